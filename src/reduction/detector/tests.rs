//! The curve by itself: its form, and the fit of visits whose truth is known.

use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;

use super::shares::Share;
use super::*;

const FULL: f64 = 65335.0;

#[test]
fn the_curve_and_its_inverse_are_each_others() {
    for c in [-0.2, -0.03, 0.0, 1e-12, 0.02, 0.06, 0.1, 0.2] {
        let curve = Curve { c, full_dn: FULL };
        for linear in [-30.0, 0.0, 1.0, 500.0, 2e4, 6e4] {
            let back = curve.linear(curve.counted(linear));
            assert!((back - linear).abs() < 1e-9 * FULL, "{c} {linear} {back}");
            let step = 1e-6;
            let other = Curve {
                c: c + step,
                full_dn: FULL,
            };
            let counted = curve.counted(linear);
            let by_c = (other.linear(counted) - linear) / step;
            assert!(
                (by_c - linear * curve.per_c(linear)).abs() < 1e-4 * FULL,
                "{c} {linear}"
            );
        }
        // Nothing that a file can hold makes it no number.
        assert!(
            curve.linear(65535.0).is_finite() && curve.counted(f64::INFINITY) < f64::INFINITY
                || c <= 0.0
        );
    }
}

/// Visits by exposures of 0.05 and 0.2 s, signals between `levels`, with flicker.
fn visits(levels: &[f64], c: f64, kappa: f64, flicker: f64, seed: u64) -> (Vec<Visit>, CurvePrior) {
    let curve = Curve { c, full_dn: FULL };
    visits_by(levels, |linear| curve.counted(linear), kappa, flicker, seed)
}

/// The same of a camera with any curve.
fn visits_by(
    levels: &[f64],
    counted: impl Fn(f64) -> f64,
    kappa: f64,
    flicker: f64,
    seed: u64,
) -> (Vec<Visit>, CurvePrior) {
    let mut rng = rand_pcg::Pcg64::seed_from_u64(seed);
    let known = CurvePrior {
        full_dn: FULL,
        times_s: vec![0.05, 0.2],
        time_std: 1e-3,
        dark_std_dn: 0.4,
    };
    let visit = |level: &f64| {
        let mut one = |time: usize, linear: f64| {
            let linear = linear * (1.0 + flicker * rng.sample::<f64, _>(StandardNormal));
            let counts = counted(linear);
            let n = 4096.0;
            FrameLevels {
                time,
                bins: vec![[n, n * counts]],
                variance: 2.0 / (n * counts),
            }
        };
        vec![one(0, level / 4.0), one(1, level * (1.0 + kappa))]
    };
    (levels.iter().map(visit).collect(), known)
}

fn spread(n: usize, low: f64, high: f64) -> Vec<f64> {
    let at = |k: usize| low * (high / low).powf(k as f64 / (n - 1) as f64);
    (0..n).map(at).collect()
}

fn detector(visits: &[Visit], known: &CurvePrior, stated: Option<f64>) -> Detector {
    let known = CurvePrior {
        time_std: stated.unwrap_or(known.time_std),
        ..known.clone()
    };
    Detector::of(visits, &known, &known.times_s, stated)
}

#[test]
fn a_curve_is_reported_within_its_uncertainty_and_a_straight_one_is_not() {
    let mut squares = 0.0;
    let curves = [-0.1, -0.02, 0.02, 0.06, 0.1];
    for (seed, c) in curves.into_iter().enumerate() {
        let (visits, known) = visits(&spread(40, 4e3, 6e4), c, 0.0, 3e-4, seed as u64);
        let reported = detector(&visits, &known, None).bent.expect("a curve");
        assert!((reported.c - c).abs() < 0.002, "{c}: {reported:?}");
        assert!(
            reported.explains > 0.9 && reported.pairs == 40,
            "{reported:?}"
        );
        squares += ((reported.c - c) / reported.std).powi(2);
    }
    assert!(squares < 15.0, "{squares} for 5");
    for seed in 0..40 {
        let (visits, known) = visits(&spread(40, 4e3, 6e4), 0.0, 0.0, 3e-4, 100 + seed);
        let found = detector(&visits, &known, None);
        assert!(
            found.bent.is_none() && found.correction(0.2).is_none(),
            "{found:?}"
        );
        assert!(found.shares(&[vec![]], &[])[0] == 0.0);
    }
}

#[test]
fn a_curve_of_another_form_is_less_certain() {
    let found = |counted: &dyn Fn(f64) -> f64| {
        let (visits, known) = visits_by(&spread(40, 4e3, 6e4), counted, 0.0, 3e-4, 3);
        detector(&visits, &known, None).bent.expect("a curve")
    };
    let of_this = found(&|e| e * (1.0 - 0.05 * e / FULL));
    let saturating = |e: f64| 2.0 * FULL * (0.5 * e / FULL).tanh();
    let of_another = found(&saturating);
    assert!(
        of_this.std < 1e-3 && of_another.std > 5.0 * of_this.std,
        "{of_this:?} {of_another:?}"
    );
    // The uncertainty covers what is left after the correction, up to a factor that all signals share.
    let off = |counts: f64| {
        let curve = Curve {
            c: of_another.c,
            full_dn: FULL,
        };
        let linear = curve.linear(saturating(counts));
        ((linear / counts).ln(), curve.per_c(linear) * of_another.std)
    };
    let (low, high) = (off(0.1 * FULL), off(0.8 * FULL));
    assert!(
        (high.0 - low.0).abs() < 2.0 * (high.1 - low.1),
        "{low:?} {high:?}"
    );
}

#[test]
fn few_bright_visits_among_dark_ones_are_no_bad_frames_where_the_curve_has_another_form() {
    let saturating = |e: f64| 2.5 * FULL * (0.4 * e / FULL).tanh();
    let levels = [spread(8, 5.8e3, 1.2e4), spread(4, 4.9e4, 5.9e4)].concat();
    for seed in 0..5 {
        let (visits, known) = visits_by(&levels, saturating, 0.0, 3e-4, seed);
        let found = detector(&visits, &known, None).bent.expect("a curve");
        assert_eq!(found.pairs, 12, "{seed} {found:?}");
        // The correction of a bright pose against a dark one is right within its uncertainty.
        let curve = Curve {
            c: found.c,
            full_dn: FULL,
        };
        let off = |linear: f64| {
            let corrected = curve.linear(saturating(linear));
            (
                (corrected / linear).ln(),
                curve.per_c(corrected) * found.std,
            )
        };
        let (low, high) = (off(0.02 * FULL), off(0.8 * FULL));
        assert!(
            (high.0 - low.0).abs() < 2.0 * (high.1 - low.1),
            "{seed}: {low:?} {high:?}"
        );
    }
}

#[test]
fn a_late_shutter_is_no_curve_and_is_put_right_by_itself() {
    for (kappa, stated) in [
        (0.005, None),
        (-0.005, None),
        (0.005, Some(0.005)),
        (0.03, None),
    ] {
        let (visits, known) = visits(&spread(40, 3e3, 6e4), 0.0, kappa, 3e-4, 5);
        let found = detector(&visits, &known, stated);
        assert!(found.bent.is_none(), "{kappa} {stated:?}: {:?}", found.bent);
        let time = |s: f64| found.correction(s).expect("times are off").time;
        assert!(
            (time(0.2) / time(0.05) - 1.0 - kappa).abs() < 3e-4,
            "{found:?}"
        );
        assert!(found.words().expect("a message").contains("shutter"));
    }
    // With both, the one is not taken for the other.
    let (visits, known) = visits(&spread(40, 3e3, 6e4), 0.06, 0.004, 3e-4, 6);
    let reported = detector(&visits, &known, Some(0.005))
        .bent
        .expect("a curve");
    assert!(
        (reported.c - 0.06).abs() < 3.0 * reported.std && reported.std < 1.5e-3,
        "{reported:?}"
    );
}

#[test]
fn errors_of_exposure_times_that_follow_their_logarithm_may_be_a_power_law() {
    for exponent in [0.92, 1.05] {
        let kappa = (4.0_f64.ln() * (exponent - 1.0)).exp_m1();
        let (visits, known) = visits(&spread(40, 3e3, 6e4), 0.0, kappa, 3e-4, 8);
        let found = detector(&visits, &known, None);
        assert!(found.bent.is_none());
        let law = found.power_law().expect("a power law");
        assert!((law.exponent - exponent).abs() < 5e-4, "{law:?}");
        assert!((law.spread - kappa.abs()).abs() < 0.01 && law.explains > 0.99);
        assert_eq!(Some(law.instead_of), found.words());
    }
    let (visits, known) = visits(&spread(40, 3e3, 6e4), 0.0, 0.0, 3e-4, 8);
    assert_eq!(detector(&visits, &known, None).power_law(), None);
}

#[test]
fn what_shutter_and_curve_would_make_alike_is_not_reported_as_a_curve() {
    // One level: half a per cent of shutter is a curve of 2 % or none.
    let (visits, known) = visits(&[3e4; 20], 0.0, 0.005, 3e-4, 7);
    assert!(detector(&visits, &known, None).bent.is_none());
}

#[test]
fn bad_frames_neither_make_nor_hide_a_curve() {
    for c in [0.0, 0.06] {
        let (mut visits, known) = visits(&spread(30, 4e3, 6e4), c, 0.0, 3e-4, 8);
        for (at, factor) in [
            (3, 0.02),
            (7, 1.2),
            (8, 1.05),
            (15, 4.0),
            (20, 0.9),
            (22, 0.25),
        ] {
            for bin in &mut visits[at][1].bins {
                bin[1] *= factor;
            }
        }
        let reported = detector(&visits, &known, None).bent;
        match c {
            0.0 => assert!(reported.is_none(), "{reported:?}"),
            _ => assert!(
                (reported.expect("a curve").c - c).abs() < 0.002,
                "{reported:?}"
            ),
        }
    }
}

#[test]
fn three_pairs_tell_a_large_curve_and_two_tell_nothing() {
    let (three, known) = visits(&[1e4, 3e4, 6e4], 0.06, 0.0, 3e-4, 9);
    let reported = detector(&three, &known, None)
        .bent
        .expect("three are enough");
    assert!(
        (reported.c - 0.06).abs() < 3.0 * reported.std && reported.std < 0.01,
        "{reported:?}"
    );
    let two = detector(&three[1..], &known, None);
    assert!(two.bent.is_none() && two.correction(0.2).is_none());
}

#[test]
fn what_is_uncertain_of_curve_and_clock_changes_signals_in_proportion() {
    let (visits, known) = visits(&spread(40, 4e3, 6e4), 0.06, 0.0, 3e-4, 10);
    let found = detector(&visits, &known, None);
    let share = |counts_dn: f64| {
        vec![Share {
            exposure_s: 0.05,
            share: 1.0,
            counts_dn,
        }]
    };
    let flats = share(2e4);
    let shares = found.shares(&[share(2e3), share(2e4), share(6e4)], &flats);
    // As bright as the white reference: nothing is between them.
    assert!(shares[1].abs() < 1e-9, "{shares:?}");
    let std = found.bent.expect("a curve").std;
    assert!(
        (shares[2] / std - (6e4 - 2e4) / FULL).abs() < 0.2,
        "{shares:?} {std}"
    );
    assert!(shares[0] < 0.0, "{shares:?}");
    // A clock that is stated to be uncertain, and that no pair tells.
    let clock = Detector::of(&[], &known, &known.times_s, Some(2e-3));
    let long = |s: f64| {
        vec![Share {
            exposure_s: s,
            share: 1.0,
            counts_dn: 1e4,
        }]
    };
    let shares = clock.shares(&[long(0.2), long(0.05)], &long(0.05));
    assert!(
        (shares[0].abs() - 2e-3 * 2.0_f64.sqrt()).abs() < 1e-9 && shares[1].abs() < 1e-9,
        "{shares:?}"
    );
}
