//! The machine's links against each other and against the part, by the collision shapes of its URDF.
//!
//! Boxes, cylinders and spheres are taken as they are, capsules as the cylinder around them, meshes as their facets: a mesh whose
//! facets are not in the URDF's text is not looked at ([`MachineBodies::unchecked`] names its link), and one is not known to be solid,
//! so that a body met by no facet counts as outside. The tool hangs under the spindle as a stack of cylinders. A pair of
//! links is looked at when at least two joints move between them: neighbours rest on each other. Pairs that overlap at every
//! corner of the linear travel carry each other and are left out. Joints that are no axis of the machine stand at 0.

use std::collections::BTreeMap;
use std::sync::Arc;

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use patchmill_geometry::bvh::Bvh;
use patchmill_geometry::mesh::TriangleMesh;
use patchmill_kinematics::{AxisKind, Facets, Joints, Machine, collision_meshes};
use patchmill_products::job::Tool;
use patchmill_products::stage::StageError;
use urdf_rs::{Geometry, JointType, Pose, Robot};

use crate::convex_gap::{Convex, Placed, Solid, apart};
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

/// What a link consists of.
#[derive(Clone, Debug)]
enum Shape {
    Solid(Solid),
    Mesh(Arc<FacetTree>),
}

/// Facets in their hierarchy.
#[derive(Debug)]
struct FacetTree {
    mesh: TriangleMesh,
    bvh: Bvh,
}

/// A shape at its place in the world.
enum PlacedShape<'a> {
    Solid(Placed),
    Mesh(&'a FacetTree, Isometry3<f64>),
}

/// A link with its shapes.
#[derive(Clone, Debug)]
struct Body {
    link: String,
    steps: Vec<Step>,
    shapes: Vec<(Isometry3<f64>, Shape)>,
}

/// The machine's collision shapes and the pairs of links that are looked at.
#[derive(Clone, Debug, Default)]
pub struct MachineBodies {
    bodies: Vec<Body>,
    pairs: Vec<[usize; 2]>,
    /// The way to the workpiece, and the links that must not touch the part.
    workpiece: Vec<Step>,
    facing_part: Vec<usize>,
    /// Links with a collision mesh whose facets are not known.
    pub unchecked: Vec<String>,
}

impl MachineBodies {
    /// Reads the shapes from the machine's URDF text; `tool` hangs under `spindle`, else from `tool_tip` up.
    ///
    /// # Errors
    /// [`BAD_MACHINE`] when the text is no URDF, a shape's size is no positive number or a mesh's facets cannot be read.
    pub fn of(urdf: &str, machine: &Machine, tool: &Tool) -> Result<Self, StageError> {
        let robot =
            patchmill_kinematics::robot_of(urdf).map_err(|e| StageError::new(BAD_MACHINE, e.to_string()))?;
        let meshes = collision_meshes(urdf).map_err(|e| StageError::new(BAD_MACHINE, e.to_string()))?;
        let mut bodies = Vec::new();
        let mut unchecked: Vec<String> = Vec::new();
        for link in robot.links.iter().filter(|l| l.name != "tool_tip") {
            let mut shapes = Vec::new();
            for collision in &link.collision {
                let sizeless = || {
                    let text = format!(
                        "link {} of the machine's URDF has a collision shape of no size: {:?}; positive lengths were expected",
                        link.name, collision.geometry
                    );
                    StageError::new(BAD_MACHINE, text)
                };
                match shape(&collision.geometry, &meshes).ok_or_else(sizeless)? {
                    Some(shape) => shapes.push((isometry(&collision.origin), shape)),
                    None if unchecked.contains(&link.name) => {}
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
        let carried =
            |pair: &[usize; 2]| corners.iter().all(|q| found.touching(&found.placed(q), pair, MARGIN));
        let pairs = found.pairs.iter().copied().filter(|pair| !carried(pair)).collect();
        found.pairs = pairs;
        Ok(found)
    }

    /// Whether there is anything to look at besides the tool.
    pub fn is_empty(&self) -> bool {
        self.pairs.is_empty() && self.facing_part.is_empty()
    }

    /// Which links come closer to each other than `margin` (m) at a position, or which one to the part.
    pub fn touch_at(&self, q: &Joints, mesh: &TriangleMesh, bvh: &Bvh, margin: f64) -> Option<String> {
        let placed = self.placed(q);
        if let Some([i, j]) = self.pairs.iter().find(|pair| self.touching(&placed, pair, margin)) {
            let (a, b) = (&self.bodies[*i].link, &self.bodies[*j].link);
            return Some(format!("{a} touches {b}"));
        }
        let workpiece = pose(&self.workpiece, q);
        let on_part = |i: &&usize| {
            placed[**i].iter().any(|shape| match shape {
                PlacedShape::Solid(body) => {
                    let body = Placed { pose: workpiece.inv_mul(&body.pose), ..*body };
                    touches_mesh(&body, mesh, bvh, margin)
                }
                PlacedShape::Mesh(facets, pose) => {
                    meshes_touch(facets, &workpiece.inv_mul(pose), mesh, bvh, margin)
                }
            })
        };
        let link = self.facing_part.iter().find(on_part)?;
        Some(format!("{} touches the part", self.bodies[*link].link))
    }

    fn placed(&self, q: &Joints) -> Vec<Vec<PlacedShape<'_>>> {
        self.bodies.iter().map(|body| body.placed(q)).collect()
    }

    fn touching(&self, placed: &[Vec<PlacedShape<'_>>], [i, j]: &[usize; 2], margin: f64) -> bool {
        placed[*i].iter().any(|a| placed[*j].iter().any(|b| a.touches(b, margin)))
    }
}

impl Body {
    fn placed(&self, q: &Joints) -> Vec<PlacedShape<'_>> {
        let link = pose(&self.steps, q);
        self.shapes.iter().map(|(own, shape)| shape.at(link * own)).collect()
    }
}

impl Shape {
    fn at(&self, pose: Isometry3<f64>) -> PlacedShape<'_> {
        match self {
            Self::Solid(solid) => PlacedShape::Solid(Placed { solid: *solid, pose }),
            Self::Mesh(facets) => PlacedShape::Mesh(facets, pose),
        }
    }
}

impl PlacedShape<'_> {
    fn touches(&self, other: &Self, margin: f64) -> bool {
        match (self, other) {
            (Self::Solid(a), Self::Solid(b)) => !apart(a, b, margin),
            (Self::Solid(body), Self::Mesh(facets, pose)) | (Self::Mesh(facets, pose), Self::Solid(body)) => {
                let body = Placed { pose: pose.inv_mul(&body.pose), ..*body };
                touches_mesh(&body, &facets.mesh, &facets.bvh, margin)
            }
            (Self::Mesh(a, a_pose), Self::Mesh(b, b_pose)) => {
                meshes_touch(a, &b_pose.inv_mul(a_pose), &b.mesh, &b.bvh, margin)
            }
        }
    }
}

/// Whether a body in the mesh's frame comes closer to a facet than `margin`, m.
fn touches_mesh(body: &impl Convex, mesh: &TriangleMesh, bvh: &Bvh, margin: f64) -> bool {
    let found = std::cell::Cell::new(false);
    let near = |min: &[f64; 3], max: &[f64; 3]| {
        !found.get() && !apart(body, &cell(min, max, &Isometry3::identity()), margin)
    };
    bvh.for_each_triangle(near, |t| {
        if !found.get() && !apart(body, &mesh.corners(t as usize), margin) {
            found.set(true);
        }
    });
    found.get()
}

/// Whether facets at `pose` in the frame of a mesh come closer to it than `margin`, m.
fn meshes_touch(
    facets: &FacetTree,
    pose: &Isometry3<f64>,
    mesh: &TriangleMesh,
    bvh: &Bvh,
    margin: f64,
) -> bool {
    let found = std::cell::Cell::new(false);
    let near = |min: &[f64; 3], max: &[f64; 3]| {
        !found.get() && touches_mesh(&cell(min, max, pose), mesh, bvh, margin)
    };
    facets.bvh.for_each_triangle(near, |t| {
        let facet = || facets.mesh.corners(t as usize).map(|p| pose * p);
        if !found.get() && touches_mesh(&facet(), mesh, bvh, margin) {
            found.set(true);
        }
    });
    found.get()
}

/// A box along the axes of the frame that stands at `pose`.
fn cell(min: &[f64; 3], max: &[f64; 3], pose: &Isometry3<f64>) -> Placed {
    let (low, high) = (Vector3::from(*min), Vector3::from(*max));
    let middle = Translation3::from((low + high) * 0.5);
    Placed { solid: Solid::Cuboid((high - low) * 0.5), pose: pose * middle }
}

fn tool_body(robot: &Robot, machine: &Machine, tool: &Tool) -> Body {
    let under_spindle = robot.links.iter().any(|l| l.name == "spindle");
    let (link, tip) = if under_spindle { ("spindle", -tool.length) } else { ("tool_tip", 0.0) };
    let radius = tool.cutter.radius();
    let cylinder = |low: f64, high: f64, radius: f64| {
        let half_length = 0.5 * (high - low);
        let solid = Solid::Cylinder { radius, half_length };
        (Isometry3::translation(0.0, 0.0, tip + low + half_length), Shape::Solid(solid))
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

/// A collision shape; `Some(None)` for a mesh whose facets are not known, `None` for one without size.
fn shape(geometry: &Geometry, meshes: &BTreeMap<String, Facets>) -> Option<Option<Shape>> {
    let solid = match geometry {
        Geometry::Box { size } => Solid::Cuboid(Vector3::from(**size) * 0.5),
        Geometry::Cylinder { radius, length } => {
            Solid::Cylinder { radius: *radius, half_length: 0.5 * length }
        }
        Geometry::Capsule { radius, length } => {
            Solid::Cylinder { radius: *radius, half_length: 0.5 * length + radius }
        }
        Geometry::Sphere { radius } => Solid::Sphere(*radius),
        Geometry::Mesh { filename, scale } => {
            let scale = scale.map_or([1.0; 3], |scale| *scale);
            let sized = scale.iter().all(|v| v.is_finite() && *v != 0.0);
            let mesh = |facets| Shape::Mesh(Arc::new(FacetTree::of(facets, scale)));
            return sized.then(|| meshes.get(filename).map(mesh));
        }
    };
    is_sized(&solid).then_some(Some(Shape::Solid(solid)))
}

impl FacetTree {
    fn of(facets: &Facets, scale: [f64; 3]) -> Self {
        let scaled = |p: &Point3<f64>| Point3::from(p.coords.component_mul(&Vector3::from(scale)));
        let vertices: Vec<Point3<f64>> = facets.iter().flatten().map(scaled).collect();
        let triangles = (0..facets.len() as u32).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
        // Nothing here looks at normals.
        let normals = vec![Vector3::zeros(); vertices.len()];
        let mesh = TriangleMesh { vertices, normals, triangles, chord_error: 0.0, check_only: Vec::new() };
        let bvh = Bvh::build(&mesh);
        Self { mesh, bvh }
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
