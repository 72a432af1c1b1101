//! The inner loop of every fit: one parameter set, many poses, the value and all first derivatives.
//!
//! [`OpticsTable`] contains the values that depend on the index only (computed once per fit unless the index is
//! free), [`Prepared`] those that depend on the parameters (once per trial); [`Prepared::partials`] evaluates one
//! pose, [`Prepared::over_views`] the mean over many directions, several at once. The forms are those of [`super::form`].
//!
//! *Conditioning.* The value has the forms of [`super::sawtooth`] and their digits. Derivatives are logarithmic ones
//! times the value, so they vanish with it and never divide by it. ∂/∂α² of a lobe loses no digits at the lobe's peak
//! and grows as (x/α)² beside it, which is its true size. A retro lobe beyond e⁻¹⁰⁰ of its peak is omitted: below
//! 1e-43 of the peak the inner loop returns 0, unlike the reference form.

use std::f64::consts::PI;

use nalgebra::Vector3;

use crate::geometry::{Directions, Pose, RigGeometry};

use super::dual::Dual;
use super::form::{self, Fixed, Half, NUMBERS, Shape};
use super::fresnel::Slopes;
use super::number::Number as _;
use super::real::Real;
use super::register::Register;
use super::sawtooth::{RETRO_TILT_MAX, RETRO_TILT_MIN, diffuse_transmittance};
use super::{Gradient, Optics, Surface, Variant};

/// A radiance with its derivatives with respect to the parameters and to the components of both directions.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Partials {
    /// The radiance.
    pub value: f64,
    /// ∂/∂θr, per radian.
    pub theta_r: f64,
    /// ∂/∂αu.
    pub alpha_u: f64,
    /// ∂/∂αv.
    pub alpha_v: f64,
    /// ∂/∂ρd.
    pub rho_d: f64,
    /// With respect to the deviations of [`super::extended`]; 0 in the other forms.
    pub real: Real,
    /// ∂/∂A.
    pub amplitude: f64,
    /// ∂/∂n.
    pub eta: f64,
    /// ∂/∂k.
    pub k: f64,
    /// ∂/∂ω_i along u, v, n, each component independent.
    pub incident: [f64; 3],
    /// ∂/∂ω_o along u, v, n.
    pub outgoing: [f64; 3],
}

impl Partials {
    /// Converts the derivatives with respect to the directions to those with respect to the two stage angles and the wedge,
    /// for `directions` of a rig at a pose whose azimuth of v has this `sin` and `cos`.
    #[must_use]
    pub fn on_rig(&self, directions: &Directions, sin: f64, cos: f64) -> Gradient {
        let mut theta_c = 0.0;
        let mut phi_s = 0.0;
        let mut wedge = 0.0;
        for (w, g) in [
            (directions.incident, self.incident),
            (directions.outgoing, self.outgoing),
        ] {
            // Tilting turns a rig direction (x, y, z) about +y at the rate (z, 0, −x); turning the
            // sample turns (u, v) at the rate (v, −u); tilting the sample about v turns (u, n) at the rate (n, −u).
            theta_c += w.z * (g[0] * sin + g[1] * cos) - (w.x * sin + w.y * cos) * g[2];
            phi_s += w.y * g[0] - w.x * g[1];
            wedge += w.z * g[0] - w.x * g[2];
        }
        Gradient {
            value: self.value,
            theta_r: self.theta_r,
            alpha_u: self.alpha_u,
            alpha_v: self.alpha_v,
            rho_d: self.rho_d,
            real: self.real,
            amplitude: self.amplitude,
            eta: self.eta,
            k: self.k,
            theta_c,
            phi_s,
            wedge,
            lamp_turn: 0.0,
        }
    }
}

/// The values that depend only on the index and on the angle between lamp and camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OpticsTable {
    /// The optics of the table.
    pub optics: Optics,
    /// 1/(π T(1) T(cos θl)) with ∂/∂n, ∂/∂k.
    pub(super) diffuse: [f64; 3],
    /// π T̄² with ∂/∂n, ∂/∂k.
    pub(super) exchange: [f64; 3],
    /// What the forms take from both.
    fixed: Fixed,
    /// cos(θl/2) and the reflectance there, which applies to every single reflection of a far rig.
    half: (f64, Slopes),
}

impl OpticsTable {
    /// Computes the table, including the integral T̄ (a few microseconds).
    #[must_use]
    pub fn new(optics: &Optics) -> Self {
        let t = |cos: f64| {
            let f = super::fresnel::Reflectances::at(cos, optics.eta, optics.k).unpolarised();
            Dual {
                value: 1.0 - f.value,
                partials: [-f.eta, -f.k],
            }
        };
        let one = Dual {
            value: 1.0,
            partials: [0.0; 2],
        };
        let enters = t(1.0) * t(optics.theta_l.cos());
        // If no light enters (total reflection, a perfect mirror), none leaves; `domain` refuses ρd > 0 there.
        let diffuse = if enters.value > f64::MIN_POSITIVE {
            one / enters.times(PI)
        } else {
            Dual {
                value: 0.0,
                partials: [0.0; 2],
            }
        };
        let t_bar = diffuse_transmittance(optics.eta, optics.k);
        let exchange = (t_bar * t_bar).times(PI);
        let parts = |x: Dual<2>| [x.value, x.partials[0], x.partials[1]];
        let (diffuse, exchange) = (parts(diffuse), parts(exchange));
        let kappa_index = [1, 2].map(|n| diffuse[n] * exchange[0] + diffuse[0] * exchange[n]);
        let fixed = Fixed {
            eta: optics.eta,
            k: optics.k,
            diffuse: diffuse[0],
            kappa: diffuse[0] * exchange[0],
            diffuse_index: [diffuse[1], diffuse[2]],
            kappa_index,
            cones: 0.5 * optics.cones.widening(),
            per_tan: [RETRO_TILT_MIN, RETRO_TILT_MAX].map(|tilt| 1.0 / tilt.tan()),
        };
        let cos_half = (0.5 * optics.theta_l).cos();
        OpticsTable {
            optics: *optics,
            diffuse,
            exchange,
            fixed,
            half: (cos_half, cos_half.reflectance(optics.eta, optics.k)),
        }
    }

    /// Returns what the forms need besides the surface.
    #[must_use]
    pub(crate) fn fixed(&self) -> &Fixed {
        &self.fixed
    }

    /// Returns the half vector's length for two directions. Most are those of a far rig, which share its reflectance.
    #[inline]
    fn half(&self, i: &[f64; 3], o: &[f64; 3]) -> Half<f64> {
        let h = [i[0] + o[0], i[1] + o[1], i[2] + o[2]];
        let h2 = h[0] * h[0] + h[1] * h[1] + h[2] * h[2];
        // Within the rounding of the cosine the stored value is as exact.
        let cos = 0.5 * h2.sqrt();
        let f = if (cos - self.half.0).abs() <= 4.0 * f64::EPSILON {
            self.half.1
        } else {
            cos.reflectance(self.optics.eta, self.optics.k)
        };
        Half {
            h2,
            f,
            varies: true,
        }
    }
}

/// One parameter set, prepared for many poses.
#[derive(Debug, Clone, Copy)]
pub struct Prepared {
    variant: Variant,
    /// Whether θr was negative: then the same surface turned by 180° is computed.
    turned: bool,
    table: OpticsTable,
    surface: Surface,
    opaque: bool,
    numbers: [f64; NUMBERS],
}

impl Prepared {
    /// Computes everything that does not depend on the pose. A negative θr equals the positive one at φs + 180°.
    #[must_use]
    pub fn new(variant: Variant, surface: &Surface, table: &OpticsTable) -> Self {
        let turned = surface.theta_r < 0.0;
        let surface = &Surface {
            theta_r: surface.theta_r.abs(),
            ..*surface
        };
        Prepared {
            variant,
            turned,
            table: *table,
            surface: *surface,
            opaque: false,
            numbers: numbers(surface, table),
        }
    }

    /// Returns the numbers of [`Shape::of`].
    #[must_use]
    pub(crate) fn numbers(&self) -> &[f64; NUMBERS] {
        &self.numbers
    }

    /// Omits the diffuse terms and ∂/∂ρd for a surface whose ρd is 0 and stays 0, which saves half the time on metal.
    #[must_use]
    pub fn opaque(self) -> Self {
        Prepared {
            opaque: self.surface.rho_d == 0.0,
            ..self
        }
    }

    /// Returns the optics of the table.
    #[must_use]
    pub fn optics(&self) -> &Optics {
        &self.table.optics
    }

    /// Returns the radiance and all partial derivatives for one pair of directions.
    #[must_use]
    pub fn partials(&self, directions: &Directions) -> Partials {
        let sign = if self.turned { -1.0 } else { 1.0 };
        let turn = |w: &Vector3<f64>| [sign * w.x, sign * w.y, w.z];
        let (i, o) = (turn(&directions.incident), turn(&directions.outgoing));
        if i[2] <= 0.0 || o[2] <= 0.0 {
            return Partials::default();
        }
        let half = self.table.half(&i, &o);
        let shape = Shape::of(&self.numbers, self.surface.amplitude);
        let (body, fixed) = (self.has_body(), &self.table.fixed);
        let d = form::radiance(self.variant, body, fixed, &shape, &half, &i, &o);
        let mut out = Partials {
            value: d.value,
            theta_r: d.theta_r,
            alpha_u: d.ln_alpha_u / self.surface.alpha_u,
            alpha_v: d.ln_alpha_v / self.surface.alpha_v,
            rho_d: d.rho_d,
            real: Real::NONE,
            amplitude: d.amplitude,
            eta: d.eta,
            k: d.k,
            incident: d.incident,
            outgoing: d.outgoing,
        };
        if self.turned {
            out.theta_r = -out.theta_r;
            for g in [&mut out.incident, &mut out.outgoing] {
                g[0] = -g[0];
                g[1] = -g[1];
            }
        }
        out
    }

    /// Whether the diffuse terms are evaluated.
    pub(super) fn has_body(&self) -> bool {
        !self.opaque
    }
    pub(super) fn variant(&self) -> Variant {
        self.variant
    }

    pub(super) fn surface(&self) -> &Surface {
        &self.surface
    }

    pub(super) fn table(&self) -> &OpticsTable {
        &self.table
    }

    /// Whether θr was negative.
    pub(super) fn is_turned(&self) -> bool {
        self.turned
    }

    /// As [`Self::partials`] at a true pose of a rig, with the derivatives with respect to the stage angles.
    #[must_use]
    pub fn gradient(&self, rig: &RigGeometry, pose: Pose) -> Gradient {
        let (sin, cos) = (pose.phi_s + rig.azimuth_zero).sin_cos();
        let directions = rig.directions(pose);
        self.partials(&directions).on_rig(&directions, sin, cos)
    }
}

/// Returns the numbers of a surface with θr ≥ 0, as [`Shape::of`] takes them.
fn numbers(surface: &Surface, table: &OpticsTable) -> [f64; NUMBERS] {
    let (sin, cos) = surface.theta_r.sin_cos();
    let cones = table.fixed.cones;
    let (au2, av2) = (surface.alpha_u.powi(2), surface.alpha_v.powi(2));
    let (a, b) = (au2 + 2.0 * cones, av2 + 2.0 * cones);
    let per_v_v = 1.0 / (av2 + cones);
    let [c1, c2, c3] = exchange_coefficients(sin, cos, surface.rho_d * table.fixed.kappa);
    [
        sin,
        cos,
        1.0 / a,
        1.0 / b,
        1.0 / (PI * (a * b).sqrt()),
        au2 / a,
        av2 / b,
        au2,
        per_v_v,
        per_v_v.sqrt(),
        av2 * per_v_v,
        1.0 / surface.alpha_v,
        surface.rho_d,
        surface.rho_d * table.fixed.diffuse,
        c1.value,
        c2.value,
        c3.value,
        c1.partials[0],
        c2.partials[0],
        c3.partials[0],
        c1.partials[1],
        c2.partials[1],
        c3.partials[1],
    ]
}

/// Returns the coefficients of the exchange term c_d [C₁ E_f(o) E_f(i) + C₂ (E_f(o) E_r(i) + E_r(o) E_f(i)) + C₃
/// E_r(o) E_r(i)], with derivatives with respect to θr and κ.
///
/// C₁ = (1/d − 1)/p, C₂ = κ g/(2 p r d), C₃ = (1/d − 1)/r, g = p + r − 1, d = 1 − κ² g²/(4 p r): the view factors
/// p φ_fr = r φ_rf = g/2 inserted into the two-wall radiosity.
///
/// g cancels at both ends of θr (to a last bit over p or r). With g = 2 p r/(1 + p + r), since (p + r)² − 1 = 2 p r,
/// the coefficients are C₁ = q² r/d, C₂ = q/d, C₃ = q² p/d with q = κ/(1 + p + r), d = 1 − q² p r: sums and products
/// of positive numbers except for d, which stays above 1 − 0.086 κ².
fn exchange_coefficients(sin: f64, cos: f64, kappa: f64) -> [Dual<2>; 3] {
    let constant = |value: f64| Dual {
        value,
        partials: [0.0; 2],
    };
    if sin <= 0.0 {
        return [constant(0.0); 3];
    }
    let p = Dual {
        value: cos,
        partials: [-sin, 0.0],
    };
    let r = Dual {
        value: sin,
        partials: [cos, 0.0],
    };
    let k = Dual {
        value: kappa,
        partials: [0.0, 1.0],
    };
    let per_walls = k / (p + r + constant(1.0));
    let square = per_walls * per_walls;
    let d = constant(1.0) - square * p * r;
    [square * r / d, per_walls / d, square * p / d]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::units::Angle;

    /// Random rigs, poses and surfaces: a stream of numbers in [0, 1) from a fixed seed.
    struct Stream(u64);

    impl Stream {
        fn next(&mut self) -> f64 {
            self.0 = self
                .0
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (self.0 >> 11) as f64 / (1u64 << 53) as f64
        }
        fn between(&mut self, low: f64, high: f64) -> f64 {
            low + (high - low) * self.next()
        }
    }

    struct Draw {
        rig: RigGeometry,
        pose: Pose,
        surface: Surface,
        optics: Optics,
    }

    fn draw(s: &mut Stream) -> Draw {
        let rig = RigGeometry {
            theta_l: Angle::from_deg(s.between(0.0, 40.0)),
            light_azimuth: Angle::from_deg(s.between(-180.0, 180.0)),
            azimuth_zero: Angle::from_deg(s.between(-180.0, 180.0)),
            cones: crate::geometry::Cones::of_lamp(Angle::from_deg(s.between(0.0, 2.0))),
        };
        let metal = s.next() < 0.4;
        let (eta, k) = if metal {
            (s.between(0.1, 4.0), s.between(0.5, 8.0))
        } else {
            (s.between(1.2, 2.5), 0.0)
        };
        let rho_d = if s.next() < 0.2 {
            0.0
        } else {
            s.between(0.01, 0.9)
        };
        Draw {
            rig,
            pose: Pose::from_deg(s.between(-60.0, 60.0), s.between(-180.0, 180.0)),
            surface: Surface {
                theta_r: s.between(0.002, 0.7),
                alpha_u: 10f64.powf(s.between(-1.5, 0.0)),
                alpha_v: 10f64.powf(s.between(-1.5, 0.0)),
                rho_d,
                amplitude: s.between(0.3, 1.5),
            },
            optics: Optics {
                eta,
                k,
                theta_l: rig.theta_l.rad(),
                cones: rig.cones,
            },
        }
    }

    fn list(g: &Gradient) -> [f64; 10] {
        [
            g.value,
            g.theta_r,
            g.alpha_u,
            g.alpha_v,
            g.rho_d,
            g.amplitude,
            g.eta,
            g.k,
            g.theta_c,
            g.phi_s,
        ]
    }

    #[test]
    fn slopes_by_the_stage_angles_and_the_wedge_follow_from_those_by_the_directions() {
        let mut s = Stream(7);
        for _ in 0..1000 {
            let Draw { rig, pose, .. } = draw(&mut s);
            // A radiance that is linear in the directions has the same slopes everywhere.
            let [by_incident, by_outgoing]: [Vector3<f64>; 2] =
                std::array::from_fn(|_| Vector3::from_fn(|_, _| s.between(-1.0, 1.0)));
            let linear = Partials {
                incident: by_incident.into(),
                outgoing: by_outgoing.into(),
                ..Partials::default()
            };
            let at = |theta_c: f64, phi_s: f64, wedge: f64| {
                let directions = rig.directions(Pose {
                    theta_c: pose.theta_c + Angle::from_rad(theta_c),
                    phi_s: pose.phi_s + Angle::from_rad(phi_s),
                });
                let (sin, cos) = wedge.sin_cos();
                let tilt = |w: Vector3<f64>| {
                    Vector3::new(w.x * cos + w.z * sin, w.y, w.z * cos - w.x * sin)
                };
                by_incident.dot(&tilt(directions.incident))
                    + by_outgoing.dot(&tilt(directions.outgoing))
            };
            let (sin, cos) = (pose.phi_s + rig.azimuth_zero).sin_cos();
            let found = linear.on_rig(&rig.directions(pose), sin, cos);
            let h = 1e-5;
            for (slope, found) in [
                (at(h, 0.0, 0.0) - at(-h, 0.0, 0.0), found.theta_c),
                (at(0.0, h, 0.0) - at(0.0, -h, 0.0), found.phi_s),
                (at(0.0, 0.0, h) - at(0.0, 0.0, -h), found.wedge),
            ] {
                // h² times a third derivative of at most 4, plus rounding of 1e-15/h.
                assert!((slope / (2.0 * h) - found).abs() < 1e-9, "{slope} {found}");
            }
        }
    }

    #[test]
    fn an_opaque_surface_lacks_only_the_diffuse_slope() {
        let mut s = Stream(11);
        for _ in 0..500 {
            let mut d = draw(&mut s);
            d.surface.rho_d = 0.0;
            let full = Prepared::new(Variant::Sawtooth, &d.surface, &OpticsTable::new(&d.optics));
            let a = full.gradient(&d.rig, d.pose);
            let b = full.opaque().gradient(&d.rig, d.pose);
            for (j, (x, y)) in list(&a).into_iter().zip(list(&b)).enumerate() {
                assert!(
                    j == 4 || (x - y).abs() <= 1e-13 * (x.abs() + a.value),
                    "{j} {x} {y}"
                );
            }
        }
    }
}
