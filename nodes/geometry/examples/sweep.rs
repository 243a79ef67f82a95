//! Time of the swept check: `cargo run --release -p patchmill_geometry --example sweep`.
//!
//! Raster passes of a 38.1 mm torus over a 150 mm wave, 0.9 mm moves, against 100 000 proof points; one JSON line.
#![allow(clippy::print_stdout)]

use std::sync::atomic::AtomicBool;
use std::time::Instant;

use nalgebra::{Point3, Unit, Vector3};
use patchmill_geometry::bvh::Bvh;
use patchmill_geometry::cutter::Cutter;
use patchmill_geometry::drop_cutter::DropCutter;
use patchmill_geometry::mesh::TriangleMesh;
use patchmill_geometry::sweep::{ProofPoints, sweep_fixed_axis};

/// A wave over [0, 0.15]² m in n × n cells.
fn wave(n: u32) -> TriangleMesh {
    let mut mesh = TriangleMesh::default();
    for (i, j) in (0..=n).flat_map(|i| (0..=n).map(move |j| (i, j))) {
        let (x, y) = (0.15 * f64::from(i) / f64::from(n), 0.15 * f64::from(j) / f64::from(n));
        mesh.vertices.push(Point3::new(x, y, 0.004 * (x * 40.0).sin() * (y * 35.0).cos()));
        mesh.normals.push(Vector3::z());
    }
    let id = |i: u32, j: u32| i * (n + 1) + j;
    for (i, j) in (0..n).flat_map(|i| (0..n).map(move |j| (i, j))) {
        mesh.triangles.push([id(i, j), id(i + 1, j), id(i + 1, j + 1)]);
        mesh.triangles.push([id(i, j), id(i + 1, j + 1), id(i, j + 1)]);
    }
    mesh
}

fn main() {
    let mesh = wave(224);
    let cutter = Cutter { r1: 0.01305, r2: 0.006 };
    let axis = Unit::new_normalize(Vector3::new(0.2, 0.0, 1.0));
    let bvh = Bvh::build(&mesh);
    let drops = DropCutter::new(&mesh, &bvh, cutter, &axis, &Vector3::x());
    let back = drops.frame().inverse();
    let passes: Vec<Vec<Point3<f64>>> = (0..33)
        .map(|pass| {
            let y = 0.15 * f64::from(pass) / 32.0;
            let tip = |k: u32| {
                let x = 0.15 * f64::from(k) / 182.0;
                drops.drop(x, y).map(|d| back * Point3::new(x, y, d.z))
            };
            (0..183).filter_map(tip).collect()
        })
        .collect();
    let lines: Vec<&[Point3<f64>]> = passes.iter().map(Vec::as_slice).collect();
    let points = ProofPoints::on_facets(&mesh, 0.48e-3);
    for cap in [0.15e-3, f64::INFINITY] {
        let mut residual = vec![f64::INFINITY; points.len()];
        let start = Instant::now();
        sweep_fixed_axis(&points, cutter, &axis, &lines, cap, &AtomicBool::new(false), &mut residual);
        let seconds = start.elapsed().as_secs_f64();
        let reached = residual.iter().filter(|r| r.is_finite()).count();
        let least = residual.iter().copied().fold(f64::INFINITY, f64::min);
        println!(
            "{{\"points\":{},\"moves\":{},\"cap_mm\":{},\"seconds\":{seconds:.4},\"threads\":{},\"reached\":{reached},\"least_mm\":{:.6}}}",
            points.len(),
            lines.iter().map(|l| l.len() - 1).sum::<usize>(),
            if cap.is_finite() { (cap * 1e3).to_string() } else { "null".into() },
            rayon::current_num_threads(),
            least * 1e3
        );
    }
}
