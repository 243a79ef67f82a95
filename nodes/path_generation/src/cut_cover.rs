//! Which stretch of every piece is kept so that all points stay cut.
//!
//! Pieces are shortened from both ends, one after the other, as far as every point that was cut stays cut by one of them; a
//! piece that no point needs is left out. Then pieces are lengthened again where that shortens their neighbours by more.

use std::ops::Range;

/// A stretch of a piece on which it cuts a point, by the length of its way, m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stretch {
    /// The piece.
    pub piece: usize,
    /// The point.
    pub point: usize,
    /// Begin, m.
    pub from: f64,
    /// End, m.
    pub to: f64,
}

/// What is kept of every piece: from where to where, m; `None` where nothing.
pub type Kept = Vec<Option<[f64; 2]>>;

/// What a piece costs beside its length, as a length, m: the link to the next one.
const PIECE: f64 = 5e-3;
/// Pieces are lengthened by this, or to their ends, to try whether their neighbours get shorter, m.
const LENGTHENING: f64 = 4e-3;
/// Rounds in which pieces are lengthened.
const ROUNDS: usize = 3;
/// An exchange has to win this, m.
const LEAST_GAIN: f64 = 1e-6;

/// Shortens the pieces in `order` (all of them, each once); both ends keep `margin` (m) more than the points ask for. `lengths`
/// of the pieces in m; `points` is the number of points.
pub fn shortened(
    lengths: &[f64],
    mut stretches: Vec<Stretch>,
    points: usize,
    order: &[usize],
    margin: f64,
) -> Kept {
    stretches
        .sort_by(|a, b| a.piece.cmp(&b.piece).then(a.point.cmp(&b.point)).then(a.from.total_cmp(&b.from)));
    let mut cover = Cover {
        of_piece: ranges(&stretches, lengths.len()),
        stretches,
        cut_by: vec![0; points],
        kept: vec![None; lengths.len()],
        lengths,
        margin,
    };
    for (piece, length) in lengths.iter().enumerate() {
        cover.keep(piece, Some([0.0, *length]));
    }
    for &piece in order {
        cover.shorten(piece);
    }
    let neighbours = cover.neighbours(order);
    for _ in 0..ROUNDS {
        let mut changed = false;
        for &piece in order {
            changed |= cover.exchange(piece, &neighbours[piece]);
        }
        if !changed {
            break;
        }
    }
    cover.kept
}

/// Where each piece's stretches are.
fn ranges(stretches: &[Stretch], pieces: usize) -> Vec<Range<usize>> {
    let begin = |piece: usize| stretches.partition_point(|s| s.piece < piece);
    (0..pieces).map(|piece| begin(piece)..begin(piece + 1)).collect()
}

struct Cover<'a> {
    /// By piece, point and place.
    stretches: Vec<Stretch>,
    of_piece: Vec<Range<usize>>,
    /// Number of pieces that cut each point as far as they are kept.
    cut_by: Vec<u32>,
    kept: Kept,
    lengths: &'a [f64],
    margin: f64,
}

impl Cover<'_> {
    /// Keeps that much of a piece from now on.
    fn keep(&mut self, piece: usize, range: Option<[f64; 2]>) {
        let before = std::mem::replace(&mut self.kept[piece], range);
        for own in self.stretches[self.of_piece[piece].clone()].chunk_by(|a, b| a.point == b.point) {
            let cuts = |range: Option<[f64; 2]>| {
                range.is_some_and(|[from, to]| own.iter().any(|s| s.from <= to && s.to >= from))
            };
            match (cuts(before), cuts(range)) {
                (false, true) => self.cut_by[own[0].point] += 1,
                (true, false) => self.cut_by[own[0].point] -= 1,
                _ => {}
            }
        }
    }

    /// Shortens a piece to what only it cuts.
    fn shorten(&mut self, piece: usize) {
        let Some([from, to]) = self.kept[piece] else { return };
        let groups = || self.stretches[self.of_piece[piece].clone()].chunk_by(|a, b| a.point == b.point);
        let needed = || groups().filter(|own| self.cut_by[own[0].point] == 1);
        // The end comes back to where every point is cut once, then the begin up to it.
        let first = |own: &[Stretch]| own.iter().find(|s| s.to >= from && s.from <= to).map(|s| s.from);
        let range = needed().filter_map(first).reduce(f64::max).map(|end| {
            let end = end.max(from);
            let last = |own: &[Stretch]| own.iter().rfind(|s| s.to >= from && s.from <= end).map(|s| s.to);
            let begin = needed().filter_map(last).fold(end, f64::min);
            [(begin - self.margin).max(from), (end + self.margin).min(to)]
        });
        self.keep(piece, range);
    }

    /// The pieces that cut one of a piece's points too, in the order of shortening.
    fn neighbours(&self, order: &[usize]) -> Vec<Vec<usize>> {
        let own = |piece: usize| &self.stretches[self.of_piece[piece].clone()];
        let mut cutting: Vec<Vec<usize>> = vec![Vec::new(); self.cut_by.len()];
        for (place, &piece) in order.iter().enumerate() {
            for s in own(piece) {
                if cutting[s.point].last() != Some(&place) {
                    cutting[s.point].push(place);
                }
            }
        }
        let beside = |piece: usize| {
            let mut places: Vec<usize> =
                own(piece).iter().flat_map(|s| cutting[s.point].iter().copied()).collect();
            places.sort_unstable();
            places.dedup();
            places.into_iter().map(|place| order[place]).filter(|other| *other != piece).collect()
        };
        (0..self.kept.len()).map(beside).collect()
    }

    /// Lengthens a piece and shortens its neighbours, where all together get shorter by it.
    fn exchange(&mut self, piece: usize, neighbours: &[usize]) -> bool {
        let (length, mut changed) = (self.lengths[piece], false);
        for [back, on] in
            [[length, length], [length, 0.0], [0.0, length], [LENGTHENING, 0.0], [0.0, LENGTHENING]]
        {
            let [from, to] = self.kept[piece].unwrap_or([0.0, length]);
            let range = Some([(from - back).max(0.0), (to + on).min(length)]);
            if self.kept[piece] == range {
                continue;
            }
            let (cost, own) = (self.cost(piece, neighbours), self.kept[piece]);
            let others: Vec<_> = neighbours.iter().map(|other| self.kept[*other]).collect();
            self.keep(piece, range);
            neighbours.iter().for_each(|other| self.shorten(*other));
            self.shorten(piece);
            if self.cost(piece, neighbours) < cost - LEAST_GAIN {
                changed = true;
                continue;
            }
            self.keep(piece, own);
            neighbours.iter().zip(others).for_each(|(other, range)| self.keep(*other, range));
        }
        changed
    }

    /// What a piece and its neighbours cost, m.
    fn cost(&self, piece: usize, neighbours: &[usize]) -> f64 {
        let kept = neighbours.iter().chain([&piece]).filter_map(|p| self.kept[*p]);
        kept.map(|[from, to]| to - from + PIECE).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn stretch(piece: usize, point: usize, from: f64, to: f64) -> Stretch {
        Stretch { piece, point, from, to }
    }

    fn covers(kept: &Kept, s: &Stretch) -> bool {
        kept[s.piece].is_some_and(|[from, to]| s.from <= to && s.to >= from)
    }

    #[test]
    fn ends_come_back_to_the_last_points() {
        let stretches = (0..10).map(|k| stretch(0, k, 0.01 * k as f64 + 0.02, 0.01 * k as f64 + 0.04));
        let kept = shortened(&[0.2], stretches.collect(), 10, &[0], 1e-3);
        let [from, to] = kept[0].unwrap();
        assert!((from - 0.039).abs() < 1e-12 && (to - 0.111).abs() < 1e-12, "{from} {to}");
    }

    #[test]
    fn a_piece_that_others_make_needless_is_left_out() {
        let both = (0..20).flat_map(|k| {
            let at = 0.01 * k as f64;
            [stretch(0, k, at, at + 5e-3), stretch(1, k, at, at + 5e-3)]
        });
        assert_eq!(shortened(&[0.2, 0.2], both.collect(), 20, &[1, 0], 0.0)[1], None);
    }

    #[test]
    fn one_long_piece_replaces_the_ends_of_many() {
        // Five pieces end in a strip that a sixth one could cut alone, and is asked to leave first.
        let mut stretches: Vec<Stretch> = (0..5)
            .flat_map(|p| (0..10).map(move |k| stretch(p, 10 * p + k, 0.01 * k as f64, 0.01 * k as f64)))
            .collect();
        stretches.extend((0..5).map(|p| stretch(5, 10 * p + 9, 4e-3 * p as f64, 4e-3 * p as f64)));
        let kept = shortened(&[0.1, 0.1, 0.1, 0.1, 0.1, 0.016], stretches, 50, &[5, 0, 1, 2, 3, 4], 0.0);
        let total: f64 = kept.iter().flatten().map(|[from, to]| to - from).sum();
        assert!((total - (5.0 * 0.08 + 0.016)).abs() < 1e-9, "{kept:?}");
    }

    proptest! {
        #[test]
        fn every_point_that_was_cut_stays_cut(
            raw in prop::collection::vec((0usize..12, 0usize..60, 0.0..0.1f64, 0.0..0.02f64), 0..300),
            margin in 0.0..2e-3f64,
        ) {
            let lengths = [0.1; 12];
            let stretches: Vec<Stretch> = raw
                .iter()
                .map(|&(piece, point, from, long)| stretch(piece, point, from, (from + long).min(0.1)))
                .collect();
            let order: Vec<usize> = (0..12).rev().collect();
            let kept = shortened(&lengths, stretches.clone(), 60, &order, margin);
            for point in 0..60 {
                let own: Vec<&Stretch> = stretches.iter().filter(|s| s.point == point).collect();
                prop_assert!(own.is_empty() || own.iter().any(|s| covers(&kept, s)));
            }
            prop_assert!(kept.iter().flatten().all(|[from, to]| 0.0 <= *from && from <= to && *to <= 0.1));
            prop_assert_eq!(kept, shortened(&lengths, stretches, 60, &order, margin));
        }
    }
}
