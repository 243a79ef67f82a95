//! All nodes in one process, one ROS context each.

use std::path::Path;

use patchmill_bag_recorder::{Recorder, RecorderOptions};
use patchmill_node_runtime::arguments::Override;
use patchmill_node_runtime::{
    Arguments, Level, Node, NodeOptions, ParameterSet, RuntimeError, Value, interrupted, say_on_stderr,
    topics,
};

use crate::machine_file::machine_text;
use crate::options::UpOptions;
use crate::terminal;

/// The running nodes.
pub struct Stack {
    nodes: Vec<Node>,
}

/// How a stack is started.
#[derive(Clone, Copy, Debug)]
pub struct StackOptions<'a> {
    /// Domain of this machine.
    pub domain: u16,
    /// Surfaces are loaded from here only; `None`: as the parameters say.
    pub surfaces: Option<&'a Path>,
    /// URDF text for jobs that bring none; empty: as the parameters say, else the shipped machine.
    pub machine: &'a str,
    /// Least level that is logged.
    pub log_level: Level,
    /// The nodes' parameters, in order of increasing weight.
    pub parameters: &'a [Override],
}

impl Stack {
    /// Starts all nodes but the recorder and the visualization on a domain of this machine. Surfaces are loaded from `surfaces` only;
    /// `machine` is the URDF text for jobs that bring none (empty: the shipped machine).
    ///
    /// # Errors
    /// Of the first node that does not start.
    pub fn start(
        domain: u16,
        surfaces: &Path,
        machine: &str,
        log_level: Level,
    ) -> Result<Self, RuntimeError> {
        Self::start_some(domain, surfaces, machine, log_level, |_| true)
    }

    /// [`Stack::start`] of those nodes that are wanted.
    ///
    /// # Errors
    /// As [`Stack::start`].
    pub fn start_some(
        domain: u16,
        surfaces: &Path,
        machine: &str,
        log_level: Level,
        wanted: impl Fn(&str) -> bool,
    ) -> Result<Self, RuntimeError> {
        let options = StackOptions { domain, surfaces: Some(surfaces), machine, log_level, parameters: &[] };
        Self::start_with(&options, wanted)
    }

    /// [`Stack::start_some`] with parameters.
    ///
    /// # Errors
    /// As [`Stack::start`].
    pub fn start_with(
        options: &StackOptions<'_>,
        wanted: impl Fn(&str) -> bool,
    ) -> Result<Self, RuntimeError> {
        type Start = fn(NodeOptions) -> Result<Node, RuntimeError>;
        let stages: [(&str, ParameterSet, Start); 6] = [
            (
                topics::nodes::SURFACE_INGESTION,
                patchmill_surface_ingestion::node::parameters(),
                patchmill_surface_ingestion::node::start,
            ),
            (
                topics::nodes::ROLLING_BALL_ANALYSIS,
                patchmill_rolling_ball_analysis::node::parameters(),
                patchmill_rolling_ball_analysis::node::start,
            ),
            (
                topics::nodes::SURFACE_PARTITIONING,
                patchmill_surface_partitioning::node::parameters(),
                patchmill_surface_partitioning::node::start,
            ),
            (
                topics::nodes::PATH_GENERATION,
                patchmill_path_generation::node::parameters(),
                patchmill_path_generation::node::start,
            ),
            (
                topics::nodes::MACHINE_INTERFACE,
                patchmill_machine_interface::node::parameters(),
                patchmill_machine_interface::node::start,
            ),
            (topics::nodes::PLANNER, crate::node::parameters(), crate::node::start),
        ];
        let mut nodes = Vec::with_capacity(stages.len());
        for (name, parameters, start) in stages.into_iter().filter(|(name, _, _)| wanted(name)) {
            let mut arguments = local(name, options.domain, options.log_level);
            arguments.overrides = options.parameters.to_vec();
            if let (topics::nodes::SURFACE_INGESTION, Some(folder)) = (name, options.surfaces) {
                let folder = folder.to_string_lossy().into_owned();
                set(&mut arguments, "surface_directory", Value::Text(folder));
            }
            if name == topics::nodes::MACHINE_INTERFACE && !options.machine.is_empty() {
                set(&mut arguments, "robot_description", Value::Text(options.machine.to_owned()));
            }
            nodes.push(start(NodeOptions { arguments, parameters })?);
        }
        Ok(Self { nodes })
    }

    /// Starts the node that draws plans for viewers; who only plans does without it.
    ///
    /// # Errors
    /// When it does not start.
    pub fn add_visualization(&mut self, domain: u16, log_level: Level) -> Result<(), RuntimeError> {
        use patchmill_visualization::node;
        let arguments = local(topics::nodes::VISUALIZATION, domain, log_level);
        self.nodes.push(node::start(NodeOptions { arguments, parameters: node::parameters() })?);
        Ok(())
    }

    /// Starts the node that serves every topic to Foxglove, on a port of this machine (0: a free one, which its log names).
    ///
    /// # Errors
    /// When it does not start: the port may be taken.
    pub async fn add_live_view(&mut self, options: &StackOptions<'_>, port: u16) -> Result<(), RuntimeError> {
        use patchmill_live_view::node;
        let mut arguments = local(topics::nodes::LIVE_VIEW, options.domain, options.log_level);
        arguments.overrides = options.parameters.to_vec();
        set(&mut arguments, "port", Value::Integer(i64::from(port)));
        self.nodes.push(node::start(NodeOptions { arguments, parameters: node::parameters() }).await?);
        Ok(())
    }

    /// Resolves once one of the nodes must not run on, with its reason.
    pub async fn gave_up(&self) -> RuntimeError {
        Node::one_gave_up(&self.nodes).await
    }

    /// Ends all nodes.
    pub async fn shutdown(self) {
        for node in self.nodes {
            node.shutdown().await;
        }
    }
}

/// Arguments of a node of this process.
pub fn local(name: &str, domain: u16, log_level: Level) -> Arguments {
    Arguments { log_level, ..Arguments::local(name, domain) }
}

fn set(arguments: &mut Arguments, parameter: &str, value: Value) {
    arguments.overrides.push(Override { node: None, name: parameter.to_owned(), value, strict: true });
}

/// `patchmill up`: all nodes until interrupted.
///
/// # Errors
/// When a node does not start or the bag cannot be written.
pub async fn up(options: &UpOptions) -> Result<(), String> {
    let environment = Arguments::from_process("patchmill").map_err(|e| e.to_string())?;
    let domain = options.domain.unwrap_or(environment.domain);
    let machine = machine_text(options.machine.as_deref(), terminal::warn)?;
    let parameters = options.parameters.read(&[])?;
    let recorder = match &options.bag {
        Some(directory) => {
            let arguments = local(topics::nodes::BAG_RECORDER, domain, Level::Info);
            let node = Node::start(NodeOptions { arguments, parameters: ParameterSet::new() });
            Some(
                node.and_then(|node| Recorder::on(node, directory, RecorderOptions::default()))
                    .map_err(|e| e.to_string())?,
            )
        }
        None => None,
    };
    let started = StackOptions {
        domain,
        surfaces: options.surfaces.as_deref(),
        machine: &machine,
        log_level: Level::Info,
        parameters: &parameters,
    };
    let mut stack = Stack::start_with(&started, |_| true).map_err(|e| e.to_string())?;
    stack.add_visualization(domain, Level::Info).map_err(|e| e.to_string())?;
    if let Some(port) = options.foxglove {
        stack.add_live_view(&started, port).await.map_err(|e| e.to_string())?;
    }
    say_on_stderr(format_args!("patchmill is up on ROS domain {domain}; Ctrl-C ends it"));
    let ended = tokio::select! {
        () = interrupted() => Ok(()),
        reason = stack.gave_up() => Err(reason.to_string()),
    };
    stack.shutdown().await;
    let recorded = match recorder {
        Some(recorder) => recorder.finish().await.map(|_| ()).map_err(|e| e.to_string()),
        None => Ok(()),
    };
    ended.and(recorded)
}
