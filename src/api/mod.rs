//! HTTP: routes and their description from one source, problems, events, the page.
//!
//! [`router`] makes the whole from a [`Lab`]; [`server::bind`] and [`server::serve`] put it on a
//! loopback address. One file per noun; `error` alone knows status codes, `guard` alone knows who
//! may come in. This room knows no hardware and no settings.
//!
//! To add a route: a handler in the noun's file with `#[utoipa::path]` (each response with a
//! description), one line in [`router`], and the snapshot in `tests/data/openapi.json` renewed.

mod accuracy;
mod answered;
mod asked;
mod caching;
mod calibrations;
mod certainty;
mod connections;
mod document;
mod error;
mod events;
mod extract;
mod fits;
mod frames;
mod guard;
mod health;
mod imports;
mod jobs;
mod observations;
mod page;
mod rig;
mod samples;
mod scans;
pub mod server;
mod words;

use std::sync::Arc;

use axum::Router;
use axum::middleware::{from_fn, from_fn_with_state};
use axum::response::IntoResponse;
use axum::routing::get;
use serde::Serialize;
use tokio_util::sync::CancellationToken;
use tower_http::catch_panic::CatchPanicLayer;
use utoipa::{OpenApi, ToSchema};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::lab::{Lab, LabError};
use crate::store::{DamagedRow, Page, StoreError};

pub use error::{ApiError, FieldProblem, Problem};

/// Gives the metrics as text.
pub type RenderMetrics = Arc<dyn Fn() -> String + Send + Sync>;

/// What every handler may use.
#[derive(Clone)]
pub(crate) struct App {
    lab: Lab,
    render_metrics: RenderMetrics,
    openapi: Arc<str>,
    /// Ends the event streams, which would otherwise keep the server alive.
    ending: CancellationToken,
    /// One turn for requests with an Idempotency-Key.
    turns: guard::Turns,
}

/// A list as all lists are.
#[derive(Debug, Serialize, ToSchema)]
pub struct List<T> {
    /// The rows of this page.
    pub items: Vec<T>,
    /// Hand it back as `cursor` for the next page; null at the end.
    pub next_cursor: Option<String>,
    /// Rows of this page that the store cannot read; left out where there are none.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub damaged: Vec<DamagedBody>,
}

/// A row that does not hold what was written into it.
#[derive(Debug, Clone, Serialize, ToSchema)]
pub struct DamagedBody {
    /// Its number.
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
    /// A list of no rows yet, after this page.
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

    /// Takes in what a row answers. One that is damaged stands beside the others.
    ///
    /// # Errors
    /// What went wrong besides.
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

/// The answer to what takes longer than a request.
#[derive(Debug, Serialize, ToSchema)]
pub struct Begun {
    /// Number of what was begun; null for a motion.
    pub id: Option<i64>,
    /// State it is in now.
    pub state: String,
}

#[derive(OpenApi)]
#[openapi(
    info(
        title = "ridged",
        description = "Drives a rig for surfaces of fine parallel ridges, keeps its frames, fits the ridge angle and states the uncertainty. Loopback only. Errors are RFC 9457 problems with a stable `code`. POSTs may carry an `Idempotency-Key`, but for the stop, which acts each time.",
        license(name = "MIT OR Apache-2.0")
    ),
    tags(
        (name = "rig", description = "The stages, one axis at a time"),
        (name = "samples", description = "What is measured"),
        (name = "scans", description = "Series of frames"),
        (name = "frames", description = "16-bit images"),
        (name = "observations", description = "Frames reduced to numbers"),
        (name = "fits", description = "The model fitted to observations"),
        (name = "maps", description = "The model fitted to every pixel"),
        (name = "contrasts", description = "Contrast after rotation"),
        (name = "verdicts", description = "Judgement against a specification"),
        (name = "traces", description = "Polarised light through a scene"),
        (name = "calibrations", description = "Dark and white-reference frames"),
        (name = "events", description = "What happens, as it happens"),
        (name = "health", description = "For monitors"),
    )
)]
struct Document;

fn described() -> OpenApiRouter<App> {
    OpenApiRouter::with_openapi(Document::openapi())
        .routes(routes!(rig::get_rig))
        .routes(routes!(rig::move_axis))
        .routes(routes!(rig::home_axis))
        .routes(routes!(rig::unpark_axis))
        .routes(routes!(rig::stop))
        .routes(routes!(samples::list, samples::add))
        .routes(routes!(samples::get))
        .routes(routes!(scans::list, scans::begin))
        .routes(routes!(scans::estimate))
        .routes(routes!(scans::get))
        .routes(routes!(scans::command))
        .routes(routes!(certainty::of_scan))
        .routes(routes!(imports::add))
        .routes(routes!(frames::of_scan))
        .routes(routes!(observations::of_scan))
        .routes(routes!(frames::get))
        .routes(routes!(frames::image))
        .routes(routes!(frames::pixels))
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
        .routes(routes!(health::healthz))
        .routes(routes!(health::readyz))
        .routes(routes!(health::metrics))
}

/// The OpenAPI document, pretty-printed.
#[must_use]
pub fn openapi_json() -> String {
    let mut document = described().into_openapi();
    document::complete(&mut document);
    document
        .to_pretty_json()
        .expect("a document of text is JSON")
}

/// The whole HTTP interface of a lab. `ending` is cancelled when the server shall end.
pub fn router(lab: Lab, render_metrics: RenderMetrics, ending: CancellationToken) -> Router {
    health::describe_metrics();
    let app = App {
        lab,
        render_metrics,
        openapi: openapi_json().into(),
        ending,
        turns: guard::Turns::default(),
    };
    let (routes, _) = described().split_for_parts();
    routes
        .route("/openapi.json", get(health::openapi))
        .fallback(page::page)
        .method_not_allowed_fallback(async || {
            ApiError::new(
                axum::http::StatusCode::METHOD_NOT_ALLOWED,
                "method-not-allowed",
                "not with this method",
                "the route exists, but not with this method; /openapi.json lists them",
            )
            .into_response()
        })
        .layer(from_fn_with_state(app.clone(), guard::once_per_key))
        .layer(from_fn(guard::check_body))
        .layer(CatchPanicLayer::custom(panicked))
        .layer(from_fn(guard::same_machine_same_page))
        .layer(from_fn(guard::measure))
        .with_state(app)
}

fn panicked(_: Box<dyn std::any::Any + Send>) -> axum::response::Response {
    tracing::error!("a handler panicked; the message is above");
    ApiError::new(
        axum::http::StatusCode::INTERNAL_SERVER_ERROR,
        "internal",
        "something went wrong inside",
        "something went wrong inside; the daemon's log has the details",
    )
    .into_response()
}
