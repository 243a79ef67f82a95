//! `patchmill compare`: one surface planned by every method at the same conditions, in one table.

use std::fs;
use std::path::Path;
use std::sync::Arc;

use patchmill_geometry::cutter::Cutter;
use patchmill_geometry::mesh::TriangleMesh;
use patchmill_machine_interface::travel::travel;
use patchmill_path_generation::least_length::least_cut_length;
use patchmill_path_generation::{PathParams, PreparedSurface};
use patchmill_products::field::RollingBallField;
use patchmill_products::job::{Job, Strategy, Tool};
use patchmill_products::samples::SurfaceSamples;
use patchmill_products::stage::unobserved;

use crate::comparison::{Comparison, Figures, Refused, Row, method, ratios, tool_mm};
use crate::machine_file::machine_text;
use crate::options::CompareOptions;
use crate::output_folder::OutputFolder;
use crate::progress_line::ProgressLine;
use crate::session::{Order, PlanFailure, Session, SessionOptions, surface_file};
use crate::summary::summary;

/// Diameters of the toroidal cutters in stock where the command names none, mm; the corner radius is a quarter of them.
const STOCK: [f64; 8] = [32.0, 25.0, 20.0, 16.0, 12.0, 10.0, 8.0, 6.0];

/// Compares and writes the output folder.
///
/// # Errors
/// With one sentence for the user: the surface, the machine or the folder cannot be used, or nothing could be planned.
pub async fn compare(options: &CompareOptions) -> Result<(), String> {
    let surface = surface_file(&options.surface)?;
    let machine = machine_text(options.job.machine.as_deref(), |warning| eprintln!("{warning}"))?;
    let folder = OutputFolder::create(&options.out)?;
    let session = Session::start(SessionOptions::default(), &surface)?;
    let bench = Bench { options, surface: &surface, machine, folder: &folder, session: &session };
    let compared = bench.run().await;
    let closed = session.close().await;
    let comparison = compared?;
    closed?;
    folder.write("compare.md", comparison.table().as_bytes())?;
    folder.write_json("compare.json", &comparison)?;
    folder.commit()?;
    report(&format!("{}written to {}\n", comparison.table(), options.out.display()));
    Ok(())
}

/// What all rows share.
struct Bench<'a> {
    options: &'a CompareOptions,
    surface: &'a Path,
    machine: String,
    folder: &'a OutputFolder,
    session: &'a Session,
}

impl Bench<'_> {
    async fn run(&self) -> Result<Comparison, String> {
        let mut rows = Vec::new();
        let methods = self.methods();
        for (i, tools) in methods.iter().enumerate() {
            rows.push(self.row(tools, &format!("[{}/{}]", i + 1, methods.len())).await?);
        }
        let job = self.job(Strategy::RollingBall, &self.options.tool, 1, 1);
        // The field is that of the last job, whose tool is the job's.
        let (surface_id, lower_bound_s) = self.lower_bound(&job).await?;
        Ok(Comparison {
            patchmill_version: env!("CARGO_PKG_VERSION"),
            surface: self.options.surface.to_string_lossy().into_owned(),
            surface_id,
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
        let usual = STOCK.map(|mm| Tool {
            cutter: Cutter { r1: mm * 0.25e-3, r2: mm * 0.25e-3 },
            ..Tool::bare(own.cutter, own.length)
        });
        let stock = if self.options.stock.is_empty() { &usual[..] } else { &self.options.stock };
        let mut tools: Vec<Tool> =
            stock.iter().filter(|tool| tool.cutter.radius() < own.cutter.radius()).cloned().collect();
        tools.push(own.clone());
        tools.sort_by(|a, b| b.cutter.radius().total_cmp(&a.cutter.radius()));
        tools
    }

    fn job(&self, strategy: Strategy, tool: &Tool, patches_min: u8, patches_max: u8) -> Job {
        let machine_urdf = self.machine.clone();
        Job { strategy, patches_min, patches_max, machine_urdf, ..self.options.job.job(tool) }
    }

    /// The row of the first job that has a program.
    async fn row(&self, jobs: &[Job], place: &str) -> Result<Row, String> {
        let mut refused: Vec<Refused> = Vec::new();
        for job in jobs {
            let name = method(job);
            let [diameter, corner] = tool_mm(&job.tool);
            eprintln!("{place} {name}, tool {diameter:.1} r{corner} mm");
            let mut line = ProgressLine::new();
            let units = self.options.job.units.as_deref().unwrap_or_default();
            let planned = self.session.plan(Order { surface: self.surface, units, job }, &mut line).await;
            line.end();
            match planned {
                Ok((result, program)) => {
                    let machine = travel(&program.text, &program.machine_urdf, job.tool.length)?;
                    let figures = Figures::of(&result, &machine, job, line.seconds());
                    eprintln!(
                        "        {:.1} s, planned in {:.1} s",
                        figures.machining_time_s, figures.planned_s
                    );
                    let folder = slug(&name);
                    let place = Path::new("programs").join(&folder);
                    let made = self.folder.staging().join(&place);
                    fs::create_dir_all(&made).map_err(|e| format!("cannot make {}: {e}", made.display()))?;
                    let file = |name: &str| place.join(name).to_string_lossy().into_owned();
                    let surface = self.options.surface.to_string_lossy();
                    let summary = summary(&surface, job, &result.evaluation, &result.program, &machine);
                    self.folder.write(&file("program.ngc"), program.text.as_bytes())?;
                    self.folder.write(&file("machine.urdf"), program.machine_urdf.as_bytes())?;
                    self.folder.write_json(&file("summary.json"), &summary)?;
                    return Ok(Row {
                        method: name,
                        folder: Some(folder),
                        tool_mm: tool_mm(&job.tool),
                        figures: Some(figures),
                        reason: String::new(),
                        refused,
                    });
                }
                Err(failure) if failure.is_of_the_tool() => {
                    eprintln!("        none: {}", failure.text);
                    refused.push(Refused { tool_mm: tool_mm(&job.tool), reason: own_words(&failure) });
                }
                Err(failure) => return Err(failure.to_string()),
            }
        }
        let last = refused.pop().ok_or("a method without a tool")?;
        let method = jobs.first().map(method).unwrap_or_default();
        let (tool_mm, reason) = (last.tool_mm, last.reason);
        Ok(Row { method, folder: None, tool_mm, figures: None, reason, refused })
    }

    /// The surface's id and the bound, s; `None` where the cutter does not fit.
    async fn lower_bound(&self, job: &Job) -> Result<(String, Option<f64>), String> {
        eprintln!("lower bound");
        let (surface, mesh) = self.session.product::<TriangleMesh>().await?;
        let (_, samples) = self.session.product::<SurfaceSamples>().await?;
        let (_, field) = self.session.product::<RollingBallField>().await?;
        let params = PathParams::default();
        let prepared = PreparedSurface::new(Arc::new(mesh), &samples, &field, job, &params, unobserved());
        let length = prepared.ok().and_then(|surface| least_cut_length(&surface, job).ok());
        Ok((surface.surface_id, length.map(|length| length / job.feed)))
    }
}

/// A failure without the frame that a plan of many candidates puts around it.
fn own_words(failure: &PlanFailure) -> String {
    let text = &failure.text;
    text.split_once(" patches: ").map_or(text.as_str(), |(_, reason)| reason).to_owned()
}

/// A row's name as a folder's.
fn slug(name: &str) -> String {
    let words = name.split(|c: char| !c.is_ascii_alphanumeric()).filter(|word| !word.is_empty());
    words.collect::<Vec<_>>().join("_").to_lowercase()
}

/// The one thing that goes to stdout.
#[allow(clippy::print_stdout)]
fn report(text: &str) {
    print!("{text}");
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
