//! Which controllers a rig has, by serial and product number, and how others differ from them.

use std::fmt;

use serde::{Deserialize, Serialize};

use crate::bench::AxisName;

/// Identity of the controllers of both axes.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct StageIdentity {
    /// The tilt axis's controller.
    pub theta_c: DeviceIdentity,
    /// The rotation axis's controller.
    pub phi_s: DeviceIdentity,
}

/// Identity of one controller.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct DeviceIdentity {
    /// Serial number.
    pub serial: u32,
    /// The manufacturer's product number.
    pub device_id: u32,
    /// Firmware version. An update changes it, so it is recorded and not compared.
    pub firmware: String,
}

impl DeviceIdentity {
    /// Whether both are the same device.
    #[must_use]
    pub fn is_same_device(&self, other: &DeviceIdentity) -> bool {
        (self.serial, self.device_id) == (other.serial, other.device_id)
    }
}

impl fmt::Display for DeviceIdentity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "serial number {} (device {})",
            self.serial, self.device_id
        )
    }
}

impl StageIdentity {
    /// The controller of an axis.
    #[must_use]
    pub fn axis(&self, axis: AxisName) -> &DeviceIdentity {
        match axis {
            AxisName::ThetaC => &self.theta_c,
            AxisName::PhiS => &self.phi_s,
        }
    }

    /// Whether both name the same devices.
    #[must_use]
    pub fn is_same(&self, other: &StageIdentity) -> bool {
        AxisName::ALL
            .into_iter()
            .all(|axis| self.axis(axis).is_same_device(other.axis(axis)))
    }
}

impl fmt::Display for StageIdentity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "theta_c {}, phi_s {}", self.theta_c, self.phi_s)
    }
}

/// Controllers other than those of the rig answer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OtherStages {
    /// Those of the rig.
    pub expected: StageIdentity,
    /// Those that answer.
    pub found: StageIdentity,
}

impl OtherStages {
    fn are_swapped(&self) -> bool {
        let OtherStages { expected, found } = self;
        found.theta_c.is_same_device(&expected.phi_s)
            && found.phi_s.is_same_device(&expected.theta_c)
    }
}

impl fmt::Display for OtherStages {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let OtherStages { expected, found } = self;
        if self.are_swapped() {
            write!(
                f,
                "the controllers of theta_c and phi_s have swapped their addresses or cables: this rig has {expected}, \
                 but {found} answer; swap them back"
            )?;
        } else {
            f.write_str("another controller is connected: ")?;
            let other = AxisName::ALL
                .into_iter()
                .filter(|axis| !found.axis(*axis).is_same_device(expected.axis(*axis)));
            for (n, axis) in other.enumerate() {
                let (expected, found) = (expected.axis(axis), found.axis(axis));
                let also = if n == 0 { "" } else { ", and " };
                write!(
                    f,
                    "{also}{axis} of this rig has {expected}, but {found} answers"
                )?;
            }
            f.write_str("; connect the controllers of this rig")?;
        }
        f.write_str(
            ". If the rig was changed on purpose, check it, then accept the new controllers with `ridged rig accept-stages` \
             or on the page",
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn device(serial: u32) -> DeviceIdentity {
        DeviceIdentity {
            serial,
            device_id: 50_105,
            firmware: "7.38".into(),
        }
    }

    fn stages(theta_c: u32, phi_s: u32) -> StageIdentity {
        StageIdentity {
            theta_c: device(theta_c),
            phi_s: device(phi_s),
        }
    }

    #[test]
    fn swapped_controllers_and_another_one_are_named_differently() {
        let other = |theta_c, phi_s| OtherStages {
            expected: stages(1, 2),
            found: stages(theta_c, phi_s),
        };
        let swapped = other(2, 1).to_string();
        assert!(swapped.contains("swapped their addresses"), "{swapped}");
        let replaced = other(1, 7).to_string();
        assert!(
            replaced.contains("phi_s of this rig has serial number 2")
                && replaced.contains("serial number 7")
                && !replaced.contains("theta_c of"),
            "{replaced}"
        );
        assert!(replaced.contains("ridged rig accept-stages"), "{replaced}");
    }

    #[test]
    fn a_firmware_update_is_the_same_device() {
        let mut updated = stages(1, 2);
        updated.phi_s.firmware = "7.40".into();
        assert!(updated.is_same(&stages(1, 2)));
        assert!(!stages(2, 1).is_same(&stages(1, 2)));
    }
}
