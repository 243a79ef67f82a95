//! The job as it was planned, written so that it can be planned again.

use std::ffi::{OsStr, OsString};
use std::path::{Component, Path, PathBuf};

use clap::{Arg, ArgMatches, CommandFactory};
use patchmill_node_runtime::Value;
use patchmill_node_runtime::arguments::Override;

use super::entries::quoted;
use super::keys::{Holds, arguments, is_flag, is_list, key};
use super::{PARAMETERS, relocated};
use crate::options::CommandLine;

/// How the command tells and where it writes is no part of the job; parameters are written as they were read from all places.
const LEFT_OUT: [&str; 3] = ["out", "json", "verbose"];
/// Which nodes planned is no part of the job either, unless they have its surface.
const STACK: [&str; 2] = ["domain", "namespace"];

/// All options of a command with the values that they have, defaults too.
#[derive(Clone, Debug, Default)]
pub struct Effective {
    command: String,
    values: Vec<Values>,
    /// ROS domain of the nodes that plan, where they ran before.
    domain: Option<String>,
}

#[derive(Clone, Debug)]
struct Values {
    key: String,
    holds: Holds,
    list: bool,
    texts: Vec<OsString>,
}

impl Effective {
    /// Of a parsed command line; empty without a subcommand.
    pub fn of(matches: &ArgMatches) -> Self {
        let mut root = CommandLine::command();
        root.build();
        let Some((name, matches)) = matches.subcommand() else { return Self::default() };
        let Some(command) = root.find_subcommand(name) else { return Self::default() };
        let has_surface = matches.try_get_one("cloud").is_ok_and(|cloud| cloud.copied().unwrap_or(false));
        let written = |argument: &&Arg| {
            let id = argument.get_id().as_str();
            let left_out = LEFT_OUT.contains(&id) || PARAMETERS.iter().any(|(p, _)| *p == id);
            !left_out && (has_surface || !STACK.contains(&id))
        };
        let values = arguments(command).filter(written).filter_map(|a| Values::of(a, matches)).collect();
        let domain = matches.try_get_raw("domain").ok().flatten().and_then(|mut raw| raw.next());
        Self { command: name.to_owned(), values, domain: domain.map(|d| d.to_string_lossy().into_owned()) }
    }

    /// The file's text for a folder, to which its paths are relative; `parameters` are those of the nodes.
    ///
    /// # Errors
    /// When a file that the job names, or the folder's parent, is not there.
    pub fn text(&self, parameters: &[Override], folder: &Path) -> Result<String, String> {
        let folder = settled(folder)?;
        let mut text = format!(
            "# A job of patchmill {}, every option at its value; `patchmill {} --job {} --out DIR` does it again.\n# Paths start from this file's folder.\n",
            env!("CARGO_PKG_VERSION"),
            self.command,
            super::JOB
        );
        if let Some(domain) = &self.domain {
            text +=
                &format!("# Done by the nodes of ROS domain {domain}: their parameters are not in here.\n");
        }
        for Values { key, holds, list, texts } in &self.values {
            let value = |text: &OsString| written(*holds, text, &folder);
            let values = texts.iter().map(value).collect::<Result<Vec<_>, _>>()?;
            text += &lines(key, *list, &values);
        }
        let parameters: Vec<String> = parameters.iter().map(parameter).collect();
        text += &lines("param", true, &parameters);
        Ok(text)
    }
}

impl Values {
    /// `None` for an option without a value.
    fn of(argument: &Arg, matches: &ArgMatches) -> Option<Self> {
        let raw = matches.try_get_raw(argument.get_id().as_str()).ok().flatten();
        let texts: Vec<OsString> = match is_flag(argument) {
            true => vec![OsString::from(matches.get_flag(argument.get_id().as_str()).to_string())],
            false => raw.into_iter().flatten().map(OsStr::to_owned).collect(),
        };
        let (key, holds, list) = (key(argument), Holds::of(argument), is_list(argument));
        (!texts.is_empty()).then_some(Self { key, holds, list, texts })
    }
}

fn lines(key: &str, list: bool, values: &[String]) -> String {
    match values {
        [] => String::new(),
        [one] if !list => format!("{key}: {}\n", quoted(one)),
        several => {
            let items = several.iter().map(|value| format!("- {}\n", quoted(value)));
            std::iter::once(format!("{key}:\n")).chain(items).collect()
        }
    }
}

/// A value with its path, if it names one, relative to the folder.
fn written(holds: Holds, text: &OsStr, folder: &Path) -> Result<String, String> {
    let mut missing = None;
    let placed = relocated(holds, text, |path| match path.canonicalize() {
        Ok(whole) => relative(&whole, folder),
        Err(e) => {
            // What is there all the same is a pipe, such as `<(…)` of a shell.
            let why =
                if path.exists() { "it is no file that job.yaml can name".to_owned() } else { e.to_string() };
            missing = Some(format!("{}: {why}; expected a file that can be read", path.display()));
            path.to_path_buf()
        }
    });
    missing.map_or_else(|| Ok(placed.to_string_lossy().into_owned()), Err)
}

/// The full path of a folder that need not be there yet, though its parent is.
fn settled(folder: &Path) -> Result<PathBuf, String> {
    let absolute = std::path::absolute(folder).map_err(|e| format!("{}: {e}", folder.display()))?;
    if let Ok(there) = absolute.canonicalize() {
        return Ok(there);
    }
    let (Some(parent), Some(name)) = (absolute.parent(), absolute.file_name()) else { return Ok(absolute) };
    let parent = parent.canonicalize().map_err(|e| format!("{}: {e}", parent.display()))?;
    Ok(parent.join(name))
}

/// The way from a folder to a path, both full.
fn relative(path: &Path, folder: &Path) -> PathBuf {
    let (path, folder): (Vec<Component>, Vec<Component>) =
        (path.components().collect(), folder.components().collect());
    let shared = path.iter().zip(&folder).take_while(|(a, b)| a == b).count();
    let up = folder[shared..].iter().map(|_| Component::ParentDir);
    up.chain(path[shared..].iter().copied()).collect()
}

/// A parameter as `-p` takes it.
fn parameter(over: &Override) -> String {
    let value = match &over.value {
        // Debug keeps the point that makes it no whole number.
        Value::Double(number) => format!("{number:?}"),
        Value::Text(text) => serde_json::Value::from(text.as_str()).to_string(),
        other => other.to_string(),
    };
    let node = over.node.as_ref().map_or(String::new(), |node| format!("{node}:"));
    format!("{node}{}:={value}", over.name)
}

#[cfg(test)]
mod tests {
    use patchmill_node_runtime::Arguments;

    use super::*;

    #[test]
    fn paths_lead_from_the_folder() {
        let way =
            |path: &str, folder: &str| relative(Path::new(path), Path::new(folder)).display().to_string();
        assert_eq!(way("/a/b/s.json", "/a/b/plan"), "../s.json");
        assert_eq!(way("/a/b/plan/s.json", "/a/b/plan"), "s.json");
        assert_eq!(way("/x/s.json", "/a/b"), "../../x/s.json");
    }

    #[test]
    fn parameters_are_read_back_as_they_were() {
        let doubles = Value::Doubles(vec![1.0, 2.5e-9]);
        let text = |text: &str| Value::Text(text.to_owned());
        let values = [
            Value::Bool(true),
            Value::Integer(-3),
            Value::Double(2.0),
            Value::Double(1e-7),
            text("exact"),
            text("true"),
            text("7"),
            text("a: 'b' \"c\""),
            text(""),
            doubles,
        ];
        for value in values {
            let over =
                Override { node: Some("planner".to_owned()), name: "x".to_owned(), value, strict: true };
            let line = ["--ros-args".to_owned(), "-p".to_owned(), parameter(&over)];
            let read = Arguments::parse(line, "planner", |_| None).unwrap().overrides;
            assert_eq!(read, [over]);
        }
    }
}
