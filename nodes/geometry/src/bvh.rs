//! A bounding-volume hierarchy over the triangles of a mesh, shared by ray casts and drops.

use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

use crate::mesh::TriangleMesh;
use crate::mesh_edges::MeshEdges;
use crate::split_tree::{Split, split_tree};

/// Nodes with more triangles take their bounding plane from their box instead of from their vertices.
const PLANE_FIT: u32 = 2048;
/// Ranges longer than this are handled in parallel.
const PARALLEL: u32 = 8192;

/// Axis-aligned box, m.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Aabb {
    pub(crate) min: [f64; 3],
    pub(crate) max: [f64; 3],
}

impl Aabb {
    pub(crate) const EMPTY: Self = Self { min: [f64::INFINITY; 3], max: [f64::NEG_INFINITY; 3] };

    pub(crate) fn add(&mut self, p: &Point3<f64>) {
        for k in 0..3 {
            self.min[k] = self.min[k].min(p[k]);
            self.max[k] = self.max[k].max(p[k]);
        }
    }

    pub(crate) fn union(&self, other: &Self) -> Self {
        let mut u = *self;
        for k in 0..3 {
            u.min[k] = u.min[k].min(other.min[k]);
            u.max[k] = u.max[k].max(other.max[k]);
        }
        u
    }

    /// max of n·p over the box
    pub(crate) fn support(&self, n: &Vector3<f64>) -> f64 {
        (0..3).map(|k| (n[k] * self.min[k]).max(n[k] * self.max[k])).sum()
    }
}

/// What a node holds of its triangles, `workpiece` frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Bounds {
    pub(crate) aabb: Aabb,
    /// Mean normal (unit, or zero where the normals cancel).
    pub(crate) normal: Vector3<f64>,
    /// No vertex of the node has `normal`·p above this, m.
    pub(crate) offset: f64,
}

/// Bounding-volume hierarchy of a [`TriangleMesh`]; at most four triangles a leaf.
///
/// Besides its box each node bounds its triangles by the plane of their mean normal, which holds in any
/// frame; the hierarchy is built once for a mesh and serves every tool axis. The build is parallel and gives
/// the same hierarchy whatever the number of threads.
#[derive(Clone, Debug)]
pub struct Bvh {
    pub(crate) splits: Vec<Split>,
    pub(crate) bounds: Vec<Bounds>,
    /// Triangle indices in leaf order.
    pub(crate) order: Vec<u32>,
    pub(crate) edges: MeshEdges,
}

impl Bvh {
    /// Builds the hierarchy over all triangles of `mesh`.
    ///
    /// # Panics
    /// If a triangle's vertex index is out of range; a mesh from outside is validated before it gets here.
    pub fn build(mesh: &TriangleMesh) -> Self {
        let ((order, splits), edges) = rayon::join(|| split_tree(&centres(mesh)), || MeshEdges::of(mesh));
        let blank = Bounds { aabb: Aabb::EMPTY, normal: Vector3::zeros(), offset: f64::NEG_INFINITY };
        let mut bounds = vec![blank; splits.len()];
        if !splits.is_empty() {
            fit(mesh, &order, &splits, 0, None, &mut bounds);
        }
        Self { splits, bounds, order, edges }
    }

    /// Number of triangles.
    pub fn len(&self) -> usize {
        self.order.len()
    }

    /// Whether the mesh had no triangle.
    pub fn is_empty(&self) -> bool {
        self.order.is_empty()
    }

    /// Smallest and largest corner of the mesh's box, m; `None` for an empty mesh.
    pub fn extent(&self) -> Option<(Point3<f64>, Point3<f64>)> {
        self.bounds.first().map(|b| (Point3::from(b.aabb.min), Point3::from(b.aabb.max)))
    }

    /// Heights along a unit direction that the mesh keeps between, those of its box, m; `None` for an empty mesh.
    pub fn extent_along(&self, direction: &Vector3<f64>) -> Option<(f64, f64)> {
        self.bounds.first().map(|b| (-b.aabb.support(&-direction), b.aabb.support(direction)))
    }
}

fn centres(mesh: &TriangleMesh) -> Vec<[f64; 3]> {
    (0..mesh.triangles.len())
        .into_par_iter()
        .map(|t| {
            let [a, b, c] = mesh.corners(t);
            [0, 1, 2].map(|k| (a[k] + b[k] + c[k]) / 3.0)
        })
        .collect()
}

/// The corners of a range of triangles in leaf order, side by side: every level below looks at them again.
struct Gathered {
    first: usize,
    corners: Vec<[Point3<f64>; 3]>,
}

impl Gathered {
    fn of(mesh: &TriangleMesh, order: &[u32], split: &Split) -> Self {
        let corners = order[split.range()].iter().map(|&t| mesh.corners(t as usize)).collect();
        Self { first: split.first as usize, corners }
    }

    fn range(&self, split: &Split) -> &[[Point3<f64>; 3]] {
        let start = split.first as usize - self.first;
        &self.corners[start..start + split.count as usize]
    }
}

/// Bounds of the subtree whose nodes start at `base`; `out[0]` is that node. Gives box and summed normal.
/// `above` are the corners that a node above has gathered.
fn fit(
    mesh: &TriangleMesh,
    order: &[u32],
    splits: &[Split],
    base: usize,
    above: Option<&Gathered>,
    out: &mut [Bounds],
) -> (Aabb, Vector3<f64>) {
    let split = splits[base];
    let own = (above.is_none() && split.count <= PLANE_FIT).then(|| Gathered::of(mesh, order, &split));
    let gathered = above.or(own.as_ref());
    let triangles = gathered.map_or(&[][..], |g| g.range(&split));
    let (aabb, sum) = if split.right == 0 {
        let (mut aabb, mut sum) = (Aabb::EMPTY, Vector3::zeros());
        for corners in triangles {
            corners.iter().for_each(|p| aabb.add(p));
            sum += (corners[1] - corners[0]).cross(&(corners[2] - corners[0]));
        }
        (aabb, sum)
    } else {
        let right = split.right as usize;
        let (left_out, right_out) = out[1..].split_at_mut(right - base - 1);
        let mut left = || fit(mesh, order, splits, base + 1, gathered, left_out);
        let mut right = || fit(mesh, order, splits, right, gathered, right_out);
        let (l, r) = if split.count > PARALLEL { rayon::join(left, right) } else { (left(), right()) };
        (l.0.union(&r.0), l.1 + r.1)
    };
    let normal = sum.try_normalize(0.0).unwrap_or_else(Vector3::zeros);
    let offset = if split.count > PLANE_FIT {
        aabb.support(&normal)
    } else {
        let corners = triangles.iter().flatten();
        corners.map(|p| normal.dot(&p.coords)).fold(f64::NEG_INFINITY, f64::max)
    };
    out[0] = Bounds { aabb, normal, offset };
    (aabb, sum)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_meshes::{bumpy, random_soup};

    #[test]
    fn every_triangle_is_in_one_leaf_and_within_its_bounds() {
        for mesh in [bumpy(40, 0.05, 0.003), random_soup(301, 7)] {
            let bvh = Bvh::build(&mesh);
            let mut seen = vec![0; mesh.triangles.len()];
            for (split, bounds) in bvh.splits.iter().zip(&bvh.bounds) {
                assert!(split.right != 0 || split.count <= 4);
                for &t in &bvh.order[split.range()] {
                    seen[t as usize] += u32::from(split.right == 0);
                    for p in mesh.corners(t as usize) {
                        assert!(bounds.normal.dot(&p.coords) <= bounds.offset + 1e-15);
                        assert!((0..3).all(|k| p[k] >= bounds.aabb.min[k] && p[k] <= bounds.aabb.max[k]));
                    }
                }
            }
            assert!(seen.iter().all(|&n| n == 1));
        }
    }

    #[test]
    fn build_does_not_depend_on_threads() {
        let mesh = bumpy(150, 0.05, 0.003);
        let build = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| Bvh::build(&mesh))
        };
        let (one, three) = (build(1), build(3));
        assert_eq!(one.order, three.order);
        assert!(one.bounds.iter().zip(&three.bounds).all(|(a, b)| a.offset == b.offset));
    }

    #[test]
    fn an_empty_mesh_is_empty() {
        let bvh = Bvh::build(&TriangleMesh::default());
        assert!(bvh.is_empty() && bvh.extent().is_none());
    }
}
