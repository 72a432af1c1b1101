//! The surfaces of a sweep: which there are, the contrast of one, and the sweeps that their contrasts make.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use anyhow::anyhow;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::{Args, SAME_DEG, Sweep, Swept, Wear, WearPoint, left_out};
use crate::cli::CliError;
use crate::cli::limits::{Stopwatch, check_paths};
use crate::cli::progress::Bar;
use crate::geometry::{Pose, RigGeometry};
use crate::model::contrast::{PAPER_AZIMUTHS_DEG, PAPER_RIDGES_DEG};
use crate::trace::counting::tally::MonteCarloEstimate;
use crate::trace::facets::scattering::{DiffuseBody, Roughness};
use crate::trace::pose_radiance::{RadianceOptions, RidgedSurface};
use crate::trace::rng::{Purpose, RandomStream};
use crate::trace::surfaces::worn_ridges::WornRidges;

/// The surfaces of a sweep: every wear at every ridge angle, numbered by wear, then by angle.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct Surfaces {
    wears: Vec<Wear>,
    /// The even steps, then the paper's ridge angles between them.
    angles_deg: Vec<f64>,
    /// Number of even steps.
    steps: usize,
    seed: u64,
}

impl Surfaces {
    /// Number of surfaces.
    pub fn count(&self) -> usize {
        self.wears.len() * self.angles_deg.len()
    }

    fn ridges(&self, theta_r_deg: f64, wear: Wear) -> WornRidges {
        let mut ridges = WornRidges::ideal(theta_r_deg.to_radians(), 1.0);
        ridges.seed = self.seed;
        match wear {
            Wear::Round(round) => ridges.round = round,
            Wear::Burr(burr) => ridges.burr = burr,
        }
        ridges
    }

    /// Makes the sweeps from the points of all surfaces in their order, of which the time limit left out `late`.
    pub fn swept(
        &self,
        points: &[Option<WearPoint>],
        late: usize,
        paths: u64,
        cut_short: bool,
    ) -> Swept {
        let sweeps = self.wears.iter().zip(points.chunks(self.angles_deg.len()));
        let sweeps = sweeps.map(|(wear, own)| {
            let of = |points: &[Option<WearPoint>]| points.iter().flatten().copied().collect();
            let points: Vec<WearPoint> = of(&own[..self.steps]);
            Sweep {
                wear: *wear,
                missing: if late > 0 {
                    self.steps - points.len()
                } else {
                    0
                },
                points,
                between: of(&own[self.steps..]),
            }
        });
        let burrs = self.wears.iter();
        let burrs = burrs.filter(|wear| matches!(wear, Wear::Burr(_)));
        let cuts = burrs.filter_map(|wear| {
            let angles = self.angles_deg.iter();
            let all = angles.map(|theta_r_deg| self.ridges(*theta_r_deg, *wear));
            let cut = all.filter_map(|r| r.burr_cut().map(|(most, mean)| (r.burr, most, mean)));
            cut.min_by(|a, b| a.2.total_cmp(&b.2))
        });
        Swept {
            sweeps: sweeps.collect(),
            left_out: left_out(late, self.count(), cuts),
            paths,
            cut_short: cut_short || late > 0,
        }
    }
}

/// The surfaces with all that tracing them needs.
pub(super) struct Study {
    pub surfaces: Surfaces,
    rig: RigGeometry,
    roughness: Roughness,
    index: [f64; 2],
    body: Option<DiffuseBody>,
    tilts_deg: Vec<f64>,
}

impl Study {
    /// Checks the options and lists the surfaces.
    pub fn of(args: &Args) -> Result<Self, CliError> {
        let bad = |what: String| Err(CliError::bad_input(anyhow!(what)));
        let (low, high, step) = (
            args.theta_r_min_deg,
            args.theta_r_max_deg,
            args.theta_r_step_deg,
        );
        if !(low >= 0.2 && low < high && high <= 45.0 && step >= 0.01 && step <= high - low) {
            return bad(format!(
                "ridge angles from {low} to {high} by {step} degrees are out of range: expected rising bounds within 0.2 and \
                 45, and a step from 0.01 up to their distance"
            ));
        }
        let (rig, optics, surface) = args.scene.build(&[low, high])?;
        for (name, list) in [("--rounds", &args.rounds), ("--burrs", &args.burrs)] {
            if let Some(x) = list.iter().find(|x| !(0.0..=1.0).contains(*x)) {
                return bad(format!(
                    "{name} {x} is out of range: expected 0 to 1 facet lengths"
                ));
            }
        }
        check_paths(args.paths)?;
        let wears = args.rounds.iter().copied().map(Wear::Round);
        let wears: Vec<Wear> = wears
            .chain(args.burrs.iter().copied().map(Wear::Burr))
            .collect();
        if wears.is_empty() {
            return bad("no wear to sweep: give --rounds or --burrs".to_owned());
        }
        let steps = ((high - low) / step + 1e-9) as usize + 1;
        let mut angles_deg: Vec<f64> = (0..steps).map(|n| low + step * n as f64).collect();
        // The paper's ridges are traced, not interpolated: the contrast changes its course by a tenth within two degrees.
        for t in PAPER_RIDGES_DEG {
            let is_in = (low - SAME_DEG..=high + SAME_DEG).contains(&t);
            if is_in && angles_deg.iter().all(|a| (a - t).abs() >= SAME_DEG) {
                angles_deg.push(t);
            }
        }
        let body = DiffuseBody::new(surface.rho_d, optics.eta, 1.0, optics.theta_l.cos());
        Ok(Study {
            surfaces: Surfaces {
                wears,
                angles_deg,
                steps,
                seed: args.seed,
            },
            rig,
            roughness: Roughness {
                alpha_u: surface.alpha_u,
                alpha_v: surface.alpha_v,
            },
            index: [optics.eta, optics.k],
            body: (optics.k == 0.0 && surface.rho_d > 0.0).then_some(body),
            tilts_deg: args.scene.theta_c_deg.clone(),
        })
    }

    /// Traces the surface of a number; `None` once it is to stop, and for ridges without a profile.
    pub fn point(
        &self,
        number: usize,
        paths: u64,
        stopped: &(dyn Fn() -> bool + Sync),
    ) -> Option<WearPoint> {
        let Surfaces {
            wears, angles_deg, ..
        } = &self.surfaces;
        let theta_r_deg = angles_deg[number % angles_deg.len()];
        let wear = wears[number / angles_deg.len()];
        let profile = self.surfaces.ridges(theta_r_deg, wear).profile().ok()?;
        let effective = profile.effective_ridge_angle()?.to_degrees();
        let worn = RidgedSurface::new(profile, self.roughness, self.index, self.body);
        Some(WearPoint {
            theta_r_deg,
            effective_deg: effective,
            contrast: self.contrast(&worn, paths, stopped)?,
        })
    }

    /// Traces the surfaces of these numbers on all cores. Those that the time limit does not reach have no point.
    pub fn points(
        &self,
        numbers: Vec<usize>,
        paths: u64,
        watch: &Stopwatch,
        cancel: &AtomicBool,
    ) -> Result<Vec<Option<WearPoint>>, CliError> {
        let stopped = || cancel.load(Ordering::Relaxed) || watch.is_late();
        let (bar, done, count) = (Bar::new("surfaces"), AtomicU64::new(0), numbers.len());
        let points = numbers
            .into_par_iter()
            .map(|number| {
                if stopped() {
                    return None;
                }
                let point = self.point(number, paths, &stopped)?;
                bar.at(1 + done.fetch_add(1, Ordering::Relaxed), count as u64);
                Some(point)
            })
            .collect();
        match cancel.load(Ordering::Relaxed) {
            true => Err(CliError::Interrupted),
            false => Ok(points),
        }
    }

    /// Returns the mean absolute contrast over the tilts; all surfaces use the same random numbers. `None` once it is to
    /// stop.
    fn contrast(
        &self,
        surface: &RidgedSurface,
        paths: u64,
        stopped: &(dyn Fn() -> bool + Sync),
    ) -> Option<MonteCarloEstimate> {
        let tilts = &self.tilts_deg;
        let (mut sum, mut variance) = (0.0, 0.0);
        for (t, tilt) in tilts.iter().enumerate() {
            if stopped() {
                return None;
            }
            let radiance = [0, 1, 2].map(|a| {
                let index = (3 * t + a) as u64;
                let options = RadianceOptions {
                    paths,
                    seed: RandomStream::new(self.surfaces.seed, Purpose::Batch, index).bits(),
                    cones: self.rig.cones,
                    polarised: true,
                };
                let pose = Pose::from_deg(*tilt, PAPER_AZIMUTHS_DEG[a]);
                surface.radiance(&self.rig.directions(pose), &options)
            });
            let [a, b, c] = radiance.map(|e| e.value);
            sum += (a - b).abs() + (b - c).abs();
            // The middle radiance is in both differences.
            let weights = [
                (a - b).signum(),
                (b - c).signum() - (a - b).signum(),
                -(b - c).signum(),
            ];
            let parts = weights.iter().zip(radiance);
            variance += parts.map(|(w, e)| (w * e.std).powi(2)).sum::<f64>();
        }
        let n = 2.0 * tilts.len() as f64;
        Some(MonteCarloEstimate {
            value: sum / n,
            std: variance.sqrt() / n,
        })
    }
}
