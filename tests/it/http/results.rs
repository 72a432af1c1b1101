//! `/results` and `fields=` of `/fits`.

use axum::body::{Body, to_bytes};
use axum::http::header;
use serde_json::{Value, json};
use tower::ServiceExt;

use ridged::job::JobKind;
use ridged::store::jobs::{JobEnd, NewJob};

use super::{get, imported, is_problem, opened, request};
use crate::bench_in_a_box::BenchInABox;

/// Ends a fit of scan 1 with this report.
async fn fitted(bench: &BenchInABox, report: &Value) {
    let store = bench.lab.store();
    let new = NewJob {
        kind: JobKind::Fit,
        scan_id: Some(1),
        variant: Some("auto".into()),
        request: json!({ "scan_id": 1 }).to_string(),
        options: None,
        who: "local".into(),
    };
    let (id, _) = store.start_job(&new).await.unwrap();
    let end = JobEnd::Completed {
        result: report.to_string(),
        fit: None,
    };
    store.end_job(id, &end).await.unwrap();
}

fn report() -> Value {
    let angle = json!({ "value": 10.001_234, "std": 0.012_34, "expanded": 0.024_68, "coverage_factor": 2.0 });
    json!({ "variant": "sawtooth", "status": "converged", "parameters": { "theta_r_deg": angle }, "rms_residual": 0.004 })
}

#[tokio::test]
async fn results_are_short_rows_as_json_and_as_csv() {
    let (bench, router) = opened().await;
    imported(&router).await;
    fitted(&bench, &report()).await;
    let list = get(&router, "/api/v1/results?count=true").await;
    assert_eq!(list.status, 200, "{}", list.body);
    assert_eq!(
        (&list.body["count"], &list.body["next_cursor"]),
        (&json!(1), &Value::Null)
    );
    let row = &list.body["items"][0];
    assert_eq!(
        (&row["scan_id"], &row["theta_r_deg"]),
        (&json!(1), &json!(10.0012))
    );
    let short = get(&router, "/api/v1/results?fields=theta_r_deg,part").await;
    assert_eq!(
        short.body["items"],
        json!([{ "theta_r_deg": 10.0012, "part": "polymer-10" }])
    );

    let csv = async |path: &str, accept: &str| {
        let asked = request("GET", path).header(header::ACCEPT, accept);
        let answer = router
            .clone()
            .oneshot(asked.body(Body::empty()).unwrap())
            .await
            .unwrap();
        let kind = answer.headers()[header::CONTENT_TYPE]
            .to_str()
            .unwrap()
            .to_owned();
        let bytes = to_bytes(answer.into_body(), usize::MAX).await.unwrap();
        (kind, String::from_utf8(bytes.to_vec()).unwrap())
    };
    let path = "/api/v1/results?fields=scan_id,part,theta_r_deg,rho_d";
    let table = "scan_id,part,theta_r_deg,rho_d\n1,polymer-10,10.0012,\n";
    let by_accept = csv(path, "text/csv").await;
    assert_eq!(by_accept, ("text/csv; charset=utf-8".into(), table.into()));
    let by_format = csv(&format!("{path}&format=csv"), "application/json").await;
    assert_eq!(by_format, by_accept);
    let preferred = csv(path, "application/json, text/csv;q=0.5").await;
    assert!(preferred.0.starts_with("application/json"), "{preferred:?}");
}

#[tokio::test]
async fn a_query_of_results_that_is_not_valid_is_refused_by_name() {
    let (_bench, router) = opened().await;
    let unknown = get(&router, "/api/v1/results?verdicts=fail").await;
    is_problem(&unknown, 400, "bad-request");
    assert!(
        unknown.detail().contains("did you mean `verdict`?"),
        "{}",
        unknown.body
    );
    for (query, field) in [
        ("verdict=fial", "verdict"),
        ("theta_r_deg_min=steep", "theta_r_deg_min"),
        ("sort=angle", "sort"),
        ("cursor=12", "cursor"),
        ("limit=0", "limit"),
    ] {
        let refused = get(&router, &format!("/api/v1/results?{query}")).await;
        is_problem(&refused, 422, "invalid-value");
        assert_eq!(
            refused.body["errors"][0]["field"], field,
            "{}",
            refused.body
        );
    }
}

#[tokio::test]
async fn fields_shorten_the_rows_of_fits() {
    let (bench, router) = opened().await;
    imported(&router).await;
    fitted(&bench, &report()).await;
    let path = "/api/v1/fits?fields=id,state,parameters.theta_r_deg";
    let short = get(&router, path).await;
    let angle = &report()["parameters"]["theta_r_deg"];
    let row = json!({ "id": 1, "state": "completed", "parameters": { "theta_r_deg": angle } });
    assert_eq!(short.body["items"], json!([row]));
    let refused = get(&router, "/api/v1/fits?fields=id,sate").await;
    is_problem(&refused, 422, "invalid-value");
    assert!(
        refused.detail().contains("did you mean `state`?"),
        "{}",
        refused.body
    );
}
