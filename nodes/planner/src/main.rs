//! The command `patchmill`.

use std::process::ExitCode;

use clap::Parser;
use patchmill_node_runtime::block_on;
use patchmill_planner::options::{Command, CommandLine};
use patchmill_planner::{
    bag_command, compare_command, dialect_command, execute_command, linuxcnc_config_command, plan_command,
    plot_command, replay_command, report_command, stack,
};

/// `replay`: something differs, or it could not be done.
const DIFFERS: u8 = 1;
const NOT_DONE: u8 = 2;

fn main() -> ExitCode {
    let mut failure = ExitCode::FAILURE;
    let done = match CommandLine::parse().command {
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
        Command::Replay(options) => {
            failure = ExitCode::from(NOT_DONE);
            let code = |same| if same { ExitCode::SUCCESS } else { ExitCode::from(DIFFERS) };
            run(replay_command::replay(&options)).map(code)
        }
    };
    done.unwrap_or_else(|text| {
        eprintln!("patchmill: error: {text}");
        failure
    })
}

fn run<T>(command: impl Future<Output = Result<T, String>>) -> Result<T, String> {
    block_on(command).map_err(|e| e.to_string()).and_then(|done| done)
}
