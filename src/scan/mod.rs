//! A scan: a plan that is data, the states it goes through, the events that tell its story.
//!
//! [`Plan`] is what a person asks for; [`Plan::check`] lists everything that is wrong with it and
//! [`Plan::steps`] puts it in an order that saves motion, both before anything moves.
//! [`ScanState`] is the one state machine. What happens is told in [`Event`]s and nowhere else:
//! page, log and store see the same ones. [`runner::run`] carries a plan out. This room knows no database, no HTTP and no simulator.

pub mod event;
pub mod plan;
pub mod reach;
pub mod recorder;
pub mod rig;
pub mod runner;
mod seen;
pub mod state;
pub mod visit;

pub use event::{Event, OperatorAction, Progress, RecordedEvent};
pub use plan::{Plan, PlanError, PlanRequest, Shot, Step, TravelLimits};
pub use reach::{Reach, StageLink};
pub use rig::Rig;
pub use state::ScanState;
