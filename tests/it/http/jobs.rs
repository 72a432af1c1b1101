//! Jobs of a scan: contrasts, verdicts, maps and fits; and the results of `ridged accuracy`.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use serde_json::json;

use super::{costs, ended, forecasts, get, imported, is_problem, opened, post};

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_scan_has_a_contrast_and_is_judged_against_a_specification() {
    let (bench, router) = opened().await;
    imported(&router).await;

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
        assert!(refused.detail().contains(word), "{}", refused.detail());
    }
    let list = get(&router, "/api/v1/verdicts?scan_id=1&state=completed").await;
    assert_eq!(list.body["items"].as_array().unwrap().len(), 3);
    is_problem(
        &get(&router, "/api/v1/verdicts?state=done").await,
        422,
        "invalid-value",
    );
    // Each kind has its own numbers.
    is_problem(&get(&router, "/api/v1/contrasts/2").await, 404, "not-found");
    // An event has the forecast of each before it starts.
    let reported = forecasts(&bench).await;
    let reported: Vec<(&str, i64)> = reported.iter().map(|(of, n)| (of.as_str(), *n)).collect();
    assert_eq!(
        reported,
        [
            ("contrast", 1),
            ("verdict", 1),
            ("verdict", 2),
            ("verdict", 3)
        ]
    );
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_map_reports_its_progress_and_can_be_cancelled() {
    let (bench, router) = opened().await;
    imported(&router).await;
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
    // It has no files then.
    let file = get(&router, &format!("{map}/files/summary.json")).await;
    is_problem(&file, 409, "state-conflict");
    // What has ended cannot be cancelled.
    let again = post(&router, &format!("{map}/cancel"), "").await;
    is_problem(&again, 409, "state-conflict");
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
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn results_of_accuracy_are_served_as_they_were_written() {
    let (bench, router) = opened().await;
    let missing = get(&router, "/api/v1/accuracy").await;
    assert_eq!(
        (missing.status, &missing.body["points"]),
        (200, &serde_json::json!([]))
    );
    let why = missing.body["left_out"][0]["why"].as_str().unwrap();
    assert!(why.contains("ridged accuracy --data"), "{why}");
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

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_fit_traces_on_a_measured_shape() {
    let (bench, router) = opened().await;
    imported(&router).await;
    // A sawtooth of 10° with a corner cut, one period across the ridges.
    let shape = json!({
        "name": "ridge.csv",
        "content": STANDARD.encode("v_um,z_um\n0,0\n9,-1.587\n9.6,-1.6\n10,0\n"),
    });
    let request = json!({ "scan_id": 1, "variant": "traced", "max_seconds": 1.0, "shape": shape });
    let begun = post(&router, "/api/v1/fits", &request.to_string()).await;
    let fit = ended(&router, &begun).await;
    assert_eq!(fit["state"], "completed", "{fit}");
    let without = json!({ "scan_id": 1, "variant": "sawtooth", "shape": shape });
    let map = json!({ "name": "map.csv", "content": STANDARD.encode("0,1,2\n0,1,2\n0,1,2\n") });
    let flat = json!({ "name": "flat.csv", "content": STANDARD.encode("0,0,0\n0,0,0\n0,0,0\n"), "pitch_um": [1, 1], "height_unit_um": 1 });
    let other = json!({ "name": "ridge.stl", "content": "" });
    let traced = |shape| json!({ "scan_id": 1, "variant": "traced", "shape": shape });
    for (request, word) in [
        (without, "ray tracer"),
        (traced(map), "pitch_um"),
        (traced(flat), "flat"),
        (traced(other), ".x3p"),
        (traced(json!({ "name": "a.csv", "content": "%" })), "base64"),
    ] {
        let refused = post(&router, "/api/v1/fits", &request.to_string()).await;
        is_problem(&refused, 422, "invalid-value");
        assert!(refused.detail().contains(word), "{}", refused.detail());
    }
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_fit_accepts_the_options_of_the_command_and_returns_its_request() {
    let (bench, router) = opened().await;
    imported(&router).await;
    let request = json!({
        "scan_id": 1,
        "variant": "sawtooth",
        "loss": "huber",
        "fix": { "tilt_offset_deg": 0.0 },
        "priors": { "theta_r_deg": { "value": 10.2, "std": 1e-4 } },
        "starts": 2,
    });
    let begun = post(&router, "/api/v1/fits", &request.to_string()).await;
    let fit = ended(&router, &begun).await;
    assert_eq!(fit["state"], "completed", "{fit}");
    for (name, value) in request.as_object().unwrap() {
        assert_eq!(&fit["request"][name], value, "{name}");
    }
    let parameter = |name: &str| fit["parameters"][name].clone();
    assert_eq!(parameter("tilt_offset_deg")["value"], 0.0);
    // The ridges lean by 10°; so certain a prior has its way.
    let theta_r_deg = parameter("theta_r_deg")["value"].as_f64().unwrap();
    assert!((theta_r_deg - 10.2).abs() < 0.01, "{theta_r_deg}");

    let location = begun.location.clone().unwrap();
    let again = post(&router, &format!("{location}/cancel"), "").await;
    is_problem(&again, 409, "state-conflict");
    for (name, value, field, word) in [
        ("starts", json!(0), "starts", "1 to 1024"),
        ("starts", json!(-1), "starts", "whole number"),
        ("bootstrap", json!(19), "bootstrap", "20 to 100000"),
        ("loss", json!("hard"), "loss", "tukey"),
        ("fix", json!({ "theta": 1 }), "fix.theta", "theta_r_deg"),
        ("fix", json!({ "rho_d": 1.5 }), "fix.rho_d", "0 to 1"),
        ("fix", json!({ "rho_d": "a" }), "fix.rho_d", "a number"),
        ("fix", json!({ "k": 3 }), "fix", "dielectric"),
        ("fix", json!({ "theta_r_deg": 9 }), "fix", "once"),
        (
            "priors",
            json!({ "scale": { "value": 1 } }),
            "priors.scale.std",
            "missing",
        ),
        (
            "priors",
            json!({ "scale": { "value": 1, "std": 0 } }),
            "priors.scale",
            "greater than 0",
        ),
        ("target_error", json!(0.01), "target_error", "ray tracer"),
        ("region", json!("even"), "region", "has none"),
    ] {
        let mut wrong = request.clone();
        wrong[name] = value;
        let refused = post(&router, "/api/v1/fits", &wrong.to_string()).await;
        is_problem(&refused, 422, "invalid-value");
        assert_eq!(refused.body["errors"][0]["field"], field);
        assert!(refused.detail().contains(word), "{}", refused.detail());
    }
    let elsewhere = json!({ "scan_id": 1, "region": "even" }).to_string();
    let refused = post(&router, "/api/v1/contrasts", &elsewhere).await;
    is_problem(&refused, 422, "invalid-value");
    bench.end().await;
}
