//! The executable `planner`.

use patchmill_node_runtime::{run_node, topics};
use patchmill_planner::node;

/// glibc keeps several times what a process with many threads has in use (nodes/node_runtime/README.md).
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> std::process::ExitCode {
    run_node(topics::nodes::PLANNER, node::parameters(), node::start)
}
