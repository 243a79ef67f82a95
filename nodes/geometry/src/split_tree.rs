//! The shape of a bounding-volume hierarchy: median splits of centres, in depth-first order.

use rayon::prelude::*;

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

/// Most items in a leaf of [`split_tree`].
const LEAF: usize = 4;

#[derive(Clone, Copy)]
struct Item {
    centre: [f64; 3],
    index: u32,
}

/// [`split_tree_to`] leaves of four.
pub(crate) fn split_tree(centres: &[[f64; 3]]) -> (Vec<u32>, Vec<Split>) {
    split_tree_to(LEAF, centres)
}

/// Splits items by the median along the widest extent of their centres until at most `leaf` remain.
///
/// Gives the order of the items in the leaves and the nodes. Left parts are whole multiples of `leaf`, so
/// n items have ⌈n/leaf⌉ leaves and every node's place is known beforehand: the parallel build needs no
/// synchronisation and its result does not depend on the number of threads.
pub(crate) fn split_tree_to(leaf: usize, centres: &[[f64; 3]]) -> (Vec<u32>, Vec<Split>) {
    let mut items: Vec<Item> =
        centres.par_iter().enumerate().map(|(i, &centre)| Item { centre, index: i as u32 }).collect();
    let mut nodes = vec![Split::default(); node_count(items.len(), leaf)];
    if !items.is_empty() {
        split(&mut items, &mut nodes, leaf, 0, 0);
    }
    (items.into_iter().map(|i| i.index).collect(), nodes)
}

/// Number of nodes of [`split_tree`] over some items.
pub(crate) fn nodes_of(items: usize) -> usize {
    node_count(items, LEAF)
}

fn node_count(items: usize, leaf: usize) -> usize {
    (2 * items.div_ceil(leaf)).saturating_sub(1)
}

fn split(items: &mut [Item], nodes: &mut [Split], leaf: usize, first: usize, base: usize) {
    let n = items.len();
    nodes[0] = Split { first: first as u32, count: n as u32, right: 0 };
    if n <= leaf {
        items.sort_unstable_by_key(|i| i.index);
        return;
    }
    let left = n.div_ceil(2).next_multiple_of(leaf).min((n - 1) / leaf * leaf);
    let axis = widest_axis(items);
    items.select_nth_unstable_by(left, |a, b| {
        a.centre[axis].total_cmp(&b.centre[axis]).then(a.index.cmp(&b.index))
    });
    let left_nodes = node_count(left, leaf);
    nodes[0].right = (base + 1 + left_nodes) as u32;
    let (items_l, items_r) = items.split_at_mut(left);
    let (nodes_l, nodes_r) = nodes[1..].split_at_mut(left_nodes);
    let right_base = base + 1 + left_nodes;
    if n > PARALLEL {
        rayon::join(
            || split(items_l, nodes_l, leaf, first, base + 1),
            || split(items_r, nodes_r, leaf, first + left, right_base),
        );
    } else {
        split(items_l, nodes_l, leaf, first, base + 1);
        split(items_r, nodes_r, leaf, first + left, right_base);
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
