//! `ridged contrast`: the paper's contrast table, predicted for a rig or measured in a series.

mod figure;

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use anyhow::{Context, anyhow};
use clap::{Args as _, ValueEnum};
use serde_json::{Value, json};

use super::limits::{PredictionLimits, Stopwatch};
use super::{CliError, answer, daemon, interrupt, place};
use crate::contrast::{as_json, findings_json, measure, rounded_deg};
use crate::forecast::Expected;
use crate::geometry::{Cones, RigGeometry};
use crate::limits::{self, Limit};
use crate::material::tables;
use crate::model::contrast::{
    Exposure, PAIRS, PAPER_RIDGES_DEG, PAPER_TILTS_DEG, Pace, Table, Tier, predict_paced,
};
use crate::model::{LeftOut, Optics, Surface, Variant, domain, left_out};
use crate::observation::ObservationSet;
use crate::reduction::{FrameSource, ReductionError, reduce};
use crate::series::Series;
use crate::units::Angle;

/// Contrast after rotation: absolute difference of radiances at azimuths 0°, 90° and 180°.
///
/// With a folder it is measured in that series, otherwise predicted for the rig and the surface that
/// the options describe; without options that is the paper's rig with narrow lobes.
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
    /// Region of a sample with a layout (measured).
    #[arg(long, requires = "measured")]
    pub region: Option<String>,
    /// Ridge angles to predict for.
    #[arg(long, num_args = 1.., value_name = "DEG", conflicts_with = "measured",
          default_values_t = PAPER_RIDGES_DEG)]
    pub theta_r_deg: Vec<f64>,
    /// The rig and the surface that is predicted.
    #[command(flatten)]
    pub scene: Scene,
    /// How the radiances are computed.
    #[arg(long, value_enum, default_value_t = Model::Sawtooth)]
    pub variant: Model,
    /// Time and error allowed of a prediction.
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

/// What a measured contrast has nowhere to put: the series says it, or nobody asks.
fn of_predictions(arg: clap::Arg) -> clap::Arg {
    let options = PredictionLimits::augment_args(Scene::augment_args(clap::Command::new("")));
    let mut predicted = options.get_arguments().map(clap::Arg::get_id);
    if arg.get_id() == "variant" || predicted.any(|id| id == arg.get_id()) {
        arg.conflicts_with("measured")
    } else {
        arg
    }
}

/// A rig and a surface given by options; the defaults are the paper's rig with narrow lobes.
#[derive(Debug, Clone, clap::Args)]
pub struct Scene {
    /// Camera tilts.
    #[arg(long, num_args = 1.., value_name = "DEG", allow_negative_numbers = true,
          default_values_t = PAPER_TILTS_DEG)]
    pub theta_c_deg: Vec<f64>,
    /// Roughness along and across the ridges.
    #[arg(long, default_value_t = 0.05)]
    pub alpha: f64,
    /// Roughness along the ridges, if it differs.
    #[arg(long)]
    pub alpha_u: Option<f64>,
    /// Roughness across the ridges, if it differs.
    #[arg(long)]
    pub alpha_v: Option<f64>,
    /// Diffuse reflectance [default: 0.35, and 0 of a metal].
    #[arg(long)]
    pub rho_d: Option<f64>,
    /// Real part of the index.
    #[arg(long, default_value_t = 1.54)]
    pub eta: f64,
    /// Imaginary part of the index.
    #[arg(long, default_value_t = 0.0)]
    pub k: f64,
    /// A metal of the tables (Ag, Al, Au, Cr, Cu, W) in place of its index.
    #[arg(long, value_name = "NAME", conflicts_with_all = ["eta", "k"])]
    pub metal: Option<String>,
    /// Wavelength at which the metal is looked up.
    #[arg(long, value_name = "NM", default_value_t = 550.0, requires = "metal")]
    pub wavelength_nm: f64,
    /// Angle between lamp and camera.
    #[arg(long, default_value_t = 10.0, value_name = "DEG")]
    pub theta_l_deg: f64,
    /// Azimuth of the lamp about the camera: 0 in the tilt plane, 90 beside it.
    #[arg(
        long,
        default_value_t = 90.0,
        value_name = "DEG",
        allow_negative_numbers = true
    )]
    pub light_azimuth_deg: f64,
    /// Azimuth of the lean direction at the recorded azimuth 0.
    #[arg(
        long,
        default_value_t = 90.0,
        value_name = "DEG",
        allow_negative_numbers = true
    )]
    pub azimuth_zero_deg: f64,
    /// Angular radius of the lamp.
    #[arg(long, default_value_t = 1.0, value_name = "DEG")]
    pub light_angular_radius_deg: f64,
    /// Angular radius of the lens's pupil, seen from the sample; 0 for a point.
    #[arg(long, default_value_t = 0.0, value_name = "DEG")]
    pub lens_angular_radius_deg: f64,
}

/// Tiers by the names of the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Model {
    /// The BRDF as printed.
    Paper,
    /// The sawtooth's closed form.
    Sawtooth,
    /// Two bounces integrated.
    Quadrature,
}

impl Model {
    /// The tier it names.
    #[must_use]
    pub fn tier(self) -> Tier {
        match self {
            Model::Paper => Tier::Closed(Variant::Paper),
            Model::Sawtooth => Tier::Closed(Variant::Sawtooth),
            Model::Quadrature => Tier::Quadrature,
        }
    }

    /// What its radiances do without on a rig of those cones, the lobes' narrower roughness being `alpha`; `apart` is how
    /// far they are from those with two bounces integrated, as a share of the brightest.
    #[must_use]
    pub fn left_out(
        self,
        cones: &Cones,
        alpha: f64,
        metal: bool,
        apart: Option<f64>,
    ) -> Vec<LeftOut> {
        let of = |variant| left_out::of_closed_form(variant, cones, alpha);
        let mut list = match self {
            Model::Paper => {
                let mut list = of(Variant::Paper);
                list.pop();
                list.push(left_out::printed_lobe(apart));
                list
            }
            Model::Sawtooth => {
                let mut list = of(Variant::Sawtooth);
                list.push(left_out::two_bounce_quadrature(apart));
                list
            }
            // It averages over the cones.
            Model::Quadrature => {
                let mut list: Vec<LeftOut> = left_out::lens(cones).into_iter().collect();
                list.extend([left_out::ideal_profile(), left_out::third_bounce()]);
                list
            }
        };
        if !metal && self != Model::Paper {
            list.push(left_out::polarisation(
                "on plastic predictions multiply unpolarised reflectances where light bounces twice, as many renderers \
                 do; single reflections do not depend on it",
            ));
        }
        list
    }

    /// Its name in JSON.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Model::Paper => "paper",
            Model::Sawtooth => "sawtooth",
            Model::Quadrature => "quadrature",
        }
    }
}

impl Scene {
    /// Checks the numbers, and that ridges of `theta_r_deg` (degrees) have a radiance with them; makes
    /// rig, optics and surface (ridge angle 0) of them.
    ///
    /// # Errors
    /// Bad input, naming the option and its range.
    pub fn build(&self, theta_r_deg: &[f64]) -> Result<(RigGeometry, Optics, Surface), CliError> {
        let alpha_u = self.alpha_u.unwrap_or(self.alpha);
        let alpha_v = self.alpha_v.unwrap_or(self.alpha);
        for (name, own, alpha) in [
            ("alpha_u", self.alpha_u, alpha_u),
            ("alpha_v", self.alpha_v, alpha_v),
        ] {
            let name = own.map_or(limits::ALPHA.name, |_| name);
            check(
                &Limit {
                    name,
                    ..limits::ALPHA
                },
                alpha,
            )?;
        }
        for (limit, value) in [
            (limits::PREDICTED_ETA, self.eta),
            (limits::PREDICTED_K, self.k),
            (limits::PREDICTED_THETA_L_DEG, self.theta_l_deg),
            (limits::LIGHT_AZIMUTH_DEG, self.light_azimuth_deg),
            (limits::AZIMUTH_ZERO_DEG, self.azimuth_zero_deg),
            (
                limits::PREDICTED_LIGHT_ANGULAR_RADIUS_DEG,
                self.light_angular_radius_deg,
            ),
            (
                limits::PREDICTED_LENS_ANGULAR_RADIUS_DEG,
                self.lens_angular_radius_deg,
            ),
        ] {
            check(&limit, value)?;
        }
        for &tilt in &self.theta_c_deg {
            check(&limits::THETA_C_DEG, tilt)?;
        }
        let rig = RigGeometry {
            theta_l: Angle::from_deg(self.theta_l_deg),
            light_azimuth: Angle::from_deg(self.light_azimuth_deg),
            azimuth_zero: Angle::from_deg(self.azimuth_zero_deg),
            cones: Cones {
                lamp: Angle::from_deg(self.light_angular_radius_deg),
                lens: Angle::from_deg(self.lens_angular_radius_deg),
            },
        };
        let (eta, k) = match &self.metal {
            Some(name) => tables::metal(name, self.wavelength_nm)
                .map_err(CliError::bad_input)?
                .index(),
            None => (self.eta, self.k),
        };
        let rho_d = self.rho_d.unwrap_or(if k > 0.0 { 0.0 } else { 0.35 });
        check(&limits::RHO_D, rho_d)?;
        let optics = Optics {
            eta,
            k,
            theta_l: rig.theta_l.rad(),
            cones: rig.cones,
        };
        let surface = Surface {
            theta_r: 0.0,
            alpha_u,
            alpha_v,
            rho_d,
            amplitude: 1.0,
        };
        for &ridge in theta_r_deg {
            check(&limits::THETA_R_DEG, ridge)?;
            let theta_r = ridge.to_radians();
            domain::check(&Surface { theta_r, ..surface }, &optics).map_err(CliError::bad_input)?;
        }
        Ok((rig, optics, surface))
    }
}

/// Refuses a number that an option of this limit may not have.
fn check(limit: &Limit, value: f64) -> Result<(), CliError> {
    let Limit { low, high, .. } = limit;
    if limit.holds(value) {
        return Ok(());
    }
    let option = limit.name.replace('_', "-");
    Err(CliError::bad_input(anyhow!(
        "--{option} = {value} is not within {low} and {high}"
    )))
}

/// Runs the command.
///
/// # Errors
/// Bad input for options out of range, a folder that is no series, a file that is no table; no
/// result where the series has no pose at the paper's azimuths or a file cannot be written.
pub fn run(args: Args) -> Result<(), CliError> {
    args.svg.as_deref().map_or(Ok(()), place::for_file)?;
    let started = Instant::now();
    let region = args.region.as_deref();
    if (args.dir.is_some() || args.scan.is_some()) && args.limits != PredictionLimits::default() {
        return Err(CliError::bad_input(anyhow!(
            "--max-seconds and --target-error are for predictions: a measured contrast has the error of its frames"
        )));
    }
    let (table, mut report) = match (&args.dir, args.scan) {
        (Some(dir), _) => {
            let series = Series::open(dir).map_err(CliError::bad_input)?;
            measured(&series, region)?
        }
        (None, Some(scan)) => measured(&daemon::stored_series(&args.data, scan)?, region)?,
        (None, None) => predicted(&args)?,
    };
    report["seconds"] = json!(started.elapsed().as_secs_f64());
    let mut others = Vec::new();
    if let Some(path) = &args.compare {
        let alpha = args.scene.alpha;
        let other = read_radiances(path, alpha)?;
        report["comparison"] = comparison(&table, &other, path);
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
    answer::put(args.json, &report, || as_text(&table, &report))
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
    args.limits.foretell(args.theta_r_deg.len() as u64, || {
        let one = args.theta_r_deg.get(middle).copied().unwrap_or_default();
        std::hint::black_box(predicted(tier, &[one], &pace.to_the_end()));
    });
    let found = predicted(tier, &args.theta_r_deg, &pace);
    if found.table.lines.is_empty() && !found.left.is_empty() {
        return Err(CliError::no_result(anyhow!(
            "nothing was finished in time: allow more seconds"
        )));
    }
    // A closed form is compared with two bounces integrated, as long as time is.
    let apart = match args.variant {
        Model::Quadrature => None,
        Model::Paper | Model::Sawtooth => {
            let full = predicted(Tier::Quadrature, &args.theta_r_deg, &pace);
            (found.left.is_empty() && full.left.is_empty())
                .then(|| found.table.apart(&full.table))
                .flatten()
        }
    };
    let mut report = as_json(&found.table, None);
    report["mode"] = json!("predicted");
    report["variant"] = json!(args.variant.name());
    let error = found.error.or(apart).map(|value| Expected {
        value,
        of: "a radiance, of the brightest".to_owned(),
    });
    report["error"] = json!(error);
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
            "time was over",
            None,
        ));
    }
    report["left_out"] = json!(left_out);
    Ok((found.table, report))
}

fn measured(source: &dyn FrameSource, region: Option<&str>) -> Result<(Table, Value), CliError> {
    let cancel = interrupt::flag()?;
    let set = reduced(source, region, &cancel)?;
    measure(&set).map_err(CliError::no_result)
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

/// Radiances of a table on disk; rows of another alpha are left out.
fn read_radiances(path: &Path, alpha: f64) -> Result<Table, CliError> {
    let bad = |why: String| CliError::bad_input(anyhow!("{}: {why}", path.display()));
    let mut reader = csv::Reader::from_path(path)
        .with_context(|| format!("cannot read {}", path.display()))
        .map_err(CliError::bad_input)?;
    let headers = reader.headers().map_err(|e| bad(e.to_string()))?.clone();
    let find = |name: &str| headers.iter().position(|h| h.trim() == name);
    let need = |name: &str| find(name).ok_or_else(|| bad(format!("lacks the column {name}")));
    let columns = [
        need("theta_r_deg")?,
        need("theta_c_deg")?,
        need("phi_s_deg")?,
        need("radiance")?,
    ];
    let alpha_column = find("alpha");
    let mut exposures = Vec::new();
    for record in reader.records() {
        let record = record.map_err(|e| bad(e.to_string()))?;
        let number = |column: usize| {
            record[column]
                .trim()
                .parse::<f64>()
                .map_err(|_| bad(format!("{:?} is no number", &record[column])))
        };
        if let Some(column) = alpha_column
            && (number(column)? - alpha).abs() > 1e-9
        {
            continue;
        }
        let [theta_r, theta_c, phi_s, radiance] = columns;
        exposures.push(Exposure {
            theta_r: Angle::from_deg(number(theta_r)?),
            theta_c: Angle::from_deg(number(theta_c)?),
            phi_s: Angle::from_deg(number(phi_s)?),
            radiance: number(radiance)?,
        });
    }
    let table = Table::of(&exposures);
    if table.lines.is_empty() {
        return Err(bad(format!(
            "no line has the azimuths 0, 90 and 180 degrees (alpha {alpha})"
        )));
    }
    Ok(table)
}

/// Differences of absolute contrasts over the lines that both tables have.
fn comparison(ours: &Table, theirs: &Table, path: &Path) -> Value {
    let mut differences = Vec::new();
    let mut largest: f64 = 0.0;
    for a in &ours.lines {
        for b in &theirs.lines {
            let near = |x: Angle, y: Angle| (x - y).abs() < Angle::from_deg(5e-4);
            if near(a.theta_r, b.theta_r) && near(a.theta_c, b.theta_c) {
                for pair in 0..PAIRS.len() {
                    largest = largest.max(b.contrast[pair].absolute);
                    differences.push(a.contrast[pair].absolute - b.contrast[pair].absolute);
                }
            }
        }
    }
    let n = differences.len().max(1) as f64;
    let rms = (differences.iter().map(|d| d * d).sum::<f64>() / n).sqrt();
    let worst = differences.iter().map(|d| d.abs()).fold(0.0, f64::max);
    json!({
        "file": path.display().to_string(),
        "n_contrasts": differences.len(),
        "rms": rms,
        "worst": worst,
        "largest_contrast": largest,
        "rms_relative": rms / largest,
        "worst_relative": worst / largest,
        "findings": theirs.findings().map(findings_json),
    })
}

fn as_text(table: &Table, report: &Value) -> String {
    let mut text = String::new();
    let predicted = report["mode"] == "predicted";
    let ridge = |a: Angle| {
        if predicted {
            format!("{:8.2}", rounded_deg(a))
        } else {
            "       –".to_owned()
        }
    };
    let _ = writeln!(
        text,
        "θr / °   θc / °       L(0°)      L(90°)     L(180°)   |0–90|  (Mich.)  |90–180|  (Mich.)"
    );
    for l in &table.lines {
        let [a, b] = l.contrast;
        let _ = writeln!(
            text,
            "{}{:8.2}  {:10.5}  {:10.5}  {:10.5}  {:7.4}  {:6.3}   {:7.4}  {:6.3}",
            ridge(l.theta_r),
            rounded_deg(l.theta_c),
            l.radiance[0],
            l.radiance[1],
            l.radiance[2],
            a.absolute,
            a.michelson,
            b.absolute,
            b.michelson
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
                    "{}°: {:.4} ({:.3})",
                    m.setting, m.contrast.absolute, m.contrast.michelson
                )
            })
            .collect();
        let _ = writeln!(text, "mean by {name}: {}", list.join("   "));
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
    if let Some(c) = report.get("comparison") {
        let _ = writeln!(
            text,
            "against {}: {} contrasts, rms difference {:.3} %, worst {:.3} % of the largest",
            c["file"].as_str().unwrap_or_default(),
            c["n_contrasts"],
            100.0 * c["rms_relative"].as_f64().unwrap_or(f64::NAN),
            100.0 * c["worst_relative"].as_f64().unwrap_or(f64::NAN)
        );
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
        assert!(as_text(&table, &report).lines().count() > 20);
    }

    #[test]
    fn options_out_of_range_are_named() {
        let refused = predicted(&parsed(&["--rho-d", "1.5"])).unwrap_err();
        let CliError::BadInput(e) = refused else {
            panic!("{refused:?}")
        };
        assert_eq!(e.to_string(), "--rho-d = 1.5 is not within 0 and 1");
        assert!(predicted(&parsed(&["--theta-r-deg", "5", "75"])).is_err());
    }

    #[test]
    fn the_comparison_takes_the_rows_of_its_alpha() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("tests/data/contrast-raytraced-paper-rig.csv");
        let other = read_radiances(&path, 0.06).unwrap();
        let (table, _) = predicted(&parsed(&["--alpha", "0.06", "--rho-d", "0.342"])).unwrap();
        let c = comparison(&table, &other, &path);
        assert_eq!(c["n_contrasts"], 40);
        assert!(c["rms_relative"].as_f64().unwrap() < 0.002);
        assert!(read_radiances(&path, 0.5).is_err());
    }
}
