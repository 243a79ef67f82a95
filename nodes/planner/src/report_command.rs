//! `report.html`: written by every `patchmill plan`, or later, from a plan's folder with its bag, by `patchmill report`.

use std::path::{Path, PathBuf};

use patchmill_machine_interface::execution::sha256_hex;
use patchmill_products::job::Job;
use patchmill_report::{Plan, Refused};
use serde::Deserialize;

use crate::options::ReportOptions;
use crate::output_folder::replace;
use crate::plan_folder;
use crate::replay::recorded::load;
use crate::stdout::say;

/// The report's file in a plan's folder.
pub const REPORT: &str = "report.html";

/// What is needed of `summary.json`.
#[derive(Deserialize)]
struct Summary {
    patchmill_version: String,
    surface: String,
    strategy: String,
    pattern: String,
    program_sha256: String,
    #[serde(default)]
    refused_tools: Vec<RefusedTool>,
}

#[derive(Deserialize)]
struct RefusedTool {
    r1_mm: f64,
    r2_mm: f64,
    reason: String,
}

/// `patchmill report`: writes the report of a finished plan.
///
/// # Errors
/// As [`write_report`].
pub fn report(options: &ReportOptions) -> Result<(), String> {
    let place = write_report(&options.plan)?;
    say(&format!("written: {}\n", place.display()))
}

/// Writes the report of the plan in a folder beside it; gives its place.
///
/// # Errors
/// With one sentence: as [`finished_plan`], or when the report cannot be made or written.
pub fn write_report(folder: &Path) -> Result<PathBuf, String> {
    let html = patchmill_report::report(&finished_plan(folder)?)?;
    let place = folder.join(REPORT);
    replace(&place, html.as_bytes())?;
    Ok(place)
}

/// The plan in a folder: its summary and, from its bag, its products.
///
/// # Errors
/// When summary or bag are missing, cannot be read, lack something, or are not of the same program.
pub fn finished_plan(folder: &Path) -> Result<Plan, String> {
    let place = folder.join("summary.json");
    let summary: Summary = plan_folder::summary(folder)?;
    let bag = folder.join("bag");
    let recorded =
        load(&bag).map_err(|e| format!("{e}; expected the bag of the plan in {}", folder.display()))?;
    let lacks = |what: &str| format!("bag {}: the {what} is not in it, or not whole", bag.display());
    let mut products = recorded.products;
    let program = products.program.ok_or_else(|| lacks("program"))?;
    if sha256_hex(&program.text) != summary.program_sha256 {
        return Err(format!(
            "bag {} is not of the program that {} speaks of",
            bag.display(),
            place.display()
        ));
    }
    let chosen = program.candidate_index;
    Ok(Plan {
        surface: summary.surface,
        version: summary.patchmill_version,
        strategy: summary.strategy,
        pattern: summary.pattern,
        job: Job::from_msg(&recorded.job).map_err(|e| e.text)?,
        mesh: products.mesh.ok_or_else(|| lacks("mesh"))?,
        samples: products.samples.ok_or_else(|| lacks("samples"))?,
        field: products.field.ok_or_else(|| lacks("rolling-ball field"))?,
        partition: products.partitions.remove(&chosen).ok_or_else(|| lacks("chosen partition"))?,
        toolpath: products.toolpaths.remove(&chosen).ok_or_else(|| lacks("chosen toolpath"))?,
        evaluation: products.evaluation.ok_or_else(|| lacks("evaluation"))?,
        motion: products.motion.ok_or_else(|| lacks("joint motion"))?,
        residual: products.residual.ok_or_else(|| lacks("residual map"))?,
        program_sha256: summary.program_sha256,
        program,
        refused: summary
            .refused_tools
            .into_iter()
            .map(|t| Refused { r1: t.r1_mm / 1e3, r2: t.r2_mm / 1e3, reason: t.reason })
            .collect(),
        notes: recorded.notes,
    })
}
