//! The table `mueller`: unmasked single bounce on Beckmann slopes, SCATMECH's conventions.

use super::{InputCase, Table};
use crate::model::single_bounce::{Scattering, mueller_brdf};

pub(super) const TABLE: Table = Table {
    inputs: &["n", "k", "alpha", "theta_i_deg", "theta_s_deg", "phi_s_deg"],
    outputs: &[
        "m00", "m01", "m02", "m03", "m10", "m11", "m12", "m13", "m20", "m21", "m22", "m23", "m30",
        "m31", "m32", "m33",
    ],
    compute,
};

fn compute(row: &InputCase<'_>) -> Result<Vec<f64>, String> {
    let (n, k, alpha) = (row.number(0)?, row.number(1)?, row.number(2)?);
    let (theta_i, theta_s) = (row.number(3)?, row.number(4)?);
    if n <= 0.0 || k < 0.0 {
        return Err("the index needs n > 0 and k >= 0".to_owned());
    }
    if alpha <= 0.0 {
        return Err("alpha must be greater than 0".to_owned());
    }
    if !(0.0..90.0).contains(&theta_i) || !(0.0..90.0).contains(&theta_s) {
        return Err("theta_i_deg and theta_s_deg must be in [0, 90)".to_owned());
    }
    let scattering = Scattering {
        theta_i: theta_i.to_radians(),
        theta_s: theta_s.to_radians(),
        phi_s: row.number(5)?.to_radians(),
    };
    let m =
        mueller_brdf(&scattering, alpha, n, k).ok_or("no scattering between these directions")?;
    Ok(m.0.transpose().iter().copied().collect())
}
