//! Levenberg–Marquardt for many pixels at once: one pixel per lane, and damped normal equations per lane. A lane
//! takes a new pixel as soon as its last one is done, so slow pixels do not delay the others.
//!
//! The five parameters are well scaled (angles in radians, logarithms, a reflectance) and the damping is Marquardt's
//! (a multiple of the diagonal), so 5 × 5 Cholesky factors in f64 are safe. The rank test of [`PixelFit`] flags a
//! pixel whose factors are not.
//!
//! *Conditioning.* A step from the damped normal equations has relative errors of 1e-16 times their condition, below
//! 1e-7 for all pixels that pass the rank test of [`self::inverse`]. A descent ends if the step after its last would
//! gain 1e-6 of its cost. QR in lanes would cost twice as much for digits that are not used.

pub(super) mod inverse;
pub(super) mod kernel;
mod pixel_fit;
pub(super) mod starts;
mod step;

use pulp::{Arch, Simd, WithSimd};

use super::higher_order_terms::{Met, Way};
use crate::model::lanes::{Lane, Numbers};
use inverse::invert;
use kernel::{FREE, GEOMETRY, Geometry, PACKED, Parameters, packed};
#[cfg(test)]
pub(super) use pixel_fit::UPPER;
use pixel_fit::upper;
pub(super) use pixel_fit::{End, LOWER, PixelFit};
use step::step;

/// Numbers per observation and lane: weight, weighted signal, weighted B.
const ROW: usize = 3;
/// A descent is over if the step after the next would lower the cost by less than this share of 1 + cost.
const CONVERGED: f64 = 1e-6;
/// As [`CONVERGED`], for a subset of the observations: it determines the minimum of all only to some standard
/// deviations.
const OPEN: f64 = 0.1;
/// Squared distance, in standard deviations, from where the costly terms were computed beyond which a descent that
/// converged recomputes them and goes on. The terms change by a few percent of the signal's change.
const STALE2: f64 = 1.0;
/// Evaluations after which a descent is abandoned.
const EVALUATIONS_MAX: u16 = 80;
/// The source of pixels. Slices have one element per observation.
pub(super) trait Pixels: Sync {
    /// Pixels to fit.
    fn count(&self) -> usize;
    /// Writes a pixel's signal, weights (1/σ, 0 where masked) and, unless all pixels share it, geometry; returns its
    /// start.
    fn load(
        &self,
        pixel: usize,
        signal: &mut [f64],
        weight: &mut [f64],
        geometry: &mut [Geometry],
    ) -> Parameters;
    /// Writes the offset of the costly terms at parameters `p`, and B.
    fn costly(
        &self,
        p: &Parameters,
        way: Way,
        met: &mut Met,
        offset: &mut [f64],
        basis: &mut [f64],
    );
}

/// Inputs that all pixels share.
#[derive(Clone, Copy)]
pub(super) struct Job<'a> {
    pub(super) observations: usize,
    /// R²/8 of the lamp.
    pub(super) lamp: f64,
    /// Whether the fifth parameter is the amplitude (conductors) in place of ρd.
    pub(super) amplitude: bool,
    /// Geometry at the centre of the field, to which the costly terms apply.
    pub(super) geometry: &'a [Geometry],
    /// Whether [`Pixels::load`] writes each pixel's own geometry; else all use the centre's.
    pub(super) own_geometry: bool,
    /// Number of times that the costly terms are recomputed before the last descent.
    pub(super) refreshes: u8,
    pub(super) way: Way,
    pub(super) pixels: &'a dyn Pixels,
}

/// Fits all pixels of a job; `Arch::new()` selects the widest instructions of the machine.
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

/// The pixel in a lane.
#[derive(Clone, Copy)]
struct Slot {
    pixel: usize,
    refreshes_left: u8,
    evaluations: u16,
    n_used: usize,
    /// Cost at the last accepted point, and the gain that was predicted there for an undamped step.
    cost: f64,
    gain: f64,
    /// Parameters at which the costly terms were computed.
    taken_at: Parameters,
}

struct Table<'a> {
    job: &'a Job<'a>,
    width: usize,
    state: Numbers,
    /// Weight, signal less offset, and B, the last two weighted: `[observation][these three][lane]`.
    rows: Numbers,
    /// `[observation][GEOMETRY][lane]`; empty if shared.
    geometry: Numbers,
    /// The signals of the pixel in each lane.
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

    /// Loads the next pixel with enough observations into a lane; pixels with fewer get their result at once. If none
    /// is left, the lane stays empty with weight 0.
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
                Way::Whole => FREE,
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
            self.refresh(lane, &start);
            self.begin_at(lane, &start);
            return;
        }
        for row in self.rows.chunks_exact_mut(self.width) {
            row[lane] = 0.0;
        }
        self.begin_at(lane, &[0.1, 0.0, -2.0, -2.0, 0.1]);
    }

    /// Computes the costly terms at `p`.
    fn refresh(&mut self, lane: usize, p: &Parameters) {
        let (job, width) = (self.job, self.width);
        let (offset, basis) = (&mut self.offset, &mut self.column);
        job.pixels.costly(p, job.way, &mut self.met, offset, basis);
        if job.own_geometry {
            for (j, (basis, centre)) in basis.iter_mut().zip(job.geometry).enumerate() {
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

    /// Returns the squared distance of the accepted point from another, in standard deviations.
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

    /// Decides, after a step was proposed, whether a lane continues, recomputes its costly terms, or ends.
    fn look(&mut self, lane: usize, fits: &mut [PixelFit]) {
        let Some(mut slot) = self.slots[lane] else {
            return;
        };
        slot.evaluations += 1;
        let cost = self.get(COST, lane);
        let lambda = self.get(LAMBDA, lane);
        // Upper bound of the gain of an undamped step.
        let gain = self.get(DECREMENT, lane) * (1.0 + lambda);
        // From step to step gains decrease at least as fast as last time, so the gain of the step after this one is
        // known without an evaluation.
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
        let trial = std::array::from_fn(|k| self.get(TRIAL + k, lane));
        if self.job.way == Way::There {
            let open = gain <= OPEN * (1.0 + cost);
            if open || stalled {
                fits[slot.pixel] = PixelFit {
                    p: if open { trial } else { self.parameters(lane) },
                    evaluations: f32::from(slot.evaluations),
                    end: End::Converged,
                    ..fits[slot.pixel]
                };
                self.refill(lane, fits);
            }
            return;
        }
        let is_stale =
            converged && slot.refreshes_left > 0 && self.moved2(lane, &slot.taken_at) > STALE2;
        if is_stale && !stalled {
            // At the next trial, so that no evaluation is lost; its cost cannot be compared with the last one.
            slot.refreshes_left -= 1;
            slot.cost = f64::INFINITY;
            slot.gain = 0.0;
            self.set(COST, lane, f64::INFINITY);
            self.slots[lane] = Some(slot);
            self.refresh(lane, &trial);
        } else if converged || stalled {
            let normal: [f64; PACKED] = std::array::from_fn(|k| self.get(NORMAL + k, lane));
            // The last step is taken without an evaluation.
            let (p, chi2) = if converged {
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
