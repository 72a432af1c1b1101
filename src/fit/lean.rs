//! The lean form of one observation with its derivatives, for a register of starts or of observations.
//!
//! It contains the light that the facets reflect once, and a flat Lambertian surface for all diffuse light (see
//! [`crate::model::prepared::Prepared::lean`]). It omits the light from the riser and reports where that is not zero.
//! With the lamp at infinity the half angle, and with it the reflectance F, is the same for all poses; the directions
//! are rotated by the offsets:
//!
//! ```text
//! L = F |h|⁴/(4π o_n) · G · exp(−q)/(h_m⁴ √(ab)) + ρd/π · i_n,   G = cos θr − sin θr t
//! q = x²/a + y²/b, x = h_u/h_m, y = h_e/h_m, a = αu² + R²/8, b = αv² + R²/8, t = max(0, i_e/i_m, o_e/o_m)
//! ```
//!
//! Every derivative by an angle is a rotation of h and of the direction that t belongs to: ∂ ln D = −2x(∂h_u − x
//! ∂h_m)/(a h_m) − 2y(∂h_e − y ∂h_m)/(b h_m) − 4 ∂h_m/h_m.
//!
//! In `crew` the lanes are starts; in [`evaluate`] they are observations.
//!
//! *Conditioning.* The same divisions as in the full form, without the terms that cancel. Lanes end descents that are
//! refined elsewhere by QR, so a tenth of their digits would suffice.

use std::f64::consts::{FRAC_1_PI, PI};

use pulp::{Arch, Simd, WithSimd};

use super::problem::{Problem, Quantity, Values};
use crate::model::fresnel::reflectance;
use crate::model::lanes::{Lane, Numbers};

/// Quantities with derivatives, in the order of their columns.
pub(super) const COLUMNS: [Quantity; N] = Quantity::ALL;
pub(super) const N: usize = 8;
/// Number of values that describe a surface.
pub(super) const SHAPE: usize = 14;
/// Number of values of one observation: sine and cosine of tilt and azimuth, signal, weight.
pub(super) const ROW: usize = 6;

/// Returns the column of each free quantity; `None` if the form does not support one.
pub(super) fn columns(problem: &Problem<'_>) -> Option<Vec<usize>> {
    let column = |q: &Quantity| COLUMNS.iter().position(|c| c == q);
    problem.free().iter().map(column).collect()
}

/// Values that depend on neither pose nor surface.
#[derive(Clone, Copy)]
pub(super) struct Optics {
    /// Direction of the lamp: along the camera direction, across it in the tilt plane, and perpendicular to that plane.
    lamp: [f64; 3],
    /// F |h|⁴/(4π).
    gloss: f64,
    /// R²/8.
    wide: f64,
    /// 1/π, or 0 for metal.
    lambert: f64,
}

impl Optics {
    pub(super) fn new(problem: &Problem<'_>) -> Self {
        let set = problem.set();
        let (sl, cl) = set.rig.theta_l.sin_cos();
        let (sa, ca) = set.rig.light_azimuth.sin_cos();
        let (eta, k) = set.material.index();
        let h2 = 2.0 + 2.0 * cl;
        Optics {
            lamp: [cl, sl * ca, sl * sa],
            gloss: reflectance(0.5 * h2.sqrt(), eta, k) * h2 * h2 / (4.0 * PI),
            wide: set.rig.cones.widening(),
            lambert: if k > 0.0 { 0.0 } else { FRAC_1_PI },
        }
    }

    /// Describes a surface for [`row`], from its values by [`COLUMNS`].
    pub(super) fn shape(&self, x: &[f64; N]) -> [f64; SHAPE] {
        let side = if x[0] < 0.0 { -1.0 } else { 1.0 };
        let (s, c) = x[0].abs().sin_cos();
        let (au, av) = (x[1].exp(), x[2].exp());
        let (a, b) = (au * au + self.wide, av * av + self.wide);
        let (so, co) = x[7].sin_cos();
        let (sp, cp) = x[6].sin_cos();
        [
            s,
            c,
            1.0 / a,
            1.0 / b,
            self.gloss / (a * b).sqrt(),
            au * au / a,
            av * av / b,
            so,
            co,
            side * sp,
            side * cp,
            x[3] * self.lambert,
            x[4],
            x[5],
        ]
    }
}

/// Describes the observations for [`row`].
pub(super) fn rows(problem: &Problem<'_>) -> impl Iterator<Item = [f64; ROW]> {
    let observations = problem.set().observations.iter();
    let all = observations.zip(problem.sigma()).zip(problem.poses());
    all.map(|((o, sigma), [tilt, turn])| [tilt.0, tilt.1, turn.0, turn.1, o.signal, 1.0 / sigma])
}

/// Weighted residual and derivatives.
#[derive(Clone, Copy)]
pub(super) struct Row<S: Simd> {
    pub(super) residual: Lane<S>,
    /// By [`COLUMNS`]; the first derivative is by |θr|.
    pub(super) slopes: [Lane<S>; N],
    /// 1 where the light from the riser is not zero.
    pub(super) riser: Lane<S>,
}

/// Evaluates one observation of one surface per lane.
#[inline(always)]
pub(super) fn row<S: Simd>(
    simd: S,
    optics: &Optics,
    pose: &[Lane<S>; ROW],
    shape: &[Lane<S>; SHAPE],
) -> Row<S> {
    // Macros instead of closures: code that is not inlined is not compiled for the instruction set.
    macro_rules! k {
        ($x:expr) => {
            Lane::splat(simd, $x)
        };
    }
    let [st, ct, sr, cr, signal, weight] = *pose;
    let [
        s,
        c,
        per_a,
        per_b,
        norm,
        wu,
        wv,
        so,
        co,
        sp0,
        cp0,
        albedo,
        scale,
        background,
    ] = *shape;
    let (zero, one, two, tiny) = (k!(0.0), k!(1.0), k!(2.0), k!(1e-6));
    let [along, inside, beside] = optics.lamp.map(|x| k!(x));
    let (sin, cos) = (st.mul_add(co, ct * so), ct.mul_add(co, -(st * so)));
    let (sp, cp) = (sr.mul_add(cp0, cr * sp0), cr.mul_add(cp0, -(sr * sp0)));
    // Rig frame x, y, z; the camera's y is 0.
    let (ix, iz) = (
        along.mul_add(sin, inside * cos),
        along.mul_add(cos, -(inside * sin)),
    );
    let (ox, oz) = (sin, cos);
    // Sample frame u, v.
    let (iu, iv) = (ix.mul_add(sp, -(beside * cp)), ix.mul_add(cp, beside * sp));
    let (ou, ov) = (ox * sp, ox * cp);
    let (hu, hv, hn, hx) = (iu + ou, iv + ov, iz + oz, ix + ox);
    // Corner frame.
    let (ie, im) = (iv.mul_add(c, -(iz * s)), iv.mul_add(s, iz * c));
    let (oe, om) = (ov.mul_add(c, -(oz * s)), ov.mul_add(s, oz * c));
    let (he, hm) = (ie + oe, im + om);
    let faces = zero.less(im).and(zero.less(om));
    let above = zero.less(iz).and(zero.less(oz));
    let hides_i = (oe * im).less(ie * om);
    macro_rules! nearer {
        ($i:expr, $o:expr) => {
            hides_i.select($i, $o)
        };
    }
    let (we, wm) = (nearer!(ie, oe), nearer!(im, om).max(tiny));
    let (across, wn, wx) = (nearer!(iu, ou), nearer!(iz, oz), nearer!(ix, ox));
    let hm_ = hm.max(tiny);
    let oz_ = oz.max(tiny);
    let (per_wm, per_hm, per_oz) = (one / wm, one / hm_, one / oz_);
    let slope = we * per_wm;
    let hides = zero.less(slope);
    let t = slope.max(zero);
    let g = c - s * t;
    let seen = faces.and(above).and(zero.less(g));
    let (x, y) = (hu * per_hm, he * per_hm);
    let (xa, yb) = (x * per_a, y * per_b);
    let (qx, qy) = (x * xa, y * yb);
    let per2 = per_hm * per_hm;
    let base = seen.select((qx + qy).exp_neg() * per2 * per2 * norm * per_oz, zero);
    let value = base * g;
    // ln D for a change of h, and the shadowing for a change of its direction.
    let four_q = two * (qx + qy) - k!(4.0);
    macro_rules! turned {
        ($hu:expr, $he:expr, $hm:expr, $we:expr, $wm:expr, $bare:expr, $more:expr) => {{
            let lobe = (four_q * $hm - two * (xa * $hu + yb * $he)) * per_hm + $more;
            let hidden = hides.select(s * ($we - t * $wm) * per_wm, zero);
            base * (g.mul_add(lobe, $bare - hidden))
        }};
    }
    // θr: de = −m dθ, dm = e dθ, dG = −s − c t.
    let to_theta = turned!(zero, -hm, he, -wm, we, -(s + c * t), zero);
    // Turn: du = v, dv = −u.
    let to_turn = turned!(
        hv,
        -(hu * c),
        -(hu * s),
        -(across * c),
        -(across * s),
        zero,
        zero
    );
    // Tilt: du = n sin, dv = n cos, dn = −x.
    let to_tilt = turned!(
        hn * sp,
        (hn * cp).mul_add(c, hx * s),
        (hn * cp).mul_add(s, -(hx * c)),
        (wn * cp).mul_add(c, wx * s),
        (wn * cp).mul_add(s, -(wx * c)),
        zero,
        ox * per_oz
    );
    let lit = above.select(iz, zero);
    let diffuse = albedo * lit;
    let tilted = above.select(albedo * ix, zero);
    let radiance = value + diffuse;
    let residual = weight * (scale.mul_add(radiance, background) - signal);
    let gain = weight * scale;
    // The lobe of the riser about −e: not zero where it exceeds e⁻⁴⁰ of its peak.
    let riser = ie.less(zero).and(oe.less(zero));
    let narrow = (hu * hu)
        .mul_add(per_a, hm * hm * per_b)
        .less(k!(40.0) * he * he);
    let riser = riser.and(narrow).select(one, zero);
    let slopes = [
        gain * to_theta,
        gain * (value * (two * qx - one)) * wu,
        gain * (value * (two * qy - one)) * wv,
        gain * lit * k!(optics.lambert),
        weight * radiance,
        weight,
        gain * to_turn,
        gain * (to_tilt - tilted),
    ];
    Row {
        residual,
        slopes,
        riser,
    }
}

/// Writes residuals and derivatives of the lean problem's observations at `values` in the form of
/// [`super::least_squares::LeastSquares::evaluate`], `m` rows per column. Returns `false` if this form does not support
/// the problem or omits light at these values; the results are then invalid.
pub(super) fn evaluate(
    problem: &Problem<'_>,
    values: &Values,
    residuals: &mut [f64],
    jacobian: &mut [f64],
    m: usize,
) -> bool {
    let Some(columns) = columns(problem) else {
        return false;
    };
    Arch::new().dispatch(Whole {
        problem,
        columns: &columns,
        x: COLUMNS.map(|q| values.inner(q)),
        residuals,
        jacobian,
        m,
    })
}

struct Whole<'r, 'a> {
    problem: &'r Problem<'a>,
    columns: &'r [usize],
    x: [f64; N],
    residuals: &'r mut [f64],
    jacobian: &'r mut [f64],
    m: usize,
}

impl WithSimd for Whole<'_, '_> {
    type Output = bool;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> bool {
        let width = Lane::<S>::WIDTH;
        let n = self.problem.set().observations.len();
        let groups = n.div_ceil(width);
        // Lanes beyond the last observation have no weight.
        let mut poses = Numbers::zeros(groups * ROW * width);
        for (i, row) in rows(self.problem).enumerate() {
            for (k, x) in row.into_iter().enumerate() {
                poses[(i / width * ROW + k) * width + i % width] = x;
            }
        }
        let optics = Optics::new(self.problem);
        let mut shape = [Lane::splat(simd, 0.0); SHAPE];
        for (lane, x) in shape.iter_mut().zip(optics.shape(&self.x)) {
            *lane = Lane::splat(simd, x);
        }
        let side = if self.x[0] < 0.0 { -1.0 } else { 1.0 };
        let mut riser = Lane::splat(simd, 0.0);
        let mut found = Numbers::zeros((N + 1) * width);
        for group in 0..groups {
            let mut pose = [riser; ROW];
            for (k, x) in pose.iter_mut().enumerate() {
                *x = Lane::load(simd, &poses, group * ROW + k);
            }
            let mut r = row(simd, &optics, &pose, &shape);
            riser = riser.max(r.riser);
            r.slopes[0] = r.slopes[0] * Lane::splat(simd, side);
            for (k, slope) in r.slopes.iter().enumerate() {
                slope.store(&mut found, k);
            }
            r.residual.store(&mut found, N);
            let from = group * width;
            let count = width.min(n - from);
            self.residuals[from..from + count].copy_from_slice(&found[N * width..][..count]);
            for (j, column) in self.columns.iter().enumerate() {
                self.jacobian[j * self.m + from..][..count]
                    .copy_from_slice(&found[column * width..][..count]);
            }
        }
        riser.store(&mut found, 0);
        found[..width].iter().all(|x| *x == 0.0)
    }
}
