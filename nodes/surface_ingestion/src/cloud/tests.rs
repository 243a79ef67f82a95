//! Synthetic scans of surfaces of known equation.

use patchmill_products::stage::unobserved;
use rand_xoshiro::Xoshiro256Plus;
use rand_xoshiro::rand_core::{RngCore, SeedableRng};

use super::*;

const PARAMS: CloudParams = CloudParams { noise_tolerance: 50e-6, bridge_holes: 0.0 };
/// Radius of the bowl, mm.
const BOWL: f64 = 80.0;

struct Random(Xoshiro256Plus);

impl Random {
    fn new(seed: u64) -> Self {
        Self(Xoshiro256Plus::seed_from_u64(seed))
    }
    /// Evenly from 0 to 1.
    fn even(&mut self) -> f64 {
        (self.0.next_u64() >> 11) as f64 / (1u64 << 53) as f64
    }
    /// Normally, with unit deviation (Box and Muller).
    fn normal(&mut self) -> f64 {
        (-2.0 * (1.0 - self.even()).ln()).sqrt() * (std::f64::consts::TAU * self.even()).cos()
    }
}

/// Points of the graph z(x, y) over a square of `side` mm about the origin, about `spacing` mm apart, with normal noise (mm) along z.
fn scan(z: impl Fn(f64, f64) -> f64, side: f64, spacing: f64, grid: bool, noise: f64) -> Vec<Point3<f64>> {
    let mut random = Random::new(7);
    let n = (side / spacing).round() as usize;
    let mut points = Vec::new();
    for i in 0..=n {
        for j in 0..=n {
            let (x, y) = if grid {
                ((i as f64 / n as f64 - 0.5) * side, (j as f64 / n as f64 - 0.5) * side)
            } else {
                ((random.even() - 0.5) * side, (random.even() - 0.5) * side)
            };
            points.push(Point3::new(x, y, z(x, y) + noise * random.normal()) * 1e-3);
        }
    }
    points
}

fn bowl(x: f64, y: f64) -> f64 {
    BOWL - (BOWL * BOWL - x * x - y * y).sqrt()
}

fn read(points: Vec<Point3<f64>>, params: &CloudParams) -> Result<CloudSurface, StageError> {
    cloud_surface(RawCloud { points, no_return: 0 }, params, "scan", unobserved())
}

/// Root mean square distance of the vertices from the bowl, mm, and mean and largest error of the normals, degrees.
fn errors(surface: &CloudSurface) -> (f64, f64, f64) {
    let centre = Point3::new(0.0, 0.0, BOWL * 1e-3);
    let count = surface.mesh.vertices.len() as f64;
    let (mut square, mut sum, mut worst) = (0.0, 0.0, 0f64);
    for (p, n) in surface.mesh.vertices.iter().zip(&surface.mesh.normals) {
        let out = centre - p;
        square += (out.norm() * 1e3 - BOWL).powi(2);
        let angle = out.normalize().cross(n).norm().asin().to_degrees();
        assert!(out.dot(n) > 0.0);
        sum += angle;
        worst = worst.max(angle);
    }
    ((square / count).sqrt(), sum / count, worst)
}

fn area(surface: &CloudSurface) -> f64 {
    (0..surface.mesh.triangles.len())
        .map(|t| {
            let [a, b, c] = surface.mesh.corners(t);
            0.5e6 * (b - a).cross(&(c - a)).z
        })
        .sum()
}

#[test]
fn a_noisy_bowl_is_met_within_a_part_of_the_noise() {
    for (spacing, grid, deviation, mean, worst) in [
        (0.2, true, 0.002, 0.13, 2.2),
        (0.2, false, 0.002, 0.14, 2.2),
        (0.5, true, 0.0032, 0.15, 2.2),
        (0.5, false, 0.0032, 0.15, 2.2),
        (1.0, true, 0.004, 0.12, 2.2),
        (1.0, false, 0.004, 0.14, 2.2),
    ] {
        let surface = read(scan(bowl, 40.0, spacing, grid, 0.01), &PARAMS).unwrap();
        let found = errors(&surface);
        let report = surface.report;
        println!(
            "{spacing} mm, grid {grid}: RMS {:.5} mm, normals mean {:.3}° max {:.3}°, {} vertices, area {:.1} mm², {report}",
            found.0,
            found.1,
            found.2,
            surface.mesh.vertices.len(),
            area(&surface)
        );
        assert!(found.0 < deviation && found.1 < mean && found.2 < worst, "{spacing} {grid}: {found:?}");
        assert!((report.noise * 1e3 - 0.01).abs() < 0.001, "{report}");
        assert!((report.spacing * 1e3 / spacing - 1.0).abs() < 0.1, "{report}");
        assert!(
            report.moved <= PARAMS.noise_tolerance && report.isolated == 0 && report.holes_open == 0,
            "{report}"
        );
        assert!((area(&surface) / 1600.0 - 1.0).abs() < if grid { 1e-3 } else { 0.04 });
    }
}

#[test]
fn exact_points_stay_where_they_are() {
    let surface = read(scan(bowl, 40.0, 0.5, true, 0.0), &PARAMS).unwrap();
    let (deviation, mean, worst) = errors(&surface);
    println!("exact: {deviation:e} mm, {mean}°, {worst}°, {}", surface.report);
    assert!(deviation < 2e-5 && worst < 0.05);
    assert_eq!(surface.mesh.vertices.len(), 81 * 81);
    assert_eq!(surface.mesh.triangles.len(), 2 * 80 * 80);
    for curvature in &surface.fit.curvature {
        assert!(
            (curvature.max * BOWL * 1e-3 - 1.0).abs() < 0.05
                && (curvature.min * BOWL * 1e-3 - 1.0).abs() < 0.05
        );
    }
}

#[test]
fn noise_above_the_tolerance_is_refused_with_its_size() {
    let error = read(scan(bowl, 40.0, 0.5, false, 0.04), &PARAMS).map(|s| s.report).unwrap_err();
    assert_eq!(error.code, NOISY_CLOUD);
    assert!(
        error.text.contains("noise_tolerance_mm = 0.05") && error.text.contains("root mean square 0.039"),
        "{error}"
    );
    read(scan(bowl, 40.0, 0.5, false, 0.04), &CloudParams { noise_tolerance: 2e-4, ..PARAMS }).unwrap();
}

#[test]
fn outliers_and_repetitions_are_dropped_and_counted() {
    let mut points = scan(bowl, 40.0, 0.5, false, 0.01);
    let clean = errors(&read(points.clone(), &PARAMS).unwrap());
    let count = points.len();
    points.extend_from_within(..500);
    let mut random = Random::new(3);
    for _ in 0..60 {
        // Far above: alone; 1 mm above: a spike.
        let [x, y] = [random.even() * 30.0 - 15.0, random.even() * 30.0 - 15.0];
        points.push(Point3::new(x, y, bowl(x, y) + 20.0 + 100.0 * random.even()) * 1e-3);
        let [x, y] = [random.even() * 30.0 - 15.0, random.even() * 30.0 - 15.0];
        points.push(Point3::new(x, y, bowl(x, y) + 1.0) * 1e-3);
    }
    points.push(Point3::new(-900.0, 500.0, 3.0));
    let surface = read(points, &PARAMS).unwrap();
    let (report, found) = (surface.report, errors(&surface));
    println!("{report}: {found:?} against {clean:?}");
    assert_eq!((report.points, report.duplicates, report.isolated), (count + 621, 500, 61));
    assert!((55..=62).contains(&report.spikes));
    assert!(found.0 < 1.1 * clean.0 && found.1 < 1.1 * clean.1);
    let text = report.to_string();
    assert!(text.contains("500 repeated, 61 isolated ones dropped, 6"), "{text}");
}

#[test]
fn holes_and_concave_outlines_stay_and_holes_are_bridged_when_asked() {
    let points: Vec<_> = scan(bowl, 40.0, 0.5, false, 0.01)
        .into_iter()
        .filter(|p| {
            let (x, y) = (p.x * 1e3, p.y * 1e3);
            let hole = |cx: f64, cy: f64, r: f64| (x - cx).hypot(y - cy) > r;
            hole(0.0, 0.0, 3.0) && hole(10.0, 8.0, 6.0) && !(x < -8.0 && y < -8.0)
        })
        .collect();
    let open = read(points.clone(), &PARAMS).unwrap();
    let missing = 144.0 + std::f64::consts::PI * 45.0;
    println!("{}, area {:.1}", open.report, area(&open));
    assert_eq!((open.report.holes_open, open.report.holes_bridged), (2, 0));
    assert!((area(&open) - (1600.0 - missing)).abs() < 60.0);
    assert!(open.report.to_string().ends_with("2 holes left open"));

    let bridged = read(points, &CloudParams { bridge_holes: 8e-3, ..PARAMS }).unwrap();
    let found = errors(&bridged);
    println!("{}, area {:.1}, {found:?}", bridged.report, area(&bridged));
    assert_eq!((bridged.report.holes_open, bridged.report.holes_bridged), (1, 1));
    assert!(area(&bridged) - area(&open) > 0.9 * std::f64::consts::PI * 9.0);
    assert!(found.0 < 0.0032);
    let middle = bridged.mesh.vertices.iter().filter(|p| p.x.hypot(p.y) < 2.5e-3).count();
    assert!(middle > 50, "{middle}");
}

#[test]
fn a_tilted_part_is_seen_along_its_normal_and_from_above() {
    // A plate at 70° with a wave, scanned from below in file order: the tool side is up.
    let wave = |x: f64, _: f64| 0.5 * (x / 15.0 * std::f64::consts::TAU).sin();
    let (sin, cos) = 1.22f64.sin_cos();
    let turn = |p: Point3<f64>| Point3::new(p.x * cos + p.z * sin, p.y, p.z * cos - p.x * sin);
    let points = scan(wave, 30.0, 0.5, true, 0.002).into_iter().map(turn).collect();
    let surface = read(points, &PARAMS).unwrap();
    assert_eq!(surface.mesh.vertices.len(), 61 * 61);
    let mean: Vector3<f64> = surface.mesh.normals.iter().sum::<Vector3<f64>>().normalize();
    assert!((mean - Vector3::new(sin, 0.0, cos)).norm() < 0.01, "{mean}");
}

#[test]
fn what_folds_over_is_refused() {
    let tube = |z: f64, a: f64| Point3::new(10.0 * a.cos(), 10.0 * a.sin(), z) * 1e-3;
    let tube = (0..60)
        .flat_map(|z| (0..120).map(move |a| tube(f64::from(z) * 0.5, f64::from(a) * 0.052_36)))
        .collect();
    let sheets =
        [0.0, 8.0].iter().flat_map(|z| scan(move |x, _| z + 0.01 * x * x, 20.0, 0.5, false, 0.005)).collect();
    for (points, part) in [(tube, "no height field"), (sheets, "folds over")] {
        let error = read(points, &PARAMS).map(|s| s.report).unwrap_err();
        assert_eq!(error.code, BAD_TOPOLOGY);
        assert!(error.text.contains(part) && error.text.contains("as at x = "), "{error}");
    }
}

#[test]
fn clouds_that_are_no_surface_are_refused() {
    let mut random = Random::new(5);
    let volume = (0..5000).map(|_| Point3::new(random.even(), random.even(), random.even()) * 0.02).collect();
    let line = (0..500).map(|i| Point3::new(f64::from(i) * 1e-4, 0.0, 0.0)).collect();
    for (points, part) in [
        (vec![Point3::origin(); 1000], "1 different points are too few"),
        (line, "have no surface around them"),
        (volume, "noisier than noise_tolerance_mm"),
    ] {
        let error = read(points, &PARAMS).map(|s| s.report).unwrap_err();
        assert!(error.text.contains(part), "{part}: {error}");
    }
}

#[test]
fn a_cluster_of_points_is_thinned() {
    let mut points = scan(bowl, 40.0, 1.0, true, 0.001);
    let mut random = Random::new(9);
    points.extend((0..1500).map(|_| {
        let (x, y) = (random.even() * 1e-2, random.even() * 1e-2);
        Point3::new(x, y, bowl(x, y)) * 1e-3
    }));
    let surface = read(points, &PARAMS).unwrap();
    assert_eq!(surface.mesh.vertices.len(), 41 * 41);
}
