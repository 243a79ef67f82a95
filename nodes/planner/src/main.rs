//! The command `patchmill`.

use std::process::ExitCode;

use patchmill_node_runtime::block_on;
use patchmill_planner::command_line::{self, Refusal};
use patchmill_planner::options::Command;
use patchmill_planner::stdout::{say_json, say_usage};
use patchmill_planner::{
    bag_command, compare_command, completions_command, dialect_command, doctor_command, execute_command,
    linuxcnc_config_command, man_command, plan_command, plot_command, replay_command, report_command, stack,
    terminal,
};

/// glibc keeps several times what a process with many threads has in use (nodes/node_runtime/README.md).
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// `replay`: something differs, or it could not be done. A job file that is wrong is a command line that is: 2 as well.
const DIFFERS: u8 = 1;
const NOT_DONE: u8 = 2;

fn main() -> ExitCode {
    let command = match command_line::read(std::env::args_os()) {
        Ok(line) => line.command,
        Err(Refusal::Usage(e)) => return usage(&e),
        Err(Refusal::JobFile(text)) => {
            terminal::error(&text);
            return ExitCode::from(NOT_DONE);
        }
    };
    let json = command.is_json();
    let mut failure = ExitCode::FAILURE;
    let done = match command {
        Command::Plan(options) => run(plan_command::plan(&options)).map(|()| ExitCode::SUCCESS),
        Command::Compare(options) => run(compare_command::compare(&options)).map(|()| ExitCode::SUCCESS),
        Command::Up(options) => run(stack::up(&options)).map(|()| ExitCode::SUCCESS),
        Command::Dialect(options) => dialect_command::dialect(&options).map(|()| ExitCode::SUCCESS),
        Command::Execute(options) => run(execute_command::execute(&options)).map(|()| ExitCode::SUCCESS),
        Command::LinuxcncConfig(options) => {
            linuxcnc_config_command::linuxcnc_config(&options).map(|()| ExitCode::SUCCESS)
        }
        Command::Plot(options) => plot_command::plot(&options).map(|()| ExitCode::SUCCESS),
        Command::Report(options) => report_command::report(&options).map(|()| ExitCode::SUCCESS),
        Command::Bag(command) => bag_command::bag(&command).map(|()| ExitCode::SUCCESS),
        Command::Completions(options) => {
            completions_command::completions(&options).map(|()| ExitCode::SUCCESS)
        }
        Command::Man(options) => man_command::man(&options).map(|()| ExitCode::SUCCESS),
        Command::Doctor(options) => {
            let code = |well| if well { ExitCode::SUCCESS } else { ExitCode::FAILURE };
            run(doctor_command::doctor(&options)).map(code)
        }
        Command::Replay(options) => {
            failure = ExitCode::from(NOT_DONE);
            let code = |same| if same { ExitCode::SUCCESS } else { ExitCode::from(DIFFERS) };
            run(replay_command::replay(&options)).map(code)
        }
    };
    done.unwrap_or_else(|text| {
        terminal::error(&text);
        if json {
            // The error has been told; a document of two strings cannot fail.
            let _ = say_json(&serde_json::json!({ "error": text }));
        }
        failure
    })
}

/// What clap says: its answer to `--help`, or what is wrong with the command line.
fn usage(answer: &clap::Error) -> ExitCode {
    match say_usage(answer) {
        Ok(()) => ExitCode::from(u8::try_from(answer.exit_code()).unwrap_or(NOT_DONE)),
        Err(text) => {
            terminal::error(&text);
            ExitCode::FAILURE
        }
    }
}

fn run<T>(command: impl Future<Output = Result<T, String>>) -> Result<T, String> {
    block_on(command).map_err(|e| e.to_string()).and_then(|done| done)
}
