//! What flows between the stages, as plain data: job, samples, rolling-ball field, partition, toolpath,
//! evaluation, program; and (in `wire`) their messages. No ROS, no I/O, no algorithms.
//!
//! SI units, `workpiece` frame, curvature positive where concave as seen from the tool side.

pub mod evaluation;
pub mod field;
pub mod job;
pub mod partition;
pub mod program;
pub mod samples;
pub mod selection;
pub mod stage;
pub mod tool;
pub mod toolpath;
pub mod wire;
