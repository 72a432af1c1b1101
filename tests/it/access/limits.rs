//! What one peer may take, and what a request may bring.

use std::io::Write;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use serde_json::{Value, json};
use tokio::io::AsyncWriteExt;

use super::{Served, Serving, get, head, order, post};
use crate::bench_in_a_box::in_time;

#[tokio::test(flavor = "multi_thread")]
async fn six_hundred_streams_of_one_peer_leave_room_for_others() {
    let (served, _) = Served::new(Serving::default()).await;
    let mut open = Vec::new();
    let mut refused = 0;
    for _ in 0..600 {
        let mut stream = served.connect().await;
        let text = get("/api/v1/events").head(served.address, 0);
        stream.write_all(text.as_bytes()).await.unwrap();
        let reply = head(&mut stream).await;
        match reply.status {
            200 => open.push(stream),
            429 => refused += 1,
            _ => panic!("{reply:?}"),
        }
    }
    assert!(open.len() <= 64, "{}", open.len());
    assert_eq!(open.len() + refused, 600);
    served.ask(get("/api/v1/rig")).await.is_ok();
    served.ask(get("/healthz")).await.is_ok();
    served.ask(order("/api/v1/rig/stop")).await.is_ok();
    drop(open);
    served.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn unfinished_bodies_of_one_peer_are_bounded() {
    let (served, _) = Served::new(Serving::default()).await;
    let part = vec![b' '; 7 << 20];
    let unfinished = async || {
        let mut stream = served.connect().await;
        let text = post("/api/v1/fits", &json!({})).head(served.address, 8 << 20);
        stream.write_all(text.as_bytes()).await.unwrap();
        // The daemon may refuse and close before it has read everything.
        stream.write_all(&part).await.ok();
        stream
    };
    let mut open = Vec::new();
    // On a busy machine the daemon gives up on the first bodies before it has read the fifth.
    let refused = async {
        loop {
            open.clear();
            for _ in 0..4 {
                open.push(unfinished().await);
            }
            let mut fifth = unfinished().await;
            let wait = std::time::Duration::from_secs(2);
            if let Ok(reply) = tokio::time::timeout(wait, head(&mut fifth)).await {
                assert!(matches!(reply.status, 0 | 429), "{reply:?}");
                break;
            }
        }
    };
    in_time(refused).await;
    served.ask(get("/api/v1/rig")).await.is_ok();
    drop(open);
    served.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_long_note_is_refused() {
    let (served, _) = Served::new(Serving::default()).await;
    let material = json!({ "kind": "dielectric", "eta": 1.5 });
    let note =
        |length: usize| json!({ "name": "a", "material": material, "note": "n".repeat(length) });
    let refused = served.ask(post("/api/v1/samples", &note(4001))).await;
    refused.is(422, "invalid-value");
    assert_eq!(refused.json()["errors"][0]["field"], "note");
    served
        .ask(post("/api/v1/samples", &note(4000)))
        .await
        .is_ok();
    served.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_with_a_long_text_is_refused() {
    let (served, _) = Served::new(Serving::default()).await;
    let scene = |length: usize| {
        let flat = "[light]\ntheta_i_deg = 45.0\n[[interface]]\nshape = \"flat\"\nbelow = { n = 1.5 }\n[run]\nphotons = 10\n";
        json!({ "scene": format!("{flat}# {}", "n".repeat(length)) })
    };
    let refused = served.ask(post("/api/v1/traces", &scene(300_000))).await;
    refused.is(422, "invalid-value");
    assert!(refused.text.contains("expected at most"), "{refused:?}");
    let traced = served.ask(post("/api/v1/traces", &scene(200_000))).await;
    traced.is_ok();
    served.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_key_of_another_caller_returns_nothing_of_its_answer() {
    let (served, tokens) = Served::with_tokens().await;
    let sample = |name: &str, token: &str| {
        let sample = post("/api/v1/samples", &json!({ "name": name }));
        sample.by(token).with("idempotency-key", "the same")
    };
    let first = served.ask(sample("annas", &tokens.operator)).await;
    let again = served.ask(sample("annas", &tokens.operator)).await;
    assert_eq!(first.json(), again.json());
    let of_another = served.ask(sample("annas", &tokens.analyst)).await;
    assert_ne!(first.json()["id"], of_another.json()["id"]);
    // Not even that the key was used.
    served.ask(sample("berts", &tokens.admin)).await.is_ok();
    let other = served.ask(sample("berts", &tokens.operator)).await;
    other.is(422, "idempotency-mismatch");
    served.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn imports_keep_to_their_roots_whatever_links_and_steps_say() {
    let at = tempfile::tempdir().unwrap();
    let (inside, outside) = (at.path().join("in"), at.path().join("out"));
    for folder in [&inside, &outside] {
        std::fs::create_dir_all(folder).unwrap();
        std::fs::write(folder.join("secret.txt"), "word").unwrap();
    }
    std::os::unix::fs::symlink(&outside, inside.join("link")).unwrap();
    let (served, _) = Served::new(Serving {
        roots: vec![inside.clone()],
        ..Serving::default()
    })
    .await;
    let import = async |folder: &str| {
        let body = json!({ "folder": folder });
        served.ask(post("/api/v1/imports", &body)).await
    };
    let text = |path: &std::path::Path| path.to_str().unwrap().to_owned();
    for folder in [
        text(&outside),
        text(&inside.join("link")),
        format!("{}/../out", text(&inside)),
        "/etc".into(),
        "/root".into(),
        "/no/such/folder".into(),
    ] {
        let refused = import(&folder).await;
        refused.is(422, "invalid-value");
        assert!(refused.text.contains("import.roots"), "{refused:?}");
    }
    import(&text(&inside)).await.is(422, "series-invalid");
    served.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_frame_that_is_a_link_out_of_its_series_is_refused() {
    let source = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/series/polymer-10");
    let at = tempfile::tempdir().unwrap();
    let series = at.path().join("series");
    std::fs::create_dir_all(series.join("frames")).unwrap();
    for file in ["manifest.toml", "frames.csv"] {
        std::fs::copy(format!("{source}/{file}"), series.join(file)).unwrap();
    }
    for frame in std::fs::read_dir(format!("{source}/frames")).unwrap() {
        let frame = frame.unwrap();
        let link = series.join("frames").join(frame.file_name());
        std::os::unix::fs::symlink(frame.path(), link).unwrap();
    }
    let (served, _) = Served::new(Serving {
        roots: vec![at.path().to_owned()],
        ..Serving::default()
    })
    .await;
    let body = json!({ "folder": series });
    let refused = served.ask(post("/api/v1/imports", &body)).await;
    assert_eq!(refused.status, 422, "{refused:?}");
    assert!(
        refused.text.contains("link out of the folder"),
        "{refused:?}"
    );
    served.end().await;
}

/// A scene whose only interface has this height file.
fn scene(path: &str) -> Value {
    let interface = json!({
        "shape": "file", "path": path, "pitch_um": 1.0, "height_unit_um": 1.0, "below": { "n": 1.5 },
    });
    json!({
        "light": { "theta_i_deg": 45.0, "phi_i_deg": 0.0, "wavelength_nm": 550.0, "stokes": [1.0, 0.0, 0.0, 0.0] },
        "interface": [interface],
    })
}

#[tokio::test(flavor = "multi_thread")]
async fn names_of_uploads_lead_nowhere() {
    let (served, _) = Served::new(Serving::default()).await;
    for name in ["../../daemon.json", "/etc/passwd", "a/b.csv", "..", ""] {
        let content = STANDARD.encode("0,1\n1,0\n");
        let mut files = serde_json::Map::new();
        files.insert(name.to_owned(), json!(content));
        let body = json!({ "scene": scene(name), "files": files });
        let refused = served.ask(post("/api/v1/traces", &body)).await;
        assert_eq!(refused.status, 422, "{name}: {refused:?}");
    }
    // A scene names no file of the daemon's machine.
    let body = json!({ "scene": scene("/etc/passwd") });
    let refused = served.ask(post("/api/v1/traces", &body)).await;
    assert_eq!(refused.status, 422, "{refused:?}");
    assert!(!refused.text.contains("root:"), "{refused:?}");
    for path in [
        "/api/v1/maps/1/files/..%2F..%2Fdaemon.json",
        "/api/v1/maps/1/files/../../../daemon.json",
        "/assets/../../Cargo.toml",
        "/..%2f..%2fetc/passwd",
    ] {
        let refused = served.ask(get(path)).await;
        assert!((400..500).contains(&refused.status), "{path}: {refused:?}");
    }
    served.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_zip_bomb_is_refused() {
    let options = zip::write::SimpleFileOptions::default();
    let mut archive = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    archive.start_file("main.xml", options).unwrap();
    let zeros = vec![b' '; 1 << 20];
    for _ in 0..512 {
        archive.write_all(&zeros).unwrap();
    }
    let bomb = archive.finish().unwrap().into_inner();
    assert!(bomb.len() < 2 << 20);
    let (served, _) = Served::new(Serving::default()).await;
    let files = json!({ "bomb.x3p": STANDARD.encode(&bomb) });
    let body = json!({ "scene": scene("bomb.x3p"), "files": files });
    let refused = served.ask(post("/api/v1/traces", &body)).await;
    assert_eq!(refused.status, 422, "{refused:?}");
    served.ask(get("/api/v1/rig")).await.is_ok();
    served.end().await;
}
