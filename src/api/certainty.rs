//! `/scans/{id}/uncertainty`: uncertainties of the live fit of a scan against the rig's time.

use std::collections::BTreeMap;

use axum::Json;
use axum::extract::State;
use serde::Serialize;
use utoipa::ToSchema;

use super::extract::{Id, PageParams, Params, page};
use super::status::{ApiError, Problem};
use super::{App, List};
use crate::fit::report::{Status, VariantName};
use crate::scan::event::{Certainty, UncertainValue};
use crate::scan::{Event, RecordedEvent};
use crate::store::utc_text;

/// Result of the live fit of the frames so far.
#[derive(Debug, Serialize, ToSchema)]
pub struct CertaintyBody {
    /// Number of the event that reported it.
    id: i64,
    /// When it was reported, RFC 3339 in UTC.
    at: String,
    /// Time that the rig had spent moving and exposing, s, without waiting for the operator.
    elapsed_s: f64,
    /// Number of poses fitted.
    n_observations: usize,
    /// Number of frames used, including dark and white-reference frames.
    n_frames_used: u32,
    /// Variant of the model that gave the values.
    #[schema(value_type = VariantName)]
    variant: String,
    /// How the fit ended.
    #[schema(value_type = Status)]
    status: String,
    /// By name, without the parameters that the frames so far do not determine.
    parameters: BTreeMap<String, UncertainValue>,
}

impl CertaintyBody {
    fn of(recorded: RecordedEvent) -> Option<Self> {
        let Event::Uncertainty { certainty, .. } = recorded.event else {
            return None;
        };
        let Certainty {
            elapsed_s,
            n_observations,
            n_frames_used,
            variant,
            status,
            parameters,
        } = certainty;
        Some(CertaintyBody {
            id: recorded.id,
            at: utc_text(recorded.at),
            elapsed_s,
            n_observations,
            n_frames_used,
            variant,
            status,
            parameters,
        })
    }
}

/// Uncertainties during the scan, one row per live fit. While the scan runs, the same rows are sent as events of type
/// `uncertainty`.
#[utoipa::path(get, path = "/api/v1/scans/{id}/uncertainty", tag = "scans", params(("id" = i64, Path, description = "Number of the scan"), PageParams), responses(
    (status = 200, description = "A page of rows, oldest first", body = List<CertaintyBody>),
    (status = 404, description = "There is no such scan", body = Problem),
))]
pub(super) async fn of_scan(
    State(app): State<App>,
    Id(id): Id,
    Params(params): Params<PageParams>,
) -> Result<Json<List<CertaintyBody>>, ApiError> {
    let store = app.lab.store();
    store.scan(id).await?;
    let page = page(params.limit, params.cursor.as_deref())?;
    let found = store.scan_events(id, &["uncertainty"], page).await?;
    let mut list = List::after(&found);
    let rows = found.items.into_iter().filter_map(CertaintyBody::of);
    list.items = rows.collect();
    Ok(Json(list))
}
