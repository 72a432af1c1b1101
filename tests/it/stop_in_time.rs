//! How soon a stop is on the wire and answered, in every state of the rig.

use std::io;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use axum::body::Body;
use ridged::bench::AxisName::{PhiS, ThetaC};
use ridged::bench::port::{NoFaults, Port, PortAddress, PortError, PortSeam};
use ridged::clock::{Clock, ScaledClock};
use ridged::lab::ScanRequest;
use ridged::scan::runner::ScanCommand;
use ridged::scan::{Event, ScanState};
use ridged::sim::rig::SimulatedRig;
use ridged::store::disk::{Disk, RealDisk};
use ridged::units::Angle;

use crate::bench_in_a_box::{BenchInABox, small};
use crate::http::{request, router_of, send};
use crate::stop::{disturbed_on, idle};

/// 50 ms, and as much again three times, since tests share the machine.
const ON_THE_WIRE: Duration = Duration::from_millis(200);
const ANSWERED: Duration = Duration::from_secs(1);
/// No wait of these tests is as long.
const LONGEST: Duration = Duration::from_secs(60);

/// Notes when a stop is written to the port.
#[derive(Clone, Default)]
struct StopTimes(Arc<Mutex<Vec<Instant>>>);

impl PortSeam for StopTimes {
    fn open(&self, address: &PortAddress, baud: u32) -> Result<Box<dyn Port>, PortError> {
        let port = NoFaults.open(address, baud)?;
        let times = self.clone();
        Ok(Box::new(Watched { port, times }))
    }
}

struct Watched {
    port: Box<dyn Port>,
    times: StopTimes,
}

impl Port for Watched {
    fn read(&mut self, buffer: &mut [u8], wait: Duration) -> io::Result<usize> {
        self.port.read(buffer, wait)
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        if bytes.windows(4).any(|part| part == b"stop") {
            self.times.0.lock().unwrap().push(Instant::now());
        }
        self.port.write(bytes)
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stop_is_on_the_wire_at_once_and_answered_within_a_second_in_every_state() {
    let clock: Arc<dyn Clock> = Arc::new(ScaledClock::new(10.0));
    let times = StopTimes::default();
    let seam = Arc::new(times.clone());
    let (lab, rig, _folder) = disturbed_on(clock, |link| link.seam = seam).await;
    rig.add_samples(&lab).await.unwrap();
    let router = router_of(&lab);
    let stop = async |state: &str| {
        let asked = Instant::now();
        let stop = request("POST", "/api/v1/rig/stop").body(Body::empty());
        let answer = send(&router, stop.unwrap()).await;
        let took = asked.elapsed();
        let sent = times
            .0
            .lock()
            .unwrap()
            .iter()
            .find(|at| **at >= asked)
            .copied();
        let sent = sent.unwrap_or_else(|| panic!("{state}: no stop was sent"));
        let wire = sent.duration_since(asked);
        println!("{state}: on the wire after {wire:?}, answered after {took:?}");
        assert!(wire < ON_THE_WIRE, "{state}: on the wire after {wire:?}");
        assert!(took < ANSWERED, "{state}: answered after {took:?}");
        answer.status
    };
    let mut events = lab.events();
    lab.have_rig().await.unwrap();
    assert_eq!(stop("idle").await, 200);
    lab.home(PhiS).await.unwrap();
    assert_eq!(stop("homing").await, 200);
    idle(&mut events).await;
    for axis in [ThetaC, PhiS] {
        lab.home(axis).await.unwrap();
        idle(&mut events).await;
    }
    lab.move_axis(PhiS, Angle::from_deg(350.0)).await.unwrap();
    moves(&rig).await;
    assert_eq!(stop("moving").await, 200);
    idle(&mut events).await;
    assert!(!rig.world.is_moving());

    let plan = small(&[-55.0, 55.0], &[0.0]);
    let request = ScanRequest::of(2, plan);
    let scan = lab.start_scan(&request).await.unwrap();
    let waits = |event: &Event| {
        matches!(
            event,
            Event::Scan {
                operator: Some(_),
                ..
            }
        )
    };
    until(&mut events, waits).await;
    assert_eq!(stop("waiting for the operator").await, 200);
    let paused =
        |event: &Event| matches!(event, Event::Scan { state, .. } if *state == ScanState::Paused);
    until(&mut events, paused).await;
    assert_eq!(stop("paused").await, 200);
    lab.order(scan.id, ScanCommand::Resume).await.unwrap();
    until(&mut events, waits).await;
    let hands = rig.operate(&lab, true);
    until(&mut events, |event| matches!(event, Event::Frame { .. })).await;
    moves(&rig).await;
    assert_eq!(stop("scanning").await, 200);
    assert!(!rig.world.is_moving());
    until(&mut events, paused).await;
    hands.abort();
    lab.order(scan.id, ScanCommand::Abort).await.unwrap();

    for axis in [ThetaC, PhiS] {
        rig.world.set_powered(axis, false);
    }
    assert_eq!(stop("silent controllers").await, 503);
    lab.shut_down().await;
}

async fn until(
    events: &mut tokio::sync::broadcast::Receiver<Arc<ridged::scan::RecordedEvent>>,
    wanted: impl Fn(&Event) -> bool,
) {
    let mut seen = Vec::new();
    let waiting = async {
        loop {
            let event = events.recv().await.unwrap();
            if wanted(&event.event) {
                return;
            }
            seen.push(event);
        }
    };
    let found = tokio::time::timeout(LONGEST, waiting).await;
    assert!(found.is_ok(), "not among {seen:#?}");
}

async fn moves(rig: &SimulatedRig) {
    let waiting = async {
        while !rig.world.is_moving() {
            tokio::task::yield_now().await;
        }
    };
    let moved = tokio::time::timeout(LONGEST, waiting).await;
    assert!(moved.is_ok(), "nothing moved");
}

/// A disk that stops answering, as a network drive whose server is gone.
#[derive(Default)]
struct HungDisk {
    hangs: AtomicBool,
}

impl Disk for HungDisk {
    fn write_durably(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        RealDisk.write_durably(path, bytes)
    }

    fn free_bytes(&self, folder: &Path) -> io::Result<u64> {
        while self.hangs.load(Ordering::SeqCst) {
            std::thread::sleep(Duration::from_millis(5));
        }
        RealDisk.free_bytes(folder)
    }

    fn ask(&self, _: &Path) {
        while self.hangs.load(Ordering::SeqCst) {
            std::thread::sleep(Duration::from_millis(5));
        }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_stop_is_answered_while_the_disk_hangs() {
    let disk = Arc::new(HungDisk::default());
    let bench = BenchInABox::with(Arc::clone(&disk) as Arc<dyn Disk>, false).await;
    bench.lab.have_rig().await.unwrap();
    let router = router_of(&bench.lab);
    disk.hangs.store(true, Ordering::SeqCst);
    // More requests than the runtime has threads.
    let waiting: Vec<_> = ["/readyz", "/metrics"]
        .repeat(4)
        .into_iter()
        .map(|path| {
            let router = router.clone();
            tokio::spawn(async move {
                let ask = request("GET", path).body(Body::empty()).unwrap();
                tower::ServiceExt::oneshot(router, ask)
                    .await
                    .unwrap()
                    .status()
            })
        })
        .collect();
    tokio::time::sleep(Duration::from_millis(50)).await;
    assert!(!waiting.iter().any(tokio::task::JoinHandle::is_finished));
    let asked = Instant::now();
    let stop = request("POST", "/api/v1/rig/stop").body(Body::empty());
    let answer = send(&router, stop.unwrap()).await;
    assert_eq!(answer.status, 200, "{}", answer.body);
    assert!(asked.elapsed() < ANSWERED, "{:?}", asked.elapsed());
    disk.hangs.store(false, Ordering::SeqCst);
    for answered in waiting {
        answered.await.unwrap();
    }
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn orders_are_answered_while_the_disk_hangs_and_move_nothing_later() {
    let disk = Arc::new(HungDisk::default());
    let bench = BenchInABox::with(Arc::clone(&disk) as Arc<dyn Disk>, false).await;
    let scan = bench.start(small(&[0.0], &[0.0])).await;
    bench.until(scan.id, ScanState::WaitingForOperator).await;
    bench.lab.order(scan.id, ScanCommand::Pause).await.unwrap();
    disk.hangs.store(true, Ordering::SeqCst);
    let request = ScanRequest::of(2, small(&[0.0], &[0.0]));
    let refused = async |order: Option<ScanCommand>| {
        let asked = Instant::now();
        let error = match order {
            Some(order) => bench.lab.order(scan.id, order).await.unwrap_err(),
            None => bench.lab.start_scan(&request).await.unwrap_err(),
        };
        assert_eq!(error.code(), "disk-silent", "{order:?}: {error}");
        let took = asked.elapsed();
        assert!(took < Duration::from_millis(1500), "{order:?}: {took:?}");
    };
    for order in [Some(ScanCommand::Resume), Some(ScanCommand::Continue), None] {
        refused(order).await;
    }
    bench.lab.stop().await.unwrap();
    disk.hangs.store(false, Ordering::SeqCst);
    tokio::time::sleep(Duration::from_millis(200)).await;
    let state = bench.lab.store().scan(scan.id).await.unwrap().state;
    assert_eq!(
        state,
        ScanState::Paused,
        "an order was obeyed after it was refused"
    );
    bench.lab.order(scan.id, ScanCommand::Resume).await.unwrap();
    bench.lab.order(scan.id, ScanCommand::Abort).await.unwrap();
    bench.end().await;
}
