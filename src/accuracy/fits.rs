//! Iterations of the solver: error of the parameters against seconds, on data with an exact truth.

use std::sync::atomic::AtomicBool;
use std::time::Instant;

use nalgebra::{DMatrix, DVector};

use super::{AccuracyPoint, ConvergenceRate};
use crate::cases::{PaintedError, PaintedScan, PaintedSigma, SampleCase};
use crate::fit::least_squares::LeastSquares;
use crate::fit::least_squares::levenberg_marquardt::Settings;
use crate::fit::problem::{Problem, Quantity, Values};
use crate::geometry::{Pose, RigGeometry};
use crate::material::Material;
use crate::model::Variant;

/// Numbers of trial steps after which the error is measured.
const STEPS: [u64; 16] = [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 14, 16, 20, 30];

/// Descents per measurement; the shortest time counts.
const REPEATS: u32 = 20;
/// Error below which only rounding is left.
const ROUNDING: f64 = 1e-12;

pub(super) fn measure(
    cancel: &AtomicBool,
    points: &mut Vec<AccuracyPoint>,
    rates: &mut Vec<ConvergenceRate>,
) {
    for (name, model_error) in [("zero residual", 0.0), ("5 % model error", 0.05)] {
        iterations(name, model_error, cancel, points, rates);
    }
}

fn truth() -> Values {
    Values {
        theta_r: 12f64.to_radians(),
        alpha_u: 0.08,
        alpha_v: 0.11,
        rho_d: 0.3,
        eta: 1.5,
        ..Values::IDEAL
    }
}

fn iterations(
    name: &str,
    model_error: f64,
    cancel: &AtomicBool,
    points: &mut Vec<AccuracyPoint>,
    rates: &mut Vec<ConvergenceRate>,
) {
    let truth = truth();
    let material = Material::Dielectric {
        eta: truth.eta,
        eta_std: 0.0,
    };
    let poses: Vec<Pose> = super::full_scan().poses().collect();
    let scan = PaintedScan {
        rig: RigGeometry::IN_PLANE,
        sample: SampleCase {
            material,
            surface: truth.surface(),
        },
        poses: &poses,
        error: PaintedError::Alternating(model_error),
        sigma: PaintedSigma::Absolute(1e-3),
    };
    let set = scan.observations();
    let free = vec![
        Quantity::ThetaR,
        Quantity::AlphaU,
        Quantity::AlphaV,
        Quantity::RhoD,
        Quantity::AzimuthOffset,
        Quantity::TiltOffset,
    ];
    let problem = Problem::new(&set, Variant::Sawtooth, free, truth);
    let start = Values {
        theta_r: 0.9 * truth.theta_r,
        alpha_u: 0.15,
        alpha_v: 0.15,
        rho_d: 0.2,
        azimuth_offset: 0.05,
        tilt_offset: 0.01,
        ..truth
    };
    let descend =
        |settings: &Settings, from: &Values| problem.descend(&problem.pack(from), settings, cancel);
    // With a model error the minimum differs from the truth, and Newton's method finds it. The kinks of the model divide
    // it into several minima 1e-5 apart; the goal is the one that these descents reach.
    let (goal, reference) = if model_error == 0.0 {
        (problem.pack(&truth), "known truth")
    } else {
        let other = descend(&Settings::default(), &start);
        let minimum = minimum_by_newton(&problem, &other.parameters).0;
        (
            minimum.as_slice().to_vec(),
            "minimum by Newton's method with second derivatives",
        )
    };
    rates.push(if model_error == 0.0 {
        order(name, &problem, &goal)
    } else {
        // The minimum next to the truth; the last steps stay within its kinks.
        let near = descend(&Settings::default(), &truth);
        rate(name, &problem, &near.parameters)
    });
    for polish_steps in [0, 60] {
        let mut errors: Vec<f64> = Vec::new();
        for steps in STEPS {
            let settings = Settings {
                max_iterations: steps,
                polish_steps,
                ..Settings::default()
            };
            // The shortest of several: other work on the machine only adds time.
            let mut seconds = f64::INFINITY;
            let mut found = descend(&settings, &start);
            for _ in 0..REPEATS {
                let started = Instant::now();
                found = descend(&settings, &start);
                seconds = seconds.min(started.elapsed().as_secs_f64());
            }
            let off = found
                .parameters
                .iter()
                .zip(&goal)
                .map(|(a, b)| (a - b).abs());
            let error = off.fold(0.0, f64::max).max(f64::EPSILON / 4.0);
            // Further steps change only rounding errors.
            if errors
                .last()
                .is_some_and(|last| error >= *last && *last < ROUNDING)
            {
                break;
            }
            errors.push(error);
            points.push(AccuracyPoint {
                scene: format!("fit, {name}"),
                method: if polish_steps == 0 {
                    "Levenberg–Marquardt"
                } else {
                    "with Gauss–Newton polish"
                }
                .to_owned(),
                seconds,
                error,
                quantity: "largest error of a parameter (rad, ln α, ρd)".to_owned(),
                reference: reference.to_owned(),
            });
        }
    }
}

/// Residuals and derivatives at a point.
fn at(problem: &Problem<'_>, x: &[f64]) -> (DVector<f64>, DMatrix<f64>) {
    let (m, n) = (problem.n_residuals(), problem.n_parameters());
    let (mut r, mut j) = (vec![0.0; m], vec![0.0; m * n]);
    problem.evaluate(x, &mut r, &mut j);
    (DVector::from_vec(r), DMatrix::from_vec(m, n, j))
}

/// The undamped Gauss–Newton step at a point.
fn newton(problem: &Problem<'_>, x: &DVector<f64>) -> Option<DVector<f64>> {
    let (r, j) = at(problem, x.as_slice());
    (j.transpose() * &j)
        .cholesky()
        .map(|c| c.solve(&(-(j.transpose() * r))))
}

/// Errors of undamped Gauss–Newton steps from near a minimum, in the norm of the derivatives.
fn last_steps(problem: &Problem<'_>, goal: &[f64]) -> Vec<f64> {
    let goal = DVector::from_column_slice(goal);
    let (_, j) = at(problem, goal.as_slice());
    let mut x = goal.map(|g| g + NEAR);
    let mut errors = vec![(&j * (&x - &goal)).norm()];
    for _ in 0..NEAR_STEPS {
        let Some(step) = newton(problem, &x) else {
            break;
        };
        x += step;
        errors.push((&j * (&x - &goal)).norm());
    }
    errors
}

/// Distance from the minimum, in every parameter, at which the last steps begin, and their number.
const NEAR: f64 = 3e-3;
const NEAR_STEPS: usize = 40;

/// Without residuals, convergence is quadratic: the difference of the logarithms of the error doubles in each step.
fn order(name: &str, problem: &Problem<'_>, goal: &[f64]) -> ConvergenceRate {
    let errors = last_steps(problem, goal);
    // The last step whose error rounding (1e-12 of the first) does not hide.
    let floor = 1e-12 * errors[0];
    let found = errors
        .windows(3)
        .take_while(|w| w[2] > floor)
        .last()
        .map(|w| (w[2] / w[1]).ln() / (w[1] / w[0]).ln());
    ConvergenceRate {
        scene: format!("fit, {name}"),
        quantity: "order of the last steps".to_owned(),
        predicted: 2.0,
        found,
    }
}

/// The Hessian of half the cost, by central differences of its gradient.
fn hessian_at(problem: &Problem<'_>, x: &DVector<f64>) -> DMatrix<f64> {
    let gradient = |x: &DVector<f64>| {
        let (r, j) = at(problem, x.as_slice());
        j.transpose() * r
    };
    let (n, step) = (x.len(), 1e-5);
    let mut hessian = DMatrix::zeros(n, n);
    for k in 0..n {
        let (mut up, mut down) = (x.clone(), x.clone());
        up[k] += step;
        down[k] -= step;
        hessian.set_column(k, &((gradient(&up) - gradient(&down)) / (2.0 * step)));
    }
    hessian
}

/// The minimum near a point, and the Hessian there, by Newton's method. It uses second derivatives, so it is independent of
/// the method that is measured.
fn minimum_by_newton(problem: &Problem<'_>, near: &[f64]) -> (DVector<f64>, DMatrix<f64>) {
    let mut minimum = DVector::from_column_slice(near);
    let mut hessian = hessian_at(problem, &minimum);
    for _ in 0..4 {
        let (r, j) = at(problem, minimum.as_slice());
        if let Some(step) = hessian.clone().lu().solve(&(-(j.transpose() * r))) {
            minimum += step;
        }
        hessian = hessian_at(problem, &minimum);
    }
    (minimum, hessian)
}

/// With residuals, Gauss–Newton omits their curvature. Near the minimum each step multiplies the error by
/// I − (JᵀJ)⁻¹H, where H is the Hessian of half the cost; its spectral radius is the asymptotic rate.
fn rate(name: &str, problem: &Problem<'_>, goal: &[f64]) -> ConvergenceRate {
    let (minimum, hessian) = minimum_by_newton(problem, goal);
    let goal = minimum.as_slice();
    let (_, j) = at(problem, goal);
    let normal = j.transpose() * &j;
    let predicted = normal
        .cholesky()
        .map(|c| DMatrix::identity(goal.len(), goal.len()) - c.solve(&hessian))
        .map_or(f64::NAN, |m| {
            let values = m.complex_eigenvalues();
            values.iter().map(|v| v.norm()).fold(0.0, f64::max)
        });
    let errors = last_steps(problem, goal);
    let floor = 1e-8 * errors[0];
    let found = errors
        .windows(2)
        .take_while(|w| w[1] > floor)
        .last()
        .map(|w| w[1] / w[0]);
    ConvergenceRate {
        scene: format!("fit, {name}"),
        quantity: "error of a step over that of the one before".to_owned(),
        predicted,
        found,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_steps_are_quadratic_without_residuals_and_linear_at_the_predicted_rate_with_them() {
        let (mut points, mut rates) = (Vec::new(), Vec::new());
        measure(&AtomicBool::new(false), &mut points, &mut rates);
        let (order, rate) = (&rates[0], &rates[1]);
        assert!((order.found.unwrap() - 2.0).abs() < 0.3, "{order:?}");
        let found = rate.found.unwrap();
        assert!((found / rate.predicted - 1.0).abs() < 0.2, "{rate:?}");
        assert!(
            points
                .iter()
                .all(|p| p.error.is_finite() && p.seconds > 0.0)
        );
    }
}
