//! The program itself: exit codes, messages, a kill in mid-scan.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;

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

#[test]
fn a_second_daemon_on_one_folder_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let mut daemon = Daemon::start(folder.path(), &["--simulated-rig"]);
    refuses(
        folder.path(),
        &[
            "serve",
            "--simulated-rig",
            "--listen",
            "127.0.0.1:0",
            "--data",
            "data",
        ],
        1,
        &["in use", "--data"],
    );
    assert!(daemon.terminate().success());
}

#[test]
fn a_daemon_that_may_open_few_files_hears_the_stop_among_many_connections() {
    let folder = tempfile::tempdir().unwrap();
    let mut shell = Command::new("sh");
    let program = env!("CARGO_BIN_EXE_ridged");
    shell.args(["-c", r#"ulimit -n 128; exec "$0" "$@""#, program]);
    let mut daemon = Daemon::start_by(shell, folder.path(), &["--simulated-rig"]);
    let address = daemon.url.strip_prefix("http://").unwrap().to_owned();
    let idle: Vec<TcpStream> = (0..300)
        .map(|_| TcpStream::connect(&address).unwrap())
        .collect();
    let stopped = daemon.post("/rig/stop", "");
    assert_eq!(stopped.0, 200, "{}", stopped.1);
    drop(idle);
    assert!(daemon.terminate().success());
}

#[test]
fn a_terminal_that_is_closed_ends_a_daemon_as_ctrl_c_does() {
    let folder = tempfile::tempdir().unwrap();
    // Under nohup, all programs that the tests start ignore the signal.
    let mut hears = Command::new("env");
    hears.args(["--default-signal=HUP", env!("CARGO_BIN_EXE_ridged")]);
    let mut daemon = Daemon::start_by(hears, folder.path(), &["--simulated-rig"]);
    let ended = daemon.end_by(rustix::process::Signal::HUP);
    assert!(ended.success(), "{ended}");
    // The rig is stopped and the notice taken away: it did not just fall over.
    assert!(!folder.path().join("data/daemon.json").exists());
}

#[test]
fn a_log_that_cannot_be_written_ends_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let mut shell = Command::new("sh");
    let program = env!("CARGO_BIN_EXE_ridged");
    // As a disk does that is full, and a terminal that was closed.
    shell.args([
        "-c",
        r#"RIDGED_LOG=debug exec "$0" "$@" 2>/dev/full"#,
        program,
    ]);
    let mut daemon = Daemon::start_by(shell, folder.path(), &["--simulated-rig"]);
    let added = daemon.post("/samples", r#"{"name": "part 17"}"#);
    assert_eq!(added.0, 201, "{}", added.1);
    let homing = daemon.post("/rig/axes/phi_s/home", "");
    assert_eq!(homing.0, 202, "{}", homing.1);
    let stopped = daemon.post("/rig/stop", "");
    assert_eq!(stopped.0, 200, "{}", stopped.1);
    let ended = daemon.terminate();
    assert!(ended.success(), "{ended}");
    assert!(!folder.path().join("data/daemon.json").exists());
}

#[test]
fn levels_of_the_log_that_are_not_valid_are_named_and_the_usual_ones_apply() {
    let said = |levels: &str| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_ridged"));
        command.args(["completions", "bash"]).stdout(Stdio::null());
        let output = command.env("RIDGED_LOG", levels).output().unwrap();
        assert!(output.status.success());
        String::from_utf8(output.stderr).unwrap()
    };
    assert_eq!(said("warn,ridged=debug"), "");
    let message = said("ridged=loud");
    assert!(message.contains("RIDGED_LOG=\"ridged=loud\""), "{message}");
    assert!(message.contains("The log uses warn\n"), "{message}");
}

#[test]
fn a_kill_in_mid_scan_leaves_every_committed_frame_and_the_scan_interrupted() {
    let folder = tempfile::tempdir().unwrap();
    let args = ["--simulated-rig", "--time-scale", "20"];
    let mut daemon = Daemon::start(folder.path(), &args);
    let begun = daemon.post("/scans", r#"{"sample_id": 2, "plan": {"preset": "full"}}"#);
    assert_eq!(begun.0, 202, "{}", begun.1);
    let mut frames = Vec::new();
    daemon.follow(|daemon, event| {
        match event["type"].as_str() {
            Some("scan") if event["state"] == "waiting-for-operator" => {
                assert_eq!(daemon.post("/scans/1/continue", "").0, 202);
            }
            Some("frame") => frames.push(event["frame_id"].as_i64().unwrap()),
            _ => {}
        }
        frames.len() < 60
    });
    daemon.child.kill().unwrap();
    daemon.child.wait().unwrap();

    let mut daemon = Daemon::start(folder.path(), &args);
    let scan = daemon.get("/scans/1").1;
    assert_eq!(scan["state"], "interrupted");
    // Every reported frame exists, and its file matches its row.
    for id in &frames {
        let (status, frame) = daemon.get(&format!("/frames/{id}"));
        assert_eq!(status, 200);
        let (status, png) = daemon.bytes(frame["image"].as_str().unwrap());
        assert_eq!(status, 200);
        assert_eq!(
            ridged::store::frames::sha256_hex(&png),
            frame["sha256"].as_str().unwrap()
        );
    }
    // And the scan can be taken up again.
    let resumed = daemon.post("/scans/1/resume", "");
    assert_eq!(resumed.0, 202, "{}", resumed.1);
    let aborted = daemon.post("/scans/1/abort", "");
    assert_eq!(aborted.0, 202, "{}", aborted.1);
    assert!(daemon.terminate().success());
}

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

/// A daemon as a process of its own.
pub(crate) struct Daemon {
    child: Child,
    pub(crate) url: String,
    /// Number of the last event seen by [`Daemon::follow`].
    last_event: i64,
}

impl Daemon {
    pub(crate) fn start(folder: &Path, args: &[&str]) -> Daemon {
        let program = Command::new(env!("CARGO_BIN_EXE_ridged"));
        Daemon::start_by(program, folder, args)
    }

    pub(crate) fn start_by(mut program: Command, folder: &Path, args: &[&str]) -> Daemon {
        program.env("RIDGED_LOG", "off");
        Daemon::start_with(program, folder, args)
    }

    /// Starts the daemon with its log as the command has it.
    pub(crate) fn start_with(mut program: Command, folder: &Path, args: &[&str]) -> Daemon {
        let data: PathBuf = folder.join("data");
        let mut child = program
            .args(["serve", "--listen", "127.0.0.1:0", "--data"])
            .arg(data)
            .args(args)
            .current_dir(folder)
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap())
            .read_line(&mut line)
            .unwrap();
        let url = line
            .trim()
            .strip_prefix("listening on ")
            .unwrap_or_else(|| panic!("the daemon says `{line}`"))
            .to_owned();
        Daemon {
            child,
            url,
            last_event: 0,
        }
    }

    fn agent() -> ureq::Agent {
        ureq::Agent::config_builder()
            .http_status_as_error(false)
            .build()
            .into()
    }

    fn bytes(&self, path: &str) -> (u16, Vec<u8>) {
        let mut answer = Daemon::agent()
            .get(format!("{}{path}", self.url))
            .call()
            .unwrap();
        let status = answer.status().as_u16();
        (status, answer.body_mut().read_to_vec().unwrap())
    }

    pub(crate) fn get_at(&self, path: &str) -> (u16, Value) {
        let (status, body) = self.bytes(path);
        (status, serde_json::from_slice(&body).unwrap())
    }

    pub(crate) fn get(&self, path: &str) -> (u16, Value) {
        self.get_at(&format!("/api/v1{path}"))
    }

    pub(crate) fn post(&self, path: &str, body: &str) -> (u16, Value) {
        let request = Daemon::agent().post(format!("{}/api/v1{path}", self.url));
        let mut answer = match body {
            "" => request.send_empty().unwrap(),
            body => request
                .header("content-type", "application/json")
                .send(body)
                .unwrap(),
        };
        let status = answer.status().as_u16();
        (status, answer.body_mut().read_json().unwrap())
    }

    /// Reads the events as they come, until `more` says that it has seen enough.
    fn follow(&mut self, mut more: impl FnMut(&Daemon, &Value) -> bool) {
        let host = self.url.strip_prefix("http://").unwrap().to_owned();
        let mut stream = TcpStream::connect(&host).unwrap();
        write!(
            stream,
            "GET /api/v1/events?since={} HTTP/1.1\r\nHost: {host}\r\n\r\n",
            self.last_event
        )
        .unwrap();
        let mut reader = BufReader::new(stream);
        let mut line = String::new();
        loop {
            line.clear();
            assert!(
                reader.read_line(&mut line).unwrap() > 0,
                "the events broke off"
            );
            if let Some(data) = line.strip_prefix("data: ") {
                let event: Value = serde_json::from_str(data).unwrap();
                self.last_event = event["id"].as_i64().unwrap();
                if !more(self, &event) {
                    return;
                }
            }
        }
    }

    /// Ends it as a service manager does.
    pub(crate) fn terminate(&mut self) -> std::process::ExitStatus {
        self.end_by(rustix::process::Signal::TERM)
    }

    pub(crate) fn end_by(&mut self, signal: rustix::process::Signal) -> std::process::ExitStatus {
        let pid = rustix::process::Pid::from_child(&self.child);
        rustix::process::kill_process(pid, signal).unwrap();
        let late = Instant::now() + Duration::from_secs(60);
        loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                return status;
            }
            assert!(Instant::now() < late, "{signal:?} does not end the daemon");
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        // A test that failed leaves nothing running.
        if matches!(self.child.try_wait(), Ok(None)) {
            self.child.kill().ok();
            self.child.wait().ok();
        }
    }
}

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
