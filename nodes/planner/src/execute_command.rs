//! `patchmill execute`: a planned program on a controller, followed to its end.

use std::convert::Infallible;
use std::io::BufRead;
use std::time::Duration;

use patchmill_kinematics::LookAhead;
use patchmill_machine_interface::linuxcnc::client::address;
use patchmill_msgs::action::{ExecuteProgram, ExecuteProgramFeedback, ExecuteProgramGoal};
use patchmill_msgs::msg;
use patchmill_msgs::srv::{ControlProgram, ControlProgramRequest, LoadProgram, LoadProgramRequest};
use patchmill_node_runtime::arguments::Override;
use patchmill_node_runtime::{
    ActionClient, ActionEnd, Arguments, DomainLease, Level, Node, NodeOptions, ParameterSet, RuntimeError,
    ServiceClient, Value, free_domain, interrupted, topics,
};
use tokio::sync::mpsc;

use crate::options::ExecuteOptions;
use crate::plan_folder::PlanFolder;
use crate::progress_line::{ProgressLine, Voice};
use crate::session::log_level;
use crate::stack::{Stack, StackOptions, local};
use crate::stdout::say;

/// For finding machine_interface, and for one answer of it.
const PATIENCE: Duration = Duration::from_secs(20);
const ATTEMPT: Duration = Duration::from_secs(2);
/// A part of a program has at most so many bytes of text and as many of the URDF.
const PART: usize = 24 * 1024;

/// Runs the program of a plan's folder.
///
/// # Errors
/// With one sentence for the user.
pub async fn execute(options: &ExecuteOptions) -> Result<(), String> {
    let plan = PlanFolder::read(&options.plan)?;
    let session = Session::start(options, &plan)?;
    let mut line = ProgressLine::new(options.verbose);
    let done = session.run(options, &plan, &mut line).await;
    line.end();
    session.close().await;
    say(&done?)
}

/// The node that runs it and the one that asks for it.
struct Session {
    /// Held so that no other process takes the domain.
    _lease: Option<DomainLease>,
    stack: Option<Stack>,
    node: Node,
    load: ServiceClient<LoadProgram>,
    hold: ServiceClient<ControlProgram>,
    resume: ServiceClient<ControlProgram>,
    action: ActionClient<ExecuteProgram>,
}

impl Session {
    fn start(options: &ExecuteOptions, plan: &PlanFolder) -> Result<Self, String> {
        let text = |e: RuntimeError| e.to_string();
        let lease = if options.domain.is_none() { Some(free_domain().map_err(text)?) } else { None };
        let domain = options.domain.or(lease.as_ref().map(DomainLease::domain)).unwrap_or(0);
        let stack = match lease {
            Some(_) => {
                let only = |name: &str| name == topics::nodes::MACHINE_INTERFACE;
                let given = |name: &str, value: &str| Override {
                    node: None,
                    name: name.to_owned(),
                    value: Value::Text(value.to_owned()),
                    strict: true,
                };
                let controller = address(&options.controller).unwrap_or_default();
                let parameters =
                    [given("accepted_programs", &plan.program_sha256), given("controllers", controller)];
                let started = StackOptions {
                    domain,
                    surfaces: None,
                    machine: &plan.machine_urdf,
                    log_level: log_level(options.verbose),
                    parameters: &parameters,
                };
                Some(Stack::start_with(&started, only).map_err(text)?)
            }
            None => None,
        };
        let arguments = match lease {
            Some(_) => local("patchmill_execute", domain, Level::Fatal),
            None => {
                let environment = |variable: &str| std::env::var(variable).ok();
                let arguments = Arguments::parse(std::iter::empty(), "patchmill_execute", environment);
                Arguments { domain, log_level: Level::Fatal, ..arguments.map_err(text)? }
            }
        };
        let node = Node::start(NodeOptions { arguments, parameters: ParameterSet::new() }).map_err(text)?;
        Ok(Self {
            _lease: lease,
            stack,
            load: node.service_client(topics::LOAD_PROGRAM).map_err(text)?,
            hold: node.service_client(topics::HOLD_PROGRAM).map_err(text)?,
            resume: node.service_client(topics::RESUME_PROGRAM).map_err(text)?,
            action: node.action_client(topics::EXECUTE_PROGRAM).map_err(text)?,
            node,
        })
    }

    /// What came of it, as one line.
    async fn run(
        &self,
        options: &ExecuteOptions,
        plan: &PlanFolder,
        line: &mut ProgressLine,
    ) -> Result<String, String> {
        for request in parts(plan) {
            let answer = self.load.call(&request, ATTEMPT, PATIENCE).await.map_err(|e| e.to_string())?;
            if answer.code != 0 {
                return Err(format!("{} (code {})", answer.text, answer.code));
            }
        }
        let simulated = options.controller == "sim";
        let goal = ExecuteProgramGoal {
            program_sha256: plan.program_sha256.clone(),
            controller: options.controller.clone(),
            speed: if simulated || options.speed != 1.0 { options.speed } else { 0.0 },
        };
        let (abort, aborted) = tokio::sync::oneshot::channel();
        let cancel = async {
            tokio::select! {
                () = interrupted() => {}
                Ok(()) = aborted => {}
            }
        };
        let voice = line.voice();
        let end = self.action.execute(goal, PATIENCE, |feedback| show(line, &feedback), cancel);
        let end = tokio::select! {
            end = end => end,
            never = self.obey(abort, &voice) => match never {},
        };
        match end.map_err(|e| e.to_string())? {
            ActionEnd::Succeeded(result) => Ok(format!("{}\n", result.text)),
            ActionEnd::Aborted(result) | ActionEnd::Canceled(result) => {
                Err(format!("{} (code {})", result.text, result.code))
            }
        }
    }

    /// Passes on what is typed, for ever.
    async fn obey(&self, abort: tokio::sync::oneshot::Sender<()>, voice: &Voice) -> Infallible {
        let mut words = typed_words();
        let mut abort = Some(abort);
        while let Some(word) = words.recv().await {
            let request = ControlProgramRequest::default();
            let told = match word.as_str() {
                "hold" => self.hold.call(&request, ATTEMPT, PATIENCE).await,
                "resume" => self.resume.call(&request, ATTEMPT, PATIENCE).await,
                "abort" => {
                    // The run may have ended meanwhile.
                    abort.take().map(|abort| abort.send(()));
                    continue;
                }
                _ => {
                    voice.say(&format!("patchmill: `{word}`: hold, resume or abort was expected"));
                    continue;
                }
            };
            match told {
                Ok(answer) if answer.code == 0 => {}
                Ok(answer) => {
                    voice.say(&format!("patchmill: {word}: {} (code {})", answer.text, answer.code));
                }
                Err(e) => voice.say(&format!("patchmill: {word}: {e}")),
            }
        }
        // At the end of the input nothing more is typed, but the run goes on.
        let _keep = abort;
        std::future::pending().await
    }

    async fn close(self) {
        self.node.shutdown().await;
        if let Some(stack) = self.stack {
            stack.shutdown().await;
        }
    }
}

/// The words on the lines of the standard input. The thread ends with the process.
fn typed_words() -> mpsc::UnboundedReceiver<String> {
    let (sender, receiver) = mpsc::unbounded_channel();
    std::thread::spawn(move || {
        for line in std::io::stdin().lock().lines() {
            let Ok(line) = line else { return };
            let word = line.trim().to_ascii_lowercase();
            if !word.is_empty() && sender.send(word).is_err() {
                return;
            }
        }
    });
    receiver
}

fn show(line: &mut ProgressLine, feedback: &ExecuteProgramFeedback) {
    let place = if feedback.line > 0 { format!("line {}", feedback.line) } else { "no line yet".to_owned() };
    line.show_stage(&feedback.state, &place, feedback.fraction);
}

/// The program in parts.
fn parts(plan: &PlanFolder) -> Vec<LoadProgramRequest> {
    let (text, urdf) = (slices(&plan.program), slices(&plan.machine_urdf));
    let count = text.len().max(urdf.len());
    let slice = |of: &[&str], index: usize| of.get(index).map_or(String::new(), |s| (*s).to_owned());
    let part = |index: usize| LoadProgramRequest {
        program_sha256: plan.program_sha256.clone(),
        part_index: index as u32,
        part_count: count as u32,
        text: slice(&text, index),
        machine_urdf: slice(&urdf, index),
        tool_length: plan.tool_length,
        acceleration_linear: plan.dynamics.accelerations.linear,
        acceleration_rotary: plan.dynamics.accelerations.rotary,
        jerk_linear: plan.dynamics.control.jerk_linear,
        jerk_rotary: plan.dynamics.control.jerk_rotary,
        block_time: plan.dynamics.control.block_time,
        look_ahead: match plan.dynamics.control.look_ahead {
            LookAhead::AllAxes => msg::Job::LOOK_AHEAD_ALL_AXES,
            LookAhead::LinearAxes => msg::Job::LOOK_AHEAD_LINEAR_AXES,
        },
    };
    (0..count).map(part).collect()
}

/// A text in slices of at most [`PART`] bytes.
fn slices(mut text: &str) -> Vec<&str> {
    let mut slices = Vec::new();
    while text.len() > PART {
        let end = (0..=PART).rev().find(|&i| text.is_char_boundary(i)).unwrap_or(text.len());
        let (slice, rest) = text.split_at(end);
        slices.push(slice);
        text = rest;
    }
    slices.push(text);
    slices
}

#[cfg(test)]
mod tests {
    use super::*;
    use patchmill_machine_interface::timing::Dynamics;
    use patchmill_products::job::Job;

    #[test]
    fn parts_make_up_the_program_and_the_machine() {
        let plan = PlanFolder {
            program: "(ä)\n".repeat(20_000),
            program_sha256: String::new(),
            machine_urdf: "ß".repeat(PART),
            tool_length: 0.1,
            dynamics: Dynamics::of(&Job::default_for("")),
        };
        let parts = parts(&plan);
        assert!(parts.iter().all(|p| p.text.len() <= PART && p.machine_urdf.len() <= PART));
        assert_eq!(parts.iter().map(|p| p.text.as_str()).collect::<String>(), plan.program);
        assert_eq!(parts.iter().map(|p| p.machine_urdf.as_str()).collect::<String>(), plan.machine_urdf);
        assert!(parts.iter().all(|p| p.part_count as usize == parts.len()));
    }
}
