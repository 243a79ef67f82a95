//! `patchmill plan`: surface in, checked program out.

use std::path::{Path, PathBuf};
use std::time::Duration;

use patchmill_bag_recorder::{Recorder, RecorderOptions};
use patchmill_machine_interface::travel::{MachineUse, travel};
use patchmill_msgs::action::{PlanSurface, PlanSurfaceGoal, PlanSurfaceResult};
use patchmill_msgs::builtin_interfaces::msg::Time;
use patchmill_node_runtime::{
    ActionClient, ActionEnd, Arguments, DomainLease, Level, Node, NodeOptions, ParameterSet, ProductReceiver,
    Received, RuntimeError, free_domain, interrupted, topics,
};
use patchmill_products::program::Program;

use crate::dialect_command::write_dialects;
use crate::machine_file::machine_text;
use crate::options::{DialectOption, PlanOptions};
use crate::output_folder::OutputFolder;
use crate::progress_line::ProgressLine;
use crate::stack::{Stack, local};
use crate::summary::{summary, table};

/// For finding the planner and being accepted.
const PATIENCE: Duration = Duration::from_secs(20);
/// For the program's text after the result.
const PROGRAM_PATIENCE: Duration = Duration::from_secs(30);

/// Plans one surface and writes the output folder.
///
/// # Errors
/// With one sentence for the user; nothing is left in the folder then.
pub async fn plan(options: &PlanOptions) -> Result<(), String> {
    let surface = surface_file(&options.surface)?;
    let machine = machine_text(options.machine.as_deref(), |warning| eprintln!("{warning}"))?;
    let folder = OutputFolder::create(&options.out)?;
    let mut line = ProgressLine::new();
    let session = Session::start(options, &surface, &folder.staging().join("bag"))?;
    let planned = session.plan(options, &surface, machine, &mut line).await;
    line.end();
    let closed = session.close().await;
    let (result, program) = planned?;
    closed?;
    let machine = travel(&program.text, &program.machine_urdf, options.tool.length)?;
    write(&folder, options, &result, &program, &machine)?;
    folder.commit()?;
    report(&format!(
        "{}planned in {:.1} s, written to {}\n",
        table(&result.evaluation, &result.program, &machine),
        line.seconds(),
        options.out.display()
    ));
    Ok(())
}

/// The nodes of this run.
struct Session {
    /// Held so that no other process takes the domain.
    _lease: Option<DomainLease>,
    stack: Option<Stack>,
    recorder: Recorder,
    node: Node,
    client: ActionClient<PlanSurface>,
}

impl Session {
    fn start(options: &PlanOptions, surface: &Path, bag: &Path) -> Result<Self, String> {
        let text = |e: RuntimeError| e.to_string();
        let lease = if options.domain.is_none() { Some(free_domain().map_err(text)?) } else { None };
        let domain = options.domain.or(lease.as_ref().map(DomainLease::domain)).unwrap_or(0);
        let quiet = |name: &str| {
            let arguments = match lease {
                Some(_) => local(name, domain, Level::Fatal),
                None => joining(name, domain, options.namespace.as_deref())?,
            };
            Node::start(NodeOptions { arguments, parameters: ParameterSet::new() })
        };
        let recorder = quiet(topics::nodes::BAG_RECORDER).map_err(text)?;
        let recorder = Recorder::on(recorder, bag, RecorderOptions::default()).map_err(text)?;
        let stack = match lease {
            Some(_) => {
                let folder = surface.parent().unwrap_or(Path::new("/"));
                // Failures come back as the action's result; the nodes need not print them as well.
                Some(Stack::start(domain, folder, "", Level::Fatal).map_err(text)?)
            }
            None => None,
        };
        let node = quiet("patchmill_plan").map_err(text)?;
        let client = node.action_client(topics::PLAN_SURFACE).map_err(text)?;
        Ok(Self { _lease: lease, stack, recorder, node, client })
    }

    async fn plan(
        &self,
        options: &PlanOptions,
        surface: &Path,
        machine: String,
        line: &mut ProgressLine,
    ) -> Result<(PlanSurfaceResult, Program), String> {
        let mut programs = ProductReceiver::<Program>::new(&self.node).map_err(|e| e.to_string())?;
        let mut job = options.job();
        job.machine_urdf = machine;
        let goal = PlanSurfaceGoal {
            path: surface.to_string_lossy().into_owned(),
            units: options.units.clone().unwrap_or_default(),
            job: job.to_msg(Time::default()),
            ..PlanSurfaceGoal::default()
        };
        job.check().map_err(|e| e.text)?;
        let end = self.client.execute(goal, PATIENCE, |feedback| line.show(&feedback), interrupted());
        let result = match end.await.map_err(|e| e.to_string())? {
            ActionEnd::Succeeded(result) => result,
            ActionEnd::Aborted(result) => {
                return Err(format!("{}: {} (code {})", result.stage, result.text, result.code));
            }
            ActionEnd::Canceled(result) => return Err(result.text),
        };
        let wanted = (&result.program.job_id, &result.program.header.stamp);
        let received = tokio::time::timeout(PROGRAM_PATIENCE, async {
            while let Some(received) = programs.next().await {
                match received {
                    Received::Product { manifest, product, .. }
                        if (&manifest.job_id, &manifest.header.stamp) == wanted =>
                    {
                        return Ok(product);
                    }
                    Received::Failed { key, text } if key.job_id == *wanted.0 => return Err(text),
                    _ => {}
                }
            }
            Err("the node was shut down".to_owned())
        });
        let program = received
            .await
            .unwrap_or_else(|_| Err(format!("it did not come within {} s", PROGRAM_PATIENCE.as_secs())));
        let program = program.map_err(|e| format!("the program's text did not arrive: {e}"))?;
        Ok((result, program))
    }

    /// Ends the bag first, while everything is still there.
    async fn close(self) -> Result<(), String> {
        let bag = self.recorder.finish().await;
        self.node.shutdown().await;
        if let Some(stack) = self.stack {
            stack.shutdown().await;
        }
        bag.map(|_| ()).map_err(|e| e.to_string())
    }
}

/// Arguments of a node that joins a running stack: what the environment says of hosts counts.
fn joining(name: &str, domain: u16, namespace: Option<&str>) -> Result<Arguments, RuntimeError> {
    let remap = namespace.map(|n| ["--ros-args".to_owned(), "-r".to_owned(), format!("__ns:={n}")]);
    let environment = |variable: &str| std::env::var(variable).ok();
    let arguments = Arguments::parse(remap.into_iter().flatten(), name, environment)?;
    Ok(Arguments { domain, log_level: Level::Fatal, ..arguments })
}

fn surface_file(path: &Path) -> Result<PathBuf, String> {
    path.canonicalize().map_err(|e| format!("surface file {}: {e}", path.display()))
}

fn write(
    folder: &OutputFolder,
    options: &PlanOptions,
    result: &PlanSurfaceResult,
    program: &Program,
    machine: &MachineUse,
) -> Result<(), String> {
    let name = options.surface.to_string_lossy();
    let mut summary = summary(&name, &options.job(), &result.evaluation, &result.program, machine);
    let wanted = DialectOption::wanted(&options.dialect);
    summary.programs.extend(write_dialects(&wanted, program, options.tool.length, folder)?);
    let mut json = serde_json::to_string_pretty(&summary).map_err(|e| format!("summary.json: {e}"))?;
    json.push('\n');
    folder.write("program.ngc", program.text.as_bytes())?;
    folder.write("machine.urdf", program.machine_urdf.as_bytes())?;
    folder.write("summary.json", json.as_bytes())
}

/// The one thing that goes to stdout.
#[allow(clippy::print_stdout)]
fn report(text: &str) {
    print!("{text}");
}
