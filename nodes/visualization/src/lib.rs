//! The plan as shapes and points to look at: patches, passes, tool axes, rolling-ball radius, tool. Pure but for `node`.
//!
//! SI units, `workpiece` frame but for the tool, which is in the frame of its tip.

pub mod axes;
pub mod cloud;
pub mod colours;
pub mod node;
pub mod passes;
pub mod patches;
pub mod radius_cloud;
pub mod residual_cloud;
pub mod shape;
pub mod simplify;
pub mod tool;
