//! The rolling-ball field of a surface: at every sample the most concave pseudo-curvature κ* = 1/R* over the shadow
//! of the tool (paper, "Theoretical framework of the RBM").
//!
//! A ball of radius R* that touches the surface at the sample holds no point of the shadow inside it where R* > 0; where
//! R* < 0 the whole shadow lies inside the ball |R*| below. The tool in that ball cannot gouge.

pub mod local_balls;
pub mod node;
pub mod pseudo_radius;
pub mod rest_zone;
pub mod shadow;
#[cfg(test)]
mod test_surfaces;
pub mod tool_fit;

use std::sync::atomic::{AtomicUsize, Ordering};

use nalgebra::Vector3;
use patchmill_geometry::bvh::Bvh;
use patchmill_geometry::mesh::TriangleMesh;
use patchmill_geometry::rolling_ball::{BallTree, SmoothSurface};
use patchmill_geometry::surface_points::SurfacePoints;
use patchmill_products::field::RollingBallField;
use patchmill_products::job::Job;
use patchmill_products::samples::SurfaceSamples;
use patchmill_products::stage::{Progress, StageError};
use rayon::prelude::*;

use pseudo_radius::{Ball, BallSearch, Shadow, shadow_radius};
use shadow::{Border, ShadowPattern, TangentFrame};

pub use tool_fit::check_tool_fits;

/// Code: mesh, samples or field are empty, do not match, or hold numbers that are not finite.
pub const CODE_INPUT: i32 = 201;
/// Code: parameters or tool make no shadow.
pub const CODE_PARAMETERS: i32 = 202;
/// Code: the tool is too big for the part.
pub const CODE_TOOL_TOO_BIG: i32 = 203;

/// With the exact shadow, the points nearer to a sample than this share of the tool's 2·R1 + R2 do not count; there
/// the largest principal curvature speaks for the surface. 3.2 mm for the 38.1 mm torus, as for the border of the circles.
const NEAR: f64 = 0.1;
/// The same for samples whose normals are fitted to a mesh: 6.4 mm, as far as the paper's innermost circle, where an
/// error of a milliradian, as beside a jump of curvature, is 0.3 /m of κ.
const NEAR_FITTED: f64 = 0.2;
/// Facets longer than this share of 2·R1 + R2 get points of their own, no further apart.
const SPACING: f64 = 0.03;

/// Which points of the shadow are looked at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ShadowKind {
    /// All of the surface within the shadow, by branch and bound: its vertices, and points inside of long facets.
    Exact,
    /// The paper's concentric circles of shadow-check points.
    Circles,
}

/// How to analyse. The tool travels in the job.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AnalysisParams {
    /// Which points of the shadow are looked at; those below say how for [`ShadowKind::Circles`].
    pub shadow: ShadowKind,
    /// Shadow radius in units of 2·R1 + R2; at least 1 for the guarantee to cover the tool's bottom. 0 is the whole
    /// part, for the exact shadow only.
    pub shadow_factor: f64,
    /// Concentric shadow circles, at i/`shadow_circles` of the shadow radius; at least 1.
    pub shadow_circles: usize,
    /// Shadow-check points on each circle; at least 3.
    pub points_per_circle: usize,
    /// Whether the border of the surface within the shadow takes part; the paper's circles alone leave a gap there.
    pub include_border: bool,
}

impl Default for AnalysisParams {
    /// All of the surface within the paper's shadow; for circles the paper's five of 100 points, and the border.
    fn default() -> Self {
        Self {
            shadow: ShadowKind::Exact,
            shadow_factor: 1.0,
            shadow_circles: 5,
            points_per_circle: 100,
            include_border: true,
        }
    }
}

/// κ* and the point that stops the ball, for every sample.
///
/// The exact shadow is the vertices of the mesh and points inside of its longer facets, moved to the smooth surface,
/// that are within the shadow radius in the tangent plane. For circles each shadow-check point is projected along the
/// sample's normal onto the mesh and corrected from the facet to the smooth surface; points off the surface are skipped,
/// and the border vertices within the shadow are looked at as well (see [`Border`]). The result does not depend on
/// the number of threads.
///
/// # Errors
/// Codes 201 and 202 (see the constants of this module), 1 when cancelled. Whether the tool fits is asked of
/// [`check_tool_fits`].
pub fn analyse(
    mesh: &TriangleMesh,
    samples: &SurfaceSamples,
    job: &Job,
    params: &AnalysisParams,
    progress: Progress<'_>,
) -> Result<RollingBallField, StageError> {
    validate_mesh(mesh)?;
    validate_samples(samples)?;
    let tool_shadow = validate_shadow(job, params)?;
    let whole = params.shadow_factor == 0.0;
    let radius = if whole { f64::INFINITY } else { params.shadow_factor * tool_shadow };
    let balls = match params.shadow {
        ShadowKind::Exact => {
            // Only an analytic surface is sampled on a grid.
            let near = if samples.grid.is_some() { NEAR } else { NEAR_FITTED };
            let points = || BallTree::build(&SurfacePoints::of(mesh, SPACING * tool_shadow));
            let (tree, surface) = rayon::join(points, || SmoothSurface::of(mesh));
            let shadow = Shadow::Exact { tree: &tree, surface: &surface, near: near * tool_shadow };
            inflate(&BallSearch { shadow, cutter: job.tool.cutter, radius }, samples, progress)?
        }
        ShadowKind::Circles => {
            let border = || if params.include_border { Border::of(mesh) } else { Border::default() };
            let (bvh, border) = rayon::join(|| Bvh::build(mesh), border);
            let pattern = ShadowPattern::new(params.shadow_circles, params.points_per_circle);
            let shadow = Shadow::Circles { mesh, bvh: &bvh, border: &border, pattern: &pattern };
            inflate(&BallSearch { shadow, cutter: job.tool.cutter, radius }, samples, progress)?
        }
    };
    Ok(RollingBallField {
        pseudo_curvature: balls.iter().map(|b| b.curvature).collect(),
        contact: balls.iter().map(|b| b.contact).collect(),
        shadow_radius: if whole { diagonal(mesh) } else { radius },
    })
}

/// The ball of every sample.
fn inflate(
    search: &BallSearch<'_>,
    samples: &SurfaceSamples,
    progress: Progress<'_>,
) -> Result<Vec<Ball>, StageError> {
    let n = samples.len();
    let done = AtomicUsize::new(0);
    let step = n.div_ceil(50);
    (0..n)
        .into_par_iter()
        .map(|i| {
            progress.check()?;
            let frame = TangentFrame::new(samples.points[i], samples.normals[i], &samples.direction_max[i]);
            let ball = search.ball(&frame, samples.curvature_max[i]);
            let count = done.fetch_add(1, Ordering::Relaxed) + 1;
            if count.is_multiple_of(step) {
                (progress.report)(count as f64 / n as f64);
            }
            Ok(ball)
        })
        .collect()
}

/// Diagonal of the mesh's box, m: no shadow needs to be larger.
fn diagonal(mesh: &TriangleMesh) -> f64 {
    let corner = |f: fn(&Vector3<f64>, &Vector3<f64>) -> Vector3<f64>| {
        mesh.vertices.iter().map(|p| p.coords).reduce(|a, b| f(&a, &b)).unwrap_or_default()
    };
    (corner(Vector3::sup) - corner(Vector3::inf)).norm()
}

fn input_error(text: impl Into<String>) -> StageError {
    StageError::new(CODE_INPUT, text)
}

fn validate_mesh(mesh: &TriangleMesh) -> Result<(), StageError> {
    if mesh.triangles.is_empty() {
        return Err(input_error("the mesh has no triangles"));
    }
    let n = mesh.vertices.len();
    if mesh.normals.len() != n {
        return Err(input_error(format!("the mesh has {n} vertices and {} normals", mesh.normals.len())));
    }
    if let Some(t) = mesh.triangles.iter().position(|t| t.iter().any(|&v| v as usize >= n)) {
        return Err(input_error(format!("triangle {t} of the mesh names a vertex beyond the {n} there are")));
    }
    let unsound =
        |i: &usize| !mesh.vertices[*i].coords.iter().chain(mesh.normals[*i].iter()).all(|v| v.is_finite());
    if let Some(i) = (0..n).find(unsound) {
        return Err(input_error(format!("vertex {i} of the mesh is not finite")));
    }
    Ok(())
}

fn validate_samples(samples: &SurfaceSamples) -> Result<(), StageError> {
    let n = samples.len();
    if n == 0 {
        return Err(input_error("there are no samples to analyse"));
    }
    for (name, len) in [
        ("normals", samples.normals.len()),
        ("largest curvatures", samples.curvature_max.len()),
        ("curvature directions", samples.direction_max.len()),
    ] {
        if len != n {
            return Err(input_error(format!("{n} samples came with {len} {name}, expected as many")));
        }
    }
    let sound = |i: usize| {
        samples.points[i].coords.iter().all(|v| v.is_finite())
            && (samples.normals[i].norm() - 1.0).abs() < 1e-6
            && samples.curvature_max[i].is_finite()
            && samples.direction_max[i].iter().all(|v| v.is_finite())
    };
    match (0..n).find(|&i| !sound(i)) {
        Some(i) => Err(input_error(format!(
            "sample {i} is unsound: expected finite numbers and a normal of length 1"
        ))),
        None => Ok(()),
    }
}

/// The radius of the tool's own shadow, m.
fn validate_shadow(job: &Job, params: &AnalysisParams) -> Result<f64, StageError> {
    let cutter = job.tool.cutter;
    let fail = |text: String| Err(StageError::new(CODE_PARAMETERS, text));
    let radius = shadow_radius(&cutter);
    let whole = params.shadow == ShadowKind::Exact && params.shadow_factor == 0.0;
    let reach = if whole { radius } else { params.shadow_factor * radius };
    if !(cutter.r1 >= 0.0 && cutter.r2 >= 0.0 && reach > 0.0 && reach.is_finite()) {
        return fail(format!(
            "a tool of r1={:.3} r2={:.3} mm and shadow factor {} makes no shadow: expected a tool radius and \
             factor above 0 (0, the whole part, with the exact shadow only)",
            cutter.r1 * 1e3,
            cutter.r2 * 1e3,
            params.shadow_factor
        ));
    }
    let circles = params.shadow == ShadowKind::Circles;
    if circles && (params.shadow_circles == 0 || params.points_per_circle < 3) {
        return fail(format!(
            "{} shadow circles of {} points are too few: expected at least 1 of 3",
            params.shadow_circles, params.points_per_circle
        ));
    }
    Ok(radius)
}

fn validate_field(samples: &SurfaceSamples, field: &RollingBallField) -> Result<(), StageError> {
    let (n, m) = (samples.len(), field.pseudo_curvature.len());
    if n == 0 {
        return Err(input_error("there are no samples"));
    }
    if n != m {
        return Err(input_error(format!("{n} samples came with a field of {m} values, expected as many")));
    }
    match field.pseudo_curvature.iter().position(|k| !k.is_finite()) {
        Some(i) => Err(input_error(format!("the pseudo-curvature of sample {i} is not a finite number"))),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests;
