//! The algorithm behind [`minimise`](super::levenberg_marquardt::minimise): trial steps, polish and the classification of the end,
//! as an argmin [`Solver`].

mod nonsmooth;
mod polish;

use std::sync::atomic::{AtomicBool, Ordering};

use argmin::core::{Error, IterState, KV, Problem, Solver, TerminationReason, TerminationStatus};
use nalgebra::{DMatrix, DVector};

use super::minimum::{Bounds, Ending, Minimum, Settings};
use super::trust_region::{SmallSystem, Triangle};
use super::{LeastSquares, householder, norm, sum_of_squares};

/// State of the solver in argmin: parameters, no gradient, Jacobian, no Hessian, residuals.
pub type State = IterState<DVector<f64>, (), DMatrix<f64>, (), DVector<f64>, f64>;

#[derive(Debug, Clone, Copy, PartialEq)]
enum Phase {
    Descent,
    Polish { done: u32, misses: u32, last: f64 },
    Over(Ending),
}

/// A point with everything evaluated there.
#[derive(Debug)]
struct Point {
    x: Vec<f64>,
    r: Vec<f64>,
    j: Vec<f64>,
    cost: f64,
}

/// The algorithm; see the module documentation of `levenberg_marquardt`. One argmin iteration is one trial step.
#[derive(Debug)]
pub struct LevenbergMarquardt<'a> {
    bounds: Bounds,
    settings: Settings,
    cancel: &'a AtomicBool,
    n: usize,
    m: usize,
    x: Vec<f64>,
    r: Vec<f64>,
    j: Vec<f64>,
    cost: f64,
    scale: Vec<f64>,
    radius: f64,
    damping: f64,
    phase: Phase,
    may_polish: bool,
    /// Whether it followed kinks of the residuals ([`nonsmooth`]).
    slid: bool,
    iterations: u64,
    evaluations: u64,
    /// Best point of the descent, kept during the polish.
    anchor: Option<Point>,
    trial_x: Vec<f64>,
    trial_r: Vec<f64>,
    trial_j: Vec<f64>,
    work: Vec<f64>,
    rhs: Vec<f64>,
    small: SmallSystem,
}

impl<'a> LevenbergMarquardt<'a> {
    /// Makes a solver for n parameters and m residuals.
    #[must_use]
    pub fn new(
        n: usize,
        m: usize,
        bounds: Bounds,
        settings: Settings,
        cancel: &'a AtomicBool,
    ) -> Self {
        LevenbergMarquardt {
            bounds,
            settings,
            cancel,
            n,
            m,
            x: vec![0.0; n],
            r: vec![0.0; m],
            j: vec![0.0; m * n],
            cost: f64::INFINITY,
            scale: vec![0.0; n],
            radius: 0.0,
            damping: 0.0,
            phase: Phase::Descent,
            may_polish: settings.polish_steps > 0,
            slid: false,
            iterations: 0,
            evaluations: 0,
            anchor: None,
            trial_x: vec![0.0; n],
            trial_r: vec![0.0; m],
            trial_j: vec![0.0; m * n],
            work: vec![0.0; m.max(n) * n],
            rhs: vec![0.0; m.max(n)],
            small: SmallSystem::new(n),
        }
    }

    /// Parameters that the projected gradient leaves free.
    fn within_bounds(&self) -> Vec<bool> {
        (0..self.n)
            .map(|j| {
                let gradient: f64 = self.column(j).iter().zip(&self.r).map(|(a, b)| a * b).sum();
                !((self.x[j] <= self.bounds.lower[j] && gradient >= 0.0)
                    || (self.x[j] >= self.bounds.upper[j] && gradient <= 0.0))
            })
            .collect()
    }

    fn column(&self, j: usize) -> &[f64] {
        &self.j[j * self.m..(j + 1) * self.m]
    }

    /// Largest cosine between residuals and a free column: 0 at a minimum.
    fn orthogonality(&self, free: &[bool]) -> f64 {
        let length = self.cost.sqrt();
        if length == 0.0 {
            return 0.0;
        }
        (0..self.n)
            .filter(|&j| free[j])
            .map(|j| {
                let column = self.column(j);
                let size = norm(column);
                if size == 0.0 {
                    return 0.0;
                }
                let dot: f64 = column.iter().zip(&self.r).map(|(a, b)| a * b).sum();
                (dot / size / length).abs()
            })
            .fold(0.0, f64::max)
    }

    /// Length of a step scaled by D; [`Self::size`] is the same for the parameters, ‖D x‖.
    fn length(&self, step: &[f64]) -> f64 {
        step.iter()
            .zip(&self.scale)
            .map(|(p, d)| (p * d) * (p * d))
            .sum::<f64>()
            .sqrt()
    }

    fn size(&self) -> f64 {
        let size = self.length(&self.x);
        if size > 0.0 { size } else { 1.0 }
    }

    fn take_scales(&mut self) {
        for j in 0..self.n {
            let length = norm(&self.j[j * self.m..(j + 1) * self.m]);
            self.scale[j] = self.scale[j].max(if length > 0.0 {
                length
            } else {
                f64::MIN_POSITIVE
            });
        }
    }

    /// Computes R and Qᵀ(−r − J·fixed step) of the free columns, packed; returns their number.
    fn factorise(&mut self, free: &[bool], step: &[f64], rescaled: bool) -> usize {
        let m = self.m;
        self.rhs.iter_mut().for_each(|v| *v = 0.0);
        for i in 0..m {
            self.rhs[i] = -self.r[i];
        }
        let mut packed = 0;
        for j in 0..self.n {
            let column = &self.j[j * m..(j + 1) * m];
            if free[j] {
                let divisor = if rescaled { self.scale[j] } else { 1.0 };
                for (w, c) in self.work[packed * m..(packed + 1) * m]
                    .iter_mut()
                    .zip(column)
                {
                    *w = c / divisor;
                }
                packed += 1;
            } else if step[j] != 0.0 {
                for (b, c) in self.rhs.iter_mut().zip(column) {
                    *b -= c * step[j];
                }
            }
        }
        if packed > 0 && m >= packed {
            householder(&mut self.work[..packed * m], m, packed, &mut self.rhs[..m]);
        }
        packed
    }

    /// Computes the damped step inside trust region and bounds; `None` if the system cannot be solved.
    fn damped_step(&mut self, free: &[bool]) -> Option<Vec<f64>> {
        let mut free = free.to_vec();
        let mut step = vec![0.0; self.n];
        loop {
            let packed = self.factorise(&free, &step, false);
            if packed == 0 {
                return Some(step);
            }
            let spent = self.length(
                &step
                    .iter()
                    .zip(&free)
                    .map(|(p, f)| if *f { 0.0 } else { *p })
                    .collect::<Vec<_>>(),
            );
            let radius = (self.radius * self.radius - spent * spent)
                .max(1e-4 * self.radius * self.radius)
                .sqrt();
            let scale: Vec<f64> = (0..self.n)
                .filter(|&j| free[j])
                .map(|j| self.scale[j])
                .collect();
            let triangle = Triangle {
                r: &self.work[..packed * self.m],
                m: self.m,
                qtb: &self.rhs[..packed],
            };
            let (solution, damping) = self.small.solve(triangle, &scale, radius, self.damping)?;
            self.damping = damping;
            let mut crossed = false;
            let mut k = 0;
            for j in 0..self.n {
                if !free[j] {
                    continue;
                }
                step[j] = solution[k];
                k += 1;
                let target = self.x[j] + step[j];
                let bound = if target < self.bounds.lower[j] {
                    self.bounds.lower[j]
                } else if target > self.bounds.upper[j] {
                    self.bounds.upper[j]
                } else {
                    continue;
                };
                step[j] = bound - self.x[j];
                free[j] = false;
                crossed = true;
            }
            if !crossed {
                return Some(step);
            }
        }
    }

    fn place_trial(&mut self, step: &[f64]) {
        for ((trial, x), p) in self.trial_x.iter_mut().zip(&self.x).zip(step) {
            *trial = x + p;
        }
        self.bounds.clamp(&mut self.trial_x);
    }

    fn evaluate<P: LeastSquares>(&mut self, problem: &mut Problem<P>) -> Result<f64, Error> {
        let (x, r, j) = (&self.trial_x, &mut self.trial_r, &mut self.trial_j);
        problem.problem("evaluations", |p| {
            p.evaluate(x, r, j);
            Ok(())
        })?;
        self.evaluations += 1;
        let cost = sum_of_squares(&self.trial_r);
        let finite = cost.is_finite() && self.trial_j.iter().all(|v| v.is_finite());
        Ok(if finite { cost } else { f64::INFINITY })
    }

    fn accept(&mut self, cost: f64) {
        std::mem::swap(&mut self.x, &mut self.trial_x);
        std::mem::swap(&mut self.r, &mut self.trial_r);
        std::mem::swap(&mut self.j, &mut self.trial_j);
        self.cost = cost;
    }

    /// Whether the descent ends near the minimum: a polish follows, or none is wanted.
    fn is_rough(&self) -> bool {
        self.may_polish || self.settings.polish_steps == 0
    }

    fn descend<P: LeastSquares>(&mut self, problem: &mut Problem<P>) -> Result<(), Error> {
        let free = self.within_bounds();
        if self.orthogonality(&free) < 1e-14 {
            self.hand_over(Ending::ConvergedByGradient);
            return Ok(());
        }
        let Some(step) = self.damped_step(&free) else {
            self.phase = Phase::Over(Ending::RankDeficient);
            return Ok(());
        };
        self.place_trial(&step);
        let length = self.length(&step);
        let predicted_cost: f64 = (0..self.m)
            .map(|i| {
                let mut value = self.r[i];
                for (j, p) in step.iter().enumerate() {
                    value += self.j[i + j * self.m] * p;
                }
                value * value
            })
            .sum();
        let predicted = self.cost - predicted_cost;
        let cost = self.evaluate(problem)?;
        let actual = self.cost - cost;
        let ratio = if predicted > 0.0 {
            actual / predicted
        } else {
            -1.0
        };
        if ratio < 0.25 {
            // Moré: shrink to the minimum of the parabola through value, slope and trial.
            let shrink = if cost.is_finite() && predicted > 0.0 && actual < 0.0 {
                (0.5 * predicted / (predicted - actual)).clamp(0.1, 0.5)
            } else if cost.is_finite() && actual >= 0.0 {
                0.5
            } else {
                0.1
            };
            self.radius = shrink * self.radius.min(length / 0.1);
            self.damping /= shrink;
        } else if ratio >= 0.75 || self.damping == 0.0 {
            self.radius = (2.0 * length).max(if ratio >= 0.75 { self.radius } else { 0.0 });
            self.damping *= 0.5;
        }
        let reference = self.cost;
        if ratio > 1e-4 && actual >= 0.0 {
            self.accept(cost);
            self.take_scales();
        }
        let (cost_tolerance, step_tolerance) = match self.is_rough() {
            true => (self.settings.cost_tolerance, self.settings.step_tolerance),
            false => (4.0 * f64::EPSILON, f64::EPSILON),
        };
        let small_gain = actual.abs() <= cost_tolerance * reference
            && predicted.abs() <= cost_tolerance * reference;
        let small_radius = self.radius <= step_tolerance * self.size();
        if small_gain {
            self.end_descent(problem, Ending::ConvergedByCost)?;
        } else if small_radius {
            self.end_descent(problem, Ending::Stalled)?;
        }
        Ok(())
    }

    /// The same; if the polish did not converge, the remaining gain may be along a kink.
    fn end_descent<P: LeastSquares>(
        &mut self,
        problem: &mut Problem<P>,
        ending: Ending,
    ) -> Result<(), Error> {
        if self.is_rough() || self.slid {
            self.hand_over(ending);
            return Ok(());
        }
        self.slid = true;
        let before = self.cost;
        match self.slide(problem)? {
            Some(ending) => self.phase = Phase::Over(ending),
            // It left the kinks.
            None if self.cost < before => {
                self.may_polish = true;
                self.damping = 0.0;
                self.radius = self.settings.initial_radius * self.size();
            }
            None => self.hand_over(ending),
        }
        Ok(())
    }

    /// Ends the descent: the first time with the polish, then finally.
    fn hand_over(&mut self, ending: Ending) {
        if self.may_polish {
            self.anchor = Some(Point {
                x: self.x.clone(),
                r: self.r.clone(),
                j: self.j.clone(),
                cost: self.cost,
            });
            self.phase = Phase::Polish {
                done: 0,
                misses: 0,
                last: f64::INFINITY,
            };
        } else {
            self.phase = Phase::Over(ending);
        }
    }

    /// Ratio of the smallest to the largest singular value of the free columns, scaled to length 1. The running scales
    /// are not used, so a vanished column counts as 0.
    fn conditioning(&self, free: &[bool]) -> f64 {
        let columns: Vec<usize> = (0..self.n).filter(|&j| free[j]).collect();
        if columns.is_empty() {
            return 1.0;
        }
        if columns.len() > self.m {
            return 0.0;
        }
        let (m, n) = (self.m, columns.len());
        let mut scaled = Vec::with_capacity(m * n);
        for &j in &columns {
            let length = norm(self.column(j));
            let factor = if length > 0.0 { 1.0 / length } else { 0.0 };
            scaled.extend(self.column(j).iter().map(|x| x * factor));
        }
        householder(&mut scaled, m, n, &mut vec![0.0; m]);
        let r = DMatrix::from_fn(n, n, |i, j| if i <= j { scaled[i + j * m] } else { 0.0 });
        let values = r.singular_values();
        values.min() / values.max()
    }

    /// Returns the result, with the ending checked again by gradient and rank.
    #[must_use]
    pub fn into_minimum(self) -> Minimum {
        let free = self.within_bounds();
        let mut ending = match self.phase {
            Phase::Over(ending) => ending,
            Phase::Descent | Phase::Polish { .. } => Ending::MaxIterations,
        };
        if !matches!(ending, Ending::NotFinite | Ending::Cancelled) {
            let gradient = self.orthogonality(&free);
            if matches!(ending, Ending::ConvergedByCost | Ending::Stalled) && gradient < 1e-9 {
                ending = Ending::ConvergedByGradient;
            }
            // For a perfect fit, the rounding of the residuals limits how small the cosine can get.
            if ending.is_success() && self.conditioning(&free) < self.settings.rank_tolerance {
                ending = Ending::RankDeficient;
            }
        }
        Minimum {
            at_bound: (0..self.n).filter(|&j| !free[j]).collect(),
            parameters: self.x,
            residuals: self.r,
            jacobian: self.j,
            cost: self.cost,
            ending,
            evaluations: self.evaluations,
        }
    }
}

impl<P: LeastSquares> Solver<P, State> for LevenbergMarquardt<'_> {
    fn name(&self) -> &str {
        "bounded Levenberg-Marquardt with Gauss-Newton polish"
    }

    fn init(
        &mut self,
        problem: &mut Problem<P>,
        mut state: State,
    ) -> Result<(State, Option<KV>), Error> {
        let start = state.take_param().expect("minimise sets the start");
        self.trial_x.copy_from_slice(start.as_slice());
        let cost = self.evaluate(problem)?;
        self.accept(cost);
        if cost.is_finite() {
            self.take_scales();
            self.radius = self.settings.initial_radius * self.size();
        } else {
            self.phase = Phase::Over(Ending::NotFinite);
        }
        Ok((state.param(start).cost(cost), None))
    }

    fn next_iter(
        &mut self,
        problem: &mut Problem<P>,
        state: State,
    ) -> Result<(State, Option<KV>), Error> {
        self.iterations += 1;
        if self.cancel.load(Ordering::Relaxed) {
            self.phase = Phase::Over(Ending::Cancelled);
        } else if self.iterations > self.settings.max_iterations {
            self.phase = Phase::Over(Ending::MaxIterations);
        }
        match self.phase {
            Phase::Descent => self.descend(problem)?,
            Phase::Polish { done, misses, last } => self.polish(problem, done, misses, last)?,
            Phase::Over(_) => {}
        }
        let x = DVector::from_column_slice(&self.x);
        Ok((state.param(x).cost(self.cost), None))
    }

    fn terminate(&mut self, _state: &State) -> TerminationStatus {
        match self.phase {
            Phase::Over(ending) if ending.is_success() => {
                TerminationStatus::Terminated(TerminationReason::SolverConverged)
            }
            Phase::Over(ending) => {
                TerminationStatus::Terminated(TerminationReason::SolverExit(format!("{ending:?}")))
            }
            _ => TerminationStatus::NotTerminated,
        }
    }
}
