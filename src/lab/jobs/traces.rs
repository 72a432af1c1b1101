//! Traces: light through a scene by Monte Carlo.
//!
//! The result of a trace has energies and errors; its files have the direction bins, so that the page can draw any of
//! them. With `compare` every path is traced with and without polarisation; if a material depends on the wavelength, at
//! the wavelengths of Wang et al. 2017.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use serde::{Deserialize, Serialize};

use super::progress::ProgressMeter;
use super::trace_result::{self, Bins, Comparison, Light, TraceResult};
use super::work::{Finished, Work};
use crate::accuracy::trace_forecast::{Patience, TraceExtent, of_runs};
use crate::clock::elapsed_s;
use crate::forecast::Forecast;
use crate::lab::LabError;
use crate::lab::exchange::uploads::{Content, DescribedContent};
use crate::lab::failure::Failure;
use crate::lab::request_checks::{invalid, positive};
use crate::lab::tasks::blocking;
use crate::store::StoreError;
use crate::trace::counting::polarisation_difference::{
    DirectionMask, PolarisationDifference, WAVELENGTHS_NM,
};
use crate::trace::counting::tally::Totals;
use crate::trace::report::TraceReport;
use crate::trace::run::{Follow, StopPolicy, TraceProgress, trace_following};
use crate::trace::scene::{BuiltShapes, PreparedScene, Scene, SceneError};
use crate::trace::surface_spread::{Surfaces, over_surfaces};
use crate::wording::{json, significant};

/// Largest number of direction bins per side, 0.5° by 0.5°: more make the files too large for the page.
const BINS_MAX: usize = 180 * 720;

/// Allowed numbers of surfaces with the same statistics.
const SURFACES: std::ops::RangeInclusive<u32> = 2..=1000;

/// A request for a trace.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct TraceRequest {
    /// The scene, as TOML text or as an object with the same keys.
    pub scene: serde_json::Value,
    /// Files that the scene names, by `path`.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    #[schema(value_type = BTreeMap<String, DescribedContent>)]
    pub files: BTreeMap<String, Content>,
    /// Number of photons instead of the scene's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 1, maximum = 9_007_199_254_740_991_i64)]
    pub photons: Option<u64>,
    /// Stop after this time, s; the result has what is finished until then.
    #[serde(default)]
    #[schema(exclusive_minimum = 0, maximum = 1e9)]
    pub max_seconds: Option<f64>,
    /// Stop once the relative error of the reflected bins (root mean square) is below this.
    #[serde(default)]
    #[schema(exclusive_minimum = 0, maximum = 1e9)]
    pub target_error: Option<f64>,
    /// Trace every path with and without polarisation, and report where the latter is wrong.
    #[serde(default)]
    pub compare: bool,
    /// Trace this number of surfaces with the same statistics, and report how much they differ.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 2, maximum = 1000)]
    pub surfaces: Option<u32>,
}

/// A checked trace with its surfaces.
pub(in crate::lab) struct TraceWork {
    request: TraceRequest,
    scene: Scene,
    shapes: BuiltShapes,
    prepared: PreparedScene,
}

impl TraceRequest {
    pub(in crate::lab) async fn prepare(&self) -> Result<TraceWork, LabError> {
        let request = self.clone();
        // Building the surfaces takes a while.
        blocking(move || request.build()).await?
    }

    /// Checks everything and builds the surfaces.
    fn build(&self) -> Result<TraceWork, LabError> {
        positive([
            ("max_seconds", self.max_seconds),
            ("target_error", self.target_error),
        ])?;
        let wrong = |problem: String| invalid("scene", problem);
        let mut scene = match &self.scene {
            serde_json::Value::String(text) => {
                Scene::parse(text).map_err(|e| wrong(e.to_string()))?
            }
            object => json::from_value(object).map_err(|refusal| {
                invalid(refusal.path_below("scene"), refusal.message("field"))
            })?,
        };
        if let Some(photons) = self.photons {
            scene.run.photons = photons;
        }
        scene.check().map_err(|e| wrong(e.to_string()))?;
        let bins = scene.run.theta_bins * scene.run.phi_bins;
        if bins > BINS_MAX {
            return Err(wrong(format!(
                "run.theta_bins × run.phi_bins = {bins}: at most {BINS_MAX} here; `ridged trace` takes more"
            )));
        }
        self.check_files(&scene)?;
        if self.surfaces.is_some_and(|n| !SURFACES.contains(&n)) {
            return Err(invalid(
                "surfaces",
                format!("must be {} to {}", SURFACES.start(), SURFACES.end()),
            ));
        }
        let shapes = self.shapes(&scene).map_err(|e| wrong(e.to_string()))?;
        let prepared = scene.prepare_on(&shapes);
        let prepared = prepared.map_err(|e| wrong(e.to_string()))?;
        if self.compare && !prepared.polarised {
            return Err(invalid(
                "compare",
                "needs run.polarised = true or \"auto\" in the scene",
            ));
        }
        if self.surfaces.is_some() && !prepared.is_drawn {
            return Err(invalid(
                "surfaces",
                "no interface of the scene is random (beckmann, crystals, burrs), so all surfaces would be the same",
            ));
        }
        Ok(TraceWork {
            request: self.clone(),
            scene,
            shapes,
            prepared,
        })
    }

    /// Refuses file names that are not plain, and files that no interface names.
    fn check_files(&self, scene: &Scene) -> Result<(), LabError> {
        let wrong = |problem: String| Err(invalid("files", problem));
        for name in self.files.keys() {
            let plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '.' | '-' | '_');
            if name.len() > FILE_NAME_MAX || !name.chars().all(plain) {
                return wrong(format!(
                    "{name:?}: a name has at most {FILE_NAME_MAX} letters, digits, dots, dashes and underscores"
                ));
            }
            let asked = |path: &Option<String>| path.as_deref() == Some(name);
            if !scene.interface.iter().any(|i| asked(&i.path)) {
                return wrong(format!("no interface of the scene has path = {name:?}"));
            }
        }
        Ok(())
    }

    fn shapes(&self, scene: &Scene) -> Result<BuiltShapes, SceneError> {
        scene.shapes(&|name| match self.files.get(name) {
            Some(content) => content.heights(name),
            None => Err(format!(
                "is missing: send it as `files`: {{{name:?}: content in base64}}"
            )),
        })
    }
}

/// Longest file name in a request.
const FILE_NAME_MAX: usize = 100;
/// Prefix of these files' names among the files of the result.
const GIVEN: &str = "given-";

impl TraceWork {
    /// Wavelengths to trace, the scene's first: energies and bins belong to it.
    fn wavelengths(&self) -> Vec<f64> {
        let mut wavelengths = vec![self.scene.light.wavelength_nm];
        if self.request.compare && self.scene.depends_on_wavelength() {
            wavelengths.extend(WAVELENGTHS_NM);
        }
        wavelengths
    }

    fn follow(&self) -> Follow {
        if self.request.compare {
            Follow::Both
        } else {
            Follow::Scene
        }
    }

    /// Returns the scene at another wavelength.
    fn at(&self, wavelength_nm: f64) -> Result<PreparedScene, SceneError> {
        let mut scene = self.scene.clone();
        scene.light.wavelength_nm = wavelength_nm;
        scene.prepare_on(&self.shapes)
    }

    /// Traces energies on other surfaces with the same statistics; none if the time is over.
    fn surfaces(
        &self,
        own: &Totals,
        count: u32,
        started: Instant,
        progress: &ProgressMeter,
        cancel: &AtomicBool,
    ) -> Result<Option<Surfaces>, Failure> {
        let again = |scene: &Scene| scene.prepare_on(&self.request.shapes(scene)?);
        let late = || {
            let limit = self.request.max_seconds;
            limit.is_some_and(|limit| started.elapsed().as_secs_f64() >= limit)
        };
        let go_on = |done: usize| {
            progress.report("tracing other surfaces", done as u64, u64::from(count));
            !cancel.load(Ordering::Relaxed) && !late()
        };
        let found = over_surfaces(&self.scene, own, count as usize, &again, &go_on);
        if cancel.load(Ordering::Relaxed) {
            return Err(Failure::Cancelled);
        }
        found.map_err(|e| Failure::because("no-trace", e))
    }

    /// Traces one wavelength within its share of the time; `left` counts the remaining runs, including this one.
    fn one_run(
        &self,
        prepared: &PreparedScene,
        started: Instant,
        left: usize,
        go_on: &(dyn Fn(u64) -> bool + Sync),
    ) -> Totals {
        let begun = Instant::now();
        let share = self.request.max_seconds.map(|limit| {
            let rest = limit - begun.duration_since(started).as_secs_f64();
            rest.max(0.0) / left as f64
        });
        let proceed = |progress: &TraceProgress| {
            let late = share.is_some_and(|limit| begun.elapsed().as_secs_f64() >= limit);
            go_on(progress.photons) && !late && !self.is_reached(progress.relative_error)
        };
        let ending = StopPolicy::of(share, elapsed_s, self.request.target_error);
        trace_following(prepared, self.follow(), ending, &proceed)
    }

    fn is_reached(&self, error: Option<f64>) -> bool {
        matches!((self.request.target_error, error), (Some(target), Some(error)) if error <= target)
    }

    fn warnings(&self, report: &TraceReport, started: Instant) -> Vec<String> {
        let mut warnings = Vec::new();
        let late = |limit: f64| started.elapsed().as_secs_f64() >= limit;
        if let Some(target) = self.request.target_error
            && !self.is_reached(report.relative_error)
        {
            let got = match report.relative_error {
                None => "no light was reflected beyond its own noise".to_owned(),
                Some(e) => format!(
                    "{} photons gave {}; about {} photons are needed",
                    report.photons,
                    significant(e),
                    significant(report.photons as f64 * (e / target).powi(2))
                ),
            };
            warnings.push(format!("the target error {target} was not reached: {got}"));
        } else if let Some(limit) = self.request.max_seconds
            && report.photons < self.scene.run.photons
            && late(limit)
        {
            warnings.push(format!(
                "stopped after {limit} s: {} of {} photons were traced",
                report.photons, self.scene.run.photons
            ));
        }
        warnings
    }

    fn write(
        &self,
        folder: &Path,
        totals: &Totals,
        light: &Light,
        difference: Option<&PolarisationDifference>,
    ) -> Result<Vec<String>, Failure> {
        let files = trace_result::files(totals, light, difference).map_err(Failure::not_json)?;
        let given = self.request.files.iter();
        let given = given.map(|(name, content)| (format!("{GIVEN}{name}"), &content.0));
        let made = files
            .iter()
            .map(|(name, content)| ((*name).to_owned(), content));
        let mut names = Vec::new();
        for (name, content) in made.chain(given) {
            let path = folder.join(&name);
            std::fs::write(&path, content).map_err(|e| {
                Failure::because("trace-not-written", StoreError::file("a trace", &path, e))
            })?;
            names.push(name);
        }
        Ok(names)
    }
}

impl Work for TraceWork {
    fn forecast(&self, cancel: &AtomicBool) -> Option<Forecast> {
        let request = &self.request;
        let patience = Patience::usual(request.max_seconds, cancel);
        let asked = TraceExtent {
            follow: self.follow(),
            target_error: request.target_error,
        };
        let wavelengths = self.wavelengths();
        let made = |n: usize| match n {
            0 => Some(self.prepared.clone()),
            _ => self.at(wavelengths[n]).ok(),
        };
        let forecast = of_runs(wavelengths.len(), &made, asked, patience)?;
        let forecast = forecast.times(request.surfaces.unwrap_or(1));
        Some(forecast.drawn_within(request.max_seconds))
    }

    fn run(
        &self,
        folder: &Path,
        progress: &ProgressMeter,
        cancel: &AtomicBool,
    ) -> Result<Finished, Failure> {
        let started = Instant::now();
        let wavelengths = self.wavelengths();
        let mut runs: Vec<Totals> = Vec::new();
        let (mut traced, mut own_seconds) = (Vec::new(), 0.0);
        for (done, &wavelength) in wavelengths.iter().enumerate() {
            let other = (done > 0).then(|| self.at(wavelength));
            let other = other.transpose().map_err(|e| {
                Failure::because("no-trace", format_args!("at {wavelength} nm: {e}"))
            })?;
            let prepared = other.as_ref().unwrap_or(&self.prepared);
            let left = wavelengths.len() - done;
            let totals = self.one_run(prepared, started, left, &|photons| {
                let each = prepared.photons;
                let all = each.saturating_mul(wavelengths.len() as u64);
                let so_far = each.saturating_mul(done as u64);
                progress.report("tracing photons", so_far.saturating_add(photons), all);
                !cancel.load(Ordering::Relaxed)
            });
            if cancel.load(Ordering::Relaxed) {
                return Err(Failure::Cancelled);
            }
            if done == 0 {
                own_seconds = started.elapsed().as_secs_f64();
            }
            if totals.photons() > 0 {
                traced.push(wavelength);
                runs.push(totals);
            } else if done == 0 {
                return Err(Failure::because(
                    "no-trace",
                    "nothing was finished within the time limit: raise max_seconds or lower photons",
                ));
            }
        }
        let own = &runs[0];
        let mut report = TraceReport::of(&self.prepared, own);
        if let Some(count) = self.request.surfaces {
            report.spread_over(self.surfaces(own, count, started, progress, cancel)?);
        }
        progress.report("writing the bins", 0, 1);
        let seconds = started.elapsed().as_secs_f64();
        report.seconds = Some(seconds);
        report.run_seconds = Some(own_seconds);
        let difference = self.request.compare.then(|| {
            let compared = if runs.len() > 1 {
                &runs[1..]
            } else {
                &runs[..]
            };
            PolarisationDifference::of(compared, &DirectionMask::default())
        });
        let difference = difference.flatten();
        let light = Light::of(&self.scene);
        let files = self.write(folder, own, &light, difference.as_ref())?;
        let mut warnings = self.warnings(&report, started);
        if traced.len() < wavelengths.len() {
            let missing = wavelengths.iter().filter(|w| !traced.contains(w));
            let missing: Vec<String> = missing.map(|w| format!("{w}")).collect();
            warnings.push(format!(
                "nothing was finished within the time limit at {} nm: the comparison omits this wavelength",
                missing.join(", ")
            ));
        }
        let compared_nm = match &traced[..] {
            [_, others @ ..] if !others.is_empty() => others.to_vec(),
            one => one.to_vec(),
        };
        Finished::new(&TraceResult {
            light,
            bins: Bins::of(own),
            comparison: difference.map(|d| Comparison::of(&d, compared_nm)),
            files,
            warnings,
            report,
        })
    }
}
