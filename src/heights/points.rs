//! Distinguishes points x, y, z from rows of heights, and puts them on their regular grid.

use super::check_size;
use super::column_units::of_points;
use super::header::Header;
use crate::trace::scene::HeightMap;
use crate::wording::significant;

/// Least number of rows of three numbers that may be points; fewer are a small map.
const POINTS_MIN: usize = 9;
/// Number of rows of three numbers that must be points, whether they are on a grid or not.
const POINTS_SURE: usize = 32;
/// Least fraction of grid positions with a point.
const COVERED_MIN: f64 = 0.5;
/// Largest deviation of a position from its grid, in steps: programs round positions.
const OFF_MAX: f64 = 0.25;

/// Evenly spaced positions on a line.
struct Places {
    first: f64,
    step: f64,
    count: usize,
}

impl Places {
    /// Finds the positions of points in any order; `None` if they are not evenly spaced.
    fn of(all: impl Iterator<Item = f64>) -> Option<Self> {
        let mut all: Vec<f64> = all.collect();
        all.sort_by(f64::total_cmp);
        let (first, last) = (*all.first()?, *all.last()?);
        let span = last - first;
        if !span.is_finite() {
            return None;
        }
        if span <= 0.0 {
            return Some(Places {
                first,
                step: 0.0,
                count: 1,
            });
        }
        // Differences of rounded positions within a column are much smaller than the spacing of the
        // columns.
        let steps = all.windows(2).map(|pair| pair[1] - pair[0]);
        let widest = steps.clone().fold(0.0, f64::max);
        let mut wide: Vec<f64> = steps.filter(|step| *step > 0.1 * widest).collect();
        let middle = wide.len() / 2;
        let usual = *wide.select_nth_unstable_by(middle, f64::total_cmp).1;
        let intervals = (span / usual).round();
        let step = span / intervals;
        let is_even = all.iter().all(|x| {
            let place = (x - first) / step;
            (place - place.round()).abs() <= OFF_MAX
        });
        (is_even && intervals < 1e9).then_some(Places {
            first,
            step,
            count: intervals as usize + 1,
        })
    }

    fn index(&self, x: f64) -> usize {
        match self.count {
            1 => 0,
            _ => ((x - self.first) / self.step).round() as usize,
        }
    }
}

/// Converts a table of three columns of points x, y, z to a map; `None` if they are three heights
/// per row.
///
/// # Errors
/// The points are not on a regular grid, two points have one position, or a unit is unsupported.
pub(super) fn gridded(
    numbers: &[f64],
    names: &[String],
    header: &Header,
    most: usize,
) -> Result<Option<HeightMap>, String> {
    let count = numbers.len() / 3;
    if count < POINTS_MIN {
        return Ok(None);
    }
    let column = |n: usize| numbers.iter().copied().skip(n).step_by(3);
    let places = (Places::of(column(0)), Places::of(column(1)));
    let covers = |x: &Places, y: &Places| {
        let cells = x.count as f64 * y.count as f64;
        count as f64 >= COVERED_MIN * cells && x.count.max(y.count) > 2
    };
    let (x, y) = match places {
        (Some(x), Some(y)) if covers(&x, &y) => (x, y),
        _ if count >= POINTS_SURE => {
            return Err(format!(
                "{count} rows of three numbers look like points x, y, z, but are not on a regular grid along x and y: \
                 interpolate them on one and save rows of heights, an X3P file or points on that grid"
            ));
        }
        _ => return Ok(None),
    };
    check_size(x.count, y.count, most)?;
    let mut heights = vec![f64::NAN; x.count * y.count];
    let mut taken = vec![false; x.count * y.count];
    for (n, point) in numbers.chunks_exact(3).enumerate() {
        let at = y.index(point[1]) * x.count + x.index(point[0]);
        if taken[at] && (heights[at] - point[2]).abs() > 0.0 {
            return Err(format!(
                "point {} has the position of another point but a different height: all points must be on one surface",
                n + 1
            ));
        }
        (heights[at], taken[at]) = (point[2], true);
    }
    let [unit_x, unit_y, unit_z] = of_points(names)?;
    // A single line of points becomes one row, in either direction.
    let is_column = x.count == 1;
    let steps = match (is_column, y.count) {
        (true, _) => [y.step; 2],
        (false, 1) => [x.step; 2],
        _ => [x.step, y.step],
    };
    let lateral = [
        unit_x.or(header.lateral_um()),
        unit_y.or(header.lateral_um()),
    ];
    let pitch_um = match lateral {
        [Some(u), Some(v)] => Some([steps[0] * u, steps[1] * v]),
        _ => None,
    };
    let note = format!(
        "the three columns are read as points x, y, z on a regular grid of {} × {}, spaced {} × {} in the file's unit of length",
        x.count,
        y.count,
        significant(steps[0]),
        significant(steps[1])
    );
    let map = HeightMap::new(if is_column { y.count } else { x.count }, heights);
    Ok(Some(HeightMap {
        pitch_um,
        spacing: pitch_um.is_none().then_some(steps),
        height_unit_um: unit_z.or(header.value_um()),
        notes: vec![note],
        ..map
    }))
}

#[cfg(test)]
mod tests {
    use super::super::read;

    /// Points of a plane on 12 × 9 positions, 0.333 and 0.5 apart, in shuffled order, with some
    /// left out.
    fn text(head: &str, keep: fn(usize) -> bool) -> String {
        let mut text = head.to_owned();
        for k in (0..108).map(|k| k * 35 % 108).filter(|k| keep(*k)) {
            let (i, j) = ((k % 12) as f64, (k / 12) as f64);
            text += &format!(
                "{:.3} {:.3} {:.3}\n",
                5.0 + i / 3.0,
                -2.0 + 0.5 * j,
                i + 10.0 * j
            );
        }
        text
    }

    #[test]
    fn points_on_a_grid_become_its_heights_in_any_order_and_absent_ones_are_missing() {
        let map = read("a.xyz", text("", |_| true).as_bytes()).unwrap();
        assert_eq!((map.columns, map.rows, map.missing()), (12, 9, 0));
        for (n, h) in map.heights.iter().enumerate() {
            assert!((h - ((n % 12) as f64 + 10.0 * (n / 12) as f64)).abs() < 1e-9);
        }
        let [u, v] = map.spacing.unwrap();
        assert!((u - 1.0 / 3.0).abs() < 1e-3 && (v - 0.5).abs() < 1e-9);
        assert!(map.pitch_um.is_none() && map.notes[0].contains("x, y, z"));
        let some = read("a.txt", text("x_mm y_mm z_nm\n", |k| k % 7 != 3).as_bytes()).unwrap();
        assert_eq!((some.columns, some.rows, some.missing()), (12, 9, 15));
        assert!((some.pitch_um.unwrap()[1] - 500.0).abs() < 1e-6);
        assert_eq!((some.height_unit_um, some.spacing), (Some(1e-3), None));
        // A single line of points is a profile.
        let line: String = (0..40).map(|n| format!("1 {n} {}\n", n % 10)).collect();
        let map = read("a.txt", line.as_bytes()).unwrap();
        assert_eq!((map.columns, map.rows), (40, 1));
    }

    #[test]
    fn points_off_a_grid_are_refused_as_points_and_small_maps_stay_maps() {
        let scattered: String = (0..60)
            .map(|n| {
                let n = f64::from(n);
                format!("{} {} 1\n", (n * 0.618).fract(), (n * 0.414).fract())
            })
            .collect();
        let why = read("a.txt", scattered.as_bytes()).unwrap_err();
        assert!(
            why.contains("points x, y, z") && why.contains("interpolate"),
            "{why}"
        );
        let twice = text("", |_| true) + "5.000 -2.000 7\n";
        assert!(
            read("a.txt", twice.as_bytes())
                .unwrap_err()
                .contains("point 109")
        );
        assert_eq!(read("a.csv", b"1,2,3\n4,5,7\n").unwrap().columns, 3);
    }
}
