//! Measured contrast with its uncertainty, from the observations of a scan.
//!
//! After Luongo et al. 2017, section 4: for each tilt the absolute difference of the signals at φs =
//! 0° and 90°, and at 90° and 180°, and the mean of all of these; the Michelson contrast beside it
//! is free of the scale. Uncertainties: the observations' own noise through the exact derivative
//! of the mean (an observation that two pairs share counts once), the white reference and the lamp's
//! drift as factors on the absolute contrast, the stray light on the Michelson contrast.

use super::{Measured, Quantity};
use crate::fit::report::{COVERAGE_FACTOR, Parameter};
use crate::observation::{Observation, ObservationSet};

/// Mean absolute contrast, in radiance for a lamp irradiance of 1.
pub const CONTRAST_MEAN: &str = "contrast_mean";
/// Mean Michelson contrast.
pub const CONTRAST_MICHELSON_MEAN: &str = "contrast_michelson_mean";

/// Recorded angles closer than this are the same.
const SAME_ANGLE_DEG: f64 = 0.1;
const PAIRS_DEG: [(f64, f64); 2] = [(0.0, 90.0), (90.0, 180.0)];

/// Both mean contrasts; `background` is the fit's stray light.
#[must_use]
pub fn contrasts(set: &ObservationSet, background: &Parameter) -> Vec<Quantity> {
    let pairs = pairs(&set.observations);
    let (absolute, michelson) = if pairs.is_empty() {
        let reason = "the scan has no tilt with azimuths 0° and 90° or 90° and 180°".to_owned();
        (Err(reason.clone()), Err(reason))
    } else {
        (
            absolute(set, &pairs),
            Ok(michelson(set, &pairs, background)),
        )
    };
    vec![
        Quantity {
            name: CONTRAST_MEAN.to_owned(),
            measured: absolute,
        },
        Quantity {
            name: CONTRAST_MICHELSON_MEAN.to_owned(),
            measured: michelson,
        },
    ]
}

/// Indices of the observations that are compared.
fn pairs(observations: &[Observation]) -> Vec<(usize, usize)> {
    let apart_deg = |a: f64, b: f64| ((a - b + 180.0).rem_euclid(360.0) - 180.0).abs();
    let at = |tilt_deg: f64, azimuth_deg: f64| {
        observations.iter().position(|o| {
            (o.pose.theta_c.deg() - tilt_deg).abs() < SAME_ANGLE_DEG
                && apart_deg(o.pose.phi_s.deg(), azimuth_deg) < SAME_ANGLE_DEG
        })
    };
    let mut tilts_deg: Vec<f64> = observations.iter().map(|o| o.pose.theta_c.deg()).collect();
    tilts_deg.sort_by(f64::total_cmp);
    tilts_deg.dedup_by(|a, b| (*a - *b).abs() < SAME_ANGLE_DEG);
    tilts_deg
        .iter()
        .flat_map(|tilt| PAIRS_DEG.map(|(a, b)| Some((at(*tilt, a)?, at(*tilt, b)?))))
        .flatten()
        .collect()
}

fn absolute(set: &ObservationSet, pairs: &[(usize, usize)]) -> Result<Measured, String> {
    let Some(white) = &set.white_reference else {
        return Err(
            "without a white reference the absolute contrast is known up to a factor; specify contrast_michelson_mean"
                .to_owned(),
        );
    };
    let n = pairs.len() as f64;
    let mut slopes = vec![0.0; set.observations.len()];
    let (mut mean, mut drift) = (0.0, 0.0);
    for (a, b) in pairs {
        let difference = set.observations[*a].signal - set.observations[*b].signal;
        let sign = difference.signum();
        mean += difference.abs() / n;
        slopes[*a] += sign / n;
        slopes[*b] -= sign / n;
    }
    for (slope, o) in slopes.iter().zip(&set.observations) {
        drift += slope * o.shared.led_drift;
    }
    let reference = mean * white.reflectance_std / white.reflectance;
    Ok(measured(mean, &[own(set, &slopes), drift, reference]))
}

fn michelson(set: &ObservationSet, pairs: &[(usize, usize)], background: &Parameter) -> Measured {
    // Stray light is in both signals and lowers the contrast; where the fit does not know it, its
    // prior is all there is.
    let (stray, stray_std) = match (background.value, background.std) {
        (Some(value), Some(std)) => (value, std),
        _ => (set.background.mean, set.background.std),
    };
    let n = pairs.len() as f64;
    let mut slopes = vec![0.0; set.observations.len()];
    let (mut mean, mut by_stray) = (0.0, 0.0);
    for (a, b) in pairs {
        let (x, y) = (
            set.observations[*a].signal - stray,
            set.observations[*b].signal - stray,
        );
        let sum = x + y;
        if sum <= 0.0 {
            continue;
        }
        let sign = (x - y).signum();
        mean += (x - y).abs() / sum / n;
        // ∂/∂x (x − y)/(x + y) = 2y/(x + y)², ∂/∂y = −2x/(x + y)².
        let (dx, dy) = (2.0 * sign * y / (sum * sum), -2.0 * sign * x / (sum * sum));
        slopes[*a] += dx / n;
        slopes[*b] += dy / n;
        by_stray -= (dx + dy) / n;
    }
    measured(mean, &[own(set, &slopes), by_stray * stray_std])
}

fn own(set: &ObservationSet, slopes: &[f64]) -> f64 {
    slopes
        .iter()
        .zip(&set.observations)
        .map(|(slope, o)| (slope * o.sigma).powi(2))
        .sum::<f64>()
        .sqrt()
}

fn measured(value: f64, parts: &[f64]) -> Measured {
    Measured {
        value,
        std: parts.iter().map(|p| p * p).sum::<f64>().sqrt(),
        coverage_factor: COVERAGE_FACTOR,
        degrees_of_freedom: None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Pose, RigGeometry};
    use crate::material::Material;
    use crate::observation::{Prior, SharedErrors, WhiteReference};

    fn set() -> ObservationSet {
        let at = |tilt: f64, azimuth: f64, signal: f64| Observation {
            shared: SharedErrors {
                led_drift: 0.01 * signal,
                ..SharedErrors::default()
            },
            ..Observation::new(Pose::from_deg(tilt, azimuth), signal, 0.001)
        };
        ObservationSet {
            white_reference: Some(WhiteReference {
                reflectance: 0.99,
                reflectance_std: 0.0099,
            }),
            ..ObservationSet::bare(
                RigGeometry::IN_PLANE,
                Material::exactly(1.54, 0.0),
                vec![
                    at(0.0, 0.02, 0.30),
                    at(0.0, 90.0, 0.10),
                    at(0.0, 180.0, 0.20),
                    // Another tilt without its 180°, and an azimuth that is nobody's partner.
                    at(10.0, 0.0, 0.50),
                    at(10.0, 89.98, 0.10),
                    at(10.0, 45.0, 9.0),
                ],
                Prior {
                    mean: 0.0,
                    std: 0.002,
                },
            )
        }
    }

    #[test]
    fn the_mean_is_over_the_papers_pairs_and_shared_observations_count_once() {
        let list = contrasts(&set(), &Parameter::unknown("free"));
        let mean = list[0].measured.clone().unwrap();
        // |0.3 − 0.1|, |0.1 − 0.2|, |0.5 − 0.1| over three.
        assert!((mean.value - 0.7 / 3.0).abs() < 1e-12);
        // 0.1 at tilt 0 has slope −2/3, the other four ±1/3; drift and reference are factors of 1 %.
        let own = 0.001 * (4.0_f64 / 9.0 + 4.0 / 9.0).sqrt();
        let expected = (own * own + 2.0 * (0.01 * mean.value).powi(2)).sqrt();
        assert!(
            (mean.std - expected).abs() < 1e-12,
            "{} {expected}",
            mean.std
        );
    }

    #[test]
    fn the_michelson_contrast_is_free_of_the_scale_and_feels_stray_light() {
        let list = contrasts(&set(), &Parameter::unknown("free"));
        let mean = list[1].measured.clone().unwrap();
        assert!((mean.value - (0.5 + 1.0 / 3.0 + 2.0 / 3.0) / 3.0).abs() < 1e-12);
        let mut brighter = set();
        for o in &mut brighter.observations {
            o.signal *= 7.0;
        }
        let again = contrasts(&brighter, &Parameter::unknown("free"));
        assert!((again[1].measured.clone().unwrap().value - mean.value).abs() < 1e-12);
        let mut hazy = set();
        hazy.background.mean = 0.05;
        let clearer = contrasts(&hazy, &Parameter::unknown("free"));
        assert!(clearer[1].measured.clone().unwrap().value > mean.value);
    }

    #[test]
    fn without_reference_or_pairs_there_is_a_reason() {
        let mut relative = set();
        relative.white_reference = None;
        let list = contrasts(&relative, &Parameter::unknown("free"));
        assert!(
            list[0]
                .measured
                .clone()
                .unwrap_err()
                .contains("white reference")
        );
        assert!(list[1].measured.is_ok());
        let mut alone = set();
        alone.observations.truncate(1);
        let list = contrasts(&alone, &Parameter::unknown("free"));
        assert!(list[1].measured.clone().unwrap_err().contains("azimuths"));
    }
}
