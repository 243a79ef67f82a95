//! The stage: all candidates on the machine, the quickest feasible one whose program passes its proof.

use crate::MachineParams;
use crate::clearance::PartBody;
use crate::gcode::{self, Header, ProgramText};
use crate::machine_collision::MachineBodies;
use crate::motion::{self, Infeasible, MotionPlan};
use crate::passed_proof::{PassedProof, ProofBench, ReadProgram};
use crate::patch_order::shortest_order;
use crate::placement::place;
use crate::surroundings::Surroundings;
use crate::timing::{Dynamics, ProgramTiming, time_program};
use patchmill_geometry::mesh::TriangleMesh;
use patchmill_kinematics::{Joints, Machine, Mount, PathPoint, with_mount, with_tool_tip};
use patchmill_products::evaluation::{CandidateEvaluation, Evaluation};
use patchmill_products::job::{Job, Placement, Strategy, Tool};
use patchmill_products::stage::{Progress, StageError};
use patchmill_products::toolpath::CandidateToolpath;
use rayon::prelude::*;

/// The machine's URDF cannot be used.
pub const BAD_MACHINE: i32 = 501;
/// The surface or the job is empty or not usable.
pub const BAD_INPUT: i32 = 502;
/// No candidate is feasible.
pub const NONE_FEASIBLE: i32 = 510;
/// No candidate is feasible because the surface lies outside the machine's travel.
pub const OUTSIDE_TRAVEL: i32 = 511;

/// One patch of the chosen program on the machine.
#[derive(Clone, Debug, PartialEq)]
pub struct PatchOnMachine {
    /// Place among the toolpath's patches.
    pub place: usize,
    /// Joint names of the two rotary axes.
    pub rotary_names: [String; 2],
    /// Their positions while the patch is cut, rad.
    pub rotary_positions: [f64; 2],
    /// Time of the patch's moves, the index move before it included, s.
    pub machining_time: f64,
    /// Length cut at feed, m.
    pub cut_length: f64,
}

/// The chosen candidate's program.
#[derive(Clone, Debug, PartialEq)]
pub struct ProvenProgram {
    /// Place of the candidate among the job's.
    pub candidate_index: u32,
    /// Its text and the proof of it.
    pub passed: PassedProof,
    /// Machining time, s.
    pub machining_time: f64,
    /// Length cut at feed, m.
    pub cut_length: f64,
    /// Its patches in cutting order.
    pub patches: Vec<PatchOnMachine>,
    /// Joint names in the order of the trajectory's joints.
    pub joint_names: [String; 5],
    /// Joint motion from the program's first known position, time from there, s.
    pub trajectory: Vec<PathPoint>,
}

/// What machine_interface finds.
#[derive(Clone, Debug, PartialEq)]
pub struct MachineOutput {
    /// All candidates and the choice.
    pub evaluation: Evaluation,
    /// The chosen program; `None` when no candidate is feasible ([`assess`] only).
    pub program: Option<ProvenProgram>,
    /// The machine as used, tool mounted, as URDF text.
    pub machine_urdf: String,
    /// Why there is no program; `None` when there is one.
    pub failure: Option<StageError>,
}

/// The machine of a job: its own URDF, or `default_urdf` where it brings none, the part mounted where the job says.
/// [`Placement::Auto`] needs the toolpaths: the part stays where the URDF has it.
///
/// # Errors
/// [`BAD_MACHINE`] with what the URDF lacks.
pub fn machine_of(job: &Job, default_urdf: &str) -> Result<(Machine, String), StageError> {
    let text = if job.machine_urdf.is_empty() { default_urdf } else { &job.machine_urdf };
    match job.placement {
        Placement::At { xyz, rpy } => mounted_machine(text, &Mount { xyz, rpy }, job),
        Placement::AsDescribed | Placement::Auto => machine_from(text, job),
    }
}

/// The machine that an output was reckoned with, and its URDF text.
///
/// # Errors
/// As [`machine_of`].
pub fn machine_as_used(output: &MachineOutput, job: &Job) -> Result<(Machine, String), StageError> {
    machine_from(&output.machine_urdf, job)
}

fn mounted_machine(text: &str, mount: &Mount, job: &Job) -> Result<(Machine, String), StageError> {
    let mounted = with_mount(text, mount).map_err(|e| StageError::new(BAD_MACHINE, e.to_string()))?;
    machine_from(&mounted, job)
}

fn machine_from(text: &str, job: &Job) -> Result<(Machine, String), StageError> {
    let acceleration = Dynamics::of(job).accelerations;
    let bad = |e: patchmill_kinematics::KinematicsError| StageError::new(BAD_MACHINE, e.to_string());
    let machine = Machine::from_urdf(text, job.tool.length, acceleration).map_err(bad)?;
    let mounted = with_tool_tip(text, job.tool.length, job.tool.cutter.radius()).map_err(bad)?;
    Ok((machine, mounted))
}

/// As [`assess`], but an error when no candidate is feasible.
///
/// # Errors
/// As [`assess`]; [`NONE_FEASIBLE`] with each candidate's reason; [`OUTSIDE_TRAVEL`] when the travel alone is why.
pub fn evaluate(
    toolpaths: &[CandidateToolpath],
    mesh: &TriangleMesh,
    job: &Job,
    params: &MachineParams,
    progress: &Progress<'_>,
) -> Result<MachineOutput, StageError> {
    let output = assess(toolpaths, mesh, job, params, progress)?;
    match output.failure {
        Some(failure) => Err(failure),
        None => Ok(output),
    }
}

/// Plans, writes, reads back and times every candidate's program, proves the quickest (else the next quickest …) and
/// chooses it. Candidates that cannot run or whose proof fails are marked infeasible with the reason.
///
/// # Errors
/// [`BAD_MACHINE`], [`BAD_INPUT`], or superseded.
pub fn assess(
    toolpaths: &[CandidateToolpath],
    mesh: &TriangleMesh,
    job: &Job,
    params: &MachineParams,
    progress: &Progress<'_>,
) -> Result<MachineOutput, StageError> {
    let (machine, machine_urdf) = machine_of(job, &params.default_urdf)?;
    let Some(part) = PartBody::around(mesh) else {
        return Err(StageError::new(BAD_INPUT, "the surface's mesh has no vertices"));
    };
    if toolpaths.is_empty() {
        return Err(StageError::new(BAD_INPUT, "there are no candidate toolpaths to evaluate"));
    }
    let (machine, machine_urdf) = match job.placement {
        Placement::Auto => {
            let mount = place(toolpaths, &machine_urdf, &part, job)?;
            mounted_machine(&machine_urdf, &mount, job)?
        }
        Placement::AsDescribed | Placement::At { .. } => (machine, machine_urdf),
    };
    let zero = machine.zero_offset().map_err(|e| StageError::new(BAD_MACHINE, e.to_string()))?;
    let bodies = MachineBodies::of(&machine_urdf, &machine, &job.tool)?;
    let surroundings = Surroundings::new(bodies, mesh);
    let setting = Setting { machine, zero, part, surroundings, job, max_moves: params.max_moves };
    let mut drafts: Vec<Draft> =
        toolpaths.par_iter().map(|t| setting.draft(t, progress)).collect::<Result<_, _>>()?;
    drafts.sort_by_key(|d| d.evaluation.index);
    (progress.report)(0.5);
    let program = setting.choose(&mut drafts, progress)?;
    (progress.report)(1.0);
    let failure = program.is_none().then(|| no_program(&drafts));
    let evaluation = Evaluation {
        candidates: drafts.into_iter().map(|d| d.evaluation).collect(),
        chosen: program.as_ref().map(|p| p.candidate_index),
    };
    Ok(MachineOutput { evaluation, program, machine_urdf, failure })
}

/// A candidate on the way to its verdict.
struct Draft {
    evaluation: CandidateEvaluation,
    outside_travel: bool,
    /// Given up by path_generation already.
    refused_before: bool,
    written: Option<Written>,
}

struct Written {
    plan: MotionPlan,
    /// Lines of each patch of the plan.
    patch_lines: Vec<std::ops::Range<usize>>,
    program: ReadProgram,
    timing: ProgramTiming,
}

/// What all candidates share.
struct Setting<'a> {
    machine: Machine,
    zero: Joints,
    part: PartBody,
    surroundings: Surroundings<'a>,
    job: &'a Job,
    max_moves: usize,
}

impl Setting<'_> {
    fn draft(&self, toolpath: &CandidateToolpath, progress: &Progress<'_>) -> Result<Draft, StageError> {
        progress.check()?;
        let mut draft = Draft {
            evaluation: CandidateEvaluation {
                index: toolpath.index,
                patch_count: toolpath.patch_count,
                feasible: false,
                reason: toolpath.infeasible_reason.clone(),
                machining_time: 0.0,
                cut_length: 0.0,
                rapid_length: 0.0,
                index_moves: 0,
            },
            outside_travel: false,
            refused_before: !toolpath.infeasible_reason.is_empty(),
            written: None,
        };
        if draft.refused_before {
            return Ok(draft);
        }
        match self.write(toolpath) {
            Ok(written) => {
                let e = &mut draft.evaluation;
                e.feasible = true;
                e.machining_time = written.timing.duration;
                e.cut_length = written.timing.cut_length;
                e.rapid_length = written.timing.rapid_length;
                e.index_moves = written.timing.index_moves;
                draft.written = Some(written);
            }
            Err(why) => {
                draft.evaluation.reason = why.reason;
                draft.outside_travel = why.travel;
            }
        }
        Ok(draft)
    }

    /// The candidate's program; where the least time is asked for, with its patches in the order of the shortest index moves if that is
    /// quicker.
    fn write(&self, toolpath: &CandidateToolpath) -> Result<Written, Infeasible> {
        let given: Vec<usize> = (0..toolpath.patches.len()).collect();
        let written = self.write_in(toolpath, &given);
        if self.job.strategy != Strategy::Fastest {
            return written;
        }
        let order = shortest_order(toolpath, &self.machine, &self.part, self.job);
        if order == given {
            return written;
        }
        match (written, self.write_in(toolpath, &order)) {
            (Ok(given), Ok(ordered)) if given.timing.duration <= ordered.timing.duration => Ok(given),
            (Err(why), Err(_)) => Err(why),
            (Ok(given), Err(_)) => Ok(given),
            (_, Ok(ordered)) => Ok(ordered),
        }
    }

    fn write_in(&self, toolpath: &CandidateToolpath, order: &[usize]) -> Result<Written, Infeasible> {
        let plan = motion::plan(toolpath, order, &self.machine, &self.part, &self.surroundings, self.job)?;
        let (count, most) = (plan.blocks.len(), self.max_moves);
        if count > most {
            let reason =
                format!("its program would have {count} moves: at most {most} (max_moves) are written");
            return Err(Infeasible { reason, travel: false });
        }
        let header = Header {
            comments: self.comments(toolpath, &plan),
            spindle_speed: self.job.spindle_speed,
            feed: self.job.feed,
            path_tolerance: self.job.corner_tolerance(),
        };
        let ProgramText { text, patch_lines } = gcode::write(&plan, &self.machine, &self.zero, &header);
        let unread = |e| Infeasible { reason: format!("its program does not read back: {e}"), travel: false };
        let program = ReadProgram::new(text, &self.machine, &self.zero, self.max_moves).map_err(unread)?;
        let blocks = program.blocks();
        if let Some((b, v)) = blocks.iter().find_map(|b| self.machine.violation(&b.joints).map(|v| (b, v)))
            && v.excess() > 1e-6
        {
            let reason = format!("outside the machine's travel: {v} in line {} of the program", b.line);
            return Err(Infeasible { reason, travel: true });
        }
        if let Some(reason) = self.surroundings.touch(blocks) {
            return Err(Infeasible { reason, travel: false });
        }
        let timing = time_program(blocks, &self.machine, &Dynamics::of(self.job).control);
        Ok(Written { plan, patch_lines, program, timing })
    }

    /// The program's comment header.
    fn comments(&self, toolpath: &CandidateToolpath, plan: &MotionPlan) -> Vec<String> {
        let (job, tool) = (self.job, &self.job.tool);
        let start = match plan.raise {
            Some((axis, _)) => format!(
                "start: from any position from which {} can go to its end away from the part, as the first motion does",
                self.machine.axes()[axis].letter
            ),
            None => "start: from a position well above the part, the first rapid moves all axes together"
                .to_owned(),
        };
        let mut comments = vec![
            format!(
                "patchmill: {}-axis finishing program",
                if plan.simultaneous { "5" } else { "3 1/2 1/2" }
            ),
            format!("job {}", job.job_id),
            format!("surface {}", job.surface_id),
            format!(
                "tool T1: r1 {:.3} r2 {:.3} length {:.3} mm{}",
                tool.cutter.r1 * 1e3,
                tool.cutter.r2 * 1e3,
                tool.length * 1e3,
                above_the_cutter(tool)
            ),
            format!("machine {}", self.machine.name()),
            format!(
                "candidate {} of {}: {} patches, scallop height {:.4} mm, gouge tolerance {:.4} mm{}",
                toolpath.index + 1,
                toolpath.count,
                plan.patches.len(),
                job.scallop_height * 1e3,
                job.gouge_tolerance * 1e3,
                if job.leaves_rest() { ", what the tool does not fit is left standing" } else { "" }
            ),
            "coordinates: joint values, X0 Y0 Z0 is the workpiece origin with all rotary axes at 0"
                .to_owned(),
            start,
        ];
        let unchecked = &self.surroundings.bodies.unchecked;
        if !unchecked.is_empty() {
            let links = unchecked.join(" ");
            comments.push(format!("collision meshes whose facets are not known were not looked at: {links}"));
        }
        comments
    }

    /// The quickest candidate whose program passes its proof; those that fail it become infeasible.
    fn choose(
        &self,
        drafts: &mut [Draft],
        progress: &Progress<'_>,
    ) -> Result<Option<ProvenProgram>, StageError> {
        let mut order: Vec<usize> = (0..drafts.len()).filter(|&i| drafts[i].written.is_some()).collect();
        if order.is_empty() {
            return Ok(None);
        }
        let time = |i: usize| drafts[i].evaluation.machining_time;
        order.sort_by(|&a, &b| time(a).total_cmp(&time(b)).then(a.cmp(&b)));
        let bench = ProofBench::new(&self.machine, &self.part, &self.surroundings, self.job);
        for place in order {
            progress.check()?;
            let draft = &mut drafts[place];
            let Some(written) = draft.written.take() else { continue };
            let patches = self.patches(&written);
            match PassedProof::of(written.program, &bench, progress)? {
                Ok(passed) => {
                    let name = |i: usize| self.machine.axes()[i].joint_name.clone();
                    return Ok(Some(ProvenProgram {
                        candidate_index: draft.evaluation.index,
                        passed,
                        machining_time: written.timing.duration,
                        cut_length: written.timing.cut_length,
                        patches,
                        joint_names: std::array::from_fn(name),
                        trajectory: written.timing.trajectory,
                    }));
                }
                Err(reason) => {
                    draft.evaluation = CandidateEvaluation {
                        feasible: false,
                        reason,
                        machining_time: 0.0,
                        cut_length: 0.0,
                        rapid_length: 0.0,
                        index_moves: 0,
                        ..draft.evaluation
                    };
                }
            }
        }
        Ok(None)
    }

    fn patches(&self, written: &Written) -> Vec<PatchOnMachine> {
        let (timing, blocks) = (&written.timing, written.program.blocks());
        let mut begin = 0.0;
        let patch = |(pose, lines): (&motion::PatchPose, &std::ops::Range<usize>)| {
            let own: Vec<usize> = (0..blocks.len()).filter(|&i| lines.contains(&blocks[i].line)).collect();
            let end = own.last().map_or(begin, |&i| timing.block_ends[i]);
            let machining_time = end - begin;
            begin = end;
            PatchOnMachine {
                place: pose.place,
                rotary_names: [3, 4].map(|i| self.machine.axes()[i].joint_name.clone()),
                rotary_positions: pose.rotary,
                machining_time,
                cut_length: own.iter().filter(|&&i| !blocks[i].rapid).map(|&i| timing.block_lengths[i]).sum(),
            }
        };
        written.plan.patches.iter().zip(&written.patch_lines).map(patch).collect()
    }
}

/// Flutes, shank and holder for the program's header; nothing for a bare tool.
fn above_the_cutter(tool: &Tool) -> String {
    let mut text = String::new();
    if tool.flute_length > 0.0 {
        text += &format!(" flute {:.3}", tool.flute_length * 1e3);
    }
    if tool.shank_radius > 0.0 {
        text += &format!(" shank d {:.3}", tool.shank_radius * 2e3);
    }
    for section in &tool.holder {
        let [low, high, length] = [section.radius_low * 2e3, section.radius_high * 2e3, section.length * 1e3];
        text += &format!(" holder d {low:.3} to {high:.3} l {length:.3}");
    }
    text
}

/// The error of a job without a feasible candidate.
fn no_program(drafts: &[Draft]) -> StageError {
    let on_machine: Vec<&Draft> = drafts.iter().filter(|d| !d.refused_before).collect();
    if let Some(first) = on_machine.first()
        && on_machine.iter().all(|d| d.outside_travel)
    {
        return StageError::new(OUTSIDE_TRAVEL, format!("the surface lies {}", first.evaluation.reason));
    }
    let reasons: Vec<String> = drafts
        .iter()
        .map(|d| format!("{} patches: {}", d.evaluation.patch_count, d.evaluation.reason))
        .collect();
    StageError::new(NONE_FEASIBLE, format!("no candidate is feasible: {}", reasons.join("; ")))
}
