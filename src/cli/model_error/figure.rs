//! Maps of the variants' errors: over ridge angle and roughness, and over the rig's poses.

use std::fmt::Write as _;

use super::super::axis::signed;
use crate::accuracy::full_scan;
use crate::accuracy::model_error::{Cell, MATERIALS, summary};

const CELL: (f64, f64) = (64.0, 26.0);
const POSE: (f64, f64) = (30.0, 22.0);
const LEFT: f64 = 70.0;
const TOP: f64 = 96.0;
const GAP: f64 = 54.0;
/// A panel of few roughnesses is no narrower than its title.
const PANEL_MIN: f64 = 280.0;
/// Half of the label under a panel.
const LABEL_HALF: f64 = 90.0;

/// What is shown over ridge angle and roughness.
type Shown = (&'static str, &'static str, fn(&Cell) -> Option<f64>);

const MAPS: [Shown; 4] = [
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

/// Dark red for much, white for nothing: decades of |x| from 0.001 to 10.
fn colour(x: f64) -> (String, &'static str) {
    let share = ((x.abs().max(1e-3).log10() + 3.0) / 4.0).clamp(0.0, 1.0);
    let stops = [
        [255.0, 255.0, 255.0],
        [253.0, 219.0, 160.0],
        [239.0, 138.0, 98.0],
        [178.0, 24.0, 43.0],
        [70.0, 5.0, 40.0],
    ];
    let at = share * 4.0;
    let i = (at as usize).min(3);
    let mix = |j: usize| stops[i][j] + (at - i as f64) * (stops[i + 1][j] - stops[i][j]);
    let text = if share > 0.6 { "white" } else { "black" };
    (
        format!("rgb({:.0},{:.0},{:.0})", mix(0), mix(1), mix(2)),
        text,
    )
}

fn number(x: f64) -> String {
    let text = match x.abs() {
        a if a >= 10.0 => format!("{x:.0}"),
        a if a >= 1.0 => format!("{x:.1}"),
        a if a >= 0.1 => format!("{x:.2}"),
        _ => format!("{x:.3}"),
    };
    // What rounds to nothing has no sign.
    match text.trim_start_matches(['-', '0', '.']) {
        "" => text.trim_start_matches('-').to_owned(),
        _ => signed(&text),
    }
}

/// All maps as one SVG.
pub(super) fn draw(cells: &[Cell]) -> String {
    let distinct = |of: fn(&Cell) -> f64| {
        let mut all: Vec<f64> = cells.iter().map(of).collect();
        all.sort_by(f64::total_cmp);
        all.dedup();
        all
    };
    let (ridges, alphas) = (distinct(|c| c.theta_r_deg), distinct(|c| c.alpha));
    let panel_w = CELL.0 * alphas.len() as f64;
    let panel_h = CELL.1 * ridges.len() as f64;
    let scan = full_scan();
    let (tilts, azimuths) = (scan.tilts().len(), scan.azimuths().len());
    let pose_w = POSE.0 * azimuths as f64;
    let pose_h = POSE.1 * tilts as f64;
    let slot = panel_w.max(PANEL_MIN) + GAP;
    let width = LEFT + (MAPS.len() as f64 * slot).max(2.0 * (pose_w + GAP + LEFT));
    let height = TOP + 2.0 * (panel_h + 74.0) + pose_h + 60.0;
    let mut svg = format!(
        r##"<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" font-family="Inter, Helvetica, Arial, sans-serif" font-size="12">
<rect width="{width}" height="{height}" fill="white"/>
<text x="{LEFT}" y="20" font-size="14">Errors against the ray tracer; shares are of the brightest pose. Colours by size, in each panel’s unit:</text>
"##
    );
    let text = |svg: &mut String, x: f64, y: f64, anchor: &str, words: &str, fill: &str| {
        let _ = writeln!(
            svg,
            r##"<text x="{x:.1}" y="{y:.1}" text-anchor="{anchor}" fill="{fill}">{words}</text>"##
        );
    };
    for (n, words) in ["0.001", "0.01", "0.1", "1", "10"].iter().enumerate() {
        let (fill, ink) = colour(10f64.powi(n as i32 - 3));
        let x = LEFT + CELL.0 * n as f64;
        let _ = writeln!(
            svg,
            r##"<rect x="{x:.1}" y="30" width="{}" height="22" fill="{fill}" stroke="#bbb"/>"##,
            CELL.0
        );
        text(&mut svg, x + 0.5 * CELL.0, 45.0, "middle", words, ink);
    }
    for (material, (name, ..)) in MATERIALS.iter().enumerate() {
        let y0 = TOP + material as f64 * (panel_h + 74.0);
        for (n, (title, unit, of)) in MAPS.iter().enumerate() {
            let x0 = LEFT + n as f64 * slot;
            text(
                &mut svg,
                x0,
                y0 - 8.0,
                "start",
                &format!("{name} · {title} / {unit}"),
                "black",
            );
            for (r, ridge) in ridges.iter().enumerate() {
                let y = y0 + CELL.1 * (ridges.len() - 1 - r) as f64;
                text(
                    &mut svg,
                    x0 - 5.0,
                    y + 17.0,
                    "end",
                    &format!("{ridge}°"),
                    "black",
                );
                for (a, alpha) in alphas.iter().enumerate() {
                    let x = x0 + CELL.0 * a as f64;
                    let found = cells.iter().find(|c| {
                        c.material == material && c.theta_r_deg == *ridge && c.alpha == *alpha
                    });
                    let value = found.and_then(of);
                    let (fill, ink) = value.map_or(("#ddd".to_owned(), "black"), colour);
                    let _ = writeln!(
                        svg,
                        r##"<rect x="{x:.1}" y="{y:.1}" width="{}" height="{}" fill="{fill}" stroke="#bbb"/>"##,
                        CELL.0, CELL.1
                    );
                    let words = value.map_or("–".to_owned(), number);
                    text(&mut svg, x + 0.5 * CELL.0, y + 17.0, "middle", &words, ink);
                }
            }
            for (a, alpha) in alphas.iter().enumerate() {
                let x = x0 + CELL.0 * (a as f64 + 0.5);
                text(
                    &mut svg,
                    x,
                    y0 + panel_h + 15.0,
                    "middle",
                    &format!("{alpha}"),
                    "black",
                );
            }
            let x = x0 + (0.5 * panel_w).max(LABEL_HALF);
            let y = y0 + panel_h + 32.0;
            text(
                &mut svg,
                x,
                y,
                "middle",
                "roughness α (rows: ridge angle)",
                "black",
            );
        }
    }
    let y0 = TOP + 2.0 * (panel_h + 74.0);
    for (material, (name, ..)) in MATERIALS.iter().enumerate() {
        let x0 = LEFT + material as f64 * (pose_w + GAP + LEFT);
        let title = format!("{name} · sawtooth at the truth, rms over all surfaces by pose / %");
        text(&mut svg, x0, y0 - 8.0, "start", &title, "black");
        for (n, pose) in scan.poses().enumerate() {
            let (t, a) = (n / azimuths, n % azimuths);
            let own: Vec<f64> = cells
                .iter()
                .filter(|c| c.material == material)
                .map(|c| c.closed[n])
                .collect();
            let value = 100.0 * summary(&own).0;
            let (x, y) = (x0 + POSE.0 * a as f64, y0 + POSE.1 * (tilts - 1 - t) as f64);
            let (fill, _) = colour(value);
            let _ = writeln!(
                svg,
                r##"<rect x="{x:.1}" y="{y:.1}" width="{}" height="{}" fill="{fill}" stroke="#bbb"><title>{}</title></rect>"##,
                POSE.0,
                POSE.1,
                number(value)
            );
            if a == 0 {
                let words = signed(&format!("{:.0}°", pose.theta_c.deg()));
                text(&mut svg, x0 - 5.0, y + 16.0, "end", &words, "black");
            }
            if t == 0 && a % 3 == 0 {
                let words = format!("{:.0}°", pose.phi_s.deg());
                text(
                    &mut svg,
                    x + 0.5 * POSE.0,
                    y0 + pose_h + 15.0,
                    "middle",
                    &words,
                    "black",
                );
            }
        }
        let (x, y) = (x0 + 0.5 * pose_w, y0 + pose_h + 32.0);
        text(
            &mut svg,
            x,
            y,
            "middle",
            "azimuth φs (rows: tilt θc)",
            "black",
        );
    }
    svg.push_str("</svg>\n");
    svg
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn titles_of_one_surface_alone_do_not_lie_over_each_other() {
        let cells: Vec<Cell> = (0..MATERIALS.len())
            .map(|material| Cell {
                material,
                theta_r_deg: 10.0,
                alpha: 0.1,
                closed: vec![0.001; full_scan().poses().count()],
                quadrature: vec![0.0; full_scan().poses().count()],
                paths: 64,
                noise: 0.0,
                fitted: [None; 2],
            })
            .collect();
        let svg = draw(&cells);
        let at = |title: &str| -> f64 {
            let line = svg.lines().find(|l| l.contains(title)).expect(title);
            let x = line.split("x=\"").nth(1).expect("an x").split('"').next();
            x.expect("a number").parse().expect("a number")
        };
        let starts: Vec<f64> = MAPS
            .iter()
            .map(|(title, ..)| at(&format!("{} · {title}", MATERIALS[0].0)))
            .collect();
        for (n, pair) in starts.windows(2).enumerate() {
            // Of 12 px, a letter is some 6 wide; a few are for the unit.
            let room = 6.0 * (MATERIALS[0].0.len() + MAPS[n].0.len() + 7) as f64;
            assert!(pair[1] - pair[0] > room, "{pair:?} {room}");
        }
    }

    #[test]
    fn numbers_have_a_true_minus_and_nothing_has_none() {
        assert_eq!(number(-0.36), "−0.36");
        assert_eq!(number(-0.0002), "0.000");
        assert_eq!(number(12.3), "12");
    }
}
