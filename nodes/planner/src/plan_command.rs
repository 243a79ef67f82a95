//! `patchmill plan`: surface in, checked program out.

use std::borrow::Cow;
use std::path::Path;

use patchmill_machine_interface::travel::{MachineUse, travel};
use patchmill_products::job::Job;
use serde::Serialize;

use crate::dialect_command::write_dialects;
use crate::job_file::JOB;
use crate::machine_file::machine_text;
use crate::options::{DialectOption, PlanOptions};
use crate::output_folder::OutputFolder;
use crate::progress_line::ProgressLine;
use crate::report_command::write_report;
use crate::rest_of::{Finished, finished};
use crate::session::{
    Order, Outcome, Planned, SURFACE_DIRECTORY, Session, SessionOptions, Surface, surface_file,
};
use crate::stdout::{say, say_json};
use crate::summary::{RefusedTool, Summary, refused_tools, summary, table};
use crate::terminal;

/// What `--json` prints: `summary.json` and what only the command knows.
#[derive(Serialize)]
struct Document<'a> {
    folder: Cow<'a, str>,
    planned_s: f64,
    #[serde(flatten)]
    summary: Summary,
}

/// Plans one surface and writes the output folder.
///
/// # Errors
/// With one sentence for the user; nothing is left in the folder then.
pub async fn plan(options: &PlanOptions) -> Result<(), String> {
    let file = options.surface.as_deref().map(surface_file).transpose()?;
    let surface = file.as_deref().map_or(Surface::NewestCloud { wait: options.cloud_wait }, Surface::File);
    let machine = machine_text(options.job.machine.as_deref(), terminal::warn)?;
    if options.domain.is_some() && !options.parameters.is_empty() {
        return Err(
            "-p and --params-file are for nodes that the command starts, those of --domain run already; leave out either"
                .to_owned(),
        );
    }
    let parameters = options.parameters.read(&[SURFACE_DIRECTORY])?;
    let mut jobs = options.jobs();
    jobs.iter_mut().for_each(|job| job.machine_urdf.clone_from(&machine));
    // Before any node is started.
    jobs.iter().try_for_each(|job| job.check().map_err(|e| e.text))?;
    let finished = finished(&options.job.select, options.rest_of.as_deref())?;
    let folder = OutputFolder::create(&options.out)?;
    let job_file = options.run.effective.text(&parameters, &options.out)?;
    let mut line = ProgressLine::new(options.run.verbose);
    let bag = folder.staging().join("bag");
    let session = SessionOptions {
        domain: options.domain,
        namespace: options.namespace.as_deref(),
        bag: Some(&bag),
        parameters: &parameters,
        verbose: options.run.verbose,
    };
    let session = Session::start(session, surface)?;
    let units = options.job.units.as_deref().unwrap_or_default();
    let order = Order { surface, units, selection: &finished.selection, jobs: &jobs };
    let outcome = session.plan(order, &mut line).await;
    line.end();
    let closed = session.close().await;
    let Outcome { planned, refused } = outcome.map_err(|e| e.to_string())?;
    let plan = planned.ok_or_else(|| match refused.as_slice() {
        [only] => only.to_string(),
        several => format!("none of the {} tools can make the surface, see above", several.len()),
    })?;
    closed?;
    let job = &jobs[plan.place];
    let machine = travel(&plan.program.text, &plan.program.machine_urdf, job.tool.length)?;
    let refused = refused_tools(&jobs, &refused);
    folder.write(JOB, job_file.as_bytes())?;
    let summary = write(&folder, options, (job, &plan, refused), finished, &machine)?;
    folder.commit()?;
    let planned_s = line.seconds();
    let said = if options.run.json {
        say_json(&Document { folder: options.out.to_string_lossy(), planned_s, summary })
    } else {
        let table = table(&plan.result.evaluation, &plan.result.program, job, &machine);
        say(&format!("{table}planned in {planned_s:.1} s, written to {}\n", options.out.display()))
    };
    // The plan is proven and in its place: whatever befalls its report, it stays.
    if let Err(e) = write_report(&options.out) {
        terminal::warn(format!("no report.html: {e}"));
    }
    said
}

fn write(
    folder: &OutputFolder,
    options: &PlanOptions,
    (job, plan, refused_tools): (&Job, &Planned, Vec<RefusedTool>),
    finished: Finished,
    machine: &MachineUse,
) -> Result<Summary, String> {
    let name = options.surface.as_deref().map_or("newest cloud".into(), Path::to_string_lossy);
    let program = &plan.program;
    let result = &plan.result;
    let mut summary =
        summary(&name, job, &result.evaluation, &result.program, &program.machine_urdf, machine);
    summary.refused_tools = refused_tools;
    summary.select = finished.select;
    summary.rest_of = finished.rest_of;
    let wanted = DialectOption::wanted(&options.dialect);
    summary.programs.extend(write_dialects(&wanted, program, job.tool.length, folder)?);
    folder.write("program.ngc", program.text.as_bytes())?;
    folder.write("machine.urdf", program.machine_urdf.as_bytes())?;
    folder.write_json("summary.json", &summary)?;
    Ok(summary)
}
