//! Drops per second on a binary STL: `cargo run --release -p patchmill_geometry --example drop_cutter -- MESH.stl POINTS`.
//!
//! Prints one JSON line. The mesh is in mm; the cutter is the 38.1 mm torus (R1 13.05, R2 6), the points are
//! spread evenly over the middle of the mesh in plan, in order along passes. A third argument inclines the axis by
//! so many degrees (default 10). The deviation is that of a random subset from drops onto every triangle.

mod common;

use std::time::Instant;

use common::Outcome;
use nalgebra::{Point3, Unit, Vector3};
use patchmill_geometry::{bvh::Bvh, cutter::Cutter, drop_cutter::DropCutter};
use rayon::prelude::*;

const USAGE: &str = "usage: drop_cutter MESH.stl POINTS [LEAN_DEGREES]";
/// Points that are checked.
const CHECKED: usize = 200;

fn main() -> std::process::ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    common::finish(run(&arguments))
}

fn run(arguments: &[String]) -> Outcome<String> {
    let (path, wanted, lean) = match arguments {
        [path, wanted] => (path, wanted, 10.0),
        [path, wanted, lean] => {
            (path, wanted, common::number("LEAN_DEGREES", lean, "0 to 89", |x| (0.0..=89.0).contains(&x))?)
        }
        _ => return Err(USAGE.into()),
    };
    let wanted = common::count("POINTS", wanted)?;
    let mesh = common::read_mesh(path)?;

    let start = Instant::now();
    let bvh = Bvh::build(&mesh);
    let build_seconds = start.elapsed().as_secs_f64();
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
    let deviation = common::some_of(points.len(), CHECKED)
        .into_par_iter()
        .map(|i| {
            let z = drops.drop_on_all(points[i].0, points[i].1).map_or(f64::NEG_INFINITY, |d| d.z);
            if z == heights[i] { 0.0 } else { (z - heights[i]).abs() }
        })
        .reduce(|| 0.0, f64::max);
    Ok(format!(
        "{{\"triangles\":{},\"points\":{},\"build_seconds\":{build_seconds:.4},\"axis_seconds\":{axis_seconds:.4},\"points_per_second\":{:.0},\"threads\":{},\"max_deviation_mm\":{:e},\"peak_memory_mib\":{:.1}}}",
        mesh.triangles.len(),
        points.len(),
        points.len() as f64 / seconds,
        rayon::current_num_threads(),
        deviation * 1e3,
        common::peak_memory_mib()
    ))
}
