//! Shank and holder: a stack of coaxial cylinders and cones, and its exact drop along the tool axis on a mesh.
//!
//! The stack counts as reaching up without end: what lies above a part of it, within that part's radius, counts as
//! touched. So the stack is the height H(ρ) of its underside at a distance ρ from the axis, and the lowest tip that keeps
//! it off the mesh at (x, y) is max(z − H(ρ)) over the mesh. On one section, a disc of radius r₀ at height h₀ and a cone of
//! slope s around it up to radius r₁, that is the maximum of the concave function z − h₀ − s·max(0, ρ − r₀) over a triangle
//! cut to ρ ≤ r₁: on the facet only the circles r₀ and r₁ in the direction of its steepest ascent can hold it; on an
//! edge at plan distance e from the axis, of gradient m along its plan length u, the circles' crossings, the ends, and
//! u = e·m/√(s² − m²).

use std::cell::Cell;

use nalgebra::{Matrix3, Point3, Rotation3, Vector3};

use crate::bvh::Bvh;
use crate::mesh::TriangleMesh;

/// A cylinder or cone about the tool axis; heights above the tool tip, m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frustum {
    /// Height of its end towards the tip, m.
    pub low: f64,
    /// Height of its end towards the spindle, m.
    pub high: f64,
    /// Radius at `low`, m.
    pub radius_low: f64,
    /// Radius at `high`, m.
    pub radius_high: f64,
}

impl Frustum {
    /// The part of it that is wider than `radius` (m), reaching from where it becomes so; `None` when it never does.
    pub fn wider_than(&self, radius: f64) -> Option<Self> {
        if self.radius_low.max(self.radius_high) <= radius {
            return None;
        }
        if self.radius_low >= radius {
            return Some(*self);
        }
        let share = (radius - self.radius_low) / (self.radius_high - self.radius_low);
        Some(Self { low: self.low + share * (self.high - self.low), radius_low: radius, ..*self })
    }
}

/// One section's underside: a disc and, for an opening cone, the flank around it.
#[derive(Clone, Copy, Debug)]
struct Section {
    /// Height of the disc above the tip, m.
    height: f64,
    /// Radius of the disc, m.
    inner: f64,
    /// Radius up to which the flank goes, m; `inner` without one.
    outer: f64,
    /// Rise of the flank a metre outward.
    slope: f64,
}

impl Section {
    fn height_at(&self, rho: f64) -> f64 {
        self.height + self.slope * (rho - self.inner).max(0.0)
    }
}

/// The underside of a stack of cylinders and cones.
#[derive(Clone, Debug)]
pub struct ToolStack {
    sections: Vec<Section>,
    reach: f64,
}

impl ToolStack {
    /// The stack grown by `margin` (m) outward and downward, so that a point outside it is at least that far from the
    /// frusta. A cone that narrows towards the spindle counts as a cylinder.
    pub fn new(frusta: &[Frustum], margin: f64) -> Self {
        let section = |f: &Frustum| {
            let widening = f.radius_high - f.radius_low;
            let slope = if widening > 0.0 { (f.high - f.low) / widening } else { 0.0 };
            let (inner, outer) = (f.radius_low + margin, f.radius_low.max(f.radius_high) + margin);
            Section { height: f.low - margin, inner, outer, slope }
        };
        let sections: Vec<Section> = frusta.iter().map(section).collect();
        let reach = sections.iter().map(|s| s.outer).fold(0.0, f64::max);
        Self { sections, reach }
    }

    /// Whether there is nothing of it.
    pub fn is_empty(&self) -> bool {
        self.sections.is_empty()
    }

    /// Height of the underside above the tip at distance `rho` (m) from the axis; `None` outside the stack.
    pub fn height(&self, rho: f64) -> Option<f64> {
        let within = self.sections.iter().filter(|s| rho <= s.outer);
        within.map(|s| s.height_at(rho)).min_by(f64::total_cmp)
    }

    /// Raises `best` to the lowest tip on the axis x = y = 0 that keeps the stack off a triangle.
    fn raise(&self, corners: &[[f64; 3]; 3], best: &mut f64) {
        let top = corners.iter().map(|c| c[2]).fold(f64::NEG_INFINITY, f64::max);
        for section in &self.sections {
            if top - section.height <= *best {
                continue;
            }
            for i in 0..3 {
                raise_edge(section, &corners[i], &corners[(i + 1) % 3], best);
            }
            raise_facet(section, corners, best);
        }
    }
}

fn raise_edge(section: &Section, a: &[f64; 3], b: &[f64; 3], best: &mut f64) {
    let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
    let length = dx.hypot(dy);
    if length < 1e-12 {
        // Upright: its upper end.
        let (rho, z) = (a[0].hypot(a[1]), a[2].max(b[2]));
        if rho <= section.outer {
            *best = best.max(z - section.height_at(rho));
        }
        return;
    }
    let start = (a[0] * dx + a[1] * dy) / length;
    let distance = ((a[0] * dy - a[1] * dx) / length).abs();
    let Some(half) = half_chord(section.outer, distance) else { return };
    let (from, to) = (start.max(-half), (start + length).min(half));
    if from > to {
        return;
    }
    let gradient = (b[2] - a[2]) / length;
    let mut at = |u: f64| {
        let u = u.clamp(from, to);
        let z = a[2] + gradient * (u - start);
        *best = best.max(z - section.height_at(distance.hypot(u).min(section.outer)));
    };
    at(from);
    at(to);
    if section.slope > 0.0 {
        if let Some(half) = half_chord(section.inner, distance) {
            at(half);
            at(-half);
        }
        if gradient.abs() < section.slope {
            at(distance * gradient / (section.slope * section.slope - gradient * gradient).sqrt());
        }
    }
}

/// Half of the chord that a line at `distance` from the axis cuts from a circle.
fn half_chord(radius: f64, distance: f64) -> Option<f64> {
    (distance <= radius).then(|| ((radius - distance) * (radius + distance)).sqrt())
}

fn raise_facet(section: &Section, [a, b, c]: &[[f64; 3]; 3], best: &mut f64) {
    let (u, v) = ([b[0] - a[0], b[1] - a[1], b[2] - a[2]], [c[0] - a[0], c[1] - a[1], c[2] - a[2]]);
    let area = u[0] * v[1] - u[1] * v[0];
    if area == 0.0 {
        return;
    }
    let slope = [(u[2] * v[1] - u[1] * v[2]) / area, (u[0] * v[2] - u[2] * v[0]) / area];
    let steepness = slope[0].hypot(slope[1]);
    let mut at = |radius: f64| {
        let share = if steepness > 0.0 { radius / steepness } else { 0.0 };
        let p = [slope[0] * share, slope[1] * share];
        let d = [p[0] - a[0], p[1] - a[1]];
        let (s, t) = ((d[0] * v[1] - d[1] * v[0]) / area, (u[0] * d[1] - u[1] * d[0]) / area);
        if s >= 0.0 && t >= 0.0 && s + t <= 1.0 {
            *best = best.max(a[2] + s * u[2] + t * v[2] - section.height_at(radius));
        }
    };
    at(section.inner);
    if section.outer > section.inner {
        at(section.outer);
    }
}

/// Where a stack touches.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Touch {
    /// How far the stack has to be raised over the tip to be clear, m.
    pub raise: f64,
    /// Tool tip there, `workpiece` frame.
    pub tip: Point3<f64>,
}

impl Touch {
    /// The one that needs the larger raise; the first where they are equal.
    pub fn worse(a: Option<Self>, b: Option<Self>) -> Option<Self> {
        match (a, b) {
            (Some(a), Some(b)) => Some(if b.raise > a.raise { b } else { a }),
            (a, b) => a.or(b),
        }
    }
}

/// Drops stacks on a mesh along one axis.
#[derive(Clone, Copy, Debug)]
pub struct StackDrop<'a> {
    mesh: &'a TriangleMesh,
    bvh: &'a Bvh,
    /// tool_from_workpiece.
    frame: Rotation3<f64>,
    absolute: Matrix3<f64>,
}

impl<'a> StackDrop<'a> {
    /// Makes ready for the axis that is z of the tool frame, `frame` being tool_from_workpiece.
    pub fn new(mesh: &'a TriangleMesh, bvh: &'a Bvh, frame: Rotation3<f64>) -> Self {
        Self { mesh, bvh, frame, absolute: frame.matrix().abs() }
    }

    /// The lowest height of the tool tip over (x, y), tool frame, m, that keeps the stack off the mesh; `None` when it
    /// is not above `floor`.
    pub fn lowest_tip(&self, stack: &ToolStack, x: f64, y: f64, floor: f64) -> Option<f64> {
        let best = Cell::new(floor);
        let place = Vector3::new(x, y, 0.0);
        let enter = |min: &[f64; 3], max: &[f64; 3]| {
            let (min, max) = (Vector3::from(*min), Vector3::from(*max));
            let centre = self.frame * ((min + max) * 0.5) - place;
            let half = self.absolute * ((max - min) * 0.5);
            let (dx, dy) = ((centre.x.abs() - half.x).max(0.0), (centre.y.abs() - half.y).max(0.0));
            let rho2 = dx * dx + dy * dy;
            let top = centre.z + half.z;
            rho2 <= stack.reach * stack.reach
                && stack.height(rho2.sqrt()).is_some_and(|height| top - height > best.get())
        };
        self.bvh.for_each_triangle(enter, |t| {
            let corners = self.mesh.corners(t as usize).map(|p| (self.frame * p.coords - place).into());
            let mut raised = best.get();
            stack.raise(&corners, &mut raised);
            best.set(raised);
        });
        (best.get() > floor).then_some(best.get())
    }

    /// Where the stack touches with the tip at `tip` (`workpiece` frame, m), if that takes more than `least` (m) of raise.
    pub fn touch(&self, stack: &ToolStack, tip: &Point3<f64>, least: f64) -> Option<Touch> {
        let place = self.frame * tip;
        let lowest = self.lowest_tip(stack, place.x, place.y, place.z + least)?;
        Some(Touch { raise: lowest - place.z, tip: *tip })
    }

    /// The worst touch with the tip on the straight move from `from` to `to` (`workpiece` frame, m), looked at no coarser
    /// than `spacing` (m). Where it finds none, a stack whose margin is at least half of that is clear all along the move.
    pub fn touch_along(
        &self,
        stack: &ToolStack,
        from: &Point3<f64>,
        to: &Point3<f64>,
        spacing: f64,
    ) -> Option<Touch> {
        let parts = ((to - from).norm() / spacing).ceil().max(1.0) as usize;
        let mut worst: Option<Touch> = None;
        for k in 0..=parts {
            let tip = from + (to - from) * (k as f64 / parts as f64);
            let least = worst.map_or(0.0, |w| w.raise);
            worst = self.touch(stack, &tip, least).or(worst);
        }
        worst
    }
}

#[cfg(test)]
mod tests;
