//! The shape of a bounding-volume hierarchy: median splits of centres, in depth-first order.

use rayon::prelude::*;

/// Most items in a leaf.
pub(crate) const LEAF: usize = 4;
/// Ranges longer than this are split in parallel.
const PARALLEL: usize = 8192;

/// A node over `order[first .. first + count]`; depth-first, the left child follows its parent directly.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Split {
    /// First item (position in the leaf order).
    pub(crate) first: u32,
    /// Number of items below the node.
    pub(crate) count: u32,
    /// Index of the right child; 0 for a leaf.
    pub(crate) right: u32,
}

impl Split {
    /// The positions in leaf order that the node covers.
    pub(crate) fn range(&self) -> std::ops::Range<usize> {
        self.first as usize..(self.first + self.count) as usize
    }
}

#[derive(Clone, Copy)]
struct Item {
    centre: [f64; 3],
    index: u32,
}

/// Splits items by the median along the widest extent of their centres until at most [`LEAF`] remain.
///
/// Gives the order of the items in the leaves and the nodes. Left parts are whole multiples of `LEAF`, so
/// n items have ⌈n/LEAF⌉ leaves and every node's place is known beforehand: the parallel build needs no
/// synchronisation and its result does not depend on the number of threads.
pub(crate) fn split_tree(centres: &[[f64; 3]]) -> (Vec<u32>, Vec<Split>) {
    let mut items: Vec<Item> =
        centres.par_iter().enumerate().map(|(i, &centre)| Item { centre, index: i as u32 }).collect();
    let mut nodes = vec![Split::default(); node_count(items.len())];
    if !items.is_empty() {
        split(&mut items, &mut nodes, 0, 0);
    }
    (items.into_iter().map(|i| i.index).collect(), nodes)
}

fn node_count(items: usize) -> usize {
    (2 * items.div_ceil(LEAF)).saturating_sub(1)
}

fn split(items: &mut [Item], nodes: &mut [Split], first: usize, base: usize) {
    let n = items.len();
    nodes[0] = Split { first: first as u32, count: n as u32, right: 0 };
    if n <= LEAF {
        items.sort_unstable_by_key(|i| i.index);
        return;
    }
    let left = n.div_ceil(2).next_multiple_of(LEAF).min((n - 1) / LEAF * LEAF);
    let axis = widest_axis(items);
    items.select_nth_unstable_by(left, |a, b| {
        a.centre[axis].total_cmp(&b.centre[axis]).then(a.index.cmp(&b.index))
    });
    let left_nodes = node_count(left);
    nodes[0].right = (base + 1 + left_nodes) as u32;
    let (items_l, items_r) = items.split_at_mut(left);
    let (nodes_l, nodes_r) = nodes[1..].split_at_mut(left_nodes);
    let right_base = base + 1 + left_nodes;
    if n > PARALLEL {
        rayon::join(
            || split(items_l, nodes_l, first, base + 1),
            || split(items_r, nodes_r, first + left, right_base),
        );
    } else {
        split(items_l, nodes_l, first, base + 1);
        split(items_r, nodes_r, first + left, right_base);
    }
}

fn widest_axis(items: &[Item]) -> usize {
    let (mut lo, mut hi) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    for item in items {
        for k in 0..3 {
            lo[k] = lo[k].min(item.centre[k]);
            hi[k] = hi[k].max(item.centre[k]);
        }
    }
    let extent = [hi[0] - lo[0], hi[1] - lo[1], hi[2] - lo[2]];
    if extent[0] >= extent[1] && extent[0] >= extent[2] {
        0
    } else if extent[1] >= extent[2] {
        1
    } else {
        2
    }
}
