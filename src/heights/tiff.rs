//! Heights in a TIFF: one grey channel of 16-bit or 32-bit integers or of floats.

use tiff::ColorType;
use tiff::decoder::{Decoder, DecodingResult, Limits};
use tiff::tags::Tag;

use super::check_size;
use crate::trace::scene::HeightMap;

/// Reads the first picture of a TIFF.
pub(super) fn read(content: &[u8], most: usize) -> Result<HeightMap, String> {
    let mut decoder = Decoder::new(std::io::Cursor::new(content))
        .map_err(|e| format!("this is not a readable TIFF: {e}"))?
        .with_limits(Limits::default());
    let (columns, rows) = decoder.dimensions().map_err(|e| e.to_string())?;
    let (columns, rows) = (columns as usize, rows as usize);
    check_size(columns, rows, most)?;
    match decoder.colortype().map_err(|e| e.to_string())? {
        ColorType::Gray(16 | 32 | 64) => {}
        other => {
            return Err(format!(
                "heights need a grey TIFF of 16-bit integers or 32-bit floats, this one is {other:?}"
            ));
        }
    }
    // Which way is up then, writers do not agree on.
    const WHITE_IS_ZERO: u32 = 0;
    let polarity = decoder.find_tag_unsigned::<u32>(Tag::PhotometricInterpretation);
    if polarity.map_err(|e| e.to_string())? == Some(WHITE_IS_ZERO) {
        return Err(
            "in this TIFF white is zero (PhotometricInterpretation 0), so it does not say if its numbers count \
             upwards: write it with black as zero"
                .to_owned(),
        );
    }
    let heights: Vec<f64> = match decoder.read_image().map_err(|e| e.to_string())? {
        DecodingResult::U16(v) => v.into_iter().map(f64::from).collect(),
        DecodingResult::I16(v) => v.into_iter().map(f64::from).collect(),
        DecodingResult::U32(v) => v.into_iter().map(f64::from).collect(),
        DecodingResult::I32(v) => v.into_iter().map(f64::from).collect(),
        DecodingResult::F32(v) => v.into_iter().map(f64::from).collect(),
        DecodingResult::F64(v) => v,
        _ => return Err("heights need 16-bit integers or floats".to_owned()),
    };
    if heights.len() != columns * rows {
        return Err(format!(
            "the TIFF holds {} heights instead of {columns} × {rows}",
            heights.len()
        ));
    }
    Ok(HeightMap {
        columns,
        rows,
        heights,
        units: None,
        filled: 0,
    })
}

#[cfg(test)]
mod tests {
    use super::super::{HEIGHTS_MAX, HeightMap};
    use tiff::encoder::{Compression, TiffEncoder, colortype};

    fn read(content: &[u8]) -> Result<HeightMap, String> {
        super::read(content, HEIGHTS_MAX)
    }

    #[test]
    fn compressed_heights_are_those_that_were_compressed() {
        for compression in [
            Compression::Lzw,
            Compression::Deflate(tiff::encoder::DeflateLevel::Balanced),
            Compression::Packbits,
        ] {
            let mut file = std::io::Cursor::new(Vec::new());
            let encoder = TiffEncoder::new(&mut file).unwrap();
            let mut encoder = encoder.with_compression(compression);
            let heights: Vec<u16> = (0..40 * 30).map(|n| 7 * n % 1009).collect();
            encoder
                .write_image::<colortype::Gray16>(40, 30, &heights)
                .unwrap();
            let map = read(&file.into_inner()).unwrap();
            assert!(
                map.heights
                    .iter()
                    .zip(&heights)
                    .all(|(a, b)| *a == f64::from(*b))
            );
        }
    }

    #[test]
    fn integers_and_floats_come_back_as_written_and_colours_are_refused() {
        let write = |what: u8| {
            let mut file = std::io::Cursor::new(Vec::new());
            let mut encoder = TiffEncoder::new(&mut file).unwrap();
            match what {
                0 => encoder.write_image::<colortype::Gray16>(2, 3, &[0, 1, 2, 3, 4, 65535]),
                1 => encoder.write_image::<colortype::Gray32Float>(
                    2,
                    3,
                    &[0.5, -1.0, 2.0, 3.0, 4.0, 5.25],
                ),
                2 => encoder.write_image::<colortype::RGB8>(1, 1, &[1, 2, 3]),
                _ => encoder.write_image::<colortype::Gray8>(1, 1, &[1]),
            }
            .unwrap();
            file.into_inner()
        };
        let map = read(&write(0)).unwrap();
        assert_eq!((map.columns, map.rows, map.heights[5]), (2, 3, 65535.0));
        let map = read(&write(1)).unwrap();
        assert_eq!((map.heights[1], map.heights[5]), (-1.0, 5.25));
        assert!(read(&write(2)).unwrap_err().contains("grey"));
        assert!(read(&write(3)).unwrap_err().contains("16-bit"));
        let whole = write(1);
        assert!(read(&whole[..whole.len() / 2]).is_err());
        assert!(read(b"").is_err());
    }
}
