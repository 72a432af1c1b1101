//! Samples: what is assumed of them and what may be named.

use serde_json::json;

use super::{get, is_problem, opened, patch, post};

#[tokio::test(flavor = "multi_thread")]
async fn a_sample_without_a_material_says_what_was_assumed() {
    let (bench, router) = opened().await;
    let added = post(&router, "/api/v1/samples", r#"{"name": "part 17"}"#).await;
    assert_eq!(added.status, 201);
    assert_eq!(added.body["material"]["eta_std"], json!(0.05));
    let note = added.body["note"]
        .as_str()
        .expect("the assumption is noted");
    assert!(note.contains("1.5 (u = 0.05) assumed"), "{note}");
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_index_without_its_uncertainty_is_as_certain_as_in_a_manifest() {
    let (bench, router) = opened().await;
    let body = r#"{"name": "part 19", "material": {"kind": "dielectric", "eta": 1.5}}"#;
    let added = post(&router, "/api/v1/samples", body).await;
    assert_eq!(added.status, 201, "{}", added.body);
    assert_eq!(added.body["material"]["eta_std"], json!(0.01));
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_sample_may_name_its_metal() {
    let (bench, router) = opened().await;
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
    // Both are found by the name that they share, whatever else it has in it; others are not.
    let other = post(&router, "/api/v1/samples", r#"{"name": "part 18 & 19"}"#).await;
    assert_eq!(other.status, 201);
    let count = async |query: &str| {
        let found = get(&router, &format!("/api/v1/samples?name={query}")).await;
        found.body["items"].as_array().map(Vec::len)
    };
    assert_eq!(count("part%2018").await, Some(2));
    assert_eq!(count("part+18+%26+19").await, Some(1));
    assert_eq!(count("part").await, Some(0));
    let unknown = add(r#"{"name": "Mithril"}"#).await;
    assert_eq!(unknown.status, 422);
    let detail = unknown.detail();
    assert!(detail.contains("known ones are Ag, Al"), "{detail}");
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_sample_is_renamed_and_its_earlier_name_stays() {
    let (bench, router) = opened().await;
    let renamed = patch(&router, "/api/v1/samples/2", r#"{"name": "B-17"}"#).await;
    assert_eq!(renamed.status, 200, "{}", renamed.body);
    assert_eq!(renamed.body["name"], json!("B-17"));
    assert_eq!(
        renamed.body["earlier_names"][0]["name"],
        json!("traced polymer")
    );
    let read = get(&router, "/api/v1/samples/2").await;
    assert_eq!(read.body, renamed.body);
    // A name leads to one part.
    let taken = patch(&router, "/api/v1/samples/1", r#"{"name": "B-17"}"#).await;
    is_problem(&taken, 409, "name-taken");
    assert!(taken.detail().contains("part 2"), "{}", taken.detail());
    let nameless = patch(&router, "/api/v1/samples/2", r#"{"name": " "}"#).await;
    is_problem(&nameless, 422, "invalid-value");
    let missing = patch(&router, "/api/v1/samples/99", r#"{"name": "x"}"#).await;
    is_problem(&missing, 404, "not-found");
    let of_nothing = patch(&router, "/api/v1/scans/99", r#"{"sample_id": 2}"#).await;
    is_problem(&of_nothing, 404, "not-found");
    bench.end().await;
}
