//! Materials by name: n and k over wavelength from the tables in `assets/optical-constants`.
//!
//! Call [`index_of`], or [`metal`] for a sample's nominal material. `Au`, `Al`, `Cu`, `Ag`, `Cr`,
//! `W` are interpolated linearly in wavelength; `Au550`, `Al550`, `Cu550` are fixed numbers. Other
//! published tables differ, for gold by up to 0.7 in k, so a result names its table.

use nalgebra::Complex;

use super::Material;

/// Names with fixed indices: their tables at 550 nm, rounded to four decimals.
pub const FIXED_METALS: [(&str, f64, f64); 3] = [
    ("Au550", 0.3504, 2.7141),
    ("Al550", 0.9586, 6.6870),
    ("Cu550", 0.9582, 2.5771),
];

/// Names and tables (`wavelength_nm,n,k`).
const TABLES: [(&str, &str); 6] = [
    ("Ag", include_str!("../../assets/optical-constants/Ag.csv")),
    ("Al", include_str!("../../assets/optical-constants/Al.csv")),
    ("Au", include_str!("../../assets/optical-constants/Au.csv")),
    ("Cr", include_str!("../../assets/optical-constants/Cr.csv")),
    ("Cu", include_str!("../../assets/optical-constants/Cu.csv")),
    ("W", include_str!("../../assets/optical-constants/W.csv")),
];

/// Why a name has no index.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum MaterialError {
    /// The material is unknown.
    #[error(
        "unknown material {name:?}: the known ones are Ag, Al, Au, Cr, Cu, W and Au550, Al550, Cu550"
    )]
    Unknown {
        /// The requested name.
        name: String,
    },
    /// The wavelength is outside the table.
    #[error("{asked} nm is outside the table of {name}, which covers {from} nm to {to} nm")]
    OutOfTable {
        /// The material.
        name: String,
        /// The requested wavelength, nm.
        asked: f64,
        /// First wavelength, nm.
        from: f64,
        /// Last wavelength, nm.
        to: f64,
    },
}

/// Whether a name refers to a table over the wavelength.
#[must_use]
pub fn is_dispersive(name: &str) -> bool {
    TABLES.iter().any(|t| t.0 == name)
}

/// Returns the complex index n + ik of a named material at a wavelength in nm.
///
/// # Errors
/// The name is unknown, or the wavelength is outside its table.
pub fn index_of(name: &str, wavelength_nm: f64) -> Result<Complex<f64>, MaterialError> {
    if let Some(metal) = FIXED_METALS.iter().find(|m| m.0 == name) {
        return Ok(Complex::new(metal.1, metal.2));
    }
    let Some((_, table)) = TABLES.iter().find(|t| t.0 == name) else {
        return Err(MaterialError::Unknown {
            name: name.to_owned(),
        });
    };
    let rows: Vec<[f64; 3]> = table.lines().filter_map(row).collect();
    let (from, to) = (rows[0][0], rows[rows.len() - 1][0]);
    if !(from..=to).contains(&wavelength_nm) {
        return Err(MaterialError::OutOfTable {
            name: name.to_owned(),
            asked: wavelength_nm,
            from,
            to,
        });
    }
    let after = rows
        .partition_point(|r| r[0] <= wavelength_nm)
        .clamp(1, rows.len() - 1);
    let (a, b) = (rows[after - 1], rows[after]);
    let t = (wavelength_nm - a[0]) / (b[0] - a[0]);
    let between = |i: usize| a[i] + t * (b[i] - a[i]);
    Ok(Complex::new(between(1), between(2)))
}

/// Relative difference of n and of k between published tables of one metal (gold near 550 nm, see
/// the README beside the tables): the standard uncertainty of an index that was not measured.
pub const RELATIVE_STD: f64 = 0.1;

/// Returns a named metal at a wavelength in nm as a sample's nominal material, with
/// [`RELATIVE_STD`].
///
/// # Errors
/// As [`index_of`].
pub fn metal(name: &str, wavelength_nm: f64) -> Result<Material, MaterialError> {
    let index = index_of(name, wavelength_nm)?;
    Ok(Material::Conductor {
        eta: index.re,
        k: index.im,
        eta_std: RELATIVE_STD * index.re,
        k_std: RELATIVE_STD * index.im,
    })
}

fn row(line: &str) -> Option<[f64; 3]> {
    let mut numbers = line.split(',').map(|x| x.trim().parse::<f64>().ok());
    Some([numbers.next()??, numbers.next()??, numbers.next()??])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_fixed_indices_are_their_tables_at_550_nm() {
        for (name, fixed) in [("Au", "Au550"), ("Al", "Al550"), ("Cu", "Cu550")] {
            let difference = index_of(name, 550.0).unwrap() - index_of(fixed, 0.0).unwrap();
            assert!(difference.norm() < 1e-4, "{name}: {difference}");
        }
    }

    #[test]
    fn every_table_is_read_to_both_ends_and_not_beyond() {
        for (name, _) in TABLES {
            let index = index_of(name, 633.0).unwrap();
            assert!(index.re > 0.0 && index.im > 1.0, "{name}");
            assert!(matches!(
                index_of(name, 5000.0),
                Err(MaterialError::OutOfTable { .. })
            ));
        }
        assert!(matches!(
            index_of("Gold", 550.0),
            Err(MaterialError::Unknown { .. })
        ));
    }

    #[test]
    fn a_wavelength_just_outside_is_shown_beside_the_ends_of_the_table() {
        for (name, _) in TABLES {
            let Err(MaterialError::OutOfTable { from, to, .. }) = index_of(name, 1e6) else {
                panic!("no table reaches a millimetre");
            };
            assert!(index_of(name, from).is_ok() && index_of(name, to).is_ok());
            for near in [from.floor() - 1.0, to.ceil()] {
                if let Err(refused) = index_of(name, near) {
                    let message = refused.to_string();
                    assert!(message.starts_with(&format!("{near} nm")), "{message}");
                    assert!(
                        message.ends_with(&format!("{from} nm to {to} nm")),
                        "{message}"
                    );
                }
            }
        }
    }

    #[test]
    fn a_metal_by_name_is_a_conductor_with_the_spread_of_published_tables() {
        let index = index_of("Cr", 633.0).unwrap();
        let Ok(Material::Conductor { eta, k, k_std, .. }) = metal("Cr", 633.0) else {
            panic!("a conductor");
        };
        assert_eq!((eta, k), (index.re, index.im));
        assert_eq!(k_std, RELATIVE_STD * k);
    }
}
