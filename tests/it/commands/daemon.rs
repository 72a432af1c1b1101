//! A daemon as a process: another one on its folder, few open files, a closed terminal, its log, a kill in mid-scan.

use std::io::{BufRead, BufReader, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;

use super::refuses;

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

    pub(super) fn bytes(&self, path: &str) -> (u16, Vec<u8>) {
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
    pub(super) fn follow(&mut self, mut more: impl FnMut(&Daemon, &Value) -> bool) {
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
