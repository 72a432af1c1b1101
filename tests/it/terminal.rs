//! Commands beside a daemon and beside each other: the prompt at the terminal, the stop, who has the folder.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, ChildStderr, ChildStdin, Command, Stdio};
use std::time::{Duration, Instant};

use ridged::frame::Frame;
use ridged::store::Store;
use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;

use crate::commands::{Daemon, holds_a_file, refuses, ridged};

/// Stages as a process of their own, a camera that shows what lies in `now.png`, and a daemon that takes both for real
/// ones: its scans wait for people.
struct RealRig {
    stages: Child,
    daemon: Daemon,
    folder: tempfile::TempDir,
}

impl RealRig {
    fn start() -> RealRig {
        let folder = tempfile::tempdir().unwrap();
        let at = folder.path();
        let mut stages = Command::new(env!("CARGO_BIN_EXE_ridged"))
            .args([
                "simulate-rig",
                "--tcp",
                "127.0.0.1:0",
                "--time-scale",
                "200",
            ])
            .env("RIDGED_LOG", "off")
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut line = String::new();
        let mut said = BufReader::new(stages.stdout.take().unwrap());
        said.read_line(&mut line).unwrap();
        let port = line.trim().strip_prefix("listening on ").unwrap();
        let camera = at.join("camera");
        std::fs::create_dir(&camera).unwrap();
        let (frames, now) = (camera.display(), at.join("now.png"));
        let now = now.display();
        let settings = format!(
            r#"
port = "tcp://{port}"
stage.theta_c = {{ address = 1, zero_deg = 65.0, limit_min_deg = -45.0, limit_max_deg = 45.0, settle_ms = 0 }}
stage.phi_s = {{ address = 2, zero_deg = 30.0, limit_min_deg = -5.0, limit_max_deg = 365.0, settle_ms = 0 }}
dark.repeats = 1
[camera]
folder = "{frames}"
command = ["cp", "{now}", "{{file}}"]
width_px = 8
height_px = 8
bit_depth = 16
gain_dn_per_electron = 1.0
black_level_dn = 64.0
read_noise_electrons_rms = 0.0
exposures_s = [0.02]
"#
        );
        std::fs::write(at.join("rig.toml"), settings).unwrap();
        std::fs::write(
            at.join("plan.toml"),
            "theta_c_deg = [0]\nphi_s_deg = [0, 30]\n",
        )
        .unwrap();
        show(at, 64);
        let daemon = Daemon::start(at, &["--config", "rig.toml"]);
        let sample =
            r#"{"name": "s", "material": {"kind": "dielectric", "eta": 1.5, "eta_std": 0.01}}"#;
        assert_eq!(daemon.post("/samples", sample).0, 201);
        RealRig {
            stages,
            daemon,
            folder,
        }
    }

    /// Begins a scan at a terminal.
    fn scan(&self) -> Terminal {
        let mut child = Command::new(env!("CARGO_BIN_EXE_ridged"))
            .args(["scan", "plan.toml", "--sample", "s", "--data", "data"])
            .current_dir(self.folder.path())
            .env("RIDGED_LOG", "off")
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        Terminal {
            keys: child.stdin.take().unwrap(),
            said: BufReader::new(child.stderr.take().unwrap()),
            child,
        }
    }

    /// Waits until a scan waits for a step.
    fn until(&self, scan_id: i64, action: &str) {
        let late = Instant::now() + Duration::from_secs(60);
        loop {
            let scan = self.daemon.get(&format!("/scans/{scan_id}")).1;
            if scan["operator"]["action"] == action {
                return;
            }
            assert!(Instant::now() < late, "{action}: {scan}");
            std::thread::sleep(Duration::from_millis(10));
        }
    }

    fn end(mut self) {
        assert!(self.daemon.terminate().success());
    }
}

impl Drop for RealRig {
    fn drop(&mut self) {
        self.stages.kill().ok();
        self.stages.wait().ok();
    }
}

/// Puts something before the camera that fills its picture with these counts.
fn show(folder: &Path, dn: u16) {
    let png = Frame::new(8, 8, vec![dn; 64]).unwrap().to_png().unwrap();
    std::fs::write(folder.join("next.png"), png).unwrap();
    std::fs::rename(folder.join("next.png"), folder.join("now.png")).unwrap();
}

/// A command with somebody before it.
struct Terminal {
    child: Child,
    keys: ChildStdin,
    said: BufReader<ChildStderr>,
}

impl Terminal {
    /// The next line that it says.
    fn says(&mut self) -> String {
        let mut line = String::new();
        self.said.read_line(&mut line).unwrap();
        line
    }

    fn press_enter(&mut self) {
        self.keys.write_all(b"\n").unwrap();
    }

    /// What it says last, and its exit code.
    fn end(mut self) -> (String, Option<i32>) {
        let mut rest = String::new();
        self.said.read_to_string(&mut rest).unwrap();
        (rest, self.child.wait().unwrap().code())
    }
}

#[test]
fn the_prompt_follows_what_others_do_and_enter_is_for_the_step_it_shows() {
    let rig = RealRig::start();
    let at = rig.folder.path();
    let mut terminal = rig.scan();
    let cap = terminal.says();
    assert!(cap.starts_with("Put the cap on the lens"), "{cap}");
    rig.until(1, "cap-lens");
    // Somebody at the page says that it is done.
    assert_eq!(rig.daemon.post("/scans/1/continue", "").0, 202);
    let elsewhere = terminal.says();
    assert!(elsewhere.contains("Another client"), "{elsewhere}");
    let white = terminal.says();
    assert!(white.contains("white reference"), "{white}");
    show(at, 30_000);
    // Whether this prompt took the other's place, so that an Enter of its first second counts for none, is chance.
    std::thread::sleep(Duration::from_millis(1200));
    terminal.press_enter();
    let sample = terminal.says();
    assert!(sample.contains("put the part"), "{sample}");
    assert_eq!(rig.daemon.post("/scans/1/abort", "").0, 202);
    let (rest, code) = terminal.end();
    assert_eq!(code, Some(1), "{rest}");
    assert!(
        rest.contains("scan 1 is aborted (aborted by the operator)"),
        "{rest}"
    );
    rig.end();
}

#[test]
fn ctrl_c_at_the_prompt_pauses_the_scan_and_then_says_how_it_is_left() {
    let rig = RealRig::start();
    let mut terminal = rig.scan();
    let cap = terminal.says();
    assert!(cap.starts_with("Put the cap on the lens"), "{cap}");
    kill_process(Pid::from_child(&terminal.child), Signal::INT).unwrap();
    let (rest, code) = terminal.end();
    assert_eq!(code, Some(130), "{rest}");
    assert!(
        rest.starts_with("scan 1 is paused, 0 of ") && rest.contains("resume or abort it on http"),
        "{rest}"
    );
    assert!(rest.ends_with("everything is safe\n"), "{rest}");
    assert_eq!(rig.daemon.get("/scans/1").1["state"], "paused");
    // A pause frees nothing, so the message does not advise to pause.
    let body = r#"{"sample_id": 1, "plan": {"preset": "paper"}}"#;
    let (status, refused) = rig.daemon.post("/scans", body);
    let detail = refused["detail"].as_str().unwrap();
    assert_eq!(status, 409, "{refused}");
    assert!(
        detail.contains("scan 1 is paused and holds the rig; resume it"),
        "{detail}"
    );
    rig.end();
}

#[test]
fn an_unattended_terminal_leaves_the_step_to_others() {
    let rig = RealRig::start();
    let args = ["scan", "plan.toml", "--sample", "s", "--data", "data"];
    let words = ["scan 1 waits for the operator", "http://127.0.0.1"];
    refuses(rig.folder.path(), &args, 1, &words);
    rig.until(1, "cap-lens");
    rig.end();
}

#[test]
fn a_full_daemon_stops_the_rig_is_alive_and_is_said_to_be_full() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let mut shell = Command::new("sh");
    let program = env!("CARGO_BIN_EXE_ridged");
    shell.args(["-c", r#"ulimit -n 128; exec "$0" "$@""#, program]);
    let mut daemon = Daemon::start_by(shell, at, &["--simulated-rig"]);
    let host = daemon.url.strip_prefix("http://").unwrap().to_owned();
    // Half of the open files are seats, half of these for one peer; each request in hand keeps one.
    let head = format!(
        "POST /api/v1/scans HTTP/1.1\r\nHost: {host}\r\nContent-Type: application/json\r\nContent-Length: 9\r\n"
    );
    let connections: Vec<TcpStream> = (0..32)
        .map(|_| {
            let mut stream = TcpStream::connect(&host).unwrap();
            write!(stream, "{head}Expect: 100-continue\r\n\r\n").unwrap();
            let mut begun = [0; 12];
            stream.read_exact(&mut begun).unwrap();
            assert_eq!(&begun, b"HTTP/1.1 100");
            stream
        })
        .collect();
    let stopped = ridged(at, &["rig", "stop", "--data", "data"]);
    assert!(stopped.status.success(), "{stopped:?}");
    refuses(
        at,
        &["rig", "status", "--data", "data"],
        1,
        &["the daemon is busy", "close some"],
    );
    let alive = ureq::get(format!("{}/healthz", daemon.url)).call().unwrap();
    assert_eq!(alive.status(), 200);
    drop(connections);
    assert!(daemon.terminate().success());
}

#[test]
fn a_log_without_a_reader_holds_no_answer() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    // A pipe takes 64 kB and then blocks who writes to it; the daemon's end of it stays open with the child.
    let (unread, stderr) = std::io::pipe().unwrap();
    let mut program = Command::new(env!("CARGO_BIN_EXE_ridged"));
    program.env("RIDGED_LOG", "trace").stderr(stderr);
    let mut daemon = Daemon::start_with(program, at, &["--simulated-rig", "--time-scale", "1000"]);
    let left_out = |daemon: &Daemon| {
        let text = ureq::get(format!("{}/metrics", daemon.url)).call().unwrap();
        let text = text.into_body().read_to_string().unwrap();
        let name = "ridged_log_lines_left_out_total ";
        let line = text.lines().find_map(|line| line.strip_prefix(name));
        line.unwrap().parse::<u64>().unwrap()
    };
    while left_out(&daemon) == 0 {
        assert_eq!(daemon.get("/rig").0, 200);
    }
    let stopped = ridged(at, &["rig", "stop", "--data", "data"]);
    assert!(stopped.status.success(), "{stopped:?}");
    drop(unread);
    assert!(daemon.terminate().success());
}

#[test]
fn beside_a_scan_that_has_no_daemon_the_stop_names_who_drives_the_rig() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let stop = ["rig", "stop", "--data", "data"];
    refuses(at, &stop, 1, &["no daemon runs on data", "`ridged serve`"]);
    // A daemon that was killed has left its notice.
    std::fs::create_dir(at.join("data")).unwrap();
    let notice = r#"{"url": "http://127.0.0.1:9", "process": 1}"#;
    std::fs::write(at.join("data/daemon.json"), notice).unwrap();
    refuses(at, &stop, 1, &["no daemon runs on data", "`ridged serve`"]);
    let mut scan = Command::new(env!("CARGO_BIN_EXE_ridged"))
        .args(["scan", "--preset", "full", "--data", "data"])
        .args(["--simulated-rig", "--time-scale", "20"])
        .current_dir(at)
        .env("RIDGED_LOG", "off")
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let number = format!("process {}", scan.id());
    let held = || {
        let lock = std::fs::read_to_string(at.join("data/lock")).unwrap_or_default();
        Store::is_in_use(&at.join("data")) && lock.trim() == number
    };
    while !held() {
        assert!(matches!(scan.try_wait(), Ok(None)), "the scan has ended");
        std::thread::sleep(Duration::from_millis(10));
    }
    for action in ["stop", "status"] {
        let args = ["rig", action, "--data", "data"];
        refuses(at, &args, 1, &["no daemon runs on data", &number, "Ctrl-C"]);
    }
    while !holds_a_file(&at.join("data/frames")) {
        assert!(matches!(scan.try_wait(), Ok(None)), "the scan has ended");
        std::thread::sleep(Duration::from_millis(10));
    }
    kill_process(Pid::from_child(&scan), Signal::INT).unwrap();
    // It reports the state of the scan and the rig, and how to resume.
    let left = scan.wait_with_output().unwrap();
    let said = String::from_utf8(left.stderr).unwrap();
    assert_eq!(left.status.code(), Some(130), "{said}");
    for words in [
        "scan 1 is interrupted, ",
        " frames are kept; to resume it, start `ridged serve --simulated-rig --data data`",
        "the stages are at rest",
        "everything is safe",
    ] {
        assert!(said.contains(words), "{words} is not in: {said}");
    }
}

#[test]
fn a_daemon_that_answers_nothing_is_named_with_the_emergency_switch() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let mut daemon = Daemon::start(at, &["--simulated-rig"]);
    // Its notice leads to an address without a listener.
    let notice = at.join("data/daemon.json");
    let text = std::fs::read_to_string(&notice).unwrap();
    let mut wrong: Value = serde_json::from_str(&text).unwrap();
    wrong["url"] = "http://127.0.0.1:9".into();
    std::fs::write(&notice, wrong.to_string()).unwrap();
    let process = wrong["process"].to_string();
    for args in [
        &["rig", "status", "--data", "data"][..],
        &["scan", "--preset", "paper", "--data", "data"],
    ] {
        refuses(at, args, 1, &["runs (process", &process, "does not answer"]);
    }
    let stop = ["rig", "stop", "--data", "data"];
    refuses(at, &stop, 1, &["emergency switch", "may be moving"]);
    assert!(daemon.terminate().success());
}
