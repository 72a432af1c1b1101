//! Maps of the variants' errors: over ridge angle and roughness, and over the poses of the rig.

use crate::accuracy::full_scan;
use crate::accuracy::model_error::{MATERIALS, SurfaceErrors, summary};
use crate::colour::{Rgb, sequential};
use crate::figures::{
    ColourBar, DataSeries, Figure, HeatCell, Legend, Mark, NO_VALUE, Panel, PlotAxis, power_of_ten,
    with_true_minus,
};
use crate::units::Angle;

const PANEL_WIDTH: i32 = 440;
/// Height of a cell over ridge angle and roughness, and of one over the poses, px.
const ROW: i32 = 28;
const POSE_ROW: i32 = 22;

/// Title, unit and value of a map over ridge angle and roughness.
type ErrorMap = (
    &'static str,
    &'static str,
    fn(&SurfaceErrors) -> Option<f64>,
);

const MAPS: [ErrorMap; 4] = [
    ("paper, fitted: error of θr", "°", |c| {
        c.fitted[0].map(|m| m.theta_r_deg)
    }),
    ("sawtooth at the truth: worst pose", "%", |c| {
        Some(100.0 * c.closed[summary(&c.closed).1])
    }),
    ("sawtooth at the truth: rms", "%", |c| {
        Some(100.0 * summary(&c.closed).0)
    }),
    ("sawtooth, fitted: error of θr", "°", |c| {
        c.fitted[1].map(|m| m.theta_r_deg)
    }),
];

/// Decades of |error| from 10⁻³ to 10 in the unit of a panel; light for small ones.
fn colour(error: f64) -> Rgb {
    let share = (error.abs().max(1e-3).log10() + 3.0) / 4.0;
    sequential(1.0 - share)
}

fn colour_bar() -> ColourBar {
    let steps = (0..=256).map(|n| colour(10f64.powf(f64::from(n) / 64.0 - 3.0)));
    let decades = (-3..=1).map(|p| (f64::from(p + 3) / 4.0, power_of_ten(f64::from(p))));
    ColourBar {
        colours: steps.collect(),
        labels: decades.collect(),
        caption: "size of the error, in each panel’s unit".to_owned(),
    }
}

fn number(x: f64) -> String {
    let text = match x.abs() {
        a if a >= 10.0 => format!("{x:.0}"),
        a if a >= 1.0 => format!("{x:.1}"),
        a if a >= 0.1 => format!("{x:.2}"),
        _ => format!("{x:.3}"),
    };
    // What rounds to zero has no sign.
    match text.trim_start_matches(['-', '0', '.']) {
        "" => text.trim_start_matches('-').to_owned(),
        _ => with_true_minus(&text),
    }
}

/// Distinct values, rising.
fn distinct(cases: &[SurfaceErrors], of: fn(&SurfaceErrors) -> f64) -> Vec<f64> {
    let mut all: Vec<f64> = cases.iter().map(of).collect();
    all.sort_by(f64::total_cmp);
    all.dedup();
    all
}

fn cells(cells: Vec<HeatCell>) -> Vec<DataSeries> {
    vec![DataSeries::numbered(0, "", vec![Mark::Cells(cells)])]
}

/// Errors of one material over ridge angle and roughness.
fn over_surfaces(cases: &[SurfaceErrors], material: usize, (title, unit, of): ErrorMap) -> Panel {
    let ridges = distinct(cases, |c| c.theta_r_deg);
    let alphas = distinct(cases, |c| c.alpha);
    let mut drawn = Vec::new();
    for (row, ridge) in ridges.iter().enumerate() {
        for (column, alpha) in alphas.iter().enumerate() {
            let case = cases
                .iter()
                .find(|c| c.material == material && c.theta_r_deg == *ridge && c.alpha == *alpha);
            let value = case.and_then(of);
            drawn.push(HeatCell {
                centre: (column as f64, row as f64),
                colour: value.map_or(NO_VALUE, colour),
                text: value.map_or("–".to_owned(), number),
            });
        }
    }
    let names = |values: &[f64]| values.iter().map(f64::to_string).collect();
    Panel {
        title: format!("{} · {title} / {unit}", MATERIALS[material].0),
        x: PlotAxis::categories("roughness α", names(&alphas)),
        y: PlotAxis::categories("ridge angle θr / °", names(&ridges)),
        series: cells(drawn),
        own_px: Some((PANEL_WIDTH, ROW * ridges.len() as i32)),
        ..Panel::default()
    }
}

/// Errors of the sawtooth of one material over the poses, over all its surfaces.
fn over_poses(cases: &[SurfaceErrors], material: usize) -> Panel {
    let scan = full_scan();
    let azimuths = scan.azimuths().len();
    let drawn = scan.poses().enumerate().map(|(n, _)| {
        let own: Vec<f64> = cases
            .iter()
            .filter(|c| c.material == material)
            .map(|c| c.closed[n])
            .collect();
        let value = 100.0 * summary(&own).0;
        HeatCell {
            centre: ((n % azimuths) as f64, (n / azimuths) as f64),
            colour: colour(value),
            text: number(value),
        }
    });
    let degrees = |angle: Angle| with_true_minus(&format!("{:.0}", angle.deg()));
    let title = "sawtooth at the truth, rms over all surfaces";
    Panel {
        title: format!("{} · {title} / %", MATERIALS[material].0),
        x: PlotAxis::categories("azimuth φs / °", scan.azimuths().map(degrees).collect()),
        y: PlotAxis::categories("tilt θc / °", scan.tilts().map(degrees).collect()),
        series: cells(drawn.collect()),
        own_px: Some((PANEL_WIDTH, POSE_ROW * scan.tilts().len() as i32)),
        ..Panel::default()
    }
}

/// All maps as one figure; each material has a column.
pub(super) fn draw(cases: &[SurfaceErrors]) -> String {
    let materials = 0..MATERIALS.len();
    let maps = MAPS
        .iter()
        .flat_map(|map| materials.clone().map(|m| over_surfaces(cases, m, *map)));
    let poses = materials.clone().map(|m| over_poses(cases, m));
    let figure = Figure {
        title: "Errors against the ray tracer".to_owned(),
        note: "Percentages are of the brightest pose. – marks a fit that returned no ridge angle."
            .to_owned(),
        columns: MATERIALS.len(),
        legend: Legend::Colours(colour_bar()),
        panels: maps.chain(poses).collect(),
        ..Figure::default()
    };
    figure.svg()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_surface_and_every_pose_has_a_cell_in_each_material() {
        let poses = full_scan().poses().count();
        let cases: Vec<SurfaceErrors> = (0..MATERIALS.len())
            .map(|material| SurfaceErrors {
                material,
                theta_r_deg: 10.0,
                alpha: 0.1,
                closed: vec![0.001; poses],
                quadrature: vec![0.0; poses],
                paths: 64,
                noise: 0.0,
                fitted: [None; 2],
            })
            .collect();
        let svg = draw(&cases);
        let background = 1;
        let expected = background + MATERIALS.len() * (MAPS.len() + poses);
        assert_eq!(svg.matches("<rect").count(), expected);
        // A fit without an answer.
        assert_eq!(svg.matches(">\n–\n<").count(), 2 * MATERIALS.len());
    }

    #[test]
    fn numbers_have_a_true_minus_and_zero_has_no_sign() {
        assert_eq!(number(-0.36), "−0.36");
        assert_eq!(number(-0.0002), "0.000");
        assert_eq!(number(12.3), "12");
    }
}
