//! Numerical kernels of the fit at the limits of doubles: finite input gives a finite result or a named failure.

use std::sync::atomic::AtomicBool;

use proptest::prelude::*;

use super::least_squares::LeastSquares;
use super::least_squares::levenberg_marquardt::{Bounds, Ending, Settings, minimise};
use super::loss::Loss;
use super::subsample::triangle;
use crate::extremes::{any_double, cases};

const ROWS: usize = 5;
const COLUMNS: usize = 3;

/// y − A x.
struct Linear {
    a: Vec<f64>,
    y: Vec<f64>,
}

impl LeastSquares for &Linear {
    fn n_parameters(&self) -> usize {
        COLUMNS
    }
    fn n_residuals(&self) -> usize {
        ROWS
    }
    fn evaluate(&self, x: &[f64], residuals: &mut [f64], jacobian: &mut [f64]) {
        for (i, r) in residuals.iter_mut().enumerate() {
            let sum: f64 = (0..COLUMNS).map(|j| self.a[i + j * ROWS] * x[j]).sum();
            *r = sum - self.y[i];
        }
        jacobian.copy_from_slice(&self.a);
    }
}

proptest! {
    #![proptest_config(cases(300))]

    #[test]
    fn every_transformed_residual_is_finite_and_its_weight_is_from_0_to_1(r in any_double()) {
        for loss in [Loss::Linear, Loss::Huber, Loss::Tukey] {
            let (bent, slope) = loss.bent(r);
            prop_assert!(bent.is_finite() && (0.0..=1.0).contains(&slope), "{loss} {bent} {slope}");
            prop_assert!(bent.abs() <= r.abs());
            prop_assert!((0.0..=1.0).contains(&loss.weight(r)));
        }
    }

    #[test]
    fn rows_are_reduced_to_a_finite_triangle_or_to_nan(a in prop::collection::vec(any_double(), ROWS * COLUMNS)) {
        let r = triangle(a.clone(), ROWS, COLUMNS);
        prop_assert!(r.iter().all(|v| v.is_finite()) || r.iter().all(|v| v.is_nan()), "{r:?}");
        // Columns keep their lengths.
        if r[0].is_finite() {
            for (before, after) in a.chunks(ROWS).zip(r.chunks(COLUMNS)) {
                let length = |v: &[f64]| v.iter().map(|x| x * x).sum::<f64>().sqrt();
                prop_assert!((length(before) - length(after)).abs() <= 1e-13 * length(before) + 1e-150);
            }
        }
    }

    #[test]
    fn a_descent_ends_at_finite_values_or_reports_why_not(a in prop::collection::vec(any_double(), ROWS * COLUMNS), y in prop::collection::vec(any_double(), ROWS), start in prop::collection::vec(any_double(), COLUMNS)) {
        let problem = Linear { a, y };
        let settings = Settings::DEFAULT.within(60);
        let m = minimise(&problem, &start, &Bounds::none(COLUMNS), &settings, &AtomicBool::new(false));
        prop_assert!(m.parameters.iter().all(|x| x.is_finite()), "{m:?}");
        prop_assert!(!m.cost.is_nan());
        if m.ending.is_success() {
            prop_assert!(m.cost.is_finite() && m.residuals.iter().all(|r| r.is_finite()), "{m:?}");
        }
        if !m.cost.is_finite() {
            prop_assert_eq!(m.ending, Ending::NotFinite);
        }
    }
}
