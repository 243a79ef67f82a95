//! Random messages of any type: a serde deserializer that invents what it is asked for.

use serde::de::{self, DeserializeOwned, DeserializeSeed, SeqAccess, Visitor};

use super::mutate::Random;

/// Deepest nesting of sequences and structs that is filled.
const DEPTH: u32 = 12;

/// A message whose sequences have a few elements and whose numbers are small, sensible or extreme.
pub fn random_message<T: DeserializeOwned>(random: &mut Random) -> Option<T> {
    T::deserialize(&mut Inventor { random, depth: 0 }).ok()
}

struct Inventor<'a> {
    random: &'a mut Random,
    depth: u32,
}

impl Inventor<'_> {
    fn integer(&mut self) -> u64 {
        match self.random.below(8) {
            0 => self.random.bits(),
            1 => u64::MAX,
            _ => self.random.below(4) as u64,
        }
    }

    fn number(&mut self) -> f64 {
        const NUMBERS: [f64; 8] = [0.0, 1.0, -1.0, 0.05, 1e-3, 1e308, f64::NAN, f64::INFINITY];
        match self.random.below(4) {
            0 => self.random.pick(&NUMBERS).copied().unwrap_or_default(),
            _ => self.random.below(2001) as f64 / 1000.0 - 1.0,
        }
    }

    fn text(&mut self) -> String {
        const TEXTS: [&str; 6] =
            ["", "workpiece", "0123456789abcdef", "x", "a text of several words é", "../../etc"];
        self.random.pick(&TEXTS).copied().unwrap_or_default().to_owned()
    }

    fn list<'de, V: Visitor<'de>>(&mut self, length: usize, visitor: V) -> Result<V::Value, Impossible> {
        let random = &mut *self.random;
        visitor.visit_seq(List { inventor: Inventor { random, depth: self.depth + 1 }, left: length })
    }
}

struct List<'a> {
    inventor: Inventor<'a>,
    left: usize,
}

impl<'de> SeqAccess<'de> for List<'_> {
    type Error = Impossible;

    fn next_element_seed<S: DeserializeSeed<'de>>(
        &mut self,
        seed: S,
    ) -> Result<Option<S::Value>, Impossible> {
        if self.left == 0 {
            return Ok(None);
        }
        self.left -= 1;
        seed.deserialize(&mut self.inventor).map(Some)
    }
}

/// What no type of a message asks for.
#[derive(Debug)]
struct Impossible;

impl std::fmt::Display for Impossible {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("no message has such a field")
    }
}

impl std::error::Error for Impossible {}

impl de::Error for Impossible {
    fn custom<T: std::fmt::Display>(_: T) -> Self {
        Self
    }
}

macro_rules! invented {
    ($($method:ident => $visit:ident($value:expr);)*) => {
        $(fn $method<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Impossible> {
            let value = $value(self);
            visitor.$visit(value)
        })*
    };
}

impl<'de> de::Deserializer<'de> for &mut Inventor<'_> {
    type Error = Impossible;

    invented! {
        deserialize_bool => visit_bool(|s: &mut Inventor<'_>| s.random.below(2) == 1);
        deserialize_i8 => visit_i8(|s: &mut Inventor<'_>| s.integer() as i8);
        deserialize_i16 => visit_i16(|s: &mut Inventor<'_>| s.integer() as i16);
        deserialize_i32 => visit_i32(|s: &mut Inventor<'_>| s.integer() as i32);
        deserialize_i64 => visit_i64(|s: &mut Inventor<'_>| s.integer() as i64);
        deserialize_u8 => visit_u8(|s: &mut Inventor<'_>| s.integer() as u8);
        deserialize_u16 => visit_u16(|s: &mut Inventor<'_>| s.integer() as u16);
        deserialize_u32 => visit_u32(|s: &mut Inventor<'_>| s.integer() as u32);
        deserialize_u64 => visit_u64(|s: &mut Inventor<'_>| s.integer());
        deserialize_f32 => visit_f32(|s: &mut Inventor<'_>| s.number() as f32);
        deserialize_f64 => visit_f64(|s: &mut Inventor<'_>| s.number());
        deserialize_str => visit_string(|s: &mut Inventor<'_>| s.text());
        deserialize_string => visit_string(|s: &mut Inventor<'_>| s.text());
    }

    fn deserialize_seq<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Impossible> {
        let length = if self.depth < DEPTH { self.random.below(5) } else { 0 };
        self.list(length, visitor)
    }

    fn deserialize_tuple<V: Visitor<'de>>(self, length: usize, visitor: V) -> Result<V::Value, Impossible> {
        self.list(length, visitor)
    }

    fn deserialize_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        fields: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Impossible> {
        self.list(fields.len(), visitor)
    }

    fn deserialize_any<V: Visitor<'de>>(self, _: V) -> Result<V::Value, Impossible> {
        Err(Impossible)
    }

    serde::forward_to_deserialize_any! {
        i128 u128 char bytes byte_buf option unit unit_struct newtype_struct tuple_struct map enum identifier ignored_any
    }
}
