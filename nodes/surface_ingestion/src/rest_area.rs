//! A surface of which only what an earlier plan has left standing is finished.
//!
//! Facets across the border of what is left are split there, without moving the surface, so that a second job need not cut a long facet
//! from end to end for a short stretch of it.

use std::collections::BTreeMap;

use nalgebra::Point3;
use patchmill_geometry::curvature::{Curvature, SmoothFit};
use patchmill_geometry::mesh::TriangleMesh;
use patchmill_products::samples::SurfaceSamples;
use patchmill_products::selection::RestArea;
use patchmill_products::stage::StageError;

use crate::error_code::BAD_SELECTION;

/// Edges are halved no more often than this: 100 m come down to half a millimetre.
const MOST_HALVINGS: usize = 18;

/// Rows and columns of samples become no more than so many times as many.
const MOST_FINER: f64 = 8.0;
/// But no more than these.
const MOST_PER_SIDE: u32 = 1000;

/// Marks everything else as check surface, facets beside the rest split. `fit` is kept as long as the vertices.
///
/// # Errors
/// When nothing of the surface lies in the rest.
pub fn restrict(
    mesh: &mut TriangleMesh,
    mut fit: Option<&mut SmoothFit>,
    rest: &RestArea,
    name: &str,
) -> Result<(), StageError> {
    let longest = rest.cell.max(rest.overlap);
    for _ in 0..MOST_HALVINGS {
        let edges = long_edges(mesh, rest, longest);
        if edges.is_empty() {
            break;
        }
        halve(mesh, fit.as_deref_mut(), &edges);
    }
    let finished: Vec<bool> =
        (0..mesh.triangles.len()).map(|t| mesh.is_finished(t) && holds(rest, &centroid(mesh, t))).collect();
    match finished.iter().filter(|finished| **finished).count() {
        0 => Err(nothing_left(name)),
        all if all == finished.len() => {
            mesh.check_only.clear();
            Ok(())
        }
        _ => {
            mesh.check_only = finished.into_iter().map(|finished| !finished).collect();
            Ok(())
        }
    }
}

/// Rows and columns of a grid of which about as many samples lie in the rest as `samples`, of a grid of `per_side` rows and columns, are in
/// all.
pub fn samples_per_side(samples: &SurfaceSamples, rest: &RestArea, per_side: u32) -> u32 {
    let within = samples.points.iter().filter(|p| holds(rest, p)).count().max(1);
    let finer = (samples.len() as f64 / within as f64).sqrt().clamp(1.0, MOST_FINER);
    ((f64::from(per_side) * finer).ceil() as u32).min(MOST_PER_SIDE)
}

/// The samples that lie in the rest.
///
/// # Errors
/// When there are none.
pub fn samples_within(
    samples: &SurfaceSamples,
    rest: &RestArea,
    name: &str,
) -> Result<SurfaceSamples, StageError> {
    let kept: Vec<usize> = (0..samples.len()).filter(|&i| holds(rest, &samples.points[i])).collect();
    if kept.is_empty() { Err(nothing_left(name)) } else { Ok(samples.only(&kept)) }
}

fn nothing_left(name: &str) -> StageError {
    let text = format!("{name}: nothing of it lies where the earlier plan has left something standing");
    StageError::new(BAD_SELECTION, text)
}

fn centroid(mesh: &TriangleMesh, t: usize) -> Point3<f64> {
    let [a, b, c] = mesh.corners(t);
    Point3::from((a.coords + b.coords + c.coords) / 3.0)
}

/// Whether a point is within the overlap of one of the cells.
fn holds(rest: &RestArea, point: &Point3<f64>) -> bool {
    touches(rest, point, point)
}

/// Whether a box and one of the cells grown by the overlap have a point in common.
fn touches(rest: &RestArea, low: &Point3<f64>, high: &Point3<f64>) -> bool {
    let begin = |k: usize| (low[k] - rest.overlap) / rest.cell - 1.0;
    let end = |k: usize| (high[k] + rest.overlap) / rest.cell;
    let from = rest.cells.partition_point(|cell| f64::from(cell[0]) < begin(0));
    let near = rest.cells[from..].iter().take_while(|cell| f64::from(cell[0]) <= end(0));
    near.into_iter().any(|cell| (1..3).all(|k| (begin(k)..=end(k)).contains(&f64::from(cell[k]))))
}

/// Edges longer than `longest` (m) of finished facets whose box touches the rest, in order.
fn long_edges(mesh: &TriangleMesh, rest: &RestArea, longest: f64) -> Vec<[u32; 2]> {
    let mut edges = Vec::new();
    for (t, v) in mesh.triangles.iter().enumerate().filter(|(t, _)| mesh.is_finished(*t)) {
        let p = mesh.corners(t);
        let long = [0, 1, 2].map(|k| (p[(k + 1) % 3] - p[k]).norm() > longest);
        if long.contains(&true) && touches(rest, &p[0].inf(&p[1]).inf(&p[2]), &p[0].sup(&p[1]).sup(&p[2])) {
            edges.extend((0..3).filter(|k| long[*k]).map(|k| edge(v[k], v[(k + 1) % 3])));
        }
    }
    edges.sort_unstable();
    edges.dedup();
    edges
}

fn edge(a: u32, b: u32) -> [u32; 2] {
    [a.min(b), a.max(b)]
}

/// Puts a vertex into the middle of each of these edges and splits all facets that have one.
fn halve(mesh: &mut TriangleMesh, fit: Option<&mut SmoothFit>, edges: &[[u32; 2]]) {
    let first = mesh.vertices.len() as u32;
    let middles: BTreeMap<[u32; 2], u32> = edges.iter().copied().zip(first..).collect();
    for [a, b] in edges.iter().map(|edge| edge.map(|v| v as usize)) {
        let between = |a: Point3<f64>, b: Point3<f64>| Point3::from((a.coords + b.coords) / 2.0);
        mesh.vertices.push(between(mesh.vertices[a], mesh.vertices[b]));
        let normal = (mesh.normals[a] + mesh.normals[b]).try_normalize(1e-9).unwrap_or(mesh.normals[a]);
        mesh.normals.push(normal);
    }
    if let Some(fit) = fit {
        let new = &mesh.normals[first as usize..];
        for ([a, b], normal) in edges.iter().map(|edge| edge.map(|v| v as usize)).zip(new) {
            let [at_a, at_b] = [a, b].map(|v| fit.curvature[v].tensor(&fit.normals[v]));
            // There is no curvature at sharp vertices.
            let tensor = match [fit.sharp[a], fit.sharp[b]] {
                [false, true] => at_a,
                [true, false] => at_b,
                _ => (at_a + at_b) / 2.0,
            };
            fit.curvature.push(Curvature::of_tensor(&tensor, normal));
            fit.sharp.push(fit.sharp[a] && fit.sharp[b]);
            fit.normals.push(*normal);
        }
    }
    let (mut triangles, mut marks) = (Vec::new(), Vec::new());
    for (t, v) in mesh.triangles.iter().enumerate() {
        let before = triangles.len();
        split(*v, [0, 1, 2].map(|k| middles.get(&edge(v[k], v[(k + 1) % 3])).copied()), &mut triangles);
        marks.extend((before..triangles.len()).map(|_| !mesh.is_finished(t)));
    }
    mesh.triangles = triangles;
    if !mesh.check_only.is_empty() {
        mesh.check_only = marks;
    }
}

/// A facet in as many pieces as its edges' middles ask for, `middles[k]` lying after corner k, all wound as it is.
fn split(v: [u32; 3], middles: [Option<u32>; 3], into: &mut Vec<[u32; 3]>) {
    // Turned so that the cases below suffice.
    for turn in 0..3 {
        let at = |k: usize| (k + turn) % 3;
        let [a, b, c] = [v[at(0)], v[at(1)], v[at(2)]];
        match [middles[at(0)], middles[at(1)], middles[at(2)]] {
            [None, None, None] => return into.push(v),
            [Some(ab), None, None] => return into.extend([[a, ab, c], [ab, b, c]]),
            [Some(ab), Some(bc), None] => return into.extend([[ab, b, bc], [a, ab, bc], [a, bc, c]]),
            [Some(ab), Some(bc), Some(ca)] => {
                return into.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
            }
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;
    use patchmill_geometry::mesh_topology::MeshTopology;

    /// 100 × 40 mm of two facets.
    fn plate() -> TriangleMesh {
        let corner = |x: f64, y: f64| Point3::new(x, y, 0.0);
        TriangleMesh {
            vertices: vec![corner(0.0, 0.0), corner(0.1, 0.0), corner(0.1, 0.04), corner(0.0, 0.04)],
            normals: vec![Vector3::z(); 4],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            ..TriangleMesh::default()
        }
    }

    /// A strip of 100 × 2 mm in the middle, in cells of 1 mm.
    fn strip() -> RestArea {
        let cells = (0..100).flat_map(|x| [[x, 19, 0], [x, 20, 0]]).collect();
        RestArea { surface_id: "ab".to_owned(), cell: 1e-3, overlap: 0.5e-3, cells }
    }

    #[test]
    fn long_facets_are_split_at_the_border_and_nothing_else_changes() {
        let (mut mesh, rest) = (plate(), strip());
        restrict(&mut mesh, None, &rest, "plate").unwrap();
        let total: f64 = (0..mesh.triangles.len()).map(|t| mesh.facet_area(t)).sum();
        assert!((total - 0.004).abs() < 1e-12);
        // 100 × (2 + 2 · 0.5) mm, ragged by half a facet on either side.
        assert!((mesh.finished_area() - 300e-6).abs() < 40e-6, "{}", mesh.finished_area());
        for t in 0..mesh.triangles.len() {
            let [a, b, c] = mesh.corners(t);
            assert!((b - a).cross(&(c - a)).z > 0.0, "facet {t} is turned over");
            if mesh.is_finished(t) {
                assert!(mesh.corners(t).iter().all(|p| (p.y - 0.02).abs() < 2.6e-3));
            } else {
                assert!((centroid(&mesh, t).y - 0.02).abs() > 1.4e-3);
            }
        }
        // Conforming: all but the outline's edges have two facets.
        let topology = MeshTopology::of(&mesh);
        let on_outline = |p: &Point3<f64>| p.x == 0.0 || p.x == 0.1 || p.y == 0.0 || p.y == 0.04;
        for v in 0..mesh.vertices.len() {
            assert_eq!(topology.is_border(v), on_outline(&mesh.vertices[v]), "{}", mesh.vertices[v]);
        }
    }

    #[test]
    fn check_surface_stays_so_and_what_is_elsewhere_is_named() {
        let (mut mesh, mut rest) = (plate(), strip());
        mesh.check_only = vec![true, false];
        restrict(&mut mesh, None, &rest, "plate").unwrap();
        let diagonal = |p: &Point3<f64>| p.y - 0.4 * p.x;
        assert!(
            (0..mesh.triangles.len())
                .filter(|t| mesh.is_finished(*t))
                .all(|t| diagonal(&centroid(&mesh, t)) > 0.0)
        );
        rest.cells.iter_mut().for_each(|cell| cell[2] = 7);
        let error = restrict(&mut plate(), None, &rest, "plate").unwrap_err();
        assert!(error.code == BAD_SELECTION && error.text.contains("plate"), "{error}");
    }

    #[test]
    fn a_rest_is_sampled_as_often_as_the_whole() {
        let grid = |n: usize| SurfaceSamples {
            points: (0..n * n)
                .map(|i| Point3::new((i / n) as f64 * 0.1, (i % n) as f64 * 0.04, 0.0) / (n - 1) as f64)
                .collect(),
            ..SurfaceSamples::default()
        };
        // 3 of 40 mm of the width.
        let finer = samples_per_side(&grid(50), &strip(), 50) as usize;
        let fine = grid(finer).points.iter().filter(|p| holds(&strip(), p)).count();
        assert!((1500..4000).contains(&fine), "{finer}: {fine}");
        let elsewhere = RestArea { cells: vec![[0, 0, 9]], ..strip() };
        assert_eq!(samples_per_side(&grid(50), &elsewhere, 50), 400);
        assert_eq!(samples_per_side(&grid(50), &elsewhere, 500), 1000);
    }

    #[test]
    fn the_fit_goes_along() {
        let (mut mesh, rest) = (plate(), strip());
        let curved = Curvature { max: 20.0, min: -3.0, direction: Vector3::x() };
        let mut fit = SmoothFit {
            normals: mesh.normals.clone(),
            curvature: vec![curved; 4],
            sharp: vec![false, false, true, false],
        };
        restrict(&mut mesh, Some(&mut fit), &rest, "plate").unwrap();
        let n = mesh.vertices.len();
        assert_eq!([fit.normals.len(), fit.curvature.len(), fit.sharp.len()], [n; 3]);
        assert!(fit.curvature.iter().all(|c| (c.max - 20.0).abs() < 1e-9 && (c.min + 3.0).abs() < 1e-9));
        assert_eq!(fit.sharp.iter().filter(|sharp| **sharp).count(), 1);
    }
}
