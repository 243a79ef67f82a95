//! The executable `surface_ingestion`.

use patchmill_node_runtime::{run_node, topics};
use patchmill_surface_ingestion::node;

fn main() -> std::process::ExitCode {
    run_node(topics::nodes::SURFACE_INGESTION, node::parameters(), node::start)
}
