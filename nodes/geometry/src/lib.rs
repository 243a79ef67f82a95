//! Surfaces, meshes, cutters and the exact kernels between them: no ROS, no I/O.
//!
//! All lengths are metres, all angles radians, all coordinates in the `workpiece` frame unless a name says
//! otherwise. Curvature is positive where the surface is concave as seen from the tool side.

pub mod box_query;
pub mod bvh;
mod contact_tree;
pub mod curvature;
pub mod cut_stretches;
pub mod cutter;
pub mod drop_cutter;
mod drop_facet;
mod edge_contact;
pub mod extent;
pub mod mesh;
mod mesh_edges;
pub mod mesh_topology;
pub mod point_grid;
pub mod proof_points;
pub mod ray_cast;
pub mod rolling_ball;
mod split_tree;
pub mod surface_points;
pub mod sweep;
#[cfg(test)]
mod test_meshes;
pub mod tool_stack;
