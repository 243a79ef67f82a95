//! The node shell: takes job, samples and rolling-ball field, gives `partition/candidates`, one message a candidate.

use std::sync::Arc;

use patchmill_msgs::msg;
use patchmill_node_runtime::{
    JobTag, Latest, Node, NodeOptions, ParameterSet, ProductReceiver, Publisher, Qos, RecomputeServer,
    RuntimeError, StageRunner, StatusPublisher, Subscription, topics,
};
use patchmill_products::field::RollingBallField;
use patchmill_products::job::Job;
use patchmill_products::partition::Partition;
use patchmill_products::samples::SurfaceSamples;
use patchmill_products::stage::StageError;

use crate::{PartitionParams, partition};

/// First code of this stage's hundred: an input that cannot be read, a product that cannot be sent.
const BAD_MESSAGE: i32 = 300;

/// The parameters of the node.
pub fn parameters() -> ParameterSet {
    let default = PartitionParams::default();
    ParameterSet::new()
        .integer("seed", default.seed as i64, 0..=i64::MAX, "seed of the k-means++ starts")
        .integer("restarts", default.restarts as i64, 1..=1000, "k-means++ runs of which the best counts")
        .integer(
            "max_iterations",
            default.max_iterations as i64,
            1..=100_000,
            "iterations of one k-means run at most",
        )
        .integer(
            "changes",
            default.changes as i64,
            0..=100_000,
            "random changes by which patches are moved for the least time",
        )
        .max_chunks()
}

/// Starts the node. It runs until it is shut down.
///
/// # Errors
/// When the node cannot join the domain or a parameter is refused.
pub fn start(options: NodeOptions) -> Result<Node, RuntimeError> {
    let node = Node::start(options)?;
    let shell = Shell {
        jobs: node.subscribe(topics::JOB, Qos::Status)?,
        samples: ProductReceiver::new(&node)?,
        fields: ProductReceiver::new(&node)?,
        recompute: RecomputeServer::new(&node, BAD_MESSAGE)?,
        candidates: node.publisher(topics::PARTITION_CANDIDATES, Qos::Product)?,
        runner: StageRunner::new(StatusPublisher::new(&node)?),
        job: None,
        sample: Latest::default(),
        field: Latest::default(),
        started: None,
        node: node.clone(),
    };
    node.spawn(shell.run());
    Ok(node)
}

struct Shell {
    jobs: Subscription<msg::Job>,
    samples: ProductReceiver<SurfaceSamples>,
    fields: ProductReceiver<RollingBallField>,
    recompute: RecomputeServer,
    candidates: Publisher<msg::PartitionCandidate>,
    runner: StageRunner<Vec<Partition>>,
    job: Option<(JobTag, Arc<Job>)>,
    sample: Latest<String, SurfaceSamples>,
    field: Latest<JobTag, RollingBallField>,
    started: Option<JobTag>,
    node: Node,
}

impl Shell {
    async fn run(mut self) {
        loop {
            tokio::select! {
                Some(job) = self.jobs.next() => {
                    self.job = self.runner.take_job(&job, BAD_MESSAGE);
                    self.started = None;
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
                call = self.recompute.next() => {
                    if let Some(call) = call.accept(self.job.as_ref().map(|(tag, _)| tag)) {
                        self.started = None;
                        call.answer(Ok(()));
                    }
                }
                (tag, result) = self.runner.finished() => self.publish(&tag, result),
                else => return,
            }
            if let Err(e) = self.start_when_complete() {
                self.node.error(e.to_string());
            }
        }
    }

    fn start_when_complete(&mut self) -> Result<(), RuntimeError> {
        let Some((tag, job)) = &self.job else { return Ok(()) };
        if self.started.as_ref() == Some(tag) {
            return Ok(());
        }
        let (Some(samples), Some(field)) = (self.sample.of(&tag.surface_id), self.field.of(tag)) else {
            self.runner.status().waiting(tag, "waiting for samples and rolling-ball field");
            return Ok(());
        };
        let params = PartitionParams {
            seed: self.node.integer("seed")? as u64,
            restarts: self.node.integer("restarts")? as usize,
            max_iterations: self.node.integer("max_iterations")? as u64,
            changes: self.node.integer("changes")? as usize,
        };
        let job = Arc::clone(job);
        self.started = Some(tag.clone());
        self.runner.start(tag.clone(), "clustering the samples", move |progress| {
            partition(&samples, &field, &job, &params, progress)
        });
        Ok(())
    }

    fn publish(&mut self, tag: &JobTag, result: Result<Vec<Partition>, StageError>) {
        let Ok(partitions) = result else { return };
        for partition in &partitions {
            let sent =
                partition.to_msg(&tag.provenance()).map_err(|e| e.with_code(BAD_MESSAGE)).and_then(|m| {
                    self.candidates.publish(m).map_err(|e| StageError::new(BAD_MESSAGE, e.to_string()))
                });
            if let Err(e) = sent {
                return self.runner.status().failed(tag, &e);
            }
        }
        let split = partitions.iter().flat_map(|p| &p.patches).filter(|p| p.parts.len() > 1).count();
        let text = match split {
            0 => format!("{} candidate partitions", partitions.len()),
            _ => format!("{} candidate partitions, {split} patches in several parts", partitions.len()),
        };
        self.runner.status().done(tag, &text);
    }
}
