//! Demo, import and export to their end, and ended by Ctrl-C.

use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Command, Output, Stdio};

use serde_json::Value;

use super::{Daemon, refuses, ridged};

#[test]
fn the_demo_prints_the_truth_beside_the_fit() {
    let folder = tempfile::tempdir().unwrap();
    let mut demo = Command::new(env!("CARGO_BIN_EXE_ridged"))
        .args([
            "demo",
            "--once",
            "--json",
            "--seed",
            "3",
            "--azimuth-offset-deg",
            "7",
        ])
        .args(["--tilt-offset-deg", "0.4", "--time-scale", "50"])
        .current_dir(folder.path())
        .env("RIDGED_LOG", "off")
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut text = String::new();
    demo.stdout
        .take()
        .unwrap()
        .read_to_string(&mut text)
        .unwrap();
    assert!(demo.wait().unwrap().success());
    let shown: Value = serde_json::from_str(&text).unwrap();
    // Cost and left_out have the same keys as in every command.
    assert!(shown["seconds"].as_f64().unwrap() > 0.0);
    assert!(!shown["left_out"].as_array().unwrap().is_empty());
    for key in [
        "theta_r_deg",
        "alpha_u",
        "alpha_v",
        "rho_d",
        "azimuth_offset_deg",
        "tilt_offset_deg",
    ] {
        let truth = shown["truth"][key].as_f64().unwrap();
        let parameter = &shown["fit"]["parameters"][key];
        let value = parameter["value"].as_f64().unwrap();
        let expanded = parameter["expanded"].as_f64().unwrap();
        assert!(
            (value - truth).abs() <= expanded,
            "{key}: {value} ± {expanded}, true {truth}"
        );
    }
}

/// Starts a command, presses Ctrl-C once `begun` says so, and gives its exit code and its stdout.
fn interrupted(
    folder: &Path,
    args: &[&str],
    begun: impl Fn(&mut BufReader<std::process::ChildStderr>) -> bool,
) -> (Option<i32>, String) {
    let mut child = Command::new(env!("CARGO_BIN_EXE_ridged"))
        .args(args)
        .current_dir(folder)
        .env("RIDGED_LOG", "ridged=info")
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut reported = BufReader::new(child.stderr.take().unwrap());
    while !begun(&mut reported) {
        assert!(matches!(child.try_wait(), Ok(None)), "{args:?} has ended");
        std::thread::yield_now();
    }
    let process = rustix::process::Pid::from_child(&child);
    rustix::process::kill_process(process, rustix::process::Signal::INT).unwrap();
    // Both ends are read, so that the command is not held up by what it says.
    std::io::copy(&mut reported, &mut std::io::sink()).unwrap();
    let output = child.wait_with_output().unwrap();
    (
        output.status.code(),
        String::from_utf8(output.stdout).unwrap(),
    )
}

/// Whether there is a file anywhere below a folder.
pub(crate) fn holds_a_file(folder: &Path) -> bool {
    let files = std::fs::read_dir(folder).into_iter().flatten().flatten();
    files
        .map(|file| file.path())
        .any(|path| !path.is_dir() || holds_a_file(&path))
}

#[test]
fn a_zip_archive_is_imported_with_and_without_a_daemon() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    std::fs::write(at.join("part 7.zip"), crate::http::uploads::archive(6)).unwrap();
    std::fs::write(at.join("note.txt"), "no archive").unwrap();
    let import = |file| ridged(at, &["import", file, "--data", "data", "--json"]);
    let wrong = ["import", "note.txt", "--data", "data"];
    refuses(at, &wrong, 2, &["note.txt", "neither a folder nor a zip"]);
    assert!(!at.join("data").exists());
    let answer = |output: Output| -> Value { serde_json::from_slice(&output.stdout).unwrap() };
    let alone = answer(import("part 7.zip"));
    assert_eq!(
        (&alone["scan_id"], &alone["n_frames"]),
        (&1.into(), &6.into())
    );
    let daemon = Daemon::start(at, &[]);
    let by_daemon = answer(import("part 7.zip"));
    assert_eq!(by_daemon["scan_id"], 2);
    assert_eq!(by_daemon["same_as_scan_id"], 1);
    refuses(at, &wrong, 2, &["note.txt", "pack the folder"]);
    drop(daemon);
}

#[test]
fn ctrl_c_ends_an_import_and_an_export_with_130_and_nothing_half_done() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let series = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/series/polymer-10");
    let import = ["import", series.to_str().unwrap(), "--data", "data"];
    let frames = at.join("data/frames");
    let (code, _) = interrupted(at, &import, |_| holds_a_file(&frames));
    assert_eq!(code, Some(130));
    assert!(!holds_a_file(&frames));
    assert!(ridged(at, &import).status.success());
    let export = ["export", "--scan", "1", "--out", "out", "--data", "data"];
    let begun = |file: std::fs::DirEntry| file.file_name().to_string_lossy().starts_with(".out-");
    let half_done = || std::fs::read_dir(at).unwrap().flatten().any(begun);
    let (code, _) = interrupted(at, &export, |_| half_done());
    assert_eq!(code, Some(130));
    assert!(!half_done() && !at.join("out").exists());
    assert!(ridged(at, &export).status.success());
    assert!(at.join("out/manifest.toml").is_file());
}

#[test]
fn a_demo_that_is_ended_before_its_answer_exits_with_130() {
    let folder = tempfile::tempdir().unwrap();
    let demo = ["demo", "--once", "--json", "--data", "data"];
    let (code, out) = interrupted(folder.path(), &demo, |reported| {
        let mut line = String::new();
        reported.read_line(&mut line).unwrap();
        line.contains("is running")
    });
    assert_eq!((code, out.as_str()), (Some(130), ""));
}
