//! Patches chosen for the least machining time ([`Strategy::Fastest`](patchmill_products::job::Strategy)), instead of the k-means solution
//! of least inertia.
//!
//! The time of a partition is the sum of its patches', each held by the quickest orientation found for it
//! ([`patchmill_orientation::axis_search`]): the length of the curves that its passes would follow over the samples
//! ([`patchmill_orientation::pass_curves`]), and an end for every pass that meets the patch's border. k-means with the features weighted differently gives several partitions; the quickest of them is then changed a little at
//! random (a patch's mean moved, its covariance grown or stretched), over and over, and what is quicker is kept. All stay
//! partitions by minimum intra-class distance, so their borders stay smooth and their patches mostly whole.

use nalgebra::{Matrix4, Vector3, Vector4};
use patchmill_orientation::axis_search::{AxisSearch, End, SECONDS_PER_PATCH};
use patchmill_orientation::cloud_point::CloudPoint;
use patchmill_orientation::orientation::{Orientation, leads};
use patchmill_orientation::pass_curves::StepField;
use patchmill_orientation::step_over::offset_cutter;
use patchmill_products::field::RollingBallField;
use patchmill_products::job::Job;
use patchmill_products::partition::PatchStatistics;
use patchmill_products::samples::SurfaceSamples;
use patchmill_products::stage::{Progress, StageError};
use rand_xoshiro::Xoshiro256Plus;
use rand_xoshiro::rand_core::{RngCore, SeedableRng};

use crate::PartitionParams;
use crate::features::Features;
use crate::k_means;
use crate::micd::{self, Classification};
use crate::parts::Adjacency;

/// Weights of the z-scored [x, y, z, κ*] for other k-means partitions than the plain one.
const WEIGHTS: [[f64; 4]; 8] = [
    [1.0, 1.0, 1.0, 0.5],
    [1.0, 1.0, 1.0, 2.0],
    [1.0, 1.0, 1.0, 0.0],
    [2.0, 1.0, 1.0, 1.0],
    [1.0, 2.0, 1.0, 1.0],
    [0.5, 1.0, 1.0, 1.0],
    [1.0, 0.5, 1.0, 1.0],
    [1.0, 1.0, 3.0, 0.5],
];
/// k-means runs of each.
const WEIGHTED_RESTARTS: usize = 3;
/// Times that all orientations are searched all around again.
const SEARCHES: usize = 4;
/// One in so many samples is timed where orientations are searched; all of them limit the axes, and the passes of the one found are
/// laid over all.
const TIMED: usize = 4;
/// One in so many samples on a patch's border counts there.
const TIMED_ENDS: usize = 2;
/// Orientations of the fan that are refined for a patch.
const STARTS: usize = 2;
/// Time of a patch that has no orientation, s: worse than any that has one.
const IMPOSSIBLE: f64 = 1e5;
/// Least and largest size of a random change, z-scored units or logarithm of a stretch.
const CHANGES: [f64; 2] = [0.04, 0.4];

/// What partitions are timed by.
pub struct PatchTimer<'a> {
    points: Vec<CloudPoint>,
    leads: Vec<f64>,
    adjacency: &'a Adjacency,
    job: &'a Job,
}

/// A patch's time, s, and how it is held.
type Held = (f64, Option<Orientation>);

/// A partition with its patches' times.
struct Timed {
    classification: Classification,
    patches: Vec<Held>,
}

impl Timed {
    fn total(&self) -> f64 {
        self.patches.iter().map(|(time, _)| time + SECONDS_PER_PATCH).sum()
    }
}

impl<'a> PatchTimer<'a> {
    /// `None` where the cutter does not fit everywhere: there is nothing to be timed.
    pub fn new(
        samples: &SurfaceSamples,
        field: &RollingBallField,
        adjacency: &'a Adjacency,
        job: &'a Job,
    ) -> Option<Self> {
        let n = samples.len();
        let lengths = [
            samples.normals.len(),
            samples.curvature_max.len(),
            samples.curvature_min.len(),
            samples.direction_max.len(),
            samples.area.len(),
        ];
        if lengths.iter().any(|l| *l != n) {
            return None;
        }
        let points: Vec<CloudPoint> = (0..n).map(|i| point(samples, field, i)).collect();
        let leads = leads(&points.iter().collect::<Vec<_>>(), offset_cutter(job), job).ok()?;
        Some(Self { points, leads, adjacency, job })
    }

    /// The time of one patch, its orientation searched from `known` or, without it, all around.
    fn held(&self, labels: &[u8], patch: u8, known: Option<&Orientation>) -> Held {
        let members: Vec<usize> = (0..labels.len()).filter(|&i| labels[i] == patch).collect();
        let points: Vec<(&CloudPoint, f64)> =
            members.iter().map(|&i| (&self.points[i], self.leads[i])).collect();
        // The same samples whatever patch they are in; of a patch that has none of them all.
        let every = if members.iter().any(|i| i % TIMED == 0) { TIMED } else { 1 };
        let timed = members.iter().filter(|i| *i % every == 0).map(|&i| &self.points[i]);
        // What is timed stands for all.
        let share = points.iter().map(|(p, _)| p.area).sum::<f64>()
            / timed.clone().map(|p| p.area).sum::<f64>().max(1e-300);
        let ends = members.iter().filter_map(|&i| self.end(labels, i, share / TIMED_ENDS as f64));
        let ends = ends.step_by(TIMED_ENDS);
        let Some(search) = AxisSearch::new(&points, timed, ends, self.job) else {
            return (IMPOSSIBLE, None);
        };
        let found = match known {
            Some(known) => search.quickest_from(known),
            None => search.quickest(STARTS),
        };
        let Some((_, o)) = found else { return (IMPOSSIBLE, None) };
        let points: Vec<&CloudPoint> = points.into_iter().map(|(p, _)| p).collect();
        let field = StepField::new(&points, &o, offset_cutter(self.job), self.job);
        let (length, _) = field.estimate(&field.curves());
        (length / self.job.feed + search.time_of_ends(&o) * share, Some(o))
    }

    /// The border at a sample: what its neighbours within the patch lack of surrounding it, `None` inside the patch. Its length (m) is
    /// divided by `share`, the ratio of the patch's area to what of it is timed.
    fn end(&self, labels: &[u8], i: usize, share: f64) -> Option<End<'_>> {
        let place = self.points[i].position;
        let neighbours = self.adjacency.of_sample(i);
        let inward: Vector3<f64> = neighbours
            .iter()
            .filter(|&&j| labels[j as usize] == labels[i])
            .filter_map(|&j| (self.points[j as usize].position - place).try_normalize(1e-12))
            .sum();
        let outward = -inward / self.adjacency.one_sided();
        (outward.norm() > 0.4).then(|| (&self.points[i], outward * (self.points[i].area.sqrt() / share)))
    }

    fn timed(&self, classification: Classification) -> Timed {
        let patches = (0..classification.patches.len())
            .map(|patch| self.held(&classification.labels, patch as u8, None))
            .collect();
        Timed { classification, patches }
    }

    /// The same after a change of its statistics, patches searched anew only where their samples changed; `None` when that leaves a patch
    /// with too few samples or is not quicker.
    fn changed(&self, features: &Features, from: &Timed, patches: Vec<PatchStatistics>) -> Option<Timed> {
        let classification = micd::classify_once(features, patches)?;
        let k = from.patches.len();
        let mut touched = vec![false; k];
        for (new, old) in classification.labels.iter().zip(&from.classification.labels) {
            if new != old {
                touched[usize::from(*new)] = true;
                touched[usize::from(*old)] = true;
            }
        }
        if !micd::enough(&classification.labels, k) {
            return None;
        }
        let mut patches = from.patches.clone();
        let mut total = (0..k).filter(|&p| !touched[p]).map(|p| patches[p].0).sum::<f64>();
        let before: f64 = from.patches.iter().map(|(time, _)| time).sum();
        for patch in (0..k).filter(|&p| touched[p]) {
            patches[patch] = self.held(&classification.labels, patch as u8, from.patches[patch].1.as_ref());
            total += patches[patch].0;
            if total >= before {
                return None;
            }
        }
        Some(Timed { classification, patches })
    }
}

fn point(samples: &SurfaceSamples, field: &RollingBallField, i: usize) -> CloudPoint {
    CloudPoint {
        position: samples.points[i],
        normal: samples.normals[i],
        pseudo_curvature: field.pseudo_curvature[i],
        curvature: samples.curvature_tensor(i),
        facet_error: 0.0,
        area: samples.area[i],
    }
}

/// The quickest classification found with as many patches as `plain`, the one of plain k-means.
///
/// # Errors
/// SUPERSEDED when cancelled.
pub fn quickest(
    features: &Features,
    timer: &PatchTimer,
    plain: Classification,
    params: &PartitionParams,
    progress: Progress,
) -> Result<Classification, StageError> {
    let k = plain.patches.len();
    if k == 1 {
        return Ok(plain);
    }
    let mut best = timer.timed(plain);
    let fewer = PartitionParams { restarts: params.restarts.min(WEIGHTED_RESTARTS), ..*params };
    for weights in &WEIGHTS {
        progress.check()?;
        let weights = Vector4::from(*weights);
        let scored: Vec<Vector4<f64>> = features.scored.iter().map(|x| x.component_mul(&weights)).collect();
        // A weighting that leaves fewer clusters than asked for is no loss.
        let Ok(clusters) = k_means::cluster(&scored, k as u8, &fewer) else { continue };
        let Some(classification) = micd::classify(features, &clusters.labels, k) else { continue };
        let timed = timer.timed(classification);
        if timed.total() < best.total() {
            best = timed;
        }
    }
    let best = moved(features, timer, best, params, progress)?.classification;
    // The statistics have just classified: they can.
    Ok(micd::ordered(features, best.patches.clone()).unwrap_or(best))
}

/// The partition after many small random changes of which those are kept that make it quicker.
fn moved(
    features: &Features,
    timer: &PatchTimer,
    mut best: Timed,
    params: &PartitionParams,
    progress: Progress,
) -> Result<Timed, StageError> {
    let mut random = Xoshiro256Plus::seed_from_u64(params.seed ^ best.patches.len() as u64);
    let [least, most] = CHANGES;
    for step in 0..params.changes {
        progress.check()?;
        let size = most * (least / most).powf(step as f64 / params.changes as f64);
        let mut patches = best.classification.patches.clone();
        change(&mut patches, size, &mut random);
        if let Some(changed) = timer.changed(features, &best, patches) {
            best = changed;
        }
        // Once the patches have moved far enough, quite another orientation may have become the best.
        if (step + 1) % params.changes.div_ceil(SEARCHES) == 0 {
            let again = timer.timed(best.classification.clone());
            let quicker = best.patches.iter_mut().zip(again.patches).filter(|(own, new)| new.0 < own.0);
            quicker.for_each(|(own, new)| *own = new);
        }
    }
    Ok(best)
}

/// Moves the mean of a patch, grows its covariance, or stretches it along a direction.
fn change(patches: &mut [PatchStatistics], size: f64, random: &mut Xoshiro256Plus) {
    let at = (random.next_u64() % patches.len() as u64) as usize;
    let kind = random.next_u64() % 3;
    let direction = Vector4::from_fn(|_, _| uniform(random)) * size;
    let patch = &mut patches[at];
    match kind {
        0 => patch.mean += direction,
        1 => patch.covariance *= (2.0 * direction[0]).exp(),
        _ => {
            let along = direction / direction.norm().max(1e-12);
            let stretch =
                Matrix4::identity() + along * along.transpose() * ((2.0 * direction[1]).exp() - 1.0);
            let stretched = stretch * patch.covariance * stretch;
            patch.covariance = (stretched + stretched.transpose()) * 0.5;
        }
    }
}

/// Evenly between −1 and 1.
fn uniform(random: &mut Xoshiro256Plus) -> f64 {
    (random.next_u64() >> 11) as f64 * (2.0 / (1u64 << 53) as f64) - 1.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;
    use patchmill_products::job::Strategy;
    use patchmill_products::partition::Classifier;
    use patchmill_products::stage::unobserved;

    /// 30 × 30 samples, 3 mm apart, of waves along x: z = 4 mm·sin(60 x/m).
    fn waves() -> (SurfaceSamples, RollingBallField) {
        let mut samples = SurfaceSamples { grid: Some([30, 30]), ..SurfaceSamples::default() };
        for i in 0..900 {
            let (x, y) = ((i / 30) as f64 * 3e-3, (i % 30) as f64 * 3e-3);
            let (height, phase) = (4e-3, 60.0 * x);
            let rise = height * 60.0 * phase.cos();
            let root = rise.hypot(1.0);
            let curvature = -height * 3600.0 * phase.sin() / root.powi(3);
            let along = Vector3::new(1.0, 0.0, rise) / root;
            samples.points.push(Point3::new(x, y, height * phase.sin()));
            samples.normals.push(Vector3::new(-rise, 0.0, 1.0) / root);
            samples.curvature_max.push(curvature.max(0.0));
            samples.curvature_min.push(curvature.min(0.0));
            samples.direction_max.push(if curvature > 0.0 { along } else { Vector3::y() });
            samples.area.push(9e-6 * root);
        }
        let field = RollingBallField {
            pseudo_curvature: samples.curvature_max.clone(),
            contact: samples.points.clone(),
            shadow_radius: 0.0321,
        };
        (samples, field)
    }

    fn time(timer: &PatchTimer, labels: &[u8], k: u8) -> f64 {
        (0..k).map(|patch| timer.held(labels, patch, None).0).sum()
    }

    #[test]
    fn patches_get_quicker_and_stay_what_their_statistics_classify() {
        let (samples, field) = waves();
        let job = Job { strategy: Strategy::Fastest, ..Job::default_for("waves") };
        let (features, adjacency) = (Features::new(&samples, &field), Adjacency::of(&samples).unwrap());
        let timer = PatchTimer::new(&samples, &field, &adjacency, &job).unwrap();
        let params = PartitionParams { changes: 60, ..PartitionParams::default() };
        // Two patches can hardly do better than the plain ones here, four by a sixth.
        for (k, share) in [(2u8, 1.0), (4, 0.9)] {
            let clusters = k_means::cluster(&features.scored, k, &params).unwrap();
            let plain = micd::classify(&features, &clusters.labels, usize::from(k)).unwrap();
            let before = time(&timer, &plain.labels, k);
            let found = quickest(&features, &timer, plain.clone(), &params, unobserved()).unwrap();
            let after = time(&timer, &found.labels, k);
            assert!(after < share * before, "{k}: {after} s, {before} s before");
            let classifier =
                Classifier::from_statistics(features.mean, features.scale, &found.patches).unwrap();
            for (x, label) in features.raw.iter().zip(&found.labels) {
                assert_eq!(classifier.classify(x), usize::from(*label));
            }
            let again = quickest(&features, &timer, plain, &params, unobserved()).unwrap();
            assert_eq!(again.labels, found.labels);
        }
    }

    #[test]
    fn a_long_narrow_patch_is_cut_along() {
        let (samples, field) = waves();
        let job = Job { strategy: Strategy::Fastest, ..Job::default_for("waves") };
        let adjacency = Adjacency::of(&samples).unwrap();
        let timer = PatchTimer::new(&samples, &field, &adjacency, &job).unwrap();
        // A strip of 9 mm along y, and the rest.
        let labels: Vec<u8> = (0..900).map(|i| u8::from((12..15).contains(&(i / 30)))).collect();
        let (_, held) = timer.held(&labels, 1, None);
        assert!(held.unwrap().cross_feed.x.abs() > 0.9);
    }

    #[test]
    fn where_the_cutter_does_not_fit_nothing_is_timed() {
        let (samples, mut field) = waves();
        field.pseudo_curvature[7] = 1.0 / 10e-3;
        let adjacency = Adjacency::of(&samples).unwrap();
        assert!(PatchTimer::new(&samples, &field, &adjacency, &Job::default_for("waves")).is_none());
    }
}
