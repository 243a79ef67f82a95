//! Writes down what a type asks of its deserializer: field names, order, types, lengths.

use serde::de::{self, DeserializeOwned, DeserializeSeed, SeqAccess, Visitor};

/// `{name:type,…}` with nested types written out, `[T;N]` for arrays, `[T]` for sequences.
pub fn layout<T: DeserializeOwned>() -> String {
    let mut text = String::new();
    let asked = T::deserialize(Recorder(&mut text));
    assert!(asked.is_ok(), "{text}");
    text
}

struct Recorder<'a>(&'a mut String);

type Error = de::value::Error;

macro_rules! record {
    ($($method:ident $visit:ident $name:literal $value:expr;)*) => {$(
        fn $method<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
            self.0.push_str($name);
            visitor.$visit($value)
        }
    )*};
}

impl<'de> de::Deserializer<'de> for Recorder<'_> {
    type Error = Error;

    record! {
        deserialize_bool visit_bool "bool" false;
        deserialize_i8 visit_i8 "i8" 0;
        deserialize_i16 visit_i16 "i16" 0;
        deserialize_i32 visit_i32 "i32" 0;
        deserialize_i64 visit_i64 "i64" 0;
        deserialize_u8 visit_u8 "u8" 0;
        deserialize_u16 visit_u16 "u16" 0;
        deserialize_u32 visit_u32 "u32" 0;
        deserialize_u64 visit_u64 "u64" 0;
        deserialize_f32 visit_f32 "f32" 0.0;
        deserialize_f64 visit_f64 "f64" 0.0;
        deserialize_str visit_str "string" "";
        deserialize_string visit_str "string" "";
    }

    fn deserialize_any<V: Visitor<'de>>(self, _: V) -> Result<V::Value, Error> {
        Err(de::Error::custom("a type that no interface file has"))
    }

    fn deserialize_seq<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
        self.0.push('[');
        let mut element = String::new();
        let value = visitor.visit_seq(Elements { text: &mut element, len: 1, next: 0 })?;
        self.0.push_str(&format!("{element}]"));
        Ok(value)
    }

    fn deserialize_tuple<V: Visitor<'de>>(self, len: usize, visitor: V) -> Result<V::Value, Error> {
        self.0.push('[');
        let mut first = String::new();
        let value = visitor.visit_seq(Elements { text: &mut first, len, next: 0 })?;
        self.0.push_str(&format!("{first};{len}]"));
        Ok(value)
    }

    fn deserialize_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        fields: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Error> {
        self.0.push('{');
        let value = visitor.visit_seq(Fields { text: self.0, fields, next: 0 })?;
        self.0.push('}');
        Ok(value)
    }

    serde::forward_to_deserialize_any! {
        i128 u128 char bytes byte_buf option unit unit_struct newtype_struct tuple_struct map enum identifier
        ignored_any
    }
}

/// Elements of an array or a sequence; the first one is written down.
struct Elements<'a> {
    text: &'a mut String,
    len: usize,
    next: usize,
}

impl<'de> SeqAccess<'de> for Elements<'_> {
    type Error = Error;

    fn next_element_seed<S: DeserializeSeed<'de>>(&mut self, seed: S) -> Result<Option<S::Value>, Error> {
        if self.next == self.len {
            return Ok(None);
        }
        self.next += 1;
        let mut unwritten = String::new();
        let text = if self.next == 1 { &mut *self.text } else { &mut unwritten };
        seed.deserialize(Recorder(text)).map(Some)
    }
}

struct Fields<'a> {
    text: &'a mut String,
    fields: &'static [&'static str],
    next: usize,
}

impl<'de> SeqAccess<'de> for Fields<'_> {
    type Error = Error;

    fn next_element_seed<S: DeserializeSeed<'de>>(&mut self, seed: S) -> Result<Option<S::Value>, Error> {
        let Some(name) = self.fields.get(self.next) else { return Ok(None) };
        if self.next > 0 {
            self.text.push(',');
        }
        self.next += 1;
        self.text.push_str(name);
        self.text.push(':');
        seed.deserialize(Recorder(self.text)).map(Some)
    }
}
