//! The media of a scene: refractive indices at each boundary and absorption in each layer.

use std::f64::consts::FRAC_PI_2;

use nalgebra::Complex;

use super::error::{positive, value};
use super::{InterfaceShape, LeftOut, Scene, SceneError};
use crate::material::tables;
use crate::model::fresnel;
use crate::model::polarisation::{Boundary, excess, slant};

/// The media of a scene.
pub(super) struct SceneOptics {
    /// One per interface, top first.
    pub(super) steps: Vec<MediumStep>,
    pub(super) left_out: Vec<LeftOut>,
}

/// The transition from one medium to the next.
pub(super) struct MediumStep {
    /// n + ik above.
    pub(super) above: Complex<f64>,
    /// n + ik below.
    pub(super) below: Complex<f64>,
    /// Optical depth of the layer below, at normal incidence.
    pub(super) optical_depth: f64,
    /// Diffuse reflectance of a diffuse body below.
    pub(super) rho_d: Option<f64>,
}

struct Medium {
    index: Complex<f64>,
    rho_d: Option<f64>,
}

impl Scene {
    /// Returns the media of all interfaces, top first.
    pub(super) fn optics(&self) -> Result<SceneOptics, SceneError> {
        let mut optics = SceneOptics {
            steps: Vec::new(),
            left_out: Vec::new(),
        };
        let mut above = Complex::new(self.n_top, 0.0);
        for (i, shape) in self.interface.iter().enumerate() {
            let number = i + 1;
            let last = number == self.interface.len();
            let medium = self.medium(shape, number, above.re)?;
            if medium.rho_d.is_some() && !last {
                return Err(SceneError::Unreachable { number });
            }
            let left_out = &mut optics.left_out;
            let optical_depth = self.layer(shape, number, above, &medium, last, left_out)?;
            optics.steps.push(MediumStep {
                above,
                below: medium.index,
                optical_depth,
                rho_d: medium.rho_d,
            });
            above = medium.index;
        }
        Ok(optics)
    }

    fn medium(
        &self,
        shape: &InterfaceShape,
        number: usize,
        above: f64,
    ) -> Result<Medium, SceneError> {
        let key = |k: &str| format!("interface {number}: below.{k}");
        match &shape.below {
            toml::Value::String(name) => {
                let index = tables::index_of(name, self.light.wavelength_nm)
                    .map_err(|source| SceneError::Material { number, source })?;
                Ok(Medium { index, rho_d: None })
            }
            toml::Value::Table(table) => {
                let number_of = |name: &str| match table.get(name) {
                    None => Ok(None),
                    Some(toml::Value::Float(x)) => Ok(Some(*x)),
                    Some(toml::Value::Integer(x)) => Ok(Some(*x as f64)),
                    Some(other) => Err(value(&key(name), other, "must be a number")),
                };
                if let Some(unknown) = table
                    .keys()
                    .find(|k| !["n", "k", "rho_d"].contains(&k.as_str()))
                {
                    return Err(value(
                        &key(unknown),
                        &table[unknown],
                        "unknown key; the known ones are n, k and rho_d",
                    ));
                }
                let n = number_of("n")?.ok_or(SceneError::Missing {
                    number,
                    shape: shape.shape.clone(),
                    key: "below.n",
                })?;
                index(&key("n"), n)?;
                let k = number_of("k")?.unwrap_or(0.0);
                if !(0.0..=*INDEX_RANGE.end()).contains(&k) {
                    return Err(value(&key("k"), k, "must be from 0 to 1e30"));
                }
                let rho_d = number_of("rho_d")?;
                if let Some(rho) = rho_d {
                    let t = fresnel::transmittance(1.0, n / above, 0.0);
                    if k > 0.0 || !(rho >= 0.0 && rho <= t * t) {
                        return Err(value(
                            &key("rho_d"),
                            rho,
                            "needs k = 0 and must be from 0 to the boundary's transmittance",
                        ));
                    }
                }
                Ok(Medium {
                    index: Complex::new(n, k),
                    rho_d,
                })
            }
            other => Err(value(
                &format!("interface {number}: below"),
                other,
                "must be { n = 1.5 }, { n = 0.35, k = 2.7 } or a material's name",
            )),
        }
    }

    /// Optical depth of the layer below.
    fn layer(
        &self,
        shape: &InterfaceShape,
        number: usize,
        above: Complex<f64>,
        medium: &Medium,
        last: bool,
        left_out: &mut Vec<LeftOut>,
    ) -> Result<f64, SceneError> {
        if let Some(thickness) = shape.thickness_um {
            positive(&format!("interface {number}: thickness_um"), thickness)?;
        }
        let k = medium.index.im;
        if last && shape.thickness_um.is_some() {
            left_out.push(LeftOut {
                what: format!("thickness_um of interface {number}"),
                why: "the medium below the last interface has no lower boundary: light that enters it does not return"
                    .to_owned(),
                cost: None,
            });
        }
        if last || k == 0.0 {
            return Ok(0.0);
        }
        // With stronger absorption the layer is opaque within a wavelength: it is a substrate, not
        // a layer.
        let (n, limit) = (medium.index.re, 0.1 * medium.index.re);
        if k > limit {
            let named = matches!(shape.below, toml::Value::String(_));
            return Err(match named {
                true => SceneError::Unreachable { number },
                false => SceneError::Opaque {
                    number,
                    n,
                    k,
                    limit,
                },
            });
        }
        let Some(thickness) = shape.thickness_um else {
            return Err(SceneError::Missing {
                number,
                shape: shape.shape.clone(),
                key: "thickness_um (the layer below absorbs)",
            });
        };
        let depth = 4.0e3 * std::f64::consts::PI * k * thickness / self.light.wavelength_nm;
        left_out.push(LeftOut {
            what: format!("absorption within the relief of interface {number}"),
            why: "a layer absorbs over its thickness between mean planes".to_owned(),
            cost: None,
        });
        let (cost, theta) = interference(above.re, medium.index, depth);
        left_out.push(LeftOut {
            what: format!("interference next to the boundary within layer {number}"),
            why: format!(
                "in an absorbing layer the reflected and transmitted light at the boundary sum to slightly more than 1; \
                 the cost is the light that this returns to the medium above at the worst angle, θ = {:.1}° there",
                theta.to_degrees()
            ),
            cost: Some(cost),
        });
        Ok(depth)
    }
}

/// Largest fraction of the light above an absorbing layer that [`excess`] would add after two
/// passes through the layer, with total reflection below, and the angle (rad) above the layer at
/// which it occurs.
fn interference(above: f64, layer: Complex<f64>, depth: f64) -> (f64, f64) {
    const ANGLES: u32 = 2000;
    // It is largest close to the critical angle.
    let critical = (layer.re / above).min(1.0).asin();
    let evenly = (0..ANGLES).map(|j| f64::from(j) / f64::from(ANGLES) * FRAC_PI_2);
    let boundary = Boundary::between(Complex::new(above, 0.0), layer, true);
    let at = |theta: f64| {
        let cos_below = boundary.at(theta.cos()).cos_refracted;
        excess(above, layer, theta.cos()) * (-2.0 * depth * slant(layer, cos_below)).exp()
    };
    evenly
        .chain([critical * (1.0 - f64::EPSILON)])
        .map(|theta| (at(theta), theta))
        .fold(
            (0.0, 0.0),
            |most, here| if here.0 > most.0 { here } else { most },
        )
}

/// Range of plausible indices; powers of others would overflow.
const INDEX_RANGE: std::ops::RangeInclusive<f64> = 1e-30..=1e30;

/// Refuses values that are not an index of a medium.
pub(super) fn index(key: &str, x: f64) -> Result<(), SceneError> {
    positive(key, x)?;
    if INDEX_RANGE.contains(&x) {
        Ok(())
    } else {
        Err(value(key, x, "must be from 1e-30 to 1e30"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_term_omitted_in_an_absorbing_layer_is_small_if_it_is_thicker_than_a_wavelength() {
        let cost = |above: f64, layer: Complex<f64>, thickness_um: f64| {
            let depth = 4e3 * std::f64::consts::PI * layer.im * thickness_um / 550.0;
            interference(above, layer, depth).0
        };
        // Attenuated total reflection, stained glass, and a wavelength of ink.
        assert!(cost(1.5, Complex::new(1.3, 0.013), 5.0) < 3e-5);
        assert!(cost(1.0, Complex::new(1.5, 1e-3), 10.0) < 1e-6);
        let ink = cost(1.0, Complex::new(1.5, 0.1), 0.5);
        assert!((1e-5..1e-3).contains(&ink), "{ink}");
        assert!(cost(1.0, Complex::new(1.0, 0.01), 5.0) < 3e-2);
    }
}
