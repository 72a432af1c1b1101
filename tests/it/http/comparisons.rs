//! `/comparisons` and `/repeatability`, and the commands that state the same.

use std::sync::Arc;
use std::time::Duration;

use serde_json::{Value, json};

use ridged::job::{JobId, JobKind};
use ridged::store::disk::RealDisk;
use ridged::store::jobs::{FitSummary, JobEnd, NewJob};

use super::recipes::{added, recipe};
use super::reports::shows_only;
use super::{download, ended, get, imported, is_problem, patch, post, router_of};
use crate::bench_in_a_box::BenchInABox;
use crate::commands::ridged;

/// Fits scan 1 and gives each later scan the same report, moved by an angle.
async fn fitted(bench: &BenchInABox, router: &axum::Router, moved_deg: &[f64]) -> Value {
    let request = json!({ "scan_id": 1, "variant": "paper" }).to_string();
    let begun = post(router, "/api/v1/fits", &request).await;
    let fit = ended(router, &begun).await;
    assert_eq!(fit["state"], "completed", "{fit}");
    let store = bench.lab.store();
    let job = store.job(JobId::new(JobKind::Fit, 1)).await.unwrap();
    for (index, moved) in moved_deg.iter().enumerate() {
        let new = NewJob {
            kind: JobKind::Fit,
            scan_id: Some(index as i64 + 2),
            variant: Some("paper".into()),
            request: job.request.clone(),
            options: None,
            who: "local".into(),
        };
        let mut report: Value = serde_json::from_str(job.result.as_ref().unwrap()).unwrap();
        let angle = &mut report["parameters"]["theta_r_deg"]["value"];
        *angle = json!(angle.as_f64().unwrap() + moved);
        let (id, _) = store.start_job(&new).await.unwrap();
        let summary = FitSummary {
            set_id: job.set_id.unwrap(),
            variant: "paper".into(),
            status: "converged".into(),
            theta_r_deg: None,
        };
        let end = JobEnd::Completed {
            result: report.to_string(),
            fit: Some(summary),
        };
        store.end_job(id, &end).await.unwrap();
    }
    fit
}

fn close(value: &Value, expected: f64) {
    let value = value.as_f64().unwrap_or_else(|| panic!("{value}"));
    assert!(
        (value - expected).abs() <= 1e-9 * expected.abs().max(1.0),
        "{value} is not {expected}"
    );
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn scans_are_compared_and_their_scatter_is_put_beside_the_stated_uncertainty() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    let bench = BenchInABox::open(&data, Arc::new(RealDisk), false).await;
    let router = router_of(&bench.lab);
    for _ in 0..4 {
        imported(&router).await;
    }
    let none = get(&router, "/api/v1/comparisons?scan_id=1&scan_id=2").await;
    is_problem(&none, 409, "no-fit");
    let fit = fitted(&bench, &router, &[0.05, -0.05]).await;
    let angle = &fit["parameters"]["theta_r_deg"];
    let std = angle["std"].as_f64().unwrap();

    // By the records, two imports of one series share its white-reference frames, its material and the model error.
    let path = "/api/v1/comparisons?scan_id=1&scan_id=2";
    let compared = get(&router, path).await;
    assert_eq!(compared.status, 200, "{}", compared.body);
    let body = &compared.body;
    let shared: Vec<&str> = body["shared_lines"]
        .as_array()
        .unwrap()
        .iter()
        .filter(|line| line["shared"] == json!(true))
        .filter_map(|line| line["line"].as_str())
        .collect();
    assert_eq!(shared, ["reference", "material", "model"], "{body}");
    let row = &body["parameters"][0];
    assert_eq!(row["name"], "theta_r_deg");
    assert_eq!(row["first"]["value"], angle["value"]);
    let budget = angle["budget"].as_object().unwrap();
    let rest: f64 = budget
        .iter()
        .filter(|(line, _)| !["reference", "material", "model"].contains(&line.as_str()))
        .map(|(_, part)| 2.0 * part.as_f64().unwrap().powi(2))
        .sum();
    close(&row["difference"]["value"], 0.05);
    close(&row["difference"]["std"], rest.sqrt());
    let k = row["difference"]["coverage_factor"].as_f64().unwrap();
    assert!((2.0..4.0).contains(&k), "{k}");
    close(&row["difference"]["expanded"], k * rest.sqrt());
    close(&row["difference"]["normalised"], 0.05 / (k * rest.sqrt()));
    let apart = get(&router, &format!("{path}&shared=none")).await.body;
    let apart = &apart["parameters"][0]["difference"];
    close(&apart["std"], std * 2f64.sqrt());

    let path = "/api/v1/repeatability?scan_id=1&scan_id=2&scan_id=3&scan_id=4";
    let study = get(&router, &format!("{path}&shared=none")).await;
    assert_eq!(study.status, 200, "{}", study.body);
    let scatter = &study.body["scatter"];
    close(&scatter["mean"], angle["value"].as_f64().unwrap());
    close(&scatter["std"], 0.05);
    close(&scatter["stated_std"], std);
    close(&scatter["chi_square"], 2.0 * (0.05 / std).powi(2));
    assert_eq!(scatter["degrees_of_freedom"], json!(2));
    assert_eq!(study.body["results"].as_array().unwrap().len(), 3);
    let left_out = &study.body["left_out"][0];
    assert_eq!(left_out["scan_id"], json!(4));
    assert!(
        left_out["why"].as_str().unwrap().contains("fit"),
        "{left_out}"
    );
    // One part, one day, no operators: the answer says what to measure.
    assert_eq!(study.body["gauge"], Value::Null);
    let note = study.body["gauge_note"].as_str().unwrap();
    assert!(note.contains("several"), "{note}");

    // The commands state the same.
    let run = |words: &[&str]| {
        let words = [words, &["--data", "data", "--json"]].concat();
        let output = ridged(folder.path(), &words);
        let errors = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{words:?}: {errors}");
        serde_json::from_slice::<Value>(&output.stdout).unwrap()
    };
    assert_eq!(run(&["compare", "1", "2"]), compared.body);
    let words = ["repeatability", "1", "2", "3", "4", "--shared", "none"];
    assert_eq!(run(&words), study.body);
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_study_that_is_not_valid_is_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let bench = BenchInABox::open(folder.path(), Arc::new(RealDisk), false).await;
    let router = router_of(&bench.lab);
    for (path, field, part) in [
        ("comparisons?scan_id=1", "scan_id", "expected two scans"),
        ("comparisons?scan_id=1&scan_id=1", "scan_id", "given twice"),
        (
            "comparisons?scan_id=a&scan_id=1",
            "scan_id",
            "whole numbers",
        ),
        (
            "comparisons?scan_id=1&scan_id=2&shared=refernce",
            "shared",
            "did you mean `reference`?",
        ),
        ("repeatability?scan_id=1", "scan_id", "expected 2 to 200"),
        (
            "repeatability?scan_id=1&scan_id=2&parameter=theta",
            "parameter",
            "expected one of theta_r_deg",
        ),
        (
            "repeatability?scan_id=1&scan_id=2&by=week",
            "by",
            "operator",
        ),
    ] {
        let refused = get(&router, &format!("/api/v1/{path}")).await;
        is_problem(&refused, 422, "invalid-value");
        assert_eq!(refused.body["errors"][0]["field"], field, "{path}");
        assert!(refused.detail().contains(part), "{path}: {}", refused.body);
    }
    let unknown = get(&router, "/api/v1/comparisons?scan_id=1&scan_id=2").await;
    is_problem(&unknown, 404, "not-found");
    let word = get(
        &router,
        "/api/v1/repeatability?scan_id=1&scan_id=2&share=none",
    )
    .await;
    is_problem(&word, 400, "bad-request");
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_report_has_the_scatter_of_three_scans_of_a_part_by_one_recipe() {
    let folder = tempfile::tempdir().unwrap();
    let bench = BenchInABox::open(folder.path(), Arc::new(RealDisk), true).await;
    let router = router_of(&bench.lab);
    added(&router, "recipes", &recipe("PX-1")).await;
    for scan_id in 1..=3 {
        let body = json!({ "sample_id": 2, "recipe": "PX-1", "operator_name": "Anna" });
        let begun = post(&router, "/api/v1/scans", &body.to_string()).await;
        assert_eq!(begun.status, 202, "{}", begun.body);
        bench.finish(scan_id).await;
        // The recipe has the scan fitted by itself; another fit would become the newest one at some time.
        let path = format!("/api/v1/fits?scan_id={scan_id}");
        let fit = async || get(&router, &path).await.body["items"][0].clone();
        while fit().await["state"] != "completed" {
            assert_ne!(fit().await["state"], "failed", "{}", fit().await);
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    }
    let report = async |scan_id: i64| {
        let path = format!("/api/v1/scans/{scan_id}/report");
        get(&router, &format!("{path}?format=json")).await.body
    };
    assert_eq!(report(2).await["repeatability"], Value::Null);
    let of_third = report(3).await;
    let path = "/api/v1/repeatability?scan_id=1&scan_id=2&scan_id=3";
    let study = get(&router, path).await.body;
    assert_eq!(of_third["repeatability"], study);
    let scatter = &study["scatter"];
    assert_eq!(scatter["n"], json!(3), "{study}");
    // The scans reuse the white reference of the first one, on the same rig.
    let shared = study["shared_lines"].as_array().unwrap().iter();
    let shared: Vec<&str> = shared
        .filter(|line| line["shared"] == json!(true))
        .filter_map(|line| line["line"].as_str())
        .collect();
    let all = ["reference", "angles", "material", "detector", "model"];
    assert_eq!(shared, all, "{study}");
    let html = download(&router, "/api/v1/scans/3/report").await;
    let html = String::from_utf8(html).unwrap();
    assert!(html.contains("<h2>Repeatability</h2>"), "{html}");
    shows_only(&html, &of_third);

    // An archived scan does not count.
    let archived = patch(&router, "/api/v1/scans/1", r#"{"archived": true}"#).await;
    assert_eq!(archived.status, 200, "{}", archived.body);
    assert_eq!(report(3).await["repeatability"], Value::Null);
    bench.end().await;
}
