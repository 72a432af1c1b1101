//! One-channel OpenEXR files: scan lines of 32-bit floats, uncompressed.
//!
//! Layout after the OpenEXR file-layout document: magic number, version, attributes, a table of
//! line offsets, then the lines, all little-endian.

use crate::model::picture::Picture;

/// The file's bytes; the channel is Y, linear.
pub(super) fn encode(picture: &Picture) -> Vec<u8> {
    let (width, height) = (picture.width as i32, picture.height as i32);
    let mut out = vec![0x76, 0x2f, 0x31, 0x01, 2, 0, 0, 0];
    let mut attribute = |name: &str, kind: &str, value: &[u8]| {
        out.extend_from_slice(name.as_bytes());
        out.push(0);
        out.extend_from_slice(kind.as_bytes());
        out.push(0);
        out.extend_from_slice(&(value.len() as i32).to_le_bytes());
        out.extend_from_slice(value);
    };
    let integers =
        |values: &[i32]| -> Vec<u8> { values.iter().flat_map(|v| v.to_le_bytes()).collect() };
    // Name, pixel type 2 = float, linear flag and padding, sampling 1 × 1, end of list.
    let mut channels = b"Y\0".to_vec();
    channels.extend(integers(&[2, 0, 1, 1]));
    channels.push(0);
    attribute("channels", "chlist", &channels);
    attribute("compression", "compression", &[0]);
    let window = integers(&[0, 0, width - 1, height - 1]);
    attribute("dataWindow", "box2i", &window);
    attribute("displayWindow", "box2i", &window);
    attribute("lineOrder", "lineOrder", &[0]);
    attribute("pixelAspectRatio", "float", &1f32.to_le_bytes());
    attribute("screenWindowCenter", "v2f", &[0; 8]);
    attribute("screenWindowWidth", "float", &1f32.to_le_bytes());
    out.push(0);
    let line_bytes = 4 * picture.width;
    let first = out.len() + 8 * picture.height;
    for line in 0..picture.height {
        out.extend_from_slice(&((first + line * (8 + line_bytes)) as u64).to_le_bytes());
    }
    for (y, line) in picture.radiance.chunks(picture.width).enumerate() {
        out.extend_from_slice(&(y as i32).to_le_bytes());
        out.extend_from_slice(&(line_bytes as i32).to_le_bytes());
        for value in line {
            out.extend_from_slice(&value.to_le_bytes());
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_offset_table_points_at_the_lines() {
        let picture = Picture {
            width: 3,
            height: 2,
            radiance: vec![0.0, 1.0, 2.0, 3.0, 4.0, 5.0],
        };
        let bytes = encode(&picture);
        let line = 8 + 12;
        let table = bytes.len() - 2 * line - 16;
        for y in 0..2 {
            let at = table + 8 * y;
            let offset = u64::from_le_bytes(bytes[at..at + 8].try_into().unwrap()) as usize;
            assert_eq!(bytes[offset..offset + 4], (y as i32).to_le_bytes());
            let value = f32::from_le_bytes(bytes[offset + 8..offset + 12].try_into().unwrap());
            assert_eq!(value, picture.radiance[3 * y]);
        }
        assert_eq!(bytes[table - 1], 0);
    }
}
