//! The planner's node: serves the action `plan_surface`. It loads the surface, publishes the job, follows the stages.

use std::collections::BTreeSet;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use patchmill_msgs::action::{PlanSurface, PlanSurfaceFeedback, PlanSurfaceGoal, PlanSurfaceResult};
use patchmill_msgs::msg::{Evaluation, Job as JobMessage, ProgramManifest, StageStatus};
use patchmill_msgs::srv::{LoadSurface, LoadSurfaceRequest, LoadSurfaceResponse};
use patchmill_node_runtime::{
    ActionEnd, GoalContext, JobTag, LargeProduct, Node, NodeOptions, ParameterSet, Publisher, Qos,
    RuntimeError, ServiceClient, status, topics,
};
use patchmill_products::job::Job;
use patchmill_products::program::Program;
use patchmill_products::stage::{SUPERSEDED, StageError};
use tokio::sync::{broadcast, watch};

/// The goal's job is not valid.
pub const BAD_JOB: i32 = 601;
/// A stage is not there.
pub const STAGE_MISSING: i32 = 602;
/// No stage reported anything for too long.
pub const STALLED: i32 = 603;
/// The planner could not publish or was left behind by the stages' messages.
pub const COMMUNICATION: i32 = 604;
/// The goal was cancelled.
pub const CANCELLED: i32 = 605;

/// How long all stages may take to show up, and a call of `load_surface` until it is repeated.
const STAGES_PATIENCE: Duration = Duration::from_secs(15);
const LOAD_ATTEMPT: Duration = Duration::from_secs(10);

/// The parameters of the node.
pub fn parameters() -> ParameterSet {
    ParameterSet::new()
        .double("load_timeout_s", 300.0, 1.0..=3600.0, "longest time for loading a surface [s]")
        .double("stall_timeout_s", 120.0, 1.0..=3600.0, "longest silence of all stages while planning [s]")
}

/// Starts the node. It runs until it is shut down.
///
/// # Errors
/// When the node cannot join the domain or a parameter is refused.
pub fn start(options: NodeOptions) -> Result<Node, RuntimeError> {
    let node = Node::start(options)?;
    let (events, _) = broadcast::channel(1024);
    let front = Arc::new(Front {
        jobs: node.publisher(topics::JOB, Qos::Status)?,
        load: node.service_client(topics::LOAD_SURFACE)?,
        events,
        seen: Mutex::default(),
        newest: watch::channel(0).0,
        node: node.clone(),
    });
    for stage in topics::nodes::STAGES {
        let front = Arc::clone(&front);
        node.subscribe_with(&topics::status(stage), Qos::Status, move |status: StageStatus| {
            front.seen.lock().unwrap_or_else(PoisonError::into_inner).insert(status.node.clone());
            front.tell(Event::Status(Box::new(status)));
        })?;
    }
    let teller = Arc::clone(&front);
    node.subscribe_with(topics::EVALUATION, Qos::Status, move |evaluation: Evaluation| {
        teller.tell(Event::Evaluation(Box::new(evaluation)));
    })?;
    let teller = Arc::clone(&front);
    node.subscribe_with(Program::MANIFEST_TOPIC, Qos::Product, move |manifest: ProgramManifest| {
        teller.tell(Event::Program(Box::new(manifest)));
    })?;
    node.serve_action::<PlanSurface, _, _>(
        topics::PLAN_SURFACE,
        |goal| Job::from_msg(&goal.job).map(|_| ()).map_err(|e| e.text),
        move |goal, context| Arc::clone(&front).plan(goal, context),
    )?;
    Ok(node)
}

/// What the stages say.
#[derive(Clone)]
enum Event {
    Status(Box<StageStatus>),
    Evaluation(Box<Evaluation>),
    Program(Box<ProgramManifest>),
}

struct Front {
    jobs: Publisher<JobMessage>,
    load: ServiceClient<LoadSurface>,
    events: broadcast::Sender<Event>,
    /// Stages whose status has been seen.
    seen: Mutex<BTreeSet<String>>,
    /// Number of the newest goal: older ones end when it changes.
    newest: watch::Sender<u64>,
    node: Node,
}

/// Why a goal failed and at which stage.
struct Failure {
    stage: String,
    error: StageError,
}

impl Failure {
    fn here(code: i32, text: impl Into<String>) -> Self {
        Self { stage: topics::nodes::PLANNER.to_owned(), error: StageError::new(code, text) }
    }
}

impl Front {
    fn tell(&self, event: Event) {
        // Without a goal nobody listens.
        let _ = self.events.send(event);
    }

    async fn plan(
        self: Arc<Self>,
        goal: PlanSurfaceGoal,
        context: GoalContext<PlanSurface>,
    ) -> ActionEnd<PlanSurfaceResult> {
        let mut number = 0;
        self.newest.send_modify(|newest| {
            *newest += 1;
            number = *newest;
        });
        let mut newest = self.newest.subscribe();
        let mut result = PlanSurfaceResult::default();
        let failure = tokio::select! {
            _ = newest.wait_for(|newest| *newest != number) => {
                Failure::here(SUPERSEDED, "a newer goal superseded this one")
            }
            () = context.cancelled() => {
                self.withdraw();
                result.code = CANCELLED;
                result.text = "the goal was cancelled".to_owned();
                return ActionEnd::Canceled(result);
            }
            done = self.follow(&goal, &context, &mut result) => match done {
                Ok(()) => return ActionEnd::Succeeded(result),
                Err(failure) => failure,
            },
        };
        result.code = failure.error.code;
        result.text = failure.error.text;
        result.stage = failure.stage;
        ActionEnd::Aborted(result)
    }

    /// Ends the stages' work on the present job.
    fn withdraw(&self) {
        let mut none = JobMessage::default();
        none.header.stamp = status::now();
        if let Err(e) = self.jobs.publish(none) {
            self.node.error(e.to_string());
        }
    }

    async fn follow(
        &self,
        goal: &PlanSurfaceGoal,
        context: &GoalContext<PlanSurface>,
        result: &mut PlanSurfaceResult,
    ) -> Result<(), Failure> {
        self.wait_for_stages().await?;
        let loaded = self.load(goal, context).await?;
        let job = Job::from_msg(&goal.job).map_err(|e| Failure::here(BAD_JOB, e.text))?;
        let job = Job { surface_id: loaded.surface_id, ..job }.with_id();
        let message = job.to_msg(status::now());
        result.surface_id.clone_from(&job.surface_id);
        result.job_id.clone_from(&job.job_id);
        let tag = JobTag::of_job(&message);
        let mut events = self.events.subscribe();
        self.jobs.publish(message).map_err(|e| Failure::here(COMMUNICATION, e.to_string()))?;
        let silence = self.node.double("stall_timeout_s").unwrap_or(120.0);
        loop {
            let event = match tokio::time::timeout(Duration::from_secs_f64(silence), events.recv()).await {
                Ok(Ok(event)) => event,
                // Feedback lost under load; what counts is latched and comes again with the next event.
                Ok(Err(broadcast::error::RecvError::Lagged(_))) => continue,
                Ok(Err(broadcast::error::RecvError::Closed)) => {
                    return Err(Failure::here(COMMUNICATION, "the planner is shutting down"));
                }
                Err(_) => {
                    return Err(Failure::here(
                        STALLED,
                        format!("no stage reported anything for {silence} s"),
                    ));
                }
            };
            match event {
                Event::Status(status) => self.take_status(&status, &tag, context)?,
                Event::Evaluation(evaluation) => {
                    if is_of(&tag, &evaluation.job_id, &evaluation.header) {
                        result.evaluation = *evaluation;
                    }
                }
                Event::Program(program) => {
                    if is_of(&tag, &program.job_id, &program.header) {
                        // The description travels on the topic: a service answer has to fit one datagram.
                        result.program = ProgramManifest { machine_urdf: String::new(), ..*program };
                    }
                }
            }
            if !result.program.job_id.is_empty() && !result.evaluation.job_id.is_empty() {
                result.text = format!(
                    "{} patches in {:.1} s",
                    result.program.patches.len(),
                    result.program.machining_time
                );
                return Ok(());
            }
        }
    }

    async fn wait_for_stages(&self) -> Result<(), Failure> {
        let end = Instant::now() + STAGES_PATIENCE;
        loop {
            let missing: Vec<&str> = {
                let seen = self.seen.lock().unwrap_or_else(PoisonError::into_inner);
                topics::nodes::STAGES.into_iter().filter(|stage| !seen.contains(*stage)).collect()
            };
            if missing.is_empty() {
                return Ok(());
            }
            if Instant::now() >= end {
                let text = format!(
                    "{} did not show up within {} s: is the node running on domain {}?",
                    missing.join(", "),
                    STAGES_PATIENCE.as_secs(),
                    self.node.domain()
                );
                return Err(Failure::here(STAGE_MISSING, text));
            }
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    }

    async fn load(
        &self,
        goal: &PlanSurfaceGoal,
        context: &GoalContext<PlanSurface>,
    ) -> Result<LoadSurfaceResponse, Failure> {
        let stage = topics::nodes::SURFACE_INGESTION;
        context.feedback(PlanSurfaceFeedback {
            stage: stage.to_owned(),
            fraction: 0.0,
            text: "loading the surface".to_owned(),
        });
        let request = LoadSurfaceRequest {
            path: goal.path.clone(),
            inline_json: goal.inline_json.clone(),
            units: goal.units.clone(),
            ..LoadSurfaceRequest::default()
        };
        let patience = Duration::from_secs_f64(self.node.double("load_timeout_s").unwrap_or(300.0));
        let response = self.load.call(&request, LOAD_ATTEMPT, patience).await;
        let response = response.map_err(|e| Failure::here(COMMUNICATION, e.to_string()))?;
        if response.code == 0 {
            return Ok(response);
        }
        let error = StageError::new(response.code, response.text);
        Err(Failure { stage: stage.to_owned(), error })
    }

    fn take_status(
        &self,
        status: &StageStatus,
        tag: &JobTag,
        context: &GoalContext<PlanSurface>,
    ) -> Result<(), Failure> {
        let of_job = status.job_id == tag.job_id && status.job_stamp == tag.stamp;
        // A stage that could not take in the surface knows of no job.
        let of_surface = status.job_id.is_empty() && status.surface_id == tag.surface_id;
        if status.state == StageStatus::FAILED && (of_job || of_surface) {
            let error = StageError::new(status.code, status.text.clone());
            return Err(Failure { stage: status.node.clone(), error });
        }
        if of_job && matches!(status.state, StageStatus::RUNNING | StageStatus::DONE) {
            context.feedback(PlanSurfaceFeedback {
                stage: status.node.clone(),
                fraction: status.fraction,
                text: status.text.clone(),
            });
        }
        Ok(())
    }
}

fn is_of(tag: &JobTag, job_id: &str, header: &patchmill_msgs::std_msgs::msg::Header) -> bool {
    tag.job_id == job_id && tag.stamp == header.stamp
}
