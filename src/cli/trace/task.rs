//! One traced run in its steps: prepare, forecast, trace, write, report, check.

use std::io::IsTerminal;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::Instant;

use anyhow::anyhow;
use sha2::Digest;

use super::runs::LONG;
use super::{Args, pictures, prepare, ready, surface_build, table, unreached};
use crate::accuracy::trace_forecast::{Patience, TraceExtent, of_run};
use crate::cli::kept_part::KeptPart;
use crate::cli::limits::Stopwatch;
use crate::cli::progress::Bar;
use crate::cli::{CliError, interrupt, output_collision, output_path, shards};
use crate::clock::elapsed_s;
use crate::plan::scene::TracePlanRequest;
use crate::plan::{self, ComputationPlan};
use crate::trace::counting::tally::Totals;
use crate::trace::report::{About, TraceReport};
use crate::trace::run::{self, PartialRun, Shard, StopPolicy, TraceProgress, check_shard};
use crate::trace::scene::{PreparedScene, Scene};
use crate::trace::surface_spread::over_surfaces;
use crate::wording::hex;

/// A prepared scene with the options of the run.
pub(super) struct TraceTask<'a> {
    args: &'a Args,
    path: &'a Path,
    watch: Stopwatch,
    cancel: Arc<AtomicBool>,
    scene: Scene,
    prepared: PreparedScene,
    plan: ComputationPlan,
    shard: Shard,
    /// Identifies the run: files of one run have the same.
    run_id: String,
    /// Seconds that the surfaces took to build.
    surface_seconds: f64,
}

/// The traced part, and the seconds in total and until the first photon.
pub(super) struct FinishedTask {
    pub(super) so_far: PartialRun,
    complete: bool,
    run_seconds: f64,
    setup_seconds: Option<f64>,
}

impl<'a> TraceTask<'a> {
    /// Reads the scene, builds its surfaces and decides what is left out; refuses options that do not apply.
    pub(super) fn prepare(args: &'a Args) -> Result<Self, CliError> {
        let path = args
            .scene
            .as_deref()
            .ok_or_else(|| CliError::bad_input(anyhow!("expected the file of a scene")))?;
        args.limits.check()?;
        let watch = Stopwatch::start(args.limits.max_seconds);
        let cancel = interrupt::flag()?;
        let asked_for = path.to_owned();
        let (scene, mut prepared, mut fingerprint) =
            surface_build::build(&watch, &cancel, move || prepare(&asked_for))?;
        let surface_seconds = watch.seconds();
        args.pictures
            .as_deref()
            .map_or(Ok(()), output_path::check_folder)?;
        // The bits of the result depend on what is left out, so all parts of one run leave out the same.
        fingerprint.update(format!("{:?}", args.limits.tolerance));
        let run_id = hex(&fingerprint.finalize());
        check_out(args, &run_id)?;
        let wish = TracePlanRequest {
            mueller: out_of(args).is_some() || args.pictures.is_some(),
            tolerance: args.limits.tolerance.unwrap_or(plan::TOLERANCE),
            photons: args.limits.tolerance.is_none().then_some(prepared.photons),
        };
        let plan = plan::scene::plan(&scene, &prepared, &wish);
        plan::scene::apply(&plan, &scene, &mut prepared);
        // Only the pictures show errors of polarisation.
        prepared.plane = args.pictures.is_some();
        if args.surfaces.is_some() && !prepared.is_drawn {
            return Err(CliError::bad_input(anyhow!(
                "--surfaces: the scene has no random interface (beckmann, crystals, burrs), so all surfaces would be equal"
            )));
        }
        let shard = args.shard.unwrap_or(Shard::WHOLE);
        check_shard(shard, prepared.photons)
            .map_err(|most| shards::too_many(shard, prepared.photons, "photon", most))?;
        Ok(TraceTask {
            args,
            path,
            watch,
            cancel,
            scene,
            prepared,
            plan,
            shard,
            run_id,
            surface_seconds,
        })
    }

    /// Reads the state of a stopped run.
    pub(super) fn kept(&self) -> Result<Option<PartialRun>, CliError> {
        let PreparedScene {
            photons, polarised, ..
        } = self.prepared;
        let file = self.args.resume.as_deref();
        file.map(|file| table::kept(file, &self.run_id, photons, self.shard, polarised))
            .transpose()
    }

    /// Prints a forecast of the whole run, where it is worth its time.
    pub(super) fn print_forecast(&self, goes_on: bool) {
        let args = self.args;
        let asked = args.limits.is_any();
        let worth = asked || (std::io::stderr().is_terminal() && self.prepared.photons >= LONG);
        if !worth || args.shard.is_some() || goes_on {
            return;
        }
        let asked = TraceExtent {
            target_error: args.limits.target_error,
            ..TraceExtent::ALL
        };
        let patience = Patience::usual(args.limits.max_seconds, &self.cancel);
        if let Some(one) = of_run(&self.prepared, asked, patience) {
            let forecast = one.times(args.surfaces.unwrap_or(1));
            super::say_forecast(forecast, args.limits.max_seconds);
        }
    }

    pub(super) fn execute(&self, before: Option<PartialRun>) -> Result<FinishedTask, CliError> {
        let TraceTask {
            args,
            prepared,
            shard,
            cancel,
            watch,
            ..
        } = self;
        // The first photon is traced once the illuminated part of the surface is found.
        let (set_up, run_started) = (OnceLock::new(), Instant::now());
        let so_far = watched(prepared, *shard, before, args, cancel, watch, &|| {
            set_up.get_or_init(|| run_started.elapsed().as_secs_f64());
        });
        let run_seconds = run_started.elapsed().as_secs_f64();
        if so_far.totals.photons() == 0 {
            if self.is_cancelled() {
                return Err(CliError::Interrupted);
            }
            if args.shard.is_none() {
                let seconds = watch.seconds();
                return Err(CliError::no_result(anyhow!(
                    "no batch was finished in {seconds:.1} s: allow more time, or give fewer photons"
                )));
            }
        }
        Ok(FinishedTask {
            complete: so_far.is_complete(prepared.photons, *shard),
            so_far,
            run_seconds,
            setup_seconds: set_up.get().copied(),
        })
    }

    pub(super) fn write(&self, done: &FinishedTask) -> Result<(), CliError> {
        let (args, stokes, totals) = (self.args, self.scene.light.stokes, &done.so_far.totals);
        let out = out_of(args);
        if let Some(out) = out {
            let part = (args.shard.is_some() || !done.complete).then(|| {
                let about = About::of(&self.prepared);
                let run_id = self.run_id.clone();
                table::ShardPart::of(
                    run_id,
                    self.shard,
                    &done.so_far,
                    done.complete,
                    stokes,
                    about,
                )
            });
            table::write(out, totals, &stokes, part.as_ref())?;
        }
        if !done.complete {
            super::super::say(&format_args!(
                "{}",
                how_to_go_on(self.path, out, args.shard)
            ));
        }
        if totals.photons() == 0 && !self.is_cancelled() {
            return Err(CliError::no_result(anyhow!(
                "no photon was traced: allow more time"
            )));
        }
        match &args.pictures {
            Some(folder) => pictures::write(folder, &self.scene, totals),
            None => Ok(()),
        }
    }

    /// Makes the report; traces further surfaces if `--surfaces` asks for them.
    pub(super) fn report(&self, done: &FinishedTask) -> Result<TraceReport, CliError> {
        let totals = &done.so_far.totals;
        let mut report = TraceReport::of(&self.prepared, totals);
        if let Some(count) = self.args.surfaces {
            let bar = Bar::new("surfaces");
            let again = |other: &Scene| -> Result<PreparedScene, CliError> {
                let mut other_one = ready(self.path, other)?;
                plan::scene::apply(&self.plan, &self.scene, &mut other_one);
                Ok(other_one)
            };
            let go_on = |done: usize| {
                bar.at(done as u64, u64::from(count));
                !self.is_cancelled() && !self.watch.is_late()
            };
            let spread = over_surfaces(&self.scene, totals, count as usize, &again, &go_on)?;
            report.spread_over(spread);
        }
        report.seconds = Some(self.watch.seconds());
        report.run_seconds = Some(done.run_seconds);
        report.setup_seconds = done.setup_seconds;
        report.surface_seconds = Some(self.surface_seconds);
        Ok(report)
    }

    /// Checks that the target error was reached.
    pub(super) fn verdict(&self, totals: &Totals) -> Result<(), CliError> {
        if self.is_cancelled() {
            return Err(CliError::Interrupted);
        }
        let reached = totals.relative_error();
        match self.args.limits.target_error {
            Some(target) if reached.is_none_or(|e| e > target) && !self.watch.is_late() => Err(
                CliError::no_result(unreached(target, reached, totals.photons())),
            ),
            _ => Ok(()),
        }
    }

    fn is_cancelled(&self) -> bool {
        self.cancel.load(Ordering::Relaxed)
    }
}

/// The file of the direction bins; a resumed run writes to its own file by default.
fn out_of(args: &Args) -> Option<&Path> {
    args.out.as_deref().or(args.resume.as_deref())
}

/// Checks that the file of the direction bins can be written. Of parts of runs, it replaces the one that it continues, and a
/// finished shard that it computes again.
fn check_out(args: &Args, run_id: &str) -> Result<(), CliError> {
    let Some(out) = out_of(args) else {
        return Ok(());
    };
    let resumes = |resumed: &Path| resumed == out || output_collision::same_file(resumed, out);
    let is_same = || {
        let part = KeptPart::read(out);
        args.shard.is_some()
            && part.is_some_and(|part| {
                part.is_complete
                    && part.shard == args.shard
                    && part.run_id.as_deref() == Some(run_id)
            })
    };
    match args.resume.as_deref().is_some_and(resumes) || is_same() {
        true => output_path::check_writable(out),
        false => output_path::check_file(out),
    }
}

fn how_to_go_on(scene: &Path, out: Option<&Path>, shard: Option<Shard>) -> String {
    let shard = shard.map_or(String::new(), |shard| format!(" --shard {shard}"));
    match out {
        Some(out) => format!(
            "stopped before the last photon; to resume: ridged trace {}{shard} --resume {}",
            scene.display(),
            out.display()
        ),
        None => "stopped before the last photon; to be able to resume, run with --out FILE.csv"
            .to_owned(),
    }
}

/// Traces with a progress bar on a terminal.
fn watched(
    prepared: &PreparedScene,
    shard: Shard,
    before: Option<PartialRun>,
    args: &Args,
    cancel: &AtomicBool,
    watch: &Stopwatch,
    first: &(dyn Fn() + Sync),
) -> PartialRun {
    // Photons have no pace before the illuminated part of the surface is found.
    let (looking, bar) = (Bar::new("%"), Bar::new("photons"));
    let looked = AtomicBool::new(false);
    let left_s = args.limits.max_seconds.map(|limit| limit - watch.seconds());
    let ending = StopPolicy::of(left_s, elapsed_s, args.limits.target_error);
    let so_far = run::resume(
        prepared,
        shard,
        before,
        ending,
        &|progress: &TraceProgress| {
            if let Some(share) = progress.surface_analysis {
                looking.show(
                    (100.0 * share) as u64,
                    100,
                    "finding the illuminated surface",
                );
            } else {
                if !looked.swap(true, Ordering::Relaxed) {
                    looking.clear();
                }
                first();
                let error = progress.relative_error;
                let word = error.map_or(String::new(), |e| format!("error {:.2} %", 100.0 * e));
                bar.show(progress.photons, progress.photons_planned, &word);
            }
            let good_enough = args
                .limits
                .target_error
                .is_some_and(|target| progress.relative_error.is_some_and(|e| e <= target));
            !(cancel.load(Ordering::Relaxed) || watch.is_late() || good_enough)
        },
    );
    looking.clear();
    bar.clear();
    so_far
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::parsed;

    #[test]
    fn the_state_of_a_stopped_run_is_replaced_only_by_the_run_that_continues_it() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("bins.csv");
        let name = file.to_str().unwrap();
        let keep = |of: u64, complete: bool| {
            let part =
                format!(r#"{{""run"":""r"",""shard"":1,""of"":{of},""complete"":{complete}}}"#);
            let text = format!("side,exact,plane,run\nup,,,\"{part}\"\n");
            std::fs::write(&file, text).unwrap();
        };
        let is_allowed = |run: &str, options: &[&str]| {
            let all = [&["scene.toml"][..], options].concat();
            check_out(&parsed(&all), run).is_ok()
        };
        keep(1, false);
        assert!(!is_allowed("r", &["--out", name]));
        assert!(!is_allowed("r", &["--resume", "other.csv", "--out", name]));
        assert!(is_allowed("r", &["--resume", name]));
        assert!(is_allowed("r", &["--resume", name, "--out", name]));
        keep(2, true);
        assert!(is_allowed("r", &["--shard", "1/2", "--out", name]));
        assert!(!is_allowed("other", &["--shard", "1/2", "--out", name]));
        assert!(!is_allowed("r", &["--shard", "2/2", "--out", name]));
        assert!(!is_allowed("r", &["--out", name]));
        keep(2, false);
        assert!(!is_allowed("r", &["--shard", "1/2", "--out", name]));
        // A finished run is a table as any other.
        std::fs::write(&file, "side,hits\n").unwrap();
        assert!(is_allowed("r", &["--out", name]));
    }
}
