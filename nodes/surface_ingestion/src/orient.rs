//! Triangles turned so that neighbours agree and every connected part looks to the tool side, +Z.

use nalgebra::{Point3, Vector3};
use patchmill_products::stage::StageError;
use rayon::prelude::*;

use crate::error_code::BAD_TOPOLOGY;

/// What was found on the way.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Orientation {
    /// Connected parts (over edges that exactly two triangles share).
    pub parts: u32,
    /// Those of them without a border.
    pub closed_parts: u32,
    /// Triangles whose winding was reversed.
    pub reversed: u32,
    /// Edges that more than two triangles share; orientation is not carried across them.
    pub non_manifold_edges: u32,
}

/// Sides of triangles that share an edge.
const NONE: u32 = u32::MAX;

/// Orients `triangles` over `vertices`. An open part is turned so that its area-weighted mean normal has z > 0, a closed one
/// so that its normals point outward.
///
/// # Errors
/// If a part is one-sided (a Möbius band), naming a place.
pub fn orient(
    vertices: &[Point3<f64>],
    triangles: &mut [[u32; 3]],
    name: &str,
) -> Result<Orientation, StageError> {
    let (across, non_manifold_edges) = neighbours(triangles);
    let mut found = Orientation { non_manifold_edges, ..Default::default() };
    // 0 not seen, 1 as in the file, 2 reversed.
    let mut state = vec![0u8; triangles.len()];
    let mut part: Vec<u32> = Vec::new();
    for start in 0..triangles.len() {
        if state[start] != 0 {
            continue;
        }
        found.parts += 1;
        state[start] = 1;
        part.clear();
        part.push(start as u32);
        let mut closed = true;
        let mut next = 0;
        while next < part.len() {
            let t = part[next] as usize;
            next += 1;
            for side in across[t] {
                if side == NONE {
                    closed = false;
                    continue;
                }
                let (other, agrees) = ((side >> 1) as usize, side & 1 == 0);
                let wanted = if agrees { state[t] } else { 3 - state[t] };
                if state[other] == 0 {
                    state[other] = wanted;
                    part.push(other as u32);
                } else if state[other] != wanted {
                    return Err(one_sided(vertices, triangles[other], name));
                }
            }
        }
        found.closed_parts += u32::from(closed);
        if looks_away(vertices, triangles, &part, &state, closed) {
            part.iter().for_each(|&t| state[t as usize] = 3 - state[t as usize]);
        }
    }
    for (triangle, _) in triangles.iter_mut().zip(&state).filter(|(_, s)| **s == 2) {
        triangle.swap(1, 2);
        found.reversed += 1;
    }
    Ok(found)
}

fn one_sided(vertices: &[Point3<f64>], triangle: [u32; 3], name: &str) -> StageError {
    let p = vertices[triangle[0] as usize] * 1e3;
    StageError::new(
        BAD_TOPOLOGY,
        format!(
            "{name}: the facets near x = {:.3} mm, y = {:.3} mm, z = {:.3} mm form a one-sided surface; a surface with a tool \
             side was expected",
            p.x, p.y, p.z
        ),
    )
}

/// For every triangle the triangles across its edges: index · 2, + 1 when the two run along the edge in the same sense (one of
/// them must be reversed); [`NONE`] at borders and at edges of more than two triangles, whose number is returned.
fn neighbours(triangles: &[[u32; 3]]) -> (Vec<[u32; 3]>, u32) {
    // Edge key with its triangle side: sorting brings the sides of an edge together, in a fixed order.
    let mut edges: Vec<(u64, u32)> = triangles
        .par_iter()
        .enumerate()
        .flat_map_iter(|(t, corners)| {
            (0..3).map(move |k| {
                let (a, b) = (corners[k], corners[(k + 1) % 3]);
                (u64::from(a.min(b)) << 32 | u64::from(a.max(b)), (3 * t + k) as u32)
            })
        })
        .collect();
    edges.par_sort_unstable();
    let forward = |side: u32| {
        let corners = triangles[side as usize / 3];
        let k = side as usize % 3;
        corners[k] < corners[(k + 1) % 3]
    };
    let mut across = vec![[NONE; 3]; triangles.len()];
    let mut non_manifold = 0;
    for same in edges.chunk_by(|a, b| a.0 == b.0) {
        match same {
            [_] => {}
            [(_, a), (_, b)] => {
                let flag = u32::from(forward(*a) == forward(*b));
                across[*a as usize / 3][*a as usize % 3] = b / 3 * 2 + flag;
                across[*b as usize / 3][*b as usize % 3] = a / 3 * 2 + flag;
            }
            _ => non_manifold += 1,
        }
    }
    (across, non_manifold)
}

fn looks_away(
    vertices: &[Point3<f64>],
    triangles: &[[u32; 3]],
    part: &[u32],
    state: &[u8],
    closed: bool,
) -> bool {
    let origin = vertices[triangles[part[0] as usize][0] as usize];
    let (mut vector, mut area, mut volume) = (Vector3::zeros(), 0.0, 0.0);
    for &t in part {
        let [a, b, c] = triangles[t as usize].map(|v| vertices[v as usize] - origin);
        let sense = if state[t as usize] == 2 { -0.5 } else { 0.5 };
        let cross = (b - a).cross(&(c - a)) * sense;
        vector += cross;
        area += cross.norm();
        volume += cross.dot(&a);
    }
    // A part that stands upright has no upper side: it stays as the file has it.
    if closed { volume < 0.0 } else { vector.z < -1e-9 * area }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square(z: f64) -> Vec<Point3<f64>> {
        [(0., 0.), (1., 0.), (1., 1.), (0., 1.)].map(|(x, y)| Point3::new(x, y, z)).to_vec()
    }

    #[test]
    fn parts_are_made_consistent_and_turned_up() {
        let mut vertices = square(0.0);
        vertices.extend(square(1.0));
        let mut triangles = [[0, 2, 1], [0, 2, 3], [4, 5, 6], [4, 6, 7]];
        let found = orient(&vertices, &mut triangles, "a").unwrap();
        assert_eq!(found, Orientation { parts: 2, closed_parts: 0, reversed: 1, non_manifold_edges: 0 });
        assert_eq!(triangles, [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]]);
    }

    #[test]
    fn a_closed_body_looks_outward() {
        let vertices: Vec<_> =
            [[0., 0., 0.], [1., 0., 0.], [0., 1., 0.], [0., 0., 1.]].map(Point3::from).to_vec();
        let outward = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]];
        for flips in 0..16 {
            let mut triangles = outward;
            for (k, t) in triangles.iter_mut().enumerate() {
                if flips >> k & 1 == 1 {
                    t.swap(1, 2);
                }
            }
            orient(&vertices, &mut triangles, "a").unwrap();
            for (t, expected) in triangles.iter().zip(&outward) {
                let from = t.iter().position(|v| *v == expected[0]).unwrap();
                assert_eq!([t[from], t[(from + 1) % 3], t[(from + 2) % 3]], *expected);
            }
        }
    }

    #[test]
    fn a_moebius_band_is_refused_and_a_fin_tolerated() {
        let count = 9u32;
        let vertices: Vec<_> = (0..count)
            .flat_map(|i| {
                let a = f64::from(i) / f64::from(count) * std::f64::consts::TAU;
                [-0.3, 0.3].map(|s| {
                    let r = 1.0 + s * (a / 2.0).cos();
                    Point3::new(r * a.cos(), r * a.sin(), s * (a / 2.0).sin())
                })
            })
            .collect();
        let mut band = Vec::new();
        for i in 0..count {
            let (a, b) = (2 * i, 2 * i + 1);
            let (c, d) = if i + 1 == count { (1, 0) } else { (a + 2, b + 2) };
            band.extend([[a, c, b], [b, c, d]]);
        }
        assert_eq!(orient(&vertices, &mut band, "band").unwrap_err().code, BAD_TOPOLOGY);

        let mut vertices = square(0.0);
        vertices.push(Point3::new(0.5, 0.5, 1.0));
        let mut triangles = [[0, 1, 2], [0, 2, 3], [0, 2, 4]];
        assert_eq!(orient(&vertices, &mut triangles, "fin").unwrap().non_manifold_edges, 1);
    }
}
