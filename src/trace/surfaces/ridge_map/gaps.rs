//! Bridges gaps across the ridges in which nothing was measured.
//!
//! Instruments miss steep parts and some of their surroundings, so a gap contains a wall that is at
//! least vertical and at most as wide as the gap. [`FlankExtension::Half`] extends the flanks
//! beside a gap until half of it is left for the wall, [`FlankExtension::Whole`] to its middle (or
//! to where they meet). The difference of the results bounds the unknown to either side.

use super::lines::{FlankExtension, RidgeLine, RidgeLines};

/// Lines whose spacing exceeds the usual one by this, in samples, have a gap between them.
const WIDE: f64 = 0.45;
/// Largest distance of a corner from a gap's end, in the same unit.
const BESIDE: f64 = 2.5;
/// Largest fraction of half a gap by which a flank is extended: walls have a width.
const HALF: f64 = 0.98;

/// A gap between two lines, as positions across.
#[derive(Debug, Clone, Copy)]
struct Gap {
    from: f64,
    to: f64,
}

impl RidgeLines {
    /// Usual spacing of lines.
    fn apart(&self) -> f64 {
        let mut apart: Vec<f64> = self.lines.windows(2).map(|l| l[1].v - l[0].v).collect();
        let middle = apart.len() / 2;
        match apart.is_empty() {
            true => 0.0,
            false => *apart.select_nth_unstable_by(middle, f64::total_cmp).1,
        }
    }

    /// The gaps; empty for a completely measured map.
    fn gaps(&self) -> Vec<Gap> {
        if self.holes.is_empty() {
            return Vec::new();
        }
        let usual = self.apart();
        let pairs = self.lines.windows(2);
        let is_gap = |l: &&[RidgeLine]| {
            let within = |hole: &f64| l[0].v < *hole && *hole < l[1].v;
            l[1].v - l[0].v > usual + WIDE * self.sample && self.holes.iter().any(within)
        };
        let wide = pairs.filter(is_gap);
        wide.map(|l| Gap {
            from: l[0].v,
            to: l[1].v,
        })
        .collect()
    }

    /// Fraction of the length in gaps, without the half lines that belong to their ends.
    pub fn unseen(&self) -> f64 {
        let usual = self.apart();
        let gaps = self.gaps();
        let within: f64 = gaps.iter().map(|gap| gap.to - gap.from - usual).sum();
        // The sum of an empty list is −0.
        (within / self.length()).max(0.0)
    }

    /// The straight pieces of these lines, with the flanks beside gaps extended.
    pub fn bridged_by(&self, straight: &RidgeLines, reach: FlankExtension) -> RidgeLines {
        let (gaps, usual) = (self.gaps(), self.apart());
        let corners = &straight.lines;
        let mut lines = Vec::with_capacity(corners.len() + 2 * gaps.len());
        for (n, corner) in corners.iter().enumerate() {
            lines.push(*corner);
            let (Some(next), Some(before), Some(after)) = (
                corners.get(n + 1),
                n.checked_sub(1).map(|k| &corners[k]),
                corners.get(n + 2),
            ) else {
                continue;
            };
            // A gap within a flank is bridged by the flank.
            let is_bridge = |gap: &&Gap| {
                let (left, right) = (gap.from - corner.v, next.v - gap.to);
                let near = 0.0..=BESIDE * usual;
                let rounding = 1e-9 * usual;
                near.contains(&(left + rounding)) && near.contains(&(right + rounding))
            };
            if let Some(gap) = gaps.iter().find(is_bridge) {
                lines.extend(gone_on([before, corner, next, after], gap, reach));
            }
        }
        let holes = straight.holes.clone();
        RidgeLines {
            lines,
            holes,
            ..*straight
        }
    }
}

/// Extends the flanks on both sides of a gap straight into it, or to where they meet.
fn gone_on(
    [before, a, b, after]: [&RidgeLine; 4],
    gap: &Gap,
    reach: FlankExtension,
) -> Vec<RidgeLine> {
    let slope = |from: &RidgeLine, to: &RidgeLine| (to.z - from.z) / (to.v - from.v);
    let (left, right) = (slope(before, a), slope(b, after));
    let on = |line: &RidgeLine, slope: f64, v: f64| RidgeLine {
        v,
        z: line.z + slope * (v - line.v),
        count: line.count,
    };
    let by = match reach {
        FlankExtension::Half => 0.25 * (gap.to - gap.from),
        FlankExtension::Whole => 0.5 * HALF * (gap.to - gap.from),
    };
    let ends = [gap.from + by, gap.to - by];
    let meet = a.v + (b.z - a.z - right * (b.v - a.v)) / (left - right);
    let reached = meet <= ends[0] || meet >= ends[1] || reach == FlankExtension::Whole;
    if meet > a.v && meet < b.v && reached {
        return vec![on(a, left, meet)];
    }
    vec![on(a, left, ends[0]), on(b, right, ends[1])]
}

#[cfg(test)]
mod tests {
    use crate::trace::surfaces::ridge_map::tests::map_of;
    use crate::trace::surfaces::ridge_map::{MapUnits, RidgeMap};
    use crate::trace::surfaces::surface_profile::SurfaceProfile;

    const UNITS: MapUnits = MapUnits {
        pitch_um: [1.0, 1.0],
        height_unit_um: 1.0,
    };

    /// Total width of steeply rising parts per ridge, µm.
    fn wall_um(profile: &SurfaceProfile, ridges: usize) -> f64 {
        let steep = profile
            .pieces()
            .iter()
            .filter(|p| p.z_to - p.z_from > 0.5 * (p.to - p.from));
        steep.map(|p| p.to - p.from).sum::<f64>() / ridges as f64
    }

    #[test]
    fn unmeasured_walls_have_their_expected_width_and_the_steepest_is_the_alternative() {
        let sawtooth = SurfaceProfile::sawtooth(10f64.to_radians(), 60.0, 0.0).unwrap();
        // sin² of the angle is the wall's fraction of a ridge.
        let wall = sawtooth.period() * 10f64.to_radians().sin().powi(2);
        for (azimuth_deg, size) in [(0.0, [400, 60]), (90.0, [60, 400]), (17.0, [300, 200])] {
            let mut map = map_of(&sawtooth, azimuth_deg, size, [1.0, 1.0], 0.02);
            let (s, c) = azimuth_deg.to_radians().sin_cos();
            for n in 0..map.heights.len() {
                let v = (n % size[0]) as f64 * c + (n / size[0]) as f64 * s;
                if v.rem_euclid(sawtooth.period()) > sawtooth.period() - wall {
                    map.heights[n] = f64::NAN;
                }
            }
            let made = RidgeMap::of(&map, UNITS).unwrap();
            let case = format!("{azimuth_deg}: {:?}", made.facts);
            assert!((made.facts.theta_r_deg - 10.0).abs() < 0.05, "{case}");
            assert!(
                (made.facts.unseen_share * sawtooth.period() / wall - 1.0).abs() < 0.35,
                "{case}"
            );
            assert!(made.facts.filled_share > 0.02, "{case}");
            let found = wall_um(&made.profile, made.facts.ridges);
            assert!(
                found > 0.4 * wall && found < wall + 0.3,
                "{found} {wall} {case}"
            );
            let steepest = made.profile.alternative().unwrap();
            assert!(wall_um(steepest, made.facts.ridges) < 0.3 * wall, "{case}");
            let left_out = made.facts.left_out();
            assert!(
                left_out
                    .iter()
                    .any(|l| l.why.contains("not measured anywhere")),
                "{left_out:?}"
            );
        }
    }

    #[test]
    fn scattered_missing_points_and_spikes_have_no_effect() {
        let sawtooth = SurfaceProfile::sawtooth(10f64.to_radians(), 40.0, 0.0).unwrap();
        let whole = map_of(&sawtooth, 33.0, [260, 220], [1.0, 1.0], 0.02);
        let (mut holed, mut spiked) = (whole.clone(), whole.clone());
        for n in (0..whole.heights.len()).step_by(37) {
            holed.heights[n] = f64::NAN;
            spiked.heights[n] += if n % 2 == 0 { 300.0 } else { -9.0 };
        }
        let [a, b, c] = [&whole, &holed, &spiked].map(|map| RidgeMap::of(map, UNITS).unwrap());
        assert_eq!(a.facts.filled_share, 0.0);
        for other in [b, c] {
            assert!((a.facts.theta_r_deg - other.facts.theta_r_deg).abs() < 0.02);
            assert!((a.facts.lean_azimuth_deg - other.facts.lean_azimuth_deg).abs() < 0.02);
            assert!((other.facts.filled_share - 1.0 / 37.0).abs() < 1e-3);
            assert!(other.profile.alternative().is_none() && other.facts.unseen_share == 0.0);
        }
        let mut gone = whole;
        for h in gone.heights.iter_mut().step_by(2) {
            *h = f64::NAN;
        }
        let why = RidgeMap::of(&gone, UNITS).unwrap_err().to_string();
        assert!(
            why.contains("28600 of 57200 points have no height"),
            "{why}"
        );
    }
}
