//! `ridged optimize`: the micro-structure of greatest contrast on a rig, and the width of the optimum.

use anyhow::anyhow;
use serde::Deserialize;
use serde_json::{Value, json};

use super::limits::{PredictionLimits, Stopwatch};
use super::prediction::{Model, Scene, costly_omissions};
use super::{CliError, output};
use crate::forecast::Expected;
use crate::model::LeftOut;
use crate::model::Surface;
use crate::model::contrast::{Tier, predict_paced};
use crate::model::optimum::{Search, optimise, tables_of};
use crate::wording::counted;

/// Finds the ridge angle (and the roughness within bounds) of greatest mean contrast on a rig.
///
/// Contrast is the mean of |L(0°) − L(90°)| and |L(90°) − L(180°)| over the given tilts.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  ridged optimize --theta-c-deg 0\n  \
    ridged optimize --alpha-min 0.04 --alpha-max 0.2 --json")]
pub struct Args {
    /// Smallest ridge angle that can be made.
    #[arg(long, default_value_t = 1.0, value_name = "DEG")]
    pub theta_r_min_deg: f64,
    /// Largest ridge angle that can be made.
    #[arg(long, default_value_t = 30.0, value_name = "DEG")]
    pub theta_r_max_deg: f64,
    /// Smallest roughness that can be made (together with --alpha-max; without both, --alpha holds).
    #[arg(long, value_name = "ALPHA", requires = "alpha_max",
          conflicts_with_all = ["alpha", "alpha_u", "alpha_v"])]
    pub alpha_min: Option<f64>,
    /// Largest roughness that can be made.
    #[arg(long, value_name = "ALPHA", requires = "alpha_min")]
    pub alpha_max: Option<f64>,
    /// Rig and other parameters of the surface.
    #[command(flatten)]
    pub scene: Scene,
    /// How the radiances are computed.
    #[arg(long, value_enum, default_value_t = Model::Sawtooth)]
    pub variant: Model,
    /// Limits of time and error.
    #[command(flatten)]
    pub limits: PredictionLimits,
    /// One JSON object on stdout instead of sentences.
    #[arg(long)]
    pub json: bool,
}

/// Runs the command.
///
/// # Errors
/// Bad input for options out of range or bounds that are not in order.
pub fn run(args: Args) -> Result<(), CliError> {
    let report = report(&args)?;
    output::write(args.json, &report, || text(&report))
}

/// Formats the report as text.
fn text(report: &Value) -> String {
    let number = |key: &str| report[key].as_f64().unwrap_or(f64::NAN);
    let range = |key: &str| {
        let at = |j: usize| report[key][j].as_f64();
        match (at(0), at(1)) {
            (Some(low), Some(high)) => format!("{low:.2}° to {high:.2}°"),
            _ => "(time limit reached)".to_owned(),
        }
    };
    let bound = |key: &str, what: &str| {
        if report[key] == true {
            format!("\nThe optimum is at a bound of {what}: a wider bound may give more.")
        } else {
            String::new()
        }
    };
    let stopped = match report["complete"] == false {
        true => format!(
            "\nThe time limit ended the search: this is the best of {}. Allow more time with --max-seconds.",
            counted(report["tables"].as_u64().unwrap_or(0) as usize, "table")
        ),
        false => String::new(),
    };
    format!(
        "greatest mean contrast {:.5} sr⁻¹ (Michelson {:.3}) at θr = {:.3}°, α = {:.4}\n\
             above 99 % of it from {}, above 90 % from {}{}{}{stopped}\n{}",
        number("contrast"),
        number("michelson"),
        number("theta_r_deg"),
        number("alpha"),
        range("within_1_percent_deg"),
        range("within_10_percent_deg"),
        bound("at_theta_r_bound", "the ridge angle"),
        bound("at_alpha_bound", "the roughness"),
        costly_omissions(&Vec::<LeftOut>::deserialize(&report["left_out"]).unwrap_or_default()),
    )
}

fn report(args: &Args) -> Result<Value, CliError> {
    let theta_r_deg = [args.theta_r_min_deg, args.theta_r_max_deg];
    if !(theta_r_deg[0] >= 0.0 && theta_r_deg[0] < theta_r_deg[1] && theta_r_deg[1] <= 60.0) {
        return Err(CliError::bad_input(anyhow!(
            "the ridge angle's bounds {} and {} degrees are not in order within 0 and 60",
            theta_r_deg[0],
            theta_r_deg[1]
        )));
    }
    let (rig, optics, surface) = args.scene.build(&theta_r_deg)?;
    let alpha = match (args.alpha_min, args.alpha_max) {
        (Some(low), Some(high)) if low >= 1e-3 && low < high && high <= 1.0 => [low, high],
        (Some(low), Some(high)) => {
            return Err(CliError::bad_input(anyhow!(
                "the roughness's bounds {low} and {high} are not in order within 0.001 and 1"
            )));
        }
        _ if surface.alpha_u != surface.alpha_v => {
            return Err(CliError::bad_input(anyhow!(
                "optimize uses one roughness for both axes: give --alpha instead of --alpha-u, --alpha-v"
            )));
        }
        _ => [surface.alpha_u; 2],
    };
    let search = Search {
        theta_r_deg,
        alpha,
        tilts_deg: args.scene.theta_c_deg.clone(),
    };
    args.limits.check(args.variant)?;
    let tier = args.variant.tier();
    let watch = Stopwatch::start(args.limits.max_seconds);
    let in_time = || !watch.is_late();
    let pace = args.limits.pace(&in_time);
    let table = |tier, theta_r_deg: f64, alpha: f64| {
        let surface = Surface {
            alpha_u: alpha,
            alpha_v: alpha,
            ..surface
        };
        let all = pace.to_the_end();
        let tilts = &search.tilts_deg;
        predict_paced(tier, &rig, &optics, &surface, &[theta_r_deg], tilts, &all)
    };
    args.limits.print_forecast(tables_of(&search), || {
        let middle = 0.5 * (theta_r_deg[0] + theta_r_deg[1]);
        let alpha = (search.alpha[0] * search.alpha[1]).sqrt();
        std::hint::black_box(table(tier, middle, alpha));
    });
    let best = optimise(tier, &rig, &optics, &surface, &search, &pace);
    // The integral at the optimum shows the error of the closed form.
    let apart = (tier != Tier::Quadrature).then(|| {
        let full = table(Tier::Quadrature, best.theta_r_deg, best.alpha).table;
        let closed = table(tier, best.theta_r_deg, best.alpha).table;
        let of_contrast = (full.mean_absolute() - best.contrast).abs() / best.contrast;
        (of_contrast, closed.apart(&full))
    });
    let error = best.error.or(apart.map(|(of_contrast, _)| of_contrast));
    let mut left_out = args.variant.left_out(
        &rig.cones,
        best.alpha,
        optics.k > 0.0,
        apart.and_then(|(_, of_radiance)| of_radiance),
    );
    if !best.complete {
        left_out.push(LeftOut::new(
            "the rest of the search",
            "time limit reached: ridge angle and roughness are the best of those tried",
            None,
        ));
    }
    let error = error.filter(|e| e.is_finite()).map(|value| Expected {
        value,
        of: "the contrast".to_owned(),
    });
    Ok(json!({
        "variant": args.variant.name(),
        "theta_r_deg": best.theta_r_deg,
        "alpha": best.alpha,
        "contrast": best.contrast,
        "michelson": best.michelson,
        "within_1_percent_deg": best.within_1_percent_deg,
        "within_10_percent_deg": best.within_10_percent_deg,
        "at_theta_r_bound": best.at_theta_r_bound,
        "at_alpha_bound": best.at_alpha_bound,
        "theta_c_deg": args.scene.theta_c_deg,
        "theta_r_resolution_deg": best.theta_r_resolution_deg,
        "error": error,
        "complete": best.complete,
        "tables": best.tables,
        "seconds": watch.seconds(),
        "left_out": left_out,
        "program": concat!("ridged ", env!("CARGO_PKG_VERSION")),
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::parsed;

    #[test]
    fn a_vertical_camera_wants_the_ridge_that_sends_light_straight_up() {
        let report = report(&parsed(&["--theta-c-deg", "0"])).unwrap();
        // Lamp 10° beside the camera, facets that lean to it by half of that: the paper's 5°.
        let best = report["theta_r_deg"].as_f64().unwrap();
        assert!((best - 5.0).abs() < 0.5, "{report}");
        assert_eq!(report["at_theta_r_bound"], false);
    }

    #[test]
    fn a_costly_omission_is_stated_in_the_text() {
        let args = ["--variant", "paper", "--theta-r-min-deg", "15"];
        let mut report = report(&parsed(&args)).unwrap();
        assert!(text(&report).contains("\nleft out: risers, "), "{report}");
        report["left_out"] = json!([LeftOut::new("a thing", "a reason", Some(1e-3))]);
        assert!(!text(&report).contains("left out"));
    }

    #[test]
    fn bounds_out_of_order_are_refused() {
        assert!(
            report(&parsed(&[
                "--theta-r-min-deg",
                "20",
                "--theta-r-max-deg",
                "10"
            ]))
            .is_err()
        );
        assert!(report(&parsed(&["--alpha-min", "0.3", "--alpha-max", "0.1"])).is_err());
        assert!(report(&parsed(&["--alpha-u", "0.3"])).is_err());
        // One roughness or its bounds: an option that would be ignored is refused.
        let both = [
            "--alpha",
            "0.1",
            "--alpha-min",
            "0.04",
            "--alpha-max",
            "0.2",
        ];
        assert!(crate::cli::try_parsed::<Args>(&both).is_err());
    }
}
