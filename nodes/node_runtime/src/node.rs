//! A node: its own DDS participant and ROS context, with publishers and subscriptions.

use std::future::Future;
use std::net::Ipv4Addr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use futures::{StreamExt, pin_mut};
use patchmill_msgs::RosType;
use patchmill_msgs::builtin_interfaces::msg::Time;
use ros2_client::builtin_interfaces::Time as RosTime;
use ros2_client::dds::rustdds::{DomainParticipant, DomainParticipantBuilder, RTPSEntity, Topic, TopicKind};
use ros2_client::rosout::RosoutRaw;
use ros2_client::{Context, Gid, MessageTypeName, Name, NodeName};
use tokio::sync::{mpsc, watch};
use tokio::task::AbortHandle;

use crate::RuntimeError;
use crate::arguments::{Arguments, NodeOptions};
use crate::log::{Level, say_on_stderr};
use crate::parameters::Value;
use crate::printable;
use crate::qos::Qos;
use crate::security::protected;
use crate::status;
use crate::wire_type::package_and_name;

/// Messages of a [`Subscription`] that wait to be taken, at most.
pub const WAITING: usize = 64;

/// A running node. Cloning gives another handle to the same node.
#[derive(Clone)]
pub struct Node {
    shared: Arc<Shared>,
}

struct Shared {
    arguments: Arguments,
    name: NodeName,
    context: Context,
    /// `None` after shutdown.
    node: Mutex<Option<ros2_client::Node>>,
    tasks: Mutex<Vec<AbortHandle>>,
    started: Time,
    begin: Instant,
    gave_up: watch::Sender<Option<String>>,
}

impl Node {
    /// Joins the domain. Must be called within a tokio runtime.
    ///
    /// # Errors
    /// When a parameter is unknown or out of bounds, the name is none, or the DDS participant cannot be made.
    pub fn start(options: NodeOptions) -> Result<Self, RuntimeError> {
        let NodeOptions { arguments, parameters } = options;
        let values = parameters.start_values(&arguments)?;
        let name = NodeName::new(&arguments.namespace, &arguments.name)
            .map_err(|e| RuntimeError::create(format!("node '{}'", arguments.name), e))?;
        let context = join(&arguments)?;

        // The parameter services validate before they set (see `parameter_services`).
        let mut ros_options = ros2_client::NodeOptions::new().start_parameter_services(false);
        for (name, value) in &values {
            ros_options = ros_options.declare_parameter(name, value.to_ros());
        }
        let what = || format!("node {}", name.fully_qualified_name());
        let mut node =
            context.new_node(name.clone(), ros_options).map_err(|e| RuntimeError::create(what(), e))?;
        let spinner = node.spinner().map_err(|e| RuntimeError::create(what(), e))?;
        let this = Self {
            shared: Arc::new(Shared {
                arguments,
                name,
                context,
                node: Mutex::new(Some(node)),
                tasks: Mutex::new(Vec::new()),
                started: status::now(),
                begin: Instant::now(),
                gave_up: watch::channel(None).0,
            }),
        };
        // Not among the tasks that shutdown aborts: it ends by itself when the node is dropped.
        tokio::spawn(async move { spinner.spin().await.is_ok() });
        this.serve_parameters(&Arc::new(parameters))?;
        Ok(this)
    }

    /// The node's name without namespace.
    pub fn name(&self) -> &str {
        self.shared.name.base_name()
    }

    /// Its part in the stack: the name it has unless renamed (`-r __node:=`). Topics and services are named by it.
    pub fn role(&self) -> &str {
        &self.shared.arguments.role
    }

    /// The namespace, without a slash at its end.
    pub fn namespace(&self) -> &str {
        self.shared.arguments.namespace.trim_end_matches('/')
    }

    /// Name with namespace.
    pub fn full_name(&self) -> String {
        self.shared.name.fully_qualified_name()
    }

    /// The domain.
    pub fn domain(&self) -> u16 {
        self.shared.arguments.domain
    }

    /// The absolute name after remapping.
    pub fn resolve(&self, name: &str) -> String {
        self.shared.arguments.resolve(name)
    }

    /// When it started.
    pub(crate) fn started(&self) -> &Time {
        &self.shared.started
    }

    /// The same by a clock that nobody sets.
    pub(crate) fn begin(&self) -> Instant {
        self.shared.begin
    }

    /// Says that the node must not run on; the first reason counts.
    pub(crate) fn give_up(&self, reason: String) {
        self.shared.gave_up.send_if_modified(|told| {
            let first = told.is_none();
            told.get_or_insert(reason);
            first
        });
    }

    /// Resolves once the node must not run on, with the reason. Its owner shuts it down then.
    pub async fn gave_up(&self) -> RuntimeError {
        let mut told = self.shared.gave_up.subscribe();
        // The sender lives as long as this handle.
        let reason = told.wait_for(Option::is_some).await.map(|reason| reason.clone());
        RuntimeError::GaveUp(reason.ok().flatten().unwrap_or_default())
    }

    /// [`Node::gave_up`] of the first of some nodes, of which there is at least one.
    pub async fn one_gave_up(nodes: &[Node]) -> RuntimeError {
        futures::future::select_all(nodes.iter().map(|node| Box::pin(node.gave_up()))).await.0
    }

    /// Writes a log line to stderr and `/rosout`.
    pub fn log(&self, level: Level, text: impl AsRef<str>) {
        if level < self.shared.arguments.log_level {
            return;
        }
        let text = &*printable(text.as_ref());
        say_on_stderr(format_args!("[{level}] [{}] {text}", self.name()));
        if let Some(node) = self.lock().as_ref() {
            node.rosout_raw(RosTime::now(), level.ros(), self.name(), text, "", "", 0);
        }
    }

    /// [`Node::log`] with [`Level::Info`].
    pub fn info(&self, text: impl AsRef<str>) {
        self.log(Level::Info, text);
    }

    /// [`Node::log`] with [`Level::Warn`].
    pub fn warn(&self, text: impl AsRef<str>) {
        self.log(Level::Warn, text);
    }

    /// [`Node::log`] with [`Level::Error`].
    pub fn error(&self, text: impl AsRef<str>) {
        self.log(Level::Error, text);
    }

    /// The present value of a parameter.
    ///
    /// # Errors
    /// When the node has no such parameter or has been shut down.
    pub fn parameter(&self, name: &str) -> Result<Value, RuntimeError> {
        let guard = self.lock();
        let node = guard.as_ref().ok_or(RuntimeError::Stopped)?;
        node.get_parameter(name)
            .as_ref()
            .and_then(Value::from_ros)
            .ok_or_else(|| RuntimeError::Parameter(format!("{} has no parameter '{name}'", self.name())))
    }

    /// The present value of a number parameter.
    ///
    /// # Errors
    /// As [`Node::parameter`], and when it is no number.
    pub fn double(&self, name: &str) -> Result<f64, RuntimeError> {
        match self.parameter(name)? {
            Value::Double(v) => Ok(v),
            other => {
                Err(RuntimeError::Parameter(format!("parameter '{name}' is {other}: expected a number")))
            }
        }
    }

    /// The present value of a whole-number parameter.
    ///
    /// # Errors
    /// As [`Node::parameter`], and when it is no whole number.
    pub fn integer(&self, name: &str) -> Result<i64, RuntimeError> {
        match self.parameter(name)? {
            Value::Integer(v) => Ok(v),
            other => Err(RuntimeError::Parameter(format!(
                "parameter '{name}' is {other}: expected a whole number"
            ))),
        }
    }

    /// The present value of a text parameter.
    ///
    /// # Errors
    /// As [`Node::parameter`], and when it is no text.
    pub fn text(&self, name: &str) -> Result<String, RuntimeError> {
        match self.parameter(name)? {
            Value::Text(v) => Ok(v),
            other => Err(RuntimeError::Parameter(format!("parameter '{name}' is {other}: expected text"))),
        }
    }

    /// Offers a topic.
    ///
    /// # Errors
    /// When the name is none or DDS refuses.
    pub fn publisher<T: RosType>(&self, topic: &str, qos: Qos) -> Result<Publisher<T>, RuntimeError> {
        let name = self.resolve(topic);
        let topic = self.topic::<T>(&name, qos, true)?;
        let publisher =
            self.with_node(&name, |node| node.create_publisher(&topic, None).map_err(|e| e.to_string()))?;
        Ok(Publisher { inner: Arc::new(publisher), topic: name, node: self.clone() })
    }

    /// Listens to a topic. Messages that cannot be read are logged and dropped. Of those that nobody takes the first [`WAITING`] are held,
    /// and the newest by DDS, at least as many as the topic's history has.
    ///
    /// # Errors
    /// When the name is none or DDS refuses.
    pub fn subscribe<T: RosType>(&self, topic: &str, qos: Qos) -> Result<Subscription<T>, RuntimeError> {
        let (sender, receiver) = mpsc::channel(WAITING);
        let task = self.listen(topic, qos, move |message: T| {
            let sender = sender.clone();
            async move {
                // The receiver may be gone; then nobody wants the message.
                let _ = sender.send(message).await;
            }
        })?;
        Ok(Subscription { receiver, _task: AbortOnDrop(task) })
    }

    /// Calls `receive` with every message of a topic, on a task of the runtime, until the handle is aborted or the node
    /// shut down.
    ///
    /// # Errors
    /// When the name is none or DDS refuses.
    pub fn subscribe_with<T: RosType>(
        &self,
        topic: &str,
        qos: Qos,
        mut receive: impl FnMut(T) + Send + 'static,
    ) -> Result<AbortHandle, RuntimeError> {
        self.listen(topic, qos, move |message| {
            receive(message);
            std::future::ready(())
        })
    }

    /// As [`Node::subscribe_with`]; the next message is taken from DDS when `receive` is done with the one before.
    fn listen<T: RosType, F: Future<Output = ()> + Send>(
        &self,
        topic: &str,
        qos: Qos,
        mut receive: impl FnMut(T) -> F + Send + 'static,
    ) -> Result<AbortHandle, RuntimeError> {
        let name = self.resolve(topic);
        let topic = self.topic::<T>(&name, qos, false)?;
        let subscription = self.with_node(&name, |node| {
            node.create_subscription::<T>(&topic, None).map_err(|e| e.to_string())
        })?;
        let node = self.clone();
        Ok(self.spawn(async move {
            let stream = subscription.async_stream();
            pin_mut!(stream);
            while let Some(received) = stream.next().await {
                match received {
                    Ok((message, _info)) => receive(message).await,
                    Err(e) => node.warn(format!("a message on {name} was dropped: {e}")),
                }
            }
        }))
    }

    /// Runs a task until it ends or the node is shut down.
    pub fn spawn(&self, task: impl Future<Output = ()> + Send + 'static) -> AbortHandle {
        let handle = tokio::spawn(task).abort_handle();
        let mut tasks = self.shared.tasks.lock().unwrap_or_else(PoisonError::into_inner);
        tasks.retain(|t| !t.is_finished());
        tasks.push(handle.clone());
        handle
    }

    /// Ends the node's tasks and leaves the domain. Publishers that are still held keep their topics until dropped.
    pub async fn shutdown(&self) {
        let tasks = std::mem::take(&mut *self.shared.tasks.lock().unwrap_or_else(PoisonError::into_inner));
        for task in &tasks {
            task.abort();
        }
        drop(self.lock().take());
        let deadline = Instant::now() + Duration::from_secs(1);
        while tasks.iter().any(|t| !t.is_finished()) && Instant::now() < deadline {
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
    }

    pub(crate) fn participant(&self) -> DomainParticipant {
        self.shared.context.domain_participant()
    }

    pub(crate) fn gid(&self) -> Gid {
        Gid::from(self.participant().guid())
    }

    pub(crate) fn lock(&self) -> MutexGuard<'_, Option<ros2_client::Node>> {
        self.shared.node.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(crate) fn with_node<R>(
        &self,
        what: &str,
        make: impl FnOnce(&mut ros2_client::Node) -> Result<R, String>,
    ) -> Result<R, RuntimeError> {
        let mut guard = self.lock();
        let node = guard.as_mut().ok_or(RuntimeError::Stopped)?;
        make(node).map_err(|reason| RuntimeError::create(what, reason))
    }

    pub(crate) fn topic<T: RosType>(
        &self,
        name: &str,
        qos: Qos,
        writer: bool,
    ) -> Result<Topic, RuntimeError> {
        let ros_name = parse_name(name)?;
        let (package, message) = package_and_name(T::TYPE_NAME);
        // Not Node::create_topic: it knows no resource limits, from which rustdds derives the send window.
        self.shared
            .context
            .domain_participant()
            .create_topic(
                ros_name.to_dds_name("rt", &self.shared.name, ""),
                MessageTypeName::new(package, message).dds_msg_type(),
                &qos.policies(writer),
                TopicKind::NoKey,
            )
            .map_err(|e| RuntimeError::create(format!("topic {name}"), e))
    }
}

pub(crate) fn parse_name(name: &str) -> Result<Name, RuntimeError> {
    Name::parse(name).map_err(|e| RuntimeError::create(format!("name '{name}'"), e))
}

pub(crate) fn join(arguments: &Arguments) -> Result<Context, RuntimeError> {
    let what = || format!("a DDS participant in domain {}", arguments.domain);
    let mut builder = DomainParticipantBuilder::new(arguments.domain);
    if arguments.local_only {
        builder = builder.with_only_networks([Ipv4Addr::LOCALHOST]);
    }
    let builder = protected(builder, arguments.enclave.as_deref())?;
    let participant = builder.build().map_err(|e| RuntimeError::create(what(), e))?;
    Context::from_domain_participant(participant).map_err(|e| RuntimeError::create(what(), e))
}

/// Offers a topic. Cloning gives another handle.
pub struct Publisher<T: RosType> {
    inner: Arc<ros2_client::Publisher<T>>,
    topic: String,
    node: Node,
}

impl<T: RosType> Clone for Publisher<T> {
    fn clone(&self) -> Self {
        Self { inner: Arc::clone(&self.inner), topic: self.topic.clone(), node: self.node.clone() }
    }
}

impl<T: RosType> Publisher<T> {
    /// Publishes without waiting for anybody.
    ///
    /// # Errors
    /// When the send window (8192 messages) stays full for a second.
    pub fn publish(&self, message: T) -> Result<(), RuntimeError> {
        self.inner
            .publish(message)
            .map_err(|e| RuntimeError::Publish { topic: self.topic.clone(), reason: e.to_string() })
    }

    /// Drops what was published so far: late joiners receive only what comes after.
    pub(crate) fn forget(&self) {
        self.node.shared.context.domain_participant().clear_writer_history(self.inner.guid());
    }

    pub(crate) fn topic(&self) -> &str {
        &self.topic
    }

    pub(crate) async fn publish_when_acknowledged(&self, message: T) -> Result<(), RuntimeError> {
        self.inner
            .async_publish(message)
            .await
            .map_err(|e| RuntimeError::Publish { topic: self.topic.clone(), reason: e.to_string() })
    }

    /// Subscriptions matched at present.
    pub fn subscription_count(&self) -> usize {
        self.node.lock().as_ref().map_or(0, |node| self.inner.get_subscription_count(node))
    }

    /// Waits until so many subscriptions are matched; `false` when the time is over first.
    pub async fn wait_for_subscriptions(&self, count: usize, patience: Duration) -> bool {
        let deadline = Instant::now() + patience;
        while self.subscription_count() < count {
            if Instant::now() >= deadline {
                return false;
            }
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
        true
    }
}

/// The messages of a topic in the order of arrival.
pub struct Subscription<T> {
    receiver: mpsc::Receiver<T>,
    _task: AbortOnDrop,
}

impl<T> Subscription<T> {
    /// The next message; `None` once the node has been shut down. Cancel-safe.
    pub async fn next(&mut self) -> Option<T> {
        self.receiver.recv().await
    }
}

pub(crate) struct AbortOnDrop(pub AbortHandle);

impl Drop for AbortOnDrop {
    fn drop(&mut self) {
        self.0.abort();
    }
}
