//! The manifest of a table: the quantity of its values, the convention of its angles, and the
//! nominal material.

use serde::Deserialize;

use super::TableError;
use crate::geometry::Directions;
use crate::material::Material;
use crate::observation::TableRow;
use crate::series::{Manifest, SeriesError, TABLE_SCHEMA as SCHEMA};
use crate::wording::toml_text;

/// Quantity of a table's values.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ValueKind {
    /// f, sr⁻¹.
    Brdf,
    /// π f: relative to a perfect diffuser in the same geometry.
    RadianceFactor,
    /// f cos θo, sr⁻¹: scattered power per solid angle (ARS, cosine-corrected BSDF).
    CosineCorrected,
    /// f cos θi: radiance for an irradiance of 1 on a surface facing the lamp, sr⁻¹.
    Radiance,
}

impl ValueKind {
    /// Radiance for a lamp irradiance of 1 on a surface facing it, per unit of the value.
    /// `directions` are in the rig's frame, z along the normal.
    pub(super) fn radiance_per_value(self, directions: &Directions) -> f64 {
        let (cos_i, cos_o) = (directions.incident.z, directions.outgoing.z);
        match self {
            ValueKind::Brdf => cos_i,
            ValueKind::RadianceFactor => cos_i / std::f64::consts::PI,
            ValueKind::CosineCorrected => cos_i / cos_o,
            ValueKind::Radiance => 1.0,
        }
    }
}

/// Whether the values are absolute.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ValueScale {
    /// In the stated unit, within `scale_rel_std`.
    #[default]
    Absolute,
    /// In one arbitrary unit.
    Relative,
}

/// AzimuthSense of the azimuths, seen from above the sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum AzimuthSense {
    /// From u towards v.
    #[default]
    CounterClockwise,
    /// From v towards u.
    Clockwise,
}

/// `[goniometer]`.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Goniometer {
    /// Quantity of the values.
    pub value: ValueKind,
    /// Whether the values are absolute.
    #[serde(default)]
    pub scale: ValueScale,
    /// Relative standard uncertainty of an absolute scale.
    pub scale_rel_std: Option<f64>,
    /// Relative standard uncertainty of values without their own, independent between readings.
    pub value_rel_std: Option<f64>,
    /// Constant part of that standard uncertainty, in the unit of the values.
    pub value_std: Option<f64>,
    /// Standard uncertainty of stray light common to all readings: radiance for an irradiance of 1,
    /// sr⁻¹.
    pub stray_std: Option<f64>,
    /// Azimuth of the lean direction v.
    #[serde(default = "quarter")]
    pub azimuth_of_v_deg: f64,
    /// AzimuthSense of the azimuths.
    #[serde(default)]
    pub azimuth_sense: AzimuthSense,
    /// Standard uncertainty of θi and of θo, each as an error common to all readings.
    pub theta_std_deg: Option<f64>,
    /// Standard uncertainty of the azimuths, in the same sense.
    pub phi_std_deg: Option<f64>,
    /// Standard uncertainty of the inclination of the sample's mean plane to the goniometer's.
    pub sample_tilt_std_deg: Option<f64>,
    /// Half angle of the lamp, seen from the sample.
    #[serde(default)]
    pub light_angular_radius_deg: f64,
    /// Half angle of the detector's aperture, seen from the sample.
    #[serde(default)]
    pub detector_angular_radius_deg: f64,
    /// Wavelength: for a metal by name, and to select one from a BiRD file.
    pub wavelength_nm: Option<f64>,
}

fn quarter() -> f64 {
    90.0
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Text {
    schema: String,
    #[serde(default)]
    name: String,
    table: String,
    goniometer: Goniometer,
    sample: toml::Table,
    #[serde(default, rename = "notes")]
    _notes: toml::Table,
}

/// The contents of a manifest.
pub(super) struct TableManifest {
    pub(super) name: String,
    pub(super) table: String,
    pub(super) facts: Goniometer,
    pub(super) material: Material,
}

pub(super) fn read(text: &str, file: &str) -> Result<TableManifest, TableError> {
    let text: Text = toml_text::read(text).map_err(|refused| {
        let key = match refused.key.as_str() {
            "" => String::new(),
            key => format!("{key}: "),
        };
        let cause = format!(
            "{key}{}; docs/reference/brdf-tables.md lists all keys",
            refused.words
        );
        TableError::new(file, refused.line.map(TableRow::Line), cause)
    })?;
    let wrong = |cause: String| Err(TableError::new(file, None, cause));
    if text.schema != SCHEMA {
        return wrong(format!("schema: expected {SCHEMA}, got `{}`", text.schema));
    }
    let f = &text.goniometer;
    let at_most = |key: &str, value: Option<f64>, most: f64, unit: &str| match value {
        Some(x) if !(0.0..=most).contains(&x) => Some(format!(
            "goniometer.{key}: {x} is out of range: set it to a number from 0 to {most}{unit}"
        )),
        _ => None,
    };
    let slips = [
        at_most(
            "scale_rel_std",
            f.scale_rel_std,
            1.0,
            ", a fraction of the value",
        ),
        at_most(
            "value_rel_std",
            f.value_rel_std,
            1.0,
            ", a fraction of the value",
        ),
        at_most("value_std", f.value_std, f64::MAX, ""),
        at_most("stray_std", f.stray_std, f64::MAX, ""),
        at_most("theta_std_deg", f.theta_std_deg, 10.0, "°"),
        at_most("phi_std_deg", f.phi_std_deg, 10.0, "°"),
        at_most("sample_tilt_std_deg", f.sample_tilt_std_deg, 10.0, "°"),
        at_most(
            "light_angular_radius_deg",
            Some(f.light_angular_radius_deg),
            30.0,
            "°",
        ),
        at_most(
            "detector_angular_radius_deg",
            Some(f.detector_angular_radius_deg),
            30.0,
            "°",
        ),
        at_most(
            "azimuth_of_v_deg",
            Some(f.azimuth_of_v_deg.abs()),
            360.0,
            "°, of either sign",
        ),
    ];
    if let Some(cause) = slips.into_iter().flatten().next() {
        return wrong(cause);
    }
    if (f.value_rel_std, f.value_std) == (Some(0.0), Some(0.0)) {
        return wrong(
            "goniometer.value_rel_std and value_std: values without uncertainty cannot be weighted: set one above 0"
                .to_owned(),
        );
    }
    if text.sample.contains_key("layout") {
        return wrong("sample.layout: a table describes one surface: leave it out".to_owned());
    }
    let material =
        Manifest::material_alone(&text.sample, f.wavelength_nm, file).map_err(|error| {
            let cause = match error {
                SeriesError::Invalid {
                    key, cause, remedy, ..
                } => {
                    // The rig that was checked has the goniometer's wavelength.
                    let key = key.replacen("rig.", "goniometer.", 1);
                    format!("{key}{cause}; {remedy}")
                }
                other => other.to_string(),
            };
            TableError::new(file, None, cause)
        })?;
    Ok(TableManifest {
        name: text.name,
        table: text.table,
        facts: text.goniometer,
        material,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_metal_without_a_wavelength_names_the_key_of_the_goniometer() {
        let text = "schema = \"brdf-table-1\"\ntable = \"t.csv\"\n[goniometer]\nvalue = \"brdf\"\n\
            [sample]\nkind = \"conductor\"\nmetal = \"Al\"\n";
        let why = read(text, "manifest.toml").err().unwrap().to_string();
        assert!(
            why.contains("goniometer.wavelength_nm: sample.metal = \"Al\" needs it"),
            "{why}"
        );
        let stated = text.replace("[sample]", "wavelength_nm = 633\n[sample]");
        assert!(read(&stated, "manifest.toml").is_ok());
    }
}
