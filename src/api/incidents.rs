//! `/scans/{id}/incidents`: the alarms and recoveries of a scan.

use axum::Json;
use axum::extract::State;

use super::extract::{Id, PageParams, Params, page};
use super::status::{ApiError, Problem};
use super::{App, List};
use crate::scan::Incident;
use crate::store::utc_text;

/// Faults of a scan and how it recovered from them. While the scan runs, the same rows are sent as events of type `alarm`
/// and `recovered`.
#[utoipa::path(get, path = "/api/v1/scans/{id}/incidents", tag = "scans", params(("id" = i64, Path, description = "Number of the scan"), PageParams), responses(
    (status = 200, description = "A page of rows, oldest first", body = List<Incident>),
    (status = 404, description = "There is no such scan", body = Problem),
))]
pub(super) async fn of_scan(
    State(app): State<App>,
    Id(id): Id,
    Params(params): Params<PageParams>,
) -> Result<Json<List<Incident>>, ApiError> {
    let store = app.lab.store();
    store.scan(id).await?;
    let page = page(params.limit, params.cursor.as_deref())?;
    let found = store.scan_events(id, &Incident::KINDS, page).await?;
    let mut list = List::after(&found);
    let incidents = found.items.into_iter().filter_map(|recorded| {
        let at = utc_text(recorded.at);
        Incident::of(recorded, at)
    });
    list.items = incidents.collect();
    Ok(Json(list))
}
