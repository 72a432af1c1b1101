//! The universal BRDF format of the BiRD project, version 1.0 (JSON).
//!
//! `data` contains lists of equal length: `theta_i`, `phi_i`, `theta_r`, `phi_r`, `BRDF`, and
//! `uBRDF` if the uncertainty differs between readings. Uncertainties are taken as standard
//! uncertainties. Of several wavelengths, the one in the manifest is read; of several
//! polarisations, the unpolarised one.

use serde::Deserialize;
use serde_json::Value as Json;

use super::TableError;
use super::light::{is_other_wavelength, wavelength};
use super::manifest::{Goniometer, ValueKind};
use super::rows::{TableContents, TableReading, check};
use crate::heights::missing::{Kind, mark};
use crate::observation::TableRow;
use crate::wording::counted;
use crate::wording::json;

#[derive(Debug, Deserialize)]
struct File {
    data: Data,
}

#[derive(Debug, Deserialize)]
struct Data {
    theta_i: Angles,
    phi_i: Angles,
    theta_r: Angles,
    phi_r: Angles,
    #[serde(rename = "BRDF")]
    brdf: Values,
    #[serde(rename = "uBRDF")]
    u_brdf: Option<Values>,
    wavelength_i: Option<Values>,
    polarization_i: Option<States>,
    polarization_r: Option<States>,
}

#[derive(Debug, Deserialize)]
struct Angles {
    unit: String,
    values: Vec<f64>,
}

#[derive(Debug, Deserialize)]
struct Values {
    unit: String,
    /// JSON writes a missing reading as null.
    values: Vec<Option<f64>>,
    uncertainty: Option<Constant>,
}

#[derive(Debug, Deserialize)]
struct Constant {
    value: f64,
    unit: String,
}

/// Polarisation of each reading: a word, or a Stokes vector.
#[derive(Debug, Deserialize)]
struct States {
    values: Vec<Json>,
}

/// Whether a state is unpolarised: `u`, or a Stokes vector with intensity only.
fn is_unpolarised(state: &Json) -> bool {
    match state {
        Json::String(word) => word == "u",
        Json::Array(stokes) => stokes.iter().skip(1).all(|s| s.as_f64() == Some(0.0)),
        _ => false,
    }
}

impl Angles {
    fn in_degrees(&self, index: usize) -> f64 {
        match self.unit.as_str() {
            "rad" => self.values[index].to_degrees(),
            _ => self.values[index],
        }
    }
}

/// Units of the schema, and spellings that occur.
const ANGLES: &[&str] = &["rad", "deg", "°"];
const BRDF: &[&str] = &["1/sr", "sr^-1"];
const UNCERTAINTIES: &[&str] = &["1/sr", "sr^-1", "%"];
/// The second and third begin with two characters that look alike.
const WAVELENGTHS: &[&str] = &["nm", "μm", "µm", "um"];

/// Refuses units that the schema does not have.
fn check_units(data: &Data) -> Result<(), String> {
    let constant = data.brdf.uncertainty.as_ref();
    for (name, unit, known) in [
        ("theta_i", Some(&data.theta_i.unit), ANGLES),
        ("phi_i", Some(&data.phi_i.unit), ANGLES),
        ("theta_r", Some(&data.theta_r.unit), ANGLES),
        ("phi_r", Some(&data.phi_r.unit), ANGLES),
        ("BRDF", Some(&data.brdf.unit), BRDF),
        ("BRDF.uncertainty", constant.map(|c| &c.unit), UNCERTAINTIES),
        (
            "uBRDF",
            data.u_brdf.as_ref().map(|u| &u.unit),
            UNCERTAINTIES,
        ),
        (
            "wavelength_i",
            data.wavelength_i.as_ref().map(|w| &w.unit),
            WAVELENGTHS,
        ),
    ] {
        if let Some(unit) = unit.filter(|unit| !known.contains(&unit.as_str())) {
            return Err(format!(
                "data.{name}.unit: expected {}, got `{unit}`",
                known.join(" or ")
            ));
        }
    }
    Ok(())
}

pub(super) fn read(
    text: &str,
    file: &str,
    facts: &Goniometer,
) -> Result<TableContents, TableError> {
    let wrong = |cause: String| TableError::new(file, None, cause);
    let text = text.trim_start_matches('\u{feff}');
    let File { data } = serde_json::from_str(text).map_err(|error| {
        // The second reader names the path and what is expected; only the first one knows the line.
        let is_bare = |word: &&str| {
            [" ", ",", "["].iter().any(|before| text.contains(&format!("{before}{word}")))
        };
        let words = ["NaN", "Infinity", "-Infinity"];
        if let Some(word) = words.into_iter().find(is_bare).filter(|_| error.is_syntax()) {
            let cause = format!("JSON has no {word}, which Python writes for a number that is not finite: write null");
            return TableError::new(file, Some(TableRow::Line(error.line())), cause);
        }
        let cause = match json::from_slice::<File>(text.as_bytes()) {
            Err(refusal) => refusal.to_string(),
            Ok(_) => error.to_string(),
        };
        let cause = format!("{cause}; expected a BiRD file of version 1.0");
        TableError::new(file, Some(TableRow::Line(error.line())), cause)
    })?;
    if facts.value != ValueKind::Brdf {
        return Err(wrong(
            "a BiRD file contains BRDF: set value = \"brdf\" in the manifest's [goniometer]"
                .to_owned(),
        ));
    }
    check_units(&data).map_err(wrong)?;
    let count = data.brdf.values.len();
    let lengths = [
        ("theta_i", Some(data.theta_i.values.len())),
        ("phi_i", Some(data.phi_i.values.len())),
        ("theta_r", Some(data.theta_r.values.len())),
        ("phi_r", Some(data.phi_r.values.len())),
        ("uBRDF", data.u_brdf.as_ref().map(|u| u.values.len())),
        (
            "wavelength_i",
            data.wavelength_i.as_ref().map(|w| w.values.len()),
        ),
        (
            "polarization_i",
            data.polarization_i.as_ref().map(|p| p.values.len()),
        ),
        (
            "polarization_r",
            data.polarization_r.as_ref().map(|p| p.values.len()),
        ),
    ];
    for (name, length) in lengths {
        if let Some(length) = length.filter(|length| *length != count) {
            return Err(wrong(format!(
                "data.{name} has {} but data.BRDF has {count}: every reading needs all of them",
                counted(length, "value")
            )));
        }
    }
    let wavelengths = data.wavelength_i.as_ref();
    let wavelengths = wavelengths.map_or_else(Vec::new, |all| {
        let count = 0..all.values.len();
        count.filter_map(|i| all.nanometres(i)).collect()
    });
    let wavelength = wavelength(wavelengths, facts).map_err(wrong)?;
    let u_brdf = data.u_brdf.as_ref();
    let constant = data.brdf.uncertainty.as_ref();
    let mut values: Vec<f64> = data
        .brdf
        .values
        .iter()
        .map(|v| v.unwrap_or(f64::NAN))
        .collect();
    let mut read = TableContents {
        left_out: mark(&mut values, &[], Kind::Readings),
        readings: Vec::new(),
    };
    let (mut missing, mut other, mut polarised) = (0, 0, 0);
    for (index, value) in values.into_iter().enumerate() {
        if value.is_nan() {
            missing += 1;
            continue;
        }
        let is_other = |wanted: f64| {
            let own = data.wavelength_i.as_ref().and_then(|w| w.nanometres(index));
            own.is_some_and(|own| is_other_wavelength(own, wanted))
        };
        if wavelength.is_some_and(is_other) {
            other += 1;
            continue;
        }
        let states = [&data.polarization_i, &data.polarization_r];
        if states
            .into_iter()
            .flatten()
            .any(|s| !is_unpolarised(&s.values[index]))
        {
            polarised += 1;
            continue;
        }
        let share = |of: f64, unit: &str| match unit {
            "%" => value.abs() * of / 100.0,
            _ => of,
        };
        let own = u_brdf.and_then(|u| Some(share(u.values[index]?, &u.unit)));
        let sigma = own.or_else(|| constant.map(|c| share(c.value, &c.unit)));
        let reading = TableReading {
            theta_i_deg: data.theta_i.in_degrees(index),
            phi_i_deg: data.phi_i.in_degrees(index),
            theta_o_deg: data.theta_r.in_degrees(index),
            phi_o_deg: data.phi_r.in_degrees(index),
            value,
            // The schema allows 0, which states no uncertainty.
            sigma: sigma.filter(|sigma| *sigma != 0.0),
            row: Some(TableRow::Reading(index + 1)),
        };
        check(&reading, file)?;
        read.readings.push(reading);
    }
    if missing > 0 {
        let missing = counted(missing, "reading");
        read.left_out
            .push(format!("{missing} without a value left out"));
    }
    read.note_other_light(other, polarised).map_err(wrong)?;
    Ok(read)
}

impl Values {
    fn nanometres(&self, index: usize) -> Option<f64> {
        let value = self.values[index]?;
        Some(if self.unit == "nm" {
            value
        } else {
            1e3 * value
        })
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn contents(goniometer: &str, changed: &[(&str, Json)]) -> Result<TableContents, TableError> {
        let facts = format!("value = \"brdf\"\n{goniometer}");
        let facts: Goniometer = toml::from_str(&facts).unwrap();
        let angle = json!({"unit": "deg", "values": [10, 20]});
        let mut file = json!({"data": {
            "theta_i": angle, "phi_i": angle, "theta_r": angle, "phi_r": angle,
            "BRDF": {"unit": "1/sr", "values": [0.5, 0.4]},
            "uBRDF": {"unit": "%", "values": [1, 1]},
            "wavelength_i": {"unit": "μm", "values": [0.633, 0.633]},
        }});
        for (key, value) in changed {
            file["data"][*key] = value.clone();
        }
        read(&file.to_string(), "table.json", &facts)
    }

    #[test]
    fn the_only_wavelength_of_a_file_is_compared_with_the_manifest() {
        for (stated, is_read) in [
            ("", true),
            ("wavelength_nm = 633.2", true),
            ("wavelength_nm = 450", false),
        ] {
            assert_eq!(contents(stated, &[]).is_ok(), is_read, "{stated}");
        }
        let why = contents("wavelength_nm = 450", &[])
            .err()
            .unwrap()
            .to_string();
        assert!(why.contains("= 450 nm: the file has 633 nm"), "{why}");
    }

    #[test]
    fn units_that_the_schema_does_not_have_and_negative_uncertainties_are_refused() {
        let values = |unit: &str, values: [f64; 2]| json!({"unit": unit, "values": values});
        let constant = json!({"unit": "1/sr", "values": [0.5, 0.4], "uncertainty": {"value": 1, "unit": "dB"}});
        for (key, value, words) in [
            (
                "wavelength_i",
                values("m", [1e-6, 1e-6]),
                "wavelength_i.unit: expected nm or",
            ),
            (
                "uBRDF",
                values("percent", [1.0, 1.0]),
                "data.uBRDF.unit: expected 1/sr or sr^-1 or %",
            ),
            ("BRDF", constant, "data.BRDF.uncertainty.unit"),
            (
                "uBRDF",
                values("1/sr", [0.1, -0.1]),
                "reading 2: sigma = -0.1",
            ),
            ("uBRDF", values("%", [-1.0, 1.0]), "reading 1: sigma"),
        ] {
            let why = contents("", &[(key, value)]).err().unwrap().to_string();
            assert!(why.contains(words), "{why}");
        }
        let facts: Goniometer = toml::from_str("value = \"brdf\"").unwrap();
        for text in ["{\"data\": {\"BRDF\": [NaN]}}", "[1, 2"] {
            let why = read(text, "table.json", &facts).err().unwrap().to_string();
            assert_eq!(why.contains("write null"), text.contains("NaN"), "{why}");
        }
        let none = contents("", &[("uBRDF", values("1/sr", [0.0, 0.1]))]).unwrap();
        assert_eq!(none.readings[0].sigma, None);
    }
}
