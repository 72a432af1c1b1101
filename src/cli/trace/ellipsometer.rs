//! `ridged trace ellipsometer`: what a camera records through filter and compensator, DOLP and AOP.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use anyhow::{Context, anyhow};
use serde::Serialize;

use super::curves::{self, AngleCurve, CurveValues};
use super::runs::{self, Runs};
use super::{CliError, Source};
use crate::cli::limits::{RunLimits, Stopwatch};
use crate::cli::output_path;
use crate::figures::{Panel, PlotAxis, with_true_minus};
use crate::model::LeftOut;
use crate::trace::ellipsometer::{ERROR_UNKNOWN, EllipsometerPoint, SETTINGS, curve};
use crate::trace::run::Follow;

/// Six states of the lamp's light, six settings of the camera's filter and compensator, over the plane
/// of incidence: intensities, Stokes vectors, DOLP and AOP.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Example:\n  ridged trace ellipsometer scenes/sandpaper.toml --angles-deg 30,45,60 --out states.csv --pictures out"
)]
pub struct Args {
    /// The scene. Polarisation is always traced; its run.polarised has no effect.
    #[arg(value_name = "SCENE.toml")]
    scene: PathBuf,
    /// Angles of incidence, in degrees.
    #[arg(long, value_name = "DEG,…", value_delimiter = ',', default_values_t = [30.0, 45.0, 60.0])]
    angles_deg: Vec<f64>,
    /// Photons per angle, instead of the scene's.
    #[arg(long, value_name = "N")]
    photons: Option<u64>,
    #[command(flatten)]
    limits: RunLimits,
    /// CSV file of all readings.
    #[arg(long, value_name = "FILE.csv")]
    out: Option<PathBuf>,
    /// Folder for the curves (SVG).
    #[arg(long, value_name = "DIR")]
    pictures: Option<PathBuf>,
    /// One JSON object on stdout with all readings.
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Serialize)]
struct Report {
    settings: [crate::trace::ellipsometer::PolariserSetting; 6],
    photons: u64,
    angles: Vec<MeasuredAngle>,
    seconds: f64,
    /// Limitations of the standard errors.
    notes: Vec<&'static str>,
    left_out: Vec<LeftOut>,
    program: String,
}

#[derive(Debug, Serialize)]
struct MeasuredAngle {
    theta_i_deg: f64,
    /// Photons traced.
    photons: u64,
    /// Error of the reflected bins, root mean square.
    relative_error: Option<f64>,
    points: Vec<EllipsometerPoint>,
}

/// Runs the command.
///
/// # Errors
/// Bad input for an invalid scene; no result where a file cannot be written.
pub fn run(args: &Args) -> Result<(), CliError> {
    args.limits.check()?;
    let watch = Stopwatch::start(args.limits.max_seconds);
    let mut source = Source::read(&args.scene, args.photons)?;
    // One polarised run gives all states of the lamp.
    source.scene.run.polarised = toml::Value::Boolean(true);
    let at = |run: usize| {
        let mut scene = source.scene.clone();
        scene.light.theta_i_deg = args.angles_deg[run];
        scene
    };
    for run in 0..args.angles_deg.len() {
        at(run).check().map_err(CliError::bad_input)?;
    }
    args.out
        .as_deref()
        .map_or(Ok(()), output_path::check_file)?;
    args.pictures
        .as_deref()
        .map_or(Ok(()), output_path::check_folder)?;
    let mut report = Report {
        settings: SETTINGS,
        photons: source.scene.run.photons,
        angles: Vec::new(),
        seconds: 0.0,
        notes: Vec::new(),
        left_out: Vec::new(),
        program: format!("ridged {}", env!("CARGO_PKG_VERSION")),
    };
    let shapes = source.shapes(&watch)?;
    let runs = Runs {
        watch,
        count: args.angles_deg.len(),
        photons: source.scene.run.photons,
        follow: Follow::Scene,
        limits: args.limits,
        make: &|run| at(run).prepare_on(&shapes).map_err(CliError::bad_input),
    };
    let done = runs::each(&runs, &mut |run, prepared, totals| {
        report.left_out.clone_from(&prepared.left_out);
        let points = curve(&totals, source.scene.light.phi_i_deg)
            .ok_or_else(|| CliError::no_result(anyhow!("nothing was reflected")))?;
        report.angles.push(MeasuredAngle {
            theta_i_deg: args.angles_deg[run],
            photons: totals.photons(),
            relative_error: totals.relative_error(),
            points,
        });
        Ok(())
    })?;
    report.seconds = done.seconds;
    report.notes = notes(&report.angles);
    if let Some(out) = &args.out {
        std::fs::write(out, report.csv())
            .with_context(|| format!("cannot write {}", out.display()))
            .map_err(CliError::no_result)?;
    }
    if let Some(folder) = &args.pictures {
        for angle in &report.angles {
            let name = format!("ellipsometer-{}.svg", angle.theta_i_deg);
            let step_deg = 90.0 / source.scene.run.theta_bins as f64;
            write_curves(folder, &name, angle.theta_i_deg, &angle.points, step_deg)?;
        }
    }
    super::print(args.json, &report, |out| report.table(out))?;
    done.verdict()
}

/// The state of the lamp that Ψ and Δ are read with.
const AT_45: &str = SETTINGS[1].name;

/// Note on the errors.
fn notes(angles: &[MeasuredAngle]) -> Vec<&'static str> {
    let readings = angles.iter().flat_map(|a| &a.points);
    let mut readings = readings.flat_map(|p| &p.readings);
    let unknown = readings.any(|r| !r.has_errors());
    unknown.then_some(ERROR_UNKNOWN).into_iter().collect()
}

/// DOLP and AOP for the six states of the lamp; directions are `step_deg` apart.
pub(super) fn write_curves(
    folder: &Path,
    name: &str,
    theta_i_deg: f64,
    points: &[EllipsometerPoint],
    step_deg: f64,
) -> Result<(), CliError> {
    let panels = |dolp: bool, settings: std::ops::Range<usize>| -> Vec<Panel> {
        // Of all half turns this one holds the four linear states away from its ends.
        let values = CurveValues {
            axis: match dolp {
                true => PlotAxis::from_zero("DOLP", 1.0),
                false => {
                    let ticks = [-45.0, 0.0, 45.0, 90.0];
                    let ticks = ticks.map(|t| (t, with_true_minus(&format!("{t}"))));
                    PlotAxis::between("AOP / °", (-67.5, 112.5), ticks.to_vec())
                }
            },
            wraps: !dolp,
            step_deg,
        };
        let panel = |n: usize| {
            let points = points.iter().map(|p| {
                let r = &p.readings[n];
                let (value, std, most) = match dolp {
                    true => (r.dolp, r.dolp_std, 0.25),
                    false => (r.aop_deg, r.aop_std_deg, 15.0),
                };
                let settled = std.filter(|std| *std < most);
                let value = settled.map_or(f64::NAN, |_| value);
                (p.theta_s_deg, value, settled.unwrap_or(0.0))
            });
            let curve = AngleCurve {
                name: String::new(),
                points: points.collect(),
            };
            curves::panel(SETTINGS[n].name, &values, &[curve])
        };
        settings.map(panel).collect()
    };
    // Three states per row, DOLP above AOP.
    let ordered = [
        panels(true, 0..3),
        panels(false, 0..3),
        panels(true, 3..6),
        panels(false, 3..6),
    ]
    .concat();
    let mut note = "plane of incidence; positive angles are on the side of the mirror direction; AOP is from s to p; \
                    bars are standard errors"
        .to_owned();
    if points.iter().any(|p| p.errors_as_independent) {
        note += " that treat the Mueller elements as independent";
    }
    let title = format!("Polarisation of the reflected light, lamp at {theta_i_deg}°");
    let svg = curves::figure(&title, &note, ordered);
    super::write_picture(folder, name, &svg)
}

/// Formats an angle of polarisation: rounded, 90 for −90 (the same state), and 0 without a sign.
fn shown_aop_deg(aop_deg: f64) -> f64 {
    let tenths = (10.0 * aop_deg).round();
    let tenths = if tenths <= -900.0 { 900.0 } else { tenths };
    0.1 * tenths + 0.0
}

/// Directions up to which the table shows all.
const SHOWN: usize = 20;

/// Returns the nearest direction with light for each ten degrees; the CSV file has all directions.
fn shown(points: &[EllipsometerPoint]) -> Vec<&EllipsometerPoint> {
    if points.len() <= SHOWN {
        return points.iter().collect();
    }
    let mut nearest: Vec<&EllipsometerPoint> = Vec::new();
    for ten in -9..=9 {
        let wanted = 10.0 * f64::from(ten);
        let off = |p: &EllipsometerPoint| (p.theta_s_deg - wanted).abs();
        // A direction nearer to the next ten degrees belongs to those.
        let found = points.iter().filter(|p| off(p) <= 5.0);
        let found = found.min_by(|a, b| off(a).total_cmp(&off(b)));
        nearest.extend(found.filter(|f| {
            nearest
                .last()
                .is_none_or(|last| last.theta_s_deg < f.theta_s_deg)
        }));
    }
    nearest
}

impl Report {
    fn csv(&self) -> String {
        let mut text = String::from("theta_i_deg,theta_s_deg,input,filter_deg,compensator_deg");
        let cameras = |text: &mut String, suffix: &str| {
            for setting in &SETTINGS {
                let _ = write!(text, ",camera_{}{suffix}", setting.name.replace('-', "_"));
            }
        };
        cameras(&mut text, "");
        text.push_str(",s0,s1,s2,s3,s0_std,s1_std,s2_std,s3_std,dolp,aop_deg,dolp_std,aop_std_deg");
        text.push_str(",psi_deg,delta_deg,psi_std_deg,delta_std_deg,dop,dop_std");
        cameras(&mut text, "_std");
        text.push('\n');
        for angle in &self.angles {
            for point in &angle.points {
                for (reading, setting) in point.readings.iter().zip(&SETTINGS) {
                    let _ = write!(
                        text,
                        "{},{},{},{},{}",
                        angle.theta_i_deg,
                        point.theta_s_deg,
                        reading.input,
                        setting.filter_deg,
                        setting.compensator_deg
                    );
                    let numbers = reading.camera.iter().chain(&reading.stokes);
                    for x in numbers.chain(&reading.stokes_std) {
                        let _ = write!(text, ",{x:e}");
                    }
                    let _ = write!(text, ",{:e},{:e}", reading.dolp, reading.aop_deg);
                    for std in [reading.dolp_std, reading.aop_std_deg] {
                        let std = std.map_or(String::new(), |std| format!("{std:e}"));
                        let _ = write!(text, ",{std}");
                    }
                    // Ψ and Δ are of the direction, from linear light at 45°.
                    let of = &point.psi_delta;
                    let known = (reading.input == AT_45).then_some(of);
                    for number in [
                        known.map(|of| of.psi_deg),
                        known.map(|of| of.delta_deg),
                        known.and_then(|of| of.psi_std_deg),
                        known.and_then(|of| of.delta_std_deg),
                        known.map(|of| of.dop),
                        known.and_then(|of| of.dop_std),
                    ] {
                        let number = number.map_or(String::new(), |x| format!("{x:e}"));
                        let _ = write!(text, ",{number}");
                    }
                    for x in &reading.camera_std {
                        let _ = write!(text, ",{x:e}");
                    }
                    text.push('\n');
                }
            }
        }
        text
    }

    fn table(&self, out: &mut dyn std::io::Write) -> std::io::Result<()> {
        writeln!(out, "θi / °  θs / °  lamp        I / sr⁻¹   DOLP   AOP / °")?;
        for angle in &self.angles {
            if angle.points.is_empty() {
                writeln!(
                    out,
                    "{:6}  no light in the bins of the plane of incidence",
                    angle.theta_i_deg
                )?;
            }
            for point in shown(&angle.points) {
                for r in &point.readings {
                    writeln!(
                        out,
                        "{:6}  {:6}  {:10}  {:.3e}  {:.3}  {:6.1}",
                        angle.theta_i_deg,
                        (100.0 * point.theta_s_deg).round() / 100.0,
                        r.input,
                        r.stokes[0],
                        r.dolp,
                        shown_aop_deg(r.aop_deg)
                    )?;
                }
            }
        }
        writeln!(
            out,
            "\nfrom linear light at 45°, ± U (k = 2):\nθi / °  θs / °       Ψ / °             Δ / °        degree of polarisation"
        )?;
        let with_error = |value: f64, std: Option<f64>, decimals: usize| match std {
            Some(std) => format!("{value:8.decimals$} ± {:<6.decimals$}", 2.0 * std),
            None => format!("{value:8.decimals$}         "),
        };
        for angle in &self.angles {
            for point in shown(&angle.points) {
                let of = &point.psi_delta;
                writeln!(
                    out,
                    "{:6}  {:6}  {}  {}  {}",
                    angle.theta_i_deg,
                    (100.0 * point.theta_s_deg).round() / 100.0,
                    with_error(of.psi_deg, of.psi_std_deg, 2),
                    with_error(of.delta_deg, of.delta_std_deg, 1),
                    with_error(of.dop, of.dop_std, 3)
                )?;
            }
        }
        for note in &self.notes {
            writeln!(out, "note: {note}")?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trace::ellipsometer::{EllipsometerReading, PsiDelta};

    const PSI_DELTA: PsiDelta = PsiDelta {
        psi_deg: 20.0,
        psi_std_deg: Some(0.5),
        delta_deg: 130.0,
        delta_std_deg: None,
        dop: 0.9,
        dop_std: Some(0.01),
    };

    fn report(readings: Vec<EllipsometerReading>) -> Report {
        Report {
            settings: SETTINGS,
            photons: 1,
            angles: vec![MeasuredAngle {
                theta_i_deg: 45.0,
                photons: 1,
                relative_error: None,
                points: vec![EllipsometerPoint {
                    theta_s_deg: 45.0,
                    readings,
                    psi_delta: PSI_DELTA,
                    errors_as_independent: false,
                }],
            }],
            seconds: 0.0,
            notes: Vec::new(),
            left_out: Vec::new(),
            program: String::new(),
        }
    }

    fn reading(aop_deg: f64) -> EllipsometerReading {
        EllipsometerReading {
            input: "left",
            stokes: [1.0, 0.5, 0.0, 0.1],
            stokes_std: [0.1; 4],
            camera: [2.0; 6],
            camera_std: [0.25, 0.5, 0.75, 1.0, 1.25, 1.5],
            dolp: 0.5,
            dolp_std: Some(0.1),
            aop_deg,
            aop_std_deg: Some(1.0),
        }
    }

    #[test]
    fn the_csv_file_ends_with_the_errors_of_the_intensities() {
        let text = report(vec![reading(10.0)]).csv();
        let rows: Vec<Vec<&str>> = text.lines().map(|l| l.split(',').collect()).collect();
        assert_eq!(rows[0].len(), rows[1].len());
        let at = |name: &str| rows[0].iter().position(|n| *n == name).unwrap();
        assert_eq!(rows[1][at("camera_left")], "2e0");
        assert_eq!(rows[1][at("camera_linear_0_std")], "2.5e-1");
        assert_eq!(rows[1][at("camera_right_std")], "1.5e0");
        // Of light at 45° only.
        assert_eq!(rows[1][at("psi_deg")], "");
        let mut at_45 = reading(10.0);
        at_45.input = AT_45;
        let text = report(vec![at_45]).csv();
        let row: Vec<&str> = text.lines().nth(1).unwrap().split(',').collect();
        assert_eq!((row[at("psi_deg")], row[at("delta_std_deg")]), ("2e1", ""));
        assert_eq!(at("camera_right_std"), rows[0].len() - 1);
    }

    #[test]
    fn an_unknown_error_is_an_empty_field_null_and_a_note() {
        let mut unknown = reading(10.0);
        (unknown.dolp_std, unknown.aop_std_deg) = (None, None);
        let mut report = report(vec![reading(10.0), unknown]);
        report.notes = notes(&report.angles);
        let text = report.csv();
        let rows: Vec<Vec<&str>> = text.lines().map(|l| l.split(',').collect()).collect();
        for name in ["dolp_std", "aop_std_deg"] {
            let at = rows[0].iter().position(|n| *n == name).unwrap();
            assert!(!rows[1][at].is_empty() && rows[2][at].is_empty());
        }
        let json = serde_json::to_value(&report).unwrap();
        assert!(json["angles"][0]["points"][0]["readings"][1]["dolp_std"].is_null());
        let mut out = Vec::new();
        report.table(&mut out).unwrap();
        assert!(
            String::from_utf8(out)
                .unwrap()
                .contains("no standard error")
        );
    }

    #[test]
    fn one_state_of_polarisation_has_one_angle_in_the_table() {
        for (aop_deg, shown) in [
            (-0.01, "   0.0\n"),
            (0.01, "   0.0\n"),
            (-89.98, "  90.0\n"),
            (90.0, "  90.0\n"),
            (-89.9, " -89.9\n"),
            (-45.0, " -45.0\n"),
        ] {
            let mut out = Vec::new();
            report(vec![reading(aop_deg)]).table(&mut out).unwrap();
            let text = String::from_utf8(out).unwrap();
            assert!(text.contains(shown), "{aop_deg}: {text}");
            assert!(text.contains("20.00 ± 1.00"), "{text}");
        }
    }

    #[test]
    fn the_table_shows_a_direction_for_each_ten_degrees_whatever_the_bins() {
        let lit = |n_theta: i32, from_deg: f64, until_deg: f64| -> Vec<EllipsometerPoint> {
            let width = 90.0 / f64::from(n_theta);
            let all = (-n_theta..n_theta).map(|n| (f64::from(n) + 0.5) * width);
            let lit = all.filter(|t| (from_deg..until_deg).contains(t));
            lit.map(|theta_s_deg| EllipsometerPoint {
                theta_s_deg,
                readings: Vec::new(),
                psi_delta: PSI_DELTA,
                errors_as_independent: false,
            })
            .collect()
        };
        for n_theta in [12, 18, 31, 45, 90, 1440] {
            let half_deg = 45.0 / f64::from(n_theta);
            let points = lit(n_theta, -90.0, 90.0);
            let table = shown(&points);
            assert_eq!(table.len(), 19, "{n_theta}");
            for (point, ten) in table.iter().zip(-9..) {
                let off = (point.theta_s_deg - 10.0 * f64::from(ten)).abs();
                assert!(off <= half_deg + 1e-9, "{n_theta}: {}", point.theta_s_deg);
            }
        }
        // Some directions are dark, and few are shown all.
        let points = lit(45, -1.0, 62.0);
        let table = shown(&points);
        assert_eq!(table.len(), 7);
        assert!((table[6].theta_s_deg - 59.0).abs() < 1.1);
        assert_eq!(shown(&lit(45, 10.0, 30.0)).len(), 10);
    }
}
