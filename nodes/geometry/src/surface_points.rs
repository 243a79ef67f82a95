//! Points of the smooth surface that a mesh stands for, no further apart than asked for.

use nalgebra::{Point3, Vector3};

use crate::mesh::TriangleMesh;

/// Most points that are added to the vertices: beyond that the spacing is widened.
const MOST_ADDED: f64 = 1e6;

/// Points and unit normals of a smooth surface.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SurfacePoints {
    /// Positions, m, `workpiece` frame.
    pub points: Vec<Point3<f64>>,
    /// Unit normals on the tool side, as long as `points`.
    pub normals: Vec<Vector3<f64>>,
    /// A triangle that the point belongs to, as long as `points`.
    pub triangles: Vec<u32>,
}

impl SurfacePoints {
    /// The vertices of all triangles of `mesh`, and on edges and facets longer than `spacing` (m) a lattice of
    /// points no further apart, moved to the smooth surface by [`TriangleMesh::smooth_point`].
    ///
    /// At most a million points are added, with a wider spacing where need be. The indices of the mesh are valid.
    pub fn of(mesh: &TriangleMesh, spacing: f64) -> Self {
        const UNUSED: u32 = u32::MAX;
        let mut user = vec![UNUSED; mesh.vertices.len()];
        for (t, corners) in mesh.triangles.iter().enumerate() {
            corners.iter().for_each(|&v| user[v as usize] = t as u32);
        }
        let vertices = || (0..user.len()).filter(|&v| user[v] != UNUSED);
        let mut found = Self {
            points: vertices().map(|v| mesh.vertices[v]).collect(),
            normals: vertices().map(|v| mesh.normals[v]).collect(),
            triangles: vertices().map(|v| user[v]).collect(),
        };
        let spacing = affordable(mesh, spacing);
        let mut long_edges = Vec::new();
        for t in 0..mesh.triangles.len() {
            let parts = edge_lengths(mesh, t).map(|length| parts_of(length, spacing));
            for (k, &parts) in parts.iter().enumerate().filter(|(_, parts)| **parts > 1) {
                let (a, b) = (mesh.triangles[t][k], mesh.triangles[t][(k + 1) % 3]);
                long_edges.push(((a.min(b), a.max(b)), t, k, parts));
            }
            let most = parts[0].max(parts[1]).max(parts[2]);
            for i in 1..most {
                for j in 1..most - i {
                    found.add(mesh, t, [i, j, most - i - j].map(|w| w as f64 / most as f64));
                }
            }
        }
        // Each edge once: neighbours see the same points on it.
        long_edges.sort_unstable();
        long_edges.dedup_by_key(|edge| edge.0);
        for (_, t, k, parts) in long_edges {
            for i in 1..parts {
                let mut weights = [0.0; 3];
                weights[k] = (parts - i) as f64 / parts as f64;
                weights[(k + 1) % 3] = i as f64 / parts as f64;
                found.add(mesh, t, weights);
            }
        }
        found
    }

    fn add(&mut self, mesh: &TriangleMesh, t: usize, weights: [f64; 3]) {
        let (point, normal) = mesh.smooth_point(t, weights);
        // Opposite vertex normals have no mean.
        if point.iter().chain(normal.iter()).all(|c| c.is_finite()) {
            self.points.push(point);
            self.normals.push(normal);
            self.triangles.push(t as u32);
        }
    }
}

fn edge_lengths(mesh: &TriangleMesh, t: usize) -> [f64; 3] {
    let p = mesh.corners(t);
    [0, 1, 2].map(|k| (p[(k + 1) % 3] - p[k]).norm())
}

fn parts_of(length: f64, spacing: f64) -> usize {
    (length / spacing).ceil().max(1.0) as usize
}

/// `spacing`, or more where it would take too many points.
fn affordable(mesh: &TriangleMesh, spacing: f64) -> f64 {
    let mut spacing = spacing.max(f64::MIN_POSITIVE);
    loop {
        let added = |t: usize| {
            let lengths = edge_lengths(mesh, t);
            let parts = (lengths[0].max(lengths[1]).max(lengths[2]) / spacing).ceil();
            if parts > 1.0 { 0.5 * (parts + 1.0) * (parts + 2.0) - 3.0 } else { 0.0 }
        };
        let total: f64 = (0..mesh.triangles.len()).map(added).sum();
        if total <= MOST_ADDED || !total.is_finite() && spacing > 1e300 {
            return spacing;
        }
        spacing *= (total / MOST_ADDED).sqrt().clamp(1.1, 1e30);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_meshes::height_field;

    #[test]
    fn no_point_of_a_facet_is_far_from_the_set() {
        // Facets of 20 × 10 mm and up, a plane.
        let mesh = height_field(2, 0.02, |_, _| 0.0);
        let spacing = 0.003;
        let found = SurfacePoints::of(&mesh, spacing);
        for i in 0..=100 {
            for j in 0..=100 {
                let p = Point3::new(-0.02 + 4e-4 * f64::from(i), -0.02 + 4e-4 * f64::from(j), 0.0);
                let nearest = found.points.iter().map(|q| (q - p).norm()).fold(f64::INFINITY, f64::min);
                assert!(nearest <= 0.71 * spacing, "{p}: {nearest}");
            }
        }
        // No point twice.
        let mut keys: Vec<[i64; 2]> =
            found.points.iter().map(|p| [p.x, p.y].map(|c| (c * 1e9).round() as i64)).collect();
        keys.sort_unstable();
        assert!(keys.windows(2).all(|w| w[0] != w[1]));
    }

    #[test]
    fn fine_meshes_give_their_vertices_and_coarse_ones_stay_affordable() {
        let mesh = height_field(10, 0.02, |x, y| x * y);
        assert_eq!(SurfacePoints::of(&mesh, 0.01).points, mesh.vertices);
        for spacing in [1e-6, 0.0] {
            let many = SurfacePoints::of(&mesh, spacing).points.len();
            assert!(many > 500_000 && many < 1_100_000, "{many}");
        }
    }
}
