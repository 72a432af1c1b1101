//! Differences between surfaces of the same statistics: the part of the uncertainty that more
//! photons do not reduce.
//!
//! Call [`over_surfaces`] with a run on the scene's own surface. It traces other realisations with
//! as many photons each, and separates the photons' error from the spread between surfaces.

use serde::Serialize;

use super::counting::tally::{MonteCarloEstimate, Totals};
use super::run::{self, Follow, Shard, TraceProgress};
use super::scene::{PreparedScene, Scene};

/// A fraction of the light over several surfaces.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, utoipa::ToSchema)]
#[schema(as = TraceBetween)]
pub struct Between {
    /// Mean over the surfaces.
    pub value: f64,
    /// Standard error of the mean, as an estimate for all surfaces of these statistics.
    pub std: f64,
    /// Part of it that more photons would reduce.
    pub std_by_sampling: f64,
    /// Standard deviation between surfaces, without the photons' own error.
    pub std_between_surfaces: f64,
}

impl Between {
    /// From one estimate per surface; at least two.
    fn of(each: &[MonteCarloEstimate]) -> Self {
        let n = each.len() as f64;
        let value = each.iter().map(|x| x.value).sum::<f64>() / n;
        let square: f64 = each.iter().map(|x| (x.value - value).powi(2)).sum();
        let seen = square / (n - 1.0);
        let sampling = each.iter().map(|x| x.std * x.std).sum::<f64>() / n;
        Between {
            value,
            // At least the photons' own, however similar a few surfaces happen to be.
            std: (seen.max(sampling) / n).sqrt(),
            std_by_sampling: (sampling / n).sqrt(),
            // Without an error of the photons, the two parts cannot be separated.
            std_between_surfaces: match sampling.is_nan() {
                true => f64::NAN,
                false => (seen - sampling).max(0.0).sqrt(),
            },
        }
    }
}

/// Energies over several surfaces.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
#[schema(as = TraceSurfaces)]
pub struct Surfaces {
    /// Number of surfaces; fewer than requested if time ran out.
    pub count: usize,
    /// Reflected to the upper side.
    pub reflected: Between,
    /// Transmitted through the last interface.
    pub transmitted: Between,
    /// Absorbed by metals, layers and diffuse bodies.
    pub absorbed: Between,
}

/// Traces the scene on this number of surfaces in all; `own` is the run on the first. `prepare`
/// prepares a scene as the first was; `go_on` is called with the number of finished surfaces.
/// `None` if time ran out before the second.
///
/// # Errors
/// The error of `prepare`.
pub fn over_surfaces<E>(
    scene: &Scene,
    own: &Totals,
    count: usize,
    prepare: &dyn Fn(&Scene) -> Result<PreparedScene, E>,
    go_on: &(dyn Fn(usize) -> bool + Sync),
) -> Result<Option<Surfaces>, E> {
    let mut each = vec![own.energies()];
    for n in 1..count {
        if !go_on(n) {
            break;
        }
        let prepared = prepare(&scene.redrawn(n as u64))?;
        let proceed = |_: &TraceProgress| go_on(n);
        let (photons, all) = (own.photons(), Shard::WHOLE);
        let totals = run::trace_photons(&prepared, Follow::Scene, photons, all, &proceed);
        // A surface with few photons would count as much as one with many.
        if totals.photons() < photons {
            break;
        }
        each.push(totals.energies());
    }
    if each.len() < 2 {
        return Ok(None);
    }
    let of = |part: &dyn Fn(usize) -> MonteCarloEstimate| {
        let all: Vec<MonteCarloEstimate> = (0..each.len()).map(part).collect();
        Between::of(&all)
    };
    Ok(Some(Surfaces {
        count: each.len(),
        reflected: of(&|n| each[n].reflected_all),
        transmitted: of(&|n| each[n].transmitted_all),
        absorbed: of(&|n| each[n].absorbed),
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    const ROUGH: &str = "[light]\ntheta_i_deg = 45.0\n[[interface]]\nshape = \"beckmann\"\ncells = 32\nalpha_u = 0.4\nalpha_v = 0.4\nbelow = { n = 1.5 }\n[run]\nphotons = 20000\n";

    #[test]
    fn the_errors_of_photons_and_surfaces_are_separated() {
        let alike = |value: f64| MonteCarloEstimate { value, std: 0.1 };
        let b = Between::of(&[alike(1.0), alike(1.0), alike(1.0), alike(1.0)]);
        assert_eq!((b.std_between_surfaces, b.std), (0.0, 0.05));
        let sure = |value: f64| MonteCarloEstimate { value, std: 0.0 };
        let b = Between::of(&[sure(1.0), sure(3.0)]);
        assert_eq!((b.value, b.std_by_sampling), (2.0, 0.0));
        assert!(
            (b.std_between_surfaces - 2f64.sqrt()).abs() < 1e-15 && (b.std - 1.0).abs() < 1e-15
        );
    }

    #[test]
    fn small_fields_differ_by_more_than_the_photons_error() {
        let scene = Scene::parse(ROUGH).unwrap();
        let prepare = |scene: &Scene| scene.prepare(&|_| Err(String::new()));
        let own = run::trace(&prepare(&scene).unwrap(), Shard::WHOLE, &|_| true);
        let all = over_surfaces(&scene, &own, 6, &prepare, &|_| true)
            .unwrap()
            .unwrap();
        assert_eq!(all.count, 6);
        assert!(all.reflected.std_between_surfaces > 2.0 * all.reflected.std_by_sampling);
        let none = over_surfaces(&scene, &own, 6, &prepare, &|_| false).unwrap();
        assert_eq!(none, None);
    }
}
