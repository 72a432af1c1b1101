//! Hemispheres of direction bins as discs, each with its colour bar.
//!
//! A disc shows the directions of exit from above: the polar angle grows linearly from the centre to the
//! rim for bins in angles, as its sine for bins that are pixels of the direction cosines. +u is
//! to the right, +v upwards. A ring marks the lamp, a cross the mirror direction.

use crate::colour::{Rgb, cyclic, diverging, sequential};
use crate::figures::{
    ColourBar, DataSeries, Figure, GREY, Mark, NO_VALUE, Panel, PlotAxis, Raster, Stroke, Symbol,
    power_of_ten, with_true_minus,
};
use crate::trace::counting::grid::{DirectionGrid, Layout};
use crate::trace::surfaces::height_field::Side;

/// Pixels across a disc's picture, and its side in the figure.
const PIXELS: usize = 300;
const SIDE_PX: i32 = 210;
const OUTLINE: Rgb = [40, 40, 40];

/// What the colours of a disc mean.
#[derive(Debug, Clone, Copy)]
pub(super) enum DiscScale {
    /// Powers of ten, from the first exponent to the second.
    Decades(f64, f64),
    /// Values from the first number to the second.
    Range(f64, f64),
    /// From −x over zero to x.
    Signed(f64),
    /// Angles of polarisation, −90° to 90°, which are the same state.
    Turn,
}

impl DiscScale {
    /// Decades that hold the values, at most the five highest.
    pub(super) fn decades(values: impl Iterator<Item = f64>) -> DiscScale {
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for x in values.filter(|x| *x > 0.0) {
            low = low.min(x.log10());
            high = high.max(x.log10());
        }
        if high < low {
            return DiscScale::Decades(-1.0, 0.0);
        }
        let top = high.ceil();
        DiscScale::Decades(low.floor().max(top - 5.0).min(top - 1.0), top)
    }

    fn colour(self, x: f64) -> Rgb {
        match self {
            DiscScale::Decades(low, high) => {
                sequential((x.max(f64::MIN_POSITIVE).log10() - low) / (high - low))
            }
            DiscScale::Range(low, high) => sequential((x - low) / (high - low)),
            DiscScale::Signed(most) => diverging(x / most),
            DiscScale::Turn => cyclic(x / 180.0),
        }
    }

    /// The value at a fraction of the colour bar.
    fn at(self, fraction: f64) -> f64 {
        match self {
            DiscScale::Decades(low, high) => 10f64.powf(low + fraction * (high - low)),
            DiscScale::Range(low, high) => low + fraction * (high - low),
            DiscScale::Signed(most) => most * (2.0 * fraction - 1.0),
            DiscScale::Turn => 180.0 * fraction - 90.0,
        }
    }

    fn colour_bar(self) -> ColourBar {
        let steps = (0..=255).map(|n| self.colour(self.at(f64::from(n) / 255.0)));
        let label = |fraction: f64| match self {
            DiscScale::Decades(low, high) => power_of_ten(low + fraction * (high - low)),
            DiscScale::Turn => with_true_minus(&format!("{:.0}°", self.at(fraction))),
            _ => with_true_minus(&format!("{}", (self.at(fraction) * 1e4).round() / 1e4)),
        };
        let is_labelled = |fraction: &f64| match self {
            DiscScale::Decades(low, high) => (low + fraction * (high - low)).fract() == 0.0,
            _ => true,
        };
        let fractions = [0.0, 0.5, 1.0].into_iter().filter(is_labelled);
        ColourBar {
            colours: steps.collect(),
            labels: fractions.map(|f| (f, label(f))).collect(),
            caption: String::new(),
        }
    }
}

/// One disc of a figure.
pub(super) struct Disc {
    /// What it shows.
    pub title: String,
    /// Its colours.
    pub scale: DiscScale,
    /// One per bin of the upper side; `None` is grey.
    pub values: Vec<Option<f64>>,
}

/// The direction of the lamp, which fixes the mirror direction.
#[derive(Debug, Clone, Copy)]
pub(super) struct LampMark {
    /// Polar angle, degrees.
    pub theta_deg: f64,
    /// Azimuth, degrees.
    pub phi_deg: f64,
}

/// Discs in rows of `columns`, with a title and a note above them.
pub(super) fn figure(
    grid: DirectionGrid,
    lamp: LampMark,
    columns: usize,
    title: &str,
    note: &str,
    discs: &[Disc],
) -> String {
    let figure = Figure {
        title: title.to_owned(),
        note: note.to_owned(),
        columns,
        panel_px: (SIDE_PX, SIDE_PX),
        panels: discs.iter().map(|disc| panel(grid, lamp, disc)).collect(),
        ..Figure::default()
    };
    figure.svg()
}

fn panel(grid: DirectionGrid, lamp: LampMark, disc: &Disc) -> Panel {
    let circle = |radius: f64, stroke| {
        let angles = (0..=90).map(|n| (4.0 * f64::from(n)).to_radians());
        let points = angles.map(|a| (radius * a.cos(), radius * a.sin()));
        Mark::Line(points.collect(), stroke)
    };
    let faint = Stroke {
        opacity: 0.4,
        ..Stroke::HAIRLINE
    };
    let mut rings = Vec::new();
    for ring_deg in [30.0, 60.0] {
        let r = from_centre(grid, ring_deg);
        let corner = r * std::f64::consts::FRAC_1_SQRT_2;
        rings.push(circle(r, faint));
        rings.push(Mark::Words((-corner, corner), format!("{ring_deg}°")));
    }
    let place = |phi_deg: f64| {
        let (sin, cos) = phi_deg.to_radians().sin_cos();
        let r = from_centre(grid, lamp.theta_deg);
        vec![(r * cos, r * sin)]
    };
    let marks = vec![
        Mark::Picture(picture(grid, disc)),
        circle(1.0, Stroke::HAIRLINE),
        Mark::Points(place(lamp.phi_deg), Symbol::Ring),
        Mark::Points(place(lamp.phi_deg + 180.0), Symbol::Cross),
    ];
    let series = |colour, marks| DataSeries {
        colour,
        marks,
        ..DataSeries::default()
    };
    Panel {
        title: disc.title.clone(),
        x: PlotAxis::hidden(-1.0, 1.0),
        y: PlotAxis::hidden(-1.0, 1.0),
        series: vec![series(GREY, rings), series(OUTLINE, marks)],
        colours: Some(disc.scale.colour_bar()),
        own_px: None,
    }
}

/// Distance of a polar angle from a disc's centre, the rim being at 1.
fn from_centre(grid: DirectionGrid, theta_deg: f64) -> f64 {
    match grid.layout {
        Layout::Polar => theta_deg / 90.0,
        Layout::Disc => theta_deg.to_radians().sin(),
    }
}

fn picture(grid: DirectionGrid, disc: &Disc) -> Raster {
    let mut rgba = Vec::with_capacity(4 * PIXELS * PIXELS);
    for row in 0..PIXELS {
        for column in 0..PIXELS {
            let at = |n: usize| (2 * n + 1) as f64 / PIXELS as f64 - 1.0;
            let (x, y) = (at(column), -at(row));
            let r = x.hypot(y);
            if r >= 1.0 {
                rgba.extend([255, 255, 255, 0]);
                continue;
            }
            let sin = match grid.layout {
                Layout::Polar => (r * std::f64::consts::FRAC_PI_2).sin(),
                Layout::Disc => r,
            };
            let stretch = if r > 0.0 { sin / r } else { 0.0 };
            let k = [x * stretch, y * stretch, (1.0 - sin * sin).max(0.0).sqrt()];
            let value = disc.values[grid.bin(Side::Above, &k)];
            let [red, green, blue] = value.map_or(NO_VALUE, |v| disc.scale.colour(v));
            rgba.extend([red, green, blue, 255]);
        }
    }
    Raster {
        width: PIXELS,
        height: PIXELS,
        rgba,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_figure_shows_every_disc_and_decades_have_round_ends() {
        let grid = DirectionGrid::polar(9, 12);
        let discs: Vec<Disc> = (0..3)
            .map(|n| Disc {
                title: format!("m{n} < 1"),
                scale: DiscScale::Signed(1.0),
                values: vec![Some(0.5); grid.per_side()],
            })
            .collect();
        let lamp = LampMark {
            theta_deg: 45.0,
            phi_deg: 0.0,
        };
        let svg = figure(grid, lamp, 2, "a", "b", &discs);
        assert_eq!(svg.matches("<image").count(), 6);
        assert!(svg.contains("m2 &lt; 1"));
        let DiscScale::Decades(low, high) = DiscScale::decades([0.02, 3.0, 0.0].into_iter()) else {
            panic!("decades")
        };
        assert_eq!((low, high), (-2.0, 1.0));
    }
}
