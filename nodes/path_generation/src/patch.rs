//! One patch: the orientation of least estimated time, its pass planes, its cut passes.

use nalgebra::Point3;
use patchmill_geometry::cutter::Cutter;
use patchmill_products::job::Job;
use patchmill_products::stage::{Progress, StageError};
use patchmill_products::toolpath::{Pass, PatchToolpath};
use rayon::prelude::*;

use crate::PreparedSurface;
use crate::linking::linked_passes;
use crate::orientation::{Orientation, least_lead, orientations};
use crate::pass_cut::PatchCutter;
use crate::pass_layout::{StripPoint, chains, intervals};
use crate::step_over::{StepProfile, plane_distance, scallop_budget, valley};
use crate::surface_cloud::CloudPoint;

/// Share of the second-order step that is used: the true swept profile is an offset ellipse, whose step is up to 1.4 %
/// shorter at small leads, and the share of area above the height is half of the excess.
const STEP_SHARE: f64 = 0.98;
/// Passes reach beyond the points that they have to cut by this at least, m.
const OVERLAP: f64 = 0.4e-3;
/// Gaps along a pass up to this are cut through, m; longer ones are lifted over.
const LONGEST_GAP: f64 = 3e-3;
/// Time that a pass costs beside its length, s: corner and link. Only for the estimate that picks the orientation.
const SECONDS_PER_PASS: f64 = 0.3;

/// A patch whose orientation is chosen; its spacing may still be tightened.
pub struct PatchPlan<'a> {
    /// Number in the partition.
    pub patch: u32,
    /// The orientation.
    pub orientation: Orientation,
    /// Cuts along the orientation.
    pub cutter: PatchCutter<'a>,
    points: Vec<&'a CloudPoint>,
    profile: StepProfile,
    overlap: f64,
    planes: Vec<f64>,
}

impl<'a> PatchPlan<'a> {
    /// Chooses the orientation for the dense points of a patch (at least one).
    ///
    /// # Errors
    /// With the reason when no orientation is within the job's limits.
    pub fn new(
        surface: &'a PreparedSurface,
        patch: u32,
        points: Vec<&'a CloudPoint>,
        job: &Job,
    ) -> Result<Self, String> {
        let shape = offset_cutter(job);
        let leads = leads(&points, shape, job)?;
        let all = orientations(&points, &leads);
        let least = all.iter().map(|o| o.inclination).fold(f64::INFINITY, f64::min);
        let allowed = all.into_iter().filter(|o| o.inclination <= job.inclination_max);
        let timed = allowed.map(|o| {
            let profile = step_profile(&points, &o, shape, job);
            let (length, passes) = profile.estimate();
            (length / job.feed + passes as f64 * SECONDS_PER_PASS, o, profile)
        });
        let Some((_, orientation, profile)) = timed.min_by(|a, b| a.0.total_cmp(&b.0)) else {
            return Err(format!(
                "patch {patch}: one fixed tool axis would lean {:.1}° off some of its normals, allowed are {:.1}°",
                least.to_degrees(),
                job.inclination_max.to_degrees()
            ));
        };
        let cutter = PatchCutter::new(
            &surface.mesh,
            &surface.bvh,
            &surface.shapes,
            shape,
            &orientation,
            job.pass_chord,
        );
        let planes = profile.planes();
        Ok(Self { patch, orientation, cutter, points, profile, overlap: OVERLAP, planes })
    }

    /// Cuts all passes.
    ///
    /// # Errors
    /// SUPERSEDED when cancelled.
    pub fn cut(&self, job: &Job, progress: Progress) -> Result<PatchToolpath, StageError> {
        let shape = offset_cutter(job);
        let strip: Vec<StripPoint> =
            self.points.iter().map(|p| strip_point(p, &self.orientation, shape, &self.cutter)).collect();
        let needed = intervals(&self.planes, &strip, self.overlap, LONGEST_GAP);
        let chains = chains(&needed)
            .into_iter()
            .map(|chain| {
                chain
                    .into_par_iter()
                    .map(|(plane, i)| {
                        progress.check()?;
                        Ok(self.cutter.pass(self.planes[plane], needed[plane][i]))
                    })
                    .collect()
            })
            .collect::<Result<_, StageError>>()?;
        let mut passes = linked_passes(&self.cutter, chains, job.pattern, job.clearance);
        self.lift_by_allowance(&mut passes, job.stock_allowance);
        Ok(PatchToolpath {
            patch: self.patch,
            tool_axis: self.orientation.axis.into_inner(),
            feed_direction: self.orientation.feed,
            pseudo_curvature_max: self
                .points
                .iter()
                .map(|p| p.pseudo_curvature)
                .fold(f64::NEG_INFINITY, f64::max),
            sample_count: self.points.iter().filter(|p| p.area == 0.0).count() as u32,
            step_over: self.step_over(),
            area: self.points.iter().map(|p| p.area).sum(),
            passes,
        })
    }

    /// The tip of the cutter with the allowance in its corner radius lies deeper than the real one's by that much.
    fn lift_by_allowance(&self, passes: &mut [Pass], allowance: f64) {
        for pass in passes {
            pass.cl.iter_mut().for_each(|tip| *tip += self.orientation.axis.into_inner() * allowance);
            pass.retract_height += allowance;
        }
    }

    fn step_over(&self) -> [f64; 2] {
        let steps = || self.planes.windows(2).map(|w| w[1] - w[0]);
        if self.planes.len() < 2 {
            return [0.0; 2];
        }
        [steps().fold(f64::INFINITY, f64::min), steps().fold(0.0, f64::max)]
    }

    /// Takes the swept check's findings, (point, leftover in m), all above `height` (m): strips with too much left get a
    /// smaller step, passes that end too early a longer overlap.
    pub fn tighten(&mut self, left: &[(Point3<f64>, f64)], height: f64) {
        let mut worst = vec![0.0f64; self.planes.len() + 1];
        for (point, leftover) in left {
            // Far above the height it is no ridge between passes but a place that none of them reached.
            if *leftover > 4.0 * height {
                continue;
            }
            let y = (self.cutter.frame() * point).y;
            let above = self.planes.partition_point(|plane| *plane < y);
            worst[above] = worst[above].max(*leftover);
        }
        let unreached = left.iter().filter(|(_, leftover)| *leftover > 4.0 * height).count();
        if unreached > 0 {
            self.overlap += 0.75e-3;
        }
        let (low, high) = self.profile.range();
        for (above, leftover) in worst.iter().enumerate().filter(|(_, leftover)| **leftover > 0.0) {
            let factor = (height / leftover).sqrt() * 0.99;
            let (from, to, gap) = match (above.checked_sub(1), self.planes.get(above)) {
                (Some(below), Some(next)) => (self.planes[below], *next, next - self.planes[below]),
                (None, Some(next)) => (low, *next, 2.0 * (next - low)),
                (Some(below), None) => (self.planes[below], high, 2.0 * (high - self.planes[below])),
                (None, None) => continue,
            };
            self.profile.limit(from, to, gap * factor);
        }
        self.planes = self.profile.planes();
    }
}

/// The cutter grown by the stock allowance: dropping it leaves the allowance everywhere.
pub fn offset_cutter(job: &Job) -> Cutter {
    Cutter { r1: job.tool.cutter.r1, r2: job.tool.cutter.r2 + job.stock_allowance }
}

fn leads(points: &[&CloudPoint], cutter: Cutter, job: &Job) -> Result<Vec<f64>, String> {
    points
        .iter()
        .map(|p| {
            least_lead(cutter, p.pseudo_curvature, job.lead_min).ok_or_else(|| {
                let q = p.position * 1e3;
                format!(
                    "the cutter of radius {:.2} mm does not fit at ({:.1}, {:.1}, {:.1}) mm, where the ball's radius is \
                     {:.2} mm",
                    cutter.radius() * 1e3,
                    q.x,
                    q.y,
                    q.z,
                    1e3 / p.pseudo_curvature
                )
            })
        })
        .collect()
}

fn step_profile(points: &[&CloudPoint], orientation: &Orientation, cutter: Cutter, job: &Job) -> StepProfile {
    let longest = cutter.radius();
    let steps: Vec<(f64, f64, f64)> = points
        .par_iter()
        .map(|p| {
            let height = scallop_budget(p, job.scallop_height, job.pass_chord);
            let step = match valley(cutter, orientation, &p.normal, &p.curvature) {
                Some(valley) => plane_distance(&valley, height, longest) * STEP_SHARE,
                // The bottom touches all around: the corner alone still cuts a valley of radius R2.
                None => (8.0 * height * cutter.r2.max(1e-5)).sqrt() * STEP_SHARE,
            };
            (p.position.coords.dot(&orientation.cross_feed), step, p.area)
        })
        .collect();
    StepProfile::new(steps.iter().copied())
}

fn strip_point(
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
