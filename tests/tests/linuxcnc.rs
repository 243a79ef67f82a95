//! A planned program on a real LinuxCNC whose configuration is made from the machine's URDF, and on the simulated machine.
#![allow(clippy::unwrap_used, reason = "a test's own helpers may fail like the test")]

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::pin::Pin;
use std::process::{Command, Output, Stdio};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use patchmill_machine_interface::execution::program::Deviation;
use patchmill_machine_interface::execution::{ABORTED, BUSY, ExecutableProgram, UNKNOWN_PROGRAM, sha256_hex};
use patchmill_msgs::action::{ExecuteProgram, ExecuteProgramGoal};
use patchmill_msgs::geometry_msgs::msg::PoseStamped;
use patchmill_msgs::sensor_msgs::msg::JointState;
use patchmill_node_runtime::arguments::Override;
use patchmill_node_runtime::{
    ActionEnd, DomainLease, Level, Node, NodeOptions, Value, block_on, free_domain, topics,
};
use patchmill_planner::plan_folder::PlanFolder;
use patchmill_planner::stack::{Stack, StackOptions};
use patchmill_tests::controller::LinuxCnc;
use patchmill_tests::executables::{executable, patchmill};
use patchmill_tests::fixture;
use patchmill_tests::viewer::{View, Viewer};
use tokio::sync::Notify;

/// How far the joints may be from ours.
const LINEAR: f64 = 1e-6;
const ROTARY: f64 = 0.001 * std::f64::consts::PI / 180.0;

/// LinuxCNC's messages go through one port of the machine: one of them at a time.
fn one_at_a_time() -> MutexGuard<'static, ()> {
    static ONE: Mutex<()> = Mutex::new(());
    ONE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A plan of the small surface of which `lines` lines of the program are left; its path tolerance is below what is measured.
fn plan(folder: &Path, lines: usize) -> PathBuf {
    let out = folder.join("plan");
    let surface = fixture("small_bezier.json");
    let (from, to) = (surface.to_string_lossy(), out.to_string_lossy());
    let arguments = [
        "plan",
        &from,
        "--strategy",
        "rolling-ball",
        "--patches",
        "2",
        "--path-tolerance",
        "0.0005",
        "--out",
        &to,
    ];
    let planned = patchmill(&arguments);
    assert!(planned.status.success(), "{}", String::from_utf8_lossy(&planned.stderr));
    let program = fs::read_to_string(out.join("program.ngc")).unwrap();
    assert!(program.contains("G64 P0.0005\n"));
    let mut short: Vec<&str> = program.lines().take(lines).collect();
    short.extend(["M5", "M30", ""]);
    write_program(&out, &short.join("\n"));
    out
}

/// Puts another program into a plan's folder, as if it had been proven.
fn write_program(plan: &Path, program: &str) {
    fs::write(plan.join("program.ngc"), program).unwrap();
    let summary = fs::read_to_string(plan.join("summary.json")).unwrap();
    let mut summary: serde_json::Value = serde_json::from_str(&summary).unwrap();
    summary["program_sha256"] = sha256_hex(program).into();
    fs::write(plan.join("summary.json"), summary.to_string()).unwrap();
}

/// Our own motion of a plan's program.
fn ours(plan: &Path) -> ExecutableProgram {
    let plan = PlanFolder::read(plan).unwrap();
    ExecutableProgram::new(plan.program, plan.machine_urdf, plan.tool_length, plan.dynamics, usize::MAX)
        .unwrap()
}

/// `patchmill execute` as a process; `words` are typed when `when` is first seen in what it says.
fn execute(plan: &Path, arguments: &[&str], when: &str, words: &[&str]) -> Output {
    let mut command = Command::new(executable("patchmill"));
    command.arg("execute").arg(plan).arg("--verbose").args(arguments);
    let mut child =
        command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let (mut input, mut error) = (child.stdin.take().unwrap(), child.stderr.take().unwrap());
    let mut said = Vec::new();
    if !words.is_empty() {
        let mut byte = [0];
        while !String::from_utf8_lossy(&said).contains(when) {
            if std::io::Read::read(&mut error, &mut byte).unwrap() == 0 {
                break;
            }
            said.extend(byte);
        }
        input.write_all((words.join("\n") + "\n").as_bytes()).unwrap();
    }
    std::io::Read::read_to_end(&mut error, &mut said).unwrap();
    let output = child.wait_with_output().unwrap();
    drop(input);
    Output { stderr: said, ..output }
}

fn text(output: &Output) -> String {
    format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr))
}

/// The number before a unit in a run's last line.
fn figure(text: &str, before: &str, unit: &str) -> f64 {
    let rest = text.split(before).nth(1).unwrap_or_else(|| panic!("no `{before}` in {text}"));
    rest.split(unit).next().unwrap().trim().parse().unwrap()
}

/// A machine_interface of its own, and who looks at it.
struct Bench {
    lease: DomainLease,
    stack: Stack,
    viewer: Viewer,
}

impl Bench {
    /// `accepted`: the programs that it runs.
    fn start(accepted: &str) -> Self {
        let lease = free_domain().unwrap();
        let only = |name: &str| name == topics::nodes::MACHINE_INTERFACE;
        let (name, value) = ("accepted_programs".to_owned(), Value::Text(accepted.to_owned()));
        let options = StackOptions {
            domain: lease.domain(),
            surfaces: None,
            machine: "",
            log_level: Level::Fatal,
            parameters: &[Override { node: None, name, value, strict: true }],
        };
        let stack = Stack::start_with(&options, only).unwrap();
        let viewer = Viewer::start("viewer", lease.domain()).unwrap();
        Self { lease, stack, viewer }
    }

    async fn close(self) {
        self.viewer.node().shutdown().await;
        self.stack.shutdown().await;
    }
}

/// Distance of a joint state from the whole path of a program.
fn distance(program: &ExecutableProgram, state: &JointState) -> Deviation {
    let names: Vec<&str> = program.machine.axes().iter().map(|a| a.joint_name.as_str()).collect();
    assert_eq!(state.name, names);
    let joints = std::array::from_fn(|i| state.position[i]);
    let worse = |d: &Deviation| (d.linear / LINEAR).max(d.rotary / ROTARY);
    let all = (0..program.blocks.len()).map(|place| program.deviation(place, &joints));
    all.min_by(|a, b| worse(a).total_cmp(&worse(b))).unwrap()
}

#[test]
fn linuxcnc_follows_our_joints_and_tells_where_they_are() {
    let _one = one_at_a_time();
    let folder = tempfile::tempdir().unwrap();
    let plan = plan(folder.path(), 110);
    let program = ours(&plan);
    let controller = LinuxCnc::start(&folder.path().join("linuxcnc"), &[]);
    block_on(async {
        let bench = Bench::start("any");
        let (domain, name) = (bench.lease.domain().to_string(), controller.name());
        let (run, arguments) = (plan.clone(), [name, domain]);
        let output = tokio::task::spawn_blocking(move || {
            let [name, domain] = arguments.each_ref().map(String::as_str);
            execute(&run, &["--controller", name, "--domain", domain], "running", &["hold", "resume"])
        });
        let output = output.await.unwrap();
        let said = text(&output);
        assert!(output.status.success(), "{said}");
        assert!(figure(&said, "positions, at most ", " mm and") <= LINEAR * 1e3, "{said}");
        assert!(figure(&said, " mm and ", "° from") <= ROTARY.to_degrees(), "{said}");
        // What went out meanwhile: on our path, and at its end in the end.
        let at_end = |state: &JointState| {
            let off = |j: usize| (state.position[j] - program.end()[j]).abs();
            (0..3).all(|j| off(j) <= LINEAR) && (3..5).all(|j| off(j) <= ROTARY)
        };
        let end_tip = program.machine.pose(&program.end()).tip;
        let tip_at_end = |pose: &PoseStamped| {
            let tip = &pose.pose.position;
            (tip.x - end_tip.x).hypot(tip.y - end_tip.y).hypot(tip.z - end_tip.z) < 5e-6
        };
        // Two topics: neither waits for the other.
        let both_at_end = |view: &View| {
            view.joint_states.last().is_some_and(at_end) && view.tool_poses.last().is_some_and(tip_at_end)
        };
        let ended = bench.viewer.when(Duration::from_secs(60), both_at_end).await;
        let view = ended.unwrap_or_else(|view| {
            panic!("{:?} {:?}, not {end_tip}", view.joint_states.last(), view.tool_poses.last())
        });
        // From where it first is on the path; before that it comes from its home.
        let near = |state: &&JointState| {
            let off = distance(&program, state);
            off.linear < 1e-4 && off.rotary < 1e-3
        };
        let states: Vec<&JointState> = view.joint_states.iter().skip_while(|s| !near(s)).collect();
        let on_path = states.iter().filter(|state| {
            let off = distance(&program, state);
            off.linear <= LINEAR && off.rotary <= ROTARY
        });
        let on_path = on_path.count();
        // LinuxCNC copies its joints while they move: a state may mix two servo cycles.
        let worst = states.iter().map(|s| distance(&program, s).linear).fold(0.0, f64::max);
        let enough = states.len() > 10 && on_path * 20 >= states.len() * 19;
        assert!(enough, "{on_path} of {} on the path, at most {worst} m from it", states.len());
        // Once more on the same controller, which now stands at the end and still names the last line.
        let again = [controller.name(), bench.lease.domain().to_string()];
        let output = tokio::task::spawn_blocking(move || {
            let [name, domain] = again.each_ref().map(String::as_str);
            execute(&plan, &["--controller", name, "--domain", domain], "", &[])
        });
        let output = output.await.unwrap();
        let said = text(&output);
        assert!(output.status.success(), "{said}");
        assert!(figure(&said, "positions, at most ", " mm and") <= LINEAR * 1e3, "{said}");
        bench.close().await;
    })
    .unwrap();
}

#[test]
fn a_program_that_the_node_has_not_proven_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let plan = plan(folder.path(), 60);
    let sum = sha256_hex(&fs::read_to_string(plan.join("program.ngc")).unwrap());
    block_on(async {
        for (accepted, runs) in [(String::new(), false), ("0".repeat(64), false), (sum, true)] {
            let bench = Bench::start(&accepted);
            let arguments = (plan.clone(), bench.lease.domain().to_string());
            let output = tokio::task::spawn_blocking(move || {
                execute(&arguments.0, &["--domain", &arguments.1, "--speed", "50"], "", &[])
            });
            let output = output.await.unwrap();
            let said = text(&output);
            assert_eq!(output.status.success(), runs, "{said}");
            assert!(runs || said.contains("accepted_programs") && said.contains("(code 540)"), "{said}");
            bench.close().await;
        }
    })
    .unwrap();
}

#[test]
fn a_goal_names_controllers_of_this_machine_or_those_the_node_was_told_of() {
    let folder = tempfile::tempdir().unwrap();
    let plan = plan(folder.path(), 60);
    let sum = sha256_hex(&fs::read_to_string(plan.join("program.ngc")).unwrap());
    let elsewhere = ["--controller", "linuxcnc://nowhere.invalid:5007"];
    block_on(async {
        let bench = Bench::start(&sum);
        let domain = bench.lease.domain().to_string();
        let asked = (plan.clone(), [elsewhere[0], elsewhere[1], "--domain", &domain].map(str::to_owned));
        let output = tokio::task::spawn_blocking(move || {
            let (plan, arguments) = asked;
            execute(&plan, &arguments.each_ref().map(String::as_str), "", &[])
        });
        let said = text(&output.await.unwrap());
        assert!(said.contains("`controllers`") && said.contains("(code 532)"), "{said}");
        bench.close().await;
    })
    .unwrap();
    // A node of the command's own is told of it, and looks for it.
    let said = text(&execute(&plan, &elsewhere, "", &[]));
    assert!(said.contains("nowhere.invalid") && said.contains("(code 534)"), "{said}");
}

#[test]
fn what_linuxcnc_refuses_is_told_in_its_words() {
    let _one = one_at_a_time();
    let folder = tempfile::tempdir().unwrap();
    let plan = plan(folder.path(), 60);
    // The machine that LinuxCNC knows ends 10 mm below its top.
    let urdf = fs::read_to_string(plan.join("machine.urdf")).unwrap();
    let lower = folder.path().join("lower.urdf");
    fs::write(&lower, urdf.replace(r#"lower="-0.60" upper="0""#, r#"lower="-0.60" upper="-0.01""#)).unwrap();
    let controller =
        LinuxCnc::start(&folder.path().join("linuxcnc"), &["--machine", &lower.to_string_lossy()]);
    let output = execute(&plan, &["--controller", &controller.name()], "", &[]);
    let said = text(&output);
    assert!(!output.status.success() && said.contains("(code 536)"), "{said}");
    assert!(said.to_lowercase().contains("limit") && said.matches("error:").count() == 1, "{said}");
}

#[test]
fn a_lost_linuxcnc_ends_the_run_with_that() {
    let _one = one_at_a_time();
    let folder = tempfile::tempdir().unwrap();
    let plan = plan(folder.path(), 400);
    let mut controller = LinuxCnc::start(&folder.path().join("linuxcnc"), &[]);
    let mut command = Command::new(executable("patchmill"));
    command.arg("execute").arg(&plan).args(["--verbose", "--controller", &controller.name()]);
    let mut child =
        command.stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    let (mut error, mut said, mut byte) = (child.stderr.take().unwrap(), Vec::new(), [0]);
    while !String::from_utf8_lossy(&said).contains("running") {
        assert!(
            std::io::Read::read(&mut error, &mut byte).unwrap() > 0,
            "{}",
            String::from_utf8_lossy(&said)
        );
        said.extend(byte);
    }
    controller.kill();
    std::io::Read::read_to_end(&mut error, &mut said).unwrap();
    let said = String::from_utf8_lossy(&said);
    assert!(!child.wait().unwrap().success());
    assert!(said.contains("was lost while the program ran") && said.contains("(code 535)"), "{said}");
    // The next run says at once that nobody is there.
    let output = execute(&plan, &["--controller", &controller.name()], "", &[]);
    assert!(text(&output).contains("(code 534)"), "{}", text(&output));
}

#[test]
fn the_simulated_machine_runs_any_plan_at_any_speed_and_obeys() {
    let folder = tempfile::tempdir().unwrap();
    let plan = plan(folder.path(), 400);
    let program = ours(&plan);
    let output = execute(&plan, &["--speed", "50"], "", &[]);
    let said = text(&output);
    assert!(output.status.success(), "{said}");
    assert!((figure(&said, "planned ", " s") - program.timing.duration).abs() < 0.06, "{said}");
    assert!(figure(&said, "positions, at most ", " mm and") == 0.0, "{said}");
    let output = execute(&plan, &["--speed", "0.01"], "running", &["hold", "resume", "abort"]);
    let said = text(&output);
    assert!(
        !output.status.success() && said.contains("aborted in line") && said.contains("(code 538)"),
        "{said}"
    );
    let output = execute(&plan, &["--controller", "fanuc"], "", &[]);
    assert!(text(&output).contains("no controller `fanuc`"), "{}", text(&output));
    // Not the program that was proven.
    let changed = fs::read_to_string(plan.join("program.ngc")).unwrap().replace("F2000", "F9000");
    fs::write(plan.join("program.ngc"), changed).unwrap();
    let output = execute(&plan, &[], "", &[]);
    assert!(
        !output.status.success() && text(&output).contains("not the program that was proven"),
        "{}",
        text(&output)
    );
}

#[test]
fn a_planned_program_is_run_by_its_hash_one_at_a_time_and_until_cancelled() {
    block_on(async {
        let lease = free_domain().unwrap();
        let stack = Stack::start(lease.domain(), &fixture(""), "", Level::Fatal).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let (out, domain) = (folder.path().join("plan"), lease.domain().to_string());
        let target = out.clone();
        let planning = tokio::task::spawn_blocking(move || {
            let (surface, out) = (fixture("small_bezier.json"), target.to_string_lossy().into_owned());
            patchmill(&[
                "plan",
                "--strategy",
                "rolling-ball",
                &surface.to_string_lossy(),
                "--patches",
                "1",
                "--out",
                &out,
                "--domain",
                &domain,
            ])
        });
        let planned = planning.await.unwrap();
        assert!(planned.status.success(), "{}", text(&planned));
        let program = ours(&out);
        let node = Node::start(NodeOptions::local("operator", lease.domain())).unwrap();
        let client = node.action_client::<ExecuteProgram>(topics::EXECUTE_PROGRAM).unwrap();
        let goal = |sha256: &str, speed: f64| ExecuteProgramGoal {
            program_sha256: sha256.to_owned(),
            controller: "sim".to_owned(),
            speed,
        };
        let started = Notify::new();
        let run = |goal, tells: bool, cancel| {
            let started = &started;
            let tell = move |_| {
                if tells {
                    started.notify_one();
                }
            };
            client.execute(goal, Duration::from_secs(20), tell, cancel)
        };
        let never = || Box::pin(std::future::pending()) as Pin<Box<dyn Future<Output = ()>>>;
        let end = run(goal(&program.sha256, 100.0), false, never()).await.unwrap();
        let ActionEnd::Succeeded(result) = end else { panic!("{}", end.result().text) };
        assert!((result.planned_time - program.timing.duration).abs() < 1e-9 && result.position_count > 0);
        let end = run(goal("0123", 1.0), false, never()).await.unwrap();
        assert_eq!(end.result().code, UNKNOWN_PROGRAM);
        // The plan's folder brings the same; with another machine, of whatever difference, it brings nothing.
        let (folder_of_plan, domain) = (out.clone(), lease.domain().to_string());
        let bringing = tokio::task::spawn_blocking(move || {
            let bring = || text(&execute(&folder_of_plan, &["--domain", &domain, "--speed", "100"], "", &[]));
            let honest = bring();
            // Whoever changes the machine may change what the summary says of it too.
            let [urdf, summary] = ["machine.urdf", "summary.json"].map(|name| folder_of_plan.join(name));
            let [machine, told] = [&urdf, &summary].map(|file| fs::read_to_string(file).unwrap());
            let other = machine.clone() + "\n";
            assert!(told.contains(&sha256_hex(&machine)));
            fs::write(&summary, told.replace(&sha256_hex(&machine), &sha256_hex(&other))).unwrap();
            fs::write(&urdf, other).unwrap();
            [honest, bring()]
        });
        let [honest, other] = bringing.await.unwrap();
        assert_eq!(figure(&honest, "positions, at most ", " mm and"), 0.0, "{honest}");
        assert!(other.contains("another machine (URDF)") && other.contains("(code 540)"), "{other}");
        let end = run(goal(&program.sha256, 100.0), false, never()).await.unwrap();
        assert!(matches!(end, ActionEnd::Succeeded(_)), "{}", end.result().text);
        // While one runs no other does; the first ends when its client wants no more.
        let (cancel, cancelled) = tokio::sync::oneshot::channel::<()>();
        let until = Box::pin(async move { drop(cancelled.await) }) as Pin<Box<dyn Future<Output = ()>>>;
        let second = async {
            started.notified().await;
            let refused = run(goal(&program.sha256, 1.0), false, never()).await.unwrap();
            cancel.send(()).unwrap();
            refused
        };
        let (first, second) = tokio::join!(run(goal(&program.sha256, 0.1), true, until), second);
        let first = first.unwrap();
        assert!(matches!(first, ActionEnd::Canceled(_)) && first.result().code == ABORTED, "{first:?}");
        assert_eq!(second.result().code, BUSY);
        node.shutdown().await;
        stack.shutdown().await;
    })
    .unwrap();
}

#[test]
fn bad_machines_and_full_folders_are_refused_by_linuxcnc_config() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let run = |more: &[&str]| {
        let directory = out.to_string_lossy();
        let mut arguments = vec!["linuxcnc-config", "--out", &directory];
        arguments.extend(more);
        patchmill(&arguments)
    };
    let refused = |more: &[&str], words: &str| {
        let output = run(more);
        let said = text(&output);
        assert!(!output.status.success() && said.contains(words), "{more:?}: {said}");
        assert!(!out.join("patchmill.ini").exists());
    };
    let urdf = folder.path().join("m.urdf");
    fs::write(&urdf, r#"<robot name="m"><link name="base_link"/></robot>"#).unwrap();
    refused(&["--machine", &urdf.to_string_lossy()], "workpiece");
    refused(&["--machine", "no_such.urdf"], "no_such.urdf");
    fs::create_dir(&out).unwrap();
    fs::write(out.join("mine.txt"), "").unwrap();
    refused(&[], "not empty");
    fs::remove_file(out.join("mine.txt")).unwrap();
    assert!(run(&["--machine", "xyzbc"]).status.success());
    assert!(out.join("start.sh").is_file());
}
