//! Errors of the lab, one variant per situation that page, command line and scripts can distinguish.

use std::fmt;
use std::sync::Arc;

use crate::analysis::AnalysisError;
use crate::bench::stage::StageError;
use crate::bench::{AxisName, CameraError};
use crate::job::{JobId, JobState};
use crate::program::ProgramError;
use crate::scan::visit::stage_code;
use crate::scan::{OperatorAction, PlanError, ScanState};
use crate::series::archive::ArchiveError;
use crate::series::{FrameReadError, SeriesError};
use crate::store::StoreError;
use crate::store::queue::QueueState;

/// What holds the rig.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Holder {
    /// A scan, up to its end.
    Scan {
        /// Which.
        scan_id: i64,
        /// Its state, if known.
        state: Option<ScanState>,
    },
    /// One axis that is homing.
    Homing,
    /// One axis that is moving.
    Moving,
    /// The stages are being connected.
    Connecting,
    /// A scan that is about to begin.
    Beginning,
    /// An order that came while a preview was taken.
    OtherOrder,
}

impl fmt::Display for Holder {
    /// States the holder, and how the rig becomes free: a paused scan still holds it.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (scan_id, state) = match *self {
            Holder::Homing => return f.write_str("an axis is homing; wait until it stops"),
            Holder::Moving => return f.write_str("an axis is moving; wait until it stops"),
            Holder::Connecting => {
                return f.write_str("the stages are being connected; try again in a moment");
            }
            Holder::Beginning => {
                return f.write_str("a scan is about to start; try again in a moment");
            }
            Holder::OtherOrder => {
                return f.write_str(
                    "another order to the rig came first; look again when the rig is at rest",
                );
            }
            Holder::Scan { scan_id, state } => (scan_id, state),
        };
        match state {
            Some(ScanState::Paused) => write!(
                f,
                "scan {scan_id} is paused and holds the rig; resume it and wait for its end, or abort it"
            ),
            Some(ScanState::WaitingForOperator) => write!(
                f,
                "scan {scan_id} waits for an operator step and holds the rig; do the step and wait for its end, or abort it"
            ),
            _ => write!(
                f,
                "scan {scan_id} holds the rig until its end; wait for the end or abort it: a pause does not free the rig"
            ),
        }
    }
}

/// Why the lab refused or failed an operation.
#[derive(Debug, thiserror::Error)]
pub enum LabError {
    /// The rig is busy.
    #[error("the rig is busy: {with}; stop is always allowed")]
    Busy {
        /// What holds the rig.
        with: Holder,
    },
    /// This daemon has no rig.
    #[error(
        "this daemon has no rig: name its port and its camera's folder in a configuration file and start `ridged serve --config FILE`, or start with --simulated-rig"
    )]
    NoRig,
    /// The scan's state does not allow the command.
    #[error("scan {scan_id} is {state}: {asked} is not allowed in this state")]
    NotNow {
        /// The scan.
        scan_id: i64,
        /// Its state.
        state: ScanState,
        /// The command.
        asked: &'static str,
    },
    /// The scan waits for another operator step than the one reported as done.
    #[error(
        "scan {scan_id} waits for {}, not for {}: {}",
        .waits_for.as_str(), .done.as_str(), .waits_for.message()
    )]
    OtherStep {
        /// The scan.
        scan_id: i64,
        /// The step reported as done.
        done: OperatorAction,
        /// The step it waits for.
        waits_for: OperatorAction,
    },
    /// The queue's state does not allow the request.
    #[error("the queue is {state}: {problem}")]
    QueueConflict {
        /// Its state.
        state: QueueState,
        /// What is not possible or missing.
        problem: &'static str,
    },
    /// No order waits.
    #[error("no order waits in the queue; add one first")]
    EmptyQueue,
    /// A job is in the wrong state for the request.
    #[error("{id} is {state}: {problem}")]
    JobConflict {
        /// The job.
        id: JobId,
        /// Its state.
        state: JobState,
        /// What is not possible or missing.
        problem: &'static str,
    },
    /// The scan belongs to another rig.
    #[error("scan {scan_id} cannot be resumed here: {why}")]
    NotOfThisRig {
        /// The scan.
        scan_id: i64,
        /// What differs, with both values, and the remedy.
        why: String,
    },
    /// The plan cannot run.
    #[error(transparent)]
    Plan(#[from] PlanError),
    /// There is not enough disk space for the scan.
    #[error(
        "the disk is full: the scan needs up to {needed_mb} MB beside {reserve_mb} MB of reserve, {free_mb} MB are free; free some space or plan less"
    )]
    NoRoom {
        /// Largest size of the frames, MB.
        needed_mb: u64,
        /// Reserve that stays free, MB.
        reserve_mb: u64,
        /// Free space, MB.
        free_mb: u64,
    },
    /// There is not enough disk space for a series or a file.
    #[error(
        "the disk is full: {what} needs up to {needed_mb} MB beside {reserve_mb} MB of reserve, {free_mb} MB are free; nothing was kept: free some space first"
    )]
    NoRoomFor {
        /// What has no room: "the series".
        what: &'static str,
        /// Its largest size, MB.
        needed_mb: u64,
        /// Reserve that stays free, MB.
        reserve_mb: u64,
        /// Free space, MB.
        free_mb: u64,
    },
    /// An import or export was cancelled.
    #[error("cancelled; nothing was kept")]
    BrokenOff,
    /// The stages.
    #[error(transparent)]
    Stage(#[from] StageError),
    /// A jog that is over cannot be renewed.
    #[error(
        "this jog has ended: it was not renewed within 0.5 s, or the stage was stopped; begin another one"
    )]
    JogEnded,
    /// Other controllers answer than those to be accepted.
    #[error("{}", match found {
        Some(found) => format!("other controllers answer than those to be accepted: {found}; check them, then accept these"),
        None => "no controllers answer: connect them and switch them on, then accept them".to_owned(),
    })]
    OtherStagesAnswer {
        /// Those that answer.
        found: Option<String>,
    },
    /// A stop command did not reach the stages.
    #[error("{}", not_stopped(source))]
    NotStopped {
        /// Why not.
        source: StageError,
    },
    /// The stages have not confirmed a stop in time; the daemon continues to stop them.
    #[error(
        "the stages have not confirmed the stop yet and may be moving: the daemon repeats it; if they move on, use the \
         hardware emergency switch"
    )]
    StopUnconfirmed,
    /// The stages have not confirmed the stop of an abort in time; the daemon continues to stop them.
    #[error(
        "scan {scan_id} is being aborted, but the stages have not confirmed the stop yet and may be moving: the daemon repeats \
         it; if they move on, use the hardware emergency switch"
    )]
    AbortUnconfirmed {
        /// The scan.
        scan_id: i64,
    },
    /// An order waits for a locked database, or for a disk that does not answer.
    #[error(
        "scan {scan_id} cannot record the order to {asked} yet, since {}; it obeys as soon as {}{}",
        if *no_answer { "the disk of the data folder does not answer" } else { "another program has locked the database" },
        match no_answer {
            true => "the disk answers",
            false => "the lock ends: end that program (`fuser` with the path of ridged.sqlite names it)",
        },
        if *asked == "abort" { "; the stages have stopped" } else { "" }
    )]
    WaitsForDatabase {
        /// The scan.
        scan_id: i64,
        /// The order.
        asked: &'static str,
        /// It is the disk that does not answer.
        no_answer: bool,
    },
    /// The stop of an abort did not reach the stages.
    #[error("scan {scan_id} is aborted, but {}", not_stopped(source))]
    AbortedInMotion {
        /// The scan.
        scan_id: i64,
        /// Why the stop did not reach them.
        source: StageError,
    },
    /// A preview without light on a rig whose lamp has no command.
    #[error(
        "the lamp cannot be switched off: the settings have no command for it; set lamp.off, or cap the lens and leave the \
         lamp on"
    )]
    NoLampSwitch,
    /// The lamp's command failed.
    #[error("the lamp could not be switched: {0}")]
    Lamp(ProgramError),
    /// The camera.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// The store.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// A scan has no fit to report.
    #[error("scan {scan_id} has nothing to report: {why}")]
    NoReport {
        /// The scan.
        scan_id: i64,
        /// Why, and the way out.
        why: String,
    },
    /// A folder is not a series.
    #[error(transparent)]
    Series(#[from] SeriesError),
    /// A file is not an archive of a series.
    #[error(transparent)]
    Archive(ArchiveError),
    /// A frame of a series cannot be imported.
    #[error(
        "{reason}; nothing was imported: restore the file, or leave it out (--skip-unreadable, over HTTP \"skip_unreadable\": true)"
    )]
    Frame {
        /// The cause.
        reason: FrameReadError,
    },
    /// A series cannot be written.
    #[error("{0}")]
    Export(String),
    /// Reduction or fit.
    #[error(transparent)]
    Analysis(#[from] AnalysisError),
    /// An invalid value.
    #[error("{field}: {problem}")]
    Invalid {
        /// Path of the field in the request, with dots.
        field: String,
        /// What is wrong and what is allowed.
        problem: String,
    },
    /// Work that several callers shared failed for all of them.
    #[error(transparent)]
    Shared(Arc<LabError>),
    /// A computation panicked.
    #[error("something went wrong inside; the daemon's log has the details")]
    Panicked,
    /// The daemon is ending.
    #[error("the daemon is stopping")]
    Stopping,
}

/// States why a stop is not confirmed.
pub(super) fn not_stopped(source: &StageError) -> String {
    match source {
        // Connecting stops all devices of the line first.
        StageError::OtherStages(_) | StageError::WrongDevice { .. } => format!(
            "the controllers on the port acknowledged the stop, but they are not those of the rig: {source}; if an axis moves, \
             use the hardware emergency switch"
        ),
        _ => format!(
            "the stop did not reach the stages, which may be moving: use the hardware emergency switch ({source})"
        ),
    }
}

impl LabError {
    /// Returns the axis of a target outside its travel, with target, lower and upper limit in degrees.
    #[must_use]
    pub fn outside_travel(&self) -> Option<(AxisName, [f64; 3])> {
        match self {
            LabError::Stage(StageError::OutsideLimits {
                axis,
                target,
                min,
                max,
            }) => Some((
                *axis,
                [target, min, max].map(|angle| angle.deg_for_tables()),
            )),
            _ => None,
        }
    }

    /// Returns a stable code for logs and scripts.
    #[must_use]
    pub fn code(&self) -> &'static str {
        match self {
            LabError::Busy { .. } => "busy",
            LabError::NoRig => "no-rig",
            LabError::EmptyQueue => "queue-empty",
            LabError::NotNow { .. }
            | LabError::QueueConflict { .. }
            | LabError::JobConflict { .. }
            | LabError::NotOfThisRig { .. } => "state-conflict",
            LabError::OtherStep { .. } => "other-step",
            LabError::Plan(_) => "plan-invalid",
            LabError::NoRoom { .. } | LabError::NoRoomFor { .. } => "disk-full",
            LabError::BrokenOff => "broken-off",
            LabError::Stage(error)
            | LabError::NotStopped { source: error }
            | LabError::AbortedInMotion { source: error, .. } => stage_code(error),
            LabError::StopUnconfirmed | LabError::AbortUnconfirmed { .. } => "stop-unconfirmed",
            LabError::WaitsForDatabase {
                no_answer: true, ..
            } => "disk-silent",
            LabError::WaitsForDatabase { .. } => "store-locked",
            LabError::JogEnded => "jog-ended",
            LabError::OtherStagesAnswer { .. } => "other-stages",
            LabError::NoLampSwitch => "no-lamp-switch",
            LabError::Lamp(_) => "lamp-failed",
            LabError::Camera(_) => "camera-failed",
            LabError::Store(error) => store_code(error),
            LabError::NoReport { .. } => "no-fit",
            LabError::Series(_) | LabError::Archive(_) => "series-invalid",
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

pub(super) fn store_code(error: &StoreError) -> &'static str {
    match error {
        StoreError::InUse { .. } => "store-in-use",
        StoreError::Missing { .. } => "store-missing",
        StoreError::DiskFull { .. } | StoreError::NoRoomToOpen { .. } => "disk-full",
        StoreError::NotFound { .. } => "not-found",
        StoreError::StateConflict { .. } => "state-conflict",
        StoreError::NoVersion { .. } => "not-found",
        StoreError::NameTaken { .. } | StoreError::PartNameTaken { .. } => "name-taken",
        StoreError::VersionConflict { .. } => "version-conflict",
        StoreError::ExternalIdTaken { .. } => "external-id-taken",
        StoreError::OrderConflict { .. } => "state-conflict",
        StoreError::KeyReused => "idempotency-mismatch",
        StoreError::FrameDamaged { .. } => "frame-damaged",
        StoreError::FolderGone { .. } => "data-folder-gone",
        StoreError::Locked => "store-locked",
        StoreError::NoAnswer => "disk-silent",
        StoreError::DiskFailed { .. } | StoreError::File { .. } => "disk-failed",
        StoreError::Damaged { .. }
        | StoreError::BadRow { .. }
        | StoreError::RowsMissing { .. }
        | StoreError::UnreadLog { .. } => "store-damaged",
        StoreError::ReadOnly
        | StoreError::FolderName { .. }
        | StoreError::Migration(_)
        | StoreError::NotKept { .. }
        | StoreError::Frame(_)
        | StoreError::Database(_) => "store-failed",
    }
}
