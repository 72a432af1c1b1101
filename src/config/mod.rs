//! All settings of the daemon with unit, default and range: one TOML file, overridden by environment variables.
//!
//! [`Config::read`] is the one function to call; it checks all settings and names file, line, key, allowed values and
//! remedy. No other module reads settings from the environment. The variable of a key is `RIDGED_` and the key's path in
//! capitals, parts joined by two underscores: `RIDGED_STAGE__THETA_C__LIMIT_MAX_DEG=45`.

mod bounds;
mod checks;
mod due;
mod sections;
mod unattended;

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::bench::stage::{PortAddress, StageSettings};
use crate::bench::watched_value::WatchedValue;
use crate::scan::plan::PlanDefaults;
use crate::series::{CameraFacts, FlatFacts, RigFacts};
use crate::wording::toml_text::{self, Refused};

pub use due::DueSection;
pub use sections::{
    CameraSection, DarkSection, FlatSection, ImportSection, QueueSection, RigSection, ScanSection,
    ServerSection, StoreSection,
};
pub use unattended::{HooksSection, LampSection, ParkSection};

/// All settings. Sections and keys are those of the file.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// Port of the stages, as `/dev/serial/by-id/…` or `tcp://host:port`. Required for a real rig.
    pub port: Option<PortAddress>,
    /// HTTP.
    pub server: ServerSection,
    /// The data folder.
    pub store: StoreSection,
    /// What imports may read.
    pub import: ImportSection,
    /// The two axes. Required for a real rig, since only the lab knows how far they may travel.
    pub stage: Option<StageSettings>,
    /// Positions of lamp and camera.
    pub rig: RigSection,
    /// The camera: how it delivers frames, and what their counts mean.
    pub camera: CameraSection,
    /// The white reference.
    pub flat: FlatSection,
    /// Dark frames.
    pub dark: DarkSection,
    /// How a scan deals with faults.
    pub scan: ScanSection,
    /// The queue of parts.
    pub queue: QueueSection,
    /// What is measured again at intervals.
    pub due: DueSection,
    /// Programs run at events.
    pub hooks: HooksSection,
    /// Commands that switch the lamp.
    pub lamp: LampSection,
    /// Where the axes are parked. Default: they stay where they are.
    pub park: Option<ParkSection>,
    /// Values of external programs outside whose limits a scan is suspended.
    pub suspend: Vec<WatchedValue>,
}

/// Why the settings cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("the configuration file {} cannot be read; check the path given to --config", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// Error of the operating system.
        source: std::io::Error,
    },
    /// The text is not TOML, a key is unknown or a value has the wrong type.
    #[error("{origin}: {detail}; ridged.example.toml shows every key")]
    Malformed {
        /// File and line, or variable.
        origin: String,
        /// The key, what is wrong with it and what is allowed.
        detail: String,
    },
    /// A value is out of its range.
    #[error("{origin}: {key} is {found}, expected {allowed}; ridged.example.toml shows every key")]
    OutOfRange {
        /// File and line, or variable.
        origin: String,
        /// Path of the key.
        key: String,
        /// The value found.
        found: String,
        /// The allowed values.
        allowed: String,
    },
}

impl Config {
    /// Reads settings: defaults, then `file` if given, then `environment` (name and value).
    ///
    /// # Errors
    /// [`ConfigError`] names the place, the key and the allowed values.
    pub fn read(
        file: Option<&Path>,
        environment: impl IntoIterator<Item = (String, String)>,
    ) -> Result<Config, ConfigError> {
        let (text, origin) = match file {
            None => (String::new(), "settings".to_owned()),
            Some(path) => (
                std::fs::read_to_string(path).map_err(|source| ConfigError::Unreadable {
                    path: path.into(),
                    source,
                })?,
                path.display().to_string(),
            ),
        };
        Config::from_text(&text, &origin, environment)
    }

    /// Reads settings from a text; `origin` names it in messages.
    ///
    /// # Errors
    /// As [`Config::read`].
    pub fn from_text(
        text: &str,
        origin: &str,
        environment: impl IntoIterator<Item = (String, String)>,
    ) -> Result<Config, ConfigError> {
        // The file is read by itself first, so that a mistake in it is reported with its line.
        let malformed = |origin: &str, refused: Refused| ConfigError::Malformed {
            origin: match refused.line {
                Some(line) => format!("{origin}, line {line}"),
                None => origin.into(),
            },
            detail: Refused {
                line: None,
                ..refused
            }
            .to_string(),
        };
        toml_text::read::<Config>(text).map_err(|refused| malformed(origin, refused))?;
        let mut table: toml::Table = toml_text::read(text).unwrap_or_default();
        let mut variables = Vec::new();
        for (name, value) in environment {
            let Some(path) = name.strip_prefix("RIDGED_").filter(|p| p.contains("__")) else {
                continue;
            };
            let path = path.to_lowercase();
            set(&mut table, &path, &value);
            // One variable at a time, so that the wrong one is named.
            toml_text::of_table::<Config>(table.clone())
                .map_err(|refused| malformed(&format!("environment variable {name}"), refused))?;
            variables.push((path.replace("__", "."), name));
        }
        let config: Config =
            toml_text::of_table(table).map_err(|refused| malformed(origin, refused))?;
        config.check(|key| {
            if let Some((_, name)) = variables.iter().find(|(path, _)| path == key) {
                return format!("environment variable {name}");
            }
            match toml_text::line_of(text, key) {
                Some(line) => format!("{origin}, line {line}"),
                None => origin.to_owned(),
            }
        })?;
        Ok(config)
    }

    /// `[rig]` of the manifests of this rig's scans.
    #[must_use]
    pub fn rig_facts(&self) -> RigFacts {
        let rig = &self.rig;
        let distance = |mm: Option<f64>| mm.map(|_| "finite".to_owned());
        let light_angular_radius_deg = rig
            .light_angular_radius_deg
            .or_else(|| rig.light_radius_mm.is_none().then_some(USUAL_LAMP_DEG));
        RigFacts {
            theta_l_deg: rig.theta_l_deg,
            light_azimuth_deg: rig.light_azimuth_deg,
            azimuth_zero_deg: rig.azimuth_zero_deg,
            azimuth_zero_std_deg: rig.azimuth_zero_std_deg,
            light_angular_radius_deg,
            lens_angular_radius_deg: rig.lens_angular_radius_deg,
            wavelength_nm: Some(rig.wavelength_nm),
            tilt_centre_px: rig.tilt_centre_px,
            rotation_axis_px: rig.rotation_axis_px,
            light_distance: distance(rig.light_distance_mm),
            camera_distance: distance(rig.camera_distance_mm),
            light_distance_mm: rig.light_distance_mm,
            light_radius_mm: rig.light_radius_mm,
            camera_distance_mm: rig.camera_distance_mm,
            lens_radius_mm: rig.lens_radius_mm,
            sample_wedge_std_deg: rig.sample_wedge_std_deg,
            theta_l_std_deg: rig.theta_l_std_deg,
            theta_c_std_deg: rig.theta_c_std_deg,
            phi_s_std_deg: rig.phi_s_std_deg,
            lamp_drift_std: rig.lamp_drift_std,
            notes: Default::default(),
        }
    }

    /// `[camera]` of the manifests of this rig's scans.
    #[must_use]
    pub fn camera_facts(&self) -> CameraFacts {
        let camera = &self.camera;
        let projection = match self.rig.camera_distance_mm {
            Some(_) => "perspective",
            None => "orthographic",
        };
        CameraFacts {
            projection: projection.into(),
            width_px: camera.width_px,
            height_px: camera.height_px,
            field_width_mm: camera.field_width_mm,
            field_height_mm: camera.field_height_mm,
            bit_depth: Some(camera.bit_depth),
            saturation_dn: camera.saturation_dn,
            gain_dn_per_electron: camera.gain_dn_per_electron,
            black_level_dn: Some(camera.black_level_dn),
            read_noise_electrons_rms: Some(camera.read_noise_electrons_rms),
            exposures_s: camera.exposures_s.clone(),
            camera_distance_mm: self.rig.camera_distance_mm,
            principal_point_px: camera.principal_point_px,
            exposure_rel_std: camera.exposure_rel_std,
            notes: Default::default(),
        }
    }

    /// `[flat]` of the manifests of this rig's scans.
    #[must_use]
    pub fn flat_facts(&self) -> FlatFacts {
        FlatFacts {
            reflectance: Some(self.flat.reflectance),
            reflectance_std: Some(self.flat.reflectance_std),
            notes: self
                .flat
                .certificate
                .iter()
                .map(|text| (FlatFacts::CERTIFICATE.to_owned(), text.as_str().into()))
                .collect(),
        }
    }

    /// Defaults of a plan.
    #[must_use]
    pub fn plan_defaults(&self) -> PlanDefaults {
        PlanDefaults {
            exposures_s: self.camera.exposures_s.clone(),
            flat_exposures_s: self
                .flat
                .exposures_s
                .clone()
                .unwrap_or_else(|| self.camera.exposures_s.clone()),
            dark_repeats: self.dark.repeats,
            flat_repeats: self.flat.repeats,
            reference_every: self.scan.reference_every,
        }
    }
}

/// Half angle, in degrees, of a lamp whose size the settings do not state: that of the LED of the recorded series.
const USUAL_LAMP_DEG: f64 = 1.0;

/// Sets `a__b__c` in a table; a value that is not TOML counts as text.
fn set(table: &mut toml::Table, path: &str, value: &str) {
    let parsed = toml::from_str::<toml::Table>(&format!("x = {value}"))
        .ok()
        .and_then(|mut t| t.remove("x"))
        .unwrap_or_else(|| toml::Value::String(value.into()));
    let mut table = table;
    let mut parts = path.split("__").peekable();
    while let Some(part) = parts.next() {
        if parts.peek().is_none() {
            table.insert(part.into(), parsed);
            return;
        }
        let next = table
            .entry(part)
            .or_insert_with(|| toml::Value::Table(toml::Table::new()));
        match next {
            toml::Value::Table(inner) => table = inner,
            // The reader will refuse this, since it is not a table.
            other => {
                *other = parsed;
                return;
            }
        }
    }
}

#[cfg(test)]
mod tests;
