//! The executable `live_view`.

use patchmill_live_view::node;
use patchmill_node_runtime::{run_async_node, topics};

fn main() -> std::process::ExitCode {
    run_async_node(topics::nodes::LIVE_VIEW, node::parameters(), node::start)
}
