//! Angles that a stage reads back a little differently each time, told apart from those that differ.
//!
//! A stage comes to a place with some jitter. Rounding would split a place whose readings lie to both sides of a
//! half; so readings are put in order, and a group goes on as long as it stays within a width of its first.

use crate::units::Angle;

/// For each angle the number of its group, by rising angle: those within `within` of the lowest of a group are in it.
#[must_use]
pub fn alike(angles: &[Angle], within: Angle) -> Vec<usize> {
    grouped(&angles.iter().map(|a| a.deg()).collect::<Vec<_>>(), within).0
}

/// The same of directions, which a whole turn brings back: 359.99° and 0° are neighbours, in the group 0.
#[must_use]
pub fn alike_around(angles: &[Angle], within: Angle) -> Vec<usize> {
    let turned: Vec<f64> = angles.iter().map(|a| a.deg().rem_euclid(360.0)).collect();
    let (mut groups, starts) = grouped(&turned, within);
    let close = starts.len() > 1 && starts[0] + 360.0 - starts[starts.len() - 1] <= within.deg();
    if close {
        let last = starts.len() - 1;
        for group in groups.iter_mut().filter(|group| **group == last) {
            *group = 0;
        }
    }
    groups
}

/// Groups, and where each begins.
fn grouped(degrees: &[f64], within: Angle) -> (Vec<usize>, Vec<f64>) {
    let mut order: Vec<usize> = (0..degrees.len()).collect();
    order.sort_by(|a, b| degrees[*a].total_cmp(&degrees[*b]));
    let mut groups = vec![0; degrees.len()];
    let mut starts: Vec<f64> = Vec::new();
    for at in order {
        if starts
            .last()
            .is_none_or(|first| degrees[at] - first > within.deg())
        {
            starts.push(degrees[at]);
        }
        groups[at] = starts.len() - 1;
    }
    (groups, starts)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn degrees(all: &[f64]) -> Vec<Angle> {
        all.iter().copied().map(Angle::from_deg).collect()
    }

    #[test]
    fn readings_to_both_sides_of_any_boundary_are_one_place() {
        let tenth = Angle::from_deg(0.1);
        let tilts = degrees(&[5.003, -20.0, 4.997, 15.0, 5.05, 4.951, 15.2]);
        assert_eq!(alike(&tilts, tenth), [1, 0, 1, 2, 1, 1, 3]);
        let turns = degrees(&[0.002, 359.998, 90.0, -0.001, 450.01, 180.0]);
        assert_eq!(alike_around(&turns, tenth), [0, 0, 1, 0, 1, 2]);
        assert_eq!(alike_around(&degrees(&[180.0]), tenth), [0]);
        assert_eq!(alike(&[], tenth), [0usize; 0]);
    }
}
