//! `ridged score`: fits series of known truth like any other and reports the differences.
//!
//! The truth is the file `truth.toml` of a series, which neither reduction nor fit reads. E_n is the difference divided by
//! the expanded uncertainty; below 1 the interval contains the truth.
//!
//! A synthetic series often has a rig, a reference and a material without errors, so its E_n say nothing about the lines
//! of a budget for such errors. `--draws` therefore also fits each series with errors of the stated sizes
//! (`accuracy::stated_errors`).

use std::fmt::Write as _;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

use anyhow::Context as _;
use serde::{Deserialize, Serialize};

use super::progress::Bar;
use super::{CliError, fit, interrupt, output};
use crate::accuracy::stated_errors::with_stated_errors;
use crate::analysis::{Analysis, AnalysisOptions, analyse_observations};
use crate::fit::report::{FitReport, Parameter};
use crate::fit::uncertainty::coverage::other_factor;
use crate::series::Series;
use crate::wording::decimals;

/// Text above the table in a file.
const HEAD: &str = "# Fits of samples, rigs and cameras as labs have them, against the truth

Made by `ridged score tests/data/series tests/data/series2 --draws 10 --out docs/explanation/real-samples.md`. Each series was path-traced on
ridges of known shape, with a camera's noise and pattern; `truth.toml` in its folder says what is real in it, and no fit reads it. U is the
expanded uncertainty (k = 2), E_n = (value − truth)/U. The first finding is what explains most of what an ideal sawtooth, a steady lamp and a
linear camera leave. [sawtooth.md](sawtooth.md) has the formulas.

The stages, the white reference and the index of these series have no errors, but U allows for those that the manifest states. Each
series is therefore fitted again with random errors of the stated sizes: zero and scale of the tilt, zero and eccentricity of the rotation,
lamp angle, certificate, lamp drift, camera, index. The column “E_n, drawn” has the root mean square of E_n over these fits. U is of the
right size if it is about 0.5: the errors are then half of U, that is one standard uncertainty.

";

/// Fits recorded series whose truth is known and prints truth, value, expanded uncertainty and E_n.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  ridged score tests/data/series tests/data/series2\n  \
                  ridged score tests/data/series2/translucent-12 --json\n  \
                  ridged score tests/data/series tests/data/series2 --draws 10 --out docs/explanation/real-samples.md"
)]
pub struct Args {
    /// Series with a truth.toml, or folders that hold such series.
    #[arg(value_name = "DIR", required = true)]
    pub dirs: Vec<PathBuf>,
    /// Fit each series N times more, with random errors of the sizes that its manifest states.
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u64).range(0..=1000))]
    pub draws: u64,
    /// Write the table to a file (Markdown), too.
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// One JSON object on stdout instead of a table.
    #[arg(long)]
    pub json: bool,
}

/// One parameter of one series.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ScoreRow {
    /// Name as in the report of a fit.
    pub parameter: String,
    /// True value, in the parameter's unit.
    pub truth: f64,
    /// Fitted value.
    pub value: f64,
    /// Expanded uncertainty of the fitted value.
    pub expanded: f64,
    /// k of the expanded uncertainty.
    #[serde(default)]
    pub coverage_factor: Option<f64>,
    /// (value − truth)/expanded.
    pub e_n: f64,
    /// The same of each fit with drawn errors.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub drawn_e_n: Vec<f64>,
}

/// One series.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Score {
    /// Name of its folder.
    pub series: String,
    /// Status of its fit.
    pub status: crate::fit::report::Status,
    /// Residual, root mean square over the largest observation.
    pub rms_residual: Option<f64>,
    /// Code of the first finding.
    pub first_finding: Option<String>,
    /// Parameters whose truth is known.
    pub rows: Vec<ScoreRow>,
}

/// Many E_n in brief.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ScoreSummary {
    /// Root mean square of all E_n.
    pub rms_e_n: f64,
    /// Largest |E_n|.
    pub worst_e_n: f64,
    /// Share of |E_n| above 1.
    pub share_above_1: f64,
}

/// All series.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Scores {
    /// Each series.
    pub series: Vec<Score>,
    /// Over the series as they are.
    #[serde(flatten)]
    pub summary: ScoreSummary,
    /// Over the fits with drawn errors; none without `--draws`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub drawn: Option<ScoreSummary>,
}

/// The values of `truth.toml` that are compared.
#[derive(Debug, Default, Deserialize)]
struct KnownTruth {
    #[serde(default)]
    sample: TrueSample,
    #[serde(default)]
    body: TrueBody,
    #[serde(default)]
    mounting: TrueMounting,
    #[serde(default)]
    near_field: NearField,
    #[serde(default)]
    moulded: Moulded,
}

#[derive(Debug, Default, Deserialize)]
struct TrueSample {
    theta_r_deg: Option<f64>,
    theta_r_effective_deg: Option<f64>,
    alpha_u: Option<f64>,
    alpha_v: Option<f64>,
    rho_d_lambertian_equivalent: Option<f64>,
}

#[derive(Debug, Default, Deserialize)]
struct TrueBody {
    translucency: Option<f64>,
}

#[derive(Debug, Default, Deserialize)]
struct TrueMounting {
    azimuth_offset_deg: Option<f64>,
    camera_tilt_zero_offset_deg: Option<f64>,
}

#[derive(Debug, Default, Deserialize)]
struct NearField {
    theta_r_to_the_turntable_deg: Option<f64>,
    azimuth_offset_to_the_turntable_deg: Option<f64>,
}

#[derive(Debug, Default, Deserialize)]
struct Moulded {
    crest: Option<f64>,
}

impl KnownTruth {
    /// By the names of the fit report.
    fn of(&self, parameter: &str) -> Option<f64> {
        let (sample, near) = (&self.sample, &self.near_field);
        match parameter {
            "theta_r_deg" => near
                .theta_r_to_the_turntable_deg
                .or(sample.theta_r_effective_deg)
                .or(sample.theta_r_deg),
            "alpha_u" => sample.alpha_u,
            "alpha_v" => sample.alpha_v,
            "rho_d" => sample.rho_d_lambertian_equivalent,
            "azimuth_offset_deg" => near
                .azimuth_offset_to_the_turntable_deg
                .or(self.mounting.azimuth_offset_deg),
            "tilt_offset_deg" => self.mounting.camera_tilt_zero_offset_deg,
            "translucency" => self.body.translucency,
            "crest_radius" => self.moulded.crest,
            _ => None,
        }
    }
}

/// Runs the command.
///
/// # Errors
/// Bad input for a folder that is not a series or has no truth; no result where a fit fails.
pub fn run(args: &Args) -> Result<(), CliError> {
    let mut series = Vec::new();
    for dir in &args.dirs {
        series.extend(with_truth(dir).map_err(CliError::bad_input)?);
    }
    let cancel = interrupt::flag()?;
    let mut scores = Vec::new();
    for (index, dir) in series.iter().enumerate() {
        super::say(&format_args!("{}", dir.display()));
        let source = Series::open(dir).map_err(CliError::bad_input)?;
        // Each patch of a board has its own truth.
        if crate::reduction::FrameSource::manifest(&source)
            .sample
            .layout
            .is_some()
        {
            super::say(&"  has regions: left out");
            continue;
        }
        let truth = truth_of(dir).map_err(CliError::bad_input)?;
        let options = AnalysisOptions::default();
        let analysis = fit::watched(&source, &options, None, &cancel)?;
        let mut score = score(&name_of(dir), &truth, &analysis.report);
        // Errors of one series say nothing about those of the next.
        let first = index as u64 * args.draws;
        let seeds = first..first + args.draws;
        add_draws(&mut score, &truth, &analysis, seeds, &cancel)?;
        scores.push(score);
    }
    let scores = summed(scores);
    let table = markdown(&scores);
    if let Some(path) = &args.out {
        std::fs::write(path, format!("{HEAD}{table}"))
            .with_context(|| format!("cannot write {}", path.display()))
            .map_err(CliError::bad_input)?;
    }
    output::write(args.json, &scores, || table)
}

/// Fits the observations again with errors of the stated sizes. A value that such a fit does not report has no E_n.
fn add_draws(
    to: &mut Score,
    truth: &KnownTruth,
    analysis: &Analysis,
    seeds: Range<u64>,
    cancel: &AtomicBool,
) -> Result<(), CliError> {
    let bar = Bar::new("fits with drawn errors");
    let draws = seeds.end - seeds.start;
    for (done, seed) in (1..).zip(seeds) {
        let set = with_stated_errors(&analysis.observations, seed);
        let drawn = analyse_observations(set, &AnalysisOptions::default(), &|_| {}, cancel)
            .map_err(|_| CliError::Interrupted)?;
        for row in score(&to.series, truth, &drawn.report).rows {
            if let Some(known) = to.rows.iter_mut().find(|k| k.parameter == row.parameter) {
                known.drawn_e_n.push(row.e_n);
            }
        }
        bar.at(done, draws);
    }
    Ok(())
}

fn name_of(dir: &Path) -> String {
    let canonical = dir.canonicalize().unwrap_or_else(|_| dir.to_owned());
    let name = canonical.file_name().unwrap_or(canonical.as_os_str());
    name.to_string_lossy().into_owned()
}

/// Returns the folders with a truth, by name: `dir` itself, or folders in it.
fn with_truth(dir: &Path) -> anyhow::Result<Vec<PathBuf>> {
    if dir.join("truth.toml").is_file() {
        return Ok(vec![dir.to_owned()]);
    }
    let entries =
        std::fs::read_dir(dir).with_context(|| format!("cannot read {}", dir.display()))?;
    let mut found: Vec<PathBuf> = entries
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(|path| path.join("truth.toml").is_file())
        .collect();
    found.sort();
    anyhow::ensure!(
        !found.is_empty(),
        "{}: neither a series with a truth.toml nor a folder of such series",
        dir.display()
    );
    Ok(found)
}

fn truth_of(dir: &Path) -> anyhow::Result<KnownTruth> {
    let path = dir.join("truth.toml");
    let text = std::fs::read_to_string(&path)
        .with_context(|| format!("cannot read {}", path.display()))?;
    toml::from_str(&text).with_context(|| path.display().to_string())
}

fn score(name: &str, truth: &KnownTruth, report: &FitReport) -> Score {
    let row = |(parameter, p): (&str, &Parameter)| {
        let truth = truth.of(parameter)?;
        let (value, expanded) = (p.value?, p.expanded?);
        Some(ScoreRow {
            parameter: parameter.to_owned(),
            truth,
            value,
            expanded,
            coverage_factor: p.coverage_factor,
            e_n: (value - truth) / expanded,
            drawn_e_n: Vec::new(),
        })
    };
    Score {
        series: name.to_owned(),
        status: report.status,
        rms_residual: report.rms_residual,
        first_finding: report.findings.first().map(|f| f.code.word().to_owned()),
        rows: report
            .parameters
            .named()
            .into_iter()
            .filter_map(row)
            .collect(),
    }
}

fn summed(series: Vec<Score>) -> Scores {
    let rows = || series.iter().flat_map(|s| &s.rows);
    let drawn: Vec<f64> = rows().flat_map(|row| row.drawn_e_n.clone()).collect();
    let plain: Vec<f64> = rows().map(|row| row.e_n).collect();
    Scores {
        summary: ScoreSummary::of(&plain),
        drawn: (!drawn.is_empty()).then(|| ScoreSummary::of(&drawn)),
        series,
    }
}

impl ScoreSummary {
    fn of(all: &[f64]) -> Self {
        let count = all.len().max(1) as f64;
        ScoreSummary {
            rms_e_n: root_mean_square(all),
            worst_e_n: all.iter().fold(0.0, |worst, e| worst.max(e.abs())),
            share_above_1: all.iter().filter(|e| e.abs() > 1.0).count() as f64 / count,
        }
    }
}

fn root_mean_square(all: &[f64]) -> f64 {
    (all.iter().map(|e| e * e).sum::<f64>() / all.len().max(1) as f64).sqrt()
}

fn markdown(scores: &Scores) -> String {
    let mut out = String::new();
    let mut heads = vec!["series", "parameter", "truth", "value ± U (k = 2)", "E_n"];
    heads.extend(scores.drawn.map(|_| "E_n, drawn"));
    heads.push("first finding");
    let _ = writeln!(out, "| {} |", heads.join(" | "));
    let _ = writeln!(out, "| {} |", vec!["---"; heads.len()].join(" | "));
    for score in &scores.series {
        for (k, row) in score.rows.iter().enumerate() {
            let digits = decimals(row.expanded);
            let factor = other_factor(row.coverage_factor);
            let drawn = scores.drawn.map(|_| match row.drawn_e_n.as_slice() {
                [] => String::from("| "),
                all => format!("| {:.2} ", root_mean_square(all)),
            });
            let _ = writeln!(
                out,
                "| {} | {} | {} | {:.digits$} ± {:.digits$}{} | {:.2} {}| {} |",
                if k == 0 { score.series.as_str() } else { "" },
                row.parameter,
                (row.truth * 1e4).round() / 1e4,
                row.value,
                row.expanded,
                factor.map_or_else(String::new, |k| format!(" ({k})")),
                row.e_n,
                drawn.unwrap_or_default(),
                match k {
                    0 => score.first_finding.as_deref().unwrap_or("none"),
                    _ => "",
                }
            );
        }
    }
    let mut line = |what: &str, s: ScoreSummary| {
        let _ = writeln!(
            out,
            "\n{what}: {:.2} root mean square, {:.2} at most, {:.1} % above 1.",
            s.rms_e_n,
            s.worst_e_n,
            100.0 * s.share_above_1
        );
    };
    line("E_n over all", scores.summary);
    if let Some(drawn) = scores.drawn {
        line("E_n with drawn errors", drawn);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_truth_is_compared_by_the_most_exact_of_its_angles() {
        let truth: KnownTruth = toml::from_str(
            "[sample]\ntheta_r_deg = 14\ntheta_r_effective_deg = 13.9\nalpha_u = 0.1\n[near_field]\n\
             theta_r_to_the_turntable_deg = 13.8",
        )
        .unwrap();
        assert_eq!(truth.of("theta_r_deg"), Some(13.8));
        assert_eq!(truth.of("alpha_u"), Some(0.1));
        assert_eq!(truth.of("rho_d"), None);
    }

    #[test]
    fn scores_add_up_over_series() {
        let row = |e_n: f64| ScoreRow {
            parameter: "theta_r_deg".into(),
            truth: 10.0,
            value: 10.0 + 0.1 * e_n,
            expanded: 0.1,
            coverage_factor: Some(2.0),
            e_n,
            drawn_e_n: vec![2.0 * e_n, 0.0],
        };
        let series = |rows| Score {
            series: "a".into(),
            status: crate::fit::report::Status::Converged,
            rms_residual: None,
            first_finding: None,
            rows,
        };
        let scores = summed(vec![
            series(vec![row(0.5), row(-2.0)]),
            series(vec![row(0.5)]),
        ]);
        assert!((scores.summary.rms_e_n - 1.5f64.sqrt()).abs() < 1e-12);
        assert_eq!(scores.summary.worst_e_n, 2.0);
        let drawn = scores.drawn.unwrap();
        assert!((drawn.rms_e_n - 3f64.sqrt()).abs() < 1e-12);
        assert!((drawn.share_above_1 - 1.0 / 6.0).abs() < 1e-12);
        let table = markdown(&scores);
        assert!(
            table.contains("| 10.05 ± 0.10 | 0.50 | 0.71 | none |"),
            "{table}"
        );
        assert!(table.contains(
            "E_n with drawn errors: 1.73 root mean square, 4.00 at most, 16.7 % above 1."
        ));
    }
}
