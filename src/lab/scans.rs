//! Scans: from the plan, recipe or queue that orders one to the run on the rig, and the fit at its end.

pub(super) mod commands;
pub(super) mod due;
pub(super) mod fit_at_end;
pub(super) mod incidents;
pub(super) mod live_fit;
pub(super) mod orders;
pub(super) mod plans;
pub(super) mod queue;
pub(super) mod recipes;
pub(super) mod recorder;
pub(super) mod scan_run;
