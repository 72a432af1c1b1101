//! The exact visibility of the sawtooth over a table; angles of the projected directions from n.

use super::{InputCase, Table};
use crate::model::sawtooth::visible_and_lit_fraction;

/// theta_r_deg, theta_i_proj_deg, theta_o_proj_deg → visible_and_lit_fraction.
pub(super) const TABLE: Table = Table {
    inputs: &["theta_r_deg", "theta_i_proj_deg", "theta_o_proj_deg"],
    outputs: &["visible_and_lit_fraction"],
    compute,
};

fn compute(row: &InputCase<'_>) -> Result<Vec<f64>, String> {
    let (theta_r_deg, i_deg, o_deg) = (row.number(0)?, row.number(1)?, row.number(2)?);
    if !(0.0..90.0).contains(&theta_r_deg) {
        return Err(format!(
            "theta_r_deg = {theta_r_deg} is not within 0 and 90"
        ));
    }
    Ok(vec![visible_and_lit_fraction(theta_r_deg, i_deg, o_deg)])
}
