//! The swept check: how far a moving cutter stays from points of the surface.

use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering};

use nalgebra::{Point3, Unit, Vector3};
use rayon::prelude::*;

use crate::contact_tree::{ContactNode, ContactTree, Profile, SLACK};
use crate::cutter::Cutter;
use crate::drop_cutter::tool_frame;
use crate::edge_contact::inside_contact;
use crate::split_tree::{Split, split_tree};

pub use crate::proof_points::ProofPoints;

/// Gaps along the axis are turned into normal distances by the cosine between them, at least this.
pub(crate) const LEAST_COSINE: f64 = 0.02;
/// Points whose normal has a lesser cosine to the axis count only when the cutter goes below them.
pub(crate) const GRAZING: f64 = 0.1;
/// Points handled by one parallel task.
pub(crate) const TASK: usize = 1024;
/// Points in one ball of [`sweep_poses`].
const CLUSTER: usize = 64;

/// Lowers `residual[i]` to the least distance of point i from a cutter of constant `axis` whose tip runs along
/// `polylines` (straight between their points, `workpiece` frame, m).
///
/// The residual is m along the point's normal: the exact least gap along the axis between the point and the
/// cutter's surface over all moves, times the cosine between normal and axis, which is the distance to first order,
/// exact where it vanishes. Negative: the cutter goes below the surface there (gouge). Start with +∞ and
/// call once for each axis. Residuals that stay above `cap` (m) are not lowered; gouges always are. Points
/// steeper than about 84° to the axis count only when gouged; points outside the swept tool stay untouched.
/// Only the cutting end and the cylinder above it count, not holder and spindle. Once `cancelled` is set the rest is left
/// out: the residuals mean nothing then.
///
/// # Panics
/// If `residual` is not as long as `points`.
pub fn sweep_fixed_axis(
    points: &ProofPoints,
    cutter: Cutter,
    axis: &Unit<Vector3<f64>>,
    polylines: &[&[Point3<f64>]],
    cap: f64,
    cancelled: &AtomicBool,
    residual: &mut [f64],
) {
    assert_eq!(points.len(), residual.len(), "one residual for each proof point");
    let frame = tool_frame(axis, &Vector3::x());
    let moves = Moves::new(cutter, polylines, |p| (frame * p).coords.into());
    let tasks = residual.par_chunks_mut(TASK).enumerate();
    tasks.for_each(|(task, residual)| {
        if cancelled.load(Ordering::Relaxed) {
            return;
        }
        let mut near = 0..0;
        for (i, residual) in residual.iter_mut().enumerate() {
            let i = task * TASK + i;
            let facing = points.normals[i].dot(axis);
            let cosine = facing.max(LEAST_COSINE);
            let limit = if facing > GRAZING { residual.min(cap) } else { residual.min(0.0) };
            let q = frame * points.points[i];
            if let Some(gap) = moves.least_gap(q.x, q.y, q.z, limit / cosine, &mut near) {
                *residual = gap * cosine;
            }
        }
    });
}

/// One straight move of the tip, upside down: the gap tip_z + lift(ρ) − z over a point is least where
/// −tip_z − lift(ρ) is highest, so sweeping is dropping the cutter at the point onto the mirrored path.
pub(crate) type Move = [[f64; 3]; 2];

pub(crate) struct Moves {
    /// In leaf order.
    pub(crate) moves: Vec<Move>,
    /// Place of each among the moves of all polylines one after the other; a polyline of one point is one move.
    pub(crate) order: Vec<u32>,
    pub(crate) tree: ContactTree,
}

impl Moves {
    pub(crate) fn new(
        cutter: Cutter,
        polylines: &[&[Point3<f64>]],
        to_tool: impl Fn(&Point3<f64>) -> [f64; 3],
    ) -> Self {
        let mirrored = |p: &Point3<f64>| {
            let [x, y, z] = to_tool(p);
            [x, y, -z]
        };
        let mut moves: Vec<Move> = Vec::new();
        for line in polylines {
            match line {
                [] => {}
                [only] => moves.push([mirrored(only); 2]),
                _ => moves.extend(line.windows(2).map(|w| [mirrored(&w[0]), mirrored(&w[1])])),
            }
        }
        let centres: Vec<[f64; 3]> =
            moves.iter().map(|[p, q]| [0, 1, 2].map(|k| 0.5 * (p[k] + q[k]))).collect();
        let (order, splits) = split_tree(&centres);
        let moves: Vec<Move> = order.iter().map(|&i| moves[i as usize]).collect();
        let tool = Profile::of(cutter);
        let nodes = splits.iter().map(|s| contact_node(&tool, s, &moves[s.range()])).collect();
        Self { moves, order, tree: ContactTree { nodes, tool } }
    }

    /// The least gap along the axis over (x, y, z) if it is below `limit`. `near` is the leaf that had the least gap over a point
    /// nearby: looked at first, it leaves little to be searched for; then this point's.
    fn least_gap(&self, x: f64, y: f64, z: f64, limit: f64, near: &mut Range<usize>) -> Option<f64> {
        let floor = -(limit + z);
        let mut highest = floor;
        for m in &self.moves[near.clone()] {
            raise(&self.tree.tool, m, x, y, &mut highest);
        }
        self.tree.search(x, y, highest, |range, best| {
            for m in &self.moves[range.clone()] {
                raise(&self.tree.tool, m, x, y, best);
            }
            if *best > highest {
                (highest, *near) = (*best, range);
            }
        });
        (highest > floor).then_some(-highest - z)
    }
}

/// Raises `best` to the highest of the move under a cutter at (x, y).
#[inline]
fn raise(tool: &Profile, [p, q]: &Move, x: f64, y: f64, best: &mut f64) {
    if p[2].max(q[2]) <= *best + SLACK {
        return;
    }
    let (p, q) = ([p[0] - x, p[1] - y, p[2]], [q[0] - x, q[1] - y, q[2]]);
    for end in [&p, &q] {
        let rho2 = end[0] * end[0] + end[1] * end[1];
        if rho2 <= tool.radius * tool.radius {
            *best = best.max(end[2] - tool.lift(rho2.sqrt()));
        }
    }
    if let Some((z, _)) = inside_contact(tool, &p, &q, *best) {
        *best = best.max(z);
    }
}

/// Box in plan, and the least-squares plane of the ends raised over all of them.
fn contact_node(tool: &Profile, split: &Split, moves: &[Move]) -> ContactNode {
    let ends = || moves.iter().flatten();
    let (mut low, mut high, mut mean) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2], [0.0; 3]);
    for p in ends() {
        for k in 0..2 {
            low[k] = low[k].min(p[k]);
            high[k] = high[k].max(p[k]);
        }
        for k in 0..3 {
            mean[k] += p[k] / (2 * moves.len()) as f64;
        }
    }
    let centre = [0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1])];
    let slope = fitted_slope(ends(), &mean);
    let above = |p: &[f64; 3]| p[2] - slope[0] * (p[0] - centre[0]) - slope[1] * (p[1] - centre[1]);
    ContactNode {
        centre,
        half: [high[0] - centre[0], high[1] - centre[1]],
        slope,
        top: ends().map(above).fold(f64::NEG_INFINITY, f64::max),
        toe: tool.toe(slope),
        rise: tool.rise(slope[0].hypot(slope[1])),
        first: split.first,
        count: if split.right == 0 { split.count } else { 0 },
        right: split.right,
    }
}

/// Gradient of the least-squares plane; level across the points where they lie on one line.
fn fitted_slope<'a>(points: impl Iterator<Item = &'a [f64; 3]>, mean: &[f64; 3]) -> [f64; 2] {
    let (mut xx, mut xy, mut yy, mut xz, mut yz) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for p in points {
        let [x, y, z] = [0, 1, 2].map(|k| p[k] - mean[k]);
        (xx, xy, yy) = (xx + x * x, xy + x * y, yy + y * y);
        (xz, yz) = (xz + x * z, yz + y * z);
    }
    let ridge = 1e-6 * (xx + yy) + f64::MIN_POSITIVE;
    let (xx, yy) = (xx + ridge, yy + ridge);
    let det = xx * yy - xy * xy;
    let slope = [(yy * xz - xy * yz) / det, (xx * yz - xy * xz) / det];
    // Plunges: a plane through them bounds nothing better than their height.
    if slope.iter().all(|s| s.abs() < 10.0) { slope } else { [0.0; 2] }
}

/// A cutter's tip and its axis, tip to spindle.
pub type Pose = (Point3<f64>, Unit<Vector3<f64>>);

/// Lowers `residual[i]` over single poses of the cutter, for moves in which the axis turns: the caller steps such a move
/// finely enough.
///
/// The residual is the gap along the axis of the pose times its cosine to the normal, as in [`sweep_fixed_axis`].
/// A point counts when it is within the tool's radius of the axis and not more than `reach` (m) above the tip.
/// Residuals that stay above `cap` (m) may or may not be lowered; gouges always are.
///
/// # Panics
/// If `residual` is not as long as `points`.
pub fn sweep_poses(
    points: &ProofPoints,
    cutter: Cutter,
    poses: &[Pose],
    reach: f64,
    cap: f64,
    residual: &mut [f64],
) {
    assert_eq!(points.len(), residual.len(), "one residual for each proof point");
    residual.par_chunks_mut(CLUSTER).enumerate().for_each(|(cluster, residual)| {
        let first = cluster * CLUSTER;
        let positions = &points.points[first..first + residual.len()];
        let disc = Disc::around(positions, &points.normals[first..first + residual.len()]);
        for (tip, axis) in poses {
            let d = disc.middle - tip;
            let height = d.dot(axis);
            let (near, across) = (cutter.radius() + disc.radius, d.norm_squared() - height * height);
            if height > reach + disc.radius || across > near * near {
                continue;
            }
            if disc.least_gap(cutter, axis, height, across.max(0.0).sqrt()) > cap {
                continue;
            }
            for (i, residual) in residual.iter_mut().enumerate() {
                let d = positions[i] - tip;
                let height = d.dot(axis);
                let rho = (d - axis.into_inner() * height).norm();
                let Some(lift) = cutter.lift(rho).filter(|_| height <= reach) else { continue };
                let facing = points.normals[first + i].dot(axis);
                let gap = lift - height;
                if facing > GRAZING || gap < 0.0 {
                    *residual = residual.min(gap * facing.max(LEAST_COSINE));
                }
            }
        }
    });
}

/// Proof points as obstacles of single poses.
pub struct Obstacles<'a> {
    points: &'a ProofPoints,
    discs: Vec<Disc>,
}

impl<'a> Obstacles<'a> {
    /// Groups the points.
    pub fn new(points: &'a ProofPoints) -> Self {
        let clusters = points.points.par_chunks(CLUSTER).zip(points.normals.par_chunks(CLUSTER));
        Self {
            points,
            discs: clusters.map(|(positions, normals)| Disc::around(positions, normals)).collect(),
        }
    }

    /// How far a cutter at a pose has to be raised along its axis until no point lies in it, m, ≥ 0. Points count as for
    /// [`sweep_poses`].
    pub fn raise(&self, cutter: Cutter, (tip, axis): &Pose, reach: f64) -> f64 {
        let mut raise = 0.0f64;
        for (cluster, disc) in self.discs.iter().enumerate() {
            let d = disc.middle - tip;
            let height = d.dot(axis);
            let (near, across) = (cutter.radius() + disc.radius, d.norm_squared() - height * height);
            if height > reach + disc.radius || height + disc.radius <= raise || across > near * near {
                continue;
            }
            let first = cluster * CLUSTER;
            for p in &self.points.points[first..(first + CLUSTER).min(self.points.len())] {
                let d = p - tip;
                let height = d.dot(axis);
                if height <= raise || height > reach {
                    continue;
                }
                let rho = (d - axis.into_inner() * height).norm();
                if let Some(lift) = cutter.lift(rho) {
                    raise = raise.max(height - lift);
                }
            }
        }
        raise
    }
}

/// A flat body around a few proof points: within `radius` of `middle` along their mean plane, within `thickness` of it across.
struct Disc {
    middle: Point3<f64>,
    normal: Vector3<f64>,
    radius: f64,
    thickness: f64,
    /// Least cosine between a point's normal and an axis, from the mean normal's: cos(∠ + spread) ≥ cosine − spread.
    spread: f64,
}

impl Disc {
    fn around(positions: &[Point3<f64>], normals: &[Vector3<f64>]) -> Self {
        let sum: Vector3<f64> = positions.iter().map(|p| p.coords).sum();
        let middle = Point3::from(sum / positions.len() as f64);
        let normal = normals.iter().sum::<Vector3<f64>>().try_normalize(1e-9).unwrap_or_default();
        let largest = |f: &dyn Fn(&Vector3<f64>) -> f64| {
            positions.iter().map(|p| f(&(p - middle))).fold(0.0, f64::max) * (1.0 + 1e-12)
        };
        Self {
            middle,
            normal,
            radius: largest(&|d| d.norm()),
            thickness: largest(&|d| d.dot(&normal).abs()),
            spread: normals.iter().map(|n| (n - normal).norm()).fold(0.0, f64::max),
        }
    }

    /// A lower bound of the residuals, where it is above 0; `height` along the axis from the tip and `across` are the middle's.
    fn least_gap(&self, cutter: Cutter, axis: &Vector3<f64>, height: f64, across: f64) -> f64 {
        let facing = self.normal.dot(axis);
        let sine = (1.0 - facing * facing).max(0.0).sqrt();
        let highest = height + sine * self.radius + facing.abs() * self.thickness;
        let lift = cutter.lift((across - self.radius).max(0.0)).unwrap_or(0.0);
        (lift - highest) * (facing - self.spread).max(LEAST_COSINE)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_meshes::{Random, bumpy, height_field};

    static NEVER: AtomicBool = AtomicBool::new(false);

    fn axis(x: f64, y: f64) -> Unit<Vector3<f64>> {
        Unit::new_normalize(Vector3::new(x, y, 1.0))
    }

    /// Dense stepping along every move, over all points.
    fn stepped(
        points: &ProofPoints,
        cutter: Cutter,
        axis: &Unit<Vector3<f64>>,
        lines: &[&[Point3<f64>]],
        steps: usize,
    ) -> Vec<f64> {
        let mut residual = vec![f64::INFINITY; points.len()];
        for w in lines.iter().flat_map(|l| l.windows(2)) {
            let pose = |k: usize| (w[0] + (w[1] - w[0]) * (k as f64 / steps as f64), *axis);
            sweep_poses(
                points,
                cutter,
                &(0..=steps).map(pose).collect::<Vec<_>>(),
                1.0,
                f64::INFINITY,
                &mut residual,
            );
        }
        residual
    }

    #[test]
    fn sweep_matches_dense_stepping() {
        let points = ProofPoints::on_facets(&bumpy(40, 0.02, 0.002), 1.5e-3);
        let mut random = Random::new(3);
        for cutter in
            [Cutter { r1: 0.006, r2: 0.003 }, Cutter { r1: 0.0, r2: 0.005 }, Cutter { r1: 0.005, r2: 0.0 }]
        {
            let axis = axis(0.2, -0.1);
            let mut lines: Vec<Vec<Point3<f64>>> = Vec::new();
            for pass in 0..6 {
                let y = -0.02 + 0.008 * f64::from(pass);
                let point =
                    |k: i32| Point3::new(-0.02 + 0.002 * f64::from(k), y, random.in_range(-0.001, 0.002));
                lines.push((0..20).map(point).collect());
            }
            lines.push(vec![
                Point3::origin() + axis.into_inner() * 0.01,
                Point3::origin() - axis.into_inner() * 0.001,
            ]);
            let lines: Vec<&[Point3<f64>]> = lines.iter().map(Vec::as_slice).collect();
            let expected = stepped(&points, cutter, &axis, &lines, 400);
            for cap in [f64::INFINITY, 0.15e-3] {
                let mut found = vec![f64::INFINITY; points.len()];
                sweep_fixed_axis(&points, cutter, &axis, &lines, cap, &NEVER, &mut found);
                for (f, e) in found.iter().zip(&expected) {
                    if *e < cap - 1e-6 || *f < cap {
                        // Stepping sees less, by curvature × (half a step)² at most; at a flat end's rim it misses slots.
                        let slack = if cutter.r2 == 0.0 { 3e-5 } else { 1e-6 };
                        assert!(
                            *f <= *e + 1e-12 && *f > *e - slack || *e == f64::INFINITY,
                            "{cutter:?} {f} {e}"
                        );
                    } else {
                        assert!(*f >= cap && f.is_infinite());
                    }
                }
                assert!(found.iter().any(|&f| f < -1e-4));
                assert!(cap.is_infinite() || found.iter().any(|f| f.is_infinite()));
            }
        }
    }

    #[test]
    fn scallop_on_a_plane_is_that_of_the_swept_ellipse() {
        let cutter = Cutter { r1: 0.01305, r2: 0.006 };
        let points = ProofPoints::on_facets(&height_field(2, 0.02, |_, _| 0.0), 0.1e-3);
        let lead = 5f64.to_radians();
        let axis = Unit::new_normalize(Vector3::new(lead.sin(), 0.0, lead.cos()));
        // Contact P: C = P + R2 n + R1 w/|w|, w = n − (n·a)a; T = C − R2 a.
        let w = (Vector3::z() - axis.into_inner() * lead.cos()).normalize();
        let step = 0.005;
        let tip = |x: f64, y: f64| {
            Point3::from(Vector3::new(x, y, cutter.r2) + w * cutter.r1 - axis.into_inner() * cutter.r2)
        };
        let passes: Vec<[Point3<f64>; 2]> =
            (-4..=4).map(|k| f64::from(k) * step).map(|y| [tip(-0.04, y), tip(0.04, y)]).collect();
        let lines: Vec<&[Point3<f64>]> = passes.iter().map(|p| p.as_slice()).collect();
        let mut residual = vec![f64::INFINITY; points.len()];
        sweep_fixed_axis(&points, cutter, &axis, &lines, 0.15e-3, &NEVER, &mut residual);
        // Seen along the feed the mid-circle is an ellipse of semi-axes R1 and R1 sin(lead); the swept profile
        // is its offset by R2: at parameter t the centre is (R1 sin t, R2 + R1 sin(lead)(1 − cos t)), normal (cos-part).
        let height = |y: f64| {
            let (mut a, mut b) = (0.0f64, 1.5f64);
            let at = |t: f64| {
                let (ey, ez) = (cutter.r1 * t.sin(), cutter.r1 * lead.sin() * (1.0 - t.cos()));
                let (ty, tz) = (t.cos(), lead.sin() * t.sin());
                let norm = ty.hypot(tz);
                (ey + cutter.r2 * tz / norm, ez + cutter.r2 * (1.0 - ty / norm))
            };
            for _ in 0..80 {
                let m = 0.5 * (a + b);
                if at(m).0 < y { a = m } else { b = m }
            }
            at(a).1
        };
        // The gap along the axis leaves the normal by the lead: over a plane, with the swept profile constant
        // along x, distance along the axis × cos(lead) is the height above the plane itself.
        let mut worst = 0.0f64;
        for (p, r) in points.points.iter().zip(&residual) {
            let y = p.y.abs() % step;
            let expected = height(y.min(step - y));
            worst = worst.max((r - expected).abs());
        }
        assert!(worst < 1e-10, "{worst}");
        let highest = residual.iter().copied().fold(0.0, f64::max);
        assert!(highest <= height(step / 2.0) && highest > 0.9 * height(step / 2.0));
    }

    #[test]
    fn steep_points_count_only_when_gouged() {
        let points = ProofPoints {
            points: vec![Point3::new(0.0, 0.0, 0.0), Point3::new(0.0, 0.0, 0.002)],
            normals: vec![Vector3::x(); 2],
            weights: vec![1.0; 2],
        };
        let line = [Point3::new(-0.01, 0.0, 0.001), Point3::new(0.01, 0.0, 0.001)];
        let mut residual = vec![f64::INFINITY; 2];
        sweep_fixed_axis(
            &points,
            Cutter { r1: 0.0, r2: 0.005 },
            &Vector3::z_axis(),
            &[&line],
            1.0,
            &NEVER,
            &mut residual,
        );
        assert!(residual[0].is_infinite() && (residual[1] + 0.001 * LEAST_COSINE).abs() < 1e-15);
    }

    #[test]
    fn poses_see_the_cylinder_up_to_their_reach() {
        let points = ProofPoints {
            points: vec![
                Point3::new(0.004, 0.0, 0.03),
                Point3::new(0.004, 0.0, 0.2),
                Point3::new(0.2, 0.0, 0.0),
            ],
            normals: vec![Vector3::z(); 3],
            weights: vec![1.0; 3],
        };
        let mut residual = vec![f64::INFINITY; 3];
        let poses = [(Point3::origin(), Vector3::z_axis())];
        sweep_poses(&points, Cutter { r1: 0.004, r2: 0.001 }, &poses, 0.1, f64::INFINITY, &mut residual);
        assert_eq!(residual, [-0.03, f64::INFINITY, f64::INFINITY]);
    }
}
