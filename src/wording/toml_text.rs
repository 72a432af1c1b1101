//! Reads TOML and reports what is wrong with it: line, key and what is expected.
//!
//! [`read`] is the one function to call for a file; [`of_table`] reads a table that was combined from several sources, and
//! [`line_of`] finds the line of a key. Values are compared with the types that they are read into, as in [`json`].

use serde::de::DeserializeOwned;
use toml::Value;
use toml::de::{DeTable, DeValue};

use super::values::{self, Form, Read};

/// What is wrong with a text.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{}{}{words}", place(*.line), key_of(.key))]
pub struct Refused {
    /// Line from 1, if it is known.
    pub line: Option<usize>,
    /// Path of the key; empty if it is about the whole text.
    pub key: String,
    /// What is wrong with it.
    pub words: String,
}

fn place(line: Option<usize>) -> String {
    line.map_or_else(String::new, |line| format!("line {line}: "))
}

fn key_of(key: &str) -> String {
    match key {
        "" => String::new(),
        key => format!("{key}: "),
    }
}

/// Reads a text.
///
/// # Errors
/// The first thing that is wrong.
pub fn read<T: DeserializeOwned>(text: &str) -> Result<T, Refused> {
    let text = text.trim_start_matches('\u{feff}');
    let table: toml::Table = toml::from_str(text).map_err(|error| {
        let refused = |key: String, words: String| Refused {
            line: error.span().map(|span| line_at(text, span.start)),
            key,
            words,
        };
        // The parser reads any whole number; a value of TOML holds only those of 64 bits.
        match DeTable::parse(text)
            .ok()
            .and_then(|t| too_large(t.get_ref()))
        {
            Some((key, number)) => refused(
                key,
                format!("expected a whole number up to {}, got {number}", i64::MAX),
            ),
            None => refused(
                String::new(),
                format!("this is not TOML: {}", one_line(error.message())),
            ),
        }
    })?;
    of_table(table).map_err(|refused: Refused| Refused {
        line: nearest_line(text, &refused.key),
        ..refused
    })
}

/// Reads a table.
///
/// # Errors
/// The first thing that is wrong; it has no line.
pub fn of_table<T: DeserializeOwned>(table: toml::Table) -> Result<T, Refused> {
    let table = Value::Table(table);
    T::deserialize(Read(&table)).map_err(|refusal| Refused {
        line: None,
        key: refusal.path(),
        words: refusal.message("key"),
    })
}

/// Returns the line (from 1) on which the key at `path` is set, such as `camera.width_px` or `camera.exposures_s[1]`; for
/// a section, the line of its first header. `None` if the text does not set it.
#[must_use]
pub fn line_of(text: &str, path: &str) -> Option<usize> {
    let text = text.trim_start_matches('\u{feff}');
    let (table, _) = DeTable::parse_recoverable(text);
    let (mut within, mut at) = (Some(table.get_ref()), None);
    for step in path.split('.') {
        let mut parts = step.split('[');
        let (key, value) = within?.get_key_value(parts.next()?)?;
        at = Some(key.span().start);
        let mut value = value;
        for place in parts {
            let place: usize = place.strip_suffix(']')?.parse().ok()?;
            value = value.get_ref().as_array()?.get(place)?;
            at = Some(value.span().start);
        }
        within = DeValue::as_table(value.get_ref());
    }
    at.map(|byte| line_at(text, byte))
}

/// Returns the path and the digits of the first whole number of more than 64 bits.
fn too_large(table: &DeTable<'_>) -> Option<(String, String)> {
    table
        .iter()
        .find_map(|(name, value)| match value.get_ref() {
            DeValue::Integer(number) => {
                let digits = number.as_str();
                let fits = i64::from_str_radix(digits, number.radix()).is_ok();
                (!fits).then(|| (name.get_ref().to_string(), digits.to_owned()))
            }
            DeValue::Table(inner) => {
                let (path, digits) = too_large(inner)?;
                Some((format!("{}.{path}", name.get_ref()), digits))
            }
            _ => None,
        })
}

/// Returns the line of a key, or that of the section in which it is missing.
fn nearest_line(text: &str, path: &str) -> Option<usize> {
    line_of(text, path).or_else(|| match path.rsplit_once('.') {
        Some((section, _)) => nearest_line(text, section),
        None => Some(1),
    })
}

/// Returns the line (from 1) of a byte.
#[must_use]
pub fn line_at(text: &str, byte: usize) -> usize {
    let before = text.bytes().take(byte);
    before.filter(|b| *b == b'\n').count() + 1
}

fn one_line(message: &str) -> String {
    message.split_whitespace().collect::<Vec<_>>().join(" ")
}

impl<'de> values::Value<'de> for &'de Value {
    const SECTION: &'static str = "a section";
    type List = std::slice::Iter<'de, Value>;
    type Section = toml::map::Iter<'de, String, Value>;

    fn form(self) -> Form<'de, Self> {
        match self {
            Value::String(text) => Form::Text(text),
            Value::Integer(number) => Form::Whole((*number).into()),
            Value::Float(number) => Form::Number(*number),
            Value::Boolean(value) => Form::Truth(*value),
            Value::Datetime(time) => Form::Time(time.to_string()),
            Value::Array(values) => Form::List(values.iter()),
            Value::Table(table) => Form::Section(table.iter()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::Deserialize;

    #[derive(Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    #[expect(dead_code, reason = "only its form is asked for")]
    struct Outer {
        camera: Camera,
        #[serde(default)]
        kind: Kind,
    }

    #[derive(Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    #[expect(dead_code, reason = "only its form is asked for")]
    struct Camera {
        width_px: u32,
        exposures_s: Vec<f64>,
    }

    #[derive(Debug, Default, Deserialize)]
    #[serde(rename_all = "lowercase")]
    enum Kind {
        #[default]
        Paper,
        Full,
    }

    fn refusal(text: &str) -> String {
        read::<Outer>(text).unwrap_err().to_string()
    }

    #[test]
    fn a_key_is_found_in_its_own_section() {
        let text = "a = 1\n\n[rig]\n a = 2\n[camera]\n\"a\" = 3\n[sample.layout]\nx = { y = 1 }";
        for (path, line) in [
            ("a", Some(1)),
            ("rig.a", Some(4)),
            ("camera.a", Some(6)),
            ("camera", Some(5)),
            ("camera.b", None),
            ("sample", Some(7)),
            ("sample.layout.x.y", Some(8)),
            ("rig.a.b", None),
        ] {
            assert_eq!(line_of(text, path), line, "{path}");
        }
        assert_eq!(line_of("x = 1\nrig.a = 2\n", "rig.a"), Some(2));
        assert_eq!(line_of("\u{feff}x = 1\ny = [\n1,\n]\nz = 1", "z"), Some(5));
    }

    #[test]
    fn any_value_reads_as_the_parser_reads_it() {
        let text = "a = 2026-01-02T03:04:05Z\nb = [1979-05-27, 1, 2.5, \"w\", true, nan]\n[c.d]\ne = { f = -1 }\n";
        let parsed: Value = toml::from_str(text).unwrap();
        let own: Value = read(text).unwrap();
        assert_eq!(format!("{own:?}"), format!("{parsed:?}"));
    }

    #[test]
    fn a_number_of_more_than_64_bits_is_named_with_its_key() {
        let text = "[camera]\nexposures_s = []\nwidth_px = 18446744073709551616\n";
        assert_eq!(
            read::<Outer>(text).unwrap_err().to_string(),
            "line 3: camera.width_px: expected a whole number up to 9223372036854775807, got 18446744073709551616"
        );
    }

    #[test]
    fn a_refusal_has_line_key_and_what_is_expected() {
        let camera = "[camera]\nwidth_px = 3\nexposures_s = [0.1]\n";
        assert!(read::<Outer>(camera).is_ok());
        assert!(read::<Outer>(&format!("\u{feff}{camera}")).is_ok());
        for (text, wanted) in [
            (
                camera.replace("= 3", "= \"wide\""),
                "line 2: camera.width_px: expected a whole number from 0 to 4294967295, got \"wide\"",
            ),
            (
                camera.replace("= 3", "= -3"),
                "line 2: camera.width_px: expected a whole number from 0 to 4294967295, got -3",
            ),
            (
                camera.replace("[0.1]", "[0.1, \"x\"]"),
                "line 3: camera.exposures_s[1]: expected a number, got \"x\"",
            ),
            (
                camera.replace("width", "widht"),
                "line 2: camera.widht_px: there is no key `widht_px`; did you mean `width_px`?",
            ),
            (
                format!("kind = \"papr\"\n{camera}"),
                "line 1: kind: expected paper or full, got \"papr\"; did you mean `paper`?",
            ),
            (
                camera.replace("width_px = 3\n", ""),
                "line 1: camera.width_px: is missing",
            ),
        ] {
            assert_eq!(refusal(&text), wanted, "{text}");
        }
        for (text, line) in [
            ("[camera\nwidth_px = 3\n", 1),
            ("\u{0}garbage", 1),
            ("a = 1\na = 2", 2),
        ] {
            let refused = read::<Outer>(text).unwrap_err();
            assert_eq!(refused.line, Some(line), "{refused}");
        }
        let table: toml::Table = toml::from_str(&camera.replace("= 3", "= true")).unwrap();
        let refused = of_table::<Outer>(table).unwrap_err().to_string();
        assert!(
            refused.starts_with(
                "camera.width_px: expected a whole number from 0 to 4294967295, got true"
            ),
            "{refused}"
        );
    }
}
