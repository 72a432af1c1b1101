//! The light of the readings of a table: of several wavelengths one is fitted, and only unpolarised light.

use super::manifest::Goniometer;

/// Largest difference of a wavelength from the requested one, nm.
const SAME_NM: f64 = 0.5;

/// Whether a reading's wavelength is not the one to fit, both in nm.
pub(super) fn is_other_wavelength(own: f64, wanted: f64) -> bool {
    (own - wanted).abs() > SAME_NM
}

/// The wavelength to read, nm; `None` if the file has at most one and the manifest states none.
///
/// # Errors
/// The manifest states none of the wavelengths of the readings.
pub(super) fn wavelength(mut found: Vec<f64>, facts: &Goniometer) -> Result<Option<f64>, String> {
    found.sort_by(f64::total_cmp);
    found.dedup_by(|a, b| (*a - *b).abs() <= SAME_NM);
    if found.is_empty() || (found.len() == 1 && facts.wavelength_nm.is_none()) {
        return Ok(None);
    }
    let listed = || {
        // Micrometres are converted with a rounding in the last digits.
        let some = found
            .iter()
            .take(8)
            .map(|w| format!("{}", (w * 1e3).round() / 1e3));
        some.collect::<Vec<_>>().join(", ")
    };
    match facts.wavelength_nm {
        None => Err(format!(
            "the file has {} wavelengths ({} nm): set goniometer.wavelength_nm to the one to fit",
            found.len(),
            listed()
        )),
        Some(wanted) if found.iter().all(|w| (w - wanted).abs() > SAME_NM) => Err(format!(
            "no reading is at goniometer.wavelength_nm = {wanted} nm: the file has {} nm",
            listed()
        )),
        wanted => Ok(wanted),
    }
}

/// Whether a word of a table states unpolarised light; a blank states nothing else.
pub(super) fn is_unpolarised(word: &str) -> bool {
    let word = word.trim().to_lowercase();
    ["", "u", "0", "-", "n", "no", "none", "random"].contains(&word.as_str())
        || word.starts_with("unpol")
}
