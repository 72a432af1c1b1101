//! In which order the axes are homed, and where the other one waits.

use serde::{Deserialize, Serialize};

use crate::bench::AxisName;

/// Which axis is homed first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub enum HomingOrder {
    /// Both axes at once.
    #[default]
    #[serde(rename = "together")]
    Together,
    /// First the camera's tilt.
    #[serde(rename = "theta_c-first")]
    ThetaCFirst,
    /// First the sample's azimuth.
    #[serde(rename = "phi_s-first")]
    PhiSFirst,
}

/// `[stage.homing]`: the order of homing, and safe angles.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HomingSettings {
    /// Which axis is homed first. Default `together`; beside forbidden regions one axis must be first.
    #[serde(default)]
    pub order: HomingOrder,
    /// Tilt to which θc moves before φs is homed, where it is not free of all forbidden regions, degrees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub safe_theta_c_deg: Option<f64>,
    /// Azimuth to which φs moves before θc is homed, where it is not free of all forbidden regions, degrees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub safe_phi_s_deg: Option<f64>,
}

impl HomingSettings {
    /// Whether nothing is stated.
    pub(super) fn is_default(&self) -> bool {
        *self == HomingSettings::default()
    }

    /// The axes one after the other; `None` for both at once.
    pub(super) fn sequence(&self) -> Option<[AxisName; 2]> {
        match self.order {
            HomingOrder::Together => None,
            HomingOrder::ThetaCFirst => Some([AxisName::ThetaC, AxisName::PhiS]),
            HomingOrder::PhiSFirst => Some([AxisName::PhiS, AxisName::ThetaC]),
        }
    }

    /// The safe angle of an axis, in degrees.
    pub(super) fn safe_deg(&self, axis: AxisName) -> Option<f64> {
        match axis {
            AxisName::ThetaC => self.safe_theta_c_deg,
            AxisName::PhiS => self.safe_phi_s_deg,
        }
    }
}
