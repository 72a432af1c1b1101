//! The BRDF of the sawtooth over a table, with the terms of real samples; angles in rad, φ from u towards v.

use nalgebra::Vector3;

use super::{InputCase, Table};
use crate::geometry::{Cones, Directions};
use crate::model::extended::slopes::TAIL_MAX;
use crate::model::extended::{CREST_MAX, LAND_MAX, Real};
use crate::model::surface_brdf::SurfaceBrdf;
use crate::model::{Optics, Surface, Variant, domain};

/// theta_i … land_share → f.
pub(super) const TABLE: Table = Table {
    inputs: &[
        "theta_i",
        "phi_i",
        "theta_o",
        "phi_o",
        "theta_r",
        "alpha_u",
        "alpha_v",
        "rho_d",
        "eta",
        "k",
        "theta_l",
        "translucency",
        "tail",
        "crest_radius",
        "land_share",
    ],
    outputs: &["f"],
    compute,
};

fn compute(row: &InputCase<'_>) -> Result<Vec<f64>, String> {
    let direction = |theta: usize| -> Result<Vector3<f64>, String> {
        let (zenith, azimuth) = (row.number(theta)?, row.number(theta + 1)?);
        if zenith.abs() >= std::f64::consts::FRAC_PI_2 {
            return Err("theta_i and theta_o must be within ±π/2: above the surface".to_owned());
        }
        let (sin, cos) = zenith.sin_cos();
        Ok(Vector3::new(sin * azimuth.cos(), sin * azimuth.sin(), cos))
    };
    let share = |column: usize, name: &str, most: f64| -> Result<f64, String> {
        let value = row.number(column)?;
        match (0.0..=most).contains(&value) {
            true => Ok(value),
            false => Err(format!("{name} = {value} is not within 0 and {most}")),
        }
    };
    let directions = Directions {
        incident: direction(0)?,
        outgoing: direction(2)?,
    };
    let surface = Surface {
        theta_r: row.number(4)?,
        alpha_u: row.number(5)?,
        alpha_v: row.number(6)?,
        rho_d: row.number(7)?,
        amplitude: 1.0,
    };
    if surface.theta_r < 0.0 {
        return Err("theta_r is negative: turn phi_i and phi_o by π instead".to_owned());
    }
    let optics = Optics {
        eta: row.number(8)?,
        k: row.number(9)?,
        theta_l: row.number(10)?,
        cones: Cones::NONE,
    };
    domain::check(&surface, &optics).map_err(|error| error.to_string())?;
    let real = Real {
        translucency: share(11, "translucency", 1.0)?,
        tail: share(12, "tail", TAIL_MAX)?,
        crest: share(13, "crest_radius", CREST_MAX)?,
        land: share(14, "land_share", LAND_MAX)?,
    };
    let real = (real != Real::NONE).then_some(real);
    let brdf = SurfaceBrdf::new(Variant::Sawtooth, surface, real, &optics);
    Ok(vec![brdf.value(&directions)])
}
