//! The run of a bag that is replayed.

use std::path::Path;

use patchmill_bag_recorder::{BagError, RecordedRun};
use patchmill_msgs::msg::{Evaluation as EvaluationMessage, Job, MachineModel, StageStatus};
use patchmill_msgs::std_msgs;
use patchmill_node_runtime::{JobTag, LargeProduct, ProductKey, topics};
use patchmill_products::evaluation::Evaluation;

use super::{RunProducts, StageEnd};

/// A recorded run of a job.
pub struct Recorded {
    /// The job's message.
    pub job: Job,
    /// What the stages gave.
    pub products: RunProducts,
    /// Whether the bag's recorder was killed, so that what came last is missing.
    pub cut_short: bool,
    /// What a reader of the report has to know.
    pub notes: Vec<String>,
}

/// Reads the last run of a bag.
///
/// # Errors
/// When the bag cannot be read, is of another version of the interfaces, or holds no job.
pub fn load(bag: &Path) -> Result<Recorded, String> {
    let run = RecordedRun::open(bag).map_err(|e| format!("{}{}", e.text, meant(bag)))?;
    let mut jobs = run.jobs().map_err(|e| e.text)?;
    let count = jobs.len();
    let job = jobs.pop().ok_or_else(|| format!("bag {}: there is no job in it", bag.display()))?;
    let mut notes = Vec::new();
    if count > 1 {
        notes.push(format!("the bag has {count} runs of jobs, the last one was replayed"));
    }
    for file in run.unfinished() {
        let file = file.display();
        notes.push(format!("{file} has no end: its recorder was killed, what came last is missing"));
    }
    let products = products(&run, &job).map_err(|e| e.text)?;
    Ok(Recorded { job, products, cut_short: !run.unfinished().is_empty(), notes })
}

/// What a folder that is no bag may stand for, to be added to an error.
pub fn meant(bag: &Path) -> String {
    let inside = bag.join("bag");
    match (bag.is_dir(), inside.is_dir()) {
        (true, true) => format!("; is {} meant?", inside.display()),
        (true, false) => String::new(),
        (false, _) => "; expected the folder of a bag, such as bag/ in the folder of a plan".to_owned(),
    }
}

fn products(run: &RecordedRun, job: &Job) -> Result<RunProducts, BagError> {
    let tag = JobTag::of_job(job);
    let of_surface = |key: &ProductKey| key.surface_id == tag.surface_id;
    let of_job = |key: &ProductKey| JobTag::of_key(key) == tag;
    let machine = last_machine(run, job)?;
    let description = run.messages::<std_msgs::msg::String>(topics::ROBOT_DESCRIPTION)?.pop();
    let toolpaths = run.products_of::<patchmill_products::toolpath::CandidateToolpath>(of_job)?;
    let mut products = RunProducts {
        surface_id: Some(tag.surface_id.clone()),
        mesh: last(run, of_surface)?,
        samples: last(run, of_surface)?,
        field: last(run, of_job)?,
        partitions: run.partitions_of(Some(&tag))?.into_iter().map(|p| (p.index, p)).collect(),
        toolpaths: toolpaths.into_iter().map(|(_, t)| (t.index, t)).collect(),
        evaluation: last_evaluation(run, &tag)?,
        program: last(run, of_job)?,
        motion: last(run, of_job)?,
        residual: last(run, of_job)?,
        robot_description: description.filter(|_| machine.is_some()).map(|text| text.data),
        machine,
        ..RunProducts::default()
    };
    for stage in topics::nodes::STAGES {
        for status in run.messages::<StageStatus>(&topics::status(stage))? {
            if let Some(end) = end_of(&status, &tag) {
                products.ends.insert(stage.to_owned(), end);
            }
        }
    }
    Ok(products)
}

fn last<P: LargeProduct>(
    run: &RecordedRun,
    wanted: impl Fn(&ProductKey) -> bool,
) -> Result<Option<P>, BagError> {
    Ok(run.products_of::<P>(wanted)?.pop().map(|(_, product)| product))
}

fn last_evaluation(run: &RecordedRun, tag: &JobTag) -> Result<Option<Evaluation>, BagError> {
    let mut last = None;
    for message in run.messages::<EvaluationMessage>(topics::EVALUATION)? {
        let (provenance, evaluation) =
            Evaluation::from_msg(&message).map_err(|e| BagError { text: e.text })?;
        if JobTag::of_provenance(&provenance) == *tag {
            last = Some(evaluation);
        }
    }
    Ok(last)
}

/// The machine that the job was evaluated with: machine_interface tells of it anew for every job.
fn last_machine(run: &RecordedRun, job: &Job) -> Result<Option<MachineModel>, BagError> {
    let mut models = run.messages::<MachineModel>(topics::MACHINE_MODEL)?;
    models.retain(|model| is_later(model, &job.header));
    Ok(models.pop())
}

/// Whether a machine model was published after a job.
pub(super) fn is_later(model: &MachineModel, job: &std_msgs::msg::Header) -> bool {
    let time = |header: &std_msgs::msg::Header| (header.stamp.sec, header.stamp.nanosec);
    time(&model.header) >= time(job)
}

/// How a stage ended its work on a job or, surface_ingestion, on its surface.
pub(super) fn end_of(status: &StageStatus, tag: &JobTag) -> Option<StageEnd> {
    let of_job = status.job_id == tag.job_id && status.job_stamp == tag.stamp;
    let ingested = status.node == topics::nodes::SURFACE_INGESTION && status.job_id.is_empty();
    if status.surface_id != tag.surface_id || !(of_job || ingested) {
        return None;
    }
    match status.state {
        StageStatus::DONE => Some(StageEnd { done: true, code: 0, failure: String::new() }),
        StageStatus::FAILED => {
            Some(StageEnd { done: false, code: status.code, failure: status.text.clone() })
        }
        _ => None,
    }
}
