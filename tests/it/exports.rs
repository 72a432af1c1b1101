//! A scan as files for other programs: read back by their formats' own rules.

use std::io::Cursor;

use axum::body::{Body, to_bytes};
use ridged::frame::FrameKind;
use ridged::series::Series;
use ridged::tables::BrdfTable;
use serde_json::{Value, json};
use tiff::decoder::{Decoder, DecodingResult};
use tiff::tags::Tag;
use tower::ServiceExt;

use crate::http::{download, ended, get, imported, is_problem, opened, polymer, post, request};
use crate::tables::bird::against;

#[tokio::test]
async fn the_brdf_of_a_scan_is_a_valid_bird_file_that_is_read_back() {
    let (bench, router) = opened().await;
    imported(&router).await;
    let answer = get(&router, "/api/v1/scans/1/brdf.json").await;
    assert_eq!(answer.status, 200, "{}", answer.body);
    let file = answer.body;
    let schema = include_str!("../data/bird/brdf_json_schema_v1.0.json");
    let schema: Value = serde_json::from_str(schema).unwrap();
    assert_eq!(against(&schema, &file, "file"), Vec::<String>::new());
    let series = Series::open(&polymer()).unwrap();
    let of_part = series
        .rows()
        .iter()
        .filter(|row| row.kind == FrameKind::Sample);
    let first = of_part.map(|row| row.timestamp.as_str()).min().unwrap();
    assert_eq!(file["metadata"]["timestamp"], json!(first));
    let folder = tempfile::tempdir().unwrap();
    let manifest = "schema = \"brdf-table-1\"\ntable = \"brdf.json\"\n[goniometer]\nvalue = \"brdf\"\n[sample]\n\
        kind = \"dielectric\"\nindex_of_refraction = 1.54\n";
    std::fs::write(folder.path().join("manifest.toml"), manifest).unwrap();
    std::fs::write(folder.path().join("brdf.json"), file.to_string()).unwrap();
    let read = BrdfTable::open(folder.path()).unwrap().observations();
    let set = bench.lab.observations(1, None).await.unwrap().set;
    assert_eq!(read.observations.len(), set.observations.len());
    for (index, (own, back)) in set.observations.iter().zip(&read.observations).enumerate() {
        let signal = own.signal.max(0.0);
        assert!(
            (back.signal - signal).abs() <= 1e-12 + 1e-9 * signal,
            "{index}"
        );
        assert!(back.sigma >= own.sigma * (1.0 - 1e-9), "{index}");
        // The same angles between lamp, camera, normal and ridges.
        let (a, b) = (set.rig_directions(index), read.rig_directions(index));
        for (x, y) in [
            (a.incident.z, b.incident.z),
            (a.outgoing.z, b.outgoing.z),
            (a.incident.dot(&a.outgoing), b.incident.dot(&b.outgoing)),
        ] {
            // A zenith angle in degrees keeps half of the digits of a cosine near 1.
            assert!((x - y).abs() < 1e-7, "{index}: {x} for {y}");
        }
    }
}

#[tokio::test]
async fn the_stack_of_a_scan_has_its_frames_bit_for_bit() {
    let (_bench, router) = opened().await;
    imported(&router).await;
    let asked = request("GET", "/api/v1/scans/1/frames.tif").body(Body::empty());
    let answer = router.clone().oneshot(asked.unwrap()).await.unwrap();
    assert_eq!(answer.headers()["content-type"], "image/tiff");
    let length: usize = answer.headers()["content-length"]
        .to_str()
        .unwrap()
        .parse()
        .unwrap();
    let bytes = to_bytes(answer.into_body(), usize::MAX).await.unwrap();
    assert_eq!(bytes.len(), length);
    let series = Series::open(&polymer()).unwrap();
    let mut decoder = Decoder::new(Cursor::new(&bytes[..])).unwrap();
    let rows = series.rows();
    for (index, row) in rows.iter().enumerate() {
        let text = decoder.get_tag_ascii_string(Tag::ImageDescription).unwrap();
        let page: Value = serde_json::from_str(text.trim_end_matches('\0')).unwrap();
        assert_eq!(page["file"], json!(row.file));
        assert_eq!(page["theta_c_deg"], json!(row.theta_c_deg));
        // Each tenth frame shows it.
        if index % 10 == 0 {
            let DecodingResult::U16(pixels) = decoder.read_image().unwrap() else {
                panic!("the pixels are not 16-bit");
            };
            assert_eq!(pixels, series.read(index).unwrap().pixels_dn());
        }
        assert_eq!(decoder.more_images(), index + 1 < rows.len());
        if decoder.more_images() {
            decoder.next_image().unwrap();
        }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_surface_of_a_fit_is_a_tensor_file_that_states_where_it_comes_from() {
    let (bench, router) = opened().await;
    imported(&router).await;
    let path = "/api/v1/scans/1/surface.bsdf";
    is_problem(&get(&router, path).await, 409, "no-fit");
    let paper = json!({ "scan_id": 1, "variant": "paper" }).to_string();
    let begun = post(&router, "/api/v1/fits", &paper).await;
    let fit = ended(&router, &begun).await;
    assert_eq!(fit["state"], "completed", "{fit}");
    let file = download(&router, path).await;
    assert_eq!(&file[..18], b"tensor_file\0\x01\x00\x0a\x00\x00\x00");
    let angle = &fit["parameters"]["theta_r_deg"]["value"];
    let angle = angle.as_f64().unwrap();
    let program = fit["build"].as_str().unwrap();
    assert!(program.starts_with("ridged 0.1.0 ("), "{program}");
    let origin = format!("scan 1, fit 1 (paper) by {program}; theta_r {angle:.4} deg");
    let text = String::from_utf8_lossy(&file[..4000]);
    assert!(text.contains(&origin), "{text}");
    let of_fit = download(&router, &format!("{path}?fit_id=1")).await;
    assert!(of_fit == file, "the newest fit is fit 1");
    let other = get(&router, &format!("{path}?fit_id=2")).await;
    is_problem(&other, 404, "not-found");
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_nexus_file_of_a_scan_is_hdf5_and_leaves_nothing_in_the_data_folder() {
    let (bench, router) = opened().await;
    imported(&router).await;
    let files = || {
        let entries = std::fs::read_dir(bench.lab.store().folder()).unwrap();
        let mut names: Vec<_> = entries.map(|entry| entry.unwrap().file_name()).collect();
        names.sort();
        names
    };
    let before = files();
    let asked = request("GET", "/api/v1/scans/1/scan.nxs").body(Body::empty());
    let answer = router.clone().oneshot(asked.unwrap()).await.unwrap();
    assert_eq!(answer.status(), 200);
    let length: usize = answer.headers()["content-length"]
        .to_str()
        .unwrap()
        .parse()
        .unwrap();
    let bytes = to_bytes(answer.into_body(), usize::MAX).await.unwrap();
    assert_eq!(bytes.len(), length);
    assert_eq!(&bytes[..8], b"\x89HDF\r\n\x1a\n");
    assert_eq!(files(), before);
    bench.end().await;
}

#[tokio::test]
async fn a_scan_that_does_not_exist_has_no_files() {
    let (_bench, router) = opened().await;
    for path in ["brdf.json", "frames.tif", "surface.bsdf", "scan.nxs"] {
        let refused = get(&router, &format!("/api/v1/scans/9/{path}")).await;
        is_problem(&refused, 404, "not-found");
    }
}
