//! Options of a fit on series computed from the closed form: losses, held values, priors, intervals, and the budget
//! against propagated distributions.

mod uncertainty;

use std::collections::HashMap;
use std::sync::Mutex;
use std::sync::atomic::AtomicBool;

use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;

use super::convergence_trace::Time;
use super::estimate::Estimate;
use super::least_squares::levenberg_marquardt::Settings;
use super::model_selection::{Tracer, fit_with_tracer, fit_without_higher_order};
use super::one_variant::estimate;
use super::painted::{painted, painted_by};
use super::problem::{Problem, Quantity, Values};
use super::report::build::report_of;
use super::report::{ReferencePlane, VariantName};
use super::uncertainty::budget::uncertainty;
use super::uncertainty::coverage::coverage_factor;
use super::{Constraint, FitOptions, Loss, VariantChoice};
use crate::geometry::Pose;
use crate::model::Variant;
use crate::observation::{Observation, ObservationSet, SharedErrors};
use crate::units::Angle;

const TRUTH: Values = Values {
    theta_r: 0.17,
    alpha_u: 0.12,
    alpha_v: 0.14,
    rho_d: 0.3,
    background: 0.002,
    azimuth_offset: 0.05,
    tilt_offset: -0.01,
    eta: 1.54,
    ..Values::IDEAL
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
    let report = fit_without_higher_order(&set, &held, &AtomicBool::new(false));
    let p = &report.parameters;
    assert_eq!((p.alpha_u.value, p.alpha_u.std), (Some(0.12), None));
    let theta = p.theta_r_deg.value.expect("it is free");
    assert!((theta - TRUTH.theta_r.to_degrees()).abs() < 0.2);
}

#[test]
fn a_higher_order_is_taken_at_the_reported_surface_where_the_model_error_is_left_out() {
    let mut set = series(3);
    let signals = set.observations.iter().map(|o| o.signal);
    let peak = signals.fold(0.0, f64::max);
    // Light that the closed form lacks, and that grows with the angle.
    let light = |theta_r: f64, o: &Observation| peak * 0.6 * theta_r * o.pose.theta_c.rad();
    for o in &mut set.observations {
        o.signal += light(TRUTH.theta_r, o);
    }
    let asked = Mutex::new(Vec::new());
    let higher_order = |problem: &Problem<'_>, values: &Values| {
        let theta_r = values.theta_r.abs();
        asked.lock().expect("nothing panics").push(theta_r);
        let observations = problem.set().observations.iter();
        Some(observations.map(|o| light(theta_r, o)).collect())
    };
    let never = AtomicBool::new(false);
    let found = estimate(
        &set,
        Variant::Sawtooth,
        &options(),
        Some(&higher_order),
        &never,
    );
    let found = found.expect("there is a minimum");
    let steps = &found.higher_order_shift;
    assert!(steps.iter().any(|step| step.abs() > 1e-3), "{steps:?}");
    let asked = asked.into_inner().expect("nothing panics");
    let off = |theta_r: &f64| (theta_r - found.values.theta_r.abs()).abs();
    let nearest = asked.iter().map(off).fold(f64::INFINITY, f64::min);
    assert!(nearest < 2e-4, "{nearest} {asked:?}");
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
    let report = fit_without_higher_order(&set, &held, &AtomicBool::new(false));
    let scale = &report.parameters.scale;
    assert_eq!((scale.value, scale.std), (Some(1.1), None));
}

#[test]
fn a_prior_pulls_by_its_weight_and_is_in_the_budget() {
    let set = series(4);
    let free = run(&set, &options());
    let j = free.problem.column(Quantity::RhoD).expect("ρd is free");
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
fn only_a_prior_that_the_data_contradict_is_reported() {
    let set = series(5);
    let warned = |mean: f64, std: f64| {
        let options = FitOptions {
            constraints: vec![super::constraints::known("theta_r_deg", mean, std).unwrap()],
            ..options()
        };
        let report = fit_without_higher_order(&set, &options, &AtomicBool::new(false));
        let mut warnings = report.warnings.iter();
        warnings.any(|w| w.contains("contradict the stated θr"))
    };
    let truth = TRUTH.theta_r.to_degrees();
    for std in [0.5, 0.005] {
        assert!(!warned(truth + std, std), "{std}");
        assert!(warned(truth + 20.0 * std + 0.5, std), "{std}");
    }
    // Far beyond the scatter, but within the zeros of the stages.
    assert!(!warned(truth + 0.03, 0.001));
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
        let report = fit_without_higher_order(&set, &options, &AtomicBool::new(false));
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
    let report = fit_without_higher_order(&set, &FitOptions::default(), &cancel);
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
