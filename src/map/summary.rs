//! A map in numbers: distributions of its parameters, the shared quantities, defects and flags.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::Map;
use super::defects::{Defect, Lean};
use super::layers::{self, FLAG_NAMES};
use crate::model::LeftOut;
use crate::observation::RejectedFrame;

/// Median and percentiles of a parameter over the pixels that have a value.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, utoipa::ToSchema)]
#[schema(as = MapSpread)]
pub struct Spread {
    /// Median; azimuths are counted around their mean direction.
    pub median: Option<f64>,
    /// 5th percentile.
    pub p5: Option<f64>,
    /// 95th percentile.
    pub p95: Option<f64>,
    /// Median of the pixels' own standard uncertainties.
    pub std_median: Option<f64>,
    /// Standard uncertainty that all pixels have in common (gain, stray light, tilt offset, model error).
    pub std_shared: Option<f64>,
}

/// Shared quantities in a summary; see [`super::Globals`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, utoipa::ToSchema)]
#[schema(as = MapShared)]
pub struct SharedSummary {
    /// Signal units per unit of radiance (the radiance for a lamp irradiance of 1).
    pub gain: f64,
    /// Relative standard uncertainty of the gain, 0.01 for 1 %.
    pub gain_relative_std: f64,
    /// Stray light, in units of radiance.
    pub stray_radiance: f64,
    /// Its standard uncertainty, in units of radiance.
    pub stray_radiance_std: f64,
    /// Offset Δθc to add to a recorded tilt, degrees.
    pub tilt_offset_deg: f64,
    /// Its standard uncertainty, degrees.
    pub tilt_offset_deg_std: f64,
}

/// Seconds per step.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[schema(as = MapTiming)]
pub struct Timing {
    /// Darks, flats, frames read and resampled.
    pub read: f64,
    /// Shared quantities.
    pub settle: f64,
    /// All pixels.
    pub fit: f64,
    /// The fit of the pixels' mean, for which frames are read once more.
    pub mean: f64,
    /// Files.
    pub write: f64,
}

impl Timing {
    /// Returns the sum of each step.
    #[must_use]
    pub fn plus(&self, other: &Timing) -> Timing {
        Timing {
            read: self.read + other.read,
            settle: self.settle + other.settle,
            fit: self.fit + other.fit,
            mean: self.mean + other.mean,
            write: self.write + other.write,
        }
    }
}

/// The object of `map --json`.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
#[schema(as = MapResult)]
pub struct Summary {
    /// Pixels that were fitted.
    pub pixels: usize,
    /// Pixels that have values.
    pub pixels_with_value: usize,
    /// `pixels` over the seconds of the fit, on all cores.
    pub pixels_per_s: f64,
    /// Poses, which are the observations per pixel without masks.
    pub observations_per_pixel: usize,
    /// Evaluations of all observations per fitted pixel.
    pub evaluations_per_pixel: f64,
    /// Seconds per step.
    pub timing_s: Timing,
    /// By layer name; a lean direction has no median where several are common (`lean_directions`).
    pub parameters: BTreeMap<&'static str, Spread>,
    /// What all pixels share.
    pub shared: SharedSummary,
    /// Usual χ² per degree of freedom; pixels' uncertainties are scaled by its square root.
    pub chi2_reduced_usual: f64,
    /// Lean directions that many pixels share.
    pub lean_directions: Vec<Lean>,
    /// Connected areas that differ from the rest, the largest first.
    pub defects: Vec<Defect>,
    /// Pixels per flag.
    pub flags: BTreeMap<&'static str, usize>,
    /// The bit of each flag in `flags.tif`; a pixel's value is the sum of its flags' bits.
    pub flag_bits: BTreeMap<&'static str, u8>,
    /// Files written, relative to the output folder.
    pub files: Vec<String>,
    /// Frames that were rejected.
    pub rejected_frames: Vec<RejectedFrame>,
    /// Warnings for the user.
    pub warnings: Vec<String>,
    /// What the model omits, why, and at which cost.
    pub left_out: Vec<LeftOut>,
    /// Pixels that were not reached within the time limit.
    pub pixels_left_out: usize,
    /// Name and version of the program.
    pub program: String,
}

/// Summarises a map. `files` are as [`write`](super::write::write) returned them.
#[must_use]
pub fn summary(map: &Map, timing: Timing, files: Vec<String>) -> Summary {
    let layers = &map.layers;
    let parameters = layers
        .parameters
        .iter()
        .enumerate()
        .map(|(k, layer)| {
            let [median, p5, p95] = match layer.cyclic {
                // A median between two common directions would be a direction that no pixel has.
                true if map.leans.len() > 1 => [None; 3],
                true => around_the_circle(&layer.values),
                false => percentiles(&sorted(&layer.values)),
            };
            let spread = Spread {
                median,
                p5,
                p95,
                std_median: quantile(&sorted(&layer.std), 0.5),
                std_shared: map
                    .shared_std
                    .filter(|_| layer.values.iter().any(|x| x.is_finite()))
                    .map(|s| s[k]),
            };
            (layer.name, spread)
        })
        .collect();
    let flags = FLAG_NAMES
        .iter()
        .enumerate()
        .map(|(bit, name)| {
            let count = layers.flags.iter().filter(|f| **f >> bit & 1 == 1).count();
            (*name, count)
        })
        .collect();
    let globals = &map.globals;
    Summary {
        pixels: map.pixels_fitted,
        pixels_with_value: (0..layers.flags.len())
            .filter(|p| layers.has_value(*p))
            .count(),
        pixels_per_s: map.pixels_fitted as f64 / timing.fit.max(1e-9),
        observations_per_pixel: map.n_poses,
        evaluations_per_pixel: map.evaluations,
        timing_s: timing,
        parameters,
        shared: SharedSummary {
            gain: globals.gain,
            gain_relative_std: globals.gain_relative_std,
            stray_radiance: globals.stray,
            stray_radiance_std: globals.stray_std,
            tilt_offset_deg: globals.tilt_offset.deg(),
            tilt_offset_deg_std: globals.tilt_offset_std.deg(),
        },
        chi2_reduced_usual: map.birge,
        lean_directions: map.leans.clone(),
        defects: map.defects.clone(),
        flags,
        flag_bits: layers::flag_bits().collect(),
        files,
        rejected_frames: map.rejected_frames.clone(),
        warnings: map.warnings.clone(),
        left_out: map.left_out.clone(),
        pixels_left_out: map.pixels_left_out,
        program: format!("ridged {}", env!("CARGO_PKG_VERSION")),
    }
}

fn sorted(values: &[f32]) -> Vec<f32> {
    let mut finite: Vec<f32> = values.iter().copied().filter(|x| x.is_finite()).collect();
    finite.sort_unstable_by(f32::total_cmp);
    finite
}

/// Returns median, 5th and 95th percentile.
fn percentiles(sorted: &[f32]) -> [Option<f64>; 3] {
    [0.5, 0.05, 0.95].map(|share| quantile(sorted, share))
}

/// As [`percentiles`], for azimuths in degrees, counted from their mean direction: 359.9° is next to 0.1°. The median
/// is in (−180°, 180°]; the percentiles continue from it without a jump.
fn around_the_circle(values: &[f32]) -> [Option<f64>; 3] {
    let finite = || values.iter().copied().filter(|x| x.is_finite());
    let (mut sine, mut cosine) = (0.0, 0.0);
    for value in finite() {
        let (s, c) = f64::from(value).to_radians().sin_cos();
        sine += s;
        cosine += c;
    }
    let mean = sine.atan2(cosine).to_degrees();
    let wrapped = |deg: f64| deg - 360.0 * ((deg - 180.0) / 360.0).ceil();
    let off: Vec<f32> = finite()
        .map(|value| wrapped(f64::from(value) - mean) as f32)
        .collect();
    let [median, p5, p95] = percentiles(&sorted(&off));
    let whole = median.map_or(0.0, |m| wrapped(mean + m) - (mean + m));
    [median, p5, p95].map(|off| off.map(|off| mean + off + whole))
}

fn quantile(sorted: &[f32], share: f64) -> Option<f64> {
    let last = sorted.len().checked_sub(1)?;
    let at = share * last as f64;
    let (low, high) = (sorted[at.floor() as usize], sorted[at.ceil() as usize]);
    let part = at - at.floor();
    Some(f64::from(low) * (1.0 - part) + f64::from(high) * part)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn azimuths_around_any_direction_have_their_median_there() {
        let around = |middle: f32| -> Vec<f32> {
            let off = [-4.0f32, -0.5, -0.25, 0.25, 0.5, 1.0, f32::NAN];
            off.map(|off| (middle + off).rem_euclid(360.0)).to_vec()
        };
        for (middle, said) in [(0.0, 0.0), (90.0, 90.0), (180.0, 180.0), (270.0, -90.0)] {
            let found = around_the_circle(&around(middle)).map(Option::unwrap);
            let plain = percentiles(&sorted(&around(20.0))).map(|p| p.unwrap() - 20.0);
            for (found, plain) in found.into_iter().zip(plain) {
                assert!((found - said - plain).abs() < 1e-4, "{middle}: {found}");
            }
        }
        assert_eq!(around_the_circle(&[f32::NAN]), [None; 3]);
    }
}
