//! `ridged model-error`: where and by how much the closed forms are wrong, measured with the tracer.
//!
//! A surface of every ridge angle and roughness is traced at the poses of the full scan. The closed
//! form at the true parameters is compared pose by pose; then the variants are fitted to the traced
//! radiances, and what they read is compared with the truth.

mod figure;

use std::fmt::Write as _;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use anyhow::{Context, anyhow};
use rayon::prelude::*;
use serde_json::{Value, json};

use super::limits::{PathLimits, Stopwatch, Trial, Work};
use super::progress::Bar;
use super::{CliError, answer, interrupt, place};
use crate::fit::{FitOptions, VariantChoice, fit};
use crate::forecast::Expected;
use crate::geometry::{Directions, Pose, RigGeometry};
use crate::material::Material;
use crate::model::prepared::{OpticsTable, Prepared};
use crate::model::quadrature::Quadrature;
use crate::model::{LeftOut, Optics, Surface, Variant};
use crate::observation::{FlatObservation, Observation, ObservationSet, Prior, WhiteReference};
use crate::trace::facet::{Diffuse, Roughness};
use crate::trace::ridged::{RadianceOptions, RidgedSurface};
use crate::trace::ridges::Ridges;
use crate::trace::rng::{Purpose, Stream};
use crate::wording::counted;

/// Where and by how much the variants paper and sawtooth are wrong: table, maps.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  ridged model-error --out docs\n  \
    ridged model-error --theta-r-deg 10 --alpha 0.12 --paths 16384")]
pub struct Args {
    /// Ridge angles.
    #[arg(long, num_args = 1.., value_name = "DEG",
          default_values_t = [2.0, 5.0, 10.0, 15.0, 20.0, 25.0, 30.0])]
    pub theta_r_deg: Vec<f64>,
    /// Roughnesses (both axes).
    #[arg(long, num_args = 1.., default_values_t = [0.03, 0.06, 0.1, 0.2, 0.3])]
    pub alpha: Vec<f64>,
    /// Diffuse reflectance of the plastic.
    #[arg(long, default_value_t = 0.35)]
    pub rho_d: f64,
    /// Paths per radiance, from the camera and as many from the lamp.
    #[arg(long, default_value_t = 8192)]
    pub paths: u64,
    /// Time and error allowed.
    #[command(flatten)]
    pub limits: PathLimits,
    /// Seed of everything random.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// One JSON object on stdout instead of a table.
    #[arg(long)]
    pub json: bool,
    /// Folder for model-error.csv, model-error-poses.csv and model-error.svg.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
}

/// Camera tilts of the full scan, degrees.
const TILTS: usize = 9;
/// Azimuths of the full scan.
const AZIMUTHS: usize = 12;

/// The samples' materials: name, n, k.
const MATERIALS: [(&str, f64, f64); 2] = [("plastic", 1.54, 0.0), ("steel", 2.9, 3.1)];

/// What one variant makes of one surface.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Misread {
    /// Root mean square residual of the fit, as a share of the peak.
    pub rms: f64,
    /// Fitted less true ridge angle, degrees.
    pub theta_r_deg: f64,
    /// Fitted over true roughness, less 1: along and across the ridges.
    pub alpha: [f64; 2],
    /// Fitted over true diffuse reflectance, less 1; not for metal nor for the printed lobe.
    pub rho_d: Option<f64>,
}

/// One surface.
#[derive(Debug, Clone)]
pub(super) struct Cell {
    /// Index into [`MATERIALS`].
    pub material: usize,
    pub theta_r_deg: f64,
    pub alpha: f64,
    /// Sawtooth's closed form less traced at the true parameters, as a share of the peak, by pose
    /// (azimuths within tilts).
    pub closed: Vec<f64>,
    /// The same with two bounces integrated.
    pub quadrature: Vec<f64>,
    /// Root mean square standard error of the tracer, as a share of the peak.
    pub noise: f64,
    /// The variants paper and sawtooth, fitted; `None` where a fit gave no number.
    pub fitted: [Option<Misread>; 2],
}

/// Runs the command.
///
/// # Errors
/// Bad input for options out of range; no result where a file cannot be written; interrupted.
pub fn run(args: Args) -> Result<(), CliError> {
    args.out.as_deref().map_or(Ok(()), place::for_files)?;
    let cancel = interrupt::flag()?;
    let watch = Stopwatch::start(args.limits.max_seconds);
    let (cells, missing) = cells(&args, &watch, &cancel)?;
    let left_out = left_out(&missing);
    let seconds = watch.seconds();
    if let Some(out) = &args.out {
        std::fs::create_dir_all(out)
            .and_then(|()| std::fs::write(out.join("model-error.csv"), csv(&cells)))
            .and_then(|()| std::fs::write(out.join("model-error-poses.csv"), poses_csv(&cells)))
            .and_then(|()| std::fs::write(out.join("model-error.svg"), figure::draw(&cells)))
            .with_context(|| format!("cannot write to {}", out.display()))
            .map_err(CliError::no_result)?;
    }
    answer::put(args.json, &report(&cells, &left_out, seconds), || {
        let mut text = table(&cells);
        for left in &left_out {
            let _ = writeln!(text, "\nleft out: {} ({})", left.what, left.why);
        }
        text
    })
}

/// What neither the closed forms nor the traced surfaces have, and surfaces for which no time was left.
fn left_out(missing: &[Wanted]) -> Vec<LeftOut> {
    let mut list = vec![
        LeftOut::new(
            "rounded crests, burrs, draft of the risers",
            "forms and traced surfaces alike are ideal sawteeth; `ridged wear` shows what wear does",
            None,
        ),
        LeftOut::new(
            "bounces among the facets' own roughness",
            "below the profile light meets one microfacet per hit, with Smith's masking",
            None,
        ),
    ];
    if !missing.is_empty() {
        let names = missing.iter().map(|w| {
            let (material, ..) = MATERIALS[w.material];
            format!("{material} of {}° and α {}", w.theta_r_deg, w.alpha)
        });
        let names: Vec<String> = names.collect();
        let what = counted(missing.len(), "surface");
        list.push(LeftOut::new(
            format!("{what}: {}", names.join(", ")),
            "time was over",
            None,
        ));
    }
    list
}

/// The object of `--json`.
fn report(cells: &[Cell], left_out: &[LeftOut], seconds: f64) -> Value {
    let surfaces = cells.iter().map(|cell| {
        // With its sign, as in the table of poses: too bright is positive.
        let largest = |of: &[f64]| of.get(summary(of).1).copied();
        let fitted = ["paper", "sawtooth"].iter().zip(&cell.fitted);
        let fitted: serde_json::Map<String, Value> = fitted
            .map(|(name, m)| {
                let m = m.map(|m| {
                    json!({
                        "rms": m.rms,
                        "theta_r_error_deg": m.theta_r_deg,
                        "alpha_u_error": m.alpha[0],
                        "alpha_v_error": m.alpha[1],
                        "rho_d_error": m.rho_d,
                    })
                });
                ((*name).to_owned(), json!(m))
            })
            .collect();
        json!({
            "material": MATERIALS[cell.material].0,
            "theta_r_deg": cell.theta_r_deg,
            "alpha": cell.alpha,
            "noise": cell.noise,
            "closed_worst": largest(&cell.closed),
            "quadrature_worst": largest(&cell.quadrature),
            "fitted": fitted,
        })
    });
    let noise = cells.iter().map(|c| c.noise).fold(0.0, f64::max);
    json!({
        "surfaces": surfaces.collect::<Vec<_>>(),
        "error": Expected {
            value: noise,
            of: "a traced radiance, of the peak, at worst".to_owned(),
        },
        "seconds": seconds,
        "left_out": left_out,
        "program": concat!("ridged ", env!("CARGO_PKG_VERSION")),
    })
}

/// Pose number `n` of the full scan.
pub(super) fn pose(n: usize) -> Pose {
    let (tilt, azimuth) = (n / AZIMUTHS, n % AZIMUTHS);
    Pose::from_deg(5.0 * tilt as f64 - 20.0, 30.0 * azimuth as f64)
}

/// A surface to trace and fit.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Wanted {
    /// Index into [`MATERIALS`].
    material: usize,
    theta_r_deg: f64,
    alpha: f64,
}

/// All surfaces, and those for which no time was left.
fn cells(
    args: &Args,
    watch: &Stopwatch,
    cancel: &AtomicBool,
) -> Result<(Vec<Cell>, Vec<Wanted>), CliError> {
    let bad = |what: String| Err(CliError::bad_input(anyhow!(what)));
    if let Some(t) = args.theta_r_deg.iter().find(|t| !(0.1..=45.0).contains(*t)) {
        return bad(format!("--theta-r-deg {t}: give degrees from 0.1 to 45"));
    }
    if let Some(a) = args.alpha.iter().find(|a| !(0.005..=1.0).contains(*a)) {
        return bad(format!("--alpha {a}: give 0.005 to 1"));
    }
    if !(0.0..=0.9).contains(&args.rho_d) {
        return bad(format!("--rho-d {}: give 0 to 0.9", args.rho_d));
    }
    if !(64..=10_000_000).contains(&args.paths) {
        return bad(format!("--paths {}: give 64 to 10,000,000", args.paths));
    }
    let mut wanted = Vec::new();
    for material in 0..MATERIALS.len() {
        for &theta_r_deg in &args.theta_r_deg {
            wanted.extend(args.alpha.iter().map(|&alpha| Wanted {
                material,
                theta_r_deg,
                alpha,
            }));
        }
    }
    args.limits.check()?;
    let mut paths = args.paths;
    let stopped = || cancel.load(Ordering::Relaxed);
    let done =
        |wanted: &Wanted, paths: u64| watch.flagging(cancel, |end| cell(args, paths, wanted, end));
    if args.limits.is_any() {
        // One of each material: plastic takes more of the tracer, and their fits are not alike.
        let each = wanted.len() / MATERIALS.len();
        let middle = (0..MATERIALS.len()).map(|m| m * each + each / 2);
        let middle: Vec<Wanted> = middle.filter_map(|n| wanted.get(n).copied()).collect();
        let pilot = |paths| {
            let mut trial = Trial {
                surfaces: middle.len(),
                error: 0.0,
                apart_s: 0.0,
            };
            for wanted in &middle {
                let (cell, fits_s) = done(wanted, paths)?;
                trial.error = cell.noise.max(trial.error);
                trial.apart_s += fits_s;
            }
            Some(trial)
        };
        let work = Work {
            surfaces: wanted.len(),
            abreast: 1,
            paths,
            may_miss_some: true,
        };
        if let Some(told) = args.limits.plan(&work, &pilot)? {
            eprintln!("forecast: {}", told.forecast);
            paths = told.paths;
        }
    }
    let bar = Bar::new("surfaces");
    let (mut cells, mut missing) = (Vec::new(), Vec::new());
    for (n, next) in wanted.iter().enumerate() {
        let found = if watch.is_late() {
            None
        } else {
            done(next, paths)
        };
        if stopped() {
            return Err(CliError::Interrupted);
        }
        match found {
            Some((cell, _)) => cells.push(cell),
            None if watch.is_late() => missing.push(*next),
            None => {}
        }
        bar.at(n as u64 + 1, wanted.len() as u64);
    }
    bar.clear();
    if cells.is_empty() && !missing.is_empty() {
        return Err(CliError::no_result(anyhow!(
            "no surface was finished in time: allow more seconds"
        )));
    }
    Ok((cells, missing))
}

/// One surface, and the seconds that its fits and integrals took; `None` where it was told to end.
fn cell(args: &Args, paths: u64, wanted: &Wanted, end: &AtomicBool) -> Option<(Cell, f64)> {
    let Wanted {
        material,
        theta_r_deg,
        alpha,
    } = *wanted;
    let go_on = || (!end.load(Ordering::Relaxed)).then_some(());
    let (_, eta, k) = MATERIALS[material];
    let rig = RigGeometry::IN_PLANE;
    let rho_d = if k > 0.0 { 0.0 } else { args.rho_d };
    let surface = Surface {
        theta_r: theta_r_deg.to_radians(),
        alpha_u: alpha,
        alpha_v: alpha,
        rho_d,
        amplitude: 1.0,
    };
    let (kind, optics) = optics(&rig, eta, k);
    let roughness = Roughness {
        alpha_u: alpha,
        alpha_v: alpha,
    };
    let traced = RidgedSurface::new(
        Ridges::ideal(surface.theta_r, 1.0).profile().ok()?,
        roughness,
        [eta, k],
        (rho_d > 0.0).then(|| Diffuse::new(rho_d, eta, 1.0, rig.theta_l.rad().cos())),
    );
    let directions: Vec<Directions> = (0..TILTS * AZIMUTHS)
        .map(|n| rig.directions(pose(n)))
        .collect();
    let radiances: Vec<_> = directions
        .par_iter()
        .enumerate()
        .map(|(n, d)| {
            let options = RadianceOptions {
                paths,
                seed: Stream::new(args.seed, Purpose::Batch, n as u64).bits(),
                cones: rig.cones,
                polarised: true,
            };
            go_on().map(|()| traced.radiance(d, &options))
        })
        .collect::<Option<Vec<_>>>()?;
    let all_traced = Instant::now();
    let peak = radiances.iter().map(|r| r.value).fold(0.0, f64::max);
    let table = OpticsTable::new(&optics);
    let closed = Prepared::new(Variant::Sawtooth, &surface, &table);
    let against = |value: &dyn Fn(usize) -> f64| -> Vec<f64> {
        let all = radiances.iter().enumerate();
        all.map(|(n, r)| (value(n) - r.value) / peak).collect()
    };
    let integrated = Quadrature::new(&surface, &table).radiances(&directions, 1e-5 * peak);
    go_on()?;
    let square: f64 = radiances.iter().map(|r| (r.std / peak).powi(2)).sum();
    let set = observations(
        &rig,
        kind,
        &radiances
            .iter()
            .map(|r| (r.value, r.std))
            .collect::<Vec<_>>(),
    );
    let fitted = [VariantChoice::Paper, VariantChoice::Sawtooth].map(|variant| {
        let options = FitOptions {
            variant,
            ..FitOptions::default()
        };
        let report = fit(&set, &options, end);
        let p = &report.parameters;
        let rho = p.rho_d.value.filter(|_| variant != VariantChoice::Paper);
        Some(Misread {
            rms: report.rms_residual?,
            theta_r_deg: p.theta_r_deg.value? - theta_r_deg,
            alpha: [
                p.alpha_u.value? / alpha - 1.0,
                p.alpha_v.value? / alpha - 1.0,
            ],
            rho_d: rho.map(|r| r / rho_d - 1.0),
        })
    });
    // A fit that was told to end is no answer.
    go_on()?;
    let cell = Cell {
        material,
        theta_r_deg,
        alpha,
        closed: against(&|n| closed.partials(&directions[n]).value),
        quadrature: against(&|n| integrated[n].value),
        noise: (square / radiances.len() as f64).sqrt(),
        fitted,
    };
    Some((cell, all_traced.elapsed().as_secs_f64()))
}

fn optics(rig: &RigGeometry, eta: f64, k: f64) -> (Material, Optics) {
    let material = if k > 0.0 {
        Material::Conductor {
            eta,
            k,
            eta_std: 0.0,
            k_std: 0.0,
        }
    } else {
        Material::Dielectric { eta, eta_std: 0.0 }
    };
    (material, Optics::new(rig, &material))
}

/// Traced radiances (value, standard error) as a reduction would hand them to a fit, with an ideal
/// white reference.
fn observations(rig: &RigGeometry, material: Material, radiances: &[(f64, f64)]) -> ObservationSet {
    let peak = radiances.iter().map(|r| r.0).fold(0.0, f64::max);
    let observation = |(n, (signal, std)): (usize, &(f64, f64))| {
        Observation::new(pose(n), *signal, std.max(1e-6 * peak))
    };
    let flat = |t: usize| {
        let theta_c = pose(t * AZIMUTHS).theta_c;
        let signal = rig.cos_incidence(theta_c) / std::f64::consts::PI;
        FlatObservation {
            theta_c,
            signal,
            sigma: 1e-4 * signal,
        }
    };
    ObservationSet {
        flats: (0..TILTS).map(flat).collect(),
        white_reference: Some(WhiteReference {
            reflectance: 1.0,
            reflectance_std: 0.0,
        }),
        n_frames_used: 0,
        ..ObservationSet::bare(
            *rig,
            material,
            radiances.iter().enumerate().map(observation).collect(),
            Prior {
                mean: 0.0,
                std: 1e-4 * peak,
            },
        )
    }
}

/// Root mean square and the pose of the largest deviation.
fn summary(deviations: &[f64]) -> (f64, usize) {
    let square: f64 = deviations.iter().map(|d| d * d).sum();
    let worst = (0..deviations.len())
        .max_by(|a, b| deviations[*a].abs().total_cmp(&deviations[*b].abs()))
        .unwrap_or(0);
    ((square / deviations.len().max(1) as f64).sqrt(), worst)
}

fn csv(cells: &[Cell]) -> String {
    let mut text = String::from(
        "material,theta_r_deg,alpha,tracer_rms,closed_rms,closed_worst,worst_theta_c_deg,worst_phi_s_deg,\
         quadrature_rms,quadrature_worst",
    );
    for variant in ["paper", "sawtooth"] {
        for what in [
            "rms",
            "theta_r_error_deg",
            "alpha_u_error",
            "alpha_v_error",
            "rho_d_error",
        ] {
            let _ = write!(text, ",{variant}_fit_{what}");
        }
    }
    text.push('\n');
    for cell in cells {
        let (rms, worst) = summary(&cell.closed);
        let (quadrature_rms, quadrature_worst) = summary(&cell.quadrature);
        let at = pose(worst);
        let _ = write!(
            text,
            "{},{},{},{:.2e},{rms:.2e},{:.2e},{:.0},{:.0},{quadrature_rms:.2e},{:.2e}",
            MATERIALS[cell.material].0,
            cell.theta_r_deg,
            cell.alpha,
            cell.noise,
            cell.closed[worst],
            at.theta_c.deg(),
            at.phi_s.deg(),
            cell.quadrature[quadrature_worst],
        );
        for fitted in &cell.fitted {
            match fitted {
                Some(m) => {
                    let rho = m.rho_d.map_or(String::new(), |r| format!("{r:.5}"));
                    let _ = write!(
                        text,
                        ",{:.2e},{:.4},{:.5},{:.5},{rho}",
                        m.rms, m.theta_r_deg, m.alpha[0], m.alpha[1]
                    );
                }
                None => text.push_str(",,,,,"),
            }
        }
        text.push('\n');
    }
    text
}

/// Per material and pose: root mean square over the surfaces of closed form less traced.
fn poses_csv(cells: &[Cell]) -> String {
    let mut text = String::from("material,theta_c_deg,phi_s_deg,closed_rms,quadrature_rms\n");
    for (material, (name, ..)) in MATERIALS.iter().enumerate() {
        for n in 0..TILTS * AZIMUTHS {
            let rms = |of: &dyn Fn(&Cell) -> f64| {
                let own: Vec<f64> = cells
                    .iter()
                    .filter(|c| c.material == material)
                    .map(of)
                    .collect();
                summary(&own).0
            };
            let at = pose(n);
            let _ = writeln!(
                text,
                "{name},{:.0},{:.0},{:.2e},{:.2e}",
                at.theta_c.deg(),
                at.phi_s.deg(),
                rms(&|c| c.closed[n]),
                rms(&|c| c.quadrature[n])
            );
        }
    }
    text
}

/// A table in Markdown: the worst and the median over the roughnesses, by material and ridge angle.
fn table(cells: &[Cell]) -> String {
    let mut text = String::from(
        "| material | θr | paper, fitted: rms | its θr is off by | its αv by | sawtooth at the truth: rms | worst pose | two bounces integrated: rms | sawtooth, fitted: θr is off by | its α by | its ρd by | tracer's noise |\n\
         | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |\n",
    );
    let mut angles: Vec<(usize, f64)> = Vec::new();
    for cell in cells {
        if !angles.contains(&(cell.material, cell.theta_r_deg)) {
            angles.push((cell.material, cell.theta_r_deg));
        }
    }
    for (material, theta) in angles {
        let own: Vec<&Cell> = cells
            .iter()
            .filter(|c| c.material == material && c.theta_r_deg == theta)
            .collect();
        let most = |of: &dyn Fn(&Cell) -> Option<f64>| -> Option<f64> {
            own.iter()
                .filter_map(|c| of(c))
                .map(f64::abs)
                .fold(None, |m: Option<f64>, x| Some(m.map_or(x, |m| m.max(x))))
        };
        let percent =
            |x: Option<f64>| x.map_or("–".to_owned(), |x| format!("{:.3} %", 100.0 * x));
        let degrees = |x: Option<f64>| x.map_or("–".to_owned(), |x| format!("{x:.3}°"));
        let paper = |c: &Cell| c.fitted[0];
        let sawtooth = |c: &Cell| c.fitted[1];
        let _ = writeln!(
            text,
            "| {} | {theta}° | {} | {} | {} | {} | {} | {} | {} | {} | {} | {} |",
            MATERIALS[material].0,
            percent(most(&|c| paper(c).map(|m| m.rms))),
            degrees(most(&|c| paper(c).map(|m| m.theta_r_deg))),
            percent(most(&|c| paper(c).map(|m| m.alpha[1]))),
            percent(most(&|c| Some(summary(&c.closed).0))),
            percent(most(&|c| Some(c.closed[summary(&c.closed).1]))),
            percent(most(&|c| Some(summary(&c.quadrature).0))),
            degrees(most(&|c| sawtooth(c).map(|m| m.theta_r_deg))),
            percent(most(
                &|c| sawtooth(c).map(|m| m.alpha[0].abs().max(m.alpha[1].abs()))
            )),
            percent(most(&|c| sawtooth(c).and_then(|m| m.rho_d))),
            percent(most(&|c| Some(c.noise))),
        );
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::parsed;

    fn found(words: &[&str]) -> Result<Vec<Cell>, CliError> {
        let args: Args = parsed(words);
        let watch = Stopwatch::start(args.limits.max_seconds);
        cells(&args, &watch, &AtomicBool::new(false)).map(|found| found.0)
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
    fn surfaces_for_which_no_time_is_left_are_named() {
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
        // Time is over before the first.
        let late = cells(&args, &Stopwatch::start(Some(1e-9)), &calm);
        let Err(CliError::NoResult(why)) = late else {
            panic!("{late:?}");
        };
        assert!(why.to_string().contains("in time"), "{why}");
        let missing = [Wanted {
            material: 1,
            theta_r_deg: 10.0,
            alpha: 0.2,
        }];
        let told = report(&[], &left_out(&missing), 1.0);
        let last = &told["left_out"][2];
        assert_eq!(last["what"], "1 surface: steel of 10° and α 0.2");
        assert!(left_out(&[]).len() == 2);
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
