//! Every handler, once: the router and the OpenAPI document are made from one list.
//!
//! A handler states its path and method in `#[utoipa::path]`. The router reads these two alone, so that a program holds no
//! code that describes operations: it serves the finished document.
//!
//! A new handler is a word in `with_handlers!`, in the order of the document, and a row of `table.rs`.

use axum::Router;
use axum::handler::Handler;
use axum::routing::{MethodFilter, MethodRouter};
use utoipa::openapi::path::HttpMethod;
use utoipa::{OpenApi, Path};

use super::App;
use super::{
    accuracy, calibrations, certainty, charts, comparisons, events, exports, fits, frames, health,
    imports, incidents, jobs, lease, motions, observations, previews, queue, recipes, reports,
    results, rig, samples, scan_records, scans, session, specifications,
};

/// Passes all handlers, by module, to a macro.
macro_rules! with_handlers {
    ($to:ident) => {
        $to! {
            rig { get_rig move_axis home_axis home_both unpark_axis jog accept_stages stop }
            motions { move_rig motion }
            previews { take image pixels }
            samples { list add get rename }
            scans { list begin estimate get command }
            scan_records { change changes }
            certainty { of_scan }
            incidents { of_scan }
            recipes { list add get versions change archive restore }
            specifications { list add get versions change archive restore }
            queue { get_queue start stop pause resume proceed list add get remove move_to retry }
            reports { of_scan }
            imports { add upload }
            frames { of_scan get image preview pixels }
            observations { of_scan }
            exports { brdf stack surface nexus }
            results { list }
            charts { chart due }
            comparisons { compare repeatability }
            fits { list begin get cancel curve }
            jobs {
                maps begin_map map cancel_map map_file contrasts begin_contrast contrast cancel_contrast verdicts
                begin_verdict verdict cancel_verdict traces begin_trace trace cancel_trace trace_file
            }
            calibrations { list take get }
            accuracy { get }
            events { stream }
            session { get login logout }
            lease { get take release }
            health { healthz readyz metrics }
        }
    };
}

macro_rules! make_router {
    ($($module:ident { $($handler:ident)+ })+) => {
        /// Returns the routes of all handlers.
        pub(super) fn routes() -> Router<App> {
            pastey::paste! {
                Router::new()$($(
                    .route(
                        &$module::[<__path_ $handler>]::path(),
                        serve::<$module::[<__path_ $handler>], _, _>($module::$handler),
                    )
                )+)+
            }
        }
    };
}

macro_rules! make_document {
    ($($module:ident { $($handler:ident)+ })+) => {
        /// What the handlers say of themselves.
        #[derive(OpenApi)]
        #[openapi(
            info(
                title = "ridged",
                description = "Drives a rig for surfaces of fine parallel ridges, keeps its frames, fits the ridge angle and states the uncertainty. Errors are RFC 9457 problems with a stable `code`. POSTs except stop, login, lease and preview may carry an `Idempotency-Key`, which is known for a day. Loopback needs no token, unless the settings ask for one; any other address needs one. `docs/reference/access.md` describes roles and the lease of the rig.",
                license(name = "MIT OR Apache-2.0")
            ),
            paths($($($module::$handler),+),+),
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
        router.on(filter(&method), handler.clone())
    })
}

fn filter(method: &HttpMethod) -> MethodFilter {
    match method {
        HttpMethod::Get => MethodFilter::GET,
        HttpMethod::Post => MethodFilter::POST,
        HttpMethod::Put => MethodFilter::PUT,
        HttpMethod::Delete => MethodFilter::DELETE,
        HttpMethod::Options => MethodFilter::OPTIONS,
        HttpMethod::Head => MethodFilter::HEAD,
        HttpMethod::Patch => MethodFilter::PATCH,
        HttpMethod::Trace => MethodFilter::TRACE,
    }
}

with_handlers!(make_router);
with_handlers!(make_document);
