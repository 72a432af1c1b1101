//! `/scans/{id}/incidents`: the alarms and recoveries of a scan.

use axum::Json;
use axum::extract::State;
use serde::Serialize;
use utoipa::ToSchema;

use super::extract::{Id, PageParams, Params, page};
use super::status::{ApiError, Problem};
use super::{App, List};
use crate::scan::{Event, RecordedEvent};
use crate::store::utc_text;

/// Whether something went wrong or is over.
#[derive(Debug, Clone, Copy, Serialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum IncidentKind {
    /// A fault.
    Alarm,
    /// The end of a fault: the scan continues.
    Recovered,
}

/// An alarm or a recovery.
#[derive(Debug, Serialize, ToSchema)]
pub struct IncidentBody {
    /// Number of the event.
    id: i64,
    /// When it was recorded, RFC 3339 in UTC.
    at: String,
    /// Whether it is a fault or the end of one.
    kind: IncidentKind,
    /// Stable word of the fault.
    code: String,
    /// What happened, as a sentence.
    message: String,
    /// Time from the fault to the first point that counted again, s; null for an alarm.
    took_s: Option<f64>,
    /// Points of the plan that were taken again, by their index.
    points: Vec<u32>,
    /// Whether a person resumed the scan in between; null for an alarm.
    attended: Option<bool>,
}

impl IncidentBody {
    fn of(recorded: RecordedEvent) -> Option<IncidentBody> {
        let (id, at) = (recorded.id, utc_text(recorded.at));
        match recorded.event {
            Event::Alarm { code, message, .. } => Some(IncidentBody {
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
            } => Some(IncidentBody {
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

/// Faults of a scan and how it recovered from them. While the scan runs, the same rows are sent as events of type `alarm`
/// and `recovered`.
#[utoipa::path(get, path = "/api/v1/scans/{id}/incidents", tag = "scans", params(("id" = i64, Path, description = "Number of the scan"), PageParams), responses(
    (status = 200, description = "A page of rows, oldest first", body = List<IncidentBody>),
    (status = 404, description = "There is no such scan", body = Problem),
))]
pub(super) async fn of_scan(
    State(app): State<App>,
    Id(id): Id,
    Params(params): Params<PageParams>,
) -> Result<Json<List<IncidentBody>>, ApiError> {
    let store = app.lab.store();
    store.scan(id).await?;
    let page = page(params.limit, params.cursor.as_deref())?;
    let mut found = store
        .incidents(id, page.cursor.unwrap_or(0), page.limit + 1)
        .await?;
    let more = found.len() > page.limit as usize;
    found.truncate(page.limit as usize);
    let next_cursor = more
        .then(|| found.last().map(|e| e.id.to_string()))
        .flatten();
    Ok(Json(List {
        items: found.into_iter().filter_map(IncidentBody::of).collect(),
        next_cursor,
        damaged: Vec::new(),
    }))
}
