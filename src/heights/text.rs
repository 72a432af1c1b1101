//! Decodes the text of a file in the encodings that programs write.

use std::borrow::Cow;

/// Decodes a text: UTF-8, UTF-16 (by its byte order mark or its zeros), or Latin-1, in which some
/// programs write µ.
///
/// # Errors
/// The content is not text, or is invalid UTF-16.
pub(super) fn text_of(content: &[u8]) -> Result<Cow<'_, str>, String> {
    let wide = |bytes: &[u8], unit: fn([u8; 2]) -> u16| {
        let (pairs, rest) = bytes.as_chunks::<2>();
        let units: Vec<u16> = pairs.iter().map(|pair| unit(*pair)).collect();
        match String::from_utf16(&units) {
            Ok(text) if rest.is_empty() && !text.contains('\0') => Ok(text.into()),
            _ => Err("the file is damaged UTF-16 text: save it as UTF-8".to_owned()),
        }
    };
    match content {
        [0xff, 0xfe, rest @ ..] => return wide(rest, u16::from_le_bytes),
        [0xfe, 0xff, rest @ ..] => return wide(rest, u16::from_be_bytes),
        [1..=255, 0, 1..=255, 0, ..] => return wide(content, u16::from_le_bytes),
        [0, 1..=255, 0, 1..=255, ..] => return wide(content, u16::from_be_bytes),
        _ => {}
    }
    if content.contains(&0) {
        return Err("the file is not text: it contains zero bytes".to_owned());
    }
    match std::str::from_utf8(content) {
        Ok(text) => Ok(text.trim_start_matches('\u{feff}').into()),
        Err(_) if content.iter().any(|b| *b < b' ' && !b"\t\r\n".contains(b)) => {
            Err("the file is not text".to_owned())
        }
        Err(_) => Ok(content
            .iter()
            .map(|b| char::from(*b))
            .collect::<String>()
            .into()),
    }
}

/// A number with a decimal point or comma; if both occur, the later one is the decimal mark.
pub(super) fn number(word: &str) -> Option<f64> {
    let word = word.trim();
    let plain = match (word.rfind(','), word.rfind('.')) {
        (Some(comma), Some(point)) if comma > point => word.replace('.', "").replace(',', "."),
        (Some(_), Some(_)) => word.replace(',', ""),
        (Some(_), None) => word.replace(',', "."),
        _ => return finite(word),
    };
    finite(&plain)
}

fn finite(word: &str) -> Option<f64> {
    // A typographic minus.
    let plain = word.replace('\u{2212}', "-");
    plain.parse().ok().filter(|x: &f64| x.is_finite())
}
