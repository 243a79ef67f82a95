//! Dense points on the facets of a mesh at which a finished program is judged.

use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

use crate::mesh::TriangleMesh;

/// Points spread evenly over the facets of a mesh, made from the mesh alone.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ProofPoints {
    /// Positions, each exactly on a facet, `workpiece` frame, m.
    pub points: Vec<Point3<f64>>,
    /// Unit normals of the facets, tool side.
    pub normals: Vec<Vector3<f64>>,
    /// Area that each point stands for, m²; the sum is the area of the mesh.
    pub weights: Vec<f64>,
}

impl ProofPoints {
    /// The marked ones; `marks` is as long as the points.
    pub fn only(&self, marks: &[bool]) -> Self {
        let kept = || (0..self.len()).filter(|i| marks[*i]);
        Self {
            points: kept().map(|i| self.points[i]).collect(),
            normals: kept().map(|i| self.normals[i]).collect(),
            weights: kept().map(|i| self.weights[i]).collect(),
        }
    }

    /// About one point for every `spacing`² of facet area (m², `spacing` in m), the same for the same mesh.
    ///
    /// Facets larger than the spacing are halved across their longest edge until their pieces are not; all
    /// pieces are then walked along a Morton curve and every piece in which another full share of area is
    /// reached gives its centroid. Facets without area give nothing; a mesh without area gives no points.
    ///
    /// # Panics
    /// If `spacing` is not positive and finite.
    pub fn on_facets(mesh: &TriangleMesh, spacing: f64) -> Self {
        Self::on_those(mesh, spacing, &|_| true)
    }

    /// The same on the facets that are to be finished.
    ///
    /// # Panics
    /// If `spacing` is not positive and finite.
    pub fn on_finished(mesh: &TriangleMesh, spacing: f64) -> Self {
        Self::on_those(mesh, spacing, &|t| mesh.is_finished(t))
    }

    /// The same on the facets that are check surface only.
    ///
    /// # Panics
    /// If `spacing` is not positive and finite.
    pub fn on_check_surface(mesh: &TriangleMesh, spacing: f64) -> Self {
        Self::on_those(mesh, spacing, &|t| !mesh.is_finished(t))
    }

    fn on_those(mesh: &TriangleMesh, spacing: f64, wanted: &(dyn Fn(usize) -> bool + Sync)) -> Self {
        assert!(spacing > 0.0 && spacing.is_finite(), "spacing of proof points: {spacing} m");
        let areas: Vec<Vector3<f64>> = (0..mesh.triangles.len())
            .into_par_iter()
            .map(|t| {
                let [a, b, c] = mesh.corners(t);
                if wanted(t) { (b - a).cross(&(c - a)) * 0.5 } else { Vector3::zeros() }
            })
            .collect();
        let total: f64 = areas.iter().map(|a| a.norm()).sum();
        let mut made = Self::default();
        if !(total > 0.0 && total.is_finite()) {
            return made;
        }
        let count = (total / (spacing * spacing)).ceil();
        let mut walk =
            Walk { share: total / count, until_next: 0.5 * total / count, longest2: spacing * spacing };
        for t in along_morton_curve(mesh) {
            let area = areas[t as usize].norm();
            if area > 0.0 {
                let normal = areas[t as usize] / area;
                walk.over(mesh.corners(t as usize), area, &mut |point| {
                    made.points.push(point);
                    made.normals.push(normal);
                });
            }
        }
        made.weights = vec![total / made.points.len() as f64; made.points.len()];
        made
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Whether there is no point.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }
}

struct Walk {
    /// Area for one point.
    share: f64,
    /// Area still to pass before the next point.
    until_next: f64,
    /// Longest edge of a piece, squared.
    longest2: f64,
}

impl Walk {
    fn over(&mut self, corners: [Point3<f64>; 3], area: f64, emit: &mut impl FnMut(Point3<f64>)) {
        let [a, b, c] = corners;
        let edges = [(b - a).norm_squared(), (c - b).norm_squared(), (a - c).norm_squared()];
        let longest = edges[0].max(edges[1]).max(edges[2]);
        if longest > self.longest2 && area < self.until_next {
            self.until_next -= area; // nothing to give in here, however large
        } else if longest > self.longest2 {
            let [a, b, c] = match edges.iter().position(|&e| e == longest) {
                Some(0) => [a, b, c],
                Some(1) => [b, c, a],
                _ => [c, a, b],
            };
            let middle = nalgebra::center(&a, &b);
            self.over([c, a, middle], 0.5 * area, emit);
            self.over([b, c, middle], 0.5 * area, emit);
        } else {
            self.until_next -= area;
            while self.until_next <= 0.0 {
                emit(Point3::from((a.coords + b.coords + c.coords) / 3.0));
                self.until_next += self.share;
            }
        }
    }
}

/// Triangles ordered along a Morton curve of their centroids (21 bits an axis), ties by index.
fn along_morton_curve(mesh: &TriangleMesh) -> Vec<u32> {
    let centre = |t: usize| {
        let [a, b, c] = mesh.corners(t);
        (a.coords + b.coords + c.coords) / 3.0
    };
    let (mut low, mut high) = (Vector3::repeat(f64::INFINITY), Vector3::repeat(f64::NEG_INFINITY));
    for t in 0..mesh.triangles.len() {
        let c = centre(t);
        (low, high) = (low.inf(&c), high.sup(&c));
    }
    let scale = 2_097_151.0 / (high - low).max().max(f64::MIN_POSITIVE);
    let mut keyed: Vec<(u64, u32)> = (0..mesh.triangles.len())
        .into_par_iter()
        .map(|t| {
            let c = (centre(t) - low) * scale;
            (spread(c.x as u64) | spread(c.y as u64) << 1 | spread(c.z as u64) << 2, t as u32)
        })
        .collect();
    keyed.par_sort_unstable();
    keyed.into_iter().map(|k| k.1).collect()
}

/// Two zero bits between any two of the lowest 21.
fn spread(v: u64) -> u64 {
    let mut v = v & 0x1f_ffff;
    v = (v | v << 32) & 0x001f_0000_0000_ffff;
    v = (v | v << 16) & 0x001f_0000_ff00_00ff;
    v = (v | v << 8) & 0x100f_00f0_0f00_f00f;
    v = (v | v << 4) & 0x10c3_0c30_c30c_30c3;
    (v | v << 2) & 0x1249_2492_4924_9249
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_meshes::{bumpy, height_field, random_soup};

    #[test]
    fn density_and_weights_fit_small_and_large_facets() {
        for (mesh, spacing) in
            [(bumpy(200, 0.05, 0.003), 1.1e-3), (bumpy(3, 0.05, 0.003), 0.7e-3), (random_soup(60, 1), 0.5e-3)]
        {
            let points = ProofPoints::on_facets(&mesh, spacing);
            let total = mesh.area();
            let ideal = total / spacing.powi(2);
            assert!((points.len() as f64 - ideal).abs() < 2.0, "{} {ideal}", points.len());
            assert!((points.weights.iter().sum::<f64>() - total).abs() < 1e-12);
            assert_eq!(points, ProofPoints::on_facets(&mesh, spacing));
        }
    }

    #[test]
    fn points_are_spread_evenly() {
        for n in [4, 300] {
            let points = ProofPoints::on_facets(&height_field(n, 0.05, |_, _| 0.0), 0.5e-3);
            // Every 4 mm × 4 mm tile holds about (4 / 0.5)² points.
            let mut tiles = [0u32; 625];
            for p in &points.points {
                let tile = |c: f64| (((c + 0.05) / 0.004) as usize).min(24);
                tiles[25 * tile(p.x) + tile(p.y)] += 1;
                assert!(p.z == 0.0);
            }
            assert!(tiles.iter().all(|&t| (44..=86).contains(&t)), "{n} {tiles:?}");
            assert!(points.normals.iter().all(|n| *n == Vector3::z()));
        }
    }

    #[test]
    fn meshes_without_area_give_nothing() {
        assert!(ProofPoints::on_facets(&TriangleMesh::default(), 1e-3).is_empty());
        let flat = TriangleMesh {
            vertices: vec![Point3::origin(); 3],
            normals: vec![Vector3::z(); 3],
            triangles: vec![[0, 1, 2]],
            chord_error: 0.0,
            check_only: Vec::new(),
        };
        assert!(ProofPoints::on_facets(&flat, 1e-3).is_empty());
    }
}
