//! The HTTP interface: routes with their OpenAPI description, problems, events and the page.
//!
//! [`router`] builds everything from a [`Lab`]; [`server::listen`] and [`server::serve`] serve it. There is one file per
//! noun. Only `status` knows status codes. A request passes `origin` (host and page), `authentication` (who sends it, and whether
//! `table` allows it), `guard` (its body) and `keys` (whether it was sent before). This module knows no hardware and no
//! settings.
//!
//! To add a route, write a handler in the noun's file with `#[utoipa::path]` (each response with a
//! description), add one line to `described` and one to `table`, and renew the snapshot `tests/data/openapi.json`.

mod access;
mod accuracy;
mod authentication;
mod caching;
mod calibrations;
mod caller;
mod certainty;
mod comparisons;
mod connections;
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
mod observations;
mod origin;
mod page;
mod peers;
mod previews;
mod queue;
mod recipes;
mod reports;
mod results;
mod rig;
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
use utoipa::{OpenApi, ToSchema};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::lab::{Lab, LabError};
use crate::store::{DamagedRow, Page, StoreError};

pub use access::Access;
pub use status::{ApiError, FieldProblem, OutOfRange, Problem};

/// Renders the metrics as text.
pub type RenderMetrics = Arc<dyn Fn() -> String + Send + Sync>;

/// State shared by all handlers.
#[derive(Clone)]
pub(crate) struct App {
    lab: Lab,
    render_metrics: RenderMetrics,
    openapi: Arc<str>,
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
    pub damaged: Vec<DamagedBody>,
}

/// A row that the store cannot read.
#[derive(Debug, Clone, Serialize, ToSchema)]
pub struct DamagedBody {
    /// Number of the row.
    id: i64,
    /// What is wrong with it.
    detail: String,
}

impl From<DamagedRow> for DamagedBody {
    fn from(row: DamagedRow) -> Self {
        let DamagedRow { id, detail } = row;
        DamagedBody { id, detail }
    }
}

impl<T, U: From<T>> From<Page<T>> for List<U> {
    fn from(page: Page<T>) -> Self {
        List {
            items: page.items.into_iter().map(U::from).collect(),
            next_cursor: page.next_cursor.map(|cursor| cursor.to_string()),
            damaged: page.damaged.into_iter().map(DamagedBody::from).collect(),
        }
    }
}

impl<U> List<U> {
    /// Returns an empty list with the cursor and the damaged rows of this page.
    fn after<T>(page: &Page<T>) -> Self {
        List {
            items: Vec::new(),
            next_cursor: page.next_cursor.map(|cursor| cursor.to_string()),
            damaged: page
                .damaged
                .iter()
                .cloned()
                .map(DamagedBody::from)
                .collect(),
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
                self.damaged.push(DamagedBody { id, detail });
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

#[derive(OpenApi)]
#[openapi(
    info(
        title = "ridged",
        description = "Drives a rig for surfaces of fine parallel ridges, keeps its frames, fits the ridge angle and states the uncertainty. Errors are RFC 9457 problems with a stable `code`. POSTs except stop, login, lease and preview may carry an `Idempotency-Key`, which is known for a day. Loopback needs no token, unless the settings ask for one; any other address needs one. `docs/reference/access.md` describes roles and the lease of the rig.",
        license(name = "MIT OR Apache-2.0")
    ),
    tags(
        (name = "rig", description = "The stages, one axis at a time"),
        (name = "samples", description = "Parts: names and materials. A part is a `sample` in routes and keys"),
        (name = "recipes", description = "How parts are measured, in versions"),
        (name = "specifications", description = "Limits of parts, in versions"),
        (name = "queue", description = "Parts in sequence, each measured by its recipe"),
        (name = "scans", description = "Series of frames"),
        (name = "frames", description = "16-bit images"),
        (name = "observations", description = "Frames reduced to numbers"),
        (name = "results", description = "One short row per scan: parts, values, verdicts"),
        (name = "comparisons", description = "Results beside each other: differences, repeatability, gauge R&R"),
        (name = "fits", description = "The model fitted to observations"),
        (name = "maps", description = "The model fitted to every pixel"),
        (name = "contrasts", description = "Contrast after rotation"),
        (name = "verdicts", description = "Judgement against a specification"),
        (name = "traces", description = "Polarised light through a scene"),
        (name = "calibrations", description = "Dark and white-reference frames"),
        (name = "events", description = "Changes of scans, frames, jobs and rig, as they happen"),
        (name = "access", description = "Who is logged in, and who holds the rig"),
        (name = "health", description = "For monitors"),
    )
)]
struct Document;

fn described() -> OpenApiRouter<App> {
    OpenApiRouter::with_openapi(Document::openapi())
        .routes(routes!(rig::get_rig))
        .routes(routes!(rig::move_axis))
        .routes(routes!(motions::move_rig))
        .routes(routes!(motions::motion))
        .routes(routes!(rig::home_axis))
        .routes(routes!(rig::home_both))
        .routes(routes!(rig::unpark_axis))
        .routes(routes!(rig::jog))
        .routes(routes!(previews::take))
        .routes(routes!(previews::image))
        .routes(routes!(previews::pixels))
        .routes(routes!(rig::accept_stages))
        .routes(routes!(rig::stop))
        .routes(routes!(samples::list, samples::add))
        .routes(routes!(samples::get, samples::rename))
        .routes(routes!(scans::list, scans::begin))
        .routes(routes!(scans::estimate))
        .routes(routes!(scans::get, scan_records::change))
        .routes(routes!(scan_records::changes))
        .routes(routes!(scans::command))
        .routes(routes!(certainty::of_scan))
        .routes(routes!(incidents::of_scan))
        .routes(routes!(recipes::list, recipes::add))
        .routes(routes!(recipes::get))
        .routes(routes!(recipes::versions, recipes::change))
        .routes(routes!(recipes::archive))
        .routes(routes!(recipes::restore))
        .routes(routes!(specifications::list, specifications::add))
        .routes(routes!(specifications::get))
        .routes(routes!(specifications::versions, specifications::change))
        .routes(routes!(specifications::archive))
        .routes(routes!(specifications::restore))
        .routes(routes!(queue::get_queue))
        .routes(routes!(queue::start))
        .routes(routes!(queue::stop))
        .routes(routes!(queue::pause))
        .routes(routes!(queue::resume))
        .routes(routes!(queue::proceed))
        .routes(routes!(queue::list, queue::add))
        .routes(routes!(queue::get, queue::remove))
        .routes(routes!(queue::move_to))
        .routes(routes!(queue::retry))
        .routes(routes!(reports::of_scan))
        .routes(routes!(imports::add))
        .routes(routes!(imports::upload))
        .routes(routes!(frames::of_scan))
        .routes(routes!(observations::of_scan))
        .routes(routes!(exports::brdf))
        .routes(routes!(exports::stack))
        .routes(routes!(exports::surface))
        .routes(routes!(exports::nexus))
        .routes(routes!(frames::get))
        .routes(routes!(frames::image))
        .routes(routes!(frames::preview))
        .routes(routes!(frames::pixels))
        .routes(routes!(results::list))
        .routes(routes!(comparisons::compare))
        .routes(routes!(comparisons::repeatability))
        .routes(routes!(fits::list, fits::begin))
        .routes(routes!(fits::get))
        .routes(routes!(fits::cancel))
        .routes(routes!(fits::curve))
        .routes(routes!(jobs::maps, jobs::begin_map))
        .routes(routes!(jobs::map))
        .routes(routes!(jobs::cancel_map))
        .routes(routes!(jobs::map_file))
        .routes(routes!(jobs::contrasts, jobs::begin_contrast))
        .routes(routes!(jobs::contrast))
        .routes(routes!(jobs::cancel_contrast))
        .routes(routes!(jobs::verdicts, jobs::begin_verdict))
        .routes(routes!(jobs::verdict))
        .routes(routes!(jobs::cancel_verdict))
        .routes(routes!(jobs::traces, jobs::begin_trace))
        .routes(routes!(jobs::trace))
        .routes(routes!(jobs::cancel_trace))
        .routes(routes!(jobs::trace_file))
        .routes(routes!(calibrations::list, calibrations::take))
        .routes(routes!(calibrations::get))
        .routes(routes!(accuracy::get))
        .routes(routes!(events::stream))
        .routes(routes!(session::get, session::login, session::logout))
        .routes(routes!(lease::get, lease::take, lease::release))
        .routes(routes!(health::healthz))
        .routes(routes!(health::readyz))
        .routes(routes!(health::metrics))
}

/// Returns the OpenAPI document, pretty-printed.
#[must_use]
pub fn openapi_json() -> String {
    let mut document = described().into_openapi();
    document::complete(&mut document);
    document
        .to_pretty_json()
        .expect("a document of text is JSON")
}

/// Routes that the document does not describe: the document itself.
const UNDESCRIBED: &[&str] = &["/openapi.json"];

/// Builds the whole HTTP interface of a lab for those who have access. Cancelling `ending` ends the event streams.
pub fn router(
    lab: Lab,
    render_metrics: RenderMetrics,
    ending: CancellationToken,
    access: Access,
) -> Router {
    health::describe_metrics();
    let access = Arc::new(access);
    let lease = Arc::clone(&access);
    lab.respect_lease(Arc::new(move || lease.lease.holder(lease.now())));
    let app = App {
        lab,
        render_metrics,
        openapi: openapi_json().into(),
        ending,
        key_locks: keys::KeyLocks::default(),
        access,
        peers: peers::Peers::new(server::limits().seats),
        uploads: Arc::new(Semaphore::new(imports::UPLOADS_MAX)),
    };
    let (routes, _) = described().split_for_parts();
    routes
        .route(UNDESCRIBED[0], get(health::openapi))
        .fallback(page::page)
        .method_not_allowed_fallback(async || {
            ApiError::method_not_allowed(
                "the route exists, but has no such method; /openapi.json lists all routes",
            )
            .into_response()
        })
        .layer(from_fn_with_state(app.clone(), keys::once_per_key))
        .layer(from_fn_with_state(app.clone(), guard::check_body))
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
