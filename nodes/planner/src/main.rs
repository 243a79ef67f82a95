//! The command `patchmill`.

use std::process::ExitCode;

use clap::Parser;
use patchmill_node_runtime::block_on;
use patchmill_planner::options::{Command, CommandLine};
use patchmill_planner::{plan_command, stack};

fn main() -> ExitCode {
    let done = match CommandLine::parse().command {
        Command::Plan(options) => block_on(plan_command::plan(&options)),
        Command::Up(options) => block_on(stack::up(&options)),
    };
    match done.map_err(|e| e.to_string()).and_then(|done| done) {
        Ok(()) => ExitCode::SUCCESS,
        Err(text) => {
            eprintln!("patchmill: error: {text}");
            ExitCode::FAILURE
        }
    }
}
