//! A plan of faults: what goes wrong with a simulated rig, and when. A user writes it as a file; a soak draws it from a
//! seed.
//!
//! A fault is due with the first command, frame or write at or after its time that it applies to. So nothing has to wait
//! for it, and the same plan gives the same faults on a real, a scaled and a stepped clock.

use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};

use super::{FaultSource, LineFault};
use crate::bench::AxisName;
use crate::sim::world::{AxisFault, World};
use crate::units::Angle;
use crate::wording::toml_text;

/// Longest time of one fault and latest time at which it begins.
const TIME_MAX_S: f64 = 1e6;
/// Largest angle by which a fault turns an axis.
const TURN_MAX_DEG: f64 = 30.0;
/// What a line says that no device sent.
const NOISE: &[u8] = b"\x00\xff@01 1 17 OK BUSY -- 4711:00\r\n#note\r\n";

/// What controllers say that are at rest.
const IDLE_ALERTS: &[u8] = b"!01 1 IDLE --\r\n!02 1 IDLE --\r\n";

/// What goes wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FaultKind {
    /// The command never reaches the device.
    LoseCommand,
    /// One bit of the command flips.
    GarbleCommand,
    /// The reply never reaches the host.
    LoseReply,
    /// One bit of the reply flips.
    GarbleReply,
    /// One byte of the reply is missing.
    DropByte,
    /// The reply comes with the next command.
    LateReply,
    /// The reply comes twice.
    DoubleReply,
    /// Bytes that no device sent come before the reply.
    Noise,
    /// The controller says that an axis is at rest, whatever it does.
    IdleAlert,
    /// The controller refuses the command with `code`.
    Refuse,
    /// The controllers answer nothing for `for_s`.
    Silence,
    /// The plug is out for `for_s`. Only where this program opens the port (`serve`, `scan`).
    Unplug,
    /// The motor stalls.
    Stall,
    /// The axis hits a limit sensor inside its range.
    LimitSensor,
    /// Another program stops the axis.
    ForeignStop,
    /// Another program moves the axis by `by_deg`.
    ForeignMove,
    /// The knob is turned by `by_deg`.
    Knob,
    /// The axis slips by `by_deg` without a flag.
    Slip,
    /// The controller restarts.
    PowerCycle,
    /// The controller has no power for `for_s`.
    PowerOff,
    /// The emergency stop is pressed.
    EmergencyStop,
    /// The camera's program fails.
    CameraFail,
    /// The camera does not answer in time.
    CameraHang,
    /// The camera delivers the frame before once more.
    FrameRepeat,
    /// The camera delivers the frame that it should have delivered before.
    FrameBehind,
    /// The frame has no light.
    FrameBlack,
    /// The lower half of the frame has no light.
    FrameHalfDark,
    /// The frame is saturated.
    FrameFull,
    /// The frame has another size.
    FrameSize,
    /// The exposure is `factor` times as long as requested.
    FrameExposure,
    /// The disk is full for `for_s`.
    DiskFull,
    /// Writing a file fails.
    DiskError,
}

/// Which device a fault is in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Place {
    Line,
    Stages,
    Camera,
    Disk,
}

impl FaultKind {
    /// Every kind.
    pub const ALL: [FaultKind; 32] = {
        use FaultKind::*;
        [
            LoseCommand,
            GarbleCommand,
            LoseReply,
            GarbleReply,
            DropByte,
            LateReply,
            DoubleReply,
            Noise,
            IdleAlert,
            Refuse,
            Silence,
            Unplug,
            Stall,
            LimitSensor,
            ForeignStop,
            ForeignMove,
            Knob,
            Slip,
            PowerCycle,
            PowerOff,
            EmergencyStop,
            CameraFail,
            CameraHang,
            FrameRepeat,
            FrameBehind,
            FrameBlack,
            FrameHalfDark,
            FrameFull,
            FrameSize,
            FrameExposure,
            DiskFull,
            DiskError,
        ]
    };

    fn place(self) -> Place {
        use FaultKind::*;
        match self {
            LoseCommand | GarbleCommand | LoseReply | GarbleReply | DropByte | LateReply
            | DoubleReply | Noise | IdleAlert | Refuse => Place::Line,
            Silence | Unplug | Stall | LimitSensor | ForeignStop | ForeignMove | Knob | Slip
            | PowerCycle | PowerOff | EmergencyStop => Place::Stages,
            CameraFail | CameraHang | FrameRepeat | FrameBehind | FrameBlack | FrameHalfDark
            | FrameFull | FrameSize | FrameExposure => Place::Camera,
            DiskFull | DiskError => Place::Disk,
        }
    }

    /// Whether a controller alone can have it, without this program's port, camera and disk.
    #[must_use]
    pub fn is_of_controller(self) -> bool {
        matches!(self.place(), Place::Line | Place::Stages) && self != FaultKind::Unplug
    }

    /// Whether it needs `axis`.
    #[must_use]
    pub fn has_axis(self) -> bool {
        self.place() == Place::Stages && !matches!(self, FaultKind::Silence | FaultKind::Unplug)
    }

    /// Whether it needs `by_deg`.
    #[must_use]
    pub fn has_angle(self) -> bool {
        matches!(
            self,
            FaultKind::ForeignMove | FaultKind::Knob | FaultKind::Slip
        )
    }

    /// Whether it needs `for_s`.
    #[must_use]
    pub fn has_duration(self) -> bool {
        matches!(
            self,
            FaultKind::Silence | FaultKind::Unplug | FaultKind::PowerOff | FaultKind::DiskFull
        )
    }

    /// Whether it happens `times` times.
    #[must_use]
    pub fn is_repeated(self) -> bool {
        matches!(self.place(), Place::Line | Place::Camera) || self == FaultKind::DiskError
    }
}

/// One fault of a plan.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlannedFault {
    /// What goes wrong.
    pub kind: FaultKind,
    /// Earliest time, in simulated seconds since the rig was built.
    #[serde(default)]
    pub at_s: f64,
    /// Line and stages: only with commands that contain these words.
    #[serde(default)]
    pub command: String,
    /// Line, camera and `disk-error`: how many times it happens.
    #[serde(default = "once")]
    pub times: u32,
    /// Probability of each of these times.
    #[serde(default = "certain")]
    pub probability: f64,
    /// The axis of a fault of the stages.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub axis: Option<AxisName>,
    /// The angle of `foreign-move`, `knob` and `slip`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub by_deg: Option<f64>,
    /// Duration of `silence`, `unplug`, `power-off` and `disk-full`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub for_s: Option<f64>,
    /// Code of `refuse`, for example `STATUSBUSY`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub code: Option<String>,
    /// Factor of `frame-exposure`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub factor: Option<f64>,
}

fn once() -> u32 {
    1
}

fn certain() -> f64 {
    1.0
}

/// The faults of a file, `[[fault]]` each.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlanText {
    /// The faults.
    #[serde(default)]
    pub fault: Vec<PlannedFault>,
}

/// Why a plan of faults cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum PlanError {
    /// The text is not such a plan.
    #[error(transparent)]
    Text(#[from] toml_text::Refused),
    /// A fault is not complete or out of range.
    #[error("fault {number} ({kind}): {what}")]
    Fault {
        /// Its number in the file, from 1.
        number: usize,
        /// Its kind, as in the file.
        kind: String,
        /// What is wrong.
        what: String,
    },
}

impl PlanText {
    /// Reads and checks a plan.
    ///
    /// # Errors
    /// [`PlanError`] with line or fault and what is expected.
    pub fn read(text: &str) -> Result<PlanText, PlanError> {
        let plan: PlanText = toml_text::read(text)?;
        for (number, fault) in (1..).zip(&plan.fault) {
            if let Err(what) = fault.check() {
                return Err(PlanError::Fault {
                    number,
                    kind: fault.kind_name(),
                    what,
                });
            }
        }
        Ok(plan)
    }
}

impl PlannedFault {
    /// A fault of this kind, once and at once.
    #[must_use]
    pub fn of(kind: FaultKind) -> Self {
        PlannedFault {
            kind,
            at_s: 0.0,
            command: String::new(),
            times: once(),
            probability: certain(),
            axis: None,
            by_deg: None,
            for_s: None,
            code: None,
            factor: None,
        }
    }

    /// Its kind, as in the file.
    #[must_use]
    pub fn kind_name(&self) -> String {
        serde_json::to_value(self.kind)
            .ok()
            .and_then(|kind| kind.as_str().map(str::to_owned))
            .unwrap_or_default()
    }

    fn check(&self) -> Result<(), String> {
        within("at_s", Some(self.at_s), true, 0.0, TIME_MAX_S)?;
        within("probability", Some(self.probability), true, 0.0, 1.0)?;
        let kind = self.kind;
        within("for_s", self.for_s, kind.has_duration(), 0.0, TIME_MAX_S)?;
        let turned = kind.has_angle();
        within("by_deg", self.by_deg, turned, -TURN_MAX_DEG, TURN_MAX_DEG)?;
        let exposed = kind == FaultKind::FrameExposure;
        within("factor", self.factor, exposed, 0.01, 100.0)?;
        match (&self.code, kind == FaultKind::Refuse) {
            (None, true) => return Err("code is missing: for example STATUSBUSY".into()),
            (Some(_), false) => {
                return Err("code has no meaning for this kind: leave it out".into());
            }
            (Some(code), true) if !code.bytes().all(|byte| byte.is_ascii_uppercase()) => {
                return Err(format!(
                    "code {code:?} is not one: expected capitals, as STATUSBUSY"
                ));
            }
            _ => {}
        }
        match (self.axis.is_some(), kind.has_axis()) {
            (false, true) => Err("axis is missing: expected theta_c or phi_s".into()),
            (true, false) => Err("axis has no meaning for this kind: leave it out".into()),
            _ => Ok(()),
        }
    }
}

fn within(
    key: &str,
    value: Option<f64>,
    needed: bool,
    least: f64,
    most: f64,
) -> Result<(), String> {
    match value {
        None if needed => Err(format!("{key} is missing: expected {least} to {most}")),
        Some(_) if !needed => Err(format!("{key} has no meaning for this kind: leave it out")),
        Some(value) if !(least..=most).contains(&value) => Err(format!(
            "{key} {value} is out of range: expected {least} to {most}"
        )),
        _ => Ok(()),
    }
}

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
pub struct FaultPlan {
    world: Arc<World>,
    state: Mutex<State>,
}

impl FaultPlan {
    /// Puts a plan to work. `seed` decides where a probability is below 1.
    #[must_use]
    pub fn new(world: Arc<World>, plan: PlanText, seed: u64) -> Arc<Self> {
        Arc::new(FaultPlan {
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

impl FaultSource for FaultPlan {
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

    fn plan(text: &str) -> (Arc<SteppedClock>, Arc<FaultPlan>) {
        let clock = Arc::new(SteppedClock::new());
        let world = Arc::new(World::new(clock.clone(), WorldSettings::default()));
        let text = PlanText::read(text).unwrap();
        (clock, FaultPlan::new(world, text, 1))
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
            let plan = FaultPlan::new(world, PlanText::read(text).unwrap(), seed);
            (0..200).map(|_| plan.of_frame().is_some()).collect()
        };
        assert_eq!(draws(3), draws(3));
        assert_ne!(draws(3), draws(4));
        let share = draws(3).iter().filter(|black| **black).count();
        assert!((35..90).contains(&share), "{share} of 200");
    }

    #[test]
    fn a_plan_that_cannot_be_meant_is_refused_with_what_is_expected() {
        for (text, expected) in [
            ("[[fault]]\nkind = \"stal\"", "stall"),
            ("[[fault]]\nkind = \"stall\"", "axis is missing"),
            (
                "[[fault]]\nkind = \"noise\"\naxis = \"phi_s\"",
                "leave it out",
            ),
            (
                "[[fault]]\nkind = \"slip\"\naxis = \"phi_s\"",
                "by_deg is missing",
            ),
            (
                "[[fault]]\nkind = \"noise\"\nprobability = 2",
                "expected 0 to 1",
            ),
            ("[[fault]]\nkind = \"silence\"\nfor_s = nan", "out of range"),
            ("[[fault]]\nkind = \"noise\"\nat = 3", "at_s"),
        ] {
            let refused = PlanText::read(text).unwrap_err().to_string();
            assert!(refused.contains(expected), "{text}: {refused}");
        }
    }

    #[test]
    fn a_plan_survives_its_text() {
        let mut slip = PlannedFault::of(FaultKind::Slip);
        slip.axis = Some(AxisName::PhiS);
        slip.by_deg = Some(0.5);
        let plan = PlanText { fault: vec![slip] };
        let text = toml::to_string(&plan).unwrap();
        assert_eq!(PlanText::read(&text).unwrap(), plan);
        for kind in FaultKind::ALL {
            let name = PlannedFault::of(kind).kind_name();
            assert!(!name.is_empty(), "{kind:?}");
        }
    }
}
