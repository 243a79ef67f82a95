//! The stages one after the other without ROS, on all four surfaces.
#![allow(clippy::unwrap_used, reason = "a test's own helpers may fail like the test")]

use patchmill_geometry::cutter::Cutter;
use patchmill_machine_interface::evaluate::evaluate;
use patchmill_machine_interface::{MACHINES, MachineParams};
use patchmill_products::job::{Job, Pattern, Strategy, Tool};
use patchmill_products::selection::{NormalCone, Selection};
use patchmill_products::stage::unobserved;
use patchmill_tests::bowl::{block_top, write_block, write_holed_top};
use patchmill_tests::{Planned, fixture, plan, plan_selected};

fn job(patches: u8) -> Job {
    Job { patches_min: patches, patches_max: patches, ..Job::default_for("") }
}

/// What holds for every plan, whatever the surface, on every shipped machine.
fn check(planned: &Planned) {
    for (name, urdf) in MACHINES {
        let mesh = &planned.surface.mesh;
        let params = MachineParams { default_urdf: urdf.to_owned(), ..MachineParams::default() };
        let output = evaluate(&planned.toolpaths, mesh, &planned.job, &params, &unobserved());
        let program = output.unwrap_or_else(|e| panic!("{name}: {e}")).program.unwrap();
        assert!(
            program.passed.proof().gouge_max <= planned.job.gouge_tolerance,
            "{name}: {:?}",
            program.passed.proof()
        );
        assert!(program.passed.proof().area_within_scallop >= 0.999, "{name}: {:?}", program.passed.proof());
    }
    for toolpath in planned.toolpaths.iter().filter(|t| t.infeasible_reason.is_empty()) {
        assert!(toolpath.gouge_max <= planned.job.gouge_tolerance && toolpath.area_within_scallop >= 0.999);
        for patch in &toolpath.patches {
            assert!((patch.tool_axis.norm() - 1.0).abs() < 1e-12 && !patch.passes.is_empty());
            assert!(patch.feed_direction.dot(&patch.tool_axis).abs() < 1.0);
        }
    }
}

#[test]
fn surface_1_in_four_patches() {
    check(&plan(&fixture("surface_1.json"), job(4)).unwrap());
}

#[test]
fn surface_2_in_eight_patches() {
    check(&plan(&fixture("surface_2.json"), job(8)).unwrap());
}

#[test]
fn surface_3_in_one_patch_one_way() {
    let one_way = Job { pattern: Pattern::OneWay, ..job(1) };
    let planned = plan(&fixture("surface_3.json"), one_way).unwrap();
    check(&planned);
    // One way: every pass starts with a lift, and all run in the same sense.
    let patch = &planned.toolpaths[0].patches[0];
    for pass in &patch.passes {
        let sense = pass.cl[pass.cl.len() - 1] - pass.cl[0];
        assert!(sense.dot(&patch.feed_direction) > 0.0);
    }
}

#[test]
fn surface_4_in_five_patches() {
    check(&plan(&fixture("surface_4.stl"), job(5)).unwrap());
}

fn cut_length(planned: &Planned) -> f64 {
    let passes = planned.toolpaths[0].patches.iter().flat_map(|patch| &patch.passes);
    passes.flat_map(|pass| pass.cl.windows(2)).map(|w| (w[1] - w[0]).norm()).sum()
}

/// Any axis, and passes that follow the surface.
#[test]
fn the_fastest_passes_are_shorter_than_those_of_the_rule() {
    for (name, patches) in [("surface_1.json", 3), ("surface_3.json", 1)] {
        let fastest = plan(&fixture(name), Job { strategy: Strategy::Fastest, ..job(patches) }).unwrap();
        check(&fastest);
        let rule = cut_length(&plan(&fixture(name), job(patches)).unwrap());
        assert!(cut_length(&fastest) < 0.95 * rule, "{name}: {} {rule}", cut_length(&fastest));
    }
}

#[test]
fn the_fastest_passes_leave_a_stock_allowance_and_run_one_way() {
    let job =
        Job { strategy: Strategy::Fastest, pattern: Pattern::OneWay, stock_allowance: 0.2e-3, ..job(2) };
    check(&plan(&fixture("surface_3.json"), job).unwrap());
}

#[test]
fn five_axes_at_once() {
    let five_axis = Job { strategy: Strategy::FiveAxis, ..job(1) };
    for surface in ["surface_1.json", "surface_3.json"] {
        let planned = plan(&fixture(surface), five_axis.clone()).unwrap();
        check(&planned);
        let [patch] = planned.toolpaths[0].patches.as_slice() else { panic!("one patch was expected") };
        let axes = || patch.passes.iter().flat_map(|pass| &pass.tool_axes);
        assert!(patch.is_simultaneous() && axes().all(|a| (a.norm() - 1.0).abs() < 1e-9));
        let most = axes().map(|a| a.angle(&patch.tool_axis)).fold(0.0, f64::max);
        assert!(most > 10f64.to_radians(), "{most}");
    }
}

#[test]
fn five_axes_leave_a_stock_allowance_too() {
    let job = Job { strategy: Strategy::FiveAxis, stock_allowance: 0.0003, ..job(1) };
    let planned = plan(&fixture("small_bezier.json"), job).unwrap();
    check(&planned);
}

/// Sturz milling at 5°: the paper's tool gouges surface 3, a smaller one does not.
#[test]
fn sturz_milling_needs_a_smaller_tool() {
    let sturz =
        |r1, r2| Job { strategy: Strategy::Sturz, tool: Tool::bare(Cutter { r1, r2 }, 0.1), ..job(1) };
    let large = plan(&fixture("surface_3.json"), sturz(0.01305, 0.006)).unwrap();
    let [refused] = large.toolpaths.as_slice() else { panic!("one candidate was expected") };
    assert!(refused.infeasible_reason.contains("gouges"), "{}", refused.infeasible_reason);
    let small = plan(&fixture("surface_3.json"), sturz(0.005, 0.005)).unwrap();
    check(&small);
    assert!(small.toolpaths[0].patches[0].is_simultaneous());
}

#[test]
fn three_axes_keep_the_tool_upright() {
    let ball = Tool::bare(Cutter { r1: 0.0, r2: 0.01905 }, 0.1);
    let planned =
        plan(&fixture("surface_3.json"), Job { strategy: Strategy::ThreeAxis, tool: ball, ..job(1) });
    let planned = planned.unwrap();
    check(&planned);
    assert_eq!(planned.toolpaths[0].patches[0].tool_axis, nalgebra::Vector3::z());
}

/// With M3 the cutter climbs when what is uncut lies on the right of the feed: every pass is on the right of the last one; where
/// a patch takes several chains of passes, each begins at its left.
#[test]
fn climb_milling_goes_to_the_right_of_the_feed() {
    for (strategy, most_chains) in [(Strategy::RollingBall, 1), (Strategy::Fastest, 8)] {
        let climb = Job { pattern: Pattern::Climb, strategy, ..job(1) };
        let planned = plan(&fixture("surface_3.json"), climb).unwrap();
        check(&planned);
        let patch = &planned.toolpaths[0].patches[0];
        let right = patch.feed_direction.cross(&patch.tool_axis);
        let middle = |cl: &[nalgebra::Point3<f64>]| cl[cl.len() / 2].coords.dot(&right);
        let places: Vec<f64> = patch.passes.iter().map(|pass| middle(&pass.cl)).collect();
        let back_to_the_left = places.windows(2).filter(|w| w[1] < w[0]).count();
        assert!(places.len() > 10 && back_to_the_left < most_chains, "{strategy:?}: {places:?}");
        for pass in &patch.passes {
            assert!((pass.cl[pass.cl.len() - 1] - pass.cl[0]).dot(&patch.feed_direction) > 0.0);
        }
    }
}

/// Passes go on by the margin beyond the border of the surface, and no farther gouge comes of it.
#[test]
fn a_border_margin_lengthens_every_pass_at_both_ends() {
    let of = |border_margin| Job { border_margin, pattern: Pattern::OneWay, lead_radius: 0.0, ..job(1) };
    let (without, with) = (of(0.0), of(0.008));
    let plain = plan(&fixture("small_bezier.json"), without).unwrap();
    let wide = plan(&fixture("small_bezier.json"), with).unwrap();
    check(&wide);
    let [plain, wide] = [&plain, &wide].map(|p| p.toolpaths[0].patches[0].passes.as_slice());
    assert_eq!(plain.len(), wide.len());
    let reach = |cl: &[nalgebra::Point3<f64>]| (cl[cl.len() - 1] - cl[0]).norm();
    let longer: f64 = plain.iter().zip(wide).map(|(p, w)| reach(&w.cl) - reach(&p.cl)).sum();
    assert!(longer / plain.len() as f64 > 0.002, "{}", longer / plain.len() as f64);
    assert!(plain.iter().zip(wide).all(|(p, w)| reach(&w.cl) > reach(&p.cl) - 1e-9));
}

#[test]
fn a_slower_control_takes_longer_over_the_same_program() {
    let planned = plan(&fixture("small_bezier.json"), job(1)).unwrap();
    let evaluated = |job: Job| {
        let job = Job { surface_id: planned.job.surface_id.clone(), ..job };
        evaluate(&planned.toolpaths, &planned.surface.mesh, &job, &MachineParams::default(), &unobserved())
            .unwrap()
            .program
            .unwrap()
    };
    let (free, jerk) = (evaluated(job(1)), evaluated(Job { jerk_linear: 100.0, ..job(1) }));
    // 5/100 s more for every run from standstill to standstill.
    let more = (jerk.machining_time - free.machining_time) / 0.05;
    assert!(more > 3.0 && (more - more.round()).abs() < 1e-3, "{more}");
    let slow = evaluated(Job { block_time: 0.5, ..job(1) });
    assert!(slow.machining_time > 0.5 * f64::from(slow.passed.block_count() - 1));
    let motions = |text: &str| {
        text.lines().filter(|line| !line.starts_with('(')).map(str::to_owned).collect::<Vec<_>>()
    };
    assert_eq!(motions(free.passed.text()), motions(jerk.passed.text()));
}

#[test]
fn a_ball_end_and_a_flat_end_are_the_same_code() {
    for (r1, r2) in [(0.0, 0.008), (0.008, 0.0)] {
        let mut job = job(1);
        job.tool.cutter.r1 = r1;
        job.tool.cutter.r2 = r2;
        check(&plan(&fixture("small_bezier.json"), job).unwrap());
    }
}

#[test]
fn stock_allowance_is_left_everywhere() {
    let allowance = 0.0003;
    let planned = plan(&fixture("small_bezier.json"), Job { stock_allowance: allowance, ..job(1) }).unwrap();
    let bare = plan(&fixture("small_bezier.json"), job(1)).unwrap();
    let mean_height = |p: &Planned| {
        let tips: Vec<f64> =
            p.toolpaths[0].patches[0].passes.iter().flat_map(|p| &p.cl).map(|t| t.z).collect();
        tips.iter().sum::<f64>() / tips.len() as f64
    };
    assert!(planned.toolpaths[0].infeasible_reason.is_empty(), "{}", planned.toolpaths[0].infeasible_reason);
    assert!(planned.toolpaths[0].gouge_max <= 5e-6);
    assert!((mean_height(&planned) - mean_height(&bare) - allowance).abs() < 0.1 * allowance);
}

#[test]
fn the_same_plan_twice_is_the_same_to_the_bit() {
    let twice = [0, 1].map(|_| plan(&fixture("surface_3.json"), job(3)).unwrap().toolpaths);
    assert_eq!(twice[0], twice[1]);
}

/// Parts of the surface fold under some patches' tool axes, so that passes jump: once an endless bisection.
#[test]
fn a_surface_that_folds_under_the_tool_axis_is_judged() {
    let planned = plan(&fixture("steep_bezier.json"), job(8)).unwrap();
    let toolpath = &planned.toolpaths[0];
    assert!(
        toolpath.infeasible_reason.contains("above the scallop height"),
        "{}",
        toolpath.infeasible_reason
    );
    assert!(toolpath.gouge_max <= planned.job.gouge_tolerance);
}

fn leaning_up_to(degrees: f64) -> Selection {
    let cone = NormalCone { axis: nalgebra::Vector3::z_axis(), angle: degrees.to_radians() };
    Selection { cone: Some(cone), ..Selection::default() }
}

/// The top of a closed block is planned as the same top alone is; walls and bottom need no passes.
#[test]
fn the_top_of_a_closed_solid_is_finished_alone() {
    let folder = tempfile::tempdir().unwrap();
    let (solid, sheet) = (folder.path().join("solid.stl"), folder.path().join("sheet.stl"));
    write_block(&solid, 60, true).unwrap();
    write_block(&sheet, 60, false).unwrap();
    let mut job = job(1);
    job.tool.cutter = Cutter { r1: 0.003, r2: 0.003 };
    let refused = plan(&solid, job.clone()).err().unwrap();
    assert!(refused.code == 120 && refused.text.contains("--select normal=60"), "{refused}");

    let top = plan_selected(&solid, leaning_up_to(60.0), job.clone()).unwrap();
    let alone = plan(&sheet, job).unwrap();
    check(&top);
    assert_eq!(top.surface.mesh.check_only.iter().filter(|c| !**c).count(), 2 * 60 * 60);
    let steepest = top.surface.samples.normals.iter().map(|n| n.z).fold(1.0, f64::min);
    assert!(steepest > 60f64.to_radians().cos(), "{steepest}");
    let figures = |planned: &Planned| {
        let patch = &planned.toolpaths[0].patches[0];
        let moves = patch.passes.iter().flat_map(|pass| pass.cl.windows(2));
        (patch.area, moves.map(|w| (w[1] - w[0]).norm()).sum::<f64>())
    };
    let ((area, length), (area_alone, length_alone)) = (figures(&top), figures(&alone));
    assert!((area / area_alone - 1.0).abs() < 1e-3, "{area} {area_alone}");
    assert!((length / length_alone - 1.0).abs() < 0.02, "{length} {length_alone}");
}

/// What is only check surface needs no cut, but a program that goes below it fails its proof.
#[test]
fn check_surface_is_proven_against_gouges_only() {
    let mut planned = plan(&fixture("surface_1.json"), job(1)).unwrap();
    let mesh = &planned.surface.mesh;
    let xs = || mesh.vertices.iter().map(|v| v.x);
    let middle = (xs().fold(f64::INFINITY, f64::min) + xs().fold(f64::NEG_INFINITY, f64::max)) / 2.0;
    let marks = (0..mesh.triangles.len()).map(|t| mesh.corners(t)[0].x > middle).collect();
    let mesh = patchmill_geometry::mesh::TriangleMesh { check_only: marks, ..mesh.clone() };
    let far = |tip: &nalgebra::Point3<f64>| tip.x > middle + 0.025;
    let mut proven = |change: f64| {
        for tip in planned.toolpaths[0].patches[0].passes.iter_mut().flat_map(|pass| &mut pass.cl) {
            tip.z += if far(tip) { change } else { 0.0 };
        }
        evaluate(&planned.toolpaths, &mesh, &planned.job, &MachineParams::default(), &unobserved())
    };
    proven(0.0).unwrap();
    // A tenth of a millimetre above the check surface: uncut there, and well.
    let program = proven(1e-4).unwrap().program.unwrap();
    assert!(program.passed.proof().area_within_scallop > 0.999 && program.passed.proof().gouge_max < 5e-6);
    let refused = proven(-1.2e-4).unwrap_err();
    assert!(refused.text.contains("finds a gouge of 0.0"), "{refused}");
}

/// Passes that cross a hole stay on the surface as it would go on, and everything around it is cut.
#[test]
fn no_pass_drops_into_a_hole() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("hole.stl");
    write_holed_top(&file, 60, 8.0).unwrap();
    let mut job = job(1);
    job.tool.cutter = Cutter { r1: 0.003, r2: 0.003 };
    for strategy in [Strategy::RollingBall, Strategy::Fastest] {
        let planned = plan(&file, Job { strategy, ..job.clone() }).unwrap();
        check(&planned);
        let passes = planned.toolpaths[0].patches[0].passes.iter();
        let inside = passes.flat_map(|pass| &pass.cl).filter(|tip| tip.x.hypot(tip.y) < 7.5e-3);
        let depth = |tip: &nalgebra::Point3<f64>| block_top(tip.x * 1e3, tip.y * 1e3) - tip.z * 1e3;
        let depths: Vec<f64> = inside.map(depth).collect();
        assert!(!depths.is_empty() && depths.iter().all(|depth| *depth < 0.05), "{strategy:?}: {depths:?}");
    }
}
