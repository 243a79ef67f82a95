//! A triangle soup made into shared vertices: welding, degenerate and duplicate facets dropped.

use std::collections::HashMap;
use std::hash::{BuildHasherDefault, Hasher};
use std::sync::atomic::{AtomicU32, Ordering};

use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

use crate::fast_hasher::FastHasher;
use crate::raw::RawMesh;

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
    /// The facets' places in the file.
    pub numbers: Vec<u32>,
    /// Facets dropped for having no area.
    pub degenerate: u32,
    /// Facets dropped for having the same three vertices as an earlier one.
    pub duplicate: u32,
}

/// Welds `mesh` (m).
pub fn weld(mesh: &RawMesh) -> Welded {
    let RawMesh { vertices, triangles: corners } = mesh;
    let (mut low, mut high) = (Vector3::repeat(f64::INFINITY), Vector3::repeat(f64::NEG_INFINITY));
    for p in corners.iter().flatten().map(|v| &vertices[*v as usize]) {
        low = low.inf(&p.coords);
        high = high.sup(&p.coords);
    }
    let tolerance = ((high - low).norm() * RELATIVE_TOLERANCE).clamp(f64::MIN_POSITIVE, TOLERANCE_MAX);
    let same = weld_near(vertices, tolerance);

    let kept: Vec<[u32; 3]> = corners.par_iter().map(|t| t.map(|v| same[v as usize])).collect();
    let degenerate: Vec<bool> = kept.par_iter().map(|t| is_degenerate(*t, vertices)).collect();
    let repeated = repeated(&kept, vertices.len());
    let mut welded = Welded { triangles: Vec::with_capacity(kept.len()), ..Default::default() };
    let mut number = vec![u32::MAX; vertices.len()];
    for (place, ((corners, degenerate), repeated)) in kept.iter().zip(degenerate).zip(repeated).enumerate() {
        if degenerate || repeated {
            welded.degenerate += u32::from(degenerate);
            welded.duplicate += u32::from(!degenerate);
            continue;
        }
        welded.numbers.push(place as u32);
        welded.triangles.push(corners.map(|v| {
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

/// Whether an earlier one of `triangles`, over `count` vertices, has the same three vertices.
fn repeated(triangles: &[[u32; 3]], count: usize) -> Vec<bool> {
    // The triangles of every vertex that is the least of their three, one vertex after the other.
    let least = |t: &[u32; 3]| t[0].min(t[1]).min(t[2]) as usize;
    let mut ends = vec![0u32; count + 1];
    triangles.iter().for_each(|t| ends[least(t) + 1] += 1);
    (0..count).for_each(|v| ends[v + 1] += ends[v]);
    let mut of_vertex = vec![0u32; triangles.len()];
    for (i, t) in triangles.iter().enumerate() {
        let place = &mut ends[least(t)];
        of_vertex[*place as usize] = i as u32;
        *place += 1;
    }
    let key = |t: u32| {
        let mut key = triangles[t as usize];
        key.sort_unstable();
        (key, t)
    };
    let mut repeated = vec![false; triangles.len()];
    let mut start = 0;
    for end in ends.iter().take(count).map(|end| *end as usize) {
        let own = &mut of_vertex[start..end];
        start = end;
        if own.len() > 1 {
            own.sort_unstable_by_key(|t| key(*t));
            for pair in own.windows(2).filter(|pair| key(pair[0]).0 == key(pair[1]).0) {
                repeated[pair[1] as usize] = true;
            }
        }
    }
    repeated
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

/// For every vertex the first one within `tolerance` that stands for itself.
fn weld_near(vertices: &[Point3<f64>], tolerance: f64) -> Vec<u32> {
    let size = tolerance * CELL_TOLERANCES;
    // Grid places, and whether a vertex has to look into the next cell: both are found in parallel.
    let places: Vec<Place> = vertices
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
    let mut head: HashMap<[i64; 3], u32, BuildHasherDefault<FastHasher>> = HashMap::default();
    let mut next = vec![u32::MAX; vertices.len()];
    let mut same: Vec<u32> = (0..vertices.len() as u32).collect();
    for v in with_company(&places) {
        let (v, (cell, near)) = (v as usize, places[v as usize]);
        let mut best = u32::MAX;
        for key in cells_around(cell, near) {
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
            let slot = head.entry(cell).or_insert(u32::MAX);
            next[v] = *slot;
            *slot = v as u32;
        }
    }
    same
}

/// A vertex's cell, and for every axis the side, −1, 0 or 1, on which the next cell is within the tolerance.
type Place = ([i64; 3], [i64; 3]);

/// The cell and those next to it that the tolerance reaches into.
fn cells_around(cell: [i64; 3], near: [i64; 3]) -> impl Iterator<Item = [i64; 3]> {
    (0..8).filter_map(move |corner: usize| {
        let bits: [i64; 3] = std::array::from_fn(|k| (corner >> k & 1) as i64);
        let reached = (0..3).all(|k| bits[k] == 0 || near[k] != 0);
        reached.then(|| std::array::from_fn(|k| cell[k].wrapping_add(bits[k] * near[k])))
    })
}

/// The vertices, in order, that may have another one in a cell which they reach: all that have, and few more.
fn with_company(places: &[Place]) -> Vec<u32> {
    // Whether cells have one vertex, and another: a bit for each, shared by few enough cells to be seldom wrong.
    let words = (places.len() / 2).next_power_of_two();
    let bits = || (0..words).map(|_| AtomicU32::new(0)).collect::<Vec<_>>();
    let (one, another) = (bits(), bits());
    let place_of = |cell: [i64; 3]| {
        let mut hasher = FastHasher::default();
        cell.into_iter().for_each(|x| hasher.write_i64(x));
        let hash = hasher.finish() as usize;
        ((hash >> 5) & (words - 1), 1u32 << (hash & 31))
    };
    places.par_iter().for_each(|(cell, _)| {
        let (word, bit) = place_of(*cell);
        if one[word].fetch_or(bit, Ordering::Relaxed) & bit != 0 {
            another[word].fetch_or(bit, Ordering::Relaxed);
        }
    });
    let is_set = |bits: &[AtomicU32], cell: [i64; 3]| {
        let (word, bit) = place_of(cell);
        bits[word].load(Ordering::Relaxed) & bit != 0
    };
    let has_company = |(cell, near): &Place| {
        is_set(&another, *cell) || cells_around(*cell, *near).skip(1).any(|next| is_set(&one, next))
    };
    let company: Vec<bool> = places.par_iter().map(has_company).collect();
    (0..places.len() as u32).filter(|v| company[*v as usize]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::share_vertices::share_vertices;

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
        let welded = weld(&share_vertices(&facets));
        assert_eq!(welded.triangles, [[0, 1, 2], [0, 2, 3], [0, 4, 2]]);
        assert_eq!(welded.numbers, [0, 1, 5]);
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
