//! The text of a file, in whatever encoding a program wrote it.

use std::borrow::Cow;

/// The text of a file: UTF-8, UTF-16 (with its mark, or told by its zeros), or Latin-1, which programs of some countries
/// write a µ in.
///
/// # Errors
/// What is no text, or UTF-16 that cannot be read.
pub(super) fn text_of(content: &[u8]) -> Result<Cow<'_, str>, String> {
    let wide = |bytes: &[u8], unit: fn([u8; 2]) -> u16| {
        let (pairs, rest) = bytes.as_chunks::<2>();
        let units: Vec<u16> = pairs.iter().map(|pair| unit(*pair)).collect();
        match String::from_utf16(&units) {
            Ok(text) if rest.is_empty() && !text.contains('\0') => Ok(text.into()),
            _ => Err("the file is UTF-16 text that is damaged: save it as UTF-8".to_owned()),
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
        return Err("the file is not text: it holds zeros".to_owned());
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

/// A number with a decimal point or a decimal comma; of thousands and decimals the later mark is the decimal one.
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
    // A minus as typographers set it.
    let plain = word.replace('\u{2212}', "-");
    plain.parse().ok().filter(|x: &f64| x.is_finite())
}
