//! Laws of the tracer as a whole: energy conservation, reciprocity, correct errors, reproducible
//! bits. Also its comparison with references ([`references`]) and the scenes that it refuses
//! ([`refusals`]).

mod absorbing;
mod analog;
mod references;
mod refusals;
mod stepped;

use super::counting::tally::{MonteCarloEstimate, Totals};
use super::run::{Shard, trace};
use super::scene::{PreparedScene, Scene};
use super::surfaces::height_field::Side;
use crate::model::polarisation::Mueller;

fn prepared(text: &str) -> PreparedScene {
    Scene::parse(text)
        .unwrap()
        .prepare(&|path| Err(format!("no file {path}")))
        .unwrap()
}

fn traced(text: &str) -> Totals {
    trace(&prepared(text), Shard::WHOLE, &|_| true)
}

/// A scene with the lamp at φ = 180°, so that the mirror direction is φ = 0.
fn scene(theta: f64, interfaces: &str, run: &str) -> String {
    format!(
        "[light]\ntheta_i_deg = {theta}\nphi_i_deg = 180.0\nwavelength_nm = 550.0\n{interfaces}\n[run]\n{run}\n"
    )
}

fn interface(shape: &str, below: &str) -> String {
    format!("[[interface]]\n{shape}\nbelow = {below}\n")
}

fn single(theta: f64, shape: &str, below: &str, run: &str) -> Totals {
    traced(&scene(theta, &interface(shape, below), run))
}

#[test]
fn energy_adds_up_to_rounding() {
    let metal = interface(
        "shape = \"beckmann\"\nalpha_u = 0.3\nalpha_v = 0.2\ncells = 64",
        "\"Au\"",
    );
    let layered = interface(
        "shape = \"beckmann\"\nalpha_u = 0.2\nalpha_v = 0.2\ncells = 64\nthickness_um = 10.0",
        "{ n = 1.5, k = 0.0005 }",
    ) + &metal;
    for (interfaces, stokes) in [
        (&metal, "[1.0, 0.0, 0.0, 0.0]"),
        (&layered, "[2.0, 1.0, 0.5, -1.0]"),
    ] {
        for method in ["analog", "split"] {
            let text = scene(
                50.0,
                interfaces,
                &format!("photons = 20000\nmethod = \"{method}\"\ntheta_bins = 9\nphi_bins = 12"),
            )
            .replace(
                "wavelength_nm",
                &format!("stokes = {stokes}\nwavelength_nm"),
            );
            let e = traced(&text).energies();
            let parts = [e.reflected_all, e.transmitted_all, e.absorbed, e.truncated];
            let sum: f64 = parts.iter().map(|p| p.value).sum();
            assert!((sum - 1.0).abs() < 1e-14, "{method}: {sum}");
            let orders: f64 = e.reflected.iter().map(|r| r.value).sum();
            assert!((orders - e.reflected_all.value).abs() < 1e-14);
            assert!(e.absorbed.value > 0.05 && e.truncated.value < 1e-3);
        }
    }
}

#[test]
fn light_that_crosses_hundreds_of_walls_is_split_a_few_times_and_conserved() {
    let shape = "shape = \"beckmann\"\nalpha_u = 8.0\nalpha_v = 8.0\ncells = 32\nseed = 2";
    let run = |method: &str, photons: u32| {
        let run =
            format!("photons = {photons}\nmethod = \"{method}\"\ntheta_bins = 3\nphi_bins = 4");
        single(40.0, shape, "{ n = 2.4 }", &run).energies()
    };
    let (a, b) = (run("analog", 40_000), run("split", 4000));
    for (x, y) in [
        (a.reflected_all, b.reflected_all),
        (a.transmitted_all, b.transmitted_all),
        (a.reflected[1], b.reflected[1]),
    ] {
        let z = (x.value - y.value) / x.std.hypot(y.std);
        assert!(x.std > 0.0 && z.abs() < 4.5, "{x:?} {y:?}");
    }
    assert!(b.reflected_all.value > 2e-3 && b.truncated.value < 1e-3);
}

#[test]
fn variance_reduction_does_not_move_the_result() {
    let layers = interface(
        "shape = \"beckmann\"\nalpha_u = 0.4\nalpha_v = 0.4\ncells = 64\nseed = 3",
        "{ n = 1.5 }",
    ) + &interface(
        "shape = \"beckmann\"\nalpha_u = 0.3\nalpha_v = 0.3\ncells = 64\nseed = 4",
        "\"Cu550\"",
    );
    let run = |method: &str, seed| {
        traced(&scene(
            60.0,
            &layers,
            &format!(
                "photons = 60000\nseed = {seed}\nmethod = \"{method}\"\ntheta_bins = 9\nphi_bins = 12"
            ),
        ))
    };
    let (a, b) = (run("analog", 1), run("split", 2));
    let (ea, eb) = (a.energies(), b.energies());
    for (x, y) in [
        (ea.reflected_all, eb.reflected_all),
        (ea.absorbed, eb.absorbed),
        (ea.reflected[0], eb.reflected[0]),
        (ea.reflected[2], eb.reflected[2]),
        (ea.reflected[4], eb.reflected[4]),
    ] {
        let z = (x.value - y.value) / x.std.hypot(y.std);
        assert!(z.abs() < 4.0, "{x:?} {y:?}");
    }
    let chi = chi_square(&a, &b, 50);
    assert!(chi.within(4.0), "{chi:?}");
    assert!(smallest_cloude_share(&b) > -1e-12);
}

#[test]
fn rough_and_diffuse_facets_agree_between_the_methods() {
    use super::scene::HeightMap;
    // Such a facet scatters in all directions: none of its light is known without sampling, not
    // even on a height field.
    let waves = |path: &str| {
        let height =
            |n: usize| 0.6 * ((n % 32) as f64 * 0.59).sin() + 0.5 * ((n / 32) as f64 * 0.39).cos();
        assert_eq!(path, "waves.csv");
        Ok(HeightMap::new(32, (0..32 * 32).map(height).collect()))
    };
    let file = "shape = \"file\"\npath = \"waves.csv\"\npitch_um = 1.0\nheight_unit_um = 1.0";
    let rough = interface(
        &format!("{file}\nalpha_u = 0.3\nalpha_v = 0.2"),
        "\"Au550\"",
    );
    for interfaces in [rough, interface(file, "{ n = 1.5, rho_d = 0.3 }")] {
        let [a, b] = ["analog", "split"].map(|method| {
            let run =
                format!("photons = 40000\nmethod = \"{method}\"\ntheta_bins = 9\nphi_bins = 12");
            let scene = Scene::parse(&scene(45.0, &interfaces, &run)).unwrap();
            let totals = trace(&scene.prepare(&waves).unwrap(), Shard::WHOLE, &|_| true);
            totals.energies()
        });
        for (x, y) in [
            (a.reflected_all, b.reflected_all),
            (a.absorbed, b.absorbed),
            (a.reflected[0], b.reflected[0]),
            (a.reflected[1], b.reflected[1]),
        ] {
            let z = (x.value - y.value) / x.std.hypot(y.std);
            assert!(z.abs() < 4.0, "{x:?} {y:?}");
        }
        assert!(a.transmitted_all.value == 0.0 && b.transmitted_all.value == 0.0);
    }
}

/// The minimum over all bins that light reached.
fn smallest_cloude_share(totals: &Totals) -> f64 {
    let mut smallest = f64::INFINITY;
    for side in [Side::Above, Side::Below] {
        for bin in 0..totals.grid().per_side() {
            if !totals.is_empty(side, bin) {
                let values: Vec<f64> = (0..16)
                    .map(|i| totals.element(side, bin, i).value)
                    .collect();
                let m = Mueller(nalgebra::Matrix4::from_row_slice(&values));
                smallest = smallest.min(m.smallest_cloude_share());
            }
        }
    }
    smallest
}

#[derive(Debug)]
struct Chi {
    mean: f64,
    n: f64,
}

impl Chi {
    fn within(&self, k: f64) -> bool {
        self.n > 20.0 && (self.mean - 1.0).abs() < k * (2.0 / self.n).sqrt()
    }
}

/// Σ (a − b)²/(σa² + σb²)/n over m00 of the reflected bins with at least `hits` hits in each run.
///
/// For bins much wider than this limit requires: selecting by the smaller of two numbers prefers
/// bins in which both happen to agree, so if many bins are near the limit the mean is too low (0.9
/// at 50 hits for an average of 40).
fn chi_square(a: &Totals, b: &Totals, hits: u64) -> Chi {
    let (mut sum, mut n) = (0.0, 0.0);
    for bin in 0..a.grid().per_side() {
        if a.hits(Side::Above, bin).min(b.hits(Side::Above, bin)) >= hits {
            let (x, y) = (
                a.element(Side::Above, bin, 0),
                b.element(Side::Above, bin, 0),
            );
            sum += (x.value - y.value).powi(2) / (x.std * x.std + y.std * y.std);
            n += 1.0;
        }
    }
    Chi { mean: sum / n, n }
}

const ROUGH_GLASS: &str =
    "shape = \"beckmann\"\nalpha_u = 0.4\nalpha_v = 0.4\nseed = 1\ncells = 200";

#[test]
fn two_seeds_differ_by_their_errors_and_every_matrix_is_physical() {
    for method in ["analog", "split"] {
        let run = |seed| {
            single(
                45.0,
                ROUGH_GLASS,
                "\"Au\"",
                &format!(
                    "photons = 300000\nseed = {seed}\nmethod = \"{method}\"\ntheta_bins = 18\nphi_bins = 36"
                ),
            )
        };
        let (a, b) = (run(1), run(2));
        let chi = chi_square(&a, &b, 50);
        assert!(chi.within(4.0), "{method}: {chi:?}");
        assert!(smallest_cloude_share(&a) > -1e-12);
    }
}

#[test]
fn all_orders_of_reflection_off_flat_layers_leave_in_one_direction() {
    // 20°, 30° and 50° are edges of the 2° bins.
    let stack =
        interface("shape = \"flat\"", "{ n = 1.5 }") + &interface("shape = \"flat\"", "\"Au550\"");
    for method in ["analog", "split"] {
        for theta in [0.0, 20.0, 30.0, 50.0] {
            let run = format!("photons = 2000\nmethod = \"{method}\"");
            let totals = traced(&scene(theta, &stack, &run));
            let bins = 0..totals.grid().per_side();
            let lit: Vec<usize> = bins.filter(|b| !totals.is_empty(Side::Above, *b)).collect();
            assert_eq!(lit.len(), 1, "{method} {theta}: {lit:?}");
        }
    }
}

#[test]
fn rounded_edges_reflect_like_thousands_of_flat_pieces() {
    use super::scene::HeightMap;
    const PIECES: usize = 2400;
    let (sin, cos) = 15f64.to_radians().sin_cos();
    let (down, up, round) = ((cos, -sin), (sin, cos), 0.8);
    let mut heights = Vec::new();
    for (corner, a, b) in [
        ((0.0, 0.0), up, down),
        ((10.0 * cos, -10.0 * sin), down, up),
        ((10.0 / cos, 0.0), up, down),
    ] {
        // A period ends at the height of its start.
        let last = if corner.0 > 10.0 { 0 } else { PIECES };
        for step in 0..=last {
            let turned = std::f64::consts::FRAC_PI_2 * step as f64 / PIECES as f64;
            let (s, c) = (turned.sin() - 1.0, 1.0 - turned.cos());
            heights.push(corner.0 + round * (s * a.0 + c * b.0));
            heights.push(corner.1 + round * (s * a.1 + c * b.1));
        }
    }
    let fine = |_: &str| Ok(HeightMap::new(2, heights.clone()));
    let ridges = "shape = \"ridges\"\ntheta_r_deg = 15.0\npitch_um = 10.0\nround_um = 0.8";
    for alpha in ["", "\nalpha_u = 0.02\nalpha_v = 0.02"] {
        let [a, b] = [ridges, "shape = \"profile\"\npath = \"fine.csv\""].map(|shape| {
            let run = "photons = 300000\ntheta_bins = 30\nphi_bins = 4";
            let text = scene(
                20.0,
                &interface(&format!("{shape}{alpha}"), "\"Au550\""),
                run,
            );
            let scene = Scene::parse(&text.replace("180.0", "45.0")).unwrap();
            let scene = scene.prepare(&fine).unwrap();
            trace(&scene, Shard::WHOLE, &|_| true)
        });
        let mut compared = 0;
        for bin in 0..a.grid().per_side() {
            let [x, y] = [&a, &b].map(|t| t.element(Side::Above, bin, 0));
            if a.hits(Side::Above, bin) + b.hits(Side::Above, bin) < 400 {
                continue;
            }
            // A bin contains the reflections of 40 fine pieces, plus or minus one.
            let sigma = x.std.hypot(y.std) + 0.01 * y.value;
            assert!(
                (x.value - y.value).abs() < 4.5 * sigma,
                "{bin}: {x:?} {y:?}"
            );
            compared += 1;
        }
        assert!(compared > 20, "{compared}");
    }
}

#[test]
fn the_error_falls_with_the_square_root_of_the_photons() {
    // Also if most bins are almost empty: 5000 photons in 8100 bins.
    for (method, bins) in [
        ("analog", "theta_bins = 9\nphi_bins = 12"),
        ("split", "theta_bins = 9\nphi_bins = 12"),
        ("analog", "theta_bins = 45\nphi_bins = 180"),
    ] {
        let error = |photons: u64| {
            single(
                45.0,
                ROUGH_GLASS,
                "{ n = 1.5 }",
                &format!("photons = {photons}\nmethod = \"{method}\"\n{bins}"),
            )
            .relative_error()
            .unwrap()
        };
        let slope = (error(160_000) / error(5_000)).ln() / 32f64.ln();
        assert!(slope < -0.45, "{method} {bins}: {slope}");
        // Strata can only make it steeper. A variance from 64 replicates is known to 18 %, in the
        // worst case common to few bins: each error to 9 %, the slope to 0.04.
        assert!(slope > -0.75, "{method} {bins}: {slope}");
    }
}

#[test]
fn polarisation_does_not_change_singly_scattered_unpolarised_light() {
    let run = |polarised: bool| {
        single(
            60.0,
            "shape = \"beckmann\"\nalpha_u = 0.1\nalpha_v = 0.1\nseed = 2\ncells = 128",
            "{ n = 1.5 }",
            &format!("photons = 100000\npolarised = {polarised}"),
        )
    };
    let (a, b) = (run(true), run(false));
    // The same photons, and both branches are followed at the first hit: R1 is the same number.
    let (r, s) = (a.energies().reflected[0], b.energies().reflected[0]);
    assert!((r.value - s.value).abs() < 1e-12, "{r:?} {s:?}");
}

#[test]
fn exchanging_lamp_and_camera_gives_the_reciprocal_matrix() {
    // M(i → o) = O M(o → i)ᵀ O on the same surface. Both directions are bin centres; the effect of
    // the bin's size is of second order and far below the errors at α = 0.4.
    let bins = "theta_bins = 18\nphi_bins = 36\nphotons = 150000";
    let layers = interface(ROUGH_GLASS, "{ n = 1.5 }")
        + &interface(
            "shape = \"beckmann\"\nalpha_u = 0.4\nalpha_v = 0.4\nseed = 9\ncells = 200",
            "\"Al550\"",
        );
    let run = |theta: f64, phi: f64| {
        let text = scene(theta, &layers, bins).replace("180.0", &format!("{phi}"));
        traced(&text)
    };
    let (ti, pi, to, po) = (32.5f64, 5.0f64, 57.5f64, 235.0f64);
    let (there, back) = (run(ti, pi), run(to, po));
    let direction = |t: f64, p: f64| {
        let (s, c) = t.to_radians().sin_cos();
        let (sp, cp) = p.to_radians().sin_cos();
        [s * cp, s * sp, c]
    };
    let matrix = |totals: &Totals, t, p| {
        let bin = totals.grid().bin(Side::Above, &direction(t, p));
        let e: Vec<MonteCarloEstimate> = (0..16)
            .map(|i| totals.element(Side::Above, bin, i))
            .collect();
        e
    };
    let (a, b) = (matrix(&there, to, po), matrix(&back, ti, pi));
    for i in 0..4 {
        for j in 0..4 {
            let sign = if (i == 2) == (j == 2) { 1.0 } else { -1.0 };
            let (x, y) = (&a[4 * i + j], &b[4 * j + i]);
            let z = (x.value - sign * y.value) / (x.std.hypot(y.std) + 1e-3 * a[0].value);
            assert!(z.abs() < 4.5, "m{i}{j}: {x:?} {y:?}");
        }
    }
}

#[test]
fn shards_add_up_to_the_whole_bit_by_bit() {
    let text = scene(
        45.0,
        &interface(
            "shape = \"beckmann\"\nalpha_u = 0.4\nalpha_v = 0.4\ncells = 64",
            "{ n = 1.5 }",
        ),
        "photons = 10007",
    );
    let prepared = prepared(&text);
    let whole = trace(&prepared, Shard::WHOLE, &|_| true);
    assert_eq!(whole.photons(), 10_007);
    let mut sum = Totals::new(whole.grid(), whole.elements());
    for number in [3, 1, 2] {
        sum.merge(&trace(&prepared, Shard { number, of: 3 }, &|_| true))
            .unwrap();
    }
    assert_eq!(sum, whole);
    let one_thread = rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .build()
        .unwrap();
    assert_eq!(
        one_thread.install(|| trace(&prepared, Shard::WHOLE, &|_| true)),
        whole
    );
}
