//! The solver applied to some pixels, with the shared quantities removed from their signals.

use std::borrow::Cow;

use super::calibration::globals::Globals;
use super::field_variation::Beside;
use super::higher_order_terms::{Costly, Met, Way};
use super::signals::planes::Planes;
use super::signals::view::View;
use super::solve::kernel::{FREE, Geometry, Parameters};
use super::solve::starts::Starts;
use super::solve::{End, Job, PixelFit, Pixels, solve_on};
use crate::robust::reduced_chi2_at;

/// Signals of some pixels, pixel by pixel.
pub(super) struct Batch {
    pub(super) observations: usize,
    /// Map pixels.
    pub(super) pixels: Vec<usize>,
    /// `[pixel][observation]`; σ is 0 where masked.
    signal: Vec<f32>,
    sigma: Vec<f32>,
}

impl Batch {
    /// Reads some pixels of one tile; `kept` selects them by their index in the tile.
    pub(super) fn of_tile(
        planes: &Planes,
        tile: usize,
        kept: impl Fn(usize) -> bool,
    ) -> std::io::Result<Batch> {
        let data = planes.get(tile)?;
        let range = planes.range(tile);
        let (poses, length) = (planes.poses(), range.len());
        let chosen: Vec<usize> = (0..length).filter(|i| kept(*i)).collect();
        let mut signal = Vec::with_capacity(chosen.len() * poses);
        let mut sigma = Vec::with_capacity(chosen.len() * poses);
        for i in &chosen {
            for pose in 0..poses {
                let at = (pose * length + i) * 2;
                signal.push(data[at]);
                sigma.push(data[at + 1]);
            }
        }
        Ok(Batch {
            observations: poses,
            pixels: chosen.iter().map(|i| range.start + i).collect(),
            signal,
            sigma,
        })
    }

    /// Joins the pixels of several batches.
    pub(super) fn join(batches: Vec<Batch>) -> Batch {
        let mut joined = Batch {
            observations: batches.first().map_or(0, |b| b.observations),
            pixels: Vec::new(),
            signal: Vec::new(),
            sigma: Vec::new(),
        };
        for batch in batches {
            joined.pixels.extend(batch.pixels);
            joined.signal.extend(batch.signal);
            joined.sigma.extend(batch.sigma);
        }
        joined
    }

    /// Takes pixels from the caller, numbered from 0; slices are `[pixel][observation]`.
    pub(super) fn of_slices(observations: usize, signal: Vec<f32>, sigma: Vec<f32>) -> Batch {
        assert_eq!(
            signal.len(),
            sigma.len(),
            "every signal needs an uncertainty"
        );
        assert_eq!(signal.len() % observations, 0, "pixels must be complete");
        Batch {
            observations,
            pixels: (0..signal.len() / observations).collect(),
            signal,
            sigma,
        }
    }

    /// Returns signal and σ of a pixel's observations; σ is 0 where masked.
    pub(super) fn observed(&self, index: usize) -> impl Iterator<Item = (f64, f64)> {
        let all = index * self.observations..(index + 1) * self.observations;
        let pairs = self.signal[all.clone()].iter().zip(&self.sigma[all]);
        pairs.map(|(y, s)| (f64::from(*y), f64::from(*s)))
    }

    /// Returns the number of a pixel's observations that are not masked.
    pub(super) fn used(&self, index: usize) -> usize {
        let n = self.observations;
        self.sigma[index * n..(index + 1) * n]
            .iter()
            .filter(|s| **s > 0.0)
            .count()
    }

    /// Returns the largest signal above its noise, as a high quantile to exclude spikes.
    pub(super) fn largest(&self) -> f64 {
        let mut clear: Vec<f32> = self
            .signal
            .iter()
            .zip(&self.sigma)
            .filter(|(y, s)| **s > 0.0 && **y > 3.0 * **s)
            .map(|(y, _)| *y)
            .collect();
        if clear.is_empty() {
            return 0.0;
        }
        let at = clear.len() * 995 / 1000;
        let (_, x, _) = clear.select_nth_unstable_by(at, f32::total_cmp);
        f64::from(*x)
    }
}

/// All inputs for the fit of any pixel.
pub(super) struct Run<'a> {
    pub(super) batch: &'a Batch,
    pub(super) globals: &'a Globals,
    pub(super) costly: &'a Costly,
    pub(super) view: &'a View,
    /// Off-centre changes of a near field, once they are known.
    pub(super) beside: Option<&'a Beside>,
}

impl Run<'_> {
    /// Writes a pixel's radiances for the irradiance at the field's centre, and its weights (1/σ, 0 where masked).
    pub(super) fn read(&self, index: usize, signal: &mut [f64], weight: &mut [f64]) {
        let n = self.batch.observations;
        let all = index * n..(index + 1) * n;
        for (signal, recorded) in signal.iter_mut().zip(&self.batch.signal[all.clone()]) {
            *signal = self.radiance(*recorded);
        }
        for (weight, sigma) in weight.iter_mut().zip(&self.batch.sigma[all]) {
            *weight = self.weight(*sigma);
        }
        if self.view.is_unevenly_lit() {
            for (j, (signal, weight)) in signal.iter_mut().zip(weight).enumerate() {
                let irradiance = self.irradiance(index, j);
                *signal /= irradiance;
                *weight *= irradiance;
            }
        }
    }

    /// Subtracts the off-centre change of a pixel like `p` from its signals. `picked` lists the observations in
    /// `signal`; `None` means all.
    pub(super) fn bring_to_centre(
        &self,
        index: usize,
        p: &Parameters,
        picked: Option<&[usize]>,
        signal: &mut [f64],
    ) {
        if let Some(beside) = self.beside {
            let more = beside.at(p, self.view.place_mm(self.batch.pixels[index]));
            for (at, signal) in signal.iter_mut().enumerate() {
                *signal -= more(picked.map_or(at, |picked| picked[at]));
            }
        }
    }

    /// Returns the irradiance on a pixel in its observation `j`, relative to the field's centre.
    fn irradiance(&self, index: usize, j: usize) -> f64 {
        let place = self.view.place_mm(self.batch.pixels[index]);
        self.view.irradiance(self.costly.poses()[j], place)
    }

    #[inline(always)]
    fn radiance(&self, signal: f32) -> f64 {
        f64::from(signal) * (1.0 / self.globals.gain) - self.globals.stray
    }

    /// Returns 1/σ of a radiance, in the single precision of σ itself; 0 if masked.
    #[inline(always)]
    fn weight(&self, sigma: f32) -> f64 {
        f64::from(if sigma > 0.0 {
            self.globals.gain as f32 / sigma
        } else {
            0.0
        })
    }

    /// Returns radiance and weight of a pixel's observation `j`.
    fn observation(&self, index: usize, j: usize) -> (f64, f64) {
        let at = index * self.batch.observations + j;
        let signal = self.radiance(self.batch.signal[at]);
        let weight = self.weight(self.batch.sigma[at]);
        if !self.view.is_unevenly_lit() {
            return (signal, weight);
        }
        let irradiance = self.irradiance(index, j);
        (signal / irradiance, weight * irradiance)
    }

    /// Returns a pixel's geometry: shared, or its own if camera or lamp are near.
    pub(super) fn geometry_of(&self, index: usize) -> Cow<'_, [Geometry]> {
        if self.view.shares_directions() {
            return Cow::Borrowed(self.costly.geometry());
        }
        let place = self.view.place_mm(self.batch.pixels[index]);
        Cow::Owned(
            self.costly
                .poses()
                .iter()
                .map(|pose| self.view.geometry(*pose, place))
                .collect(),
        )
    }

    /// Fits the chosen pixels of the batch from given starts.
    pub(super) fn fit(
        &self,
        chosen: &[usize],
        starts: &[Parameters],
        refreshes: u8,
    ) -> Vec<PixelFit> {
        self.fit_on(pulp::Arch::new(), chosen, starts, refreshes)
    }

    /// As [`Run::fit`], with the given instructions.
    ///
    /// If there are many observations, a subset of them is used far from the minimum, where less precision is needed.
    pub(super) fn fit_on(
        &self,
        arch: pulp::Arch,
        chosen: &[usize],
        starts: &[Parameters],
        refreshes: u8,
    ) -> Vec<PixelFit> {
        let few = self.costly.few();
        let walk = |way: Way, starts: &[Parameters]| {
            let (observations, geometry) = match way {
                Way::There => (few.len(), self.costly.few_geometry()),
                Way::Whole => (self.batch.observations, self.costly.geometry()),
            };
            let pixels = Chosen {
                run: self,
                chosen,
                starts,
                picked: (way == Way::There).then_some(few),
            };
            let job = Job {
                observations,
                lamp: self.costly.lamp(),
                amplitude: self.costly.is_amplitude(),
                geometry,
                own_geometry: !self.view.shares_directions(),
                refreshes,
                way,
                pixels: &pixels,
            };
            solve_on(arch, &job)
        };
        if few.is_empty() {
            return walk(Way::Whole, starts);
        }
        let there = walk(Way::There, starts);
        let near: Vec<Parameters> = there
            .iter()
            .zip(starts)
            .map(|(fit, start)| match fit.end {
                End::Converged | End::Stalled => fit.p,
                End::TooFew => *start,
            })
            .collect();
        let mut fits = walk(Way::Whole, &near);
        let share = few.len() as f32 / self.batch.observations as f32;
        for (fit, there) in fits.iter_mut().zip(&there) {
            fit.evaluations += share * there.evaluations;
        }
        fits
    }

    /// Fits the chosen pixels from their best start of every set; returns the fits with the lowest χ².
    pub(super) fn fit_from(&self, chosen: &[usize], sets: &[Starts]) -> Vec<PixelFit> {
        let n = self.batch.observations;
        let (mut signal, mut weight) = (vec![0.0; n], vec![0.0; n]);
        let mut best: Vec<PixelFit> = Vec::new();
        for set in sets {
            let starts = chosen.iter().filter_map(|index| {
                self.read(*index, &mut signal, &mut weight);
                set.best(&signal, &weight).map(|(start, _)| start)
            });
            let starts: Vec<Parameters> = starts.collect();
            if starts.len() < chosen.len() {
                continue;
            }
            let fits = self.fit(chosen, &starts, super::REFRESHES);
            if best.is_empty() {
                best = fits;
                continue;
            }
            for (best, fit) in best.iter_mut().zip(fits) {
                if better(&fit, best) {
                    *best = fit;
                }
            }
        }
        best
    }
}

/// Whether fit `a` is better than fit `b`.
pub(super) fn better(a: &PixelFit, b: &PixelFit) -> bool {
    match (a.end, b.end) {
        (End::Converged, End::Converged) => a.chi2 < b.chi2,
        (End::Converged, _) => true,
        (_, End::Converged) => false,
        _ => a.chi2 < b.chi2 || !b.chi2.is_finite(),
    }
}

struct Chosen<'a> {
    run: &'a Run<'a>,
    chosen: &'a [usize],
    starts: &'a [Parameters],
    /// Observations used; `None` means all.
    picked: Option<&'a [usize]>,
}

impl Pixels for Chosen<'_> {
    fn count(&self) -> usize {
        self.chosen.len()
    }

    fn load(
        &self,
        pixel: usize,
        signal: &mut [f64],
        weight: &mut [f64],
        geometry: &mut [Geometry],
    ) -> Parameters {
        let index = self.chosen[pixel];
        let start = self.starts[pixel];
        match self.picked {
            None => {
                self.run.read(index, signal, weight);
                if !geometry.is_empty() {
                    geometry.copy_from_slice(&self.run.geometry_of(index));
                }
            }
            Some(picked) => {
                for (at, j) in picked.iter().enumerate() {
                    (signal[at], weight[at]) = self.run.observation(index, *j);
                }
                if !geometry.is_empty() {
                    let all = self.run.geometry_of(index);
                    for (geometry, j) in geometry.iter_mut().zip(picked) {
                        *geometry = all[*j];
                    }
                }
            }
        }
        self.run.bring_to_centre(index, &start, self.picked, signal);
        start
    }

    fn costly(
        &self,
        p: &Parameters,
        way: Way,
        met: &mut Met,
        offset: &mut [f64],
        basis: &mut [f64],
    ) {
        self.run.costly.write(p, way, met, offset, basis);
    }
}

/// Returns the degrees of freedom of a pixel's fit; at least 1.
pub(super) fn freedom(fit: &PixelFit) -> f64 {
    (fit.n_used as f64 - FREE as f64).max(1.0)
}

/// Returns the χ² per degree of freedom that good data exceed once in 300,000 (the normal quantile 4.5).
pub(super) fn usual_chi2_max(freedom: f64) -> f64 {
    reduced_chi2_at(freedom, 4.5)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_limit_of_chi2_is_its_far_quantile() {
        // The normal distribution has a tail of 3.4e-6 beyond 4.5; the approximation is good to a factor of 2.
        use statrs::distribution::{ChiSquared, ContinuousCDF};
        for freedom in [5.0, 19.0, 103.0] {
            let tail = ChiSquared::new(freedom)
                .unwrap()
                .sf(freedom * usual_chi2_max(freedom));
            assert!(tail > 1e-6 && tail < 1e-5, "{freedom}: {tail:e}");
        }
    }
}
