//! An even sampling of a mesh, borders included.
//!
//! Candidates are spread over the facets by area; farthest-point sampling picks from them and from the border, so that
//! every sample keeps its distance from the others and none of the surface is far from one. Each sample stands for the area of the
//! candidates nearest to it.

use nalgebra::{Matrix3, Point3, Vector3};
use patchmill_geometry::curvature::{Curvature, SmoothFit};
use patchmill_geometry::mesh::TriangleMesh;
use patchmill_products::samples::SurfaceSamples;
use patchmill_products::stage::{Progress, StageError};
use rayon::prelude::*;

/// Candidates for every sample wanted.
const CANDIDATES: usize = 16;

#[derive(Clone, Copy)]
struct Candidate {
    triangle: u32,
    weights: [f64; 3],
    position: Point3<f64>,
}

/// About `count` samples of what of `mesh` is to be finished; its normals are those of `fit`.
///
/// # Errors
/// On cancellation only.
pub fn mesh_samples(
    mesh: &TriangleMesh,
    fit: &SmoothFit,
    count: usize,
    progress: Progress<'_>,
) -> Result<SurfaceSamples, StageError> {
    let (mut candidates, total) = spread_by_area(mesh, count * CANDIDATES);
    let inside = candidates.len();
    // Samples of an even cover lie about √(area/count) apart: the border is offered at a quarter of that.
    add_border(mesh, 0.25 * (total / count as f64).sqrt(), &mut candidates);

    let (chosen, nearest) = farthest_points(&candidates, count, progress)?;
    let mut samples = SurfaceSamples::default();
    let mut area = vec![0.0; chosen.len()];
    for &sample in &nearest[..inside] {
        area[sample as usize] += total / inside as f64;
    }
    for (&index, area) in chosen.iter().zip(area) {
        let c = &candidates[index as usize];
        let (position, normal) = mesh.smooth_point(c.triangle as usize, c.weights);
        let curvature = curvature_at(mesh, fit, c, &normal);
        samples.points.push(position);
        samples.normals.push(normal);
        samples.curvature_max.push(curvature.max);
        samples.curvature_min.push(curvature.min);
        samples.direction_max.push(curvature.direction);
        samples.area.push(area);
    }
    Ok(samples)
}

/// Up to `count` candidates, each the farthest from those before it (the first of equals), and for every candidate the nearest
/// of them.
fn farthest_points(
    candidates: &[Candidate],
    count: usize,
    progress: Progress<'_>,
) -> Result<(Vec<u32>, Vec<u32>), StageError> {
    // One array a coordinate: the loop below runs a hundred million times and vectorises like this.
    let coordinate = |k: usize| candidates.iter().map(|c| c.position[k]).collect::<Vec<f64>>();
    let (x, y, z) = (coordinate(0), coordinate(1), coordinate(2));
    let mut distance = vec![f64::INFINITY; candidates.len()];
    let mut nearest = vec![0u32; candidates.len()];
    let mut chosen: Vec<u32> = Vec::with_capacity(count);
    let mut next = 0;
    while chosen.len() < count {
        if chosen.len().is_multiple_of(64) {
            progress.check()?;
        }
        let from = candidates[next].position;
        let number = chosen.len() as u32;
        chosen.push(next as u32);
        let mut farthest = 0f64;
        let places = x.iter().zip(&y).zip(&z);
        for (((x, y), z), (distance, nearest)) in places.zip(distance.iter_mut().zip(&mut nearest)) {
            let (dx, dy, dz) = (x - from.x, y - from.y, z - from.z);
            let d = dx * dx + dy * dy + dz * dz;
            let nearer = d < *distance;
            *nearest = if nearer { number } else { *nearest };
            *distance = if nearer { d } else { *distance };
            farthest = if *distance > farthest { *distance } else { farthest };
        }
        match distance.iter().position(|d| *d == farthest) {
            Some(place) if farthest > 0.0 => next = place,
            _ => break,
        }
    }
    Ok((chosen, nearest))
}

/// Interpolated between the corners that have a curvature, that is, not from sharp edges.
fn curvature_at(mesh: &TriangleMesh, fit: &SmoothFit, c: &Candidate, normal: &Vector3<f64>) -> Curvature {
    let (mut tensor, mut sum) = (Matrix3::zeros(), 0.0);
    for (v, weight) in mesh.triangles[c.triangle as usize].iter().map(|v| *v as usize).zip(c.weights) {
        if !fit.sharp[v] {
            tensor += fit.curvature[v].tensor(&fit.normals[v]) * weight;
            sum += weight;
        }
    }
    if sum > 1e-9 {
        tensor /= sum;
    }
    Curvature::of_tensor(&tensor, normal)
}

/// `count` candidates at equal shares of the area, in the facets' order, and the total area (m²).
fn spread_by_area(mesh: &TriangleMesh, count: usize) -> (Vec<Candidate>, f64) {
    let areas: Vec<f64> = (0..mesh.triangles.len())
        .into_par_iter()
        .map(|t| {
            if !mesh.is_finished(t) {
                return 0.0;
            }
            let [a, b, c] = mesh.corners(t);
            0.5 * (b - a).cross(&(c - a)).norm()
        })
        .collect();
    let total: f64 = areas.iter().sum();
    let mut candidates = Vec::with_capacity(count);
    let mut covered = 0.0;
    for (t, area) in areas.iter().enumerate() {
        covered += area;
        while candidates.len() < count && (candidates.len() as f64 + 0.5) * total < covered * count as f64 {
            // The R2 sequence (Roberts 2018) of low discrepancy, folded into the triangle.
            let k = candidates.len() as f64;
            let (mut a, mut b) =
                ((k * 0.754_877_666_246_692_8).fract(), (k * 0.569_840_290_998_053_3).fract());
            if a + b > 1.0 {
                (a, b) = (1.0 - a, 1.0 - b);
            }
            candidates.push(candidate(mesh, t, [1.0 - a - b, a, b]));
        }
    }
    (candidates, total)
}

fn candidate(mesh: &TriangleMesh, t: usize, weights: [f64; 3]) -> Candidate {
    let [a, b, c] = mesh.corners(t).map(|p| p.coords);
    let position = Point3::from(a * weights[0] + b * weights[1] + c * weights[2]);
    Candidate { triangle: t as u32, weights, position }
}

/// Points of the edges that only one finished triangle has, `spacing` (m) or less apart where edges are longer than that.
fn add_border(mesh: &TriangleMesh, spacing: f64, candidates: &mut Vec<Candidate>) {
    let mut edges: Vec<(u64, u32)> = mesh
        .triangles
        .par_iter()
        .enumerate()
        .filter(|(t, _)| mesh.is_finished(*t))
        .flat_map_iter(|(t, corners)| {
            (0..3).map(move |k| {
                let (a, b) = (corners[k], corners[(k + 1) % 3]);
                (u64::from(a.min(b)) << 32 | u64::from(a.max(b)), (3 * t + k) as u32)
            })
        })
        .collect();
    edges.par_sort_unstable();
    let mut border: Vec<u32> =
        edges.chunk_by(|a, b| a.0 == b.0).filter(|same| same.len() == 1).map(|same| same[0].1).collect();
    border.sort_unstable();
    for side in border {
        let (t, k) = (side as usize / 3, side as usize % 3);
        let p = mesh.corners(t);
        let steps = ((p[(k + 1) % 3] - p[k]).norm() / spacing).ceil().clamp(1.0, 1e5) as usize;
        for i in 0..steps {
            let share = i as f64 / steps as f64;
            let mut weights = [0.0; 3];
            weights[k] = 1.0 - share;
            weights[(k + 1) % 3] = share;
            candidates.push(candidate(mesh, t, weights));
        }
    }
}
