//! `patchmill replay` over DDS on the golden bag: from every stage, with altered bags, on another domain, and refusals.
#![allow(clippy::unwrap_used, reason = "a test's own helpers may fail like the test")]

use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use patchmill_bag_recorder::RecordedRun;
use patchmill_msgs::msg::{Job, PartitionCandidate};
use patchmill_node_runtime::{LargeProduct, Qos, free_domain};
use patchmill_planner::replay::tolerances::RULES;
use patchmill_products::field::RollingBallField;
use patchmill_products::program::Program;
use patchmill_products::toolpath::CandidateToolpath;
use patchmill_products::wire::Provenance;
use patchmill_tests::altered_bag::{Copy, topic_of};
use patchmill_tests::children::Children;
use patchmill_tests::executables::{executable, patchmill};
use patchmill_tests::fixture;
use patchmill_tests::golden::golden_bag;

fn replay(bag: &Path, from: &str, more: &[&str]) -> Output {
    let bag = bag.to_string_lossy();
    let mut arguments = vec!["replay", &bag, "--from", from];
    let surface = fixture("small_bezier.json").to_string_lossy().into_owned();
    if from == "surface_ingestion" && !more.contains(&"--surface") {
        arguments.extend(["--surface", &surface]);
    }
    arguments.extend(more);
    patchmill(&arguments)
}

/// The JSON report of a replay that could be done.
fn report(output: &Output) -> serde_json::Value {
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(matches!(output.status.code(), Some(0 | 1)), "{said}");
    serde_json::from_slice(&output.stdout).unwrap_or_else(|e| panic!("{e}: {said}"))
}

/// A replay that could not be done: what it said.
fn refused(output: &Output) -> String {
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{said}{}", String::from_utf8_lossy(&output.stdout));
    assert_eq!(said.matches("error:").count(), 1, "{said}");
    said
}

/// (product, field, values compared) of a report.
fn fields(report: &serde_json::Value) -> Vec<(String, String, u64)> {
    let text = |value: &serde_json::Value| value.as_str().unwrap().to_owned();
    let all = report["fields"].as_array().unwrap();
    all.iter().map(|f| (text(&f["product"]), text(&f["field"]), f["compared"].as_u64().unwrap())).collect()
}

#[test]
fn the_golden_bag_comes_out_the_same_from_every_stage() {
    let first_products = [
        ("surface_ingestion", "surface/mesh"),
        ("rolling_ball_analysis", "analysis/rolling_ball_field"),
        ("surface_partitioning", "partition/candidates"),
        ("path_generation", "toolpath/candidates"),
        ("machine_interface", "machine/evaluation"),
    ];
    for (stage, product) in first_products {
        let output = replay(&golden_bag(), stage, &["--json"]);
        let report = report(&output);
        assert_eq!(output.status.code(), Some(0), "{stage}: {report:#}");
        assert_eq!(report["same"], true);
        let fields = fields(&report);
        // Everything from the stage's own product on, and nothing before it.
        let expected: Vec<(&str, &str)> =
            RULES.iter().map(|r| (r.product, r.field)).skip_while(|(p, _)| *p != product).collect();
        let compared: Vec<(&str, &str)> = fields.iter().map(|(p, f, _)| (p.as_str(), f.as_str())).collect();
        assert_eq!(compared, expected, "{stage}");
    }
}

#[test]
fn the_report_for_people_states_tolerances_and_result() {
    let output = replay(&golden_bag(), "machine_interface", &[]);
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{text}{}", String::from_utf8_lossy(&output.stderr));
    for part in ["machine/program", "proof.gouge_max", "1e-9 m", "exact", "the same: "] {
        assert!(text.contains(part), "{part} in: {text}");
    }
    assert!(!text.contains("differs"), "{text}");
}

/// A copy of the golden bag in which one large product is another one.
fn with_product<P: LargeProduct>(bag: &Path, change: impl FnOnce(&mut P)) {
    let run = RecordedRun::open(&golden_bag()).unwrap();
    let (manifest, mut product) = run.products_of::<P>(|_| true).unwrap().pop().unwrap();
    change(&mut product);
    let head = P::manifest_head(&manifest);
    let provenance = Provenance::read(head.header, head.surface_id, head.job_id).unwrap();
    let (manifest, chunks) = product.split(&provenance).unwrap();
    let names = [P::MANIFEST_TOPIC, P::CHUNK_TOPIC].map(|topic| format!("/patchmill/{topic}"));
    let mut copy = Copy::of(&golden_bag(), bag);
    copy.messages(|message| if names.contains(&message.topic) { None } else { Some(message) });
    copy.add(&names[0], Qos::Product, &manifest);
    chunks.iter().for_each(|chunk| copy.add(&names[1], Qos::Chunks, chunk));
    copy.finish();
}

/// The only difference that a report shows: "product: field: at", recorded, now.
fn only_difference(bag: &Path, from: &str) -> (String, String, String) {
    let output = replay(bag, from, &["--json"]);
    let report = report(&output);
    assert_eq!(output.status.code(), Some(1), "{report:#}");
    let differing: Vec<&serde_json::Value> =
        report["fields"].as_array().unwrap().iter().filter(|f| f["differing"] != 0).collect();
    assert_eq!(differing.len(), 1, "{differing:#?}");
    assert_eq!(differing[0]["differing"], 1);
    let place = &differing[0]["places"][0];
    let text = |value: &serde_json::Value| value.as_str().unwrap().to_owned();
    let at = format!(
        "{}: {}: {}",
        text(&differing[0]["product"]),
        text(&differing[0]["field"]),
        text(&place["at"])
    );
    (at, text(&place["recorded"]), text(&place["now"]))
}

#[test]
fn one_altered_value_is_found_and_named() {
    let root = tempfile::tempdir().unwrap();
    let bag = |name: &str| -> PathBuf { root.path().join(name) };

    // The ball of a sample.
    let mut values = (0.0, 0.0);
    with_product::<RollingBallField>(&bag("ball"), |field| {
        let curvature = &mut field.pseudo_curvature[17];
        values = (*curvature + 0.5, *curvature);
        *curvature += 0.5;
    });
    let (at, recorded, now) = only_difference(&bag("ball"), "rolling_ball_analysis");
    assert_eq!(at, "analysis/rolling_ball_field: pseudo_curvature: [17]");
    assert_eq!((recorded, now), (values.0.to_string(), values.1.to_string()));

    // The label of a sample.
    let mut labels = (0, 0);
    let mut copy = Copy::of(&golden_bag(), &bag("label"));
    copy.messages(|message| {
        if message.topic != "/patchmill/partition/candidates" {
            return Some(message);
        }
        let mut candidate: PartitionCandidate = message.decode().unwrap();
        if candidate.index == 1 {
            let label = &mut candidate.labels[5];
            labels = (1 - *label, *label);
            *label = 1 - *label;
        }
        Some(message.with(&candidate))
    });
    copy.finish();
    let (at, recorded, now) = only_difference(&bag("label"), "surface_partitioning");
    assert_eq!(at, "partition/candidates: labels: candidate 1, [5]");
    assert_eq!((recorded, now), (labels.0.to_string(), labels.1.to_string()));

    // A line of the program, told to a person.
    with_product::<Program>(&bag("line"), |program| program.text = program.text.replacen("G17", "G18", 1));
    let output = replay(&bag("line"), "machine_interface", &[]);
    let text = String::from_utf8_lossy(&output.stdout);
    assert_eq!(output.status.code(), Some(1), "{text}");
    let line = text.lines().find(|line| line.starts_with("differs: machine/program: text: line ")).unwrap();
    let (recorded, now) = line.split_once(", now ").unwrap();
    assert!(recorded.contains("G18") && now.contains("G17") && !now.contains("G18"), "{line}");
}

#[test]
fn what_was_not_recorded_or_cannot_be_fed_is_said() {
    let root = tempfile::tempdir().unwrap();
    let bag = root.path().join("bag");
    let mut copy = Copy::of(&golden_bag(), &bag);
    copy.messages(|message| (!message.topic.contains("/toolpath/")).then_some(message));
    copy.finish();
    assert!(refused(&replay(&bag, "machine_interface", &[])).contains("toolpath/candidates"));
    let output = replay(&bag, "path_generation", &["--json"]);
    assert_eq!(output.status.code(), Some(1));
    let unrecorded = report(&output)["unrecorded"].to_string();
    assert!(unrecorded.contains("toolpath/candidates 0") && unrecorded.contains("toolpath/candidates 1"));
    assert!(refused(&replay(&root.path().join("none"), "path_generation", &[])).contains("none"));
    let no_surface = patchmill(&["replay", &bag.to_string_lossy(), "--from", "surface_ingestion"]);
    assert!(refused(&no_surface).contains("--surface"));
    let other = fixture("surface_3.json").to_string_lossy().into_owned();
    let text = replay(&golden_bag(), "surface_ingestion", &["--surface", &other]);
    assert_eq!(text.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&text.stdout).contains("differs: surface/mesh: surface_id:"));
}

#[test]
fn a_bag_whose_recorder_was_killed_is_replayed_as_far_as_it_goes() {
    let root = tempfile::tempdir().unwrap();
    let bag = root.path().join("bag");
    let mut copy = Copy::of(&golden_bag(), &bag);
    let mut over = false;
    copy.messages(|message| {
        over |= message.topic == "/patchmill/toolpath/candidates";
        (!over).then_some(message)
    });
    copy.finish();
    let file = bag.join("bag_0.mcap");
    let whole = std::fs::read(&file).unwrap();
    std::fs::write(&file, &whole[..whole.len() - 1]).unwrap();
    let output = replay(&bag, "rolling_ball_analysis", &["--json"]);
    let report = report(&output);
    assert_eq!(output.status.code(), Some(0), "{report:#}");
    assert!(fields(&report).iter().any(|(product, _, _)| product == "analysis/rolling_ball_field"));
    let notes = report["notes"].to_string();
    assert!(notes.contains("bag_0.mcap has no end"), "{notes}");
    assert!(notes.contains("machine/program came after the bag's end"), "{notes}");
}

#[test]
fn a_bag_of_another_version_of_the_interfaces_is_refused() {
    let root = tempfile::tempdir().unwrap();
    let theirs = format!("RIHS01_{}", "7".repeat(64));
    let job = topic_of::<Job>("/patchmill/job", Qos::Status);
    // With type hashes, one of them another; without, one definition another.
    for (name, hash, definition) in [
        ("hash", &*theirs, job.definition.to_owned()),
        ("fields", "", job.definition.replace("float64 feed ", "float32 feed ")),
    ] {
        let bag = root.path().join(name);
        let mut copy = Copy::of(&golden_bag(), &bag);
        let (hash, definition): (&'static str, &'static str) = (hash.to_owned().leak(), definition.leak());
        copy.describe(move |topic| {
            if topic.name == "/patchmill/job" {
                (topic.type_hash, topic.definition) = (hash, definition);
            }
        });
        copy.messages(Some);
        copy.finish();
        let said = refused(&replay(&bag, "machine_interface", &[]));
        for part in [
            "/patchmill/job",
            "patchmill_msgs/msg/Job",
            job.type_hash,
            if hash.is_empty() { "none" } else { hash },
        ] {
            assert!(said.contains(part), "{part} in: {said}");
        }
    }
    // Without type hashes, as bags were before there were any, but with these definitions.
    let bag = root.path().join("old");
    let mut copy = Copy::of(&golden_bag(), &bag);
    copy.describe(|topic| topic.type_hash = "");
    copy.messages(Some);
    copy.finish();
    assert!(RecordedRun::open(&bag).unwrap().product::<Program>().is_ok());
}

#[test]
fn nodes_of_another_process_replay_as_often_as_asked() {
    let lease = free_domain().unwrap();
    let domain = lease.domain().to_string();
    let spawn = |node: &str| {
        let mut command = Command::new(executable(node));
        command.env("ROS_DOMAIN_ID", &domain).stderr(Stdio::null()).spawn().unwrap()
    };
    let mut processes = Children(vec![spawn("machine_interface")]);
    for _ in 0..2 {
        let output = replay(&golden_bag(), "machine_interface", &["--domain", &domain]);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    }
    // An altered bag on the same nodes: not their older products are looked at.
    let root = tempfile::tempdir().unwrap();
    let bag = root.path().join("bag");
    let run = RecordedRun::open(&golden_bag()).unwrap();
    let candidates = run.products::<CandidateToolpath>().unwrap().len();
    assert_eq!(candidates, 2);
    with_product::<Program>(&bag, |program| program.machining_time += 1.0);
    let output = replay(&bag, "machine_interface", &["--domain", &domain]);
    assert_eq!(output.status.code(), Some(1), "{}", String::from_utf8_lossy(&output.stderr));
    processes.0.push(spawn("path_generation"));
    assert!(
        refused(&replay(&golden_bag(), "surface_partitioning", &["--domain", &domain]))
            .contains("did not show up")
    );
    let said = refused(&replay(&golden_bag(), "machine_interface", &["--domain", &domain]));
    assert!(said.contains("path_generation runs there too"), "{said}");
}
