//! Decodes the text of tables and headers in the encodings and with the line ends that programs write.

use std::borrow::Cow;

/// Decodes a text: UTF-8, UTF-16 (by its byte order mark or its zeros), or Latin-1, in which some
/// programs write µ, ° and the names of files. A byte order mark is removed, and lines end in a line
/// feed also where a carriage return stands for it.
///
/// # Errors
/// The content is not text, or is invalid UTF-16.
pub fn text_of(content: &[u8]) -> Result<Cow<'_, str>, String> {
    decoded(content).map(with_line_feeds)
}

fn decoded(content: &[u8]) -> Result<Cow<'_, str>, String> {
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
        return Err(
            "the file is not text: it contains zero bytes; export the table as text (CSV)"
                .to_owned(),
        );
    }
    match std::str::from_utf8(content) {
        Ok(text) => Ok(text.trim_start_matches('\u{feff}').into()),
        Err(_) if content.iter().any(|b| *b < b' ' && !b"\t\r\n".contains(b)) => {
            Err("the file is not text: export the table as text (CSV)".to_owned())
        }
        Err(_) => Ok(content
            .iter()
            .map(|b| char::from(*b))
            .collect::<String>()
            .into()),
    }
}

/// Replaces carriage returns by line feeds where no line feed ends a line, as some spreadsheets save
/// a CSV file.
pub(super) fn with_line_feeds(text: Cow<'_, str>) -> Cow<'_, str> {
    match text.contains('\r') && !text.contains('\n') {
        true => text.replace('\r', "\n").into(),
        false => text,
    }
}

/// A number with a plain minus in place of a typographic one.
#[must_use]
pub fn with_plain_minus(word: &str) -> Cow<'_, str> {
    const MINUS: [char; 4] = ['\u{2212}', '\u{2013}', '\u{ff0d}', '\u{fe63}'];
    match word.contains(MINUS) {
        true => word.replace(MINUS, "-").into(),
        false => word.into(),
    }
}

/// A field of a file as a message quotes it: at most 40 characters.
#[must_use]
pub fn quoted(word: &str) -> String {
    const LENGTH_MAX: usize = 40;
    match word.char_indices().nth(LENGTH_MAX) {
        Some((at, _)) => format!("{:?}…", &word[..at]),
        None => format!("{word:?}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_is_the_same_in_every_encoding_and_with_every_line_end() {
        let text = "θ [°]\n1\n".replace('θ', "\u{fc}");
        let latin: Vec<u8> = text.chars().map(|c| c as u8).collect();
        let wide: Vec<u8> = text.encode_utf16().flat_map(u16::to_be_bytes).collect();
        let marked = [&b"\xfe\xff"[..], &wide].concat();
        let returns = text.replace('\n', "\r");
        for content in [text.as_bytes(), &latin, &marked, returns.as_bytes()] {
            assert_eq!(text_of(content).unwrap(), text);
        }
        assert_eq!(text_of(b"a\r\nb\r\n").unwrap(), "a\r\nb\r\n");
        assert!(text_of(b"PK\x03\x04\0").unwrap_err().contains("CSV"));
    }

    #[test]
    fn a_long_field_is_quoted_in_part() {
        assert_eq!(quoted("ab"), "\"ab\"");
        assert!(quoted(&"ü".repeat(500)).chars().count() < 50);
    }
}
