//! `patchmill compare`: one surface planned by every method at the same conditions, in one table.

use std::borrow::Cow;
use std::fs;
use std::path::Path;
use std::sync::Arc;

use patchmill_geometry::cutter::Cutter;
use patchmill_geometry::mesh::TriangleMesh;
use patchmill_machine_interface::travel::{MachineUse, travel};
use patchmill_msgs::action::PlanSurfaceResult;
use patchmill_path_generation::least_length::least_cut_length;
use patchmill_path_generation::{PathParams, PreparedSurface};
use patchmill_products::field::RollingBallField;
use patchmill_products::job::{Job, Strategy, Tool};
use patchmill_products::samples::SurfaceSamples;
use patchmill_products::selection::Selection;
use patchmill_products::stage::unobserved;
use serde::Serialize;

use crate::comparison::{Comparison, Figures, Row, method, ratios, tool_mm};
use crate::job_file::JOB;
use crate::machine_file::machine_text;
use crate::options::CompareOptions;
use crate::output_folder::OutputFolder;
use crate::progress_line::ProgressLine;
use crate::select_option::selection;
use crate::session::{
    Order, Outcome, Planned, SURFACE_DIRECTORY, Session, SessionOptions, Surface, surface_file,
};
use crate::stdout::{say, say_json};
use crate::summary::{refused_tools, summary};
use crate::terminal;
use crate::tool_option::largest_first;

/// Diameters of the toroidal cutters in stock where the command names none, mm; the corner radius is a quarter of them.
const STOCK: [f64; 8] = [32.0, 25.0, 20.0, 16.0, 12.0, 10.0, 8.0, 6.0];

/// Compares and writes the output folder.
///
/// # Errors
/// With one sentence for the user: the surface, the machine or the folder cannot be used, or nothing could be planned.
pub async fn compare(options: &CompareOptions) -> Result<(), String> {
    let surface = surface_file(&options.surface)?;
    let machine = machine_text(options.job.machine.as_deref(), terminal::warn)?;
    let parameters = options.parameters.read(&[SURFACE_DIRECTORY])?;
    let selection = selection(&options.job.select)?;
    let session =
        SessionOptions { parameters: &parameters, verbose: options.run.verbose, ..SessionOptions::default() };
    let folder = OutputFolder::create(&options.out)?;
    let job_file = options.run.effective.text(&parameters, &options.out)?;
    let session = Session::start(session, Surface::File(&surface))?;
    let surface = Surface::File(&surface);
    let bench = Bench { options, surface, machine, selection, folder: &folder, session: &session };
    let mut line = ProgressLine::new(options.run.verbose);
    let compared = bench.run(&mut line).await;
    line.end();
    let closed = session.close().await;
    let comparison = compared?;
    closed?;
    folder.write("compare.md", comparison.table().as_bytes())?;
    folder.write_json("compare.json", &comparison)?;
    folder.write(JOB, job_file.as_bytes())?;
    folder.commit()?;
    if options.run.json {
        return say_json(&Document { folder: options.out.to_string_lossy(), comparison });
    }
    say(&format!("{}written to {}\n", comparison.table(), options.out.display()))
}

/// What `--json` prints: `compare.json` and its place.
#[derive(Serialize)]
struct Document<'a> {
    folder: Cow<'a, str>,
    #[serde(flatten)]
    comparison: Comparison,
}

/// What all rows share.
struct Bench<'a> {
    options: &'a CompareOptions,
    surface: Surface<'a>,
    machine: String,
    selection: Selection,
    folder: &'a OutputFolder,
    session: &'a Session,
}

impl Bench<'_> {
    async fn run(&self, line: &mut ProgressLine) -> Result<Comparison, String> {
        let (mut rows, mut of_own_tool) = (Vec::new(), None);
        let methods = self.methods();
        for (i, jobs) in methods.iter().enumerate() {
            line.set_part(i, methods.len());
            let (row, result) = self.row(jobs, &format!("[{}/{}]", i + 1, methods.len()), line).await?;
            if row.tool_mm == tool_mm(&self.options.tool) {
                of_own_tool = result.or(of_own_tool);
            }
            rows.push(row);
        }
        let Some(result) = of_own_tool else {
            let reasons: Vec<String> = rows.iter().map(|r| format!("{}: {}", r.method, r.reason)).collect();
            return Err(format!("no method has a program with this tool: {}", reasons.join("; ")));
        };
        line.note("lower bound");
        let lower_bound_s = self.lower_bound(&result).await?;
        Ok(Comparison {
            patchmill_version: env!("CARGO_PKG_VERSION"),
            surface: self.options.surface.to_string_lossy().into_owned(),
            surface_id: result.program.surface_id,
            scallop_height_mm: self.options.job.scallop,
            gouge_tolerance_mm: self.options.job.gouge_tolerance,
            feed_mm_per_min: self.options.job.feed,
            ratios: ratios(&rows),
            rows,
            lower_bound_s,
        })
    }

    /// The methods; of each the jobs that are tried, from the largest tool down.
    fn methods(&self) -> Vec<Vec<Job>> {
        let tool = &self.options.tool;
        let one = |strategy, tool: &Tool| vec![self.job(strategy, tool, 1, 1)];
        let ball = Tool { cutter: Cutter { r1: 0.0, r2: tool.cutter.radius() }, ..tool.clone() };
        let mut methods = vec![one(Strategy::ThreeAxis, &ball)];
        if tool.cutter.r1 > 0.0 {
            methods.push(one(Strategy::ThreeAxis, tool));
        }
        let sturz = self.tools_for_sturz();
        methods.push(sturz.iter().map(|tool| self.job(Strategy::Sturz, tool, 1, 1)).collect());
        methods.push(one(Strategy::FiveAxis, tool));
        for patches in self.options.patches.clone() {
            methods.push(vec![self.job(Strategy::RollingBall, tool, patches, patches)]);
        }
        methods.push(one(Strategy::Fastest, tool));
        methods.push(vec![self.job(Strategy::Fastest, tool, 1, 8)]);
        methods
    }

    /// The job's tool and those of the stock that are smaller, the largest first.
    fn tools_for_sturz(&self) -> Vec<Tool> {
        let own = &self.options.tool;
        let usual = STOCK.map(|mm| Tool::bare(Cutter { r1: mm * 0.25e-3, r2: mm * 0.25e-3 }, own.length));
        let stock = if self.options.stock.is_empty() { &usual[..] } else { &self.options.stock };
        let smaller = stock.iter().filter(|tool| tool.cutter.radius() < own.cutter.radius());
        largest_first(smaller.chain([own]).cloned().collect())
    }

    fn job(&self, strategy: Strategy, tool: &Tool, patches_min: u8, patches_max: u8) -> Job {
        let machine_urdf = self.machine.clone();
        Job { strategy, patches_min, patches_max, machine_urdf, ..self.options.job.job(tool) }
    }

    /// The row of a method, and the plan of the first of its jobs that has a program.
    async fn row(
        &self,
        jobs: &[Job],
        place: &str,
        line: &mut ProgressLine,
    ) -> Result<(Row, Option<PlanSurfaceResult>), String> {
        let last = jobs.last().ok_or("a method without a tool")?;
        let name = method(last);
        line.note(&format!("{place} {name}"));
        let units = self.options.job.units.as_deref().unwrap_or_default();
        let outcome = self
            .session
            .plan(Order { surface: self.surface, units, selection: &self.selection, jobs }, line)
            .await;
        let Outcome { planned, refused } = outcome.map_err(|e| e.to_string())?;
        let mut refused = refused_tools(jobs, &refused);
        refused.iter_mut().for_each(|tool| tool.reason = own_words(&tool.reason));
        let Some(plan) = planned else {
            let reason = refused.pop().map(|tool| tool.reason).unwrap_or_default();
            line.note(&format!("        none: {reason}"));
            let tool_mm = tool_mm(&last.tool);
            return Ok((Row { method: name, folder: None, tool_mm, figures: None, reason, refused }, None));
        };
        let job = &jobs[plan.place];
        let machine = travel(&plan.program.text, &plan.program.machine_urdf, job.tool.length)?;
        let figures = Figures::of(&plan.result, &machine, job, plan.seconds);
        let Figures { machining_time_s, planned_s, .. } = figures;
        line.note(&format!("        {machining_time_s:.1} s, planned in {planned_s:.1} s"));
        let row = Row {
            folder: Some(slug(&name)),
            method: name,
            tool_mm: tool_mm(&job.tool),
            figures: Some(figures),
            reason: String::new(),
            refused,
        };
        self.keep(&slug(&row.method), job, &plan, &machine)?;
        Ok((row, Some(plan.result)))
    }

    /// Writes a row's program into its folder.
    fn keep(&self, row: &str, job: &Job, plan: &Planned, machine: &MachineUse) -> Result<(), String> {
        let place = Path::new("programs").join(row);
        let made = self.folder.staging().join(&place);
        fs::create_dir_all(&made).map_err(|e| format!("cannot make {}: {e}", made.display()))?;
        let file = |name: &str| place.join(name).to_string_lossy().into_owned();
        let surface = self.options.surface.to_string_lossy();
        let (result, urdf) = (&plan.result, &plan.program.machine_urdf);
        let summary = summary(&surface, job, &result.evaluation, &result.program, urdf, machine);
        self.folder.write(&file("program.ngc"), plan.program.text.as_bytes())?;
        self.folder.write(&file("machine.urdf"), plan.program.machine_urdf.as_bytes())?;
        self.folder.write_json(&file("summary.json"), &summary)
    }

    /// The bound, s, from the products of a plan with the job's own tool; `None` where the cutter does not fit.
    async fn lower_bound(&self, result: &PlanSurfaceResult) -> Result<Option<f64>, String> {
        let mesh = Arc::new(self.session.product::<TriangleMesh>(result).await?);
        let samples = self.session.product::<SurfaceSamples>(result).await?;
        let field = self.session.product::<RollingBallField>(result).await?;
        let job = self.job(Strategy::RollingBall, &self.options.tool, 1, 1);
        let params = PathParams::default();
        let surface = PreparedSurface::new(mesh, &samples, &field, &job, &params, unobserved());
        let length = least_cut_length(&surface.map_err(|e| e.text)?, &job).ok();
        Ok(length.map(|length| length / job.feed))
    }
}

/// A failure's text without the frame that a plan of many candidates puts around it.
fn own_words(text: &str) -> String {
    text.split_once(" patches: ").map_or(text, |(_, reason)| reason).to_owned()
}

/// A row's name as a folder's.
fn slug(name: &str) -> String {
    let words = name.split(|c: char| !c.is_ascii_alphanumeric()).filter(|word| !word.is_empty());
    words.collect::<Vec<_>>().join("_").to_lowercase()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_have_folders_of_their_own() {
        assert_eq!(slug("five-axis Sturz 5°"), "five_axis_sturz_5");
        assert_eq!(slug("rolling-ball, 4 patches"), "rolling_ball_4_patches");
        assert_eq!(slug("3+2, one orientation"), "3_2_one_orientation");
    }
}
