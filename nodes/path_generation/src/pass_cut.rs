//! One pass: the cutter led along a plane or curve of the patch, every cutter location an exact drop on the whole mesh.

use std::f64::consts::FRAC_PI_2;

use nalgebra::{Matrix3, Point3, Rotation3, Unit, Vector3};
use patchmill_geometry::bvh::Bvh;
use patchmill_geometry::cutter::Cutter;
use patchmill_geometry::drop_cutter::{DropCutter, tool_frame};
use patchmill_geometry::mesh::TriangleMesh;
use patchmill_products::toolpath::Pass;

use crate::assembly::{Assembly, Collision, HeldAssembly};
use crate::pass_layout::PassLine;
use crate::sample_interpolation::SampleInterpolation;
use patchmill_orientation::orientation::Orientation;

/// A cutter location and its cutter contact point, both in the tool frame (z = tool axis, x = feed), m.
#[derive(Clone, Copy, Debug)]
pub struct Location {
    /// Tool tip.
    pub tip: Point3<f64>,
    /// Cutter contact point.
    pub contact: Point3<f64>,
    /// Unit tool axis, tip to spindle: z but where five axes move at once.
    pub axis: Vector3<f64>,
}

/// Where the cutter is wanted: the place of its axis and the height that it must not go below.
#[derive(Clone, Copy, Debug)]
struct Wanted {
    x: f64,
    y: f64,
    /// Lower bound of the tip's height, m.
    floor: f64,
    /// Whether the floor holds the cutter up (beyond the border and on links) or only speeds up the drop.
    held: bool,
    contact: Point3<f64>,
}

/// Where a pass leaves the surface, and how the surface would go on.
pub(crate) struct Border {
    x: f64,
    pub(crate) contact: Point3<f64>,
    normal: Vector3<f64>,
    /// Unit tangent of the contact curve, towards +x.
    along: Vector3<f64>,
    curvature: Matrix3<f64>,
}

/// Largest distance of the chord from the wanted curve across the tool axis, m. It shifts the contact only, so it costs
/// step-over (0.3 % of a 3 mm step), never a gouge.
pub(crate) const LATERAL_TOLERANCE: f64 = 10e-6;
/// Segments are not split below this length, m.
pub(crate) const SHORTEST_SEGMENT: f64 = 20e-6;
/// A stretch is halved no more often than this: 4 mm come down to 0.1 µm, and only a jump is left.
pub(crate) const MOST_SPLITS: u32 = 15;
/// On a move up to this long one look at its middle is enough, m: a kink of the exact curve anywhere on it (the cutter rolls
/// over one facet edge) shows there with at least half of its height.
pub(crate) const ONE_KINK: f64 = 0.5e-3;
/// Straight moves of a lead arc.
pub(crate) const LEAD_MOVES: usize = 12;
/// Steps in which a plane is searched for surface, m: a shorter stretch without surface is not noticed.
const SAMPLE_STEP: f64 = 1e-3;

/// Cuts the passes of one patch.
pub struct PatchCutter<'a> {
    mesh: &'a TriangleMesh,
    bvh: &'a Bvh,
    shapes: &'a SampleInterpolation,
    drop_cutter: DropCutter<'a>,
    /// tool_from_workpiece.
    frame: Rotation3<f64>,
    cutter: Cutter,
    chord: f64,
    longest_segment: f64,
    /// Extent of the mesh along the tool axis, tool frame, m.
    height: (f64, f64),
    /// Passes go on so far beyond open borders, m.
    border_margin: f64,
    /// Shank and holder, where they are wider than the cutter.
    held: Option<HeldAssembly<'a>>,
}

impl<'a> PatchCutter<'a> {
    /// Makes ready for one orientation. `chord` is the job's chord of a pass, m.
    pub fn new(
        mesh: &'a TriangleMesh,
        bvh: &'a Bvh,
        shapes: &'a SampleInterpolation,
        cutter: Cutter,
        orientation: &Orientation,
        chord: f64,
    ) -> Self {
        let frame = tool_frame(&orientation.axis, &orientation.feed);
        let drop_cutter = DropCutter::in_frame(mesh, bvh, cutter, frame);
        let height = bvh.extent_along(&orientation.axis).unwrap_or_default();
        Self {
            mesh,
            bvh,
            shapes,
            drop_cutter,
            frame,
            cutter,
            chord,
            longest_segment: longest_segment(mesh, chord),
            height,
            border_margin: 0.0,
            held: None,
        }
    }

    /// The same cutter, its passes going on so far beyond open borders, m.
    pub fn with_border_margin(self, border_margin: f64) -> Self {
        Self { border_margin, ..self }
    }

    /// The same cutter with shank and holder over it: lifts between passes clear them too.
    pub fn with_assembly(self, assembly: &'a Assembly) -> Self {
        let held = HeldAssembly::new(assembly, self.mesh, self.bvh, self.frame);
        Self { held: Some(held), ..self }
    }

    /// Gives back the memory that drops have taken; the next ones take it again.
    pub fn release(&mut self) {
        self.drop_cutter.release();
    }

    /// Where shank and holder touch the part along passes, `workpiece` frame.
    pub fn collision(&self, passes: &[Pass], axis: &Unit<Vector3<f64>>) -> Collision {
        self.held.map_or(Collision::default(), |held| held.collision_along(passes, axis))
    }

    /// tool_from_workpiece: z along the tool axis, x along the feed, origin at the workpiece origin.
    pub fn frame(&self) -> &Rotation3<f64> {
        &self.frame
    }

    /// The pass over x in `interval` along a line (tool frame, m), beyond open borders too; a piece for every stretch of
    /// surface, in the sense of +x.
    pub fn pass(&self, line: PassLine, interval: (f64, f64)) -> Vec<Vec<Location>> {
        let stretches = self.stretches(line, interval);
        let mut pieces = Vec::with_capacity(stretches.len());
        for (i, &(begin, end)) in stretches.iter().enumerate() {
            let (from, to) = self.ends_of(&stretches, i, interval);
            let (Some(first), Some(last)) = (self.border(begin, line), self.border(end, line)) else {
                continue;
            };
            let wanted = |x: f64| {
                if x < begin {
                    self.beyond(&first, x)
                } else if x > end {
                    self.beyond(&last, x)
                } else {
                    self.over(x, line.at(x).0)
                        .unwrap_or_else(|| self.beyond(if x - begin < end - x { &first } else { &last }, x))
                }
            };
            pieces.push(self.follow(&wanted, &self.nodes(from, (begin, end), to), true));
        }
        pieces
    }

    /// From where to where the pass over stretch `i` runs: at the ends as far as asked and by the margin beyond open borders,
    /// towards a hole over half of it, at most 2 mm.
    pub(crate) fn ends_of(&self, stretches: &[(f64, f64)], i: usize, interval: (f64, f64)) -> (f64, f64) {
        let (begin, end) = stretches[i];
        // A stretch that begins or ends within the interval does so at an open border; at the ends of the interval other
        // patches go on.
        let margin = |border: bool| if border { self.border_margin } else { 0.0 };
        let from = if i == 0 {
            interval.0.min(begin - margin(begin > interval.0))
        } else {
            begin - half_gap(stretches[i - 1].1, begin)
        };
        let to = if i + 1 == stretches.len() {
            interval.1.max(end + margin(end < interval.1))
        } else {
            end + half_gap(end, stretches[i + 1].0)
        };
        (from, to)
    }

    /// Places on a pass from `from` over a stretch to `to`, no farther apart than the longest segment.
    pub(crate) fn nodes(&self, from: f64, (begin, end): (f64, f64), to: f64) -> Vec<f64> {
        let mut nodes = vec![from.min(begin)];
        for (a, b) in [(from.min(begin), begin), (begin, end), (end, to.max(end))] {
            let parts = ((b - a) / self.longest_segment).ceil() as usize;
            nodes.extend((1..=parts).map(|k| a + (b - a) * k as f64 / parts as f64));
        }
        nodes
    }

    /// The arc at feed on which a pass is left over its `end`, its location before being `inward`: along the pass first, up the
    /// tool axis last, never in the part. Without the end itself; empty where the radius (m) is 0.
    pub fn lead(&self, end: &Location, inward: &Location, radius: f64) -> Vec<Location> {
        let Some(arc) = lead_arc(end, inward, radius) else { return Vec::new() };
        let wanted = |angle: f64| {
            let tip = arc(angle);
            Wanted { x: tip.x, y: tip.y, floor: tip.z, held: true, contact: end.contact }
        };
        self.follow(&wanted, &lead_angles(), false).split_off(1)
    }

    /// The straight link between two cutter locations at feed: never below the line between them, never in the part.
    pub fn link(&self, from: &Location, to: &Location) -> Vec<Location> {
        let wanted = |t: f64| {
            let tip = from.tip + (to.tip - from.tip) * t;
            let contact = from.contact + (to.contact - from.contact) * t;
            Wanted { x: tip.x, y: tip.y, floor: tip.z, held: true, contact }
        };
        let parts = ((to.tip - from.tip).norm() / self.longest_segment).ceil().max(1.0) as usize;
        let nodes: Vec<f64> = (0..=parts).map(|k| k as f64 / parts as f64).collect();
        self.follow(&wanted, &nodes, false)
    }

    /// Largest height of the dropped tool's tip on the straight line between two places (tool frame, m), sampled every
    /// millimetre: what a rapid across has to clear, before its clearance is added.
    pub fn highest_between(&self, from: &Point3<f64>, to: &Point3<f64>) -> f64 {
        let parts = ((to.xy() - from.xy()).norm() / 1e-3).ceil().max(1.0) as usize;
        let places = (0..=parts).map(|k| from + (to - from) * (k as f64 / parts as f64));
        let between = places.clone().filter_map(|p| self.drop_from(p.x, p.y, f64::NEG_INFINITY));
        let cutter = between.fold(from.z.max(to.z), f64::max);
        match &self.held {
            Some(held) => places.fold(cutter, |level, p| held.lowest_tip(p.x, p.y, level)),
            None => cutter,
        }
    }

    /// Stretches of x in which a line meets the surface, ends found to a micrometre.
    pub(crate) fn stretches(&self, line: PassLine, interval: (f64, f64)) -> Vec<(f64, f64)> {
        let parts = ((interval.1 - interval.0) / SAMPLE_STEP).ceil().max(2.0) as usize;
        let at = |k: usize| interval.0 + (interval.1 - interval.0) * k as f64 / parts as f64;
        let meets = |x: f64| self.surface_at(x, line.at(x).0).is_some();
        let edge = |mut inside: f64, mut outside: f64| {
            while (outside - inside).abs() > 1e-6 {
                let middle = (inside + outside) / 2.0;
                if meets(middle) { inside = middle } else { outside = middle }
            }
            inside
        };
        let (mut found, mut begin) = (Vec::new(), None);
        for k in 0..=parts {
            match (meets(at(k)), begin) {
                (true, None) => begin = Some(if k == 0 { at(0) } else { edge(at(k), at(k - 1)) }),
                (false, Some(from)) => {
                    found.push((from, edge(at(k - 1), at(k))));
                    begin = None;
                }
                _ => {}
            }
        }
        if let Some(from) = begin {
            found.push((from, interval.1));
        }
        found
    }

    /// Facet point and smooth normal under (x, y), tool frame: the first one seen along the tool axis. Check surface is none: passes
    /// end there as at a border.
    pub(crate) fn surface_at(&self, x: f64, y: f64) -> Option<(Point3<f64>, Vector3<f64>)> {
        let (low, high) = self.height;
        let margin = 1e-3;
        let origin = self.frame.inverse_transform_point(&Point3::new(x, y, high + margin));
        let down = self.frame.inverse_transform_vector(&-Vector3::z());
        let hit = self.bvh.first_hit(self.mesh, &origin, &down, (0.0, high - low + 2.0 * margin))?;
        if !self.mesh.is_finished(hit.triangle as usize) {
            return None;
        }
        let (_, normal) = self.mesh.smooth_point(hit.triangle as usize, hit.barycentric);
        Some((Point3::new(x, y, high + margin - hit.distance), self.frame * normal))
    }

    /// The cutter in contact at a point of given normal: C = P + R2·n + R1·w/|w|, tip = C − R2·a, tool frame.
    fn tip_at(&self, contact: &Point3<f64>, normal: &Vector3<f64>) -> Point3<f64> {
        let horizontal = normal.xy();
        let outward = horizontal.try_normalize(1e-9).unwrap_or_default() * self.cutter.r1;
        contact + normal * self.cutter.r2 + Vector3::new(outward.x, outward.y, -self.cutter.r2)
    }

    fn over(&self, x: f64, y: f64) -> Option<Wanted> {
        let (contact, normal) = self.surface_at(x, y)?;
        let tip = self.tip_at(&contact, &normal);
        // The contact point belongs to the mesh, so no drop ends below the tip that touches it.
        Some(Wanted { x: tip.x, y: tip.y, floor: tip.z, held: false, contact })
    }

    pub(crate) fn border(&self, x: f64, line: PassLine) -> Option<Border> {
        let (y, slope) = line.at(x);
        let (contact, normal) = self.surface_at(x, y)?;
        let along = Vector3::new(-slope, 1.0, 0.0).cross(&normal).try_normalize(1e-9)?;
        let in_workpiece = self.frame.inverse_transform_point(&contact);
        let rotation = self.frame.matrix();
        let curvature = rotation * self.shapes.at(&in_workpiece).curvature * rotation.transpose();
        Some(Border { x, contact, normal, along, curvature })
    }

    /// Beyond a border the surface is continued to second order: point and normal.
    pub(crate) fn continued(&self, border: &Border, x: f64) -> (Point3<f64>, Vector3<f64>) {
        let length = (x - border.x) / border.along.x.max(0.1);
        let bend = border.curvature * border.along;
        let normal = (border.normal - bend * length).normalize();
        let rise = 0.5 * border.along.dot(&bend) * length * length;
        (border.contact + border.along * length + border.normal * rise, normal)
    }

    /// Beyond a border the continued surface holds the cutter.
    fn beyond(&self, border: &Border, x: f64) -> Wanted {
        let (contact, normal) = self.continued(border, x);
        let tip = self.tip_at(&contact, &normal);
        Wanted { x: tip.x, y: tip.y, floor: tip.z, held: true, contact }
    }

    fn settle(&self, wanted: &Wanted) -> Location {
        let z = self.height_at(wanted.x, wanted.y, wanted.floor);
        Location { tip: Point3::new(wanted.x, wanted.y, z), contact: wanted.contact, axis: Vector3::z() }
    }

    /// The larger of `floor` and the dropped tip's height.
    fn height_at(&self, x: f64, y: f64, floor: f64) -> f64 {
        self.drop_from(x, y, floor).map_or(floor, |z| z.max(floor))
    }

    /// Height of the dropped tip, m, if not below `floor`.
    fn drop_from(&self, x: f64, y: f64, floor: f64) -> Option<f64> {
        self.drop_cutter.drop_from(x, y, floor).map(|drop| drop.z)
    }

    /// Cutter locations along `wanted` over the given parameters, bisected until straight moves are within the chord. Where
    /// the curve jumps (the surface folds under the tool axis) a straight link bridges the jump, if `bridging`.
    fn follow(&self, wanted: &dyn Fn(f64) -> Wanted, nodes: &[f64], bridging: bool) -> Vec<Location> {
        let mut locations = vec![self.settle(&wanted(nodes[0]))];
        for pair in nodes.windows(2) {
            let end = self.settle(&wanted(pair[1]));
            let span = Span {
                parameters: (pair[0], pair[1]),
                ends: (locations[locations.len() - 1], end),
                splits: MOST_SPLITS,
                bridging,
            };
            self.refine(wanted, span, &mut locations);
        }
        locations
    }

    /// Pushes the locations after the first end of the span, its second end included.
    fn refine(&self, wanted: &dyn Fn(f64) -> Wanted, span: Span, locations: &mut Vec<Location>) {
        let ((t0, t1), (from, to)) = (span.parameters, span.ends);
        let chord = to.tip - from.tip;
        let fits = |share: f64| {
            let (aim, point) = (wanted(t0 + (t1 - t0) * share), from.tip + chord * share);
            let off = Vector3::new(aim.x - point.x, aim.y - point.y, 0.0);
            let lateral = if chord.xy().norm() > 0.0 {
                (off.xy().perp(&chord.xy()) / chord.xy().norm()).abs()
            } else {
                off.norm()
            };
            if lateral > LATERAL_TOLERANCE {
                return false;
            }
            let mut height = self.height_at(point.x, point.y, point.z - 3.0 * self.chord);
            if aim.held {
                // The floor is known at the aim; carried over along the chord's own slope.
                let slope = chord.xy().dot(&off.xy()) / chord.xy().norm_squared().max(1e-18) * chord.z;
                height = height.max(aim.floor - slope);
            }
            (height - point.z).abs() <= self.chord
        };
        let length = chord.norm();
        let fits_all = || fits(0.5) && (length <= ONE_KINK || (fits(0.25) && fits(0.75)));
        if length <= SHORTEST_SEGMENT || fits_all() {
            locations.push(to);
            return;
        }
        if span.splits == 0 {
            if span.bridging {
                locations.extend_from_slice(&self.link(&from, &to)[1..]);
            } else {
                locations.push(to);
            }
            return;
        }
        let middle = (t0 + t1) / 2.0;
        let between = self.settle(&wanted(middle));
        for (parameters, ends) in [((t0, middle), (from, between)), ((middle, t1), (between, to))] {
            self.refine(wanted, Span { parameters, ends, splits: span.splits - 1, ..span }, locations);
        }
    }
}

/// A stretch of a pass between two cutter locations.
#[derive(Clone, Copy)]
struct Span {
    parameters: (f64, f64),
    ends: (Location, Location),
    /// Times that it may still be halved.
    splits: u32,
    bridging: bool,
}

/// Angles of a lead arc's locations, rad, from the pass on.
pub(crate) fn lead_angles() -> Vec<f64> {
    (0..=LEAD_MOVES).map(|k| FRAC_PI_2 * k as f64 / LEAD_MOVES as f64).collect()
}

/// Tips on a quarter circle that leaves a pass over its `end`, its location before being `inward`, by the angle in rad; `None`
/// where the radius (m) is 0 or the pass has no direction there.
pub(crate) fn lead_arc(
    end: &Location,
    inward: &Location,
    radius: f64,
) -> Option<impl Fn(f64) -> Point3<f64> + use<>> {
    let onward = (end.tip - inward.tip).try_normalize(1e-9).filter(|_| radius > 0.0)?;
    let up = (end.axis - onward * end.axis.dot(&onward)).try_normalize(1e-6)?;
    let tip = end.tip;
    Some(move |angle: f64| tip + onward * (radius * angle.sin()) + up * (radius * (1.0 - angle.cos())))
}

/// Half of a gap between stretches, at most 2 mm.
fn half_gap(end: f64, begin: f64) -> f64 {
    ((begin - end) / 2.0).min(2e-3)
}

/// Straight moves are looked at no coarser than this, m: the mean facet edge where facets are coarse enough to be felt
/// through the chord tolerance, 4 mm on fine meshes.
fn longest_segment(mesh: &TriangleMesh, chord: f64) -> f64 {
    if mesh.chord_error <= chord || mesh.triangles.is_empty() {
        return 4e-3;
    }
    let edges: f64 = (0..mesh.triangles.len())
        .map(|t| {
            let [a, b, c] = mesh.corners(t);
            (b - a).norm() + (c - b).norm() + (a - c).norm()
        })
        .sum();
    (edges / (3 * mesh.triangles.len()) as f64).clamp(0.1e-3, 4e-3)
}
