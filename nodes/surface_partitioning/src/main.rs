//! The executable `surface_partitioning`.

use patchmill_node_runtime::{run_node, topics};
use patchmill_surface_partitioning::node;

fn main() -> std::process::ExitCode {
    run_node(topics::nodes::SURFACE_PARTITIONING, node::parameters(), node::start)
}
