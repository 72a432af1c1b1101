//! Tags, note and archived flag of a scan: changed, found, left out of lists, undone.

use axum::body::Body;
use serde_json::{Value, json};

use super::{get, imported, is_problem, opened, patch, request, send};

async fn ids(router: &axum::Router, query: &str) -> Vec<i64> {
    let found = get(router, &format!("/api/v1/scans{query}")).await;
    assert_eq!(found.status, 200, "{}", found.body);
    let items = found.body["items"].as_array().unwrap();
    items
        .iter()
        .filter_map(|scan| scan["id"].as_i64())
        .collect()
}

#[tokio::test]
async fn a_record_is_changed_found_by_and_undone_with_a_trace() {
    let (_bench, router) = opened().await;
    imported(&router).await;
    imported(&router).await;
    let body = json!({ "tags": ["study 1", "night"], "note": "edge" }).to_string();
    let changed = patch(&router, "/api/v1/scans/1", &body).await;
    assert_eq!(changed.status, 200, "{}", changed.body);
    assert_eq!(changed.body["tags"], json!(["study 1", "night"]));
    assert_eq!(changed.body["note"], "edge");
    assert_eq!(ids(&router, "?tag=study%201").await, [1]);
    assert_eq!(ids(&router, "?tag=study").await, Vec::<i64>::new());

    // What a body does not state stays; null removes the note.
    patch(&router, "/api/v1/scans/1", r#"{"archived": true}"#).await;
    let archived = patch(&router, "/api/v1/scans/1", r#"{"note": null}"#).await;
    assert_eq!(
        (&archived.body["note"], &archived.body["archived"]),
        (&Value::Null, &json!(true))
    );
    assert_eq!(archived.body["tags"], json!(["study 1", "night"]));
    assert_eq!(ids(&router, "").await, [2]);
    assert_eq!(ids(&router, "?archived=true").await, [1]);
    assert_eq!(ids(&router, "?archived=all").await, [2, 1]);
    // Its address stays valid.
    assert_eq!(get(&router, "/api/v1/scans/1").await.body, archived.body);
    let results = get(
        &router,
        "/api/v1/results?archived=all&tag=night&fields=scan_id,archived,tags,note",
    )
    .await;
    let row = json!({ "scan_id": 1, "archived": true, "tags": ["study 1", "night"], "note": null });
    assert_eq!(results.body["items"], json!([row]));
    let results = get(&router, "/api/v1/results?count=true").await;
    assert_eq!(results.body["count"], json!(1), "{}", results.body);

    // Undo is a change back.
    patch(
        &router,
        "/api/v1/scans/1",
        r#"{"archived": false, "note": "edge"}"#,
    )
    .await;
    assert_eq!(ids(&router, "").await, [2, 1]);
    let changes = get(&router, "/api/v1/scans/1/changes?limit=3").await;
    assert_eq!(changes.status, 200, "{}", changes.body);
    let rows = changes.body["items"].as_array().unwrap();
    let notes: Vec<&Value> = rows.iter().map(|row| &row["note"]).collect();
    assert_eq!(notes, [&json!("edge"), &json!("edge"), &Value::Null]);
    assert!(rows.iter().all(|row| row["who"] == "local"), "{rows:?}");
    let cursor = changes.body["next_cursor"].as_str().unwrap();
    let rest = get(
        &router,
        &format!("/api/v1/scans/1/changes?limit=3&cursor={cursor}"),
    )
    .await;
    assert_eq!(rest.body["items"][0]["archived"], json!(false));
    assert_eq!(rest.body["next_cursor"], Value::Null);
}

#[tokio::test]
async fn a_record_that_is_not_valid_is_refused_and_changes_nothing() {
    let (_bench, router) = opened().await;
    imported(&router).await;
    let long = "x".repeat(41);
    let note = "x".repeat(4001);
    for (body, field) in [
        (json!({}), "body"),
        (json!({ "tags": [long], "note": "kept out" }), "tags"),
        (json!({ "tags": ["a,b"] }), "tags"),
        (json!({ "note": note }), "note"),
        (json!({ "archived": "yes" }), "archived"),
        (json!({ "tags": "a" }), "tags"),
    ] {
        let refused = patch(&router, "/api/v1/scans/1", &body.to_string()).await;
        is_problem(&refused, 422, "invalid-value");
        assert_eq!(
            refused.body["errors"][0]["field"], field,
            "{}",
            refused.body
        );
    }
    let scan = get(&router, "/api/v1/scans/1").await.body;
    assert_eq!((&scan["tags"], &scan["note"]), (&json!([]), &Value::Null));
    let unknown = patch(&router, "/api/v1/scans/99", r#"{"archived": true}"#).await;
    is_problem(&unknown, 404, "not-found");
    is_problem(
        &get(&router, "/api/v1/scans/99/changes").await,
        404,
        "not-found",
    );
    let word = patch(&router, "/api/v1/scans/1", r#"{"archive": true}"#).await;
    is_problem(&word, 400, "unknown-field");
    for (query, field) in [("archived=no", "archived"), ("tag=a,b", "tag")] {
        let refused = get(&router, &format!("/api/v1/scans?{query}")).await;
        is_problem(&refused, 422, "invalid-value");
        assert_eq!(
            refused.body["errors"][0]["field"], field,
            "{}",
            refused.body
        );
        let refused = get(&router, &format!("/api/v1/results?{query}")).await;
        is_problem(&refused, 422, "invalid-value");
    }
    let nothing = send(
        &router,
        request("PATCH", "/api/v1/scans/1")
            .body(Body::empty())
            .unwrap(),
    )
    .await;
    assert!((400..500).contains(&nothing.status), "{}", nothing.body);
}
