//! Heights as read from a file, with the units stated in it and missing points.
//!
//! A missing height is NaN. [`HeightMap::filled`] interpolates missing points,
//! [`HeightMap::spikes`] finds heights that differ from all their neighbours.

use crate::trace::surfaces::surface_profile::{ProfileError, SurfaceProfile};

/// Heights read from a file, in the file's unit; index row·columns + column, rows along v.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct HeightMap {
    /// Samples along u.
    pub columns: usize,
    /// Samples along v.
    pub rows: usize,
    /// Heights; NaN if missing.
    pub heights: Vec<f64>,
    /// Spacing of the samples along u and v as stated in the file, µm.
    pub pitch_um: Option<[f64; 2]>,
    /// The same in an unstated unit, for points with positions.
    pub spacing: Option<[f64; 2]>,
    /// Micrometres per unit of the heights as stated in the file.
    pub height_unit_um: Option<f64>,
    /// Notes on how an ambiguous file was read, as sentences.
    pub notes: Vec<String>,
}

/// Units of a height map.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MapUnits {
    /// Spacing of the samples along u and v, µm.
    pub pitch_um: [f64; 2],
    /// Micrometres per unit of the heights.
    pub height_unit_um: f64,
}

/// A linear interpolation across missing points.
#[derive(Clone, Copy)]
struct Bridge {
    /// Number of ends with a height; one at the rim.
    ends: usize,
    /// Number of points that it spans.
    span: usize,
    value: f64,
}

impl Bridge {
    /// Prefers two ends to one, then the shorter span.
    fn is_better_than(&self, other: &Bridge) -> bool {
        (self.ends, other.span) > (other.ends, self.span)
    }
}

impl HeightMap {
    /// Makes a map of rows of heights without units.
    #[must_use]
    pub fn new(columns: usize, heights: Vec<f64>) -> Self {
        HeightMap {
            columns,
            rows: heights.len() / columns.max(1),
            heights,
            ..HeightMap::default()
        }
    }

    /// Adds stated units.
    #[must_use]
    pub fn stating(self, units: MapUnits) -> Self {
        HeightMap {
            pitch_um: Some(units.pitch_um),
            height_unit_um: Some(units.height_unit_um),
            ..self
        }
    }

    /// Whether the file states any unit.
    #[must_use]
    pub fn states_units(&self) -> bool {
        self.pitch_um.is_some() || self.height_unit_um.is_some() || self.spacing.is_some()
    }

    /// Number of missing points.
    #[must_use]
    pub fn missing(&self) -> usize {
        self.heights.iter().filter(|h| h.is_nan()).count()
    }

    /// Fraction of missing points.
    #[must_use]
    pub fn missing_share(&self) -> f64 {
        self.missing() as f64 / self.heights.len().max(1) as f64
    }

    /// Fills missing points by linear interpolation along their row or column, whichever gap is
    /// shorter; at the rim the nearest height is repeated. NaN remains only if all points are
    /// missing.
    #[must_use]
    pub fn filled(&self) -> Vec<f64> {
        let mut heights = self.heights.clone();
        loop {
            let holes: Vec<usize> = (0..heights.len())
                .filter(|n| heights[*n].is_nan())
                .collect();
            if holes.is_empty() || holes.len() == heights.len() {
                return heights;
            }
            let mut best: Vec<Option<Bridge>> = vec![None; holes.len()];
            // Along the rows, then along the columns: number of lines, their length, stride between
            // lines, stride between points.
            let (columns, rows) = (self.columns, self.rows);
            for (lines, length, apart, step) in
                [(rows, columns, columns, 1), (columns, rows, 1, columns)]
            {
                for line in 0..lines {
                    let points: Vec<usize> = (0..length).map(|i| line * apart + i * step).collect();
                    for (n, bridge) in bridges(&heights, &points) {
                        let slot = holes.partition_point(|hole| *hole < n);
                        if best[slot].is_none_or(|known| bridge.is_better_than(&known)) {
                            best[slot] = Some(bridge);
                        }
                    }
                }
            }
            for (hole, bridge) in holes.iter().zip(best) {
                heights[*hole] = bridge.map_or(f64::NAN, |b| b.value);
            }
        }
    }

    /// Points that differ from the median of their neighbours by more than `share` of the map's
    /// height (the range of nine tenths of its points), which ridges, walls and edges do not.
    #[must_use]
    pub fn spikes(&self, share: f64) -> Vec<usize> {
        let Some(height) = self.robust_height() else {
            return Vec::new();
        };
        if self.columns < 3 || self.rows < 3 {
            return Vec::new();
        }
        let limit = share * height;
        let (columns, rows) = (self.columns as isize, self.rows as isize);
        let at = |column: isize, row: isize| {
            let within = (0..columns).contains(&column) && (0..rows).contains(&row);
            let h = within.then(|| self.heights[(row * columns + column) as usize]);
            h.filter(|h| !h.is_nan())
        };
        let stands_off = |n: usize| {
            let (column, row) = (n as isize % columns, n as isize / columns);
            // At an edge, one of two opposite neighbours is on the point's own side: the median of
            // each pair and the point is, too.
            let h = self.heights[n];
            let mut around = [h; 9];
            let mut count = 1;
            for (c, r) in [(1, 0), (0, 1), (1, 1), (1, -1)] {
                if let (Some(a), Some(b)) = (at(column - c, row - r), at(column + c, row + r)) {
                    (around[count], around[count + 1]) = (a, b);
                    count += 2;
                }
            }
            let around = &mut around[..count];
            // Most points are close to most of their neighbours, so sorting is rarely needed.
            let near = around.iter().filter(|other| (h - **other).abs() <= limit);
            if near.count() > count / 2 {
                return false;
            }
            around.sort_by(f64::total_cmp);
            (h - around[count / 2]).abs() > limit
        };
        (0..self.heights.len())
            .filter(|n| !self.heights[*n].is_nan() && stands_off(*n))
            .collect()
    }

    /// Height range of nine tenths of the points; `None` if there are no points or the range is 0.
    fn robust_height(&self) -> Option<f64> {
        let mut seen: Vec<f64> = self
            .heights
            .iter()
            .copied()
            .filter(|h| !h.is_nan())
            .collect();
        let last = seen.len().checked_sub(1)?;
        let mut at = |share: f64| {
            let n = (share * last as f64).round() as usize;
            *seen.select_nth_unstable_by(n, f64::total_cmp).1
        };
        let height = at(0.95) - at(0.05);
        (height > 0.0 && height.is_finite()).then_some(height)
    }
}

impl HeightMap {
    /// Value of the last digit of the largest height, in the file's unit.
    pub(super) fn last_digit(&self) -> f64 {
        let largest = |all: &mut dyn Iterator<Item = &f64>| all.fold(0.0f64, |a, h| a.max(h.abs()));
        f64::EPSILON
            * match self.is_profile_table() {
                true => largest(&mut self.heights.iter().skip(1).step_by(2)),
                false => largest(&mut self.heights.iter()),
            }
    }

    /// Whether it is a table of two columns, positions and heights: a map would state its units or
    /// have more columns.
    #[must_use]
    pub fn is_profile_table(&self) -> bool {
        self.columns == 2 && !self.states_units()
    }

    /// The profile whose corners are the rows: v and height in one unit; the last row closes the
    /// period. For a single row with units, as instruments measure profiles, the samples are the
    /// corners, in µm. Missing points are skipped.
    ///
    /// # Errors
    /// The rows are not two numbers, the heights are a map, or the profile is not closed or does
    /// not lean to +v.
    pub fn profile(&self) -> Result<SurfaceProfile, ProfileError> {
        if let (Some(pitch_um), Some(height_unit_um)) = (self.pitch_um, self.height_unit_um) {
            if self.rows != 1 {
                return Err(ProfileError::Map { rows: self.rows });
            }
            return self.row_profile(MapUnits {
                pitch_um,
                height_unit_um,
            });
        }
        if self.columns != 2 {
            return Err(ProfileError::NotTwoColumns {
                columns: self.columns,
            });
        }
        let rows = self.heights.chunks_exact(2).map(|r| (r[0], r[1]));
        SurfaceProfile::measured(&rows.filter(|row| !row.1.is_nan()).collect::<Vec<_>>())
    }

    /// The profile of a single row of samples.
    ///
    /// # Errors
    /// The profile is not closed or does not lean to +v.
    pub fn row_profile(&self, units: MapUnits) -> Result<SurfaceProfile, ProfileError> {
        let samples = self.heights.iter().enumerate();
        let samples =
            samples.map(|(n, h)| (n as f64 * units.pitch_um[0], h * units.height_unit_um));
        SurfaceProfile::measured(&samples.filter(|row| !row.1.is_nan()).collect::<Vec<_>>())
    }
}

/// Returns the interpolations across the missing points of a line, with their indices in the map.
fn bridges(heights: &[f64], points: &[usize]) -> Vec<(usize, Bridge)> {
    let mut found = Vec::new();
    let mut i = 0;
    while i < points.len() {
        if !heights[points[i]].is_nan() {
            i += 1;
            continue;
        }
        let from = i;
        while i < points.len() && heights[points[i]].is_nan() {
            i += 1;
        }
        let before = from.checked_sub(1).map(|k| heights[points[k]]);
        let after = points.get(i).map(|n| heights[*n]);
        let bridge = |k: usize| match (before, after) {
            (Some(a), Some(b)) => Some(Bridge {
                ends: 2,
                span: i - from,
                value: a + (b - a) * (k + 1 - from) as f64 / (i + 1 - from) as f64,
            }),
            (Some(value), None) => Some(Bridge {
                ends: 1,
                span: k + 1 - from,
                value,
            }),
            (None, Some(value)) => Some(Bridge {
                ends: 1,
                span: i - k,
                value,
            }),
            (None, None) => None,
        };
        found.extend((from..i).filter_map(|k| Some((points[k], bridge(k)?))));
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaps_are_filled_along_the_shorter_way_and_the_rim_repeats_its_neighbour() {
        // Heights rise along the columns only; a whole row, a part of a row and a corner are
        // missing.
        let (columns, rows) = (8, 7);
        let height = |n: usize| (n / columns) as f64;
        let mut map = HeightMap::new(columns, (0..columns * rows).map(height).collect());
        for n in (3 * columns..4 * columns).chain([9, 10, 11, columns * rows - 1]) {
            map.heights[n] = f64::NAN;
        }
        assert_eq!(map.missing(), 12);
        for (n, h) in map.filled().into_iter().enumerate() {
            let expected = if n == columns * rows - 1 {
                6.0
            } else {
                height(n)
            };
            assert!((h - expected).abs() < 1e-12, "{n}: {h}");
        }
        // If no height is known, none is invented.
        assert!(HeightMap::new(2, vec![f64::NAN; 4]).filled()[0].is_nan());
        // A row and a column with heights only at their ends.
        let lone = HeightMap::new(
            3,
            vec![1.0, f64::NAN, f64::NAN, f64::NAN, f64::NAN, f64::NAN],
        );
        assert_eq!(lone.filled(), [1.0; 6]);
    }

    #[test]
    fn spikes_differ_from_all_neighbours_and_edges_do_not() {
        // A sawtooth of 9 samples whose walls are oblique to the samples.
        let (columns, rows) = (60, 50);
        let height = |n: usize| {
            let v = (n % columns) as f64 + 0.37 * (n / columns) as f64;
            9.0 - v.rem_euclid(9.0)
        };
        let mut map = HeightMap::new(columns, (0..columns * rows).map(height).collect());
        assert_eq!(map.spikes(0.3), [] as [usize; 0]);
        let spikes = [30, 130, 1530, 27 * columns];
        for n in spikes {
            map.heights[n] += 8.0;
        }
        map.heights[131] = f64::NAN;
        assert_eq!(map.spikes(0.3), spikes);
        assert!(HeightMap::new(3, vec![2.0; 9]).spikes(0.3).is_empty());
    }
}
