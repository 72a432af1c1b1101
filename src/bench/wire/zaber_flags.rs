//! Warning flags of the Zaber ASCII protocol (firmware 7): their meaning and their effect on a
//! move.

use std::fmt;

/// Effect of a flag on the running or next move.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum FlagClass {
    /// The move failed and the position may be wrong.
    Fault,
    /// Another command or the manual knob ended the move early.
    Interrupted,
    /// The axis has no reference position, or only one from before the last power-up.
    ReferenceLost,
    /// Worth reporting; the position can still be trusted.
    Informational,
}

macro_rules! flags {
    ($($name:ident = $code:literal, $class:ident, $meaning:literal;)*) => {
        /// A warning flag, in the order of priority in which a device reports them.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
        pub enum Flag {
            $(#[doc = $meaning] $name,)*
            /// A flag that is not in this table: two printable characters.
            Other([u8; 2]),
        }

        impl Flag {
            /// Every flag of the table, highest priority first.
            pub const ALL: &'static [Flag] = &[$(Flag::$name,)*];

            /// Returns the flag with these two characters. Unknown capitals are [`Flag::Other`];
            /// other characters are not a flag.
            #[must_use]
            pub fn from_code(code: &str) -> Option<Self> {
                match code {
                    $($code => Some(Flag::$name),)*
                    _ => match code.as_bytes() {
                        [a, b] if a.is_ascii_uppercase() && b.is_ascii_alphanumeric() => {
                            Some(Flag::Other([*a, *b]))
                        }
                        _ => None,
                    },
                }
            }

            /// The two characters in the protocol.
            #[must_use]
            pub fn code(self) -> [char; 2] {
                let bytes = match self {
                    $(Flag::$name => *$code.as_bytes().first_chunk::<2>().expect("two characters"),)*
                    Flag::Other(code) => code,
                };
                bytes.map(char::from)
            }

            /// Its meaning as text: the cause and, if there is one, the remedy.
            #[must_use]
            pub fn meaning(self) -> &'static str {
                match self {
                    $(Flag::$name => $meaning,)*
                    Flag::Other(_) => "a flag unknown to this program; see the controller's manual",
                }
            }

            /// Its effect on a move.
            #[must_use]
            pub fn class(self) -> FlagClass {
                match self {
                    $(Flag::$name => FlagClass::$class,)*
                    Flag::Other([b'F', _]) => FlagClass::Fault,
                    Flag::Other(_) => FlagClass::Informational,
                }
            }
        }
    };
}

impl Flag {
    /// Whether it means that the motor's driver is off until it is enabled.
    #[must_use]
    pub fn is_driver_off(self) -> bool {
        matches!(
            self,
            Flag::EmergencyStop
                | Flag::SupplyVoltage
                | Flag::DriverOff
                | Flag::InrushCurrent
                | Flag::MotorTemperature
                | Flag::DriverDisabled
        )
    }
}

flags! {
    CriticalSystemError = "FF", Fault, "critical system error; the controller needs service";
    PeripheralNotSupported = "FN", Fault, "the connected stage is not supported by this controller";
    PeripheralInactive = "FZ", Fault, "the stage was replaced and is not active yet; send 'activate'";
    EmergencyStop = "FH", Fault, "hardware emergency stop: release the button, then enable the driver";
    SupplyVoltage = "FV", Fault, "supply voltage out of range, driver off; check the power supply";
    DriverOff = "FO", Fault, "the driver is disabled; enable it";
    InrushCurrent = "FC", Fault, "current inrush error; enable the driver again";
    MotorTemperature = "FM", Fault, "the motor is too hot; let it cool, then enable the driver";
    DriverDisabled = "FD", Fault, "the driver switched itself off, probably too hot";
    EncoderError = "FQ", Fault, "encoder error: the position may be wrong; home the axis";
    IndexError = "FI", Fault, "encoder index error; home the axis";
    EncoderSync = "FA", Fault, "analogue encoder out of sync; home the axis";
    Overdrive = "FR", Fault, "overdrive limit exceeded";
    Stalled = "FS", Fault, "stalled and stopped: remove what blocks the axis, then home it";
    Twisted = "FT", Fault, "lockstep axes twisted against each other";
    OutOfBounds = "FB", Fault, "a stream left the travel range";
    PathDeviation = "FP", Fault, "the axis left the interpolated path";
    LimitError = "FE", Fault, "a limit sensor was not reached or is faulty";
    UnexpectedLimit = "WL", Fault, "ran into a limit sensor unexpectedly: steps were lost or the limits are wrong; home the axis";
    SupplyVoltageLow = "WV", Informational, "supply voltage near its limits";
    ControllerHot = "WT", Informational, "the controller is hot";
    StallRecovered = "WS", Informational, "stalled and recovered by itself";
    Displaced = "WM", Informational, "the axis was displaced while at rest";
    InvalidCalibration = "WP", Informational, "the stored calibration does not match the stage";
    NoReference = "WR", ReferenceLost, "no reference position; home the axis";
    NotHomed = "WH", ReferenceLost, "not homed since power-up; home the axis";
    ManualControl = "NC", Interrupted, "the manual knob is being turned";
    MovementInterrupted = "NI", Interrupted, "another movement command ended the move early";
    StreamDiscontinuity = "ND", Informational, "a stream ran out of points";
    ValueRounded = "NR", Informational, "a value was rounded";
    ValueTruncated = "NT", Informational, "a value was cut to its range";
    UpdatePending = "NU", Informational, "a setting has not taken effect yet";
    JoystickCalibrating = "NJ", Informational, "the joystick is being calibrated";
    FirmwareUpdate = "NB", Informational, "the controller is in firmware update mode";
}

impl fmt::Display for Flag {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [a, b] = self.code();
        write!(f, "{a}{b}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_flag_round_trips() {
        for flag in Flag::ALL {
            assert_eq!(Flag::from_code(&flag.to_string()), Some(*flag));
        }
        assert_eq!(Flag::from_code("FX"), Some(Flag::Other(*b"FX")));
        for no_flag in ["--", "", "F", "FSS", "ws", "é"] {
            assert_eq!(Flag::from_code(no_flag), None, "{no_flag:?}");
        }
    }

    #[test]
    fn the_vendors_client_ends_a_move_at_the_same_flags() {
        // zaber-motion: ^(F\w|WL)$ fails a wait, NI and NC interrupt it, no other flag does.
        for flag in Flag::ALL {
            let code = flag.to_string();
            let class = flag.class();
            assert_eq!(
                class == FlagClass::Fault,
                code.starts_with('F') || code == "WL",
                "{code}"
            );
            assert_eq!(
                class == FlagClass::Interrupted,
                code == "NI" || code == "NC",
                "{code}"
            );
        }
        assert_eq!(Flag::Other(*b"FX").class(), FlagClass::Fault);
    }
}
