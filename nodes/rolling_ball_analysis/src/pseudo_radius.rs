//! The pseudo-radius of curvature (paper, "Pseudo-radius of curvature"), as its inverse κ*.
//!
//! The sphere tangent to the surface at P that passes through Q has the curvature κ(Q) = 2 (d·n)/(d·d), d = Q − P.
//! Of all Q in the shadow the most concave one stops the rolling ball: κ* = max κ(Q). Curvatures are compared,
//! never radii, which jump through ±∞. As Q nears P, κ(Q) tends to a normal curvature, a limit that points at a
//! distance miss, so the largest principal curvature at P takes part in the maximum.

use nalgebra::{Point3, Vector3};
use patchmill_geometry::bvh::Bvh;
use patchmill_geometry::cutter::Cutter;
use patchmill_geometry::mesh::TriangleMesh;
use patchmill_geometry::rolling_ball::{BallTree, Reach, SmoothSurface};

use crate::shadow::{Border, ShadowPattern, TangentFrame, for_each_shadow_point};

/// Times that a shadow is extended step by step before it is extended to its bound.
const EXTENSIONS: usize = 4;

/// Curvature (1/m, positive when Q is above the tangent plane) of the sphere tangent at `p` to the plane of unit
/// normal `n` and passing through `q`; −∞ when the points coincide.
pub fn pseudo_curvature(p: &Point3<f64>, n: &Vector3<f64>, q: &Point3<f64>) -> f64 {
    let d = q - p;
    let square = d.norm_squared();
    if square > 0.0 { 2.0 * d.dot(n) / square } else { f64::NEG_INFINITY }
}

/// Radius of the shadow of a cutter on flat or gently curved ground, 2·R1 + R2, m: the reach of the tool's
/// bottom from a contact point on its corner, whatever the feed direction.
pub fn shadow_radius(cutter: &Cutter) -> f64 {
    2.0 * cutter.r1 + cutter.r2
}

/// Chord of the contact ring of a cutter in a ball of curvature `kappa` (1/m), 2·R1·R*/(R* − R2), m; 0 where the
/// ball is no hollow. It exceeds [`shadow_radius`] when R* is below that. A ball that does not hold the tool
/// gives the chord of the smallest one that does, 2·(R1 + R2).
pub fn contact_chord(cutter: &Cutter, kappa: f64) -> f64 {
    if kappa <= 0.0 {
        return 0.0;
    }
    let ball = (1.0 / kappa).max(cutter.radius());
    if cutter.r1 > 0.0 { 2.0 * cutter.r1 * ball / (ball - cutter.r2) } else { 0.0 }
}

/// A sample's most concave pseudo-curvature and what stops its ball.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ball {
    /// κ*, 1/m.
    pub curvature: f64,
    /// The point that stops the ball; the sample itself when the principal curvature does, m.
    pub contact: Point3<f64>,
}

/// The points of the surface that can stop a ball.
pub enum Shadow<'a> {
    /// All within reach, found by branch and bound.
    Exact {
        /// The surface's points.
        tree: &'a BallTree,
        /// The surface between them.
        surface: &'a SmoothSurface<'a>,
        /// Points nearer to the sample than this do not count, m (see [`Reach`]).
        near: f64,
    },
    /// Those under the shadow-check points.
    Circles {
        /// The surface.
        mesh: &'a TriangleMesh,
        /// Its hierarchy.
        bvh: &'a Bvh,
        /// Its border; empty to leave it out of the shadow.
        border: &'a Border,
        /// The shadow-check points.
        pattern: &'a ShadowPattern,
    },
}

impl Shadow<'_> {
    /// The ball shrunk by what stops it within the shadow of `radius` (m, infinite for the whole surface).
    fn shrink(&self, frame: &TangentFrame, radius: f64, ball: Ball) -> Ball {
        match self {
            Self::Exact { tree, surface, near } => {
                let reach = Reach { near: *near, shadow: radius };
                let (p, n) = (&frame.origin, &frame.normal);
                let stop = tree.stop(p, n, &reach, ball.curvature).map(|s| surface.refine(p, n, &reach, s));
                stop.map_or(ball, |s| Ball { curvature: s.curvature, contact: s.point })
            }
            Self::Circles { mesh, bvh, border, pattern } => {
                let mut ball = ball;
                let mut take = |q: Point3<f64>| {
                    let curvature = pseudo_curvature(&frame.origin, &frame.normal, &q);
                    if curvature > ball.curvature {
                        ball = Ball { curvature, contact: q };
                    }
                };
                for_each_shadow_point(bvh, mesh, frame, radius, pattern, &mut take);
                // From half the innermost circle on.
                let near = 0.5 * radius / pattern.circles() as f64;
                border.for_each_in(frame, (near, radius), &mut take);
                ball
            }
        }
    }
}

/// What the balls of all samples have in common.
pub struct BallSearch<'a> {
    /// What can stop them.
    pub shadow: Shadow<'a>,
    /// The cutter that casts the shadow.
    pub cutter: Cutter,
    /// Radius of the shadow, m; infinite for the whole surface.
    pub radius: f64,
}

impl BallSearch<'_> {
    /// The ball of one sample with largest principal curvature `principal` (1/m): the maximum over the shadow, or
    /// over a larger one where the ball is so small that the contact ring reaches further.
    pub fn ball(&self, frame: &TangentFrame, principal: f64) -> Ball {
        let mut ball = Ball { curvature: principal, contact: frame.origin };
        let mut searched = self.radius;
        for extension in 0..=EXTENSIONS + 1 {
            ball = self.shadow.shrink(frame, searched, ball);
            let needed = contact_chord(&self.cutter, ball.curvature);
            if needed <= searched * (1.0 + 1e-3) {
                break;
            }
            // Every extension can find a smaller ball with a longer chord; the bound is the tool's own diameter.
            searched = if extension < EXTENSIONS { needed } else { 2.0 * self.cutter.radius() };
        }
        ball
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn any_point_of_a_sphere_gives_its_curvature(
            radius in prop_oneof![0.01f64..1.0, -1.0..-0.01],
            theta in 0.01f64..3.0,
            phi in 0.0f64..6.3,
        ) {
            let (n, p) = (Vector3::new(0.48, -0.6, 0.64), Point3::new(0.1, 0.2, -0.3));
            let frame = TangentFrame::new(p, n, &Vector3::x());
            let side = Vector3::x() - n * n.x;
            let tangent = side.normalize() * phi.cos() + n.cross(&side.normalize()) * phi.sin();
            let q = frame.origin + n * radius + (tangent * theta.sin() - n * theta.cos()) * radius;
            let found = pseudo_curvature(&p, &n, &q);
            prop_assert!((found * radius - 1.0).abs() < 1e-9);
        }
    }

    #[test]
    fn contact_chord_passes_the_shadow_radius_where_the_ball_does() {
        let cutter = Cutter { r1: 0.01305, r2: 0.006 };
        let reach = shadow_radius(&cutter);
        assert!((reach - 0.0321).abs() < 1e-15);
        assert!((contact_chord(&cutter, 1.0 / reach) - reach).abs() < 1e-12);
        assert!(contact_chord(&cutter, 1.0 / 0.025) > reach && contact_chord(&cutter, 1.0 / 0.040) < reach);
        assert!((contact_chord(&cutter, 1.0 / 0.010) - 2.0 * cutter.radius()).abs() < 1e-12);
        assert_eq!(contact_chord(&cutter, -30.0), 0.0);
        assert_eq!(contact_chord(&Cutter { r1: 0.0, r2: 0.006 }, 300.0), 0.0);
    }
}
