//! What does not get in: bad input by its name, bodies that are too large, other pages and other hosts.

use axum::body::Body;
use axum::http::Request;
use serde_json::{Value, json};

use super::{get, is_problem, opened, post, request, send};

#[tokio::test(flavor = "multi_thread")]
async fn bad_input_is_refused_by_name_and_nothing_happens() {
    let (bench, router) = opened().await;
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
            "[10]",
            422,
            "invalid-value",
            "/api/v1/rig/axes/theta_c/move",
        ),
        (
            &plan(r#"{"preset": "paper", "dark": [1]}"#),
            422,
            "invalid-value",
            "/api/v1/scans",
        ),
        ("[1]", 422, "invalid-value", "/api/v1/fits"),
        (
            r#"{"name": "a", "material": ["dielectric", 1.5, 0.01]}"#,
            422,
            "invalid-value",
            "/api/v1/samples",
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
        (
            r#"{"name": "x", "material": {"kind": "dielectric", "eta": 1.5, "eta_sdt": 0.01}}"#,
            400,
            "unknown-field",
            "/api/v1/samples",
        ),
        (
            r#"{"name": "x", "material": {"kind": "dielectric", "eta": 1.5, "k": 0.5}}"#,
            400,
            "unknown-field",
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
            r#"{"scan_id": 77, "variant": ["auto"]}"#,
            422,
            "invalid-value",
            "/api/v1/fits",
        ),
        (
            r#"{"scan_id": 77, "variant": {"auto": null}}"#,
            422,
            "invalid-value",
            "/api/v1/fits",
        ),
        (
            r#"{"scan_id": 77, "fix": {"rho_d": 0.3, "rho_d": 0.4}}"#,
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
            r#"{"folder": "/tmp/nowhere/at/all"}"#,
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
    // A value of any size is quoted with the digits that it has.
    for (path, body) in [
        (
            "/api/v1/rig/axes/theta_c/move",
            r#"{"position_deg": 1e300}"#.to_owned(),
        ),
        (
            "/api/v1/scans",
            plan(r#"{"theta_c_deg": [1e300, -1e300], "phi_s_deg": [1e300], "exposures_s": [1e300, 1e-300]}"#),
        ),
        (
            "/api/v1/scans",
            plan(r#"{"theta_c_deg": {"from": -1e300, "to": 1e300, "step": 1e-300}, "phi_s_deg": [0]}"#),
        ),
        (
            "/api/v1/samples",
            r#"{"name": "x", "material": {"kind": "dielectric", "eta": 1e300}}"#.to_owned(),
        ),
        (
            "/api/v1/fits",
            r#"{"scan_id": 1, "fix": {"theta_r_deg": 1e300}}"#.to_owned(),
        ),
        (
            "/api/v1/fits",
            r#"{"scan_id": 1, "priors": {"theta_r_deg": {"value": 1, "std": -1e300}}}"#.to_owned(),
        ),
        (
            "/api/v1/traces",
            r#"{"scene": {"light": {"theta_i_deg": 1e300}, "interface": [{"shape": "flat", "below": {"n": 1.5}}]}}"#.to_owned(),
        ),
        (
            "/api/v1/verdicts",
            r#"{"scan_id": 1, "specification": {"name": "a", "limits": {"theta_r_deg": {"lower": 1e300, "upper": -1e300}}}}"#.to_owned(),
        ),
    ] {
        let far = post(&router, path, &body).await;
        assert!(matches!(far.status, 404 | 422), "{body}: {}", far.body);
        assert!(far.detail().len() < 500, "{}", far.detail());
        let digits = far.detail().split(|c: char| !c.is_ascii_digit());
        assert!(digits.map(str::len).max() < Some(12), "{}", far.detail());
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
        "/api/v1/maps/x/files/bins.csv",
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
    ] {
        is_problem(&answer, 404, "not-found");
        assert!(answer.detail().contains("/api/v1"), "{}", answer.detail());
    }
    for method in ["POST", "PUT", "DELETE", "OPTIONS", "PATCH"] {
        let asked = request(method, "/").body(Body::empty()).unwrap();
        let answer = send(&router, asked).await;
        is_problem(&answer, 405, "method-not-allowed");
        assert!(answer.detail().contains("/api/v1"), "{}", answer.detail());
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
    let (bench, router) = opened().await;
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
    let (bench, router) = opened().await;
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
async fn fits_are_searched_by_the_words_that_reports_have() {
    let (_bench, router) = opened().await;
    let known = get(&router, "/api/v1/fits?status=at-bound&variant=traced").await;
    assert_eq!(known.status, 200);
    for (query, word) in [("status=fine", "converged"), ("variant=auto", "sawtooth")] {
        let answer = get(&router, &format!("/api/v1/fits?{query}")).await;
        assert_eq!(answer.status, 422);
        assert!(answer.body.to_string().contains(word), "{}", answer.body);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn values_are_refused_by_their_path_and_in_plain_words() {
    let (_bench, router) = opened().await;
    let samples = "/api/v1/samples";
    for (path, body, field, words) in [
        (samples, "{}", "name", "is missing"),
        (samples, "[]", "body", "an object of named fields"),
        (
            samples,
            r#"{"name": "x", "material": {"kind": "dielectric"}}"#,
            "material.eta",
            "is missing",
        ),
        (
            samples,
            r#"{"name": "x", "metal": {"name": 3}}"#,
            "metal.name",
            "metal.name: expected a text, got 3",
        ),
        (
            samples,
            r#"{"name": "x", "material": {"kind": "dielectric", "eta": "a"}}"#,
            "material.eta",
            "expected a number, got \"a\"",
        ),
        (
            samples,
            r#"{"name": "x", "material": {"kind": "conductor", "eta": 1}}"#,
            "material.k",
            "is missing",
        ),
        (
            "/api/v1/rig/axes/theta_c/move",
            r#"{"position_deg": "a"}"#,
            "position_deg",
            "position_deg: expected a number, got \"a\"",
        ),
        (
            "/api/v1/scans",
            r#"{"sample_id": 1, "plan": {"theta_c_deg": "all", "phi_s_deg": [0]}}"#,
            "plan.theta_c_deg",
            "a list of numbers",
        ),
    ] {
        let refused = post(&router, path, body).await;
        is_problem(&refused, 422, "invalid-value");
        assert_eq!(refused.body["errors"][0]["field"], field, "{body}");
        assert!(refused.detail().contains(words), "{}", refused.detail());
    }
    let refused = get(&router, "/api/v1/fits?limit=many").await;
    is_problem(&refused, 422, "invalid-value");
    assert_eq!(
        refused.detail(),
        "limit: expected a whole number from 0 to 4294967295, got \"many\""
    );
    let refused = get(&router, "/api/v1/fits?theta_r_deg_min=ten").await;
    assert_eq!(
        refused.detail(),
        "theta_r_deg_min: expected a number, got \"ten\""
    );
    let refused = get(&router, "/api/v1/fits?colour=red").await;
    is_problem(&refused, 400, "bad-request");
    let detail = refused.detail();
    assert!(
        detail.contains("there is no parameter `colour`"),
        "{detail}"
    );
    let refused = get(&router, "/api/v1/scans?sampel_id=3").await;
    let detail = refused.detail();
    assert!(detail.contains("did you mean `sample_id`?"), "{detail}");
}

#[tokio::test(flavor = "multi_thread")]
async fn every_route_that_is_read_refuses_a_parameter_that_it_does_not_have() {
    let (bench, router) = opened().await;
    let document: Value = serde_json::from_str(ridged::api::openapi()).unwrap();
    let mut routes = 0;
    for (path, item) in document["paths"].as_object().unwrap() {
        if item["get"].is_null() {
            continue;
        }
        let asked = format!(
            "{}?bogus=1",
            path.replace("{id}", "1").replace("{name}", "a.csv")
        );
        let refused = get(&router, &asked).await;
        is_problem(&refused, 400, "bad-request");
        assert!(
            refused.detail().contains("bogus"),
            "{path}: {}",
            refused.detail()
        );
        routes += 1;
    }
    assert!(routes > 50, "{routes}");
    is_problem(
        &post(&router, "/api/v1/queue/stop?bogus=1", "").await,
        400,
        "bad-request",
    );
    // Nothing refuses the stop.
    let stop = post(&router, "/api/v1/rig/stop?bogus=1", "").await;
    assert_eq!(stop.status, 200, "{}", stop.body);
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_cursor_that_no_page_has_is_refused_like_one_that_is_no_number() {
    let (bench, router) = opened().await;
    for cursor in ["-5", "0", "x", "9223372036854775808"] {
        for list in ["samples", "scans", "queue/orders", "fits", "calibrations"] {
            let refused = get(&router, &format!("/api/v1/{list}?cursor={cursor}")).await;
            is_problem(&refused, 422, "invalid-value");
            assert_eq!(refused.detail(), "cursor: is not the next_cursor of a page");
        }
    }
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_name_needs_a_visible_character() {
    let (bench, router) = opened().await;
    let blank = "\u{2060}\u{feff}";
    let material = json!({ "kind": "dielectric", "eta": 1.5 });
    for (path, body) in [
        ("samples", json!({ "name": blank, "material": material })),
        ("lease", json!({ "name": blank })),
    ] {
        let refused = post(&router, &format!("/api/v1/{path}"), &body.to_string()).await;
        is_problem(&refused, 422, "invalid-value");
        assert_eq!(refused.body["errors"][0]["field"], "name", "{path}");
    }
    bench.end().await;
}
