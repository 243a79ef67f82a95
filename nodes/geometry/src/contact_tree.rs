//! The search for the highest contact under a cutter: branch and bound over boxes with planes on top.
//!
//! Seen in a tool frame (z = tool axis) a cutter dropped at (x, y) onto points p rests at the tip height
//! max over p of F(p) = p.z − lift(ρ(p)), ρ = distance of p from the tool axis. Over a plane F is concave, so
//! its tangent at any one point bounds it from above, to second order over a small box.

use crate::cutter::Cutter;

/// Results may miss the true height by this much, m: what cannot lift the tool by more is left out.
pub(crate) const SLACK: f64 = 1e-13;
/// Share of the corner radius up to which bounds take their tangents (at 1 the lift is vertical).
pub(crate) const TANGENT_REACH: f64 = 0.97;

/// Tangents tried for a node's bound.
const TANGENTS: u32 = 2;

/// A cutter's profile with what the inner loops need of it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Profile {
    pub(crate) r1: f64,
    pub(crate) r2: f64,
    pub(crate) radius: f64,
}

impl Profile {
    pub(crate) fn of(cutter: Cutter) -> Self {
        Self { r1: cutter.r1, r2: cutter.r2, radius: cutter.radius() }
    }

    /// Height of the cutter's surface above its tip; `rho` beyond the radius counts as the radius.
    #[inline]
    pub(crate) fn lift(&self, rho: f64) -> f64 {
        let w = rho - self.r1;
        if w <= 0.0 || self.r2 == 0.0 {
            return 0.0;
        }
        w * w / (self.r2 + (self.r2 * self.r2 - w * w).max(0.0).sqrt())
    }

    /// Tip height above a plane of slope g at the axis, the cutter resting on it: max over ρ of gρ − lift(ρ).
    #[inline]
    pub(crate) fn rise(&self, slope: f64) -> f64 {
        // √(1+g²) − 1, without loss of digits at small slopes
        let root = (1.0 + slope * slope).sqrt();
        self.r1 * slope + self.r2 * slope * slope / (root + 1.0)
    }

    /// From the contact on a plane of gradient `slope` to the tool axis: against the slope, (R1 + R2 sin φ) long.
    #[inline]
    pub(crate) fn toe(&self, slope: [f64; 2]) -> [f64; 2] {
        let g = steepness(slope);
        if g == 0.0 {
            return [0.0; 2];
        }
        let length = self.r1 + self.r2 * g / (1.0 + g * g).sqrt();
        [-slope[0] / g * length, -slope[1] / g * length]
    }
}

/// Length of a gradient: of no more than a few thousand, where `hypot`'s care for overflow is not needed.
#[inline]
pub(crate) fn steepness([x, y]: [f64; 2]) -> f64 {
    (x * x + y * y).sqrt()
}

/// A node's bounds: a box in x and y, and a plane that nothing of the node stands above.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct ContactNode {
    /// Centre of the box.
    pub(crate) centre: [f64; 2],
    /// Half extents of the box.
    pub(crate) half: [f64; 2],
    /// Gradient of the plane.
    pub(crate) slope: [f64; 2],
    /// Height of the plane over `centre`.
    pub(crate) top: f64,
    /// From the contact on the plane to the tool axis.
    pub(crate) toe: [f64; 2],
    /// [`Profile::rise`] on the plane.
    pub(crate) rise: f64,
    /// First item in leaf order.
    pub(crate) first: u32,
    /// Items of a leaf; 0 for an inner node.
    pub(crate) count: u32,
    /// Right child; the left one follows its parent.
    pub(crate) right: u32,
}

impl ContactNode {
    /// An upper bound of F over the node for a tool axis at (x, y); −∞ where the tool does not reach it.
    /// Worth no more than `floor` is told early.
    #[inline]
    fn bound(&self, tool: &Profile, x: f64, y: f64, floor: f64) -> f64 {
        let (dx, dy) = (self.centre[0] - x, self.centre[1] - y);
        let (gap_x, gap_y) = ((dx.abs() - self.half[0]).max(0.0), (dy.abs() - self.half[1]).max(0.0));
        if gap_x * gap_x + gap_y * gap_y > tool.radius * tool.radius {
            return f64::NEG_INFINITY;
        }
        // The whole plane under the tool ...
        let whole = self.top - self.slope[0] * dx - self.slope[1] * dy + self.rise;
        if whole <= floor {
            return whole;
        }
        // The tangent of F at the point of the box nearest to where the tool would rest on the plane ...
        // (`f64::clamp` would panic on NaN.)
        let clamp = |px: f64, py: f64| {
            (px.max(-self.half[0]).min(self.half[0]), py.max(-self.half[1]).min(self.half[1]))
        };
        let mut bound = whole;
        let (mut px, mut py) = clamp(-self.toe[0] - dx, -self.toe[1] - dy);
        // ... and at the maximum over the box of the quadratic about it.
        for _ in 0..TANGENTS {
            let (qx, qy) = (dx + px, dy + py);
            let rho = (qx * qx + qy * qy).sqrt();
            let flat = self.top + self.slope[0] * px + self.slope[1] * py;
            if rho <= tool.r1 || tool.r2 == 0.0 {
                // Under the flat bottom the tangent is the plane itself.
                return bound.min(self.highest(self.slope) + self.top);
            }
            let w = (rho - tool.r1).min(TANGENT_REACH * tool.r2);
            let root = (tool.r2 * tool.r2 - w * w).sqrt();
            let inverse = 1.0 / (rho * root);
            let (ux, uy) = (qx * root * inverse, qy * root * inverse);
            let g = w * rho * inverse;
            let fall = tool.r2 - root + g * (rho - tool.r1 - w);
            let (fx, fy) = (self.slope[0] - g * ux, self.slope[1] - g * uy);
            bound = bound.min(flat - fall - fx * px - fy * py + self.highest([fx, fy]));
            // Enough to leave the node out, or F itself is above the floor here and nothing will be.
            if bound <= floor || flat - fall > floor {
                return bound;
            }
            // Minus the second derivatives of F: around the axis and along the radius, then in x and y.
            let around = w * inverse;
            let along = (1.0 + g * g) * rho * inverse;
            let (xx, yy, xy) = (
                along * ux * ux + around * uy * uy,
                along * uy * uy + around * ux * ux,
                (along - around) * ux * uy,
            );
            let (ix, iy) = (1.0 / xx, 1.0 / yy);
            let (cx, cy) = (fx + xx * px + xy * py, fy + yy * py + xy * px);
            for _ in 0..2 {
                px = clamp((cx - xy * py) * ix, py).0;
                py = clamp(px, (cy - xy * px) * iy).1;
            }
        }
        bound
    }

    /// The most that a gradient rises from the centre to the border of the box.
    #[inline]
    fn highest(&self, gradient: [f64; 2]) -> f64 {
        gradient[0].abs() * self.half[0] + gradient[1].abs() * self.half[1]
    }
}

/// Nodes in depth-first order.
#[derive(Clone, Debug)]
pub(crate) struct ContactTree {
    pub(crate) nodes: Vec<ContactNode>,
    pub(crate) tool: Profile,
}

impl ContactTree {
    /// Visits the leaves that may hold an F above `best`, best bound first; `leaf` raises `best`.
    #[inline]
    pub(crate) fn search(
        &self,
        x: f64,
        y: f64,
        mut best: f64,
        mut leaf: impl FnMut(std::ops::Range<usize>, &mut f64),
    ) {
        let Some(root) = self.nodes.first() else { return };
        let bound = |node: u32, floor: f64| self.nodes[node as usize].bound(&self.tool, x, y, floor);
        if root.bound(&self.tool, x, y, best + SLACK) <= best + SLACK {
            return;
        }
        let mut stack = [(0u32, 0.0f64); 64];
        let (mut depth, mut at) = (0usize, 0u32);
        loop {
            let node = &self.nodes[at as usize];
            let mut descend = None;
            if node.count > 0 {
                leaf(node.first as usize..(node.first + node.count) as usize, &mut best);
            } else {
                let floor = best + SLACK;
                let (l, r) = (at + 1, node.right);
                let (l_bound, r_bound) = (bound(l, floor), bound(r, floor));
                let (near, far) = if l_bound >= r_bound {
                    ((l, l_bound), (r, r_bound))
                } else {
                    ((r, r_bound), (l, l_bound))
                };
                if near.1 > floor {
                    descend = Some(near.0);
                    if far.1 > floor {
                        stack[depth] = far;
                        depth += 1;
                    }
                }
            }
            at = match descend {
                Some(node) => node,
                None => loop {
                    if depth == 0 {
                        return;
                    }
                    depth -= 1;
                    if stack[depth].1 > best + SLACK {
                        break stack[depth].0;
                    }
                },
            };
        }
    }
}
