//! The executable `surface_ingestion`.

use patchmill_node_runtime::{run_node, topics};
use patchmill_surface_ingestion::node;

/// glibc keeps several times what a process with many threads has in use (nodes/node_runtime/README.md).
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> std::process::ExitCode {
    run_node(topics::nodes::SURFACE_INGESTION, node::parameters(), node::start)
}
