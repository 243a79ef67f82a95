use super::*;
use crate::DEFAULT_MACHINE_URDF;
use crate::evaluate::machine_of;
use nalgebra::Point3;
use patchmill_products::job::{HolderSection, Job};

fn bodies_of(urdf: &str, tool: Option<Tool>) -> Result<(MachineBodies, Machine), StageError> {
    let default = Job::default_for("s");
    let job = Job { tool: tool.unwrap_or(default.tool.clone()), ..default };
    let (machine, _) = machine_of(&job, urdf)?;
    Ok((MachineBodies::of(urdf, &machine, &job.tool)?, machine))
}

fn without_part(bodies: &MachineBodies, q: [f64; 5]) -> Option<String> {
    let mesh = TriangleMesh::default();
    bodies.touch_at(&q, &mesh, &Bvh::build(&mesh), MARGIN)
}

#[test]
fn neighbours_are_left_out_and_the_machine_stands_clear() {
    let (bodies, machine) = bodies_of(DEFAULT_MACHINE_URDF, None).unwrap();
    let name = |i: usize| bodies.bodies[i].link.as_str();
    let pairs: Vec<(&str, &str)> = bodies.pairs.iter().map(|[i, j]| (name(*i), name(*j))).collect();
    assert!(pairs.contains(&("spindle", "table")) && pairs.contains(&("table", "the tool")), "{pairs:?}");
    for neighbours in [("trunnion", "table"), ("base_link", "trunnion"), ("spindle", "the tool")] {
        assert!(!pairs.contains(&neighbours), "{neighbours:?}");
    }
    let facing: Vec<&str> = bodies.facing_part.iter().map(|i| name(*i)).collect();
    assert!(facing.contains(&"spindle") && !facing.contains(&"table"), "{facing:?}");
    assert_eq!(without_part(&bodies, [0.0; 5]), None);
    for a in machine.axes()[3].limits.unwrap() {
        assert_eq!(without_part(&bodies, [0.0, 0.0, 0.0, a, 1.0]), None, "A {a}");
    }
}

#[test]
fn the_tool_meets_the_table_at_its_surface() {
    let (bodies, _) = bodies_of(DEFAULT_MACHINE_URDF, None).unwrap();
    // Nose at 0.5 m, tool 0.1 m, table surface at -0.06 m: 0.46 m down, less the margin.
    assert_eq!(without_part(&bodies, [0.0, 0.0, -0.46 + MARGIN + 1e-4, 0.0, 0.0]), None);
    let found = without_part(&bodies, [0.0, 0.0, -0.46 + MARGIN - 1e-4, 0.0, 0.0]);
    assert_eq!(found.unwrap(), "table touches the tool");
    // Beside the table the head comes down beside the trunnion's arm, and on it.
    assert!(without_part(&bodies, [0.36, 0.0, -0.55, 0.0, 0.0]).is_some());
}

#[test]
fn a_holder_is_part_of_the_tool() {
    let section = HolderSection { length: 0.05, radius_low: 0.12, radius_high: 0.12 };
    let holder = Tool { holder: vec![section], ..Job::default_for("s").tool };
    // The table's rim, 45° up, is beside the tool and under the holder.
    let touches = |tool: Option<Tool>| {
        let (bodies, _) = bodies_of(DEFAULT_MACHINE_URDF, tool).unwrap();
        (0..60).find(|i| {
            let q = [0.0, 0.0, -0.30 - 0.004 * f64::from(*i), -0.8, 0.0];
            without_part(&bodies, q).is_some()
        })
    };
    let (bare, held) = (touches(None), touches(Some(holder)));
    assert!(held.unwrap() < bare.unwrap_or(60), "{held:?} {bare:?}");
}

#[test]
fn the_spindle_meets_a_tall_part() {
    let (bodies, _) = bodies_of(DEFAULT_MACHINE_URDF, None).unwrap();
    let wall = |x: f64, top: f64| TriangleMesh {
        vertices: vec![
            Point3::new(x, 0.0, 0.0),
            Point3::new(x, 0.12, 0.0),
            Point3::new(x, 0.12, top),
            Point3::new(x, 0.0, top),
        ],
        normals: vec![Vector3::x(); 4],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        chord_error: 0.0,
        check_only: Vec::new(),
    };
    // The tool tip is 20 mm over the workpiece's origin plane, its axis at x = 90 mm; the spindle's nose 120 mm over it.
    let q = [0.0, 0.015, -0.37, 0.0, 0.0];
    let at = |mesh: &TriangleMesh| bodies.touch_at(&q, mesh, &Bvh::build(mesh), MARGIN);
    assert_eq!(at(&wall(0.13, 0.117)), None);
    assert_eq!(at(&wall(0.13, 0.119)).unwrap(), "spindle touches the part");
    assert_eq!(at(&wall(0.14, 0.119)), None);
}

#[test]
fn meshes_are_named_and_sizes_checked() {
    let with = |geometry: &str| {
        let shape =
            format!("<link name=\"workpiece\"><collision><geometry>{geometry}</geometry></collision></link>");
        DEFAULT_MACHINE_URDF.replace("<link name=\"workpiece\"/>", &shape)
    };
    let (bodies, _) = bodies_of(&with("<mesh filename=\"vise.stl\"/>"), None).unwrap();
    assert_eq!(bodies.unchecked, ["workpiece"]);
    let (bodies, _) = bodies_of(&with("<sphere radius=\"0.05\"/>"), None).unwrap();
    assert!(bodies.unchecked.is_empty() && bodies.bodies.iter().any(|b| b.link == "workpiece"));
    let error = bodies_of(&with("<box size=\"0.1 0 0.1\"/>"), None).unwrap_err();
    assert_eq!(error.code, BAD_MACHINE);
    assert!(error.text.contains("link workpiece") && error.text.contains("positive"), "{error}");
}

/// Links whose shapes always overlap carry each other.
#[test]
fn links_that_always_overlap_are_left_out() {
    let around = "<collision><origin xyz=\"0 0 0.5\"/><geometry><box size=\"3 3 1\"/></geometry></collision>";
    let urdf = DEFAULT_MACHINE_URDF.replacen(
        "<link name=\"x_slide\">",
        &format!("<link name=\"x_slide\">{around}"),
        1,
    );
    let (bodies, _) = bodies_of(&urdf, None).unwrap();
    let name = |i: usize| bodies.bodies[i].link.as_str();
    assert!(!bodies.pairs.iter().any(|[i, j]| (name(*i), name(*j)) == ("x_slide", "spindle")));
    assert!(bodies.pairs.iter().any(|[i, j]| (name(*i), name(*j)) == ("spindle", "table")));
}

/// Corners of the twelve facets of a box about the origin, in mm.
fn box_facets(half: [f64; 3]) -> Vec<[Point3<f64>; 3]> {
    let corner = |bits: usize| {
        Point3::from(std::array::from_fn::<f64, 3, _>(|k| {
            half[k] * if bits >> k & 1 == 1 { 1e3 } else { -1e3 }
        }))
    };
    let face = |[a, b, c, d]: [usize; 4]| [[a, b, c], [a, c, d]].map(|facet| facet.map(corner));
    [[0, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]]
        .into_iter()
        .flat_map(face)
        .collect()
}

#[test]
fn facets_of_a_box_touch_what_the_box_touches() {
    let (vise, head) = ([0.06, 0.04, 0.03], [0.05, 0.07, 0.02]);
    let link = |name: &str, geometry: &str| {
        format!("<link name=\"{name}\"><collision><geometry>{geometry}</geometry></collision>")
    };
    let built = |vise: &str, head: &str| {
        let urdf = DEFAULT_MACHINE_URDF
            .replace("<link name=\"workpiece\"/>", &format!("{}</link>", link("workpiece", vise)));
        urdf.replacen("<link name=\"spindle\">", &link("spindle", head), 1)
    };
    let size = |half: [f64; 3]| format!("<box size=\"{}\"/>", half.map(|h| (2.0 * h).to_string()).join(" "));
    let file = |name: &str| format!("<mesh filename=\"{name}\" scale=\"0.001 0.001 0.001\"/>");
    let (solid, _) = bodies_of(&built(&size(vise), &size(head)), None).unwrap();
    let mut urdf = built(&file("vise.stl"), &file("head.stl"));
    for (name, half) in [("vise.stl", vise), ("head.stl", head)] {
        urdf = patchmill_kinematics::with_collision_mesh(&urdf, name, &box_facets(half)).unwrap();
    }
    let (meshes, _) = bodies_of(&urdf, None).unwrap();
    assert!(meshes.unchecked.is_empty());
    let (mut clear, mut touching) = (0, 0);
    for i in 0..400 {
        let part = |k: usize, range: f64| ((i * k % 97) as f64 / 96.0 - 0.5) * range;
        let q = [part(13, 0.3), part(29, 0.3), -0.35 + part(41, 0.2), part(53, 1.2), part(61, 3.0)];
        let (a, b) = (without_part(&solid, q), without_part(&meshes, q));
        assert_eq!(a.is_some(), b.is_some(), "{q:?} {a:?} {b:?}");
        if a.is_some() { touching += 1 } else { clear += 1 }
    }
    assert!(clear > 50 && touching > 50, "{clear} {touching}");
}

#[test]
fn facets_that_cannot_be_read_are_an_error() {
    let urdf = DEFAULT_MACHINE_URDF
        .replace("</robot>", "<patchmill_collision_mesh filename=\"a\" facets=\"AA\"/></robot>");
    let error = bodies_of(&urdf, None).unwrap_err();
    assert!(error.code == BAD_MACHINE && error.text.contains("facets"), "{error}");
}
