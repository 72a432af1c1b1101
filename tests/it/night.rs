//! A scan through a night of faults, on a stepped clock: the harness of the soak and of the table of faults.
//!
//! Each frame carries the true pose, exposure and object in its first row, so that a wrong datum is found however it came
//! about. A person is called whenever the scan pauses: after a minute she restores power and resumes.

use std::sync::Arc;
use std::time::Duration;

use futures::future::BoxFuture;
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;
use ridged::bench::{AxisName, Camera, CameraError, CaptureRequest, Captured};
use ridged::clock::{Clock, SteppedClock};
use ridged::frame::{Frame, FrameKind, FrameTag};
use ridged::lab::{Lab, ScanRequest};
use ridged::scan::runner::ScanCommand;
use ridged::scan::{Event, Rig, ScanState};
use ridged::sim::controller::Controller;
use ridged::sim::faults::disk::FaultyDisk;
use ridged::sim::faults::plan::FaultPlan;
use ridged::sim::memory_port::MemoryPorts;
use ridged::sim::rig::{SimulatedRig, Simulation};
use ridged::sim::world::{OnTable, World};
use ridged::store::disk::RealDisk;

use crate::bench_in_a_box::small;

/// Real time after which a run counts as hung.
const HUNG_AFTER: Duration = Duration::from_secs(60);
/// How often the person resumes before she gives up for the night.
const RESUMES_MAX: u32 = 12;
/// Largest difference between the recorded and the true position.
const POSITION_TOLERANCE_DEG: f64 = 0.03;
/// Count above which a pixel has light.
const LIT_DN: u16 = 700;

/// What a night came to.
#[derive(Debug, Clone, Default)]
pub struct Night {
    /// State in which the scan ended.
    pub end: String,
    /// Why it paused, each time.
    pub pauses: Vec<String>,
    /// Codes of the alarms.
    pub alarms: Vec<String>,
    /// Codes of the recoveries.
    pub recovered: Vec<String>,
    /// Why frames were rejected.
    pub rejected: Vec<String>,
    /// Faults that happened.
    pub faults: usize,
    /// Plan, faults and events as text.
    pub story: String,
}

/// Runs the scan of one night in a runtime of its own.
///
/// # Errors
/// A wrong datum, a hang, a panic, an end or a pause without a cause; with the story.
pub fn night(seed: u64, text: &FaultPlan, presses: &[Press]) -> Result<Night, String> {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .unwrap();
    let run = std::panic::AssertUnwindSafe(|| runtime.block_on(pass(seed, text, presses)));
    let outcome = std::panic::catch_unwind(run);
    runtime.shutdown_background();
    outcome.unwrap_or_else(|_| {
        let plan = toml::to_string(text).unwrap();
        Err(format!("it panicked\n{plan}"))
    })
}

/// Whether the camera of a night states when it exposed a frame and for how long.
pub fn states_its_settings(seed: u64) -> bool {
    seed.is_multiple_of(2)
}

async fn pass(seed: u64, text: &FaultPlan, presses: &[Press]) -> Result<Night, String> {
    let plan_text = toml::to_string(text).unwrap();
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
        states_its_settings: states_its_settings(seed),
    };
    parts.rig = Rig::new(link, Box::new(camera));
    let (parts, plan) = rig.with_faults(parts, text.clone(), seed);
    let disk = Arc::new(FaultyDisk::new(Arc::new(RealDisk), plan.clone()));
    let (lab, _) = Lab::open(folder.path(), disk, clock.clone(), Some(parts))
        .await
        .unwrap();
    rig.add_samples(&lab).await.unwrap();
    let hands = rig.operate(&lab, true);
    let watched = watch(&lab, &world, &clock, presses);
    let watched = tokio::time::timeout(HUNG_AFTER, watched).await;
    let mut night = read_events(&lab).await;
    night.faults = plan.story().len();
    let happened = plan.story().into_iter();
    let happened = happened.map(|h| format!("{:8.1} s {}\n", h.at.as_secs_f64(), h.what));
    night.story = format!(
        "{plan_text}\nfaults:\n{}events:\n{}",
        happened.collect::<String>(),
        night.story
    );
    let outcome = match watched {
        Err(_) => Err("it hung".to_owned()),
        Ok(Err(why)) => Err(why),
        Ok(Ok((scan_id, end))) => match wrong_datum(&lab, scan_id, &night).await {
            Some(why) => Err(why),
            None => Ok(end),
        },
    };
    hands.abort();
    let ended = tokio::time::timeout(HUNG_AFTER, lab.shut_down()).await;
    let outcome = outcome.and_then(|end| match ended {
        Ok(_) => Ok(end),
        Err(_) => Err("the lab did not end".to_owned()),
    });
    match outcome {
        Ok(end) => Ok(Night { end, ..night }),
        Err(why) => Err(format!("{why}\n{}", night.story)),
    }
}

/// A folder in memory where the system has one: thousands of nights need no real disk.
fn folder() -> tempfile::TempDir {
    tempfile::tempdir_in("/dev/shm").unwrap_or_else(|_| tempfile::tempdir().unwrap())
}

async fn read_events(lab: &Lab) -> Night {
    let events = lab.store().events_after(0, 10_000).await;
    let mut night = Night::default();
    for event in events.unwrap_or_default() {
        let line = match event.event {
            Event::Rig { .. } | Event::Uncertainty { .. } => continue,
            Event::Frame {
                kind,
                theta_c_deg,
                phi_s_deg,
                reason,
                ..
            } => {
                night.rejected.extend(reason.clone());
                format!("frame {kind:?} ({theta_c_deg:.2}, {phi_s_deg:.2}) {reason:?}")
            }
            Event::Scan { state, reason, .. } => {
                if state == ScanState::Paused {
                    night.pauses.push(reason.clone().unwrap_or_default());
                }
                format!("scan {state} {reason:?}")
            }
            Event::Alarm { code, message, .. } => {
                night.alarms.push(code.clone());
                format!("alarm {code}: {message}")
            }
            Event::Recovered { code, message, .. } => {
                night.recovered.push(code.clone());
                format!("recovered {code}: {message}")
            }
            other => format!("{other:?}"),
        };
        night.story.push_str(&line);
        night.story.push('\n');
    }
    night
}

/// Starts the scan and looks after it as a person does who is called whenever it pauses. Returns the state it ended in.
async fn watch(
    lab: &Lab,
    world: &World,
    clock: &SteppedClock,
    presses: &[Press],
) -> Result<(i64, String), String> {
    let plan = small(&[0.0, 20.0, 40.0], &[0.0, 90.0]);
    let request = ScanRequest::of(2, plan);
    let mut events = lab.events();
    let mut refused = Vec::new();
    let scan = loop {
        match lab.start_scan(&request).await {
            Ok(scan) => break scan,
            Err(error) if refused.len() < 50 => {
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
async fn wrong_datum(lab: &Lab, scan_id: i64, night: &Night) -> Option<String> {
    // A person who resumes a scan that found no light confirms that the sample has none, or none in a part of the picture.
    let confirmed = |words: &str| night.pauses.iter().any(|why| why.contains(words));
    let black_is_confirmed = confirmed("black");
    let dark_part_is_confirmed = confirmed("of the picture show no light");
    let frames = lab.store().frames_for_reduction(scan_id).await.unwrap();
    for record in frames {
        let name = &record.name;
        let bytes = lab.store().read_png(&record.sha256).unwrap();
        let frame = Frame::from_png(&bytes).unwrap();
        let dark = record.kind == FrameKind::Dark;
        let is_unlit = frame.pixels_dn().iter().all(|dn| *dn < LIT_DN);
        if is_unlit && (dark || record.kind == FrameKind::Sample && black_is_confirmed) {
            // A frame without light is a dark frame, wherever its light went.
            continue;
        }
        if frame.pixels_dn().iter().all(|dn| *dn == u16::MAX) {
            // A lobe may fill the camera; a reduction leaves such frames out.
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
        if !dark && !dark_part_is_confirmed && last.iter().all(|dn| *dn < LIT_DN) {
            return Some(format!("{name} was accepted and its last row has no light"));
        }
    }
    None
}

/// A button that somebody presses.
#[derive(Debug, Clone, Copy)]
pub enum Button {
    /// The stop.
    Stop,
    /// The pause of the scan.
    Pause,
    /// The machine sleeps for an hour.
    Sleep,
}

/// When it is pressed.
#[derive(Debug, Clone, Copy)]
pub struct Press {
    /// Number of events before.
    pub at_event: usize,
    /// The button.
    pub button: Button,
}

/// A camera whose first row holds the truth.
struct WritingCamera {
    world: Arc<World>,
    clock: Arc<SteppedClock>,
    size_px: (u32, u32),
    noise: Pcg64,
    states_its_settings: bool,
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
            // No two poses of the plan look alike: a camera that states nothing could not tell them apart.
            let lobe = (tilt - 0.4 * pose.phi_s.rad().cos()) / 0.2;
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
                tag: match self.states_its_settings {
                    true => FrameTag {
                        exposure_start: Some(started_utc),
                        exposure_s: Some(request.exposure_s),
                        ..FrameTag::default()
                    },
                    false => FrameTag::default(),
                },
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
