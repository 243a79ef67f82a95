//! Plane polygons cut into triangles.

use nalgebra::{Point3, Vector2, Vector3};

/// Most corners of a polygon.
pub const CORNERS_MAX: usize = 1000;

/// Appends the triangles of the polygon of `corners` (3 to [`CORNERS_MAX`] indices into `vertices`, in range) with its winding: a
/// fan where the polygon is convex, else its ears as seen along its mean normal. n corners give n − 2 triangles.
pub fn triangulate(corners: &[u32], vertices: &[Point3<f64>], triangles: &mut Vec<[u32; 3]>) {
    if let &[a, b, c] = corners {
        triangles.push([a, b, c]);
        return;
    }
    let flat = flatten(corners, vertices);
    let rounding = 1e-12 * flat.iter().map(|p| p.norm_squared()).fold(0.0, f64::max);
    let mut left: Vec<usize> = (0..corners.len()).collect();
    while left.len() > 2 {
        let Some(k) = (0..left.len()).find(|k| is_ear(&flat, &left, *k, rounding)) else {
            // A polygon that crosses itself may have none: a fan then does as well, and no more time is spent.
            triangles
                .extend(left[1..].windows(2).map(|side| [left[0], side[0], side[1]].map(|i| corners[i])));
            return;
        };
        let [before, after] = around(&left, k);
        triangles.push([before, left[k], after].map(|i| corners[i]));
        left.remove(k);
    }
}

fn around(left: &[usize], k: usize) -> [usize; 2] {
    let n = left.len();
    [left[(k + n - 1) % n], left[(k + 1) % n]]
}

/// The corners in the plane across the polygon's area vector, counter-clockwise.
fn flatten(corners: &[u32], vertices: &[Point3<f64>]) -> Vec<Vector2<f64>> {
    let origin = vertices[corners[0] as usize];
    let at = |i: usize| vertices[corners[i % corners.len()] as usize] - origin;
    let normal: Vector3<f64> = (0..corners.len()).map(|i| at(i).cross(&at(i + 1))).sum();
    let normal = normal.try_normalize(0.0).unwrap_or_else(Vector3::z);
    let (s, t) = patchmill_geometry::curvature::tangents(&normal);
    (0..corners.len()).map(|i| Vector2::new(at(i).dot(&s), at(i).dot(&t))).collect()
}

/// Whether corner `k` of those `left` is convex and its triangle holds no other corner, nor has one on its sides; areas up to
/// `rounding` are none.
fn is_ear(flat: &[Vector2<f64>], left: &[usize], k: usize, rounding: f64) -> bool {
    let [before, after] = around(left, k);
    let (a, b, c) = (flat[before], flat[left[k]], flat[after]);
    let cross = |p: Vector2<f64>, q: Vector2<f64>, r: Vector2<f64>| (q - p).perp(&(r - p));
    cross(a, b, c) > rounding
        && left.iter().filter(|i| **i != before && **i != left[k] && **i != after).all(|i| {
            let p = flat[*i];
            cross(a, b, p) < -rounding
                || cross(b, c, p) < -rounding
                || cross(c, a, p) < -rounding
                || p == a
                || p == c
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cut(outline: &[[f64; 2]]) -> (Vec<[u32; 3]>, f64) {
        let vertices: Vec<_> = outline.iter().map(|[x, y]| Point3::new(*x, *y, 0.3 * x - 0.1 * y)).collect();
        let corners: Vec<u32> = (0..outline.len() as u32).collect();
        let mut triangles = Vec::new();
        triangulate(&corners, &vertices, &mut triangles);
        let area = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|v| vertices[v as usize]);
            0.5 * (b - a).cross(&(c - a)).z
        };
        assert!(triangles.iter().all(|t| area(t) > 0.0), "{triangles:?}");
        let total = triangles.iter().map(area).sum();
        (triangles, total)
    }

    #[test]
    fn convex_and_concave_outlines_keep_area_and_winding() {
        assert_eq!(cut(&[[0., 0.], [2., 0.], [2., 1.], [0., 1.]]), (vec![[3, 0, 1], [3, 1, 2]], 2.0));
        // An arrow head, whose diagonal 0–2 would lie outside.
        let (triangles, area) = cut(&[[0., 0.], [1., 2.], [0., 1.], [-1., 2.]].map(|[x, y]| [x, y]));
        assert_eq!(triangles.len(), 2);
        assert!((area - 1.0).abs() < 1e-12);
        // A comb.
        let comb = [
            [0., 0.],
            [5., 0.],
            [5., 2.],
            [4., 2.],
            [4., 1.],
            [3., 1.],
            [3., 2.],
            [2., 2.],
            [2., 1.],
            [0., 1.],
        ];
        let (triangles, area) = cut(&comb);
        assert_eq!(triangles.len(), 8);
        assert!((area - 7.0).abs() < 1e-12);
    }

    #[test]
    fn what_has_no_ears_becomes_a_fan_at_once() {
        let vertices = vec![Point3::origin(); CORNERS_MAX];
        let corners: Vec<u32> = (0..CORNERS_MAX as u32).collect();
        let mut triangles = Vec::new();
        triangulate(&corners, &vertices, &mut triangles);
        let fan: Vec<[u32; 3]> = corners[1..].windows(2).map(|side| [0, side[0], side[1]]).collect();
        assert_eq!(triangles, fan);
    }
}
