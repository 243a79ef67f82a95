//! The drop of a cutter onto one triangle: its facet, the edges and the corners that it owns.

use crate::contact_tree::{Profile, SLACK};
use crate::edge_contact::inside_contact;

/// Facet contacts outside by up to this share of the triangle still count as inside.
const INSIDE: f64 = 1e-9;
/// Facets with a horizontal share of their unit normal below this are level: the flat bottom rests on them.
const LEVEL: f64 = 1e-14;
/// Facets whose doubled area is below this share of their longest edge squared have no plane that could be
/// relied on to 1e-12 m: their edges hold the tool (the facet bulges over them by far less than that).
const SLIVER: f64 = 1e-5;

const OWN_EDGE: u8 = 1;
const OWN_CORNER: u8 = 8;
const HAS_CONTACT: u8 = 64;
const IS_LEVEL: u8 = 128;

/// A triangle in the tool frame, ready for drops.
#[derive(Clone, Copy, Debug)]
pub(crate) struct DropFacet {
    corners: [[f64; 3]; 3],
    /// Gradient of the facet's plane.
    slope: [f64; 2],
    /// Tip height on the whole plane with the axis over corner 0; +∞ where the plane bounds nothing.
    rest: f64,
    /// From the contact on the plane to the tool axis.
    toe: [f64; 2],
    /// Index of the triangle in the mesh.
    pub(crate) triangle: u32,
    flags: u8,
}

/// The highest contact so far.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Best {
    pub(crate) z: f64,
    pub(crate) contact: [f64; 3],
    pub(crate) triangle: u32,
}

impl DropFacet {
    /// `owned`: bits 0–2 the edges, bits 3–5 the corners to be tested with this triangle.
    pub(crate) fn new(tool: &Profile, corners: [[f64; 3]; 3], triangle: u32, owned: u8) -> Self {
        let edge = |i: usize, j: usize| [0, 1, 2].map(|k| corners[j][k] - corners[i][k]);
        let (u, v, w) = (edge(0, 1), edge(0, 2), edge(1, 2));
        let n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
        let square = |a: &[f64; 3]| a[0] * a[0] + a[1] * a[1] + a[2] * a[2];
        let longest = square(&u).max(square(&v)).max(square(&w));
        let area = square(&n).sqrt();
        let mut facet = Self {
            corners,
            slope: [0.0; 2],
            rest: f64::INFINITY,
            toe: [0.0; 2],
            triangle,
            flags: owned & (HAS_CONTACT - 1),
        };
        let (nx, ny, nz) = (n[0] / area, n[1] / area, n[2] / area);
        // Facets turned away from the tool (and degenerate ones) touch it with edges and corners only.
        if !(area > SLIVER * longest && nz > LEVEL) {
            return facet;
        }
        // Shares of a unit vector: no root overflows, as `hypot` would see to slowly.
        let level = (nx * nx + ny * ny).sqrt();
        let slope = [-nx / nz, -ny / nz];
        facet.flags |= HAS_CONTACT;
        facet.slope = slope;
        facet.rest = corners[0][2] + tool.rise(level / nz);
        facet.toe = [nx, ny].map(|c| tool.r2 * c + if level < LEVEL { 0.0 } else { tool.r1 * c / level });
        if level < LEVEL && tool.r1 > 0.0 {
            facet.flags |= IS_LEVEL;
        }
        facet
    }

    pub(crate) fn corners(&self) -> &[[f64; 3]; 3] {
        &self.corners
    }

    /// Raises `best` to the highest contact of this triangle for a tool axis at (x, y).
    #[inline]
    pub(crate) fn raise(&self, tool: &Profile, x: f64, y: f64, best: &mut Best) {
        let (dx, dy) = (x - self.corners[0][0], y - self.corners[0][1]);
        let tip = self.rest + self.slope[0] * dx + self.slope[1] * dy;
        if tip <= best.z + SLACK {
            return;
        }
        if self.flags & HAS_CONTACT != 0
            && let Some(contact) = self.plane_contact(tool, x, y)
        {
            *best = Best { z: tip, contact, triangle: self.triangle };
            return;
        }
        let local = self.corners.map(|c| [c[0] - x, c[1] - y, c[2]]);
        let offer = |best: &mut Best, z: f64, p: [f64; 3]| {
            if z > best.z {
                *best = Best { z, contact: [p[0] + x, p[1] + y, p[2]], triangle: self.triangle };
            }
        };
        for (k, p) in local.iter().enumerate() {
            let rho2 = p[0] * p[0] + p[1] * p[1];
            if self.flags & (OWN_CORNER << k) != 0 && rho2 <= tool.radius * tool.radius {
                offer(best, p[2] - tool.lift(rho2.sqrt()), *p);
            }
        }
        for k in 0..3 {
            if self.flags & (OWN_EDGE << k) != 0
                && let Some((z, p)) = inside_contact(tool, &local[k], &local[(k + 1) % 3], best.z)
            {
                offer(best, z, p);
            }
        }
    }

    /// Where the cutter resting on the facet's plane touches it, if that is within the facet.
    #[inline]
    fn plane_contact(&self, tool: &Profile, x: f64, y: f64) -> Option<[f64; 3]> {
        let c = &self.corners;
        let (px, py) = (x - self.toe[0], y - self.toe[1]);
        let twice =
            |i: usize, j: usize| (c[j][0] - c[i][0]) * (py - c[i][1]) - (c[j][1] - c[i][1]) * (px - c[i][0]);
        let parts = [twice(0, 1), twice(1, 2), twice(2, 0)];
        let least = -INSIDE * (parts[0] + parts[1] + parts[2]);
        let inside = parts.iter().all(|&a| a >= least);
        let [qx, qy] = if inside {
            [px, py]
        } else if self.flags & IS_LEVEL != 0 {
            self.nearest_in_plan(x, y).filter(|q| (q[0] - x).hypot(q[1] - y) <= tool.r1)?
        } else {
            return None;
        };
        let z = c[0][2] + self.slope[0] * (qx - c[0][0]) + self.slope[1] * (qy - c[0][1]);
        Some([qx, qy, z])
    }

    /// The point of the outline that is nearest to the axis in plan.
    fn nearest_in_plan(&self, x: f64, y: f64) -> Option<[f64; 2]> {
        let on_edge = |k: usize| {
            let (a, b) = (&self.corners[k], &self.corners[(k + 1) % 3]);
            let (ux, uy) = (b[0] - a[0], b[1] - a[1]);
            let t = (((x - a[0]) * ux + (y - a[1]) * uy) / (ux * ux + uy * uy)).clamp(0.0, 1.0);
            [a[0] + ux * t, a[1] + uy * t]
        };
        let distance = |q: &[f64; 2]| (q[0] - x).hypot(q[1] - y);
        (0..3).map(on_edge).min_by(|p, q| distance(p).total_cmp(&distance(q)))
    }
}
