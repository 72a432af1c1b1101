//! The error of a computation without polarisation: difference maps over the outgoing directions.
//!
//! Call [`PolarisationDifference::of`] on runs that follow both ([`crate::trace::run::Follow`]), one per
//! wavelength, all with the same bins. As in Wang et al. 2017 (Sec. 5), for each direction d =
//! (I_pol − I_scalar)/I_scalar for unpolarised light; ADM is the mean of |d| over the wavelengths,
//! MDM the largest. Directions darker than the mean of the lit ones divided by a divisor are left
//! out. So are unresolved ones: those whose d has a large standard error, or that light from inside
//! layers reached in too few replicates to estimate d. Bin size and mask affect the numbers: a
//! result is reported with both.

use serde::Serialize;

use super::grid::DirectionGrid;
use super::plane;
use super::tally::{MonteCarloEstimate, Totals};
use crate::trace::photons::paired::{DIFFERENCE, SCALAR};
use crate::trace::rng::{Purpose, RandomStream};
use crate::trace::surfaces::height_field::Side;

/// The wavelengths of Wang et al. 2017, nm.
pub const WAVELENGTHS_NM: [f64; 8] = [380.0, 420.0, 460.0, 500.0, 540.0, 580.0, 620.0, 660.0];

/// Seed of the photons at one of several wavelengths, by its index from 0. With equal photons at
/// all wavelengths the noise would be equal too, and a mean over the wavelengths would be no more
/// accurate than one of them. The surfaces are those of the run.
#[must_use]
pub fn seed_at(run_seed: u64, wavelength: usize) -> u64 {
    match wavelength {
        0 => run_seed,
        _ => RandomStream::new(run_seed, Purpose::Batch, wavelength as u64).bits(),
    }
}

/// The directions that count.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, utoipa::ToSchema)]
#[schema(as = TraceMask)]
pub struct DirectionMask {
    /// Directions darker than the mean of the lit ones divided by this are left out.
    pub divisor: f64,
    /// Directions whose relative difference has a larger standard error are left out.
    pub error_max: f64,
}

/// Least number of replicates with a difference in a direction above layers: light reflected once
/// has none, and d = 0 ± 0 before any other light arrived is not a result.
const DIFFERING_MIN: u32 = 5;

impl Default for DirectionMask {
    /// The mean divided by 10, as Wang et al. 2017 use it for dielectrics, and 2 %.
    fn default() -> Self {
        DirectionMask {
            divisor: 10.0,
            error_max: 0.02,
        }
    }
}

/// The relative difference in one direction.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, utoipa::ToSchema)]
#[schema(as = TraceDirection)]
pub struct DirectionDifference {
    /// Bin of the upper side.
    #[serde(skip)]
    pub bin: usize,
    /// Polar angle of the bin's centre, degrees.
    pub theta_deg: f64,
    /// Azimuth of the bin's centre, degrees.
    pub phi_deg: f64,
    /// Mean over the wavelengths of the scalar BRDF, sr⁻¹.
    pub scalar: f64,
    /// Signed mean of d over the wavelengths.
    pub mean: f64,
    /// Its standard error.
    pub std: f64,
    /// Mean of |d|.
    pub adm: f64,
    /// Largest |d|.
    pub mdm: f64,
}

/// All directions that count.
#[derive(Debug, Clone, PartialEq)]
pub struct PolarisationDifference {
    /// The bins.
    pub grid: DirectionGrid,
    /// Directions that count, in the order of the bins.
    pub directions: Vec<DirectionDifference>,
    /// Number of lit directions left out as too dark.
    pub too_dark: usize,
    /// Number of directions left out as unresolved.
    pub not_settled: usize,
}

/// Statistics of a difference over the directions.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, utoipa::ToSchema)]
#[schema(as = TraceDifference)]
pub struct DifferenceSummary {
    /// Largest value.
    pub greatest: f64,
    /// 99th percentile over the directions.
    pub percentile_99: f64,
    /// Mean over the directions.
    pub mean: f64,
}

impl PolarisationDifference {
    /// Computes the difference from runs of one scene at one or more wavelengths, independent of
    /// each other ([`seed_at`]); `None` if the runs do not match or were not paired.
    #[must_use]
    pub fn of(runs: &[Totals], mask: &DirectionMask) -> Option<PolarisationDifference> {
        let grid = runs.first()?.grid();
        if runs
            .iter()
            .any(|r| r.grid() != grid || r.elements() <= DIFFERENCE)
        {
            return None;
        }
        let scalar = |run: &Totals, bin| run.element(Side::Above, bin, SCALAR).value;
        let brightness: Vec<f64> = (0..grid.per_side())
            .map(|bin| {
                let lit = runs.iter().filter(|r| !r.is_empty(Side::Above, bin));
                lit.map(|r| scalar(r, bin)).sum::<f64>() / runs.len() as f64
            })
            .collect();
        // If polarisation makes no difference at all, no direction is unresolved.
        let differ = |r: &Totals| {
            (0..grid.per_side()).any(|bin| r.differing(bin).is_some_and(|batches| batches > 0))
        };
        let differing: Vec<&Totals> = runs.iter().filter(|r| differ(r)).collect();
        let met = |bin: usize| {
            let of = differing.iter().filter_map(|r| r.differing(bin));
            of.min().is_none_or(|batches| batches >= DIFFERING_MIN)
        };
        let lit = brightness.iter().filter(|b| **b > 0.0).count();
        let limit = brightness.iter().sum::<f64>() / (lit.max(1) as f64 * mask.divisor);
        let (mut directions, mut too_dark, mut not_settled) = (Vec::new(), 0, 0);
        for (bin, &bright) in brightness.iter().enumerate() {
            if bright <= 0.0 {
                continue;
            }
            if bright < limit {
                too_dark += 1;
                continue;
            }
            let of: Vec<MonteCarloEstimate> = runs.iter().map(|r| relative(r, bin)).collect();
            let n = of.len() as f64;
            let std = of.iter().map(|d| d.std * d.std).sum::<f64>().sqrt() / n;
            // A bin reached by a single photon has no usable error.
            if met(bin) && of.iter().all(|d| d.std <= mask.error_max) {
                let [t0, t1, p0, p1] = grid.limits_deg(bin);
                directions.push(DirectionDifference {
                    bin,
                    theta_deg: 0.5 * (t0 + t1),
                    phi_deg: 0.5 * (p0 + p1),
                    scalar: bright,
                    mean: of.iter().map(|d| d.value).sum::<f64>() / n,
                    std,
                    adm: of.iter().map(|d| d.value.abs()).sum::<f64>() / n,
                    mdm: of.iter().map(|d| d.value.abs()).fold(0.0, f64::max),
                });
            } else {
                not_settled += 1;
            }
        }
        Some(PolarisationDifference {
            grid,
            directions,
            too_dark,
            not_settled,
        })
    }

    /// Statistics of the ADM map; `None` if no direction counts.
    #[must_use]
    pub fn adm(&self) -> Option<DifferenceSummary> {
        summary(self.directions.iter().map(|d| d.adm).collect())
    }

    /// Statistics of the MDM map; `None` if no direction counts.
    #[must_use]
    pub fn mdm(&self) -> Option<DifferenceSummary> {
        summary(self.directions.iter().map(|d| d.mdm).collect())
    }

    /// The direction with the largest scalar error.
    #[must_use]
    pub fn worst(&self) -> Option<&DirectionDifference> {
        self.directions
            .iter()
            .max_by(|a, b| a.adm.total_cmp(&b.adm))
    }
}

/// Both results in one direction of the plane of incidence.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct LobePoint {
    /// Angle of reflection, degrees; positive on the side of the mirror direction.
    pub theta_s_deg: f64,
    /// BRDF for unpolarised light, sr⁻¹.
    pub polarised: MonteCarloEstimate,
    /// The same computed without polarisation, sr⁻¹.
    pub scalar: MonteCarloEstimate,
    /// The first minus the second, sr⁻¹; more accurate than either.
    pub difference: MonteCarloEstimate,
}

/// The plane of incidence of a paired run with the lamp at the azimuth `phi_i_deg`. `None` for
/// other runs and for pixel bins.
#[must_use]
pub fn lobe(totals: &Totals, phi_i_deg: f64) -> Option<Vec<LobePoint>> {
    if totals.elements() <= DIFFERENCE {
        return None;
    }
    let point = |at: plane::PlaneDirection| LobePoint {
        theta_s_deg: at.theta_s_deg,
        polarised: at.numbers[0],
        scalar: at.numbers[SCALAR],
        difference: at.numbers[DIFFERENCE],
    };
    let directions = plane::plane(totals, phi_i_deg)?;
    Some(directions.into_iter().map(point).collect())
}

/// d of a bin.
fn relative(run: &Totals, bin: usize) -> MonteCarloEstimate {
    let scalar = run.element(Side::Above, bin, SCALAR).value;
    let difference = run.element(Side::Above, bin, DIFFERENCE);
    MonteCarloEstimate {
        value: difference.value / scalar,
        std: difference.std / scalar,
    }
}

fn summary(mut values: Vec<f64>) -> Option<DifferenceSummary> {
    values.sort_by(f64::total_cmp);
    let greatest = *values.last()?;
    let at = (values.len() * 99).div_ceil(100) - 1;
    Some(DifferenceSummary {
        greatest,
        percentile_99: values[at],
        mean: values.iter().sum::<f64>() / values.len() as f64,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::flat_stack::FlatStack;
    use crate::trace::run;
    use crate::trace::run::{Follow, Shard, StopPolicy};
    use crate::trace::scene::PreparedScene;
    use crate::trace::scene::Scene;

    fn traced(theta_deg: f64, interfaces: &str, photons: u32) -> Totals {
        let text = format!(
            "[light]\ntheta_i_deg = {theta_deg}\nphi_i_deg = 170.0\n{interfaces}\n[run]\nphotons = {photons}\n"
        );
        let scene = Scene::parse(&text).unwrap();
        let prepared = scene.prepare(&|_| Err(String::new())).unwrap();
        both_ways(&prepared.with_grid(DirectionGrid::disc(16)))
    }

    fn both_ways(prepared: &PreparedScene) -> Totals {
        run::trace_following(prepared, Follow::Both, StopPolicy::AtLast, &|_| true)
    }

    #[test]
    fn flat_layers_differ_as_in_the_exact_recursion() {
        let layers = "[[interface]]\nshape = \"flat\"\nbelow = { n = 1.5 }\n\
                      [[interface]]\nshape = \"flat\"\nbelow = { n = 2.4 }";
        let difference =
            PolarisationDifference::of(&[traced(65.0, layers, 60_000)], &DirectionMask::default())
                .unwrap();
        let [only] = difference.directions[..] else {
            panic!("a mirror reflects in one direction")
        };
        let exact = FlatStack::parse("1.5/2.4")
            .unwrap()
            .reflect(65f64.to_radians())
            .unwrap();
        let expected = exact.channel.unpolarised() / exact.scalar - 1.0;
        assert!(
            (only.mean - expected).abs() < 4.0 * only.std,
            "{only:?} {expected}"
        );
        assert!(only.std < 0.1 * expected.abs());
        assert_eq!((only.adm, only.mdm), (only.mean.abs(), only.mean.abs()));
    }

    #[test]
    fn a_direction_with_little_light_from_inside_the_layers_is_unresolved() {
        // The glass is bright in all directions and the layer below it dark, so most directions
        // receive light only from the glass.
        let layers = "[[interface]]\nshape = \"smith\"\nalpha_u = 0.3\nalpha_v = 0.3\nbelow = { n = 1.5 }\n\
                      [[interface]]\nshape = \"smith\"\nalpha_u = 0.3\nalpha_v = 0.3\nbelow = { n = 1.49 }";
        let wide = DirectionMask {
            divisor: 1e3,
            error_max: 0.02,
        };
        let run = traced(65.0, layers, 2_000);
        let difference = PolarisationDifference::of(std::slice::from_ref(&run), &wide).unwrap();
        let unmet = |bin: usize| run.differing(bin).unwrap() < DIFFERING_MIN;
        let lit = (0..256).filter(|bin| !run.is_empty(Side::Above, *bin));
        assert!(lit.filter(|bin| unmet(*bin)).count() > 10);
        assert!(difference.directions.iter().all(|d| !unmet(d.bin)));
        assert!(difference.not_settled > 0);
        // A single facet has no layer whose light could be missed.
        let facet = layers.split_once("\n[[").unwrap().0;
        let alone = traced(65.0, facet, 2_000);
        assert_eq!(alone.differing(0), None);
        let settled = PolarisationDifference::of(&[alone], &wide)
            .unwrap()
            .directions;
        assert!(!settled.is_empty());
    }

    #[test]
    fn means_over_wavelengths_scatter_over_seeds_by_their_errors() {
        const SEEDS: u64 = 20;
        let text = "[light]\ntheta_i_deg = 50.0\n[[interface]]\nshape = \"smith\"\nalpha_u = 0.3\nalpha_v = 0.3\n\
                    below = { n = 1.5 }\n[[interface]]\nshape = \"smith\"\nalpha_u = 0.3\nalpha_v = 0.3\n\
                    below = { n = 2.4 }\n[run]\nphotons = 30000\n";
        let prepared = Scene::parse(text).unwrap().prepare(&|_| Err(String::new()));
        let prepared = prepared.unwrap().with_grid(DirectionGrid::disc(8));
        let mask = DirectionMask {
            divisor: 100.0,
            error_max: 0.3,
        };
        let maps: Vec<PolarisationDifference> = (1..=SEEDS)
            .map(|seed| {
                let at = |n| both_ways(&prepared.clone().with_seed(seed_at(seed, n)));
                PolarisationDifference::of(&[0, 1, 2, 3].map(at), &mask).unwrap()
            })
            .collect();
        let (mut sum, mut count) = (0.0, 0);
        for bin in 0..64 {
            let of = maps.iter().flat_map(|m| &m.directions);
            let of: Vec<&DirectionDifference> = of.filter(|d| d.bin == bin).collect();
            if of.len() < maps.len() {
                continue;
            }
            let n = of.len() as f64;
            let mean = of.iter().map(|d| d.mean).sum::<f64>() / n;
            let squares = of.iter().map(|d| (d.mean - mean).powi(2)).sum::<f64>();
            let of_stated = of.iter().map(|d| d.std * d.std).sum::<f64>() / n;
            sum += squares / (n - 1.0) / of_stated;
            count += 1;
        }
        // A variance from 20 seeds is known to 32 %, the mean over these directions to 9 %.
        assert!(count > 12, "{count}");
        let ratio = (sum / f64::from(count)).sqrt();
        assert!((ratio - 1.0).abs() < 0.15, "{ratio}");
    }

    #[test]
    fn a_lobe_equals_its_bins_and_only_paired_runs_have_one() {
        let text = "[light]\ntheta_i_deg = 40.0\nphi_i_deg = 180.0\n[[interface]]\nshape = \"flat\"\n\
                    below = { n = 1.5 }\n[run]\nphotons = 500\ntheta_bins = 9\nphi_bins = 9\n";
        let scene = Scene::parse(text).unwrap();
        let prepared = scene.prepare(&|_| Err(String::new())).unwrap();
        let totals = both_ways(&prepared);
        let points = lobe(&totals, 180.0).unwrap();
        let [only] = &points[..] else {
            panic!("a mirror reflects in one direction: {points:?}")
        };
        assert_eq!(only.theta_s_deg, 45.0);
        let expected = only.polarised.value - only.scalar.value;
        assert!((only.difference.value - expected).abs() < 1e-12 * only.scalar.value);
        assert!(lobe(&run::trace(&prepared, Shard::WHOLE, &|_| true), 180.0).is_none());
    }

    #[test]
    fn one_reflection_of_unpolarised_light_needs_no_polarisation() {
        let facet = "[[interface]]\nshape = \"beckmann\"\nalpha_u = 0.05\nalpha_v = 0.05\n\
                     cells = 64\nbelow = \"Au\"";
        let difference =
            PolarisationDifference::of(&[traced(20.0, facet, 20_000)], &DirectionMask::default())
                .unwrap();
        assert!(difference.adm().unwrap().greatest < 1e-12);
        assert!(!difference.directions.is_empty());
    }
}
