//! The tracer on the simulations of Wang et al. 2017, at their angles.
//!
//! The squared error of a method is the variance over seeds plus the squared difference of their mean from the reference.
//! Where the reference is a long run of another method, its mean is uncertain too. Then only the part of the difference
//! beyond two standard errors of both counts, so that the scatter of the reference is not attributed to the method. The
//! time is that of the fastest run.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use super::trace_forecast::{Patience, TraceExtent, of_run};
use super::{AccuracyEffort, AccuracyPoint, ForecastOutcome, Measurements, plan_check};
use crate::model::flat_stack::FlatStack;
use crate::plan::TOLERANCE;
use crate::plan::scene::{TracePlanRequest, apply, plan};
use crate::trace::run::{self, Shard};
use crate::trace::scene::{PreparedScene, Scene};

use Medium::{Dielectric, Metal};

/// One scene at one angle.
pub(super) struct TracedScene {
    pub(super) name: String,
    theta_deg: f64,
    layers: &'static [SceneLayer],
}

/// Roughness (0 for flat) and the medium below.
type SceneLayer = (f64, Medium);

#[derive(Clone, Copy)]
enum Medium {
    /// A dielectric by its refractive index.
    Dielectric(f64),
    /// A metal by its symbol.
    Metal(&'static str),
}

/// Layers and angles of incidence in degrees, from easy to stiff: flat stacks with an exact result, single interfaces,
/// layers, metals.
const SIMULATIONS: [(&[SceneLayer], &[f64]); 16] = [
    (&[(0.0, Dielectric(1.5)), (0.0, Dielectric(2.4))], &[60.0]),
    (&[(0.0, Dielectric(1.5)), (0.0, Metal("Au"))], &[60.0]),
    (&[(0.25, Dielectric(1.5))], &[45.0]),
    (&[(0.25, Metal("Au"))], &[45.0]),
    (
        &[(0.1, Dielectric(1.5)), (0.1, Dielectric(2.4))],
        &[50.0, 56.0, 60.0, 65.0],
    ),
    (
        &[(0.3, Dielectric(1.5)), (0.7, Dielectric(2.4))],
        &[50.0, 65.0],
    ),
    (
        &[(0.1, Dielectric(1.5)), (0.7, Dielectric(2.4))],
        &[50.0, 65.0],
    ),
    (
        &[(0.7, Dielectric(1.5)), (0.1, Dielectric(2.4))],
        &[50.0, 65.0],
    ),
    (
        &[(0.1, Dielectric(1.5)), (0.1, Metal("Au"))],
        &[10.0, 60.0, 80.0],
    ),
    (&[(0.1, Dielectric(1.5)), (0.4, Metal("Au"))], &[40.0, 80.0]),
    (&[(0.3, Dielectric(1.5)), (0.1, Metal("Au"))], &[40.0, 80.0]),
    (&[(0.1, Dielectric(1.5)), (0.1, Metal("Al"))], &[60.0, 80.0]),
    (&[(0.1, Dielectric(1.5)), (0.4, Metal("Al"))], &[60.0]),
    (&[(0.5, Dielectric(1.3)), (0.3, Metal("Cu"))], &[40.0, 80.0]),
    (
        &[
            (0.2, Dielectric(1.3)),
            (0.3, Dielectric(1.5)),
            (0.4, Dielectric(1.8)),
        ],
        &[40.0, 80.0],
    ),
    (
        &[
            (0.1, Dielectric(1.3)),
            (0.1, Dielectric(1.5)),
            (0.1, Metal("Au")),
        ],
        &[40.0, 80.0],
    ),
];

pub(super) fn scenes(effort: AccuracyEffort) -> Vec<TracedScene> {
    let all = SIMULATIONS
        .iter()
        .enumerate()
        .flat_map(|(n, (layers, angles))| {
            // A quick run takes the first angle of every fourth simulation.
            let taken = match effort {
                AccuracyEffort::Full => angles.len(),
                AccuracyEffort::Quick => usize::from(n % 4 == 0),
            };
            angles[..taken].iter().map(move |theta_deg| TracedScene {
                name: name(layers, *theta_deg),
                theta_deg: *theta_deg,
                layers,
            })
        });
    all.collect()
}

/// The layers from the top, e.g. `n = 1.5 (α = 0.1) on Al (α = 0.4) at 60°`.
fn name(layers: &[SceneLayer], theta_deg: f64) -> String {
    let layer = |(alpha, medium): &SceneLayer| {
        let medium = match medium {
            Dielectric(n) => format!("n = {n}"),
            Metal(symbol) => (*symbol).to_owned(),
        };
        match *alpha {
            0.0 => format!("{medium} (flat)"),
            alpha => format!("{medium} (α = {alpha})"),
        }
    };
    let layers: Vec<String> = layers.iter().map(layer).collect();
    format!("{} at {theta_deg}°", layers.join(" on "))
}

impl TracedScene {
    /// The surfaces are the same in every run; only the seed of the photons changes.
    fn scene(&self, method: &str, polarised: &str, photons: u64, seed: u64) -> Option<Scene> {
        let mut text = format!("[light]\ntheta_i_deg = {:?}\n", self.theta_deg);
        for (n, (alpha, medium)) in self.layers.iter().enumerate() {
            let below = match medium {
                Dielectric(n) => format!("{{ n = {n:?} }}"),
                Metal(symbol) => format!("{symbol:?}"),
            };
            text += &if *alpha == 0.0 {
                format!("[[interface]]\nshape = \"flat\"\nbelow = {below}\n")
            } else {
                format!(
                    "[[interface]]\nshape = \"beckmann\"\ncells = 200\nalpha_u = {alpha:?}\nalpha_v = {alpha:?}\nseed = {}\nbelow = {below}\n",
                    n + 1
                )
            };
        }
        text += &format!(
            "[run]\nphotons = {photons}\nseed = {seed}\nmethod = \"{method}\"\npolarised = {polarised}\n"
        );
        Scene::parse(&text).ok()
    }

    fn prepared(
        &self,
        method: &str,
        polarised: &str,
        photons: u64,
        seed: u64,
    ) -> Option<PreparedScene> {
        self.scene(method, polarised, photons, seed)?
            .prepare(&|_| Err("no files here".to_owned()))
            .ok()
    }

    /// The exact reflectance of flat layers.
    fn exact(&self) -> Option<f64> {
        if self.layers.iter().any(|(alpha, _)| *alpha > 0.0) {
            return None;
        }
        let mut indices = vec![nalgebra::Complex::new(1.0, 0.0)];
        for (_, medium) in self.layers {
            let index = match medium {
                Dielectric(n) => nalgebra::Complex::new(*n, 0.0),
                Metal(symbol) => crate::material::tables::index_of(symbol, 550.0).ok()?,
            };
            indices.push(index);
        }
        let stack = FlatStack::new(indices).ok()?;
        let r = stack.reflect(self.theta_deg.to_radians()).ok()?;
        Some(r.channel.unpolarised())
    }
}

/// Share reflected with its standard error, and the seconds it took.
fn reflected(prepared: &PreparedScene, cancel: &AtomicBool) -> ([f64; 2], f64) {
    let started = Instant::now();
    let totals = run::trace(prepared, Shard::WHOLE, &|_| !cancel.load(Ordering::Relaxed));
    let r = totals.energies().reflected_all;
    ([r.value, r.std], started.elapsed().as_secs_f64())
}

/// Photons of a scene whose plan is checked; the check chooses its own numbers.
const PLANNED_PHOTONS: u64 = 100_000;

/// Photons of a run and number of runs (seeds) per point. Short runs are repeated more often, because a root mean
/// square of n errors has a relative uncertainty of 1/√(2n).
type Sizes = &'static [(u64, u64)];
const QUICK: Sizes = &[(4_000, 8), (16_000, 6), (64_000, 3)];
const FULL: Sizes = &[(4_000, 12), (16_000, 8), (64_000, 4)];
/// The error of scalar light ends at its bias, which few runs show.
const FULL_SCALAR: Sizes = &[(4_000, 6), (16_000, 3), (64_000, 2)];
/// Standard errors within which a mean agrees with the reference.
const SAME: f64 = 2.0;

/// A reference value with its uncertainty.
struct Reference {
    value: f64,
    std: f64,
    name: String,
}

impl Reference {
    /// Relative error of a method from its results, one per seed.
    fn error(&self, values: &[f64]) -> f64 {
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        let squares: f64 = values.iter().map(|x| (x - mean).powi(2)).sum();
        let variance = squares / (n - 1.0).max(1.0);
        let known2 = if self.std > 0.0 {
            SAME * SAME * (self.std * self.std + variance / n)
        } else {
            0.0
        };
        let off2 = ((mean - self.value).powi(2) - known2).max(0.0);
        (variance + off2).sqrt() / self.value
    }
}

pub(super) fn measure(
    scene: &TracedScene,
    effort: AccuracyEffort,
    cancel: &AtomicBool,
    found: &mut Measurements,
) {
    // Split photons carry more information, so a reference needs fewer of them.
    let (sizes, scalar, [by_split, by_analog]) = match effort {
        AccuracyEffort::Quick => (QUICK, QUICK, [300_000, 300_000]),
        AccuracyEffort::Full => (FULL, FULL_SCALAR, [500_000, 1_000_000]),
    };
    // The forecast of the reference run, made before it starts.
    let forecast = scene
        .prepared("split", "true", by_split, REFERENCE_SEED)
        .and_then(|prepared| {
            let seconds = f64::INFINITY;
            of_run(&prepared, TraceExtent::ALL, Patience { seconds, cancel })
        });
    // The reference of each method is the other method.
    let mut taken = None;
    let mut against = |method: &str, photons: u64| {
        let exact = scene.exact().map(|value| Reference {
            value,
            std: 0.0,
            name: "exact (flat layers)".to_owned(),
        });
        // The long split run is needed for the forecast even where the result is exact.
        if method != "split" && exact.is_some() {
            return exact;
        }
        let prepared = scene.prepared(method, "true", photons, REFERENCE_SEED)?;
        let ([value, std], seconds) = reflected(&prepared, cancel);
        if method == "split" {
            taken = Some(seconds);
        }
        exact.or_else(|| {
            Some(Reference {
                value,
                std,
                name: format!("{method}, polarised, {photons} photons, ± {std:.1e}"),
            })
        })
    };
    let (by_split, by_analog) = (against("split", by_split), against("analog", by_analog));
    let (Some(by_split), Some(by_analog)) = (by_split, by_analog) else {
        return;
    };
    if let (Some(forecast), Some(taken_s)) = (forecast, taken) {
        found.forecasts.push(ForecastOutcome {
            scene: scene.name.clone(),
            forecast_s: forecast.seconds,
            taken_s,
        });
    }
    let methods = [
        (
            "analog, polarised",
            "analog",
            Some("true"),
            &by_split,
            sizes,
        ),
        ("split, polarised", "split", Some("true"), &by_analog, sizes),
        ("split, scalar", "split", Some("false"), &by_analog, scalar),
        ("split, as planned", "split", None, &by_analog, sizes),
    ];
    for (label, method, polarised, reference, sizes) in methods {
        let polarisation = polarised.unwrap_or("\"auto\"");
        let Some(built) = scene.prepared(method, polarisation, PLANNED_PHOTONS, 1) else {
            return;
        };
        for (photons, runs) in sizes {
            let (mut values, mut seconds) = (Vec::new(), f64::INFINITY);
            for seed in 1..=*runs {
                if cancel.load(Ordering::Relaxed) {
                    return;
                }
                let mut prepared = built.clone().with_seed(seed);
                prepared.photons = *photons;
                let started = Instant::now();
                if polarised.is_none()
                    && let Some(scene) = scene.scene(method, polarisation, *photons, seed)
                {
                    // The time of planning counts.
                    apply(&plan(&scene, &prepared, &REQUEST), &scene, &mut prepared);
                }
                let ([value, _], _) = reflected(&prepared, cancel);
                // Other work on the machine only adds time.
                seconds = started.elapsed().as_secs_f64().min(seconds);
                values.push(value);
            }
            found.points.push(AccuracyPoint {
                scene: scene.name.clone(),
                method: label.to_owned(),
                seconds,
                error: reference.error(&values),
                quantity: "relative error of the reflected energy".to_owned(),
                reference: reference.name.clone(),
            });
        }
    }
    if let Some(planned) = scene.scene("split", "\"auto\"", PLANNED_PHOTONS, 1) {
        let ready = |s: &Scene| s.prepare(&|_| Err("no files here".to_owned())).ok();
        let check = plan_check::of_scene(&scene.name, &planned, &ready, TOLERANCE, None, cancel);
        found.proofs.extend(check);
    }
}

/// Seed of the long runs that are references.
const REFERENCE_SEED: u64 = 77;

/// The request for each plan.
const REQUEST: TracePlanRequest = TracePlanRequest {
    mueller: false,
    tolerance: TOLERANCE,
    photons: None,
};

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_combines_scatter_and_significant_bias() {
        let reference = |std: f64| Reference {
            value: 2.0,
            std,
            name: String::new(),
        };
        // Variance 0.02 about a mean that is 0.1 off.
        let values = [2.0, 2.2];
        let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-12, "{a} {b}");
        near(reference(0.0).error(&values), (0.02f64 + 0.01).sqrt() / 2.0);
        near(reference(0.1).error(&values), 0.02f64.sqrt() / 2.0);
        // One value has no scatter, and a bias far beyond the error of the reference stays.
        near(reference(0.1).error(&[3.0]), (1.0f64 - 0.04).sqrt() / 2.0);
    }
}
