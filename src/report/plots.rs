//! Figures of a report: observations with the fitted curve over the azimuth, and their residuals below, one column per
//! tilt. A figure has one row of tilts, so that no page break cuts it.

use super::{MeasurementReport, ReportedCurve};
use crate::figures::{
    DataSeries, Figure, Mark, Panel, PlotAxis, SERIES_COLOURS, Stroke, Symbol, with_true_minus,
};
use crate::fit::report::FittedObservation;
use crate::fit::uncertainty::coverage::COVERAGE_FACTOR;

/// Tilts in one row.
const COLUMNS: usize = 3;
const PANEL_PX: (i32, i32) = (178, 118);
const RESIDUALS_PX: (i32, i32) = (178, 58);
/// Tilts closer than this are one: positions of one tilt differ slightly.
const SAME_TILT_DEG: f64 = 0.25;

/// Returns the figures, one per row of tilts.
pub(super) fn figures(report: &MeasurementReport) -> Vec<String> {
    let fitted = &report.fit.result.fitted;
    let peak = fitted.iter().map(|o| o.signal).fold(0.0, f64::max);
    if peak <= 0.0 {
        return Vec::new();
    }
    let curves = report.curves.iter().flat_map(|curve| &curve.points);
    let top = curves.map(|point| point.1).fold(peak, f64::max);
    let signal = match report.absolute {
        true => "f cos θi / sr⁻¹",
        false => "signal, arbitrary unit",
    };
    let axes = Axes {
        azimuth: PlotAxis::between("azimuth φs / °", (0.0, 360.0), turn_ticks()),
        signal: PlotAxis::from_zero(signal, top),
        residual: residual_axis(fitted, peak),
        peak,
    };
    let rows = report.curves.chunks(COLUMNS);
    rows.map(|row| axes.row(row, fitted)).collect()
}

/// The axes that all panels share.
struct Axes {
    azimuth: PlotAxis,
    signal: PlotAxis,
    residual: PlotAxis,
    peak: f64,
}

impl Axes {
    fn row(&self, curves: &[ReportedCurve], fitted: &[FittedObservation]) -> String {
        let of_tilt = |curve: &ReportedCurve| -> Vec<FittedObservation> {
            let tilt = curve.theta_c_deg;
            let near = |o: &&FittedObservation| (o.theta_c_deg - tilt).abs() < SAME_TILT_DEG;
            fitted.iter().filter(near).copied().collect()
        };
        let above = curves.iter().map(|c| self.curve(c, &of_tilt(c)));
        let below = curves.iter().map(|c| self.residuals(&of_tilt(c)));
        let figure = Figure {
            columns: curves.len(),
            panel_px: PANEL_PX,
            panels: above.chain(below).collect(),
            ..Figure::default()
        };
        figure.svg()
    }

    fn curve(&self, curve: &ReportedCurve, observed: &[FittedObservation]) -> Panel {
        let line = DataSeries {
            colour: SERIES_COLOURS[1],
            marks: vec![Mark::Line(curve.points.clone(), Stroke::SOLID)],
            ..DataSeries::default()
        };
        let bars = observed
            .iter()
            .map(|o| (place(o), o.signal, COVERAGE_FACTOR * o.sigma));
        let dots = observed.iter().map(|o| (place(o), o.signal));
        let dots = DataSeries {
            colour: SERIES_COLOURS[0],
            marks: vec![
                Mark::ErrorBars(bars.collect()),
                Mark::Points(dots.collect(), Symbol::SmallDot),
            ],
            ..DataSeries::default()
        };
        Panel {
            title: with_true_minus(&format!("θc = {:.1}°", curve.theta_c_deg)),
            x: self.azimuth.clone(),
            y: self.signal.clone(),
            series: vec![line, dots],
            ..Panel::default()
        }
    }

    fn residuals(&self, observed: &[FittedObservation]) -> Panel {
        let percent = 100.0 / self.peak;
        let bars = observed.iter().map(|o| {
            let residual = percent * (o.signal - o.fitted);
            (place(o), residual, percent * COVERAGE_FACTOR * o.sigma)
        });
        let dots = observed
            .iter()
            .map(|o| (place(o), percent * (o.signal - o.fitted)));
        let zero = DataSeries {
            colour: SERIES_COLOURS[1],
            marks: vec![Mark::Line(vec![(0.0, 0.0), (360.0, 0.0)], Stroke::HAIRLINE)],
            ..DataSeries::default()
        };
        let dots = DataSeries {
            colour: SERIES_COLOURS[0],
            marks: vec![
                Mark::ErrorBars(bars.collect()),
                Mark::Points(dots.collect(), Symbol::SmallDot),
            ],
            ..DataSeries::default()
        };
        Panel {
            x: self.azimuth.clone(),
            y: self.residual.clone(),
            series: vec![zero, dots],
            own_px: Some(RESIDUALS_PX),
            ..Panel::default()
        }
    }
}

/// The azimuth of an observation within a turn.
fn place(observed: &FittedObservation) -> f64 {
    observed.phi_s_deg.rem_euclid(360.0)
}

fn turn_ticks() -> Vec<(f64, String)> {
    let quarters = [0.0, 90.0, 180.0, 270.0];
    let named = quarters.map(|deg| (deg, format!("{deg}")));
    // The next panel begins where a label of the end would be.
    named.into_iter().chain([(360.0, String::new())]).collect()
}

/// An axis about zero that holds all residuals, in per cent of the peak.
fn residual_axis(fitted: &[FittedObservation], peak: f64) -> PlotAxis {
    let residuals = fitted
        .iter()
        .map(|o| 100.0 * (o.signal - o.fitted).abs() / peak);
    let largest = residuals.fold(1e-3, f64::max);
    let (_, end) = PlotAxis::from_zero("", largest).ends();
    let decimals = (1.0 - end.log10().floor()).clamp(0.0, 6.0) as usize;
    let ticks = [-end, 0.0, end].map(|value| {
        let text = match value == 0.0 {
            true => "0".to_owned(),
            false => with_true_minus(&format!("{value:.decimals$}")),
        };
        (value, text)
    });
    PlotAxis::between("residual / %", (-end, end), ticks.to_vec())
}
