//! Tests of the effects that the plan of a scene omits.

use super::*;
use crate::trace::counting::tally::MonteCarloEstimate;
use crate::trace::run::{Shard, trace};

fn planned(text: &str, request: &TracePlanRequest) -> ComputationPlan {
    let scene = Scene::parse(text).unwrap();
    let prepared = scene.prepare(&|_| Err(String::new())).unwrap();
    plan(&scene, &prepared, request)
}

const ENERGY: TracePlanRequest = TracePlanRequest {
    mueller: false,
    tolerance: 0.01,
    photons: None,
};

fn smooth(theta_deg: f64, below: &str) -> String {
    format!(
        "[light]\ntheta_i_deg = {theta_deg:?}\n[[interface]]\nshape = \"flat\"\nbelow = {{ n = 1.5 }}\n\
         [[interface]]\nshape = \"flat\"\nbelow = {below}\n[run]\nphotons = 200000\n"
    )
}

#[test]
fn polarisation_is_out_where_light_is_reflected_once_and_in_for_layers_near_brewster() {
    let once = planned(
        "[[interface]]\nshape = \"flat\"\nbelow = { n = 1.5 }\n",
        &ENERGY,
    );
    let choice = once.on(Decision::Polarisation).unwrap();
    assert!(!choice.included && choice.cost == Some(0.0) && choice.basis == Basis::Exact);
    let brewster = planned(&smooth(60.0, "{ n = 2.4 }"), &ENERGY);
    let choice = brewster.on(Decision::Polarisation).unwrap();
    // For flat layers the cost in the plan is exact.
    let stack = FlatStack::parse("1.5/2.4").unwrap();
    let exact = stack.reflect(60f64.to_radians()).unwrap();
    let off = (exact.channel.unpolarised() / exact.scalar - 1.0).abs();
    assert!(choice.included && off > 0.01, "{choice:?} {off}");
    assert!(
        choice.cost.unwrap() >= off && choice.cost.unwrap() < 1.5 * off,
        "{choice:?} {off}"
    );
    let straight = planned(&smooth(5.0, "\"Au\""), &ENERGY);
    assert!(
        !straight.on(Decision::Polarisation).unwrap().included,
        "{straight:?}"
    );
}

#[test]
fn a_pilot_with_few_double_reflections_keeps_polarisation() {
    // Few photons on ridges are reflected twice; split photons resolve that light.
    for seed in [1, 22, 30] {
        let scene = format!(
            "[light]\ntheta_i_deg = 45.0\nphi_i_deg = 70.0\n[[interface]]\nshape = \"ridges\"\ntheta_r_deg = 15.0\n\
             pitch_um = 100.0\nround_um = 3.0\nbelow = {{ n = 1.5 }}\n[run]\nseed = {seed}\nphotons = 1000000\n"
        );
        let request = TracePlanRequest {
            photons: Some(1_000_000),
            ..ENERGY
        };
        let plan = planned(&scene, &request);
        assert!(
            plan.on(Decision::Polarisation).unwrap().included,
            "{plan:?}"
        );
    }
}

#[test]
fn mueller_matrices_keep_polarisation() {
    let request = TracePlanRequest {
        mueller: true,
        ..ENERGY
    };
    let plan = planned(
        "[[interface]]\nshape = \"flat\"\nbelow = { n = 1.5 }\n",
        &request,
    );
    assert!(plan.on(Decision::Polarisation).unwrap().included);
}

#[test]
fn an_interface_between_equal_media_is_omitted_without_effect() {
    let text = smooth(40.0, "{ n = 1.5 }");
    let plan = planned(&text, &ENERGY);
    let choice = plan.on(Decision::Layers).unwrap();
    assert!(!choice.included && choice.what == "interface 2");
    // The remaining interface keeps its number and thus its surface.
    let ridges = "[[interface]]\nshape = \"ridges\"\ntheta_r_deg = 20.0\npitch_um = 10.0\nburr_um = 0.2\n\
                  below = { n = 1.5 }\n";
    let rough_air = "[[interface]]\nshape = \"beckmann\"\nalpha_u = 0.1\nalpha_v = 0.1\ncells = 16\nbelow = { n = 1.0 }\n";
    let text = |first: &str| {
        format!("[light]\ntheta_i_deg = 45.0\n{first}{ridges}[run]\nphotons = 3000\n")
    };
    let scene = Scene::parse(&text(rough_air)).unwrap();
    let plan = super::plan(
        &scene,
        &scene.prepare(&|_| Err(String::new())).unwrap(),
        &ENERGY,
    );
    assert_eq!(plan.idle_interfaces, [1]);
    let mut prepared = scene.prepare(&|_| Err(String::new())).unwrap();
    let whole = prepared.clone();
    apply(&plan, &scene, &mut prepared);
    let numbers =
        |p: &PreparedScene| -> Vec<usize> { p.ridge_angles.iter().map(|a| a.interface).collect() };
    assert_eq!((numbers(&prepared), numbers(&whole)), (vec![2], vec![1, 2]));
    let layers = |p: &PreparedScene| p.left_out.iter().any(|l| l.what.contains("registration"));
    assert!(layers(&whole) && !layers(&prepared));
    let traced = |p: &PreparedScene| trace(p, Shard::WHOLE, &|_| true).energies().reflected_all;
    let (with, without) = (traced(&whole), traced(&prepared));
    let std = with.std.hypot(without.std);
    assert!(
        std < 0.01 && (with.value - without.value).abs() < 4.0 * std,
        "{with:?} {without:?}"
    );
}

#[test]
fn without_a_stated_tolerance_nothing_costs_more_than_the_noise_of_the_run() {
    let request = TracePlanRequest {
        photons: Some(1_000_000_000),
        ..ENERGY
    };
    let plan = planned(&smooth(30.0, "{ n = 2.4 }"), &request);
    assert!(plan.tolerance < 1e-3);
    assert!(
        plan.on(Decision::Polarisation).unwrap().included,
        "{plan:?}"
    );
}

#[test]
fn layers_over_a_metal_keep_polarisation_where_the_run_would_notice() {
    // Splitting at every layer makes the reflected share far more exact than the number of photons suggests.
    let flat = |below: &str| format!("[[interface]]\nshape = \"flat\"\nbelow = {below}\n");
    let layers: String = (0..29)
        .map(|j| {
            flat(if j % 2 == 0 {
                "{ n = 1.7 }"
            } else {
                "{ n = 1.3 }"
            })
        })
        .collect();
    let metal = flat("{ n = 0.3504, k = 2.7141 }");
    let text =
        format!("[light]\ntheta_i_deg = 45.0\n{layers}{metal}[run]\nphotons = 2000\nseed = 7\n");
    let request = TracePlanRequest {
        photons: Some(2000),
        ..ENERGY
    };
    let plan = planned(&text, &request);
    let choice = plan.on(Decision::Polarisation).unwrap();
    assert!(choice.cost.unwrap() > 2e-3 && choice.included, "{plan:?}");
}

/// A pilot with these reflected and transmitted shares by number of interactions.
fn saw(photons: u64, reflected: &[f64], transmitted: &[f64]) -> Pilot {
    let exactly = |value: f64| MonteCarloEstimate { value, std: 0.0 };
    let all = |shares: &[f64]| exactly(shares.iter().sum());
    let each = |shares: &[f64]| {
        std::array::from_fn(|n| exactly(shares.get(n).copied().unwrap_or_default()))
    };
    Pilot {
        photons,
        reflected: all(reflected),
        transmitted: all(transmitted),
        reflected_difference: exactly(0.0),
        transmitted_difference: exactly(0.0),
        by_interactions: [each(reflected), each(transmitted)],
    }
}

#[test]
fn late_light_is_relative_to_the_reflected_light() {
    let kept = |pilot: &Pilot, allowed: f64| bounces(false, Some(pilot), allowed).1;
    // A tenth of the weak reflection returns after two interactions: only a thousandth of all light, but too much.
    let weak = saw(100_000_000, &[9e-3, 1e-3, 1e-6], &[0.98, 0.009]);
    assert_eq!(kept(&weak, 0.005), Some(2));
    assert_eq!(kept(&weak, 0.2), Some(1));
    // The same holds for transmitted light, unless none is transmitted.
    let through = saw(100_000_000, &[0.5, 1e-6], &[0.4, 0.05, 0.049, 1e-6]);
    assert_eq!(kept(&through, 0.01), Some(3));
    let metal = saw(100_000_000, &[0.5, 1e-6], &[]);
    assert_eq!(kept(&metal, 0.01), Some(1));
    // Where all light is late, none of it can be omitted.
    let trapped = saw(100_000_000, &[0.05; ORDERS], &[]);
    assert_eq!(kept(&trapped, 0.01), None);
}

#[test]
fn few_photons_do_not_bound_late_light() {
    // Three photons in a thousand may be unseen: 30 % of a reflection of 1 %.
    let few = saw(1000, &[0.01], &[0.99]);
    let (choice, limit) = bounces(false, Some(&few), 0.05);
    assert!(limit.is_none() && choice.included, "{choice:?}");
    assert!(
        choice
            .why
            .contains("the 1000-photon pilot cannot resolve late light below 30.00 %"),
        "{}",
        choice.why
    );
    let many = saw(100_000, &[0.01], &[0.99]);
    let (choice, limit) = bounces(false, Some(&many), 0.05);
    assert_eq!(limit, Some(1));
    let cost = choice.cost.unwrap();
    assert!(!choice.included && (0.003..0.05).contains(&cost), "{cost}");
}
