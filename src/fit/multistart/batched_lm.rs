//! Vectorised descents: the starts of a search are the lanes of one register and descend together.
//!
//! Call [`descend_together`]. True descents begin at the ends, so Marquardt's damping of the normal equations in doubles is
//! accurate enough.
//!
//! *Conditioning.* Normal equations of up to eight columns in doubles lose half of the digits. Seven remain, and a
//! start only has to lie in the right basin. Marquardt's damping scales with the diagonal, so units do not matter. A
//! lane whose factors are not positive is damped further and not passed on.

use std::f64::consts::FRAC_1_PI;
use std::sync::atomic::{AtomicBool, Ordering};

use pulp::{Arch, Scalar, Simd, WithSimd};

use super::lane_form::{COLUMNS, LaneForm, N, ROW, SHAPE, columns, rows};
use crate::fit::least_squares::lane_steps::{BLOCK, Block, damped, packed};
use crate::fit::least_squares::minimum::{Bounds, Ending, Minimum};
use crate::fit::problem::{Problem, Values};
use crate::model::lanes::{Lane, Numbers, WIDEST};

const PACKED: usize = N * (N + 1) / 2;
/// Columns of a row: the slopes and the residual.
const ALL: usize = N + 1;
/// Gain, as a share of the cost, below which a lane is done.
const SMALL_GAIN: f64 = 1e-7;
/// Damping up to which a step is as good as a Gauss–Newton step.
const HARDLY_DAMPED: f64 = 1e-3;
/// Longest steps: rad, logarithms, ρd, a share of scale (see [`limit`]).
const STEP_MAX: [f64; N] = [0.15, 0.7, 0.7, 0.5, 1.0, f64::INFINITY, 0.5, 0.1];

/// Whether lanes support a problem. They do not on a near rig, with a robust loss, corrections or a free index.
pub(in crate::fit) fn knows(problem: &Problem<'_>) -> bool {
    problem.is_plain() && columns(problem).is_some()
}

/// Descends from every start, with up to `evaluations` each; the ends have no residuals and derivatives. Returns `None` if lanes do not support the problem.
pub(in crate::fit) fn descend_together(
    problem: &Problem<'_>,
    starts: &[Values],
    evaluations: usize,
    cancel: &AtomicBool,
) -> Option<Vec<Minimum>> {
    let columns = columns(problem).filter(|_| problem.is_plain())?;
    let table = Table::new(problem, columns);
    let run = Run {
        table: &table,
        starts,
        evaluations,
        cancel,
    };
    Some(Arch::new().dispatch(run))
}

/// Values that all lanes share.
struct Table<'p, 'a> {
    problem: &'p Problem<'a>,
    /// Column of each free quantity.
    columns: Vec<usize>,
    rows: Vec<[f64; ROW]>,
    bounds: Bounds,
    form: LaneForm,
}

impl<'p, 'a> Table<'p, 'a> {
    fn new(problem: &'p Problem<'a>, columns: Vec<usize>) -> Self {
        Table {
            problem,
            columns,
            rows: rows(problem).collect(),
            bounds: problem.bounds(),
            form: LaneForm::new(problem),
        }
    }
}

struct Run<'r, 'p, 'a> {
    table: &'r Table<'p, 'a>,
    starts: &'r [Values],
    /// Maximum evaluations of a lane.
    evaluations: usize,
    cancel: &'r AtomicBool,
}

impl WithSimd for Run<'_, '_, '_> {
    type Output = Vec<Minimum>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Vec<Minimum> {
        let width = Lane::<S>::WIDTH.min(WIDEST);
        let table = self.table;
        let mut ends: Vec<Option<Minimum>> = vec![None; self.starts.len()];
        let mut waiting = self.starts.iter().enumerate();
        // An empty lane repeats the first start.
        let Some(first) = self.starts.first() else {
            return Vec::new();
        };
        let mut lanes: Vec<State> = (0..width)
            .map(|_| match waiting.next() {
                Some((index, start)) => State::new(table, start, Some(index)),
                None => State::new(table, first, None),
            })
            .collect();
        let mut sums = Numbers::zeros((1 + N + PACKED) * width);
        while lanes.iter().any(|l| l.start.is_some()) {
            evaluate(simd, table, &lanes, &mut sums);
            let cancelled = self.cancel.load(Ordering::Relaxed);
            for (lane, state) in lanes.iter_mut().enumerate() {
                let Some(index) = state.start else {
                    continue;
                };
                let done = state.look(table, &sums[lane..], width);
                if done || state.evaluations >= self.evaluations || cancelled {
                    ends[index] = Some(state.end(table));
                    // A lane that is done takes the next start, so that none waits for its neighbours.
                    match waiting.next().filter(|_| !cancelled) {
                        Some((index, start)) => *state = State::new(table, start, Some(index)),
                        None => state.start = None,
                    }
                }
            }
        }
        ends.into_iter().flatten().collect()
    }
}

/// State of one lane between evaluations; arrays by [`COLUMNS`].
struct State {
    /// All values, including those that are not free.
    values: Values,
    x: [f64; N],
    trial: [f64; N],
    cost: f64,
    gradient: [f64; N],
    normal: [f64; PACKED],
    damping: f64,
    evaluations: usize,
    /// Whether `x` is a minimum: a nearly undamped step would gain almost nothing.
    settled: bool,
    /// Index of its start; none if the lane is empty.
    start: Option<usize>,
}

impl State {
    fn new(table: &Table<'_, '_>, values: &Values, start: Option<usize>) -> Self {
        let free = table.problem.free();
        let mut x = COLUMNS.map(|q| values.inner(q));
        for (k, _) in free.iter().enumerate() {
            let c = table.columns[k];
            x[c] = x[c].clamp(table.bounds.lower[k], table.bounds.upper[k]);
        }
        State {
            values: *values,
            x,
            trial: x,
            cost: f64::INFINITY,
            gradient: [0.0; N],
            normal: [0.0; PACKED],
            damping: 1e-2,
            evaluations: 0,
            settled: false,
            start,
        }
    }

    fn at(&self, x: &[f64; N]) -> Values {
        let mut values = self.values;
        for (q, v) in COLUMNS.iter().zip(x) {
            values.set_inner(*q, *v);
        }
        values
    }

    fn end(&self, table: &Table<'_, '_>) -> Minimum {
        Minimum {
            parameters: table.columns.iter().map(|c| self.x[*c]).collect(),
            residuals: Vec::new(),
            jacobian: Vec::new(),
            cost: self.cost,
            ending: match self.settled {
                true => Ending::ConvergedByGradient,
                false => Ending::MaxIterations,
            },
            at_bound: Vec::new(),
            evaluations: self.evaluations as u64,
        }
    }

    /// Accepts or rejects the trial and proposes the next one; returns whether the lane is done. `sums` begins with
    /// this lane.
    fn look(&mut self, table: &Table<'_, '_>, sums: &[f64], width: usize) -> bool {
        let mut gradient: [f64; N] = std::array::from_fn(|a| sums[(1 + a) * width]);
        let mut normal: [f64; PACKED] = std::array::from_fn(|k| sums[(1 + N + k) * width]);
        let extra = rest(table, &self.at(&self.trial), &mut gradient, &mut normal);
        let cost = sums[0] + extra;
        self.evaluations += 1;
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
            self.settled = small && self.damping <= HARDLY_DAMPED;
            return true;
        }
        self.trial = self.x;
        let longest = limit(&step, self.x[4]);
        for (k, _) in table.problem.free().iter().enumerate() {
            let c = table.columns[k];
            let next = self.x[c] + longest * step[c];
            self.trial[c] = next.clamp(table.bounds.lower[k], table.bounds.upper[k]);
        }
        false
    }

    /// −(H + λ diag H)⁻¹ g over the parameters that are free and not pushed against their bounds.
    fn step(&self, table: &Table<'_, '_>) -> [f64; N] {
        let lane = |x: f64| Lane::splat(Scalar::new(), x);
        let mut free = [lane(0.0); N];
        for k in 0..table.columns.len() {
            let c = table.columns[k];
            let (g, x) = (self.gradient[c], self.x[c]);
            let held = (x <= table.bounds.lower[k] && g > 0.0)
                || (x >= table.bounds.upper[k] && g < 0.0)
                || self.normal[packed(c, c)] <= 0.0;
            free[c] = lane(if held { 0.0 } else { 1.0 });
        }
        let downhill = self.gradient.map(|g| lane(-g));
        let (normal, damping) = (self.normal.map(lane), lane(self.damping));
        damped(Scalar::new(), &normal, &downhill, &free, damping).map(|step| step.1)
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

/// Adds flats and priors to gradient and normal matrix; returns their cost.
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
        let [cosine, slope, _] = problem.flat_cosine(index, values);
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

/// Computes cost, gradient and normal matrix of the sample residuals at the trial of every lane.
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
    let mut block = Block::<ALL>::new();
    let mut shape = [0.0; SHAPE * WIDEST];
    let mut numbers = [0.0; SHAPE];
    for (lane, state) in lanes.iter().enumerate() {
        table.form.shape(&state.trial, &mut numbers);
        for n in 0..SHAPE {
            shape[n * width + lane] = numbers[n];
        }
    }
    let zero = k!(0.0);
    let mut at = [zero; SHAPE];
    for n in 0..SHAPE {
        at[n] = Lane::load(simd, &shape[..SHAPE * width], n);
    }
    let mut totals = [zero; PACKED + ALL];
    for rows in table.rows.chunks(BLOCK) {
        for (i, row) in rows.iter().enumerate() {
            let mut pose = [k!(0.0); ROW];
            for n in 0..ROW {
                pose[n] = k!(row[n]);
            }
            let found = table.form.row(simd, &pose, &at);
            for a in 0..N {
                block.put(i, a, found.slopes[a]);
            }
            block.put(i, N, found.residual);
        }
        block.add(simd, rows.len(), &mut totals);
    }
    let (normal, rest) = totals.split_at_mut(PACKED);
    let (gradient, cost) = rest.split_at_mut(N);
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
    cost[0].store(sums, 0);
    for a in 0..N {
        gradient[a].store(sums, 1 + a);
    }
    for n in 0..PACKED {
        normal[n].store(sums, 1 + N + n);
    }
}

#[cfg(test)]
#[path = "batched_lm_tests.rs"]
mod tests;
