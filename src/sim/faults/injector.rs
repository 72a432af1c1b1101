//! Carries out a plan of faults in a world.
//!
//! A fault is due with the first command, frame or write at or after its time that it applies to. So nothing has to wait
//! for it, and the same plan gives the same faults on a real, a scaled and a stepped clock.

use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::plan::{FaultKind, FaultPlan, Place, PlannedFault};
use super::{FaultSource, LineFault};
use crate::bench::AxisName;
use crate::sim::world::{AxisFault, World};
use crate::units::Angle;

/// What a line says that no device sent.
const NOISE: &[u8] = b"\x00\xff@01 1 17 OK BUSY -- 4711:00\r\n#note\r\n";
/// What controllers say that are at rest.
const IDLE_ALERTS: &[u8] = b"!01 1 IDLE --\r\n!02 1 IDLE --\r\n";

/// A fault of one frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum CameraFault {
    /// The program fails.
    Fail,
    /// No frame comes in time.
    Hang,
    /// The frame before comes again.
    Repeat,
    /// The frame that was due before.
    OneBehind,
    /// No light.
    Black,
    /// No light in the lower half.
    HalfDark,
    /// Saturated.
    Full,
    /// Another size.
    WrongSize,
    /// The exposure is this many times as long.
    WrongExposure(f64),
}

/// A fault of one write.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DiskFault {
    /// No space.
    Full,
    /// An I/O error.
    Error,
}

/// What happened, for the story of a run.
#[derive(Debug, Clone, PartialEq)]
pub struct Happening {
    /// Simulated time.
    pub at: Duration,
    /// The fault.
    pub what: String,
}

#[derive(Debug)]
struct State {
    faults: Vec<PlannedFault>,
    rng: Pcg64,
    silent_until: Duration,
    unplugged_until: Duration,
    full_until: Duration,
    power_back: Vec<(AxisName, Duration)>,
    story: Vec<Happening>,
}

/// A plan at work in a world.
#[derive(Debug)]
pub struct FaultInjector {
    world: Arc<World>,
    state: Mutex<State>,
}

impl FaultInjector {
    /// Puts a plan to work. `seed` decides where a probability is below 1.
    #[must_use]
    pub fn new(world: Arc<World>, plan: FaultPlan, seed: u64) -> Arc<Self> {
        Arc::new(FaultInjector {
            world,
            state: Mutex::new(State {
                faults: plan.fault,
                rng: Pcg64::seed_from_u64(seed ^ 0xFA17),
                silent_until: Duration::ZERO,
                unplugged_until: Duration::ZERO,
                full_until: Duration::ZERO,
                power_back: Vec::new(),
                story: Vec::new(),
            }),
        })
    }

    /// What has happened so far.
    #[must_use]
    pub fn story(&self) -> Vec<Happening> {
        self.state().story.clone()
    }

    /// The fault of the next frame.
    #[must_use]
    pub fn of_frame(&self) -> Option<CameraFault> {
        let now = self.world.now();
        let fault = self.state().take(now, Place::Camera, "")?;
        Some(match fault.kind {
            FaultKind::CameraFail => CameraFault::Fail,
            FaultKind::CameraHang => CameraFault::Hang,
            FaultKind::FrameRepeat => CameraFault::Repeat,
            FaultKind::FrameBehind => CameraFault::OneBehind,
            FaultKind::FrameBlack => CameraFault::Black,
            FaultKind::FrameHalfDark => CameraFault::HalfDark,
            FaultKind::FrameFull => CameraFault::Full,
            FaultKind::FrameSize => CameraFault::WrongSize,
            _ => CameraFault::WrongExposure(fault.factor.unwrap_or(1.0)),
        })
    }

    /// The fault of the next write of a file.
    #[must_use]
    pub fn of_write(&self) -> Option<DiskFault> {
        let now = self.world.now();
        let mut state = self.state();
        while let Some(fault) = state.take(now, Place::Disk, "") {
            match fault.kind {
                FaultKind::DiskError => return Some(DiskFault::Error),
                _ => state.full_until = now + seconds(fault.for_s),
            }
        }
        (state.full_until > now).then_some(DiskFault::Full)
    }

    /// Whether the disk is full now.
    #[must_use]
    pub fn disk_is_full(&self) -> bool {
        self.state().full_until > self.world.now()
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().expect("no holder of this lock panics")
    }

    /// Does to the stages what is due.
    fn disturb_stages(&self, command: &str, now: Duration) {
        loop {
            let mut state = self.state();
            let back = state.power_back.iter().position(|(_, at)| *at <= now);
            if let Some(index) = back {
                let (axis, _) = state.power_back.swap_remove(index);
                drop(state);
                self.world.set_powered(axis, true);
                continue;
            }
            let Some(fault) = state.take(now, Place::Stages, command) else {
                return;
            };
            let until = now + seconds(fault.for_s);
            let by = Angle::from_deg(fault.by_deg.unwrap_or_default());
            let cause = match fault.kind {
                FaultKind::Silence => {
                    state.silent_until = until;
                    continue;
                }
                FaultKind::Unplug => {
                    state.unplugged_until = until;
                    continue;
                }
                FaultKind::PowerOff => {
                    let axes = fault.axis.into_iter();
                    state
                        .power_back
                        .extend(axes.clone().map(|axis| (axis, until)));
                    drop(state);
                    for axis in axes {
                        self.world.set_powered(axis, false);
                    }
                    continue;
                }
                FaultKind::Stall => AxisFault::Stall,
                FaultKind::LimitSensor => AxisFault::LimitSensor,
                FaultKind::ForeignStop => AxisFault::ForeignStop,
                FaultKind::ForeignMove => AxisFault::ForeignMove(by),
                FaultKind::Knob => AxisFault::Knob(by),
                FaultKind::Slip => AxisFault::Slip(by),
                FaultKind::EmergencyStop => AxisFault::EmergencyStop,
                _ => AxisFault::PowerCycle,
            };
            drop(state);
            if let Some(axis) = fault.axis {
                self.world.cause(axis, cause);
            }
        }
    }
}

impl FaultSource for FaultInjector {
    fn of_command(&self, command: &str) -> Option<LineFault> {
        let now = self.world.now();
        self.disturb_stages(command, now);
        let mut state = self.state();
        if state.silent_until > now {
            return Some(LineFault::LoseCommand);
        }
        let fault = state.take(now, Place::Line, command)?;
        Some(match fault.kind {
            FaultKind::LoseCommand => LineFault::LoseCommand,
            FaultKind::GarbleCommand => LineFault::GarbleCommand,
            FaultKind::LoseReply => LineFault::LoseReply,
            FaultKind::GarbleReply => LineFault::GarbleReply,
            FaultKind::DropByte => LineFault::DropByte,
            FaultKind::LateReply => LineFault::LateReply,
            FaultKind::DoubleReply => LineFault::DoubleReply,
            FaultKind::Refuse => LineFault::Refuse(fault.code.unwrap_or_default()),
            FaultKind::IdleAlert => LineFault::Before(IDLE_ALERTS.to_vec()),
            _ => LineFault::Before(NOISE.to_vec()),
        })
    }

    fn unplugged(&self) -> bool {
        self.state().unplugged_until > self.world.now()
    }
}

impl State {
    /// Takes the first fault of a place that is due and that chance lets happen.
    fn take(&mut self, now: Duration, place: Place, command: &str) -> Option<PlannedFault> {
        let State { faults, rng, .. } = self;
        let due = faults.iter_mut().find(|fault| {
            fault.kind.place() == place
                && fault.times > 0
                && seconds(Some(fault.at_s)) <= now
                && command.contains(&fault.command)
                && (fault.probability >= 1.0 || rng.random::<f64>() < fault.probability)
        })?;
        due.times = match due.kind.is_repeated() {
            true => due.times - 1,
            false => 0,
        };
        let fault = due.clone();
        let what = match fault.axis {
            Some(axis) => format!("{} of {axis}", fault.kind_name()),
            None => fault.kind_name(),
        };
        tracing::warn!(fault = what, "the plan of faults causes {what}");
        self.story.push(Happening { at: now, what });
        Some(fault)
    }
}

fn seconds(value: Option<f64>) -> Duration {
    Duration::try_from_secs_f64(value.unwrap_or_default()).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::clock::SteppedClock;
    use crate::sim::world::WorldSettings;

    fn plan(text: &str) -> (Arc<SteppedClock>, Arc<FaultInjector>) {
        let clock = Arc::new(SteppedClock::new());
        let world = Arc::new(World::new(clock.clone(), WorldSettings::default()));
        let text = FaultPlan::read(text).unwrap();
        (clock, FaultInjector::new(world, text, 1))
    }

    #[test]
    fn a_fault_is_due_with_the_first_command_it_applies_to() {
        let (clock, plan) = plan(
            "[[fault]]\nkind = \"lose-reply\"\ncommand = \"get pos\"\ntimes = 2\nat_s = 5\n\
             [[fault]]\nkind = \"power-off\"\naxis = \"phi_s\"\nat_s = 7\nfor_s = 3\n\
             [[fault]]\nkind = \"silence\"\nat_s = 20\nfor_s = 1",
        );
        assert_eq!(plan.of_command("/1 1 get pos"), None);
        clock.advance(Duration::from_secs(5));
        assert_eq!(plan.of_command("/1 1 move abs 3"), None);
        for expected in [Some(LineFault::LoseReply), Some(LineFault::LoseReply), None] {
            assert_eq!(plan.of_command("/1 1 get pos"), expected);
        }
        clock.advance(Duration::from_secs(2));
        assert_eq!(plan.of_command("/1 1"), None);
        assert!(!plan.world.powered(AxisName::PhiS));
        clock.advance(Duration::from_secs(3));
        assert_eq!(plan.of_command("/1 1"), None);
        assert!(plan.world.powered(AxisName::PhiS));
        clock.advance(Duration::from_secs(10));
        assert_eq!(plan.of_command("/1 1"), Some(LineFault::LoseCommand));
        clock.advance(Duration::from_secs(1));
        assert_eq!(plan.of_command("/1 1"), None);
        assert_eq!(plan.story().len(), 4);
    }

    #[test]
    fn chance_follows_the_seed() {
        let text = "[[fault]]\nkind = \"frame-black\"\ntimes = 1000\nprobability = 0.3";
        let draws = |seed: u64| -> Vec<bool> {
            let clock = Arc::new(SteppedClock::new());
            let world = Arc::new(World::new(clock, WorldSettings::default()));
            let plan = FaultInjector::new(world, FaultPlan::read(text).unwrap(), seed);
            (0..200).map(|_| plan.of_frame().is_some()).collect()
        };
        assert_eq!(draws(3), draws(3));
        assert_ne!(draws(3), draws(4));
        let share = draws(3).iter().filter(|black| **black).count();
        assert!((35..90).contains(&share), "{share} of 200");
    }
}
