//! Passes of all patches cut back to what the points of the swept check ask for.
//!
//! Passes reach beyond the points that they are laid for: over borders, as the contact runs ahead of the tool, and into
//! neighbouring patches. From the exact stretches on which each piece leaves no more than the scallop height of each point
//! [`crate::cut_cover`] tells what of it is needed. Links and lead arcs do not count as cutting. A shorter path cannot gouge.

use std::ops::Range;

use nalgebra::{Point3, Unit, Vector3};
use patchmill_geometry::cut_stretches::cut_stretches;
use patchmill_geometry::sweep::ProofPoints;
use patchmill_products::job::Job;
use patchmill_products::stage::{Progress, StageError};

use crate::cut_cover::{Kept, Stretch, shortened};
use crate::linking::CutChain;
use crate::pass_cut::Location;

/// The tips of a patch's pieces as they are looked at together with other patches'.
pub struct PatchTips {
    /// Unit tool axis, `workpiece` frame.
    pub axis: Unit<Vector3<f64>>,
    /// Tips of every piece in the order of the patch's chains, allowance included, `workpiece` frame, m.
    pub pieces: Vec<Vec<Point3<f64>>>,
    /// Area of the patch, m².
    pub area: f64,
}

/// The pieces of all patches with the stretches on which they cut the points.
pub struct CutPieces {
    stretches: Vec<Stretch>,
    /// Of every piece, m.
    lengths: Vec<f64>,
    /// Where each patch's pieces are.
    patches: Vec<Range<usize>>,
    /// In which pieces are shortened.
    order: Vec<usize>,
    /// Number of points.
    points: usize,
    /// Distance between them, m.
    spacing: f64,
}

impl CutPieces {
    /// Finds the stretches on which no more than the job's scallop height is left.
    ///
    /// # Errors
    /// SUPERSEDED when cancelled.
    pub fn find(
        points: &ProofPoints,
        patches: &[PatchTips],
        job: &Job,
        progress: Progress,
    ) -> Result<Self, StageError> {
        let height = job.scallop_height + job.stock_allowance;
        let (mut stretches, mut lengths, mut ranges) = (Vec::new(), Vec::new(), Vec::new());
        for patch in patches {
            let first = lengths.len();
            let lines: Vec<&[Point3<f64>]> = patch.pieces.iter().map(Vec::as_slice).collect();
            let found =
                cut_stretches(points, job.tool.cutter, &patch.axis, &lines, height, progress.cancelled);
            progress.check()?;
            for (point, found) in found.into_iter().enumerate() {
                let of = |polyline: u32| first + polyline as usize;
                stretches.extend(found.iter().map(|s| Stretch {
                    piece: of(s.polyline),
                    point,
                    from: s.from,
                    to: s.to,
                }));
            }
            lengths.extend(patch.pieces.iter().map(|tips| way(tips)));
            ranges.push(first..lengths.len());
        }
        // Where patches overlap the one with the closer passes gives way.
        let density = |p: usize| lengths[ranges[p].clone()].iter().sum::<f64>() / patches[p].area.max(1e-12);
        let mut by_density: Vec<usize> = (0..patches.len()).collect();
        by_density.sort_by(|&a, &b| density(b).total_cmp(&density(a)).then(a.cmp(&b)));
        let order = by_density.into_iter().flat_map(|p| ranges[p].clone()).collect();
        let spacing = points.weights.first().map_or(0.0, |weight| weight.sqrt());
        Ok(Self { stretches, lengths, patches: ranges, order, points: points.len(), spacing })
    }

    /// What is kept of every piece of every patch ([`trimmed`]): all of the points that the pieces cut stay cut, and both ends go
    /// on for the area between the points by `margin` times their distance.
    pub fn kept(&self, margin: f64) -> Vec<Kept> {
        let (stretches, margin) = (self.stretches.clone(), margin * self.spacing);
        let kept = shortened(&self.lengths, stretches, self.points, &self.order, margin);
        self.patches.iter().map(|range| kept[range.clone()].to_vec()).collect()
    }
}

/// Every `share`-th of the points: enough to compare candidates by.
pub fn fewer(points: &ProofPoints, share: usize) -> ProofPoints {
    ProofPoints {
        points: points.points.iter().step_by(share).copied().collect(),
        normals: points.normals.iter().step_by(share).copied().collect(),
        weights: points.weights.iter().step_by(share).copied().collect(),
    }
}

/// A patch's chains with what is kept of their pieces.
pub fn trimmed(chains: &[CutChain], kept: &Kept) -> Vec<CutChain> {
    let mut kept = kept.iter();
    let mut piece = |locations: &Vec<Location>| kept.next()?.map(|range| part(locations, range));
    chains
        .iter()
        .map(|chain| chain.iter().map(|line| line.iter().filter_map(&mut piece).collect()).collect())
        .collect()
}

/// Length of a polyline, m.
fn way(tips: &[Point3<f64>]) -> f64 {
    tips.windows(2).map(|w| (w[1] - w[0]).norm()).sum()
}

/// The stretch of a piece between two lengths of its way, m.
fn part(locations: &[Location], [from, to]: [f64; 2]) -> Vec<Location> {
    let (mut begin, mut part) = (0.0, Vec::new());
    for w in locations.windows(2) {
        let length = (w[1].tip - w[0].tip).norm();
        let end = begin + length;
        let meets = end >= from && (begin < to || (part.is_empty() && begin <= to));
        if meets && length > 0.0 {
            let at = |way: f64| between(&w[0], &w[1], ((way - begin) / length).clamp(0.0, 1.0));
            if part.is_empty() {
                part.push(at(from));
            }
            // A stretch may begin where a move ends.
            if end > from || to <= end {
                part.push(at(to));
            }
        }
        begin = end;
    }
    if part.is_empty() { locations.to_vec() } else { part }
}

fn between(a: &Location, b: &Location, share: f64) -> Location {
    if share >= 1.0 {
        return *b;
    }
    Location {
        tip: a.tip + (b.tip - a.tip) * share,
        contact: a.contact + (b.contact - a.contact) * share,
        axis: a.axis,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn straight(n: usize) -> Vec<Location> {
        let at = |k: usize| Point3::new(1e-3 * k as f64, 0.0, 0.0);
        (0..n).map(|k| Location { tip: at(k), contact: at(k), axis: Vector3::z() }).collect()
    }

    #[test]
    fn parts_have_their_ends_and_all_between() {
        let piece = straight(11);
        let xs = |range| part(&piece, range).iter().map(|l| (l.tip.x * 1e6).round()).collect::<Vec<_>>();
        assert_eq!(xs([0.0, 0.010]), (0..11).map(|k| f64::from(k) * 1000.0).collect::<Vec<_>>());
        assert_eq!(xs([0.0015, 0.0035]), [1500.0, 2000.0, 3000.0, 3500.0]);
        assert_eq!(xs([0.0012, 0.0016]), [1200.0, 1600.0]);
        let touching = xs([0.002, 0.004]);
        assert_eq!((touching[0], touching[touching.len() - 1]), (2000.0, 4000.0));
    }

    #[test]
    fn chains_lose_what_is_not_kept() {
        let chains = vec![vec![vec![straight(5)], vec![straight(5), straight(3)]]];
        let kept = vec![Some([0.001, 0.003]), None, Some([0.0, 0.002])];
        let left = trimmed(&chains, &kept);
        assert_eq!(left[0].iter().map(Vec::len).collect::<Vec<_>>(), [1, 1]);
        assert_eq!(left[0][0][0].len(), 3);
        assert_eq!(left[0][1][0].len(), 3);
    }
}
