//! What a form takes, a surface and the half vector's length, and what it returns.

use crate::model::fresnel::Slopes;
use crate::model::register::Register;

/// Numbers that describe a surface; see [`Shape`].
pub(crate) const NUMBERS: usize = 23;

/// Numbers that depend on the index and the rig only, so that a register shares them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Fixed {
    /// Real and imaginary part of the index.
    pub(in crate::model) eta: f64,
    pub(in crate::model) k: f64,
    /// c_d/ρd = 1/(π T(1) T(cos θl)), and κ/ρd with κ = π c_d T̄².
    pub(in crate::model) diffuse: f64,
    pub(in crate::model) kappa: f64,
    /// Slopes of c_d and of κ with respect to n and k, each over ρd.
    pub(in crate::model) diffuse_index: [f64; 2],
    pub(in crate::model) kappa_index: [f64; 2],
    /// The cones' share in the retro lobe's variances.
    pub(in crate::model) cones: f64,
    /// 1/tan of the least and of the greatest tilt of the retro lobe's walls.
    pub(in crate::model) per_tan: [f64; 2],
}

impl Fixed {
    /// Whether the index has no imaginary part, so that light can enter.
    pub(crate) fn is_dielectric(&self) -> bool {
        self.k == 0.0
    }
}

/// A surface per place of the register.
#[derive(Clone, Copy)]
pub(crate) struct Shape<R> {
    /// sin θr and cos θr: lengths of riser and facet.
    pub(super) r: R,
    pub(super) p: R,
    /// 1/a and 1/b with a = αu² + R²/8, b = αv² + R²/8.
    pub(super) per_a: R,
    pub(super) per_b: R,
    /// 1/(π √(ab)).
    pub(super) peak: R,
    /// αu²/a and αv²/b.
    pub(super) share_u: R,
    pub(super) share_v: R,
    /// αu².
    pub(super) alpha_u2: R,
    /// 1/(αv² + R²/16), its root, and αv² times it.
    pub(super) per_v_v: R,
    pub(super) root_per_v_v: R,
    pub(super) share_v_v: R,
    /// 1/αv.
    pub(super) per_alpha_v: R,
    pub(super) rho_d: R,
    /// c_d.
    pub(super) c_d: R,
    /// The coefficients of the exchange term, and their slopes with respect to θr and to κ.
    pub(super) exchange: [R; 3],
    pub(super) exchange_theta: [R; 3],
    pub(super) exchange_kappa: [R; 3],
    /// A.
    pub(super) amplitude: R,
}

impl<R: Register> Shape<R> {
    /// Makes the shape from its numbers and A.
    #[inline(always)]
    pub(crate) fn of(numbers: &[R; NUMBERS], amplitude: R) -> Self {
        let n = numbers;
        Shape {
            r: n[0],
            p: n[1],
            per_a: n[2],
            per_b: n[3],
            peak: n[4],
            share_u: n[5],
            share_v: n[6],
            alpha_u2: n[7],
            per_v_v: n[8],
            root_per_v_v: n[9],
            share_v_v: n[10],
            per_alpha_v: n[11],
            rho_d: n[12],
            c_d: n[13],
            exchange: [n[14], n[15], n[16]],
            exchange_theta: [n[17], n[18], n[19]],
            exchange_kappa: [n[20], n[21], n[22]],
            amplitude,
        }
    }
}

/// The half vector's length, on which single reflection depends.
#[derive(Clone, Copy)]
pub(crate) struct Half<R> {
    /// |h|².
    pub(in crate::model) h2: R,
    /// The reflectance at the half angle.
    pub(in crate::model) f: Slopes<R>,
    /// Whether |h| has slopes. Rotations keep it, so that a far rig needs none.
    pub(in crate::model) varies: bool,
}

impl<R: Register> Half<R> {
    /// That of a far rig, with the unpolarised reflectance `f`.
    #[inline(always)]
    pub(crate) fn of_far_rig(h2: R, f: R) -> Self {
        let none = h2.like(0.0);
        let f = Slopes {
            value: f,
            cos: none,
            eta: none,
            k: none,
        };
        Half {
            h2,
            f,
            varies: false,
        }
    }

    /// That of two directions.
    #[inline(always)]
    pub(crate) fn of_directions(i: &[R; 3], o: &[R; 3], fixed: &Fixed) -> Self {
        let h = [i[0] + o[0], i[1] + o[1], i[2] + o[2]];
        let h2 = h[0].fused(h[0], h[1].fused(h[1], h[2] * h[2]));
        Half {
            h2,
            f: h2.root().times(0.5).reflectance(fixed.eta, fixed.k),
            varies: true,
        }
    }

    /// Slope of a lobe with respect to |h|²: |h|⁴ in D, and the Fresnel angle with the cosine |h|/2. `value` is the lobe,
    /// `per_f` its slope with respect to the reflectance.
    #[inline(always)]
    pub(super) fn slope(&self, value: R, per_f: R) -> R {
        let length = self.h2.root();
        (value + value) / self.h2 + per_f * self.f.cos.times(0.25) / length
    }
}

/// A radiance with its slopes.
#[derive(Clone, Copy)]
pub(crate) struct Derivatives<R> {
    /// The radiance.
    pub(crate) value: R,
    /// With respect to θr.
    pub(crate) theta_r: R,
    /// With respect to ln αu.
    pub(crate) ln_alpha_u: R,
    /// With respect to ln αv.
    pub(crate) ln_alpha_v: R,
    /// With respect to ρd.
    pub(crate) rho_d: R,
    /// With respect to A.
    pub(crate) amplitude: R,
    /// With respect to n.
    pub(crate) eta: R,
    /// With respect to k.
    pub(crate) k: R,
    /// With respect to the components of the lamp's direction along u, v, n; at constant |h| for [`Half::of_far_rig`].
    pub(crate) incident: [R; 3],
    /// With respect to those of the camera's direction.
    pub(crate) outgoing: [R; 3],
}
