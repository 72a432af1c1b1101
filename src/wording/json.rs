//! Reads the JSON of a request into a type of the program, and refuses it by the path of the first wrong value.
//!
//! [`from_slice`] reads a body, [`from_value`] a part of one, and [`from_query`] the parameters after a question mark.
//! All three compare the names that were sent with the field list of the type, so a refusal can name the field that was
//! probably meant. They are stricter than serde: each name counts once, and an object of named fields cannot be written
//! as a list of its values (`[10]` for `{"position_deg": 10}`), which in a request for a motion is a slip.

use std::cell::{Cell, RefCell};
use std::fmt;

use serde::Deserialize;
use serde::de::value::MapAccessDeserializer;
use serde::de::{
    DeserializeOwned, DeserializeSeed, Deserializer, Error as _, MapAccess, SeqAccess, Visitor,
};
use serde_json::Value;

pub use super::refusal::{Fault, Refusal};

use super::refusal::Step;
use super::values::{self, Fields, Form, Read, Text};

/// Reads a text of JSON.
///
/// # Errors
/// The text is not JSON, or a value in it is not what `T` needs.
pub fn from_slice<T: DeserializeOwned>(json: &[u8]) -> Result<T, Refusal> {
    from_value(&read(json)?)
}

/// Reads a value.
///
/// # Errors
/// The first value in it that is not what `T` needs.
pub fn from_value<'de, T: Deserialize<'de>>(value: &'de Value) -> Result<T, Refusal> {
    T::deserialize(Read(value))
}

/// Reads the parameters of a query, by name and text.
///
/// # Errors
/// The first parameter that is not what `T` needs.
pub fn from_query<'de, T: Deserialize<'de>>(
    parameters: &'de [(String, String)],
) -> Result<T, Refusal> {
    let parameters = parameters.iter();
    T::deserialize(MapAccessDeserializer::new(Fields::new(
        parameters.map(|(name, text)| (name.as_str(), Text(text))),
    )))
}

impl<'de> values::Value<'de> for &'de Value {
    const SECTION: &'static str = "an object";
    type List = std::slice::Iter<'de, Value>;
    type Section = serde_json::map::Iter<'de>;

    fn form(self) -> Form<'de, Self> {
        match self {
            Value::Null => Form::Null,
            Value::Bool(value) => Form::Truth(*value),
            Value::Number(number) => match number.as_i128() {
                Some(number) => Form::Whole(number),
                None => Form::Number(number.as_f64().unwrap_or(f64::NAN)),
            },
            Value::String(text) => Form::Text(text),
            Value::Array(values) => Form::List(values.iter()),
            Value::Object(fields) => Form::Section(fields.iter()),
        }
    }
}

/// Reads JSON in which every object has each name once.
fn read(json: &[u8]) -> Result<Value, Refusal> {
    let (path, repeated) = (RefCell::default(), Cell::new(false));
    let mut from = serde_json::Deserializer::from_slice(json);
    let once = Once {
        path: &path,
        repeated: &repeated,
    };
    let read = once.deserialize(&mut from);
    read.and_then(|value| from.end().map(|()| value))
        .map_err(|error| match repeated.get() {
            true => Refusal::at_path(path.take(), Fault::Repeated),
            false => Refusal::new(Fault::Syntax(error.to_string())),
        })
}

/// Makes a value none of whose objects has a name twice.
#[derive(Clone, Copy)]
struct Once<'a> {
    /// From the whole inwards.
    path: &'a RefCell<Vec<Step>>,
    repeated: &'a Cell<bool>,
}

impl<'de> DeserializeSeed<'de> for Once<'_> {
    type Value = Value;

    fn deserialize<D: Deserializer<'de>>(self, from: D) -> Result<Value, D::Error> {
        from.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for Once<'_> {
    type Value = Value;

    fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("a value")
    }

    fn visit_unit<E>(self) -> Result<Value, E> {
        Ok(Value::Null)
    }

    fn visit_bool<E>(self, value: bool) -> Result<Value, E> {
        Ok(value.into())
    }

    fn visit_u64<E>(self, value: u64) -> Result<Value, E> {
        Ok(value.into())
    }

    fn visit_i64<E>(self, value: i64) -> Result<Value, E> {
        Ok(value.into())
    }

    fn visit_f64<E>(self, value: f64) -> Result<Value, E> {
        Ok(value.into())
    }

    fn visit_str<E>(self, value: &str) -> Result<Value, E> {
        Ok(value.into())
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut values: A) -> Result<Value, A::Error> {
        let mut read = Vec::new();
        loop {
            self.path.borrow_mut().push(Step::Place(read.len()));
            let Some(value) = values.next_element_seed(self)? else {
                self.path.borrow_mut().pop();
                return Ok(Value::Array(read));
            };
            self.path.borrow_mut().pop();
            read.push(value);
        }
    }

    fn visit_map<A: MapAccess<'de>>(self, mut fields: A) -> Result<Value, A::Error> {
        let mut read = serde_json::Map::new();
        while let Some(name) = fields.next_key::<String>()? {
            self.path.borrow_mut().push(Step::Name(name.clone()));
            if read.contains_key(&name) {
                self.repeated.set(true);
                return Err(A::Error::custom("a name is given twice"));
            }
            let value = fields.next_value_seed(self)?;
            self.path.borrow_mut().pop();
            read.insert(name, value);
        }
        Ok(Value::Object(read))
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use serde_json::json;

    #[derive(Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    #[expect(dead_code, reason = "only its form is asked for")]
    struct Outer {
        number: Option<f64>,
        #[serde(default)]
        inner: Option<Inner>,
        #[serde(default)]
        kind: Option<Kind>,
        #[serde(default)]
        values: Option<Values>,
        #[serde(default)]
        word: Word,
        #[serde(default)]
        by_name: BTreeMap<String, Inner>,
        #[serde(default)]
        pair: Option<(u16, [f64; 2])>,
        #[serde(default)]
        many: Vec<Inner>,
        #[serde(default)]
        text: String,
        #[serde(default)]
        yes: bool,
    }

    #[derive(Debug, Deserialize)]
    #[expect(dead_code, reason = "only its form is asked for")]
    struct Inner {
        a: f64,
    }

    #[derive(Debug, Deserialize)]
    #[serde(tag = "kind", rename_all = "lowercase", deny_unknown_fields)]
    #[expect(dead_code, reason = "only its form is asked for")]
    enum Kind {
        One { n: f64 },
    }

    #[derive(Debug, Deserialize)]
    #[serde(untagged, expecting = "expected a list of numbers, or an object of a")]
    #[expect(dead_code, reason = "only its form is asked for")]
    enum Values {
        List(Vec<f64>),
        Grid(Inner),
    }

    #[derive(Debug, Deserialize, Default)]
    #[serde(rename_all = "kebab-case")]
    enum Word {
        #[default]
        First,
        SecondOne,
    }

    fn refused(text: &str) -> String {
        from_slice::<Outer>(text.as_bytes())
            .unwrap_err()
            .to_string()
    }

    #[test]
    fn a_whole_value_is_read() {
        let whole = json!({
            "number": 1.5, "inner": {"a": -1}, "kind": {"kind": "one", "n": 2}, "values": [1, 2.5], "word": "second-one",
            "by_name": {"x": {"a": 1}}, "pair": [1, [2, 3.5]], "many": [{"a": 1}], "text": "t", "yes": true,
        });
        from_slice::<Outer>(whole.to_string().as_bytes()).unwrap();
        from_value::<Outer>(&json!({"number": null, "values": {"a": 1}})).unwrap();
        let any: Value = from_slice(br#"{"a": {"x": [1, -2, 2.5, "w", null, true]}}"#).unwrap();
        assert_eq!(any, json!({"a": {"x": [1, -2, 2.5, "w", null, true]}}));
    }

    #[test]
    fn a_refusal_has_the_path_the_expected_value_and_the_one_sent() {
        for (text, words) in [
            (
                r#"{"number": "9 deg"}"#,
                "number: expected a number, got \"9 deg\"",
            ),
            (
                r#"{"inner": {"a": null}}"#,
                "inner.a: expected a number, got null",
            ),
            (r#"{"inner": {}}"#, "inner.a: is missing"),
            (
                r#"{"many": [{"a": 1}, {"a": []}]}"#,
                "many[1].a: expected a number, got a list of 0",
            ),
            (
                r#"{"pair": [-1, [1, 2]]}"#,
                "pair[0]: expected a whole number from 0 to 65535, got -1",
            ),
            (
                r#"{"pair": [1, [1]]}"#,
                "pair[1]: expected a list of 2, got a list of 1",
            ),
            (r#"{"by_name": 3}"#, "by_name: expected an object, got 3"),
            (r#"{"text": 3}"#, "text: expected a text, got 3"),
            (r#"{"yes": 1.5}"#, "yes: expected true or false, got 1.5"),
            (
                r#"{"values": "all"}"#,
                "values: expected a list of numbers, or an object of a",
            ),
            (
                r#"{"word": "third"}"#,
                "word: expected first or second-one, got \"third\"",
            ),
            (
                r#"{"word": "second_one"}"#,
                "word: expected first or second-one, got \"second_one\"; did you mean `second-one`?",
            ),
            (
                r#"{"word": {"first": null}}"#,
                "word: expected first or second-one, got an object",
            ),
            (
                r#"{"nunber": 1}"#,
                "nunber: there is no field `nunber`; did you mean `number`?",
            ),
            (
                r#"{"kind": {"kind": "one", "n": 1, "colour": 1}}"#,
                "kind.colour: there is no field `colour`; expected n",
            ),
            (
                r#"{"number": 1e300, "yes": 1e300}"#,
                "yes: expected true or false, got 1e300",
            ),
        ] {
            assert_eq!(refused(text), words, "{text}");
        }
        let long = refused(&format!(r#"{{"number": "{}"}}"#, "x".repeat(1000)));
        assert!(long.len() < 120, "{long}");
    }

    #[test]
    fn a_list_is_no_object_of_named_fields() {
        for (text, path) in [
            ("[1.5]", ""),
            (r#"{"inner": [1]}"#, "inner"),
            (r#"{"kind": ["one", 1]}"#, "kind"),
            (r#"{"by_name": {"x": [1]}}"#, "by_name.x"),
            (r#"{"many": [[1]]}"#, "many[0]"),
        ] {
            let refusal = from_slice::<Outer>(text.as_bytes()).unwrap_err();
            assert_eq!(refusal.path(), path, "{refusal}");
            assert_eq!(refusal.fault(), &Fault::ListForObject, "{refusal}");
        }
    }

    #[test]
    fn a_name_counts_once() {
        for (text, path) in [
            (r#"{"a": 1, "b": 2, "a": 1}"#, "a"),
            (r#"{"a": [0, {"b": {"c": 1, "c": 2}}]}"#, "a[1].b.c"),
        ] {
            let refusal = from_slice::<Value>(text.as_bytes()).unwrap_err();
            assert_eq!(refusal.path(), path, "{refusal}");
            assert_eq!(refusal.fault(), &Fault::Repeated, "{refusal}");
        }
        for text in ["", "{", "[1] 2", "{\"a\": NaN}", "1e999"] {
            let refusal = from_slice::<Value>(text.as_bytes()).unwrap_err();
            assert!(
                matches!(refusal.fault(), Fault::Syntax(_)),
                "{text}: {refusal}"
            );
        }
    }

    #[test]
    fn parameters_of_a_query_are_read_as_their_type() {
        #[derive(Debug, Default, PartialEq, Deserialize)]
        #[serde(deny_unknown_fields, default)]
        struct Params {
            limit: Option<u32>,
            name: Option<String>,
            least: Option<f64>,
        }
        let query = |all: &[(&str, &str)]| -> Result<Params, String> {
            let all: Vec<_> = all
                .iter()
                .map(|(n, t)| ((*n).to_owned(), (*t).to_owned()))
                .collect();
            from_query(&all).map_err(|refusal: Refusal| refusal.message("parameter"))
        };
        let read = query(&[("limit", "3"), ("name", "7"), ("least", "-1.5")]).unwrap();
        assert_eq!(
            (read.limit, read.name.as_deref(), read.least),
            (Some(3), Some("7"), Some(-1.5))
        );
        for (name, text, words) in [
            (
                "limit",
                "many",
                "expected a whole number from 0 to 4294967295, got \"many\"",
            ),
            ("least", "NaN", "expected a number, got \"NaN\""),
            (
                "limits",
                "3",
                "there is no parameter `limits`; did you mean `limit`?",
            ),
            (
                "colour",
                "3",
                "there is no parameter `colour`; expected limit, name or least",
            ),
        ] {
            assert_eq!(query(&[(name, text)]).unwrap_err(), words);
        }
        assert_eq!(
            query(&[("limit", "1"), ("limit", "2")]).unwrap_err(),
            "is given twice"
        );
    }
}
