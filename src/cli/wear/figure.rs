//! Contrast over the ridge angle for each wear, and the optimum over the wear, as one figure.

use super::{Sweep, Wear};
use crate::colour::sequential;
use crate::figures::{DataSeries, Figure, Legend, Mark, Panel, PlotAxis, Stroke, Symbol};

/// Height of an interpolated curve.
fn on_line(points: &[(f64, f64)], x: f64) -> Option<f64> {
    let pair = points.windows(2).find(|w| (w[0].0..=w[1].0).contains(&x));
    let [(x0, y0), (x1, y1)] = pair?.try_into().ok()?;
    Some(y0 + (y1 - y0) * (x - x0) / (x1 - x0))
}

fn name(wear: Wear) -> String {
    match wear {
        Wear::Round(0.0) => "sharp".to_owned(),
        Wear::Round(w) => format!("R = {w} p"),
        Wear::Burr(w) => format!("h = {w} p"),
    }
}

/// One curve with a dot at its optimum; `share` from 0, sharp, to 1 for the greatest wear.
fn curve(sweep: &Sweep, share: f64) -> DataSeries {
    let values = sweep
        .points
        .iter()
        .map(|p| (p.theta_r_deg, p.contrast.value));
    let points: Vec<(f64, f64)> = values.collect();
    let optimum = sweep
        .optimum()
        .and_then(|best| Some((best.value, on_line(&points, best.value)?)));
    DataSeries {
        name: name(sweep.wear),
        // Without the palest part of the scale, which a white ground swallows.
        colour: sequential(0.82 * share),
        marks: vec![
            Mark::Line(points, Stroke::SOLID),
            Mark::Points(optimum.into_iter().collect(), Symbol::Dot),
        ],
        ..DataSeries::default()
    }
}

/// The optima of some sweeps over their wear.
fn optima(n: usize, name: &str, sweeps: &[&Sweep]) -> DataSeries {
    let points: Vec<(f64, f64)> = sweeps
        .iter()
        .filter_map(|s| {
            let (Wear::Round(wear) | Wear::Burr(wear)) = s.wear;
            Some((wear, s.optimum()?.value))
        })
        .collect();
    let line = Mark::Line(points.clone(), Stroke::SOLID);
    DataSeries::numbered(n, name, vec![line, Mark::Points(points, Symbol::Dot)])
}

/// The figure: rounded edges, burrs, optimum.
pub(super) fn draw(sweeps: &[Sweep]) -> String {
    let highest = |f: &dyn Fn(&super::WearPoint) -> f64| {
        let all = sweeps.iter().flat_map(|s| &s.points).map(f);
        all.fold(f64::MIN_POSITIVE, f64::max)
    };
    // The legend is above the curves.
    let y_max = 1.3 * highest(&|p| p.contrast.value);
    let x_max = highest(&|p| p.theta_r_deg);
    let rounded = |s: &&Sweep| matches!(s.wear, Wear::Round(_));
    let edges: Vec<&Sweep> = sweeps.iter().filter(rounded).collect();
    let sharp = sweeps.iter().find(|s| s.wear == Wear::Round(0.0));
    let burrs: Vec<&Sweep> = sharp
        .into_iter()
        .chain(sweeps.iter().filter(|s| !rounded(s)))
        .collect();
    let curves = |sweeps: &[&Sweep]| -> Vec<DataSeries> {
        let last = sweeps.len().saturating_sub(1).max(1) as f64;
        let numbered = sweeps.iter().enumerate();
        numbered.map(|(n, s)| curve(s, n as f64 / last)).collect()
    };
    let over_angle = |title: &str, sweeps: &[&Sweep]| Panel {
        title: title.to_owned(),
        x: PlotAxis::up_to("ridge angle θr before wear / °", x_max),
        y: PlotAxis::up_to("mean contrast / sr⁻¹", y_max),
        series: curves(sweeps),
        ..Panel::default()
    };
    let best = vec![
        optima(0, "rounded edges", &edges),
        optima(1, "burrs", &burrs),
    ];
    let all = edges.iter().chain(&burrs);
    let wears = all.filter(|s| s.optimum().is_some()).map(|s| {
        let (Wear::Round(wear) | Wear::Burr(wear)) = s.wear;
        wear
    });
    let worst = wears.fold(f64::MIN_POSITIVE, f64::max);
    let figure = Figure {
        columns: 3,
        panel_px: (330, 280),
        legend: Legend::Inside,
        panels: vec![
            over_angle("rounded edges of radius R", &edges),
            over_angle("burrs of mean height h on the crests", &burrs),
            Panel {
                title: "ridge angle of greatest contrast".to_owned(),
                x: PlotAxis::up_to("radius or mean burr height / facet length p", worst),
                y: PlotAxis::up_to("ridge angle θr / °", x_max),
                series: best,
                ..Panel::default()
            },
        ],
        ..Figure::default()
    };
    figure.svg()
}
