//! k-means over z-scored features: greedy k-means++ starts, Lloyd steps with Hamerly's bounds.
//!
//! A point is looked at again only when the bounds on its distance to its own centre and to the next one cross (Hamerly 2010): the
//! labels are those of plain Lloyd steps, which end when no label changes. Of many points a stratified sample tries the starts, and
//! the best of them are compared and worked on with all points. Sums are taken in chunks of a fixed size in a fixed order, so a seed gives
//! the same bits on any number of threads.

use nalgebra::Vector4;
use patchmill_products::stage::StageError;
use rand_xoshiro::Xoshiro256Plus;
use rand_xoshiro::rand_core::{RngCore, SeedableRng};
use rayon::prelude::*;

use crate::{CODE_CLUSTERING, PartitionParams};

/// Starts are tried on no more points than this.
const TRIED: usize = 8192;
/// So many times the starts asked for are tried where they are cheap because of that.
const MORE_STARTS: usize = 4;
/// The best of those are compared by all points, ...
const COMPARED: usize = 12;
/// ... and the best of these worked on with them.
const FINISHED: usize = 2;
/// Points that one thread takes at a time.
const CHUNK: usize = 8192;

/// Labels and their sum of squares.
#[derive(Clone, Debug, PartialEq)]
pub struct Clustering {
    /// Cluster of every point.
    pub labels: Vec<u8>,
    /// Sum of squared distances to the clusters' means.
    pub inertia: f64,
}

/// Best of `params.restarts` starts, of four times as many where there are many points.
///
/// # Errors
/// When there are fewer than `k` different points.
pub fn cluster(points: &[Vector4<f64>], k: u8, params: &PartitionParams) -> Result<Clustering, StageError> {
    if k == 1 {
        let labels = vec![0; points.len()];
        let inertia = inertia(points, &labels, &means(points, &labels, 1));
        return Ok(Clustering { labels, inertia });
    }
    let mut random = Xoshiro256Plus::seed_from_u64(params.seed);
    let some = (points.len() > TRIED).then(|| stratified(points, TRIED, &mut random));
    let tried = some.as_deref().unwrap_or(points);
    let starts = if some.is_some() { MORE_STARTS * params.restarts } else { params.restarts };
    let seeds: Vec<u64> = (0..starts).map(|_| random.next_u64()).collect();
    let start = |seed: u64| {
        let centres = greedy_start(tried, usize::from(k), &mut Xoshiro256Plus::seed_from_u64(seed))?;
        Some(lloyd(tried, centres, params.max_iterations))
    };
    let mut runs: Vec<Run> = seeds.into_par_iter().filter_map(start).collect();
    runs.sort_by(|a, b| a.inertia.total_cmp(&b.inertia));
    if some.is_some() {
        // Runs of the same sum have come to the same clusters.
        runs.dedup_by(|b, a| b.inertia <= a.inertia * (1.0 + 1e-6));
        runs.truncate(COMPARED);
        runs.iter_mut().for_each(|run| run.inertia = inertia_about(points, &run.centres));
        runs.sort_by(|a, b| a.inertia.total_cmp(&b.inertia));
        runs.truncate(FINISHED);
        runs = runs.into_iter().map(|run| lloyd(points, run.centres, params.max_iterations)).collect();
        runs.sort_by(|a, b| a.inertia.total_cmp(&b.inertia));
    }
    runs.into_iter().next().map(|Run { labels, inertia, .. }| Clustering { labels, inertia }).ok_or_else(
        || {
            let text =
                format!("k-means found no {k} clusters of {} samples: fewer of them differ", points.len());
            StageError::new(CODE_CLUSTERING, text)
        },
    )
}

/// One point at random of each of `count` equal stretches of the points.
fn stratified(points: &[Vector4<f64>], count: usize, random: &mut Xoshiro256Plus) -> Vec<Vector4<f64>> {
    let begin = |i: usize| i * points.len() / count;
    (0..count)
        .map(|i| {
            let stretch = (begin(i + 1) - begin(i)) as u64;
            points[begin(i) + (random.next_u64() % stretch) as usize]
        })
        .collect()
}

/// k-means++ (Arthur and Vassilvitskii 2007): points as centres, each drawn by its squared distance to those before; of 2 + ln k
/// draws the one that leaves the least sum. `None` when fewer than `k` points differ.
fn greedy_start(points: &[Vector4<f64>], k: usize, random: &mut Xoshiro256Plus) -> Option<Vec<Vector4<f64>>> {
    let first = points.get((random.next_u64() % points.len().max(1) as u64) as usize)?;
    let mut centres = vec![*first];
    let mut distances: Vec<f64> = points.iter().map(|p| (p - first).norm_squared()).collect();
    let draws = 2 + (k as f64).ln() as usize;
    while centres.len() < k {
        let total: f64 = distances.iter().sum();
        if total <= 0.0 {
            return None;
        }
        let tries = (0..draws).map(|_| {
            let at = drawn(&distances, fraction(random) * total);
            let closer: Vec<f64> =
                points.iter().zip(&distances).map(|(p, d)| (p - points[at]).norm_squared().min(*d)).collect();
            (closer.iter().sum::<f64>(), at, closer)
        });
        let (_, at, closer) = tries.min_by(|a, b| a.0.total_cmp(&b.0))?;
        centres.push(points[at]);
        distances = closer;
    }
    Some(centres)
}

/// The first item at which the running sum passes `target`; one of weight 0 never is.
fn drawn(weights: &[f64], target: f64) -> usize {
    let (mut sum, mut last) = (0.0, 0);
    for (i, weight) in weights.iter().enumerate().filter(|(_, weight)| **weight > 0.0) {
        sum += weight;
        last = i;
        if sum > target {
            break;
        }
    }
    last
}

/// Evenly from 0 to 1, 1 left out.
fn fraction(random: &mut Xoshiro256Plus) -> f64 {
    (random.next_u64() >> 11) as f64 / (1u64 << 53) as f64
}

/// Where Lloyd steps have come to.
struct Run {
    labels: Vec<u8>,
    centres: Vec<Vector4<f64>>,
    inertia: f64,
}

/// What is known of a point: its label, no less than its distance to that centre, no more than that to any other.
#[derive(Clone, Copy)]
struct Bounds {
    label: u8,
    upper: f64,
    lower: f64,
}

/// The points of a cluster, or by how many more it has got.
#[derive(Clone, Copy)]
struct Sum {
    sum: Vector4<f64>,
    count: i64,
}

impl Sum {
    const NONE: Self = Self { sum: Vector4::new(0.0, 0.0, 0.0, 0.0), count: 0 };

    fn add(&mut self, other: &Self) {
        self.sum += other.sum;
        self.count += other.count;
    }
}

/// Lloyd steps until no label changes.
fn lloyd(points: &[Vector4<f64>], mut centres: Vec<Vector4<f64>>, max_iterations: u64) -> Run {
    let mut known: Vec<Bounds> =
        points.par_iter().with_min_len(CHUNK).map(|p| nearest(p, &centres)).collect();
    let mut sums = sums(points, &known, centres.len());
    for _ in 0..max_iterations {
        let next = moved_centres(points, &known, &centres, &sums);
        let moves = Moves::of(&centres, &next);
        centres = next;
        let changes: Vec<Option<Vec<Sum>>> = known
            .par_chunks_mut(CHUNK)
            .zip(points.par_chunks(CHUNK))
            .map(|(known, points)| moves.update(known, points, &centres))
            .collect();
        if changes.iter().all(Option::is_none) {
            break;
        }
        // Only what has changed hands: most steps leave most points unread.
        for change in changes.iter().flatten() {
            sums.iter_mut().zip(change).for_each(|(sum, change)| sum.add(change));
        }
    }
    let labels: Vec<u8> = known.iter().map(|known| known.label).collect();
    let inertia = inertia(points, &labels, &means(points, &labels, centres.len()));
    Run { labels, centres, inertia }
}

#[inline]
fn nearest(p: &Vector4<f64>, centres: &[Vector4<f64>]) -> Bounds {
    let (mut label, mut first, mut second) = (0, f64::INFINITY, f64::INFINITY);
    for (i, c) in centres.iter().enumerate() {
        let d = (p - c).norm_squared();
        if d < first {
            (label, first, second) = (i as u8, d, first);
        } else if d < second {
            second = d;
        }
    }
    Bounds { label, upper: first.sqrt(), lower: second.sqrt() }
}

/// Every cluster's points, chunk by chunk.
fn sums(points: &[Vector4<f64>], known: &[Bounds], k: usize) -> Vec<Sum> {
    let of_chunk = |(points, known): (&[Vector4<f64>], &[Bounds])| {
        let mut sums = vec![Sum::NONE; k];
        for (p, known) in points.iter().zip(known) {
            sums[usize::from(known.label)].add(&Sum { sum: *p, count: 1 });
        }
        sums
    };
    let chunks: Vec<Vec<Sum>> = points.par_chunks(CHUNK).zip(known.par_chunks(CHUNK)).map(of_chunk).collect();
    let mut sums = vec![Sum::NONE; k];
    for chunk in &chunks {
        sums.iter_mut().zip(chunk).for_each(|(sum, chunk)| sum.add(chunk));
    }
    sums
}

/// Means of the clusters; a centre that has lost all its points goes to the point farthest from its own.
fn moved_centres(
    points: &[Vector4<f64>],
    known: &[Bounds],
    centres: &[Vector4<f64>],
    sums: &[Sum],
) -> Vec<Vector4<f64>> {
    let farthest = || {
        let off = |i: &usize| (points[*i] - centres[usize::from(known[*i].label)]).norm_squared();
        (0..points.len()).max_by(|a, b| off(a).total_cmp(&off(b)).then(b.cmp(a)))
    };
    let mean = |(i, sum): (usize, &Sum)| match sum.count {
        0 => farthest().map_or(centres[i], |at| points[at]),
        count => sum.sum / count as f64,
    };
    sums.iter().enumerate().map(mean).collect()
}

/// How far the centres have moved in a step, and how far they are apart after it.
struct Moves {
    own: Vec<f64>,
    /// The largest one of all others.
    others: Vec<f64>,
    /// Half the distance to the nearest other centre: a point within it is nowhere nearer.
    half_gap: Vec<f64>,
}

impl Moves {
    fn of(before: &[Vector4<f64>], after: &[Vector4<f64>]) -> Self {
        let own: Vec<f64> = before.iter().zip(after).map(|(a, b)| (b - a).norm()).collect();
        let over_others = |i: usize, least: f64, of: &dyn Fn(usize) -> f64, pick: fn(f64, f64) -> f64| {
            (0..after.len()).filter(|&j| j != i).map(of).fold(least, pick)
        };
        let others = |i| over_others(i, 0.0, &|j| own[j], f64::max);
        let gap = |i| over_others(i, f64::INFINITY, &|j| (after[j] - after[i]).norm(), f64::min);
        Self {
            others: (0..after.len()).map(others).collect(),
            half_gap: (0..after.len()).map(|i| 0.5 * gap(i)).collect(),
            own,
        }
    }

    /// Brings bounds and labels up to date; what the clusters have won and lost, if anything.
    fn update(
        &self,
        known: &mut [Bounds],
        points: &[Vector4<f64>],
        centres: &[Vector4<f64>],
    ) -> Option<Vec<Sum>> {
        let mut changes = None;
        for (known, p) in known.iter_mut().zip(points) {
            let label = usize::from(known.label);
            known.upper += self.own[label];
            known.lower -= self.others[label];
            let bound = known.lower.max(self.half_gap[label]);
            if known.upper <= bound {
                continue;
            }
            known.upper = (p - centres[label]).norm();
            if known.upper <= bound {
                continue;
            }
            let found = nearest(p, centres);
            // Of two centres equally near a point keeps its own.
            if found.label != known.label {
                let changes: &mut Vec<Sum> = changes.get_or_insert_with(|| vec![Sum::NONE; centres.len()]);
                changes[usize::from(found.label)].add(&Sum { sum: *p, count: 1 });
                changes[label].add(&Sum { sum: -p, count: -1 });
            }
            *known = found;
        }
        changes
    }
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

/// Sum of squared distances to the nearest centres.
fn inertia_about(points: &[Vector4<f64>], centres: &[Vector4<f64>]) -> f64 {
    let squared =
        |p: &Vector4<f64>| centres.iter().map(|c| (p - c).norm_squared()).fold(f64::INFINITY, f64::min);
    let sums: Vec<f64> = points.par_chunks(CHUNK).map(|points| points.iter().map(squared).sum()).collect();
    sums.iter().sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cloud(n: usize, seed: u64) -> Vec<Vector4<f64>> {
        let mut random = Xoshiro256Plus::seed_from_u64(seed);
        let mut along = move || 2.0 * fraction(&mut random) - 1.0;
        (0..n)
            .map(|_| {
                let (x, y) = (along(), along());
                Vector4::new(x, y, (3.0 * x).sin() * y, (x * y).powi(2) + 0.1 * along())
            })
            .collect()
    }

    /// Lloyd steps without bounds.
    fn plain(points: &[Vector4<f64>], mut centres: Vec<Vector4<f64>>) -> Vec<u8> {
        let assign =
            |centres: &[Vector4<f64>]| points.iter().map(|p| nearest(p, centres).label).collect::<Vec<_>>();
        let mut labels = assign(&centres);
        loop {
            centres = means(points, &labels, centres.len());
            let next = assign(&centres);
            if next == labels {
                return labels;
            }
            labels = next;
        }
    }

    #[test]
    fn bounds_do_not_change_the_labels() {
        for (seed, k) in [(1, 2), (2, 3), (3, 5), (4, 8)] {
            let points = cloud(3000, seed);
            let start = greedy_start(&points, k, &mut Xoshiro256Plus::seed_from_u64(seed)).unwrap();
            let run = lloyd(&points, start.clone(), 1000);
            assert_eq!(run.labels, plain(&points, start));
        }
    }

    #[test]
    fn many_points_come_to_what_all_starts_on_all_of_them_come_to() {
        let points = cloud(40_000, 7);
        let params = PartitionParams::default();
        for k in [2, 5, 8] {
            let mut random = Xoshiro256Plus::seed_from_u64(99);
            let all = (0..10)
                .map(|_| lloyd(&points, greedy_start(&points, k, &mut random).unwrap(), 300).inertia)
                .fold(f64::INFINITY, f64::min);
            let found = cluster(&points, k as u8, &params).unwrap().inertia;
            assert!(found <= all * (1.0 + 1e-4), "{k}: {found} {all}");
        }
    }

    #[test]
    fn a_cluster_that_empties_gets_the_farthest_point() {
        let points: Vec<Vector4<f64>> =
            [0.0, 0.1, 0.2, 5.0].iter().map(|x| Vector4::new(*x, 0.0, 0.0, 0.0)).collect();
        let far = Vector4::repeat(1e3);
        let run = lloyd(&points, vec![Vector4::zeros(), far], 100);
        assert_eq!(run.labels, [0, 0, 0, 1]);
    }

    #[test]
    fn fewer_different_points_than_clusters_are_an_error() {
        let points = vec![Vector4::repeat(1.0); 20];
        assert!(cluster(&points, 2, &PartitionParams::default()).is_err());
    }
}
