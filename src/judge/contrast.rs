//! Measured contrast with its uncertainty, from the observations of a scan.
//!
//! After Luongo et al. 2017, section 4: for each tilt the absolute difference of the signals at φs =
//! 0° and 90°, and at 90° and 180°, and the mean of all of these. The Michelson contrast is also given; it does
//! not depend on the scale. The values are those of [`crate::contrast`], which `ridged contrast` shows: tilts with all three
//! azimuths, corrected for the stray light found in the flats. They do not depend on the model. Only the slopes, which
//! turn stage errors into errors of the radiances, come from the fit.

use super::quantity::{CONTRAST_MEAN, CONTRAST_MICHELSON_MEAN, JudgedQuantity, MeasuredValue};
use crate::contrast::{
    ContrastKind, ContrastScan, ContrastValue, RadianceSlope, RadianceSlopes, angles_left_out,
    missing_poses,
};
use crate::fit::problem::{Problem, Values};
use crate::fit::report::{FitReport, LeftOut, Status, VariantName};
use crate::fit::uncertainty::coverage::coverage_factor;
use crate::geometry::Pose;
use crate::model::Variant;
use crate::observation::ObservationSet;

/// Both mean contrasts with their conditions.
#[derive(Debug, Clone, PartialEq)]
pub struct JudgedContrasts {
    /// [`CONTRAST_MEAN`] and [`CONTRAST_MICHELSON_MEAN`].
    pub quantities: Vec<JudgedQuantity>,
    /// Tilts over which the contrasts are averaged, degrees.
    pub theta_c_deg: Vec<f64>,
    /// Sentences for the user.
    pub warnings: Vec<String>,
    /// Errors that the uncertainties do not include.
    pub left_out: Option<LeftOut>,
}

/// Measures both mean contrasts. `planned` are the poses of all frames of the scan, including frames that could not be
/// used.
#[must_use]
pub fn contrasts(set: &ObservationSet, planned: &[Pose], report: &FitReport) -> JudgedContrasts {
    let scan = ContrastScan::of(set);
    let slopes = fitted_slopes(set, report, scan.gain());
    let scan = match slopes {
        Some(slopes) => scan.with_slopes(slopes),
        None => scan,
    };
    let poses: Vec<Pose> = set.observations.iter().map(|o| o.pose).collect();
    let pairs = scan.pairs();
    let missing = missing_poses(planned, &poses);
    let reason = if !missing.is_empty() {
        Some(format!(
            "no frame could be used at {}; the mean over the remaining poses is not the specified quantity; repeat these poses",
            missing.join("; ")
        ))
    } else if pairs.is_empty() {
        Some("the scan has no tilt with all of the azimuths 0°, 90° and 180°".to_owned())
    } else {
        None
    };
    let mean = |kind| scan.mean(kind, &pairs);
    let (absolute, michelson) = (mean(ContrastKind::Absolute), mean(ContrastKind::Michelson));
    let measured = |known: &ContrastValue, refused: Option<&str>| {
        match (&reason, refused) {
        (Some(reason), _) => Err(reason.clone()),
        (None, Some(refused)) => Err(refused.to_owned()),
        (None, None) if known.may_cost.is_infinite() => Err(
            "the effect of stage errors is unknown, because no neighbouring pose shows how the radiance changes; add poses beside these"
                .to_owned(),
        ),
        (None, None) => Ok(MeasuredValue {
            value: known.value,
            std: known.std,
            coverage_factor: coverage_factor(None),
            degrees_of_freedom: None,
            may_cost: known.may_cost,
        }),
    }
    };
    let unscaled = set.white_reference.is_none().then_some(
        "without a white reference the absolute contrast has an unknown factor; specify contrast_michelson_mean",
    );
    let dark = michelson
        .value
        .is_nan()
        .then_some("every pair of azimuths is darker than the uncertainty of the stray light");
    let turns = &scan.turns;
    JudgedContrasts {
        quantities: vec![
            JudgedQuantity {
                name: CONTRAST_MEAN.to_owned(),
                measured: measured(&absolute, unscaled),
            },
            JudgedQuantity {
                name: CONTRAST_MICHELSON_MEAN.to_owned(),
                measured: measured(&michelson, dark),
            },
        ],
        theta_c_deg: turns.theta_c_deg(),
        warnings: turns
            .left_out()
            .into_iter()
            .chain(turns.substitutions(&poses))
            .collect(),
        left_out: angles_left_out(&[absolute], absolute.value),
    }
}

/// Slopes of the fitted radiances, in the unit of radiances of this gain; `None` where the fit has no result.
fn fitted_slopes(set: &ObservationSet, report: &FitReport, gain: f64) -> Option<RadianceSlopes> {
    if !matches!(
        report.status,
        Status::Converged | Status::AtBound | Status::RankDeficient
    ) {
        return None;
    }
    let p = &report.parameters;
    let (eta, k) = set.material.index();
    let offset = |deg: Option<f64>| deg.unwrap_or(0.0).to_radians();
    let values = Values {
        theta_r: p.theta_r_deg.value?.to_radians(),
        alpha_u: p.alpha_u.value?,
        alpha_v: p.alpha_v.value?,
        rho_d: p.rho_d.value?,
        scale: p.scale.value?,
        background: p.background.value.unwrap_or(0.0),
        azimuth_offset: offset(p.azimuth_offset_deg.value),
        tilt_offset: offset(p.tilt_offset_deg.value),
        eta,
        k,
        ..Values::IDEAL
    };
    // The corrections of the ray tracer hardly change the slopes.
    let variant = match report.variant {
        VariantName::Paper => Variant::Paper,
        VariantName::Sawtooth | VariantName::Traced => Variant::Sawtooth,
    };
    let problem = Problem::new(set, variant, Vec::new(), values);
    let ready = problem.ready(&values);
    let gradients: Vec<_> = (0..set.observations.len())
        .map(|n| problem.gradient(n, &ready))
        .collect();
    let slope = |per_rad: f64| {
        let value = per_rad * values.scale / gain;
        value
            .is_finite()
            .then_some(RadianceSlope { value, std: 0.0 })
    };
    Some(RadianceSlopes {
        theta_c: gradients.iter().map(|g| slope(g.theta_c)).collect(),
        phi_s: gradients.iter().map(|g| slope(g.phi_s)).collect(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::{FitOptions, fit};
    use crate::geometry::RigGeometry;
    use crate::material::Material;
    use crate::observation::{Observation, Prior, RejectedFrame, SharedErrors, WhiteReference};
    use crate::units::Angle;
    use std::sync::atomic::AtomicBool;

    fn set() -> ObservationSet {
        let at = |tilt: f64, azimuth: f64, signal: f64| Observation {
            shared: SharedErrors {
                white_reference: 0.01 * signal,
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
                    // Another tilt without its 180°, and an azimuth without a partner.
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

    fn poses(set: &ObservationSet) -> Vec<Pose> {
        set.observations.iter().map(|o| o.pose).collect()
    }

    /// Contrasts of a scan without a result of a fit.
    fn without_fit(set: &ObservationSet) -> Vec<JudgedQuantity> {
        contrasts(set, &poses(set), &cancelled_fit(set)).quantities
    }

    fn cancelled_fit(set: &ObservationSet) -> FitReport {
        fit(set, &FitOptions::default(), &AtomicBool::new(true))
    }

    #[test]
    fn the_mean_is_over_the_papers_pairs_and_shared_observations_count_once() {
        let found = contrasts(&set(), &poses(&set()), &cancelled_fit(&set()));
        assert_eq!(found.theta_c_deg, [0.0]);
        assert!(found.warnings[0].contains("θc 10.000° (no observation at φs 180°)"));
        let mean = found.quantities[0].measured.clone().unwrap();
        // |0.3 − 0.1|, |0.1 − 0.2| over two.
        assert!((mean.value - 0.15).abs() < 1e-12);
        // 0.1 has slope −1, the other two 1/2; drift and reference are factors of 1 %.
        let own = 0.001 * 1.5_f64.sqrt();
        let expected = (own * own + 2.0 * (0.01 * mean.value).powi(2)).sqrt();
        assert!(
            (mean.std - expected).abs() < 1e-12,
            "{} {expected}",
            mean.std
        );
    }

    #[test]
    fn the_michelson_contrast_depends_on_stray_light_but_not_on_the_scale() {
        let mean = without_fit(&set())[1].measured.clone().unwrap();
        assert!((mean.value - (0.5 + 1.0 / 3.0) / 2.0).abs() < 1e-12);
        let mut brighter = set();
        for o in &mut brighter.observations {
            o.signal *= 7.0;
        }
        let again = without_fit(&brighter)[1].measured.clone().unwrap();
        assert!((again.value - mean.value).abs() < 1e-12);
        let mut hazy = set();
        hazy.background.mean = 0.05;
        let clearer = without_fit(&hazy)[1].measured.clone().unwrap();
        assert!(clearer.value > mean.value);
    }

    #[test]
    fn the_contrast_equals_that_of_the_table_of_contrasts() {
        let (_, report) = crate::contrast::measure(&set()).unwrap();
        let all = serde_json::to_value(report.table.mean.all).unwrap();
        for (quantity, key) in without_fit(&set()).iter().zip(["absolute", "michelson"]) {
            let mean = quantity.measured.clone().unwrap();
            assert_eq!(all[key].as_f64(), Some(mean.value));
            assert_eq!(all[format!("{key}_std")].as_f64(), Some(mean.std));
        }
        assert_eq!(all["theta_c_deg"].as_array().unwrap().len(), 1);
    }

    #[test]
    fn only_a_missing_pose_that_a_pair_needs_prevents_a_mean() {
        let mut damaged = set();
        damaged.rejected_frames = vec![RejectedFrame {
            file: "a.png".to_owned(),
            reason: "unreadable".to_owned(),
            detail: String::new(),
        }];
        let report = cancelled_fit(&damaged);
        let with = |more: (f64, f64)| {
            let mut planned = poses(&damaged);
            planned.push(Pose::from_deg(more.0, more.1));
            contrasts(&damaged, &planned, &report).quantities
        };
        // An azimuth that no pair uses, and a tilt that is incomplete by plan.
        assert!(with((0.0, 30.0))[0].measured.is_ok());
        assert!(with((20.0, 0.0))[0].measured.is_ok());
        for quantity in with((10.0, 180.0)) {
            let why = quantity.measured.unwrap_err();
            assert!(
                why.contains("no frame could be used at θc 10.000°, φs 180.000°"),
                "{why}"
            );
        }
    }

    #[test]
    fn without_reference_or_pairs_there_is_a_reason() {
        let mut relative = set();
        relative.white_reference = None;
        let list = without_fit(&relative);
        assert!(
            list[0]
                .measured
                .clone()
                .unwrap_err()
                .contains("white reference")
        );
        assert!(list[1].measured.is_ok());
        let mut single = set();
        single.observations.truncate(1);
        let list = without_fit(&single);
        assert!(list[1].measured.clone().unwrap_err().contains("azimuths"));
    }

    /// A sample of the model, with all azimuths of the paper at only one tilt.
    fn fitted(zero: Angle, turn: Angle) -> ObservationSet {
        let tilts = (-6..=6).map(|n| 5.0 * f64::from(n));
        let azimuths = (0..12).map(|n| 30.0 * f64::from(n));
        let poses = tilts.flat_map(|tilt| {
            let azimuths = azimuths
                .clone()
                .filter(move |azimuth| tilt == 0.0 || *azimuth != 90.0);
            azimuths.map(move |azimuth| Pose::from_deg(tilt, azimuth))
        });
        let observation = |pose| Observation {
            shared: SharedErrors {
                theta_c_zero: Angle::from_deg(0.02),
                phi_s_zero: Angle::from_deg(0.02),
                ..SharedErrors::default()
            },
            ..Observation::new(pose, 0.0, 1e-5)
        };
        let mut set = ObservationSet {
            white_reference: Some(WhiteReference {
                reflectance: 0.99,
                reflectance_std: 0.0,
            }),
            ..ObservationSet::bare(
                RigGeometry::IN_PLANE,
                Material::exactly(1.54, 0.0),
                poses.map(observation).collect(),
                Prior {
                    mean: 0.0,
                    std: 1e-6,
                },
            )
        };
        let values = Values {
            theta_r: 10.0_f64.to_radians(),
            alpha_u: 0.12,
            alpha_v: 0.12,
            rho_d: 0.34,
            azimuth_offset: turn.rad(),
            tilt_offset: zero.rad(),
            eta: 1.54,
            ..Values::IDEAL
        };
        let signals = Problem::new(&set, Variant::Sawtooth, Vec::new(), values).predicted(&values);
        for (o, signal) in set.observations.iter_mut().zip(signals) {
            o.signal = signal;
        }
        set
    }

    #[test]
    fn a_stage_that_is_off_moves_the_means_by_what_their_uncertainties_say() {
        let zero = Angle::from_deg(0.02);
        let right = fitted(Angle::ZERO, Angle::ZERO);
        let report = fit(&right, &FitOptions::default(), &AtomicBool::new(false));
        let mean = |set: &ObservationSet, n: usize| {
            let list = contrasts(set, &poses(set), &report).quantities;
            list[n].measured.clone().unwrap()
        };
        for n in [0, 1] {
            let known = mean(&right, n);
            let tilted = mean(&fitted(zero, Angle::ZERO), n).value - known.value;
            let turned = mean(&fitted(Angle::ZERO, zero), n).value - known.value;
            let zeros = tilted.hypot(turned);
            assert!(zeros > 1e-4, "{zeros}");
            // The tilt's range adds nothing in its middle, the eccentricity as much as the rotation's zero.
            let ratio = known.std / zeros;
            assert!(ratio > 0.97 && ratio < 1.1, "{} {zeros}", known.std);
            assert_eq!(known.may_cost, 0.0);
        }
    }
}
