//! Names of quantities and of the lines of a budget, as people read them. JSON, specifications and options have the keys.

/// A quantity as people read it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct QuantityName {
    /// Symbol; empty where the name is enough.
    pub symbol: &'static str,
    /// What it is.
    pub name: &'static str,
    /// Unit as it follows a number, with its blank; empty for a number without one.
    pub unit: &'static str,
}

impl QuantityName {
    /// Returns symbol and name in one text.
    #[must_use]
    pub fn full(&self) -> String {
        match self.symbol {
            "" => self.name.to_owned(),
            symbol => format!("{symbol} {}", self.name),
        }
    }
}

/// Quantities by their keys.
#[rustfmt::skip]
const QUANTITIES: [(&str, &str, &str, &str); 14] = [
    ("theta_r_deg", "θr", "ridge angle", "°"),
    ("alpha_u", "αu", "roughness along", ""),
    ("alpha_v", "αv", "roughness across", ""),
    ("rho_d", "ρd", "diffuse reflectance", ""),
    ("scale", "g", "gain (scale)", ""),
    ("background", "B", "stray light", ""),
    ("azimuth_offset_deg", "Δφs", "azimuth offset", "°"),
    ("tilt_offset_deg", "Δθc", "tilt offset", "°"),
    ("translucency", "τ", "translucency", ""),
    ("crest_radius", "R/p", "crest radius", ""),
    ("land_share", "f", "share of flat lands", ""),
    ("lean_azimuth_deg", "", "azimuth of the lean", "°"),
    ("contrast_mean", "", "mean contrast", " sr⁻¹"),
    ("contrast_michelson_mean", "", "mean Michelson contrast", ""),
];

/// Returns the name of a quantity by its key; a key without a name is its own.
#[must_use]
pub fn quantity(key: &'static str) -> QuantityName {
    known(key).unwrap_or(QuantityName {
        symbol: "",
        name: key,
        unit: "",
    })
}

/// Returns the name of a quantity by its key, if it has one.
#[must_use]
pub fn known(key: &str) -> Option<QuantityName> {
    let row = QUANTITIES.iter().find(|row| row.0 == key)?;
    let (_, symbol, name, unit) = *row;
    Some(QuantityName { symbol, name, unit })
}

/// Returns what a line of an uncertainty budget contains.
#[must_use]
pub fn budget_line(key: &str) -> &'static str {
    match key {
        "counting" => "counting noise of sample and white reference",
        "reference" => "certificate of the white reference",
        "angles" => "angles of the stages, angle between lamp and camera",
        "material" => "refractive index of the material",
        "wedge" => "tilt of the sample on the turntable",
        "drift" => "drift of the lamp",
        "detector" => "linearity and exposure times of the camera",
        "background" => "stray light",
        "model" => "model error",
        "shape" => "departure from the linear approximation",
        "prior" => "values stated for this fit",
        "tracer" => "standard error of the ray tracer",
        _ => "",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_have_names_with_units() {
        let angle = quantity("theta_r_deg");
        assert_eq!((angle.full().as_str(), angle.unit), ("θr ridge angle", "°"));
        assert_eq!(quantity("contrast_mean").full(), "mean contrast");
        assert_eq!(known("theta_r"), None);
    }
}
