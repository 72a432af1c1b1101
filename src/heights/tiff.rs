//! Heights in a TIFF: one grey channel of 16-bit or 32-bit integers or floats.
//!
//! A file of several images is read if exactly one can be the heights: the only grey one of
//! suitable depth, the only one with a suitable name, or the only one of floats. A note states the
//! choice; an ambiguous file is refused.

use tiff::ColorType;
use tiff::decoder::{Decoder, DecodingResult, Limits};
use tiff::tags::Tag;

use super::missing::{Kind, mark};
use super::text::number;
use super::{check_size, tiff_scale};
use crate::trace::scene::HeightMap;

/// Largest number of images that are examined.
const IMAGES_MAX: usize = 1000;
/// Words in the name of an image of heights.
const NAMES: [&str; 8] = [
    "height",
    "topo",
    "höhe",
    "hoehe",
    "hauteur",
    "elevation",
    "z map",
    "zmap",
];

type TiffDecoder<'c> = Decoder<std::io::Cursor<&'c [u8]>>;

/// Properties that distinguish an image of a file from the others.
struct TiffImage {
    index: usize,
    size: (u32, u32),
    colour: ColorType,
    is_float: bool,
    /// A reduced copy of another image, or a mask.
    is_aside: bool,
    is_named: bool,
}

impl TiffImage {
    fn of(decoder: &mut TiffDecoder<'_>, index: usize) -> Result<Self, String> {
        /// The sample format of floats.
        const FLOAT: u16 = 3;
        let message = |e: tiff::TiffError| e.to_string();
        let format = decoder.find_tag_unsigned_vec::<u16>(Tag::SampleFormat);
        let aside = decoder.find_tag_unsigned::<u32>(Tag::NewSubfileType);
        let name = |decoder: &mut TiffDecoder<'_>, tag| {
            let name = decoder.get_tag_ascii_string(tag).unwrap_or_default();
            // Structured descriptions apply to the whole file.
            let is_plain = name.len() < 200 && !name.trim_start().starts_with(['{', '<']);
            if is_plain {
                name.to_lowercase()
            } else {
                String::new()
            }
        };
        /// The tag of a page's name.
        const PAGE_NAME: Tag = Tag::Unknown(285);
        let names = [Tag::ImageDescription, PAGE_NAME].map(|tag| name(decoder, tag));
        Ok(TiffImage {
            index,
            size: decoder.dimensions().map_err(message)?,
            colour: decoder.colortype().map_err(message)?,
            is_float: matches!(format, Ok(Some(f)) if f.first() == Some(&FLOAT)),
            is_aside: matches!(aside, Ok(Some(kind)) if kind & 0b101 != 0),
            is_named: names
                .iter()
                .any(|name| NAMES.iter().any(|word| name.contains(word))),
        })
    }

    fn may_be_heights(&self) -> bool {
        matches!(self.colour, ColorType::Gray(16 | 32 | 64)) && !self.is_aside
    }
}

/// Returns the image that contains the heights, and the reason of the choice if there are others.
fn heights_of(decoder: &mut TiffDecoder<'_>) -> Result<(usize, Option<String>), String> {
    let mut images = Vec::new();
    loop {
        images.push(TiffImage::of(decoder, images.len())?);
        if !decoder.more_images() || images.len() == IMAGES_MAX {
            break;
        }
        let next = decoder.next_image();
        next.map_err(|e| {
            format!(
                "image {} of this TIFF cannot be read: {e}",
                images.len() + 1
            )
        })?;
    }
    let may: Vec<&TiffImage> = images.iter().filter(|p| p.may_be_heights()).collect();
    let only = |which: fn(&TiffImage) -> bool| {
        let mut those = may.iter().filter(|p| which(p));
        those.next().filter(|_| those.next().is_none())
    };
    let found = only(|_| true)
        .map(|p| (p, "it is the only grey one of 16-bit integers or floats"))
        .or_else(|| {
            only(|p| p.is_named).map(|p| (p, "it is the only one whose name indicates heights"))
        })
        .or_else(|| only(|p| p.is_float).map(|p| (p, "it is the only one of floats")));
    match (found, &images[..]) {
        (Some((image, _)), [_]) => Ok((image.index, None)),
        (Some((image, why)), all) => Ok((
            image.index,
            Some(format!(
                "the TIFF has {} images; number {} ({} × {}) is read as the heights because {why}",
                all.len(),
                image.index + 1,
                image.size.0,
                image.size.1
            )),
        )),
        (None, all) if may.is_empty() => Err(format!(
            "expected a grey TIFF of 16-bit integers or 32-bit floats, got {:?}",
            all[0].colour
        )),
        (None, all) => Err(format!(
            "the TIFF has {} images, and {} of them could be the heights ({}): save only the heights \
             in a file, as floats, or name their page accordingly",
            all.len(),
            may.len(),
            may.iter()
                .take(4)
                .map(|p| format!(
                    "number {}, {} × {}, {:?}",
                    p.index + 1,
                    p.size.0,
                    p.size.1,
                    p.colour
                ))
                .collect::<Vec<_>>()
                .join("; ")
        )),
    }
}

/// The message about a TIFF that cannot be decoded.
fn unreadable(error: &tiff::TiffError) -> String {
    format!(
        "the TIFF is damaged or packed in a way that is not read here ({error}): save it without compression, or with LZW, deflate or \
         PackBits"
    )
}

/// Reads the heights of a TIFF.
pub(super) fn read(content: &[u8], most: usize) -> Result<HeightMap, String> {
    let mut decoder = Decoder::new(std::io::Cursor::new(content))
        .map_err(|e| format!("the TIFF cannot be read: {e}"))?
        .with_limits(Limits::default());
    let (index, note) = heights_of(&mut decoder)?;
    decoder.seek_to_image(index).map_err(|e| e.to_string())?;
    let (columns, rows) = decoder.dimensions().map_err(|e| e.to_string())?;
    let (columns, rows) = (columns as usize, rows as usize);
    check_size(columns, rows, most)?;
    // Programs differ in which direction is up in such a file.
    const WHITE_IS_ZERO: u32 = 0;
    let polarity = decoder.find_tag_unsigned::<u32>(Tag::PhotometricInterpretation);
    if polarity.map_err(|e| e.to_string())? == Some(WHITE_IS_ZERO) {
        return Err(
            "white is zero in this TIFF (PhotometricInterpretation 0), so it is ambiguous whether larger numbers \
             are higher: save it with black as zero"
                .to_owned(),
        );
    }
    let no_data = decoder.get_tag_ascii_string(Tag::GdalNodata).ok();
    let no_data = no_data.and_then(|word| number(word.trim_end_matches('\0')));
    let mut heights: Vec<f64> = match decoder.read_image().map_err(|e| unreadable(&e))? {
        DecodingResult::U16(v) => v.into_iter().map(f64::from).collect(),
        DecodingResult::I16(v) => v.into_iter().map(f64::from).collect(),
        DecodingResult::U32(v) => v.into_iter().map(f64::from).collect(),
        DecodingResult::I32(v) => v.into_iter().map(f64::from).collect(),
        DecodingResult::F32(v) => v.into_iter().map(f64::from).collect(),
        DecodingResult::F64(v) => v,
        _ => {
            return Err(
                "expected 16-bit or 32-bit integers, or floats of 32 or 64 bits".to_owned(),
            );
        }
    };
    if heights.len() != columns * rows {
        return Err(format!(
            "the TIFF contains {} heights instead of {columns} × {rows}",
            heights.len()
        ));
    }
    let marked = mark(&mut heights, no_data.as_slice(), Kind::Heights);
    let scale = tiff_scale::of(&mut decoder);
    let notes = [note, scale.note].into_iter().flatten();
    Ok(HeightMap {
        notes: notes.chain(marked).collect(),
        pitch_um: scale.pitch_um,
        height_unit_um: scale.height_unit_um,
        ..HeightMap::new(columns, heights)
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
    fn compressed_heights_round_trip() {
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
    fn integers_and_floats_round_trip_and_colours_are_refused() {
        let write = |what: u8| {
            let mut file = std::io::Cursor::new(Vec::new());
            let mut encoder = TiffEncoder::new(&mut file).unwrap();
            match what {
                0 => encoder.write_image::<colortype::Gray16>(2, 3, &[0, 1, 2, 3, 4, 7]),
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
        assert_eq!((map.columns, map.rows, map.heights[5]), (2, 3, 7.0));
        let map = read(&write(1)).unwrap();
        assert_eq!((map.heights[1], map.heights[5]), (-1.0, 5.25));
        assert!(read(&write(2)).unwrap_err().contains("grey"));
        assert!(read(&write(3)).unwrap_err().contains("16-bit"));
        let whole = write(1);
        assert!(read(&whole[..whole.len() / 2]).is_err());
        assert!(read(b"").is_err());
    }

    #[test]
    fn of_several_images_the_only_candidate_is_read_and_noted_and_ambiguity_is_refused() {
        let (whole, light) = ([0.5f32, 1.0, 2.0, 3.0], [10u16, 20, 30, 40]);
        let write = |kinds: &str| {
            let mut file = std::io::Cursor::new(Vec::new());
            let mut encoder = TiffEncoder::new(&mut file).unwrap();
            for kind in kinds.chars() {
                match kind {
                    'f' => encoder.write_image::<colortype::Gray32Float>(2, 2, &whole),
                    'c' => encoder.write_image::<colortype::RGB8>(1, 1, &[1, 2, 3]),
                    'b' => encoder.write_image::<colortype::Gray8>(2, 2, &[1, 2, 3, 4]),
                    'n' => {
                        let mut image = encoder.new_image::<colortype::Gray16>(2, 2).unwrap();
                        let tags = image.encoder();
                        tags.write_tag(tiff::tags::Tag::ImageDescription, "Topography")
                            .unwrap();
                        image.write_data(&light)
                    }
                    _ => encoder.write_image::<colortype::Gray16>(2, 2, &light),
                }
                .unwrap();
            }
            file.into_inner()
        };
        for (kinds, number, first) in [
            ("if", 2, 0.5),
            ("fi", 1, 0.5),
            ("cbi", 3, 10.0),
            ("iin", 3, 10.0),
            ("cf", 2, 0.5),
        ] {
            let map = read(&write(kinds)).unwrap_or_else(|why| panic!("{kinds}: {why}"));
            assert_eq!(map.heights[0], first, "{kinds}");
            assert!(
                map.notes[0].contains(&format!("number {number} ")),
                "{:?}",
                map.notes
            );
        }
        assert!(read(&write("f")).unwrap().notes.is_empty());
        for kinds in ["ii", "ff", "iic"] {
            let why = read(&write(kinds)).unwrap_err();
            assert!(why.contains("save only the heights"), "{kinds}: {why}");
        }
    }

    #[test]
    fn points_equal_to_the_no_data_tag_are_missing() {
        let mut file = std::io::Cursor::new(Vec::new());
        let mut encoder = TiffEncoder::new(&mut file).unwrap();
        let mut image = encoder.new_image::<colortype::Gray32Float>(2, 2).unwrap();
        let tags = image.encoder();
        tags.write_tag(tiff::tags::Tag::GdalNodata, "-7").unwrap();
        image.write_data(&[1.0, -7.0, 2.0, 3.0]).unwrap();
        let map = read(&file.into_inner()).unwrap();
        assert!(map.heights[1].is_nan() && map.missing() == 1);
    }
}
