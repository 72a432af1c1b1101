//! One figure per scene: error against run time, both axes logarithmic, one series per method.

use super::{AccuracyPoint, levels_off, slope};
use crate::figures::{
    DataSeries, Figure, GREY, Legend, Mark, Panel, PlotAxis, Stroke, Symbol, with_true_minus,
};

/// The figure of one scene's points as SVG; `footer` names the machine.
#[must_use]
pub fn svg(scene: &str, points: &[&AccuracyPoint], footer: &str) -> String {
    let shown: Vec<&AccuracyPoint> = points
        .iter()
        .copied()
        .filter(|p| p.seconds > 0.0 && p.error > 0.0)
        .collect();
    let x = PlotAxis::logarithmic("run time / s", shown.iter().map(|p| p.seconds));
    let y = PlotAxis::logarithmic("error", shown.iter().map(|p| p.error));
    // Where a scene has several quantities, the names of the series state them.
    let quantity = match shown.first() {
        Some(p) if shown.iter().all(|q| q.quantity == p.quantity) => p.quantity.as_str(),
        Some(p) => p.quantity.split(", ").next().unwrap_or_default(),
        None => "no result",
    };
    let mut references: Vec<&str> = shown.iter().map(|p| p.reference.as_str()).collect();
    references.sort_unstable();
    references.dedup();
    let mut series: Vec<DataSeries> = Vec::new();
    series.extend(root_guide(&shown, y.ends().1));
    for (n, group) in groups(&shown).into_iter().enumerate() {
        let places: Vec<(f64, f64)> = group.iter().map(|p| (p.seconds, p.error)).collect();
        let marks = vec![
            Mark::Line(places.clone(), Stroke::SOLID),
            Mark::Points(places, Symbol::Dot),
        ];
        series.push(DataSeries {
            detail: match slope(&group) {
                _ if levels_off(&group) => "levels off".to_owned(),
                Some(s) => with_true_minus(&format!("slope {s:.2}")),
                None => String::new(),
            },
            ..DataSeries::numbered(n, name(group[0], &shown), marks)
        });
    }
    let figure = Figure {
        title: scene.to_owned(),
        note: quantity.to_owned(),
        footers: vec![
            format!("error against: {}", references.join("; ")),
            footer.to_owned(),
        ],
        columns: 1,
        panel_px: (460, 360),
        legend: Legend::Beside,
        panels: vec![Panel {
            x,
            y,
            series,
            ..Panel::default()
        }],
    };
    figure.svg()
}

/// Points that share a method and a quantity, in the order in which they came.
#[must_use]
pub fn groups<'a>(points: &[&'a AccuracyPoint]) -> Vec<Vec<&'a AccuracyPoint>> {
    let mut groups: Vec<Vec<&AccuracyPoint>> = Vec::new();
    for point in points {
        let same = |g: &&mut Vec<&AccuracyPoint>| {
            g[0].method == point.method && g[0].quantity == point.quantity
        };
        match groups.iter_mut().find(same) {
            Some(group) => group.push(point),
            None => groups.push(vec![point]),
        }
    }
    groups
}

/// The method, with the quantity where the figure has several.
fn name(point: &AccuracyPoint, all: &[&AccuracyPoint]) -> String {
    if all.iter().all(|p| p.quantity == point.quantity) {
        return point.method.clone();
    }
    let last = point.quantity.rsplit(", ").next().unwrap_or_default();
    format!("{} ({last})", point.method)
}

/// A guide of slope −½, as the error of a Monte Carlo method falls, above the tracer's own points and below `top`; `None`
/// without enough of them.
fn root_guide(points: &[&AccuracyPoint], top: f64) -> Option<DataSeries> {
    let traced: Vec<&&AccuracyPoint> = points
        .iter()
        .filter(|p| p.method == "split, polarised")
        .collect();
    let seconds = |f: fn(f64, f64) -> f64, from| traced.iter().map(|p| p.seconds).fold(from, f);
    let first = seconds(f64::min, f64::INFINITY);
    let last = seconds(f64::max, f64::NEG_INFINITY);
    if traced.len() < 3 || last <= first {
        return None;
    }
    // Somewhat above the highest point.
    let heights = traced.iter().map(|p| p.error * p.seconds.sqrt());
    let height = 1.4 * heights.fold(0.0, f64::max);
    let first = first.max((height / top).powi(2));
    let ends = [first, last].map(|s| (s, height / s.sqrt()));
    (first < last).then(|| DataSeries {
        name: "slope \u{2212}½".to_owned(),
        detail: "error by chance".to_owned(),
        colour: GREY,
        marks: vec![Mark::Line(ends.to_vec(), Stroke::DASHED)],
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_figure_has_a_line_per_method_and_names_its_reference() {
        let point = |method: &str, seconds: f64, error: f64| AccuracyPoint {
            scene: "s".to_owned(),
            method: method.to_owned(),
            seconds,
            error,
            quantity: "q".to_owned(),
            reference: "R & D".to_owned(),
        };
        let points = [
            point("first", 0.1, 1e-2),
            point("first", 1.0, 1e-3),
            point("second", 0.3, 1e-9),
            point("second", 0.4, 0.0),
        ];
        let text = svg("a < b", &points.iter().collect::<Vec<_>>(), "machine");
        for words in [
            "a &lt; b",
            "R &amp; D",
            "machine",
            "first",
            "second",
            "run time / s",
        ] {
            assert!(text.contains(words), "{words}");
        }
        // Three points and the two samples of the legend, each point on its white ground.
        assert_eq!(text.matches("<circle").count(), 3 + 3 + 2);
        assert!(!text.contains("NaN") && !text.contains("inf"));
    }
}
