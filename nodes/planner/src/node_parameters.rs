//! Parameters of the nodes that the command starts in its own process, given as ROS 2 gives them: files and `NODE:NAME:=VALUE`.

use std::path::PathBuf;

use clap::Args;
use patchmill_node_runtime::arguments::Override;
use patchmill_node_runtime::{Arguments, ParameterSet, topics::nodes};

/// Parameters as typed.
#[derive(Args, Debug, Default)]
pub struct ParameterOptions {
    /// ROS 2 parameter file for the nodes that are started, such as launch_scripts/config/patchmill.yaml; of several the later ones
    /// outweigh the earlier
    #[arg(long, value_name = "FILE")]
    pub params_file: Vec<PathBuf>,
    /// A parameter of a node that is started (without NODE: of every one that has it); outweighs the files
    #[arg(short = 'p', long = "param", value_name = "[NODE:]NAME:=VALUE")]
    pub param: Vec<String>,
    /// Those of a job file, as option and value; what is typed outweighs them.
    #[arg(skip)]
    pub of_job: Vec<(&'static str, String)>,
}

impl ParameterOptions {
    /// Whether nothing is given.
    pub fn is_empty(&self) -> bool {
        self.params_file.is_empty() && self.param.is_empty() && self.of_job.is_empty()
    }

    /// What the nodes are told. `fixed` are parameters that the command itself sets: a file's are passed over, typed ones refused.
    ///
    /// # Errors
    /// For a file or value that cannot be read, and for a node or a name that there is not.
    pub fn read(&self, fixed: &[&str]) -> Result<Vec<Override>, String> {
        let files =
            self.params_file.iter().map(|file| ("--params-file", file.to_string_lossy().into_owned()));
        let typed = self.param.iter().map(|parameter| ("-p", parameter.clone()));
        let mut read = Vec::new();
        for (option, value) in self.of_job.iter().cloned().chain(files).chain(typed) {
            let line = ["--ros-args", option, &value].map(str::to_owned);
            let parsed = Arguments::parse(line, "patchmill", |_| None).map_err(|e| e.to_string())?;
            for mut over in parsed.overrides {
                let typed = option == "-p";
                if fixed.contains(&over.name.as_str()) {
                    if typed {
                        return Err(format!(
                            "-p {value}: this command sets the parameter {} itself",
                            over.name
                        ));
                    }
                    continue;
                }
                check(&over, typed).map_err(|text| format!("{option} {value}: {text}"))?;
                // Checked here: a node that lacks what was meant for others need not complain.
                over.strict = false;
                read.push(over);
            }
        }
        Ok(read)
    }
}

/// Every node with its parameters; those that are started on demand only (live view, recorder) last. A parameter file may also be meant
/// for the recorder, which the command runs its own way.
pub fn declared() -> [(&'static str, ParameterSet); 9] {
    [
        (nodes::SURFACE_INGESTION, patchmill_surface_ingestion::node::parameters()),
        (nodes::ROLLING_BALL_ANALYSIS, patchmill_rolling_ball_analysis::node::parameters()),
        (nodes::SURFACE_PARTITIONING, patchmill_surface_partitioning::node::parameters()),
        (nodes::PATH_GENERATION, patchmill_path_generation::node::parameters()),
        (nodes::MACHINE_INTERFACE, patchmill_machine_interface::node::parameters()),
        (nodes::PLANNER, crate::node::parameters()),
        (nodes::VISUALIZATION, patchmill_visualization::node::parameters()),
        (nodes::LIVE_VIEW, patchmill_live_view::node::parameters()),
        (nodes::BAG_RECORDER, patchmill_bag_recorder::recorder::parameters()),
    ]
}

fn check(over: &Override, typed: bool) -> Result<(), String> {
    let known = declared();
    let listed = |names: &mut dyn Iterator<Item = &str>| {
        let names: Vec<&str> = names.collect();
        if names.is_empty() { "none".to_owned() } else { names.join(", ") }
    };
    let has = |set: &ParameterSet| set.defaults().any(|(name, _)| name == over.name);
    match over.node.as_deref() {
        Some(nodes::BAG_RECORDER) if typed => {
            Err("the command runs bag_recorder without parameters".to_owned())
        }
        Some(node) => match known.iter().find(|(name, _)| *name == node) {
            None => {
                let nodes = listed(&mut known.iter().map(|(name, _)| *name));
                Err(format!("there is no node '{node}'; there are {nodes}"))
            }
            Some((_, set)) if !has(set) => {
                let names = listed(&mut set.defaults().map(|(name, _)| name));
                Err(format!("{node} has no parameter '{}'; it has {names}", over.name))
            }
            Some(_) => Ok(()),
        },
        None if known.iter().any(|(_, set)| has(set)) => Ok(()),
        None => Err(format!(
            "no node has a parameter '{}'; launch_scripts/config/patchmill.yaml has all",
            over.name
        )),
    }
}

#[cfg(test)]
mod tests {
    use patchmill_node_runtime::Value;

    use super::*;

    fn read(files: &[&str], param: &[&str]) -> Result<Vec<Override>, String> {
        let options = ParameterOptions {
            params_file: files.iter().map(PathBuf::from).collect(),
            param: param.iter().map(|p| (*p).to_owned()).collect(),
            of_job: Vec::new(),
        };
        options.read(&["surface_directory"])
    }

    #[test]
    fn typed_values_come_after_the_files() {
        let shipped = concat!(env!("CARGO_MANIFEST_DIR"), "/../../launch_scripts/config/patchmill.yaml");
        let all = read(&[shipped], &["surface_ingestion:noise_tolerance_mm:=0.2", "shadow:=exact"]).unwrap();
        assert!(all.iter().all(|over| over.name != "surface_directory" && !over.strict));
        let last = |name: &str| all.iter().rev().find(|over| over.name == name).unwrap();
        let noise = last("noise_tolerance_mm");
        assert_eq!((noise.node.as_deref(), &noise.value), (Some("surface_ingestion"), &Value::Double(0.2)));
        assert_eq!(last("shadow").value, Value::Text("exact".to_owned()));
        assert!(all.iter().filter(|over| over.name == "noise_tolerance_mm").count() == 2);
    }

    #[test]
    fn what_no_node_has_is_named() {
        for (bad, words) in [
            (
                "surface_ingestion:noise:=0.1",
                "surface_ingestion has no parameter 'noise'; it has surface_directory,",
            ),
            ("noise:=0.1", "no node has a parameter 'noise'"),
            (
                "ingestion:noise_tolerance_mm:=0.1",
                "there is no node 'ingestion'; there are surface_ingestion,",
            ),
            ("surface_directory:=/", "sets the parameter surface_directory itself"),
            ("bag_recorder:buffer_mib:=3", "bag_recorder"),
            ("noise_tolerance_mm", "expected name:=value"),
        ] {
            let text = read(&[], &[bad]).unwrap_err();
            assert!(text.contains(words) && !text.contains('\n'), "{bad}: {text}");
        }
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a.yaml");
        std::fs::write(&file, "/**:\n  ros__parameters:\n    noise: 0.1\n").unwrap();
        let text = read(&[&file.to_string_lossy()], &[]).unwrap_err();
        assert!(text.contains("a.yaml: no node has a parameter 'noise'"), "{text}");
        assert!(read(&["no_such.yaml"], &[]).unwrap_err().contains("no_such.yaml"));
    }
}
