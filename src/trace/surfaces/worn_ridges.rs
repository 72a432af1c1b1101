//! Manufactured and worn ridges: sawtooth profiles with rounded edges, a draft angle of the risers,
//! and burrs on the crests.
//!
//! The function to call is [`WornRidges::profile`]. Edges are rounded as by a disc that rolls along
//! the surface: valleys down to where a tool of that radius reaches, crests worn until the disc
//! fits below them. If the radius is small compared with the riser, these are arcs tangent to facet
//! and riser. If it is large, they merge and the ridge loses height and inclination (morphological
//! closing and opening, as in the morphological filters of ISO 16610-41).

use super::surface_profile::{ARC, Corner, ProfileError, SurfaceProfile};
use crate::trace::rng::{Purpose, RandomStream};

/// A sawtooth surface with the effects of manufacture and wear. Lengths in one unit, angles in
/// radians.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WornRidges {
    /// Ridge angle of the facets before rounding, rad, 0 < θr < π/2.
    pub theta_r: f64,
    /// Length of a facet before rounding, in the unit of all lengths here.
    pub pitch: f64,
    /// Radius of crests and valleys, same unit; 0 for sharp ones.
    pub round: f64,
    /// Angle by which the riser is flatter than perpendicular to the facet, rad.
    pub draft: f64,
    /// Mean height of the burrs on the crests (exponentially distributed), same unit; 0 for none.
    pub burr: f64,
    /// Seed of the burrs.
    pub seed: u64,
}

/// Number of ridges in a tile if burrs make each one different.
const BURRED_RIDGES: usize = 48;
/// Least number of samples per period if the rolling disc is computed numerically,
const SAMPLES: usize = 1024;
/// least number of samples per disc radius, so that the turn at each sample is small,
const SAMPLES_TO_RADIUS: f64 = 64.0;
/// and largest number of samples per period.
const SAMPLES_MAX: usize = 1 << 16;
/// Least lift of a sample by the disc that counts, as a fraction of the period: far below a
/// wavelength on any ridge to which ray optics applies.
const TOUCHES: f64 = 1e-5;
/// Largest fraction of its facet that a burr covers: taller burrs are truncated.
const BURR_SHARE_MAX: f64 = 0.4;
/// Relative loss of the burrs' mean height by truncation that is not reported.
const CUT_REPORTED_MIN: f64 = 1e-3;

impl WornRidges {
    /// The ideal sawtooth.
    #[must_use]
    pub fn ideal(theta_r: f64, pitch: f64) -> Self {
        WornRidges {
            theta_r,
            pitch,
            round: 0.0,
            draft: 0.0,
            burr: 0.0,
            seed: 1,
        }
    }

    /// The profile: one period, or a tile of many ridges with burrs.
    ///
    /// # Errors
    /// The draft makes the riser flatter than 1° above the horizontal, or there are burrs on edges
    /// whose roundings meet.
    pub fn profile(&self) -> Result<SurfaceProfile, ProfileError> {
        let riser_lean = self.theta_r + self.draft;
        if riser_lean >= 89f64.to_radians() {
            return Err(ProfileError::TooFlat {
                draft_deg: self.draft.to_degrees(),
                limit_deg: 89.0 - self.theta_r.to_degrees(),
            });
        }
        let edges = Edges::of(self);
        let fits = self.round <= edges.largest_round;
        if self.burr > 0.0 {
            if !fits {
                return Err(ProfileError::TooRound {
                    round: self.round,
                    largest: edges.largest_round,
                });
            }
            return Ok(self.burred(&edges));
        }
        if fits {
            let mut corners = Vec::new();
            edges.edge(&mut corners, (0.0, 0.0), edges.up, edges.down, self.round);
            edges.edge(&mut corners, edges.foot(), edges.down, edges.up, self.round);
            Ok(SurfaceProfile::with_bows(&corners, edges.period))
        } else {
            Ok(self.rolled(&edges))
        }
    }

    /// Height at which burrs are truncated and their resulting mean height, if the mean falls below
    /// [`WornRidges::burr`] by more than a thousandth.
    #[must_use]
    pub fn burr_cut(&self) -> Option<(f64, f64)> {
        let most = Edges::of(self).burr_max();
        // The fraction exp(−most/mean) of exponentially distributed heights is larger.
        let share = (-most / self.burr).exp();
        (self.burr > 0.0 && share > CUT_REPORTED_MIN).then_some((most, self.burr * (1.0 - share)))
    }

    /// Many ridges, each crest with its own burr: the riser continues beyond the crest, and the
    /// burr returns to the facet at 45°.
    fn burred(&self, edges: &Edges) -> SurfaceProfile {
        let mut corners = Vec::new();
        let mut random = RandomStream::new(self.seed, Purpose::Surface, 0);
        let slant = edges.slant();
        for ridge in 0..BURRED_RIDGES {
            let from = (ridge as f64 * edges.period, 0.0);
            let height = -self.burr * (1.0 - random.uniform()).ln();
            let height = height.min(edges.burr_max());
            let width = slant * height;
            corners.push(Corner::sharp(plus(from, height, edges.up)));
            corners.push(Corner::sharp(plus(from, width, edges.down)));
            let foot = plus(from, 1.0, edges.foot());
            edges.edge(&mut corners, foot, edges.down, edges.up, self.round);
        }
        SurfaceProfile::with_bows(&corners, BURRED_RIDGES as f64 * edges.period)
    }

    /// The sharp profile closed and then opened by a disc, numerically.
    fn rolled(&self, edges: &Edges) -> SurfaceProfile {
        let samples = (SAMPLES_TO_RADIUS * edges.period / self.round) as usize;
        let samples = samples.clamp(SAMPLES, SAMPLES_MAX);
        let step = edges.period / samples as f64;
        let foot = edges.foot();
        let sharp: Vec<f64> = (0..samples)
            .map(|i| {
                let v = i as f64 * step;
                if v <= foot.0 {
                    v * edges.down.1 / edges.down.0
                } else {
                    (v - edges.period) * edges.up.1 / edges.up.0
                }
            })
            .collect();
        let closed = lifted(&sharp, self.round, step, 1.0, TOUCHES * edges.period);
        let opened = lifted(&closed, self.round, step, -1.0, TOUCHES * edges.period);
        let moved: Vec<bool> = opened.iter().zip(&sharp).map(|(a, b)| a != b).collect();
        let corners = (0..samples).map(|i| Corner {
            v: i as f64 * step,
            z: opened[i],
            bowed: moved[i] && moved[(i + 1) % samples],
        });
        let corners: Vec<Corner> = corners.collect();
        SurfaceProfile::with_bows(&without_needless(&corners, step), edges.period)
    }
}

/// Closing of a periodic row of heights by a disc (`sign` 1), or opening (−1, heights inverted).
/// Heights that the disc changes by less than `touches` are unchanged.
fn lifted(heights: &[f64], radius: f64, step: f64, sign: f64, touches: f64) -> Vec<f64> {
    let n = heights.len();
    let reach = ((radius / step) as usize).min(n);
    let disc: Vec<f64> = (0..=reach)
        .map(|i| {
            (radius * radius - (i as f64 * step).powi(2))
                .max(0.0)
                .sqrt()
        })
        .collect();
    let around =
        |i: usize| (0..=2 * reach).map(move |k| ((i + n * 2 + k - reach) % n, k.abs_diff(reach)));
    // Lowest centre of a disc above i that does not touch the heights, then the lowest disc over
    // each position.
    let centres: Vec<f64> = (0..n)
        .map(|i| {
            around(i)
                .map(|(j, d)| sign * heights[j] + disc[d])
                .fold(f64::NEG_INFINITY, f64::max)
        })
        .collect();
    (0..n)
        .map(|i| {
            let lowest = around(i)
                .map(|(j, d)| centres[j] - disc[d])
                .fold(f64::INFINITY, f64::min);
            if lowest - sign * heights[i] > touches {
                sign * lowest
            } else {
                heights[i]
            }
        })
        .collect()
}

/// Corners of a sampled period; samples on a straight line between others are removed.
fn without_needless(samples: &[Corner], step: f64) -> Vec<Corner> {
    let n = samples.len();
    (0..n)
        .filter(|&i| {
            let (before, after) = (&samples[(i + n - 1) % n], &samples[(i + 1) % n]);
            let bend = before.z - 2.0 * samples[i].z + after.z;
            i == 0 || bend.abs() > 1e-9 * step || before.bowed != samples[i].bowed
        })
        .map(|i| samples[i])
        .collect()
}

fn plus(a: (f64, f64), length: f64, direction: (f64, f64)) -> (f64, f64) {
    (a.0 + length * direction.0, a.1 + length * direction.1)
}

/// One sharp ridge: crest at (0, 0), down the facet, up the riser.
struct Edges {
    /// Unit vector down the facet.
    down: (f64, f64),
    /// Unit vector up the riser.
    up: (f64, f64),
    pitch: f64,
    period: f64,
    /// Angle by which the profile turns at an edge.
    turn: f64,
    largest_round: f64,
}

impl Edges {
    fn of(ridges: &WornRidges) -> Self {
        let (sin, cos) = ridges.theta_r.sin_cos();
        let (lean, height) = (ridges.theta_r + ridges.draft).sin_cos();
        let riser = ridges.pitch * sin / height;
        let turn = std::f64::consts::FRAC_PI_2 - ridges.draft;
        // A rounding removes R tan(turn/2) from both sides of its edge.
        let largest_round = 0.5 * ridges.pitch.min(riser) / (0.5 * turn).tan();
        Edges {
            down: (cos, -sin),
            up: (lean, height),
            pitch: ridges.pitch,
            period: ridges.pitch * cos + riser * lean,
            turn,
            largest_round,
        }
    }

    /// Width of a burr divided by its height: its flank must end beyond the tip.
    fn slant(&self) -> f64 {
        (1.05 * self.up.0 / self.down.0).max(1.0)
    }

    /// Height of the tallest burr that fits on its facet.
    fn burr_max(&self) -> f64 {
        BURR_SHARE_MAX * self.pitch / self.slant()
    }

    fn foot(&self) -> (f64, f64) {
        plus((0.0, 0.0), self.pitch, self.down)
    }

    /// The corner between the directions `a` and `b`, rounded.
    fn edge(
        &self,
        corners: &mut Vec<Corner>,
        corner: (f64, f64),
        a: (f64, f64),
        b: (f64, f64),
        round: f64,
    ) {
        if round == 0.0 {
            corners.push(Corner::sharp(corner));
            return;
        }
        let (sin, cos) = self.turn.sin_cos();
        // Perpendicular to a, towards b.
        let across = ((b.0 - a.0 * cos) / sin, (b.1 - a.1 * cos) / sin);
        let start = plus(corner, -round * (0.5 * self.turn).tan(), a);
        for step in 0..=ARC {
            let (s, c) = (self.turn * step as f64 / ARC as f64).sin_cos();
            let (v, z) = plus(plus(start, round * s, a), round * (1.0 - c), across);
            let bowed = step < ARC;
            corners.push(Corner { v, z, bowed });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ridges() -> WornRidges {
        WornRidges::ideal(15f64.to_radians(), 10.0)
    }

    #[test]
    fn without_wear_the_profile_is_the_sawtooth() {
        let plain = ridges().profile().unwrap();
        let sawtooth = SurfaceProfile::sawtooth(15f64.to_radians(), 10.0, 0.0).unwrap();
        assert!((plain.period() - sawtooth.period()).abs() < 1e-12);
        for (a, b) in plain.pieces().iter().zip(sawtooth.pieces()) {
            assert!((a.to - b.to).abs() < 1e-12 && (a.z_to - b.z_to).abs() < 1e-12);
        }
        let round = WornRidges {
            round: 0.4,
            ..ridges()
        }
        .profile()
        .unwrap();
        let other = SurfaceProfile::sawtooth(15f64.to_radians(), 10.0, 0.4).unwrap();
        assert_eq!(round.pieces().len(), other.pieces().len());
        for (a, b) in round.pieces().iter().zip(other.pieces()) {
            assert!((a.from - b.from).abs() < 1e-12 && (a.z_from - b.z_from).abs() < 1e-12);
        }
    }

    #[test]
    fn a_draft_only_tilts_the_riser() {
        let draft = 6f64.to_radians();
        let profile = WornRidges { draft, ..ridges() }.profile().unwrap();
        let [facet, riser] = profile.pieces() else {
            panic!("two pieces")
        };
        let angle = facet.normal[1].atan2(facet.normal[2]);
        assert!((angle - 15f64.to_radians()).abs() < 1e-12);
        // The riser's normal leans back by 90° minus θr and draft.
        let lean = -riser.normal[1].atan2(riser.normal[2]);
        assert!((lean - (75f64 - 6.0).to_radians()).abs() < 1e-12);
        let too_much = 80f64.to_radians();
        assert!(
            WornRidges {
                draft: too_much,
                ..ridges()
            }
            .profile()
            .is_err()
        );
    }

    #[test]
    fn a_large_disc_flattens_the_ridge_and_a_small_one_gives_the_arcs() {
        let area = |p: &SurfaceProfile| -> f64 {
            let under = |q: &crate::trace::surfaces::surface_profile::Piece| {
                0.5 * (q.z_from + q.z_to) * (q.to - q.from)
            };
            p.pieces().iter().map(under).sum::<f64>() / p.period()
        };
        // Just below and above the radius at which the arcs meet, both methods agree.
        let limit = 0.5 * 10.0 * 15f64.to_radians().tan();
        let arcs = WornRidges {
            round: 0.999 * limit,
            ..ridges()
        }
        .profile()
        .unwrap();
        let rolled = WornRidges {
            round: 1.001 * limit,
            ..ridges()
        }
        .profile()
        .unwrap();
        assert!((area(&arcs) - area(&rolled)).abs() < 0.01);
        let height = |p: &SurfaceProfile| p.range().1 - p.range().0;
        assert!((height(&arcs) - height(&rolled)).abs() < 0.01 * height(&arcs));
        let worn = WornRidges {
            round: 4.0 * limit,
            ..ridges()
        }
        .profile()
        .unwrap();
        assert!(height(&worn) < 0.7 * height(&arcs));
        let angle = worn.effective_ridge_angle().unwrap().to_degrees();
        assert!((2.0..15.0).contains(&angle), "{angle}");
    }

    #[test]
    fn points_below_the_resolution_are_left_out() {
        for tiny in [1e-300, 1e-18, 1e-14, 1e-11, 1e-8] {
            let all = [
                WornRidges {
                    theta_r: tiny,
                    ..ridges()
                },
                WornRidges {
                    theta_r: tiny,
                    round: 0.1,
                    ..ridges()
                },
                WornRidges {
                    round: tiny,
                    ..ridges()
                },
                WornRidges {
                    burr: tiny,
                    ..ridges()
                },
                WornRidges {
                    draft: tiny,
                    ..ridges()
                },
            ];
            for shape in all {
                let profile = shape.profile().unwrap();
                let pieces = profile.pieces();
                assert!(pieces.iter().all(|p| p.to > p.from), "{shape:?}");
                let last = pieces[pieces.len() - 1].to - pieces[0].from;
                assert!((last / profile.period() - 1.0).abs() < 1e-12, "{shape:?}");
            }
        }
    }

    #[test]
    fn burrs_are_on_the_crests_and_depend_on_their_seed() {
        let with = |seed| {
            WornRidges {
                burr: 0.2,
                seed,
                ..ridges()
            }
            .profile()
            .unwrap()
        };
        let (a, b) = (with(1), with(2));
        assert_eq!(a, with(1));
        assert_ne!(a, b);
        let plain = ridges().profile().unwrap();
        assert!(a.range().1 > plain.range().1 + 0.2);
        // Exponential heights along the riser, truncated: mean 0.2 within 5 standard errors.
        let n = BURRED_RIDGES as f64;
        let tips = a
            .pieces()
            .iter()
            .map(|p| p.z_from)
            .filter(|z| *z > 0.0)
            .sum::<f64>()
            / n;
        let expected = 0.2 * 15f64.to_radians().cos();
        assert!(
            (tips - expected).abs() < 5.0 * expected / n.sqrt(),
            "{tips}"
        );
    }
}
