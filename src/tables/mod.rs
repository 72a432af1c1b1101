//! BRDF tables from goniometers (`brdf-table-1`): a folder with `manifest.toml` and a CSV or a BiRD
//! JSON file.
//!
//! Call [`is_table`] to distinguish such a folder from a recorded series, [`BrdfTable::open`] to
//! read it, and [`BrdfTable::observations`] for the input of a fit. Lamp and detector move freely,
//! so every observation has its own directions. The scale is that of the table, and there are no
//! flats.

mod bird;
pub mod bird_out;
mod columns;
mod half_vectors;
mod light;
mod manifest;
pub mod rgl_out;
mod rows;
mod tensor_file;

use std::path::Path;

use nalgebra::Vector3;

pub use self::manifest::{AzimuthSense, Goniometer, ValueKind, ValueScale};
pub use self::rows::TableReading;
use crate::geometry::{Cones, Directions, Pose, RigGeometry};
use crate::material::Material;
use crate::observation::{
    Observation, ObservationSet, Prior, SharedErrors, TableRow, View, WhiteReference,
};
use crate::robust;
use crate::series::TABLE_SCHEMA;
use crate::units::Angle;
use crate::wording::encoding;
use crate::wording::sheet::decoded;
use crate::wording::{counted, significant};

/// Largest size of a file, in bytes.
const BYTES_MAX: u64 = 256 << 20;
/// Standard uncertainty of the goniometer's angles and of the sample's inclination, if the manifest
/// does not state one.
const ANGLE_STD_DEFAULT_DEG: f64 = 0.05;
/// Relative standard uncertainty of the absolute scale, if the manifest does not state one.
const SCALE_STD_DEFAULT: f64 = 0.01;
/// Noise, as a share of the value, from which weights by the noisy value bias a fit: by twice its square, 0.1 %.
const NOISY: f64 = 0.02;
/// Share of a reading below which a fitted value does not set its uncertainty.
const TRUSTED: f64 = 0.3;
/// Standard uncertainty of a value, if neither table nor manifest state one: a fraction of the
/// value, and of the largest value.
const VALUE_STD_DEFAULT: f64 = 0.01;
const FLOOR_DEFAULT: f64 = 1e-4;
/// Standard uncertainty of stray light, if not stated, as a fraction of the median signal.
const STRAY_SHARE: f64 = 0.01;

/// Why a folder is not a valid table.
#[derive(Debug, thiserror::Error)]
#[error("{file}{}: {cause}", .row.map(|row| format!(" {row}")).unwrap_or_default())]
pub struct TableError {
    /// The file.
    pub file: String,
    /// The line or reading, if known.
    pub row: Option<TableRow>,
    /// The fault and the remedy.
    pub cause: String,
}

impl TableError {
    fn new(file: &str, row: Option<TableRow>, cause: impl Into<String>) -> Self {
        TableError {
            file: file.to_owned(),
            row,
            cause: cause.into(),
        }
    }
}

/// A table that was read.
#[derive(Debug, Clone)]
pub struct BrdfTable {
    /// Name of the sample or series; may be empty.
    pub name: String,
    /// Properties of the goniometer from the manifest.
    pub facts: Goniometer,
    /// Nominal material.
    pub material: Material,
    /// The readings, in the order of the file.
    pub readings: Vec<TableReading>,
    /// Notes on the readings left out.
    pub left_out: Vec<String>,
}

/// Whether a folder contains the manifest of a table.
#[must_use]
pub fn is_table(folder: &Path) -> bool {
    let text = text_of(folder, "manifest.toml").ok();
    let table: Option<toml::Table> =
        text.and_then(|text| toml::from_str(text.trim_start_matches('\u{feff}')).ok());
    table.is_some_and(|t| t.get("schema").and_then(toml::Value::as_str) == Some(TABLE_SCHEMA))
}

impl BrdfTable {
    /// Reads the manifest and the table in a folder.
    ///
    /// # Errors
    /// [`TableError`] names file, line, cause and remedy.
    pub fn open(folder: &Path) -> Result<BrdfTable, TableError> {
        let manifest = manifest::read(&text_of(folder, "manifest.toml")?, "manifest.toml")?;
        let file = &manifest.table;
        let content = content_of(folder, file)?;
        let text = encoding::text_of(&content);
        let text = text.map_err(|cause| TableError::new(file, None, cause))?;
        let is_json = text.trim_start().starts_with(['{', '[']);
        let mut read = match is_json {
            true => bird::read(&text, file, &manifest.facts)?,
            false => rows::read(&text, file, &manifest.facts)?,
        };
        rows::leave_copies_out(&mut read);
        if read.readings.is_empty() {
            return Err(TableError::new(
                file,
                None,
                "the file contains no reading with a value",
            ));
        }
        Ok(BrdfTable {
            name: manifest.name,
            facts: manifest.facts,
            material: manifest.material,
            readings: read.readings,
            left_out: read.left_out,
        })
    }

    /// The input of a fit. Azimuths are converted to count from u towards v, relative to the
    /// manifest's azimuth of v.
    #[must_use]
    pub fn observations(&self) -> ObservationSet {
        let facts = &self.facts;
        let mut warnings = self.left_out.clone();
        let mut assumed = Vec::new();
        let angle = |stated: Option<f64>, key: &'static str, assumed: &mut Vec<String>| {
            let std = stated.unwrap_or_else(|| {
                assumed.push(format!("{key} = {ANGLE_STD_DEFAULT_DEG}"));
                ANGLE_STD_DEFAULT_DEG
            });
            Angle::from_deg(std)
        };
        let theta_std = angle(facts.theta_std_deg, "theta_std_deg", &mut assumed);
        let phi_std = angle(facts.phi_std_deg, "phi_std_deg", &mut assumed);
        let tilt_std = angle(
            facts.sample_tilt_std_deg,
            "sample_tilt_std_deg",
            &mut assumed,
        );
        let absolute = facts.scale == ValueScale::Absolute;
        let scale_std = facts.scale_rel_std.unwrap_or(SCALE_STD_DEFAULT);
        if absolute && facts.scale_rel_std.is_none() {
            assumed.push(format!("scale_rel_std = {SCALE_STD_DEFAULT}"));
        }
        let stated = facts.value_rel_std.is_some() || facts.value_std.is_some();
        let without = self.readings.iter().filter(|r| r.sigma.is_none()).count();
        let largest = self.largest();
        let noise = self.noise();
        if without > 0 && !stated {
            assumed.push(format!(
                "value_rel_std = {VALUE_STD_DEFAULT} and value_std = {} for {}",
                significant(noise.floor),
                counted(without, "reading")
            ));
        }
        if !assumed.is_empty() {
            warnings.push(format!(
                "the manifest does not state these standard uncertainties; assumed in [goniometer]: {}",
                assumed.join(", ")
            ));
        }
        let mut observations = Vec::with_capacity(self.readings.len());
        let mut views = Vec::with_capacity(self.readings.len());
        // A sigma of 0 would outweigh all other readings.
        let least = f64::EPSILON * largest;
        for reading in &self.readings {
            let placed = Placed::new(reading, facts);
            let per_value = facts.value.radiance_per_value(&placed.directions);
            let own = reading.sigma.unwrap_or(noise.of(reading.value));
            let signal = per_value * reading.value;
            observations.push(Observation {
                shared: SharedErrors {
                    white_reference: if absolute { signal * scale_std } else { 0.0 },
                    theta_c_zero: theta_std,
                    phi_s_zero: phi_std,
                    ..SharedErrors::default()
                },
                row: reading.row,
                ..Observation::new(placed.pose, signal, per_value * own.max(least))
            });
            views.push(vec![View {
                directions: placed.directions,
                weight: 1.0,
            }]);
        }
        let mut sizes: Vec<f64> = observations.iter().map(|o| o.signal.abs()).collect();
        let stray = facts
            .stray_std
            .unwrap_or_else(|| STRAY_SHARE * robust::median(&mut sizes).unwrap_or(0.0));
        let rig = RigGeometry {
            theta_l: Angle::ZERO,
            light_azimuth: Angle::ZERO,
            azimuth_zero: Angle::ZERO,
            cones: Cones {
                lamp: Angle::from_deg(facts.light_angular_radius_deg),
                lens: Angle::from_deg(facts.detector_angular_radius_deg),
            },
        };
        let background = Prior {
            mean: 0.0,
            std: stray.max(f64::EPSILON * largest),
        };
        ObservationSet {
            views,
            white_reference: absolute.then_some(WhiteReference {
                reflectance: 1.0,
                reflectance_std: scale_std,
            }),
            // An error common to both arms acts as an inclination of the sample; the rest rotates
            // them relative to each other.
            wedge_std: Some(Angle::from_rad(
                tilt_std
                    .rad()
                    .hypot(theta_std.rad() * std::f64::consts::FRAC_1_SQRT_2),
            )),
            theta_l_std: Some(Angle::from_rad(theta_std.rad() * std::f64::consts::SQRT_2)),
            warnings,
            ..ObservationSet::bare(rig, self.material, observations, background)
        }
    }

    /// The largest value; a negative one is noise or a fault.
    fn largest(&self) -> f64 {
        let values = self.readings.iter().map(|r| r.value);
        values.fold(0.0, f64::max)
    }

    /// The noise of readings without a sigma, as stated or assumed.
    fn noise(&self) -> Noise {
        let facts = &self.facts;
        match facts.value_rel_std.is_some() || facts.value_std.is_some() {
            true => Noise {
                share: facts.value_rel_std.unwrap_or(0.0),
                floor: facts.value_std.unwrap_or(0.0),
            },
            false => Noise {
                share: VALUE_STD_DEFAULT,
                floor: FLOOR_DEFAULT * self.largest(),
            },
        }
    }

    /// Whether readings without a sigma are so noisy that weights by their own values bias a fit.
    #[must_use]
    pub fn is_noisy(&self) -> bool {
        self.noise().share >= NOISY && self.readings.iter().any(|r| r.sigma.is_none())
    }

    /// Gives the observations shares of their fitted signals as uncertainties, in place of shares of the noisy values: a
    /// value that is low by chance would otherwise count most. A fit without a signal for each reading changes nothing.
    #[must_use]
    pub fn weighed_by(&self, mut set: ObservationSet, fitted: &[f64]) -> ObservationSet {
        let noise = self.noise();
        if fitted.len() != self.readings.len() || !fitted.iter().all(|f| f.is_finite()) {
            return set;
        }
        let rows = set.observations.iter_mut().zip(&self.readings);
        for ((o, reading), fitted) in rows.zip(fitted) {
            if reading.sigma.is_none() && o.signal != 0.0 {
                // A fit that misses a lobe must not make its readings certain.
                let size = fitted.abs().max(TRUSTED * o.signal.abs());
                let per_value = o.signal / reading.value;
                o.sigma = (noise.share * size).hypot(noise.floor * per_value);
            }
        }
        set
    }
}

/// Standard uncertainty of readings that state none: a share of the value, and a floor.
#[derive(Debug, Clone, Copy)]
struct Noise {
    share: f64,
    floor: f64,
}

impl Noise {
    fn of(self, value: f64) -> f64 {
        (self.share * value).hypot(self.floor)
    }
}

/// A reading as an observation of a rig whose x axis is at the detector's azimuth.
struct Placed {
    pose: Pose,
    directions: Directions,
}

impl Placed {
    fn new(reading: &TableReading, facts: &Goniometer) -> Placed {
        let sense = match facts.azimuth_sense {
            AzimuthSense::CounterClockwise => 1.0,
            AzimuthSense::Clockwise => -1.0,
        };
        // A negative angle from the normal is a positive one at the opposite azimuth.
        let upright = |theta_deg: f64, phi_deg: f64| match theta_deg < 0.0 {
            true => (Angle::from_deg(-theta_deg), sense * (phi_deg + 180.0)),
            false => (Angle::from_deg(theta_deg), sense * phi_deg),
        };
        let (theta_i, phi_i_deg) = upright(reading.theta_i_deg, reading.phi_i_deg);
        let (theta_o, phi_o_deg) = upright(reading.theta_o_deg, reading.phi_o_deg);
        let ((sin_i, cos_i), (sin_o, cos_o)) = (theta_i.sin_cos(), theta_o.sin_cos());
        let (sin, cos) = Angle::from_deg(phi_i_deg - phi_o_deg).sin_cos();
        let phi_s = Angle::from_deg(sense * facts.azimuth_of_v_deg - phi_o_deg);
        Placed {
            pose: Pose {
                theta_c: theta_o,
                phi_s: phi_s.wrapped(),
            },
            directions: Directions {
                incident: Vector3::new(sin_i * cos, sin_i * sin, cos_i),
                outgoing: Vector3::new(sin_o, 0.0, cos_o),
            },
        }
    }
}

/// Reads a text file of the folder.
fn text_of(folder: &Path, file: &str) -> Result<String, TableError> {
    decoded(content_of(folder, file)?).map_err(|(line, byte)| {
        let cause = format!("the byte 0x{byte:02X} is not valid UTF-8: save the file as UTF-8");
        TableError::new(file, Some(TableRow::Line(line)), cause)
    })
}

fn content_of(folder: &Path, file: &str) -> Result<Vec<u8>, TableError> {
    let path = folder.join(file);
    let unread = |cause: String| TableError::new(file, None, cause);
    let facts = std::fs::metadata(&path).map_err(|e| {
        unread(format!(
            "the file cannot be read from {}: {e}",
            folder.display()
        ))
    })?;
    if !facts.is_file() || facts.len() > BYTES_MAX {
        return Err(unread(
            "it is not a regular file of at most 256 MB".to_owned(),
        ));
    }
    std::fs::read(&path).map_err(|e| unread(format!("the file cannot be read: {e}")))
}
