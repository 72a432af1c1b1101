//! Curves over the angle of reflection.

use crate::figures::{DataSeries, Figure, Legend, Mark, Panel, PlotAxis, Stroke, Symbol};
use crate::figures::{SERIES_COLOURS, with_true_minus};

/// One curve of a panel.
#[derive(Debug, Clone)]
pub(super) struct AngleCurve {
    /// For the legend.
    pub name: String,
    /// Angle in degrees, rising; value; half the height of the error bar. A value that is not finite is a gap.
    pub points: Vec<(f64, f64, f64)>,
}

/// How the values of a panel are read.
#[derive(Debug, Clone)]
pub(super) struct CurveValues {
    /// Their axis.
    pub axis: PlotAxis,
    /// Whether the two ends of the axis are one value, as of an angle: a curve that leaves at one end enters at the other.
    pub wraps: bool,
    /// Between neighbouring directions, degrees: points further apart are not joined.
    pub step_deg: f64,
}

/// One panel over angles from −90° to 90°.
pub(super) fn panel(title: &str, values: &CurveValues, curves: &[AngleCurve]) -> Panel {
    let ticks = [-60.0, -30.0, 0.0, 30.0, 60.0];
    let ticks = ticks.map(|t| (t, with_true_minus(&format!("{t}"))));
    let series = curves.iter().enumerate().map(|(n, curve)| {
        let known = curve.points.iter().filter(|p| p.1.is_finite());
        let bars = known.map(|&(angle, value, half)| (angle, wrapped(values, value), half));
        let mut marks = vec![Mark::ErrorBars(bars.collect())];
        let (alone, joined) = strokes(values, &curve.points)
            .into_iter()
            .partition::<Vec<_>, _>(|stroke| stroke.len() == 1);
        // A second curve may coincide with the first.
        let kind = match n {
            1 => Stroke::DASHED,
            _ => Stroke::SOLID,
        };
        marks.extend(joined.into_iter().map(|points| Mark::Line(points, kind)));
        marks.push(Mark::Points(alone.concat(), Symbol::SmallDot));
        DataSeries {
            name: curve.name.clone(),
            detail: String::new(),
            colour: SERIES_COLOURS[n % SERIES_COLOURS.len()],
            marks,
        }
    });
    Panel {
        title: title.to_owned(),
        x: PlotAxis::between("angle of reflection / °", (-90.0, 90.0), ticks.to_vec()),
        y: values.axis.clone(),
        series: series.collect(),
        ..Panel::default()
    }
}

/// Panels in rows of three.
pub(super) fn figure(title: &str, note: &str, panels: Vec<Panel>) -> String {
    let figure = Figure {
        title: title.to_owned(),
        note: note.to_owned(),
        columns: 3,
        panel_px: (270, 150),
        legend: match panels.first().is_some_and(|p| p.series.len() > 1) {
            true => Legend::Above,
            false => Legend::None,
        },
        panels,
        ..Figure::default()
    };
    figure.svg()
}

/// A value on an axis that wraps.
fn wrapped(values: &CurveValues, value: f64) -> f64 {
    let (low, high) = values.axis.ends();
    match values.wraps {
        true => low + (value - low).rem_euclid(high - low),
        false => value,
    }
}

/// The points in pieces that are each drawn without lifting the pen; a piece may be a single point.
fn strokes(values: &CurveValues, points: &[(f64, f64, f64)]) -> Vec<Vec<(f64, f64)>> {
    let (low, high) = values.axis.ends();
    let turn = high - low;
    let mut strokes: Vec<Vec<(f64, f64)>> = vec![Vec::new()];
    let mut last: Option<(f64, f64)> = None;
    for &(angle, value, _) in points {
        let value = wrapped(values, value);
        if !value.is_finite() || last.is_some_and(|(a, _)| angle - a > 1.5 * values.step_deg) {
            strokes.push(Vec::new());
            last = None;
        }
        if !value.is_finite() {
            continue;
        }
        if let Some((before, from)) = last
            && values.wraps
            && (value - from).abs() > 0.5 * turn
        {
            // The short way round: out over one end and in over the other.
            let (out, into, onward) = match value < from {
                true => (high, low, value + turn),
                false => (low, high, value - turn),
            };
            let edge = before + (angle - before) * (out - from) / (onward - from);
            strokes
                .last_mut()
                .into_iter()
                .for_each(|s| s.push((edge, out)));
            strokes.push(vec![(edge, into)]);
        }
        strokes
            .last_mut()
            .into_iter()
            .for_each(|s| s.push((angle, value)));
        last = Some((angle, value));
    }
    strokes.retain(|stroke| !stroke.is_empty());
    strokes
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drawn(wraps: bool, points: &[(f64, f64, f64)]) -> Vec<Vec<(f64, f64)>> {
        let values = CurveValues {
            axis: PlotAxis::between("b", (0.0, 1.0), Vec::new()),
            wraps,
            step_deg: 45.0,
        };
        strokes(&values, points)
    }

    #[test]
    fn a_gap_in_the_values_is_a_gap_in_the_curve_and_a_point_alone_is_drawn() {
        let points = [
            (-90.0, 0.0, 0.0),
            (-45.0, f64::NAN, 0.0),
            (0.0, 0.5, 0.0),
            (45.0, 0.5, 0.0),
            (90.0, 1.0, 0.1),
        ];
        let expected = [
            vec![(-90.0, 0.0)],
            vec![(0.0, 0.5), (45.0, 0.5), (90.0, 1.0)],
        ];
        assert_eq!(drawn(false, &points), expected);
        // So is a direction with dark ones around it.
        let apart = drawn(false, &[(-90.0, 0.0, 0.0), (0.0, 0.5, 0.0)]);
        assert_eq!(apart, [vec![(-90.0, 0.0)], vec![(0.0, 0.5)]]);
    }

    #[test]
    fn an_angle_that_wraps_leaves_at_one_end_and_enters_at_the_other() {
        let points = [(-45.0, 0.875, 0.0), (0.0, 1.125, 0.0), (45.0, 0.5, 0.0)];
        let expected = [
            vec![(-45.0, 0.875), (-22.5, 1.0)],
            vec![(-22.5, 0.0), (0.0, 0.125), (45.0, 0.5)],
        ];
        assert_eq!(drawn(true, &points), expected);
    }
}
