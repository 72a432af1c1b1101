//! Files of heights: a CSV table of numbers, or a 16-bit grey PNG.

use crate::trace::scene::HeightMap;

/// Reads a file's content by the ending of its name.
pub(super) fn read(name: &str, content: &[u8]) -> Result<HeightMap, String> {
    let ending = name.rsplit('.').next().unwrap_or_default().to_lowercase();
    match ending.as_str() {
        "csv" | "txt" => table(content),
        "png" => png(content),
        _ => Err("heights are read from .csv (rows of numbers) or .png (16-bit grey)".to_owned()),
    }
}

fn table(content: &[u8]) -> Result<HeightMap, String> {
    let text = std::str::from_utf8(content).map_err(|_| "the file is not text".to_owned())?;
    let mut map = HeightMap {
        columns: 0,
        rows: 0,
        heights: Vec::new(),
    };
    for (n, line) in text.lines().enumerate() {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let before = map.heights.len();
        for word in line.split([',', ';', '\t', ' ']).filter(|w| !w.is_empty()) {
            let height: f64 = word
                .parse()
                .map_err(|_| format!("line {}: {word:?} is not a number", n + 1))?;
            map.heights.push(height);
        }
        let count = map.heights.len() - before;
        if map.rows > 0 && count != map.columns {
            return Err(format!(
                "line {} has {count} heights, the lines before it {}",
                n + 1,
                map.columns
            ));
        }
        map.columns = count;
        map.rows += 1;
    }
    if map.rows == 0 {
        return Err("the file holds no heights".to_owned());
    }
    Ok(map)
}

fn png(content: &[u8]) -> Result<HeightMap, String> {
    let mut reader = png::Decoder::new(std::io::Cursor::new(content))
        .read_info()
        .map_err(|e| e.to_string())?;
    let info = reader.info();
    let (columns, rows) = (info.width as usize, info.height as usize);
    if info.color_type != png::ColorType::Grayscale || info.bit_depth != png::BitDepth::Sixteen {
        return Err("heights need a 16-bit grey PNG".to_owned());
    }
    let size = reader
        .output_buffer_size()
        .ok_or_else(|| "the picture is too large".to_owned())?;
    let mut bytes = vec![0; size];
    reader.next_frame(&mut bytes).map_err(|e| e.to_string())?;
    Ok(HeightMap {
        columns,
        rows,
        heights: bytes
            .chunks_exact(2)
            .map(|b| f64::from(u16::from_be_bytes([b[0], b[1]])))
            .collect(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_is_read_and_a_ragged_one_refused_by_line() {
        let map = read("a.csv", b"1, 2, 3\n4, 5, 6\n").unwrap();
        assert_eq!((map.columns, map.rows), (3, 2));
        assert_eq!(map.heights[3], 4.0);
        assert!(read("a.csv", b"1,2\n3\n").unwrap_err().contains("line 2"));
        assert!(read("a.csv", b"1,x\n").unwrap_err().contains("\"x\""));
        assert!(read("a.csv", b"").is_err());
        assert!(read("a.png", b"no picture").is_err());
        assert!(read("a.doc", b"").is_err());
    }
}
