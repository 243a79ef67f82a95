//! The stack as separate processes, one a node, that end with the test.

use std::process::{Child, Command, Stdio};

use crate::children::{end, signal};
use crate::executables::executable;
use crate::fixture;

/// The nodes of a stack in the order of the data flow, then the planner and the visualization.
pub const NODES: [&str; 7] = [
    "surface_ingestion",
    "rolling_ball_analysis",
    "surface_partitioning",
    "path_generation",
    "machine_interface",
    "planner",
    "visualization",
];

/// Running nodes of one domain.
pub struct Stack {
    domain: u16,
    more: Vec<String>,
    environment: Vec<(String, String)>,
    children: Vec<(String, Child)>,
}

impl Stack {
    /// Starts all nodes. Surfaces are loaded from the fixtures; `more` follows `--ros-args` of every node.
    ///
    /// # Panics
    /// When a node cannot be started.
    pub fn start(domain: u16, more: &[&str]) -> Self {
        Self::start_in(domain, more, &[])
    }

    /// [`Stack::start`] with further variables in the environment of every node.
    ///
    /// # Panics
    /// When a node cannot be started.
    pub fn start_in(domain: u16, more: &[&str], environment: &[(&str, String)]) -> Self {
        let mut stack = Self {
            domain,
            more: more.iter().map(|argument| (*argument).to_owned()).collect(),
            environment: environment
                .iter()
                .map(|(name, value)| ((*name).to_owned(), value.clone()))
                .collect(),
            children: Vec::new(),
        };
        for node in NODES {
            stack.spawn(node);
        }
        stack
    }

    /// Starts one node.
    ///
    /// # Panics
    /// When it cannot be started.
    pub fn spawn(&mut self, node: &str) {
        let mut command = Command::new(executable(node));
        command.envs(self.environment.iter().cloned());
        command.env("ROS_DOMAIN_ID", self.domain.to_string()).stderr(Stdio::null()).arg("--ros-args");
        if node == "surface_ingestion" {
            command.arg("-p").arg(format!("surface_directory:={}", fixture("").display()));
        }
        match command.args(&self.more).spawn() {
            Ok(child) => self.children.push((node.to_owned(), child)),
            Err(e) => panic!("{node} cannot be started: {e}"),
        }
    }

    /// Kills one node as `kill -9` does.
    ///
    /// # Panics
    /// When there is no such node.
    pub fn kill(&mut self, node: &str) {
        let Some(place) = self.children.iter().position(|(name, _)| name == node) else {
            panic!("there is no node {node}");
        };
        let (_, mut child) = self.children.remove(place);
        end(&mut child);
    }

    /// Sends all processes of a node a signal by its name (`STOP`: it answers nobody until `CONT`).
    pub fn signal(&self, node: &str, name: &str) {
        self.children.iter().filter(|(of, _)| of == node).for_each(|(_, child)| signal(child, name));
    }

    /// The process ids.
    pub fn pids(&self) -> Vec<u32> {
        self.children.iter().map(|(_, child)| child.id()).collect()
    }
}

impl Drop for Stack {
    fn drop(&mut self) {
        self.children.iter_mut().for_each(|(_, child)| end(child));
    }
}
