//! The thread that owns a port, over a real pseudo-terminal, with injected faults.

use std::sync::Arc;
use std::time::{Duration, Instant};

use ridged::bench::AxisName;
use ridged::bench::line::{LineError, LineSettings, PortLine};
use ridged::bench::port::{NoFaults, PortAddress, PortError};
use ridged::bench::wire::zaber::DeviceCommand;
use ridged::clock::SteppedClock;
use ridged::sim::controller::Controller;
use ridged::sim::faults::{LineFault, ScriptedFaults};
use ridged::sim::server::{PtyServer, serve_pty, serve_tcp};
use ridged::sim::world::{World, WorldSettings};

struct Rig {
    world: Arc<World>,
    server: PtyServer,
    faults: ScriptedFaults,
}

impl Rig {
    fn new() -> Self {
        let clock = Arc::new(SteppedClock::new());
        let world = Arc::new(World::new(clock, WorldSettings::default()));
        Rig {
            server: serve_pty(Controller::new(&world)).unwrap(),
            world,
            faults: ScriptedFaults::new(),
        }
    }

    fn address(&self) -> PortAddress {
        PortAddress::Serial {
            path: self.server.path().to_owned(),
        }
    }

    fn line(&self, attempts: u32) -> PortLine {
        let settings = LineSettings {
            reply_timeout: Duration::from_millis(250),
            attempts,
        };
        PortLine::open(&self.address(), 115_200, settings, &self.faults).unwrap()
    }
}

async fn ask(line: &PortLine, address: u8, words: &str) -> String {
    let command = DeviceCommand::new(address, 0, words);
    line.ask(&command).await.unwrap().data
}

#[tokio::test]
async fn a_late_reply_never_answers_the_next_command() {
    let rig = Rig::new();
    let line = rig.line(1);
    rig.faults.on("get device.id", LineFault::LateReply, 1);
    let command = DeviceCommand::new(1, 0, "get device.id");
    assert!(matches!(
        line.ask(&command).await,
        Err(LineError::NoReply { address: 1, .. })
    ));
    assert_eq!(ask(&line, 1, "get version").await, "7.38");
    assert_eq!(ask(&line, 1, "get device.id").await, "50105");
    assert_eq!(line.counts().strays, 1);
}

#[tokio::test]
async fn a_command_is_repeated_after_a_lost_or_garbled_reply() {
    let rig = Rig::new();
    let line = rig.line(4);
    for fault in [
        LineFault::LoseReply,
        LineFault::GarbleReply,
        LineFault::DropByte,
        LineFault::LoseCommand,
        LineFault::GarbleCommand,
    ] {
        rig.faults.on("get version", fault, 1);
        assert_eq!(ask(&line, 1, "get version").await, "7.38");
    }
    assert_eq!(rig.faults.happened(), 5);
    assert_eq!(line.counts().garbled, 2);
}

#[tokio::test]
async fn a_duplicate_reply_counts_once() {
    let rig = Rig::new();
    let line = rig.line(4);
    rig.faults.on("get version", LineFault::DoubleReply, 1);
    assert_eq!(ask(&line, 1, "get version").await, "7.38");
    assert_eq!(ask(&line, 1, "get device.id").await, "50105");
    assert_eq!(line.counts().strays, 1);
}

#[tokio::test]
async fn lines_that_belong_to_others_are_set_aside() {
    let rig = Rig::new();
    let line = rig.line(4);
    // Another device, another id, another axis, an alert, a help text, noise.
    let others = b"@02 0 00 OK IDLE -- 1\r\n@01 0 99 OK IDLE -- 2\r\n@01 1 00 OK IDLE -- 3\r\n\
                   !01 1 IDLE --\r\n#01 0 00 hello\r\nnoise\r\n@@@\r\n";
    rig.faults
        .on("get version", LineFault::Before(others.to_vec()), 1);
    assert_eq!(ask(&line, 1, "get version").await, "7.38");
    let counts = line.counts();
    assert_eq!((counts.strays, counts.alerts, counts.garbled), (3, 1, 1));
}

#[tokio::test]
async fn ids_are_reused_without_confusion() {
    let rig = Rig::new();
    let line = rig.line(4);
    rig.faults.on("get version", LineFault::LateReply, 1);
    for n in 0..250 {
        let words = format!("tools echo {n}");
        assert_eq!(ask(&line, 2, &words).await, n.to_string());
        if n == 0 {
            assert_eq!(ask(&line, 1, "get version").await, "7.38");
        }
    }
}

#[tokio::test]
async fn a_long_command_and_its_long_reply_are_whole() {
    let rig = Rig::new();
    let line = rig.line(2);
    let words: Vec<String> = (0..40).map(|n| format!("word{n:02}")).collect();
    let text = words.join(" ");
    assert_eq!(ask(&line, 1, &format!("tools echo {text}")).await, text);
}

#[tokio::test]
async fn a_command_issued_before_a_stop_is_not_sent_after_it() {
    let rig = Rig::new();
    let line = rig.line(2);
    let before = line.stops();
    let replies = line.stop(&[1, 2]).await.unwrap();
    assert_eq!(replies.len(), 2);
    let home = DeviceCommand::new(1, 1, "home");
    let cancelled = line.command_once(&home, before).await;
    assert!(matches!(cancelled, Err(LineError::CancelledByStop)));
    assert!(!rig.world.is_moving());
    assert!(
        line.command_once(&home, line.stops())
            .await
            .unwrap()
            .accepted
    );
    assert!(rig.world.is_moving());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stop_does_not_wait_for_the_reply_to_another_command() {
    let rig = Rig::new();
    let settings = LineSettings {
        reply_timeout: Duration::from_secs(3600),
        attempts: 2,
    };
    let line = PortLine::open(&rig.address(), 115_200, settings, &rig.faults).unwrap();
    let stop = async || {
        // Until the other command waits for its reply.
        tokio::time::sleep(Duration::from_millis(100)).await;
        let asked = Instant::now();
        line.stop(&[1, 2]).await.unwrap();
        asked.elapsed()
    };
    let in_time = |work| tokio::time::timeout(Duration::from_secs(60), work);
    // The device answers the stop, so the reply to the question is lost: it is asked again.
    rig.faults.on("get version", LineFault::LoseReply, 1);
    let both = async { tokio::join!(ask(&line, 1, "get version"), stop()) };
    let (version, took) = in_time(Box::pin(both)).await.unwrap();
    assert_eq!(version, "7.38");
    assert!(took < Duration::from_secs(1), "{took:?}");
    assert_eq!(line.counts().timeouts, 1);
    // A motion is not sent again.
    rig.faults.on("home", LineFault::LoseReply, 1);
    let home = DeviceCommand::new(1, 1, "home");
    let stops = line.stops();
    let (homing, _) = tokio::join!(line.command_once(&home, stops), stop());
    assert!(matches!(homing, Err(LineError::NoReply { address: 1, .. })));
    assert!(!rig.world.is_moving());
}

#[tokio::test]
async fn a_stop_is_repeated_until_every_device_has_acknowledged_it() {
    let rig = Rig::new();
    let line = rig.line(4);
    rig.faults.on("stop", LineFault::LoseCommand, 1);
    rig.faults.on("stop", LineFault::LoseReply, 1);
    assert_eq!(line.stop(&[1, 2]).await.unwrap().len(), 2);
    rig.world.set_powered(AxisName::PhiS, false);
    let silent = line.stop(&[1, 2]).await;
    assert!(matches!(silent, Err(LineError::NoReply { address: 2, .. })));
}

#[tokio::test]
async fn a_stop_whose_replies_are_lost_is_confirmed_within_the_time_of_its_answer() {
    let rig = Rig::new();
    let line = rig.line(3);
    rig.faults.on("stop", LineFault::LoseReply, 4);
    let asked = Instant::now();
    assert_eq!(line.stop(&[1, 2]).await.unwrap().len(), 2);
    assert!(asked.elapsed() < Duration::from_millis(900));
    // A position that is asked for until the axes are at rest, too.
    rig.faults.on("get pos", LineFault::LoseReply, 2);
    let asked = Instant::now();
    let position = DeviceCommand::new(1, 1, "get pos");
    assert!(line.ask_soon(&position).await.unwrap().accepted);
    assert!(asked.elapsed() < Duration::from_millis(600));
    assert_eq!(line.counts().second_answers, 0);
}

#[tokio::test]
async fn every_device_answers_a_broadcast() {
    let rig = Rig::new();
    let line = rig.line(1);
    let replies = line.ask_everyone("get system.serial").await.unwrap();
    let serials: Vec<&str> = replies.iter().map(|r| r.data.as_str()).collect();
    assert_eq!(serials, ["90001", "90002"]);
}

#[tokio::test]
async fn a_pulled_plug_is_reported_at_once_and_permanently() {
    let rig = Rig::new();
    let line = rig.line(3);
    assert_eq!(ask(&line, 1, "get version").await, "7.38");
    let command = DeviceCommand::new(1, 0, "get version");
    drop(rig.server);
    for _ in 0..2 {
        let gone = line.ask(&command).await;
        assert!(
            matches!(gone, Err(LineError::Disconnected { .. })),
            "{gone:?}"
        );
    }
}

#[tokio::test]
async fn a_port_has_one_owner_until_its_last_handle_is_dropped() {
    let rig = Rig::new();
    let line = rig.line(1);
    let again = || PortLine::open(&rig.address(), 115_200, LineSettings::default(), &NoFaults);
    let error = again().unwrap_err();
    assert!(matches!(error, PortError::InUse { .. }), "{error}");
    assert!(error.to_string().contains("in use by another program"));
    let second = line.clone();
    drop(line);
    assert_eq!(ask(&second, 1, "get version").await, "7.38");
    drop(second);
    // The thread closes the port asynchronously.
    let limit = Instant::now() + Duration::from_secs(10);
    while again().is_err() {
        assert!(Instant::now() < limit, "the port is still taken");
        std::thread::yield_now();
    }
}

#[tokio::test]
async fn tcp_carries_the_same_bytes() {
    let clock = Arc::new(SteppedClock::new());
    let world = Arc::new(World::new(clock, WorldSettings::default()));
    let server = serve_tcp(Controller::new(&world), "127.0.0.1:0".parse().unwrap()).unwrap();
    let address: PortAddress = format!("tcp://{}", server.address()).parse().unwrap();
    for _ in 0..2 {
        let line = PortLine::open(&address, 0, LineSettings::default(), &NoFaults).unwrap();
        assert_eq!(ask(&line, 2, "get system.serial").await, "90002");
    }
    let line = PortLine::open(&address, 0, LineSettings::default(), &NoFaults).unwrap();
    drop(server);
    let gone = line.ask(&DeviceCommand::new(1, 0, "get version")).await;
    assert!(
        matches!(gone, Err(LineError::Disconnected { .. })),
        "{gone:?}"
    );
}

#[tokio::test]
async fn a_closed_line_frees_its_port_although_a_handle_is_kept() {
    let rig = Rig::new();
    let line = rig.line(1);
    let held = line.clone();
    let settings = LineSettings::default();
    let refused = PortLine::open(&rig.address(), 115_200, settings, &NoFaults);
    assert!(matches!(refused, Err(PortError::InUse { .. })));
    line.close();
    line.closed().await;
    let command = DeviceCommand::new(1, 0, "get version");
    let gone = held.ask(&command).await;
    assert!(
        matches!(gone, Err(LineError::Disconnected { .. })),
        "{gone:?}"
    );
    let again = PortLine::open(&rig.address(), 115_200, settings, &NoFaults).unwrap();
    assert_eq!(ask(&again, 1, "get version").await, "7.38");
}

#[tokio::test]
async fn closing_ends_a_command_that_waits_for_its_reply() {
    let rig = Rig::new();
    let settings = LineSettings {
        reply_timeout: Duration::from_secs(3600),
        attempts: 1,
    };
    let line = PortLine::open(&rig.address(), 115_200, settings, &rig.faults).unwrap();
    rig.faults.on("get version", LineFault::LoseReply, 1);
    let command = DeviceCommand::new(1, 0, "get version");
    let (waiting, ()) = tokio::join!(line.ask(&command), async { line.close() });
    assert!(matches!(waiting, Err(LineError::Disconnected { .. })));
    line.closed().await;
}
