//! k-means++ over z-scored features, by `linfa-clustering`.
//!
//! `linfa-clustering` runs the distance step in parallel but sums in order, so a fixed seed gives the same bits on
//! any number of threads. It averages each centre with its predecessor (a guard against empty clusters), so its
//! centres are a hair off the means; a few plain Lloyd steps afterwards bring labels and means into agreement.

use linfa::DatasetBase;
use linfa::ParamGuard;
use linfa::traits::Fit;
use linfa_clustering::KMeans;
use nalgebra::Vector4;
use ndarray::Array2;
use patchmill_products::stage::StageError;
use rand_xoshiro::Xoshiro256Plus;
use rand_xoshiro::rand_core::SeedableRng;

use crate::{CODE_CLUSTERING, PartitionParams};

/// Centres this close (z-scored units) to the step before end a run; Lloyd steps do the rest.
const TOLERANCE: f64 = 1e-3;

/// Labels and their sum of squares.
#[derive(Clone, Debug, PartialEq)]
pub struct Clustering {
    /// Cluster of every point.
    pub labels: Vec<u8>,
    /// Sum of squared distances to the clusters' means.
    pub inertia: f64,
}

/// Best of several k-means++ runs.
///
/// # Errors
/// When the library fails or leaves a cluster empty.
pub fn cluster(points: &[Vector4<f64>], k: u8, params: &PartitionParams) -> Result<Clustering, StageError> {
    if k == 1 {
        let labels = vec![0; points.len()];
        let inertia = inertia(points, &labels, &means(points, &labels, 1));
        return Ok(Clustering { labels, inertia });
    }
    let flat = points.iter().flat_map(|p| p.iter().copied()).collect();
    let failed = |e: &dyn std::fmt::Display| {
        StageError::new(
            CODE_CLUSTERING,
            format!("k-means found no {k} clusters of {} samples: {e}", points.len()),
        )
    };
    let records = Array2::from_shape_vec((points.len(), 4), flat).map_err(|e| failed(&e))?;
    let model = KMeans::params_with_rng(k as usize, Xoshiro256Plus::seed_from_u64(params.seed))
        .n_runs(params.restarts)
        .max_n_iterations(params.max_iterations)
        .tolerance(TOLERANCE)
        .check()
        .map_err(|e| failed(&e))?
        .fit(&DatasetBase::from(records))
        .map_err(|e| failed(&e))?;
    let centres: Vec<Vector4<f64>> =
        model.centroids().rows().into_iter().map(|r| Vector4::new(r[0], r[1], r[2], r[3])).collect();
    let clustering = settle(points, centres, params.max_iterations);
    let mut counts = vec![0usize; k as usize];
    clustering.labels.iter().for_each(|&l| counts[l as usize] += 1);
    if counts.contains(&0) {
        return Err(failed(&"a cluster stayed empty"));
    }
    Ok(clustering)
}

/// Plain Lloyd steps until no label changes.
fn settle(points: &[Vector4<f64>], mut centres: Vec<Vector4<f64>>, max_iterations: u64) -> Clustering {
    let k = centres.len();
    let mut labels = assign(points, &centres);
    for _ in 0..max_iterations {
        centres = means(points, &labels, k);
        let next = assign(points, &centres);
        if next == labels {
            break;
        }
        labels = next;
    }
    let inertia = inertia(points, &labels, &means(points, &labels, k));
    Clustering { labels, inertia }
}

fn assign(points: &[Vector4<f64>], centres: &[Vector4<f64>]) -> Vec<u8> {
    points
        .iter()
        .map(|p| {
            let mut best = (0, f64::INFINITY);
            for (i, c) in centres.iter().enumerate() {
                let d = (p - c).norm_squared();
                if d < best.1 {
                    best = (i, d);
                }
            }
            best.0 as u8
        })
        .collect()
}

/// Mean of each cluster's points; far away for an empty one.
pub fn means(points: &[Vector4<f64>], labels: &[u8], k: usize) -> Vec<Vector4<f64>> {
    let mut sums = vec![(Vector4::zeros(), 0usize); k];
    for (p, &l) in points.iter().zip(labels) {
        sums[l as usize].0 += p;
        sums[l as usize].1 += 1;
    }
    sums.into_iter()
        .map(|(sum, n)| if n == 0 { Vector4::repeat(f64::MAX.sqrt() / 4.0) } else { sum / n as f64 })
        .collect()
}

fn inertia(points: &[Vector4<f64>], labels: &[u8], means: &[Vector4<f64>]) -> f64 {
    points.iter().zip(labels).map(|(p, &l)| (p - means[l as usize]).norm_squared()).sum()
}
