//! Corrections of `/scans/{id}`: its part, tags, note and archived flag, and the trace of who changed them.

use axum::Json;
use axum::extract::State;
use serde::{Deserialize, Deserializer};
use utoipa::ToSchema;

use super::caller::Caller;
use super::extract::{Body, Id, PageParams, Params, page};
use super::scans::{ScanBody, body};
use super::status::{ApiError, Problem};
use super::{App, List};
use crate::store::records::{RecordChange, RecordPatch};

/// What changes of a scan; a field that is omitted stays as it is.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ScanPatch {
    /// Number of the part that was scanned.
    #[serde(default)]
    #[schema(minimum = 1, maximum = 9_007_199_254_740_991_i64)]
    sample_id: Option<i64>,
    /// All tags from now on, at most 20: each 1 to 40 characters without comma, quote and backslash.
    #[serde(default)]
    #[schema(max_items = 20)]
    tags: Option<Vec<String>>,
    /// The note from now on, at most 4000 characters; null or an empty text removes it.
    #[serde(default, deserialize_with = "stated")]
    #[schema(value_type = Option<String>, max_length = 4000)]
    note: Option<Option<String>>,
    /// Whether lists leave the scan out from now on.
    #[serde(default)]
    archived: Option<bool>,
}

/// Distinguishes null from a field that is omitted.
fn stated<'de, D: Deserializer<'de>>(from: D) -> Result<Option<Option<String>>, D::Error> {
    Option::deserialize(from).map(Some)
}

/// Correct a scan: assign it to another part, or change its tags, note and archived flag. What was there before stays on
/// record, so another request undoes it. A completed scan of a part with another material is fitted again.
#[utoipa::path(patch, path = "/api/v1/scans/{id}", tag = "scans", params(("id" = i64, Path, description = "Number of the scan")),
    request_body = ScanPatch, responses(
    (status = 200, description = "The scan", body = ScanBody),
    (status = 400, description = "The body cannot be read", body = Problem),
    (status = 404, description = "There is no such scan or part", body = Problem),
    (status = 409, description = "The scan holds the rig and cannot be assigned to another part", body = Problem),
    (status = 422, description = "A value is not valid", body = Problem),
    (status = 503, description = "The store cannot be written (`store-locked`, `disk-silent`, `data-folder-gone`)", body = Problem),
    (status = 507, description = "The disk is full (`disk-full`)", body = Problem),
))]
pub(super) async fn change(
    Caller(app): Caller,
    Id(id): Id,
    Body(wanted): Body<ScanPatch>,
) -> Result<Json<ScanBody>, ApiError> {
    let patch = RecordPatch {
        tags: wanted.tags,
        note: wanted.note,
        archived: wanted.archived,
    };
    if let Some((field, problem)) = patch.fault() {
        return Err(ApiError::invalid(field, problem));
    }
    let scan = match wanted.sample_id {
        Some(sample_id) => {
            let assigned = app.lab.assign_scan(id, sample_id).await?;
            match patch.is_empty() {
                true => assigned,
                false => app.lab.change_record(id, &patch).await?,
            }
        }
        None if patch.is_empty() => {
            let problem = "expected sample_id, tags, note or archived";
            return Err(ApiError::invalid("body", problem));
        }
        None => app.lab.change_record(id, &patch).await?,
    };
    Ok(Json(body(&app, scan).await?))
}

/// Changes of tags, note and archived flag of a scan, oldest first, with who made them.
#[utoipa::path(get, path = "/api/v1/scans/{id}/changes", tag = "scans", params(("id" = i64, Path, description = "Number of the scan"), PageParams), responses(
    (status = 200, description = "A page of changes", body = List<RecordChange>),
    (status = 404, description = "There is no such scan", body = Problem),
))]
pub(super) async fn changes(
    State(app): State<App>,
    Id(id): Id,
    Params(params): Params<PageParams>,
) -> Result<Json<List<RecordChange>>, ApiError> {
    let page = page(params.limit, params.cursor.as_deref())?;
    let found = app.lab.store().record_changes(id, page).await?;
    Ok(Json(found.into()))
}
