//! Binary and ASCII STL. Facet normals in the file are ignored: many writers leave them wrong or zero.

use nalgebra::Point3;
use patchmill_products::stage::StageError;
use rayon::prelude::*;

use crate::error_code::BAD_CONTENT;

/// Bytes before the facet count of a binary STL.
const HEADER: usize = 80;
/// Bytes of one binary facet: normal, three vertices, attribute.
const FACET: usize = 50;

/// The facets' corners, in the file's unit and order; all coordinates are finite.
///
/// Binary is told from ASCII by its length, which the facet count gives: binary files that start with "solid" are common.
///
/// # Errors
/// When the content is empty, truncated, malformed, has no facet, more than `max_triangles` or a NaN or infinite coordinate.
pub fn parse(bytes: &[u8], name: &str, max_triangles: usize) -> Result<Vec<[Point3<f64>; 3]>, StageError> {
    let bad = |text: String| StageError::new(BAD_CONTENT, format!("{name}: {text}"));
    if bytes.is_empty() {
        return Err(bad("the STL is empty".to_owned()));
    }
    let facets = if is_ascii(bytes) { ascii(bytes, max_triangles) } else { binary(bytes, max_triangles) }
        .map_err(bad)?;
    if facets.is_empty() {
        return Err(bad("the STL has no facets; at least one was expected".to_owned()));
    }
    let is_bad = |p: &Point3<f64>| !p.iter().all(|x| x.is_finite());
    let Some(i) = facets.par_iter().position_first(|facet| facet.iter().any(is_bad)) else {
        return Ok(facets);
    };
    let p = facets[i].into_iter().find(is_bad).unwrap_or_default();
    Err(bad(format!(
        "facet {} of the STL has a vertex that is not finite ({}, {}, {}); every coordinate must be a number",
        i + 1,
        p.x,
        p.y,
        p.z
    )))
}

/// The facet count that a binary file states, if it is long enough to state one.
fn stated_count(bytes: &[u8]) -> Option<usize> {
    let count = bytes.get(HEADER..HEADER + 4)?;
    Some(u32::from_le_bytes(count.try_into().ok()?) as usize)
}

fn is_ascii(bytes: &[u8]) -> bool {
    let exact = stated_count(bytes).is_some_and(|n| bytes.len() == HEADER + 4 + n * FACET);
    let start = bytes.iter().position(|b| !b.is_ascii_whitespace()).unwrap_or(0);
    let solid = bytes[start..].get(..5).is_some_and(|w| w.eq_ignore_ascii_case(b"solid"));
    // A truncated binary file that starts with "solid" has a zero or another control byte soon; text has none.
    let is_text = bytes.iter().take(1024).all(|&b| b >= 0x20 || b.is_ascii_whitespace());
    !exact && solid && is_text
}

fn binary(bytes: &[u8], max_triangles: usize) -> Result<Vec<[Point3<f64>; 3]>, String> {
    let Some(count) = stated_count(bytes) else {
        return Err(format!(
            "neither an ASCII nor a binary STL: a binary one has at least {} bytes, found {}",
            HEADER + 4,
            bytes.len()
        ));
    };
    let expected = HEADER + 4 + count * FACET;
    if bytes.len() < expected {
        return Err(format!(
            "the binary STL is truncated or not an STL: {count} facets need {expected} bytes, found {}",
            bytes.len()
        ));
    }
    too_many(count, max_triangles)?;
    // Bytes after the last facet are left alone: some writers append colours or padding.
    Ok(bytes[HEADER + 4..expected].par_chunks_exact(FACET).map(binary_facet).collect())
}

fn binary_facet(facet: &[u8]) -> [Point3<f64>; 3] {
    let number =
        |at: usize| f64::from(f32::from_le_bytes([facet[at], facet[at + 1], facet[at + 2], facet[at + 3]]));
    [12, 24, 36].map(|at| Point3::new(number(at), number(at + 4), number(at + 8)))
}

fn too_many(count: usize, max_triangles: usize) -> Result<(), String> {
    if count > max_triangles {
        return Err(format!(
            "the STL has {count} facets, more than the {max_triangles} allowed (max_triangles)"
        ));
    }
    Ok(())
}

fn ascii(bytes: &[u8], max_triangles: usize) -> Result<Vec<[Point3<f64>; 3]>, String> {
    // Names may be in any encoding; what matters is ASCII.
    let text = String::from_utf8_lossy(bytes);
    let mut facets = Vec::new();
    let mut corners: Vec<Point3<f64>> = Vec::with_capacity(3);
    let mut open = false;
    let mut ended = false;
    let mut last_line = 0;
    for (i, line) in text.lines().enumerate() {
        let (at, mut words) = (i + 1, line.split_ascii_whitespace());
        let Some(word) = words.next() else { continue };
        last_line = at;
        match word.to_ascii_lowercase().as_str() {
            "solid" if !open => ended = false,
            "endsolid" if !open => ended = true,
            "facet" if !open => open = true,
            "outer" | "endloop" if open => {}
            "vertex" if open => corners.push(ascii_vertex(words, at, facets.len() + 1)?),
            "endfacet" if open => {
                let facet: [Point3<f64>; 3] = corners.as_slice().try_into().map_err(|_| {
                    format!(
                        "facet {} of the ASCII STL (line {at}) has {} vertices; 3 were expected",
                        facets.len() + 1,
                        corners.len()
                    )
                })?;
                facets.push(facet);
                too_many(facets.len(), max_triangles)?;
                corners.clear();
                open = false;
            }
            other => {
                let shown: String = other.chars().take(40).collect();
                return Err(format!(
                    "line {at} of the ASCII STL starts with \"{shown}\", which is out of place"
                ));
            }
        }
    }
    if open || !ended {
        return Err(format!(
            "the ASCII STL is truncated: it ends at line {last_line} after {} facets without \"endsolid\"",
            facets.len()
        ));
    }
    Ok(facets)
}

fn ascii_vertex<'a>(
    mut words: impl Iterator<Item = &'a str>,
    line: usize,
    facet: usize,
) -> Result<Point3<f64>, String> {
    let mut number = || -> Result<f64, String> {
        let word = words.next().unwrap_or("");
        word.parse::<f64>().map_err(|_| {
            let shown: String = word.chars().take(40).collect();
            format!("facet {facet} of the ASCII STL (line {line}) has the coordinate \"{shown}\"; a number was expected")
        })
    };
    let point = Point3::new(number()?, number()?, number()?);
    match words.next() {
        None => Ok(point),
        Some(_) => Err(format!("line {line} of the ASCII STL has more than three coordinates")),
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn binary_of(facets: &[[[f32; 3]; 3]]) -> Vec<u8> {
        let triangles: Vec<_> = facets
            .iter()
            .map(|f| stl_io::Triangle {
                normal: stl_io::Normal::new([0.; 3]),
                vertices: f.map(stl_io::Vertex::new),
            })
            .collect();
        let mut bytes = Vec::new();
        stl_io::write_stl(&mut bytes, triangles.iter()).unwrap();
        bytes
    }

    fn ascii_of(facets: &[[[f32; 3]; 3]]) -> Vec<u8> {
        let mut text = String::from("solid part\n");
        for f in facets {
            text += "facet normal 0 0 0\n outer loop\n";
            for [x, y, z] in f {
                text += &format!("  vertex {x:e} {y:e} {z:e}\n");
            }
            text += " endloop\nendfacet\n";
        }
        (text + "endsolid part\n").into_bytes()
    }

    const FACET_1: [[f32; 3]; 3] = [[0., 0., 0.], [1., 0., 0.], [0., 1., 0.5]];

    #[test]
    fn each_bad_file_is_one_clear_error() {
        let good = binary_of(&[FACET_1, FACET_1]);
        let mut nan = good.clone();
        nan[HEADER + 4 + FACET + 12..HEADER + 4 + FACET + 16].copy_from_slice(&f32::NAN.to_le_bytes());
        let text = String::from_utf8(ascii_of(&[FACET_1])).unwrap();
        for (bytes, part) in [
            (Vec::new(), "empty"),
            (good[..60].to_vec(), "at least 84 bytes, found 60"),
            (good[..150].to_vec(), "2 facets need 184 bytes, found 150"),
            (binary_of(&[]), "no facets"),
            (nan, "facet 2"),
            (b"solid a\nendsolid a\n".to_vec(), "no facets"),
            (text.replace("endsolid part\n", "").into_bytes(), "truncated"),
            (text.as_bytes()[..60].to_vec(), "truncated"),
            (text.replace("5e-1", "nan").into_bytes(), "not finite"),
            (text.replace("5e-1", "1e999").into_bytes(), "not finite"),
            (text.replace("5e-1", "oops").into_bytes(), "\"oops\""),
            (text.replace("5e-1", "").into_bytes(), "coordinate \"\""),
            (text.replace("5e-1", "5e-1 7").into_bytes(), "more than three"),
            (text.replace(" outer loop", "outer loop\nvertex 0 0 0").into_bytes(), "4 vertices"),
            (text.replace(" outer loop", "what").into_bytes(), "\"what\""),
            (b"hello".to_vec(), "neither"),
        ] {
            let error = parse(&bytes, "part.stl", 100).expect_err(part);
            assert!(error.text.contains(part), "{part}: {error}");
            assert!(error.text.starts_with("part.stl: "));
        }
        assert!(parse(&good, "part.stl", 1).unwrap_err().text.contains("2 facets, more than the 1"));
    }

    #[test]
    fn a_binary_file_may_start_with_solid() {
        let mut bytes = binary_of(&[FACET_1]);
        bytes[..HEADER].fill(b' ');
        bytes[..5].copy_from_slice(b"solid");
        assert_eq!(parse(&bytes, "a", 10).unwrap().len(), 1);
        bytes.pop();
        assert!(parse(&bytes, "a", 10).unwrap_err().text.contains("found 133"));
    }

    fn facets() -> impl Strategy<Value = Vec<[[f32; 3]; 3]>> {
        prop::collection::vec(prop::array::uniform3(prop::array::uniform3(-1e4f32..1e4)), 1..20)
    }

    proptest! {
        #[test]
        fn both_forms_return_every_bit(facets in facets()) {
            let expected: Vec<[Point3<f64>; 3]> =
                facets.iter().map(|f| f.map(|p| Point3::from(p.map(f64::from)))).collect();
            prop_assert_eq!(&parse(&binary_of(&facets), "a", 100).unwrap(), &expected);
            let ascii: Vec<_> = parse(&ascii_of(&facets), "a", 100).unwrap();
            let back: Vec<_> = ascii.iter().map(|f| f.map(|p| Point3::from(p.coords.map(|x| f64::from(x as f32))))).collect();
            prop_assert_eq!(&back, &expected);
        }

        #[test]
        fn truncation_is_an_error_and_never_a_panic(facets in facets(), share in 0f64..1.0) {
            for bytes in [binary_of(&facets), ascii_of(&facets)] {
                let cut = (bytes.len() as f64 * share) as usize;
                prop_assert!(parse(&bytes[..cut.min(bytes.len() - 12)], "a", 100).is_err());
            }
        }

        #[test]
        fn no_bytes_panic(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
            let _ = parse(&bytes, "a", 100);
        }
    }
}
