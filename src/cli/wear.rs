//! `ridged wear`: the ridge angle at which the contrast of worn ridges peaks, by tracing.
//!
//! The first paper's model peaks at a ridge angle of 5°, its experiments at 10° (Luongo et al. 2017,
//! section 5). This command traces rounded edges and burrs of several sizes on the true geometry, to show whether and at
//! which size they explain the difference.

mod figure;
mod shards;
mod study;
mod tables;

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context, anyhow};
use serde::{Deserialize, Serialize};
use study::Study;

use super::limits::{PathLimits, PathWork, PilotResult, Stopwatch};
use super::prediction::Scene;
use super::shards::{MergeArgs, Target};
use super::{CliError, interrupt, output, output_path};
use crate::model::LeftOut;
use crate::model::contrast::PAPER_RIDGES_DEG;
use crate::shard::Shard;
use crate::trace::counting::tally::MonteCarloEstimate;
use crate::wording::{counted, significant};

/// Traces the contrast of rounded and burred ridges over the ridge angle: CSV and figure.
///
/// Contrast is the mean of |L(0°) − L(90°)| and |L(90°) − L(180°)| over the given tilts. Rounding is
/// the radius of crests and valleys, burrs have exponentially distributed heights; both in units
/// of the facets' length.
#[derive(Debug, clap::Args)]
#[command(
    args_conflicts_with_subcommands = true,
    after_help = "Examples:\n  ridged wear --out docs/explanation\n  \
    ridged wear --alpha 0.12 --rounds 0 0.05 0.1 --burrs --paths 1024 --json\n  \
    ridged wear --shard 1/4 --out 1.shard\n  \
    ridged wear merge 1.shard 2.shard 3.shard 4.shard --out worn"
)]
pub struct Args {
    /// Merge shards instead.
    #[command(subcommand)]
    pub action: Option<Action>,
    /// Radii of rounded crests and valleys, as ratios to the facet length (traced without burrs).
    #[arg(long, value_name = "RATIO", num_args = 0.., value_delimiter = ',', default_values_t = [0.0, 0.01, 0.02, 0.05, 0.1, 0.15, 0.2, 0.3])]
    pub rounds: Vec<f64>,
    /// Mean heights of burrs, as ratios to the facet length (traced without rounding).
    #[arg(long, value_name = "RATIO", num_args = 0.., value_delimiter = ',', default_values_t = [0.005, 0.01, 0.02, 0.03, 0.05])]
    pub burrs: Vec<f64>,
    /// Smallest ridge angle.
    #[arg(long, default_value_t = 1.0, value_name = "DEG")]
    pub theta_r_min_deg: f64,
    /// Largest ridge angle.
    #[arg(long, default_value_t = 20.0, value_name = "DEG")]
    pub theta_r_max_deg: f64,
    /// Step of the ridge angle.
    #[arg(long, default_value_t = 0.5, value_name = "DEG")]
    pub theta_r_step_deg: f64,
    /// Paths per radiance: from the camera, and the same number from the lamp.
    #[arg(long, value_name = "N", default_value_t = 4096)]
    pub paths: u64,
    /// Limits of time and error.
    #[command(flatten)]
    pub limits: PathLimits,
    /// Seed of the random numbers.
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
    /// Rig and other parameters of the surface.
    #[command(flatten)]
    pub scene: Scene,
    /// Folder for wear.csv and wear.svg. With --shard: file of the shard.
    #[arg(long, value_name = "DIR|FILE")]
    pub out: Option<PathBuf>,
    /// Trace part K of N; `ridged wear merge` puts the parts together.
    #[arg(long, value_name = "K/N", conflicts_with_all = ["max_seconds", "target_error"])]
    pub shard: Option<Shard>,
    /// One JSON object on stdout instead of a table.
    #[arg(long)]
    pub json: bool,
}

/// Subcommands of `ridged wear`.
#[derive(Debug, clap::Subcommand)]
pub enum Action {
    /// Merge the files of all shards of one run; the result is bit-equal to one run.
    #[command(after_help = "Example:\n  ridged wear merge 1.shard 2.shard --out worn")]
    Merge(MergeArgs),
}

/// Ridge angles closer than this are equal.
const SAME_DEG: f64 = 1e-9;

/// A kind of wear.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(super) enum Wear {
    /// Radius of the edges in facet lengths.
    Round(f64),
    /// Mean height of burrs in facet lengths.
    Burr(f64),
}

/// The contrast over the ridge angle at one wear.
#[derive(Debug, Clone)]
pub(super) struct Sweep {
    pub wear: Wear,
    /// By rising angle in even steps.
    pub points: Vec<WearPoint>,
    /// The paper's ridge angles within the bounds that are between the steps.
    pub between: Vec<WearPoint>,
    /// Number of steps left out by the time limit.
    pub missing: usize,
}

/// All wears, and facts about the run.
#[derive(Debug)]
struct Swept {
    sweeps: Vec<Sweep>,
    left_out: Vec<LeftOut>,
    /// Paths per radiance.
    paths: u64,
    /// Whether the time limit reduced the number of surfaces or paths.
    cut_short: bool,
}

/// One surface.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
pub(super) struct WearPoint {
    /// Ridge angle of the facets before wear.
    pub theta_r_deg: f64,
    /// Effective ridge angle after wear.
    pub effective_deg: f64,
    /// Mean absolute contrast, sr⁻¹.
    pub contrast: MonteCarloEstimate,
}

impl Wear {
    fn name(self) -> String {
        match self {
            Wear::Round(0.0) => "none".to_owned(),
            Wear::Round(x) => format!("edges of radius {x} p"),
            Wear::Burr(x) => format!("burrs of mean height {x} p"),
        }
    }
}

impl Sweep {
    /// Ridge angle of greatest contrast: the vertex of a parabola through the best point and its
    /// neighbours, and its standard uncertainty from the points' errors.
    /// `None` where steps are missing: the best may be one of them.
    pub fn optimum(&self) -> Option<MonteCarloEstimate> {
        if self.missing > 0 {
            return None;
        }
        let value = |p: &WearPoint| p.contrast.value;
        let best = (0..self.points.len())
            .max_by(|&a, &b| value(&self.points[a]).total_cmp(&value(&self.points[b])))?;
        let at = &self.points[best];
        let (Some(before), Some(after)) = (
            best.checked_sub(1).map(|i| &self.points[i]),
            self.points.get(best + 1),
        ) else {
            return Some(MonteCarloEstimate {
                value: at.theta_r_deg,
                std: f64::INFINITY,
            });
        };
        let step = after.theta_r_deg - at.theta_r_deg;
        let bend = value(before) - 2.0 * value(at) + value(after);
        let slope = 0.5 * (value(after) - value(before));
        let noise = 0.5f64.sqrt() * at.contrast.std;
        Some(MonteCarloEstimate {
            value: at.theta_r_deg - step * (slope / bend).clamp(-0.5, 0.5),
            std: (step * noise / bend).abs().hypot(0.25 * step),
        })
    }

    /// All traced surfaces, at the steps and between them.
    fn all(&self) -> impl Iterator<Item = &WearPoint> {
        self.points.iter().chain(&self.between)
    }

    /// Returns the surface of a ridge angle, if it was traced.
    pub fn at(&self, theta_r_deg: f64) -> Option<&WearPoint> {
        self.all()
            .find(|p| (p.theta_r_deg - theta_r_deg).abs() < SAME_DEG)
    }

    /// Returns the one of the paper's four ridge angles with the greatest contrast.
    pub fn best_of_paper(&self) -> Option<f64> {
        let known = PAPER_RIDGES_DEG
            .iter()
            .filter_map(|t| Some((*t, self.at(*t)?.contrast.value)));
        known.max_by(|a, b| a.1.total_cmp(&b.1)).map(|best| best.0)
    }
}

/// Runs the command.
///
/// # Errors
/// Bad input for options out of range; no result where a file cannot be written; interrupted.
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
    let swept = sweep(&args, &watch, &*interrupt::flag()?)?;
    write_result(&swept, args.out.as_deref(), args.json, watch.seconds())?;
    swept.verdict(&args.limits)
}

/// Writes the files of a sweep, if a folder is given, and prints it.
fn write_result(
    swept: &Swept,
    out: Option<&Path>,
    json: bool,
    seconds: f64,
) -> Result<(), CliError> {
    let sweeps = &swept.sweeps;
    if let Some(out) = out {
        std::fs::create_dir_all(out)
            .and_then(|()| std::fs::write(out.join("wear.csv"), tables::csv(sweeps)))
            .and_then(|()| std::fs::write(out.join("wear.svg"), figure::draw(sweeps)))
            .with_context(|| format!("cannot write to {}", out.display()))
            .map_err(CliError::no_result)?;
    }
    output::write(json, &tables::report(swept, seconds), || {
        let mut text = tables::table(sweeps) + "\n" + &tables::errors_table(sweeps);
        for left in &swept.left_out {
            let _ = writeln!(text, "\nleft out: {} ({})", left.what, left.why);
        }
        text
    })
}

fn sweep(args: &Args, watch: &Stopwatch, cancel: &AtomicBool) -> Result<Swept, CliError> {
    let study = Study::of(args)?;
    args.limits.check()?;
    let surfaces = study.surfaces.count();
    let stopped = || cancel.load(Ordering::Relaxed) || watch.is_late();
    let (mut paths, mut cut_short) = (args.paths, false);
    if args.limits.is_any() {
        let pilot = |paths: u64| {
            let c = study.point(surfaces / 2, paths, &stopped)?.contrast;
            Some(PilotResult {
                surfaces: 1,
                error: c.std / c.value.abs().max(f64::MIN_POSITIVE),
                apart_s: 0.0,
            })
        };
        let work = PathWork {
            surfaces,
            abreast: rayon::current_num_threads(),
            paths,
            may_miss_some: false,
        };
        let planned = args.limits.plan(&work, &pilot)?;
        if let Some(planned) = planned {
            super::say(&format_args!("forecast: {}", planned.forecast));
            (paths, cut_short) = (planned.paths, planned.forecast.cut_short);
        }
    }
    let points = study.points((0..surfaces).collect(), paths, watch, cancel)?;
    let late = points.iter().filter(|p| p.is_none()).count();
    let late = if watch.is_late() { late } else { 0 };
    if late == surfaces {
        return Err(CliError::no_result(anyhow!(
            "no surface was finished within the time limit: allow more time"
        )));
    }
    Ok(study.surfaces.swept(&points, late, paths, cut_short))
}

/// Effects that the surfaces omit, and surfaces left out by the time limit. `cut` has, for each burr that is cut, the mean
/// height as given, the height of the cut and the remaining mean height, in facet lengths.
fn left_out(
    late: usize,
    surfaces: usize,
    cuts: impl Iterator<Item = (f64, f64, f64)>,
) -> Vec<LeftOut> {
    let mut list = vec![LeftOut::new(
        "bounces among the facets' own roughness",
        "on the facets, light meets one microfacet per hit, with Smith's masking",
        None,
    )];
    list.extend(cuts.map(|(burr, most, mean)| {
        LeftOut::new(
            format!("the tops of burrs of mean height {burr} p"),
            format!(
                "a burr must fit on its facet: burrs above {} p are cut there, so their mean height is {} p",
                significant(most),
                significant(mean)
            ),
            None,
        )
    }));
    if late > 0 {
        list.push(LeftOut::new(
            format!("{late} of {}", counted(surfaces, "surface")),
            "time limit reached",
            None,
        ));
    }
    list
}

impl Swept {
    /// The greatest relative standard error of a contrast.
    fn error(&self) -> f64 {
        let points = self.sweeps.iter().flat_map(Sweep::all);
        let relative = points.map(|p| p.contrast.std / p.contrast.value);
        relative.filter(|e| e.is_finite()).fold(0.0, f64::max)
    }

    /// Checks that the target error was reached, unless the time limit ended the run.
    fn verdict(&self, limits: &PathLimits) -> Result<(), CliError> {
        match self.cut_short {
            true => Ok(()),
            false => limits.verdict("contrast", self.paths, self.error()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::parsed;

    fn all_of(words: &[&str]) -> Result<Swept, CliError> {
        let args: Args = parsed(words);
        let watch = Stopwatch::start(args.limits.max_seconds);
        sweep(&args, &watch, &AtomicBool::new(false))
    }

    fn swept(words: &[&str]) -> Result<Vec<Sweep>, CliError> {
        all_of(words).map(|swept| swept.sweeps)
    }

    /// Few surfaces of few paths.
    const SMALL: &str = "--rounds 0 --burrs --theta-c-deg 0 --theta-r-min-deg 8 --theta-r-max-deg 10 --theta-r-step-deg 1 \
                         --paths 64";

    #[test]
    fn surfaces_left_out_by_the_time_limit_are_reported() {
        let args: Args = parsed(&SMALL.split(' ').collect::<Vec<_>>());
        let late = sweep(
            &args,
            &Stopwatch::start(Some(1e-9)),
            &AtomicBool::new(false),
        );
        let Err(CliError::NoResult(why)) = late else {
            panic!("{late:?}");
        };
        assert!(why.to_string().contains("within the time limit"), "{why}");
        let omitted = left_out(2, 3, std::iter::empty());
        assert_eq!(omitted[1].what, "2 of 3 surfaces");
        // A missing step may be the best one.
        let mut whole = swept(&SMALL.split(' ').collect::<Vec<_>>())
            .unwrap()
            .remove(0);
        assert!(whole.missing == 0 && whole.optimum().is_some());
        (whole.missing, whole.points) = (1, whole.points[..2].to_vec());
        assert!(whole.optimum().is_none());
    }

    #[test]
    fn a_target_error_that_is_not_reached_is_no_result_unless_the_time_limit_ended_the_run() {
        let mut few = all_of(&SMALL.split(' ').collect::<Vec<_>>()).unwrap();
        let error = few.error();
        let asked = |target: f64| PathLimits {
            max_seconds: None,
            target_error: Some(target),
        };
        assert!(error > 0.0 && few.verdict(&PathLimits::default()).is_ok());
        assert!(few.verdict(&asked(2.0 * error)).is_ok());
        let Err(CliError::NoResult(why)) = few.verdict(&asked(0.5 * error)) else {
            panic!("{error}");
        };
        let why = why.to_string();
        assert!(
            why.contains("reached the target error") && why.contains("about 256"),
            "{why}"
        );
        few.cut_short = true;
        assert!(few.verdict(&asked(0.5 * error)).is_ok());
        assert_eq!(tables::report(&few, 1.0)["paths"], 64);
        assert_eq!(tables::errors_table(&few.sweeps).lines().count(), 2 + 1);
    }

    #[test]
    fn burrs_that_are_cut_are_reported_with_the_remaining_height() {
        let words = SMALL.replace("--burrs", "--burrs 0.02 0.2");
        let omitted = all_of(&words.split(' ').collect::<Vec<_>>())
            .unwrap()
            .left_out;
        let [_, cut] = &omitted[..] else {
            panic!("{omitted:?}")
        };
        // 0.2 (1 − exp(−0.4/0.2)).
        assert!(
            cut.what.contains("0.2 p") && cut.why.contains("0.173 p"),
            "{cut:?}"
        );
    }

    #[test]
    fn rounding_takes_contrast_from_flat_ridges() {
        let sweeps = swept(&[
            "--rounds",
            "0",
            "0.1",
            "--burrs",
            "0.02",
            "--theta-c-deg",
            "0",
            "--paths",
            "64",
            "--theta-r-min-deg",
            "5",
            "--theta-r-max-deg",
            "15",
            "--theta-r-step-deg",
            "5",
        ])
        .unwrap();
        assert_eq!(sweeps.len(), 3);
        let contrast = |s: &Sweep, t: f64| s.at(t).unwrap().contrast.value;
        let ratio = |t: f64| contrast(&sweeps[1], t) / contrast(&sweeps[0], t);
        assert!(ratio(5.0) < 0.95, "{}", ratio(5.0));
        assert!(sweeps[1].points[0].effective_deg < 5.0);
        assert_eq!(tables::csv(&sweeps).lines().count(), 1 + 9);
        assert!(tables::table(&sweeps).lines().count() == 2 + 3);
        assert!(figure::draw(&sweeps).contains("</svg>"));
    }

    #[test]
    fn the_papers_ridges_are_traced_whatever_the_steps() {
        let from_by = |low: &str, step: &str| {
            let mut words = "--rounds 0.1 --burrs --theta-c-deg 0 --paths 64 --theta-r-max-deg 16"
                .split(' ')
                .collect::<Vec<_>>();
            words.extend(["--theta-r-min-deg", low, "--theta-r-step-deg", step]);
            swept(&words).unwrap().remove(0)
        };
        let (coarse, fine) = (from_by("1", "7"), from_by("5", "5"));
        assert_eq!((coarse.points.len(), coarse.between.len()), (3, 2));
        for t in [5.0, 10.0, 15.0] {
            let (a, b) = (coarse.at(t).unwrap(), fine.at(t).unwrap());
            assert_eq!((a.contrast, a.effective_deg), (b.contrast, b.effective_deg));
        }
        assert!(coarse.at(20.0).is_none() && fine.between.is_empty());
        let object = tables::report(
            &Swept {
                sweeps: vec![coarse],
                left_out: Vec::new(),
                paths: 64,
                cut_short: false,
            },
            0.0,
        );
        let effective = &object["sweeps"][0]["effective_deg_at_paper_ridges"];
        assert!(
            (effective[1].as_f64().unwrap() - 10.0).abs() < 0.1 && effective[3].is_null(),
            "{object}"
        );
    }

    #[test]
    fn wears_out_of_range_are_refused() {
        for word in [
            "--rounds=-1",
            "--rounds=nan",
            "--paths=1",
            "--theta-r-step-deg=0",
            "--theta-r-min-deg=30",
        ] {
            assert!(swept(&[word]).is_err(), "{word}");
        }
    }
}
