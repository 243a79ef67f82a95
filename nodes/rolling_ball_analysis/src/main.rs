//! The executable `rolling_ball_analysis`.

use patchmill_node_runtime::{run_node, topics};
use patchmill_rolling_ball_analysis::node;

/// glibc keeps several times what a process with many threads has in use (nodes/node_runtime/README.md).
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> std::process::ExitCode {
    run_node(topics::nodes::ROLLING_BALL_ANALYSIS, node::parameters(), node::start)
}
