//! The executable `live_view`.

use patchmill_live_view::node;
use patchmill_node_runtime::{run_async_node, topics};

/// glibc keeps several times what a process with many threads has in use (nodes/node_runtime/README.md).
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> std::process::ExitCode {
    run_async_node(topics::nodes::LIVE_VIEW, node::parameters(), node::start)
}
