//! Which edges and vertices of a mesh each triangle owns, and which edges are valleys.

use nalgebra::Vector3;
use rayon::prelude::*;

use crate::mesh::TriangleMesh;

/// No neighbour.
pub(crate) const NONE: u32 = u32::MAX;
/// A fold counts as a valley only when its sine is above this, far beyond rounding.
const VALLEY_SINE: f64 = 1e-7;
/// Facets whose doubled area is below this share of their longest edge squared have no reliable normal.
const SLIVER: f64 = 1e-5;

/// Topology that does not depend on the tool axis. Edge k of a triangle runs from corner k to corner k+1.
#[derive(Clone, Debug, Default)]
pub(crate) struct MeshEdges {
    /// Bits 0–2: the triangle owns edge k; bits 3–5: it owns corner k. Each edge and vertex has one owner.
    pub(crate) owned: Vec<u8>,
    /// The triangle across edge k where that edge is a valley (concave as seen from the tool side);
    /// [`NONE`] at ridges, flat folds, borders and where facets disagree.
    pub(crate) valley: Vec<[u32; 3]>,
}

impl MeshEdges {
    pub(crate) fn of(mesh: &TriangleMesh) -> Self {
        let mut owned = vec![0u8; mesh.triangles.len()];
        let mut across = vec![[NONE; 3]; mesh.triangles.len()];
        own_vertices(mesh, &mut owned);
        match_edges(mesh, &mut owned, &mut across);
        let normals: Vec<Vector3<f64>> =
            (0..mesh.triangles.len()).into_par_iter().map(|t| reliable_normal(mesh, t)).collect();
        let valley = across
            .par_iter()
            .enumerate()
            .map(|(t, n)| {
                n.map(|n| if n != NONE && is_valley(mesh, &normals, t, n as usize) { n } else { NONE })
            })
            .collect();
        Self { owned, valley }
    }
}

fn own_vertices(mesh: &TriangleMesh, owned: &mut [u8]) {
    let mut taken = vec![false; mesh.vertices.len()];
    for (corners, owned) in mesh.triangles.iter().zip(owned) {
        for (k, &v) in corners.iter().enumerate() {
            if !std::mem::replace(&mut taken[v as usize], true) {
                *owned |= 8 << k;
            }
        }
    }
}

/// Pairs half-edges through buckets of their smaller vertex; a bucket holds a handful.
fn match_edges(mesh: &TriangleMesh, owned: &mut [u8], across: &mut [[u32; 3]]) {
    let mut start = vec![0u32; mesh.vertices.len() + 1];
    let ends = |t: usize, k: usize| (mesh.triangles[t][k], mesh.triangles[t][(k + 1) % 3]);
    for t in 0..mesh.triangles.len() {
        for k in 0..3 {
            let (a, b) = ends(t, k);
            start[a.min(b) as usize + 1] += 1;
        }
    }
    for v in 1..start.len() {
        start[v] += start[v - 1];
    }
    // (larger vertex, half-edge 3t + k)
    let mut half_edges = vec![(0u32, 0u32); 3 * mesh.triangles.len()];
    let mut next = start.clone();
    for t in 0..mesh.triangles.len() {
        for k in 0..3 {
            let (a, b) = ends(t, k);
            let slot = &mut next[a.min(b) as usize];
            half_edges[*slot as usize] = (a.max(b), (3 * t + k) as u32);
            *slot += 1;
        }
    }
    for w in start.windows(2) {
        let bucket = &mut half_edges[w[0] as usize..w[1] as usize];
        bucket.sort_unstable();
        for same in bucket.chunk_by(|x, y| x.0 == y.0) {
            let place = |i: usize| (same[i].1 as usize / 3, same[i].1 as usize % 3);
            let (t, k) = place(0);
            owned[t] |= 1 << k;
            if let [_, _] = same {
                let (u, m) = place(1);
                // Neighbours of one orientation run along their edge in opposite directions.
                if mesh.triangles[t][k] == mesh.triangles[u][(m + 1) % 3] && t != u {
                    across[t][k] = u as u32;
                    across[u][m] = t as u32;
                }
            }
        }
    }
}

/// Unit facet normal; zero for slivers.
fn reliable_normal(mesh: &TriangleMesh, t: usize) -> Vector3<f64> {
    let [a, b, c] = mesh.corners(t);
    let n = (b - a).cross(&(c - a));
    let longest = (b - a).norm_squared().max((c - b).norm_squared()).max((a - c).norm_squared());
    if n.norm() > SLIVER * longest { n.normalize() } else { Vector3::zeros() }
}

/// Whether the fold between `t` and `u` is concave on the side of their normals.
fn is_valley(mesh: &TriangleMesh, normals: &[Vector3<f64>], t: usize, u: usize) -> bool {
    let (n, m) = (&normals[t], &normals[u]);
    let (p, q) = (mesh.corners(t), mesh.corners(u));
    let centre = |c: &[nalgebra::Point3<f64>; 3]| (c[0].coords + c[1].coords + c[2].coords) / 3.0;
    let across = centre(&q) - centre(&p);
    n.cross(m).norm() > VALLEY_SINE && n.dot(m) > 0.0 && (n - m).dot(&across) > 0.0
}
