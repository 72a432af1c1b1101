//! Before the map: a sample of pixels determines what all pixels share, the starts of the descents, and the usual χ².

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use super::beside::Beside;
use super::costly::{Costly, RealSurface};
use super::globals::Globals;
use super::globals::step::{Second, shared_std};
use super::integrated::Integrated;
use super::kernel::{FREE, Parameters, packed};
use super::misfit::shared_misfit;
use super::run::{Batch, Run, freedom};
use super::solve::{End, PixelFit};
use super::start::{Leaders, Templates, lambert};
use super::view::View;
use super::{MapError, Progress, Stage, plan};
use crate::geometry::Pose;
use crate::material::Material;
use crate::observation::{FlatObservation, WhiteReference};
use crate::plan::{ComputationPlan, Decision};
use crate::robust;

/// Rounds that alternate between tilt offset, gain and fits.
const ROUNDS: usize = 6;
/// Number of passes through the rounds; before each but the first, double reflections are integrated again.
const PASSES: usize = 3;
/// A search is outdated if the usual χ² has fallen to this share of its value after that search.
const OUTDATED: f64 = 0.9;
/// Number of surfaces on which the need to integrate double reflections is evaluated.
const PROBED: usize = 2;
/// Least decrease of χ², in usual χ² units, that makes a lobe significant.
pub(super) const LOBE_SIGNIFICANCE: f64 = 30.0;
/// Largest standard uncertainties of determined parameters: θr 2°, ln α 0.3.
const THETA_R_STD_MAX_RAD: f64 = 0.035;
const LN_ALPHA_STD_MAX: f64 = 0.3;
/// Largest coarseness of cells; it is the typical uncertainty over the cell width, at least 1.
const COARSENESS_MAX: f64 = 3.0;

/// The results, which the map needs for its pixels.
pub(super) struct Settled {
    pub(super) globals: Globals,
    pub(super) poses: Vec<Pose>,
    pub(super) costly: Costly,
    pub(super) leaders: Leaders,
    pub(super) templates: Templates,
    /// Lambert's term per observation.
    pub(super) lambert: Vec<f64>,
    /// Usual χ² per degree of freedom, at least 1.
    pub(super) birge: f64,
    /// Median shift of each parameter by one standard uncertainty of all shared quantities and of the model error.
    pub(super) shared_std: Option<Parameters>,
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

/// The observations of the camera's references.
pub(super) struct References<'a> {
    pub(super) flats: &'a [FlatObservation],
    pub(super) white: Option<WhiteReference>,
}

/// Inputs that are known beforehand.
pub(super) struct Given<'a> {
    pub(super) material: &'a Material,
    pub(super) recorded: &'a [Pose],
    pub(super) references: &'a References<'a>,
    /// Share of the brightest radiance that may be omitted.
    pub(super) target_error: Option<f64>,
    /// The sample's deviations from an ideal sawtooth.
    pub(super) real: Option<Arc<RealSurface>>,
}

/// Whether a fit determines all parameters.
pub(super) fn identifiable(fit: &PixelFit, birge: f64) -> bool {
    let Some(covariance) = &fit.covariance else {
        return false;
    };
    let std = |k: usize| (birge * covariance[packed(k, k)]).sqrt();
    std(0) < THETA_R_STD_MAX_RAD && std(2) < LN_ALPHA_STD_MAX && std(3) < LN_ALPHA_STD_MAX
}

/// Determines tilt offset, gain and the fits of sampled pixels in turn; first with the closed form only, then with
/// double reflections integrated on the surfaces that were found.
pub(super) fn settle(
    batch: &Batch,
    view: &View,
    given: &Given<'_>,
    progress: &(dyn Fn(Progress) + Sync),
    cancel: &AtomicBool,
) -> Result<Settled, MapError> {
    let mut settling = Settling::new(batch, view, given)?;
    let lobed = settling.lobed()?;
    let (mut passes_left, mut rounds_left) = (PASSES, ROUNDS);
    // The usual χ² after the last search.
    let mut searched = f64::INFINITY;
    for round in 0..ROUNDS * PASSES {
        if cancel.load(Ordering::Relaxed) {
            return Err(MapError::Cancelled);
        }
        progress(Progress {
            stage: Stage::Settling,
            done: round,
            total: ROUNDS * PASSES,
        });
        // The first round searches from every template; in later rounds the fits continue. Which minimum of a pixel
        // is the deepest depends on the shared quantities, so a pass searches again if these now explain the pixels
        // better.
        let searching = rounds_left == ROUNDS && settling.birge < OUTDATED * searched;
        let fits = match searching || settling.good.is_empty() {
            true => settling.search(&lobed),
            false => settling.follow(),
        };
        settling.keep_the_usual(fits)?;
        if searching {
            searched = settling.birge;
        }
        let step = settling.step();
        rounds_left -= 1;
        let settled = rounds_left + 1 < ROUNDS && step[0].abs() < 2e-5 && step[1].abs() < 1e-4;
        if settled || rounds_left == 0 {
            passes_left -= 1;
            if passes_left == 0 {
                break;
            }
            if !settling.integrate() {
                // Another pass is useful only for a new search.
                if settling.birge >= OUTDATED * searched {
                    break;
                }
                passes_left = 1;
            }
            rounds_left = ROUNDS;
        }
    }
    Ok(settling.finish())
}

/// The state of the iteration.
struct Settling<'a> {
    batch: &'a Batch,
    given: &'a Given<'a>,
    /// Positions of camera and lamp.
    stand: &'a View,
    /// The same view; the plan may change which directions pixels use.
    view: View,
    /// Whether a pixel has an amplitude of its own, as on metal.
    amplitude: bool,
    /// Largest signal of the sampled pixels.
    largest: f64,
    /// The shared quantities before the first round.
    first: Globals,
    globals: Globals,
    poses: Vec<Pose>,
    integrated: Integrated,
    costly: Costly,
    birge: f64,
    /// Sampled pixels with a usual fit, by their index in the batch.
    good: Vec<(usize, PixelFit)>,
    /// The plan, and the error of using the centre's directions.
    decided: Option<(ComputationPlan, Option<f64>)>,
    beside: Option<Beside>,
    polarised: bool,
}

impl<'a> Settling<'a> {
    fn new(batch: &'a Batch, view: &'a View, given: &'a Given<'a>) -> Result<Self, MapError> {
        if (0..batch.pixels.len()).all(|index| batch.used(index) == 0) {
            return Err(MapError::NothingUsable);
        }
        let largest = batch.largest();
        if largest <= 0.0 {
            return Err(MapError::NothingSeen);
        }
        let first = Globals::first(1.0, largest);
        let poses = poses_at(&first, given.recorded);
        let integrated = Integrated::default();
        let costly =
            costly_at(view, given.material, &poses, 1.0, &integrated).with_real(given.real.clone());
        let mut settling = Settling {
            batch,
            given,
            stand: view,
            view: view.clone(),
            amplitude: View::fits_amplitude(given.material),
            largest,
            first,
            globals: first,
            poses,
            integrated,
            costly,
            birge: 1.0,
            good: Vec::new(),
            decided: None,
            beside: None,
            polarised: true,
        };
        if settling.is_relative() {
            let gain = settling.first_gain().ok_or(MapError::NoLobes)?;
            settling.first = Globals::first(gain, largest);
        }
        settling.globals = settling.with_flats(settling.first);
        Ok(settling)
    }

    /// Whether there is no white reference.
    fn is_relative(&self) -> bool {
        self.given.references.white.is_none()
    }

    fn with_flats(&self, globals: Globals) -> Globals {
        let references = self.given.references;
        match &references.white {
            Some(white) => globals.with_flats(
                references.flats,
                white,
                &self.stand.imaging.rig,
                self.largest,
            ),
            None => globals,
        }
    }

    fn run(&self) -> Run<'_> {
        self.run_with(&self.costly)
    }

    fn run_with<'b>(&'b self, costly: &'b Costly) -> Run<'b> {
        Run {
            batch: self.batch,
            globals: &self.globals,
            costly,
            view: &self.view,
            poses: &self.poses,
            beside: self.beside.as_ref(),
        }
    }

    fn costly_with(&self, coarseness: f64, integrated: &Integrated) -> Costly {
        let material = self.given.material;
        costly_at(self.stand, material, &self.poses, coarseness, integrated)
            .with_real(self.given.real.clone())
    }

    fn templates(&self) -> Templates {
        Templates::new(self.costly.geometry(), self.costly.lamp(), self.amplitude)
    }

    /// Returns the sampled pixels with more observations than unknowns.
    fn enough(&self) -> impl Iterator<Item = usize> {
        (0..self.batch.pixels.len()).filter(|index| self.batch.used(*index) > FREE)
    }

    /// Returns the median amplitude of the best template over the pixels, for data without a white reference.
    fn first_gain(&self) -> Option<f64> {
        let (run, templates) = (self.run(), self.templates());
        let n = self.batch.observations;
        let (mut signal, mut weight) = (vec![0.0; n], vec![0.0; n]);
        robust::median_of_finite(self.enough().filter_map(|index| {
            run.read(index, &mut signal, &mut weight);
            templates.amplitude_of(&signal, &weight)
        }))
    }

    /// Returns the pixels that show a lobe, which excludes the mount.
    fn lobed(&self) -> Result<Vec<usize>, MapError> {
        let (run, lambert) = (self.run(), lambert(self.costly.geometry()));
        let shows = |index: &usize| {
            let dof = self.batch.used(*index) as f64 - 1.0;
            run.lambert_chi2(*index, &lambert) > dof + LOBE_SIGNIFICANCE
        };
        let lobed: Vec<usize> = self.enough().filter(shows).collect();
        match lobed.is_empty() {
            true => Err(MapError::NoLobes),
            false => Ok(lobed),
        }
    }

    /// Fits these pixels from every template.
    fn search(&self, lobed: &[usize]) -> Vec<(usize, PixelFit)> {
        let run = self.run();
        let mut fits = run.fit_from_templates(lobed, &self.templates());
        run.follow_the_best(lobed, &mut fits);
        lobed.iter().copied().zip(fits).collect()
    }

    /// Fits the good pixels from their present parameters.
    fn follow(&self) -> Vec<(usize, PixelFit)> {
        let chosen: Vec<usize> = self.good.iter().map(|(index, _)| *index).collect();
        let fits = self.run().fit(&chosen, &self.found(), 1);
        chosen.into_iter().zip(fits).collect()
    }

    /// Returns the parameters of the good pixels.
    fn found(&self) -> Vec<Parameters> {
        self.good.iter().map(|(_, fit)| fit.p).collect()
    }

    /// Sets the usual χ² of these fits, and keeps the fits near it.
    fn keep_the_usual(&mut self, fits: Vec<(usize, PixelFit)>) -> Result<(), MapError> {
        let reduced = |(_, fit): &(usize, PixelFit)| fit.chi2 / freedom(fit);
        let left = robust::median_of_finite(fits.iter().map(reduced));
        let converged: Vec<(usize, PixelFit)> = fits
            .into_iter()
            .filter(|(_, fit)| fit.end == End::Converged && identifiable(fit, 1.0))
            .collect();
        // There are lobes, but these poses do not determine their parameters.
        self.birge = robust::median_of_finite(converged.iter().map(reduced))
            .ok_or(MapError::NothingFitted {
                poses: self.given.recorded.len(),
                chi2: left.unwrap_or(f64::INFINITY),
            })?
            .max(1.0);
        // Pixels that straddle two surfaces would bias the shared quantities, so only the usual ones are used.
        self.good = converged
            .into_iter()
            .filter(|one| reduced(one) < 2.5 * self.birge)
            .collect();
        Ok(())
    }

    /// Moves the shared quantities towards the good fits; returns the step.
    fn step(&mut self) -> [f64; 2] {
        let prior = match self.is_relative() {
            true => self.first,
            false => self.with_flats(self.globals),
        };
        let second = match (self.amplitude, self.is_relative()) {
            // A metal pixel has an amplitude of its own, which is indistinguishable from the gain.
            (true, _) => Second::Stray {
                prior: prior.stray,
                prior_std: prior.stray_std,
            },
            (false, true) => Second::Gain,
            (false, false) => Second::Nothing,
        };
        let mut next = self.globals;
        let step = next.step(&self.run(), &self.good, self.birge, second);
        self.globals = self.with_flats(next);
        if self.amplitude {
            self.globals.stray = next.stray;
            self.globals.stray_std = next.stray_std;
        }
        self.poses = poses_at(&self.globals, self.given.recorded);
        self.costly = self.costly_with(1.0, &self.integrated);
        step
    }

    /// Integrates double reflections on the surfaces that represent most pixels; returns false if the plan omits them.
    fn integrate(&mut self) -> bool {
        let found = self.found();
        let centres = Leaders::gather(&found).centres(&found);
        // The first centres are those of the largest groups.
        if self.decided.is_none() && !self.decide(&centres[..centres.len().min(PROBED)]) {
            return false;
        }
        let at = |polarised: bool| {
            Integrated::at(centres.clone(), self.amplitude, |p| {
                self.costly.lacking(p, polarised)
            })
        };
        let mut integrated = at(true);
        if !self.amplitude {
            // In nature the first facet polarises the light that reaches the second one; many renderers omit that on
            // plastic. The χ² of the pixels decides.
            let without = at(false);
            let misses = |integrated: &Integrated| {
                let costly = self.costly_with(1.0, integrated);
                self.run_with(&costly).misses(&self.good)
            };
            let polarised = misses(&integrated) <= misses(&without);
            if !polarised {
                integrated = without;
            }
            self.polarised = polarised;
        }
        self.integrated = integrated;
        self.costly = self.costly_with(1.0, &self.integrated);
        true
    }

    /// Decides which terms are omitted, on some surfaces; returns whether double reflections are integrated.
    fn decide(&mut self, surfaces: &[Parameters]) -> bool {
        let plan = plan::decide(&self.costly, &self.view, surfaces, self.given.target_error);
        let near = !self.view.is_telecentric();
        let cost = near.then(|| plan::centre_for_all(&self.costly, &self.view, surfaces));
        let included = |decision| plan.on(decision).is_none_or(|choice| choice.included);
        let integrate = included(Decision::Bounces);
        let own = included(Decision::PerPixelGeometry);
        self.view = self.view.clone().with_own_directions(own);
        if near && own {
            self.beside = Beside::new(&self.costly, &self.view, surfaces);
        }
        self.decided = Some((plan, cost));
        integrate
    }

    fn finish(mut self) -> Settled {
        self.costly = self.costly_with(self.coarseness(), &self.integrated);
        let found = self.found();
        let mut leaders = Leaders::gather(&found);
        leaders.points = leaders.centres(&found);
        leaders.predict(|p| self.costly.full(p));
        let shared_std = self.shared_std();
        let templates = self.templates();
        let lambert = lambert(self.costly.geometry());
        let target_error = self.given.target_error;
        let (plan, centre_for_all) = self.decided.unwrap_or_else(|| {
            let plan = plan::decide(&self.costly, &self.view, &[], target_error);
            (plan, None)
        });
        Settled {
            sampled: self.good.len(),
            globals: self.globals,
            poses: self.poses,
            costly: self.costly,
            leaders,
            templates,
            lambert,
            birge: self.birge,
            shared_std,
            view: self.view,
            plan: plan::with_polarisation(plan, self.polarised),
            centre_for_all,
            beside: self.beside,
        }
    }

    /// Returns the coarseness that the cells of the costly terms may have: proportional to the fits' uncertainty.
    fn coarseness(&self) -> f64 {
        let of_cells = self.good.iter().filter_map(|(_, f)| {
            let covariance = f.covariance.as_ref()?;
            Some(2.0 * covariance[0].sqrt() / super::costly::CELL[0])
        });
        robust::median_of_finite(of_cells)
            .unwrap_or(1.0)
            .clamp(1.0, COARSENESS_MAX)
    }

    /// Returns the shift of the usual pixel due to the shared quantities and the model error.
    fn shared_std(&self) -> Option<Parameters> {
        let run = self.run();
        let mut all = shared_std(&run, &self.good)?;
        if let Some(misfit) = shared_misfit(&run, &self.good) {
            for (std, misfit) in all.iter_mut().zip(misfit) {
                *std = std.hypot(misfit);
            }
        }
        Some(all)
    }
}

/// Returns the recorded poses with the tilt offset added.
fn poses_at(globals: &Globals, recorded: &[Pose]) -> Vec<Pose> {
    let shifted = recorded.iter().map(|pose| Pose {
        theta_c: pose.theta_c + globals.tilt_offset,
        ..*pose
    });
    shifted.collect()
}

fn costly_at(
    stand: &View,
    material: &Material,
    poses: &[Pose],
    coarseness: f64,
    integrated: &Integrated,
) -> Costly {
    let geometry = poses.iter().map(|pose| stand.central(*pose));
    Costly::new(
        stand.imaging.rig,
        *material,
        poses.to_vec(),
        geometry.collect(),
        coarseness,
        integrated.clone(),
    )
}
