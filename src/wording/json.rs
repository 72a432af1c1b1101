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
    DeserializeOwned, DeserializeSeed, Deserializer, Error as _, Expected, IntoDeserializer,
    MapAccess, SeqAccess, Unexpected, Visitor,
};
use serde::forward_to_deserialize_any;
use serde_json::Value;

use super::{meant, stated};

/// Longest part of a value that a refusal quotes, in characters.
const QUOTED_MAX: usize = 60;

/// Why a text, or a value in it, is not what the type needs.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Refusal {
    /// From the value outwards.
    steps: Vec<Step>,
    fault: Fault,
}

/// A step of a path into a value.
#[derive(Debug, Clone, PartialEq, Eq)]
enum Step {
    Name(String),
    Place(usize),
}

/// What is wrong at the end of the path.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Fault {
    /// The text is not JSON. Holds the parser's own words, with line and column.
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
    fn new(fault: Fault) -> Self {
        Refusal {
            steps: Vec::new(),
            fault,
        }
    }

    fn expected(what: &str, got: &Value) -> Self {
        Refusal::new(Fault::Invalid(format!(
            "expected {what}, got {}",
            quoted(got)
        )))
    }

    fn at(mut self, step: Step) -> Self {
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
            Fault::ListForObject => "expected an object of named fields, got a list".to_owned(),
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
        Refusal::new(Fault::Invalid(format!("expected {expected}, got {got}")))
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

/// Words in a row: `paper, sawtooth or auto`.
fn one_of(words: &[&str]) -> String {
    match words {
        [] => "nothing".to_owned(),
        [one] => (*one).to_owned(),
        [first @ .., last] => format!("{} or {last}", first.join(", ")),
    }
}

/// The first characters of a text of any length.
fn short(text: &str) -> String {
    match text.char_indices().nth(QUOTED_MAX) {
        Some((end, _)) => format!("{}…", &text[..end]),
        None => text.to_owned(),
    }
}

fn quoted(value: &Value) -> String {
    match value {
        Value::Null => "null".to_owned(),
        Value::Bool(value) => value.to_string(),
        Value::Number(number) => match number.as_f64() {
            Some(value) if number.is_f64() => stated(value),
            _ => number.to_string(),
        },
        Value::String(text) => format!("{:?}", short(text)),
        Value::Array(values) => format!("a list of {}", values.len()),
        Value::Object(_) => "an object".to_owned(),
    }
}

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
    T::deserialize(Json(value))
}

/// Reads the parameters of a query, by name and text.
///
/// # Errors
/// The first parameter that is not what `T` needs.
pub fn from_query<'de, T: Deserialize<'de>>(
    parameters: &'de [(String, String)],
) -> Result<T, Refusal> {
    let parameters = parameters.iter();
    T::deserialize(MapAccessDeserializer::new(Fields {
        inner: parameters.map(|(name, text)| (name.as_str(), Text(text))),
        value: None,
    }))
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
            true => Refusal {
                steps: path.take().into_iter().rev().collect(),
                fault: Fault::Repeated,
            },
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

/// Names and values, each value refused by its name.
struct Fields<'de, I, D> {
    inner: I,
    value: Option<(&'de str, D)>,
}

impl<'de, I, D> MapAccess<'de> for Fields<'de, I, D>
where
    I: Iterator<Item = (&'de str, D)>,
    D: Deserializer<'de, Error = Refusal>,
{
    type Error = Refusal;

    fn next_key_seed<K: DeserializeSeed<'de>>(
        &mut self,
        seed: K,
    ) -> Result<Option<K::Value>, Refusal> {
        self.value = self.inner.next();
        let name = self.value.as_ref().map(|(name, _)| *name);
        name.map(|name| seed.deserialize(name.into_deserializer()))
            .transpose()
    }

    fn next_value_seed<V: DeserializeSeed<'de>>(&mut self, seed: V) -> Result<V::Value, Refusal> {
        let (name, value) = self.value.take().expect("a name is read before its value");
        seed.deserialize(value)
            .map_err(|refusal| refusal.at(Step::Name(name.to_owned())))
    }
}

/// The values of a list, each refused by its place.
struct Places<'de> {
    values: std::iter::Enumerate<std::slice::Iter<'de, Value>>,
}

impl<'de> SeqAccess<'de> for Places<'de> {
    type Error = Refusal;

    fn next_element_seed<T: DeserializeSeed<'de>>(
        &mut self,
        seed: T,
    ) -> Result<Option<T::Value>, Refusal> {
        let Some((place, value)) = self.values.next() else {
            return Ok(None);
        };
        let taken_for_name = Cell::new(false);
        let element = Element {
            value: Json(value),
            taken_for_name: &taken_for_name,
        };
        match seed.deserialize(element) {
            Ok(value) => Ok(Some(value)),
            Err(_) if taken_for_name.get() => Err(Refusal::new(Fault::ListForObject)),
            Err(refusal) => Err(refusal.at(Step::Place(place))),
        }
    }

    fn size_hint(&self) -> Option<usize> {
        Some(self.values.len())
    }
}

/// A whole number of a type as a value says it.
fn range_of(least: i128, most: i128) -> String {
    match (least, most) {
        (0, most) if most > i128::from(u32::MAX) => "a whole number from 0".to_owned(),
        (0, most) => format!("a whole number from 0 to {most}"),
        _ => "a whole number".to_owned(),
    }
}

/// Reads a whole number of each type that has one.
macro_rules! whole_numbers {
    ($read:ident: $($method:ident $visit:ident $type:ty;)*) => {$(
        fn $method<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Refusal> {
            match self.$read().and_then(|number| <$type>::try_from(number).ok()) {
                Some(number) => visitor.$visit(number),
                None => Err(self.not(&range_of(<$type>::MIN.into(), <$type>::MAX.into()))),
            }
        }
    )*};
}

/// A value of JSON.
#[derive(Clone, Copy)]
struct Json<'de>(&'de Value);

impl<'de> Json<'de> {
    fn not(self, expected: &str) -> Refusal {
        Refusal::expected(expected, self.0)
    }

    fn whole(self) -> Option<i128> {
        match self.0 {
            Value::Number(number) => match number.as_i64() {
                Some(number) => Some(number.into()),
                None => number.as_u64().map(i128::from),
            },
            _ => None,
        }
    }

    fn list<V: Visitor<'de>>(values: &'de [Value], visitor: V) -> Result<V::Value, Refusal> {
        let values = values.iter().enumerate();
        visitor.visit_seq(Places { values })
    }

    fn object<V: Visitor<'de>>(
        fields: &'de serde_json::Map<String, Value>,
        visitor: V,
    ) -> Result<V::Value, Refusal> {
        visitor.visit_map(Fields {
            inner: fields
                .iter()
                .map(|(name, value)| (name.as_str(), Json(value))),
            value: None,
        })
    }
}

impl<'de> IntoDeserializer<'de, Refusal> for Json<'de> {
    type Deserializer = Self;

    fn into_deserializer(self) -> Self {
        self
    }
}

impl<'de> Deserializer<'de> for Json<'de> {
    type Error = Refusal;

    fn deserialize_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Refusal> {
        match self.0 {
            Value::Null => visitor.visit_unit(),
            Value::Bool(value) => visitor.visit_bool(*value),
            Value::Number(number) => match (number.as_u64(), number.as_i64()) {
                (Some(value), _) => visitor.visit_u64(value),
                (None, Some(value)) => visitor.visit_i64(value),
                (None, None) => visitor.visit_f64(number.as_f64().unwrap_or(f64::NAN)),
            },
            Value::String(text) => visitor.visit_borrowed_str(text),
            Value::Array(values) => Json::list(values, visitor),
            Value::Object(fields) => Json::object(fields, visitor),
        }
    }

    whole_numbers! { whole:
        deserialize_u8 visit_u8 u8;
        deserialize_u16 visit_u16 u16;
        deserialize_u32 visit_u32 u32;
        deserialize_u64 visit_u64 u64;
        deserialize_i8 visit_i8 i8;
        deserialize_i16 visit_i16 i16;
        deserialize_i32 visit_i32 i32;
        deserialize_i64 visit_i64 i64;
    }

    fn deserialize_f64<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Refusal> {
        match self.0.as_f64() {
            Some(number) => visitor.visit_f64(number),
            None => Err(self.not("a number")),
        }
    }

    fn deserialize_f32<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Refusal> {
        self.deserialize_f64(visitor)
    }

    fn deserialize_bool<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Refusal> {
        match self.0 {
            Value::Bool(value) => visitor.visit_bool(*value),
            _ => Err(self.not("true or false")),
        }
    }

    fn deserialize_str<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Refusal> {
        match self.0 {
            Value::String(text) => visitor.visit_borrowed_str(text),
            _ => Err(self.not("a text")),
        }
    }

    fn deserialize_string<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Refusal> {
        self.deserialize_str(visitor)
    }

    fn deserialize_seq<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Refusal> {
        match self.0 {
            Value::Array(values) => Json::list(values, visitor),
            _ => Err(self.not("a list")),
        }
    }

    fn deserialize_tuple<V: Visitor<'de>>(
        self,
        length: usize,
        visitor: V,
    ) -> Result<V::Value, Refusal> {
        match self.0 {
            Value::Array(values) if values.len() == length => Json::list(values, visitor),
            _ => Err(self.not(&format!("a list of {length}"))),
        }
    }

    fn deserialize_map<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Refusal> {
        match self.0 {
            Value::Object(fields) => Json::object(fields, visitor),
            _ => Err(self.not("an object")),
        }
    }

    fn deserialize_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        _: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Refusal> {
        match self.0 {
            Value::Object(fields) => Json::object(fields, visitor),
            Value::Array(_) => Err(Refusal::new(Fault::ListForObject)),
            _ => Err(self.not("an object of named fields")),
        }
    }

    fn deserialize_option<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Refusal> {
        match self.0 {
            Value::Null => visitor.visit_none(),
            _ => visitor.visit_some(self),
        }
    }

    fn deserialize_newtype_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        visitor: V,
    ) -> Result<V::Value, Refusal> {
        visitor.visit_newtype_struct(self)
    }

    fn deserialize_enum<V: Visitor<'de>>(
        self,
        _: &'static str,
        known: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Refusal> {
        match self.0 {
            Value::String(word) => visitor.visit_enum(word.as_str().into_deserializer()),
            // A type with fields names its kind in a field, so no request has an enumeration as an object.
            _ => Err(self.not(&one_of(known))),
        }
    }

    forward_to_deserialize_any! {
        i128 u128 char bytes byte_buf unit unit_struct tuple_struct identifier ignored_any
    }
}

/// A value in a list. Serde reads the first one as the kind of a tagged object, which only an object may be.
struct Element<'a, 'de> {
    value: Json<'de>,
    taken_for_name: &'a Cell<bool>,
}

/// Reads an element as its value is read.
macro_rules! as_its_value {
    ($($method:ident)*) => {$(
        fn $method<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Refusal> {
            self.value.$method(visitor)
        }
    )*};
}

impl<'de> Deserializer<'de> for Element<'_, 'de> {
    type Error = Refusal;

    fn deserialize_identifier<V: Visitor<'de>>(self, _: V) -> Result<V::Value, Refusal> {
        self.taken_for_name.set(true);
        Err(Refusal::new(Fault::ListForObject))
    }

    fn deserialize_tuple<V: Visitor<'de>>(
        self,
        length: usize,
        visitor: V,
    ) -> Result<V::Value, Refusal> {
        self.value.deserialize_tuple(length, visitor)
    }

    fn deserialize_struct<V: Visitor<'de>>(
        self,
        name: &'static str,
        fields: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Refusal> {
        self.value.deserialize_struct(name, fields, visitor)
    }

    fn deserialize_newtype_struct<V: Visitor<'de>>(
        self,
        name: &'static str,
        visitor: V,
    ) -> Result<V::Value, Refusal> {
        self.value.deserialize_newtype_struct(name, visitor)
    }

    fn deserialize_enum<V: Visitor<'de>>(
        self,
        name: &'static str,
        known: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Refusal> {
        self.value.deserialize_enum(name, known, visitor)
    }

    as_its_value! {
        deserialize_any deserialize_u8 deserialize_u16 deserialize_u32 deserialize_u64 deserialize_i8 deserialize_i16
        deserialize_i32 deserialize_i64 deserialize_f32 deserialize_f64 deserialize_bool deserialize_str
        deserialize_string deserialize_seq deserialize_map deserialize_option
    }

    forward_to_deserialize_any! {
        i128 u128 char bytes byte_buf unit unit_struct tuple_struct ignored_any
    }
}

/// A parameter of a query: a text that is read as the type needs it.
#[derive(Clone, Copy)]
struct Text<'de>(&'de str);

impl<'de> Text<'de> {
    fn not(self, expected: &str) -> Refusal {
        let got = short(self.0);
        Refusal::new(Fault::Invalid(format!("expected {expected}, got {got:?}")))
    }

    fn whole(self) -> Option<i128> {
        self.0.parse().ok()
    }
}

impl<'de> Deserializer<'de> for Text<'de> {
    type Error = Refusal;

    fn deserialize_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Refusal> {
        visitor.visit_borrowed_str(self.0)
    }

    whole_numbers! { whole:
        deserialize_u8 visit_u8 u8;
        deserialize_u16 visit_u16 u16;
        deserialize_u32 visit_u32 u32;
        deserialize_u64 visit_u64 u64;
        deserialize_i8 visit_i8 i8;
        deserialize_i16 visit_i16 i16;
        deserialize_i32 visit_i32 i32;
        deserialize_i64 visit_i64 i64;
    }

    fn deserialize_f64<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Refusal> {
        match self.0.parse::<f64>() {
            Ok(number) if number.is_finite() => visitor.visit_f64(number),
            _ => Err(self.not("a number")),
        }
    }

    fn deserialize_bool<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Refusal> {
        match self.0.parse() {
            Ok(value) => visitor.visit_bool(value),
            Err(_) => Err(self.not("true or false")),
        }
    }

    fn deserialize_option<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Refusal> {
        visitor.visit_some(self)
    }

    fn deserialize_newtype_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        visitor: V,
    ) -> Result<V::Value, Refusal> {
        visitor.visit_newtype_struct(self)
    }

    fn deserialize_enum<V: Visitor<'de>>(
        self,
        _: &'static str,
        _: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Refusal> {
        visitor.visit_enum(self.0.into_deserializer())
    }

    forward_to_deserialize_any! {
        i128 u128 f32 char str string bytes byte_buf unit unit_struct seq tuple tuple_struct map struct identifier
        ignored_any
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
