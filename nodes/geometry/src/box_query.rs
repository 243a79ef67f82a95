//! Triangles whose bounding boxes pass a test: for queries other than a ray or a drop.

use crate::bvh::Bvh;

impl Bvh {
    /// Visits the triangles of every leaf whose box, and the boxes of all nodes above it, `enter` accepts.
    ///
    /// `enter` gets the smallest and largest corner of a box (m, `workpiece` frame) and must accept every box that
    /// encloses an acceptable one. The order is always the same. A leaf's box holds up to four triangles, so
    /// `visit` has to look for itself.
    pub fn for_each_triangle(
        &self,
        mut enter: impl FnMut(&[f64; 3], &[f64; 3]) -> bool,
        mut visit: impl FnMut(u32),
    ) {
        // The tree splits at medians: its depth is the logarithm of the number of triangles.
        let mut open = [0u32; 64];
        let mut depth = usize::from(!self.splits.is_empty());
        while depth > 0 {
            depth -= 1;
            let node = open[depth] as usize;
            let aabb = &self.bounds[node].aabb;
            if !enter(&aabb.min, &aabb.max) {
                continue;
            }
            let split = self.splits[node];
            if split.right == 0 {
                self.order[split.range()].iter().for_each(|&t| visit(t));
            } else {
                open[depth] = split.right;
                open[depth + 1] = node as u32 + 1;
                depth += 2;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::TriangleMesh;
    use crate::test_meshes::random_soup;

    #[test]
    fn a_box_query_finds_what_a_full_search_finds() {
        let mesh = random_soup(301, 7);
        let bvh = Bvh::build(&mesh);
        let reaches = |min: &[f64; 3], max: &[f64; 3]| min[0] <= 0.01 && max[0] >= -0.01 && max[1] >= 0.0;
        let mut found = Vec::new();
        bvh.for_each_triangle(reaches, |t| found.push(t));
        found.sort_unstable();
        assert!(found.windows(2).all(|w| w[0] != w[1]));
        for t in 0..mesh.triangles.len() {
            let corners = mesh.corners(t);
            let bound = |k: usize, f: fn(f64, f64) -> f64| f(f(corners[0][k], corners[1][k]), corners[2][k]);
            let (min, max) = ([0, 1, 2].map(|k| bound(k, f64::min)), [0, 1, 2].map(|k| bound(k, f64::max)));
            assert!(!reaches(&min, &max) || found.contains(&(t as u32)));
        }
        Bvh::build(&TriangleMesh::default()).for_each_triangle(|_, _| true, |_| panic!("nothing to visit"));
    }
}
