//! The rows of a CSV table.

use super::TableError;
use crate::wording::counted;
use crate::wording::sheet::Sheet;

/// One reading. Directions point away from the sample; θ counts from its normal, with either sign,
/// φ as stated in the manifest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TableReading {
    /// Polar angle of the lamp.
    pub theta_i_deg: f64,
    /// Azimuth of the lamp.
    pub phi_i_deg: f64,
    /// Polar angle of the detector.
    pub theta_o_deg: f64,
    /// Azimuth of the detector.
    pub phi_o_deg: f64,
    /// The value, in the unit of the manifest.
    pub value: f64,
    /// Its standard uncertainty, if stated in the table.
    pub sigma: Option<f64>,
}

/// The contents of a file.
pub(super) struct TableContents {
    pub(super) readings: Vec<TableReading>,
    pub(super) left_out: Vec<String>,
}

/// The columns with their accepted names, without case, unit and separators.
const COLUMNS: [(&str, &[&str]); 6] = [
    ("theta_i_deg", &["thetai", "thetain", "thetaincident"]),
    ("phi_i_deg", &["phii", "phiin", "phiincident"]),
    ("theta_o_deg", &["thetao", "thetar", "thetas", "thetaout"]),
    ("phi_o_deg", &["phio", "phir", "phis", "phiout"]),
    (
        "value",
        &[
            "value",
            "brdf",
            "bsdf",
            "f",
            "fr",
            "radiancefactor",
            "radiance",
            "ars",
        ],
    ),
    (
        "sigma",
        &["sigma", "std", "valuestd", "brdfstd", "ubrdf", "stdbrdf"],
    ),
];
/// Texts of a missing reading.
const MISSING: [&str; 6] = ["", "nan", "na", "n/a", "-", "null"];

/// A column's name without case, unit and separators, and whether its unit is the radian.
fn plain(name: &str) -> (String, bool) {
    let lower = name
        .to_lowercase()
        .replace('θ', "theta")
        .replace(['φ', 'ϕ'], "phi");
    let mut words: Vec<&str> = lower
        .split(|c: char| !c.is_alphanumeric() && c != '°')
        .filter(|w| !w.is_empty())
        .collect();
    let radian = words.contains(&"rad");
    words.retain(|w| !["deg", "degrees", "degree", "°", "rad", "1", "per", "sr"].contains(w));
    (words.concat(), radian)
}

pub(super) fn read(text: &str, file: &str) -> Result<TableContents, TableError> {
    let mut sheet = Sheet::open(text);
    let no_csv = |error: csv::Error, sheet: &Sheet<'_>| {
        let cause = match error.kind() {
            csv::ErrorKind::UnequalLengths {
                expected_len, len, ..
            } => format!(
                "the line has {}, but the header has {expected_len}; if commas separate the columns, write decimals with a point",
                counted(*len as usize, "field")
            ),
            _ => format!("the line is not valid CSV: {error}"),
        };
        TableError::new(file, sheet.line(error.position()), cause)
    };
    let headers = sheet.headers().map_err(|e| no_csv(e, &sheet))?;
    let names: Vec<(String, bool)> = headers.iter().map(plain).collect();
    let mut places = [None; COLUMNS.len()];
    for (place, (column, known)) in places.iter_mut().zip(COLUMNS) {
        let mut found = (0..names.len()).filter(|i| known.contains(&names[*i].0.as_str()));
        *place = found.next();
        let wrong = match (*place, found.next()) {
            (None, _) if column != "sigma" => format!(
                "the column {column} is missing: the header needs {}, and may have sigma",
                COLUMNS[..5]
                    .iter()
                    .map(|c| c.0)
                    .collect::<Vec<_>>()
                    .join(",")
            ),
            (Some(a), Some(b)) => format!(
                "the columns `{}` and `{}` both mean {column}: remove one",
                &headers[a], &headers[b]
            ),
            _ => continue,
        };
        return Err(TableError::new(file, Some(sheet.header_line()), wrong));
    }
    let mut read = TableContents {
        readings: Vec::new(),
        left_out: Vec::new(),
    };
    let mut missing = 0;
    while let Some(record) = sheet.read() {
        let record = record.map_err(|e| no_csv(e, &sheet))?;
        let line = sheet.line(record.position());
        let at = |column: usize| places[column].map(|place| &record[place]);
        let number = |column: usize| -> Result<f64, TableError> {
            let value = sheet.number(at(column).unwrap_or_default());
            let value = value.map_err(|cause| {
                TableError::new(file, line, format!("column {}: {cause}", COLUMNS[column].0))
            })?;
            let radian = column < 4 && places[column].is_some_and(|place| names[place].1);
            Ok(if radian { value.to_degrees() } else { value })
        };
        let is_missing = |field: &str| MISSING.contains(&field.to_lowercase().as_str());
        if at(4).is_some_and(is_missing) {
            missing += 1;
            continue;
        }
        let reading = TableReading {
            theta_i_deg: number(0)?,
            phi_i_deg: number(1)?,
            theta_o_deg: number(2)?,
            phi_o_deg: number(3)?,
            value: number(4)?,
            sigma: match at(5) {
                None => None,
                Some(field) if is_missing(field) => None,
                Some(_) => Some(number(5)?),
            },
        };
        check(&reading).map_err(|cause| TableError::new(file, line, cause))?;
        read.readings.push(reading);
    }
    if missing > 0 {
        read.left_out.push(format!(
            "{} without a value left out",
            counted(missing, "row")
        ));
    }
    Ok(read)
}

/// Refuses a reading that is not one of a goniometer in reflection.
pub(super) fn check(reading: &TableReading) -> Result<(), String> {
    for (name, theta) in [
        ("theta_i", reading.theta_i_deg),
        ("theta_o", reading.theta_o_deg),
    ] {
        if theta.abs() >= 90.0 {
            return Err(format!(
                "{name} = {theta}° is not above the surface: leave out readings in transmission and at 90°, and check that the unit is the degree"
            ));
        }
    }
    if reading.phi_i_deg.abs().max(reading.phi_o_deg.abs()) > 3600.0 {
        return Err("an azimuth exceeds ten turns: check that the unit is the degree".to_owned());
    }
    match reading.sigma {
        Some(sigma) if sigma <= 0.0 => Err(format!(
            "sigma = {sigma}: a standard uncertainty must be above 0; leave the field empty to use that of the manifest"
        )),
        _ => Ok(()),
    }
}
