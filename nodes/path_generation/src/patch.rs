//! One patch: the orientation of least estimated time, its pass planes, its cut passes.

use nalgebra::Point3;
use patchmill_geometry::cutter::Cutter;
use patchmill_geometry::tool_stack::Touch;
use patchmill_orientation::cloud_point::CloudPoint;
use patchmill_orientation::orientation::Orientation;
use patchmill_orientation::step_over::{allowed_distance, offset_cutter, valley};
use patchmill_products::job::{Job, Strategy};
use patchmill_products::stage::{Progress, StageError};
use patchmill_products::toolpath::{Pass, PatchToolpath};
use rayon::prelude::*;

use crate::PreparedSurface;
use crate::assembly::{Assembly, Collision};
use crate::axis_choice::{Ways, strips};
use crate::linking::{CutChain, linked_passes};
use crate::pass_cut::{Location, PatchCutter};
use crate::pass_layout::StripPoint;
use crate::pass_trimming::PatchTips;
use crate::step_profile::StepProfile;
use crate::strips::Strips;
use patchmill_orientation::pass_curves::turned;

/// Orientations whose passes are cut before a patch is given up.
const MOST_CUTS: usize = 6;

/// A patch whose orientation is chosen; its spacing may still be tightened.
pub struct PatchPlan<'a> {
    /// Number in the partition.
    pub patch: u32,
    /// The orientation.
    pub orientation: Orientation,
    /// Cuts along the orientation.
    pub cutter: PatchCutter<'a>,
    points: Vec<&'a CloudPoint>,
    strips: Strips,
    ways: Ways<'a>,
    surface: &'a PreparedSurface,
    assembly: Option<&'a Assembly>,
}

/// A patch's passes.
#[derive(Clone)]
pub struct PatchCut {
    /// Their pieces, where they may still be trimmed: with [`Strategy::Fastest`] only.
    pub chains: Vec<CutChain>,
    /// The pieces linked.
    pub toolpath: PatchToolpath,
}

/// Why there is no plan of a patch.
#[derive(Debug)]
pub enum PlanError {
    /// The patch cannot be cut within the job's limits; for a person to read.
    Infeasible(String),
    /// Superseded.
    Stopped(StageError),
}

impl From<StageError> for PlanError {
    fn from(error: StageError) -> Self {
        Self::Stopped(error)
    }
}

impl<'a> PatchPlan<'a> {
    /// Chooses the orientation for the dense points of a patch (at least one); `assembly` is what of the tool has to keep
    /// off the part there.
    ///
    /// # Errors
    /// With the reason when no orientation is within the job's limits or all touch; SUPERSEDED when cancelled.
    pub fn new(
        surface: &'a PreparedSurface,
        patch: u32,
        points: Vec<&'a CloudPoint>,
        job: &'a Job,
        assembly: Option<&'a Assembly>,
        progress: Progress,
    ) -> Result<Self, PlanError> {
        let mut ways = Ways::new(surface, assembly, patch, &points, job).map_err(PlanError::Infeasible)?;
        let (orientation, touches) = match ways.next(&points) {
            Some(orientation) => (orientation, false),
            None => {
                let none = || PlanError::Infeasible(format!("patch {patch}: no tool axis was found"));
                (ways.least_bad(&points).ok_or_else(none)?, true)
            }
        };
        let strips = strips(&points, &orientation, job);
        let cutter = cutter_along(surface, &orientation, job, assembly);
        let plan = Self { patch, orientation, cutter, points, strips, ways, surface, assembly };
        if touches { Err(plan.refusal(job, progress)) } else { Ok(plan) }
    }

    /// Cuts all passes, along another orientation where shank or holder touch the part on them.
    ///
    /// # Errors
    /// With the reason when all touch; SUPERSEDED when cancelled.
    pub fn cut_clear(&mut self, job: &Job, progress: Progress) -> Result<PatchCut, PlanError> {
        for _ in 0..MOST_CUTS {
            let cut = self.cut(job, progress)?;
            if self.cutter.collision(&cut.toolpath.passes, &self.orientation.axis).is_clear() {
                return Ok(cut);
            }
            self.ways.refuse(self.orientation);
            let Some(orientation) = self.ways.next(&self.points) else { break };
            self.take(orientation, job);
        }
        if let Some(orientation) = self.ways.least_bad(&self.points) {
            self.take(orientation, job);
        }
        Err(self.refusal(job, progress))
    }

    fn take(&mut self, orientation: Orientation, job: &Job) {
        self.orientation = orientation;
        self.strips = strips(&self.points, &orientation, job);
        self.cutter = cutter_along(self.surface, &self.orientation, job, self.assembly);
    }

    /// What touches on the plan's orientation, and the tool that would not.
    fn refusal(&self, job: &Job, progress: Progress) -> PlanError {
        let cut = match self.cut(job, progress) {
            Ok(cut) => cut,
            Err(stopped) => return stopped.into(),
        };
        let along = self.cutter.collision(&cut.toolpath.passes, &self.orientation.axis);
        let collision = along.worse(self.ways.collision(&self.orientation, &self.points));
        PlanError::Infeasible(format!(
            "patch {}: on every tool axis tried {}",
            self.patch,
            lacking(&collision, job)
        ))
    }

    /// Cuts all passes.
    ///
    /// # Errors
    /// SUPERSEDED when cancelled.
    pub fn cut(&self, job: &Job, progress: Progress) -> Result<PatchCut, StageError> {
        let shape = offset_cutter(job);
        let strip: Vec<StripPoint> = self.points.par_iter().map(|p| self.strip_point(p, shape)).collect();
        let chains = self.strips.cut(&strip, progress, |line, interval| self.cutter.pass(line, interval))?;
        let kept = if job.strategy == Strategy::Fastest { chains.clone() } else { Vec::new() };
        Ok(PatchCut { toolpath: self.linked(chains, job), chains: kept })
    }

    /// The patch's toolpath of such pieces.
    pub fn linked(&self, chains: Vec<CutChain>, job: &Job) -> PatchToolpath {
        let mut passes = linked_passes(&self.cutter, chains, job);
        self.lift_by_allowance(&mut passes, job.stock_allowance);
        let directions = [self.orientation.axis.into_inner(), self.orientation.feed];
        self.strips.toolpath(self.patch, directions, &self.points, passes)
    }

    /// The tips of such pieces, to be looked at together with other patches'.
    pub fn tips(&self, chains: &[CutChain], job: &Job) -> PatchTips {
        let (back, axis) = (self.cutter.frame().inverse(), self.orientation.axis);
        let lift = axis.into_inner() * job.stock_allowance;
        let tips = |piece: &Vec<Location>| piece.iter().map(|l| back * l.tip + lift).collect();
        let pieces = chains.iter().flatten().flatten().map(tips).collect();
        PatchTips { axis, pieces, area: self.points.iter().map(|p| p.area).sum() }
    }

    /// A dense point as the passes see it, by their direction there.
    fn strip_point(&self, p: &CloudPoint, shape: Cutter) -> StripPoint {
        let frame = self.cutter.frame();
        let place = frame * p.position;
        let slope = self.strips.slope_at(place.x, place.y);
        if slope == 0.0 {
            return strip_point(p, &self.orientation, shape, &self.cutter);
        }
        let turned = turned(&self.orientation, frame, slope);
        let drift = strip_point(p, &turned, shape, &self.cutter).drift;
        // The foot on the line, and the drift along it: by the distance along y.
        let (cosine, sine) = (1.0 / slope.hypot(1.0), slope / slope.hypot(1.0));
        StripPoint { x: place.x, y: place.y, drift: cosine * (sine + drift) }
    }

    /// The tip of the cutter with the allowance in its corner radius lies deeper than the real one's by that much.
    fn lift_by_allowance(&self, passes: &mut [Pass], allowance: f64) {
        for pass in passes {
            pass.cl.iter_mut().for_each(|tip| *tip += self.orientation.axis.into_inner() * allowance);
            pass.retract_height += allowance;
        }
    }

    /// Whether its passes are laid anew even where nothing is left.
    pub fn adapts(&self) -> bool {
        self.strips.adapts()
    }

    /// Takes the swept check's findings, (point, leftover in m), for the next cut ([`Strips::respace`]).
    pub fn respace(&mut self, left: &[(Point3<f64>, f64)], height: f64, widening: bool) {
        let frame = *self.cutter.frame();
        let left = left.iter().map(|(point, leftover)| (frame * point, *leftover));
        self.strips.respace(left, height, widening);
    }
}

/// A cutter along an orientation, with shank and holder.
fn cutter_along<'a>(
    surface: &'a PreparedSurface,
    orientation: &Orientation,
    job: &Job,
    assembly: Option<&'a Assembly>,
) -> PatchCutter<'a> {
    let cutter = PatchCutter::new(
        &surface.mesh,
        &surface.bvh,
        &surface.shapes,
        offset_cutter(job),
        orientation,
        job.pass_chord,
    )
    .with_border_margin(job.border_margin);
    match assembly {
        Some(assembly) => cutter.with_assembly(assembly),
        None => cutter,
    }
}

/// What of shank and holder touches, and the flute length and stick-out at which it would not.
pub fn lacking(collision: &Collision, job: &Job) -> String {
    let parts = [
        (collision.shank, "shank", "flute length", job.tool.flute_top()),
        (collision.holder, "holder", "stick-out", job.tool.length),
    ];
    let sentence = |(touch, part, length, has): (Option<Touch>, &str, &str, f64)| {
        let touch = touch?;
        let tip = touch.tip * 1e3;
        // Rounded up, so that the length named works.
        let needed = ((has + touch.raise) * 1e5 + 1e-3).ceil() / 1e2;
        Some(format!(
            "the {part} touches the part, worst with the tool tip at ({:.1}, {:.1}, {:.1}) mm; least {length} that works \
             {needed:.2} mm, the tool has {:.2} mm",
            tip.x,
            tip.y,
            tip.z,
            has * 1e3
        ))
    };
    parts.into_iter().filter_map(sentence).collect::<Vec<_>>().join("; and ")
}

/// Step-over that an orientation allows across the patch.
pub fn step_profile(
    points: &[&CloudPoint],
    orientation: &Orientation,
    cutter: Cutter,
    job: &Job,
) -> StepProfile {
    step_profile_of(points, &|_| *orientation, cutter, job)
}

/// The same where every point, told by its place, has an orientation of its own; all share their cross-feed direction.
pub fn step_profile_of(
    points: &[&CloudPoint],
    orientation: &(dyn Fn(usize) -> Orientation + Sync),
    cutter: Cutter,
    job: &Job,
) -> StepProfile {
    let step = |(i, p): (usize, &&CloudPoint)| {
        let orientation = orientation(i);
        let (distance, _) = allowed_distance(p, &orientation, cutter, job);
        (p.position.coords.dot(&orientation.cross_feed), distance, p.area)
    };
    let steps: Vec<(f64, f64, f64)> = points.par_iter().enumerate().map(step).collect();
    StepProfile::new(steps.iter().copied())
}

pub(crate) fn strip_point(
    point: &CloudPoint,
    orientation: &Orientation,
    shape: Cutter,
    cutter: &PatchCutter,
) -> StripPoint {
    let place = cutter.frame() * point.position;
    let along = orientation.cross_feed.cross(&point.normal).normalize();
    let forward = (cutter.frame() * along).x;
    let drift = valley(shape, orientation, &point.normal, &point.curvature)
        .map_or(0.0, |v| v.shear / v.slope.max(0.1) * forward);
    // Beyond a slope of 3 the second-order contact says little.
    StripPoint { y: place.y, x: place.x, drift: drift.clamp(-3.0, 3.0) }
}
