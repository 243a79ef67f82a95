//! The executable `visualization`.

use patchmill_node_runtime::{run_node, topics};
use patchmill_visualization::node;

fn main() -> std::process::ExitCode {
    run_node(topics::nodes::VISUALIZATION, node::parameters(), node::start)
}
