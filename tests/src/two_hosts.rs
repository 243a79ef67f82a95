//! Two hosts on one machine: see `tests/hosts/two_hosts.sh`.

use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Child, Command, Stdio};

/// Two network namespaces joined by a cable; gone when the value is dropped.
pub struct TwoHosts {
    script: Child,
    names: [String; 2],
}

impl TwoHosts {
    /// Makes them.
    ///
    /// # Panics
    /// When this machine does not allow it: a test that cannot be run is a failure, not a skipped test.
    pub fn new() -> Self {
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("hosts/two_hosts.sh");
        let mut command = Command::new("bash");
        command.arg(script).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut script = match command.spawn() {
            Ok(child) => child,
            Err(e) => panic!("bash cannot be started: {e}"),
        };
        let mut line = String::new();
        if let Some(stdout) = script.stdout.as_mut() {
            // Nothing read is the failure that is reported next.
            let _ = BufReader::new(stdout).read_line(&mut line);
        }
        match line.split_whitespace().collect::<Vec<_>>().as_slice() {
            [a, b] => Self { names: [(*a).to_owned(), (*b).to_owned()], script },
            _ => {
                let mut text = String::new();
                if let Some(mut stderr) = script.stderr.take() {
                    let _ = stderr.read_to_string(&mut text);
                }
                panic!("two hosts are needed for this test. {text}");
            }
        }
    }

    /// A command that runs on the first (0) or second (1) host, where nodes talk to the other.
    pub fn command(&self, host: usize, program: &Path) -> Command {
        let mut command = Command::new("ip");
        command.args(["netns", "exec", &self.names[host]]).arg(program);
        command.env("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET").env_remove("ROS_LOCALHOST_ONLY");
        command
    }
}

impl Default for TwoHosts {
    fn default() -> Self {
        Self::new()
    }
}

impl Drop for TwoHosts {
    fn drop(&mut self) {
        // The end of its input tells the script to remove them.
        drop(self.script.stdin.take());
        let _ = self.script.wait();
    }
}
