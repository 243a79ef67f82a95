//! Rolling balls per second on a binary STL:
//! `cargo run --release -p patchmill_geometry --example rolling_ball -- MESH.stl SAMPLES [SHADOW_MM|unlimited]`.
//!
//! Prints one JSON line. The mesh is in mm, the samples are spread evenly over its vertices, with the normals and
//! curvature of the smooth surface fitted to them; the shadow is that of the 38.1 mm torus (32.1 mm) unless told
//! otherwise. `points` is the number of points that can stop a ball. The deviations are those of a random subset from
//! the search of every point: relative, and of the ball's radius.

mod common;

use std::time::Instant;

use common::Outcome;
use patchmill_geometry::curvature::fit_smooth_surface;
use patchmill_geometry::rolling_ball::{BallTree, Reach};
use patchmill_geometry::surface_points::SurfacePoints;
use rayon::prelude::*;

const USAGE: &str = "usage: rolling_ball MESH.stl SAMPLES [SHADOW_MM|unlimited]";
/// Shadow radius of the 38.1 mm torus, 2·R1 + R2, mm.
const SHADOW: f64 = 32.1;
/// Shares of it: how near a point stops a ball, and how far apart the points are at most.
const NEAR: f64 = 0.2;
const SPACING: f64 = 0.03;
/// Samples that are checked.
const CHECKED: usize = 1000;

fn main() -> std::process::ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    common::finish(run(&arguments))
}

fn run(arguments: &[String]) -> Outcome<String> {
    let (path, wanted, shadow) = match arguments {
        [path, wanted] => (path, wanted, SHADOW),
        [path, wanted, shadow] if shadow == "unlimited" => (path, wanted, f64::INFINITY),
        [path, wanted, shadow] => {
            let expected = "a length above 0 or \"unlimited\"";
            (path, wanted, common::number("SHADOW_MM", shadow, expected, |x| x > 0.0)?)
        }
        _ => return Err(USAGE.into()),
    };
    let wanted = common::count("SAMPLES", wanted)?;
    let mut mesh = common::read_mesh(path)?;
    let fit = fit_smooth_surface(&mesh);
    mesh.normals = fit.normals;

    let start = Instant::now();
    let tree = BallTree::build(&SurfacePoints::of(&mesh, SPACING * SHADOW * 1e-3));
    let build_seconds = start.elapsed().as_secs_f64();
    let reach = Reach { near: NEAR * SHADOW * 1e-3, shadow: shadow * 1e-3 };
    let n = mesh.vertices.len();
    let samples: Vec<usize> = (0..wanted)
        .map(|i| if wanted <= n { (i as u128 * n as u128 / wanted as u128) as usize } else { i % n })
        .collect();
    let floor = |v: usize| fit.curvature[v].max;
    let start = Instant::now();
    let balls: Vec<f64> = samples
        .par_iter()
        .map(|&v| {
            let ball = tree.stop(&mesh.vertices[v], &mesh.normals[v], &reach, floor(v));
            ball.map_or(floor(v), |b| b.curvature)
        })
        .collect();
    let seconds = start.elapsed().as_secs_f64();
    let (relative, radius) = common::some_of(samples.len(), CHECKED)
        .into_par_iter()
        .map(|i| {
            let v = samples[i];
            let all = tree.stop_among_all(&mesh.vertices[v], &mesh.normals[v], &reach, floor(v));
            let (found, expected) = (balls[i], all.map_or(floor(v), |b| b.curvature));
            if found == expected {
                return (0.0, 0.0);
            }
            ((found / expected - 1.0).abs(), (1.0 / found - 1.0 / expected).abs())
        })
        .reduce(|| (0.0, 0.0), |a, b| (a.0.max(b.0), a.1.max(b.1)));
    Ok(format!(
        "{{\"triangles\":{},\"points\":{},\"samples\":{wanted},\"build_seconds\":{build_seconds:.4},\"points_per_second\":{:.0},\"threads\":{},\"max_relative_deviation\":{relative:e},\"max_deviation_mm\":{:e},\"peak_memory_mib\":{:.1}}}",
        mesh.triangles.len(),
        tree.len(),
        wanted as f64 / seconds,
        rayon::current_num_threads(),
        radius * 1e3,
        common::peak_memory_mib()
    ))
}
