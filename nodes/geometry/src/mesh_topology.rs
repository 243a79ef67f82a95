//! Which triangles and vertices of a mesh are neighbours.

use nalgebra::Vector3;

use crate::mesh::TriangleMesh;

/// Neighbourhood of every vertex, in flat arrays, in an order that depends on the mesh alone.
#[derive(Clone, Debug, Default)]
pub struct MeshTopology {
    triangle_start: Vec<u32>,
    triangles: Vec<u32>,
    neighbour_start: Vec<u32>,
    neighbours: Vec<u32>,
    border: Vec<bool>,
    /// Triangle corners, kept to find the edge that two triangles share.
    corners: Vec<[u32; 3]>,
}

impl MeshTopology {
    /// The topology of `mesh`, whose indices are valid.
    pub fn of(mesh: &TriangleMesh) -> Self {
        let count = mesh.vertices.len();
        let mut triangle_start = vec![0u32; count + 1];
        for v in mesh.triangles.iter().flatten() {
            triangle_start[*v as usize + 1] += 1;
        }
        for v in 0..count {
            triangle_start[v + 1] += triangle_start[v];
        }
        let mut next = triangle_start.clone();
        let mut triangles = vec![0u32; mesh.triangles.len() * 3];
        for (t, corners) in mesh.triangles.iter().enumerate() {
            for &v in corners {
                triangles[next[v as usize] as usize] = t as u32;
                next[v as usize] += 1;
            }
        }
        let mut neighbour_start = Vec::with_capacity(count + 1);
        let mut neighbours = Vec::with_capacity(mesh.triangles.len() * 3 + count);
        let mut border = vec![false; count];
        neighbour_start.push(0);
        let mut around: Vec<u32> = Vec::new();
        for v in 0..count {
            around.clear();
            for &t in &triangles[triangle_start[v] as usize..triangle_start[v + 1] as usize] {
                around.extend(mesh.triangles[t as usize].iter().filter(|&&c| c as usize != v));
            }
            around.sort_unstable();
            // Around an inner vertex every neighbour belongs to two triangles.
            border[v] = around.chunk_by(|a, b| a == b).any(|same| same.len() == 1);
            around.dedup();
            neighbours.extend_from_slice(&around);
            neighbour_start.push(neighbours.len() as u32);
        }
        Self {
            triangle_start,
            triangles,
            neighbour_start,
            neighbours,
            border,
            corners: mesh.triangles.clone(),
        }
    }

    /// Triangles that use vertex `v`, ascending.
    pub fn triangles_at(&self, v: usize) -> &[u32] {
        &self.triangles[self.triangle_start[v] as usize..self.triangle_start[v + 1] as usize]
    }

    /// The vertices of triangle `t`.
    pub fn corners_of(&self, t: usize) -> [u32; 3] {
        self.corners[t]
    }

    /// Vertices that share an edge with `v`, ascending.
    pub fn neighbours(&self, v: usize) -> &[u32] {
        &self.neighbours[self.neighbour_start[v] as usize..self.neighbour_start[v + 1] as usize]
    }

    /// Whether `v` lies on an edge that has only one triangle.
    pub fn is_border(&self, v: usize) -> bool {
        self.border[v]
    }

    /// Triangles other than `t` on the edge from `a` to `b`.
    pub fn across(&self, t: usize, a: u32, b: u32) -> impl Iterator<Item = usize> + '_ {
        self.triangles_at(a as usize)
            .iter()
            .map(|&s| s as usize)
            .filter(move |&s| s != t && self.corners[s].contains(&b))
    }

    /// Vertices on an edge across which the facet normals' dot product falls below `cos_limit`.
    pub fn sharp_vertices(&self, facet_normals: &[Vector3<f64>], cos_limit: f64) -> Vec<bool> {
        let mut sharp = vec![false; self.border.len()];
        for (t, corners) in self.corners.iter().enumerate() {
            for k in 0..3 {
                let (a, b) = (corners[k], corners[(k + 1) % 3]);
                for s in self.across(t, a, b).filter(|&s| s > t) {
                    if facet_normals[t].dot(&facet_normals[s]) < cos_limit {
                        sharp[a as usize] = true;
                        sharp[b as usize] = true;
                    }
                }
            }
        }
        sharp
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Point3;

    use super::*;

    #[test]
    fn a_square_of_two_triangles_is_all_border() {
        let mesh = TriangleMesh {
            vertices: [(0., 0.), (1., 0.), (1., 1.), (0., 1.)].map(|(x, y)| Point3::new(x, y, 0.)).to_vec(),
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            ..Default::default()
        };
        let topology = MeshTopology::of(&mesh);
        assert_eq!(topology.triangles_at(0), [0, 1]);
        assert_eq!(topology.neighbours(1), [0, 2]);
        assert!((0..4).all(|v| topology.is_border(v)));
        assert_eq!(topology.across(0, 0, 2).collect::<Vec<_>>(), [1]);
    }
}
