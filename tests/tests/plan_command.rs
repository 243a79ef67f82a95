//! `patchmill plan` as a user runs it: all nodes over DDS in one process, and in separate processes.
#![allow(clippy::unwrap_used, reason = "a test's own helpers may fail like the test")]

use std::fs;
use std::path::Path;
use std::process::Command;

use patchmill_node_runtime::free_domain;
use patchmill_tests::executables::{executable, patchmill, peers_python};
use patchmill_tests::fixture;
use patchmill_tests::processes::Stack;

fn plan(surface: &Path, out: &Path, more: &[&str]) -> std::process::Output {
    let (surface, out) = (surface.to_string_lossy(), out.to_string_lossy());
    let mut arguments = vec!["plan", &surface, "--out", &out];
    arguments.extend(more);
    patchmill(&arguments)
}

fn planned(surface: &Path, out: &Path, more: &[&str]) {
    let output = plan(surface, out, more);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

#[test]
fn one_process_and_separate_processes_give_the_same_accepted_program() {
    let folder = tempfile::tempdir().unwrap();
    let surface = fixture("surface_3.json");
    let one = folder.path().join("one");
    planned(&surface, &one, &["--patches", "2..3"]);
    for name in ["program.ngc", "machine.urdf", "summary.json", "bag/metadata.yaml"] {
        assert!(one.join(name).is_file(), "{name}");
    }
    accepted_by_linuxcnc(&one, folder.path());
    decoded_by_peers(&one.join("bag"));
    summary_is_whole(&one);

    let lease = free_domain().unwrap();
    let domain = lease.domain().to_string();
    let _stack = Stack::start(lease.domain(), &[]);
    let apart = folder.path().join("apart");
    planned(&surface, &apart, &["--patches", "2..3", "--domain", &domain]);
    let program = |out: &Path| fs::read(out.join("program.ngc")).unwrap();
    assert!(program(&one) == program(&apart), "the programs differ");
}

#[test]
fn as_many_open_files_as_most_systems_allow_unasked_are_enough() {
    let folder = tempfile::tempdir().unwrap();
    let output = Command::new("sh")
        .args(["-c", "ulimit -S -n 1024; exec \"$0\" \"$@\""])
        .arg(executable("patchmill"))
        .arg("plan")
        .arg(fixture("small_bezier.json"))
        .args(["--patches", "1", "--out"])
        .arg(folder.path().join("plan"))
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

#[test]
fn a_trough_scanned_and_as_a_mesh_gives_the_same_length_of_cut() {
    let folder = tempfile::tempdir().unwrap();
    // 36 mm of a trough, every 0.6 mm: radii of 120 and 450 mm, as a bowl's feed direction would be anybody's guess.
    let (side, height) = (61, |x: f64, y: f64| x * x / 240.0 + y * y / 900.0);
    let corner = |k: usize| (0.6 * (k / side) as f64 - 18.0, 0.6 * (k % side) as f64 - 18.0);
    let corners = || (0..side * side).map(corner).map(|(x, y)| format!("{x:.4} {y:.4} {:.6}", height(x, y)));
    let points: String = corners().map(|line| line + "\n").collect();
    let facet = |k: usize| format!("f {} {} {} {}\n", k + 1, k + side + 1, k + side + 2, k + 2);
    let facets: String = (0..side * (side - 1)).filter(|k| k % side + 1 < side).map(facet).collect();
    let mesh: String = corners().map(|line| format!("v {line}\n")).collect::<String>() + &facets;
    let cut_length = |name: &str, content: &str| {
        let (surface, out) = (folder.path().join(name), folder.path().join(format!("{name}.plan")));
        fs::write(&surface, content).unwrap();
        planned(&surface, &out, &["--patches", "1..1", "--strategy", "rolling-ball"]);
        let summary: serde_json::Value =
            serde_json::from_str(&fs::read_to_string(out.join("summary.json")).unwrap()).unwrap();
        summary["candidates"][0]["cut_length_mm"].as_f64().unwrap()
    };
    let (scanned, meshed) = (cut_length("trough.xyz", &points), cut_length("trough.obj", &mesh));
    assert!(meshed > 300.0 && (scanned / meshed - 1.0).abs() < 2e-3, "{scanned} {meshed}");
}

#[test]
fn a_nurbs_surface_is_planned_with_parameters_from_file_and_line() {
    let folder = tempfile::tempdir().unwrap();
    let (surface, out) = (fixture("nurbs_trough.json"), folder.path().join("out"));
    let file = folder.path().join("nodes.yaml");
    fs::write(&file, "/**:\n  ros__parameters:\n    samples_per_side: 30\n    shadow: exact\n").unwrap();
    let file = file.to_string_lossy();
    let samples = ["-p", "surface_ingestion:samples_per_side:=20"];
    planned(&surface, &out, &[&["--patches", "1", "--params-file", &file], &samples[..]].concat());
    let summary: serde_json::Value =
        serde_json::from_str(&fs::read_to_string(out.join("summary.json")).unwrap()).unwrap();
    // 20 samples a side; the trough's arcs have a radius of 90 mm, the surface none that is smaller.
    assert_eq!(summary["patches"][0]["sample_count"], 400);
    let radius = summary["patches"][0]["smallest_concave_radius_mm"].as_f64().unwrap();
    assert!((radius - 90.0).abs() < 1e-6, "{radius}");
    assert!(summary["proof"]["gouge_max_mm"].as_f64().unwrap() < 0.005);
    assert!(summary["proof"]["area_within_scallop"].as_f64().unwrap() > 0.999);

    let content = fs::read(&surface).unwrap();
    refused("s.json", &content, &["-p", "planner:shadow:=exact"], &["planner has no parameter 'shadow'"]);
    refused("s.json", &content, &["-p", "samples_per_side:=9999"], &["samples_per_side", "2 to 1000"]);
    refused("s.json", &content, &["-p", "shadow:=exact", "--domain", "99"], &["run already"]);
}

#[test]
fn a_step_face_with_a_hole_is_planned_and_proven() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    planned(
        &fixture("step/freeform_hole.step"),
        &out,
        &["--patches", "1", "-p", "chord_tolerance_mm:=0.002", "--tool", "r1=0,r2=5"],
    );
    let summary: serde_json::Value =
        serde_json::from_str(&fs::read_to_string(out.join("summary.json")).unwrap()).unwrap();
    assert!(summary["proof"]["gouge_max_mm"].as_f64().unwrap() < 0.005);
    assert!(summary["proof"]["area_within_scallop"].as_f64().unwrap() > 0.995);
    // As Open CASCADE has it.
    let area = summary["patches"][0]["area_mm2"].as_f64().unwrap();
    assert!((area / 2889.752 - 1.0).abs() < 1e-3, "{area}");
}

fn accepted_by_linuxcnc(out: &Path, scratch: &Path) {
    let table = scratch.join("tool.tbl");
    fs::write(&table, "T1 P1 D38.1 Z100\n").unwrap();
    let output = Command::new("rs274")
        .arg("-g")
        .arg("-t")
        .arg(&table)
        .arg(out.join("program.ngc"))
        .current_dir(scratch)
        .output()
        .unwrap();
    assert!(output.status.success(), "rs274: {}", String::from_utf8_lossy(&output.stderr));
    let canon = String::from_utf8_lossy(&output.stdout);
    assert!(canon.matches("STRAIGHT_FEED").count() > 100, "rs274 saw no cutting moves");
}

fn decoded_by_peers(bag: &Path) {
    let topics = [
        "/patchmill/job",
        "/patchmill/surface/mesh",
        "/patchmill/surface/mesh/chunks",
        "/patchmill/surface/samples",
        "/patchmill/surface/samples/chunks",
        "/patchmill/analysis/rolling_ball_field",
        "/patchmill/analysis/rolling_ball_field/chunks",
        "/patchmill/partition/candidates",
        "/patchmill/toolpath/candidates",
        "/patchmill/toolpath/candidates/chunks",
        "/patchmill/machine/evaluation",
        "/patchmill/machine/model",
        "/patchmill/machine/program",
        "/patchmill/machine/program/chunks",
        "/patchmill/machine/joint_trajectory",
        "/patchmill/machine/joint_trajectory/chunks",
        "/patchmill/machine/trajectory",
        "/patchmill/machine/tool_pose",
        "/patchmill/robot_description",
        "/patchmill/joint_states",
        "/tf",
        "/tf_static",
    ];
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("peers/read_bag.py");
    let output =
        Command::new(peers_python()).arg(script).arg(bag).arg("--expect").args(topics).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

fn summary_is_whole(out: &Path) {
    let text = fs::read_to_string(out.join("summary.json")).unwrap();
    let summary: serde_json::Value = serde_json::from_str(&text).unwrap();
    let candidates = summary["candidates"].as_array().unwrap();
    assert_eq!(candidates.len(), 2);
    for candidate in candidates {
        assert!(candidate["feasible"].is_boolean() && candidate["reason"].is_string());
        assert!(candidate["machining_time_s"].is_number() && candidate["cut_length_mm"].is_number());
    }
    assert!(summary["machining_time_s"].as_f64().unwrap() > 0.0);
    assert_eq!(summary["tool"]["r1_mm"], 13.05);
    let patches = summary["patches"].as_array().unwrap();
    assert_eq!(patches.len() as u64, summary["chosen_patches"].as_u64().unwrap());
    for patch in patches {
        assert_eq!(patch["rotary_deg"].as_array().unwrap().len(), 2);
        assert!(patch["sample_count"].as_u64().unwrap() > 0 && patch["step_over_mm"][0].is_number());
    }
}

/// One case of bad input: what is written to the surface file, options, and words that the error has to have.
fn refused(name: &str, content: &[u8], more: &[&str], words: &[&str]) {
    let folder = tempfile::tempdir().unwrap();
    let surface = folder.path().join(name);
    fs::write(&surface, content).unwrap();
    let out = folder.path().join("out");
    let output = plan(&surface, &out, more);
    let text = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success(), "{name} {more:?} was accepted");
    assert_eq!(text.matches("error:").count(), 1, "{name}: {text}");
    for word in words {
        assert!(text.contains(word), "{name} {more:?}: no '{word}' in: {text}");
    }
    let left: Vec<_> = fs::read_dir(folder.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
    assert_eq!(left, [std::ffi::OsString::from(name)], "{name}: something was left behind");
}

#[test]
fn bad_surfaces_are_refused_with_one_clear_error() {
    let algebraic = |expression: &str| {
        format!(r#"{{"kind":"algebraic","expression":"{expression}","x":[0,60],"y":[0,40]}}"#)
    };
    refused("empty.stl", b"", &[], &["empty"]);
    let mut truncated = fs::read(fixture("surface_4.stl")).unwrap();
    truncated.truncate(5000);
    refused("truncated.stl", &truncated, &[], &["bytes"]);
    let mut nan = fs::read(fixture("surface_4.stl")).unwrap();
    nan[84 + 12..84 + 16].copy_from_slice(&f32::NAN.to_le_bytes());
    refused("nan.stl", &nan, &[], &["facet"]);
    refused("net.json", br#"{"kind":"bezier","units":"mm","control_points":[[[0,0,0]]]}"#, &[], &["4"]);
    refused("name.json", algebraic("x + q").as_bytes(), &[], &["q"]);
    refused("pole.json", algebraic("1/(x-20.3)").as_bytes(), &[], &["20."]);
}

#[test]
fn bad_machines_tools_and_folders_are_refused_with_one_clear_error() {
    let small = fs::read(fixture("small_bezier.json")).unwrap();
    let big = ["--tool", "r1=50,r2=40,length=100", "--patches", "1"];
    let surface = fs::read(fixture("surface_3.json")).unwrap();
    refused("surface.json", &surface, &big, &["mm", "fit"]);
    let far = String::from_utf8_lossy(&small).replace("[42.0,", "[4200.0,").replace("[28.0,", "[2800.0,");
    let far = far.replace("[14.0,", "[1400.0,");
    refused("far.json", far.as_bytes(), &["--patches", "1"], &["travel"]);
    let folder = tempfile::tempdir().unwrap();
    let urdf = folder.path().join("m.urdf");
    fs::write(&urdf, r#"<robot name="m"><link name="base_link"/></robot>"#).unwrap();
    let machine = ["--machine", &urdf.to_string_lossy(), "--patches", "1"];
    refused("small.json", &small, &machine, &["workpiece"]);

    let missing = plan(Path::new("no_such_surface.json"), &folder.path().join("out"), &[]);
    let text = String::from_utf8_lossy(&missing.stderr);
    assert!(!missing.status.success() && text.contains("no_such_surface.json"), "{text}");
    let unwritable = plan(&fixture("small_bezier.json"), Path::new("/proc/out"), &[]);
    let text = String::from_utf8_lossy(&unwritable.stderr);
    assert!(!unwritable.status.success() && text.contains("/proc/out"), "{text}");
}
