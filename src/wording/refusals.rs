//! What a parser says of data, in words for those who wrote the data.
//!
//! [`plain`] turns a message of serde into what stands there and what is wanted, without the names that the program
//! has for it. It knows no path: where the value stands is told by who calls.

/// Says a message of serde in plain words; one that is none of serde's own stays as it is.
#[must_use]
pub fn plain(message: &str) -> String {
    let message = match message.rfind(" at line ") {
        Some(end) => &message[..end],
        None => message,
    };
    for start in ["invalid type: ", "invalid value: ", "invalid length "] {
        let rest = message.strip_prefix(start);
        if let Some((got, wanted)) = rest.and_then(|rest| rest.split_once(", expected ")) {
            let got = match start {
                "invalid length " => format!("a list of {got}"),
                _ => found(got),
            };
            return format!("{got} stands where {} is expected", sought(wanted));
        }
    }
    for (start, what) in [("unknown field ", "field "), ("unknown variant ", "")] {
        if let Some(rest) = message.strip_prefix(start) {
            return match rest.split_once(", expected ") {
                Some((name, known)) => {
                    let known = known.strip_prefix("one of ").unwrap_or(known);
                    format!("there is no {what}{name}, only {known}")
                }
                None => format!("there is no {what}{rest}"),
            };
        }
    }
    if let Some(name) = missing(message) {
        return format!("`{name}` is missing");
    }
    if let Some(name) = message.strip_prefix("duplicate field ") {
        return format!("{name} is named twice");
    }
    message.to_owned()
}

/// The field that a message of serde misses.
#[must_use]
pub fn missing(message: &str) -> Option<&str> {
    let rest = message.strip_prefix("missing field `")?;
    rest.split('`').next()
}

/// What stands there.
fn found(got: &str) -> String {
    let value = |kind: &str| {
        let rest = got.strip_prefix(kind)?;
        Some(rest.trim_matches('`').to_owned())
    };
    for kind in ["integer ", "floating point ", "boolean ", "string "] {
        if let Some(value) = value(kind) {
            return value;
        }
    }
    match got {
        "map" => "an object",
        "sequence" => "a list",
        "unit value" => "null",
        other => other,
    }
    .to_owned()
}

/// What should stand there.
fn sought(wanted: &str) -> String {
    match wanted {
        "f64" | "f32" => "a number".to_owned(),
        "i8" | "i16" | "i32" | "i64" | "isize" => "a whole number".to_owned(),
        "u8" => format!("a whole number from 0 to {}", u8::MAX),
        "u16" => format!("a whole number from 0 to {}", u16::MAX),
        "u32" => format!("a whole number from 0 to {}", u32::MAX),
        "u64" | "usize" => "a whole number from 0 on".to_owned(),
        "a boolean" => "true or false".to_owned(),
        "a string" | "a borrowed string" => "a text".to_owned(),
        "path string" => "a path".to_owned(),
        "a map" => "an object".to_owned(),
        "a sequence" => "a list".to_owned(),
        "string or map" | "variant identifier" => "a word".to_owned(),
        other => {
            let of_lists = ["an array of length ", "a tuple of size "];
            let length = of_lists.iter().find_map(|start| other.strip_prefix(start));
            let fields = ["struct ", "internally tagged enum ", "struct variant "];
            if let Some(length) = length {
                format!("a list of {length}")
            } else if fields.iter().any(|start| other.starts_with(start)) {
                "an object of named fields".to_owned()
            } else if other.starts_with("enum ") {
                "a word".to_owned()
            } else {
                other.to_owned()
            }
        }
    }
}

/// The way out for a table of which a comma separates nothing, but another mark does.
#[must_use]
pub fn other_separator(headers: &csv::StringRecord) -> Option<&'static str> {
    (headers.len() == 1 && headers[0].contains([';', '\t']))
        .then_some("separate its fields by commas, with a point as decimal mark")
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use serde::Deserialize;
    use serde::de::DeserializeOwned;

    use super::*;

    #[derive(Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    #[expect(dead_code, reason = "only its form is asked for")]
    struct Sample {
        name: String,
        kind: Kind,
    }

    #[derive(Debug, Deserialize)]
    #[serde(rename_all = "lowercase")]
    enum Kind {
        Plastic,
        Metal,
    }

    fn told<T: DeserializeOwned>(json: &str) -> String {
        match serde_json::from_str::<T>(json) {
            Ok(_) => String::new(),
            Err(error) => plain(&error.to_string()),
        }
    }

    #[test]
    fn nothing_is_said_in_the_words_of_the_program() {
        let whole = "-1 stands where a whole number from 0 to 65535 is expected";
        for (said, wanted) in [
            (
                told::<f64>("\"a\""),
                "\"a\" stands where a number is expected",
            ),
            (told::<u16>("-1"), whole),
            (
                told::<bool>("1.5"),
                "1.5 stands where true or false is expected",
            ),
            (told::<Vec<f64>>("3"), "3 stands where a list is expected"),
            (
                told::<[f64; 2]>("[1]"),
                "a list of 1 stands where a list of 2 is expected",
            ),
            (
                told::<BTreeMap<String, f64>>("null"),
                "null stands where an object is expected",
            ),
            (
                told::<Sample>("[\"a\"]"),
                "a list of 1 stands where an object of named fields is expected",
            ),
            (
                told::<Sample>(r#"{"colour": 1}"#),
                "there is no field `colour`, only `name` or `kind`",
            ),
            (
                told::<Kind>("\"wood\""),
                "there is no `wood`, only `plastic` or `metal`",
            ),
        ] {
            assert_eq!(said, wanted);
        }
        assert_eq!(missing("missing field `eta` at line 1"), Some("eta"));
        assert_eq!(plain("a remedy of our own"), "a remedy of our own");
    }
}
