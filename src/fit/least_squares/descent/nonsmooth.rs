//! Minima on kinks of the residuals, where no derivative vanishes.
//!
//! A direction along the ridges is shadowed by either of the two flanks. The visibility has a kink where they change
//! places, and the cost may have its minimum there: it rises to both sides, but every further step promises a gain.
//! Such a descent continues *along* the kinks: a damped step in the space orthogonal to their normals, then a move
//! across to the lowest point between the flanks. The normal of a kink is the difference of the derivatives of a
//! residual on its two sides.

use std::sync::atomic::Ordering;

use argmin::core::{Error, Problem};

use super::{Ending, LeastSquares, LevenbergMarquardt, Triangle, householder};
use crate::fit::least_squares::norm;

/// Distance on both sides of a point at which its derivatives are evaluated, as a share of ‖D x‖.
const ASIDE: f64 = 1e-10;
/// Kinks below this share of the strongest one are not followed.
const FAINT: f64 = 1e-4;
/// Smallest share of a normal that has to remain beside the others.
const OBLIQUE: f64 = 0.05;
const STEPS: usize = 60;
/// Relative gain that counts as zero.
const NO_GAIN: f64 = 1e-13;
/// Cosine between residuals and derivatives that counts as zero.
const ORTHOGONAL: f64 = 1e-9;

impl LevenbergMarquardt<'_> {
    /// Continues along the kinks at which the descent has ended; `None` if there are none.
    pub(super) fn slide<P: LeastSquares>(
        &mut self,
        problem: &mut Problem<P>,
    ) -> Result<Option<Ending>, Error> {
        let mut normals = self.kinks(problem)?;
        if normals.is_empty() {
            return Ok(None);
        }
        let mut radius = self.settings.initial_radius * self.size();
        let mut without_gain = 0;
        for _ in 0..STEPS {
            if self.cancel.load(Ordering::Relaxed) {
                return Ok(Some(Ending::Cancelled));
            }
            let Some((step, promised, cosine)) = self.step_along(&normals, radius) else {
                break;
            };
            if promised <= NO_GAIN * self.cost || cosine < ORTHOGONAL {
                return Ok(Some(Ending::ConvergedByGradient));
            }
            self.place_trial(&step);
            let length = self.length(&step);
            let mut cost = self.evaluate(problem)?;
            if cost.is_finite() {
                for normal in &normals {
                    cost = self.lowest_across(problem, normal, length)?;
                }
            }
            let gain = self.cost - cost;
            let ratio = gain / promised;
            if ratio < 0.25 {
                radius = 0.25 * radius.min(length);
            } else if ratio > 0.75 {
                radius = radius.max(2.0 * length);
            }
            if gain > 0.0 {
                self.accept(cost);
                // The step may have met other kinks, or left these.
                let met = self.kinks(problem)?;
                if met.is_empty() {
                    return Ok(None);
                }
                normals = met;
            }
            without_gain = match gain > NO_GAIN * self.cost {
                true => 0,
                false => without_gain + 1,
            };
            if radius <= f64::EPSILON * self.size() || without_gain > 8 {
                break;
            }
        }
        Ok(Some(Ending::Stalled))
    }

    /// Returns orthonormal normals, in scaled parameters, of the kinks with rising cost on both sides.
    fn kinks<P: LeastSquares>(&mut self, problem: &mut Problem<P>) -> Result<Vec<Vec<f64>>, Error> {
        let free = self.within_bounds();
        let size = self.size();
        let mut found: Vec<(f64, Vec<f64>)> = Vec::new();
        for j in (0..self.n).filter(|j| free[*j]) {
            let aside = ASIDE * size / self.scale[j];
            let above = self.slope_beside(problem, j, aside)?;
            let on_this_side = self.trial_j.clone();
            let below = self.slope_beside(problem, j, -aside)?;
            if !(below < 0.0 && above > 0.0) {
                continue;
            }
            for (i, residual) in self.r.iter().enumerate() {
                let jump = |k: usize| {
                    let entry = i + k * self.m;
                    (on_this_side[entry] - self.trial_j[entry]) / self.scale[k]
                };
                let normal: Vec<f64> = (0..self.n)
                    .map(|k| if free[k] { jump(k) } else { 0.0 })
                    .collect();
                found.push((residual.abs() * norm(&normal), normal));
            }
        }
        found.sort_by(|a, b| b.0.total_cmp(&a.0));
        let strongest = found.first().map_or(0.0, |(weight, _)| *weight);
        let mut normals: Vec<Vec<f64>> = Vec::new();
        for (weight, normal) in found {
            if weight > FAINT * strongest {
                add_direction(&mut normals, normal);
            }
        }
        Ok(normals)
    }

    /// Half the derivative of the cost by a parameter, one step away along it.
    fn slope_beside<P: LeastSquares>(
        &mut self,
        problem: &mut Problem<P>,
        j: usize,
        step: f64,
    ) -> Result<f64, Error> {
        self.trial_x.copy_from_slice(&self.x);
        self.trial_x[j] += step;
        self.bounds.clamp(&mut self.trial_x);
        self.evaluate(problem)?;
        let column = &self.trial_j[j * self.m..(j + 1) * self.m];
        Ok(column.iter().zip(&self.trial_r).map(|(a, b)| a * b).sum())
    }

    /// Returns a damped step across no normal, the gain that it promises, and the cosine of the remaining gradient.
    fn step_along(&mut self, normals: &[Vec<f64>], radius: f64) -> Option<(Vec<f64>, f64, f64)> {
        let free = self.within_bounds();
        let mut directions = normals.to_vec();
        let units = (0..self.n).filter(|j| free[*j]);
        for _ in normals.len()..units.clone().count() {
            // The unit vector of which the others leave most.
            let left = |j: &usize| 1.0 - directions.iter().map(|d| d[*j] * d[*j]).sum::<f64>();
            let most = units.clone().max_by(|a, b| left(a).total_cmp(&left(b)))?;
            let unit = (0..self.n).map(|k| f64::from(u8::from(k == most)));
            add_direction(&mut directions, unit.collect());
        }
        let along = &directions[normals.len()..];
        let packed = along.len();
        if packed == 0 {
            return Some((vec![0.0; self.n], 0.0, 0.0));
        }
        if packed > self.m {
            return None;
        }
        let mut columns = vec![0.0; self.m * packed];
        let mut cosine: f64 = 0.0;
        for (column, direction) in columns.chunks_exact_mut(self.m).zip(along) {
            for (k, part) in direction.iter().enumerate() {
                let share = part / self.scale[k];
                for (sum, entry) in column.iter_mut().zip(self.column(k)) {
                    *sum += share * entry;
                }
            }
            let lengths = norm(column) * self.cost.sqrt();
            if lengths > 0.0 {
                cosine = cosine.max((dot(column, &self.r) / lengths).abs());
            }
        }
        let mut rhs: Vec<f64> = self.r.iter().map(|r| -r).collect();
        let before = columns.clone();
        householder(&mut columns, self.m, packed, &mut rhs);
        let triangle = Triangle {
            r: &columns,
            m: self.m,
            qtb: &rhs[..packed],
        };
        let ones = vec![1.0; packed];
        let (solution, _) = self.small.solve(triangle, &ones, radius, 0.0)?;
        let mut step = vec![0.0; self.n];
        for (amount, direction) in solution.iter().zip(along) {
            for (k, part) in direction.iter().enumerate() {
                step[k] += amount * part / self.scale[k];
            }
        }
        let within = self.share_within_bounds(&step);
        step.iter_mut().for_each(|p| *p *= within);
        let expected = (0..self.m).map(|i| {
            let change = solution
                .iter()
                .enumerate()
                .map(|(k, s)| before[i + k * self.m] * s);
            (self.r[i] + within * change.sum::<f64>()).powi(2)
        });
        let promised = self.cost - expected.sum::<f64>();
        Some((step, promised, cosine))
    }

    fn share_within_bounds(&self, step: &[f64]) -> f64 {
        let shares = step.iter().enumerate().map(|(j, p)| {
            let bound = match *p > 0.0 {
                true => self.bounds.upper[j],
                false => self.bounds.lower[j],
            };
            match *p == 0.0 {
                true => 1.0,
                false => (bound - self.x[j]) / p,
            }
        });
        shares.fold(1.0, f64::min).max(0.0)
    }

    /// Moves the trial point along a normal to the lowest cost, and evaluates it there.
    fn lowest_across<P: LeastSquares>(
        &mut self,
        problem: &mut Problem<P>,
        normal: &[f64],
        length: f64,
    ) -> Result<f64, Error> {
        let from = self.trial_x.clone();
        let (first, cost) = self.slope_across(problem, &from, normal, 0.0)?;
        let towards = -first.signum();
        // A step of this length leaves a curved kink by its square.
        let size = self.size();
        let mut near = Side {
            at: 0.0,
            cost,
            slope: -first.abs(),
        };
        let mut far = Side {
            at: (length * length / size).max(ASIDE * size),
            ..near
        };
        loop {
            let (slope, cost) = self.slope_across(problem, &from, normal, towards * far.at)?;
            far = Side {
                cost,
                slope: towards * slope,
                ..far
            };
            if !cost.is_finite() || far.slope >= 0.0 {
                break;
            }
            if far.at > size {
                return Ok(f64::INFINITY);
            }
            near = far;
            far.at *= 4.0;
        }
        let mut cost = far.cost;
        for trial in 1.. {
            let least = f64::EPSILON * size.max(4.0 * far.at);
            if far.at - near.at <= least {
                break;
            }
            // Tangents may shorten the way from one side only.
            let at = match trial % 3 {
                0 => 0.5 * (near.at + far.at),
                _ => near.meets(&far, least),
            };
            let slope;
            (slope, cost) = self.slope_across(problem, &from, normal, towards * at)?;
            let slope = towards * slope;
            let side = Side { at, cost, slope };
            match cost.is_finite() && slope < 0.0 {
                true => near = side,
                false => far = side,
            }
        }
        Ok(cost)
    }

    /// Half the derivative of the cost along a normal, and the cost, at a distance from a point.
    fn slope_across<P: LeastSquares>(
        &mut self,
        problem: &mut Problem<P>,
        from: &[f64],
        normal: &[f64],
        distance: f64,
    ) -> Result<(f64, f64), Error> {
        for (k, trial) in self.trial_x.iter_mut().enumerate() {
            *trial = from[k] + distance * normal[k] / self.scale[k];
        }
        self.bounds.clamp(&mut self.trial_x);
        let cost = self.evaluate(problem)?;
        let slope = normal.iter().enumerate().map(|(k, part)| {
            let column = &self.trial_j[k * self.m..(k + 1) * self.m];
            part / self.scale[k] * dot(column, &self.trial_r)
        });
        Ok((slope.sum(), cost))
    }
}

/// A point on one side of a kink, on the way across it.
#[derive(Clone, Copy)]
struct Side {
    at: f64,
    cost: f64,
    /// Half the derivative of the cost.
    slope: f64,
}

impl Side {
    /// Where the tangents of two sides meet, at least `least` away from both; the middle if they meet elsewhere.
    fn meets(&self, far: &Side, least: f64) -> f64 {
        let tangent = |side: &Side| side.cost - 2.0 * side.slope * side.at;
        let at = 0.5 * (tangent(far) - tangent(self)) / (self.slope - far.slope);
        let half = 0.5 * (far.at - self.at);
        let away = least.min(half);
        match (self.at..=far.at).contains(&at) {
            true => at.max(self.at + away).min(far.at - away),
            false => self.at + half,
        }
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Adds the remainder of a direction beside the others, with length 1, unless it is too small.
fn add_direction(directions: &mut Vec<Vec<f64>>, mut new: Vec<f64>) {
    let whole = norm(&new);
    // Twice is enough.
    for _ in 0..2 {
        for other in directions.iter() {
            let along = dot(other, &new);
            new.iter_mut().zip(other).for_each(|(n, o)| *n -= along * o);
        }
    }
    let left = norm(&new);
    if left > OBLIQUE * whole {
        new.iter_mut().for_each(|n| *n /= left);
        directions.push(new);
    }
}
