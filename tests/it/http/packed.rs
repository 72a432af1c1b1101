//! Bodies that a client sends packed (`Content-Encoding: gzip`).

use std::io::Write as _;

use axum::body::Body;
use axum::http::Request;
use flate2::Compression;
use flate2::write::GzEncoder;

use super::{get, is_problem, opened, request, send};

fn gzip(content: &[u8]) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::best());
    encoder.write_all(content).unwrap();
    encoder.finish().unwrap()
}

fn packed(encoding: &str, content: Vec<u8>) -> Request<Body> {
    request("POST", "/api/v1/samples")
        .header("content-type", "application/json")
        .header("content-encoding", encoding)
        .header("content-length", content.len())
        .body(Body::from(content))
        .unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_packed_body_is_read_as_if_it_were_not() {
    let (bench, router) = opened().await;
    let body = br#"{"name": "packed", "material": {"kind": "dielectric", "eta": 1.5}}"#;
    let added = send(&router, packed("gzip", gzip(body))).await;
    assert_eq!(added.status, 201, "{}", added.body);
    let found = get(&router, "/api/v1/samples?name=packed").await;
    assert_eq!(found.body["items"].as_array().unwrap().len(), 1);
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_small_body_that_unpacks_to_a_large_one_is_cut_off_by_the_limit_of_bodies() {
    let (bench, router) = opened().await;
    let bomb = gzip(&vec![b' '; 256 << 20]);
    assert!(bomb.len() < 1 << 20, "{}", bomb.len());
    is_problem(
        &send(&router, packed("gzip", bomb)).await,
        413,
        "body-too-large",
    );
    let mut broken = gzip(b"{}");
    broken.truncate(12);
    let refused = send(&router, packed("gzip", broken)).await;
    is_problem(&refused, 400, "bad-request");
    assert!(refused.detail().contains("gzip"), "{}", refused.detail());
    let other = send(&router, packed("br", b"{}".to_vec())).await;
    is_problem(&other, 415, "wrong-content-encoding");
    assert!(other.detail().contains("gzip"), "{}", other.detail());
    bench.end().await;
}
