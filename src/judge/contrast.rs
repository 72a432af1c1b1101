//! Measured contrast with its uncertainty, from the observations of a scan.
//!
//! After Luongo et al. 2017, section 4: for each tilt the absolute difference of the signals at φs =
//! 0° and 90°, and at 90° and 180°, and the mean of all of these; the Michelson contrast beside it
//! is free of the scale. Uncertainties: the observations' own noise through the exact derivative
//! of the mean (an observation that two pairs share counts once), the white reference and the lamp's
//! drift as factors on the absolute contrast, the stray light on both: it is in the flats, too.

use super::{Measured, Quantity};
use crate::contrast::{Radiances, Stray, places};
use crate::fit::report::{COVERAGE_FACTOR, Parameter};
use crate::model::contrast::PAIRS;
use crate::observation::{Observation, ObservationSet};

/// Mean absolute contrast, in radiance for a lamp irradiance of 1.
pub const CONTRAST_MEAN: &str = "contrast_mean";
/// Mean Michelson contrast.
pub const CONTRAST_MICHELSON_MEAN: &str = "contrast_michelson_mean";

/// Both mean contrasts; `background` is the fit's stray light.
#[must_use]
pub fn contrasts(set: &ObservationSet, background: &Parameter) -> Vec<Quantity> {
    // Stray light is in both signals and lowers the contrast; where the fit does not know it, the flats may.
    let stray = match (background.value, background.std) {
        (Some(radiance), Some(std)) => Stray { radiance, std },
        _ => Stray::of_flats(set),
    };
    let radiances = Radiances::of(set, &stray);
    let seen = Seen {
        set,
        radiances,
        stray,
        pairs: pairs(&set.observations),
    };
    let reason = match seen.pairs.is_empty() {
        true => Some("the scan has no tilt with azimuths 0° and 90° or 90° and 180°".to_owned()),
        false => lost(set),
    };
    let (absolute, michelson) = match reason {
        Some(reason) => (Err(reason.clone()), Err(reason)),
        None => (seen.absolute(), seen.michelson()),
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
    let places = places(observations);
    let at = |place: (usize, usize)| places.iter().position(|p| *p == Some(place));
    let last = places.iter().flatten().map(|place| place.0).max();
    (0..last.map_or(0, |last| last + 1))
        .flat_map(|tilt| PAIRS.map(|(_, a, b)| Some((at((tilt, a))?, at((tilt, b))?))))
        .flatten()
        .collect()
}

/// Why the mean over the pairs would be another quantity than the one specified: frames were left out, and a tilt lacks
/// a pair that others have.
fn lost(set: &ObservationSet) -> Option<String> {
    if set.rejected_frames.is_empty() {
        return None;
    }
    let observations = &set.observations;
    let places = places(observations);
    let tilt_of = |tilt| {
        places
            .iter()
            .position(|p| matches!(p, Some((t, _)) if *t == tilt))
    };
    let at = |place: (usize, usize)| places.contains(&Some(place));
    let last = places.iter().flatten().map(|place| place.0).max()?;
    PAIRS.iter().find_map(|(name, a, b)| {
        let has = |tilt: &usize| at((*tilt, *a)) && at((*tilt, *b));
        let any = (0..=last).any(|tilt| has(&tilt));
        let lacking = (0..=last).find(|tilt| any && !has(tilt))?;
        let theta_c = observations[tilt_of(lacking)?].pose.theta_c;
        Some(format!(
            "frames were left out, and θc {theta_c} lacks the pair {name}° that other tilts have: the mean of what is left is \
             not the quantity that is specified; take that pose again"
        ))
    })
}

/// What is compared.
struct Seen<'a> {
    set: &'a ObservationSet,
    radiances: Radiances,
    stray: Stray,
    pairs: Vec<(usize, usize)>,
}

impl Seen<'_> {
    fn absolute(&self) -> Result<Measured, String> {
        let Some(white) = &self.set.white_reference else {
            return Err(
                "without a white reference the absolute contrast is known up to a factor; specify contrast_michelson_mean"
                    .to_owned(),
            );
        };
        let n = self.pairs.len() as f64;
        let l = &self.radiances.values;
        let mut slopes = vec![0.0; l.len()];
        let mut mean = 0.0;
        for (a, b) in &self.pairs {
            let sign = (l[*a] - l[*b]).signum();
            mean += (l[*a] - l[*b]).abs() / n;
            slopes[*a] += sign / n;
            slopes[*b] -= sign / n;
        }
        let drift: f64 = slopes
            .iter()
            .zip(&self.set.observations)
            .map(|(slope, o)| slope * o.shared.led_drift / self.radiances.gain)
            .sum();
        let reference = mean * white.reflectance_std / white.reflectance;
        let parts = [self.own(&slopes), drift, reference, self.by_stray(&slopes)];
        Ok(measured(mean, &parts))
    }

    fn michelson(&self) -> Result<Measured, String> {
        let l = &self.radiances.values;
        // Two that are dark once the stray light is off have no contrast: neither 0 nor any other.
        let lit: Vec<(usize, usize)> = self
            .pairs
            .iter()
            .copied()
            .filter(|(a, b)| l[*a] + l[*b] > 0.0)
            .collect();
        if lit.is_empty() {
            return Err("no pair of azimuths is brighter than the stray light".to_owned());
        }
        let n = lit.len() as f64;
        let mut slopes = vec![0.0; l.len()];
        let mut mean = 0.0;
        for (a, b) in lit {
            let (x, y) = (l[a], l[b]);
            let sum = x + y;
            let sign = (x - y).signum();
            mean += (x - y).abs() / sum / n;
            // ∂/∂x (x − y)/(x + y) = 2y/(x + y)², ∂/∂y = −2x/(x + y)².
            slopes[a] += 2.0 * sign * y / (sum * sum) / n;
            slopes[b] += -2.0 * sign * x / (sum * sum) / n;
        }
        Ok(measured(mean, &[self.own(&slopes), self.by_stray(&slopes)]))
    }

    /// The observations' own noise, through slopes per radiance.
    fn own(&self, slopes: &[f64]) -> f64 {
        slopes
            .iter()
            .zip(&self.set.observations)
            .map(|(slope, o)| (slope * o.sigma / self.radiances.gain).powi(2))
            .sum::<f64>()
            .sqrt()
    }

    fn by_stray(&self, slopes: &[f64]) -> f64 {
        let moved: f64 = slopes
            .iter()
            .zip(&self.radiances.per_stray)
            .map(|(slope, per_stray)| slope * per_stray)
            .sum();
        moved * self.stray.std
    }
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
    use crate::observation::{Prior, RejectedFrame, SharedErrors, WhiteReference};

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
    fn a_pair_that_was_lost_leaves_no_mean_and_one_that_was_not_planned_does() {
        let mut damaged = set();
        assert!(
            contrasts(&damaged, &Parameter::unknown("free"))[0]
                .measured
                .is_ok()
        );
        damaged.rejected_frames = vec![RejectedFrame {
            file: "a.png".to_owned(),
            reason: "unreadable".to_owned(),
            detail: String::new(),
        }];
        for quantity in contrasts(&damaged, &Parameter::unknown("free")) {
            let why = quantity.measured.unwrap_err();
            assert!(
                why.contains("θc 10") && why.contains("90–180") || why.contains("90-180"),
                "{why}"
            );
        }
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
