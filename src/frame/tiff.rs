//! The TIFF of a camera's program: one image of 16-bit grey counts, in either byte order.

use std::io::Cursor;

use tiff::decoder::{Decoder, DecodingResult, Limits};
use tiff::tags::Tag;
use tiff::{ColorType, TiffError};

use super::{Frame, FrameError, PIXELS_MAX, article, way_out};

/// Limit of the memory used to decode a frame, in bytes.
const BYTES_MAX: usize = 1 << 30;
/// Values of PhotometricInterpretation and Orientation.
const WHITE_IS_ZERO: u32 = 0;
const PALETTE: u32 = 3;
const COLOUR_FILTER: u32 = 32_803;
const UPRIGHT: u32 = 1;

/// Reads the image of a TIFF. The input is untrusted: a wrong or truncated file is an error.
pub(super) fn read(bytes: &[u8]) -> Result<Frame, FrameError> {
    let mut limits = Limits::default();
    limits.decoding_buffer_size = BYTES_MAX;
    limits.intermediate_buffer_size = BYTES_MAX;
    let mut decoder = Decoder::new(Cursor::new(bytes))
        .map_err(unreadable)?
        .with_limits(limits);
    let mut tag = |tag| decoder.find_tag_unsigned::<u32>(tag).map_err(unreadable);
    let polarity = tag(Tag::PhotometricInterpretation)?;
    let orientation = tag(Tag::Orientation)?.unwrap_or(UPRIGHT);
    match polarity {
        Some(PALETTE) => return Err(wrong("a palette TIFF".to_owned(), way_out(true))),
        Some(COLOUR_FILTER) => {
            let found = "the raw image of a camera with a colour filter";
            let way_out = "use a monochrome camera, or save the green pixels as a grey image of half the size";
            return Err(wrong(found.to_owned(), way_out));
        }
        _ => {}
    }
    let bits = match decoder.colortype().map_err(unreadable)? {
        ColorType::Gray(bits) => bits,
        other => {
            let channels = other.num_samples();
            let bits = other.bit_depth();
            let found = format!("{} {bits}-bit TIFF of {channels} channels", article(bits));
            return Err(wrong(found, way_out(true)));
        }
    };
    if polarity == Some(WHITE_IS_ZERO) {
        return Err(wrong(
            "a TIFF in which white is zero (PhotometricInterpretation 0)".to_owned(),
            "save it with black as zero",
        ));
    }
    if orientation != UPRIGHT {
        return Err(wrong(
            format!("a TIFF to be shown rotated or mirrored (Orientation {orientation})"),
            "save it in the sensor's orientation, with Orientation 1",
        ));
    }
    let (width_px, height_px) = decoder.dimensions().map_err(unreadable)?;
    let pixels = u64::from(width_px) * u64::from(height_px);
    if pixels > PIXELS_MAX {
        return Err(FrameError::WrongSize {
            width_px,
            height_px,
            pixels: usize::try_from(pixels).unwrap_or(usize::MAX),
        });
    }
    if decoder.more_images() {
        return Err(wrong(
            "a TIFF of several images".to_owned(),
            "save one image per file, and list each file with its own pose and exposure",
        ));
    }
    let kind = match decoder.read_image().map_err(unreadable)? {
        DecodingResult::U16(pixels_dn) if bits == 16 => {
            return Frame::new(width_px, height_px, pixels_dn);
        }
        DecodingResult::F16(_) | DecodingResult::F32(_) | DecodingResult::F64(_) => "floats",
        DecodingResult::I8(_)
        | DecodingResult::I16(_)
        | DecodingResult::I32(_)
        | DecodingResult::I64(_) => "signed numbers",
        _ => "grey",
    };
    let found = match kind {
        "grey" => format!("{} {bits}-bit grey TIFF", article(bits)),
        kind => format!("a TIFF of {bits}-bit {kind}"),
    };
    let way_out = match (kind, bits) {
        ("grey", 0..16) => way_out(false),
        _ => {
            "set the camera's program to save the counts themselves, as whole numbers from 0 to 65535"
        }
    };
    Err(wrong(found, way_out))
}

fn wrong(found: String, way_out: &'static str) -> FrameError {
    FrameError::WrongFormat { found, way_out }
}

fn unreadable(error: TiffError) -> FrameError {
    FrameError::UnreadableTiff(error.to_string())
}

#[cfg(test)]
mod tests {
    use tiff::encoder::colortype::{self, ColorType};
    use tiff::encoder::{Compression, TiffEncoder, TiffValue};

    use super::*;

    /// A TIFF with one image of 3 × 2 pixels for each list of values.
    fn file<C: ColorType>(pictures: &[&[C::Inner]], packing: Compression) -> Vec<u8>
    where
        [C::Inner]: TiffValue,
    {
        let mut bytes = Cursor::new(Vec::new());
        let mut encoder = TiffEncoder::new(&mut bytes)
            .unwrap()
            .with_compression(packing);
        for values in pictures {
            encoder.write_image::<C>(3, 2, values).unwrap();
        }
        bytes.into_inner()
    }

    const COUNTS: [u16; 6] = [0, 1, 256, 40_000, 65_535, 7];

    #[test]
    fn a_grey_tiff_gives_the_same_frame_as_the_png() {
        let frame = Frame::new(3, 2, COUNTS.to_vec()).unwrap();
        for packing in [
            Compression::Uncompressed,
            Compression::Lzw,
            Compression::Packbits,
            Compression::Deflate(Default::default()),
        ] {
            let tiff = file::<colortype::Gray16>(&[&COUNTS], packing);
            assert_eq!(Frame::read(&tiff).unwrap(), frame);
        }
        assert_eq!(Frame::read(&frame.to_png().unwrap()).unwrap(), frame);
    }

    /// The same counts in big-endian byte order.
    #[test]
    fn a_big_endian_tiff_gives_the_same_counts() {
        let entries: [(u16, u16, u32); 8] = [
            (256, 3, 3),
            (257, 3, 2),
            (258, 3, 16),
            (259, 3, 1),
            (262, 3, 1),
            (273, 4, 110),
            (278, 3, 2),
            (279, 4, 12),
        ];
        let mut bytes = b"MM\0*\0\0\0\x08\0\x08".to_vec();
        for (tag, kind, value) in entries {
            bytes.extend(tag.to_be_bytes());
            bytes.extend(kind.to_be_bytes());
            bytes.extend(1_u32.to_be_bytes());
            // A short is left-aligned in its four bytes.
            bytes.extend(if kind == 3 {
                (value << 16).to_be_bytes()
            } else {
                value.to_be_bytes()
            });
        }
        bytes.extend([0; 4]);
        assert_eq!(bytes.len(), 110);
        bytes.extend(COUNTS.iter().flat_map(|dn| dn.to_be_bytes()));
        assert_eq!(Frame::read(&bytes).unwrap().pixels_dn(), COUNTS);
    }

    #[test]
    fn another_kind_of_file_is_named_with_the_remedy() {
        let plain = Compression::Uncompressed;
        let turned = {
            let mut bytes = Cursor::new(Vec::new());
            let mut encoder = TiffEncoder::new(&mut bytes).unwrap();
            let mut image = encoder.new_image::<colortype::Gray16>(3, 2).unwrap();
            image.encoder().write_tag(Tag::Orientation, 3_u16).unwrap();
            image.write_data(&COUNTS).unwrap();
            bytes.into_inner()
        };
        for (bytes, words) in [
            (
                file::<colortype::Gray8>(&[&[1; 6]], plain),
                ["an 8-bit grey TIFF", "all its bits"],
            ),
            (
                file::<colortype::RGB16>(&[&[1; 18]], plain),
                ["3 channels", "one grey channel"],
            ),
            (
                file::<colortype::Gray32Float>(&[&[0.5; 6]], plain),
                ["32-bit floats", "whole numbers"],
            ),
            (
                file::<colortype::Gray32>(&[&[5; 6]], plain),
                ["a 32-bit grey TIFF", "0 to 65535"],
            ),
            (
                file::<colortype::GrayI16>(&[&[-5; 6]], plain),
                ["16-bit signed", "whole numbers"],
            ),
            (
                file::<colortype::Gray16>(&[&COUNTS, &COUNTS], plain),
                ["several images", "one image per file"],
            ),
            (turned, ["Orientation 3", "the sensor's orientation"]),
            (b"\xff\xd8\xff\xe0JFIF".to_vec(), ["a JPEG", "PNG or TIFF"]),
            (
                b"SIMPLE  =                    T".to_vec(),
                ["a FITS file", "16-bit grey"],
            ),
            (Vec::new(), ["the file is empty", "PNG or TIFF"]),
        ] {
            let said = Frame::read(&bytes).unwrap_err().to_string();
            for word in words {
                assert!(said.contains(word), "`{word}` is not in: {said}");
            }
        }
    }

    #[test]
    fn every_truncation_of_a_tiff_is_an_error() {
        let tiff = file::<colortype::Gray16>(&[&COUNTS], Compression::Lzw);
        for end in 0..tiff.len() - 8 {
            assert!(
                Frame::read(&tiff[..end]).is_err(),
                "{end} of {} bytes pass",
                tiff.len()
            );
        }
    }
}
