//! The shadow of the tool: shadow-check points on concentric circles in the tangent plane, projected on the mesh.

use std::f64::consts::TAU;

use nalgebra::{Point3, Vector3};
use patchmill_geometry::bvh::Bvh;
use patchmill_geometry::mesh::TriangleMesh;
use patchmill_geometry::mesh_topology::MeshTopology;

/// Cells along each side of the lookup grid; about the spacing of 500 points, and its sums fit the first-level
/// cache.
const CELLS: usize = 128;
/// Up to so many points in the cells of a rectangle are looked at one by one.
const FEW: u32 = 8;
/// Barycentric weights down to minus this still count as inside, so that no line is lost between two facets.
const INSIDE: f64 = 1e-9;
/// Projected boxes are widened by this share of the shadow radius.
const ROUNDING: f64 = 1e-9;
/// Facets whose projected area is less than this share of their squared longest edge are seen edge-on.
const EDGE_ON: f64 = 1e-9;

/// Shadow-check points in the unit disc, with a grid that tells in constant time which rectangles hold none.
#[derive(Clone, Debug)]
pub struct ShadowPattern {
    circles: usize,
    /// Points ordered by cell.
    points: Vec<[f64; 2]>,
    /// First point of every cell, row by row, and the number of points at the end.
    cell_start: Vec<u32>,
    /// `sums[(CELLS + 1)·row + column]`: points in the cells below `row` and left of `column`.
    sums: Vec<u32>,
}

impl ShadowPattern {
    /// `circles` circles at radius i/`circles`, each with `per_circle` points, the first on the first axis.
    pub fn new(circles: usize, per_circle: usize) -> Self {
        let mut points: Vec<[f64; 2]> = (1..=circles)
            .flat_map(|i| (0..per_circle).map(move |j| (i, j)))
            .map(|(i, j)| {
                let (sin, cos) = (TAU * j as f64 / per_circle as f64).sin_cos();
                let radius = i as f64 / circles as f64;
                [radius * cos, radius * sin]
            })
            .collect();
        let cell_of = |p: &[f64; 2]| cell(p[1]) * CELLS + cell(p[0]);
        points.sort_by_key(cell_of);
        let mut counts = vec![0u32; CELLS * CELLS];
        points.iter().for_each(|p| counts[cell_of(p)] += 1);
        let mut cell_start = vec![0u32; CELLS * CELLS + 1];
        for (i, n) in counts.iter().enumerate() {
            cell_start[i + 1] = cell_start[i] + n;
        }
        let mut sums = vec![0u32; (CELLS + 1) * (CELLS + 1)];
        for row in 0..CELLS {
            for column in 0..CELLS {
                sums[(row + 1) * (CELLS + 1) + column + 1] = counts[row * CELLS + column]
                    + sums[row * (CELLS + 1) + column + 1]
                    + sums[(row + 1) * (CELLS + 1) + column]
                    - sums[row * (CELLS + 1) + column];
            }
        }
        Self { circles, points, cell_start, sums }
    }

    /// Number of circles.
    pub fn circles(&self) -> usize {
        self.circles
    }

    /// Whether the rectangle holds a point; `true` without a closer look where many are near.
    #[inline]
    fn touches(&self, min: [f64; 2], max: [f64; 2]) -> bool {
        if min[0] > 1.0 || min[1] > 1.0 || max[0] < -1.0 || max[1] < -1.0 {
            return false;
        }
        let (left, right) = (cell(min[0]), cell(max[0]) + 1);
        let (low, high) = (cell(min[1]) * (CELLS + 1), (cell(max[1]) + 1) * (CELLS + 1));
        // Each side is a sum of disjoint parts: no underflow in this order.
        let near = (self.sums[high + right] + self.sums[low + left])
            - (self.sums[high + left] + self.sums[low + right]);
        if near == 0 || near > FEW {
            return near != 0;
        }
        let mut inside = false;
        self.for_each_near(min, max, |p| {
            inside |= (p[0] >= min[0]) & (p[0] <= max[0]) & (p[1] >= min[1]) & (p[1] <= max[1]);
        });
        inside
    }

    /// Visits the points of all cells that the rectangle touches.
    #[inline]
    fn for_each_near(&self, min: [f64; 2], max: [f64; 2], mut visit: impl FnMut(&[f64; 2])) {
        let (left, right) = (cell(min[0]), cell(max[0]) + 1);
        for row in cell(min[1])..=cell(max[1]) {
            let start = self.cell_start[row * CELLS + left] as usize;
            let end = self.cell_start[row * CELLS + right] as usize;
            self.points[start..end].iter().for_each(&mut visit);
        }
    }
}

/// Cell of a coordinate in [-1, 1]; others go to the nearest.
#[inline]
fn cell(v: f64) -> usize {
    // A float-to-integer cast saturates: what lies below goes to 0.
    (((v + 1.0) * (0.5 * CELLS as f64)) as usize).min(CELLS - 1)
}

/// A sample's tangent plane.
#[derive(Clone, Copy, Debug)]
pub struct TangentFrame {
    /// The sample, m.
    pub origin: Point3<f64>,
    /// Unit normal on the tool side.
    pub normal: Vector3<f64>,
    first: Vector3<f64>,
    second: Vector3<f64>,
}

impl TangentFrame {
    /// The frame whose first axis is `direction`, made perpendicular to the unit `normal`, or any perpendicular
    /// where that is not possible.
    pub fn new(origin: Point3<f64>, normal: Vector3<f64>, direction: &Vector3<f64>) -> Self {
        let across = |v: &Vector3<f64>| (v - normal * normal.dot(v)).try_normalize(1e-6);
        // Of x and y at least one is well away from any normal.
        let fallback = if normal.x.abs() < 0.8 { Vector3::x() } else { Vector3::y() };
        let first = across(direction).or_else(|| across(&fallback)).unwrap_or_else(Vector3::x);
        Self { origin, normal, first, second: normal.cross(&first) }
    }
}

/// Visits every point of the smooth surface that the shadow-check points of radius `radius` (m) meet: the
/// normal line through each is cut with all facets, and the facet points are moved to the smooth surface.
///
/// A point off the surface is not visited, one over several sheets is visited several times, one on an edge
/// of the mesh perhaps twice. Facets below the tangent plane that show their back are the far side of a solid
/// part and do not count.
pub fn for_each_shadow_point(
    bvh: &Bvh,
    mesh: &TriangleMesh,
    frame: &TangentFrame,
    radius: f64,
    pattern: &ShadowPattern,
    mut visit: impl FnMut(Point3<f64>),
) {
    let per_radius = 1.0 / radius;
    let (u_axis, v_axis) = (frame.first * per_radius, frame.second * per_radius);
    let (u_size, v_size) = (u_axis.abs(), v_axis.abs());
    let o = frame.origin;
    let enter = |min: &[f64; 3], max: &[f64; 3]| {
        let centre = Vector3::from_fn(|k, _| 0.5 * (min[k] + max[k]) - o[k]);
        let half = Vector3::from_fn(|k, _| 0.5 * (max[k] - min[k]));
        let (x, y) = (centre.dot(&u_axis), centre.dot(&v_axis));
        let (dx, dy) = (half.dot(&u_size) + ROUNDING, half.dot(&v_size) + ROUNDING);
        pattern.touches([x - dx, y - dy], [x + dx, y + dy])
    };
    bvh.for_each_triangle(enter, |t| {
        let project = |v: u32| {
            let d = mesh.vertices[v as usize] - o;
            [d.dot(&u_axis), d.dot(&v_axis)]
        };
        let [i, j, k] = mesh.triangles[t as usize];
        let (a, b, c) = (project(i), project(j), project(k));
        let min = [a[0].min(b[0]).min(c[0]) - ROUNDING, a[1].min(b[1]).min(c[1]) - ROUNDING];
        let max = [a[0].max(b[0]).max(c[0]) + ROUNDING, a[1].max(b[1]).max(c[1]) + ROUNDING];
        if min[0] > 1.0 || min[1] > 1.0 || max[0] < -1.0 || max[1] < -1.0 {
            return;
        }
        let area = cross(a, b, c);
        let longest = (max[0] - min[0]).max(max[1] - min[1]);
        if area.abs() <= EDGE_ON * longest * longest {
            return;
        }
        pattern.for_each_near(min, max, |p| {
            let w = [cross(*p, b, c) / area, cross(a, *p, c) / area, cross(a, b, *p) / area];
            if (w[0] < -INSIDE) | (w[1] < -INSIDE) | (w[2] < -INSIDE) {
                return;
            }
            let q = mesh.smooth_point(t as usize, w).0;
            if area > 0.0 || (q - o).dot(&frame.normal) >= 0.0 {
                visit(q);
            }
        });
    });
}

/// Vertices on the border of the mesh, holes included, with their normals.
///
/// Beside a border the outermost circle that still meets the surface can end up to one ring's width short of it;
/// with a curvature that grows toward the border the ball would then dip into the surface there, by 0.1 mm on a
/// gentle part. The border's own points close that gap.
#[derive(Clone, Debug, Default)]
pub struct Border(Vec<(Point3<f64>, Vector3<f64>)>);

impl Border {
    /// The border of a mesh whose indices are valid; empty for a closed one.
    pub fn of(mesh: &TriangleMesh) -> Self {
        let topology = MeshTopology::of(mesh);
        let border = (0..mesh.vertices.len()).filter(|&v| topology.is_border(v));
        Self(border.map(|v| (mesh.vertices[v], mesh.normals[v])).collect())
    }

    /// Visits the border points whose distance from the sample in the tangent plane is within `range` (m). The
    /// lower bound keeps out points so near that their rounding would pass for curvature.
    pub fn for_each_in(&self, frame: &TangentFrame, range: (f64, f64), mut visit: impl FnMut(Point3<f64>)) {
        let (low, high) = (range.0 * range.0, range.1 * range.1);
        for (p, normal) in &self.0 {
            let d = p - frame.origin;
            let height = d.dot(&frame.normal);
            let across = d.norm_squared() - height * height;
            if across >= low && across <= high && (height >= 0.0 || normal.dot(&frame.normal) > 0.0) {
                visit(*p);
            }
        }
    }
}

/// Twice the signed area of a triangle in the plane.
fn cross(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> f64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_surfaces::{Surface, grid_mesh};

    fn shadow_points(surface: &Surface, cells: usize, frame: &TangentFrame, radius: f64) -> Vec<Point3<f64>> {
        let mesh = grid_mesh(surface, cells);
        let mut found = Vec::new();
        let pattern = ShadowPattern::new(5, 100);
        for_each_shadow_point(&Bvh::build(&mesh), &mesh, frame, radius, &pattern, |q| found.push(q));
        found
    }

    #[test]
    fn pattern_lookup_agrees_with_a_full_search() {
        let pattern = ShadowPattern::new(5, 100);
        assert_eq!(pattern.points.len(), 500);
        for i in 0..2000 {
            let value = |k: usize| ((i * (7 + 2 * k) + k * 31) % 101) as f64 / 40.0 - 1.25;
            let (min, size) = ([value(0), value(1)], [value(2).abs() * 0.3, value(3).abs() * 0.3]);
            let max = [min[0] + size[0], min[1] + size[1]];
            let inside = |p: &[f64; 2]| (0..2).all(|k| p[k] >= min[k] && p[k] <= max[k]);
            let expected = pattern.points.iter().filter(|p| inside(p)).count();
            let mut found = 0;
            pattern.for_each_near(min, max, |p| found += usize::from(inside(p)));
            assert_eq!(found, expected);
            assert!(expected == 0 || pattern.touches(min, max));
        }
    }

    #[test]
    fn lines_through_edges_and_vertices_are_not_lost() {
        // 20 mm plane of 20 cells: many of the 500 lines hit edges, the centre lies on a vertex.
        let plane = Surface::plane(0.020);
        let frame = TangentFrame::new(Point3::origin(), Vector3::z(), &Vector3::x());
        let found = shadow_points(&plane, 20, &frame, 0.005);
        for i in 1..=5 {
            for j in 0..100 {
                let (sin, cos) = (TAU * f64::from(j) / 100.0).sin_cos();
                let p = Point3::new(cos, sin, 0.0) * (0.001 * f64::from(i));
                assert!(found.iter().any(|q| (q - p).norm() < 1e-12), "circle {i}, point {j} is lost");
            }
        }
    }

    #[test]
    fn points_off_the_surface_are_skipped() {
        let plane = Surface::plane(0.020);
        let corner = TangentFrame::new(Point3::new(0.01, 0.01, 0.0), Vector3::z(), &Vector3::x());
        let found = shadow_points(&plane, 21, &corner, 0.005);
        assert!(found.iter().all(|q| q.x <= 0.01 + 1e-9 && q.y <= 0.01 + 1e-9));
        assert!((125..=150).contains(&found.len()), "{}", found.len());
    }

    #[test]
    fn frame_survives_a_useless_direction() {
        for normal in [Vector3::x(), Vector3::y(), Vector3::z(), Vector3::new(0.6, -0.48, 0.64)] {
            for direction in [normal, Vector3::zeros(), Vector3::new(1.0, 2.0, 3.0)] {
                let f = TangentFrame::new(Point3::origin(), normal, &direction);
                assert!((f.first.norm() - 1.0).abs() < 1e-12 && (f.second.norm() - 1.0).abs() < 1e-12);
                assert!(f.first.dot(&normal).abs() < 1e-12 && f.second.dot(&normal).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn all_sheets_count_but_not_the_far_side_of_a_solid() {
        let mut mesh = grid_mesh(&Surface::plane(0.020), 7);
        let (n, m) = (mesh.vertices.len() as u32, mesh.triangles.len());
        // A roof 3 mm above and the back of the part 3 mm below, both facing down.
        for z in [0.003, -0.003] {
            for i in 0..n as usize {
                let p = mesh.vertices[i];
                mesh.vertices.push(Point3::new(p.x, p.y, z));
                mesh.normals.push(-Vector3::z());
            }
        }
        for sheet in 1..=2 {
            for t in 0..m {
                let [a, b, c] = mesh.triangles[t].map(|v| v + sheet * n);
                mesh.triangles.push([a, c, b]);
            }
        }
        let frame = TangentFrame::new(Point3::new(1e-4, 2e-4, 0.0), Vector3::z(), &Vector3::x());
        let mut heights = Vec::new();
        for_each_shadow_point(&Bvh::build(&mesh), &mesh, &frame, 0.005, &ShadowPattern::new(5, 100), |q| {
            heights.push(q.z);
        });
        assert!(heights.iter().filter(|&&z| z == 0.0).count() >= 500);
        assert!(heights.iter().filter(|&&z| z > 0.002).count() >= 500);
        assert!(heights.iter().all(|&z| z > -0.002));
    }
}
