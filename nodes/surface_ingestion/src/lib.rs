//! The first stage: a surface file or an inline surface in, a mesh within a chord tolerance and samples with exact normals and
//! curvature out.
//!
//! Read top-down: [`read_source`] (the only I/O) → [`ingest`] → [`surface_file`] ([`bezier`], [`nurbs`] with [`knots`], [`algebraic`] with [`expression`] and
//! [`jet`]) → [`tessellate`], [`grid_samples`]; or [`read_raw`] ([`stl`], [`ply`], [`obj`], [`three_mf`], [`xyz`], [`pcd`]) →
//! [`mesh_surface`] ([`weld`], [`orient`]), of points [`cloud`] → [`mesh_samples`].
//! [`step`] gives meshes with the surfaces' own normals. Everything leaves in metres in the `workpiece` frame; the +Z side of the surface is the tool side.

pub mod algebraic;
pub mod bezier;
pub mod cloud;
pub mod crease_split;
pub mod error_code;
pub mod expression;
mod fast_hasher;
pub mod finish_mask;
pub mod grid_samples;
pub mod jet;
pub mod knots;
pub mod lzf;
pub mod mesh_samples;
pub mod mesh_surface;
pub mod node;
pub mod nurbs;
pub mod obj;
pub mod orient;
pub mod parametric;
pub mod pcd;
pub mod ply;
pub mod point_cloud2;
pub mod polygon;
pub mod raw;
pub mod rest_area;
pub mod scalar;
pub mod share_vertices;
mod site;
pub mod source;
pub mod step;
pub mod stl;
pub mod surface_file;
pub mod tessellate;
pub mod text;
pub mod three_mf;
pub mod units;
pub mod weld;
pub mod xyz;

use nalgebra::Point3;
use patchmill_geometry::extent::Extent;
use patchmill_geometry::mesh::TriangleMesh;
use patchmill_products::samples::SurfaceSamples;
use patchmill_products::selection::Selection;
use patchmill_products::stage::{Progress, StageError};
use rayon::prelude::*;
use sha2::{Digest, Sha256};

use cloud::{CloudParams, CloudReport};
use raw::{Limits, Raw, RawCloud};

pub use source::{SourceKind, SurfaceSource, read_source};

/// Part of every surface id: changes when the same file would give another mesh or other samples.
const VERSION_TAG: &str = "patchmill surface 1";

/// Smallest diagonal of a surface's bounding box, m: less is below what tools and programs can tell apart.
const SMALLEST: f64 = 10e-6;

/// How a surface is read.
#[derive(Clone, Debug, PartialEq)]
pub struct IngestionParams {
    /// Largest distance between a facet and an analytic surface, m, > 0.
    pub chord_tolerance: f64,
    /// Samples along each side of the grid, 2 to 1000; of a mesh about its square in all.
    pub samples_per_side: u32,
    /// Most triangles of a mesh.
    pub max_triangles: usize,
    /// Most points of a point cloud.
    pub max_points: usize,
    /// How point clouds are read.
    pub cloud: CloudParams,
    /// Which facets are to be finished.
    pub selection: Selection,
}

impl Default for IngestionParams {
    fn default() -> Self {
        Self {
            chord_tolerance: 0.5e-6,
            samples_per_side: 50,
            max_triangles: 8_000_000,
            max_points: 4_000_000,
            cloud: CloudParams { noise_tolerance: 50e-6, bridge_holes: 0.0 },
            selection: Selection::default(),
        }
    }
}

impl IngestionParams {
    /// Whether every parameter is in its range.
    ///
    /// # Errors
    /// Naming the parameter, its value and its range.
    pub fn validate(&self) -> Result<(), StageError> {
        let bad = |text: String| Err(StageError::new(error_code::BAD_PARAMETER, text));
        if !(1e-9..=1e-3).contains(&self.chord_tolerance) {
            return bad(format!(
                "chord_tolerance is {} mm; 0.000001 mm to 1 mm was expected",
                self.chord_tolerance * 1e3
            ));
        }
        if !(2..=1000).contains(&self.samples_per_side) {
            return bad(format!("samples_per_side is {}; 2 to 1000 was expected", self.samples_per_side));
        }
        if !(2..=100_000_000).contains(&self.max_triangles) {
            return bad(format!("max_triangles is {}; 2 to 100000000 was expected", self.max_triangles));
        }
        if !(30..=50_000_000).contains(&self.max_points) {
            return bad(format!("max_points is {}; 30 to 50000000 was expected", self.max_points));
        }
        let CloudParams { noise_tolerance, bridge_holes } = self.cloud;
        if !(1e-7..=0.01).contains(&noise_tolerance) {
            return bad(format!(
                "noise_tolerance is {} mm; 0.0001 mm to 10 mm was expected",
                noise_tolerance * 1e3
            ));
        }
        if !(0.0..=1.0).contains(&bridge_holes) {
            return bad(format!("bridge_holes is {} mm; 0 mm to 1000 mm was expected", bridge_holes * 1e3));
        }
        Ok(())
    }
}

/// What the stage gives.
#[derive(Clone, Debug, PartialEq)]
pub struct IngestedSurface {
    /// Content hash of the source and of the parameters that shape the result: 16 hex digits.
    pub surface_id: String,
    /// The surface as triangles.
    pub mesh: TriangleMesh,
    /// Samples of the surface.
    pub samples: SurfaceSamples,
    /// Whether normals and curvature are exact (analytic) or fitted (meshes, point clouds).
    pub analytic: bool,
    /// Facets of a mesh dropped for having no area.
    pub degenerate_dropped: u32,
    /// Facets of a mesh dropped for repeating an earlier one.
    pub duplicate_dropped: u32,
    /// Facets of a mesh whose winding was reversed.
    pub reversed: u32,
    /// Edges of a mesh that more than two facets share.
    pub non_manifold_edges: u32,
    /// Connected parts of the surface.
    pub parts: u32,
    /// Vertices of a mesh on sharp edges, where the surface is not smooth.
    pub sharp_vertices: u32,
    /// What was found in a point cloud.
    pub cloud: Option<CloudReport>,
}

/// Reads a surface: the stage's pure function.
///
/// # Errors
/// Parameters out of range; content that is not a surface, is singular, needs too many triangles or is not orientable; cancellation.
pub fn ingest(
    source: &SurfaceSource,
    params: &IngestionParams,
    progress: Progress<'_>,
) -> Result<IngestedSurface, StageError> {
    params.validate()?;
    of_earlier_surface(&params.selection, &source.name, |params| surface_id(source, params), params)?;
    progress.check()?;
    let result = match source.kind {
        SourceKind::Json => ingest_analytic(source, params, progress),
        SourceKind::Step => ingest_step(source, params, progress),
        _ => {
            let raw = read_raw(source, params)?;
            ingest_raw(raw, surface_id(source, params), &source.name, params, progress)
        }
    }?;
    is_large_enough(&result.mesh, &source.name)?;
    (progress.report)(1.0);
    Ok(result)
}

/// Makes the surface of points that came otherwise than as a file, m; `name` is what errors call them.
///
/// # Errors
/// As [`ingest`].
pub fn ingest_points(
    cloud: RawCloud,
    name: &str,
    params: &IngestionParams,
    progress: Progress<'_>,
) -> Result<IngestedSurface, StageError> {
    params.validate()?;
    of_earlier_surface(&params.selection, name, |params| points_id(&cloud.points, params), params)?;
    progress.check()?;
    within_reach(&cloud.points)
        .map_err(|text| StageError::new(error_code::BAD_CONTENT, format!("{name}: {text}")))?;
    let id = points_id(&cloud.points, params);
    let surface = ingest_raw(Raw::Cloud(cloud), id, name, params, progress)?;
    is_large_enough(&surface.mesh, name)?;
    (progress.report)(1.0);
    Ok(surface)
}

/// Refuses a surface that is nothing to cut.
fn is_large_enough(mesh: &TriangleMesh, name: &str) -> Result<(), StageError> {
    let size = Extent::of(&mesh.vertices).map_or(0.0, |extent| extent.diagonal());
    if size >= SMALLEST {
        return Ok(());
    }
    Err(StageError::new(
        error_code::BAD_CONTENT,
        format!(
            "{name}: the surface measures {:.3e} mm across, at least {} mm were expected; is its unit right (--units)?",
            size * 1e3,
            SMALLEST * 1e3
        ),
    ))
}

/// Refuses what an earlier plan has left of another surface; `id` gives the content hash under some parameters.
fn of_earlier_surface(
    selection: &Selection,
    name: &str,
    id: impl Fn(&IngestionParams) -> String,
    params: &IngestionParams,
) -> Result<(), StageError> {
    let Some(rest) = &selection.rest else { return Ok(()) };
    let found = id(&IngestionParams { selection: selection.without_rest(), ..params.clone() });
    if found == rest.surface_id {
        return Ok(());
    }
    Err(StageError::new(
        error_code::BAD_SELECTION,
        format!(
            "{name}: what is left standing is that of the surface {}, this one is {found}; the earlier plan's file, units, selection \
             and parameters of surface_ingestion were expected",
            rest.surface_id
        ),
    ))
}

/// Content hash of a source under `params`: the first 16 hex digits of a SHA-256.
pub fn surface_id(source: &SurfaceSource, params: &IngestionParams) -> String {
    let kind = match source.kind {
        SourceKind::Json => 0,
        SourceKind::Stl => 1,
        SourceKind::Ply => 2,
        SourceKind::Obj => 3,
        SourceKind::ThreeMf => 4,
        SourceKind::Xyz => 5,
        SourceKind::Pcd => 6,
        SourceKind::Step => 8,
    };
    let may_be_cloud = matches!(source.kind, SourceKind::Ply | SourceKind::Xyz | SourceKind::Pcd);
    content_id(&source.units, &source.bytes, (kind, may_be_cloud), params)
}

/// [`surface_id`] of points without a file: of their coordinates alone, not of when and how they came.
fn points_id(points: &[Point3<f64>], params: &IngestionParams) -> String {
    let bytes: Vec<u8> = points.iter().flat_map(|p| p.iter().flat_map(|x| x.to_le_bytes())).collect();
    content_id("m", &bytes, (7, true), params)
}

fn content_id(
    units: &str,
    bytes: &[u8],
    (kind, may_be_cloud): (u8, bool),
    params: &IngestionParams,
) -> String {
    let mut hash = Sha256::new();
    // Lengths first, so that no two lists of fields give the same bytes.
    for field in [VERSION_TAG.as_bytes(), units.as_bytes(), bytes] {
        hash.update((field.len() as u64).to_le_bytes());
        hash.update(field);
    }
    hash.update([kind]);
    hash.update(params.chord_tolerance.to_le_bytes());
    hash.update(params.samples_per_side.to_le_bytes());
    if may_be_cloud {
        hash.update(params.cloud.noise_tolerance.to_le_bytes());
        hash.update(params.cloud.bridge_holes.to_le_bytes());
    }
    if !params.selection.is_all() {
        hash.update(params.selection.content_hash());
    }
    hash.finalize().iter().take(8).map(|byte| format!("{byte:02x}")).collect()
}

fn ingest_analytic(
    source: &SurfaceSource,
    params: &IngestionParams,
    progress: Progress<'_>,
) -> Result<IngestedSurface, StageError> {
    let surface = surface_file::parse(&source.bytes, &source.name, &source.units)?;
    let (selection, name) = (&params.selection.without_rest(), &source.name);
    let samples = grid_samples::grid_samples(surface.as_ref(), params.samples_per_side)?;
    let mut samples = finish_mask::selected_samples(samples, selection, name)?;
    if let Some(rest) = &params.selection.rest {
        let finer = rest_area::samples_per_side(&samples, rest, params.samples_per_side);
        let grid = grid_samples::grid_samples(surface.as_ref(), finer)?;
        let selected = finish_mask::selected_samples(grid, selection, name)?;
        samples = rest_area::samples_within(&selected, rest, name)?;
    }
    progress.check()?;
    let mut mesh =
        tessellate::tessellate(surface.as_ref(), params.chord_tolerance, params.max_triangles, progress)?;
    mesh.check_only = finish_mask::check_only(&mesh, None, selection, name)?;
    if let Some(rest) = &params.selection.rest {
        rest_area::restrict(&mut mesh, None, rest, name)?;
    }
    Ok(IngestedSurface {
        surface_id: surface_id(source, params),
        mesh,
        samples,
        analytic: true,
        degenerate_dropped: 0,
        duplicate_dropped: 0,
        reversed: 0,
        non_manifold_edges: 0,
        parts: 1,
        sharp_vertices: 0,
        cloud: None,
    })
}

fn ingest_step(
    source: &SurfaceSource,
    params: &IngestionParams,
    progress: Progress<'_>,
) -> Result<IngestedSurface, StageError> {
    let selection = params.selection.without_rest();
    let read = step::read(
        &source.bytes,
        &source.name,
        params.chord_tolerance,
        params.max_triangles,
        !selection.is_all(),
        progress,
    )?;
    let surface = mesh_surface::of_faces(read, &selection, &source.name)?;
    let id = surface_id(source, params);
    Ok(IngestedSurface { analytic: true, ..sampled(surface, id, &source.name, params, progress)? })
}

/// The triangles or points of a source that is neither JSON nor STEP, m.
///
/// # Errors
/// Content that is not what the source's kind says, or more of it than `params` allow; a vertex more than 1000 m from the origin.
pub fn read_raw(source: &SurfaceSource, params: &IngestionParams) -> Result<Raw, StageError> {
    let bad = |text: String| StageError::new(error_code::BAD_CONTENT, format!("{}: {text}", source.name));
    let limits = Limits { triangles: params.max_triangles, points: params.max_points };
    let unit = units::metres_per_unit(&source.units)?;
    let bytes = &source.bytes;
    let (mut raw, unit) = match source.kind {
        SourceKind::Json | SourceKind::Step => {
            return Err(bad("a mesh or points were expected, found JSON or STEP".to_owned()));
        }
        SourceKind::Stl => {
            let facets = stl::parse(bytes, &source.name, limits.triangles)?;
            (Raw::Mesh(share_vertices::share_vertices(&facets)), unit)
        }
        SourceKind::Ply => (ply::parse(bytes, &limits).map_err(bad)?, unit),
        SourceKind::Obj => (Raw::Mesh(obj::parse(bytes, &limits).map_err(bad)?), unit),
        SourceKind::ThreeMf => {
            let (mesh, own_unit) = three_mf::parse(bytes, &limits).map_err(bad)?;
            (Raw::Mesh(mesh), own_unit)
        }
        SourceKind::Xyz => (Raw::Cloud(xyz::parse(bytes, &limits).map_err(bad)?), unit),
        SourceKind::Pcd => (Raw::Cloud(pcd::parse(bytes, &limits).map_err(bad)?), unit),
    };
    let points = match &mut raw {
        Raw::Mesh(mesh) => &mut mesh.vertices,
        Raw::Cloud(cloud) => &mut cloud.points,
    };
    points.par_iter_mut().for_each(|p| p.coords *= unit);
    within_reach(points).map_err(bad)?;
    Ok(raw)
}

fn within_reach(points: &[Point3<f64>]) -> Result<(), String> {
    match points.par_iter().find_first(|p| p.coords.amax() > 1e3 || p.iter().any(|x| x.is_nan())) {
        Some(p) => {
            let far = p.coords.amax();
            let far = if far < 1e9 { format!("{far:.0}") } else { format!("{far:.1e}") };
            Err(format!("a vertex lies {far} m from the origin; at most 1000 m is allowed"))
        }
        None => Ok(()),
    }
}

fn ingest_raw(
    raw: Raw,
    surface_id: String,
    name: &str,
    params: &IngestionParams,
    progress: Progress<'_>,
) -> Result<IngestedSurface, StageError> {
    (progress.report)(0.1);
    let mut report = None;
    let selection = params.selection.without_rest();
    let surface = match raw {
        Raw::Mesh(mesh) => mesh_surface::mesh_surface(&mesh, &selection, name, progress)?,
        Raw::Cloud(points) => {
            let cloud = cloud::cloud_surface(points, &params.cloud, name, progress)?;
            report = Some(cloud.report);
            mesh_surface::of_cloud(cloud, &selection, name)?
        }
    };
    Ok(IngestedSurface { cloud: report, ..sampled(surface, surface_id, name, params, progress)? })
}

fn sampled(
    mut surface: mesh_surface::MeshSurface,
    surface_id: String,
    name: &str,
    params: &IngestionParams,
    progress: Progress<'_>,
) -> Result<IngestedSurface, StageError> {
    progress.check()?;
    (progress.report)(0.8);
    if let Some(rest) = &params.selection.rest {
        rest_area::restrict(&mut surface.mesh, Some(&mut surface.fit), rest, name)?;
    }
    let count = (params.samples_per_side * params.samples_per_side) as usize;
    let samples = mesh_samples::mesh_samples(&surface.mesh, &surface.fit, count, progress)?;
    Ok(IngestedSurface {
        surface_id,
        samples,
        analytic: false,
        degenerate_dropped: surface.dropped[0],
        duplicate_dropped: surface.dropped[1],
        reversed: surface.orientation.reversed,
        non_manifold_edges: surface.orientation.non_manifold_edges,
        parts: surface.orientation.parts,
        sharp_vertices: surface.fit.sharp.iter().filter(|s| **s).count() as u32,
        cloud: None,
        mesh: surface.mesh,
    })
}

#[cfg(test)]
mod reader_tests;
#[cfg(test)]
mod tests;
