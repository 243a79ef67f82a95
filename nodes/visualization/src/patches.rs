//! The mesh, one colour a patch.

use std::borrow::Cow;

use nalgebra::{Point3, center};
use patchmill_geometry::mesh::TriangleMesh;
use patchmill_path_generation::sample_interpolation::SampleInterpolation;
use patchmill_products::field::RollingBallField;
use patchmill_products::partition::{Classifier, Partition, feature};
use patchmill_products::samples::SurfaceSamples;

use crate::colours::{self, Rgb};
use crate::shape::{Drawing, Form, MOST_POINTS, Shape};
use crate::simplify::display_triangles;

/// Larger meshes are drawn coarser, with no more triangles than this.
pub const DISPLAY_TRIANGLES: usize = 20_000;
/// Triangles at a border are divided down to this share of the samples' distance.
const BORDER_DETAIL: f64 = 0.15;
/// Larger ones than so many times the samples' distance are divided in any case: a patch could lie within.
const UNLOOKED: f64 = 4.0;

/// A triangle's corners, m.
pub type Triangle = [Point3<f64>; 3];

/// What tells the patches apart.
pub struct Colouring<'a> {
    /// The chosen partition.
    pub partition: &'a Partition,
    /// The samples that it labels.
    pub samples: &'a SurfaceSamples,
    /// Their rolling-ball field.
    pub field: &'a RollingBallField,
}

/// The surface in grey, in the namespace `surface`, what is not to be finished darker, in `check_surface`; larger ones than
/// [`DISPLAY_TRIANGLES`] are drawn coarser, as the note says.
pub fn plain(mesh: &TriangleMesh) -> Drawing {
    let (finished, check) = by_selection(mesh);
    let triangles = display_triangles(&finished, share(&finished, mesh));
    let mut shapes = shapes_of("surface", colours::NEUTRAL, &triangles);
    let checked = check_surface(check.as_ref(), mesh, &mut shapes);
    Drawing { shapes, note: note(mesh, triangles.len() + checked) }
}

/// The facets to be finished and, where there are any, those that are not.
fn by_selection(mesh: &TriangleMesh) -> (Cow<'_, TriangleMesh>, Option<TriangleMesh>) {
    let count = mesh.triangles.len();
    if (0..count).all(|t| mesh.is_finished(t)) {
        return (Cow::Borrowed(mesh), None);
    }
    let part = |finished: bool| TriangleMesh {
        vertices: mesh.vertices.clone(),
        normals: mesh.normals.clone(),
        triangles: (0..count)
            .filter(|t| mesh.is_finished(*t) == finished)
            .map(|t| mesh.triangles[t])
            .collect(),
        chord_error: mesh.chord_error,
        check_only: Vec::new(),
    };
    (Cow::Owned(part(true)), Some(part(false)))
}

/// How many of [`DISPLAY_TRIANGLES`] a part of the mesh may have; all of its own where the whole mesh is drawn as it is.
fn share(part: &TriangleMesh, mesh: &TriangleMesh) -> usize {
    DISPLAY_TRIANGLES * part.triangles.len() / mesh.triangles.len().max(1)
}

/// Adds what is not to be finished; gives how many triangles that were.
fn check_surface(check: Option<&TriangleMesh>, mesh: &TriangleMesh, shapes: &mut Vec<Shape>) -> usize {
    let Some(check) = check else { return 0 };
    let triangles = display_triangles(check, share(check, mesh));
    shapes.extend(shapes_of("check_surface", colours::CHECK_SURFACE, &triangles));
    triangles.len()
}

/// The surface with the colours of the patches, in the namespaces `patch_0`, `patch_1` …, what is not to be finished in dark grey, in
/// `check_surface`; larger ones than [`DISPLAY_TRIANGLES`] are drawn coarser, as the note says. Patches are those that path_generation cuts: points are
/// classified by place and pseudo-curvature between the samples. `None` when the partition cannot classify or does not fit
/// the samples.
pub fn coloured(mesh: &TriangleMesh, by: &Colouring<'_>) -> Option<Drawing> {
    let (finished, check) = by_selection(mesh);
    let Labelled { triangles, drawn } = labelled(&finished, by, share(&finished, mesh))?;
    let mut patches: Vec<Vec<Triangle>> = vec![Vec::new(); by.partition.patches.len()];
    for (patch, triangle) in triangles {
        patches[patch].push(triangle);
    }
    let of_patch = |(i, t): (usize, &Vec<Triangle>)| shapes_of(&format!("patch_{i}"), colours::patch(i), t);
    let mut shapes = patches.iter().enumerate().flat_map(of_patch).collect();
    let checked = check_surface(check.as_ref(), mesh, &mut shapes);
    Some(Drawing { shapes, note: note(mesh, drawn + checked) })
}

/// Triangles to look at, each with its patch.
pub struct Labelled {
    /// Patch and corners.
    pub triangles: Vec<(usize, Triangle)>,
    /// How many there were before those along the patches' borders were divided; fewer than the mesh has where it is drawn coarser.
    pub drawn: usize,
}

/// The surface with at most `most` triangles, those along the patches' borders divided into at most half as many more. `None` as
/// [`coloured`].
pub fn labelled(mesh: &TriangleMesh, by: &Colouring<'_>, most: usize) -> Option<Labelled> {
    let classifier = Classifier::new(by.partition)?;
    let n = by.samples.len();
    if n == 0 || by.partition.labels.len() != n || by.field.pseudo_curvature.len() != n {
        return None;
    }
    let shape = SampleInterpolation::new(by.samples, by.field);
    let label = |p: &Point3<f64>| classifier.classify(&feature(p, shape.at(p).pseudo_curvature));
    let spacing = (by.samples.area.iter().sum::<f64>() / n as f64).sqrt();
    let triangles = display_triangles(mesh, most);
    let drawn = triangles.len();
    Some(Labelled { triangles: divided(triangles, &label, spacing, most / 2), drawn })
}

fn note(mesh: &TriangleMesh, drawn: usize) -> String {
    let count = mesh.triangles.len();
    if drawn == count {
        String::new()
    } else {
        format!("the mesh of {count} triangles is drawn with {drawn}")
    }
}

/// The triangles with their labels: those with a border between labels, and those much larger than the samples' distance
/// `spacing` (m), are halved until they are small, at most `most` times in all.
fn divided(
    mut pending: Vec<Triangle>,
    label: &impl Fn(&Point3<f64>) -> usize,
    spacing: f64,
    mut most: usize,
) -> Vec<(usize, Triangle)> {
    pending.reverse();
    let mut done = Vec::with_capacity(pending.len());
    while let Some(triangle) = pending.pop() {
        let [a, b, c] = triangle;
        let middle = label(&Point3::from((a.coords + b.coords + c.coords) / 3.0));
        let (edge, longest) = longest_edge(&triangle);
        let mixed = || triangle.iter().any(|p| label(p) != middle);
        let worth = longest > UNLOOKED * spacing || longest > BORDER_DETAIL * spacing && mixed();
        if worth && most > 0 {
            most -= 1;
            pending.extend(halves(&triangle, edge));
        } else {
            done.push((middle, triangle));
        }
    }
    done
}

/// Number of the longest edge (from that corner to the next) and its length, m.
fn longest_edge(t: &Triangle) -> (usize, f64) {
    let length = |i: usize| (t[(i + 1) % 3] - t[i]).norm();
    let longest = (0..3).max_by(|a, b| length(*a).total_cmp(&length(*b))).unwrap_or(0);
    (longest, length(longest))
}

fn halves(t: &Triangle, edge: usize) -> [Triangle; 2] {
    let (a, b, c) = (t[edge], t[(edge + 1) % 3], t[(edge + 2) % 3]);
    let m = center(&a, &b);
    [[a, m, c], [m, b, c]]
}

fn shapes_of(ns: &str, colour: Rgb, triangles: &[Triangle]) -> Vec<Shape> {
    let parts = triangles.chunks(MOST_POINTS / 3).enumerate();
    parts.map(|(id, part)| Shape::on_workpiece(ns, id, colour, Form::Triangles(part.to_vec()))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shape::into_messages;
    use crate::simplify::area_of;
    use crate::simplify::tests::bowl;
    use std::collections::BTreeSet;

    fn triangles(shapes: &[Shape]) -> Vec<Triangle> {
        let of = |s: &Shape| match &s.form {
            Form::Triangles(t) => t.clone(),
            other => panic!("{other:?}"),
        };
        shapes.iter().flat_map(of).collect()
    }

    fn bits(t: &Triangle) -> Vec<u64> {
        t.iter().flat_map(|p| p.iter().map(|v| v.to_bits()).collect::<Vec<_>>()).collect()
    }

    #[test]
    fn every_triangle_of_the_grey_surface_is_drawn_once_in_small_messages() {
        let mesh = bowl(90);
        let Drawing { shapes, note } = plain(&mesh);
        assert_eq!(note, "");
        let drawn = triangles(&shapes);
        let expected: BTreeSet<_> = (0..mesh.triangles.len()).map(|t| bits(&mesh.corners(t))).collect();
        assert_eq!(drawn.len(), mesh.triangles.len());
        assert_eq!(drawn.iter().map(bits).collect::<BTreeSet<_>>(), expected);
        let ids: BTreeSet<_> = shapes.iter().map(|s| (s.ns.clone(), s.id)).collect();
        assert!(ids.len() == shapes.len() && shapes.iter().all(|s| s.ns == "surface"));
        assert!(into_messages(shapes).len() > 10);
    }

    #[test]
    fn what_is_not_to_be_finished_is_drawn_apart() {
        for n in [40, 150] {
            let mut mesh = bowl(n);
            let count = mesh.triangles.len();
            mesh.check_only = (0..count).map(|t| mesh.corners(t)[0].x < 0.02).collect();
            let Drawing { shapes, note } = plain(&mesh);
            let of = |ns: &str| triangles(&shapes.iter().filter(|s| s.ns == ns).cloned().collect::<Vec<_>>());
            let (finished, check) = (of("surface"), of("check_surface"));
            let area = |t: &[Triangle]| t.iter().map(area_of).sum::<f64>();
            assert!((area(&finished) / mesh.finished_area() - 1.0).abs() < 0.01);
            // A border of cells as wide as the coarse mesh's, at most.
            assert!(
                check.iter().flatten().all(|p| p.x < 0.023) && finished.iter().flatten().all(|p| p.x > 0.017)
            );
            if n == 40 {
                assert_eq!(finished.len() + check.len(), count);
                assert_eq!(note, "");
            } else {
                assert!(finished.len() + check.len() <= DISPLAY_TRIANGLES && !note.is_empty());
            }
        }
    }

    #[test]
    fn a_large_surface_is_coarse_and_says_so() {
        let drawing = plain(&bowl(150));
        let drawn = triangles(&drawing.shapes).len();
        assert!(drawn <= DISPLAY_TRIANGLES);
        assert_eq!(drawing.note, format!("the mesh of 44402 triangles is drawn with {drawn}"));
    }

    #[test]
    fn triangles_are_divided_along_the_border_only_and_cover_the_same_area() {
        let mesh = bowl(40);
        let whole: Vec<Triangle> = (0..mesh.triangles.len()).map(|t| mesh.corners(t)).collect();
        let label = |p: &Point3<f64>| usize::from(p.x + 0.3 * p.y > 0.0611);
        let parts = divided(whole.clone(), &label, 4e-3, 100_000);
        let area = |t: &mut dyn Iterator<Item = &Triangle>| t.map(area_of).sum::<f64>();
        let (drawn, all) = (area(&mut parts.iter().map(|(_, t)| t)), area(&mut whole.iter()));
        assert!((drawn / all - 1.0).abs() < 1e-12);
        assert!(parts.len() > whole.len() && parts.len() < 2 * whole.len(), "{}", parts.len());
        // A triangle of one label reaches over the border by no more than the detail.
        for (patch, t) in &parts {
            if t.iter().any(|p| label(p) != *patch) {
                assert!(longest_edge(t).1 <= BORDER_DETAIL * 4e-3);
            }
        }
        let capped = divided(whole.clone(), &label, 4e-3, 10);
        assert_eq!(capped.len(), whole.len() + 10);
    }
}
