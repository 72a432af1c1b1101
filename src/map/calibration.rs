//! Before the map: what all pixels share, the surfaces that represent most of them, and the usual χ².
//!
//! The fit of the pixels' mean gives the shared quantities (`shared`). With these, the means of the clusters of pixels
//! (`clusters`) are fitted in lanes; their surfaces are the starts of all pixels, decide the plan, and are those on which
//! double reflections are integrated.

pub(super) mod clusters;
pub(super) mod globals;
pub(super) mod mean_fit;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use super::double_reflection::{Integrated, distance};
use super::field_variation::Beside;
use super::higher_order_terms::{Costly, RealSurface};
use super::run::{Batch, Run, freedom};
use super::signals::view::View;
use super::solve::kernel::{FREE, Parameters, difference};
use super::solve::starts::{LEADERS_MAX, Starts};
use super::solve::{End, PixelFit};
use super::{MapError, Progress, Stage, plan};
use crate::geometry::Pose;
use crate::material::Material;
use crate::observation::ObservationSet;
use crate::plan::{ComputationPlan, Decision};
use crate::reduction::ReductionError;
use crate::robust;
use clusters::{clusters, means};
use globals::{Given, Globals, Which};
use mean_fit::{Mean, Shared};

/// Times that double reflections are integrated; the surfaces move little by the second time.
const PASSES: usize = 2;
/// Number of surfaces on which the need to integrate double reflections is evaluated.
const PROBED: usize = 2;
/// Distance, as a share of that up to which a surface's double reflections are used, below which two surfaces are one.
const ALIKE: f64 = 0.5;
/// Least decrease of χ², in usual χ² units, that makes a lobe significant.
pub(super) const LOBE_SIGNIFICANCE: f64 = 30.0;
/// Largest number of pixels that determine the shared quantities: their noise averages out to far below that of the references.
const ASKED_MAX: usize = 500;

/// The results, which the map needs for its pixels.
pub(super) struct GlobalCalibration {
    pub(super) globals: Globals,
    pub(super) costly: Costly,
    /// The surfaces of the clusters' means.
    pub(super) leaders: Starts,
    /// All shapes, by quarter turn.
    pub(super) quarters: Vec<Starts>,
    pub(super) matte: Starts,
    /// Usual χ² per degree of freedom, at least 1.
    pub(super) birge: f64,
    /// Median shift of each parameter by one standard uncertainty of all shared quantities.
    pub(super) shared_std: Option<Parameters>,
    /// The fit of the pixels' mean, or why there is none.
    pub(super) mean: Result<Mean, String>,
    /// Sampled pixels with a good fit.
    pub(super) sampled: usize,
    /// The view, with the centre's directions for all pixels if the plan decided so.
    pub(super) view: View,
    /// The plan, decided on the surfaces that represent most pixels.
    pub(super) plan: ComputationPlan,
    /// Error of using the centre's directions for light reflected between the facets, if camera or lamp are near and
    /// it is not corrected.
    pub(super) centre_for_all: Option<f64>,
    /// Off-centre changes.
    pub(super) beside: Option<Beside>,
}

/// Determines what the sampled pixels share. `mean` is their mean, or that of a region of them, as a reduction gives it.
pub(super) fn settle(
    batch: &Batch,
    view: &View,
    given: &Given<'_>,
    mean: Result<ObservationSet, ReductionError>,
    progress: &(dyn Fn(Progress) + Sync),
    cancel: &AtomicBool,
) -> Result<GlobalCalibration, MapError> {
    let step = |done: usize| {
        progress(Progress {
            stage: Stage::Settling,
            done,
            total: 3,
        });
        match cancel.load(Ordering::Relaxed) {
            true => Err(MapError::Cancelled),
            false => Ok(()),
        }
    };
    step(0)?;
    if (0..batch.pixels.len()).all(|index| batch.used(index) == 0) {
        return Err(MapError::NothingUsable);
    }
    if given.largest <= 0.0 {
        return Err(MapError::NothingSeen);
    }
    let mut at = Stand {
        given,
        real: &None,
        view: view.clone(),
        beside: None,
        integrated: Integrated::default(),
    };
    let first = Globals::first(given.largest);
    let lobed = lobed(&at.run(batch, &first, &at.costly(&first)));
    if lobed.is_empty() {
        return Err(MapError::NoLobes);
    }
    let clusters = clusters(batch, &lobed);
    let shared = Shared::new(batch, view, given, &mean?, &clusters, cancel);
    if given.white.is_none() && shared.mean.is_err() {
        return Err(MapError::NothingFitted {
            poses: given.recorded.len(),
            chi2: f64::INFINITY,
        });
    }
    step(1)?;

    let largest = &clusters[..clusters.len().min(LEADERS_MAX)];
    let means = means(batch, view, largest);
    at.real = &shared.real;
    let mut globals = shared.globals;
    let costly = at.costly(&globals);
    let amplitude = costly.is_amplitude();
    let quarters = Starts::quarters(amplitude, |p| costly.full(p));
    let all: Vec<usize> = (0..means.pixels.len()).collect();
    // A grid of ideal sawteeth may have no point from which a surface with deviations is reached: the mean's own fit has.
    let mean = shared.mean.as_ref().ok();
    let of_mean = mean
        .and_then(Mean::surface)
        .map(|surface| Starts::new(vec![surface], |p| costly.full(p)));
    let starts: Vec<Starts> = quarters.iter().cloned().chain(of_mean).collect();
    let found = at.run(&means, &globals, &costly).fit_from(&all, &starts);
    let mut found = Found::of(all.into_iter().zip(found).collect());

    let surfaces = distinct(&found.fits);
    let probed = &surfaces[..surfaces.len().min(PROBED)];
    let plan = plan::decide(&costly, view, probed, given.target_error);
    let included = |decision| plan.on(decision).is_none_or(|choice| choice.included);
    let own = included(Decision::PerPixelGeometry);
    let near = !view.is_telecentric();
    let centre_for_all = near.then(|| plan::centre_for_all(&costly, view, probed));
    at.view = view.clone().with_own_directions(own);
    if near && own {
        at.beside = Beside::new(&costly, &at.view, probed);
    }
    if included(Decision::Bounces) {
        for _ in 0..PASSES {
            at.integrated = Integrated::at(distinct(&found.fits), amplitude, |p| {
                costly.lacking(p, shared.polarised)
            });
            found.fits = at.fit_on(&means, &globals, &found);
        }
    }
    step(2)?;

    let leaders = distinct(&found.fits);
    let usual = |globals: &Globals| -> Result<(Found, f64), MapError> {
        let costly = at.costly(globals);
        let run = at.run(batch, globals, &costly);
        let leaders = Starts::new(leaders.clone(), |p| costly.full(p));
        usual(&run, &lobed, &leaders)
    };
    let (good, birge) = usual(&globals)?;
    let mean = shared.mean.as_ref().ok();
    let is_tilt_known = mean.is_some_and(|mean| mean.tilt_offset_deg.is_some());
    at.refine(batch, &mut globals, &good, birge, is_tilt_known);
    let (good, birge) = usual(&globals)?;
    let costly = at.costly(&globals);
    Ok(GlobalCalibration {
        matte: Starts::matte(costly.geometry()),
        leaders: Starts::new(leaders, |p| costly.full(p)),
        quarters,
        shared_std: at.shared_std(batch, &globals, &good),
        globals,
        mean: shared.mean,
        birge,
        sampled: good.fits.len(),
        plan: plan::with_polarisation(plan, shared.polarised),
        centre_for_all,
        beside: at.beside,
        costly,
        view: at.view,
    })
}

/// Pixels with their converged fits.
struct Found {
    pixels: Vec<usize>,
    fits: Vec<PixelFit>,
}

impl Found {
    fn of(all: Vec<(usize, PixelFit)>) -> Self {
        let converged = all.into_iter().filter(|(_, fit)| fit.end == End::Converged);
        let (pixels, fits) = converged.unzip();
        Found { pixels, fits }
    }

    /// Returns some of them, spread over all.
    fn some(&self) -> Found {
        let step = self.fits.len().div_ceil(ASKED_MAX).max(1);
        let pixels = self.pixels.iter().step_by(step).copied();
        let fits = self.fits.iter().step_by(step).copied();
        Found {
            pixels: pixels.collect(),
            fits: fits.collect(),
        }
    }
}

/// All that a fit of pixels needs besides the pixels and the shared quantities.
struct Stand<'a> {
    given: &'a Given<'a>,
    real: &'a Option<Arc<RealSurface>>,
    view: View,
    beside: Option<Beside>,
    integrated: Integrated,
}

impl Stand<'_> {
    /// Returns the costly terms at the recorded poses with the tilt offset added.
    fn costly(&self, globals: &Globals) -> Costly {
        let shifted = self.given.recorded.iter().map(|pose| Pose {
            theta_c: pose.theta_c + globals.tilt_offset,
            ..*pose
        });
        let poses: Vec<Pose> = shifted.collect();
        let geometry = poses.iter().map(|pose| self.view.central(*pose)).collect();
        let Given { rig, material, .. } = *self.given;
        Costly::new(rig, *material, poses, geometry, self.integrated.clone())
            .with_real(self.real.clone())
    }

    fn run<'r>(&'r self, batch: &'r Batch, globals: &'r Globals, costly: &'r Costly) -> Run<'r> {
        Run {
            batch,
            globals,
            costly,
            view: &self.view,
            beside: self.beside.as_ref(),
        }
    }

    /// Continues fits with other shared quantities or costly terms.
    fn fit_on(&self, batch: &Batch, globals: &Globals, found: &Found) -> Vec<PixelFit> {
        let costly = self.costly(globals);
        let starts: Vec<Parameters> = found.fits.iter().map(|fit| fit.p).collect();
        let run = self.run(batch, globals, &costly);
        run.fit(&found.pixels, &starts, 1)
    }

    /// Moves the shared quantities that the pixels determine better than the references and the fit of the mean, whose values
    /// are the priors: the tilt offset, the gain without a white reference, and on metal, which has no diffuse light, the
    /// stray light. Along each, χ² over the pixels, all fitted again, is a parabola.
    fn refine(
        &self,
        batch: &Batch,
        globals: &mut Globals,
        good: &Found,
        birge: f64,
        is_tilt_known: bool,
    ) {
        let second = match (self.given.material, self.given.white) {
            // A metal pixel has an amplitude of its own, which is indistinguishable from the gain.
            (Material::Conductor { .. }, _) => Some(Which::Stray),
            (_, None) => Some(Which::Gain),
            _ => None,
        };
        let asked = good.some();
        let prior = *globals;
        // A tilt offset that the poses do not determine stays as recorded.
        let first = Some(Which::Tilt).filter(|_| is_tilt_known);
        for which in [first, second, first, second].into_iter().flatten() {
            let ((value, std), (mean, least)) = (globals.get(which), prior.get(which));
            let step = least.min(3.0 * std);
            let chi2 = |by: f64| -> f64 {
                let moved = globals.with(which, (value + by * step, std));
                let fits = self.fit_on(batch, &moved.with_flats(self.given), &asked);
                let each = fits.iter().map(|fit| fit.chi2).filter(|x| x.is_finite());
                each.sum::<f64>() + birge * ((value + by * step - mean) / least).powi(2)
            };
            let [below, here, above] = [-1.0, 0.0, 1.0].map(chi2);
            let least_bend = 2.0 * birge * (step / least).powi(2);
            let bend = (above + below - 2.0 * here).max(least_bend);
            let by = (0.5 * (below - above) / bend).clamp(-3.0, 3.0);
            let std = step * (2.0 * birge / bend).sqrt();
            let moved = globals.with(which, (value + by * step, std));
            *globals = moved.with_flats(self.given);
        }
    }

    /// Returns the median shift of a pixel's parameters by one standard uncertainty of every shared quantity.
    fn shared_std(&self, batch: &Batch, globals: &Globals, good: &Found) -> Option<Parameters> {
        let asked = good.some();
        let here = self.fit_on(batch, globals, &asked);
        let mut sum = [0.0; FREE];
        for which in [Which::Gain, Which::Stray, Which::Tilt] {
            let (value, std) = globals.get(which);
            let moved = globals.with(which, (value + std, std));
            let there = self.fit_on(batch, &moved, &asked);
            for (k, sum) in sum.iter_mut().enumerate() {
                let pairs = there.iter().zip(&here);
                let apart = pairs.map(|(a, b)| difference(&a.p, &b.p)[k].abs());
                *sum += robust::median_of_finite(apart)?.powi(2);
            }
        }
        Some(sum.map(f64::sqrt))
    }
}

/// Returns the surfaces of converged fits without those that are nearly equal to an earlier one.
fn distinct(fits: &[PixelFit]) -> Vec<Parameters> {
    let mut found: Vec<Parameters> = Vec::new();
    for fit in fits.iter().filter(|fit| fit.end == End::Converged) {
        if found.iter().all(|p| distance(p, &fit.p) > ALIKE) {
            found.push(fit.p);
        }
    }
    found
}

/// Returns the pixels that show a lobe, which excludes the mount.
fn lobed(run: &Run<'_>) -> Vec<usize> {
    let matte = Starts::matte(run.costly.geometry());
    let n = run.batch.observations;
    let (mut signal, mut weight) = (vec![0.0; n], vec![0.0; n]);
    let shows = |index: &usize| {
        let used = run.batch.used(*index);
        run.read(*index, &mut signal, &mut weight);
        let least = used as f64 - 1.0 + LOBE_SIGNIFICANCE;
        let best = matte.best(&signal, &weight);
        used > FREE && best.is_some_and(|(_, chi2)| chi2 > least)
    };
    (0..run.batch.pixels.len()).filter(shows).collect()
}

/// Fits the chosen pixels from the best leader of each; returns the usual ones and their χ² per degree of freedom.
fn usual(run: &Run<'_>, chosen: &[usize], leaders: &Starts) -> Result<(Found, f64), MapError> {
    let fits = run.fit_from(chosen, std::slice::from_ref(leaders));
    let reduced = |fit: &PixelFit| fit.chi2 / freedom(fit);
    let left = robust::median_of_finite(fits.iter().map(reduced));
    let mut all: Vec<(usize, PixelFit)> = chosen.iter().copied().zip(fits).collect();
    all.retain(|(_, fit)| fit.end == End::Converged && fit.is_identifiable(1.0));
    // There are lobes, but these poses do not determine their parameters.
    let birge = robust::median_of_finite(all.iter().map(|(_, fit)| reduced(fit)))
        .ok_or(MapError::NothingFitted {
            poses: run.batch.observations,
            chi2: left.unwrap_or(f64::INFINITY),
        })?
        .max(1.0);
    // Pixels that straddle two surfaces would bias the shared quantities.
    all.retain(|(_, fit)| reduced(fit) < 2.5 * birge);
    Ok((Found::of(all), birge))
}
