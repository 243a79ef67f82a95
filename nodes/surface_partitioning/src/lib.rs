//! Divides the samples of a surface into patches: one candidate partition for every number of patches of the job.
//!
//! Features are z-scored [x, y, z, κ*] (paper, "Clustering"; the pseudo-curvature κ* = 1/R* instead of the radius,
//! which jumps through ±∞ where the surface is flat). k-means++ finds the clusters; mean and covariance of each
//! then classify every point by minimum intra-class distance (paper, "Tool path generation"). Where the least time is asked for,
//! patches are chosen and moved for it ([`quickest_patches`]).

pub mod features;
pub mod k_means;
pub mod micd;
pub mod node;
pub mod parts;
pub mod quickest_patches;

use std::sync::atomic::{AtomicUsize, Ordering};

use patchmill_products::field::RollingBallField;
use patchmill_products::job::{Job, Strategy};
use patchmill_products::partition::{Classifier, Partition, feature};
use patchmill_products::samples::SurfaceSamples;
use patchmill_products::stage::{Progress, StageError};
use patchmill_rolling_ball_analysis::rest_zone::tightest_fit;
use rayon::prelude::*;

use features::Features;
use parts::Adjacency;
use quickest_patches::PatchTimer;

/// Code: no samples, arrays of different lengths, numbers that are not finite, or an impossible range of patches.
pub const CODE_INPUT: i32 = 301;
/// Code: more patches asked for than there are different samples.
pub const CODE_TOO_MANY_PATCHES: i32 = 302;
/// Code: no such clusters found.
pub const CODE_CLUSTERING: i32 = 303;
/// Code: the neighbours of the samples were not found.
pub const CODE_NEIGHBOURS: i32 = 304;

/// How to partition. What to partition into travels in the job.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PartitionParams {
    /// Seed of the k-means++ starts.
    pub seed: u64,
    /// Independent k-means++ runs of which the best counts, at least 1.
    pub restarts: usize,
    /// Iterations of one run at most, at least 1.
    pub max_iterations: u64,
    /// Random changes by which patches are moved where the least time is asked for; 0 leaves the quickest of several k-means
    /// partitions.
    pub changes: usize,
}

impl Default for PartitionParams {
    fn default() -> Self {
        Self { seed: 20_151_207, restarts: 10, max_iterations: 300, changes: 300 }
    }
}

/// One candidate partition for every number of patches from `job.patches_min` to `job.patches_max`, in order.
///
/// Where the job leaves places standing that the tool does not fit, patches are made of the others' samples, and the statistics count
/// those only. The result does not depend on the number of threads. In every candidate, `labels` are exactly what
/// [`patchmill_products::partition::Classifier`] says of the samples with the candidate's own statistics.
///
/// # Errors
/// Codes 301 to 304 (see the constants of this module), 1 when cancelled.
pub fn partition(
    samples: &SurfaceSamples,
    field: &RollingBallField,
    job: &Job,
    params: &PartitionParams,
    progress: Progress<'_>,
) -> Result<Vec<Partition>, StageError> {
    validate(samples, field, job, params)?;
    if job.leaves_rest()
        && let Some((kept, fitting)) = without_rest(samples, field, job)
    {
        let of_fitting =
            partition(&kept, &fitting, &Job { rest_lead: 0.0, ..job.clone() }, params, progress)?;
        return of_fitting.into_iter().map(|candidate| relabelled(candidate, samples, field)).collect();
    }
    let features = Features::new(samples, field);
    let distinct = features.distinct();
    if usize::from(job.patches_max) > distinct {
        return Err(StageError::new(
            CODE_TOO_MANY_PATCHES,
            format!("{} patches cannot be made of {distinct} different samples", job.patches_max),
        ));
    }
    let adjacency = Adjacency::of(samples)?;
    let timer = match job.strategy {
        Strategy::Fastest => PatchTimer::new(samples, field, &adjacency, job),
        _ => None,
    };
    let count = u32::from(job.patches_max - job.patches_min) + 1;
    let done = AtomicUsize::new(0);
    (job.patches_min..=job.patches_max)
        .into_par_iter()
        .map(|k| {
            progress.check()?;
            let index = u32::from(k - job.patches_min);
            let candidate =
                candidate(&features, &adjacency, timer.as_ref(), k, [index, count], params, progress)?;
            (progress.report)((done.fetch_add(1, Ordering::Relaxed) + 1) as f64 / f64::from(count));
            Ok(candidate)
        })
        .collect::<Vec<Result<_, _>>>()
        // Collected first: which of several errors is told must not depend on timing.
        .into_iter()
        .collect()
}

/// The samples at which the tool fits, with their field; `None` where it does everywhere.
fn without_rest(
    samples: &SurfaceSamples,
    field: &RollingBallField,
    job: &Job,
) -> Option<(SurfaceSamples, RollingBallField)> {
    let limit = tightest_fit(job);
    let kept: Vec<usize> = (0..samples.len()).filter(|&i| field.pseudo_curvature[i] <= limit).collect();
    if kept.len() == samples.len() {
        return None;
    }
    let field = RollingBallField {
        pseudo_curvature: kept.iter().map(|&i| field.pseudo_curvature[i]).collect(),
        contact: kept.iter().map(|&i| field.contact[i]).collect(),
        shadow_radius: field.shadow_radius,
    };
    Some((samples.only(&kept), field))
}

/// The candidate with labels of all samples, by its own statistics.
fn relabelled(
    candidate: Partition,
    samples: &SurfaceSamples,
    field: &RollingBallField,
) -> Result<Partition, StageError> {
    let classifier = Classifier::new(&candidate)
        .ok_or_else(|| StageError::new(CODE_CLUSTERING, "a patch's covariance is singular"))?;
    let all = samples.points.iter().zip(&field.pseudo_curvature);
    let labels = all.map(|(p, k)| classifier.classify(&feature(p, *k)) as u8).collect();
    Ok(Partition { labels, ..candidate })
}

fn candidate(
    features: &Features,
    adjacency: &Adjacency,
    timer: Option<&PatchTimer>,
    k: u8,
    [index, count]: [u32; 2],
    params: &PartitionParams,
    progress: Progress,
) -> Result<Partition, StageError> {
    let clustering = k_means::cluster(&features.scored, k, params)?;
    let mut classification =
        micd::classify(features, &clustering.labels, usize::from(k)).ok_or_else(|| {
            StageError::new(CODE_CLUSTERING, format!("the {k} clusters of k-means do not stay apart"))
        })?;
    if let Some(timer) = timer {
        classification = quickest_patches::quickest(features, timer, classification, params, progress)?;
    }
    let parts = adjacency.parts(&classification.labels, usize::from(k));
    for (patch, parts) in classification.patches.iter_mut().zip(parts) {
        patch.parts = parts;
    }
    Ok(Partition {
        index,
        count,
        feature_mean: features.mean,
        feature_scale: features.scale,
        labels: classification.labels,
        patches: classification.patches,
        inertia: clustering.inertia,
    })
}

fn validate(
    samples: &SurfaceSamples,
    field: &RollingBallField,
    job: &Job,
    params: &PartitionParams,
) -> Result<(), StageError> {
    let fail = |text: String| Err(StageError::new(CODE_INPUT, text));
    let (n, m) = (samples.len(), field.pseudo_curvature.len());
    if n == 0 {
        return fail("there are no samples to partition".into());
    }
    if n != m {
        return fail(format!("{n} samples came with a rolling-ball field of {m} values, expected as many"));
    }
    if let Some([rows, columns]) = samples.grid
        && rows as usize * columns as usize != n
    {
        return fail(format!("a grid of {rows} x {columns} samples came with {n} samples"));
    }
    let bad = samples
        .points
        .iter()
        .zip(&field.pseudo_curvature)
        .position(|(p, k)| !(p.coords.iter().all(|v| v.is_finite()) && k.is_finite()));
    if let Some(i) = bad {
        return fail(format!("sample {i} has a position or pseudo-curvature that is not a finite number"));
    }
    if job.patches_min == 0 || job.patches_min > job.patches_max {
        return fail(format!(
            "patches {}..{} is no range: expected 1 <= least <= largest",
            job.patches_min, job.patches_max
        ));
    }
    if params.restarts == 0 || params.max_iterations == 0 {
        return fail("restarts and max_iterations of the partitioning must be at least 1".into());
    }
    Ok(())
}

#[cfg(test)]
mod tests;
