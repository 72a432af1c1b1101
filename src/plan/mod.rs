//! What a computation can do without, decided before it starts, as a database plans a query.
//!
//! Call [`scene::plan`] for a scene of the tracer, [`series::plan`] for the fit of a recorded series; the plan of a map,
//! which decides the same things pixel by pixel and one more, is made in the room `map`. Five decisions, each in or out, with the reason and what leaving it out may cost: exactly nothing, a bound, or an
//! estimate from a closed form or a pilot run. Nothing is left out that may cost more than the
//! tolerance, unless the program has it nowhere; then the reason says so. What is left out takes a path of its own through the program (scalar light is another
//! type than polarised light), so it leaves no branch behind. It prints nothing and knows no clock.

pub mod scene;
pub mod series;

use serde::Serialize;

use crate::model::LeftOut;

/// What can be left out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
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
    /// Everything but single reflections, at every step of each pixel's fit (maps alone).
    CostlyTerms,
}

impl Decision {
    /// In words.
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

/// Where a cost comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Basis {
    /// It is exactly nothing.
    Exact,
    /// It is no more than this.
    Bound,
    /// It is about this, from a closed form.
    Estimate,
    /// A short run says so, two standard errors included.
    Pilot,
}

/// One decision.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Choice {
    /// What about.
    pub decision: Decision,
    /// Whether it is computed.
    pub included: bool,
    /// What exactly is in or out, for the user.
    pub what: String,
    /// Why.
    pub why: String,
    /// Relative error of the answer without it; null where nobody asked.
    pub cost: Option<f64>,
    /// Where the cost comes from.
    pub basis: Basis,
}

/// All decisions on one computation.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Plan {
    /// Relative error that the plan may cost.
    pub tolerance: f64,
    /// What the error is relative to.
    pub quantity: String,
    /// The five decisions; a map has a sixth.
    pub decisions: Vec<Choice>,
    /// Interactions after which light may be given up; null where all count.
    pub interactions_max: Option<u32>,
    /// Interfaces that may go (1 for the topmost).
    pub idle_interfaces: Vec<usize>,
}

impl Plan {
    /// What is left out.
    pub fn left_out(&self) -> impl Iterator<Item = &Choice> {
        self.decisions.iter().filter(|c| !c.included)
    }

    /// What is left out, in the form of every result.
    #[must_use]
    pub fn told(&self) -> Vec<LeftOut> {
        self.left_out()
            .map(|c| LeftOut::new(&c.what, &c.why, c.cost))
            .collect()
    }

    /// The decision about something.
    #[must_use]
    pub fn on(&self, decision: Decision) -> Option<&Choice> {
        self.decisions.iter().find(|c| c.decision == decision)
    }
}

/// Error that a plan may cost where nobody says otherwise.
pub const TOLERANCE: f64 = 0.01;
