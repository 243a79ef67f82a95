//! Numbers for the page's script: typed arrays, one after the other, deflated, in base64.

use std::io::Write;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use flate2::Compression;
use flate2::write::GzEncoder;
use serde::Serialize;

/// Every array begins at a multiple of this, as typed arrays have to.
const ALIGNMENT: usize = 4;

/// Where an array lies in the bytes.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Place {
    /// Name in the script.
    pub name: &'static str,
    /// `u8`, `u16`, `i16`, `u32` or `f32`.
    pub kind: &'static str,
    /// First byte.
    pub at: usize,
    /// Number of entries.
    pub count: usize,
}

/// Arrays in the making.
#[derive(Clone, Debug, Default)]
pub struct Blob {
    places: Vec<Place>,
    bytes: Vec<u8>,
}

/// A number that arrays are made of.
pub trait Number: Copy {
    /// Name of its kind.
    const KIND: &'static str;
    /// Little-endian bytes.
    fn push(self, bytes: &mut Vec<u8>);
}

macro_rules! numbers {
    ($($type:ty),*) => {$(
        impl Number for $type {
            const KIND: &'static str = stringify!($type);
            fn push(self, bytes: &mut Vec<u8>) {
                bytes.extend(self.to_le_bytes());
            }
        }
    )*};
}
numbers!(u8, u16, i16, u32, f32);

impl Blob {
    /// Adds an array.
    pub fn add<N: Number>(&mut self, name: &'static str, numbers: impl IntoIterator<Item = N>) {
        self.bytes.resize(self.bytes.len().next_multiple_of(ALIGNMENT), 0);
        let (at, mut count) = (self.bytes.len(), 0);
        for number in numbers {
            number.push(&mut self.bytes);
            count += 1;
        }
        self.places.push(Place { name, kind: N::KIND, at, count });
    }

    /// Where the arrays lie, and all bytes as base64 of their gzip.
    pub fn finish(self) -> (Vec<Place>, String) {
        let mut encoder = GzEncoder::new(Vec::new(), Compression::fast());
        // Writing into memory cannot fail.
        let _ = encoder.write_all(&self.bytes);
        (self.places, STANDARD.encode(encoder.finish().unwrap_or_default()))
    }
}

/// A number as a whole one of `i16`, in steps of `step`; what is no number or beyond the ends is at an end.
pub fn stepped(value: f64, step: f64) -> i16 {
    // A float cast saturates.
    (value / step).round() as i16
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Read;

    #[test]
    fn arrays_come_back_from_their_places() {
        let mut blob = Blob::default();
        blob.add("small", [1u8, 2, 3]);
        blob.add("numbers", [1.5f32, -2.0]);
        blob.add("none", Vec::<u32>::new());
        blob.add("whole", [-7i16]);
        let (places, text) = blob.finish();
        let mut bytes = Vec::new();
        flate2::read::GzDecoder::new(STANDARD.decode(text).unwrap().as_slice())
            .read_to_end(&mut bytes)
            .unwrap();
        let at = |name: &str| places.iter().find(|p| p.name == name).unwrap();
        assert_eq!((at("numbers").at, at("numbers").count, at("numbers").kind), (4, 2, "f32"));
        assert_eq!(bytes[8..12], (-2f32).to_le_bytes());
        assert_eq!((at("none").count, at("whole").at, at("whole").kind), (0, 12, "i16"));
        assert_eq!(bytes[12..14], (-7i16).to_le_bytes());
    }

    #[test]
    fn steps_end_where_the_numbers_end() {
        assert_eq!([stepped(1.26, 0.5), stepped(-1e9, 1.0), stepped(1e9, 1.0)], [3, i16::MIN, i16::MAX]);
    }
}
