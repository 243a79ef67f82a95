//! The executable `rolling_ball_analysis`.

use patchmill_node_runtime::{run_node, topics};
use patchmill_rolling_ball_analysis::node;

fn main() -> std::process::ExitCode {
    run_node(topics::nodes::ROLLING_BALL_ANALYSIS, node::parameters(), node::start)
}
