//! `/charts` and `/due`, and the command that states the same.

use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use serde_json::{Value, json};

use ridged::config::DueSection;
use ridged::job::{JobId, JobKind};
use ridged::store::disk::RealDisk;
use ridged::store::jobs::{FitSummary, JobEnd, NewJob};

use super::recipes::added;
use super::{ended, get, imported, is_problem, patch, post, router_of};
use crate::bench_in_a_box::{BenchInABox, small};
use crate::commands::{refuses, ridged};

/// Ends a job of a scan with this result.
async fn ended_with(
    bench: &BenchInABox,
    scan_id: i64,
    kind: JobKind,
    [request, result]: [&Value; 2],
    fit: Option<FitSummary>,
) {
    let new = NewJob {
        kind,
        scan_id: Some(scan_id),
        variant: (kind == JobKind::Fit).then(|| "auto".into()),
        request: request.to_string(),
        options: None,
        who: "local".into(),
    };
    let store = bench.lab.store();
    let (id, _) = store.start_job(&new).await.unwrap();
    let result = result.to_string();
    let end = JobEnd::Completed { result, fit };
    store.end_job(id, &end).await.unwrap();
}

/// Fits a scan: the first fit, whose observations the made ones share.
async fn really_fitted(router: &Router, scan_id: i64) {
    let request = json!({ "scan_id": scan_id, "variant": "paper" }).to_string();
    let begun = post(router, "/api/v1/fits", &request).await;
    let fit = ended(router, &begun).await;
    assert_eq!(fit["state"], "completed", "{fit}");
}

/// Ends a fit of a scan with this angle.
async fn fitted(bench: &BenchInABox, scan_id: i64, theta_r_deg: f64, status: &str) {
    let angle =
        json!({ "value": theta_r_deg, "std": 0.02, "expanded": 0.05, "coverage_factor": 2.5 });
    let alpha = json!({ "value": 0.12, "std": 0.001, "expanded": 0.003, "coverage_factor": 3.0 });
    let report = json!({ "variant": "sawtooth", "status": status, "parameters": { "theta_r_deg": angle, "alpha_u": alpha } });
    let request = json!({ "scan_id": scan_id });
    let first = bench.lab.store().job(JobId::new(JobKind::Fit, 1)).await;
    let summary = FitSummary {
        set_id: first.unwrap().set_id.unwrap(),
        variant: "sawtooth".into(),
        status: status.into(),
        theta_r_deg: None,
    };
    let job = [&request, &report];
    ended_with(bench, scan_id, JobKind::Fit, job, Some(summary)).await;
}

/// Ends a verdict on a scan by a specification with guard bands of 0.03°.
async fn judged(bench: &BenchInABox, scan_id: i64, specification: &Value) {
    let item = json!({
        "quantity": "theta_r_deg", "value": 11.0, "std": 0.015, "expanded": 0.03, "coverage_factor": 2.0, "lower": 9.5, "upper": 11.2,
        "guard_band": 0.03, "acceptance_lower": 9.53, "acceptance_upper": 11.17, "conformance_probability": 1.0, "verdict": "pass",
        "reason": "risk of nonconformity < 0.01 % (allowed 2.5 %)"
    });
    let result =
        json!({ "verdict": "pass", "specification": specification["name"], "items": [item] });
    let request = json!({ "scan_id": scan_id, "specification": specification });
    let job = [&request, &result];
    ended_with(bench, scan_id, JobKind::Verdict, job, None).await;
}

fn close(value: &Value, expected: f64) {
    let value = value.as_f64().unwrap_or_else(|| panic!("{value}"));
    assert!(
        (value - expected).abs() <= 1e-9,
        "{value} is not {expected}"
    );
}

const SETTINGS: &str = "[due]\ncheck_standard = \"polymer-10\"\ncheck_standard_every_days = 3650\nreferences_every_days = 1.0\n";

fn settings() -> DueSection {
    DueSection {
        check_standard: Some("polymer-10".into()),
        check_standard_every_days: Some(3650.0),
        references_every_days: Some(1.0),
    }
}

/// Eight values below the mean, and one beyond the upper limit.
const VALUES: [f64; 9] = [10.0, 10.01, 10.0, 10.01, 10.0, 10.01, 10.0, 10.01, 11.0];

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_chart_has_limits_signals_and_the_specification_and_the_command_states_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    let bench = BenchInABox::open(&data, Arc::new(RealDisk), false).await;
    bench.lab.set_due(settings());
    let router = router_of(&bench.lab);
    for _ in 0..11 {
        imported(&router).await;
    }
    really_fitted(&router, 1).await;
    for (scan_id, value) in (1..).zip(VALUES) {
        fitted(&bench, scan_id, value, "converged").await;
    }
    fitted(&bench, 10, 12.0, "at-bound").await;
    let limits =
        json!({ "theta_r_deg": { "lower": 9.5, "upper": 11.2 }, "rho_d": { "upper": 0.4 } });
    let specification = json!({ "name": "drawing 4711", "limits": limits });
    added(&router, "specifications", &specification).await;
    judged(&bench, 9, &specification).await;
    std::fs::write(folder.path().join("rig.toml"), SETTINGS).unwrap();

    let run = |words: &[&str]| {
        let shared = ["--data", "data", "--config", "rig.toml", "--json"];
        let output = ridged(folder.path(), &[&["chart"], words, &shared].concat());
        let errors = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{words:?}: {errors}");
        serde_json::from_slice::<Value>(&output.stdout).unwrap()
    };
    // The same figures from both.
    let chart = async |query: &str, words: &[&str]| {
        let answer = get(&router, &format!("/api/v1/charts?{query}")).await;
        assert_eq!(answer.status, 200, "{query}: {}", answer.body);
        assert_eq!(run(words), answer.body, "{query}");
        answer.body
    };

    let all = chart("", &[]).await;
    assert_eq!((&all["count"], &all["omitted"]), (&json!(11), &json!(2)));
    let found = &all["limits"];
    assert_eq!(found["n"], json!(9));
    let mean = VALUES.iter().sum::<f64>() / 9.0;
    let range = (7.0 * 0.01 + 0.99) / 8.0;
    close(&found["mean"], mean);
    close(&found["mean_range"], range);
    close(&found["s"], range / 1.128);
    close(&found["lower"], mean - 3.0 * range / 1.128);
    close(&found["upper"], mean + 3.0 * range / 1.128);
    close(&found["range_limit"], 3.267 * range);
    assert_eq!(
        all["runs"],
        json!([{ "first": 0, "last": 7, "is_above": false }])
    );
    let points = all["points"].as_array().unwrap();
    let scans: Vec<i64> = points
        .iter()
        .filter_map(|p| p["scan_id"].as_i64())
        .collect();
    assert_eq!(scans, (1..=9).collect::<Vec<_>>());
    let last = &points[8];
    assert_eq!(
        (&last["beyond"], &last["in_run"]),
        (&json!(true), &json!(false))
    );
    assert_eq!(
        (&points[7]["beyond"], &points[7]["in_run"]),
        (&json!(false), &json!(true))
    );
    assert_eq!(
        (&last["verdict"], &last["part"]),
        (&json!("pass"), &json!("polymer-10"))
    );
    close(&last["moving_range"], 0.99);
    assert_eq!(points[0]["moving_range"], Value::Null);
    assert_eq!(
        (&last["coverage_factor"], &last["expanded"]),
        (&json!(2.5), &json!(0.05))
    );
    // The only specification of the verdicts, with the guard band of its newest one.
    let beside = &all["specification"];
    assert_eq!(beside["name"], "drawing 4711");
    assert_eq!(
        (&beside["lower"], &beside["upper"]),
        (&json!(9.5), &json!(11.2))
    );
    assert_eq!(
        (&beside["guard_basis"], &beside["verdict_id"]),
        (&json!("verdict"), &json!(1))
    );
    assert_eq!(beside["acceptance_lower"], json!(9.53));
    assert_eq!(beside["limited"], json!(["rho_d", "theta_r_deg"]));
    let due = &all["due"];
    assert_eq!(
        (&due[0]["what"], &due[0]["is_due"]),
        (&json!("check-standard"), &json!(false))
    );
    assert_eq!(
        (&due[1]["last_at"], &due[1]["is_due"]),
        (&Value::Null, &json!(true))
    );

    // Another parameter: U is 2 u, and the specification has no limits of it.
    let alpha = chart("parameter=alpha_u", &["--parameter", "alpha_u"]).await;
    assert_eq!(alpha["points"][0]["expanded"], json!(0.002));
    assert_eq!(
        (&alpha["limits"]["s"], &alpha["runs"]),
        (&json!(0.0), &json!([]))
    );
    let beside = &alpha["specification"];
    assert_eq!(
        (&beside["upper"], &beside["guard_band"]),
        (&Value::Null, &Value::Null)
    );

    // Filters; the verdict is not among these rows.
    let three = chart("scan_id_max=3", &["--filter", "scan_id_max=3"]).await;
    assert_eq!(
        (&three["count"], &three["limits"]["n"]),
        (&json!(3), &json!(3))
    );
    assert_eq!(three["specification"], Value::Null);
    let words = ["--filter", "scan_id_max=3", "--limits-of", "drawing 4711"];
    let stated = chart("scan_id_max=3&limits_of=drawing%204711", &words).await;
    let beside = &stated["specification"];
    assert_eq!(beside["guard_basis"], "median-uncertainty");
    assert_eq!(beside["verdict_id"], Value::Null);
    let guard = beside["guard_band"].as_f64().unwrap();
    assert!((guard / 0.02 - 1.959_964).abs() < 1e-5, "{guard}");
    let words = ["--specification", "drawing 4711"];
    let filtered = chart("specification=drawing+4711", &words).await;
    assert_eq!(filtered["count"], json!(1));
    assert_eq!(filtered["limits"], Value::Null);
    assert_eq!(filtered["specification"]["name"], "drawing 4711");
    let none = chart("limits_of=", &["--limits-of", ""]).await;
    assert_eq!(none["specification"], Value::Null);
    let empty = chart("lot=7", &["--lot", "7"]).await;
    assert_eq!((&empty["points"], &empty["count"]), (&json!([]), &json!(0)));

    // An archived scan does not count.
    let archived = patch(&router, "/api/v1/scans/9", r#"{"archived": true}"#).await;
    assert_eq!(archived.status, 200, "{}", archived.body);
    let without = chart("", &[]).await;
    assert_eq!(without["limits"]["n"], json!(8));

    // The text states signals, what is due, and the answer last.
    let words = [
        "chart",
        "--archived",
        "all",
        "--data",
        "data",
        "--config",
        "rig.toml",
    ];
    let output = ridged(folder.path(), &words);
    let text = String::from_utf8(output.stdout).unwrap();
    for part in [
        "Scans 1 to 8: 8 values in a row below the mean.",
        "Scan 9: 11.00",
        "Limits of drawing 4711: 9.5° to 11.2°",
        "Check standard polymer-10: last measured ",
        "References: never taken, due now",
    ] {
        assert!(text.contains(part), "{part}: {text}");
    }
    assert!(
        text.trim_end()
            .lines()
            .last()
            .unwrap()
            .contains("2 signals"),
        "{text}"
    );
    refuses(
        folder.path(),
        &["chart", "--data", "data", "--parameter", "theta"],
        2,
        &["expected one of theta_r_deg"],
    );
    refuses(
        folder.path(),
        &["chart", "--data", "data", "--limits-of", "drawing 12"],
        2,
        &[
            "there is no specification `drawing 12`",
            "ridged specification list",
        ],
    );
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_chart_that_is_not_valid_is_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let bench = BenchInABox::open(folder.path(), Arc::new(RealDisk), false).await;
    let router = router_of(&bench.lab);
    for (query, field, part) in [
        (
            "parameter=theta",
            "parameter",
            "expected one of theta_r_deg",
        ),
        (
            "parameter=alpha_u&parameter=alpha_v",
            "parameter",
            "given twice",
        ),
        (
            "limits_of=drawing",
            "limits_of",
            "there is no specification `drawing`",
        ),
        ("verdict=fial", "verdict", "expected pass, fail"),
    ] {
        let refused = get(&router, &format!("/api/v1/charts?{query}")).await;
        is_problem(&refused, 422, "invalid-value");
        assert_eq!(refused.body["errors"][0]["field"], field, "{query}");
        assert!(refused.detail().contains(part), "{query}: {}", refused.body);
    }
    for (query, part) in [
        ("sort=theta_r_deg", "expected filters only"),
        ("limit=10", "expected filters only"),
        ("verdicts=fail", "did you mean `verdict`?"),
    ] {
        let refused = get(&router, &format!("/api/v1/charts?{query}")).await;
        is_problem(&refused, 400, "bad-request");
        assert!(refused.detail().contains(part), "{query}: {}", refused.body);
    }
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn check_standard_and_references_are_due_when_their_interval_is_over() {
    let bench = BenchInABox::new().await;
    let router = router_of(&bench.lab);
    let due = async || {
        let answer = get(&router, "/api/v1/due").await;
        assert_eq!(answer.status, 200, "{}", answer.body);
        answer.body["items"].clone()
    };
    assert_eq!(due().await, json!([]));
    bench.lab.set_due(DueSection {
        check_standard_every_days: Some(7.0),
        ..settings()
    });
    let never = due().await;
    let what = [&never[0]["what"], &never[1]["what"]];
    assert_eq!(what, [&json!("check-standard"), &json!("references")]);
    for item in [&never[0], &never[1]] {
        assert_eq!(
            (&item["last_at"], &item["due_at"]),
            (&Value::Null, &Value::Null)
        );
        assert_eq!(item["is_due"], json!(true));
    }
    assert_eq!(
        (&never[0]["part"], &never[1]["part"]),
        (&json!("polymer-10"), &Value::Null)
    );

    // A scan of the rig takes references; the check standard counts once a fit of it has converged.
    let scan = bench.start(small(&[0.0], &[0.0])).await;
    bench.finish(scan.id).await;
    imported(&router).await;
    really_fitted(&router, 2).await;
    fitted(&bench, 2, 10.0, "at-bound").await;
    let half = due().await;
    assert_eq!(
        (&half[0]["is_due"], &half[1]["is_due"]),
        (&json!(true), &json!(false))
    );
    fitted(&bench, 2, 10.0, "converged").await;
    let measured = due().await;
    assert_eq!(measured[0]["is_due"], json!(false));
    assert_eq!(get(&router, "/api/v1/charts").await.body["due"], measured);

    let day = Duration::from_secs(86_400);
    bench.lab.clock().sleep(2 * day).await;
    let later = due().await;
    assert_eq!(
        (&later[0]["is_due"], &later[1]["is_due"]),
        (&json!(false), &json!(true))
    );
    bench.lab.clock().sleep(5 * day).await;
    assert_eq!(due().await[0]["is_due"], json!(true));
    // An archived scan does not count.
    let archived = patch(&router, "/api/v1/scans/2", r#"{"archived": true}"#).await;
    assert_eq!(archived.status, 200, "{}", archived.body);
    assert_eq!(due().await[0]["last_at"], Value::Null);
    bench.end().await;
}
