//! The node shell: takes job, mesh and toolpaths, gives evaluation, program, joint motion, machine model, robot description
//! and TF; serves `machine/solve_pose`.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use nalgebra::{Point3, Unit, Vector3};
use patchmill_geometry::mesh::TriangleMesh;
use patchmill_kinematics::{AxisKind, Joints, KinematicsError, Machine};
use patchmill_msgs::msg;
use patchmill_msgs::srv::{SolvePose, SolvePoseRequest, SolvePoseResponse};
use patchmill_msgs::{geometry_msgs, sensor_msgs, std_msgs, tf2_msgs};
use patchmill_node_runtime::{
    JobTag, Latest, Node, NodeOptions, ParameterSet, ProductReceiver, ProductServer, Publisher, Qos,
    RecomputeServer, RuntimeError, StageRunner, StatusPublisher, Subscription, status, topics,
};
use patchmill_products::job::Job;
use patchmill_products::program::{JointMotion, PatchPlan, PatchProgram, Program};
use patchmill_products::stage::StageError;
use patchmill_products::toolpath::CandidateToolpath;

use crate::DEFAULT_MACHINE_URDF;
use crate::evaluate::{BAD_MACHINE, MachineOutput, ProvenProgram, assess, machine_of};
use crate::transforms::{LinkTransform, named_positions, transforms};

/// First code of this stage's hundred: an input that cannot be read, a product that cannot be sent.
const BAD_MESSAGE: i32 = 500;
/// A pose that the machine cannot take.
const UNREACHABLE: i32 = 520;
/// Joint positions travel in a trajectory; a machine description above this size does not go out as one message, bytes.
const LARGEST_URDF: usize = 100 * 1024;

/// The parameters of the node.
pub fn parameters() -> ParameterSet {
    ParameterSet::new()
        .text(
            "robot_description",
            "",
            "URDF text of the machine for jobs that bring none; empty: the shipped table-table machine xyzac",
        )
        .read_only()
}

/// Starts the node. It runs until it is shut down.
///
/// # Errors
/// When the node cannot join the domain, a parameter is refused or `robot_description` is no five-axis machine.
pub fn start(options: NodeOptions) -> Result<Node, RuntimeError> {
    let node = Node::start(options)?;
    let default_urdf = match node.text("robot_description")? {
        none if none.is_empty() => DEFAULT_MACHINE_URDF.to_owned(),
        given => given,
    };
    let refused = |e: StageError| RuntimeError::Parameter(format!("robot_description: {}", e.text));
    let (machine, urdf) = machine_of(&Job::default_for(""), &default_urdf).map_err(refused)?;
    let current = Arc::new(Mutex::new(machine));
    let solving = Arc::clone(&current);
    node.serve::<SolvePose, _, _>(topics::SOLVE_POSE, move |request| {
        let machine = solving.lock().unwrap_or_else(PoisonError::into_inner).clone();
        std::future::ready(solve_pose(&machine, &request))
    })?;
    let shell = Shell {
        jobs: node.subscribe(topics::JOB, Qos::Status)?,
        meshes: ProductReceiver::new(&node)?,
        toolpaths: ProductReceiver::new(&node)?,
        recompute: RecomputeServer::new(&node, BAD_MESSAGE)?,
        evaluation: node.publisher(topics::EVALUATION, Qos::Status)?,
        program: ProductServer::new(&node)?,
        motion: ProductServer::new(&node)?,
        description: Description::new(&node)?,
        runner: StageRunner::new(StatusPublisher::new(&node)?),
        job: None,
        mesh: Latest::default(),
        candidates: (JobTag::default(), BTreeMap::new()),
        started: None,
        default_urdf: Arc::new(default_urdf),
        current,
    };
    shell.describe(&urdf, &[0.0; 5])?;
    node.spawn(shell.run());
    Ok(node)
}

struct Shell {
    jobs: Subscription<msg::Job>,
    meshes: ProductReceiver<TriangleMesh>,
    toolpaths: ProductReceiver<CandidateToolpath>,
    recompute: RecomputeServer,
    evaluation: Publisher<msg::Evaluation>,
    program: ProductServer<Program>,
    motion: ProductServer<JointMotion>,
    description: Description,
    runner: StageRunner<Outcome>,
    job: Option<(JobTag, Arc<Job>)>,
    mesh: Latest<String, TriangleMesh>,
    /// Toolpaths of one run of a job, by index.
    candidates: (JobTag, BTreeMap<u32, CandidateToolpath>),
    started: Option<JobTag>,
    default_urdf: Arc<String>,
    /// The machine that `solve_pose` answers for.
    current: Arc<Mutex<Machine>>,
}

/// What the blocking part gives.
struct Outcome {
    output: MachineOutput,
    machine: Machine,
    program: Option<(Program, JointMotion)>,
}

impl Shell {
    async fn run(mut self) {
        loop {
            tokio::select! {
                Some(job) = self.jobs.next() => {
                    self.job = self.runner.take_job(&job, BAD_MESSAGE);
                    self.started = None;
                }
                Some(mesh) = self.meshes.next() => {
                    if let Some((key, mesh)) = self.runner.received(mesh) {
                        self.mesh.put(key.surface_id, mesh);
                    }
                }
                Some(toolpath) = self.toolpaths.next() => {
                    if let Some((key, toolpath)) = self.runner.received(toolpath) {
                        let tag = JobTag::of_key(&key);
                        if self.candidates.0 != tag {
                            self.candidates = (tag, BTreeMap::new());
                        }
                        self.candidates.1.insert(toolpath.index, toolpath);
                    }
                }
                call = self.recompute.next() => {
                    if let Some(call) = call.accept(self.job.as_ref().map(|(tag, _)| tag)) {
                        self.started = None;
                        call.answer(Ok(()));
                    }
                }
                (tag, result) = self.runner.finished() => {
                    if let Err(e) = self.publish(&tag, result).await {
                        self.runner.status().failed(&tag, &e);
                    }
                }
                else => return,
            }
            self.start_when_complete();
        }
    }

    fn start_when_complete(&mut self) {
        let Some((tag, job)) = &self.job else { return };
        if self.started.as_ref() == Some(tag) {
            return;
        }
        let complete = self.candidates.0 == *tag
            && self.candidates.1.values().next().is_some_and(|t| t.count as usize == self.candidates.1.len());
        let (Some(mesh), true) = (self.mesh.of(&tag.surface_id), complete) else {
            self.runner.status().waiting(tag, "waiting for the mesh and all toolpaths");
            return;
        };
        let toolpaths: Vec<CandidateToolpath> = self.candidates.1.values().cloned().collect();
        let (job, default_urdf) = (Arc::clone(job), Arc::clone(&self.default_urdf));
        self.started = Some(tag.clone());
        self.runner.start(tag.clone(), "timing and proving the candidates", move |progress| {
            let output = assess(&toolpaths, &mesh, &job, &default_urdf, &progress)?;
            let (machine, _) = machine_of(&job, &default_urdf)?;
            let program = output.program.as_ref().map(|p| products(p, &toolpaths, &output.machine_urdf));
            Ok(Outcome { program: program.transpose()?, machine, output })
        });
    }

    async fn publish(&self, tag: &JobTag, result: Result<Outcome, StageError>) -> Result<(), StageError> {
        // The runner has already said why there is none.
        let Ok(Outcome { output, machine, program }) = result else { return Ok(()) };
        let provenance = tag.provenance();
        let evaluation = output.evaluation.to_msg(&provenance).map_err(|e| e.with_code(BAD_MESSAGE))?;
        let undelivered = |e: RuntimeError| StageError::new(BAD_MESSAGE, e.to_string());
        self.evaluation.publish(evaluation).map_err(undelivered)?;
        let Some((program, motion)) = program else {
            return Err(output
                .failure
                .unwrap_or_else(|| StageError::new(BAD_MESSAGE, "no candidate has a program")));
        };
        *self.current.lock().unwrap_or_else(PoisonError::into_inner) = machine;
        let first = motion.positions.get(..5).unwrap_or(&[0.0; 5]).to_vec();
        self.describe(&output.machine_urdf, &first).map_err(undelivered)?;
        self.program.publish(&program, &provenance).await.map_err(|e| e.with_code(BAD_MESSAGE))?;
        self.motion.publish(&motion, &provenance).await.map_err(|e| e.with_code(BAD_MESSAGE))?;
        let text = format!(
            "chose {} patches: {:.1} s, {:.1} mm, proven",
            program.patches.len(),
            program.machining_time,
            program.cut_length * 1e3
        );
        self.runner.status().done(tag, &text);
        Ok(())
    }

    fn describe(&self, urdf: &str, joints: &[f64]) -> Result<(), RuntimeError> {
        let machine = self.current.lock().unwrap_or_else(PoisonError::into_inner).clone();
        self.description.publish(&machine, urdf, joints)
    }
}

/// What others must know of the machine: model, description, joint states, TF.
struct Description {
    model: Publisher<msg::MachineModel>,
    text: Publisher<std_msgs::msg::String>,
    joints: Publisher<sensor_msgs::msg::JointState>,
    tf: Publisher<tf2_msgs::msg::TFMessage>,
    tf_static: Publisher<tf2_msgs::msg::TFMessage>,
}

impl Description {
    fn new(node: &Node) -> Result<Self, RuntimeError> {
        Ok(Self {
            model: node.publisher(topics::MACHINE_MODEL, Qos::Status)?,
            text: node.publisher(topics::ROBOT_DESCRIPTION, Qos::Status)?,
            joints: node.publisher(topics::JOINT_STATES, Qos::Stream)?,
            tf: node.publisher(topics::TF, Qos::Stream)?,
            tf_static: node.publisher(topics::TF_STATIC, Qos::Status)?,
        })
    }

    fn publish(&self, machine: &Machine, urdf: &str, joints: &[f64]) -> Result<(), RuntimeError> {
        if urdf.len() > LARGEST_URDF {
            let text = format!("the URDF has {} bytes, at most {LARGEST_URDF} were expected", urdf.len());
            return Err(RuntimeError::Parameter(text));
        }
        let (fixed, moving) = transforms(urdf, &named_positions(machine, joints))
            .map_err(|e| RuntimeError::Parameter(e.text))?;
        let header = std_msgs::msg::Header { stamp: status::now(), frame_id: String::new() };
        self.model.publish(machine_model(machine, urdf, &header))?;
        self.text.publish(std_msgs::msg::String { data: urdf.to_owned() })?;
        self.tf_static.publish(tf_message(&fixed, &header))?;
        self.tf.publish(tf_message(&moving, &header))?;
        self.joints.publish(sensor_msgs::msg::JointState {
            header,
            name: machine.axes().iter().map(|a| a.joint_name.clone()).collect(),
            position: joints.to_vec(),
            velocity: Vec::new(),
            effort: Vec::new(),
        })
    }
}

fn machine_model(machine: &Machine, urdf: &str, header: &std_msgs::msg::Header) -> msg::MachineModel {
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

fn tf_message(links: &[LinkTransform], header: &std_msgs::msg::Header) -> tf2_msgs::msg::TFMessage {
    let transforms = links.iter().map(|link| {
        let (t, r) = (&link.transform.translation, link.transform.rotation.coords);
        geometry_msgs::msg::TransformStamped {
            header: std_msgs::msg::Header { stamp: header.stamp.clone(), frame_id: link.parent.clone() },
            child_frame_id: link.child.clone(),
            transform: geometry_msgs::msg::Transform {
                translation: geometry_msgs::msg::Vector3 { x: t.x, y: t.y, z: t.z },
                rotation: geometry_msgs::msg::Quaternion { x: r.x, y: r.y, z: r.z, w: r.w },
            },
        }
    });
    tf2_msgs::msg::TFMessage { transforms: transforms.collect() }
}

fn products(
    proven: &ProvenProgram,
    toolpaths: &[CandidateToolpath],
    machine_urdf: &str,
) -> Result<(Program, JointMotion), StageError> {
    let lost = || StageError::new(BAD_MESSAGE, "the program names a patch that its toolpath does not have");
    let toolpath = toolpaths.iter().find(|t| t.index == proven.candidate_index).ok_or_else(lost)?;
    let patches = proven.patches.iter().map(|patch| {
        Ok(PatchProgram {
            plan: PatchPlan::from(toolpath.patches.get(patch.place).ok_or_else(lost)?),
            rotary_names: patch.rotary_names.clone(),
            rotary_positions: patch.rotary_positions,
            machining_time: patch.machining_time,
            cut_length: patch.cut_length,
        })
    });
    let program = Program {
        text: proven.text.clone(),
        block_count: proven.block_count,
        candidate_index: proven.candidate_index,
        machining_time: proven.machining_time,
        cut_length: proven.cut_length,
        proof: proven.proof,
        patches: patches.collect::<Result<_, StageError>>()?,
        machine_urdf: machine_urdf.to_owned(),
    };
    let motion = JointMotion {
        joint_names: proven.joint_names.to_vec(),
        times: proven.trajectory.iter().map(|p| p.time).collect(),
        positions: proven.trajectory.iter().flat_map(|p| p.joints).collect(),
        velocities: proven.trajectory.iter().flat_map(|p| p.velocity).collect(),
    };
    Ok((program, motion))
}

fn solve_pose(machine: &Machine, request: &SolvePoseRequest) -> SolvePoseResponse {
    let refused = |code: i32, text: String| SolvePoseResponse { code, text, ..SolvePoseResponse::default() };
    let (t, a) = (&request.tip, &request.tool_axis);
    let numbers = [t.x, t.y, t.z, a.x, a.y, a.z];
    let Some(axis) =
        Unit::try_new(Vector3::new(a.x, a.y, a.z), 1e-12).filter(|_| numbers.iter().all(|v| v.is_finite()))
    else {
        return refused(
            BAD_MESSAGE,
            "the pose needs finite numbers and a tool axis that is not zero".to_owned(),
        );
    };
    let near: Joints = [0.0; 5];
    match machine.inverse(&Point3::new(t.x, t.y, t.z), &axis, &near) {
        Ok(solution) => SolvePoseResponse {
            joint_names: machine.axes().iter().map(|axis| axis.joint_name.clone()).collect(),
            positions: solution.joints.to_vec(),
            singular: solution.singular,
            ..SolvePoseResponse::default()
        },
        Err(e @ KinematicsError::Model(_)) => refused(BAD_MACHINE, e.to_string()),
        Err(e) => refused(UNREACHABLE, e.to_string()),
    }
}
