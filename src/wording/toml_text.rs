//! Reads TOML and reports what is wrong with it: line, key and what is expected.
//!
//! [`read`] is the one function to call for a file; [`of_table`] reads a table that was combined from several sources, and
//! [`line_of`] finds the line of a key.

use serde::de::DeserializeOwned;
use toml::de::DeTable;

use super::refusals::{missing, plain};

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
    let syntax = |error: &toml::de::Error| {
        let message = one_line(error.message());
        Refused {
            line: error.span().map(|span| line_at(text, span.start)),
            key: String::new(),
            words: match message.strip_prefix("duplicate key") {
                Some(_) => "this key is given twice".to_owned(),
                None => format!("this is not TOML: {message}"),
            },
        }
    };
    let from = toml::Deserializer::parse(text).map_err(|error| syntax(&error))?;
    serde_path_to_error::deserialize(from).map_err(|error| {
        let line = error.inner().span().map(|span| line_at(text, span.start));
        told(line, &error)
    })
}

/// Reads a table.
///
/// # Errors
/// The first thing that is wrong; it has no line.
pub fn of_table<T: DeserializeOwned>(table: toml::Table) -> Result<T, Refused> {
    serde_path_to_error::deserialize(toml::Value::Table(table)).map_err(|error| told(None, &error))
}

fn told(line: Option<usize>, error: &serde_path_to_error::Error<toml::de::Error>) -> Refused {
    let path = error.path().to_string();
    let path = if path == "." { "" } else { path.as_str() };
    let message = one_line(error.inner().message());
    if let Some(name) = missing(&message) {
        let key = match path {
            "" => name.to_owned(),
            path => format!("{path}.{name}"),
        };
        let words = "is missing".to_owned();
        return Refused { line, key, words };
    }
    Refused {
        line,
        key: path.to_owned(),
        words: plain(&message),
    }
}

/// Returns the line (from 1) on which the key at `path` is set, for example `camera.width_px`; for a section, the line of
/// its first header. `None` if the text does not set it.
#[must_use]
pub fn line_of(text: &str, path: &str) -> Option<usize> {
    let text = text.trim_start_matches('\u{feff}');
    let (table, _) = DeTable::parse_recoverable(text);
    let (mut within, mut at) = (Some(table.get_ref()), None);
    for key in path.split('.') {
        let (key, value) = within?.get_key_value(key)?;
        at = Some(key.span().start);
        within = value.get_ref().as_table();
    }
    at.map(|byte| line_at(text, byte))
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

    fn said(text: &str) -> String {
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
    fn what_is_wrong_is_said_with_line_key_and_no_word_of_the_program() {
        let camera = "[camera]\nwidth_px = 3\nexposures_s = [0.1]\n";
        assert!(read::<Outer>(camera).is_ok());
        assert!(read::<Outer>(&format!("\u{feff}{camera}")).is_ok());
        for (text, wanted) in [
            (
                camera.replace("= 3", "= \"wide\""),
                "line 2: camera.width_px: \"wide\" stands where a whole number from 0 to 4294967295 is expected",
            ),
            (
                camera.replace("= 3", "= -3"),
                "line 2: camera.width_px: -3 stands where a whole number from 0 to 4294967295 is expected",
            ),
            (
                camera.replace("[0.1]", "[0.1, \"x\"]"),
                "line 3: camera.exposures_s[1]: \"x\" stands where a number is expected",
            ),
            (
                camera.replace("width", "widht"),
                "line 2: camera.widht_px: there is no field `widht_px`, only `width_px` or `exposures_s`",
            ),
            (
                format!("kind = \"papr\"\n{camera}"),
                "line 1: kind: there is no `papr`, only `paper` or `full`",
            ),
            (
                camera.replace("width_px = 3\n", ""),
                "line 1: camera.width_px: is missing",
            ),
        ] {
            assert_eq!(said(&text), wanted, "{text}");
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
            refused.starts_with("camera.width_px: true stands where"),
            "{refused}"
        );
    }
}
