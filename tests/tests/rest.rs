//! Where the tool does not fit: refused, or left standing and finished by a second job with a smaller tool.
#![allow(clippy::unwrap_used, reason = "a test's own helpers may fail like the test")]

use std::fmt::Write;
use std::fs;
use std::path::Path;

use nalgebra::{Point3, Vector3};
use patchmill_geometry::cutter::Cutter;
use patchmill_kinematics::{Accelerations, Machine};
use patchmill_machine_interface::evaluate::evaluate;
use patchmill_machine_interface::{MachineParams, gcode};
use patchmill_products::job::Job;
use patchmill_products::selection::{NormalCone, Selection};
use patchmill_products::stage::unobserved;
use patchmill_tests::executables::patchmill;
use patchmill_tests::{fixture, plan_selected};

/// Scallop height of the jobs, mm.
const HEIGHT: f64 = 0.0254;

fn plan(surface: &Path, out: &Path, more: &[&str]) -> Result<serde_json::Value, String> {
    let (surface, path) = (surface.to_string_lossy(), out.to_string_lossy());
    let arguments = [&["plan", &surface, "--out", &path, "--patches", "1..2"], more].concat();
    let output = patchmill(&arguments);
    if !output.status.success() {
        return Err(String::from_utf8_lossy(&output.stderr).into_owned());
    }
    let text = fs::read_to_string(out.join("summary.json")).unwrap();
    Ok(serde_json::from_str(&text).unwrap())
}

/// A straight move at feed of a ball-end's centre, mm.
type Move = [Point3<f64>; 2];

/// The moves at feed of a plan's program, from its text and its machine.
fn centres(out: &Path, radius: f64) -> Vec<Move> {
    let text = |name: &str| fs::read_to_string(out.join(name)).unwrap();
    let accelerations = Accelerations { linear: 5.0, rotary: 20.0 };
    let machine = Machine::from_urdf(&text("machine.urdf"), 0.1, accelerations).unwrap();
    let blocks =
        gcode::read(&text("program.ngc"), &machine, &machine.zero_offset().unwrap(), gcode::MOST_MOVES)
            .unwrap();
    let centre = |block: &gcode::ReadBlock| {
        let pose = machine.pose(&block.joints);
        pose.tip * 1e3 + pose.axis.into_inner() * radius
    };
    let at_feed = blocks.windows(2).filter(|w| !w[1].rapid && w[0].joints[3..] == w[1].joints[3..]);
    at_feed.map(|w| [centre(&w[0]), centre(&w[1])]).collect()
}

/// tests/fixtures/valley.json, mm.
fn valley(y: f64) -> f64 {
    (y * y + 25.0).sqrt() - 5.0
}

/// Distance of a place from the valley as if it had no ends, mm; negative below it.
fn height_over_valley(p: &Point3<f64>) -> f64 {
    let distance = |y: f64| (p.y - y).hypot(p.z - valley(y));
    let nearest =
        (-500..=500).map(|k| f64::from(k) * 0.05).min_by(|a, b| distance(*a).total_cmp(&distance(*b)));
    let (mut low, mut high) = (nearest.unwrap() - 0.05, nearest.unwrap() + 0.05);
    for _ in 0..40 {
        let (a, b) = (low + (high - low) / 3.0, high - (high - low) / 3.0);
        if distance(a) < distance(b) { high = b } else { low = a }
    }
    distance(low) * (p.z - valley(p.y)).signum()
}

/// Deepest cut below the valley, mm.
fn deepest(moves: &[Move], radius: f64) -> f64 {
    let within = |p: &Point3<f64>| p.x.abs() <= 20.0;
    let places = moves.iter().flat_map(|[a, b]| {
        let steps = ((b - a).norm() / 0.2).ceil().max(1.0) as usize;
        (0..=steps).map(move |k| a + (b - a) * (k as f64 / steps as f64))
    });
    places.filter(within).map(|p| radius - height_over_valley(&p)).fold(0.0, f64::max)
}

/// What a ball along some moves leaves over a place, mm.
fn left_over(moves: &[Move], radius: f64, p: &Point3<f64>) -> f64 {
    let distance = |[a, b]: &Move| {
        let way = b - a;
        let along = ((p - a).dot(&way) / way.norm_squared().max(1e-18)).clamp(0.0, 1.0);
        (a + way * along - p).norm()
    };
    moves.iter().map(distance).fold(f64::INFINITY, f64::min) - radius
}

#[test]
fn a_valley_is_left_standing_and_finished_by_a_smaller_tool() {
    let folder = tempfile::tempdir().unwrap();
    let surface = fixture("valley.json");
    let out = |name: &str| folder.path().join(name);
    let refusal = plan(&surface, &out("refused"), &["--tool", "r1=0,r2=6"]).unwrap_err();
    assert!(refusal.contains("too big") && refusal.contains("--allow-rest"), "{refusal}");
    assert!(!out("refused").exists());

    let summary = plan(&surface, &out("first"), &["--tool", "r1=0,r2=6", "--allow-rest"]).unwrap();
    let regions = summary["rest"].as_array().unwrap();
    assert_eq!(regions.len(), 1, "{regions:?}");
    let number = |key: &str| regions[0][key].as_f64().unwrap();
    // The ball of 6 mm touches both sides at y = ±2.345 mm (R² = 2y² + 25); less than the scallop height is left beside that.
    let width = number("area_mm2") / 40.0;
    assert!((3.6..5.6).contains(&width), "{width}");
    assert!((number("smallest_ball_radius_mm") - 5.0).abs() < 0.05, "{regions:?}");
    assert!((number("largest_ball_end_r2_mm") - 5.0).abs() < 0.05, "{regions:?}");
    assert!(regions[0]["position_mm"][1].as_f64().unwrap().abs() < 0.5, "{regions:?}");
    assert!(summary["proof"]["area_within_scallop"].as_f64().unwrap() >= 0.999);

    let first = out("first").to_string_lossy().into_owned();
    let second = ["--tool", "r1=0,r2=4", "--rest-of", &first];
    let finished = plan(&surface, &out("second"), &second).unwrap();
    let length = |summary: &serde_json::Value| summary["cut_length_mm"].as_f64().unwrap();
    assert!(length(&finished) < 0.25 * length(&summary), "{} {}", length(&finished), length(&summary));

    // By the programs' texts and the valley's formula alone.
    let (begun, ended) = (centres(&out("first"), 6.0), centres(&out("second"), 4.0));
    for (moves, radius) in [(&begun, 6.0), (&ended, 4.0)] {
        let depth = deepest(moves, radius);
        assert!(depth < 0.005, "{radius}: {depth}");
    }
    let (mut left, mut unfinished, mut elsewhere) = (0, 0, 0);
    for (i, j) in (0..20).flat_map(|i| (0..380).map(move |j| (i, j))) {
        let (x, y) = (f64::from(i) * 2.0 - 19.0, f64::from(j) * 0.1 - 18.95);
        let p = Point3::new(x, y, valley(y));
        let stands = left_over(&begun, 6.0, &p) > HEIGHT + 1e-3;
        if y.abs() > 3.5 {
            elsewhere += u32::from(stands);
        } else if stands {
            left += 1;
            unfinished += u32::from(left_over(&ended, 4.0, &p) > HEIGHT + 1e-3);
        } else {
            assert!(y.abs() > 1.0, "not left at {p}");
        }
    }
    assert!(left > 400 && unfinished == 0, "{left} {unfinished}");
    // The proof allows a thousandth of the area anywhere: of these 6200 points six.
    assert!(elsewhere <= 6, "{elsewhere}");

    // What nothing was left of, another surface, and a tool that is still too big.
    let error = plan(&surface, &out("none"), &["--rest-of", &out("second").to_string_lossy()]).unwrap_err();
    assert!(error.contains("left nothing standing"), "{error}");
    let of_first = ["--rest-of", first.as_str()];
    let error = plan(&fixture("small_bezier.json"), &out("none"), &of_first).unwrap_err();
    assert!(error.contains("is that of the surface") && error.contains("code 120"), "{error}");
    let big = [&["--tool", "r1=0,r2=5.5"], &of_first[..]].concat();
    let error = plan(&surface, &out("none"), &big).unwrap_err();
    assert!(error.contains("too big") && error.contains("--allow-rest"), "{error}");
    let again = plan(&surface, &out("again"), &[&big[..], &["--allow-rest"]].concat()).unwrap();
    let area = |summary: &serde_json::Value| summary["rest_area_mm2"].as_f64().unwrap();
    assert!(area(&again) > 1.0 && area(&again) < area(&summary), "{} {}", area(&again), area(&summary));
}

/// A closed block of 60 × 50 × 20 mm with a pocket of 40 × 30 × 8 mm, walls upright, all corners sharp.
fn write_pocket(file: &Path) {
    let outline = |x: f64, y: f64, z: f64| [[-x, -y, z], [x, -y, z], [x, y, z], [-x, y, z]];
    let (bottom, top) = (outline(30.0, 25.0, -20.0), outline(30.0, 25.0, 0.0));
    let (rim, floor) = (outline(20.0, 15.0, 0.0), outline(20.0, 15.0, -8.0));
    let mut quads = vec![floor, [bottom[0], bottom[3], bottom[2], bottom[1]]];
    for (i, j) in [(0, 1), (1, 2), (2, 3), (3, 0)] {
        quads.push([top[i], top[j], rim[j], rim[i]]);
        quads.push([rim[i], rim[j], floor[j], floor[i]]);
        quads.push([bottom[i], bottom[j], top[j], top[i]]);
    }
    let mut text = "solid pocket\n".to_owned();
    for [a, b, c, d] in quads {
        for facet in [[a, b, c], [a, c, d]] {
            text += "facet normal 0 0 0\nouter loop\n";
            facet.iter().for_each(|[x, y, z]| writeln!(text, "vertex {x} {y} {z}").unwrap());
            text += "endloop\nendfacet\n";
        }
    }
    fs::write(file, text + "endsolid pocket\n").unwrap();
}

/// Walls beside the floor make any tool too big by the ball's rule: with a rest the floor is planned as far as the tool gets.
#[test]
fn a_pockets_floor_is_finished_up_to_where_its_walls_stop_the_tool() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("pocket.stl");
    write_pocket(&file);
    let cone = NormalCone { axis: Vector3::z_axis(), angle: 45f64.to_radians() };
    let upward = Selection { cone: Some(cone), ..Selection::default() };
    let mut job = Job { patches_max: 2, ..Job::default_for("") };
    job.tool.cutter = Cutter { r1: 0.0, r2: 0.003 };
    let refused = plan_selected(&file, upward.clone(), job.clone()).err().unwrap();
    assert_eq!(refused.code, 203, "{refused}");
    let resting = Job { rest_lead: 45f64.to_radians(), ..job };
    let planned = plan_selected(&file, upward, resting).unwrap();
    let mesh = &planned.surface.mesh;
    let output = evaluate(&planned.toolpaths, mesh, &planned.job, &MachineParams::default(), &unobserved());
    let program = output.unwrap().program.unwrap();
    let proof = program.passed.proof();
    assert!(
        proof.gouge_max <= planned.job.gouge_tolerance && proof.area_within_scallop >= 0.999,
        "{proof:?}"
    );
    assert_eq!(proof.rest.len(), 1, "{proof:?}");
    assert!(proof.rest[0].ball_radius < 0.5e-3 && proof.rest[0].leftover_max > 0.9e-3, "{proof:?}");
    // A ball of 3 mm beside a wall leaves less than the scallop height from 2.61 mm on.
    let ring = |w: f64| (40.0 * 30.0 - (40.0 - 2.0 * w) * (30.0 - 2.0 * w)) * 1e-6;
    assert!((ring(2.5)..ring(3.5)).contains(&proof.rest_area), "{:e}", proof.rest_area);
    let map = program.passed.residual();
    for (p, _) in map.points.iter().zip(&map.leftover).filter(|(_, left)| **left > HEIGHT * 1e-3 + 1e-6) {
        let to_wall = (0.020 - p.x.abs()).min(0.015 - p.y.abs());
        assert!(p.z < -0.007 && to_wall < 3.6e-3, "left at {p}");
    }
}
