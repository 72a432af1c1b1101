//! The tracer on the simulations of Wang et al. 2017, at their angles.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use super::{Effort, Foretold, Measurements, Point, forecast};
use crate::model::flat_stack::FlatStack;
use crate::plan::scene::{Wish, plan};
use crate::plan::{Decision, TOLERANCE};
use crate::trace::run::{self, Shard};
use crate::trace::scene::{Prepared, Scene};

/// One scene at one angle.
pub(super) struct Traced {
    pub(super) name: String,
    theta_deg: f64,
    layers: &'static [Layer],
}

/// Roughness (0 for flat) and what is below.
type Layer = (f64, &'static str);

const GLASS: &str = "{ n = 1.5 }";
const DENSE: &str = "{ n = 2.4 }";

/// From easy to stiff: flat stacks whose answer is exact, single interfaces, layers, metals.
const SIMULATIONS: [(&str, &[Layer], &[f64]); 16] = [
    ("flat 1.5/2.4", &[(0.0, GLASS), (0.0, DENSE)], &[60.0]),
    ("flat 1.5/Au", &[(0.0, GLASS), (0.0, "\"Au\"")], &[60.0]),
    ("1.5 (.25)", &[(0.25, GLASS)], &[45.0]),
    ("Au (.25)", &[(0.25, "\"Au\"")], &[45.0]),
    (
        "1.5/2.4 (.1/.1)",
        &[(0.1, GLASS), (0.1, DENSE)],
        &[50.0, 56.0, 60.0, 65.0],
    ),
    (
        "1.5/2.4 (.3/.7)",
        &[(0.3, GLASS), (0.7, DENSE)],
        &[50.0, 65.0],
    ),
    (
        "1.5/2.4 (.1/.7)",
        &[(0.1, GLASS), (0.7, DENSE)],
        &[50.0, 65.0],
    ),
    (
        "1.5/2.4 (.7/.1)",
        &[(0.7, GLASS), (0.1, DENSE)],
        &[50.0, 65.0],
    ),
    (
        "1.5/Au (.1/.1)",
        &[(0.1, GLASS), (0.1, "\"Au\"")],
        &[10.0, 60.0, 80.0],
    ),
    (
        "1.5/Au (.1/.4)",
        &[(0.1, GLASS), (0.4, "\"Au\"")],
        &[40.0, 80.0],
    ),
    (
        "1.5/Au (.3/.1)",
        &[(0.3, GLASS), (0.1, "\"Au\"")],
        &[40.0, 80.0],
    ),
    (
        "1.5/Al (.1/.1)",
        &[(0.1, GLASS), (0.1, "\"Al\"")],
        &[60.0, 80.0],
    ),
    ("1.5/Al (.1/.4)", &[(0.1, GLASS), (0.4, "\"Al\"")], &[60.0]),
    (
        "1.3/Cu (.5/.3)",
        &[(0.5, "{ n = 1.3 }"), (0.3, "\"Cu\"")],
        &[40.0, 80.0],
    ),
    (
        "1.3/1.5/1.8 (.2/.3/.4)",
        &[(0.2, "{ n = 1.3 }"), (0.3, GLASS), (0.4, "{ n = 1.8 }")],
        &[40.0, 80.0],
    ),
    (
        "1.3/1.5/Au (.1/.1/.1)",
        &[(0.1, "{ n = 1.3 }"), (0.1, GLASS), (0.1, "\"Au\"")],
        &[40.0, 80.0],
    ),
];

pub(super) fn scenes(effort: Effort) -> Vec<Traced> {
    let all = SIMULATIONS
        .iter()
        .enumerate()
        .flat_map(|(n, (name, layers, angles))| {
            // The first of every third simulation is enough to see that all works.
            let taken = match effort {
                Effort::Full => angles.len(),
                Effort::Quick => usize::from(n % 3 == 0),
            };
            angles[..taken].iter().map(move |theta_deg| Traced {
                name: format!("{name} at {theta_deg}°"),
                theta_deg: *theta_deg,
                layers,
            })
        });
    all.collect()
}

impl Traced {
    /// The surfaces are the same in every run; only the photons' seed changes.
    fn scene(&self, method: &str, polarised: &str, photons: u64, seed: u64) -> Option<Scene> {
        let mut text = format!("[light]\ntheta_i_deg = {:?}\n", self.theta_deg);
        for (n, (alpha, below)) in self.layers.iter().enumerate() {
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

    fn prepared(&self, method: &str, polarised: &str, photons: u64, seed: u64) -> Option<Prepared> {
        self.scene(method, polarised, photons, seed)?
            .prepare(&|_| Err("no files here".to_owned()))
            .ok()
    }

    /// The exact answer of flat layers.
    fn exact(&self) -> Option<f64> {
        if self.layers.iter().any(|(alpha, _)| *alpha > 0.0) {
            return None;
        }
        let mut indices = vec![nalgebra::Complex::new(1.0, 0.0)];
        for (_, below) in self.layers {
            let index = match below.strip_prefix('"') {
                Some(name) => {
                    crate::trace::media::index_of(name.trim_end_matches('"'), 550.0).ok()?
                }
                None => {
                    let n = below.trim_matches(|c: char| !c.is_ascii_digit() && c != '.');
                    nalgebra::Complex::new(n.parse().ok()?, 0.0)
                }
            };
            indices.push(index);
        }
        let stack = FlatStack::new(indices).ok()?;
        let r = stack.reflect(self.theta_deg.to_radians()).ok()?;
        Some(r.channel.unpolarised())
    }
}

/// Share reflected with its standard error, and the seconds it took.
fn reflected(prepared: &Prepared, cancel: &AtomicBool) -> ([f64; 2], f64) {
    let started = Instant::now();
    let totals = run::trace(prepared, Shard::WHOLE, &|_| !cancel.load(Ordering::Relaxed));
    let r = totals.energies().reflected_all;
    ([r.value, r.std], started.elapsed().as_secs_f64())
}

/// Runs with other seeds whose errors make one point.
const REPEATS: u64 = 4;

pub(super) fn measure(
    scene: &Traced,
    effort: Effort,
    cancel: &AtomicBool,
    found: &mut Measurements,
) {
    let (sizes, long): (&[u64], u64) = match effort {
        Effort::Quick => (&[4_000, 16_000, 64_000], 500_000),
        Effort::Full => (&[4_000, 16_000, 64_000, 256_000], 4_000_000),
    };
    // Each method's reference is another method: the analog tracer's is the split one and the reverse.
    let exact = scene.exact().map(|r| (r, "exact (flat layers)".to_owned()));
    let against = |method: &str| {
        exact.clone().or_else(|| {
            let prepared = scene.prepared(method, "true", long, 77)?;
            let ([r, std], _) = reflected(&prepared, cancel);
            Some((
                r,
                format!("{method}, polarised, {long} photons, ± {std:.1e}"),
            ))
        })
    };
    let (Some(by_split), Some(by_analog)) = (against("split"), against("analog")) else {
        return;
    };
    let methods = [
        ("analog, polarised", "analog", Some("true"), &by_split),
        ("split, polarised", "split", Some("true"), &by_analog),
        ("split, scalar", "split", Some("false"), &by_analog),
        ("split, as planned", "split", None, &by_analog),
    ];
    for (label, method, polarised, (r, reference)) in methods {
        for photons in sizes {
            let (mut squares, mut seconds) = (0.0, 0.0);
            for seed in 1..=REPEATS {
                if cancel.load(Ordering::Relaxed) {
                    return;
                }
                let Some(mut prepared) =
                    scene.prepared(method, polarised.unwrap_or("\"auto\""), *photons, seed)
                else {
                    return;
                };
                let started = Instant::now();
                if polarised.is_none() {
                    prepared.polarised = follows_polarisation(scene, &prepared);
                }
                let ([value, _], _) = reflected(&prepared, cancel);
                seconds += started.elapsed().as_secs_f64();
                squares += (value / r - 1.0).powi(2);
            }
            found.points.push(Point {
                scene: scene.name.clone(),
                method: label.to_owned(),
                seconds: seconds / REPEATS as f64,
                error: (squares / REPEATS as f64).sqrt(),
                quantity: "relative error of the reflected energy".to_owned(),
                reference: reference.clone(),
            });
        }
    }
    if let Some(prepared) = scene.prepared("split", "true", long, 5) {
        let told = forecast::of_run(&prepared, None);
        let (_, taken_s) = reflected(&prepared, cancel);
        found.forecasts.push(Foretold {
            scene: scene.name.clone(),
            forecast_s: told.seconds,
            taken_s,
        });
    }
}

/// What the plan says at the default tolerance; its pilot's time counts.
fn follows_polarisation(scene: &Traced, prepared: &Prepared) -> bool {
    let wish = Wish {
        mueller: false,
        tolerance: TOLERANCE,
        photons: None,
    };
    scene
        .scene("split", "\"auto\"", prepared.photons, 1)
        .and_then(|s| {
            plan(&s, prepared, &wish)
                .on(Decision::Polarisation)
                .map(|c| c.included)
        })
        .unwrap_or(true)
}
