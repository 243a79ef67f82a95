//! A candidate's toolpath as joint motion: rotary positions of the patches, approach, passes, links, index moves.
//!
//! * Rotary positions: the solution nearest to the one before it whose every point lies within the travel.
//! * A pass begins with a rapid down the tool axis to 2 mm above its first cutter location, the rest at feed.
//! * Between passes the tool lifts along its axis to the height that the path gives, crosses, and comes down.
//! * Between orientations it lifts clear of the part, and the axes turn only on a way on which the tool keeps its
//!   distance from the part's convex body at every intermediate position.
//! * Passes whose tool axis changes are followed by all five axes ([`crate::simultaneous`]); from one piece to the next the
//!   machine goes as from one orientation to another.
//! * Rotary solutions and index moves on which links of the machine touch are left out.
//!
//! Two positions within all limits have only legal positions between them, as rapids move all axes in proportion.

use crate::clearance::{PartBody, ToolBody};
use crate::simultaneous;
use crate::surroundings::Surroundings;
use nalgebra::{Point3, Unit, Vector3};
use patchmill_kinematics::{
    AxisKind, Control, FixedOrientation, Joints, KinematicsError, Machine, rapid_run,
};
use patchmill_products::job::Job;
use patchmill_products::toolpath::{CandidateToolpath, PatchToolpath};

/// Rapids end this far above a cutter location, m; the rest is fed.
const PLUNGE: f64 = 0.002;
/// Free rapids stay this far from the ends of the travel, m.
const END_MARGIN: f64 = 0.001;
/// How far above the safe height index moves are tried, m.
const LIFTS: [f64; 8] = [0.0, 0.01, 0.02, 0.04, 0.07, 0.11, 0.16, 0.25];
/// Smallest step of a rotary word in a program, degrees.
const ROTARY_DIGIT: f64 = 1e-5;

/// One straight move of all axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Block {
    /// Rapid or at the job's feed.
    pub rapid: bool,
    /// Joint values at its end, m and rad.
    pub joints: Joints,
    /// Place of its patch in [`MotionPlan::patches`]; an index move belongs to the patch that it leads to.
    pub patch: usize,
}

/// A patch on the machine.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PatchPose {
    /// Place among the toolpath's patches.
    pub place: usize,
    /// Joint values of the two rotary axes, rad, whole steps of a program's last digit; where they move while the patch is
    /// cut: at its start.
    pub rotary: [f64; 2],
    /// The tool is parallel to a rotary axis, which kept its position.
    pub singular: bool,
}

/// A candidate as joint motion.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MotionPlan {
    /// Before anything else, this linear axis (place in the machine's axes) goes to this joint value (m): away from
    /// the part, wherever the machine stands.
    pub raise: Option<(usize, f64)>,
    /// The moves.
    pub blocks: Vec<Block>,
    /// The patches in cutting order.
    pub patches: Vec<PatchPose>,
    /// The rotary axes move at feed.
    pub simultaneous: bool,
}

/// Why a candidate cannot run on the machine.
#[derive(Clone, Debug, PartialEq)]
pub struct Infeasible {
    /// For a person to read.
    pub reason: String,
    /// It needs more travel than the machine has.
    pub travel: bool,
}

impl Infeasible {
    fn because(reason: String) -> Self {
        Self { reason, travel: false }
    }
}

/// Plans the motion of one candidate, its patches in `order`: places among the toolpath's, each once.
///
/// # Errors
/// [`Infeasible`] with the axis, its need and its travel, or what else stands in the way.
pub fn plan(
    toolpath: &CandidateToolpath,
    order: &[usize],
    machine: &Machine,
    part: &PartBody,
    surroundings: &Surroundings<'_>,
    job: &Job,
) -> Result<MotionPlan, Infeasible> {
    let tool = ToolBody::of(&job.tool);
    let plan = MotionPlan::default();
    let mut planner = Planner { machine, part, surroundings, tool, job, plan, at: None };
    for (place, patch) in order.iter().map(|&place| (place, &toolpath.patches[place])) {
        if patch.is_simultaneous() {
            planner.add_simultaneous(place, patch)?;
        } else if patch.passes.iter().any(|p| !p.cl.is_empty()) {
            planner.add_patch(place, patch)?;
        }
    }
    planner.finish()
}

/// Where the tool is after a patch.
struct Station {
    held: FixedOrientation,
    tip: Point3<f64>,
}

struct Planner<'a> {
    machine: &'a Machine,
    part: &'a PartBody,
    surroundings: &'a Surroundings<'a>,
    tool: ToolBody,
    job: &'a Job,
    plan: MotionPlan,
    at: Option<Station>,
}

impl Planner<'_> {
    fn add_patch(&mut self, place: usize, patch: &PatchToolpath) -> Result<(), Infeasible> {
        let pose = self.choose_pose(place, patch)?;
        let held = self.hold(pose.rotary)?;
        let number = self.plan.patches.len();
        self.plan.patches.push(pose);
        let moves = pass_moves(patch, &held.axis());
        let Some((start, end)) = moves.first().zip(moves.last()).map(|(s, e)| (s.tip, e.tip)) else {
            return Ok(());
        };
        let there = Station { held, tip: start };
        for joints in self.way_to(&there, number)? {
            self.plan.blocks.push(Block { rapid: true, joints, patch: number });
        }
        let on = |m: &TipMove| Block { rapid: m.rapid, joints: there.held.joints(&m.tip), patch: number };
        self.plan.blocks.extend(moves.iter().map(on));
        self.at = Some(Station { tip: end, ..there });
        Ok(())
    }

    /// All passes of a patch whose tool axis changes along them.
    fn add_simultaneous(&mut self, place: usize, patch: &PatchToolpath) -> Result<(), Infeasible> {
        let number = self.plan.patches.len();
        self.plan.simultaneous = true;
        for (count, pass) in patch.passes.iter().enumerate() {
            let near = self.plan.blocks.last().map_or([0.0, 0.0], |b| [b.joints[3], b.joints[4]]);
            let pieces = simultaneous::follow(self.machine, pass, near).map_err(|blocked| Infeasible {
                reason: format!(
                    "{}patch {}, pass {}: {}",
                    if blocked.travel { "outside the machine's travel: " } else { "" },
                    place + 1,
                    count + 1,
                    blocked.reason
                ),
                travel: blocked.travel,
            })?;
            for piece in pieces {
                self.add_piece(place, &piece, number)?;
            }
        }
        Ok(())
    }

    /// Comes to a piece from wherever the machine is, and follows it.
    fn add_piece(
        &mut self,
        place: usize,
        piece: &[simultaneous::Station],
        number: usize,
    ) -> Result<(), Infeasible> {
        let Some((first, last)) = piece.first().zip(piece.last()) else { return Ok(()) };
        let rotary = |joints: &Joints| [joints[3], joints[4]];
        let there = Station { held: self.hold(rotary(&first.joints))?, tip: first.tip };
        if number == self.plan.patches.len() {
            self.plan.patches.push(PatchPose { place, rotary: rotary(&first.joints), singular: false });
        }
        let mut rapids = self.way_to(&there, number)?;
        rapids.push(there.held.joints(&(first.tip + there.held.axis().into_inner() * PLUNGE)));
        let on = |rapid| move |joints| Block { rapid, joints, patch: number };
        self.plan.blocks.extend(rapids.into_iter().map(on(true)));
        self.plan.blocks.extend(piece.iter().map(|station| station.joints).map(on(false)));
        self.at = Some(Station { held: self.hold(rotary(&last.joints))?, tip: last.tip });
        Ok(())
    }

    /// Lifts the tool off the part at the end.
    fn finish(mut self) -> Result<MotionPlan, Infeasible> {
        let Some(last) = self.at.take() else {
            return Err(Infeasible::because("the toolpath has no passes".to_owned()));
        };
        let joints = last.held.joints(&self.lifted(&last, 0.0));
        self.plan.blocks.push(Block { rapid: true, joints, patch: self.plan.patches.len() - 1 });
        Ok(self.plan)
    }

    fn hold(&self, rotary: [f64; 2]) -> Result<FixedOrientation, Infeasible> {
        self.machine.at_rotary(rotary).map_err(|e| Infeasible::because(e.to_string()))
    }

    /// The rotary solution nearest to the machine's last position with every point of the patch in the travel.
    fn choose_pose(&self, place: usize, patch: &PatchToolpath) -> Result<PatchPose, Infeasible> {
        let near = self.plan.patches.last().map_or([0.0, 0.0], |p| p.rotary);
        let blocked = |why: String, travel| Infeasible {
            reason: format!(
                "{}patch {}: {why}",
                if travel { "outside the machine's travel: " } else { "" },
                place + 1
            ),
            travel,
        };
        let Some(axis) = Unit::try_new(patch.tool_axis, 1e-9) else {
            return Err(blocked("its tool axis is zero".to_owned(), false));
        };
        let found = self.machine.orientations(&axis, near).map_err(|e| match e {
            KinematicsError::Limit(violation) => blocked(violation.to_string(), true),
            other => blocked(other.to_string(), false),
        })?;
        let mut least: Option<(f64, String)> = None;
        let mut collision: Option<String> = None;
        for orientation in found {
            let rotary = self.in_program_digits(orientation.rotary);
            let held = self.hold(rotary)?;
            let Some(needed) = self.needed_travel(patch, &held) else {
                if let Some(who) = self.touch_at_ends(patch, &held) {
                    collision.get_or_insert(who);
                    continue;
                }
                return Ok(PatchPose { place, rotary, singular: orientation.singular });
            };
            if least.as_ref().is_none_or(|(excess, _)| needed.0 < *excess) {
                least = Some(needed);
            }
        }
        if let Some(who) = collision {
            return Err(blocked(format!("the machine would collide: {who}"), false));
        }
        Err(blocked(least.map_or_else(String::new, |(_, why)| why), true))
    }

    /// Which links touch at the ends of a patch's passes; the whole program is looked at when it is written.
    fn touch_at_ends(&self, patch: &PatchToolpath, held: &FixedOrientation) -> Option<String> {
        let ends = patch.passes.iter().flat_map(|pass| pass.cl.first().into_iter().chain(pass.cl.last()));
        let mut touches = ends.filter_map(|tip| self.surroundings.touch_at(&held.joints(tip)));
        touches.next()
    }

    /// Rounded to a program's last digit, inside the limits.
    fn in_program_digits(&self, rotary: [f64; 2]) -> [f64; 2] {
        std::array::from_fn(|i| {
            let steps = (rotary[i].to_degrees() / ROTARY_DIGIT).round();
            let within = |steps: f64| {
                let value = (steps * ROTARY_DIGIT).to_radians();
                self.machine.axes()[3 + i].limits.is_none_or(|[l, u]| l <= value && value <= u)
            };
            let steps = [steps, steps + 1.0, steps - 1.0].into_iter().find(|s| within(*s)).unwrap_or(steps);
            (steps * ROTARY_DIGIT).to_radians()
        })
    }

    /// The axis farthest out of its travel anywhere in the patch: how far, and what it needs and has. `None` when
    /// all points lie within.
    fn needed_travel(&self, patch: &PatchToolpath, held: &FixedOrientation) -> Option<(f64, String)> {
        let ranges = travel_of(patch, held, self.part, self.job.clearance)?;
        let worst = [0, 1]
            .into_iter()
            .filter_map(|end| self.machine.violation(&ranges.map(|range| range[end])))
            .max_by(|a, b| a.excess().total_cmp(&b.excess()))?;
        let [low, high] = ranges[worst.axis];
        let (scale, unit) = match worst.kind {
            AxisKind::Linear => (1e3, "mm"),
            AxisKind::Rotary => (1f64.to_degrees(), "°"),
        };
        let text = format!(
            "axis {} needs {:.2}..{:.2} {unit}, has {:.2}..{:.2} {unit} ({:.2} {unit} too far)",
            worst.letter,
            low * scale,
            high * scale,
            worst.limits[0] * scale,
            worst.limits[1] * scale,
            worst.excess() * scale
        );
        Some((worst.excess(), text))
    }

    /// The station's tip raised along the tool axis to the part's top in that direction plus the job's clearance
    /// plus `more` (m).
    fn lifted(&self, station: &Station, more: f64) -> Point3<f64> {
        let axis = station.held.axis().into_inner();
        let level = self.part.extent(&axis) + self.job.clearance + more;
        raised(&station.tip, &axis, level)
    }

    /// Rapid positions from where the machine is to above a patch's first cutter location.
    fn way_to(&mut self, there: &Station, number: usize) -> Result<Vec<Joints>, Infeasible> {
        let Some(here) = &self.at else { return Ok(self.first_way(there)) };
        let limits = self.machine.limits(&Control::default());
        let from = here.held.joints(&here.tip);
        let mut ways: Vec<Vec<Joints>> = LIFTS
            .iter()
            .map(|&more| {
                vec![here.held.joints(&self.lifted(here, more)), there.held.joints(&self.lifted(there, more))]
            })
            .collect();
        if let Some((axis, top)) = self.away() {
            let (up, down) = (ways[0][0], ways[0][1]);
            let at_top = |mut q: Joints| {
                q[axis] = top;
                q
            };
            ways.push(vec![up, at_top(up), at_top(down), down]);
        }
        let mut timed: Vec<(f64, Vec<Joints>)> = ways
            .into_iter()
            .filter(|way| way.iter().all(|q| self.machine.violation(q).is_none()))
            .map(|way| {
                let points: Vec<Joints> = std::iter::once(from).chain(way.iter().copied()).collect();
                (rapid_run(&points, &limits).time(&limits).duration, way)
            })
            .collect();
        timed.sort_by(|a, b| a.0.total_cmp(&b.0));
        timed.into_iter().map(|(_, way)| way).find(|way| self.clear(way)).ok_or_else(|| {
            Infeasible::because(format!(
                "no clear way to turn from patch {number} to patch {}: within the travel the tool cannot be lifted far enough from the part",
                number + 1
            ))
        })
    }

    /// The way of the program's first moves; the machine may stand anywhere.
    fn first_way(&mut self, there: &Station) -> Vec<Joints> {
        let above = there.held.joints(&self.lifted(there, 0.0));
        let Some((axis, top)) = self.away() else { return vec![above] };
        let mut at_top = above;
        at_top[axis] = top;
        if self.machine.violation(&at_top).is_some() || !self.clear(&[at_top, above]) {
            return vec![above];
        }
        self.plan.raise = Some((axis, top));
        vec![at_top, above]
    }

    fn clear(&self, way: &[Joints]) -> bool {
        let margin = (0.5 * self.job.clearance).clamp(0.0005, 0.005);
        way.windows(2).all(|w| {
            self.part.clears(self.machine, &w[0], &w[1], &self.tool, margin)
                && self.surroundings.clears(&w[0], &w[1])
        })
    }

    /// The linear axis that moves the tool most nearly along itself, and its end away from the part.
    fn away(&self) -> Option<(usize, f64)> {
        let home = self.machine.pose(&[0.0; 5]);
        let along = |i: usize| {
            let mut q = [0.0; 5];
            q[i] = 1.0;
            (self.machine.pose(&q).tip - home.tip).dot(&home.axis)
        };
        let axis = (0..3).max_by(|a, b| along(*a).abs().total_cmp(&along(*b).abs()))?;
        let [low, high] = self.machine.axes()[axis].limits?;
        let end = if along(axis) > 0.0 { high - END_MARGIN } else { low + END_MARGIN };
        (end.is_finite() && along(axis).abs() > 0.9).then_some((axis, end))
    }
}

/// Least and largest joint values (m, rad) at which the tool cuts a patch, comes to it and leaves it clear of the part;
/// `None` for a patch without passes.
pub(crate) fn travel_of(
    patch: &PatchToolpath,
    held: &FixedOrientation,
    part: &PartBody,
    clearance: f64,
) -> Option<[[f64; 2]; 5]> {
    let moves = pass_moves(patch, &held.axis());
    let clear = ends_of(patch, held, part, clearance)?;
    let mut ranges = [[f64::INFINITY, f64::NEG_INFINITY]; 5];
    for tip in moves.iter().map(|m| &m.tip).chain(&clear) {
        for (range, q) in ranges.iter_mut().zip(held.joints(tip)) {
            *range = [range[0].min(q), range[1].max(q)];
        }
    }
    Some(ranges)
}

/// Where the tool comes to a patch and leaves it, clear of the part (tip, `workpiece` frame, m); `None` for a patch without passes.
pub(crate) fn ends_of(
    patch: &PatchToolpath,
    held: &FixedOrientation,
    part: &PartBody,
    clearance: f64,
) -> Option<[Point3<f64>; 2]> {
    let axis = held.axis();
    let first = patch.passes.iter().find_map(|pass| pass.cl.first())?;
    let last = patch.passes.iter().rev().find_map(|pass| pass.cl.last())?;
    let level = part.extent(&axis) + clearance;
    let plunge = first + axis.into_inner() * PLUNGE;
    Some([raised(&plunge, &axis, level), raised(last, &axis, level)])
}

/// One move of the tip within a patch.
struct TipMove {
    rapid: bool,
    tip: Point3<f64>,
}

/// `tip` raised along the axis to the height `level` (tip·axis, m), never lowered.
fn raised(tip: &Point3<f64>, axis: &Vector3<f64>, level: f64) -> Point3<f64> {
    tip + axis * (level - tip.coords.dot(axis)).max(0.0)
}

/// Moves of a patch from above its first cutter location to its last one.
fn pass_moves(patch: &PatchToolpath, axis: &Unit<Vector3<f64>>) -> Vec<TipMove> {
    let axis = axis.as_ref();
    let mut moves: Vec<TipMove> = Vec::new();
    let mut retract = f64::NEG_INFINITY;
    for pass in &patch.passes {
        let Some(start) = pass.cl.first() else { continue };
        let joined = moves.last().is_some_and(|m| (m.tip - start).norm() < 1e-9);
        if !joined {
            let plunge = start + axis * PLUNGE;
            if let Some(end) = moves.last().map(|m| m.tip) {
                let level = retract.max((end.coords.dot(axis)).max(start.coords.dot(axis)) + PLUNGE);
                moves.push(TipMove { rapid: true, tip: raised(&end, axis, level) });
                moves.push(TipMove { rapid: true, tip: raised(start, axis, level) });
            }
            if moves.last().is_none_or(|m| (m.tip - plunge).norm() > 1e-9) {
                moves.push(TipMove { rapid: true, tip: plunge });
            }
            moves.push(TipMove { rapid: false, tip: *start });
        }
        moves.extend(pass.cl.iter().skip(1).map(|tip| TipMove { rapid: false, tip: *tip }));
        retract = pass.retract_height;
    }
    moves
}
