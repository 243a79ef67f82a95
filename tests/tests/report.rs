//! `report.html` in a real browser, and pictures without one.
#![allow(clippy::unwrap_used, reason = "a test's own helpers may fail like the test")]

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use patchmill_tests::bowl::write_bowl;
use patchmill_tests::executables::{patchmill, peers_python};
use patchmill_tests::fixture;
use serde_json::Value;

/// Together with its folder, `x<`, a name that ends a script element and begins an image with a handler.
const HOSTILE: &str = "script><img src=x onerror=\"document.title='broken'\">&amp;.json";

fn succeeded(output: &Output) -> String {
    let text =
        String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{text}");
    text
}

fn plan(surface: &Path, out: &Path) {
    let (surface, out) = (surface.to_string_lossy(), out.to_string_lossy());
    let said = succeeded(&patchmill(&[
        "plan",
        &surface,
        "--out",
        &out,
        "--patches",
        "1..3",
        "--strategy",
        "rolling-ball",
    ]));
    assert!(!said.contains("warning: no report"), "{said}");
}

/// What Chromium sees of a report; panics with everything that is not as it has to be.
fn seen_in_chromium(report: &Path) -> Value {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("peers/view_report.py");
    let output = Command::new(peers_python()).arg(script).arg(report).output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}");
    serde_json::from_slice(&output.stdout).unwrap()
}

#[test]
fn a_report_draws_moves_and_stays_readable_and_a_name_from_outside_stays_text() {
    let folder = tempfile::tempdir().unwrap();
    let hostile = folder.path().join("x<");
    fs::create_dir(&hostile).unwrap();
    let (surface, out) = (hostile.join(HOSTILE), folder.path().join("plan"));
    fs::copy(fixture("small_bezier.json"), &surface).unwrap();
    plan(&surface, &out);
    let seen = seen_in_chromium(&out.join("report.html"));
    assert_eq!(seen["heading"], HOSTILE);
    assert_eq!(seen["title"], format!("{HOSTILE} – patchmill report"));
    assert!(seen["triangles"].as_str().unwrap().starts_with("All "), "{seen}");

    // Made anew from the bag it is the same, byte by byte.
    let first = fs::read(out.join("report.html")).unwrap();
    fs::remove_file(out.join("report.html")).unwrap();
    succeeded(&patchmill(&["report", &out.to_string_lossy()]));
    assert!(fs::read(out.join("report.html")).unwrap() == first);
    pictures(&out);
    fs::remove_dir_all(out.join("bag")).unwrap();
    let refused = patchmill(&["report", &out.to_string_lossy()]);
    assert!(!refused.status.success() && String::from_utf8_lossy(&refused.stderr).contains("bag"));
}

#[test]
fn a_report_that_cannot_be_written_loses_no_plan() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("plan");
    fs::create_dir_all(out.join("report.html")).unwrap();
    let surface = fixture("small_bezier.json");
    let (from, to) = (surface.to_string_lossy(), out.to_string_lossy());
    let said =
        succeeded(&patchmill(&["plan", &from, "--out", &to, "--patches", "1", "--strategy", "rolling-ball"]));
    assert!(said.contains("warning: no report.html: cannot write"), "{said}");
    for name in ["program.ngc", "summary.json", "bag/metadata.yaml"] {
        assert!(out.join(name).is_file(), "{name}");
    }
    let mut left: Vec<_> = fs::read_dir(&out).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    left.sort();
    let whole = ["bag", "job.yaml", "machine.urdf", "program.ngc", "report.html", "summary.json"];
    assert_eq!(left, whole, "nothing half-written stays");
}

fn pictures(plan: &Path) {
    let folder = plan.to_string_lossy();
    let drawn = |what: &str, name: &str| {
        let file = plan.join(name);
        succeeded(&patchmill(&["plot", &folder, "--what", what, "--out", &file.to_string_lossy()]));
        fs::read(file).unwrap()
    };
    let all = ["patches", "radius", "residual", "passes", "time"];
    let pngs = all.map(|what| drawn(what, "x.png"));
    for (i, png) in pngs.iter().enumerate() {
        assert!(png.starts_with(b"\x89PNG\r\n\x1a\n") && png.len() > 5000, "{} bytes", png.len());
        assert!(pngs[..i].iter().all(|other| other != png), "{} looks like another", all[i]);
        let svg = String::from_utf8(drawn(all[i], "x.svg")).unwrap();
        assert!(svg.contains("<svg") && svg.contains("</svg>") && !svg.contains("<img"), "{}", all[i]);
    }
    for (bad, expected) in [("x.jpg", ".png or .svg"), ("nowhere/x.png", "nowhere")] {
        let file = plan.join(bad);
        let output = patchmill(&["plot", &folder, "--what", "time", "--out", &file.to_string_lossy()]);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(!output.status.success() && said.contains(expected) && said.lines().count() == 1, "{said}");
    }
    let output =
        patchmill(&["plot", "/nowhere", "--what", "time", "--out", &plan.join("x.png").to_string_lossy()]);
    assert!(String::from_utf8_lossy(&output.stderr).contains("/nowhere/summary.json"));
}

#[test]
fn a_large_surface_is_shown_coarser_and_the_report_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let (surface, out) = (folder.path().join("bowl.stl"), folder.path().join("plan"));
    write_bowl(&surface, 250).unwrap();
    plan(&surface, &out);
    let html = fs::read_to_string(out.join("report.html")).unwrap();
    assert!(html.len() < 3_000_000, "{} bytes", html.len());
    let said = html.split("id=\"triangles\">").nth(1).unwrap().split("</p>").next().unwrap();
    assert!(said.contains(" triangles in place of the surface's ") && said.contains("125000"), "{said}");
}
