//! A short sample of the long runs under `tests/benches`: nodes and the command killed at random, many calls, stacks and plans.
#![allow(clippy::unwrap_used, reason = "a test's own helpers may fail like the test")]

use std::process::Command;

use patchmill_node_runtime::free_domain;
use patchmill_tests::executables::executable;
use patchmill_tests::markdown::repository;

/// Runs a script on a domain of its own; it ends with code 0 when every bound was kept.
fn soak(name: &str, arguments: &[&str]) {
    let lease = free_domain().unwrap();
    let binaries = executable("patchmill").parent().unwrap().to_owned();
    let mut command = Command::new("python3");
    command.arg(repository().join("tests/benches").join(name)).args(arguments);
    command.args(["--domain", &lease.domain().to_string(), "--binaries"]).arg(binaries);
    let output = command.output().unwrap();
    let [told, error] = [&output.stdout, &output.stderr].map(|text| String::from_utf8_lossy(text));
    assert!(output.status.success(), "{name} {arguments:?}\n{told}{error}");
}

#[test]
fn nodes_killed_at_random_leave_right_plans_or_one_error() {
    soak("kill_soak.py", &["--kills", "10", "--seed", "7"]);
}

/// Memory is held to a wider bound than by the script itself, which looks at 500 plans.
#[test]
fn many_calls_stacks_and_plans_are_answered_and_nothing_piles_up() {
    let sizes = ["--plans", "60", "--calls", "1000", "--stacks", "2", "--flat", "0.5"];
    soak("load_soak.py", &[&["--only", "idle,stacks,calls,plans"], &sizes[..]].concat());
}
