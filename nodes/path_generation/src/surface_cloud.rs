//! Dense points of the surface on which axes, step-overs and pass ends are decided.

use patchmill_geometry::mesh::TriangleMesh;
use patchmill_orientation::cloud_point::CloudPoint;
use rayon::prelude::*;

use crate::sample_interpolation::SampleInterpolation;

/// Points at about `spacing` on the facets of `mesh` that are to be finished, in the order of the facets.
///
/// A facet longer than the spacing is subdivided; of smaller ones only as many are taken as the spacing asks for.
pub fn surface_cloud(mesh: &TriangleMesh, shapes: &SampleInterpolation, spacing: f64) -> Vec<CloudPoint> {
    facet_places(mesh, spacing)
        .into_par_iter()
        .map(|(t, weights, area)| {
            let (position, normal) = mesh.smooth_point(t, weights);
            let shape = shapes.at(&position);
            CloudPoint {
                position,
                normal,
                pseudo_curvature: shape.pseudo_curvature,
                curvature: shape.curvature,
                facet_error: facet_error(mesh, t),
                area,
            }
        })
        .collect()
}

/// (triangle, barycentric weights, area) of every point.
fn facet_places(mesh: &TriangleMesh, spacing: f64) -> Vec<(usize, [f64; 3], f64)> {
    let (mut places, mut pending) = (Vec::new(), 0.0);
    for t in (0..mesh.triangles.len()).filter(|t| mesh.is_finished(*t)) {
        let [a, b, c] = mesh.corners(t);
        let area = mesh.facet_area(t);
        let longest = (b - a).norm().max((c - b).norm()).max((a - c).norm());
        // At most 1000² points a facet: a bound on memory, not a quality setting.
        let parts = (longest / spacing).ceil().clamp(1.0, 1000.0) as usize;
        if parts <= 2 {
            pending += area;
            if pending >= spacing * spacing {
                places.push((t, [1.0 / 3.0; 3], pending));
                pending = 0.0;
            }
            continue;
        }
        let (n, share) = (parts as f64, area / (parts * parts) as f64);
        for i in 0..parts {
            for j in 0..parts - i {
                let mut push = |third: f64| {
                    let (u, v) = ((i as f64 + third) / n, (j as f64 + third) / n);
                    places.push((t, [1.0 - u - v, u, v], share));
                };
                push(1.0 / 3.0);
                if i + j + 1 < parts {
                    push(2.0 / 3.0);
                }
            }
        }
    }
    places
}

/// Largest sagitta of a facet's edges, L²κ/8, from the vertex normals, m.
fn facet_error(mesh: &TriangleMesh, t: usize) -> f64 {
    let v = mesh.triangles[t].map(|v| v as usize);
    let sagitta = |i: usize, j: usize| {
        (mesh.normals[j] - mesh.normals[i]).dot(&(mesh.vertices[j] - mesh.vertices[i])) / 8.0
    };
    sagitta(v[0], v[1]).abs().max(sagitta(v[1], v[2]).abs()).max(sagitta(v[2], v[0]).abs())
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Point3, Vector3};

    #[test]
    fn places_share_the_whole_area() {
        let mesh = TriangleMesh {
            vertices: vec![Point3::origin(), Point3::new(0.1, 0.0, 0.0), Point3::new(0.0, 0.05, 0.0)],
            normals: vec![Vector3::z(); 3],
            triangles: vec![[0, 1, 2]],
            chord_error: 0.0,
            check_only: Vec::new(),
        };
        let places = facet_places(&mesh, 1e-3);
        let area: f64 = places.iter().map(|p| p.2).sum();
        assert!((area - 0.0025).abs() < 1e-12);
        assert!(places.iter().all(|p| p.1.iter().all(|w| (0.0..=1.0).contains(w))));
    }
}
