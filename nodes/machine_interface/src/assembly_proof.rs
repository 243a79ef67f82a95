//! The proof for shank and holder: along the motions of the program *text*, feed and rapids, they keep off the mesh.
//!
//! Only what is wider than the cutter counts: the cutter's own cylinder is in the swept check.

use nalgebra::{Point3, Unit, Vector3};
use patchmill_geometry::drop_cutter::tool_frame;
use patchmill_geometry::sweep::Pose;
use patchmill_geometry::tool_stack::{StackDrop, Touch};
use patchmill_kinematics::Machine;
use patchmill_products::job::Job;
use patchmill_products::stage::{Progress, StageError};
use rayon::prelude::*;

use crate::clearance::PartBody;
use crate::gcode::ReadBlock;
use crate::proof::motions_of;
use crate::surroundings::Surroundings;

/// Distance from the part that has to be kept, m: half of the looks' distance; path_generation keeps more.
const MARGIN: f64 = 0.15e-3;
/// Moves are looked at no coarser than this, m.
const SPACING: f64 = 0.3e-3;

/// What shank or holder of the job's tool touch along a program; `None` when they keep off, or are no wider than the cutter.
///
/// # Errors
/// SUPERSEDED when cancelled.
pub fn assembly_touch(
    blocks: &[ReadBlock],
    machine: &Machine,
    part: &PartBody,
    surroundings: &Surroundings<'_>,
    job: &Job,
    progress: &Progress<'_>,
) -> Result<Option<String>, StageError> {
    let [shank, holder] = job.tool.wide_stacks(MARGIN + job.stock_allowance);
    let parts = [("shank", shank), ("holder", holder)];
    if parts.iter().all(|(_, stack)| stack.is_empty()) {
        return Ok(None);
    }
    let Surroundings { mesh, bvh, .. } = surroundings;
    let held = |axis: &Unit<Vector3<f64>>| StackDrop::new(mesh, bvh, tool_frame(axis, &Vector3::x()));
    let motions = motions_of(blocks, machine, part, job);
    // Three poses at feed are as far apart as two looks along a straight move.
    let turning: Vec<Pose> =
        motions.turning_feed.iter().step_by(3).chain(&motions.turning_rapid).copied().collect();
    for (name, stack) in parts.iter().filter(|(_, stack)| !stack.is_empty()) {
        let mut worst: Option<Touch> = None;
        for sweep in &motions.fixed {
            progress.check()?;
            let drop = held(&sweep.axis);
            let lines: Vec<[Point3<f64>; 2]> = sweep
                .feed
                .iter()
                .chain(&sweep.rapid)
                .flat_map(|line| line.windows(2).map(|w| [w[0], w[1]]))
                .collect();
            let touch = |[from, to]: &[Point3<f64>; 2]| drop.touch_along(stack, from, to, SPACING);
            worst = Touch::worse(worst, lines.par_iter().map(touch).reduce(|| None, Touch::worse));
        }
        let touch = |(tip, axis): &Pose| held(axis).touch(stack, tip, 0.0);
        worst = Touch::worse(worst, turning.par_iter().map(touch).reduce(|| None, Touch::worse));
        if let Some(touch) = worst {
            let tip = touch.tip * 1e3;
            return Ok(Some(format!(
                "the check of the program finds the {name} touching the part, worst with the tool tip at ({:.1}, {:.1}, {:.1}) \
                 mm, where it lacks {:.2} mm along the tool axis",
                tip.x,
                tip.y,
                tip.z,
                touch.raise * 1e3
            )));
        }
    }
    Ok(None)
}
