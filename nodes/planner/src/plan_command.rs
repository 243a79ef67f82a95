//! `patchmill plan`: surface in, checked program out.

use std::path::Path;

use patchmill_machine_interface::travel::{MachineUse, travel};
use patchmill_msgs::action::PlanSurfaceResult;
use patchmill_products::job::{Job, Tool};
use patchmill_products::program::Program;

use crate::dialect_command::write_dialects;
use crate::machine_file::machine_text;
use crate::options::{DialectOption, PlanOptions};
use crate::output_folder::OutputFolder;
use crate::progress_line::ProgressLine;
use crate::session::{Order, PlanFailure, Session, SessionOptions, surface_file};
use crate::summary::{RefusedTool, summary, table};

/// Plans one surface and writes the output folder.
///
/// # Errors
/// With one sentence for the user; nothing is left in the folder then.
pub async fn plan(options: &PlanOptions) -> Result<(), String> {
    let surface = surface_file(&options.surface)?;
    let machine = machine_text(options.job.machine.as_deref(), |warning| eprintln!("{warning}"))?;
    let folder = OutputFolder::create(&options.out)?;
    let mut line = ProgressLine::new();
    let bag = folder.staging().join("bag");
    let session =
        SessionOptions { domain: options.domain, namespace: options.namespace.as_deref(), bag: Some(&bag) };
    let session = Session::start(session, &surface)?;
    let planned = with_largest_tool(&session, options, &surface, &machine, &mut line).await;
    line.end();
    let closed = session.close().await;
    let plan = planned?;
    closed?;
    let machine = travel(&plan.program.text, &plan.program.machine_urdf, plan.job.tool.length)?;
    write(&folder, options, &plan, &machine)?;
    folder.commit()?;
    report(&format!(
        "{}planned in {:.1} s, written to {}\n",
        table(&plan.result.evaluation, &plan.result.program, &machine),
        line.seconds(),
        options.out.display()
    ));
    Ok(())
}

/// A plan with its job.
struct Planned {
    job: Job,
    result: PlanSurfaceResult,
    program: Program,
    refused: Vec<RefusedTool>,
}

/// Plans with the largest of the tools that can make the surface; what keeps the larger ones from it is said on stderr.
async fn with_largest_tool(
    session: &Session,
    options: &PlanOptions,
    surface: &Path,
    machine: &str,
    line: &mut ProgressLine,
) -> Result<Planned, String> {
    let tools = options.tools_by_size();
    let mut refused: Vec<RefusedTool> = Vec::new();
    for tool in &tools {
        let job = Job { machine_urdf: machine.to_owned(), ..options.job_with(tool) };
        let units = options.job.units.as_deref().unwrap_or_default();
        match session.plan(Order { surface, units, job: &job }, line).await {
            Ok((result, program)) => return Ok(Planned { job, result, program, refused }),
            Err(failure) if tools.len() > 1 && failure.is_of_the_tool() => {
                line.end();
                eprintln!("tool {}: {failure}", named(tool));
                refused.push(refused_tool(tool, &failure));
            }
            Err(failure) => return Err(failure.to_string()),
        }
    }
    Err(format!("none of the {} tools can make the surface, see above", tools.len()))
}

/// A tool by diameter and corner radius.
pub(crate) fn named(tool: &Tool) -> String {
    format!("⌀{:.2} r{:.2} mm", tool.cutter.radius() * 2e3, tool.cutter.r2 * 1e3)
}

fn refused_tool(tool: &Tool, failure: &PlanFailure) -> RefusedTool {
    RefusedTool { r1_mm: tool.cutter.r1 * 1e3, r2_mm: tool.cutter.r2 * 1e3, reason: failure.text.clone() }
}

fn write(
    folder: &OutputFolder,
    options: &PlanOptions,
    plan: &Planned,
    machine: &MachineUse,
) -> Result<(), String> {
    let name = options.surface.to_string_lossy();
    let (job, program) = (&plan.job, &plan.program);
    let mut summary = summary(&name, job, &plan.result.evaluation, &plan.result.program, machine);
    summary.refused_tools.clone_from(&plan.refused);
    let wanted = DialectOption::wanted(&options.dialect);
    summary.programs.extend(write_dialects(&wanted, program, job.tool.length, folder)?);
    folder.write("program.ngc", program.text.as_bytes())?;
    folder.write("machine.urdf", program.machine_urdf.as_bytes())?;
    folder.write_json("summary.json", &summary)
}

/// The one thing that goes to stdout.
#[allow(clippy::print_stdout)]
fn report(text: &str) {
    print!("{text}");
}
