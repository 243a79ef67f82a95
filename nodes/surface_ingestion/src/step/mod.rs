//! STEP files (AP203, AP214, AP242) as one mesh with the surfaces' own normals and curvature.
//!
//! Read top-down: [`read`] → [`part21`] (text) → [`model`] (faces, edges) over [`shapes`] → [`edges`] (points that faces share) →
//! [`face_mesh`] (triangles). What is not read is refused by its number and type; nothing is left out.

pub mod edges;
pub mod face_mesh;
pub mod model;
pub mod part21;
pub mod shapes;

use std::collections::BTreeMap;

use nalgebra::{Point3, Vector3};
use patchmill_geometry::curvature::{Curvature, SHARP_ANGLE, SmoothFit};
use patchmill_geometry::mesh::TriangleMesh;
use patchmill_products::stage::{Progress, StageError};
use rayon::prelude::*;

use crate::error_code::{BAD_CONTENT, TOO_MANY_TRIANGLES};
use face_mesh::{FaceMesh, Outline};
use model::{Face, Model};

use crate::parametric::SurfacePoint;

/// Share of the tolerance that edges and cells are laid out for at first.
const AIM: f64 = 0.9;
/// Times that all is laid out finer before giving up.
const ROUNDS: u32 = 8;

/// The mesh of a file's faces, its normals those of `fit`, and what the surfaces are at its vertices.
pub struct StepSurface {
    /// Triangles that share the points of edges; `chord_error` is the largest facet distance found.
    pub mesh: TriangleMesh,
    /// The surfaces' normals and curvature; where faces meet smoothly the mean normal and the more concave curvature.
    pub fit: SmoothFit,
    /// The vertex that each was before sharp ones were split.
    pub origins: Vec<u32>,
}

/// Reads the faces of a STEP file within `tolerance` (m). With `apart` vertices on sharp edges are given to every smooth part of the
/// surface on its own, as [`crate::crease_split`] does for other meshes.
///
/// # Errors
/// Naming the instance that is malformed or of a kind that is not read; when more than `most` triangles are needed; cancellation.
pub fn read(
    bytes: &[u8],
    name: &str,
    tolerance: f64,
    most: usize,
    apart: bool,
    progress: Progress<'_>,
) -> Result<StepSurface, StageError> {
    let bad = |text: String| StageError::new(BAD_CONTENT, format!("{name}: {text}"));
    let model = model::read(&part21::parse(bytes).map_err(bad)?).map_err(bad)?;
    let (mut chord, mut found) = (AIM * tolerance, f64::INFINITY);
    for round in 0..ROUNDS {
        progress.check()?;
        (progress.report)(0.6 * f64::from(round) / f64::from(ROUNDS));
        let pieces = Pieces::lay_out(&model, chord, most).map_err(bad)?;
        let (worst, off) = pieces.measure(&model);
        if worst <= tolerance + off {
            return Ok(pieces.join(&model, worst, apart));
        }
        found = worst;
        chord *= (AIM * tolerance / worst).clamp(0.1, AIM);
    }
    Err(StageError::new(
        TOO_MANY_TRIANGLES,
        format!(
            "{name}: the facets stay {:.3} µm off the faces, however fine; {:.3} µm was expected: a larger chord tolerance may do",
            found * 1e6,
            tolerance * 1e6
        ),
    ))
}

/// All faces as triangles over one list of points.
struct Pieces {
    /// Points of edges first.
    points: Vec<Point3<f64>>,
    outlines: Vec<Outline>,
    /// Of each face, its triangles and the number of its first own point.
    faces: Vec<(FaceMesh, u32)>,
}

/// A loop's points: their numbers and places.
type Loop = Vec<(u32, Point3<f64>)>;
/// The loops of a face.
type FaceLoops = Vec<Loop>;

impl Pieces {
    fn lay_out(model: &Model, chord: f64, most: usize) -> Result<Self, String> {
        // The faces' cells bound the chords of the edges, whose points the cells are laid between.
        let (_, loops) = edge_points(model, chord, &BTreeMap::new())?;
        let outlines = outlines(model, &loops, chord)?;
        let mut longest = BTreeMap::new();
        for (face, outline) in model.faces.iter().zip(&outlines) {
            for used in face.loops.iter().flatten() {
                let slot = longest.entry(used.edge).or_insert(f64::INFINITY);
                *slot = f64::min(*slot, outline.reach);
            }
        }
        let (mut points, loops) = edge_points(model, chord, &longest)?;
        let outlines = self::outlines(model, &loops, chord)?;
        let shared = points.len() as u32;
        let meshes: Vec<FaceMesh> = model
            .faces
            .par_iter()
            .zip(&outlines)
            .map(|(face, outline)| face_mesh::triangulate(face, outline, shared, most))
            .collect::<Result<_, _>>()?;
        let count: usize = meshes.iter().map(|mesh| mesh.triangles.len()).sum();
        if count > most {
            return Err(format!(
                "the chord tolerance needs {count} triangles, more than the {most} allowed (max_triangles)"
            ));
        }
        let mut faces = Vec::with_capacity(meshes.len());
        for (face, mesh) in model.faces.iter().zip(meshes) {
            let first = points.len() as u32;
            points.extend(mesh.inner.iter().map(|uv| face.shape.at(*uv).position));
            faces.push((renumbered(mesh, shared, first), first));
        }
        Ok(Self { points, outlines, faces })
    }

    /// Largest distance of a facet from its surface, and of an edge from its faces, m.
    fn measure(&self, model: &Model) -> (f64, f64) {
        let worst = |face: &Face, mesh: &FaceMesh| {
            let of = |(triangle, uvs): (&[u32; 3], &[[f64; 2]; 3])| {
                let [a, b, c] = triangle.map(|v| self.points[v as usize]);
                let Some(n) = (b - a).cross(&(c - a)).try_normalize(0.0) else { return 0.0 };
                let mean = |places: &[usize]| {
                    [0, 1].map(|k| places.iter().map(|i| uvs[*i][k]).sum::<f64>() / places.len() as f64)
                };
                let places: [&[usize]; 4] = [&[0, 1], &[1, 2], &[2, 0], &[0, 1, 2]];
                places
                    .into_iter()
                    .map(|at| (face.shape.at(mean(at)).position - a).dot(&n).abs())
                    .fold(0.0, f64::max)
            };
            mesh.triangles.iter().zip(&mesh.uvs).map(of).fold(0.0, f64::max)
        };
        let pairs: Vec<_> = model.faces.iter().zip(&self.faces).collect();
        let of_faces: Vec<f64> = pairs.par_iter().map(|(face, (mesh, _))| worst(face, mesh)).collect();
        (
            of_faces.into_iter().fold(0.0, f64::max),
            self.outlines.iter().map(|outline| outline.off).fold(0.0, f64::max),
        )
    }

    fn join(mut self, model: &Model, chord_error: f64, apart: bool) -> StepSurface {
        let mut attributes = self.attributes(model);
        let mut origins: Vec<u32> = (0..self.points.len() as u32).collect();
        if apart {
            self.split(model, &attributes.sharp, &mut origins);
            attributes = self.attributes(model);
        }
        let turned = |(face, (mesh, _)): (&Face, &(FaceMesh, u32))| -> Vec<[u32; 3]> {
            let turn = |[a, b, c]: &[u32; 3]| if face.same_sense { [*a, *b, *c] } else { [*a, *c, *b] };
            mesh.triangles.iter().map(turn).collect()
        };
        let fit = attributes.fit();
        let mesh = TriangleMesh {
            triangles: model.faces.iter().zip(&self.faces).flat_map(turned).collect(),
            vertices: self.points,
            normals: fit.normals.clone(),
            chord_error,
            check_only: Vec::new(),
        };
        StepSurface { mesh, fit, origins }
    }

    fn attributes(&self, model: &Model) -> Attributes {
        let mut attributes = Attributes::new(self.points.len());
        for (number, (face, (mesh, _))) in (0..).zip(model.faces.iter().zip(&self.faces)) {
            for (triangle, uvs) in mesh.triangles.iter().zip(&mesh.uvs) {
                for (vertex, uv) in triangle.iter().zip(uvs) {
                    attributes.add(*vertex as usize, number, face, *uv, uvs);
                }
            }
        }
        attributes
    }

    /// Gives every sharp vertex once to each of the smooth parts that meet there.
    fn split(&mut self, model: &Model, sharp: &[bool], origins: &mut Vec<u32>) {
        let mut parts: BTreeMap<u32, Vec<(Vector3<f64>, u32)>> = BTreeMap::new();
        for (face, (mesh, _)) in model.faces.iter().zip(&mut self.faces) {
            for (triangle, uvs) in mesh.triangles.iter_mut().zip(&mesh.uvs) {
                for (vertex, uv) in triangle.iter_mut().zip(uvs).filter(|(v, _)| sharp[**v as usize]) {
                    let Some((_, normal)) = regular(face, *uv, uvs) else { continue };
                    let parts = parts.entry(*vertex).or_default();
                    let own = parts.iter().find(|(other, _)| other.dot(&normal) >= SHARP_ANGLE.cos());
                    *vertex = match own {
                        Some((_, index)) => *index,
                        None => {
                            let index = if parts.is_empty() { *vertex } else { self.points.len() as u32 };
                            if !parts.is_empty() {
                                self.points.push(self.points[*vertex as usize]);
                                origins.push(*vertex);
                            }
                            parts.push((normal, index));
                            index
                        }
                    };
                }
            }
        }
    }
}

/// The surface of a face at a corner of a triangle, and its normal on the face's side; at a pole, where the derivatives vanish, at the
/// triangle's middle.
fn regular(face: &Face, uv: [f64; 2], corners: &[[f64; 2]; 3]) -> Option<(SurfacePoint, Vector3<f64>)> {
    let centre = [0, 1].map(|k| corners.iter().map(|c| c[k]).sum::<f64>() / 3.0);
    let found = [uv, centre].into_iter().find_map(|uv| {
        let p = face.shape.at(uv);
        p.normal(1e-6).map(|n| (p, n))
    });
    found.map(|(p, normal)| (p, if face.same_sense { normal } else { -normal }))
}

/// Points of all edges, and every face's loops over them; `longest` bounds the chords of edges, m.
fn edge_points(
    model: &Model,
    chord: f64,
    longest: &BTreeMap<u64, f64>,
) -> Result<(Vec<Point3<f64>>, Vec<FaceLoops>), String> {
    let (mut points, mut vertices, mut of_edge) = (Vec::new(), BTreeMap::new(), BTreeMap::new());
    for (number, edge) in &model.edges {
        let most = longest.get(number).copied().unwrap_or(f64::INFINITY);
        let places = edges::points(*number, edge, chord, most)?;
        let last = places.len() - 1;
        let mut numbers = Vec::with_capacity(places.len());
        for (k, p) in places.into_iter().enumerate() {
            let new = points.len() as u32;
            let index = match k {
                0 => *vertices.entry(edge.vertices[0]).or_insert(new),
                k if k == last => *vertices.entry(edge.vertices[1]).or_insert(new),
                _ => new,
            };
            if index == new {
                points.push(p);
            }
            numbers.push(index);
        }
        of_edge.insert(*number, numbers);
    }
    let ring = |face: &Face, uses: &[model::Use]| {
        let mut ring: Loop = Vec::new();
        let mut end = None;
        for used in uses {
            let mut numbers = of_edge[&used.edge].clone();
            if !used.forward {
                numbers.reverse();
            }
            if end.is_some_and(|end| numbers.first() != Some(&end)) {
                return Err(broken(face, used.edge));
            }
            end = numbers.pop();
            ring.extend(numbers.into_iter().map(|k| (k, points[k as usize])));
        }
        match (ring.first(), end) {
            (Some((first, _)), Some(end)) if *first == end => Ok(ring),
            _ => Err(broken(face, uses.last().map_or(0, |used| used.edge))),
        }
    };
    let of_face = |face: &Face| face.loops.iter().map(|uses| ring(face, uses)).collect::<Result<Vec<_>, _>>();
    let loops = model.faces.iter().map(of_face).collect::<Result<Vec<_>, _>>()?;
    Ok((points, loops))
}

fn broken(face: &Face, edge: u64) -> String {
    format!(
        "#{} ADVANCED_FACE: its loop is broken at the edge #{edge}; the next edge was expected to begin where it ends",
        face.number
    )
}

fn outlines(model: &Model, loops: &[FaceLoops], chord: f64) -> Result<Vec<Outline>, String> {
    model.faces.par_iter().zip(loops).map(|(face, loops)| face_mesh::outline(face, loops, chord)).collect()
}

/// A face's triangles with its own points from `first` on instead of `shared`; those that a pole collapses are gone.
fn renumbered(mut mesh: FaceMesh, shared: u32, first: u32) -> FaceMesh {
    mesh.triangles.iter_mut().flatten().filter(|v| **v >= shared).for_each(|v| *v += first - shared);
    let kept: Vec<bool> = mesh.triangles.iter().map(|[a, b, c]| a != b && b != c && c != a).collect();
    let (mut triangle, mut uv) = (kept.iter(), kept.iter());
    mesh.triangles.retain(|_| triangle.next() == Some(&true));
    mesh.uvs.retain(|_| uv.next() == Some(&true));
    mesh
}

/// What the faces are at the vertices.
struct Attributes {
    /// The face that a vertex was last met on.
    last: Vec<u32>,
    first_normal: Vec<Vector3<f64>>,
    normals: Vec<Vector3<f64>>,
    curvature: Vec<Curvature>,
    sharp: Vec<bool>,
}

impl Attributes {
    fn new(count: usize) -> Self {
        let flat = Curvature { max: f64::NEG_INFINITY, min: 0.0, direction: Vector3::x() };
        let zero = vec![Vector3::zeros(); count];
        Self {
            last: vec![u32::MAX; count],
            first_normal: zero.clone(),
            normals: zero,
            curvature: vec![flat; count],
            sharp: vec![false; count],
        }
    }

    /// Takes a corner of a face's triangle with parameters `uv` into account, once a face.
    fn add(&mut self, vertex: usize, number: u32, face: &Face, uv: [f64; 2], corners: &[[f64; 2]; 3]) {
        if self.last[vertex] == number {
            return;
        }
        let first = self.last[vertex] == u32::MAX;
        self.last[vertex] = number;
        let Some((p, normal)) = regular(face, uv, corners) else { return };
        let curvature = p.curvature(&normal);
        if first {
            self.first_normal[vertex] = normal;
        } else if self.first_normal[vertex].dot(&normal) < SHARP_ANGLE.cos() {
            self.sharp[vertex] = true;
        }
        self.normals[vertex] += normal;
        if curvature.max > self.curvature[vertex].max {
            self.curvature[vertex] = curvature;
        }
    }

    fn fit(mut self) -> SmoothFit {
        for (v, normal) in self.normals.iter_mut().enumerate() {
            *normal = normal.try_normalize(1e-9).unwrap_or(self.first_normal[v]);
            if self.sharp[v] || !self.curvature[v].max.is_finite() {
                self.curvature[v] = Curvature { max: 0.0, min: 0.0, direction: Vector3::x() };
            }
        }
        SmoothFit { normals: self.normals, curvature: self.curvature, sharp: self.sharp }
    }
}

#[cfg(test)]
mod tests;
