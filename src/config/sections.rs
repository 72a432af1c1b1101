//! The sections of the settings: each key with unit, default and range.
//!
//! A new key is a field here with its default, a row in `bounds.rs` if it is a number with a range, and a line in
//! `ridged.example.toml`, which is also the page of settings.

use std::net::IpAddr;
use std::path::PathBuf;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::scan::faults::{FaultPolicy, OnFailure, Reactions};

/// `[server]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ServerSection {
    /// Address to listen on. Default 127.0.0.1:8787, port 0 takes a free one. An address that other machines can reach needs a
    /// token, and TLS or a proxy.
    pub listen: String,
    /// Certificate for TLS, PEM, with those that signed it. Default: none (no TLS).
    pub tls_cert: Option<PathBuf>,
    /// Its private key, PEM. Required beside `tls_cert`.
    pub tls_key: Option<PathBuf>,
    /// Whether a proxy with TLS forwards all requests to this address. Default false.
    pub behind_proxy: bool,
    /// Addresses of the proxies. Default: this machine.
    pub proxies: Vec<IpAddr>,
    /// Names under which clients on other machines reach the daemon, without port. Default: the name of this machine; behind a
    /// proxy, every name that it forwards.
    pub hosts: Option<Vec<String>>,
    /// Whether callers on this machine need a token, too; the stop never does. Default false.
    pub token_on_loopback: bool,
}

impl Default for ServerSection {
    fn default() -> Self {
        ServerSection {
            listen: "127.0.0.1:8787".into(),
            tls_cert: None,
            tls_key: None,
            behind_proxy: false,
            proxies: Vec::new(),
            hosts: None,
            token_on_loopback: false,
        }
    }
}

/// `[import]`
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ImportSection {
    /// Folders below which an import over HTTP may read, as absolute paths. Default: the home of the daemon's user and the data
    /// folder.
    pub roots: Option<Vec<PathBuf>>,
}

/// `[store]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct StoreSection {
    /// The data folder. Default `ridged-data`; `--data` overrides it.
    pub folder: PathBuf,
    /// Space that scans and imports leave free, MB. Default 200, 1 to 1 000 000.
    pub reserve_mb: u64,
}

impl Default for StoreSection {
    fn default() -> Self {
        StoreSection {
            folder: "ridged-data".into(),
            reserve_mb: 200,
        }
    }
}

impl StoreSection {
    /// Space that scans and imports leave free, in bytes.
    #[must_use]
    pub fn reserve_bytes(&self) -> u64 {
        self.reserve_mb * 1_000_000
    }
}

/// `[rig]`: the keys of a series' manifest.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RigSection {
    /// Angle between lamp and camera. Default 10, 0 to 90.
    pub theta_l_deg: f64,
    /// Azimuth of the lamp about the camera's axis. Default 0 (in the tilt plane), −360 to 360.
    pub light_azimuth_deg: f64,
    /// Angle to add to the recorded φs for the azimuth of v. Default 0, −360 to 360.
    pub azimuth_zero_deg: f64,
    /// Standard uncertainty of the azimuth of v at a recorded φs. Default: not stated (the fit cannot separate it from a wedge
    /// across v), 0 to 180.
    pub azimuth_zero_std_deg: Option<f64>,
    /// Half angle of the lamp seen from the sample. Default: from `light_radius_mm`, or else 1; 0 to 90.
    pub light_angular_radius_deg: Option<f64>,
    /// Half angle of the lens's pupil seen from the sample. Default: from `lens_radius_mm`, or else 0 (a lens stopped down
    /// to a point); 0 to 90.
    pub lens_angular_radius_deg: Option<f64>,
    /// Wavelength of the lamp. Default 550, 100 to 100 000.
    pub wavelength_nm: f64,
    /// Column and row of the point about which camera and lamp tilt, from the outer corner of the first pixel. Default: the
    /// frame's centre.
    pub tilt_centre_px: Option<[f64; 2]>,
    /// Column and row at which the rotation axis meets the sample at θc = 0. Default: `tilt_centre_px`.
    pub rotation_axis_px: Option<[f64; 2]>,
    /// Distance from the centre of tilt to the lamp; omit it for a collimated lamp. Above 0.
    pub light_distance_mm: Option<f64>,
    /// Radius of the lamp where its distance is given; 0 is a point.
    pub light_radius_mm: Option<f64>,
    /// Distance from the centre of tilt to the camera's pupil; omit it for a telecentric lens. Above 0.
    pub camera_distance_mm: Option<f64>,
    /// Radius of the lens's pupil where its distance is given; 0 is a point.
    pub lens_radius_mm: Option<f64>,
    /// Standard uncertainty of the inclination of a sample's mean plane to the turntable. Default: not stated (reported as
    /// left out), 0 to 10.
    pub sample_wedge_std_deg: Option<f64>,
    /// Standard uncertainty of `theta_l_deg`. Default: not stated (reported as left out), 0 to 10.
    pub theta_l_std_deg: Option<f64>,
    /// Standard uncertainty of the tilt beyond the offset that a fit determines. Default: not stated (0.02 is assumed and
    /// reported), 0 to 10.
    pub theta_c_std_deg: Option<f64>,
    /// The same for the sample's rotation.
    pub phi_s_std_deg: Option<f64>,
    /// Relative standard uncertainty of the lamp's drift between white reference and sample. Default: not stated (0.001 is
    /// assumed and reported), 0 to 1.
    pub lamp_drift_std: Option<f64>,
}

impl Default for RigSection {
    fn default() -> Self {
        RigSection {
            theta_l_deg: 10.0,
            light_azimuth_deg: 0.0,
            azimuth_zero_deg: 0.0,
            azimuth_zero_std_deg: None,
            light_angular_radius_deg: None,
            lens_angular_radius_deg: None,
            wavelength_nm: 550.0,
            tilt_centre_px: None,
            rotation_axis_px: None,
            light_distance_mm: None,
            light_radius_mm: None,
            camera_distance_mm: None,
            lens_radius_mm: None,
            sample_wedge_std_deg: None,
            theta_l_std_deg: None,
            theta_c_std_deg: None,
            phi_s_std_deg: None,
            lamp_drift_std: None,
        }
    }
}

/// `[camera]`: the program that delivers frames, and what the camera's data sheet says.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CameraSection {
    /// Folder into which the camera's program writes frames. Required for a real rig.
    pub folder: Option<PathBuf>,
    /// Program and arguments run for each frame; `{file}`, `{kind}`, `{theta_c_deg}`, `{phi_s_deg}`, `{exposure_s}`,
    /// `{exposure_ms}` and `{repeat}` are filled in. Empty: the camera writes frames without being called.
    pub command: Vec<String>,
    /// How long to wait for a frame beyond its exposure, s. Default 30, 0.1 to 3600.
    pub timeout_s: f64,
    /// Whether a frame's file is deleted from the folder once it is in the store. Default false.
    pub delete_read_frames: bool,
    /// Serial number of the camera, as its program states it with the frames; another one is refused. Default: that of a scan's
    /// first frame.
    pub serial: Option<String>,
    /// Deviation of the camera's clock that a stated start of the exposure may have, s. Default 0.05, 0 to 3600.
    pub clock_tolerance_s: f64,
    /// Set point of the sensor's temperature, °C; a scan is suspended while the camera states another one. Default: not checked,
    /// −273 to 200.
    pub temperature_c: Option<f64>,
    /// Largest deviation from it, K; the scan resumes at half of it. Default 1, 0.01 to 100.
    pub temperature_tolerance_k: f64,
    /// Columns of a frame. Default 128, 1 to 65535.
    pub width_px: u32,
    /// Rows of a frame. Default 128, 1 to 65535.
    pub height_px: u32,
    /// Width of the field in the plane through the centre of tilt. Above 0.
    pub field_width_mm: Option<f64>,
    /// Height of the field. Above 0.
    pub field_height_mm: Option<f64>,
    /// Column and row of the foot of a near camera's optical axis. Default: `rig.tilt_centre_px`.
    pub principal_point_px: Option<[f64; 2]>,
    /// Bits of the converter. Default 16, 1 to 16.
    pub bit_depth: u32,
    /// Count at which a pixel saturates. Default: the largest count of the converter. 1 to 65535.
    pub saturation_dn: Option<f64>,
    /// Counts per electron. Default 1, above 0.
    pub gain_dn_per_electron: f64,
    /// Count without light. Default 0, 0 to 65535.
    pub black_level_dn: f64,
    /// Read noise. Default 2, 0 to 65535.
    pub read_noise_electrons_rms: f64,
    /// Dark current, which a frame under the cap may show in addition to `scan.capped_mean_dn_max`. Default 0, 0 to 1e6.
    pub dark_current_electrons_per_s: f64,
    /// Exposures of a sample. Default 0.02, 0.06, 0.18; each 1e-6 to 3600.
    pub exposures_s: Vec<f64>,
    /// Relative standard uncertainty of an exposure time (shutter, clock). Default: not stated (0.001 where the camera's
    /// linearity is tested), 0 to 0.1.
    pub exposure_rel_std: Option<f64>,
}

impl Default for CameraSection {
    fn default() -> Self {
        CameraSection {
            folder: None,
            command: Vec::new(),
            timeout_s: 30.0,
            delete_read_frames: false,
            serial: None,
            clock_tolerance_s: 0.05,
            temperature_c: None,
            temperature_tolerance_k: 1.0,
            width_px: 128,
            height_px: 128,
            field_width_mm: None,
            field_height_mm: None,
            principal_point_px: None,
            bit_depth: 16,
            saturation_dn: None,
            gain_dn_per_electron: 1.0,
            black_level_dn: 0.0,
            read_noise_electrons_rms: 2.0,
            dark_current_electrons_per_s: 0.0,
            exposures_s: vec![0.02, 0.06, 0.18],
            exposure_rel_std: None,
        }
    }
}

/// `[flat]`: the white reference and how it is photographed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FlatSection {
    /// Diffuse reflectance from the certificate. Default 0.99, above 0 and at most 1.2.
    pub reflectance: f64,
    /// Its standard uncertainty. Default 0.005, above 0 and at most 0.5.
    pub reflectance_std: f64,
    /// Number, date and laboratory of its certificate, for reports. Default: not stated; at most 200 characters.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub certificate: Option<String>,
    /// Exposures of the white reference, which is brighter than most samples. Default: those of the
    /// sample.
    pub exposures_s: Option<Vec<f64>>,
    /// Frames per tilt and exposure. Default 1, 0 to 1000.
    pub repeats: u32,
    /// How long its frames are valid, h. Default 24, 0 to 8760.
    pub valid_h: f64,
}

impl Default for FlatSection {
    fn default() -> Self {
        FlatSection {
            reflectance: 0.99,
            reflectance_std: 0.005,
            certificate: None,
            exposures_s: None,
            repeats: 1,
            valid_h: 24.0,
        }
    }
}

/// `[dark]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DarkSection {
    /// Frames per exposure. Default 4, 0 to 1000.
    pub repeats: u32,
    /// How long its frames are valid, h. Default 24, 0 to 8760.
    pub valid_h: f64,
}

impl Default for DarkSection {
    fn default() -> Self {
        DarkSection {
            repeats: 4,
            valid_h: 24.0,
        }
    }
}

/// `[scan]`: how a scan deals with faults.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ScanSection {
    /// Attempts at one pose before the reaction to its fault follows. Default 3, 1 to 100.
    pub attempts_max: u32,
    /// Wait before the first retry after a fault of stage or camera, s; doubles with each further one. Default 1, 0 to 3600.
    pub retry_after_s: f64,
    /// Longest wait between retries, s. Default 30, 0 to 3600.
    pub retry_after_max_s: f64,
    /// How long a lost link to the stages is reconnected, s. Default 20, 0 to 86 400.
    pub reconnect_for_s: f64,
    /// Whether axes are homed without a person after their controller restarted. Default false: the scan pauses.
    pub home_after_power_cycle: bool,
    /// What follows when retries did not help: pause, skip (the point) or abort.
    pub reactions: Reactions,
    /// Points of the sample between two checks of a reference pose. Default 20, 0 (none) to 1 000 000.
    pub reference_every: u32,
    /// Largest time of such a check as a share of the time of the points that it covers. Default 0.2, 0 to 10.
    pub reference_time_share: f64,
    /// Largest change of the picture at a reference pose, of level or pattern. Default 0.02, 0.001 to 1.
    pub reference_change_max: f64,
    /// Share of a picture without light from which the frame is rejected. Default 0.4, 0.01 to 1; above 1 never.
    pub unlit_share_max: f64,
    /// Times that a scan is suspended and resumes by itself before it pauses for a person. Default 10, 0 to 1000.
    pub suspend_times_max: u32,
    /// How long the condition of a suspension has to be over, s. Default 10, 0 to 3600.
    pub suspend_calm_s: f64,
    /// Longest suspension, s; then the scan waits for a person. Default 3600, 1 to 86 400.
    pub suspend_for_max_s: f64,
    /// Counts above the black level that a frame under the cap may show in addition to dark current. Default 100, 0 to 65535.
    pub capped_mean_dn_max: f64,
    /// Whether the daemon fits a scan once it is completed. Default true.
    pub fit_at_end: bool,
}

impl Default for ScanSection {
    fn default() -> Self {
        ScanSection {
            attempts_max: 3,
            retry_after_s: 1.0,
            retry_after_max_s: 30.0,
            reconnect_for_s: 20.0,
            home_after_power_cycle: false,
            reactions: Reactions::default(),
            reference_every: 20,
            reference_time_share: 0.2,
            reference_change_max: 0.02,
            unlit_share_max: 0.4,
            suspend_times_max: 10,
            suspend_calm_s: 10.0,
            suspend_for_max_s: 3600.0,
            capped_mean_dn_max: 100.0,
            fit_at_end: true,
        }
    }
}

/// `[queue]`
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct QueueSection {
    /// What follows a failed order: stop (the queue waits for a person) or end (the order waits again at the end, once). Default
    /// stop.
    pub on_failure: OnFailure,
}

impl ScanSection {
    /// The same as the runner applies it.
    #[must_use]
    pub fn fault_policy(&self) -> FaultPolicy {
        FaultPolicy {
            attempts_max: self.attempts_max,
            retry_after: Duration::from_secs_f64(self.retry_after_s),
            retry_after_max: Duration::from_secs_f64(self.retry_after_max_s),
            reconnect_for: Duration::from_secs_f64(self.reconnect_for_s),
            home_after_power_cycle: self.home_after_power_cycle,
            reactions: self.reactions,
        }
    }
}
