//! From k-means clusters to patches that classification by minimum intra-class distance (MICD) reproduces (paper, "Tool path
//! generation"): x belongs to the class of least (x − μ)ᵀ S⁻¹ (x − μ), μ and S the mean and covariance of the class's samples.
//!
//! MICD borders are quadrics, k-means borders are planes, so some samples change patch when they are classified.
//! Rounds of "statistics of the labels, labels by the statistics" make both agree. What is kept is always a pair:
//! statistics and the labels that they classify to, so that any other point can be classified in the same way.

use nalgebra::{Matrix4, Vector4};
use patchmill_products::partition::{Classifier, PatchStatistics};

use crate::features::Features;
use crate::k_means::means;

/// Rounds of reclassification at most.
const ROUNDS: usize = 5;
/// Added to the diagonal of every covariance (z-scored units): planar patches have a singular one.
const RIDGE: f64 = 1e-3;
/// A patch with fewer samples has no statistics to speak of.
const LEAST_SAMPLES: usize = 5;

/// Statistics and the labels that they classify the samples to.
#[derive(Clone, Debug)]
pub struct Classification {
    /// Mean and covariance of every patch, in order of mean x, then y, z, κ*; counts filled, `parts` empty.
    pub patches: Vec<PatchStatistics>,
    /// `Classifier` labels of the samples by these `patches`.
    pub labels: Vec<u8>,
}

/// Classifies clusters until stable, at most five rounds.
///
/// Each round takes mean and covariance from the last labels and classifies all samples by them. A round that
/// would leave a patch with fewer than five samples (or than the least cluster, if that is smaller) is not taken:
/// the round before stands. If not even the first can be taken, all covariances are the identity, with which
/// MICD is the nearest mean: k-means itself. `None` when not even that keeps every patch.
pub fn classify(features: &Features, clusters: &[u8], k: usize) -> Option<Classification> {
    let least = counts(clusters, k).into_iter().min().unwrap_or(0).min(LEAST_SAMPLES);
    let mut kept: Option<Classification> = None;
    let mut labels = clusters.to_vec();
    for _ in 0..ROUNDS {
        let round = classify_once(features, in_order(statistics(&features.scored, &labels, k)))?;
        if counts(&round.labels, k).into_iter().any(|n| n < least) {
            break;
        }
        let stable = round.labels == labels;
        labels.clone_from(&round.labels);
        kept = Some(round);
        if stable {
            break;
        }
    }
    let kept = match kept {
        Some(kept) => kept,
        None => by_nearest_mean(features, clusters, k, least)?,
    };
    Some(counted(kept, k))
}

/// MICD with the identity for every covariance.
fn by_nearest_mean(features: &Features, clusters: &[u8], k: usize, least: usize) -> Option<Classification> {
    let patches = means(&features.scored, clusters, k)
        .into_iter()
        .map(|mean| PatchStatistics {
            mean,
            covariance: Matrix4::identity(),
            sample_count: 0,
            parts: Vec::new(),
        })
        .collect();
    let round = classify_once(features, in_order(patches))?;
    counts(&round.labels, k).into_iter().all(|n| n >= least).then_some(round)
}

/// The labels by such statistics; `None` when one of them cannot classify.
pub fn classify_once(features: &Features, patches: Vec<PatchStatistics>) -> Option<Classification> {
    let classifier = Classifier::from_statistics(features.mean, features.scale, &patches)?;
    let labels = features.raw.iter().map(|x| classifier.classify(x) as u8).collect();
    Some(Classification { patches, labels })
}

/// Mean and covariance (1/N) Σ (x − μ)(x − μ)ᵀ + 1e-3·I of every patch.
fn statistics(points: &[Vector4<f64>], labels: &[u8], k: usize) -> Vec<PatchStatistics> {
    let means = means(points, labels, k);
    let mut sums = vec![Matrix4::zeros(); k];
    for (p, &l) in points.iter().zip(labels) {
        let d = p - means[l as usize];
        sums[l as usize] += d * d.transpose();
    }
    let counts = counts(labels, k);
    (0..k)
        .map(|i| PatchStatistics {
            mean: means[i],
            covariance: sums[i] / counts[i].max(1) as f64 + Matrix4::identity() * RIDGE,
            sample_count: 0,
            parts: Vec::new(),
        })
        .collect()
}

/// Patch numbers that do not depend on the random start.
fn in_order(mut patches: Vec<PatchStatistics>) -> Vec<PatchStatistics> {
    patches.sort_by(|a, b| {
        (0..4)
            .map(|i| a.mean[i].total_cmp(&b.mean[i]))
            .find(|o| o.is_ne())
            .unwrap_or(std::cmp::Ordering::Equal)
    });
    patches
}

/// Whether every patch has the samples that statistics need.
pub fn enough(labels: &[u8], k: usize) -> bool {
    counts(labels, k).into_iter().all(|n| n >= LEAST_SAMPLES)
}

/// The classification by such statistics, the patches in order and with their counts; `None` as for [`classify_once`].
pub fn ordered(features: &Features, patches: Vec<PatchStatistics>) -> Option<Classification> {
    let k = patches.len();
    Some(counted(classify_once(features, in_order(patches))?, k))
}

fn counted(mut classification: Classification, k: usize) -> Classification {
    let counts = counts(&classification.labels, k);
    for (patch, n) in classification.patches.iter_mut().zip(counts) {
        patch.sample_count = n as u32;
    }
    classification
}

fn counts(labels: &[u8], k: usize) -> Vec<usize> {
    let mut counts = vec![0; k];
    labels.iter().for_each(|&l| counts[l as usize] += 1);
    counts
}
