//! Delaunay triangles over the projection of a height field, without those that span gaps.

use nalgebra::{Point2, Point3, Vector3};
use patchmill_geometry::curvature::tangents;
use rayon::prelude::*;
use spade::{DelaunayTriangulation, Triangulation};

use crate::cloud::local_fit::LocalFit;
use crate::site::Site;

/// Triangles whose circumcircle, in projection, is wider than this many spacings span a gap.
const CIRCLE_SPACINGS: f64 = 6.0;
/// Others whose longest edge is longer than this many spacings …
const EDGE_SPACINGS: f64 = 12.0;
/// … or whose normal and those of its corners have less than this cosine (60°) join different sheets of the surface.
const AGREEING_COSINE: f64 = 0.5;
/// Directions in which a gap's extent is taken: within 0.5 % of its diameter.
const EXTENT_DIRECTIONS: usize = 16;

/// The frame of the projection: two tangents and the direction looked against.
pub struct Projection([Vector3<f64>; 3]);

impl Projection {
    /// Along the unit vector `direction`.
    pub fn along(direction: &Vector3<f64>) -> Self {
        let (t1, t2) = tangents(direction);
        Self([t1, t2, *direction])
    }

    /// The unit vector looked against.
    pub fn direction(&self) -> &Vector3<f64> {
        &self.0[2]
    }

    fn flat(&self, p: &Point3<f64>) -> Point2<f64> {
        Point2::new(p.coords.dot(&self.0[0]), p.coords.dot(&self.0[1]))
    }
}

/// A gap that triangles do not span, all around within the surface.
pub struct Hole {
    /// Its largest extent in space, m.
    pub extent: f64,
    /// The triangles left out.
    pub triangles: Vec<[u32; 3]>,
}

/// A triangulation of points.
pub struct Facets {
    /// The triangles that span no gap and join no sheets, counter-clockwise as seen against the direction.
    pub triangles: Vec<[u32; 3]>,
    /// The gaps within the surface.
    pub holes: Vec<Hole>,
    /// Vertices all of whose triangles that span no gap join different sheets.
    pub torn: Vec<u32>,
}

#[derive(Clone, Copy, PartialEq)]
enum Face {
    Sound,
    SpansGap,
    JoinsSheets,
}

/// Triangulates `vertices`, turned to the direction, whose typical distance is `spacing` (m). Those at the same place of the projection are used once.
///
/// # Errors
/// If a coordinate cannot be handled.
pub fn triangulate(vertices: &[LocalFit], projection: &Projection, spacing: f64) -> Result<Facets, String> {
    let sites = vertices
        .iter()
        .enumerate()
        .map(|(i, vertex)| {
            let flat = projection.flat(&vertex.position);
            // Numbers too small for the exact predicates are zero.
            let clean = |x: f64| if x.abs() < 1e-30 { 0.0 } else { x };
            Site { position: spade::Point2::new(clean(flat.x), clean(flat.y)), number: i as u32 }
        })
        .collect();
    let delaunay = DelaunayTriangulation::<Site>::bulk_load_stable(sites)
        .map_err(|e| format!("the points cannot be triangulated: {e}"))?;
    let handles: Vec<_> = delaunay.inner_faces().map(|face| face.fix()).collect();
    let faces: Vec<[u32; 3]> =
        handles.iter().map(|face| delaunay.face(*face).vertices().map(|v| v.data().number)).collect();
    let kinds: Vec<Face> = faces.par_iter().map(|face| kind(vertices, projection, face, spacing)).collect();
    // Faces are numbered in order; number 0 is the outside.
    let across = |face: usize| {
        let edges = delaunay.face(handles[face]).adjacent_edges();
        edges.map(|edge| edge.rev().face().as_inner().map(|f| f.fix().index() - 1))
    };
    let holes = holes(&faces, &kinds, across, vertices);
    let of_kind = |wanted: Face| {
        faces.iter().zip(&kinds).filter(move |(_, kind)| **kind == wanted).map(|(face, _)| *face)
    };
    let mut sound = vec![false; vertices.len()];
    of_kind(Face::Sound).flatten().for_each(|v| sound[v as usize] = true);
    let mut torn: Vec<u32> = of_kind(Face::JoinsSheets).flatten().filter(|v| !sound[*v as usize]).collect();
    torn.sort_unstable();
    torn.dedup();
    Ok(Facets { triangles: of_kind(Face::Sound).collect(), holes, torn })
}

fn kind(vertices: &[LocalFit], projection: &Projection, face: &[u32; 3], spacing: f64) -> Face {
    let corners = face.map(|v| &vertices[v as usize]);
    let [a, b, c] = corners.map(|v| projection.flat(&v.position));
    let edges = [(b - a).norm(), (c - b).norm(), (a - c).norm()];
    let double_area = (b - a).perp(&(c - a)).abs();
    // The circle's diameter is the product of the edges over twice the area.
    if edges.iter().product::<f64>() > CIRCLE_SPACINGS * spacing * double_area {
        return Face::SpansGap;
    }
    let [a, b, c] = corners.map(|v| v.position);
    let longest = (b - a).norm().max((c - b).norm()).max((a - c).norm());
    let cross = (b - a).cross(&(c - a));
    let mean: Vector3<f64> = corners.iter().map(|v| v.normal).sum();
    if longest > EDGE_SPACINGS * spacing || cross.dot(&mean) < AGREEING_COSINE * cross.norm() * mean.norm() {
        return Face::JoinsSheets;
    }
    Face::Sound
}

/// The connected groups of the faces that are not sound, except those that reach the outside.
fn holes(
    faces: &[[u32; 3]],
    kinds: &[Face],
    across: impl Fn(usize) -> [Option<usize>; 3],
    vertices: &[LocalFit],
) -> Vec<Hole> {
    let mut seen = vec![false; faces.len()];
    let mut holes = Vec::new();
    for start in 0..faces.len() {
        if kinds[start] == Face::Sound || seen[start] {
            continue;
        }
        seen[start] = true;
        let (mut group, mut next, mut inside) = (vec![start], 0, true);
        while next < group.len() {
            for other in across(group[next]) {
                match other {
                    None => inside = false,
                    Some(other) if kinds[other] != Face::Sound && !seen[other] => {
                        seen[other] = true;
                        group.push(other);
                    }
                    Some(_) => {}
                }
            }
            next += 1;
        }
        if inside {
            let triangles: Vec<[u32; 3]> = group.into_iter().map(|f| faces[f]).collect();
            holes.push(Hole { extent: extent(&triangles, vertices), triangles });
        }
    }
    holes
}

/// The largest extent of the corners of `triangles`, m.
fn extent(triangles: &[[u32; 3]], vertices: &[LocalFit]) -> f64 {
    let corners = || triangles.iter().flatten().map(|v| vertices[*v as usize].position);
    let along = |direction: Vector3<f64>| {
        let (low, high) = corners().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), p| {
            let x = p.coords.dot(&direction);
            (low.min(x), high.max(x))
        });
        high - low
    };
    (0..EXTENT_DIRECTIONS)
        .map(|k| {
            let (sin, cos) = (k as f64 * std::f64::consts::PI / EXTENT_DIRECTIONS as f64).sin_cos();
            along(Vector3::new(cos, sin, 0.0)).hypot(along(Vector3::z()))
        })
        .fold(0.0, f64::max)
}

/// Points at `spacing` (m) on the triangles of a hole, off their corners.
pub fn fill(hole: &Hole, vertices: &[LocalFit], projection: &Projection, spacing: f64) -> Vec<Point3<f64>> {
    let mut filled = Vec::new();
    for face in &hole.triangles {
        let corners = face.map(|v| vertices[v as usize].position);
        let [a, b, c] = corners.each_ref().map(|p| projection.flat(p));
        let area = (b - a).perp(&(c - a));
        let low = a.coords.inf(&b.coords).inf(&c.coords) / spacing;
        let high = a.coords.sup(&b.coords).sup(&c.coords) / spacing;
        for i in low.x.ceil() as i64..=high.x.floor() as i64 {
            for j in low.y.ceil() as i64..=high.y.floor() as i64 {
                let p = Point2::new(i as f64 * spacing, j as f64 * spacing);
                let weights = [(c - b).perp(&(p - b)), (a - c).perp(&(p - c)), (b - a).perp(&(p - a))]
                    .map(|w| w / area);
                // One side of a shared edge only is closed, or nearly so: a point on it may be filled twice, which does no harm.
                let inside = weights.iter().all(|w| *w >= 0.0);
                let clear = [a, b, c].iter().all(|q| (p - q).norm() > 0.5 * spacing);
                if inside && clear {
                    let sum = corners[0].coords * weights[0]
                        + corners[1].coords * weights[1]
                        + corners[2].coords * weights[2];
                    filled.push(Point3::from(sum));
                }
            }
        }
    }
    filled
}
