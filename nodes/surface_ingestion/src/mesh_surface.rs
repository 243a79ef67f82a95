//! The triangles of a file made into a surface: welded, oriented, with smooth normals and an estimate of its chord error. Of a
//! point cloud, which is both already: its parts and its chord error.

use patchmill_geometry::curvature::{SmoothFit, fit_smooth_surface};
use patchmill_geometry::mesh::TriangleMesh;
use patchmill_products::selection::Selection;
use patchmill_products::stage::{Progress, StageError};

use crate::cloud::CloudSurface;
use crate::crease_split::split_at_creases;
use crate::error_code::{BAD_CONTENT, BAD_SELECTION, BAD_TOPOLOGY};
use crate::finish_mask::check_only;
use crate::orient::{Orientation, orient};
use crate::raw::RawMesh;
use crate::step::StepSurface;
use crate::weld::weld;

/// A mesh with what its smooth fit and its cleaning found.
pub struct MeshSurface {
    /// The mesh with smooth normals.
    pub mesh: TriangleMesh,
    /// Normals, curvature and sharp vertices.
    pub fit: SmoothFit,
    /// Facets dropped: degenerate and duplicate.
    pub dropped: [u32; 2],
    /// What orienting found.
    pub orientation: Orientation,
}

/// Makes the surface of `raw` (m). With a `selection` its smooth parts are told apart at sharp edges.
///
/// # Errors
/// When no facet is left, the surface has no area or is one-sided; when it is a closed solid and everything is to be finished, or
/// nothing is selected; cancellation.
pub fn mesh_surface(
    raw: &RawMesh,
    selection: &Selection,
    name: &str,
    progress: Progress<'_>,
) -> Result<MeshSurface, StageError> {
    let mut welded = weld(raw);
    if welded.triangles.is_empty() {
        return Err(StageError::new(
            BAD_CONTENT,
            format!(
                "{name}: all {} facets are degenerate; facets with an area were expected",
                raw.triangles.len()
            ),
        ));
    }
    progress.check()?;
    (progress.report)(0.3);
    let orientation = orient(&welded.vertices, &mut welded.triangles, name)?;
    let dropped = [welded.degenerate, welded.duplicate];
    let mut mesh = TriangleMesh {
        vertices: welded.vertices,
        normals: Vec::new(),
        triangles: welded.triangles,
        chord_error: 0.0,
        check_only: Vec::new(),
    };
    faces_up(&mesh, name)?;
    if selection.is_all() && orientation.closed_parts == orientation.parts {
        return Err(closed_solid(name));
    }
    if !selection.is_all() {
        mesh.check_only = check_only(&mesh, Some(&welded.numbers), selection, name)?;
        split_at_creases(&mut mesh);
    }
    progress.check()?;
    (progress.report)(0.5);
    let fit = fit_smooth_surface(&mesh);
    mesh.normals = fit.normals.clone();
    mesh.chord_error = chord_error(&mesh, &fit.sharp);
    Ok(MeshSurface { mesh, fit, dropped, orientation })
}

/// Makes the surface of a cloud's mesh, whose triangles agree and look to the tool side as they are.
///
/// # Errors
/// When no facet looks to +Z or is selected.
pub fn of_cloud(cloud: CloudSurface, selection: &Selection, name: &str) -> Result<MeshSurface, StageError> {
    let CloudSurface { mut mesh, fit, .. } = cloud;
    faces_up(&mesh, name)?;
    mesh.chord_error = chord_error(&mesh, &fit.sharp);
    mesh.check_only = check_only(&mesh, None, selection, name)?;
    let found = orient(&mesh.vertices, &mut mesh.triangles.clone(), name)?;
    Ok(MeshSurface { mesh, fit, dropped: [0; 2], orientation: Orientation { reversed: 0, ..found } })
}

/// Makes the surface of a STEP file's mesh, whose normals are turned with its triangles.
///
/// # Errors
/// When no facet looks to +Z or is selected, the surface is one-sided, or a closed solid of which everything is to be finished.
pub fn of_faces(step: StepSurface, selection: &Selection, name: &str) -> Result<MeshSurface, StageError> {
    let StepSurface { mut mesh, mut fit, origins } = step;
    // Faces hang together by what their vertices were before they were split.
    let before: Vec<[u32; 3]> =
        mesh.triangles.iter().map(|triangle| triangle.map(|v| origins[v as usize])).collect();
    let mut oriented = before.clone();
    let orientation = orient(&mesh.vertices, &mut oriented, name)?;
    let mut turned = vec![false; mesh.vertices.len()];
    let pairs = mesh.triangles.iter_mut().zip(oriented.iter().zip(&before));
    let reversed = pairs.filter(|(_, (now, before))| now != before).map(|(triangle, _)| {
        triangle.swap(1, 2);
        *triangle
    });
    reversed.flatten().for_each(|v| turned[v as usize] = true);
    for v in (0..turned.len()).filter(|v| turned[*v]) {
        fit.normals[v] = -fit.normals[v];
        fit.curvature[v] = fit.curvature[v].turned(&fit.normals[v]);
    }
    mesh.normals.clone_from(&fit.normals);
    faces_up(&mesh, name)?;
    if selection.is_all() && orientation.closed_parts == orientation.parts {
        return Err(closed_solid(name));
    }
    mesh.check_only = check_only(&mesh, None, selection, name)?;
    Ok(MeshSurface { mesh, fit, dropped: [0; 2], orientation })
}

fn closed_solid(name: &str) -> StageError {
    StageError::new(
        BAD_SELECTION,
        format!(
            "{name}: it is a closed solid, bottom and walls included; say with --select which of its facets are to be finished, \
             for example --select normal=60 for those that lean up to 60 degrees from +Z (the others may not be gouged)"
        ),
    )
}

fn faces_up(mesh: &TriangleMesh, name: &str) -> Result<(), StageError> {
    let up = (0..mesh.triangles.len()).any(|t| {
        let [a, b, c] = mesh.corners(t);
        let cross = (b - a).cross(&(c - a));
        cross.z > 1e-6 * cross.norm()
    });
    if up {
        return Ok(());
    }
    Err(StageError::new(
        BAD_TOPOLOGY,
        format!("{name}: no facet looks to +Z; the machined side must look to +Z"),
    ))
}

/// Largest distance between a facet and the smooth surface, m, estimated from the vertex normals: the quadratic sagitta
/// at the edges' midpoints and the facets' centres, as in [`TriangleMesh::smooth_point`]. Facets at sharp edges are left out:
/// there the facets are the surface.
fn chord_error(mesh: &TriangleMesh, sharp: &[bool]) -> f64 {
    let mut worst = 0f64;
    for triangle in &mesh.triangles {
        let v = triangle.map(|v| v as usize);
        let sagitta = |i: usize, j: usize| {
            let (a, b) = (v[i], v[j]);
            if sharp[a] || sharp[b] {
                return 0.0;
            }
            (mesh.normals[b] - mesh.normals[a]).dot(&(mesh.vertices[b] - mesh.vertices[a]))
        };
        let s = [sagitta(0, 1), sagitta(1, 2), sagitta(2, 0)];
        let edges = s.iter().fold(0f64, |m, x| m.max(x.abs())) / 8.0;
        worst = worst.max(edges).max((s.iter().sum::<f64>() / 18.0).abs());
    }
    worst
}
