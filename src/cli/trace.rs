//! `ridged trace`: a scene in, energies and Mueller bins out; and the merging of shards.

mod compare;
mod curves;
mod ellipsometer;
mod hemisphere;
mod making;
mod pictures;
mod runs;
mod table;
mod task;

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, anyhow};
use serde::Serialize;
use sha2::{Digest, Sha256};
use task::Task;

use super::limits::Stopwatch;
use super::{CliError, interrupt};
use crate::forecast::Forecast;
use crate::heights;
use crate::trace::report::Report;
use crate::trace::run::Shard;
use crate::trace::scene::{HeightMap, Prepared, Scene, Shapes};
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
    /// The scene; docs/scenes.md lists its keys.
    #[arg(required = true, value_name = "SCENE.toml")]
    pub scene: Option<PathBuf>,
    /// One JSON object on stdout instead of a table.
    #[arg(long)]
    pub json: bool,
    /// Stop after this time; what is finished by then counts.
    #[arg(long, value_name = "S")]
    pub max_seconds: Option<f64>,
    /// Stop once the relative error of the reflected bins (root mean square) is below this.
    #[arg(long, value_name = "E")]
    pub target_error: Option<f64>,
    /// Leave out what costs the reflected energy no more than this share (see `ridged explain`). Without
    /// it, what costs less than the run's own standard error.
    #[arg(long, value_name = "E")]
    pub tolerance: Option<f64>,
    /// Trace part K of N; `ridged trace merge` puts the parts together.
    #[arg(long, value_name = "K/N", value_parser = parse_shard)]
    pub shard: Option<Shard>,
    /// CSV file of the direction bins. Of a run that is stopped (Ctrl-C, --max-seconds, --target-error) it
    /// holds all that --resume needs.
    #[arg(long, value_name = "FILE.csv")]
    pub out: Option<PathBuf>,
    /// Go on with the stopped run that wrote this file; the end is the same, bit by bit, as without the
    /// stop. Writes to the same file unless --out names another.
    #[arg(long, value_name = "FILE.csv")]
    pub resume: Option<PathBuf>,
    /// Trace so many surfaces of the same statistics in all, drawn by other seeds, and tell how much the energies differ
    /// from surface to surface; the direction bins stay those of the scene's own.
    #[arg(long, value_name = "N", conflicts_with_all = ["shard", "resume"],
          value_parser = clap::value_parser!(u32).range(2..=1000))]
    pub surfaces: Option<u32>,
    /// A folder for pictures (SVG): hemispheres of every Mueller and Stokes component, DOLP and AOP.
    #[arg(long, value_name = "DIR")]
    pub pictures: Option<PathBuf>,
}

/// What else `ridged trace` does.
#[derive(Debug, clap::Subcommand)]
pub enum Action {
    /// Puts the files of all shards of one run together; the same bits as one run.
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

fn parse_shard(text: &str) -> Result<Shard, String> {
    let parts = text
        .split_once('/')
        .and_then(|(k, n)| Some((k.parse().ok()?, n.parse().ok()?)));
    match parts {
        Some((number, of)) if 1 <= number && number <= of => Ok(Shard { number, of }),
        _ => Err("write K/N with K from 1 to N, such as 2/4".to_owned()),
    }
}

/// Runs the command.
///
/// # Errors
/// Bad input for a scene or files that make no sense; no result where a target was not reached or a
/// file cannot be written; interrupted after Ctrl-C, with what was finished written.
pub fn run(args: Args) -> Result<(), CliError> {
    match &args.action {
        Some(Action::Merge { files, out, json }) => return merge(files, out, *json),
        Some(Action::Compare(args)) => return compare::run(args),
        Some(Action::Ellipsometer(args)) => return ellipsometer::run(args),
        None => {}
    }
    let task = Task::prepare(&args)?;
    let before = task.kept()?;
    task.foretell(before.is_some());
    let done = task.execute(before)?;
    task.write(&done)?;
    let report = task.report(&done)?;
    print(args.json, &report, |out| table_of(&report, out))?;
    task.verdict(&done.so_far.totals)
}

fn unreached(target: f64, reached: Option<f64>, photons: u64) -> anyhow::Error {
    match reached {
        Some(e) => anyhow!(
            "the target error {target} was not reached: {photons} photons gave {}; about {} would be needed \
             (run.photons in the scene)",
            significant(e),
            significant(photons as f64 * (e / target).powi(2))
        ),
        None => anyhow!(
            "the target error {target} cannot be reached: no light was reflected, or no more than its own noise"
        ),
    }
}

/// Says what a run will take. What is only bounded may be far less, so nobody knows if a limit cuts it.
fn say_forecast(forecast: Forecast, max_seconds: Option<f64>) {
    if forecast.at_most {
        super::say(&format_args!(
            "forecast: {forecast}; likely far less, which shows once it is known where the light falls"
        ));
    } else {
        super::say(&format_args!(
            "forecast: {}",
            forecast.drawn_within(max_seconds)
        ));
    }
}

/// A scene with its files, ready to trace.
pub(super) fn ready(path: &Path, scene: &Scene) -> Result<Prepared, CliError> {
    scene
        .prepare(&beside(path))
        .with_context(|| path.display().to_string())
        .map_err(CliError::bad_input)
}

/// Reads the files that a scene names, which lie beside it.
fn beside(path: &Path) -> impl Fn(&str) -> Result<HeightMap, String> {
    let folder = path.parent().unwrap_or(Path::new("."));
    |file| {
        let content = heights::bytes_of(&folder.join(file))?;
        heights::read(file, &content)
    }
}

/// A scene as its file has it, ready to trace, and the fingerprint of all that was read.
fn prepare(path: &Path) -> Result<(Scene, Prepared, Sha256), CliError> {
    let mut fingerprint = Sha256::new();
    let text = std::fs::read_to_string(path)
        .with_context(|| format!("cannot read the scene {}", path.display()))
        .map_err(CliError::bad_input)?;
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

/// A scene as read from its file, to be varied.
struct Source {
    path: PathBuf,
    scene: Scene,
}

impl Source {
    fn read(path: &Path, photons: Option<u64>) -> Result<Self, CliError> {
        let text = std::fs::read_to_string(path)
            .with_context(|| format!("cannot read the scene {}", path.display()))
            .map_err(CliError::bad_input)?;
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

    /// Its surfaces, which neither lamp nor run change.
    fn shapes(&self, watch: &Stopwatch) -> Result<Shapes, CliError> {
        let (scene, path) = (self.scene.clone(), self.path.clone());
        let cancel = interrupt::flag()?;
        making::made(watch, &cancel, move || {
            scene
                .shapes(&beside(&path))
                .with_context(|| path.display().to_string())
                .map_err(CliError::bad_input)
        })
    }
}

/// Writes a picture into a folder, which is made if need be.
fn write_picture(folder: &Path, name: &str, svg: &str) -> Result<(), CliError> {
    let path = folder.join(name);
    std::fs::create_dir_all(folder)
        .and_then(|()| std::fs::write(&path, svg))
        .with_context(|| format!("cannot write {}", path.display()))
        .map_err(CliError::no_result)
}

/// One JSON object or a table on stdout.
fn print(
    json: bool,
    report: &impl Serialize,
    table: impl FnOnce(&mut dyn Write) -> std::io::Result<()>,
) -> Result<(), CliError> {
    let mut out = std::io::stdout().lock();
    let written = if json {
        serde_json::to_writer_pretty(&mut out, report)
            .map_err(std::io::Error::from)
            .and_then(|()| writeln!(out))
    } else {
        table(&mut out)
    };
    written
        .context("cannot write to stdout")
        .map_err(CliError::no_result)
}

fn merge(files: &[PathBuf], out: &Path, json: bool) -> Result<(), CliError> {
    let merged = table::merge(files)?;
    let totals = &merged.totals;
    table::write(out, totals, &merged.stokes, None)?;
    let report = Report::new(totals, totals.elements() > 1).about(merged.scene);
    print(json, &report, |out| table_of(&report, out))
}

/// Decimals of energies at least.
const LEAST_DECIMALS: usize = 6;

fn or_not_known(x: f64) -> String {
    if x.is_finite() {
        significant(x)
    } else {
        "not known".to_owned()
    }
}

/// The report for people.
fn table_of(report: &Report, out: &mut dyn Write) -> std::io::Result<()> {
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
                let digits = decimals(x.std).max(LEAST_DECIMALS);
                writeln!(
                    out,
                    "  {name:<12} {:.digits$} ± {:.digits$}",
                    x.value, x.std
                )?;
            }
            true => writeln!(out, "  {name:<12} {:.6} ± 0", x.value)?,
            false => writeln!(out, "  {name:<12} {:.6}", x.value)?,
        }
    }
    if let Some(s) = &report.surfaces {
        writeln!(
            out,
            "  over {} (± their mean's error; by the photons; from surface to surface)",
            counted(s.count, "surface")
        )?;
        for (name, x) in [
            ("reflected", s.reflected),
            ("transmitted", s.transmitted),
            ("absorbed", s.absorbed),
        ] {
            let digits = decimals(x.std).max(LEAST_DECIMALS);
            writeln!(
                out,
                "    {name:<12} {:.digits$} ± {:.digits$}; {}; {}",
                x.value,
                x.std,
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
