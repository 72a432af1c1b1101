//! `/queue`: orders in sequence, and what the queue does with them.

use axum::Json;
use axum::extract::State;
use axum::response::Response;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::caller::Caller;
use super::extract::{Body, Id, Params, page};
use super::status::{self, ApiError, Problem};
use super::{App, List};
use crate::lab::{LabError, OrderRequest, QueueView};
use crate::scan::ScanState;
use crate::scan::event::OperatorStep;
use crate::scan::faults::OnFailure;
use crate::store::queue::{OrderState, QueueOrder, QueueState};

/// A recipe or specification of an order. Its newest version at the start of the scan counts.
#[derive(Debug, Clone, Serialize, ToSchema)]
pub struct DefinitionName {
    /// Number of the recipe or specification.
    id: i64,
    /// Name, unique among recipes or among specifications.
    name: String,
}

impl From<(i64, String)> for DefinitionName {
    fn from((id, name): (i64, String)) -> Self {
        DefinitionName { id, name }
    }
}

/// An order of the queue.
#[derive(Debug, Clone, Serialize, ToSchema)]
pub struct OrderBody {
    /// Number of the order.
    id: i64,
    /// Number of the part.
    sample_id: i64,
    /// Name of the part.
    part: String,
    /// How the part is measured.
    recipe: DefinitionName,
    /// The specification; null if the part is not judged.
    specification: Option<DefinitionName>,
    /// Lot of the part.
    lot: Option<String>,
    /// Number of the part or order in another system.
    external_id: Option<String>,
    /// The person at the rig.
    operator_name: Option<String>,
    /// Free text.
    note: Option<String>,
    /// State of the order.
    state: OrderState,
    /// Why it failed, or waits again.
    reason: Option<String>,
    /// Its newest scan; null before the first.
    scan_id: Option<i64>,
    /// The verdict of that scan: pass, fail or cannot-tell; null without one.
    verdict: Option<String>,
    /// How often it failed.
    failures: i64,
    /// Who added it: the name of a token, or `local`.
    who: String,
    /// When it was added, RFC 3339 in UTC.
    created_at: String,
}

async fn body(app: &App, order: QueueOrder) -> Result<OrderBody, LabError> {
    let verdict = match (order.scan_id, &order.specification) {
        (Some(scan_id), Some(_)) => app.lab.outcome(scan_id).await?.verdict()?,
        _ => None,
    };
    Ok(OrderBody {
        id: order.id,
        sample_id: order.sample_id,
        part: order.sample_name,
        recipe: order.recipe.into(),
        specification: order.specification.map(DefinitionName::from),
        lot: order.lot,
        external_id: order.external_id,
        operator_name: order.operator_name,
        note: order.note,
        state: order.state,
        reason: order.reason,
        scan_id: order.scan_id,
        verdict: verdict.map(|(word, _)| word),
        failures: order.failures,
        who: order.who,
        created_at: order.created_at,
    })
}

/// Number of orders by state.
#[derive(Debug, Default, Serialize, ToSchema)]
pub struct OrderCounts {
    /// Orders that wait.
    waiting: i64,
    /// Orders whose scan has begun.
    running: i64,
    /// Orders whose scan is completed.
    done: i64,
    /// Orders that failed.
    failed: i64,
    /// Orders that were removed.
    removed: i64,
}

/// The order whose scan has begun and has not ended.
#[derive(Debug, Serialize, ToSchema)]
pub struct CurrentOrder {
    /// Its part, recipe and state.
    order: OrderBody,
    /// State of its scan.
    scan_state: ScanState,
    /// The operator step that it waits for; place-sample asks for this part.
    operator: Option<OperatorStep>,
}

/// The queue.
#[derive(Debug, Serialize, ToSchema)]
pub struct QueueBody {
    /// State of the queue.
    state: QueueState,
    /// Reason for the state, if a person did not ask for it.
    reason: Option<String>,
    /// Who changed the state: the name of a token, `local`, or `daemon`; null before the first change.
    who: Option<String>,
    /// When the state changed, RFC 3339 in UTC; null before the first change.
    changed_at: Option<String>,
    /// What the queue does or waits for, as sentences.
    message: String,
    /// The present order; null if none has begun.
    current: Option<CurrentOrder>,
    /// The order that begins next; null if none waits.
    next: Option<OrderBody>,
    /// Number of orders by state.
    counts: OrderCounts,
    /// What follows a failed order (setting `queue.on_failure`).
    on_failure: OnFailure,
}

async fn queue_body(app: &App, view: QueueView) -> Result<Json<QueueBody>, ApiError> {
    let mut counts = OrderCounts::default();
    for (state, n) in view.counts {
        *match state {
            OrderState::Waiting => &mut counts.waiting,
            OrderState::Running => &mut counts.running,
            OrderState::Done => &mut counts.done,
            OrderState::Failed => &mut counts.failed,
            OrderState::Removed => &mut counts.removed,
        } = n;
    }
    let current = match view.current {
        Some((order, scan)) => Some(CurrentOrder {
            order: body(app, order).await?,
            scan_state: scan.state,
            operator: scan.operator.map(OperatorStep::from),
        }),
        None => None,
    };
    let next = match view.next {
        Some(order) => Some(body(app, order).await?),
        None => None,
    };
    Ok(Json(QueueBody {
        state: view.now.state,
        reason: view.now.reason,
        who: view.now.at.is_some().then_some(view.now.who),
        changed_at: view.now.at,
        message: view.message,
        current,
        next,
        counts,
        on_failure: view.on_failure,
    }))
}

/// The queue: its state, its present and its next order.
#[utoipa::path(get, path = "/api/v1/queue", tag = "queue", responses(
    (status = 200, description = "The queue", body = QueueBody),
))]
pub(super) async fn get_queue(State(app): State<App>) -> Result<Json<QueueBody>, ApiError> {
    queue_body(&app, app.lab.queue().await?).await
}

/// Start the queue, or resume a paused one and the scan of its order. Orders begin one after the other, for this caller. The
/// scan of each asks for its part by the operator step place-sample. It stops when no order waits.
#[utoipa::path(post, path = "/api/v1/queue/start", tag = "queue", responses(
    (status = 200, description = "The queue", body = QueueBody),
    (status = 409, description = "No order waits, or the scan cannot be resumed", body = Problem),
    (status = 503, description = "The stages are not available", body = Problem),
))]
pub(super) async fn start(Caller(app): Caller) -> Result<Json<QueueBody>, ApiError> {
    queue_body(&app, app.lab.start_queue().await?).await
}

/// Stop the queue after the present order; at once if none has begun.
#[utoipa::path(post, path = "/api/v1/queue/stop", tag = "queue", responses(
    (status = 200, description = "The queue", body = QueueBody),
))]
pub(super) async fn stop(Caller(app): Caller) -> Result<Json<QueueBody>, ApiError> {
    queue_body(&app, app.lab.stop_queue().await?).await
}

/// Pause the queue and the scan of its present order.
#[utoipa::path(post, path = "/api/v1/queue/pause", tag = "queue", responses(
    (status = 200, description = "The queue", body = QueueBody),
    (status = 409, description = "The queue is stopped", body = Problem),
))]
pub(super) async fn pause(Caller(app): Caller) -> Result<Json<QueueBody>, ApiError> {
    queue_body(&app, app.lab.pause_queue().await?).await
}

/// Resume a paused queue and the scan of its order: the same as a start.
#[utoipa::path(post, path = "/api/v1/queue/resume", tag = "queue", responses(
    (status = 200, description = "The queue", body = QueueBody),
    (status = 409, description = "No order waits, or the scan cannot be resumed", body = Problem),
    (status = 503, description = "The stages are not available", body = Problem),
))]
pub(super) async fn resume(Caller(app): Caller) -> Result<Json<QueueBody>, ApiError> {
    queue_body(&app, app.lab.start_queue().await?).await
}

/// Confirm the operator step of the present order, for instance that its part is on the table.
#[utoipa::path(post, path = "/api/v1/queue/continue", tag = "queue", responses(
    (status = 200, description = "The queue", body = QueueBody),
    (status = 409, description = "No order waits for a step", body = Problem),
))]
pub(super) async fn proceed(Caller(app): Caller) -> Result<Json<QueueBody>, ApiError> {
    queue_body(&app, app.lab.continue_queue().await?).await
}

/// Orders to add.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct OrdersRequest {
    /// 1 to 1000 orders, in sequence.
    #[schema(min_items = 1, max_items = 1000)]
    orders: Vec<OrderRequest>,
}

/// Filter of the list.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct OrderParams {
    /// Orders in this state; if omitted, those that run or wait.
    state: Option<OrderState>,
    /// Largest number of rows, 1 to 1000; 100 if omitted.
    #[param(minimum = 1, maximum = 1000)]
    limit: Option<u32>,
    /// `next_cursor` of the previous page.
    cursor: Option<String>,
}

/// Orders in sequence.
#[utoipa::path(get, path = "/api/v1/queue/orders", tag = "queue", params(OrderParams), responses(
    (status = 200, description = "A page of orders", body = List<OrderBody>),
))]
pub(super) async fn list(
    State(app): State<App>,
    Params(params): Params<OrderParams>,
) -> Result<Json<List<OrderBody>>, ApiError> {
    let page = page(params.limit, params.cursor.as_deref())?;
    let states = match params.state {
        Some(state) => vec![state],
        None => vec![OrderState::Running, OrderState::Waiting],
    };
    let found = app.lab.store().queue_orders(&states, page).await?;
    let mut list = List::after(&found);
    for order in found.items {
        list.take(order.id, body(&app, order).await)?;
    }
    Ok(Json(list))
}

/// Add orders at the end of the queue: all of them or none.
#[utoipa::path(post, path = "/api/v1/queue/orders", tag = "queue", request_body = OrdersRequest, responses(
    (status = 201, description = "The orders", body = List<OrderBody>),
    (status = 400, description = "The body cannot be read", body = Problem),
    (status = 409, description = "Another order has the external id (`external-id-taken`)", body = Problem),
    (status = 422, description = "A value is not valid; its field names the order, as `orders[3].recipe`", body = Problem),
))]
pub(super) async fn add(
    Caller(app): Caller,
    Body(request): Body<OrdersRequest>,
) -> Result<Response, ApiError> {
    let added = app.lab.add_orders(&request.orders).await?;
    let mut items = Vec::with_capacity(added.len());
    for order in added {
        items.push(body(&app, order).await?);
    }
    Ok(status::made(List {
        items,
        next_cursor: None,
        damaged: Vec::new(),
    }))
}

/// One order.
#[utoipa::path(get, path = "/api/v1/queue/orders/{id}", tag = "queue",
    params(("id" = i64, Path, description = "Number of the order")), responses(
    (status = 200, description = "The order", body = OrderBody),
    (status = 404, description = "Not found", body = Problem),
))]
pub(super) async fn get(State(app): State<App>, Id(id): Id) -> Result<Json<OrderBody>, ApiError> {
    let order = app.lab.store().queue_order(id).await?;
    Ok(Json(body(&app, order).await?))
}

/// Where to move an order.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct MoveRequest {
    /// Place among the waiting orders, from 1 (the next one); beyond the last one, the end.
    #[schema(minimum = 1, maximum = 4_294_967_295_i64)]
    to: u32,
}

/// Move a waiting order.
#[utoipa::path(post, path = "/api/v1/queue/orders/{id}/move", tag = "queue",
    params(("id" = i64, Path, description = "Number of the order")), request_body = MoveRequest, responses(
    (status = 200, description = "The order", body = OrderBody),
    (status = 400, description = "The body cannot be read", body = Problem),
    (status = 404, description = "Not found", body = Problem),
    (status = 409, description = "The order does not wait", body = Problem),
    (status = 422, description = "A value is not valid", body = Problem),
))]
pub(super) async fn move_to(
    Caller(app): Caller,
    Id(id): Id,
    Body(request): Body<MoveRequest>,
) -> Result<Json<OrderBody>, ApiError> {
    let order = app.lab.move_order(id, request.to).await?;
    Ok(Json(body(&app, order).await?))
}

/// Remove a waiting or failed order. It stays on record.
#[utoipa::path(delete, path = "/api/v1/queue/orders/{id}", tag = "queue",
    params(("id" = i64, Path, description = "Number of the order")), responses(
    (status = 200, description = "The removed order", body = OrderBody),
    (status = 404, description = "Not found", body = Problem),
    (status = 409, description = "The order neither waits nor failed", body = Problem),
    (status = 503, description = "The store cannot be written (`store-locked`, `disk-silent`, `data-folder-gone`)", body = Problem),
    (status = 507, description = "The disk is full (`disk-full`)", body = Problem),
))]
pub(super) async fn remove(Caller(app): Caller, Id(id): Id) -> Result<Json<OrderBody>, ApiError> {
    let order = app.lab.remove_order(id).await?;
    Ok(Json(body(&app, order).await?))
}

/// Let a failed order wait again, as the next one.
#[utoipa::path(post, path = "/api/v1/queue/orders/{id}/retry", tag = "queue",
    params(("id" = i64, Path, description = "Number of the order")), responses(
    (status = 200, description = "The order", body = OrderBody),
    (status = 404, description = "Not found", body = Problem),
    (status = 409, description = "The order has not failed", body = Problem),
))]
pub(super) async fn retry(Caller(app): Caller, Id(id): Id) -> Result<Json<OrderBody>, ApiError> {
    let order = app.lab.retry_order(id).await?;
    Ok(Json(body(&app, order).await?))
}
