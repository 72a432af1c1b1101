//! Previews before a scan, and pictures of stored frames.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use axum::body::{Body, to_bytes};
use axum::http::header;
use futures::future::BoxFuture;
use ridged::bench::{Camera, CameraError, CaptureRequest, Captured};
use ridged::frame::Frame;
use ridged::lab::RigParts;
use ridged::program::Program;
use ridged::scan::{Event, ScanState};
use ridged::store::disk::RealDisk;
use serde_json::{Value, json};
use tower::ServiceExt;

use super::{Answer, download, get, imported, is_problem, opened, post, request, router_of};
use crate::bench_in_a_box::{BenchInABox, in_time};

const PREVIEW: &str = "/api/v1/rig/preview";

async fn preview(router: &Router, body: &Value) -> Answer {
    post(router, PREVIEW, &body.to_string()).await
}

async fn taken(router: &Router, body: &Value) -> Value {
    let answer = preview(router, body).await;
    assert_eq!(answer.status, 200, "{}", answer.body);
    answer.body
}

/// All files below a folder.
fn files(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        match path.is_dir() {
            true => found.extend(files(&path)),
            false => found.push(path),
        }
    }
    found.sort();
    found
}

async fn at_rest(router: &Router) {
    let waiting = async {
        while get(router, "/api/v1/rig").await.body["activity"] != "idle" {
            tokio::task::yield_now().await;
        }
    };
    in_time(waiting).await;
}

/// Runs a scan of one pose with these exposures to its end, with the steps of the operator.
async fn scanned(bench: &BenchInABox, router: &Router, exposures_s: &Value) -> Vec<Value> {
    let plan = json!({
        "theta_c_deg": [0], "phi_s_deg": [0], "exposures_s": exposures_s,
        "flat": { "exposures_s": [0.02] },
    });
    let body = json!({ "sample_id": 2, "plan": plan }).to_string();
    let begun = post(router, "/api/v1/scans", &body).await;
    assert_eq!(begun.status, 202, "{}", begun.body);
    let scan = begun.body["id"].as_i64().unwrap();
    assert_eq!(bench.finish(scan).await.state, ScanState::Completed);
    let path = format!("/api/v1/scans/{scan}/frames?kind=sample");
    let frames = get(router, &path).await.body;
    frames["items"].as_array().unwrap().clone()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_preview_shows_the_frame_at_the_present_pose_and_stores_nothing() {
    let (bench, router) = opened().await;
    // Connects the stages, which is recorded.
    get(&router, "/api/v1/rig").await;
    let folder = bench.lab.store().folder().to_owned();
    let events = async || bench.lab.store().events_after(0, 1000).await.unwrap().len();
    let (before, recorded) = (files(&folder), events().await);
    let view = taken(&router, &json!({ "exposures_s": [0.02, 0.06] })).await;
    assert_eq!(
        (&view["referenced"], &view["lamp"]),
        (&json!(false), &json!(true))
    );
    // No dark frames yet: the hot pixels are those without full neighbours.
    assert_eq!(view["defects_known"], false);
    let frames = view["frames"].as_array().unwrap();
    let mut hot = 0;
    for (frame, exposure_s) in frames.iter().zip([0.02, 0.06]) {
        assert_eq!(frame["exposure_s"], exposure_s);
        assert_eq!(frame["saturated_px"], 0, "{frame}");
        let histogram = frame["histogram"]["pixels"].as_array().unwrap();
        let pixels: u64 = histogram.iter().map(|n| n.as_u64().unwrap()).sum();
        hot = frame["defect_px"].as_u64().unwrap();
        assert_eq!(pixels + hot, 128 * 128);
        let png = download(&router, frame["image"]["path"].as_str().unwrap()).await;
        assert_eq!(&png[1..4], b"PNG");
        assert_eq!(png[24], 8, "bits of a pixel");
    }
    assert!(hot > 0, "the simulated camera has hot pixels");
    let level = |frame: &Value| frame["mean_dn"].as_f64().unwrap() - 200.0;
    let ratio = level(&frames[1]) / level(&frames[0]);
    assert!((2.9..3.1).contains(&ratio), "{ratio}");
    // The counts are those of the figures.
    let counts = download(&router, frames[0]["pixels"].as_str().unwrap()).await;
    let max = counts
        .as_chunks::<2>()
        .0
        .iter()
        .map(|b| u16::from_le_bytes(*b));
    let max = max.filter(|dn| *dn < 65_535).max().unwrap();
    assert_eq!(frames[0]["max_dn"], max);
    assert_eq!(files(&folder), before);
    assert_eq!(events().await, recorded);
    assert_eq!(get(&router, "/api/v1/scans").await.body["items"], json!([]));
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_suggestion_of_a_saturated_preview_gives_a_scan_without_saturated_frames() {
    let bench = BenchInABox::new().await;
    let router = router_of(&bench.lab);
    assert_eq!(post(&router, "/api/v1/rig/home", "").await.status, 202);
    // Homing ends far from the poses of a scan, which are brighter.
    for axis in ["theta_c", "phi_s"] {
        at_rest(&router).await;
        let path = format!("/api/v1/rig/axes/{axis}/move");
        let moving = post(&router, &path, r#"{"position_deg": 0}"#).await;
        assert_eq!(moving.status, 202, "{}", moving.body);
    }
    at_rest(&router).await;
    let area = json!({ "left_px": 32, "top_px": 32, "width_px": 64, "height_px": 64 });
    let view = taken(&router, &json!({ "exposures_s": [5.0], "area": area })).await;
    assert_eq!(view["referenced"], true);
    assert_eq!(view["area"], area);
    let frame = &view["frames"][0];
    assert!(frame["saturated_px"].as_u64().unwrap() > 2000, "{frame}");
    assert_eq!(frame["max_dn"], 65_535);
    let suggested = &view["suggestion"];
    assert_eq!(suggested["reason"], Value::Null, "{suggested}");
    let exposures = suggested["exposures_s"].as_array().unwrap();
    assert_eq!(exposures.len(), 1);
    assert!(exposures[0].as_f64().unwrap() < 5.0, "{suggested}");
    let frames = scanned(&bench, &router, &suggested["exposures_s"]).await;
    assert!(!frames.is_empty());
    // From now on dark frames name the defect pixels, and only they are full.
    let view = taken(&router, &json!({ "exposures_s": exposures, "suggest": 0 })).await;
    assert_eq!(view["defects_known"], true);
    assert_eq!(view["suggestion"], Value::Null);
    let now = &view["frames"][0];
    assert_eq!(now["saturated_px"], 0, "{now}");
    for frame in &frames {
        assert!(frame["saturated_px"].as_u64() <= now["defect_px"].as_u64());
    }
    let share = now["max_dn"].as_f64().unwrap() / 65_535.0;
    assert!((0.6..0.8).contains(&share), "{share}");
    // Two exposures in, two out.
    let view = taken(&router, &json!({ "exposures_s": [0.0001, 0.0002] })).await;
    let two = view["suggestion"]["exposures_s"].as_array().unwrap();
    let ratio = two[1].as_f64().unwrap() / two[0].as_f64().unwrap();
    assert!((2.7..=3.4).contains(&ratio), "{two:?}");
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_capped_lens_has_a_reason_instead_of_a_suggestion() {
    let (bench, router) = opened().await;
    bench.rig.world.cap_lens(true);
    let view = taken(&router, &json!({ "exposures_s": [0.02] })).await;
    assert_eq!(view["frames"][0]["focus"], Value::Null);
    assert_eq!(view["suggestion"]["exposures_s"], json!([]));
    let reason = view["suggestion"]["reason"].as_str().unwrap();
    assert!(reason.contains("check the lamp, the lens cap"), "{reason}");
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_scan_holds_the_camera_also_while_it_is_paused() {
    let (bench, router) = opened().await;
    let body = r#"{"sample_id": 2, "plan": {"preset": "paper"}}"#;
    assert_eq!(post(&router, "/api/v1/scans", body).await.status, 202);
    bench.until(1, ScanState::WaitingForOperator).await;
    for paused in [false, true] {
        if paused {
            let paused = post(&router, "/api/v1/scans/1/pause", "").await;
            assert_eq!(paused.status, 202, "{}", paused.body);
            bench.until(1, ScanState::Paused).await;
        }
        let busy = preview(&router, &json!({})).await;
        is_problem(&busy, 409, "busy");
        assert!(busy.detail().contains("scan 1"), "{}", busy.detail());
        assert_eq!(
            busy.body["holder"],
            json!({ "who": "local", "name": "scan 1", "until": null })
        );
    }
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_preview_ends_for_another_order() {
    let folder = tempfile::tempdir().unwrap();
    let endless = |mut parts: RigParts| {
        parts.rig.camera = Box::new(Endless);
        let run = |word: &str| Program::of(&[word.to_owned()], 5.0);
        (parts.settings.runner.lamp_on, parts.settings.lamp_off) = (run("true"), run("false"));
        parts
    };
    let disk = Arc::new(RealDisk);
    let bench = BenchInABox::open_as(folder.path(), disk, false, Duration::ZERO, endless).await;
    let router = router_of(&bench.lab);
    let ask = json!({ "lamp": true });
    let order = async {
        tokio::time::sleep(Duration::from_millis(300)).await;
        post(&router, "/api/v1/rig/home", "").await
    };
    // Two previews take turns, so the second one waits for the first. The order passes both.
    let (looking, waiting, home) =
        tokio::join!(preview(&router, &ask), preview(&router, &ask), order);
    assert_eq!(home.status, 202, "{}", home.body);
    for refused in [looking, waiting] {
        is_problem(&refused, 409, "busy");
    }
    // No client is left to read it in the answer.
    let is_lit =
        |event: &Event| matches!(event, Event::Alarm { code, .. } if code == "lamp-failed");
    let reported = async {
        loop {
            let events = bench.lab.store().events_after(0, 1000).await.unwrap();
            if events.iter().any(|recorded| is_lit(&recorded.event)) {
                break;
            }
            tokio::task::yield_now().await;
        }
    };
    in_time(reported).await;
    bench.end().await;
}

/// A camera whose frame never comes.
struct Endless;

impl Camera for Endless {
    fn describe(&self) -> String {
        "endless".into()
    }

    fn capture<'a>(
        &'a mut self,
        _: &'a CaptureRequest,
    ) -> BoxFuture<'a, Result<Captured, CameraError>> {
        Box::pin(std::future::pending())
    }
}

/// A camera on a rig whose lamp is lit while a file says so.
struct Lit {
    camera: Box<dyn Camera>,
    lamp: PathBuf,
}

impl Camera for Lit {
    fn describe(&self) -> String {
        self.camera.describe()
    }

    fn capture<'a>(
        &'a mut self,
        request: &'a CaptureRequest,
    ) -> BoxFuture<'a, Result<Captured, CameraError>> {
        Box::pin(async move {
            let mut request = request.clone();
            // No time, no light: what the lens sees without the lamp.
            if std::fs::read_to_string(&self.lamp).unwrap().trim() == "off" {
                request.exposure_s = 0.0;
            }
            self.camera.capture(&request).await
        })
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn the_lamp_is_on_for_the_frames_only_and_off_is_dark() {
    let folder = tempfile::tempdir().unwrap();
    let lamp = folder.path().join("lamp");
    std::fs::write(&lamp, "off").unwrap();
    let data = folder.path().join("data");
    let switch = |word: &str| {
        let script = format!("echo {word} > {}", lamp.display());
        Program::of(&["sh".into(), "-c".into(), script], 20.0)
    };
    let (on, off) = (switch("on"), switch("off"));
    let with_lamp = |parts: RigParts| {
        let RigParts {
            mut rig,
            mut settings,
        } = parts;
        settings.runner.lamp_on = on;
        settings.lamp_off = off;
        let camera = std::mem::replace(&mut rig.camera, Box::new(Endless));
        let lamp = lamp.clone();
        rig.camera = Box::new(Lit { camera, lamp });
        RigParts { rig, settings }
    };
    let disk = Arc::new(RealDisk);
    let bench = BenchInABox::open_as(&data, disk, false, Duration::ZERO, with_lamp).await;
    let router = router_of(&bench.lab);
    let body = |lamp: bool| json!({ "exposures_s": [0.02], "lamp": lamp, "suggest": 0 });
    let lit = taken(&router, &body(true)).await;
    assert_eq!(std::fs::read_to_string(&lamp).unwrap().trim(), "off");
    let dark = taken(&router, &body(false)).await;
    assert_eq!(dark["lamp"], false);
    let median = |view: &Value| view["frames"][0]["median_dn"].as_f64().unwrap();
    assert!((median(&dark) - 200.0).abs() <= 2.0, "{}", median(&dark));
    assert!(median(&lit) > 1000.0, "{}", median(&lit));
    bench.end().await;
    // A rig without the command says which setting makes it possible.
    let (bench, router) = opened().await;
    let refused = preview(&router, &body(false)).await;
    is_problem(&refused, 409, "no-lamp-switch");
    assert!(
        refused.detail().contains("lamp.off"),
        "{}",
        refused.detail()
    );
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_preview_that_cannot_be_taken_is_refused_by_the_field() {
    let (bench, router) = opened().await;
    for (body, says) in [
        (json!({ "exposures_s": [] }), "expected 1 to 8"),
        (
            json!({ "exposures_s": [0.1, -1.0] }),
            "exposures_s[1]: is -1 s",
        ),
        (json!({ "exposures_s": [40.0, 40.0] }), "80 s in all"),
        (json!({ "suggest": 3 }), "suggest: is 3"),
        (
            json!({ "area": { "left_px": 100, "top_px": 0, "width_px": 40, "height_px": 4 } }),
            "columns 100 to 140",
        ),
    ] {
        let refused = preview(&router, &body).await;
        is_problem(&refused, 422, "invalid-value");
        assert!(refused.detail().contains(says), "{}", refused.detail());
    }
    let slip = preview(&router, &json!({ "exposure": 1 })).await;
    is_problem(&slip, 400, "unknown-field");
    for path in [
        "/api/v1/rig/preview/99/image.png",
        "/api/v1/rig/preview/-1/pixels",
    ] {
        is_problem(&get(&router, path).await, 404, "not-found");
    }
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stored_frame_has_a_small_picture_that_is_kept_by_the_client() {
    let (bench, router) = opened().await;
    imported(&router).await;
    let ask = async |path: &str, known: Option<&str>| {
        let mut asked = request("GET", path);
        if let Some(known) = known {
            asked = asked.header("if-none-match", known);
        }
        let asked = asked.body(Body::empty()).unwrap();
        router.clone().oneshot(asked).await.unwrap()
    };
    let frames = get(&router, "/api/v1/scans/1/frames?kind=sample")
        .await
        .body;
    let of_frame = |rest: &str| format!("/api/v1/frames/{}/{rest}", frames["items"][50]["id"]);
    let path = &of_frame("preview.png?width=64");
    let answer = ask(path, None).await;
    assert_eq!(answer.status(), 200);
    let headers = answer.headers().clone();
    let header_of = |name: &str| headers[name].to_str().unwrap().to_owned();
    // Another data folder may be at this address later.
    assert_eq!(header_of("cache-control"), "private, no-cache");
    let (low, high): (f64, f64) = (
        header_of("x-low-dn").parse().unwrap(),
        header_of("x-high-dn").parse().unwrap(),
    );
    let png = to_bytes(answer.into_body(), usize::MAX).await.unwrap();
    let full = download(&router, &of_frame("image.png")).await;
    assert!(
        png.len() * 5 < full.len(),
        "{} of {}",
        png.len(),
        full.len()
    );
    let mut counts = Frame::from_png(&full).unwrap().pixels_dn().to_vec();
    counts.sort_unstable();
    let at = |share: f64| f64::from(counts[(share * counts.len() as f64) as usize]);
    assert!((at(0.0005)..=at(0.005)).contains(&low), "{low} DN");
    assert!((at(0.995)..=at(0.9995)).contains(&high), "{high} DN");
    // 128 columns in squares of two.
    assert_eq!(&png[16..24], [0, 0, 0, 64, 0, 0, 0, 64]);
    let again = ask(path, Some(&header_of("etag"))).await;
    assert_eq!(again.status(), 304);
    assert!(!again.headers().contains_key(header::CONTENT_LENGTH));
    let other = ask(&of_frame("preview.png"), Some(&header_of("etag"))).await;
    assert_eq!(other.status(), 200);
    let wide = get(&router, &of_frame("preview.png?width=4000")).await;
    is_problem(&wide, 422, "invalid-value");
    let none = get(&router, "/api/v1/frames/99999/preview.png").await;
    is_problem(&none, 404, "not-found");
    bench.end().await;
}
