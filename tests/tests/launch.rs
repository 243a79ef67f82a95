//! The launch scripts: one parameter file, the same nodes by bringup.sh and bringup.launch.py, nodes started by hand in any order.
#![allow(clippy::unwrap_used, reason = "a test's own helpers may fail like the test")]

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use patchmill_msgs::msg::StageStatus;
use patchmill_node_runtime::{Arguments, Node, NodeOptions, Qos, Value, block_on, free_domain, topics};
use patchmill_planner::node_parameters::declared;
use patchmill_tests::children::{Children, program_of, stderr_of, terminate, wait};
use patchmill_tests::executables::{executable, patchmill};
use patchmill_tests::fixture;
use patchmill_tests::golden::RecordedRun;
use serde_json::{Value as Json, json};

/// Every process may take so long to start or to end.
const PATIENCE: Duration = Duration::from_secs(60);

fn scripts() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../launch_scripts").canonicalize().unwrap()
}

fn script(name: &str) -> Command {
    let mut command = Command::new("bash");
    command.arg(scripts().join(name)).arg("--prefix").arg(executables());
    command
}

fn executables() -> PathBuf {
    executable("planner").parent().unwrap().canonicalize().unwrap()
}

/// The names in the one list.
fn listed() -> Vec<String> {
    let text = fs::read_to_string(scripts().join("config/nodes.txt")).unwrap();
    text.lines().filter(|l| !l.starts_with('#')).map(str::to_owned).collect()
}

#[test]
fn the_list_has_every_node_that_is_always_started() {
    let nodes = declared();
    let names: Vec<&str> = nodes.iter().map(|(name, _)| *name).collect();
    let (rest, on_demand) = names.split_at(names.len() - 2);
    assert_eq!(on_demand, [topics::nodes::LIVE_VIEW, topics::nodes::BAG_RECORDER]);
    assert_eq!(listed(), rest);
    assert!(topics::nodes::STAGES.iter().all(|stage| rest.contains(stage)));
}

#[test]
fn the_parameter_file_has_every_parameter_at_its_default() {
    let file = scripts().join("config/patchmill.yaml").display().to_string();
    let line = ["--ros-args", "--params-file", &file].map(str::to_owned);
    let given = Arguments::parse(line, "any", |_| None).unwrap().overrides;
    let mut of_file: Vec<(String, String, Value)> =
        given.into_iter().map(|o| (o.node.unwrap(), o.name, o.value)).collect();
    let mut of_nodes: Vec<(String, String, Value)> = declared()
        .iter()
        .flat_map(|(node, set)| set.defaults().map(|(n, v)| ((*node).to_owned(), n.to_owned(), v.clone())))
        .collect();
    // Equal lists of triples: none missing, none unknown, none twice, same types, same values.
    of_file.sort_by(|a, b| (&a.0, &a.1).cmp(&(&b.0, &b.1)));
    of_nodes.sort_by(|a, b| (&a.0, &a.1).cmp(&(&b.0, &b.1)));
    assert!(of_nodes.len() >= 15);
    assert_eq!(of_file, of_nodes);
}

/// What `bringup.sh --print` would run, in the words of launch_ros's Node.
fn by_script(options: &[&str]) -> Vec<Json> {
    let output = script("bringup.sh").arg("--print").args(options).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap().lines().map(node_of_line).collect()
}

fn node_of_line(line: &str) -> Json {
    let mut words = line.split(' ').peekable();
    let mut environment = json!({});
    if let Some((name, value)) = words.peek().unwrap().split_once('=') {
        environment[name] = json!(value);
        words.next();
    }
    let path = words.next().unwrap();
    assert_eq!(words.next(), Some("--ros-args"));
    let (mut name, mut namespace) = (None, None);
    let (mut files, mut remaps) = (Vec::new(), Vec::new());
    while let Some(option) = words.next() {
        let value = words.next().unwrap();
        match (option, value.split_once(":=")) {
            ("-r", Some(("__node", to))) => name = Some(to),
            ("-r", Some(("__ns", to))) => namespace = Some(to),
            ("-r", Some(_)) => remaps.push(value),
            ("--params-file", _) => files.push(value),
            _ => panic!("{option} {value} in {line}"),
        }
    }
    json!({
        "executable": path, "name": name, "namespace": namespace, "parameters": files, "remappings": remaps,
        "environment": environment, "shuts_down": [false, true, true],
    })
}

/// What `bringup.launch.py` would start.
fn by_launch_file(arguments: &[&str]) -> Vec<Json> {
    let output = Command::new("python3")
        .arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("peers/launch_nodes.py"))
        .arg(scripts().join("bringup.launch.py"))
        .arg(format!("prefix:={}", executables().display()))
        .args(arguments)
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

#[test]
fn launch_file_and_script_start_the_same() {
    let all = by_script(&[]);
    let names: Vec<&str> = all.iter().map(|n| n["name"].as_str().unwrap()).collect();
    assert_eq!(names, listed());
    for (node, name) in all.iter().zip(&names) {
        assert_eq!(node["executable"], executable(name).canonicalize().unwrap().to_str().unwrap());
        assert_eq!((&node["namespace"], &node["environment"]), (&json!("/patchmill"), &json!({})));
        let file = scripts().join("config/patchmill.yaml");
        assert_eq!(node["parameters"], json!([file.to_str().unwrap()]));
    }
    assert_eq!(by_launch_file(&[]), all);

    let file = tempfile::NamedTempFile::new().unwrap();
    let path = file.path().display().to_string();
    let some = by_script(&[
        "--namespace",
        "/cell",
        "--params",
        &path,
        "--domain",
        "41",
        "--without",
        "planner,surface_partitioning",
        "--remap",
        "job:=/plant/job",
        "--remap",
        "/tf:=tf",
    ]);
    assert_eq!(some.len(), all.len() - 2);
    assert_eq!(some[0]["remappings"], json!(["job:=/plant/job", "/tf:=tf"]));
    assert_eq!(some[0]["environment"], json!({ "ROS_DOMAIN_ID": "41" }));
    let params = format!("params:={path}");
    let launched = by_launch_file(&[
        "namespace:=/cell",
        &params,
        "domain:=41",
        "without:=planner,surface_partitioning",
        "remap:=job:=/plant/job /tf:=tf",
    ]);
    assert_eq!(launched, some);
    assert_eq!(by_launch_file(&["only:=planner,path_generation"]).len(), 2);
    assert_eq!(
        by_launch_file(&["only:=planner,path_generation"]),
        by_script(&["--only", "planner,path_generation"])
    );
}

#[test]
fn bad_options_are_refused_before_anything_starts() {
    for (options, word) in [
        (vec!["--only", "planer"], "planer"),
        (vec!["--params", "/no/such/file.yaml"], "/no/such/file.yaml"),
        (vec!["--prefix", "/no/such/folder"], "/no/such/folder"),
        (vec!["--nonsense"], "--nonsense"),
        (vec!["--domain"], "--domain needs a value"),
    ] {
        let output = script("bringup.sh").args(&options).output().unwrap();
        let text = String::from_utf8_lossy(&output.stderr);
        assert!(!output.status.success() && text.contains(word) && !text.contains("started"), "{text}");
    }
}

fn plan(out: &Path, more: &[&str]) {
    let (surface, out) = (fixture("small_bezier.json"), out.to_string_lossy());
    let mut arguments = vec![
        "plan",
        surface.to_str().unwrap(),
        "--out",
        &out,
        "--patches",
        "1..2",
        "--strategy",
        "rolling-ball",
    ];
    arguments.extend(["--tool", "r1=6.7,r2=6,length=100"]);
    arguments.extend(more);
    let output = patchmill(&arguments);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

/// Waits for the status of a stage that has just been started by hand; the planner has none, and is not waited for.
async fn wait_for(observer: &Node, name: &str) {
    if topics::nodes::STAGES.contains(&name) {
        let mut statuses = observer.subscribe::<StageStatus>(&topics::status(name), Qos::Status).unwrap();
        let status = tokio::time::timeout(PATIENCE, statuses.next()).await;
        let status = status.unwrap_or_else(|_| panic!("{name} did not show up")).unwrap();
        assert_eq!((status.node.as_str(), status.state), (name, StageStatus::IDLE));
    }
}

#[test]
fn nodes_started_alone_in_reverse_order_plan_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let (one, apart) = (folder.path().join("one"), folder.path().join("apart"));
    plan(&one, &[]);

    let lease = free_domain().unwrap();
    let domain = lease.domain().to_string();
    let (mut nodes, mut recorder) = (Children::default(), Children::default());
    block_on(async {
        let observer = Node::start(NodeOptions::local("observer", lease.domain())).unwrap();
        for name in listed().iter().rev() {
            let mut command = Command::new(executable(name));
            command.env("ROS_DOMAIN_ID", &domain).current_dir(fixture("")).stderr(Stdio::null());
            nodes.start(&mut command);
            wait_for(&observer, name).await;
        }
        observer.shutdown().await;
    })
    .unwrap();
    let bag = folder.path().join("bag");
    recorder.start(script("record.sh").arg(&bag).args(["--domain", &domain]).stderr(Stdio::null()));
    plan(&apart, &["--domain", &domain]);
    assert!(program_of(&one) == program_of(&apart), "the programs differ");

    // A recorder that has just been started may hear the whole after the command has ended.
    let end = Instant::now() + PATIENCE;
    let recorded = || RecordedRun::open(&bag)?.product::<patchmill_products::program::Program>();
    while recorded().is_err() {
        assert!(Instant::now() < end, "the program is not recorded");
        std::thread::sleep(Duration::from_millis(100));
    }
    recorder.terminate();
    assert!(recorder.wait(PATIENCE).iter().all(|status| status.success()));
    let recorded = RecordedRun::open(&bag).unwrap();
    let program = recorded.product::<patchmill_products::program::Program>().unwrap();
    assert!(program.text.as_bytes() == program_of(&one), "the recorded program differs");
    nodes.terminate();
    assert!(nodes.wait(PATIENCE).iter().all(|status| status.success()));
}

#[test]
fn bringup_in_a_namespace_plans_the_same_and_ends_on_a_signal() {
    let folder = tempfile::tempdir().unwrap();
    let (one, up) = (folder.path().join("one"), folder.path().join("up"));
    plan(&one, &[]);
    let lease = free_domain().unwrap();
    let domain = lease.domain().to_string();
    let mut command = script("bringup.sh");
    command.args(["--domain", &domain, "--namespace", "/cell_1"]).current_dir(fixture(""));
    let mut bringup = command.stderr(Stdio::piped()).spawn().unwrap();
    plan(&up, &["--domain", &domain, "--namespace", "/cell_1"]);
    terminate(&bringup);
    let status = wait(&mut bringup, PATIENCE);
    // The end of the text comes when the last node has closed it.
    let text = stderr_of(&mut bringup);
    assert!(status.success() && text.contains("started surface_ingestion"), "{status}: {text}");
    assert!(!text.contains("killed"), "{text}");
    assert!(program_of(&one) == program_of(&up), "the programs differ");
}

#[test]
fn one_node_that_fails_ends_all_and_is_named() {
    let lease = free_domain().unwrap();
    let file = tempfile::NamedTempFile::new().unwrap();
    fs::write(file.path(), "/**/path_generation:\n  ros__parameters:\n    cloud_points: 1\n").unwrap();
    let mut command = script("bringup.sh");
    command.args(["--domain", &lease.domain().to_string(), "--params"]).arg(file.path());
    let mut bringup = command.stderr(Stdio::piped()).spawn().unwrap();
    let status = wait(&mut bringup, PATIENCE);
    let text = stderr_of(&mut bringup);
    assert_eq!(status.code(), Some(1), "{text}");
    assert!(text.contains("path_generation ended with code 1: ending all"), "{text}");
    assert!(text.contains("[path_generation] ") && text.contains("'cloud_points' is 1"), "{text}");
}
