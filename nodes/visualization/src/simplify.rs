//! Fewer triangles and fewer points, for display only.

use std::cmp::Ordering;
use std::collections::{BTreeMap, BTreeSet};

use nalgebra::{Point3, Vector3};
use patchmill_geometry::mesh::TriangleMesh;
use patchmill_geometry::mesh_topology::MeshTopology;

/// Tolerance that polylines are simplified with first, m; doubled until the points are few enough.
const FIRST_TOLERANCE: f64 = 10e-6;

/// The mesh's triangles: all of them where there are no more than `most`, else those of a coarser mesh.
///
/// The coarser mesh has one vertex a cubic cell, the mean of the mesh's vertices in the cell; on the surface's border the
/// mean of the border's, so that the outline keeps its place. Triangles that fold over are turned to face the tool side, as the mesh's normals do.
pub fn display_triangles(mesh: &TriangleMesh, most: usize) -> Vec<[Point3<f64>; 3]> {
    let count = mesh.triangles.len();
    if count <= most {
        return (0..count).map(|t| mesh.corners(t)).collect();
    }
    let area: f64 = (0..count).map(|t| area_of(&mesh.corners(t))).sum();
    let topology = MeshTopology::of(mesh);
    // Two triangles a cell's area at best; a surface that is slanted to the cells asks for more.
    let mut cell = (2.0 * area / most.max(1) as f64).sqrt();
    if !(cell.is_finite() && cell > 0.0) {
        return Vec::new();
    }
    loop {
        let triangles = clustered(mesh, &topology, cell);
        if triangles.len() <= most {
            return triangles;
        }
        cell *= 1.1;
    }
}

/// Area of a triangle, m².
pub fn area_of(corners: &[Point3<f64>; 3]) -> f64 {
    normal_of(corners).norm() / 2.0
}

/// The mesh with the vertices of every cubic cell of that size (m) made one.
fn clustered(mesh: &TriangleMesh, topology: &MeshTopology, cell: f64) -> Vec<[Point3<f64>; 3]> {
    let mut numbers: BTreeMap<[i64; 3], usize> = BTreeMap::new();
    let mut sums: Vec<(bool, Vector3<f64>, f64)> = Vec::new();
    let mut cluster_of = Vec::with_capacity(mesh.vertices.len());
    for (v, point) in mesh.vertices.iter().enumerate() {
        let key: [i64; 3] = std::array::from_fn(|k| (point[k] / cell).floor() as i64);
        let number = *numbers.entry(key).or_insert_with(|| {
            sums.push((false, Vector3::zeros(), 0.0));
            sums.len() - 1
        });
        cluster_of.push(number);
        let sum = &mut sums[number];
        let border = topology.is_border(v);
        if border && !sum.0 {
            *sum = (true, Vector3::zeros(), 0.0);
        }
        if border == sum.0 {
            sum.1 += point.coords;
            sum.2 += 1.0;
        }
    }
    let mut seen = BTreeSet::new();
    let mut triangles = Vec::new();
    for vertices in &mesh.triangles {
        let corners = vertices.map(|v| cluster_of[v as usize]);
        let mut sorted = corners;
        sorted.sort_unstable();
        if sorted[0] != sorted[1] && sorted[1] != sorted[2] && seen.insert(sorted) {
            let [a, b, c] = corners.map(|c| Point3::from(sums[c].1 / sums[c].2));
            let tool_side: Vector3<f64> = vertices.iter().map(|v| mesh.normals[*v as usize]).sum();
            let facing = normal_of(&[a, b, c]).dot(&tool_side);
            match facing.total_cmp(&0.0) {
                Ordering::Greater => triangles.push([a, b, c]),
                Ordering::Less => triangles.push([a, c, b]),
                // Without area, or on edge: not to be seen.
                Ordering::Equal => {}
            }
        }
    }
    triangles
}

/// Normal of a triangle, twice its area long, m².
fn normal_of([a, b, c]: &[Point3<f64>; 3]) -> Vector3<f64> {
    (b - a).cross(&(c - a))
}

/// Polylines with no more than `most` points together where their ends allow it, and the tolerance (m) within which the
/// points left out lie beside the lines drawn; 0 when none is left out.
pub fn simplified(lines: &[&[Point3<f64>]], most: usize) -> (Vec<Vec<Point3<f64>>>, f64) {
    let count = |lines: &[Vec<Point3<f64>>]| lines.iter().map(Vec::len).sum::<usize>();
    let mut kept: Vec<Vec<Point3<f64>>> = lines.iter().map(|line| line.to_vec()).collect();
    let (mut tolerance, mut used) = (FIRST_TOLERANCE, 0.0);
    // 10 µm doubled 24 times is longer than any part.
    while count(&kept) > most && tolerance < 100.0 {
        kept = lines.iter().map(|line| within(line, tolerance)).collect();
        used = tolerance;
        tolerance *= 2.0;
    }
    (kept, used)
}

/// Douglas and Peucker's points of a polyline: those left out lie within the tolerance (m) of the chord drawn instead.
fn within(line: &[Point3<f64>], tolerance: f64) -> Vec<Point3<f64>> {
    let Some(end) = line.len().checked_sub(1) else { return Vec::new() };
    let mut keep = vec![false; line.len()];
    (keep[0], keep[end]) = (true, true);
    let mut pending = vec![(0, end)];
    while let Some((first, last)) = pending.pop() {
        let away = |i: &usize| distance_to_chord(&line[*i], &line[first], &line[last]);
        let farthest = (first + 1..last).max_by(|a, b| away(a).total_cmp(&away(b)));
        if let Some(i) = farthest.filter(|i| away(i) > tolerance) {
            keep[i] = true;
            pending.extend([(first, i), (i, last)]);
        }
    }
    line.iter().zip(keep).filter(|(_, keep)| *keep).map(|(p, _)| *p).collect()
}

fn distance_to_chord(p: &Point3<f64>, a: &Point3<f64>, b: &Point3<f64>) -> f64 {
    let (chord, way) = (b - a, p - a);
    let length = chord.norm_squared();
    let along = if length > 0.0 { (way.dot(&chord) / length).clamp(0.0, 1.0) } else { 0.0 };
    (way - chord * along).norm()
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// A bowl over a square of 0.1 m, n × n vertices.
    pub(crate) fn bowl(n: u32) -> TriangleMesh {
        let step = 0.1 / f64::from(n - 1);
        let vertices = (0..n * n).map(|i| {
            let (x, y) = (f64::from(i % n) * step, f64::from(i / n) * step);
            Point3::new(x, y, 2.0 * (x * x + y * y))
        });
        let corners = |i: u32| [[i, i + 1, i + n], [i + 1, i + n + 1, i + n]];
        let cells = (0..n - 1).flat_map(|r| (0..n - 1).map(move |c| r * n + c));
        TriangleMesh {
            vertices: vertices.collect(),
            normals: vec![Vector3::z(); (n * n) as usize],
            triangles: cells.flat_map(corners).collect(),
            chord_error: 0.0,
            check_only: Vec::new(),
        }
    }

    #[test]
    fn small_meshes_are_drawn_as_they_are() {
        let mesh = bowl(20);
        let triangles = display_triangles(&mesh, 2 * 19 * 19);
        assert_eq!(triangles, (0..mesh.triangles.len()).map(|t| mesh.corners(t)).collect::<Vec<_>>());
    }

    #[test]
    fn large_meshes_keep_area_and_outline_below_the_bound() {
        let mesh = bowl(150);
        let whole: f64 = (0..mesh.triangles.len()).map(|t| area_of(&mesh.corners(t))).sum();
        for most in [5000, 1000] {
            let triangles = display_triangles(&mesh, most);
            assert!(triangles.len() <= most && triangles.len() > most / 3, "{} of {most}", triangles.len());
            let area: f64 = triangles.iter().map(area_of).sum();
            assert!((area / whole - 1.0).abs() < 0.02, "{area} {whole}");
            let edge = triangles.iter().flatten().map(|p| p.x).fold(0.0, f64::max);
            assert!((edge - 0.1).abs() < 1e-9, "{edge}");
            // The means lie beside the surface by no more than the sagitta of a cell.
            let off = triangles.iter().flatten().map(|p| (p.z - 2.0 * (p.x * p.x + p.y * p.y)).abs());
            assert!(off.fold(0.0, f64::max) < 1e-4);
            assert!(
                triangles.iter().all(|[a, b, c]| (b - a).cross(&(c - a)).z > 0.0),
                "a triangle is turned"
            );
        }
    }

    #[test]
    fn polylines_keep_their_ends_and_the_tolerance() {
        let line: Vec<Point3<f64>> = (0..=1000)
            .map(|i| {
                let t = f64::from(i) / 1000.0;
                Point3::new(0.1 * t, 0.02 * (6.0 * t).sin(), 0.0)
            })
            .collect();
        let (all, none) = simplified(&[&line], 1001);
        assert_eq!((all[0].len(), none), (1001, 0.0));
        let (few, tolerance) = simplified(&[&line, &line[..2]], 60);
        assert!(few.iter().map(Vec::len).sum::<usize>() <= 60 && tolerance > 0.0);
        assert_eq!((few[0][0], few[0][few[0].len() - 1], few[1].len()), (line[0], line[1000], 2));
        for p in &line {
            let nearest = few[0].windows(2).map(|w| distance_to_chord(p, &w[0], &w[1])).fold(1.0, f64::min);
            assert!(nearest <= tolerance + 1e-12, "{nearest} {tolerance}");
        }
    }

    #[test]
    fn more_lines_than_points_asked_for_end_too() {
        let line = [Point3::origin(), Point3::new(0.1, 0.0, 0.0)];
        let (kept, _) = simplified(&[&line, &line, &line], 1);
        assert_eq!(kept.iter().map(Vec::len).sum::<usize>(), 6);
    }
}
