//! Recipes and specifications: kept in versions, and followed by scans up to the verdict.

use std::sync::Arc;

use ridged::scan::ScanState;
use ridged::store::disk::RealDisk;
use serde_json::{Value, json};

use super::{get, is_problem, opened, post, request, send};
use axum::Router;
use axum::body::Body;

use crate::bench_in_a_box::{BenchInABox, in_time, small};

/// A recipe of few poses, with the material of the parts.
pub(crate) fn recipe(name: &str) -> Value {
    json!({
        "name": name,
        "target_expanded_deg": 0.5,
        "plan": {
            "theta_c_deg": [-20, -10, 0, 10, 20], "phi_s_deg": [0, 90, 180], "exposures_s": [0.02],
            "dark": {"repeats": 1}, "flat": {"exposures_s": [0.02]}
        },
        "fit": {"variant": "sawtooth", "starts": 4, "fix": {"rho_d": 0.3}},
        "material": {"eta": 1.54, "eta_std": 0.005}
    })
}

/// Limits that every part with ridges passes.
pub(crate) fn wide_limits(name: &str) -> Value {
    json!({"name": name, "limits": {"theta_r_deg": {"lower": 0.5, "upper": 45.0}}})
}

pub(crate) async fn added(router: &Router, noun: &str, body: &Value) -> Value {
    let answer = post(router, &format!("/api/v1/{noun}"), &body.to_string()).await;
    assert_eq!(answer.status, 201, "{}", answer.body);
    answer.body
}

/// Confirms the steps of a scan until it has ended.
async fn attended(bench: &BenchInABox, id: i64) -> Value {
    let hands = bench.rig.operate(&bench.lab, true);
    bench.until(id, ScanState::Completed).await;
    hands.abort();
    let router = super::router_of(&bench.lab);
    get(&router, &format!("/api/v1/scans/{id}")).await.body
}

/// Waits for the end of what follows a scan, and returns its verdicts.
pub(crate) async fn verdicts(bench: &BenchInABox, router: &Router, scan_id: i64) -> Value {
    bench.lab.until_judged(scan_id).await.unwrap();
    let path = format!("/api/v1/verdicts?scan_id={scan_id}");
    get(router, &path).await.body["items"].clone()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_recipe_is_changed_by_new_versions_and_archived_instead_of_deleted() {
    let (bench, router) = opened().await;
    let first = added(&router, "recipes", &recipe("PX-1")).await;
    assert_eq!((&first["id"], &first["version"]), (&json!(1), &json!(1)));
    assert_eq!(first["recipe"]["fit"]["variant"], "sawtooth");
    let taken = post(&router, "/api/v1/recipes", &recipe("PX-1").to_string()).await;
    is_problem(&taken, 409, "name-taken");
    let mut changed = recipe("PX-1");
    changed["note"] = json!("new lamp");
    let path = "/api/v1/recipes/1/versions";
    let change =
        |replaces: i64, recipe: &Value| json!({"replaces": replaces, "recipe": recipe}).to_string();
    let second = post(&router, path, &change(1, &changed)).await;
    assert_eq!((second.status, &second.body["version"]), (200, &json!(2)));
    // A change that is based on version 1 would undo the note.
    let lost = post(&router, path, &change(1, &recipe("PX-1"))).await;
    is_problem(&lost, 409, "version-conflict");
    let renamed = post(&router, path, &change(2, &recipe("PX-2"))).await;
    is_problem(&renamed, 422, "invalid-value");
    let versions = get(&router, path).await.body;
    assert_eq!(versions["items"].as_array().unwrap().len(), 2);
    let earlier = get(&router, "/api/v1/recipes/1?version=1").await.body;
    assert_eq!(earlier["recipe"]["note"], Value::Null);
    assert_eq!(earlier["newest_version"], 2);
    is_problem(
        &get(&router, "/api/v1/recipes/1?version=3").await,
        404,
        "not-found",
    );

    let archived = post(&router, "/api/v1/recipes/1/archive", "").await;
    assert_eq!(archived.body["archived"], true);
    assert_eq!(
        get(&router, "/api/v1/recipes").await.body["items"],
        json!([])
    );
    let there = get(&router, "/api/v1/recipes?archived=true").await.body;
    assert_eq!(there["items"][0]["name"], "PX-1");
    let body = r#"{"sample_id": 2, "recipe": "PX-1"}"#;
    let refused = post(&router, "/api/v1/scans", body).await;
    is_problem(&refused, 422, "invalid-value");
    assert!(
        refused.detail().contains("archived"),
        "{}",
        refused.detail()
    );
    let restored = post(&router, "/api/v1/recipes/1/restore", "").await;
    assert_eq!(restored.body["archived"], false);
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_recipe_that_no_scan_could_follow_is_refused_by_its_field() {
    let (bench, router) = opened().await;
    let with = |field: &str, value: Value| {
        let mut recipe = recipe("PX-1");
        let pointer = format!("/{}", field.replace('.', "/"));
        match recipe.pointer_mut(&pointer) {
            Some(place) => *place = value,
            None => recipe[field] = value,
        }
        recipe.to_string()
    };
    for (field, value, code, words) in [
        ("name", json!(" PX"), "invalid-value", "name"),
        (
            "target_expanded_deg",
            json!(0),
            "invalid-value",
            "greater than 0",
        ),
        (
            "plan.theta_c_deg",
            json!([200]),
            "plan-invalid",
            "theta_c_deg",
        ),
        ("fit.starts", json!(0), "invalid-value", "fit.starts"),
        ("fit.fix", json!({"rho": 1.0}), "invalid-value", "fit.fix"),
        ("material.eta", json!(-1), "invalid-value", "material.eta"),
        (
            "name",
            json!("PX\u{1b}[31m"),
            "invalid-value",
            "without line breaks",
        ),
        (
            "plan",
            json!({"repeats": 0}),
            "invalid-value",
            "plan.repeats",
        ),
        (
            "layout",
            json!({"patches_x": 0, "patches_y": 2, "patch_size_mm": 1.0}),
            "invalid-value",
            "layout",
        ),
    ] {
        let refused = post(&router, "/api/v1/recipes", &with(field, value)).await;
        assert_eq!(refused.body["code"], code, "{field}: {}", refused.body);
        assert!(
            refused.detail().contains(words),
            "{field}: {}",
            refused.detail()
        );
    }
    let slip = post(&router, "/api/v1/recipes", &with("grid", json!(1))).await;
    is_problem(&slip, 400, "unknown-field");
    let none = json!({"name": "limits", "limits": {}}).to_string();
    let refused = post(&router, "/api/v1/specifications", &none).await;
    is_problem(&refused, 422, "invalid-value");
    // A plan and a recipe together, and neither.
    added(&router, "recipes", &recipe("PX-1")).await;
    for body in [
        r#"{"sample_id": 2}"#,
        r#"{"sample_id": 2, "recipe": 1, "plan": {"preset": "paper"}}"#,
        r#"{"sample_id": 2, "recipe": "PX-9"}"#,
        r#"{"sample_id": 2, "recipe": 1, "lot": ""}"#,
    ] {
        let refused = post(&router, "/api/v1/scans", body).await;
        is_problem(&refused, 422, "invalid-value");
    }
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_scan_of_a_recipe_is_fitted_by_it_and_judged_without_a_request() {
    let (bench, router) = opened().await;
    added(&router, "recipes", &recipe("PX-1")).await;
    added(&router, "specifications", &wide_limits("drawing 1")).await;
    let body = r#"{"sample_id": 1, "recipe": "PX-1", "specification": 1, "operator_name": "Anna", "lot": "4", "external_id": "A-17"}"#;
    let keyed = request("POST", "/api/v1/scans")
        .header("content-type", "application/json")
        .header("idempotency-key", "A-17")
        .body(Body::from(body))
        .unwrap();
    let begun = send(&router, keyed).await;
    assert_eq!(begun.status, 202, "{}", begun.body);
    // A new version while the scan runs does not change what it follows.
    let mut changed = recipe("PX-1");
    changed["fit"] = json!({"variant": "paper"});
    let change = json!({"replaces": 1, "recipe": changed}).to_string();
    let changed = post(&router, "/api/v1/recipes/1/versions", &change).await;
    assert_eq!(changed.body["version"], 2, "{}", changed.body);
    let scan = attended(&bench, 1).await;
    assert_eq!(
        scan["recipe"],
        json!({"id": 1, "name": "PX-1", "version": 1})
    );
    assert_eq!(
        scan["specification"],
        json!({"id": 1, "name": "drawing 1", "version": 1})
    );
    assert_eq!(scan["target_expanded_deg"], 0.5);
    assert_eq!(
        (&scan["operator_name"], &scan["lot"], &scan["external_id"]),
        (&json!("Anna"), &json!("4"), &json!("A-17"))
    );
    let verdicts = verdicts(&bench, &router, 1).await;
    assert_eq!(verdicts.as_array().unwrap().len(), 1);
    assert_eq!(verdicts[0]["specification"], "drawing 1");
    assert_eq!(verdicts[0]["request"]["fit_id"], 1);
    let fit = get(&router, "/api/v1/fits/1").await.body;
    assert_eq!(fit["variant"], "sawtooth", "{fit}");
    assert_eq!(fit["request"]["fix"], json!({"rho_d": 0.3}));
    // The verdict rests on this fit: the same value.
    let value = &fit["parameters"]["theta_r_deg"]["value"];
    assert_eq!(&verdicts[0]["items"][0]["value"], value);

    // The same fit against other limits, by the name of a stored specification; one that leaves the verdict open states
    // what would decide.
    let u = fit["parameters"]["theta_r_deg"]["std"].as_f64();
    let u = u.unwrap_or_else(|| panic!("{fit}"));
    let upper = value.as_f64().unwrap() + u;
    let narrow = json!({"name": "narrow", "limits": {"theta_r_deg": {"upper": upper}}});
    added(&router, "specifications", &narrow).await;
    let begun = post(
        &router,
        "/api/v1/verdicts",
        r#"{"scan_id": 1, "specification": "narrow", "fit_id": 1}"#,
    )
    .await;
    let open = super::ended(&router, &begun).await;
    assert_eq!(open["verdict"], "cannot-tell", "{open}");
    let found = &open["would_decide"]["theta_r_deg"];
    assert_eq!(found["verdict"], "pass", "{open}");
    assert!(found["std_max"].as_f64().unwrap() < u, "{found}");
    for (body, words) in [
        (
            r#"{"scan_id": 1, "specification": "no", "fit_id": 1}"#,
            "no specification",
        ),
        (
            r#"{"scan_id": 1, "specification": 1, "fit_id": 1, "variant": "paper"}"#,
            "leave these out",
        ),
    ] {
        let refused = post(&router, "/api/v1/verdicts", body).await;
        is_problem(&refused, 422, "invalid-value");
        assert!(refused.detail().contains(words), "{}", refused.detail());
    }
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_restart_fits_and_judges_the_scan_whose_fit_the_last_daemon_was_ended_before() {
    let folder = tempfile::tempdir().unwrap();
    let open = async || {
        let bench = BenchInABox::open(folder.path(), Arc::new(RealDisk), false).await;
        let router = super::router_of(&bench.lab);
        (bench, router)
    };
    let (bench, router) = open().await;
    added(&router, "recipes", &recipe("PX-1")).await;
    added(&router, "specifications", &wide_limits("drawing 1")).await;
    let hands = bench.rig.operate(&bench.lab, true);
    bench
        .start(small(&[-20.0, 0.0, 20.0], &[0.0, 90.0, 180.0]))
        .await;
    bench.until(1, ScanState::Completed).await;
    hands.abort();
    // Fits of a person take all slots.
    for _ in 0..4 {
        let long = r#"{"scan_id": 1, "variant": "sawtooth", "bootstrap": 10000}"#;
        assert_eq!(post(&router, "/api/v1/fits", long).await.status, 202);
    }
    let body = r#"{"sample_id": 1, "recipe": "PX-1", "specification": 1}"#;
    assert_eq!(post(&router, "/api/v1/scans", body).await.status, 202);
    attended(&bench, 2).await;
    let of_scan = async |router: &Router, noun: &str, scan_id: i64| {
        let path = format!("/api/v1/{noun}?scan_id={scan_id}");
        get(router, &path).await.body["items"].clone()
    };
    let states = |jobs: &Value| -> Vec<String> {
        let jobs = jobs.as_array().unwrap().iter();
        jobs.map(|job| job["state"].as_str().unwrap().to_owned())
            .collect()
    };
    let mut events = bench.lab.events();
    let begun = async {
        while states(&of_scan(&router, "fits", 2).await).is_empty() {
            events.recv().await.ok();
        }
    };
    in_time(begun).await;
    bench.end().await;

    let (bench, router) = open().await;
    let mut events = bench.lab.events();
    let judged = async {
        while states(&of_scan(&router, "verdicts", 2).await) != ["completed"] {
            events.recv().await.ok();
        }
    };
    in_time(judged).await;
    let fits = of_scan(&router, "fits", 2).await;
    assert_eq!(states(&fits), ["completed", "interrupted"]);
    let verdict = of_scan(&router, "verdicts", 2).await;
    assert_eq!(verdict[0]["request"]["fit_id"], fits[0]["id"]);
    // Nothing follows a fit that a person asked for.
    assert_eq!(
        states(&of_scan(&router, "fits", 1).await),
        ["interrupted"; 4]
    );
    bench.end().await;
}
