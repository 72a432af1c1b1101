//! Values and parameters as serde reads them, each refused by its name or place.

use std::cell::Cell;

use serde::de::value::MapDeserializer;
use serde::de::{DeserializeSeed, Deserializer, IntoDeserializer, MapAccess, SeqAccess, Visitor};
use serde::forward_to_deserialize_any;

use super::refusal::{Fault, Refusal, Step, one_of, short};
use super::stated;

/// Names and values, each value refused by its name.
pub(super) struct Fields<'de, I, D> {
    inner: I,
    value: Option<(&'de str, D)>,
}

impl<'de, I, D> Fields<'de, I, D> {
    pub(super) fn new(inner: I) -> Self {
        Fields { inner, value: None }
    }
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

/// A value of a text format.
pub(super) trait Value<'de>: Copy {
    /// The word for names with their values.
    const SECTION: &'static str;
    type List: ExactSizeIterator<Item = Self>;
    type Section: Iterator<Item = (&'de String, Self)>;

    /// Returns what the value is.
    fn form(self) -> Form<'de, Self>;
}

/// What a value is.
pub(super) enum Form<'de, V: Value<'de>> {
    Null,
    Truth(bool),
    Whole(i128),
    Number(f64),
    Text(&'de str),
    /// A time of TOML.
    Time(String),
    List(V::List),
    Section(V::Section),
}

/// The field under which the crate `toml` passes a time to its own types.
const TIME_FIELD: &str = "$__toml_private_datetime";

/// The values of a list, each refused by its place.
struct Places<L> {
    values: std::iter::Enumerate<L>,
}

impl<'de, V: Value<'de>, L: ExactSizeIterator<Item = V>> SeqAccess<'de> for Places<L> {
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
            value: Read(value),
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

/// Reads a whole number of each type that has one, by the deserializer's method `whole`.
macro_rules! whole_numbers {
    () => {
        whole_numbers! {
            deserialize_u8 visit_u8 u8;
            deserialize_u16 visit_u16 u16;
            deserialize_u32 visit_u32 u32;
            deserialize_u64 visit_u64 u64;
            deserialize_i8 visit_i8 i8;
            deserialize_i16 visit_i16 i16;
            deserialize_i32 visit_i32 i32;
            deserialize_i64 visit_i64 i64;
        }
    };
    ($($method:ident $visit:ident $type:ty;)*) => {$(
        fn $method<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Refusal> {
            match self.whole().and_then(|number| <$type>::try_from(number).ok()) {
                Some(number) => visitor.$visit(number),
                None => Err(self.not(&range_of(<$type>::MIN.into(), <$type>::MAX.into()))),
            }
        }
    )*};
}

/// Reads a value of any format.
#[derive(Clone, Copy)]
pub(super) struct Read<V>(pub(super) V);

impl<'de, V: Value<'de>> Read<V> {
    fn not(self, expected: &str) -> Refusal {
        let got = match self.0.form() {
            Form::Null => "null".to_owned(),
            Form::Truth(value) => value.to_string(),
            Form::Whole(number) => number.to_string(),
            Form::Number(number) => stated(number),
            Form::Text(text) => format!("{:?}", short(text)),
            Form::Time(time) => time,
            Form::List(values) => format!("a list of {}", values.len()),
            Form::Section(_) => V::SECTION.to_owned(),
        };
        Refusal::new(Fault::Invalid(format!("expected {expected}, got {got}")))
    }

    fn whole(self) -> Option<i128> {
        match self.0.form() {
            Form::Whole(number) => Some(number),
            _ => None,
        }
    }
}

fn list<'de, V: Value<'de>, T: Visitor<'de>>(
    values: V::List,
    visitor: T,
) -> Result<T::Value, Refusal> {
    let values = values.enumerate();
    visitor.visit_seq(Places { values })
}

fn section<'de, V: Value<'de>, T: Visitor<'de>>(
    values: V::Section,
    visitor: T,
) -> Result<T::Value, Refusal> {
    visitor.visit_map(Fields::new(
        values.map(|(name, value)| (name.as_str(), Read(value))),
    ))
}

impl<'de, V: Value<'de>> IntoDeserializer<'de, Refusal> for Read<V> {
    type Deserializer = Self;

    fn into_deserializer(self) -> Self {
        self
    }
}

impl<'de, F: Value<'de>> Deserializer<'de> for Read<F> {
    type Error = Refusal;

    fn deserialize_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Refusal> {
        match self.0.form() {
            Form::Null => visitor.visit_unit(),
            Form::Truth(value) => visitor.visit_bool(value),
            Form::Whole(number) => match (u64::try_from(number), i64::try_from(number)) {
                (Ok(number), _) => visitor.visit_u64(number),
                (_, Ok(number)) => visitor.visit_i64(number),
                _ => visitor.visit_i128(number),
            },
            Form::Number(number) => visitor.visit_f64(number),
            Form::Text(text) => visitor.visit_borrowed_str(text),
            Form::Time(time) => {
                visitor.visit_map(MapDeserializer::new(std::iter::once((TIME_FIELD, time))))
            }
            Form::List(values) => list::<F, V>(values, visitor),
            Form::Section(values) => section::<F, V>(values, visitor),
        }
    }

    whole_numbers! {}

    fn deserialize_f64<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Refusal> {
        match self.0.form() {
            Form::Number(number) => visitor.visit_f64(number),
            #[expect(
                clippy::cast_precision_loss,
                reason = "a number is as near as a float can be"
            )]
            Form::Whole(number) => visitor.visit_f64(number as f64),
            _ => Err(self.not("a number")),
        }
    }

    fn deserialize_f32<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Refusal> {
        self.deserialize_f64(visitor)
    }

    fn deserialize_bool<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Refusal> {
        match self.0.form() {
            Form::Truth(value) => visitor.visit_bool(value),
            _ => Err(self.not("true or false")),
        }
    }

    fn deserialize_str<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Refusal> {
        match self.0.form() {
            Form::Text(text) => visitor.visit_borrowed_str(text),
            _ => Err(self.not("a text")),
        }
    }

    fn deserialize_string<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Refusal> {
        self.deserialize_str(visitor)
    }

    fn deserialize_seq<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Refusal> {
        match self.0.form() {
            Form::List(values) => list::<F, V>(values, visitor),
            _ => Err(self.not("a list")),
        }
    }

    fn deserialize_tuple<V: Visitor<'de>>(
        self,
        length: usize,
        visitor: V,
    ) -> Result<V::Value, Refusal> {
        match self.0.form() {
            Form::List(values) if values.len() == length => list::<F, V>(values, visitor),
            _ => Err(self.not(&format!("a list of {length}"))),
        }
    }

    fn deserialize_map<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Refusal> {
        match self.0.form() {
            Form::Section(values) => section::<F, V>(values, visitor),
            _ => Err(self.not(F::SECTION)),
        }
    }

    fn deserialize_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        _: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Refusal> {
        match self.0.form() {
            // The crate `toml` reads a time as a struct.
            Form::Time(_) => self.deserialize_any(visitor),
            Form::List(_) => Err(Refusal::new(Fault::ListForObject)),
            _ => self.deserialize_map(visitor),
        }
    }

    fn deserialize_option<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Refusal> {
        match self.0.form() {
            Form::Null => visitor.visit_none(),
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
        match self.0.form() {
            Form::Text(word) => visitor.visit_enum(word.into_deserializer()),
            // A type with fields names its kind in a field, so no enumeration is written with names of its own.
            _ => Err(self.not(&one_of(known))),
        }
    }

    forward_to_deserialize_any! {
        i128 u128 char bytes byte_buf unit unit_struct tuple_struct identifier ignored_any
    }
}

/// A value in a list. Serde reads the first one as the kind of a tagged object, which only an object may be.
struct Element<'a, F> {
    value: Read<F>,
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

impl<'de, F: Value<'de>> Deserializer<'de> for Element<'_, F> {
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
pub(super) struct Text<'de>(pub(super) &'de str);

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

    whole_numbers! {}

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
