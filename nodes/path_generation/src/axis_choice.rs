//! Which tool axis a patch gets: the paper's four orientations by estimated time, and more of them where shank or holder
//! would touch the part, or where the least time is asked for ([`patchmill_orientation::axis_search`]).
//!
//! The rule β* = max(β_i + θ_i) leans as little as the ball's lead allows in the feed direction; a lesser lean would
//! leave material. So where the paper's four all touch, other feed directions around the mean normal are tried, each with its
//! own β* and with leans beyond it up to the largest inclination.

use std::f64::consts::TAU;

use nalgebra::Point3;
use patchmill_geometry::drop_cutter::{DropCutter, tool_frame};
use patchmill_products::job::{Job, Strategy};
use rayon::prelude::*;

use crate::PreparedSurface;
use crate::assembly::{Assembly, Collision, HeldAssembly};
use crate::patch::step_profile;
use crate::strips::Strips;
use patchmill_orientation::axis_search::quickest_orientations;
use patchmill_orientation::cloud_point::CloudPoint;
use patchmill_orientation::orientation::{
    Orientation, leads, orientations, orientations_around, upright_orientations,
};
use patchmill_orientation::pass_curves::StepField;
use patchmill_orientation::step_over::offset_cutter;

/// Time that a pass costs beside its length, s: corner and link. Only for the estimate that picks the orientation.
const SECONDS_PER_PASS: f64 = 0.3;
/// Feed directions tried around the mean normal where the paper's four touch.
const DIRECTIONS: usize = 16;
/// Leans tried beyond β*, rad.
const LEAN_STEP: f64 = 5.0 * TAU / 360.0;
/// Number of leans tried in each direction, β* included.
const LEANS: usize = 9;
/// Dense points on which curves are timed.
const TIMED_POINTS: usize = 6000;
/// Number of leans tried in each direction where a wall stands in the way.
const REACHING_LEANS: usize = 3;
/// Of all these so many are timed.
const REACHING_TIMED: usize = 4;
/// Dense points of a patch at which it is looked whether an orientation reaches them.
const REACHED_POINTS: usize = 1500;
/// Share of the scallop height by which the cutter may be lifted off a point that it reaches.
const LIFTED: f64 = 0.1;
/// Share of a patch that an orientation need not reach.
const MISSED: f64 = 3e-4;
/// Dense points that a first look is taken at.
const FIRST_LOOK: usize = 256;

/// The orientations of a patch in the order in which they are tried.
pub struct Ways<'a> {
    surface: &'a PreparedSurface,
    assembly: Option<&'a Assembly>,
    job: &'a Job,
    leads: Vec<f64>,
    /// Not yet tried, the best one last.
    ready: Vec<Orientation>,
    /// What touched.
    refused: Vec<Orientation>,
    widened: bool,
}

impl<'a> Ways<'a> {
    /// The paper's four, and those of a search where the least time is asked for, within the job's limits, by estimated time.
    ///
    /// # Errors
    /// With the reason when the cutter does not fit or none is within the limits.
    pub fn new(
        surface: &'a PreparedSurface,
        assembly: Option<&'a Assembly>,
        patch: u32,
        points: &[&CloudPoint],
        job: &'a Job,
    ) -> Result<Self, String> {
        let upright = job.strategy == Strategy::ThreeAxis;
        let leads = if upright { Vec::new() } else { leads(points, offset_cutter(job), job)? };
        let mut all = if upright { upright_orientations(points) } else { orientations(points, &leads) };
        if job.strategy == Strategy::Fastest {
            all.extend(quickest_orientations(points, &leads, &all, job));
        }
        let least = all.iter().map(|o| o.inclination).fold(f64::INFINITY, f64::min);
        let mut ready = by_time(all, points, job);
        if job.leaves_rest() && !upright {
            ready = reaching(ready, surface, points, &leads, job);
        }
        if ready.is_empty() {
            return Err(format!(
                "patch {patch}: one fixed tool axis would lean {:.1}° off some of its normals, allowed are {:.1}°",
                least.to_degrees(),
                job.inclination_max.to_degrees()
            ));
        }
        Ok(Self { surface, assembly, job, leads, ready, refused: Vec::new(), widened: upright })
    }

    /// The quickest one not tried yet on which shank and holder keep off the part over all dense points.
    pub fn next(&mut self, points: &[&CloudPoint]) -> Option<Orientation> {
        loop {
            while let Some(orientation) = self.ready.pop() {
                let Some(held) = self.held(&orientation) else { return Some(orientation) };
                if !held.touches(&self.tips(&orientation, points, usize::MAX)) {
                    return Some(orientation);
                }
                self.refused.push(orientation);
            }
            if self.widened || self.assembly.is_none() {
                return None;
            }
            self.widened = true;
            self.ready = self.wider(points);
        }
    }

    /// Goes on with the marked ones of its points.
    pub fn keep(&mut self, marks: &[bool]) {
        let mut marks = marks.iter();
        self.leads.retain(|_| marks.next().is_none_or(|mark| *mark));
    }

    /// Takes back one that its passes have shown to touch.
    pub fn refuse(&mut self, orientation: Orientation) {
        self.refused.push(orientation);
    }

    /// Of all refused orientations the one that lacks least, by a first look.
    pub fn least_bad(&self, points: &[&CloudPoint]) -> Option<Orientation> {
        let lacking = |o: &Orientation| {
            let held = self.held(o)?;
            Some(held.collision(&self.tips(o, points, FIRST_LOOK)).raises())
        };
        let compare = |a: &[f64; 2], b: &[f64; 2]| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1]));
        let all = self.refused.iter().filter_map(|o| Some((lacking(o)?, *o)));
        all.min_by(|a, b| compare(&a.0, &b.0)).map(|(_, orientation)| orientation)
    }

    /// Where shank and holder touch with the cutter at the patch's dense points.
    pub fn collision(&self, orientation: &Orientation, points: &[&CloudPoint]) -> Collision {
        let tips = self.tips(orientation, points, usize::MAX);
        self.held(orientation).map_or(Collision::default(), |held| held.collision(&tips))
    }

    /// Other feed directions and leans that pass a first look.
    fn wider(&mut self, points: &[&CloudPoint]) -> Vec<Orientation> {
        let (mut clear, mut touching) = (Vec::new(), Vec::new());
        for orientation in orientations_around(points, &self.leads, DIRECTIONS, LEANS, LEAN_STEP) {
            if orientation.inclination > self.job.inclination_max {
                continue;
            }
            let tips = self.tips(&orientation, points, FIRST_LOOK);
            let touches = self.held(&orientation).is_some_and(|held| held.touches(&tips));
            if touches { touching.push(orientation) } else { clear.push(orientation) }
        }
        self.refused.extend(touching);
        by_time(clear, points, self.job)
    }

    fn held(&self, orientation: &Orientation) -> Option<HeldAssembly<'a>> {
        let frame = tool_frame(&orientation.axis, &orientation.feed);
        Some(HeldAssembly::new(self.assembly?, &self.surface.mesh, &self.surface.bvh, frame))
    }

    /// Tips of the cutter touching at the dense points, evenly thinned to about `most`, `workpiece` frame. The drop on the whole
    /// mesh can only raise them, and shank and holder with them.
    fn tips(&self, orientation: &Orientation, points: &[&CloudPoint], most: usize) -> Vec<Point3<f64>> {
        let (shape, axis) = (offset_cutter(self.job), orientation.axis.into_inner());
        let tip = |p: &&CloudPoint| {
            let across = (p.normal - axis * p.normal.dot(&axis)).try_normalize(1e-9).unwrap_or_default();
            p.position
                + p.normal * shape.r2
                + across * shape.r1
                + axis * (self.job.stock_allowance - shape.r2)
        };
        points.iter().step_by((points.len() / most).max(1)).map(tip).collect()
    }
}

/// The same with those last that reach most of the patch, which a wall above the rolling ball can keep the cutter's own cylinder from;
/// others leant in all directions join them where none reaches all.
fn reaching(
    ready: Vec<Orientation>,
    surface: &PreparedSurface,
    points: &[&CloudPoint],
    leads: &[f64],
    job: &Job,
) -> Vec<Orientation> {
    let measured = |all: Vec<Orientation>| -> Vec<(f64, Orientation)> {
        all.into_par_iter().map(|o| (missed(&o, surface, points, job), o)).collect()
    };
    let mut found = measured(ready);
    if found.iter().all(|(missed, _)| *missed > 0.0) {
        let around = orientations_around(points, leads, DIRECTIONS, REACHING_LEANS, LEAN_STEP);
        let within = around.into_iter().filter(|o| o.inclination <= job.inclination_max).collect();
        let mut others = measured(within);
        // Only the best are timed: that takes longer.
        others.sort_by(|a, b| a.0.total_cmp(&b.0));
        let most: Vec<Orientation> = others.into_iter().take(REACHING_TIMED).map(|(_, o)| o).collect();
        let mut timed = measured(by_time(most, points, job));
        timed.append(&mut found);
        found = timed;
    }
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    found.into_iter().map(|(_, orientation)| orientation).collect()
}

/// Share of a patch's area to which the cutter cannot be put; 0 below [`MISSED`].
fn missed(orientation: &Orientation, surface: &PreparedSurface, points: &[&CloudPoint], job: &Job) -> f64 {
    let inner: Vec<&CloudPoint> = points.iter().filter(|p| p.area > 0.0).copied().collect();
    let looked_at: Vec<&CloudPoint> =
        inner.iter().step_by((inner.len() / REACHED_POINTS).max(1)).copied().collect();
    missed_share(&looked_at, &reached(orientation, surface, &looked_at, job))
}

/// Share of the area of the points that are not marked as reached; 0 below [`MISSED`].
pub fn missed_share(points: &[&CloudPoint], reached: &[bool]) -> f64 {
    let total: f64 = points.iter().map(|p| p.area).sum();
    let missed: f64 = points.iter().zip(reached).filter(|(_, reached)| !**reached).map(|(p, _)| p.area).sum();
    if missed <= MISSED * total { 0.0 } else { missed / total }
}

/// Whether the cutter can be put to the surface at each of the points without being in the part elsewhere by more than a trifle.
pub fn reached(
    orientation: &Orientation,
    surface: &PreparedSurface,
    points: &[&CloudPoint],
    job: &Job,
) -> Vec<bool> {
    let (shape, axis) = (offset_cutter(job), orientation.axis.into_inner());
    let drop = DropCutter::new(&surface.mesh, &surface.bvh, shape, &orientation.axis, &orientation.feed);
    let touches = |p: &&CloudPoint| {
        let across = (p.normal - axis * p.normal.dot(&axis)).try_normalize(1e-9).unwrap_or_default();
        let tip = drop.frame() * (p.position + p.normal * shape.r2 + across * shape.r1 - axis * shape.r2);
        let lifted = drop.drop_from(tip.x, tip.y, tip.z).map_or(0.0, |dropped| (dropped.z - tip.z).max(0.0));
        lifted <= LIFTED * job.scallop_height
    };
    points.par_iter().map(touches).collect()
}

/// Those within the largest inclination, the quickest last; of equally quick ones the first is last.
fn by_time(all: Vec<Orientation>, points: &[&CloudPoint], job: &Job) -> Vec<Orientation> {
    // Curves are tabulated over many slopes: fewer points tell as well which is the quickest.
    let share = if job.strategy == Strategy::Fastest { (points.len() / TIMED_POINTS).max(1) } else { 1 };
    let fewer: Vec<CloudPoint> =
        points.iter().step_by(share).map(|p| CloudPoint { area: p.area * share as f64, ..**p }).collect();
    let points: Vec<&CloudPoint> = fewer.iter().collect();
    let timed = all.into_iter().filter(|o| o.inclination <= job.inclination_max).map(|orientation| {
        let (length, passes) = strips(&points, &orientation, job).estimate();
        (length / job.feed + passes as f64 * SECONDS_PER_PASS, orientation)
    });
    let mut timed: Vec<(f64, Orientation)> = timed.collect();
    timed.sort_by(|a, b| a.0.total_cmp(&b.0));
    timed.into_iter().rev().map(|(_, orientation)| orientation).collect()
}

/// The passes over a patch held that way.
pub(crate) fn strips(points: &[&CloudPoint], orientation: &Orientation, job: &Job) -> Strips {
    let cutter = offset_cutter(job);
    match job.strategy {
        Strategy::Fastest => Strips::curves(StepField::new(points, orientation, cutter, job)),
        Strategy::RollingBall | Strategy::FiveAxis | Strategy::Sturz | Strategy::ThreeAxis => {
            Strips::planes(step_profile(points, orientation, cutter, job))
        }
    }
}
