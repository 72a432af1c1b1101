//! The program itself: exit codes and messages.

use std::path::Path;
use std::process::{Command, Output, Stdio};

use serde_json::Value;

mod daemon;
mod ended_early;
mod metrics;

pub(crate) use daemon::Daemon;
pub(crate) use ended_early::holds_a_file;

pub(crate) fn ridged(folder: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_ridged"))
        .args(args)
        .current_dir(folder)
        .env("RIDGED_LOG", "off")
        .stdin(Stdio::null())
        .output()
        .unwrap()
}

/// Asserts an exit code and that the message names all of `words`.
pub(crate) fn refuses(folder: &Path, args: &[&str], code: i32, words: &[&str]) {
    let output = ridged(folder, args);
    let message = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(code), "{args:?}: {message}");
    assert!(output.stdout.is_empty(), "{args:?}");
    for word in words {
        assert!(
            message.contains(word),
            "{args:?}: `{word}` is not in: {message}"
        );
    }
    assert!(!message.contains("panicked"), "{message}");
}

pub(crate) fn example(port: &str, camera: &Path) -> String {
    include_str!("../../ridged.example.toml")
        .lines()
        .map(|line| {
            if line.starts_with("port = ") {
                format!("port = \"{port}\"\n")
            } else if line.starts_with("folder = \"/var") {
                format!("folder = \"{}\"\n", camera.display())
            } else if line.starts_with("command = ") {
                "command = []\n".into()
            } else {
                format!("{line}\n")
            }
        })
        .collect()
}

#[test]
fn bad_input_exits_2_and_says_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let write = |name: &str, text: &str| std::fs::write(at.join(name), text).unwrap();
    write("garbled.toml", "\u{1}\u{2}[[[");
    refuses(
        at,
        &["serve", "--config", "garbled.toml"],
        2,
        &["garbled.toml", "line 1"],
    );
    write("unknown.toml", "[camera]\nwidht_px = 3\n");
    refuses(
        at,
        &["serve", "--config", "unknown.toml"],
        2,
        &["unknown.toml", "line 2", "widht_px", "width_px"],
    );
    refuses(at, &["serve", "--config", "none.toml"], 2, &["none.toml"]);
    refuses(
        at,
        &["serve", "--listen", "0.0.0.0:0"],
        2,
        &["access control", "SSH"],
    );
    refuses(at, &["serve", "--listen", "here"], 2, &["127.0.0.1:8787"]);
    write("far.toml", "theta_c_deg = [0, 75]\nphi_s_deg = [0]\n");
    refuses(
        at,
        &["scan", "far.toml", "--simulated-rig", "--data", "d"],
        2,
        &["plan.theta_c_deg[1]", "75", "60"],
    );
    write("nan.toml", "theta_c_deg = [nan]\nphi_s_deg = []\n");
    refuses(
        at,
        &["scan", "nan.toml", "--simulated-rig", "--data", "d"],
        2,
        &["plan.theta_c_deg[0]", "finite", "plan.phi_s_deg"],
    );
    write("typo.toml", "preset = \"paper\"\nexposure = 1\n");
    refuses(
        at,
        &["scan", "typo.toml", "--simulated-rig", "--data", "d"],
        2,
        &["typo.toml", "exposure", "exposures_s"],
    );
    refuses(
        at,
        &["scan", "--preset", "paper", "--data", "d2"],
        2,
        &["ridged serve", "--config"],
    );
    std::fs::create_dir(at.join("empty")).unwrap();
    refuses(
        at,
        &["import", "empty", "--data", "d3"],
        2,
        &["manifest.toml"],
    );
    assert!(!at.join("d3").exists(), "a refused import leaves no store");
    refuses(
        at,
        &["export", "--scan", "1", "--out", "o", "--data", "d3"],
        2,
        &["no store"],
    );
    refuses(
        at,
        &["fit", "empty", "--store"],
        2,
        &["--store needs --scan N", "ridged import"],
    );
    refuses(
        at,
        &["fit", "--scan", "1", "--data", "d3"],
        2,
        &["no store"],
    );
}

#[test]
fn more_shards_than_a_run_has_parts_are_refused_and_leave_no_pictures() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let scene = "[[interface]]\nshape = \"flat\"\nbelow = { n = 1.5 }\n[run]\nphotons = 1000\n";
    std::fs::write(at.join("flat.toml"), scene).unwrap();
    // A run has 64 parts.
    let empty = [
        "trace",
        "flat.toml",
        "--shard",
        "100/200",
        "--pictures",
        "p",
    ];
    refuses(at, &empty, 2, &["100/200", "at most 64 shards"]);
    let left = std::fs::read_dir(at.join("p")).map_or(0, Iterator::count);
    assert_eq!(left, 0);
    let full = ["trace", "flat.toml", "--shard", "1/2", "--pictures", "p"];
    assert_eq!(ridged(at, &full).status.code(), Some(0));
    assert!(std::fs::read_dir(at.join("p")).unwrap().count() > 0);
}

#[test]
fn a_truncated_frame_is_named_and_nothing_is_imported() {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/series/polymer-10");
    let folder = tempfile::tempdir().unwrap();
    let series = folder.path().join("series");
    std::fs::create_dir_all(series.join("frames")).unwrap();
    std::fs::copy(source.join("manifest.toml"), series.join("manifest.toml")).unwrap();
    let list = std::fs::read_to_string(source.join("frames.csv")).unwrap();
    let sample = list.lines().find(|line| line.contains(",sample,"));
    let few: Vec<&str> = list.lines().take(3).chain(sample).collect();
    std::fs::write(series.join("frames.csv"), few.join("\n") + "\n").unwrap();
    for line in &few[1..] {
        let file = line.split(',').next().unwrap();
        std::fs::copy(source.join(file), series.join(file)).unwrap();
    }
    let broken = few[2].split(',').next().unwrap();
    let bytes = std::fs::read(series.join(broken)).unwrap();
    std::fs::write(series.join(broken), &bytes[..bytes.len() / 2]).unwrap();
    refuses(
        folder.path(),
        &["import", "series"],
        2,
        &[broken, "--skip-unreadable"],
    );
    let output = ridged(
        folder.path(),
        &["import", "series", "--skip-unreadable", "--json"],
    );
    let answer: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(answer["n_frames"], 2);
    assert!(answer["skipped"][0].as_str().unwrap().contains(broken));
}

#[test]
fn a_port_that_is_missing_exits_1_and_is_503_to_a_client() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let camera = at.join("frames");
    std::fs::create_dir(&camera).unwrap();
    let config = example("/dev/serial/by-id/none-there", &camera);
    std::fs::write(at.join("rig.toml"), config).unwrap();
    let mut daemon = Daemon::start(at, &["--config", "rig.toml"]);
    let sample = daemon.post(
        "/samples",
        r#"{"name": "s", "material": {"kind": "dielectric", "eta": 1.5, "eta_std": 0.01}}"#,
    );
    assert_eq!(sample.0, 201, "{}", sample.1);
    let refused = daemon.post("/scans", r#"{"sample_id": 1, "plan": {"preset": "paper"}}"#);
    assert_eq!(
        (refused.0, &refused.1["code"]),
        (503, &"port-missing".into())
    );
    assert_eq!(daemon.get("/rig").1["connected"], false);
    assert_eq!(daemon.get_at("/readyz").0, 503);
    // Asked of the daemon, the command says the same.
    refuses(
        at,
        &["scan", "--preset", "paper", "--data", "data"],
        1,
        &["none-there"],
    );
    assert!(daemon.terminate().success());
    // And by itself too.
    refuses(
        at,
        &[
            "scan", "--preset", "paper", "--data", "data", "--config", "rig.toml",
        ],
        1,
        &["none-there"],
    );
}

#[test]
fn names_that_the_daemon_does_not_know_are_new() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let mut daemon = Daemon::start(at, &["--simulated-rig"]);
    let specification = "name = \"lid\"\n[limits]\nalpha_u = { upper = 0.2 }\n";
    for (noun, text) in [
        ("recipe", "name = \"px\"\n[plan]\npreset = \"paper\"\n"),
        ("specification", specification),
    ] {
        std::fs::write(at.join("new.toml"), text).unwrap();
        let saved = ridged(at, &[noun, "save", "new.toml", "--data", "data"]);
        let said = String::from_utf8_lossy(&saved.stdout);
        assert!(
            saved.status.success() && said.contains("version 1"),
            "{saved:?}"
        );
    }
    // A part needs a material.
    let scan = [
        "scan", "--preset", "paper", "--sample", "B-17", "--data", "data",
    ];
    refuses(at, &scan, 2, &["there is no part `B-17`"]);
    assert!(daemon.terminate().success());
}
