//! Levenberg–Marquardt for many pixels at once: one pixel per lane, damped normal equations per
//! lane, and a new pixel in a lane as soon as its last one is done, so that slow pixels hold up
//! nobody.
//!
//! The five parameters are well scaled (angles in radians, logarithms, a reflectance), the damping
//! is Marquardt's (a multiple of the diagonal), so 5 × 5 Cholesky factors in doubles are safe; a
//! pixel whose factors are not is flagged by the rank test of [`PixelFit`], never passed on.
//!
//! *Conditioning.* A step from the damped normal equations has relative errors of 1e-16 times their condition, below 1e-7 for
//! all pixels that the rank test of [`super::inverse`] lets pass; a descent ends where the step after its last would gain 1e-6 of its
//! cost. QR in lanes would cost twice as much for digits that nobody reads.

mod step;

use pulp::{Arch, Simd, WithSimd};

use super::costly::{Met, Size};
use super::inverse::invert;
use super::kernel::{GEOMETRY, Geometry, Parameters};
use crate::model::lanes::{Lane, Numbers};
use step::step;

/// Free parameters per pixel.
pub(super) const FREE: usize = 5;
/// Numbers in a packed symmetric matrix of [`FREE`] rows.
pub(super) const PACKED: usize = FREE * (FREE + 1) / 2;
/// Numbers per observation and lane: weight, weighted signal, weighted B.
const ROW: usize = 3;
/// A descent is over where the step after the next would lower the cost by less than this share of 1 + cost.
const CONVERGED: f64 = 1e-6;
/// The same where the costly terms are taken anew since the minimum is near.
const NEAR: f64 = 1e-2;
/// The same on metal.
const NEAR_ON_METAL: f64 = 1e-3;
/// The same for few observations: they know the minimum of all no better than to some standard deviations.
const OPEN: f64 = 0.1;
/// First steps at whose ends the costly terms are taken anew, so that not the kernel's minimum is
/// walked to first.
const EARLY: u16 = 2;
/// Squared distance, in standard deviations, from where the costly terms were taken beyond which a
/// descent does not end: they change by a few percent of what the signal does.
const STALE2: f64 = 1.0;
/// Evaluations after which a pixel is given up.
const EVALUATIONS_MAX: u16 = 80;
/// Bounds; ψ has none.
pub(super) const LOWER: [f64; FREE] = [0.0, f64::NEG_INFINITY, -6.9, -6.9, 0.0];
/// See [`LOWER`]: 75°, α = 1, ρd = 1. An amplitude may go to [`AMPLITUDE_MAX`].
pub(super) const UPPER: [f64; FREE] = [1.309, f64::INFINITY, 0.0, 0.0, 1.0];
pub(super) const AMPLITUDE_MAX: f64 = 20.0;

/// Where packed element (i, j ≤ i) lies.
pub(super) const fn packed(i: usize, j: usize) -> usize {
    i * (i + 1) / 2 + j
}

/// How a pixel's fit ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum End {
    /// The next step would be far below a standard deviation.
    Converged,
    /// No step lowers the cost, or there were too many.
    Stalled,
    /// Fewer observations than [`FREE`] + 1.
    TooFew,
}

/// One pixel's fit.
#[derive(Debug, Clone, Copy)]
pub(super) struct PixelFit {
    pub(super) p: Parameters,
    /// Packed covariance for weights 1/σ; `None` where the normal matrix is singular.
    pub(super) covariance: Option<[f64; PACKED]>,
    pub(super) chi2: f64,
    pub(super) n_used: usize,
    /// Evaluations of all observations; one of a part of them counts as that part.
    pub(super) evaluations: f32,
    pub(super) end: End,
}

impl PixelFit {
    /// Whether αu, αv or the fifth parameter stands on a bound.
    pub(super) fn at_bound(&self, amplitude: bool) -> bool {
        let upper = upper(amplitude);
        (2..FREE).any(|k| self.p[k] <= LOWER[k] + 1e-9 || self.p[k] >= upper[k] - 1e-9)
            || self.p[0] >= upper[0] - 1e-9
    }
}

fn upper(amplitude: bool) -> Parameters {
    let mut upper = UPPER;
    if amplitude {
        upper[4] = AMPLITUDE_MAX;
    }
    upper
}

/// Where pixels come from. Slices have one element per observation.
pub(super) trait Pixels: Sync {
    /// Pixels to fit.
    fn count(&self) -> usize;
    /// Writes a pixel's signal, weights (1/σ, 0 where masked) and, unless all pixels share one,
    /// geometry; returns its start.
    fn load(
        &self,
        pixel: usize,
        signal: &mut [f64],
        weight: &mut [f64],
        geometry: &mut [Geometry],
    ) -> Parameters;
    /// Writes what the kernel leaves out at parameters `p`, and B.
    fn costly(
        &self,
        p: &Parameters,
        size: Size,
        met: &mut Met,
        offset: &mut [f64],
        basis: &mut [f64],
    );
}

/// What part of the way to its minimum a descent goes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Way {
    /// All of it, from a start that may be far away.
    Whole,
    /// With few observations to where these leave it open: a fit's parameters are where to go next.
    There,
    /// From the end of [`Way::There`].
    Rest,
}

/// What is the same for all pixels.
#[derive(Clone, Copy)]
pub(super) struct Job<'a> {
    pub(super) observations: usize,
    /// R²/8 of the lamp.
    pub(super) lamp: f64,
    /// The fifth parameter is the amplitude (conductors) instead of ρd.
    pub(super) amplitude: bool,
    /// Geometry at the centre of the field, for which the costly terms are.
    pub(super) geometry: &'a [Geometry],
    /// Whether [`Pixels::load`] writes each pixel's own; else all share the centre's.
    pub(super) own_geometry: bool,
    /// How often the costly terms are taken anew before the last descent.
    pub(super) refreshes: u8,
    pub(super) way: Way,
    pub(super) pixels: &'a dyn Pixels,
}

/// Fits all pixels of a job; `Arch::new()` takes the widest instructions that the machine has.
pub(super) fn solve_on(arch: Arch, job: &Job<'_>) -> Vec<PixelFit> {
    arch.dispatch(Descent(job))
}

struct Descent<'a>(&'a Job<'a>);

impl WithSimd for Descent<'_> {
    type Output = Vec<PixelFit>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Vec<PixelFit> {
        descend(simd, self.0)
    }
}

// Rows of the state table; each row has one number per lane.
const P: usize = 0;
const TRIAL: usize = 5;
/// sin θ, cos θ, sin ψ, cos ψ, αu², αv² of the accepted point …
const SHAPE: usize = 10;
/// … and of the trial.
const TRIAL_SHAPE: usize = 16;
const COST: usize = 22;
const LAMBDA: usize = 23;
const NORMAL: usize = 24;
const GRADIENT: usize = NORMAL + PACKED;
const DECREMENT: usize = GRADIENT + FREE;
const ROWS: usize = DECREMENT + 1;

/// What a lane is busy with.
#[derive(Clone, Copy)]
struct Slot {
    pixel: usize,
    refreshes_left: u8,
    evaluations: u16,
    n_used: usize,
    /// Cost at the last accepted point, and what an undamped step from there would have gained.
    cost: f64,
    gain: f64,
    /// Where the costly terms were taken.
    taken_at: Parameters,
}

struct Table<'a> {
    job: &'a Job<'a>,
    width: usize,
    state: Numbers,
    /// Weight, signal less offset and B, both weighted: `[observation][these three][lane]`.
    rows: Numbers,
    /// `[observation][GEOMETRY][lane]`; empty where shared.
    geometry: Numbers,
    /// One pixel's columns while it moves in.
    raw: Vec<Vec<f64>>,
    offset: Vec<f64>,
    column: Vec<f64>,
    own_geometry: Vec<Geometry>,
    slots: Vec<Option<Slot>>,
    next: usize,
    met: Met,
}

impl<'a> Table<'a> {
    fn new(job: &'a Job<'a>, width: usize) -> Self {
        let n = job.observations;
        Table {
            job,
            width,
            state: Numbers::zeros(ROWS * width),
            rows: Numbers::zeros(ROW * n * width),
            geometry: Numbers::zeros(if job.own_geometry {
                n * GEOMETRY * width
            } else {
                0
            }),
            raw: vec![vec![0.0; n]; width],
            offset: vec![0.0; n],
            column: vec![0.0; n],
            own_geometry: if job.own_geometry {
                vec![Geometry([0.0; GEOMETRY]); n]
            } else {
                Vec::new()
            },
            slots: vec![None; width],
            next: 0,
            met: Met::default(),
        }
    }

    fn get(&self, field: usize, lane: usize) -> f64 {
        self.state[field * self.width + lane]
    }

    fn set(&mut self, field: usize, lane: usize, x: f64) {
        self.state[field * self.width + lane] = x;
    }

    fn parameters(&self, lane: usize) -> Parameters {
        std::array::from_fn(|k| self.get(P + k, lane))
    }

    /// Moves the next pixel that has enough observations into a lane; those that have not are
    /// answered at once. Without one the lane stays empty and weighs nothing.
    fn refill(&mut self, lane: usize, fits: &mut [PixelFit]) {
        self.slots[lane] = None;
        while self.next < self.job.pixels.count() {
            let pixel = self.next;
            self.next += 1;
            let start = self.job.pixels.load(
                pixel,
                &mut self.raw[lane],
                &mut self.column,
                &mut self.own_geometry,
            );
            let used = self.column.iter().filter(|w| **w > 0.0).count();
            let least = match self.job.way {
                Way::There => 2 * FREE,
                Way::Whole | Way::Rest => FREE,
            };
            if used <= least {
                fits[pixel] = PixelFit {
                    n_used: used,
                    end: End::TooFew,
                    ..fits[pixel]
                };
                continue;
            }
            for (row, w) in self
                .rows
                .chunks_exact_mut(ROW * self.width)
                .zip(&self.column)
            {
                row[lane] = *w;
            }
            for (j, g) in self.own_geometry.iter().enumerate() {
                for (k, x) in g.0.iter().enumerate() {
                    self.geometry[(j * GEOMETRY + k) * self.width + lane] = *x;
                }
            }
            self.slots[lane] = Some(Slot {
                pixel,
                refreshes_left: self.job.refreshes,
                evaluations: 0,
                n_used: used,
                cost: f64::INFINITY,
                gain: 0.0,
                taken_at: start,
            });
            let size = if self.job.amplitude || self.job.way == Way::Rest {
                Size::Usual
            } else {
                Size::Large
            };
            self.refresh(lane, &start, size);
            self.begin_at(lane, &start);
            return;
        }
        for row in self.rows.chunks_exact_mut(self.width) {
            row[lane] = 0.0;
        }
        self.begin_at(lane, &[0.1, 0.0, -2.0, -2.0, 0.1]);
    }

    /// Takes the costly terms at `p`.
    fn refresh(&mut self, lane: usize, p: &Parameters, size: Size) {
        let (offset, basis) = (&mut self.offset, &mut self.column);
        self.job
            .pixels
            .costly(p, size, &mut self.met, offset, basis);
        let width = self.width;
        if self.job.own_geometry {
            for (j, (basis, centre)) in basis.iter_mut().zip(self.job.geometry).enumerate() {
                let number = |k| self.geometry[(j * GEOMETRY + k) * width + lane];
                *basis *= Geometry(std::array::from_fn(number)).facing_beside(centre, p);
            }
        }
        for (((row, raw), offset), basis) in self
            .rows
            .chunks_exact_mut(ROW * width)
            .zip(&self.raw[lane])
            .zip(&self.offset)
            .zip(&self.column)
        {
            let weight = row[lane];
            row[width + lane] = weight * (raw - offset);
            row[2 * width + lane] = weight * basis;
        }
        if let Some(slot) = &mut self.slots[lane] {
            slot.taken_at = *p;
        }
    }

    fn begin_at(&mut self, lane: usize, p: &Parameters) {
        for (k, x) in p.iter().enumerate() {
            self.set(TRIAL + k, lane, *x);
            self.set(P + k, lane, *x);
        }
        let shape = [
            p[0].sin(),
            p[0].cos(),
            p[1].sin(),
            p[1].cos(),
            (2.0 * p[2]).exp(),
            (2.0 * p[3]).exp(),
        ];
        for (k, x) in shape.into_iter().enumerate() {
            self.set(TRIAL_SHAPE + k, lane, x);
            self.set(SHAPE + k, lane, x);
        }
        self.set(COST, lane, f64::INFINITY);
        self.set(LAMBDA, lane, 1e-3);
        for k in 0..PACKED + FREE {
            self.set(NORMAL + k, lane, 0.0);
        }
    }

    /// Squared distance of the accepted point from another, in standard deviations.
    fn moved2(&self, lane: usize, from: &Parameters) -> f64 {
        let away: Parameters = std::array::from_fn(|k| self.get(P + k, lane) - from[k]);
        let mut sum = 0.0;
        for i in 0..FREE {
            let own = self.get(NORMAL + packed(i, i), lane) * away[i];
            let others: f64 = (0..i)
                .map(|j| self.get(NORMAL + packed(i, j), lane) * away[j])
                .sum();
            sum += away[i] * (own + 2.0 * others);
        }
        sum
    }

    /// Looks at a lane after a step was proposed: goes on, refreshes the costly terms, or answers.
    fn look(&mut self, lane: usize, fits: &mut [PixelFit]) {
        let Some(mut slot) = self.slots[lane] else {
            return;
        };
        slot.evaluations += 1;
        let cost = self.get(COST, lane);
        let lambda = self.get(LAMBDA, lane);
        // What an undamped step would gain, at most.
        let gain = self.get(DECREMENT, lane) * (1.0 + lambda);
        // Gains fall at least as fast from step to step as they did last, so what the step after this one
        // would gain is known without an evaluation.
        let accepted = cost < slot.cost;
        let next_gain = if accepted && gain < slot.gain {
            gain * (gain / slot.gain)
        } else {
            gain
        };
        if accepted {
            (slot.cost, slot.gain) = (cost, gain);
        }
        self.slots[lane] = Some(slot);
        let converged = cost.is_finite() && next_gain <= CONVERGED * (1.0 + cost);
        let stalled = lambda > 1e7 || !cost.is_finite() || slot.evaluations >= EVALUATIONS_MAX;
        // On metal the costly terms are no small part of the light: there the way to the kernel's own
        // minimum is the safe one, and every round of new terms is asked for.
        let careful = self.job.amplitude;
        if self.job.way == Way::There {
            self.look_on_the_way(lane, gain <= OPEN * (1.0 + cost), stalled, fits);
            return;
        }
        let near = if careful { NEAR_ON_METAL } else { NEAR };
        let early = !careful && slot.evaluations <= EARLY && gain > near * (1.0 + cost);
        let first = slot.refreshes_left == self.job.refreshes && self.job.way == Way::Whole;
        let stale = slot.refreshes_left > 0
            && if first || careful {
                // A descent may arrive from afar in one step.
                converged || gain <= near * (1.0 + cost)
            } else {
                converged && self.moved2(lane, &slot.taken_at) > STALE2
            };
        if (stale || early && self.job.refreshes > 0) && !stalled {
            // At the next trial, so that no evaluation is lost. Near the minimum its cost has nothing
            // to be compared with; far from it the change is much smaller than what a step gains.
            if stale {
                slot.refreshes_left -= 1;
                slot.cost = f64::INFINITY;
                slot.gain = 0.0;
                self.set(COST, lane, f64::INFINITY);
            }
            self.slots[lane] = Some(slot);
            let trial = std::array::from_fn(|k| self.get(TRIAL + k, lane));
            let size = if stale || self.job.way == Way::Rest {
                Size::Usual
            } else {
                Size::Large
            };
            self.refresh(lane, &trial, size);
        } else if converged || stalled {
            let normal: [f64; PACKED] = std::array::from_fn(|k| self.get(NORMAL + k, lane));
            // The last step is taken unseen.
            let (p, chi2) = if converged {
                let trial = std::array::from_fn(|k| self.get(TRIAL + k, lane));
                (trial, (cost - gain).max(0.0))
            } else {
                (self.parameters(lane), cost)
            };
            fits[slot.pixel] = PixelFit {
                p,
                covariance: invert(&normal),
                chi2,
                n_used: slot.n_used,
                evaluations: f32::from(slot.evaluations),
                end: if converged {
                    End::Converged
                } else {
                    End::Stalled
                },
            };
            self.refill(lane, fits);
        }
    }

    /// The same with few observations: over as soon as they leave open where the minimum is.
    fn look_on_the_way(&mut self, lane: usize, open: bool, stalled: bool, fits: &mut [PixelFit]) {
        let Some(slot) = self.slots[lane] else {
            return;
        };
        let trial = std::array::from_fn(|k| self.get(TRIAL + k, lane));
        if open || stalled {
            fits[slot.pixel] = PixelFit {
                p: if open { trial } else { self.parameters(lane) },
                evaluations: f32::from(slot.evaluations),
                end: End::Converged,
                ..fits[slot.pixel]
            };
            self.refill(lane, fits);
        } else if slot.evaluations <= EARLY && self.job.refreshes > 0 {
            self.refresh(lane, &trial, Size::Large);
        }
    }
}

#[inline(always)]
fn descend<S: Simd>(simd: S, job: &Job<'_>) -> Vec<PixelFit> {
    let width = Lane::<S>::WIDTH;
    let mut fits = vec![
        PixelFit {
            p: [f64::NAN; FREE],
            covariance: None,
            chi2: f64::NAN,
            n_used: 0,
            evaluations: 0.0,
            end: End::TooFew,
        };
        job.pixels.count()
    ];
    let mut table = Table::new(job, width);
    for lane in 0..width {
        table.refill(lane, &mut fits);
    }
    while table.slots.iter().any(Option::is_some) {
        if job.amplitude {
            step::<S, true>(simd, &mut table);
        } else {
            step::<S, false>(simd, &mut table);
        }
        for lane in 0..width {
            table.look(lane, &mut fits);
        }
    }
    fits
}

#[cfg(test)]
mod tests;
