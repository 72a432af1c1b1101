//! The printed BRDF over a table; angles in rad, φ from u towards v.

use super::{InputCase, Table};
use crate::model::brdf::{Case, evaluate};

/// theta_i … k → f, d, g, fresnel.
pub(super) const TABLE: Table = Table {
    inputs: &[
        "theta_i", "phi_i", "theta_o", "phi_o", "theta_r", "alpha_u", "alpha_v", "rho_d", "eta",
        "k",
    ],
    outputs: &["f", "d", "g", "fresnel"],
    compute,
};

fn compute(row: &InputCase<'_>) -> Result<Vec<f64>, String> {
    let case = Case {
        theta_i: row.number(0)?,
        phi_i: row.number(1)?,
        theta_o: row.number(2)?,
        phi_o: row.number(3)?,
        theta_r: row.number(4)?,
        alpha_u: row.number(5)?,
        alpha_v: row.number(6)?,
        rho_d: row.number(7)?,
        eta: row.number(8)?,
        k: row.number(9)?,
    };
    let e = evaluate(&case).map_err(|refusal| refusal.to_string())?;
    Ok(vec![e.f, e.d, e.g, e.fresnel])
}
