//! The executable `bag_recorder`: records until interrupted or until the disk refuses.

use patchmill_bag_recorder::{Recorder, recorder};
use patchmill_node_runtime::{Arguments, NodeOptions, block_on, interrupted, say_on_stderr, topics};

/// glibc keeps several times what a process with many threads has in use (nodes/node_runtime/README.md).
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

const NAME: &str = topics::nodes::BAG_RECORDER;

async fn record() -> Result<(), String> {
    let arguments = Arguments::from_process(NAME).map_err(|e| e.to_string())?;
    if let Some(unknown) = arguments.rest.first() {
        return Err(format!("unknown argument '{unknown}': see --help"));
    }
    let interrupted = interrupted();
    let recorder = Recorder::start(NodeOptions { arguments, parameters: recorder::parameters() })
        .map_err(|e| e.to_string())?;
    tokio::select! {
        () = interrupted => {}
        _ = recorder.failed() => {}
    }
    recorder.finish().await.map(|_| ()).map_err(|e| e.to_string())
}

fn main() -> std::process::ExitCode {
    if std::env::args().any(|a| a == "--help" || a == "-h") {
        let table = recorder::parameters().table();
        say_on_stderr(format_args!("{NAME} [--ros-args -p name:=value …]\nparameters:\n{table}"));
        return std::process::ExitCode::SUCCESS;
    }
    match block_on(record()).map_err(|e| e.to_string()).and_then(|done| done) {
        Ok(()) => std::process::ExitCode::SUCCESS,
        Err(text) => {
            say_on_stderr(format_args!("{NAME}: {text}"));
            std::process::ExitCode::FAILURE
        }
    }
}
