//! A data folder that an older program wrote: its jobs keep their numbers, answers, files, cursors and keys.

use std::path::Path;
use std::sync::Arc;

use axum::body::Body;
use serde_json::{Value, json};
use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{Connection, SqliteConnection};

use ridged::clock::SteppedClock;
use ridged::job::{JobId, JobKind};
use ridged::lab::Lab;
use ridged::store::disk::RealDisk;
use ridged::store::jobs::NewJob;

use super::{download, get, is_problem, post, request, router_of, send};

/// `sqlite3 ridged.sqlite .dump` of a folder of ridged 0.1.0, killed while fit 4 and trace 6 ran. It had one table of fits
/// and one of all other calculations.
const DUMP: &str = include_str!("../../data/store-0.1.0.sql");

/// Restores the old database and returns the rows of its jobs as the old program answered them: path, request, result.
async fn restored(folder: &Path) -> Vec<(String, Value, Value)> {
    let options = SqliteConnectOptions::new()
        .filename(folder.join("ridged.sqlite"))
        .create_if_missing(true);
    let mut old = SqliteConnection::connect_with(&options).await.unwrap();
    sqlx::raw_sql(DUMP).execute(&mut old).await.unwrap();
    // A fit of the time before requests were stored, and a damaged row.
    sqlx::raw_sql(
        "INSERT INTO fits (scan_id, variant, options, program, created_at)
         VALUES (1, 'paper', '{\"starts\": 8}', 'ridged 0.0.1', '2020-01-01T00:00:00.000Z'),
                (1, 'paper', '{', 'ridged 0.0.1', '2020-01-01T00:00:00.000Z')",
    )
    .execute(&mut old)
    .await
    .unwrap();
    let rows: Vec<(String, String, Option<String>)> = sqlx::query_as(
        "SELECT '/api/v1/fits/' || f.id, json_extract(f.options, '$.request'), e.report
         FROM fits f LEFT JOIN fit_ends e ON e.fit_id = f.id WHERE f.id < 5
         UNION ALL
         SELECT '/api/v1/' || c.kind || 's/' || c.id, c.request, e.result
         FROM calculations c LEFT JOIN calculation_ends e ON e.calculation_id = c.id",
    )
    .fetch_all(&mut old)
    .await
    .unwrap();
    old.close().await.unwrap();
    let json = |text: &str| serde_json::from_str(text).unwrap();
    rows.iter()
        .map(|(path, request, result)| {
            let result = result.as_deref().map_or(Value::Null, json);
            (path.clone(), json(request), result)
        })
        .collect()
}

#[tokio::test]
async fn jobs_of_an_older_program_keep_their_numbers_answers_files_cursors_and_keys() {
    let folder = tempfile::tempdir().unwrap();
    let rows = restored(folder.path()).await;
    assert_eq!(rows.len(), 10);
    let picture = folder.path().join("maps/3/theta_r_deg.png");
    std::fs::create_dir_all(picture.parent().unwrap()).unwrap();
    std::fs::write(&picture, b"a picture").unwrap();

    let clock = Arc::new(SteppedClock::new());
    let (lab, recovery) = Lab::open(folder.path(), Arc::new(RealDisk), clock, None)
        .await
        .unwrap();
    let fit = |number| JobId::new(JobKind::Fit, number);
    let trace = JobId::new(JobKind::Trace, 6);
    let interrupted = recovery.interrupted_jobs;
    for id in [fit(4), fit(5), fit(6), trace] {
        assert!(interrupted.contains(&id), "{interrupted:?}");
    }
    assert_eq!(interrupted.len(), 4);
    let router = router_of(&lab);

    let mut finished = 0;
    for (path, request, result) in &rows {
        let job = get(&router, path).await.body;
        assert_eq!(&job["request"], request, "{path}");
        let number = path.rsplit('/').next().unwrap();
        assert_eq!(job["id"].to_string(), number);
        let Some(result) = result.as_object() else {
            assert_ne!(job["state"], "completed", "{path}");
            continue;
        };
        assert_eq!(job["state"], "completed", "{path}");
        finished += 1;
        for (key, value) in result {
            assert_eq!(&job[key], value, "{key} of {path}");
        }
    }
    assert_eq!(finished, 5);
    assert_eq!(
        get(&router, "/api/v1/maps/1").await.body["error"]["code"],
        "no-map"
    );
    assert_eq!(
        get(&router, "/api/v1/fits/3").await.body["state"],
        "cancelled"
    );
    is_problem(&get(&router, "/api/v1/maps/2").await, 404, "not-found");
    let without_request = get(&router, "/api/v1/fits/5").await.body;
    let request_of_columns = json!({ "scan_id": 1, "variant": "paper", "region": null });
    assert_eq!(without_request["request"], request_of_columns);
    is_problem(&get(&router, "/api/v1/fits/6").await, 500, "store-damaged");

    // A cursor that the old program gave out.
    let ids = async |path: &str| {
        let list = get(&router, path).await.body;
        let ids = list["items"].as_array().unwrap().iter();
        ids.map(|job| job["id"].as_i64().unwrap())
            .collect::<Vec<_>>()
    };
    assert_eq!(ids("/api/v1/fits?cursor=4").await, [3, 2, 1]);
    assert_eq!(ids("/api/v1/fits?cursor=4&status=cancelled").await, [3]);
    assert_eq!(ids("/api/v1/fits?variant=sawtooth").await, [2, 1]);
    assert_eq!(ids("/api/v1/maps?cursor=3").await, [1]);
    let file = download(&router, "/api/v1/maps/3/files/theta_r_deg.png").await;
    assert_eq!(file, b"a picture");

    // The same request with the same key gets the answer of then.
    let again = request("POST", "/api/v1/fits")
        .header("content-type", "application/json")
        .header("idempotency-key", "fit-one")
        .body(Body::from(r#"{"scan_id":1}"#))
        .unwrap();
    let again = send(&router, again).await;
    assert_eq!((again.status, &again.body["id"]), (202, &json!(1)));

    // Numbers go on within each kind.
    for (kind, next) in [(JobKind::Fit, 7), (JobKind::Map, 4), (JobKind::Contrast, 3)] {
        let new = NewJob {
            kind,
            scan_id: Some(1),
            variant: None,
            request: "{}".into(),
            options: None,
            who: "local".into(),
        };
        let (id, _) = lab.store().start_job(&new).await.unwrap();
        assert_eq!(id, JobId::new(kind, next));
    }
    let unknown = post(&router, "/api/v1/fits/99/cancel", "").await;
    is_problem(&unknown, 404, "not-found");
    lab.shut_down().await;
}
