//! Where to mount the part so that the machine's travel suffices.
//!
//! With the rotary axes held, joint values are affine in the tip, and so they are in the mount's translation t:
//! a patch that needs axis j from lⱼ to hⱼ at the described mount needs it from lⱼ + gⱼ·t to hⱼ + gⱼ·t. Keeping a margin m
//! to the travel Lⱼ..Hⱼ on all axes in all patches of all candidates, Lⱼ + m ≤ lⱼ + gⱼ·t and hⱼ + gⱼ·t ≤ Hⱼ − m, is a linear
//! programme. Solved for the least max |tᵢ| with the wanted margin, else for the largest margin. The part may be turned by
//! eighths about the z axis of the link that carries it, and raised, but not sunk into that link.

use crate::clearance::PartBody;
use crate::evaluate::{BAD_INPUT, BAD_MACHINE, OUTSIDE_TRAVEL};
use crate::motion::travel_of;
use crate::timing::Dynamics;
use microlp::{ComparisonOp, OptimizationDirection, Problem, Variable};
use nalgebra::{Matrix3, Point3, Unit, Vector3};
use patchmill_kinematics::{KinematicsError, Machine, Mount, mount_of, with_mount};
use patchmill_products::job::Job;
use patchmill_products::stage::StageError;
use patchmill_products::toolpath::{CandidateToolpath, PatchToolpath};

/// The margin to every end of the travel that is looked for, m.
const WANTED: f64 = 0.005;
/// Less than this is no margin, m.
const LEAST: f64 = 1e-4;
/// Turns of the part that are tried, in this order, degrees.
const TURNS: [f64; 8] = [0.0, 90.0, -90.0, 180.0, 45.0, -45.0, 135.0, -135.0];
/// Farthest that a mount may be shifted, m.
const FAR: f64 = 10.0;
/// A mount's digits, m.
const DIGIT: f64 = 1e-5;

/// What a patch needs of the linear axes.
struct Need {
    /// Least and largest joint value of X, Y, Z at the trial's mount, m.
    ranges: [[f64; 2]; 3],
    /// Change of X, Y, Z (rows) with the mount's translation.
    shift: Matrix3<f64>,
}

/// A mount that keeps all limits for so many candidates.
struct Found {
    candidates: usize,
    margin: f64,
    mount: Mount,
}

/// The mount nearest to the one that `urdf` describes (unturned first) that leaves at least 5 mm to every end of the linear
/// travel for all candidates that path_generation could cut; where there is none, the one for most candidates with most
/// margin. The described one where there is none to cut.
///
/// # Errors
/// [`BAD_MACHINE`] when the part cannot be mounted elsewhere; [`BAD_INPUT`] for passes whose tool axis changes; [`OUTSIDE_TRAVEL`] with what is missing when no mount
/// suffices for any candidate.
pub fn place(
    toolpaths: &[CandidateToolpath],
    urdf: &str,
    part: &PartBody,
    job: &Job,
) -> Result<Mount, StageError> {
    let bad = |e: KinematicsError| StageError::new(BAD_MACHINE, e.to_string());
    let described = mount_of(urdf).map_err(bad)?;
    let toolpaths: Vec<&CandidateToolpath> =
        toolpaths.iter().filter(|t| t.infeasible_reason.is_empty()).collect();
    // Where nothing could be cut no mount helps, and the candidates have reasons of their own.
    if toolpaths.is_empty() {
        return Ok(described);
    }
    if toolpaths.iter().any(|t| t.patches.iter().any(PatchToolpath::is_simultaneous)) {
        let text = "a mount is looked for with fixed tool axes only; give one for five axes moving at once";
        return Err(StageError::new(BAD_INPUT, text));
    }
    let mut best: Option<Found> = None;
    let (mut missing, mut reached) = (f64::NEG_INFINITY, false);
    for turn in TURNS {
        let mut mount = described;
        mount.rpy[2] += turn.to_radians();
        let trial = Trial::new(urdf, mount, part, job).map_err(bad)?;
        let needs: Vec<Vec<Need>> =
            toolpaths.iter().filter_map(|t| trial.needs(t)).filter(|needs| !needs.is_empty()).collect();
        let most = needs.len();
        reached |= most > 0;
        if let Some(found) = trial.best(&needs, &mut missing) {
            let done = found.candidates == most && found.margin >= WANTED;
            if best.as_ref().is_none_or(|b| (found.candidates, found.margin) > (b.candidates, b.margin)) {
                best = Some(found);
            }
            if done {
                break;
            }
        }
    }
    best.map(|found| found.mount).ok_or_else(|| {
        let why = if missing.is_finite() {
            format!("the travel is {:.2} mm too short at the best place found", (LEAST - missing) * 1e3)
        } else if reached {
            format!("none within {FAR} m of where the part is described")
        } else {
            "the rotary axes do not reach the tool axes of any candidate".to_owned()
        };
        StageError::new(OUTSIDE_TRAVEL, format!("no mount of the part keeps the machine's limits: {why}"))
    })
}

/// The machine with the part at one mount.
struct Trial<'a> {
    mount: Mount,
    machine: Machine,
    /// The part 1 m farther along x, y, z of the link that carries it.
    shifted: [Machine; 3],
    travel: [[f64; 2]; 3],
    part: &'a PartBody,
    job: &'a Job,
}

impl<'a> Trial<'a> {
    fn new(urdf: &str, mount: Mount, part: &'a PartBody, job: &'a Job) -> Result<Self, KinematicsError> {
        let acceleration = Dynamics::of(job).accelerations;
        let at = |mount: &Mount| Machine::from_urdf(&with_mount(urdf, mount)?, job.tool.length, acceleration);
        let machine = at(&mount)?;
        let beside = |i: usize| {
            let mut moved = mount;
            moved.xyz[i] += 1.0;
            at(&moved)
        };
        let shifted = [beside(0)?, beside(1)?, beside(2)?];
        let travel =
            std::array::from_fn(|i| machine.axes()[i].limits.unwrap_or([f64::NEG_INFINITY, f64::INFINITY]));
        Ok(Self { mount, machine, shifted, travel, part, job })
    }

    /// The needs of a candidate's patches; `None` where the rotary axes do not reach one.
    fn needs(&self, toolpath: &CandidateToolpath) -> Option<Vec<Need>> {
        let mut near = [0.0; 2];
        let mut needs = Vec::new();
        for patch in &toolpath.patches {
            let axis = Unit::try_new(patch.tool_axis, 1e-9)?;
            near = self.machine.orientations(&axis, near).ok()?.first()?.rotary;
            let held = self.machine.at_rotary(near).ok()?;
            let Some(ranges) = travel_of(patch, &held, self.part, self.job.clearance) else { continue };
            let here = held.joints(&Point3::origin());
            let mut shift = Matrix3::zeros();
            for (i, machine) in self.shifted.iter().enumerate() {
                let there = machine.at_rotary(near).ok()?.joints(&Point3::origin());
                shift.set_column(i, &Vector3::from_fn(|j, _| there[j] - here[j]));
            }
            needs.push(Need { ranges: [ranges[0], ranges[1], ranges[2]], shift });
        }
        Some(needs)
    }

    /// The best mount for as many of the candidates as possible; raises `missing` to the largest margin seen.
    fn best(&self, candidates: &[Vec<Need>], missing: &mut f64) -> Option<Found> {
        let alone = |needs: &Vec<Need>| self.widest(needs.iter()).map_or(f64::NEG_INFINITY, |(m, _)| m);
        let margins: Vec<f64> = candidates.iter().map(alone).collect();
        *missing = margins.iter().fold(*missing, |a, b| a.max(*b));
        let mut order: Vec<usize> = (0..candidates.len()).collect();
        order.sort_by(|a, b| margins[*b].total_cmp(&margins[*a]));
        for count in (1..=order.len()).rev() {
            let needs = || order[..count].iter().flat_map(|i| candidates[*i].iter());
            let found = match self.nearest(needs()) {
                Some(shift) => Some((WANTED, shift)),
                None => self.widest(needs()),
            };
            if let Some((margin, shift)) = found.filter(|(margin, _)| *margin >= LEAST) {
                let mut mount = self.mount;
                for (place, way) in mount.xyz.iter_mut().zip(shift.iter()) {
                    *place += (way / DIGIT).round() * DIGIT;
                }
                return Some(Found { candidates: count, margin, mount });
            }
        }
        None
    }

    /// Largest margin to all ends of the travel, and the shift of the mount that gives it, m.
    fn widest<'n>(&self, needs: impl Iterator<Item = &'n Need>) -> Option<(f64, Vector3<f64>)> {
        let mut problem = Problem::new(OptimizationDirection::Maximize);
        let margin = problem.add_var(1.0, (-FAR, FAR));
        let t = translation(&mut problem);
        self.keep(&mut problem, needs, &t, Some(margin));
        let solution = problem.solve().ok()?.into_solution().ok()?;
        Some((solution[margin], Vector3::from_fn(|i, _| solution[t[i]])))
    }

    /// The smallest shift of the mount with the wanted margin, m.
    fn nearest<'n>(&self, needs: impl Iterator<Item = &'n Need>) -> Option<Vector3<f64>> {
        let mut problem = Problem::new(OptimizationDirection::Minimize);
        let most = problem.add_var(1.0, (0.0, FAR));
        let t = translation(&mut problem);
        for way in t {
            problem.add_constraint([(way, 1.0), (most, -1.0)], ComparisonOp::Le, 0.0);
            problem.add_constraint([(way, 1.0), (most, 1.0)], ComparisonOp::Ge, 0.0);
        }
        self.keep(&mut problem, needs, &t, None);
        let solution = problem.solve().ok()?.into_solution().ok()?;
        Some(Vector3::from_fn(|i, _| solution[t[i]]))
    }

    /// Adds the limits with the margin that is sought, or with the wanted one.
    fn keep<'n>(
        &self,
        problem: &mut Problem,
        needs: impl Iterator<Item = &'n Need>,
        t: &[Variable; 3],
        margin: Option<Variable>,
    ) {
        let fixed = if margin.is_some() { 0.0 } else { WANTED };
        for need in needs {
            for ((range, travel), row) in need.ranges.iter().zip(&self.travel).zip(need.shift.row_iter()) {
                let terms = |sign: f64| {
                    let ways = t.iter().zip(row.iter()).map(|(v, g)| (*v, *g));
                    ways.chain(margin.map(|m| (m, sign))).collect::<Vec<_>>()
                };
                if travel[0].is_finite() {
                    problem.add_constraint(terms(-1.0), ComparisonOp::Ge, travel[0] + fixed - range[0]);
                }
                if travel[1].is_finite() {
                    problem.add_constraint(terms(1.0), ComparisonOp::Le, travel[1] - fixed - range[1]);
                }
            }
        }
    }
}

/// The mount's translation along x, y, z of the link that carries the part; never into it.
fn translation(problem: &mut Problem) -> [Variable; 3] {
    [(-FAR, FAR), (-FAR, FAR), (0.0, FAR)].map(|bounds| problem.add_var(0.0, bounds))
}
