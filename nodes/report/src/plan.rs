//! What a report is made from.

use patchmill_geometry::mesh::TriangleMesh;
use patchmill_products::evaluation::{Evaluation, ResidualMap};
use patchmill_products::field::RollingBallField;
use patchmill_products::job::Job;
use patchmill_products::partition::Partition;
use patchmill_products::program::{JointMotion, Program};
use patchmill_products::samples::SurfaceSamples;
use patchmill_products::toolpath::CandidateToolpath;

/// A finished plan: its products and how it was called. SI units, `workpiece` frame.
#[derive(Clone, Debug)]
pub struct Plan {
    /// Surface file as it was named.
    pub surface: String,
    /// Version of patchmill that planned.
    pub version: String,
    /// Planning strategy, as on the command line.
    pub strategy: String,
    /// Pass pattern, as on the command line.
    pub pattern: String,
    /// The job.
    pub job: Job,
    /// The surface.
    pub mesh: TriangleMesh,
    /// Its samples.
    pub samples: SurfaceSamples,
    /// Their rolling-ball field.
    pub field: RollingBallField,
    /// The chosen partition.
    pub partition: Partition,
    /// The chosen toolpath.
    pub toolpath: CandidateToolpath,
    /// All candidates and the choice.
    pub evaluation: Evaluation,
    /// The program.
    pub program: Program,
    /// sha256 of the program's text, hex digits.
    pub program_sha256: String,
    /// Its motion.
    pub motion: JointMotion,
    /// What it leaves.
    pub residual: ResidualMap,
    /// Larger tools that cannot make the surface.
    pub refused: Vec<Refused>,
    /// What else a reader has to know, a sentence each.
    pub notes: Vec<String>,
}

/// A tool that cannot make the surface.
#[derive(Clone, Debug)]
pub struct Refused {
    /// Axis to corner centre, m.
    pub r1: f64,
    /// Corner radius, m.
    pub r2: f64,
    /// Why not.
    pub reason: String,
}
