//! Why a stage did not execute a request, with the remedy.

use super::identity::OtherStages;
use super::regions::{Forbidden, ForbiddenRegion};
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
    /// Controllers other than those of the rig answer.
    #[error("{0}")]
    OtherStages(Box<OtherStages>),
    /// Another controller answers at the address since the connection.
    #[error(
        "the controller of {axis} was replaced while the stage was connected: serial number {before} answered before, and \
         {found} answers now; connect the right one again"
    )]
    Replaced {
        /// Which axis.
        axis: AxisName,
        /// Serial number at the connection.
        before: u32,
        /// Serial number now.
        found: u32,
    },
    /// The device answers, but a motion command has no effect.
    #[error(
        "the {axis} controller answers questions, but {command:?} had no effect in {attempts} attempts (no reply and no \
         motion): check the line for noise and for other programs that use it"
    )]
    NotCarriedOut {
        /// Which axis.
        axis: AxisName,
        /// The command sent.
        command: String,
        /// How often it was sent.
        attempts: u32,
    },
    /// Every way to the target enters a forbidden region; nothing moved.
    #[error("{0}")]
    Forbidden(Box<Forbidden>),
    /// The settings name another axis to be homed first.
    #[error(
        "{axis} cannot be homed while {first} has no reference position: home {first} first (order in [stage.homing])"
    )]
    HomingOrder {
        /// Which axis.
        axis: AxisName,
        /// The axis to home first.
        first: AxisName,
    },
    /// The other axis is where this one cannot be homed.
    #[error(
        "{axis} cannot be homed while {other} is at the forbidden region {region}: move {other} away, or set \
         safe_{other}_deg in [stage.homing] so that it moves there first"
    )]
    HomingBlocked {
        /// Which axis.
        axis: AxisName,
        /// The axis in the way.
        other: AxisName,
        /// The region whose angles it is at.
        region: Box<ForbiddenRegion>,
    },
    /// The encoder shows another position than the counter.
    #[error(
        "{axis} slipped by {slip:.3}: its encoder and its counter have moved apart by this since it was homed, without a \
         flag. Check its load and what touches it, then home it; repeat the points since the last good one"
    )]
    Slipped {
        /// Which axis.
        axis: AxisName,
        /// Encoder minus counter.
        slip: Angle,
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
    #[error("{axis} stalled {}", stall_text(*.position, *.again))]
    Stalled {
        /// Which axis.
        axis: AxisName,
        /// Position of the stall, by the counter.
        position: Angle,
        /// Whether it stalled at the same place before.
        again: bool,
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
            StageError::Port(_)
                | StageError::Disconnected(_)
                | StageError::NoReply(_)
                | StageError::Replaced { .. }
        )
    }

    /// Whether the controllers of the rig may be on another port: the named one is gone, or something else is on it.
    #[must_use]
    pub fn may_be_elsewhere(&self) -> bool {
        match self {
            StageError::Port(port) => matches!(
                port,
                PortError::Missing { .. } | PortError::NotASerialLine { .. }
            ),
            StageError::OtherStages(_)
            | StageError::WrongDevice { .. }
            | StageError::NoReply(_) => true,
            _ => false,
        }
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

fn stall_text(position: Angle, again: bool) -> String {
    match again {
        false => format!("at {position}: remove what blocks it, then home it"),
        true => format!(
            "again at {position}, where it stalled before: something blocks it there, or its load is too high for its speed. \
             Remove it, or lower max_speed_deg_s, then home it; if it stalls there once more, abort the scan"
        ),
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
