//! Programs in tilted planes, read back by parsers of their own (`peers/check_dialects.py`) to the joint program's poses.
#![allow(clippy::unwrap_used, reason = "a test's own helpers may fail like the test")]

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use patchmill_tests::executables::{patchmill, peers_python};
use patchmill_tests::fixture;
use sha2::{Digest, Sha256};

const FILES: [(&str, &str); 3] =
    [("siemens", "program.mpf"), ("heidenhain", "program.h"), ("fanuc", "program.nc")];

/// The shipped machine with a head that nutates about 45°, the workpiece askew on its table.
const NUTATING: [&str; 4] = ["--machine", "xyzbc_nutating", "--mount", "-30,-20,50,0,0,23"];

fn planned(out: &Path, more: &[&str]) {
    let (surface, out) = (fixture("small_bezier.json"), out.to_string_lossy());
    let surface = surface.to_string_lossy();
    let mut arguments = vec!["plan", &surface, "--strategy", "rolling-ball", "--out", &out];
    arguments.extend(more);
    let output = patchmill(&arguments);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

fn dialect(plan: &Path, to: &[&str]) -> Output {
    let plan = plan.to_string_lossy();
    let mut arguments = vec!["dialect", &plan];
    arguments.extend(to.iter().flat_map(|name| ["--to", name]));
    patchmill(&arguments)
}

fn check(plan: &Path, dialects: &[&str]) -> Output {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("peers/check_dialects.py");
    Command::new(peers_python()).arg(script).arg(plan).args(dialects).output().unwrap()
}

/// What the parsers found: dialect, then `blocks`, `planes`, `chosen`.
fn read_back(plan: &Path) -> serde_json::Value {
    let output = check(plan, &FILES.map(|(name, _)| name));
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

fn sha256(file: &Path) -> String {
    Sha256::digest(fs::read(file).unwrap()).iter().map(|b| format!("{b:02x}")).collect()
}

fn summary(plan: &Path) -> serde_json::Value {
    serde_json::from_str(&fs::read_to_string(plan.join("summary.json")).unwrap()).unwrap()
}

#[test]
fn every_dialect_has_the_poses_of_the_proven_program() {
    let folder = tempfile::tempdir().unwrap();
    let plan = folder.path().join("plan");
    let all = ["--dialect", "siemens", "--dialect", "heidenhain", "--dialect", "fanuc"];
    planned(&plan, &[["--patches", "3", "--dialect", "linuxcnc"].as_slice(), &all].concat());
    let (figures, summary) = (read_back(&plan), summary(&plan));
    for (name, _) in FILES {
        let found = &figures[name];
        assert_eq!(found["blocks"], summary["blocks"], "{name}");
        assert_eq!(found["planes"].as_u64().unwrap(), 3, "{name}");
        assert_eq!(found["chosen"], found["planes"], "{name}: no tool of this plan stands upright");
    }
    let programs = summary["programs"].as_array().unwrap();
    let listed: Vec<_> = programs.iter().map(|p| p["dialect"].as_str().unwrap()).collect();
    assert_eq!(listed, ["linuxcnc", "siemens", "heidenhain", "fanuc"]);
    for program in programs {
        let file = plan.join(program["file"].as_str().unwrap());
        assert_eq!(program["sha256"].as_str().unwrap(), sha256(&file), "{}", file.display());
        // The same header in every language: capitals where a control has nothing else.
        let text = fs::read_to_string(&file).unwrap().to_lowercase();
        for id in ["job_id", "surface_id"] {
            assert!(text.contains(summary[id].as_str().unwrap()), "{}: {id}", file.display());
        }
    }
    written_later_is_the_same(&plan);
    one_digit_more_or_less_is_found(&plan);
    // A plan without dialects leaves none of another plan's.
    planned(&plan, &["--patches", "1"]);
    assert!(FILES.iter().all(|(_, file)| !plan.join(file).exists()));
}

fn written_later_is_the_same(plan: &Path) {
    let with_the_plan = FILES.map(|(_, file)| fs::read(plan.join(file)).unwrap());
    for (_, file) in FILES {
        fs::remove_file(plan.join(file)).unwrap();
    }
    let output = dialect(plan, &["fanuc", "siemens", "heidenhain", "fanuc"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(FILES.map(|(_, file)| fs::read(plan.join(file)).unwrap()) == with_the_plan);
}

/// The check itself: it has to see a wrong coordinate, angle, solution, feed and a missing retract.
fn one_digit_more_or_less_is_found(plan: &Path) {
    let altered = |file: &str, from: &str, to: &str, words: &str| {
        let place = plan.join(file);
        let text = fs::read_to_string(&place).unwrap();
        assert!(text.contains(from), "{file}: {from}");
        fs::write(&place, text.replacen(from, to, 1)).unwrap();
        let (name, _) = FILES.iter().find(|(_, of)| *of == file).unwrap();
        let output = check(plan, &[name]);
        fs::write(&place, text).unwrap();
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(!output.status.success() && said.contains(words), "{file}, {from} → {to}: {said}");
    };
    altered("program.mpf", "CYCLE800(1,", "CYCLE800(0,", "without a retract");
    altered("program.mpf", ",57,0,0,0,", ",27,0,0,0,", "off");
    altered("program.h", "M140 MB MAX", "; nothing", "without a retract");
    // The spatial angle A is the table's tilt, never 0 in this plan.
    let klartext = fs::read_to_string(plan.join("program.h")).unwrap();
    let one_way = klartext.contains(" SPA+");
    let (from, to) = if one_way { (" SPA+", " SPA-") } else { (" SPA-", " SPA+") };
    altered("program.h", from, to, "off");
    altered("program.h", "F2000", "F1999", "F1999");
    altered("program.nc", "G91 G28 Z0.\n", "", "without a retract");
    for (file, one, other) in [
        ("program.mpf", ",0,0,0,1,0,1)", ",0,0,0,-1,0,1)"),
        ("program.h", " SEQ+", " SEQ-"),
        ("program.nc", "G53.1 P1", "G53.1 P2"),
    ] {
        let text = fs::read_to_string(plan.join(file)).unwrap();
        let (from, to) = if text.contains(one) { (one, other) } else { (other, one) };
        altered(file, from, to, "it chooses");
    }
}

/// The joint program of axes X Y Z B C.
fn accepted_by_linuxcnc(plan: &Path, scratch: &Path) {
    fs::write(scratch.join("tool.tbl"), "T1 P1 D38.1 Z100\n").unwrap();
    let program = plan.join("program.ngc");
    let output = Command::new("rs274")
        .args(["-g", "-t", "tool.tbl"])
        .arg(program)
        .current_dir(scratch)
        .output()
        .unwrap();
    assert!(output.status.success(), "rs274: {}", String::from_utf8_lossy(&output.stderr));
    assert!(String::from_utf8_lossy(&output.stdout).matches("STRAIGHT_FEED").count() > 100);
}

#[test]
fn a_nutating_head_over_a_turned_workpiece_too() {
    let folder = tempfile::tempdir().unwrap();
    let plan = folder.path().join("plan");
    planned(&plan, &[["--patches", "2"].as_slice(), &NUTATING].concat());
    accepted_by_linuxcnc(&plan, folder.path());
    assert!(dialect(&plan, &["siemens", "heidenhain", "fanuc"]).status.success());
    let figures = read_back(&plan);
    for (name, file) in FILES {
        assert_eq!(figures[name]["planes"].as_u64().unwrap(), 2, "{name}");
        let text = fs::read_to_string(plan.join(file)).unwrap().to_lowercase();
        assert!(text.contains("the workpiece frame is turned against the machine"), "{file}");
    }
}

#[test]
fn a_plan_that_was_changed_or_is_not_whole_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let plan = folder.path().join("plan");
    planned(&plan, &["--patches", "1"]);
    let refused = |to: &[&str], words: &[&str]| {
        let output = dialect(&plan, to);
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(!output.status.success() && said.matches("error:").count() == 1, "{said}");
        assert!(words.iter().all(|word| said.contains(word)), "{said}");
        assert!(FILES.iter().all(|(_, file)| !plan.join(file).exists()), "something was written");
    };
    refused(&["linuxcnc"], &["siemens", "program.ngc"]);
    refused(&["okuma"], &["heidenhain"]);
    let altered = |file: &str, from: &str, to: &str, words: &[&str]| {
        let place = plan.join(file);
        let text = fs::read_to_string(&place).unwrap();
        assert!(text.contains(from), "{file}: {from}");
        fs::write(&place, text.replacen(from, to, 1)).unwrap();
        refused(&["siemens"], words);
        fs::write(&place, text).unwrap();
    };
    altered("program.ngc", "F2000", "F2001", &["program.ngc", "sha256"]);
    altered("summary.json", "\"program_sha256\"", "\"sha\"", &["summary.json", "program_sha256"]);
    altered("summary.json", "\"length_mm\"", "\"long\"", &["summary.json", "length_mm"]);
    altered("machine.urdf", "name=\"workpiece\"", "name=\"part\"", &["machine.urdf", "sha256"]);
    altered("summary.json", "\"machine_urdf_sha256\"", "\"sha\"", &["summary.json", "plan anew"]);
    fs::remove_file(plan.join("machine.urdf")).unwrap();
    refused(&["fanuc"], &["machine.urdf"]);
}
