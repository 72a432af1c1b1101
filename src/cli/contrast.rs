//! `ridged contrast`: the paper's contrast table, predicted for a rig or measured in a series.

mod compare;
mod figure;

use std::fmt::Write as _;
use std::path::PathBuf;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use anyhow::{Context, anyhow};
use clap::Args as _;
use serde_json::{Value, json};

use compare::TableComparison;

use super::limits::{PredictionLimits, Stopwatch};
use super::prediction::{Model, Scene};
use super::{CliError, interrupt, output, output_collision, output_path, runtime};
use crate::contrast::{ReportedTable, measure, rounded_deg};
use crate::forecast::Expected;
use crate::model::LeftOut;
use crate::model::contrast::{PAIRS, PAPER_RIDGES_DEG, Pace, Table, Tier, predict_paced};
use crate::observation::ObservationSet;
use crate::reduction::{FrameSource, ReductionError, reduce};
use crate::series::Series;
use crate::units::Angle;
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
    let (table, mut report) = match (&args.dir, args.scan) {
        (Some(dir), _) => {
            let series = Series::open_own(dir).map_err(CliError::bad_input)?;
            if let Some(svg) = &args.svg {
                output_collision::no_file_of_series(svg, &series)?;
            }
            measured(&series, region)?
        }
        (None, Some(scan)) => measured(&runtime::stored_series(&args.data, scan)?, region)?,
        (None, None) => predicted(&args)?,
    };
    report["seconds"] = json!(started.elapsed().as_secs_f64());
    let (mut others, mut compared) = (Vec::new(), None);
    if let Some(path) = &args.compare {
        let other = compare::read_radiances(path, args.scene.alpha)?;
        let found = compare::comparison(&table, &other, path)?;
        report["comparison"] = found.as_json();
        compared = Some(found);
        others.push(("compared", other));
    }
    if let Some(path) = &args.svg {
        let label = if args.dir.is_some() || args.scan.is_some() {
            "measured"
        } else {
            "predicted"
        };
        let mut series = vec![(label, &table)];
        series.extend(others.iter().map(|(name, t)| (*name, t)));
        std::fs::write(path, figure::bars(&series))
            .with_context(|| format!("cannot write {}", path.display()))
            .map_err(CliError::NoResult)?;
    }
    output::write(args.json, &report, || {
        as_text(&table, &report, compared.as_ref())
    })
}

fn predicted(args: &Args) -> Result<(Table, Value), CliError> {
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
    let mut report = json!(ReportedTable::predicted(&found.table));
    report["mode"] = json!("predicted");
    report["variant"] = json!(args.variant.name());
    let error = found.error.or(apart).map(|value| Expected {
        value,
        of: "a radiance, of the brightest".to_owned(),
    });
    report["model_error"] = json!(error);
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
    report["left_out"] = json!(left_out);
    Ok((found.table, report))
}

fn measured(source: &dyn FrameSource, region: Option<&str>) -> Result<(Table, Value), CliError> {
    let cancel = interrupt::flag()?;
    let set = reduced(source, region, &cancel)?;
    let (table, report) = measure(&set).map_err(CliError::no_result)?;
    Ok((table, json!(report)))
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

fn as_text(table: &Table, report: &Value, compared: Option<&TableComparison>) -> String {
    let mut text = String::new();
    let predicted = report["mode"] == "predicted";
    let ridge = |a: Angle| {
        if predicted {
            format!("{:6.2}", rounded_deg(a))
        } else {
            "     –".to_owned()
        }
    };
    let _ = writeln!(
        text,
        "θr / ° θc / °     L(0°)   L(90°)  L(180°)  |0–90| (Mich.) |90–180| (Mich.)"
    );
    let michelson = |m: f64| match m.is_nan() {
        true => "–".to_owned(),
        false => format!("{m:.3}"),
    };
    for (n, l) in table.lines.iter().enumerate() {
        let [a, b] = l.contrast;
        let _ = write!(
            text,
            "{}{:7.2}  {:8.5} {:8.5} {:8.5} {:7.4} {:>7}  {:7.4} {:>7}",
            ridge(l.theta_r),
            rounded_deg(l.theta_c),
            l.radiance[0],
            l.radiance[1],
            l.radiance[2],
            a.absolute,
            michelson(a.michelson),
            b.absolute,
            michelson(b.michelson)
        );
        if !predicted {
            let std = |pair: usize, key: &str| {
                let std = &report["lines"][n]["contrast"][PAIRS[pair].0][key];
                std.as_f64()
                    .map_or("–".to_owned(), |std| format!("{:.1e}", 2.0 * std))
            };
            let _ = write!(
                text,
                "\n{:>42} {:>7} {:>7}  {:>7} {:>7}",
                "±",
                std(0, "absolute_std"),
                std(0, "michelson_std"),
                std(1, "absolute_std"),
                std(1, "michelson_std")
            );
        }
        text.push('\n');
    }
    if !predicted {
        let unit = match report["scale"] == "white reference" {
            true => "sr⁻¹ (L is BRDF × cos θi)",
            false => "shares of the brightest level",
        };
        let of = |key: &str| report["stray_light"][key].as_f64().unwrap_or(f64::NAN);
        let _ = writeln!(
            text,
            "L and |0–90|, |90–180| in {unit}, ± expanded uncertainties (k = 2); stray light {} ± {} subtracted",
            significant(of("radiance")),
            significant(2.0 * of("std"))
        );
    }
    let mut means = vec![("θc", &table.by_theta_c), ("φs", &table.by_phi_s)];
    if predicted {
        means.insert(1, ("θr", &table.by_theta_r));
    }
    for (name, means) in means {
        let list: Vec<String> = means
            .iter()
            .map(|m| {
                format!(
                    "{}°: {:.4} ({})",
                    m.setting,
                    m.contrast.absolute,
                    michelson(m.contrast.michelson)
                )
            })
            .collect();
        let _ = writeln!(text, "mean by {name}: {}", list.join("   "));
    }
    if !predicted {
        let all = &report["mean"]["all"];
        let of = |key: &str| all[key].as_f64().unwrap_or(f64::NAN);
        let _ = writeln!(
            text,
            "mean of all: {:.4} ± {:.1e} ({} ± {:.1e}; k = 2), as `judge` uses it",
            of("absolute"),
            2.0 * of("absolute_std"),
            michelson(of("michelson")),
            2.0 * of("michelson_std"),
        );
    }
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
    if let Some(comparison) = compared {
        let _ = writeln!(text, "{comparison}");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::parsed;

    #[test]
    fn the_defaults_are_the_papers_experiment_and_show_its_findings() {
        let (table, report) = predicted(&parsed(&[])).unwrap();
        assert_eq!(table.lines.len(), 20);
        assert_eq!(report["findings"]["greatest_at_theta_c_0"], true);
        assert_eq!(report["findings"]["greatest_at_smallest_theta_r"], true);
        assert_eq!(report["findings"]["0-90_above_90-180"], true);
        assert_eq!(report["lines"][0]["theta_r_deg"], 5.0);
        assert_eq!(report["mean"]["by_theta_c"][2]["theta_c_deg"], 0.0);
        assert_eq!(report["mean"]["by_phi_s"][0]["phi_s_deg"], "0-90");
        assert!(as_text(&table, &report, None).lines().count() > 20);
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
