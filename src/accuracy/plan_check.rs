//! Checks that the result of a plan stays within its tolerance, and measures the time that the plan saves.
//!
//! Call [`of_scene`] for a scene of the tracer. The full run continues until its standard
//! error is a fifth of the tolerance. The result of the plan, with other random numbers, must agree within
//! the tolerance and two standard errors of both. Times are those to a standard error equal to the tolerance,
//! planning included. Each decision is also timed separately.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use serde::Serialize;

use crate::plan::scene::{TracePlanRequest, apply, plan};
use crate::plan::{ComputationPlan, Decision, PlanChoice};
use crate::trace::run::{Follow, Shard, trace_photons};
use crate::trace::scene::{PreparedScene, Scene};

/// The effect of one decision alone.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct PlanPart {
    /// The decision.
    pub decision: Decision,
    /// The omitted effect.
    pub what: String,
    /// Its cost as the plan states it.
    pub cost: Option<f64>,
    /// Time of the full run over the time without the effect, both to the same standard error; null where the scene does not
    /// have the effect.
    pub speed_up: Option<f64>,
}

/// A plan compared with the full computation.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct PlanCheck {
    /// Scene.
    pub scene: String,
    /// The compared quantity.
    pub quantity: String,
    /// Allowed relative error of the plan.
    pub tolerance: f64,
    /// Full computation: value and standard error.
    pub full: [f64; 2],
    /// Planned computation: value and standard error.
    pub planned: [f64; 2],
    /// Relative difference of the two.
    pub off: f64,
    /// Tolerance and two standard errors of the difference, relative.
    pub allowed: f64,
    /// Whether the difference is allowed.
    pub holds: bool,
    /// Seconds of the full computation, to a standard error equal to the tolerance.
    pub full_s: f64,
    /// Seconds of the planned computation, planning included.
    pub planned_s: f64,
    /// Seconds of planning.
    pub planning_s: f64,
    /// The decisions that omit an effect.
    pub parts: Vec<PlanPart>,
}

impl PlanCheck {
    /// Time of the full over that of the planned computation.
    #[must_use]
    pub fn speed_up(&self) -> f64 {
        self.full_s / self.planned_s
    }

    /// The omitted effects, each with its own speed-up.
    #[must_use]
    pub fn parts_text(&self) -> String {
        let parts = self.parts.iter().filter_map(|p| {
            let speed_up = p.speed_up?;
            Some(format!("{} ×{speed_up:.2}", p.what))
        });
        let words = parts.collect::<Vec<_>>().join("; ");
        if words.is_empty() {
            "no effect that takes time".to_owned()
        } else {
            words
        }
    }
}

/// Standard error of the reference as a share of the tolerance.
const REFERENCE_SHARE: f64 = 0.2;
/// Photons of the first reference run, and most of the last.
const PHOTONS: (u64, u64) = (100_000, 6_400_000);
/// Margin over the photons that an estimated standard error requires.
const ESTIMATE_MARGIN: f64 = 1.3;
/// Largest factor between the photons of successive runs.
const GROWTH_MAX: f64 = 16.0;
/// Fewest photons of a timed run: one batch for each replicate.
const TIMED_PHOTONS_MIN: u64 = 256;
/// Timed runs, of which the fastest counts: other work on the machine only adds time.
const TIMED_RUNS: usize = 15;
/// Seed of the planned run.
const OTHER_SEED: u64 = 0x005E_ED0F_0A11;

/// Reflected share with its standard error.
fn reflected(prepared: &PreparedScene, photons: u64, cancel: &AtomicBool) -> [f64; 2] {
    let totals = trace_photons(prepared, Follow::Scene, photons, Shard::WHOLE, &|_| {
        !cancel.load(Ordering::Relaxed)
    });
    let r = totals.energies().reflected_all;
    [r.value, r.std]
}

/// Photons to a relative standard error of `target`, from a run of `photons`.
fn photons_for(run: [f64; 2], photons: u64, target: f64) -> u64 {
    let error = run[1] / run[0].max(f64::MIN_POSITIVE);
    let needed = photons as f64 * (error / target).powi(2);
    (needed as u64).clamp(TIMED_PHOTONS_MIN, photons)
}

/// Shortest time of each piece of work, s. The pieces run in turns, so that other work on the machine affects all of them
/// equally.
fn fastest<const N: usize>(work: [&dyn Fn(); N]) -> [f64; N] {
    let mut least = [f64::INFINITY; N];
    for _ in 0..TIMED_RUNS {
        for (f, seconds) in work.iter().zip(&mut least) {
            let started = Instant::now();
            f();
            *seconds = seconds.min(started.elapsed().as_secs_f64());
        }
    }
    least
}

/// Checks the plan of a scene for its reflected energy at `tolerance`. `ready` builds the surfaces of a scene, the same
/// at every call. `printed` is a plan that the user has seen; without it, a run to the tolerance is planned.
/// `None` where it was cancelled or the scene cannot be built.
#[must_use]
pub fn of_scene(
    name: &str,
    scene: &Scene,
    ready: &dyn Fn(&Scene) -> Option<PreparedScene>,
    tolerance: f64,
    printed: Option<&ComputationPlan>,
    cancel: &AtomicBool,
) -> Option<PlanCheck> {
    let everything = |scene: &Scene| {
        let mut prepared = ready(scene)?;
        prepared.polarised = true;
        Some(prepared)
    };
    let reference = everything(scene)?;
    let mut photons = PHOTONS.0;
    let full = loop {
        let run = reflected(&reference, photons, cancel);
        if cancel.load(Ordering::Relaxed) {
            return None;
        }
        let over = run[1] / (REFERENCE_SHARE * tolerance * run[0]);
        if over <= 1.0 || photons >= PHOTONS.1 {
            break run;
        }
        // The photons that the error so far requires, with a margin because that error is an estimate.
        let next = photons as f64 * (ESTIMATE_MARGIN * over * over).min(GROWTH_MAX);
        photons = (next as u64).min(PHOTONS.1);
    };
    // The plan is made for the timed run, which ends at the tolerance.
    let needed = photons_for(full, photons, tolerance);
    let request = TracePlanRequest {
        mueller: false,
        tolerance,
        photons: None,
    };
    let mut to_plan = everything(scene)?;
    to_plan.photons = needed;
    let plan = printed
        .cloned()
        .unwrap_or_else(|| plan(scene, &to_plan, &request));
    let as_planned = |plan: &ComputationPlan| {
        let mut prepared = everything(scene)?;
        apply(plan, scene, &mut prepared);
        Some(prepared)
    };
    let planned_run = as_planned(&plan)?.with_seed(OTHER_SEED);
    let planned = reflected(&planned_run, photons, cancel);
    if cancel.load(Ordering::Relaxed) {
        return None;
    }
    let off = planned[0] / full[0] - 1.0;
    let allowed = tolerance + 2.0 * (full[1] / full[0]).hypot(planned[1] / full[0]);
    // A plan without effect needs the same number of photons; the errors of two seeds differ by chance.
    let unchanged = !plan.left_out().any(|c| changes_the_run(c, &plan));
    let enough = if unchanged {
        needed
    } else {
        photons_for(planned, photons, tolerance)
    };
    let [full_s, run_s, planning_s] = fastest([
        &|| {
            std::hint::black_box(reflected(&reference, needed, cancel));
        },
        &|| {
            std::hint::black_box(reflected(&planned_run, enough, cancel));
        },
        &|| {
            std::hint::black_box(crate::plan::scene::plan(scene, &to_plan, &request));
        },
    ]);
    // A plan without effect runs the same work; the times differ only by chance.
    let (full_s, run_s) = if unchanged {
        (full_s.min(run_s), full_s.min(run_s))
    } else {
        (full_s, run_s)
    };
    let mut parts = Vec::new();
    for choice in plan.left_out() {
        let alone = ComputationPlan {
            decisions: vec![choice.clone()],
            interactions_max: plan
                .interactions_max
                .filter(|_| choice.decision == Decision::Bounces),
            idle_interfaces: match choice.decision {
                Decision::Layers => plan.idle_interfaces.clone(),
                _ => Vec::new(),
            },
            ..plan.clone()
        };
        let speed_up = if changes_the_run(choice, &alone) {
            let prepared = as_planned(&alone)?;
            let run = reflected(&prepared, PHOTONS.0, cancel);
            let count = photons_for(run, PHOTONS.0, tolerance);
            let [with_s, without_s] = fastest([
                &|| {
                    std::hint::black_box(reflected(&reference, needed, cancel));
                },
                &|| {
                    std::hint::black_box(reflected(&prepared, count, cancel));
                },
            ]);
            Some(with_s / without_s)
        } else {
            None
        };
        parts.push(PlanPart {
            decision: choice.decision,
            what: choice.what.clone(),
            cost: choice.cost,
            speed_up,
        });
    }
    if cancel.load(Ordering::Relaxed) {
        return None;
    }
    Some(PlanCheck {
        scene: name.to_owned(),
        quantity: "reflected energy".to_owned(),
        tolerance,
        full,
        planned,
        off,
        allowed,
        holds: off.abs() <= allowed,
        full_s,
        planned_s: run_s + planning_s,
        planning_s,
        parts,
    })
}

/// Whether a decision changes a run: a scene may not have the effect.
fn changes_the_run(choice: &PlanChoice, alone: &ComputationPlan) -> bool {
    match choice.decision {
        Decision::Polarisation => true,
        Decision::Bounces => alone.interactions_max.is_some(),
        Decision::Layers => !alone.idle_interfaces.is_empty(),
        Decision::ConeAverage | Decision::PerPixelGeometry | Decision::CostlyTerms => false,
    }
}

/// Median of the speed-ups.
#[must_use]
pub fn median_speed_up<'a>(checks: impl Iterator<Item = &'a PlanCheck>) -> Option<f64> {
    let mut speed_ups: Vec<f64> = checks.map(PlanCheck::speed_up).collect();
    crate::robust::median(&mut speed_ups)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plan_without_polarisation_and_late_bounces_stays_within_its_tolerance() {
        let text = "[light]\ntheta_i_deg = 10.0\n[[interface]]\nshape = \"smith\"\nalpha_u = 0.1\nalpha_v = 0.1\nbelow = { n = 1.5 }\n\
                    [[interface]]\nshape = \"flat\"\nbelow = \"Au\"\n[run]\nphotons = 4000\n";
        let scene = Scene::parse(text).unwrap();
        let ready = |s: &Scene| s.prepare(&|_| Err(String::new())).ok();
        let check = of_scene(
            "gold under glass",
            &scene,
            &ready,
            0.05,
            None,
            &AtomicBool::new(false),
        );
        let check = check.unwrap();
        assert!(check.holds, "{check:?}");
        assert!(check.full[1] <= 0.01 * check.full[0]);
        // A scene has neither cones nor pixels, so their omission saves no time.
        let of = |d: Decision| check.parts.iter().find(|p| p.decision == d);
        assert!(of(Decision::Polarisation).unwrap().speed_up.is_some());
        assert!(of(Decision::ConeAverage).unwrap().speed_up.is_none());
    }

    #[test]
    fn the_printed_plan_is_the_one_that_is_checked() {
        let text = "[[interface]]\nshape = \"flat\"\nbelow = { n = 1.5 }\n[run]\nphotons = 2000\n";
        let scene = Scene::parse(text).unwrap();
        let ready = |s: &Scene| s.prepare(&|_| Err(String::new())).ok();
        let of = |printed: Option<&ComputationPlan>| {
            let check = of_scene(
                "glass",
                &scene,
                &ready,
                0.1,
                printed,
                &AtomicBool::new(false),
            );
            check.unwrap().parts
        };
        // For Mueller matrices the plan keeps polarisation; for energies it would not.
        let request = TracePlanRequest {
            mueller: true,
            tolerance: 0.1,
            photons: None,
        };
        let printed = plan(&scene, &ready(&scene).unwrap(), &request);
        let omitted: Vec<Decision> = printed.left_out().map(|c| c.decision).collect();
        let checked: Vec<Decision> = of(Some(&printed)).iter().map(|p| p.decision).collect();
        assert_eq!(omitted, checked);
        assert!(!omitted.contains(&Decision::Polarisation));
        let other = of(None);
        assert!(other.iter().any(|p| p.decision == Decision::Polarisation));
    }

    #[test]
    fn the_number_of_photons_follows_from_the_target_error() {
        // 1 % after 10,000 is 2 % after 2,500.
        assert_eq!(photons_for([0.5, 0.005], 10_000, 0.02), 2_500);
        assert_eq!(photons_for([0.5, 0.005], 10_000, 1e-6), 10_000);
    }
}
