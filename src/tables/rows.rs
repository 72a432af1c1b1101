//! The rows of a CSV table.

use std::collections::HashSet;

use super::TableError;
use super::columns::{COLUMNS, Columns};
use super::light::{is_other_wavelength, is_unpolarised, wavelength};
use super::manifest::Goniometer;
use crate::heights::missing::{Kind, is_mark, mark};
use crate::observation::TableRow;
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
    /// Its place in the file, if known.
    pub row: Option<TableRow>,
}

/// The contents of a file.
pub(super) struct TableContents {
    pub(super) readings: Vec<TableReading>,
    pub(super) left_out: Vec<String>,
}

impl TableContents {
    /// Notes readings that were left out because of their light.
    ///
    /// # Errors
    /// All readings are polarised.
    pub(super) fn note_other_light(
        &mut self,
        other: usize,
        polarised: usize,
    ) -> Result<(), String> {
        for (n, why) in [
            (other, "at other wavelengths"),
            (
                polarised,
                "with a polariser (only unpolarised light is fitted)",
            ),
        ] {
            if n > 0 {
                let readings = counted(n, "reading");
                self.left_out.push(format!("{readings} {why} left out"));
            }
        }
        match self.readings.is_empty() && polarised > 0 {
            true => Err(
                "all readings are polarised, but a fit needs unpolarised light: average those of s and p"
                    .to_owned(),
            ),
            false => Ok(()),
        }
    }
}

pub(super) fn read(
    text: &str,
    file: &str,
    facts: &Goniometer,
) -> Result<TableContents, TableError> {
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
        TableError::new(
            file,
            sheet.line(error.position()).map(TableRow::Line),
            cause,
        )
    };
    let headers = sheet.headers().map_err(|e| no_csv(e, &sheet))?;
    let columns = Columns::find(&headers, facts)
        .map_err(|cause| TableError::new(file, Some(TableRow::Line(sheet.header_line())), cause))?;
    let mut rows: Vec<TableReading> = Vec::new();
    let mut wavelengths: Vec<Option<f64>> = Vec::new();
    let (mut missing, mut polarised) = (0, 0);
    while let Some(record) = sheet.read() {
        let record = record.map_err(|e| no_csv(e, &sheet))?;
        let line = sheet.line(record.position()).map(TableRow::Line);
        let number = |column: usize| -> Result<f64, TableError> {
            let value = sheet.number(columns.field(&record, column).unwrap_or_default());
            value.map_err(|cause| {
                TableError::new(file, line, format!("column {}: {cause}", COLUMNS[column].0))
            })
        };
        let angle = |column: usize| number(column).map(|x| columns.converted(column, x));
        if columns.field(&record, 4).is_some_and(is_mark) {
            missing += 1;
            continue;
        }
        if !columns.polarisations(&record).all(is_unpolarised) {
            polarised += 1;
            continue;
        }
        let own = columns.wavelength(&record, |field| sheet.number(field));
        let own = own
            .map_err(|cause| TableError::new(file, line, format!("column wavelength: {cause}")))?;
        wavelengths.push(own);
        let reading = TableReading {
            theta_i_deg: angle(0)?,
            phi_i_deg: angle(1)?,
            theta_o_deg: angle(2)?,
            phi_o_deg: angle(3)?,
            value: number(4)?,
            sigma: match columns.field(&record, 5) {
                None => None,
                Some(field) if is_mark(field) => None,
                Some(_) => Some(number(5)?),
            },
            row: line,
        };
        rows.push(reading);
    }
    let light = |cause: String| TableError::new(file, None, cause);
    let wanted =
        wavelength(wavelengths.iter().copied().flatten().collect(), facts).map_err(light)?;
    let before = rows.len();
    let is_other = |own: &Option<f64>| {
        let both = own.zip(wanted);
        both.is_some_and(|(own, wanted)| is_other_wavelength(own, wanted))
    };
    let mut own = wavelengths.iter();
    rows.retain(|_| !own.next().is_some_and(is_other));
    let other = before - rows.len();
    // Marks are recognised in the file's unit.
    let mut values: Vec<f64> = rows.iter().map(|r| r.value).collect();
    let mut left_out = mark(&mut values, &[], Kind::Readings);
    let mut readings = Vec::new();
    for (mut reading, value) in rows.into_iter().zip(values) {
        if value.is_nan() {
            missing += 1;
            continue;
        }
        check(&reading, file)?;
        reading.value = columns.converted(4, value);
        let stated = reading.sigma;
        reading.sigma = stated.and_then(|stated| columns.sigma(reading.value, stated));
        readings.push(reading);
    }
    if missing > 0 {
        left_out.push(format!(
            "{} without a value left out",
            counted(missing, "row")
        ));
    }
    let mut read = TableContents { readings, left_out };
    read.note_other_light(other, polarised).map_err(light)?;
    Ok(read)
}

/// Refuses a reading that is not one of a goniometer in reflection.
pub(super) fn check(reading: &TableReading, file: &str) -> Result<(), TableError> {
    let refused = |cause: String| Err(TableError::new(file, reading.row, cause));
    for (name, theta) in [
        ("theta_i", reading.theta_i_deg),
        ("theta_o", reading.theta_o_deg),
    ] {
        if theta.abs() >= 90.0 {
            return refused(format!(
                "{name} = {theta}° is not above the surface: leave out readings in transmission and at 90°, and check that the unit is the degree"
            ));
        }
    }
    if reading.phi_i_deg.abs().max(reading.phi_o_deg.abs()) > 3600.0 {
        return refused(
            "an azimuth exceeds ten turns: check that the unit is the degree".to_owned(),
        );
    }
    match reading.sigma {
        Some(sigma) if sigma <= 0.0 => refused(format!(
            "sigma = {sigma}: a standard uncertainty must be above 0; leave the field empty to use that of the manifest"
        )),
        _ => Ok(()),
    }
}

/// Leaves out readings that repeat another one in every digit, which are copies of one measurement.
pub(super) fn leave_copies_out(read: &mut TableContents) {
    let before = read.readings.len();
    let mut seen = HashSet::new();
    read.readings.retain(|r| {
        let numbers = [
            r.theta_i_deg,
            r.phi_i_deg,
            r.theta_o_deg,
            r.phi_o_deg,
            r.value,
        ];
        seen.insert((numbers.map(f64::to_bits), r.sigma.map(f64::to_bits)))
    });
    let copies = before - read.readings.len();
    if copies > 0 {
        read.left_out.push(format!(
            "{} left out that repeat the directions, value and sigma of another one in every digit: \
             state independent repeats with all their digits",
            counted(copies, "reading")
        ));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ANGLES: &str = "theta_i,phi_i,theta_o,phi_o";

    fn contents(kind: &str, header: &str, rows: &[&str]) -> Result<TableContents, TableError> {
        let facts: Goniometer = toml::from_str(&format!("value = \"{kind}\"")).unwrap();
        let rows: String = rows
            .iter()
            .enumerate()
            .map(|(n, row)| format!("10,0,{n},90,{row}\n"))
            .collect();
        read(&format!("{header}\n{rows}"), "table.csv", &facts)
    }

    #[test]
    fn per_cent_of_a_value_and_values_in_per_cent_are_converted() {
        let of = |kind: &str, columns: &str, row: &str| {
            let read = contents(kind, &format!("{ANGLES},{columns}"), &[row]);
            let reading = read.unwrap().readings[0];
            (reading.value, reading.sigma)
        };
        let share = of("brdf", "BRDF [1/sr],uBRDF [%]", "0.5,1");
        assert_eq!(share, (0.5, Some(0.005)));
        // Per cent of nothing state no uncertainty.
        assert_eq!(of("brdf", "brdf,ubrdf_%", "0,1"), (0.0, None));
        let factor = of("radiance-factor", "radiance factor [%],sigma", "28,2");
        assert!((factor.0 - 0.28).abs() < 1e-15 && factor.1 == Some(0.02));
    }

    #[test]
    fn a_unit_that_a_column_cannot_have_is_refused_by_name() {
        for (kind, header, words) in [
            (
                "brdf",
                "theta_i (radians),phi_i,theta_o,phi_o,brdf",
                "`theta_i (radians)`",
            ),
            (
                "brdf",
                "theta_i_mrad,phi_i,theta_o,phi_o,brdf",
                "deg (°) or rad",
            ),
            ("brdf", "theta_i,phi_i,theta_o,phi_o,brdf [%]", "1/sr"),
            (
                "radiance-factor",
                "theta_i,phi_i,theta_o,phi_o,f [1/sr]",
                "1 or %",
            ),
            (
                "radiance-factor",
                "theta_i,phi_i,theta_o,phi_o,f [%],sigma [%]",
                "two meanings",
            ),
            (
                "brdf",
                "theta_i,phi_i,theta_o,phi_o,f [1/sr],std [W]",
                "`std [W]`",
            ),
            (
                "brdf",
                "theta_i,phi_i,elevation,phi_o,brdf",
                "it has `theta_i`, `phi_i`, `elevation`",
            ),
        ] {
            let why = contents(kind, header, &[]).err().unwrap().to_string();
            assert!(why.contains(words), "{header}: {why}");
        }
    }

    #[test]
    fn marks_of_missing_readings_are_left_out_and_a_peak_that_occurs_twice_is_not() {
        let mut rows = vec!["0.2"; 30];
        (rows[1], rows[2], rows[3]) = ("0.3", "#N/A", "--");
        let plain = contents("brdf", &format!("{ANGLES},value"), &rows).unwrap();
        assert_eq!(plain.readings.len(), 28);
        rows[4] = "-9999";
        let read = contents("brdf", &format!("{ANGLES},value"), &rows).unwrap();
        assert_eq!(read.readings.len(), 27);
        let note = &read.left_out[0];
        assert!(note.contains("1 reading of -9999"), "{note}");
        (rows[4], rows[5]) = ("80", "80");
        let read = contents("brdf", &format!("{ANGLES},value"), &rows).unwrap();
        assert_eq!(read.readings.len(), 28);
    }

    #[test]
    fn readings_of_other_light_are_left_out_or_refused() {
        let of =
            |header: &str, rows: &[&str]| contents("brdf", &format!("{ANGLES},{header}"), rows);
        let both = ["0.2,550", "0.3,0.65e3", "0.4,550"];
        let why = of("value,Wavelength [nm]", &both)
            .err()
            .unwrap()
            .to_string();
        assert!(why.contains("2 wavelengths (550, 650 nm)"), "{why}");
        assert_eq!(
            of("value,wavelength_nm", &both[..1])
                .unwrap()
                .readings
                .len(),
            1
        );
        let why = of("value,lambda (in)", &both).err().unwrap().to_string();
        assert!(why.contains("nm or µm"), "{why}");
        let read = of("value,polarization", &["0.2,s", "0.3,u", "0.4,P"]).unwrap();
        assert!(
            read.readings.len() == 1 && read.left_out[0].starts_with("2 readings with a polariser")
        );
        let why = of("value,pol_i,pol_r", &["0.2,u,s"])
            .err()
            .unwrap()
            .to_string();
        assert!(why.contains("average those of s and p"), "{why}");
    }

    #[test]
    fn a_table_may_have_remarks_above_and_blank_rows_below() {
        let facts: Goniometer = toml::from_str("value = \"brdf\"").unwrap();
        for text in [
            "# by hand\n\ntheta_i,phi_i,theta_o,phi_o,value\n10,0,5,90,0.2\n,,,,\n",
            "# theta_i, phi_i, theta_o, phi_o, value\n10,0,5,90,0.2\n",
        ] {
            let read = read(text, "table.csv", &facts).unwrap();
            assert!(
                read.readings.len() == 1 && read.left_out.is_empty(),
                "{text}"
            );
        }
    }

    #[test]
    fn copies_of_a_reading_count_once() {
        let mut read =
            contents("brdf", &format!("{ANGLES},value"), &["0.2", "0.2", "0.3"]).unwrap();
        let copy = read.readings[1];
        read.readings.push(copy);
        leave_copies_out(&mut read);
        assert_eq!(read.readings.len(), 3);
        assert!(read.left_out[0].starts_with("1 reading left out"));
    }
}
