//! `ridged model-error`: the errors of the closed forms, measured with the tracer.
//!
//! A surface of every ridge angle and roughness is traced at the poses of the full scan. The closed form at the true
//! parameters is compared pose by pose; then the variants are fitted to the traced radiances, and the fitted parameters
//! are compared with the truth.

mod figure;
mod shards;
mod table;

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context, anyhow};

use super::limits::{PATHS, PathLimits, PathWork, PilotResult, Stopwatch, check_paths};
use super::progress::Bar;
use super::shards::{MergeArgs, Target};
use super::{CliError, interrupt, output, output_path};
use crate::accuracy::model_error::{ErrorSurface, MATERIALS, SurfaceComparison, SurfaceErrors};
use crate::deadline;
use crate::shard::Shard;

/// Errors of the variants paper and sawtooth: table and maps.
#[derive(Debug, clap::Args)]
#[command(
    args_conflicts_with_subcommands = true,
    after_help = "Examples:\n  ridged model-error --out docs/explanation\n  \
    ridged model-error --theta-r-deg 10 --alpha 0.12 --paths 16384\n  \
    ridged model-error --shard 1/4 --out 1.shard\n  \
    ridged model-error merge 1.shard 2.shard 3.shard 4.shard --out errors"
)]
pub struct Args {
    /// Merge shards instead.
    #[command(subcommand)]
    pub action: Option<Action>,
    /// Ridge angles.
    #[arg(long, num_args = 1.., value_delimiter = ',', value_name = "DEG",
          default_values_t = [2.0, 5.0, 10.0, 15.0, 20.0, 25.0, 30.0])]
    pub theta_r_deg: Vec<f64>,
    /// Roughnesses (both axes).
    #[arg(long, num_args = 1.., value_delimiter = ',', default_values_t = [0.03, 0.06, 0.1, 0.2, 0.3])]
    pub alpha: Vec<f64>,
    /// Diffuse reflectance of the plastic.
    #[arg(long, default_value_t = 0.35)]
    pub rho_d: f64,
    /// Paths per radiance: from the camera, and the same number from the lamp.
    #[arg(long, default_value_t = 8192)]
    pub paths: u64,
    /// Limits of time and error.
    #[command(flatten)]
    pub limits: PathLimits,
    /// Seed of all random numbers.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// One JSON object on stdout instead of a table.
    #[arg(long)]
    pub json: bool,
    /// Folder for model-error.csv, model-error-poses.csv and model-error.svg. With --shard: file of the shard.
    #[arg(long, value_name = "DIR|FILE")]
    pub out: Option<PathBuf>,
    /// Trace part K of N; `ridged model-error merge` puts the parts together.
    #[arg(long, value_name = "K/N", conflicts_with_all = ["max_seconds", "target_error"])]
    pub shard: Option<Shard>,
}

/// Subcommands of `ridged model-error`.
#[derive(Debug, clap::Subcommand)]
pub enum Action {
    /// Merge the files of all shards of one run; the result is bit-equal to one run.
    #[command(after_help = "Example:\n  ridged model-error merge 1.shard 2.shard --out errors")]
    Merge(MergeArgs),
}

/// Times that a surface may be traced again with more paths: errors estimated from few paths may be too small.
const RETRIES: usize = 4;

/// Runs the command.
///
/// # Errors
/// Bad input for options out of range; no result where a file cannot be written or the target error was not reached
/// within the time limit; interrupted.
pub fn run(args: Args) -> Result<(), CliError> {
    let watch = Stopwatch::start(args.limits.max_seconds);
    if let Some(Action::Merge(merge)) = &args.action {
        return shards::merge(merge);
    }
    if let Some(shard) = args.shard {
        let target = Target::new(shards::run_of(&args), shard, args.out.as_deref(), args.json)?;
        return shards::trace(&args, &target, &watch, &*interrupt::flag()?);
    }
    args.out
        .as_deref()
        .map_or(Ok(()), output_path::check_folder)?;
    let compared = cells(&args, &watch, &*interrupt::flag()?)?;
    write_result(&compared, args.out.as_deref(), args.json, watch.seconds())?;
    compared.verdict(&args.limits)
}

/// Writes the files of a comparison, if a folder is given, and prints it.
fn write_result(
    compared: &Compared,
    out: Option<&Path>,
    json: bool,
    seconds: f64,
) -> Result<(), CliError> {
    let cells = &compared.cells;
    let left_out = table::left_out(&compared.missing);
    if let Some(out) = out {
        std::fs::create_dir_all(out)
            .and_then(|()| std::fs::write(out.join("model-error.csv"), table::csv(cells)))
            .and_then(|()| {
                std::fs::write(out.join("model-error-poses.csv"), table::poses_csv(cells))
            })
            .and_then(|()| std::fs::write(out.join("model-error.svg"), figure::draw(cells)))
            .with_context(|| format!("cannot write to {}", out.display()))
            .map_err(CliError::no_result)?;
    }
    output::write(json, &table::report(cells, &left_out, seconds), || {
        let mut text = table::table(cells);
        for left in &left_out {
            let _ = writeln!(text, "\nleft out: {} ({})", left.what, left.why);
        }
        text
    })
}

/// The comparison.
#[derive(Debug)]
struct Compared {
    cells: Vec<SurfaceErrors>,
    /// Surfaces left out by the time limit.
    missing: Vec<ErrorSurface>,
    /// Whether the time limit reduced the number of paths.
    cut_short: bool,
}

impl Compared {
    /// Checks that the target error was reached, unless the time limit ended the run.
    fn verdict(&self, limits: &PathLimits) -> Result<(), CliError> {
        let worst = self.cells.iter().max_by(|a, b| a.noise.total_cmp(&b.noise));
        match worst {
            Some(worst) if !self.cut_short && self.missing.is_empty() => {
                limits.verdict("surface", worst.paths, worst.noise)
            }
            _ => Ok(()),
        }
    }
}

/// Checks the options and prepares the surfaces, by material, ridge angle and roughness.
fn wanted(args: &Args) -> Result<Vec<SurfaceComparison>, CliError> {
    let bad = |what: String| Err(CliError::bad_input(anyhow!(what)));
    if let Some(t) = args.theta_r_deg.iter().find(|t| !(0.1..=45.0).contains(*t)) {
        return bad(format!(
            "--theta-r-deg {t} is out of range: expected 0.1 to 45 degrees"
        ));
    }
    if let Some(a) = args.alpha.iter().find(|a| !(0.005..=1.0).contains(*a)) {
        return bad(format!("--alpha {a}: give 0.005 to 1"));
    }
    if !(0.0..=0.9).contains(&args.rho_d) {
        return bad(format!("--rho-d {}: give 0 to 0.9", args.rho_d));
    }
    check_paths(args.paths)?;
    let mut wanted = Vec::new();
    for material in 0..MATERIALS.len() {
        for &theta_r_deg in &args.theta_r_deg {
            wanted.extend(args.alpha.iter().map(|&alpha| ErrorSurface {
                material,
                theta_r_deg,
                alpha,
            }));
        }
    }
    wanted
        .into_iter()
        .map(|one| SurfaceComparison::of(one, args.rho_d))
        .collect::<Result<_, _>>()
        .map_err(CliError::bad_input)
}

fn cells(args: &Args, watch: &Stopwatch, cancel: &AtomicBool) -> Result<Compared, CliError> {
    let wanted = wanted(args)?;
    args.limits.check()?;
    let (mut paths, mut cut_short) = (args.paths, false);
    if args.limits.is_any() {
        // One surface of each material: plastic takes more tracing, and the fits differ.
        let each = wanted.len() / MATERIALS.len();
        let middle = (0..MATERIALS.len()).map(|m| m * each + each / 2);
        let middle: Vec<&SurfaceComparison> = middle.filter_map(|n| wanted.get(n)).collect();
        let pilot = |paths| {
            let mut trial = PilotResult {
                surfaces: middle.len(),
                error: 0.0,
                apart_s: 0.0,
            };
            for wanted in &middle {
                let run = |end: &AtomicBool| wanted.run(paths, args.seed, end);
                let (cell, fits_s) = deadline::flagging(&|| watch.is_late(), cancel, run)?;
                trial.error = cell.noise.max(trial.error);
                trial.apart_s += fits_s;
            }
            Some(trial)
        };
        let work = PathWork {
            surfaces: wanted.len(),
            abreast: 1,
            paths,
            may_miss_some: true,
        };
        if let Some(planned) = args.limits.plan(&work, &pilot)? {
            super::say(&format_args!("forecast: {}", planned.forecast));
            (paths, cut_short) = (planned.paths, planned.forecast.cut_short);
        }
    }
    let target = args.limits.target_error.filter(|_| !cut_short);
    let all: Vec<&SurfaceComparison> = wanted.iter().collect();
    let found = compare(&all, paths, args.seed, target, watch, cancel)?;
    let late = watch.is_late();
    let missing = found.iter().zip(&wanted);
    let missing = missing.filter(|(found, _)| late && found.is_none());
    let missing: Vec<ErrorSurface> = missing.map(|(_, wanted)| wanted.wanted()).collect();
    let cells: Vec<SurfaceErrors> = found.into_iter().flatten().collect();
    if cells.is_empty() && !missing.is_empty() {
        return Err(CliError::no_result(anyhow!(
            "no surface was finished within the time limit: allow more time"
        )));
    }
    Ok(Compared {
        cells,
        missing,
        cut_short: cut_short || late,
    })
}

/// Traces and compares these surfaces; those that the time limit does not reach have no result.
fn compare(
    wanted: &[&SurfaceComparison],
    paths: u64,
    seed: u64,
    target: Option<f64>,
    watch: &Stopwatch,
    cancel: &AtomicBool,
) -> Result<Vec<Option<SurfaceErrors>>, CliError> {
    let bar = Bar::new("surfaces");
    let mut found = Vec::new();
    for next in wanted {
        let trace = |paths| {
            let run = |end: &AtomicBool| next.run(paths, seed, end);
            let found = deadline::flagging(&|| watch.is_late(), cancel, run);
            found.map(|(cell, _)| cell)
        };
        found.push(match watch.is_late() {
            true => None,
            false => traced(paths, target, &trace),
        });
        if cancel.load(Ordering::Relaxed) {
            return Err(CliError::Interrupted);
        }
        bar.at(found.len() as u64, wanted.len() as u64);
    }
    bar.clear();
    Ok(found)
}

/// Traces a surface, and where it misses the target error traces it again with the paths that it needs, and some more than
/// the square-root law requires: the pilots' surfaces represent all, but some are noisier.
fn traced(
    paths: u64,
    target: Option<f64>,
    trace: &dyn Fn(u64) -> Option<SurfaceErrors>,
) -> Option<SurfaceErrors> {
    let mut found = trace(paths)?;
    for _ in 0..RETRIES {
        let ratio = target.map_or(0.0, |target| found.noise / target);
        if ratio <= 1.0 || found.paths >= PATHS.1 {
            break;
        }
        let needed = (1.1 * found.paths as f64 * ratio.powi(2)).ceil() as u64;
        match trace(needed.min(PATHS.1)) {
            Some(next) => found = next,
            None => break,
        }
    }
    Some(found)
}

#[cfg(test)]
mod tests {
    use super::table::{csv, left_out, poses_csv, report, table};
    use super::*;
    use crate::accuracy::model_error::summary;
    use crate::cli::parsed;

    fn found(words: &[&str]) -> Result<Vec<SurfaceErrors>, CliError> {
        let args: Args = parsed(words);
        let watch = Stopwatch::start(args.limits.max_seconds);
        cells(&args, &watch, &AtomicBool::new(false)).map(|found| found.cells)
    }

    #[test]
    fn at_a_gentle_ridge_the_closed_form_is_right_within_the_tracers_noise_and_a_per_cent() {
        let cells = found(&["--theta-r-deg", "5", "--alpha", "0.2", "--paths", "64"]).unwrap();
        let [plastic, steel] = &cells[..] else {
            panic!("two materials")
        };
        for cell in [plastic, steel] {
            let (rms, _) = summary(&cell.closed);
            assert!(rms < 0.01 + 3.0 * cell.noise, "{rms} {}", cell.noise);
            let [paper, sawtooth] = cell.fitted;
            assert!(sawtooth.unwrap().theta_r_deg.abs() < 0.2);
            assert!(paper.unwrap().rms > sawtooth.unwrap().rms);
        }
        assert_eq!(csv(&cells).lines().count(), 3);
        assert_eq!(poses_csv(&cells).lines().count(), 1 + 2 * 108);
        assert!(figure::draw(&cells).contains("</svg>") && table(&cells).contains("steel"));
    }

    #[test]
    fn surfaces_left_out_by_the_time_limit_are_named() {
        let words = [
            "--theta-r-deg",
            "5",
            "10",
            "--alpha",
            "0.2",
            "--paths",
            "64",
        ];
        let args: Args = parsed(&words);
        let calm = AtomicBool::new(false);
        // The limit has passed before the first surface.
        let late = cells(&args, &Stopwatch::start(Some(1e-9)), &calm);
        let Err(CliError::NoResult(why)) = late else {
            panic!("{late:?}");
        };
        assert!(why.to_string().contains("within the time limit"), "{why}");
        let missing = [ErrorSurface {
            material: 1,
            theta_r_deg: 10.0,
            alpha: 0.2,
        }];
        let object = report(&[], &left_out(&missing), 1.0);
        let last = &object["left_out"][2];
        assert_eq!(last["what"], "1 surface: steel of 10° and α 0.2");
        assert!(left_out(&[]).len() == 2);
    }

    #[test]
    fn a_target_error_that_is_not_reached_is_no_result_unless_the_time_limit_ended_the_run() {
        let args: Args = parsed(&["--theta-r-deg", "5", "--alpha", "0.2", "--paths", "64"]);
        let watch = Stopwatch::start(None);
        let mut few = cells(&args, &watch, &AtomicBool::new(false)).unwrap();
        let worst = few.cells.iter().map(|c| c.noise).fold(0.0, f64::max);
        let asked = |target: f64| PathLimits {
            max_seconds: None,
            target_error: Some(target),
        };
        assert!(few.verdict(&asked(2.0 * worst)).is_ok());
        let Err(CliError::NoResult(why)) = few.verdict(&asked(0.5 * worst)) else {
            panic!("{worst}");
        };
        let why = why.to_string();
        assert!(
            why.contains("every surface") && why.contains("about 256"),
            "{why}"
        );
        few.cut_short = true;
        assert!(few.verdict(&asked(0.5 * worst)).is_ok());
    }

    #[test]
    fn a_surface_that_misses_the_error_is_traced_again_with_the_paths_that_it_needs() {
        let asked = std::cell::RefCell::new(Vec::new());
        let trace = |paths: u64| {
            asked.borrow_mut().push(paths);
            Some(SurfaceErrors {
                material: 0,
                theta_r_deg: 5.0,
                alpha: 0.1,
                closed: Vec::new(),
                quadrature: Vec::new(),
                paths,
                noise: 0.8 / (paths as f64).sqrt(),
                fitted: [None; 2],
            })
        };
        let reached = |paths, target| traced(paths, target, &trace).unwrap().noise;
        assert!(reached(64, None) == 0.1 && reached(64, Some(0.1)) == 0.1);
        assert_eq!(asked.take(), [64, 64]);
        assert!(reached(64, Some(0.05)) < 0.05);
        assert_eq!(asked.take(), [64, 282]);
        // An unreachable error ends the run; a second run that the time limit ends leaves the first result.
        assert!(reached(64, Some(1e-9)) > 1e-9);
        assert_eq!(asked.take(), [64, PATHS.1]);
        // An error that falls more slowly takes more than two runs.
        let slow = |paths: u64| {
            let cell = trace(paths)?;
            let noise = (paths as f64).powf(-0.45);
            Some(SurfaceErrors { noise, ..cell })
        };
        assert!(traced(64, Some(0.05), &slow).unwrap().noise < 0.05);
        assert!(asked.take().len() > 2);
        let once = |paths: u64| (paths == 64).then(|| trace(paths)).flatten();
        assert_eq!(traced(64, Some(0.05), &once).unwrap().paths, 64);
    }

    #[test]
    fn surfaces_out_of_range_are_refused() {
        for words in [
            ["--theta-r-deg", "90"],
            ["--alpha", "0"],
            ["--paths", "0"],
            ["--rho-d", "2"],
        ] {
            assert!(found(&words).is_err(), "{words:?}");
        }
    }
}
