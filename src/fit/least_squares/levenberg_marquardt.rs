//! Bounded trust-region Levenberg–Marquardt as an argmin solver, with a Gauss–Newton polish.
//!
//! Call [`minimise`]. It differs from usual implementations in three points:
//!
//! - *Bounds.* A parameter at its bound whose gradient points outward is held (projected gradient). A step that would
//!   cross a bound is cut there, and the other components are solved for again.
//! - *Polish.* If a step is accepted only when the cost falls, half the digits are lost, because the cost is flat near
//!   the minimum. The end is therefore a run of undamped Gauss–Newton steps by column-scaled QR, accepted while their
//!   length shrinks.
//! - *Status.* Success requires a vanishing step or projected gradient at full rank.
//!
//! Damping follows Moré 1978 (MINPACK's `lmder`): trust region in the norm of the running column scales D, the
//! multiplier μ from Newton's iteration on ‖D p(μ)‖ = Δ, each trial μ by QR of [R; √μ D]. The solver is independent of
//! the reflectance model.
//!
//! *Conditioning.* Steps come from QR of the derivatives, never from normal equations: they are accurate to 1e-16 times
//! the condition number of the Jacobian, not its square. The rank test uses columns scaled to length 1, so a change of
//! units changes no status. Residual and gradient of the last steps are differences of nearly equal numbers, so the end
//! is decided by shrinking steps and not by falling cost.

use std::sync::atomic::AtomicBool;

use argmin::core::Executor;
use nalgebra::DVector;

use super::LeastSquares;
use super::descent::LevenbergMarquardt;
pub use super::minimum::{Bounds, Ending, Minimum, Settings};

/// Minimises `problem` from `start` inside `bounds`.
pub fn minimise<P: LeastSquares>(
    problem: P,
    start: &[f64],
    bounds: &Bounds,
    settings: &Settings,
    cancel: &AtomicBool,
) -> Minimum {
    let solver = LevenbergMarquardt::new(
        problem.n_parameters(),
        problem.n_residuals(),
        bounds.clone(),
        *settings,
        cancel,
    );
    let mut first = start.to_vec();
    bounds.clamp(&mut first);
    let run = Executor::new(problem, solver)
        .configure(|state| state.param(DVector::from_vec(first)).max_iters(u64::MAX))
        .timer(false)
        .run()
        .expect("the solver reports every difficulty as an ending, never as an error");
    run.solver.into_minimum()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// y = a exp(−b t) on exact data, so the minimum is known and the cost there is 0.
    struct Decay {
        times: Vec<f64>,
        values: Vec<f64>,
    }

    impl Decay {
        fn exact(a: f64, b: f64) -> Self {
            let times: Vec<f64> = (0..20).map(|i| 0.25 * f64::from(i)).collect();
            let values = times.iter().map(|t| a * (-b * t).exp()).collect();
            Decay { times, values }
        }
    }

    impl LeastSquares for &Decay {
        fn n_parameters(&self) -> usize {
            2
        }
        fn n_residuals(&self) -> usize {
            self.times.len()
        }
        fn evaluate(&self, p: &[f64], r: &mut [f64], j: &mut [f64]) {
            let m = self.times.len();
            for (i, t) in self.times.iter().enumerate() {
                let e = (-p[1] * t).exp();
                r[i] = p[0] * e - self.values[i];
                j[i] = e;
                j[i + m] = -p[0] * t * e;
            }
        }
    }

    fn run(problem: &Decay, start: [f64; 2], bounds: &Bounds) -> Minimum {
        minimise(
            problem,
            &start,
            bounds,
            &Settings::default(),
            &AtomicBool::new(false),
        )
    }

    #[test]
    fn exact_data_give_the_exact_parameters() {
        let m = run(&Decay::exact(3.0, 0.7), [1.0, 0.1], &Bounds::none(2));
        assert!(m.ending.is_success(), "{m:?}");
        assert!((m.parameters[0] - 3.0).abs() < 1e-14 && (m.parameters[1] - 0.7).abs() < 1e-14);
    }

    #[test]
    fn a_bound_holds_its_parameter_and_the_others_still_converge() {
        let bounds = Bounds {
            lower: vec![0.0, 0.0],
            upper: vec![10.0, 0.5],
        };
        let problem = Decay::exact(3.0, 0.7);
        let m = run(&problem, [1.0, 0.1], &bounds);
        assert_eq!(m.at_bound, vec![1]);
        assert!(m.ending.is_success(), "{:?}", m.ending);
        // With b held at 0.5 the best a is linear: Σ y e / Σ e².
        let (mut top, mut bottom) = (0.0, 0.0);
        for (t, y) in problem.times.iter().zip(&problem.values) {
            let e = (-0.5 * t).exp();
            top += y * e;
            bottom += e * e;
        }
        assert!((m.parameters[0] - top / bottom).abs() < 1e-13);
    }

    #[test]
    fn a_parameter_without_effect_is_not_reported_as_success() {
        struct Idle;
        impl LeastSquares for Idle {
            fn n_parameters(&self) -> usize {
                2
            }
            fn n_residuals(&self) -> usize {
                3
            }
            fn evaluate(&self, p: &[f64], r: &mut [f64], j: &mut [f64]) {
                for i in 0..3 {
                    r[i] = p[0] + p[1] - i as f64;
                    j[i] = 1.0;
                    j[i + 3] = 1.0;
                }
            }
        }
        let m = minimise(
            Idle,
            &[5.0, 1.0],
            &Bounds::none(2),
            &Settings::default(),
            &AtomicBool::new(false),
        );
        assert_eq!(m.ending, Ending::RankDeficient);
    }

    #[test]
    fn a_minimum_on_a_kink_is_found_and_the_other_parameters_converge() {
        /// r = (1 + |x| + y/4, 1 + 2 |x|, y − 3 + x): the cost rises to both sides of x = 0.
        struct Kinked;
        impl LeastSquares for Kinked {
            fn n_parameters(&self) -> usize {
                2
            }
            fn n_residuals(&self) -> usize {
                3
            }
            fn evaluate(&self, p: &[f64], r: &mut [f64], j: &mut [f64]) {
                let side = p[0].signum();
                r.copy_from_slice(&[
                    1.0 + p[0].abs() + 0.25 * p[1],
                    1.0 + 2.0 * p[0].abs(),
                    p[1] - 3.0 + p[0],
                ]);
                j.copy_from_slice(&[side, 2.0 * side, 1.0, 0.25, 0.0, 1.0]);
            }
        }
        let cancel = AtomicBool::new(false);
        let from = |start: [f64; 2]| {
            minimise(
                Kinked,
                &start,
                &Bounds::none(2),
                &Settings::default(),
                &cancel,
            )
        };
        for start in [[0.7, 1.0], [-2.0, 5.0]] {
            let m = from(start);
            assert!(m.ending.is_success(), "{m:?}");
            assert!(m.parameters[0].abs() < 1e-9, "{m:?}");
            // At x = 0: 16 (y − 3) + 4 + y = 0.
            assert!((m.parameters[1] - 44.0 / 17.0).abs() < 1e-8, "{m:?}");
            assert_eq!(m.at_bound, Vec::<usize>::new());
        }
    }

    #[test]
    fn a_minimum_on_a_curved_kink_is_reached_along_it() {
        /// r = (1 + 2 |y − x²|, x − 0.7, y/10 − 0.2): a gorge with its bottom at y = x², where no single parameter
        /// lowers the cost.
        struct Gorge;
        impl LeastSquares for Gorge {
            fn n_parameters(&self) -> usize {
                2
            }
            fn n_residuals(&self) -> usize {
                3
            }
            fn evaluate(&self, p: &[f64], r: &mut [f64], j: &mut [f64]) {
                let (x, y) = (p[0], p[1]);
                let side = (y - x * x).signum();
                r.copy_from_slice(&[1.0 + 2.0 * (y - x * x).abs(), x - 0.7, 0.1 * y - 0.2]);
                j.copy_from_slice(&[-4.0 * side * x, 1.0, 0.0, 2.0 * side, 0.0, 0.1]);
            }
        }
        // Along the bottom: (x − 0.7) + 0.02 x (x² − 2) = 0.
        let (mut low, mut high) = (0.0, 2.0);
        for _ in 0..60 {
            let x: f64 = 0.5 * (low + high);
            match x - 0.7 + 0.02 * x * (x * x - 2.0) > 0.0 {
                true => high = x,
                false => low = x,
            }
        }
        let cancel = AtomicBool::new(false);
        for start in [[-3.0, 2.0], [1.5, -1.0], [0.1, 0.0]] {
            let m = minimise(
                Gorge,
                &start,
                &Bounds::none(2),
                &Settings::default(),
                &cancel,
            );
            assert!(m.ending.is_success(), "{m:?}");
            assert!((m.parameters[0] - low).abs() < 1e-6, "{low} {m:?}");
            assert!((m.parameters[1] - low * low).abs() < 1e-6, "{low} {m:?}");
        }
    }

    #[test]
    fn a_start_without_a_value_is_reported_and_a_cancelled_run_stops() {
        let problem = Decay::exact(3.0, 0.7);
        let m = run(&problem, [f64::NAN, 0.0], &Bounds::none(2));
        assert_eq!(m.ending, Ending::NotFinite);
        let m = minimise(
            &problem,
            &[1.0, 0.1],
            &Bounds::none(2),
            &Settings::default(),
            &AtomicBool::new(true),
        );
        assert_eq!(m.ending, Ending::Cancelled);
    }
}
