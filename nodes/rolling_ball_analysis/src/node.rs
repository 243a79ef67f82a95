//! The node shell: takes job, mesh and samples, gives `analysis/rolling_ball_field`.

use std::sync::Arc;

use patchmill_geometry::mesh::TriangleMesh;
use patchmill_msgs::msg;
use patchmill_node_runtime::{
    JobTag, Latest, Node, NodeOptions, ParameterSet, ProductReceiver, ProductServer, Qos, RecomputeServer,
    RuntimeError, StageRunner, StatusPublisher, Subscription, Value, topics,
};
use patchmill_products::field::RollingBallField;
use patchmill_products::job::Job;
use patchmill_products::samples::SurfaceSamples;
use patchmill_products::stage::StageError;

use crate::{AnalysisParams, ShadowKind, analyse, check_tool_fits};

/// First code of this stage's hundred: an input that cannot be read.
const BAD_MESSAGE: i32 = 200;

/// Values of the parameter `shadow`.
const EXACT: &str = "exact";
const CIRCLES: &str = "circles";

/// The parameters of the node.
pub fn parameters() -> ParameterSet {
    ParameterSet::new()
        .text("shadow", EXACT, "points of the shadow: exact (all of the surface) or circles (the paper's)")
        .checked(|value| match value {
            Value::Text(text) if [EXACT, CIRCLES].contains(&text.as_str()) => Ok(()),
            _ => Err(format!("expected {EXACT} or {CIRCLES}")),
        })
        .double(
            "shadow_factor",
            1.0,
            0.0..=100.0,
            "shadow radius in units of 2·R1+R2, at least 1; 0: the whole part",
        )
        .checked(|value| match value {
            Value::Double(factor) if *factor > 0.0 && *factor < 1.0 => Err("expected 0 or at least 1".into()),
            _ => Ok(()),
        })
        .integer("shadow_circles", 5, 1..=100, "circles: concentric circles of shadow-check points")
        .integer("points_per_circle", 100, 3..=10_000, "circles: shadow-check points on each circle")
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
        meshes: ProductReceiver::new(&node)?,
        samples: ProductReceiver::new(&node)?,
        recompute: RecomputeServer::new(&node, BAD_MESSAGE)?,
        field: ProductServer::new(&node)?,
        runner: StageRunner::new(StatusPublisher::new(&node)?),
        job: None,
        mesh: Latest::default(),
        sample: Latest::default(),
        started: None,
        node: node.clone(),
    };
    node.spawn(shell.run());
    Ok(node)
}

struct Shell {
    jobs: Subscription<msg::Job>,
    meshes: ProductReceiver<TriangleMesh>,
    samples: ProductReceiver<SurfaceSamples>,
    recompute: RecomputeServer,
    field: ProductServer<RollingBallField>,
    runner: StageRunner<RollingBallField>,
    job: Option<(JobTag, Arc<Job>)>,
    mesh: Latest<String, TriangleMesh>,
    sample: Latest<String, SurfaceSamples>,
    started: Option<JobTag>,
    node: Node,
}

impl Shell {
    async fn run(mut self) {
        loop {
            tokio::select! {
                Some(job) = self.jobs.next() => self.take_job(&job),
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
                call = self.recompute.next() => {
                    if let Some(call) = call.accept(self.job.as_ref().map(|(tag, _)| tag)) {
                        self.started = None;
                        call.answer(Ok(()));
                    }
                }
                (tag, result) = self.runner.finished() => self.publish(tag, result).await,
                else => return,
            }
            if let Err(e) = self.start_when_complete() {
                self.node.error(e.to_string());
            }
        }
    }

    fn take_job(&mut self, message: &msg::Job) {
        self.job = self.runner.take_job(message, BAD_MESSAGE);
        self.started = None;
    }

    fn start_when_complete(&mut self) -> Result<(), RuntimeError> {
        let Some((tag, job)) = &self.job else { return Ok(()) };
        if self.started.as_ref() == Some(tag) {
            return Ok(());
        }
        let (mesh, samples) = (self.mesh.of(&tag.surface_id), self.sample.of(&tag.surface_id));
        let (Some(mesh), Some(samples)) = (mesh, samples) else {
            self.runner.status().waiting(tag, "waiting for the surface's mesh and samples");
            return Ok(());
        };
        let params = AnalysisParams {
            shadow: if self.node.text("shadow")? == CIRCLES {
                ShadowKind::Circles
            } else {
                ShadowKind::Exact
            },
            shadow_circles: self.node.integer("shadow_circles")? as usize,
            points_per_circle: self.node.integer("points_per_circle")? as usize,
            shadow_factor: self.node.double("shadow_factor")?,
            ..AnalysisParams::default()
        };
        let job = Arc::clone(job);
        self.started = Some(tag.clone());
        self.runner.start(tag.clone(), "inflating the rolling balls", move |progress| {
            let field = analyse(&mesh, &samples, &job, &params, progress)?;
            check_tool_fits(&samples, &field, &job)?;
            Ok(field)
        });
        Ok(())
    }

    async fn publish(&mut self, tag: JobTag, result: Result<RollingBallField, StageError>) {
        let Ok(field) = result else { return };
        match self.field.publish(&field, &tag.provenance()).await {
            Ok(_) => {
                let most = field.pseudo_curvature.iter().copied().fold(f64::NEG_INFINITY, f64::max);
                let ball = if most > 0.0 {
                    format!("smallest concave ball {:.2} mm", 1e3 / most)
                } else {
                    "no concave ball".to_owned()
                };
                let text = format!("{} balls inflated, {ball}", field.pseudo_curvature.len());
                self.runner.status().done(&tag, &text);
            }
            Err(e) => self.runner.status().failed(&tag, &e.with_code(BAD_MESSAGE)),
        }
    }
}
