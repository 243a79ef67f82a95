//! `patchmill compare` and a plan with several tools, as a user runs them.
#![allow(clippy::unwrap_used, reason = "a test's own helpers may fail like the test")]

use std::fs;

use patchmill_tests::executables::patchmill;
use patchmill_tests::fixture;
use serde_json::Value;

#[test]
fn every_method_has_a_proven_row_or_a_reason() {
    let folder = tempfile::tempdir().unwrap();
    let (surface, out) = (fixture("surface_3.json"), folder.path().join("compared"));
    let (from, to) = (surface.to_string_lossy(), out.to_string_lossy());
    let output = patchmill(&["compare", &from, "--out", &to, "--patches", "1..2", "--stock", "r1=5,r2=5"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let table = fs::read_to_string(out.join("compare.md")).unwrap();
    assert!(String::from_utf8_lossy(&output.stdout).starts_with(&table));
    let compared: Value =
        serde_json::from_str(&fs::read_to_string(out.join("compare.json")).unwrap()).unwrap();
    let rows = compared["rows"].as_array().unwrap();
    let methods: Vec<&str> = rows.iter().map(|row| row["method"].as_str().unwrap()).collect();
    let expected = [
        "three-axis, ball-end",
        "three-axis, toroid",
        "five-axis Sturz 5°",
        "five-axis rolling ball",
        "rolling-ball, 1 patch",
        "rolling-ball, 2 patches",
        "3+2, one orientation",
        "fastest",
    ];
    assert_eq!(methods, expected);
    let time = |method: &str| {
        rows.iter().find(|row| row["method"] == method).unwrap()["figures"]["machining_time_s"].as_f64()
    };
    for row in rows {
        let figures = &row["figures"];
        if figures.is_null() {
            assert!(!row["reason"].as_str().unwrap().is_empty(), "{row}");
            continue;
        }
        assert!(figures["gouge_max_mm"].as_f64().unwrap() <= 0.005, "{row}");
        assert!(figures["area_within_scallop"].as_f64().unwrap() >= 0.999, "{row}");
        let program = out.join("programs").join(row["folder"].as_str().unwrap());
        for file in ["program.ngc", "machine.urdf", "summary.json"] {
            assert!(program.join(file).is_file(), "{file} of {row}");
        }
    }
    // A flat bottom held upright bridges the hollow.
    let toroid = &rows[1];
    assert!(toroid["figures"].is_null() && toroid["reason"].as_str().unwrap().contains("leaves"), "{toroid}");
    let sturz = &rows[2];
    assert_eq!(sturz["tool_mm"][0], 20.0);
    assert!(sturz["refused"][0]["reason"].as_str().unwrap().contains("gouges"), "{sturz}");
    let (fastest, bound) = (time("fastest").unwrap(), compared["lower_bound_s"].as_f64().unwrap());
    assert!(fastest < 0.9 * time("rolling-ball, 2 patches").unwrap(), "{table}");
    assert!(0.0 < bound && bound < fastest, "{table}");
    let summary = fs::read_to_string(out.join("programs/fastest/summary.json")).unwrap();
    let summary: Value = serde_json::from_str(&summary).unwrap();
    assert_eq!(compared["surface_id"], summary["surface_id"]);
}

/// A tool of 400 mm does not fit the rolling ball: the next smaller one is taken and the refusal named.
#[test]
fn the_largest_tool_that_can_make_the_surface_is_taken() {
    let folder = tempfile::tempdir().unwrap();
    let (surface, out) = (fixture("small_bezier.json"), folder.path().join("plan"));
    let (from, to) = (surface.to_string_lossy(), out.to_string_lossy());
    let tools = ["--tool", "r1=0,r2=4", "--tool", "r1=6.7,r2=6", "--tool", "r1=190,r2=10"];
    let mut arguments = vec!["plan", &from, "--out", &to, "--patches", "1"];
    arguments.extend(tools);
    let output = patchmill(&arguments);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}");
    assert!(said.contains("tool ⌀400.00 r10.00 mm: "), "{said}");
    let summary: Value =
        serde_json::from_str(&fs::read_to_string(out.join("summary.json")).unwrap()).unwrap();
    assert_eq!((&summary["tool"]["r1_mm"], &summary["tool"]["r2_mm"]), (&6.7.into(), &6.0.into()));
    let refused = summary["refused_tools"].as_array().unwrap();
    assert_eq!((refused.len(), &refused[0]["r1_mm"]), (1, &190.0.into()));
    assert!(!refused[0]["reason"].as_str().unwrap().is_empty());
    assert_eq!(summary["strategy"], "fastest");
}
