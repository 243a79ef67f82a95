//! Actions: a server whose goals, cancels and results may all be repeated by the client, and such a client.

use std::future::Future;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use futures::{FutureExt, StreamExt, pin_mut};
use patchmill_msgs::{ActionType, cdr};
use ros2_client::action::{
    ActionClientQosPolicies, ActionServerQosPolicies, GoalId, GoalInfo, GoalStatusEnum, SendGoalRequest,
    SendGoalResponse,
};
use ros2_client::action_msgs::{CancelGoalResponse, CancelGoalResponseEnum, GoalStatus, GoalStatusArray};
use ros2_client::builtin_interfaces::Time as RosTime;
use ros2_client::qos::{Durability, History, QosProfile};
use ros2_client::{ActionTypeName, RmwRequestId, ServiceMapping};
use serde::Deserialize;
use tokio::sync::mpsc;

use crate::RuntimeError;
use crate::node::{Node, parse_name};
use crate::service::{service_qos, wait_until};
use crate::wire_type::{Wire, package_and_name};

/// The sync action server of ros2-client is asked so often: its async one loses repeated goals and late result requests.
const POLL: Duration = Duration::from_millis(20);
/// Ended goals whose results are kept.
const KEPT: usize = 16;
/// Clients repeat a goal after this, and the request for the result.
const GOAL_ATTEMPT: Duration = Duration::from_secs(1);
const RESULT_ATTEMPT: Duration = Duration::from_secs(5);
/// A server that is gone while a goal runs is waited for so long; one that was started again says that it does not know the goal.
const RETURN_PATIENCE: Duration = Duration::from_secs(20);

type Server<A> = ros2_client::ActionServer<
    Wire<<A as ActionType>::Goal>,
    Wire<<A as ActionType>::Result>,
    Wire<<A as ActionType>::Feedback>,
>;
type Client<A> = ros2_client::ActionClient<
    Wire<<A as ActionType>::Goal>,
    Wire<<A as ActionType>::Result>,
    Wire<<A as ActionType>::Feedback>,
>;

/// How a goal ended.
#[derive(Clone, Debug, PartialEq)]
pub enum ActionEnd<R> {
    /// The goal was reached.
    Succeeded(R),
    /// The server gave up.
    Aborted(R),
    /// The client cancelled.
    Canceled(R),
}

impl<R> ActionEnd<R> {
    /// The result, however it ended.
    pub fn result(&self) -> &R {
        match self {
            Self::Succeeded(r) | Self::Aborted(r) | Self::Canceled(r) => r,
        }
    }

    fn into_parts(self) -> (GoalStatusEnum, R) {
        match self {
            Self::Succeeded(r) => (GoalStatusEnum::Succeeded, r),
            Self::Aborted(r) => (GoalStatusEnum::Aborted, r),
            Self::Canceled(r) => (GoalStatusEnum::Canceled, r),
        }
    }
}

/// What a running goal may do.
pub struct GoalContext<A: ActionType> {
    id: GoalId,
    events: mpsc::UnboundedSender<Event<A>>,
    cancelled: Arc<AtomicBool>,
    cancel: Arc<tokio::sync::Notify>,
}

impl<A: ActionType> GoalContext<A> {
    /// Tells the client how it goes.
    pub fn feedback(&self, feedback: A::Feedback) {
        // The server may have been shut down.
        let _ = self.events.send(Event::Feedback(self.id, feedback));
    }

    /// Whether the client wants no more.
    pub fn is_cancelled(&self) -> bool {
        self.cancelled.load(Ordering::Relaxed)
    }

    /// Resolves when the client wants no more.
    pub async fn cancelled(&self) {
        while !self.is_cancelled() {
            self.cancel.notified().await;
        }
    }
}

enum Event<A: ActionType> {
    Feedback(GoalId, A::Feedback),
    End(GoalId, GoalStatusEnum, A::Result),
}

struct Goal<R> {
    id: GoalId,
    accepted: RosTime,
    status: GoalStatusEnum,
    result: Option<R>,
    waiting: Vec<RmwRequestId>,
    cancelled: Arc<AtomicBool>,
    cancel: Arc<tokio::sync::Notify>,
}

impl<R> Goal<R> {
    fn info(&self) -> GoalInfo {
        GoalInfo { goal_id: self.id, stamp: self.accepted }
    }
}

impl Node {
    /// Serves an action. `accept` looks at a goal (`Err`: rejected, with the reason logged), `run` works on an accepted
    /// one; several may run at once. A goal repeated by its client is accepted again but runs once.
    ///
    /// # Errors
    /// When the name is none or DDS refuses.
    pub fn serve_action<A, F, Fut>(
        &self,
        name: &str,
        accept: impl Fn(&A::Goal) -> Result<(), String> + Send + 'static,
        run: F,
    ) -> Result<(), RuntimeError>
    where
        A: ActionType,
        F: Fn(A::Goal, GoalContext<A>) -> Fut + Send + 'static,
        Fut: Future<Output = ActionEnd<A::Result>> + Send + 'static,
    {
        let name = self.resolve(name);
        let ros_name = parse_name(&name)?;
        let (package, action) = package_and_name(A::NAME);
        let type_name = ActionTypeName::new(package, action);
        let server: Server<A> = self.with_node(&name, |node| {
            let qos = ActionServerQosPolicies {
                goal_service: service_qos(),
                result_service: service_qos(),
                cancel_service: service_qos(),
                feedback_publisher: service_qos(),
                status_publisher: status_qos(),
            };
            node.create_action_server(ServiceMapping::Enhanced, &ros_name, &type_name, qos)
                .map_err(|e| e.to_string())
        })?;
        let (events, receiver) = mpsc::unbounded_channel();
        let task = ServerTask { server, goals: Vec::new(), events, node: self.clone(), name, accept, run };
        self.spawn(task.run(receiver));
        Ok(())
    }

    /// A client of an action.
    ///
    /// # Errors
    /// When the name is none or DDS refuses.
    pub fn action_client<A: ActionType>(&self, name: &str) -> Result<ActionClient<A>, RuntimeError> {
        let name = self.resolve(name);
        let ros_name = parse_name(&name)?;
        let (package, action) = package_and_name(A::NAME);
        let type_name = ActionTypeName::new(package, action);
        let client = self.with_node(&name, |node| {
            let qos = ActionClientQosPolicies {
                goal_service: service_qos(),
                result_service: service_qos(),
                cancel_service: service_qos(),
                feedback_subscription: service_qos(),
                status_subscription: status_qos(),
            };
            node.create_action_client(ServiceMapping::Enhanced, &ros_name, &type_name, qos)
                .map_err(|e| e.to_string())
        })?;
        Ok(ActionClient { client, node: self.clone(), name })
    }
}

fn status_qos() -> QosProfile {
    service_qos().durability(Durability::TransientLocal).history(History::KeepLast { depth: 1 })
}

struct ServerTask<A: ActionType, C, F> {
    server: Server<A>,
    goals: Vec<Goal<A::Result>>,
    events: mpsc::UnboundedSender<Event<A>>,
    node: Node,
    name: String,
    accept: C,
    run: F,
}

impl<A, C, F, Fut> ServerTask<A, C, F>
where
    A: ActionType,
    C: Fn(&A::Goal) -> Result<(), String> + Send,
    F: Fn(A::Goal, GoalContext<A>) -> Fut + Send,
    Fut: Future<Output = ActionEnd<A::Result>> + Send + 'static,
{
    async fn run(mut self, mut events: mpsc::UnboundedReceiver<Event<A>>) {
        let mut poll = tokio::time::interval(POLL);
        poll.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        loop {
            tokio::select! {
                _ = poll.tick() => {
                    self.take_goals();
                    self.take_cancels();
                    self.take_result_requests();
                }
                Some(event) = events.recv() => self.take_event(event),
            }
        }
    }

    fn take_goals(&mut self) {
        loop {
            match self.server.receive_goal() {
                Ok(None) => break,
                Ok(Some((request, goal))) => self.take_goal(request, goal),
                Err(e) => self.node.warn(format!("a goal of {} was dropped: {e}", self.name)),
            }
        }
    }

    fn take_goal(
        &mut self,
        request: RmwRequestId,
        SendGoalRequest { goal_id, goal: Wire(goal) }: SendGoalRequest<Wire<A::Goal>>,
    ) {
        let known = self.goals.iter().find(|g| g.id == goal_id).map(|g| g.accepted);
        let (accepted, stamp) = match known {
            Some(stamp) => (true, stamp),
            None => match (self.accept)(&goal) {
                Err(why) => {
                    self.node.warn(format!("a goal of {} was rejected: {why}", self.name));
                    (false, RosTime::now())
                }
                Ok(()) => (true, self.start(goal_id, goal)),
            },
        };
        self.sent(
            "an answer to a goal",
            self.server.send_goal_response(request, SendGoalResponse { accepted, stamp }).is_ok(),
        );
        if known.is_none() && accepted {
            self.publish_statuses();
        }
    }

    fn start(&mut self, id: GoalId, goal: A::Goal) -> RosTime {
        let accepted = RosTime::now();
        let cancelled = Arc::new(AtomicBool::new(false));
        let cancel = Arc::new(tokio::sync::Notify::new());
        let context = GoalContext {
            id,
            events: self.events.clone(),
            cancelled: Arc::clone(&cancelled),
            cancel: Arc::clone(&cancel),
        };
        let (work, events) = ((self.run)(goal, context), self.events.clone());
        self.node.spawn(async move {
            let end = match std::panic::AssertUnwindSafe(work).catch_unwind().await {
                Ok(end) => end,
                Err(_) => ActionEnd::Aborted(A::Result::default()),
            };
            let (status, result) = end.into_parts();
            let _ = events.send(Event::End(id, status, result));
        });
        let status = GoalStatusEnum::Executing;
        self.goals.push(Goal { id, accepted, status, result: None, waiting: Vec::new(), cancelled, cancel });
        accepted
    }

    fn take_cancels(&mut self) {
        loop {
            match self.server.receive_cancel_request() {
                Ok(None) => break,
                Err(e) => self.node.warn(format!("a cancel of {} was dropped: {e}", self.name)),
                Ok(Some((request, cancel))) => {
                    // ros2-client keeps the fields to itself; the bytes are the standard ones.
                    let Ok(wanted) = cdr::from_cdr::<Cancel>(&cdr::to_cdr(&cancel)) else { continue };
                    let response = self.cancel(&wanted);
                    self.sent(
                        "an answer to a cancel",
                        self.server.send_cancel_response(request, response).is_ok(),
                    );
                    self.publish_statuses();
                }
            }
        }
    }

    /// By the rules of action_msgs/srv/CancelGoal: a zero id means all goals, a stamp those accepted until then.
    fn cancel(&mut self, wanted: &Cancel) -> CancelGoalResponse {
        let (any_id, any_time) = (wanted.id == [0; 16], (wanted.sec, wanted.nanosec) == (0, 0));
        let until = i64::from(wanted.sec) * 1_000_000_000 + i64::from(wanted.nanosec);
        let mut goals_canceling = Vec::new();
        let (mut known, mut ended) = (false, false);
        for goal in &mut self.goals {
            let by_id = !any_id && *goal.id.uuid.as_bytes() == wanted.id;
            let by_time = !any_time && goal.accepted.to_nanos() <= until;
            if !(by_id || by_time || (any_id && any_time)) {
                continue;
            }
            known = true;
            if goal.result.is_some() {
                ended |= by_id;
                continue;
            }
            goal.status = GoalStatusEnum::Canceling;
            goal.cancelled.store(true, Ordering::Relaxed);
            goal.cancel.notify_waiters();
            goal.cancel.notify_one();
            goals_canceling.push(goal.info());
        }
        let return_code = match (goals_canceling.is_empty(), known, ended) {
            (false, ..) => CancelGoalResponseEnum::None,
            (true, false, _) if !any_id => CancelGoalResponseEnum::UnknownGoal,
            (true, _, true) => CancelGoalResponseEnum::GoalTerminated,
            (true, ..) => CancelGoalResponseEnum::Rejected,
        };
        CancelGoalResponse { return_code, goals_canceling }
    }

    fn take_result_requests(&mut self) {
        loop {
            match self.server.receive_result_request() {
                Ok(None) => break,
                Err(e) => self.node.warn(format!("a result request of {} was dropped: {e}", self.name)),
                Ok(Some((request, wanted))) => match self.goals.iter_mut().find(|g| g.id == wanted.goal_id) {
                    None => self.send_result(request, GoalStatusEnum::Unknown, A::Result::default()),
                    Some(goal) => match goal.result.clone() {
                        None => goal.waiting.push(request),
                        Some(result) => {
                            let status = goal.status;
                            self.send_result(request, status, result);
                        }
                    },
                },
            }
        }
    }

    fn take_event(&mut self, event: Event<A>) {
        match event {
            Event::Feedback(id, feedback) => {
                let sent = self.server.send_feedback(id, Wire(feedback)).is_ok();
                self.sent("feedback", sent);
            }
            Event::End(id, status, result) => {
                let Some(goal) = self.goals.iter_mut().find(|g| g.id == id) else { return };
                goal.status = status;
                goal.result = Some(result.clone());
                for request in std::mem::take(&mut goal.waiting) {
                    self.send_result(request, status, result.clone());
                }
                self.publish_statuses();
                self.forget_old_goals();
            }
        }
    }

    fn send_result(&self, request: RmwRequestId, status: GoalStatusEnum, result: A::Result) {
        let response = ros2_client::action::GetResultResponse { status, result: Wire(result) };
        self.sent("a result", self.server.send_result(request, response).is_ok());
    }

    fn forget_old_goals(&mut self) {
        while self.goals.iter().filter(|g| g.result.is_some()).count() > KEPT {
            if let Some(oldest) = self.goals.iter().position(|g| g.result.is_some()) {
                self.goals.remove(oldest);
            }
        }
    }

    fn publish_statuses(&self) {
        let status_list =
            self.goals.iter().map(|g| GoalStatus { goal_info: g.info(), status: g.status }).collect();
        self.sent("a goal status", self.server.send_goal_statuses(GoalStatusArray { status_list }).is_ok());
    }

    fn sent(&self, what: &str, sent: bool) {
        if !sent {
            self.node.warn(format!("{what} of {} could not be sent", self.name));
        }
    }
}

/// action_msgs/srv/CancelGoal_Request.
#[derive(Deserialize)]
struct Cancel {
    id: [u8; 16],
    sec: i32,
    nanosec: u32,
}

/// Sends goals to an action server.
pub struct ActionClient<A: ActionType> {
    client: Client<A>,
    node: Node,
    name: String,
}

impl<A: ActionType> ActionClient<A> {
    /// Sends a goal and follows it to its end. `patience` is for finding the server and being accepted. Resolving
    /// `cancel` asks the server to cancel; the end is waited for all the same.
    ///
    /// # Errors
    /// [`RuntimeError::Unavailable`], [`RuntimeError::NoAnswer`] or [`RuntimeError::Rejected`]; [`RuntimeError::Forgotten`] when
    /// the server was started anew while the goal ran, [`RuntimeError::Lost`] when it went away and stays away.
    pub async fn execute(
        &self,
        goal: A::Goal,
        patience: Duration,
        mut feedback: impl FnMut(A::Feedback),
        cancel: impl Future<Output = ()>,
    ) -> Result<ActionEnd<A::Result>, RuntimeError> {
        let id = self.send(goal, patience).await?;
        let stream = self.client.feedback_stream(id);
        let result = self.result(id);
        let cancel = cancel.fuse();
        let cancelling = futures::future::Fuse::terminated();
        pin_mut!(stream, result, cancel, cancelling);
        loop {
            futures::select! {
                end = result.as_mut().fuse() => return end,
                news = stream.select_next_some() => if let Ok(Wire(news)) = news { feedback(news) },
                () = cancel => cancelling.set(self.cancel(id).fuse()),
                () = cancelling => {}
            }
        }
    }

    async fn send(&self, goal: A::Goal, patience: Duration) -> Result<GoalId, RuntimeError> {
        let end = Instant::now() + patience;
        let unavailable = || RuntimeError::Unavailable { name: self.name.clone(), waited: patience };
        if !wait_until(end, || self.is_ready()).await {
            return Err(unavailable());
        }
        let goal_id = GoalId::new_random();
        loop {
            let left = end.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Err(RuntimeError::NoAnswer { name: self.name.clone(), waited: patience });
            }
            let request = SendGoalRequest { goal_id, goal: Wire(goal.clone()) };
            let call = self.client.goal_client().async_call_service(request);
            match tokio::time::timeout(GOAL_ATTEMPT.min(left), call).await {
                Ok(Ok(SendGoalResponse { accepted: true, .. })) => return Ok(goal_id),
                Ok(Ok(_)) => return Err(RuntimeError::Rejected { name: self.name.clone() }),
                Ok(Err(_)) | Err(_) => {}
            }
        }
    }

    fn is_ready(&self) -> bool {
        let guard = self.node.lock();
        guard.as_ref().is_some_and(|node| {
            self.client.goal_client().wait_for_service(node).now_or_never().is_some()
                && self.client.result_client().wait_for_service(node).now_or_never().is_some()
        })
    }

    async fn result(&self, goal_id: GoalId) -> Result<ActionEnd<A::Result>, RuntimeError> {
        let mut there = Instant::now();
        loop {
            if self.is_ready() {
                there = Instant::now();
            } else if there.elapsed() >= RETURN_PATIENCE {
                return Err(RuntimeError::Lost { name: self.name.clone(), waited: RETURN_PATIENCE });
            }
            let call = self.client.async_request_result(goal_id);
            let Ok(Ok((status, Wire(result)))) = tokio::time::timeout(RESULT_ATTEMPT, call).await else {
                continue;
            };
            return match status {
                GoalStatusEnum::Succeeded => Ok(ActionEnd::Succeeded(result)),
                GoalStatusEnum::Aborted => Ok(ActionEnd::Aborted(result)),
                GoalStatusEnum::Canceled => Ok(ActionEnd::Canceled(result)),
                _ => Err(RuntimeError::Forgotten { name: self.name.clone() }),
            };
        }
    }

    /// Asks until somebody answers; what becomes of it shows in the result.
    async fn cancel(&self, goal_id: GoalId) {
        loop {
            let call = self.client.async_cancel_goal(goal_id, RosTime::ZERO);
            if let Ok(Ok(_)) = tokio::time::timeout(GOAL_ATTEMPT, call).await {
                return;
            }
        }
    }
}
