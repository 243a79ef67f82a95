//! The ball that rolls on a surface, exactly: of all points within reach the one that stops it.
//!
//! The sphere tangent at P (unit normal n) that passes through Q has the curvature κ(Q) = 2 (d·n)/|d|², d = Q − P,
//! positive on the side of n. The most concave Q stops the ball: κ* = max κ(Q).
//!
//! κ(Q) > κ is the same as f(d) = 2 d·n − κ|d|² > 0, which is a sum of one parabola a coordinate: its maximum over an
//! axis-aligned box is a closed form for either sign of κ. So is that of f + λ (c − m·d), λ ≥ 0, which is no less than
//! f on the side m·d ≤ c of a plane: with the plane of a node's mean normal the thickness of the box drops out, and
//! with it all of the box's rise over an inclined surface.

use nalgebra::{Point3, Vector3};

use crate::bvh::Aabb;
use crate::mesh::TriangleMesh;
use crate::mesh_topology::MeshTopology;
use crate::split_tree::{Split, split_tree_to};
use crate::surface_points::SurfacePoints;

/// Most points in a leaf.
const LEAF: usize = 8;
/// Children of a node. Their bounds are worked out side by side, which the compiler turns into vector instructions.
const WIDTH: usize = 4;
/// Room on the stack of open nodes: three a level, and four levels of a binary tree of 2³² points are two of this one.
const OPEN: usize = 64;
/// Nodes with more points take their bounding plane from their box instead of from their points.
const PLANE_FIT: u32 = 2048;
/// Ranges longer than this are handled in parallel.
const PARALLEL: u32 = 8192;
/// No point that is anywhere has a κ below this, 1/m.
const LEAST: f64 = -1e100;
/// Bounds are widened by this share of the largest coordinate: far beyond rounding.
const ROUNDING: f64 = 1e-14;

/// Which points of the surface can stop a ball.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reach {
    /// Points nearer than this to the tangent point do not count, m: an error e of their positions and ε of the
    /// tangent point's normal turns into an error 2(e/|d|² + ε/|d|) of κ. There the principal curvature has the word.
    pub near: f64,
    /// Radius of the shadow about the tangent point, taken in the tangent plane, m; infinite for the whole surface.
    pub shadow: f64,
}

/// What stops a ball.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BallContact {
    /// κ* = 1/R*, 1/m, positive where concave.
    pub curvature: f64,
    /// The point that the ball meets, m.
    pub point: Point3<f64>,
    /// A triangle that the point belongs to.
    pub triangle: u32,
}

/// Points of a surface ready for rolling balls. Built once, it serves every tool and every tangent point; the build
/// is parallel and its result does not depend on the number of threads.
#[derive(Clone, Debug)]
pub struct BallTree {
    /// Depth first; the first is the root.
    nodes: Vec<WideNode>,
    /// In leaf order.
    points: Vec<[f64; 3]>,
    /// In leaf order.
    normals: Vec<Vector3<f64>>,
    /// In leaf order.
    triangles: Vec<u32>,
    /// Largest coordinate, m.
    largest: f64,
}

/// What is known of the points of one node of the binary tree.
#[derive(Clone, Copy, Debug)]
struct PointBounds {
    centre: Vector3<f64>,
    half: Vector3<f64>,
    /// Mean normal, or zero where the normals cancel.
    normal: Vector3<f64>,
    /// No point of the node has `normal`·(p − `centre`) above this.
    top: f64,
    /// Sine of the largest angle of a normal with the mean; 2 where it is not known to be below 90°.
    spread: f64,
}

/// A lane for each child.
type Lanes = [f64; WIDTH];

/// A node with the bounds of its children, coordinate by coordinate.
#[derive(Clone, Copy, Debug, Default)]
struct WideNode {
    centre: [Lanes; 3],
    half: [Lanes; 3],
    /// Half the diagonals of the boxes.
    radius: Lanes,
    normal: [Lanes; 3],
    top: Lanes,
    spread: Lanes,
    children: [Child; WIDTH],
    /// Children that there are.
    used: usize,
}

/// A leaf's points, or a node where `count` is 0.
#[derive(Clone, Copy, Debug, Default)]
struct Child {
    first: u32,
    count: u32,
}

impl BallTree {
    /// The tree over `surface`, whose points are finite and have a normal and a triangle each.
    pub fn build(surface: &SurfacePoints) -> Self {
        let centres: Vec<[f64; 3]> = surface.points.iter().map(|p| p.coords.into()).collect();
        let (order, splits) = split_tree_to(LEAF, &centres);
        let points: Vec<[f64; 3]> = order.iter().map(|&i| centres[i as usize]).collect();
        let normals: Vec<Vector3<f64>> = order.iter().map(|&i| surface.normals[i as usize]).collect();
        let triangles = order.iter().map(|&i| surface.triangles[i as usize]).collect();
        let blank = PointBounds {
            centre: Vector3::zeros(),
            half: Vector3::zeros(),
            normal: Vector3::zeros(),
            top: 0.0,
            spread: 2.0,
        };
        let mut bounds = vec![blank; splits.len()];
        let mut nodes = Vec::with_capacity(splits.len() / 2 + 1);
        if !splits.is_empty() {
            fit(&points, &normals, &splits, 0, &mut bounds);
            widen(&splits, &bounds, 0, &mut nodes);
        }
        let largest = points.iter().flatten().fold(0.0, |most: f64, c| most.max(c.abs()));
        Self { nodes, points, normals, triangles, largest }
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Whether there are no points.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    /// The point with the largest κ above `floor` (1/m, −∞ to find any) for a ball tangent at `p` with the unit
    /// normal `n`; `None` when no point is above it.
    ///
    /// Points below the tangent plane whose normal points away from the ball are the far side of a solid part and do
    /// not count. Agrees with [`Self::stop_among_all`] to rounding.
    pub fn stop(&self, p: &Point3<f64>, n: &Vector3<f64>, reach: &Reach, floor: f64) -> Option<BallContact> {
        if self.is_empty() {
            return None;
        }
        let largest = self.largest.max(p.coords.amax());
        let mut ball = Ball::new(p, n, reach, floor, ROUNDING * largest);
        let mut open = [(f64::INFINITY, Child::default()); OPEN];
        let mut depth = 1;
        while depth > 0 {
            depth -= 1;
            let (bound, child) = open[depth];
            if bound <= ball.curvature {
                continue;
            }
            let first = child.first as usize;
            if child.count > 0 {
                self.visit(first..first + child.count as usize, &mut ball);
                continue;
            }
            let node = &self.nodes[first];
            let bounds = ball.bounds(node);
            // The best on top.
            let bottom = depth;
            for (&bound, &child) in bounds.iter().zip(&node.children).take(node.used) {
                if bound > ball.curvature {
                    let mut at = depth;
                    while at > bottom && open[at - 1].0 > bound {
                        open[at] = open[at - 1];
                        at -= 1;
                    }
                    open[at] = (bound, child);
                    depth += 1;
                }
            }
        }
        ball.contact()
    }

    /// The same as [`Self::stop`] by trying every point: slow, for checking.
    pub fn stop_among_all(
        &self,
        p: &Point3<f64>,
        n: &Vector3<f64>,
        reach: &Reach,
        floor: f64,
    ) -> Option<BallContact> {
        let mut ball = Ball::new(p, n, reach, floor, 0.0);
        self.visit(0..self.len(), &mut ball);
        ball.contact()
    }

    #[inline]
    fn visit(&self, range: std::ops::Range<usize>, ball: &mut Ball) {
        for i in range {
            ball.offer(&self.points[i], &self.normals[i], self.triangles[i]);
        }
    }
}

/// Steps of the grid on a facet that the refinement starts from.
const GRID: usize = 4;
/// The refinement ends when its steps are below this share of a facet.
const FINEST: f64 = 1.0 / 512.0;
/// Most facets that are refined about a contact.
const FACETS: usize = 32;

/// The smooth surface over a mesh, to follow a contact into the facets about it.
#[derive(Clone, Debug)]
pub struct SmoothSurface<'a> {
    mesh: &'a TriangleMesh,
    topology: MeshTopology,
}

impl<'a> SmoothSurface<'a> {
    /// The surface of a mesh whose indices are valid.
    pub fn of(mesh: &'a TriangleMesh) -> Self {
        Self { mesh, topology: MeshTopology::of(mesh) }
    }

    /// Shrinks a ball of [`BallTree::stop`] further, to the largest κ that a climb over the facets about its contact
    /// finds between the points; never to one that is less concave. The arguments are those of the search.
    ///
    /// Between points δ apart κ is missed by about κ(δ/2D)² at the distance D, at the rim of the shadow by κδ/D: after
    /// the climb δ is a fraction of a facet.
    pub fn refine(
        &self,
        p: &Point3<f64>,
        n: &Vector3<f64>,
        reach: &Reach,
        found: BallContact,
    ) -> BallContact {
        let mut ball = Ball::new(p, n, reach, found.curvature, 0.0);
        let mut best = None;
        let mut offer = |t: u32, w: [f64; 3]| {
            let (q, normal) = self.mesh.smooth_point(t as usize, w);
            if ball.offer(&q.coords.into(), &normal, t) {
                best = Some((t, w));
            }
            best
        };
        let (mut near, mut count) = ([0u32; FACETS], 0);
        for &v in &self.mesh.triangles[found.triangle as usize] {
            for &t in self.topology.triangles_at(v as usize) {
                if count < FACETS && !near[..count].contains(&t) {
                    near[count] = t;
                    count += 1;
                }
            }
        }
        for &t in &near[..count] {
            for i in 0..=GRID {
                for j in 0..=GRID - i {
                    offer(t, [GRID - i - j, i, j].map(|w| w as f64 / GRID as f64));
                }
            }
        }
        let start = (found.triangle, [1.0 / 3.0; 3]);
        let (mut at, mut step) = (offer(start.0, start.1).unwrap_or(start), 0.5 / GRID as f64);
        while step > FINEST {
            let (t, w) = at;
            for (up, down) in [(0, 1), (1, 0), (1, 2), (2, 1), (2, 0), (0, 2)] {
                let mut moved = w;
                moved[up] += step;
                moved[down] -= step;
                if moved[down] >= 0.0 {
                    at = offer(t, moved).unwrap_or(at);
                }
            }
            if at == (t, w) {
                step *= 0.5;
            }
        }
        ball.contact().unwrap_or(found)
    }
}

/// A ball that shrinks while points are offered to it.
struct Ball {
    p: Vector3<f64>,
    n: Vector3<f64>,
    near: f64,
    near_square: f64,
    shadow: f64,
    shadow_square: f64,
    slack: f64,
    curvature: f64,
    /// 1/2κ.
    half_radius: f64,
    stop: Option<([f64; 3], u32)>,
}

impl Ball {
    fn new(p: &Point3<f64>, n: &Vector3<f64>, reach: &Reach, floor: f64, slack: f64) -> Self {
        Self {
            p: p.coords,
            n: *n,
            near: reach.near,
            // The tangent point itself has no κ.
            near_square: (reach.near * reach.near).max(f64::MIN_POSITIVE),
            shadow: reach.shadow,
            shadow_square: reach.shadow * reach.shadow,
            slack,
            curvature: floor.max(LEAST),
            half_radius: 0.5 / floor,
            stop: None,
        }
    }

    fn contact(self) -> Option<BallContact> {
        let curvature = self.curvature;
        self.stop.map(|(q, triangle)| BallContact { curvature, point: Point3::from(q), triangle })
    }

    /// Shrinks the ball to the point `q` of `triangle` if that is inside of it and counts; whether it did.
    #[inline]
    fn offer(&mut self, q: &[f64; 3], normal: &Vector3<f64>, triangle: u32) -> bool {
        let d = Vector3::new(q[0] - self.p.x, q[1] - self.p.y, q[2] - self.p.z);
        let (height, square) = (d.dot(&self.n), d.norm_squared());
        let curvature = 2.0 * height / square;
        // A distance of zero gives NaN, which is not above anything.
        let stops = curvature > self.curvature
            && square >= self.near_square
            && square - height * height <= self.shadow_square
            && (height >= 0.0 || normal.dot(&self.n) > 0.0);
        if stops {
            self.curvature = curvature;
            self.half_radius = 0.5 / curvature;
            self.stop = Some((*q, triangle));
        }
        stops
    }

    /// No point of a child has a κ above this; −∞ where none is within reach or better than the present ball.
    #[inline]
    fn bounds(&self, node: &WideNode) -> Lanes {
        if self.curvature > 0.0 {
            let (kappa, half_radius) = (self.curvature, self.half_radius);
            self.bounds_by(node, |a, low, high| {
                let x = least(largest(a * half_radius, low), high);
                x * (a - kappa * x)
            })
        } else {
            let kappa = self.curvature;
            self.bounds_by(node, |a, low, high| largest(low * (a - kappa * low), high * (a - kappa * high)))
        }
    }

    /// `parabola`(a, low, high) is the maximum of ax − κx² between `low` and `high`.
    #[inline(always)]
    fn bounds_by(&self, node: &WideNode, parabola: impl Fn(f64, f64, f64) -> f64) -> Lanes {
        let (p, n) = (&self.p, &self.n);
        let mut bounds = [0.0; WIDTH];
        for (i, bound) in bounds.iter_mut().enumerate() {
            let c = [node.centre[0][i] - p.x, node.centre[1][i] - p.y, node.centre[2][i] - p.z];
            let m = [node.normal[0][i], node.normal[1][i], node.normal[2][i]];
            let half = [node.half[0][i], node.half[1][i], node.half[2][i]];
            let square = c[0] * c[0] + c[1] * c[1] + c[2] * c[2];
            let height = c[0] * n.x + c[1] * n.y + c[2] * n.z;
            let over = c[0] * m[0] + c[1] * m[1] + c[2] * m[2];
            let facing = n.x * m[0] + n.y * m[1] + n.z * m[2];
            // λ that makes f's gradient at the centre run along the plane.
            let lambda = largest(2.0 * (facing - self.curvature * over), 0.0);
            // Widened for the rounding, that of κ|d|² included, which is large against f where κ is far from the rest.
            let radius = node.radius[i] * (1.0 + ROUNDING) + self.slack;
            let rounding = (1.0 + lambda) * self.slack
                + 4.0 * ROUNDING * self.curvature.abs() * (square + radius * radius);
            let mut f = lambda * (over + node.top[i]) + rounding;
            let (mut gap_square, mut above) = (0.0, height);
            for k in 0..3 {
                f += parabola(2.0 * n[k] - lambda * m[k], c[k] - half[k], c[k] + half[k]);
                let gap = largest(c[k].abs() - half[k], 0.0);
                gap_square += gap * gap;
                above += n[k].abs() * half[k];
            }
            let (inner, outer) = (largest(self.near - radius, 0.0), self.shadow + radius);
            let out = (square < inner * inner)
                | (square - height * height > outer * outer)
                | ((facing <= -node.spread[i]) & (above < 0.0))
                | (f <= 0.0);
            // f(d) ≤ `f` is κ(Q) ≤ κ + `f`/|d|².
            let most = self.curvature + f / largest(gap_square, self.near_square);
            *bound = if out { f64::NEG_INFINITY } else { most };
        }
        bounds
    }
}

/// One instruction, which `f64::max` is not.
#[inline(always)]
fn largest(a: f64, b: f64) -> f64 {
    if a > b { a } else { b }
}

#[inline(always)]
fn least(a: f64, b: f64) -> f64 {
    if a < b { a } else { b }
}

/// The wide node over the binary one at `at` and what is below it, depth first; gives its place.
fn widen(splits: &[Split], bounds: &[PointBounds], at: usize, nodes: &mut Vec<WideNode>) -> u32 {
    let place = nodes.len();
    nodes.push(WideNode::default());
    let mut node = WideNode::default();
    let halves = [at, at + 1, splits[at].right as usize];
    let halves = if splits[at].right == 0 { &halves[..1] } else { &halves[1..] };
    for &half in halves {
        let quarters = [half + 1, splits[half].right as usize];
        let leaf = [half];
        for &child in if splits[half].right == 0 { &leaf[..] } else { &quarters[..] } {
            let (b, lane) = (&bounds[child], node.used);
            for k in 0..3 {
                node.centre[k][lane] = b.centre[k];
                node.half[k][lane] = b.half[k];
                node.normal[k][lane] = b.normal[k];
            }
            node.radius[lane] = b.half.norm();
            node.top[lane] = b.top;
            node.spread[lane] = b.spread;
            let split = splits[child];
            node.children[lane] = if split.right == 0 {
                Child { first: split.first, count: split.count }
            } else {
                Child { first: widen(splits, bounds, child, nodes), count: 0 }
            };
            node.used += 1;
        }
    }
    nodes[place] = node;
    place as u32
}

/// Bounds of the subtree whose nodes start at `base`; `out[0]` is that node. Gives box and summed normal.
fn fit(
    points: &[[f64; 3]],
    normals: &[Vector3<f64>],
    splits: &[Split],
    base: usize,
    out: &mut [PointBounds],
) -> (Aabb, Vector3<f64>) {
    let split = splits[base];
    let (aabb, sum) = if split.right == 0 {
        let mut aabb = Aabb::EMPTY;
        points[split.range()].iter().for_each(|&p| aabb.add(&Point3::from(p)));
        (aabb, normals[split.range()].iter().sum())
    } else {
        let right = split.right as usize;
        let (left_out, right_out) = out[1..].split_at_mut(right - base - 1);
        let mut left = || fit(points, normals, splits, base + 1, left_out);
        let mut right = || fit(points, normals, splits, right, right_out);
        let (l, r) = if split.count > PARALLEL { rayon::join(left, right) } else { (left(), right()) };
        (l.0.union(&r.0), l.1 + r.1)
    };
    let (min, max) = (Vector3::from(aabb.min), Vector3::from(aabb.max));
    let centre = (min + max) * 0.5;
    let normal = sum.try_normalize(1e-12).unwrap_or_else(Vector3::zeros);
    let (top, spread) = if split.count > PLANE_FIT {
        (aabb.support(&normal) - normal.dot(&centre), 2.0)
    } else {
        let above = |p: &[f64; 3]| normal.dot(&(Vector3::from(*p) - centre));
        let top = points[split.range()].iter().map(above).fold(f64::NEG_INFINITY, f64::max);
        let least = normals[split.range()].iter().map(|n| n.dot(&normal)).fold(1.0, f64::min);
        // Slack against rounding.
        (top, if least > 1e-3 { (1.0 - least * least).max(0.0).sqrt() + 1e-7 } else { 2.0 })
    };
    // The half extent seen from the rounded centre.
    let half = (max - centre).sup(&(centre - min));
    out[0] = PointBounds { centre, half, normal, top, spread };
    (aabb, sum)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_meshes::{Random, bumpy, height_field, random_soup};
    use proptest::prelude::*;

    /// Area-weighted vertex normals.
    fn with_normals(mut mesh: TriangleMesh) -> TriangleMesh {
        mesh.normals.fill(Vector3::zeros());
        for t in 0..mesh.triangles.len() {
            let [a, b, c] = mesh.corners(t);
            let n = (b - a).cross(&(c - a));
            mesh.triangles[t].iter().for_each(|&v| mesh.normals[v as usize] += n);
        }
        mesh.normals.iter_mut().for_each(|n| *n = n.try_normalize(0.0).unwrap_or_else(Vector3::z));
        mesh
    }

    fn tree_of(mesh: &TriangleMesh, spacing: f64) -> (BallTree, SurfacePoints) {
        let points = SurfacePoints::of(mesh, spacing);
        (BallTree::build(&points), points)
    }

    fn assert_agree(tree: &BallTree, p: &Point3<f64>, n: &Vector3<f64>, reach: &Reach, floor: f64) {
        let found = tree.stop(p, n, reach, floor);
        let expected = tree.stop_among_all(p, n, reach, floor);
        match (found, expected) {
            (Some(a), Some(b)) => {
                let deviation = (a.curvature - b.curvature).abs();
                assert!(deviation <= 1e-12 * b.curvature.abs(), "{a:?} {b:?}");
            }
            (a, b) => assert_eq!(a, b, "{p} {n} {reach:?} {floor}"),
        }
    }

    #[test]
    fn the_search_finds_what_all_points_give() {
        let mut random = Random::new(5);
        for (mesh, spacing) in [
            (with_normals(bumpy(40, 0.05, 0.004)), 0.01),
            (with_normals(bumpy(12, 0.05, 0.01)), 0.002),
            (with_normals(random_soup(400, 3)), 0.004),
            (with_normals(height_field(30, 0.03, |x, y| 8.0 * (x * x + y * y))), 0.01),
            (with_normals(height_field(30, 0.03, |x, y| -8.0 * (x * x + y * y))), 0.01),
        ] {
            let (tree, points) = tree_of(&mesh, spacing);
            for shadow in [0.01, 0.032, f64::INFINITY] {
                for near in [0.0, 1e-4, 0.003] {
                    for _ in 0..60 {
                        let i = random.in_range(0.0, points.points.len() as f64) as usize;
                        let (p, n) = (points.points[i], points.normals[i]);
                        let reach = Reach { near, shadow };
                        for floor in [f64::NEG_INFINITY, -20.0, 0.0, 15.0] {
                            assert_agree(&tree, &p, &n, &reach, floor);
                        }
                        // Not on the surface, not along its normal.
                        let (q, m) = (p + random.unit_vector() * 1e-3, random.unit_vector());
                        assert_agree(&tree, &q, &m, &reach, f64::NEG_INFINITY);
                    }
                }
            }
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 2000, failure_persistence: None, ..ProptestConfig::default() })]
        #[test]
        fn nothing_is_missed_in_any_cloud(
            seed in 0u64..10_000,
            count in 1usize..300,
            flat in 0.0f64..1.0,
            shadow in prop_oneof![Just(f64::INFINITY), 0.001f64..0.1],
            near in prop_oneof![Just(0.0), 1e-6f64..0.03],
            floor in prop_oneof![Just(f64::NEG_INFINITY), Just(-1e9), -100.0f64..100.0],
        ) {
            let mut random = Random::new(seed);
            let mut cloud = SurfacePoints::default();
            for _ in 0..count {
                let p = Vector3::from_fn(|k, _| random.in_range(-0.05, 0.05) * if k == 2 { flat } else { 1.0 });
                cloud.points.push(Point3::from(p));
                cloud.triangles.push(0);
                cloud.normals.push((Vector3::z() + random.unit_vector() * (1.5 * flat)).normalize());
            }
            let tree = BallTree::build(&cloud);
            for i in 0..count.min(20) {
                assert_agree(&tree, &cloud.points[i], &cloud.normals[i], &Reach { near, shadow }, floor);
            }
        }
    }

    #[test]
    fn bowls_and_domes_give_their_radius_from_any_point() {
        for radius in [0.05f64, -0.05] {
            let sag =
                move |x: f64, y: f64| radius - radius.signum() * (radius * radius - x * x - y * y).sqrt();
            let mesh = height_field(40, 0.03, sag);
            let centre = Point3::new(0.0, 0.0, radius);
            let normals = mesh.vertices.iter().map(|p| (centre - p) / radius).collect();
            let triangles = vec![0; mesh.vertices.len()];
            let points = SurfacePoints { points: mesh.vertices, normals, triangles };
            let tree = BallTree::build(&points);
            for i in (0..points.points.len()).step_by(37) {
                let reach = Reach { near: 1e-4, shadow: f64::INFINITY };
                let found = tree.stop(&points.points[i], &points.normals[i], &reach, -1e9).unwrap();
                assert!((found.curvature * radius - 1.0).abs() < 1e-9, "{found:?}");
            }
        }
    }

    #[test]
    fn far_sides_and_empty_sets_stop_nothing() {
        let reach = Reach { near: 0.0, shadow: f64::INFINITY };
        let empty = BallTree::build(&SurfacePoints::default());
        assert!(empty.is_empty() && empty.stop(&Point3::origin(), &Vector3::z(), &reach, -1e9).is_none());
        // A plate of 3 mm: its back does not count, a ceiling does.
        let mut back = SurfacePoints::of(&height_field(50, 0.03, |_, _| -0.003), 0.01);
        back.normals.fill(-Vector3::z());
        let tree = BallTree::build(&back);
        assert_eq!(tree.stop(&Point3::origin(), &Vector3::z(), &reach, f64::NEG_INFINITY), None);
        let ceiling = tree.stop(&Point3::new(0.0, 0.0, -0.013), &Vector3::z(), &reach, 0.0).unwrap();
        assert!((ceiling.curvature * 0.005 - 1.0).abs() < 1e-12);
    }

    #[test]
    fn build_does_not_depend_on_threads() {
        let points = SurfacePoints::of(&with_normals(bumpy(120, 0.05, 0.003)), 0.01);
        let build = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| BallTree::build(&points))
        };
        assert_eq!(build(1).points, build(3).points);
    }
}
