//! Tests of the whole partitioning.

use super::*;
use nalgebra::{Matrix2, Point3, Vector3};
use patchmill_products::partition::{Classifier, feature};
use patchmill_products::stage::{SUPERSEDED, unobserved};
use proptest::prelude::*;
use std::sync::atomic::AtomicBool;

fn job(patches: std::ops::RangeInclusive<u8>) -> Job {
    Job { patches_min: *patches.start(), patches_max: *patches.end(), ..Job::default_for("test") }
}

/// Samples and field of bare points [x, y, z, κ*].
fn inputs(points: &[[f64; 4]], grid: Option<[u32; 2]>) -> (SurfaceSamples, RollingBallField) {
    let positions: Vec<_> = points.iter().map(|p| Point3::new(p[0], p[1], p[2])).collect();
    let samples = SurfaceSamples { grid, points: positions.clone(), ..SurfaceSamples::default() };
    let pseudo_curvature = points.iter().map(|p| p[3]).collect();
    (samples, RollingBallField { pseudo_curvature, contact: positions, shadow_radius: 0.0321 })
}

fn run(points: &[[f64; 4]], grid: Option<[u32; 2]>, job: &Job) -> Vec<Partition> {
    let (samples, field) = inputs(points, grid);
    partition(&samples, &field, job, &PartitionParams::default(), unobserved()).unwrap()
}

/// `rows` × `columns` samples 2 mm apart on a wavy surface, κ* by `curvature` of the position.
fn grid(rows: usize, columns: usize, curvature: impl Fn(f64, f64) -> f64) -> Vec<[f64; 4]> {
    (0..rows * columns)
        .map(|i| {
            let (x, y) = ((i / columns) as f64 * 0.002, (i % columns) as f64 * 0.002);
            [x, y, 0.003 * (40.0 * x).sin() + 0.002 * (50.0 * y).cos(), curvature(x, y)]
        })
        .collect()
}

/// Features of the fixture surface_1, 50 × 50, with the largest principal curvature for κ*.
fn surface_1() -> Vec<[f64; 4]> {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/fixtures/surface_1.json");
    let file: serde_json::Value = serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap();
    let net: [[Vector3<f64>; 4]; 4] = std::array::from_fn(|i| {
        std::array::from_fn(|j| {
            Vector3::from_fn(|k, _| file["control_points"][i][j][k].as_f64().unwrap() * 1e-3)
        })
    });
    let basis = |t: f64| {
        let s = 1.0 - t;
        [
            [s * s * s, 3.0 * t * s * s, 3.0 * t * t * s, t * t * t],
            [-3.0 * s * s, 3.0 * s * s - 6.0 * t * s, 6.0 * t * s - 3.0 * t * t, 3.0 * t * t],
            [6.0 * s, 6.0 * t - 12.0 * s, 6.0 * s - 12.0 * t, 6.0 * t],
        ]
    };
    let point = |u: f64, v: f64| {
        let (bu, bv) = (basis(u), basis(v));
        let d = |a: usize, b: usize| {
            (0..16).map(|i| net[i / 4][i % 4] * bu[a][i / 4] * bv[b][i % 4]).sum::<Vector3<f64>>()
        };
        let (s, su, sv) = (d(0, 0), d(1, 0), d(0, 1));
        let n = su.cross(&sv).normalize();
        let first = Matrix2::new(su.dot(&su), su.dot(&sv), su.dot(&sv), sv.dot(&sv));
        let second = Matrix2::new(d(2, 0).dot(&n), d(1, 1).dot(&n), d(1, 1).dot(&n), d(0, 2).dot(&n));
        let shape = first.try_inverse().unwrap() * second;
        let half = 0.5 * shape.trace();
        [s.x, s.y, s.z, half + (half * half - shape.determinant()).max(0.0).sqrt()]
    };
    (0..2500).map(|i| point((i / 50) as f64 / 49.0, (i % 50) as f64 / 49.0)).collect()
}

/// What must hold of every candidate.
fn check(points: &[[f64; 4]], candidates: &[Partition], job: &Job) {
    assert_eq!(candidates.len(), usize::from(job.patches_max - job.patches_min) + 1);
    for (i, c) in candidates.iter().enumerate() {
        assert_eq!((c.index as usize, c.count as usize), (i, candidates.len()));
        assert_eq!(c.patches.len(), usize::from(job.patches_min) + i);
        assert_eq!(c.labels.len(), points.len());
        let classifier = Classifier::new(c).unwrap();
        for (p, &label) in points.iter().zip(&c.labels) {
            let x = feature(&Point3::new(p[0], p[1], p[2]), p[3]);
            assert_eq!(classifier.classify(&x), usize::from(label));
        }
        for (label, patch) in c.patches.iter().enumerate() {
            let samples = c.labels.iter().filter(|&&l| usize::from(l) == label).count();
            assert!(samples > 0);
            assert_eq!(patch.sample_count as usize, samples);
            assert_eq!(patch.parts.iter().sum::<u32>() as usize, samples);
            assert!(patch.parts.is_sorted_by(|a, b| a >= b) && patch.parts.iter().all(|&n| n > 0));
        }
        assert!(c.patches.is_sorted_by(|a, b| a.mean.x <= b.mean.x));
    }
}

#[test]
fn separable_blobs_are_found_exactly() {
    let centres =
        [[0.0, 0.0, 0.0, 5.0], [0.1, 0.0, 0.01, -10.0], [0.05, 0.08, 0.0, 12.0], [0.0, 0.1, 0.03, 0.0]];
    let points: Vec<[f64; 4]> = (0..400)
        .map(|i| {
            let wobble = |k: usize| (((i * (13 + 4 * k) + 7 * k) % 37) as f64 / 37.0 - 0.5) * 0.02;
            let c = centres[i % 4];
            [c[0] + wobble(0), c[1] + wobble(1), c[2] + 0.1 * wobble(2), c[3] + 50.0 * wobble(3)]
        })
        .collect();
    let job = job(4..=4);
    let candidates = run(&points, None, &job);
    check(&points, &candidates, &job);
    let labels = &candidates[0].labels;
    assert!((0..400).all(|i| labels[i] == labels[i % 4]));
    assert!(candidates[0].patches.iter().all(|p| p.parts == [100]));
}

#[test]
fn inertia_is_that_of_scikit_learn() {
    // scikit-learn 1.9.1, KMeans(k, n_init=100, random_state=0) on the z-scored features of `surface_1()`,
    // recomputed there with numpy.
    let reference = [10_000.0, 6075.044, 4463.684, 3332.723, 2783.098, 2417.467, 2103.871, 1873.608];
    let points = surface_1();
    let job = job(1..=8);
    let candidates = run(&points, Some([50, 50]), &job);
    check(&points, &candidates, &job);
    for (candidate, expected) in candidates.iter().zip(reference) {
        let excess = candidate.inertia / expected - 1.0;
        assert!(
            excess.abs() < 0.005,
            "{} patches: {} for {expected}",
            candidate.patches.len(),
            candidate.inertia
        );
    }
    // Reclassification moves samples across borders, it does not make other patches.
    assert!(candidates.iter().flat_map(|c| &c.patches).all(|p| p.sample_count > 50));
}

#[test]
fn result_does_not_depend_on_threads() {
    let points = grid(30, 20, |x, y| 8.0 * (60.0 * x).sin() * (45.0 * y).cos());
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| run(&points, None, &job(1..=8)))
    };
    let one = run(1);
    assert_eq!(one, run(2));
    assert_eq!(one, run(5));
}

#[test]
fn patch_in_two_places_has_two_parts() {
    // Two curved bands in a flat field; the bands are far alike in κ* and near in the rest.
    let band = |x: f64| (0.010..0.014).contains(&x) || (0.024..0.028).contains(&x);
    let points = grid(20, 10, |x, _| if band(x + 1e-9) { 200.0 } else { 0.0 });
    let flat: Vec<[f64; 4]> = points.iter().map(|p| [p[0] * 1e-6, p[1] * 1e-6, 0.0, p[3]]).collect();
    for grid in [Some([20, 10]), None] {
        let job = job(2..=2);
        // Positions shrunk below the floor of the features: only κ* counts.
        let candidates = run(&flat, grid, &job);
        check(&flat, &candidates, &job);
        let mut parts: Vec<_> = candidates[0].patches.iter().map(|p| p.parts.clone()).collect();
        parts.sort();
        if grid.is_some() {
            assert_eq!(parts, [vec![20, 20], vec![60, 50, 50]]);
        }
    }
}

#[test]
fn flat_plate_is_parted_by_position_alone() {
    // z and κ* only carry rounding noise, which must not become a feature.
    let noise = |i: usize, size: f64| ((i * 7919) % 101) as f64 * size;
    let points: Vec<_> = (0..400)
        .map(|i| [(i / 10) as f64 * 0.002, (i % 10) as f64 * 0.002, noise(i, 1e-12), noise(i + 5, 1e-9)])
        .collect();
    let job = job(1..=3);
    let candidates = run(&points, Some([40, 10]), &job);
    check(&points, &candidates, &job);
    assert_eq!(candidates[0].feature_scale[2], 1.0);
    assert_eq!(candidates[0].feature_scale[3], 1.0);
    assert!(candidates.iter().flat_map(|c| &c.patches).all(|p| p.parts.len() == 1));
    assert_eq!(candidates[1].patches[0].sample_count, 200);
}

#[test]
fn a_few_odd_samples_do_not_break_a_candidate() {
    // Two outliers make a cluster of two: too small for statistics, but no reason to fail.
    let mut points = grid(12, 12, |_, _| 1.0);
    points[0][3] = 900.0;
    points[1][3] = 905.0;
    let job = job(1..=6);
    let candidates = run(&points, Some([12, 12]), &job);
    check(&points, &candidates, &job);
}

#[test]
fn as_many_patches_as_samples_still_work() {
    let points =
        [[0.0, 0.0, 0.0, 1.0], [0.01, 0.0, 0.0, 2.0], [0.0, 0.01, 0.001, 1.0], [0.01, 0.02, 0.0, 3.0]];
    let job = job(1..=4);
    check(&points, &run(&points, None, &job), &job);
}

#[test]
fn unusable_input_is_refused() {
    let points = grid(4, 5, |x, _| x);
    let code = |points: &[[f64; 4]], grid, job: &Job, params: &PartitionParams| {
        let (samples, field) = inputs(points, grid);
        partition(&samples, &field, job, params, unobserved()).map_err(|e| e.code).err()
    };
    let params = PartitionParams::default();
    assert_eq!(code(&points, Some([4, 5]), &job(1..=8), &params), None);
    assert_eq!(code(&points, Some([4, 4]), &job(1..=8), &params), Some(CODE_INPUT));
    assert_eq!(code(&[], None, &job(1..=8), &params), Some(CODE_INPUT));
    assert_eq!(code(&points, None, &job(0..=8), &params), Some(CODE_INPUT));
    assert_eq!(code(&points, None, &Job { patches_min: 5, ..job(1..=4) }, &params), Some(CODE_INPUT));
    assert_eq!(code(&points, None, &job(1..=21), &params), Some(CODE_TOO_MANY_PATCHES));
    assert_eq!(code(&[points[0]; 9], None, &job(2..=2), &params), Some(CODE_TOO_MANY_PATCHES));
    assert_eq!(code(&[points[0]; 9], None, &job(1..=1), &params), None);
    let mut holed = points.clone();
    holed[7][3] = f64::NAN;
    assert_eq!(code(&holed, None, &job(1..=2), &params), Some(CODE_INPUT));
    let none = PartitionParams { restarts: 0, ..params };
    assert_eq!(code(&points, None, &job(1..=2), &none), Some(CODE_INPUT));
    let (samples, mut field) = inputs(&points, None);
    field.pseudo_curvature.pop();
    let error = partition(&samples, &field, &job(1..=2), &params, unobserved()).unwrap_err();
    assert_eq!(error.code, CODE_INPUT);
}

#[test]
fn cancellation_ends_the_partitioning() {
    let (samples, field) = inputs(&grid(4, 5, |x, _| x), None);
    let cancelled = AtomicBool::new(true);
    let progress = Progress { cancelled: &cancelled, report: &|_| {} };
    let error = partition(&samples, &field, &job(1..=3), &PartitionParams::default(), progress).unwrap_err();
    assert_eq!(error.code, SUPERSEDED);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]
    #[test]
    fn every_candidate_is_consistent(
        points in prop::collection::vec([0.0f64..0.1, 0.0f64..0.1, 0.0f64..0.02, -20.0f64..20.0], 12..120),
    ) {
        let job = job(1..=5);
        check(&points, &run(&points, None, &job), &job);
    }
}

/// `cargo test --release -p patchmill_surface_partitioning -- --ignored --nocapture`
#[test]
#[ignore = "a measurement"]
fn time_of_all_candidates() {
    let points = surface_1();
    for grid in [Some([50, 50]), None] {
        let start = std::time::Instant::now();
        let candidates = run(&points, grid, &job(1..=8));
        println!("2500 samples, 1..8 patches, grid {grid:?}: {:?}", start.elapsed());
        for c in candidates {
            println!(
                "{} {:.3} {:?}",
                c.patches.len(),
                c.inertia,
                c.patches.iter().map(|p| &p.parts).collect::<Vec<_>>()
            );
        }
    }
}
