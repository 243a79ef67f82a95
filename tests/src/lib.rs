//! The stages run one after the other in this process, without ROS: what the nodes over DDS are compared with.

pub mod altered_bag;
pub mod bowl;
pub mod brute_check;
pub mod children;
pub mod controller;
pub mod executables;
pub mod fuzz;
pub mod golden;
pub mod markdown;
pub mod processes;
pub mod spoilt;
pub mod two_hosts;
pub mod viewer;

use std::path::Path;

use patchmill_path_generation::{PathParams, PreparedSurface, plan_candidate};
use patchmill_products::field::RollingBallField;
use patchmill_products::job::Job;
use patchmill_products::partition::Partition;
use patchmill_products::selection::Selection;
use patchmill_products::stage::{Progress, StageError, unobserved};
use patchmill_products::toolpath::CandidateToolpath;
use patchmill_rolling_ball_analysis::{AnalysisParams, analyse, check_tool_fits};
use patchmill_surface_ingestion::{IngestedSurface, IngestionParams, SurfaceSource, ingest, read_source};
use patchmill_surface_partitioning::{PartitionParams, partition};

/// Everything before the machine.
pub struct Planned {
    /// The job with its ids.
    pub job: Job,
    /// The surface.
    pub surface: IngestedSurface,
    /// The rolling-ball field.
    pub field: RollingBallField,
    /// The candidate partitions.
    pub partitions: Vec<Partition>,
    /// Their toolpaths.
    pub toolpaths: Vec<CandidateToolpath>,
}

/// Plans a surface file up to the toolpaths; `job` without ids.
///
/// # Errors
/// Of the stage that fails.
pub fn plan(file: &Path, job: Job) -> Result<Planned, StageError> {
    plan_selected(file, Selection::default(), job)
}

/// The same of a part of the surface.
///
/// # Errors
/// Of the stage that fails.
pub fn plan_selected(file: &Path, selection: Selection, job: Job) -> Result<Planned, StageError> {
    let folder = file.parent().unwrap_or(Path::new("."));
    let name = file.file_name().unwrap_or_default().to_string_lossy();
    let source = read_source(folder, &name, "")?;
    plan_source(&source, &IngestionParams { selection, ..IngestionParams::default() }, job, unobserved())
}

/// Plans a surface that is not yet read up to the toolpaths.
///
/// # Errors
/// Of the stage that fails.
pub fn plan_source(
    source: &SurfaceSource,
    params: &IngestionParams,
    job: Job,
    progress: Progress<'_>,
) -> Result<Planned, StageError> {
    let surface = ingest(source, params, progress)?;
    let job = Job { surface_id: surface.surface_id.clone(), ..job };
    let (mesh, samples) = (&surface.mesh, &surface.samples);
    let field = analyse(mesh, samples, &job, &AnalysisParams::default(), progress)?;
    check_tool_fits(samples, &field, &job)?;
    let partitions = partition(samples, &field, &job, &PartitionParams::default(), progress)?;
    let params = PathParams::default();
    let shared = std::sync::Arc::new(mesh.clone());
    let prepared = PreparedSurface::new(shared, samples, &field, &job, &params, progress)?;
    let toolpaths = partitions
        .iter()
        .map(|partition| plan_candidate(&prepared, partition, &job, &params, progress))
        .collect::<Result<_, _>>()?;
    Ok(Planned { job, surface, field, partitions, toolpaths })
}

/// A file of `tests/fixtures`.
pub fn fixture(name: &str) -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures").join(name)
}
