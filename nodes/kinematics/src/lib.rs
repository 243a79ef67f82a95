//! Five-axis machines described by URDF: forward and inverse kinematics, limits, and the time of a path.
//! No ROS, no I/O: the URDF comes as text.
//!
//! Any serial arrangement of three linear and two rotary axes is solved from its chain alone (table-table,
//! head-table, head-head, nutating axes, tilted mounts). Metres, radians, seconds. Joint vectors are [`Joints`]:
//! X, Y, Z, then the two rotary axes in the order of [`Machine::axes`].

mod axis;
mod chain;
mod collision_meshes;
mod error;
mod inverse;
mod mount;
mod time;
mod tool_tip;
mod urdf_text;

#[cfg(test)]
mod random_chains;

pub use axis::{Accelerations, Axis, AxisKind, Joints};
pub use chain::{Machine, Pose};
pub use collision_meshes::{Facets, collision_meshes, missing_collision_meshes, with_collision_mesh};
pub use error::{KinematicsError, LimitViolation};
pub use inverse::{FixedOrientation, Orientation, Solution};
pub use mount::{Mount, mount_of, with_mount};
pub use time::{AxisLimits, Control, LookAhead, PathPoint, Run, RunTiming, feed_run, rapid_run};
pub use tool_tip::with_tool_tip;
pub use urdf_text::robot_of;
