//! Before the map: a sample of pixels settles what all pixels share, where descents start, and how
//! large a χ² is usual.

use std::sync::atomic::{AtomicBool, Ordering};

use super::dear::Dear;
use super::globals::{Globals, Second, shared_effects};
use super::integrated::Integrated;
use super::kernel::Parameters;
use super::misfit::shared_misfit;
use super::run::{Batch, Run, freedom};
use super::solve::{End, FREE, PixelFit, packed};
use super::start::{Leaders, Templates, lambert};
use super::view::View;
use super::{MapError, Progress, Stage, plan};
use crate::geometry::Pose;
use crate::material::Material;
use crate::observation::{FlatObservation, WhiteReference};
use crate::plan::{Decision, Plan};
use crate::robust;

/// Rounds in which zero of the tilt, gain and fits take turns.
const ROUNDS: usize = 6;
/// How often the rounds are gone through; before each but the first, integrals are taken anew.
const PASSES: usize = 3;
/// Surfaces on which it is looked whether double reflections have to be integrated.
const PROBED: usize = 2;
/// A lobe has to lower χ² by this many usual χ² units.
pub(super) const LOBE_SIGNIFICANCE: f64 = 30.0;
/// Least certain parameters that still count as known: θr 2°, ln α 0.3.
const THETA_R_STD_MAX_RAD: f64 = 0.035;
const LN_ALPHA_STD_MAX: f64 = 0.3;
/// Typical uncertainty over cell width beyond which cells are made coarser, and how far.
const COARSENESS_MAX: f64 = 3.0;

/// What is settled before the map.
pub(super) struct Settled {
    pub(super) globals: Globals,
    pub(super) poses: Vec<Pose>,
    pub(super) dear: Dear,
    pub(super) leaders: Leaders,
    pub(super) templates: Templates,
    /// Lambert's term per observation.
    pub(super) lambert: Vec<f64>,
    /// Usual χ² per degree of freedom, at least 1.
    pub(super) birge: f64,
    /// Median shift of each parameter by one standard uncertainty of all shared quantities and of the model's
    /// misfit.
    pub(super) shared_std: Option<Parameters>,
    /// Sampled pixels that gave a good fit.
    pub(super) sampled: usize,
    /// The drawing, with the centre's directions for all pixels where the plan says so.
    pub(super) view: View,
    /// What was decided on the surfaces that most pixels look like.
    pub(super) plan: Plan,
    /// What the centre's directions cost in light that went between the facets, where camera or lamp are near.
    pub(super) centre_for_all: Option<f64>,
}

/// What the camera's references say.
pub(super) struct References<'a> {
    pub(super) flats: &'a [FlatObservation],
    pub(super) white: Option<WhiteReference>,
}

/// What is known and asked for before anything is settled.
pub(super) struct Given<'a> {
    pub(super) material: &'a Material,
    pub(super) recorded: &'a [Pose],
    pub(super) references: &'a References<'a>,
    /// Share of the brightest radiance that may be left out.
    pub(super) target_error: Option<f64>,
}

/// Whether a fit tells all that it was asked for.
pub(super) fn identifiable(fit: &PixelFit, birge: f64) -> bool {
    let Some(covariance) = &fit.covariance else {
        return false;
    };
    let std = |k: usize| (birge * covariance[packed(k, k)]).sqrt();
    std(0) < THETA_R_STD_MAX_RAD && std(2) < LN_ALPHA_STD_MAX && std(3) < LN_ALPHA_STD_MAX
}

pub(super) fn settle(
    batch: &Batch,
    view: &View,
    given: &Given<'_>,
    progress: &(dyn Fn(Progress) + Sync),
    cancel: &AtomicBool,
) -> Result<Settled, MapError> {
    let Given {
        material,
        recorded,
        references,
        target_error,
    } = *given;
    if (0..batch.pixels.len()).all(|index| batch.used(index) == 0) {
        return Err(MapError::NothingUsable);
    }
    let largest = batch.largest();
    if largest <= 0.0 {
        return Err(MapError::NothingSeen);
    }
    let amplitude = View::fits_amplitude(material);
    // Which directions pixels have may be decided; where camera and lamp stand is not.
    let (stand, mut view) = (view, view.clone());
    let place = [0.0, 0.0];
    let poses_at = |globals: &Globals| -> Vec<Pose> {
        let shifted = recorded.iter().map(|pose| Pose {
            theta_c: pose.theta_c + globals.tilt_offset,
            ..*pose
        });
        shifted.collect()
    };
    let dear_at = |poses: &[Pose], coarseness: f64, integrated: &Integrated| {
        let geometry = poses
            .iter()
            .map(|pose| stand.geometry(*pose, place))
            .collect();
        Dear::new(
            stand.rig,
            *material,
            poses.to_vec(),
            geometry,
            coarseness,
            integrated.clone(),
        )
    };
    let relative = references.white.is_none();
    let flats = |globals: Globals| match &references.white {
        Some(white) => globals.with_flats(references.flats, white, &stand.rig, largest),
        None => globals,
    };
    let enough: Vec<usize> = (0..batch.pixels.len())
        .filter(|index| batch.used(*index) > FREE)
        .collect();

    let mut globals = Globals::first(1.0, largest);
    let mut poses = poses_at(&globals);
    let mut integrated = Integrated::default();
    let mut dear = dear_at(&poses, 1.0, &integrated);
    let lambert_first = lambert(dear.geometry());
    if relative {
        let templates = Templates::new(dear.geometry(), dear.lamp(), amplitude);
        globals = Globals::first(
            gain_of(batch, &enough, &globals, &dear, &view, &poses, &templates)
                .ok_or(MapError::NoLobes)?,
            largest,
        );
    }
    let first = globals;
    globals = flats(globals);

    // Pixels that show a lobe at all; a mount has nothing to say here.
    let run = Run {
        batch,
        globals: &globals,
        dear: &dear,
        view: &view,
        poses: &poses,
    };
    let lobed: Vec<usize> = enough
        .iter()
        .copied()
        .filter(|index| {
            let dof = batch.used(*index) as f64 - 1.0;
            run.lambert_chi2(*index, &lambert_first) > dof + LOBE_SIGNIFICANCE
        })
        .collect();
    if lobed.is_empty() {
        return Err(MapError::NoLobes);
    }

    let mut birge = 1.0;
    let mut good: Vec<(usize, PixelFit)> = Vec::new();
    // First with the closed form alone, then with double reflections integrated at what was found.
    let mut passes_left = PASSES;
    let mut decided: Option<(Plan, Option<f64>)> = None;
    let mut polarised = true;
    let mut rounds_left = ROUNDS;
    for round in 0..ROUNDS * PASSES {
        if cancel.load(Ordering::Relaxed) {
            return Err(MapError::Cancelled);
        }
        progress(Progress {
            stage: Stage::Settling,
            done: round,
            total: ROUNDS * PASSES,
        });
        let run = Run {
            batch,
            globals: &globals,
            dear: &dear,
            view: &view,
            poses: &poses,
        };
        // The first round and the last search everywhere; between them fits follow the globals.
        let search = round == 0 || good.is_empty();
        let (chosen, fits) = if search {
            let templates = Templates::new(dear.geometry(), dear.lamp(), amplitude);
            let mut fits = run.fit_from_templates(&lobed, &templates);
            run.follow_the_best(&lobed, &mut fits);
            (lobed.clone(), fits)
        } else {
            let chosen: Vec<usize> = good.iter().map(|(index, _)| *index).collect();
            let starts: Vec<Parameters> = good.iter().map(|(_, fit)| fit.p).collect();
            let fits = run.fit(&chosen, &starts, 1);
            (chosen, fits)
        };
        let left = median(fits.iter().map(|f| f.chi2 / freedom(f)));
        let converged: Vec<(usize, PixelFit)> = chosen
            .into_iter()
            .zip(fits)
            .filter(|(_, fit)| fit.end == End::Converged && identifiable(fit, 1.0))
            .collect();
        // There are lobes, but these poses do not tell whose.
        birge = median(converged.iter().map(|(_, f)| f.chi2 / freedom(f)))
            .ok_or(MapError::NothingFitted {
                poses: recorded.len(),
                chi2: left.unwrap_or(f64::INFINITY),
            })?
            .max(1.0);
        // Pixels that straddle two surfaces pull at everything: only the usual ones have a say.
        good = converged
            .into_iter()
            .filter(|(_, f)| f.chi2 / freedom(f) < 2.5 * birge)
            .collect();
        let step = {
            let run = Run {
                batch,
                globals: &globals,
                dear: &dear,
                view: &view,
                poses: &poses,
            };
            let prior = if relative { first } else { flats(globals) };
            let second = match (amplitude, relative) {
                // A metal pixel has an amplitude of its own, which is the gain by another name.
                (true, _) => Second::Stray {
                    prior: prior.stray,
                    prior_std: prior.stray_std,
                },
                (false, true) => Second::Gain,
                (false, false) => Second::Nothing,
            };
            let mut next = globals;
            let step = next.step(&run, &good, birge, second);
            globals = flats(next);
            if amplitude {
                globals.stray = next.stray;
                globals.stray_std = next.stray_std;
            }
            step
        };
        poses = poses_at(&globals);
        dear = dear_at(&poses, 1.0, &integrated);
        rounds_left -= 1;
        let settled = rounds_left + 1 < ROUNDS && step[0].abs() < 2e-5 && step[1].abs() < 1e-4;
        if settled || rounds_left == 0 {
            passes_left -= 1;
            if passes_left == 0 {
                break;
            }
            rounds_left = ROUNDS;
            let fits: Vec<Parameters> = good.iter().map(|(_, fit)| fit.p).collect();
            let centres = Leaders::gather(&fits).centres(&fits);
            if decided.is_none() {
                // The first centres are those of most pixels.
                let surfaces = &centres[..centres.len().min(PROBED)];
                let plan = plan::decide(&dear, &view, surfaces, target_error);
                let near = !view.is_telecentric();
                let cost = near.then(|| plan::centre_for_all(&dear, &view, surfaces));
                let included = |decision| plan.on(decision).is_none_or(|choice| choice.included);
                let integrate = included(Decision::Bounces);
                view = view.with_own_directions(included(Decision::PerPixelGeometry));
                decided = Some((plan, cost));
                if !integrate {
                    break;
                }
            }
            let at = |polarised: bool| {
                Integrated::at(centres.clone(), amplitude, |p| dear.lacking(p, polarised))
            };
            integrated = at(true);
            if !amplitude {
                // Nature polarises light at the first facet and the second one sees it; many renderers leave that out
                // where light meets plastic. The pixels tell.
                let without = at(false);
                let misses = |integrated: &Integrated| {
                    let dear = dear_at(&poses, 1.0, integrated);
                    let run = Run {
                        batch,
                        globals: &globals,
                        dear: &dear,
                        view: &view,
                        poses: &poses,
                    };
                    run.misses(&good)
                };
                polarised = misses(&integrated) <= misses(&without);
                if !polarised {
                    integrated = without;
                }
            }
            dear = dear_at(&poses, 1.0, &integrated);
        }
    }

    let coarseness = median(good.iter().filter_map(|(_, f)| {
        let covariance = f.covariance.as_ref()?;
        Some(2.0 * covariance[0].sqrt() / super::dear::CELL[0])
    }))
    .unwrap_or(1.0)
    .clamp(1.0, COARSENESS_MAX);
    dear = dear_at(&poses, coarseness, &integrated);
    let run = Run {
        batch,
        globals: &globals,
        dear: &dear,
        view: &view,
        poses: &poses,
    };
    let found: Vec<Parameters> = good.iter().map(|(_, fit)| fit.p).collect();
    let mut leaders = Leaders::gather(&found);
    leaders.predict(|p| dear.full(p));
    let mut shared_std = shared_std(&run, &good);
    if let (Some(all), Some(misfit)) = (&mut shared_std, shared_misfit(&run, &good)) {
        for (std, misfit) in all.iter_mut().zip(misfit) {
            *std = std.hypot(misfit);
        }
    }
    let templates = Templates::new(dear.geometry(), dear.lamp(), amplitude);
    let lambert = lambert(dear.geometry());
    let (plan, centre_for_all) =
        decided.unwrap_or_else(|| (plan::decide(&dear, &view, &[], target_error), None));
    let plan = plan::with_polarisation(plan, polarised);
    Ok(Settled {
        sampled: good.len(),
        globals,
        poses,
        dear,
        leaders,
        templates,
        lambert,
        birge,
        shared_std,
        view,
        plan,
        centre_for_all,
    })
}

/// The usual amplitude of the best template over the pixels, for data without a white reference.
fn gain_of(
    batch: &Batch,
    enough: &[usize],
    globals: &Globals,
    dear: &Dear,
    view: &View,
    poses: &[Pose],
    templates: &Templates,
) -> Option<f64> {
    let run = Run {
        batch,
        globals,
        dear,
        view,
        poses,
    };
    let n = batch.observations;
    let (mut signal, mut weight) = (vec![0.0; n], vec![0.0; n]);
    median(enough.iter().filter_map(|index| {
        run.read(*index, &mut signal, &mut weight);
        templates.amplitude_of(&signal, &weight)
    }))
}

fn shared_std(run: &Run<'_>, good: &[(usize, PixelFit)]) -> Option<Parameters> {
    let every = good.len().div_ceil(200).max(1);
    let effects: Vec<Parameters> = good
        .iter()
        .step_by(every)
        .filter_map(|(index, fit)| {
            let parts = shared_effects(run, *index, fit)?;
            Some(std::array::from_fn(|k| {
                parts.iter().map(|p| p[k] * p[k]).sum::<f64>().sqrt()
            }))
        })
        .collect();
    let mut medians = [0.0; FREE];
    for (k, m) in medians.iter_mut().enumerate() {
        *m = median(effects.iter().map(|e| e[k]))?;
    }
    Some(medians)
}

/// Median of those that are finite; none of none.
pub(super) fn median(values: impl Iterator<Item = f64>) -> Option<f64> {
    let mut values: Vec<f64> = values.filter(|x| x.is_finite()).collect();
    robust::median(&mut values)
}
