//! Axes: where values lie, which of them are labelled, and how numbers are written.

use std::ops::Range;

use plotters::coord::ranged1d::{KeyPointHint, NoDefaultFormatting, Ranged, ValueFormatter};

/// One axis of a panel. Its ends and ticks are fixed when it is made.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PlotAxis {
    /// The quantity with its unit.
    pub label: String,
    /// Lowest value.
    pub(super) low: f64,
    /// Highest value.
    pub(super) high: f64,
    /// Values that have a label, and a grid line.
    pub(super) ticks: Vec<(f64, String)>,
    /// Values that have only a fine grid line.
    pub(super) fine: Vec<f64>,
    pub(super) is_logarithmic: bool,
    pub(super) has_grid: bool,
}

impl PlotAxis {
    /// From zero to the first round number that holds `max`.
    #[must_use]
    pub fn from_zero(label: &str, max: f64) -> Self {
        let ticks = round_ticks(max.max(1e-12));
        PlotAxis {
            high: ticks.last().map_or(max, |t| t.0),
            ..PlotAxis::between(label, (0.0, 1.0), ticks)
        }
    }

    /// From zero to `max` itself, with round numbers up to there.
    #[must_use]
    pub fn up_to(label: &str, max: f64) -> Self {
        let max = max.max(1e-12);
        let mut ticks = round_ticks(max);
        ticks.retain(|(value, _)| *value <= max * 1.0001);
        PlotAxis::between(label, (0.0, max), ticks)
    }

    /// With the stated ends and ticks.
    #[must_use]
    pub fn between(label: &str, (low, high): (f64, f64), ticks: Vec<(f64, String)>) -> Self {
        PlotAxis {
            label: label.to_owned(),
            low,
            high,
            ticks,
            fine: Vec::new(),
            is_logarithmic: false,
            has_grid: true,
        }
    }

    /// One unit of length for each name; the first is at 0.
    #[must_use]
    pub fn categories(label: &str, names: Vec<String>) -> Self {
        let high = names.len().max(1) as f64 - 0.5;
        let ticks = names.into_iter().enumerate();
        let ticks = ticks.map(|(n, name)| (n as f64, name)).collect();
        PlotAxis {
            has_grid: false,
            ..PlotAxis::between(label, (-0.5, high), ticks)
        }
    }

    /// Without label, ticks and grid.
    #[must_use]
    pub fn hidden(low: f64, high: f64) -> Self {
        PlotAxis::between("", (low, high), Vec::new())
    }

    /// Logarithmic, from one of 1, 2 and 5 times a power of ten to another; values that are not positive are ignored.
    #[must_use]
    pub fn logarithmic(label: &str, values: impl Iterator<Item = f64>) -> Self {
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for v in values.filter(|v| *v > 0.0 && v.is_finite()) {
            low = low.min(v.log10());
            high = high.max(v.log10());
        }
        if low > high {
            (low, high) = (0.0, 1.0);
        }
        // A point at an end of the axis stays inside.
        let margin = (0.03 * (high - low)).max(0.04);
        let steps = || {
            let (first, last) = (low.floor() as i32 - 2, high.ceil() as i32 + 2);
            (first..=last).flat_map(|p| [1.0, 2.0, 5.0].map(|f: f64| f.log10() + f64::from(p)))
        };
        let low = steps()
            .filter(|s| *s <= low - margin)
            .fold(low - 3.0, f64::max);
        let high = steps()
            .filter(|s| *s >= high + margin)
            .fold(high + 3.0, f64::min);
        let on = |factors: &[f64], step: i32| -> Vec<f64> {
            (low.floor() as i32..=high.ceil() as i32)
                .filter(|p| p.rem_euclid(step) == 0)
                .flat_map(|p| factors.iter().map(move |f| f * 10f64.powi(p)))
                .filter(|v| (low - 1e-9..=high + 1e-9).contains(&v.log10()))
                .collect()
        };
        let span = high - low;
        let ticks = match span {
            span if span <= 2.5 => on(&[1.0, 2.0, 5.0], 1),
            span => on(&[1.0], 1 + (span / 9.0) as i32),
        };
        let fine = match span {
            span if span <= 4.0 => on(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0], 1),
            _ => Vec::new(),
        };
        let ticks = ticks.into_iter().map(|v| (v, short(v))).collect();
        PlotAxis {
            fine,
            is_logarithmic: true,
            ..PlotAxis::between(label, (10f64.powf(low), 10f64.powf(high)), ticks)
        }
    }

    /// Lowest and highest value.
    #[must_use]
    pub fn ends(&self) -> (f64, f64) {
        (self.low, self.high)
    }

    /// Whether nothing of it is shown.
    pub(super) fn is_hidden(&self) -> bool {
        self.label.is_empty() && self.ticks.is_empty()
    }

    /// Fraction of the axis's length; what lies beyond an end is drawn just outside it.
    pub(super) fn fraction(&self, value: f64) -> f64 {
        let place = |v: f64| match self.is_logarithmic {
            true => v.max(f64::MIN_POSITIVE).log10(),
            false => v,
        };
        let (low, high) = (place(self.low), place(self.high));
        let fraction = (place(value) - low) / (high - low);
        if fraction.is_finite() {
            fraction.clamp(-0.02, 1.02)
        } else {
            0.0
        }
    }
}

impl Ranged for PlotAxis {
    type FormatOption = NoDefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, (from, to): (i32, i32)) -> i32 {
        (f64::from(from) + f64::from(to - from) * self.fraction(*value)).round() as i32
    }

    fn key_points<Hint: KeyPointHint>(&self, hint: Hint) -> Vec<f64> {
        match hint.weight().allow_light_points() {
            true => self.fine.clone(),
            false => self.ticks.iter().map(|t| t.0).collect(),
        }
    }

    fn range(&self) -> Range<f64> {
        self.low..self.high
    }
}

impl ValueFormatter<f64> for PlotAxis {
    fn format_ext(&self, value: &f64) -> String {
        let tick = self.ticks.iter().find(|t| t.0 == *value);
        tick.map_or_else(String::new, |t| t.1.clone())
    }
}

/// Values 0, s, 2s … and their labels, where s is 1, 2 or 5 times a power of ten; the last one is the first that
/// reaches `max`. `max` is above 0; three to five steps make it up.
fn round_ticks(max: f64) -> Vec<(f64, String)> {
    let raw = max / 5.0;
    let power = 10f64.powf(raw.log10().floor());
    let candidates = [1.0, 2.0, 5.0, 10.0].map(|m| m * power);
    let step = candidates.into_iter().find(|step| *step >= raw * 0.999);
    let step = step.unwrap_or(max);
    let decimals = (-step.log10().floor()).clamp(0.0, 12.0) as usize;
    let last = (max / step * (1.0 - 1e-9)).ceil().max(1.0) as u32;
    (0..=last)
        .map(|n| {
            let value = step * f64::from(n);
            (value, format!("{value:.decimals$}"))
        })
        .collect()
}

/// A positive number in few letters: as it is where it is short, otherwise as a power of ten.
fn short(value: f64) -> String {
    let power = (value.log10() + 1e-9).floor();
    if (-2.0..4.0).contains(&power) {
        return format!("{value:.*}", (-power).max(0.0) as usize);
    }
    match (value / 10f64.powf(power)).round() {
        1.0 => power_of_ten(power),
        factor => format!("{factor:.0}·{}", power_of_ten(power)),
    }
}

/// 10 with a whole exponent raised.
#[must_use]
pub fn power_of_ten(exponent: f64) -> String {
    const RAISED: [char; 10] = ['⁰', '¹', '²', '³', '⁴', '⁵', '⁶', '⁷', '⁸', '⁹'];
    let raised = |c: char| match c {
        '-' => '⁻',
        digit => RAISED[digit.to_digit(10).unwrap_or(0) as usize],
    };
    let exponent = format!("{exponent:.0}");
    "10".chars().chain(exponent.chars().map(raised)).collect()
}

/// A number in the typography of a figure: a minus sign in place of a hyphen.
#[must_use]
pub fn with_true_minus(text: &str) -> String {
    text.replace('-', "\u{2212}")
}
