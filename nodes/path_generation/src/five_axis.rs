//! Simultaneous 5-axis passes: the whole surface as one patch, at every cutter location the rolling ball's own tool axis.
//!
//! Passes lie in parallel planes as those of a patch with one axis. At a contact of normal n the axis leans from n towards
//! the first pass's feed by the lead θ, sin θ = R1/(R* − R2) on concave places, else the least lead; passes of the other
//! sense keep it (they drag the tool), as the lead counts from any side. R* is known on samples only and a lead that is
//! 0.1° short of a wall gouges 0.045 mm, so the swept check decides: where it finds a gouge the leads around it grow by what the
//! gouge asks for, R1 of depth a radian, and the passes are cut anew; beside the contact, where a lead clears the ring little,
//! what is left after a few rounds is answered by raising the cutter. Beyond borders, on links and on lead arcs, where the
//! rolling ball says nothing, the cutter is raised along its axis off dense points of the surface and its border instead.
//!
//! With [`Strategy::Sturz`] the lead is the least one everywhere and a gouge is the end of it: the method knows no answer to one but
//! a smaller tool.

use nalgebra::{Point3, Unit, Vector3};
use patchmill_geometry::cutter::Cutter;
use patchmill_geometry::mesh::TriangleMesh;
use patchmill_geometry::mesh_topology::MeshTopology;
use patchmill_geometry::sweep::{Obstacles, Pose, ProofPoints, sweep_poses};
use patchmill_products::job::{Job, Pattern, Strategy};
use patchmill_products::partition::Partition;
use patchmill_products::stage::{Progress, StageError};
use patchmill_products::toolpath::{CandidateToolpath, Pass, PatchToolpath};
use rayon::prelude::*;

use crate::candidate::{CHECK_CAP, COVERAGE, COVERAGE_AIM, SweptCheck, infeasible, judge, judged};
use crate::linking::{LONGEST_LINK, add_leads, merged_runs, ordered};
use crate::pass_cut::{
    Border, LATERAL_TOLERANCE, Location, MOST_SPLITS, ONE_KINK, PatchCutter, SHORTEST_SEGMENT, lead_angles,
    lead_arc,
};
use crate::pass_layout::{PassLine, StripPoint};
use crate::patch::{step_profile_of, strip_point};
use crate::strips::Strips;
use crate::{PathParams, PreparedSurface};
use patchmill_orientation::cloud_point::CloudPoint;
use patchmill_orientation::orientation::leads;
use patchmill_orientation::orientation::{Orientation, least_lead, orientations};
use patchmill_orientation::step_over::offset_cutter;

/// Distance between the places of a pass at which the lead is looked up, m.
const LEAD_STEP: f64 = 0.5e-3;
/// Leads change over this way along a pass, m: a jump of R* must not become a jump of the tool.
const LEAD_WAY: f64 = 4e-3;
/// Rounds of cutting anew.
const ROUNDS: usize = 10;
/// Of them those in which gouges are answered by more lead.
const LEAN_ROUNDS: usize = 3;
/// Share of the gouge tolerance that passes may use; the rest is for the control's own corners.
const GOUGE_SHARE: f64 = 0.7;
/// What a lead grows by beside what the gouge itself asks for, rad.
const LEAST_GROWTH: f64 = 0.02 * std::f64::consts::PI / 180.0;
/// Gouges in one cell of this size count as one, m.
const CELL: f64 = 3e-3;
/// Poses of the swept check are no farther apart than this, m: a corner of 6 mm leaves 0.2 µm between them.
const CHECK_STEP: f64 = 0.1e-3;
/// Where the rolling ball says nothing locations are no farther apart than this, m.
const LOOSE_STEP: f64 = 0.4e-3;
/// What such a location is raised by beside what those points ask for, m; it grows from round to round.
const RAISE: f64 = 2e-6;
/// Distance of the points that such locations keep off, m: over a corner of 6 mm the surface rises 1 µm between two of them.
const OBSTACLES: f64 = 0.25e-3;
/// The distance grows rather than let their number pass this.
const MOST_OBSTACLES: f64 = 1e6;
/// Distance of those along the border, m.
const BORDER_STEP: f64 = 0.1e-3;
/// A link clears the straight way between two passes by this at its middle, m.
const HOP: f64 = 0.1e-3;

/// Plans the 5-axis toolpath of the whole surface; one that cannot meet the job's tolerances comes with its
/// `infeasible_reason`.
///
/// # Errors
/// SUPERSEDED when cancelled.
pub fn plan_five_axis(
    surface: &PreparedSurface,
    partition: &Partition,
    job: &Job,
    params: &PathParams,
    progress: Progress,
) -> Result<CandidateToolpath, StageError> {
    let obstacles = obstacle_points(&surface.mesh);
    let mut plan = match Plan::new(surface, &obstacles, job) {
        Ok(plan) => plan,
        Err(reason) => return Ok(infeasible(partition, reason)),
    };
    let mut round = 0;
    loop {
        let patch = plan.cut(progress)?;
        let check = judge(&surface.check, &surface.rest, swept_residual(surface, &patch, job), job);
        progress.check()?;
        let gouges = match job.strategy {
            Strategy::Sturz if check.gouge > job.gouge_tolerance => {
                return Ok(judged(partition, vec![patch], &check, None, job));
            }
            Strategy::Sturz => false,
            _ => check.gouge > GOUGE_SHARE * job.gouge_tolerance,
        };
        let enough = if round < params.respacing_rounds { COVERAGE_AIM } else { COVERAGE };
        let leaves = check.within < enough;
        if round == ROUNDS || !(gouges || leaves) {
            return Ok(judged(partition, vec![patch], &check, None, job));
        }
        if gouges {
            plan.answer(&check, round >= LEAN_ROUNDS);
        }
        if leaves {
            let left = surface.check.points.iter().zip(&check.residual);
            let left = left.filter(|(_, left)| **left > job.scallop_height);
            let frame = *plan.cutter.frame();
            plan.strips.respace(left.map(|(p, left)| (frame * p, *left)), job.scallop_height, false);
        }
        round += 1;
    }
}

/// Where leads have to grow.
struct Growth {
    middle: Point3<f64>,
    lead: f64,
    /// More lead has not helped: locations around it are raised off the surface.
    raised: bool,
}

struct Plan<'a> {
    surface: &'a PreparedSurface,
    job: &'a Job,
    shape: Cutter,
    /// Its axis is the mean normal.
    frame: Orientation,
    points: Vec<&'a CloudPoint>,
    leads: Vec<f64>,
    cutter: PatchCutter<'a>,
    strips: Strips,
    growth: Vec<Growth>,
    obstacles: Obstacles<'a>,
    raise: f64,
}

impl<'a> Plan<'a> {
    fn new(surface: &'a PreparedSurface, obstacles: &'a ProofPoints, job: &'a Job) -> Result<Self, String> {
        let shape = offset_cutter(job);
        let points: Vec<&CloudPoint> = surface.cloud.iter().collect();
        let leads = match job.strategy {
            Strategy::Sturz => vec![job.lead_min; points.len()],
            _ => leads(&points, shape, job)?,
        };
        let largest = leads.iter().copied().fold(0.0, f64::max);
        if largest > job.inclination_max {
            return Err(format!(
                "the rolling ball asks for a lead of {:.1}°, allowed are {:.1}°",
                largest.to_degrees(),
                job.inclination_max.to_degrees()
            ));
        }
        let timed = orientations(&points, &leads).into_iter().map(|o| {
            let mean = Unit::new_normalize(o.feed.cross(&o.cross_feed));
            let frame = Orientation { axis: mean, ..o };
            let own = |i: usize| leaning(&frame, &points[i].normal, leads[i]);
            let profile = step_profile_of(&points, &own, shape, job);
            (profile.estimate().0, frame, profile)
        });
        let best = timed.min_by(|a, b| a.0.total_cmp(&b.0));
        let (_, frame, profile) = best.ok_or("the surface's normals have no mean")?;
        let cutter =
            PatchCutter::new(&surface.mesh, &surface.bvh, &surface.shapes, shape, &frame, job.pass_chord)
                .with_border_margin(job.border_margin);
        let strips = Strips::planes(profile);
        let obstacles = Obstacles::new(obstacles);
        Ok(Self {
            surface,
            job,
            shape,
            frame,
            points,
            leads,
            cutter,
            strips,
            growth: Vec::new(),
            obstacles,
            raise: RAISE,
        })
    }

    fn cut(&self, progress: Progress) -> Result<PatchToolpath, StageError> {
        let own = |i: usize| leaning(&self.frame, &self.points[i].normal, self.leads[i]);
        let strip: Vec<StripPoint> = self
            .points
            .par_iter()
            .enumerate()
            .map(|(i, p)| strip_point(p, &own(i), self.shape, &self.cutter))
            .collect();
        let chains =
            self.strips.cut(&strip, progress, |plane, interval| self.pass(plane.at(0.0).0, interval))?;
        let passes = self.linked(ordered(chains, self.job.pattern), self.job.pattern);
        let first = passes.first().and_then(|pass: &Pass| pass.tool_axes.first());
        let axis = first.copied().unwrap_or_else(|| self.frame.axis.into_inner());
        Ok(self.strips.toolpath(0, [axis, self.frame.feed], &self.points, passes))
    }

    /// The pass over x in `interval` of the plane at `y` (frame of the mean normal, m), a piece for every stretch of surface.
    fn pass(&self, y: f64, interval: (f64, f64)) -> Vec<Vec<Location>> {
        let plane = PassLine::Plane(y);
        let stretches = self.cutter.stretches(plane, interval);
        let piece = |(i, &stretch): (usize, &(f64, f64))| {
            let (from, to) = self.cutter.ends_of(&stretches, i, interval);
            let line = Line {
                plan: self,
                y,
                stretch,
                borders: [self.cutter.border(stretch.0, plane)?, self.cutter.border(stretch.1, plane)?],
                leads: self.leads_along(y, stretch),
            };
            let mut locations =
                line.follow(&loose_ends(from, stretch, to, self.cutter.nodes(stretch.0, stretch, stretch.1)));
            for (x, location) in &mut locations {
                if *x < stretch.0 || *x > stretch.1 {
                    self.raise_off(location, self.raise);
                } else if self.is_raised(&location.contact) {
                    self.raise_off(location, 0.0);
                }
            }
            Some(locations.into_iter().map(|(_, location)| location).collect())
        };
        stretches.iter().enumerate().filter_map(piece).collect()
    }

    /// Raises the cutter along its axis off the surface with its allowance and `beyond` (m), if it is in it.
    fn raise_off(&self, location: &mut Location, beyond: f64) {
        let back = self.cutter.frame().inverse();
        // The cutter grown by the allowance reaches that much lower.
        let tip = location.tip - location.axis * self.job.stock_allowance;
        let pose = (back * tip, Unit::new_normalize(back * location.axis));
        let raise = self.obstacles.raise(self.shape, &pose, self.job.tool.length);
        if raise > 0.0 {
            location.tip += location.axis * (raise + beyond);
        }
    }

    /// Leads at places `LEAD_STEP` apart over a stretch, smoothed from above.
    fn leads_along(&self, y: f64, (begin, end): (f64, f64)) -> Vec<f64> {
        let count = ((end - begin) / LEAD_STEP).ceil() as usize + 1;
        let mut known = self.job.lead_min;
        let raw = (0..count).map(|k| {
            let x = (begin + k as f64 * LEAD_STEP).min(end);
            if let Some((contact, _)) = self.cutter.surface_at(x, y) {
                known = self.lead_at(&self.cutter.frame().inverse_transform_point(&contact));
            }
            known
        });
        smoothed_from_above(&raw.collect::<Vec<_>>(), (LEAD_WAY / LEAD_STEP) as usize)
    }

    /// Whether locations with this contact (frame of the mean normal) are raised off the surface.
    fn is_raised(&self, contact: &Point3<f64>) -> bool {
        let contact = self.cutter.frame().inverse_transform_point(contact);
        let reach = 2.0 * self.shape.radius();
        self.growth.iter().any(|g| g.raised && (g.middle - contact).norm_squared() < reach * reach)
    }

    fn lead_at(&self, contact: &Point3<f64>) -> f64 {
        if self.job.strategy == Strategy::Sturz {
            return self.job.lead_min;
        }
        let kappa = self.surface.shapes.at(contact).pseudo_curvature;
        let lead = least_lead(self.shape, kappa, self.job.lead_min).unwrap_or(self.job.inclination_max);
        // Whatever touches there is within the cutter's diameter of the contact.
        let reach = 2.0 * self.shape.radius();
        let near = self.growth.iter().filter(|g| (g.middle - contact).norm_squared() < reach * reach);
        (lead + near.map(|g| g.lead).fold(0.0, f64::max)).min(self.job.inclination_max)
    }

    /// Answers the check's gouges by more lead around them, or, where that has not helped, by raising.
    fn answer(&mut self, check: &SweptCheck, raise: bool) {
        self.raise *= 1.5;
        let depth = GOUGE_SHARE * self.job.gouge_tolerance;
        let lever = self.shape.r1.max(self.shape.r2);
        // Of the gouges in one cell the deepest counts.
        let mut asked: Vec<Growth> = Vec::new();
        for (point, residual) in self.surface.check.points.iter().zip(&check.residual) {
            if -residual > depth {
                let lead = -residual / lever + LEAST_GROWTH;
                match cell_at(&mut asked, point) {
                    Some(growth) => growth.lead = growth.lead.max(lead),
                    None => asked.push(Growth { middle: *point, lead, raised: raise }),
                }
            }
        }
        for more in asked {
            match cell_at(&mut self.growth, &more.middle) {
                Some(growth) if raise => growth.raised = true,
                Some(growth) => growth.lead += more.lead,
                None => self.growth.push(more),
            }
        }
    }

    /// Passes in cutting order, `workpiece` frame.
    fn linked(&self, pieces: Vec<Vec<Location>>, pattern: Pattern) -> Vec<Pass> {
        let raised = |mut location: Location| {
            self.raise_off(&mut location, self.raise);
            location
        };
        let link = |from: &Location, to: &Location| hop(from, to).into_iter().map(raised).collect();
        let mut runs = merged_runs(&link, pieces, pattern, LONGEST_LINK);
        let lead = |end: &Location, inward: &Location| {
            let Some(arc) = lead_arc(end, inward, self.job.lead_radius) else { return Vec::new() };
            lead_angles()[1..].iter().map(|&angle| raised(Location { tip: arc(angle), ..*end })).collect()
        };
        let back = self.cutter.frame().inverse();
        runs.iter_mut().for_each(|run| add_leads(run, &lead));
        runs.iter()
            .map(|run| Pass {
                cl: run.iter().map(|l| back * l.tip).collect(),
                cc: run.iter().map(|l| back * l.contact).collect(),
                tool_axes: run.iter().map(|l| (back * l.axis).normalize()).collect(),
                // The machine leaves the part altogether between runs: the axis turns on the way.
                retract_height: 0.0,
            })
            .collect()
    }
}

fn cell_at<'a>(growth: &'a mut [Growth], point: &Point3<f64>) -> Option<&'a mut Growth> {
    growth.iter_mut().find(|g| (g.middle - point).norm_squared() < CELL * CELL)
}

/// The frame's orientation with the axis that leans by `lead` (rad) from a normal towards the feed.
fn leaning(frame: &Orientation, normal: &Vector3<f64>, lead: f64) -> Orientation {
    let along = frame.cross_feed.cross(normal).try_normalize(1e-9).unwrap_or(frame.feed);
    Orientation { axis: Unit::new_normalize(normal * lead.cos() + along * lead.sin()), ..*frame }
}

/// Twice the mean over ± half of `reach` places of the largest within `reach`: nowhere below the values, without jumps.
fn smoothed_from_above(values: &[f64], reach: usize) -> Vec<f64> {
    let last = values.len().saturating_sub(1);
    let window = |i: usize, reach: usize| i.saturating_sub(reach)..=(i + reach).min(last);
    let mut smooth: Vec<f64> =
        (0..values.len()).map(|i| values[window(i, reach)].iter().copied().fold(0.0, f64::max)).collect();
    for _ in 0..2 {
        let mean = |i: usize| {
            let values = &smooth[window(i, reach / 2)];
            values.iter().sum::<f64>() / values.len() as f64
        };
        smooth = (0..smooth.len()).map(mean).collect();
    }
    smooth
}

/// One stretch of a pass.
struct Line<'a> {
    plan: &'a Plan<'a>,
    y: f64,
    stretch: (f64, f64),
    borders: [Border; 2],
    leads: Vec<f64>,
}

impl Line<'_> {
    /// Contact and normal at x, continued beyond the borders.
    fn surface(&self, x: f64) -> (Point3<f64>, Vector3<f64>) {
        let cutter = &self.plan.cutter;
        if x < self.stretch.0 {
            return cutter.continued(&self.borders[0], x);
        }
        let beyond = || cutter.continued(&self.borders[1], x);
        if x > self.stretch.1 { beyond() } else { cutter.surface_at(x, self.y).unwrap_or_else(beyond) }
    }

    fn lead(&self, x: f64) -> f64 {
        let place = ((x - self.stretch.0) / LEAD_STEP).clamp(0.0, (self.leads.len() - 1) as f64);
        let below = (place as usize).min(self.leads.len() - 1);
        let above = (below + 1).min(self.leads.len() - 1);
        self.leads[below] + (self.leads[above] - self.leads[below]) * (place - below as f64)
    }

    /// The cutter in contact at x with its axis there, and the normal.
    fn at(&self, x: f64) -> (Location, Vector3<f64>) {
        let (contact, normal) = self.surface(x);
        let along = Vector3::y().cross(&normal).try_normalize(1e-9).unwrap_or_else(Vector3::x);
        let lead = self.lead(x);
        let axis = normal * lead.cos() + along * lead.sin();
        let tip = contact + offset(&axis, &normal, self.plan.shape, self.plan.job.stock_allowance);
        (Location { tip, contact, axis }, normal)
    }

    /// Locations with their x.
    fn follow(&self, nodes: &[f64]) -> Vec<(f64, Location)> {
        let mut locations = vec![(nodes[0], self.at(nodes[0]).0)];
        for pair in nodes.windows(2) {
            let (_, from) = locations[locations.len() - 1];
            self.refine((pair[0], pair[1]), (from, self.at(pair[1]).0), MOST_SPLITS, &mut locations);
        }
        locations
    }

    /// Pushes the locations after the first end, the second one included: halved until the cutter between two locations stays
    /// on the surface within the chord and leans as wanted.
    fn refine(
        &self,
        (t0, t1): (f64, f64),
        (from, to): (Location, Location),
        splits: u32,
        locations: &mut Vec<(f64, Location)>,
    ) {
        let length = (to.tip - from.tip).norm();
        let fits = |share: f64| {
            let (wanted, normal) = self.at(t0 + (t1 - t0) * share);
            self.within_chord(&between(&from, &to, share), &wanted, &normal)
        };
        let fits_all = || fits(0.5) && (length <= ONE_KINK || (fits(0.25) && fits(0.75)));
        if length <= SHORTEST_SEGMENT || splits == 0 || fits_all() {
            locations.push((t1, to));
            return;
        }
        let middle = (t0 + t1) / 2.0;
        let (halfway, _) = self.at(middle);
        self.refine((t0, middle), (from, halfway), splits - 1, locations);
        self.refine((middle, t1), (halfway, to), splits - 1, locations);
    }

    fn within_chord(&self, found: &Location, wanted: &Location, normal: &Vector3<f64>) -> bool {
        let plan = self.plan;
        // Where the cutter as it stands would touch a surface of this normal.
        let touching = found.tip - offset(&found.axis, normal, plan.shape, plan.job.stock_allowance);
        let off = touching - wanted.contact;
        let height = off.dot(normal);
        let turned = (found.axis - wanted.axis).norm() * plan.shape.radius();
        height.abs() <= plan.job.pass_chord
            && (off - normal * height).norm() <= LATERAL_TOLERANCE
            && turned <= 2.0 * plan.job.pass_chord
    }
}

/// From a contact to the tip of the real cutter, `shape` being the one grown by the allowance:
/// R2·n + R1·w/|w| − r2·a, w = n − (n·a)·a.
fn offset(axis: &Vector3<f64>, normal: &Vector3<f64>, shape: Cutter, allowance: f64) -> Vector3<f64> {
    let across = (normal - axis * normal.dot(axis)).try_normalize(1e-9).unwrap_or_default();
    normal * shape.r2 + across * shape.r1 - axis * (shape.r2 - allowance)
}

/// On the way from one location to the next: tip and contact along straight lines, the axis between both.
fn between(from: &Location, to: &Location, share: f64) -> Location {
    Location {
        tip: from.tip + (to.tip - from.tip) * share,
        contact: from.contact + (to.contact - from.contact) * share,
        axis: (from.axis + (to.axis - from.axis) * share).normalize(),
    }
}

/// The places of a pass with those beyond its stretch no farther apart than `LOOSE_STEP`.
fn loose_ends(from: f64, (begin, end): (f64, f64), to: f64, inside: Vec<f64>) -> Vec<f64> {
    let parts = |way: f64| (way / LOOSE_STEP).ceil().max(0.0) as usize;
    let (before, after) = (parts(begin - from), parts(to - end));
    let entry = (0..before).map(|k| from + (begin - from) * k as f64 / before as f64);
    let exit = (1..=after).map(|k| end + (to - end) * k as f64 / after as f64);
    entry.chain(inside).chain(exit).collect()
}

/// A link over the surface, its ends included, a little above the straight way.
fn hop(from: &Location, to: &Location) -> Vec<Location> {
    let moves = ((to.tip - from.tip).norm() / LOOSE_STEP).ceil().max(2.0) as usize;
    let at = |k: usize| {
        let share = k as f64 / moves as f64;
        let location = between(from, to, share);
        // sin²: it leaves and comes back along the straight way.
        let lift = HOP * (std::f64::consts::PI * share).sin().powi(2);
        Location { tip: location.tip + location.axis * lift, ..location }
    };
    (0..=moves).map(at).collect()
}

/// Points of the surface that loose locations keep off: closer than those of the check, and along its border too.
fn obstacle_points(mesh: &TriangleMesh) -> ProofPoints {
    let area = mesh.area();
    let mut points = ProofPoints::on_facets(mesh, OBSTACLES.max((area / MOST_OBSTACLES).sqrt()));
    let topology = MeshTopology::of(mesh);
    for (t, triangle) in mesh.triangles.iter().enumerate() {
        let corners = mesh.corners(t);
        let normal = (corners[1] - corners[0]).cross(&(corners[2] - corners[0])).try_normalize(0.0);
        for (i, j) in [(0, 1), (1, 2), (2, 0)] {
            if topology.across(t, triangle[i], triangle[j]).next().is_some() {
                continue;
            }
            let edge = corners[j] - corners[i];
            let parts = (edge.norm() / BORDER_STEP).ceil().clamp(1.0, 1e5) as usize;
            for k in 0..=parts {
                points.points.push(corners[i] + edge * (k as f64 / parts as f64));
                points.normals.push(normal.unwrap_or_else(Vector3::z));
                points.weights.push(0.0);
            }
        }
    }
    points
}

/// Normal distance from every point of the check to the cutter on its way along the passes, m.
fn swept_residual(surface: &PreparedSurface, patch: &PatchToolpath, job: &Job) -> Vec<f64> {
    let mut residual = vec![f64::INFINITY; surface.check.points.len()];
    let cap = CHECK_CAP * job.scallop_height + job.stock_allowance;
    let poses: Vec<Pose> = patch.passes.par_iter().flat_map_iter(dense_poses).collect();
    let reach = job.tool.length;
    sweep_poses(&surface.check, job.tool.cutter, &poses, reach, cap, &mut residual);
    residual
}

fn dense_poses(pass: &Pass) -> impl Iterator<Item = Pose> + '_ {
    let moves = pass.cl.windows(2).zip(pass.tool_axes.windows(2));
    let first =
        pass.cl.first().zip(pass.tool_axes.first()).map(|(tip, axis)| (*tip, Unit::new_normalize(*axis)));
    first.into_iter().chain(moves.flat_map(|(tips, axes)| {
        let steps = ((tips[1] - tips[0]).norm() / CHECK_STEP).ceil().max(1.0) as usize;
        (1..=steps).map(move |k| {
            let share = k as f64 / steps as f64;
            let axis = axes[0] + (axes[1] - axes[0]) * share;
            (tips[0] + (tips[1] - tips[0]) * share, Unit::new_normalize(axis))
        })
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn smoothing_never_goes_below(values in prop::collection::vec(0.05..0.5f64, 1..80), reach in 0usize..12) {
            let smooth = smoothed_from_above(&values, reach);
            prop_assert_eq!(smooth.len(), values.len());
            for (s, v) in smooth.iter().zip(&values) {
                prop_assert!(*s >= v - 1e-12);
            }
        }

        #[test]
        fn the_offset_touches_the_tangent_plane(lean in 0.05..1.2f64, turn in -3.0..3.0f64, allowance in 0.0..1e-3f64) {
            let normal = Vector3::z();
            let axis = Vector3::new(lean.sin() * turn.cos(), lean.sin() * turn.sin(), lean.cos());
            let (cutter, shape) = (Cutter { r1: 0.013, r2: 0.006 }, Cutter { r1: 0.013, r2: 0.006 + allowance });
            let tip = offset(&axis, &normal, shape, allowance);
            // The torus's lowest point along the normal: C − R2·n − R1·w/|w|, C = tip + R2·a.
            let across = (normal - axis * normal.dot(&axis)).normalize();
            let lowest = tip + axis * cutter.r2 - normal * cutter.r2 - across * cutter.r1;
            prop_assert!((lowest - normal * allowance).norm() < 1e-12);
        }
    }

    #[test]
    fn links_stay_above_the_straight_way() {
        let at = |x: f64| Location {
            tip: Point3::new(x, 0.0, 0.0),
            contact: Point3::new(x, 0.0, 0.0),
            axis: Vector3::z(),
        };
        let link = hop(&at(0.0), &at(4e-3));
        assert!(link.iter().all(|l| l.tip.z >= 0.0 && l.tip.z <= HOP + 1e-12));
        assert_eq!((link[0].tip, link[10].tip.x), (at(0.0).tip, 4e-3));
    }
}
