//! The executable `machine_interface`.

use patchmill_machine_interface::node;
use patchmill_node_runtime::{run_node, topics};

/// glibc keeps several times what a process with many threads has in use (nodes/node_runtime/README.md).
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> std::process::ExitCode {
    run_node(topics::nodes::MACHINE_INTERFACE, node::parameters(), node::start)
}
