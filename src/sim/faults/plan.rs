//! A plan of faults: what goes wrong with a simulated rig, and when. A user writes it as a file; a soak draws it from a
//! seed. [`FaultInjector`](super::injector::FaultInjector) carries it out.

use serde::{Deserialize, Serialize};

use crate::bench::AxisName;
use crate::wording::toml_text;

/// Longest time of one fault and latest time at which it begins.
const TIME_MAX_S: f64 = 1e6;
/// Largest angle by which a fault turns an axis.
const TURN_MAX_DEG: f64 = 30.0;
/// Which device a fault is in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Place {
    Line,
    Stages,
    Camera,
    Disk,
}

/// Defines the kinds of faults from one list: each with the device it is in.
macro_rules! fault_kinds {
    ($($(#[$doc:meta])* $kind:ident: $place:ident,)+) => {
        /// What goes wrong.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
        #[serde(rename_all = "kebab-case")]
        pub enum FaultKind {
            $($(#[$doc])* $kind,)+
        }

        impl FaultKind {
            /// Every kind.
            pub const ALL: &[FaultKind] = &[$(FaultKind::$kind),+];

            /// The device it is in.
            pub(super) fn place(self) -> Place {
                match self {
                    $(FaultKind::$kind => Place::$place,)+
                }
            }
        }
    };
}

fault_kinds! {
    /// The command never reaches the device.
    LoseCommand: Line,
    /// One bit of the command flips.
    GarbleCommand: Line,
    /// The reply never reaches the host.
    LoseReply: Line,
    /// One bit of the reply flips.
    GarbleReply: Line,
    /// One byte of the reply is missing.
    DropByte: Line,
    /// The reply comes with the next command.
    LateReply: Line,
    /// The reply comes twice.
    DoubleReply: Line,
    /// Bytes that no device sent come before the reply.
    Noise: Line,
    /// The controller says that an axis is at rest, whatever it does.
    IdleAlert: Line,
    /// The controller refuses the command with `code`.
    Refuse: Line,
    /// The controllers answer nothing for `for_s`.
    Silence: Stages,
    /// The plug is out for `for_s`. Only where this program opens the port (`serve`, `scan`).
    Unplug: Stages,
    /// The motor stalls.
    Stall: Stages,
    /// The axis hits a limit sensor inside its range.
    LimitSensor: Stages,
    /// Another program stops the axis.
    ForeignStop: Stages,
    /// Another program moves the axis by `by_deg`.
    ForeignMove: Stages,
    /// The knob is turned by `by_deg`.
    Knob: Stages,
    /// The axis slips by `by_deg` without a flag.
    Slip: Stages,
    /// The controller restarts.
    PowerCycle: Stages,
    /// The controller has no power for `for_s`.
    PowerOff: Stages,
    /// The emergency stop is pressed.
    EmergencyStop: Stages,
    /// The camera's program fails.
    CameraFail: Camera,
    /// The camera does not answer in time.
    CameraHang: Camera,
    /// The camera delivers the frame before once more.
    FrameRepeat: Camera,
    /// The camera delivers the frame that it should have delivered before.
    FrameBehind: Camera,
    /// The frame has no light.
    FrameBlack: Camera,
    /// The lower half of the frame has no light.
    FrameHalfDark: Camera,
    /// The frame is saturated.
    FrameFull: Camera,
    /// The frame has another size.
    FrameSize: Camera,
    /// The exposure is `factor` times as long as requested.
    FrameExposure: Camera,
    /// The disk is full for `for_s`.
    DiskFull: Disk,
    /// Writing a file fails.
    DiskError: Disk,
}

impl FaultKind {
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
pub struct FaultPlan {
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

impl FaultPlan {
    /// Reads and checks a plan.
    ///
    /// # Errors
    /// [`PlanError`] with line or fault and what is expected.
    pub fn read(text: &str) -> Result<FaultPlan, PlanError> {
        let plan: FaultPlan = toml_text::read(text)?;
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

#[cfg(test)]
mod tests {
    use super::*;

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
            let refused = FaultPlan::read(text).unwrap_err().to_string();
            assert!(refused.contains(expected), "{text}: {refused}");
        }
    }

    #[test]
    fn a_plan_survives_its_text() {
        let mut slip = PlannedFault::of(FaultKind::Slip);
        slip.axis = Some(AxisName::PhiS);
        slip.by_deg = Some(0.5);
        let plan = FaultPlan { fault: vec![slip] };
        let text = toml::to_string(&plan).unwrap();
        assert_eq!(FaultPlan::read(&text).unwrap(), plan);
        for kind in FaultKind::ALL {
            let name = PlannedFault::of(*kind).kind_name();
            assert!(!name.is_empty(), "{kind:?}");
        }
    }
}
