//! What every node stands on. The only crate that calls ros2-client: everything else sees plain message types
//! from `patchmill_msgs`, names relative to the namespace, and async Rust.
//!
//! One [`Node`] is one ROS context (own DDS participant), also where several live in one process: a shared one
//! loses large messages.

use std::process::ExitCode;

use tokio::signal::unix::{SignalKind, signal};

pub mod action;
pub mod arguments;
pub mod chunks;
pub mod domain;
pub mod error;
pub mod every_topic;
pub mod heartbeat;
pub mod latest;
pub mod log;
pub mod node;
mod open_files;
mod parameter_services;
pub mod parameters;
pub mod peers;
pub mod product_receiver;
pub mod product_server;
pub mod products;
pub mod qos;
pub mod recompute;
pub mod regular_file;
pub mod security;
pub mod series;
pub mod service;
pub mod stage_runner;
pub mod status;
pub mod topics;
pub mod whole_file;

pub use action::{ActionClient, ActionEnd, GoalContext};
pub use arguments::{Arguments, NodeOptions};
pub use chunks::ChunkPublisher;
pub use domain::{DomainLease, free_domain};
pub use error::RuntimeError;
pub use every_topic::{TopicVisitor, visit_topics};
pub use heartbeat::{Build, Heartbeat};
pub use latest::Latest;
pub use log::{Level, say_on_stderr};
pub use node::{Node, Publisher, Subscription, WAITING};
pub use parameters::{ParameterSet, Value};
pub use peers::{Peers, peers};
pub use printable::printable;
pub use product_receiver::{ProductEvent, ProductReceiver, Received};
pub use product_server::ProductServer;
pub use products::{LargeProduct, ProductKey};
pub use qos::Qos;
pub use recompute::{RecomputeCall, RecomputeServer};
pub use series::Series;
pub use service::ServiceClient;
pub use stage_runner::{JobTag, StageRunner};
pub use status::StatusPublisher;

mod printable;
mod wire_type;
pub mod yaml;

/// Runs an async main on a runtime fit for a node: few async workers, because the heavy work is in blocking threads.
///
/// # Errors
/// When the operating system refuses the threads.
pub fn block_on<F: Future>(main: F) -> Result<F::Output, RuntimeError> {
    open_files::allow_many();
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()
        .map_err(|e| RuntimeError::create("the async runtime", e))?;
    Ok(runtime.block_on(main))
}

/// The main of a node's executable: arguments from the process, `start`, run until interrupted, leave the domain. Errors go to
/// stderr as one line and make the exit code 1; `--help` lists the parameters.
pub fn run_node(
    name: &str,
    parameters: ParameterSet,
    start: impl FnOnce(NodeOptions) -> Result<Node, RuntimeError>,
) -> ExitCode {
    run_async_node(name, parameters, async |options| start(options))
}

/// [`run_node`] of a node that has to wait for something when it starts.
pub fn run_async_node(
    name: &str,
    parameters: ParameterSet,
    start: impl AsyncFnOnce(NodeOptions) -> Result<Node, RuntimeError>,
) -> ExitCode {
    if std::env::args().any(|a| a == "--help" || a == "-h") {
        say_on_stderr(format_args!(
            "{name} [--ros-args -r from:=to -p name:=value --params-file FILE --log-level LEVEL]\nparameters:\n{}",
            parameters.table()
        ));
        return ExitCode::SUCCESS;
    }
    let run = async {
        let arguments = Arguments::from_process(name)?;
        if let Some(unknown) = arguments.rest.first() {
            return Err(RuntimeError::Argument(format!("unknown argument '{unknown}': see --help")));
        }
        // From here on, so that a signal finds the node leave the domain however soon it comes.
        let interrupted = interrupted();
        let node = start(NodeOptions { arguments, parameters }).await?;
        let ended = tokio::select! {
            () = interrupted => Ok(()),
            reason = node.gave_up() => Err(reason),
        };
        node.shutdown().await;
        ended
    };
    match block_on(run).and_then(|result| result) {
        Ok(()) => ExitCode::SUCCESS,
        Err(e) => {
            say_on_stderr(format_args!("{name}: {e}"));
            ExitCode::FAILURE
        }
    }
}

/// Resolves on a Ctrl-C or SIGTERM that comes after this call. Must be called within a tokio runtime.
pub fn interrupted() -> impl Future<Output = ()> {
    let signals = [SignalKind::interrupt(), SignalKind::terminate()].map(signal);
    async {
        let [interrupt, terminate] = signals.map(async |signal| match signal {
            Ok(mut signal) => _ = signal.recv().await,
            Err(_) => std::future::pending().await,
        });
        tokio::select! {
            () = interrupt => {}
            () = terminate => {}
        }
    }
}
