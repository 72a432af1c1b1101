//! The closed forms of one observation with their derivatives, for a register of surfaces.
//!
//! The directions are those of a far rig, rotated by the offsets; the forms themselves are in `model::form`. `batched_lm`
//! descends with them.

use pulp::Simd;

use crate::fit::problem::{Problem, Quantity};
use crate::model::form::{self, Half, NUMBERS, Shape};
use crate::model::fresnel::reflectance;
use crate::model::lanes::Lane;
use crate::model::prepared::{OpticsTable, Prepared};
use crate::model::{Surface, Variant};

/// Quantities with derivatives, in the order of their columns.
pub(in crate::fit) const COLUMNS: [Quantity; N] = Quantity::ALL;
pub(in crate::fit) const N: usize = 8;
/// Number of values of one observation: sine and cosine of tilt and azimuth, signal, weight.
pub(in crate::fit) const ROW: usize = 6;
/// Number of values that describe a surface.
pub(in crate::fit) const SHAPE: usize = NUMBERS + PLACED;
/// Number of values that place a surface and its signals: sine and cosine of tilt and azimuth offset, gain, background.
const PLACED: usize = 6;

/// Returns the column of each free quantity; `None` if lanes do not support one.
pub(in crate::fit) fn columns(problem: &Problem<'_>) -> Option<Vec<usize>> {
    let column = |q: &Quantity| COLUMNS.iter().position(|c| c == q);
    problem.free().iter().map(column).collect()
}

/// Describes the observations for [`LaneForm::row`].
pub(in crate::fit) fn rows(problem: &Problem<'_>) -> impl Iterator<Item = [f64; ROW]> {
    let observations = problem.set().observations.iter();
    let all = observations.zip(problem.sigma()).zip(problem.poses());
    all.map(|((o, sigma), [tilt, turn])| [tilt.0, tilt.1, turn.0, turn.1, o.signal, 1.0 / sigma])
}

/// Weighted residual and derivatives.
#[derive(Clone, Copy)]
pub(in crate::fit) struct LaneRow<S: Simd> {
    pub(in crate::fit) residual: Lane<S>,
    /// By [`COLUMNS`]; the first derivative is by |θr|.
    pub(in crate::fit) slopes: [Lane<S>; N],
}

/// The closed form of a variant on a far rig.
#[derive(Clone, Copy)]
pub(in crate::fit) struct LaneForm {
    variant: Variant,
    table: OpticsTable,
    /// Direction of the lamp: along the camera direction, across it in the tilt plane, and perpendicular to that plane.
    lamp: [f64; 3],
    /// Reflectance at the half angle, and |h|².
    f: f64,
    h2: f64,
}

impl LaneForm {
    pub(in crate::fit) fn new(problem: &Problem<'_>) -> Self {
        let rig = &problem.set().rig;
        let (sl, cl) = rig.theta_l.sin_cos();
        let (sa, ca) = rig.light_azimuth.sin_cos();
        let table = *problem.nominal_optics();
        let (eta, k) = (table.optics.eta, table.optics.k);
        let h2 = 2.0 + 2.0 * cl;
        LaneForm {
            variant: problem.variant(),
            table,
            lamp: [cl, sl * ca, sl * sa],
            f: reflectance(0.5 * h2.sqrt(), eta, k),
            h2,
        }
    }

    /// Writes the values that describe a surface, from its values by [`COLUMNS`].
    pub(in crate::fit) fn shape(&self, x: &[f64; N], to: &mut [f64; SHAPE]) {
        let [
            theta_r,
            ln_alpha_u,
            ln_alpha_v,
            rho_d,
            scale,
            background,
            turn,
            tilt,
        ] = *x;
        let surface = Surface {
            theta_r,
            alpha_u: ln_alpha_u.exp(),
            alpha_v: ln_alpha_v.exp(),
            rho_d,
            amplitude: 1.0,
        };
        let prepared = Prepared::new(self.variant, &surface, &self.table);
        to[..NUMBERS].copy_from_slice(prepared.numbers());
        // θr < 0 is the surface rotated by 180°.
        let side = if theta_r < 0.0 { -1.0 } else { 1.0 };
        let (so, co) = tilt.sin_cos();
        let (sp, cp) = turn.sin_cos();
        let placed = [so, co, side * sp, side * cp, scale, background];
        to[NUMBERS..].copy_from_slice(&placed);
    }

    /// Evaluates one observation of one surface per lane.
    #[inline(always)]
    pub(in crate::fit) fn row<S: Simd>(
        &self,
        simd: S,
        pose: &[Lane<S>; ROW],
        shape: &[Lane<S>; SHAPE],
    ) -> LaneRow<S> {
        let [st, ct, sr, cr, signal, weight] = *pose;
        let placed: &[Lane<S>; PLACED] = shape[NUMBERS..]
            .first_chunk()
            .expect("as many as are placed");
        let [so, co, sp0, cp0, scale, background] = *placed;
        let [along, inside, beside] = self.lamp.map(|x| Lane::splat(simd, x));
        let (sin, cos) = (st.mul_add(co, ct * so), ct.mul_add(co, -(st * so)));
        let (sp, cp) = (sr.mul_add(cp0, cr * sp0), cr.mul_add(cp0, -(sr * sp0)));
        // Rig frame x, y, z; the camera's y is 0.
        let (ix, iz) = (
            along.mul_add(sin, inside * cos),
            along.mul_add(cos, -(inside * sin)),
        );
        let i = [
            ix.mul_add(sp, -(beside * cp)),
            ix.mul_add(cp, beside * sp),
            iz,
        ];
        let o = [sin * sp, sin * cp, cos];
        let k = |x: f64| Lane::splat(simd, x);
        let fixed = self.table.fixed();
        let surface = Shape::of(shape.first_chunk().expect("more than they"), k(1.0));
        let half = Half::of_far_rig(k(self.h2), k(self.f));
        let g = form::radiance(
            self.variant,
            fixed.is_dielectric(),
            fixed,
            &surface,
            &half,
            &i,
            &o,
        );
        // The tilt rotates a rig direction (x, y, z) about +y at the rate (z, 0, −x); the rotation of the sample
        // rotates (u, v) at the rate (v, −u).
        macro_rules! turned {
            ($w:expr, $g:expr, $x:expr) => {
                (
                    $w[1] * $g[0] - $w[0] * $g[1],
                    $w[2] * ($g[0] * sp + $g[1] * cp) - $x * $g[2],
                )
            };
        }
        let (turn_i, tilt_i) = turned!(i, g.incident, ix);
        let (turn_o, tilt_o) = turned!(o, g.outgoing, sin);
        let gain = weight * scale;
        LaneRow {
            residual: weight * (scale.mul_add(g.value, background) - signal),
            slopes: [
                gain * g.theta_r,
                gain * g.ln_alpha_u,
                gain * g.ln_alpha_v,
                gain * g.rho_d,
                weight * g.value,
                weight,
                gain * (turn_i + turn_o),
                gain * (tilt_i + tilt_o),
            ],
        }
    }
}
