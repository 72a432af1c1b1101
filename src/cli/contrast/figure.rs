//! Bars of mean contrast after the paper's Fig. 8: over tilt, ridge angle and the pairs of azimuths.

use crate::figures::{DataSeries, Figure, Legend, Mark, Panel, PlotAxis, with_true_minus};
use crate::model::contrast::{Mean, Table};

/// The bars of one panel.
type Means = fn(&Table) -> &[Mean];

const PANEL_WIDTH: i32 = 300;
/// Of all bars of one setting together, as a share of its room; few settings do not fill their panel.
const BARS_SHARE: f64 = 0.8;
const BARS_WIDTH_MAX_PX: f64 = 60.0;

/// A figure with one series per named table. The panel over ridge angles appears only where a table has several of
/// them: a single bar would repeat the mean of everything, and a measured table does not know its angle.
pub(super) fn bars(tables: &[(&str, &Table)]) -> String {
    let all: [(&str, Means); 3] = [
        ("tilt θc / °", |t| &t.by_theta_c),
        ("ridge angle θr / °", |t| &t.by_theta_r),
        ("from azimuth to azimuth φs / °", |t| &t.by_phi_s),
    ];
    let panels: Vec<(&str, Means)> = all
        .into_iter()
        .enumerate()
        .filter(|(n, (_, of))| *n != 1 || tables.iter().any(|(_, t)| of(t).len() > 1))
        .map(|(_, panel)| panel)
        .collect();
    let means = tables
        .iter()
        .flat_map(|(_, t)| panels.iter().flat_map(|(_, of)| of(t)));
    let top = means.map(|m| m.contrast.absolute).fold(0.0, f64::max);
    let y = PlotAxis::from_zero("mean contrast / sr⁻¹", top);
    let figure = Figure {
        title: "Mean contrast after rotation".to_owned(),
        columns: panels.len(),
        panel_px: (PANEL_WIDTH, 220),
        legend: Legend::Above,
        panels: panels
            .into_iter()
            .map(|(label, of)| panel(tables, label, of, &y))
            .collect(),
        ..Figure::default()
    };
    figure.svg()
}

fn panel(tables: &[(&str, &Table)], label: &str, of: Means, y: &PlotAxis) -> Panel {
    let settings: Vec<&str> = tables
        .first()
        .map(|(_, t)| of(t).iter().map(|m| m.setting.as_str()).collect())
        .unwrap_or_default();
    let widest = BARS_WIDTH_MAX_PX * settings.len() as f64 / f64::from(PANEL_WIDTH);
    let group = BARS_SHARE.min(widest);
    let width = group / tables.len().max(1) as f64;
    let series = tables.iter().enumerate().map(|(n, (name, table))| {
        let first = 0.5 * (width - group) + width * n as f64;
        let bars = settings.iter().enumerate().filter_map(|(j, setting)| {
            let mean = of(table).iter().find(|m| m.setting == *setting)?;
            Some((j as f64 + first, width, mean.contrast.absolute))
        });
        DataSeries::numbered(n, *name, vec![Mark::Bars(bars.collect())])
    });
    Panel {
        series: series.collect(),
        x: PlotAxis::categories(label, settings.iter().map(|s| shown(s)).collect()),
        y: y.clone(),
        ..Panel::default()
    }
}

/// A setting as the axis names it: a pair of azimuths has a hyphen in it, an angle a minus sign before it.
fn shown(setting: &str) -> String {
    match setting.split_once('-') {
        Some((from, to)) if !from.is_empty() => format!("{from} → {to}"),
        _ => with_true_minus(setting),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Cones, RigGeometry};
    use crate::model::contrast::{PAPER_RIDGES_DEG, PAPER_TILTS_DEG, Tier, predict};
    use crate::model::{Optics, Surface, Variant};

    #[test]
    fn the_figure_has_a_bar_for_every_mean_of_every_table() {
        let optics = Optics {
            eta: 1.54,
            k: 0.0,
            theta_l: 0.17,
            cones: Cones::NONE,
        };
        let surface = Surface {
            theta_r: 0.0,
            alpha_u: 0.1,
            alpha_v: 0.1,
            rho_d: 0.3,
            amplitude: 1.0,
        };
        let table = |ridges_deg: &[f64]| {
            predict(
                Tier::Closed(Variant::Sawtooth),
                &RigGeometry::IN_PLANE,
                &optics,
                &surface,
                ridges_deg,
                &PAPER_TILTS_DEG,
            )
        };
        // The first rectangle is the background, and each table has one in the legend.
        let bars_of = |svg: &str, tables| svg.matches("<rect").count() - 1 - tables;
        let full = table(&PAPER_RIDGES_DEG);
        let svg = bars(&[("predicted", &full), ("compared", &full)]);
        assert_eq!(bars_of(&svg, 2), 2 * (5 + 4 + 2));
        assert!(svg.trim_end().ends_with("</svg>"));
        assert!(svg.contains(">\n−20\n<") && svg.contains(">\n0 → 90\n<"));
        let svg = bars(&[("measured", &table(&[10.0]))]);
        assert_eq!(bars_of(&svg, 1), 5 + 2);
        assert!(!svg.contains("ridge angle"));
    }
}
