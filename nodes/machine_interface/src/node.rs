//! The node shell: takes job, mesh and toolpaths, gives evaluation, program, joint motion, trajectory, and (in
//! `description`) the machine and its state; serves `machine/solve_pose` and (in `execution`) runs programs on controllers.

mod description;
mod execution;

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use nalgebra::{Point3, Unit, Vector3};
use patchmill_geometry::mesh::TriangleMesh;
use patchmill_kinematics::{Joints, KinematicsError, Machine};
use patchmill_msgs::msg;
use patchmill_msgs::srv::{SolvePose, SolvePoseRequest, SolvePoseResponse};
use patchmill_msgs::trajectory_msgs::msg::JointTrajectory;
use patchmill_node_runtime::{
    JobTag, Latest, Node, NodeOptions, ParameterSet, ProductReceiver, ProductServer, Publisher, Qos,
    RecomputeServer, RuntimeError, Series, StageRunner, StatusPublisher, Subscription, topics,
};
use patchmill_products::evaluation::ResidualMap;
use patchmill_products::job::Job;
use patchmill_products::program::{JointMotion, PatchPlan, PatchProgram, Program};
use patchmill_products::stage::StageError;
use patchmill_products::toolpath::CandidateToolpath;

use crate::evaluate::{BAD_MACHINE, MachineOutput, ProvenProgram, assess, machine_as_used, machine_of};
use crate::execution::ExecutableProgram;
use crate::gcode::MOST_MOVES;
use crate::timing::Dynamics;
use crate::{DEFAULT_MACHINE_URDF, MachineParams};
use description::Description;
use execution::Execution;

/// First code of this stage's hundred: an input that cannot be read, a product that cannot be sent.
const BAD_MESSAGE: i32 = 500;
/// A pose that the machine cannot take.
const UNREACHABLE: i32 = 520;

/// The parameters of the node.
pub fn parameters() -> ParameterSet {
    ParameterSet::new()
        .text(
            "robot_description",
            "",
            "URDF text of the machine for jobs that bring none; empty: the shipped table-table machine xyzac",
        )
        .read_only()
        .double(
            "state_rate_hz",
            10.0,
            0.0..=100.0,
            "joint_states, /tf and machine/tool_pose so often [Hz]; 0: only on change",
        )
        .text(
            "program_directory",
            "",
            "programs are put here for a controller to read while they run; empty: the system's folder for temporary files",
        )
        .read_only()
        .text(
            "accepted_programs",
            "",
            "programs besides those that this node has proven that may be brought to it and run: their sha256 sums, or `any`",
        )
        .read_only()
        .text(
            "controllers",
            "",
            "controllers besides those on this machine that a program may be run on: their HOST:PORT, or `any`",
        )
        .read_only()
        .integer(
            "max_moves",
            MachineParams::default().max_moves as i64,
            1..=MOST_MOVES as i64,
            "most moves of a program",
        )
        .max_chunks()
}

/// The parameter `max_moves`, at least 1.
fn max_moves(node: &Node) -> Result<usize, RuntimeError> {
    Ok(node.integer("max_moves")? as usize)
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
    let description = Arc::new(Description::new(&node)?);
    let execution = Execution::serve(&node, Arc::clone(&description), Arc::clone(&current))?;
    let shell = Shell {
        jobs: node.subscribe(topics::JOB, Qos::Status)?,
        meshes: ProductReceiver::new(&node)?,
        toolpaths: ProductReceiver::new(&node)?,
        recompute: RecomputeServer::new(&node, BAD_MESSAGE)?,
        evaluation: node.publisher(topics::EVALUATION, Qos::Status)?,
        program: ProductServer::new(&node)?,
        motion: ProductServer::new(&node)?,
        residual: ProductServer::new(&node)?,
        trajectory: Series::new(&node, topics::TRAJECTORY)?,
        description,
        execution,
        runner: StageRunner::new(StatusPublisher::new(&node)?),
        job: None,
        mesh: Latest::default(),
        candidates: (JobTag::default(), BTreeMap::new()),
        started: None,
        default_urdf,
        current,
        node: node.clone(),
    };
    shell.describe(&urdf, &[0.0; 5])?;
    node.spawn(shell.description.repeat_state());
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
    residual: ProductServer<ResidualMap>,
    /// The same for controllers that know nothing of patchmill.
    trajectory: Series<JointTrajectory>,
    description: Arc<Description>,
    execution: Arc<Execution>,
    runner: StageRunner<Outcome>,
    job: Option<(JobTag, Arc<Job>)>,
    mesh: Latest<String, TriangleMesh>,
    /// Toolpaths of one run of a job, by index.
    candidates: (JobTag, BTreeMap<u32, CandidateToolpath>),
    started: Option<JobTag>,
    default_urdf: String,
    /// The machine that `solve_pose` answers for.
    current: Arc<Mutex<Machine>>,
    node: Node,
}

/// What the blocking part gives.
struct Outcome {
    output: MachineOutput,
    machine: Machine,
    program: Option<(Program, JointMotion)>,
    residual: Option<ResidualMap>,
    executable: Option<ExecutableProgram>,
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
        let max_moves = match max_moves(&self.node) {
            Ok(max_moves) => max_moves,
            Err(e) => return self.node.error(e.to_string()),
        };
        let toolpaths: Vec<CandidateToolpath> = self.candidates.1.values().cloned().collect();
        let (job, default_urdf) = (Arc::clone(job), self.default_urdf.clone());
        let params = MachineParams { default_urdf, max_moves };
        self.started = Some(tag.clone());
        self.runner.start(tag.clone(), "timing and proving the candidates", move |progress| {
            let output = assess(&toolpaths, &mesh, &job, &params, &progress)?;
            let (machine, _) = machine_as_used(&output, &job)?;
            let program = output.program.as_ref().map(|p| products(p, &toolpaths, &output.machine_urdf));
            let executable = output.program.as_ref().map(|p| {
                let urdf = output.machine_urdf.clone();
                let (text, dynamics) = (p.passed.text().to_owned(), Dynamics::of(&job));
                ExecutableProgram::new(text, urdf, job.tool.length, dynamics, max_moves)
            });
            let (program, executable) = (program.transpose()?, executable.transpose()?);
            let residual = output.program.as_ref().map(|p| p.passed.residual().clone());
            Ok(Outcome { program, residual, executable, machine, output })
        });
    }

    async fn publish(&mut self, tag: &JobTag, result: Result<Outcome, StageError>) -> Result<(), StageError> {
        // The runner has already said why there is none.
        let Ok(Outcome { output, machine, program, residual, executable }) = result else { return Ok(()) };
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
        let mut first = [0.0; 5];
        first.iter_mut().zip(&motion.positions).for_each(|(q, position)| *q = *position);
        self.describe(&output.machine_urdf, &first).map_err(undelivered)?;
        self.program.publish(&program, &provenance).await.map_err(|e| e.with_code(BAD_MESSAGE))?;
        if let Some(executable) = executable {
            self.execution.proven(executable);
        }
        self.motion.publish(&motion, &provenance).await.map_err(|e| e.with_code(BAD_MESSAGE))?;
        if let Some(residual) = residual {
            self.residual.publish(&residual, &provenance).await.map_err(|e| e.with_code(BAD_MESSAGE))?;
        }
        let text = format!(
            "chose {} patches: {:.1} s, {:.1} mm, proven",
            program.patches.len(),
            program.machining_time,
            program.cut_length * 1e3
        );
        self.runner.status().done(tag, &text);
        // After the status: nobody who plans waits for it, and the plan stands without it.
        self.publish_trajectory(&motion).await;
        Ok(())
    }

    async fn publish_trajectory(&mut self, motion: &JointMotion) {
        let published = match motion.to_joint_trajectories() {
            Ok(parts) => self.trajectory.replace(parts).await.map_err(|e| e.to_string()),
            Err(e) => Err(e.text),
        };
        if let Err(e) = published {
            self.node.error(format!("the program did not go out on {}: {e}", topics::TRAJECTORY));
        }
    }

    fn describe(&self, urdf: &str, joints: &Joints) -> Result<(), RuntimeError> {
        let machine = self.current.lock().unwrap_or_else(PoisonError::into_inner).clone();
        self.description.publish(&machine, urdf, joints)
    }
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
        text: proven.passed.text().to_owned(),
        block_count: proven.passed.block_count(),
        candidate_index: proven.candidate_index,
        machining_time: proven.machining_time,
        cut_length: proven.cut_length,
        proof: proven.passed.proof().clone(),
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
