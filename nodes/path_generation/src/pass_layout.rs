//! Which stretch of each plane a patch needs, and in what order the passes are cut.

use patchmill_orientation::pass_curves::PassCurves;

/// The line in the tool frame along which a pass is cut.
#[derive(Clone, Copy)]
pub enum PassLine<'a> {
    /// The plane at this y, m.
    Plane(f64),
    /// One of several curves.
    Curve(&'a PassCurves, usize),
}

impl PassLine<'_> {
    /// y (m) and slope dy/dx at x, m.
    pub fn at(&self, x: f64) -> (f64, f64) {
        match self {
            Self::Plane(y) => (*y, 0.0),
            Self::Curve(curves, i) => curves.at(*i, x),
        }
    }
}

/// The passes of a patch, from low to high y.
pub trait PassLines {
    /// Number of lines.
    fn count(&self) -> usize;

    /// One of them.
    fn line(&self, i: usize) -> PassLine<'_>;

    /// The one nearest along y to a place in the tool frame, m.
    fn nearest(&self, x: f64, y: f64) -> usize;
}

impl PassLines for [f64] {
    fn count(&self) -> usize {
        self.len()
    }

    fn line(&self, i: usize) -> PassLine<'_> {
        PassLine::Plane(self[i])
    }

    fn nearest(&self, _: f64, y: f64) -> usize {
        let above = self.partition_point(|plane| *plane < y);
        if above == 0 {
            0
        } else if above == self.len() || y - self[above - 1] < self[above] - y {
            above - 1
        } else {
            above
        }
    }
}

impl PassLines for PassCurves {
    fn count(&self) -> usize {
        self.len()
    }

    fn line(&self, i: usize) -> PassLine<'_> {
        PassLine::Curve(self, i)
    }

    fn nearest(&self, x: f64, y: f64) -> usize {
        Self::nearest(self, x, y)
    }
}

/// A point of the patch as a pass sees it, tool frame.
#[derive(Clone, Copy, Debug)]
pub struct StripPoint {
    /// Cross-feed coordinate, m.
    pub y: f64,
    /// Feed coordinate of the contact that cuts the point deepest, per line: `x + drift·(y − the line's y)`, m.
    pub x: f64,
    /// Change of that coordinate per distance from the line.
    pub drift: f64,
}

/// Passes of one line: (from, to) along the feed, m, in order.
pub type Intervals = Vec<(f64, f64)>;

/// Stretches of every line that the points of its strip ask for, widened by `overlap` (m) and joined over gaps of up to
/// `longest_gap` (m). Every point belongs to the strip of the nearest line.
pub fn intervals(
    lines: &(impl PassLines + ?Sized),
    points: &[StripPoint],
    overlap: f64,
    longest_gap: f64,
) -> Vec<Intervals> {
    let mut needed: Vec<Vec<f64>> = vec![Vec::new(); lines.count()];
    for p in points {
        let nearest = lines.nearest(p.x, p.y);
        let (y, _) = lines.line(nearest).at(p.x);
        needed[nearest].push(p.x + p.drift * (p.y - y));
    }
    needed
        .into_iter()
        .map(|mut places| {
            places.sort_by(f64::total_cmp);
            let mut joined = Intervals::new();
            for x in places {
                match joined.last_mut() {
                    Some(last) if x - overlap <= last.1 + longest_gap => last.1 = last.1.max(x + overlap),
                    _ => joined.push((x - overlap, x + overlap)),
                }
            }
            joined
        })
        .collect()
}

/// A run of overlapping intervals over neighbouring planes: (plane, interval) pairs.
pub type Chain = Vec<(usize, usize)>;

/// Groups the intervals into chains, each interval once; a chain goes from plane to plane as long as it finds a free
/// interval that overlaps its last one.
pub fn chains(intervals: &[Intervals]) -> Vec<Chain> {
    let mut free: Vec<Vec<bool>> = intervals.iter().map(|plane| vec![true; plane.len()]).collect();
    let mut found = Vec::new();
    for plane in 0..intervals.len() {
        for i in 0..intervals[plane].len() {
            if !free[plane][i] {
                continue;
            }
            free[plane][i] = false;
            let mut chain = vec![(plane, i)];
            while let Some((next, j)) = continuation(intervals, &free, chain[chain.len() - 1]) {
                free[next][j] = false;
                chain.push((next, j));
            }
            found.push(chain);
        }
    }
    found
}

/// The free interval of the next plane that overlaps most, if any does.
fn continuation(
    intervals: &[Intervals],
    free: &[Vec<bool>],
    (plane, i): (usize, usize),
) -> Option<(usize, usize)> {
    let next = plane + 1;
    let (from, to) = intervals[plane][i];
    let overlap = |j: usize| {
        let (a, b) = intervals[next][j];
        b.min(to) - a.max(from)
    };
    (0..intervals.get(next)?.len())
        .filter(|&j| free[next][j] && overlap(j) > 0.0)
        .max_by(|&a, &b| overlap(a).total_cmp(&overlap(b)).then(b.cmp(&a)))
        .map(|j| (next, j))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_point_lies_in_an_interval_of_its_nearest_plane() {
        let points: Vec<StripPoint> = (0..1000)
            .map(|i| StripPoint { y: (i % 40) as f64 * 1e-3, x: (i / 40) as f64 * 2e-3, drift: 0.0 })
            .filter(|p| (p.x - 0.02).abs() > 0.006 || p.y < 0.02)
            .collect();
        let planes = [0.003, 0.010, 0.020, 0.031];
        let found = intervals(planes.as_slice(), &points, 0.2e-3, 3e-3);
        for p in &points {
            let nearest =
                (0..4).min_by(|&a, &b| (planes[a] - p.y).abs().total_cmp(&(planes[b] - p.y).abs())).unwrap();
            assert!(found[nearest].iter().any(|(a, b)| (*a..=*b).contains(&p.x)));
        }
        assert_eq!(found.iter().map(Vec::len).collect::<Vec<_>>(), [1, 1, 1, 2]);
    }

    #[test]
    fn chains_use_every_interval_once() {
        let intervals = vec![
            vec![(0.0, 10.0)],
            vec![(0.0, 4.0), (6.0, 10.0)],
            vec![(0.0, 4.0), (6.5, 10.0)],
            vec![(0.0, 10.0)],
        ];
        let found = chains(&intervals);
        assert_eq!(found, vec![vec![(0, 0), (1, 0), (2, 0), (3, 0)], vec![(1, 1), (2, 1)]]);
    }
}
