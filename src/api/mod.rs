//! The HTTP interface: routes with their OpenAPI description, problems, events and the page.
//!
//! [`router`] builds everything from a [`Lab`]; [`server::listen`] and [`server::serve`] serve it. There is one file per
//! noun. Only `status` knows status codes. This module knows no hardware and no settings.
//!
//! A request passes `origin` (host and page), `authentication` (who sends it, and whether `table` allows it), `guard` (its body),
//! `parameters` (of routes without any) and `keys` (whether it was sent before), in this order.
//!
//! To add a route, write a handler in the noun's file with `#[utoipa::path]` (each response with a description) and an entry of
//! the list in `routes`, which states what a request needs. Then renew `openapi.json` (`tests/it/http/document.rs` says how).

mod access;
mod accuracy;
mod authentication;
mod caching;
mod calibrations;
mod caller;
mod certainty;
mod charts;
mod comparisons;
mod connections;
mod definitions;
mod document;
mod event_body;
mod events;
mod exports;
mod extract;
mod fields;
mod fits;
mod frames;
mod guard;
mod health;
mod holder;
mod imports;
mod incidents;
mod job_body;
mod jobs;
mod keys;
mod lease;
mod motions;
mod need;
mod observations;
mod origin;
mod page;
mod parameters;
mod peers;
mod previews;
mod queue;
mod recipes;
mod reports;
mod results;
mod rig;
mod routes;
mod samples;
mod scan_records;
mod scans;
mod seats;
pub mod server;
mod session;
mod specifications;
mod status;
mod table;
mod tls;
mod via;

use std::sync::Arc;

use axum::Router;
use axum::middleware::{from_fn, from_fn_with_state};
use axum::response::IntoResponse;
use axum::routing::get;
use serde::Serialize;
use tokio::sync::Semaphore;
use tokio_util::sync::CancellationToken;
use tower_http::catch_panic::CatchPanicLayer;
use tower_http::compression::CompressionLayer;
use tower_http::compression::predicate::{DefaultPredicate, NotForContentType, Predicate};
use tower_http::decompression::RequestDecompressionLayer;
use utoipa::ToSchema;

use crate::lab::{Lab, LabError};
use crate::store::{DamagedRow, Page, StoreError};

pub use access::Access;
pub use document::{openapi, openapi_of_handlers};
pub use scans::EstimateBody;
pub use status::{ApiError, FieldProblem, OutOfRange, Problem};

/// Renders the metrics as text.
pub type RenderMetrics = Arc<dyn Fn() -> String + Send + Sync>;

/// State shared by all handlers.
#[derive(Clone)]
pub(crate) struct App {
    lab: Lab,
    render_metrics: RenderMetrics,
    /// Ends the event streams, which would otherwise keep the server running.
    ending: CancellationToken,
    /// Locks for requests with an Idempotency-Key.
    key_locks: keys::KeyLocks,
    access: Arc<Access>,
    peers: peers::Peers,
    /// One permit for each upload in progress.
    uploads: Arc<Semaphore>,
}

/// A page of a list.
#[derive(Debug, Serialize, ToSchema)]
pub struct List<T> {
    /// The rows of this page.
    pub items: Vec<T>,
    /// `cursor` of the next page; null at the end.
    pub next_cursor: Option<String>,
    /// Rows of this page that the store cannot read; omitted if there are none.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub damaged: Vec<DamagedRow>,
}

impl<T, U: From<T>> From<Page<T>> for List<U> {
    fn from(page: Page<T>) -> Self {
        List {
            items: page.items.into_iter().map(U::from).collect(),
            next_cursor: page.next_cursor.map(|cursor| cursor.to_string()),
            damaged: page.damaged,
        }
    }
}

impl<U> List<U> {
    /// Returns an empty list with the cursor and the damaged rows of this page.
    fn after<T>(page: &Page<T>) -> Self {
        List {
            items: Vec::new(),
            next_cursor: page.next_cursor.map(|cursor| cursor.to_string()),
            damaged: page.damaged.clone(),
        }
    }

    /// Adds a row, or lists it as damaged.
    ///
    /// # Errors
    /// Any error other than a damaged row.
    fn take(&mut self, id: i64, answer: Result<U, LabError>) -> Result<(), ApiError> {
        match answer {
            Ok(item) => self.items.push(item),
            Err(error @ (LabError::Store(StoreError::BadRow { .. }) | LabError::Series(_))) => {
                let detail = error.to_string();
                self.damaged.push(DamagedRow { id, detail });
            }
            Err(error) => return Err(error.into()),
        }
        Ok(())
    }
}

/// The answer to a request for work that takes longer than the request.
#[derive(Debug, Serialize, ToSchema)]
pub struct Begun {
    /// Number of the new row; null for a motion.
    pub id: Option<i64>,
    /// Its state now.
    pub state: String,
}

/// Path of the document, the only route that the document does not describe.
const DOCUMENT: &str = "/openapi.json";

/// Builds the HTTP interface of a lab. `access` decides who may use it. Cancelling `ending` ends the event streams.
pub fn router(
    lab: Lab,
    render_metrics: RenderMetrics,
    ending: CancellationToken,
    access: Access,
) -> Router {
    health::describe_metrics();
    let access = Arc::new(access);
    let lease = Arc::clone(&access);
    lab.respect_lease(Arc::new(move || lease.lease().holder(lease.now())));
    let app = App {
        lab,
        render_metrics,
        ending,
        key_locks: keys::KeyLocks::default(),
        access,
        peers: peers::Peers::new(server::limits().seats),
        uploads: Arc::new(Semaphore::new(imports::UPLOADS_MAX)),
    };
    routes::routes()
        .route(DOCUMENT, get(health::openapi))
        .fallback(page::page)
        .method_not_allowed_fallback(async || {
            ApiError::method_not_allowed(
                "the route exists, but has no such method; /openapi.json lists all routes",
            )
            .into_response()
        })
        .layer(from_fn_with_state(app.clone(), keys::once_per_key))
        .layer(from_fn_with_state(app.clone(), guard::check_disk))
        .layer(from_fn(parameters::refuse_unknown))
        .layer(from_fn_with_state(app.clone(), guard::check_body))
        // The limits of a body count what is unpacked.
        .layer(RequestDecompressionLayer::new().pass_through_unaccepted(true))
        .layer(from_fn(guard::mark_packed))
        .layer(CatchPanicLayer::custom(panicked))
        .layer(CompressionLayer::new().compress_when(compressible()))
        .layer(from_fn_with_state(
            app.clone(),
            authentication::authenticate,
        ))
        .layer(from_fn_with_state(
            app.clone(),
            origin::same_machine_same_page,
        ))
        .layer(from_fn(guard::measure))
        .with_state(app)
}

/// Frames are noise and fonts are compressed already; events must not wait for a full buffer.
fn compressible() -> impl Predicate {
    DefaultPredicate::new()
        .and(NotForContentType::const_new("application/octet-stream"))
        .and(NotForContentType::const_new("font/"))
}

fn panicked(_: Box<dyn std::any::Any + Send>) -> axum::response::Response {
    tracing::error!("a handler panicked; the message is above");
    ApiError::internal().into_response()
}
