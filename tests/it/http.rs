//! The HTTP interface, called directly: forms, problems, guards, and the document that describes it.

use std::path::Path;
use std::sync::Arc;

use axum::Router;
use axum::body::{Body, to_bytes};
use axum::http::{Request, StatusCode, header};
use serde_json::{Value, json};
use tokio_util::sync::CancellationToken;
use tower::ServiceExt;

use ridged::api;
use ridged::scan::{Event, ScanState};
use ridged::store::disk::RealDisk;

use crate::bench_in_a_box::BenchInABox;

fn router(bench: &BenchInABox) -> Router {
    api::router(
        bench.lab.clone(),
        Arc::new(String::new),
        CancellationToken::new(),
    )
}

/// An answer: status, headers, JSON (null if it is none).
struct Answer {
    status: u16,
    location: Option<String>,
    kind: String,
    body: Value,
}

async fn send(router: &Router, request: Request<Body>) -> Answer {
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

fn request(method: &str, path: &str) -> axum::http::request::Builder {
    Request::builder()
        .method(method)
        .uri(path)
        .header("host", "127.0.0.1:8787")
}

async fn get(router: &Router, path: &str) -> Answer {
    send(router, request("GET", path).body(Body::empty()).unwrap()).await
}

async fn download(router: &Router, path: &str) -> Vec<u8> {
    let request = request("GET", path).body(Body::empty()).unwrap();
    let response = router.clone().oneshot(request).await.unwrap();
    assert_eq!(response.status(), 200, "{path}");
    let bytes = to_bytes(response.into_body(), usize::MAX).await.unwrap();
    bytes.to_vec()
}

async fn post(router: &Router, path: &str, body: &str) -> Answer {
    let request = request("POST", path)
        .header("content-type", "application/json")
        .body(Body::from(body.to_owned()))
        .unwrap();
    send(router, request).await
}

fn is_problem(answer: &Answer, status: u16, code: &str) {
    assert_eq!(answer.status, status, "{}", answer.body);
    assert_eq!(answer.kind, "application/problem+json");
    assert_eq!(answer.body["code"], code, "{}", answer.body);
    assert_eq!(answer.body["status"], status);
    let detail = answer.body["detail"].as_str().unwrap();
    assert!(detail.len() > 10, "{detail}");
}

#[tokio::test(flavor = "multi_thread")]
async fn bad_input_is_refused_by_name_and_nothing_happens() {
    let bench = BenchInABox::with(Arc::new(RealDisk), false).await;
    let router = router(&bench);
    let plan = |plan: &str| format!("{{\"sample_id\": 1, \"plan\": {plan}}}");
    let cases = [
        ("{", 400, "bad-json", "/api/v1/scans"),
        (
            r#"{"sample_id": 1, "plan": {"theta_c_deg": [NaN], "phi_s_deg": [0]}}"#,
            400,
            "bad-json",
            "/api/v1/scans",
        ),
        (
            r#"{"sample_id": 1, "plan": {"theta_c_deg": [1e999], "phi_s_deg": [0]}}"#,
            400,
            "bad-json",
            "/api/v1/scans",
        ),
        (
            r#"{"sample_id": 1, "plan": {"preset": "paper", "exposure": 1}}"#,
            400,
            "unknown-field",
            "/api/v1/scans",
        ),
        (
            r#"{"sample_id": "one", "plan": {"preset": "paper"}}"#,
            422,
            "invalid-value",
            "/api/v1/scans",
        ),
        (
            r#"{"sample_id": 99, "plan": {"preset": "paper"}}"#,
            404,
            "not-found",
            "/api/v1/scans",
        ),
        (
            &plan(r#"{"theta_c_deg": [75], "phi_s_deg": []}"#),
            422,
            "plan-invalid",
            "/api/v1/scans",
        ),
        (
            &plan(r#"{"theta_c_deg": {"from": 0, "to": 1, "step": 1e-9}, "phi_s_deg": [0]}"#),
            422,
            "plan-invalid",
            "/api/v1/scans",
        ),
        (
            r#"{"position_deg": 500}"#,
            422,
            "outside-limits",
            "/api/v1/rig/axes/theta_c/move",
        ),
        (
            r#"{"position": 5}"#,
            400,
            "unknown-field",
            "/api/v1/rig/axes/theta_c/move",
        ),
        (
            r#"{"position_deg": 5}"#,
            404,
            "not-found",
            "/api/v1/rig/axes/z/move",
        ),
        (
            r#"{"name": "", "material": {"kind": "dielectric", "eta": 1.5, "eta_std": 0.01}}"#,
            422,
            "invalid-value",
            "/api/v1/samples",
        ),
        (
            r#"{"name": "x", "material": {"kind": "dielectric", "eta": -1, "eta_std": 0.01}}"#,
            422,
            "invalid-value",
            "/api/v1/samples",
        ),
        (r#"{"scan_id": 77}"#, 404, "not-found", "/api/v1/fits"),
        (
            r#"{"scan_id": 77, "variant": "best"}"#,
            422,
            "invalid-value",
            "/api/v1/fits",
        ),
        (
            r#"{"folder": "relative"}"#,
            422,
            "invalid-value",
            "/api/v1/imports",
        ),
        (
            r#"{"folder": "/nowhere/at/all"}"#,
            422,
            "series-invalid",
            "/api/v1/imports",
        ),
    ];
    for (body, status, code, path) in cases {
        let answer = post(&router, path, body).await;
        println!("{body} → {}", answer.body);
        is_problem(&answer, status, code);
    }
    // Everything wrong with a plan at once, each by its path.
    let answer = post(
        &router,
        "/api/v1/scans/estimate",
        &plan(r#"{"theta_c_deg": [75, 0, 0], "phi_s_deg": [0], "exposures_s": [-1]}"#),
    )
    .await;
    let fields: Vec<&str> = answer.body["errors"]
        .as_array()
        .unwrap()
        .iter()
        .filter_map(|e| e["field"].as_str())
        .collect();
    assert_eq!(
        fields,
        [
            "plan.theta_c_deg[2]",
            "plan.theta_c_deg[0]",
            "plan.exposures_s[0]"
        ]
    );
    for path in [
        "/api/v1/scans/x",
        "/api/v1/scans?limit=0",
        "/api/v1/scans?colour=red",
        "/api/v1/scans?state=happy",
        "/api/v1/fits?theta_r_deg_min=NaN",
        "/api/v1/fits?since=yesterday",
    ] {
        let answer = get(&router, path).await;
        assert!(
            matches!(answer.status, 400 | 422),
            "{path}: {}",
            answer.body
        );
        assert_eq!(answer.kind, "application/problem+json", "{path}");
    }
    is_problem(&get(&router, "/api/v1/scans/9").await, 404, "not-found");
    is_problem(&get(&router, "/api/v1/nothing").await, 404, "not-found");
    for answer in [
        get(&router, "/rig").await,
        post(&router, "/scans", "{}").await,
        post(&router, "/", "{}").await,
    ] {
        is_problem(&answer, 404, "not-found");
        let detail = answer.body["detail"].as_str().unwrap();
        assert!(detail.contains("/api/v1"), "{detail}");
    }
    let delete = request("DELETE", "/api/v1/rig")
        .body(Body::empty())
        .unwrap();
    is_problem(&send(&router, delete).await, 405, "method-not-allowed");
    assert_eq!(get(&router, "/api/v1/scans").await.body["items"], json!([]));
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn bodies_that_are_too_large_or_no_json_do_not_get_in() {
    let bench = BenchInABox::with(Arc::new(RealDisk), false).await;
    let router = router(&bench);
    let large = vec![b' '; 100_000_000];
    let announced = request("POST", "/api/v1/samples")
        .header("content-type", "application/json")
        .header("content-length", large.len())
        .body(Body::from(large))
        .unwrap();
    is_problem(&send(&router, announced).await, 413, "body-too-large");
    let chunks =
        futures::stream::iter((0..1000).map(|_| Ok::<_, std::io::Error>(vec![b' '; 100_000])));
    let chunked = request("POST", "/api/v1/samples")
        .header("content-type", "application/json")
        .header("transfer-encoding", "chunked")
        .body(Body::from_stream(chunks))
        .unwrap();
    is_problem(&send(&router, chunked).await, 413, "body-too-large");
    let text = request("POST", "/api/v1/samples")
        .header("content-type", "text/plain")
        .header("content-length", 2)
        .body(Body::from("{}"))
        .unwrap();
    is_problem(&send(&router, text).await, 415, "wrong-content-type");
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn another_page_and_another_host_may_not_command_the_rig() {
    let bench = BenchInABox::with(Arc::new(RealDisk), false).await;
    let router = router(&bench);
    let foreign = request("POST", "/api/v1/rig/stop")
        .header("origin", "https://evil.example")
        .body(Body::empty())
        .unwrap();
    is_problem(&send(&router, foreign).await, 403, "forbidden-origin");
    let rebound = Request::builder()
        .method("POST")
        .uri("/api/v1/rig/stop")
        .header("host", "evil.example:8787")
        .body(Body::empty())
        .unwrap();
    is_problem(&send(&router, rebound).await, 403, "forbidden-host");
    let own = request("POST", "/api/v1/rig/stop")
        .header("origin", "http://127.0.0.1:8787")
        .body(Body::empty())
        .unwrap();
    let answer = send(&router, own).await;
    assert_eq!(
        (answer.status, &answer.body["state"]),
        (200, &json!("stopped"))
    );
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_scan_is_begun_found_commanded_and_begun_once_per_key() {
    let bench = BenchInABox::with(Arc::new(RealDisk), false).await;
    let router = router(&bench);
    let body = r#"{"sample_id": 2, "plan": {"preset": "paper"}}"#;
    let keyed = || {
        request("POST", "/api/v1/scans")
            .header("content-type", "application/json")
            .header("idempotency-key", "first scan")
            .body(Body::from(body))
            .unwrap()
    };
    let first = send(&router, keyed()).await;
    assert_eq!(first.status, 202, "{}", first.body);
    assert_eq!(first.location.as_deref(), Some("/api/v1/scans/1"));
    assert_eq!(first.body, json!({"id": 1, "state": "planned"}));
    // Sent again, the same answer; another one is refused while this one holds the rig.
    let again = send(&router, keyed()).await;
    assert_eq!((again.status, again.body), (first.status, first.body));
    assert_eq!(again.location, first.location);
    is_problem(&post(&router, "/api/v1/scans", body).await, 409, "busy");
    bench.until(1, ScanState::WaitingForOperator).await;
    let scan = get(&router, "/api/v1/scans/1").await.body;
    assert_eq!(scan["operator"]["action"], "cap-lens");
    assert_eq!(scan["sample_name"], "traced polymer");
    assert_eq!(scan["progress"]["frames_total"], 48);
    let rig = get(&router, "/api/v1/rig").await.body;
    assert_eq!(rig["scan_id"], 1);
    assert_eq!(rig["activity"], "scanning");
    assert_eq!(rig["axes"]["phi_s"]["homed"], true);
    is_problem(
        &post(&router, "/api/v1/scans/1/resume", "").await,
        409,
        "state-conflict",
    );
    let aborted = post(&router, "/api/v1/scans/1/abort", "").await;
    assert_eq!(
        (aborted.status, &aborted.body["state"]),
        (202, &json!("aborted"))
    );
    let found = get(&router, "/api/v1/scans?state=aborted&sample_id=2")
        .await
        .body;
    assert_eq!(found["items"].as_array().unwrap().len(), 1);
    assert_eq!(found["next_cursor"], Value::Null);
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_imported_series_is_there_as_scan_frames_and_observations() {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/series/polymer-10");
    let bench = BenchInABox::with(Arc::new(RealDisk), false).await;
    let router = router(&bench);
    let body = json!({ "folder": source }).to_string();
    let imported = post(&router, "/api/v1/imports", &body).await;
    assert_eq!(imported.status, 201, "{}", imported.body);
    let scan = get(&router, imported.location.as_deref().unwrap())
        .await
        .body;
    assert_eq!(scan["state"], "completed");
    assert_eq!(scan["origin"], "import");
    assert_eq!(scan["plan"]["theta_c_deg"].as_array().unwrap().len(), 9);
    let frames = get(&router, "/api/v1/scans/1/frames?limit=1000&kind=sample")
        .await
        .body;
    let frame = &frames["items"][0];
    assert_eq!(frames["items"].as_array().unwrap().len(), 324);
    // The image is the file, bit for bit, and known by its hash.
    let image = frame["image"].as_str().unwrap();
    let response = router
        .clone()
        .oneshot(request("GET", image).body(Body::empty()).unwrap())
        .await
        .unwrap();
    let etag = response.headers()[header::ETAG]
        .to_str()
        .unwrap()
        .to_owned();
    assert_eq!(etag, format!("\"{}\"", frame["sha256"].as_str().unwrap()));
    let bytes = to_bytes(response.into_body(), usize::MAX).await.unwrap();
    let file = std::fs::read(source.join(frame["file"].as_str().unwrap())).unwrap();
    assert!(bytes == file);
    let cached = request("GET", image)
        .header("if-none-match", etag)
        .body(Body::empty())
        .unwrap();
    assert_eq!(
        send(&router, cached).await.status,
        StatusCode::NOT_MODIFIED.as_u16()
    );
    // Observations, whole and by pose, as JSON and as CSV.
    let all = get(&router, "/api/v1/scans/1/observations").await.body;
    assert_eq!(all["items"].as_array().unwrap().len(), 108);
    assert_eq!(
        (&all["absolute"], &all["complete"]),
        (&json!(true), &json!(true))
    );
    let one = get(
        &router,
        "/api/v1/scans/1/observations?theta_c_deg=-20&phi_s_deg=30",
    )
    .await
    .body;
    assert_eq!(one["items"].as_array().unwrap().len(), 1);
    let csv = router
        .clone()
        .oneshot(
            request("GET", "/api/v1/scans/1/observations?format=csv")
                .body(Body::empty())
                .unwrap(),
        )
        .await
        .unwrap();
    let csv = to_bytes(csv.into_body(), usize::MAX).await.unwrap();
    let text = String::from_utf8(csv.to_vec()).unwrap();
    assert_eq!(text.lines().count(), 109);
    assert!(text.starts_with("theta_c_deg,phi_s_deg,signal,sigma,n_frames\n"));
    bench.end().await;
}

/// Asks until something that was begun has ended.
async fn ended(router: &Router, begun: &Answer) -> Value {
    assert_eq!(begun.status, 202, "{}", begun.body);
    let location = begun.location.clone().unwrap();
    loop {
        let now = get(router, &location).await.body;
        if now["state"] != "running" {
            return now;
        }
        tokio::task::yield_now().await;
    }
}

/// A result says what it took and what had been told before it started.
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

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_scan_is_compared_judged_and_mapped() {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/series/polymer-10");
    let bench = BenchInABox::with(Arc::new(RealDisk), false).await;
    let router = router(&bench);
    let body = json!({ "folder": source }).to_string();
    assert_eq!(post(&router, "/api/v1/imports", &body).await.status, 201);

    let begun = post(&router, "/api/v1/contrasts", r#"{"scan_id": 1}"#).await;
    let contrast = ended(&router, &begun).await;
    assert_eq!(contrast["state"], "completed", "{contrast}");
    assert_eq!(contrast["mode"], "measured");
    assert_eq!(contrast["lines"].as_array().unwrap().len(), 9);
    costs(&contrast, "poses");

    // The sample has a ridge angle of 10°: one specification allows it, one does not, one asks for
    // what no measurement of this kind can tell.
    let judged = async |lower: f64, upper: f64| {
        let limits = json!({ "theta_r_deg": { "lower": lower, "upper": upper } });
        let request = json!({
            "scan_id": 1,
            "variant": "sawtooth",
            "specification": { "name": "lid, revision C", "limits": limits },
        });
        let begun = post(&router, "/api/v1/verdicts", &request.to_string()).await;
        let verdict = ended(&router, &begun).await;
        assert_eq!(verdict["specification"], "lid, revision C", "{verdict}");
        assert_eq!(verdict["items"][0]["quantity"], "theta_r_deg");
        costs(&verdict, "poses");
        verdict["verdict"].as_str().unwrap().to_owned()
    };
    assert_eq!(judged(9.5, 10.5).await, "pass");
    assert_eq!(judged(11.0, 12.0).await, "fail");
    assert_eq!(judged(10.0, 12.0).await, "cannot-tell");
    for (specification, word) in [
        (json!({ "name": "x", "limits": {} }), "empty"),
        (
            json!({ "name": "x", "limits": { "theta_r": { "lower": 1 } } }),
            "theta_r_deg",
        ),
        (json!({ "limits": {} }), "name"),
    ] {
        let request = json!({ "scan_id": 1, "specification": specification });
        let refused = post(&router, "/api/v1/verdicts", &request.to_string()).await;
        is_problem(&refused, 422, "invalid-value");
        let detail = refused.body["detail"].as_str().unwrap();
        assert!(detail.contains(word), "{detail}");
    }
    let list = get(&router, "/api/v1/verdicts?scan_id=1&state=completed").await;
    assert_eq!(list.body["items"].as_array().unwrap().len(), 3);
    is_problem(
        &get(&router, "/api/v1/verdicts?state=done").await,
        422,
        "invalid-value",
    );

    // A trace is of a scene, not of a scan; what makes no sense is said by its key.
    let scene = json!({
        "light": { "theta_i_deg": 56.31 },
        "interface": [{ "shape": "flat", "below": { "n": 1.5 } }],
        "run": { "photons": 2000 },
    });
    let request = json!({ "scene": scene });
    let begun = post(&router, "/api/v1/traces", &request.to_string()).await;
    let trace = ended(&router, &begun).await;
    assert_eq!(trace["state"], "completed", "{trace}");
    assert_eq!(trace["photons"], 2000);
    costs(&trace, "photons");
    // What was told before it started is told to everybody, and durably.
    let told = bench.lab.store().events_after(0, 1000).await.unwrap();
    let forecasts: Vec<(&str, i64)> = told
        .iter()
        .filter_map(|e| match &e.event {
            Event::Forecast { of, number, .. } => Some((of.as_str(), *number)),
            _ => None,
        })
        .collect();
    let verdicts = [2, 3, 4].map(|n| ("verdict", n));
    assert_eq!(forecasts[0], ("contrast", 1));
    assert_eq!(&forecasts[1..4], &verdicts);
    assert_eq!(forecasts[4].0, "trace");
    let reflected = trace["energy"]["reflected"]["value"].as_f64().unwrap();
    assert!((reflected - 0.073_964_5).abs() < 1e-6, "{reflected}");
    assert_eq!(trace["comparison"], Value::Null);
    // With `compare` its files say where light without polarisation goes wrong; limits are kept and told.
    let layered = json!({
        "light": { "theta_i_deg": 65.0, "phi_i_deg": 180.0 },
        "interface": [
            { "shape": "flat", "below": { "n": 1.5 } },
            { "shape": "beckmann", "alpha_u": 0.2, "alpha_v": 0.2, "cells": 32, "below": { "n": 2.4 } },
        ],
        "run": { "photons": 9_000_000, "theta_bins": 9, "phi_bins": 12 },
    });
    let wanted =
        json!({ "scene": layered, "compare": true, "photons": 6000, "target_error": 1e-9 });
    let begun = post(&router, "/api/v1/traces", &wanted.to_string()).await;
    let trace = ended(&router, &begun).await;
    assert_eq!(trace["state"], "completed", "{trace}");
    assert_eq!(trace["photons"], 6000);
    let warning = trace["warnings"][0].as_str().unwrap();
    assert!(warning.contains("was not reached"), "{warning}");
    assert!(trace["comparison"]["adm"]["greatest"].as_f64().unwrap() > 0.0);
    assert_eq!(trace["bins"]["numbers"].as_array().unwrap().len(), 18);
    assert_eq!(trace["bins"]["sides"], json!(["reflected", "transmitted"]));
    let files = format!("{}/files", begun.location.clone().unwrap());
    let plane = get(&router, &format!("{files}/plane.json")).await.body;
    let point = &plane["lobe"][0];
    let value = |what: &str| point[what]["value"].as_f64().unwrap();
    let difference = value("polarised") - value("scalar");
    assert!((value("difference") - difference).abs() < 1e-9, "{point}");
    assert_eq!(plane["states"][0]["stokes"], json!([1.0, 0.0, 0.0, 0.0]));
    assert_eq!(plane["points"][0]["readings"].as_array().unwrap().len(), 7);
    for (name, bytes) in [
        ("bins.f32", 2 * 108 * 18 * 2 * 4),
        ("difference.f32", 108 * 4 * 4),
    ] {
        let file = download(&router, &format!("{files}/{name}")).await;
        assert_eq!(file.len(), bytes, "{name}");
    }
    is_problem(
        &get(&router, &format!("{files}/../../ridged.sqlite")).await,
        404,
        "not-found",
    );
    is_problem(
        &get(&router, &format!("{files}/none.csv")).await,
        422,
        "invalid-value",
    );
    let text = "[[interface]]\nshape = \"flat\"\nbelow = { n = 0 }\n";
    let mut scalar = layered.clone();
    scalar["run"]["polarised"] = json!(false);
    let mut fine = layered.clone();
    fine["run"]["phi_bins"] = json!(1440);
    fine["run"]["theta_bins"] = json!(1440);
    for (request, word) in [
        (json!({ "scene": text }), "below.n"),
        (json!({ "scene": scalar, "compare": true }), "polarised"),
        (json!({ "scene": fine }), "theta_bins"),
        (json!({ "scene": scene, "photons": 0 }), "run.photons"),
        (json!({ "scene": {} }), "interface"),
        (
            json!({ "scene": scene, "max_seconds": -1.0 }),
            "greater than 0",
        ),
    ] {
        let refused = post(&router, "/api/v1/traces", &request.to_string()).await;
        is_problem(&refused, 422, "invalid-value");
        let detail = refused.body["detail"].as_str().unwrap();
        assert!(detail.contains(word), "{detail}");
    }

    // A map is long work: it says how far it is, can be cancelled, and then has no files.
    let begun = post(&router, "/api/v1/maps", r#"{"scan_id": 1}"#).await;
    let map = begun.location.clone().unwrap();
    let progress = loop {
        let now = get(&router, &map).await.body;
        assert_eq!(now["state"], "running", "{now}");
        if !now["progress"].is_null() {
            break now["progress"].clone();
        }
    };
    assert!(progress["stage"].is_string(), "{progress}");
    let fraction = progress["fraction"].as_f64().unwrap();
    assert!((0.0..=1.0).contains(&fraction), "{progress}");
    let cancelled = post(&router, &format!("{map}/cancel"), "").await;
    assert_eq!(cancelled.status, 202, "{}", cancelled.body);
    assert_eq!(ended(&router, &begun).await["state"], "cancelled");
    let file = get(&router, &format!("{map}/files/summary.json")).await;
    is_problem(&file, 422, "invalid-value");
    is_problem(
        &post(&router, "/api/v1/maps", r#"{"scan_id": 7}"#).await,
        404,
        "not-found",
    );
    let nonsense = r#"{"scan_id": 1, "target_error": 0}"#;
    let refused = post(&router, "/api/v1/maps", nonsense).await;
    is_problem(&refused, 422, "invalid-value");
    let nonsense = r#"{"scan_id": 1, "tolerance": -1}"#;
    let refused = post(&router, "/api/v1/fits", nonsense).await;
    is_problem(&refused, 422, "invalid-value");
    is_problem(&get(&router, "/api/v1/contrasts/2").await, 404, "not-found");

    // What was measured of accuracy is served as it was written, once it is there.
    let missing = get(&router, "/api/v1/accuracy").await;
    is_problem(&missing, 404, "not-found");
    assert!(
        missing.body["detail"]
            .as_str()
            .unwrap()
            .contains("ridged accuracy --data")
    );
    let folder = bench.lab.store().folder().join("accuracy");
    std::fs::create_dir_all(&folder).unwrap();
    std::fs::write(
        folder.join("accuracy.json"),
        r#"{"machine": "m", "points": []}"#,
    )
    .unwrap();
    let found = get(&router, "/api/v1/accuracy").await;
    assert_eq!((found.status, &found.body["machine"]), (200, &json!("m")));
    assert!(found.body["written_at"].as_str().unwrap().ends_with('Z'));
    bench.end().await;
}

#[test]
fn the_document_is_the_one_in_the_repository() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/openapi.json");
    let now = api::openapi_json() + "\n";
    if std::env::var_os("RIDGED_RENEW").is_some() {
        std::fs::write(&path, &now).unwrap();
    }
    let kept = std::fs::read_to_string(&path).unwrap_or_default();
    assert!(
        kept == now,
        "the interface has changed; look at the change, then renew tests/data/openapi.json with \
         `RIDGED_RENEW=1 cargo test --test it the_document`"
    );
}

#[test]
fn every_response_of_the_document_says_what_it_is() {
    let document: Value = serde_json::from_str(&api::openapi_json()).unwrap();
    let mut responses = 0;
    for (path, item) in document["paths"].as_object().unwrap() {
        for (method, operation) in item.as_object().unwrap() {
            let Some(all) = operation["responses"].as_object() else {
                continue;
            };
            for (status, response) in all {
                let description = response["description"].as_str().unwrap_or_default();
                assert!(!description.is_empty(), "{method} {path} {status}");
                responses += 1;
            }
        }
    }
    assert!(responses > 60, "{responses}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_sample_without_a_material_says_what_was_assumed() {
    let bench = BenchInABox::with(Arc::new(RealDisk), false).await;
    let router = router(&bench);
    let added = post(&router, "/api/v1/samples", r#"{"name": "part 17"}"#).await;
    assert_eq!(added.status, 201);
    assert_eq!(added.body["material"]["eta_std"], json!(0.05));
    let note = added.body["note"]
        .as_str()
        .expect("the assumption is noted");
    assert!(note.contains("1.5 ± 0.05 assumed"), "{note}");
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_sample_may_name_its_metal() {
    let bench = BenchInABox::with(Arc::new(RealDisk), false).await;
    let router = router(&bench);
    let add = async |metal: &str| {
        let body = format!(r#"{{"name": "part 18", "metal": {metal}}}"#);
        post(&router, "/api/v1/samples", &body).await
    };
    let added = add(r#"{"name": "Al", "wavelength_nm": 633}"#).await;
    assert_eq!(added.status, 201);
    assert_eq!(added.body["material"]["kind"], json!("conductor"));
    assert!(added.body["material"]["k"].as_f64().expect("k") > 5.0);
    // Without a wavelength it is the lamp's.
    assert_eq!(add(r#"{"name": "Al"}"#).await.status, 201);
    let unknown = add(r#"{"name": "Mithril"}"#).await;
    assert_eq!(unknown.status, 422);
    let detail = unknown.body["detail"].as_str().expect("words");
    assert!(detail.contains("known are Ag, Al"), "{detail}");
    bench.end().await;
}
