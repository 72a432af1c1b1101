//! Objects of named fields, and nothing else in their place.
//!
//! The form that serde derives for a struct takes a list of its values too: `[10]` for `{"position_deg": 10}`. In a
//! request that is a slip, and it may move something. [`check`] reads a value once more and refuses it. A map takes a
//! name twice, and the last counts: [`read`] refuses that.

use serde::Deserialize;
use serde::de::value::{Error, MapDeserializer, SeqDeserializer};
use serde::de::{
    Deserializer, Error as _, Expected, IntoDeserializer, MapAccess, SeqAccess, Unexpected, Visitor,
};
use serde::forward_to_deserialize_any;
use serde_json::Value;

/// What is wrong with a value, and where.
pub type Refusal = serde_path_to_error::Error<Error>;

/// Reads JSON in which every object has each name once.
///
/// # Errors
/// What is no JSON, and the first object that has a name twice.
pub fn read(json: &[u8]) -> Result<Value, serde_path_to_error::Error<serde_json::Error>> {
    let mut track = serde_path_to_error::Track::new();
    let mut from = serde_json::Deserializer::from_slice(json);
    let tracked = serde_path_to_error::Deserializer::new(&mut from, &mut track);
    let read = Once::deserialize(tracked).and_then(|once| from.end().map(|()| once.0));
    read.map_err(|error| serde_path_to_error::Error::new(track.path(), error))
}

/// A value none of whose objects has a name twice.
struct Once(Value);

impl<'de> Deserialize<'de> for Once {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        from.deserialize_any(OnceVisitor).map(Once)
    }
}

struct OnceVisitor;

impl<'de> Visitor<'de> for OnceVisitor {
    type Value = Value;

    fn expecting(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
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
        while let Some(Once(value)) = values.next_element()? {
            read.push(value);
        }
        Ok(Value::Array(read))
    }

    fn visit_map<A: MapAccess<'de>>(self, mut fields: A) -> Result<Value, A::Error> {
        let mut read = serde_json::Map::new();
        while let Some(name) = fields.next_key::<String>()? {
            if read.contains_key(&name) {
                // In the words of serde.
                return Err(A::Error::custom(format_args!("duplicate field `{name}`")));
            }
            let Once(value) = fields.next_value()?;
            read.insert(name, value);
        }
        Ok(Value::Object(read))
    }
}

/// Refuses a list where `T` has an object of named fields.
///
/// # Errors
/// The first such place.
pub fn check<'de, T: Deserialize<'de>>(value: &'de Value) -> Result<(), Refusal> {
    serde_path_to_error::deserialize::<_, T>(Named(value)).map(drop)
}

/// A value whose objects have names.
#[derive(Clone, Copy)]
struct Named<'de>(&'de Value);

impl<'de> IntoDeserializer<'de, Error> for Named<'de> {
    type Deserializer = Self;

    fn into_deserializer(self) -> Self {
        self
    }
}

impl<'de> Named<'de> {
    fn map(
        fields: &'de serde_json::Map<String, Value>,
    ) -> MapDeserializer<'de, impl Iterator<Item = (&'de str, Named<'de>)>, Error> {
        let fields = fields.iter();
        MapDeserializer::new(fields.map(|(name, value)| (name.as_str(), Named(value))))
    }
}

impl<'de> Deserializer<'de> for Named<'de> {
    type Error = Error;

    fn deserialize_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
        match self.0 {
            Value::Null => visitor.visit_unit(),
            Value::Bool(value) => visitor.visit_bool(*value),
            Value::Number(number) => match (number.as_u64(), number.as_i64()) {
                (Some(value), _) => visitor.visit_u64(value),
                (None, Some(value)) => visitor.visit_i64(value),
                (None, None) => visitor.visit_f64(number.as_f64().unwrap_or(f64::NAN)),
            },
            Value::String(text) => visitor.visit_borrowed_str(text),
            // A kind beside its fields reads as anything, and says what it is only in words.
            Value::Array(_) if said(&visitor).starts_with("internally tagged enum") => {
                Err(Error::invalid_type(Unexpected::Seq, &visitor))
            }
            Value::Array(values) => {
                let mut values = SeqDeserializer::new(values.iter().map(Named));
                let value = visitor.visit_seq(&mut values)?;
                values.end()?;
                Ok(value)
            }
            Value::Object(fields) => {
                let mut fields = Named::map(fields);
                let value = visitor.visit_map(&mut fields)?;
                fields.end()?;
                Ok(value)
            }
        }
    }

    fn deserialize_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        _: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Error> {
        match self.0 {
            Value::Array(_) => Err(Error::invalid_type(Unexpected::Seq, &visitor)),
            _ => self.deserialize_any(visitor),
        }
    }

    fn deserialize_option<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
        match self.0 {
            Value::Null => visitor.visit_none(),
            _ => visitor.visit_some(self),
        }
    }

    fn deserialize_newtype_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        visitor: V,
    ) -> Result<V::Value, Error> {
        visitor.visit_newtype_struct(self)
    }

    fn deserialize_enum<V: Visitor<'de>>(
        self,
        _: &'static str,
        _: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Error> {
        match self.0 {
            Value::String(word) => visitor.visit_enum(word.as_str().into_deserializer()),
            // All that have fields say what they are beside these.
            Value::Object(_) => Err(Error::invalid_type(Unexpected::Map, &visitor)),
            _ => self.deserialize_any(visitor),
        }
    }

    forward_to_deserialize_any! {
        bool i8 i16 i32 i64 i128 u8 u16 u32 u64 u128 f32 f64 char str string
        bytes byte_buf unit unit_struct seq tuple
        tuple_struct map identifier ignored_any
    }
}

fn said(visitor: &dyn Expected) -> String {
    visitor.to_string()
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[derive(Deserialize)]
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
        by_name: std::collections::BTreeMap<String, Inner>,
        #[serde(default)]
        pair: Option<(u32, [f64; 2])>,
    }

    #[derive(Deserialize)]
    #[expect(dead_code, reason = "only its form is asked for")]
    struct Inner {
        a: f64,
    }

    #[derive(Deserialize)]
    #[serde(tag = "kind", rename_all = "lowercase")]
    #[expect(dead_code, reason = "only its form is asked for")]
    enum Kind {
        One { n: f64 },
    }

    #[derive(Deserialize)]
    #[serde(untagged)]
    #[expect(dead_code, reason = "only its form is asked for")]
    enum Values {
        List(Vec<f64>),
        Grid(Inner),
    }

    #[derive(Deserialize, Default)]
    #[serde(rename_all = "kebab-case")]
    enum Word {
        #[default]
        First,
        SecondOne,
    }

    #[test]
    fn what_has_names_passes() {
        let whole = json!({
            "number": 1.5, "inner": {"a": -1}, "kind": {"kind": "one", "n": 2}, "values": [1, 2.5], "word": "second-one",
            "by_name": {"x": {"a": 1}}, "pair": [1, [2, 3.5]],
        });
        check::<Outer>(&whole).unwrap();
        check::<Outer>(&json!({"number": null, "values": {"a": 1}})).unwrap();
    }

    #[test]
    fn a_name_is_said_once() {
        let text = br#"{"a": {"x": [1, -2, 2.5, "w", null, true]}, "b": {"x": {}}}"#;
        let plain: Value = serde_json::from_slice(text).unwrap();
        assert_eq!(read(text).unwrap(), plain);
        for (text, place) in [
            (r#"{"a": 1, "b": 2, "a": 1}"#, "."),
            (r#"{"a": [{"b": {"c": 1, "c": 2}}]}"#, "a[0].b"),
        ] {
            let refusal = read(text.as_bytes()).unwrap_err();
            assert_eq!(refusal.path().to_string(), place, "{refusal}");
            let words = crate::wording::refusals::plain(&refusal.into_inner().to_string());
            assert!(words.ends_with("is named twice"), "{words}");
        }
        for text in ["", "{", "[1] 2", "{\"a\": NaN}", "1e999"] {
            let refusal = read(text.as_bytes()).unwrap_err().into_inner();
            assert!(!refusal.is_data(), "{text}: {refusal}");
        }
    }

    #[test]
    fn a_word_has_nothing_beside_it() {
        let refusal = check::<Outer>(&json!({"word": {"first": null}})).unwrap_err();
        assert_eq!(refusal.path().to_string(), "word", "{refusal}");
        let words = crate::wording::refusals::plain(&refusal.into_inner().to_string());
        assert_eq!(words, "an object stands where a word is expected");
    }

    #[test]
    fn a_list_in_the_place_of_names_is_refused_wherever_it_stands() {
        for (value, place) in [
            (json!([1.5]), "."),
            (json!({"number": 1, "inner": [1]}), "inner"),
            (json!({"number": 1, "kind": ["one", 1]}), "kind"),
            (json!({"number": 1, "by_name": {"x": [1]}}), "by_name.x"),
        ] {
            let refusal = check::<Outer>(&value).unwrap_err();
            assert_eq!(refusal.path().to_string(), place, "{refusal}");
            let words = crate::wording::refusals::plain(&refusal.into_inner().to_string());
            assert_eq!(
                words,
                "a list stands where an object of named fields is expected"
            );
        }
    }
}
