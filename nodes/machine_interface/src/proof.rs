//! The proof: the cutter swept along the motions of the program *text* over dense samples of the facets.

use crate::clearance::{PartBody, TOOL_REACH, ToolBody};
use crate::gcode::ReadBlock;
use crate::rest_regions::Standing;
use nalgebra::{Point3, Unit, Vector3};
use patchmill_geometry::mesh::TriangleMesh;
use patchmill_geometry::sweep::{Pose, ProofPoints, sweep_fixed_axis, sweep_poses};
use patchmill_kinematics::{Joints, Machine};
use patchmill_products::evaluation::{Proof, ProofSpot, ResidualMap, UNTOUCHED};
use patchmill_products::job::Job;
use patchmill_products::stage::{Progress, StageError};
use patchmill_rolling_ball_analysis::local_balls::LocalBalls;

/// Distance between proof points, m.
const SPACING: f64 = 0.4e-3;
/// The spacing grows rather than let the number of proof points pass this …
const MOST_POINTS: f64 = 250e3;
/// … and shrinks on small parts rather than let it fall below this.
const LEAST_POINTS: f64 = 2e3;
/// Gouges of so many tolerances are seen where they are as small as a ball of the cutter's corner makes them, …
const SEEN: f64 = 10.0;
/// … of which a sharp one counts as that, m.
const SHARP: f64 = 50e-6;
/// What the sweep's own discretisation may add to a leftover, m.
const SCALLOP_SLACK: f64 = 0.5e-6;
/// Places that a proof names of a kind, and how far they are apart at least, m.
const SPOTS: usize = 5;
const SPOT_DISTANCE: f64 = 5e-3;
/// Share of the gouge tolerance by which check surface may be cut unnoticed.
const CHECK_SHARE: f64 = 0.5;
/// Share of the area that must lie within the scallop height.
pub const COVERAGE: f64 = 0.999;

/// Proof points of a mesh: those on what is to be finished, and those on check surface, which only have to stay whole.
pub struct PartPoints {
    /// On the facets that are to be finished.
    pub finished: ProofPoints,
    /// On the others.
    pub checked: ProofPoints,
}

impl PartPoints {
    /// Spreads the points as finely as the job's cutter asks for.
    pub fn of(mesh: &TriangleMesh, job: &Job) -> Self {
        let spacing = |area| spacing(area, job);
        let finished = ProofPoints::on_finished(mesh, spacing(mesh.finished_area()));
        if mesh.check_only.is_empty() {
            return Self { finished, checked: ProofPoints::default() };
        }
        let others = (0..mesh.triangles.len()).filter(|t| !mesh.is_finished(*t));
        let area = others.map(|t| mesh.facet_area(t)).sum();
        let checked = ProofPoints::on_check_surface(mesh, spacing(area));
        Self { finished, checked }
    }
}

/// Distance between the proof points of so much area (m²), m: where a small cutter went [`SEEN`] tolerances too deep at one place, it
/// left a mark of that radius.
fn spacing(area: f64, job: &Job) -> f64 {
    let [most, least] = [MOST_POINTS, LEAST_POINTS].map(|count| (area / count).sqrt());
    let mark = (2.0 * job.tool.cutter.r2.max(SHARP) * SEEN * job.gouge_tolerance).sqrt();
    SPACING.min(mark).min(least).max(most).max(f64::MIN_POSITIVE)
}

/// Poses of moves at feed that turn are no farther apart than this, m: a corner of 6 mm leaves 0.2 µm between them.
const FEED_STEP: f64 = 0.1e-3;
/// Lever with which a turn counts as a way, m.
const LEVER: f64 = 0.02;

/// A program's motions by tool orientation.
pub(crate) struct Motions {
    /// Those with one tool axis each.
    pub(crate) fixed: Vec<Sweeps>,
    /// Poses along moves at feed that turn.
    pub(crate) turning_feed: Vec<Pose>,
    /// Poses along rapids that turn near the part.
    pub(crate) turning_rapid: Vec<Pose>,
}

/// Motions with one tool axis: tip polylines at feed and in rapids.
pub(crate) struct Sweeps {
    pub(crate) axis: Unit<Vector3<f64>>,
    rotary: [f64; 2],
    pub(crate) feed: Vec<Vec<Point3<f64>>>,
    pub(crate) rapid: Vec<Vec<Point3<f64>>>,
}

/// Sweeps the cutter along a program. Feed moves cut; rapids only count where they gouge. The map holds what is left at every
/// proof point, in their order. `balls` tell where the tool does not fit, if the job leaves what is there standing.
///
/// # Errors
/// SUPERSEDED when cancelled.
pub fn prove(
    blocks: &[ReadBlock],
    machine: &Machine,
    part: &PartBody,
    points: &PartPoints,
    balls: Option<&LocalBalls>,
    job: &Job,
    progress: &Progress<'_>,
) -> Result<(Proof, ResidualMap), StageError> {
    let motions = motions_of(blocks, machine, part, job);
    let checked = deepest_in_check_surface(&motions, &points.checked, job, progress)?;
    let points = &points.finished;
    let mut left = vec![f64::INFINITY; points.points.len()];
    let mut hit = left.clone();
    let run = |s: &Sweeps, lines: &[Vec<Point3<f64>>], residual: &mut [f64]| {
        let lines: Vec<&[Point3<f64>]> = lines.iter().map(Vec::as_slice).collect();
        if !lines.is_empty() {
            sweep_fixed_axis(
                points,
                job.tool.cutter,
                &s.axis,
                &lines,
                UNTOUCHED,
                progress.cancelled,
                residual,
            );
        }
    };
    for s in &motions.fixed {
        run(s, &s.feed, &mut left);
        run(s, &s.rapid, &mut hit);
        progress.check()?;
    }
    for (poses, residual) in [(&motions.turning_feed, &mut left), (&motions.turning_rapid, &mut hit)] {
        sweep_poses(points, job.tool.cutter, poses, TOOL_REACH, UNTOUCHED, residual);
        progress.check()?;
    }
    let worst = |(l, h): (&f64, &f64)| if *h < 0.0 { l.min(*h) } else { *l };
    let leftover = left.iter().zip(&hit).map(worst).map(|l| l.min(UNTOUCHED)).collect();
    let map = ResidualMap { points: points.points.clone(), leftover };
    let standing = balls.map(|balls| Standing::find(&map, points, within_scallop(job), balls, job));
    let mut proof = summary(&map, &points.weights, &standing.unwrap_or_default(), job);
    if let Some(spot) = checked.filter(|spot| -spot.leftover > proof.gouge_max) {
        proof.gouge_max = -spot.leftover;
        proof.deepest = vec![spot];
    }
    Ok((proof, map))
}

/// Where check surface is gouged deepest; `None` where it is not by more than [`CHECK_SHARE`] of the tolerance.
///
/// The cutter may roll along a steep wall, where a gap along the axis says nothing of the distance: so the points are looked at that
/// deep below the surface.
fn deepest_in_check_surface(
    motions: &Motions,
    points: &ProofPoints,
    job: &Job,
    progress: &Progress<'_>,
) -> Result<Option<ProofSpot>, StageError> {
    let depth = CHECK_SHARE * job.gouge_tolerance;
    let mut sunk = points.clone();
    sunk.points.iter_mut().zip(&points.normals).for_each(|(p, normal)| *p -= normal * depth);
    let mut residual = vec![f64::INFINITY; points.len()];
    for s in motions.fixed.iter().filter(|_| !points.is_empty()) {
        let lines: Vec<&[Point3<f64>]> = s.feed.iter().chain(&s.rapid).map(Vec::as_slice).collect();
        sweep_fixed_axis(&sunk, job.tool.cutter, &s.axis, &lines, 0.0, progress.cancelled, &mut residual);
        progress.check()?;
    }
    for poses in [&motions.turning_feed, &motions.turning_rapid] {
        sweep_poses(&sunk, job.tool.cutter, poses, TOOL_REACH, 0.0, &mut residual);
        progress.check()?;
    }
    let gouged = residual.iter().enumerate().filter(|(_, left)| **left < 0.0);
    let deepest = gouged.min_by(|a, b| a.1.total_cmp(b.1));
    Ok(deepest.map(|(i, left)| ProofSpot { position: points.points[i], leftover: left - depth }))
}

/// Groups motions by tool orientation.
pub(crate) fn motions_of(blocks: &[ReadBlock], machine: &Machine, part: &PartBody, job: &Job) -> Motions {
    let mut sweeps: Vec<Sweeps> = Vec::new();
    let (mut turning_feed, mut turning_rapid) = (Vec::new(), Vec::new());
    let tool = ToolBody::of(&job.tool);
    let mut open = false;
    for pair in blocks.windows(2) {
        let (from, to) = (&pair[0], &pair[1]);
        let rotary = [to.joints[3], to.joints[4]];
        if [from.joints[3], from.joints[4]] != rotary {
            open = false;
            if !to.rapid {
                turning_feed.extend(feed_poses(machine, &from.joints, &to.joints));
            } else if !part.clears(machine, &from.joints, &to.joints, &tool, 0.001) {
                turning_rapid.extend(poses_between(machine, &from.joints, &to.joints));
            }
            continue;
        }
        let (start, end) = (machine.pose(&from.joints), machine.pose(&to.joints));
        if sweeps.last().is_none_or(|s| s.rotary != rotary) {
            sweeps.push(Sweeps { axis: end.axis, rotary, feed: Vec::new(), rapid: Vec::new() });
            open = false;
        }
        let Some(sweep) = sweeps.last_mut() else { continue };
        let lines = if to.rapid { &mut sweep.rapid } else { &mut sweep.feed };
        match lines.last_mut().filter(|_| open && from.rapid == to.rapid) {
            Some(line) => line.push(end.tip),
            None => lines.push(vec![start.tip, end.tip]),
        }
        open = true;
    }
    Motions { fixed: sweeps, turning_feed, turning_rapid }
}

/// Poses of a move at feed that turns, its start included.
fn feed_poses(machine: &Machine, from: &Joints, to: &Joints) -> impl Iterator<Item = Pose> {
    let (a, b) = (machine.pose(from), machine.pose(to));
    let way = (b.tip - a.tip).norm() + LEVER * a.axis.angle(&b.axis);
    let steps = (way / FEED_STEP).ceil().clamp(1.0, 5000.0) as usize;
    steps_between(machine, from, to, steps)
}

/// Poses at even steps of all joints, both ends included.
fn steps_between(machine: &Machine, from: &Joints, to: &Joints, steps: usize) -> impl Iterator<Item = Pose> {
    let at = move |i: usize| std::array::from_fn(|j| from[j] + (to[j] - from[j]) * i as f64 / steps as f64);
    (0..=steps).map(move |i| machine.pose(&at(i))).map(|pose| (pose.tip, pose.axis))
}

/// Poses of a turning move, finely enough for the tool's end to pass no more than about a tenth of a millimetre.
fn poses_between(machine: &Machine, from: &Joints, to: &Joints) -> impl Iterator<Item = Pose> {
    let way: f64 = (0..5).map(|j| (to[j] - from[j]).abs() * if j < 3 { 1.0 } else { 0.2 }).sum();
    let steps = (way / 1e-4).ceil().clamp(1.0, 5000.0) as usize;
    steps_between(machine, from, to, steps)
}

/// Leftover that still is within the job's scallop height, m.
pub fn within_scallop(job: &Job) -> f64 {
    job.stock_allowance + job.scallop_height + SCALLOP_SLACK
}

/// The figures of a map; `weights` is the area of every point, m². What is left `standing` counts for its regions and for gouges only.
fn summary(map: &ResidualMap, weights: &[f64], standing: &Standing, job: &Job) -> Proof {
    let left = &map.leftover;
    let stands = standing.marks(left.len());
    let weights_of_all = weights;
    let weights: Vec<f64> =
        weights.iter().zip(&stands).map(|(weight, stands)| if *stands { 0.0 } else { *weight }).collect();
    let total: f64 = weights.iter().sum();
    let share = |keep: &dyn Fn(f64) -> bool| {
        left.iter().zip(&weights).filter(|(l, _)| keep(**l)).map(|(_, w)| w).sum::<f64>().max(0.0) / total
    };
    let mut order: Vec<usize> = (0..left.len()).collect();
    order.sort_by(|&a, &b| left[a].total_cmp(&left[b]).then(a.cmp(&b)));
    let percentile = |share: f64| {
        let mut covered = 0.0;
        let place = order.iter().find(|&&i| {
            covered += weights[i];
            covered >= share * total
        });
        place.map_or(UNTOUCHED, |&i| left[i].max(0.0))
    };
    let within = within_scallop(job);
    let finished = || order.iter().rev().copied().filter(|&i| !stands[i]);
    let (rest_area, rest) = standing.regions(map, weights_of_all);
    let below = order.iter().copied().take_while(|&i| left[i] < 0.0);
    Proof {
        gouge_max: order.first().map_or(0.0, |&i| (-left[i]).max(0.0)),
        scallop_max: finished().next().map_or(0.0, |i| left[i].max(0.0)),
        scallop_p50: percentile(0.5),
        scallop_p90: percentile(0.9),
        scallop_p99: percentile(0.99),
        scallop_p999: percentile(COVERAGE),
        area_within_scallop: share(&|l| l <= within),
        uncut_area: share(&|l| l >= UNTOUCHED),
        deepest: spots(map, below),
        highest: spots(map, finished()),
        rest_area,
        rest,
    }
}

/// The first places of an order that keep their distance from each other.
fn spots(map: &ResidualMap, order: impl Iterator<Item = usize>) -> Vec<ProofSpot> {
    let mut found: Vec<ProofSpot> = Vec::new();
    for i in order {
        let position = map.points[i];
        if found.iter().all(|spot| (spot.position - position).norm() >= SPOT_DISTANCE) {
            found.push(ProofSpot { position, leftover: map.leftover[i] });
            if found.len() == SPOTS {
                break;
            }
        }
    }
    found
}

/// What of the job's tolerances a proof breaks; `None` when it passes.
pub fn shortcoming(proof: &Proof, job: &Job) -> Option<String> {
    if proof.gouge_max > job.gouge_tolerance || proof.gouge_max.is_nan() {
        return Some(format!(
            "the swept check of the program finds a gouge of {:.4} mm{}, tolerance {:.4} mm",
            proof.gouge_max * 1e3,
            place_of(&proof.deepest),
            job.gouge_tolerance * 1e3
        ));
    }
    if proof.area_within_scallop < COVERAGE || proof.area_within_scallop.is_nan() {
        return Some(format!(
            "the swept check of the program finds {:.3} % of the area within the scallop height of {:.4} mm, {:.1} % wanted ({:.3} % uncut, 99.9 % within {:.4} mm, most is left{}){}",
            proof.area_within_scallop * 100.0,
            job.scallop_height * 1e3,
            COVERAGE * 100.0,
            proof.uncut_area * 100.0,
            proof.scallop_p999 * 1e3,
            place_of(&proof.highest),
            rest_hint(proof, job)
        ));
    }
    None
}

/// What may help where something is left.
fn rest_hint(proof: &Proof, job: &Job) -> String {
    if job.leaves_rest() {
        format!(
            "; beside that {:.1} mm² are left standing where the tool does not fit",
            proof.rest_area * 1e6
        )
    } else {
        String::new()
    }
}

/// Where the worst of the places is, for a sentence.
fn place_of(spots: &[ProofSpot]) -> String {
    spots.first().map_or_else(String::new, |spot| {
        let p = spot.position * 1e3;
        format!(" at ({:.1}, {:.1}, {:.1}) mm", p.x, p.y, p.z)
    })
}
