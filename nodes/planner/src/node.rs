//! The planner's node: serves the action `plan_surface`. It loads the surface, publishes the job, follows the stages.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use patchmill_msgs::action::{PlanSurface, PlanSurfaceFeedback, PlanSurfaceGoal, PlanSurfaceResult};
use patchmill_msgs::builtin_interfaces::msg::Time;
use patchmill_msgs::msg::{Evaluation, Job as JobMessage, ProgramManifest, StageStatus};
use patchmill_msgs::srv::{LoadSurface, LoadSurfaceRequest, LoadSurfaceResponse};
use patchmill_node_runtime::{
    ActionEnd, GoalContext, Heartbeat, JobTag, LargeProduct, Node, NodeOptions, ParameterSet, Publisher, Qos,
    RuntimeError, ServiceClient, status, topics,
};
use patchmill_products::job::Job;
use patchmill_products::program::Program;
use patchmill_products::stage::{SUPERSEDED, StageError};
use tokio::sync::{broadcast, watch};

use crate::stage_watch::{Change, SILENCE, StageWatch};

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
/// A stage was lost while planning and did not come back.
pub const STAGE_LOST: i32 = 606;

/// The surface is another one after surface_ingestion was lost while planning.
pub const SURFACE_CHANGED: i32 = 607;

/// How long all stages may take to show up, and a call of `load_surface` until it is repeated.
const STAGES_PATIENCE: Duration = Duration::from_secs(15);
const LOAD_ATTEMPT: Duration = Duration::from_secs(10);
/// The planner looks after the stages' signs of life so often.
const LOOK: Duration = Duration::from_millis(250);
/// A failure that came while a stage was away counts only when it still stands so long after its return.
const RECOVERY: Duration = Duration::from_secs(20);

/// The parameters of the node.
pub fn parameters() -> ParameterSet {
    ParameterSet::new()
        .double("load_timeout_s", 300.0, 1.0..=3600.0, "longest time for loading a surface [s]")
        .double(
            "return_timeout_s",
            60.0,
            1.0..=3600.0,
            "longest wait for a stage that was lost while planning [s]",
        )
        .double("stall_timeout_s", 120.0, 1.0..=3600.0, "longest silence of all stages while planning [s]")
}

/// Starts the node. It runs until it is shut down.
///
/// # Errors
/// When the node cannot join the domain or a parameter is refused.
pub fn start(options: NodeOptions) -> Result<Node, RuntimeError> {
    let node = Node::start(options)?;
    node.give_signs_of_life()?;
    let (events, _) = broadcast::channel(1024);
    let front = Arc::new(Front {
        jobs: node.publisher(topics::JOB, Qos::Status)?,
        load: node.service_client(topics::LOAD_SURFACE)?,
        events,
        watch: Mutex::new(StageWatch::of(&topics::nodes::STAGES)),
        newest: watch::channel(0).0,
        node: node.clone(),
    });
    for stage in topics::nodes::STAGES {
        let front = Arc::clone(&front);
        node.subscribe_with(&topics::status(stage), Qos::Status, move |status: StageStatus| {
            // Whatever else is said on its topic, a stage does not say it.
            if status.node == stage {
                front.watch().met(stage, Instant::now());
                front.tell(Event::Status(Box::new(status)));
            }
        })?;
    }
    let watcher = Arc::clone(&front);
    node.watch_heartbeats(move |heartbeat| watcher.hear(&heartbeat))?;
    let (watcher, mut clock) = (Arc::clone(&front), tokio::time::interval(LOOK));
    node.spawn(async move {
        loop {
            clock.tick().await;
            let changes = watcher.watch().fallen_silent(Instant::now());
            changes.into_iter().for_each(|change| watcher.tell_change(change));
        }
    });
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
    Stage(Change),
}

struct Front {
    jobs: Publisher<JobMessage>,
    load: ServiceClient<LoadSurface>,
    events: broadcast::Sender<Event>,
    watch: Mutex<StageWatch>,
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
    fn watch(&self) -> MutexGuard<'_, StageWatch> {
        self.watch.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn hear(&self, heartbeat: &Heartbeat) {
        let change = self.watch().heard(&heartbeat.stage, &heartbeat.started, heartbeat.up, Instant::now());
        if let Some(change) = change {
            self.tell_change(change);
        }
    }

    fn tell_change(&self, change: Change) {
        match &change {
            Change::Gone(stage) => self.node.error(format!("{stage} is gone: {}", silent())),
            Change::Back(stage) => self.node.info(format!("{stage} is back")),
            Change::Restarted(stage) => self.node.info(format!("{stage} was restarted")),
            Change::Twice(stage) => self.node.error(twice(stage)),
        }
        self.tell(Event::Stage(change));
    }

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
            // In this order: who is cancelled and superseded at once must not withdraw the newer goal's job.
            biased;
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
                Ok(()) => {
                    self.node.info(format!("{}{}", result.text, ids_of(&result)));
                    return ActionEnd::Succeeded(result);
                }
                Err(failure) => failure,
            },
        };
        self.node.warn(format!("no plan: {}: {}{}", failure.stage, failure.error, ids_of(&result)));
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
        self.node.info(format!("planning{}", tag.in_log()));
        let mut run = Run {
            tag,
            context,
            result,
            at_work: BTreeSet::new(),
            running: BTreeMap::new(),
            failures: BTreeMap::new(),
            disturbed: None,
        };
        let mut events = self.events.subscribe();
        self.jobs.publish(message).map_err(|e| Failure::here(COMMUNICATION, e.to_string()))?;
        let silence = Duration::from_secs_f64(self.node.double("stall_timeout_s").unwrap_or(120.0));
        let patience = self.return_patience();
        let mut heard = Instant::now();
        loop {
            match tokio::time::timeout(LOOK, events.recv()).await {
                Ok(Ok(Event::Stage(change))) => {
                    run.take_change(&change, patience);
                    if change == Change::Restarted(topics::nodes::SURFACE_INGESTION.to_owned()) {
                        let again = self.load(goal, context).await?;
                        run.check_surface(&again.surface_id)?;
                    }
                    heard = Instant::now();
                }
                Ok(Ok(event)) => {
                    run.take(event)?;
                    heard = Instant::now();
                }
                // Feedback lost under load; what counts is latched and comes again with the next event.
                Ok(Err(broadcast::error::RecvError::Lagged(_))) => {}
                Ok(Err(broadcast::error::RecvError::Closed)) => {
                    return Err(Failure::here(COMMUNICATION, "the planner is shutting down"));
                }
                Err(_) => {}
            }
            if run.is_complete() {
                return Ok(());
            }
            let gone = self.watch().longest_gone(Instant::now()).map(|(s, away)| (s.to_owned(), away));
            run.check(gone, patience)?;
            if heard.elapsed() >= silence && run.disturbed.is_none() {
                return Err(run.stalled(silence));
            }
        }
    }

    async fn wait_for_stages(&self) -> Result<(), Failure> {
        let end = Instant::now() + STAGES_PATIENCE;
        loop {
            let missing: Vec<&str> = {
                let (watch, now) = (self.watch(), Instant::now());
                topics::nodes::STAGES.into_iter().filter(|stage| !watch.is_alive(stage, now)).collect()
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
            newest_cloud: goal.newest_cloud,
            cloud_wait: goal.cloud_wait,
            units: goal.units.clone(),
            selection: goal.selection.clone(),
            ..LoadSurfaceRequest::default()
        };
        // A wait that is none is surface_ingestion's to refuse.
        let wait = Duration::try_from_secs_f64(goal.cloud_wait.min(3600.0)).unwrap_or_default();
        let patience = wait + Duration::from_secs_f64(self.node.double("load_timeout_s").unwrap_or(300.0));
        let mut events = self.events.subscribe();
        let response = loop {
            // A new process knows nothing of the call to the old one.
            let restarted = Change::Restarted(stage.to_owned());
            tokio::select! {
                response = self.load.call(&request, LOAD_ATTEMPT, patience) => break response,
                lost = self.lost_or(&mut events, &restarted, context) => lost?,
            }
        };
        let response = response.map_err(|e| Failure::here(COMMUNICATION, e.to_string()))?;
        if response.code == 0 {
            return Ok(response);
        }
        let error = StageError::new(response.code, response.text);
        Err(Failure { stage: stage.to_owned(), error })
    }

    /// Tells the goal's client of lost stages until `awaited` happens.
    async fn lost_or(
        &self,
        events: &mut broadcast::Receiver<Event>,
        awaited: &Change,
        context: &GoalContext<PlanSurface>,
    ) -> Result<(), Failure> {
        let patience = self.return_patience();
        loop {
            if let Ok(Ok(Event::Stage(change))) = tokio::time::timeout(LOOK, events.recv()).await {
                context.feedback(told(&change, patience));
                if change == *awaited {
                    return Ok(());
                }
            }
            let watch = self.watch();
            if let Some((stage, away)) = watch.longest_gone(Instant::now())
                && away >= patience
            {
                return Err(lost(stage, patience));
            }
        }
    }

    fn return_patience(&self) -> Duration {
        Duration::from_secs_f64(self.node.double("return_timeout_s").unwrap_or(60.0))
    }
}

/// As [`JobTag::in_log`].
fn ids_of(result: &PlanSurfaceResult) -> String {
    let (surface_id, job_id) = (result.surface_id.clone(), result.job_id.clone());
    JobTag { surface_id, job_id, ..JobTag::default() }.in_log()
}

fn silent() -> String {
    format!("no sign of life for {} s", SILENCE.as_secs())
}

fn twice(stage: &str) -> String {
    format!("{stage} runs twice in this namespace: end one of the two, both do its work and answer its calls")
}

fn told(change: &Change, patience: Duration) -> PlanSurfaceFeedback {
    let (stage, text) = match change {
        Change::Gone(stage) => {
            let wait = patience.as_secs_f64();
            (stage, format!("{stage} is gone: {}, waiting up to {wait} s for its return", silent()))
        }
        Change::Back(stage) => (stage, format!("{stage} is back")),
        Change::Restarted(stage) => (stage, format!("{stage} was restarted and takes up the job")),
        Change::Twice(stage) => (stage, twice(stage)),
    };
    PlanSurfaceFeedback { stage: stage.clone(), fraction: 0.0, text }
}

fn lost(stage: &str, patience: Duration) -> Failure {
    let wait = patience.as_secs_f64();
    let text = format!("{stage} was lost while planning and did not come back within {wait} s");
    Failure { stage: stage.to_owned(), error: StageError::new(STAGE_LOST, text) }
}

/// A goal while the stages work on it.
struct Run<'a> {
    tag: JobTag,
    context: &'a GoalContext<PlanSurface>,
    result: &'a mut PlanSurfaceResult,
    /// Stages that have reported on this run.
    at_work: BTreeSet<String>,
    /// Stages that have begun and not ended: what they said last, and how far they were.
    running: BTreeMap<String, (f64, String)>,
    /// What stages said while another was away: the consequence of its absence, or a failure of their own.
    failures: BTreeMap<String, StageError>,
    /// When last a stage was away or came back.
    disturbed: Option<Instant>,
}

impl Run<'_> {
    fn feedback(&self, stage: &str, fraction: f64, text: String) {
        self.context.feedback(PlanSurfaceFeedback { stage: stage.to_owned(), fraction, text });
    }

    fn take(&mut self, event: Event) -> Result<(), Failure> {
        match event {
            Event::Status(status) => return self.take_status(&status),
            Event::Evaluation(evaluation) => {
                if is_of(&self.tag, &evaluation.job_id, &evaluation.header) {
                    self.result.evaluation = *evaluation;
                }
            }
            Event::Program(program) => {
                if is_of(&self.tag, &program.job_id, &program.header) {
                    // The description travels on the topic: a service answer has to fit one datagram.
                    self.result.program = ProgramManifest { machine_urdf: String::new(), ..*program };
                }
            }
            Event::Stage(_) => {}
        }
        Ok(())
    }

    fn take_status(&mut self, status: &StageStatus) -> Result<(), Failure> {
        let of_job = status.job_id == self.tag.job_id && status.job_stamp == self.tag.stamp;
        // A stage that could not take in the surface knows of no job.
        let of_surface = status.job_id.is_empty() && status.surface_id == self.tag.surface_id;
        if of_job {
            self.at_work.insert(status.node.clone());
        } else if self.at_work.contains(&status.node) && is_later(&status.job_stamp, &self.tag.stamp) {
            return Err(Failure::here(
                SUPERSEDED,
                "a newer job, not of this planner, superseded this goal's",
            ));
        }
        if status.state == StageStatus::FAILED && (of_job || of_surface) {
            let error = StageError::new(status.code, status.text.clone());
            if self.disturbed.is_none() {
                return Err(Failure { stage: status.node.clone(), error });
            }
            self.failures.insert(status.node.clone(), error);
        } else if of_job {
            self.failures.remove(&status.node);
        }
        if of_job && status.state == StageStatus::RUNNING {
            self.running.insert(status.node.clone(), (status.fraction, status.text.clone()));
        } else {
            self.running.remove(&status.node);
        }
        if of_job && matches!(status.state, StageStatus::RUNNING | StageStatus::DONE) {
            self.feedback(&status.node, status.fraction, status.text.clone());
        }
        Ok(())
    }

    /// Nothing moves any more; who stands still is named.
    fn stalled(&self, silence: Duration) -> Failure {
        let at = |(stage, (fraction, text)): (&String, &(f64, String))| {
            format!("; {stage} is at {:.0} % of: {text}", fraction * 100.0)
        };
        let standing: String = self.running.iter().map(at).collect();
        let text = format!("no stage reported anything for {} s{standing}", silence.as_secs_f64());
        Failure::here(STALLED, text)
    }

    /// A newer cloud, or a file that was written anew, is another surface than the one in work.
    fn check_surface(&self, loaded: &str) -> Result<(), Failure> {
        if loaded == self.tag.surface_id {
            return Ok(());
        }
        let text = format!(
            "surface_ingestion was restarted while planning and loaded another surface ({loaded}) than the one in work ({})",
            self.tag.surface_id
        );
        Err(Failure::here(SURFACE_CHANGED, text))
    }

    fn take_change(&mut self, change: &Change, patience: Duration) {
        if !matches!(change, Change::Twice(_)) {
            self.disturbed = Some(Instant::now());
        }
        self.context.feedback(told(change, patience));
    }

    /// Gives up when a stage stays away or a failure outlives its return.
    fn check(&mut self, gone: Option<(String, Duration)>, patience: Duration) -> Result<(), Failure> {
        if let Some((stage, away)) = gone {
            self.disturbed = Some(Instant::now());
            if away >= patience {
                return Err(lost(&stage, patience));
            }
        } else if self.disturbed.is_some_and(|since| since.elapsed() >= RECOVERY) {
            self.disturbed = None;
            if let Some((stage, error)) = std::mem::take(&mut self.failures).pop_first() {
                return Err(Failure { stage, error });
            }
        }
        Ok(())
    }

    fn is_complete(&mut self) -> bool {
        let complete = !self.result.program.job_id.is_empty() && !self.result.evaluation.job_id.is_empty();
        if complete {
            let program = &self.result.program;
            self.result.text =
                format!("{} patches in {:.1} s", program.patches.len(), program.machining_time);
        }
        complete
    }
}

/// Without a job there is no stamp.
fn is_later(stamp: &Time, than: &Time) -> bool {
    (stamp.sec, stamp.nanosec) > (than.sec, than.nanosec)
}

fn is_of(tag: &JobTag, job_id: &str, header: &patchmill_msgs::std_msgs::msg::Header) -> bool {
    tag.job_id == job_id && tag.stamp == header.stamp
}
