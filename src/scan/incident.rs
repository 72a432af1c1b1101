//! Incidents: the faults of a scan and their ends, as they stay on record.

use serde::Serialize;

use super::event::{Event, RecordedEvent};

/// Whether something went wrong or is over.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, utoipa::ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum IncidentKind {
    /// A fault.
    Alarm,
    /// The end of a fault: the scan continues.
    Recovered,
}

/// An alarm or a recovery.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
#[schema(as = IncidentBody)]
pub struct Incident {
    /// Number of the event.
    pub id: i64,
    /// When it was recorded, RFC 3339 in UTC.
    pub at: String,
    /// Whether it is a fault or the end of one.
    pub kind: IncidentKind,
    /// Stable word of the fault.
    pub code: String,
    /// What happened, as a sentence.
    pub message: String,
    /// Time from the fault to the first point that counted again, s; null for an alarm.
    pub took_s: Option<f64>,
    /// Points of the plan that were taken again, by their index.
    pub points: Vec<u32>,
    /// Whether a person resumed the scan in between; null for an alarm.
    pub attended: Option<bool>,
}

impl Incident {
    /// Kinds of the events that record incidents.
    pub const KINDS: [&str; 2] = ["alarm", "recovered"];

    /// Returns the incident that an event records; `at` is its time as text. `None` for events of other kinds.
    #[must_use]
    pub fn of(recorded: RecordedEvent, at: String) -> Option<Incident> {
        let id = recorded.id;
        match recorded.event {
            Event::Alarm { code, message, .. } => Some(Incident {
                id,
                at,
                kind: IncidentKind::Alarm,
                code,
                message,
                took_s: None,
                points: Vec::new(),
                attended: None,
            }),
            Event::Recovered {
                code,
                message,
                took_s,
                points,
                attended,
                ..
            } => Some(Incident {
                id,
                at,
                kind: IncidentKind::Recovered,
                code,
                message,
                took_s: Some(took_s),
                points,
                attended: Some(attended),
            }),
            _ => None,
        }
    }
}
