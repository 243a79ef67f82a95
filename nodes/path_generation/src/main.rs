//! The executable `path_generation`.

use patchmill_node_runtime::{run_node, topics};
use patchmill_path_generation::node;

fn main() -> std::process::ExitCode {
    run_node(topics::nodes::PATH_GENERATION, node::parameters(), node::start)
}
