//! Options of a fit on series computed from the closed form: losses, held values, priors, intervals, and the budget
//! against propagated distributions.

use std::collections::HashMap;
use std::sync::atomic::AtomicBool;

use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;

use super::budget::uncertainty;
use super::coverage::coverage_factor;
use super::estimate::{Estimate, estimate};
use super::painted::{painted, painted_by};
use super::problem::{Problem, Quantity, Values};
use super::report::{ReferencePlane, VariantName};
use super::reporting::report_of;
use super::solver::{Settings, minimise};
use super::trail::Time;
use super::variants::{Tracer, fit_with_tier, fit_with_tracer};
use super::{Constraint, FitOptions, Loss, VariantChoice};
use crate::geometry::Pose;
use crate::model::Variant;
use crate::observation::{ObservationSet, SharedErrors};
use crate::units::Angle;

const TRUTH: Values = Values {
    theta_r: 0.17,
    alpha_u: 0.12,
    alpha_v: 0.14,
    rho_d: 0.3,
    scale: 1.0,
    background: 0.002,
    azimuth_offset: 0.05,
    tilt_offset: -0.01,
    eta: 1.54,
    k: 0.0,
    real: crate::model::extended::Real::NONE,
};
/// As a share of the brightest observation.
const NOISE: f64 = 1e-3;

struct Draw(rand_pcg::Pcg64);

impl Draw {
    fn new(seed: u64) -> Self {
        Draw(rand_pcg::Pcg64::seed_from_u64(seed))
    }

    fn normal(&mut self) -> f64 {
        self.0.sample(StandardNormal)
    }
}

/// 40 poses of a plastic sample with an absolute scale.
fn series(seed: u64) -> ObservationSet {
    let poses =
        (0..40).map(|k| Pose::from_deg(-20.0 + 10.0 * f64::from(k / 8), 45.0 * f64::from(k % 8)));
    painted(poses, &TRUTH, NOISE, seed)
}

fn options() -> FitOptions {
    FitOptions {
        variant: VariantChoice::Sawtooth,
        starts: 3,
        misfit: false,
        ..FitOptions::default()
    }
}

fn run<'a>(set: &'a ObservationSet, options: &FitOptions) -> Estimate<'a> {
    let cancel = AtomicBool::new(false);
    estimate(set, Variant::Sawtooth, options, None, &cancel).expect("there is a minimum")
}

#[test]
fn a_stated_number_of_starts_limits_a_search() {
    // Without the limit a search extends over the whole box.
    let poses =
        (0..15).map(|k| Pose::from_deg(f64::from(k % 5) * 10.0 - 20.0, f64::from(k / 5) * 90.0));
    let set = painted(poses, &TRUTH, NOISE, 3);
    let tried = |misfit: bool, starts: usize, starts_alone: bool| {
        let asked = FitOptions {
            misfit,
            starts,
            starts_alone,
            ..options()
        };
        run(&set, &asked).starts.tried
    };
    for starts in [1, 3, 20] {
        for misfit in [true, false] {
            let tried = tried(misfit, starts, true);
            assert!((1..=starts).contains(&tried), "{tried} of {starts}");
        }
    }
    assert!(tried(true, 1, false) > 1);
}

#[test]
fn three_outliers_in_ten_do_not_move_a_robust_fit() {
    let mut set = series(1);
    let peak = set
        .observations
        .iter()
        .map(|o| o.signal)
        .fold(0.0, f64::max);
    let mut draw = Draw::new(2);
    for o in set.observations.iter_mut().step_by(10) {
        o.signal += 0.8 * peak;
    }
    for o in set.observations.iter_mut().skip(3).step_by(5) {
        o.signal += peak * (0.2 + 0.2 * draw.normal().abs());
    }
    let error = |loss: Loss| {
        let robust = FitOptions {
            misfit: true,
            loss,
            ..options()
        };
        let e = run(&set, &robust);
        (e.values.folded().theta_r - TRUTH.theta_r)
            .abs()
            .to_degrees()
    };
    let (linear, huber, tukey) = (error(Loss::Linear), error(Loss::Huber), error(Loss::Tukey));
    // A noise of 1e-3 leaves about 0.02°; outliers of half the peak must have a many times larger effect.
    assert!(tukey < 0.1, "{tukey}");
    assert!(huber < 0.5 * linear, "{huber} {linear}");
    assert!(linear > 0.3, "the outliers do harm: {linear}");
}

#[test]
fn without_outliers_a_robust_loss_finds_the_surface_of_least_squares() {
    let truth = Values {
        alpha_u: 0.09,
        alpha_v: 0.24,
        ..TRUTH
    };
    for seed in 0..3 {
        let poses = (0..25)
            .map(|k| Pose::from_deg(-20.0 + 10.0 * f64::from(k / 5), 72.0 * f64::from(k % 5)));
        let set = painted(poses, &truth, 5e-3, seed);
        let by = |loss: Loss| {
            let misfit = true;
            run(
                &set,
                &FitOptions {
                    misfit,
                    loss,
                    ..options()
                },
            )
        };
        let plain = by(Loss::Linear);
        let u = uncertainty(&plain);
        for loss in [Loss::Huber, Loss::Tukey] {
            let robust = by(loss).values.folded();
            for (j, q) in plain.problem.free().iter().enumerate() {
                let off = robust.inner(*q) - plain.values.folded().inner(*q);
                let std = u.budgets[j].combined();
                assert!(
                    off.abs() < 2.0 * std,
                    "seed {seed} {loss:?} {q:?} {off} {std}"
                );
            }
        }
    }
}

#[test]
fn a_held_value_stays_and_has_no_uncertainty() {
    let set = series(3);
    let held = FitOptions {
        constraints: vec![Constraint {
            quantity: Quantity::AlphaU,
            value: 0.12,
            std: 0.0,
        }],
        ..options()
    };
    let report = fit_with_tier(&set, &held, None, &AtomicBool::new(false));
    let p = &report.parameters;
    assert_eq!((p.alpha_u.value, p.alpha_u.std), (Some(0.12), None));
    let theta = p.theta_r_deg.value.expect("it is free");
    assert!((theta - TRUTH.theta_r.to_degrees()).abs() < 0.2);
}

#[test]
fn a_held_gain_is_reported_as_it_was_used() {
    let mut set = series(3);
    set.white_reference = Some(crate::observation::WhiteReference {
        reflectance: 0.99,
        reflectance_std: 0.005,
    });
    let held = FitOptions {
        constraints: vec![Constraint {
            quantity: Quantity::Scale,
            value: 1.1,
            std: 0.0,
        }],
        ..options()
    };
    let report = fit_with_tier(&set, &held, None, &AtomicBool::new(false));
    let scale = &report.parameters.scale;
    assert_eq!((scale.value, scale.std), (Some(1.1), None));
}

#[test]
fn a_prior_pulls_by_its_weight_and_is_in_the_budget() {
    let set = series(4);
    let free = run(&set, &options());
    let j = free
        .problem
        .free()
        .iter()
        .position(|q| *q == Quantity::RhoD);
    let j = j.expect("ρd is free");
    let std = uncertainty(&free).covariance.matrix[(j, j)].sqrt();
    let (value, mean) = (free.values.rho_d, free.values.rho_d + 3.0 * std);
    let with_prior = FitOptions {
        constraints: vec![Constraint {
            quantity: Quantity::RhoD,
            value: mean,
            std,
        }],
        ..options()
    };
    let pulled = run(&set, &with_prior);
    // Two equal weights meet half way, up to the curvature of the model within three deviations.
    let way = (pulled.values.rho_d - value) / (mean - value);
    assert!((way - 0.5).abs() < 0.02, "{way}");
    let budget = uncertainty(&pulled).budgets[j];
    assert!((budget.prior / (0.5 * std) - 1.0).abs() < 0.05);
}

#[test]
fn a_prior_on_an_offset_applies_to_the_zero_of_its_stage() {
    let mut set = series(4);
    for o in &mut set.observations {
        o.shared.theta_c_zero = Angle::from_deg(0.02);
        o.shared.phi_s_zero = Angle::from_deg(0.02);
    }
    let stated = |std: f64| FitOptions {
        constraints: vec![Constraint {
            quantity: Quantity::TiltOffset,
            value: TRUTH.tilt_offset,
            std,
        }],
        ..options()
    };
    let stds = |options: &FitOptions| -> HashMap<Quantity, f64> {
        let e = run(&set, options);
        let budgets = uncertainty(&e).budgets;
        let combined = budgets.iter().map(|budget| budget.combined());
        e.problem.free().iter().copied().zip(combined).collect()
    };
    let known = Angle::from_deg(0.001).rad();
    let before = stds(&options());
    let with_prior = stds(&stated(known));
    for after in [&with_prior, &stds(&stated(0.0))] {
        for other in [Quantity::ThetaR, Quantity::AzimuthOffset] {
            // Slightly more, because no zero then compensates a scale error of the stage; not several times as much.
            assert!(
                after[&other] <= 1.05 * before[&other],
                "{other:?}: {} before, {} knowing more",
                before[&other],
                after[&other]
            );
        }
    }
    let tilt = with_prior[&Quantity::TiltOffset];
    assert!(tilt <= 1.5 * known, "{tilt} for {known}");
    // A statement less accurate than the certificate of the stage does not change it.
    let before = before[&Quantity::TiltOffset];
    let after = stds(&stated(0.5))[&Quantity::TiltOffset];
    assert!((after / before - 1.0).abs() < 0.01, "{before} {after}");
}

#[test]
fn where_the_model_is_linear_profile_and_bootstrap_agree_with_the_budget() {
    let set = series(5);
    let asked = FitOptions {
        profile: true,
        bootstrap: 200,
        ..options()
    };
    let report = fit_with_tier(&set, &asked, None, &AtomicBool::new(false));
    let p = &report.parameters.theta_r_deg;
    let (value, budget) = (p.value.expect("known"), p.budget.expect("known"));
    let half = 2.0 * budget.counting.hypot(budget.background);
    let profile = p.profile.expect("asked for");
    let (lower, upper) = (
        profile.lower.expect("closed"),
        profile.upper.expect("closed"),
    );
    assert!(
        ((value - lower) / half - 1.0).abs() < 0.1,
        "{lower} {value} {half}"
    );
    assert!(
        ((upper - value) / half - 1.0).abs() < 0.1,
        "{upper} {value} {half}"
    );
    let drawn = p.bootstrap.expect("asked for");
    let width = drawn.upper.expect("closed") - drawn.lower.expect("closed");
    // The ends of 95.45 % of 200 draws scatter by 9 % of the half width each; three times that.
    assert!((width / (2.0 * half) - 1.0).abs() < 0.2, "{width} {half}");
}

#[test]
fn the_budget_agrees_with_propagated_distributions() {
    // JCGM 101: draw every source from its distribution, fit, and compare the spread.
    let mut set = series(6);
    for o in &mut set.observations {
        o.shared = SharedErrors {
            white_reference: 0.005 / 0.99 * o.signal,
            led_drift: 0.002 * o.signal,
            detector: 0.0,
            theta_c_zero: Angle::from_deg(0.02),
            phi_s_zero: Angle::from_deg(0.03),
        };
    }
    let e = run(&set, &options());
    let report = report_of(&e, VariantName::Sawtooth);
    let u = uncertainty(&e);
    let bounds = e.problem.bounds();
    let mut draw = Draw::new(7);
    const DRAWS: usize = 300;
    let mut sums = vec![[0.0; 2]; e.problem.free().len()];
    let clean = e.problem.predicted(&e.values);
    for _ in 0..DRAWS {
        let mut drawn = set.clone();
        let gain = 1.0 + 0.005 / 0.99 * draw.normal() + 0.002 * draw.normal();
        let tilt = Angle::from_deg(0.02 * draw.normal());
        let turn = Angle::from_deg(0.03 * draw.normal());
        let (scale, aside) = (
            Angle::from_deg(0.02 * draw.normal()),
            [(); 2].map(|()| Angle::from_deg(0.03 * draw.normal())),
        );
        let tilts = || set.observations.iter().map(|o| o.pose.theta_c.deg());
        let (low, high) = (
            tilts().fold(f64::INFINITY, f64::min),
            tilts().fold(f64::NEG_INFINITY, f64::max),
        );
        for (o, c) in drawn.observations.iter_mut().zip(&clean) {
            o.signal =
                gain * (c - e.values.background) + e.values.background + o.sigma * draw.normal();
            let (along, (sin, cos)) = (
                (2.0 * o.pose.theta_c.deg() - low - high) / (high - low),
                o.pose.phi_s.sin_cos(),
            );
            o.pose.theta_c += tilt + scale * along;
            o.pose.phi_s += turn + aside[0] * sin + aside[1] * cos;
        }
        drawn.background.mean = e.values.background + set.background.std * draw.normal();
        let free = e.problem.free().to_vec();
        let p = Problem::new(&drawn, Variant::Sawtooth, free, e.values);
        let never = AtomicBool::new(false);
        let m = minimise(
            &p,
            &e.minimum.parameters,
            &bounds,
            &Settings::default(),
            &never,
        );
        assert!(m.ending.is_success());
        for (sum, (x, best)) in sums
            .iter_mut()
            .zip(m.parameters.iter().zip(&e.minimum.parameters))
        {
            let d = x - best;
            sum[0] += d;
            sum[1] += d * d;
        }
    }
    for (j, q) in e.problem.free().iter().enumerate() {
        if *q == Quantity::Background {
            // Its budget adds the certificate that defines its scale.
            continue;
        }
        let n = DRAWS as f64;
        let spread = ((sums[j][1] - sums[j][0] * sums[j][0] / n) / (n - 1.0)).sqrt();
        let stated = u.budgets[j].combined();
        // The spread of 300 draws is known to 4 %; four times that.
        assert!(
            (spread / stated - 1.0).abs() < 0.16,
            "{q:?}: {spread} drawn, {stated} stated"
        );
    }
    for (name, p) in report.parameters.named() {
        let k = p.std.map(|_| coverage_factor(p.degrees_of_freedom));
        assert_eq!(p.coverage_factor, k, "{name}");
    }
}

#[test]
fn a_retraced_descent_ends_at_the_minimum_and_a_bootstrap_past_the_time_limit_draws_nothing() {
    let set = series(4);
    let cancel = AtomicBool::new(false);
    let ticks = std::sync::atomic::AtomicU32::new(0);
    // A clock that advances by a second at each reading.
    let now = || f64::from(ticks.fetch_add(1, std::sync::atomic::Ordering::Relaxed));
    let time = Time {
        now: &now,
        limit_s: Some(0.0),
        retrace: true,
    };
    let tracer = Tracer {
        time: Some(time),
        ..Tracer::PLAIN
    };
    let options = FitOptions {
        bootstrap: 50,
        ..options()
    };
    let report = fit_with_tracer(&set, &options, None, &tracer, &cancel);
    let (first, last) = (
        report.iterations.first().unwrap(),
        report.iterations.last().unwrap(),
    );
    assert!(
        report
            .iterations
            .windows(2)
            .all(|w| w[0].seconds < w[1].seconds)
    );
    // The start is many standard uncertainties away, the last accepted step none.
    assert!(first.error > 1.0 && last.error < 1e-6, "{first:?} {last:?}");
    assert!(
        last.cost < 0.1 * first.cost && last.gradient < 1e-6,
        "{last:?}"
    );
    assert!(report.parameters.theta_r_deg.bootstrap.is_none());
    assert!(
        report
            .warnings
            .iter()
            .any(|w| w.contains("within the time"))
    );
}

#[test]
fn a_stated_wedge_is_in_the_budget_and_an_unstated_one_is_listed_as_left_out() {
    let bare = series(5);
    let stated = ObservationSet {
        wedge_std: Some(Angle::from_deg(0.1)),
        ..bare.clone()
    };
    let [without, with] =
        [&bare, &stated].map(|set| fit_with_tier(set, &options(), None, &AtomicBool::new(false)));
    let listed = |r: &super::FitReport| r.left_out.iter().any(|l| l.what.contains("wedge"));
    assert!(listed(&without) && !listed(&with));
    assert_eq!(without.reference_plane, ReferencePlane::Turntable);
    assert_eq!(with.reference_plane, ReferencePlane::Sample);
    // The uncertainty of the azimuth itself excludes the wedge.
    let of = |r: &super::FitReport| r.wedge_across.unwrap().azimuth_std_deg;
    assert!((of(&with) / of(&without) - 1.0).abs() < 1e-9);
    let text = |r: &super::FitReport| super::text::table(r, &super::text::Form::PLAIN);
    assert!(text(&without).contains("refer to the turntable"));
    assert!(text(&with).contains("refer to the plane of the sample"));
    let line = |p: &super::report::Parameter| p.budget.unwrap().wedge;
    let p = &with.parameters;
    assert!((line(&p.theta_r_deg) - 0.1).abs() < 1e-12);
    let theta_r = p.theta_r_deg.value.unwrap().to_radians();
    assert!((line(&p.azimuth_offset_deg) - 0.1 / theta_r.tan()).abs() < 1e-9);
    assert_eq!(line(&p.alpha_u), 0.0);
    let (wide, narrow) = (
        p.theta_r_deg.std.unwrap(),
        without.parameters.theta_r_deg.std.unwrap(),
    );
    assert!((wide - narrow.hypot(0.1)).abs() < 1e-9, "{wide} {narrow}");
}

#[test]
fn a_stated_lamp_angle_error_is_in_the_budget_and_an_unstated_one_is_listed_as_left_out() {
    let fitted =
        |set: &ObservationSet| fit_with_tier(set, &options(), None, &AtomicBool::new(false));
    let bare = series(5);
    let std = 0.2;
    let stated = ObservationSet {
        theta_l_std: Some(Angle::from_deg(std)),
        ..bare.clone()
    };
    let [without, with] = [&bare, &stated].map(fitted);
    let listed = |r: &super::FitReport| {
        r.left_out
            .iter()
            .any(|l| l.what.contains("lamp and camera"))
    };
    assert!(listed(&without) && !listed(&with));
    // The line of the budget equals the result of a fit to the same signals with the lamp moved.
    let moved = fitted(&bare.with_lamp_moved(Angle::from_deg(std)));
    let parameters = |r: &super::FitReport| {
        let p = &r.parameters;
        [&p.theta_r_deg, &p.azimuth_offset_deg, &p.tilt_offset_deg].map(Clone::clone)
    };
    let all = parameters(&without).into_iter().zip(parameters(&with));
    for ((before, after), elsewhere) in all.zip(parameters(&moved)) {
        let line = |p: &super::report::Parameter| p.budget.unwrap().angles;
        let added = (line(&after).powi(2) - line(&before).powi(2))
            .max(0.0)
            .sqrt();
        let shift = (elsewhere.value.unwrap() - before.value.unwrap()).abs();
        assert!((added - shift).abs() < 0.02 * std, "{added} {shift}");
    }
    let tilt = |r: &super::FitReport| r.parameters.tilt_offset_deg.value.unwrap();
    assert!(((tilt(&moved) - tilt(&without)).abs() - 0.5 * std).abs() < 0.05 * std);
}

#[test]
fn only_a_prior_that_the_data_contradict_is_reported() {
    let set = series(5);
    let warned = |mean: f64, std: f64| {
        let options = FitOptions {
            constraints: vec![super::constraints::known("theta_r_deg", mean, std).unwrap()],
            ..options()
        };
        let report = fit_with_tier(&set, &options, None, &AtomicBool::new(false));
        let mut warnings = report.warnings.iter();
        warnings.any(|w| w.contains("contradict the stated θr"))
    };
    let truth = TRUTH.theta_r.to_degrees();
    for std in [0.5, 0.005] {
        assert!(!warned(truth + std, std), "{std}");
        assert!(warned(truth + 20.0 * std + 0.5, std), "{std}");
    }
}

#[test]
fn a_contradicted_prior_does_not_count_as_model_error() {
    let set = series(5);
    let value = |misfit: bool| {
        let prior =
            super::constraints::known("theta_r_deg", TRUTH.theta_r.to_degrees() + 2.0, 0.05);
        let options = FitOptions {
            constraints: vec![prior.unwrap()],
            misfit,
            ..options()
        };
        let report = fit_with_tier(&set, &options, None, &AtomicBool::new(false));
        report.parameters.theta_r_deg.value.unwrap()
    };
    // The data come from the model, so allowing for a model error makes no difference.
    let (free, strict) = (value(true), value(false));
    assert!((free - strict).abs() < 1e-4, "{free} {strict}");
}

#[test]
fn few_poses_that_the_printed_form_explains_select_paper() {
    let poses = [-20.0, -10.0, 0.0, 10.0, 20.0]
        .into_iter()
        .flat_map(|tilt| [0.0, 90.0, 180.0].map(|azimuth| Pose::from_deg(tilt, azimuth)));
    let set = painted_by(Variant::Paper, poses, &TRUTH, 1e-4, 3);
    let cancel = AtomicBool::new(false);
    let report = fit_with_tier(&set, &FitOptions::default(), None, &cancel);
    assert_eq!(report.variant, VariantName::Paper);
    assert_eq!(report.status, super::report::Status::Converged);
    let theta_r = &report.parameters.theta_r_deg;
    let off = (theta_r.value.unwrap() - TRUTH.theta_r.to_degrees()).abs();
    assert!(off < 2.0 * theta_r.expanded.unwrap(), "{theta_r:?}");
    let unexplained = |w: &String| w.contains("No variant explains");
    assert!(!report.notes.iter().any(unexplained), "{:?}", report.notes);
}

#[test]
fn a_search_ended_by_the_time_limit_lists_what_was_left_out() {
    let set = series(5);
    // The first starts are free; the multistart is not.
    let few = ObservationSet {
        observations: set.observations[..24].to_vec(),
        ..set
    };
    let cancel = AtomicBool::new(false);
    let cut_short = |limit_s| {
        let time = Time {
            now: &|| 1.0,
            limit_s: Some(limit_s),
            retrace: false,
        };
        let tracer = Tracer {
            time: Some(time),
            ..Tracer::PLAIN
        };
        let report = fit_with_tracer(&few, &options(), None, &tracer, &cancel);
        let mut left = report.left_out.iter();
        left.any(|l| l.what == "the rest of the search")
    };
    assert!(cut_short(0.0) && !cut_short(2.0));
}
