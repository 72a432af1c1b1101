//! Scans under seeded faults of line, stages, camera, disk, clock and people, on a stepped clock.
//!
//! Each frame carries the true pose, exposure and object in its first row, so that a wrong datum is found however it came
//! about. A run must end completed and right, or in another named state with its cause: no hang, no panic, no wrong datum.
//! `make soak SEEDS=A..B` runs more seeds than the test of the suite; a seed that fails prints its plan and its story, and
//! `ridged serve --simulated-rig --faults FILE` runs such a plan.

use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::Arc;
use std::time::{Duration, Instant};

use futures::future::BoxFuture;
use rand::{Rng, RngExt, SeedableRng};
use rand_pcg::Pcg64;
use ridged::bench::{AxisName, Camera, CameraError, CaptureRequest, Captured};
use ridged::clock::{Clock, SteppedClock};
use ridged::frame::{Frame, FrameKind};
use ridged::lab::{Lab, ScanRequest};
use ridged::scan::runner::ScanCommand;
use ridged::scan::{Event, Rig, ScanState};
use ridged::sim::controller::Controller;
use ridged::sim::faults::disk::FaultyDisk;
use ridged::sim::faults::plan::{FaultKind, PlanText, PlannedFault};
use ridged::sim::memory_port::MemoryPorts;
use ridged::sim::rig::{SimulatedRig, Simulation};
use ridged::sim::world::{OnTable, World};
use ridged::store::disk::RealDisk;

use crate::bench_in_a_box::small;

/// Seeds of the suite's own run.
const SEEDS: Range<u64> = 0..100;
/// Real time after which a run counts as hung.
const HUNG_AFTER: Duration = Duration::from_secs(60);
/// How often the person resumes before she gives up for the night.
const RESUMES_MAX: u32 = 12;
/// Kinds that no check finds.
const UNFOUND: [FaultKind; 5] = [
    FaultKind::FrameHalfDark,
    FaultKind::FrameBehind,
    FaultKind::Slip,
    FaultKind::FrameExposure,
    FaultKind::FrameFull,
];
/// Largest difference between the recorded and the true position.
const POSITION_TOLERANCE_DEG: f64 = 0.03;
/// Count above which a pixel has light.
const LIT_DN: u16 = 700;

#[test]
fn no_seed_gives_a_wrong_datum_a_hang_or_an_end_without_a_cause() {
    let seeds = match std::env::var("RIDGED_SOAK_SEEDS") {
        Ok(text) => range(&text).expect("RIDGED_SOAK_SEEDS is like 0..10000"),
        Err(_) => SEEDS,
    };
    let began = Instant::now();
    let (total, mut failed) = (seeds.end - seeds.start, Vec::new());
    let mut ends = BTreeMap::<String, u32>::new();
    for seed in seeds {
        match one_night(seed) {
            Ok(end) => *ends.entry(end).or_default() += 1,
            Err(story) => {
                println!("seed {seed} failed\n{story}\n");
                failed.push(seed);
            }
        }
    }
    let took_s = began.elapsed().as_secs_f64();
    println!(
        "{total} seeds in {took_s:.0} s, {:.3} s each: {ends:?}",
        took_s / total as f64
    );
    assert!(
        failed.is_empty(),
        "{} of {total} seeds failed: {failed:?}",
        failed.len()
    );
}

fn range(text: &str) -> Option<Range<u64>> {
    let (from, to) = text.split_once("..")?;
    Some(from.parse().ok()?..to.parse().ok()?)
}

/// Runs the scan of one seed. Returns the state it ended in, or the plan and the story of what failed.
fn one_night(seed: u64) -> Result<String, String> {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .unwrap();
    let night = std::panic::AssertUnwindSafe(|| runtime.block_on(night(seed)));
    let outcome = std::panic::catch_unwind(night);
    runtime.shutdown_background();
    match outcome {
        Ok(outcome) => outcome,
        Err(_) => Err(format!(
            "it panicked\n{}",
            toml::to_string(&drawn(seed).0).unwrap()
        )),
    }
}

async fn night(seed: u64) -> Result<String, String> {
    let (text, presses) = drawn(seed);
    let plan_text = toml::to_string(&text).unwrap();
    let clock = Arc::new(SteppedClock::new());
    let folder = folder();
    let (rig, mut parts) = SimulatedRig::with_clock(
        Simulation {
            seed,
            ..Simulation::default()
        },
        clock.clone(),
    )
    .unwrap();
    let world = Arc::clone(&rig.world);
    let mut link = parts.rig.link().clone();
    let ports = MemoryPorts::new(Controller::new(&world), Arc::clone(&clock));
    link.seam = Arc::new(ports);
    let camera = WritingCamera {
        world: Arc::clone(&world),
        clock: clock.clone(),
        size_px: (
            parts.settings.camera.width_px,
            parts.settings.camera.height_px,
        ),
        noise: Pcg64::seed_from_u64(seed),
    };
    parts.rig = Rig::new(link, Box::new(camera));
    let (parts, plan) = rig.with_faults(parts, text, seed);
    let disk = Arc::new(FaultyDisk::new(Arc::new(RealDisk), plan.clone()));
    let (lab, _) = Lab::open(folder.path(), disk, clock.clone(), Some(parts))
        .await
        .unwrap();
    rig.add_samples(&lab).await.unwrap();
    let hands = rig.operate(&lab, true);
    let fail = |why: String, events: &[String]| {
        let happened: Vec<String> = plan
            .story()
            .iter()
            .map(|h| format!("{:8.1} s {}", h.at.as_secs_f64(), h.what))
            .collect();
        format!(
            "{why}\n{plan_text}\nfaults:\n{}\nevents:\n{}",
            happened.join("\n"),
            events.join("\n")
        )
    };
    let night = tokio::time::timeout(HUNG_AFTER, watch(&lab, &world, &clock, presses)).await;
    let events = story(&lab).await;
    let outcome = match night {
        Err(_) => Err(fail("it hung".into(), &events)),
        Ok(Err(why)) => Err(fail(why, &events)),
        Ok(Ok((scan_id, end))) => match wrong_datum(&lab, scan_id).await {
            Some(why) => Err(fail(why, &events)),
            None => Ok(end),
        },
    };
    hands.abort();
    if tokio::time::timeout(HUNG_AFTER, lab.shut_down())
        .await
        .is_err()
    {
        return Err(fail("the lab did not end".into(), &events));
    }
    outcome
}

/// A folder in memory where the system has one: thousands of nights need no real disk.
fn folder() -> tempfile::TempDir {
    tempfile::tempdir_in("/dev/shm").unwrap_or_else(|_| tempfile::tempdir().unwrap())
}

async fn story(lab: &Lab) -> Vec<String> {
    let events = lab
        .store()
        .events_after(0, 10_000)
        .await
        .unwrap_or_default();
    events
        .iter()
        .filter(|event| !matches!(event.event, Event::Rig { .. } | Event::Uncertainty { .. }))
        .map(|event| match &event.event {
            Event::Frame {
                kind,
                theta_c_deg,
                phi_s_deg,
                accepted,
                reason,
                ..
            } => {
                format!("frame {kind:?} ({theta_c_deg:.2}, {phi_s_deg:.2}) {accepted} {reason:?}")
            }
            Event::Scan { state, reason, .. } => format!("scan {state} {reason:?}"),
            other => format!("{other:?}"),
        })
        .collect()
}

/// Starts the scan and looks after it as a person does who is called whenever it pauses. Returns the state it ended in.
async fn watch(
    lab: &Lab,
    world: &World,
    clock: &SteppedClock,
    presses: Vec<Press>,
) -> Result<(i64, String), String> {
    let plan = small(&[0.0, 20.0, 40.0], &[0.0, 90.0]);
    let request = ScanRequest { sample_id: 2, plan };
    let mut events = lab.events();
    let mut refused = Vec::new();
    let scan = loop {
        match lab.start_scan(&request).await {
            Ok(scan) => break scan,
            Err(error) if refused.len() < 20 => {
                refused.push(error.to_string());
                clock.advance(Duration::from_secs(60));
                look_after(world);
            }
            Err(error) => return Err(format!("no scan begins: {error}; before: {refused:?}")),
        }
    };
    let (mut seen, mut resumes) = (0_usize, 0_u32);
    loop {
        let now = lab.store().scan(scan.id).await.map_err(|e| e.to_string())?;
        if now.state.is_end() || now.state == ScanState::Interrupted {
            return ended(&now.state, now.reason.as_deref()).map(|end| (scan.id, end));
        }
        if now.state == ScanState::Paused {
            if now.reason.as_deref().unwrap_or_default().trim().is_empty() && presses.is_empty() {
                return Err("it paused without a cause".into());
            }
            if resumes == RESUMES_MAX {
                let aborted = lab.order(scan.id, ScanCommand::Abort).await;
                let now = lab.store().scan(scan.id).await.map_err(|e| e.to_string())?;
                // The scan ends also if no stop reaches the stages; the answer then says so.
                if !now.state.is_end() {
                    return Err(format!("no abort ends it: {aborted:?}"));
                }
                continue;
            }
            resumes += 1;
            clock.advance(Duration::from_secs(60));
            look_after(world);
            if let Err(error) = lab.order(scan.id, ScanCommand::Resume).await {
                let still = lab.store().scan(scan.id).await.map_err(|e| e.to_string())?;
                if still.state == ScanState::Paused {
                    return Err(format!("it cannot be resumed: {error}"));
                }
            }
            continue;
        }
        match events.recv().await {
            Ok(_) => seen += 1,
            Err(tokio::sync::broadcast::error::RecvError::Lagged(n)) => seen += n as usize,
            Err(_) => return Err("the events ended".into()),
        }
        for press in presses.iter().filter(|press| press.at_event == seen) {
            match press.button {
                Button::Stop => {
                    // The answer names a stage out of reach.
                    lab.stop().await.ok();
                }
                Button::Pause => {
                    lab.order(scan.id, ScanCommand::Pause).await.ok();
                }
                Button::Sleep => clock.advance(Duration::from_secs(3600)),
            }
        }
    }
}

/// What a person puts right before she resumes.
fn look_after(world: &World) {
    for axis in AxisName::ALL {
        world.set_powered(axis, true);
    }
}

fn ended(state: &ScanState, reason: Option<&str>) -> Result<String, String> {
    match (state, reason.unwrap_or_default().trim()) {
        (ScanState::Failed | ScanState::Interrupted, "") => {
            Err(format!("it is {state} without a cause"))
        }
        _ => Ok(state.to_string()),
    }
}

/// What is wrong with an accepted frame of a scan, if anything is.
async fn wrong_datum(lab: &Lab, scan_id: i64) -> Option<String> {
    let frames = lab.store().frames_for_reduction(scan_id).await.unwrap();
    for record in frames {
        let name = &record.name;
        let bytes = lab.store().read_png(&record.sha256).unwrap();
        let frame = Frame::from_png(&bytes).unwrap();
        let dark = record.kind == FrameKind::Dark;
        if dark && frame.pixels_dn().iter().all(|dn| *dn < LIT_DN) {
            // A frame without light is a dark frame, wherever its light went.
            continue;
        }
        let Some(written) = Written::read(&frame) else {
            return Some(format!(
                "{name} was accepted and is no picture of the camera"
            ));
        };
        let off = |recorded: f64, truth: f64| (recorded - truth).abs() > POSITION_TOLERANCE_DEG;
        let wrong_pose = off(record.theta_c_deg, written.theta_c_deg)
            || off(record.phi_s_deg, written.phi_s_deg);
        if record.kind == FrameKind::Sample && (wrong_pose || written.moved) {
            return Some(format!(
                "{name} was accepted at ({}, {}) deg; it was taken at ({}, {}) deg, moved: {}",
                record.theta_c_deg,
                record.phi_s_deg,
                written.theta_c_deg,
                written.phi_s_deg,
                written.moved
            ));
        }
        // Without light the exposure makes no difference.
        if !dark && (record.exposure_s - written.exposure_s).abs() > 1e-5 {
            return Some(format!(
                "{name} was accepted as of {} s and is of {} s",
                record.exposure_s, written.exposure_s
            ));
        }
        let shown = match (written.capped, written.reference) {
            (true, _) => FrameKind::Dark,
            (false, true) => FrameKind::Flat,
            (false, false) => FrameKind::Sample,
        };
        if record.kind != shown {
            return Some(format!(
                "{name} was accepted as {:?} and shows {shown:?}",
                record.kind
            ));
        }
        let width = frame.width_px() as usize;
        let last = &frame.pixels_dn()[frame.pixels_dn().len() - width..];
        if !dark && last.iter().all(|dn| *dn < LIT_DN) {
            return Some(format!("{name} was accepted and its last row has no light"));
        }
    }
    None
}

#[derive(Debug, Clone, Copy)]
enum Button {
    Stop,
    Pause,
    /// The machine sleeps for an hour.
    Sleep,
}

#[derive(Debug, Clone, Copy)]
struct Press {
    at_event: usize,
    button: Button,
}

/// The faults and the presses of a seed.
fn drawn(seed: u64) -> (PlanText, Vec<Press>) {
    let mut rng = Pcg64::seed_from_u64(seed ^ 0x50A4);
    let mut one_of = |n: usize| rng.random_range(0..n);
    const COMMANDS: [&str; 6] = ["", "move abs", "get pos", "warnings", "home", "stop"];
    let faults = (0..1 + one_of(5)).map(|_| {
        let mut fault = PlannedFault::of(FaultKind::ALL[one_of(FaultKind::ALL.len())]);
        if UNFOUND.contains(&fault.kind) {
            fault.kind = FaultKind::Noise;
        }
        // Most things happen while it homes and scans; some long after.
        fault.at_s = one_of(600) as f64 / if one_of(4) == 0 { 1.0 } else { 10.0 };
        fault.command = COMMANDS[one_of(COMMANDS.len())].into();
        if fault.kind.is_repeated() {
            fault.times = [1, 1, 2, 3, 8, 60][one_of(6)];
            fault.probability = [1.0, 1.0, 0.5, 0.15][one_of(4)];
        }
        if fault.kind.has_axis() {
            fault.axis = Some(AxisName::ALL[one_of(2)]);
        }
        if fault.kind.has_angle() {
            fault.by_deg = Some([0.1, 0.5, 2.0, -1.0][one_of(4)]);
        }
        if fault.kind.has_duration() {
            fault.for_s = Some([0.3, 1.0, 4.0, 30.0, 300.0][one_of(5)]);
        }
        if fault.kind == FaultKind::FrameExposure {
            fault.factor = Some([0.25, 0.5, 1.5, 3.0][one_of(4)]);
        }
        fault
    });
    let text = PlanText {
        fault: faults.collect(),
    };
    let presses = (0..one_of(3)).map(|_| Press {
        at_event: 1 + one_of(60),
        button: [Button::Stop, Button::Pause, Button::Sleep][one_of(3)],
    });
    (text, presses.collect())
}

/// A camera whose first row holds the truth.
struct WritingCamera {
    world: Arc<World>,
    clock: Arc<SteppedClock>,
    size_px: (u32, u32),
    noise: Pcg64,
}

/// What the first row of a frame holds.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Written {
    theta_c_deg: f64,
    phi_s_deg: f64,
    exposure_s: f64,
    moved: bool,
    capped: bool,
    reference: bool,
}

/// Counts of a written value begin here; each pixel holds ten bits.
const WRITTEN_FROM_DN: u16 = 1000;

impl Written {
    fn numbers(self) -> [u64; 4] {
        let micro = |value: f64| ((value + 1000.0) * 1e6).round() as u64;
        let flags = [self.moved, self.capped, self.reference];
        let flags = flags
            .iter()
            .fold(0, |bits, flag| bits * 2 + u64::from(*flag));
        [
            micro(self.theta_c_deg),
            micro(self.phi_s_deg),
            micro(self.exposure_s),
            flags,
        ]
    }

    fn write(self, pixels: &mut [u16]) {
        for (number, pixels) in self.numbers().into_iter().zip(pixels.chunks_mut(4)) {
            for (digit, pixel) in pixels.iter_mut().enumerate() {
                *pixel = WRITTEN_FROM_DN + ((number >> (10 * digit)) & 1023) as u16;
            }
        }
    }

    fn read(frame: &Frame) -> Option<Written> {
        let mut numbers = frame.pixels_dn().chunks(4).take(4).map(|pixels| {
            let digits = pixels.iter().rev();
            digits.fold(0_u64, |number, pixel| {
                (number << 10) + u64::from(pixel.wrapping_sub(WRITTEN_FROM_DN))
            })
        });
        let mut value = || numbers.next().map(|n| n as f64 / 1e6 - 1000.0);
        let (theta_c_deg, phi_s_deg, exposure_s) = (value()?, value()?, value()?);
        let flags = numbers.next()?;
        let plausible = theta_c_deg.abs() < 500.0 && phi_s_deg.abs() < 900.0 && flags < 8;
        plausible.then_some(Written {
            theta_c_deg,
            phi_s_deg,
            exposure_s,
            moved: flags & 4 != 0,
            capped: flags & 2 != 0,
            reference: flags & 1 != 0,
        })
    }
}

impl Camera for WritingCamera {
    fn describe(&self) -> String {
        "a camera whose frames hold the truth".into()
    }

    fn capture<'a>(
        &'a mut self,
        request: &'a CaptureRequest,
    ) -> BoxFuture<'a, Result<Captured, CameraError>> {
        Box::pin(async move {
            let (started_at, started_utc) = (self.clock.now(), self.clock.utc());
            let before = self.world.pose_now();
            let duration = Duration::from_secs_f64(request.exposure_s);
            self.clock.sleep(duration).await;
            let pose = self.world.pose_now();
            let written = Written {
                theta_c_deg: pose.theta_c.deg(),
                phi_s_deg: pose.phi_s.deg(),
                exposure_s: request.exposure_s,
                moved: (pose.theta_c - before.theta_c).abs().deg() > POSITION_TOLERANCE_DEG
                    || (pose.phi_s - before.phi_s).abs().deg() > POSITION_TOLERANCE_DEG,
                capped: self.world.lens_capped(),
                reference: self.world.on_table() == OnTable::WhiteReference,
            };
            let tilt = pose.theta_c.rad();
            let lobe = (tilt - 0.35 * pose.phi_s.rad().cos()) / 0.2;
            let rate = match (written.capped, written.reference) {
                (true, _) => 0.0,
                (false, true) => 20_000.0 * tilt.cos(),
                (false, false) => 3_000.0 + 12_000.0 * (-lobe * lobe).exp(),
            };
            let level = 200.0 + rate * request.exposure_s / 0.02;
            let (width, height) = self.size_px;
            let mut pixels_dn: Vec<u16> = (0..width * height)
                .map(|_| {
                    let noise = f64::from(self.noise.next_u32() & 0xFF) / 255.0 - 0.5;
                    (level + noise * level.sqrt() * 3.0).clamp(0.0, 65_000.0) as u16
                })
                .collect();
            written.write(&mut pixels_dn);
            Ok(Captured {
                frame: Frame::new(width, height, pixels_dn)?,
                started_at,
                started_utc,
                tag: Default::default(),
            })
        })
    }
}

#[test]
fn what_is_written_into_a_frame_is_read_again() {
    let written = Written {
        theta_c_deg: -12.345678,
        phi_s_deg: 359.999,
        exposure_s: 0.02,
        moved: false,
        capped: true,
        reference: false,
    };
    let mut pixels_dn = vec![300; 64 * 48];
    written.write(&mut pixels_dn);
    let read = Written::read(&Frame::new(64, 48, pixels_dn).unwrap()).unwrap();
    assert_eq!(read.numbers(), written.numbers());
}
