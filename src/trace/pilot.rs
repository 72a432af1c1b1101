//! A short run that carries both kinds of light along the same paths, to find what may be left out.
//!
//! Call [`pilot`]. Polarised and scalar light hit the same facets with the same random numbers, so
//! their difference is much more accurate than either, with few photons.

use pulp::Simd;

use super::counting::grid::DirectionGrid;
use super::counting::tally::{MonteCarloEstimate, ORDERS};
use super::photons::interface::Relief;
use super::photons::light::{ELEMENTS_MAX, Leaving, PhotonState, Polarised, ScalarState, Turn};
use super::run::trace_briefly;
use super::scene::PreparedScene;
use super::surfaces::height_field::Side;
use super::vec3::V3;
use crate::model::lanes::Lane;
use crate::model::polarisation::Channel;

/// Scalar light accompanied by polarised light of the same lamp.
#[derive(Debug, Clone, Copy)]
struct Accompanied {
    scalar: ScalarState,
    polarised: Polarised,
}

impl PhotonState for Accompanied {
    /// The scalar weight, and the difference of the polarised one from it.
    const ELEMENTS: usize = 2;

    fn launch(s: &V3) -> Self {
        Accompanied {
            scalar: ScalarState::launch(s),
            polarised: Polarised::launch(s),
        }
    }
    fn weight(&self) -> f64 {
        self.scalar.weight()
    }
    fn power(&self, stokes: &[f64; 4]) -> f64 {
        self.scalar.power(stokes)
    }
    fn meet(&mut self, k: &V3, m: &V3) {
        self.polarised.meet(k, m);
    }
    /// Both take the path of scalar light: any probability is correct for both.
    fn share(&self, channel: &Channel) -> f64 {
        self.scalar.share(channel)
    }
    fn pass(&mut self, channel: &Channel, factor: f64) {
        self.scalar.pass(channel, factor);
        self.polarised.pass(channel, factor);
    }
    fn depolarise(&mut self, s: &V3) {
        self.polarised.depolarise(s);
    }
    fn scale(&mut self, factor: f64) {
        self.scalar.scale(factor);
        self.polarised.scale(factor);
    }
    fn leave(&mut self, k: &V3, straight: &V3) {
        self.polarised.leave(k, straight);
    }
    fn turn(&mut self, turn: &Turn) {
        self.polarised.turn(turn);
    }
    fn add_to(&self, bin: &mut [f64]) {
        bin[0] += self.scalar.weight();
        bin[1] += self.polarised.weight() - self.scalar.weight();
    }
    #[inline(always)]
    fn leaves_each<S: Simd>(hits: &Leaving<S>, numbers: &mut [Lane<S>; ELEMENTS_MAX]) -> Lane<S> {
        Polarised::leaves_each(hits, numbers);
        let polarised = numbers[0];
        let power = ScalarState::leaves_each(hits, numbers);
        numbers[1] = polarised - numbers[0];
        power
    }
}

/// Results of a pilot for unpolarised light.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pilot {
    /// Photons traced.
    pub photons: u64,
    /// Fraction reflected, without polarisation.
    pub reflected: MonteCarloEstimate,
    /// Fraction reflected with polarisation minus without.
    pub reflected_difference: MonteCarloEstimate,
    /// The same for the transmitted light.
    pub transmitted_difference: MonteCarloEstimate,
    /// Fraction transmitted.
    pub transmitted: MonteCarloEstimate,
    /// Fractions reflected and transmitted after 1, 2, … interactions; the last element means "or
    /// more".
    pub by_interactions: [[MonteCarloEstimate; ORDERS]; 2],
}

/// Largest work of a pilot's batch ([`super::counting::tally::TallyBatch::work`]): 64 of them take one or two
/// seconds.
const WORK_MAX: u64 = 1 << 22;

/// Traces `photons` with both kinds of light. The result holds for an unpolarised lamp and a camera
/// without polarisation sensitivity. Pilots of different `number` are independent and can be
/// combined ([`Pilot::and`]). `None` if a photon takes as long as thousands usually do.
#[must_use]
pub fn pilot(prepared: &PreparedScene, photons: u64, number: u64) -> Option<Pilot> {
    let grid = DirectionGrid::polar(1, 1);
    let worth_it = |work| work <= WORK_MAX;
    let totals = trace_briefly::<Accompanied>(prepared, grid, photons, number, &worth_it);
    if totals.photons() < photons {
        return None;
    }
    let whole = std::f64::consts::PI;
    // One bin per side: its value times the projected solid angle π is the fraction of the light.
    let of = |side: Side, i: usize| {
        let e = totals.element(side, 0, i);
        MonteCarloEstimate {
            value: e.value * whole,
            std: e.std * whole,
        }
    };
    let energies = totals.energies();
    Some(Pilot {
        photons: totals.photons(),
        // As in reports: a fraction of the counted light, which scatters less than the count.
        reflected: energies.reflected_all,
        reflected_difference: of(Side::Above, 1),
        transmitted_difference: of(Side::Below, 1),
        transmitted: energies.transmitted_all,
        by_interactions: [energies.reflected, energies.transmitted],
    })
}

impl Pilot {
    /// Combines two pilots.
    #[must_use]
    pub fn and(self, other: Self) -> Self {
        let photons = self.photons + other.photons;
        let share = self.photons as f64 / photons.max(1) as f64;
        let both = |a: MonteCarloEstimate, b: MonteCarloEstimate| MonteCarloEstimate {
            value: share * a.value + (1.0 - share) * b.value,
            std: (share * a.std).hypot((1.0 - share) * b.std),
        };
        Pilot {
            photons,
            reflected: both(self.reflected, other.reflected),
            reflected_difference: both(self.reflected_difference, other.reflected_difference),
            transmitted_difference: both(self.transmitted_difference, other.transmitted_difference),
            transmitted: both(self.transmitted, other.transmitted),
            by_interactions: std::array::from_fn(|side| {
                let (a, b) = (self.by_interactions[side], other.by_interactions[side]);
                std::array::from_fn(|n| both(a[n], b[n]))
            }),
        }
    }
}

/// The work of a run in photons: before its first photon it visits every cell of the topmost height
/// field, each for half a photon's time.
#[must_use]
pub fn effort(prepared: &PreparedScene) -> u64 {
    let analysed = match &prepared.stack.interfaces[0].relief {
        Relief::Field(field) => {
            let (nx, ny) = field.cells();
            (nx * ny / 2) as u64
        }
        _ => 0,
    };
    prepared.photons.saturating_add(analysed)
}

#[cfg(test)]
mod tests {
    use super::super::run::{Shard, trace};
    use super::super::scene::Scene;
    use super::*;

    const TWO: &str = "[light]\ntheta_i_deg = 60.0\n[[interface]]\nshape = \"flat\"\nbelow = { n = 1.5 }\n\
                       [[interface]]\nshape = \"flat\"\nbelow = { n = 2.4 }\n[run]\nphotons = 4000\npolarised = ";

    fn prepared(polarised: bool) -> PreparedScene {
        let scene = Scene::parse(&format!("{TWO}{polarised}\n")).unwrap();
        scene.prepare(&|_| Err(String::new())).unwrap()
    }

    #[test]
    fn the_difference_equals_that_of_the_two_modes_and_is_more_accurate_than_either() {
        let pilot = pilot(&prepared(true), 4000, 0).unwrap();
        let both = [true, false].map(|p| {
            let totals = trace(&prepared(p), Shard::WHOLE, &|_| true);
            totals.energies().reflected_all
        });
        let difference = both[0].value - both[1].value;
        let std = both[0].std.hypot(both[1].std);
        assert!((pilot.reflected_difference.value - difference).abs() < 4.0 * std);
        assert!(pilot.reflected_difference.std < 0.5 * std);
        assert!((pilot.reflected.value - both[1].value).abs() < 4.0 * std);
    }

    #[test]
    fn two_combined_pilots_equal_one_with_all_photons() {
        let parts = [0, 1].map(|number| pilot(&prepared(true), 2000, number).unwrap());
        assert_ne!(parts[0].reflected, parts[1].reflected);
        let both = parts[0].and(parts[1]);
        assert_eq!(both.photons, 4000);
        let mean = 0.5 * (parts[0].reflected.value + parts[1].reflected.value);
        assert!((both.reflected.value - mean).abs() < 1e-15);
        // Half the variance of either; the errors are known to a tenth each.
        let ratio = both.reflected_difference.std / parts[0].reflected_difference.std;
        assert!((ratio - 0.5f64.sqrt()).abs() < 0.3 * ratio, "{ratio}");
    }

    #[test]
    fn photons_that_take_as_long_as_thousands_are_abandoned() {
        // Needles: light passes from one to the next for millions of cells.
        let needles = |alpha: f64| {
            let scene = format!(
                "[light]\ntheta_i_deg = 45.0\n[[interface]]\nshape = \"beckmann\"\nalpha_u = {alpha:?}\nalpha_v = {alpha:?}\n\
                 cells = 32\nbelow = {{ n = 1.5 }}\n[run]\nphotons = 100000\n"
            );
            let scene = Scene::parse(&scene).unwrap();
            scene.prepare(&|_| Err(String::new())).unwrap()
        };
        // If paths split at every needle without end, photons would already take too long here.
        assert_eq!(pilot(&needles(1e3), 500, 0).unwrap().photons, 500);
        let needles = needles(1e7);
        assert_eq!(pilot(&needles, 500, 0), None);
        let stopped = trace(&needles, Shard::WHOLE, &|p| p.surface_analysis.is_some());
        assert_eq!(stopped.photons(), 0);
    }

    #[test]
    fn polarisation_makes_no_difference_to_a_single_reflection() {
        let scene =
            "[light]\ntheta_i_deg = 60.0\n[[interface]]\nshape = \"flat\"\nbelow = { n = 1.5 }\n";
        let ready = Scene::parse(scene)
            .unwrap()
            .prepare(&|_| Err(String::new()))
            .unwrap();
        let pilot = pilot(&ready, 500, 0).unwrap();
        assert!(pilot.reflected_difference.value.abs() < 1e-12);
    }
}
