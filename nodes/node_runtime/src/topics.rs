//! The names under `/patchmill`, once. Messages: [`patchmill_msgs`]; large products: [`crate::products`].

/// `patchmill_msgs/msg/Job`, latched.
pub const JOB: &str = "job";
/// `patchmill_msgs/msg/PartitionCandidate`, latched, one message a candidate.
pub const PARTITION_CANDIDATES: &str = "partition/candidates";
/// `patchmill_msgs/msg/Evaluation`, latched.
pub const EVALUATION: &str = "machine/evaluation";
/// `patchmill_msgs/msg/MachineModel`, latched.
pub const MACHINE_MODEL: &str = "machine/model";
/// `trajectory_msgs/msg/JointTrajectory`, a latched series: the program in parts, one goal of a joint trajectory controller.
pub const TRAJECTORY: &str = "machine/trajectory";
/// `geometry_msgs/msg/PoseStamped` of the tool tip in `workpiece`, z along the tool axis.
pub const TOOL_POSE: &str = "machine/tool_pose";
/// `sensor_msgs/msg/JointState`.
pub const JOINT_STATES: &str = "joint_states";
/// `std_msgs/msg/String`, latched.
pub const ROBOT_DESCRIPTION: &str = "robot_description";
/// `diagnostic_msgs/msg/DiagnosticArray`: signs of life of every stage; absolute, as everywhere in ROS.
pub const DIAGNOSTICS: &str = "/diagnostics";
/// `tf2_msgs/msg/TFMessage`; absolute, as everywhere in ROS.
pub const TF: &str = "/tf";
/// `tf2_msgs/msg/TFMessage`, latched; absolute.
pub const TF_STATIC: &str = "/tf_static";

/// `visualization_msgs/msg/MarkerArray`, a latched series: the mesh, a colour a patch.
pub const VISUALIZATION_PATCHES: &str = "visualization/patches";
/// `visualization_msgs/msg/MarkerArray`, a latched series: the passes' contact points.
pub const VISUALIZATION_PASSES: &str = "visualization/passes";
/// `visualization_msgs/msg/MarkerArray`, a latched series: tool axis, feed direction and number of every patch.
pub const VISUALIZATION_TOOL_AXES: &str = "visualization/tool_axes";
/// `visualization_msgs/msg/MarkerArray`, a latched series: the tool in the frame of its tip.
pub const VISUALIZATION_TOOL: &str = "visualization/tool";
/// `sensor_msgs/msg/PointCloud2`, latched: the samples with their rolling-ball radius.
pub const ROLLING_BALL_RADIUS: &str = "visualization/rolling_ball_radius";
/// `sensor_msgs/msg/PointCloud2`, latched: what the chosen program leaves, by its swept check.
pub const VISUALIZATION_RESIDUAL: &str = "visualization/residual";

/// `sensor_msgs/msg/PointCloud2`, taken by surface_ingestion: the newest one can be loaded as a surface.
pub const CLOUD: &str = "surface_ingestion/points";

/// Service `patchmill_msgs/srv/LoadSurface`.
pub const LOAD_SURFACE: &str = "surface_ingestion/load_surface";
/// Service `patchmill_msgs/srv/SolvePose`.
pub const SOLVE_POSE: &str = "machine/solve_pose";
/// Service `patchmill_msgs/srv/LoadProgram`.
pub const LOAD_PROGRAM: &str = "machine/load_program";
/// Service `patchmill_msgs/srv/ControlProgram`: stops the feed of the program that runs.
pub const HOLD_PROGRAM: &str = "machine/hold";
/// Service `patchmill_msgs/srv/ControlProgram`: continues it.
pub const RESUME_PROGRAM: &str = "machine/resume";
/// Action `patchmill_msgs/action/ExecuteProgram`.
pub const EXECUTE_PROGRAM: &str = "machine/execute_program";
/// Action `patchmill_msgs/action/PlanSurface`.
pub const PLAN_SURFACE: &str = "plan_surface";

/// Names of the nodes, in the order of the data flow.
pub mod nodes {
    /// Loads surfaces.
    pub const SURFACE_INGESTION: &str = "surface_ingestion";
    /// Computes the rolling-ball field.
    pub const ROLLING_BALL_ANALYSIS: &str = "rolling_ball_analysis";
    /// Computes candidate partitions.
    pub const SURFACE_PARTITIONING: &str = "surface_partitioning";
    /// Computes toolpaths.
    pub const PATH_GENERATION: &str = "path_generation";
    /// Evaluates, chooses, writes the program.
    pub const MACHINE_INTERFACE: &str = "machine_interface";
    /// Draws the plan.
    pub const VISUALIZATION: &str = "visualization";
    /// The front.
    pub const PLANNER: &str = "planner";
    /// Records everything.
    pub const BAG_RECORDER: &str = "bag_recorder";
    /// Gives everything to Foxglove.
    pub const LIVE_VIEW: &str = "live_view";
    /// Nodes that publish a status.
    pub const STAGES: [&str; 5] =
        [SURFACE_INGESTION, ROLLING_BALL_ANALYSIS, SURFACE_PARTITIONING, PATH_GENERATION, MACHINE_INTERFACE];
}

/// `patchmill_msgs/msg/StageStatus` of a node, latched.
pub fn status(node: &str) -> String {
    format!("{node}/status")
}

/// Service `patchmill_msgs/srv/Recompute` of a stage.
pub fn recompute(node: &str) -> String {
    format!("{node}/recompute")
}
