//! Surface maps of ISO 25178-72 (X3P, "OpenGPS"): a zip archive of `main.xml` and the heights, in
//! metres, as a binary member or as a list in the XML.
//!
//! Supported are surfaces (feature type SUR) with incremental x and y axes and one layer, and
//! profiles (PRF) as maps of one row. Missing points are NaN, or 0 in the file of valid points,
//! which integers need. Checksums are verified if the file has them.

use roxmltree::{Document, Node};

use super::archive::{Archive, note};
use super::missing::{Kind, mark};
use super::{check_size, text as encoded};
use crate::trace::scene::{HeightMap, MapUnits};
use crate::wording::encoding::text_of;

/// Largest size of main.xml in bytes (it may contain a list of heights): the first number plus the
/// second for each height that the map may have.
const XML_MAX: (u64, u64) = (1 << 16, 4);

/// Reads an X3P file; the heights are in metres, as stated in [`HeightMap::units`].
pub(super) fn read(content: &[u8], most: usize) -> Result<HeightMap, String> {
    let mut archive = Archive::open(content)?;
    let main = archive.main(XML_MAX.0 + XML_MAX.1 * most as u64)?;
    let xml = text_of(&main).map_err(|why| format!("main.xml: {why}"))?;
    let document = Document::parse(&xml).map_err(|e| format!("main.xml: {e}"))?;
    let root = document.root_element();
    let (x, y, z) = (axis(root, "CX")?, axis(root, "CY")?, axis(root, "CZ")?);
    for (name, axis) in [("CX", &x), ("CY", &y)] {
        if !axis.incremental {
            return Err(format!(
                "the axis {name} is not incremental (AxisType I): resample the map on a grid"
            ));
        }
    }
    let size = |name: &str| -> Result<usize, String> {
        number(root, &["MatrixDimension", name])
            .or_else(|| {
                number(root, &["ListDimension"]).map(|n| if name == "SizeX" { n } else { 1.0 })
            })
            .filter(|n| *n >= 1.0 && n.fract() == 0.0)
            .map(|n| n as usize)
            .ok_or_else(|| format!("main.xml does not state {name} of the map"))
    };
    let (columns, rows, layers) = (size("SizeX")?, size("SizeY")?, size("SizeZ")?);
    check_size(columns, rows, most)?;
    if layers != 1 {
        return Err(format!("the file has {layers} layers: expected one"));
    }
    let count = columns * rows;
    let mut notes = Vec::new();
    notes.extend(archive.main_note(&main, text(root, &["Record4", "ChecksumFile"])));
    let checked = |key: &str, link: &str, bytes: &[u8]| {
        let stated = text(root, &["DataLink", key])?;
        note(link, bytes, stated, "main.xml")
    };
    let mut values = match text(root, &["DataLink", "PointDataLink"]) {
        Some(link) => {
            let limit = (most * 8) as u64;
            let bytes = archive.linked(link, limit)?;
            notes.extend(checked("MD5ChecksumPointData", link, &bytes));
            let mut values = z.decode(&bytes, count)?;
            if let Some(link) = text(root, &["DataLink", "ValidPointsLink"]) {
                let mask = archive.linked(link, most as u64)?;
                notes.extend(checked("MD5ChecksumValidPoints", link, &mask));
                for (n, value) in values.iter_mut().enumerate() {
                    if !is_valid(&mask, n, count)? {
                        *value = f64::NAN;
                    }
                }
            }
            values
        }
        None => listed(root, count)?,
    };
    // Marks of missing points are numbers of the file, before scaling.
    notes.extend(mark(&mut values, &[], Kind::Heights));
    for value in &mut values {
        *value = if z.scales() {
            *value * z.increment
        } else {
            *value
        } + z.offset;
    }
    let u_um = x.increment * 1e6;
    let v_um = if rows == 1 { u_um } else { y.increment * 1e6 };
    let map = HeightMap::new(columns, values).stating(MapUnits {
        pitch_um: [u_um, v_um],
        height_unit_um: 1e6,
    });
    Ok(HeightMap { notes, ..map })
}

/// Whether the file of valid points contains point `n` of `count`: one bit per point, lowest bit
/// first; some programs write one byte per point.
fn is_valid(mask: &[u8], n: usize, count: usize) -> Result<bool, String> {
    if mask.len() == count.div_ceil(8) {
        Ok(mask[n / 8] >> (n % 8) & 1 == 1)
    } else if mask.len() == count {
        Ok(mask[n] != 0)
    } else {
        Err(format!(
            "the file of valid points (ValidPointsLink) has {} bytes instead of {}, one bit for each of {count} points: \
             the file is damaged",
            mask.len(),
            count.div_ceil(8)
        ))
    }
}

struct Axis {
    incremental: bool,
    increment: f64,
    offset: f64,
    /// I, L, F or D: 16- and 32-bit integers, floats, doubles.
    kind: char,
}

impl Axis {
    /// Whether its numbers count increments: on an incremental axis, and for integers on any axis.
    fn scales(&self) -> bool {
        self.incremental || matches!(self.kind, 'I' | 'L')
    }

    /// Decodes little-endian numbers of the axis's type.
    fn decode(&self, bytes: &[u8], count: usize) -> Result<Vec<f64>, String> {
        let width = match self.kind {
            'I' => 2,
            'L' | 'F' => 4,
            _ => 8,
        };
        if bytes.len() != width * count {
            return Err(format!(
                "the heights take {} bytes instead of {} × {count}: the file is damaged",
                bytes.len(),
                width
            ));
        }
        let value = |b: &[u8]| -> f64 {
            match (self.kind, b) {
                ('I', &[a, b]) => f64::from(i16::from_le_bytes([a, b])),
                ('L', &[a, b, c, d]) => f64::from(i32::from_le_bytes([a, b, c, d])),
                ('F', &[a, b, c, d]) => f64::from(f32::from_le_bytes([a, b, c, d])),
                (_, &[a, b, c, d, e, f, g, h]) => f64::from_le_bytes([a, b, c, d, e, f, g, h]),
                _ => f64::NAN,
            }
        };
        Ok(bytes.chunks_exact(width).map(value).collect())
    }
}

fn axis(root: Node<'_, '_>, name: &str) -> Result<Axis, String> {
    let of = |key: &str| text(root, &["Axes", name, key]);
    let number_of = |key: &str, otherwise: f64| match of(key) {
        None => Ok(otherwise),
        Some(word) => encoded::number(word)
            .ok_or_else(|| format!("main.xml: {name}/{key} = {word:?} is not a number")),
    };
    let incremental = match of("AxisType").and_then(|t| t.chars().next()) {
        Some('I' | 'i') => true,
        Some('A' | 'a') => false,
        _ => {
            return Err(format!(
                "main.xml does not state the AxisType of {name} (I or A)"
            ));
        }
    };
    let increment = number_of("Increment", 1.0)?;
    if incremental && name != "CZ" && !(increment > 0.0 && increment < 1.0) {
        return Err(format!(
            "main.xml: {name}/Increment = {increment} m is not a valid spacing of points"
        ));
    }
    let kind = of("DataType").and_then(|kind| kind.chars().next());
    let kind = kind.unwrap_or('D').to_ascii_uppercase();
    if !"ILFD".contains(kind) {
        return Err(format!(
            "main.xml: {name}/DataType must be I, L, F or D, not {kind}"
        ));
    }
    Ok(Axis {
        incremental,
        increment,
        offset: number_of("Offset", 0.0)?,
        kind,
    })
}

/// The text of the first element along a path of local names, searched below `node`.
fn text<'d>(node: Node<'d, '_>, path: &[&str]) -> Option<&'d str> {
    let first = node.descendants().find(|n| n.has_tag_name_of(path[0]))?;
    let last = path[1..].iter().try_fold(first, |at, name| {
        at.children().find(|n| n.has_tag_name_of(name))
    })?;
    last.text().map(str::trim).filter(|t| !t.is_empty())
}

fn number(node: Node<'_, '_>, path: &[&str]) -> Option<f64> {
    encoded::number(text(node, path)?)
}

trait LocalName {
    fn has_tag_name_of(&self, name: &str) -> bool;
}

impl LocalName for Node<'_, '_> {
    /// Ignores the namespace, which differs between files.
    fn has_tag_name_of(&self, name: &str) -> bool {
        self.is_element() && self.tag_name().name() == name
    }
}

/// Reads heights from `DataList/Datum` elements: the last number of each, or missing if empty.
fn listed(root: Node<'_, '_>, count: usize) -> Result<Vec<f64>, String> {
    let list = root
        .descendants()
        .find(|n| n.has_tag_name_of("DataList"))
        .ok_or("main.xml has neither a DataLink nor a DataList")?;
    let values: Vec<f64> = list
        .children()
        .filter(|n| n.has_tag_name_of("Datum"))
        .map(|n| {
            let word = n.text().unwrap_or_default().rsplit(';').next();
            word.and_then(encoded::number).unwrap_or(f64::NAN)
        })
        .collect();
    if values.len() == count {
        Ok(values)
    } else {
        Err(format!(
            "main.xml lists {} heights instead of {count}",
            values.len()
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::super::{HEIGHTS_MAX, HeightMap};
    use std::io::Write;

    fn read(content: &[u8]) -> Result<HeightMap, String> {
        super::read(content, HEIGHTS_MAX)
    }

    fn archive(xml: &str, data: Option<&[u8]>) -> Vec<u8> {
        archive_with(xml, data, None)
    }

    fn archive_with(xml: &str, data: Option<&[u8]>, valid: Option<&[u8]>) -> Vec<u8> {
        let mut zip = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
        let options = zip::write::SimpleFileOptions::default();
        zip.start_file("main.xml", options).unwrap();
        zip.write_all(xml.as_bytes()).unwrap();
        for (name, content) in [("bindata/data.bin", data), ("bindata/valid.bin", valid)] {
            if let Some(content) = content {
                zip.start_file(name, options).unwrap();
                zip.write_all(content).unwrap();
            }
        }
        zip.finish().unwrap().into_inner()
    }

    fn xml(z: &str, size: &str, record: &str) -> String {
        format!(
            r#"<?xml version="1.0" encoding="UTF-8"?>
<p:ISO5436_2 xmlns:p="http://www.opengps.eu/2008/ISO5436_2">
 <Record1><Revision>ISO5436 - 2000</Revision><FeatureType>SUR</FeatureType><Axes>
  <CX><AxisType>I</AxisType><DataType>D</DataType><Increment>2e-6</Increment><Offset>0</Offset></CX>
  <CY><AxisType>I</AxisType><DataType>D</DataType><Increment>3e-6</Increment></CY>
  <CZ>{z}</CZ></Axes></Record1>
 <Record3><MatrixDimension>{size}</MatrixDimension>{record}</Record3>
</p:ISO5436_2>"#
        )
    }

    const SIZE: &str = "<SizeX>3</SizeX><SizeY>2</SizeY><SizeZ>1</SizeZ>";
    const LINK: &str = "<DataLink><PointDataLink>bindata/data.bin</PointDataLink></DataLink>";
    const ABSOLUTE: &str = "<AxisType>A</AxisType><DataType>D</DataType>";

    #[test]
    fn binary_doubles_and_scaled_integers_are_read_in_metres() {
        let doubles: Vec<u8> = [1e-6f64, 2e-6, f64::NAN, 4e-6, 5e-6, 6e-6]
            .iter()
            .flat_map(|h| h.to_le_bytes())
            .collect();
        let map = read(&archive(&xml(ABSOLUTE, SIZE, LINK), Some(&doubles))).unwrap();
        assert!(map.missing() == 1 && map.heights[2].is_nan());
        let integers: Vec<u8> = [10i16, 20, 30, -40, 50, 60]
            .iter()
            .flat_map(|h| h.to_le_bytes())
            .collect();
        let scaled = "<AxisType>I</AxisType><DataType>I</DataType><Increment>1e-7</Increment>";
        let map = read(&archive(&xml(scaled, SIZE, LINK), Some(&integers))).unwrap();
        // Integers of an absolute axis count increments too.
        let absolute = scaled.replace("<AxisType>I", "<AxisType>A");
        let again = read(&archive(&xml(&absolute, SIZE, LINK), Some(&integers))).unwrap();
        assert_eq!(again.heights, map.heights);
        assert_eq!((map.columns, map.rows), (3, 2));
        assert!((map.heights[3] + 4e-6).abs() < 1e-20);
        let [u, v] = map.pitch_um.unwrap();
        assert!((u - 2.0).abs() < 1e-12 && (v - 3.0).abs() < 1e-12);
        assert_eq!(map.height_unit_um, Some(1e6));
    }

    #[test]
    fn a_list_in_the_xml_is_read_with_missing_points() {
        let size = "<SizeX>11</SizeX><SizeY>1</SizeY><SizeZ>1</SizeZ>";
        let mut list: String = (0..10)
            .map(|i| format!("<Datum>0;0;{}</Datum>", f64::from(i)))
            .collect();
        list = list.replace("<Datum>0;0;4</Datum>", "<Datum/>") + "<Datum>10</Datum>";
        let map = read(&archive(
            &xml(ABSOLUTE, size, &format!("<DataList>{list}</DataList>")),
            None,
        ))
        .unwrap();
        assert_eq!(map.filled(), (0..=10).map(f64::from).collect::<Vec<_>>());
        assert!(map.missing() == 1 && map.heights[4].is_nan());
    }

    #[test]
    fn points_outside_the_mask_of_valid_points_are_missing() {
        let size = "<SizeX>7</SizeX><SizeY>3</SizeY><SizeZ>1</SizeZ>";
        let link = LINK.replace(
            "</DataLink>",
            "<ValidPointsLink>./bindata/valid.bin</ValidPointsLink></DataLink>",
        );
        let z = "<AxisType>I</AxisType><DataType>I</DataType><Increment>1e-7</Increment>";
        let xml = xml(z, size, &link);
        // Slopes along the rows, with spikes at the missing points.
        let unseen = [9, 18];
        let height = |n: usize| {
            if unseen.contains(&n) {
                i16::MIN
            } else {
                10 * n as i16
            }
        };
        let heights: Vec<u8> = (0..21).flat_map(|n| height(n).to_le_bytes()).collect();
        let packed = |unseen: &[usize]| {
            let mut mask = [0xffu8; 3];
            for n in unseen {
                mask[n / 8] &= !(1 << (n % 8));
            }
            mask
        };
        let bytes: Vec<u8> = (0..21).map(|n| u8::from(!unseen.contains(&n))).collect();
        for mask in [&packed(&unseen)[..], &bytes] {
            let map = read(&archive_with(&xml, Some(&heights), Some(mask))).unwrap();
            assert_eq!(map.missing(), 2);
            for (n, h) in map.filled().iter().enumerate() {
                assert!((h - 1e-6 * n as f64).abs() < 1e-12, "{n}: {h}");
            }
        }
        let refused =
            |mask: Option<&[u8]>| read(&archive_with(&xml, Some(&heights), mask)).unwrap_err();
        assert!(refused(Some(&[0xff; 4])).contains("instead of 3"));
        assert!(refused(None).contains("bindata/valid.bin"));
    }

    #[test]
    fn a_profile_runs_along_v_and_links_may_have_backslashes() {
        let size = "<SizeX>4</SizeX><SizeY>1</SizeY><SizeZ>1</SizeZ>";
        let link = LINK.replace("bindata/data.bin", ".\\bindata\\data.bin");
        let heights: Vec<u8> = [0.0f64, -1e-6, -2e-6, 0.0]
            .iter()
            .flat_map(|h| h.to_le_bytes())
            .collect();
        let xml = xml(ABSOLUTE, size, &link).replace("SUR", "PRF");
        let profile = read(&archive(&xml, Some(&heights)))
            .unwrap()
            .profile()
            .unwrap();
        assert!((profile.period() - 6.0).abs() < 1e-9);
        let (low, high) = profile.range();
        assert!((high - low - 2.0).abs() < 1e-9);
        let area = xml.replace("<SizeX>4</SizeX><SizeY>1", "<SizeX>2</SizeX><SizeY>2");
        let map = read(&archive(&area, Some(&heights))).unwrap();
        assert!(map.profile().unwrap_err().to_string().contains("map"));
    }

    #[test]
    fn invalid_files_are_refused_with_the_reason() {
        let fine = [0u8; 48];
        for (xml, data, part) in [
            (xml(ABSOLUTE, SIZE, LINK), Some(&fine[..40]), "damaged"),
            (xml(ABSOLUTE, SIZE, LINK), None, "bindata/data.bin"),
            (xml(ABSOLUTE, SIZE, ""), None, "neither"),
            (
                xml(ABSOLUTE, "<SizeX>3</SizeX>", LINK),
                Some(&fine[..]),
                "SizeY",
            ),
            (
                xml(ABSOLUTE, &SIZE.replace('3', "99999999999"), LINK),
                Some(&fine[..]),
                "crop the map",
            ),
            (xml("", SIZE, LINK), Some(&fine[..]), "CZ"),
            (
                xml(ABSOLUTE, SIZE, LINK).replace("2e-6", "x"),
                Some(&fine[..]),
                "Increment",
            ),
            (
                xml(ABSOLUTE, SIZE, LINK).replacen("<AxisType>I", "<AxisType>A", 1),
                Some(&fine[..]),
                "incremental",
            ),
            ("<open>".to_owned(), None, "main.xml"),
        ] {
            let why = read(&archive(&xml, data)).unwrap_err();
            assert!(why.contains(part), "{part}: {why}");
        }
        assert!(read(b"PK").unwrap_err().contains("zip"));
    }
}
