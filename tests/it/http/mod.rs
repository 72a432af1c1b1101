//! The HTTP interface, called directly: one room per topic, and here how each of them asks.

mod calibrations;
mod charts;
mod comparisons;
pub(crate) mod document;
mod jobs;
mod motions;
mod old_folder;
mod packed;
mod previews;
mod queue;
pub(crate) mod recipes;
mod records;
mod refusals;
mod reports;
mod results;
mod samples;
mod scans;
mod traces;
pub(crate) mod uploads;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use axum::Router;
use axum::body::{Body, to_bytes};
use axum::http::{Request, StatusCode, header};
use serde_json::{Value, json};
use tokio_util::sync::CancellationToken;
use tower::ServiceExt;

use ridged::api::{self, Access};
use ridged::lab::Lab;
use ridged::scan::Event;
use ridged::sim::rig::{SimulatedRig, Simulation};
use ridged::store::disk::RealDisk;

use crate::bench_in_a_box::{BenchInABox, in_time};

/// A lab without hands, and the interface to it.
pub(crate) async fn opened() -> (BenchInABox, Router) {
    let bench = BenchInABox::with(Arc::new(RealDisk), false).await;
    let router = router_of(&bench.lab);
    (bench, router)
}

/// A lab in a folder with a simulated rig that is this many times faster than a real one, and the interface to it.
pub(crate) async fn opened_in(folder: &Path, time_scale: f64) -> (SimulatedRig, Lab, Router) {
    let simulation = Simulation {
        time_scale,
        ..Simulation::default()
    };
    let (rig, parts) = SimulatedRig::build(simulation).unwrap();
    let clock = Arc::clone(&rig.clock);
    let lab = Lab::open(folder, Arc::new(RealDisk), clock, Some(parts)).await;
    let (lab, _) = lab.unwrap();
    let router = router_of(&lab);
    (rig, lab, router)
}

/// The interface of a lab to callers on this machine, who may import the series that come with the tests and others in
/// temporary folders.
pub(crate) fn router_of(lab: &Lab) -> Router {
    let roots = vec![env!("CARGO_MANIFEST_DIR").into(), std::env::temp_dir()];
    let access = Access::of_folder(lab.store().folder()).with_import_roots(roots);
    let ending = CancellationToken::new();
    api::router(lab.clone(), Arc::new(String::new), ending, access)
}

/// An answer: status, headers, JSON (null if it is none).
pub(crate) struct Answer {
    pub(crate) status: u16,
    location: Option<String>,
    kind: String,
    pub(crate) body: Value,
}

impl Answer {
    /// What a problem says to a person.
    pub(crate) fn detail(&self) -> &str {
        self.body["detail"].as_str().unwrap()
    }
}

pub(crate) async fn send(router: &Router, request: Request<Body>) -> Answer {
    let response = router.clone().oneshot(request).await.unwrap();
    let header = |name| {
        response
            .headers()
            .get(name)
            .and_then(|v: &axum::http::HeaderValue| v.to_str().ok())
            .map(str::to_owned)
    };
    let (location, kind) = (header(header::LOCATION), header(header::CONTENT_TYPE));
    let status = response.status().as_u16();
    let bytes = to_bytes(response.into_body(), usize::MAX).await.unwrap();
    Answer {
        status,
        location,
        kind: kind.unwrap_or_default(),
        body: serde_json::from_slice(&bytes).unwrap_or(Value::Null),
    }
}

pub(crate) fn request(method: &str, path: &str) -> axum::http::request::Builder {
    Request::builder()
        .method(method)
        .uri(path)
        .header("host", "127.0.0.1:8787")
}

pub(crate) async fn get(router: &Router, path: &str) -> Answer {
    send(router, request("GET", path).body(Body::empty()).unwrap()).await
}

pub(crate) async fn download(router: &Router, path: &str) -> Vec<u8> {
    let request = request("GET", path).body(Body::empty()).unwrap();
    let response = router.clone().oneshot(request).await.unwrap();
    assert_eq!(response.status(), StatusCode::OK, "{path}");
    let bytes = to_bytes(response.into_body(), usize::MAX).await.unwrap();
    bytes.to_vec()
}

pub(crate) async fn post(router: &Router, path: &str, body: &str) -> Answer {
    let request = request("POST", path)
        .header("content-type", "application/json")
        .body(Body::from(body.to_owned()))
        .unwrap();
    send(router, request).await
}

async fn patch(router: &Router, path: &str, body: &str) -> Answer {
    let request = request("PATCH", path)
        .header("content-type", "application/json")
        .body(Body::from(body.to_owned()))
        .unwrap();
    send(router, request).await
}

/// Asserts that an answer refuses by this code and says what to do.
pub(crate) fn is_problem(answer: &Answer, status: u16, code: &str) {
    assert_eq!(answer.status, status, "{}", answer.body);
    assert_eq!(answer.kind, "application/problem+json");
    assert_eq!(answer.body["code"], code, "{}", answer.body);
    assert_eq!(answer.body["status"], status);
    let detail = answer.detail();
    assert!(detail.len() > 10, "{detail}");
}

/// The recorded series that comes with the tests.
pub(crate) fn polymer() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/series/polymer-10")
}

/// Imports it: scan 1 of a fresh store.
pub(crate) async fn imported(router: &Router) -> Answer {
    let body = json!({ "folder": polymer() }).to_string();
    let imported = post(router, "/api/v1/imports", &body).await;
    assert_eq!(imported.status, 201, "{}", imported.body);
    imported
}

/// Asks until something that was begun has ended.
pub(crate) async fn ended(router: &Router, begun: &Answer) -> Value {
    assert_eq!(begun.status, 202, "{}", begun.body);
    let location = begun.location.clone().unwrap();
    let waiting = async {
        loop {
            let now = get(router, &location).await.body;
            if now["state"] != "running" {
                return now;
            }
            tokio::task::yield_now().await;
        }
    };
    in_time(waiting).await
}

/// A result states its cost and the forecast made before it started.
fn costs(result: &Value, of: &str) {
    assert!(result["seconds"].as_f64().unwrap() > 0.0, "{result}");
    assert!(result["left_out"].is_array(), "{result}");
    let forecast = &result["forecast"];
    assert!(forecast["seconds"].as_f64().unwrap() > 0.0, "{forecast}");
    assert!(
        forecast["amount"]["count"].as_u64().unwrap() > 0,
        "{forecast}"
    );
    assert_eq!(forecast["amount"]["of"], of);
}

/// The forecasts that were broadcast and stored: kind and number of the job.
async fn forecasts(bench: &BenchInABox) -> Vec<(String, i64)> {
    let reported = bench.lab.store().events_after(0, 1000).await.unwrap();
    let forecast = |event: &Event| match event {
        Event::Forecast { of, number, .. } => Some((of.clone(), *number)),
        _ => None,
    };
    reported.iter().filter_map(|e| forecast(&e.event)).collect()
}
