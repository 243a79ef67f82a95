//! Command line and environment of a node: `--ros-args` with `-r`, `-p`, `--params-file`, `--log-level`, `--enclave`;
//! ROS_DOMAIN_ID and the discovery range.
//!
//! Unlike ROS at large, patchmill talks to this machine only (127.0.0.1) unless ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET says
//! otherwise: a machining program is nobody else's business by default.

use std::path::{Path, PathBuf};

use yaml_rust2::Yaml;

use crate::RuntimeError;
use crate::log::Level;
use crate::parameters::{ParameterSet, Value};
use crate::yaml;

/// Namespace of every node unless remapped.
pub const NAMESPACE: &str = "/patchmill";

/// What the command line and the environment say.
#[derive(Clone, Debug)]
pub struct Arguments {
    /// The node's name unless renamed.
    pub role: String,
    /// Name of the node.
    pub name: String,
    /// Namespace of the node, absolute.
    pub namespace: String,
    /// ROS domain.
    pub domain: u16,
    /// Only this machine (127.0.0.1).
    pub local_only: bool,
    /// Least level that is logged.
    pub log_level: Level,
    /// Enclave of the keystore (`--enclave`), where security is enabled.
    pub enclave: Option<String>,
    /// Names to replace, as given: (from, to).
    pub remaps: Vec<(String, String)>,
    /// Parameter values in order of increasing weight.
    pub overrides: Vec<Override>,
    /// What was outside `--ros-args … --`.
    pub rest: Vec<String>,
}

/// One parameter value from the command line or a file.
#[derive(Clone, Debug, PartialEq)]
pub struct Override {
    /// Node it is meant for; `None` for all.
    pub node: Option<String>,
    /// Name of the parameter.
    pub name: String,
    /// Its value.
    pub value: Value,
    /// Whether a node without such a parameter says so.
    pub strict: bool,
}

/// How a node is started.
pub struct NodeOptions {
    /// What the command line and the environment say.
    pub arguments: Arguments,
    /// The parameters it has.
    pub parameters: ParameterSet,
}

impl NodeOptions {
    /// A node without parameters, in the domain, on this machine only; for nodes in one process and for tests.
    pub fn local(name: &str, domain: u16) -> Self {
        Self { arguments: Arguments::local(name, domain), parameters: ParameterSet::new() }
    }

    /// The same with parameters.
    #[must_use]
    pub fn with_parameters(mut self, parameters: ParameterSet) -> Self {
        self.parameters = parameters;
        self
    }
}

impl Arguments {
    /// The defaults of a node in a domain, without looking at the environment.
    pub fn local(name: &str, domain: u16) -> Self {
        Self {
            role: name.to_owned(),
            name: name.to_owned(),
            namespace: NAMESPACE.to_owned(),
            domain,
            local_only: true,
            log_level: Level::Info,
            enclave: None,
            remaps: Vec::new(),
            overrides: Vec::new(),
            rest: Vec::new(),
        }
    }

    /// From the process's own command line and environment.
    ///
    /// # Errors
    /// As [`Arguments::parse`].
    pub fn from_process(default_name: &str) -> Result<Self, RuntimeError> {
        Self::parse(std::env::args().skip(1), default_name, |name| std::env::var(name).ok())
    }

    /// From a command line without the program's name, and an environment.
    ///
    /// # Errors
    /// [`RuntimeError::Argument`] that names the bad argument or variable and what was expected.
    pub fn parse(
        arguments: impl IntoIterator<Item = String>,
        default_name: &str,
        environment: impl Fn(&str) -> Option<String>,
    ) -> Result<Self, RuntimeError> {
        let mut parsed = Self::local(default_name, 0);
        parsed.read_environment(environment)?;
        let mut arguments = arguments.into_iter();
        let mut ros = false;
        while let Some(argument) = arguments.next() {
            match (ros, argument.as_str()) {
                (false, "--ros-args") => ros = true,
                (true, "--ros-args") => {}
                (true, "--") => ros = false,
                (false, _) => parsed.rest.push(argument),
                (true, option) => {
                    let value = match option {
                        "-r" | "--remap" | "-p" | "--param" | "--params-file" | "--log-level" | "-e"
                        | "--enclave" => {
                            arguments.next().ok_or_else(|| bad(format!("{option} needs a value")))?
                        }
                        _ => return Err(bad(format!("unknown ROS argument '{option}'"))),
                    };
                    parsed.read_ros_option(option, &value)?;
                }
            }
        }
        Ok(parsed)
    }

    /// The value that is given for a parameter of this node, the last one wins.
    pub fn override_of(&self, parameter: &str) -> Option<&Value> {
        self.overrides
            .iter()
            .rev()
            .find(|o| o.name == parameter && o.node.as_deref().is_none_or(|n| n == self.name))
            .map(|o| &o.value)
    }

    /// The absolute name of a topic, service or action after remapping. Relative names are in the namespace, `~/x` in
    /// the node's own.
    pub fn resolve(&self, name: &str) -> String {
        let absolute = self.expand(name);
        self.remaps
            .iter()
            .find(|(from, _)| self.expand(from) == absolute)
            .map_or(absolute, |(_, to)| self.expand(to))
    }

    fn expand(&self, name: &str) -> String {
        let namespace = self.namespace.trim_end_matches('/');
        match (name.strip_prefix("~/"), name.starts_with('/')) {
            (Some(private), _) => format!("{namespace}/{}/{private}", self.name),
            (None, true) => name.to_owned(),
            (None, false) => format!("{namespace}/{name}"),
        }
    }

    fn read_environment(&mut self, environment: impl Fn(&str) -> Option<String>) -> Result<(), RuntimeError> {
        let variable = |name: &str| environment(name).filter(|v| !v.is_empty());
        if let Some(text) = variable("ROS_DOMAIN_ID") {
            self.domain = text
                .parse()
                .ok()
                .filter(|d| *d <= 232)
                .ok_or_else(|| bad(format!("ROS_DOMAIN_ID is '{text}': expected 0 to 232")))?;
        }
        if let Some(text) = variable("ROS_AUTOMATIC_DISCOVERY_RANGE") {
            self.local_only = match text.to_ascii_uppercase().as_str() {
                "LOCALHOST" | "SYSTEM_DEFAULT" => true,
                "SUBNET" => false,
                _ => {
                    return Err(bad(format!(
                        "ROS_AUTOMATIC_DISCOVERY_RANGE is '{text}': expected LOCALHOST or SUBNET"
                    )));
                }
            };
        }
        match variable("ROS_LOCALHOST_ONLY").as_deref() {
            Some("1") => self.local_only = true,
            None | Some("0") => {}
            Some(text) => return Err(bad(format!("ROS_LOCALHOST_ONLY is '{text}': expected 0 or 1"))),
        }
        Ok(())
    }

    fn read_ros_option(&mut self, option: &str, value: &str) -> Result<(), RuntimeError> {
        match option {
            "-r" | "--remap" => self.read_remap(value),
            "-p" | "--param" => {
                let over = parse_parameter(value)?;
                self.overrides.push(over);
                Ok(())
            }
            "--params-file" => {
                let overrides = read_parameter_file(Path::new(value))?;
                self.overrides.extend(overrides);
                Ok(())
            }
            "-e" | "--enclave" => {
                self.enclave = Some(value.to_owned());
                Ok(())
            }
            // "name:=level" sets the level of one logger; there is one.
            _ => {
                let level = value.rsplit(":=").next().unwrap_or(value);
                self.log_level = level.parse().map_err(bad)?;
                Ok(())
            }
        }
    }

    fn read_remap(&mut self, rule: &str) -> Result<(), RuntimeError> {
        let (from, to) =
            rule.split_once(":=").ok_or_else(|| bad(format!("remapping '{rule}': expected from:=to")))?;
        let (node, from) = split_node_prefix(from);
        if node.is_some_and(|n| n != self.name) {
            return Ok(());
        }
        match from {
            "__node" | "__name" => {
                if !is_token(to) {
                    return Err(bad(format!("node name '{to}': expected letters, digits and '_'")));
                }
                self.name = to.to_owned();
            }
            "__ns" => {
                let tokens_fine =
                    to == "/" || to.strip_prefix('/').is_some_and(|t| t.split('/').all(is_token));
                if !tokens_fine {
                    return Err(bad(format!("namespace '{to}': expected an absolute name such as /cell_1")));
                }
                self.namespace = to.to_owned();
            }
            _ => {
                for name in [from, to] {
                    let plain = name.strip_prefix("~/").unwrap_or_else(|| name.trim_start_matches('/'));
                    if !plain.split('/').all(is_token) {
                        return Err(bad(format!("remapping '{rule}': '{name}' is no topic or service name")));
                    }
                }
                self.remaps.push((from.to_owned(), to.to_owned()));
            }
        }
        Ok(())
    }
}

fn bad(text: impl Into<String>) -> RuntimeError {
    RuntimeError::Argument(text.into())
}

fn is_token(text: &str) -> bool {
    let mut characters = text.chars();
    characters.next().is_some_and(|c| c.is_ascii_alphabetic() || c == '_')
        && characters.all(|c| c.is_ascii_alphanumeric() || c == '_')
        && !text.contains("__")
}

/// `node:name` of a rule; a lone name otherwise.
fn split_node_prefix(text: &str) -> (Option<&str>, &str) {
    match text.split_once(':') {
        Some((node, name)) if is_token(node) => (Some(node), name),
        _ => (None, text),
    }
}

fn parse_parameter(text: &str) -> Result<Override, RuntimeError> {
    let (name, value) =
        text.split_once(":=").ok_or_else(|| bad(format!("parameter '{text}': expected name:=value")))?;
    let (node, name) = split_node_prefix(name);
    let documents = yaml::parse(value)
        .map_err(|e| bad(format!("parameter '{name}': '{value}' is no YAML value: {e}")))?;
    let value = match documents.first() {
        None => Value::Text(String::new()),
        Some(yaml) => parse_value(yaml).ok_or_else(|| {
            bad(format!("parameter '{name}': '{value}' is neither bool, number, text nor a list of one kind"))
        })?,
    };
    Ok(Override { node: node.map(str::to_owned), name: name.to_owned(), value, strict: true })
}

fn parse_value(yaml: &Yaml) -> Option<Value> {
    match yaml {
        Yaml::Boolean(b) => Some(Value::Bool(*b)),
        Yaml::Integer(i) => Some(Value::Integer(*i)),
        Yaml::Real(_) => yaml.as_f64().map(Value::Double),
        Yaml::String(s) => Some(Value::Text(s.clone())),
        Yaml::Array(list) => list
            .iter()
            .map(|item| match item {
                Yaml::Integer(i) => Some(*i as f64),
                Yaml::Real(_) => item.as_f64(),
                _ => None,
            })
            .collect::<Option<Vec<f64>>>()
            .map(Value::Doubles),
        _ => None,
    }
}

/// A parameter file in the layout of ROS 2: node (or `/**`), `ros__parameters`, then nested names.
fn read_parameter_file(path: &Path) -> Result<Vec<Override>, RuntimeError> {
    let fail = |text: String| bad(format!("parameter file {}: {text}", PathBuf::from(path).display()));
    let text = yaml::read_text(path)
        .map_err(|e| fail(format!("{e}; expected YAML as launch_scripts/config/patchmill.yaml")))?;
    let documents = yaml::parse(&text).map_err(&fail)?;
    let mut overrides = Vec::new();
    for document in &documents {
        let nodes = document.as_hash().ok_or_else(|| fail("expected node names at the top".to_owned()))?;
        for (node, body) in nodes {
            let node = node.as_str().ok_or_else(|| fail("a node's name is not text".to_owned()))?;
            let values = body["ros__parameters"]
                .as_hash()
                .ok_or_else(|| fail(format!("'{node}' has no mapping 'ros__parameters'")))?;
            let node = match node.rsplit('/').next().unwrap_or(node) {
                "**" | "*" => None,
                name => Some(name.to_owned()),
            };
            let mut collect = Collector { node, overrides: &mut overrides };
            for (name, value) in values {
                collect.add("", name, value).map_err(&fail)?;
            }
        }
    }
    Ok(overrides)
}

struct Collector<'a> {
    node: Option<String>,
    overrides: &'a mut Vec<Override>,
}

impl Collector<'_> {
    fn add(&mut self, prefix: &str, name: &Yaml, value: &Yaml) -> Result<(), String> {
        let name = name.as_str().ok_or_else(|| format!("a name below '{prefix}' is not text"))?;
        let full = if prefix.is_empty() { name.to_owned() } else { format!("{prefix}.{name}") };
        if let Some(inner) = value.as_hash() {
            return inner.iter().try_for_each(|(name, value)| self.add(&full, name, value));
        }
        let value = parse_value(value)
            .ok_or_else(|| format!("'{full}' is neither bool, number, text nor a list of numbers"))?;
        self.overrides.push(Override {
            node: self.node.clone(),
            name: full,
            value,
            strict: self.node.is_some(),
        });
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(line: &str, environment: &[(&str, &str)]) -> Result<Arguments, RuntimeError> {
        Arguments::parse(line.split_whitespace().map(str::to_owned), "node", |name| {
            environment.iter().find(|(n, _)| *n == name).map(|(_, v)| (*v).to_owned())
        })
    }

    #[test]
    fn reads_names_remaps_parameters_and_leaves_the_rest() {
        let line = "plan --ros-args -r __ns:=/cell -r __node:=n2 -r job:=/other/job -r other:x:=y \
                    -p chord:=0.5 -p n:=3 -p n2:on:=true -p text:=abc --log-level warn --enclave /cell/a -- file.stl";
        let a = parse(line, &[("ROS_DOMAIN_ID", "7")]).unwrap();
        assert_eq!((a.name.as_str(), a.namespace.as_str(), a.domain, a.local_only), ("n2", "/cell", 7, true));
        assert_eq!(a.rest, ["plan", "file.stl"]);
        assert_eq!(a.resolve("job"), "/other/job");
        assert_eq!(a.resolve("surface/mesh"), "/cell/surface/mesh");
        assert_eq!(a.resolve("~/status"), "/cell/n2/status");
        assert_eq!(a.override_of("chord"), Some(&Value::Double(0.5)));
        assert_eq!(a.override_of("n"), Some(&Value::Integer(3)));
        assert_eq!(a.override_of("on"), Some(&Value::Bool(true)));
        assert_eq!(a.override_of("text"), Some(&Value::Text("abc".to_owned())));
        assert_eq!(a.log_level, Level::Warn);
        assert_eq!(a.enclave.as_deref(), Some("/cell/a"));
    }

    #[test]
    fn bad_values_are_one_clear_error() {
        for (line, environment, expected) in [
            ("", ("ROS_DOMAIN_ID", "x"), "ROS_DOMAIN_ID is 'x': expected 0 to 232"),
            ("--ros-args -r job", ("", ""), "remapping 'job': expected from:=to"),
            (
                "--ros-args -r __ns:=cell",
                ("", ""),
                "namespace 'cell': expected an absolute name such as /cell_1",
            ),
            ("--ros-args -p a", ("", ""), "parameter 'a': expected name:=value"),
            ("--ros-args -p", ("", ""), "-p needs a value"),
            ("--ros-args --nonsense", ("", ""), "unknown ROS argument '--nonsense'"),
            ("", ("ROS_LOCALHOST_ONLY", "yes"), "ROS_LOCALHOST_ONLY is 'yes': expected 0 or 1"),
        ] {
            let error = parse(line, &[environment]).unwrap_err();
            assert_eq!(error.to_string(), expected);
        }
    }

    #[test]
    fn reads_parameter_files() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let text = "/**:\n  ros__parameters:\n    a: 1\nnode:\n  ros__parameters:\n    b:\n      c: 2.5\n\
                    other:\n  ros__parameters:\n    a: 9\n";
        std::fs::write(file.path(), text).unwrap();
        let a = parse(&format!("--ros-args --params-file {}", file.path().display()), &[]).unwrap();
        assert_eq!(a.override_of("a"), Some(&Value::Integer(1)));
        assert_eq!(a.override_of("b.c"), Some(&Value::Double(2.5)));
    }
}
