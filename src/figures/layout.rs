//! Where everything of a figure is placed, px.

use super::{Figure, Legend, Panel};

pub(super) const MARGIN: i32 = 14;
pub(super) const TITLE_PX: i32 = 16;
pub(super) const TEXT_PX: i32 = 12;
pub(super) const SMALL_PX: i32 = 11;
/// From one line of text to the next.
pub(super) const LINE: i32 = 17;
const TITLE_LINE: i32 = 22;
/// Height of tick labels, or of an axis's label, below a panel.
const LABELS: i32 = 19;
/// Height of a colour bar with its labels.
pub(super) const BAR: i32 = 30;
const LEGEND_WIDTH: i32 = 190;
/// From a legend's name to the next.
pub(super) const LEGEND_STEP: i32 = 40;
const GAP: i32 = 16;

/// Width of a text, px: an average over the letters of common sans-serif fonts.
pub(super) fn text_width(text: &str, size_px: i32) -> i32 {
    (0.56 * f64::from(size_px) * text.chars().count() as f64).ceil() as i32
}

/// A text in lines that are at most so wide.
fn wrapped(text: &str, size_px: i32, width: i32) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split_whitespace() {
        match lines.last_mut() {
            Some(line) if text_width(line, size_px) + text_width(word, size_px) < width => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(word.to_owned()),
        }
    }
    lines
}

/// The place of one panel.
#[derive(Debug, Clone, Copy)]
pub(super) struct PanelPlace {
    /// Left upper corner of the plotting area.
    pub at: (i32, i32),
    /// Width and height of the plotting area.
    pub size: (i32, i32),
    /// Room for the labels of the y axis, to the left; 0 where the panel to the left has the same axis.
    pub left: i32,
    /// Room for the labels of the x axis, below.
    pub below: i32,
    /// Whether the x axis is named.
    pub names_x: bool,
}

/// The places of a figure.
#[derive(Debug, Clone)]
pub(super) struct FigureLayout {
    pub size: (i32, i32),
    pub title: Vec<String>,
    pub note: Vec<String>,
    pub footers: Vec<String>,
    /// Top of the first line of the footers.
    pub footers_at: i32,
    /// Left upper corner of a legend above or beside the panels.
    pub legend_at: (i32, i32),
    pub panels: Vec<PanelPlace>,
}

impl FigureLayout {
    pub fn of(figure: &Figure) -> FigureLayout {
        let columns = figure.columns.max(1);
        let of_column = |column: usize| figure.panels.iter().skip(column).step_by(columns);
        let size = |panel: &Panel| panel.own_px.unwrap_or(figure.panel_px);
        let mut lefts = Vec::new();
        let mut right = MARGIN;
        for column in 0..columns.min(figure.panels.len()) {
            let indices = (column..figure.panels.len()).step_by(columns);
            let left = indices.map(|n| left_of(figure, n)).max().unwrap_or(0);
            lefts.push(right + left);
            right += left + of_column(column).map(|p| size(p).0).max().unwrap_or(0) + GAP;
        }
        let panels_end = right;
        let names = |legend: &Legend| matches!(legend, Legend::Beside);
        let width = panels_end - GAP + MARGIN + LEGEND_WIDTH * i32::from(names(&figure.legend));
        let text = width - 2 * MARGIN;
        let title = wrapped(&figure.title, TITLE_PX, text);
        let note = wrapped(&figure.note, SMALL_PX, text);
        let footers: Vec<String> = figure
            .footers
            .iter()
            .flat_map(|footer| wrapped(footer, SMALL_PX, text))
            .collect();
        let mut y = MARGIN + TITLE_LINE * title.len() as i32 + LINE * note.len() as i32 + 6;
        let legend_y = y;
        y += match figure.legend {
            Legend::Above => LINE + 6,
            Legend::Colours(_) => BAR + 8,
            _ => 0,
        };
        let mut panels = Vec::new();
        for (row, of_row) in figure.panels.chunks(columns).enumerate() {
            if of_row.iter().any(|p| !p.title.is_empty()) {
                y += LINE + 3;
            }
            let mut bottom = y;
            for (column, panel) in of_row.iter().enumerate() {
                let n = row * columns + column;
                let next = figure.panels.get(n + columns);
                let names_x = !panel.x.label.is_empty() && next.is_none_or(|p| p.x != panel.x);
                let below =
                    LABELS * i32::from(!panel.x.ticks.is_empty()) + LABELS * i32::from(names_x);
                let bar = BAR * i32::from(panel.colours.is_some());
                let size = size(panel);
                panels.push(PanelPlace {
                    at: (lefts[column], y),
                    size,
                    left: left_of(figure, n),
                    below,
                    names_x,
                });
                bottom = bottom.max(y + size.1 + below + bar);
            }
            y = bottom + GAP;
        }
        let footers_at = y - 4;
        y += LINE * footers.len() as i32;
        FigureLayout {
            size: (width, y),
            title,
            note,
            footers,
            footers_at,
            legend_at: match names(&figure.legend) {
                true => (panels_end + 6, legend_y + LINE),
                false => (lefts.first().copied().unwrap_or(MARGIN), legend_y),
            },
            panels,
        }
    }
}

/// Room for the labels of a panel's y axis.
fn left_of(figure: &Figure, n: usize) -> i32 {
    let columns = figure.columns.max(1);
    let y = &figure.panels[n].y;
    let shared = !n.is_multiple_of(columns) && figure.panels[n - 1].y == *y;
    if y.is_hidden() || shared {
        return 0;
    }
    let ticks = y.ticks.iter().map(|t| text_width(&t.1, SMALL_PX));
    ticks.max().unwrap_or(0) + 12 + (LINE + 4) * i32::from(!y.label.is_empty())
}
