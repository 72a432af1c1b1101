//! Files of heights: tables, 16-bit grey PNG and TIFF, float TIFF, and the microscope formats X3P
//! (ISO 25178-72) and SDF (ISO 25178-71).
//!
//! Call [`read`] for the heights in a file's content ([`read_within`] for untrusted input) and
//! [`ridges::of`] for the ridges in them. This module opens no files except in [`bytes_of`] and
//! does not know the purpose of the heights. It passes on the units stated in the file, returns
//! missing points as NaN, and notes ambiguities of the file.

mod archive;
mod column_units;
mod groupings;
mod header;
pub(crate) mod missing;
mod points;
pub mod ridges;
mod sdf;
mod table;
mod text;
mod tiff;
mod tiff_scale;
mod x3p;

use crate::trace::scene::HeightMap;

/// Larger maps are refused before they are read.
const HEIGHTS_MAX: usize = 1 << 26;

/// Largest size of a file of heights, in bytes.
const BYTES_MAX: u64 = 1 << 32;

/// Reads a file of heights; a device or an endless pipe is refused.
///
/// # Errors
/// The file cannot be read, is not a regular file, or is too large.
pub fn bytes_of(path: &std::path::Path) -> Result<Vec<u8>, String> {
    let facts = std::fs::metadata(path).map_err(|e| e.to_string())?;
    if !facts.is_file() {
        return Err("it is not a regular file".to_owned());
    }
    if facts.len() > BYTES_MAX {
        let gigabytes = facts.len() as f64 / 1e9;
        return Err(format!(
            "it has {gigabytes:.1} GB, but at most 4.3 GB are read"
        ));
    }
    std::fs::read(path).map_err(|e| e.to_string())
}

/// Reads a file's content. The first bytes determine the format; a table is recognised by the
/// extension of its name.
///
/// # Errors
/// The fault of the file and the remedy.
pub fn read(name: &str, content: &[u8]) -> Result<HeightMap, String> {
    read_within(name, content, HEIGHTS_MAX)
}

/// As [`read`], with at most `most` heights. A small file may unpack to a large map; `most` bounds
/// the memory, not the size of the file.
///
/// # Errors
/// As [`read`].
pub fn read_within(name: &str, content: &[u8], most: usize) -> Result<HeightMap, String> {
    match content {
        [b'P', b'K', 3, 4, ..] => return x3p::read(content, most),
        [0x89, b'P', b'N', b'G', ..] => return png(content, most),
        [b'I', b'I', 42 | 43, 0, ..] | [b'M', b'M', 0, 42 | 43, ..] => {
            return tiff::read(content, most);
        }
        _ if sdf::is_one(content) => return sdf::read(content, most),
        _ => {}
    }
    let ending = name.rsplit('.').next().unwrap_or_default().to_lowercase();
    match ending.as_str() {
        "csv" | "txt" | "tsv" | "dat" | "asc" | "xyz" | "prn" => table::read(content, most),
        "png" => png(content, most),
        "tif" | "tiff" => tiff::read(content, most),
        "x3p" => x3p::read(content, most),
        "sdf" | "bcr" => sdf::read(content, most),
        _ => Err(
            "heights are read from .csv (rows of numbers; also .txt, .tsv, .dat, .asc, .prn, .xyz), .png (16-bit grey), .tif \
             (16-bit or float grey), .x3p (ISO 25178-72) and .sdf (ISO 25178-71)"
                .to_owned(),
        ),
    }
}

/// Refuses maps of more than `most` heights.
fn check_size(columns: usize, rows: usize, most: usize) -> Result<(), String> {
    match columns.checked_mul(rows) {
        Some(count) if (1..=most).contains(&count) => Ok(()),
        _ => Err(format!(
            "{columns} × {rows} heights are out of the range of 1 to {most}: crop the map"
        )),
    }
}

fn png(content: &[u8], most: usize) -> Result<HeightMap, String> {
    let mut reader = png::Decoder::new(std::io::Cursor::new(content))
        .read_info()
        .map_err(|e| e.to_string())?;
    let info = reader.info();
    let (columns, rows) = (info.width as usize, info.height as usize);
    if info.color_type != png::ColorType::Grayscale || info.bit_depth != png::BitDepth::Sixteen {
        return Err("expected a 16-bit grey PNG".to_owned());
    }
    check_size(columns, rows, most)?;
    let size = reader
        .output_buffer_size()
        .ok_or_else(|| "the image is too large".to_owned())?;
    let mut bytes = vec![0; size];
    reader.next_frame(&mut bytes).map_err(|e| e.to_string())?;
    let heights = bytes.chunks_exact(2);
    let mut heights: Vec<f64> = heights
        .map(|b| f64::from(u16::from_be_bytes([b[0], b[1]])))
        .collect();
    let notes = missing::mark(&mut heights, &[], missing::Kind::Heights);
    Ok(HeightMap {
        notes,
        ..HeightMap::new(columns, heights)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_endless_file_is_refused() {
        for path in ["/dev/zero", "/dev"] {
            let refused = bytes_of(path.as_ref()).unwrap_err();
            assert!(refused.contains("not a regular file"), "{refused}");
        }
        assert!(bytes_of("/nowhere.csv".as_ref()).is_err());
    }

    #[test]
    fn a_table_is_read_with_or_without_names_and_a_ragged_one_is_refused_with_its_line() {
        let map = read("a.csv", b"1, 2, 3\n4, 5, 6\n").unwrap();
        assert_eq!((map.columns, map.rows), (3, 2));
        assert_eq!(map.heights[3], 4.0);
        assert_eq!(read("a.csv", b"v_um,z_um\n1, 2\n").unwrap().rows, 1);
        assert!(read("a.csv", b"1,2\n3\n").unwrap_err().contains("line 2"));
        let twice = read("a.csv", b"# taken at noon\nv,z\nv,z\n1,2\n").unwrap_err();
        assert!(twice.contains("line 3"), "{twice}");
        assert!(read("a.csv", b"1,x\n").unwrap_err().contains("\"x\""));
        assert_eq!(
            read("a.csv", b"\"1\", \"2.5\"\n").unwrap().heights,
            [1.0, 2.5]
        );
        assert!(read("a.csv", b"").is_err());
        assert_eq!(read("a.csv", b"1,2,\n3,4,\n").unwrap().columns, 2);
        assert!(read("a.png", b"no image").is_err());
        assert!(read("a.doc", b"").is_err());
    }

    #[test]
    fn decimal_commas_are_read_if_unambiguous_and_refused_if_ambiguous() {
        for text in [
            "0,5;-1,25\n2;3,5e-1\n",
            "0,5\t-1,25\n2\t3,5e-1\n",
            "\u{feff}0.5 -1.25\n2 0.35\n",
        ] {
            let map = read("a.csv", text.as_bytes()).unwrap();
            assert_eq!((map.columns, map.rows), (2, 2), "{text}");
            assert_eq!(map.heights, [0.5, -1.25, 2.0, 0.35], "{text}");
        }
        assert_eq!(
            read("a.txt", b"v \xc2\xb5m;z \xc2\xb5m\n1,5;2\n")
                .unwrap()
                .heights,
            [1.5, 2.0]
        );
        let either = read("a.csv", b"0,5 1,25\n").unwrap_err();
        assert!(either.contains("decimal mark"), "{either}");
    }

    #[test]
    fn a_small_file_with_a_large_map_is_refused_before_it_is_unpacked() {
        let mut file = Vec::new();
        let mut encoder = png::Encoder::new(&mut file, 1000, 1000);
        encoder.set_color(png::ColorType::Grayscale);
        encoder.set_depth(png::BitDepth::Sixteen);
        let mut writer = encoder.write_header().unwrap();
        writer.write_image_data(&vec![0; 2_000_000]).unwrap();
        writer.finish().unwrap();
        assert!(file.len() < 20_000);
        let refused = read_within("a.png", &file, 999_999).unwrap_err();
        assert!(refused.contains("1 to 999999"), "{refused}");
        assert_eq!(read_within("a.png", &file, 1_000_000).unwrap().rows, 1000);
    }
}
