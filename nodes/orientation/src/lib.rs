//! Tool axis and feed direction of a patch, the step-over they allow, the curves of its passes and the time they take: what surface_partitioning reckons
//! with and path_generation decides. Pure: no ROS, no I/O.
//!
//! SI units, `workpiece` frame, curvature positive where concave as seen from the tool side.

pub mod axis_search;
pub mod cloud_point;
pub mod orientation;
pub mod pass_curves;
pub mod step_over;
mod timed_points;
