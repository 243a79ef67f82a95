//! The executable `machine_interface`.

use patchmill_machine_interface::node;
use patchmill_node_runtime::{run_node, topics};

fn main() -> std::process::ExitCode {
    run_node(topics::nodes::MACHINE_INTERFACE, node::parameters(), node::start)
}
