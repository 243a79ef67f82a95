//! In what order and sense pieces are cut, so that the ways between them are short.
//!
//! Starts from the order of the chains and improves it by cutting a stretch of it the other way round, in the same order or in the
//! reverse one, and by moving up to three pieces elsewhere, as long as that helps.

use nalgebra::Point3;
use patchmill_products::job::Pattern;

/// What a lift and the plunge after it cost, as a length at feed, m: at 2000 mm/min those of 10 mm take about 0.9 s.
const LIFT: f64 = 30e-3;
/// What a way at rapid costs beside a way at feed.
const RAPID_SHARE: f64 = 0.1;
/// Pieces that are moved together.
const LONGEST_MOVED: usize = 3;
/// Rounds over all pieces.
const ROUNDS: usize = 20;
/// With more pieces than this the order of the chains stays: the effort grows as the square.
const MOST_PIECES: usize = 600;
/// A change has to win this, m.
const LEAST_GAIN: f64 = 1e-7;

/// A piece's place in the list and whether it is cut from its end.
pub type Turn = (usize, bool);

/// Order and sense of pieces given by their ends (tips, m), in an order that is already sensible. Pieces up to `longest_link` (m)
/// apart are linked at feed, except one-way, where no piece is reversed either.
pub fn short_order(ends: &[[Point3<f64>; 2]], pattern: Pattern, longest_link: f64) -> Vec<Turn> {
    let mut order: Vec<Turn> = (0..ends.len()).map(|i| (i, false)).collect();
    if ends.len() > MOST_PIECES {
        return order;
    }
    let tour = Tour { ends, reversible: pattern == Pattern::Zigzag, longest_link };
    for _ in 0..ROUNDS {
        let turned = tour.reversible && tour.turn(&mut order);
        let reversed = tour.reversible && tour.reverse(&mut order);
        if !(tour.relocate(&mut order) || reversed || turned) {
            break;
        }
    }
    order
}

struct Tour<'a> {
    ends: &'a [[Point3<f64>; 2]],
    reversible: bool,
    longest_link: f64,
}

impl Tour<'_> {
    /// Cost of the way from one piece to the next, m at feed; none before the first and after the last.
    fn way(&self, from: Option<Turn>, to: Option<Turn>) -> f64 {
        let (Some((a, against)), Some((b, turned))) = (from, to) else { return 0.0 };
        let (end, start) = (self.ends[a][usize::from(!against)], self.ends[b][usize::from(turned)]);
        let distance = (start - end).norm();
        if self.reversible && distance <= self.longest_link {
            distance
        } else {
            LIFT + RAPID_SHARE * distance
        }
    }

    /// Cuts the pieces of stretches the other way round, in the same order, where that helps.
    fn turn(&self, order: &mut [Turn]) -> bool {
        let (n, mut changed) = (order.len(), false);
        let flipped = |(piece, against): Turn| (piece, !against);
        for i in 0..n {
            let before = i.checked_sub(1).map(|k| order[k]);
            // What the ways between the pieces of the stretch win by it.
            let mut inside = 0.0;
            for j in i..n {
                if j > i {
                    let (a, b) = (order[j - 1], order[j]);
                    inside += self.way(Some(a), Some(b)) - self.way(Some(flipped(a)), Some(flipped(b)));
                }
                let after = order.get(j + 1).copied();
                let old = self.way(before, Some(order[i])) + self.way(Some(order[j]), after);
                let new =
                    self.way(before, Some(flipped(order[i]))) + self.way(Some(flipped(order[j])), after);
                if inside + old - new > LEAST_GAIN {
                    order[i..=j].iter_mut().for_each(|turn| turn.1 = !turn.1);
                    inside = -inside;
                    changed = true;
                }
            }
        }
        changed
    }

    /// Reverses stretches where that helps.
    fn reverse(&self, order: &mut [Turn]) -> bool {
        let (n, mut changed) = (order.len(), false);
        for i in 0..n {
            for j in i..n {
                let (before, after) = (i.checked_sub(1).map(|k| order[k]), order.get(j + 1).copied());
                let flipped = |(piece, against): Turn| (piece, !against);
                let old = self.way(before, Some(order[i])) + self.way(Some(order[j]), after);
                let new =
                    self.way(before, Some(flipped(order[j]))) + self.way(Some(flipped(order[i])), after);
                if new < old - LEAST_GAIN {
                    order[i..=j].reverse();
                    order[i..=j].iter_mut().for_each(|turn| turn.1 = !turn.1);
                    changed = true;
                }
            }
        }
        changed
    }

    /// Moves a few pieces elsewhere where that helps.
    fn relocate(&self, order: &mut Vec<Turn>) -> bool {
        let mut changed = false;
        for count in 1..=LONGEST_MOVED {
            let mut i = 0;
            while i + count <= order.len() {
                changed |= self.relocated(order, i, count);
                i += 1;
            }
        }
        changed
    }

    fn relocated(&self, order: &mut Vec<Turn>, i: usize, count: usize) -> bool {
        let at = |k: usize| order.get(k).copied();
        let (before, after) = (i.checked_sub(1).and_then(at), at(i + count));
        let (first, last) = (at(i), at(i + count - 1));
        let saved = self.way(before, first) + self.way(last, after) - self.way(before, after);
        let mut best: Option<(f64, usize, bool)> = None;
        for k in (0..=order.len()).filter(|k| !(i..=i + count).contains(k)) {
            let (left, right) = (k.checked_sub(1).and_then(at), at(k));
            let there = self.way(left, right);
            let flipped = |turn: Option<Turn>| turn.map(|(piece, against)| (piece, !against));
            let straight = self.way(left, first) + self.way(last, right) - there;
            let turned = self.way(left, flipped(last)) + self.way(flipped(first), right) - there;
            for (added, reversed) in [(straight, false), (turned, true)] {
                let allowed = !reversed || self.reversible;
                if allowed && added < saved - LEAST_GAIN && best.is_none_or(|(least, ..)| added < least) {
                    best = Some((added, k, reversed));
                }
            }
        }
        let Some((_, k, reversed)) = best else { return false };
        let mut moved: Vec<Turn> = order.drain(i..i + count).collect();
        if reversed {
            moved.reverse();
            moved.iter_mut().for_each(|turn| turn.1 = !turn.1);
        }
        let k = if k > i { k - count } else { k };
        order.splice(k..k, moved);
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn tour(ends: &[[Point3<f64>; 2]], pattern: Pattern) -> Tour<'_> {
        Tour { ends, reversible: pattern == Pattern::Zigzag, longest_link: 25e-3 }
    }

    fn cost(ends: &[[Point3<f64>; 2]], pattern: Pattern, order: &[Turn]) -> f64 {
        order.windows(2).map(|w| tour(ends, pattern).way(Some(w[0]), Some(w[1]))).sum()
    }

    #[test]
    fn parallel_passes_are_cut_to_and_fro_after_one_is_gone() {
        // Alternating senses, the third of them missing: the rest would start at the wrong side.
        let pass = |k: usize| {
            let (y, ends) = (4e-3 * k as f64, [0.0, 0.1]);
            let [a, b] = if k.is_multiple_of(2) { ends } else { [ends[1], ends[0]] };
            [Point3::new(a, y, 0.0), Point3::new(b, y, 0.0)]
        };
        let ends: Vec<_> = [0, 1, 3, 4, 5].map(pass).to_vec();
        let order = short_order(&ends, Pattern::Zigzag, 25e-3);
        assert!((cost(&ends, Pattern::Zigzag, &order) - 20e-3).abs() < 1e-12, "{order:?}");
    }

    proptest! {
        #[test]
        fn every_piece_is_cut_once_and_the_ways_are_no_longer(
            raw in prop::collection::vec(prop::array::uniform4(0.0..0.1f64), 0..24),
            zigzag: bool,
        ) {
            let pattern = if zigzag { Pattern::Zigzag } else { Pattern::OneWay };
            let end = |x: f64, y: f64| Point3::new(x, y, 0.0);
            let ends: Vec<_> = raw.iter().map(|[a, b, c, d]| [end(*a, *b), end(*c, *d)]).collect();
            let order = short_order(&ends, pattern, 25e-3);
            let given: Vec<Turn> = (0..ends.len()).map(|i| (i, false)).collect();
            prop_assert!(cost(&ends, pattern, &order) <= cost(&ends, pattern, &given) + 1e-12);
            prop_assert!(zigzag || order.iter().all(|(_, against)| !against));
            let mut pieces: Vec<usize> = order.into_iter().map(|(piece, _)| piece).collect();
            pieces.sort_unstable();
            prop_assert_eq!(pieces, (0..ends.len()).collect::<Vec<_>>());
        }
    }
}
