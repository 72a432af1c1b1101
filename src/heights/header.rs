//! Reads the header above a table of heights: size, steps and units, as programs write them.
//!
//! Lines are `key: value unit` or `key = value unit` (`# Width: 400.0 µm`, `Breite = 400,0 µm`, `dx
//! [nm]; 500`), in the languages that Gwyddion and microscope makers use. All other lines are
//! ignored.

use super::column_units::{is_foreign, known, unknown};
use super::text::number;

/// Keys of the size of the map along its rows.
const WIDTH: &[&str] = &[
    "width",
    "breite",
    "largeur",
    "larghezza",
    "ancho",
    "anchura",
    "largura",
    "breedte",
    "šířka",
    "x size",
    "size x",
    "x range",
    "x length",
    "length x",
    "x extent",
    "scan size x",
    "x scan size",
    "field width",
    "image width",
    "scan width",
    "x real",
    "xreal",
    "range x",
    "physical width",
    "total width",
];
/// Keys of the size along its columns.
const HEIGHT: &[&str] = &[
    "height",
    "höhe",
    "hauteur",
    "altezza",
    "alto",
    "altura",
    "hoogte",
    "výška",
    "y size",
    "size y",
    "y range",
    "y length",
    "length y",
    "y extent",
    "scan size y",
    "y scan size",
    "field height",
    "image height",
    "scan height",
    "y real",
    "yreal",
    "range y",
    "physical height",
    "total height",
];
/// Keys of the spacing of the samples along the rows.
const STEP_X: &[&str] = &[
    "dx",
    "delta x",
    "x step",
    "step x",
    "x pitch",
    "pitch x",
    "x spacing",
    "spacing x",
    "pixel width",
    "pixel size x",
    "x pixel size",
    "x resolution",
    "resolution x",
    "lateral resolution x",
    "x increment",
    "increment x",
    "x sampling",
    "sampling x",
    "x interval",
    "interval x",
    "schrittweite x",
    "x schrittweite",
    "pixelbreite",
    "pas x",
    "x pas",
    "pixelgröße x",
    "xscale",
    "x scale",
];
/// Keys of the spacing along the columns.
const STEP_Y: &[&str] = &[
    "dy",
    "delta y",
    "y step",
    "step y",
    "y pitch",
    "pitch y",
    "y spacing",
    "spacing y",
    "pixel height",
    "pixel size y",
    "y pixel size",
    "y resolution",
    "resolution y",
    "lateral resolution y",
    "y increment",
    "increment y",
    "y sampling",
    "sampling y",
    "y interval",
    "interval y",
    "schrittweite y",
    "y schrittweite",
    "pixelhöhe",
    "pas y",
    "y pas",
    "pixelgröße y",
    "yscale",
    "y scale",
];
/// Keys of the spacing in both directions.
const STEP: &[&str] = &[
    "pitch",
    "pixel pitch",
    "pixel size",
    "pixelsize",
    "pixelgröße",
    "lateral resolution",
    "laterale auflösung",
    "sampling",
    "sampling interval",
    "lateral sampling",
    "sample spacing",
    "point spacing",
    "spacing",
    "step",
    "step size",
    "schrittweite",
    "punktabstand",
    "pas",
    "xy calibration",
    "xy resolution",
    "xy spacing",
    "cellsize",
    "cell size",
    "taille du pixel",
];
/// Keys of the size along rows and columns, as in `Scan size: 400 x 64 µm`, or of both alike.
const SIZE: &[&str] = &[
    "scan size",
    "scan range",
    "image size",
    "size",
    "field size",
    "field of view",
    "fov",
    "scan area",
    "map size",
    "measured area",
    "scangröße",
    "bildgröße",
    "messfeld",
];
/// Keys of the unit of the heights.
const VALUE: &[&str] = &[
    "value units",
    "value unit",
    "werteeinheiten",
    "werteeinheit",
    "z unit",
    "z units",
    "unit z",
    "units z",
    "height unit",
    "height units",
    "unit",
    "units",
    "einheit",
    "einheiten",
    "z einheit",
    "einheit z",
    "höheneinheit",
    "unités des valeurs",
    "unité des valeurs",
    "unité z",
    "unità valore",
    "unità dei valori",
    "unidades de valor",
    "unidades",
    "unidades dos valores",
    "jednotky hodnot",
    "data unit",
    "data units",
    "z scale",
    "zscale",
    "z factor",
    "z increment",
    "height scale",
    "scale z",
    "eenheid",
    "eenheden",
];
/// Keys of the unit of lengths, for sizes without a unit of their own.
const LATERAL: &[&str] = &[
    "xy unit",
    "xy units",
    "x unit",
    "x units",
    "unit x",
    "unit xy",
    "lateral unit",
    "lateral units",
    "xy einheit",
    "x einheit",
    "einheit x",
    "einheit xy",
    "laterale einheit",
];
/// Keys of a number that marks a missing point.
const MARK: &[&str] = &[
    "nodata value",
    "nodata",
    "no data value",
    "no data",
    "missing value",
    "missing",
    "invalid value",
    "bad value",
    "blank",
    "blank value",
    "null value",
    "fehlwert",
    "ungültig",
    "fill value",
    "missing data value",
    "not measured",
];
/// Keys of grids that do not state units.
const OTHER: &[&str] = &[
    "ncols",
    "nrows",
    "xllcorner",
    "yllcorner",
    "xllcenter",
    "yllcenter",
];

/// Sizes and units above a table.
#[derive(Debug, Default)]
pub(super) struct Header {
    /// Size along rows and columns: a number, and the micrometres per unit of it if a unit is
    /// stated.
    size: [Option<(f64, Option<f64>)>; 2],
    /// Spacing of the samples, in the same form.
    step: [Option<(f64, Option<f64>)>; 2],
    value_um: Option<f64>,
    lateral_um: Option<f64>,
    /// Numbers that mark missing points.
    pub marks: Vec<f64>,
}

impl Header {
    /// Reads a line (without its comment mark). Returns whether it states something known.
    ///
    /// # Errors
    /// A size or unit in an unsupported unit.
    pub fn take(&mut self, line: &str) -> Result<bool, String> {
        let Some((key, value)) = key_and_value(line) else {
            return Ok(false);
        };
        let (key, unit_of_key) = without_unit(key);
        let is = |keys: &[&str]| keys.contains(&key.as_str());
        let quantity = quantity(value);
        if is(OTHER) {
            return Ok(true);
        }
        if is(MARK) {
            self.marks.extend(quantity.map(|q| q.0));
            return Ok(quantity.is_some());
        }
        if is(VALUE) || is(LATERAL) {
            // Either a unit alone, or the size of one step of the numbers.
            let (times, unit) = quantity.unwrap_or((1.0, bare(value)));
            let unit = if unit.is_empty() {
                unit_of_key.as_str()
            } else {
                unit
            };
            if unit.is_empty() {
                return Ok(false);
            }
            let um = times * known(unit).ok_or_else(|| unknown(unit))?;
            match is(VALUE) {
                true => self.value_um = Some(um),
                false => self.lateral_um = Some(um),
            }
            return Ok(um > 0.0);
        }
        if is(SIZE)
            && let Some((first, second)) = value.split_once(['x', '×', '*'])
        {
            let (Some(a), Some(b)) = (self::quantity(first), self::quantity(second)) else {
                return Ok(false);
            };
            let unit = [b.1, a.1, unit_of_key.as_str()];
            let unit = unit.into_iter().find(|unit| !unit.is_empty());
            // The numbers of points have no unit, or that of a picture.
            let Some(unit) = unit.filter(|unit| !is_of_pixels(unit)) else {
                return Ok(true);
            };
            let um = known(unit).ok_or_else(|| format!("{key}: {}", unknown(unit)))?;
            if a.0 > 0.0 && b.0 > 0.0 {
                self.size = [Some((a.0, Some(um))), Some((b.0, Some(um)))];
            }
            return Ok(true);
        }
        let (sides, into) = match () {
            () if is(WIDTH) => (0..1, &mut self.size),
            () if is(HEIGHT) => (1..2, &mut self.size),
            () if is(STEP_X) => (0..1, &mut self.step),
            () if is(STEP_Y) => (1..2, &mut self.step),
            () if is(STEP) => (0..2, &mut self.step),
            () => return Ok(false),
        };
        // The names of columns may be the same words.
        let Some((number, unit)) = quantity.filter(|q| q.0 > 0.0) else {
            return Ok(false);
        };
        let unit = if unit.is_empty() {
            unit_of_key.as_str()
        } else {
            unit
        };
        // A number of samples does not state their spacing.
        if is_of_pixels(unit) {
            return Ok(true);
        }
        let um = match unit {
            "" => None,
            _ => Some(known(unit).ok_or_else(|| format!("{key}: {}", unknown(unit)))?),
        };
        for side in sides {
            into[side] = Some((number, um));
        }
        Ok(true)
    }

    /// Spacing of the samples of a map with these numbers of columns and rows, µm.
    pub fn pitch_um(&self, columns: usize, rows: usize) -> Option<[f64; 2]> {
        let um = |(number, um): (f64, Option<f64>)| Some(number * um.or(self.lateral_um)?);
        let side = |n: usize, count: usize| {
            let step = self.step[n].and_then(um);
            step.or_else(|| Some(self.size[n].and_then(um)? / count as f64))
        };
        match (side(0, columns), side(1, rows)) {
            (Some(u), Some(v)) if rows > 1 => Some([u, v]),
            (Some(one), _) | (None, Some(one)) => Some([one; 2]),
            (None, None) => None,
        }
    }

    /// Micrometres per unit of length.
    pub fn lateral_um(&self) -> Option<f64> {
        self.lateral_um
    }

    /// Micrometres per unit of the heights.
    pub fn value_um(&self) -> Option<f64> {
        self.value_um
    }
}

/// Whether a unit counts samples.
fn is_of_pixels(unit: &str) -> bool {
    let lower = unit.to_lowercase();
    lower.starts_with("pix") || ["px", "points", "pts", "samples"].contains(&lower.as_str())
}

/// Splits a line at its colon or equals sign, otherwise at its first separator.
fn key_and_value(line: &str) -> Option<(&str, &str)> {
    let line = line.trim_matches(|c: char| c.is_whitespace() || c == '"');
    let marks = [':', '=', '\t', ';', ','];
    let split = marks.iter().find_map(|mark| line.split_once(*mark));
    // Of a word and a number, the first is the key.
    let split = split.or_else(|| line.split_once(' '))?;
    let starts_as_key = line.chars().next().is_some_and(char::is_alphabetic);
    starts_as_key.then_some(split)
}

/// A key in lower case with single spaces, and the unit at its end: `Pixel size [µm]`, `dx_um`, `dx
/// (nm)`.
fn without_unit(key: &str) -> (String, String) {
    let mut unit = String::new();
    let mut key = key.trim().trim_matches('"').trim();
    for (open, close) in [('[', ']'), ('(', ')')] {
        if let Some((before, inner)) = key.strip_suffix(close).and_then(|k| k.rsplit_once(open)) {
            (key, unit) = (before.trim(), inner.trim().to_owned());
        }
    }
    if let Some((before, last)) = key.rsplit_once('_')
        && unit.is_empty()
        && known(last).is_some()
    {
        (key, unit) = (before, last.to_owned());
    }
    let words = key.split(|c: char| !c.is_alphanumeric());
    let words: Vec<String> = words
        .filter(|w| !w.is_empty())
        .map(str::to_lowercase)
        .collect();
    (words.join(" "), unit)
}

/// A number and the unit after it.
fn quantity(value: &str) -> Option<(f64, &str)> {
    let value = value.trim_matches(|c: char| c.is_whitespace() || ";,\"".contains(c));
    let end = value
        .find(|c: char| !(c.is_ascii_digit() || "+-.,eE\u{2212}".contains(c)))
        .unwrap_or(value.len());
    // "400 eV" does not end in an exponent.
    let digits = value[..end].trim_end_matches([',', 'e', 'E', '+', '-']);
    let rest = bare(&value[digits.len()..]);
    Some((number(digits)?, rest))
}

/// A unit without the surrounding brackets and marks.
fn bare(unit: &str) -> &str {
    let unit = unit.trim_matches(|c: char| c.is_whitespace() || ";,\"[]()".contains(c));
    // A second word means that the text is not a unit.
    match unit.split_once(char::is_whitespace) {
        Some((first, _)) if known(first).is_some() || is_foreign(first) => first,
        _ => unit,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(lines: &[&str]) -> Header {
        let mut header = Header::default();
        for line in lines {
            assert!(header.take(line).unwrap(), "{line}");
        }
        header
    }

    #[test]
    fn sizes_steps_and_units_are_read_in_the_forms_that_programs_write() {
        for lines in [
            &["Width: 400.0 µm", "Height: 64.00 µm", "Value units: m"][..],
            &["Breite: 400,0 µm", "Höhe: 64,00 µm", "Werteeinheiten: m"],
            &[
                "Largeur : 0,4 mm",
                "Hauteur : 0,064 mm",
                "Unités des valeurs : m",
            ],
            &["X Size = 400.0 um", "Y Size = 64 um", "Z Unit = m"],
            &["dx [nm]; 1000", "dy [nm]; 1000", "unit; m"],
            &["Pixel size (µm): 1,0", "Unit: m"],
            &["Lateral resolution,1.0,um", "Z units,m"],
            &["XY unit: µm", "Width: 400", "Height: 64", "Z-Unit: m"],
            &[
                "Scan size: 400 x 64 µm",
                "Image size: 400 x 64 pixels",
                "Unit: m",
            ],
            &["Field of view [mm] = 0,4 × 0,064", "Unit: m"],
            &["pixel_size_um = 1", "z_scale = 1e6 µm"],
            &[
                "X-Schrittweite: 1,0 \u{3bc}m",
                "Y-Schrittweite: 1,0 \u{3bc}m",
                "Einheit: m",
            ],
        ] {
            let header = of(lines);
            let [u, v] = header.pitch_um(400, 64).unwrap();
            assert!(
                (u - 1.0).abs() < 1e-12 && (v - 1.0).abs() < 1e-12,
                "{lines:?}"
            );
            assert_eq!(header.value_um(), Some(1e6), "{lines:?}");
        }
        assert_eq!(of(&["NODATA_value -9999", "ncols 400"]).marks, [-9999.0]);
        let samples = of(&["Width: 400 px", "Height: 64 pixels", "Width: 400"]);
        assert_eq!(samples.pitch_um(400, 64), None);
    }

    #[test]
    fn other_lines_are_ignored_and_unsupported_units_are_named() {
        let mut header = Header::default();
        for line in [
            "Channel: Height",
            "Kanal: Höhe",
            "taken at noon",
            "1.5 2.5",
            "v_mm,z_um",
            "",
        ] {
            assert!(!header.take(line).unwrap(), "{line}");
        }
        let why = header.take("Width: 3 furlong").unwrap_err();
        assert!(why.contains("width") && why.contains("furlong"), "{why}");
        assert!(header.take("Value units: V").unwrap_err().contains("\"V\""));
    }
}
