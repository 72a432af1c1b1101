//! The radiance of one observation with its exact derivatives, for a register of pixels at once.
//!
//! The kernel computes the light that the facets reflect once, which is term (a) of the `sawtooth` closed form
//! without the riser's share, times an amplitude, plus ρd times a given number B. All costlier terms (riser, mirror
//! hops, exchange, retro lobe) enter the fit through B and as an offset on the signal; see `costly`.
//!
//! With the facets' normal m = cos θ n + sin θ v, e = cos θ v − sin θ n, the half vector h = i + o
//! and the larger of the two slopes t = max(0, i_e/i_m, o_e/o_m):
//!
//! ```text
//! L = F |h|⁴/(4π o_n) · G · exp(−q) / (h_m⁴ √(ab)),   G = cos θ − sin θ t
//! x = h_u/h_m, y = h_e/h_m, q = x²/a + y²/b, a = αu² + R²/8, b = αv² + R²/8
//! ∂ ln D/∂θ = 2y (q + 1/b − 2)          ∂G/∂θ = −t G (−sin θ where t = 0)
//! ∂ ln D/∂ψ = 2x (2 sin θ − (h_v/h_m + x² sin θ)/a + y (h_n/h_m)/b)
//! ∂G/∂ψ = sin θ ω_u ω_n/ω_m² of the direction that t belongs to
//! ∂ ln D/∂ ln αu = (2x²/a − 1) αu²/a    (αv in the same way)
//! ```
//!
//! ψ turns v about n: ∂v/∂ψ = −u, ∂u/∂ψ = v (u = v × n).
//!
//! *Conditioning.* Squares, products and one exponential. h_m and the denominator of t are held above 1e-3: below
//! that the facet is edge on and G or the lobe is 0 (q beyond 60 counts as 60, e⁻⁶⁰ = 1e-26 of the peak), so no lane
//! divides by 0 or makes a NaN that would have to be masked. Each lane subtracts o = h − i in place of loading o.
//! This costs o_n an error of 1e-16, which affects t only; the 1/o_n of L is in the scale, from the pose. With α from
//! 1e-3 to 1 and θr to 75° (the bounds of a descent) all lanes stay finite at any pose above the horizon.

use nalgebra::Vector3;
use pulp::Simd;

pub(in crate::map) use crate::fit::least_squares::lane_steps::packed;
use crate::geometry::Directions;
use crate::model::lanes::Lane;

/// Numbers that describe one observation's geometry; see [`Geometry`].
pub(in crate::map) const GEOMETRY: usize = 7;

/// Product of a facet's cosines to lamp and camera below which the facet counts as edge on.
const EDGE_ON: f64 = 0.01;

/// One observation's directions in the sample's frame (x, y, n) at ψ = 0, and its scale.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::map) struct Geometry(pub(in crate::map) [f64; GEOMETRY]);

impl Geometry {
    /// Takes lamp and camera directions (unit vectors away from the surface; the third component along n), and the
    /// Fresnel reflectance at their half angle.
    pub(in crate::map) fn new(i: [f64; 3], o: [f64; 3], fresnel: f64) -> Self {
        let h = [i[0] + o[0], i[1] + o[1], i[2] + o[2]];
        let h2 = h[0] * h[0] + h[1] * h[1] + h[2] * h[2];
        let above = i[2] > 0.0 && o[2] > 0.0;
        let scale = if above {
            fresnel * h2 * h2 / (4.0 * std::f64::consts::PI * o[2])
        } else {
            0.0
        };
        Geometry([i[0], i[1], i[2], h[0], h[1], h[2], scale])
    }

    pub(in crate::map) fn incident(&self) -> [f64; 3] {
        [self.0[0], self.0[1], self.0[2]]
    }

    /// Direction to the camera.
    pub(in crate::map) fn outgoing(&self) -> [f64; 3] {
        std::array::from_fn(|axis| self.0[3 + axis] - self.0[axis])
    }

    /// Returns the factor of the facets' diffuse light, i_m o_m / o_n: the irradiance of a facet times its projected
    /// area per area that the camera images; 0 if it faces away from lamp or camera. Fresnel transmittances are
    /// omitted.
    pub(in crate::map) fn facing(&self, p: &Parameters) -> f64 {
        let (s, c) = p[0].sin_cos();
        let Directions { incident, outgoing } = self.directions(p[1]);
        let towards = |w: Vector3<f64>| (c * w.z + s * w.y).max(0.0);
        if incident.z > 0.0 && outgoing.z > 0.0 {
            towards(incident) * towards(outgoing) / outgoing.z
        } else {
            0.0
        }
    }

    /// Returns the directions along (u, v, n) of ridges that lean to ψ.
    pub(in crate::map) fn directions(&self, psi: f64) -> Directions {
        let (s, c) = psi.sin_cos();
        let turned = |w: [f64; 3]| Vector3::new(w[0] * s - w[1] * c, w[0] * c + w[1] * s, w[2]);
        Directions {
            incident: turned(self.incident()),
            outgoing: turned(self.outgoing()),
        }
    }

    /// Returns the ratio of the diffuse light here to that at the field's centre.
    pub(in crate::map) fn facing_beside(&self, centre: &Geometry, p: &Parameters) -> f64 {
        let there = centre.facing(p);
        // A facet that is edge on at the centre gives no information on its light elsewhere.
        if there > EDGE_ON {
            self.facing(p) / there
        } else {
            1.0
        }
    }
}

/// The pixels' parameters in the form that the kernel uses.
#[derive(Clone, Copy)]
pub(in crate::map) struct Shape<S: Simd> {
    pub(in crate::map) sin_theta: Lane<S>,
    pub(in crate::map) cos_theta: Lane<S>,
    pub(in crate::map) sin_psi: Lane<S>,
    pub(in crate::map) cos_psi: Lane<S>,
    /// 1/a and 1/b.
    pub(in crate::map) inv_a: Lane<S>,
    pub(in crate::map) inv_b: Lane<S>,
    /// 1/√(ab)
    pub(in crate::map) norm: Lane<S>,
}

/// A single reflection of amplitude 1 with its derivatives, times a weight. `alpha_u` and `alpha_v` still lack the
/// factors αu²/a and αv²/b.
#[derive(Clone, Copy)]
pub(in crate::map) struct Row<S: Simd> {
    pub(in crate::map) value: Lane<S>,
    pub(in crate::map) theta: Lane<S>,
    pub(in crate::map) psi: Lane<S>,
    pub(in crate::map) alpha_u: Lane<S>,
    pub(in crate::map) alpha_v: Lane<S>,
}

/// Evaluates one observation for all lanes.
#[inline(always)]
pub(in crate::map) fn row<S: Simd>(
    simd: S,
    at: &[Lane<S>; GEOMETRY],
    shape: &Shape<S>,
    weight: Lane<S>,
) -> Row<S> {
    macro_rules! k {
        ($x:expr) => {
            Lane::splat(simd, $x)
        };
    }
    let [ix, iy, i_n, hx, hy, hn, scale] = *at;
    let (s, c) = (shape.sin_theta, shape.cos_theta);
    let (sp, cp) = (shape.sin_psi, shape.cos_psi);
    let zero = k!(0.0);

    let (iv, iu) = (ix.mul_add(cp, iy * sp), ix.mul_add(sp, -(iy * cp)));
    let (hv, hu) = (hx.mul_add(cp, hy * sp), hx.mul_add(sp, -(hy * cp)));
    let (im, ie) = (c.mul_add(i_n, s * iv), c.mul_add(iv, -(s * i_n)));
    let (hm, he) = (c.mul_add(hn, s * hv), c.mul_add(hv, -(s * hn)));
    let (om, oe, ou, on) = (hm - im, he - ie, hu - iu, hn - i_n);
    let tiny = k!(1e-3);
    let faces = zero.less(im).and(zero.less(om));

    // The direction closer to the facet's own plane hides more.
    let incident_hides = (oe * im).less(ie * om);
    let num = incident_hides.select(ie, oe);
    let den = incident_hides.select(im, om).max(tiny);
    let across = incident_hides.select(iu, ou) * incident_hides.select(i_n, on);
    let hm = hm.max(tiny);
    let inv = k!(1.0) / (den * hm);
    let (inv_den, inv_hm) = (inv * hm, inv * den);
    let slope = num * inv_den;
    let hides = zero.less(slope);
    let t = slope.max(zero);
    let g = c - s * t;
    let seen = faces.and(zero.less(g));
    let g_theta = hides.select(-(t * g), -s);
    let g_psi = hides.select(s * across * inv_den * inv_den, zero);

    let x = hu * inv_hm;
    let y = he * inv_hm;
    let (qx, qy) = (x * x * shape.inv_a, y * y * shape.inv_b);
    let q = qx + qy;
    let inv2 = inv_hm * inv_hm;
    // The exponential is computed last, so that all other factors are ready.
    let factor = inv2 * inv2 * (shape.norm * scale * weight);
    let base = seen.select(q.exp_neg() * factor, zero);
    let value = base * g;
    let two = k!(2.0);
    let ln_theta = two * y * (q + shape.inv_b - two);
    let bend = (x * x).mul_add(s, hv * inv_hm);
    let ln_psi = two * x * (two * s - bend * shape.inv_a + y * hn * inv_hm * shape.inv_b);
    Row {
        value,
        theta: base * g.mul_add(ln_theta, g_theta),
        psi: base * g.mul_add(ln_psi, g_psi),
        alpha_u: value * two.mul_add(qx, k!(-1.0)),
        alpha_v: value * two.mul_add(qy, k!(-1.0)),
    }
}

/// Free parameters per pixel.
pub(in crate::map) const FREE: usize = 5;
/// Numbers in a packed symmetric matrix of [`FREE`] rows.
pub(in crate::map) const PACKED: usize = FREE * (FREE + 1) / 2;

/// One pixel's parameters in the order of the fit: θr and ψ in radians, ln αu, ln αv, and either ρd (dielectrics) or
/// the amplitude (conductors).
pub(in crate::map) type Parameters = [f64; FREE];

/// Returns a − b, with the difference of ψ within half a turn.
pub(in crate::map) fn difference(a: &Parameters, b: &Parameters) -> Parameters {
    let mut apart: Parameters = std::array::from_fn(|k| a[k] - b[k]);
    let turn = std::f64::consts::TAU;
    apart[1] -= turn * (apart[1] / turn).round();
    apart
}

/// Returns term (a) of one observation for one pixel: its value and its derivatives with respect to θr, ψ, ln αu, ln
/// αv. `lamp` is R²/8.
pub(in crate::map) fn single(geometry: &Geometry, p: &Parameters, lamp: f64) -> (f64, [f64; 4]) {
    let simd = pulp::Scalar::new();
    let k = |x: f64| Lane::splat(simd, x);
    let (au2, av2) = ((2.0 * p[2]).exp(), (2.0 * p[3]).exp());
    let (inv_a, inv_b) = (1.0 / (au2 + lamp), 1.0 / (av2 + lamp));
    let shape = Shape {
        sin_theta: k(p[0].sin()),
        cos_theta: k(p[0].cos()),
        sin_psi: k(p[1].sin()),
        cos_psi: k(p[1].cos()),
        inv_a: k(inv_a),
        inv_b: k(inv_b),
        norm: k((inv_a * inv_b).sqrt()),
    };
    let r = row(simd, &geometry.0.map(k), &shape, k(1.0));
    (
        r.value.1,
        [
            r.theta.1,
            r.psi.1,
            r.alpha_u.1 * au2 * inv_a,
            r.alpha_v.1 * av2 * inv_b,
        ],
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Pose, RigGeometry};
    use crate::material::Material;
    use crate::model::{Optics, Surface, Variant, fresnel, radiance};
    use crate::units::Angle;

    fn cases() -> Vec<(RigGeometry, Pose, Parameters)> {
        let mut cases = Vec::new();
        for (n, &theta_r_deg) in [1.0, 5.0, 10.0, 22.0, 40.0].iter().enumerate() {
            for theta_c_deg in [-35.0, -20.0, -5.0, 3.0, 20.0] {
                for step in 0..12 {
                    let rig = RigGeometry {
                        light_azimuth: Angle::from_deg(if n % 2 == 0 { 0.0 } else { 90.0 }),
                        ..RigGeometry::IN_PLANE
                    };
                    let pose = Pose::from_deg(theta_c_deg, 30.0 * f64::from(step));
                    let p = [
                        f64::to_radians(theta_r_deg),
                        0.3 + 0.9 * n as f64,
                        (0.15_f64 + 0.02 * n as f64).ln(),
                        0.2_f64.ln(),
                        0.0,
                    ];
                    cases.push((rig, pose, p));
                }
            }
        }
        cases
    }

    fn geometry(rig: &RigGeometry, pose: Pose) -> Geometry {
        let rig_at_zero = RigGeometry {
            azimuth_zero: Angle::ZERO,
            ..*rig
        };
        let d = rig_at_zero.rig_directions(pose.theta_c);
        let (s, c) = pose.phi_s.sin_cos();
        let turned = |w: Vector3<f64>| [w.x * c + w.y * s, w.y * c - w.x * s, w.z];
        let h = (d.incident + d.outgoing).norm() * 0.5;
        Geometry::new(
            turned(d.incident),
            turned(d.outgoing),
            fresnel::reflectance(h, 1.54, 0.0),
        )
    }

    #[test]
    fn the_lanes_agree_with_the_models_single_reflection() {
        let material = Material::Dielectric {
            eta: 1.54,
            eta_std: 0.0,
        };
        let mut compared = 0;
        for (rig, pose, p) in cases() {
            let optics = Optics::new(&rig, &material);
            let lamp = rig.cones.widening();
            let (value, _) = single(&geometry(&rig, pose), &p, lamp);
            // With ρd = 0 the model's terms (a) and (c) remain. (c) is proportional to A². The riser's part of (a) is
            // below e⁻⁶⁰ of its peak at these angles only for small θr, so only those are compared.
            let at = |amplitude: f64| {
                let surface = Surface {
                    theta_r: p[0],
                    alpha_u: p[2].exp(),
                    alpha_v: p[3].exp(),
                    rho_d: 0.0,
                    amplitude,
                };
                let turned = Pose {
                    phi_s: pose.phi_s + Angle::from_rad(p[1]) - rig.azimuth_zero,
                    ..pose
                };
                radiance(
                    Variant::Sawtooth,
                    &rig.directions(turned),
                    &surface,
                    &optics,
                )
            };
            let single_reflection = 2.0 * at(1.0) - 0.5 * at(2.0);
            if p[0] < 0.2 {
                assert!(
                    (value - single_reflection).abs() < 1e-9 * (1.0 + value),
                    "{p:?} {pose:?}: {value} {single_reflection}"
                );
                compared += 1;
            }
        }
        assert_eq!(compared, 180);
    }

    #[test]
    fn the_derivatives_agree_with_central_differences() {
        for (rig, pose, p) in cases() {
            let lamp = rig.cones.widening();
            let g = geometry(&rig, pose);
            let (value, slopes) = single(&g, &p, lamp);
            for k in 0..4 {
                let step = 1e-5;
                let (mut up, mut down) = (p, p);
                up[k] += step;
                down[k] -= step;
                let (a, b) = (single(&g, &up, lamp).0, single(&g, &down, lamp).0);
                // At a kink between the two points the one-sided slopes differ.
                let one_sided = ((a - value) - (value - b)).abs() / step;
                let tolerance = 1e-6 * (1.0 + slopes[k].abs()) + 2.0 * one_sided;
                assert!(
                    ((a - b) / (2.0 * step) - slopes[k]).abs() < tolerance,
                    "{k} {p:?} {pose:?}"
                );
            }
        }
    }
}
