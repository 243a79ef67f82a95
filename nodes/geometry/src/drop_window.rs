//! The part of a mesh that a tool led over a window of its frame can meet.

use nalgebra::Rotation3;

use crate::bvh::{Aabb, Bvh};
use crate::split_tree::Split;

/// A rectangle of the tool frame's x and y, m, that the tool axis stays within.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Window {
    /// Smallest x and y.
    pub min: [f64; 2],
    /// Largest x and y.
    pub max: [f64; 2],
}

impl Window {
    /// Everything.
    pub const WHOLE: Self = Self { min: [f64::NEG_INFINITY; 2], max: [f64::INFINITY; 2] };
    /// Nothing.
    pub const EMPTY: Self = Self { min: [f64::INFINITY; 2], max: [f64::NEG_INFINITY; 2] };

    /// The least window of these places (x, y), grown by `margin` (m) to all sides.
    pub fn around(places: impl Iterator<Item = [f64; 2]>, margin: f64) -> Self {
        let mut window = Self::EMPTY;
        for place in places {
            for (k, at) in place.into_iter().enumerate() {
                window.min[k] = window.min[k].min(at - margin);
                window.max[k] = window.max[k].max(at + margin);
            }
        }
        window
    }

    /// Whether the window holds a place.
    #[inline]
    pub fn covers(&self, x: f64, y: f64) -> bool {
        x >= self.min[0] && x <= self.max[0] && y >= self.min[1] && y <= self.max[1]
    }

    /// Whether a box of the workpiece frame, seen along the tool axis, comes within `reach` (m) of the window.
    pub(crate) fn meets(&self, frame: &Rotation3<f64>, aabb: &Aabb, reach: f64) -> bool {
        (0..2).all(|row| {
            let side = |k: usize| {
                let n = frame.matrix()[(row, k)];
                let (a, b) = (n * aabb.min[k], n * aabb.max[k]);
                (a.min(b), a.max(b))
            };
            let low: f64 = (0..3).map(|k| side(k).0).sum();
            let high: f64 = (0..3).map(|k| side(k).1).sum();
            low <= self.max[row] + reach && high >= self.min[row] - reach
        })
    }
}

/// The hierarchy of what a tool can meet: its nodes, in depth-first order, and where each comes from.
pub(crate) struct Pruned {
    pub(crate) splits: Vec<Split>,
    /// The node of the whole hierarchy whose bounds each has.
    pub(crate) sources: Vec<u32>,
    /// Triangles in leaf order.
    pub(crate) order: Vec<u32>,
}

impl Pruned {
    /// Keeps the leaves whose boxes come within `reach` (m, the cutter's radius) of the window.
    pub(crate) fn of(bvh: &Bvh, frame: &Rotation3<f64>, window: &Window, reach: f64) -> Self {
        let mut kept = vec![0; bvh.splits.len()];
        if !kept.is_empty() {
            count(bvh, frame, window, reach, 0, &mut kept);
        }
        let mut pruned = Self { splits: Vec::new(), sources: Vec::new(), order: Vec::new() };
        if kept.first().is_some_and(|&leaves| leaves > 0) {
            pruned.add(bvh, &kept, 0);
        }
        pruned
    }

    /// Adds the subtree of `node`, of which something is kept.
    fn add(&mut self, bvh: &Bvh, kept: &[u32], mut node: usize) {
        // Of a node with one child left only that child is wanted.
        while bvh.splits[node].right != 0 {
            let children = (node + 1, bvh.splits[node].right as usize);
            node = match (kept[children.0], kept[children.1]) {
                (0, _) => children.1,
                (_, 0) => children.0,
                _ => break,
            };
        }
        let split = bvh.splits[node];
        let (at, first) = (self.splits.len(), self.order.len() as u32);
        self.sources.push(node as u32);
        self.splits.push(Split { first, count: 0, right: 0 });
        if split.right == 0 {
            self.order.extend_from_slice(&bvh.order[split.range()]);
        } else {
            self.add(bvh, kept, node + 1);
            self.splits[at].right = self.splits.len() as u32;
            self.add(bvh, kept, split.right as usize);
        }
        self.splits[at].count = self.order.len() as u32 - first;
    }
}

/// Leaves kept of the subtree of `node`, noted for all its nodes: nothing below a node that does not meet the window does.
fn count(
    bvh: &Bvh,
    frame: &Rotation3<f64>,
    window: &Window,
    reach: f64,
    node: usize,
    kept: &mut [u32],
) -> u32 {
    if window.meets(frame, &bvh.bounds[node].aabb, reach) {
        let right = bvh.splits[node].right as usize;
        kept[node] = match right {
            0 => 1,
            _ => [node + 1, right].map(|child| count(bvh, frame, window, reach, child, kept)).iter().sum(),
        };
    }
    kept[node]
}
