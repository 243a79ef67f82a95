//! The node shell: takes job, mesh, samples, field and candidate partitions, gives `toolpath/candidates` one by one.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use patchmill_geometry::mesh::TriangleMesh;
use patchmill_msgs::msg::{self, ToolpathChunk, ToolpathManifest};
use patchmill_node_runtime::{
    JobTag, Latest, Node, NodeOptions, ParameterSet, ProductReceiver, ProductServer, Qos, RecomputeServer,
    RuntimeError, StageRunner, StatusPublisher, Subscription, topics,
};
use patchmill_products::field::RollingBallField;
use patchmill_products::job::Job;
use patchmill_products::partition::Partition;
use patchmill_products::samples::SurfaceSamples;
use patchmill_products::stage::{Progress, StageError};
use patchmill_products::toolpath::CandidateToolpath;
use patchmill_products::wire::{Chunked, Provenance};
use tokio::sync::mpsc;

use crate::{PathParams, PreparedSurface, plan_candidates};

/// First code of this stage's hundred: an input that cannot be read, a product that cannot be sent.
const BAD_MESSAGE: i32 = 400;

/// The parameters of the node.
pub fn parameters() -> ParameterSet {
    let default = PathParams::default();
    ParameterSet::new()
        .integer(
            "cloud_points",
            default.cloud_points as i64,
            1000..=2_000_000,
            "dense points on which axes and step-overs are decided",
        )
        .double(
            "check_spacing_mm",
            default.check_spacing * 1e3,
            0.01..=10.0,
            "distance of the swept check's points on the facets [mm]",
        )
        .integer(
            "check_points",
            default.check_points as i64,
            1000..=10_000_000,
            "most points of the swept check",
        )
        .integer(
            "respacing_rounds",
            default.respacing_rounds as i64,
            0..=20,
            "most rounds of spacing passes anew after the swept check",
        )
        .integer(
            "max_passes",
            default.max_passes as i64,
            10..=1_000_000,
            "most passes side by side over a square of the surface's area",
        )
        .max_chunks()
}

/// Starts the node. It runs until it is shut down.
///
/// # Errors
/// When the node cannot join the domain or a parameter is refused.
pub fn start(options: NodeOptions) -> Result<Node, RuntimeError> {
    let node = Node::start(options)?;
    let (made, ready) = mpsc::unbounded_channel();
    let shell = Shell {
        jobs: node.subscribe(topics::JOB, Qos::Status)?,
        meshes: ProductReceiver::new(&node)?,
        samples: ProductReceiver::new(&node)?,
        fields: ProductReceiver::new(&node)?,
        partitions: node.subscribe(topics::PARTITION_CANDIDATES, Qos::Product)?,
        recompute: RecomputeServer::new(&node, BAD_MESSAGE)?,
        toolpaths: ProductServer::new(&node)?,
        runner: StageRunner::new(StatusPublisher::new(&node)?),
        job: None,
        mesh: Latest::default(),
        sample: Latest::default(),
        field: Latest::default(),
        candidates: (JobTag::default(), BTreeMap::new()),
        started: None,
        made,
        ready,
        node: node.clone(),
    };
    node.spawn(shell.run());
    Ok(node)
}

/// A toolpath ready to be published.
type Parts = (JobTag, ToolpathManifest, Vec<ToolpathChunk>);

struct Shell {
    jobs: Subscription<msg::Job>,
    meshes: ProductReceiver<TriangleMesh>,
    samples: ProductReceiver<SurfaceSamples>,
    fields: ProductReceiver<RollingBallField>,
    partitions: Subscription<msg::PartitionCandidate>,
    recompute: RecomputeServer,
    toolpaths: ProductServer<CandidateToolpath>,
    runner: StageRunner<String>,
    job: Option<(JobTag, Arc<Job>)>,
    mesh: Latest<String, TriangleMesh>,
    sample: Latest<String, SurfaceSamples>,
    field: Latest<JobTag, RollingBallField>,
    /// Partitions of one run of a job, by index.
    candidates: (JobTag, BTreeMap<u32, Partition>),
    started: Option<JobTag>,
    made: mpsc::UnboundedSender<Parts>,
    ready: mpsc::UnboundedReceiver<Parts>,
    node: Node,
}

impl Shell {
    async fn run(mut self) {
        loop {
            tokio::select! {
                biased;
                Some(job) = self.jobs.next() => {
                    self.job = self.runner.take_job(&job, BAD_MESSAGE);
                    self.started = None;
                }
                // Before the end of the work: its toolpaths are out when the status says DONE.
                Some((tag, manifest, chunks)) = self.ready.recv() => {
                    if self.started.as_ref() == Some(&tag) {
                        self.toolpaths.publish_parts(manifest, chunks).await;
                    }
                }
                Some(mesh) = self.meshes.next() => {
                    if let Some((key, mesh)) = self.runner.received(mesh) {
                        self.mesh.put(key.surface_id, mesh);
                    }
                }
                Some(samples) = self.samples.next() => {
                    if let Some((key, samples)) = self.runner.received(samples) {
                        self.sample.put(key.surface_id, samples);
                    }
                }
                Some(field) = self.fields.next() => {
                    if let Some((key, field)) = self.runner.received(field) {
                        self.field.put(JobTag::of_key(&key), field);
                    }
                }
                Some(partition) = self.partitions.next() => self.take_partition(&partition),
                call = self.recompute.next() => {
                    if let Some(call) = call.accept(self.job.as_ref().map(|(tag, _)| tag)) {
                        self.started = None;
                        call.answer(Ok(()));
                    }
                }
                (tag, result) = self.runner.finished() => {
                    if let Ok(text) = result {
                        self.runner.status().done(&tag, &text);
                    }
                }
                else => return,
            }
            if let Err(e) = self.start_when_complete() {
                self.node.error(e.to_string());
            }
        }
    }

    fn take_partition(&mut self, message: &msg::PartitionCandidate) {
        match Partition::from_msg(message) {
            Ok((provenance, partition)) => {
                let tag = JobTag::of_provenance(&provenance);
                if self.candidates.0 != tag {
                    self.candidates = (tag, BTreeMap::new());
                }
                self.candidates.1.insert(partition.index, partition);
            }
            Err(e) => {
                let tag = JobTag {
                    surface_id: message.surface_id.clone(),
                    job_id: message.job_id.clone(),
                    stamp: message.header.stamp.clone(),
                };
                self.runner.status().failed(&tag, &e.with_code(BAD_MESSAGE));
            }
        }
    }

    fn start_when_complete(&mut self) -> Result<(), RuntimeError> {
        let Some((tag, job)) = &self.job else { return Ok(()) };
        if self.started.as_ref() == Some(tag) {
            return Ok(());
        }
        let inputs = (self.mesh.of(&tag.surface_id), self.sample.of(&tag.surface_id), self.field.of(tag));
        let complete = self.candidates.0 == *tag
            && self.candidates.1.values().next().is_some_and(|p| p.count as usize == self.candidates.1.len());
        let ((Some(mesh), Some(samples), Some(field)), true) = (inputs, complete) else {
            self.runner.status().waiting(tag, "waiting for mesh, samples, field and all partitions");
            return Ok(());
        };
        let params = PathParams {
            cloud_points: self.node.integer("cloud_points")? as usize,
            check_spacing: self.node.double("check_spacing_mm")? / 1e3,
            check_points: self.node.integer("check_points")? as usize,
            respacing_rounds: self.node.integer("respacing_rounds")? as usize,
            max_passes: self.node.integer("max_passes")? as usize,
        };
        let partitions: Vec<Partition> = self.candidates.1.values().cloned().collect();
        let (job, made, run) = (Arc::clone(job), self.made.clone(), tag.clone());
        self.started = Some(tag.clone());
        self.runner.start(tag.clone(), "cutting the passes of every candidate", move |progress| {
            let surface = PreparedSurface::new(mesh, &samples, &field, &job, &params, progress)?;
            let publish = |toolpath: &CandidateToolpath| {
                split(toolpath, &run.provenance()).map(|(manifest, chunks)| {
                    // The shell may be gone; then nobody wants the toolpath.
                    let _ = made.send((run.clone(), manifest, chunks));
                })
            };
            plan_all(&surface, &partitions, &job, &params, progress, &publish)
        });
        Ok(())
    }
}

fn split(
    toolpath: &CandidateToolpath,
    provenance: &Provenance,
) -> Result<(ToolpathManifest, Vec<ToolpathChunk>), StageError> {
    toolpath.split(provenance).map_err(|e| e.with_code(BAD_MESSAGE))
}

/// Plans all candidates in parallel and hands each over when it is ready; a line about the outcome.
fn plan_all(
    surface: &PreparedSurface,
    partitions: &[Partition],
    job: &Job,
    params: &PathParams,
    progress: Progress<'_>,
    publish: &(dyn Fn(&CandidateToolpath) -> Result<(), StageError> + Sync),
) -> Result<String, StageError> {
    let (done, feasible) = (AtomicUsize::new(0), AtomicUsize::new(0));
    plan_candidates(surface, partitions, job, params, progress, &|toolpath| {
        publish(&toolpath)?;
        if toolpath.infeasible_reason.is_empty() {
            feasible.fetch_add(1, Ordering::Relaxed);
        }
        let done = done.fetch_add(1, Ordering::Relaxed) + 1;
        (progress.report)(done as f64 / partitions.len() as f64);
        Ok(())
    })?;
    Ok(format!("{} of {} candidates cut within the tolerances", feasible.into_inner(), partitions.len()))
}
