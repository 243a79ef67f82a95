//! The stages on two hosts: analysis and path generation on one, all else on the other, give the program of one host.
#![allow(clippy::unwrap_used, reason = "a test's own helpers may fail like the test")]

use std::fs;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Stdio};

use patchmill_tests::bowl::write_bowl;
use patchmill_tests::children::{Children, program_of};
use patchmill_tests::executables::executable;
use patchmill_tests::fixture;
use patchmill_tests::two_hosts::TwoHosts;

/// Any: the namespaces have their own ports.
const DOMAIN: &str = "7";
const HERE: [&str; 4] = ["surface_ingestion", "surface_partitioning", "machine_interface", "planner"];
const THERE: [&str; 2] = ["rolling_ball_analysis", "path_generation"];

/// The stack on two hosts and a client on the first.
struct Cell {
    /// Dropped before the hosts.
    _nodes: Children,
    hosts: TwoHosts,
}

impl Cell {
    fn start(surfaces: &Path) -> Self {
        let (hosts, mut nodes) = (TwoHosts::new(), Children::default());
        for (host, names) in [&HERE[..], &THERE[..]].into_iter().enumerate() {
            for name in names {
                let mut command = hosts.command(host, &executable(name));
                nodes.start(command.env("ROS_DOMAIN_ID", DOMAIN).current_dir(surfaces).stderr(Stdio::null()));
            }
        }
        Self { _nodes: nodes, hosts }
    }

    fn plan(&self, surface: &Path, out: &Path, more: &[&str]) {
        let command = self.hosts.command(0, &executable("patchmill"));
        plan(command, surface, out, &[more, &["--domain", DOMAIN]].concat());
    }
}

fn plan(mut command: Command, surface: &Path, out: &Path, more: &[&str]) {
    command.args(["plan", "--strategy", "rolling-ball"]).arg(surface).arg("--out").arg(out).args(more);
    let output = command.output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

fn the_same_on_two_hosts(surface: &Path, options: &[&str]) {
    let folder = tempfile::tempdir().unwrap();
    let (one, two) = (folder.path().join("one"), folder.path().join("two"));
    let cell = Cell::start(surface.parent().unwrap());
    cell.plan(surface, &two, options);
    plan(Command::new(executable("patchmill")), surface, &one, options);
    assert!(program_of(&one) == program_of(&two), "the programs differ");
    for file in ["machine.urdf", "summary.json"] {
        let text = |out: &Path| fs::read_to_string(out.join(file)).unwrap();
        assert_eq!(text(&one), text(&two), "{file}");
    }
}

#[test]
fn a_small_surface() {
    // Eight candidates: a result that does not fit one datagram.
    the_same_on_two_hosts(&fixture("small_bezier.json"), &["--tool", "r1=6.7,r2=6,length=100"]);
}

#[test]
fn a_mesh_of_twenty_megabytes() {
    let folder = tempfile::tempdir().unwrap();
    let surface = folder.path().join("bowl.stl");
    write_bowl(&surface, 450).unwrap();
    assert!(fs::metadata(&surface).unwrap().len() > 20_000_000);
    the_same_on_two_hosts(&surface, &["--patches", "1", "--scallop", "0.2"]);
}

#[test]
fn a_node_that_keeps_to_its_machine_does_not_hear_another_host() {
    let hosts = TwoHosts::new();
    let mut there = Children::default();
    let mut node = hosts.command(1, &executable("planner"));
    there.start(node.env("ROS_DOMAIN_ID", DOMAIN).stderr(Stdio::null()));
    let relay = Path::new(env!("CARGO_MANIFEST_DIR")).join("peers/relay.py");
    let mut relaying = hosts.command(1, Path::new("python3"));
    relaying.arg(relay).args(["10.77.0.2", "10.77.0.1", DOMAIN]);
    let mut relaying = relaying.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
    let mut says = BufReader::new(relaying.stdout.take().unwrap()).lines();
    assert_eq!(says.next().unwrap().unwrap(), "ready");
    let doctor = |range: &str| {
        let mut doctor = hosts.command(0, &executable("patchmill"));
        doctor.env("ROS_AUTOMATIC_DISCOVERY_RANGE", range).args(["doctor", "--json", "--domain", DOMAIN]);
        String::from_utf8(doctor.output().unwrap().stdout).unwrap()
    };
    let closed = doctor("LOCALHOST");
    // That one hears where the other does not, be it at a second look.
    let seen = (0..10).any(|_| doctor("SUBNET").contains("/patchmill/planner"));
    drop(relaying.stdin.take());
    let taken: u64 = says.next().unwrap().unwrap().parse().unwrap();
    assert!(relaying.wait().unwrap().success());
    assert!(taken > 0, "nothing reached the other host");
    assert!(closed.contains("nobody else is on domain 7"), "{closed}");
    assert!(seen, "the other host is not heard at all");
}
