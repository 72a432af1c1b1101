//! The plan of a scene for the tracer.

use nalgebra::Complex;

use super::{Basis, Choice, Decision, Plan};
use crate::material::tables::index_of;
use crate::model::flat_stack::{FlatStack, StackReflectance};
use crate::trace::pilot::{Pilot, effort, pilot};
use crate::trace::scene::{LeftOut, Prepared, Scene};
use crate::trace::tally::ORDERS;
use crate::trace::walk::Method;

/// What the user wants from a run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Wish {
    /// Mueller matrices are asked for, not only energies.
    pub mueller: bool,
    /// Relative error of the reflected energy that all decisions together may cost.
    pub tolerance: f64,
    /// Costs no greater than the run's own standard error at this number of photons only.
    pub photons: Option<u64>,
}

/// Share of a run's effort that pilots may take to see if a decision will fall, and where it is likely to:
/// what a pilot allows to leave out saves a quarter of the run and more.
const PILOT_SHARE: u64 = 30;
const LIKELY_SHARE: u64 = 10;
/// How many standard deviations worse than its best guess a pilot may turn out and still be likely to decide.
const LIKELY: f64 = 0.5;
/// Photons of the first pilot, and of all together at most.
const PILOT_PHOTONS: (u64, u64) = (500, 20_000);
/// A pilot that leaves a decision open is gone on with until it has so many times its photons.
const PILOT_GROWTH: u64 = 2;
/// What none of n photons met happens to fewer than this many of n, nineteen times out of twenty.
const UNSEEN: f64 = 3.0;
/// Share of an error by counting that split photons have left: a thousandth or two for reflections off rough plastic.
const SPLIT_SHARE: f64 = 1e-3;
/// A pilot for the bounces alone takes no more than one photon in so many.
const SELDOM_SHARE: u64 = 50;
/// Share of the tolerance that bounces may cost at most, so that all decisions together keep to it.
const BOUNCES_SHARE: f64 = 0.5;

/// Plans a scene. Closed answers decide where they are exact; else pilots do, the shortest that is clear. They
/// depend on the scene and its seed alone, so all shards of a run come to the same plan.
#[must_use]
pub fn plan(scene: &Scene, prepared: &Prepared, wish: &Wish) -> Plan {
    let known = Known {
        asks: asks_for_polarisation(scene, wish),
        told: scene.run.polarised.as_bool(),
        alone: scene.interface.len() == 1 && scene.interface[0].shape == "flat",
        stack: flat_stack(scene),
    };
    // Without a stated tolerance a run keeps its bounces and its count of interactions.
    let stated = wish.photons.is_none();
    let open = known.asks.is_none() && known.told.is_none();
    let flat = known.alone || known.stack.is_some();
    let needs_pilot = match stated {
        true => !flat,
        false => open && !known.alone,
    };
    let look = || {
        let most = |share: u64| (effort(prepared) / share).clamp(PILOT_PHOTONS.0, PILOT_PHOTONS.1);
        let (usual, costly) = (most(PILOT_SHARE), most(LIKELY_SHARE));
        let mut seen = pilot(prepared, PILOT_PHOTONS.0.min(prepared.photons), 0)?;
        for number in 1.. {
            let tolerance = tolerance_of(wish, Some(&seen), prepared.method());
            let likely = open && may_turn_out(&seen, tolerance, costly, LIKELY);
            let hopeful = likely || open && may_turn_out(&seen, tolerance, usual, 0.0);
            let most = if likely { costly } else { usual };
            let more = ((PILOT_GROWTH - 1) * seen.photons).min(most.saturating_sub(seen.photons));
            if more == 0 || !(hopeful || stated && blind(&seen, tolerance)) {
                break;
            }
            // What can only tell of seldom light is worth no more than a fiftieth of the photons.
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
    let tolerance = tolerance_of(wish, seen.as_ref(), prepared.method());
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
    Plan {
        tolerance,
        quantity: if wish.mueller {
            "Mueller matrices by direction".to_owned()
        } else {
            "reflected energy".to_owned()
        },
        decisions: vec![
            polarisation,
            bounces,
            layers(scene, &idle),
            Choice {
                decision: Decision::ConeAverage,
                included: false,
                what: "average over the lamp's cone".to_owned(),
                why: "the scene's lamp is one direction".to_owned(),
                cost: Some(0.0),
                basis: Basis::Exact,
            },
            Choice {
                decision: Decision::PerPixelGeometry,
                included: false,
                what: "directions of single pixels".to_owned(),
                why: "a scene has no camera: light is counted by direction".to_owned(),
                cost: Some(0.0),
                basis: Basis::Exact,
            },
        ],
        interactions_max,
        idle_interfaces: idle,
    }
}

/// What is known of a scene without a photon.
struct Known {
    /// Why polarisation is part of the question.
    asks: Option<&'static str>,
    /// What the scene says of it.
    told: Option<bool>,
    /// A single flat interface.
    alone: bool,
    /// Flat interfaces only: their answer is exact.
    stack: Option<StackReflectance>,
}

/// Relative error that the plan as a whole may cost.
fn tolerance_of(wish: &Wish, seen: Option<&Pilot>, method: Method) -> f64 {
    match (seen, wish.photons) {
        (Some(p), Some(run)) => wish.tolerance.min(own_error(p, run, method)),
        _ => wish.tolerance,
    }
}

/// What leaving polarisation out costs, at least and at most: two standard errors either way. A pilot that met no light
/// of two reflections tells of no difference, whatever there is.
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

/// Whether a pilot leaves open if polarisation matters, and with `photons` in all would tell that it does not,
/// were the difference `worse` standard deviations of its way there greater than it looks.
fn may_turn_out(p: &Pilot, tolerance: f64, photons: u64, worse: f64) -> bool {
    let (least, most) = difference(p);
    let (guess, spread) = (0.5 * (least + most), 0.5 * (most - least));
    // Of the variance this share is left then, and the rest is how far the guess will move.
    let left = (p.photons as f64 / photons.max(1) as f64).min(1.0);
    let then = guess + spread * (left.sqrt() + 0.5 * worse * (1.0 - left).sqrt());
    most > tolerance && then <= tolerance
}

/// Whether a pilot has too few photons to tell of light that comes back after many bounces.
fn blind(p: &Pilot, tolerance: f64) -> bool {
    unseen(p, p.reflected.value) > 0.5 * BOUNCES_SHARE * tolerance
}

/// What none of a pilot's photons met may amount to, relative to a share of the light.
fn unseen(p: &Pilot, share: f64) -> f64 {
    UNSEEN / p.photons.max(1) as f64 / share.max(f64::MIN_POSITIVE)
}

/// The exact answer where all interfaces are flat, neither diffuse nor, above the last, absorbing.
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

/// Relative standard error of the reflected energy that a run of so many photons will have, or less: of split photons only
/// the light of several reflections is left to chance, and of that their starts are spread evenly.
fn own_error(pilot: &Pilot, photons: u64, method: Method) -> f64 {
    let ratio = pilot.photons as f64 / photons.max(1) as f64;
    let counted = pilot.reflected.std / pilot.reflected.value.max(f64::MIN_POSITIVE) * ratio.sqrt();
    match method {
        Method::Analog => counted,
        Method::Split => SPLIT_SHARE * counted,
    }
}

/// Why polarisation is part of the question itself.
fn asks_for_polarisation(scene: &Scene, wish: &Wish) -> Option<&'static str> {
    let [_, q, u, v] = scene.light.stokes;
    if scene.run.polarised.as_bool() == Some(true) {
        Some("the scene says so")
    } else if wish.mueller {
        Some("Mueller matrices are asked for")
    } else if [q, u, v] != [0.0; 3] {
        Some("the lamp is polarised")
    } else {
        None
    }
}

fn polarisation(known: &Known, seen: Option<&Pilot>, tolerance: f64) -> Choice {
    let choice = |included: bool, why: String, cost: Option<f64>, basis: Basis| Choice {
        decision: Decision::Polarisation,
        included,
        what: "polarisation of light".to_owned(),
        why,
        cost,
        basis,
    };
    if known.told == Some(false) {
        return choice(false, "the scene says so".to_owned(), None, Basis::Bound);
    }
    if let Some(why) = known.asks {
        return choice(true, why.to_owned(), None, Basis::Exact);
    }
    if known.alone {
        let why =
            "a single reflection of unpolarised light, counted by energy, does not depend on it";
        return choice(false, why.to_owned(), Some(0.0), Basis::Exact);
    }
    if let Some(exact) = &known.stack {
        let with = exact.channel.unpolarised();
        let cost = (exact.scalar / with.max(f64::MIN_POSITIVE) - 1.0).abs();
        let percent = 100.0 * cost;
        let why = format!(
            "the closed answer of flat layers differs by {percent:.2} % without it (unpolarised lamp, energies only)"
        );
        return choice(cost > tolerance, why, Some(cost), Basis::Exact);
    }
    let Some(p) = seen else {
        return choice(
            true,
            "nothing bounds what it would cost".to_owned(),
            None,
            Basis::Bound,
        );
    };
    let (_, cost) = difference(p);
    let percent = 100.0 * cost;
    if cost <= tolerance {
        let why = format!(
            "the lamp is unpolarised and only energies are asked for; {} photons carried both ways differ by no more than {percent:.2} %",
            p.photons
        );
        choice(false, why, Some(cost), Basis::Pilot)
    } else {
        let why = format!(
            "without it the reflected energy would be off by up to {percent:.2} % ({} photons carried both ways)",
            p.photons
        );
        choice(true, why, Some(cost), Basis::Pilot)
    }
}

/// Bounces beyond which next to nothing comes back.
fn bounces(flat: bool, seen: Option<&Pilot>, allowed: f64) -> (Choice, Option<u32>) {
    let choice =
        |included: bool, what: String, why: String, cost: Option<f64>, basis: Basis| Choice {
            decision: Decision::Bounces,
            included,
            what,
            why,
            cost,
            basis,
        };
    if flat {
        let why = "on a flat interface light bounces once".to_owned();
        let what = "bounces within an interface".to_owned();
        return (choice(false, what, why, Some(0.0), Basis::Exact), None);
    }
    let all = "bounces up to run.interactions_max".to_owned();
    let Some(p) = seen else {
        let why = "no tolerance was stated".to_owned();
        return (choice(true, all, why, None, Basis::Bound), None);
    };
    // Late light is seldom: what its few photons say of their own scatter is no bound, and none at all says
    // nothing, so what so many photons may have missed is added.
    let mut beyond = [(0.0, 0.0f64); 2];
    let mut limit = None;
    for order in (0..ORDERS - 1).rev() {
        let mut cost = 0.0f64;
        for (side, all) in [p.reflected, p.transmitted].into_iter().enumerate() {
            let next = p.by_interactions[side][order + 1];
            let (value, std) = &mut beyond[side];
            (*value, *std) = (*value + next.value, std.hypot(next.std));
            // The tolerance is one of the reflected light, however little that is; where nothing was seen to go through,
            // a percentage of it says nothing.
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
                "light that leaves after more than {n} interactions is no more than {:.2} % of what is reflected or goes through",
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
                    "{} photons cannot show less than {:.2} % that comes back late",
                    p.photons,
                    100.0 * least
                )
            } else {
                format!(
                    "more than {:.2} % comes back after {ORDERS} interactions and more",
                    100.0 * allowed
                )
            };
            (choice(true, all, why, None, Basis::Pilot), None)
        }
    }
}

/// n and k of a medium given by numbers; `None` for a name or a diffuse body.
fn number(below: &toml::Value) -> Option<(f64, f64)> {
    let table = below.as_table()?;
    let of = |key: &str| match table.get(key) {
        None => Some(0.0),
        Some(v) => v.as_float().or_else(|| v.as_integer().map(|i| i as f64)),
    };
    (!table.contains_key("rho_d")).then_some((of("n")?, of("k")?))
}

/// Interfaces between equal media, which do nothing to light whatever their shape (1 for the topmost). A
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

fn layers(scene: &Scene, idle: &[usize]) -> Choice {
    let count = scene.interface.len();
    let included = idle.is_empty();
    let (what, why) = if included {
        (
            format!("{count} of {count} interfaces"),
            "each has its own step of the index",
        )
    } else {
        let names: Vec<String> = idle.iter().map(ToString::to_string).collect();
        let why = "the medium is the same above and below: nothing is reflected and nothing turned";
        (format!("interface {}", names.join(", ")), why)
    };
    Choice {
        decision: Decision::Layers,
        included,
        what,
        why: why.to_owned(),
        cost: (!included).then_some(0.0),
        basis: Basis::Exact,
    }
}

/// Makes a plan's decisions those of a run; what the scene itself says of polarisation stands.
pub fn apply(plan: &Plan, scene: &Scene, prepared: &mut Prepared) {
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
