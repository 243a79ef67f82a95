//! An STL's facets made into a surface: welded, oriented, with smooth normals and an estimate of its chord error.

use nalgebra::Point3;
use patchmill_geometry::curvature::{SmoothFit, fit_smooth_surface};
use patchmill_geometry::mesh::TriangleMesh;
use patchmill_products::stage::{Progress, StageError};

use crate::error_code::{BAD_CONTENT, BAD_TOPOLOGY};
use crate::orient::{Orientation, orient};
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

/// Makes the surface of `facets` (m).
///
/// # Errors
/// When no facet is left, the surface has no area or is one-sided; cancellation.
pub fn mesh_surface(
    facets: &[[Point3<f64>; 3]],
    name: &str,
    progress: Progress<'_>,
) -> Result<MeshSurface, StageError> {
    let mut welded = weld(facets);
    if welded.triangles.is_empty() {
        return Err(StageError::new(
            BAD_CONTENT,
            format!(
                "{name}: all {} facets of the STL are degenerate; facets with an area were expected",
                facets.len()
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
    };
    faces_up(&mesh, name)?;
    progress.check()?;
    (progress.report)(0.5);
    let fit = fit_smooth_surface(&mesh);
    mesh.normals = fit.normals.clone();
    mesh.chord_error = chord_error(&mesh, &fit.sharp);
    Ok(MeshSurface { mesh, fit, dropped, orientation })
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
        format!("{name}: no facet of the STL looks to +Z; the machined side must look to +Z"),
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
