//! A rig that works alone: hooks, the lamp's switch, and parking.

use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::time::Duration;

use ridged::bench::AxisName::{PhiS, ThetaC};
use ridged::config::HooksSection;
use ridged::geometry::Pose;
use ridged::lab::{Hooks, RigParts};
use ridged::program::Program;
use ridged::scan::event::RigActivity;
use ridged::scan::runner::ScanCommand;
use ridged::scan::{Event, ScanState};
use ridged::store::disk::RealDisk;
use ridged::units::Angle;
use serde_json::Value;

use crate::bench_in_a_box::{BenchInABox, small};
use crate::commands::Daemon;
use crate::cut_short::by_hand;
use crate::stop::idle;

const PLACE: (f64, f64) = (20.0, 90.0);

async fn bench(folder: &Path, hands: bool, change: impl FnOnce(&mut RigParts)) -> BenchInABox {
    let change = |mut parts: RigParts| {
        change(&mut parts);
        parts
    };
    let disk = Arc::new(RealDisk);
    BenchInABox::open_as(folder, disk, hands, Duration::ZERO, change).await
}

fn parking(parts: &mut RigParts) {
    parts.settings.park = Some(Pose::from_deg(PLACE.0, PLACE.1));
}

fn is_parked(bench: &BenchInABox) -> bool {
    let pose = bench.rig.world.pose_now();
    let off = |angle: Angle, deg: f64| (angle.deg() - deg).abs();
    off(pose.theta_c, PLACE.0) < 0.01 && off(pose.phi_s, PLACE.1) < 0.01
}

fn shell(script: &str) -> Program {
    let words = ["sh", "-c", script].map(str::to_owned);
    Program::of(&words, 20.0).unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn the_axes_are_parked_when_a_scan_completes_and_the_next_one_waits_for_that() {
    let folder = tempfile::tempdir().unwrap();
    let bench = bench(folder.path(), true, parking).await;
    let scan = bench.start(small(&[0.0], &[0.0])).await;
    let mut events = bench.lab.events();
    bench.until(scan.id, ScanState::Completed).await;
    // Not refused, although the axes may be on their way.
    let next = bench.start(small(&[0.0], &[10.0])).await;
    idle(&mut events).await;
    bench.until(next.id, ScanState::Completed).await;
    idle(&mut events).await;
    assert!(is_parked(&bench), "{:?}", bench.rig.world.pose_now());
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_rig_is_idle_once_the_lamp_is_off_and_the_axes_are_parked() {
    let folder = tempfile::tempdir().unwrap();
    let tools = tempfile::tempdir().unwrap();
    let cold = tools.path().join("cold");
    let off = format!("until test -e {}; do sleep 0.05; done", cold.display());
    let bench = bench(folder.path(), true, |parts| {
        parking(parts);
        parts.settings.lamp_off = Some(shell(&off));
    })
    .await;
    let scan = bench.start(small(&[0.0], &[0.0])).await;
    bench.until(scan.id, ScanState::Completed).await;
    let mut events = bench.lab.events();
    tokio::time::sleep(Duration::from_millis(200)).await;
    let waits = bench.lab.rig().await.unwrap();
    assert_eq!(waits.activity, RigActivity::Scanning);
    assert_eq!(waits.scan_id, None);
    std::fs::write(&cold, "").unwrap();
    idle(&mut events).await;
    assert!(is_parked(&bench), "{:?}", bench.rig.world.pose_now());
    assert_eq!(bench.lab.rig().await.unwrap().activity, RigActivity::Idle);
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_axes_are_parked_as_the_daemon_ends_but_never_after_a_stop_or_without_a_reference() {
    let folder = tempfile::tempdir().unwrap();
    for (stopped, homed) in [(false, true), (true, true), (false, false)] {
        let bench = bench(folder.path(), false, parking).await;
        let mut events = bench.lab.events();
        if homed {
            for axis in [ThetaC, PhiS] {
                bench.lab.home(axis).await.unwrap();
                idle(&mut events).await;
            }
        } else {
            bench.lab.home(ThetaC).await.unwrap();
            idle(&mut events).await;
        }
        bench
            .lab
            .move_axis(ThetaC, Angle::from_deg(-10.0))
            .await
            .unwrap();
        idle(&mut events).await;
        if stopped {
            bench.lab.stop().await.unwrap();
        }
        bench.lab.rest().await.unwrap();
        assert_eq!(is_parked(&bench), !stopped && homed, "{stopped} {homed}");
        assert!(!bench.rig.world.is_moving());
        bench.end().await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn neither_an_abort_nor_a_stop_of_a_scan_is_followed_by_motion() {
    let folder = tempfile::tempdir().unwrap();
    let bench = bench(folder.path(), false, parking).await;
    // Homed, and away from the place.
    let scan = bench.start(small(&[0.0], &[0.0])).await;
    bench.until(scan.id, ScanState::WaitingForOperator).await;
    bench.lab.order(scan.id, ScanCommand::Abort).await.unwrap();
    // The owner is free again once it accepts this.
    bench.lab.have_rig().await.unwrap();
    assert!(!is_parked(&bench));

    let scan = bench.start(small(&[0.0], &[0.0])).await;
    bench.until(scan.id, ScanState::WaitingForOperator).await;
    bench.lab.stop().await.unwrap();
    bench.until(scan.id, ScanState::Paused).await;
    bench.lab.rest().await.unwrap();
    assert!(!is_parked(&bench));
    bench.end().await;

    // A scan that merely waits is parked as the daemon ends.
    let other = tempfile::tempdir().unwrap();
    let bench = self::bench(other.path(), false, parking).await;
    let scan = bench.start(small(&[0.0], &[0.0])).await;
    bench.until(scan.id, ScanState::WaitingForOperator).await;
    bench.lab.rest().await.unwrap();
    assert!(is_parked(&bench), "{:?}", bench.rig.world.pose_now());
    let scan = bench.lab.store().scan(scan.id).await.unwrap();
    assert_eq!(scan.state, ScanState::Interrupted);
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_lamp_that_cannot_be_switched_on_pauses_the_scan_with_its_words() {
    let folder = tempfile::tempdir().unwrap();
    let tools = tempfile::tempdir().unwrap();
    let at = |name: &str| tools.path().join(name).display().to_string();
    let on = format!(
        "test -e {0} || {{ echo no mains >&2; exit 1; }}; echo on >> {1}",
        at("mains"),
        at("log")
    );
    let off = format!("echo off >> {}", at("log"));
    let bench = bench(folder.path(), true, |parts| {
        parts.settings.runner.lamp_on = Some(shell(&on));
        parts.settings.lamp_off = Some(shell(&off));
    })
    .await;
    let scan = bench.start(small(&[0.0], &[0.0])).await;
    bench.until(scan.id, ScanState::Paused).await;
    let paused = bench.lab.store().scan(scan.id).await.unwrap();
    let why = paused.reason.unwrap();
    assert!(
        why.contains("no mains") && why.contains("then resume"),
        "{why}"
    );
    let events = bench.lab.store().events_after(0, 1000).await.unwrap();
    let alarms = events
        .iter()
        .filter(|e| matches!(&e.event, Event::Alarm { code, .. } if code == "lamp-failed"));
    assert_eq!(alarms.count(), 1);
    assert!(
        !events
            .iter()
            .any(|e| matches!(e.event, Event::Frame { .. }))
    );

    std::fs::write(at("mains"), "").unwrap();
    bench.lab.order(scan.id, ScanCommand::Resume).await.unwrap();
    assert_eq!(bench.finish(scan.id).await.state, ScanState::Completed);
    // The owner of the rig answers once the lamp is off.
    bench.lab.have_rig().await.unwrap();
    let log = std::fs::read_to_string(at("log")).unwrap();
    assert_eq!(log, "on\noff\n");
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_daemon_that_was_killed_switches_the_lamp_of_its_scan_off_when_it_starts_again() {
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("log");
    let off = format!("echo off >> {}", log.display());
    let lamp = |parts: &mut RigParts| parts.settings.lamp_off = Some(shell(&off));
    let first = bench(folder.path(), false, lamp).await;
    let scan = first.start(small(&[0.0], &[0.0])).await;
    first.until(scan.id, ScanState::WaitingForOperator).await;
    first.end().await;
    std::fs::remove_file(&log).unwrap();
    // A kill leaves the scan in the state that it had.
    by_hand(
        folder.path(),
        "INSERT INTO scan_states (scan_id, state, at) SELECT scan_id, 'running', at FROM scan_states ORDER BY id DESC LIMIT 1",
    )
    .await;
    let again = bench(folder.path(), false, lamp).await;
    // The owner of the rig answers once the lamp is off.
    again.lab.have_rig().await.unwrap();
    assert_eq!(std::fs::read_to_string(&log).unwrap(), "off\n");
    again.end().await;
}

/// Every JSON object that a hook wrote to a file.
fn written(file: &Path) -> Vec<Value> {
    let text = std::fs::read_to_string(file).unwrap_or_default();
    let read = serde_json::Deserializer::from_str(&text).into_iter();
    // The last one may be half written.
    read.map_while(Result::ok).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn hooks_get_each_event_and_a_broken_one_disturbs_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let tools = tempfile::tempdir().unwrap();
    let file = |name: &str| tools.path().join(name);
    let to = |name: &str| {
        let script = format!("cat >> {}", file(name).display());
        ["sh", "-c", &script].map(str::to_owned).to_vec()
    };
    let settings = HooksSection {
        waiting: to("waiting"),
        completed: to("completed"),
        alarm: to("alarm"),
        // Fails, and never ends.
        paused: ["sh", "-c", "exec sleep 100"].map(str::to_owned).to_vec(),
        failed: vec!["/no/such/program".to_owned()],
        time_limit_s: 2.0,
        ..HooksSection::default()
    };
    let bench = bench(folder.path(), false, |_| {}).await;
    let url = Some("http://127.0.0.1:1".to_owned());
    let hooks = Hooks::start(&bench.lab, &settings, url, Vec::new());
    let scan = bench.start(small(&[0.0], &[0.0])).await;
    bench.until(scan.id, ScanState::WaitingForOperator).await;
    // A pause whose hook hangs.
    bench.lab.order(scan.id, ScanCommand::Pause).await.unwrap();
    bench.until(scan.id, ScanState::Paused).await;
    bench.lab.order(scan.id, ScanCommand::Resume).await.unwrap();
    let hands = bench.rig.operate(&bench.lab, true);
    bench.rig.world.cap_lens(true);
    bench.lab.order(scan.id, ScanCommand::Continue).await.ok();
    assert_eq!(bench.finish(scan.id).await.state, ScanState::Completed);
    hooks.finish().await;

    let waited = written(&file("waiting"));
    let actions: Vec<&str> = waited
        .iter()
        .map(|call| call["operator"]["action"].as_str().unwrap())
        .collect();
    for action in ["cap-lens", "place-white-reference", "place-sample"] {
        assert!(actions.contains(&action), "{actions:?}");
    }
    let step = &waited[0]["operator"];
    assert_eq!(step["scan_id"], scan.id);
    assert_eq!(step["part"], "traced polymer");
    assert_eq!(step["continue_body"]["action"], step["action"]);
    let continue_url = format!("http://127.0.0.1:1/api/v1/scans/{}/continue", scan.id);
    assert_eq!(step["continue_url"], continue_url);
    let completed = written(&file("completed"));
    assert_eq!(completed.len(), 1);
    let completed = &completed[0];
    assert_eq!(completed["event"]["state"], "completed");
    assert!(
        completed["message"]
            .as_str()
            .unwrap()
            .contains("is completed")
    );
    let picture = PathBuf::from(completed["last_frame"]["path"].as_str().unwrap());
    assert!(picture.is_absolute() && picture.is_file());
    assert!(written(&file("alarm")).is_empty());
    hands.abort();
    bench.end().await;
}

/// Runs an example of the docs with stand-ins for the programs it calls; returns what these got.
fn example(script: &str, arguments: &[&str], event: &Value, tools: &Path) -> String {
    let got = tools.join("got");
    for program in ["sendmail", "curl", "load"] {
        let path = tools.join(program);
        // Arguments one a line, then stdin.
        let text = format!(
            "#!/bin/sh\nprintf '%s\\n' \"${{0##*/}}\" \"$@\" >> {0}\ncat >> {0}\n",
            got.display()
        );
        std::fs::write(&path, text).unwrap();
        let mode = std::os::unix::fs::PermissionsExt::from_mode(0o755);
        std::fs::set_permissions(&path, mode).unwrap();
    }
    let script = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("docs/examples/hooks")
        .join(script);
    let path = std::env::var("PATH").unwrap();
    let mut running = Command::new(script)
        .args(arguments)
        .env("PATH", format!("{}:{path}", tools.display()))
        .stdin(Stdio::piped())
        .spawn()
        .unwrap();
    let mut stdin = running.stdin.take().unwrap();
    stdin.write_all(event.to_string().as_bytes()).unwrap();
    drop(stdin);
    assert!(running.wait().unwrap().success(), "it needs jq");
    let text = std::fs::read_to_string(&got).unwrap();
    std::fs::remove_file(got).unwrap();
    text
}

#[test]
fn the_examples_of_the_docs_send_the_message_and_the_last_picture() {
    let tools = tempfile::tempdir().unwrap();
    let picture = tools.path().join("frame.png");
    std::fs::write(&picture, b"a picture").unwrap();
    let secret = tools.path().join("webhook");
    std::fs::write(&secret, "https://chat.example/hook").unwrap();
    let event = serde_json::json!({
        "message": "scan 3 (part 17) is paused: θc stalled\nBcc: all@example.org",
        "scan": { "id": 3, "url": "http://127.0.0.1:8787/api/v1/scans/3" },
        "operator": {
            "action": "place-sample", "part": "part 17", "continue_body": { "action": "place-sample" },
            "continue_url": "http://127.0.0.1:8787/api/v1/scans/3/continue",
        },
        "last_frame": { "path": picture },
    });
    let mail = example("mail.sh", &["lab@example.org"], &event, tools.path());
    let (head, body) = mail.split_once("\n\n").unwrap();
    assert!(head.contains("To: lab@example.org\n"), "{mail}");
    // No line of the message becomes a header.
    assert!(!head.lines().any(|line| line.starts_with("Bcc")), "{head}");
    assert!(
        body.contains("θc stalled") && body.contains("YSBwaWN0dXJl"),
        "{mail}"
    );

    let secret = secret.to_str().unwrap();
    let chat = example("webhook.sh", &[secret], &event, tools.path());
    assert!(
        chat.contains(&format!("file=@{};type=image/png", picture.display())),
        "{chat}"
    );
    let arguments = chat.split("url = ").next().unwrap();
    assert!(!arguments.contains("chat.example"), "{chat}");
    assert!(
        chat.ends_with("url = \"https://chat.example/hook\"\n"),
        "{chat}"
    );
    let text = example("webhook.sh", &[secret, "text"], &event, tools.path());
    assert!(
        text.contains("\"text\": \"scan 3") && !text.contains("file=@"),
        "{text}"
    );

    let robot = example("robot.sh", &["load"], &event, tools.path());
    assert!(
        robot.starts_with("load\nplace-sample\npart 17\n"),
        "{robot}"
    );
    assert!(robot.contains("{\"action\":\"place-sample\"}"), "{robot}");
    assert!(robot.contains("/api/v1/scans/3/continue"), "{robot}");
}

#[test]
fn the_daemon_runs_the_hooks_of_its_settings_also_for_a_scan_that_a_kill_interrupted() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let to = |name: &str| format!("[\"sh\", \"-c\", \"cat >> {}\"]", at.join(name).display());
    let settings = format!(
        "[hooks]\nwaiting = {}\npaused = {}\n",
        to("waiting"),
        to("paused")
    );
    std::fs::write(at.join("rig.toml"), settings).unwrap();
    let args = [
        "--simulated-rig",
        "--time-scale",
        "20",
        "--config",
        "rig.toml",
    ];
    let mut daemon = Daemon::start(at, &args);
    let plan = r#"{"sample_id": 2, "plan": {"theta_c_deg": [0], "phi_s_deg": [0], "exposures_s": [0.02]}}"#;
    let (status, scan) = daemon.post("/scans", plan);
    assert_eq!(status, 202, "{scan}");
    let one = |name: &str| {
        for _ in 0..1500 {
            if let [one] = &written(&at.join(name))[..] {
                return one.clone();
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        panic!("the hook {name} did not run");
    };
    let waiting = one("waiting");
    assert_eq!(waiting["operator"]["action"], "cap-lens");
    assert_eq!(waiting["url"], daemon.url);
    assert!(written(&at.join("paused")).is_empty());
    daemon.end_by(rustix::process::Signal::KILL);
    let mut daemon = Daemon::start(at, &args);
    let paused = one("paused");
    assert_eq!(paused["event"]["state"], "interrupted");
    assert_eq!(paused["scan"]["id"], scan["id"]);
    assert!(daemon.terminate().success());
}
