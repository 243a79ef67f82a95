//! The chain workpiece → base → tool tip, read from URDF, and its forward kinematics.
//!
//! With `base_from_workpiece` = Π Oᵢ·Mᵢ(qᵢ) and `base_from_tool` likewise (O: fixed origins, M: joint motions),
//! `workpiece_from_tool` = `base_from_workpiece`⁻¹ · `base_from_tool`. The inverse only turns the order and the
//! signs of the workpiece side, so the whole machine is one list of fixed offsets and signed joint motions from
//! the workpiece to the tool. Joints above both chains move neither relative to the other and drop out.

use crate::axis::{Accelerations, Axis, AxisKind, Joints, letter_of};
use crate::error::{KinematicsError, LimitViolation};
use crate::urdf_text::robot_of;
use nalgebra::{Isometry3, Matrix3, Point3, Translation3, Unit, UnitQuaternion, Vector3};
use std::collections::{BTreeMap, BTreeSet};
use urdf_rs::{Joint, JointType};

/// Speed of a continuous joint whose URDF gives none, rad/s.
const DEFAULT_ROTARY_VELOCITY: f64 = std::f64::consts::PI;
/// Slack of limit checks, m or rad: far below what a program's last digit resolves.
const LIMIT_SLACK: f64 = 1e-9;

/// Where the tool is, `workpiece` frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Tool tip, m.
    pub tip: Point3<f64>,
    /// Tool axis, tip to spindle.
    pub axis: Unit<Vector3<f64>>,
}

/// One joint on the way from the workpiece to the tool.
#[derive(Clone, Debug)]
pub(crate) struct Element {
    /// Fixed transform since the joint before.
    pub offset: Isometry3<f64>,
    /// Place of its axis in [`Machine::axes`].
    pub axis: usize,
    /// Unit direction of motion for a growing joint value, its sign turned on the workpiece side.
    pub direction: Unit<Vector3<f64>>,
}

/// A machine of three linear and two rotary axes with its tool.
#[derive(Clone, Debug)]
pub struct Machine {
    name: String,
    axes: Vec<Axis>,
    pub(crate) elements: Vec<Element>,
    pub(crate) end: Isometry3<f64>,
}

impl Machine {
    /// Reads the machine from URDF text (metres, radians).
    ///
    /// Needs a link `workpiece` and either a link `spindle` (nose, +Z into the spindle; the tip lies
    /// `tool_length` m along −Z, whatever `tool_tip` the text may have) or only a link `tool_tip` (+Z from tip to
    /// spindle; `tool_length` is then not used). Between the two exactly three prismatic joints with the letters
    /// X Y Z and two revolute or continuous ones with letters of A B C must lie, in any order; fixed joints
    /// anywhere. A letter is the joint's name, or what follows or precedes `_`, `axis`, `joint` in it.
    ///
    /// # Errors
    /// [`KinematicsError::Model`] naming what is missing or cannot be used.
    pub fn from_urdf(
        text: &str,
        tool_length: f64,
        accelerations: Accelerations,
    ) -> Result<Self, KinematicsError> {
        let positive = |x: f64| x.is_finite() && x > 0.0;
        if !(positive(accelerations.linear) && positive(accelerations.rotary)) {
            return model("the accelerations of the axes must be positive numbers");
        }
        if !(tool_length.is_finite() && tool_length >= 0.0) {
            return model("the tool length must be a finite number of at least 0 mm");
        }
        let robot = robot_of(text)?;
        let links: BTreeSet<&str> = robot.links.iter().map(|l| l.name.as_str()).collect();
        let has = |name: &str| links.contains(name);
        let (tool_link, tip) = match (has("workpiece"), has("spindle"), has("tool_tip")) {
            (true, true, _) => ("spindle", Isometry3::translation(0.0, 0.0, -tool_length)),
            (true, false, true) => ("tool_tip", Isometry3::identity()),
            (false, true, _) | (false, false, true) => {
                return model("the machine's URDF has no tool chain: no link named `workpiece`");
            }
            (true, false, false) => {
                return model("the machine's URDF has no tool chain: no link named `spindle` or `tool_tip`");
            }
            (false, false, false) => {
                return model(
                    "the machine's URDF has no tool chain: no link named `workpiece` and none named `spindle` or `tool_tip`",
                );
            }
        };
        let mut parent_joint = BTreeMap::new();
        for joint in &robot.joints {
            if parent_joint.insert(joint.child.link.as_str(), joint).is_some() {
                return model(format!(
                    "the machine's URDF is not a tree: link {} has two parents",
                    joint.child.link
                ));
            }
        }
        let (mut work, mut tool) =
            (joints_above("workpiece", &parent_joint)?, joints_above(tool_link, &parent_joint)?);
        let root =
            |chain: &[&Joint], link: &str| chain.first().map_or(link.to_owned(), |j| j.parent.link.clone());
        if root(&work, "workpiece") != root(&tool, tool_link) {
            return model(format!(
                "the machine's URDF has no tool chain: links `workpiece` and `{tool_link}` hang from different roots"
            ));
        }
        let shared = work.iter().zip(&tool).take_while(|(w, t)| w.name == t.name).count();
        work.drain(..shared);
        tool.drain(..shared);
        let axes = axes_of(&work, &tool, accelerations)?;
        let (elements, end) = flatten(&work, &tool, &axes)?;
        let machine = Self { name: robot.name, axes, elements, end: end * tip };
        machine.check_spans_space()?;
        Ok(machine)
    }

    /// The robot's name in the URDF.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The five axes: X, Y, Z, then the two rotary ones: those that carry the workpiece first, then those that
    /// carry the tool, each from the base outward.
    pub fn axes(&self) -> &[Axis] {
        &self.axes
    }

    /// Pose of the tool in the `workpiece` frame at joint values `q` (m, rad).
    pub fn workpiece_from_tool(&self, q: &Joints) -> Isometry3<f64> {
        let mut t = Isometry3::identity();
        for element in &self.elements {
            t *= element.offset;
            let value = q[element.axis];
            match self.axes[element.axis].kind {
                AxisKind::Linear => t *= Translation3::from(element.direction.into_inner() * value),
                AxisKind::Rotary => t *= UnitQuaternion::from_axis_angle(&element.direction, value),
            }
        }
        t * self.end
    }

    /// Tip and tool axis at joint values `q` (m, rad).
    pub fn pose(&self, q: &Joints) -> Pose {
        let t = self.workpiece_from_tool(q);
        Pose { tip: Point3::from(t.translation.vector), axis: Unit::new_normalize(t.rotation * Vector3::z()) }
    }

    /// Joint values that put the tip at the workpiece origin with both rotary axes at 0: the work offset from
    /// which programs count. Not checked against the limits; rotary entries are 0.
    ///
    /// # Errors
    /// [`KinematicsError::Singular`] never for a machine that [`Machine::from_urdf`] accepted.
    pub fn zero_offset(&self) -> Result<Joints, KinematicsError> {
        Ok(self.at_rotary([0.0, 0.0])?.joints(&Point3::origin()))
    }

    /// The axis farthest outside its travel at `q`, if any.
    pub fn violation(&self, q: &Joints) -> Option<LimitViolation> {
        let mut worst: Option<LimitViolation> = None;
        for (i, axis) in self.axes.iter().enumerate() {
            let Some(limits) = axis.limits else { continue };
            let found = LimitViolation { axis: i, letter: axis.letter, kind: axis.kind, value: q[i], limits };
            // A joint value that is no number is outside too.
            let within = found.excess() <= LIMIT_SLACK;
            if !within && worst.as_ref().is_none_or(|w| found.excess() > w.excess()) {
                worst = Some(found);
            }
        }
        worst
    }

    /// Time that the slowest axis needs from `from` to `to` at its full speed, s: the measure of nearness.
    pub fn rapid_distance(&self, from: &Joints, to: &Joints) -> f64 {
        self.axes.iter().enumerate().map(|(i, a)| (to[i] - from[i]).abs() / a.velocity).fold(0.0, f64::max)
    }

    /// Refuses chains whose axes cannot place and tilt a tool.
    fn check_spans_space(&self) -> Result<(), KinematicsError> {
        let directions: Matrix3<f64> = self.linear_directions([0.0, 0.0]);
        if directions.determinant().abs() < 1e-6 {
            return model(
                "the machine's three linear axes do not span space: two are parallel or all lie in a plane",
            );
        }
        let [first, second] = self.rotary_geometry();
        if first.direction.cross(&second.direction).norm() < 1e-6 {
            return model("the machine's two rotary axes are parallel");
        }
        if second.direction.cross(&self.tool_axis_at_zero()).norm() < 1e-6 {
            return model(format!(
                "rotary axis {} is parallel to the tool: it turns the tool about itself and tilts nothing",
                self.axes[second.axis].letter
            ));
        }
        Ok(())
    }
}

fn model<T>(text: impl Into<String>) -> Result<T, KinematicsError> {
    Err(KinematicsError::Model(text.into()))
}

/// Joints from the root down to `link`.
fn joints_above<'a>(
    link: &str,
    parent_joint: &BTreeMap<&'a str, &'a Joint>,
) -> Result<Vec<&'a Joint>, KinematicsError> {
    let mut chain = Vec::new();
    let mut at = link;
    while let Some(&joint) = parent_joint.get(at) {
        chain.push(joint);
        if chain.len() > parent_joint.len() {
            return model(format!("the machine's URDF is not a tree: link {link} is its own ancestor"));
        }
        at = joint.parent.link.as_str();
    }
    chain.reverse();
    Ok(chain)
}

/// The axes of both chains in the order of [`Machine::axes`].
fn axes_of(work: &[&Joint], tool: &[&Joint], acc: Accelerations) -> Result<Vec<Axis>, KinematicsError> {
    let (mut linear, mut rotary) = (Vec::new(), Vec::new());
    for joint in work.iter().chain(tool) {
        match joint.joint_type {
            JointType::Fixed => {}
            JointType::Prismatic => linear.push(axis_of(joint, AxisKind::Linear, acc.linear)?),
            JointType::Revolute | JointType::Continuous => {
                rotary.push(axis_of(joint, AxisKind::Rotary, acc.rotary)?);
            }
            _ => {
                return model(format!(
                    "joint {} between workpiece and tool is {:?}; only prismatic, revolute, continuous and fixed joints make a machine tool",
                    joint.name, joint.joint_type
                ));
            }
        }
    }
    let letters = |axes: &[Axis]| axes.iter().map(|a| a.letter.to_string()).collect::<Vec<_>>().join(" ");
    if linear.len() != 3 || rotary.len() != 2 {
        return model(format!(
            "a five-axis machine has 3 linear and 2 rotary axes between workpiece and tool; this URDF has {} linear ({}) and {} rotary ({})",
            linear.len(),
            letters(&linear),
            rotary.len(),
            letters(&rotary)
        ));
    }
    linear.sort_by_key(|a| a.letter);
    if letters(&linear) != "X Y Z" {
        return model(format!(
            "the linear axes must have the letters X Y Z; this URDF has {}",
            letters(&linear)
        ));
    }
    let is_rotary_letter = |a: &Axis| ('A'..='C').contains(&a.letter);
    if !rotary.iter().all(is_rotary_letter) || rotary[0].letter == rotary[1].letter {
        return model(format!(
            "the rotary axes must have two different letters of A B C; this URDF has {}",
            letters(&rotary)
        ));
    }
    linear.append(&mut rotary);
    Ok(linear)
}

fn axis_of(joint: &Joint, kind: AxisKind, acceleration: f64) -> Result<Axis, KinematicsError> {
    let name = &joint.name;
    let Some(letter) = letter_of(name) else {
        return model(format!(
            "joint {name} moves between workpiece and tool, but its name carries no axis letter (x y z a b c, alone or after `_` or `axis`)"
        ));
    };
    if joint.mimic.is_some() {
        return model(format!(
            "joint {name} mimics another joint; an axis of a machine tool must move by itself"
        ));
    }
    let [lower, upper, mut velocity] = [joint.limit.lower, joint.limit.upper, joint.limit.velocity];
    let continuous = joint.joint_type == JointType::Continuous;
    if continuous && (velocity == 0.0 || velocity == f64::INFINITY) {
        velocity = DEFAULT_ROTARY_VELOCITY;
    }
    if !(velocity.is_finite() && velocity > 0.0) {
        return model(format!("joint {name} has no speed: <limit velocity> must be given and positive"));
    }
    let has_travel = lower < upper;
    if !continuous && !has_travel {
        return model(format!(
            "joint {name} has no travel: <limit lower, upper> must be given, lower below upper"
        ));
    }
    let limits = (!continuous).then_some([lower, upper]);
    Ok(Axis { joint_name: name.clone(), letter, kind, limits, velocity, acceleration })
}

/// A fixed transform or a joint motion on the way from workpiece to tool.
enum Step {
    Fixed(Isometry3<f64>),
    Motion { axis: usize, direction: Unit<Vector3<f64>> },
}

fn flatten(
    work: &[&Joint],
    tool: &[&Joint],
    axes: &[Axis],
) -> Result<(Vec<Element>, Isometry3<f64>), KinematicsError> {
    let mut steps = Vec::new();
    for joint in work.iter().rev() {
        steps.extend(motion_of(joint, axes, -1.0)?);
        steps.push(Step::Fixed(origin_of(joint)?.inverse()));
    }
    for joint in tool {
        steps.push(Step::Fixed(origin_of(joint)?));
        steps.extend(motion_of(joint, axes, 1.0)?);
    }
    let mut elements = Vec::new();
    let mut offset = Isometry3::identity();
    for step in steps {
        match step {
            Step::Fixed(t) => offset *= t,
            Step::Motion { axis, direction } => {
                elements.push(Element { offset, axis, direction });
                offset = Isometry3::identity();
            }
        }
    }
    Ok((elements, offset))
}

fn origin_of(joint: &Joint) -> Result<Isometry3<f64>, KinematicsError> {
    let ([x, y, z], [roll, pitch, yaw]) = (*joint.origin.xyz, *joint.origin.rpy);
    if ![x, y, z, roll, pitch, yaw].iter().all(|v| v.is_finite()) {
        return model(format!("joint {}: its origin is not finite", joint.name));
    }
    Ok(Isometry3::from_parts(Translation3::new(x, y, z), UnitQuaternion::from_euler_angles(roll, pitch, yaw)))
}

fn motion_of(joint: &Joint, axes: &[Axis], sign: f64) -> Result<Option<Step>, KinematicsError> {
    if joint.joint_type == JointType::Fixed {
        return Ok(None);
    }
    let direction = Vector3::from(*joint.axis.xyz) * sign;
    let Some(direction) = Unit::try_new(direction, 1e-9).filter(|d| d.iter().all(|v| v.is_finite())) else {
        return model(format!("joint {}: its axis is zero or not finite", joint.name));
    };
    match axes.iter().position(|a| a.joint_name == joint.name) {
        Some(axis) => Ok(Some(Step::Motion { axis, direction })),
        None => model(format!("joint {} is not an axis of the machine", joint.name)),
    }
}
