//! Starts of a multistart.

use super::*;
use crate::fit::painted::{TRUTH, painted};
use crate::fit::search_setup::free_quantities;
use crate::geometry::Pose;
use crate::model::Variant;
use crate::observation::ObservationSet;

/// 40 poses, computed from the truth.
fn series() -> ObservationSet {
    let poses = (0..40).map(|k| (10 * (k % 5) - 20, 45 * (k / 5)));
    let poses = poses.map(|(tilt, turn)| Pose::from_deg(f64::from(tilt), f64::from(turn)));
    ObservationSet {
        white_reference: None,
        ..painted(poses, &TRUTH, 1e-6, 1)
    }
}

#[test]
fn unselected_starts_are_as_bright_as_the_signals_and_cover_the_whole_box() {
    let set = series();
    let (free, fixed) = free_quantities(&set, Variant::Sawtooth);
    let problem = Problem::new(&set, Variant::Sawtooth, free, fixed);
    let starts = plain(&problem, &fixed, 256, 7);
    let signals: f64 = set.observations.iter().map(|o| o.signal).sum();
    for v in &starts {
        let sum: f64 = problem.predicted(v).iter().sum();
        assert!(
            (sum / signals - 1.0).abs() < 1e-9,
            "{v:?}: {sum} of {signals}"
        );
    }
    let spans = [
        (
            0.0,
            62f64.to_radians(),
            (|v| v.theta_r) as fn(&Values) -> f64,
        ),
        (-11f64.to_radians(), 11f64.to_radians(), |v| v.tilt_offset),
        (ALPHA_MIN.ln(), 0.0, |v| v.alpha_u.ln()),
        (ALPHA_MIN.ln(), 0.0, |v| v.alpha_v.ln()),
        (0.0, 0.8, |v| v.rho_d),
    ];
    for (low, high, of) in spans {
        // A tenth of them in each tenth of the span, within the unevenness of 256 Sobol points.
        let mut tenths = [0; 10];
        for v in &starts {
            tenths[(10.0 * (of(v) - low) / (high - low)) as usize] += 1;
        }
        assert!(tenths.iter().all(|n| (20..=32).contains(n)), "{tenths:?}");
    }
    let beside = |v: &&Values| v.azimuth_offset.abs() > 11f64.to_radians();
    let turned = starts.iter().filter(beside).count();
    assert!((30..=43).contains(&turned), "{turned}");
}

#[test]
fn the_rim_reaches_the_steepest_roughest_and_most_offset_surfaces_of_a_fit() {
    let set = series();
    let (free, fixed) = free_quantities(&set, Variant::Sawtooth);
    let problem = Problem::new(&set, Variant::Sawtooth, free, fixed);
    let starts = rim(&problem, &fixed, 256, 7);
    let share = |is: fn(&Values) -> bool| starts.iter().filter(|v| is(v)).count();
    assert!(share(|v| v.theta_r > 0.9 * THETA_R_MAX) > 20);
    assert!(share(|v| v.tilt_offset.abs() > 0.9 * TILT_OFFSET_MAX) > 20);
    assert!(share(|v| v.alpha_u > 1.0 && v.alpha_v > 0.3) > 20);
    assert!(share(|v| v.azimuth_offset.abs() > 90f64.to_radians()) > 50);
    assert!(share(|v| v.alpha_u < 0.01) > 20);
    let bounds = problem.bounds();
    for v in &starts {
        let x = problem.pack(v);
        let within = x.iter().zip(&bounds.lower).zip(&bounds.upper);
        assert!(
            within.into_iter().all(|((x, l), u)| l <= x && x <= u),
            "{v:?}"
        );
    }
}

#[test]
fn starts_keep_what_the_user_holds() {
    let set = series();
    let (mut free, fixed) = free_quantities(&set, Variant::Sawtooth);
    free.retain(|quantity| !matches!(quantity, Quantity::ThetaR | Quantity::AzimuthOffset));
    let fixed = Values {
        theta_r: 0.17,
        azimuth_offset: 0.02,
        ..fixed
    };
    let problem = Problem::new(&set, Variant::Sawtooth, free, fixed);
    let starts = starts(&problem, &fixed, 64, 7);
    for v in &starts {
        assert_eq!((v.theta_r, v.azimuth_offset), (0.17, 0.02));
    }
    let smooth = starts.iter().filter(|v| v.alpha_u < 0.1).count();
    assert!((10..50).contains(&smooth), "{smooth}");
}
