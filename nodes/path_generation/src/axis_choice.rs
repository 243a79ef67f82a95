//! Which tool axis a patch gets: the paper's four orientations by estimated time, and more of them where shank or holder
//! would touch the part, or where the least time is asked for ([`patchmill_orientation::axis_search`]).
//!
//! The rule β* = max(β_i + θ_i) leans as little as the ball's lead allows in the feed direction; a lesser lean would
//! leave material. So where the paper's four all touch, other feed directions around the mean normal are tried, each with its
//! own β* and with leans beyond it up to the largest inclination.

use std::f64::consts::TAU;

use nalgebra::Point3;
use patchmill_geometry::drop_cutter::tool_frame;
use patchmill_products::job::{Job, Strategy};

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
        let ready = by_time(all, points, job);
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
