//! The plan of a scene for the tracer.

use nalgebra::Complex;

use super::{Basis, ComputationPlan, Decision, PlanChoice};
use crate::material::tables::index_of;
use crate::model::flat_stack::{FlatStack, StackReflectance};
use crate::trace::counting::tally::ORDERS;
use crate::trace::photons::walk::Method;
use crate::trace::pilot::{Pilot, effort, pilot};
use crate::trace::scene::{LeftOut, PreparedScene, Scene};

/// What a plan of a trace must achieve.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TracePlanRequest {
    /// Whether the run gives Mueller matrices, not only energies.
    pub mueller: bool,
    /// Allowed relative error of the reflected energy from all decisions together.
    pub tolerance: f64,
    /// Limits the error further, to the standard error of a run of this many photons.
    pub photons: Option<u64>,
}

/// A pilot may take one part in this many of the effort of the run; in so few where a decision is likely, because an
/// omission saves at least a quarter of the run.
const PILOT_SHARE: u64 = 30;
const LIKELY_SHARE: u64 = 10;
/// A decision is likely where it would hold even if the estimate grew by this many standard deviations.
const LIKELY: f64 = 0.5;
/// Photons of the first pilot, and largest number of all pilots together.
const PILOT_PHOTONS: (u64, u64) = (500, 20_000);
/// Factor by which the photons grow while a decision is open.
const PILOT_GROWTH: u64 = 2;
/// An event that none of n photons had happens to fewer than this many of n, with 95 % confidence.
const UNSEEN: f64 = 3.0;
/// Ratio of the standard error with split photons to that by counting: about 10⁻³ for reflections off rough plastic.
const SPLIT_SHARE: f64 = 1e-3;
/// A pilot only for the bounces takes at most one photon in this many.
const SELDOM_SHARE: u64 = 50;
/// Largest share of the tolerance for bounces, so that all decisions together stay within it.
const BOUNCES_SHARE: f64 = 0.5;

/// Plans a scene. Closed forms decide where they are exact, otherwise pilots, the shortest that is clear. The plan
/// depends only on the scene and its seed, so all shards of a run have the same plan.
#[must_use]
pub fn plan(
    scene: &Scene,
    prepared: &PreparedScene,
    request: &TracePlanRequest,
) -> ComputationPlan {
    let known = SceneFacts {
        needs_polarisation: asks_for_polarisation(scene, request),
        stated_polarised: scene.run.polarised.as_bool(),
        is_single_flat: scene.interface.len() == 1 && scene.interface[0].shape == "flat",
        stack: flat_stack(scene),
    };
    // Without a stated tolerance a run keeps all bounces and interfaces.
    let stated = request.photons.is_none();
    let open = known.needs_polarisation.is_none() && known.stated_polarised.is_none();
    let flat = known.is_single_flat || known.stack.is_some();
    let needs_pilot = match stated {
        true => !flat,
        false => open && !known.is_single_flat,
    };
    let look = || {
        let most = |share: u64| (effort(prepared) / share).clamp(PILOT_PHOTONS.0, PILOT_PHOTONS.1);
        let (usual, costly) = (most(PILOT_SHARE), most(LIKELY_SHARE));
        let mut seen = pilot(prepared, PILOT_PHOTONS.0.min(prepared.photons), 0)?;
        for number in 1.. {
            let tolerance = tolerance_of(request, Some(&seen), prepared.method());
            let likely = open && may_turn_out(&seen, tolerance, costly, LIKELY);
            let hopeful = likely || open && may_turn_out(&seen, tolerance, usual, 0.0);
            let most = if likely { costly } else { usual };
            let more = ((PILOT_GROWTH - 1) * seen.photons).min(most.saturating_sub(seen.photons));
            if more == 0 || !(hopeful || stated && blind(&seen, tolerance)) {
                break;
            }
            // A pilot that can only bound rare light may take at most a fiftieth of the photons.
            if !hopeful && seen.photons + more > prepared.photons / SELDOM_SHARE {
                break;
            }
            let Some(another) = pilot(prepared, more, number) else {
                break;
            };
            seen = seen.and(another);
        }
        Some(seen)
    };
    let seen = if needs_pilot { look() } else { None };
    let tolerance = tolerance_of(request, seen.as_ref(), prepared.method());
    let polarisation = polarisation(&known, seen.as_ref(), tolerance);
    let spent = match (polarisation.included, polarisation.cost) {
        (false, Some(cost)) => cost,
        _ => 0.0,
    };
    let allowed = (tolerance - spent).clamp(0.0, BOUNCES_SHARE * tolerance);
    let (bounces, interactions_max) = bounces(flat, seen.as_ref().filter(|_| stated), allowed);
    let idle = if stated {
        idle_interfaces(scene)
    } else {
        Vec::new()
    };
    ComputationPlan {
        tolerance,
        quantity: if request.mueller {
            "Mueller matrices by direction".to_owned()
        } else {
            "reflected energy".to_owned()
        },
        decisions: vec![
            polarisation,
            bounces,
            layers(scene, &idle),
            PlanChoice {
                decision: Decision::ConeAverage,
                included: false,
                what: "average over the lamp's cone".to_owned(),
                why: "the lamp of a scene is a single direction".to_owned(),
                cost: Some(0.0),
                basis: Basis::Exact,
            },
            PlanChoice {
                decision: Decision::PerPixelGeometry,
                included: false,
                what: "directions of single pixels".to_owned(),
                why: "a scene has no camera; light is counted by direction".to_owned(),
                cost: Some(0.0),
                basis: Basis::Exact,
            },
        ],
        interactions_max,
        idle_interfaces: idle,
    }
}

/// Facts about a scene that need no photon.
struct SceneFacts {
    /// Why the result needs polarisation, if it does.
    needs_polarisation: Option<&'static str>,
    /// Whether the scene states that polarisation is followed.
    stated_polarised: Option<bool>,
    /// Whether there is a single flat interface.
    is_single_flat: bool,
    /// The exact reflectance, where all interfaces are flat.
    stack: Option<StackReflectance>,
}

/// Allowed relative error of the whole plan.
fn tolerance_of(request: &TracePlanRequest, seen: Option<&Pilot>, method: Method) -> f64 {
    match (seen, request.photons) {
        (Some(p), Some(run)) => request.tolerance.min(own_error(p, run, method)),
        _ => request.tolerance,
    }
}

/// Lower and upper bound of the error without polarisation, two standard errors apart from the estimate. A pilot without
/// doubly reflected light does not constrain the difference.
fn difference(p: &Pilot) -> (f64, f64) {
    let d = p.reflected_difference;
    let per = 1.0 / p.reflected.value.max(f64::MIN_POSITIVE);
    let (value, spread) = (d.value.abs(), 2.0 * d.std);
    let single = p.by_interactions[0][1..].iter().all(|e| e.value == 0.0);
    let unmet = if single {
        unseen(p, p.reflected.value)
    } else {
        0.0
    };
    ((value - spread) * per, (value + spread) * per + unmet)
}

/// Whether a pilot leaves polarisation undecided, and would decide against it with `photons` in total, even if the
/// difference turned out `worse` standard deviations larger than estimated.
fn may_turn_out(p: &Pilot, tolerance: f64, photons: u64, worse: f64) -> bool {
    let (least, most) = difference(p);
    let (guess, spread) = (0.5 * (least + most), 0.5 * (most - least));
    // The remaining share of the variance; the rest is the variance of the change of the estimate.
    let left = (p.photons as f64 / photons.max(1) as f64).min(1.0);
    let then = guess + spread * (left.sqrt() + 0.5 * worse * (1.0 - left).sqrt());
    most > tolerance && then <= tolerance
}

/// Whether a pilot has too few photons to bound the light that returns after many bounces.
fn blind(p: &Pilot, tolerance: f64) -> bool {
    unseen(p, p.reflected.value) > 0.5 * BOUNCES_SHARE * tolerance
}

/// Upper bound of light that none of a pilot's photons represents, relative to a share of the light.
fn unseen(p: &Pilot, share: f64) -> f64 {
    UNSEEN / p.photons.max(1) as f64 / share.max(f64::MIN_POSITIVE)
}

/// The exact reflectance where all interfaces are flat, not diffuse and, above the last, not absorbing.
fn flat_stack(scene: &Scene) -> Option<StackReflectance> {
    let mut indices = vec![Complex::new(scene.n_top, 0.0)];
    for shape in &scene.interface {
        if shape.shape != "flat" {
            return None;
        }
        indices.push(match &shape.below {
            toml::Value::String(name) => index_of(name, scene.light.wavelength_nm).ok()?,
            below => {
                let (n, k) = number(below)?;
                Complex::new(n, k)
            }
        });
    }
    let stack = FlatStack::new(indices).ok()?;
    stack.reflect_deg(scene.light.theta_i_deg).ok()
}

/// Upper bound of the relative standard error of the reflected energy of a run. With split photons only multiply
/// reflected light is random, and its starting points are stratified.
fn own_error(pilot: &Pilot, photons: u64, method: Method) -> f64 {
    let ratio = pilot.photons as f64 / photons.max(1) as f64;
    let counted = pilot.reflected.std / pilot.reflected.value.max(f64::MIN_POSITIVE) * ratio.sqrt();
    match method {
        Method::Analog => counted,
        Method::Split => SPLIT_SHARE * counted,
    }
}

/// The reason why the result needs polarisation, if it does.
fn asks_for_polarisation(scene: &Scene, request: &TracePlanRequest) -> Option<&'static str> {
    let [_, q, u, v] = scene.light.stokes;
    if scene.run.polarised.as_bool() == Some(true) {
        Some("the scene states it")
    } else if request.mueller {
        Some("the run gives Mueller matrices")
    } else if [q, u, v] != [0.0; 3] {
        Some("the lamp is polarised")
    } else {
        None
    }
}

fn polarisation(known: &SceneFacts, seen: Option<&Pilot>, tolerance: f64) -> PlanChoice {
    let choice = |included: bool, why: String, cost: Option<f64>, basis: Basis| PlanChoice {
        decision: Decision::Polarisation,
        included,
        what: "polarisation of light".to_owned(),
        why,
        cost,
        basis,
    };
    if known.stated_polarised == Some(false) {
        return choice(false, "the scene states it".to_owned(), None, Basis::Bound);
    }
    if let Some(why) = known.needs_polarisation {
        return choice(true, why.to_owned(), None, Basis::Exact);
    }
    if known.is_single_flat {
        let why = "the energy of a single reflection of unpolarised light does not depend on it";
        return choice(false, why.to_owned(), Some(0.0), Basis::Exact);
    }
    if let Some(exact) = &known.stack {
        let with = exact.channel.unpolarised();
        let cost = (exact.scalar / with.max(f64::MIN_POSITIVE) - 1.0).abs();
        let percent = 100.0 * cost;
        let why = format!(
            "the exact reflectance of the flat layers changes by {percent:.2} % without it (unpolarised lamp, energies only)"
        );
        return choice(cost > tolerance, why, Some(cost), Basis::Exact);
    }
    let Some(p) = seen else {
        return choice(
            true,
            "its effect has no bound".to_owned(),
            None,
            Basis::Bound,
        );
    };
    let (_, cost) = difference(p);
    let percent = 100.0 * cost;
    if cost <= tolerance {
        let why = format!(
            "unpolarised lamp, energies only; {} photons traced with and without it differ by at most {percent:.2} %",
            p.photons
        );
        choice(false, why, Some(cost), Basis::Pilot)
    } else {
        let why = format!(
            "without it the reflected energy would change by up to {percent:.2} % ({} photons traced with and without it)",
            p.photons
        );
        choice(true, why, Some(cost), Basis::Pilot)
    }
}

/// The number of bounces after which little light returns.
fn bounces(flat: bool, seen: Option<&Pilot>, allowed: f64) -> (PlanChoice, Option<u32>) {
    let choice =
        |included: bool, what: String, why: String, cost: Option<f64>, basis: Basis| PlanChoice {
            decision: Decision::Bounces,
            included,
            what,
            why,
            cost,
            basis,
        };
    if flat {
        let why = "light bounces once on a flat interface".to_owned();
        let what = "bounces within an interface".to_owned();
        return (choice(false, what, why, Some(0.0), Basis::Exact), None);
    }
    let all = "bounces up to run.interactions_max".to_owned();
    let Some(p) = seen else {
        let why = "no tolerance was stated".to_owned();
        return (choice(true, all, why, None, Basis::Bound), None);
    };
    // Late light is rare, so the scatter of its few photons is not a bound. The bound for unseen light is added.
    let mut beyond = [(0.0, 0.0f64); 2];
    let mut limit = None;
    for order in (0..ORDERS - 1).rev() {
        let mut cost = 0.0f64;
        for (side, all) in [p.reflected, p.transmitted].into_iter().enumerate() {
            let next = p.by_interactions[side][order + 1];
            let (value, std) = &mut beyond[side];
            (*value, *std) = (*value + next.value, std.hypot(next.std));
            // The tolerance is relative to the reflected light, and to the transmitted light where there is some.
            if side == 0 || all.value > 0.0 {
                let share = (*value + 2.0 * *std) / all.value.max(f64::MIN_POSITIVE);
                cost = cost.max(share + unseen(p, all.value));
            }
        }
        if cost > allowed {
            break;
        }
        limit = Some((order + 1, cost));
    }
    match limit {
        Some((n, cost)) => {
            let why = format!(
                "light that leaves after more than {n} interactions is at most {:.2} % of the reflected or transmitted light",
                100.0 * cost
            );
            let what = format!("interactions beyond {n}");
            let limit = u32::try_from(n).ok();
            (choice(false, what, why, Some(cost), Basis::Pilot), limit)
        }
        None => {
            let least = unseen(p, p.reflected.value);
            let why = if least > allowed {
                format!(
                    "the {}-photon pilot cannot resolve late light below {:.2} %",
                    p.photons,
                    100.0 * least
                )
            } else {
                format!(
                    "more than {:.2} % of the light returns after {ORDERS} or more interactions",
                    100.0 * allowed
                )
            };
            (choice(true, all, why, None, Basis::Pilot), None)
        }
    }
}

/// n and k of a medium that is stated by numbers; `None` for a name or a diffuse body.
fn number(below: &toml::Value) -> Option<(f64, f64)> {
    let table = below.as_table()?;
    let of = |key: &str| match table.get(key) {
        None => Some(0.0),
        Some(v) => v.as_float().or_else(|| v.as_integer().map(|i| i as f64)),
    };
    (!table.contains_key("rho_d")).then_some((of("n")?, of("k")?))
}

/// Interfaces between equal media, which do not change light whatever their shape (1 for the topmost). A
/// scene keeps at least one.
fn idle_interfaces(scene: &Scene) -> Vec<usize> {
    let mut above = Some((scene.n_top, 0.0));
    let mut idle = Vec::new();
    for (i, shape) in scene.interface.iter().enumerate() {
        let below = number(&shape.below);
        if below.is_some() && below == above && above.is_some_and(|(_, k)| k == 0.0) {
            idle.push(i + 1);
        }
        above = below;
    }
    if idle.len() == scene.interface.len() {
        idle.pop();
    }
    idle
}

fn layers(scene: &Scene, idle: &[usize]) -> PlanChoice {
    let count = scene.interface.len();
    let included = idle.is_empty();
    let (what, why) = if included {
        (
            format!("{count} of {count} interfaces"),
            "each changes the index",
        )
    } else {
        let names: Vec<String> = idle.iter().map(ToString::to_string).collect();
        let why = "the medium is the same above and below, so no light is reflected or refracted";
        (format!("interface {}", names.join(", ")), why)
    };
    PlanChoice {
        decision: Decision::Layers,
        included,
        what,
        why: why.to_owned(),
        cost: (!included).then_some(0.0),
        basis: Basis::Exact,
    }
}

/// Applies a plan to a run. A statement of the scene about polarisation takes precedence.
pub fn apply(plan: &ComputationPlan, scene: &Scene, prepared: &mut PreparedScene) {
    if let Some(choice) = plan.on(Decision::Polarisation)
        && !scene.run.polarised.is_bool()
    {
        prepared.polarised = choice.included;
    }
    if let Some(limit) = plan.interactions_max {
        prepared.give_up_after(limit);
    }
    prepared.leave_out(&plan.idle_interfaces, scene);
    prepared.left_out.extend(plan.left_out().map(|c| LeftOut {
        what: c.what.clone(),
        why: c.why.clone(),
        cost: c.cost,
    }));
}

#[cfg(test)]
mod tests;
