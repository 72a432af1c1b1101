//! Contrast over the ridge angle for each wear, and the optimum over the wear, as one SVG.

use std::fmt::Write as _;

use super::super::axis;
use super::{Sweep, Wear};

const WIDTH: f64 = 330.0;
const HEIGHT: f64 = 260.0;
const LEFT: f64 = 66.0;
const TOP: f64 = 40.0;
const GAP: f64 = 70.0;
/// Light to dark with the wear; readable in grey.
const COLOURS: [&str; 8] = [
    "#0b3c6f", "#1f6fb2", "#2a9d8f", "#7cb342", "#e9b44c", "#e07a3f", "#c2413b", "#7b2d5e",
];

struct Panel {
    x0: f64,
    x_max: f64,
    y_max: f64,
}

impl Panel {
    fn x(&self, x: f64) -> f64 {
        self.x0 + WIDTH * x / self.x_max
    }

    fn y(&self, y: f64) -> f64 {
        TOP + HEIGHT * (1.0 - y / self.y_max)
    }

    fn frame(&self, svg: &mut String, title: &str, x_name: &str, y_name: &str) {
        let (x1, y1) = (self.x0 + WIDTH, TOP + HEIGHT);
        let _ = writeln!(
            svg,
            r##"<text x="{}" y="{}" font-weight="bold">{title}</text><rect x="{}" y="{TOP}" width="{WIDTH}" height="{HEIGHT}" fill="none" stroke="#888"/>"##,
            self.x0,
            TOP - 12.0,
            self.x0
        );
        for (max, along_x) in [(self.x_max, true), (self.y_max, false)] {
            for (tick, label) in axis::ticks(max)
                .into_iter()
                .filter(|(tick, _)| *tick <= max * 1.0001)
            {
                let _ = if along_x {
                    let x = self.x(tick);
                    writeln!(
                        svg,
                        r##"<line x1="{x:.1}" x2="{x:.1}" y1="{y1}" y2="{}" stroke="#888"/><text x="{x:.1}" y="{}" text-anchor="middle">{label}</text>"##,
                        y1 + 4.0,
                        y1 + 17.0
                    )
                } else {
                    let y = self.y(tick);
                    writeln!(
                        svg,
                        r##"<line x1="{}" x2="{x1}" y1="{y:.1}" y2="{y:.1}" stroke="#e4e4e4"/><text x="{}" y="{:.1}" text-anchor="end">{label}</text>"##,
                        self.x0,
                        self.x0 - 6.0,
                        y + 4.0
                    )
                };
            }
        }
        let (xm, ym) = (self.x0 + 0.5 * WIDTH, TOP + 0.5 * HEIGHT);
        let _ = writeln!(
            svg,
            r##"<text x="{xm}" y="{}" text-anchor="middle">{x_name}</text><text x="{}" y="{ym}" transform="rotate(-90 {} {ym})" text-anchor="middle">{y_name}</text>"##,
            y1 + 36.0,
            self.x0 - 48.0,
            self.x0 - 48.0
        );
    }

    fn line(&self, svg: &mut String, points: &[(f64, f64)], colour: &str) {
        let path: Vec<String> = points
            .iter()
            .map(|(x, y)| format!("{:.1},{:.1}", self.x(*x), self.y(*y)))
            .collect();
        let _ = writeln!(
            svg,
            r##"<polyline points="{}" fill="none" stroke="{colour}" stroke-width="2"/>"##,
            path.join(" ")
        );
    }

    fn dot(&self, svg: &mut String, x: f64, y: f64, colour: &str) {
        let _ = writeln!(
            svg,
            r##"<circle cx="{:.1}" cy="{:.1}" r="4" fill="{colour}" stroke="white"/>"##,
            self.x(x),
            self.y(y)
        );
    }
}

/// Height of a drawn line.
fn on_line(points: &[(f64, f64)], x: f64) -> Option<f64> {
    let pair = points.windows(2).find(|w| (w[0].0..=w[1].0).contains(&x));
    let [(x0, y0), (x1, y1)] = pair?.try_into().ok()?;
    Some(y0 + (y1 - y0) * (x - x0) / (x1 - x0))
}

/// The figure: rounding, burrs, optimum.
pub(super) fn draw(sweeps: &[Sweep]) -> String {
    let highest = |f: &dyn Fn(&super::WearPoint) -> f64| {
        let all = sweeps.iter().flat_map(|s| &s.points).map(f);
        all.fold(f64::MIN_POSITIVE, f64::max)
    };
    let y_max = 1.08 * highest(&|p| p.contrast.value);
    let x_max = highest(&|p| p.theta_r_deg);
    let width = LEFT + 3.0 * (WIDTH + GAP);
    let height = TOP + HEIGHT + 50.0;
    let mut svg = format!(
        r##"<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" font-family="sans-serif" font-size="12">
<rect width="{width}" height="{height}" fill="white"/>
"##
    );
    let sharp = sweeps.iter().find(|s| s.wear == Wear::Round(0.0));
    let (mut worst_wear, mut optima) = (f64::MIN_POSITIVE, Vec::new());
    for (n, (title, is_round)) in [("rounded edges", true), ("burrs on the crests", false)]
        .into_iter()
        .enumerate()
    {
        let panel = Panel {
            x0: LEFT + n as f64 * (WIDTH + GAP),
            x_max,
            y_max,
        };
        panel.frame(
            &mut svg,
            title,
            "ridge angle θr before wear / °",
            "mean contrast / sr⁻¹",
        );
        let mut shown: Vec<&Sweep> = sweeps
            .iter()
            .filter(|s| matches!(s.wear, Wear::Round(_)) == is_round)
            .collect();
        if !is_round {
            shown.splice(0..0, sharp);
        }
        let mut line = Vec::new();
        for (i, sweep) in shown.into_iter().enumerate() {
            let colour = COLOURS[i % COLOURS.len()];
            let points: Vec<(f64, f64)> = sweep
                .points
                .iter()
                .map(|p| (p.theta_r_deg, p.contrast.value))
                .collect();
            panel.line(&mut svg, &points, colour);
            let (Wear::Round(wear) | Wear::Burr(wear)) = sweep.wear;
            if let Some(best) = sweep.optimum() {
                if let Some(at) = on_line(&points, best.value) {
                    panel.dot(&mut svg, best.value, at, colour);
                }
                line.push((wear, best.value));
                worst_wear = worst_wear.max(wear);
            }
            let (x, y) = (panel.x0 + WIDTH - 92.0, TOP + 16.0 + 15.0 * i as f64);
            let name = match sweep.wear {
                Wear::Round(0.0) => "sharp".to_owned(),
                Wear::Round(w) => format!("R = {w} p"),
                Wear::Burr(w) => format!("h = {w} p"),
            };
            let _ = writeln!(
                svg,
                r##"<line x1="{x}" x2="{}" y1="{}" y2="{}" stroke="{colour}" stroke-width="3"/><text x="{}" y="{y}">{name}</text>"##,
                x + 18.0,
                y - 4.0,
                y - 4.0,
                x + 24.0
            );
        }
        optima.push(line);
    }
    let panel = Panel {
        x0: LEFT + 2.0 * (WIDTH + GAP),
        x_max: worst_wear,
        y_max: x_max,
    };
    panel.frame(
        &mut svg,
        "where contrast is greatest",
        "radius or mean burr height / facet length p",
        "ridge angle of greatest contrast / °",
    );
    for (i, (line, name)) in optima.iter().zip(["rounded edges", "burrs"]).enumerate() {
        let colour = COLOURS[[1, 5][i]];
        panel.line(&mut svg, line, colour);
        for (x, y) in line {
            panel.dot(&mut svg, *x, *y, colour);
        }
        let _ = writeln!(
            svg,
            r##"<text x="{}" y="{}" fill="{colour}">{name}</text>"##,
            panel.x0 + WIDTH - 92.0,
            TOP + 18.0 + 16.0 * i as f64
        );
    }
    svg.push_str("</svg>\n");
    svg
}
