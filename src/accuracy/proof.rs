//! Whether a plan keeps its word: its result beside that of a run with everything on, and the time of both.
//!
//! Call [`of_scene`] for a scene of the tracer. The run with everything on goes on until its standard
//! error is a fifth of the tolerance; the plan's result, with other random numbers, must lie within
//! tolerance and two standard errors of both. Times are to a standard error as large as the tolerance,
//! the plan's own time included. Each decision is also taken alone, to tell what it brings.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use serde::Serialize;

use crate::plan::scene::{Wish, apply, plan};
use crate::plan::{Choice, Decision, Plan};
use crate::trace::run::{Follow, Shard, trace_photons};
use crate::trace::scene::{Prepared, Scene};

/// What a decision brings when it is taken alone.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Part {
    /// Which.
    pub decision: Decision,
    /// What is left out.
    pub what: String,
    /// What the plan says it costs.
    pub cost: Option<f64>,
    /// Time with everything on over time without it, both to the same standard error; null where there was
    /// nothing to leave out.
    pub speed_up: Option<f64>,
}

/// A plan beside everything on.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Proof {
    /// Scene.
    pub scene: String,
    /// What is compared.
    pub quantity: String,
    /// What the plan may cost, relative.
    pub tolerance: f64,
    /// Everything on: value and standard error.
    pub full: [f64; 2],
    /// As planned: value and standard error.
    pub planned: [f64; 2],
    /// Relative difference of the two.
    pub off: f64,
    /// Tolerance and two standard errors of the difference, relative.
    pub allowed: f64,
    /// Whether the difference is allowed.
    pub holds: bool,
    /// Seconds with everything on to a standard error as large as the tolerance.
    pub full_s: f64,
    /// The same as planned, planning included.
    pub planned_s: f64,
    /// Seconds of planning in it.
    pub planning_s: f64,
    /// Of the decisions that leave something out.
    pub parts: Vec<Part>,
}

impl Proof {
    /// Time with everything on over time as planned.
    #[must_use]
    pub fn speed_up(&self) -> f64 {
        self.full_s / self.planned_s
    }

    /// What is left out with what each part brings alone.
    #[must_use]
    pub fn parts_in_words(&self) -> String {
        let parts = self.parts.iter().filter_map(|p| {
            let speed_up = p.speed_up?;
            Some(format!("{} ×{speed_up:.2}", p.what))
        });
        let words = parts.collect::<Vec<_>>().join("; ");
        if words.is_empty() {
            "nothing that takes time".to_owned()
        } else {
            words
        }
    }
}

/// Standard error of the reference as a share of the tolerance.
const REFERENCE_SHARE: f64 = 0.2;
/// Photons of the first reference run, and most of the last.
const PHOTONS: (u64, u64) = (100_000, 6_400_000);
/// How many more photons than an estimated standard error asks for, and how many times as many at once.
const ESTIMATE_MARGIN: f64 = 1.3;
/// See [`ESTIMATE_MARGIN`].
const GROWTH_MAX: f64 = 16.0;
/// Fewest photons that are timed: a batch of each of a run's replicates.
const TIMED_PHOTONS_MIN: u64 = 256;
/// Runs of which the fastest counts: whatever else a machine does only ever adds.
const TIMED_RUNS: usize = 15;
/// Seed of the run as planned.
const OTHER_SEED: u64 = 0x005E_ED0F_0A11;

/// Reflected share with its standard error.
fn reflected(prepared: &Prepared, photons: u64, cancel: &AtomicBool) -> [f64; 2] {
    let totals = trace_photons(prepared, Follow::Scene, photons, Shard::WHOLE, &|_| {
        !cancel.load(Ordering::Relaxed)
    });
    let r = totals.energies().reflected_all;
    [r.value, r.std]
}

/// Photons after which a run that had `photons` has a relative standard error of `target`.
fn photons_for(run: [f64; 2], photons: u64, target: f64) -> u64 {
    let error = run[1] / run[0].max(f64::MIN_POSITIVE);
    let needed = photons as f64 * (error / target).powi(2);
    (needed as u64).clamp(TIMED_PHOTONS_MIN, photons)
}

/// Least seconds of each of some pieces of work, run by turns so that whatever else the machine does
/// meets them all alike.
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

/// Proves the plan of a scene at `tolerance` for its reflected energy. `ready` builds a scene's surfaces, the same
/// at every call; `printed` is the plan that somebody was shown, without which it is one for a run to the tolerance.
/// `None` where it was cancelled or the scene cannot be built.
#[must_use]
pub fn of_scene(
    name: &str,
    scene: &Scene,
    ready: &dyn Fn(&Scene) -> Option<Prepared>,
    tolerance: f64,
    printed: Option<&Plan>,
    cancel: &AtomicBool,
) -> Option<Proof> {
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
        // As many as the error found so far asks for, and some more since that is an estimate itself.
        let next = photons as f64 * (ESTIMATE_MARGIN * over * over).min(GROWTH_MAX);
        photons = (next as u64).min(PHOTONS.1);
    };
    // The plan is made for the run that is timed: one to the tolerance.
    let needed = photons_for(full, photons, tolerance);
    let wish = Wish {
        mueller: false,
        tolerance,
        photons: None,
    };
    let mut to_plan = everything(scene)?;
    to_plan.photons = needed;
    let plan = printed
        .cloned()
        .unwrap_or_else(|| plan(scene, &to_plan, &wish));
    let as_planned = |plan: &Plan| {
        let mut prepared = everything(scene)?;
        apply(plan, scene, &mut prepared);
        Some(prepared)
    };
    let lean_run = as_planned(&plan)?.with_seed(OTHER_SEED);
    let planned = reflected(&lean_run, photons, cancel);
    if cancel.load(Ordering::Relaxed) {
        return None;
    }
    let off = planned[0] / full[0] - 1.0;
    let allowed = tolerance + 2.0 * (full[1] / full[0]).hypot(planned[1] / full[0]);
    // A plan that changes nothing needs as many photons: the errors of two seeds are no measure of that.
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
            std::hint::black_box(reflected(&lean_run, enough, cancel));
        },
        &|| {
            std::hint::black_box(crate::plan::scene::plan(scene, &to_plan, &wish));
        },
    ]);
    // A plan that changes nothing runs the same work: what tells the two apart is the machine.
    let (full_s, run_s) = if unchanged {
        (full_s.min(run_s), full_s.min(run_s))
    } else {
        (full_s, run_s)
    };
    let mut parts = Vec::new();
    for choice in plan.left_out() {
        let alone = Plan {
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
        parts.push(Part {
            decision: choice.decision,
            what: choice.what.clone(),
            cost: choice.cost,
            speed_up,
        });
    }
    if cancel.load(Ordering::Relaxed) {
        return None;
    }
    Some(Proof {
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

/// Whether a decision does anything to a run: what a scene does not have cannot be left out.
fn changes_the_run(choice: &Choice, alone: &Plan) -> bool {
    match choice.decision {
        Decision::Polarisation => true,
        Decision::Bounces => alone.interactions_max.is_some(),
        Decision::Layers => !alone.idle_interfaces.is_empty(),
        Decision::ConeAverage | Decision::PerPixelGeometry | Decision::CostlyTerms => false,
    }
}

/// Median of the speed-ups of some proofs.
#[must_use]
pub fn median_speed_up<'a>(proofs: impl Iterator<Item = &'a Proof>) -> Option<f64> {
    let mut speed_ups: Vec<f64> = proofs.map(Proof::speed_up).collect();
    crate::robust::median(&mut speed_ups)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plan_without_polarisation_and_late_bounces_keeps_its_word() {
        let text = "[light]\ntheta_i_deg = 10.0\n[[interface]]\nshape = \"smith\"\nalpha_u = 0.1\nalpha_v = 0.1\nbelow = { n = 1.5 }\n\
                    [[interface]]\nshape = \"flat\"\nbelow = \"Au\"\n[run]\nphotons = 4000\n";
        let scene = Scene::parse(text).unwrap();
        let ready = |s: &Scene| s.prepare(&|_| Err(String::new())).ok();
        let proof = of_scene(
            "gold under glass",
            &scene,
            &ready,
            0.05,
            None,
            &AtomicBool::new(false),
        );
        let proof = proof.unwrap();
        assert!(proof.holds, "{proof:?}");
        assert!(proof.full[1] <= 0.01 * proof.full[0]);
        // Cone and pixels are no part of a scene: nothing is gained by leaving them out.
        let of = |d: Decision| proof.parts.iter().find(|p| p.decision == d);
        assert!(of(Decision::Polarisation).unwrap().speed_up.is_some());
        assert!(of(Decision::ConeAverage).unwrap().speed_up.is_none());
    }

    #[test]
    fn it_is_the_printed_plan_that_is_proved() {
        let text = "[[interface]]\nshape = \"flat\"\nbelow = { n = 1.5 }\n[run]\nphotons = 2000\n";
        let scene = Scene::parse(text).unwrap();
        let ready = |s: &Scene| s.prepare(&|_| Err(String::new())).ok();
        let of = |printed: Option<&Plan>| {
            let proof = of_scene(
                "glass",
                &scene,
                &ready,
                0.1,
                printed,
                &AtomicBool::new(false),
            );
            proof.unwrap().parts
        };
        // Asked for Mueller matrices the plan keeps polarisation; for energies alone it would not.
        let wish = Wish {
            mueller: true,
            tolerance: 0.1,
            photons: None,
        };
        let printed = plan(&scene, &ready(&scene).unwrap(), &wish);
        let told: Vec<Decision> = printed.left_out().map(|c| c.decision).collect();
        let proved: Vec<Decision> = of(Some(&printed)).iter().map(|p| p.decision).collect();
        assert_eq!(told, proved);
        assert!(!told.contains(&Decision::Polarisation));
        let other = of(None);
        assert!(other.iter().any(|p| p.decision == Decision::Polarisation));
    }

    #[test]
    fn photons_are_those_for_the_error_asked_for() {
        // 1 % after 10,000 is 2 % after 2,500.
        assert_eq!(photons_for([0.5, 0.005], 10_000, 0.02), 2_500);
        assert_eq!(photons_for([0.5, 0.005], 10_000, 1e-6), 10_000);
    }
}
