//! Positions and flags of the axes at one moment.

use serde::{Serialize, Serializer};

use crate::bench::AxisName;
use crate::bench::wire::zaber_flags::Flag;
use crate::geometry::Pose;
use crate::units::Angle;

/// Positions and flags of both axes.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StageStatus {
    /// The tilt axis.
    pub theta_c: AxisStatus,
    /// The rotation axis.
    pub phi_s: AxisStatus,
}

/// Position and flags of an axis.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AxisStatus {
    /// Position read from the device, as a recorded angle.
    #[serde(rename = "position_deg", serialize_with = "degrees")]
    pub position: Angle,
    /// Whether the axis is moving.
    pub moving: bool,
    /// Whether the axis has been homed since power-up.
    pub homed: bool,
    /// Raised flags, each with its meaning.
    pub warnings: Vec<String>,
    /// The same flags as the device names them.
    #[serde(skip)]
    pub flags: Vec<Flag>,
    /// Serial number of its controller.
    pub serial: u32,
}

fn degrees<S: Serializer>(angle: &Angle, s: S) -> Result<S::Ok, S::Error> {
    s.serialize_f64((angle.deg() * 1e10).round() / 1e10)
}

impl StageStatus {
    /// Both positions.
    #[must_use]
    pub fn pose(&self) -> Pose {
        Pose {
            theta_c: self.theta_c.position,
            phi_s: self.phi_s.position,
        }
    }

    /// The status of one axis.
    #[must_use]
    pub fn axis(&self, axis: AxisName) -> &AxisStatus {
        match axis {
            AxisName::ThetaC => &self.theta_c,
            AxisName::PhiS => &self.phi_s,
        }
    }

    /// Whether both axes have been homed since power-up.
    #[must_use]
    pub fn all_homed(&self) -> bool {
        self.theta_c.homed && self.phi_s.homed
    }
}
