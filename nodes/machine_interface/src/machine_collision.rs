//! The machine's links against each other and against the part, by the collision shapes of its URDF.
//!
//! Boxes, cylinders and spheres are taken as they are, capsules as the cylinder around them; mesh shapes are not looked at
//! ([`MachineBodies::unchecked`] names their links). The tool hangs under the spindle as a stack of cylinders. A pair of
//! links is looked at when at least two joints move between them: neighbours rest on each other. Pairs that overlap at every
//! corner of the linear travel carry each other and are left out. Joints that are no axis of the machine stand at 0.

use std::collections::BTreeMap;

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use patchmill_geometry::bvh::Bvh;
use patchmill_geometry::mesh::TriangleMesh;
use patchmill_kinematics::{AxisKind, Joints, Machine};
use patchmill_products::job::Tool;
use patchmill_products::stage::StageError;
use urdf_rs::{Geometry, JointType, Pose, Robot};

use crate::convex_gap::{Placed, Solid, apart};
use crate::evaluate::BAD_MACHINE;

/// Closer than this counts as touching, m.
pub const MARGIN: f64 = 2e-3;

/// One joint or fixed offset on the way from the root to a link.
#[derive(Clone, Debug)]
struct Step {
    joint: String,
    origin: Isometry3<f64>,
    /// Place among the machine's axes, kind and direction; `None` for what does not move.
    motion: Option<(usize, AxisKind, Vector3<f64>)>,
}

/// A link with its shapes.
#[derive(Clone, Debug)]
struct Body {
    link: String,
    steps: Vec<Step>,
    shapes: Vec<(Isometry3<f64>, Solid)>,
}

/// The machine's collision shapes and the pairs of links that are looked at.
#[derive(Clone, Debug, Default)]
pub struct MachineBodies {
    bodies: Vec<Body>,
    pairs: Vec<[usize; 2]>,
    /// The way to the workpiece, and the links that must not touch the part.
    workpiece: Vec<Step>,
    facing_part: Vec<usize>,
    /// Links whose collision shape is a mesh, which is not looked at.
    pub unchecked: Vec<String>,
}

impl MachineBodies {
    /// Reads the shapes from the machine's URDF text; `tool` hangs under `spindle`, else from `tool_tip` up.
    ///
    /// # Errors
    /// [`BAD_MACHINE`] when the text is no URDF or a shape's size is no positive number.
    pub fn of(urdf: &str, machine: &Machine, tool: &Tool) -> Result<Self, StageError> {
        let robot =
            urdf_rs::read_from_string(urdf).map_err(|e| StageError::new(BAD_MACHINE, e.to_string()))?;
        let mut bodies = Vec::new();
        let mut unchecked = Vec::new();
        for link in robot.links.iter().filter(|l| l.name != "tool_tip") {
            let mut shapes = Vec::new();
            for collision in &link.collision {
                match solid(&collision.geometry) {
                    Some(solid) if is_sized(&solid) => shapes.push((isometry(&collision.origin), solid)),
                    Some(_) => {
                        let text = format!(
                            "link {} of the machine's URDF has a collision shape of no size: {:?}; positive lengths were expected",
                            link.name, collision.geometry
                        );
                        return Err(StageError::new(BAD_MACHINE, text));
                    }
                    None => unchecked.push(link.name.clone()),
                }
            }
            if !shapes.is_empty() {
                bodies.push(Body {
                    link: link.name.clone(),
                    steps: steps_to(&robot, machine, &link.name),
                    shapes,
                });
            }
        }
        bodies.push(tool_body(&robot, machine, tool));
        let workpiece = steps_to(&robot, machine, "workpiece");
        let tool_place = bodies.len() - 1;
        let facing = |i: &usize| *i != tool_place && moving_between(&bodies[*i].steps, &workpiece) >= 2;
        let facing_part = (0..bodies.len()).filter(facing).collect();
        let all = (0..bodies.len()).flat_map(|j| (0..j).map(move |i| [i, j]));
        let apart_by_two = |[i, j]: &[usize; 2]| moving_between(&bodies[*i].steps, &bodies[*j].steps) >= 2;
        let pairs: Vec<[usize; 2]> = all.filter(apart_by_two).collect();
        let mut found = Self { bodies, pairs, workpiece, facing_part, unchecked };
        let corners = corners_of_travel(machine);
        let carried = |pair: &[usize; 2]| corners.iter().all(|q| found.touching(&found.placed(q), pair));
        let pairs = found.pairs.iter().copied().filter(|pair| !carried(pair)).collect();
        found.pairs = pairs;
        Ok(found)
    }

    /// Whether there is anything to look at besides the tool.
    pub fn is_empty(&self) -> bool {
        self.pairs.is_empty() && self.facing_part.is_empty()
    }

    /// Which links touch at a position, or which touches the part.
    pub fn touch_at(&self, q: &Joints, mesh: &TriangleMesh, bvh: &Bvh) -> Option<String> {
        let placed = self.placed(q);
        if let Some([i, j]) = self.pairs.iter().find(|pair| self.touching(&placed, pair)) {
            let (a, b) = (&self.bodies[*i].link, &self.bodies[*j].link);
            return Some(format!("{a} touches {b}"));
        }
        let workpiece = pose(&self.workpiece, q).inverse();
        let on_part = |i: &&usize| {
            placed[**i]
                .iter()
                .any(|body| touches_mesh(&Placed { pose: workpiece * body.pose, ..*body }, mesh, bvh))
        };
        let link = self.facing_part.iter().find(on_part)?;
        Some(format!("{} touches the part", self.bodies[*link].link))
    }

    fn placed(&self, q: &Joints) -> Vec<Vec<Placed>> {
        let place = |body: &Body| {
            let link = pose(&body.steps, q);
            body.shapes.iter().map(|(own, solid)| Placed { solid: *solid, pose: link * own }).collect()
        };
        self.bodies.iter().map(place).collect()
    }

    fn touching(&self, placed: &[Vec<Placed>], [i, j]: &[usize; 2]) -> bool {
        placed[*i].iter().any(|a| placed[*j].iter().any(|b| !apart(a, b, MARGIN)))
    }
}

/// Whether a body in the workpiece frame comes too close to a facet.
fn touches_mesh(body: &Placed, mesh: &TriangleMesh, bvh: &Bvh) -> bool {
    let found = std::cell::Cell::new(false);
    let near = |min: &[f64; 3], max: &[f64; 3]| {
        let (low, high) = (Vector3::from(*min), Vector3::from(*max));
        let middle = Translation3::from((low + high) * 0.5);
        let cell = Placed {
            solid: Solid::Cuboid((high - low) * 0.5),
            pose: Isometry3::from_parts(middle, UnitQuaternion::identity()),
        };
        !found.get() && !apart(body, &cell, MARGIN)
    };
    bvh.for_each_triangle(near, |t| {
        if !found.get() && !apart(body, &mesh.corners(t as usize), MARGIN) {
            found.set(true);
        }
    });
    found.get()
}

fn tool_body(robot: &Robot, machine: &Machine, tool: &Tool) -> Body {
    let under_spindle = robot.links.iter().any(|l| l.name == "spindle");
    let (link, tip) = if under_spindle { ("spindle", -tool.length) } else { ("tool_tip", 0.0) };
    let radius = tool.cutter.radius();
    let cylinder = |low: f64, high: f64, radius: f64| {
        let half_length = 0.5 * (high - low);
        (Isometry3::translation(0.0, 0.0, tip + low + half_length), Solid::Cylinder { radius, half_length })
    };
    let mut shapes = vec![cylinder(0.0, tool.flute_top(), radius)];
    let above = tool.shank().into_iter().chain(tool.holder_frusta());
    shapes.extend(above.map(|f| cylinder(f.low, f.high, f.radius_low.max(f.radius_high))));
    Body { link: "the tool".to_owned(), steps: steps_to(robot, machine, link), shapes }
}

/// The joints from the root down to a link.
fn steps_to(robot: &Robot, machine: &Machine, link: &str) -> Vec<Step> {
    let above: BTreeMap<&str, &urdf_rs::Joint> =
        robot.joints.iter().map(|j| (j.child.link.as_str(), j)).collect();
    let (mut steps, mut at) = (Vec::new(), link);
    // The machine has been read from the same text, so the way up ends; the bound is for safety.
    while let Some(joint) = above.get(at).filter(|_| steps.len() <= robot.joints.len()) {
        let axis = machine.axes().iter().position(|a| a.joint_name == joint.name);
        let moves = !matches!(joint.joint_type, JointType::Fixed);
        let direction = Vector3::from(*joint.axis.xyz).try_normalize(1e-12).unwrap_or_else(Vector3::x);
        let motion = axis.filter(|_| moves).map(|i| (i, machine.axes()[i].kind, direction));
        steps.push(Step { joint: joint.name.clone(), origin: isometry(&joint.origin), motion });
        at = joint.parent.link.as_str();
    }
    steps.reverse();
    steps
}

fn pose(steps: &[Step], q: &Joints) -> Isometry3<f64> {
    steps.iter().fold(Isometry3::identity(), |pose, step| {
        let moved = match step.motion {
            None => Isometry3::identity(),
            Some((axis, AxisKind::Linear, direction)) => Translation3::from(direction * q[axis]).into(),
            Some((axis, AxisKind::Rotary, direction)) => Isometry3::rotation(direction * q[axis]),
        };
        pose * step.origin * moved
    })
}

/// Number of moving joints on the way between two links.
fn moving_between(a: &[Step], b: &[Step]) -> usize {
    let shared = a.iter().zip(b).take_while(|(a, b)| a.joint == b.joint).count();
    a[shared..].iter().chain(&b[shared..]).filter(|s| s.motion.is_some()).count()
}

/// The eight corners of the linear axes' travel, rotary axes at 0.
fn corners_of_travel(machine: &Machine) -> Vec<Joints> {
    let corner = |bits: usize| {
        let mut q = [0.0; 5];
        for (i, value) in q.iter_mut().enumerate().take(3) {
            *value = machine.axes()[i].limits.map_or(0.0, |limits| limits[bits >> i & 1]);
        }
        q
    };
    (0..8).map(corner).collect()
}

fn solid(geometry: &Geometry) -> Option<Solid> {
    match geometry {
        Geometry::Box { size } => Some(Solid::Cuboid(Vector3::from(**size) * 0.5)),
        Geometry::Cylinder { radius, length } => {
            Some(Solid::Cylinder { radius: *radius, half_length: 0.5 * length })
        }
        Geometry::Capsule { radius, length } => {
            Some(Solid::Cylinder { radius: *radius, half_length: 0.5 * length + radius })
        }
        Geometry::Sphere { radius } => Some(Solid::Sphere(*radius)),
        Geometry::Mesh { .. } => None,
    }
}

fn is_sized(solid: &Solid) -> bool {
    let positive = |v: f64| v.is_finite() && v > 0.0;
    match solid {
        Solid::Cuboid(half) => half.iter().all(|v| positive(*v)),
        Solid::Cylinder { radius, half_length } => positive(*radius) && positive(*half_length),
        Solid::Sphere(radius) => positive(*radius),
    }
}

fn isometry(origin: &Pose) -> Isometry3<f64> {
    let ([x, y, z], [roll, pitch, yaw]) = (*origin.xyz, *origin.rpy);
    Isometry3::from_parts(Translation3::new(x, y, z), UnitQuaternion::from_euler_angles(roll, pitch, yaw))
}

#[cfg(test)]
mod tests;
