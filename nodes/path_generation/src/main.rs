//! The executable `path_generation`.

use patchmill_node_runtime::{run_node, topics};
use patchmill_path_generation::node;

/// glibc keeps several times what a process with many threads has in use (nodes/node_runtime/README.md).
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> std::process::ExitCode {
    run_node(topics::nodes::PATH_GENERATION, node::parameters(), node::start)
}
