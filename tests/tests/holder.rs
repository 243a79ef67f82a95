//! Shank and holder of the tool against the part: refused axes, other axes, the stick-out that works, the machine's links.
#![allow(clippy::unwrap_used, reason = "a test's own helpers may fail like the test")]

use std::path::PathBuf;

use nalgebra::Vector3;
use patchmill_geometry::cutter::Cutter;
use patchmill_machine_interface::MachineParams;
use patchmill_machine_interface::evaluate::{assess, evaluate};
use patchmill_products::job::{HolderSection, Job, Tool};
use patchmill_products::stage::unobserved;
use patchmill_products::toolpath::PatchToolpath;
use patchmill_tests::{Planned, plan};

/// A trough 22.5 mm deep and 60 mm wide between walls of up to 56°.
const TROUGH: &str = r#"{"kind":"algebraic","units":"mm","expression":"(x-30)^2/40","x":[0,60],"y":[0,30]}"#;
/// A floor, a ramp of up to 62° and a plateau 30 mm higher.
const RAMP: &str =
    r#"{"kind":"algebraic","units":"mm","expression":"15*tanh((y-30)/8)","x":[0,30],"y":[0,50]}"#;

fn surface(folder: &tempfile::TempDir, text: &str) -> PathBuf {
    let file = folder.path().join("surface.json");
    std::fs::write(&file, text).unwrap();
    file
}

/// A ball-end of 8 mm in one patch; the holder, 34 mm long and 50 mm thick, begins on a cone.
fn job(stick_out: f64, held: bool) -> Job {
    let section = |length, radius_low, radius_high| HolderSection { length, radius_low, radius_high };
    let holder = vec![section(0.004, 0.020, 0.025), section(0.030, 0.025, 0.025)];
    let bare = Tool::bare(Cutter { r1: 0.0, r2: 0.004 }, stick_out);
    let tool = if held { Tool { flute_length: 0.005, shank_radius: 0.0035, holder, ..bare } } else { bare };
    Job { tool, patches_min: 1, patches_max: 1, scallop_height: 0.1e-3, ..Job::default_for("") }
}

/// How far the tool's true profile, without any margin, would have to be raised off the mesh's vertices at the cutter
/// locations of a patch, m: a search over everything.
fn raise_by_search(planned: &Planned, patch: &PatchToolpath, tool: &Tool) -> f64 {
    let axis = patch.tool_axis;
    let underside = |rho: f64| {
        let frusta = tool.holder_frusta();
        let under = frusta.iter().filter(|f| rho <= f.radius_high).map(|f| {
            let widening = f.radius_high - f.radius_low;
            f.low + if rho > f.radius_low { (rho - f.radius_low) / widening * (f.high - f.low) } else { 0.0 }
        });
        under.fold(f64::INFINITY, f64::min)
    };
    let vertices: Vec<Vector3<f64>> =
        planned.surface.mesh.vertices.iter().step_by(3).map(|v| v.coords).collect();
    let mut worst = f64::NEG_INFINITY;
    for tip in patch.passes.iter().flat_map(|p| &p.cl).step_by(7) {
        for v in &vertices {
            let d = v - tip.coords;
            let height = d.dot(&axis);
            worst = worst.max(height - underside((d - axis * height).norm()));
        }
    }
    worst
}

/// The number after `before` in a text.
fn number_after(text: &str, before: &str) -> f64 {
    let at = text.find(before).unwrap_or_else(|| panic!("no '{before}' in: {text}")) + before.len();
    text[at..].split_whitespace().next().unwrap().parse().unwrap()
}

#[test]
fn in_a_trough_the_least_stick_out_is_named_and_works() {
    let folder = tempfile::tempdir().unwrap();
    let file = surface(&folder, TROUGH);
    let refused = plan(&file, job(0.046, true)).unwrap();
    let reason = refused.toolpaths[0].infeasible_reason.clone();
    assert!(reason.contains("on every tool axis tried the holder touches the part"), "{reason}");
    assert!(reason.contains("the tool has 46.00 mm") && !reason.contains("shank"), "{reason}");
    let least = number_after(&reason, "least stick-out that works ");
    assert!(least > 46.0 && least < 60.0, "{reason}");

    let enough = plan(&file, job(least / 1e3, true)).unwrap();
    assert_eq!(enough.toolpaths[0].infeasible_reason, "", "stick-out {least} mm");
    let patch = &enough.toolpaths[0].patches[0];
    let raise = raise_by_search(&enough, patch, &enough.job.tool);
    assert!(raise < 0.0, "{raise}");
    // With 1.5 mm less than that, more than the margins on the steep walls, the same passes collide.
    let lacking = Tool { length: least / 1e3 - 1.5e-3, ..enough.job.tool.clone() };
    assert!(raise_by_search(&enough, patch, &lacking) > 0.0);
    let output = evaluate(
        &enough.toolpaths,
        &enough.surface.mesh,
        &enough.job,
        &MachineParams::default(),
        &unobserved(),
    );
    let program = output.unwrap().program.unwrap();
    assert!(program.passed.text().contains("flute 5.000 shank d 7.000 holder d 40.000 to 50.000 l 4.000"));

    // The same passes with the refused tool: the program's own proof finds the holder.
    let short = Job { tool: refused.job.tool.clone(), ..enough.job.clone() };
    let output =
        assess(&enough.toolpaths, &enough.surface.mesh, &short, &MachineParams::default(), &unobserved());
    let failure = output.unwrap().failure.unwrap();
    assert!(failure.text.contains("finds the holder touching the part"), "{failure}");
}

#[test]
fn beside_a_ramp_the_holder_forces_another_axis() {
    let folder = tempfile::tempdir().unwrap();
    let file = surface(&folder, RAMP);
    let bare = plan(&file, job(0.050, false)).unwrap();
    let held = plan(&file, job(0.050, true)).unwrap();
    for planned in [&bare, &held] {
        assert_eq!(planned.toolpaths[0].infeasible_reason, "");
    }
    let (without, with) = (&bare.toolpaths[0].patches[0], &held.toolpaths[0].patches[0]);
    let tool = &held.job.tool;
    assert!(raise_by_search(&bare, without, tool) > 1e-3, "the bare tool's axis has to touch");
    assert!(raise_by_search(&held, with, tool) < 0.0);
    let turned = without.tool_axis.dot(&with.tool_axis).clamp(-1.0, 1.0).acos();
    assert!(turned > 5f64.to_radians(), "{turned}");
    assert!(held.toolpaths[0].gouge_max <= held.job.gouge_tolerance);
    let output =
        evaluate(&held.toolpaths, &held.surface.mesh, &held.job, &MachineParams::default(), &unobserved());
    assert!(output.unwrap().program.unwrap().passed.proof().area_within_scallop >= 0.999);
}

#[test]
fn a_thick_shank_asks_for_longer_flutes() {
    let folder = tempfile::tempdir().unwrap();
    let file = surface(&folder, TROUGH);
    let job = job(0.100, true);
    let tool = Tool { shank_radius: 0.015, ..job.tool.clone() };
    let planned = plan(&file, Job { tool, ..job }).unwrap();
    let reason = &planned.toolpaths[0].infeasible_reason;
    assert!(reason.contains("the shank touches the part"), "{reason}");
    assert!(number_after(reason, "least flute length that works ") > 5.0, "{reason}");
}

#[test]
fn a_holder_out_of_reach_changes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let file = surface(&folder, TROUGH);
    let (bare, held) = (plan(&file, job(0.150, false)).unwrap(), plan(&file, job(0.150, true)).unwrap());
    assert_eq!(bare.toolpaths, held.toolpaths);
}
