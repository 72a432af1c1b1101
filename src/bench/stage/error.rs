//! Why a stage did not do what was asked, and what to do about it.

use crate::bench::AxisName;
use crate::bench::line::LineError;
use crate::bench::port::PortError;
use crate::bench::wire::zaber_flags::Flag;
use crate::units::Angle;

/// Why a stage did not do what was asked. The axes stand still, as far as they can be reached.
#[derive(Debug, thiserror::Error)]
pub enum StageError {
    /// The port could not be opened: missing, in use, no permission.
    #[error(transparent)]
    Port(#[from] PortError),
    /// A setting that cannot be meant.
    #[error("the stage setting {key} is {found}, allowed is {allowed}")]
    BadSetting {
        /// Which one.
        key: String,
        /// What it is.
        found: String,
        /// What it may be.
        allowed: String,
    },
    /// The device does not answer.
    #[error("{0}")]
    NoReply(LineError),
    /// The line is gone.
    #[error("{0}")]
    Disconnected(LineError),
    /// The command cannot be sent.
    #[error("{0}")]
    Unsendable(LineError),
    /// The device answered what nobody can read.
    #[error("the {axis} controller answered {command:?} with {answer:?}, which cannot be read")]
    Unreadable {
        /// Which axis.
        axis: AxisName,
        /// What was asked.
        command: String,
        /// What came.
        answer: String,
    },
    /// The device refused a command.
    #[error("the {axis} controller refused {command:?} ({code}): {meaning}")]
    Refused {
        /// Which axis.
        axis: AxisName,
        /// What was asked.
        command: String,
        /// The device's own word.
        code: String,
        /// What that means, for people.
        meaning: &'static str,
    },
    /// Another device than the one configured.
    #[error(
        "address {address} should be the {axis} axis with serial number {expected}, but serial number {found} \
         answers: the cables may be swapped; put them right, or correct the settings"
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
        "two devices answer to address {address}: take one off the chain and give it another ('renumber')"
    )]
    AddressConflict {
        /// The address.
        address: u8,
    },
    /// Nobody knows how many microsteps a turn has.
    #[error(
        "the {axis} device does not report its microsteps per turn (limit.cycle.dist): set counts_per_turn for it"
    )]
    NoScale {
        /// Which axis.
        axis: AxisName,
    },
    /// Device and settings disagree.
    #[error(
        "the {axis} device says {name} = {found}, the settings say {expected}: correct the one that is wrong"
    )]
    Disagreement {
        /// Which axis.
        axis: AxisName,
        /// What they disagree on.
        name: &'static str,
        /// In the settings.
        expected: f64,
        /// On the device.
        found: f64,
    },
    /// The settings' range, with the room for the approach, is not within what the device can reach.
    #[error(
        "the limits of {axis} with its backlash need the device angles {needed_min} … {needed_max}, the device goes from {travel_min} to {travel_max}: set zero_deg (the device angle where {axis} reads 0), or narrow limit_min_deg and limit_max_deg"
    )]
    BeyondTravel {
        /// Which axis.
        axis: AxisName,
        /// Lowest device angle that the settings ask for.
        needed_min: Angle,
        /// Highest device angle that the settings ask for.
        needed_max: Angle,
        /// Lowest angle of the device, its `limit.min`.
        travel_min: Angle,
        /// Highest angle of the device, its `limit.max`.
        travel_max: Angle,
    },
    /// A target that is no number.
    #[error("the target of {axis} is not a number")]
    NotANumber {
        /// Which axis.
        axis: AxisName,
    },
    /// A target beyond the limits; nothing moved.
    #[error("{axis} = {target} is outside its limits {min} … {max}")]
    OutsideLimits {
        /// Which axis.
        axis: AxisName,
        /// What was asked for.
        target: Angle,
        /// Lower limit.
        min: Angle,
        /// Upper limit.
        max: Angle,
    },
    /// The axis does not know where it is.
    #[error("{axis} has no reference position: home it first")]
    NotReferenced {
        /// Which axis.
        axis: AxisName,
    },
    /// The controller restarted and lost its reference; points since the last good check are in doubt.
    #[error(
        "the {axis} controller was restarted and lost its reference: home it, then redo the points since the last good one"
    )]
    PowerCycled {
        /// Which axis.
        axis: AxisName,
    },
    /// The move ended early: another command, or a hand on the knob.
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
        /// Where, by its counter.
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
    /// The axis stands still elsewhere, and nothing says why.
    #[error(
        "{axis} stands at {found} instead of {target}, and no flag says why: check for slip, then home it"
    )]
    Missed {
        /// Which axis.
        axis: AxisName,
        /// Where it should be.
        target: Angle,
        /// Where it is.
        found: Angle,
    },
    /// The axis still moves when it should long have stopped; it has been stopped.
    #[error(
        "{axis} still moved after {} (it should have taken {}) and was stopped",
        in_seconds(*.waited_s), in_seconds(*.predicted_s)
    )]
    TimedOut {
        /// Which axis.
        axis: AxisName,
        /// How long was waited.
        waited_s: f64,
        /// How long it should have taken.
        predicted_s: f64,
    },
    /// Homing took longer than the settings allow; the axis has been stopped.
    #[error(
        "homing {axis} had not ended after {home_timeout_s} s (home_timeout_s in [stage.{axis}]), and the axis was \
         stopped: if it moved all the while, allow more time there; if not, look at its drive; then home it again"
    )]
    HomingTimedOut {
        /// Which axis.
        axis: AxisName,
        /// How long it may take.
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
        /// The axis that it does not have.
        number: u8,
    },
    /// Somebody stopped the stage.
    #[error("the stage was stopped")]
    Stopped,
    /// Another move or homing of this axis is under way.
    #[error("{axis} is busy with another move: wait for it, or stop the stage")]
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
            LineError::Overtaken => StageError::Stopped,
            LineError::Encoding(_) => StageError::Unsendable(error),
        }
    }
}

impl StageError {
    /// Whether the stage has to be connected again before anything else.
    #[must_use]
    pub fn is_disconnect(&self) -> bool {
        matches!(
            self,
            StageError::Port(_) | StageError::Disconnected(_) | StageError::NoReply(_)
        )
    }

    /// The axis that has to be homed before its position can be trusted again.
    #[must_use]
    pub fn axis_to_home(&self) -> Option<AxisName> {
        match *self {
            StageError::NotReferenced { axis }
            | StageError::PowerCycled { axis }
            | StageError::Stalled { axis, .. }
            | StageError::HomingFailed { axis, .. }
            | StageError::HomingTimedOut { axis, .. }
            | StageError::Fault { axis, .. }
            | StageError::Missed { axis, .. } => Some(axis),
            _ => None,
        }
    }
}

/// A time that is never told as none.
fn in_seconds(seconds: f64) -> String {
    match seconds < 0.1 {
        true => "less than 0.1 s".to_owned(),
        false => format!("{seconds:.1} s"),
    }
}

/// What a refusal means, for people.
pub(super) fn refusal_meaning(code: &str) -> &'static str {
    match code {
        "AGAIN" => "it has no room now; try again",
        "BADAXIS" => "there is no such axis; check address and axis in the settings",
        "BADCOMMAND" => {
            "it does not know the command; it may be another kind of device or older firmware"
        }
        "BADDATA" => "the value is beyond the device's own limits, or the axis is not homed",
        "DRIVERDISABLED" => {
            "the motor driver is off; check the emergency stop, then home the axis, which switches the driver on"
        }
        "INACTIVE" => {
            "the stage plugged in is not active yet; send 'activate' with the stage maker's program"
        }
        "PARKED" => {
            "the axis is parked (its position is kept for the next power-up); once it may move again, unpark it with \
             `ridged rig unpark`, or home it, which unparks it too"
        }
        "STATUSBUSY" => "not while the axis moves",
        "REMOTE" => "the device is set to remote operation",
        _ => "see the controller's manual",
    }
}
