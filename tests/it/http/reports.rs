//! The report on a scan: as JSON it says what the routes say, and the page to print says what the JSON says.

use std::collections::BTreeSet;
use std::sync::Arc;

use serde_json::{Value, json};
use sha2::{Digest, Sha256};

use ridged::lab::ScanRequest;
use ridged::report::{Check, check};
use ridged::store::disk::RealDisk;

use super::{download, ended, get, is_problem, post, router_of};
use crate::bench_in_a_box::{BenchInABox, small};
use crate::commands::{refuses, ridged};

const EVIL: &str = "<script>alert('x')</script> & \"B\"";

/// Asserts that each field of a route is in a part of the report, with the same value, except for these.
fn contains(part: &Value, route: &Value, except: &[&str]) {
    for (key, value) in route.as_object().unwrap() {
        if !except.contains(&key.as_str()) {
            assert_eq!(&part[key], value, "{key}");
        }
    }
}

/// All numbers in a document, as their texts.
fn numbers(value: &Value, found: &mut BTreeSet<String>) {
    match value {
        Value::Number(number) => {
            let number = number.as_f64().unwrap();
            found.insert(serde_json::to_string(&number).unwrap());
        }
        Value::Array(items) => items.iter().for_each(|item| numbers(item, found)),
        Value::Object(fields) => fields.values().for_each(|field| numbers(field, found)),
        _ => {}
    }
}

/// Asserts that the page shows only numbers of the JSON, rounded to the digits that it shows.
pub(super) fn shows_only(html: &str, report: &Value) {
    let mut known = BTreeSet::new();
    numbers(report, &mut known);
    let elements: Vec<&str> = html.split("<data value=\"").skip(1).collect();
    assert!(elements.len() > 100, "{}", elements.len());
    for element in elements {
        let (full, rest) = element.split_once("\">").unwrap();
        let (shown, _) = rest.split_once("</data>").unwrap();
        assert!(known.contains(full), "{full}, shown as {shown}");
        let full: f64 = full.parse().unwrap();
        let percent = shown.ends_with(" %");
        let plain = shown.trim_end_matches(" %").replace('\u{2212}', "-");
        if plain.starts_with('&') {
            continue;
        }
        let scaled = if percent { 100.0 * full } else { full };
        let read: f64 = plain.parse().unwrap_or_else(|_| panic!("{shown}"));
        let mantissa = plain.split('e').next().unwrap();
        let decimals = mantissa.split_once('.').map_or(0, |(_, d)| d.len() as i32);
        let power: i32 = plain.split_once('e').map_or(0, |(_, p)| p.parse().unwrap());
        let last = 10f64.powi(power - decimals);
        assert!(
            (read - scaled).abs() <= 0.5001 * last,
            "{full} shown as {shown}"
        );
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_report_says_what_the_routes_say_and_the_page_what_the_json_says() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    let bench = BenchInABox::open(&data, Arc::new(RealDisk), true).await;
    let router = router_of(&bench.lab);
    let sample = json!({
        "name": EVIL,
        "note": "</dd><img src=x onerror=alert(1)>",
        "material": { "kind": "dielectric", "eta": 1.54, "eta_std": 0.005 },
        "simulated": { "surface": "model", "theta_r_deg": 10.0, "alpha_u": 0.12, "alpha_v": 0.12, "rho_d": 0.3 },
    });
    let added = post(&router, "/api/v1/samples", &sample.to_string()).await;
    assert_eq!(added.status, 201, "{}", added.body);
    let sample_id = added.body["id"].as_i64().unwrap();
    let plan = small(&[-10.0, 0.0, 10.0], &[0.0, 60.0, 180.0, 300.0]);
    let request = ScanRequest {
        lot: Some("12 & 13".to_owned()),
        external_id: Some("PO-4711".to_owned()),
        operator_name: Some("Kim <night shift>".to_owned()),
        ..ScanRequest::of(sample_id, plan)
    };
    let scan = bench.lab.start_scan(&request).await;
    let id = scan.unwrap().id;
    bench.finish(id).await;
    let path = format!("/api/v1/scans/{id}/report");

    // Without a fit there is nothing to report, and the problem says what to do.
    let none = get(&router, &path).await;
    is_problem(&none, 409, "no-fit");
    assert!(none.detail().contains("/api/v1/fits"), "{}", none.detail());
    is_problem(
        &get(&router, "/api/v1/scans/77/report").await,
        404,
        "not-found",
    );
    refuses(
        folder.path(),
        &["report", &id.to_string(), "--data", "data"],
        1,
        &["no completed fit"],
    );

    let request = json!({ "scan_id": id, "variant": "sawtooth" });
    let fit = post(&router, "/api/v1/fits", &request.to_string()).await;
    let fit = ended(&router, &fit).await;
    let limits =
        json!({ "theta_r_deg": { "lower": 8.0, "upper": 12.0 }, "alpha_u": { "upper": 0.5 } });
    let specification = json!({ "name": "<b>lid</b>", "limits": limits });
    let request = json!({ "scan_id": id, "variant": "sawtooth", "specification": specification });
    let verdict = post(&router, "/api/v1/verdicts", &request.to_string()).await;
    let verdict = ended(&router, &verdict).await;
    assert_eq!(verdict["state"], "completed", "{verdict}");

    let json_path = format!("{path}?format=json");
    let report = get(&router, &json_path).await.body;
    assert!(matches!(check(&report), Check::Unchanged { .. }));
    // The same measurement, the same report.
    assert_eq!(get(&router, &json_path).await.body, report);

    let timed = [
        "state",
        "scan_id",
        "sample_id",
        "sample_name",
        "seconds",
        "forecast",
    ];
    contains(&report["fit"], &fit, &timed);
    contains(&report["verdict"], &verdict, &timed);
    let scan = get(&router, &format!("/api/v1/scans/{id}")).await.body;
    // Tags, note and archive may change after the report, which stays the same.
    let elsewhere = [
        "tags",
        "note",
        "archived",
        "sample_id",
        "sample_name",
        "plan",
        "progress",
        "operator",
        "camera",
        "calibration_ids",
        "regions",
        "target_expanded_deg",
    ];
    contains(&report["scan"], &scan, &elsewhere);
    assert_eq!(report["plan"], scan["plan"]);
    let sample = get(&router, &format!("/api/v1/samples/{sample_id}"))
        .await
        .body;
    for key in ["name", "note", "material"] {
        assert_eq!(report["part"][key], sample[key], "{key}");
    }
    let observations = get(&router, &format!("/api/v1/scans/{id}/observations"))
        .await
        .body;
    assert_eq!(report["observations"], observations["items"]);
    assert_eq!(report["absolute"], observations["absolute"]);
    let incidents = get(&router, &format!("/api/v1/scans/{id}/incidents"))
        .await
        .body;
    assert_eq!(report["incidents"], incidents["items"]);
    let used = report["calibrations"].as_array().unwrap();
    assert_eq!(
        used.len(),
        scan["calibration_ids"].as_array().unwrap().len()
    );
    for calibration in used {
        let path = format!("/api/v1/calibrations/{}", calibration["id"]);
        let route = get(&router, &path).await.body;
        contains(calibration, &route, &["valid", "valid_until"]);
    }
    let rig = get(&router, "/api/v1/rig").await.body;
    assert_eq!(report["rig"]["simulated"], true, "{rig}");
    assert_eq!(report["rig"]["stages"].as_array().unwrap().len(), 2);

    // The hash of the frames is that of `sha256sum`.
    let frames = get(&router, &format!("/api/v1/scans/{id}/frames?limit=1000"))
        .await
        .body;
    let mut lines: Vec<String> = frames["items"]
        .as_array()
        .unwrap()
        .iter()
        .filter(|frame| frame["accepted"] == true)
        .map(|frame| {
            let text = |key: &str| frame[key].as_str().unwrap().to_owned();
            format!("{}\t{}", text("file"), text("sha256"))
        })
        .collect();
    lines.sort();
    let mut all = Sha256::new();
    for line in &lines {
        let (name, hash) = line.split_once('\t').unwrap();
        all.update(format!("{hash}  {name}\n"));
    }
    let all: String = all.finalize().iter().map(|b| format!("{b:02x}")).collect();
    assert_eq!(report["frames"]["sha256"], all);
    assert_eq!(report["frames"]["count"], lines.len());

    let html = String::from_utf8(download(&router, &path).await).unwrap();
    shows_only(&html, &report);
    let angle = &report["fit"]["parameters"]["theta_r_deg"];
    for key in ["value", "expanded", "std", "coverage_factor"] {
        assert!(
            html.contains(&format!("<data value=\"{}\">", angle[key])),
            "{key}"
        );
    }
    for words in [
        "PASS",
        "Simulated rig",
        "JCGM 106",
        report["verdict"]["decision_rule"].as_str().unwrap(),
        report["sha256"].as_str().unwrap(),
        report["frames"]["sha256"].as_str().unwrap(),
        report["program"].as_str().unwrap(),
        "&lt;b&gt;lid&lt;/b&gt;",
        "12 &amp; 13",
        "PO-4711",
        "Kim &lt;night shift&gt;",
        "&lt;script&gt;alert(&#39;x&#39;)&lt;/script&gt; &amp; &quot;B&quot;",
    ] {
        assert!(html.contains(words), "{words}");
    }
    // Nothing runs and nothing is loaded.
    for tag in [
        "<script",
        "<img",
        "<link",
        "<iframe",
        "onerror=alert(1)>",
        " src=\"",
        " href=\"",
    ] {
        assert!(!html.contains(tag), "{tag}");
    }
    let other = format!("{path}?fit_id=99");
    is_problem(&get(&router, &other).await, 404, "not-found");
    let form = format!("{path}?format=pdf");
    is_problem(&get(&router, &form).await, 422, "invalid-value");

    // The command writes the same, beside the daemon.
    let at = folder.path();
    let written = ridged(
        at,
        &["report", &id.to_string(), "--data", "data", "-o", "a.html"],
    );
    assert!(written.status.success(), "{written:?}");
    let read = |name: &str| std::fs::read_to_string(at.join(name)).unwrap();
    let written: Value = serde_json::from_str(&read("a.json")).unwrap();
    assert_eq!(written, report);
    let hash = report["sha256"].as_str().unwrap();
    assert!(read("a.html").contains(hash));
    assert!(
        ridged(at, &["report", "--check", "a.json"])
            .status
            .success()
    );
    std::fs::write(at.join("b.json"), read("a.json").replace("1.54", "1.55")).unwrap();
    refuses(at, &["report", "--check", "b.json"], 1, &["was changed"]);

    // A folder of frames is fitted and reported, with the same frames.
    let exported = ridged(
        at,
        &[
            "export",
            "--scan",
            &id.to_string(),
            "--data",
            "data",
            "--out",
            "series",
        ],
    );
    assert!(exported.status.success(), "{exported:?}");
    let reported = ridged(at, &["report", "series", "--variant", "sawtooth"]);
    assert!(reported.status.success(), "{reported:?}");
    let of_folder: Value = serde_json::from_str(&read("report.json")).unwrap();
    assert_eq!(of_folder["frames"], report["frames"]);
    let angle_of = |report: &Value| {
        let angle = &report["fit"]["parameters"]["theta_r_deg"];
        angle["value"].as_f64().unwrap()
    };
    assert!((angle_of(&of_folder) - angle_of(&report)).abs() < 1e-6);
    shows_only(&read("report.html"), &of_folder);
    bench.end().await;
}
