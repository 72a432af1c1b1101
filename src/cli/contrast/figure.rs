//! Bars of mean contrast after the paper's Fig. 8: over θc, θr and the pairs of azimuths.

use std::fmt::Write as _;

use super::super::axis::{signed, ticks};
use crate::model::contrast::{Mean, Table};

/// The bars of one panel.
type Means = fn(&Table) -> &[Mean];

const COLOURS: [&str; 3] = ["#1f77b4", "#d62728", "#7f7f7f"];
const PANEL_WIDTH: f64 = 300.0;
const PANEL_HEIGHT: f64 = 220.0;
const LEFT: f64 = 64.0;
const TOP: f64 = 44.0;
const GAP: f64 = 28.0;
/// Few bars do not fill their panel.
const BARS_WIDTH_MAX: f64 = 60.0;
/// As wide as a letter of the legend at most.
const LETTER: f64 = 7.0;

/// A stand-alone SVG; one colour per named table. A panel of one ridge angle alone would show the mean of
/// everything (and a measured table does not know its angle), so there is none.
pub(super) fn bars(tables: &[(&str, &Table)]) -> String {
    let all: [(&str, Means); 3] = [
        ("tilt θc / °", |t| &t.by_theta_c),
        ("ridge angle θr / °", |t| &t.by_theta_r),
        ("from azimuth to azimuth φs / °", |t| &t.by_phi_s),
    ];
    let axes: Vec<(&str, Means)> = all
        .into_iter()
        .enumerate()
        .filter(|(n, (_, of))| *n != 1 || tables.iter().any(|(_, t)| of(t).len() > 1))
        .map(|(_, axis)| axis)
        .collect();
    let top = tables
        .iter()
        .flat_map(|(_, t)| axes.iter().flat_map(|(_, of)| of(t)))
        .map(|m| m.contrast.absolute)
        .fold(0.0, f64::max)
        .max(1e-12);
    let ticks = ticks(top);
    let top = ticks.last().map_or(top, |(value, _)| *value);
    let width = LEFT + axes.len() as f64 * (PANEL_WIDTH + GAP);
    let height = TOP + PANEL_HEIGHT + 56.0;
    let mut svg = String::new();
    let _ = write!(
        svg,
        r##"<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" font-family="Inter, Helvetica, Arial, sans-serif" font-size="12">
<rect width="{width}" height="{height}" fill="white"/>
<text x="16" y="{}" transform="rotate(-90 16 {})" text-anchor="middle">mean contrast / sr⁻¹</text>
"##,
        TOP + 0.5 * PANEL_HEIGHT,
        TOP + 0.5 * PANEL_HEIGHT
    );
    let mut x = LEFT;
    for (n, (name, _)) in tables.iter().enumerate() {
        let colour = COLOURS[n % COLOURS.len()];
        let _ = writeln!(
            svg,
            r##"<rect x="{x}" y="12" width="12" height="12" fill="{colour}"/><text x="{}" y="22">{name}</text>"##,
            x + 18.0
        );
        x += 42.0 + LETTER * name.chars().count() as f64;
    }
    for (panel, (title, of)) in axes.iter().enumerate() {
        let x0 = LEFT + panel as f64 * (PANEL_WIDTH + GAP);
        let y0 = TOP + PANEL_HEIGHT;
        let settings: Vec<&str> = tables
            .first()
            .map(|(_, t)| of(t).iter().map(|m| m.setting.as_str()).collect())
            .unwrap_or_default();
        let slot = PANEL_WIDTH / settings.len().max(1) as f64;
        let group = (0.8 * slot).min(BARS_WIDTH_MAX);
        let bar = group / tables.len().max(1) as f64;
        for (value, label) in &ticks {
            let y = y0 - PANEL_HEIGHT * value / top;
            let _ = writeln!(
                svg,
                r##"<line x1="{x0}" x2="{}" y1="{y}" y2="{y}" stroke="#dddddd"/>"##,
                x0 + PANEL_WIDTH
            );
            if panel == 0 {
                let _ = writeln!(
                    svg,
                    r##"<text x="{}" y="{}" text-anchor="end">{label}</text>"##,
                    x0 - 6.0,
                    y + 4.0
                );
            }
        }
        for (j, setting) in settings.iter().enumerate() {
            // A pair of azimuths has a hyphen in it, an angle a minus sign before it.
            let shown = match setting.split_once('-') {
                Some((from, to)) if !from.is_empty() => format!("{from} → {to}"),
                _ => signed(setting),
            };
            let centre = x0 + slot * (j as f64 + 0.5);
            for (n, (name, table)) in tables.iter().enumerate() {
                let Some(mean) = of(table).iter().find(|m| m.setting == *setting) else {
                    continue;
                };
                let h = PANEL_HEIGHT * mean.contrast.absolute / top;
                let x = centre - 0.5 * group + bar * n as f64;
                let colour = COLOURS[n % COLOURS.len()];
                let _ = writeln!(
                    svg,
                    r##"<rect x="{x:.2}" y="{:.2}" width="{bar:.2}" height="{h:.2}" fill="{colour}"><title>{name}, {shown}: {:.5}, Michelson {:.4}</title></rect>"##,
                    y0 - h,
                    mean.contrast.absolute,
                    mean.contrast.michelson
                );
            }
            let _ = writeln!(
                svg,
                r##"<text x="{centre}" y="{}" text-anchor="middle">{shown}</text>"##,
                y0 + 16.0
            );
        }
        let _ = writeln!(
            svg,
            r##"<line x1="{x0}" x2="{}" y1="{y0}" y2="{y0}" stroke="black"/><text x="{}" y="{}" text-anchor="middle">{title}</text>"##,
            x0 + PANEL_WIDTH,
            x0 + 0.5 * PANEL_WIDTH,
            y0 + 36.0
        );
    }
    svg.push_str("</svg>\n");
    svg
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
        let table = predict(
            Tier::Closed(Variant::Sawtooth),
            &RigGeometry::IN_PLANE,
            &optics,
            &surface,
            &PAPER_RIDGES_DEG,
            &PAPER_TILTS_DEG,
        );
        let svg = bars(&[("predicted", &table), ("compared", &table)]);
        assert_eq!(svg.matches("<title>").count(), 2 * (5 + 4 + 2));
        assert!(svg.trim_end().ends_with("</svg>"));
        assert!(svg.contains(">−20<") && svg.contains(">0 → 90<"));
        let one = predict(
            Tier::Closed(Variant::Sawtooth),
            &RigGeometry::IN_PLANE,
            &optics,
            &surface,
            &[10.0],
            &PAPER_TILTS_DEG,
        );
        let svg = bars(&[("measured", &one)]);
        assert_eq!(svg.matches("<title>").count(), 5 + 2);
        assert!(!svg.contains("ridge angle"));
    }
}
