//! Surface data files of ISO 25178-71 (SDF, also BCR): a header of names and values, then heights
//! as text (`aISO-1.0`, `aBCR-1.0`) or as little-endian numbers (`bISO-1.0`, `bBCR-1.0`). Scales
//! are in metres. A missing point is `BAD`, or the lowest integer of its type.

use super::check_size;
use super::missing::{Kind, is_mark, mark};
use super::text::number;
use crate::trace::scene::{HeightMap, MapUnits};
use crate::wording::encoding::{quoted, text_of};

/// First letters of the four kinds.
const KINDS: [&[u8; 4]; 4] = [b"aISO", b"aBCR", b"bISO", b"bBCR"];
/// Size of the binary header in bytes: version 8, maker and dates 10, 12 and 12, two integers of 2,
/// four doubles, and three bytes for compression, type and checksum.
const BINARY: usize = 81;

/// Whether a file is an SDF file, by its first letters.
pub(super) fn is_one(content: &[u8]) -> bool {
    let content = content.strip_prefix(b"\xef\xbb\xbf").unwrap_or(content);
    let start = content.trim_ascii_start();
    let kind = start.get(..4).unwrap_or_default();
    KINDS
        .iter()
        .any(|known| kind.eq_ignore_ascii_case(&known[..]))
}

/// The header's contents.
#[derive(Debug)]
struct SdfHeader {
    columns: usize,
    rows: usize,
    x_um: f64,
    y_um: f64,
    z_um: f64,
}

impl SdfHeader {
    /// Makes a header from the counts and the scales in metres.
    fn of(counts: [f64; 2], metres: [f64; 3], most: usize) -> Result<Self, String> {
        for (name, count) in ["NumPoints", "NumProfiles"].into_iter().zip(counts) {
            if !(count >= 1.0 && count.fract() == 0.0) {
                return Err(format!(
                    "the header of this SDF file has {name} = {count}, which is not a valid number of points"
                ));
            }
        }
        let (columns, rows) = (counts[0] as usize, counts[1] as usize);
        check_size(columns, rows, most)?;
        for (name, scale) in ["Xscale", "Yscale", "Zscale"].into_iter().zip(metres) {
            // A profile has no second axis.
            let is_needed = name != "Yscale" || rows > 1;
            if is_needed && !(scale > 0.0 && scale.is_finite()) {
                return Err(format!(
                    "the header of this SDF file has {name} = {scale}, but it must be above 0 m"
                ));
            }
        }
        let [x_um, y_um, z_um] = metres.map(|m| m * 1e6);
        Ok(SdfHeader {
            columns,
            rows,
            x_um,
            y_um: if rows == 1 { x_um } else { y_um },
            z_um,
        })
    }

    fn map(&self, mut heights: Vec<f64>) -> HeightMap {
        let notes = mark(&mut heights, &[], Kind::Heights);
        let map = HeightMap::new(self.columns, heights).stating(MapUnits {
            pitch_um: [self.x_um, self.y_um],
            height_unit_um: self.z_um,
        });
        HeightMap { notes, ..map }
    }
}

/// Reads an SDF file.
pub(super) fn read(content: &[u8], most: usize) -> Result<HeightMap, String> {
    let content = content.strip_prefix(b"\xef\xbb\xbf").unwrap_or(content);
    let content = content.trim_ascii_start();
    match content.first() {
        Some(b'a' | b'A') => text(content, most),
        Some(b'b' | b'B') => binary(content, most),
        _ => Err(
            "this is not an SDF file of ISO 25178-71: it must begin with aISO, aBCR, bISO or bBCR"
                .to_owned(),
        ),
    }
}

fn text(content: &[u8], most: usize) -> Result<HeightMap, String> {
    let text = text_of(content)?;
    // Lines with only * part header, heights and trailer; a text of the header may contain it, too.
    let is_end = |line: &&str| line.trim() == "*";
    let Some(length) = text.lines().position(|line| is_end(&line)) else {
        return Err(
            "the header of this SDF file does not end: a line with only * must follow it"
                .to_owned(),
        );
    };
    let head: Vec<&str> = text.lines().take(length).collect();
    let data = text.lines().skip(length + 1);
    let data = data.take_while(|line| !is_end(line));
    let value = |name: &str| -> Result<f64, String> {
        let lines = head.iter().filter_map(|line| line.split_once('='));
        let found = lines.filter(|(key, _)| key.trim().eq_ignore_ascii_case(name));
        let mut words = found.map(|(_, value)| value.split(';').next().unwrap_or_default().trim());
        let word = words
            .next_back()
            .ok_or_else(|| format!("the header of this SDF file lacks {name}"))?;
        number(word).ok_or_else(|| {
            format!("the header of this SDF file has {name} = {word:?}, which is not a number")
        })
    };
    let y_scale = value("Yscale").or_else(|why| {
        if value("NumProfiles")? > 1.0 {
            Err(why)
        } else {
            Ok(1.0)
        }
    })?;
    let header = SdfHeader::of(
        [value("NumPoints")?, value("NumProfiles")?],
        [value("Xscale")?, y_scale, value("Zscale")?],
        most,
    )?;
    let count = header.columns * header.rows;
    let mut heights = Vec::with_capacity(count);
    let words = data.flat_map(|line| line.split(|c: char| c.is_whitespace() || "\0;*".contains(c)));
    for word in words.filter(|word| !word.is_empty()) {
        heights.push(match number(word) {
            Some(height) => height,
            None if is_mark(word) => f64::NAN,
            None => {
                return Err(format!(
                    "height {} of this SDF file is {}: expected a number or BAD",
                    heights.len() + 1,
                    quoted(word)
                ));
            }
        });
        if heights.len() > count {
            break;
        }
    }
    if heights.len() != count {
        return Err(format!(
            "this SDF file contains {} heights than the {count} of its header ({} × {}): the file is damaged",
            if heights.len() > count {
                "more"
            } else {
                "fewer"
            },
            header.columns,
            header.rows
        ));
    }
    Ok(header.map(heights))
}

fn binary(content: &[u8], most: usize) -> Result<HeightMap, String> {
    let Some((head, data)) = content.split_at_checked(BINARY) else {
        return Err("the header of this SDF file is truncated: expected 81 bytes".to_owned());
    };
    let (compression, kind) = (head[78], head[79]);
    let width = match kind {
        0 | 4 => 1,
        1 | 5 => 2,
        2 | 3 | 6 => 4,
        7 => 8,
        _ => {
            return Err(format!(
                "this SDF file has the data type {kind}: expected 0 to 7"
            ));
        }
    };
    let u16_at = |at: usize| [head[at], head[at + 1]];
    let f64_at = |at: usize| {
        let mut bytes = [0; 8];
        bytes.copy_from_slice(&head[at..at + 8]);
        bytes
    };
    let (counts, scales) = ([42, 44].map(u16_at), [46, 54, 62].map(f64_at));
    // The standard has the lowest byte first. A program that wrote the other order shows by the length.
    let bytes_of = |order: fn([u8; 2]) -> u16| {
        let points = counts.map(|count| usize::from(order(count)));
        points[0] * points[1] * width
    };
    if bytes_of(u16::from_le_bytes) != data.len() && bytes_of(u16::from_be_bytes) == data.len() {
        return Err(
            "the numbers of this SDF file have the highest byte first, but ISO 25178-71 has the lowest byte first: save it as text \
             (aISO-1.0)"
                .to_owned(),
        );
    }
    let header = SdfHeader::of(
        counts.map(|count| f64::from(u16::from_le_bytes(count))),
        scales.map(f64::from_le_bytes),
        most,
    )?;
    if compression != 0 {
        return Err("this SDF file is compressed: save it without compression".to_owned());
    }
    let count = header.columns * header.rows;
    if data.len() < width * count {
        return Err(format!(
            "the heights of this SDF file take {} bytes instead of {width} × {count}: the file is damaged",
            data.len()
        ));
    }
    let value = |b: &[u8]| -> f64 {
        // The lowest signed integer marks a missing point.
        let signed = |x: i32, lowest: i32| if x == lowest { f64::NAN } else { f64::from(x) };
        match (kind, b) {
            (0, &[a]) => f64::from(a),
            (4, &[a]) => signed(i8::from_le_bytes([a]).into(), i8::MIN.into()),
            (1, &[a, b]) => f64::from(u16::from_le_bytes([a, b])),
            (5, &[a, b]) => signed(i16::from_le_bytes([a, b]).into(), i16::MIN.into()),
            (2, &[a, b, c, d]) => f64::from(u32::from_le_bytes([a, b, c, d])),
            (6, &[a, b, c, d]) => signed(i32::from_le_bytes([a, b, c, d]), i32::MIN),
            (3, &[a, b, c, d]) => f64::from(f32::from_le_bytes([a, b, c, d])),
            (_, &[a, b, c, d, e, f, g, h]) => f64::from_le_bytes([a, b, c, d, e, f, g, h]),
            _ => f64::NAN,
        }
    };
    Ok(header.map(
        data[..width * count]
            .chunks_exact(width)
            .map(value)
            .collect(),
    ))
}

#[cfg(test)]
mod tests {
    use super::super::read;

    const TEXT: &str = "aBCR-1.0\nManufacID = test\nCreateDate = 020320260900\nModDate = 020320260900\nNumPoints = 4\n\
                        NumProfiles = 3\nXscale = 1.0e-6\nYscale = 2.0e-6\nZscale = 1.0e-9\nZresolution = -1\nCompression = 0\n\
                        DataType = 7\nCheckType = 0\n*\n1 2 3 4\n5 BAD 7 8\n9 10\n11 12\n*\nOperator = anonymous\n*\n";

    #[test]
    fn heights_as_text_have_their_scales_and_bad_points_are_missing() {
        for text in [
            TEXT.to_owned(),
            TEXT.replace("aBCR", "aISO").replace('\n', "\r\n"),
            TEXT.replace(".0e", ",0e"),
            TEXT.replace("aBCR", "AISO").to_uppercase(),
            TEXT.replace("= test", "= test*instruments"),
            TEXT.replace("1 2 3 4", "1;2;3;4"),
            TEXT.replace(" = ", "="),
        ] {
            // The name's extension is irrelevant.
            let map = read("map.sdf", text.as_bytes()).unwrap();
            assert_eq!((map.columns, map.rows, map.missing()), (4, 3, 1));
            assert!(map.heights[5].is_nan() && map.heights[11] == 12.0);
            let [u, v] = map.pitch_um.unwrap();
            assert!((u - 1.0).abs() < 1e-12 && (v - 2.0).abs() < 1e-12);
            assert!((map.height_unit_um.unwrap() - 1e-3).abs() < 1e-15);
        }
        for (from, to, word) in [
            ("NumPoints = 4", "NumPoints = 5", "fewer"),
            ("11 12", "11 12 13", "more"),
            ("BAD", "x", "height 6"),
            ("Xscale = 1.0e-6", "Xscale = 0", "above 0 m"),
            ("Zscale = 1.0e-9\n", "", "lacks Zscale"),
            ("*", "", "does not end"),
        ] {
            let why = read("map.sdf", TEXT.replace(from, to).as_bytes()).unwrap_err();
            assert!(why.contains(word), "{to}: {why}");
        }
    }

    #[test]
    fn heights_as_numbers_are_read_in_all_types() {
        let file = |kind: u8, data: &[u8]| {
            let mut file = b"bISO-1.0".to_vec();
            file.extend([b' '; 34]);
            file.extend([3u16, 2].map(u16::to_le_bytes).concat());
            file.extend([1e-6, 1e-6, 1e-9, -1.0].map(f64::to_le_bytes).concat());
            file.extend([0, kind, 0]);
            file.extend(data);
            file
        };
        let doubles = [1.0, 2.0, f64::NAN, 4.0, 5.0, 6.0]
            .map(f64::to_le_bytes)
            .concat();
        let floats = [1f32, 2.0, f32::MAX, 4.0, 5.0, 6.0]
            .map(f32::to_le_bytes)
            .concat();
        let words = [1i16, 2, i16::MIN, 4, 5, 6].map(i16::to_le_bytes).concat();
        let longs = [1i32, 2, i32::MIN, 4, 5, 6].map(i32::to_le_bytes).concat();
        for (kind, data) in [(7, &doubles), (3, &floats), (5, &words), (6, &longs)] {
            let map = read("map.sdf", &file(kind, data)).unwrap();
            assert_eq!((map.columns, map.rows, map.missing()), (3, 2, 1), "{kind}");
            assert!(map.heights[2].is_nan() && map.heights[5] == 6.0, "{kind}");
        }
        assert!(
            read("map.sdf", &file(5, &words[1..]))
                .unwrap_err()
                .contains("damaged")
        );
        let mut swapped = file(5, &words);
        swapped[42..46].copy_from_slice(&[0, 3, 0, 2]);
        let why = read("map.sdf", &swapped).unwrap_err();
        assert!(why.contains("highest byte first"), "{why}");
        assert!(
            read("map.sdf", &file(9, &words))
                .unwrap_err()
                .contains("data type 9")
        );
        assert!(
            read("map.sdf", b"bISO-1.0")
                .unwrap_err()
                .contains("truncated")
        );
        assert!(
            read("map.sdf", b"nothing")
                .unwrap_err()
                .contains("not an SDF file")
        );
    }
}
