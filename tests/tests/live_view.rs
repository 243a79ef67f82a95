//! `patchmill up --foxglove`: what a real client of Foxglove's WebSocket protocol sees of a planning run and of an execution, early
//! and late, beside what DDS gives.
#![allow(clippy::unwrap_used, reason = "a test's own helpers may fail like the test")]

use std::io::{BufRead, BufReader, Read, Write};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use patchmill_node_runtime::{block_on, free_domain, topics};
use patchmill_tests::children::{Children, stderr_of, wait};
use patchmill_tests::executables::{executable, patchmill, peers_python};
use patchmill_tests::fixture;
use patchmill_tests::viewer::{MARKER_TOPICS, Viewer};
use serde_json::Value as Json;

const PATIENCE: Duration = Duration::from_secs(60);
const LATCHED: [&str; 9] = [
    "job",
    "machine/evaluation",
    "robot_description",
    "visualization/patches",
    "visualization/passes",
    "visualization/tool_axes",
    "visualization/tool",
    "visualization/residual",
    "machine/program",
];
const STREAMS: [&str; 4] = ["joint_states", "machine/tool_pose", "/tf", "/diagnostics"];

fn absolute(topic: &str) -> String {
    if topic.starts_with('/') { topic.to_owned() } else { format!("/patchmill/{topic}") }
}

/// The line of a child's stderr that holds the word; what comes after it goes `on`, by a thread, so that the child never waits.
fn line_with(child: &mut Child, word: &str, mut on: impl Write + Send + 'static) -> String {
    let mut lines = BufReader::new(child.stderr.take().unwrap());
    let mut text = String::new();
    loop {
        let mut line = String::new();
        assert!(lines.read_line(&mut line).unwrap() > 0, "it ended without '{word}': {text}");
        if line.contains(word) {
            std::thread::spawn(move || std::io::copy(&mut lines, &mut on));
            return line;
        }
        text += &line;
    }
}

/// A stack with a live view on a free port, and its address.
fn up(domain: u16) -> (Children, String) {
    let mut up = Children::default();
    let domain = domain.to_string();
    let surfaces = fixture("");
    let line = ["up", "--foxglove", "0", "--domain", &domain, "--surfaces", surfaces.to_str().unwrap()];
    up.start(Command::new(executable("patchmill")).args(line).stderr(Stdio::piped()));
    let line = line_with(&mut up.0[0], "ws://", std::io::sink());
    let url = line.split_whitespace().find(|word| word.starts_with("ws://")).unwrap().to_owned();
    (up, url)
}

/// A client that has subscribed.
fn client(url: &str, want: &[&str], moving: &[&str]) -> Child {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("peers/foxglove_client.py");
    let mut command = Command::new(peers_python());
    command.arg(script).arg(url).args(["--seconds", "90", "--want"]);
    command.args(want.iter().map(|topic| absolute(topic)));
    command.arg("--moving").args(moving.iter().map(|topic| absolute(topic)));
    command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
}

fn seen(mut client: Child) -> Json {
    let (mut out, mut errors) = (String::new(), String::new());
    client.stdout.take().unwrap().read_to_string(&mut out).unwrap();
    if let Some(mut stderr) = client.stderr.take() {
        stderr.read_to_string(&mut errors).unwrap();
    }
    assert!(client.wait().unwrap().success(), "{errors}");
    serde_json::from_str(&out).unwrap()
}

fn plan(domain: u16, out: &Path) -> Json {
    let (surface, out_text, domain) =
        (fixture("small_bezier.json"), out.to_string_lossy(), domain.to_string());
    let mut line = vec!["plan", surface.to_str().unwrap(), "--out", &out_text, "--domain", &domain];
    line.extend(["--patches", "1..2", "--tool", "r1=6.7,r2=6,length=100"]);
    let output = patchmill(&line);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&std::fs::read(out.join("summary.json")).unwrap()).unwrap()
}

#[test]
fn a_foxglove_client_sees_planning_and_execution() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("plan");
    let lease = free_domain().unwrap();
    let (_up, url) = up(lease.domain());

    let mut early = client(&url, &LATCHED, &[]);
    line_with(&mut early, "subscribed", std::io::stderr());
    let summary = plan(lease.domain(), &out);
    let early = seen(early);
    let wanted: Vec<&str> = LATCHED.iter().chain(&STREAMS).copied().collect();
    let late = seen(client(&url, &wanted, &[]));

    for topic in LATCHED.map(absolute) {
        assert!(early[&topic]["messages"].as_u64() > Some(0), "{topic}");
        assert_eq!(
            early[&topic]["digest"], late[&topic]["digest"],
            "{topic}: late and early client see different things"
        );
    }
    assert_eq!(late["/patchmill/job"]["job_id"], summary["job_id"]);
    let patches = summary["chosen_patches"].as_u64().unwrap() as usize;
    let names: Vec<String> = (0..patches).map(|i| format!("patch_{i}")).collect();
    assert_eq!(late["/patchmill/visualization/patches"]["namespaces"], serde_json::json!(names));
    let urdf = std::fs::read_to_string(out.join("machine.urdf")).unwrap();
    assert_eq!(late["/patchmill/robot_description"]["text"], urdf.as_str());
    assert!(late["/tf"]["frames"].as_array().unwrap().len() >= 5);
    for stage in topics::nodes::STAGES {
        assert!(late[&format!("/patchmill/{stage}/status")]["messages"].as_u64() == Some(1), "{stage}");
    }
    same_as_dds(lease.domain(), &late);

    let mut watching = client(&url, &STREAMS, &["joint_states"]);
    line_with(&mut watching, "subscribed", std::io::stderr());
    let domain = lease.domain().to_string();
    let run = patchmill(&["execute", &out.to_string_lossy(), "--domain", &domain, "--speed", "10"]);
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    let watched = seen(watching);
    assert!(watched["/patchmill/joint_states"]["positions"].as_u64() >= Some(10));
}

/// Markers and clouds are those that a subscriber of DDS gets.
fn same_as_dds(domain: u16, late: &Json) {
    block_on(async {
        let viewer = Viewer::start("beside", domain).unwrap();
        let markers = |topic: &str| late[&absolute(topic)]["markers"].as_u64().unwrap() as usize;
        let points = |topic: &str| late[&absolute(topic)]["points"].as_u64().unwrap() as usize;
        let width = |topic: &str| late[&absolute(topic)]["width"].as_u64().unwrap();
        let same = viewer.when(PATIENCE, |view| {
            MARKER_TOPICS.iter().all(|topic| {
                let scene = view.scene(topic);
                scene.markers.len() == markers(topic)
                    && scene.markers.values().map(|m| m.points.len()).sum::<usize>() == points(topic)
            }) && view.clouds.last().is_some_and(|c| u64::from(c.width) == width(topics::ROLLING_BALL_RADIUS))
                && view
                    .residuals
                    .last()
                    .is_some_and(|c| u64::from(c.width) == width(topics::VISUALIZATION_RESIDUAL))
        });
        assert!(same.await.is_ok(), "DDS and the WebSocket show different things");
        assert!(width(topics::VISUALIZATION_RESIDUAL) > 0 && points(topics::VISUALIZATION_PASSES) > 0);
        viewer.node().shutdown().await;
    })
    .unwrap();
}

#[test]
fn a_port_that_is_taken_is_named() {
    let taken = std::net::TcpListener::bind(("127.0.0.1", 0)).unwrap();
    let port = taken.local_addr().unwrap().port().to_string();
    let lease = free_domain().unwrap();
    let mut up = Command::new(executable("patchmill"))
        .args(["up", "--foxglove", &port, "--domain", &lease.domain().to_string()])
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let status = wait(&mut up, PATIENCE);
    let text = stderr_of(&mut up);
    assert!(!status.success() && text.contains(&format!("127.0.0.1:{port}")), "{text}");
}
