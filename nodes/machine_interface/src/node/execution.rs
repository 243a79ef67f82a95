//! Programs on controllers: the action `machine/execute_program`, and the services that bring a program, hold it and resume it.

use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use patchmill_kinematics::{Accelerations, Control, Machine};
use patchmill_msgs::action::{
    ExecuteProgram, ExecuteProgramFeedback, ExecuteProgramGoal, ExecuteProgramResult,
};
use patchmill_msgs::srv::{
    ControlProgram, ControlProgramRequest, ControlProgramResponse, LoadProgram, LoadProgramRequest,
    LoadProgramResponse,
};
use patchmill_node_runtime::{ActionEnd, GoalContext, Node, RuntimeError, topics};
use patchmill_products::stage::StageError;
use patchmill_products::wire::{self, WireError};
use tokio::sync::mpsc;

use super::BAD_MESSAGE;
use super::description::Description;
use crate::execution::program::AllParts;
use crate::execution::{
    ABORTED, Admission, BAD_PROGRAM, BUSY, ExecutableProgram, KnownPrograms, NOT_RUNNING, Orders, Outcome,
    Part, PartStore, Phase, Reach, Seen, UNKNOWN_PROGRAM, UNPROVEN, controller_of, execute,
};
use crate::timing::{Dynamics, look_ahead};

/// Feedback goes out so often, and when the state changes.
const FEEDBACK: Duration = Duration::from_millis(100);

/// What the action and the services share.
pub(super) struct Execution {
    programs: Mutex<KnownPrograms>,
    parts: Mutex<PartStore>,
    reach: Reach,
    /// Held while a program that was brought is read: one at a time.
    reading: tokio::sync::Mutex<()>,
    running: Mutex<Option<Running>>,
    description: Arc<Description>,
    current: Arc<Mutex<Machine>>,
    node: Node,
}

/// The run that is under way.
struct Running {
    sha256: String,
    orders: Arc<Orders>,
}

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Execution {
    /// Serves the action and the services. `current` is the machine that the node stands for.
    pub(super) fn serve(
        node: &Node,
        description: Arc<Description>,
        current: Arc<Mutex<Machine>>,
    ) -> Result<Arc<Self>, RuntimeError> {
        let refused = |name: &str, e: String| RuntimeError::Parameter(format!("{name}: {e}"));
        let admission = Admission::parse(&node.text("accepted_programs")?);
        let admission = admission.map_err(|e| refused("accepted_programs", e))?;
        let reach = Reach::parse(&node.text("controllers")?).map_err(|e| refused("controllers", e))?;
        let this = Arc::new(Self {
            programs: Mutex::new(KnownPrograms::new(admission)),
            parts: Mutex::default(),
            reach,
            reading: tokio::sync::Mutex::default(),
            running: Mutex::default(),
            description,
            current,
            node: node.clone(),
        });
        let loading = Arc::clone(&this);
        node.serve::<LoadProgram, _, _>(topics::LOAD_PROGRAM, move |request| {
            // The part is taken at once: parts are asked for together as well as one by one.
            let taken = loading.take(request);
            let loading = Arc::clone(&loading);
            async move { loading.load(taken).await }
        })?;
        for (name, hold) in [(topics::HOLD_PROGRAM, true), (topics::RESUME_PROGRAM, false)] {
            let controlling = Arc::clone(&this);
            node.serve::<ControlProgram, _, _>(name, move |request| {
                std::future::ready(controlling.control(&request, hold))
            })?;
        }
        let executing = Arc::clone(&this);
        node.serve_action::<ExecuteProgram, _, _>(
            topics::EXECUTE_PROGRAM,
            |_| Ok(()),
            move |goal, context| Arc::clone(&executing).run(goal, context),
        )?;
        Ok(this)
    }

    /// Takes a program that has passed its proof; it can be run from now on.
    pub(super) fn proven(&self, program: ExecutableProgram) {
        locked(&self.programs).prove(program);
    }

    /// Takes a part of a program; all parts once they are there, else how many are missing.
    fn take(&self, request: LoadProgramRequest) -> Result<Result<AllParts, u32>, StageError> {
        locked(&self.programs).check(&request.program_sha256)?;
        let dynamics = dynamics_of(&request).map_err(|e| e.with_code(BAD_PROGRAM))?;
        let part = Part {
            sha256: request.program_sha256,
            index: request.part_index,
            count: request.part_count,
            text: request.text,
            machine_urdf: request.machine_urdf,
            tool_length: request.tool_length,
            dynamics,
        };
        locked(&self.parts).take(part)
    }

    /// Answers a part that was taken.
    async fn load(self: &Arc<Self>, taken: Result<Result<AllParts, u32>, StageError>) -> LoadProgramResponse {
        let loaded = match taken {
            Ok(Err(missing)) => return LoadProgramResponse { missing, ..LoadProgramResponse::default() },
            Ok(Ok(parts)) => self.read(parts).await,
            Err(e) => Err(e),
        };
        match loaded {
            Ok(program) => {
                let text = format!("{} motions, {:.1} s", program.blocks.len(), program.timing.duration);
                LoadProgramResponse { text, ..LoadProgramResponse::default() }
            }
            Err(e) => {
                if e.code == UNPROVEN {
                    self.node.warn(format!("{}: {}", topics::LOAD_PROGRAM, e.text));
                }
                LoadProgramResponse { code: e.code, text: e.text, missing: 0 }
            }
        }
    }

    /// Reads a program of which all parts are there, beside what else the node does. It can be run from now on.
    async fn read(self: &Arc<Self>, parts: AllParts) -> Result<Arc<ExecutableProgram>, StageError> {
        let Ok(_reading) = self.reading.try_lock() else {
            return Err(StageError::new(BUSY, "another program is being read: bring this one once more"));
        };
        let max_moves =
            super::max_moves(&self.node).map_err(|e| StageError::new(BAD_PROGRAM, e.to_string()))?;
        let this = Arc::clone(self);
        let reading = move || {
            let brought = parts.join()?;
            let own = locked(&this.programs).own(&brought.sha256, &brought.setup())?;
            let program = own.map_or_else(|| brought.read(max_moves).map(Arc::new), Ok)?;
            locked(&this.programs).bring(program)
        };
        let read = tokio::task::spawn_blocking(reading).await;
        read.unwrap_or_else(|e| Err(StageError::new(BAD_MESSAGE, e.to_string())))
    }

    fn control(&self, request: &ControlProgramRequest, hold: bool) -> ControlProgramResponse {
        let running = locked(&self.running);
        let meant =
            |run: &&Running| request.program_sha256.is_empty() || request.program_sha256 == run.sha256;
        match running.as_ref().filter(meant) {
            Some(run) => {
                run.orders.set_hold(hold);
                ControlProgramResponse::default()
            }
            None => {
                let text = match &*running {
                    Some(run) => format!("the program that runs is {}", run.sha256),
                    None => "no program runs".to_owned(),
                };
                ControlProgramResponse { code: NOT_RUNNING, text }
            }
        }
    }

    async fn run(
        self: Arc<Self>,
        goal: ExecuteProgramGoal,
        context: GoalContext<ExecuteProgram>,
    ) -> ActionEnd<ExecuteProgramResult> {
        let outcome = Arc::new(Mutex::new(Outcome::default()));
        let mut result = ExecuteProgramResult::default();
        let done = match self.begin(&goal) {
            Ok((program, place)) => {
                result.planned_time = program.timing.duration;
                self.follow(&goal, &program, &place, &outcome, &context).await
            }
            Err(e) => Err(e),
        };
        let known = *locked(&outcome);
        result.run_time = known.run_time;
        result.approach_time = known.approach_time;
        result.held_time = known.held_time;
        result.position_count = known.position_count;
        result.deviation_linear = known.deviation.linear;
        result.deviation_rotary = known.deviation.rotary;
        match done {
            Ok(()) => {
                result.text = told(&goal.controller, &result);
                self.node.info(&result.text);
                ActionEnd::Succeeded(result)
            }
            Err(e) => {
                self.node.error(e.to_string());
                (result.code, result.text) = (e.code, e.text);
                let cancelled = result.code == ABORTED && context.is_cancelled();
                if cancelled { ActionEnd::Canceled(result) } else { ActionEnd::Aborted(result) }
            }
        }
    }

    /// The goal's program, and the place of the run that is under way, which is freed when it is dropped.
    fn begin(
        self: &Arc<Self>,
        goal: &ExecuteProgramGoal,
    ) -> Result<(Arc<ExecutableProgram>, Place), StageError> {
        let Some(program) = locked(&self.programs).find(&goal.program_sha256) else {
            let text = format!(
                "there is no program with the sha256 `{}`: it is neither the one on machine/program nor was it brought by {}",
                goal.program_sha256,
                topics::LOAD_PROGRAM
            );
            return Err(StageError::new(UNKNOWN_PROGRAM, text));
        };
        let mut running = locked(&self.running);
        if let Some(run) = &*running {
            let text = format!("the program {} runs; one at a time", run.sha256);
            return Err(StageError::new(BUSY, text));
        }
        let orders = Arc::new(Orders::default());
        *running = Some(Running { sha256: program.sha256.clone(), orders: Arc::clone(&orders) });
        Ok((program, Place { orders, execution: Arc::clone(self) }))
    }

    async fn follow(
        &self,
        goal: &ExecuteProgramGoal,
        program: &Arc<ExecutableProgram>,
        place: &Place,
        outcome: &Arc<Mutex<Outcome>>,
        context: &GoalContext<ExecuteProgram>,
    ) -> Result<(), StageError> {
        let folder =
            self.node.text("program_directory").map_err(|e| StageError::new(BAD_MESSAGE, e.to_string()))?;
        let folder = if folder.is_empty() { std::env::temp_dir() } else { PathBuf::from(folder) };
        let mut controller = controller_of(&goal.controller, goal.speed, &folder, &self.reach)?;
        let (sender, mut looks) = mpsc::unbounded_channel();
        let (running, orders, outcome) =
            (Arc::clone(program), Arc::clone(&place.orders), Arc::clone(outcome));
        let mut work = tokio::task::spawn_blocking(move || {
            let mut observe = |seen: &Seen| {
                // Nobody looks any more when the node is being shut down.
                let _ = sender.send(*seen);
            };
            execute(&mut *controller, &running, &orders, &mut observe, &outcome)
        });
        let mut teller = Teller { program, context, described: false, told: None };
        loop {
            tokio::select! {
                Some(seen) = looks.recv() => self.show(&seen, &mut teller),
                () = context.cancelled(), if !context.is_cancelled() => {}
                done = &mut work => {
                    while let Ok(seen) = looks.try_recv() {
                        self.show(&seen, &mut teller);
                    }
                    return done.unwrap_or_else(|e| Err(StageError::new(BAD_MESSAGE, e.to_string())));
                }
            }
            if context.is_cancelled() {
                place.orders.abort();
            }
        }
    }

    fn show(&self, seen: &Seen, teller: &mut Teller<'_>) {
        let program = teller.program;
        let (machine, urdf) = (&program.machine, &program.machine_urdf);
        if let Some(joints) = &seen.joints {
            // From the first report on this node's machine is the program's, and where it says that it is.
            let published = if std::mem::replace(&mut teller.described, true) {
                self.description.moved(machine, urdf, joints)
            } else {
                *locked(&self.current) = machine.clone();
                self.description.publish(machine, urdf, joints)
            };
            if let Err(e) = published {
                self.node.warn(e.to_string());
            }
        }
        teller.tell(seen);
    }
}

/// The place of the one run; aborts what still runs and frees it.
struct Place {
    orders: Arc<Orders>,
    execution: Arc<Execution>,
}

impl Drop for Place {
    fn drop(&mut self) {
        self.orders.abort();
        *locked(&self.execution.running) = None;
    }
}

/// Sends feedback, not too often.
struct Teller<'a> {
    program: &'a ExecutableProgram,
    context: &'a GoalContext<ExecuteProgram>,
    /// The machine has been published.
    described: bool,
    told: Option<(Phase, Instant)>,
}

impl Teller<'_> {
    fn tell(&mut self, seen: &Seen) {
        let recent = |(phase, when): (Phase, Instant)| phase == seen.phase && when.elapsed() < FEEDBACK;
        if self.told.is_some_and(recent) && seen.fraction < 1.0 {
            return;
        }
        self.told = Some((seen.phase, Instant::now()));
        let axes = self.program.machine.axes();
        self.context.feedback(ExecuteProgramFeedback {
            state: seen.phase.name().to_owned(),
            line: seen.line,
            fraction: seen.fraction,
            joint_names: axes.iter().map(|axis| axis.joint_name.clone()).collect(),
            positions: seen.joints.map_or(Vec::new(), |joints| joints.to_vec()),
        });
    }
}

/// How machine and control of a program move.
fn dynamics_of(request: &LoadProgramRequest) -> Result<Dynamics, WireError> {
    let limits = [request.jerk_linear, request.jerk_rotary, request.block_time];
    if !limits.iter().all(|v| v.is_finite() && *v >= 0.0) {
        let text = format!("jerks and block time are {limits:?}, finite values of at least 0 were expected");
        return Err(WireError::new(text));
    }
    let asked = wire::job::look_ahead(request.look_ahead)?;
    Ok(Dynamics {
        accelerations: Accelerations {
            linear: request.acceleration_linear,
            rotary: request.acceleration_rotary,
        },
        control: Control {
            jerk_linear: request.jerk_linear,
            jerk_rotary: request.jerk_rotary,
            block_time: request.block_time,
            look_ahead: look_ahead(asked),
            ..Control::default()
        },
    })
}

/// One line about a run that has come to its end.
fn told(controller: &str, result: &ExecuteProgramResult) -> String {
    format!(
        "{controller}: {:.1} s from the first position on, planned {:.1} s, {:.1} s before it; {} positions, at most {:.4} mm and {:.4}° \
         from the program's path",
        result.run_time - result.approach_time - result.held_time,
        result.planned_time,
        result.approach_time,
        result.position_count,
        result.deviation_linear * 1e3,
        result.deviation_rotary.to_degrees()
    )
}
