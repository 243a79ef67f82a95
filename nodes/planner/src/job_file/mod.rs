//! A job file (`--job FILE`): every option of the command as a line of YAML. What it says is put into the command line before what is
//! typed, so that the options' own parsers check both; what is typed outweighs it.

mod effective;
mod entries;
mod keys;

use std::error::Error;
use std::ffi::{OsStr, OsString};
use std::path::{Path, PathBuf};

use clap::error::{ContextKind, ContextValue, ErrorKind};
use clap::parser::ValueSource;
use clap::{Arg, ArgMatches, Command, CommandFactory};
use patchmill_machine_interface::MACHINES;
use patchmill_node_runtime::yaml;

pub use effective::Effective;

use crate::options::CommandLine;
use entries::{Entry, entries};
use keys::{Holds, arguments, is_flag, is_list, key};

/// The file that every plan writes into its folder.
pub const JOB: &str = "job.yaml";

/// Parameters of nodes have weights of their own: those of a job file come before all that are typed.
const PARAMETERS: [(&str, &str); 2] = [("params_file", "--params-file"), ("param", "-p")];

/// A command line with what its job file adds.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct Merged {
    /// The arguments, the program's name first.
    pub arguments: Vec<OsString>,
    /// The file's parameters of nodes, as option and value, in order of increasing weight.
    pub parameters: Vec<(&'static str, String)>,
}

/// Puts the job file that a command line names into it; without one it stays as it is.
///
/// # Errors
/// With one sentence that names file, line, key, value and expectation.
pub fn merged(typed: Vec<OsString>) -> Result<Merged, String> {
    let untouched = |arguments| Merged { arguments, parameters: Vec::new() };
    // What is typed wrongly or lacking is found when the whole is parsed.
    let Ok(matches) = CommandLine::command().ignore_errors(true).try_get_matches_from(&typed) else {
        return Ok(untouched(typed));
    };
    let Some((name, matches)) = matches.subcommand() else { return Ok(untouched(typed)) };
    let Ok(Some(file)) = matches.try_get_one::<PathBuf>("job_file") else { return Ok(untouched(typed)) };
    let mut root = CommandLine::command();
    root.build();
    let (Some(command), Some(at)) =
        (root.find_subcommand(name), typed.iter().skip(1).position(|a| a == name))
    else {
        return Ok(untouched(typed));
    };
    let said = |what: String| format!("job file {}: {what}", file.display());
    let text = yaml::read_text(file).map_err(|e| said(format!("it cannot be read: {e}")))?;
    let mut merged = untouched(typed);
    let mut added = Vec::new();
    for entry in entries(&text).map_err(said)? {
        let line = |what: String| said(format!("line {}: {}: {what}", entry.line, entry.key));
        let argument = known(command, &entry.key).map_err(line)?;
        let values = values(command, argument, &entry, folder_of(file)).map_err(line)?;
        if let Some((_, option)) = PARAMETERS.iter().find(|(id, _)| argument.get_id() == id) {
            merged.parameters.extend(values.iter().map(|v| (*option, v.to_string_lossy().into_owned())));
        } else if !is_outweighed(command, argument, matches) {
            added.extend(values.iter().filter_map(|value| spelled(argument, value)));
        }
    }
    // Files first, as with what is typed.
    merged.parameters.sort_by_key(|(option, _)| PARAMETERS.iter().position(|(_, o)| o == option));
    merged.arguments.splice(at + 2..at + 2, added);
    Ok(merged)
}

/// The folder that the file's paths start from; never empty, so that no path looks like an option.
fn folder_of(file: &Path) -> &Path {
    file.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

fn known<'a>(command: &'a Command, name: &str) -> Result<&'a Arg, String> {
    if let Some(argument) = arguments(command).find(|argument| key(argument) == name) {
        return Ok(argument);
    }
    let typed = name.replace('-', "_");
    let keys: Vec<String> = arguments(command).map(key).collect();
    let meant = keys.iter().find(|key| key.starts_with(&typed) || typed.starts_with(key.as_str()));
    Err(match meant {
        Some(key) => format!("there is no such key; is {key} meant?"),
        None => format!("there is no such key; expected one of {}", keys.join(", ")),
    })
}

/// The values of an entry, checked by the option's own parser, paths from the file's folder on. Those that are the default are left out:
/// some options may be typed only beside others.
fn values(command: &Command, argument: &Arg, entry: &Entry, folder: &Path) -> Result<Vec<OsString>, String> {
    if entry.list && !is_list(argument) {
        return Err(format!("it has a list of {}; expected one value{}", entry.values.len(), of(argument)));
    }
    let defaults = argument.get_default_values();
    if !is_flag(argument) && defaults.iter().map(|d| d.as_os_str()).eq(entry.values.iter().map(OsStr::new)) {
        return Ok(Vec::new());
    }
    let from_folder = |path: &Path| if path.is_absolute() { path.to_path_buf() } else { folder.join(path) };
    let one = |value: &String| {
        if is_flag(argument) && !matches!(value.as_str(), "true" | "false") {
            return Err(format!("`{value}` is neither true nor false{}", of(argument)));
        }
        let value = relocated(Holds::of(argument), OsStr::new(value), from_folder);
        check(command, argument, &value).map(|()| value)
    };
    entry.values.iter().map(one).collect()
}

/// The argument that gives an option this value; none for a flag that is false.
fn spelled(argument: &Arg, value: &OsStr) -> Option<OsString> {
    let Some(long) = argument.get_long() else { return Some(value.to_owned()) };
    let mut text = OsString::from(format!("--{long}"));
    if is_flag(argument) {
        return (value == "true").then_some(text);
    }
    text.push("=");
    text.push(value);
    Some(text)
}

/// Lets clap parse the option alone; what else it finds lacking is not asked here.
fn check(command: &Command, argument: &Arg, value: &OsStr) -> Result<(), String> {
    let typed = spelled(argument, value).into_iter();
    let line = std::iter::once(OsString::from(command.get_name())).chain(typed);
    match command.clone().try_get_matches_from(line) {
        Err(e) if matches!(e.kind(), ErrorKind::ValueValidation | ErrorKind::InvalidValue) => {
            let value = value.to_string_lossy();
            Err(format!("`{value}`: {}{}", reason(&e), of(argument)))
        }
        _ => Ok(()),
    }
}

fn reason(error: &clap::Error) -> String {
    match (error.source(), error.get(ContextKind::ValidValue)) {
        (Some(source), _) => source.to_string(),
        (None, Some(ContextValue::Strings(valid))) if !valid.is_empty() => {
            format!("expected one of {}", valid.join(", "))
        }
        _ => "it is no value for it".to_owned(),
    }
}

/// What an option is, for an error.
fn of(argument: &Arg) -> String {
    argument.get_help().map_or(String::new(), |help| format!(" ({help})"))
}

/// Whether the option is typed, or one that excludes it.
fn is_outweighed(command: &Command, argument: &Arg, typed: &ArgMatches) -> bool {
    let is_typed = |a: &Arg| typed.value_source(a.get_id().as_str()) == Some(ValueSource::CommandLine);
    let excludes = |other: &Arg| {
        let of =
            |a: &Arg, b: &Arg| command.get_arg_conflicts_with(a).iter().any(|c| c.get_id() == b.get_id());
        of(other, argument) || of(argument, other)
    };
    is_typed(argument) || arguments(command).any(|other| is_typed(other) && excludes(other))
}

/// A value whose path, if it names one, is put elsewhere.
fn relocated(holds: Holds, value: &OsStr, place: impl FnOnce(&Path) -> PathBuf) -> OsString {
    const FACETS: &str = "facets=";
    let file = value.to_str().and_then(|text| text.strip_prefix(FACETS));
    match (holds, file) {
        (Holds::Condition, Some(file)) => {
            let mut condition = OsString::from(FACETS);
            condition.push(place(Path::new(file)));
            condition
        }
        (Holds::Machine, _) if MACHINES.iter().any(|(name, _)| value == *name) => value.to_owned(),
        (Holds::Path | Holds::Machine, _) => place(Path::new(value)).into_os_string(),
        _ => value.to_owned(),
    }
}

#[cfg(test)]
mod tests;
