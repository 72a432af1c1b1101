//! Conformity: measured parameters and contrast against a specification, with guard bands.
//!
//! Call [`judge`] with a [`Specification`] and the measured quantities ([`JudgedQuantity`], for instance
//! from [`parameters`] and [`contrasts`]). Each limit is decided after JCGM 106:2012. With the measured value y, its
//! standard uncertainty u and effective degrees of freedom ν, the probability that the true value
//! conforms is p = F((TU − y)/u) − F((TL − y)/u), where F is the t distribution (JCGM 106, 7.3 and 9).
//!
//! *Decision rule*: **pass** where 1 − p, the risk of accepting a nonconforming item, is at most
//! the specification's `max_false_accept_risk`; **fail** where p, the risk of rejecting a conforming item,
//! is at most `max_false_reject_risk`; **cannot tell** in between, and where a quantity is
//! not identifiable. For limits far apart this is guarded acceptance: the acceptance limits lie
//! inside the tolerance limits by the guard band g = t(1 − risk) · u (JCGM 106, 8.3.2), which the report
//! states. The part fails if one item fails and passes if all pass.
//!
//! This module knows neither files nor frames.

mod contrast;
mod decision;
mod judgement;
mod quantity;
mod report;
mod specification;
mod true_value;
mod would_decide;

pub use contrast::{JudgedContrasts, contrasts};
pub use decision::{JudgedItem, Verdict};
pub use judgement::{Judgement, judge};
pub use quantity::{
    CONTRAST_MEAN, CONTRAST_MICHELSON_MEAN, JudgedQuantity, MeasuredValue, QUANTITIES, parameters,
};
pub use report::VerdictReport;
pub use specification::{DecisionRule, Specification, SpecificationError, ToleranceLimits};
pub use would_decide::{Way, WouldDecide};

#[cfg(test)]
mod tests;
