use serde_json::json;

use super::*;
use crate::job::{JobId, JobKind};
use crate::scan::{Progress, ScanState};
use crate::store::jobs::{FitSummary, JobEnd, NewJob};
use crate::store::samples::tests::polymer;
use crate::store::scans::tests::planned;
use crate::store::scans::{NewScan, ScanPurpose};
use crate::store::tests::open;

/// A report of a fit, as far as results read it.
fn report(theta_r_deg: f64, std: f64) -> String {
    let parameter = |value: f64, std: f64| json!({ "value": value, "std": std, "expanded": 2.0 * std, "coverage_factor": 2 });
    let unknown = json!({ "value": null, "std": null, "note": "a metal has none" });
    json!({
        "parameters": {
            "theta_r_deg": parameter(theta_r_deg, std),
            "alpha_u": parameter(0.12, 0.001),
            "alpha_v": parameter(0.13, 0.001),
            "rho_d": unknown,
        },
        "rms_residual": 0.004,
        "findings": [{ "code": "lamp-drift" }, { "code": "bad-pose" }],
    })
    .to_string()
}

async fn end(
    store: &Store,
    kind: JobKind,
    scan_id: i64,
    region: Option<&str>,
    result: String,
) -> JobId {
    let new = NewJob {
        kind,
        scan_id: Some(scan_id),
        variant: None,
        request: json!({ "scan_id": scan_id, "region": region }).to_string(),
        options: None,
        who: "local".into(),
    };
    let (id, _) = store.start_job(&new).await.unwrap();
    let fit = (kind == JobKind::Fit).then(|| FitSummary {
        set_id: 1,
        variant: "sawtooth".into(),
        status: "converged".into(),
        theta_r_deg: None,
    });
    let end = JobEnd::Completed { result, fit };
    store.end_job(id, &end).await.unwrap();
    id
}

/// Scans 1, 2, … with fits of these angles, each of a sample of its own.
async fn fitted(store: &Store, angles: &[Option<f64>]) {
    for angle in angles {
        let scan = planned(store).await;
        if let Some(angle) = angle {
            end(store, JobKind::Fit, scan.id, None, report(*angle, 0.01)).await;
        }
    }
}

async fn found(store: &Store, parameters: &[(&str, &str)]) -> Vec<i64> {
    let query = ResultQuery::read(parameters.iter().copied()).unwrap();
    let page = store.results(&query).await.unwrap();
    let count = store.count_results(&query).await.unwrap();
    assert!(count >= page.rows.len() as i64);
    page.rows.iter().map(ResultRow::scan_id).collect()
}

/// A store in which reports name set 1.
async fn store() -> (tempfile::TempDir, Store) {
    let folder = tempfile::tempdir().unwrap();
    let (store, _) = open(folder.path()).await.unwrap();
    sqlx::query("PRAGMA foreign_keys = OFF")
        .execute(store.writer())
        .await
        .unwrap();
    (folder, store)
}

fn text(row: &ResultRow, name: &str) -> serde_json::Value {
    serde_json::to_value(row.shown(column(name).unwrap())).unwrap()
}

async fn only_row(store: &Store) -> ResultRow {
    let mut page = store.results(&ResultQuery::default()).await.unwrap();
    assert_eq!(page.rows.len(), 1);
    page.rows.remove(0)
}

#[tokio::test]
async fn the_finding_that_explains_most_selects_results() {
    let (_folder, store) = store().await;
    fitted(&store, &[Some(9.0), None]).await;
    assert_eq!(found(&store, &[("finding", "lamp-drift,tails")]).await, [1]);
    assert!(found(&store, &[("finding", "bad-pose")]).await.is_empty());
    assert_eq!(found(&store, &[("finding", "")]).await, [2]);
}

#[tokio::test]
async fn a_row_follows_its_scan_sample_fit_and_verdict() {
    let (_folder, store) = store().await;
    let scan = planned(&store).await;
    let row = only_row(&store).await;
    assert_eq!(text(&row, "state"), "planned");
    assert_eq!(
        (text(&row, "material"), text(&row, "eta")),
        (json!("dielectric"), json!(1.54))
    );
    assert_eq!(text(&row, "theta_r_deg"), json!(null));
    assert_eq!(
        (text(&row, "who"), text(&row, "ended_at")),
        (json!("anna"), json!(null))
    );

    let to = async |state| {
        let progress = Progress::default();
        store
            .change_state(scan.id, state, None, None, progress)
            .await
            .unwrap();
    };
    to(ScanState::Running).await;
    to(ScanState::Completed).await;
    end(&store, JobKind::Fit, scan.id, None, report(9.5, 0.02)).await;
    end(
        &store,
        JobKind::Fit,
        scan.id,
        None,
        report(10.001_234, 0.012_34),
    )
    .await;
    let judged = json!({ "verdict": "pass", "specification": "PX" }).to_string();
    let verdict = end(&store, JobKind::Verdict, scan.id, None, judged).await;
    let other = polymer(&store).await;
    store.rename_sample(other.id, "B-17").await.unwrap();
    store.assign_scan(scan.id, other.id, "").await.unwrap();
    let row = only_row(&store).await;
    for (name, value) in [
        ("state", json!("completed")),
        ("part", json!("B-17")),
        ("sample_id", json!(other.id)),
        ("fit_id", json!(2)),
        ("status", json!("converged")),
        ("theta_r_deg", json!(10.0012)),
        ("theta_r_deg_std", json!(0.0123)),
        ("theta_r_deg_expanded", json!(0.0247)),
        ("coverage_factor", json!(2.0)),
        ("rho_d", json!(null)),
        ("finding", json!("lamp-drift")),
        ("verdict", json!("pass")),
        ("verdict_id", json!(verdict.number)),
        ("specification", json!("PX")),
    ] {
        assert_eq!(text(&row, name), value, "{name}");
    }
    assert_ne!(text(&row, "ended_at"), json!(null));
    store.rename_sample(other.id, "B-18").await.unwrap();
    assert_eq!(text(&only_row(&store).await, "part"), "B-18");
    // All that the triggers keep is what a new computation gives.
    let (kept, made): (i64, i64) = sqlx::query_as(
        "SELECT COUNT(*), (SELECT COUNT(*) FROM (SELECT * FROM results INTERSECT SELECT * FROM result_now)) FROM results",
    )
    .fetch_one(store.readers())
    .await
    .unwrap();
    assert_eq!((kept, made), (1, 1));
}

#[tokio::test]
async fn a_row_states_whether_its_verdict_judged_the_values_of_its_fit() {
    let (_folder, store) = store().await;
    let scan = planned(&store).await;
    let fit = async |angle| end(&store, JobKind::Fit, scan.id, None, report(angle, 0.01)).await;
    let judge = async |items: serde_json::Value| {
        let judged = json!({ "verdict": "pass", "specification": "PX", "items": items });
        end(&store, JobKind::Verdict, scan.id, None, judged.to_string()).await;
    };
    let matches = async || text(&only_row(&store).await, "verdict_matches");
    fit(10.0).await;
    assert_eq!(matches().await, json!(null));
    let item = |quantity: &str, value| json!({ "quantity": quantity, "value": value, "std": 0.01 });
    let angle = item("theta_r_deg", json!(10.00001));
    judge(json!([angle, item("alpha_u", json!(0.12))])).await;
    assert_eq!(matches().await, json!(true));
    fit(9.0).await;
    assert_eq!(matches().await, json!(false));
    assert_eq!(found(&store, &[("verdict_matches", "false")]).await, [1]);
    // The fit does not determine what was judged.
    judge(json!([item("rho_d", json!(0.3))])).await;
    assert_eq!(matches().await, json!(false));
    // Nothing to compare: no value, no parameter of the fit, the turn of an azimuth.
    judge(json!([
        item("theta_r_deg", json!(null)),
        item("contrast_mean", json!(0.5)),
        item("azimuth_offset_deg", json!(181.0)),
    ]))
    .await;
    assert_eq!(matches().await, json!(true));
}

#[tokio::test]
async fn a_row_has_the_purpose_of_its_scan() {
    let (_folder, store) = store().await;
    sqlx::raw_sql(
        "INSERT INTO definitions (kind, number, name, created_at) VALUES ('recipe', 1, 'PX-1204', '');
         INSERT INTO definition_versions (definition_id, version, content, who, at) VALUES (1, 3, '{}', 'local', '')",
    )
    .execute(store.writer())
    .await
    .unwrap();
    let new = NewScan {
        sample_id: polymer(&store).await.id,
        rig_id: None,
        name: "scan".into(),
        plan: None,
        manifest: String::new(),
        frames_csv: None,
        calibration_ids: vec![],
        purpose: ScanPurpose {
            recipe_version_id: Some(1),
            lot: Some("L-4".into()),
            external_id: Some("A-17".into()),
            operator_name: Some("Anna".into()),
            ..ScanPurpose::default()
        },
        who: "local".into(),
    };
    store.add_scan(&new).await.unwrap();
    let row = only_row(&store).await;
    for (name, value) in [
        ("recipe", json!("PX-1204")),
        ("recipe_version", json!(3)),
        ("lot", json!("L-4")),
        ("external_id", json!("A-17")),
        ("operator_name", json!("Anna")),
    ] {
        assert_eq!(text(&row, name), value, "{name}");
    }
    for (name, value) in [
        ("search", "a-1"),
        ("lot", "L-4"),
        ("recipe_version_min", "3"),
    ] {
        assert_eq!(found(&store, &[(name, value)]).await, [1], "{name}");
    }
    assert_eq!(found(&store, &[("recipe", "")]).await, Vec::<i64>::new());
}

#[tokio::test]
async fn a_sample_with_regions_has_a_row_for_each() {
    let (_folder, store) = store().await;
    let scan = planned(&store).await;
    for (region, angle) in [("even", 10.0), ("odd", 5.0), ("even", 10.5)] {
        end(
            &store,
            JobKind::Fit,
            scan.id,
            Some(region),
            report(angle, 0.01),
        )
        .await;
    }
    let judged = json!({ "verdict": "fail", "specification": "PX" }).to_string();
    end(&store, JobKind::Verdict, scan.id, Some("odd"), judged).await;
    // A verdict on a stated fit names the region in its result alone.
    let judged = json!({ "verdict": "pass", "specification": "PX", "region": "even" }).to_string();
    end(&store, JobKind::Verdict, scan.id, None, judged).await;
    let page = store.results(&ResultQuery::default()).await.unwrap();
    let row = |at: usize| {
        let row = &page.rows[at];
        (row.region(), text(row, "theta_r_deg"), text(row, "verdict"))
    };
    assert_eq!(page.rows.len(), 2);
    assert_eq!(row(0), ("odd", json!(5.0), json!("fail")));
    assert_eq!(row(1), ("even", json!(10.5), json!("pass")));
    assert_eq!(found(&store, &[("region", "odd")]).await, [scan.id]);
    // A page ends between the regions of a scan.
    let query = ResultQuery::read([("limit", "1"), ("sort", "region")]).unwrap();
    let first = store.results(&query).await.unwrap();
    assert_eq!(first.rows[0].region(), "even");
    let cursor = first.next_cursor.unwrap();
    let query =
        ResultQuery::read([("limit", "1"), ("sort", "region"), ("cursor", &cursor)]).unwrap();
    let second = store.results(&query).await.unwrap();
    assert_eq!((second.rows[0].region(), second.next_cursor), ("odd", None));
}

#[tokio::test]
async fn filters_select_by_value_word_time_and_text() {
    let (_folder, store) = store().await;
    fitted(&store, &[Some(9.0), None, Some(10.0), Some(11.0)]).await;
    let judged = json!({ "verdict": "cannot-tell", "specification": "PX 100%_a" }).to_string();
    end(&store, JobKind::Verdict, 3, None, judged).await;
    store.rename_sample(4, "Panel B-17").await.unwrap();
    for (parameters, scans) in [
        (vec![("theta_r_deg_min", "9.5")], vec![4, 3]),
        (
            vec![("theta_r_deg_min", "9.5"), ("theta_r_deg_max", "10.5")],
            vec![3],
        ),
        (vec![("verdict", "pass,cannot-tell")], vec![3]),
        (vec![("verdict", "")], vec![4, 2, 1]),
        (vec![("status", ",converged")], vec![4, 3, 2, 1]),
        (vec![("part", "Panel B-17")], vec![4]),
        (vec![("search", "b-17")], vec![4]),
        (vec![("search", "100%_A")], vec![3]),
        (vec![("search", "1%7")], vec![]),
        (vec![("scan_id_max", "2")], vec![2, 1]),
        (vec![("fit_id", "2")], vec![3]),
        (vec![("until", "1980-01-01")], vec![]),
        (
            vec![("since", "1980-01-01T00:00:00Z"), ("state", "planned")],
            vec![4, 3, 2, 1],
        ),
        (vec![("sort", "theta_r_deg")], vec![1, 3, 4, 2]),
        (vec![("sort", "-theta_r_deg")], vec![4, 3, 1, 2]),
    ] {
        assert_eq!(found(&store, &parameters).await, scans, "{parameters:?}");
    }
}

#[tokio::test]
async fn the_latest_scan_of_a_part_is_the_newest_one_that_the_filters_on_scans_leave() {
    let (_folder, store) = store().await;
    fitted(&store, &[Some(9.0), Some(10.0), Some(11.0), None]).await;
    // Scans 1 to 4 are of samples 1 to 4; scans 2 to 4 become scans of sample 1.
    for scan in 2..=4 {
        store.assign_scan(scan, 1, "").await.unwrap();
    }
    assert_eq!(found(&store, &[("latest", "true")]).await, [3]);
    let before = [("latest", "true"), ("scan_id_max", "2")];
    assert_eq!(found(&store, &before).await, [2]);
    // Its value decides afterwards.
    let low = [("latest", "true"), ("theta_r_deg_max", "10.5")];
    assert_eq!(found(&store, &low).await, Vec::<i64>::new());
}

#[tokio::test]
async fn pages_stay_whole_while_rows_are_added_in_every_order() {
    for sort in [
        "-scan_id",
        "scan_id",
        "theta_r_deg",
        "-theta_r_deg",
        "verdict",
        "-part",
    ] {
        let (_folder, store) = store().await;
        // Ties and rows without a value.
        fitted(
            &store,
            &[
                Some(10.0),
                None,
                Some(9.0),
                Some(10.0),
                None,
                Some(10.0),
                Some(8.0),
            ],
        )
        .await;
        let mut expected = found(&store, &[("sort", sort)]).await;
        let mut seen = Vec::new();
        let mut cursor: Option<String> = None;
        loop {
            let mut parameters = vec![("sort", sort), ("limit", "2")];
            parameters.extend(cursor.as_deref().map(|cursor| ("cursor", cursor)));
            let query = ResultQuery::read(parameters).unwrap();
            let page = store.results(&query).await.unwrap();
            seen.extend(page.rows.iter().map(ResultRow::scan_id));
            cursor = page.next_cursor;
            if cursor.is_none() {
                break;
            }
            if seen.len() < 6 {
                fitted(&store, &[Some(9.5)]).await;
            }
        }
        // Rows that came meanwhile may be on the pages; all others are there once.
        seen.retain(|scan| *scan <= 7);
        assert_eq!(seen, expected, "{sort}");
        expected.sort_unstable();
        assert_eq!(expected, [1, 2, 3, 4, 5, 6, 7]);
    }
}

#[tokio::test]
async fn a_brief_row_has_at_most_600_bytes_whatever_its_texts() {
    let (_folder, store) = store().await;
    let scan = planned(&store).await;
    end(
        &store,
        JobKind::Fit,
        scan.id,
        None,
        report(10.001_234_567_89, 0.012_345_678),
    )
    .await;
    let judged = json!({ "verdict": "cannot-tell", "specification": "PX-1204 rev C" }).to_string();
    end(&store, JobKind::Verdict, scan.id, None, judged).await;
    let rename = async |name: &str| {
        store.rename_sample(scan.sample_id, name).await.unwrap();
        only_row(&store).await
    };
    let query = ResultQuery::default();
    assert!(query.brief);
    let row = rename("Panel B-17 of the left side").await;
    let text = serde_json::to_string(&row.brief(&query.fields)).unwrap();
    assert!(text.len() <= 560, "{} bytes: {text}", text.len());
    assert!(
        text.starts_with("{\"scan_id\":1,\"fit_id\":1,\"part\":"),
        "{text}"
    );
    assert_eq!(
        text,
        serde_json::to_string(&row.object(&query.fields)).unwrap()
    );

    let long = "Ü\"".repeat(100);
    let row = rename(&long).await;
    let text = serde_json::to_string(&row.brief(&query.fields)).unwrap();
    assert!(
        (590..=ROW_BYTES_MAX).contains(&text.len()),
        "{} bytes: {text}",
        text.len()
    );
    let brief: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!(brief["shortened"], true);
    let part = brief["part"].as_str().unwrap();
    assert!(
        long.starts_with(part.strip_suffix('…').unwrap()) && part.chars().count() > 8,
        "{part}"
    );
    assert_eq!(brief["specification"], "PX-1204 rev C");
    let whole = ResultQuery::read([("fields", "usual")]).unwrap();
    assert!(!whole.brief);
    let whole = serde_json::to_value(row.object(&whole.fields)).unwrap();
    assert_eq!(
        (&whole["part"], whole.get("shortened")),
        (&json!(long), None)
    );
}

#[test]
fn a_brief_row_keeps_its_bytes_with_long_values_in_every_column() {
    let query = ResultQuery::default();
    let cells = query.fields.iter().map(|column| {
        let cell = match column.kind {
            Kind::Id => Cell::Id(9_999_999),
            Kind::Real { .. } if column.name.ends_with("_std") => Cell::Real(1.234e-5),
            Kind::Real { .. } => Cell::Real(12.345_678_912_345),
            Kind::Time => Cell::Text("2026-11-27T03:50:57.000Z".into()),
            // A scan that waits has no fit yet.
            _ if column.name == "state" => Cell::Text("interrupted".into()),
            Kind::Word(words) => {
                Cell::Text((*words.iter().max_by_key(|word| word.len()).unwrap()).into())
            }
            _ => Cell::Text("\u{1F9EA}".repeat(200)),
        };
        (column.name, cell)
    });
    let row = ResultRow::of(cells.collect());
    let text = serde_json::to_string(&row.brief(&query.fields)).unwrap();
    assert!(text.len() <= ROW_BYTES_MAX, "{} bytes: {text}", text.len());
}
