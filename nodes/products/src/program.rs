//! The program of the chosen candidate, as text and as joint motion.

use nalgebra::Vector3;

use crate::evaluation::Proof;
use crate::toolpath::PatchToolpath;

/// A proven program with what is known of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Program {
    /// Text of the program, RS-274.
    pub text: String,
    /// Lines with a motion.
    pub block_count: u32,
    /// Place of its candidate among the job's candidates, 0-based.
    pub candidate_index: u32,
    /// Machining time, s.
    pub machining_time: f64,
    /// Length cut at feed, m.
    pub cut_length: f64,
    /// What the swept check found.
    pub proof: Proof,
    /// The patches in cutting order.
    pub patches: Vec<PatchProgram>,
    /// The machine as used, tool mounted, as URDF text.
    pub machine_urdf: String,
}

/// One patch of a program on the machine.
#[derive(Clone, Debug, PartialEq)]
pub struct PatchProgram {
    /// The patch without its passes.
    pub plan: PatchPlan,
    /// Joint names of the two rotary axes, base of the chain first.
    pub rotary_names: [String; 2],
    /// Their positions while the patch is cut, rad.
    pub rotary_positions: [f64; 2],
    /// Time of its feed and rapid moves, the index move before it included, s.
    pub machining_time: f64,
    /// Length cut at feed, m.
    pub cut_length: f64,
}

/// A [`PatchToolpath`] without its passes; fields as there.
#[derive(Clone, Debug, PartialEq)]
pub struct PatchPlan {
    /// Patch number in the partition.
    pub patch: u32,
    /// Unit tool axis, tip to spindle, `workpiece` frame.
    pub tool_axis: Vector3<f64>,
    /// Unit feed direction of the first pass, `workpiece` frame.
    pub feed_direction: Vector3<f64>,
    /// Largest pseudo-curvature κ* in the patch, 1/m.
    pub pseudo_curvature_max: f64,
    /// Samples in the patch.
    pub sample_count: u32,
    /// Least and largest step-over between neighbouring passes, m.
    pub step_over: [f64; 2],
    /// Surface area of the patch, m².
    pub area: f64,
    /// Number of passes.
    pub pass_count: u32,
}

impl From<&PatchToolpath> for PatchPlan {
    fn from(patch: &PatchToolpath) -> Self {
        Self {
            patch: patch.patch,
            tool_axis: patch.tool_axis,
            feed_direction: patch.feed_direction,
            pseudo_curvature_max: patch.pseudo_curvature_max,
            sample_count: patch.sample_count,
            step_over: patch.step_over,
            area: patch.area,
            pass_count: patch.passes.len() as u32,
        }
    }
}

/// The program as motion of the joints. With `n` joints, `positions` and `velocities` hold `n` values a point.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct JointMotion {
    /// Names of the joints.
    pub joint_names: Vec<String>,
    /// Time of every point from the program's start, s; never decreasing. Travels in nanoseconds.
    pub times: Vec<f64>,
    /// Joint positions, m or rad, point after point.
    pub positions: Vec<f64>,
    /// Joint velocities, m/s or rad/s, point after point.
    pub velocities: Vec<f64>,
}
