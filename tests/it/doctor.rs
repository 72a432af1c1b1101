//! `ridged doctor` and the service manager, by the program itself.

use std::os::unix::net::UnixDatagram;
use std::path::Path;
use std::process::{Command, Output};
use std::time::Duration;

use serde_json::Value;

use crate::bench_in_a_box::BenchInABox;
use crate::commands::Daemon;

fn doctor(at: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_ridged"))
        .args(["doctor", "--data", "data"])
        .args(args)
        .current_dir(at)
        .env("RIDGED_LOG", "off")
        .output()
        .unwrap()
}

/// The findings of a check, each as severity and text, and the exit code, which the JSON states too.
fn findings(output: &Output) -> (i32, Vec<(String, String, String)>) {
    let answer: Value = serde_json::from_slice(&output.stdout)
        .unwrap_or_else(|e| panic!("{e}: {}", String::from_utf8_lossy(&output.stderr)));
    let code = output.status.code().unwrap();
    assert_eq!(answer["exit_code"], code, "{answer:#}");
    let text = |value: &Value| value.as_str().unwrap().to_owned();
    let all = answer["findings"].as_array().unwrap().iter();
    let all = all.map(|f| (text(&f["check"]), text(&f["severity"]), text(&f["found"])));
    (code, all.collect())
}

fn has(found: &[(String, String, String)], check: &str, severity: &str, words: &str) -> bool {
    let is_it =
        |f: &&(String, String, String)| f.0 == check && f.1 == severity && f.2.contains(words);
    found.iter().any(|f| is_it(&f))
}

#[test]
fn a_simulated_rig_passes_with_a_dark_and_a_lit_frame_and_nothing_moves() {
    let folder = tempfile::tempdir().unwrap();
    let args = ["--simulated-rig", "--frames", "--json"];
    let (code, found) = findings(&doctor(folder.path(), &args));
    // A machine without a time server gives a warning.
    assert!(
        code == 0 || has(&found, "clock", "warning", "time server"),
        "{found:#?}"
    );
    for (check, severity, words) in [
        ("stages", "ok", "serial number"),
        ("stages", "note", "has no reference"),
        ("camera", "ok", "dark frame: "),
        ("camera", "ok", "lit frame: "),
        ("folder", "note", "does not exist"),
        ("daemon", "note", "none runs"),
    ] {
        assert!(
            has(&found, check, severity, words),
            "{check} {words}: {found:#?}"
        );
    }
    assert!(!found.iter().any(|f| f.1 == "fault"), "{found:#?}");
}

#[test]
fn a_missing_port_and_a_missing_program_are_faults_with_the_way_out() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    std::fs::create_dir(at.join("frames")).unwrap();
    let config = crate::commands::example("/dev/serial/by-id/none-there", &at.join("frames"));
    let config = format!("{config}\n").replace("[hooks]", "[hooks]\npaused = [\"/no/such/mail\"]");
    std::fs::write(at.join("rig.toml"), config).unwrap();
    let output = doctor(at, &["--config", "rig.toml"]);
    assert_eq!(output.status.code(), Some(4));
    let text = String::from_utf8(output.stdout).unwrap();
    for part in [
        "none-there",
        "does not exist",
        "hooks.paused: `/no/such/mail`",
        "faults",
    ] {
        assert!(text.contains(part), "{part}: {text}");
    }
    let refused = doctor(at, &["--config", "missing.toml"]);
    assert_eq!(refused.status.code(), Some(2));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_changed_frame_is_found_by_its_hash_and_a_daemon_is_asked_about_its_rig() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    let disk = std::sync::Arc::new(ridged::store::disk::RealDisk);
    let bench = BenchInABox::open(&data, disk, true).await;
    let scan = bench
        .start(crate::bench_in_a_box::small(&[0.0], &[0.0]))
        .await;
    bench.finish(scan.id).await;
    let frame = bench
        .lab
        .store()
        .newest_frame(scan.id)
        .await
        .unwrap()
        .unwrap();
    let path = bench.lab.store().frame_path(&frame.sha256);
    bench.end().await;
    let at = folder.path().to_owned();
    let checking = tokio::task::spawn_blocking(move || {
        let (_, found) = findings(&doctor(&at, &["--deep", "--json"]));
        assert!(
            has(&found, "frames", "ok", "as their rows state"),
            "{found:#?}"
        );
        assert!(has(&found, "database", "ok", "integrity"), "{found:#?}");
        assert!(has(&found, "disk", "ok", "durable"), "{found:#?}");

        let mut content = std::fs::read(&path).unwrap();
        content[100] ^= 4;
        std::fs::write(&path, &content).unwrap();
        // A size does not show it.
        let (_, found) = findings(&doctor(&at, &["--json"]));
        assert!(has(&found, "frames", "ok", "--deep compares"), "{found:#?}");
        let (code, found) = findings(&doctor(&at, &["--deep", "--json"]));
        assert!(
            has(&found, "frames", "fault", "its hash differs"),
            "{found:#?}"
        );
        assert_eq!(code, 4);
        content[100] ^= 4;
        std::fs::write(&path, &content).unwrap();

        let mut daemon = Daemon::start(&at, &["--simulated-rig"]);
        let (_, found) = findings(&doctor(&at, &["--deep", "--frames", "--json"]));
        assert!(has(&found, "daemon", "ok", "is ready"), "{found:#?}");
        assert!(
            has(&found, "stages", "ok", "the daemon has them"),
            "{found:#?}"
        );
        assert!(has(&found, "camera", "note", "no effect"), "{found:#?}");
        assert!(
            has(&found, "frames", "ok", "as their rows state"),
            "{found:#?}"
        );
        assert!(daemon.terminate().success());
    });
    checking.await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn what_the_settings_ask_to_measure_again_is_a_warning_with_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    let disk = std::sync::Arc::new(ridged::store::disk::RealDisk);
    let bench = BenchInABox::open(&folder.path().join("data"), disk, false).await;
    bench.end().await;
    let at = folder.path().to_owned();
    let checking = tokio::task::spawn_blocking(move || {
        let (_, found) = findings(&doctor(&at, &["--json"]));
        assert!(!found.iter().any(|f| f.0 == "due"), "{found:#?}");
        let settings = "[due]\ncheck_standard = \"CS-1\"\ncheck_standard_every_days = 7.0\nreferences_every_days = 1.0\n";
        std::fs::write(at.join("rig.toml"), settings).unwrap();
        let (code, found) = findings(&doctor(&at, &["--config", "rig.toml", "--json"]));
        for words in [
            "check standard CS-1: never measured",
            "references: never taken",
        ] {
            assert!(has(&found, "due", "warning", words), "{words}: {found:#?}");
        }
        assert_eq!(code, 3, "{found:#?}");
        let text = doctor(&at, &["--config", "rig.toml"]).stdout;
        let text = String::from_utf8(text).unwrap();
        assert!(text.contains("ridged chart --part \"CS-1\""), "{text}");
        std::fs::write(at.join("rig.toml"), settings.replace("7.0", "0.0")).unwrap();
        let refused = doctor(&at, &["--config", "rig.toml"]);
        assert_eq!(refused.status.code(), Some(2));
        let message = String::from_utf8(refused.stderr).unwrap();
        assert!(
            message.contains("line 3: due.check_standard_every_days is 0"),
            "{message}"
        );
    });
    checking.await.unwrap();
}

#[test]
fn the_service_manager_learns_of_start_life_and_end() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("notify");
    let socket = UnixDatagram::bind(&path).unwrap();
    socket
        .set_read_timeout(Some(Duration::from_secs(60)))
        .unwrap();
    let mut program = Command::new(env!("CARGO_BIN_EXE_ridged"));
    program
        .env("NOTIFY_SOCKET", &path)
        .env("WATCHDOG_USEC", "300000");
    let mut daemon = Daemon::start_by(program, folder.path(), &["--simulated-rig"]);
    let next = || {
        let mut bytes = [0; 200];
        let n = socket.recv(&mut bytes).unwrap();
        String::from_utf8_lossy(&bytes[..n]).trim().to_owned()
    };
    assert_eq!(next(), "READY=1");
    assert_eq!([next(), next()], ["WATCHDOG=1", "WATCHDOG=1"]);
    assert!(daemon.terminate().success());
    loop {
        match next().as_str() {
            "WATCHDOG=1" => {}
            other => return assert_eq!(other, "STOPPING=1"),
        }
    }
}
