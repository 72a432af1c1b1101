//! All settings of the daemon with unit, default and range: one TOML file, overridden by environment variables.
//!
//! [`Config::read`] is the one function to call; it checks all settings and names file, line, key, allowed values and
//! remedy. No other module reads settings from the environment. The variable of a key is `RIDGED_` and the key's path in
//! capitals, parts joined by two underscores: `RIDGED_STAGE__THETA_C__LIMIT_MAX_DEG=45`.

mod bounds;
mod due;
mod sections;
mod unattended;

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::bench::stage::{PortAddress, StageError, StageSettings};
use crate::bench::watched_value::WatchedValue;
use crate::geometry::Pose;
use crate::scan::plan::{EXPOSURE_S_MAX, EXPOSURE_S_MIN, PlanDefaults};
use crate::series::{CameraFacts, FlatFacts, RigFacts, misaimed};
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

    fn check(&self, origin_of: impl Fn(&str) -> String) -> Result<(), ConfigError> {
        let checked = self
            .check_numbers()
            .and_then(|()| self.check_exposures())
            .and_then(|()| self.check_certificate())
            .and_then(|()| self.check_camera())
            .and_then(|()| self.check_stage())
            .and_then(|()| self.check_park())
            .and_then(|()| self.check_access())
            .and_then(|()| self.check_due())
            .and_then(|()| self.check_suspend());
        checked.map_err(|wrong| ConfigError::OutOfRange {
            origin: origin_of(&wrong.key),
            key: wrong.key,
            found: wrong.found,
            allowed: wrong.allowed,
        })
    }

    fn check_numbers(&self) -> Result<(), WrongSetting> {
        for (key, limit, of) in bounds::BOUNDED {
            match of(self) {
                Some(value) if !limit.holds(value) => {
                    return Err(WrongSetting::new(*key, value.to_string(), limit.allowed()));
                }
                _ => {}
            }
        }
        Ok(())
    }

    fn check_exposures(&self) -> Result<(), WrongSetting> {
        let camera = self.camera.exposures_s.as_slice();
        let flat = self.flat.exposures_s.as_deref().unwrap_or(camera);
        for (key, list) in [("camera.exposures_s", camera), ("flat.exposures_s", flat)] {
            let fine = |s: &f64| (EXPOSURE_S_MIN..=EXPOSURE_S_MAX).contains(s);
            if list.is_empty() || !list.iter().all(fine) {
                let allowed = format!("one or more of {EXPOSURE_S_MIN} to {EXPOSURE_S_MAX} s");
                return Err(WrongSetting::new(key, format!("{list:?}"), allowed));
            }
        }
        Ok(())
    }

    fn check_certificate(&self) -> Result<(), WrongSetting> {
        match &self.flat.certificate {
            Some(text) if text.trim().is_empty() || text.chars().count() > 200 => {
                let found = format!("{} characters", text.chars().count());
                let allowed = "a text of 1 to 200 characters";
                Err(WrongSetting::new("flat.certificate", found, allowed))
            }
            _ => Ok(()),
        }
    }

    /// Checks settings that depend on each other.
    fn check_camera(&self) -> Result<(), WrongSetting> {
        if let Some(found) = self.camera_facts().contradiction() {
            let key = format!("camera.{}", found.key);
            return Err(WrongSetting::new(
                key,
                found.value.to_string(),
                found.allowed,
            ));
        }
        let (facts, camera) = (self.rig_facts(), self.camera_facts());
        if let Some(allowed) = misaimed(&facts, &camera, facts.camera_distance_mm) {
            let found = format!("{:?}", camera.principal_point_px.unwrap_or_default());
            return Err(WrongSetting::new(
                "camera.principal_point_px",
                found,
                allowed,
            ));
        }
        let rig = &self.rig;
        let (lamp, lens) = (rig.light_angular_radius_deg, rig.lens_angular_radius_deg);
        for (key, radius_mm, distance, spans) in [
            (
                "rig.light_radius_mm",
                rig.light_radius_mm,
                "light_distance_mm",
                rig.light_distance_mm.or(lamp),
            ),
            (
                "rig.lens_radius_mm",
                rig.lens_radius_mm,
                "camera_distance_mm",
                rig.camera_distance_mm.or(lens),
            ),
        ] {
            if let (Some(radius_mm), None) = (radius_mm, spans) {
                let allowed = format!("only beside {distance}, without which it spans no angle");
                return Err(WrongSetting::new(key, radius_mm.to_string(), allowed));
            }
        }
        Ok(())
    }

    fn check_stage(&self) -> Result<(), WrongSetting> {
        if self.port.is_some() && self.stage.is_none() {
            let allowed = "address, limit_min_deg and limit_max_deg of both axes";
            return Err(WrongSetting::new("stage", "missing beside a port", allowed));
        }
        match self.stage.as_ref().map(StageSettings::validate) {
            None | Some(Ok(())) => Ok(()),
            Some(Err(StageError::BadSetting {
                key,
                found,
                allowed,
            })) => Err(WrongSetting::new(format!("stage.{key}"), found, allowed)),
            Some(Err(other)) => Err(WrongSetting::new(
                "stage",
                other.to_string(),
                "a setting that a stage supports",
            )),
        }
    }

    fn check_park(&self) -> Result<(), WrongSetting> {
        let Some(park) = self.park else {
            return Ok(());
        };
        for (key, deg) in [
            ("park.theta_c_deg", park.theta_c_deg),
            ("park.phi_s_deg", park.phi_s_deg),
        ] {
            if !deg.is_finite() {
                return Err(WrongSetting::new(key, deg.to_string(), "a finite angle"));
            }
        }
        // A simulated rig has its own limits, which are checked when it is assembled.
        let Some(stage) = &self.stage else {
            return Ok(());
        };
        let target = Pose::from_deg(park.theta_c_deg, park.phi_s_deg);
        if let Err(StageError::OutsideLimits {
            axis,
            target,
            min,
            max,
        }) = stage.check_limits(target)
        {
            return Err(WrongSetting::new(
                format!("park.{axis}_deg"),
                target.to_string(),
                format!("{min} to {max}, the limits of {axis}"),
            ));
        }
        match stage.region_at(target) {
            Some(region) => Err(WrongSetting::new(
                "park",
                format!("in the forbidden region {region}"),
                "a place outside the forbidden regions",
            )),
            None => Ok(()),
        }
    }

    fn check_access(&self) -> Result<(), WrongSetting> {
        let server = &self.server;
        for (key, given, other) in [
            ("server.tls_key", &server.tls_key, &server.tls_cert),
            ("server.tls_cert", &server.tls_cert, &server.tls_key),
        ] {
            if given.is_none() && other.is_some() {
                let allowed = "the files of both: server.tls_cert and server.tls_key";
                return Err(WrongSetting::new(key, "missing", allowed));
            }
        }
        let hosts = server.hosts.iter().flatten();
        let is_name = |host: &&String| {
            let part = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '.' | '_');
            !host.is_empty() && host.chars().all(part)
        };
        if let Some(host) = hosts.clone().find(|host| !is_name(host)) {
            let allowed = "names without scheme and port, like lab-pc.example.org";
            return Err(WrongSetting::new(
                "server.hosts",
                format!("{host:?}"),
                allowed,
            ));
        }
        let roots = self.import.roots.iter().flatten();
        if let Some(root) = roots.clone().find(|root| !root.is_absolute()) {
            let found = root.display().to_string();
            return Err(WrongSetting::new("import.roots", found, "absolute paths"));
        }
        Ok(())
    }

    fn check_due(&self) -> Result<(), WrongSetting> {
        let Some((key, found, allowed)) = self.due.fault() else {
            return Ok(());
        };
        Err(WrongSetting::new(key, found, allowed))
    }

    fn check_suspend(&self) -> Result<(), WrongSetting> {
        for (i, value) in self.suspend.iter().enumerate() {
            if let Some((key, allowed)) = value.invalid() {
                let found = format!("invalid in {:?}", value.name);
                return Err(WrongSetting::new(
                    format!("suspend[{i}].{key}"),
                    found,
                    allowed,
                ));
            }
        }
        Ok(())
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

/// A setting with a value that is not allowed.
struct WrongSetting {
    key: String,
    found: String,
    allowed: String,
}

impl WrongSetting {
    fn new(
        key: impl Into<String>,
        found: impl Into<String>,
        allowed: impl Into<String>,
    ) -> WrongSetting {
        WrongSetting {
            key: key.into(),
            found: found.into(),
            allowed: allowed.into(),
        }
    }
}

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
mod tests {
    use super::*;

    fn read(text: &str, environment: &[(&str, &str)]) -> Result<Config, ConfigError> {
        Config::from_text(
            text,
            "rig.toml",
            environment
                .iter()
                .map(|(k, v)| ((*k).to_owned(), (*v).to_owned())),
        )
    }

    #[test]
    fn an_empty_file_means_the_defaults() {
        assert_eq!(read("", &[]).unwrap(), Config::default());
    }

    #[test]
    fn the_example_file_is_read_and_names_every_section() {
        let text = include_str!("../../ridged.example.toml");
        let config = read(text, &[]).unwrap();
        assert!(config.port.is_some() && config.camera.folder.is_some());
        for section in [
            "server", "import", "store", "stage", "rig", "camera", "flat", "dark", "scan", "hooks",
            "lamp", "park", "due",
        ] {
            assert!(text.contains(&format!("[{section}]")), "{section}");
        }
    }

    #[test]
    fn the_example_file_shows_every_key() {
        let example = include_str!("../../ridged.example.toml");
        // serde names all keys of a table where it refuses one.
        let keys_of = |table: &str| -> Vec<String> {
            let probe = match table {
                "" => "nothing = 1".to_owned(),
                _ => format!("[{table}]\nnothing = 1"),
            };
            let error = toml::from_str::<Config>(&probe).unwrap_err();
            let Some((_, names)) = error.message().split_once("unknown field `nothing`") else {
                return Vec::new();
            };
            names
                .split('`')
                .skip(1)
                .step_by(2)
                .map(str::to_owned)
                .collect()
        };
        let mut tables = vec![String::new()];
        let mut count = 0;
        while let Some(table) = tables.pop() {
            for key in keys_of(&table) {
                let word = |c: char| !(c.is_ascii_alphanumeric() || c == '_');
                assert!(example.split(word).any(|w| w == key), "{table}.{key}");
                count += 1;
                tables.push(match table.as_str() {
                    "" => key,
                    _ => format!("{table}.{key}"),
                });
            }
        }
        assert!(count > 80, "{count}");
    }

    #[test]
    fn a_place_to_park_is_within_the_limits() {
        let example = include_str!("../../ridged.example.toml");
        let config = read(example, &[]).unwrap();
        assert!(config.park.is_none() && config.hooks.paused.is_empty());
        let text = format!("{example}\n[park]\ntheta_c_deg = 0.0\nphi_s_deg = 370.0\n");
        let error = read(&text, &[]).unwrap_err().to_string();
        for part in ["park.phi_s_deg", "370", "-5", "365"] {
            assert!(error.contains(part), "{part} is not in: {error}");
        }
        let text = format!(
            "{example}\n[park]\ntheta_c_deg = 45.0\nphi_s_deg = 90.0\n\n[stage.homing]\norder = \"theta_c-first\"\n\n[[stage.forbidden]]\nname = \"lamp arm\"\n\
            theta_c_deg = [30.0, 60.0]\nphi_s_deg = [80.0, 100.0]\n"
        );
        let error = read(&text, &[]).unwrap_err().to_string();
        for part in ["park is in the forbidden region", "lamp arm", "outside"] {
            assert!(error.contains(part), "{part} is not in: {error}");
        }
        let text = "[park]\ntheta_c_deg = nan\nphi_s_deg = 0.0\n";
        assert!(read(text, &[]).is_err());
        let hooks = "[hooks]\npaused = [\"mail\", \"me\"]\ntime_limit_s = 0.0\n";
        let error = read(hooks, &[]).unwrap_err().to_string();
        assert!(
            error.contains("hooks.time_limit_s is 0, expected"),
            "{error}"
        );
    }

    #[test]
    fn an_unknown_key_is_named_with_its_line_and_what_was_meant() {
        let error = read("[camera]\nwidth_px = 10\nheigth_px = 10\n", &[])
            .unwrap_err()
            .to_string();
        for part in ["rig.toml", "line 3", "heigth_px", "height_px"] {
            assert!(error.contains(part), "{part} is not in: {error}");
        }
    }

    #[test]
    fn a_value_out_of_range_is_named_with_line_and_range() {
        let error = read("[rig]\n\ntheta_l_deg = 100.0\n", &[])
            .unwrap_err()
            .to_string();
        for part in ["rig.toml, line 3", "rig.theta_l_deg", "100", "0 to 90"] {
            assert!(error.contains(part), "{part} is not in: {error}");
        }
        assert!(read("[rig]\ntheta_l_deg = nan", &[]).is_err());
    }

    #[test]
    fn settings_that_contradict_each_other_are_refused_with_both() {
        for (text, words) in [
            (
                "[camera]\nbit_depth = 12\nsaturation_dn = 65535.0\n",
                [
                    "line 3",
                    "camera.saturation_dn is 65535",
                    "at most 4095",
                    "bit_depth = 12",
                ],
            ),
            (
                "[camera]\nbit_depth = 8\nblack_level_dn = 300.0\n",
                [
                    "line 3",
                    "camera.black_level_dn is 300",
                    "below 255",
                    "full",
                ],
            ),
            (
                "[rig]\nlight_radius_mm = 3.0\n",
                [
                    "line 2",
                    "rig.light_radius_mm is 3",
                    "light_distance_mm",
                    "angle",
                ],
            ),
        ] {
            let error = read(text, &[]).unwrap_err().to_string();
            for part in words {
                assert!(error.contains(part), "{part} is not in: {error}");
            }
        }
        // The check does not depend on which of the two comes from a variable.
        let variable = ("RIDGED_CAMERA__BIT_DEPTH", "10");
        let error = read("[camera]\nsaturation_dn = 4095.0\n", &[variable]);
        assert!(error.unwrap_err().to_string().contains("bit_depth = 10"));
    }

    #[test]
    fn uncertainties_of_stages_and_lamp_go_into_the_manifests() {
        let text = "[rig]\ntheta_c_std_deg = 0.1\nphi_s_std_deg = 0.05\nlamp_drift_std = 0.002\n";
        let rig = read(text, &[]).unwrap().rig_facts();
        assert_eq!(rig.theta_c_std_deg, Some(0.1));
        assert_eq!(rig.phi_s_std_deg, Some(0.05));
        assert_eq!(rig.lamp_drift_std, Some(0.002));
        assert_eq!(read("", &[]).unwrap().rig_facts().lamp_drift_std, None);
        let error = read("[rig]\nphi_s_std_deg = 11.0\n", &[]).unwrap_err();
        let error = error.to_string();
        for part in ["line 2", "rig.phi_s_std_deg is 11", "0 to 10"] {
            assert!(error.contains(part), "{part} is not in: {error}");
        }
    }

    #[test]
    fn settings_of_access_that_protect_nothing_are_refused() {
        for (text, words) in [
            (
                "[server]\ntls_cert = \"a.pem\"\n",
                ["server.tls_key", "tls_cert and server.tls_key"],
            ),
            (
                "[server]\nhosts = [\"https://lab:8787\"]\n",
                ["server.hosts", "without scheme"],
            ),
            (
                "[import]\nroots = [\"data\"]\n",
                ["import.roots", "absolute"],
            ),
            ("[server]\nproxies = [\"proxy\"]\n", ["line 2", "proxies"]),
        ] {
            let error = read(text, &[]).unwrap_err().to_string();
            for part in words {
                assert!(error.contains(part), "{part} is not in: {error}");
            }
        }
        let roots = ("RIDGED_IMPORT__ROOTS", "[\"/srv\"]");
        let config = read("", &[roots]).unwrap();
        assert_eq!(config.import.roots, Some(vec!["/srv".into()]));
    }

    #[test]
    fn a_wrong_type_and_a_garbled_file_are_named_with_their_line() {
        for (text, line) in [
            ("[camera]\nwidth_px = \"wide\"\n", "line 2"),
            ("[camera\nwidth_px = 3\n", "line 1"),
            ("\u{0}\u{1}garbage", "line 1"),
        ] {
            let error = read(text, &[]).unwrap_err().to_string();
            assert!(error.contains(line), "{line} is not in: {error}");
            for word in ["u32", "f64", "expected struct", "invalid type"] {
                assert!(!error.contains(word), "{word} is in: {error}");
            }
        }
        let error = read("", &[("RIDGED_CAMERA__WIDTH_PX", "wide")]).unwrap_err();
        let words = "environment variable RIDGED_CAMERA__WIDTH_PX: camera.width_px: expected a whole number from 0 to 4294967295, got \"wide\"";
        assert!(error.to_string().starts_with(words), "{error}");
    }

    #[test]
    fn a_stage_setting_out_of_range_is_named_with_its_line() {
        let text =
            include_str!("../../ridged.example.toml").replace("address = 2 ", "address = 200 ");
        let text = text.replace("address = 2\n", "address = 200\n");
        let error = read(&text, &[]).unwrap_err().to_string();
        for part in ["line ", "stage.phi_s.address", "1 to 99"] {
            assert!(error.contains(part), "{part} is not in: {error}");
        }
        let error = read("port = \"/dev/ttyUSB0\"", &[])
            .unwrap_err()
            .to_string();
        assert!(error.contains("limit_min_deg"), "{error}");
    }

    #[test]
    fn the_environment_wins_and_is_named_when_it_is_wrong() {
        let text = "[flat]\nreflectance = 0.5\n";
        let config = read(text, &[("RIDGED_FLAT__REFLECTANCE", "0.9")]).unwrap();
        assert_eq!(config.flat.reflectance, 0.9);
        let config = read("", &[("RIDGED_STORE__FOLDER", "/srv/data")]).unwrap();
        assert_eq!(config.store.folder, PathBuf::from("/srv/data"));
        for variable in [
            ("RIDGED_FLAT__REFLECTANCE", "7"),
            ("RIDGED_FLAT__REFLECTANCE", "0"),
            ("RIDGED_FLAT__REFLEKTANCE", "0.9"),
            ("RIDGED_FLAT__REFLECTANCE", "bright"),
        ] {
            let error = read(text, &[variable]).unwrap_err().to_string();
            assert!(error.contains(variable.0), "{error}");
        }
    }
}
