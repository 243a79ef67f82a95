//! An indexed triangle mesh with the normals of the smooth surface that it stands for.

use nalgebra::{Point3, Vector3};

/// Triangles over shared vertices, counter-clockwise as seen from the tool side, `workpiece` frame, metres.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TriangleMesh {
    /// Vertex positions, m.
    pub vertices: Vec<Point3<f64>>,
    /// Unit normals of the smooth surface at the vertices, on the tool side; as long as `vertices`.
    pub normals: Vec<Vector3<f64>>,
    /// Vertex indices, three a triangle.
    pub triangles: Vec<[u32; 3]>,
    /// Largest distance between a facet and the smooth surface, m: a bound for analytic surfaces, an estimate
    /// from the vertex normals for measured meshes.
    pub chord_error: f64,
    /// Facets that are not to be finished, only not to be gouged: as long as `triangles`, or empty where all are finished.
    pub check_only: Vec<bool>,
}

impl TriangleMesh {
    /// Whether triangle `t` is to be finished.
    pub fn is_finished(&self, t: usize) -> bool {
        self.check_only.get(t).is_none_or(|check_only| !check_only)
    }

    /// Area of the finished triangles, m².
    pub fn finished_area(&self) -> f64 {
        (0..self.triangles.len()).filter(|t| self.is_finished(*t)).map(|t| self.facet_area(t)).sum()
    }

    /// Area of all triangles, m².
    pub fn area(&self) -> f64 {
        (0..self.triangles.len()).map(|t| self.facet_area(t)).sum()
    }

    /// Area of triangle `t`, m².
    ///
    /// # Panics
    /// As [`Self::corners`].
    pub fn facet_area(&self, t: usize) -> f64 {
        let [a, b, c] = self.corners(t);
        (b - a).cross(&(c - a)).norm() / 2.0
    }

    /// The three corners of triangle `t`.
    ///
    /// # Panics
    /// If `t` or one of its indices is out of range; a mesh from outside is validated before it gets here.
    pub fn corners(&self, t: usize) -> [Point3<f64>; 3] {
        self.triangles[t].map(|v| self.vertices[v as usize])
    }

    /// A point of the smooth surface over triangle `t` at barycentric weights `b` (sum 1).
    ///
    /// The facet point is moved along the interpolated normal by the quadratic sagitta of its three edges,
    /// ½ Σ_{i<j} b_i b_j (n_j − n_i)·(p_j − p_i): exact on parabolic arcs, so a facet's chord error
    /// L²κ/8 is taken out to third order in the edge length.
    pub fn smooth_point(&self, t: usize, b: [f64; 3]) -> (Point3<f64>, Vector3<f64>) {
        let v = self.triangles[t].map(|v| v as usize);
        let (p, n) = (v.map(|v| self.vertices[v].coords), v.map(|v| self.normals[v]));
        let flat = p[0] * b[0] + p[1] * b[1] + p[2] * b[2];
        let normal = (n[0] * b[0] + n[1] * b[1] + n[2] * b[2]).normalize();
        let sagitta = |i: usize, j: usize| b[i] * b[j] * (n[j] - n[i]).dot(&(p[j] - p[i]));
        let lift = 0.5 * (sagitta(0, 1) + sagitta(1, 2) + sagitta(2, 0));
        (Point3::from(flat + normal * lift), normal)
    }
}
