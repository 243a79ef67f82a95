//! The stack as real ROS 2 tools see and drive it: rclpy on Fast DDS (PyPI wheels), with `patchmill_msgs` built by colcon.
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a test: its own helpers may fail, and the peers' words go to its output"
)]

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use patchmill_node_runtime::free_domain;
use patchmill_tests::executables::{executable, patchmill, ros_environment};
use patchmill_tests::fixture;
use patchmill_tests::processes::{NODES, Stack};

fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// Runs a script of `tests/peers` in the peers' environment; its output goes to the test's.
fn peer(script: &str, arguments: &[&str], domain: u16, stack: &[&Stack]) {
    let pids: Vec<String> = stack.iter().flat_map(|s| s.pids()).map(|pid| pid.to_string()).collect();
    let output = Command::new("bash")
        .arg("-c")
        .arg(r#"source "$1" && shift && exec python "$@""#)
        .arg("bash")
        .arg(ros_environment())
        .arg(repository().join("tests/peers").join(script))
        .args(arguments)
        .env("ROS_DOMAIN_ID", domain.to_string())
        .env("PATCHMILL_PIDS", pids.join(","))
        .output()
        .unwrap();
    let (out, error) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    println!("{script}:\n{out}{error}");
    assert!(output.status.success(), "{script}: {error}");
}

#[test]
fn rclpy_loads_plans_cancels_and_reads_every_product() {
    let folder = tempfile::tempdir().unwrap();
    let (surface, reference) = (fixture("small_bezier.json"), folder.path().join("plan"));
    let output = patchmill(&[
        "plan",
        "--strategy",
        "rolling-ball",
        &surface.to_string_lossy(),
        "--patches",
        "1..3",
        "--out",
        &reference.to_string_lossy(),
    ]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let lease = free_domain().unwrap();
    let stack = Stack::start(lease.domain(), &[]);
    let program = reference.join("program.ngc");
    let arguments = ["small_bezier.json", "surface_4.stl", &program.to_string_lossy()];
    peer("drive.py", &arguments, lease.domain(), &[&stack]);
}

#[test]
fn rclpy_sees_the_graph_of_the_readme_and_the_parameters() {
    let lease = free_domain().unwrap();
    let stack = Stack::start(lease.domain(), &[]);
    let readme = repository().join("README.md");
    let mut arguments = vec![readme.to_str().unwrap()];
    arguments.extend(NODES);
    peer("introspection.py", &arguments, lease.domain(), &[&stack]);
}

#[test]
fn the_first_call_of_a_client_is_answered() {
    let lease = free_domain().unwrap();
    let stack = Stack::start(lease.domain(), &[]);
    let arguments = ["/patchmill/surface_ingestion/list_parameters", "40"];
    peer("first_calls.py", &arguments, lease.domain(), &[&stack]);
}

#[test]
fn two_stacks_in_two_namespaces_of_one_domain_do_not_mix() {
    let lease = free_domain().unwrap();
    let stacks = ["/cell_1", "/hall/cell_2"].map(|namespace| {
        let rule = format!("__ns:={namespace}");
        Stack::start(lease.domain(), &["-r", &rule])
    });
    let arguments = ["/cell_1", "small_bezier.json", "/hall/cell_2", "surface_3.json"];
    peer("two_stacks.py", &arguments, lease.domain(), &[&stacks[0], &stacks[1]]);
}

#[test]
fn a_node_takes_every_ros_argument() {
    let lease = free_domain().unwrap();
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("parameters.yaml");
    let text = "/**:\n  ros__parameters:\n    max_triangles: 4000\nloader:\n  ros__parameters:\n    \
                samples_per_side: 12\n    chord_tolerance_mm: 0.004\nother:\n  ros__parameters:\n    samples_per_side: 99\n";
    std::fs::write(&file, text).unwrap();
    let mut node = Command::new(executable("surface_ingestion"))
        .env("ROS_DOMAIN_ID", lease.domain().to_string())
        .args(["--ros-args", "-r", "__ns:=/line", "-r", "__node:=loader", "-r", "surface/mesh:=/shared/mesh"])
        .arg("--params-file")
        .arg(&file)
        .args(["-p", "max_triangles:=5000", "-p", "loader:chord_tolerance_mm:=0.002", "--log-level", "warn"])
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let seen = std::panic::catch_unwind(|| peer("arguments.py", &[], lease.domain(), &[]));
    node.kill().unwrap();
    node.wait().unwrap();
    seen.unwrap();
}

#[test]
fn bad_ros_arguments_end_a_node_with_one_clear_error() {
    for (arguments, words) in [
        (&["--ros-args", "-p", "max_triangles:=0"][..], "parameter 'max_triangles' is 0: expected 2 to"),
        (&["--ros-args", "-p", "max_triangels:=9"], "has no parameter 'max_triangels'"),
        (&["--ros-args", "-r", "__ns:=cell"], "namespace 'cell'"),
        (&["--ros-args", "--params-file", "no_such.yaml"], "no_such.yaml"),
        (&["--ros-args", "--log-level", "loud"], "loud"),
        (&["surface.stl"], "unknown argument 'surface.stl'"),
    ] {
        let output = Command::new(executable("surface_ingestion")).args(arguments).output().unwrap();
        let text = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{arguments:?}: {text}");
        assert!(text.contains(words) && text.lines().count() == 1, "{arguments:?}: {text}");
    }
}
