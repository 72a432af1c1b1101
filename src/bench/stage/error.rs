//! Why a stage did not execute a request, with the remedy.

use crate::bench::AxisName;
use crate::bench::line::LineError;
use crate::bench::port::PortError;
use crate::bench::wire::zaber_flags::Flag;
use crate::units::Angle;

/// Why a stage did not execute a request. The axes have been stopped as far as they can be reached.
#[derive(Debug, thiserror::Error)]
pub enum StageError {
    /// The port could not be opened: missing, in use, no permission.
    #[error(transparent)]
    Port(#[from] PortError),
    /// A setting is out of range.
    #[error("the stage setting {key} is {found}; allowed: {allowed}")]
    BadSetting {
        /// Key of the setting.
        key: String,
        /// The value found.
        found: String,
        /// The allowed values.
        allowed: String,
    },
    /// The device does not answer.
    #[error("{0}")]
    NoReply(LineError),
    /// The connection is lost.
    #[error("{0}")]
    Disconnected(LineError),
    /// The command cannot be encoded.
    #[error("{0}")]
    Unsendable(LineError),
    /// The device's answer cannot be parsed.
    #[error(
        "the {axis} controller answered {command:?} with {answer:?}, which is not a valid answer"
    )]
    Unreadable {
        /// Which axis.
        axis: AxisName,
        /// The command sent.
        command: String,
        /// The answer received.
        answer: String,
    },
    /// The device refused a command.
    #[error("the {axis} controller refused {command:?} ({code}): {meaning}")]
    Refused {
        /// Which axis.
        axis: AxisName,
        /// The command sent.
        command: String,
        /// The device's own error code.
        code: String,
        /// The meaning of the code, as text.
        meaning: &'static str,
    },
    /// A device other than the configured one answers.
    #[error(
        "address {address}: expected the {axis} axis with serial number {expected}, but serial number {found} \
         answers: the cables may be swapped; swap them back, or correct the settings"
    )]
    WrongDevice {
        /// Which axis.
        axis: AxisName,
        /// Its address.
        address: u8,
        /// Serial number in the settings.
        expected: u32,
        /// Serial number found.
        found: u32,
    },
    /// Two devices answer to one address.
    #[error(
        "two devices answer to address {address}: disconnect one of them and give it another address ('renumber')"
    )]
    AddressConflict {
        /// The address.
        address: u8,
    },
    /// The number of microsteps per turn is unknown.
    #[error(
        "the {axis} device does not report its microsteps per turn (limit.cycle.dist): set counts_per_turn for it"
    )]
    NoScale {
        /// Which axis.
        axis: AxisName,
    },
    /// Device and settings disagree.
    #[error(
        "the {axis} device reports {name} = {found}, but the settings say {expected}: correct the wrong one"
    )]
    Disagreement {
        /// Which axis.
        axis: AxisName,
        /// The quantity they disagree on.
        name: &'static str,
        /// In the settings.
        expected: f64,
        /// On the device.
        found: f64,
    },
    /// The device cannot reach the settings' range, widened by the backlash approach.
    #[error(
        "the limits of {axis} with its backlash need the device angles {needed_min} … {needed_max}, but the device travels from {travel_min} to {travel_max}: set zero_deg (the device angle where {axis} reads 0), or narrow limit_min_deg and limit_max_deg"
    )]
    BeyondTravel {
        /// Which axis.
        axis: AxisName,
        /// Lowest device angle that the settings need.
        needed_min: Angle,
        /// Highest device angle that the settings need.
        needed_max: Angle,
        /// Lowest angle of the device, its `limit.min`.
        travel_min: Angle,
        /// Highest angle of the device, its `limit.max`.
        travel_max: Angle,
    },
    /// The target is not a finite number.
    #[error("the target of {axis} is not a number")]
    NotANumber {
        /// Which axis.
        axis: AxisName,
    },
    /// The target is outside the limits; nothing moved.
    #[error("{axis} = {target} is outside its limits {min} … {max}")]
    OutsideLimits {
        /// Which axis.
        axis: AxisName,
        /// The requested target.
        target: Angle,
        /// Lower limit.
        min: Angle,
        /// Upper limit.
        max: Angle,
    },
    /// The axis has no reference position.
    #[error("{axis} has no reference position: home it first")]
    NotReferenced {
        /// Which axis.
        axis: AxisName,
    },
    /// The controller restarted and lost its reference; points measured since the last good check
    /// are doubtful.
    #[error(
        "the {axis} controller was restarted and lost its reference: home the axis, then repeat the points since the last good one"
    )]
    PowerCycled {
        /// Which axis.
        axis: AxisName,
    },
    /// The move ended early: another command, or the manual knob.
    #[error("the move of {axis} was interrupted ({flag}: {})", flag.meaning())]
    Interrupted {
        /// Which axis.
        axis: AxisName,
        /// NI or NC.
        flag: Flag,
    },
    /// Something blocks the axis.
    #[error("{axis} stalled at {position}: remove what blocks it, then home it")]
    Stalled {
        /// Which axis.
        axis: AxisName,
        /// Position of the stall, by the counter.
        position: Angle,
    },
    /// The device reports a fault.
    #[error("{axis} reports {flag}: {}", flag.meaning())]
    Fault {
        /// Which axis.
        axis: AxisName,
        /// Its flag.
        flag: Flag,
    },
    /// Homing ended without a reference.
    #[error("homing {axis} ended without a reference position ({flag}: {})", flag.meaning())]
    HomingFailed {
        /// Which axis.
        axis: AxisName,
        /// The flag that says so.
        flag: Flag,
    },
    /// The axis is at rest at a wrong position, and no flag is raised.
    #[error(
        "{axis} stopped at {found} instead of {target} without a flag: check for slip, then home it"
    )]
    Missed {
        /// Which axis.
        axis: AxisName,
        /// The target.
        target: Angle,
        /// The position found.
        found: Angle,
    },
    /// Encoder and counter of the axis differ: it slipped without a flag.
    #[error(
        "{axis} slipped: its encoder is {apart} from its counter; check for slip, then home it"
    )]
    Slipped {
        /// Which axis.
        axis: AxisName,
        /// Encoder minus counter.
        apart: Angle,
    },
    /// The axis still moved after its time limit, and was stopped.
    #[error(
        "{axis} still moved after {} (expected: {}) and was stopped",
        in_seconds(*.waited_s), in_seconds(*.predicted_s)
    )]
    TimedOut {
        /// Which axis.
        axis: AxisName,
        /// Time waited.
        waited_s: f64,
        /// Predicted duration.
        predicted_s: f64,
    },
    /// Homing exceeded its time limit, and the axis was stopped.
    #[error(
        "homing {axis} did not end within {home_timeout_s} s (home_timeout_s in [stage.{axis}]), and the axis was \
         stopped: if it was moving, raise home_timeout_s; if not, check its drive; then home it again"
    )]
    HomingTimedOut {
        /// Which axis.
        axis: AxisName,
        /// The time limit.
        home_timeout_s: f64,
    },
    /// The controller at the address has no such axis.
    #[error(
        "the controller at address {address} has no axis {number}: set axis in [stage.{axis}] to the output of the \
         controller that this stage is plugged into (1 where it has only one)"
    )]
    NoSuchAxis {
        /// Which axis.
        axis: AxisName,
        /// Address of the controller.
        address: u8,
        /// The missing axis number.
        number: u8,
    },
    /// The stage was stopped by a request.
    #[error("the stage was stopped")]
    Stopped,
    /// Another move or homing of this axis is running.
    #[error("{axis} is busy with another move: wait until it ends, or stop the stage")]
    Busy {
        /// Which axis.
        axis: AxisName,
    },
}

impl From<LineError> for StageError {
    fn from(error: LineError) -> Self {
        match error {
            LineError::NoReply { .. } => StageError::NoReply(error),
            LineError::Disconnected { .. } => StageError::Disconnected(error),
            LineError::CancelledByStop => StageError::Stopped,
            LineError::Encoding(_) => StageError::Unsendable(error),
        }
    }
}

impl StageError {
    /// Whether the stage must be connected again before any other command.
    #[must_use]
    pub fn is_disconnect(&self) -> bool {
        matches!(
            self,
            StageError::Port(_) | StageError::Disconnected(_) | StageError::NoReply(_)
        )
    }

    /// The axis that must be homed before its position can be trusted.
    #[must_use]
    pub fn axis_to_home(&self) -> Option<AxisName> {
        match *self {
            StageError::NotReferenced { axis }
            | StageError::PowerCycled { axis }
            | StageError::Stalled { axis, .. }
            | StageError::HomingFailed { axis, .. }
            | StageError::HomingTimedOut { axis, .. }
            | StageError::Fault { axis, .. }
            | StageError::Slipped { axis, .. }
            | StageError::Missed { axis, .. } => Some(axis),
            _ => None,
        }
    }
}

/// Renders a duration; a short one does not become zero.
fn in_seconds(seconds: f64) -> String {
    match seconds < 0.1 {
        true => "less than 0.1 s".to_owned(),
        false => format!("{seconds:.1} s"),
    }
}

/// Returns the meaning of a refusal's code, as text.
pub(super) fn refusal_meaning(code: &str) -> &'static str {
    match code {
        "AGAIN" => "its buffer is full; try again",
        "BADAXIS" => "it has no such axis; check address and axis in the settings",
        "BADCOMMAND" => "unknown command; it may be another kind of device or older firmware",
        "BADDATA" => "the value is outside the device's own limits, or the axis is not homed",
        "DRIVERDISABLED" => {
            "the motor driver is off; check the emergency stop, then home the axis, which enables the driver"
        }
        "INACTIVE" => {
            "the connected stage is not active yet; send 'activate' with the manufacturer's program"
        }
        "PARKED" => {
            "the axis is parked (its position is kept for the next power-up); once it may move again, unpark it with \
             `ridged rig unpark`, or home it, which unparks it too"
        }
        "STATUSBUSY" => "not possible while the axis moves",
        "REMOTE" => "the device is set to remote operation",
        _ => "see the controller's manual",
    }
}
