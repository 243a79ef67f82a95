//! Every topic of a run with its type and quality of service, once: for those who want them all, as the recorder and the live view do.

use patchmill_geometry::mesh::TriangleMesh;
use patchmill_msgs::RosType;
use patchmill_msgs::geometry_msgs::msg::PoseStamped;
use patchmill_msgs::msg::{Evaluation, Job, MachineModel, PartitionCandidate, StageStatus};
use patchmill_msgs::sensor_msgs::msg::{JointState, PointCloud2};
use patchmill_msgs::std_msgs;
use patchmill_msgs::tf2_msgs::msg::TFMessage;
use patchmill_msgs::trajectory_msgs::msg::JointTrajectory;
use patchmill_msgs::visualization_msgs::msg::MarkerArray;
use patchmill_products::evaluation::ResidualMap;
use patchmill_products::field::RollingBallField;
use patchmill_products::program::{JointMotion, Program};
use patchmill_products::samples::SurfaceSamples;
use patchmill_products::toolpath::CandidateToolpath;

use crate::{LargeProduct, Qos, RuntimeError, topics};

/// What is done with the topics of a run.
pub trait TopicVisitor {
    /// A topic whose messages stand for themselves.
    ///
    /// # Errors
    /// The visitor's own; they end the visit.
    fn topic<T: RosType>(&mut self, name: &str, qos: Qos) -> Result<(), RuntimeError>;

    /// A product that travels as manifest and chunks.
    ///
    /// # Errors
    /// As [`TopicVisitor::topic`].
    fn product<P: LargeProduct>(&mut self) -> Result<(), RuntimeError>;
}

/// Shows a visitor everything that a bag of a run holds.
///
/// # Errors
/// The visitor's first one.
pub fn visit_topics(visitor: &mut impl TopicVisitor) -> Result<(), RuntimeError> {
    visitor.topic::<Job>(topics::JOB, Qos::Status)?;
    visitor.topic::<PartitionCandidate>(topics::PARTITION_CANDIDATES, Qos::Product)?;
    visitor.topic::<Evaluation>(topics::EVALUATION, Qos::Status)?;
    visitor.topic::<MachineModel>(topics::MACHINE_MODEL, Qos::Status)?;
    visitor.topic::<JointTrajectory>(topics::TRAJECTORY, Qos::Series)?;
    visitor.topic::<PoseStamped>(topics::TOOL_POSE, Qos::Stream)?;
    visitor.topic::<JointState>(topics::JOINT_STATES, Qos::Stream)?;
    visitor.topic::<std_msgs::msg::String>(topics::ROBOT_DESCRIPTION, Qos::Status)?;
    visitor.topic::<TFMessage>(topics::TF, Qos::Stream)?;
    visitor.topic::<TFMessage>(topics::TF_STATIC, Qos::Status)?;
    for stage in topics::nodes::STAGES {
        visitor.topic::<StageStatus>(&topics::status(stage), Qos::Status)?;
    }
    for topic in [
        topics::VISUALIZATION_PATCHES,
        topics::VISUALIZATION_PASSES,
        topics::VISUALIZATION_TOOL_AXES,
        topics::VISUALIZATION_TOOL,
    ] {
        visitor.topic::<MarkerArray>(topic, Qos::Series)?;
    }
    visitor.topic::<PointCloud2>(topics::ROLLING_BALL_RADIUS, Qos::Status)?;
    visitor.topic::<PointCloud2>(topics::VISUALIZATION_RESIDUAL, Qos::Status)?;
    visitor.product::<TriangleMesh>()?;
    visitor.product::<SurfaceSamples>()?;
    visitor.product::<RollingBallField>()?;
    visitor.product::<CandidateToolpath>()?;
    visitor.product::<Program>()?;
    visitor.product::<JointMotion>()?;
    visitor.product::<ResidualMap>()
}
