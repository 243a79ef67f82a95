//! What a replay compares and how closely: the one table.
//!
//! A stage on the same processor gives the same bits; the tolerances leave room for another processor's mathematics.
//! Stamps are not compared: a replay is a new run of the job.

use std::fmt;

/// How closely a field has to come.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Tolerance {
    /// The same.
    Exact,
    /// At most so far away, in the unit (empty: none).
    Within(f64, &'static str),
    /// At most this share of the larger magnitude away.
    Share(f64),
}

impl fmt::Display for Tolerance {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Exact => f.write_str("exact"),
            Self::Within(most, "") => write!(f, "{most:e}"),
            Self::Within(most, unit) => write!(f, "{most:e} {unit}"),
            Self::Share(most) => write!(f, "{most:e} of it"),
        }
    }
}

/// One line of the table.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rule {
    /// The product's topic.
    pub product: &'static str,
    /// The field, dotted where it is inside another one.
    pub field: &'static str,
    /// How closely it has to come.
    pub tolerance: Tolerance,
}

/// Product `surface/mesh`.
pub const MESH: &str = "surface/mesh";
/// Product `surface/samples`.
pub const SAMPLES: &str = "surface/samples";
/// Product `analysis/rolling_ball_field`.
pub const FIELD: &str = "analysis/rolling_ball_field";
/// Product `partition/candidates`.
pub const PARTITION: &str = "partition/candidates";
/// Product `toolpath/candidates`.
pub const TOOLPATH: &str = "toolpath/candidates";
/// Product `machine/evaluation`.
pub const EVALUATION: &str = "machine/evaluation";
/// Product `machine/program`.
pub const PROGRAM: &str = "machine/program";
/// Product `machine/joint_trajectory`.
pub const MOTION: &str = "machine/joint_trajectory";
/// Product `machine/residual_map`.
pub const RESIDUAL: &str = "machine/residual_map";
/// Product `machine/model`.
pub const MACHINE: &str = "machine/model";
/// Product `robot_description`.
pub const ROBOT_DESCRIPTION: &str = "robot_description";
/// The last status of a stage.
pub const STATUS: &str = "status";

const LENGTH: Tolerance = Tolerance::Within(1e-9, "m");
/// Sums over a whole program.
const LONG: Tolerance = Tolerance::Within(1e-6, "m");
const AREA: Tolerance = Tolerance::Within(1e-12, "m²");
const CURVATURE: Tolerance = Tolerance::Within(1e-6, "1/m");
const DIRECTION: Tolerance = Tolerance::Within(1e-9, "");
const NUMBER: Tolerance = Tolerance::Within(1e-9, "");
const TIME: Tolerance = Tolerance::Within(1e-6, "s");
const EXACT: Tolerance = Tolerance::Exact;

const fn rule(product: &'static str, field: &'static str, tolerance: Tolerance) -> Rule {
    Rule { product, field, tolerance }
}

/// Every field that is compared, in the order of the data flow.
pub const RULES: &[Rule] = &[
    rule(MESH, "surface_id", EXACT),
    rule(MESH, "vertices", LENGTH),
    rule(MESH, "normals", DIRECTION),
    rule(MESH, "triangles", EXACT),
    rule(MESH, "check_only", EXACT),
    rule(MESH, "chord_error", LENGTH),
    rule(SAMPLES, "grid", EXACT),
    rule(SAMPLES, "points", LENGTH),
    rule(SAMPLES, "normals", DIRECTION),
    rule(SAMPLES, "curvature_max", CURVATURE),
    rule(SAMPLES, "curvature_min", CURVATURE),
    rule(SAMPLES, "direction_max", Tolerance::Within(1e-6, "")),
    rule(SAMPLES, "area", AREA),
    rule(FIELD, "pseudo_curvature", CURVATURE),
    rule(FIELD, "contact", LENGTH),
    rule(FIELD, "shadow_radius", LENGTH),
    rule(PARTITION, "count", EXACT),
    rule(PARTITION, "feature_mean", Tolerance::Share(1e-9)),
    rule(PARTITION, "feature_scale", Tolerance::Share(1e-9)),
    rule(PARTITION, "labels", EXACT),
    rule(PARTITION, "patches.mean", NUMBER),
    rule(PARTITION, "patches.covariance", NUMBER),
    rule(PARTITION, "patches.sample_count", EXACT),
    rule(PARTITION, "patches.parts", EXACT),
    rule(PARTITION, "inertia", Tolerance::Share(1e-9)),
    rule(TOOLPATH, "count", EXACT),
    rule(TOOLPATH, "patch_count", EXACT),
    rule(TOOLPATH, "infeasible_reason", EXACT),
    rule(TOOLPATH, "area_within_scallop", NUMBER),
    rule(TOOLPATH, "gouge_max", LENGTH),
    rule(TOOLPATH, "patches.patch", EXACT),
    rule(TOOLPATH, "patches.tool_axis", DIRECTION),
    rule(TOOLPATH, "patches.feed_direction", DIRECTION),
    rule(TOOLPATH, "patches.pseudo_curvature_max", CURVATURE),
    rule(TOOLPATH, "patches.sample_count", EXACT),
    rule(TOOLPATH, "patches.step_over", LENGTH),
    rule(TOOLPATH, "patches.area", AREA),
    rule(TOOLPATH, "patches.pass_count", EXACT),
    rule(TOOLPATH, "passes.cl", LENGTH),
    rule(TOOLPATH, "passes.cc", LENGTH),
    rule(TOOLPATH, "passes.retract_height", LENGTH),
    rule(EVALUATION, "chosen", EXACT),
    rule(EVALUATION, "candidates.patch_count", EXACT),
    rule(EVALUATION, "candidates.feasible", EXACT),
    rule(EVALUATION, "candidates.reason", EXACT),
    rule(EVALUATION, "candidates.machining_time", TIME),
    rule(EVALUATION, "candidates.cut_length", LONG),
    rule(EVALUATION, "candidates.rapid_length", LONG),
    rule(EVALUATION, "candidates.index_moves", EXACT),
    rule(PROGRAM, "text", EXACT),
    rule(PROGRAM, "block_count", EXACT),
    rule(PROGRAM, "candidate_index", EXACT),
    rule(PROGRAM, "machining_time", TIME),
    rule(PROGRAM, "cut_length", LONG),
    rule(PROGRAM, "proof.gouge_max", LENGTH),
    rule(PROGRAM, "proof.scallop_max", LENGTH),
    rule(PROGRAM, "proof.scallop_percentiles", LENGTH),
    rule(PROGRAM, "proof.deepest", LENGTH),
    rule(PROGRAM, "proof.highest", LENGTH),
    rule(PROGRAM, "proof.area_within_scallop", NUMBER),
    rule(PROGRAM, "proof.uncut_area", NUMBER),
    rule(PROGRAM, "proof.rest_area", AREA),
    rule(PROGRAM, "proof.rest", LENGTH),
    rule(PROGRAM, "proof.rest.area", AREA),
    rule(PROGRAM, "patches.patch", EXACT),
    rule(PROGRAM, "patches.tool_axis", DIRECTION),
    rule(PROGRAM, "patches.feed_direction", DIRECTION),
    rule(PROGRAM, "patches.pseudo_curvature_max", CURVATURE),
    rule(PROGRAM, "patches.sample_count", EXACT),
    rule(PROGRAM, "patches.step_over", LENGTH),
    rule(PROGRAM, "patches.area", AREA),
    rule(PROGRAM, "patches.pass_count", EXACT),
    rule(PROGRAM, "patches.rotary_names", EXACT),
    rule(PROGRAM, "patches.rotary_positions", Tolerance::Within(1e-9, "rad")),
    rule(PROGRAM, "patches.machining_time", TIME),
    rule(PROGRAM, "patches.cut_length", LONG),
    rule(PROGRAM, "machine_urdf", EXACT),
    rule(RESIDUAL, "points", LENGTH),
    rule(RESIDUAL, "leftover", LENGTH),
    rule(MOTION, "joint_names", EXACT),
    // Times travel in whole nanoseconds.
    rule(MOTION, "times", TIME),
    rule(MOTION, "positions", Tolerance::Within(1e-9, "m, rad")),
    rule(MOTION, "velocities", Tolerance::Within(1e-6, "m/s, rad/s")),
    rule(MACHINE, "name", EXACT),
    rule(MACHINE, "axes.joint_name", EXACT),
    rule(MACHINE, "axes.letter", EXACT),
    rule(MACHINE, "axes.kind", EXACT),
    rule(MACHINE, "axes.limits", EXACT),
    rule(MACHINE, "axes.velocity", EXACT),
    rule(MACHINE, "axes.acceleration", EXACT),
    rule(MACHINE, "urdf", EXACT),
    rule(ROBOT_DESCRIPTION, "data", EXACT),
    rule(STATUS, "state", EXACT),
    rule(STATUS, "code", EXACT),
    rule(STATUS, "text of a failure", EXACT),
];
