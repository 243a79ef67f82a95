//! A trimmed face as triangles: its loops as polygons in (u, v), a grid of points between them, a constrained Delaunay triangulation.

use std::collections::HashSet;

use nalgebra::Point3;
use spade::{ConstrainedDelaunayTriangulation, Triangulation};

use crate::site::Site;
use crate::step::model::Face;
use crate::step::shapes::Shape;

/// Largest distance of an edge's points from the surface, m.
const OFF_MAX: f64 = 10e-6;
/// A cell is at most so many times as long as wide.
const ASPECT_MAX: f64 = 10.0;
/// Places a side at which a B-spline's bend is looked at.
const BEND_PLACES: usize = 48;
/// Places of a cell that points are rounded to.
const SNAP: f64 = (1u64 << 26) as f64;
/// Points of the grid keep this distance from the loops, cells.
const CLEARANCE: f64 = 0.5;

/// A corner of a loop.
#[derive(Clone, Copy)]
pub struct Corner {
    /// Number of the point among all edges' points.
    pub vertex: u32,
    /// Its parameters on the face.
    pub uv: [f64; 2],
}

/// Loops in parameters, and the size of the cells that the tolerance asks for.
pub struct Outline {
    /// The loops, closed: the last corner is followed by the first.
    pub loops: Vec<Vec<Corner>>,
    /// Sides of a cell in u and v; infinite on a plane.
    pub cell: [f64; 2],
    /// The longer side of a cell, m.
    pub reach: f64,
    /// Largest distance of a corner from the surface, m.
    pub off: f64,
}

/// A triangle's corners: edges' points as numbered, points of the grid after those by their place in `inner`.
pub struct FaceMesh {
    /// Triangles, counter-clockwise in (u, v).
    pub triangles: Vec<[u32; 3]>,
    /// Parameters of the corners of each triangle.
    pub uvs: Vec<[[f64; 2]; 3]>,
    /// Points of the grid, by their parameters.
    pub inner: Vec<[f64; 2]>,
}

/// The loops of `face`, given the numbers and places of their points without the repeated last one.
///
/// # Errors
/// When an edge leaves the surface, or a loop does not close on it.
pub fn outline(face: &Face, loops: &[Vec<(u32, Point3<f64>)>], chord: f64) -> Result<Outline, String> {
    let mut found = Outline { loops: Vec::new(), cell: [f64::INFINITY; 2], reach: f64::INFINITY, off: 0.0 };
    for points in loops {
        let (corners, off) = unrolled(face, points)?;
        found.off = found.off.max(off);
        found.loops.push(corners);
    }
    if found.loops.is_empty() {
        return Err(format!("#{} ADVANCED_FACE: it has no bound; one was expected", face.number));
    }
    (found.cell, found.reach) = cell(&face.shape, &found.loops, chord);
    Ok(found)
}

/// A loop's corners in parameters that do not jump.
fn unrolled(face: &Face, points: &[(u32, Point3<f64>)]) -> Result<(Vec<Corner>, f64), String> {
    let (shape, fail) = (&face.shape, |text: String| Err(format!("#{} ADVANCED_FACE: {text}", face.number)));
    let singular = points.iter().position(|(_, p)| shape.parameters(p, None).pole);
    // From the pole on, so that what is before and after it meets at the loop's ends.
    let start = singular.unwrap_or(0);
    let count = points.len();
    let (mut corners, mut near, mut worst) = (Vec::with_capacity(count + 2), None, 0.0f64);
    // The pole itself is left at the u of the point after it, and reached at that of the point before it.
    let order = (usize::from(singular.is_some())..count).map(|k| points[(start + k) % count]);
    for (vertex, p) in order {
        let found = shape.parameters(&p, near);
        if found.pole && singular.is_some() {
            return fail("a loop goes through a pole twice, which is not read".to_owned());
        }
        let off = (shape.at(found.uv).position - p).norm();
        if off.is_nan() || off > OFF_MAX {
            return fail(format!(
                "its edge leaves its surface by {:.4} mm at x = {:.4} mm, y = {:.4} mm, z = {:.4} mm",
                off * 1e3,
                p.x * 1e3,
                p.y * 1e3,
                p.z * 1e3
            ));
        }
        worst = worst.max(off);
        near = Some(found.uv);
        corners.push(Corner { vertex, uv: found.uv });
    }
    let (Some(first), Some(last)) = (corners.first().copied(), corners.last().copied()) else {
        return fail("a loop without a point".to_owned());
    };
    match singular {
        Some(pole) => {
            let (vertex, p) = points[pole];
            let [arriving, leaving] = [last, first].map(|corner| shape.parameters(&p, Some(corner.uv)).uv);
            corners.push(Corner { vertex, uv: [last.uv[0], arriving[1]] });
            corners.push(Corner { vertex, uv: [first.uv[0], leaving[1]] });
            if (arriving[1] - leaving[1]).abs() > 1e-6 {
                return fail("a loop goes around without closing, which is not read".to_owned());
            }
        }
        None => {
            let again = shape.parameters(&points[start].1, Some(last.uv)).uv;
            let [[low_u, high_u], [low_v, high_v]] = bounds(std::slice::from_ref(&corners));
            let gap =
                [(again[0] - first.uv[0]) / (high_u - low_u), (again[1] - first.uv[1]) / (high_v - low_v)];
            if gap.iter().any(|x| x.is_nan() || x.abs() > 1e-3) {
                return fail(
                    "a loop goes around its closed surface, which has no seam edge: this is not read"
                        .to_owned(),
                );
            }
        }
    }
    Ok((corners, worst))
}

/// Ranges of u and v.
fn bounds(loops: &[Vec<Corner>]) -> [[f64; 2]; 2] {
    let mut range = [[f64::INFINITY, f64::NEG_INFINITY]; 2];
    for corner in loops.iter().flatten() {
        for (range, x) in range.iter_mut().zip(corner.uv) {
            *range = [range[0].min(x), range[1].max(x)];
        }
    }
    range
}

/// Sides of a cell such that each direction takes half of `chord` (m), du²·|Suu·n|/8 = chord/2, and the longer one in m.
fn cell(shape: &Shape, loops: &[Vec<Corner>], chord: f64) -> ([f64; 2], f64) {
    if matches!(shape, Shape::Plane(_)) {
        return ([f64::INFINITY; 2], f64::INFINITY);
    }
    let range = bounds(loops);
    let at = |k: usize, i: usize| range[k][0] + (range[k][1] - range[k][0]) * i as f64 / BEND_PLACES as f64;
    let (mut bend, mut length) = ([0.0f64; 2], [0.0f64; 2]);
    for i in 0..=BEND_PLACES {
        for j in 0..=BEND_PLACES {
            let p = shape.at([at(0, i), at(1, j)]);
            let Some(n) = p.normal(0.0) else { continue };
            let ([a, m, b], aspect) = (p.second_form(&n).map(f64::abs), p.u.norm() / p.v.norm());
            bend = [bend[0].max(a.max(m * aspect)), bend[1].max(b.max(m / aspect))];
            length = [length[0].max(p.u.norm()), length[1].max(p.v.norm())];
        }
    }
    let mut cell = [0, 1].map(|k| {
        let most = (range[k][1] - range[k][0]) / 4.0;
        (4.0 * chord / bend[k]).sqrt().min(most).min(if matches!(shape, Shape::Revolved(..)) && k == 0 {
            0.3
        } else {
            most
        })
    });
    for k in 0..2 {
        cell[k] = cell[k].min(ASPECT_MAX * cell[1 - k] * length[1 - k] / length[k]);
    }
    (cell, f64::max(cell[0] * length[0], cell[1] * length[1]))
}

/// Triangles of an outline; points of the grid are numbered from `first_inner` on.
///
/// # Errors
/// When loops cross, or more than `most` triangles would be needed.
pub fn triangulate(
    face: &Face,
    outline: &Outline,
    first_inner: u32,
    most: usize,
) -> Result<FaceMesh, String> {
    let fail = |text: &str| format!("#{} ADVANCED_FACE: {text}", face.number);
    let range = bounds(&outline.loops);
    // Cells of about one by one; a plane's by its extent.
    let scale = [0, 1].map(|k| {
        if outline.cell[k].is_finite() {
            outline.cell[k]
        } else {
            (range[0][1] - range[0][0]).max(range[1][1] - range[1][0])
        }
    });
    // Rounded, so that points along a line of constant u or v are on one to the last bit, without slivers between them.
    let flat = |uv: [f64; 2]| [0, 1].map(|k| ((uv[k] - range[k][0]) / scale[k] * SNAP).round() / SNAP);
    let rings: Vec<Vec<[f64; 2]>> =
        outline.loops.iter().map(|ring| ring.iter().map(|c| flat(c.uv)).collect()).collect();
    let mut mesh = FaceMesh { triangles: Vec::new(), uvs: Vec::new(), inner: Vec::new() };
    if outline.cell[0].is_finite() {
        let size = [0, 1].map(|k| (range[k][1] - range[k][0]) / scale[k]);
        if size[0] * size[1] > most as f64 {
            return Err(fail(&format!(
                "the chord tolerance needs more than the {most} triangles allowed (max_triangles)"
            )));
        }
        let inner = grid(&rings, size);
        mesh.inner =
            inner.iter().map(|p| [range[0][0] + p[0] * scale[0], range[1][0] + p[1] * scale[1]]).collect();
    }
    let mut cdt = ConstrainedDelaunayTriangulation::<Site>::new();
    let mut uv_of = Vec::new();
    let mut insert = |cdt: &mut ConstrainedDelaunayTriangulation<Site>, uv: [f64; 2], number: u32| {
        let [x, y] = flat(uv);
        let before = cdt.num_vertices();
        let handle = cdt.insert(Site { position: spade::Point2::new(x, y), number });
        let Ok(handle) = handle else { return Err(fail("its parameters cannot be used")) };
        if cdt.num_vertices() == before {
            return Err(fail("its loops touch or repeat a point, which is not read"));
        }
        uv_of.push(uv);
        Ok(handle)
    };
    for ring in &outline.loops {
        let handles: Vec<_> =
            ring.iter().map(|c| insert(&mut cdt, c.uv, c.vertex)).collect::<Result<_, _>>()?;
        for k in 0..handles.len() {
            let (from, to) = (handles[k], handles[(k + 1) % handles.len()]);
            if from == to || cdt.try_add_constraint(from, to).is_empty() {
                return Err(fail("its loops cross each other or themselves"));
            }
        }
    }
    for (k, uv) in mesh.inner.iter().enumerate() {
        insert(&mut cdt, *uv, first_inner + k as u32)?;
    }
    let inside = inside(&cdt);
    for triangle in cdt.inner_faces().filter(|triangle| inside[triangle.fix().index()]) {
        let corners = triangle.vertices();
        mesh.triangles.push(corners.each_ref().map(|v| v.data().number));
        mesh.uvs.push(corners.each_ref().map(|v| uv_of[v.fix().index()]));
    }
    Ok(mesh)
}

/// By the triangles' index, whether an odd number of loops lies between a triangle and the outside.
fn inside(cdt: &ConstrainedDelaunayTriangulation<Site>) -> Vec<bool> {
    let mut state = vec![None; cdt.num_all_faces()];
    state[cdt.outer_face().fix().index()] = Some(false);
    let mut queue = vec![];
    let across = |edge: &spade::handles::DirectedEdgeHandle<'_, Site, (), spade::CdtEdge<()>, ()>| {
        (edge.rev().face().fix().index(), edge.is_constraint_edge())
    };
    for edge in cdt.convex_hull() {
        // The hull's edges have the outside on their left.
        queue.extend([edge, edge.rev()]);
    }
    while let Some(edge) = queue.pop() {
        let Some(here) = state[edge.face().fix().index()] else { continue };
        let (other, loops_between) = across(&edge);
        if state[other].is_none() {
            state[other] = Some(here != loops_between);
            if let Some(face) = edge.rev().face().as_inner() {
                queue.extend(face.adjacent_edges());
            }
        }
    }
    state.into_iter().map(|inside| inside == Some(true)).collect()
}

fn sides(rings: &[Vec<[f64; 2]>]) -> impl Iterator<Item = [[f64; 2]; 2]> + '_ {
    rings.iter().flat_map(|ring| (0..ring.len()).map(move |k| [ring[k], ring[(k + 1) % ring.len()]]))
}

fn crossing(a: [f64; 2], b: [f64; 2], y: f64) -> f64 {
    a[0] + (b[0] - a[0]) * (y - a[1]) / (b[1] - a[1])
}

/// Points of a grid of unit cells within the loops and off them, of a face of `size` cells.
fn grid(rings: &[Vec<[f64; 2]>], size: [f64; 2]) -> Vec<[f64; 2]> {
    let counts = size.map(|x| x.ceil().max(1.0));
    let step = [size[0] / counts[0], size[1] / counts[1]];
    // Grid places that a side comes near to.
    let mut taken = HashSet::new();
    for [a, b] in sides(rings) {
        let places = (((b[0] - a[0]).hypot(b[1] - a[1])) / (0.5 * CLEARANCE * step[0].min(step[1])))
            .ceil()
            .max(1.0) as usize;
        for k in 0..places {
            let share = k as f64 / places as f64;
            let at = [0, 1].map(|i| (a[i] + (b[i] - a[i]) * share) / step[i]);
            taken.insert(at.map(|x| x.round() as i64));
        }
    }
    let mut points = Vec::new();
    for j in 1..counts[1] as i64 {
        let y = j as f64 * step[1];
        let mut crossings: Vec<f64> = sides(rings)
            .filter(|[a, b]| (a[1] <= y) != (b[1] <= y))
            .map(|[a, b]| crossing(a, b, y))
            .collect();
        crossings.sort_unstable_by(f64::total_cmp);
        for pair in crossings.chunks_exact(2) {
            let (from, to) = ((pair[0] / step[0]).ceil() as i64, (pair[1] / step[0]).floor() as i64);
            let free = (from..=to).filter(|i| !taken.contains(&[*i, j]));
            points.extend(free.map(|i| [i as f64 * step[0], y]));
        }
    }
    points
}
