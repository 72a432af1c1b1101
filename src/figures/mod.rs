//! Figures as SVG text: a [`Figure`] is a list of panels, a panel a list of series over two labelled axes.
//!
//! [`Figure::svg`] is the function to call. The crate plotters draws axes, grids and marks; this module adds the layout
//! of panels, legends and colour bars. The text needs no other file: pictures are embedded. The background is
//! white, so a figure reads the same on a light and on a dark page.

mod axis;
mod drawing;
mod layout;

pub use axis::{PlotAxis, power_of_ten, with_true_minus};

use crate::colour::Rgb;

/// Colours of series that readers with deficient colour vision can distinguish (M. Okabe and K. Ito, "Color universal
/// design", 2008).
pub const SERIES_COLOURS: [Rgb; 8] = [
    [0, 114, 178],
    [213, 94, 0],
    [0, 158, 115],
    [204, 121, 167],
    [230, 159, 0],
    [86, 180, 233],
    [0, 0, 0],
    [153, 153, 153],
];
/// Guides and outlines.
pub const GREY: Rgb = [110, 110, 110];
/// Cells without a value.
pub const NO_VALUE: Rgb = [226, 226, 226];

/// Panels in rows, with a title above them.
#[derive(Debug, Clone, Default)]
pub struct Figure {
    /// Above everything, in the largest letters.
    pub title: String,
    /// Below the title: conditions and how to read the figure.
    pub note: String,
    /// Below the panels, one line each.
    pub footers: Vec<String>,
    /// Panels per row.
    pub columns: usize,
    /// Width and height of a panel's plotting area, px; a panel may have its own.
    pub panel_px: (i32, i32),
    /// Where the names of the first panel's series appear.
    pub legend: Legend,
    /// Row by row. Neighbours with equal axes share the labels.
    pub panels: Vec<Panel>,
}

/// Where the series are named.
#[derive(Debug, Clone, Default)]
pub enum Legend {
    /// Nowhere.
    #[default]
    None,
    /// In a row between the note and the panels.
    Above,
    /// In a column to the right of the panels, each name with its detail.
    Beside,
    /// In the upper right corner of every panel, each with its own series.
    Inside,
    /// A colour bar between the note and the panels.
    Colours(ColourBar),
}

/// Series over two axes.
#[derive(Debug, Clone, Default)]
pub struct Panel {
    /// Above the plotting area.
    pub title: String,
    /// To the right.
    pub x: PlotAxis,
    /// Upwards.
    pub y: PlotAxis,
    /// Drawn in this order.
    pub series: Vec<DataSeries>,
    /// Below the plotting area.
    pub colours: Option<ColourBar>,
    /// Width and height of the plotting area, px, where they differ from those of the figure.
    pub own_px: Option<(i32, i32)>,
}

/// What has one name and one colour.
#[derive(Debug, Clone, Default)]
pub struct DataSeries {
    /// For the legend; empty for a series that it does not name.
    pub name: String,
    /// In the legend, below the name.
    pub detail: String,
    /// Of all its marks.
    pub colour: Rgb,
    /// Drawn in this order.
    pub marks: Vec<Mark>,
}

/// Something drawn at places in the units of the axes.
#[derive(Debug, Clone)]
pub enum Mark {
    /// Straight lines from point to point.
    Line(Vec<(f64, f64)>, Stroke),
    /// Symbols.
    Points(Vec<(f64, f64)>, Symbol),
    /// Vertical bars of ± half their height about a value: (x, value, half).
    ErrorBars(Vec<(f64, f64, f64)>),
    /// Upright rectangles from y = 0: (centre, width, y).
    Bars(Vec<(f64, f64, f64)>),
    /// Rectangles of one unit in x and y, each in its own colour with its own text.
    Cells(Vec<HeatCell>),
    /// Words at a place, centred.
    Words((f64, f64), String),
    /// Fills the plotting area.
    Picture(Raster),
}

/// A picture of 8-bit pixels.
#[derive(Debug, Clone)]
pub struct Raster {
    /// Pixels per row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Red, green, blue and opacity of each pixel, row by row from the upper left.
    pub rgba: Vec<u8>,
}

/// A rectangle of a heat map.
#[derive(Debug, Clone)]
pub struct HeatCell {
    /// Its centre, in the units of the axes.
    pub centre: (f64, f64),
    /// Fill.
    pub colour: Rgb,
    /// In the middle; may be empty.
    pub text: String,
}

/// How a line is drawn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stroke {
    /// Width, px.
    pub width_px: f64,
    /// 1 for opaque.
    pub opacity: f64,
    /// In dashes.
    pub is_dashed: bool,
}

impl Stroke {
    /// Of a curve.
    pub const SOLID: Stroke = Stroke {
        width_px: 2.0,
        opacity: 1.0,
        is_dashed: false,
    };
    /// Of a guide, or of a curve that may coincide with another.
    pub const DASHED: Stroke = Stroke {
        is_dashed: true,
        ..Stroke::SOLID
    };
    /// Of an outline.
    pub const HAIRLINE: Stroke = Stroke {
        width_px: 0.8,
        opacity: 1.0,
        is_dashed: false,
    };
}

/// The form of a point.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Symbol {
    /// A filled circle.
    Dot,
    /// A small filled circle.
    SmallDot,
    /// An open circle on a white halo.
    Ring,
    /// An upright cross on a white halo.
    Cross,
}

/// What the colours of a panel mean.
#[derive(Debug, Clone)]
pub struct ColourBar {
    /// From left to right, in equal steps.
    pub colours: Vec<Rgb>,
    /// Fraction of the bar's length and text.
    pub labels: Vec<(f64, String)>,
    /// Before the bar; may be empty.
    pub caption: String,
}

impl DataSeries {
    /// A series of one mark in the colour number `n` of [`SERIES_COLOURS`].
    #[must_use]
    pub fn numbered(n: usize, name: impl Into<String>, marks: Vec<Mark>) -> Self {
        DataSeries {
            name: name.into(),
            detail: String::new(),
            colour: SERIES_COLOURS[n % SERIES_COLOURS.len()],
            marks,
        }
    }
}

impl Figure {
    /// The figure as the text of an SVG file.
    #[must_use]
    pub fn svg(&self) -> String {
        drawing::svg(self)
    }
}

#[cfg(test)]
mod tests;
