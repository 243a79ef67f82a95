//! A triangle soup made into shared vertices: welding, degenerate and duplicate facets dropped.

use std::collections::HashMap;
use std::hash::{BuildHasherDefault, Hasher};

use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

/// Vertices nearer than this share of the bounding box's diagonal are one …
const RELATIVE_TOLERANCE: f64 = 1e-6;
/// … but never vertices further apart than this, m.
const TOLERANCE_MAX: f64 = 1e-6;
/// Grid cells are this many tolerances wide: most vertices then lie clear of their cell's border.
const CELL_TOLERANCES: f64 = 16.0;

/// Shared vertices in order of first use and the facets left, in the file's order.
#[derive(Clone, Debug, Default)]
pub struct Welded {
    /// Vertex positions, m.
    pub vertices: Vec<Point3<f64>>,
    /// Vertex indices, three a facet; no two the same.
    pub triangles: Vec<[u32; 3]>,
    /// Facets dropped for having no area.
    pub degenerate: u32,
    /// Facets dropped for having the same three vertices as an earlier one.
    pub duplicate: u32,
}

/// Welds `facets` (m).
pub fn weld(facets: &[[Point3<f64>; 3]]) -> Welded {
    let (mut low, mut high) = (Vector3::repeat(f64::INFINITY), Vector3::repeat(f64::NEG_INFINITY));
    for p in facets.iter().flatten() {
        low = low.inf(&p.coords);
        high = high.sup(&p.coords);
    }
    let tolerance = ((high - low).norm() * RELATIVE_TOLERANCE).clamp(f64::MIN_POSITIVE, TOLERANCE_MAX);
    let (vertices, corners) = weld_exact(facets);
    let same = weld_near(&vertices, tolerance);

    let mut welded = Welded { triangles: Vec::with_capacity(corners.len()), ..Default::default() };
    let mut number = vec![u32::MAX; vertices.len()];
    let mut seen: Set<[u32; 3]> = Set::with_capacity_and_hasher(corners.len(), BuildHasherDefault::default());
    for corner in &corners {
        let first = corner.map(|v| same[v as usize]);
        if is_degenerate(first, &vertices) {
            welded.degenerate += 1;
            continue;
        }
        let mut key = first;
        key.sort_unstable();
        if seen.insert(key, ()).is_some() {
            welded.duplicate += 1;
            continue;
        }
        welded.triangles.push(first.map(|v| {
            let slot = &mut number[v as usize];
            if *slot == u32::MAX {
                *slot = welded.vertices.len() as u32;
                welded.vertices.push(vertices[v as usize]);
            }
            *slot
        }));
    }
    welded
}

/// Collapsed, or so thin that its height drowns in the coordinates' rounding.
fn is_degenerate([a, b, c]: [u32; 3], vertices: &[Point3<f64>]) -> bool {
    if a == b || b == c || c == a {
        return true;
    }
    let [a, b, c] = [a, b, c].map(|v| vertices[v as usize]);
    let longest = (b - a).norm().max((c - b).norm()).max((a - c).norm());
    (b - a).cross(&(c - a)).norm() <= 1e-7 * longest * longest
}

/// Never iterated: only its answers to single keys count, so the order of results does not depend on it.
type Set<K> = HashMap<K, (), BuildHasherDefault<FastHasher>>;

fn weld_exact(facets: &[[Point3<f64>; 3]]) -> (Vec<Point3<f64>>, Vec<[u32; 3]>) {
    let mut index: HashMap<[u64; 3], u32, BuildHasherDefault<FastHasher>> =
        HashMap::with_capacity_and_hasher(facets.len(), BuildHasherDefault::default());
    let mut vertices = Vec::with_capacity(facets.len() / 2 + 3);
    let corners = facets
        .iter()
        .map(|facet| {
            facet.map(|p| {
                // + 0.0 turns −0 into 0.
                let key = [p.x + 0.0, p.y + 0.0, p.z + 0.0].map(f64::to_bits);
                *index.entry(key).or_insert_with(|| {
                    vertices.push(p);
                    (vertices.len() - 1) as u32
                })
            })
        })
        .collect();
    (vertices, corners)
}

/// For every vertex the first one within `tolerance` that stands for itself.
fn weld_near(vertices: &[Point3<f64>], tolerance: f64) -> Vec<u32> {
    let size = tolerance * CELL_TOLERANCES;
    // Grid places, and whether a vertex has to look into the next cell: both are found in parallel.
    let places: Vec<([i64; 3], [i64; 3])> = vertices
        .par_iter()
        .map(|p| {
            let at = [p.x / size, p.y / size, p.z / size];
            let cell = at.map(|x| x.floor() as i64);
            let near = std::array::from_fn(|k| {
                let within = at[k] - at[k].floor();
                let margin = 1.01 / CELL_TOLERANCES;
                i64::from(within > 1.0 - margin) - i64::from(within < margin)
            });
            (cell, near)
        })
        .collect();
    let mut head: HashMap<[i64; 3], u32, BuildHasherDefault<FastHasher>> =
        HashMap::with_capacity_and_hasher(vertices.len(), BuildHasherDefault::default());
    let mut next = vec![u32::MAX; vertices.len()];
    let mut same: Vec<u32> = (0..vertices.len() as u32).collect();
    for (v, (cell, near)) in places.iter().enumerate() {
        let mut best = u32::MAX;
        for corner in 0..8 {
            let bits: [i64; 3] = std::array::from_fn(|k| i64::from(corner >> k & 1 == 1));
            if (0..3).any(|k| bits[k] == 1 && near[k] == 0) {
                continue;
            }
            let key: [i64; 3] = std::array::from_fn(|k| cell[k].wrapping_add(bits[k] * near[k]));
            let mut other = head.get(&key).copied().unwrap_or(u32::MAX);
            while other != u32::MAX {
                if (vertices[other as usize] - vertices[v]).norm() <= tolerance {
                    best = best.min(other);
                }
                other = next[other as usize];
            }
        }
        if best != u32::MAX {
            same[v] = best;
        } else {
            let slot = head.entry(*cell).or_insert(u32::MAX);
            next[v] = *slot;
            *slot = v as u32;
        }
    }
    same
}

/// A multiplicative hash: the keys are coordinates of a file, not chosen to collide by anyone who gains by it.
#[derive(Default)]
struct FastHasher(u64);

impl Hasher for FastHasher {
    fn finish(&self) -> u64 {
        let h = self.0 ^ (self.0 >> 32);
        let h = h.wrapping_mul(0xD6E8_FEB8_6659_FD93);
        h ^ (h >> 32)
    }
    fn write(&mut self, bytes: &[u8]) {
        for chunk in bytes.chunks(8) {
            let mut word = [0; 8];
            word[..chunk.len()].copy_from_slice(chunk);
            self.write_u64(u64::from_le_bytes(word));
        }
    }
    fn write_u64(&mut self, word: u64) {
        self.0 = (self.0.rotate_left(23) ^ word).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    }
    fn write_i64(&mut self, word: i64) {
        self.write_u64(word as u64);
    }
    fn write_u32(&mut self, word: u32) {
        self.write_u64(u64::from(word));
    }
    fn write_usize(&mut self, word: usize) {
        self.write_u64(word as u64);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn facet(points: [[f64; 3]; 3]) -> [Point3<f64>; 3] {
        points.map(Point3::from)
    }

    #[test]
    fn equal_and_near_vertices_become_one_and_bad_facets_go() {
        let e = 5e-8;
        let facets = [
            facet([[0., 0., 0.], [0.1, 0., 0.], [0.1, 0.1, 0.]]),
            facet([[-0.0, e, 0.], [0.1, 0.1 - e, e], [0., 0.1, 0.]]),
            facet([[0., 0., 0.], [e, 0., 0.], [0.1, 0.1, 0.]]),
            facet([[0., 0., 0.], [0.05, 0., 0.], [0.1, 0., 0.]]),
            facet([[0.1, 0.1, 0.], [0.1, 0., 0.], [0., 0., 0.]]),
            facet([[0., 0., 0.], [0.1, 0., 1e-6], [0.1, 0.1, 0.]]),
        ];
        let welded = weld(&facets);
        assert_eq!(welded.triangles, [[0, 1, 2], [0, 2, 3], [0, 4, 2]]);
        assert_eq!((welded.degenerate, welded.duplicate), (2, 1));
        assert_eq!(welded.vertices.len(), 5);
    }

    #[test]
    fn welding_sees_across_cell_borders() {
        let tolerance = 1e-6;
        for shift in 0..400 {
            let p = Point3::new(f64::from(shift) * 7.7e-8, f64::from(shift) * -3.1e-8, 1e-6);
            let q = p + Vector3::new(0.5e-6, -0.5e-6, 0.5e-6);
            assert_eq!(weld_near(&[p, q], tolerance), [0, 0], "{shift}");
            let far = p + Vector3::new(0.7e-6, -0.7e-6, 0.7e-6);
            assert_eq!(weld_near(&[p, far], tolerance), [0, 1], "{shift}");
        }
    }
}
