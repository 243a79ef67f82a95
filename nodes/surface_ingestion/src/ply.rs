//! PLY, ASCII and binary of both byte orders: a mesh, or the points of a scan where there are no faces.
//!
//! Of the vertices x, y and z are read, of the faces the list `vertex_indices` (or `vertex_index`); all other properties and
//! elements are passed over.

use nalgebra::Point3;

use crate::polygon::{CORNERS_MAX, triangulate};
use crate::raw::{Limits, Raw, RawCloud, RawMesh};
use crate::scalar::Scalar;
use crate::text::{any_number, integer, shown, words};

/// How a file starts.
pub const MAGIC: [&[u8]; 2] = [b"ply\n", b"ply\r"];

/// The mesh or the points of `bytes`; polygons are cut into triangles.
///
/// # Errors
/// Naming the line or byte: a bad header, less data than the header states, a coordinate that is not finite, a face with less
/// than three corners or with one that does not exist; no vertices; more than `limits` allows.
pub fn parse(bytes: &[u8], limits: &Limits) -> Result<Raw, String> {
    let header = Header::parse(bytes)?;
    let body = &bytes[header.length..];
    match header.format {
        Format::Ascii => read(&header, Text { rest: body, line: header.lines }, limits),
        Format::Binary { big_endian } => {
            read(&header, Binary { bytes, at: header.length, big_endian }, limits)
        }
    }
}

#[derive(Clone, Copy)]
enum Format {
    Ascii,
    Binary { big_endian: bool },
}

#[derive(Clone, Copy)]
enum Kind {
    Scalar(Scalar),
    List { count: Scalar, item: Scalar },
}

struct Property {
    name: String,
    kind: Kind,
}

struct Element {
    name: String,
    count: usize,
    properties: Vec<Property>,
}

struct Header {
    format: Format,
    elements: Vec<Element>,
    /// Bytes and lines of the header.
    length: usize,
    lines: usize,
}

impl Header {
    fn parse(bytes: &[u8]) -> Result<Self, String> {
        if !MAGIC.iter().any(|magic| bytes.starts_with(magic)) {
            return Err("not a PLY: its first line is not \"ply\"".to_owned());
        }
        let (mut format, mut elements) = (None, Vec::<Element>::new());
        let (mut length, mut lines) = (0, 0);
        for line in bytes.split_inclusive(|b| *b == b'\n') {
            length += line.len();
            lines += 1;
            let words: Vec<&[u8]> = words(line).take(6).collect();
            let bad = || {
                format!("line {lines} of the PLY header, \"{}\", is not understood", shown(line.trim_ascii()))
            };
            match words.as_slice() {
                [b"ply"] if lines == 1 => {}
                [] | [b"comment" | b"obj_info", ..] => {}
                [b"format", name, b"1.0"] => {
                    format = Some(match *name {
                        b"ascii" => Format::Ascii,
                        b"binary_little_endian" => Format::Binary { big_endian: false },
                        b"binary_big_endian" => Format::Binary { big_endian: true },
                        _ => return Err(bad()),
                    });
                }
                [b"element", name, count] => elements.push(Element {
                    name: shown(name),
                    count: integer(count).ok_or_else(bad)?,
                    properties: Vec::new(),
                }),
                [b"property", rest @ ..] => {
                    let (kind, name) = match rest {
                        [b"list", count, item, name] => {
                            let [count, item] = [count, item].map(|w| scalar(w));
                            (Kind::List { count: count.ok_or_else(bad)?, item: item.ok_or_else(bad)? }, name)
                        }
                        [item, name] => (Kind::Scalar(scalar(item).ok_or_else(bad)?), name),
                        _ => return Err(bad()),
                    };
                    let element = elements.last_mut().ok_or_else(bad)?;
                    element.properties.push(Property { name: shown(name), kind });
                }
                [b"end_header"] if line.ends_with(b"\n") => {
                    let format = format.ok_or("the PLY header names no format")?;
                    return Ok(Self { format, elements, length, lines });
                }
                _ => return Err(bad()),
            }
        }
        Err(format!("the PLY is truncated: its header ends after {lines} lines without \"end_header\""))
    }

    fn count(&self, name: &str) -> usize {
        self.elements.iter().filter(|e| e.name == name).map(|e| e.count).max().unwrap_or(0)
    }
}

fn scalar(word: &[u8]) -> Option<Scalar> {
    Some(match word {
        b"char" | b"int8" => Scalar::I8,
        b"uchar" | b"uint8" => Scalar::U8,
        b"short" | b"int16" => Scalar::I16,
        b"ushort" | b"uint16" => Scalar::U16,
        b"int" | b"int32" => Scalar::I32,
        b"uint" | b"uint32" => Scalar::U32,
        b"float" | b"float32" => Scalar::F32,
        b"double" | b"float64" => Scalar::F64,
        _ => return None,
    })
}

/// The numbers after the header, one after the other.
trait Numbers {
    /// The next number, none at the end of the file or where a word is no number.
    fn next(&mut self, scalar: Scalar) -> Option<f64>;
    /// What stands where the last number was read, for an error message.
    fn place(&self) -> String;
    /// Bytes of a number of that type at least.
    fn least_size(scalar: Scalar) -> usize;
    /// Bytes left.
    fn left(&self) -> usize;
}

struct Text<'a> {
    rest: &'a [u8],
    line: usize,
}

impl Numbers for Text<'_> {
    fn next(&mut self, _: Scalar) -> Option<f64> {
        let start = self.rest.iter().position(|b| !b.is_ascii_whitespace())?;
        self.line += self.rest[..start].iter().filter(|b| **b == b'\n').count();
        let word = &self.rest[start..];
        let end = word.iter().position(u8::is_ascii_whitespace).unwrap_or(word.len());
        self.rest = &word[end..];
        any_number(&word[..end])
    }
    fn place(&self) -> String {
        format!("line {}", self.line + 1)
    }
    fn least_size(_: Scalar) -> usize {
        // A digit and what parts it from the next.
        2
    }
    fn left(&self) -> usize {
        // The last digit of the file may stand alone.
        self.rest.len() + 1
    }
}

struct Binary<'a> {
    bytes: &'a [u8],
    at: usize,
    big_endian: bool,
}

impl Numbers for Binary<'_> {
    #[inline]
    fn next(&mut self, scalar: Scalar) -> Option<f64> {
        let number = scalar.read(&self.bytes[self.at..], self.big_endian)?;
        self.at += scalar.size();
        Some(number)
    }
    fn place(&self) -> String {
        format!("byte {}", self.at)
    }
    fn least_size(scalar: Scalar) -> usize {
        scalar.size()
    }
    fn left(&self) -> usize {
        self.bytes.len() - self.at
    }
}

fn read<N: Numbers>(header: &Header, mut numbers: N, limits: &Limits) -> Result<Raw, String> {
    let faces = header.count("face");
    if faces == 0 && header.count("tristrips") > 0 {
        return Err("the PLY has triangle strips; faces with their vertices were expected".to_owned());
    }
    let (mut vertices, mut triangles) = (Vec::new(), Vec::new());
    for element in &header.elements {
        let least: usize = element.properties.iter().map(|p| least_size::<N>(p.kind)).sum();
        if element.count.saturating_mul(least) > numbers.left() {
            return Err(format!(
                "the PLY is truncated: its header states {} of \"{}\", {least} bytes each at least; {} bytes are left",
                element.count,
                element.name,
                numbers.left()
            ));
        }
        match element.name.as_str() {
            "vertex" if faces == 0 => {
                limits.check_points(element.count, "PLY")?;
                vertices = read_vertices(element, &mut numbers)?;
            }
            "vertex" => {
                limits.check_vertices(element.count, "PLY")?;
                vertices = read_vertices(element, &mut numbers)?;
            }
            "face" => {
                limits.check_triangles(element.count, "PLY")?;
                triangles = read_faces(element, &mut numbers, &vertices, limits)?;
            }
            _ if least == 0 => {}
            _ => (0..element.count).try_for_each(|i| {
                element
                    .properties
                    .iter()
                    .try_for_each(|p| skip(&mut numbers, p.kind))
                    .ok_or_else(|| broken(&numbers, element, i))
            })?,
        }
    }
    if vertices.is_empty() {
        return Err("the PLY has no vertices; a mesh or the points of a scan were expected".to_owned());
    }
    Ok(if faces == 0 {
        Raw::Cloud(RawCloud { points: vertices, no_return: 0 })
    } else {
        Raw::Mesh(RawMesh { vertices, triangles })
    })
}

fn least_size<N: Numbers>(kind: Kind) -> usize {
    match kind {
        Kind::Scalar(scalar) => N::least_size(scalar),
        Kind::List { count, .. } => N::least_size(count),
    }
}

fn broken<N: Numbers>(numbers: &N, element: &Element, i: usize) -> String {
    format!(
        "{} of the PLY: {} {} of {} is cut short or no number",
        numbers.place(),
        element.name,
        i + 1,
        element.count
    )
}

fn skip<N: Numbers>(numbers: &mut N, kind: Kind) -> Option<()> {
    match kind {
        Kind::Scalar(scalar) => numbers.next(scalar).map(drop),
        Kind::List { count, item } => {
            let count = length(numbers.next(count)?)?;
            (0..count).try_for_each(|_| numbers.next(item).map(drop))
        }
    }
}

/// A list's length or a vertex's index.
fn length(number: f64) -> Option<usize> {
    (number.fract() == 0.0 && (0.0..=4e9).contains(&number)).then_some(number as usize)
}

fn read_vertices<N: Numbers>(element: &Element, numbers: &mut N) -> Result<Vec<Point3<f64>>, String> {
    let names = ["x", "y", "z"];
    let slots: Vec<Option<usize>> =
        element.properties.iter().map(|p| names.iter().position(|name| *name == p.name)).collect();
    for (k, name) in names.iter().enumerate() {
        let of_name: Vec<_> =
            element.properties.iter().zip(&slots).filter(|(_, slot)| **slot == Some(k)).collect();
        if !matches!(of_name.as_slice(), [(Property { kind: Kind::Scalar(_), .. }, _)]) {
            return Err(format!("the vertices of the PLY have no property \"{name}\", or not as one number"));
        }
    }
    let mut vertices = Vec::with_capacity(element.count);
    for i in 0..element.count {
        let mut point = Point3::origin();
        for (property, slot) in element.properties.iter().zip(&slots) {
            let read = match (property.kind, slot) {
                (Kind::Scalar(scalar), Some(k)) => numbers.next(scalar).map(|x| point[*k] = x),
                (kind, _) => skip(numbers, kind),
            };
            read.ok_or_else(|| broken(numbers, element, i))?;
        }
        if !point.iter().all(|x| x.is_finite()) {
            return Err(format!(
                "{} of the PLY: vertex {} is not finite ({}, {}, {})",
                numbers.place(),
                i + 1,
                point.x,
                point.y,
                point.z
            ));
        }
        vertices.push(point);
    }
    Ok(vertices)
}

fn read_faces<N: Numbers>(
    element: &Element,
    numbers: &mut N,
    vertices: &[Point3<f64>],
    limits: &Limits,
) -> Result<Vec<[u32; 3]>, String> {
    let is_corners = |p: &Property| matches!(p.name.as_str(), "vertex_indices" | "vertex_index");
    if !element.properties.iter().any(|p| is_corners(p) && matches!(p.kind, Kind::List { .. })) {
        return Err("the faces of the PLY have no list \"vertex_indices\" or \"vertex_index\"".to_owned());
    }
    let (mut triangles, mut corners) = (Vec::with_capacity(element.count), Vec::new());
    for i in 0..element.count {
        for property in &element.properties {
            match property.kind {
                Kind::List { count, item } if is_corners(property) => {
                    let count = numbers.next(count).ok_or_else(|| broken(numbers, element, i))?;
                    if !(count.fract() == 0.0 && (3.0..=CORNERS_MAX as f64).contains(&count)) {
                        return Err(format!(
                            "{} of the PLY: face {} has {count} corners; 3 to {CORNERS_MAX} were expected",
                            numbers.place(),
                            i + 1
                        ));
                    }
                    corners.clear();
                    for _ in 0..count as usize {
                        let number = numbers.next(item).ok_or_else(|| broken(numbers, element, i))?;
                        let Some(corner) = length(number).filter(|v| *v < vertices.len()) else {
                            return Err(format!(
                                "{} of the PLY: face {} has the corner {number}; there are {} vertices before it, counted from 0",
                                numbers.place(),
                                i + 1,
                                vertices.len()
                            ));
                        };
                        corners.push(corner as u32);
                    }
                    limits.check_triangles(triangles.len() + corners.len() - 2, "PLY")?;
                    triangulate(&corners, vertices, &mut triangles);
                }
                kind => skip(numbers, kind).ok_or_else(|| broken(numbers, element, i))?,
            }
        }
    }
    Ok(triangles)
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: Limits = Limits { triangles: 4, points: 5 };
    const HEADER: &str = "comment by hand\nelement vertex 4\nproperty float x\nproperty float y\nproperty uchar red\nproperty float z\n\
        element edge 1\nproperty int vertex1\nproperty list uchar short more\n\
        element face 2\nproperty uchar flags\nproperty list uchar int vertex_indices\nend_header\n";

    fn ascii() -> String {
        format!(
            "ply\nformat ascii 1.0\n{HEADER}0 0 255 0\n1 0 255 0.5\n1 1 255 0\n0 1 255 0\n7 2 1 1\n0 3 0 1 2\n1 4 0 1 2 3\n"
        )
    }

    fn binary(big: bool) -> Vec<u8> {
        let name = if big { "big" } else { "little" };
        let mut bytes = format!("ply\r\nformat binary_{name}_endian 1.0\n{HEADER}").into_bytes();
        let mut put = |b: &[u8]| {
            if big { bytes.extend(b.iter().rev()) } else { bytes.extend(b) }
        };
        for [x, y, z] in [[0f32, 0., 0.], [1., 0., 0.5], [1., 1., 0.], [0., 1., 0.]] {
            put(&x.to_le_bytes());
            put(&y.to_le_bytes());
            put(&[255]);
            put(&z.to_le_bytes());
        }
        put(&7i32.to_le_bytes());
        put(&[2]);
        put(&1i16.to_le_bytes());
        put(&1i16.to_le_bytes());
        for corners in [&[0i32, 1, 2][..], &[0, 1, 2, 3]] {
            put(&[0]);
            put(&[corners.len() as u8]);
            corners.iter().for_each(|c| put(&c.to_le_bytes()));
        }
        bytes
    }

    #[test]
    fn all_three_forms_give_the_same_mesh() {
        let expected = RawMesh {
            vertices: [[0., 0., 0.], [1., 0., 0.5], [1., 1., 0.], [0., 1., 0.]].map(Point3::from).to_vec(),
            triangles: vec![[0, 1, 2], [3, 0, 1], [3, 1, 2]],
        };
        for bytes in [ascii().into_bytes(), binary(false), binary(true)] {
            assert_eq!(parse(&bytes, &LIMITS).unwrap(), Raw::Mesh(expected.clone()));
        }
    }

    #[test]
    fn no_faces_make_a_cloud() {
        let cloud = "ply\nformat ascii 1.0\nelement vertex 2\nproperty double x\nproperty double y\nproperty double z\nproperty float nx\n\
                     element face 0\nproperty list uchar int vertex_index\nend_header\n1 2 3 0\n4 5 6 1";
        let expected =
            RawCloud { points: [[1., 2., 3.], [4., 5., 6.]].map(Point3::from).to_vec(), no_return: 0 };
        assert_eq!(parse(cloud.as_bytes(), &LIMITS).unwrap(), Raw::Cloud(expected));
    }

    #[test]
    fn each_bad_file_is_one_clear_error() {
        let good = ascii();
        let little = binary(false);
        let cut = |n: usize| little[..little.len() - n].to_vec();
        let with = |from: &str, to: &str| good.replacen(from, to, 1).into_bytes();
        for (bytes, part) in [
            (Vec::new(), "not a PLY"),
            (b"ply\nformat ascii 1.0\n".to_vec(), "truncated: its header ends after 2 lines"),
            (with("format ascii 1.0\n", ""), "names no format"),
            (with("ascii 1.0", "ascii 2.0"), "line 2 of the PLY header, \"format ascii 2.0\""),
            (with("float x", "half x"), "\"property half x\", is not understood"),
            (with("float x", "float u"), "no property \"x\""),
            (with("float x", "list uchar float x"), "no property \"x\""),
            (with("vertex_indices", "corners"), "no list \"vertex_indices\""),
            (with("vertex 4", "vertex 99999999999999999999999"), "\"element vertex 9999"),
            (with("vertex 4", "vertex 4000000000"), "its header states 4000000000 of \"vertex\""),
            (with("face 2", "face 18446744073709551615"), "truncated"),
            (with("1 0 255 0.5", "1 0 255 nan"), "line 17 of the PLY: vertex 2 is not finite"),
            (with("1 0 255 0.5", "1 0 255 up"), "line 17 of the PLY: vertex 2 of 4"),
            (with("0 3 0 1 2", "0 3 0 1 4"), "line 21 of the PLY: face 1 has the corner 4; there are 4"),
            (with("0 3 0 1 2", "0 3 0 1 -1"), "face 1 has the corner -1"),
            (with("0 3 0 1 2", "0 2 0 1"), "face 1 has 2 corners"),
            (with("1 4 0 1 2 3", "1 4 0 1 2"), "face 2 of 2 is cut short"),
            (with("element face", "element tristrips"), "triangle strips"),
            (cut(1), "face 2 of 2 is cut short"),
            (cut(30), "states 2 of \"face\", 2 bytes each at least"),
            (cut(50), "truncated"),
        ] {
            let error = parse(&bytes, &LIMITS).unwrap_err();
            assert!(error.contains(part), "{part}: {error}");
        }
        let few = Limits { triangles: 2, points: 5 };
        assert!(
            parse(good.as_bytes(), &few)
                .unwrap_err()
                .contains("3 facets, more than the 2 allowed (max_triangles)")
        );
        let few = Limits { triangles: 1, points: 5 };
        assert!(parse(good.as_bytes(), &few).unwrap_err().contains("4 vertices, more than the 3"));
    }
}
