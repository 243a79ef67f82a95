//! Wavefront OBJ: `v` and `f`; all other records (texture, normals, groups, materials, lines) are left alone.

use nalgebra::Point3;

use crate::polygon::{CORNERS_MAX, triangulate};
use crate::raw::{Limits, RawMesh};
use crate::text::{integer, lines, number, shown, words};

/// The mesh of `bytes`; polygons are cut into triangles.
///
/// # Errors
/// Naming the line: a vertex without three numbers, a face with less than three corners or with one that does not exist; no
/// face; more than `limits` allows.
pub fn parse(bytes: &[u8], limits: &Limits) -> Result<RawMesh, String> {
    let vertices = vertices(bytes, limits)?;
    let mut triangles = Vec::new();
    let (mut before, mut corners) = (0, Vec::new());
    for (at, line) in lines(bytes) {
        let mut words = words(line);
        match words.next() {
            Some(b"v") => before += 1,
            Some(b"f") => {
                corners.clear();
                for word in words {
                    corners.push(corner(word, before, vertices.len(), at)?);
                    if corners.len() > CORNERS_MAX {
                        return Err(format!(
                            "the face in line {at} of the OBJ has more than {CORNERS_MAX} corners"
                        ));
                    }
                }
                if corners.len() < 3 {
                    return Err(format!(
                        "the face in line {at} of the OBJ has {} corners; 3 at least were expected",
                        corners.len()
                    ));
                }
                limits.check_triangles(triangles.len() + corners.len() - 2, "OBJ")?;
                triangulate(&corners, &vertices, &mut triangles);
            }
            _ => {}
        }
    }
    if triangles.is_empty() {
        return Err(format!(
            "the OBJ has no faces ({} vertices); lines \"v x y z\" and \"f i j k\" were expected",
            vertices.len()
        ));
    }
    Ok(RawMesh { vertices, triangles })
}

fn vertices(bytes: &[u8], limits: &Limits) -> Result<Vec<Point3<f64>>, String> {
    let mut vertices = Vec::new();
    for (at, line) in lines(bytes) {
        let mut words = words(line);
        if words.next() != Some(b"v") {
            continue;
        }
        let mut coordinate = || {
            let word = words.next().unwrap_or(b"");
            number(word).ok_or_else(|| {
                format!("the vertex in line {at} of the OBJ has the coordinate \"{}\"; a finite number was expected", shown(word))
            })
        };
        vertices.push(Point3::new(coordinate()?, coordinate()?, coordinate()?));
        limits.check_vertices(vertices.len(), "OBJ")?;
    }
    Ok(vertices)
}

/// The vertex of `7`, `7/1`, `7/1/3` or `7//3`, counted from 1, or back from those before the face if negative.
fn corner(word: &[u8], before: usize, count: usize, line: usize) -> Result<u32, String> {
    let vertex = word.split(|b| *b == b'/').next().unwrap_or(b"");
    let index = match integer::<i64>(vertex) {
        Some(n) if n > 0 => usize::try_from(n - 1).ok(),
        Some(n) if n < 0 => usize::try_from(n.unsigned_abs()).ok().and_then(|back| before.checked_sub(back)),
        _ => None,
    };
    match index {
        Some(index) if index < count => Ok(index as u32),
        _ => Err(format!(
            "the face in line {line} of the OBJ has the corner \"{}\"; a vertex from 1 to {count} (or from -1 to -{before}) was expected",
            shown(word)
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: Limits = Limits { triangles: 10, points: 10 };

    #[test]
    fn faces_of_all_forms_are_read() {
        let text = "# part\r\nmtllib a.mtl\nv 0 0 0\nv 1 0 0 1.0\nv 1 1 0 0.5 0.5 0.5\nvn 0 0 1\nvt 0 0\ng top\nf 1/1/1 2//1 3/1\n\
                    v 0 1 0\nf -4 -2 -1\nf 1 2 3 4\nl 1 2\n";
        let mesh = parse(text.as_bytes(), &LIMITS).unwrap();
        assert_eq!(mesh.vertices.len(), 4);
        assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3], [3, 0, 1], [3, 1, 2]]);
    }

    #[test]
    fn each_bad_file_is_one_clear_error() {
        let corners = "v 0 0 0\nv 1 0 0\nv 0 1 0\n";
        for (text, part) in [
            (String::new(), "no faces (0 vertices)"),
            (corners.to_owned(), "no faces (3 vertices)"),
            (format!("{corners}f 1 2"), "line 4 of the OBJ has 2 corners"),
            (format!("{corners}f 1 2 4"), "line 4 of the OBJ has the corner \"4\"; a vertex from 1 to 3"),
            (format!("{corners}f 1 2 0"), "the corner \"0\""),
            (format!("{corners}f 1 2 -4"), "the corner \"-4\""),
            (format!("{corners}f 1 2 99999999999999999999"), "the corner \"9999"),
            (format!("{corners}f 1 2 x"), "the corner \"x\""),
            (format!("v 0 nan 0\n{corners}"), "line 1 of the OBJ has the coordinate \"nan\""),
            (format!("v 0 0\n{corners}"), "the coordinate \"\""),
            (
                format!("{corners}{}", "f 1 2 3\n".repeat(11)),
                "11 facets, more than the 10 allowed (max_triangles)",
            ),
            ("v 0 0 0\n".repeat(31), "31 vertices, more than the 30"),
            (format!("{corners}f{}", " 1".repeat(1001)), "more than 1000 corners"),
        ] {
            let error = parse(text.as_bytes(), &LIMITS).unwrap_err();
            assert!(error.contains(part), "{part}: {error}");
        }
    }
}
