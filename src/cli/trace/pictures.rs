//! The figures of one run: all Mueller elements, the Stokes vector for the scene's own light, and the
//! six canonical states over the plane of incidence.

use std::path::Path;

use super::hemisphere::{Disc, DiscScale, LampMark, figure};
use super::{CliError, ellipsometer, write_picture};
use crate::trace::counting::tally::Totals;
use crate::trace::ellipsometer::{aop_deg, curve, dolp};
use crate::trace::scene::Scene;
use crate::trace::surfaces::height_field::Side;

/// Relative error of a bin's brightness above which ratios are shown grey.
const SETTLED: f64 = 0.3;

/// Writes `mueller.svg`, `stokes.svg` and `curves.svg`; for a scalar run only `brdf.svg`.
pub(super) fn write(folder: &Path, scene: &Scene, totals: &Totals) -> Result<(), CliError> {
    let lamp = LampMark {
        theta_deg: scene.light.theta_i_deg,
        phi_deg: scene.light.phi_i_deg,
    };
    let grid = totals.grid();
    let value = |bin: usize, i: usize| totals.element(Side::Above, bin, i).value;
    let lit = |bin: usize| !totals.is_empty(Side::Above, bin) && value(bin, 0) > 0.0;
    let over = |f: &dyn Fn(usize) -> Option<f64>| -> Vec<Option<f64>> {
        (0..grid.per_side()).map(f).collect()
    };
    let brightness = over(&|bin| lit(bin).then(|| value(bin, 0)));
    let decades = DiscScale::decades(brightness.iter().flatten().copied());
    let note = format!(
        "{} × {} bins of polar angle and azimuth, {} photons; ○ lamp, + mirror direction",
        grid.n_theta,
        grid.n_phi,
        totals.photons()
    );
    let title = |what: &str| format!("{what}, lamp at {}°", lamp.theta_deg);
    let brdf = |title: &str, values| Disc {
        title: title.to_owned(),
        scale: decades,
        values,
    };
    if totals.elements() < 16 {
        let discs = [brdf("BRDF / sr⁻¹", brightness)];
        let svg = figure(grid, lamp, 1, &title("Reflected light"), &note, &discs);
        return write_picture(folder, "brdf.svg", &svg);
    }
    let settled = |bin: usize| {
        let m00 = totals.element(Side::Above, bin, 0);
        lit(bin) && m00.std <= SETTLED * m00.value
    };
    let mut discs = vec![brdf("m00 / sr⁻¹", brightness)];
    for i in 1..16 {
        discs.push(Disc {
            title: format!("m{}{} / m00", i / 4, i % 4),
            scale: DiscScale::Signed(1.0),
            values: over(&|bin| settled(bin).then(|| value(bin, i) / value(bin, 0))),
        });
    }
    let svg = figure(
        grid,
        lamp,
        4,
        &title("Mueller matrix of the reflected light"),
        &note,
        &discs,
    );
    write_picture(folder, "mueller.svg", &svg)?;

    let [intensity, q, u, v] = scene.light.stokes;
    let input = [1.0, q / intensity, u / intensity, v / intensity];
    let stokes = |bin: usize| -> [f64; 4] {
        std::array::from_fn(|i| (0..4).map(|j| value(bin, 4 * i + j) * input[j]).sum())
    };
    let seen = |f: &dyn Fn(&[f64; 4]) -> f64| over(&|bin| settled(bin).then(|| f(&stokes(bin))));
    let ratio = |name: &str, i: usize| Disc {
        title: format!("{name} / I"),
        scale: DiscScale::Signed(1.0),
        values: seen(&|s| s[i] / s[0]),
    };
    let discs = [
        brdf("I / sr⁻¹", over(&|bin| lit(bin).then(|| stokes(bin)[0]))),
        ratio("Q", 1),
        ratio("U", 2),
        ratio("V", 3),
        Disc {
            title: "DOLP".to_owned(),
            scale: DiscScale::Range(0.0, 1.0),
            values: seen(&dolp),
        },
        Disc {
            title: "AOP from s to p".to_owned(),
            scale: DiscScale::Turn,
            // The angle is undefined where almost no light is polarised.
            values: over(&|bin| {
                (settled(bin) && dolp(&stokes(bin)) > 0.01).then(|| aop_deg(&stokes(bin)))
            }),
        },
    ];
    let what = format!(
        "Stokes vector of the reflected light for ({}, {}, {}, {})",
        1, input[1], input[2], input[3]
    );
    let svg = figure(grid, lamp, 3, &title(&what), &note, &discs);
    write_picture(folder, "stokes.svg", &svg)?;
    match curve(totals, lamp.phi_deg) {
        Some(points) => {
            let step_deg = 90.0 / grid.n_theta as f64;
            ellipsometer::write_curves(folder, "curves.svg", lamp.theta_deg, &points, step_deg)
        }
        None => Ok(()),
    }
}
