//! One step of all lanes: evaluate the trials, accept or reject each, propose the next.
//!
//! Call [`step`]. All of it is inlined into the function that is compiled for the machine's instructions.
//!
//! *Conditioning.* See `fit::lane_steps`. A pivot of the column-scaled normal equations loses as many of 16 digits as 1/pivot
//! has: at 1e-9, below which the rank test of `inverse` fails, seven are left.

use pulp::Simd;

use super::kernel::{GEOMETRY, Shape, row};
use super::{
    COST, DECREMENT, FREE, GRADIENT, LAMBDA, LOWER, NORMAL, P, PACKED, ROW, SHAPE, TRIAL,
    TRIAL_SHAPE, Table, packed, upper,
};
use crate::fit::least_squares::lane_steps::{BLOCK, Block, damped};
use crate::model::lanes::Lane;

/// Columns of a row: the slopes and the residual.
const COLUMNS: usize = FREE + 1;
/// Longest step per parameter: rad, rad, logarithms, ρd or amplitude.
const STEP_MAX: [f64; FREE] = [0.15, 0.5, 0.5, 0.5, 0.5];

/// Evaluates all trials, accepts or rejects each, and proposes the next ones.
#[inline(always)]
#[expect(
    clippy::needless_range_loop,
    reason = "matrix indices are the notation, and iterators with closures are not inlined here"
)]
pub(super) fn step<S: Simd, const AMPLITUDE: bool>(simd: S, table: &mut Table<'_>) {
    // Loops and macros in place of closures: what is not inlined into this function is not compiled for its instruction
    // set.
    macro_rules! k {
        ($x:expr) => {
            Lane::splat(simd, $x)
        };
    }
    macro_rules! read {
        ($from:expr, $field:expr) => {
            Lane::load(simd, $from, $field)
        };
    }
    let state = &mut table.state;
    let mut trial_shape = [k!(0.0); 6];
    for (i, x) in trial_shape.iter_mut().enumerate() {
        *x = read!(state, TRIAL_SHAPE + i);
    }
    let fifth = read!(state, TRIAL + 4);
    let lamp = k!(table.job.lamp);
    let inv_a = k!(1.0) / (trial_shape[4] + lamp);
    let inv_b = k!(1.0) / (trial_shape[5] + lamp);
    let shape = Shape {
        sin_theta: trial_shape[0],
        cos_theta: trial_shape[1],
        sin_psi: trial_shape[2],
        cos_psi: trial_shape[3],
        inv_a,
        inv_b,
        norm: (inv_a * inv_b).sqrt(),
    };

    let mut sums = [k!(0.0); PACKED + COLUMNS];
    let mut block = Block::<COLUMNS>::new();
    let n = table.job.observations;
    let mut done = 0;
    while done < n {
        let count = (n - done).min(BLOCK);
        for i in 0..count {
            let j = done + i;
            let mut at = [k!(0.0); GEOMETRY];
            if table.job.own_geometry {
                for i in 0..GEOMETRY {
                    at[i] = Lane::load(simd, &table.geometry, j * GEOMETRY + i);
                }
            } else {
                for i in 0..GEOMETRY {
                    at[i] = Lane::splat(simd, table.job.geometry[j].0[i]);
                }
            }
            let weight = read!(&table.rows, ROW * j);
            let signal = read!(&table.rows, ROW * j + 1);
            let mut r = row(simd, &at, &shape, weight);
            // All numbers here include the weight.
            let (residual, last) = if AMPLITUDE {
                for slope in [&mut r.theta, &mut r.psi, &mut r.alpha_u, &mut r.alpha_v] {
                    *slope = *slope * fifth;
                }
                (signal - fifth * r.value, r.value)
            } else {
                let basis = read!(&table.rows, ROW * j + 2);
                ((-fifth).mul_add(basis, signal - r.value), basis)
            };
            let numbers = [r.theta, r.psi, r.alpha_u, r.alpha_v, last, residual];
            for (k, x) in numbers.into_iter().enumerate() {
                block.put(i, k, x);
            }
        }
        block.add(simd, count, &mut sums);
        done += count;
    }
    let mut normal = [k!(0.0); PACKED];
    normal.copy_from_slice(&sums[..PACKED]);
    let mut gradient = [k!(0.0); FREE];
    gradient.copy_from_slice(&sums[PACKED..PACKED + FREE]);
    let cost = sums[PACKED + FREE];
    // The factors that all rows of a column share.
    let factor = [
        k!(1.0),
        k!(1.0),
        trial_shape[4] * inv_a,
        trial_shape[5] * inv_b,
        k!(1.0),
    ];
    for a in 2..FREE {
        gradient[a] = gradient[a] * factor[a];
        for b in 0..=a {
            normal[packed(a, b)] = normal[packed(a, b)] * (factor[a] * factor[b]);
        }
    }

    // A NaN cost is not less than any number, so it is rejected.
    let accepted = cost.less(read!(state, COST));
    let old_lambda = read!(state, LAMBDA);
    let lambda = accepted.select(
        (old_lambda * k!(0.1)).max(k!(1e-9)),
        (old_lambda * k!(8.0)).max(k!(1e-4)),
    );
    let cost = accepted.select(cost, read!(state, COST));
    let mut p = [cost; FREE];
    for (i, x) in p.iter_mut().enumerate() {
        *x = accepted.select(read!(state, TRIAL + i), read!(state, P + i));
    }
    let mut at = [cost; 6];
    for (i, x) in at.iter_mut().enumerate() {
        *x = accepted.select(trial_shape[i], read!(state, SHAPE + i));
    }
    for i in 0..FREE {
        gradient[i] = accepted.select(gradient[i], read!(state, GRADIENT + i));
    }
    for i in 0..PACKED {
        normal[i] = accepted.select(normal[i], read!(state, NORMAL + i));
    }

    let proposal = propose(simd, &p, &gradient, &normal, lambda, AMPLITUDE);
    let (trial, shape) = advance(simd, &p, &at, &proposal.step, AMPLITUDE);
    lambda.store(state, LAMBDA);
    cost.store(state, COST);
    proposal.decrement.store(state, DECREMENT);
    for i in 0..FREE {
        p[i].store(state, P + i);
        trial[i].store(state, TRIAL + i);
        gradient[i].store(state, GRADIENT + i);
    }
    for i in 0..PACKED {
        normal[i].store(state, NORMAL + i);
    }
    for i in 0..6 {
        at[i].store(state, SHAPE + i);
        shape[i].store(state, TRIAL_SHAPE + i);
    }
}

#[derive(Clone, Copy)]
struct Proposal<S: Simd> {
    step: [Lane<S>; FREE],
    /// Gradient times step: twice the gain that the quadratic model predicts.
    decrement: Lane<S>,
}

/// Solves (H + λ diag H) δ = g for each lane; a parameter at a bound with an outward gradient is held fixed.
#[inline(always)]
fn propose<S: Simd>(
    simd: S,
    p: &[Lane<S>; FREE],
    gradient: &[Lane<S>; FREE],
    normal: &[Lane<S>; PACKED],
    lambda: Lane<S>,
    amplitude: bool,
) -> Proposal<S> {
    macro_rules! k {
        ($x:expr) => {
            Lane::splat(simd, $x)
        };
    }
    let (zero, one) = (k!(0.0), k!(1.0));
    let upper = upper(amplitude);
    let mut free = [one; FREE];
    for i in 2..FREE {
        let below = p[i].less(k!(LOWER[i] + 1e-9)).and(gradient[i].less(zero));
        let above = k!(upper[i] - 1e-9).less(p[i]).and(zero.less(gradient[i]));
        free[i] = below.select(zero, above.select(zero, one));
    }
    let mut d = damped(simd, normal, gradient, &free, lambda);
    let mut decrement = zero;
    let mut excess = one;
    for i in 0..FREE {
        decrement = d[i].mul_add(gradient[i], decrement);
        excess = excess.max(d[i].abs() * k!(1.0 / STEP_MAX[i]));
    }
    let shrink = one / excess;
    for x in &mut d {
        *x = *x * shrink;
    }
    Proposal { step: d, decrement }
}

/// Returns parameters and shape after a step: within bounds, θr ≥ 0 (a facet at −θr is the same as one at θr and ψ +
/// 180°).
#[inline(always)]
fn advance<S: Simd>(
    simd: S,
    p: &[Lane<S>; FREE],
    at: &[Lane<S>; 6],
    step: &[Lane<S>; FREE],
    amplitude: bool,
) -> ([Lane<S>; FREE], [Lane<S>; 6]) {
    macro_rules! k {
        ($x:expr) => {
            Lane::splat(simd, $x)
        };
    }
    let upper = upper(amplitude);
    let mut trial = *p;
    for i in 0..FREE {
        trial[i] = trial[i] + step[i];
    }
    trial[0] = trial[0].min(k!(upper[0]));
    for i in 2..FREE {
        trial[i] = trial[i].max(k!(LOWER[i])).min(k!(upper[i]));
    }
    let (sd, cd) = (trial[0] - p[0]).sin_cos_small();
    let (mut st, ct) = (at[0] * cd + at[1] * sd, at[1] * cd - at[0] * sd);
    let (sd, cd) = (trial[1] - p[1]).sin_cos_small();
    let (mut sp, mut cp) = (at[2] * cd + at[3] * sd, at[3] * cd - at[2] * sd);
    let backwards = trial[0].less(k!(0.0));
    st = backwards.select(-st, st);
    sp = backwards.select(-sp, sp);
    cp = backwards.select(-cp, cp);
    trial[1] = backwards.select(trial[1] + k!(std::f64::consts::PI), trial[1]);
    trial[0] = trial[0].abs();
    let au = (trial[2] - p[2]).exp_small();
    let av = (trial[3] - p[3]).exp_small();
    (trial, [st, ct, sp, cp, at[4] * au * au, at[5] * av * av])
}
