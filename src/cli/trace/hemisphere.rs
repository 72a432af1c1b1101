//! Hemispheres of direction bins as pictures: a sheet of discs in one SVG, each with its colour bar.
//!
//! A disc shows the directions of exit from above: the polar angle grows linearly from the centre to the
//! rim for bins in angles, as its sine for bins that are pixels of the direction cosines. +u is
//! to the right, +v upwards. The lamp is marked by a ring, the mirror direction by a cross.

use std::fmt::Write as _;

use crate::cli::axis::signed;
use crate::map::colour::{Rgb, cyclic, diverging, sequential};
use crate::trace::grid::{Grid, Layout};
use crate::trace::height_field::Side;

/// Pixels across a disc's bitmap, and its side in the sheet.
const PIXELS: usize = 300;
const SIZE: f64 = 200.0;
const GAP: f64 = 26.0;
const TOP: f64 = 58.0;
const BAR: f64 = 36.0;
const NOTHING: Rgb = [226, 226, 226];

/// What the colours of a disc mean.
#[derive(Debug, Clone, Copy)]
pub(super) enum Scale {
    /// Powers of ten, from the first exponent to the second.
    Decades(f64, f64),
    /// From the first number to the second.
    Range(f64, f64),
    /// From −x over zero to x.
    Signed(f64),
    /// Angles of polarisation, −90° to 90° and round again.
    Turn,
}

impl Scale {
    /// Decades that hold the values: the highest down to at most five below it.
    pub(super) fn decades(values: impl Iterator<Item = f64>) -> Scale {
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for x in values.filter(|x| *x > 0.0) {
            low = low.min(x.log10());
            high = high.max(x.log10());
        }
        if high < low {
            return Scale::Decades(-1.0, 0.0);
        }
        let top = high.ceil();
        Scale::Decades(low.floor().max(top - 5.0).min(top - 1.0), top)
    }

    fn colour(self, x: f64) -> Rgb {
        match self {
            Scale::Decades(low, high) => {
                sequential((x.max(f64::MIN_POSITIVE).log10() - low) / (high - low))
            }
            Scale::Range(low, high) => sequential((x - low) / (high - low)),
            Scale::Signed(most) => diverging(x / most),
            Scale::Turn => cyclic(x / 180.0),
        }
    }

    /// The value at a fraction of the colour bar.
    fn at(self, fraction: f64) -> f64 {
        match self {
            Scale::Decades(low, high) => 10f64.powf(low + fraction * (high - low)),
            Scale::Range(low, high) => low + fraction * (high - low),
            Scale::Signed(most) => most * (2.0 * fraction - 1.0),
            Scale::Turn => 180.0 * fraction - 90.0,
        }
    }

    fn labels(self) -> [String; 3] {
        [0.0, 0.5, 1.0].map(|f| match self {
            Scale::Decades(low, high) => {
                let exponent = low + f * (high - low);
                if exponent.fract() == 0.0 {
                    power_of_ten(exponent)
                } else {
                    String::new()
                }
            }
            Scale::Turn => signed(&format!("{:.0}°", self.at(f))),
            _ => format!("{}", (self.at(f) * 1e4).round() / 1e4).replace('-', "−"),
        })
    }
}

/// 10 with its exponent raised.
fn power_of_ten(exponent: f64) -> String {
    const RAISED: [char; 10] = ['⁰', '¹', '²', '³', '⁴', '⁵', '⁶', '⁷', '⁸', '⁹'];
    let mut text = String::from("10");
    if exponent < 0.0 {
        text.push('⁻');
    }
    for digit in format!("{:.0}", exponent.abs()).chars() {
        text.push(RAISED[digit.to_digit(10).unwrap_or(0) as usize]);
    }
    text
}

/// One disc of a sheet.
pub(super) struct Disc {
    /// What it shows.
    pub title: String,
    /// Its colours.
    pub scale: Scale,
    /// Per bin of the upper side; `None` is painted grey.
    pub values: Vec<Option<f64>>,
}

/// Where lamp and mirror direction are to be marked.
#[derive(Debug, Clone, Copy)]
pub(super) struct Lamp {
    /// Polar angle, degrees.
    pub theta_deg: f64,
    /// Azimuth, degrees.
    pub phi_deg: f64,
}

/// A sheet of discs, so many in a row, with a title and a note below it.
pub(super) fn sheet(
    grid: Grid,
    lamp: Lamp,
    columns: usize,
    title: &str,
    note: &str,
    discs: &[Disc],
) -> String {
    let rows = discs.len().div_ceil(columns);
    let (cell_x, cell_y) = (SIZE + GAP, SIZE + 24.0 + BAR);
    let width = GAP + columns as f64 * cell_x;
    let height = TOP + rows as f64 * cell_y + 6.0;
    let mut svg = String::new();
    let _ = writeln!(
        svg,
        r##"<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}" font-family="DejaVu Sans, Verdana, sans-serif" font-size="11" fill="#282828">
<rect width="{width}" height="{height}" fill="white"/>
<text x="{GAP}" y="24" font-size="16">{}</text>
<text x="{GAP}" y="42" fill="#606060">{}</text>"##,
        escaped(title),
        escaped(note)
    );
    for (n, disc) in discs.iter().enumerate() {
        let x = GAP + (n % columns) as f64 * cell_x;
        let y = TOP + (n / columns) as f64 * cell_y;
        draw(&mut svg, grid, lamp, disc, x, y);
    }
    svg.push_str("</svg>\n");
    svg
}

fn draw(svg: &mut String, grid: Grid, lamp: Lamp, disc: &Disc, x: f64, y: f64) {
    let (centre_x, centre_y, radius) = (x + 0.5 * SIZE, y + 16.0 + 0.5 * SIZE, 0.5 * SIZE);
    let picture = base64(&bitmap(grid, disc));
    let top = y + 16.0;
    let _ = writeln!(
        svg,
        r##"<text x="{centre_x}" y="{}" text-anchor="middle" font-size="13">{}</text>
<image x="{x}" y="{top}" width="{SIZE}" height="{SIZE}" href="data:image/png;base64,{picture}"/>
<circle cx="{centre_x}" cy="{centre_y}" r="{radius}" fill="none" stroke="#282828" stroke-width="0.8"/>"##,
        y + 10.0,
        escaped(&disc.title)
    );
    for ring_deg in [30.0, 60.0] {
        let r = radius * from_centre(grid, ring_deg);
        let _ = writeln!(
            svg,
            r##"<circle cx="{centre_x}" cy="{centre_y}" r="{r:.1}" fill="none" stroke="#282828" stroke-opacity="0.25" stroke-width="0.6"/><text x="{:.1}" y="{:.1}" font-size="8" fill="#282828" fill-opacity="0.6" text-anchor="middle">{ring_deg}°</text>"##,
            centre_x - 0.707 * r,
            centre_y - 0.707 * r + 3.0
        );
    }
    let place = |phi_deg: f64| {
        let (s, c) = phi_deg.to_radians().sin_cos();
        let r = radius * from_centre(grid, lamp.theta_deg);
        (centre_x + r * c, centre_y - r * s)
    };
    let ((lx, ly), (mx, my)) = (place(lamp.phi_deg), place(lamp.phi_deg + 180.0));
    let _ = writeln!(
        svg,
        r##"<circle cx="{lx:.1}" cy="{ly:.1}" r="4" fill="none" stroke="white" stroke-width="2.4"/><circle cx="{lx:.1}" cy="{ly:.1}" r="4" fill="none" stroke="#282828" stroke-width="1.1"/><path d="M{:.1} {my:.1}h8M{mx:.1} {:.1}v8" stroke="white" stroke-width="2.4"/><path d="M{:.1} {my:.1}h8M{mx:.1} {:.1}v8" stroke="#282828" stroke-width="1.1"/>"##,
        mx - 4.0,
        my - 4.0,
        mx - 4.0,
        my - 4.0
    );
    let bar = base64(&colour_bar(disc.scale));
    let (bar_x, bar_y, bar_width) = (x + 10.0, y + SIZE + 24.0, SIZE - 20.0);
    let _ = writeln!(
        svg,
        r##"<image x="{bar_x}" y="{bar_y}" width="{bar_width}" height="8" preserveAspectRatio="none" href="data:image/png;base64,{bar}"/>"##
    );
    for (fraction, label) in [0.0, 0.5, 1.0].iter().zip(disc.scale.labels()) {
        let _ = writeln!(
            svg,
            r##"<text x="{}" y="{}" text-anchor="middle" font-size="10">{label}</text>"##,
            bar_x + fraction * bar_width,
            bar_y + 19.0
        );
    }
}

/// Distance of a polar angle from a disc's centre, the rim being at 1.
fn from_centre(grid: Grid, theta_deg: f64) -> f64 {
    match grid.layout {
        Layout::Polar => theta_deg / 90.0,
        Layout::Disc => theta_deg.to_radians().sin(),
    }
}

fn bitmap(grid: Grid, disc: &Disc) -> Vec<u8> {
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
            let [red, green, blue] = value.map_or(NOTHING, |v| disc.scale.colour(v));
            rgba.extend([red, green, blue, 255]);
        }
    }
    png_of(PIXELS, PIXELS, png::ColorType::Rgba, &rgba)
}

fn colour_bar(scale: Scale) -> Vec<u8> {
    const STEPS: usize = 256;
    let rgb: Vec<u8> = (0..STEPS)
        .flat_map(|n| scale.colour(scale.at(n as f64 / (STEPS - 1) as f64)))
        .collect();
    png_of(STEPS, 1, png::ColorType::Rgb, &rgb)
}

fn png_of(width: usize, height: usize, colour: png::ColorType, pixels: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width as u32, height as u32);
    encoder.set_color(colour);
    encoder.set_depth(png::BitDepth::Eight);
    encoder
        .write_header()
        .and_then(|mut writer| writer.write_image_data(pixels))
        .expect("a Vec takes a picture of the stated size");
    bytes
}

/// RFC 4648 with padding.
fn base64(bytes: &[u8]) -> String {
    const LETTERS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for three in bytes.chunks(3) {
        let mut word = [0u8; 3];
        word[..three.len()].copy_from_slice(three);
        let bits = u32::from_be_bytes([0, word[0], word[1], word[2]]);
        for place in 0..4 {
            if place <= three.len() {
                let index = (bits >> (18 - 6 * place)) & 63;
                text.push(char::from(LETTERS[index as usize]));
            } else {
                text.push('=');
            }
        }
    }
    text
}

/// Text as XML wants it.
pub(super) fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_is_that_of_the_standard() {
        for (plain, coded) in [
            ("", ""),
            ("f", "Zg=="),
            ("fo", "Zm8="),
            ("foo", "Zm9v"),
            ("foobar", "Zm9vYmFy"),
        ] {
            assert_eq!(base64(plain.as_bytes()), coded);
        }
    }

    #[test]
    fn a_sheet_shows_every_disc_and_decades_have_round_ends() {
        let grid = Grid::polar(9, 12);
        let discs: Vec<Disc> = (0..3)
            .map(|n| Disc {
                title: format!("m{n} < 1"),
                scale: Scale::Signed(1.0),
                values: vec![Some(0.5); grid.per_side()],
            })
            .collect();
        let lamp = Lamp {
            theta_deg: 45.0,
            phi_deg: 0.0,
        };
        let svg = sheet(grid, lamp, 2, "a", "b", &discs);
        assert_eq!(svg.matches("<image").count(), 6);
        assert!(svg.contains("m2 &lt; 1"));
        let Scale::Decades(low, high) = Scale::decades([0.02, 3.0, 0.0].into_iter()) else {
            panic!("decades")
        };
        assert_eq!((low, high), (-2.0, 1.0));
        assert_eq!(power_of_ten(-12.0), "10⁻¹²");
    }
}
