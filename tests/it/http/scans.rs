//! Scans: begun, commanded and imported; their frames and observations.

use std::sync::Arc;

use axum::body::{Body, to_bytes};
use axum::http::{StatusCode, header};
use futures::StreamExt;
use ridged::bench::AxisName::PhiS;
use ridged::clock::ScaledClock;
use ridged::scan::ScanState;
use ridged::units::Angle;
use serde_json::{Value, json};
use tower::ServiceExt;

use crate::cut_short::gone_after;
use crate::stop::{disturbed_on, idle};

use super::{download, get, imported, is_problem, opened, polymer, post, request, router_of, send};

#[tokio::test(flavor = "multi_thread")]
async fn a_scan_is_begun_found_commanded_and_begun_once_per_key() {
    let (bench, router) = opened().await;
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
    // Nothing of that kind is kept yet, and kinds that there are none of are refused.
    let none = get(&router, "/api/v1/calibrations?kind=dark&scan_id=1").await;
    assert_eq!(none.body["items"], json!([]));
    let refused = get(&router, "/api/v1/calibrations?kind=white").await;
    is_problem(&refused, 422, "invalid-value");
    let unknown = get(&router, "/api/v1/calibrations/1").await;
    is_problem(&unknown, 404, "not-found");
    let paused = post(&router, "/api/v1/scans/1/pause", "").await;
    assert_eq!(paused.status, 202, "{}", paused.body);
    let rig = get(&router, "/api/v1/rig").await.body;
    assert_eq!(
        (&rig["activity"], &rig["scan_state"]),
        (&json!("paused"), &json!("paused"))
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
async fn a_step_that_is_done_counts_for_that_step_alone() {
    let (bench, router) = opened().await;
    let body = r#"{"sample_id": 2, "plan": {"theta_c_deg": [0], "phi_s_deg": [0], "exposures_s": [0.02]}}"#;
    assert_eq!(post(&router, "/api/v1/scans", body).await.status, 202);
    bench.until(1, ScanState::WaitingForOperator).await;
    let proceed = "/api/v1/scans/1/continue";
    let other = post(&router, proceed, r#"{"action": "place-sample"}"#).await;
    is_problem(&other, 409, "other-step");
    let says = "waits for cap-lens, not for place-sample: Put the cap on the lens";
    assert!(other.detail().contains(says), "{}", other.detail());
    let none = post(&router, proceed, r#"{"action": "dance"}"#).await;
    is_problem(&none, 422, "invalid-value");
    assert!(none.detail().contains("cap-lens"), "{}", none.detail());
    let slip = post(&router, proceed, r#"{"step": "cap-lens"}"#).await;
    is_problem(&slip, 400, "unknown-field");
    let scan = get(&router, "/api/v1/scans/1").await.body;
    assert_eq!(scan["state"], "waiting-for-operator");
    bench.rig.world.cap_lens(true);
    let done = post(&router, proceed, r#"{"action": "cap-lens"}"#).await;
    assert_eq!(done.status, 202, "{}", done.body);
    // Said once more it is too late, wherever the scan is by now.
    let late = post(&router, proceed, r#"{"action": "cap-lens"}"#).await;
    assert_eq!(late.status, 409, "{}", late.body);
    loop {
        let scan = get(&router, "/api/v1/scans/1").await.body;
        if scan["operator"]["action"] == "place-white-reference" {
            break;
        }
        tokio::task::yield_now().await;
    }
    let late = post(&router, proceed, r#"{"action": "cap-lens"}"#).await;
    is_problem(&late, 409, "other-step");
    // An empty object says no more than no body.
    assert_eq!(post(&router, proceed, "{}").await.status, 202);
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn who_finds_the_rig_taken_is_reported_what_frees_it() {
    let (bench, router) = opened().await;
    let body = r#"{"sample_id": 2, "plan": {"preset": "paper"}}"#;
    assert_eq!(post(&router, "/api/v1/scans", body).await.status, 202);
    bench.until(1, ScanState::WaitingForOperator).await;
    let home = "/api/v1/rig/axes/theta_c/home";
    for (order, state, says) in [
        (
            "pause",
            "paused",
            "scan 1 is paused and holds the rig; resume it",
        ),
        (
            "resume",
            "waiting-for-operator",
            "scan 1 waits for an operator step and holds the rig; do the step",
        ),
    ] {
        let path = format!("/api/v1/scans/1/{order}");
        assert_eq!(post(&router, &path, "").await.status, 202);
        while get(&router, "/api/v1/scans/1").await.body["state"] != state {
            tokio::task::yield_now().await;
        }
        let busy = post(&router, home, "").await;
        is_problem(&busy, 409, "busy");
        assert!(busy.detail().contains(says), "{}", busy.detail());
        assert!(
            !busy.detail().contains("pause or abort"),
            "{}",
            busy.detail()
        );
    }
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_that_is_gone_shows_within_seconds() {
    let (bench, router) = opened().await;
    let events = request("GET", "/api/v1/events").body(Body::empty());
    let response = router.clone().oneshot(events.unwrap()).await.unwrap();
    let mut reported = response.into_body().into_data_stream();
    // A comment, which listeners ignore; sending it fails without a listener.
    let comment = async {
        while let Some(some) = reported.next().await {
            if some.unwrap().starts_with(b":") {
                return;
            }
        }
        panic!("the events broke off");
    };
    let in_time = tokio::time::timeout(std::time::Duration::from_secs(10), comment).await;
    in_time.expect("nothing was written");
    drop(reported);
    bench.end().await;
}

/// Reads the positions of φs that events without a place in the store have, until the rig was idle twice.
async fn unstored_positions(events: Body) -> Vec<f64> {
    let mut parts = events.into_data_stream();
    let mut text = String::new();
    while text.matches("\"activity\":\"idle\"").count() < 2 {
        text.push_str(&String::from_utf8_lossy(
            &parts.next().await.unwrap().unwrap(),
        ));
    }
    let data = text.lines().filter_map(|line| line.strip_prefix("data: "));
    let events = data.map(|data| serde_json::from_str::<Value>(data).unwrap());
    let unstored = events.filter(|event| event["id"].as_i64().unwrap() < 0);
    let moving = unstored.filter(|event| event["activity"] == "moving");
    let positions = moving.map(|event| event["axes"]["phi_s"]["position_deg"].as_f64());
    positions.flatten().collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stream_that_asks_for_positions_has_them_while_an_axis_moves() {
    let (lab, rig, _folder) = disturbed_on(Arc::new(ScaledClock::new(2.0)), |_| ()).await;
    let router = router_of(&lab);
    let stream = async |query: &str| {
        let path = format!("/api/v1/events{query}");
        let events = request("GET", &path).body(Body::empty()).unwrap();
        router.clone().oneshot(events).await.unwrap().into_body()
    };
    let asking = tokio::spawn(unstored_positions(stream("?positions=true").await));
    let other = tokio::spawn(unstored_positions(stream("").await));
    let mut heard = lab.events();
    lab.have_rig().await.unwrap();
    lab.home(PhiS).await.unwrap();
    idle(&mut heard).await;
    lab.move_axis(PhiS, Angle::from_deg(200.0)).await.unwrap();
    idle(&mut heard).await;
    assert!(!rig.world.is_moving());
    let passed = asking.await.unwrap();
    assert!(passed.len() > 3, "{passed:?}");
    assert!(
        passed.windows(2).all(|pair| pair[0] < pair[1]),
        "{passed:?}"
    );
    assert_eq!(other.await.unwrap(), Vec::<f64>::new());
    lab.shut_down().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_imported_series_is_there_as_scan_frames_and_observations() {
    let (bench, router) = opened().await;
    let imported = imported(&router).await;
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
    assert_eq!(frames["items"].as_array().unwrap().len(), 180);
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
    let file = std::fs::read(polymer().join(frame["file"].as_str().unwrap())).unwrap();
    assert!(bytes == file);
    for method in ["GET", "HEAD"] {
        for (path, length) in [
            (image, bytes.len()),
            ("/api/v1/frames/1/pixels", 2 * 128 * 128),
        ] {
            let cached = request(method, path)
                .header("if-none-match", "*")
                .body(Body::empty())
                .unwrap();
            let response = router.clone().oneshot(cached).await.unwrap();
            assert_eq!(response.status(), StatusCode::NOT_MODIFIED, "{method}");
            // Not that of this empty answer.
            let said = response.headers()[header::CONTENT_LENGTH].to_str().unwrap();
            assert_eq!(said, length.to_string(), "{method} {path}");
        }
    }
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
    let csv = download(&router, "/api/v1/scans/1/observations?format=csv").await;
    let text = String::from_utf8(csv).unwrap();
    assert_eq!(text.lines().count(), 109);
    assert!(text.starts_with("theta_c_deg,phi_s_deg,signal,sigma,n_frames\n"));
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_series_that_is_there_already_says_so_and_one_without_a_sample_is_refused() {
    let (bench, router) = opened().await;
    assert_eq!(imported(&router).await.body["same_as_scan_id"], Value::Null);
    assert_eq!(imported(&router).await.body["same_as_scan_id"], 1);

    let folder = tempfile::tempdir().unwrap();
    let list = std::fs::read_to_string(polymer().join("frames.csv")).unwrap();
    let dark: Vec<&str> = list.lines().take(2).collect();
    std::fs::write(folder.path().join("frames.csv"), dark.join("\n")).unwrap();
    let file = dark[1].split(',').next().unwrap();
    std::fs::create_dir(folder.path().join("frames")).unwrap();
    std::fs::copy(polymer().join(file), folder.path().join(file)).unwrap();
    std::fs::copy(
        polymer().join("manifest.toml"),
        folder.path().join("manifest.toml"),
    )
    .unwrap();
    let body = json!({ "folder": folder.path() }).to_string();
    let refused = post(&router, "/api/v1/imports", &body).await;
    is_problem(&refused, 422, "series-invalid");
    assert!(
        refused.detail().contains("has the kind sample"),
        "{}",
        refused.detail()
    );
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_axis_moves_once_it_is_homed_and_a_stop_frees_it_at_once() {
    let (bench, router) = opened().await;
    let to = |axis: &str| format!("/api/v1/rig/axes/{axis}");
    let move_it = async |deg: f64| {
        let body = json!({ "position_deg": deg }).to_string();
        post(&router, &format!("{}/move", to("theta_c")), &body).await
    };
    let refused = move_it(5.0).await;
    is_problem(&refused, 409, "stage-not-referenced");
    assert!(
        refused.detail().contains("home it first"),
        "{}",
        refused.detail()
    );
    // Work that was in progress when the stop was answered blocks no one.
    for _ in 0..5 {
        let home = post(&router, &format!("{}/home", to("theta_c")), "").await;
        assert_eq!(home.status, 202, "{}", home.body);
        let stopped = post(&router, "/api/v1/rig/stop", "").await;
        assert_eq!(stopped.status, 200, "{}", stopped.body);
        let rig = get(&router, "/api/v1/rig").await;
        for axis in ["theta_c", "phi_s"] {
            assert_eq!(rig.body["axes"][axis]["moving"], false, "{}", rig.body);
        }
    }
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_a_client_that_went_away_asked_for_is_done_once_under_its_key() {
    let (bench, router) = opened().await;
    let samples = async || {
        let listed = get(&router, "/api/v1/samples?limit=1000").await.body;
        listed["items"].as_array().unwrap().len()
    };
    let before = samples().await;
    // It goes a step later each time, until it stays for the answer.
    for looks in 1.. {
        let keyed = || {
            let body = json!({ "name": format!("part {looks}") }).to_string();
            request("POST", "/api/v1/samples")
                .header("content-type", "application/json")
                .header("idempotency-key", format!("part {looks}"))
                .body(Body::from(body))
                .unwrap()
        };
        let answer = gone_after(looks, send(&router, keyed())).await;
        let again = send(&router, keyed()).await;
        assert_eq!(again.status, 201, "{}", again.body);
        assert_eq!(samples().await, before + looks as usize);
        if let Some(answer) = answer {
            assert_eq!(answer.body, again.body);
            break;
        }
    }
    bench.end().await;
}
