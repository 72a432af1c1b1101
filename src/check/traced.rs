//! The tracer on extreme shapes and media: limits from Fresnel's equations, and conservation of energy.

use std::sync::atomic::{AtomicBool, Ordering};

use super::criterion::{digits, limit, refused, sampled};
use super::{CheckEffort, CheckRow};
use crate::model::fresnel;
use crate::trace::counting::tally::{Energies, MonteCarloEstimate, Totals};
use crate::trace::run::{self, Shard};
use crate::trace::scene::{HeightMap, Scene, SceneError};
use crate::trace::surfaces::height_field::Side;

const AREA: &str = "tracer";
const ENERGY: &str = "conservation of energy";
const LIMIT: &str = "closed limit";

/// A scene of interfaces under a lamp.
fn scene(theta_i_deg: f64, interfaces: &str, photons: u64) -> String {
    format!(
        "[light]\ntheta_i_deg = {theta_i_deg:?}\n{interfaces}\n[run]\nphotons = {photons}\nseed = 7\ntheta_bins = 9\nphi_bins = 8\ninteractions_max = 100000\n"
    )
}

/// Towers of one cell with nearly vertical walls, a hundred times higher than wide.
fn towers() -> HeightMap {
    let edge = 8;
    let heights = (0..edge * edge).map(|n| {
        if (n % edge + n / edge) % 3 == 0 {
            1.0
        } else {
            0.0
        }
    });
    HeightMap::new(edge, heights.collect())
}

fn totals(text: &str, cancel: &AtomicBool) -> Result<Totals, SceneError> {
    let prepared = Scene::parse(text)?.prepare(&|_| Ok(towers()))?;
    Ok(run::trace(&prepared, Shard::WHOLE, &|_| {
        !cancel.load(Ordering::Relaxed)
    }))
}

fn energies(text: &str, cancel: &AtomicBool) -> Result<Energies<MonteCarloEstimate>, SceneError> {
    Ok(totals(text, cancel)?.energies())
}

/// Light in the direction bins of both sides per photon launched, with an upper bound of its standard error (the errors of
/// the bins are added as if of one sign).
fn caught(totals: &Totals) -> (f64, f64) {
    let grid = totals.grid();
    let (mut sum, mut std) = (0.0, 0.0);
    for side in [Side::Above, Side::Below] {
        for bin in 0..grid.per_side() {
            let e = totals.element(side, bin, 0);
            sum += e.value * grid.projected_solid_angle(bin);
            std += e.std * grid.projected_solid_angle(bin);
        }
    }
    (sum, std)
}

pub(super) fn rows(effort: CheckEffort, cancel: &AtomicBool) -> Vec<CheckRow> {
    let photons = if effort == CheckEffort::Quick {
        2_000
    } else {
        40_000
    };
    let mut rows = Vec::new();
    conserved(&mut rows, photons, cancel);
    smooth_limits(&mut rows, photons, cancel);
    // A photon that is split at each of thirty layers counts, and takes as long, as many. With fewer photons the 0.5 % that
    // growing layers reflect may not be sampled.
    stacks(&mut rows, photons.min(500), cancel);
    refusals(&mut rows);
    rows
}

const GLASS: &str = "below = { n = 1.5 }";

fn conserved(rows: &mut Vec<CheckRow>, photons: u64, cancel: &AtomicBool) {
    let field = |alpha_u: f64, alpha_v: f64, below: &str| {
        format!(
            "[[interface]]\nshape = \"beckmann\"\ncells = 64\nalpha_u = {alpha_u:?}\nalpha_v = {alpha_v:?}\n{below}"
        )
    };
    let facets = |alpha_u: f64, alpha_v: f64, below: &str| {
        format!(
            "[[interface]]\nshape = \"smith\"\nalpha_u = {alpha_u:?}\nalpha_v = {alpha_v:?}\n{below}"
        )
    };
    let smith = |alpha: f64, below: &str| facets(alpha, alpha, below);
    let ridges = |theta_r_deg: f64, below: &str| {
        format!(
            "[[interface]]\nshape = \"ridges\"\ntheta_r_deg = {theta_r_deg:?}\npitch_um = 100.0\n{below}"
        )
    };
    let walls = |below: &str| {
        format!(
            "[[interface]]\nshape = \"file\"\npath = \"towers\"\npitch_um = 1e-2\nheight_unit_um = 1.0\n{below}"
        )
    };
    let silver = "below = { n = 0.05, k = 30.0 }";
    let mirror = "below = { n = 1.0, k = 1e9 }";
    let cases = [
        ("field of alpha 1e-6", field(1e-6, 1e-6, GLASS), 30.0),
        ("field of alpha 1e3", field(1e3, 1e3, GLASS), 30.0),
        (
            "field of alpha_u over alpha_v 1e6",
            field(1.0, 1e-6, GLASS),
            30.0,
        ),
        (
            "field of alpha_v over alpha_u 1e6",
            field(1e-6, 1.0, GLASS),
            30.0,
        ),
        (
            "field, lamp 1e-7 degrees above the horizon",
            field(0.3, 0.3, GLASS),
            90.0 - 1e-7,
        ),
        ("field of k = 30", field(0.4, 0.4, silver), 60.0),
        ("field of a perfect mirror", field(0.4, 0.4, mirror), 60.0),
        ("facets of alpha 1e3", smith(1e3, GLASS), 30.0),
        ("facets of alpha 1e-6", smith(1e-6, GLASS), 30.0),
        (
            "facets of alpha_u over alpha_v 1e6",
            facets(1.0, 1e-6, GLASS),
            30.0,
        ),
        (
            "facets of alpha_v over alpha_u 1e6",
            facets(1e-6, 1.0, GLASS),
            30.0,
        ),
        ("facets of k = 30", smith(0.4, silver), 60.0),
        ("ridges of 85 degrees, k = 30", ridges(85.0, silver), 30.0),
        ("ridges of 85 degrees", ridges(85.0, GLASS), 80.0),
        ("ridges of 1e-6 degrees", ridges(1e-6, GLASS), 30.0),
        (
            "facets, lamp 1e-7 degrees above the horizon",
            smith(0.3, GLASS),
            90.0 - 1e-7,
        ),
        ("vertical walls of glass", walls(GLASS), 20.0),
        ("vertical walls of k = 30", walls(silver), 20.0),
        ("vertical walls, lamp straight above", walls(GLASS), 0.0),
        ("vertical walls, lamp at 89 degrees", walls(GLASS), 89.0),
    ];
    for (name, interfaces, theta) in cases {
        // Rays that cross a million cells before they hit the surface are slow, and slower where each of a thousand bounces
        // does, so few photons are traced.
        let long = theta > 89.9 || name.contains("1e3") || name.contains("walls");
        let photons = match (long, name.contains("field of alpha 1e3")) {
            (_, true) => (photons / 2_000).max(5),
            (true, false) => (photons / 200).max(10),
            (false, false) => photons,
        };
        let found = totals(&scene(theta, &interfaces, photons), cancel);
        let (sum, std) = found.as_ref().map_or((f64::NAN, f64::NAN), |t| {
            let (sum, std) = caught(t);
            let e = t.energies();
            (
                sum + e.absorbed.value + e.truncated.value,
                std.hypot(e.absorbed.std),
            )
        });
        rows.push(CheckRow::new(
            AREA,
            name,
            "R + T + A + dropped, per photon",
            ENERGY,
            sampled(1.0, std, sum),
        ));
        // A nearly level ray is dropped after a million cells, and counted as such.
        if 90.0 - theta < 1e-3 && interfaces.contains("beckmann") {
            continue;
        }
        let lost = found.as_ref().map_or((f64::NAN, f64::NAN), |t| {
            let lost = t.energies().truncated;
            (lost.value, lost.std)
        });
        rows.push(CheckRow::new(
            AREA,
            name,
            "dropped",
            ENERGY,
            sampled(0.0, lost.1, lost.0),
        ));
    }
}

fn smooth_limits(rows: &mut Vec<CheckRow>, photons: u64, cancel: &AtomicBool) {
    for shape in ["beckmann", "smith"] {
        for alpha in [1e-3, 1e-4, 1e-6] {
            for (theta, eta, k) in [(0.0, 1.5, 0.0), (56.0, 1.5, 0.0), (80.0, 1.5, 30.0)] {
                let cells = if shape == "beckmann" {
                    "cells = 64\n"
                } else {
                    ""
                };
                let interfaces = format!(
                    "[[interface]]\nshape = \"{shape}\"\n{cells}alpha_u = {alpha:?}\nalpha_v = {alpha:?}\nbelow = {{ n = {eta:?}, k = {k:?} }}"
                );
                let found = energies(&scene(theta, &interfaces, photons), cancel);
                let (value, std) = found.map_or((f64::NAN, f64::NAN), |e| {
                    (e.reflected_all.value, e.reflected_all.std)
                });
                let expected = fresnel::reflectance(f64::to_radians(theta).cos(), eta, k);
                // Slopes of size α change the angle of incidence by α; the sampling error is added.
                let mut judged = limit(expected, alpha, value);
                let both = judged.allowed.unwrap_or(0.0)
                    + sampled(expected, std, value).allowed.unwrap_or(0.0);
                judged.allowed = Some(both);
                judged.as_expected = (value - expected).abs() <= both;
                let name = format!("{shape} of alpha {alpha:e}, n = {eta} + {k}i at {theta}°");
                rows.push(CheckRow::new(
                    AREA,
                    name,
                    "R of the smooth surface",
                    LIMIT,
                    judged,
                ));
            }
        }
    }
    for shape in [
        "shape = \"beckmann\"\ncells = 64\nalpha_u = 0.4\nalpha_v = 0.4",
        "shape = \"flat\"",
    ] {
        let interfaces = format!("[[interface]]\n{shape}\nbelow = {{ n = 1.0 }}");
        let found = energies(&scene(60.0, &interfaces, photons), cancel);
        let value = found.map_or(f64::NAN, |e| e.transmitted_all.value);
        let name = format!("index 1 below: {}", shape.lines().next().unwrap_or(shape));
        rows.push(CheckRow::new(
            AREA,
            name,
            "T",
            LIMIT,
            digits(1.0, 1e3, value),
        ));
    }
    // An index step of 1e-12 reflects its square: all light is transmitted.
    let step = 1.0 + 1e-12;
    for shape in [
        "shape = \"beckmann\"\ncells = 64\nalpha_u = 0.4\nalpha_v = 0.4",
        "shape = \"smith\"\nalpha_u = 0.4\nalpha_v = 0.4",
        "shape = \"ridges\"\ntheta_r_deg = 20.0\npitch_um = 100.0",
        "shape = \"flat\"",
    ] {
        let interfaces = format!("[[interface]]\n{shape}\nbelow = {{ n = {step:?} }}");
        let found = energies(&scene(60.0, &interfaces, photons), cancel);
        let (through, back) = found.map_or((f64::NAN, f64::NAN), |e| {
            (e.transmitted_all.value, e.reflected_all.value)
        });
        let shape = shape.lines().next().unwrap_or(shape);
        let name = format!("index 1 + 1e-12 below: {shape}");
        let judged = limit(1.0, step - 1.0, through);
        rows.push(CheckRow::new(AREA, name.clone(), "T", LIMIT, judged));
        let judged = limit(0.0, step - 1.0, back);
        rows.push(CheckRow::new(AREA, name, "R", LIMIT, judged));
    }
}

fn stacks(rows: &mut Vec<CheckRow>, photons: u64, cancel: &AtomicBool) {
    let table = super::forms::stack_lines();
    for line in table.iter().filter(|l| l.theta_deg < 89.0) {
        let interfaces: String = line
            .indices
            .iter()
            .skip(1)
            .map(|n| {
                format!(
                    "[[interface]]\nshape = \"flat\"\nbelow = {{ n = {:?}, k = {:?} }}\n",
                    n.re, n.im
                )
            })
            .collect();
        let found = energies(&scene(line.theta_deg, &interfaces, photons), cancel);
        let (value, std) = found.map_or((f64::NAN, f64::NAN), |e| {
            (e.reflected_all.value, e.reflected_all.std)
        });
        let judged = sampled(0.5 * (line.rs + line.rp), std, value);
        rows.push(CheckRow::new(
            AREA,
            line.case.clone(),
            "R",
            "60-digit arithmetic",
            judged,
        ));
    }
}

fn refusals(rows: &mut Vec<CheckRow>) {
    let ridge = |theta: f64| {
        format!(
            "[[interface]]\nshape = \"ridges\"\ntheta_r_deg = {theta:?}\npitch_um = 100.0\n{GLASS}"
        )
    };
    let rough = |alpha: f64| {
        format!("[[interface]]\nshape = \"beckmann\"\nalpha_u = {alpha:?}\nalpha_v = 0.1\n{GLASS}")
    };
    for (name, text, word) in [
        (
            "ridges of 89.99 degrees",
            scene(10.0, &ridge(89.99), 10),
            "theta_r_deg = 89.99: must be 85 or less",
        ),
        ("roughness 0", scene(10.0, &rough(0.0), 10), "alpha_u = 0"),
        (
            "lamp at the horizon",
            scene(90.0, &ridge(10.0), 10),
            "theta_i_deg = 90: must be in [0, 90)",
        ),
        ("no interface", scene(10.0, "", 10), "no interface"),
        (
            "no photons",
            scene(10.0, &ridge(10.0), 0),
            "run.photons = 0",
        ),
    ] {
        let found = energies(&text, &AtomicBool::new(false))
            .map(|_| "traced".to_owned())
            .map_err(|e| e.to_string());
        rows.push(CheckRow::new(
            AREA,
            name,
            "energies",
            "no value is possible",
            refused(word, &found),
        ));
    }
}
