//! With one branch per photon, the energies equal those of splitting for any light of the lamp.

use crate::trace::counting::tally::Energies;
use crate::trace::run::{Shard, trace};
use crate::trace::scene::Scene;

fn energies(
    interfaces: &str,
    stokes: &str,
    method: &str,
) -> Energies<crate::trace::counting::tally::MonteCarloEstimate> {
    let text = format!(
        "[light]\ntheta_i_deg = 70.0\nstokes = {stokes}\n{interfaces}\n[run]\nphotons = 200000\nmethod = \"{method}\"\n"
    );
    let scene = Scene::parse(&text).unwrap();
    let ready = scene.prepare(&|_| Err(String::new())).unwrap();
    trace(&ready, Shard::WHOLE, &|_| true).energies()
}

#[test]
fn metals_absorb_polarised_light_as_with_splitting() {
    let metal = "below = { n = 2.3, k = 2.66 }\n";
    let flat = format!("[[interface]]\nshape = \"flat\"\n{metal}");
    let rough = "shape = \"beckmann\"\nalpha_u = 0.3\nalpha_v = 0.3\ncells = 64\nseed = 3\n";
    let field = format!("[[interface]]\n{rough}{metal}");
    let coated = format!("[[interface]]\n{rough}below = {{ n = 1.5 }}\n{field}");
    for interfaces in [&flat, &field, &coated] {
        for stokes in [
            "[1.0, 1.0, 0.0, 0.0]",
            "[1.0, -1.0, 0.0, 0.0]",
            "[1.0, -0.6, 0.5, 0.3]",
            "[1.0, 0.0, 0.0, 0.0]",
        ] {
            let [a, b] = ["analog", "split"].map(|m| energies(interfaces, stokes, m));
            for (a, b) in [
                (a.reflected_all, b.reflected_all),
                (a.reflected[0], b.reflected[0]),
                (a.reflected[1], b.reflected[1]),
                (a.absorbed, b.absorbed),
            ] {
                let sigma = a.std.hypot(b.std).max(1e-12);
                assert!(
                    (a.value - b.value).abs() < 5.0 * sigma && sigma < 0.01,
                    "{interfaces} {stokes}: {a:?} {b:?}"
                );
            }
        }
    }
}
