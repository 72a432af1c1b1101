//! Observations in which poses or flats that are wrong count less.
//!
//! One shaded pose, or a run of them, would pass for a model error of all poses and enlarge every uncertainty. Where such poses
//! explain most of χ² ([`super::bad_poses`]), each gets the standard uncertainty that its own deviation shows, and everything is
//! fitted again. The finding names them.
//!
//! Flats have a small scatter, and the model error of the sample is estimated from its residuals. Flats that contradict the sample
//! would therefore win, and all ends of the search would be at the tilt that the flats demand. Where the model error is one that
//! ridges never have ([`LOUD`]), everything is fitted again with flats that need not follow a Lambertian surface.

use super::bad_poses::{bad_block, bad_poses};
use super::findings::{Code, Finding};
use crate::fit::estimate::Estimate;
use crate::fit::model_discrepancy::LOUD;
use crate::fit::report::build::causes;
use crate::observation::ObservationSet;

/// Returns the observations with less weight for the poses that are wrong, and the finding that names them; `None` if there are
/// none.
pub(in crate::fit) fn of(e: &Estimate<'_>) -> Option<(ObservationSet, Finding)> {
    // An investigation has tried them beside the properties of the surface.
    if e.poses_tried {
        return None;
    }
    let poses = bad_poses(e).filter(|found| found.explains > causes::EXPLAINS);
    let (wrong, finding) = match poses {
        Some(found) => (found.observations.clone(), causes::of_poses(e, &found)),
        None => {
            let found = bad_block(e)?;
            (found.observations.clone(), causes::of_block(e, &found))
        }
    };
    let off = e.problem.signal_residuals(&e.values);
    let mut set = e.problem.set().clone();
    for i in wrong {
        let o = &mut set.observations[i];
        o.sigma = o.sigma.hypot(off[i]);
    }
    Some((set, finding))
}

/// Standard uncertainty, as a share of the signal, of a flat whose dependence on the tilt is not that of a Lambertian surface.
const NOT_LAMBERTIAN: f64 = 0.02;

/// Returns the observations with less weight for the flats, and the finding that names them; `None` if the model error gives no
/// reason, or there are no flats.
pub(in crate::fit) fn of_flats(e: &Estimate<'_>) -> Option<(ObservationSet, Finding)> {
    let set = e.problem.set();
    if set.flats.is_empty() || e.discrepancy <= LOUD {
        return None;
    }
    let mut lighter = set.clone();
    for (flat, sigma) in lighter.flats.iter_mut().zip(without_shape(set)) {
        flat.sigma = sigma;
    }
    let finding = Finding {
        code: Code::WhiteReference,
        explains: 0.0,
        change_of_theta_r_deg: None,
        advice: white_reference(),
    };
    Some((lighter, finding))
}

/// Standard uncertainties of the flats of a white reference that is not Lambertian.
pub(in crate::fit) fn without_shape(set: &ObservationSet) -> Vec<f64> {
    let flats = set.flats.iter();
    flats
        .map(|f| f.sigma.hypot(NOT_LAMBERTIAN * f.signal))
        .collect()
}

/// What the user should do about such a reference.
pub(in crate::fit) fn white_reference() -> String {
    format!(
        "The flats depend on the tilt otherwise than a Lambertian surface at the stated angles; the fit gives each of them a \
         standard uncertainty of {:.0} %. Check that the white reference is level, clean and larger than the field, and \
         compare its certificate at these angles.",
        100.0 * NOT_LAMBERTIAN
    )
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;
    use std::sync::atomic::AtomicBool;

    use super::*;
    use crate::fit::painted::{TRUTH, painted};
    use crate::fit::report::FitReport;
    use crate::fit::{FitOptions, VariantChoice, fit};
    use crate::geometry::Pose;
    use crate::observation::FlatObservation;
    use crate::units::Angle;

    fn fitted(set: &ObservationSet) -> FitReport {
        let options = FitOptions {
            variant: VariantChoice::Sawtooth,
            ..FitOptions::default()
        };
        fit(set, &options, &AtomicBool::new(false))
    }

    /// Seven tilts at eight azimuths, one pose per minute.
    fn series() -> ObservationSet {
        let poses =
            (0..56).map(|k| Pose::from_deg(f64::from(k / 8) * 7.0 - 21.0, f64::from(k % 8) * 45.0));
        let mut set = painted(poses, &TRUTH, 3e-4, 9);
        for (k, o) in set.observations.iter_mut().enumerate() {
            o.taken_s = Some(60.0 * k as f64);
        }
        set
    }

    #[test]
    fn poses_that_are_wrong_are_named_and_do_not_enlarge_the_uncertainty() {
        let clean = series();
        let expanded = |report: &FitReport| report.parameters.theta_r_deg.expanded.unwrap();
        let without = expanded(&fitted(&clean));
        let brightest = (0..56).max_by(|a, b| {
            let signal = |k: &usize| clean.observations[*k].signal;
            signal(a).total_cmp(&signal(b))
        });
        let (flank, run) = (brightest.unwrap() + 8, 20..28);
        for (code, spoilt, factor) in [
            (Code::BadPose, flank..flank + 1, 0.7),
            (Code::BadBlock, run, 0.95),
        ] {
            let mut set = clean.clone();
            for o in &mut set.observations[spoilt] {
                o.signal *= factor;
            }
            let report = fitted(&set);
            let codes: Vec<Code> = report.findings.iter().map(|f| f.code).collect();
            assert_eq!(codes, [code], "{:?}", report.findings);
            let theta_r = &report.parameters.theta_r_deg;
            let away = theta_r.value.unwrap() - TRUTH.theta_r.to_degrees();
            assert!(away.abs() < expanded(&report), "{away}");
            // A run takes a seventh of the poses out of the fit.
            let allowed = if code == Code::BadPose {
                2.0 * without
            } else {
                0.3
            };
            assert!(expanded(&report) < allowed, "{code:?} {without}");
        }
    }

    #[test]
    fn flats_that_contradict_the_sample_do_not_choose_its_minimum() {
        let mut set = series();
        let flats = (-3..=3).map(|n| {
            let theta_c = Angle::from_deg(7.0 * f64::from(n));
            let lambertian = 0.99 / PI * set.rig.cos_incidence(theta_c);
            FlatObservation {
                theta_c,
                signal: lambertian * (1.0 - 0.02 * f64::from(n) / 3.0),
                sigma: 3e-5 * lambertian,
                times_s: Vec::new(),
            }
        });
        set.flats = flats.collect();
        let report = fitted(&set);
        assert_eq!(report.findings[0].code, Code::WhiteReference);
        let theta_r = &report.parameters.theta_r_deg;
        let (away, u) = (
            theta_r.value.unwrap() - TRUTH.theta_r.to_degrees(),
            theta_r.expanded.unwrap(),
        );
        assert!(away.abs() < 1.5 * u && u < 0.2, "{away} {u}");
    }
}
