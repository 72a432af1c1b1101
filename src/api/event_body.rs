//! What an event of `/events` looks like to a client.

use std::collections::BTreeMap;

use serde::Serialize;
use utoipa::ToSchema;

use super::frames::image_of;
use super::scans::ProgressBody;
use crate::forecast::Forecast;
use crate::frame::FrameKind;
use crate::job::{JobKind, JobState};
use crate::scan::event::{AxisEvent, OperatorStep, RigActivity, ShortValue, UncertainValue};
use crate::scan::{Event, RecordedEvent, ScanState};
use crate::store::utc_text;

/// An event: the object in `data`. Its `type` is also the name of the server-sent event.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Event)]
pub(super) struct EventBody {
    /// Number of the event, growing without reuse; negative for an event that the store does not have.
    id: i64,
    /// When it was recorded, RFC 3339 in UTC.
    at: String,
    /// Who caused it: the name of a token, `local` or `daemon`.
    who: Option<String>,
    /// What happened.
    #[serde(flatten)]
    what: WhatHappened,
}

/// Positions of both axes.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct EventAxes {
    /// Camera tilt θc.
    theta_c: AxisEvent,
    /// Sample azimuth φs.
    phi_s: AxisEvent,
}

/// What happened, by `type`.
#[derive(Debug, Serialize, ToSchema)]
#[serde(tag = "type", rename_all = "lowercase")]
pub(super) enum WhatHappened {
    /// The rig began or ended a move.
    Rig {
        /// Activity of the rig.
        activity: RigActivity,
        /// Its axes.
        axes: EventAxes,
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
        operator: Option<OperatorStep>,
        /// Progress of the scan.
        progress: ProgressBody,
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
        /// Path of its image.
        image: String,
        /// Progress of the scan.
        progress: ProgressBody,
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
        /// Time spent moving and exposing until the newest of its frames, s; without the time that it waited for people.
        elapsed_s: f64,
        /// Poses fitted.
        n_observations: usize,
        /// Frames used, dark and white-reference frames included.
        n_frames_used: u32,
        /// Variant of the fit.
        variant: String,
        /// How the fit ended.
        status: String,
        /// Parameters that the frames so far determine, by name.
        parameters: BTreeMap<String, UncertainValue>,
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
        /// Kind of the calculation.
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

impl From<RecordedEvent> for EventBody {
    fn from(recorded: RecordedEvent) -> Self {
        EventBody {
            id: recorded.id,
            at: utc_text(recorded.at),
            who: recorded.who,
            what: recorded.event.into(),
        }
    }
}

impl From<Event> for WhatHappened {
    fn from(event: Event) -> Self {
        match event {
            Event::Rig {
                activity,
                theta_c,
                phi_s,
            } => WhatHappened::Rig {
                activity,
                axes: EventAxes { theta_c, phi_s },
            },
            Event::Scan {
                scan_id,
                previous,
                state,
                reason,
                operator,
                progress,
            } => WhatHappened::Scan {
                scan_id,
                previous,
                state,
                reason,
                operator: operator.map(OperatorStep::from),
                progress: ProgressBody::new(&progress, state),
            },
            Event::Frame {
                scan_id,
                frame_id,
                kind,
                theta_c_deg,
                phi_s_deg,
                exposure_s,
                repeat,
                mean_dn,
                max_dn,
                saturated_px,
                accepted,
                reason,
                progress,
            } => WhatHappened::Frame {
                scan_id,
                frame_id,
                kind,
                theta_c_deg,
                phi_s_deg,
                exposure_s,
                repeat,
                mean_dn,
                max_dn,
                saturated_px,
                accepted,
                reason,
                image: image_of(frame_id),
                progress: ProgressBody::new(&progress, ScanState::Running),
            },
            Event::Fit {
                fit_id,
                scan_id,
                state,
                variant,
                status,
                theta_r_deg,
            } => WhatHappened::Fit {
                fit_id,
                scan_id,
                state,
                variant,
                status,
                theta_r_deg,
            },
            Event::Uncertainty { scan_id, certainty } => WhatHappened::Uncertainty {
                scan_id,
                elapsed_s: certainty.elapsed_s,
                n_observations: certainty.n_observations,
                n_frames_used: certainty.n_frames_used,
                variant: certainty.variant,
                status: certainty.status,
                parameters: certainty.parameters,
            },
            Event::Calculation {
                kind,
                calculation_id,
                scan_id,
                state,
            } => WhatHappened::Calculation {
                kind,
                calculation_id,
                scan_id,
                state,
            },
            Event::Forecast {
                of,
                number,
                scan_id,
                forecast,
            } => WhatHappened::Forecast {
                of,
                number,
                scan_id,
                forecast,
            },
            Event::Recovered {
                scan_id,
                code,
                message,
                took_s,
                points,
                attended,
            } => WhatHappened::Recovered {
                scan_id,
                code,
                message,
                took_s,
                points,
                attended,
            },
            Event::Order { order, scan_id } => WhatHappened::Order { order, scan_id },
            Event::Alarm {
                code,
                message,
                scan_id,
            } => WhatHappened::Alarm {
                code,
                message,
                scan_id,
            },
        }
    }
}
