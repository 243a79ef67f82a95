//! Whether the tool stays clear of the part while it moves between orientations.
//!
//! The part is taken as a convex body: the corners of boxes around the mesh's vertices, cell by cell, and a block
//! below it. The tool is a cylinder of the cutter's radius from the tip upward, and the sections of shank and holder that
//! are wider. Along a unit direction d the gap between two convex bodies is at least min(tool·d) − max(part·d), so any
//! direction with a wide enough gap proves them apart. Directions that usually separate are tried; finding none counts as not clear, which errs on the safe side.

use nalgebra::{Point3, Unit, Vector3};
use patchmill_geometry::mesh::TriangleMesh;
use patchmill_geometry::tool_stack::Frustum;
use patchmill_kinematics::{Joints, Machine, Pose};
use patchmill_products::job::Tool;

/// The part's block reaches this far below its lowest point, m.
const BLOCK_DEPTH: f64 = 0.05;
/// Length of the cutter's cylinder that is kept clear, from the tip upward, m.
pub(crate) const TOOL_REACH: f64 = 0.15;
/// Cells along the longer side of the part.
const CELLS: usize = 32;

/// What of a tool is kept clear: the cutter's cylinder and the wider sections above it.
#[derive(Clone, Debug)]
pub struct ToolBody {
    sections: Vec<Frustum>,
}

impl ToolBody {
    /// The body of a job's tool.
    pub fn of(tool: &Tool) -> Self {
        let radius = tool.cutter.radius();
        let cutter = Frustum { low: 0.0, high: TOOL_REACH, radius_low: radius, radius_high: radius };
        let above = tool.shank().into_iter().chain(tool.holder_frusta());
        let wider = above.filter_map(|section| section.wider_than(radius));
        Self { sections: std::iter::once(cutter).chain(wider).collect() }
    }
}

/// A convex body around the part.
#[derive(Clone, Debug)]
pub struct PartBody {
    corners: Vec<Point3<f64>>,
    low: Point3<f64>,
    high: Point3<f64>,
}

impl PartBody {
    /// The body around a mesh; `None` for a mesh without vertices.
    pub fn around(mesh: &TriangleMesh) -> Option<Self> {
        let (low, high) = bounds(&mesh.vertices)?;
        let cell = ((high.x - low.x).max(high.y - low.y) / CELLS as f64).max(1e-6);
        let place = |v: f64, l: f64| (((v - l) / cell) as usize).min(CELLS);
        let mut boxes: Vec<Option<(Point3<f64>, Point3<f64>)>> = vec![None; (CELLS + 1) * (CELLS + 1)];
        for v in &mesh.vertices {
            let b = &mut boxes[place(v.x, low.x) * (CELLS + 1) + place(v.y, low.y)];
            *b = Some(b.map_or((*v, *v), |(l, h)| (l.inf(v), h.sup(v))));
        }
        // The lower corners of the cells lie between the upper ones and the block below.
        let mut corners: Vec<Point3<f64>> = boxes
            .iter()
            .flatten()
            .flat_map(|(l, h)| box_corners(&Point3::new(l.x, l.y, h.z), h)[4..].to_vec())
            .collect();
        let floor = Point3::new(low.x, low.y, low.z - BLOCK_DEPTH);
        corners.extend(box_corners(&floor, &Point3::new(high.x, high.y, low.z)));
        Some(Self { corners, low: floor, high })
    }

    /// Largest extent along `direction` (unit), m.
    pub fn extent(&self, direction: &Vector3<f64>) -> f64 {
        self.corners.iter().map(|c| c.coords.dot(direction)).fold(f64::NEG_INFINITY, f64::max)
    }

    /// Whether a tool at `pose` is at least `margin` (m) away from the part.
    pub fn is_clear(&self, pose: &Pose, tool: &ToolBody, margin: f64) -> bool {
        tool.sections.iter().all(|section| self.is_clear_of(pose, section, margin))
    }

    fn is_clear_of(&self, pose: &Pose, section: &Frustum, margin: f64) -> bool {
        let axis = pose.axis.into_inner();
        let (bottom, top) = (pose.tip + axis * section.low, pose.tip + axis * section.high);
        let middle = self.nearest_on_axis(&pose.tip, &axis, section).coords;
        let on_box = middle.sup(&self.low.coords).inf(&self.high.coords);
        let outward = Unit::try_new(middle - on_box, 1e-9).map(Unit::into_inner);
        let [x, y, z] = [Vector3::x(), Vector3::y(), Vector3::z()];
        let tried = [Some(axis), Some(z), outward, Some(x), Some(-x), Some(y), Some(-y)];
        tried.into_iter().flatten().any(|d| {
            let across = (1.0 - d.dot(&axis).powi(2)).max(0.0).sqrt();
            let low = bottom.coords.dot(&d) - section.radius_low * across;
            let tool = low.min(top.coords.dot(&d) - section.radius_high * across);
            tool - self.extent(&d) >= margin
        })
    }

    /// The point of a section's axis nearest to the part's box (the distance is convex along the axis).
    fn nearest_on_axis(&self, tip: &Point3<f64>, axis: &Vector3<f64>, section: &Frustum) -> Point3<f64> {
        let distance = |t: f64| {
            let p = (tip + axis * t).coords;
            (p - p.sup(&self.low.coords).inf(&self.high.coords)).norm_squared()
        };
        let (mut a, mut b) = (section.low, section.high);
        for _ in 0..30 {
            let (l, r) = (a + (b - a) / 3.0, b - (b - a) / 3.0);
            if distance(l) <= distance(r) { b = r } else { a = l }
        }
        tip + axis * (0.5 * (a + b))
    }

    /// Whether a tool keeps `margin` (m) to the part along a rapid that moves all axes in
    /// proportion, as the control does.
    pub fn clears(
        &self,
        machine: &Machine,
        from: &Joints,
        to: &Joints,
        tool: &ToolBody,
        margin: f64,
    ) -> bool {
        // Steps so short that between two of them nothing near the part moves by more than the margin.
        let linear: f64 = (0..3).map(|j| (to[j] - from[j]).abs()).sum();
        let turned: f64 = (3..5).map(|j| (to[j] - from[j]).abs()).sum();
        let steps = (2.0 * linear / margin + 0.3 * turned / margin).ceil().clamp(1.0, 20_000.0) as usize;
        (0..=steps).all(|i| {
            let s = i as f64 / steps as f64;
            let q = std::array::from_fn(|j| from[j] + (to[j] - from[j]) * s);
            self.is_clear(&machine.pose(&q), tool, margin)
        })
    }
}

fn bounds(points: &[Point3<f64>]) -> Option<(Point3<f64>, Point3<f64>)> {
    let first = points.first()?;
    Some(points.iter().fold((*first, *first), |(l, h), p| (l.inf(p), h.sup(p))))
}

fn box_corners(l: &Point3<f64>, h: &Point3<f64>) -> [Point3<f64>; 8] {
    let pick = |bit: usize, i: usize, l: f64, h: f64| if i >> bit & 1 == 0 { l } else { h };
    std::array::from_fn(|i| Point3::new(pick(0, i, l.x, h.x), pick(1, i, l.y, h.y), pick(2, i, l.z, h.z)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use patchmill_geometry::cutter::Cutter;
    use patchmill_products::job::HolderSection;

    fn plate() -> PartBody {
        let vertices = vec![
            Point3::new(0.0, 0.0, 0.0),
            Point3::new(0.1, 0.0, 0.0),
            Point3::new(0.1, 0.08, 0.01),
            Point3::new(0.0, 0.08, 0.0),
        ];
        PartBody::around(&TriangleMesh { vertices, ..TriangleMesh::default() }).unwrap()
    }

    fn bare() -> Tool {
        Tool::bare(Cutter { r1: 0.01, r2: 0.01 }, 0.1)
    }

    fn clear_with(tool: &Tool, tip: [f64; 3], axis: [f64; 3], margin: f64) -> bool {
        let pose = Pose { tip: tip.into(), axis: Unit::new_normalize(axis.into()) };
        plate().is_clear(&pose, &ToolBody::of(tool), margin)
    }

    fn clear(tip: [f64; 3], axis: [f64; 3], margin: f64) -> bool {
        clear_with(&bare(), tip, axis, margin)
    }

    #[test]
    fn a_holder_beside_the_part_counts_and_one_above_it_does_not() {
        let section = |length, radius| HolderSection { length, radius_low: radius, radius_high: radius };
        let held =
            |stick_out| Tool { holder: vec![section(0.03, 0.04)], ..Tool::bare(bare().cutter, stick_out) };
        let (up, beside) = ([0.0, 0.0, 1.0], [0.125, 0.04, -0.04]);
        assert!(clear(beside, up, 0.004));
        assert!(clear_with(&held(0.1), beside, up, 0.004), "its bottom is 30 mm above z = 0");
        assert!(!clear_with(&held(0.06), beside, up, 0.0), "its flank is at x = 85 mm, from z = -10 mm up");
    }

    #[test]
    fn above_beside_and_inside() {
        let up = [0.0, 0.0, 1.0];
        for (tip, gap) in [([0.05, 0.04, 0.02], 0.01), ([0.13, 0.04, -0.02], 0.01)] {
            assert!(clear(tip, up, gap - 1e-6) && !clear(tip, up, gap + 1e-6), "{tip:?}");
        }
        assert!(!clear([0.05, 0.04, 0.005], up, 0.0));
        // A tilted tool whose tip is clear but whose body lies across the part.
        assert!(!clear([-0.03, 0.04, 0.0], [1.0, 0.0, 0.1], 0.0));
        // Off a corner only the outward direction separates.
        assert!(clear([0.115, 0.095, -0.02], up, 0.001));
    }
}
