//! Surfaces of the same statistics differ: the part of an answer's doubt that no number of photons takes away.
//!
//! Call [`over_surfaces`] with a run on the scene's own surface; it traces others, drawn by other seeds, with as many
//! photons each, and tells the error of the photons and the spread between surfaces apart.

use serde::Serialize;

use super::run::{self, Follow, Progress, Shard};
use super::scene::{Prepared, Scene};
use super::tally::{Estimate, Totals};

/// A share of the light over several surfaces.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Between {
    /// Mean over the surfaces.
    pub value: f64,
    /// Standard error of the mean, as an answer for all surfaces of these statistics.
    pub std: f64,
    /// Part of it that more photons would take away.
    pub std_by_sampling: f64,
    /// Standard deviation from surface to surface, the photons' own error taken out.
    pub std_between_surfaces: f64,
}

impl Between {
    /// Of one estimate per surface; two at least.
    fn of(each: &[Estimate]) -> Self {
        let n = each.len() as f64;
        let value = each.iter().map(|x| x.value).sum::<f64>() / n;
        let square: f64 = each.iter().map(|x| (x.value - value).powi(2)).sum();
        let seen = square / (n - 1.0);
        let sampling = each.iter().map(|x| x.std * x.std).sum::<f64>() / n;
        Between {
            value,
            // Not less than the photons' own, however alike a few surfaces happen to be.
            std: (seen.max(sampling) / n).sqrt(),
            std_by_sampling: (sampling / n).sqrt(),
            // What photons without an error of their own add is not known: then nothing can be told apart.
            std_between_surfaces: match sampling.is_nan() {
                true => f64::NAN,
                false => (seen - sampling).max(0.0).sqrt(),
            },
        }
    }
}

/// Energies over several surfaces.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Surfaces {
    /// How many; fewer than asked for where time was over.
    pub count: usize,
    /// Back to the upper side.
    pub reflected: Between,
    /// Through the last interface.
    pub transmitted: Between,
    /// By metals, layers and diffuse bodies.
    pub absorbed: Between,
}

/// Traces the scene on so many surfaces in all, the first being that of `own`. `prepare` makes a scene ready as the
/// first was; `go_on` is asked with the surfaces that are done. `None` where time was over before the second.
///
/// # Errors
/// What `prepare` says.
pub fn over_surfaces<E>(
    scene: &Scene,
    own: &Totals,
    count: usize,
    prepare: &dyn Fn(&Scene) -> Result<Prepared, E>,
    go_on: &(dyn Fn(usize) -> bool + Sync),
) -> Result<Option<Surfaces>, E> {
    let mut each = vec![own.energies()];
    for n in 1..count {
        if !go_on(n) {
            break;
        }
        let prepared = prepare(&scene.redrawn(n as u64))?;
        let proceed = |_: &Progress| go_on(n);
        let (photons, all) = (own.photons(), Shard::WHOLE);
        let totals = run::trace_photons(&prepared, Follow::Scene, photons, all, &proceed);
        // A surface with few photons would count as one with many.
        if totals.photons() < photons {
            break;
        }
        each.push(totals.energies());
    }
    if each.len() < 2 {
        return Ok(None);
    }
    let of = |part: &dyn Fn(usize) -> Estimate| {
        let all: Vec<Estimate> = (0..each.len()).map(part).collect();
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
    fn photons_and_surfaces_are_told_apart() {
        let alike = |value: f64| Estimate { value, std: 0.1 };
        let b = Between::of(&[alike(1.0), alike(1.0), alike(1.0), alike(1.0)]);
        assert_eq!((b.std_between_surfaces, b.std), (0.0, 0.05));
        let sure = |value: f64| Estimate { value, std: 0.0 };
        let b = Between::of(&[sure(1.0), sure(3.0)]);
        assert_eq!((b.value, b.std_by_sampling), (2.0, 0.0));
        assert!(
            (b.std_between_surfaces - 2f64.sqrt()).abs() < 1e-15 && (b.std - 1.0).abs() < 1e-15
        );
    }

    #[test]
    fn small_fields_differ_by_more_than_their_photons_do() {
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
