//! The proof: the cutter swept along the motions of the program *text* over dense samples of the facets.

use crate::clearance::{PartBody, TOOL_REACH, ToolBody};
use crate::gcode::ReadBlock;
use nalgebra::{Point3, Unit, Vector3};
use patchmill_geometry::mesh::TriangleMesh;
use patchmill_geometry::sweep::{Pose, ProofPoints, sweep_fixed_axis, sweep_poses};
use patchmill_kinematics::{Joints, Machine};
use patchmill_products::evaluation::Proof;
use patchmill_products::job::Job;
use patchmill_products::stage::{Progress, StageError};

/// Distance between proof points, m.
const SPACING: f64 = 0.4e-3;
/// The spacing grows rather than let the number of proof points pass this.
const MOST_POINTS: f64 = 250e3;
/// Leftover that counts as untouched, m.
const UNTOUCHED: f64 = 1e-3;
/// What the sweep's own discretisation may add to a leftover, m.
const SCALLOP_SLACK: f64 = 0.5e-6;
/// Share of the area that must lie within the scallop height.
pub const COVERAGE: f64 = 0.999;

/// Proof points of a mesh.
pub fn proof_points(mesh: &TriangleMesh) -> ProofPoints {
    let area: f64 = (0..mesh.triangles.len())
        .map(|t| {
            let [a, b, c] = mesh.corners(t);
            0.5 * (b - a).cross(&(c - a)).norm()
        })
        .sum();
    ProofPoints::on_facets(mesh, SPACING.max((area / MOST_POINTS).sqrt()))
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

/// Sweeps the cutter along a program. Feed moves cut; rapids only count where they gouge.
///
/// # Errors
/// SUPERSEDED when cancelled.
pub fn prove(
    blocks: &[ReadBlock],
    machine: &Machine,
    part: &PartBody,
    points: &ProofPoints,
    job: &Job,
    progress: &Progress<'_>,
) -> Result<Proof, StageError> {
    let motions = motions_of(blocks, machine, part, job);
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
    Ok(summary(&left, &hit, &points.weights, job))
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

fn summary(left: &[f64], hit: &[f64], weights: &[f64], job: &Job) -> Proof {
    let total: f64 = weights.iter().sum();
    let share = |keep: &dyn Fn(f64) -> bool| {
        left.iter().zip(weights).filter(|(l, _)| keep(**l)).map(|(_, w)| w).sum::<f64>() / total
    };
    let mut order: Vec<usize> = (0..left.len()).collect();
    order.sort_by(|&a, &b| left[a].total_cmp(&left[b]).then(a.cmp(&b)));
    let mut covered = 0.0;
    let p999 = order.iter().find(|&&i| {
        covered += weights[i];
        covered >= COVERAGE * total
    });
    let capped = |r: f64| r.min(UNTOUCHED);
    let within = job.stock_allowance + job.scallop_height + SCALLOP_SLACK;
    Proof {
        gouge_max: left.iter().zip(hit).fold(0.0, |worst: f64, (l, h)| worst.max(-l.min(*h))),
        scallop_max: left.iter().fold(0.0, |worst: f64, l| worst.max(capped(*l))),
        scallop_p999: p999.map_or(UNTOUCHED, |&i| capped(left[i]).max(0.0)),
        area_within_scallop: share(&|l| l <= within),
        uncut_area: share(&|l| l >= UNTOUCHED),
    }
}

/// What of the job's tolerances a proof breaks; `None` when it passes.
pub fn shortcoming(proof: &Proof, job: &Job) -> Option<String> {
    if proof.gouge_max > job.gouge_tolerance || proof.gouge_max.is_nan() {
        return Some(format!(
            "the swept check of the program finds a gouge of {:.4} mm, tolerance {:.4} mm",
            proof.gouge_max * 1e3,
            job.gouge_tolerance * 1e3
        ));
    }
    if proof.area_within_scallop < COVERAGE || proof.area_within_scallop.is_nan() {
        return Some(format!(
            "the swept check of the program finds {:.3} % of the area within the scallop height of {:.4} mm, {:.1} % wanted ({:.3} % uncut, 99.9 % within {:.4} mm)",
            proof.area_within_scallop * 100.0,
            job.scallop_height * 1e3,
            COVERAGE * 100.0,
            proof.uncut_area * 100.0,
            proof.scallop_p999 * 1e3
        ));
    }
    None
}
