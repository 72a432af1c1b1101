//! A camera frame of 16-bit grey counts, its lossless PNG, and the TIFF that camera programs write.

pub mod picture;
mod tag;
mod tiff;
pub mod tiff_stack;

use std::io::Cursor;
use std::str::FromStr;

pub use picture::Picture;
pub use tag::{FrameTag, TagError};

use crate::words::words;

words! {
    /// Kind of a frame.
    #[derive(utoipa::ToSchema)]
    pub enum FrameKind {
        /// The sample.
        Sample = "sample",
        /// No light: the lens is capped.
        Dark = "dark",
        /// The white reference.
        Flat = "flat",
    }
}

impl TryFrom<String> for FrameKind {
    type Error = UnknownKind;

    fn try_from(word: String) -> Result<FrameKind, UnknownKind> {
        word.parse()
    }
}

/// A word that is not a kind of frame.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` is not a kind of frame: expected sample, dark or flat")]
pub struct UnknownKind(pub String);

impl FromStr for FrameKind {
    type Err = UnknownKind;

    fn from_str(word: &str) -> Result<FrameKind, UnknownKind> {
        FrameKind::from_word(word).ok_or_else(|| UnknownKind(word.to_owned()))
    }
}

/// 16-bit grey counts (DN), row by row from the top left, right-aligned.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Frame {
    width_px: u32,
    height_px: u32,
    pixels_dn: Vec<u16>,
}

/// Why bytes are not a frame.
#[derive(Debug, thiserror::Error)]
pub enum FrameError {
    /// A damaged or truncated PNG.
    #[error("the file is not a readable PNG: {0}")]
    Unreadable(#[from] png::DecodingError),
    /// A damaged or truncated TIFF, or an unsupported one.
    #[error(
        "the file is not a readable TIFF: {0}; it is damaged, or packed in a way that is not read here: save it without compression, or \
         with deflate"
    )]
    UnreadableTiff(String),
    /// Neither PNG nor TIFF.
    #[error(
        "the file is {found}, but frames are 16-bit grey PNG or TIFF files: set the camera's program to save them so, without \
         scaling the counts"
    )]
    OtherFile {
        /// The kind of file, with its article.
        found: &'static str,
    },
    /// PNG or TIFF, but not 16-bit grey.
    #[error("the file is {found}, but frames are 16-bit grey: {way_out}")]
    WrongFormat {
        /// Colour type, depth and kind of file, with an article.
        found: String,
        /// What to do.
        way_out: &'static str,
    },
    /// Pixel count and size disagree, or the size is zero or above 2²⁸ pixels.
    #[error("{pixels} pixels are not a valid frame of {width_px} × {height_px}")]
    WrongSize {
        /// The stated width.
        width_px: u32,
        /// The stated height.
        height_px: u32,
        /// Number of pixels given.
        pixels: usize,
    },
    /// The encoder failed.
    #[error("the frame could not be encoded as PNG: {0}")]
    Encoding(#[from] png::EncodingError),
}

/// Kind of a file, from its first bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FileKind {
    /// PNG.
    Png,
    /// TIFF, including BigTIFF.
    Tiff,
    /// Another kind, named with its article.
    Other(&'static str),
}

impl FileKind {
    /// Returns the kind of a file from its bytes; the first dozen suffices.
    #[must_use]
    pub fn of(bytes: &[u8]) -> FileKind {
        const STARTS: [(&[u8], FileKind); 13] = [
            (b"\x89PNG", FileKind::Png),
            (b"II*\0", FileKind::Tiff),
            (b"MM\0*", FileKind::Tiff),
            (b"II+\0", FileKind::Tiff),
            (b"MM\0+", FileKind::Tiff),
            (
                b"\xff\xd8\xff",
                FileKind::Other("a JPEG, which does not preserve counts"),
            ),
            (
                b"BM",
                FileKind::Other("a Windows bitmap (BMP), which has only 8 bits"),
            ),
            (b"GIF8", FileKind::Other("a GIF, which has only 8 bits")),
            (b"SIMPLE  =", FileKind::Other("a FITS file")),
            (b"P5", FileKind::Other("a PGM")),
            (b"\x93NUMPY", FileKind::Other("a NumPy array")),
            (b"\x89HDF", FileKind::Other("an HDF5 file")),
            (b"PK\x03\x04", FileKind::Other("a ZIP archive")),
        ];
        if bytes.is_empty() {
            return FileKind::Other("empty");
        }
        let known = STARTS.iter().find(|(start, _)| bytes.starts_with(start));
        known.map_or(FileKind::Other("neither a PNG nor a TIFF"), |(_, kind)| {
            *kind
        })
    }
}

/// The indefinite article of a number of bits.
fn article(bits: u8) -> &'static str {
    match bits {
        8 => "an",
        _ => "a",
    }
}

/// The remedy for an image of another kind.
fn way_out(coloured: bool) -> &'static str {
    match coloured {
        true => {
            "set the camera's program to save the raw counts of one grey channel; an image with colours, a palette or \
             transparency has been processed"
        }
        false => "set the camera's program to save all its bits, right-aligned in 16",
    }
}

/// Larger frames are refused before memory is allocated for them.
const PIXELS_MAX: u64 = 1 << 28;

impl Frame {
    /// Makes a frame of `width_px` × `height_px` counts, row by row from the top left.
    ///
    /// # Errors
    /// [`FrameError::WrongSize`] if the number of pixels does not match the size.
    pub fn new(width_px: u32, height_px: u32, pixels_dn: Vec<u16>) -> Result<Self, FrameError> {
        let pixels = u64::from(width_px) * u64::from(height_px);
        if pixels == 0 || pixels > PIXELS_MAX || pixels != pixels_dn.len() as u64 {
            return Err(FrameError::WrongSize {
                width_px,
                height_px,
                pixels: pixels_dn.len(),
            });
        }
        Ok(Frame {
            width_px,
            height_px,
            pixels_dn,
        })
    }

    /// Width in pixels.
    #[must_use]
    pub fn width_px(&self) -> u32 {
        self.width_px
    }

    /// Height in pixels.
    #[must_use]
    pub fn height_px(&self) -> u32 {
        self.height_px
    }

    /// Counts, row by row from the top left.
    #[must_use]
    pub fn pixels_dn(&self) -> &[u16] {
        &self.pixels_dn
    }

    /// Reads a 16-bit grey PNG or TIFF, distinguished by the first bytes. The input is untrusted:
    /// all other content is an error.
    ///
    /// # Errors
    /// [`FrameError`] describes the fault.
    pub fn read(bytes: &[u8]) -> Result<Self, FrameError> {
        match FileKind::of(bytes) {
            FileKind::Png => Frame::from_png(bytes),
            FileKind::Tiff => tiff::read(bytes),
            FileKind::Other(found) => Err(FrameError::OtherFile { found }),
        }
    }

    /// Reads a 16-bit grey PNG. The input is untrusted: a wrong or truncated file is an error.
    ///
    /// # Errors
    /// [`FrameError`] describes the fault.
    pub fn from_png(bytes: &[u8]) -> Result<Self, FrameError> {
        let limits = png::Limits { bytes: 1 << 30 };
        let mut decoder = png::Decoder::new_with_limits(Cursor::new(bytes), limits);
        decoder.set_transformations(png::Transformations::IDENTITY);
        let mut reader = decoder.read_info()?;
        let (width_px, height_px, color, depth) = {
            let info = reader.info();
            (info.width, info.height, info.color_type, info.bit_depth)
        };
        if color != png::ColorType::Grayscale || depth != png::BitDepth::Sixteen {
            let what = match color {
                png::ColorType::Grayscale => "grey",
                png::ColorType::GrayscaleAlpha => "grey, transparent",
                png::ColorType::Indexed => "palette",
                png::ColorType::Rgb | png::ColorType::Rgba => "colour",
            };
            let bits = depth as u8;
            return Err(FrameError::WrongFormat {
                found: format!("{} {bits}-bit {what} PNG", article(bits)),
                way_out: way_out(color != png::ColorType::Grayscale),
            });
        }
        let pixels = u64::from(width_px) * u64::from(height_px);
        if pixels > PIXELS_MAX {
            return Err(FrameError::WrongSize {
                width_px,
                height_px,
                pixels: pixels as usize,
            });
        }
        let mut bytes = vec![0; pixels as usize * 2];
        reader.next_frame(&mut bytes)?;
        reader.finish()?;
        let pixels_dn = bytes
            .as_chunks::<2>()
            .0
            .iter()
            .map(|b| u16::from_be_bytes(*b))
            .collect();
        Frame::new(width_px, height_px, pixels_dn)
    }

    /// Encodes the frame as a 16-bit grey PNG; equal frames give equal bytes.
    ///
    /// # Errors
    /// [`FrameError::Encoding`] if the encoder fails, which only a lack of memory causes.
    pub fn to_png(&self) -> Result<Vec<u8>, FrameError> {
        let mut out = Vec::with_capacity(self.pixels_dn.len() * 2 + 128);
        let mut encoder = png::Encoder::new(&mut out, self.width_px, self.height_px);
        encoder.set_color(png::ColorType::Grayscale);
        encoder.set_depth(png::BitDepth::Sixteen);
        encoder.set_compression(png::Compression::Fast);
        let mut writer = encoder.write_header()?;
        let bytes: Vec<u8> = self
            .pixels_dn
            .iter()
            .flat_map(|dn| dn.to_be_bytes())
            .collect();
        writer.write_image_data(&bytes)?;
        writer.finish()?;
        Ok(out)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_round_trips_through_png_bit_for_bit() {
        let pixels = (0..7 * 5).map(|i| (i * 1999 % 65536) as u16).collect();
        let frame = Frame::new(7, 5, pixels).unwrap();
        assert_eq!(Frame::from_png(&frame.to_png().unwrap()).unwrap(), frame);
    }

    #[test]
    fn every_truncation_of_a_file_is_an_error() {
        let png = Frame::new(3, 2, vec![1, 2, 3, 4, 5, 65535])
            .unwrap()
            .to_png()
            .unwrap();
        for end in 0..png.len() {
            assert!(
                Frame::from_png(&png[..end]).is_err(),
                "{end} bytes of {} pass",
                png.len()
            );
        }
    }
}
