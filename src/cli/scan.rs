//! `ridged scan`: runs one scan, by a running daemon or in this process.

use std::path::PathBuf;

use anyhow::{Context, anyhow};
use serde_json::{Value, json};

use super::CliError;
use super::client::{Client, ConnectionArgs};
use super::{output, runtime};
use crate::lab::{NameOrId, ScanRequest};
use crate::material::{Material, tables};
use crate::scan::PlanRequest;
use crate::scan::event::UncertainValue;
use crate::scan::plan::Preset;
use crate::scan::runner::RunEnd;
use crate::store::samples::AmbiguousPart;
use crate::wording::{factor, names};

mod by_daemon;
mod by_itself;
mod estimate;
mod order;
mod record;

pub(super) use by_daemon::followed;
pub use by_itself::follow;

/// What to do with a running or an earlier scan.
#[derive(Debug, clap::Subcommand)]
pub enum Action {
    /// An order to a running scan.
    #[command(flatten)]
    Order(order::Order),
    /// A change of the record of a scan.
    #[command(flatten)]
    Record(record::Change),
}

/// Runs one scan, orders a running one, or changes the record of an earlier one.
#[derive(Debug, clap::Args)]
#[command(args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
#[command(after_help = "Examples:
  ridged scan --preset paper --simulated-rig --data /tmp/try
  ridged scan --preset full --calibrate --config rig.toml
  ridged scan docs/examples/plan.toml --config rig.toml --sample \"batch 7\"
  ridged scan --recipe PX-1204 --specification \"drawing 4711\" --sample \"Panel B-17\" --lot 4
  ridged scan docs/examples/plan.toml --config rig.toml --estimate
  ridged scan pause 12
  ridged scan tag 12 --add study-1
If a daemon is running on the data folder, it does the scan.")]
pub struct Args {
    /// What to do with a running or an earlier scan instead.
    #[command(subcommand)]
    pub action: Option<Action>,
    /// Plan (TOML); docs/examples/plan.toml shows all keys.
    #[arg(
        value_name = "PLAN.toml",
        required_unless_present_any = ["preset", "recipe"],
        conflicts_with_all = ["preset", "recipe"]
    )]
    pub plan: Option<PathBuf>,
    /// A named plan instead of a file.
    #[arg(long, value_parser = preset, value_name = "paper|full")]
    pub preset: Option<Preset>,
    /// A recipe of the store by name or number, instead of a plan: the fit that follows uses its model and options.
    #[arg(long, value_name = "NAME", conflicts_with_all = ["preset", "calibrate"])]
    pub recipe: Option<String>,
    /// A specification of the store by name or number: the scan is judged against it once it is fitted.
    #[arg(long, value_name = "NAME", conflicts_with = "calibrate")]
    pub specification: Option<String>,
    /// The person at the rig.
    #[arg(long, value_name = "NAME")]
    pub operator: Option<String>,
    /// Lot of the part.
    #[arg(long, value_name = "LOT")]
    pub lot: Option<String>,
    /// Number of the part or order in another system.
    #[arg(long, value_name = "ID")]
    pub external_id: Option<String>,
    /// Take only new dark and white-reference frames for the plan. Later scans reuse them and ask only for the part.
    #[arg(long)]
    pub calibrate: bool,
    /// Name of the part [default: that of the last scan of this rig].
    #[arg(long, value_name = "NAME")]
    pub sample: Option<String>,
    /// Number of the part, where several have its name.
    #[arg(long, value_name = "ID", conflicts_with_all = ["sample", "eta", "metal"])]
    pub sample_id: Option<u32>,
    /// Index of refraction; adds the part if it does not exist yet.
    #[arg(long, value_name = "N", requires = "sample")]
    pub eta: Option<f64>,
    /// Imaginary part of the index, for metals.
    #[arg(long, value_name = "K", requires = "eta")]
    pub k: Option<f64>,
    /// A metal by name (Ag, Al, Au, Cr, Cu, W) instead of its index.
    #[arg(long, value_name = "NAME", requires = "sample", conflicts_with = "eta")]
    pub metal: Option<String>,
    /// Wavelength at which the metal is looked up, in nm.
    #[arg(long, value_name = "NM", default_value_t = 550.0, requires = "metal")]
    pub wavelength_nm: f64,
    /// Data folder.
    #[arg(long, value_name = "DIR", default_value = "ridged-data", global = true)]
    pub data: PathBuf,
    /// Settings of the rig (TOML), if no daemon is running.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Scan on a simulated rig, if no daemon is running.
    #[arg(long)]
    pub simulated_rig: bool,
    /// How many times faster than real time the simulated rig runs.
    #[arg(
        long,
        value_name = "X",
        default_value_t = 1.0,
        requires = "simulated_rig"
    )]
    pub time_scale: f64,
    /// Print points, time, disk space and operator steps of the scan, and what would prevent it. Nothing moves.
    #[arg(long, conflicts_with_all = ["eta", "metal", "calibrate", "timing"])]
    pub estimate: bool,
    /// Print how much longer the scan took than the ideal motion, settling and exposure of its plan.
    #[arg(long)]
    pub timing: bool,
    /// One JSON object on stdout.
    #[arg(long, global = true)]
    pub json: bool,
    /// Address, token and lease, for a running daemon.
    #[command(flatten)]
    pub connection: ConnectionArgs,
}

fn preset(word: &str) -> Result<Preset, String> {
    match word {
        "paper" => Ok(Preset::Paper),
        "full" => Ok(Preset::Full),
        other => Err(format!("expected paper or full, got `{other}`")),
    }
}

/// Runs the command.
///
/// # Errors
/// Bad input for a plan that cannot run; no result where the rig refuses or pauses; interrupted on
/// Ctrl-C.
pub fn run(args: Args) -> Result<(), CliError> {
    if let Some(action) = &args.action {
        let client = Client::require(&args.data, &args.connection)?;
        return match action {
            Action::Order(order) => order::run(&client, order, args.json),
            Action::Record(change) => record::run(&client, change, args.json),
        };
    }
    let mut plan = read_plan(&args)?;
    if args.calibrate
        && let Some(plan) = &mut plan
    {
        plan.repeats = Some(0);
        plan.reuse_calibrations = None;
    }
    match Client::of(&args.data, &args.connection)? {
        Some(client) if args.estimate => by_daemon::estimate(&client, &args, plan),
        None if args.estimate => runtime::block_on(by_itself::estimate(&args, plan)),
        Some(client) => print(&args, &by_daemon::scan(&client, &args, plan)?),
        None => runtime::block_on(by_itself::scan(&args, plan)),
    }
}

/// Prints the end of a scan, and the verdicts on it.
fn print(args: &Args, answer: &Value) -> Result<(), CliError> {
    output::write(args.json, answer, || {
        let timing = match args.timing {
            true => timing_words(answer),
            false => String::new(),
        };
        format!(
            "scan {} {}\n{}{timing}",
            answer["id"],
            answer["state"].as_str().unwrap_or(""),
            verdict_words(&answer["verdicts"])
        )
    })
}

/// The request for the scan of a part.
fn request(args: &Args, sample_id: i64, plan: Option<PlanRequest>) -> ScanRequest {
    let by_name = |name: &Option<String>| name.clone().map(NameOrId::Name);
    ScanRequest {
        sample_id,
        plan,
        recipe: by_name(&args.recipe),
        specification: by_name(&args.specification),
        operator_name: args.operator.clone(),
        lot: args.lot.clone(),
        external_id: args.external_id.clone(),
    }
}

/// Verdicts in words: one line each, and below it what would decide.
fn verdict_words(verdicts: &Value) -> String {
    let mut text = String::new();
    for verdict in verdicts.as_array().into_iter().flatten() {
        let word = |key: &str| verdict[key].as_str().unwrap_or_default();
        let region = match verdict["region"].as_str() {
            Some(region) => format!(", region {region}"),
            None => String::new(),
        };
        let decided = word("verdict").replace('-', " ");
        text.push_str(&format!("{}{region}: {decided}\n", word("specification")));
        for (quantity, found) in verdict["would_decide"].as_object().into_iter().flatten() {
            let message = found["message"].as_str().unwrap_or_default();
            let name = names::known(quantity).map_or_else(|| quantity.clone(), |name| name.full());
            text.push_str(&format!("  {name}: {message}\n"));
        }
    }
    text
}

/// Reads the plan; none for a recipe, which states its own.
fn read_plan(args: &Args) -> Result<Option<PlanRequest>, CliError> {
    let Some(path) = &args.plan else {
        return Ok(match (args.preset, &args.recipe) {
            (None, Some(_)) => None,
            (preset, _) => Some(PlanRequest::preset(preset.unwrap_or(Preset::Paper))),
        });
    };
    let text = std::fs::read_to_string(path)
        .with_context(|| format!("the plan {} cannot be read", path.display()))
        .map_err(CliError::BadInput)?;
    let plan = PlanRequest::from_toml(&text);
    plan.map(Some)
        .map_err(|refused| CliError::bad_input(anyhow!("the plan {}, {refused}", path.display())))
}

/// Formats the scan time beside the ideal time.
pub fn timing_words(answer: &Value) -> String {
    match (answer["elapsed_s"].as_f64(), answer["ideal_s"].as_f64()) {
        (Some(elapsed), Some(ideal)) if ideal > 0.0 => format!(
            "scan time {elapsed:.1} s, ideal motion + settling + exposure {ideal:.1} s, ratio {:.3}\n",
            elapsed / ideal
        ),
        _ => {
            "the scan time beside the ideal is known only where this command runs the scan itself\n"
                .into()
        }
    }
}

/// Adds the times of a run to the JSON object.
pub fn with_times(mut answer: Value, end: Option<RunEnd>) -> Value {
    if let Some(end) = end {
        answer["elapsed_s"] = json!(end.elapsed_s);
        answer["ideal_s"] = json!(end.ideal_s);
        answer["time_over_ideal"] = match end.ideal_s > 0.0 {
            true => json!(end.elapsed_s / end.ideal_s),
            false => Value::Null,
        };
    }
    answer
}

/// Returns the material that the arguments state; the uncertainty of an index is that of a data sheet, one unit in the
/// second decimal.
///
/// # Errors
/// Bad input: a metal that is not in the tables, or not at that wavelength.
fn material(args: &Args) -> Result<Option<Material>, CliError> {
    const STD: f64 = 0.01;
    if let Some(name) = &args.metal {
        let metal = tables::metal(name, args.wavelength_nm).map_err(CliError::bad_input)?;
        return Ok(Some(metal));
    }
    Ok(args.eta.map(|eta| match args.k {
        None => Material::Dielectric { eta, eta_std: STD },
        Some(k) => Material::Conductor {
            eta,
            k,
            eta_std: STD,
            k_std: STD,
        },
    }))
}

/// Refuses a material that differs from that of the existing part, since it would be ignored.
///
/// # Errors
/// Bad input, with the part's own index.
fn suits_the_sample(args: &Args, kept: &Material) -> Result<(), CliError> {
    let Some(stated) = material(args)? else {
        return Ok(());
    };
    let (n, k) = kept.index();
    if stated.index() == (n, k) {
        return Ok(());
    }
    let kept = match k == 0.0 {
        true => format!("{n}"),
        false => format!("{n} + {k}i"),
    };
    Err(CliError::bad_input(anyhow!(
        "part `{}` exists with index {kept}: leave out the material, or give another name with --sample",
        args.sample.as_deref().unwrap_or_default()
    )))
}

/// The error where several parts have the name of `--sample`.
fn ambiguous(several: &AmbiguousPart) -> CliError {
    CliError::bad_input(anyhow!("{several}; give one with --sample-id"))
}

pub(super) fn no_sample(wanted: Option<&str>) -> CliError {
    CliError::bad_input(match wanted {
        Some(name) => {
            anyhow!("there is no part `{name}`; add it on the page or by POST /api/v1/samples")
        }
        None => anyhow!(
            "which part is on the rig? Name it with --sample NAME; --eta N or --metal NAME adds a new one"
        ),
    })
}

/// Formats the ridge angle during the scan, with its expanded uncertainty and the rig's time.
fn sure_words(of: UncertainValue, elapsed_s: f64) -> String {
    let (value_deg, expanded) = (of.value, of.coverage_factor * of.std);
    let k = factor(of.coverage_factor);
    // Two digits of the uncertainty.
    let digits = (1.0 - expanded.log10().floor()).clamp(0.0, 6.0) as usize;
    let minutes = elapsed_s / 60.0;
    format!("θr {value_deg:.digits$} ± {expanded:.digits$}° (k = {k}) at {minutes:.1} min")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_material_that_differs_from_the_samples_is_refused() {
        let args = |options: &[&str]| -> Args {
            let always = ["--preset", "paper", "--sample", "batch 7"];
            crate::cli::parsed(&[&always[..], options].concat())
        };
        let kept = material(&args(&["--eta", "1.5"])).unwrap().unwrap();
        suits_the_sample(&args(&["--eta", "1.5"]), &kept).unwrap();
        suits_the_sample(&args(&[]), &kept).unwrap();
        for other in [&["--eta", "1.6"][..], &["--metal", "Cr"]] {
            let Err(CliError::BadInput(refused)) = suits_the_sample(&args(other), &kept) else {
                panic!("{other:?} is passed over");
            };
            let words = refused.to_string();
            assert!(words.contains("with index 1.5"), "{words}");
        }
        let idle = ["--preset", "paper", "--wavelength-nm", "600"];
        assert!(crate::cli::try_parsed::<Args>(&idle).is_err());
    }

    #[test]
    fn the_ridge_angle_during_a_scan_has_two_digits_of_its_uncertainty() {
        let of = |std, coverage_factor| UncertainValue {
            value: 10.0312,
            std,
            coverage_factor,
        };
        assert_eq!(
            sure_words(of(0.041, 2.0), 330.0),
            "θr 10.031 ± 0.082° (k = 2) at 5.5 min"
        );
        assert_eq!(
            sure_words(of(6.0, 3.0), 60.0),
            "θr 10 ± 18° (k = 3) at 1.0 min"
        );
    }
}
