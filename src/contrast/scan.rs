//! Single and mean contrasts of a scan, with their uncertainties.
//!
//! Errors propagate linearly: the derivatives of a contrast with respect to the radiances turn an error of the radiances into
//! an error of the contrast. Noise is independent between observations. Errors of the white reference, lamp drift, detector curve,
//! stray light and stages are common to all poses. Their contributions are summed with their signs and then squared, so
//! they do not average out in a mean.
//!
//! The stages have the errors of a fit's budget: a zero of the tilt and an error along its range, a zero of the rotation and
//! an eccentricity. The effect of the tilt's zero on the white reference is omitted. It is below 1e-4 of the scale, while
//! the certificate of the reference is uncertain by a hundred times as much.
//!
//! An error of the angle between lamp and camera moves the half vector, as tilt and rotation do. Its effect on a lobe
//! follows from the slopes with respect to those. Its effects on shadows and on Fresnel's factor are omitted.

use nalgebra::Vector3;

use super::SampleRadiances;
use super::compared_tilts::{ComparedTilts, off};
use super::slopes::{RadianceSlope, RadianceSlopes, SEPARATE, TILT_REACH, beyond_the_same};
use super::stray_light::StrayLight;
use crate::geometry::{Pose, RigGeometry};
use crate::model::contrast::{Contrast, Exposure, PAIRS, PAPER_AZIMUTHS_DEG};
use crate::observation::ObservationSet;
use crate::units::Angle;

/// Component of a unit vector perpendicular to the tilt plane that rounding leaves for a lamp within that plane.
const IN_PLANE: f64 = 1e-12;
/// Rotation per motion of the lamp above which tilt and rotation move the half vector in the same direction, within the
/// accuracy of the slopes.
const SPANNED: f64 = 300.0;
/// A pair must be brighter than this many standard uncertainties.
const COVERAGE_FACTOR: f64 = 2.0;

/// A contrast with its uncertainty.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ContrastValue {
    /// The contrast, or the mean of several; NaN where all of them are dark.
    pub value: f64,
    /// Its standard uncertainty.
    pub std: f64,
    /// Largest effect of stage errors that `std` does not include, where the slope of a radiance is unknown; infinite where
    /// it has no bound either.
    pub may_cost: f64,
}

/// The formula of a contrast of two radiances.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ContrastKind {
    /// |a − b|.
    Absolute,
    /// |a − b|/(a + b).
    Michelson,
}

/// One pair of azimuths at one tilt: the number of the tilt in [`ComparedTilts::complete`] and that in [`PAIRS`].
pub type ScanPair = (usize, usize);

/// The compared observations of a scan.
#[derive(Debug, Clone)]
pub struct ContrastScan<'a> {
    set: &'a ObservationSet,
    /// Stray light in every signal.
    pub stray: StrayLight,
    radiances: SampleRadiances,
    slopes: RadianceSlopes,
    /// The compared tilts.
    pub turns: ComparedTilts,
}

impl<'a> ContrastScan<'a> {
    /// Takes the stray light from the flats and the slopes from neighbouring poses.
    #[must_use]
    pub fn of(set: &'a ObservationSet) -> Self {
        let stray = StrayLight::of_flats(set);
        let radiances = SampleRadiances::of(set, &stray);
        let poses = poses(set);
        ContrastScan {
            slopes: RadianceSlopes::of_neighbours(&poses, &radiances.values),
            turns: ComparedTilts::of(&poses),
            set,
            stray,
            radiances,
        }
    }

    /// Replaces the slopes. Their unit is that of the radiances: signal over [`ContrastScan::gain`].
    #[must_use]
    pub fn with_slopes(mut self, slopes: RadianceSlopes) -> Self {
        self.slopes = slopes;
        self
    }

    /// Signal per radiance.
    #[must_use]
    pub fn gain(&self) -> f64 {
        self.radiances.gain
    }

    /// All compared pairs.
    #[must_use]
    pub fn pairs(&self) -> Vec<ScanPair> {
        let tilts = 0..self.turns.complete.len();
        tilts
            .flat_map(|tilt| (0..PAIRS.len()).map(move |pair| (tilt, pair)))
            .collect()
    }

    /// The compared radiances, at the azimuths of the paper.
    pub(super) fn exposures(&self) -> Vec<Exposure> {
        let of = |complete: &super::CompleteTilt| {
            let three = complete.three.into_iter().zip(PAPER_AZIMUTHS_DEG);
            let theta_c = complete.theta_c;
            three.map(move |(n, azimuth_deg)| Exposure {
                theta_r: Angle::ZERO,
                theta_c,
                phi_s: Angle::from_deg(azimuth_deg),
                radiance: self.radiances.values[n],
            })
        };
        self.turns.complete.iter().flat_map(of).collect()
    }

    /// Whether a pair is brighter than the uncertainty of noise and stray light. A darker pair has no Michelson contrast.
    #[must_use]
    pub fn is_lit(&self, pair: ScanPair) -> bool {
        let (j, k) = self.two(pair);
        let sum = self.radiances.values[j] + self.radiances.values[k];
        let own = |n: usize| self.set.observations[n].sigma / self.radiances.gain;
        let haze = (self.radiances.per_stray[j] + self.radiances.per_stray[k]) * self.stray.std;
        sum > COVERAGE_FACTOR * own(j).hypot(own(k)).hypot(haze)
    }

    /// The mean contrast of pairs; a Michelson contrast omits dark pairs.
    #[must_use]
    pub fn mean(&self, kind: ContrastKind, pairs: &[ScanPair]) -> ContrastValue {
        let counts = |pair: &&ScanPair| kind == ContrastKind::Absolute || self.is_lit(**pair);
        let pairs: Vec<ScanPair> = pairs.iter().filter(counts).copied().collect();
        if pairs.is_empty() {
            return ContrastValue {
                value: f64::NAN,
                std: f64::NAN,
                may_cost: 0.0,
            };
        }
        let n = pairs.len() as f64;
        let mut slopes = vec![0.0; self.radiances.values.len()];
        let mut value = 0.0;
        for pair in pairs {
            let (j, k) = self.two(pair);
            let (x, y) = (self.radiances.values[j], self.radiances.values[k]);
            let contrast = Contrast::between(x, y);
            let sign = (x - y).signum() / n;
            let (of, by_x, by_y) = match kind {
                ContrastKind::Absolute => (contrast.absolute, 1.0, -1.0),
                // ∂/∂x (x − y)/(x + y) = 2y/(x + y)², ∂/∂y = −2x/(x + y)².
                ContrastKind::Michelson => {
                    let sum = x + y;
                    (
                        contrast.michelson,
                        2.0 * y / sum / sum,
                        -2.0 * x / sum / sum,
                    )
                }
            };
            value += of / n;
            slopes[j] += sign * by_x;
            slopes[k] += sign * by_y;
        }
        let (std, may_cost) = self.errors(&slopes);
        ContrastValue {
            value,
            std,
            may_cost,
        }
    }

    /// Standard uncertainty of a quantity with these derivatives with respect to the radiances, and the largest error that it
    /// does not include.
    fn errors(&self, slopes: &[f64]) -> (f64, f64) {
        let observations = &self.set.observations;
        let steepest = self.steepest_tilt();
        let ends = self.tilts();
        let mut sources = ErrorSources::default();
        for (n, (slope, o)) in slopes.iter().zip(observations).enumerate() {
            if *slope == 0.0 {
                continue;
            }
            let of_signal = slope / self.radiances.gain;
            sources.own(of_signal * o.sigma);
            sources.common[WHITE] += of_signal * o.shared.white_reference;
            // As in a fit, the lamp drifts between the white reference and the sample: one factor for all poses.
            sources.common[DRIFT] += of_signal * o.shared.led_drift;
            sources.common[DETECTOR] += of_signal * o.shared.detector;
            sources.common[STRAY] += slope * self.radiances.per_stray[n] * self.stray.std;
            sources.common[DARK] += of_signal * self.set.dark_std;
            let [tilt_off, turn_off] = self.off(n);
            let along = ends.along(o.pose.theta_c);
            let tilt = AngleError {
                by: o.shared.theta_c_zero.rad(),
                modes: &[(TILT_ZERO, 1.0), (TILT_SCALE, along)],
                off: tilt_off.rad(),
            };
            let (sin, cos) = o.pose.phi_s.sin_cos();
            let turn = AngleError {
                by: o.shared.phi_s_zero.rad(),
                modes: &[(TURN_ZERO, 1.0), (TURN_SIN, sin), (TURN_COS, cos)],
                off: turn_off.rad(),
            };
            sources.moved(*slope, self.slopes.theta_c[n], &tilt, steepest);
            // A rotation moves directions by the sine of their angle from the normal, a tilt moves them one to one.
            let bound = steepest * self.sine_from_normal(o.pose.theta_c);
            sources.moved(*slope, self.slopes.phi_s[n], &turn, bound);
            if let Some(std) = self.set.theta_l_std {
                let lamp = AngleError {
                    by: std.rad(),
                    modes: &[(LAMP, 1.0)],
                    off: 0.0,
                };
                let (by_lamp, bound) = self.by_lamp(n, steepest);
                sources.moved(*slope, by_lamp, &lamp, bound);
                // A brighter white reference makes all radiances look darker.
                sources.common[LAMP] -= of_signal * o.signal * self.reference_by_lamp() * std.rad();
            }
        }
        (sources.std(), sources.may_cost)
    }

    /// The two observations of a pair.
    fn two(&self, (tilt, pair): ScanPair) -> (usize, usize) {
        let three = self.turns.complete[tilt].three;
        let (_, j, k) = PAIRS[pair];
        (three[j], three[k])
    }

    /// Differences of the recorded tilt and azimuth of an observation from those that it represents.
    fn off(&self, n: usize) -> [Angle; 2] {
        let pose = self.set.observations[n].pose;
        let tilts = self.turns.complete.iter();
        let found = tilts
            .filter_map(|c| Some((c, c.three.iter().position(|m| *m == n)?)))
            .next();
        found.map_or([Angle::ZERO; 2], |(complete, azimuth)| {
            [
                beyond_the_same(pose.theta_c - complete.theta_c),
                beyond_the_same(off(pose.phi_s, PAPER_AZIMUTHS_DEG[azimuth])),
            ]
        })
    }

    /// The largest slope with respect to the tilt; infinite where every slope is unknown.
    fn steepest_tilt(&self) -> f64 {
        let known = self.slopes.theta_c.iter().flatten();
        known
            .map(|s| s.value.abs() + s.std)
            .reduce(f64::max)
            .unwrap_or(f64::INFINITY)
    }

    /// Sine of the larger of the angles of lamp and camera from the sample's normal.
    fn sine_from_normal(&self, theta_c: Angle) -> f64 {
        let directions = self.set.rig.rig_directions(theta_c);
        let cosine = directions.incident.z.min(directions.outgoing.z);
        (1.0 - cosine * cosine).max(0.0).sqrt()
    }

    /// Slope of a radiance with respect to the angle between lamp and camera, and a bound of that slope.
    fn by_lamp(&self, n: usize, steepest: f64) -> (Option<RadianceSlope>, f64) {
        let bound = steepest * self.moved_by_lamp(n).1.norm();
        let is_useful = |slope: &RadianceSlope| slope.std < bound;
        let slope = self
            .lamp_slope(n)
            .filter(is_useful)
            .or_else(|| self.lamp_slope_between(n).filter(is_useful))
            .or_else(|| {
                self.slopes.theta_c[n].map(|_| RadianceSlope {
                    value: 0.0,
                    std: bound,
                })
            });
        (slope, bound)
    }

    /// The half vector and its derivative with respect to the angle between lamp and camera.
    fn moved_by_lamp(&self, n: usize) -> (Vector3<f64>, Vector3<f64>) {
        let theta_c = self.set.observations[n].pose.theta_c;
        let directions = self.set.rig.rig_directions(theta_c);
        let sum = directions.incident + directions.outgoing;
        let half = sum.normalize();
        let towards = self.lamp_moves(theta_c);
        (half, (towards - half * half.dot(&towards)) / sum.norm())
    }

    /// That slope from those in tilt and rotation; `None` where these are unknown or move the half vector in one direction.
    fn lamp_slope(&self, n: usize) -> Option<RadianceSlope> {
        let (half, moves) = self.moved_by_lamp(n);
        // A tilt moves (x, y, z) at the rate (z, 0, −x), a rotation at (y, −x, 0).
        let turn = if moves.y.abs() < IN_PLANE {
            0.0
        } else {
            -moves.y / half.x
        };
        let tilt = (moves.x - turn * half.y) / half.z;
        let by_tilt = self.slopes.theta_c[n]?;
        if turn == 0.0 {
            return Some(RadianceSlope {
                value: tilt * by_tilt.value,
                std: (tilt * by_tilt.std).abs(),
            });
        }
        let by_turn = self.slopes.phi_s[n]?;
        (turn.abs() < SPANNED).then(|| RadianceSlope {
            value: tilt * by_tilt.value + turn * by_turn.value,
            std: (tilt * by_tilt.std).hypot(turn * by_turn.std),
        })
    }

    /// That slope interpolated between the nearest tilts on either side at this azimuth.
    fn lamp_slope_between(&self, n: usize) -> Option<RadianceSlope> {
        let poses = |m: usize| self.set.observations[m].pose;
        let nearest = |side: f64| {
            let beside = (0..self.set.observations.len()).filter_map(|m| {
                let away = (poses(m).theta_c - poses(n).theta_c).rad() * side;
                let turned = (poses(m).phi_s - poses(n).phi_s).wrapped().abs();
                let near = away > 0.0 && away <= TILT_REACH.rad() && turned <= SEPARATE;
                Some((away, self.lamp_slope(m).filter(|_| near)?))
            });
            beside.min_by(|a, b| a.0.total_cmp(&b.0))
        };
        let ((below, one), (above, other)) = (nearest(-1.0)?, nearest(1.0)?);
        let (of_one, of_other) = (above / (below + above), below / (below + above));
        let own = (of_one * one.std).hypot(of_other * other.std);
        Some(RadianceSlope {
            value: of_one * one.value + of_other * other.value,
            std: own.hypot(0.5 * (one.value - other.value)),
        })
    }

    /// Relative change of the white reference's brightness per radian between lamp and camera.
    fn reference_by_lamp(&self) -> f64 {
        if self.set.white_reference.is_none() || self.set.flats.is_empty() {
            return 0.0;
        }
        let of = |theta_c| self.lamp_moves(theta_c).z / self.set.rig.cos_incidence(theta_c);
        let flats = self.set.flats.iter().map(|flat| of(flat.theta_c));
        flats.sum::<f64>() / self.set.flats.len() as f64
    }

    /// Derivative of the direction towards the lamp with respect to its angle from the camera: the direction 90° ahead on
    /// its circle.
    fn lamp_moves(&self, theta_c: Angle) -> Vector3<f64> {
        let ahead = RigGeometry {
            theta_l: self.set.rig.theta_l + Angle::from_deg(90.0),
            ..self.set.rig
        };
        ahead.rig_directions(theta_c).incident
    }

    fn tilts(&self) -> TiltRange {
        let tilts = self.set.observations.iter().map(|o| o.pose.theta_c.rad());
        tilts.fold(
            TiltRange {
                low: f64::INFINITY,
                high: f64::NEG_INFINITY,
            },
            |ends, tilt| TiltRange {
                low: ends.low.min(tilt),
                high: ends.high.max(tilt),
            },
        )
    }
}

/// Poses of the observations.
pub(super) fn poses(set: &ObservationSet) -> Vec<Pose> {
    set.observations.iter().map(|o| o.pose).collect()
}

/// The range of tilts, rad.
struct TiltRange {
    low: f64,
    high: f64,
}

impl TiltRange {
    /// Position from −1 at one end to 1 at the other; 0 for a single tilt.
    fn along(&self, tilt: Angle) -> f64 {
        match self.high > self.low {
            true => (2.0 * tilt.rad() - self.low - self.high) / (self.high - self.low),
            false => 0.0,
        }
    }
}

const WHITE: usize = 0;
const DRIFT: usize = 1;
const STRAY: usize = 2;
const TILT_ZERO: usize = 3;
const TILT_SCALE: usize = 4;
const TURN_ZERO: usize = 5;
const TURN_SIN: usize = 6;
const TURN_COS: usize = 7;
/// Recorded angles that differ from those that they represent.
const RECORDED: usize = 8;
const DARK: usize = 9;
const LAMP: usize = 10;
const DETECTOR: usize = 11;
const COMMON: usize = 12;

/// Errors of one angle of one observation.
struct AngleError<'m> {
    /// Standard uncertainty of the angle, rad.
    by: f64,
    /// Indices into [`ErrorSources::common`], with the share of the angle that each source moves.
    modes: &'m [(usize, f64)],
    /// Recorded less nominal, rad.
    off: f64,
}

/// Parts of an uncertainty.
#[derive(Default)]
struct ErrorSources {
    /// Sum of the squares of independent contributions.
    own: f64,
    /// Sums of the common contributions, one per source.
    common: [f64; COMMON],
    may_cost: f64,
}

impl ErrorSources {
    fn own(&mut self, change: f64) {
        self.own += change * change;
    }

    /// An angle that is off, through the slope of the radiance; `bound` stands for an unknown one.
    fn moved(
        &mut self,
        weight: f64,
        slope: Option<RadianceSlope>,
        moved: &AngleError<'_>,
        bound: f64,
    ) {
        let squares = moved.modes.iter().map(|(_, share)| share * share);
        let total = squares.sum::<f64>();
        let reach = (moved.by * total.sqrt()).hypot(moved.off);
        let Some(slope) = slope else {
            // Where nothing moves, not even the unbounded costs.
            if reach > 0.0 && bound > 0.0 {
                self.may_cost += (weight * bound * reach).abs();
            }
            return;
        };
        for (mode, share) in moved.modes {
            self.common[*mode] += weight * slope.value * share * moved.by;
        }
        self.common[RECORDED] += weight * slope.value * moved.off;
        self.own(weight * slope.std * reach);
    }

    fn std(&self) -> f64 {
        let common = self.common.iter().map(|part| part * part).sum::<f64>();
        (self.own + common).sqrt()
    }
}
