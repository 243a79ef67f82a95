//! The rolling ball at any point of a surface, not at its samples only.

use nalgebra::{Matrix3, Point3, Vector3};
use patchmill_geometry::bvh::Bvh;
use patchmill_geometry::curvature::{Curvature, SmoothFit, fit_smooth_surface};
use patchmill_geometry::cutter::Cutter;
use patchmill_geometry::mesh::TriangleMesh;
use patchmill_geometry::rolling_ball::{BallTree, SmoothSurface};
use patchmill_geometry::surface_points::SurfacePoints;
use patchmill_products::job::Job;
use rayon::prelude::*;

use crate::pseudo_radius::{BallSearch, Shadow, shadow_radius};
use crate::shadow::TangentFrame;
use crate::{NEAR, SPACING};

/// A point's facet is looked for so far above and below it, m: more than any mesh's chord error that leaves a scallop height.
const OFF_FACET: f64 = 0.1e-3;

/// A surface ready for balls at any of its points, with the exact shadow of a job's tool.
pub struct LocalBalls<'a> {
    mesh: &'a TriangleMesh,
    bvh: &'a Bvh,
    tree: BallTree,
    surface: SmoothSurface<'a>,
    fit: SmoothFit,
    cutter: Cutter,
}

impl<'a> LocalBalls<'a> {
    /// Makes ready; `bvh` is that of `mesh`, whose indices are valid.
    pub fn of(mesh: &'a TriangleMesh, bvh: &'a Bvh, job: &Job) -> Self {
        let cutter = job.tool.cutter;
        let points = || BallTree::build(&SurfacePoints::of(mesh, SPACING * shadow_radius(&cutter)));
        let smooth = || rayon::join(|| SmoothSurface::of(mesh), || fit_smooth_surface(mesh));
        let (tree, (surface, fit)) = rayon::join(points, smooth);
        Self { mesh, bvh, tree, surface, fit, cutter }
    }

    /// The surface.
    pub fn mesh(&self) -> &'a TriangleMesh {
        self.mesh
    }

    /// κ* at points on or beside facets with these unit normals, 1/m.
    pub fn curvatures(&self, points: &[Point3<f64>], normals: &[Vector3<f64>]) -> Vec<f64> {
        points.par_iter().zip(normals).map(|(p, n)| self.curvature_at(p, n)).collect()
    }

    /// κ* at one of them, 1/m.
    pub fn curvature_at(&self, point: &Point3<f64>, normal: &Vector3<f64>) -> f64 {
        let (origin, normal, principal) = self.smooth_at(point, normal);
        let radius = shadow_radius(&self.cutter);
        let shadow = Shadow::Exact { tree: &self.tree, surface: &self.surface, near: NEAR * radius };
        let search = BallSearch { shadow, cutter: self.cutter, radius };
        search.ball(&TangentFrame::new(origin, normal, &principal.direction), principal.max).curvature
    }

    /// The smooth surface beside a point: place, normal, curvature. Of several facets, as in a corner, that of the nearest normal.
    fn smooth_at(
        &self,
        point: &Point3<f64>,
        normal: &Vector3<f64>,
    ) -> (Point3<f64>, Vector3<f64>, Curvature) {
        let mut best: Option<(f64, usize, [f64; 3])> = None;
        let (from, range) = (point + normal * OFF_FACET, (0.0, 2.0 * OFF_FACET));
        self.bvh.for_each_hit(self.mesh, &from, &-normal, range, &mut |hit| {
            let t = hit.triangle as usize;
            let likeness = self.mesh.smooth_point(t, hit.barycentric).1.dot(normal);
            if best.is_none_or(|(most, other, _)| likeness > most || (likeness == most && t < other)) {
                best = Some((likeness, t, hit.barycentric));
            }
        });
        match best.filter(|(likeness, ..)| *likeness > 0.5) {
            Some((_, t, weights)) => {
                let (place, normal) = self.mesh.smooth_point(t, weights);
                (place, normal, self.principal(t, weights, &normal))
            }
            None => (*point, *normal, Curvature::of_tensor(&Matrix3::zeros(), normal)),
        }
    }

    /// Interpolated between the corners of a facet that are on no sharp edge.
    fn principal(&self, t: usize, weights: [f64; 3], normal: &Vector3<f64>) -> Curvature {
        let (mut tensor, mut sum) = (Matrix3::zeros(), 0.0);
        for (v, weight) in self.mesh.triangles[t].iter().map(|v| *v as usize).zip(weights) {
            if !self.fit.sharp[v] {
                tensor += self.fit.curvature[v].tensor(&self.fit.normals[v]) * weight;
                sum += weight;
            }
        }
        if sum > 1e-9 {
            tensor /= sum;
        }
        Curvature::of_tensor(&tensor, normal)
    }
}
