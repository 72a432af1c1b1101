//! An 8-bit picture of a frame for the eye: binned down by averaging, and stretched between two percentiles.

use super::{Frame, FrameError};

/// Largest side of a picture, px.
pub const SIDE_PX_MAX: u32 = 512;
/// Share of the pixels below black, and the same above white, in per cent.
pub const CLIPPED_PERCENT: f64 = 0.2;
/// Least span from black to white, DN. The noise of an even frame is not stretched further.
const SPAN_DN_MIN: f64 = 16.0;

/// An 8-bit picture of a frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    /// 8-bit grey PNG.
    pub png: Vec<u8>,
    /// Columns.
    pub width_px: u32,
    /// Rows.
    pub height_px: u32,
    /// Count that is black.
    pub low_dn: f64,
    /// Count that is white.
    pub high_dn: f64,
}

impl Picture {
    /// Returns a picture of at most `side_px` columns and rows (at least 1). Each of its pixels is the mean of a square of
    /// the frame. [`CLIPPED_PERCENT`] of the pixels are black or darker, as many white or brighter. Pixels that are
    /// `masked` take no part; a square of masked pixels only is black.
    ///
    /// # Errors
    /// [`FrameError::Encoding`] if the encoder fails, which only a lack of memory causes.
    pub fn of(frame: &Frame, side_px: u32, masked: Option<&[bool]>) -> Result<Self, FrameError> {
        let (width, height) = (frame.width_px() as usize, frame.height_px() as usize);
        let edge = width.max(height).div_ceil(side_px.max(1) as usize);
        let (columns, rows) = (width.div_ceil(edge), height.div_ceil(edge));
        let counts = |pixel: usize| !masked.is_some_and(|masked| masked[pixel]);
        let (low_dn, high_dn) = ends(frame, &counts);
        let grey = 255.0 / (high_dn - low_dn);
        let mut bytes = Vec::with_capacity(columns * rows);
        let mut sums = vec![(0_u64, 0_u32); columns];
        for row in 0..rows {
            sums.fill((0, 0));
            for y in row * edge..height.min((row + 1) * edge) {
                let line = &frame.pixels_dn()[y * width..][..width];
                for (x, dn) in line.iter().enumerate() {
                    if counts(y * width + x) {
                        let (sum, n) = &mut sums[x / edge];
                        *sum += u64::from(*dn);
                        *n += 1;
                    }
                }
            }
            bytes.extend(sums.iter().map(|(sum, n)| {
                let mean = *sum as f64 / f64::from((*n).max(1));
                ((mean - low_dn) * grey).round().clamp(0.0, 255.0) as u8
            }));
        }
        let mut png = Vec::with_capacity(bytes.len() / 2 + 128);
        let mut encoder = png::Encoder::new(&mut png, columns as u32, rows as u32);
        encoder.set_color(png::ColorType::Grayscale);
        encoder.set_depth(png::BitDepth::Eight);
        let mut writer = encoder.write_header()?;
        writer.write_image_data(&bytes)?;
        writer.finish()?;
        Ok(Picture {
            png,
            width_px: columns as u32,
            height_px: rows as u32,
            low_dn,
            high_dn,
        })
    }
}

/// Returns the counts of black and white.
fn ends(frame: &Frame, counts: &dyn Fn(usize) -> bool) -> (f64, f64) {
    let mut histogram = vec![0_u64; 1 << 16];
    for (pixel, dn) in frame.pixels_dn().iter().enumerate() {
        if counts(pixel) {
            histogram[usize::from(*dn)] += 1;
        }
    }
    let total: u64 = histogram.iter().sum();
    let below = |percent: f64| {
        let rank = ((percent / 100.0) * total as f64).ceil().max(1.0) as u64;
        let mut sum = 0;
        let reached = histogram.iter().position(|n| {
            sum += n;
            sum >= rank
        });
        reached.unwrap_or(0) as f64
    };
    let (low, high) = (below(CLIPPED_PERCENT), below(100.0 - CLIPPED_PERCENT));
    match high - low >= SPAN_DN_MIN {
        true => (low, high),
        false => {
            let middle = 0.5 * (low + high);
            (middle - 0.5 * SPAN_DN_MIN, middle + 0.5 * SPAN_DN_MIN)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Cursor;

    fn decoded(picture: &Picture) -> Vec<u8> {
        let mut reader = png::Decoder::new(Cursor::new(&picture.png))
            .read_info()
            .unwrap();
        let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut bytes).unwrap();
        assert_eq!(info.bit_depth, png::BitDepth::Eight);
        assert_eq!(
            (info.width, info.height),
            (picture.width_px, picture.height_px)
        );
        bytes
    }

    #[test]
    fn squares_are_averaged_and_the_ends_are_percentiles() {
        // A ramp of 0 to 999 along the columns, and one pixel far above it.
        let mut pixels: Vec<u16> = (0..1000 * 10).map(|i| (i % 1000) as u16).collect();
        pixels[5] = 60_000;
        let frame = Frame::new(1000, 10, pixels).unwrap();
        let picture = Picture::of(&frame, SIDE_PX_MAX, None).unwrap();
        assert_eq!((picture.width_px, picture.height_px), (500, 5));
        assert!((picture.low_dn - 1.5).abs() <= 1.0, "{} DN", picture.low_dn);
        assert!(
            (picture.high_dn - 997.5).abs() <= 1.0,
            "{} DN",
            picture.high_dn
        );
        let bytes = decoded(&picture);
        assert_eq!((bytes[500], bytes[999]), (0, 255));
        let middle = i32::from(bytes[750]);
        assert!((middle - 128).abs() <= 1, "{middle}");
        // The pixel fills its square unless it is masked.
        assert_eq!(bytes[2], 255);
        let mut masked = vec![false; 10_000];
        masked[5] = true;
        let picture = Picture::of(&frame, SIDE_PX_MAX, Some(&masked)).unwrap();
        assert!(decoded(&picture)[2] < 3);
    }

    #[test]
    fn an_even_frame_is_grey_and_one_of_odd_size_keeps_its_edge() {
        let frame = Frame::new(7, 3, vec![200; 21]).unwrap();
        let picture = Picture::of(&frame, 4, None).unwrap();
        assert_eq!((picture.width_px, picture.height_px), (4, 2));
        let bytes = decoded(&picture);
        assert!(
            bytes.iter().all(|grey| (127..=128).contains(grey)),
            "{bytes:?}"
        );
    }
}
