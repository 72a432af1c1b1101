//! Calibrations: dark and white-reference frames taken alone, for scans to come.

use ridged::scan::ScanState;
use serde_json::{Value, json};

use super::{get, is_problem, opened, post};

#[tokio::test(flavor = "multi_thread")]
async fn calibrations_are_taken_alone_and_leave_the_next_scan_the_sample_only() {
    let (bench, router) = opened().await;
    let hands = bench.rig.operate(&bench.lab, true);
    let sampled = json!({"sample_id": 2, "plan": {"preset": "paper", "repeats": 2}}).to_string();
    let refused = post(&router, "/api/v1/calibrations", &sampled).await;
    is_problem(&refused, 422, "invalid-value");
    let nothing = json!({"sample_id": 2, "plan": {"dark": {"repeats": 0}, "flat": {"repeats": 0}}});
    let refused = post(&router, "/api/v1/calibrations", &nothing.to_string()).await;
    assert_eq!(refused.status, 422, "{}", refused.body);
    assert!(
        refused.detail().contains("plan.repeats"),
        "{}",
        refused.detail()
    );

    let asked = json!({"sample_id": 2, "plan": {"theta_c_deg": [0, 10], "exposures_s": [0.02]}});
    let begun = post(&router, "/api/v1/calibrations", &asked.to_string()).await;
    assert_eq!(begun.status, 202, "{}", begun.body);
    assert_eq!(begun.location.as_deref(), Some("/api/v1/scans/1"));
    assert_eq!(bench.finish(1).await.state, ScanState::Completed);
    let scan = get(&router, "/api/v1/scans/1").await.body;
    assert_eq!(
        (&scan["plan"]["repeats"], &scan["progress"]["fraction"]),
        (&json!(0), &json!(1.0))
    );
    let taken = get(&router, "/api/v1/calibrations?scan_id=1").await.body;
    let what = |item: &Value| {
        (
            item["kind"].clone(),
            item["theta_c_deg"].clone(),
            item["valid"].clone(),
        )
    };
    let items: Vec<_> = taken["items"]
        .as_array()
        .unwrap()
        .iter()
        .map(what)
        .collect();
    assert_eq!(
        items,
        [
            (json!("flat"), json!([0.0, 10.0]), json!(true)),
            (json!("dark"), json!([]), json!(true)),
        ]
    );
    // There is nothing to reduce in it, and that is said.
    let frames = get(&router, "/api/v1/scans/1/frames?kind=sample")
        .await
        .body;
    assert_eq!(frames["items"], json!([]));
    let none = get(&router, "/api/v1/scans/1/observations").await;
    assert!(
        (400..500).contains(&none.status),
        "{} {}",
        none.status,
        none.body
    );
    assert!(none.detail().contains("sample"), "{}", none.detail());

    let asked = json!({"sample_id": 2, "plan":
        {"theta_c_deg": [0, 10], "phi_s_deg": [0, 90], "exposures_s": [0.02]}});
    let estimate = post(&router, "/api/v1/scans/estimate", &asked.to_string())
        .await
        .body;
    assert_eq!(estimate["operator_steps"].as_array().unwrap().len(), 1);
    assert_eq!(
        estimate["operator_steps"][0]["action"],
        json!("place-sample")
    );
    assert_eq!(estimate["calibration_ids"], json!([1, 2]));
    let begun = post(&router, "/api/v1/scans", &asked.to_string()).await;
    assert_eq!(begun.status, 202, "{}", begun.body);
    assert_eq!(bench.finish(2).await.state, ScanState::Completed);
    let reduced = get(&router, "/api/v1/scans/2/observations").await.body;
    assert_eq!(
        (
            &reduced["absolute"],
            reduced["items"].as_array().unwrap().len()
        ),
        (&json!(true), 4)
    );
    hands.abort();
    bench.end().await;
}
