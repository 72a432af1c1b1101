//! A layer as a picture: colours, a colour bar with numbers and unit, a scale bar in millimetres.

use ab_glyph::{Font, FontRef, PxScale, ScaleFont, point};

use crate::colour::{Rgb, cyclic, sequential};

const FONT: &[u8] = include_bytes!("../../assets/fonts/DejaVuSans-subset.ttf");
/// The map is enlarged to at least this many pixels across.
const WIDTH_MIN_PX: usize = 640;
const MARGIN: usize = 24;
const BAR_WIDTH: usize = 26;
const TEXT_PX: f32 = 18.0;
const TITLE_PX: f32 = 22.0;
const INK: Rgb = [40, 40, 40];
const PAPER: Rgb = [255, 255, 255];
/// Colour of pixels without a value.
const NOTHING: Rgb = [222, 222, 222];

/// An RGB picture.
pub(super) struct Picture {
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) rgb: Vec<u8>,
}

/// Dimensions of the map for a picture.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sheet {
    pub(super) width: usize,
    pub(super) height: usize,
    /// Millimetres per column; `None` if unknown.
    pub(super) column_mm: Option<f64>,
    /// Row height over column width.
    pub(super) aspect: f64,
}

/// The meaning of a layer's colours.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Scale {
    /// Values from low to high.
    Range(f64, f64),
    /// Directions in degrees.
    Directions,
}

impl Scale {
    /// Covers the values' 1st to 99th percentile with a small margin; for few values, all of them.
    pub(super) fn of(values: &[f32]) -> Option<Scale> {
        let mut finite: Vec<f32> = values.iter().copied().filter(|x| x.is_finite()).collect();
        if finite.is_empty() {
            return None;
        }
        finite.sort_unstable_by(f32::total_cmp);
        let at = |share: f64| f64::from(finite[((finite.len() - 1) as f64 * share) as usize]);
        let (low, high) = (at(0.01), at(0.99));
        let room = 0.03 * (high - low);
        if high - low <= 1e-9 * high.abs() {
            let half = (0.05 * high.abs()).max(1e-6);
            return Some(Scale::Range(low - half, high + half));
        }
        // No layer has negative values, so the margin must not add them.
        let low = if low >= 0.0 {
            (low - room).max(0.0)
        } else {
            low - room
        };
        Some(Scale::Range(low, high + room))
    }

    fn colour(self, value: f64) -> Rgb {
        match self {
            Scale::Range(low, high) => sequential((value - low) / (high - low)),
            Scale::Directions => cyclic(value / 360.0),
        }
    }

    fn ends(self) -> (f64, f64) {
        match self {
            Scale::Range(low, high) => (low, high),
            Scale::Directions => (-180.0, 180.0),
        }
    }

    fn ticks(self) -> Vec<f64> {
        match self {
            Scale::Range(low, high) => {
                let step = round_step((high - low) / 5.0);
                let first = (low / step).ceil() as i64;
                let last = (high / step).floor() as i64;
                (first..=last).map(|n| n as f64 * step).collect()
            }
            Scale::Directions => (-2..=2).map(|n| 90.0 * f64::from(n)).collect(),
        }
    }
}

/// Returns 1, 2 or 5 times a power of ten, nearest to `step` in ratio.
fn round_step(step: f64) -> f64 {
    let decade = 10_f64.powf(step.log10().floor());
    let factor = match step / decade {
        x if x < 1.5 => 1.0,
        x if x < 3.5 => 2.0,
        x if x < 7.5 => 5.0,
        _ => 10.0,
    };
    factor * decade
}

/// Formats a tick's number with as many decimals as the step needs.
fn number(value: f64, step: f64) -> String {
    let decimals = (-step.log10()).ceil().clamp(0.0, 9.0) as usize;
    let text = format!("{value:.decimals$}");
    text.replace('-', "−")
}

/// Draws a layer. `title` is written above, `unit` after each number of the colour bar.
pub(super) fn layer(
    sheet: &Sheet,
    values: &[f32],
    scale: Option<Scale>,
    title: &str,
    unit: &str,
) -> Picture {
    let colours = |pixel: usize| match scale {
        Some(scale) if values[pixel].is_finite() => scale.colour(f64::from(values[pixel])),
        _ => NOTHING,
    };
    let right = 150;
    let mut canvas = Canvas::with_map(sheet, title, right, &colours);
    let Some(scale) = scale else {
        return canvas.finish();
    };
    let (x, top) = (canvas.map_right() + 26, canvas.map_top);
    let bottom = canvas.map_bottom();
    let height = bottom - top;
    let (low, high) = scale.ends();
    for row in 0..height {
        let value = high - (high - low) * (row as f64 + 0.5) / height as f64;
        for column in 0..BAR_WIDTH {
            canvas.set(x + column, top + row, scale.colour(value));
        }
    }
    canvas.frame(x, top, BAR_WIDTH, height);
    let ticks = scale.ticks();
    let step = if ticks.len() > 1 {
        ticks[1] - ticks[0]
    } else {
        high - low
    };
    for tick in ticks {
        let row = top as f64 + (high - tick) / (high - low) * height as f64;
        let row = (row.round() as usize).clamp(top, bottom - 1);
        canvas.fill(x + BAR_WIDTH, row, 6, 1, INK);
        let text = format!("{}{unit}", number(tick, step));
        canvas.text(
            &text,
            (x + BAR_WIDTH + 10) as f32,
            row as f32 + 6.0,
            TEXT_PX,
        );
    }
    if values.iter().any(|v| !v.is_finite()) {
        canvas.swatch(x, bottom + 14, NOTHING, "no value");
    }
    canvas.finish()
}

/// Draws flags: each pixel has the colour of its class, as `class_of` returns it.
pub(super) fn classes(
    sheet: &Sheet,
    title: &str,
    names: &[(&str, Rgb)],
    class_of: &dyn Fn(usize) -> usize,
) -> Picture {
    let mut canvas = Canvas::with_map(sheet, title, 270, &|pixel| names[class_of(pixel)].1);
    let (x, top) = (canvas.map_right() + 26, canvas.map_top);
    for (k, (name, colour)) in names.iter().enumerate() {
        canvas.swatch(x, top + 32 * k, *colour, name);
    }
    canvas.finish()
}

struct Canvas {
    picture: Picture,
    font: FontRef<'static>,
    map_left: usize,
    map_top: usize,
    map_width: usize,
    map_height: usize,
}

impl Canvas {
    fn with_map(sheet: &Sheet, title: &str, right: usize, colour: &dyn Fn(usize) -> Rgb) -> Canvas {
        let enlarge = WIDTH_MIN_PX.div_ceil(sheet.width).max(1);
        let map_width = sheet.width * enlarge;
        let map_height = ((sheet.height * enlarge) as f64 * sheet.aspect)
            .round()
            .max(1.0) as usize;
        let (map_left, map_top) = (MARGIN, 56);
        let width = map_left + map_width + right + MARGIN;
        let height = map_top + map_height + 64;
        let mut canvas = Canvas {
            picture: Picture {
                width,
                height,
                rgb: PAPER.repeat(width * height),
            },
            font: FontRef::try_from_slice(FONT).expect("assets/ contains a valid font"),
            map_left,
            map_top,
            map_width,
            map_height,
        };
        for row in 0..map_height {
            let source_row = row * sheet.height / map_height;
            for column in 0..map_width {
                let pixel = source_row * sheet.width + column / enlarge;
                canvas.set(map_left + column, map_top + row, colour(pixel));
            }
        }
        canvas.frame(map_left, map_top, map_width, map_height);
        canvas.text(title, map_left as f32, 38.0, TITLE_PX);
        canvas.length_bar(sheet, enlarge);
        canvas
    }

    fn map_right(&self) -> usize {
        self.map_left + self.map_width
    }

    fn map_bottom(&self) -> usize {
        self.map_top + self.map_height
    }

    /// Draws a bar of a round length, about a fifth of the map, below its left corner.
    fn length_bar(&mut self, sheet: &Sheet, enlarge: usize) {
        let per_pixel = sheet.column_mm.unwrap_or(1.0) / enlarge as f64;
        let length = round_step(0.2 * self.map_width as f64 * per_pixel);
        let pixels = (length / per_pixel).round() as usize;
        let y = self.map_bottom() + 22;
        self.fill(self.map_left, y, pixels, 4, INK);
        self.fill(self.map_left, y - 4, 1, 12, INK);
        self.fill(self.map_left + pixels, y - 4, 1, 12, INK);
        let unit = if sheet.column_mm.is_some() {
            "mm"
        } else {
            "px"
        };
        let text = format!("{} {unit}", number(length, length));
        self.text(
            &text,
            (self.map_left + pixels + 12) as f32,
            y as f32 + 8.0,
            TEXT_PX,
        );
    }

    fn swatch(&mut self, x: usize, y: usize, colour: Rgb, name: &str) {
        self.fill(x, y, 20, 20, colour);
        self.frame(x, y, 20, 20);
        self.text(name, (x + 30) as f32, y as f32 + 16.0, TEXT_PX);
    }

    fn set(&mut self, x: usize, y: usize, colour: Rgb) {
        if x < self.picture.width && y < self.picture.height {
            let at = (y * self.picture.width + x) * 3;
            self.picture.rgb[at..at + 3].copy_from_slice(&colour);
        }
    }

    fn fill(&mut self, x: usize, y: usize, width: usize, height: usize, colour: Rgb) {
        for row in y..y + height {
            for column in x..x + width {
                self.set(column, row, colour);
            }
        }
    }

    /// Draws a line of one pixel around a rectangle.
    fn frame(&mut self, x: usize, y: usize, width: usize, height: usize) {
        self.fill(x - 1, y - 1, width + 2, 1, INK);
        self.fill(x - 1, y + height, width + 2, 1, INK);
        self.fill(x - 1, y - 1, 1, height + 2, INK);
        self.fill(x + width, y - 1, 1, height + 2, INK);
    }

    /// Writes text from `x`, with its base line at `y`.
    fn text(&mut self, text: &str, x: f32, y: f32, size_px: f32) {
        let font = self.font.clone();
        let scaled = font.as_scaled(PxScale::from(size_px));
        let mut at = x;
        let mut last = None;
        for c in text.chars() {
            let id = scaled.glyph_id(c);
            if let Some(last) = last {
                at += scaled.kern(last, id);
            }
            let glyph = id.with_scale_and_position(PxScale::from(size_px), point(at, y));
            if let Some(outline) = font.outline_glyph(glyph) {
                let bounds = outline.px_bounds();
                outline.draw(|dx, dy, coverage| {
                    let px = bounds.min.x as i64 + i64::from(dx);
                    let py = bounds.min.y as i64 + i64::from(dy);
                    if px >= 0 && py >= 0 {
                        self.blend(px as usize, py as usize, coverage);
                    }
                });
            }
            at += scaled.h_advance(id);
            last = Some(id);
        }
    }

    fn blend(&mut self, x: usize, y: usize, coverage: f32) {
        if x < self.picture.width && y < self.picture.height {
            let at = (y * self.picture.width + x) * 3;
            for (k, ink) in INK.iter().enumerate() {
                let paper = f32::from(self.picture.rgb[at + k]);
                let mixed = paper + (f32::from(*ink) - paper) * coverage.clamp(0.0, 1.0);
                self.picture.rgb[at + k] = mixed.round() as u8;
            }
        }
    }

    fn finish(self) -> Picture {
        self.picture
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SHEET: Sheet = Sheet {
        width: 64,
        height: 48,
        column_mm: Some(0.2),
        aspect: 1.0,
    };

    #[test]
    fn ticks_are_round_and_within_the_scale() {
        assert_eq!(
            Scale::Range(3.7, 10.4).ticks(),
            [4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0]
        );
        let ticks = Scale::Range(0.118, 0.251).ticks();
        assert_eq!(ticks.len(), 7);
        assert_eq!(number(ticks[1], ticks[1] - ticks[0]), "0.14");
        assert_eq!(number(-3.0, 1.0), "−3");
        assert_eq!(number(0.0005, 0.0005), "0.0005");
    }

    #[test]
    fn layers_of_one_value_and_of_no_value_make_pictures_too() {
        let values = vec![5.0_f32; 64 * 48];
        let scale = Scale::of(&values).unwrap();
        assert_eq!(scale, Scale::Range(4.75, 5.25));
        let nothing = vec![f32::NAN; 64 * 48];
        assert_eq!(Scale::of(&nothing), None);
        let picture = layer(&SHEET, &nothing, None, "x", "°");
        assert_eq!(picture.rgb.len(), picture.width * picture.height * 3);
    }

    #[test]
    fn a_pixel_has_the_colour_of_its_value_on_the_bar() {
        let values: Vec<f32> = (0..64 * 48).map(|i| (i % 64) as f32).collect();
        let scale = Scale::Range(0.0, 63.0);
        let picture = layer(&SHEET, &values, Some(scale), "t", "");
        let at = |x: usize, y: usize| {
            let k = (y * picture.width + x) * 3;
            [picture.rgb[k], picture.rgb[k + 1], picture.rgb[k + 2]]
        };
        // The map is enlarged ten times from (24, 56).
        assert_eq!(at(24 + 105, 56 + 100), scale.colour(10.0));
        assert_eq!(at(24 + 635, 56 + 470), scale.colour(63.0));
        // The title is drawn above the map.
        assert!((0..60).any(|x| (20..40).any(|y| at(24 + x, y) == INK || at(24 + x, y)[0] < 120)));
    }
}
