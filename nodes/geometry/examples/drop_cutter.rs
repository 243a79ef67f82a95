//! Drops per second on a binary STL: `cargo run --release -p patchmill_geometry --example drop_cutter -- MESH.stl POINTS`.
//!
//! Prints one JSON line. The mesh is in mm; the cutter is the 38.1 mm torus (R1 13.05, R2 6), the points are
//! spread evenly over the middle of the mesh in plan, in order along passes. `LEAN` degrees (default 10) incline the axis.
#![allow(clippy::print_stdout)]

use std::time::Instant;

use nalgebra::{Point3, Unit, Vector3};
use patchmill_geometry::{bvh::Bvh, cutter::Cutter, drop_cutter::DropCutter, mesh::TriangleMesh};
use rayon::prelude::*;

/// Triangles of a binary STL (mm), corners with equal coordinates welded.
fn read_stl(bytes: &[u8]) -> Option<TriangleMesh> {
    let count = u32::from_le_bytes(bytes.get(80..84)?.try_into().ok()?) as usize;
    let number = |at: usize| Some(f32::from_le_bytes(bytes.get(at..at + 4)?.try_into().ok()?));
    let mut corners = Vec::with_capacity(3 * count);
    for i in 0..3 * count {
        let at = 84 + 50 * (i / 3) + 12 + 12 * (i % 3);
        corners.push(([number(at)?, number(at + 4)?, number(at + 8)?].map(|c| c + 0.0), i));
    }
    corners.par_sort_unstable_by(|a, b| a.partial_cmp(b).unwrap_or(std::cmp::Ordering::Equal));
    let mut mesh = TriangleMesh { triangles: vec![[0; 3]; count], ..Default::default() };
    for same in corners.chunk_by(|a, b| a.0 == b.0) {
        for &(_, i) in same {
            mesh.triangles[i / 3][i % 3] = mesh.vertices.len() as u32;
        }
        mesh.vertices.push(Point3::from(same[0].0.map(|c| f64::from(c) * 1e-3)));
        mesh.normals.push(Vector3::z());
    }
    Some(mesh)
}

/// Peak resident memory of this process, MiB (Linux).
fn peak_memory_mib() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|l| l.starts_with("VmHWM:"))?;
    line.split_whitespace().nth(1)?.parse::<f64>().ok().map(|kib| kib / 1024.0)
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let path = arguments.next().ok_or("usage: drop_cutter MESH.stl POINTS [LEAN_DEG]")?;
    let wanted: usize = arguments.next().map_or(Ok(100_000), |a| a.parse())?;
    let lean: f64 = arguments.next().map_or(Ok(10.0), |a| a.parse())?;
    let mesh = read_stl(&std::fs::read(&path)?).ok_or("not a binary STL")?;

    let start = Instant::now();
    let bvh = Bvh::build(&mesh);
    let bvh_seconds = start.elapsed().as_secs_f64();
    let start = Instant::now();
    let cutter = Cutter { r1: 0.01305, r2: 0.006 };
    let axis = Unit::new_normalize(Vector3::new(lean.to_radians().sin(), 0.0, lean.to_radians().cos()));
    let drops = DropCutter::new(&mesh, &bvh, cutter, &axis, &Vector3::x());
    let axis_seconds = start.elapsed().as_secs_f64();

    let (low, high) = bvh.extent().ok_or("the mesh has no triangle")?;
    let side = (wanted as f64).sqrt().ceil() as usize;
    let points: Vec<(f64, f64)> = (0..wanted)
        .map(|i| {
            let (u, v) = (((i % side) as f64 + 0.5) / side as f64, ((i / side) as f64 + 0.5) / side as f64);
            let (u, v) = (0.05 + 0.9 * u, 0.05 + 0.9 * v);
            let middle = 0.5 * (low.z + high.z);
            let p = Point3::new(low.x + u * (high.x - low.x), low.y + v * (high.y - low.y), middle);
            let q = drops.frame() * p;
            (q.x, q.y)
        })
        .collect();
    let start = Instant::now();
    let heights: Vec<f64> =
        points.par_iter().map(|&(x, y)| drops.drop(x, y).map_or(f64::NEG_INFINITY, |d| d.z)).collect();
    let seconds = start.elapsed().as_secs_f64();
    let step = (points.len() / 200).max(1);
    let deviation = (0..points.len())
        .into_par_iter()
        .step_by(step)
        .map(|i| {
            let z = drops.drop_on_all(points[i].0, points[i].1).map_or(f64::NEG_INFINITY, |d| d.z);
            if z == heights[i] { 0.0 } else { (z - heights[i]).abs() }
        })
        .reduce(|| 0.0, f64::max);
    println!(
        "{{\"triangles\":{},\"points\":{},\"build_seconds\":{:.4},\"axis_seconds\":{:.4},\"points_per_second\":{:.0},\"threads\":{},\"max_deviation_mm\":{:e},\"peak_memory_mib\":{:.1}}}",
        mesh.triangles.len(),
        points.len(),
        bvh_seconds,
        axis_seconds,
        points.len() as f64 / seconds,
        rayon::current_num_threads(),
        deviation * 1e3,
        peak_memory_mib().unwrap_or(0.0)
    );
    Ok(())
}
