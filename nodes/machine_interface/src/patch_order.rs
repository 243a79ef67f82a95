//! The order of a candidate's patches in which the index moves between them are shortest.

use crate::clearance::PartBody;
use crate::motion::{ends_of, travel_of};
use nalgebra::Unit;
use patchmill_kinematics::{Joints, Machine};
use patchmill_products::job::Job;
use patchmill_products::toolpath::CandidateToolpath;
use std::f64::consts::TAU;

/// Patches up to which the best order is looked for: the subsets of more take too long.
const MOST_PATCHES: usize = 10;

/// A patch cut with one of its rotary solutions.
struct Stop {
    /// Place of the patch in the list.
    patch: usize,
    /// Joint values above its first and its last cutter location, lifted clear of the part, m and rad.
    ends: [Joints; 2],
}

/// Places of the patches in the order of the shortest index moves, by the time of the slowest axis at its full speed from lifted to
/// lifted; any patch may be the first one. The order that the toolpath has where a patch has no passes or is outside the travel, and of
/// more than ten patches.
pub fn shortest_order(
    toolpath: &CandidateToolpath,
    machine: &Machine,
    part: &PartBody,
    job: &Job,
) -> Vec<usize> {
    let count = toolpath.patches.len();
    let given = || (0..count).collect();
    if !(3..=MOST_PATCHES).contains(&count) {
        return given();
    }
    let stops: Vec<Stop> = (0..count).flat_map(|patch| stops(toolpath, patch, machine, part, job)).collect();
    round(count, &stops, |from, to| index_time(machine, from, to)).unwrap_or_else(given)
}

/// A patch with every rotary solution that has all of it within the travel.
fn stops(
    toolpath: &CandidateToolpath,
    patch: usize,
    machine: &Machine,
    part: &PartBody,
    job: &Job,
) -> Vec<Stop> {
    let path = &toolpath.patches[patch];
    let found =
        Unit::try_new(path.tool_axis, 1e-9).and_then(|axis| machine.orientations(&axis, [0.0; 2]).ok());
    let held = found.into_iter().flatten().filter_map(|o| machine.at_rotary(o.rotary).ok());
    held.filter_map(|held| {
        let ranges = travel_of(path, &held, part, job.clearance)?;
        let within = [0, 1].iter().all(|end| machine.violation(&ranges.map(|r| r[*end])).is_none());
        let ends = ends_of(path, &held, part, job.clearance)?;
        within.then(|| Stop { patch, ends: ends.map(|tip| held.joints(&tip)) })
    })
    .collect()
}

/// Time of the index move, s: axes without limits turn the shorter way.
fn index_time(machine: &Machine, from: &Joints, to: &Joints) -> f64 {
    let mut to = *to;
    for axis in 3..5 {
        if machine.axes()[axis].limits.is_none() {
            to[axis] = from[axis] + (to[axis] - from[axis] + 0.5 * TAU).rem_euclid(TAU) - 0.5 * TAU;
        }
    }
    machine.rapid_distance(from, &to)
}

/// The cheapest way to be at one stop of each of `count` patches once (Held, Karp 1962); `None` where a patch has no stop.
fn round(count: usize, stops: &[Stop], cost: impl Fn(&Joints, &Joints) -> f64) -> Option<Vec<usize>> {
    let between: Vec<Vec<f64>> =
        stops.iter().map(|a| stops.iter().map(|b| cost(&a.ends[1], &b.ends[0])).collect()).collect();
    let all = (1usize << count) - 1;
    // Least cost of having been at a set of patches, last at a stop, and the stop before it.
    let mut best = vec![vec![(f64::INFINITY, usize::MAX); stops.len()]; all + 1];
    for (s, stop) in stops.iter().enumerate() {
        best[1 << stop.patch][s].0 = 0.0;
    }
    for visited in 1..=all {
        for last in 0..stops.len() {
            let so_far = best[visited][last].0;
            if so_far == f64::INFINITY {
                continue;
            }
            for (next, stop) in stops.iter().enumerate().filter(|(_, stop)| visited & 1 << stop.patch == 0) {
                let found = (so_far + between[last][next], last);
                let known = &mut best[visited | 1 << stop.patch][next];
                if found.0 < known.0 {
                    *known = found;
                }
            }
        }
    }
    let mut at = (0..stops.len()).min_by(|&a, &b| best[all][a].0.total_cmp(&best[all][b].0))?;
    if best[all][at].0 == f64::INFINITY {
        return None;
    }
    let (mut visited, mut order) = (all, Vec::with_capacity(count));
    loop {
        order.push(stops[at].patch);
        let before = best[visited][at].1;
        visited &= !(1 << stops[at].patch);
        if visited == 0 {
            break;
        }
        at = before;
    }
    order.reverse();
    Some(order)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn stop(patch: usize, x: f64) -> Stop {
        Stop { patch, ends: [[x, 0.0, 0.0, 0.0, 0.0]; 2] }
    }

    fn apart(a: &Joints, b: &Joints) -> f64 {
        (a[0] - b[0]).abs()
    }

    /// All orders of the numbers below `n`.
    fn orders(n: usize) -> Vec<Vec<usize>> {
        if n == 0 {
            return vec![Vec::new()];
        }
        let insert = |order: Vec<usize>| {
            (0..n).map(move |at| {
                let mut order = order.clone();
                order.insert(at, n - 1);
                order
            })
        };
        orders(n - 1).into_iter().flat_map(insert).collect()
    }

    #[test]
    fn stops_in_a_row_are_visited_along_it() {
        let stops: Vec<Stop> = [3.0, 1.0, 4.0, 0.0].iter().enumerate().map(|(i, x)| stop(i, *x)).collect();
        let order = round(4, &stops, apart).unwrap();
        assert!(order == [3, 1, 0, 2] || order == [2, 0, 1, 3], "{order:?}");
    }

    #[test]
    fn a_patch_without_a_stop_has_no_order() {
        assert_eq!(round(3, &[stop(0, 0.0), stop(2, 1.0)], apart), None);
    }

    proptest! {
        #[test]
        fn no_order_is_shorter(places in prop::collection::vec((0usize..5, -1.0..1.0f64), 1..12)) {
            let stops: Vec<Stop> = places.iter().map(|(patch, x)| stop(*patch, *x)).collect();
            let ways = |order: &[usize]| {
                let mut costs: Vec<(f64, usize)> = Vec::new();
                for (k, patch) in order.iter().enumerate() {
                    let here = (0..stops.len()).filter(|s| stops[*s].patch == *patch);
                    costs = here.map(|s| {
                        let from = |(cost, t): &(f64, usize)| cost + apart(&stops[*t].ends[1], &stops[s].ends[0]);
                        (if k == 0 { 0.0 } else { costs.iter().map(from).fold(f64::INFINITY, f64::min) }, s)
                    }).collect();
                }
                costs.iter().map(|c| c.0).fold(f64::INFINITY, f64::min)
            };
            let least = orders(5).iter().map(|order| ways(order)).fold(f64::INFINITY, f64::min);
            match round(5, &stops, apart) {
                Some(order) => prop_assert!((ways(&order) - least).abs() < 1e-12),
                None => prop_assert!(least == f64::INFINITY),
            }
        }
    }
}
