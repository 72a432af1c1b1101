//! Traces of scenes: their numbers, their files, and what makes no sense by its key.

use axum::body::Body;
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use ridged::job::{JobId, JobKind};
use serde_json::{Value, json};
use tower::ServiceExt;

use super::{costs, download, ended, forecasts, get, is_problem, opened, post};

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_scene_is_traced_compared_and_looked_at() {
    let (bench, router) = opened().await;
    // Nothing has been scanned: a trace is of a scene.
    let scene = json!({
        "light": { "theta_i_deg": 56.31 },
        "interface": [{ "shape": "flat", "below": { "n": 1.5 } }],
        "run": { "photons": 2000 },
    });
    let request = json!({ "scene": scene });
    let begun = post(&router, "/api/v1/traces", &request.to_string()).await;
    let trace = ended(&router, &begun).await;
    assert_eq!(trace["state"], "completed", "{trace}");
    assert_eq!(trace["photons"], 2000);
    costs(&trace, "photons");
    assert_eq!(forecasts(&bench).await[0].0, "trace");
    let reflected = trace["energy"]["reflected"]["value"].as_f64().unwrap();
    assert!((reflected - 0.073_964_5).abs() < 1e-6, "{reflected}");
    assert_eq!(trace["comparison"], Value::Null);
    let several = json!({ "scene": scene, "surfaces": 3 }).to_string();
    let refused = post(&router, "/api/v1/traces", &several).await;
    is_problem(&refused, 422, "invalid-value");
    assert!(refused.detail().contains("is random"));
    let rough = json!({ "shape": "beckmann", "alpha_u": 0.4, "alpha_v": 0.4, "cells": 32, "below": { "n": 1.5 } });
    let several = json!({
        "scene": { "light": { "theta_i_deg": 45.0 }, "interface": [rough], "run": { "photons": 20_000 } },
        "surfaces": 4,
    });
    let begun = post(&router, "/api/v1/traces", &several.to_string()).await;
    let found = ended(&router, &begun).await;
    let all = &found["surfaces"];
    assert_eq!(all["count"], 4);
    let of = |key: &str| all["reflected"][key].as_f64().unwrap();
    assert!(of("std_between_surfaces") > of("std_by_sampling"), "{all}");
    assert!(of("std") > of("std_by_sampling"), "{all}");
    // With `compare` its files show the error without polarisation; limits are kept and reported.
    let layered = json!({
        "light": { "theta_i_deg": 65.0, "phi_i_deg": 180.0 },
        "interface": [
            { "shape": "flat", "below": { "n": 1.5 } },
            { "shape": "beckmann", "alpha_u": 0.2, "alpha_v": 0.2, "cells": 32, "below": { "n": 2.4 } },
        ],
        "run": { "photons": 9_000_000, "theta_bins": 9, "phi_bins": 12 },
    });
    let wanted =
        json!({ "scene": layered, "compare": true, "photons": 6000, "target_error": 1e-9 });
    let begun = post(&router, "/api/v1/traces", &wanted.to_string()).await;
    let trace = ended(&router, &begun).await;
    assert_eq!(trace["state"], "completed", "{trace}");
    assert_eq!(trace["photons"], 6000);
    let warning = trace["warnings"][0].as_str().unwrap();
    assert!(warning.contains("was not reached"), "{warning}");
    assert!(trace["comparison"]["adm"]["greatest"].as_f64().unwrap() > 0.0);
    assert_eq!(trace["bins"]["numbers"].as_array().unwrap().len(), 18);
    assert_eq!(trace["bins"]["sides"], json!(["reflected", "transmitted"]));
    let files = format!("{}/files", begun.location.clone().unwrap());
    let plane = get(&router, &format!("{files}/plane.json")).await.body;
    let point = &plane["lobe"][0];
    let value = |what: &str| point[what]["value"].as_f64().unwrap();
    let difference = value("polarised") - value("scalar");
    assert!((value("difference") - difference).abs() < 1e-9, "{point}");
    assert_eq!(plane["states"][0]["stokes"], json!([1.0, 0.0, 0.0, 0.0]));
    assert_eq!(plane["points"][0]["readings"].as_array().unwrap().len(), 7);
    for (name, bytes) in [
        ("bins.f32", 2 * 108 * 18 * 2 * 4),
        ("difference.f32", 108 * 4 * 4),
    ] {
        let file = download(&router, &format!("{files}/{name}")).await;
        assert_eq!(file.len(), bytes, "{name}");
    }
    is_problem(
        &get(&router, &format!("{files}/../../ridged.sqlite")).await,
        404,
        "not-found",
    );
    is_problem(
        &get(&router, &format!("{files}/none.csv")).await,
        422,
        "invalid-value",
    );
    let text = "[[interface]]\nshape = \"flat\"\nbelow = { n = 0 }\n";
    let mut scalar = layered.clone();
    scalar["run"]["polarised"] = json!(false);
    let mut fine = layered.clone();
    fine["run"]["phi_bins"] = json!(1440);
    fine["run"]["theta_bins"] = json!(1440);
    for (request, word) in [
        (json!({ "scene": text }), "below.n"),
        (
            json!({ "scene": text.replace("n = 0", "n = 1e78") }),
            "1e30",
        ),
        (
            json!({ "scene": format!("n_top = 1e-100\n{}", text.replace("n = 0", "n = 1.5")) }),
            "n_top",
        ),
        (json!({ "scene": scalar, "compare": true }), "polarised"),
        (json!({ "scene": fine }), "theta_bins"),
        (json!({ "scene": scene, "photons": 0 }), "run.photons"),
        (json!({ "scene": {} }), "interface"),
        (
            json!({ "scene": scene, "max_seconds": -1.0 }),
            "greater than 0",
        ),
    ] {
        let refused = post(&router, "/api/v1/traces", &request.to_string()).await;
        is_problem(&refused, 422, "invalid-value");
        assert!(refused.detail().contains(word), "{}", refused.detail());
    }
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_third_trace_waits_for_its_turn_and_is_cancelled_while_it_waits() {
    let (bench, router) = opened().await;
    let rough = json!({ "shape": "beckmann", "alpha_u": 0.4, "alpha_v": 0.4, "cells": 32, "below": { "n": 1.5 } });
    let endless = json!({
        "scene": { "light": { "theta_i_deg": 45.0 }, "interface": [rough], "run": { "photons": 4_000_000_000u64 } },
    });
    let mut begun = Vec::new();
    for _ in 0..3 {
        begun.push(post(&router, "/api/v1/traces", &endless.to_string()).await);
    }
    let location = |k: usize| begun[k].location.clone().unwrap();
    let waiting = loop {
        let trace = get(&router, &location(2)).await.body;
        match trace["progress"].is_object() {
            true => break trace["progress"].clone(),
            false => tokio::task::yield_now().await,
        }
    };
    assert_eq!(waiting["stage"], "waiting for its turn");
    assert_eq!(waiting["queued_position"], 1);
    for k in [2, 0, 1] {
        let cancel = format!("{}/cancel", location(k));
        assert_eq!(post(&router, &cancel, "").await.status, 202);
        assert_eq!(ended(&router, &begun[k]).await["state"], "cancelled");
    }
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_scene_brings_its_files() {
    let (bench, router) = opened().await;
    // Hills of one period on 8 × 8 samples.
    let row = |i: usize| {
        let height = |j: usize| {
            let turn = std::f64::consts::TAU / 8.0;
            0.2 * (turn * i as f64).sin() + 0.1 * (turn * j as f64).cos()
        };
        let numbers: Vec<String> = (0..8).map(|j| format!("{:.4}", height(j))).collect();
        numbers.join(",")
    };
    let table = (0..8).map(row).collect::<Vec<_>>().join("\n");
    let scene = json!({
        "interface": [{ "shape": "file", "path": "hills.csv", "pitch_um": 1.0, "height_unit_um": 1.0, "below": { "n": 1.5 } }],
        "run": { "photons": 4000, "theta_bins": 9, "phi_bins": 12 },
    });
    let content = STANDARD.encode(&table);
    let request = json!({ "scene": scene, "files": { "hills.csv": content } });
    let begun = post(&router, "/api/v1/traces", &request.to_string()).await;
    let trace = ended(&router, &begun).await;
    assert_eq!(trace["state"], "completed", "{trace}");
    // Near normal incidence hills of 10° reflect about as a plane does.
    let reflected = trace["energy"]["reflected"]["value"].as_f64().unwrap();
    assert!((0.03..0.06).contains(&reflected), "{reflected}");
    // The row keeps the identity of the file, the folder keeps the file.
    let kept = &trace["request"]["files"]["hills.csv"];
    assert_eq!(kept["bytes"], table.len());
    let file = format!("{}/files/given-hills.csv", begun.location.clone().unwrap());
    assert_eq!(download(&router, &file).await, table.as_bytes());
    // A client that keeps a file asks whether it still has the right one: another folder may have other files of this number.
    let ask = async |tag: &str| {
        let asked = super::request("GET", &file).header("if-none-match", tag);
        let asked = asked.body(Body::empty()).unwrap();
        router.clone().oneshot(asked).await.unwrap()
    };
    let first = ask("\"of another folder\"").await;
    assert_eq!(first.status(), 200);
    assert_eq!(first.headers()["cache-control"], "private, no-cache");
    let tag = first.headers()["etag"].to_str().unwrap();
    assert_eq!(ask(tag).await.status(), 304);
    let written = bench
        .lab
        .store()
        .files_folder(JobId::new(JobKind::Trace, 1));
    std::fs::write(written.join("given-hills.csv"), &table).unwrap();
    assert_eq!(ask(tag).await.status(), 200);
    for (files, word) in [
        (json!({}), "send it as"),
        (json!({ "hills.csv": content, "b.csv": "" }), "b.csv"),
        (json!({ "../hills.csv": content }), "letters, digits"),
        (json!({ "hills.csv": "0,1,2" }), "base64"),
        (json!({ "hills.csv": STANDARD.encode("0,1\n2") }), "line 2"),
    ] {
        let request = json!({ "scene": scene, "files": files });
        let refused = post(&router, "/api/v1/traces", &request.to_string()).await;
        is_problem(&refused, 422, "invalid-value");
        assert!(refused.detail().contains(word), "{}", refused.detail());
    }
    bench.end().await;
}
