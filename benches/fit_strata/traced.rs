//! Coverage of the expanded uncertainty where the model is not exact: the ray tracer on the true geometry gives the light,
//! and the whole fit gives value and U. Nothing else is uncertain in these series: reference, angles and index are exact.

use std::collections::BTreeMap;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use ridged::fit::problem::Values;
use ridged::fit::report::VariantName;
use ridged::fit::traced::ridged_surface;
use ridged::fit::{FitOptions, VariantChoice, fit};
use ridged::geometry::{Cones, Pose, RigGeometry};
use ridged::material::Material;
use ridged::observation::{Observation, ObservationSet, Prior, WhiteReference};
use ridged::trace::pose_radiance::RadianceOptions;
use ridged::units::Angle;

use super::draw::{Draw, displaced};

/// Paths per pose of the light: their noise is below that of a camera.
const PATHS: u64 = 1 << 17;
/// Poses: tilts, their step, azimuths, their step; degrees.
const GRIDS: [(u32, f64, u32, f64); 2] = [(5, 10.0, 3, 90.0), (9, 5.0, 12, 30.0)];
/// Least share of truths within U.
const COVERED_MIN: f64 = 0.93;

/// What the results of one parameter showed.
#[derive(Default)]
struct Row {
    /// (value − truth)/U.
    ratios: Vec<f64>,
    /// value − truth: of α and ρd as a share of the truth, of angles in degrees.
    errors: Vec<f64>,
    /// U over that by counting noise alone, at a coverage factor of 2.
    cautions: Vec<f64>,
    withheld: usize,
}

/// A plastic or metal sample at a grid of poses, with the values that it was traced with.
fn case(
    (tilts, tilt_step, turns, turn_step): (u32, f64, u32, f64),
    seed: u64,
) -> (ObservationSet, Values) {
    let mut draw = Draw::new(seed);
    let metal = draw.chance(0.3);
    let (eta, k) = if metal { (2.9, 3.1) } else { (1.54, 0.0) };
    let truth = Values {
        theta_r: draw.between(4.0, 20.0).to_radians(),
        alpha_u: draw.log_between(0.05, 0.2),
        alpha_v: draw.log_between(0.05, 0.2),
        rho_d: if metal { 0.0 } else { draw.between(0.1, 0.6) },
        azimuth_offset: draw.between(-3.0, 3.0).to_radians(),
        tilt_offset: draw.between(-0.3, 0.3).to_radians(),
        eta,
        k,
        ..Values::IDEAL
    };
    let rig = RigGeometry {
        cones: Cones::of_lamp(Angle::from_deg(1.0)),
        ..match draw.chance(0.5) {
            true => RigGeometry::BESIDE,
            false => RigGeometry::IN_PLANE,
        }
    };
    let background = Prior {
        mean: 0.0,
        std: 1e-4,
    };
    let mut set = ObservationSet {
        white_reference: Some(WhiteReference {
            reflectance: 0.99,
            reflectance_std: 0.0,
        }),
        ..ObservationSet::bare(rig, Material::exactly(eta, k), Vec::new(), background)
    };
    let surface = ridged_surface(&set, &truth, None).expect("an ideal sawtooth has any angle");
    let poses = (0..tilts).flat_map(|t| {
        let tilt = tilt_step * (f64::from(t) - f64::from(tilts - 1) / 2.0);
        (0..turns).map(move |p| Pose::from_deg(tilt, turn_step * f64::from(p)))
    });
    let poses: Vec<Pose> = poses.collect();
    let light: Vec<_> = poses
        .iter()
        .enumerate()
        .map(|(i, pose)| {
            let turned = displaced(*pose, truth.tilt_offset, truth.azimuth_offset);
            let options = RadianceOptions {
                paths: PATHS,
                seed: seed.wrapping_mul(1000).wrapping_add(i as u64),
                cones: set.rig.cones,
                polarised: true,
            };
            surface.radiance(&set.rig.directions(turned), &options)
        })
        .collect();
    let peak = light.iter().map(|l| l.value).fold(0.0, f64::max);
    for (pose, light) in poses.iter().zip(&light) {
        // A camera that is 2e-4 at the peak, with a constant part of a tenth of that.
        let counting = 2e-4 * peak * (0.01 + light.value / peak).sqrt();
        let signal = light.value + counting * draw.normal();
        let sigma = counting.hypot(light.std);
        set.observations
            .push(Observation::new(*pose, signal, sigma));
    }
    (set, truth)
}

/// Prints the coverage by grid and parameter; whether all of it is as required.
pub fn run(cases: u64, seed: u64, variant: VariantChoice) -> bool {
    let mut met = true;
    for grid in GRIDS {
        let begun = Instant::now();
        let mut rows: BTreeMap<&str, Row> = BTreeMap::new();
        let mut less_sure = 0;
        for n in 0..cases {
            let (set, truth) = case(grid, seed.wrapping_mul(1_000_000).wrapping_add(n));
            let options = FitOptions {
                variant,
                ..FitOptions::default()
            };
            let report = fit(&set, &options, &AtomicBool::new(false));
            less_sure += usize::from(report.notes.iter().any(|n| n.contains("less certain")));
            if report.variant == VariantName::Paper {
                println!("  case {n}: variant paper");
            }
            let truths = [
                ("theta_r_deg", truth.theta_r.to_degrees()),
                ("alpha_u", truth.alpha_u),
                ("alpha_v", truth.alpha_v),
                ("rho_d", truth.rho_d),
                ("azimuth_offset_deg", truth.azimuth_offset.to_degrees()),
                ("tilt_offset_deg", truth.tilt_offset.to_degrees()),
            ];
            for (name, parameter) in report.parameters.named() {
                let Some((_, truth)) = truths.iter().find(|(n, _)| *n == name) else {
                    continue;
                };
                if name == "rho_d" && *truth == 0.0 {
                    continue;
                }
                let row = rows.entry(name).or_default();
                let (Some(value), Some(expanded)) = (parameter.value, parameter.expanded) else {
                    row.withheld += 1;
                    continue;
                };
                row.ratios.push((value - truth) / expanded);
                let unit = if name.ends_with("_deg") { 1.0 } else { *truth };
                row.errors.push((value - truth) / unit);
                if let Some(budget) = parameter.budget {
                    row.cautions.push(expanded / (2.0 * budget.counting));
                }
            }
        }
        println!(
            "{} tilts × {} azimuths, {cases} samples, {:.0} s; {less_sure} notes of less certainty",
            grid.0,
            grid.2,
            begun.elapsed().as_secs_f64()
        );
        println!(
            "  parameter            covered        rms E_n  largest  rms error  largest  U/U(counting)  withheld"
        );
        for (name, row) in &mut rows {
            let count = row.ratios.len().max(1) as f64;
            let inside = row.ratios.iter().filter(|r| r.abs() <= 1.0).count() as f64;
            let rms_and_largest = |values: &[f64]| {
                let squares = values.iter().map(|x| x * x).sum::<f64>();
                let largest = values.iter().fold(0.0_f64, |l, x| l.max(x.abs()));
                ((squares / count).sqrt(), largest)
            };
            let (rms, largest) = rms_and_largest(&row.ratios);
            let (error, largest_error) = rms_and_largest(&row.errors);
            row.cautions.sort_by(f64::total_cmp);
            let caution = row.cautions.get(row.cautions.len() / 2).copied();
            println!(
                "  {name:<20} {:5.1} % of {count:<4} {rms:7.2} {largest:8.2} {error:10.5} {largest_error:8.5} {:14.1} {:9}",
                100.0 * inside / count,
                caution.unwrap_or(f64::NAN),
                row.withheld
            );
            // Four standard deviations of such a count.
            let spread = 4.0 * (0.05 * 0.95 / count).sqrt();
            met &= inside / count >= COVERED_MIN - spread;
        }
    }
    met
}
