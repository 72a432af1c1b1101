//! Tables as spreadsheets save them: UTF-8 or UTF-16, columns separated by commas, semicolons or tabs, a line `sep=` for
//! Excel, a comma as decimal mark, a typographic minus, remarks above the header, rows of blank fields.
//!
//! [`decoded`] turns a file's bytes into text, [`Sheet::open`] reads the text as a table, and [`Sheet::number`] reads a
//! field as a number.

use super::encoding::{with_line_feeds, with_plain_minus};

/// Marks of a line that is a remark.
pub const REMARKS: [&str; 4] = ["#", "%", "//", "!"];

/// Decodes a text file: UTF-8, or UTF-16 as spreadsheets export it. A byte order mark is kept.
///
/// # Errors
/// Line (from 1) and value of the first byte that is not text.
pub fn decoded(bytes: Vec<u8>) -> Result<String, (usize, u8)> {
    decoded_only(bytes).map(|text| with_line_feeds(text.into()).into_owned())
}

fn decoded_only(bytes: Vec<u8>) -> Result<String, (usize, u8)> {
    let order: Option<fn([u8; 2]) -> u16> = match bytes.as_slice() {
        [0xff, 0xfe, ..] | [1..=255, 0, 1..=255, 0, ..] => Some(u16::from_le_bytes),
        [0xfe, 0xff, ..] | [0, 1..=255, 0, 1..=255, ..] => Some(u16::from_be_bytes),
        _ => None,
    };
    if let Some(order) = order {
        let units = bytes.as_chunks::<2>().0.iter().map(|unit| order(*unit));
        return Ok(char::decode_utf16(units)
            .map(|c| c.unwrap_or(char::REPLACEMENT_CHARACTER))
            .collect());
    }
    String::from_utf8(bytes).map_err(|error| {
        let at = error.utf8_error().valid_up_to();
        let bytes = error.as_bytes();
        let line = 1 + bytes[..at].iter().filter(|b| **b == b'\n').count();
        (line, bytes[at])
    })
}

/// The text from the header on, and the number of lines above it: blank lines and remarks. If only
/// remarks are above the numbers, the last one is the header, as numpy writes it.
fn below_remarks(text: &str) -> (usize, &str) {
    let mark_of = |line: &str| REMARKS.iter().find(|mark| line.starts_with(**mark));
    let (mut count, mut rest, mut last) = (0, text, None);
    while let Some(line) = rest.split_inclusive('\n').next() {
        let bare = line.trim();
        match mark_of(bare) {
            Some(mark) => {
                let inner = rest.trim_start().trim_start_matches(mark);
                last = Some((count, inner.trim_start_matches([' ', '\t'])));
            }
            None if bare.is_empty() => {}
            None => break,
        }
        (count, rest) = (count + 1, &rest[line.len()..]);
    }
    let begins = rest.split([',', ';', '\t']).next().unwrap_or_default();
    let is_number = with_plain_minus(begins.trim()).parse::<f64>().is_ok();
    last.filter(|_| is_number).unwrap_or((count, rest))
}

/// A table of named columns.
#[derive(Debug)]
pub struct Sheet<'t> {
    /// Reads the header and the lines below it; its line numbers start at `first_line`.
    reader: csv::Reader<&'t [u8]>,
    /// Whether a comma may be a decimal mark: not where it separates columns.
    decimal_comma: bool,
    /// Line of the file, from 1, of the header.
    first_line: usize,
}

impl<'t> Sheet<'t> {
    /// Opens the table in a text. The separator is that of Excel's line `sep=`, or else the most frequent one in the header.
    #[must_use]
    pub fn open(text: &'t str) -> Sheet<'t> {
        let text = text.trim_start_matches('\u{feff}');
        let (above, text) = below_remarks(text);
        let (first, below) = text.split_once('\n').unwrap_or((text, ""));
        let bare = first.trim().trim_matches('"');
        let stated = match bare.get(..4) {
            Some(word) if word.eq_ignore_ascii_case("sep=") => bare[4..].bytes().next(),
            _ => None,
        };
        // A tab is trimmed away.
        let stated = match stated {
            None if first.trim_end_matches('\r').eq_ignore_ascii_case("sep=\t") => Some(b'\t'),
            stated => stated.filter(u8::is_ascii),
        };
        let (header, text, first_line) = match stated {
            Some(_) => (below.lines().next().unwrap_or(""), below, above + 2),
            None => (first, text, above + 1),
        };
        let delimiter = stated.unwrap_or_else(|| {
            let count = |mark: u8| header.bytes().filter(|b| *b == mark).count();
            let marks = [b'\t', b';', b','];
            marks.into_iter().max_by_key(|m| count(*m)).unwrap_or(b',')
        });
        Sheet {
            reader: csv::ReaderBuilder::new()
                .trim(csv::Trim::All)
                // The parser counts terminators; only the line feed must count, not the carriage return before it.
                .terminator(csv::Terminator::Any(b'\n'))
                .delimiter(delimiter)
                .from_reader(text.as_bytes()),
            decimal_comma: delimiter != b',',
            first_line,
        }
    }

    /// Names of the columns.
    ///
    /// # Errors
    /// The parser's error.
    pub fn headers(&mut self) -> csv::Result<csv::StringRecord> {
        self.reader.headers().cloned()
    }

    /// The next line with a field that is not blank; `None` at the end.
    pub fn read(&mut self) -> Option<csv::Result<csv::StringRecord>> {
        let mut record = csv::StringRecord::new();
        loop {
            match self.reader.read_record(&mut record) {
                // Spreadsheets keep rows that once were used.
                Ok(true) if record.iter().all(str::is_empty) => {}
                Ok(true) => return Some(Ok(record)),
                Ok(false) => return None,
                Err(error) => return Some(Err(error)),
            }
        }
    }

    /// Line of the header in the file, from 1.
    #[must_use]
    pub fn header_line(&self) -> usize {
        self.first_line
    }

    /// Line of the file, from 1, at a position of the parser.
    #[must_use]
    pub fn line(&self, position: Option<&csv::Position>) -> Option<usize> {
        let line = usize::try_from(position?.line()).ok()?;
        Some(line + self.first_line - 1)
    }

    /// Reads a finite number in the notation of this table.
    ///
    /// # Errors
    /// Why the field is not a finite number.
    pub fn number(&self, field: &str) -> Result<f64, String> {
        let mut plain = with_plain_minus(field).into_owned();
        if self.decimal_comma && plain.matches(',').count() == 1 && !plain.contains('.') {
            plain = plain.replace(',', ".");
        }
        let value = plain.parse::<f64>().ok().filter(|x| x.is_finite());
        value.ok_or_else(|| {
            let strange = field.chars().find(|c| !c.is_ascii());
            let also = strange.map_or(String::new(), |c| {
                format!(": it holds `{c}` (U+{:04X})", u32::from(c))
            });
            let comma = match plain.contains(',') {
                true => ": write decimals after a point, without separators between thousands",
                false => "",
            };
            format!("`{field}` is not a finite number{also}{comma}")
        })
    }
}

/// Returns the remedy for a table whose fields are separated by another mark than a comma.
#[must_use]
pub fn other_separator(headers: &csv::StringRecord) -> Option<&'static str> {
    (headers.len() == 1 && headers[0].contains([';', '\t']))
        .then_some("separate its fields by commas, with a point as decimal mark")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_text_of_a_spreadsheet_is_read_in_either_width() {
        let text = "\u{feff}file;kind\r\ngr\u{fc}n.png;\u{2212}20\r\n";
        let wide = |order: fn(u16) -> [u8; 2]| text.encode_utf16().flat_map(order).collect();
        for bytes in [
            text.as_bytes().to_vec(),
            wide(u16::to_le_bytes),
            wide(u16::to_be_bytes),
        ] {
            assert_eq!(decoded(bytes).unwrap(), text);
        }
        // Without its mark, too.
        let bare: Vec<u8> = "file".encode_utf16().flat_map(u16::to_le_bytes).collect();
        assert_eq!(decoded(bare).unwrap(), "file");
        assert_eq!(decoded(b"file\ngr\xfcn".to_vec()), Err((2, 0xfc)));
        assert_eq!(decoded(Vec::new()).unwrap(), "");
    }

    /// Fields of the first line below the header, its line number, and its second field as a number.
    fn first(text: &str) -> (Vec<String>, Option<usize>, Result<f64, String>) {
        let mut sheet = Sheet::open(text);
        assert_eq!(sheet.headers().unwrap(), vec!["a", "b"]);
        let record = sheet.read().unwrap().unwrap();
        let number = sheet.number(&record[1]);
        let fields = record.iter().map(str::to_owned).collect();
        (fields, sheet.line(record.position()), number)
    }

    #[test]
    fn columns_decimals_and_minus_are_read_as_they_are_written() {
        for (text, line, value) in [
            ("a,b\nx,-2.5\n", 2, -2.5),
            ("\u{feff}a;b\r\nx;\u{2212}2,5\r\n", 2, -2.5),
            ("sep=;\r\na;b\r\nx;2,5\r\n", 3, 2.5),
            ("\"sep=,\"\na,b\nx,2.5\n", 3, 2.5),
            ("SEP=\t\na\tb\nx\t2,5\n", 3, 2.5),
            ("a\tb\nx\t\u{2013}1e3\n", 2, -1e3),
            ("a;b\n\"x;y\";1.5\n", 2, 1.5),
            ("# by hand\n\n% twice\na,b\nx,1.5\n", 5, 1.5),
            ("a,b\n,\n,\nx,1.5\n", 4, 1.5),
            ("# by hand\n# a,b\n1,1.5\n", 3, 1.5),
        ] {
            let (fields, at, number) = first(text);
            assert_eq!((at, number), (Some(line), Ok(value)), "{text:?}");
            assert_eq!(fields.len(), 2);
        }
    }

    #[test]
    fn what_is_no_number_is_named_by_the_character_that_no_eye_sees() {
        for (text, words) in [
            ("a,b\nx,NaN\n", "not a finite number"),
            ("a,b\nx,20\u{b0}\n", "U+00B0"),
            ("a,b\nx,\"1,234\"\n", "thousands"),
            ("a;b\nx;1.234,5\n", "thousands"),
        ] {
            let said = first(text).2.unwrap_err();
            assert!(said.contains(words), "`{words}` is not in: {said}");
        }
    }
}
