//! One traced run in its steps: ready, foretold, traced, written, reported, judged.

use std::io::IsTerminal;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::Instant;

use anyhow::anyhow;
use sha2::Digest;

use super::runs::LONG;
use super::{Args, making, pictures, prepare, ready, table, unreached};
use crate::accuracy::trace_forecast::{Asked, Patience, of_run};
use crate::cli::limits::{self, Stopwatch};
use crate::cli::progress::Bar;
use crate::cli::{CliError, interrupt, place};
use crate::clock::elapsed_s;
use crate::plan::scene::Wish;
use crate::plan::{self, Plan};
use crate::trace::report::{About, Report};
use crate::trace::run::{self, Ending, Progress, Shard, SoFar};
use crate::trace::scene::{Prepared, Scene};
use crate::trace::spread::over_surfaces;
use crate::trace::tally::Totals;
use crate::wording::{counted, hex};

/// A scene that is ready to trace, with what was asked of the run.
pub(super) struct Task<'a> {
    args: &'a Args,
    path: &'a Path,
    watch: Stopwatch,
    cancel: Arc<AtomicBool>,
    scene: Scene,
    prepared: Prepared,
    plan: Plan,
    shard: Shard,
    /// Tells whether two files are of one run.
    run_id: String,
    /// Seconds that the surfaces took to build.
    surface_seconds: f64,
}

/// What was traced, and the seconds that it took in all and until the first photon.
pub(super) struct Done {
    pub(super) so_far: SoFar,
    complete: bool,
    run_seconds: f64,
    setup_seconds: Option<f64>,
}

impl<'a> Task<'a> {
    /// Reads the scene, builds its surfaces and decides what is left out; refuses what cannot be done.
    pub(super) fn prepare(args: &'a Args) -> Result<Self, CliError> {
        let path = args
            .scene
            .as_deref()
            .ok_or_else(|| CliError::bad_input(anyhow!("which scene?")))?;
        limits::check(&[
            ("--max-seconds", args.max_seconds),
            ("--target-error", args.target_error),
        ])?;
        limits::check_tolerance(args.tolerance)?;
        let watch = Stopwatch::start(args.max_seconds);
        let cancel = interrupt::flag()?;
        let asked_for = path.to_owned();
        let (scene, mut prepared, mut fingerprint) =
            making::made(&watch, &cancel, move || prepare(&asked_for))?;
        let surface_seconds = watch.seconds();
        out_of(args).map_or(Ok(()), place::for_file)?;
        args.pictures.as_deref().map_or(Ok(()), place::for_files)?;
        // What is left out decides which bits come out: parts of one run leave out the same.
        fingerprint.update(format!("{:?}", args.tolerance));
        let wish = Wish {
            mueller: out_of(args).is_some() || args.pictures.is_some(),
            tolerance: args.tolerance.unwrap_or(plan::TOLERANCE),
            photons: args.tolerance.is_none().then_some(prepared.photons),
        };
        let plan = plan::scene::plan(&scene, &prepared, &wish);
        plan::scene::apply(&plan, &scene, &mut prepared);
        // Errors of polarisation are in the pictures alone.
        prepared.plane = args.pictures.is_some();
        if args.surfaces.is_some() && !prepared.is_drawn {
            return Err(CliError::bad_input(anyhow!(
                "--surfaces: no interface of the scene is drawn at random (beckmann, crystals, burrs), so there are no others"
            )));
        }
        let shard = args.shard.unwrap_or(Shard::WHOLE);
        shard.check(prepared.photons).map_err(|most| {
            CliError::bad_input(anyhow!(
                "--shard {}/{}: {} can be dealt out to {most} shards at most",
                shard.number,
                shard.of,
                counted(prepared.photons as usize, "photon")
            ))
        })?;
        Ok(Task {
            args,
            path,
            watch,
            cancel,
            scene,
            prepared,
            plan,
            shard,
            run_id: hex(&fingerprint.finalize()),
            surface_seconds,
        })
    }

    /// What a stopped run left, to go on with.
    pub(super) fn kept(&self) -> Result<Option<SoFar>, CliError> {
        let Prepared {
            photons, polarised, ..
        } = self.prepared;
        let file = self.args.resume.as_deref();
        file.map(|file| table::kept(file, &self.run_id, photons, self.shard, polarised))
            .transpose()
    }

    /// Says how long a whole run will take, where that is worth its time.
    pub(super) fn foretell(&self, goes_on: bool) {
        let args = self.args;
        let asked = args.target_error.is_some() || args.max_seconds.is_some();
        let worth = asked || (std::io::stderr().is_terminal() && self.prepared.photons >= LONG);
        if !worth || args.shard.is_some() || goes_on {
            return;
        }
        let asked = Asked {
            target_error: args.target_error,
            ..Asked::ALL
        };
        let patience = Patience::usual(args.max_seconds, &self.cancel);
        if let Some(told) = of_run(&self.prepared, asked, patience) {
            let forecast = told.times(args.surfaces.unwrap_or(1));
            super::say_forecast(forecast, args.max_seconds);
        }
    }

    pub(super) fn execute(&self, before: Option<SoFar>) -> Result<Done, CliError> {
        let Task {
            args,
            prepared,
            shard,
            cancel,
            watch,
            ..
        } = self;
        // The first photon comes once it is known where the light falls.
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
                    "nothing was finished in {seconds:.1} s: allow more time or ask for fewer photons"
                )));
            }
        }
        Ok(Done {
            complete: so_far.is_complete(prepared.photons, *shard),
            so_far,
            run_seconds,
            setup_seconds: set_up.get().copied(),
        })
    }

    pub(super) fn write(&self, done: &Done) -> Result<(), CliError> {
        let (args, stokes, totals) = (self.args, self.scene.light.stokes, &done.so_far.totals);
        let out = out_of(args);
        if let Some(out) = out {
            let part = (args.shard.is_some() || !done.complete).then(|| {
                let about = About::of(&self.prepared);
                let run_id = self.run_id.clone();
                table::Part::of(
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

    /// What is told, with other surfaces traced where that is asked for.
    pub(super) fn report(&self, done: &Done) -> Result<Report, CliError> {
        let totals = &done.so_far.totals;
        let mut report = Report::of(&self.prepared, totals);
        if let Some(count) = self.args.surfaces {
            let bar = Bar::new("surfaces");
            let again = |other: &Scene| -> Result<Prepared, CliError> {
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

    /// Whether what was asked for was reached.
    pub(super) fn verdict(&self, totals: &Totals) -> Result<(), CliError> {
        if self.is_cancelled() {
            return Err(CliError::Interrupted);
        }
        let reached = totals.relative_error();
        match self.args.target_error {
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

/// The file of the direction bins: a run that goes on writes where it was.
fn out_of(args: &Args) -> Option<&Path> {
    args.out.as_deref().or(args.resume.as_deref())
}

fn how_to_go_on(scene: &Path, out: Option<&Path>, shard: Option<Shard>) -> String {
    let shard = shard.map_or(String::new(), |s| format!(" --shard {}/{}", s.number, s.of));
    match out {
        Some(out) => format!(
            "stopped before the last photon; to go on: ridged trace {}{shard} --resume {}",
            scene.display(),
            out.display()
        ),
        None => "stopped before the last photon; with --out FILE.csv it could be gone on with"
            .to_owned(),
    }
}

/// Traces with a progress bar on a terminal.
fn watched(
    prepared: &Prepared,
    shard: Shard,
    before: Option<SoFar>,
    args: &Args,
    cancel: &AtomicBool,
    watch: &Stopwatch,
    first: &(dyn Fn() + Sync),
) -> SoFar {
    // Photons have no pace before it is known where the light falls.
    let (looking, bar) = (Bar::new("%"), Bar::new("photons"));
    let looked = AtomicBool::new(false);
    let left_s = args.max_seconds.map(|limit| limit - watch.seconds());
    let ending = Ending::of(left_s, elapsed_s, args.target_error);
    let so_far = run::resume(prepared, shard, before, ending, &|progress: &Progress| {
        if let Some(share) = progress.look {
            looking.show((100.0 * share) as u64, 100, "looking at the surface");
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
            .target_error
            .is_some_and(|target| progress.relative_error.is_some_and(|e| e <= target));
        !(cancel.load(Ordering::Relaxed) || watch.is_late() || good_enough)
    });
    looking.clear();
    bar.clear();
    so_far
}
