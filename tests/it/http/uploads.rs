//! Uploads: a series as a zip archive, and archives that are none.

use std::io::{Cursor, Write};
use std::path::Path;

use axum::body::Body;
use axum::http::Request;
use serde_json::Value;
use tower::ServiceExt;
use zip::write::SimpleFileOptions;

use super::{get, is_problem, opened, polymer, request, send};

/// Packs the series with as many frames, in a folder of the archive.
pub(crate) fn archive(frames: usize) -> Vec<u8> {
    let series = polymer();
    let list = std::fs::read_to_string(series.join("frames.csv")).unwrap();
    let dark = list.lines().skip(1).take(1);
    let sample = list.lines().filter(|line| line.contains(",sample,"));
    let rows: Vec<&str> = dark.chain(sample).take(frames).collect();
    let head = list.lines().next().unwrap();
    let table = [&[head], &rows[..]].concat().join("\n");
    let mut zip = zip::ZipWriter::new(Cursor::new(Vec::new()));
    let mut add = |name: &str, content: &[u8]| {
        zip.start_file(format!("part 7/{name}"), SimpleFileOptions::default())
            .unwrap();
        zip.write_all(content).unwrap();
    };
    let manifest = std::fs::read(series.join("manifest.toml")).unwrap();
    add("manifest.toml", &manifest);
    add("frames.csv", table.as_bytes());
    for row in rows {
        let file = row.split(',').next().unwrap();
        add(file, &std::fs::read(series.join(file)).unwrap());
    }
    zip.finish().unwrap().into_inner()
}

fn upload(query: &str, content: impl Into<Body>) -> Request<Body> {
    request("POST", &format!("/api/v1/imports/upload{query}"))
        .header("content-type", "application/zip")
        .body(content.into())
        .unwrap()
}

fn is_empty(uploads: &Path) -> bool {
    std::fs::read_dir(uploads).is_ok_and(|mut entries| entries.next().is_none())
}

#[tokio::test(flavor = "multi_thread")]
async fn an_uploaded_archive_becomes_a_scan_and_leaves_nothing_behind() {
    let (bench, router) = opened().await;
    let uploads = bench.lab.store().folder().join("uploads");
    let packed = archive(12);
    let answer = send(&router, upload("?name=part%207.zip", packed.clone())).await;
    assert_eq!(answer.status, 201, "{}", answer.body);
    assert_eq!(answer.body["n_frames"], 12);
    let scan = get(&router, answer.location.as_deref().unwrap()).await.body;
    assert_eq!(scan["state"], "completed");
    assert_eq!(scan["origin"], "import");
    assert!(is_empty(&uploads));
    // In parts, as a browser sends it.
    let parts: Vec<_> = packed
        .chunks(1000)
        .map(|part| Ok::<_, std::io::Error>(part.to_vec()))
        .collect();
    let in_parts = Body::from_stream(futures::stream::iter(parts));
    let again = send(&router, upload("", in_parts)).await;
    assert_eq!(again.body["same_as_scan_id"], 1, "{}", again.body);
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_upload_that_is_no_series_is_refused_and_nothing_is_kept() {
    let (bench, router) = opened().await;
    let uploads = bench.lab.store().folder().join("uploads");
    let refused = send(&router, upload("?name=part.zip", "not a zip archive")).await;
    is_problem(&refused, 422, "series-invalid");
    let detail = refused.detail();
    assert!(
        detail.starts_with("part.zip") && detail.contains("pack the folder"),
        "{detail}"
    );
    let packed = archive(3);
    let torn = send(&router, upload("", packed[..packed.len() / 2].to_vec())).await;
    is_problem(&torn, 422, "series-invalid");
    let broken = futures::stream::iter([
        Ok(packed[..100].to_vec()),
        Err(std::io::Error::other("the client left")),
    ]);
    let broken = send(&router, upload("", Body::from_stream(broken))).await;
    is_problem(&broken, 400, "bad-request");
    for name in ["", "a%2Fb.zip", "..%2Fb.zip", ".b.zip", "a%00b.zip"] {
        let refused = send(&router, upload(&format!("?name={name}"), packed.clone())).await;
        is_problem(&refused, 422, "invalid-value");
    }
    let text = request("POST", "/api/v1/imports/upload")
        .header("content-type", "text/plain")
        .body(Body::from("{}"))
        .unwrap();
    let text = send(&router, text).await;
    is_problem(&text, 415, "wrong-content-type");
    assert!(
        text.detail().contains("application/zip"),
        "{}",
        text.detail()
    );
    let scans = get(&router, "/api/v1/scans").await.body;
    assert_eq!(scans["items"], Value::Array(vec![]));
    assert!(is_empty(&uploads));
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn no_more_than_two_uploads_are_received_at_a_time() {
    let (bench, router) = opened().await;
    let stalled = || {
        let router = router.clone();
        tokio::spawn(async move {
            let never = futures::stream::pending::<Result<Vec<u8>, std::io::Error>>();
            router.oneshot(upload("", Body::from_stream(never))).await
        })
    };
    let waiting = [stalled(), stalled()];
    let uploads = bench.lab.store().folder().join("uploads");
    let received = || std::fs::read_dir(&uploads).map_or(0, Iterator::count);
    while received() < 2 {
        tokio::task::yield_now().await;
    }
    let third = send(&router, upload("", archive(3))).await;
    is_problem(&third, 429, "too-many-bodies");
    for upload in waiting {
        upload.abort();
        assert!(upload.await.is_err());
    }
    let fourth = send(&router, upload("", archive(3))).await;
    assert_eq!(fourth.status, 201, "{}", fourth.body);
    bench.end().await;
}
