//! The command line as a whole: what is typed, with what a job file adds.

use std::ffi::OsString;

use clap::{CommandFactory, FromArgMatches};

use crate::job_file::{Effective, merged};
use crate::options::{Command, CommandLine};

/// Why a command line cannot be followed.
#[derive(Debug)]
pub enum Refusal {
    /// What clap says of it; also its answer to `--help`.
    Usage(Box<clap::Error>),
    /// What is wrong with the job file, in one sentence.
    JobFile(String),
}

/// Reads arguments, the program's name first.
///
/// # Errors
/// [`Refusal`].
pub fn read(arguments: impl IntoIterator<Item = OsString>) -> Result<CommandLine, Refusal> {
    let usage = |e: clap::Error| Refusal::Usage(Box::new(e));
    let merged = merged(arguments.into_iter().collect()).map_err(Refusal::JobFile)?;
    let matches = CommandLine::command().try_get_matches_from(merged.arguments).map_err(usage)?;
    let mut line = CommandLine::from_arg_matches(&matches).map_err(usage)?;
    match &mut line.command {
        Command::Plan(options) => {
            options.run.effective = Effective::of(&matches);
            options.parameters.of_job = merged.parameters;
        }
        Command::Compare(options) => {
            options.run.effective = Effective::of(&matches);
            options.parameters.of_job = merged.parameters;
        }
        _ => {}
    }
    Ok(line)
}
