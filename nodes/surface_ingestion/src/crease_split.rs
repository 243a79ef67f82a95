//! Vertices on sharp edges given to every smooth part of the surface on its own, so that the normals and the curvature of one face of a
//! solid owe nothing to the next face.

use nalgebra::Vector3;
use patchmill_geometry::curvature::SHARP_ANGLE;
use patchmill_geometry::mesh::TriangleMesh;
use patchmill_geometry::mesh_topology::MeshTopology;

/// Splits the vertices of `mesh`, whose normals are not read. Facets, their order and their corners' places stay.
pub fn split_at_creases(mesh: &mut TriangleMesh) {
    let topology = MeshTopology::of(mesh);
    let normals: Vec<Vector3<f64>> = (0..mesh.triangles.len())
        .map(|t| {
            let [a, b, c] = mesh.corners(t);
            (b - a).cross(&(c - a)).try_normalize(0.0).unwrap_or_else(Vector3::z)
        })
        .collect();
    let sharp = topology.sharp_vertices(&normals, SHARP_ANGLE.cos());
    for v in (0..sharp.len()).filter(|v| sharp[*v]) {
        for fan in smooth_fans(&topology, &normals, v).iter().skip(1) {
            let copy = mesh.vertices.len() as u32;
            mesh.vertices.push(mesh.vertices[v]);
            for t in fan {
                mesh.triangles[*t].iter_mut().filter(|c| **c as usize == v).for_each(|c| *c = copy);
            }
        }
    }
}

/// The triangles at a vertex, those together that edges at the vertex join smoothly.
fn smooth_fans(topology: &MeshTopology, normals: &[Vector3<f64>], v: usize) -> Vec<Vec<usize>> {
    let mut free: Vec<usize> = topology.triangles_at(v).iter().map(|t| *t as usize).collect();
    let mut fans = Vec::new();
    while !free.is_empty() {
        let mut fan = vec![free.remove(0)];
        let mut next = 0;
        while next < fan.len() {
            let t = fan[next];
            next += 1;
            let smooth = |s: &usize| {
                normals[t].dot(&normals[*s]) >= SHARP_ANGLE.cos()
                    && topology.neighbours(v).iter().any(|w| {
                        let has = |t: usize| topology.corners_of(t).contains(w);
                        has(t) && has(*s)
                    })
            };
            let (joined, left) = free.into_iter().partition(smooth);
            fan.extend::<Vec<usize>>(joined);
            free = left;
        }
        fans.push(fan);
    }
    fans
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;

    #[test]
    fn a_step_falls_into_its_faces_and_a_smooth_fold_stays() {
        // Three squares in a row along x, folded upward by the angle at x = 1 and x = 2.
        let folded = |angle: f64| {
            let profile =
                [[0.0, 0.0], [1.0, 0.0], [1.0 + angle.cos(), angle.sin()], [2.0 + angle.cos(), angle.sin()]];
            let vertices =
                profile.iter().flat_map(|[x, z]| [0.0, 1.0].map(|y| Point3::new(*x, y, *z))).collect();
            let triangles =
                (0..3u32).flat_map(|i| [[2 * i, 2 * i + 2, 2 * i + 3], [2 * i, 2 * i + 3, 2 * i + 1]]);
            let mut mesh =
                TriangleMesh { vertices, triangles: triangles.collect(), ..TriangleMesh::default() };
            let before: Vec<_> = (0..6).map(|t| mesh.corners(t)).collect();
            split_at_creases(&mut mesh);
            assert_eq!((0..6).map(|t| mesh.corners(t)).collect::<Vec<_>>(), before);
            mesh.vertices.len()
        };
        assert_eq!((folded(0.4), folded(0.7)), (8, 12));
    }
}
