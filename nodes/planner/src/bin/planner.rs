//! The executable `planner`.

use patchmill_node_runtime::{run_node, topics};
use patchmill_planner::node;

fn main() -> std::process::ExitCode {
    run_node(topics::nodes::PLANNER, node::parameters(), node::start)
}
