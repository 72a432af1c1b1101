//! The sections for a rig that works alone: programs that are run at events, the lamp's switch, and where to park.

use serde::{Deserialize, Serialize};

/// `[hooks]`: programs run at events, with the event as JSON on stdin. Only the settings name them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct HooksSection {
    /// A scan paused or was interrupted. Default: none.
    pub paused: Vec<String>,
    /// A scan failed. Default: none.
    pub failed: Vec<String>,
    /// A scan completed. Default: none.
    pub completed: Vec<String>,
    /// The daemon recovered from a fault by itself. Default: none.
    pub recovered: Vec<String>,
    /// Something needs a person's attention. Default: none.
    pub alarm: Vec<String>,
    /// A scan waits for an operator step. Default: none.
    pub waiting: Vec<String>,
    /// Time after which a hook is killed, s. Default 30, 0.1 to 600.
    pub time_limit_s: f64,
}

impl Default for HooksSection {
    fn default() -> Self {
        HooksSection {
            paused: Vec::new(),
            failed: Vec::new(),
            completed: Vec::new(),
            recovered: Vec::new(),
            alarm: Vec::new(),
            waiting: Vec::new(),
            time_limit_s: 30.0,
        }
    }
}

impl HooksSection {
    /// Returns the commands by the name of their hook.
    #[must_use]
    pub fn commands(&self) -> [(&'static str, &[String]); 6] {
        [
            ("paused", &self.paused),
            ("failed", &self.failed),
            ("completed", &self.completed),
            ("recovered", &self.recovered),
            ("alarm", &self.alarm),
            ("waiting", &self.waiting),
        ]
    }
}

/// `[lamp]`: commands that switch the lamp.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LampSection {
    /// Run before the first exposure of a scan. Default: none.
    pub on: Vec<String>,
    /// Run when a scan has ended, failed or was interrupted. Default: none.
    pub off: Vec<String>,
    /// Time after which either is killed, s: also the time for warming up. Default 30, 0.1 to 3600.
    pub time_limit_s: f64,
}

impl Default for LampSection {
    fn default() -> Self {
        LampSection {
            on: Vec::new(),
            off: Vec::new(),
            time_limit_s: 30.0,
        }
    }
}

/// `[park]`: where the axes go when a scan has ended or failed and when the daemon ends.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ParkSection {
    /// Camera tilt, within the limits of the axis.
    pub theta_c_deg: f64,
    /// Sample azimuth, within the limits of the axis.
    pub phi_s_deg: f64,
}
