//! Tests of the whole analysis on surfaces whose rolling ball is known.

use super::*;
use crate::test_surfaces::{Surface, grid_mesh, grid_samples};
use nalgebra::Point3;
use patchmill_geometry::curvature::fit_smooth_surface;
use patchmill_products::stage::unobserved;
use patchmill_surface_ingestion::{IngestionParams, SurfaceSource, ingest};
use std::sync::atomic::AtomicBool;

fn job() -> Job {
    Job::default_for("test")
}

fn field_of(mesh: &TriangleMesh, samples: &SurfaceSamples, job: &Job) -> RollingBallField {
    analyse(mesh, samples, job, &exact(), unobserved()).unwrap()
}

const BOTH: [ShadowKind; 2] = [ShadowKind::Exact, ShadowKind::Circles];

fn circles() -> AnalysisParams {
    AnalysisParams { shadow: ShadowKind::Circles, ..AnalysisParams::default() }
}

fn exact() -> AnalysisParams {
    AnalysisParams { shadow: ShadowKind::Exact, ..AnalysisParams::default() }
}

/// Largest relative deviation of κ* from 1/`radius`, with the principal curvature taken out of the samples so that
/// the mesh alone has to give the answer; the larger of both kinds of shadow and of the whole part.
fn deviation(surface: &Surface, cells: usize, radius: f64) -> f64 {
    let mesh = grid_mesh(surface, cells);
    let mut samples = grid_samples(surface, 12);
    samples.curvature_max.fill(-1e9);
    let of = |params: &AnalysisParams| {
        let field = analyse(&mesh, &samples, &job(), params, unobserved()).unwrap();
        field.pseudo_curvature.iter().map(|k| (k * radius - 1.0).abs()).fold(0.0, f64::max)
    };
    let whole = AnalysisParams { shadow_factor: 0.0, ..exact() };
    println!("R = {radius}: exact {:e}, whole {:e}, circles {:e}", of(&exact()), of(&whole), of(&circles()));
    of(&exact()).max(of(&whole)).max(of(&circles()))
}

#[test]
fn spheres_are_exact_on_meshes() {
    for (radius, half) in [(0.025, 0.015), (-0.040, 0.025), (0.300, 0.060)] {
        let found = deviation(&Surface::sphere(radius, half), 100, radius);
        assert!(found < 1e-3, "R = {radius}: {found}");
    }
}

#[test]
fn mesh_density_does_not_matter() {
    // 2 thousand and 50 thousand triangles; 2 thousand leave a chord error of 11 µm on R = 25 mm.
    for cells in [32, 158] {
        for (radius, half) in [(0.025, 0.015), (-0.040, 0.025)] {
            let found = deviation(&Surface::sphere(radius, half), cells, radius);
            assert!(found < 2e-3, "R = {radius}, {cells} cells: {found}");
        }
    }
}

#[test]
fn groove_holds_the_ball_that_cut_it() {
    let found = deviation(&Surface::groove(0.080, 0.030, 0.6), 120, 0.030);
    assert!(found < 1e-3, "{found}");
}

#[test]
fn concave_cylinder_stops_the_ball_across_and_convex_one_along() {
    let found = deviation(&Surface::cylinder(0.060, 0.040, 0.040), 100, 0.060);
    assert!(found < 1e-3, "{found}");
    // Along its straight lines a convex cylinder is flat, no point of it is above the tangent plane: κ* = 0.
    let convex = Surface::cylinder(-0.060, 0.040, 0.040);
    let field = field_of(&grid_mesh(&convex, 100), &grid_samples(&convex, 12), &job());
    assert!(field.pseudo_curvature.iter().all(|k| k.abs() < 1e-6), "{:?}", field.pseudo_curvature);
}

#[test]
fn plane_has_no_curvature() {
    let plane = Surface::plane(0.1);
    let field = field_of(&grid_mesh(&plane, 10), &grid_samples(&plane, 12), &job());
    assert!(field.pseudo_curvature.iter().all(|k| k.abs() < 1e-9));
    assert!((field.shadow_radius - 0.0321).abs() < 1e-12);
}

#[test]
fn a_wall_stops_the_ball_from_afar() {
    // A flat floor with a 45° wall from x = 10 mm on: a ball on the floor at distance a from the foot of the wall
    // touches it with R·tan(22.5°) = a. Principal curvatures are 0 everywhere: only the shadow sees the wall.
    let mut mesh = grid_mesh(&Surface::plane(0.060), 240);
    for v in &mut mesh.vertices {
        v.z = (v.x - 0.010).max(0.0);
    }
    let wall = Vector3::new(-1.0, 0.0, 1.0).normalize();
    for i in 0..mesh.vertices.len() {
        mesh.normals[i] = if mesh.vertices[i].x > 0.010 + 1e-9 { wall } else { Vector3::z() };
    }
    let mut samples = grid_samples(&Surface::plane(0.060), 2);
    for (i, x) in [-0.005, 0.0, 0.0, 0.001].into_iter().enumerate() {
        samples.points[i] = Point3::new(x, 0.0, 0.0);
    }
    // Five circles do not meet the touching point itself, nor does any vertex: the ball found is a little larger.
    for (kind, excess) in BOTH.into_iter().zip([0.001, 0.15]) {
        let params = AnalysisParams { shadow: kind, ..exact() };
        let field = analyse(&mesh, &samples, &job(), &params, unobserved()).unwrap();
        for (p, k) in samples.points.iter().zip(&field.pseudo_curvature) {
            let ball = (0.010 - p.x) / (std::f64::consts::PI / 8.0).tan();
            assert!(
                (1.0 / k) > ball * 0.999 && (1.0 / k) < ball * (1.0 + excess),
                "x = {}: {} for {ball}",
                p.x,
                1.0 / k
            );
        }
    }
}

#[test]
fn least_concave_radii_of_the_fixtures() {
    // Least concave principal radius on a dense grid: 93.0, 113.8 and 70.4 mm. The rolling ball cannot be larger.
    for (surface, radius) in [
        (Surface::bezier_fixture("surface_1"), 0.0930),
        (Surface::bezier_fixture("surface_2"), 0.1138),
        (Surface::waves(), 0.0704),
    ] {
        let samples = grid_samples(&surface, 40);
        let field = field_of(&grid_mesh(&surface, 80), &samples, &job());
        let found = 1.0 / field.pseudo_curvature.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        assert!((found / radius - 1.0).abs() < 0.005, "{found} for {radius}");
        check_tool_fits(&samples, &field, &job()).unwrap();
    }
}

#[test]
fn least_concave_radius_of_the_measured_mesh() {
    // surface_4 is a dome and a pocket as STL with 7 µm of chord error; its pocket has a radius of 45.0 mm.
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/fixtures/surface_4.stl");
    let source = SurfaceSource::new(std::fs::read(path).unwrap(), "surface_4.stl", "mm");
    let surface = ingest(&source, &IngestionParams::default(), unobserved()).unwrap();
    let field = field_of(&surface.mesh, &surface.samples, &job());
    let quantile = |values: &[f64], share: f64| {
        let mut sorted = values.to_vec();
        sorted.sort_by(f64::total_cmp);
        1.0 / sorted[((sorted.len() - 1) as f64 * share) as usize]
    };
    let (all, most) = (quantile(&field.pseudo_curvature, 1.0), quantile(&field.pseudo_curvature, 0.99));
    // Beside a jump of curvature the fitted normal is off by a milliradian or two, which the innermost circle turns
    // into a ball too small by up to 2.3 %: the safe side.
    assert!(all <= 0.0451 && all > 0.97 * 0.045, "{all}");
    assert!(most <= 0.0451 && most > 0.99 * 0.045, "{most}");
    check_tool_fits(&surface.samples, &field, &job()).unwrap();
}

/// How far the deepest mesh vertex of a shadow is inside its ball, m.
fn deepest_in_ball(mesh: &TriangleMesh, samples: &SurfaceSamples, field: &RollingBallField) -> f64 {
    let mut deepest = 0f64;
    for i in 0..samples.len() {
        let (p, n, kappa) = (samples.points[i], samples.normals[i], field.pseudo_curvature[i]);
        for v in &mesh.vertices {
            let d = v - p;
            let height = d.dot(&n);
            if (d - n * height).norm() <= field.shadow_radius {
                // Written without the radius, so that it holds for any κ; to first order in the depth.
                deepest = deepest.max(height - 0.5 * kappa * d.norm_squared());
            }
        }
    }
    deepest
}

#[test]
fn balls_hold_nothing_of_the_surface() {
    // What five circles leave unseen between them: most on the waves, whose κ(Q) peaks between two circles.
    for (surface, five_circles, without_border) in [
        (Surface::bezier_fixture("surface_1"), 5e-6, 100e-6),
        (Surface::waves(), 25e-6, 0.0),
        (Surface::groove(0.080, 0.030, 0.6), 1e-6, 0.0),
    ] {
        let (mesh, samples) = (grid_mesh(&surface, 100), grid_samples(&surface, 20));
        let deepest = |params: &AnalysisParams| {
            let field = analyse(&mesh, &samples, &job(), params, unobserved()).unwrap();
            assert!(field.pseudo_curvature.iter().zip(&samples.curvature_max).all(|(k, max)| k >= max));
            deepest_in_ball(&mesh, &samples, &field)
        };
        let params = circles();
        let (five, twenty) = (deepest(&params), deepest(&AnalysisParams { shadow_circles: 20, ..params }));
        let bare = deepest(&AnalysisParams { include_border: false, ..params });
        let all = deepest(&exact());
        println!(
            "µm: five circles {}, twenty {}, no border {}, exact {}",
            five * 1e6,
            twenty * 1e6,
            bare * 1e6,
            all * 1e6
        );
        // What is nearer than the exact shadow looks is left to the principal curvature.
        assert!(all < 1e-6, "{} µm", all * 1e6);
        assert!(five < five_circles, "{} µm", five * 1e6);
        assert!(twenty < 5e-6, "{} µm", twenty * 1e6);
        // The reason for the border: without it the balls dip into the surface.
        assert!(bare >= without_border, "{} µm", bare * 1e6);
    }
}

#[test]
fn ball_end_and_flat_end_have_their_shadows() {
    let surface = Surface::sphere(0.030, 0.018);
    for (r1, r2) in [(0.0, 0.006), (0.010, 0.0)] {
        let mut job = job();
        job.tool.cutter.r1 = r1;
        job.tool.cutter.r2 = r2;
        let field = field_of(&grid_mesh(&surface, 100), &grid_samples(&surface, 8), &job);
        assert!((field.shadow_radius - (2.0 * r1 + r2)).abs() < 1e-15);
        assert!(field.pseudo_curvature.iter().all(|k| (k * 0.030 - 1.0).abs() < 1e-3));
    }
}

#[test]
fn result_does_not_depend_on_threads() {
    let surface = Surface::bezier_fixture("surface_2");
    let (mesh, samples) = (grid_mesh(&surface, 60), grid_samples(&surface, 20));
    for shadow in BOTH {
        let params = AnalysisParams { shadow, ..exact() };
        let run = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| analyse(&mesh, &samples, &job(), &params, unobserved()).unwrap())
        };
        assert_eq!(run(1), run(3));
    }
}

#[test]
fn unusable_input_is_refused() {
    let surface = Surface::plane(0.1);
    let (mesh, samples) = (grid_mesh(&surface, 4), grid_samples(&surface, 4));
    let code = |mesh: &TriangleMesh, samples: &SurfaceSamples, job: &Job, params: &AnalysisParams| {
        analyse(mesh, samples, job, params, unobserved()).map_err(|e| e.code).err()
    };
    let (good, params) = (job(), exact());
    assert_eq!(code(&mesh, &samples, &good, &params), None);
    assert_eq!(code(&TriangleMesh::default(), &samples, &good, &params), Some(CODE_INPUT));
    assert_eq!(code(&mesh, &SurfaceSamples::default(), &good, &params), Some(CODE_INPUT));
    let mut short = samples.clone();
    short.curvature_max.pop();
    assert_eq!(code(&mesh, &short, &good, &params), Some(CODE_INPUT));
    let mut bent = samples.clone();
    bent.normals[3] *= 2.0;
    assert_eq!(code(&mesh, &bent, &good, &params), Some(CODE_INPUT));
    let mut torn = mesh.clone();
    torn.triangles[0][1] = 1000;
    assert_eq!(code(&torn, &samples, &good, &params), Some(CODE_INPUT));
    let mut holed = mesh.clone();
    holed.vertices[2].x = f64::NAN;
    assert_eq!(code(&holed, &samples, &good, &params), Some(CODE_INPUT));
    let mut pin = job();
    pin.tool.cutter.r1 = 0.0;
    pin.tool.cutter.r2 = 0.0;
    assert_eq!(code(&mesh, &samples, &pin, &params), Some(CODE_PARAMETERS));
    for unusable in [
        AnalysisParams { shadow_circles: 0, ..circles() },
        AnalysisParams { shadow_factor: 0.0, ..circles() },
        AnalysisParams { shadow_factor: -1.0, ..params },
        AnalysisParams { shadow_factor: f64::NAN, ..params },
    ] {
        assert_eq!(code(&mesh, &samples, &good, &unusable), Some(CODE_PARAMETERS));
    }
}

#[test]
fn cancellation_ends_the_analysis() {
    let surface = Surface::plane(0.1);
    let (mesh, samples) = (grid_mesh(&surface, 4), grid_samples(&surface, 4));
    let cancelled = AtomicBool::new(true);
    let progress = Progress { cancelled: &cancelled, report: &|_| {} };
    let error = analyse(&mesh, &samples, &job(), &exact(), progress).unwrap_err();
    assert_eq!(error.code, patchmill_products::stage::SUPERSEDED);
}

#[test]
fn large_facets_stop_the_ball_too() {
    // The wall of above as four triangles: only points inside of them tell.
    let x = [-0.060, 0.010, 0.060];
    let mut mesh = TriangleMesh::default();
    let wall = Vector3::new(-1.0, 0.0, 1.0).normalize();
    for (a, b, normal) in [(x[0], x[1], Vector3::z()), (x[1], x[2], wall)] {
        let first = mesh.vertices.len() as u32;
        for (x, y) in [(a, -0.060), (b, -0.060), (b, 0.060), (a, 0.060)] {
            mesh.vertices.push(Point3::new(x, y, (x - 0.010).max(0.0)));
            mesh.normals.push(normal);
        }
        mesh.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
    }
    let mut samples = grid_samples(&Surface::plane(0.060), 2);
    samples.points.fill(Point3::new(0.0, 0.0, 0.0));
    let field = field_of(&mesh, &samples, &job());
    let ball = 0.010 / (std::f64::consts::PI / 8.0).tan();
    assert!(field.pseudo_curvature.iter().all(|k| 1.0 / k > ball * 0.999 && 1.0 / k < ball * 1.01));
}

#[test]
fn the_whole_part_sees_what_is_beyond_the_shadow() {
    // A wall at 40 mm, beyond the 32.1 mm of the shadow.
    let mut mesh = grid_mesh(&Surface::plane(0.120), 120);
    mesh.vertices.iter_mut().for_each(|v| v.z = 2.0 * (v.x - 0.040).max(0.0));
    let mut samples = grid_samples(&Surface::plane(0.060), 2);
    samples.points.fill(Point3::new(0.0, 0.0, 0.0));
    let field = |shadow_factor: f64| {
        let params = AnalysisParams { shadow_factor, ..exact() };
        analyse(&mesh, &samples, &job(), &params, unobserved()).unwrap()
    };
    assert!(field(1.0).pseudo_curvature.iter().all(|k| k.abs() < 1e-9));
    let whole = field(0.0);
    let ball = 0.040 / (0.5 * 2f64.atan()).tan();
    assert!(whole.pseudo_curvature.iter().all(|k| (1.0 / k / ball - 1.0).abs() < 0.02));
    assert!(whole.shadow_radius > 0.120 && whole.shadow_radius < 0.20);
}

#[test]
fn balls_of_meshes_without_normals_have_the_surface_s_radius() {
    // 5 and 20 thousand triangles of which only the corners are known; every sample, of the border too.
    let parabola = 0.060;
    for (surface, radius) in [
        (Surface::sphere(0.050, 0.030), Some(0.050)),
        (Surface::cylinder(0.040, 0.030, 0.060), Some(0.040)),
        (Surface::groove(0.080, 0.030, 0.6), Some(0.030)),
        (Surface::paraboloid(parabola, 0.060), None),
    ] {
        for cells in [50, 100] {
            let mut mesh = grid_mesh(&surface, cells);
            let fit = fit_smooth_surface(&mesh);
            mesh.normals = fit.normals;
            let samples = SurfaceSamples {
                points: mesh.vertices.clone(),
                normals: mesh.normals.clone(),
                curvature_max: fit.curvature.iter().map(|c| c.max).collect(),
                direction_max: fit.curvature.iter().map(|c| c.direction).collect(),
                ..SurfaceSamples::default()
            };
            let field = field_of(&mesh, &samples, &job());
            let expected =
                |p: &Point3<f64>| radius.unwrap_or((parabola * parabola + p.x * p.x + p.y * p.y).sqrt());
            let right =
                |(k, p): (&f64, &Point3<f64>)| usize::from((1.0 / k / expected(p) - 1.0).abs() < 0.01);
            let right: usize = field.pseudo_curvature.iter().zip(&samples.points).map(right).sum();
            println!("{right} of {} right", samples.len());
            assert!(right * 100 >= samples.len() * 99, "{right} of {}", samples.len());
        }
    }
}

#[test]
fn radius_does_not_change_with_the_density() {
    // 5 and 50 thousand triangles: the same curvature to a hundredth for at least 99 % of the samples; balls of 500 mm
    // and more count as flat.
    for surface in
        [Surface::bezier_fixture("surface_1"), Surface::bezier_fixture("surface_2"), Surface::waves()]
    {
        let samples = grid_samples(&surface, 30);
        let [coarse, fine] = [50, 158].map(|cells| field_of(&grid_mesh(&surface, cells), &samples, &job()));
        let off = |(a, b): (&f64, &f64)| usize::from((a - b).abs() > 0.01 * b.abs().max(2.0));
        let changed: usize = coarse.pseudo_curvature.iter().zip(&fine.pseudo_curvature).map(off).sum();
        assert!(changed * 100 <= samples.len(), "{changed} of {}", samples.len());
    }
}

/// `cargo test --release -p patchmill_rolling_ball_analysis -- --ignored --nocapture`
#[test]
#[ignore = "a measurement"]
fn exact_and_circles_on_the_fixtures() {
    for (name, surface) in [
        ("surface_1", Surface::bezier_fixture("surface_1")),
        ("surface_2", Surface::bezier_fixture("surface_2")),
        ("surface_3", Surface::waves()),
    ] {
        let samples = grid_samples(&surface, 50);
        let truth = field_of(&grid_mesh(&surface, 700), &samples, &job());
        for cells in [50, 158, 316] {
            let mesh = grid_mesh(&surface, cells);
            for shadow in BOTH {
                let params = AnalysisParams { shadow, ..exact() };
                let start = std::time::Instant::now();
                let field = analyse(&mesh, &samples, &job(), &params, unobserved()).unwrap();
                let time = start.elapsed();
                let mut off: Vec<f64> = field
                    .pseudo_curvature
                    .iter()
                    .zip(&truth.pseudo_curvature)
                    .map(|(k, t)| (k - t).abs() * 0.5 * 0.0321 * 0.0321 * 1e6)
                    .collect();
                off.sort_by(f64::total_cmp);
                println!(
                    "{name} {} triangles {shadow:?}: {time:?}, sagitta over the shadow off by {:.3} (median) {:.3} (99 %) {:.3} (most) µm, {:.3} µm inside",
                    mesh.triangles.len(),
                    off[off.len() / 2],
                    off[off.len() * 99 / 100],
                    off[off.len() - 1],
                    deepest_in_ball(&grid_mesh(&surface, 100), &samples, &field) * 1e6
                );
            }
        }
    }
}

/// `cargo test --release -p patchmill_rolling_ball_analysis -- --ignored --nocapture`
#[test]
#[ignore = "a measurement"]
fn time_of_2500_samples() {
    let surface = Surface::bezier_fixture("surface_1");
    let samples = grid_samples(&surface, 50);
    for cells in [158, 316] {
        let mesh = grid_mesh(&surface, cells);
        let start = std::time::Instant::now();
        let bvh = Bvh::build(&mesh);
        let build = start.elapsed();
        drop(bvh);
        let start = std::time::Instant::now();
        let border = Border::of(&mesh);
        let border_time = start.elapsed();
        drop(border);
        let start = std::time::Instant::now();
        field_of(&mesh, &samples, &job());
        println!(
            "{} triangles: {:?}, of which hierarchy {build:?}, border {border_time:?}",
            mesh.triangles.len(),
            start.elapsed()
        );
    }
}
