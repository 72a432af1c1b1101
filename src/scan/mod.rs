//! A scan: its plan, its states and its events.
//!
//! [`Plan`] is what a user requests. [`Plan::check`] lists all its errors, and [`Plan::steps`] orders its points to save
//! motion; both run before anything moves. [`ScanState`] is the state machine. [`runner::run`] carries a plan out and reports
//! everything as [`Event`]s: page, log and store receive the same ones. This module knows no database, no HTTP and no simulator.

pub mod event;
pub mod faults;
mod frame_history;
pub mod frame_rules;
mod incident;
pub mod look;
pub mod plan;
pub mod recorder;
pub mod reference;
pub mod rig;
pub mod runner;
mod seen_images;
pub mod stage_access;
pub mod state;
pub mod tag_history;
pub mod visit;

pub use crate::bench::stage::StageLink;
pub use event::{Event, OperatorAction, Progress, RecordedEvent};
pub use incident::{Incident, IncidentKind};
pub use plan::{Plan, PlanError, PlanRequest, Shot, Step, TravelLimits};
pub use rig::Rig;
pub use stage_access::StageAccess;
pub use state::ScanState;
