//! What others must know of the machine: model, description and fixed transforms, latched; joint states, transforms and
//! the tool's pose as a stream.

use std::future::Future;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use patchmill_kinematics::{AxisKind, Joints, Machine};
use patchmill_msgs::builtin_interfaces::msg::Time;
use patchmill_msgs::geometry_msgs::msg::{
    Point, Pose, PoseStamped, Quaternion, Transform, TransformStamped, Vector3,
};
use patchmill_msgs::sensor_msgs::msg::JointState;
use patchmill_msgs::std_msgs::msg::{Header, String as Text};
use patchmill_msgs::tf2_msgs::msg::TFMessage;
use patchmill_msgs::{msg, std_msgs};
use patchmill_node_runtime::{Node, Publisher, Qos, RuntimeError, status, topics};
use patchmill_products::wire::provenance::FRAME;

use crate::transforms::{LinkTransform, named_positions, transforms};

/// A machine description above this size does not go out as one message, bytes.
const LARGEST_URDF: usize = 100 * 1024;
/// How often a rate of 0 is looked at again.
const IDLE: Duration = Duration::from_millis(500);

/// The publishers.
pub(super) struct Description {
    model: Publisher<msg::MachineModel>,
    text: Publisher<Text>,
    tf_static: Publisher<TFMessage>,
    state: Arc<StateStream>,
}

impl Description {
    pub(super) fn new(node: &Node) -> Result<Self, RuntimeError> {
        Ok(Self {
            model: node.publisher(topics::MACHINE_MODEL, Qos::Status)?,
            text: node.publisher(topics::ROBOT_DESCRIPTION, Qos::Status)?,
            tf_static: node.publisher(topics::TF_STATIC, Qos::Status)?,
            state: Arc::new(StateStream {
                joints: node.publisher(topics::JOINT_STATES, Qos::Stream)?,
                tf: node.publisher(topics::TF, Qos::Stream)?,
                tool_pose: node.publisher(topics::TOOL_POSE, Qos::Stream)?,
                state: Mutex::default(),
                node: node.clone(),
            }),
        })
    }

    /// Publishes a machine, its URDF text and where its joints are (m, rad, in the order of its axes).
    pub(super) fn publish(&self, machine: &Machine, urdf: &str, joints: &Joints) -> Result<(), RuntimeError> {
        if urdf.len() > LARGEST_URDF {
            let text = format!("the URDF has {} bytes, at most {LARGEST_URDF} were expected", urdf.len());
            return Err(RuntimeError::Parameter(text));
        }
        let (fixed, moving) = links(machine, urdf, joints)?;
        let header = Header { stamp: status::now(), frame_id: String::new() };
        self.model.publish(machine_model(machine, urdf, &header))?;
        self.text.publish(std_msgs::msg::String { data: urdf.to_owned() })?;
        self.tf_static.publish(tf_message(&fixed, &header.stamp))?;
        self.state.set(State::of(machine, joints, tf_message(&moving, &header.stamp)));
        self.state.publish()
    }

    /// From now on the joints are here: goes out as often as the parameter `state_rate_hz` says, at once where it says only on change.
    pub(super) fn moved(&self, machine: &Machine, urdf: &str, joints: &Joints) -> Result<(), RuntimeError> {
        let (_, moving) = links(machine, urdf, joints)?;
        self.state.set(State::of(machine, joints, tf_message(&moving, &status::now())));
        if self.state.node.double("state_rate_hz")? > 0.0 { Ok(()) } else { self.state.publish() }
    }

    /// Publishes the state again and again, as often as the parameter `state_rate_hz` says at the time, until the node is
    /// shut down.
    pub(super) fn repeat_state(&self) -> impl Future<Output = ()> + Send + use<> {
        Arc::clone(&self.state).repeat()
    }
}

/// What is true at the moment.
#[derive(Clone, Default)]
struct State {
    joints: JointState,
    tf: TFMessage,
    tool_pose: PoseStamped,
}

impl State {
    fn of(machine: &Machine, joints: &Joints, tf: TFMessage) -> Self {
        let joint_state = JointState {
            header: Header::default(),
            name: machine.axes().iter().map(|a| a.joint_name.clone()).collect(),
            position: joints.to_vec(),
            velocity: vec![0.0; joints.len()],
            effort: Vec::new(),
        };
        Self { joints: joint_state, tf, tool_pose: tool_pose(machine, joints) }
    }

    fn stamp(&mut self, now: &Time) {
        self.joints.header.stamp = now.clone();
        self.tool_pose.header.stamp = now.clone();
        self.tf.transforms.iter_mut().for_each(|t| t.header.stamp = now.clone());
    }
}

struct StateStream {
    joints: Publisher<JointState>,
    tf: Publisher<TFMessage>,
    tool_pose: Publisher<PoseStamped>,
    state: Mutex<State>,
    node: Node,
}

impl StateStream {
    fn set(&self, state: State) {
        *self.state.lock().unwrap_or_else(PoisonError::into_inner) = state;
    }

    /// Publishes the state with the present time.
    fn publish(&self) -> Result<(), RuntimeError> {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner).clone();
        state.stamp(&status::now());
        self.tf.publish(state.tf)?;
        self.joints.publish(state.joints)?;
        self.tool_pose.publish(state.tool_pose)
    }

    async fn repeat(self: Arc<Self>) {
        // The parameter is gone when the node has been shut down.
        while let Ok(rate) = self.node.double("state_rate_hz") {
            if rate <= 0.0 {
                tokio::time::sleep(IDLE).await;
                continue;
            }
            // At least once a minute, so that a new rate is seen.
            tokio::time::sleep(Duration::from_secs_f64((1.0 / rate).min(60.0))).await;
            if let Err(e) = self.publish() {
                self.node.warn(e.to_string());
            }
        }
    }
}

/// Fixed and moving transforms of the machine at joint values (m, rad).
fn links(
    machine: &Machine,
    urdf: &str,
    joints: &Joints,
) -> Result<(Vec<LinkTransform>, Vec<LinkTransform>), RuntimeError> {
    transforms(urdf, &named_positions(machine, joints)).map_err(|e| RuntimeError::Parameter(e.text))
}

fn machine_model(machine: &Machine, urdf: &str, header: &Header) -> msg::MachineModel {
    let axes = machine.axes().iter().map(|axis| {
        let [lower, upper] = axis.limits.unwrap_or([0.0; 2]);
        msg::AxisModel {
            joint_name: axis.joint_name.clone(),
            letter: axis.letter.to_string(),
            kind: match axis.kind {
                AxisKind::Linear => msg::AxisModel::LINEAR,
                AxisKind::Rotary => msg::AxisModel::ROTARY,
            },
            limited: axis.limits.is_some(),
            lower,
            upper,
            velocity: axis.velocity,
            acceleration: axis.acceleration,
        }
    });
    msg::MachineModel {
        header: header.clone(),
        name: machine.name().to_owned(),
        axes: axes.collect(),
        urdf: urdf.to_owned(),
    }
}

fn tool_pose(machine: &Machine, joints: &Joints) -> PoseStamped {
    let pose = machine.workpiece_from_tool(joints);
    let (t, r) = (pose.translation, pose.rotation.coords);
    PoseStamped {
        header: Header { frame_id: FRAME.to_owned(), ..Header::default() },
        pose: Pose {
            position: Point { x: t.x, y: t.y, z: t.z },
            orientation: Quaternion { x: r.x, y: r.y, z: r.z, w: r.w },
        },
    }
}

fn tf_message(links: &[LinkTransform], stamp: &Time) -> TFMessage {
    let transforms = links.iter().map(|link| {
        let (t, r) = (&link.transform.translation, link.transform.rotation.coords);
        TransformStamped {
            header: Header { stamp: stamp.clone(), frame_id: link.parent.clone() },
            child_frame_id: link.child.clone(),
            transform: Transform {
                translation: Vector3 { x: t.x, y: t.y, z: t.z },
                rotation: Quaternion { x: r.x, y: r.y, z: r.z, w: r.w },
            },
        }
    });
    TFMessage { transforms: transforms.collect() }
}
