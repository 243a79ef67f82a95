//! Replay: recorded inputs are fed into live nodes and what these give is compared with what was recorded.

pub mod compare;
pub mod feed;
pub mod live;
pub mod recorded;
pub mod report;
pub mod tolerances;

use std::collections::BTreeMap;

use patchmill_geometry::mesh::TriangleMesh;
use patchmill_msgs::msg::MachineModel;
use patchmill_node_runtime::topics;
use patchmill_products::evaluation::{Evaluation, ResidualMap};
use patchmill_products::field::RollingBallField;
use patchmill_products::partition::Partition;
use patchmill_products::program::{JointMotion, Program};
use patchmill_products::samples::SurfaceSamples;
use patchmill_products::toolpath::CandidateToolpath;

/// Everything that one run of a job gave, recorded or live.
#[derive(Clone, Debug, Default)]
pub struct RunProducts {
    /// The surface's content hash, where the surface was loaded.
    pub surface_id: Option<String>,
    /// Of surface_ingestion.
    pub mesh: Option<TriangleMesh>,
    /// Of surface_ingestion.
    pub samples: Option<SurfaceSamples>,
    /// Of rolling_ball_analysis.
    pub field: Option<RollingBallField>,
    /// Of surface_partitioning, by index.
    pub partitions: BTreeMap<u32, Partition>,
    /// Of path_generation, by index.
    pub toolpaths: BTreeMap<u32, CandidateToolpath>,
    /// Of machine_interface.
    pub evaluation: Option<Evaluation>,
    /// Of machine_interface.
    pub program: Option<Program>,
    /// Of machine_interface.
    pub motion: Option<JointMotion>,
    /// Of machine_interface.
    pub residual: Option<ResidualMap>,
    /// Of machine_interface, the last one.
    pub machine: Option<MachineModel>,
    /// Of machine_interface, the last one.
    pub robot_description: Option<String>,
    /// How the stages ended, by name.
    pub ends: BTreeMap<String, StageEnd>,
}

/// How a stage ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StageEnd {
    /// Whether its products are out.
    pub done: bool,
    /// The error's code; 0 when done.
    pub code: i32,
    /// The error; empty when done.
    pub failure: String,
}

/// The stages from one on, in the order of the data flow.
pub fn stages_from(first: &str) -> Vec<&'static str> {
    topics::nodes::STAGES.into_iter().skip_while(|stage| *stage != first).collect()
}

impl RunProducts {
    /// Keeps only what the stages from one on give.
    #[must_use]
    pub fn of_stages_from(mut self, first: &str) -> Self {
        use topics::nodes;
        let stages = stages_from(first);
        let kept = |stage: &str| stages.contains(&stage);
        if !kept(nodes::SURFACE_INGESTION) {
            (self.surface_id, self.mesh, self.samples) = (None, None, None);
        }
        if !kept(nodes::ROLLING_BALL_ANALYSIS) {
            self.field = None;
        }
        if !kept(nodes::SURFACE_PARTITIONING) {
            self.partitions.clear();
        }
        if !kept(nodes::PATH_GENERATION) {
            self.toolpaths.clear();
        }
        self.ends.retain(|stage, _| kept(stage));
        self
    }

    /// The products that are there, by topic and, where there are several, index.
    pub fn names(&self) -> Vec<String> {
        use tolerances::{
            EVALUATION, FIELD, MACHINE, MESH, MOTION, PARTITION, PROGRAM, RESIDUAL, ROBOT_DESCRIPTION,
            SAMPLES, STATUS, TOOLPATH,
        };
        let single = [
            (MESH, self.mesh.is_some()),
            (SAMPLES, self.samples.is_some()),
            (FIELD, self.field.is_some()),
            (EVALUATION, self.evaluation.is_some()),
            (PROGRAM, self.program.is_some()),
            (MOTION, self.motion.is_some()),
            (RESIDUAL, self.residual.is_some()),
            (MACHINE, self.machine.is_some()),
            (ROBOT_DESCRIPTION, self.robot_description.is_some()),
        ];
        let mut names: Vec<String> =
            single.into_iter().filter(|(_, there)| *there).map(|(name, _)| name.to_owned()).collect();
        names.extend(self.partitions.keys().map(|index| format!("{PARTITION} {index}")));
        names.extend(self.toolpaths.keys().map(|index| format!("{TOOLPATH} {index}")));
        names.extend(self.ends.keys().map(|stage| format!("{STATUS} of {stage}")));
        names
    }
}
