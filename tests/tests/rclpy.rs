//! The stack as real ROS 2 tools see and drive it: rclpy on Fast DDS (PyPI wheels), with `patchmill_msgs` built by colcon.
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a test: its own helpers may fail, and the peers' words go to its output"
)]

use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use patchmill_geometry::mesh::TriangleMesh;
use patchmill_msgs::srv::{LoadSurface, LoadSurfaceRequest, LoadSurfaceResponse};
use patchmill_node_runtime::{Node, NodeOptions, ProductReceiver, Received, block_on, free_domain, topics};
use patchmill_tests::children::{Children, stderr_of, wait};
use patchmill_tests::executables::{executable, patchmill, ros_environment};
use patchmill_tests::fixture;
use patchmill_tests::processes::{NODES, Stack};

fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// A script of `tests/peers` in the peers' environment.
fn command(script: &str, arguments: &[&str], domain: u16) -> Command {
    let mut command = Command::new("bash");
    command
        .arg("-c")
        .arg(r#"source "$1" && shift && exec python "$@""#)
        .arg("bash")
        .arg(ros_environment())
        .arg(repository().join("tests/peers").join(script))
        .args(arguments)
        .env("ROS_DOMAIN_ID", domain.to_string());
    command
}

/// Runs a script of `tests/peers` to its end; its output goes to the test's.
fn peer(script: &str, arguments: &[&str], domain: u16, stack: &[&Stack]) {
    let pids: Vec<String> = stack.iter().flat_map(|s| s.pids()).map(|pid| pid.to_string()).collect();
    let output = command(script, arguments, domain).env("PATCHMILL_PIDS", pids.join(",")).output().unwrap();
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
    // The newest mesh, to one that comes late, by its content hash.
    peer("large_products.py", &[], lease.domain(), &[&stack]);
}

#[test]
fn rclpy_sees_the_graph_of_the_readmes_and_the_parameters() {
    let lease = free_domain().unwrap();
    let stack = Stack::start(lease.domain(), &[]);
    let root = repository();
    let mut arguments = vec![root.to_str().unwrap()];
    arguments.extend(NODES);
    peer("introspection.py", &arguments, lease.domain(), &[&stack]);
}

#[test]
fn the_tutorials_workcell_plans_and_commands_a_controller() {
    let lease = free_domain().unwrap();
    let _stack = Stack::start(lease.domain(), &[]);
    let mut controller = command("fake_controller.py", &[], lease.domain());
    let mut controller = controller.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let tutorial = "../../launch_scripts/tutorials/workcell.py";
    peer(tutorial, &["small_bezier.json", "--patches", "2"], lease.domain(), &[]);
    let status = wait(&mut controller, Duration::from_secs(60));
    let mut taken = String::new();
    controller.stdout.take().unwrap().read_to_string(&mut taken).unwrap();
    assert!(status.success() && taken.starts_with("taken: "), "{taken}{}", stderr_of(&mut controller));
}

#[test]
fn the_first_call_of_a_client_is_answered() {
    let lease = free_domain().unwrap();
    let stack = Stack::start(lease.domain(), &[]);
    let arguments = ["/patchmill/surface_ingestion/list_parameters", "40"];
    peer("first_calls.py", &arguments, lease.domain(), &[&stack]);
}

#[test]
fn a_node_that_ends_is_gone_for_rclpy_at_once() {
    let lease = free_domain().unwrap();
    peer("leaving.py", &[&executable("path_generation").to_string_lossy()], lease.domain(), &[]);
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

/// Asks surface_ingestion for the newest cloud of a scanner that rclpy plays: the answer, and the mesh where there is one.
fn scanned(domain: u16, arguments: [&str; 3]) -> (LoadSurfaceResponse, Option<TriangleMesh>) {
    let mut scanner = Children::default();
    scanner.start(&mut command("cloud.py", &arguments, domain));
    block_on(async {
        let node = Node::start(NodeOptions::local("user", domain)).unwrap();
        let mut meshes = ProductReceiver::<TriangleMesh>::new(&node).unwrap();
        let client = node.service_client::<LoadSurface>(topics::LOAD_SURFACE).unwrap();
        let request =
            LoadSurfaceRequest { newest_cloud: true, cloud_wait: 30.0, ..LoadSurfaceRequest::default() };
        let patience = Duration::from_secs(60);
        let answer = client.call(&request, patience, patience).await.unwrap();
        let mut mesh = None;
        while answer.code == 0 && mesh.is_none() {
            match tokio::time::timeout(patience, meshes.next()).await.unwrap() {
                Some(Received::Product { key, product, .. }) if key.surface_id == answer.surface_id => {
                    mesh = Some(product);
                }
                Some(_) => {}
                None => break,
            }
        }
        node.shutdown().await;
        (answer, mesh)
    })
    .unwrap()
}

/// Nodes in one process, as `patchmill up` runs them.
fn up(domain: u16) -> Children {
    let mut nodes = Children::default();
    nodes.start(
        Command::new(executable("patchmill"))
            .args(["up", "--domain", &domain.to_string()])
            .stderr(Stdio::null()),
    );
    nodes
}

#[test]
fn a_cloud_of_several_megabytes_from_rclpy_is_planned_and_proven() {
    let lease = free_domain().unwrap();
    let domain = lease.domain();
    let _nodes = up(domain);
    let (answer, mesh) = scanned(domain, ["reliable", "560", "workpiece"]);
    assert_eq!(answer.code, 0, "{}", answer.text);
    // 5.4 MB of which 142 × 142 points are no NaN; some vertices are lost at the border.
    assert!((19_500..=20_164).contains(&answer.vertex_count), "{}", answer.text);
    assert!(answer.text.contains("315836 without a return"), "{}", answer.text);
    let mesh = mesh.unwrap();
    assert_eq!(mesh.vertices.len(), answer.vertex_count as usize);
    for p in &mesh.vertices {
        let off = p.z - (p.x * p.x / 0.24 + p.y * p.y / 0.9);
        assert!(off.abs() < 1e-6 && p.x.abs() < 0.0181 && p.y.abs() < 0.0181, "{p}");
    }

    // The scanner is gone: its newest cloud is planned.
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("plan");
    let output = patchmill(&[
        "plan",
        "--cloud",
        "--domain",
        &domain.to_string(),
        "--patches",
        "1..2",
        "--out",
        &out.to_string_lossy(),
    ]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let summary = std::fs::read_to_string(out.join("summary.json")).unwrap();
    let summary: serde_json::Value = serde_json::from_str(&summary).unwrap();
    println!("planned: {} {} s", summary["proof"], summary["machining_time_s"]);
    assert_eq!(
        (&summary["surface"], &summary["surface_id"]),
        (&"newest cloud".into(), &answer.surface_id.into())
    );
    assert!(summary["proof"]["gouge_max_mm"].as_f64().unwrap() <= 0.005);
    assert!(summary["proof"]["area_within_scallop"].as_f64().unwrap() > 0.995);
}

#[test]
fn a_best_effort_scanner_is_heard() {
    let lease = free_domain().unwrap();
    let _nodes = up(lease.domain());
    let (answer, _) = scanned(lease.domain(), ["best_effort", "142", "workpiece"]);
    assert!(answer.code == 0 && answer.vertex_count > 19_500, "{}", answer.text);
}
