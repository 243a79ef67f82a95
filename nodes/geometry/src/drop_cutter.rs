//! The exact drop of a toroidal, ball or flat cutter along its axis onto a mesh.

use std::sync::OnceLock;

use nalgebra::{Matrix3, Point3, Rotation3, Unit, Vector3};

use crate::bvh::{Bounds, Bvh};
use crate::contact_tree::{ContactNode, ContactTree, Profile, SLACK, steepness};
use crate::cutter::Cutter;
use crate::drop_facet::{Best, DropFacet};
use crate::mesh::TriangleMesh;
use crate::mesh_edges::NONE;
use crate::split_tree::{Split, nodes_of};

/// Nodes whose mean normal leans further than this (its z share) are bounded by their height alone.
const LEANING: f64 = 0.1;
/// A facet counts as facing the tool when its plan area is above this share of its edge squared.
const FACING: f64 = 1e-6;
/// Most triangles of a block. Larger ones hold more that no drop asks for, smaller ones leave more nodes to the looser boxes above them.
const BLOCK: u32 = 128;

/// Where a dropped cutter rests.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Drop {
    /// Height of the tool tip, tool-frame z, m.
    pub z: f64,
    /// The contact (CC point), tool frame, m.
    pub contact: Point3<f64>,
    /// The triangle that holds the contact (one of them, where it is on a shared edge or vertex).
    pub triangle: u32,
}

/// A mesh in the frame of one tool axis, ready for drops of one cutter along −z of that frame.
///
/// Contacts on facets and corners are closed forms, on edges a safeguarded Newton iteration; heights are
/// exact to 1e-12 m for parts of up to metres. Facets seen from behind (normal pointing away from the spindle)
/// take part with their edges and corners. The part of the tool above its corner (shank, holder) is not looked at.
///
/// The mesh is brought into the frame block by block, when a drop first looks at one: where the contacts are, not wherever the cutter
/// reaches. That takes 170 bytes a triangle of such blocks.
#[derive(Debug)]
pub struct DropCutter<'a> {
    mesh: &'a TriangleMesh,
    bvh: &'a Bvh,
    frame: Rotation3<f64>,
    /// The hierarchy down to the blocks, which are its items.
    top: ContactTree,
    blocks: Vec<Block>,
}

/// A subtree of the mesh's hierarchy.
#[derive(Debug)]
struct Block {
    /// Its node in the mesh's hierarchy.
    root: u32,
    held: OnceLock<Held>,
}

/// A block in the tool frame.
#[derive(Debug)]
struct Held {
    tree: ContactTree,
    /// In leaf order.
    facets: Vec<DropFacet>,
}

impl<'a> DropCutter<'a> {
    /// Brings `mesh` into the tool frame: z = `axis` (tip to spindle), x = `x_hint` made perpendicular to it,
    /// y = z × x, origin = workpiece origin. An `x_hint` along the axis (or zero) is replaced by the
    /// coordinate axis most across it. `bvh` is the hierarchy of the same mesh.
    pub fn new(
        mesh: &'a TriangleMesh,
        bvh: &'a Bvh,
        cutter: Cutter,
        axis: &Unit<Vector3<f64>>,
        x_hint: &Vector3<f64>,
    ) -> Self {
        Self::in_frame(mesh, bvh, cutter, tool_frame(axis, x_hint))
    }

    /// The same in a given `frame` (tool_frame_from_workpiece).
    pub fn in_frame(mesh: &'a TriangleMesh, bvh: &'a Bvh, cutter: Cutter, frame: Rotation3<f64>) -> Self {
        let top = ContactTree { nodes: Vec::new(), tool: Profile::of(cutter) };
        let mut made = Self { mesh, bvh, frame, top, blocks: Vec::new() };
        if !bvh.is_empty() {
            made.add_top(0);
        }
        made
    }

    /// Adds the nodes above the blocks below `node` of the mesh's hierarchy.
    fn add_top(&mut self, node: usize) {
        let (split, bounds) = (self.bvh.splits[node], &self.bvh.bounds[node]);
        let at = self.top.nodes.len();
        let (frame, tool) = (&self.frame, &self.top.tool);
        let mut own = contact_node(bounds, &plan_box(bounds, frame), frame, tool);
        if split.right == 0 || split.count <= BLOCK {
            (own.first, own.count) = (self.blocks.len() as u32, 1);
            self.top.nodes.push(own);
            self.blocks.push(Block { root: node as u32, held: OnceLock::new() });
        } else {
            self.top.nodes.push(own);
            self.add_top(node + 1);
            self.top.nodes[at].right = self.top.nodes.len() as u32;
            self.add_top(split.right as usize);
        }
    }

    /// Gives back the memory that drops have taken; the next ones take it again.
    pub fn release(&mut self) {
        self.blocks.iter_mut().for_each(|block| block.held = OnceLock::new());
    }

    /// The rotation tool_frame_from_workpiece.
    pub fn frame(&self) -> &Rotation3<f64> {
        &self.frame
    }

    fn held(&self, block: usize) -> &Held {
        let Block { root, held } = &self.blocks[block];
        held.get_or_init(|| Held::of(self.mesh, self.bvh, &self.frame, &self.top.tool, *root as usize))
    }

    /// Drops the cutter with its axis at (x, y) of the tool frame (m); `None` if it meets nothing.
    pub fn drop(&self, x: f64, y: f64) -> Option<Drop> {
        self.drop_from(x, y, f64::NEG_INFINITY)
    }

    /// The same, told a height `z0` (m) that the tip does not get below, which saves work. `None` if the tool
    /// meets nothing or would rest below `z0`, or if a number is NaN.
    pub fn drop_from(&self, x: f64, y: f64, z0: f64) -> Option<Drop> {
        if !(x.is_finite() && y.is_finite()) || z0.is_nan() {
            return None;
        }
        let floor = z0 - 4.0 * SLACK;
        let tool = &self.top.tool;
        let mut found = Best { z: floor, contact: [0.0; 3], triangle: NONE };
        self.top.search(x, y, floor, |blocks, best| {
            for block in blocks {
                let held = self.held(block);
                held.tree.search(x, y, found.z, |range, best| {
                    held.facets[range].iter().for_each(|facet| facet.raise(tool, x, y, &mut found));
                    *best = found.z;
                });
            }
            *best = found.z;
        });
        result(found)
    }

    /// The same as [`Self::drop`] by trying every triangle: slow, for checking.
    pub fn drop_on_all(&self, x: f64, y: f64) -> Option<Drop> {
        let mut found = Best { z: f64::NEG_INFINITY, contact: [0.0; 3], triangle: NONE };
        for block in 0..self.blocks.len() {
            self.held(block).facets.iter().for_each(|facet| facet.raise(&self.top.tool, x, y, &mut found));
        }
        result(found)
    }
}

impl Held {
    /// The subtree of node `root`.
    fn of(mesh: &TriangleMesh, bvh: &Bvh, frame: &Rotation3<f64>, tool: &Profile, root: usize) -> Self {
        let whole = bvh.splits[root];
        let corners = |t: u32| mesh.triangles[t as usize].map(|v| vertex(mesh, frame, v));
        let facet = |&t: &u32| {
            let parts = tested_parts(bvh, t, |t| faces_tool(&corners(t)));
            DropFacet::new(tool, corners(t), t, parts)
        };
        let facets: Vec<DropFacet> = bvh.order[whole.range()].iter().map(facet).collect();
        let mut nodes = vec![ContactNode::default(); nodes_of(whole.count as usize)];
        let mut boxes = vec![EMPTY; nodes.len()];
        for i in (0..nodes.len()).rev() {
            let (split, bounds) = (&bvh.splits[root + i], &bvh.bounds[root + i]);
            let (first, right) = (split.first - whole.first, split.right as usize);
            boxes[i] = if right == 0 {
                let own = &facets[Split { first, ..*split }.range()];
                let corners = own.iter().flat_map(DropFacet::corners);
                corners.fold(EMPTY, |b, c| union(&b, &[c[0], c[1], c[0], c[1], c[2]]))
            } else {
                union(&boxes[i + 1], &boxes[right - root])
            };
            nodes[i] = ContactNode {
                first,
                count: if right == 0 { split.count } else { 0 },
                right: right.saturating_sub(root) as u32,
                ..contact_node(bounds, &boxes[i], frame, tool)
            };
        }
        Self { tree: ContactTree { nodes, tool: *tool }, facets }
    }
}

fn result(found: Best) -> Option<Drop> {
    (found.triangle != NONE).then(|| Drop {
        z: found.z,
        contact: Point3::from(found.contact),
        triangle: found.triangle,
    })
}

/// Rotation into the frame with z along `axis` and x towards `x_hint`.
pub fn tool_frame(axis: &Unit<Vector3<f64>>, x_hint: &Vector3<f64>) -> Rotation3<f64> {
    let across = |hint: &Vector3<f64>| hint - axis.into_inner() * hint.dot(axis);
    let mut x = across(x_hint);
    if x.norm() <= 1e-9 * x_hint.norm() || !x.iter().all(|c| c.is_finite()) {
        let mut fallback = Vector3::zeros();
        fallback[axis.iamin()] = 1.0;
        x = across(&fallback);
    }
    let x = x.normalize();
    let y = axis.cross(&x);
    Rotation3::from_matrix_unchecked(Matrix3::from_rows(&[x.transpose(), y.transpose(), axis.transpose()]))
}

/// A vertex of the mesh in the tool frame, m.
#[inline]
fn vertex(mesh: &TriangleMesh, frame: &Rotation3<f64>, v: u32) -> [f64; 3] {
    (frame * mesh.vertices[v as usize]).coords.into()
}

/// Whether a triangle (corners in the tool frame) turns its front to the tool.
#[inline]
fn faces_tool([a, b, c]: &[[f64; 3]; 3]) -> bool {
    let (u, v) = ([b[0] - a[0], b[1] - a[1]], [c[0] - a[0], c[1] - a[1]]);
    let longest = (u[0] * u[0] + u[1] * u[1]).max(v[0] * v[0] + v[1] * v[1]);
    u[0] * v[1] - u[1] * v[0] > FACING * longest
}

/// The edges and corners that triangle `t` is to test: those it owns, without valley edges.
///
/// At a valley between two facets that both face the tool, one of them rises faster than the tool's lift
/// whichever way the tool leans: the highest contact is never inside such an edge.
fn tested_parts(bvh: &Bvh, t: u32, faces_tool: impl Fn(u32) -> bool) -> u8 {
    let mut parts = bvh.edges.owned[t as usize];
    for (k, neighbour) in bvh.edges.valley[t as usize].into_iter().enumerate() {
        if parts & (1 << k) != 0 && neighbour != NONE && faces_tool(t) && faces_tool(neighbour) {
            parts &= !(1 << k);
        }
    }
    parts
}

/// Smallest x and y, largest x, y and z, tool frame, m.
type PlanBox = [f64; 5];

const EMPTY: PlanBox =
    [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];

fn union(a: &PlanBox, b: &PlanBox) -> PlanBox {
    [a[0].min(b[0]), a[1].min(b[1]), a[2].max(b[2]), a[3].max(b[3]), a[4].max(b[4])]
}

/// Around a node's box of the workpiece frame.
fn plan_box(bounds: &Bounds, frame: &Rotation3<f64>) -> PlanBox {
    let [x, y, z] = [0, 1, 2].map(|row| frame.matrix().row(row).transpose());
    let most = |direction: &Vector3<f64>| bounds.aabb.support(direction);
    [-most(&-x), -most(&-y), most(&x), most(&y), most(&z)]
}

/// A node of a box in plan and the upper plane of the hierarchy's bounds; its place in the tree is left to the caller.
fn contact_node(bounds: &Bounds, b: &PlanBox, frame: &Rotation3<f64>, tool: &Profile) -> ContactNode {
    let centre = [0.5 * (b[0] + b[2]), 0.5 * (b[1] + b[3])];
    let n = frame * bounds.normal;
    let (slope, top) = if n.z > LEANING {
        let height = (bounds.offset - n.x * centre[0] - n.y * centre[1]) / n.z;
        ([-n.x / n.z, -n.y / n.z], height)
    } else {
        ([0.0; 2], b[4])
    };
    ContactNode {
        centre,
        half: [b[2] - centre[0], b[3] - centre[1]],
        slope,
        top,
        toe: tool.toe(slope),
        rise: tool.rise(steepness(slope)),
        ..ContactNode::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::edge_contact::inside_contact;
    use crate::test_meshes::{Random, bumpy, height_field, random_soup};

    const CUTTERS: [Cutter; 4] = [
        Cutter { r1: 0.01305, r2: 0.006 },
        Cutter { r1: 0.0, r2: 0.006 },
        Cutter { r1: 0.008, r2: 0.0 },
        Cutter { r1: 0.001, r2: 0.004 },
    ];

    fn cutter_at<'a>(
        mesh: &'a TriangleMesh,
        bvh: &'a Bvh,
        cutter: Cutter,
        axis: Vector3<f64>,
    ) -> DropCutter<'a> {
        DropCutter::new(mesh, bvh, cutter, &Unit::new_normalize(axis), &Vector3::x())
    }

    /// Every facet, every edge, every vertex, by formulas of its own for facets; no flags, no bounds.
    fn brute_force(mesh: &TriangleMesh, drops: &DropCutter, x: f64, y: f64) -> f64 {
        let tool = &drops.top.tool;
        let mut best = f64::NEG_INFINITY;
        for t in 0..mesh.triangles.len() {
            let p = mesh.corners(t).map(|p| drops.frame() * p);
            let n = (p[1] - p[0]).cross(&(p[2] - p[0])).normalize();
            let across = Vector3::new(n.x, n.y, 0.0);
            if n.z > 0.0 && across.norm() > 1e-12 {
                // Torus centre C with n·(C − R2 n − R1 ĥ) on the plane.
                let reach = n.dot(&p[0].coords) + tool.r2 + tool.r1 * across.norm();
                let centre = Point3::new(x, y, (reach - n.x * x - n.y * y) / n.z);
                let q = centre - n * tool.r2 - across.normalize() * tool.r1;
                let inside = (0..3).all(|k| {
                    let (a, b) = (p[k], p[(k + 1) % 3]);
                    (b - a).cross(&(q - a)).dot(&n) >= 0.0
                });
                if inside {
                    best = best.max(centre.z - tool.r2);
                }
            }
            let local = p.map(|p| [p.x - x, p.y - y, p.z]);
            for k in 0..3 {
                let rho = local[k][0].hypot(local[k][1]);
                if rho <= tool.radius {
                    best = best.max(local[k][2] - tool.lift(rho));
                }
                if let Some((z, _)) = inside_contact(tool, &local[k], &local[(k + 1) % 3], f64::NEG_INFINITY)
                {
                    best = best.max(z);
                }
            }
        }
        best
    }

    #[test]
    fn drops_match_all_triangles_without_hierarchy() {
        let mut random = Random::new(2);
        for (mesh, half) in [
            (bumpy(30, 0.03, 0.003), 0.04),
            (bumpy(6, 0.03, 0.008), 0.04),
            (random_soup(500, 4), 0.07),
            (height_field(20, 0.03, |x, y| (x * x - y * y) / 0.1), 0.04),
        ] {
            for cutter in CUTTERS {
                let axis = Vector3::z() + random.unit_vector() * 0.5;
                let bvh = Bvh::build(&mesh);
                let drops = cutter_at(&mesh, &bvh, cutter, axis);
                for _ in 0..150 {
                    let (x, y) = (random.in_range(-half, half), random.in_range(-half, half));
                    let expected = brute_force(&mesh, &drops, x, y);
                    let found = drops.drop(x, y);
                    let z = found.map_or(f64::NEG_INFINITY, |d| d.z);
                    assert!(
                        z == expected || (z - expected).abs() < 1e-12,
                        "{cutter:?} {x} {y}: {z} {expected}"
                    );
                    assert_eq!(drops.drop_on_all(x, y).map(|d| (d.z - z).abs() < 2e-13), found.map(|_| true));
                    if let Some(d) = found {
                        let rho = (d.contact.x - x).hypot(d.contact.y - y);
                        assert!((d.z + drops.top.tool.lift(rho) - d.contact.z).abs() < 1e-11);
                        let again = drops.drop_from(x, y, z).map(|d| d.z);
                        assert!(again.is_some_and(|a| (a - z).abs() < 1e-12));
                        assert!(drops.drop_from(x, y, z + 1e-9).is_none());
                    }
                }
            }
        }
    }

    #[test]
    fn drops_look_at_no_more_than_they_need_and_take_it_again() {
        let mesh = bumpy(100, 0.06, 0.004);
        let bvh = Bvh::build(&mesh);
        let mut drops = cutter_at(&mesh, &bvh, CUTTERS[0], Vector3::new(0.3, -0.1, 1.0));
        let held = |drops: &DropCutter| drops.blocks.iter().filter(|b| b.held.get().is_some()).count();
        assert!(drops.blocks.len() > 100 && held(&drops) == 0);
        let first = drops.drop(0.003, 0.01);
        assert!((1..20).contains(&held(&drops)), "{}", held(&drops));
        drops.release();
        assert_eq!((held(&drops), drops.drop(0.003, 0.01)), (0, first));
    }

    #[test]
    fn no_vertex_ends_up_inside_the_cutter() {
        let mesh = bumpy(60, 0.03, 0.004);
        let mut random = Random::new(9);
        for cutter in CUTTERS {
            let bvh = Bvh::build(&mesh);
            let drops = cutter_at(&mesh, &bvh, cutter, Vector3::new(0.3, -0.1, 1.0));
            for _ in 0..100 {
                let (x, y) = (random.in_range(-0.03, 0.03), random.in_range(-0.03, 0.03));
                let z = drops.drop(x, y).unwrap().z;
                for p in &mesh.vertices {
                    let q = drops.frame() * p;
                    if let Some(lift) = cutter.lift((q.x - x).hypot(q.y - y)) {
                        assert!(q.z <= z + lift + 1e-12);
                    }
                }
            }
        }
    }

    #[test]
    fn plane_edge_and_corner_by_formula() {
        let cutter = Cutter { r1: 0.013, r2: 0.006 };
        let mut mesh = height_field(1, 0.1, |_, _| 0.002);
        let axis = Vector3::new(0.2, 0.0, 1.0).normalize();
        let lead = 0.2f64.atan();
        let bvh = Bvh::build(&mesh);
        let drops = cutter_at(&mesh, &bvh, cutter, axis);
        let drop = drops.drop(0.003, 0.01).unwrap();
        let tip = drops.frame().inverse() * Point3::new(0.003, 0.01, drop.z);
        // The corner's lowest point is R2 below its mid-circle, which dips R1 sin of the lead below C.
        let centre = tip + axis * cutter.r2;
        assert!((centre.z - (0.002 + cutter.r2 + cutter.r1 * lead.sin())).abs() < 1e-13);
        // Level: the flat bottom rests on the plane, on a corner, at the border.
        let level = cutter_at(&mesh, &bvh, cutter, Vector3::z());
        for (x, y) in [(0.0, 0.0), (0.03, -0.01), (0.1, 0.1), (0.11, 0.05), (-0.1, 0.112)] {
            assert!((level.drop(x, y).unwrap().z - 0.002).abs() < 1e-15, "{x} {y}");
        }
        let off = 0.1 + cutter.r1 + 0.004;
        let edge = level.drop(off, 0.02).unwrap();
        assert!((edge.z - (0.002 - (0.006 - (36e-6f64 - 16e-6).sqrt()))).abs() < 1e-14);
        assert!((edge.contact - Point3::new(0.1, 0.02, 0.002)).norm() < 1e-14);
        assert!(level.drop(0.1 + 0.0191, 0.0).is_none());
        // A needle: one vertical sliver of a triangle seen from behind.
        mesh.vertices =
            vec![Point3::new(0.0, 0.0, 0.05), Point3::new(0.0, 1e-4, 0.0), Point3::new(0.0, -1e-4, 0.0)];
        mesh.triangles = vec![[0, 1, 2]];
        let bvh = Bvh::build(&mesh);
        let needle = cutter_at(&mesh, &bvh, cutter, Vector3::z());
        assert!((needle.drop(0.0, 0.017).unwrap().z - (0.05 - cutter.lift(0.017).unwrap())).abs() < 1e-15);
    }

    #[test]
    fn ball_in_a_bowl_and_torus_on_a_dome() {
        // Facets of a bowl lie above the sphere by their sagitta at most, those of a dome below it.
        let (radius, n) = (0.05f64, 200);
        let sphere = |x: f64, y: f64| (radius * radius - x * x - y * y).sqrt();
        let sagitta = 2.0 * (0.02f64 / n as f64).powi(2) / radius;
        let ball = Cutter { r1: 0.0, r2: 0.006 };
        let mesh = height_field(n, 0.02, |x, y| -sphere(x, y));
        let bvh = Bvh::build(&mesh);
        let bowl = cutter_at(&mesh, &bvh, ball, Vector3::z());
        let (x, y) = (0.004f64, -0.007f64);
        let expected = -((radius - 0.006f64).powi(2) - x * x - y * y).sqrt() - 0.006;
        let found = bowl.drop(x, y).unwrap().z;
        assert!(found - expected > -1e-12 && found - expected < sagitta);
        let torus = Cutter { r1: 0.01, r2: 0.003 };
        let mesh = height_field(n, 0.02, sphere);
        let bvh = Bvh::build(&mesh);
        let dome = cutter_at(&mesh, &bvh, torus, Vector3::z());
        let rho = 0.025f64;
        let (x, y) = (rho * 0.6, rho * 0.8);
        let expected = ((radius + 0.003).powi(2) - (rho - 0.01).powi(2)).sqrt() - 0.003;
        let found = dome.drop(x, y).unwrap().z;
        assert!(expected - found > -1e-12 && expected - found < 1.2 * sagitta);
    }
}
