//! The only record of what happens: page, log and store see the same events.
//!
//! An event is broadcast after it is durable: the store gives it its number, then it is broadcast. So a
//! listener that comes back with the last number it saw misses nothing and sees nothing twice.

use std::sync::atomic::{AtomicI64, Ordering};

use serde::{Deserialize, Serialize};
use time::OffsetDateTime;

use super::state::ScanState;
use crate::forecast::Forecast;
use crate::frame::FrameKind;
use crate::job::{JobId, JobKind, JobState};
use crate::words::words;

words! {
    /// A step of the operator at the rig, before which the scan cannot continue.
    #[derive(utoipa::ToSchema)]
    pub enum OperatorAction {
        /// Dark frames come next.
        CapLens = "cap-lens",
        /// White-reference frames come next.
        PlaceWhiteReference = "place-white-reference",
        /// The sample's frames come next.
        PlaceSample = "place-sample",
    }
}

impl OperatorAction {
    /// The instruction to the operator.
    #[must_use]
    pub const fn message(self) -> &'static str {
        match self {
            OperatorAction::CapLens => "Put the cap on the lens, then continue.",
            OperatorAction::PlaceWhiteReference => {
                "Take the cap off, put the white reference on the table, then continue."
            }
            OperatorAction::PlaceSample => {
                "Take the cap off, put the part on the table, then continue."
            }
        }
    }

    /// Kind of the frames that follow.
    #[must_use]
    pub const fn kind(self) -> FrameKind {
        match self {
            OperatorAction::CapLens => FrameKind::Dark,
            OperatorAction::PlaceWhiteReference => FrameKind::Flat,
            OperatorAction::PlaceSample => FrameKind::Sample,
        }
    }
}

/// An operator step.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, utoipa::ToSchema)]
#[schema(as = OperatorBody)]
pub struct OperatorStep {
    /// The step.
    pub action: OperatorAction,
    /// What to do, as a sentence.
    pub message: &'static str,
}

impl From<OperatorAction> for OperatorStep {
    fn from(action: OperatorAction) -> Self {
        OperatorStep {
            action,
            message: action.message(),
        }
    }
}

/// Progress of a scan.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Progress {
    /// Kind of frames being taken; `None` before the first and after the last.
    pub phase: Option<FrameKind>,
    /// Points committed.
    pub shots_done: u32,
    /// Points of the plan, less those that valid calibrations save.
    pub shots_total: u32,
    /// Frames committed at accepted points.
    pub frames_done: u32,
    /// Frames of the plan, less those that valid calibrations save.
    pub frames_total: u32,
    /// Share of the predicted time that is done, 0 to 1.
    pub fraction: f64,
    /// Time spent moving and exposing so far, s; without the time that it waited for people.
    pub elapsed_s: f64,
    /// Predicted time to go, from the pace so far, s; `None` when unknown.
    pub time_left_s: Option<f64>,
}

/// What an axis did.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct AxisEvent {
    /// Position read back; `None` when unknown.
    pub position_deg: Option<f64>,
    /// Where it was sent; `None` when at rest.
    pub target_deg: Option<f64>,
}

impl AxisEvent {
    /// Nothing is known of the axis.
    pub const UNKNOWN: AxisEvent = AxisEvent {
        position_deg: None,
        target_deg: None,
    };

    /// An axis at rest.
    #[must_use]
    pub fn at(position: crate::units::Angle) -> Self {
        AxisEvent {
            position_deg: Some(position.deg()),
            target_deg: None,
        }
    }

    /// An axis on its way.
    #[must_use]
    pub fn to(target: crate::units::Angle) -> Self {
        AxisEvent {
            position_deg: None,
            target_deg: Some(target.deg()),
        }
    }
}

/// What the rig is doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum RigActivity {
    /// At rest and free.
    Idle,
    /// On its way to a position.
    Moving,
    /// Looking for the reference.
    Homing,
    /// Held by a scan.
    Scanning,
    /// Stopped by a person or a program.
    Stopped,
    /// Out of reach: its state is unknown.
    NotConnected,
}

/// Fitted ridge angle in short.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct ShortValue {
    /// Estimate.
    pub value: f64,
    /// Expanded uncertainty.
    pub expanded: f64,
}

/// A parameter with its standard uncertainty.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[schema(as = UncertainBody)]
pub struct UncertainValue {
    /// Estimate, in the unit of the parameter's name.
    pub value: f64,
    /// Standard uncertainty with all known components, in the same unit.
    pub std: f64,
    /// k: the expanded uncertainty is k times `std`.
    #[serde(default = "two")]
    pub coverage_factor: f64,
}

/// k of events that were stored before it was part of them.
fn two() -> f64 {
    2.0
}

/// Result of the live fit of the frames so far.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Certainty {
    /// Time spent moving and exposing until the newest of its frames, s; without the time that it waited for people.
    pub elapsed_s: f64,
    /// Poses fitted.
    pub n_observations: usize,
    /// Frames used, dark and white-reference frames included.
    pub n_frames_used: u32,
    /// Variant of the fit.
    pub variant: String,
    /// How the fit ended.
    pub status: String,
    /// Parameters that the frames so far determine, by name.
    pub parameters: std::collections::BTreeMap<String, UncertainValue>,
}

/// Something that happened.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "type", rename_all = "lowercase")]
pub enum Event {
    /// The rig began or ended a move.
    Rig {
        /// Activity of the rig.
        activity: RigActivity,
        /// Camera tilt θc.
        theta_c: AxisEvent,
        /// Sample azimuth φs.
        phi_s: AxisEvent,
    },
    /// A scan changed its state.
    Scan {
        /// Number of the scan.
        scan_id: i64,
        /// State before.
        previous: ScanState,
        /// State now.
        state: ScanState,
        /// Reason for the state, if it is not the normal course.
        reason: Option<String>,
        /// The operator step that it waits for.
        operator: Option<OperatorAction>,
        /// Progress of the scan.
        progress: Progress,
    },
    /// A frame is stored.
    Frame {
        /// Number of the scan.
        scan_id: i64,
        /// Number of the frame.
        frame_id: i64,
        /// What it shows.
        kind: FrameKind,
        /// Camera tilt θc read back, degrees.
        theta_c_deg: f64,
        /// Sample azimuth φs read back, degrees.
        phi_s_deg: f64,
        /// Exposure time, s.
        exposure_s: f64,
        /// Number of the repeat, from 0.
        repeat: u32,
        /// Mean of all counts, DN.
        mean_dn: f64,
        /// Largest count, DN.
        max_dn: u16,
        /// Pixels at or above the saturation level.
        saturated_px: u32,
        /// Whether the point counts. A rejected frame is kept as well.
        accepted: bool,
        /// Why it does not count.
        reason: Option<String>,
        /// Progress of the scan.
        progress: Progress,
    },
    /// A fit began or ended.
    Fit {
        /// Number of the fit.
        fit_id: i64,
        /// Scan that it reads.
        scan_id: Option<i64>,
        /// State of the fit.
        state: JobState,
        /// Chosen variant; the requested one until it is chosen.
        variant: Option<String>,
        /// How the fit ended.
        status: Option<String>,
        /// The ridge angle θr, degrees, if the data determine it.
        theta_r_deg: Option<ShortValue>,
    },
    /// The fit of the frames so far has a new result.
    Uncertainty {
        /// Number of the scan.
        scan_id: i64,
        /// Result of the fit.
        #[serde(flatten)]
        certainty: Certainty,
    },
    /// A map, contrast, verdict or trace began or ended.
    Calculation {
        /// Kind of the calculation.
        kind: JobKind,
        /// Its number within the kind.
        calculation_id: i64,
        /// Scan that it reads.
        scan_id: Option<i64>,
        /// State of the calculation.
        state: JobState,
    },
    /// The duration of a running calculation was forecast.
    Forecast {
        /// Kind of the calculation: fit, map, contrast, verdict or trace.
        of: String,
        /// Its number within the kind.
        number: i64,
        /// Scan that it reads.
        scan_id: Option<i64>,
        /// The forecast.
        forecast: Forecast,
    },
    /// A fault is over, and the scan continues.
    Recovered {
        /// Scan concerned.
        scan_id: Option<i64>,
        /// Stable word of the fault, as in its alarm.
        code: String,
        /// What happened, and what ended it.
        message: String,
        /// Time from the fault to the first point that counted again, s.
        took_s: f64,
        /// Points of the plan that were taken again, by their index.
        points: Vec<u32>,
        /// Whether a person resumed the scan in between.
        attended: bool,
    },
    /// A caller gave an order to a scan, or took or returned the lease of the rig.
    Order {
        /// The order: pause, resume, abort, continue, or a change of the lease.
        order: String,
        /// Scan concerned.
        scan_id: Option<i64>,
    },
    /// A person must act.
    Alarm {
        /// Stable word of the fault.
        code: String,
        /// What happened and what to do.
        message: String,
        /// Scan concerned.
        scan_id: Option<i64>,
    },
}

impl Event {
    /// Type of the event, as in its JSON.
    #[must_use]
    pub const fn kind(&self) -> &'static str {
        match self {
            Event::Rig { .. } => "rig",
            Event::Scan { .. } => "scan",
            Event::Frame { .. } => "frame",
            Event::Fit { .. } => "fit",
            Event::Uncertainty { .. } => "uncertainty",
            Event::Calculation { .. } => "calculation",
            Event::Forecast { .. } => "forecast",
            Event::Recovered { .. } => "recovered",
            Event::Order { .. } => "order",
            Event::Alarm { .. } => "alarm",
        }
    }

    /// The job whose state changed, and its state now.
    #[must_use]
    pub const fn job(&self) -> Option<(JobId, JobState)> {
        match self {
            Event::Fit { fit_id, state, .. } => Some((JobId::new(JobKind::Fit, *fit_id), *state)),
            Event::Calculation {
                kind,
                calculation_id,
                state,
                ..
            } => Some((JobId::new(*kind, *calculation_id), *state)),
            _ => None,
        }
    }

    /// Kind and number of the job that the event is about, as the store names them.
    #[must_use]
    pub fn job_number(&self) -> Option<(&str, i64)> {
        match self {
            Event::Fit { fit_id, .. } => Some((JobKind::Fit.as_str(), *fit_id)),
            Event::Calculation {
                kind,
                calculation_id,
                ..
            } => Some((kind.as_str(), *calculation_id)),
            Event::Forecast { of, number, .. } => Some((of, *number)),
            _ => None,
        }
    }

    /// Number of its scan.
    #[must_use]
    pub const fn scan_id(&self) -> Option<i64> {
        match self {
            Event::Rig { .. } => None,
            Event::Scan { scan_id, .. }
            | Event::Frame { scan_id, .. }
            | Event::Uncertainty { scan_id, .. } => Some(*scan_id),
            Event::Fit { scan_id, .. }
            | Event::Calculation { scan_id, .. }
            | Event::Forecast { scan_id, .. }
            | Event::Recovered { scan_id, .. }
            | Event::Order { scan_id, .. }
            | Event::Alarm { scan_id, .. } => *scan_id,
        }
    }
}

/// An event with its number and time: durable, then broadcast.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordedEvent {
    /// Number, growing without reuse; negative where the store does not have it.
    pub id: i64,
    /// When it was recorded.
    pub at: OffsetDateTime,
    /// What happened.
    pub event: Event,
    /// Who caused it: a token's name, `local` or `daemon`; `None` for an event of a program that did not record it.
    pub who: Option<String>,
}

impl RecordedEvent {
    /// An event that the store could not record: only those who listen when it is sent learn of it. Its number is
    /// negative and used once.
    #[must_use]
    pub fn unrecorded(at: OffsetDateTime, event: Event) -> RecordedEvent {
        static LAST: AtomicI64 = AtomicI64::new(0);
        let id = LAST.fetch_sub(1, Ordering::Relaxed) - 1;
        RecordedEvent {
            id,
            at,
            event,
            who: None,
        }
    }

    /// Whether the store has it.
    #[must_use]
    pub const fn is_recorded(&self) -> bool {
        self.id > 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_event_survives_its_json() {
        let event = Event::Scan {
            scan_id: 3,
            previous: ScanState::Running,
            state: ScanState::WaitingForOperator,
            reason: None,
            operator: Some(OperatorAction::PlaceWhiteReference),
            progress: Progress::default(),
        };
        let json = serde_json::to_value(&event).unwrap();
        assert_eq!(json["type"], event.kind());
        assert_eq!(json["operator"], "place-white-reference");
        assert_eq!(serde_json::from_value::<Event>(json).unwrap(), event);
    }
}
