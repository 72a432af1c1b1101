//! Absorbing layers compared with the exact recursion for flat ones, which uses the complex indices
//! on both sides of each boundary.

use nalgebra::Complex;

use super::references::{all_reflected, deviation};
use super::{interface, scene, traced};
use crate::model::polarisation::Boundary;
use crate::trace::counting::tally::MonteCarloEstimate;
use crate::trace::run::{Shard, trace};

type C = Complex<f64>;

/// Reflected powers of s and p and the factor z of a stack: the coherent result averaged over the
/// phase of each layer. Layers are (index, thickness in µm); the last one is the substrate.
fn recursion(above: f64, layers: &[(C, f64)], theta_deg: f64) -> (f64, f64, C) {
    let along = above * theta_deg.to_radians().sin();
    let media: Vec<C> = std::iter::once(C::new(above, 0.0))
        .chain(layers.iter().map(|l| l.0))
        .collect();
    let across: Vec<C> = media
        .iter()
        .map(|n| (n * n - along * along).sqrt())
        .collect();
    let [mut s, mut p, mut z] = [C::new(0.0, 0.0); 3];
    for j in (0..layers.len()).rev() {
        let (a, b, qa, qb) = (media[j], media[j + 1], across[j], across[j + 1]);
        let r_s = (qa - qb) / (qa + qb);
        let r_p = (b * b * qa - a * a * qb) / (b * b * qa + a * a * qb);
        // Two passes through the layer below, as a power.
        let fades = if j + 1 < layers.len() {
            let phase = 2.0 * std::f64::consts::TAU / 0.55 * layers[j].1;
            (-2.0 * phase * qb.im).exp()
        } else {
            0.0
        };
        let under = |x: C, y: C, below: C| {
            let (r, t) = (x * y.conj(), (1.0 - x * x) * (1.0 - y * y).conj());
            r + t * below * fades / (1.0 - r * below * fades)
        };
        (s, p, z) = (under(r_s, r_s, s), under(r_p, r_p, p), under(r_s, r_p, z));
    }
    (s.re, p.re, z)
}

#[test]
fn absorbing_layers_agree_with_the_exact_recursion_within_the_stated_cost() {
    let n = C::new;
    let gold = (n(0.3504, 2.7141), 0.0);
    let mut deviations = Vec::new();
    for (above, layers) in [
        (1.0, vec![(n(1.5, 2e-3), 8.0), gold]),
        (1.0, vec![(n(1.5, 0.05), 1.0), gold]),
        // Attenuated total reflection: without k all light beyond 60.07° would return.
        (1.5, vec![(n(1.3, 0.013), 5.0), gold]),
        // Only k differs.
        (1.0, vec![(n(1.0, 0.01), 5.0), gold]),
        (
            1.0,
            vec![
                (n(1.3, 1e-3), 9.0),
                (n(1.6, 0.02), 2.0),
                (n(2.4, 0.0), 1.0),
                gold,
            ],
        ),
        (1.0, vec![(n(1.7, 1e-3), 9.0), (n(1.5, 0.0), 0.0)]),
    ] {
        for theta_deg in [0.0, 30.0, 58.0, 61.0, 75.0, 88.0] {
            let last = layers.len() - 1;
            let interfaces: String = layers
                .iter()
                .enumerate()
                .map(|(j, (index, thickness_um))| {
                    let thick = if j < last {
                        format!("\nthickness_um = {thickness_um:?}")
                    } else {
                        String::new()
                    };
                    let below = format!("{{ n = {:?}, k = {:?} }}", index.re, index.im);
                    interface(&format!("shape = \"flat\"{thick}"), &below)
                })
                .collect();
            let run = "photons = 8192\ntheta_bins = 9\nphi_bins = 12";
            let text = format!("n_top = {above:?}\n{}", scene(theta_deg, &interfaces, run));
            let totals = traced(&text);
            let prepared = super::prepared(&text);
            let stated: f64 = prepared
                .left_out
                .iter()
                .filter(|l| l.what.contains("interference next to"))
                .filter_map(|l| l.cost)
                .sum();
            let (s, p, z) = recursion(above, &layers, theta_deg);
            for (i, expected) in [
                (0, 0.5 * (s + p)),
                (1, 0.5 * (s - p)),
                (10, z.re),
                (11, z.im),
            ] {
                let found = all_reflected(&totals, i);
                let off = (found.value - expected).abs();
                let beyond = deviation(&found, expected);
                assert!(
                    off < stated || beyond < 5.0,
                    "{above} {layers:?} {theta_deg}° m{i}: {found:?}, not {expected}; {stated} was stated"
                );
                deviations.push(off);
            }
            let e = totals.energies();
            let parts = [e.reflected_all, e.transmitted_all, e.absorbed, e.truncated];
            assert!((parts.iter().map(|p| p.value).sum::<f64>() - 1.0).abs() < 1e-13);
        }
    }
    // Real indices at the boundaries would be wrong by up to 0.4 at 61° in glass, and completely
    // where only k differs.
    let worst = deviations.iter().copied().fold(0.0, f64::max);
    assert!(worst < 5e-3, "{worst}");
}

#[test]
fn light_in_rough_absorbing_layers_is_conserved_by_both_methods() {
    // Light under total reflection from inside, steep facets, thin layers: analog and split photons
    // agree.
    let layers = interface(
        "shape = \"beckmann\"\nalpha_u = 0.5\nalpha_v = 0.5\ncells = 64\nthickness_um = 0.3",
        "{ n = 1.6, k = 0.02 }",
    ) + &interface(
        "shape = \"beckmann\"\nalpha_u = 0.6\nalpha_v = 0.3\ncells = 64\nthickness_um = 2.0",
        "{ n = 1.2, k = 0.005 }",
    ) + &interface(
        "shape = \"smith\"\nalpha_u = 0.4\nalpha_v = 0.4",
        "\"Au550\"",
    );
    let run = |method: &str| {
        let run = format!("photons = 40000\nmethod = \"{method}\"\ntheta_bins = 9\nphi_bins = 12");
        let prepared = super::prepared(&scene(50.0, &layers, &run));
        trace(&prepared, Shard::WHOLE, &|_| true).energies()
    };
    let (a, b) = (run("analog"), run("split"));
    for (x, y) in [
        (a.reflected_all, b.reflected_all),
        (a.absorbed, b.absorbed),
        (a.reflected[0], b.reflected[0]),
        (a.reflected[2], b.reflected[2]),
        (a.reflected[4], b.reflected[4]),
    ] {
        let z = (x.value - y.value) / x.std.hypot(y.std);
        assert!(z.abs() < 4.5, "{x:?} {y:?}");
    }
    for e in [a, b] {
        let sum = e.reflected_all.value + e.absorbed.value + e.truncated.value;
        assert!((sum - 1.0).abs() < 1e-13 && e.truncated.value < 1e-3);
    }
}

/// Settings of the run for both methods, with and without polarisation.
fn runs(photons: u32) -> impl Iterator<Item = (bool, String)> {
    ["analog", "split"].into_iter().flat_map(move |method| {
        [true, false].map(|polarised| {
            let run = format!(
                "photons = {photons}\nmethod = \"{method}\"\npolarised = {polarised}\ntheta_bins = 9\nphi_bins = 12"
            );
            (polarised, run)
        })
    })
}

/// The thickness in µm at which a layer of k has the optical depth `depth` at the wavelength of the scenes.
fn thickness_um(k: f64, depth: f64) -> f64 {
    depth * 0.55 / (4.0 * std::f64::consts::PI * k)
}

fn agrees(found: &MonteCarloEstimate, expected: f64, tolerance: f64, what: &str) {
    let off = (found.value - expected).abs();
    assert!(
        off < 5.0 * found.std + tolerance && found.std < 0.01,
        "{what}: {found:?}, not {expected}"
    );
}

#[test]
fn an_absorbing_slab_transmits_by_beer_s_law_and_fresnel_s_equations() {
    let theta_deg = 30.0_f64;
    let sin = theta_deg.to_radians().sin() / 1.5;
    let slant = 1.0 / (1.0 - sin * sin).sqrt();
    let entry = Boundary::new(1.0, 1.5, 0.0);
    let reflected = entry.at(theta_deg.to_radians().cos()).reflected;
    // Without k, in the limit of k, and with optical depths up to 2.3 as of 1 mm of k = 1e-4.
    for (k, depth) in [
        (0.0, 0.0),
        (1e-12, 2e-8),
        (1e-6, 0.02),
        (1e-5, 0.7),
        (1e-4, 2.3),
    ] {
        let thick = if k > 0.0 { thickness_um(k, depth) } else { 9.0 };
        let slab = interface(
            &format!("shape = \"flat\"\nthickness_um = {thick:?}"),
            &format!("{{ n = 1.5, k = {k:?} }}"),
        ) + &interface("shape = \"flat\"", "{ n = 1.0 }");
        let kept = (-depth * slant).exp();
        // Both faces reflect the same share; light crosses the slab any number of times.
        let passes = |r: f64| (1.0 - r).powi(2) * kept / (1.0 - (r * kept).powi(2));
        let returns = |r: f64| r + passes(r) * r * kept;
        for (polarised, run) in runs(20_000) {
            let shares = match polarised {
                true => [reflected.s, reflected.p],
                false => [reflected.unpolarised(); 2],
            };
            let mean = |of: &dyn Fn(f64) -> f64| shares.map(of).iter().sum::<f64>() / 2.0;
            let e = traced(&scene(theta_deg, &slab, &run)).energies();
            let what = format!("k = {k}, {run}");
            agrees(&e.transmitted_all, mean(&passes), 1e-6, &what);
            agrees(&e.reflected_all, mean(&returns), 1e-6, &what);
        }
    }
}

#[test]
fn light_totally_reflected_below_a_layer_of_vanishing_absorption_returns() {
    let layer = interface(
        "shape = \"flat\"\nthickness_um = 10.0",
        "{ n = 1.5, k = 1e-12 }",
    ) + &interface("shape = \"flat\"", "{ n = 1.0 }");
    for (_, run) in runs(2000) {
        let text = format!("n_top = 1.5\n{}", scene(60.0, &layer, &run));
        let e = traced(&text).energies();
        agrees(&e.reflected_all, 1.0, 1e-6, &run);
        agrees(&e.transmitted_all, 0.0, 1e-12, &run);
    }
}

#[test]
fn a_diffuse_body_below_an_absorbing_layer_returns_what_the_layer_lets_pass() {
    // No boundary reflects: the layer's light goes down at one angle and up at all angles.
    for (k, depth) in [(1e-12, 2e-8), (1e-5, 0.3), (1e-4, 1.5)] {
        let thick = thickness_um(k, depth);
        let interfaces = interface(
            &format!("shape = \"flat\"\nthickness_um = {thick:?}"),
            &format!("{{ n = 1.0, k = {k:?} }}"),
        ) + &interface("shape = \"flat\"", "{ n = 1.0, rho_d = 0.8 }");
        let steps = 10_000;
        let upwards: f64 = (0..steps)
            .map(|j| (f64::from(j) + 0.5) / f64::from(steps))
            .map(|mu| 2.0 * mu * (-depth / mu).exp() / f64::from(steps))
            .sum();
        let down = (-depth / 40f64.to_radians().cos()).exp();
        for (_, run) in runs(20_000) {
            let e = traced(&scene(40.0, &interfaces, &run)).energies();
            let what = format!("k = {k}, {run}");
            agrees(&e.reflected_all, 0.8 * down * upwards, 1e-6, &what);
        }
    }
    // Below glass, in the limit of k: as without absorption.
    let over = |k: &str, run: &str| {
        let interfaces = interface(
            "shape = \"flat\"\nthickness_um = 10.0",
            &format!("{{ n = 1.5, k = {k} }}"),
        ) + &interface(
            "shape = \"smith\"\nalpha_u = 0.2\nalpha_v = 0.2",
            "{ n = 1.6, rho_d = 0.8 }",
        );
        traced(&scene(30.0, &interfaces, run))
            .energies()
            .reflected_all
    };
    for (_, run) in runs(20_000) {
        let (clear, limit) = (over("0.0", &run), over("1e-9", &run));
        let sigma = clear.std.hypot(limit.std);
        assert!(
            (clear.value - limit.value).abs() < 5.0 * sigma && limit.value > 0.5,
            "{run}: {clear:?} {limit:?}"
        );
    }
}
