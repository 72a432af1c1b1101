//! The starts of a search as lanes of one register: all descend together on the lean form.
//!
//! The lean form is the light that the facets reflect once and a flat Lambertian surface for all
//! diffuse light (see [`crate::model::prepared::Prepared::lean`]; the riser's share is left out here).
//! Its ends are only where the true descents begin, so the damping is Marquardt's on the normal
//! equations, in doubles. With the lamp at infinity the half angle, and with it the reflectance F, is
//! one number for all poses; the directions are turned by each lane's own offsets:
//!
//! ```text
//! L = F |h|⁴/(4π o_n) · G · exp(−q)/(h_m⁴ √(ab)) + ρd/π · i_n,   G = cos θr − sin θr t
//! q = x²/a + y²/b, x = h_u/h_m, y = h_e/h_m, a = αu² + R²/8, b = αv² + R²/8, t = max(0, i_e/i_m, o_e/o_m)
//! ```
//!
//! Every derivative to an angle is a turn of h and of the direction that t belongs to:
//! ∂ ln D = −2x(∂h_u − x ∂h_m)/(a h_m) − 2y(∂h_e − y ∂h_m)/(b h_m) − 4 ∂h_m/h_m.
//!
//! The one function to call is [`descend_together`].

use std::f64::consts::{FRAC_1_PI, PI};
use std::sync::atomic::{AtomicBool, Ordering};

use pulp::{Arch, Simd, WithSimd};

use super::problem::{Problem, Quantity, Values};
use super::solver::Bounds;
use crate::model::fresnel::reflectance;
use crate::model::lanes::Lane;

/// What lanes move, in the order of their columns.
const COLUMNS: [Quantity; N] = [
    Quantity::ThetaR,
    Quantity::AlphaU,
    Quantity::AlphaV,
    Quantity::RhoD,
    Quantity::Scale,
    Quantity::Background,
    Quantity::AzimuthOffset,
    Quantity::TiltOffset,
];
const N: usize = 8;
const PACKED: usize = N * (N + 1) / 2;
/// Most lanes of any register.
const WIDEST: usize = 16;
/// Evaluations after which a lane is left where it is.
const EVALUATIONS_MAX: usize = 60;
/// Gain, as a share of the cost, below which a lane is done.
const SMALL_GAIN: f64 = 1e-9;
/// Longest steps: rad, logarithms, ρd, a share of scale (see [`limit`]).
const STEP_MAX: [f64; N] = [0.15, 0.7, 0.7, 0.5, 1.0, f64::INFINITY, 0.5, 0.1];

/// Where a lane ended.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct End {
    /// The problem's vector.
    pub parameters: Vec<f64>,
    /// Cost of the lean form there.
    pub cost: f64,
}

/// Descends from every start; `None` where the lanes do not know the problem (another variant, a near
/// rig, a robust loss, corrections, a free index).
pub(super) fn descend_together(
    problem: &Problem<'_>,
    starts: &[Values],
    cancel: &AtomicBool,
) -> Option<Vec<End>> {
    let columns: Vec<usize> = problem
        .free()
        .iter()
        .map(|q| COLUMNS.iter().position(|c| c == q))
        .collect::<Option<_>>()?;
    if !problem.is_plain() {
        return None;
    }
    let table = Table::new(problem, columns);
    let run = Run {
        table: &table,
        starts,
        cancel,
    };
    Some(Arch::new().dispatch(run))
}

/// One observation: sine and cosine of tilt and azimuth, signal, weight.
type Row = [f64; 6];

/// What no lane changes.
struct Table<'p, 'a> {
    problem: &'p Problem<'a>,
    /// Column of each free quantity.
    columns: Vec<usize>,
    rows: Vec<Row>,
    bounds: Bounds,
    /// Lamp along the camera's direction, in the tilt plane across it, and beside it.
    lamp: [f64; 3],
    /// F |h|⁴/(4π).
    gloss: f64,
    /// R²/8.
    wide: f64,
    /// 1/π, or 0 for metal.
    lambert: f64,
}

impl<'p, 'a> Table<'p, 'a> {
    fn new(problem: &'p Problem<'a>, columns: Vec<usize>) -> Self {
        let set = problem.set();
        let (sl, cl) = set.rig.theta_l.sin_cos();
        let (sa, ca) = set.rig.light_azimuth.sin_cos();
        let (eta, k) = set.material.index();
        let h2 = 2.0 + 2.0 * cl;
        let radius = set.rig.light_angular_radius.rad();
        let rows = set
            .observations
            .iter()
            .zip(problem.sigma())
            .zip(problem.poses());
        Table {
            problem,
            columns,
            rows: rows
                .map(|((o, sigma), [tilt, turn])| {
                    [tilt.0, tilt.1, turn.0, turn.1, o.signal, 1.0 / sigma]
                })
                .collect(),
            bounds: problem.bounds(),
            lamp: [cl, sl * ca, sl * sa],
            gloss: reflectance(0.5 * h2.sqrt(), eta, k) * h2 * h2 / (4.0 * PI),
            wide: radius * radius / 8.0,
            lambert: if k > 0.0 { 0.0 } else { FRAC_1_PI },
        }
    }
}

struct Run<'r, 'p, 'a> {
    table: &'r Table<'p, 'a>,
    starts: &'r [Values],
    cancel: &'r AtomicBool,
}

impl WithSimd for Run<'_, '_, '_> {
    type Output = Vec<End>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Vec<End> {
        let width = Lane::<S>::WIDTH.min(WIDEST);
        let mut ends = Vec::with_capacity(self.starts.len());
        for batch in self.starts.chunks(width) {
            // An empty lane repeats the last start.
            let mut lanes: Vec<State> = (0..width)
                .map(|lane| State::new(self.table, &batch[lane.min(batch.len() - 1)]))
                .collect();
            for lane in &mut lanes[batch.len()..] {
                lane.done = true;
            }
            let mut sums = vec![0.0; (1 + N + PACKED) * width];
            for _ in 0..EVALUATIONS_MAX {
                evaluate(simd, self.table, &lanes, &mut sums);
                for (lane, state) in lanes.iter_mut().enumerate() {
                    if !state.done {
                        state.look(self.table, &sums[lane..], width);
                    }
                }
                if lanes.iter().all(|l| l.done) || self.cancel.load(Ordering::Relaxed) {
                    break;
                }
            }
            let found = lanes[..batch.len()].iter();
            ends.extend(found.map(|l| l.end(self.table)));
        }
        ends
    }
}

/// One lane between evaluations; arrays by [`COLUMNS`].
struct State {
    /// All values, for what is not free.
    values: Values,
    x: [f64; N],
    trial: [f64; N],
    cost: f64,
    gradient: [f64; N],
    normal: [f64; PACKED],
    damping: f64,
    done: bool,
}

const fn packed(a: usize, b: usize) -> usize {
    // a ≥ b
    a * (a + 1) / 2 + b
}

impl State {
    fn new(table: &Table<'_, '_>, start: &Values) -> Self {
        let free = table.problem.free();
        let mut x = COLUMNS.map(|q| start.inner(q));
        for (k, _) in free.iter().enumerate() {
            let c = table.columns[k];
            x[c] = x[c].clamp(table.bounds.lower[k], table.bounds.upper[k]);
        }
        State {
            values: *start,
            x,
            trial: x,
            cost: f64::INFINITY,
            gradient: [0.0; N],
            normal: [0.0; PACKED],
            damping: 1e-2,
            done: false,
        }
    }

    fn at(&self, x: &[f64; N]) -> Values {
        let mut values = self.values;
        for (q, v) in COLUMNS.iter().zip(x) {
            values.set_inner(*q, *v);
        }
        values
    }

    fn end(&self, table: &Table<'_, '_>) -> End {
        End {
            parameters: table.columns.iter().map(|c| self.x[*c]).collect(),
            cost: self.cost,
        }
    }

    /// Takes or refuses the trial and proposes the next one. `sums` has this lane first.
    fn look(&mut self, table: &Table<'_, '_>, sums: &[f64], width: usize) {
        let mut gradient: [f64; N] = std::array::from_fn(|a| sums[(1 + a) * width]);
        let mut normal: [f64; PACKED] = std::array::from_fn(|k| sums[(1 + N + k) * width]);
        let extra = rest(table, &self.at(&self.trial), &mut gradient, &mut normal);
        let cost = sums[0] + extra;
        if cost < self.cost {
            self.x = self.trial;
            self.cost = cost;
            self.gradient = gradient;
            self.normal = normal;
            self.damping = (0.1 * self.damping).max(1e-12);
        } else {
            self.damping = (8.0 * self.damping).max(1e-6);
        }
        let step = self.step(table);
        let gain: f64 = step.iter().zip(&self.gradient).map(|(s, g)| -s * g).sum();
        let small = gain <= SMALL_GAIN * self.cost;
        if !self.cost.is_finite() || !gain.is_finite() || small || self.damping > 1e9 {
            self.done = true;
            return;
        }
        self.trial = self.x;
        let longest = limit(&step, self.x[4]);
        for (k, _) in table.problem.free().iter().enumerate() {
            let c = table.columns[k];
            let next = self.x[c] + longest * step[c];
            self.trial[c] = next.clamp(table.bounds.lower[k], table.bounds.upper[k]);
        }
    }

    /// −(H + λ diag H)⁻¹ g over what is free and not pushed against its bound.
    fn step(&self, table: &Table<'_, '_>) -> [f64; N] {
        let mut moving = [0; N];
        let mut n = 0;
        for k in 0..table.columns.len() {
            let c = table.columns[k];
            let (g, x) = (self.gradient[c], self.x[c]);
            let held = (x <= table.bounds.lower[k] && g > 0.0)
                || (x >= table.bounds.upper[k] && g < 0.0)
                || self.normal[packed(c, c)] <= 0.0;
            if !held {
                moving[n] = c;
                n += 1;
            }
        }
        let moving = &moving[..n];
        let entry = |a: usize, b: usize| self.normal[packed(a.max(b), a.min(b))];
        let mut l = [[0.0; N]; N];
        let mut d = [0.0; N];
        for (i, &a) in moving.iter().enumerate() {
            for (j, &b) in moving[..i].iter().enumerate() {
                let sum: f64 = (0..j).map(|m| l[i][m] * l[j][m]).sum();
                l[i][j] = (entry(a, b) - sum) / l[j][j];
            }
            let own = entry(a, a);
            let sum: f64 = (0..i).map(|m| l[i][m] * l[i][m]).sum();
            l[i][i] = (own * (1.0 + self.damping) - sum).max(1e-14 * own).sqrt();
            let sum: f64 = (0..i).map(|m| l[i][m] * d[m]).sum();
            d[i] = (-self.gradient[a] - sum) / l[i][i];
        }
        let mut step = [0.0; N];
        for i in (0..moving.len()).rev() {
            let sum: f64 = (i + 1..moving.len()).map(|m| l[m][i] * d[m]).sum();
            d[i] = (d[i] - sum) / l[i][i];
            step[moving[i]] = d[i];
        }
        step
    }
}

/// Share of a step that is within [`STEP_MAX`].
fn limit(step: &[f64; N], scale: f64) -> f64 {
    let mut excess = 1.0_f64;
    for (c, (s, most)) in step.iter().zip(STEP_MAX).enumerate() {
        let most = if c == 4 { most * scale.abs() } else { most };
        excess = excess.max(s.abs() / most.max(f64::MIN_POSITIVE));
    }
    1.0 / excess
}

/// What flats and priors add to gradient and normal matrix; returns their cost.
fn rest(
    table: &Table<'_, '_>,
    values: &Values,
    gradient: &mut [f64; N],
    normal: &mut [f64; PACKED],
) -> f64 {
    let problem = table.problem;
    let mut cost = 0.0;
    let mut add = |residual: f64, slopes: &[(usize, f64)]| {
        cost += residual * residual;
        for (n, (a, s)) in slopes.iter().enumerate() {
            gradient[*a] += s * residual;
            for (b, t) in &slopes[..=n] {
                normal[packed(*a.max(b), *a.min(b))] += s * t;
            }
        }
    };
    let albedo = problem.reflectance() * FRAC_1_PI;
    for (index, (flat, sigma)) in problem
        .set()
        .flats
        .iter()
        .zip(problem.flat_sigma())
        .enumerate()
    {
        let (cosine, slope) = problem.flat_cosine(index, values);
        let weight = 1.0 / sigma;
        let expected = values.scale * albedo * cosine + values.background;
        add(
            (expected - flat.signal) * weight,
            &[
                (4, albedo * cosine * weight),
                (5, weight),
                (7, values.scale * albedo * slope * weight),
            ],
        );
    }
    for row in 0..problem.priors().len() {
        let (residual, quantity, slope) = problem.prior_row(row, values);
        if let Some(c) = COLUMNS.iter().position(|q| *q == quantity) {
            add(residual, &[(c, slope)]);
        }
    }
    cost
}

/// Cost, gradient and normal matrix of the sample's residuals at every lane's trial.
#[inline(always)]
#[expect(
    clippy::needless_range_loop,
    reason = "matrix indices are the notation, and iterators with closures are not inlined here"
)]
fn evaluate<S: Simd>(simd: S, table: &Table<'_, '_>, lanes: &[State], sums: &mut [f64]) {
    macro_rules! k {
        ($x:expr) => {
            Lane::splat(simd, $x)
        };
    }
    let width = Lane::<S>::WIDTH;
    let mut shape = [0.0; 14 * WIDEST];
    for (lane, state) in lanes.iter().enumerate() {
        let x = &state.trial;
        let side = if x[0] < 0.0 { -1.0 } else { 1.0 };
        let (s, c) = x[0].abs().sin_cos();
        let (au, av) = (x[1].exp(), x[2].exp());
        let (a, b) = (au * au + table.wide, av * av + table.wide);
        let (so, co) = x[7].sin_cos();
        let (sp, cp) = x[6].sin_cos();
        let numbers = [
            s,
            c,
            1.0 / a,
            1.0 / b,
            table.gloss / (a * b).sqrt(),
            au * au / a,
            av * av / b,
            so,
            co,
            side * sp,
            side * cp,
            x[3] * table.lambert,
            x[4],
            x[5],
        ];
        for (n, value) in numbers.into_iter().enumerate() {
            shape[n * width + lane] = value;
        }
    }
    let mut at = [k!(0.0); 14];
    for n in 0..14 {
        at[n] = Lane::load(simd, &shape[..14 * width], n);
    }
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
    ] = at;
    let (zero, one, two, tiny) = (k!(0.0), k!(1.0), k!(2.0), k!(1e-6));
    let [along, inside, beside] = table.lamp.map(|x| k!(x));
    let mut cost = zero;
    let mut gradient = [zero; N];
    let mut normal = [zero; PACKED];
    for row in &table.rows {
        let (st, ct, sr, cr) = (k!(row[0]), k!(row[1]), k!(row[2]), k!(row[3]));
        let (signal, weight) = (k!(row[4]), k!(row[5]));
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
        // ln D for a change of h, and what hides for a change of its direction.
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
        let slopes = [
            gain * to_theta,
            gain * (value * (two * qx - one)) * wu,
            gain * (value * (two * qy - one)) * wv,
            gain * lit * k!(table.lambert),
            weight * radiance,
            weight,
            gain * to_turn,
            gain * (to_tilt - tilted),
        ];
        cost = residual.mul_add(residual, cost);
        for a in 0..N {
            gradient[a] = slopes[a].mul_add(residual, gradient[a]);
            for b in 0..=a {
                normal[packed(a, b)] = slopes[a].mul_add(slopes[b], normal[packed(a, b)]);
            }
        }
    }
    // ∂/∂|θr| is −∂/∂θr on the other side.
    let mut sides = [0.0; WIDEST];
    for (lane, state) in lanes.iter().enumerate() {
        sides[lane] = if state.trial[0] < 0.0 { -1.0 } else { 1.0 };
    }
    let side = Lane::load(simd, &sides[..width], 0);
    gradient[0] = gradient[0] * side;
    for a in 1..N {
        normal[packed(a, 0)] = normal[packed(a, 0)] * side;
    }
    cost.store(sums, 0);
    for a in 0..N {
        gradient[a].store(sums, 1 + a);
    }
    for n in 0..PACKED {
        normal[n].store(sums, 1 + N + n);
    }
}

#[cfg(test)]
#[path = "crew_tests.rs"]
mod tests;
