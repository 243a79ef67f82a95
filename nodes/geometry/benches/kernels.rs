//! The inner loops, one drop, ball or ray at a time: `cargo bench -p patchmill_geometry`. Beside their peers, and on all threads: `tests/peers/bench.py`.

// criterion's macro makes a public function.
#![allow(missing_docs)]

use criterion::{Criterion, criterion_group, criterion_main};
use nalgebra::{Point3, Unit, Vector3};
use patchmill_geometry::bvh::Bvh;
use patchmill_geometry::curvature::fit_smooth_surface;
use patchmill_geometry::cutter::Cutter;
use patchmill_geometry::drop_cutter::DropCutter;
use patchmill_geometry::mesh::TriangleMesh;
use patchmill_geometry::rolling_ball::{BallTree, Reach};
use patchmill_geometry::surface_points::SurfacePoints;
use patchmill_geometry::sweep::{ProofPoints, sweep_fixed_axis};

/// Side of the meshes, m.
const SIDE: f64 = 0.15;
/// Cells along a side: 5 and 100 thousand triangles.
const CELLS: [usize; 2] = [50, 224];
const CUTTER: Cutter = Cutter { r1: 0.01305, r2: 0.006 };

/// Hollows and crowns of 71 mm radius and more.
fn mesh(cells: usize) -> TriangleMesh {
    let line = |i: usize| SIDE * i as f64 / cells as f64;
    let turn = std::f64::consts::TAU / SIDE;
    let vertex = |k: usize| {
        let (x, y) = (line(k / (cells + 1)), line(k % (cells + 1)));
        Point3::new(x, y, 8e-3 * (turn * x).sin() * (turn * y).cos())
    };
    let vertices: Vec<Point3<f64>> = (0..(cells + 1) * (cells + 1)).map(vertex).collect();
    let mut triangles = Vec::with_capacity(2 * cells * cells);
    for i in 0..cells {
        for j in 0..cells {
            let at = |di: usize, dj: usize| ((i + di) * (cells + 1) + j + dj) as u32;
            triangles.extend([[at(0, 0), at(1, 0), at(1, 1)], [at(0, 0), at(1, 1), at(0, 1)]]);
        }
    }
    let normals = vec![Vector3::z(); vertices.len()];
    let mut mesh = TriangleMesh { vertices, triangles, normals, ..TriangleMesh::default() };
    mesh.normals = fit_smooth_surface(&mesh).normals;
    mesh
}

/// Places spread over the mesh, the same every time.
fn place(i: usize) -> (f64, f64) {
    let spread = |by: f64| SIDE * (0.1 + 0.8 * (i as f64 * by).fract());
    (spread(0.754_877_666), spread(0.569_840_291))
}

fn kernels(criterion: &mut Criterion) {
    for cells in CELLS {
        let mesh = mesh(cells);
        let triangles = mesh.triangles.len();
        let bvh = Bvh::build(&mesh);
        criterion.bench_function(&format!("hierarchy/{triangles}"), |bencher| {
            bencher.iter(|| Bvh::build(&mesh));
        });
        let axis = Unit::new_normalize(Vector3::new(0.17, 0.0, 1.0));
        let drops = DropCutter::new(&mesh, &bvh, CUTTER, &axis, &Vector3::x());
        let mut i = 0;
        criterion.bench_function(&format!("drop/{triangles}"), |bencher| {
            bencher.iter(|| {
                i += 1;
                let (x, y) = place(i);
                let q = drops.frame() * Point3::new(x, y, 0.0);
                drops.drop(q.x, q.y)
            });
        });
        let tree = BallTree::build(&SurfacePoints::of(&mesh, 0.4e-3));
        for (name, shadow) in [("ball, 32 mm shadow", 0.0321), ("ball, whole part", f64::INFINITY)] {
            let reach = Reach { near: 6.4e-3, shadow };
            criterion.bench_function(&format!("{name}/{triangles}"), |bencher| {
                bencher.iter(|| {
                    i += 1;
                    let v = i * 7919 % mesh.vertices.len();
                    tree.stop(&mesh.vertices[v], &mesh.normals[v], &reach, 0.0)
                });
            });
        }
        criterion.bench_function(&format!("ray/{triangles}"), |bencher| {
            bencher.iter(|| {
                i += 1;
                let (x, y) = place(i);
                bvh.first_hit(&mesh, &Point3::new(x, y, 0.05), &-Vector3::z(), (0.0, 0.1))
            });
        });
    }
}

/// One pass over the points of the swept check.
fn sweep(criterion: &mut Criterion) {
    let mesh = mesh(CELLS[1]);
    let points = ProofPoints::on_finished(&mesh, 0.6e-3);
    let pass: Vec<Point3<f64>> =
        (0..=300).map(|k| Point3::new(SIDE * f64::from(k) / 300.0, SIDE / 2.0, 8e-3)).collect();
    let axis = Unit::new_normalize(Vector3::new(0.17, 0.0, 1.0));
    let goes_on = std::sync::atomic::AtomicBool::new(false);
    criterion.bench_function("sweep of a 150 mm pass, 60 thousand points", |bencher| {
        let mut residual = vec![f64::INFINITY; points.len()];
        bencher.iter(|| {
            residual.fill(f64::INFINITY);
            sweep_fixed_axis(&points, CUTTER, &axis, &[pass.as_slice()], 0.15e-3, &goes_on, &mut residual);
        });
    });
}

criterion_group!(benches, kernels, sweep);
criterion_main!(benches);
