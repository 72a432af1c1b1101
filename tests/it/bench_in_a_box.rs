//! A lab with a simulated rig in a folder that goes away: what the tests of the whole begin with.

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use ridged::clock::{Clock, SteppedClock};
use ridged::lab::{Lab, RigParts, ScanRequest};
use ridged::scan::plan::{DarkRequest, FlatRequest, Values};
use ridged::scan::{PlanRequest, Rig, ScanState};
use ridged::sim::rig::{SimulatedRig, Simulation};
use ridged::store::disk::{Disk, RealDisk};
use ridged::store::scans::Scan;

/// A lab, its rig and its folder.
pub struct BenchInABox {
    pub lab: Lab,
    pub rig: SimulatedRig,
    hands: Option<tokio::task::JoinHandle<()>>,
    folder: Option<tempfile::TempDir>,
}

impl BenchInABox {
    /// A fresh one whose hands do every step and say so; time moves only when somebody waits.
    pub async fn new() -> Self {
        BenchInABox::with(Arc::new(RealDisk), true).await
    }

    pub async fn with(disk: Arc<dyn Disk>, hands: bool) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let mut bench = BenchInABox::open(folder.path(), disk, hands).await;
        bench.folder = Some(folder);
        bench
    }

    /// A fresh one without hands whose line waits shortly for an answer: for tests in which the controller is silent.
    pub async fn impatient() -> Self {
        let impatient = |mut parts: RigParts| {
            let mut link = parts.rig.link().clone();
            link.settings.reply_timeout_ms = 100;
            parts.rig = Rig::new(link, parts.rig.camera);
            parts
        };
        let (folder, disk) = (tempfile::tempdir().unwrap(), Arc::new(RealDisk));
        let mut bench =
            BenchInABox::open_as(folder.path(), disk, false, Duration::ZERO, impatient).await;
        bench.folder = Some(folder);
        bench
    }

    pub async fn open(folder: &Path, disk: Arc<dyn Disk>, hands: bool) -> Self {
        BenchInABox::open_as(folder, disk, hands, Duration::ZERO, |parts| parts).await
    }

    /// The same so much later, and with another rig or other settings.
    pub async fn open_as(
        folder: &Path,
        disk: Arc<dyn Disk>,
        hands: bool,
        later: Duration,
        change: impl FnOnce(RigParts) -> RigParts,
    ) -> Self {
        let clock: Arc<dyn Clock> = Arc::new(SteppedClock::new());
        clock.sleep(later).await;
        let (rig, parts) = SimulatedRig::with_clock(Simulation::default(), clock).unwrap();
        let mut parts = parts;
        // Tests that want fits ask for them.
        parts.settings.fit_at_end = false;
        let parts = change(parts);
        let (lab, _) = Lab::open(folder, disk, Arc::clone(&rig.clock), Some(parts))
            .await
            .unwrap();
        rig.add_samples(&lab).await.unwrap();
        let hands = hands.then(|| rig.operate(&lab, true));
        BenchInABox {
            lab,
            rig,
            hands,
            folder: None,
        }
    }

    /// Starts a scan of the traced polymer.
    pub async fn start(&self, plan: PlanRequest) -> Scan {
        let request = ScanRequest::of(2, plan);
        self.lab.start_scan(&request).await.unwrap()
    }

    /// Waits until a scan is over or interrupted.
    pub async fn finish(&self, scan_id: i64) -> Scan {
        let over = self.lab.wait_for_scan(scan_id, 0, |_| false);
        in_time(over).await.unwrap()
    }

    /// Waits until a scan has come to a state.
    pub async fn until(&self, scan_id: i64, state: ScanState) {
        let mut events = self.lab.events();
        let waiting = async {
            loop {
                let scan = self.lab.store().scan(scan_id).await.unwrap();
                if scan.state == state {
                    return;
                }
                assert!(!scan.state.is_end(), "{}: {:?}", scan.state, scan.reason);
                // Whatever wakes this, the store has the whole story.
                events.recv().await.ok();
            }
        };
        in_time(waiting).await;
    }

    /// Ends it as a daemon ends.
    pub async fn end(self) {
        self.lab.shut_down().await;
        if let Some(hands) = self.hands {
            hands.abort();
        }
        drop(self.folder);
    }
}

/// Waits for what comes in seconds, on a busy machine in minutes: a test that waits for something that never comes fails.
pub async fn in_time<T>(work: impl Future<Output = T>) -> T {
    let in_time = tokio::time::timeout(Duration::from_secs(600), work).await;
    in_time.expect("what the test waits for did not come")
}

/// A plan of these poses with one exposure, one dark frame and the white reference at its tilts.
pub fn small(theta_c_deg: &[f64], phi_s_deg: &[f64]) -> PlanRequest {
    PlanRequest {
        theta_c_deg: Some(Values::List(theta_c_deg.to_vec())),
        phi_s_deg: Some(Values::List(phi_s_deg.to_vec())),
        exposures_s: Some(vec![0.02]),
        dark: DarkRequest { repeats: Some(1) },
        flat: FlatRequest {
            exposures_s: Some(vec![0.02]),
            ..FlatRequest::default()
        },
        ..PlanRequest::default()
    }
}
