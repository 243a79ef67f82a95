//! The exact drop of a toroidal, ball or flat cutter along its axis onto a mesh.

use nalgebra::{Matrix3, Point3, Rotation3, Unit, Vector3};
use rayon::prelude::*;

use crate::bvh::{Aabb, Bvh};
use crate::contact_tree::{ContactNode, ContactTree, Profile, SLACK, steepness};
use crate::cutter::Cutter;
use crate::drop_facet::{Best, DropFacet};
use crate::drop_window::{Pruned, Window};
use crate::mesh::TriangleMesh;
use crate::mesh_edges::NONE;

/// Nodes whose mean normal leans further than this (its z share) are bounded by their height alone.
const LEANING: f64 = 0.1;
/// A facet counts as facing the tool when its plan area is above this share of its edge squared.
const FACING: f64 = 1e-6;

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
/// A million triangles take 170 MB. Where the tool axis stays in a part of the mesh, [`Self::within`] holds only what the
/// cutter can meet there.
#[derive(Clone, Debug)]
pub struct DropCutter {
    frame: Rotation3<f64>,
    facets: Vec<DropFacet>,
    tree: ContactTree,
    window: Window,
}

impl DropCutter {
    /// Brings `mesh` into the tool frame: z = `axis` (tip to spindle), x = `x_hint` made perpendicular to it,
    /// y = z × x, origin = workpiece origin. An `x_hint` along the axis (or zero) is replaced by the
    /// coordinate axis most across it. `bvh` is the hierarchy of the same mesh.
    pub fn new(
        mesh: &TriangleMesh,
        bvh: &Bvh,
        cutter: Cutter,
        axis: &Unit<Vector3<f64>>,
        x_hint: &Vector3<f64>,
    ) -> Self {
        Self::within(Window::WHOLE, mesh, bvh, cutter, tool_frame(axis, x_hint))
    }

    /// The same in a given `frame` (tool_frame_from_workpiece), for tool axes in a window of it.
    pub fn within(
        window: Window,
        mesh: &TriangleMesh,
        bvh: &Bvh,
        cutter: Cutter,
        frame: Rotation3<f64>,
    ) -> Self {
        let tool = Profile::of(cutter);
        let pruned = Pruned::of(bvh, &frame, &window, tool.radius);
        // In the mesh's own order, which is quicker than neighbour by neighbour.
        let facing: Vec<bool> = if pruned.order.is_empty() {
            Vec::new()
        } else {
            mesh.triangles.par_iter().map(|t| faces_tool(&t.map(|v| vertex(mesh, &frame, v)))).collect()
        };
        let facet = |&t: &u32| {
            let parts = tested_parts(bvh, t, |t| facing[t as usize]);
            DropFacet::new(&tool, mesh.triangles[t as usize].map(|v| vertex(mesh, &frame, v)), t, parts)
        };
        let facets: Vec<DropFacet> = pruned.order.par_iter().map(facet).collect();
        let tree = ContactTree { nodes: contact_nodes(bvh, &pruned, &frame, &tool, &facets), tool };
        Self { frame, facets, tree, window }
    }

    /// Where the tool axis may be.
    pub fn window(&self) -> &Window {
        &self.window
    }

    /// Whether drops with the tool axis at (x, y) of the tool frame (m) see all that the cutter can meet there.
    #[inline]
    pub fn covers(&self, x: f64, y: f64) -> bool {
        self.window.covers(x, y)
    }

    /// The rotation tool_frame_from_workpiece.
    pub fn frame(&self) -> &Rotation3<f64> {
        &self.frame
    }

    /// Drops the cutter with its axis at (x, y) of the tool frame (m), which it has to cover; `None` if it meets nothing.
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
        let mut found = Best { z: floor, contact: [0.0; 3], triangle: NONE };
        self.tree.search(x, y, floor, |range, best| {
            for facet in &self.facets[range] {
                facet.raise(&self.tree.tool, x, y, &mut found);
            }
            *best = found.z;
        });
        result(found)
    }

    /// The same anywhere, from the mesh and hierarchy that this was made of: without a hierarchy of its own, a hundred times slower
    /// on a fine mesh. For the few places that it does not cover.
    pub fn drop_outside(&self, mesh: &TriangleMesh, bvh: &Bvh, (x, y): (f64, f64), z0: f64) -> Option<Drop> {
        if !(x.is_finite() && y.is_finite()) || z0.is_nan() {
            return None;
        }
        let tool = &self.tree.tool;
        let here = Window { min: [x, y], max: [x, y] };
        let corners = |t: u32| mesh.triangles[t as usize].map(|v| vertex(mesh, &self.frame, v));
        let mut found = Best { z: z0 - 4.0 * SLACK, contact: [0.0; 3], triangle: NONE };
        bvh.for_each_triangle(
            |min, max| here.meets(&self.frame, &Aabb { min: *min, max: *max }, tool.radius),
            |t| {
                let parts = tested_parts(bvh, t, |t| faces_tool(&corners(t)));
                DropFacet::new(tool, corners(t), t, parts).raise(tool, x, y, &mut found);
            },
        );
        result(found)
    }

    /// The same as [`Self::drop`] by trying every triangle: slow, for checking.
    pub fn drop_on_all(&self, x: f64, y: f64) -> Option<Drop> {
        let mut found = Best { z: f64::NEG_INFINITY, contact: [0.0; 3], triangle: NONE };
        for facet in &self.facets {
            facet.raise(&self.tree.tool, x, y, &mut found);
        }
        result(found)
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

/// Boxes in plan from the facets, upper planes from the hierarchy's bounding planes.
fn contact_nodes(
    bvh: &Bvh,
    pruned: &Pruned,
    frame: &Rotation3<f64>,
    tool: &Profile,
    facets: &[DropFacet],
) -> Vec<ContactNode> {
    let mut nodes = vec![ContactNode::default(); pruned.splits.len()];
    let mut boxes = vec![[0.0f64; 5]; pruned.splits.len()]; // min x, min y, max x, max y, max z
    for i in (0..nodes.len()).rev() {
        let (split, bounds) = (&pruned.splits[i], &bvh.bounds[pruned.sources[i] as usize]);
        boxes[i] = if split.right == 0 {
            let corners = facets[split.range()].iter().flat_map(DropFacet::corners);
            let empty =
                [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];
            corners.fold(empty, |b, c| union(&b, &[c[0], c[1], c[0], c[1], c[2]]))
        } else {
            union(&boxes[i + 1], &boxes[split.right as usize])
        };
        let b = &boxes[i];
        let centre = [0.5 * (b[0] + b[2]), 0.5 * (b[1] + b[3])];
        let n = frame * bounds.normal;
        let (slope, top) = if n.z > LEANING {
            let height = (bounds.offset - n.x * centre[0] - n.y * centre[1]) / n.z;
            ([-n.x / n.z, -n.y / n.z], height)
        } else {
            ([0.0; 2], b[4])
        };
        nodes[i] = ContactNode {
            centre,
            half: [b[2] - centre[0], b[3] - centre[1]],
            slope,
            top,
            toe: tool.toe(slope),
            rise: tool.rise(steepness(slope)),
            first: split.first,
            count: if split.right == 0 { split.count } else { 0 },
            right: split.right,
        };
    }
    nodes
}

fn union(a: &[f64; 5], b: &[f64; 5]) -> [f64; 5] {
    [a[0].min(b[0]), a[1].min(b[1]), a[2].max(b[2]), a[3].max(b[3]), a[4].max(b[4])]
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

    fn cutter_at(mesh: &TriangleMesh, cutter: Cutter, axis: Vector3<f64>) -> DropCutter {
        DropCutter::new(mesh, &Bvh::build(mesh), cutter, &Unit::new_normalize(axis), &Vector3::x())
    }

    /// Every facet, every edge, every vertex, by formulas of its own for facets; no flags, no bounds.
    fn brute_force(mesh: &TriangleMesh, drops: &DropCutter, x: f64, y: f64) -> f64 {
        let tool = &drops.tree.tool;
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
                if let Some((z, _)) = inside_contact(tool, &local[k], &local[(k + 1) % 3]) {
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
                let drops = cutter_at(&mesh, cutter, axis);
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
                        assert!((d.z + drops.tree.tool.lift(rho) - d.contact.z).abs() < 1e-11);
                        let again = drops.drop_from(x, y, z).map(|d| d.z);
                        assert!(again.is_some_and(|a| (a - z).abs() < 1e-12));
                        assert!(drops.drop_from(x, y, z + 1e-9).is_none());
                    }
                }
            }
        }
    }

    #[test]
    fn a_window_sees_all_that_the_cutter_can_meet_there() {
        let mut random = Random::new(12);
        for mesh in [bumpy(40, 0.06, 0.004), random_soup(800, 5)] {
            let bvh = Bvh::build(&mesh);
            for cutter in CUTTERS {
                let axis = Unit::new_normalize(Vector3::z() + random.unit_vector() * 0.5);
                let whole = DropCutter::new(&mesh, &bvh, cutter, &axis, &Vector3::x());
                let corners = [(); 2].map(|()| [random.in_range(-0.06, 0.06), random.in_range(-0.06, 0.06)]);
                let window = Window::around(corners.into_iter(), 1e-3);
                let part = DropCutter::within(window, &mesh, &bvh, cutter, *whole.frame());
                assert!(part.facets.len() < whole.facets.len());
                for _ in 0..300 {
                    let (x, y) = (random.in_range(-0.07, 0.07), random.in_range(-0.07, 0.07));
                    let expected = whole.drop(x, y).map(|d| d.z);
                    let floor = expected.map_or(f64::NEG_INFINITY, |z| z - random.in_range(0.0, 1e-3));
                    let slow = part.drop_outside(&mesh, &bvh, (x, y), floor).map(|d| d.z);
                    let fast = if part.covers(x, y) { part.drop(x, y).map(|d| d.z) } else { slow };
                    for found in [slow, fast] {
                        assert_eq!(found.is_some(), expected.is_some(), "{cutter:?} {x} {y}");
                        assert!(found.zip(expected).is_none_or(|(a, b)| (a - b).abs() < 4e-13));
                    }
                }
                let none = DropCutter::within(Window::EMPTY, &mesh, &bvh, cutter, *whole.frame());
                assert!(none.facets.is_empty() && !none.covers(0.0, 0.0));
            }
        }
    }

    #[test]
    fn no_vertex_ends_up_inside_the_cutter() {
        let mesh = bumpy(60, 0.03, 0.004);
        let mut random = Random::new(9);
        for cutter in CUTTERS {
            let drops = cutter_at(&mesh, cutter, Vector3::new(0.3, -0.1, 1.0));
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
        let drops = cutter_at(&mesh, cutter, axis);
        let drop = drops.drop(0.003, 0.01).unwrap();
        let tip = drops.frame().inverse() * Point3::new(0.003, 0.01, drop.z);
        // The corner's lowest point is R2 below its mid-circle, which dips R1 sin of the lead below C.
        let centre = tip + axis * cutter.r2;
        assert!((centre.z - (0.002 + cutter.r2 + cutter.r1 * lead.sin())).abs() < 1e-13);
        // Level: the flat bottom rests on the plane, on a corner, at the border.
        let level = cutter_at(&mesh, cutter, Vector3::z());
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
        let needle = cutter_at(&mesh, cutter, Vector3::z());
        assert!((needle.drop(0.0, 0.017).unwrap().z - (0.05 - cutter.lift(0.017).unwrap())).abs() < 1e-15);
    }

    #[test]
    fn ball_in_a_bowl_and_torus_on_a_dome() {
        // Facets of a bowl lie above the sphere by their sagitta at most, those of a dome below it.
        let (radius, n) = (0.05f64, 200);
        let sphere = |x: f64, y: f64| (radius * radius - x * x - y * y).sqrt();
        let sagitta = 2.0 * (0.02f64 / n as f64).powi(2) / radius;
        let ball = Cutter { r1: 0.0, r2: 0.006 };
        let bowl = cutter_at(&height_field(n, 0.02, |x, y| -sphere(x, y)), ball, Vector3::z());
        let (x, y) = (0.004f64, -0.007f64);
        let expected = -((radius - 0.006f64).powi(2) - x * x - y * y).sqrt() - 0.006;
        let found = bowl.drop(x, y).unwrap().z;
        assert!(found - expected > -1e-12 && found - expected < sagitta);
        let torus = Cutter { r1: 0.01, r2: 0.003 };
        let dome = cutter_at(&height_field(n, 0.02, sphere), torus, Vector3::z());
        let rho = 0.025f64;
        let (x, y) = (rho * 0.6, rho * 0.8);
        let expected = ((radius + 0.003).powi(2) - (rho - 0.01).powi(2)).sqrt() - 0.003;
        let found = dome.drop(x, y).unwrap().z;
        assert!(expected - found > -1e-12 && expected - found < 1.2 * sagitta);
    }
}
