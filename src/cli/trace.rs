//! `ridged trace`: energies and Mueller bins of a scene; and the merging of shards.

mod compare;
mod curves;
mod ellipsometer;
mod hemisphere;
mod pictures;
mod runs;
mod surface_build;
mod table;
mod task;

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, anyhow};
use serde::Serialize;
use sha2::{Digest, Sha256};
use task::TraceTask;

use super::limits::{Stopwatch, TraceLimits};
use super::values::whole;
use super::{CliError, interrupt, nearby, output, output_path};
use crate::forecast::Forecast;
use crate::heights;
use crate::shard::Shard;
use crate::trace::report::TraceReport;
use crate::trace::scene::{BuiltShapes, HeightMap, PreparedScene, Scene};
use crate::wording::{counted, decimals, significant};

/// Traces polarised light through a scene of single or layered micro-surfaces.
#[derive(Debug, clap::Args)]
#[command(
    args_conflicts_with_subcommands = true,
    subcommand_negates_reqs = true,
    after_help = "Examples:\n  ridged trace scene.toml --json --out bins.csv\n  ridged trace scene.toml --resume bins.csv\n  ridged trace scene.toml --shard 1/4 --out a.csv\n  ridged trace merge a.csv b.csv c.csv d.csv --out bins.csv"
)]
pub struct Args {
    /// Merge shards instead.
    #[command(subcommand)]
    pub action: Option<Action>,
    /// The scene; docs/reference/scenes.md lists its keys.
    #[arg(required = true, value_name = "SCENE.toml")]
    pub scene: Option<PathBuf>,
    /// One JSON object on stdout instead of a table.
    #[arg(long)]
    pub json: bool,
    /// Limits of time and error.
    #[command(flatten)]
    pub limits: TraceLimits,
    /// Trace part K of N; `ridged trace merge` puts the parts together.
    #[arg(long, value_name = "K/N")]
    pub shard: Option<Shard>,
    /// CSV file of the direction bins. If a run is stopped (Ctrl-C, --max-seconds, --target-error), the file contains all
    /// that --resume needs.
    #[arg(long, value_name = "FILE.csv")]
    pub out: Option<PathBuf>,
    /// Continue the stopped run that wrote this file; the result is the same, bit by bit, as without the stop. Writes to the
    /// same file unless --out names another.
    #[arg(long, value_name = "FILE.csv")]
    pub resume: Option<PathBuf>,
    /// Trace N surfaces of the same statistics, with different seeds, and report the scatter of the energies from surface to
    /// surface. The direction bins are those of the scene's own surface.
    #[arg(long, value_name = "N", conflicts_with_all = ["shard", "resume"],
          value_parser = whole::<u32>(2..=1000))]
    pub surfaces: Option<u32>,
    /// Folder for pictures (SVG): hemispheres of every Mueller and Stokes component, DOLP and AOP.
    #[arg(long, value_name = "DIR")]
    pub pictures: Option<PathBuf>,
}

/// Subcommands of `ridged trace`.
#[derive(Debug, clap::Subcommand)]
pub enum Action {
    /// Merge the files of all shards of one run; the result is bit-equal to one run.
    #[command(after_help = "Example:\n  ridged trace merge part-1.csv part-2.csv --out bins.csv")]
    Merge {
        /// Files that `--shard` wrote.
        #[arg(required = true, value_name = "FILE")]
        files: Vec<PathBuf>,
        /// CSV file of the direction bins.
        #[arg(long, value_name = "FILE.csv")]
        out: PathBuf,
        /// One JSON object on stdout instead of a table.
        #[arg(long)]
        json: bool,
    },
    /// Polarised against scalar: ADM and MDM over the directions of exit.
    Compare(compare::Args),
    /// Filter and compensator before lamp and camera: six states, DOLP and AOP.
    Ellipsometer(ellipsometer::Args),
}

/// Runs the command.
///
/// # Errors
/// Bad input for an invalid scene or file; no result where a target was not reached or a file cannot be written;
/// interrupted after Ctrl-C, with the finished part written.
pub fn run(args: Args) -> Result<(), CliError> {
    match &args.action {
        Some(Action::Merge { files, out, json }) => return merge(files, out, *json),
        Some(Action::Compare(args)) => return compare::run(args),
        Some(Action::Ellipsometer(args)) => return ellipsometer::run(args),
        None => {}
    }
    let task = TraceTask::prepare(&args)?;
    let before = task.kept()?;
    task.print_forecast(before.is_some());
    let done = task.execute(before)?;
    task.write(&done)?;
    let report = task.report(&done)?;
    print(args.json, &report, |out| table_of(&report, out))?;
    task.verdict(&done.so_far.totals)
}

fn unreached(target: f64, reached: Option<f64>, photons: u64) -> anyhow::Error {
    match reached {
        Some(e) => anyhow!(
            "the target error {target} was not reached: {photons} photons gave {}; about {} are needed (run.photons in the \
            scene)",
            significant(e),
            significant(photons as f64 * (e / target).powi(2))
        ),
        None => anyhow!(
            "the target error {target} cannot be reached: no reflected light exceeds its own noise"
        ),
    }
}

/// Prints a forecast. An upper bound may be far too large, so it does not show whether a limit cuts the run.
fn say_forecast(forecast: Forecast, max_seconds: Option<f64>) {
    if forecast.at_most {
        super::say(&format_args!(
            "forecast: {forecast}; probably far less, known once the illuminated part of the surface is found"
        ));
    } else {
        super::say(&format_args!(
            "forecast: {}",
            forecast.drawn_within(max_seconds)
        ));
    }
}

/// Prepares a scene with its files.
pub(super) fn ready(path: &Path, scene: &Scene) -> Result<PreparedScene, CliError> {
    scene
        .prepare(&beside(path))
        .with_context(|| path.display().to_string())
        .map_err(CliError::bad_input)
}

/// Returns a reader of the files that a scene names, relative to its folder.
fn beside(path: &Path) -> impl Fn(&str) -> Result<HeightMap, String> {
    let folder = path.parent().unwrap_or(Path::new("."));
    |file| {
        let content = heights::bytes_of(&folder.join(file))?;
        heights::read(file, &content)
    }
}

/// Reads the file of a scene. A missing one is refused with the names of the files beside it.
pub(super) fn scene_text(path: &Path) -> Result<String, CliError> {
    std::fs::read_to_string(path).map_err(|error| {
        let others = match error.kind() {
            std::io::ErrorKind::NotFound => nearby::instead_of(path),
            _ => String::new(),
        };
        CliError::bad_input(anyhow!(
            "cannot read the scene {}: {error}{others}",
            path.display()
        ))
    })
}

/// Reads and prepares a scene; also returns the fingerprint of all that was read.
fn prepare(path: &Path) -> Result<(Scene, PreparedScene, Sha256), CliError> {
    let mut fingerprint = Sha256::new();
    let text = scene_text(path)?;
    fingerprint.update(text.as_bytes());
    let folder = path.parent().unwrap_or(Path::new("."));
    let scene = Scene::parse(&text)
        .with_context(|| path.display().to_string())
        .map_err(CliError::bad_input)?;
    let bytes = std::cell::RefCell::new(&mut fingerprint);
    let prepared = scene
        .prepare(&|file| {
            let content = heights::bytes_of(&folder.join(file))?;
            bytes.borrow_mut().update(&content);
            heights::read(file, &content)
        })
        .with_context(|| path.display().to_string())
        .map_err(CliError::bad_input)?;
    Ok((scene, prepared, fingerprint))
}

/// A scene as read from its file, of which variants are traced.
struct Source {
    path: PathBuf,
    scene: Scene,
}

impl Source {
    fn read(path: &Path, photons: Option<u64>) -> Result<Self, CliError> {
        let text = scene_text(path)?;
        let mut scene = Scene::parse(&text)
            .with_context(|| path.display().to_string())
            .map_err(CliError::bad_input)?;
        if let Some(photons) = photons {
            scene.run.photons = photons;
        }
        Ok(Source {
            path: path.to_owned(),
            scene,
        })
    }

    /// Builds its surfaces, which do not depend on lamp or run.
    fn shapes(&self, watch: &Stopwatch) -> Result<BuiltShapes, CliError> {
        let (scene, path) = (self.scene.clone(), self.path.clone());
        let cancel = interrupt::flag()?;
        surface_build::build(watch, &cancel, move || {
            scene
                .shapes(&beside(&path))
                .with_context(|| path.display().to_string())
                .map_err(CliError::bad_input)
        })
    }
}

/// Writes a picture into a folder, which is created if it does not exist.
fn write_picture(folder: &Path, name: &str, svg: &str) -> Result<(), CliError> {
    let path = folder.join(name);
    std::fs::create_dir_all(folder)
        .and_then(|()| std::fs::write(&path, svg))
        .with_context(|| format!("cannot write {}", path.display()))
        .map_err(CliError::no_result)
}

/// Writes one JSON object or a table to stdout, in lines that fit the terminal.
fn print(
    json: bool,
    report: &impl Serialize,
    table: impl FnOnce(&mut dyn Write) -> std::io::Result<()>,
) -> Result<(), CliError> {
    let mut text = Vec::new();
    if !json {
        table(&mut text).map_err(CliError::no_result)?;
    }
    output::write(json, report, || String::from_utf8_lossy(&text).into_owned())
}

fn merge(files: &[PathBuf], out: &Path, json: bool) -> Result<(), CliError> {
    output_path::check_file(out)?;
    let merged = table::merge(files)?;
    let totals = &merged.totals;
    table::write(out, totals, &merged.stokes, None)?;
    let report = TraceReport::new(totals, totals.elements() > 1).about(merged.scene);
    print(json, &report, |out| table_of(&report, out))
}

/// Fewest decimals of energies.
const LEAST_DECIMALS: usize = 6;

fn or_not_known(x: f64) -> String {
    if x.is_finite() {
        significant(x)
    } else {
        "unknown".to_owned()
    }
}

/// Formats the report as text.
fn table_of(report: &TraceReport, out: &mut dyn Write) -> std::io::Result<()> {
    let kind = if report.polarised {
        "polarised"
    } else {
        "scalar"
    };
    write!(
        out,
        "{}, {kind}",
        counted(report.photons as usize, "photon")
    )?;
    if let Some(seconds) = report.seconds {
        write!(out, ", {seconds:.2} s")?;
    }
    writeln!(out)?;
    let e = &report.energy;
    for (name, x) in [
        ("reflected", e.reflected),
        ("transmitted", e.transmitted),
        ("absorbed", e.absorbed),
        ("truncated", e.truncated),
    ] {
        match x.std.is_finite() {
            true if x.std > 0.0 => {
                let expanded = 2.0 * x.std;
                let digits = decimals(expanded).max(LEAST_DECIMALS);
                writeln!(
                    out,
                    "  {name:<12} {:.digits$} ± {expanded:.digits$} (k = 2)",
                    x.value
                )?;
            }
            true => writeln!(out, "  {name:<12} {:.6} ± 0", x.value)?,
            false => writeln!(out, "  {name:<12} {:.6}", x.value)?,
        }
    }
    if let Some(s) = &report.surfaces {
        writeln!(
            out,
            "  over {} (± of their mean, k = 2; u by the photons; u from surface to surface)",
            counted(s.count, "surface")
        )?;
        for (name, x) in [
            ("reflected", s.reflected),
            ("transmitted", s.transmitted),
            ("absorbed", s.absorbed),
        ] {
            let expanded = 2.0 * x.std;
            let digits = decimals(expanded).max(LEAST_DECIMALS);
            writeln!(
                out,
                "    {name:<12} {:.digits$} ± {expanded:.digits$}; {}; {}",
                x.value,
                or_not_known(x.std_by_sampling),
                or_not_known(x.std_between_surfaces)
            )?;
        }
    }
    for note in &report.notes {
        writeln!(out, "  note: {note}")?;
    }
    if let Some(error) = report.relative_error {
        writeln!(
            out,
            "  error of the reflected bins, root mean square: {:.2} %",
            100.0 * error
        )?;
    }
    for angle in &report.ridge_angles {
        writeln!(
            out,
            "  interface {}: effective ridge angle {:.3}° (median inclination towards +v, by area)",
            angle.interface, angle.theta_r_deg
        )?;
    }
    for left in &report.left_out {
        writeln!(out, "  left out: {} ({})", left.what, left.why)?;
    }
    Ok(())
}
