//! What the solver is given and returns: bounds, settings, the minimum and how its search ended.

use serde::{Deserialize, Serialize};

/// How a minimisation ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Ending {
    /// The undamped Gauss–Newton step vanished: all digits are converged.
    ConvergedByStep,
    /// The projected gradient is orthogonal to the residuals to within rounding.
    ConvergedByGradient,
    /// The model predicts no further gain, but the step did not vanish; digits may be missing.
    ConvergedByCost,
    /// No step lowers the cost, but the gradient has not vanished.
    Stalled,
    /// The derivatives do not span all free parameters.
    RankDeficient,
    /// The iteration limit was reached.
    MaxIterations,
    /// Residuals or derivatives are not finite at the start.
    NotFinite,
    /// Cancelled by the caller.
    Cancelled,
}

impl Ending {
    /// Whether the point is numerically a minimum.
    #[must_use]
    pub const fn is_success(self) -> bool {
        matches!(self, Ending::ConvergedByStep | Ending::ConvergedByGradient)
    }
}

/// Bounds of the parameters; infinite entries mean no bound.
#[derive(Debug, Clone, PartialEq)]
pub struct Bounds {
    /// Lower bounds.
    pub lower: Vec<f64>,
    /// Upper bounds.
    pub upper: Vec<f64>,
}

impl Bounds {
    /// No bounds on any of `n` parameters.
    #[must_use]
    pub fn none(n: usize) -> Self {
        Bounds {
            lower: vec![f64::NEG_INFINITY; n],
            upper: vec![f64::INFINITY; n],
        }
    }

    pub(in crate::fit) fn clamp(&self, x: &mut [f64]) {
        for (j, value) in x.iter_mut().enumerate() {
            *value = value.max(self.lower[j]).min(self.upper[j]);
        }
    }
}

/// Tolerances and limits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// Maximum number of trial steps.
    pub max_iterations: u64,
    /// First trust radius as a fraction of ‖D x‖; small values keep hard problems from leaping away.
    pub initial_radius: f64,
    /// Relative predicted and actual gain below which the descent ends, or its polish begins.
    pub cost_tolerance: f64,
    /// Relative trust radius below which it ends, or its polish begins.
    pub step_tolerance: f64,
    /// Maximum number of undamped steps at the end; 0 switches the polish off.
    pub polish_steps: u32,
    /// Relative step that counts as vanished.
    pub vanished_step: f64,
    /// Smallest ratio of singular values of the column-scaled derivatives that counts as full rank.
    pub rank_tolerance: f64,
}

impl Settings {
    /// For full accuracy.
    pub const DEFAULT: Settings = Settings {
        max_iterations: 2000,
        initial_radius: 0.1,
        cost_tolerance: 1e-9,
        step_tolerance: 1e-7,
        polish_steps: 60,
        vanished_step: 1e-12,
        rank_tolerance: 1e-11,
    };
    /// For the different ends of a search. Those that are far from a minimum after this many steps are continued only if
    /// they are the best.
    pub const FINE: Settings = Settings {
        polish_steps: 20,
        ..Settings::DEFAULT
    }
    .within(120);
    /// For a fit that is repeated near its minimum, with a held parameter or other signals.
    pub const REFIT: Settings = Settings {
        polish_steps: 12,
        ..Settings::DEFAULT
    }
    .within(300);
    /// For a descent that only serves to estimate the model error, or to compare costs.
    pub const NEAR: Settings = Settings {
        polish_steps: 0,
        cost_tolerance: 1e-6,
        ..Settings::DEFAULT
    };
    /// For a descent that only has to reach the neighbourhood of a minimum.
    pub const ROUGH: Settings = Settings {
        cost_tolerance: 1e-5,
        ..Settings::NEAR
    };

    /// Returns the same settings with another maximum number of trial steps.
    #[must_use]
    pub const fn within(self, max_iterations: u64) -> Self {
        Settings {
            max_iterations,
            ..self
        }
    }
}

impl Default for Settings {
    fn default() -> Self {
        Settings::DEFAULT
    }
}

/// The end of a minimisation.
#[derive(Debug, Clone, PartialEq)]
pub struct Minimum {
    /// Parameters.
    pub parameters: Vec<f64>,
    /// Residuals there.
    pub residuals: Vec<f64>,
    /// Derivatives there, column-major m × n.
    pub jacobian: Vec<f64>,
    /// Sum of squared residuals.
    pub cost: f64,
    /// How it ended.
    pub ending: Ending,
    /// Parameters held at a bound by the gradient.
    pub at_bound: Vec<usize>,
    /// Evaluations of residuals with derivatives.
    pub evaluations: u64,
}
