//! The workspace's executables, as `cargo build --workspace` leaves them beside the tests.

use std::path::PathBuf;
use std::process::{Command, Output};

/// Path of a built executable.
///
/// # Panics
/// When it has not been built: `launch_scripts/test.sh` builds the workspace first.
pub fn executable(name: &str) -> PathBuf {
    let test = std::env::current_exe().unwrap_or_default();
    let path =
        test.parent().and_then(|deps| deps.parent()).map(|release| release.join(name)).unwrap_or_default();
    assert!(path.is_file(), "{} is not built: run cargo build --release --workspace", path.display());
    path
}

/// Runs `patchmill` with arguments to its end.
///
/// # Panics
/// When it cannot be started.
pub fn patchmill(arguments: &[&str]) -> Output {
    match Command::new(executable("patchmill")).args(arguments).output() {
        Ok(output) => output,
        Err(e) => panic!("patchmill cannot be started: {e}"),
    }
}

/// The Python of the peers (rosbags, mcap-ros2-support, selenium), from `PATCHMILL_PEERS_PYTHON`.
///
/// # Panics
/// When the variable is not set: a peer that is missing is a failure, not a skipped test.
pub fn peers_python() -> String {
    match std::env::var("PATCHMILL_PEERS_PYTHON") {
        Ok(python) => python,
        Err(_) => panic!("PATCHMILL_PEERS_PYTHON is not set: run the tests by launch_scripts/test.sh"),
    }
}

/// The file that sets the environment of the ROS 2 peers, from `PATCHMILL_ROS_ENV`; `launch_scripts/peers.sh` makes it.
///
/// # Panics
/// When the variable is not set: a peer that is missing is a failure, not a skipped test.
pub fn ros_environment() -> String {
    match std::env::var("PATCHMILL_ROS_ENV") {
        Ok(file) => file,
        Err(_) => panic!("PATCHMILL_ROS_ENV is not set: run the tests by launch_scripts/test.sh"),
    }
}
