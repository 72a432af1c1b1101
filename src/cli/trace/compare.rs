//! `ridged trace compare`: the error of a computation without polarisation, as ADM and MDM maps.

use std::path::{Path, PathBuf};

use anyhow::anyhow;
use serde::Serialize;

use super::curves::{self, AngleCurve, CurveValues};
use super::hemisphere::{self, Disc, DiscScale, LampMark};
use super::runs::{self, Runs};
use super::{CliError, Source};
use crate::cli::limits::{RunLimits, Stopwatch};
use crate::cli::output_path;
use crate::cli::values::whole;
use crate::figures::{PlotAxis, with_true_minus};
use crate::model::LeftOut;
use crate::trace::counting::grid::DirectionGrid;
use crate::trace::counting::polarisation_difference::{
    DifferenceSummary, DirectionDifference, DirectionMask, PolarisationDifference, WAVELENGTHS_NM,
    seed_at,
};
use crate::trace::counting::tally::Totals;
use crate::trace::photons::paired::SCALAR;
use crate::trace::run::Follow;
use crate::trace::surfaces::height_field::Side;

/// Compares polarised with scalar tracing: the relative difference d per direction of exit, its mean |d| over the
/// wavelengths (ADM) and its maximum (MDM).
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  ridged trace compare scenes/glass-over-diamond.toml --angles-deg 50,56,60,65\n  ridged trace compare scenes/glass-over-gold.toml --angles-deg 60,80 --pictures out\n  ridged trace compare scenes/glass-over-gold.toml --angles-deg 60,80 --max-seconds 60"
)]
pub struct Args {
    /// The scene. Its photons are traced for each angle and wavelength, polarised and scalar; its run.polarised has no
    /// effect.
    #[arg(value_name = "SCENE.toml")]
    scene: PathBuf,
    /// Angles of incidence, in degrees, instead of the scene's.
    #[arg(long, value_name = "DEG,…", value_delimiter = ',')]
    angles_deg: Vec<f64>,
    /// Wavelengths, in nm. Default: 380 to 660 by 40 if a material depends on it, else the scene's.
    #[arg(long, value_name = "NM,…", value_delimiter = ',')]
    wavelengths_nm: Vec<f64>,
    /// Photons per angle and wavelength, instead of the scene's.
    #[arg(long, value_name = "N")]
    photons: Option<u64>,
    #[command(flatten)]
    limits: RunLimits,
    /// Number of square direction-cosine pixels across the hemisphere.
    #[arg(long, value_name = "N", default_value_t = 128, value_parser = whole::<u16>(8..=1024))]
    pixels: u16,
    /// Leave out directions darker than the mean of the lit ones divided by this.
    #[arg(long, value_name = "T", default_value_t = 10.0)]
    mask: f64,
    /// Leave out directions whose difference has a standard error above this.
    #[arg(long, value_name = "E", default_value_t = 0.02)]
    error_max: f64,
    /// Folder for difference maps and for the lobes in the plane of incidence (SVG).
    #[arg(long, value_name = "DIR")]
    pictures: Option<PathBuf>,
    /// One JSON object on stdout instead of a table.
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Serialize)]
struct Report {
    pixels: u16,
    mask: DirectionMask,
    wavelengths_nm: Vec<f64>,
    photons_per_wavelength: u64,
    angles: Vec<ComparedAngle>,
    seconds: f64,
    left_out: Vec<LeftOut>,
    program: String,
}

#[derive(Debug, Serialize)]
struct ComparedAngle {
    theta_i_deg: f64,
    adm: Option<DifferenceSummary>,
    mdm: Option<DifferenceSummary>,
    worst: Option<DirectionDifference>,
    directions: usize,
    too_dark: usize,
    not_settled: usize,
    /// Photons at all wavelengths together.
    photons: u64,
    /// Error of the reflected bins, root mean square, at the worst wavelength.
    relative_error: Option<f64>,
}

/// Runs the command.
///
/// # Errors
/// Bad input for an invalid scene or option; no result where a picture cannot be written.
pub fn run(args: &Args) -> Result<(), CliError> {
    let bad = |text: &str| Err(CliError::bad_input(anyhow!("{text}")));
    if !(args.mask > 0.0 && args.mask.is_finite()) {
        return bad("--mask must be greater than 0");
    }
    if args.error_max.is_nan() || args.error_max <= 0.0 {
        return bad("--error-max must be greater than 0");
    }
    args.limits.check()?;
    let watch = Stopwatch::start(args.limits.max_seconds);
    let source = Source::read(&args.scene, args.photons)?;
    let angles = match args.angles_deg.len() {
        0 => vec![source.scene.light.theta_i_deg],
        _ => args.angles_deg.clone(),
    };
    let wavelengths = if !args.wavelengths_nm.is_empty() {
        args.wavelengths_nm.clone()
    } else if source.scene.depends_on_wavelength() {
        WAVELENGTHS_NM.to_vec()
    } else {
        vec![source.scene.light.wavelength_nm]
    };
    let mask = DirectionMask {
        divisor: args.mask,
        error_max: args.error_max,
    };
    let grid = DirectionGrid::disc(usize::from(args.pixels));
    let at = |run: usize| {
        let mut scene = source.scene.clone();
        scene.light.theta_i_deg = angles[run / wavelengths.len()];
        scene.light.wavelength_nm = wavelengths[run % wavelengths.len()];
        scene
    };
    let count = angles.len() * wavelengths.len();
    // Everything is checked before anything is traced.
    for run in 0..count {
        at(run).check().map_err(CliError::bad_input)?;
    }
    args.pictures
        .as_deref()
        .map_or(Ok(()), output_path::check_folder)?;
    let mut report = Report {
        pixels: args.pixels,
        mask,
        wavelengths_nm: wavelengths.clone(),
        photons_per_wavelength: source.scene.run.photons,
        angles: Vec::new(),
        seconds: 0.0,
        left_out: Vec::new(),
        program: format!("ridged {}", env!("CARGO_PKG_VERSION")),
    };
    let shapes = source.shapes(&watch)?;
    let runs = Runs {
        watch,
        count,
        photons: source.scene.run.photons,
        follow: Follow::Both,
        limits: args.limits,
        make: &|run| {
            let prepared = at(run).prepare_on(&shapes);
            let seed = seed_at(source.scene.run.seed, run % wavelengths.len());
            let prepared = prepared.map_err(CliError::bad_input)?;
            Ok(prepared.with_grid(grid).with_seed(seed))
        },
    };
    let mut of_angle: Vec<Totals> = Vec::new();
    let done = runs::each(&runs, &mut |run, prepared, totals| {
        report.left_out.clone_from(&prepared.left_out);
        of_angle.push(totals);
        if of_angle.len() < wavelengths.len() {
            return Ok(());
        }
        let all = std::mem::take(&mut of_angle);
        let theta = angles[run / wavelengths.len()];
        let difference = PolarisationDifference::of(&all, &mask)
            .ok_or_else(|| CliError::no_result(anyhow!("no run was finished")))?;
        if let Some(folder) = &args.pictures {
            let lamp = LampMark {
                theta_deg: theta,
                phi_deg: source.scene.light.phi_i_deg,
            };
            pictures(folder, lamp, &wavelengths, &all, &difference, &mask)?;
        }
        report.angles.push(ComparedAngle {
            theta_i_deg: theta,
            adm: difference.adm(),
            mdm: difference.mdm(),
            worst: difference.worst().copied(),
            directions: difference.directions.len(),
            too_dark: difference.too_dark,
            not_settled: difference.not_settled,
            photons: all.iter().map(Totals::photons).sum(),
            relative_error: all
                .iter()
                .filter_map(Totals::relative_error)
                .reduce(f64::max),
        });
        Ok(())
    })?;
    report.seconds = done.seconds;
    super::print(args.json, &report, |out| report.table(out))?;
    done.verdict()
}

impl Report {
    fn table(&self, out: &mut dyn std::io::Write) -> std::io::Result<()> {
        writeln!(
            out,
            "{} × {} pixels of the direction cosines; left out: darker than the mean / {}, error above {}",
            self.pixels, self.pixels, self.mask.divisor, self.mask.error_max
        )?;
        writeln!(
            out,
            "θi / °  ADM most  99 %   mean   MDM most  99 %   most at θ, φ / °   scalar is       directions"
        )?;
        for a in &self.angles {
            let (Some(adm), Some(mdm), Some(w)) = (a.adm, a.mdm, &a.worst) else {
                writeln!(
                    out,
                    "{:6}  no direction is precise enough: trace more photons",
                    a.theta_i_deg
                )?;
                continue;
            };
            let percent = |x: f64| 100.0 * x;
            writeln!(
                out,
                "{:6}  {:6.1} % {:5.1} % {:5.1} %  {:5.1} % {:5.1} %   {:5.1}, {:5.1}     {:+.1} ± {:.1} %    {}",
                a.theta_i_deg,
                percent(adm.greatest),
                percent(adm.percentile_99),
                percent(adm.mean),
                percent(mdm.greatest),
                percent(mdm.percentile_99),
                w.theta_deg,
                w.phi_deg,
                percent(-w.mean),
                percent(w.std),
                a.directions
            )?;
        }
        Ok(())
    }
}

fn pictures(
    folder: &Path,
    lamp: LampMark,
    wavelengths: &[f64],
    runs: &[Totals],
    difference: &PolarisationDifference,
    mask: &DirectionMask,
) -> Result<(), CliError> {
    let grid = difference.grid;
    let bins = grid.per_side();
    let mean = |element: usize| -> Vec<Option<f64>> {
        (0..bins)
            .map(|bin| {
                let sum: f64 = runs
                    .iter()
                    .filter(|r| !r.is_empty(Side::Above, bin))
                    .map(|r| r.element(Side::Above, bin, element).value)
                    .sum();
                (sum > 0.0).then_some(sum / runs.len() as f64)
            })
            .collect()
    };
    let of = |value: fn(&DirectionDifference) -> f64| -> Vec<Option<f64>> {
        let mut values = vec![None; bins];
        for direction in &difference.directions {
            values[direction.bin] = Some(value(direction));
        }
        values
    };
    let (polarised, scalar) = (mean(0), mean(SCALAR));
    let decades = DiscScale::decades(difference.directions.iter().map(|d| d.scalar));
    let round_up = |x: f64| ((x * 20.0).ceil() / 20.0).max(0.05);
    let most = round_up(difference.mdm().map_or(0.05, |s| s.greatest));
    let mut discs = vec![
        disc("polarised BRDF / sr⁻¹", decades, polarised),
        disc("scalar BRDF / sr⁻¹", decades, scalar),
        disc(
            "mean d (polarised − scalar)/scalar",
            DiscScale::Signed(most),
            of(|d| d.mean),
        ),
        disc("ADM, mean |d|", DiscScale::Range(0.0, most), of(|d| d.adm)),
    ];
    if wavelengths.len() > 1 {
        discs.push(disc(
            "MDM, greatest |d|",
            DiscScale::Range(0.0, most),
            of(|d| d.mdm),
        ));
    }
    let waves = match wavelengths {
        [one] => format!("{one} nm"),
        many => format!(
            "{} wavelengths from {} nm to {} nm",
            many.len(),
            many[0],
            many[many.len() - 1]
        ),
    };
    let note = format!(
        "{waves}; {0} × {0} pixels of the direction cosines; grey: darker than the mean of the lit pixels / {1}, or error above {2}",
        grid.n_phi, mask.divisor, mask.error_max
    );
    let title = format!(
        "Reflected light, polarised against scalar, lamp at {}°",
        lamp.theta_deg
    );
    let name = format!("difference-{}.svg", lamp.theta_deg);
    super::write_picture(
        folder,
        &name,
        &hemisphere::figure(grid, lamp, discs.len(), &title, &note, &discs),
    )?;
    let name = format!("lobe-{}.svg", lamp.theta_deg);
    super::write_picture(folder, &name, &lobe(lamp, runs, &waves))
}

fn disc(title: &str, scale: DiscScale, values: Vec<Option<f64>>) -> Disc {
    Disc {
        title: title.to_owned(),
        scale,
        values,
    }
}

/// Polarised and scalar BRDF, and their difference, along three planes through n.
fn lobe(lamp: LampMark, runs: &[Totals], waves: &str) -> String {
    let grid = runs[0].grid();
    let off_deg = [0.0, 10.0, 20.0];
    let mut upper = Vec::new();
    let mut lower = Vec::new();
    let mut brightest = 0.0f64;
    for off in off_deg {
        let (mut polarised, mut scalar, mut relative) = (Vec::new(), Vec::new(), Vec::new());
        for (theta, pixels) in across(grid, lamp.phi_deg + 180.0 + off) {
            let n = runs.len() as f64;
            let mean = |element: usize| {
                let (mut sum, mut square) = (0.0, 0.0);
                for run in runs {
                    for (bin, weight) in &pixels {
                        let e = run.element(Side::Above, *bin, element);
                        sum += weight * e.value;
                        square += (weight * e.std).powi(2);
                    }
                }
                (sum / n, square.sqrt() / n)
            };
            let ((p, p_std), (q, q_std)) = (mean(0), mean(SCALAR));
            let (d, d_std) = mean(crate::trace::photons::paired::DIFFERENCE);
            brightest = brightest.max(p).max(q);
            polarised.push((theta, p, p_std));
            scalar.push((theta, q, q_std));
            let settled = d_std < 0.03 * q;
            relative.push((theta, if settled { d / q } else { f64::NAN }, d_std / q));
        }
        let curve = |name: &str, points| AngleCurve {
            name: name.to_owned(),
            points,
        };
        let title = match off {
            0.0 => "plane of incidence".to_owned(),
            _ => format!("{off}° from it"),
        };
        let both = [curve("polarised", polarised), curve("scalar", scalar)];
        upper.push((title, both));
        lower.push([curve("", relative)]);
    }
    let values = |axis| CurveValues {
        axis,
        wraps: false,
        step_deg: 90.0,
    };
    let brdf = values(PlotAxis::from_zero("BRDF / sr⁻¹", brightest));
    let ticks = [-0.2, -0.1, 0.0, 0.1, 0.2];
    let ticks = ticks.map(|t| (t, with_true_minus(&format!("{t}"))));
    let label = "(pol. − scalar)/scalar";
    let relative = values(PlotAxis::between(label, (-0.25, 0.25), ticks.to_vec()));
    let upper = upper.iter();
    let upper = upper.map(|(title, curves)| curves::panel(title, &brdf, curves));
    let lower = lower.iter();
    let lower = lower.map(|curves| curves::panel("", &relative, curves));
    curves::figure(
        &format!("Lobe of the reflected light, lamp at {}°", lamp.theta_deg),
        &format!(
            "{waves}; positive angles are on the side of the mirror direction; bars are standard errors"
        ),
        upper.chain(lower).collect(),
    )
}

/// A plane through n, by rising angle from it: one direction per pixel width, in degrees towards the azimuth `phi_deg`, and
/// up to four surrounding pixels with their weights. (A plane along the pixels' rows is between two rows.)
fn across(grid: DirectionGrid, phi_deg: f64) -> Vec<(f64, Vec<(usize, f64)>)> {
    let n = grid.n_phi;
    let centre = |i: i64| (2 * i + 1) as f64 / n as f64 - 1.0;
    let (sin, cos) = phi_deg.to_radians().sin_cos();
    let direction = |step: usize| {
        let r = centre(step as i64);
        let at = |x: f64| 0.5 * (x + 1.0) * n as f64 - 0.5;
        let (column, row) = (at(r * cos), at(r * sin));
        let mut pixels = Vec::new();
        for (i, over) in [
            (row.floor(), row - row.floor()),
            (row.floor() + 1.0, row.floor() + 1.0 - row),
        ] {
            for (j, beside) in [
                (column.floor(), column - column.floor()),
                (column.floor() + 1.0, column.floor() + 1.0 - column),
            ] {
                let weight = (1.0 - over) * (1.0 - beside);
                let (i, j) = (i as i64, j as i64);
                // Pixels at the rim contain too little of the hemisphere.
                if weight > 1e-9 && centre(i).hypot(centre(j)) < 1.0 {
                    pixels.push((i as usize * n + j as usize, weight));
                }
            }
        }
        let sum: f64 = pixels.iter().map(|p| p.1).sum();
        pixels.iter_mut().for_each(|p| p.1 /= sum);
        (sum > 0.5).then(|| (r.asin().to_degrees(), pixels))
    };
    (0..n).filter_map(direction).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plane_has_one_direction_per_pixel_and_both_rows_beside_it() {
        for n in [8, 127, 128] {
            let grid = DirectionGrid::disc(n);
            for phi_deg in [0.0, 10.0, 90.0, 180.0, 200.0] {
                let plane = across(grid, phi_deg);
                assert!(plane.len() + 4 >= n, "{n} {phi_deg}: {}", plane.len());
                let mut sets: Vec<Vec<usize>> = Vec::new();
                for (theta_deg, pixels) in plane {
                    let sum: f64 = pixels.iter().map(|p| p.1).sum();
                    assert!((sum - 1.0).abs() < 1e-12);
                    // Where all surrounding pixels exist, they surround the direction.
                    let (sin, phi) = (theta_deg.to_radians().sin(), phi_deg.to_radians());
                    let cosine = |bin: usize| (2 * bin + 1) as f64 / n as f64 - 1.0;
                    let of = |part: fn(usize, usize) -> usize| -> f64 {
                        pixels
                            .iter()
                            .map(|(bin, w)| w * cosine(part(*bin, n)))
                            .sum()
                    };
                    if sin.abs() < 1.0 - 3.0 / n as f64 {
                        assert!((of(|b, n| b % n) - sin * phi.cos()).abs() < 1e-9);
                        assert!((of(|b, n| b / n) - sin * phi.sin()).abs() < 1e-9);
                    }
                    let mut bins: Vec<usize> = pixels.iter().map(|p| p.0).collect();
                    bins.sort_unstable();
                    if n % 2 == 0 && phi_deg % 90.0 == 0.0 {
                        assert_eq!(bins.len(), 2, "{n} {phi_deg}: {theta_deg}");
                        assert!(!sets.contains(&bins), "{n} {phi_deg}: {theta_deg}");
                    }
                    sets.push(bins);
                }
            }
        }
    }
}
