//! Checks whether a frame has the sensor's fixed pattern in its place.
//!
//! Neighbouring pixels differ in dark level and response, which darks and flats determine. A frame that was shifted, torn or
//! composed of two has that pattern elsewhere. Differences between neighbouring pixels are compared, since they contain nothing
//! that the sample shows over more than a pixel. Where a lobe slopes over the field, second differences are used, which
//! contain no slope either.

/// Tiles per edge for the search of torn frames.
const TILES: usize = 4;
/// Smallest strength of a pattern that can be tested, in standard errors.
const TESTABLE_SIGMAS: f64 = 10.0;
/// Range of the search for a displaced pattern, as a share of the frame's edge.
const SEARCH_SHARE: usize = 4;

/// The expected frame up to noise, and the pixels that may be compared.
pub(super) struct Expected<'a> {
    /// Counts per pixel without light.
    pub(super) dark_dn: &'a [f32],
    /// Response per pixel, and counts of the light in a pixel of response 1. Light is taken as even over a difference: the
    /// sensor's pattern is expected, but no edge or slope of the sample.
    pub(super) response: &'a [f32],
    pub(super) light_dn: &'a [f32],
    /// Variance of the expected counts, from the noise of the darks and flats.
    pub(super) variance_dn2: f64,
    /// Pixels of equal label may be compared; `u16::MAX` is left out.
    pub(super) labels: &'a [u16],
    pub(super) width: usize,
    pub(super) differences: Differences,
}

impl Expected<'_> {
    /// The difference to expect at a column of the row that begins at pixel `row`.
    fn due(&self, row: usize, column: usize) -> Option<f64> {
        let labels = &self.labels[row..row + self.width];
        let of = |plane: &[f32]| {
            let value = |k: usize| f64::from(plane[row + k]);
            self.differences.at(column, labels, value)
        };
        Some(of(self.dark_dn)? + f64::from(self.light_dn[row + column]) * of(self.response)?)
    }
}

/// The differences along a row that are compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Differences {
    /// Between neighbours.
    First,
    /// Between a pixel and the mean of those on both sides, twice: a slope has none.
    Second,
}

impl Differences {
    /// The difference that ends at a pixel of a row, where all its pixels may be compared.
    pub(super) fn at(
        self,
        column: usize,
        labels: &[u16],
        value: impl Fn(usize) -> f64,
    ) -> Option<f64> {
        let pixels = match self {
            Differences::First => 2,
            Differences::Second => 3,
        };
        let label = labels[column];
        let first = (column + 1).checked_sub(pixels)?;
        if label == u16::MAX || labels[first..column].iter().any(|l| *l != label) {
            return None;
        }
        Some(match self {
            Differences::First => value(column) - value(column - 1),
            Differences::Second => value(column) - 2.0 * value(column - 1) + value(column - 2),
        })
    }

    /// Variance of a difference of values that have one each.
    pub(super) fn variance(self) -> f64 {
        match self {
            Differences::First => 2.0,
            Differences::Second => 6.0,
        }
    }
}

/// The result of the comparison.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Verdict {
    /// The pattern is in its place, or too weak to be tested.
    InPlace,
    /// It is displaced by (columns, rows).
    Shifted(i32, i32),
    /// It was not found.
    Absent,
    /// It is missing in some tiles of the frame.
    Torn { tiles: usize },
}

#[derive(Clone, Copy, Default)]
struct Cross {
    n: f64,
    ee: f64,
    de: f64,
    dd: f64,
}

impl Cross {
    fn add(&mut self, d: f64, e: f64) {
        self.n += 1.0;
        self.ee += e * e;
        self.de += d * e;
        self.dd += d * d;
    }

    fn plus(self, o: Cross) -> Cross {
        Cross {
            n: self.n + o.n,
            ee: self.ee + o.ee,
            de: self.de + o.de,
            dd: self.dd + o.dd,
        }
    }

    /// Slope of the frame's differences on the expected ones and its standard error. Neighbouring
    /// differences share pixels, which makes the error √2 larger at most: 1 + 2 Σ ρ² is 1.5 for first and 1.95 for second
    /// differences.
    fn slope(self) -> Option<(f64, f64)> {
        if self.n < 32.0 || self.ee <= 0.0 {
            return None;
        }
        let slope = self.de / self.ee;
        let left = (self.dd - slope * self.de).max(0.0) / (self.n - 1.0);
        Some((slope, (2.0 * left / self.ee).sqrt()))
    }

    /// Slope to expect of an intact frame: noise in the expectation flattens it.
    fn attenuation(self, variance_dn2: f64, differences: Differences) -> f64 {
        if self.ee <= 0.0 {
            return 0.0;
        }
        (1.0 - differences.variance() * variance_dn2 * self.n / self.ee).max(0.0)
    }
}

/// Compares a frame's counts with what is expected of them.
pub(super) fn compare(dn: &[u16], expected: &Expected<'_>) -> Verdict {
    let width = expected.width;
    let height = dn.len() / width;
    let mut tiles = [Cross::default(); TILES * TILES];
    for row in 0..height {
        let tile_row = row * TILES / height * TILES;
        let first = row * width;
        let (d, l) = (
            &dn[first..first + width],
            &expected.labels[first..first + width],
        );
        for column in 1..width {
            let seen = (expected.differences).at(column, l, |k| f64::from(d[k]));
            if let (Some(seen), Some(due)) = (seen, expected.due(first, column)) {
                tiles[tile_row + column * TILES / width].add(seen, due);
            }
        }
    }
    let all = tiles.iter().fold(Cross::default(), |a, t| a.plus(*t));
    let Some((slope, std)) = all.slope() else {
        return Verdict::InPlace;
    };
    let due = all.attenuation(expected.variance_dn2, expected.differences);
    if due < TESTABLE_SIGMAS * std {
        return Verdict::InPlace;
    }
    if slope < 0.5 * due {
        return locate(dn, expected);
    }
    let torn = tiles
        .iter()
        .filter(|tile| {
            tile.slope()
                .is_some_and(|(slope, std)| due > TESTABLE_SIGMAS * std && slope < 0.3 * due)
        })
        .count();
    if torn > 0 {
        Verdict::Torn { tiles: torn }
    } else {
        Verdict::InPlace
    }
}

/// Searches the displacement at which the pattern fits best, for frames that failed.
fn locate(dn: &[u16], expected: &Expected<'_>) -> Verdict {
    let width = expected.width;
    let height = dn.len() / width;
    // A window in the middle that the search never carries over the edge; of a large frame a part
    // is enough.
    let half = |edge: usize| (edge / 4).min(48);
    let reach = |edge: usize| (edge / SEARCH_SHARE).min(32) as i32;
    let (half_w, half_h) = (half(width), half(height));
    if half_w < 4 || half_h < 4 {
        return Verdict::Absent;
    }
    let columns = width / 2 - half_w..width / 2 + half_w;
    let rows = height / 2 - half_h..height / 2 + half_h;
    let mut best = (0.0, 0, 0);
    for dy in -reach(height)..=reach(height) {
        for dx in -reach(width)..=reach(width) {
            let mut cross = Cross::default();
            for row in rows.clone() {
                let there = (row as i32 - dy) as usize;
                if there >= height {
                    continue;
                }
                let first = there * width;
                let l = &expected.labels[first..first + width];
                let d = &dn[row * width..(row + 1) * width];
                for column in columns.clone() {
                    let from = (column as i32 - dx) as usize;
                    if from == 0 || from >= width {
                        continue;
                    }
                    // Columns of the window have as many to their left as a difference takes.
                    let seen = |k: usize| f64::from(d[column + k - from]);
                    if let (Some(seen), Some(due)) = (
                        expected.differences.at(from, l, seen),
                        expected.due(first, from),
                    ) {
                        cross.add(seen, due);
                    }
                }
            }
            if let Some((slope, std)) = cross.slope()
                && slope > best.0
                && slope > 8.0 * std
            {
                best = (slope, dx, dy);
            }
        }
    }
    match best {
        // Weaker than it should be, but nowhere stronger.
        (slope, 0, 0) if slope > 0.0 => Verdict::InPlace,
        (slope, dx, dy) if slope > 0.0 => Verdict::Shifted(dx, dy),
        _ => Verdict::Absent,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64;

    const EDGE: usize = 128;

    /// A pattern of 1 % rms under 0.7 % of noise, as in the recorded series.
    fn frame(shift: (i32, i32), seed: u64) -> (Vec<u16>, Vec<f32>) {
        let mut rng = Pcg64::seed_from_u64(7);
        let mut gauss =
            |rms: f64| -> f64 { (0..12).map(|_| rng.random::<f64>() - 0.5).sum::<f64>() * rms };
        let expected: Vec<f32> = (0..EDGE * EDGE)
            .map(|_| (20_000.0 * (1.0 + gauss(0.01))) as f32)
            .collect();
        let mut rng = Pcg64::seed_from_u64(seed);
        let mut noise = || (0..12).map(|_| rng.random::<f64>() - 0.5).sum::<f64>() * 140.0;
        let edge = EDGE as i32;
        let dn = (0..edge * edge)
            .map(|i| {
                let column = (i % edge - shift.0).rem_euclid(edge);
                let row = (i / edge - shift.1).rem_euclid(edge);
                (f64::from(expected[(row * edge + column) as usize]) + noise()).round() as u16
            })
            .collect();
        (dn, expected)
    }

    fn verdict(dn: &[u16], expected: &[f32]) -> Verdict {
        verdict_by(Differences::First, dn, expected)
    }

    fn verdict_by(differences: Differences, dn: &[u16], expected: &[f32]) -> Verdict {
        let labels = vec![0; dn.len()];
        let none = vec![0.0; dn.len()];
        compare(
            dn,
            &Expected {
                dark_dn: expected,
                response: &none,
                light_dn: &none,
                variance_dn2: 0.0,
                labels: &labels,
                width: EDGE,
                differences,
            },
        )
    }

    #[test]
    fn an_intact_frame_is_in_place() {
        for seed in 0..20 {
            let (dn, expected) = frame((0, 0), seed);
            assert_eq!(verdict(&dn, &expected), Verdict::InPlace);
        }
    }

    #[test]
    fn a_shift_is_found_with_its_direction() {
        for shift in [(1, 0), (0, -1), (5, -3), (-12, 7)] {
            let (dn, expected) = frame(shift, 1);
            assert_eq!(
                verdict(&dn, &expected),
                Verdict::Shifted(shift.0, shift.1),
                "{shift:?}"
            );
        }
    }

    #[test]
    fn half_a_frame_from_elsewhere_is_torn() {
        let (mut dn, expected) = frame((0, 0), 1);
        let (other, _) = frame((3, 3), 2);
        let half = dn.len() * 3 / 4;
        dn[half..].copy_from_slice(&other[half..]);
        assert_eq!(verdict(&dn, &expected), Verdict::Torn { tiles: TILES });
    }

    #[test]
    fn second_differences_find_the_same_under_a_slope_that_hides_the_pattern_from_first_ones() {
        // A lobe's flank of 150 DN per pixel, which the expectation does not know of.
        let sloping = |dn: &[u16]| -> Vec<u16> {
            let slope = |i: usize| (EDGE / 2).abs_diff(i % EDGE) as u16 * 150;
            dn.iter().enumerate().map(|(i, dn)| dn + slope(i)).collect()
        };
        let (dn, expected) = frame((0, 0), 1);
        let second = |dn: &[u16]| verdict_by(Differences::Second, dn, &expected);
        assert_eq!(second(&sloping(&dn)), Verdict::InPlace);
        let (dn, _) = frame((5, -3), 1);
        assert_eq!(second(&sloping(&dn)), Verdict::Shifted(5, -3));
        let (mut dn, _) = frame((0, 0), 1);
        let (other, _) = frame((3, 3), 2);
        let half = dn.len() * 3 / 4;
        dn[half..].copy_from_slice(&other[half..]);
        assert_eq!(second(&sloping(&dn)), Verdict::Torn { tiles: TILES });
    }

    #[test]
    fn a_sensor_without_a_pattern_cannot_be_tested() {
        let (dn, _) = frame((0, 0), 1);
        let flat = vec![20_000.0; dn.len()];
        assert_eq!(verdict(&dn, &flat), Verdict::InPlace);
    }
}
