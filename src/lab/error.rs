//! What the lab refuses, as situations that page, command line and scripts can tell apart.

use std::fmt;
use std::sync::Arc;

use crate::analysis::AnalysisError;
use crate::bench::CameraError;
use crate::bench::stage::StageError;
use crate::scan::event::TaskState;
use crate::scan::visit::stage_code;
use crate::scan::{OperatorAction, PlanError, ScanState};
use crate::series::{FrameReadError, SeriesError};
use crate::store::StoreError;

/// What has the rig while it is refused to others.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Holder {
    /// A scan, up to its end.
    Scan {
        /// Which.
        scan_id: i64,
        /// Where it stands, if that is known.
        state: Option<ScanState>,
    },
    /// One axis that looks for its reference.
    Homing,
    /// One axis on its way.
    Moving,
    /// The stages are being connected.
    Connecting,
    /// A scan that is about to begin.
    Beginning,
}

impl fmt::Display for Holder {
    /// What it does, and how the rig becomes free: pausing a scan frees nothing.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (scan_id, state) = match *self {
            Holder::Homing => return f.write_str("an axis is homing; wait until it stands"),
            Holder::Moving => return f.write_str("an axis is moving; wait until it stands"),
            Holder::Connecting => {
                return f.write_str("the stages are being connected; ask again in a moment");
            }
            Holder::Beginning => {
                return f.write_str("a scan is about to begin; ask again in a moment");
            }
            Holder::Scan { scan_id, state } => (scan_id, state),
        };
        match state {
            Some(ScanState::Paused) => write!(
                f,
                "scan {scan_id} is paused and holds it; resume it and wait for its end, or abort it"
            ),
            Some(ScanState::WaitingForOperator) => write!(
                f,
                "scan {scan_id} waits for a person and holds it; do that step and wait for its end, or abort it"
            ),
            _ => write!(
                f,
                "scan {scan_id} holds it until its end; wait for that or abort it: a pause does not free the rig"
            ),
        }
    }
}

/// Why the lab did not do what was asked.
#[derive(Debug, thiserror::Error)]
pub enum LabError {
    /// The rig is held by something else.
    #[error("the rig is busy: {with}; stop is always allowed")]
    Busy {
        /// What holds it.
        with: Holder,
    },
    /// This daemon has no rig.
    #[error(
        "this daemon has no rig: name its port and its camera's folder in a configuration file and start `ridged serve --config FILE`, or start with --simulated-rig"
    )]
    NoRig,
    /// The scan cannot do that where it stands.
    #[error("scan {scan_id} is {state}: {asked} is not allowed in this state")]
    NotNow {
        /// Which scan.
        scan_id: i64,
        /// Where it stands.
        state: ScanState,
        /// What was asked.
        asked: &'static str,
    },
    /// The scan waits for another step of the operator's than the one that was done.
    #[error(
        "scan {scan_id} waits for {}, not for {}, and waits on: {}",
        .waits_for.as_str(), .done.as_str(), .waits_for.message()
    )]
    OtherStep {
        /// Which scan.
        scan_id: i64,
        /// The step that was done.
        done: OperatorAction,
        /// The step that it waits for.
        waits_for: OperatorAction,
    },
    /// A fit or calculation cannot do that where it stands.
    #[error("{what} {number} is {state}: {problem}")]
    NotThere {
        /// A fit, a map, …
        what: String,
        /// Which one.
        number: i64,
        /// Where it stands.
        state: TaskState,
        /// What is not possible, or not there.
        problem: &'static str,
    },
    /// The scan is not this rig's to run.
    #[error("scan {scan_id} cannot be resumed here: {why}")]
    NotOfThisRig {
        /// Which scan.
        scan_id: i64,
        /// What is another rig's about it, with both values, and the way out.
        why: String,
    },
    /// The plan cannot run.
    #[error(transparent)]
    Plan(#[from] PlanError),
    /// There is not enough room for the scan.
    #[error(
        "the disk is full: the scan needs up to {needed_mb} MB beside {reserve_mb} MB of reserve, {free_mb} MB are free; free some space or plan less"
    )]
    NoRoom {
        /// What the frames can take.
        needed_mb: u64,
        /// What is left alone.
        reserve_mb: u64,
        /// What is there.
        free_mb: u64,
    },
    /// There is not enough room for a series.
    #[error(
        "the disk is full: the series needs up to {needed_mb} MB beside {reserve_mb} MB of reserve, {free_mb} MB are free; nothing was imported: free some space first"
    )]
    NoRoomToImport {
        /// What its frames can take.
        needed_mb: u64,
        /// What is left alone.
        reserve_mb: u64,
        /// What is there.
        free_mb: u64,
    },
    /// Somebody broke an import or an export off.
    #[error("cancelled; nothing was kept")]
    BrokenOff,
    /// The stages.
    #[error(transparent)]
    Stage(#[from] StageError),
    /// A stop did not reach the stages.
    #[error(
        "the stop did not reach the stages, which may be moving: use the hardware emergency switch ({source})"
    )]
    NotStopped {
        /// Why not.
        source: StageError,
    },
    /// The stop that goes with an abort did not reach the stages.
    #[error(
        "scan {scan_id} is aborted, but the stop did not reach the stages, which may be moving: use the hardware \
         emergency switch ({source})"
    )]
    AbortedInMotion {
        /// Which scan.
        scan_id: i64,
        /// Why the stop did not reach them.
        source: StageError,
    },
    /// The camera.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// The store.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// There is no measurement of accuracy.
    #[error(
        "no accuracy measurement yet: run `ridged accuracy --data FOLDER` with this daemon's data folder"
    )]
    NothingMeasured,
    /// A folder is no series.
    #[error(transparent)]
    Series(#[from] SeriesError),
    /// A frame of a series cannot be imported.
    #[error(
        "{reason}; nothing was imported: restore the file, or leave it out (--skip-unreadable, over HTTP \"skip_unreadable\": true)"
    )]
    Frame {
        /// What is wrong with it.
        reason: FrameReadError,
    },
    /// A series cannot be written.
    #[error("{0}")]
    Export(String),
    /// Reduction or fit.
    #[error(transparent)]
    Analysis(#[from] AnalysisError),
    /// A value that makes no sense.
    #[error("{field}: {problem}")]
    Invalid {
        /// Which.
        field: String,
        /// What is wrong with it, and what is allowed.
        problem: String,
    },
    /// What was asked for by several at once failed for all of them.
    #[error(transparent)]
    Shared(Arc<LabError>),
    /// A calculation broke off where it never should.
    #[error("something went wrong inside; the daemon's log has the details")]
    Panicked,
    /// The daemon is ending.
    #[error("the daemon is stopping")]
    Stopping,
}

impl LabError {
    /// A stable word for logs and scripts.
    #[must_use]
    pub fn code(&self) -> &'static str {
        match self {
            LabError::Busy { .. } => "busy",
            LabError::NoRig => "no-rig",
            LabError::NotNow { .. } | LabError::NotThere { .. } | LabError::NotOfThisRig { .. } => {
                "state-conflict"
            }
            LabError::OtherStep { .. } => "other-step",
            LabError::Plan(_) => "plan-invalid",
            LabError::NoRoom { .. } | LabError::NoRoomToImport { .. } => "disk-full",
            LabError::BrokenOff => "broken-off",
            LabError::Stage(error)
            | LabError::NotStopped { source: error }
            | LabError::AbortedInMotion { source: error, .. } => stage_code(error),
            LabError::Camera(_) => "camera-failed",
            LabError::Store(error) => store_code(error),
            LabError::NothingMeasured => "not-found",
            LabError::Series(_) => "series-invalid",
            LabError::Frame { .. } => "frame-unreadable",
            LabError::Export(_) => "export-failed",
            LabError::Analysis(_) => "analysis-failed",
            LabError::Invalid { .. } => "invalid-value",
            LabError::Shared(error) => error.code(),
            LabError::Panicked => "internal",
            LabError::Stopping => "stopping",
        }
    }
}

fn store_code(error: &StoreError) -> &'static str {
    match error {
        StoreError::InUse { .. } => "store-in-use",
        StoreError::Missing { .. } => "store-missing",
        StoreError::DiskFull { .. } | StoreError::NoRoomToOpen { .. } => "disk-full",
        StoreError::NotFound { .. } => "not-found",
        StoreError::StateConflict { .. } => "state-conflict",
        StoreError::KeyReused => "idempotency-mismatch",
        StoreError::FrameDamaged { .. } => "frame-damaged",
        StoreError::Damaged { .. }
        | StoreError::BadRow { .. }
        | StoreError::RowsMissing { .. }
        | StoreError::UnreadLog { .. } => "store-damaged",
        StoreError::File { .. }
        | StoreError::FolderName { .. }
        | StoreError::Migration(_)
        | StoreError::NotKept { .. }
        | StoreError::Frame(_)
        | StoreError::Database(_) => "store-failed",
    }
}
