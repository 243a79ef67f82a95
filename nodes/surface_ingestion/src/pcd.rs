//! PCD, the Point Cloud Library's files: ASCII, binary and binary_compressed.

use nalgebra::Point3;

use crate::lzf;
use crate::raw::{Limits, RawCloud};
use crate::scalar::Scalar;
use crate::text::{any_number, integer, lines, shown, words};

/// How most files start.
pub const MAGIC: &[u8] = b"# .PCD";
/// Largest uncompressed content, bytes.
const CONTENT_BYTES_MAX: usize = 512 << 20;

/// The points of `bytes`. Points with a coordinate that is not finite are left out and counted: so the format marks what gave no
/// return.
///
/// # Errors
/// Naming the line or what does not fit: a bad header, fields without x, y and z, less data than stated; no points; more than
/// `limits` allows.
pub fn parse(bytes: &[u8], limits: &Limits) -> Result<RawCloud, String> {
    let header = Header::parse(bytes)?;
    limits.check_points(header.points, "PCD")?;
    let body = &bytes[header.length..];
    let mut cloud = RawCloud::default();
    match header.data {
        Data::Ascii => header.ascii(body, &mut cloud)?,
        Data::Binary => {
            let size = header.points.saturating_mul(header.record_size());
            let data = body.get(..size).ok_or_else(|| truncated(&header, size, body.len()))?;
            header.records(data, false, &mut cloud);
        }
        Data::Compressed => header.records(&header.expand(body)?, true, &mut cloud),
    }
    if cloud.points.is_empty() {
        return Err(format!("the PCD has no points ({} without a return)", cloud.no_return));
    }
    Ok(cloud)
}

#[derive(Clone, Copy)]
enum Data {
    Ascii,
    Binary,
    Compressed,
}

struct Field {
    name: Vec<u8>,
    size: usize,
    kind: u8,
    count: usize,
}

struct Header {
    fields: Vec<Field>,
    points: usize,
    data: Data,
    /// Fields of x, y and z, with their type.
    axes: [(usize, Scalar); 3],
    /// Bytes and lines of the header.
    length: usize,
    lines: usize,
}

fn truncated(header: &Header, expected: usize, found: usize) -> String {
    format!(
        "the PCD is truncated: {} points of {} bytes need {expected} bytes after the header, found {found}",
        header.points,
        header.record_size()
    )
}

impl Header {
    fn parse(bytes: &[u8]) -> Result<Self, String> {
        let mut fields: Vec<Field> = Vec::new();
        let (mut width, mut height, mut points) = (None, 1usize, None);
        let (mut length, mut number) = (0, 0);
        for line in bytes.split_inclusive(|b| *b == b'\n') {
            length += line.len();
            number += 1;
            let words: Vec<&[u8]> = words(line).take(1000).collect();
            let bad = || {
                format!(
                    "line {number} of the PCD header, \"{}\", is not understood",
                    shown(line.trim_ascii())
                )
            };
            let Some((key, values)) = words.split_first() else { continue };
            let whole = || values.first().and_then(|w| integer::<usize>(w)).ok_or_else(bad);
            if matches!(*key, b"SIZE" | b"TYPE" | b"COUNT") && values.len() != fields.len() {
                return Err(bad());
            }
            match *key {
                word if word.starts_with(b"#") => {}
                b"VERSION" | b"VIEWPOINT" => {}
                b"FIELDS" => {
                    let field = |name: &&[u8]| Field { name: name.to_vec(), size: 4, kind: b'F', count: 1 };
                    fields = values.iter().map(field).collect();
                }
                b"SIZE" => {
                    for (field, word) in fields.iter_mut().zip(values) {
                        field.size = integer(word).filter(|s| matches!(s, 1 | 2 | 4 | 8)).ok_or_else(bad)?;
                    }
                }
                b"TYPE" => {
                    for (field, word) in fields.iter_mut().zip(values) {
                        let [kind @ (b'F' | b'I' | b'U')] = **word else { return Err(bad()) };
                        field.kind = kind;
                    }
                }
                b"COUNT" => {
                    for (field, word) in fields.iter_mut().zip(values) {
                        field.count = integer(word).filter(|c| *c <= 100_000).ok_or_else(bad)?;
                    }
                }
                b"WIDTH" => width = Some(whole()?),
                b"HEIGHT" => height = whole()?,
                b"POINTS" => points = Some(whole()?),
                b"DATA" => {
                    let data = match values {
                        [b"ascii"] => Data::Ascii,
                        [b"binary"] => Data::Binary,
                        [b"binary_compressed"] => Data::Compressed,
                        _ => return Err(bad()),
                    };
                    let product = width.and_then(|w: usize| w.checked_mul(height));
                    let Some(points) = points.or(product) else {
                        return Err("the PCD header has neither POINTS nor WIDTH".to_owned());
                    };
                    let axes = axes(&fields)?;
                    return Ok(Self { fields, points, data, axes, length, lines: number });
                }
                _ => return Err(bad()),
            }
        }
        Err(format!("the PCD is truncated: its header ends after {number} lines without \"DATA\""))
    }

    fn record_size(&self) -> usize {
        self.fields.iter().map(|f| f.size * f.count).sum()
    }

    fn ascii(&self, body: &[u8], cloud: &mut RawCloud) -> Result<(), String> {
        // A digit and what parts it from the next, for every number.
        let columns: usize = self.fields.iter().map(|f| f.count).sum();
        if self.points.saturating_mul(2 * columns) > body.len() + 1 {
            return Err(format!(
                "the PCD is truncated: {} points of {columns} columns cannot stand in {} bytes",
                self.points,
                body.len()
            ));
        }
        let column = |field: usize| self.fields[..field].iter().map(|f| f.count).sum::<usize>();
        let columns_of = self.axes.map(|(field, _)| column(field));
        let mut read = 0;
        for (at, line) in lines(body).filter(|(_, line)| !line.is_empty()).take(self.points) {
            let mut point = Point3::origin();
            let mut found = 0;
            for (k, word) in words(line).enumerate() {
                found += 1;
                for axis in (0..3).filter(|a| columns_of[*a] == k) {
                    point[axis] = any_number(word).ok_or_else(|| {
                        format!(
                            "line {} of the PCD has \"{}\"; a number was expected",
                            self.lines + at,
                            shown(word)
                        )
                    })?;
                }
            }
            if found != columns {
                return Err(format!(
                    "line {} of the PCD has {found} columns; {columns} were expected",
                    self.lines + at
                ));
            }
            read += 1;
            cloud.add(point);
        }
        if read < self.points {
            return Err(format!(
                "the PCD is truncated: its header states {} points, found {read}",
                self.points
            ));
        }
        Ok(())
    }

    /// Reads `data` of `points` records, one after the other or, `by_field`, all of a field before the next field.
    fn records(&self, data: &[u8], by_field: bool, cloud: &mut RawCloud) {
        let start = |field: usize| self.fields[..field].iter().map(|f| f.size * f.count).sum::<usize>();
        let places = self.axes.map(|(field, scalar)| {
            let size = self.fields[field].size * self.fields[field].count;
            if by_field {
                (self.points * start(field), size, scalar)
            } else {
                (start(field), self.record_size(), scalar)
            }
        });
        for i in 0..self.points {
            let at = places.map(|(first, step, scalar)| {
                scalar.read(&data[first + i * step..], false).unwrap_or(f64::NAN)
            });
            cloud.add(Point3::from(at));
        }
    }

    fn expand(&self, body: &[u8]) -> Result<Vec<u8>, String> {
        let size =
            |at: usize| body.get(at..at + 4).and_then(|b| Scalar::U32.read(b, false)).map(|n| n as usize);
        let (Some(packed), Some(unpacked)) = (size(0), size(4)) else {
            return Err("the PCD is truncated: its compressed data has no sizes".to_owned());
        };
        let expected = self.points.saturating_mul(self.record_size());
        if unpacked != expected || expected > CONTENT_BYTES_MAX {
            return Err(format!(
                "the PCD's compressed data states {unpacked} bytes; {} points of {} bytes, {} MiB at most, were expected",
                self.points,
                self.record_size(),
                CONTENT_BYTES_MAX >> 20
            ));
        }
        let data = body[8..].get(..packed).ok_or_else(|| {
            format!("the PCD is truncated: {packed} compressed bytes are stated, found {}", body.len() - 8)
        })?;
        lzf::expand(data, unpacked).map_err(|at| format!("the PCD's compressed data is damaged at byte {at}"))
    }
}

impl RawCloud {
    /// Adds a point of a format that marks by a coordinate that is not finite what gave no return.
    pub fn add(&mut self, point: Point3<f64>) {
        if point.iter().all(|x| x.is_finite()) {
            self.points.push(point);
        } else {
            self.no_return += 1;
        }
    }
}

fn axes(fields: &[Field]) -> Result<[(usize, Scalar); 3], String> {
    let axis = |name: &[u8]| {
        let place = fields.iter().position(|f| f.name == name && f.count == 1)?;
        let scalar = match (fields[place].kind, fields[place].size) {
            (b'F', 4) => Scalar::F32,
            (b'F', 8) => Scalar::F64,
            (b'I', 1) => Scalar::I8,
            (b'I', 2) => Scalar::I16,
            (b'I', 4) => Scalar::I32,
            (b'U', 1) => Scalar::U8,
            (b'U', 2) => Scalar::U16,
            (b'U', 4) => Scalar::U32,
            _ => return None,
        };
        Some((place, scalar))
    };
    match (axis(b"x"), axis(b"y"), axis(b"z")) {
        (Some(x), Some(y), Some(z)) => Ok([x, y, z]),
        _ => Err("the PCD has not the fields x, y and z, one number of a known type each".to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: Limits = Limits { triangles: 4, points: 5 };
    const POINTS: [[f32; 3]; 3] = [[1., 2., 3.], [f32::NAN, 0., 0.], [4., 5., 6.5]];

    fn header(data: &str) -> String {
        format!(
            "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS x rgb y z\nSIZE 4 1 4 4\nTYPE F U F F\nCOUNT 1 2 1 1\n\
             WIDTH 3\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 3\nDATA {data}\n"
        )
    }

    fn forms() -> [Vec<u8>; 3] {
        let ascii = header("ascii") + "1 7 7 2 3\nnan 7 7 0 0\n4 7 7 5 6.5\n";
        let mut binary = header("binary").into_bytes();
        for [x, y, z] in POINTS {
            binary.extend(x.to_le_bytes());
            binary.extend([7, 7]);
            binary.extend([y, z].map(f32::to_le_bytes).concat());
        }
        let mut by_field: Vec<u8> = POINTS.iter().flat_map(|p| p[0].to_le_bytes()).collect();
        by_field.extend([7; 6]);
        by_field.extend(POINTS.iter().flat_map(|p| p[1].to_le_bytes()));
        by_field.extend(POINTS.iter().flat_map(|p| p[2].to_le_bytes()));
        let packed = lzf::tests::literals(&by_field);
        let mut compressed = header("binary_compressed").into_bytes();
        compressed.extend((packed.len() as u32).to_le_bytes());
        compressed.extend((by_field.len() as u32).to_le_bytes());
        compressed.extend(packed);
        [ascii.into_bytes(), binary, compressed]
    }

    #[test]
    fn all_three_forms_give_the_same_points() {
        let expected =
            RawCloud { points: [[1., 2., 3.], [4., 5., 6.5]].map(Point3::from).to_vec(), no_return: 1 };
        for bytes in forms() {
            assert_eq!(parse(&bytes, &LIMITS).unwrap(), expected);
        }
    }

    #[test]
    fn each_bad_file_is_one_clear_error() {
        let [ascii, binary, compressed] = forms();
        let text = String::from_utf8(ascii).unwrap();
        let with = |from: &str, to: &str| text.replacen(from, to, 1).into_bytes();
        let cut = |bytes: &[u8], n: usize| bytes[..bytes.len() - n].to_vec();
        for (bytes, part) in [
            (Vec::new(), "truncated: its header ends after 0 lines"),
            (b"VERSION 0.7\n".to_vec(), "ends after 1 lines"),
            (with("SIZE 4 1 4 4", "SIZE 4 1 4"), "line 4 of the PCD header, \"SIZE 4 1 4\""),
            (with("SIZE 4 1 4 4", "SIZE 4 1 4 3"), "line 4"),
            (with("TYPE F U F F", "TYPE F U F X"), "line 5"),
            (with("FIELDS x rgb y z", "FIELDS x rgb y w"), "not the fields x, y and z"),
            (with("POINTS 3", "POINTS -3"), "line 10"),
            (with("POINTS 3", "POINTS 6"), "6 points, more than the 5 allowed (max_points)"),
            (
                text.replace("POINTS 3", "POINTS 4").replace("6.5", "6.500000").into_bytes(),
                "states 4 points, found 3",
            ),
            (with("1 7 7 2 3", "1 7 7 2"), "line 12 of the PCD has 4 columns; 5"),
            (with("1 7 7 2 3", "1 7 7 up 3"), "line 12 of the PCD has \"up\""),
            (header("zip").into_bytes(), "\"DATA zip\""),
            (header("ascii").into_bytes(), "cannot stand in 0 bytes"),
            (cut(&binary, 1), "3 points of 14 bytes need 42 bytes after the header, found 41"),
            (cut(&compressed, 1), "compressed bytes are stated"),
            (cut(&compressed, 48), "has no sizes"),
        ] {
            let error = parse(&bytes, &LIMITS).unwrap_err();
            assert!(error.contains(part), "{part}: {error}");
        }
    }
}
