//! The media of a scene: what each boundary reflects with and what each layer takes.

use std::f64::consts::FRAC_PI_2;

use nalgebra::Complex;

use super::error::{positive, value};
use super::{LeftOut, Scene, SceneError, Shape};
use crate::material::tables;
use crate::model::fresnel;
use crate::model::polarisation::Boundary;

/// What the media of a scene do to its light.
pub(super) struct Optics {
    /// Above and below each interface, top first: n above, n and k below, optical depth of the layer below, and
    /// what comes back from a diffuse body.
    pub(super) media: Vec<(f64, Complex<f64>, f64, Option<f64>)>,
    pub(super) left_out: Vec<LeftOut>,
}

struct Medium {
    index: Complex<f64>,
    rho_d: Option<f64>,
}

impl Scene {
    /// The media of all interfaces, from above.
    pub(super) fn optics(&self) -> Result<Optics, SceneError> {
        let mut optics = Optics {
            media: Vec::new(),
            left_out: Vec::new(),
        };
        let mut above = self.n_top;
        for (i, shape) in self.interface.iter().enumerate() {
            let number = i + 1;
            let last = number == self.interface.len();
            let medium = self.medium(shape, number, above)?;
            if medium.rho_d.is_some() && !last {
                return Err(SceneError::Unreachable { number });
            }
            let left_out = &mut optics.left_out;
            let (depth, k) = self.layer(shape, number, above, &medium, last, left_out)?;
            let below = Complex::new(medium.index.re, k);
            optics.media.push((above, below, depth, medium.rho_d));
            above = below.re;
        }
        Ok(optics)
    }

    fn medium(&self, shape: &Shape, number: usize, above: f64) -> Result<Medium, SceneError> {
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
                        "unknown key; known are n, k, rho_d",
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
                    return Err(value(&key("k"), k, "must lie from 0 to 1e30"));
                }
                let rho_d = number_of("rho_d")?;
                if let Some(rho) = rho_d {
                    let t = fresnel::transmittance(1.0, n / above, 0.0);
                    if k > 0.0 || !(rho >= 0.0 && rho <= t * t) {
                        return Err(value(
                            &key("rho_d"),
                            rho,
                            "needs k = 0 and must be from 0 to what the boundary lets through",
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
                "write { n = 1.5 }, { n = 0.35, k = 2.7 } or a material's name",
            )),
        }
    }

    /// Optical depth of the layer below, and the k that its boundary reflects with.
    fn layer(
        &self,
        shape: &Shape,
        number: usize,
        above: f64,
        medium: &Medium,
        last: bool,
        left_out: &mut Vec<LeftOut>,
    ) -> Result<(f64, f64), SceneError> {
        if let Some(thickness) = shape.thickness_um {
            positive(&format!("interface {number}: thickness_um"), thickness)?;
        }
        let k = medium.index.im;
        if last && shape.thickness_um.is_some() {
            left_out.push(LeftOut {
                what: format!("thickness_um of interface {number}"),
                why: "what lies below the last interface has no other side: light that enters it does not come back"
                    .to_owned(),
                cost: None,
            });
        }
        if last || k == 0.0 {
            return Ok((0.0, k));
        }
        // Beyond this the layer is opaque within a wavelength: not a layer but a substrate.
        if k > 0.1 * medium.index.re {
            return Err(SceneError::Unreachable { number });
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
        let (cost, theta) = without_k(above, medium.index);
        left_out.push(LeftOut {
            what: format!("the absorption of layer {number} in its Fresnel amplitudes"),
            why: format!(
                "a layer that light crosses has k much smaller than n; the cost is the change of its boundary's \
                 reflectance at the worst angle, θ = {:.1}° from above",
                theta.to_degrees()
            ),
            cost: Some(cost),
        });
        Ok((depth, 0.0))
    }
}

/// The greatest change of a boundary's unpolarised reflectance where the k beyond it is left out, and the angle (rad) of
/// that. Near total reflection and where both n are alike it is of first order in k.
fn without_k(above: f64, below: Complex<f64>) -> (f64, f64) {
    const ANGLES: u32 = 2000;
    let (with, without) = (
        Boundary::new(above, below.re, below.im),
        Boundary::new(above, below.re, 0.0),
    );
    // The critical angle, next to which the change is greatest, is one of them.
    let critical = (below.re / above).min(1.0).asin();
    let evenly = (0..ANGLES).map(|j| f64::from(j) / f64::from(ANGLES) * FRAC_PI_2);
    let at = |theta: f64| {
        let share = |b: &Boundary| b.at(theta.cos()).reflected.unpolarised();
        (share(&with) - share(&without)).abs()
    };
    evenly
        .chain([critical * (1.0 - f64::EPSILON)])
        .map(|theta| (at(theta), theta))
        .fold(
            (0.0, 0.0),
            |most, here| if here.0 > most.0 { here } else { most },
        )
}

/// Indices beyond any medium's, whose powers numbers do not hold.
const INDEX_RANGE: std::ops::RangeInclusive<f64> = 1e-30..=1e30;

/// Refuses what no medium's index is.
pub(super) fn index(key: &str, x: f64) -> Result<(), SceneError> {
    positive(key, x)?;
    if INDEX_RANGE.contains(&x) {
        Ok(())
    } else {
        Err(value(key, x, "a refractive index lies from 1e-30 to 1e30"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_layers_k_costs_most_where_light_is_totally_reflected_without_it() {
        // Attenuated total reflection: of the light at 61° two fifths go into the layer.
        let (cost, theta) = without_k(1.5, Complex::new(1.3, 0.013));
        assert!(
            cost > 0.4 && (theta.to_degrees() - 60.5).abs() < 1.0,
            "{cost} {theta}"
        );
        let (cost, _) = without_k(1.0, Complex::new(1.0, 0.01));
        assert!(cost > 0.7, "{cost}");
        let (cost, _) = without_k(1.0, Complex::new(1.5, 1e-4));
        assert!(cost < 1e-6, "{cost}");
    }
}
