//! Takes in what live nodes give.

use std::collections::BTreeSet;
use std::time::Duration;

use patchmill_geometry::mesh::TriangleMesh;
use patchmill_msgs::msg::{self, MachineModel, StageStatus};
use patchmill_msgs::std_msgs;
use patchmill_node_runtime::{
    JobTag, LargeProduct, Node, ProductKey, ProductReceiver, Qos, Received, RuntimeError, topics,
};
use patchmill_products::evaluation::{Evaluation, ResidualMap};
use patchmill_products::field::RollingBallField;
use patchmill_products::partition::Partition;
use patchmill_products::program::{JointMotion, Program};
use patchmill_products::samples::SurfaceSamples;
use patchmill_products::toolpath::CandidateToolpath;
use tokio::sync::mpsc;
use tokio::time::Instant;

use super::recorded::{end_of, is_later};
use super::{RunProducts, stages_from};
use crate::progress_line::ProgressLine;

/// For the stages to show up.
const STAGES_PATIENCE: Duration = Duration::from_secs(20);
/// For products to arrive after the last stage has ended; after a failure some never do.
const GRACE: Duration = Duration::from_secs(10);
const GRACE_AFTER_FAILURE: Duration = Duration::from_secs(2);

type Store = Box<dyn FnOnce(&mut RunProducts) + Send>;

enum Event {
    Product(Store),
    Machine(Box<MachineModel>),
    Status(Box<StageStatus>),
    /// A product did not come whole or is not valid.
    Lost(String),
}

/// Subscriptions to everything that the stages from one on give for one run of a job.
pub struct Watch {
    stages: Vec<&'static str>,
    tag: JobTag,
    events: mpsc::UnboundedReceiver<Event>,
    seen: BTreeSet<String>,
    products: RunProducts,
}

impl Watch {
    /// Subscribes.
    ///
    /// # Errors
    /// As [`Node::subscribe`].
    pub fn new(node: &Node, first: &str, tag: &JobTag) -> Result<Self, RuntimeError> {
        let (sender, events) = mpsc::unbounded_channel();
        let stages = stages_from(first);
        let ears = Ears { node, sender, tag: tag.clone() };
        for stage in topics::nodes::STAGES {
            ears.hear(&topics::status(stage), Qos::Status, |status| Event::Status(Box::new(status)))?;
        }
        for stage in &stages {
            ears.listen_to(stage)?;
        }
        let products = RunProducts::default();
        Ok(Self { stages, tag: tag.clone(), events, seen: BTreeSet::new(), products })
    }

    /// The surface that was loaded has this content hash.
    pub fn loaded(&mut self, surface_id: String) {
        self.products.surface_id = Some(surface_id);
    }

    /// Waits until all of the stages are there.
    ///
    /// # Errors
    /// When one does not show up, or an earlier stage is there too.
    pub async fn wait_for_stages(&mut self) -> Result<(), String> {
        let end = Instant::now() + STAGES_PATIENCE;
        while let missing = self.missing_stages()
            && !missing.is_empty()
        {
            match tokio::time::timeout_at(end, self.events.recv()).await {
                Ok(Some(event)) => self.take(event)?,
                Ok(None) => return Err("the replay's node was shut down".to_owned()),
                Err(_) => {
                    let waited = STAGES_PATIENCE.as_secs();
                    return Err(format!("{} did not show up within {waited} s", missing.join(", ")));
                }
            }
        }
        Ok(())
    }

    /// Takes everything in until the stages have ended and what was recorded has come, or does not come any more.
    ///
    /// # Errors
    /// When nothing is heard for `silence`, a product is lost, or an earlier stage is there too.
    pub async fn finish(
        mut self,
        recorded: &RunProducts,
        silence: Duration,
        line: &mut ProgressLine,
    ) -> Result<RunProducts, String> {
        let mut ended: Option<Instant> = None;
        loop {
            if ended.is_none() && self.has_ended() {
                let failed = self.products.ends.values().any(|end| !end.done);
                ended = Some(Instant::now() + if failed { GRACE_AFTER_FAILURE } else { GRACE });
            }
            if ended.is_some() && self.has_all(recorded) {
                break;
            }
            let end = ended.unwrap_or_else(|| Instant::now() + silence);
            match tokio::time::timeout_at(end, self.events.recv()).await {
                Ok(Some(event)) => {
                    if let Event::Status(status) = &event {
                        line.show_stage(&status.node, &status.text, status.fraction);
                    }
                    self.take(event)?;
                }
                Ok(None) => return Err("the replay's node was shut down".to_owned()),
                Err(_) if ended.is_some() => break,
                Err(_) => return Err(format!("no stage reported anything for {} s", silence.as_secs())),
            }
        }
        if self.products.machine.is_none() {
            // What there is was told before the job.
            self.products.robot_description = None;
        }
        Ok(self.products)
    }

    fn missing_stages(&self) -> Vec<&'static str> {
        self.stages.iter().copied().filter(|stage| !self.seen.contains(*stage)).collect()
    }

    /// Whether all stages have ended, or one has failed, so that the later ones never will.
    fn has_ended(&self) -> bool {
        let ends = &self.products.ends;
        ends.values().any(|end| !end.done) || self.stages.iter().all(|stage| ends.contains_key(*stage))
    }

    fn has_all(&self, recorded: &RunProducts) -> bool {
        let here = self.products.names();
        let described = match (&self.products.machine, &self.products.robot_description) {
            (Some(machine), Some(text)) => machine.urdf == *text,
            _ => true,
        };
        described && recorded.names().iter().all(|name| here.contains(name))
    }

    fn take(&mut self, event: Event) -> Result<(), String> {
        match event {
            Event::Product(store) => store(&mut self.products),
            Event::Lost(text) => return Err(text),
            Event::Machine(model) => {
                let job = std_msgs::msg::Header { stamp: self.tag.stamp.clone(), frame_id: String::new() };
                if is_later(&model, &job) {
                    self.products.machine = Some(*model);
                }
            }
            Event::Status(status) => {
                if !self.stages.contains(&status.node.as_str()) {
                    return Err(format!(
                        "{} runs there too, whose products the replay feeds: only {} may run there",
                        status.node,
                        self.stages.join(", ")
                    ));
                }
                if let Some(end) = end_of(&status, &self.tag) {
                    self.products.ends.insert(status.node.clone(), end);
                }
                self.seen.insert(status.node.clone());
            }
        }
        Ok(())
    }
}

struct Ears<'a> {
    node: &'a Node,
    sender: mpsc::UnboundedSender<Event>,
    tag: JobTag,
}

impl Ears<'_> {
    fn listen_to(&self, stage: &str) -> Result<(), RuntimeError> {
        let surface = self.tag.surface_id.clone();
        let of_surface = move |key: &ProductKey| key.surface_id == surface;
        let tag = self.tag.clone();
        let of_job = move |key: &ProductKey| JobTag::of_key(key) == tag;
        match stage {
            topics::nodes::SURFACE_INGESTION => {
                self.receive::<TriangleMesh>(of_surface.clone(), |all, mesh| all.mesh = Some(mesh))?;
                self.receive::<SurfaceSamples>(of_surface, |all, samples| all.samples = Some(samples))
            }
            topics::nodes::ROLLING_BALL_ANALYSIS => {
                self.receive::<RollingBallField>(of_job, |all, field| all.field = Some(field))
            }
            topics::nodes::SURFACE_PARTITIONING => self.hear_partitions(),
            topics::nodes::PATH_GENERATION => self.receive::<CandidateToolpath>(of_job, |all, toolpath| {
                all.toolpaths.insert(toolpath.index, toolpath);
            }),
            _ => {
                self.receive::<Program>(of_job.clone(), |all, program| all.program = Some(program))?;
                self.receive::<JointMotion>(of_job.clone(), |all, motion| all.motion = Some(motion))?;
                self.receive::<ResidualMap>(of_job, |all, map| all.residual = Some(map))?;
                self.hear_evaluation()?;
                self.hear(topics::MACHINE_MODEL, Qos::Status, |model| Event::Machine(Box::new(model)))?;
                self.hear(topics::ROBOT_DESCRIPTION, Qos::Status, |text: std_msgs::msg::String| {
                    Event::Product(Box::new(move |all| all.robot_description = Some(text.data)))
                })
            }
        }
    }

    fn hear<T: patchmill_msgs::RosType>(
        &self,
        topic: &str,
        qos: Qos,
        event: impl Fn(T) -> Event + Send + 'static,
    ) -> Result<(), RuntimeError> {
        let sender = self.sender.clone();
        self.node.subscribe_with(topic, qos, move |message: T| {
            // The watch may be gone; then nobody wants the message.
            let _ = sender.send(event(message));
        })?;
        Ok(())
    }

    fn hear_partitions(&self) -> Result<(), RuntimeError> {
        let tag = self.tag.clone();
        let topic = topics::PARTITION_CANDIDATES;
        self.hear(topic, Qos::Product, move |message: msg::PartitionCandidate| {
            match Partition::from_msg(&message) {
                Ok((provenance, partition)) => {
                    let wanted = JobTag::of_provenance(&provenance) == tag;
                    Event::Product(Box::new(move |all| {
                        if wanted {
                            all.partitions.insert(partition.index, partition);
                        }
                    }))
                }
                Err(e) => Event::Lost(e.text),
            }
        })
    }

    fn hear_evaluation(&self) -> Result<(), RuntimeError> {
        let tag = self.tag.clone();
        self.hear(topics::EVALUATION, Qos::Status, move |message| match Evaluation::from_msg(&message) {
            Ok((provenance, evaluation)) => {
                let wanted = JobTag::of_provenance(&provenance) == tag;
                Event::Product(Box::new(move |all| {
                    if wanted {
                        all.evaluation = Some(evaluation);
                    }
                }))
            }
            Err(e) => Event::Lost(e.text),
        })
    }

    fn receive<P: LargeProduct>(
        &self,
        wanted: impl Fn(&ProductKey) -> bool + Send + 'static,
        store: fn(&mut RunProducts, P),
    ) -> Result<(), RuntimeError> {
        let mut receiver = ProductReceiver::<P>::new(self.node)?;
        let sender = self.sender.clone();
        self.node.spawn(async move {
            while let Some(received) = receiver.next().await {
                let event = match received {
                    Received::Product { key, product, .. } if wanted(&key) => {
                        Event::Product(Box::new(move |all| store(all, product)))
                    }
                    Received::Failed { key, text } if wanted(&key) => Event::Lost(text),
                    _ => continue,
                };
                let _ = sender.send(event);
            }
        });
        Ok(())
    }
}
