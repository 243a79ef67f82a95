//! The nodes that one run of the command works with: its own stack or one that runs already.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use patchmill_bag_recorder::{Recorder, RecorderOptions};
use patchmill_machine_interface::evaluate::{NONE_FEASIBLE, OUTSIDE_TRAVEL};
use patchmill_msgs::action::{PlanSurface, PlanSurfaceGoal, PlanSurfaceResult};
use patchmill_msgs::builtin_interfaces::msg::Time;
use patchmill_node_runtime::arguments::Override;
use patchmill_node_runtime::{
    ActionClient, ActionEnd, Arguments, DomainLease, LargeProduct, Level, Node, NodeOptions, ParameterSet,
    ProductKey, ProductReceiver, Received, RuntimeError, free_domain, interrupted, topics,
};
use patchmill_products::job::Job;
use patchmill_products::program::Program;
use patchmill_products::selection::Selection;
use patchmill_rolling_ball_analysis::CODE_TOOL_TOO_BIG;

use crate::progress_line::ProgressLine;
use crate::stack::{Stack, StackOptions, local};
use crate::tool_option::named;

/// The parameter that an own stack's surface_ingestion gets from the session.
pub const SURFACE_DIRECTORY: &str = "surface_directory";

/// For finding the planner and being accepted.
const PATIENCE: Duration = Duration::from_secs(20);
/// For a product's chunks after its plan is there.
const PRODUCT_PATIENCE: Duration = Duration::from_secs(30);

/// A running stack with a client of its planner.
pub struct Session {
    /// Held so that no other process takes the domain.
    _lease: Option<DomainLease>,
    stack: Option<Stack>,
    recorder: Option<Recorder>,
    node: Node,
    client: ActionClient<PlanSurface>,
}

/// Which stack, and what is recorded.
#[derive(Clone, Copy, Debug, Default)]
pub struct SessionOptions<'a> {
    /// Domain of a stack that runs already; `None`: an own one.
    pub domain: Option<u16>,
    /// Its namespace; `None`: the usual one.
    pub namespace: Option<&'a str>,
    /// Folder of a bag of everything.
    pub bag: Option<&'a Path>,
    /// Parameters of an own stack's nodes.
    pub parameters: &'a [Override],
    /// Whether an own stack's nodes log to stderr.
    pub verbose: bool,
}

/// Where a surface comes from.
#[derive(Clone, Copy, Debug)]
pub enum Surface<'a> {
    /// A file.
    File(&'a Path),
    /// The newest cloud of surface_ingestion's topic.
    NewestCloud {
        /// Longest wait for one where none has come yet, s.
        wait: f64,
    },
}

impl Surface<'_> {
    /// The folder that an own stack loads surfaces from.
    fn folder(&self) -> &Path {
        let file = match self {
            Self::File(file) => file.parent(),
            Self::NewestCloud { .. } => None,
        };
        file.unwrap_or(Path::new("/"))
    }
}

/// What is planned.
#[derive(Clone, Copy)]
pub struct Order<'a> {
    /// The surface.
    pub surface: Surface<'a>,
    /// Unit of what names none; empty: mm.
    pub units: &'a str,
    /// What is to be finished.
    pub selection: &'a Selection,
    /// The jobs that are tried one after the other, each with its machine: one a tool.
    pub jobs: &'a [Job],
}

/// The first job of an order that has a program.
pub struct Planned {
    /// Its place in the order.
    pub place: usize,
    /// What the planner says.
    pub result: PlanSurfaceResult,
    /// The program with its text.
    pub program: Program,
    /// Time of planning it, s.
    pub seconds: f64,
}

/// What came of an order.
pub struct Outcome {
    /// `None` when no job has a program.
    pub planned: Option<Planned>,
    /// Why the jobs before it, or all, have none, in their order.
    pub refused: Vec<PlanFailure>,
}

/// Why there is no plan.
#[derive(Clone, Debug)]
pub struct PlanFailure {
    /// The stage that says so; empty where it is no stage's.
    pub stage: String,
    /// Its error, 0 where it is no stage's.
    pub code: i32,
    /// One sentence.
    pub text: String,
}

impl PlanFailure {
    fn here(text: impl Into<String>) -> Self {
        Self { stage: String::new(), code: 0, text: text.into() }
    }

    /// Whether it is a finding about tool or method, so that another one may do what this one cannot; all else (surface, machine,
    /// nodes) is in everyone's way.
    fn is_a_finding(&self) -> bool {
        [CODE_TOOL_TOO_BIG, NONE_FEASIBLE, OUTSIDE_TRAVEL].contains(&self.code)
    }
}

impl std::fmt::Display for PlanFailure {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.stage.as_str() {
            "" => f.write_str(&self.text),
            stage => write!(f, "{stage}: {} (code {})", self.text, self.code),
        }
    }
}

impl Session {
    /// Starts the nodes; an own stack loads surfaces from the folder of `surface` only.
    ///
    /// # Errors
    /// When one does not start.
    pub fn start(options: SessionOptions, surface: Surface<'_>) -> Result<Self, String> {
        let text = |e: RuntimeError| e.to_string();
        let lease = if options.domain.is_none() { Some(free_domain().map_err(text)?) } else { None };
        let domain = options.domain.or(lease.as_ref().map(DomainLease::domain)).unwrap_or(0);
        let quiet = |name: &str| {
            let arguments = match lease {
                Some(_) => local(name, domain, Level::Fatal),
                None => joining(name, domain, options.namespace)?,
            };
            Node::start(NodeOptions { arguments, parameters: ParameterSet::new() })
        };
        let recorder = match options.bag {
            Some(bag) => {
                let node = quiet(topics::nodes::BAG_RECORDER).map_err(text)?;
                Some(Recorder::on(node, bag, RecorderOptions::default()).map_err(text)?)
            }
            None => None,
        };
        let stack = match lease {
            Some(_) => {
                let own = StackOptions {
                    domain,
                    surfaces: Some(surface.folder()),
                    machine: "",
                    // Failures come back as the action's result; the nodes need not print them as well.
                    log_level: log_level(options.verbose),
                    parameters: options.parameters,
                };
                Some(Stack::start_with(&own, |_| true).map_err(text)?)
            }
            None => None,
        };
        let node = quiet("patchmill_plan").map_err(text)?;
        let client = node.action_client(topics::PLAN_SURFACE).map_err(text)?;
        Ok(Self { _lease: lease, stack, recorder, node, client })
    }

    /// Plans the first job of an order that can be; with several of them, says on stderr why one cannot.
    ///
    /// # Errors
    /// What is in the way of every job, or when the nodes cannot be talked to.
    pub async fn plan(&self, order: Order<'_>, line: &mut ProgressLine) -> Result<Outcome, PlanFailure> {
        let mut refused = Vec::new();
        for (place, job) in order.jobs.iter().enumerate() {
            let begin = Instant::now();
            match self.plan_job(order, job, line).await {
                Ok((result, program)) => {
                    let seconds = begin.elapsed().as_secs_f64();
                    let planned = Planned { place, result, program, seconds };
                    return Ok(Outcome { planned: Some(planned), refused });
                }
                Err(failure) if failure.is_a_finding() => {
                    if order.jobs.len() > 1 {
                        line.say(&format!("tool {}: {failure}", named(&job.tool)));
                        line.start_again();
                    }
                    refused.push(failure);
                }
                Err(failure) => return Err(failure),
            }
        }
        Ok(Outcome { planned: None, refused })
    }

    /// Plans one job and fetches the program's text.
    async fn plan_job(
        &self,
        order: Order<'_>,
        job: &Job,
        line: &mut ProgressLine,
    ) -> Result<(PlanSurfaceResult, Program), PlanFailure> {
        let here = |e: RuntimeError| PlanFailure::here(e.to_string());
        job.check().map_err(|e| PlanFailure::here(e.text))?;
        let programs = ProductReceiver::<Program>::new(&self.node).map_err(here)?;
        let mut goal = PlanSurfaceGoal {
            units: order.units.to_owned(),
            selection: order.selection.to_msg(),
            job: job.to_msg(Time::default()),
            ..PlanSurfaceGoal::default()
        };
        match order.surface {
            Surface::File(file) => goal.path = file.to_string_lossy().into_owned(),
            Surface::NewestCloud { wait } => (goal.newest_cloud, goal.cloud_wait) = (true, wait),
        }
        let end = self.client.execute(goal, PATIENCE, |feedback| line.show(&feedback), interrupted());
        let result = match end.await.map_err(here)? {
            ActionEnd::Succeeded(result) => result,
            ActionEnd::Aborted(result) => {
                return Err(PlanFailure { stage: result.stage, code: result.code, text: result.text });
            }
            ActionEnd::Canceled(result) => return Err(PlanFailure::here(result.text)),
        };
        let program = received(programs, &result).await;
        let program =
            program.map_err(|e| PlanFailure::here(format!("the program's text did not arrive: {e}")))?;
        Ok((result, program))
    }

    /// A product that a plan was made from: of its surface, or of its run of the job.
    ///
    /// # Errors
    /// When it does not arrive.
    pub async fn product<P: LargeProduct>(&self, result: &PlanSurfaceResult) -> Result<P, String> {
        let products = ProductReceiver::<P>::new(&self.node).map_err(|e| e.to_string())?;
        received(products, result).await.map_err(|e| format!("the {} did not arrive: {e}", P::WHAT))
    }

    /// Ends the bag first, while everything is still there.
    ///
    /// # Errors
    /// When the bag could not be written.
    pub async fn close(self) -> Result<(), String> {
        let bag = match self.recorder {
            Some(recorder) => recorder.finish().await.map(|_| ()),
            None => Ok(()),
        };
        self.node.shutdown().await;
        if let Some(stack) = self.stack {
            stack.shutdown().await;
        }
        bag.map_err(|e| e.to_string())
    }
}

async fn received<P: LargeProduct>(
    mut products: ProductReceiver<P>,
    result: &PlanSurfaceResult,
) -> Result<P, String> {
    let (surface_id, job_id) = (&result.program.surface_id, &result.program.job_id);
    let stamp = &result.program.header.stamp;
    let wanted = |key: &ProductKey| {
        let of_run = key.job_id == *job_id && key.stamp == (stamp.sec, stamp.nanosec);
        key.surface_id == *surface_id && (key.job_id.is_empty() || of_run)
    };
    let first = tokio::time::timeout(PRODUCT_PATIENCE, async {
        while let Some(received) = products.next().await {
            match received {
                Received::Product { key, product, .. } if wanted(&key) => return Ok(product),
                Received::Failed { key, text } if wanted(&key) => return Err(text),
                _ => {}
            }
        }
        Err("the node was shut down".to_owned())
    });
    first.await.unwrap_or_else(|_| Err(format!("it did not come within {} s", PRODUCT_PATIENCE.as_secs())))
}

/// From which level on the nodes of an own stack log to stderr.
pub fn log_level(verbose: bool) -> Level {
    if verbose { Level::Info } else { Level::Fatal }
}

/// Arguments of a node that joins a running stack: what the environment says of hosts counts.
fn joining(name: &str, domain: u16, namespace: Option<&str>) -> Result<Arguments, RuntimeError> {
    let remap = namespace.map(|n| ["--ros-args".to_owned(), "-r".to_owned(), format!("__ns:={n}")]);
    let environment = |variable: &str| std::env::var(variable).ok();
    let arguments = Arguments::parse(remap.into_iter().flatten(), name, environment)?;
    Ok(Arguments { domain, log_level: Level::Fatal, ..arguments })
}

/// The surface's file by its full path.
///
/// # Errors
/// When it is not there.
pub fn surface_file(path: &Path) -> Result<PathBuf, String> {
    path.canonicalize().map_err(|e| {
        format!(
            "surface file {}: {e}; expected a file of JSON, STEP, a mesh or scanned points",
            path.display()
        )
    })
}
