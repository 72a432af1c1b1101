//! One picture per scene: error against seconds, both axes logarithmic, one line per method.

use std::fmt::Write;

use super::{LEVEL, Point, slope};

const WIDTH: f64 = 960.0;
const HEIGHT: f64 = 630.0;
/// Left, right, top, bottom of the axes.
const FRAME: [f64; 4] = [90.0, 640.0, 70.0, 520.0];
/// Colours that colour-blind eyes tell apart (Okabe and Ito).
const COLOURS: [&str; 8] = [
    "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000", "#999999",
];

/// The picture of one scene's points as SVG; `footer` names the machine.
#[must_use]
pub fn svg(scene: &str, points: &[&Point], footer: &str) -> String {
    let shown: Vec<&Point> = points
        .iter()
        .copied()
        .filter(|p| p.seconds > 0.0 && p.error > 0.0)
        .collect();
    let x = Axis::over(shown.iter().map(|p| p.seconds), FRAME[0], FRAME[1]);
    let y = Axis::over(shown.iter().map(|p| p.error), FRAME[3], FRAME[2]);
    let mut out = String::new();
    let mut put = |text: String| out.push_str(&text);
    put(format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {HEIGHT}\" font-family=\"Inter, Helvetica, Arial, sans-serif\" font-size=\"16\">\n\
         <rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n\
         <text x=\"{}\" y=\"34\" font-size=\"24\" font-weight=\"600\">{}</text>\n",
        FRAME[0],
        escaped(scene)
    ));
    // Where there are several, the methods' names say which.
    let quantity = match shown.first() {
        Some(p) if shown.iter().all(|q| q.quantity == p.quantity) => p.quantity.as_str(),
        Some(p) => p.quantity.split(", ").next().unwrap_or_default(),
        None => "error",
    };
    put(format!(
        "<text x=\"{}\" y=\"57\" fill=\"#444\">{}</text>\n",
        FRAME[0],
        escaped(quantity)
    ));
    for (value, at) in x.lines() {
        put(format!(
            "<line x1=\"{at:.1}\" x2=\"{at:.1}\" y1=\"{}\" y2=\"{}\" stroke=\"{}\"/>\n",
            FRAME[2],
            FRAME[3],
            shade(value)
        ));
    }
    for (value, at) in y.lines() {
        put(format!(
            "<line x1=\"{}\" x2=\"{}\" y1=\"{at:.1}\" y2=\"{at:.1}\" stroke=\"{}\"/>\n",
            FRAME[0],
            FRAME[1],
            shade(value)
        ));
    }
    for (value, at) in x.labels() {
        put(format!(
            "<text x=\"{at:.1}\" y=\"{}\" text-anchor=\"middle\">{}</text>\n",
            FRAME[3] + 24.0,
            number(value)
        ));
    }
    for (value, at) in y.labels() {
        put(format!(
            "<text x=\"{}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>\n",
            FRAME[0] - 8.0,
            at + 5.5,
            number(value)
        ));
    }
    put(format!(
        "<rect x=\"{}\" y=\"{}\" width=\"{}\" height=\"{}\" fill=\"none\" stroke=\"#444\"/>\n<text x=\"{}\" y=\"{}\" text-anchor=\"middle\">seconds</text>\n",
        FRAME[0],
        FRAME[2],
        FRAME[1] - FRAME[0],
        FRAME[3] - FRAME[2],
        0.5 * (FRAME[0] + FRAME[1]),
        FRAME[3] + 50.0
    ));
    if let Some([from, to]) = root_guide(&shown, &x, &y) {
        put(format!(
            "<line x1=\"{:.1}\" y1=\"{:.1}\" x2=\"{:.1}\" y2=\"{:.1}\" stroke=\"#777\" stroke-width=\"1.5\" stroke-dasharray=\"7 5\"/>\n<text x=\"{:.1}\" y=\"{:.1}\" fill=\"#555\" font-size=\"14\" stroke=\"white\" stroke-width=\"4\" paint-order=\"stroke\">slope \u{2212}½</text>\n",
            from.0,
            from.1,
            to.0,
            to.1,
            0.5 * (from.0 + to.0) + 8.0,
            0.5 * (from.1 + to.1) - 8.0
        ));
    }
    for (n, group) in groups(&shown).into_iter().enumerate() {
        let colour = COLOURS[n % COLOURS.len()];
        let mut places = String::new();
        for p in &group {
            let (px, py) = (x.at(p.seconds), y.at(p.error));
            let _ = write!(places, "{px:.1},{py:.1} ");
            put(format!(
                "<circle cx=\"{px:.1}\" cy=\"{py:.1}\" r=\"6\" fill=\"{colour}\"/>\n"
            ));
        }
        put(format!(
            "<polyline points=\"{places}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"3\" stroke-linejoin=\"round\"/>\n"
        ));
        let line = FRAME[2] + 14.0 + 48.0 * n as f64;
        let told = slope(&group).map_or(String::new(), |s| {
            if s > LEVEL {
                return "levels off".to_owned();
            }
            format!("slope {s:.2}").replace('-', "\u{2212}")
        });
        put(format!(
            "<rect x=\"{}\" y=\"{}\" width=\"14\" height=\"14\" fill=\"{colour}\"/>\n<text x=\"{}\" y=\"{}\">{}</text>\n<text x=\"{}\" y=\"{}\" fill=\"#555\" font-size=\"14\">{told}</text>\n",
            FRAME[1] + 22.0,
            line - 12.0,
            FRAME[1] + 44.0,
            line,
            escaped(&label(group[0], &shown)),
            FRAME[1] + 44.0,
            line + 18.0
        ));
    }
    let mut references: Vec<&str> = shown.iter().map(|p| p.reference.as_str()).collect();
    references.sort_unstable();
    references.dedup();
    put(format!(
        "<text x=\"{}\" y=\"{}\" font-size=\"13\" fill=\"#444\">error against: {}</text>\n<text x=\"{}\" y=\"{}\" font-size=\"13\" fill=\"#555\">{}</text>\n</svg>\n",
        FRAME[0] - 60.0,
        HEIGHT - 24.0,
        escaped(&references.join("; ")),
        FRAME[0] - 60.0,
        HEIGHT - 8.0,
        escaped(footer)
    ));
    out
}

/// Points that share a method and a quantity, in the order in which they came.
#[must_use]
pub fn groups<'a>(points: &[&'a Point]) -> Vec<Vec<&'a Point>> {
    let mut groups: Vec<Vec<&Point>> = Vec::new();
    for point in points {
        let same =
            |g: &&mut Vec<&Point>| g[0].method == point.method && g[0].quantity == point.quantity;
        match groups.iter_mut().find(same) {
            Some(group) => group.push(point),
            None => groups.push(vec![point]),
        }
    }
    groups
}

/// The method, with the quantity where the picture has several.
fn label(point: &Point, all: &[&Point]) -> String {
    if all.iter().all(|p| p.quantity == point.quantity) {
        return point.method.clone();
    }
    let last = point.quantity.rsplit(", ").next().unwrap_or_default();
    format!("{} ({last})", point.method)
}

/// A power of ten darker than what lies between.
fn shade(value: f64) -> &'static str {
    let power = value.log10();
    if (power - power.round()).abs() < 1e-9 {
        "#cfcfcf"
    } else {
        "#eeeeee"
    }
}

/// A value of an axis: as it is where it is short, else as a power of ten.
fn number(value: f64) -> String {
    let power = value.log10().floor();
    if (-3.0..4.0).contains(&value.log10()) {
        return format!("{value:.*}", (-power).max(0.0) as usize);
    }
    let factor = (value / 10f64.powf(power)).round();
    let factor = if factor == 1.0 {
        String::new()
    } else {
        format!("{factor:.0}·")
    };
    let power = format!("{power:.0}").replace('-', "\u{2212}");
    format!("{factor}10<tspan dy=\"-6\" font-size=\"11\">{power}</tspan>")
}

/// Ends in pixels of a line that falls with the root of the time, above the tracer's own points; `None` without any.
fn root_guide(points: &[&Point], x: &Axis, y: &Axis) -> Option<[(f64, f64); 2]> {
    let chance: Vec<&&Point> = points
        .iter()
        .filter(|p| p.method == "split, polarised")
        .collect();
    let seconds =
        |f: fn(f64, f64) -> f64, from: f64| chance.iter().map(|p| p.seconds).fold(from, f);
    let (first, last) = (
        seconds(f64::min, f64::INFINITY),
        seconds(f64::max, f64::NEG_INFINITY),
    );
    // A little higher than the highest point needs.
    let height = chance
        .iter()
        .map(|p| p.error * p.seconds.sqrt())
        .fold(0.0, f64::max)
        * 1.4;
    if chance.len() < 3 || last <= first {
        return None;
    }
    let top = 10f64.powf(y.high);
    // Where it would leave the frame it begins later.
    let first = first.max((height / top).powi(2));
    (first < last).then(|| [first, last].map(|s| (x.at(s), y.at(height / s.sqrt()))))
}

/// Text for XML and HTML.
#[must_use]
pub fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;")
}

/// Logarithms of positive values onto pixels, from one of 1, 2 and 5 times a power of ten to another.
struct Axis {
    low: f64,
    high: f64,
    from: f64,
    to: f64,
}

impl Axis {
    fn over(values: impl Iterator<Item = f64>, from: f64, to: f64) -> Axis {
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for v in values {
            low = low.min(v.log10());
            high = high.max(v.log10());
        }
        if low > high {
            (low, high) = (0.0, 1.0);
        }
        // A dot at an end of the axis stays inside.
        let room = (0.03 * (high - low)).max(0.04);
        let steps = || {
            let first = (low - room).floor() as i32 - 1;
            let last = (high + room).ceil() as i32 + 1;
            (first..=last).flat_map(|p| [1.0, 2.0, 5.0].map(|f: f64| f.log10() + f64::from(p)))
        };
        let low_end = steps()
            .filter(|s| *s <= low - room)
            .fold(low - room - 1.0, f64::max);
        let high_end = steps()
            .filter(|s| *s >= high + room)
            .fold(high + room + 1.0, f64::min);
        Axis {
            low: low_end,
            high: high_end,
            from,
            to,
        }
    }

    fn at(&self, value: f64) -> f64 {
        self.from + (self.to - self.from) * (value.log10() - self.low) / (self.high - self.low)
    }

    /// Of given factors times every so manyth power of ten, those on the axis with their places.
    fn on(&self, factors: &[f64], step: usize) -> Vec<(f64, f64)> {
        let (low, high) = (self.low.floor() as i32, self.high.ceil() as i32);
        (low..=high)
            .filter(|p| p.rem_euclid(step as i32) == 0)
            .flat_map(|p| factors.iter().map(move |f| f * 10f64.powi(p)))
            .filter(|v| {
                let log = v.log10();
                log > self.low - 1e-9 && log < self.high + 1e-9
            })
            .map(|v| (v, self.at(v)))
            .collect()
    }

    /// Powers of ten with their places, and what lies between where there is room.
    fn lines(&self) -> Vec<(f64, f64)> {
        match self.high - self.low {
            span if span <= 4.0 => self.on(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0], 1),
            _ => self.labels(),
        }
    }

    /// Values to be named with their places, not more than a dozen.
    fn labels(&self) -> Vec<(f64, f64)> {
        match self.high - self.low {
            span if span <= 3.0 => self.on(&[1.0, 2.0, 5.0], 1),
            span => self.on(&[1.0], 1 + (span / 12.0) as usize),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_has_a_line_per_method_and_names_its_reference() {
        let point = |method: &str, seconds: f64, error: f64| Point {
            scene: "s".to_owned(),
            method: method.to_owned(),
            seconds,
            error,
            quantity: "q".to_owned(),
            reference: "R & D".to_owned(),
        };
        let points = [
            point("a", 0.1, 1e-2),
            point("a", 1.0, 1e-3),
            point("b", 0.3, 1e-9),
            point("b", 0.4, 0.0),
        ];
        let text = svg("a < b", &points.iter().collect::<Vec<_>>(), "machine");
        assert_eq!(text.matches("<polyline").count(), 2);
        assert_eq!(text.matches("<circle").count(), 3);
        assert!(
            text.contains("a &lt; b") && text.contains("R &amp; D") && text.contains("machine")
        );
        assert!(!text.contains("NaN") && !text.contains("inf"));
    }

    #[test]
    fn an_axis_holds_its_values_between_round_ends_and_names_few_of_them() {
        for (low, high) in [(0.03, 0.04), (1e-5, 0.9), (1e-16, 1.0), (3.0, 3.0)] {
            let axis = Axis::over([low, high].into_iter(), 0.0, 100.0);
            let names = axis.labels();
            assert!((2..=14).contains(&names.len()), "{low} {high}: {names:?}");
            assert!(axis.at(low) > 0.0 && axis.at(high) < 100.0);
            assert!(
                names
                    .iter()
                    .all(|(_, at)| (-1e-6..=100.0 + 1e-6).contains(at))
            );
        }
        assert_eq!(number(0.02), "0.02");
        assert_eq!(number(20.0), "20");
        assert!(number(5e-7).starts_with("5·10"));
    }
}
