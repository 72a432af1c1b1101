//! What monitors see of a daemon, and how often it decodes a frame.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::Duration;

use super::Daemon;

#[test]
fn monitors_see_scans_frames_the_line_and_requests_by_a_few_names() {
    let folder = tempfile::tempdir().unwrap();
    let mut daemon = Daemon::start(folder.path(), &["--simulated-rig", "--time-scale", "50"]);
    let begun = daemon.post("/scans", r#"{"sample_id": 2, "plan": {"preset": "paper"}}"#);
    assert_eq!(begun.0, 202, "{}", begun.1);
    // Orders that come when the scan has ended are refused, which does not matter here.
    daemon.follow(|daemon, event| match event["type"].as_str() {
        Some("scan") if event["state"] == "waiting-for-operator" => {
            daemon.post("/scans/1/continue", "");
            true
        }
        Some("frame") => {
            daemon.post("/scans/1/abort", "");
            true
        }
        _ => event["state"] != "aborted",
    });
    let host = daemon.url.strip_prefix("http://").unwrap().to_owned();
    for method in ["BREW", "WHISK"] {
        let mut stream = TcpStream::connect(&host).unwrap();
        write!(
            stream,
            "{method} /healthz HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n"
        )
        .unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        assert!(answer.starts_with("HTTP/1.1 405"), "{answer}");
    }
    let (status, text) = daemon.bytes("/metrics");
    assert_eq!(status, 200);
    let text = String::from_utf8(text).unwrap();
    let value = |name: &str| -> f64 {
        let line = text.lines().find(|line| line.starts_with(name));
        let line = line.unwrap_or_else(|| panic!("no {name} in\n{text}"));
        line.rsplit(' ').next().unwrap().parse().unwrap()
    };
    assert_eq!(value("ridged_scan_states_total{state=\"aborted\"}"), 1.0);
    assert!(value("ridged_frames_total{accepted=\"true\"}") >= 1.0);
    assert!(value("ridged_stage_line_total{what=\"exchange\"}") > 10.0);
    assert_eq!(
        value("ridged_http_requests_total{method=\"other\",status=\"405\"}"),
        2.0
    );
    assert!(!text.contains("BREW"));
    // Every metric says what it is.
    let kinds = text
        .lines()
        .filter(|line| line.starts_with("# TYPE"))
        .count();
    let helps = text
        .lines()
        .filter(|line| line.starts_with("# HELP"))
        .count();
    assert_eq!(kinds, helps, "{text}");
    assert!(daemon.terminate().success());
}

#[test]
fn every_frame_is_decoded_once_for_a_scan_and_all_its_answers() {
    let folder = tempfile::tempdir().unwrap();
    let mut daemon = Daemon::start(folder.path(), &["--simulated-rig", "--time-scale", "20"]);
    let decoded = |daemon: &Daemon| -> f64 {
        let text = String::from_utf8(daemon.bytes("/metrics").1).unwrap();
        let line = text
            .lines()
            .find(|line| line.starts_with("ridged_frames_decoded_total"));
        line.map_or(0.0, |line| {
            line.rsplit(' ').next().unwrap().parse().unwrap()
        })
    };
    let begun = daemon.post("/scans", r#"{"sample_id": 2, "plan": {"preset": "paper"}}"#);
    assert_eq!(begun.0, 202, "{}", begun.1);
    let mut frames = 0.0;
    daemon.follow(|daemon, event| match event["type"].as_str() {
        Some("scan") if event["state"] == "waiting-for-operator" => {
            daemon.post("/scans/1/continue", "");
            true
        }
        Some("frame") => {
            frames += 1.0;
            true
        }
        _ => event["state"] != "completed",
    });
    // The live fit has read what was there when it looked.
    assert!(decoded(&daemon) > 0.0);
    let specification = r#"{"name": "part", "limits": {"theta_r_deg": {"lower": 5, "upper": 15}}}"#;
    let verdict = format!(r#"{{"scan_id": 1, "specification": {specification}}}"#);
    let scan = r#"{"scan_id": 1}"#;
    for (kind, request) in [
        ("fits", scan),
        ("contrasts", scan),
        ("verdicts", &verdict),
        ("fits", scan),
    ] {
        let (status, mut answer) = daemon.post(&format!("/{kind}"), request);
        assert_eq!(status, 202, "{answer}");
        let path = format!("/{kind}/{}", answer["id"]);
        while answer["state"] == "running" {
            std::thread::sleep(Duration::from_millis(50));
            answer = daemon.get(&path).1;
        }
        assert_eq!(answer["state"], "completed", "{answer}");
        // Each frame is used, so each was decoded; the total shows that none was decoded twice.
        if kind == "fits" {
            assert_eq!(
                answer["n_frames_used"].as_f64().unwrap(),
                frames,
                "{answer}"
            );
        }
        assert_eq!(decoded(&daemon), frames, "{kind}");
    }
    assert_eq!(daemon.get("/scans/1/observations").0, 200);
    assert_eq!(decoded(&daemon), frames);
    // After another start the sums are in the store.
    assert!(daemon.terminate().success());
    let mut daemon = Daemon::start(folder.path(), &["--simulated-rig"]);
    let contrast = daemon.post("/contrasts", scan).1;
    let path = format!("/contrasts/{}", contrast["id"]);
    while daemon.get(&path).1["state"] == "running" {
        std::thread::sleep(Duration::from_millis(50));
    }
    assert_eq!(daemon.get(&path).1["state"], "completed");
    assert_eq!(decoded(&daemon), 0.0);
    assert!(daemon.terminate().success());
}
