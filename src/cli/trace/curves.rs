//! Curves over the angle of reflection as panels of one SVG.

use std::fmt::Write as _;

use super::hemisphere::escaped;

const COLOURS: [&str; 4] = ["#2166ac", "#b2182b", "#4d9221", "#666666"];
const WIDTH: f64 = 250.0;
const HEIGHT: f64 = 130.0;
const LEFT: f64 = 58.0;
const TOP: f64 = 64.0;
const GAP_X: f64 = 22.0;
const GAP_Y: f64 = 40.0;
/// Radius of a point without neighbours.
const MARKER: f64 = 2.4;

/// A line of (angle in degrees, value, half the height of its error bar).
#[derive(Debug, Clone)]
pub(super) struct Line {
    /// For the legend.
    pub name: String,
    /// Points by rising angle; a gap where the value is not finite.
    pub points: Vec<(f64, f64, f64)>,
}

/// One panel.
#[derive(Debug, Clone)]
pub(super) struct Panel {
    /// Above it.
    pub title: String,
    /// Beside it.
    pub axis: String,
    /// Lowest and highest value.
    pub range: (f64, f64),
    /// Whether the lowest is the highest again, as of an angle: what leaves on one side comes in on the other.
    pub turns: bool,
    /// Values that get a label and a line.
    pub ticks: Vec<f64>,
    /// Between neighbours in angle, degrees: where points are further apart nothing is known between them.
    pub step_deg: f64,
    /// At most four.
    pub lines: Vec<Line>,
}

/// Panels in rows of `columns`, over angles from −90° to 90°.
pub(super) fn panels(title: &str, note: &str, columns: usize, panels: &[Panel]) -> String {
    let rows = panels.len().div_ceil(columns);
    let width = LEFT + columns as f64 * (WIDTH + GAP_X) + 8.0;
    let height = TOP + rows as f64 * (HEIGHT + GAP_Y) + 12.0;
    let mut svg = String::new();
    let _ = writeln!(
        svg,
        r##"<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}" font-family="DejaVu Sans, Verdana, sans-serif" font-size="10" fill="#282828">
<rect width="{width}" height="{height}" fill="white"/>
<text x="{LEFT}" y="22" font-size="16">{}</text>
<text x="{LEFT}" y="40" font-size="11" fill="#606060">{}</text>"##,
        escaped(title),
        escaped(note)
    );
    for (n, panel) in panels.iter().enumerate() {
        let (column, row) = (n % columns, n / columns);
        let x = LEFT + column as f64 * (WIDTH + GAP_X);
        let y = TOP + row as f64 * (HEIGHT + GAP_Y);
        draw(&mut svg, panel, x, y, column == 0, row + 1 == rows);
    }
    svg.push_str("</svg>\n");
    svg
}

fn draw(svg: &mut String, panel: &Panel, x: f64, y: f64, first: bool, last: bool) {
    let (low, high) = panel.range;
    let at_x = |angle: f64| x + (angle + 90.0) / 180.0 * WIDTH;
    let at_y = |value: f64| {
        let share = ((value - low) / (high - low)).clamp(-0.02, 1.02);
        y + HEIGHT * (1.0 - share)
    };
    let _ = writeln!(
        svg,
        r##"<text x="{x}" y="{}" font-size="11">{}</text>"##,
        y - 6.0,
        escaped(&panel.title)
    );
    for &tick in &panel.ticks {
        let ty = at_y(tick);
        let _ = writeln!(
            svg,
            r##"<path d="M{x} {ty:.1}h{WIDTH}" stroke="#dddddd" stroke-width="0.7"/>"##
        );
        if first {
            let label = format!("{}", (tick * 1e4).round() / 1e4).replace('-', "−");
            let _ = writeln!(
                svg,
                r##"<text x="{}" y="{:.1}" text-anchor="end">{label}</text>"##,
                x - 5.0,
                ty + 3.5
            );
        }
    }
    for angle in [-60, -30, 0, 30, 60] {
        let tx = at_x(f64::from(angle));
        let _ = writeln!(
            svg,
            r##"<path d="M{tx:.1} {y}v{HEIGHT}" stroke="#eeeeee" stroke-width="0.7"/>"##
        );
        let label = format!("{angle}°").replace('-', "−");
        let _ = writeln!(
            svg,
            r##"<text x="{tx:.1}" y="{:.1}" text-anchor="middle">{label}</text>"##,
            y + HEIGHT + 13.0
        );
    }
    if first {
        let middle = y + 0.5 * HEIGHT;
        let _ = writeln!(
            svg,
            r##"<text x="{0}" y="{middle}" transform="rotate(-90 {0} {middle})" text-anchor="middle" font-size="11">{1}</text>"##,
            x - 42.0,
            escaped(&panel.axis)
        );
    }
    if last {
        let _ = writeln!(
            svg,
            r##"<text x="{}" y="{}" text-anchor="middle" fill="#606060">angle of reflection</text>"##,
            x + 0.5 * WIDTH,
            y + HEIGHT + 27.0
        );
    }
    for (n, line) in panel.lines.iter().enumerate() {
        let colour = COLOURS[n % COLOURS.len()];
        let marks = Marks::of(panel, line, &at_x, &at_y);
        let Marks { path, bars, alone } = &marks;
        // A second line may lie on the first all along.
        let dash = if n == 1 {
            r#" stroke-dasharray="4 3.5""#
        } else {
            ""
        };
        let _ = writeln!(
            svg,
            r##"<path d="{bars}" stroke="{colour}" stroke-opacity="0.35" stroke-width="2" fill="none"/><path d="{path}" stroke="{colour}" stroke-width="1.4" stroke-linecap="round" fill="none"{dash}/>"##
        );
        for (px, py) in alone {
            let _ = writeln!(
                svg,
                r##"<circle cx="{px:.1}" cy="{py:.1}" r="{MARKER}" fill="{colour}"/>"##
            );
        }
        if panel.lines.len() > 1 {
            let (lx, ly) = (x + 8.0, y + 12.0 + 13.0 * n as f64);
            let _ = writeln!(
                svg,
                r##"<path d="M{lx} {ly}h14" stroke="{colour}" stroke-width="2"{dash}/><text x="{}" y="{}">{}</text>"##,
                lx + 18.0,
                ly + 3.5,
                escaped(&line.name)
            );
        }
    }
    let _ = writeln!(
        svg,
        r##"<rect x="{x}" y="{y}" width="{WIDTH}" height="{HEIGHT}" fill="none" stroke="#888888" stroke-width="0.8"/>"##
    );
}

/// What is drawn of a line.
#[derive(Debug, Default)]
struct Marks {
    path: String,
    bars: String,
    /// Points without neighbours, which no stroke shows.
    alone: Vec<(f64, f64)>,
}

impl Marks {
    fn of(
        panel: &Panel,
        line: &Line,
        at_x: &dyn Fn(f64) -> f64,
        at_y: &dyn Fn(f64) -> f64,
    ) -> Self {
        let (low, high) = panel.range;
        let turn = high - low;
        let mut marks = Marks::default();
        let mut stroke: Vec<(f64, f64)> = Vec::new();
        for &(angle, value, half) in &line.points {
            if !value.is_finite() {
                marks.end(&mut stroke, at_x, at_y);
                continue;
            }
            let value = match panel.turns {
                true => low + (value - low).rem_euclid(turn),
                false => value,
            };
            if let Some(&(before, from)) = stroke.last() {
                if angle - before > 1.5 * panel.step_deg {
                    marks.end(&mut stroke, at_x, at_y);
                } else if panel.turns && (value - from).abs() > 0.5 * turn {
                    // The short way round, out over one side and in over the other.
                    let (out, into, on) = match value < from {
                        true => (high, low, value + turn),
                        false => (low, high, value - turn),
                    };
                    let edge = before + (angle - before) * (out - from) / (on - from);
                    stroke.push((edge, out));
                    marks.end(&mut stroke, at_x, at_y);
                    stroke.push((edge, into));
                }
            }
            stroke.push((angle, value));
            if half > 0.0 {
                let (px, from, to) = (at_x(angle), at_y(value - half), at_y(value + half));
                let _ = write!(marks.bars, "M{px:.1} {from:.1}V{to:.1}");
            }
        }
        marks.end(&mut stroke, at_x, at_y);
        marks
    }

    /// Draws what is together and lifts the pen.
    fn end(
        &mut self,
        stroke: &mut Vec<(f64, f64)>,
        at_x: &dyn Fn(f64) -> f64,
        at_y: &dyn Fn(f64) -> f64,
    ) {
        let mut places = stroke
            .drain(..)
            .map(|(angle, value)| (at_x(angle), at_y(value)));
        let Some(first) = places.next() else {
            return;
        };
        let mut places = places.peekable();
        if places.peek().is_none() {
            self.alone.push(first);
            return;
        }
        let _ = write!(self.path, "M{:.1} {:.1}", first.0, first.1);
        for (px, py) in places {
            let _ = write!(self.path, "L{px:.1} {py:.1}");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drawn(turns: bool, points: &[(f64, f64, f64)]) -> String {
        let panel = Panel {
            title: "a".to_owned(),
            axis: "b".to_owned(),
            range: (0.0, 1.0),
            turns,
            ticks: vec![0.0, 1.0],
            step_deg: 45.0,
            lines: vec![Line {
                name: "c".to_owned(),
                points: points.to_vec(),
            }],
        };
        panels("t", "n", 1, &[panel])
    }

    #[test]
    fn a_gap_in_the_values_is_a_gap_in_the_line_and_a_point_alone_is_seen() {
        let svg = drawn(
            false,
            &[
                (-90.0, 0.0, 0.0),
                (-45.0, f64::NAN, 0.0),
                (0.0, 0.5, 0.0),
                (45.0, 0.5, 0.0),
                (90.0, 1.0, 0.1),
            ],
        );
        assert!(
            svg.contains(r#"d="M183.0 129.0L245.5 129.0L308.0 64.0""#),
            "{svg}"
        );
        assert!(svg.contains(r#"<circle cx="58.0" cy="194.0""#), "{svg}");
        // So is a direction with darkness around it.
        let svg = drawn(false, &[(-90.0, 0.0, 0.0), (0.0, 0.5, 0.0)]);
        assert_eq!(svg.matches("<circle").count(), 2);
    }

    #[test]
    fn an_angle_that_turns_round_leaves_on_one_side_and_comes_in_on_the_other() {
        let svg = drawn(
            true,
            &[(-45.0, 0.9, 0.0), (0.0, 1.1, 0.0), (45.0, 0.3, 0.0)],
        );
        assert!(
            svg.contains(r#"d="M120.5 77.0L151.8 64.0M151.8 194.0L183.0 181.0L245.5 155.0""#),
            "{svg}"
        );
    }
}
