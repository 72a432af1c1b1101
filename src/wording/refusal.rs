//! Why a text or a query is refused: the path of the value, and what is wrong with it.

use std::fmt;

use super::{meant, stated};
use serde::de::{Expected, Unexpected};

/// Longest part of a value that a refusal quotes, in characters.
const QUOTED_MAX: usize = 60;

/// Why a text, or a value in it, is not what the type needs.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Refusal {
    /// From the value outwards.
    pub(super) steps: Vec<Step>,
    fault: Fault,
}

/// A step of a path into a value.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Step {
    Name(String),
    Place(usize),
}

/// What is wrong at the end of the path.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Fault {
    /// The text is not of its format. Holds the parser's own words, with line and column.
    Syntax(String),
    /// The type has no such field.
    UnknownField {
        /// All fields that the type has.
        known: &'static [&'static str],
    },
    /// The value is needed and was not given.
    Missing,
    /// The name was given twice.
    Repeated,
    /// A list was given for an object of named fields.
    ListForObject,
    /// Any other wrong value: what was expected and what was given.
    Invalid(String),
}

impl Refusal {
    pub(super) fn new(fault: Fault) -> Self {
        Refusal {
            steps: Vec::new(),
            fault,
        }
    }

    /// A fault at a path, given from the whole inwards.
    pub(super) fn at_path(path: Vec<Step>, fault: Fault) -> Self {
        Refusal {
            steps: path.into_iter().rev().collect(),
            fault,
        }
    }

    pub(super) fn at(mut self, step: Step) -> Self {
        self.steps.push(step);
        self
    }

    /// Returns what is wrong.
    #[must_use]
    pub fn fault(&self) -> &Fault {
        &self.fault
    }

    /// Returns the path of the value, e.g. `plan.theta_c_deg[2]`; empty for the whole text.
    #[must_use]
    pub fn path(&self) -> String {
        let mut path = String::new();
        for step in self.steps.iter().rev() {
            match step {
                Step::Name(name) if path.is_empty() => path.push_str(name),
                Step::Name(name) => path.extend([".", name]),
                Step::Place(place) => path.push_str(&format!("[{place}]")),
            }
        }
        path
    }

    /// Returns the path of the value, with the path of the value that was read in front.
    #[must_use]
    pub fn path_below(&self, root: &str) -> String {
        match self.path() {
            path if path.is_empty() => root.to_owned(),
            path if path.starts_with('[') => format!("{root}{path}"),
            path => format!("{root}.{path}"),
        }
    }

    /// Returns what is wrong, without the path. `field` is what a field is called there: a field or a parameter.
    #[must_use]
    pub fn message(&self, field: &str) -> String {
        match &self.fault {
            Fault::Syntax(words) | Fault::Invalid(words) => words.clone(),
            Fault::Missing => "is missing".to_owned(),
            Fault::Repeated => "is given twice".to_owned(),
            Fault::ListForObject => format!("expected an object of named {field}s, got a list"),
            Fault::UnknownField { known } => {
                let name = match self.steps.first() {
                    Some(Step::Name(name)) => short(name),
                    _ => String::new(),
                };
                let hint = match (meant(&name, known), known.is_empty()) {
                    (Some(right), _) => format!("did you mean `{right}`?"),
                    (None, true) => format!("expected no {field}"),
                    (None, false) => format!("expected {}", one_of(known)),
                };
                format!("there is no {field} `{name}`; {hint}")
            }
        }
    }
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.path().as_str() {
            "" => f.write_str(&self.message("field")),
            path => write!(f, "{path}: {}", self.message("field")),
        }
    }
}

impl std::error::Error for Refusal {}

impl serde::de::Error for Refusal {
    fn custom<T: fmt::Display>(message: T) -> Self {
        Refusal::new(Fault::Invalid(message.to_string()))
    }

    fn invalid_type(got: Unexpected<'_>, expected: &dyn Expected) -> Self {
        let got = match got {
            Unexpected::Bool(value) => value.to_string(),
            Unexpected::Unsigned(value) => value.to_string(),
            Unexpected::Signed(value) => value.to_string(),
            Unexpected::Float(value) => stated(value),
            Unexpected::Str(text) => format!("{:?}", short(text)),
            Unexpected::Unit | Unexpected::Option => "null".to_owned(),
            Unexpected::Seq => "a list".to_owned(),
            Unexpected::Map => "an object".to_owned(),
            other => other.to_string(),
        };
        Refusal::new(Fault::Invalid(format!(
            "expected {}, got {got}",
            in_words(&expected.to_string())
        )))
    }

    fn invalid_value(got: Unexpected<'_>, expected: &dyn Expected) -> Self {
        Self::invalid_type(got, expected)
    }

    fn invalid_length(length: usize, expected: &dyn Expected) -> Self {
        Refusal::new(Fault::Invalid(format!(
            "expected {expected}, got a list of {length}"
        )))
    }

    fn unknown_variant(word: &str, known: &'static [&'static str]) -> Self {
        let word = short(word);
        let hint = meant(&word, known)
            .map_or_else(String::new, |right| format!("; did you mean `{right}`?"));
        Refusal::new(Fault::Invalid(format!(
            "expected {}, got \"{word}\"{hint}",
            one_of(known)
        )))
    }

    fn unknown_field(name: &str, known: &'static [&'static str]) -> Self {
        Refusal::new(Fault::UnknownField { known }).at(Step::Name(name.to_owned()))
    }

    fn missing_field(name: &'static str) -> Self {
        Refusal::new(Fault::Missing).at(Step::Name(name.to_owned()))
    }

    fn duplicate_field(name: &'static str) -> Self {
        Refusal::new(Fault::Repeated).at(Step::Name(name.to_owned()))
    }
}

/// What a type of the standard library expects, in words: types read through an untagged enumeration name themselves.
fn in_words(expected: &str) -> &str {
    match expected {
        "f64" | "f32" => "a number",
        "i8" | "i16" | "i32" | "i64" => "a whole number",
        "u8" | "u16" | "u32" | "u64" => "a whole number from 0",
        "a boolean" => "true or false",
        "a string" => "a text",
        "a sequence" => "a list",
        "a map" => "an object",
        other => other,
    }
}

/// Words in a row: `paper, sawtooth or auto`.
pub(super) fn one_of(words: &[&str]) -> String {
    match words {
        [] => "nothing".to_owned(),
        [one] => (*one).to_owned(),
        [first @ .., last] => format!("{} or {last}", first.join(", ")),
    }
}

/// The first characters of a text of any length.
pub(super) fn short(text: &str) -> String {
    match text.char_indices().nth(QUOTED_MAX) {
        Some((end, _)) => format!("{}…", &text[..end]),
        None => text.to_owned(),
    }
}
