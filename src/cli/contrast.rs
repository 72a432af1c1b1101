//! `ridged contrast`: the paper's contrast table, predicted for a rig or measured in a series.

mod compare;
mod figure;

use std::fmt::Write as _;
use std::path::PathBuf;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use anyhow::{Context, anyhow};
use clap::Args as _;
use serde::Serialize;

use compare::{ReportedComparison, TableComparison};

use super::limits::{PredictionLimits, Stopwatch};
use super::prediction::{Model, Scene, costly_omissions};
use super::{CliError, interrupt, output, output_collision, output_path, runtime};
use crate::contrast::{ContrastReport, ReportedContrast, ReportedTable, measure, rounded_deg};
use crate::forecast::Expected;
use crate::model::LeftOut;
use crate::model::contrast::{Line, Mean, PAPER_RIDGES_DEG, Pace, Table, Tier, predict_paced};
use crate::observation::ObservationSet;
use crate::reduction::{FrameSource, ReductionError, reduce};
use crate::series::Series;
use crate::wording::significant;

/// Contrast after rotation: absolute difference of radiances at azimuths 0°, 90° and 180°.
///
/// With a folder it is measured in that series. Otherwise it is predicted for the rig and surface given by the options;
/// the defaults are the paper's rig with narrow lobes.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    ridged contrast --theta-r-deg 5 10 15 20 --svg contrast.svg\n  \
    ridged contrast --alpha 0.06 --rho-d 0.342 --compare tests/data/contrast-raytraced-paper-rig.csv\n  \
    ridged contrast tests/data/series/polymer-10 --json")]
#[command(mut_args(of_predictions))]
pub struct Args {
    /// Folder of a recorded series; its contrast is measured.
    #[arg(group = "measured")]
    pub dir: Option<PathBuf>,
    /// Number of a scan in the store; its contrast is measured.
    #[arg(long, value_name = "ID", group = "measured")]
    pub scan: Option<i64>,
    /// Data folder.
    #[arg(long, value_name = "DIR", default_value = "ridged-data")]
    pub data: PathBuf,
    /// Region of a part with a layout (measured).
    #[arg(long, requires = "measured")]
    pub region: Option<String>,
    /// Ridge angles to predict for.
    #[arg(long, num_args = 1.., value_delimiter = ',', value_name = "DEG", conflicts_with = "measured",
          default_values_t = PAPER_RIDGES_DEG)]
    pub theta_r_deg: Vec<f64>,
    /// Rig and surface of the prediction.
    #[command(flatten)]
    pub scene: Scene,
    /// How the radiances are computed.
    #[arg(long, value_enum, default_value_t = Model::Sawtooth)]
    pub variant: Model,
    /// Limits of time and error of a prediction.
    #[command(flatten)]
    pub limits: PredictionLimits,
    /// CSV of radiances to compare with (theta_r_deg, theta_c_deg, phi_s_deg, radiance; a column
    /// alpha is matched with --alpha).
    #[arg(long, value_name = "FILE.csv", conflicts_with = "measured")]
    pub compare: Option<PathBuf>,
    /// Bars after the paper's Fig. 8.
    #[arg(long, value_name = "FILE.svg")]
    pub svg: Option<PathBuf>,
    /// One JSON object on stdout instead of a table.
    #[arg(long)]
    pub json: bool,
}

/// What the command prints.
#[derive(Debug, Serialize)]
struct Answer {
    #[serde(flatten)]
    contrasts: Contrasts,
    /// Time of the calculation.
    seconds: f64,
    /// Beside the table of `--compare`.
    #[serde(skip_serializing_if = "Option::is_none")]
    comparison: Option<ReportedComparison>,
}

#[derive(Debug, Serialize)]
#[serde(untagged)]
enum Contrasts {
    Measured(Box<ContrastReport>),
    Predicted(Box<Prediction>),
}

#[derive(Debug, Serialize)]
struct Prediction {
    #[serde(flatten)]
    table: ReportedTable,
    /// `predicted`.
    mode: &'static str,
    variant: &'static str,
    /// Largest error of a radiance, as a share of the brightest; null where it was not determined.
    model_error: Option<Expected>,
    left_out: Vec<LeftOut>,
}

/// Options that do not apply to a measured contrast.
fn of_predictions(arg: clap::Arg) -> clap::Arg {
    let options = PredictionLimits::augment_args(Scene::augment_args(clap::Command::new("")));
    let mut predicted = options.get_arguments().map(clap::Arg::get_id);
    if arg.get_id() == "variant" || predicted.any(|id| id == arg.get_id()) {
        arg.conflicts_with("measured")
    } else {
        arg
    }
}

/// Runs the command.
///
/// # Errors
/// Bad input for options out of range, a folder that is not a series, or a file that is not a table; no result where the
/// series has no pose at the paper's azimuths or a file cannot be written.
pub fn run(args: Args) -> Result<(), CliError> {
    args.svg
        .as_deref()
        .map_or(Ok(()), output_path::check_file)?;
    if let (Some(svg), Some(compared)) = (&args.svg, &args.compare) {
        output_collision::not_the_input(svg, compared)?;
    }
    let started = Instant::now();
    let region = args.region.as_deref();
    let (table, contrasts) = match (&args.dir, args.scan) {
        (Some(dir), _) => {
            let series = Series::open_own(dir).map_err(CliError::bad_input)?;
            if let Some(svg) = &args.svg {
                output_collision::no_file_of_series(svg, &series)?;
            }
            measured(&series, region)?
        }
        (None, Some(scan)) => measured(&runtime::stored_series(&args.data, scan)?, region)?,
        (None, None) => {
            let (table, prediction) = predicted(&args)?;
            (table, Contrasts::Predicted(Box::new(prediction)))
        }
    };
    let seconds = started.elapsed().as_secs_f64();
    let (mut others, mut compared) = (Vec::new(), None);
    if let Some(path) = &args.compare {
        let other = compare::read_radiances(path, args.scene.alpha)?;
        compared = Some(compare::comparison(&table, &other, path)?);
        others.push(("compared", other));
    }
    if let Some(path) = &args.svg {
        let label = match &contrasts {
            Contrasts::Measured(_) => "measured",
            Contrasts::Predicted(_) => "predicted",
        };
        let mut series = vec![(label, &table)];
        series.extend(others.iter().map(|(name, t)| (*name, t)));
        std::fs::write(path, figure::bars(&series))
            .with_context(|| format!("cannot write {}", path.display()))
            .map_err(CliError::NoResult)?;
    }
    let answer = Answer {
        contrasts,
        seconds,
        comparison: compared.as_ref().map(TableComparison::report),
    };
    output::write(args.json, &answer, || {
        let mut text = match &answer.contrasts {
            Contrasts::Measured(report) => measured_text(&table, report),
            Contrasts::Predicted(found) => {
                predicted_text(&table) + &costly_omissions(&found.left_out)
            }
        };
        if let Some(comparison) = &compared {
            let _ = writeln!(text, "{comparison}");
        }
        text
    })
}

fn predicted(args: &Args) -> Result<(Table, Prediction), CliError> {
    let (rig, optics, surface) = args.scene.build(&args.theta_r_deg)?;
    args.limits.check(args.variant)?;
    let tilts = &args.scene.theta_c_deg;
    let predicted = |tier, ridges: &[f64], pace: &Pace<'_>| {
        predict_paced(tier, &rig, &optics, &surface, ridges, tilts, pace)
    };
    let watch = Stopwatch::start(args.limits.max_seconds);
    let in_time = || !watch.is_late();
    let pace = args.limits.pace(&in_time);
    let tier = args.variant.tier();
    let middle = args.theta_r_deg.len() / 2;
    args.limits
        .print_forecast(args.theta_r_deg.len() as u64, || {
            let one = args.theta_r_deg.get(middle).copied().unwrap_or_default();
            std::hint::black_box(predicted(tier, &[one], &pace.to_the_end()));
        });
    let found = predicted(tier, &args.theta_r_deg, &pace);
    if found.table.lines.is_empty() && !found.left.is_empty() {
        return Err(CliError::no_result(anyhow!(
            "no surface was finished within the time limit: allow more time"
        )));
    }
    // A closed form is compared with two integrated bounces, within the time limit.
    let apart = match args.variant {
        Model::Quadrature => None,
        Model::Paper | Model::Sawtooth => {
            let full = predicted(Tier::Quadrature, &args.theta_r_deg, &pace);
            (found.left.is_empty() && full.left.is_empty())
                .then(|| found.table.apart(&full.table))
                .flatten()
        }
    };
    let error = found.error.or(apart).map(|value| Expected {
        value,
        of: "a radiance, of the brightest".to_owned(),
    });
    let mut left_out = args.variant.left_out(
        &rig.cones,
        surface.alpha_u.min(surface.alpha_v),
        optics.k > 0.0,
        apart,
    );
    if !found.left.is_empty() {
        let ridges: Vec<String> = found.left.iter().map(f64::to_string).collect();
        left_out.push(LeftOut::new(
            format!("ridge angles {}", ridges.join(", ")),
            "time limit reached",
            None,
        ));
    }
    let prediction = Prediction {
        table: ReportedTable::predicted(&found.table),
        mode: "predicted",
        variant: args.variant.name(),
        model_error: error,
        left_out,
    };
    Ok((found.table, prediction))
}

fn measured(
    source: &dyn FrameSource,
    region: Option<&str>,
) -> Result<(Table, Contrasts), CliError> {
    let cancel = interrupt::flag()?;
    let set = reduced(source, region, &cancel)?;
    let (table, report) = measure(&set).map_err(CliError::no_result)?;
    Ok((table, Contrasts::Measured(Box::new(report))))
}

fn reduced(
    source: &dyn FrameSource,
    region: Option<&str>,
    cancel: &AtomicBool,
) -> Result<ObservationSet, CliError> {
    reduce(source, region, cancel).map_err(|error| match error {
        ReductionError::Cancelled => CliError::Interrupted,
        error @ (ReductionError::NoObservations { .. } | ReductionError::Vanished { .. }) => {
            CliError::no_result(error)
        }
        error => CliError::bad_input(error),
    })
}

const HEADING: &str =
    "θr / ° θc / °     L(0°)   L(90°)  L(180°)  |0–90| (Mich.) |90–180| (Mich.)\n";

fn predicted_text(table: &Table) -> String {
    let mut text = HEADING.to_owned();
    for line in &table.lines {
        let _ = writeln!(text, "{:6.2}{}", rounded_deg(line.theta_r), values(line));
    }
    means_text(&mut text, "θc", &table.by_theta_c);
    means_text(&mut text, "θr", &table.by_theta_r);
    means_text(&mut text, "φs", &table.by_phi_s);
    findings_text(&mut text, table);
    text
}

fn measured_text(table: &Table, report: &ContrastReport) -> String {
    let mut text = HEADING.to_owned();
    let expanded = |std: Option<f64>| match std {
        Some(std) if std.is_finite() => format!("{:.1e}", 2.0 * std),
        _ => "–".to_owned(),
    };
    for (line, reported) in table.lines.iter().zip(&report.table.lines) {
        let of = |contrast: &ReportedContrast| {
            let (absolute, michelson) = (contrast.absolute_std, contrast.michelson_std);
            format!("{:>7} {:>7}", expanded(absolute), expanded(michelson))
        };
        let [first, second] = [&reported.contrast.first, &reported.contrast.second].map(of);
        let _ = writeln!(
            text,
            "     –{}\n{:>42} {first}  {second}",
            values(line),
            "±"
        );
    }
    let unit = match report.scale {
        "white reference" => "sr⁻¹ (L is BRDF × cos θi)",
        _ => "shares of the brightest level",
    };
    let _ = writeln!(
        text,
        "L and |0–90|, |90–180| in {unit}, ± expanded uncertainties (k = 2); stray light {} ± {} subtracted",
        significant(report.stray_light.radiance),
        significant(2.0 * report.stray_light.std)
    );
    means_text(&mut text, "θc", &table.by_theta_c);
    means_text(&mut text, "φs", &table.by_phi_s);
    if let Some(all) = &report.table.mean.all {
        let of = &all.contrast;
        let _ = writeln!(
            text,
            "mean of all: {:.4} ± {} ({} ± {}; k = 2); `judge` uses this value, and takes the effect of stage errors on U from the fit",
            of.absolute,
            expanded(of.absolute_std),
            michelson(of.michelson),
            expanded(of.michelson_std),
        );
    }
    findings_text(&mut text, table);
    text
}

/// Tilt, radiances and contrasts of a line.
fn values(line: &Line) -> String {
    let [first, second] = line.contrast;
    format!(
        "{:7.2}  {:8.5} {:8.5} {:8.5} {:7.4} {:>7}  {:7.4} {:>7}",
        rounded_deg(line.theta_c),
        line.radiance[0],
        line.radiance[1],
        line.radiance[2],
        first.absolute,
        michelson(first.michelson),
        second.absolute,
        michelson(second.michelson)
    )
}

/// A Michelson contrast; a dash where both azimuths are dark.
fn michelson(value: f64) -> String {
    match value.is_nan() {
        true => "–".to_owned(),
        false => format!("{value:.3}"),
    }
}

fn means_text(text: &mut String, by: &str, means: &[Mean]) {
    let of = |mean: &Mean| {
        let contrast = &mean.contrast;
        format!(
            "{}°: {:.4} ({})",
            mean.setting,
            contrast.absolute,
            michelson(contrast.michelson)
        )
    };
    let list: Vec<String> = means.iter().map(of).collect();
    let _ = writeln!(text, "mean by {by}: {}", list.join("   "));
}

fn findings_text(text: &mut String, table: &Table) {
    if let Some(f) = table.findings() {
        let word = |b: bool| if b { "yes" } else { "no" };
        let _ = writeln!(
            text,
            "the paper's findings: greatest at θc = 0: {}; greatest at the smallest θr: {}; 0–90 above 90–180: {}",
            word(f.greatest_at_normal_tilt),
            word(f.greatest_at_smallest_ridge),
            word(f.first_quarter_stronger)
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::parsed;
    use crate::geometry::{Pose, RigGeometry};
    use crate::material::Material;
    use crate::observation::{Observation, Prior};

    #[test]
    fn the_defaults_are_the_papers_experiment_and_show_its_findings() {
        let (table, prediction) = predicted(&parsed(&[])).unwrap();
        let report = serde_json::to_value(&prediction).unwrap();
        assert_eq!(table.lines.len(), 20);
        assert_eq!(report["findings"]["greatest_at_theta_c_0"], true);
        assert_eq!(report["findings"]["greatest_at_smallest_theta_r"], true);
        assert_eq!(report["findings"]["0-90_above_90-180"], true);
        assert_eq!(report["lines"][0]["theta_r_deg"], 5.0);
        assert_eq!(report["mean"]["by_theta_c"][2]["theta_c_deg"], 0.0);
        assert_eq!(report["mean"]["by_phi_s"][0]["phi_s_deg"], "0-90");
        assert!(predicted_text(&table).lines().count() > 20);
    }

    #[test]
    fn a_costly_omission_is_stated_in_the_text() {
        let stated = |variant: &str| {
            let args = [
                "--variant",
                variant,
                "--theta-r-deg",
                "20",
                "--alpha",
                "0.1",
            ];
            let (_, prediction) = predicted(&parsed(&args)).unwrap();
            costly_omissions(&prediction.left_out)
        };
        let printed = stated("paper");
        assert!(
            printed.starts_with(
                "left out: risers, diffuse walls and light that bounces twice (effect ≤ "
            ) && printed.lines().count() == 1,
            "{printed}"
        );
        assert_eq!(stated("quadrature"), "");
    }

    #[test]
    fn the_mean_of_all_states_whose_value_and_uncertainty_judge_uses() {
        let poses = [(0.0, 0.3), (90.0, 0.1), (180.0, 0.2)];
        let observations = poses.map(|(phi_s_deg, signal)| {
            Observation::new(Pose::from_deg(0.0, phi_s_deg), signal, 0.001)
        });
        let set = ObservationSet::bare(
            RigGeometry::IN_PLANE,
            Material::exactly(1.54, 0.0),
            observations.to_vec(),
            Prior {
                mean: 0.0,
                std: 0.002,
            },
        );
        let (table, report) = measure(&set).unwrap();
        let text = measured_text(&table, &report);
        let line = text
            .lines()
            .find(|line| line.starts_with("mean of all: 0.15"));
        let line = line.unwrap();
        assert!(
            line.contains("`judge` uses this value") && line.contains("from the fit"),
            "{line}"
        );
    }

    #[test]
    fn options_out_of_range_are_named() {
        let refused = predicted(&parsed(&["--rho-d", "1.5"])).unwrap_err();
        let CliError::BadInput(e) = refused else {
            panic!("{refused:?}")
        };
        assert_eq!(
            e.to_string(),
            "--rho-d 1.5 is out of range: expected 0 to 1"
        );
        assert!(predicted(&parsed(&["--theta-r-deg", "5", "75"])).is_err());
    }
}
