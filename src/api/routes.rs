//! Every handler, once: router, table of access and OpenAPI document are made from one list.
//!
//! A handler states its path and method in `#[utoipa::path]`. Router and table read only these two, so that a program holds no
//! code that describes operations: it serves the finished document.
//!
//! A new handler is an entry of `with_handlers!` with what a request to it needs. A handler without it does not compile.

use axum::Router;
use axum::handler::Handler;
use axum::http::Method;
use axum::routing::{MethodFilter, MethodRouter};
use utoipa::openapi::path::HttpMethod;
use utoipa::{OpenApi, Path};

use super::App;
use super::need::{ADMIN, COMPUTE, Need, OPEN, OPERATE, READ, RIG, Route, STOP};

/// Passes all handlers, by module and each with what a request to it needs, to a macro.
macro_rules! with_handlers {
    ($to:ident) => {
        $to! {
            rig {
                get_rig: READ, move_axis: RIG, home_axis: RIG, home_both: RIG, unpark_axis: RIG, jog: RIG,
                accept_stages: ADMIN, stop: STOP,
            }
            motions { move_rig: RIG, motion: READ }
            previews { take: RIG, image: READ, pixels: READ }
            samples { list: READ, add: COMPUTE, get: READ, rename: OPERATE }
            scans { list: READ, begin: RIG, estimate: OPERATE, get: READ, command: RIG }
            scan_records { change: OPERATE, changes: READ }
            certainty { of_scan: READ }
            incidents { of_scan: READ }
            recipes {
                list: READ, add: OPERATE, get: READ, versions: READ, change: OPERATE, archive: OPERATE,
                restore: OPERATE,
            }
            specifications {
                list: READ, add: OPERATE, get: READ, versions: READ, change: OPERATE, archive: OPERATE,
                restore: OPERATE,
            }
            queue {
                get_queue: READ, start: RIG, stop: OPERATE, pause: RIG, resume: RIG, proceed: OPERATE, list: READ,
                add: OPERATE, get: READ, remove: OPERATE, move_to: OPERATE, retry: OPERATE,
            }
            reports { of_scan: READ }
            imports { add: COMPUTE, upload: COMPUTE }
            frames { of_scan: READ, get: READ, image: READ, preview: READ, pixels: READ }
            observations { of_scan: READ }
            exports { brdf: READ, stack: READ, surface: READ, nexus: READ }
            results { list: READ }
            charts { chart: READ, due: READ }
            comparisons { compare: READ, repeatability: READ }
            fits { list: READ, begin: COMPUTE, get: READ, cancel: COMPUTE, curve: READ }
            jobs {
                maps: READ, begin_map: COMPUTE, map: READ, cancel_map: COMPUTE, map_file: READ, contrasts: READ,
                begin_contrast: COMPUTE, contrast: READ, cancel_contrast: COMPUTE, verdicts: READ,
                begin_verdict: COMPUTE, verdict: READ, cancel_verdict: COMPUTE, traces: READ, begin_trace: COMPUTE,
                trace: READ, cancel_trace: COMPUTE, trace_file: READ,
            }
            calibrations { list: READ, take: RIG, get: READ }
            accuracy { get: READ }
            events { stream: READ }
            session { get: READ, login: OPEN, logout: OPEN }
            lease { get: READ, take: OPERATE, release: OPERATE }
            health { healthz: OPEN, readyz: READ, metrics: READ }
        }
    };
}

macro_rules! make_router {
    ($($module:ident { $($handler:ident: $need:ident),+ $(,)? })+) => {
        /// Returns the routes of all handlers.
        pub(super) fn routes() -> Router<App> {
            pastey::paste! {
                Router::new()$($(
                    .route(
                        &super::$module::[<__path_ $handler>]::path(),
                        serve::<super::$module::[<__path_ $handler>], _, _>(super::$module::$handler),
                    )
                )+)+
            }
        }
    };
}

macro_rules! make_table {
    ($($module:ident { $($handler:ident: $need:ident),+ $(,)? })+) => {
        /// Returns what a request to each handler needs.
        pub(super) fn needs() -> Vec<Route> {
            pastey::paste! {
                [$($(needs_of::<super::$module::[<__path_ $handler>]>($need)),+),+].concat()
            }
        }
    };
}

macro_rules! make_document {
    ($($module:ident { $($handler:ident: $need:ident),+ $(,)? })+) => {
        /// What the handlers say of themselves.
        #[derive(OpenApi)]
        #[openapi(
            info(
                title = "ridged",
                description = "Drives a rig for surfaces of fine parallel ridges, keeps its frames, fits the ridge angle and states the uncertainty. Errors are RFC 9457 problems with a stable `code`. POSTs except stop, login, lease and preview may carry an `Idempotency-Key`, which is known for a day. Loopback needs no token, unless the settings ask for one; any other address needs one. `docs/reference/access.md` describes roles and the lease of the rig.",
                license(name = "MIT OR Apache-2.0")
            ),
            paths($($(super::$module::$handler),+),+),
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
        pub(super) struct Document;
    };
}

/// Returns a handler at the methods that it states.
fn serve<P, H, T>(handler: H) -> MethodRouter<App>
where
    P: Path,
    H: Handler<T, App>,
    T: 'static,
{
    let methods = P::methods().into_iter();
    methods.fold(MethodRouter::new(), |router, method| {
        let filter = MethodFilter::try_from(method_of(&method));
        router.on(
            filter.expect("a handler has a standard method"),
            handler.clone(),
        )
    })
}

/// Returns the rows of a handler in the table of access.
fn needs_of<P: Path>(need: Need) -> Vec<Route> {
    let row = |method| (method_of(&method), P::path(), need);
    P::methods().into_iter().map(row).collect()
}

fn method_of(method: &HttpMethod) -> Method {
    match method {
        HttpMethod::Get => Method::GET,
        HttpMethod::Post => Method::POST,
        HttpMethod::Put => Method::PUT,
        HttpMethod::Delete => Method::DELETE,
        HttpMethod::Options => Method::OPTIONS,
        HttpMethod::Head => Method::HEAD,
        HttpMethod::Patch => Method::PATCH,
        HttpMethod::Trace => Method::TRACE,
    }
}

with_handlers!(make_router);
with_handlers!(make_table);
with_handlers!(make_document);
