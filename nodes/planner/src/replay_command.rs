//! `patchmill replay`: a recorded run into live nodes, and a report of what differs.

use std::path::{Path, PathBuf};
use std::time::Duration;

use patchmill_msgs::msg::Job;
use patchmill_msgs::srv::{LoadSurface, LoadSurfaceRequest};
use patchmill_node_runtime::topics::nodes;
use patchmill_node_runtime::{
    DomainLease, JobTag, Level, Node, NodeOptions, ParameterSet, free_domain, interrupted, status, topics,
};
use serde::Serialize;

use crate::machine_file::machine_text;
use crate::options::ReplayOptions;
use crate::progress_line::ProgressLine;
use crate::replay::compare::compare;
use crate::replay::feed::Feed;
use crate::replay::live::Watch;
use crate::replay::recorded::{Recorded, load};
use crate::replay::report::Report;
use crate::replay::{RunProducts, stages_from};
use crate::rest_of::finished;
use crate::session::{self, log_level};
use crate::stack::{Stack, local};
use crate::stdout::say;
use crate::terminal;

/// For one call of `load_surface`, and for all of them.
const LOAD_ATTEMPT: Duration = Duration::from_secs(10);
const LOAD_PATIENCE: Duration = Duration::from_secs(300);

/// The first keys of the JSON report.
#[derive(Serialize)]
struct Heading<'a> {
    bag: String,
    from: &'a str,
    surface_id: &'a str,
    job_id: &'a str,
}

/// Replays a bag and prints the report. `true` when everything came as it was recorded.
///
/// # Errors
/// With one sentence when the replay could not be done.
pub async fn replay(options: &ReplayOptions) -> Result<bool, String> {
    let first = options.from.stage();
    let surface = surface_file(options)?;
    let machine = machine_text(options.machine.as_deref(), terminal::warn)?;
    let recorded = load(&options.bag)?;
    let expected = recorded.products.clone().of_stages_from(first);
    if expected.names().is_empty() {
        return Err(format!("bag {}: nothing of {first} or later is in it", options.bag.display()));
    }
    let mut line = ProgressLine::new(options.verbose);
    line.set_stages(&stages_from(first));
    let now = tokio::select! {
        now = live_run(options, surface.as_deref(), &machine, (&recorded, &expected), &mut line) => now,
        () = interrupted() => Err("interrupted".to_owned()),
    };
    line.end();
    let now = now?;
    let mut report = compare(&expected, &now);
    report.notes = recorded.notes;
    if recorded.cut_short {
        let unrecorded = std::mem::take(&mut report.unrecorded);
        report.notes.extend(unrecorded.into_iter().map(|name| format!("{name} came after the bag's end")));
    }
    show(options, first, &recorded.job, &report)?;
    Ok(report.same())
}

fn surface_file(options: &ReplayOptions) -> Result<Option<PathBuf>, String> {
    match (&options.surface, options.from.stage()) {
        (None, nodes::SURFACE_INGESTION) => {
            Err("--from surface_ingestion needs --surface FILE: a bag holds the mesh, not the file"
                .to_owned())
        }
        (Some(file), nodes::SURFACE_INGESTION) => session::surface_file(file).map(Some),
        _ => Ok(None),
    }
}

/// What the nodes of a domain, or those started here, make of the recorded inputs.
async fn live_run(
    options: &ReplayOptions,
    surface: Option<&Path>,
    machine: &str,
    (recorded, expected): (&Recorded, &RunProducts),
    line: &mut ProgressLine,
) -> Result<RunProducts, String> {
    let text = |e: patchmill_node_runtime::RuntimeError| e.to_string();
    let first = options.from.stage();
    let lease = if options.domain.is_none() { Some(free_domain().map_err(text)?) } else { None };
    let domain = options.domain.or(lease.as_ref().map(DomainLease::domain)).unwrap_or(0);
    let arguments = local("patchmill_replay", domain, Level::Fatal);
    let node = Node::start(NodeOptions { arguments, parameters: ParameterSet::new() }).map_err(text)?;
    // A new run of the job: nothing that the domain still holds of an older one is taken for its product.
    let mut job = recorded.job.clone();
    job.header.stamp = status::now();
    let feed = Feed::new(&node, first).map_err(text)?;
    let lacking = feed.lacks(&recorded.products);
    if !lacking.is_empty() {
        return Err(format!(
            "bag {}: {} is not in it, or not whole",
            options.bag.display(),
            lacking.join(", ")
        ));
    }
    let mut watch = Watch::new(&node, first, &JobTag::of_job(&job)).map_err(text)?;
    let stack = match lease {
        Some(_) => {
            let folder = surface.and_then(Path::parent).unwrap_or(Path::new("/"));
            let stages = stages_from(first);
            let wanted = |name: &str| stages.contains(&name);
            Some(
                Stack::start_some(domain, folder, machine, log_level(options.verbose), wanted)
                    .map_err(text)?,
            )
        }
        None => None,
    };
    watch.wait_for_stages().await.map_err(|e| format!("{e} (ROS domain {domain})"))?;
    let silence = Duration::from_secs(options.silence);
    let now = match surface {
        Some(file) => {
            let loaded = load_surface(&node, file, options).await?;
            let same = loaded == job.surface_id;
            watch.loaded(loaded.clone());
            if same {
                feed.publish(job, &recorded.products).await?;
                watch.finish(expected, silence, line).await?
            } else {
                // Another surface: the job has nothing to work on.
                RunProducts { surface_id: Some(loaded), ..RunProducts::default() }
            }
        }
        None => {
            feed.publish(job, &recorded.products).await?;
            watch.finish(expected, silence, line).await?
        }
    };
    node.shutdown().await;
    if let Some(stack) = stack {
        stack.shutdown().await;
    }
    Ok(now)
}

/// Loads the surface by surface_ingestion's service: the surface's content hash.
async fn load_surface(node: &Node, file: &Path, options: &ReplayOptions) -> Result<String, String> {
    let client = node.service_client::<LoadSurface>(topics::LOAD_SURFACE).map_err(|e| e.to_string())?;
    let request = LoadSurfaceRequest {
        path: file.to_string_lossy().into_owned(),
        units: options.units.clone().unwrap_or_default(),
        selection: finished(&options.select, options.rest_of.as_deref())?.selection.to_msg(),
        ..LoadSurfaceRequest::default()
    };
    let response = client.call(&request, LOAD_ATTEMPT, LOAD_PATIENCE).await.map_err(|e| e.to_string())?;
    match response.code {
        0 => Ok(response.surface_id),
        code => Err(format!("surface_ingestion: {} (code {code})", response.text)),
    }
}

/// The one thing that goes to stdout.
fn show(options: &ReplayOptions, from: &str, job: &Job, report: &Report) -> Result<(), String> {
    let bag = options.bag.display().to_string();
    let (surface_id, job_id) = (&job.surface_id, &job.job_id);
    if options.json {
        say(&report.json(&Heading { bag, from, surface_id, job_id })?)
    } else {
        let heading = format!("replay of {bag} from {from}: surface {surface_id}, job {job_id}");
        say(&report.text(&heading))
    }
}
