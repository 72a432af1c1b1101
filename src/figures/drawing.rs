//! A laid out figure drawn by plotters.

use std::fmt::Write as _;

use base64::Engine as _;
use plotters::chart::{ChartBuilder, ChartContext};
use plotters::coord::Shift;
use plotters::coord::cartesian::Cartesian2d;
use plotters::drawing::{DrawingArea, DrawingAreaErrorKind, IntoDrawingArea};
use plotters::element::{Circle, DashedPathElement, PathElement, Rectangle, Text};
use plotters::prelude::SVGBackend;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use plotters::style::{Color, FontDesc, FontFamily, FontStyle, RGBColor, ShapeStyle, TextStyle};

use super::layout::{
    self, BAR, FigureLayout, LEGEND_STEP, LINE, PanelPlace, SMALL_PX, TEXT_PX, TITLE_PX,
};
use super::{
    ColourBar, DataSeries, Figure, GREY, HeatCell, Legend, Mark, Panel, PlotAxis, Raster, Stroke,
    Symbol,
};
use crate::colour::Rgb;

/// Units of the drawing per px: plotters places everything at whole units.
const UNIT: i32 = 10;
/// plotters divides the size of a font by this.
const FONT_UNIT: f64 = 1.24 * UNIT as f64;
const FONTS: &str = "Inter, Helvetica, Arial, sans-serif";
const INK: Rgb = [34, 38, 44];
const FAINT_INK: Rgb = [92, 98, 106];
const WHITE: Rgb = [255, 255, 255];
const GRID: Rgb = [216, 219, 223];
const FINE_GRID: Rgb = [238, 240, 242];

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
type Chart<'a> = ChartContext<'a, SVGBackend<'a>, Cartesian2d<PlotAxis, PlotAxis>>;
type Drawn<T> = Result<T, DrawingAreaErrorKind<std::io::Error>>;

pub(super) fn svg(figure: &Figure) -> String {
    let layout = FigureLayout::of(figure);
    let (width, height) = layout.size;
    let mut drawn = String::new();
    let mut pictures = String::new();
    let size = (units(width) as u32, units(height) as u32);
    let root = SVGBackend::with_string(&mut drawn, size).into_drawing_area();
    draw(figure, &layout, &root, &mut pictures)
        .and_then(|()| root.present())
        .expect("a string takes every element");
    drop(root);
    // plotters embeds pictures only with a codec of its own: they go below its elements, as the white ground does.
    let body = drawn.split_once('\n').map_or("", |(_, body)| body);
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" viewBox=\"0 0 {} {}\">\n\
         <rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n{pictures}{body}",
        size.0, size.1
    )
}

fn units(px: i32) -> i32 {
    px * UNIT
}

fn rgb([r, g, b]: Rgb) -> RGBColor {
    RGBColor(r, g, b)
}

fn filled(colour: Rgb) -> ShapeStyle {
    rgb(colour).filled()
}

fn stroke(colour: Rgb, stroke: Stroke) -> ShapeStyle {
    let width = (stroke.width_px * f64::from(UNIT)).round() as u32;
    rgb(colour).mix(stroke.opacity).stroke_width(width)
}

fn font(size_px: i32, colour: Rgb, h: HPos, v: VPos) -> TextStyle<'static> {
    let size = f64::from(size_px) * FONT_UNIT;
    let font = FontDesc::new(FontFamily::Name(FONTS), size, FontStyle::Normal);
    TextStyle {
        font,
        color: rgb(colour).to_backend_color(),
        pos: Pos::new(h, v),
    }
}

/// Writes a line whose left upper corner is at a place.
fn write(root: &Area<'_>, text: &str, size_px: i32, colour: Rgb, (x, y): (i32, i32)) -> Drawn<()> {
    let style = font(size_px, colour, HPos::Left, VPos::Top);
    root.draw_text(text, &style, (units(x), units(y)))
}

fn draw<'a>(
    figure: &Figure,
    layout: &FigureLayout,
    root: &Area<'a>,
    pictures: &mut String,
) -> Drawn<()> {
    let left = layout::MARGIN;
    let mut y = layout::MARGIN;
    for line in &layout.title {
        write(root, line, TITLE_PX, INK, (left, y))?;
        y += 22;
    }
    for line in &layout.note {
        write(root, line, SMALL_PX, FAINT_INK, (left, y))?;
        y += LINE;
    }
    for (n, line) in layout.footers.iter().enumerate() {
        let at = (left, layout.footers_at + LINE * n as i32);
        write(root, line, SMALL_PX, FAINT_INK, at)?;
    }
    let first = figure.panels.first().map_or(&[][..], |p| &p.series);
    match &figure.legend {
        Legend::Above => legend_above(root, first, layout.legend_at)?,
        Legend::Beside => legend_beside(root, first, layout.legend_at)?,
        Legend::Colours(bar) => {
            let (x, y) = layout.legend_at;
            let caption = layout::text_width(&bar.caption, TEXT_PX);
            write(root, &bar.caption, TEXT_PX, INK, (x, y))?;
            colour_bar(root, pictures, bar, (x + caption + 10, y), 300)?;
        }
        Legend::Inside | Legend::None => {}
    }
    for (panel, place) in figure.panels.iter().zip(&layout.panels) {
        draw_panel(root, pictures, panel, place)?;
        if matches!(figure.legend, Legend::Inside) {
            legend_inside(root, panel, place)?;
        }
    }
    Ok(())
}

fn draw_panel<'a>(
    root: &Area<'a>,
    pictures: &mut String,
    panel: &Panel,
    place: &PanelPlace,
) -> Drawn<()> {
    let PanelPlace {
        at: (x, y),
        size,
        left,
        below,
        names_x,
    } = *place;
    let has_axes = !(panel.x.is_hidden() && panel.y.is_hidden());
    let (h, title_x) = match has_axes {
        true => (HPos::Left, x),
        false => (HPos::Center, x + size.0 / 2),
    };
    let style = font(TEXT_PX, INK, h, VPos::Top);
    root.draw_text(&panel.title, &style, (units(title_x), units(y - LINE - 1)))?;
    let area = root.clone().shrink(
        (units(x - left), units(y)),
        (units(left + size.0), units(size.1 + below)),
    );
    let mut chart: Chart<'a> = ChartBuilder::on(&area)
        .y_label_area_size(units(left))
        .x_label_area_size(units(below))
        .build_cartesian_2d(panel.x.clone(), panel.y.clone())?;
    let label = |h, v| font(TEXT_PX, INK, h, v);
    let mut mesh = chart.configure_mesh();
    mesh.bold_line_style(stroke(GRID, Stroke::HAIRLINE))
        .light_line_style(stroke(FINE_GRID, Stroke::HAIRLINE))
        .axis_style(stroke(GREY, Stroke::HAIRLINE))
        .label_style(font(SMALL_PX, INK, HPos::Center, VPos::Top))
        .axis_desc_style(label(HPos::Center, VPos::Top))
        .set_all_tick_mark_size(units(3));
    if !panel.x.has_grid {
        mesh.disable_x_mesh();
    }
    if !panel.y.has_grid {
        mesh.disable_y_mesh();
    }
    if names_x {
        mesh.x_desc(&panel.x.label);
    }
    if left > 0 && !panel.y.label.is_empty() {
        mesh.y_desc(&panel.y.label);
    }
    mesh.draw()?;
    for series in &panel.series {
        for mark in &series.marks {
            draw_mark(&chart, series.colour, mark)?;
            if let Mark::Picture(raster) = mark {
                picture(pictures, raster, (x, y), size);
            }
        }
    }
    if has_axes {
        frame(root, (x, y), size)?;
    }
    if let Some(bar) = &panel.colours {
        let inset = size.0 / 20;
        let at = (x + inset, y + size.1 + below + 8);
        colour_bar(root, pictures, bar, at, size.0 - 2 * inset)?;
    }
    Ok(())
}

fn draw_mark(chart: &Chart<'_>, colour: Rgb, mark: &Mark) -> Drawn<()> {
    let area = chart.plotting_area();
    let known = |p: &&(f64, f64)| p.0.is_finite() && p.1.is_finite();
    match mark {
        Mark::Line(points, kind) => {
            let points: Vec<(f64, f64)> = points.iter().filter(known).copied().collect();
            let style = stroke(colour, *kind);
            if kind.is_dashed {
                let dash = DashedPathElement::new(points, units(6), units(4), style);
                area.draw(&dash)
            } else {
                area.draw(&PathElement::new(points, style))
            }
        }
        Mark::Points(points, symbol) => points
            .iter()
            .filter(known)
            .try_for_each(|point| draw_symbol(chart, colour, *point, *symbol)),
        Mark::ErrorBars(bars) => {
            let style = stroke(
                colour,
                Stroke {
                    opacity: 0.35,
                    ..Stroke::SOLID
                },
            );
            let known = bars.iter().filter(|b| b.1.is_finite() && b.2 > 0.0);
            known.copied().try_for_each(|(x, y, half)| {
                area.draw(&PathElement::new(vec![(x, y - half), (x, y + half)], style))
            })
        }
        Mark::Bars(bars) => bars.iter().try_for_each(|&(centre, width, y)| {
            let half = 0.5 * width;
            let corners = [(centre - half, y), (centre + half, 0.0)];
            area.draw(&Rectangle::new(corners, filled(colour)))
        }),
        Mark::Cells(cells) => cells.iter().try_for_each(|cell| draw_cell(chart, cell)),
        Mark::Words(at, words) => {
            let style = font(SMALL_PX, colour, HPos::Center, VPos::Center);
            area.draw(&Text::new(words.as_str(), *at, style))
        }
        Mark::Picture(_) => Ok(()),
    }
}

fn draw_symbol(chart: &Chart<'_>, colour: Rgb, at: (f64, f64), symbol: Symbol) -> Drawn<()> {
    let area = chart.plotting_area();
    let halo = |width_px| {
        let wide = Stroke {
            width_px: 1.2 + 2.0 * width_px,
            ..Stroke::SOLID
        };
        let thin = Stroke {
            width_px: 1.2,
            ..Stroke::SOLID
        };
        [stroke(WHITE, wide), stroke(colour, thin)]
    };
    match symbol {
        Symbol::Dot => {
            area.draw(&Circle::new(at, units(5), filled(WHITE)))?;
            area.draw(&Circle::new(at, units(4), filled(colour)))
        }
        Symbol::SmallDot => area.draw(&Circle::new(at, 24, filled(colour))),
        Symbol::Ring => halo(0.8)
            .into_iter()
            .try_for_each(|style| area.draw(&Circle::new(at, units(4), style))),
        Symbol::Cross => {
            let (x, y) = chart.backend_coord(&at);
            let area = area.use_screen_coord();
            let arms = [(units(4), 0), (0, units(4))];
            halo(0.8).into_iter().try_for_each(|style| {
                arms.into_iter().try_for_each(|(dx, dy)| {
                    let ends = vec![(x - dx, y - dy), (x + dx, y + dy)];
                    area.draw(&PathElement::new(ends, style))
                })
            })
        }
    }
}

fn draw_cell(chart: &Chart<'_>, cell: &HeatCell) -> Drawn<()> {
    let area = chart.plotting_area();
    let (x, y) = cell.centre;
    let corners = [(x - 0.5, y + 0.5), (x + 0.5, y - 0.5)];
    area.draw(&Rectangle::new(corners, filled(cell.colour)))?;
    let [(left, top), (right, bottom)] = corners;
    let around = outline((left, top), (right, bottom));
    area.draw(&PathElement::new(around, stroke(WHITE, Stroke::HAIRLINE)))?;
    if cell.text.is_empty() {
        return Ok(());
    }
    // Rec. 709 luma: dark letters on light cells.
    let [r, g, b] = cell.colour.map(f64::from);
    let luma = 0.2126 * r + 0.7152 * g + 0.0722 * b;
    let ink = if luma > 140.0 { INK } else { WHITE };
    let style = font(SMALL_PX, ink, HPos::Center, VPos::Center);
    area.draw(&Text::new(cell.text.as_str(), (x, y), style))
}

/// The corners of a rectangle, closed.
fn outline<T: Copy>((left, top): (T, T), (right, bottom): (T, T)) -> Vec<(T, T)> {
    vec![
        (left, top),
        (right, top),
        (right, bottom),
        (left, bottom),
        (left, top),
    ]
}

fn frame(root: &Area<'_>, (x, y): (i32, i32), (width, height): (i32, i32)) -> Drawn<()> {
    let (left, top, right, bottom) = (units(x), units(y), units(x + width), units(y + height));
    let around = outline((left, top), (right, bottom));
    root.draw(&PathElement::new(around, stroke(GREY, Stroke::HAIRLINE)))
}

/// A stretch of a series' own line or a square in its colour, of 20 × 10 px.
fn swatch(root: &Area<'_>, series: &DataSeries, (x, y): (i32, i32)) -> Drawn<()> {
    let line = series.marks.iter().find_map(|mark| match mark {
        Mark::Line(_, stroke) => Some(*stroke),
        _ => None,
    });
    let colour = series.colour;
    let Some(kind) = line else {
        let corners = [(units(x + 8), units(y)), (units(x + 20), units(y + 12))];
        return root.draw(&Rectangle::new(corners, filled(colour)));
    };
    let middle = y + 6;
    let ends = vec![(units(x), units(middle)), (units(x + 20), units(middle))];
    let style = stroke(colour, kind);
    if kind.is_dashed {
        root.draw(&DashedPathElement::new(ends, units(6), units(4), style))?;
    } else {
        root.draw(&PathElement::new(ends, style))?;
    }
    let has_dots = |mark: &Mark| matches!(mark, Mark::Points(_, Symbol::Dot));
    if series.marks.iter().any(has_dots) {
        let centre = (units(x + 10), units(middle));
        root.draw(&Circle::new(centre, units(4), filled(colour)))?;
    }
    Ok(())
}

fn named(series: &[DataSeries]) -> impl Iterator<Item = &DataSeries> {
    series.iter().filter(|s| !s.name.is_empty())
}

fn legend_above(root: &Area<'_>, series: &[DataSeries], (x, y): (i32, i32)) -> Drawn<()> {
    let mut x = x;
    for series in named(series) {
        swatch(root, series, (x, y))?;
        write(root, &series.name, TEXT_PX, INK, (x + 26, y))?;
        x += 26 + layout::text_width(&series.name, TEXT_PX) + 22;
    }
    Ok(())
}

fn legend_beside(root: &Area<'_>, series: &[DataSeries], (x, y): (i32, i32)) -> Drawn<()> {
    for (n, series) in named(series).enumerate() {
        let y = y + LEGEND_STEP * n as i32;
        swatch(root, series, (x, y))?;
        write(root, &series.name, TEXT_PX, INK, (x + 26, y))?;
        write(
            root,
            &series.detail,
            SMALL_PX,
            FAINT_INK,
            (x + 26, y + LINE - 2),
        )?;
    }
    Ok(())
}

/// On a white ground, because curves may pass below.
fn legend_inside(root: &Area<'_>, panel: &Panel, place: &PanelPlace) -> Drawn<()> {
    let widths = named(&panel.series).map(|s| layout::text_width(&s.name, SMALL_PX));
    let Some(width) = widths.max() else {
        return Ok(());
    };
    let count = named(&panel.series).count() as i32;
    let (right, top) = (place.at.0 + place.size.0 - 6, place.at.1 + 6);
    let left = right - width - 38;
    let corners = [
        (units(left), units(top)),
        (units(right), units(top + (LINE - 1) * count + 6)),
    ];
    root.draw(&Rectangle::new(corners, rgb(WHITE).mix(0.85).filled()))?;
    for (n, series) in named(&panel.series).enumerate() {
        let y = top + 4 + (LINE - 1) * n as i32;
        swatch(root, series, (left + 6, y))?;
        write(root, &series.name, SMALL_PX, INK, (left + 32, y + 1))?;
    }
    Ok(())
}

fn colour_bar(
    root: &Area<'_>,
    pictures: &mut String,
    bar: &ColourBar,
    (x, y): (i32, i32),
    width: i32,
) -> Drawn<()> {
    let opaque = bar.colours.iter().flat_map(|[r, g, b]| [*r, *g, *b, 255]);
    let strip = Raster {
        width: bar.colours.len(),
        height: 1,
        rgba: opaque.collect(),
    };
    picture(pictures, &strip, (x, y), (width, BAR / 3));
    for (fraction, label) in &bar.labels {
        let at = x + (fraction * f64::from(width)).round() as i32;
        let style = font(SMALL_PX, INK, HPos::Center, VPos::Top);
        root.draw_text(label, &style, (units(at), units(y + BAR / 3 + 3)))?;
    }
    Ok(())
}

/// Embeds a picture, stretched to a place.
fn picture(pictures: &mut String, raster: &Raster, at: (i32, i32), size: (i32, i32)) {
    let encoded = base64::engine::general_purpose::STANDARD.encode(png_file(raster));
    let _ = writeln!(
        pictures,
        "<image x=\"{}\" y=\"{}\" width=\"{}\" height=\"{}\" preserveAspectRatio=\"none\" href=\"data:image/png;base64,{encoded}\"/>",
        units(at.0),
        units(at.1),
        units(size.0),
        units(size.1)
    );
}

fn png_file(raster: &Raster) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, raster.width as u32, raster.height as u32);
    encoder.set_color(png::ColorType::Rgba);
    encoder.set_depth(png::BitDepth::Eight);
    encoder
        .write_header()
        .and_then(|mut writer| writer.write_image_data(&raster.rgba))
        .expect("the pixels fill the stated size");
    bytes
}
