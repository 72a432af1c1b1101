//! Groups of angles that differ only by the jitter of a stage.
//!
//! Rounding would split a position whose readings lie on both sides of a rounding boundary. Instead
//! the readings are sorted, and a group extends as long as they stay within a given width of its
//! first one.

use crate::units::Angle;

/// Returns the group number of each angle, in ascending order: a group holds the angles within
/// `within` of its lowest one.
#[must_use]
pub fn group_angles(angles: &[Angle], within: Angle) -> Vec<usize> {
    grouped(&angles.iter().map(|a| a.deg()).collect::<Vec<_>>(), within).0
}

/// As [`group_angles`] for directions, which have a period of 360°: 359.99° and 0° are neighbours, in
/// group 0.
#[must_use]
pub fn group_directions(angles: &[Angle], within: Angle) -> Vec<usize> {
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

/// Returns the group of each angle, and the first angle of each group.
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
    fn readings_on_both_sides_of_a_boundary_are_one_group() {
        let tenth = Angle::from_deg(0.1);
        let tilts = degrees(&[5.003, -20.0, 4.997, 15.0, 5.05, 4.951, 15.2]);
        assert_eq!(group_angles(&tilts, tenth), [1, 0, 1, 2, 1, 1, 3]);
        let turns = degrees(&[0.002, 359.998, 90.0, -0.001, 450.01, 180.0]);
        assert_eq!(group_directions(&turns, tenth), [0, 0, 1, 0, 1, 2]);
        assert_eq!(group_directions(&degrees(&[180.0]), tenth), [0]);
        assert_eq!(group_angles(&[], tenth), [0usize; 0]);
    }
}
