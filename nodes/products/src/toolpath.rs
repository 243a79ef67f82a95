//! A candidate's toolpath: patches, passes, cutter locations.

use nalgebra::{Point3, Vector3};

/// Toolpath of one candidate partition.
#[derive(Clone, Debug, PartialEq)]
pub struct CandidateToolpath {
    /// Place among the job's candidates, 0-based.
    pub index: u32,
    /// Number of candidates of the job.
    pub count: u32,
    /// Number of patches the candidate asked for.
    pub patch_count: u32,
    /// Empty when feasible; otherwise why the candidate cannot meet the job's tolerances.
    pub infeasible_reason: String,
    /// The patches in cutting order; may be empty when infeasible.
    pub patches: Vec<PatchToolpath>,
    /// Share of the surface's area whose leftover is within the scallop height, by the swept check.
    pub area_within_scallop: f64,
    /// Largest depth below the surface by the swept check, m, ≥ 0.
    pub gouge_max: f64,
}

/// One patch: one tool orientation and its passes.
#[derive(Clone, Debug, PartialEq)]
pub struct PatchToolpath {
    /// Patch number in the partition.
    pub patch: u32,
    /// Unit tool axis, tip to spindle, `workpiece` frame; where passes bring their own: that of the first cutter location.
    pub tool_axis: Vector3<f64>,
    /// Unit feed direction of the first pass, `workpiece` frame, perpendicular to the patch's mean normal.
    pub feed_direction: Vector3<f64>,
    /// Largest pseudo-curvature κ* in the patch, 1/m.
    pub pseudo_curvature_max: f64,
    /// Samples in the patch.
    pub sample_count: u32,
    /// Least and largest step-over between neighbouring passes, m.
    pub step_over: [f64; 2],
    /// Surface area of the patch, m².
    pub area: f64,
    /// Feed polylines in cutting order.
    pub passes: Vec<Pass>,
}

/// One polyline cut at feed without leaving the surface.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Pass {
    /// Cutter locations (tool tips), m, `workpiece` frame.
    pub cl: Vec<Point3<f64>>,
    /// Cutter contact point of every cutter location, m.
    pub cc: Vec<Point3<f64>>,
    /// Unit tool axis of every cutter location, tip to spindle; empty: everywhere the patch's.
    pub tool_axes: Vec<Vector3<f64>>,
    /// Height along the tool axis (tip·axis, m) to which the tip lifts after this pass on its way to the next
    /// one of the patch; gouge-free for a straight rapid at that height.
    pub retract_height: f64,
}

impl PatchToolpath {
    /// Whether the tool axis changes along its passes.
    pub fn is_simultaneous(&self) -> bool {
        self.passes.iter().any(|pass| !pass.tool_axes.is_empty())
    }
}
