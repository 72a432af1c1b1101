//! The table `stack`: flat layers over each other, exactly.

use super::{InputCase, Table};
use crate::model::flat_stack::FlatStack;

pub(super) const TABLE: Table = Table {
    inputs: &["stack", "theta_deg"],
    outputs: &[
        "Rs",
        "Rp",
        "m22_re_z",
        "m23_im_z",
        "R_polarised",
        "R_scalar",
    ],
    compute,
};

fn compute(row: &InputCase<'_>) -> Result<Vec<f64>, String> {
    let stack = FlatStack::parse(row.text(0)).map_err(|e| e.to_string())?;
    let theta = row.number(1)?;
    if !(0.0..90.0).contains(&theta) {
        return Err("theta_deg must be in [0, 90)".to_owned());
    }
    let r = stack.reflect_deg(theta).map_err(|e| e.to_string())?;
    Ok(vec![
        r.channel.s,
        r.channel.p,
        r.channel.re,
        r.channel.im,
        r.channel.unpolarised(),
        r.scalar,
    ])
}
