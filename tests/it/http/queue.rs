//! The queue: parts in sequence on the simulated rig, each asked for by its operator step.

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use axum::body::Body;
use ridged::scan::faults::OnFailure;
use ridged::store::disk::RealDisk;
use serde_json::{Value, json};

use super::recipes::{added, wide_limits};
use super::{Answer, get, is_problem, post, request, router_of, send};
use crate::bench_in_a_box::BenchInABox;

/// A bench whose hands do each step in the world and leave its confirmation to the client.
async fn bench(folder: &Path, on_failure: OnFailure) -> (BenchInABox, Router) {
    let disk = Arc::new(RealDisk);
    let settings = |mut parts: ridged::lab::RigParts| {
        parts.settings.queue_on_failure = on_failure;
        parts
    };
    let bench = BenchInABox::open_as(folder, disk, false, Duration::ZERO, settings).await;
    // Ends with the lab.
    drop(bench.rig.operate(&bench.lab, false));
    let router = router_of(&bench.lab);
    (bench, router)
}

/// Few poses: a fit reports at once that they are too few.
fn recipe(name: &str) -> Value {
    json!({
        "name": name,
        "plan": {
            "theta_c_deg": [0], "phi_s_deg": [0, 90, 180], "exposures_s": [0.02],
            "dark": {"repeats": 1}, "flat": {"exposures_s": [0.02]}
        },
        "material": {"eta": 1.54, "eta_std": 0.005}
    })
}

async fn add(router: &Router, orders: Value) -> Answer {
    let body = json!({ "orders": orders }).to_string();
    post(router, "/api/v1/queue/orders", &body).await
}

/// Three parts of a lot, the last of them a sample of the store.
async fn three(router: &Router) -> Vec<Value> {
    added(router, "recipes", &recipe("PX")).await;
    added(router, "specifications", &wide_limits("drawing 1")).await;
    let order = |part: &str, id: &str| json!({"part": part, "recipe": "PX", "specification": "drawing 1", "lot": "4", "external_id": id, "operator_name": "Anna"});
    let orders = [
        order("B-17", "A-1"),
        order("B-18", "A-2"),
        order("traced polymer", "A-3"),
    ];
    let answer = add(router, json!(orders)).await;
    assert_eq!(answer.status, 201, "{}", answer.body);
    answer.body["items"].as_array().unwrap().clone()
}

async fn queue(router: &Router) -> Value {
    get(router, "/api/v1/queue").await.body
}

async fn order(router: &Router, id: i64) -> Value {
    get(router, &format!("/api/v1/queue/orders/{id}"))
        .await
        .body
}

async fn asked(router: &Router, what: &str) -> Value {
    let answer = post(router, &format!("/api/v1/queue/{what}"), "").await;
    assert_eq!(answer.status, 200, "{what}: {}", answer.body);
    answer.body
}

/// Looks at the queue until `enough` is true. Confirms the steps of each part but those for which `leave` is true.
async fn until(
    router: &Router,
    leave: impl Fn(&Value) -> bool,
    enough: impl Fn(&Value) -> bool,
) -> Value {
    for _ in 0..20_000 {
        let now = queue(router).await;
        if enough(&now) {
            return now;
        }
        let current = &now["current"];
        if !current["operator"].is_null() && !leave(current) {
            // The scan may have taken its next step in the meantime.
            let _: Answer = post(router, "/api/v1/queue/continue", "").await;
        }
        tokio::time::sleep(Duration::from_millis(3)).await;
    }
    panic!("{}", queue(router).await);
}

/// Looks until a part is asked for.
async fn until_asked_for(router: &Router, part: &str) -> Value {
    let asks = |current: &Value| {
        current["order"]["part"] == part && current["operator"]["action"] == "place-sample"
    };
    until(router, asks, |now| asks(&now["current"])).await
}

fn is_stopped(now: &Value) -> bool {
    now["state"] == "stopped"
}

#[tokio::test(flavor = "multi_thread")]
async fn a_name_of_two_parts_is_refused_with_their_numbers() {
    let folder = tempfile::tempdir().unwrap();
    let (bench, router) = bench(folder.path(), OnFailure::default()).await;
    added(&router, "recipes", &recipe("PX")).await;
    let mut ids = Vec::new();
    for eta in [1.5, 1.6] {
        let body = json!({"name": "B-1", "material": {"kind": "dielectric", "eta": eta}});
        let sample = post(&router, "/api/v1/samples", &body.to_string()).await;
        ids.push(sample.body["id"].as_i64().unwrap());
    }
    let refused = add(&router, json!([{"part": "B-1", "recipe": "PX"}])).await;
    is_problem(&refused, 422, "invalid-value");
    let listed = format!("{}, {}", ids[0], ids[1]);
    assert!(refused.detail().contains(&listed), "{}", refused.detail());
    let order = json!([{"sample_id": ids[0], "recipe": "PX"}]);
    let accepted = add(&router, order).await;
    assert_eq!(accepted.status, 201, "{}", accepted.body);
    assert_eq!(accepted.body["items"][0]["sample_id"], json!(ids[0]));
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn three_parts_are_measured_one_after_the_other_and_judged() {
    let folder = tempfile::tempdir().unwrap();
    let (bench, router) = bench(folder.path(), OnFailure::Stop).await;
    let empty = post(&router, "/api/v1/queue/start", "").await;
    is_problem(&empty, 409, "queue-empty");
    let orders = three(&router).await;
    assert_eq!(orders[2]["sample_id"], 2);
    let now = queue(&router).await;
    assert_eq!(
        (&now["state"], &now["counts"]["waiting"]),
        (&json!("stopped"), &json!(3))
    );
    assert_eq!(now["next"]["part"], "B-17");
    // The sequence is changed before the start: the last part becomes the second one.
    let moved = post(&router, "/api/v1/queue/orders/3/move", r#"{"to": 2}"#).await;
    assert_eq!(moved.status, 200, "{}", moved.body);
    let listed = get(&router, "/api/v1/queue/orders").await.body;
    let parts = listed["items"]
        .as_array()
        .unwrap()
        .iter()
        .map(|o| o["id"].as_i64().unwrap());
    assert_eq!(parts.collect::<Vec<_>>(), [1, 3, 2]);

    asked(&router, "start").await;
    let asks = until_asked_for(&router, "B-17").await;
    let message = asks["message"].as_str().unwrap();
    assert!(
        message.starts_with("Next part: B-17 (order 1, scan 1)."),
        "{message}"
    );
    // While the part is measured its order cannot be removed.
    let remove = request("DELETE", "/api/v1/queue/orders/1")
        .body(Body::empty())
        .unwrap();
    is_problem(&send(&router, remove).await, 409, "state-conflict");
    let end = until(&router, |_| false, is_stopped).await;
    assert_eq!(end["reason"], "all orders are done", "{end}");
    assert_eq!(end["counts"]["done"], 3);
    for (scan_id, order_id) in [(1, 1), (2, 3), (3, 2)] {
        bench.lab.until_judged(scan_id).await.unwrap();
        let order = order(&router, order_id).await;
        assert_eq!(
            (&order["state"], &order["scan_id"], &order["verdict"]),
            (&json!("done"), &json!(scan_id), &json!("cannot-tell")),
            "{order}"
        );
        let scan = get(&router, &format!("/api/v1/scans/{scan_id}")).await.body;
        assert_eq!(
            (
                &scan["order_id"],
                &scan["sample_name"],
                &scan["lot"],
                &scan["operator_name"]
            ),
            (&order["id"], &order["part"], &json!("4"), &json!("Anna"))
        );
        assert_eq!(scan["recipe"]["name"], "PX");
        // Only the first part needs new dark frames and a white reference.
        let own = scan["progress"]["frames_total"] == 5;
        assert_eq!(own, scan_id == 1, "{scan}");
    }
    bench.lab.shut_down().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_order_that_cannot_be_is_refused_with_all_others_of_its_request() {
    let folder = tempfile::tempdir().unwrap();
    let (bench, router) = bench(folder.path(), OnFailure::Stop).await;
    three(&router).await;
    let mut bare = recipe("bare");
    bare.as_object_mut().unwrap().remove("material");
    added(&router, "recipes", &bare).await;
    let fine = json!({"part": "B-20", "recipe": 1});
    for (wrong, status, code, words) in [
        (
            json!({"part": "B-21", "recipe": "PX", "external_id": "A-2"}),
            409,
            "external-id-taken",
            "order 2 (B-18, waiting)",
        ),
        (
            json!({"part": "B-21", "recipe": "QX"}),
            422,
            "invalid-value",
            "orders[1].recipe: there is no recipe `QX`",
        ),
        (
            json!({"part": "B-21", "recipe": "bare"}),
            422,
            "invalid-value",
            "states no material",
        ),
        (
            json!({"recipe": "PX"}),
            422,
            "invalid-value",
            "orders[1].part",
        ),
        (
            json!({"sample_id": 99, "recipe": "PX"}),
            422,
            "invalid-value",
            "orders[1].sample_id",
        ),
        (
            json!({"part": "B-21", "recipe": "PX", "when": 1}),
            400,
            "unknown-field",
            "when",
        ),
    ] {
        let refused = add(&router, json!([fine, wrong])).await;
        is_problem(&refused, status, code);
        assert!(refused.detail().contains(words), "{}", refused.detail());
    }
    let twice = json!({"part": "B-22", "recipe": "PX", "external_id": "A-9"});
    is_problem(
        &add(&router, json!([twice, twice])).await,
        422,
        "invalid-value",
    );
    is_problem(&add(&router, json!([])).await, 422, "invalid-value");
    assert_eq!(queue(&router).await["counts"]["waiting"], 3);
    let none = get(&router, "/api/v1/samples?name=B-20").await.body;
    assert_eq!(none["items"], json!([]));
    // The id of a removed order is free.
    let remove = request("DELETE", "/api/v1/queue/orders/2")
        .body(Body::empty())
        .unwrap();
    assert_eq!(send(&router, remove).await.body["state"], "removed");
    let again = json!({"part": "B-21", "recipe": "PX", "external_id": "A-2"});
    assert_eq!(add(&router, json!([again])).await.status, 201);
    bench.lab.shut_down().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_queue_stops_after_the_present_part_pauses_and_is_paused_by_a_stop_of_the_rig() {
    let folder = tempfile::tempdir().unwrap();
    let (bench, router) = bench(folder.path(), OnFailure::Stop).await;
    three(&router).await;
    is_problem(
        &post(&router, "/api/v1/queue/pause", "").await,
        409,
        "state-conflict",
    );
    is_problem(
        &post(&router, "/api/v1/queue/continue", "").await,
        409,
        "state-conflict",
    );
    asked(&router, "start").await;
    until_asked_for(&router, "B-17").await;
    assert_eq!(asked(&router, "stop").await["state"], "stopping");
    let end = until(&router, |_| false, is_stopped).await;
    assert_eq!(
        (&end["counts"]["done"], &end["counts"]["waiting"]),
        (&json!(1), &json!(2))
    );

    asked(&router, "start").await;
    until_asked_for(&router, "B-18").await;
    let paused = asked(&router, "pause").await;
    assert_eq!(paused["state"], "paused");
    let held = until(
        &router,
        |_| true,
        |now| now["current"]["scan_state"] == "paused",
    )
    .await;
    assert_eq!(held["current"]["order"]["id"], 2);
    asked(&router, "resume").await;
    until_asked_for(&router, "B-18").await;

    let stop = post(&router, "/api/v1/rig/stop", "").await;
    assert_eq!(stop.status, 200, "{}", stop.body);
    let stopped = until(&router, |_| true, |now| now["state"] == "paused").await;
    let reason = stopped["reason"].as_str().unwrap();
    assert!(reason.contains("the rig was stopped"), "{reason}");
    let held = until(
        &router,
        |_| true,
        |now| now["current"]["scan_state"] == "paused",
    )
    .await;
    assert_eq!(held["counts"]["done"], 1);
    // The queue may be stopped all the same, and stays so.
    assert_eq!(asked(&router, "stop").await["state"], "stopping");
    tokio::time::sleep(Duration::from_secs(1)).await;
    let stopping = queue(&router).await;
    assert_eq!(stopping["state"], "stopping", "{stopping}");
    asked(&router, "resume").await;
    let end = until(&router, |_| false, is_stopped).await;
    assert_eq!(end["counts"]["done"], 3, "{end}");
    bench.lab.shut_down().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn after_a_restart_the_queue_waits_for_a_person_and_then_finishes_its_part() {
    let folder = tempfile::tempdir().unwrap();
    let (first, router) = bench(folder.path(), OnFailure::Stop).await;
    three(&router).await;
    asked(&router, "start").await;
    until_asked_for(&router, "B-17").await;
    first.lab.shut_down().await;
    drop((first, router));

    let (bench, router) = bench(folder.path(), OnFailure::Stop).await;
    let now = queue(&router).await;
    assert_eq!(
        (&now["state"], &now["who"]),
        (&json!("paused"), &json!("daemon"))
    );
    let reason = now["reason"].as_str().unwrap();
    assert!(
        reason.contains("restarted during order 1 (B-17, scan 1)"),
        "{reason}"
    );
    let events = bench.lab.store().events_after(0, 1000).await.unwrap();
    let waits = |event: &ridged::scan::Event| matches!(event, ridged::scan::Event::Alarm { code, .. } if code == "queue-waits");
    assert!(events.iter().any(|e| waits(&e.event)));
    // Nothing begins by itself.
    tokio::time::sleep(Duration::from_millis(50)).await;
    assert_eq!(queue(&router).await["current"]["scan_state"], "interrupted");
    asked(&router, "resume").await;
    let end = until(&router, |_| false, is_stopped).await;
    assert_eq!(
        (&end["counts"]["done"], &end["reason"]),
        (&json!(3), &json!("all orders are done"))
    );
    assert_eq!(order(&router, 1).await["scan_id"], 1);
    bench.lab.shut_down().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_failed_part_stops_the_queue_or_waits_again_at_its_end_once() {
    let folder = tempfile::tempdir().unwrap();
    let (first, router) = bench(folder.path(), OnFailure::Stop).await;
    three(&router).await;
    asked(&router, "start").await;
    until_asked_for(&router, "B-17").await;
    assert_eq!(post(&router, "/api/v1/scans/1/abort", "").await.status, 202);
    let stopped = until(&router, |_| false, is_stopped).await;
    let reason = stopped["reason"].as_str().unwrap();
    assert!(
        reason.contains("order 1 (B-17) failed: aborted by the operator"),
        "{reason}"
    );
    assert_eq!(order(&router, 1).await["state"], "failed");
    let retried = post(&router, "/api/v1/queue/orders/1/retry", "").await;
    assert_eq!(
        (&retried.body["state"], &retried.body["failures"]),
        (&json!("waiting"), &json!(1))
    );
    first.lab.shut_down().await;
    drop((first, router));

    let (bench, router) = bench(folder.path(), OnFailure::End).await;
    // An order whose recipe is out of use by now, and a part whose scan is aborted.
    let late = json!({"part": "B-23", "recipe": {"id": 1}});
    is_problem(&add(&router, json!([late])).await, 422, "invalid-value");
    added(&router, "recipes", &recipe("QX")).await;
    assert_eq!(
        add(&router, json!([{"part": "B-23", "recipe": "QX"}]))
            .await
            .status,
        201
    );
    post(&router, "/api/v1/recipes/2/archive", "").await;
    asked(&router, "start").await;
    let asks = until_asked_for(&router, "B-17").await;
    let scan_id = asks["current"]["order"]["scan_id"].clone();
    let again = until_asked_for(&router, "B-18");
    post(&router, &format!("/api/v1/scans/{scan_id}/abort"), "").await;
    // It failed twice, so that it stops the queue even so.
    let stopped = until(&router, |_| false, is_stopped).await;
    assert!(
        stopped["reason"].as_str().unwrap().contains("order 1"),
        "{stopped}"
    );
    asked(&router, "start").await;
    let asks = again.await;
    let scan_id = asks["current"]["order"]["scan_id"].clone();
    post(&router, &format!("/api/v1/scans/{scan_id}/abort"), "").await;
    // This one comes again at the end, and the order without a recipe stops the queue in the end.
    let stopped = until(&router, |_| false, is_stopped).await;
    assert!(
        stopped["reason"]
            .as_str()
            .unwrap()
            .contains("order 4 (B-23) failed"),
        "{stopped}"
    );
    assert_eq!(order(&router, 2).await["state"], "done");
    assert_eq!(order(&router, 3).await["state"], "done");
    assert_eq!(order(&router, 4).await["failures"], 2);
    bench.lab.shut_down().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_queue_begins_no_part_while_another_caller_holds_the_rig() {
    let folder = tempfile::tempdir().unwrap();
    let (bench, router) = bench(folder.path(), OnFailure::Stop).await;
    three(&router).await;
    asked(&router, "start").await;
    until_asked_for(&router, "B-17").await;
    let body = r#"{"name": "night run"}"#;
    let lease = post(&router, "/api/v1/lease", body).await;
    assert_eq!(lease.status, 201, "{}", lease.body);
    // The part that has begun is finished: a confirmation needs no lease.
    let paused = until(&router, |_| false, |now| now["state"] == "paused").await;
    let reason = paused["reason"].as_str().unwrap();
    assert!(
        reason.contains("local holds the rig (night run)"),
        "{reason}"
    );
    assert_eq!(paused["counts"]["done"], 1);
    let refused = post(&router, "/api/v1/queue/start", "").await;
    is_problem(&refused, 409, "lease-held");
    let start = request("POST", "/api/v1/queue/start")
        .header("ridged-lease", lease.body["id"].as_str().unwrap())
        .body(Body::empty())
        .unwrap();
    assert_eq!(send(&router, start).await.status, 200);
    let end = until(&router, |_| false, is_stopped).await;
    assert_eq!(end["counts"]["done"], 3);
    bench.lab.shut_down().await;
}
