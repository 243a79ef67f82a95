//! Inverse kinematics: rotary angles for a tool axis, then linear joints for the tip.
//!
//! The tool axis depends on the rotary joints alone. With u₁ the rotary axis nearer to the workpiece, u₂ the one
//! nearer to the tool and a₀ the tool axis, all in the workpiece frame at rotary zero,
//!
//! ```text
//! a = exp(û₁ θ₁) · exp(û₂ θ₂) · a₀
//! ```
//!
//! which is Paden and Kahan's second subproblem. c = exp(û₂ θ₂)·a₀ = exp(−û₁ θ₁)·a lies on two cones: at the
//! angle φ = ∠(a, u₁) about u₁ and at ψ = ∠(a₀, u₂) about u₂, with η = ∠(u₁, u₂) between them. In the frame
//! e₁ = u₁, e₂ ∝ u₂ − (u₁·u₂)u₁, e₃ = e₁ × e₂
//!
//! ```text
//! c = (cos φ, (cos ψ − cos η cos φ)/sin η, ±V/sin η),  V² = 4 sin s · sin(s−φ) · sin(s−ψ) · sin(s−η),  s = (φ+ψ+η)/2
//! ```
//!
//! V is the volume of (u₁, u₂, c), in the half-angle form of spherical triangles: the textbook's
//! 1 − α² − β² − 2αβ cos η loses half its digits where the two solutions meet, this form does not. A negative
//! factor is the angle by which the axis cannot be reached.
//!
//! At fixed rotary joints the tip is affine in the linear ones, tip = t₀ + D·q, solved by D⁻¹.

use crate::axis::{AxisKind, Joints};
use crate::chain::Machine;
use crate::error::{KinematicsError, LimitViolation};
use nalgebra::{Matrix3, Point3, Unit, UnitQuaternion, Vector3};
use std::f64::consts::TAU;

/// Below this sine of the angle between tool axis and inner rotary axis the pose counts as singular.
const SINGULAR_SINE: f64 = 1e-9;
/// How far outside the reachable cone an axis may lie and still be taken for its rim, rad.
const RIM: f64 = 1e-9;

/// One position of the two rotary axes that points the tool along a wanted axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Orientation {
    /// Joint values of the two rotary axes in the order of [`Machine::axes`], rad, unwound and within limits.
    pub rotary: [f64; 2],
    /// The tool is parallel to the rotary axis nearest the workpiece, which kept its position.
    pub singular: bool,
}

/// Joint values of a pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Solution {
    /// Joint values, m and rad.
    pub joints: Joints,
    /// As [`Orientation::singular`].
    pub singular: bool,
}

/// A rotary joint as it acts on the tool axis.
pub(crate) struct RotaryGeometry {
    /// Place in [`Machine::axes`].
    pub axis: usize,
    /// Unit axis at rotary zero, workpiece frame, signed for a growing joint value.
    pub direction: Unit<Vector3<f64>>,
}

/// The machine with its rotary axes held: tip and linear joints are affine in each other.
#[derive(Clone, Debug)]
pub struct FixedOrientation {
    rotary: [f64; 2],
    axis: Unit<Vector3<f64>>,
    tip_at_zero: Point3<f64>,
    directions: Matrix3<f64>,
    inverse: Matrix3<f64>,
}

impl FixedOrientation {
    /// The rotary joint values, rad.
    pub fn rotary(&self) -> [f64; 2] {
        self.rotary
    }

    /// The tool axis, tip to spindle, `workpiece` frame.
    pub fn axis(&self) -> Unit<Vector3<f64>> {
        self.axis
    }

    /// Joint values for a tip (m, `workpiece` frame), limits not checked.
    pub fn joints(&self, tip: &Point3<f64>) -> Joints {
        let q = self.inverse * (tip - self.tip_at_zero);
        [q.x, q.y, q.z, self.rotary[0], self.rotary[1]]
    }

    /// Tip (m, `workpiece` frame) at the linear joint values of `q`; its rotary values are not looked at.
    pub fn tip(&self, q: &Joints) -> Point3<f64> {
        self.tip_at_zero + self.directions * Vector3::new(q[0], q[1], q[2])
    }
}

impl Machine {
    /// The machine with its rotary axes held at these joint values (rad).
    ///
    /// # Errors
    /// [`KinematicsError::Singular`] when the linear axes do not span space there.
    pub fn at_rotary(&self, rotary: [f64; 2]) -> Result<FixedOrientation, KinematicsError> {
        let pose = self.pose(&[0.0, 0.0, 0.0, rotary[0], rotary[1]]);
        let directions = self.linear_directions(rotary);
        if directions.determinant().abs() < 1e-9 {
            return Err(KinematicsError::Singular);
        }
        let inverse = directions.try_inverse().ok_or(KinematicsError::Singular)?;
        Ok(FixedOrientation { rotary, axis: pose.axis, tip_at_zero: pose.tip, directions, inverse })
    }

    /// Rotary positions that point the tool along `axis` (`workpiece` frame), nearest to `near` (rad) first: both
    /// branches, each unwound to the turn within its limits that is nearest to `near`.
    ///
    /// # Errors
    /// [`KinematicsError::Orientation`] when no rotary position does, [`KinematicsError::Limit`] when those that
    /// do are outside the travel.
    pub fn orientations(
        &self,
        axis: &Unit<Vector3<f64>>,
        near: [f64; 2],
    ) -> Result<Vec<Orientation>, KinematicsError> {
        let (mut found, mut outside): (Vec<Orientation>, Option<LimitViolation>) = (Vec::new(), None);
        for branch in self.branches(axis, near)? {
            match self.unwound(branch, near) {
                Ok(orientation) if found.iter().any(|f| same(f, &orientation)) => {}
                Ok(orientation) => found.push(orientation),
                Err(violation) => {
                    if outside.as_ref().is_none_or(|o| violation.excess() < o.excess()) {
                        outside = Some(violation);
                    }
                }
            }
        }
        if found.is_empty() {
            return Err(outside.map_or(KinematicsError::Singular, KinematicsError::Limit));
        }
        let far = |o: &Orientation| {
            self.rapid_distance(
                &[0.0, 0.0, 0.0, near[0], near[1]],
                &[0.0, 0.0, 0.0, o.rotary[0], o.rotary[1]],
            )
        };
        found.sort_by(|a, b| far(a).total_cmp(&far(b)));
        Ok(found)
    }

    /// Joint values that put the tool there, within all limits, the solution nearest to `near` (by the time
    /// that the slowest axis needs).
    ///
    /// # Errors
    /// As [`Machine::orientations`]; [`KinematicsError::Limit`] with the least violation when the tip is out of
    /// travel for every rotary solution.
    pub fn inverse(
        &self,
        tip: &Point3<f64>,
        axis: &Unit<Vector3<f64>>,
        near: &Joints,
    ) -> Result<Solution, KinematicsError> {
        let mut best: Option<(f64, Solution)> = None;
        let mut failure: Option<KinematicsError> = None;
        for orientation in self.orientations(axis, [near[3], near[4]])? {
            let joints = match self.at_rotary(orientation.rotary) {
                Ok(fixed) => fixed.joints(tip),
                Err(e) => {
                    failure.get_or_insert(e);
                    continue;
                }
            };
            if let Some(violation) = self.violation(&joints) {
                match &failure {
                    Some(KinematicsError::Limit(v)) if v.excess() <= violation.excess() => {}
                    _ => failure = Some(KinematicsError::Limit(violation)),
                }
                continue;
            }
            let distance = self.rapid_distance(near, &joints);
            if best.as_ref().is_none_or(|(d, _)| distance < *d) {
                best = Some((distance, Solution { joints, singular: orientation.singular }));
            }
        }
        match best {
            Some((_, solution)) => Ok(solution),
            None => Err(failure.unwrap_or(KinematicsError::Singular)),
        }
    }

    /// Place in [`Machine::axes`] of the rotary axis nearer to the tool: the one that tilts, by which the two solutions
    /// of [`Machine::orientations`] are told apart (the other one turns the tilt about).
    pub fn tilting_axis(&self) -> usize {
        let [_, outer] = self.rotary_geometry();
        outer.axis
    }

    /// Directions in which the tip moves for growing X, Y, Z: the columns, workpiece frame.
    pub(crate) fn linear_directions(&self, rotary: [f64; 2]) -> Matrix3<f64> {
        let mut columns = Matrix3::zeros();
        let mut rotation = UnitQuaternion::identity();
        for element in &self.elements {
            rotation *= element.offset.rotation;
            match self.axes()[element.axis].kind {
                AxisKind::Linear => {
                    columns.set_column(element.axis, &(rotation * element.direction.into_inner()));
                }
                AxisKind::Rotary => {
                    rotation *= UnitQuaternion::from_axis_angle(&element.direction, rotary[element.axis - 3]);
                }
            }
        }
        columns
    }

    /// The two rotary joints at rotary zero: nearest the workpiece first.
    pub(crate) fn rotary_geometry(&self) -> [RotaryGeometry; 2] {
        let mut rotation = UnitQuaternion::identity();
        let mut found = Vec::with_capacity(2);
        for element in &self.elements {
            rotation *= element.offset.rotation;
            if self.axes()[element.axis].kind == AxisKind::Rotary {
                found.push(RotaryGeometry { axis: element.axis, direction: rotation * element.direction });
            }
        }
        let second = found.remove(1);
        [found.remove(0), second]
    }

    /// The tool axis at rotary zero, workpiece frame.
    pub(crate) fn tool_axis_at_zero(&self) -> Vector3<f64> {
        self.pose(&[0.0; 5]).axis.into_inner()
    }

    /// Both solutions for the rotary joints, not unwound.
    fn branches(
        &self,
        axis: &Unit<Vector3<f64>>,
        near: [f64; 2],
    ) -> Result<Vec<Orientation>, KinematicsError> {
        let [first, second] = self.rotary_geometry();
        let (u1, u2) = (first.direction.into_inner(), second.direction.into_inner());
        let (p, q) = (self.tool_axis_at_zero(), axis.into_inner());
        let (phi, psi, eta) = (angle(&q, &u1), angle(&p, &u2), angle(&u1, &u2));
        let s = 0.5 * (phi + psi + eta);
        // s itself exceeds π where the cones miss each other on the far side.
        let factors = [std::f64::consts::PI - s, s - phi, s - psi, s - eta];
        let short = factors.iter().fold(0.0f64, |worst, f| worst.max(-f));
        if short > RIM {
            return Err(KinematicsError::Orientation { short_by: 2.0 * short });
        }
        let volume = 2.0 * factors.iter().map(|f| f.max(0.0).sin()).product::<f64>().max(0.0).sqrt();
        let e2 = (u2 - u1 * eta.cos()).normalize();
        let e3 = u1.cross(&e2);
        let in_plane = u1 * phi.cos() + e2 * ((psi.cos() - eta.cos() * phi.cos()) / eta.sin());
        let singular = u1.cross(&q).norm() < SINGULAR_SINE;
        let branch = |sign: f64| {
            let c = in_plane + e3 * (sign * volume / eta.sin());
            let kept = near[first.axis - 3];
            let mut rotary = [0.0; 2];
            rotary[first.axis - 3] = if singular { kept } else { turn(&u1, &c, &q) };
            rotary[second.axis - 3] = turn(&u2, &p, &c);
            Orientation { rotary, singular }
        };
        Ok(vec![branch(1.0), branch(-1.0)])
    }

    /// Adds whole turns: within the limits, nearest to `near`.
    fn unwound(&self, mut branch: Orientation, near: [f64; 2]) -> Result<Orientation, LimitViolation> {
        for (i, value) in branch.rotary.iter_mut().enumerate() {
            let axis = &self.axes()[3 + i];
            let nearest = *value + ((near[i] - *value) / TAU).round() * TAU;
            let Some(limits) = axis.limits else {
                *value = nearest;
                continue;
            };
            // The wanted turn first, else the legal one closest to it.
            let up = nearest + ((limits[0] - nearest) / TAU - 1e-12).ceil().max(0.0) * TAU;
            let down = nearest - ((nearest - limits[1]) / TAU - 1e-12).ceil().max(0.0) * TAU;
            let turned = if nearest < limits[0] { up } else { down };
            let slack = 1e-9;
            if turned < limits[0] - slack || turned > limits[1] + slack {
                // Report the turn that misses the travel by least.
                let outside = |v: f64| (limits[0] - v).max(v - limits[1]);
                let value = [turned - TAU, turned, turned + TAU]
                    .into_iter()
                    .min_by(|a, b| outside(*a).total_cmp(&outside(*b)))
                    .unwrap_or(turned);
                return Err(LimitViolation {
                    axis: 3 + i,
                    letter: axis.letter,
                    kind: axis.kind,
                    value,
                    limits,
                });
            }
            *value = turned.clamp(limits[0], limits[1]);
        }
        Ok(branch)
    }
}

fn same(a: &Orientation, b: &Orientation) -> bool {
    (0..2).all(|i| (a.rotary[i] - b.rotary[i]).abs() < 1e-12)
}

/// Angle between two unit vectors, exact to rounding at 0 and π too.
fn angle(a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
    2.0 * (a - b).norm().atan2((a + b).norm())
}

/// Angle that turns `from` to `to` about the unit axis `u` (both at the same angle to it).
fn turn(u: &Vector3<f64>, from: &Vector3<f64>, to: &Vector3<f64>) -> f64 {
    let (f, t) = (from - u * u.dot(from), to - u * u.dot(to));
    u.dot(&f.cross(&t)).atan2(f.dot(&t))
}
