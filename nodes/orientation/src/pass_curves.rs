//! Passes that follow the surface: curves y(x) in the tool frame, each as far from the one before as the scallop height allows
//! there, so that one narrow place does not narrow a whole pass.
//!
//! The step that a place allows depends on the pass's direction there, so it is tabulated over place and slope dy/dx
//! ([`StepField`]). From a straight line through the middle of the patch the curves are laid outwards. A curve is the
//! highest one below (previous + allowed step) whose slope stays within `STEEPEST`: the lower envelope of cones over it,
//! then smoothed, and lowered where smoothing lifts it, which may turn it a little more. The swept check has the last word
//! ([`StepField::adapt`]).

use nalgebra::{Point3, Rotation3, Vector3};
use patchmill_geometry::cutter::Cutter;
use patchmill_geometry::drop_cutter::tool_frame;
use patchmill_products::job::Job;
use rayon::prelude::*;

use crate::cloud_point::CloudPoint;
use crate::orientation::Orientation;
use crate::step_over::{TangentShape, scallop_budget};

/// Largest slope dy/dx of a pass: turned by more, the effective radius falls faster than the spacing gains.
const STEEPEST: f64 = 0.4;
/// Slopes at which steps are tabulated.
const SLOPES: usize = 9;
/// Curves are smoothed over this way to either side, m.
const SMOOTHING: f64 = 3e-3;
/// Least size of a cell, m.
const LEAST_CELL: f64 = 0.4e-3;
/// Most cells along x or y: a part of metres gets wider cells, not unbounded memory.
const MOST_CELLS: usize = 4000;
/// Curves laid to one side at the most.
const MOST_CURVES: usize = 20_000;
/// The highest ridge counts over this way along the pass to either side, m.
const RIDGE: f64 = 2e-3;
/// Least and largest change of the allowed distance by one swept check.
const NARROWEST: f64 = 0.6;
const WIDEST: f64 = 1.15;
/// Share of the aim that ridges above it are brought to when nothing is widened any more: the curves around move as well.
const MARGIN: f64 = 0.97;
/// A step is at least this, m: a vanishing allowance must not loop for ever.
const LEAST_STEP: f64 = 5e-6;

/// Places of the first curve that are tried, in steps above the middle of the patch.
const STARTS: [f64; 4] = [0.0, 0.5, 0.25, 0.75];

/// Allowed distance between passes along y over the places and slopes of a patch, tool frame.
#[derive(Clone)]
pub struct StepField {
    low: [f64; 2],
    cell: [f64; 2],
    count: [usize; 2],
    /// Allowed distance, m, [`SLOPES`] a cell; infinite where the patch is not.
    allowed: Vec<f64>,
    /// Area of the patch in each cell, m².
    area: Vec<f64>,
    /// Largest distance that is looked ahead, m.
    longest: f64,
    /// Where the first curve is laid, in steps above the middle of the patch.
    start: f64,
}

impl StepField {
    /// From the patch's points (at least one) held that way.
    pub fn new(points: &[&CloudPoint], orientation: &Orientation, cutter: Cutter, job: &Job) -> Self {
        let frame = tool_frame(&orientation.axis, &orientation.feed);
        let place = |p: &CloudPoint| {
            let q = frame * p.position;
            [q.x, q.y]
        };
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for p in points {
            for (k, v) in place(p).into_iter().enumerate() {
                (low[k], high[k]) = (low[k].min(v), high[k].max(v));
            }
        }
        let total: f64 = points.iter().map(|p| p.area).sum();
        let spacing = (total / points.len() as f64).sqrt();
        let cell: [f64; 2] = std::array::from_fn(|k| {
            (spacing * [1.5, 1.0][k]).max(LEAST_CELL).max((high[k] - low[k]) / MOST_CELLS as f64)
        });
        let count: [usize; 2] = std::array::from_fn(|k| ((high[k] - low[k]) / cell[k]) as usize + 1);
        let across = across_by_slope(&frame);
        let steps = |p: &&CloudPoint| {
            let shape = TangentShape::new(&p.normal, &p.curvature);
            let height = scallop_budget(p, job.scallop_height, job.pass_chord);
            shape.allowed_distances(&orientation.axis, &across, cutter, height)
        };
        let steps: Vec<[f64; SLOPES]> = points.par_iter().map(steps).collect();
        let mut field = Self {
            low,
            cell,
            count,
            allowed: vec![f64::INFINITY; count[0] * count[1] * SLOPES],
            area: vec![0.0; count[0] * count[1]],
            longest: cutter.radius() * 2.0,
            start: 0.0,
        };
        for (p, steps) in points.iter().zip(&steps) {
            let [x, y] = place(p);
            let at = field.row(y) * count[0] + field.column(x);
            field.area[at] += p.area;
            for (allowed, step) in field.allowed[at * SLOPES..].iter_mut().zip(steps) {
                *allowed = allowed.min(*step);
            }
        }
        field.fill_gaps();
        field
    }

    /// Cells that no point fell into take the least of their neighbours.
    fn fill_gaps(&mut self) {
        let [nx, ny] = self.count;
        let known = self.allowed.clone();
        let at = |i: usize, j: usize| (j * nx + i) * SLOPES;
        for j in 0..ny {
            for i in 0..nx {
                if known[at(i, j)].is_finite() {
                    continue;
                }
                for b in j.saturating_sub(1)..=(j + 1).min(ny - 1) {
                    for a in i.saturating_sub(1)..=(i + 1).min(nx - 1) {
                        for k in 0..SLOPES {
                            let own = &mut self.allowed[at(i, j) + k];
                            *own = own.min(known[at(a, b) + k]);
                        }
                    }
                }
            }
        }
    }

    fn column(&self, x: f64) -> usize {
        (((x - self.low[0]) / self.cell[0]).max(0.0) as usize).min(self.count[0] - 1)
    }

    fn row(&self, y: f64) -> usize {
        (((y - self.low[1]) / self.cell[1]).max(0.0) as usize).min(self.count[1] - 1)
    }

    fn high(&self) -> f64 {
        self.low[1] + self.cell[1] * self.count[1] as f64
    }

    /// x of a curve's node: the middle of its column, m.
    fn x(&self, column: usize) -> f64 {
        self.low[0] + (column as f64 + 0.5) * self.cell[0]
    }

    fn allowed_at(&self, column: usize, y: f64, slope: f64) -> f64 {
        if !(self.low[1]..self.high()).contains(&y) {
            return f64::INFINITY;
        }
        let share = (slope / STEEPEST).clamp(-1.0, 1.0) * 0.5 + 0.5;
        let k = (share * (SLOPES - 1) as f64).round() as usize;
        self.allowed[(self.row(y) * self.count[0] + column) * SLOPES + k]
    }

    /// Largest way towards `side` (±1) that is no longer than `share` of what is allowed anywhere on it, m.
    fn advance(&self, column: usize, y: f64, slope: f64, share: f64, side: f64) -> f64 {
        let (mut allowed, mut way) = (f64::INFINITY, 0.0);
        while way < self.longest {
            let here = allowed.min(self.allowed_at(column, y + side * way, slope));
            if share * here <= way {
                return way.min(share * allowed).max(share * here).max(LEAST_STEP);
            }
            allowed = here;
            way += 0.5 * self.cell[1];
        }
        self.longest.min(share * allowed)
    }

    /// Takes the swept check's findings, (place in the tool frame, leftover) in m: between two curves the allowed distance
    /// changes as the root of `aim` (m) over the highest ridge around; unless `widening` only where that is higher, and to a
    /// little less.
    pub fn adapt(&mut self, curves: &PassCurves, found: &[(Point3<f64>, f64)], aim: f64, widening: bool) {
        let (columns, strips) = (self.count[0], curves.len() + 1);
        let mut ridge = vec![0.0f64; columns * strips];
        for (place, leftover) in found {
            let at = curves.above(place.x, place.y) * columns + self.column(place.x);
            ridge[at] = ridge[at].max(*leftover);
        }
        let reach = (RIDGE / self.cell[0]).ceil() as usize;
        let factor = |strip: usize, column: usize| {
            let around = column.saturating_sub(reach)..=(column + reach).min(columns - 1);
            // Curves that come closer move those beyond them as well.
            let beside = usize::from(!widening);
            let strips = strip.saturating_sub(beside)..=(strip + beside).min(strips - 1);
            let highest = strips
                .flat_map(|s| around.clone().map(move |i| s * columns + i))
                .map(|at| ridge[at])
                .fold(0.0, f64::max);
            // Nothing was looked at there.
            if highest == 0.0 {
                return 1.0;
            }
            if widening {
                (aim / highest).sqrt().clamp(NARROWEST, WIDEST)
            } else if highest > aim {
                (MARGIN * aim / highest).sqrt().max(NARROWEST)
            } else {
                1.0
            }
        };
        let factors: Vec<f64> = (0..columns * strips).map(|at| factor(at / columns, at % columns)).collect();
        for j in 0..self.count[1] {
            let y = self.low[1] + (j as f64 + 0.5) * self.cell[1];
            for i in 0..columns {
                let factor = factors[curves.above(self.x(i), y) * columns + i];
                let at = (j * columns + i) * SLOPES;
                self.allowed[at..at + SLOPES].iter_mut().for_each(|v| *v *= factor);
            }
        }
    }

    /// Starts the curves from now on where those over the patch become shortest: a pass that only just misses the border would
    /// be followed by another one all along it.
    pub fn start_for_least_length(&mut self) {
        let length = |start: f64| {
            let field = Self { start, ..self.clone() };
            field.length_within(&field.curves())
        };
        let lengths = STARTS.map(|start| (length(start), start));
        // Of equal ones the first.
        let best = lengths.into_iter().reduce(|best, new| if new.0 < best.0 - 1e-9 { new } else { best });
        self.start = best.map_or(0.0, |(_, start)| start);
    }

    /// Length of the curves where they are nearest to some of the patch, m.
    pub fn length_within(&self, curves: &PassCurves) -> f64 {
        let within = |i: usize, [low, high]: [f64; 2]| -> f64 {
            let x = self.x(i);
            let y: Vec<f64> = curves.curves.iter().map(|curve| curve[i]).collect();
            let needed = |c: &usize| {
                let from = if *c == 0 { f64::NEG_INFINITY } else { 0.5 * (y[c - 1] + y[*c]) };
                let to = y.get(c + 1).map_or(f64::INFINITY, |next| 0.5 * (y[*c] + next));
                from < high && to > low
            };
            (0..y.len()).filter(needed).map(|c| self.cell[0] * curves.at(c, x).1.hypot(1.0)).sum()
        };
        (0..self.count[0]).filter_map(|i| Some(within(i, self.ends_of(i)?))).sum()
    }

    /// The curves over the whole patch.
    pub fn curves(&self) -> PassCurves {
        let ends: Vec<Option<[f64; 2]>> = (0..self.count[0]).map(|i| self.ends_of(i)).collect();
        let middle = 0.5 * (self.low[1] + self.high());
        let steps = (0..self.count[0]).map(|i| self.advance(i, middle, 0.0, 1.0, 1.0));
        let step = steps.fold(f64::INFINITY, f64::min).min(self.high() - middle);
        let middle = vec![middle + self.start * step; self.count[0]];
        let mut below = self.outwards(&middle, &ends, -1.0);
        below.reverse();
        below.push(middle.clone());
        below.extend(self.outwards(&middle, &ends, 1.0));
        PassCurves { first: self.x(0), node: self.cell[0], curves: below }
    }

    /// Least and largest y of the patch in a column.
    fn ends_of(&self, column: usize) -> Option<[f64; 2]> {
        let known = |j: &usize| self.allowed[(j * self.count[0] + column) * SLOPES].is_finite();
        let (first, last) = ((0..self.count[1]).find(known)?, (0..self.count[1]).rfind(known)?);
        let y = |j: usize| self.low[1] + j as f64 * self.cell[1];
        Some([y(first), y(last + 1)])
    }

    fn outwards(&self, from: &[f64], ends: &[Option<[f64; 2]>], side: f64) -> Vec<Vec<f64>> {
        let mut laid: Vec<Vec<f64>> = Vec::new();
        while laid.len() < MOST_CURVES {
            let last = laid.last().map_or(from, Vec::as_slice);
            let slopes = slopes(last, self.cell[0]);
            let lacks = |i: usize| {
                ends[i].is_some_and(|[low, high]| {
                    let way = if side > 0.0 { high - last[i] } else { last[i] - low };
                    way > 0.0 && way > self.advance(i, last[i], slopes[i], 0.5, side)
                })
            };
            if !(0..last.len()).any(lacks) {
                break;
            }
            let wanted = |i: usize| side * last[i] + self.advance(i, last[i], slopes[i], 1.0, side);
            let heights = below_cones((0..last.len()).map(wanted).collect(), STEEPEST * self.cell[0]);
            let reach = (SMOOTHING / self.cell[0]).round() as usize;
            // Smoothing may lower a curve below the last one where next to nothing is allowed.
            let beyond = |(h, last): (f64, &f64)| side * h.max(side * last + LEAST_STEP);
            laid.push(smoothed(&heights, reach).into_iter().zip(last).map(beyond).collect());
        }
        laid
    }

    /// The same by the area over the distance between the curves: steadier where points are few; and the number of curves.
    pub fn estimate(&self, curves: &PassCurves) -> (f64, usize) {
        let mut length = 0.0;
        for i in 0..self.count[0] {
            for j in 0..self.count[1] {
                let area = self.area[j * self.count[0] + i];
                if area > 0.0 {
                    let y = self.low[1] + (j as f64 + 0.5) * self.cell[1];
                    let gap = curves.gap(self.x(i), y).unwrap_or(self.high() - self.low[1]);
                    let (_, slope) = curves.at(curves.nearest(self.x(i), y), self.x(i));
                    length += area * slope.hypot(1.0) / gap.max(LEAST_STEP);
                }
            }
        }
        (length, curves.len())
    }
}

/// Directions across passes of all slopes dy/dx, 1/cos of the slope's angle long: the distance along y is that across such a pass times
/// this length.
fn across_by_slope(frame: &Rotation3<f64>) -> [Vector3<f64>; SLOPES] {
    let slope = |k: usize| STEEPEST * (2.0 * k as f64 / (SLOPES - 1) as f64 - 1.0);
    let back = frame.inverse();
    std::array::from_fn(|k| back * Vector3::new(-slope(k), 1.0, 0.0))
}

/// The orientation with its passes turned to a slope dy/dx in the tool frame.
pub fn turned(orientation: &Orientation, frame: &Rotation3<f64>, slope: f64) -> Orientation {
    let across = frame.inverse() * Vector3::new(-slope, 1.0, 0.0);
    Orientation { cross_feed: across.normalize(), ..*orientation }
}

/// Slopes at the nodes of a curve.
fn slopes(heights: &[f64], node: f64) -> Vec<f64> {
    let n = heights.len();
    let slope = |i: usize| {
        let (a, b) = (i.saturating_sub(1), (i + 1).min(n - 1));
        if a == b { 0.0 } else { (heights[b] - heights[a]) / ((b - a) as f64 * node) }
    };
    (0..n).map(slope).collect()
}

/// The largest function below that changes by at most `rise` from node to node.
fn below_cones(mut heights: Vec<f64>, rise: f64) -> Vec<f64> {
    for i in 1..heights.len() {
        heights[i] = heights[i].min(heights[i - 1] + rise);
    }
    for i in (0..heights.len().saturating_sub(1)).rev() {
        heights[i] = heights[i].min(heights[i + 1] + rise);
    }
    heights
}

/// Mean over `reach` nodes to either side, lowered smoothly where it is above the heights themselves.
fn smoothed(heights: &[f64], reach: usize) -> Vec<f64> {
    let around = |i: usize| {
        let reach = reach.min(i).min(heights.len() - 1 - i);
        i - reach..=i + reach
    };
    let mean = |of: &[f64], i: usize| of[around(i)].iter().sum::<f64>() / around(i).count() as f64;
    let means: Vec<f64> = (0..heights.len()).map(|i| mean(heights, i)).collect();
    let above: Vec<f64> = means.iter().zip(heights).map(|(mean, own)| (mean - own).max(0.0)).collect();
    let spread: Vec<f64> =
        (0..heights.len()).map(|i| above[around(i)].iter().copied().fold(0.0, f64::max)).collect();
    (0..heights.len()).map(|i| (means[i] - mean(&spread, i)).min(heights[i])).collect()
}

/// Curves y(x) in the tool frame from low to high y, over common nodes; straight on beyond them.
pub struct PassCurves {
    first: f64,
    node: f64,
    curves: Vec<Vec<f64>>,
}

impl PassCurves {
    /// Number of curves.
    pub fn len(&self) -> usize {
        self.curves.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.curves.is_empty()
    }

    /// y (m) and slope of a curve at x, m.
    ///
    /// # Panics
    /// If there is no such curve.
    pub fn at(&self, curve: usize, x: f64) -> (f64, f64) {
        let heights = &self.curves[curve];
        let last = heights.len() - 1;
        let t = (x - self.first) / self.node;
        let slope = |i: usize| {
            let (a, b) = (i.saturating_sub(1), (i + 1).min(last));
            if a == b { 0.0 } else { (heights[b] - heights[a]) / (b - a) as f64 }
        };
        if t <= 0.0 || last == 0 {
            return (heights[0] + slope(0) * t, slope(0) / self.node);
        }
        if t >= last as f64 {
            return (heights[last] + slope(last) * (t - last as f64), slope(last) / self.node);
        }
        // Cubic through the nodes with the slopes of their neighbours.
        let i = (t as usize).min(last - 1);
        let (u, [y0, y1], [m0, m1]) = (t - i as f64, [heights[i], heights[i + 1]], [slope(i), slope(i + 1)]);
        let (c, d) = (3.0 * (y1 - y0) - 2.0 * m0 - m1, m0 + m1 - 2.0 * (y1 - y0));
        (y0 + u * (m0 + u * (c + u * d)), (m0 + u * (2.0 * c + 3.0 * u * d)) / self.node)
    }

    /// The curve nearest along y to a place.
    pub fn nearest(&self, x: f64, y: f64) -> usize {
        let above = self.above(x, y);
        let distance = |curve: usize| (self.at(curve, x).0 - y).abs();
        match above {
            0 => 0,
            n if n == self.len() => n - 1,
            n if distance(n - 1) < distance(n) => n - 1,
            n => n,
        }
    }

    /// Distance along y between the curves around a place, m; beyond the last one that between the last two. `None` for a single
    /// curve.
    pub fn gap(&self, x: f64, y: f64) -> Option<f64> {
        let upper = self.above(x, y).clamp(1, self.len().checked_sub(1).filter(|last| *last > 0)?);
        Some(self.at(upper, x).0 - self.at(upper - 1, x).0)
    }

    /// Least and largest distance along y between neighbours, m.
    pub fn step_over(&self) -> [f64; 2] {
        if self.len() < 2 {
            return [0.0; 2];
        }
        let gaps = self.curves.windows(2).flat_map(|w| w[1].iter().zip(&w[0]).map(|(b, a)| b - a));
        gaps.fold([f64::INFINITY, 0.0], |[low, high], gap| [low.min(gap), high.max(gap)])
    }

    /// Number of curves below a place.
    fn above(&self, x: f64, y: f64) -> usize {
        let (mut low, mut high) = (0, self.len());
        while low < high {
            let middle = (low + high) / 2;
            if self.at(middle, x).0 < y { low = middle + 1 } else { high = middle }
        }
        low
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::step_over::{allowed_distance, plane_distance, scallop_budget, valley};
    use nalgebra::{Matrix3, Unit};

    fn orientation() -> Orientation {
        let lead = 8f64.to_radians();
        let axis = Unit::new_normalize(Vector3::new(lead.sin(), 0.0, lead.cos()));
        Orientation { axis, feed: Vector3::x(), cross_feed: Vector3::y(), inclination: lead }
    }

    /// A square of 60 mm, ever more curved across the passes towards +x.
    fn points() -> Vec<CloudPoint> {
        let point = |i: usize| {
            let (x, y) = ((i % 100) as f64 * 0.6e-3, (i / 100) as f64 * 0.6e-3);
            CloudPoint {
                position: Point3::new(x, y, 0.0),
                normal: Vector3::z(),
                pseudo_curvature: 0.0,
                curvature: Vector3::y() * Vector3::y().transpose() * (-20.0 * x / 0.06),
                facet_error: 0.0,
                area: 0.36e-6,
            }
        };
        (0..10_000).map(point).collect()
    }

    fn field(points: &[CloudPoint]) -> StepField {
        let job = Job::default_for("s");
        StepField::new(&points.iter().collect::<Vec<_>>(), &orientation(), job.tool.cutter, &job)
    }

    #[test]
    fn neighbours_are_no_farther_apart_than_allowed_and_cover_the_patch() {
        let points = points();
        let field = field(&points);
        let curves = field.curves();
        let frame = tool_frame(&orientation().axis, &orientation().feed);
        let job = Job::default_for("s");
        for p in points.iter().step_by(7) {
            let q = frame * p.position;
            let gap = curves.gap(q.x, q.y).unwrap();
            let (_, slope) = curves.at(curves.nearest(q.x, q.y), q.x);
            let held = turned(&orientation(), &frame, slope);
            let valley = valley(job.tool.cutter, &held, &p.normal, &p.curvature).unwrap();
            let height = scallop_budget(p, job.scallop_height, job.pass_chord);
            let allowed = plane_distance(&valley, height, 1.0) * slope.hypot(1.0);
            assert!(gap > 0.0 && gap <= allowed, "{gap} {allowed} at {q}");
            // The cubic between two nodes is steeper than the line between them by half at the most.
            assert!(slope.abs() <= 1.5 * STEEPEST, "{slope}");
            let nearest = (curves.at(curves.nearest(q.x, q.y), q.x).0 - q.y).abs();
            assert!(nearest <= 0.52 * allowed, "{nearest} {allowed}");
        }
    }

    #[test]
    fn curves_are_shorter_than_planes() {
        let points = points();
        let field = field(&points);
        let curves = field.curves();
        let job = Job::default_for("s");
        // Every plane meets the narrowest place.
        let distance = |p: &CloudPoint| allowed_distance(p, &orientation(), job.tool.cutter, &job).0;
        let narrowest = points.iter().map(distance).fold(f64::INFINITY, f64::min);
        let straight = points.iter().map(|p| p.area).sum::<f64>() / narrowest;
        let curved = field.estimate(&curves).0;
        assert!(curved < 0.93 * straight, "{curved} {straight}");
    }

    #[test]
    fn curves_never_cross_where_next_to_nothing_is_allowed() {
        // Sharp ridges of 5 µm radius and planes side by side in squares of 3 mm.
        let ridge = |p: &CloudPoint| {
            let square = (p.position.x / 3e-3) as u64 * 31 + (p.position.y / 3e-3) as u64;
            let sharp = square.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 62 == 0;
            let curvature =
                if sharp { Vector3::y() * Vector3::y().transpose() * -2e5 } else { Matrix3::zeros() };
            CloudPoint { curvature, ..*p }
        };
        let points: Vec<CloudPoint> = points().iter().map(ridge).collect();
        let curves = field(&points).curves();
        assert!(curves.step_over()[0] >= LEAST_STEP * (1.0 - 1e-9), "{:?}", curves.step_over());
    }

    #[test]
    fn the_first_curve_lies_where_the_least_passes_suffice() {
        // A plane strip that an even number of passes just covers: from its middle one more would be needed.
        let flat = CloudPoint { curvature: Matrix3::zeros(), ..points()[0] };
        let step = allowed_distance(
            &flat,
            &orientation(),
            Cutter { r1: 0.01305, r2: 0.006 },
            &Job::default_for("s"),
        )
        .0;
        let width = 5.9 * step;
        let strip: Vec<CloudPoint> = (0..12_000)
            .map(|i| {
                let (x, y) = ((i % 60) as f64 * 1e-3, (i / 60) as f64 / 199.0 * width);
                CloudPoint { position: Point3::new(x, y, 0.0), ..flat }
            })
            .collect();
        let mut field = field(&strip);
        assert_eq!(field.curves().len(), 7);
        field.start_for_least_length();
        assert_eq!(field.curves().len(), 6);
    }

    #[test]
    fn ridges_change_the_distance_around_them() {
        let points = points();
        let before = field(&points).curves();
        let aim = 25e-6;
        let gap = |leftover: f64, widening: bool| {
            let mut field = field(&points);
            let found: Vec<(Point3<f64>, f64)> = points
                .iter()
                .map(|p| (tool_frame(&orientation().axis, &orientation().feed) * p.position, leftover))
                .collect();
            field.adapt(&before, &found, aim, widening);
            field.curves().gap(0.03, 0.03).unwrap() / before.gap(0.03, 0.03).unwrap()
        };
        assert!((gap(aim / 0.64, true) - 0.8).abs() < 0.03, "{}", gap(aim / 0.64, true));
        assert!((gap(aim / 1.21, true) - 1.1).abs() < 0.03, "{}", gap(aim / 1.21, true));
        assert!((gap(aim / 1.21, false) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn a_curve_is_continuous_and_straight_beyond_its_nodes() {
        let curves =
            PassCurves { first: 1.0, node: 0.5, curves: vec![vec![0.0, 0.1, 0.0, 0.2], vec![1.0; 4]] };
        for k in 0..300 {
            let x = 0.5 + 0.01 * k as f64;
            let ((a, slope), (b, _)) = (curves.at(0, x), curves.at(0, x + 1e-6));
            assert!((b - a - slope * 1e-6).abs() < 1e-10, "{x}");
        }
        assert_eq!((curves.nearest(1.2, 0.4), curves.nearest(1.2, 0.9), curves.nearest(1.2, 5.0)), (0, 1, 1));
        assert_eq!((curves.len(), curves.is_empty()), (2, false));
    }

    #[test]
    fn a_single_point_gets_one_pass() {
        let points = [CloudPoint { curvature: Matrix3::zeros(), ..points()[0] }];
        let curves = field(&points).curves();
        assert_eq!((curves.len(), curves.gap(0.0, 0.0), curves.step_over()), (1, None, [0.0; 2]));
    }
}
