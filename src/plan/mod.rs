//! What a computation can omit, decided before it starts, as a database plans a query.
//!
//! Call [`scene::plan`] for a scene of the tracer and [`series::plan`] for the fit of a recorded series. The module `map`
//! plans maps, with one more decision. A plan has five decisions. Each states whether an effect is computed, the reason,
//! and the error of the result without it: exactly zero, a bound, or an
//! estimate from a closed form or a pilot run. An effect whose omission may cost more than the
//! tolerance is computed, unless no part of the program can; then the reason says so. Omitted effects have their own
//! code path (scalar and polarised light are different types), so they leave no branch behind. This module prints nothing
//! and knows no clock.

pub mod scene;
pub mod series;

use serde::Serialize;

use crate::model::LeftOut;

/// An effect that can be omitted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, utoipa::ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Decision {
    /// Following the polarisation of light.
    Polarisation,
    /// Light that bounces more often than a number of times.
    Bounces,
    /// Interfaces of a stack.
    Layers,
    /// The average over the cones of lamp and lens.
    ConeAverage,
    /// Directions of each pixel instead of the centre's.
    PerPixelGeometry,
    /// Everything except single reflections, at every step of each pixel's fit (only in maps).
    CostlyTerms,
}

impl Decision {
    /// Its name in a report.
    #[must_use]
    pub const fn words(self) -> &'static str {
        match self {
            Decision::Polarisation => "polarisation",
            Decision::Bounces => "number of bounces",
            Decision::Layers => "layers",
            Decision::ConeAverage => "cone average",
            Decision::PerPixelGeometry => "per-pixel geometry",
            Decision::CostlyTerms => "costly terms",
        }
    }
}

/// The basis of a cost.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Basis {
    /// Exact.
    Exact,
    /// An upper bound.
    Bound,
    /// An estimate from a closed form.
    Estimate,
    /// A pilot run, including two standard errors.
    Pilot,
}

/// One decision.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PlanChoice {
    /// Which effect.
    pub decision: Decision,
    /// Whether it is computed.
    pub included: bool,
    /// What exactly is computed or omitted, for the user.
    pub what: String,
    /// Why.
    pub why: String,
    /// Relative error of the result without it; null where it was not estimated.
    pub cost: Option<f64>,
    /// Basis of the cost.
    pub basis: Basis,
}

/// All decisions about one computation.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ComputationPlan {
    /// Allowed relative error of the plan.
    pub tolerance: f64,
    /// The quantity to which the error refers.
    pub quantity: String,
    /// The five decisions; a map has a sixth.
    pub decisions: Vec<PlanChoice>,
    /// Interactions after which light may be dropped; null where all count.
    pub interactions_max: Option<u32>,
    /// Interfaces that may be omitted (1 for the topmost).
    pub idle_interfaces: Vec<usize>,
}

impl ComputationPlan {
    /// The omitted effects.
    pub fn left_out(&self) -> impl Iterator<Item = &PlanChoice> {
        self.decisions.iter().filter(|c| !c.included)
    }

    /// The omitted effects, in the form that every result reports.
    #[must_use]
    pub fn omissions(&self) -> Vec<LeftOut> {
        self.left_out()
            .map(|c| LeftOut::new(&c.what, &c.why, c.cost))
            .collect()
    }

    /// The decision about an effect.
    #[must_use]
    pub fn on(&self, decision: Decision) -> Option<&PlanChoice> {
        self.decisions.iter().find(|c| c.decision == decision)
    }
}

/// Default of the allowed relative error of a plan.
pub const TOLERANCE: f64 = 0.01;
