//! The columns of a CSV table: their names, and the units that the names state.

use super::manifest::{Goniometer, ValueKind, ValueScale};

/// The columns with their accepted names, without case, unit and separators.
pub(super) const COLUMNS: [(&str, &[&str]); 6] = [
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
/// Spellings of 1/sr, without spaces, signs of a power, and brackets.
const PER_SR: [&str; 4] = ["1/sr", "sr-1", "persr", "/sr"];
const DEGREES: [&str; 4] = ["deg", "degree", "degrees", "°"];
/// Units that occur at the end of a name without brackets and are refused.
const FOREIGN: [&str; 9] = [
    "radian", "radians", "mrad", "grad", "gon", "arcmin", "arcsec", "sr", "percent",
];

/// A unit that a column's name states.
#[derive(Debug, Clone, PartialEq, Eq)]
enum Unit {
    Unstated,
    Degree,
    Radian,
    PerSr,
    One,
    Percent,
    Other(String),
}

impl Unit {
    fn of(text: &str) -> Unit {
        let plain: String = text
            .chars()
            .filter(|c| !c.is_whitespace() && !"^_".contains(*c))
            .map(|c| match c {
                '⁻' | '−' => '-',
                '¹' => '1',
                c => c,
            })
            .collect();
        match plain.as_str() {
            "" => Unit::Unstated,
            "rad" => Unit::Radian,
            "1" | "-" => Unit::One,
            "%" => Unit::Percent,
            unit if DEGREES.contains(&unit) => Unit::Degree,
            unit if PER_SR.contains(&unit) => Unit::PerSr,
            _ => Unit::Other(text.trim().to_owned()),
        }
    }
}

/// A column's name without case, unit and separators, and its unit: in brackets, or a unit at the
/// end.
fn name_and_unit(header: &str) -> (String, Unit) {
    let lower = header
        .to_lowercase()
        .replace('θ', "theta")
        .replace(['φ', 'ϕ'], "phi");
    let lower = lower.trim();
    let bracketed = lower.strip_suffix([']', ')']);
    let (name, unit) = match bracketed.and_then(|inner| inner.rsplit_once(['[', '('])) {
        Some((name, unit)) => (name, Unit::of(unit)),
        None => {
            let begins = |at: usize| {
                lower[at..].starts_with(['%', '°', '/'])
                    || lower[..at].ends_with(|c: char| !c.is_alphanumeric())
            };
            let ends = lower.char_indices().filter(|(at, _)| begins(*at));
            let found = ends
                .map(|(at, _)| (&lower[..at], Unit::of(&lower[at..])))
                .find(|(_, unit)| match unit {
                    Unit::Unstated | Unit::One => false,
                    Unit::Other(word) => FOREIGN.contains(&word.as_str()),
                    _ => true,
                });
            found.unwrap_or((lower, Unit::Unstated))
        }
    };
    let name = name.chars().filter(|c| c.is_alphanumeric()).collect();
    (name, unit)
}

/// Unit of a column of uncertainties.
#[derive(Debug, Clone, Copy, PartialEq)]
enum SigmaUnit {
    /// That of the values.
    OfValues,
    /// Per cent of the value.
    PercentOfValue,
}

/// Where the columns are, and how to convert their numbers.
#[derive(Debug)]
pub(super) struct Columns {
    places: [Option<usize>; COLUMNS.len()],
    /// What a number of each column is multiplied by; a share of the value for sigma in per cent.
    factors: [f64; COLUMNS.len()],
    sigma: SigmaUnit,
    /// The wavelength's column, and nanometres per unit of it.
    wavelength: Option<(usize, f64)>,
    /// Columns of polarisations.
    polarisations: Vec<usize>,
}

/// The column of wavelengths, and nanometres per unit of it.
fn wavelength_of(headers: &csv::StringRecord) -> Result<Option<(usize, f64)>, String> {
    for (place, header) in headers.iter().enumerate() {
        let plain = header.to_lowercase().replace('λ', "lambda");
        let words: Vec<&str> = plain
            .split(|c: char| !c.is_alphanumeric())
            .filter(|word| !word.is_empty() && *word != "i")
            .collect();
        let nanometres = match words[..] {
            ["wavelength" | "lambda" | "wl"] | ["wavelength" | "lambda" | "wl", "nm"] => 1.0,
            // Two characters that look alike.
            ["wavelength" | "lambda" | "wl", "um" | "µm" | "μm"] => 1e3,
            ["wavelength" | "lambda", _] => {
                return Err(format!(
                    "the unit of the column `{header}` is not one of wavelengths: convert the column to nm or µm"
                ));
            }
            _ => continue,
        };
        return Ok(Some((place, nanometres)));
    }
    Ok(None)
}

impl Columns {
    /// Finds the columns in a header.
    ///
    /// # Errors
    /// A column is missing, occurs twice, or states a unit that is not one of its own.
    pub(super) fn find(headers: &csv::StringRecord, facts: &Goniometer) -> Result<Self, String> {
        let names: Vec<(String, Unit)> = headers.iter().map(name_and_unit).collect();
        let mut places = [None; COLUMNS.len()];
        for (place, (column, known)) in places.iter_mut().zip(COLUMNS) {
            let mut found = (0..names.len()).filter(|i| known.contains(&names[*i].0.as_str()));
            *place = found.next();
            match (*place, found.next()) {
                (None, _) if column != "sigma" => {
                    let needed: Vec<&str> = COLUMNS[..5].iter().map(|c| c.0).collect();
                    let got: Vec<String> = headers.iter().map(|h| format!("`{h}`")).collect();
                    return Err(format!(
                        "the column {column} is missing: the header needs {}, and may have sigma; it has {}",
                        needed.join(","),
                        got.join(", ")
                    ));
                }
                (Some(a), Some(b)) => {
                    return Err(format!(
                        "the columns `{}` and `{}` both mean {column}: remove one",
                        &headers[a], &headers[b]
                    ));
                }
                _ => {}
            }
        }
        let unit = |column: usize| places[column].map_or(&Unit::Unstated, |place| &names[place].1);
        let refused = |column: usize, known: &str| {
            let header = places[column].map_or("", |place| &headers[place]);
            let name = COLUMNS[column].0;
            format!(
                "the unit of the column `{header}` is not one of {name}: convert the column to {known}"
            )
        };
        let mut factors = [1.0; COLUMNS.len()];
        for (column, factor) in factors.iter_mut().enumerate().take(4) {
            *factor = match unit(column) {
                Unit::Unstated | Unit::Degree => 1.0,
                Unit::Radian => 1f64.to_degrees(),
                _ => return Err(refused(column, "deg (°) or rad")),
            };
        }
        let is_factor = facts.value == ValueKind::RadianceFactor;
        let known = match is_factor {
            true => "1 or %, those of goniometer.value = \"radiance-factor\"",
            false => "1/sr (sr^-1), that of goniometer.value",
        };
        factors[4] = match unit(4) {
            // An arbitrary unit has no effect.
            _ if facts.scale == ValueScale::Relative => 1.0,
            Unit::Unstated => 1.0,
            Unit::PerSr if !is_factor => 1.0,
            Unit::One if is_factor => 1.0,
            Unit::Percent if is_factor => 0.01,
            _ => return Err(refused(4, known)),
        };
        factors[5] = factors[4];
        let sigma = match (unit(5), unit(4)) {
            (Unit::Percent, Unit::Percent) => {
                return Err(refused(
                    5,
                    "the unit of the values without stating it, since % of a value in % has two meanings",
                ));
            }
            (Unit::Percent, _) => SigmaUnit::PercentOfValue,
            (Unit::Unstated, _) => SigmaUnit::OfValues,
            (sigma, value) if sigma == value => SigmaUnit::OfValues,
            (Unit::PerSr, Unit::Unstated) if !is_factor => SigmaUnit::OfValues,
            (Unit::One, Unit::Unstated) if is_factor => SigmaUnit::OfValues,
            _ => return Err(refused(5, "the unit of the values, or to % of the value")),
        };
        let is_polarisation = |header: &str| {
            let lower = header.to_lowercase();
            lower.starts_with("polari") || lower == "pol" || lower.starts_with("pol_")
        };
        let polarisations = (0..headers.len()).filter(|n| is_polarisation(&headers[*n]));
        Ok(Columns {
            places,
            factors,
            sigma,
            wavelength: wavelength_of(headers)?,
            polarisations: polarisations.collect(),
        })
    }

    /// The wavelength of a reading in nm, if the table states it.
    ///
    /// # Errors
    /// The field is not a number.
    pub(super) fn wavelength(
        &self,
        record: &csv::StringRecord,
        number: impl Fn(&str) -> Result<f64, String>,
    ) -> Result<Option<f64>, String> {
        match self.wavelength {
            Some((place, nanometres)) if !record[place].is_empty() => {
                Ok(Some(nanometres * number(&record[place])?))
            }
            _ => Ok(None),
        }
    }

    /// The polarisations that a reading states.
    pub(super) fn polarisations<'r>(
        &self,
        record: &'r csv::StringRecord,
    ) -> impl Iterator<Item = &'r str> {
        self.polarisations.iter().map(|place| &record[*place])
    }

    /// The field of a column, if the table has the column.
    pub(super) fn field<'r>(
        &self,
        record: &'r csv::StringRecord,
        column: usize,
    ) -> Option<&'r str> {
        self.places[column].map(|place| &record[place])
    }

    /// A number of a column other than sigma in degrees or in the unit of the manifest.
    pub(super) fn converted(&self, column: usize, number: f64) -> f64 {
        // A factor of 1 keeps all digits.
        self.factors[column] * number
    }

    /// A stated uncertainty in the unit of the manifest, for a value in that unit. Per cent of a
    /// value of 0 state none.
    pub(super) fn sigma(&self, value: f64, stated: f64) -> Option<f64> {
        match self.sigma {
            SigmaUnit::OfValues => Some(self.factors[5] * stated),
            SigmaUnit::PercentOfValue => {
                Some(value.abs() * stated / 100.0).filter(|sigma| *sigma > 0.0)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_unit_of_a_column_is_in_brackets_or_at_the_end_of_its_name() {
        for (header, name, unit) in [
            ("theta_i_deg", "thetai", Unit::Degree),
            ("θ_i [°]", "thetai", Unit::Degree),
            ("phi_r_rad", "phir", Unit::Radian),
            ("BRDF/sr⁻¹", "brdf", Unit::PerSr),
            ("BRDF [1/sr]", "brdf", Unit::PerSr),
            ("brdf (sr^-1)", "brdf", Unit::PerSr),
            ("brdf per sr", "brdf", Unit::PerSr),
            ("uBRDF %", "ubrdf", Unit::Percent),
            ("uBRDF[%]", "ubrdf", Unit::Percent),
            ("radiance factor", "radiancefactor", Unit::Unstated),
            ("theta_i_mrad", "thetai", Unit::Other("mrad".to_owned())),
            ("value_dark", "valuedark", Unit::Unstated),
        ] {
            let found = name_and_unit(header);
            assert_eq!(found, (name.to_owned(), unit), "{header}");
        }
    }
}
