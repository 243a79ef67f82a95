//! Tests over a synthetic job: a flat part cut in two patches of different tool axes.

use crate::clearance::{PartBody, ToolBody};
use crate::dialect::{self, Dialect, ProvenText};
use crate::evaluate::{NONE_FEASIBLE, OUTSIDE_TRAVEL, assess, evaluate, machine_of};
use crate::execution::sha256_hex;
use crate::machine_collision::MachineBodies;
use crate::surroundings::Surroundings;
use crate::travel::travel;
use crate::{DEFAULT_MACHINE_URDF, MachineParams};
use crate::{MACHINES, gcode, motion};
use nalgebra::{Point3, Vector3};
use patchmill_geometry::mesh::TriangleMesh;
use patchmill_products::job::{Job, Placement};
use patchmill_products::stage::unobserved;
use patchmill_products::toolpath::{CandidateToolpath, Pass, PatchToolpath};

const WIDTH: f64 = 0.06;
const DEPTH: f64 = 0.04;

fn plane_mesh(shift: f64) -> TriangleMesh {
    let corner = |x: f64, y: f64| Point3::new(x + shift, y, 0.0);
    TriangleMesh {
        vertices: vec![corner(0.0, 0.0), corner(WIDTH, 0.0), corner(WIDTH, DEPTH), corner(0.0, DEPTH)],
        normals: vec![Vector3::z(); 4],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        chord_error: 0.0,
        check_only: Vec::new(),
    }
}

/// Passes along x with the tool leaning by `lead` toward +x, y from `y0` to `y1`, the cutter touching z = `depth`.
fn patch(
    number: u32,
    lead: f64,
    [y0, y1]: [f64; 2],
    step: f64,
    shift: f64,
    depth: f64,
    job: &Job,
) -> PatchToolpath {
    let axis = Vector3::new(lead.sin(), 0.0, lead.cos());
    let cutter = job.tool.cutter;
    // Centre of the corner torus above a contact with normal z, then the tip below it along the axis.
    let w = (Vector3::z() - axis * axis.z).normalize();
    let tip_of =
        |p: Vector3<f64>| Point3::from(p + Vector3::z() * cutter.r2 + w * cutter.r1 - axis * cutter.r2);
    let count = ((y1 - y0) / step).ceil() as usize;
    let passes = (0..=count).map(|i| {
        let y = y0 + (y1 - y0) * i as f64 / count as f64;
        let mut ends = [-0.001, 0.02, WIDTH + 0.001].map(|x| Point3::new(x + shift, y, depth));
        if i % 2 == 1 {
            ends.reverse();
        }
        let cl: Vec<Point3<f64>> = ends.iter().map(|p| tip_of(p.coords)).collect();
        let top = cl.iter().map(|p| p.coords.dot(&axis)).fold(f64::NEG_INFINITY, f64::max);
        Pass { cl, cc: ends.to_vec(), tool_axes: Vec::new(), retract_height: top + 0.003 }
    });
    PatchToolpath {
        patch: number,
        tool_axis: axis,
        feed_direction: Vector3::x(),
        pseudo_curvature_max: 0.0,
        sample_count: 100,
        step_over: [step, step],
        area: WIDTH * (y1 - y0),
        passes: passes.collect(),
    }
}

fn candidate(index: u32, step: f64, shift: f64, depth: f64, job: &Job) -> CandidateToolpath {
    let five = 5f64.to_radians();
    CandidateToolpath {
        index,
        count: 2,
        patch_count: 2,
        infeasible_reason: String::new(),
        patches: vec![
            patch(0, five, [0.0, 0.02], step, shift, depth, job),
            patch(1, -2.0 * five, [0.02, DEPTH], step * 0.7, shift, depth, job),
        ],
        area_within_scallop: 1.0,
        gouge_max: 0.0,
    }
}

fn job() -> Job {
    Job { job_id: "j".to_owned(), ..Job::default_for("s") }
}

#[test]
fn plane_from_toolpath_to_proven_program() {
    let job = job();
    let toolpaths = [candidate(0, 0.0045, 0.0, 0.0, &job), candidate(1, 0.005, 0.0, 0.0, &job)];
    let output =
        evaluate(&toolpaths, &plane_mesh(0.0), &job, &MachineParams::default(), &unobserved()).unwrap();
    let program = output.program.unwrap();
    assert_eq!(output.evaluation.chosen, Some(1));
    let [slow, quick] = &output.evaluation.candidates[..] else { panic!() };
    assert!(slow.feasible && quick.feasible && quick.machining_time < slow.machining_time);
    assert_eq!(quick.index_moves, 1);
    assert!(program.passed.proof().gouge_max < 1e-7, "{:?}", program.passed.proof());
    assert!(program.passed.proof().area_within_scallop >= 0.999 && program.passed.proof().uncut_area == 0.0);
    assert!(program.machining_time > program.cut_length / job.feed);
    let sum: f64 = program.patches.iter().map(|p| p.machining_time).sum();
    assert!(sum > 0.9 * program.machining_time && sum <= program.machining_time + 1e-9);
    assert!((program.patches.iter().map(|p| p.cut_length).sum::<f64>() - program.cut_length).abs() < 1e-9);
    assert!((program.trajectory.last().unwrap().time - program.machining_time).abs() < 1e-9);
    assert!(program.trajectory.windows(2).all(|w| w[0].time <= w[1].time));
}

#[test]
fn program_text_reaches_every_cutter_location() {
    let job = job();
    let toolpath = candidate(0, 0.005, 0.0, 0.0, &job);
    let (machine, _) = machine_of(&job, DEFAULT_MACHINE_URDF).unwrap();
    let zero = machine.zero_offset().unwrap();
    let part = PartBody::around(&plane_mesh(0.0)).unwrap();
    let mesh = plane_mesh(0.0);
    let bodies = MachineBodies::of(DEFAULT_MACHINE_URDF, &machine, &job.tool).unwrap();
    let surroundings = Surroundings::new(bodies, &mesh);
    let plan = motion::plan(&toolpath, &[0, 1], &machine, &part, &surroundings, &job).unwrap();
    let header = gcode::Header { comments: vec![], spindle_speed: 1.0, feed: job.feed, path_tolerance: 2e-6 };
    let blocks =
        gcode::read(&gcode::write(&plan, &machine, &zero, &header).text, &machine, &zero, gcode::MOST_MOVES)
            .unwrap();
    let mut fed = blocks.iter().filter(|b| !b.rapid).map(|b| machine.pose(&b.joints));
    for patch in &toolpath.patches {
        for cl in patch.passes.iter().flat_map(|p| &p.cl) {
            let pose = fed.next().unwrap();
            assert!((pose.tip - cl).norm() < 1e-7, "{} {cl}", pose.tip);
            assert!((pose.axis.into_inner() - patch.tool_axis).norm() < 1e-6);
        }
    }
    assert!(fed.next().is_none());
}

/// A 45° nutating head on the Z slide over a C table, square and without offsets but the pivot's.
const NUTATING: &str = r#"<robot name="nutating">
  <link name="base_link"/><link name="sx"/><link name="sy"/><link name="sz"/><link name="spindle"/>
  <link name="table"/><link name="workpiece"/>
  <joint name="axis_x" type="prismatic"><origin xyz="0 0 0.5"/><parent link="base_link"/><child link="sx"/><axis xyz="1 0 0"/><limit lower="-0.5" upper="0.5" effort="1" velocity="0.5"/></joint>
  <joint name="axis_y" type="prismatic"><parent link="sx"/><child link="sy"/><axis xyz="0 -1 0"/><limit lower="-0.5" upper="0.5" effort="1" velocity="0.5"/></joint>
  <joint name="axis_z" type="prismatic"><parent link="sy"/><child link="sz"/><axis xyz="0 0 1"/><limit lower="-0.5" upper="0.2" effort="1" velocity="0.5"/></joint>
  <joint name="axis_b" type="revolute"><origin xyz="0 0 0.1"/><parent link="sz"/><child link="spindle"/><axis xyz="0 1 1"/><limit lower="-3.2" upper="3.2" effort="1" velocity="2.6"/></joint>
  <joint name="axis_c" type="continuous"><parent link="base_link"/><child link="table"/><axis xyz="0 0 -1"/><limit effort="1" velocity="2.6"/></joint>
  <joint name="mount" type="fixed"><origin xyz="-0.03 -0.02 0.05" rpy="0 0 0.4"/><parent link="table"/><child link="workpiece"/></joint>
</robot>"#;

#[test]
fn a_nutating_machine_cuts_the_same_part() {
    let job = Job { machine_urdf: NUTATING.to_owned(), ..job() };
    let toolpaths = [candidate(0, 0.005, 0.0, 0.0, &job)];
    let output =
        evaluate(&toolpaths, &plane_mesh(0.0), &job, &MachineParams::default(), &unobserved()).unwrap();
    let program = output.program.unwrap();
    assert!(program.passed.proof().gouge_max < 1e-7, "{:?}", program.passed.proof());
    assert_eq!(program.joint_names.join(" "), "axis_x axis_y axis_z axis_c axis_b");
    assert!(output.machine_urdf.contains("tool_tip") && output.machine_urdf.contains("axis_b"));
}

#[test]
fn every_move_keeps_the_tool_clear_or_at_the_surface() {
    let job = job();
    let (machine, _) = machine_of(&job, DEFAULT_MACHINE_URDF).unwrap();
    let part = PartBody::around(&plane_mesh(0.0)).unwrap();
    let mesh = plane_mesh(0.0);
    let bodies = MachineBodies::of(DEFAULT_MACHINE_URDF, &machine, &job.tool).unwrap();
    let surroundings = Surroundings::new(bodies, &mesh);
    let toolpath = candidate(0, 0.005, 0.0, 0.0, &job);
    let plan = motion::plan(&toolpath, &[0, 1], &machine, &part, &surroundings, &job).unwrap();
    assert!(plan.raise.is_some());
    assert!(plan.blocks.iter().all(|b| machine.violation(&b.joints).is_none()));
    let tool = ToolBody::of(&job.tool);
    let mut turned = 0;
    for pair in plan.blocks.windows(2) {
        if pair[0].joints[3..] != pair[1].joints[3..] {
            turned += 1;
            assert!(pair[1].rapid);
            assert!(part.clears(&machine, &pair[0].joints, &pair[1].joints, &tool, 0.005));
        }
    }
    assert_eq!(turned, 1);
}

#[test]
fn the_same_job_gives_the_same_bytes_on_any_number_of_threads() {
    let job = job();
    let toolpaths = [candidate(0, 0.0045, 0.0, 0.0, &job), candidate(1, 0.005, 0.0, 0.0, &job)];
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            evaluate(&toolpaths, &plane_mesh(0.0), &job, &MachineParams::default(), &unobserved()).unwrap()
        })
    };
    assert_eq!(run(1), run(4));
}

#[test]
fn a_program_of_too_many_moves_is_not_written() {
    let job = job();
    let toolpaths = [candidate(0, 0.0045, 0.0, 0.0, &job)];
    let params = MachineParams { max_moves: 10, ..MachineParams::default() };
    let error = evaluate(&toolpaths, &plane_mesh(0.0), &job, &params, &unobserved()).unwrap_err();
    assert_eq!(error.code, NONE_FEASIBLE);
    assert!(error.text.contains("moves: at most 10 (max_moves) are written"), "{error}");
}

#[test]
fn failed_proofs_fall_to_the_next_candidate_and_say_why() {
    let job = job();
    // Too wide a step leaves ridges; a cut 20 µm too deep gouges; both are quicker than the good one.
    let toolpaths = [
        candidate(0, 0.009, 0.0, 0.0, &job),
        candidate(1, 0.007, 0.0, -20e-6, &job),
        candidate(2, 0.005, 0.0, 0.0, &job),
    ];
    let output =
        evaluate(&toolpaths, &plane_mesh(0.0), &job, &MachineParams::default(), &unobserved()).unwrap();
    assert_eq!(output.evaluation.chosen, Some(2));
    let reasons: Vec<&str> = output.evaluation.candidates.iter().map(|c| c.reason.as_str()).collect();
    assert!(reasons[0].contains("scallop height"), "{}", reasons[0]);
    assert!(reasons[1].contains("gouge of 0.0"), "{}", reasons[1]);
    let error = evaluate(&toolpaths[..2], &plane_mesh(0.0), &job, &MachineParams::default(), &unobserved())
        .unwrap_err();
    assert_eq!(error.code, NONE_FEASIBLE);
    assert!(error.text.contains("gouge") && error.text.contains("scallop"), "{error}");
}

#[test]
fn a_rapid_through_the_part_is_found() {
    let job = job();
    let mut toolpath = candidate(0, 0.005, 0.0, 0.0, &job);
    let mut mesh = plane_mesh(0.0);
    // A wall across the part, 1 mm higher than the links between passes: the links cut it.
    let base = mesh.vertices.len() as u32;
    for (x, z) in [(0.028, 0.0), (0.030, 0.012), (0.032, 0.0)] {
        for y in [0.0, DEPTH] {
            mesh.vertices.push(Point3::new(x, y, z));
            mesh.normals.push(Vector3::z());
        }
    }
    for (a, b) in [(0, 2), (2, 4)] {
        mesh.triangles.push([base + a, base + b, base + b + 1]);
        mesh.triangles.push([base + a, base + b + 1, base + a + 1]);
    }
    // One-way passes, each beginning at the left again.
    for pass in toolpath.patches.iter_mut().flat_map(|p| &mut p.passes) {
        if pass.cl[0].x > 0.03 {
            pass.cl.reverse();
        }
        pass.cl.truncate(1);
        let far = pass.cl[0] + Vector3::x() * WIDTH;
        pass.cl.push(far);
        pass.retract_height = 0.003;
    }
    let error = evaluate(&[toolpath], &mesh, &job, &MachineParams::default(), &unobserved()).unwrap_err();
    assert!(error.text.contains("gouge"), "{error}");
}

#[test]
fn outside_the_travel_names_axis_need_and_travel() {
    let job = job();
    let toolpaths = [candidate(0, 0.005, 1.0, 0.0, &job)];
    let output =
        assess(&toolpaths, &plane_mesh(1.0), &job, &MachineParams::default(), &unobserved()).unwrap();
    assert!(output.program.is_none() && output.evaluation.chosen.is_none());
    let error = output.failure.unwrap();
    assert_eq!(error.code, OUTSIDE_TRAVEL);
    assert!(error.text.contains("outside the machine's travel: patch 1: axis Y needs "), "{error}");
    assert!(error.text.contains("has -350.00..350.00 mm"), "{error}");
}

#[test]
fn a_mount_is_found_where_the_travel_suffices() {
    let described = job();
    let auto = Job { placement: Placement::Auto, ..described.clone() };
    for shift in [0.0, 1.0, -2.0] {
        let toolpaths =
            [candidate(0, 0.005, shift, 0.0, &described), candidate(1, 0.005, shift, 0.0, &described)];
        for (name, urdf) in MACHINES {
            let params = MachineParams { default_urdf: urdf.to_owned(), ..MachineParams::default() };
            let output = evaluate(&toolpaths, &plane_mesh(shift), &auto, &params, &unobserved()).unwrap();
            assert!(output.evaluation.candidates.iter().all(|c| c.feasible), "{name} {shift}");
            let program = output.program.unwrap();
            let machine = travel(program.passed.text(), &output.machine_urdf, auto.tool.length).unwrap();
            for axis in machine.axes.iter().filter(|a| a.is_linear()) {
                let margin = axis.margin().unwrap();
                // The first motion goes to the end of Z on purpose; 0.01 mm are the digits of a mount.
                let wanted = if axis.joint == "z" { 0.000_999 } else { 0.005 - 1e-5 };
                assert!(margin >= wanted, "{name} {shift}: {} {margin}", axis.joint);
            }
            // A part that fits stays where it is described.
            let stays = machine.mount.unwrap().xyz == [-0.09, -0.06, 0.07];
            assert_eq!(stays, shift == 0.0, "{name} {shift}: {:?}", machine.mount);
        }
    }
}

#[test]
fn a_given_mount_moves_the_part_and_not_the_cut() {
    let toolpaths = |job: &Job| [candidate(0, 0.005, 0.0, 0.0, job), candidate(1, 0.005, 0.0, 0.0, job)];
    let mesh = plane_mesh(0.0);
    let here = evaluate(&toolpaths(&job()), &mesh, &job(), &MachineParams::default(), &unobserved()).unwrap();
    let placement = Placement::At { xyz: [0.02, -0.05, 0.09], rpy: [0.0, 0.0, 1.2] };
    let moved = Job { placement, ..job() };
    let there =
        evaluate(&toolpaths(&moved), &mesh, &moved, &MachineParams::default(), &unobserved()).unwrap();
    let (here, there) = (here.program.unwrap(), there.program.unwrap());
    assert!((here.cut_length - there.cut_length).abs() < 1e-6 && there.passed.proof().gouge_max < 1e-7);
    assert!((here.patches[0].rotary_positions[1] - there.patches[0].rotary_positions[1]).abs() > 0.5);
}

#[test]
fn no_mount_helps_a_part_larger_than_the_travel() {
    let job = Job { placement: Placement::Auto, ..job() };
    let mut toolpath = candidate(0, 0.005, 0.0, 0.0, &job);
    // One pass 2 m long; X has 800 mm, and turning the part does not help Y's 700 mm.
    let pass = &mut toolpath.patches[0].passes[0];
    let far = pass.cl[0] + Vector3::x() * 2.0;
    pass.cl.push(far);
    let error =
        evaluate(&[toolpath], &plane_mesh(0.0), &job, &MachineParams::default(), &unobserved()).unwrap_err();
    assert_eq!(error.code, OUTSIDE_TRAVEL);
    assert!(error.text.contains("no mount") && error.text.contains("too short"), "{error}");
}

#[test]
fn refused_candidates_keep_their_reason_and_bad_machines_theirs() {
    let job = job();
    let mut toolpath = candidate(0, 0.005, 0.0, 0.0, &job);
    toolpath.infeasible_reason = "no axis below 75°".to_owned();
    for placement in [Placement::AsDescribed, Placement::Auto] {
        let job = Job { placement, ..job.clone() };
        let toolpaths = [toolpath.clone()];
        let error = evaluate(&toolpaths, &plane_mesh(0.0), &job, &MachineParams::default(), &unobserved())
            .unwrap_err();
        assert_eq!(error.code, NONE_FEASIBLE);
        assert!(error.text.contains("no axis below 75°"));
    }
    let bare = Job { machine_urdf: "<robot name=\"r\"><link name=\"base\"/></robot>".to_owned(), ..job };
    let error = machine_of(&bare, DEFAULT_MACHINE_URDF).unwrap_err();
    assert!(error.text.contains("no tool chain") && error.text.contains("workpiece"), "{error}");
}

/// Whatever a machine is called: its name is part of one comment line, and of nothing else, for every control.
#[test]
fn no_name_breaks_out_of_a_comment() {
    let programs = |name: &str| -> Vec<String> {
        let named = format!("<robot name=\"{name}\">");
        let urdf = DEFAULT_MACHINE_URDF.replace("<robot name=\"xyzac\">", &named);
        assert!(urdf.contains(&named));
        let job = Job { machine_urdf: urdf.clone(), ..job() };
        let toolpaths = [candidate(0, 0.0045, 0.0, 0.0, &job)];
        let output =
            evaluate(&toolpaths, &plane_mesh(0.0), &job, &MachineParams::default(), &unobserved()).unwrap();
        let text = output.program.unwrap().passed.text().to_owned();
        let proven = ProvenText {
            text: &text,
            sha256: &sha256_hex(&text),
            machine_urdf: &urdf,
            tool_length: job.tool.length,
        };
        let others = Dialect::ALL.map(|dialect| dialect::write(dialect, &proven).unwrap());
        std::iter::once(text.clone()).chain(others).collect()
    };
    let plain = programs("m");
    // As XML says line feeds, carriage returns, tabs, escapes and what else there is.
    for name in [
        "m)&#10;G0 Z-99&#10;(",
        "m&#13;G0 Z-99",
        "(m)) G0 Z-99 ((",
        "m; G0 Z-99",
        "%&#10;O1000",
        "MSG, (LOGOPEN,/tmp/x)",
        "m ~",
        "m {&#9;} #1=2 [1] \\ &quot; &lt;/script&gt; $(id)",
        "m\u{7f}\u{85}\u{2028}\u{202e}ä½中",
        &"m".repeat(5000),
    ] {
        let named = programs(name);
        for (text, plain) in named.iter().zip(&plain) {
            assert!(text.bytes().all(|b| b == b'\n' || (b' '..=b'~').contains(&b)), "{name}");
            assert_eq!(text.lines().count(), plain.lines().count(), "{name}");
            for (line, usual) in text.lines().zip(plain.lines()).filter(|(line, usual)| line != usual) {
                let usual = usual.to_lowercase();
                let comment = usual.contains("machine m") || usual.contains("sha256");
                assert!(comment && line.len() < 256 && !line.ends_with('~'), "{name}: {line}");
                let bare = line.trim_start_matches(|c: char| c.is_ascii_digit() || c == ' ');
                let inside = bare.strip_prefix('(').and_then(|rest| rest.strip_suffix(')'));
                let inside = inside.or(bare.strip_prefix("; "));
                let inside = inside.unwrap_or_else(|| panic!("{name}: {line}"));
                assert!(!inside.contains(['(', ')', ';', '%']), "{name}: {line}");
            }
        }
    }
}
