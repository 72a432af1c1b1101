//! Objects of named fields, and nothing else in their place.
//!
//! The form that serde derives for a struct takes a list of its values too: `[10]` for `{"position_deg": 10}`. In a
//! request that is a slip, and it may move something. [`check`] reads a value once more and refuses it.

use serde::Deserialize;
use serde::de::value::{Error, MapAccessDeserializer, MapDeserializer, SeqDeserializer};
use serde::de::{Deserializer, Error as _, Expected, IntoDeserializer, Unexpected, Visitor};
use serde::forward_to_deserialize_any;
use serde_json::Value;

/// What is wrong with a value, and where.
pub type Refusal = serde_path_to_error::Error<Error>;

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
            Value::Object(fields) => {
                visitor.visit_enum(MapAccessDeserializer::new(Named::map(fields)))
            }
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
