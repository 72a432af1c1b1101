//! `ridged explain`: what would be computed, what is left out, why, and what that may cost.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::time::Instant;

use anyhow::{Context, anyhow};
use serde::Serialize;

use super::{CliError, limits};
use crate::accuracy::forecast::of_series as of_series_forecast;
use crate::accuracy::map_forecast::of_map as of_map_forecast;
use crate::accuracy::plan_check::{PlanCheck, of_scene as of_scene_proof};
use crate::accuracy::trace_forecast::{Patience, TraceExtent, of_run};
use crate::forecast::Forecast;
use crate::map;
use crate::material::Material;
use crate::model::LeftOut;
use crate::plan::{self, Basis, ComputationPlan, Decision};
use crate::reduction::{self, ReductionError};
use crate::series::Series;
use crate::trace::scene::Scene;
use crate::wording::{counted, percent};

/// Prints the plan of a scene or a recorded series without computing it.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  ridged explain scene.toml\n  ridged explain scene.toml --prove\n  ridged explain tests/data/series/steel-15 --tolerance 0.001 --json\n  ridged explain tests/data/series/checker --map --tolerance 0.01"
)]
pub struct Args {
    /// A scene of `ridged trace`, or the folder of a recorded series.
    #[arg(value_name = "SCENE.toml | DIR")]
    pub input: PathBuf,
    /// Largest relative error that each simplification may cause.
    #[arg(long, value_name = "E", default_value_t = plan::TOLERANCE)]
    pub tolerance: f64,
    /// Plan for Mueller matrices by direction (as `ridged trace --out` needs them) instead of energies.
    #[arg(long)]
    pub mueller: bool,
    /// Plan the map of a series (`ridged map --tolerance E`) instead of its fit.
    #[arg(long, conflicts_with_all = ["mueller", "prove"])]
    pub map: bool,
    /// Compute a scene both in full and as planned, and compare results and times.
    #[arg(long, conflicts_with = "mueller")]
    pub prove: bool,
    /// One JSON object on stdout instead of text.
    #[arg(long)]
    pub json: bool,
}

#[derive(Serialize)]
struct Explanation {
    input: &'static str,
    computes: Vec<String>,
    #[serde(flatten)]
    plan: ComputationPlan,
    left_out: Vec<LeftOut>,
    /// Seconds of the planning.
    seconds: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    forecast: Option<Forecast>,
    #[serde(skip_serializing_if = "Option::is_none")]
    proof: Option<PlanCheck>,
    program: String,
}

/// Runs the command.
///
/// # Errors
/// Bad input for an input that is neither a scene nor a series; no result where stdout cannot be written; interrupted by
/// Ctrl-C.
pub fn run(args: Args) -> Result<(), CliError> {
    limits::check_tolerance(Some(args.tolerance))?;
    if args.prove && args.input.is_dir() {
        return Err(CliError::bad_input(anyhow!(
            "--prove applies only to scenes; `ridged accuracy` tests the plans of recorded series of known truth"
        )));
    }
    if args.mueller && args.input.is_dir() {
        return Err(CliError::bad_input(anyhow!(
            "--mueller applies only to scenes; {} is a folder",
            args.input.display()
        )));
    }
    if args.map && !args.input.is_dir() {
        return Err(CliError::bad_input(anyhow!(
            "--map applies only to recorded series; {} is not a folder of one",
            args.input.display()
        )));
    }
    let explanation = if args.map {
        of_map(&args.input, args.tolerance)?
    } else if args.input.is_dir() {
        of_series(&args.input, args.tolerance)?
    } else {
        of_scene(&args)?
    };
    // An interrupted forecast is not used.
    if super::interrupt::flag()?.load(Ordering::Relaxed) {
        return Err(CliError::Interrupted);
    }
    let mut text = Vec::new();
    print(&explanation, &mut text).map_err(CliError::no_result)?;
    super::output::write(args.json, &explanation, || {
        String::from_utf8_lossy(&text).into_owned()
    })
}

fn program() -> String {
    format!("ridged {}", env!("CARGO_PKG_VERSION"))
}

/// Refuses a series of which neither a fit nor a map can be made.
fn reducible(series: &Series) -> Result<(), CliError> {
    reduction::check(series).map_err(|reason| match reason {
        ReductionError::NoObservations { .. } => CliError::no_result(reason),
        _ => CliError::bad_input(reason),
    })
}

fn of_series(folder: &Path, tolerance: f64) -> Result<Explanation, CliError> {
    let started = Instant::now();
    let series = Series::open_own(folder).map_err(CliError::bad_input)?;
    reducible(&series)?;
    let mut plan = plan::series::plan(series.manifest(), series.rows(), tolerance);
    leave_to_the_data(&mut plan, &series.manifest().material());
    let frames = series.rows().len();
    let cancel = super::interrupt::flag()?;
    Ok(Explanation {
        input: "series",
        computes: vec![
            format!(
                "reduction of {} to one observation per pose",
                counted(frames, "frame")
            ),
            "variants paper and sawtooth fitted to all of them".to_owned(),
            "double reflections by quadrature at the fitted values, and a refit".to_owned(),
        ],
        left_out: plan.omissions(),
        plan,
        seconds: started.elapsed().as_secs_f64(),
        forecast: of_series_forecast(&series, &cancel),
        proof: None,
        program: program(),
    })
}

/// Before frames are read it is unknown whether double reflections on plastic were polarised; a fit tries both.
fn leave_to_the_data(plan: &mut ComputationPlan, material: &Material) {
    let plastic = matches!(material, Material::Dielectric { .. });
    let polarisation = |d: Decision| plastic && d == Decision::Polarisation;
    for choice in &mut plan.decisions {
        if polarisation(choice.decision) && choice.included {
            choice.why.push_str(
                ", unless the unpolarised model fits the data better (frames of a renderer without polarisation); the fit then \
                lists it as left out",
            );
        }
    }
}

fn of_map(folder: &Path, tolerance: f64) -> Result<Explanation, CliError> {
    let started = Instant::now();
    let series = Series::open_own(folder).map_err(CliError::bad_input)?;
    reducible(&series)?;
    let plan = map::plan::plan(&series, Some(tolerance));
    let camera = &series.manifest().camera;
    let seconds = started.elapsed().as_secs_f64();
    let cancel = super::interrupt::flag()?;
    let options = map::MapOptions {
        target_error: Some(tolerance),
        ..map::MapOptions::default()
    };
    Ok(Explanation {
        input: "map",
        computes: vec![
            format!(
                "{} × {} pixels, resampled from {} frames into the sample's frame",
                camera.width_px,
                camera.height_px,
                series.rows().len()
            ),
            "gain, stray light and the tilt's zero from a sample of pixels; this decision is repeated on their surfaces"
                .to_owned(),
            "variant sawtooth fitted to every pixel with a lobe".to_owned(),
        ],
        left_out: plan.omissions(),
        plan,
        seconds,
        forecast: of_map_forecast(&series, &options, &cancel),
        proof: None,
        program: program(),
    })
}

fn of_scene(args: &Args) -> Result<Explanation, CliError> {
    let started = Instant::now();
    let text = super::trace::scene_text(&args.input)?;
    let scene = Scene::parse(&text)
        .with_context(|| args.input.display().to_string())
        .map_err(CliError::bad_input)?;
    let mut prepared = super::trace::ready(&args.input, &scene)?;
    let wish = plan::scene::TracePlanRequest {
        mueller: args.mueller,
        tolerance: args.tolerance,
        photons: None,
    };
    let plan = plan::scene::plan(&scene, &prepared, &wish);
    plan::scene::apply(&plan, &scene, &mut prepared);
    let seconds = started.elapsed().as_secs_f64();
    let kind = if prepared.polarised {
        "polarised"
    } else {
        "scalar"
    };
    let cancel = super::interrupt::flag()?;
    let patience = Patience::usual(None, &cancel);
    let proof = match args.prove {
        true => Some(proved(args, &scene, &plan)?),
        false => None,
    };
    Ok(Explanation {
        input: "scene",
        computes: vec![format!(
            "{}, {kind}, through {}",
            counted(prepared.photons as usize, "photon"),
            counted(scene.interface.len(), "interface")
        )],
        forecast: of_run(&prepared, TraceExtent::ALL, patience),
        proof,
        left_out: prepared.left_out.clone(),
        seconds,
        plan,
        program: program(),
    })
}

/// Compares the plan with the full computation.
fn proved(args: &Args, scene: &Scene, plan: &ComputationPlan) -> Result<PlanCheck, CliError> {
    let cancel = super::interrupt::flag()?;
    let name = args.input.display().to_string();
    let ready = |s: &Scene| super::trace::ready(&args.input, s).ok();
    of_scene_proof(&name, scene, &ready, args.tolerance, Some(plan), &cancel)
        .ok_or(CliError::Interrupted)
}

fn print(e: &Explanation, out: &mut dyn Write) -> std::io::Result<()> {
    writeln!(out, "computes")?;
    for line in &e.computes {
        writeln!(out, "  {line}")?;
    }
    if let Some(forecast) = &e.forecast {
        writeln!(out, "  {forecast}")?;
    }
    writeln!(
        out,
        "plan at a tolerance of {} % of the {}",
        (1e11 * e.plan.tolerance).round() / 1e9,
        e.plan.quantity
    )?;
    for choice in &e.plan.decisions {
        let verdict = if choice.included { "in " } else { "out" };
        writeln!(
            out,
            "  {verdict} {:<20} {}",
            choice.decision.words(),
            choice.what
        )?;
        writeln!(out, "{:27}{}", "", choice.why)?;
        if let Some(cost) = choice.cost {
            let basis = match choice.basis {
                Basis::Exact => "exactly",
                Basis::Bound => "at most",
                Basis::Estimate => "about",
                Basis::Pilot => "by the pilot, at most",
            };
            let left = if choice.included {
                "omitting it would cause an error of"
            } else {
                "costs"
            };
            writeln!(out, "{:27}{left} {basis} {}", "", percent(cost))?;
        }
    }
    let beyond = e
        .plan
        .left_out()
        .filter(|choice| choice.cost.is_some_and(|cost| cost > e.plan.tolerance));
    for choice in beyond {
        writeln!(
            out,
            "beyond the tolerance: {}; a fit with the ray tracer includes it (--variant traced)",
            choice.what
        )?;
    }
    match &e.proof {
        Some(proof) => super::accuracy::print_proofs(std::slice::from_ref(proof), out),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn polarisation_on_plastic_is_planned_with_the_alternative_of_a_fit() {
        let of = |name: &str, tolerance: f64| {
            let folder = Path::new("tests/data/series").join(name);
            let explanation = of_series(&folder, tolerance).unwrap();
            let choice = explanation.plan.on(Decision::Polarisation).unwrap();
            (
                choice.included,
                choice.why.contains("unless the unpolarised model"),
            )
        };
        assert_eq!(of("paper-rig-full", 1e-3), (true, true));
        assert_eq!(of("paper-rig-full", 0.5), (false, false));
        assert_eq!(of("steel-15", 1e-3), (true, false));
    }
}
