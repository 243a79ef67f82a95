//! Intersections of a line with a mesh, without gaps at shared edges and vertices.

use nalgebra::{Point3, Vector3};

use crate::bvh::{Aabb, Bvh};
use crate::mesh::TriangleMesh;

/// Barycentric weights down to minus this still count as inside and are clamped.
const INSIDE: f64 = 1e-10;
/// Boxes are widened by this share of the coordinates' magnitude.
const WIDEN: f64 = 1e-12;

/// One intersection of a line with a triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Index of the triangle in the mesh.
    pub triangle: u32,
    /// Weights of its corners, each in [0, 1], sum 1.
    pub barycentric: [f64; 3],
    /// Signed parameter t along the direction as given (m for a unit direction).
    pub distance: f64,
}

impl Bvh {
    /// Visits every intersection of the line origin + t·direction with t in `range` (inclusive), in no
    /// particular but always the same order. `mesh` is the mesh that the hierarchy was built over.
    ///
    /// No line through the inside of the mesh is lost between triangles: one through a shared edge or vertex
    /// is reported by at least one of its triangles, usually by all of them. Triangles seen edge-on are skipped.
    pub fn for_each_hit(
        &self,
        mesh: &TriangleMesh,
        origin: &Point3<f64>,
        direction: &Vector3<f64>,
        range: (f64, f64),
        visit: &mut impl FnMut(Hit),
    ) {
        self.traverse(mesh, origin, direction, range, |hit, _| visit(hit));
    }

    /// The hit with the least t in `range`; of equal ones that of the lowest triangle index.
    pub fn first_hit(
        &self,
        mesh: &TriangleMesh,
        origin: &Point3<f64>,
        direction: &Vector3<f64>,
        range: (f64, f64),
    ) -> Option<Hit> {
        let mut first: Option<Hit> = None;
        self.traverse(mesh, origin, direction, range, |hit, end| {
            let better = first.is_none_or(|f| (hit.distance, hit.triangle) < (f.distance, f.triangle));
            if better {
                first = Some(hit);
                *end = hit.distance;
            }
        });
        first
    }

    /// Depth-first, nearer child first; `visit` may lower the end of the range.
    fn traverse(
        &self,
        mesh: &TriangleMesh,
        origin: &Point3<f64>,
        direction: &Vector3<f64>,
        range: (f64, f64),
        mut visit: impl FnMut(Hit, &mut f64),
    ) {
        let (begin, mut end) = range;
        let Some(line) = Line::new(origin, direction) else { return };
        let Some(root) = self.bounds.first() else { return };
        let magnitude = (0..3).map(|k| root.aabb.min[k].abs().max(root.aabb.max[k].abs()) + origin[k].abs());
        let widen = WIDEN * magnitude.fold(0.0, f64::max);
        let enter = |node: usize, end: f64| line.enter(&self.bounds[node].aabb, widen, begin, end);
        let mut stack = [(0u32, 0.0f64); 64];
        let mut depth = 0;
        let mut next = enter(0, end).map(|t| (0usize, t));
        while let Some((node, t_enter)) = next.take() {
            let split = &self.splits[node];
            if t_enter > end {
                // nothing nearer in here
            } else if split.right == 0 {
                for &t in &self.order[split.range()] {
                    if let Some((distance, barycentric)) = line.meet(&mesh.corners(t as usize))
                        && distance >= begin
                        && distance <= end
                    {
                        visit(Hit { triangle: t, barycentric, distance }, &mut end);
                    }
                }
            } else {
                let (l, r) = (node + 1, split.right as usize);
                next = match (enter(l, end), enter(r, end)) {
                    (Some(a), Some(b)) => {
                        let (near, far) = if a <= b { ((l, a), (r, b)) } else { ((r, b), (l, a)) };
                        stack[depth] = (far.0 as u32, far.1);
                        depth += 1;
                        Some(near)
                    }
                    (Some(a), None) => Some((l, a)),
                    (None, b) => b.map(|b| (r, b)),
                };
            }
            if next.is_none() && depth > 0 {
                depth -= 1;
                next = Some((stack[depth].0 as usize, stack[depth].1));
            }
        }
    }
}

/// A line ready for intersection by the watertight scheme of Woop, Benthin and Wald (2013): corners are
/// sheared into the frame of the line, where the edge function of a shared edge has the same digits in both
/// triangles, so that no line passes between them.
struct Line {
    origin: Point3<f64>,
    inverse: [f64; 3],
    axes: [usize; 3],
    shear: [f64; 3],
}

impl Line {
    fn new(origin: &Point3<f64>, direction: &Vector3<f64>) -> Option<Self> {
        let z = direction.iamax();
        let (x, y) = ((z + 1) % 3, (z + 2) % 3);
        let d = direction;
        if d[z] == 0.0 || !d[z].is_finite() {
            return None;
        }
        let shear = [d[x] / d[z], d[y] / d[z], 1.0 / d[z]];
        Some(Self { origin: *origin, inverse: [1.0 / d.x, 1.0 / d.y, 1.0 / d.z], axes: [x, y, z], shear })
    }

    /// Where the line enters the widened box within the range, if it does.
    fn enter(&self, aabb: &Aabb, widen: f64, begin: f64, end: f64) -> Option<f64> {
        let (mut near, mut far) = (begin, end);
        for k in 0..3 {
            let low = aabb.min[k] - widen - self.origin[k];
            let high = aabb.max[k] + widen - self.origin[k];
            if self.inverse[k].is_infinite() {
                if low > 0.0 || high < 0.0 {
                    return None;
                }
                continue;
            }
            let (a, b) = (low * self.inverse[k], high * self.inverse[k]);
            near = near.max(a.min(b));
            far = far.min(a.max(b));
        }
        (near <= far).then_some(near)
    }

    /// Distance and clamped barycentric weights.
    fn meet(&self, corners: &[Point3<f64>; 3]) -> Option<(f64, [f64; 3])> {
        let [x, y, z] = self.axes;
        let local = corners.map(|p| {
            let p = p - self.origin;
            [p[x] - self.shear[0] * p[z], p[y] - self.shear[1] * p[z], self.shear[2] * p[z]]
        });
        let [a, b, c] = local;
        let raw = [c[0] * b[1] - c[1] * b[0], a[0] * c[1] - a[1] * c[0], b[0] * a[1] - b[1] * a[0]];
        let det = raw[0] + raw[1] + raw[2];
        if det == 0.0 || !det.is_finite() {
            return None;
        }
        let weights = raw.map(|w| w / det);
        // `>=` twice over: same signs are exact at shared edges, the tolerance serves the rest.
        if weights.iter().any(|&w| w < -INSIDE) {
            return None;
        }
        let clamped = weights.map(|w| w.max(0.0));
        let sum: f64 = clamped.iter().sum();
        let w = clamped.map(|w| w / sum);
        let distance = w[0] * a[2] + w[1] * b[2] + w[2] * c[2];
        Some((distance, w))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_meshes::{Random, bumpy, random_soup};

    fn all_hits(bvh: &Bvh, mesh: &TriangleMesh, o: &Point3<f64>, d: &Vector3<f64>) -> Vec<Hit> {
        let mut hits = Vec::new();
        bvh.for_each_hit(mesh, o, d, (-1.0, 1.0), &mut |h| hits.push(h));
        hits.sort_by_key(|h| h.triangle);
        hits
    }

    #[test]
    fn hits_match_all_triangles() {
        let mesh = random_soup(400, 3);
        let bvh = Bvh::build(&mesh);
        let mut random = Random::new(11);
        let mut found = 0;
        for _ in 0..500 {
            let o = Point3::new(
                random.in_range(-0.05, 0.05),
                random.in_range(-0.05, 0.05),
                random.in_range(-0.05, 0.05),
            );
            let d = random.unit_vector();
            let line = Line::new(&o, &d).unwrap();
            let expected: Vec<(u32, f64)> = (0..mesh.triangles.len())
                .filter_map(|t| line.meet(&mesh.corners(t)).map(|(x, _)| (t as u32, x)))
                .filter(|(_, x)| x.abs() <= 1.0)
                .collect();
            let hits = all_hits(&bvh, &mesh, &o, &d);
            assert_eq!(hits.iter().map(|h| (h.triangle, h.distance)).collect::<Vec<_>>(), expected);
            for h in &hits {
                let c = mesh.corners(h.triangle as usize);
                let p = c[0].coords * h.barycentric[0]
                    + c[1].coords * h.barycentric[1]
                    + c[2].coords * h.barycentric[2];
                assert!((p - (o + d * h.distance).coords).norm() < 1e-12);
            }
            let first = bvh.first_hit(&mesh, &o, &d, (-1.0, 1.0)).map(|h| h.distance);
            assert_eq!(first, expected.iter().map(|e| e.1).min_by(f64::total_cmp));
            found += hits.len();
        }
        assert!(found > 500);
    }

    #[test]
    fn no_line_is_lost_at_shared_edges_and_vertices() {
        let mesh = bumpy(24, 0.05, 0.003);
        let bvh = Bvh::build(&mesh);
        let mut random = Random::new(5);
        for t in 0..mesh.triangles.len() {
            let c = mesh.corners(t);
            let s = random.in_range(0.0, 1.0);
            for p in [c[0], c[0] + (c[1] - c[0]) * s, c[1] + (c[2] - c[1]) * 0.5] {
                let on_border = p.x.abs() > 0.0499 || p.y.abs() > 0.0499;
                for d in [Vector3::z(), Vector3::new(0.1, -0.2, -1.0).normalize()] {
                    let far = p - d * 0.3;
                    let hit = bvh.first_hit(&mesh, &far, &d, (0.0, 1.0));
                    assert!(on_border || hit.is_some_and(|h| (h.distance - 0.3).abs() < 1e-12), "{p} {d}");
                }
            }
        }
    }

    #[test]
    fn range_is_respected_and_direction_keeps_its_length() {
        let mesh = bumpy(8, 0.05, 0.0);
        let bvh = Bvh::build(&mesh);
        let o = Point3::new(0.011, 0.007, 0.2);
        let down = Vector3::new(0.0, 0.0, -2.0);
        let hit = bvh.first_hit(&mesh, &o, &down, (0.0, 1.0)).unwrap();
        assert!((hit.distance - 0.1).abs() < 1e-15);
        assert!(bvh.first_hit(&mesh, &o, &down, (0.0, 0.09)).is_none());
        assert!(bvh.first_hit(&mesh, &o, &down, (-1.0, 0.0)).is_none());
        assert!(bvh.first_hit(&mesh, &o, &Vector3::zeros(), (-1.0, 1.0)).is_none());
    }
}
