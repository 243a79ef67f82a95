//! The executable `bag_recorder`: records until interrupted.

use patchmill_bag_recorder::{Recorder, recorder};
use patchmill_node_runtime::{Arguments, NodeOptions, block_on, interrupted, topics};

fn main() -> std::process::ExitCode {
    let run = async {
        let arguments = Arguments::from_process(topics::nodes::BAG_RECORDER).map_err(|e| e.to_string())?;
        let options = NodeOptions { arguments, parameters: recorder::parameters() };
        let recorder = Recorder::start(options).map_err(|e| e.to_string())?;
        interrupted().await;
        recorder.finish().await.map_err(|e| e.to_string())
    };
    match block_on(run).map_err(|e| e.to_string()).and_then(|r| r) {
        Ok(_) => std::process::ExitCode::SUCCESS,
        Err(text) => {
            eprintln!("{text}");
            std::process::ExitCode::FAILURE
        }
    }
}
