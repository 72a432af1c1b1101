//! `ridged fit`: ridge angle with uncertainty from a recorded series, or one common surface from several series of one
//! sample.

mod joint;
mod merge;
mod stored;
mod table;

use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use anyhow::{Context, anyhow};
use clap::ValueEnum;
use indicatif::{HumanDuration, ProgressBar, ProgressStyle};

use super::client::ConnectionArgs;
use super::limits::FitLimits;
use super::output::ResultArgs;
use super::values::whole;
use super::{CliError, constraint_args, interrupt, output, progress, runtime};
use crate::accuracy::forecast::{READ, of_analysis};
use crate::analysis::{Analysis, AnalysisError, AnalysisOptions, DRAWS, Progress, STARTS, analyse};
use crate::fit::constraints::agree;
use crate::fit::report::text;
use crate::fit::traced::TracingOptions;
use crate::fit::{Constraint, FitOptions, Loss, VariantChoice};
use crate::heights;
use crate::heights::ridges::{self, MeasuredShape, Units};
use crate::material::Material;
use crate::reduction::{FrameSource, ReductionError, Remembering};
use crate::series::Series;
use crate::tables;

/// Reduces and fits one series of frames, or several series of one part together.
#[derive(Debug, clap::Args)]
#[command(
    args_conflicts_with_subcommands = true,
    subcommand_negates_reqs = true,
    after_help = "Examples:\n  ridged fit tests/data/series/polymer-10 --json > polymer-10.json\n  \
                  ridged fit --scan 8 --store && ridged report --scan 8 --out report.html\n  \
                  ridged fit tests/data/series/steel-15 --variant traced\n  \
                  ridged fit tests/data/series/steel-15 --variant paper --check-traced\n  \
                  ridged fit series --variant traced --shape map.tif --pitch-um 0.5 --height-unit-um 1\n  \
                  ridged fit monday tuesday remounted --fix rho_d=0\n  \
                  ridged fit merge lot-7/*.json --out lot-7.csv"
)]
pub struct Args {
    /// Merge results instead.
    #[command(subcommand)]
    pub action: Option<Action>,
    /// Folder of a recorded series (manifest.toml, frames.csv, frames/), or of a goniometer's table of BRDF
    /// (docs/reference/brdf-tables.md). Several folders of frames of one part
    /// are fitted together, with one surface and with offsets and a gain for each scan.
    #[arg(
        value_name = "DIR",
        required_unless_present = "scan",
        conflicts_with = "scan"
    )]
    pub dirs: Vec<PathBuf>,
    /// Number of a scan in the store, instead of a folder.
    #[arg(long, value_name = "ID")]
    pub scan: Option<i64>,
    /// Data folder of the store.
    #[arg(long, value_name = "DIR", default_value = "ridged-data", global = true)]
    pub data: PathBuf,
    /// Model the reported result is based on; all are fitted and compared.
    #[arg(long, value_enum, default_value_t = Variant::Auto)]
    pub variant: Variant,
    /// Region of a part with a layout: even, odd or patch-I-J.
    #[arg(long, value_name = "NAME")]
    pub region: Option<String>,
    /// Loss of the residuals: least squares, or one that limits the influence of outliers.
    #[arg(long, value_enum, default_value_t = LossName::Linear)]
    pub loss: LossName,
    /// Fix a parameter at a value, for example rho_d=0.3 (names as in the JSON form, and eta, k).
    #[arg(long, value_name = "NAME=VALUE", value_parser = constraint_args::fixed)]
    pub fix: Vec<Constraint>,
    /// Prior knowledge of a parameter: value ± standard uncertainty, for example theta_r_deg=10±0.5.
    #[arg(long, value_name = "NAME=VALUE±STD", value_parser = constraint_args::prior)]
    pub prior: Vec<Constraint>,
    /// Largest number of starting points of a search, per variant; with a prior or a robust loss the search is repeated.
    /// Default: 8, and more where these leave the minimum in doubt.
    #[arg(long, value_name = "N", value_parser = whole::<u16>(STARTS))]
    pub starts: Option<u16>,
    /// Add profile-likelihood intervals to the expanded uncertainties.
    #[arg(long)]
    pub profile: bool,
    /// Add bootstrap intervals from N series drawn from the fitted model (20 to 100000).
    #[arg(long, value_name = "N", value_parser = whole::<u32>(DRAWS))]
    pub bootstrap: Option<u32>,
    /// Check the variant with the ray tracer: the difference from `traced` becomes the `model` line of the budget.
    #[arg(long = "check-traced", alias = "judge")]
    pub judge: bool,
    /// Trace on this measured shape instead of an ideal sawtooth. A profile: CSV rows of v and height in µm across
    /// the ridges (+v is the lean direction), the last row closing the period. Or a height map of the ridges, in any
    /// orientation: table, 16-bit PNG or TIFF, float TIFF, X3P, SDF.
    #[arg(long, value_name = "FILE")]
    pub shape: Option<PathBuf>,
    /// Distance between samples of a height map, in µm (one number, or one along its rows and one along its columns),
    /// if the file does not state it.
    #[arg(
        long,
        value_name = "UM[,UM]",
        value_delimiter = ',',
        requires = "shape"
    )]
    pub pitch_um: Vec<f64>,
    /// Micrometres per unit of height, if the file does not state it.
    #[arg(long, value_name = "UM", requires = "shape")]
    pub height_unit_um: Option<f64>,
    /// Limits of time and error.
    #[command(flatten)]
    pub limits: FitLimits,
    /// Record cost, gradient, step size and error of every iteration of a descent to the minimum, against seconds
    /// (`iterations` of --json).
    #[arg(long)]
    pub iterations: bool,
    /// Keep the fit of --scan in the store, where report, compare, repeatability and results read it. A running daemon on
    /// the folder does it.
    #[arg(long, requires = "scan")]
    pub store: bool,
    /// Form of the result.
    #[command(flatten)]
    pub printed: ResultArgs,
    /// Address and token, for a running daemon.
    #[command(flatten)]
    pub connection: ConnectionArgs,
}

/// Subcommands of `ridged fit`.
#[derive(Debug, clap::Subcommand)]
pub enum Action {
    /// Merge results of single series (`ridged fit DIR --json`) into one table.
    #[command(after_help = "Example:\n  ridged fit merge a.json b.json --out fits.csv")]
    Merge(merge::Args),
}

/// Share of a time limit that the forecast always leaves for the work.
const LEAST_LEFT: f64 = 0.1;

/// Prints a forecast of the analysis to stderr: where a limit is set, and on a terminal where the analysis is long (the
/// ray tracer, the bootstrap). On a terminal it returns the seconds for the progress bar. The time of the forecast itself
/// is subtracted from the limit.
pub fn print_forecast(
    source: &dyn FrameSource,
    options: &mut AnalysisOptions,
    cancel: &AtomicBool,
) -> Option<f64> {
    let fit = &options.fit;
    let limited = options.max_seconds.is_some()
        || fit.tracer.target_error.is_some()
        || fit.tolerance.is_some();
    let traces = fit.judge || fit.variant == VariantChoice::Traced;
    let long = traces || fit.bootstrap > 0;
    let terminal = std::io::stderr().is_terminal();
    if !(limited || terminal) {
        return None;
    }
    let begun = Instant::now();
    let forecast = of_analysis(source, options, cancel);
    if let Some(limit) = &mut options.max_seconds {
        // The analysis reuses what was read, and the limit is on fitting.
        let read_s = forecast.as_ref().map_or(0.0, |f| f.part(READ));
        let spent_s = begun.elapsed().as_secs_f64() - read_s;
        *limit = (*limit - spent_s).max(LEAST_LEFT * *limit);
    }
    let forecast = forecast?;
    if limited || long {
        super::say(&format_args!("forecast: {forecast}"));
    }
    terminal.then_some(forecast.seconds)
}

/// Losses by the names of the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum LossName {
    /// Least squares.
    Linear,
    /// An outlier has at most the influence of a residual of 1.345 standard uncertainties.
    Huber,
    /// Far outliers have no influence.
    Tukey,
}

impl LossName {
    /// The loss for a fit.
    #[must_use]
    pub fn loss(self) -> Loss {
        match self {
            LossName::Linear => Loss::Linear,
            LossName::Huber => Loss::Huber,
            LossName::Tukey => Loss::Tukey,
        }
    }
}

/// Models by the names of the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Variant {
    /// The BRDF as printed.
    Paper,
    /// The sawtooth with all its terms.
    Sawtooth,
    /// The sawtooth corrected by the ray tracer.
    Traced,
    /// Paper where it is clearly better by QAIC, else sawtooth.
    Auto,
}

impl Variant {
    /// The choice for a fit.
    #[must_use]
    pub fn choice(self) -> VariantChoice {
        match self {
            Variant::Paper => VariantChoice::Paper,
            Variant::Sawtooth => VariantChoice::Sawtooth,
            Variant::Auto => VariantChoice::Auto,
            Variant::Traced => VariantChoice::Traced,
        }
    }
}

/// Runs the command.
///
/// # Errors
/// Bad input for a folder that is not a series, a region that is missing or unknown, an invalid profile, or options of
/// the tracer without the tracer; no result where no frame can be used.
pub fn run(args: Args) -> Result<(), CliError> {
    if let Some(Action::Merge(args)) = &args.action {
        return merge::run(args);
    }
    let tracer = tracing_options(&args)?;
    let units = Units {
        pitch_um: args.pitch_um.clone(),
        height_unit_um: args.height_unit_um,
    };
    let read = |path| shape_in(path, &units);
    let shape = args.shape.as_deref().map(read).transpose()?;
    let standard = FitOptions::default();
    let mut options = AnalysisOptions {
        region: args.region.clone(),
        fit: FitOptions {
            variant: args.variant.choice(),
            starts: args.starts.map_or(standard.starts, usize::from),
            starts_alone: args.starts.is_some(),
            loss: args.loss.loss(),
            constraints: args.fix.iter().chain(&args.prior).copied().collect(),
            profile: args.profile,
            bootstrap: args.bootstrap.unwrap_or(0),
            judge: args.judge,
            tolerance: args.limits.tolerance,
            tracer,
            ..standard
        },
        height_map: shape.as_ref().and_then(|shape| shape.facts),
        shape_notes: shape.iter().flat_map(|shape| shape.notes.clone()).collect(),
        profile: shape.map(|shape| shape.profile),
        max_seconds: args.limits.max_seconds,
        iterations: args.iterations,
    };
    let cancel = interrupt::flag()?;
    if args.connection.url.is_some() && !args.store {
        return Err(CliError::bad_input(anyhow!(
            "--url needs --scan N --store: a daemon fits the scans of its own store"
        )));
    }
    if args.store && args.scan.is_none() {
        return Err(CliError::bad_input(anyhow!(
            "--store needs --scan N: only a fit of a scan in the store is kept; import the folder first (ridged import)"
        )));
    }
    if let (true, Some(scan_id)) = (args.store, args.scan) {
        return stored::run(&args, scan_id, &cancel);
    }
    if let [dir] = &args.dirs[..]
        && tables::is_table(dir)
    {
        return table::run(dir, options, args.printed, &cancel);
    }
    let source: Box<dyn FrameSource> = match (&args.dirs[..], args.scan) {
        ([], scan) => Box::new(runtime::stored_series(
            &args.data,
            scan.unwrap_or_default(),
        )?),
        ([dir], _) => {
            let series = Series::open_own(dir).map_err(CliError::bad_input)?;
            Box::new(Remembering::new(series))
        }
        (dirs, _) => return joint::run(dirs, &options, args.printed, &cancel),
    };
    suits(&options.fit.constraints, &source.manifest().material())?;
    let expected_s = print_forecast(source.as_ref(), &mut options, &cancel);
    let analysis = watched(source.as_ref(), &options, expected_s, &cancel)?;
    print(&analysis, args.printed)
}

/// Reads a shape from a file.
fn shape_in(path: &Path, units: &Units) -> Result<MeasuredShape, CliError> {
    let name = path.display().to_string();
    let content = heights::bytes_of(path)
        .map_err(anyhow::Error::msg)
        .with_context(|| format!("cannot read {name}"))
        .map_err(CliError::bad_input)?;
    heights::read(&name, &content)
        .map_err(anyhow::Error::msg)
        .and_then(|map| Ok(ridges::of(&map, units)?))
        .with_context(|| name)
        .map_err(CliError::bad_input)
}

/// Refuses constraints that contradict each other, or the sample.
fn suits(constraints: &[Constraint], material: &Material) -> Result<(), CliError> {
    agree(constraints, material).map_err(CliError::bad_input)
}

/// Returns the options of the tracer.
fn tracing_options(args: &Args) -> Result<TracingOptions, CliError> {
    let traces = args.judge || args.variant == Variant::Traced;
    if args.shape.is_some() && !traces {
        return Err(CliError::bad_input(anyhow!(
            "--shape applies only to the ray tracer; add --variant traced or --check-traced"
        )));
    }
    args.limits.check(traces)?;
    Ok(TracingOptions::to_error(args.limits.target_error))
}

/// Analyses any source of frames, with a progress bar on a terminal after a second; `expected_s` is the expected time of
/// the whole, if it is known.
///
/// # Errors
/// See [`run`].
pub fn watched(
    source: &dyn FrameSource,
    options: &AnalysisOptions,
    expected_s: Option<f64>,
    cancel: &AtomicBool,
) -> Result<Analysis, CliError> {
    with_bar(expected_s, |progress| {
        analyse(source, options, progress, cancel)
    })
    .map_err(refusal)
}

/// Maps a failed analysis to an exit code.
fn refusal(error: AnalysisError) -> CliError {
    match error {
        AnalysisError::Cancelled => CliError::Interrupted,
        AnalysisError::Reduction(
            reason @ (ReductionError::NoObservations { .. } | ReductionError::Vanished { .. }),
        ) => CliError::no_result(reason),
        AnalysisError::Reduction(reason) => CliError::bad_input(reason),
    }
}

/// Receives the progress of the work.
type Tell<'t> = &'t (dyn Fn(Progress) + Sync);

/// Runs work that reads and fits, with that bar.
fn with_bar<T>(expected_s: Option<f64>, work: impl FnOnce(Tell<'_>) -> T) -> T {
    let started = Instant::now();
    let bar: OnceLock<ProgressBar> = OnceLock::new();
    let tracing: OnceLock<()> = OnceLock::new();
    let terminal = std::io::stderr().is_terminal();
    let progress = |p: Progress| {
        if !terminal {
            return;
        }
        if matches!(p, Progress::Fitting) {
            // A search has no known length, so the bar shows the time; the first tick comes after a second.
            let bar = bar.get_or_init(new_bar);
            bar.set_style(fitting_style());
            bar.set_message(expected_s.map_or_else(String::new, |all_s| {
                format!(
                    " of about {}",
                    HumanDuration(Duration::from_secs_f64(all_s.max(1.0)))
                )
            }));
            bar.enable_steady_tick(Duration::from_secs(1));
            return;
        }
        if started.elapsed() < Duration::from_secs(1) {
            return;
        }
        let bar = bar.get_or_init(new_bar);
        match p {
            Progress::Reducing { done, total } => {
                bar.set_length(done.max(total) as u64);
                bar.set_position(done as u64);
            }
            Progress::Fitting => {}
            Progress::Tracing { done, total } => {
                tracing.get_or_init(|| {
                    bar.disable_steady_tick();
                    bar.set_style(paths_style());
                });
                bar.set_length(total);
                bar.set_position(done);
            }
        }
    };
    let outcome = work(&progress);
    if let Some(bar) = bar.get() {
        bar.finish_and_clear();
    }
    outcome
}

fn new_bar() -> ProgressBar {
    let style = ProgressStyle::with_template("{msg} {wide_bar} {pos}/{len} frames, {eta} left")
        .expect("the template is constant");
    let bar = ProgressBar::new(0).with_style(style);
    progress::drawn(bar.with_message("reading"))
}

fn fitting_style() -> ProgressStyle {
    ProgressStyle::with_template("{spinner} fitting, {elapsed} so far{msg}")
        .expect("the template is constant")
}

fn paths_style() -> ProgressStyle {
    ProgressStyle::with_template("tracing {wide_bar} {human_pos} of {human_len} paths, {eta} left")
        .expect("the template is constant")
}

/// Prints a report to stdout, as JSON or as a table.
///
/// # Errors
/// No result where stdout cannot be written.
fn print(analysis: &Analysis, printed: ResultArgs) -> Result<(), CliError> {
    output::write(printed.json, &analysis.report, || {
        text::table(&analysis.report, &output::form(printed.brief))
    })
}
