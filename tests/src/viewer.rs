//! What a viewer like RViz holds of the visualization, and a robot's controller of the trajectory.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use patchmill_msgs::geometry_msgs::msg::PoseStamped;
use patchmill_msgs::sensor_msgs::msg::{JointState, PointCloud2};
use patchmill_msgs::tf2_msgs::msg::TFMessage;
use patchmill_msgs::trajectory_msgs::msg::JointTrajectory;
use patchmill_msgs::visualization_msgs::msg::{Marker, MarkerArray};
use patchmill_msgs::{RosType, std_msgs};
use patchmill_node_runtime::arguments::NodeOptions;
use patchmill_node_runtime::{Node, Qos, RuntimeError, topics};
use tokio::sync::Notify;

/// Topics of markers.
pub const MARKER_TOPICS: [&str; 4] = [
    topics::VISUALIZATION_PATCHES,
    topics::VISUALIZATION_PASSES,
    topics::VISUALIZATION_TOOL_AXES,
    topics::VISUALIZATION_TOOL,
];

/// The markers of a topic as a viewer keeps them.
#[derive(Clone, Debug, Default)]
pub struct Scene {
    /// By namespace and id.
    pub markers: BTreeMap<(String, i32), Marker>,
    /// Every message as it came.
    pub messages: Vec<MarkerArray>,
}

impl Scene {
    fn apply(&mut self, message: MarkerArray) {
        for marker in &message.markers {
            let name = (marker.ns.clone(), marker.id);
            match marker.action {
                Marker::ADD => drop(self.markers.insert(name, marker.clone())),
                Marker::DELETE => drop(self.markers.remove(&name)),
                // Of one namespace, or of all.
                Marker::DELETEALL => {
                    self.markers.retain(|(ns, _), _| !marker.ns.is_empty() && *ns != marker.ns)
                }
                _ => {}
            }
        }
        self.messages.push(message);
    }

    /// The markers whose namespace begins so.
    pub fn of<'a>(&'a self, prefix: &'a str) -> impl Iterator<Item = &'a Marker> {
        self.markers.values().filter(move |m| m.ns.starts_with(prefix))
    }
}

/// Everything that has come.
#[derive(Clone, Debug, Default)]
pub struct View {
    /// Markers by topic.
    pub scenes: BTreeMap<&'static str, Scene>,
    /// Clouds of the rolling ball's radius as they came.
    pub clouds: Vec<PointCloud2>,
    /// Clouds of what is left as they came.
    pub residuals: Vec<PointCloud2>,
    /// Parts of the trajectory as they came.
    pub trajectory: Vec<JointTrajectory>,
    /// Joint states as they came.
    pub joint_states: Vec<JointState>,
    /// Poses of the tool as they came.
    pub tool_poses: Vec<PoseStamped>,
    /// `/tf` as it came.
    pub tf: Vec<TFMessage>,
    /// `/tf_static` as it came.
    pub tf_static: Vec<TFMessage>,
    /// `robot_description` as it came.
    pub descriptions: Vec<String>,
}

impl View {
    /// The markers of a topic.
    pub fn scene(&self, topic: &str) -> Scene {
        self.scenes.get(topic).cloned().unwrap_or_default()
    }
}

/// A node that listens to all of it.
pub struct Viewer {
    node: Node,
    view: Arc<Mutex<View>>,
    news: Arc<Notify>,
}

impl Viewer {
    /// Joins the domain.
    ///
    /// # Errors
    /// When the node cannot start or listen.
    pub fn start(name: &str, domain: u16) -> Result<Self, RuntimeError> {
        let node = Node::start(NodeOptions::local(name, domain))?;
        let viewer = Self { node, view: Arc::default(), news: Arc::default() };
        for topic in MARKER_TOPICS {
            viewer.listen(topic, Qos::Series, move |view, message| {
                view.scenes.entry(topic).or_default().apply(message);
            })?;
        }
        viewer.listen(topics::ROLLING_BALL_RADIUS, Qos::Status, |view, cloud| view.clouds.push(cloud))?;
        viewer
            .listen(topics::VISUALIZATION_RESIDUAL, Qos::Status, |view, cloud| view.residuals.push(cloud))?;
        viewer.listen(topics::TRAJECTORY, Qos::Series, |view, part| view.trajectory.push(part))?;
        viewer.listen(topics::JOINT_STATES, Qos::Stream, |view, state| view.joint_states.push(state))?;
        viewer.listen(topics::TOOL_POSE, Qos::Stream, |view, pose| view.tool_poses.push(pose))?;
        viewer.listen(topics::TF, Qos::Stream, |view, tf| view.tf.push(tf))?;
        viewer.listen(topics::TF_STATIC, Qos::Status, |view, tf| view.tf_static.push(tf))?;
        viewer.listen(topics::ROBOT_DESCRIPTION, Qos::Status, |view, text: std_msgs::msg::String| {
            view.descriptions.push(text.data)
        })?;
        Ok(viewer)
    }

    fn listen<T: RosType>(
        &self,
        topic: &str,
        qos: Qos,
        mut take: impl FnMut(&mut View, T) + Send + 'static,
    ) -> Result<(), RuntimeError> {
        let (view, news) = (Arc::clone(&self.view), Arc::clone(&self.news));
        self.node.subscribe_with(topic, qos, move |message| {
            take(&mut view.lock().unwrap_or_else(PoisonError::into_inner), message);
            news.notify_one();
        })?;
        Ok(())
    }

    /// The node, for what else it is to do.
    pub fn node(&self) -> &Node {
        &self.node
    }

    fn lock(&self) -> MutexGuard<'_, View> {
        self.view.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What has come when `enough` first says so; `Err` with what has come when the time is over before.
    ///
    /// # Errors
    /// See above.
    pub async fn when(&self, patience: Duration, enough: impl Fn(&View) -> bool) -> Result<View, Box<View>> {
        let waiting = async {
            loop {
                let news = self.news.notified();
                if enough(&self.lock()) {
                    return;
                }
                news.await;
            }
        };
        let in_time = tokio::time::timeout(patience, waiting).await;
        let view = self.lock().clone();
        if in_time.is_ok() { Ok(view) } else { Err(Box::new(view)) }
    }
}
