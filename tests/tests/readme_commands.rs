//! Every command of the READMEs and tutorials: run here as it stands there, or named here with the place where it is run.
//!
//! Commands are the indented lines. `cargo run --release --` stands for the built `patchmill`; /tmp, placeholders and ROS domain 0 are
//! replaced. A line that is in neither list fails, and so does one that no text has any more.
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a test: its own helpers may fail, and what it runs goes to its output"
)]

use std::collections::BTreeSet;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use patchmill_node_runtime::free_domain;
use patchmill_tests::children::{terminate, wait};
use patchmill_tests::executables::{executable, patchmill};
use patchmill_tests::markdown::{repository, texts};

/// What placeholders of a command stand for.
type StandsFor = &'static [(&'static str, &'static str)];

/// Run here, in this order: the command, and what its placeholders stand for.
const RUN: [(&str, StandsFor); 16] = [
    ("cargo run --release -- plan tests/fixtures/surface_1.json --out /tmp/plan", &[]),
    ("patchmill plot /tmp/plan --what passes --out passes.png", &[("passes.png", "/tmp/passes.png")]),
    ("patchmill replay /tmp/plan/bag --from path_generation", &[]),
    ("patchmill replay /tmp/plan/bag --from surface_ingestion --surface tests/fixtures/surface_1.json", &[]),
    ("patchmill bag repair DIR", &[("DIR", "/tmp/plan/bag")]),
    (
        "bash launch_scripts/replay.sh BAG --from STAGE",
        &[("BAG", "/tmp/plan/bag"), ("STAGE", "machine_interface")],
    ),
    ("patchmill execute PLAN", &[("PLAN", "/tmp/plan --speed 500")]),
    (
        "patchmill linuxcnc-config --machine FILE.urdf --tool r1=13.05,r2=6,length=100 --out DIR",
        &[("FILE.urdf", "/tmp/plan/machine.urdf"), ("DIR", "/tmp/lc")],
    ),
    (
        "patchmill plan tests/fixtures/surface_4.stl --out /tmp/chips --tool r1=9,r2=3,length=90 --scallop 0.05 --patches 1..3",
        &[],
    ),
    ("patchmill plot /tmp/chips --what passes --out /tmp/chips/passes.png", &[]),
    ("patchmill plot /tmp/chips --what residual --out /tmp/chips/residual.svg", &[]),
    (
        "patchmill plan tests/fixtures/surface_4.stl --out /tmp/chips_bc --tool r1=9,r2=3,length=90 --scallop 0.05 --patches 1..3 --machine xyzbc --mount auto",
        &[],
    ),
    ("patchmill execute /tmp/chips --controller sim --speed 200", &[]),
    (
        "patchmill linuxcnc-config --machine /tmp/chips/machine.urdf --tool r1=9,r2=3,length=90 --out /tmp/chips_lc",
        &[],
    ),
    ("patchmill dialect /tmp/chips --to heidenhain", &[]),
    ("cargo run --release -p patchmill_tests --example stages -- tests/fixtures/surface_1.json", &[]),
];

/// Run here until they say the word, then ended by SIGTERM.
const STARTED: [(&str, &str, StandsFor); 2] = [
    ("live_view --ros-args -p port:=8766", "ws://127.0.0.1:", &[("8766", "0")]),
    ("bash launch_scripts/bringup.sh", "started surface_ingestion", &[]),
];

/// Run elsewhere, or not at all: where, or why.
const ELSEWHERE: [(&str, &str); 38] = [
    ("bash launch_scripts/test.sh --install", "runs this test"),
    (
        "patchmill linuxcnc-config --machine /tmp/plan/machine.urdf --out /tmp/lc && bash /tmp/lc/start.sh",
        "tests/linuxcnc.rs: a LinuxCNC has the machine's ports to itself",
    ),
    ("patchmill execute /tmp/plan --controller linuxcnc://127.0.0.1:5007", "tests/linuxcnc.rs"),
    ("patchmill execute PLAN --controller linuxcnc://127.0.0.1:5007", "tests/linuxcnc.rs"),
    ("patchmill execute /tmp/chips --controller linuxcnc://127.0.0.1:5007", "tests/linuxcnc.rs"),
    ("bash DIR/start.sh", "tests/linuxcnc.rs"),
    ("bash /tmp/chips_lc/start.sh", "tests/linuxcnc.rs"),
    ("bash launch_scripts/record.sh DIR", "tests/launch.rs"),
    (
        "bag_recorder --ros-args -p directory:=/data/run_7 -p max_bag_size_mib:=512",
        "tests/killed_recorder.rs",
    ),
    ("patchmill up --foxglove", "tests/live_view.rs, on a free port"),
    (
        "patchmill plan tests/fixtures/surface_4.stl --out /tmp/chips_live --tool r1=9,r2=3,length=90 --scallop 0.05 --patches 1..3 --domain 0",
        "tests/live_view.rs plans on the domain of `up`",
    ),
    ("patchmill execute /tmp/chips_live --speed 20 --domain 0", "tests/live_view.rs"),
    ("target/release/patchmill plan SURFACE --out DIR --domain 0", "tests/launch.rs, on a free domain"),
    (
        "rviz2 -d launch_scripts/config/patchmill.rviz",
        "no RViz on PyPI; tests/viewer_files.rs reads the file",
    ),
    (
        "ros2 launch launch_scripts/bringup.launch.py",
        "no launch_ros on PyPI; tests/launch.rs runs the file's functions",
    ),
    (
        "hostA$ ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET bash launch_scripts/bringup.sh --without rolling_ball_analysis,path_generation",
        "tests/two_hosts.rs",
    ),
    (
        "hostB$ ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET bash launch_scripts/bringup.sh --only rolling_ball_analysis,path_generation",
        "tests/two_hosts.rs",
    ),
    (
        "hostA$ ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET target/release/patchmill plan SURFACE --out DIR --domain 0",
        "tests/two_hosts.rs",
    ),
    ("ln -s \"$PWD/msgs\" ~/ws/src/patchmill_msgs", "launch_scripts/peers.sh does it in target/ros_peers"),
    ("cd ~/ws && colcon build --packages-select patchmill_msgs", "launch_scripts/peers.sh"),
    (
        "bash launch_scripts/peers.sh && source target/ros_peers/env.sh",
        "launch_scripts/test.sh, tests/rclpy.rs",
    ),
    (
        "python3 launch_scripts/tutorials/workcell.py tests/fixtures/small_bezier.json --patches 2",
        "tests/rclpy.rs, with a controller that is played",
    ),
    ("cargo build --release --workspace", "launch_scripts/test.sh"),
    ("cargo build --release --workspace --features security", "launch_scripts/test_security.sh"),
    ("bash launch_scripts/keystore.sh /tmp/keystore", "tests/security.rs, by test_security.sh"),
    ("export ROS_SECURITY_ENABLE=true ROS_SECURITY_KEYSTORE=/tmp/keystore", "tests/security.rs"),
    ("target/release/patchmill plan SURFACE --out DIR", "tests/security.rs, with these variables"),
    ("cargo install --locked --path nodes/planner", "builds everything anew: 5 minutes; tried by hand"),
    (
        "python3 tests/benches/scaling.py --mesh part.stl --sizes 100000 --side 47.4",
        "a measurement, by hand on an idle machine",
    ),
    ("target/release/examples/drop_cutter part.stl 400000", "a measurement, by hand on an idle machine"),
    (
        "cargo run --release -p patchmill_geometry --example drop_cutter -- MESH.stl POINTS",
        "a bench; built by launch_scripts/test.sh",
    ),
    (
        "cargo run --release -p patchmill_geometry --example rolling_ball -- MESH.stl SAMPLES",
        "a bench; built by launch_scripts/test.sh",
    ),
    ("python3 tests/peers/bench.py", "needs opencamlib, minutes on a quiet machine"),
    ("bash tests/benches/ros2_figures.sh", "minutes on a quiet machine"),
    ("bash tests/benches/fuzz.sh", "an hour; the test fuzz runs a sample of it"),
    ("python3 tests/benches/kill_soak.py", "half an hour; tests/faults.rs kills one process a stage"),
    ("python3 tests/benches/load_soak.py", "an hour; tests/faults.rs, tests/plan_command.rs"),
    ("bash tests/benches/secured_soak.sh", "a build of its own; tests/security.rs, by test_security.sh"),
];

/// Indented lines that are no commands, or make files that are in the repository, by how they begin.
const NO_COMMANDS: [(&str, &str); 5] = [
    ("nodes/node_runtime/README.md", ""),
    ("nodes/report/README.md", "cd nodes/report/three && npm install"),
    ("nodes/report/README.md", "pyftsubset DejaVuSans.ttf"),
    ("nodes/rolling_ball_analysis/README.md", "κ(Q) = "),
    ("README.md", "surface_ingestion → "),
];

/// The indented lines of a text without their comments; one that ends in a backslash goes on.
fn indented(text: &str) -> Vec<String> {
    let mut found: Vec<String> = Vec::new();
    let mut open = false;
    for line in text.lines().filter_map(|line| line.strip_prefix("    ")) {
        let command = line.split("  #").next().unwrap().trim();
        match found.last_mut().filter(|_| open) {
            Some(last) => last.push_str(command.trim_end_matches('\\')),
            None => found.push(command.trim_end_matches('\\').to_owned()),
        }
        open = command.ends_with('\\');
    }
    found.retain(|command| !command.is_empty());
    found
}

/// The commands of all texts.
fn commands() -> BTreeSet<String> {
    let root = repository();
    let mut found = BTreeSet::new();
    for file in texts() {
        let name = file.strip_prefix(&root).unwrap().to_string_lossy().into_owned();
        let none = |line: &str| NO_COMMANDS.iter().any(|(of, start)| *of == name && line.starts_with(start));
        let text = std::fs::read_to_string(&file).unwrap();
        found.extend(indented(&text).into_iter().filter(|line| !none(line)));
    }
    found
}

#[test]
fn every_command_is_run_somewhere() {
    let here = RUN.iter().map(|(command, _)| *command).chain(STARTED.iter().map(|(command, _, _)| *command));
    let known: BTreeSet<String> =
        here.chain(ELSEWHERE.iter().map(|(command, _)| *command)).map(str::to_owned).collect();
    let found = commands();
    let unknown: Vec<_> = found.difference(&known).collect();
    assert!(unknown.is_empty(), "run by no test: {unknown:#?}");
    let gone: Vec<_> = known.difference(&found).collect();
    assert!(gone.is_empty(), "in no README any more: {gone:#?}");
}

/// Where the commands find the workspace's executables, and a folder in place of /tmp.
struct Shell {
    scratch: tempfile::TempDir,
    domain: String,
}

impl Shell {
    fn line(&self, command: &str, stands_for: StandsFor) -> String {
        let mut line = command.replace("cargo run --release -- ", "patchmill ");
        line =
            line.replace("cargo run --release -p patchmill_tests --example stages -- ", "examples/stages ");
        for (placeholder, value) in stands_for {
            line = line.replace(placeholder, value);
        }
        line.replace("/tmp/", &format!("{}/", self.scratch.path().display()))
    }

    fn command(&self, line: &str) -> Command {
        let executables = executable("patchmill").parent().unwrap().canonicalize().unwrap();
        let path = format!("{}:{}", executables.display(), std::env::var("PATH").unwrap());
        let line = line.replace("examples/stages ", &format!("{}/examples/stages ", executables.display()));
        let mut command = Command::new("bash");
        command.args(["-c", &format!("exec {line}")]).current_dir(repository());
        command.env("PATH", path).env("ROS_DOMAIN_ID", &self.domain).stdin(Stdio::null());
        command
    }
}

#[test]
fn commands_do_what_the_readmes_say() {
    let lease = free_domain().unwrap();
    let shell = Shell { scratch: tempfile::tempdir().unwrap(), domain: lease.domain().to_string() };
    for (command, stands_for) in RUN {
        let (line, begin) = (shell.line(command, stands_for), Instant::now());
        let output = shell.command(&line).output().unwrap();
        println!("{:5.1} s  {command}", begin.elapsed().as_secs_f64());
        assert!(output.status.success(), "{line}: {}", String::from_utf8_lossy(&output.stderr));
    }
    for made in [
        "plan/report.html",
        "passes.png",
        "lc/start.sh",
        "chips/residual.svg",
        "chips/program.h",
        "chips_lc/start.sh",
    ] {
        let path = shell.scratch.path().join(made);
        assert!(path.metadata().is_ok_and(|file| file.len() > 100), "{made} was not made");
    }
    for (command, word, stands_for) in STARTED {
        let errors = shell.scratch.path().join("errors");
        let file = std::fs::File::create(&errors).unwrap();
        let mut child = shell.command(&shell.line(command, stands_for)).stderr(file).spawn().unwrap();
        let said = says(&errors, word);
        terminate(&child);
        let status = wait(&mut child, Duration::from_secs(30));
        assert!(
            said && status.success(),
            "{command}: {status}: {}",
            std::fs::read_to_string(&errors).unwrap()
        );
    }
}

/// Whether the file has the word within half a minute.
fn says(file: &Path, word: &str) -> bool {
    let end = Instant::now() + Duration::from_secs(30);
    while Instant::now() < end {
        if std::fs::read_to_string(file).is_ok_and(|text| text.contains(word)) {
            return true;
        }
        std::thread::sleep(Duration::from_millis(50));
    }
    false
}

/// Commands within the prose: subcommand and options are there.
#[test]
fn options_in_the_prose_exist() {
    let mut seen = 0;
    for file in texts() {
        let text = std::fs::read_to_string(&file).unwrap();
        let prose: String =
            text.lines().filter(|line| !line.starts_with("    ")).collect::<Vec<_>>().join(" ");
        for span in prose.split('`').skip(1).step_by(2).filter(|span| span.starts_with("patchmill ")) {
            check_span(span, &file);
            seen += 1;
        }
    }
    assert!(seen > 30, "{seen} commands seen");
}

fn check_span(span: &str, file: &Path) {
    // Only the first of several commands.
    let line = span.split("&&").next().unwrap();
    let mut words = line.split_whitespace().skip(1);
    let Some(subcommand) =
        words.next().filter(|word| word.chars().all(|c| c.is_ascii_lowercase() || c == '-'))
    else {
        return;
    };
    let output = patchmill(&[subcommand, "--help"]);
    let help = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{}: `{span}`: there is no {subcommand}", file.display());
    for option in words.filter(|word| word.starts_with("--")) {
        let option = option.split('=').next().unwrap();
        assert!(
            help.contains(option),
            "{}: `{span}`: patchmill {subcommand} has no {option}",
            file.display()
        );
    }
}
