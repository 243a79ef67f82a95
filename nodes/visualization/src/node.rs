//! The node shell: takes the products of all stages, gives them as markers and a cloud. What is shown is always of one job;
//! of its candidates the chosen one.

mod inputs;
mod messages;

use patchmill_geometry::mesh::TriangleMesh;
use patchmill_msgs::builtin_interfaces::msg::Time;
use patchmill_msgs::msg::{self, MeshManifest};
use patchmill_msgs::sensor_msgs::msg::PointCloud2;
use patchmill_msgs::visualization_msgs::msg::MarkerArray;
use patchmill_node_runtime::{
    JobTag, LargeProduct, Node, NodeOptions, ParameterSet, ProductKey, ProductReceiver, Publisher, Qos,
    Received, RuntimeError, Series, Subscription, topics,
};
use patchmill_products::evaluation::{Evaluation, ResidualMap};
use patchmill_products::field::RollingBallField;
use patchmill_products::job::Job;
use patchmill_products::partition::Partition;
use patchmill_products::samples::SurfaceSamples;
use patchmill_products::toolpath::CandidateToolpath;

use crate::cloud::Cloud;
use crate::patches::{Colouring, coloured, plain};
use crate::radius_cloud::radius_cloud;
use crate::residual_cloud::residual_cloud;
use crate::shape::{Drawing, Shape};
use crate::{axes, passes, tool};
use inputs::{CloudInputs, Inputs, Key, PatchInputs, PlanInputs, ResidualInputs};
use messages::{marker_arrays, point_cloud};

/// The parameters of the node.
pub fn parameters() -> ParameterSet {
    ParameterSet::new().max_chunks()
}

/// Starts the node. It runs until it is shut down.
///
/// # Errors
/// When the node cannot join the domain.
pub fn start(options: NodeOptions) -> Result<Node, RuntimeError> {
    let node = Node::start(options)?;
    node.give_signs_of_life()?;
    let shell = Shell {
        jobs: node.subscribe(topics::JOB, Qos::Status)?,
        meshes: ProductReceiver::new(&node)?,
        samples: ProductReceiver::new(&node)?,
        fields: ProductReceiver::new(&node)?,
        partitions: node.subscribe(topics::PARTITION_CANDIDATES, Qos::Product)?,
        toolpaths: ProductReceiver::new(&node)?,
        evaluations: node.subscribe(topics::EVALUATION, Qos::Status)?,
        residuals: ProductReceiver::new(&node)?,
        inputs: Inputs::default(),
        patches: Canvas::new(&node, topics::VISUALIZATION_PATCHES)?,
        passes: Canvas::new(&node, topics::VISUALIZATION_PASSES)?,
        axes: Canvas::new(&node, topics::VISUALIZATION_TOOL_AXES)?,
        tool: Canvas::new(&node, topics::VISUALIZATION_TOOL)?,
        cloud: CloudCanvas::new(&node, topics::ROLLING_BALL_RADIUS)?,
        residual: CloudCanvas::new(&node, topics::VISUALIZATION_RESIDUAL)?,
        node: node.clone(),
    };
    node.spawn(shell.run());
    Ok(node)
}

struct Shell {
    jobs: Subscription<msg::Job>,
    meshes: ProductReceiver<TriangleMesh>,
    samples: ProductReceiver<SurfaceSamples>,
    fields: ProductReceiver<RollingBallField>,
    partitions: Subscription<msg::PartitionCandidate>,
    toolpaths: ProductReceiver<CandidateToolpath>,
    evaluations: Subscription<msg::Evaluation>,
    residuals: ProductReceiver<ResidualMap>,
    inputs: Inputs,
    patches: Canvas,
    passes: Canvas,
    axes: Canvas,
    tool: Canvas,
    cloud: CloudCanvas,
    residual: CloudCanvas,
    node: Node,
}

impl Shell {
    async fn run(mut self) {
        loop {
            // Also before the first input: what an earlier run of this node has left in viewers goes.
            if let Err(e) = self.draw().await {
                self.node.error(e.to_string());
            }
            tokio::select! {
                Some(job) = self.jobs.next() => self.take_job(&job),
                Some(mesh) = self.meshes.next() => {
                    if let Some((_, manifest, mesh)) = self.received(mesh) {
                        self.inputs.put_mesh(tag_of_mesh(&manifest), mesh);
                    }
                }
                Some(samples) = self.samples.next() => {
                    if let Some((key, _, samples)) = self.received(samples) {
                        self.inputs.put_samples(JobTag::of_key(&key), samples);
                    }
                }
                Some(field) = self.fields.next() => {
                    if let Some((key, _, field)) = self.received(field) {
                        self.inputs.put_field(JobTag::of_key(&key), field);
                    }
                }
                Some(toolpath) = self.toolpaths.next() => {
                    if let Some((key, _, toolpath)) = self.received(toolpath) {
                        self.inputs.put_toolpath(JobTag::of_key(&key), toolpath);
                    }
                }
                Some(residual) = self.residuals.next() => {
                    if let Some((key, _, residual)) = self.received(residual) {
                        self.inputs.put_residual(JobTag::of_key(&key), residual);
                    }
                }
                Some(partition) = self.partitions.next() => match Partition::from_msg(&partition) {
                    Ok((origin, partition)) => {
                        self.inputs.put_partition(JobTag::of_provenance(&origin), partition);
                    }
                    Err(e) => self.node.warn(e.text),
                },
                Some(evaluation) = self.evaluations.next() => match Evaluation::from_msg(&evaluation) {
                    Ok((origin, evaluation)) => {
                        self.inputs.put_choice(JobTag::of_provenance(&origin), evaluation.chosen);
                    }
                    Err(e) => self.node.warn(e.text),
                },
                else => return,
            }
        }
    }

    /// A job without id, or one that is not valid, leaves nothing to show.
    fn take_job(&mut self, message: &msg::Job) {
        let job = if message.job_id.is_empty() { None } else { Some(Job::from_msg(message)) };
        let job = job.and_then(|job| job.map_err(|e| self.node.warn(e.text)).ok());
        self.inputs.put_job(job.map(|job| (JobTag::of_job(message), job)));
    }

    fn received<P: LargeProduct>(&self, received: Received<P>) -> Option<(ProductKey, Box<P::Manifest>, P)> {
        match received {
            Received::Product { key, manifest, product } => Some((key, manifest, product)),
            Received::Failed { text, .. } => {
                self.node.warn(format!("the {} is not shown: {text}", P::WHAT));
                None
            }
        }
    }

    /// Draws anew what has changed.
    async fn draw(&mut self) -> Result<(), RuntimeError> {
        let (key, job) = self.inputs.tool();
        self.tool
            .show(key, job, |job| (Drawing::of(tool::shapes(&job.value.tool)), job.tag.stamp.clone()))
            .await?;
        let (key, inputs) = self.inputs.patches();
        self.patches.show(key, inputs, |inputs| (draw_patches(&inputs), inputs.stamp)).await?;
        let (key, inputs) = self.inputs.cloud();
        self.cloud
            .show(key, inputs, |CloudInputs { stamp, samples, field }| {
                (radius_cloud(&samples.value, &field.value), stamp)
            })
            .await?;
        let (key, inputs) = self.inputs.residual();
        self.residual
            .show(key, inputs, |ResidualInputs { job, map }| {
                (residual_cloud(&map.value, job.value.scallop_height), job.tag.stamp.clone())
            })
            .await?;
        let plan = self.inputs.plan();
        let key = plan.as_ref().map_or_else(Key::new, |plan| plan.key.clone());
        self.axes.show(key.clone(), plan, |plan| (draw_axes(&plan), plan.stamp)).await?;
        let plan = self.inputs.plan();
        self.passes.show(key, plan, |plan| (passes::drawing(&plan.toolpath.value), plan.stamp)).await
    }
}

/// The mesh's surface with the stamp of its load.
fn tag_of_mesh(manifest: &MeshManifest) -> JobTag {
    JobTag {
        surface_id: manifest.surface_id.clone(),
        job_id: String::new(),
        stamp: manifest.header.stamp.clone(),
    }
}

fn draw_patches(inputs: &PatchInputs) -> Drawing {
    let mesh = &inputs.mesh.value;
    let with_patches = inputs.plan.as_ref().and_then(|(plan, field)| {
        let (partition, samples) = (&plan.partition.value, &plan.samples.value);
        coloured(mesh, &Colouring { partition, samples, field: &field.value })
    });
    with_patches.unwrap_or_else(|| plain(mesh))
}

fn draw_axes(plan: &PlanInputs) -> Drawing {
    Drawing::of(axes::shapes(&plan.toolpath.value, &plan.partition.value, &plan.samples.value))
}

/// Runs a function in a thread of its own.
async fn in_background<R: Send + 'static>(
    work: impl FnOnce() -> R + Send + 'static,
) -> Result<R, RuntimeError> {
    let broken = |e: tokio::task::JoinError| RuntimeError::Create {
        what: "a drawing".to_owned(),
        reason: e.to_string(),
    };
    tokio::task::spawn_blocking(work).await.map_err(broken)
}

/// A topic of markers and what is on it.
struct Canvas {
    series: Series<MarkerArray>,
    shown: Option<Key>,
    node: Node,
}

impl Canvas {
    fn new(node: &Node, topic: &str) -> Result<Self, RuntimeError> {
        Ok(Self { series: Series::new(node, topic)?, shown: None, node: node.clone() })
    }

    /// Replaces the markers unless they are those of `key` already; without inputs by none.
    async fn show<I: Send + 'static>(
        &mut self,
        key: Key,
        inputs: Option<I>,
        draw: impl FnOnce(I) -> (Drawing, Time) + Send + 'static,
    ) -> Result<(), RuntimeError> {
        if self.shown.as_ref() == Some(&key) {
            return Ok(());
        }
        self.shown = Some(key);
        let messages = in_background(move || {
            let (drawing, stamp) = inputs.map(draw).unwrap_or_default();
            (marker_arrays(drawing.shapes, &stamp), drawing.note)
        });
        let (messages, note) = messages.await?;
        if !note.is_empty() {
            self.node.info(note);
        }
        self.series.replace(messages).await
    }
}

/// A topic of a point cloud and what is on it.
struct CloudCanvas {
    publisher: Publisher<PointCloud2>,
    shown: Option<Key>,
    node: Node,
    topic: &'static str,
}

impl CloudCanvas {
    fn new(node: &Node, topic: &'static str) -> Result<Self, RuntimeError> {
        let publisher = node.publisher(topic, Qos::Status)?;
        Ok(Self { publisher, shown: None, node: node.clone(), topic })
    }

    /// Replaces the cloud unless it is that of `key` already; without inputs by an empty one.
    async fn show<I: Send + 'static>(
        &mut self,
        key: Key,
        inputs: Option<I>,
        draw: impl FnOnce(I) -> (Cloud, Time) + Send + 'static,
    ) -> Result<(), RuntimeError> {
        if self.shown.as_ref() == Some(&key) {
            return Ok(());
        }
        self.shown = Some(key);
        let (cloud, stamp) = in_background(move || inputs.map(draw).unwrap_or_default()).await?;
        if cloud.stride > 1 {
            let (topic, count, stride) = (self.topic, cloud.count, cloud.stride);
            self.node.info(format!("{topic} shows {count} points, one of every {stride}"));
        }
        self.publisher.publish(point_cloud(cloud, &stamp))
    }
}

impl Drawing {
    fn of(shapes: Vec<Shape>) -> Self {
        Self { shapes, note: String::new() }
    }
}
