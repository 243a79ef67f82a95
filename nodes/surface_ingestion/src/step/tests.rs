//! Parts written by Open CASCADE (`tests/fixtures/step/make.py`), held against closed forms and against Open CASCADE's own areas and
//! volumes.

use std::collections::BTreeMap;

use patchmill_products::stage::unobserved;

use super::*;
use crate::{IngestionParams, SurfaceSource, ingest, mesh_surface};
use patchmill_products::selection::{NormalCone, Selection};

const TOLERANCE: f64 = 2e-6;

fn fixture(name: &str) -> Vec<u8> {
    std::fs::read(format!("{}/../../tests/fixtures/step/{name}", env!("CARGO_MANIFEST_DIR"))).unwrap()
}

fn part(name: &str) -> StepSurface {
    read(&fixture(name), name, TOLERANCE, 1_000_000, false, unobserved()).unwrap()
}

/// Area and volume, mm² and mm³.
fn size(mesh: &TriangleMesh) -> (f64, f64) {
    let (mut area, mut volume) = (0.0, 0.0);
    for t in 0..mesh.triangles.len() {
        let [a, b, c] = mesh.corners(t);
        area += 0.5e6 * (b - a).cross(&(c - a)).norm();
        volume += a.coords.dot(&b.coords.cross(&c.coords)) * 1e9 / 6.0;
    }
    (area, volume)
}

/// Edges that not exactly two triangles share, each in another sense.
fn open_edges(mesh: &TriangleMesh) -> usize {
    let mut sides = BTreeMap::new();
    for t in &mesh.triangles {
        for k in 0..3 {
            let (a, b) = (t[k], t[(k + 1) % 3]);
            let slot = sides.entry((a.min(b), a.max(b))).or_insert((0, 0));
            *if a < b { &mut slot.0 } else { &mut slot.1 } += 1;
        }
    }
    sides.values().filter(|sides| **sides != (1, 1)).count()
}

/// Facets within the tolerance of radii of 5 mm and more lose less of area and volume than tolerance / radius.
const LOSS: f64 = 1e-4;

fn close(found: f64, expected: f64, relative: f64) {
    assert!((found / expected - 1.0).abs() < relative, "{found} {expected}");
}

#[test]
fn a_block_rounded_all_around_is_watertight_and_exact() {
    let StepSurface { mesh, fit, .. } = part("rounded_block.step");
    assert_eq!(open_edges(&mesh), 0);
    let (area, volume) = size(&mesh);
    close(area, 7741.592653590, LOSS);
    close(volume, 45592.182246175, LOSS);
    // By the distance from a box that is 5 mm smaller all around: 60 × 40 × 20 mm from (−30, −20, 0) on.
    let (centre, half) = (Point3::new(0.0, 0.0, 0.01), Vector3::new(0.025, 0.015, 0.005));
    let outside = |p: &Point3<f64>| {
        (p - centre).map(|x| x.signum()).component_mul(&((p - centre).abs() - half).sup(&Vector3::zeros()))
    };
    for (v, p) in mesh.vertices.iter().enumerate() {
        let out = outside(p);
        assert!((out.norm() - 0.005).abs() < 1e-12, "{p}");
        assert!((fit.normals[v] - out / 0.005).norm() < 1e-6, "{p} {} {out}", fit.normals[v]);
        assert!(!fit.sharp[v]);
        // Convex with a radius of 5 mm in as many directions as the corner has rounded axes, seen from the flatter side at borders.
        let curvature = &fit.curvature[v];
        assert!(
            curvature.max < 1e-9 && [0.0, 200.0].iter().any(|k| (curvature.min + k).abs() < 1e-9),
            "{p} {curvature:?}"
        );
    }
    for t in 0..mesh.triangles.len() {
        let [a, b, c] = mesh.corners(t);
        let middle = Point3::from((a.coords + b.coords + c.coords) / 3.0);
        assert!((outside(&middle).norm() - 0.005).abs() < TOLERANCE, "{middle}");
    }
    assert!(mesh.chord_error <= TOLERANCE && mesh.chord_error > 0.1 * TOLERANCE);
}

#[test]
fn cone_cylinder_and_torus_closed_around_meet() {
    let StepSurface { mesh, fit, .. } = part("turned_boss.step");
    assert_eq!(open_edges(&mesh), 0);
    let (area, volume) = size(&mesh);
    close(area, 12786.281427254, LOSS);
    close(volume, 73071.637725062, LOSS);
    // The outline from the axis out: a cone from 40 to 25 mm over 15 mm, 25 mm up to 21 mm, 6 mm around the edge, a plane at 27 mm.
    for (v, p) in mesh.vertices.iter().enumerate() {
        let (r, z) = (p.x.hypot(p.y) * 1e3, p.z * 1e3);
        let off = [
            if r <= 40.0 { z } else { f64::INFINITY },
            if z <= 15.0 { (r - 40.0 + z) / 2f64.sqrt() } else { f64::INFINITY },
            if (15.0..=21.0).contains(&z) { r - 25.0 } else { f64::INFINITY },
            if z >= 21.0 && r >= 19.0 { (r - 19.0).hypot(z - 21.0) - 6.0 } else { f64::INFINITY },
            if r <= 19.0 + 1e-9 { z - 27.0 } else { f64::INFINITY },
        ];
        assert!(off.iter().any(|off| off.abs() < 1e-9), "{p}");
        // Sharp where the cone ends: 45° against the cylinder, 135° at the base.
        let edge = (z.abs() < 1e-9 && (r - 40.0).abs() < 1e-9) || (z - 15.0).abs() < 1e-9;
        assert_eq!(fit.sharp[v], edge, "{p}");
        if z > 21.1 && r > 19.1 {
            let (sine, tube) = ((z - 21.0) / 6.0, (r - 19.0) / 6.0);
            let ring = -1e3 * tube / r;
            assert!(
                (fit.curvature[v].min + 1e3 / 6.0).abs() < 1e-6 && (fit.curvature[v].max - ring).abs() < 1e-6,
                "{p} {:?}",
                fit.curvature[v]
            );
            assert!((fit.normals[v].z - sine).abs() < 1e-9);
        }
    }
}

#[test]
fn rational_faces_and_edges_are_the_same_part() {
    let StepSurface { mesh, .. } = part("rational_block.step");
    assert_eq!(open_edges(&mesh), 0);
    let (area, volume) = size(&mesh);
    close(area, 439.685834271, LOSS);
    close(volume, 629.014370238, LOSS);
}

#[test]
fn a_trimmed_b_spline_keeps_its_hole() {
    let bytes = fixture("freeform_hole.step");
    let StepSurface { mesh, .. } = part("freeform_hole.step");
    let (area, _) = size(&mesh);
    close(area, 2889.752218623, LOSS);
    let from_hole = |p: &Point3<f64>| (p.x - 0.003).hypot(p.y - 0.002) - 0.007;
    assert!(mesh.vertices.iter().all(|p| from_hole(p) > -1e-6));
    assert!(mesh.vertices.iter().filter(|p| from_hole(p) < 1e-6).count() > 50);
    // As a surface to be machined it looks up, whatever the face's own side is.
    let source = SurfaceSource::new(bytes, "part.stp", "");
    let surface =
        ingest(&source, &IngestionParams { chord_tolerance: TOLERANCE, ..Default::default() }, unobserved())
            .unwrap();
    assert!(surface.samples.normals.iter().all(|n| n.z > 0.5) && surface.analytic && surface.parts == 1);
    assert!(surface.samples.points.iter().all(|p| from_hole(p) > -1e-6));
    let total: f64 = surface.samples.area.iter().sum();
    close(total * 1e6, 2889.752218623, 1e-3);
}

#[test]
fn a_surface_of_the_other_sense_is_turned_with_its_normals_and_curvature() {
    let text = String::from_utf8(fixture("freeform_hole.step")).unwrap();
    let turned = text.replace("#261,.T.);", "#261,.F.);");
    assert_ne!(text, turned);
    let made = |text: &str| {
        let step = read(text.as_bytes(), "a.step", TOLERANCE, 1_000_000, false, unobserved()).unwrap();
        mesh_surface::of_faces(step, &Selection::default(), "a.step").unwrap()
    };
    let (a, b) = (made(&text), made(&turned));
    assert_ne!(a.orientation.reversed, b.orientation.reversed);
    for v in 0..a.mesh.vertices.len() {
        assert!((a.fit.normals[v] - b.fit.normals[v]).norm() < 1e-12);
        let (a, b) = (&a.fit.curvature[v], &b.fit.curvature[v]);
        assert!((a.max - b.max).abs() < 1e-9 && (a.min - b.min).abs() < 1e-9);
    }
}

#[test]
fn what_is_not_read_is_named_by_number_and_type() {
    let text = String::from_utf8(fixture("turned_boss.step")).unwrap();
    let refused = |text: &str| {
        read(text.as_bytes(), "a.step", TOLERANCE, 1_000_000, false, unobserved()).map(|_| ()).unwrap_err()
    };
    for (from, to, words) in [
        ("= TOROIDAL_SURFACE(", "= OFFSET_SURFACE(", "OFFSET_SURFACE: this kind of surface is not read"),
        ("= CIRCLE(", "= PARABOLA(", "PARABOLA: this kind of curve is not read"),
        ("= EDGE_LOOP(", "= POLY_LOOP(", "POLY_LOOP: EDGE_LOOP was expected"),
        ("SI_UNIT(.MILLI.,.METRE.)", "SI_UNIT(.GIGA.,.METRE.)", "this prefix is not read"),
        ("= ADVANCED_FACE(", "= FACE(", "no ADVANCED_FACE"),
        ("= PRODUCT_CATEGORY(", "= MAPPED_ITEM(", "MAPPED_ITEM: assemblies are not read"),
        ("= DIRECTION('',(0.,0.,1.)", "= DIRECTION('',(0.,0.,0.)", "not all 0"),
        // The cylinder without its seam.
        ("EDGE_LOOP('',(#20,#30,#37,#38))", "EDGE_LOOP('',(#30))", "#17 ADVANCED_FACE: a loop goes around"),
        (
            "EDGE_LOOP('',(#20,#30,#37,#38))",
            "EDGE_LOOP('',(#20,#37,#38))",
            "#17 ADVANCED_FACE: a loop goes around",
        ),
        ("EDGE_LOOP('',(#20,#30,#37,#38))", "EDGE_LOOP('',(#20,#38))", "its loop is broken at the edge #39"),
        (",27.))", ",29.))", "mm from its vertex"),
    ] {
        assert!(text.contains(from), "{from}");
        let error = refused(&text.replace(from, to));
        assert!(
            error.code == BAD_CONTENT && error.text.starts_with("a.step: ") && error.text.contains(words),
            "{words}: {error}"
        );
        assert!(error.text.contains('#') || words.starts_with("no "), "{error}");
    }
    let few = read(text.as_bytes(), "a.step", TOLERANCE, 100, false, unobserved()).map(|_| ()).unwrap_err();
    assert!(few.text.contains("max_triangles"), "{few}");
}

#[test]
fn a_collapsed_side_is_refused() {
    let text = String::from_utf8(fixture("freeform_hole.step")).unwrap();
    let side = text.replace("(#262,#263,#264,#265,#266,#267)", "(#262,#262,#262,#262,#262,#262)");
    let error =
        read(side.as_bytes(), "a.step", TOLERANCE, 1_000_000, false, unobserved()).map(|_| ()).unwrap_err();
    assert!(error.text.contains("#261 B_SPLINE_SURFACE_WITH_KNOTS: a side of it collapses"), "{error}");
}

#[test]
fn units_are_the_files() {
    let text = String::from_utf8(fixture("rational_block.step")).unwrap();
    let metres = text.replace("SI_UNIT(.MILLI.,.METRE.)", "SI_UNIT(.CENTI.,.METRE.)");
    let mesh =
        read(metres.as_bytes(), "a.step", 10.0 * TOLERANCE, 1_000_000, false, unobserved()).unwrap().mesh;
    close(size(&mesh).0, 43968.5834271, LOSS);
}

#[test]
fn the_faces_of_a_solid_are_told_apart_at_sharp_edges_where_some_are_selected() {
    let made = |apart: bool| {
        let step = read(&fixture("rational_block.step"), "a.step", TOLERANCE, 1_000_000, apart, unobserved());
        let selection = Selection {
            cone: Some(NormalCone { axis: Vector3::z_axis(), angle: 1.0 }),
            ..Selection::default()
        };
        mesh_surface::of_faces(step.unwrap(), &selection, "a.step").unwrap()
    };
    let (whole, apart) = (made(false), made(true));
    // The same facets, closed and looking outwards.
    assert_eq!(whole.mesh.triangles.len(), apart.mesh.triangles.len());
    assert_eq!((whole.orientation.closed_parts, apart.orientation.closed_parts), (1, 1));
    let corners = |m: &TriangleMesh| (0..m.triangles.len()).map(|t| m.corners(t)).collect::<Vec<_>>();
    assert_eq!(corners(&whole.mesh), corners(&apart.mesh));
    assert_eq!(whole.mesh.check_only, apart.mesh.check_only);
    assert!(whole.fit.sharp.iter().any(|sharp| *sharp) && !apart.fit.sharp.iter().any(|sharp| *sharp));
    // Every vertex's normal is that of its facets.
    for (t, triangle) in apart.mesh.triangles.iter().enumerate() {
        let [a, b, c] = apart.mesh.corners(t);
        let Some(normal) = (b - a).cross(&(c - a)).try_normalize(1e-15) else { continue };
        for v in triangle {
            assert!(normal.dot(&apart.mesh.normals[*v as usize]) > 0.9, "facet {t}");
        }
    }
}

/// Inputs that the fuzzer's seeds led to: instances that lead to themselves and few bytes that state much.
#[test]
fn instances_that_lead_to_themselves_are_refused() {
    let refused = |text: &str| {
        read(text.as_bytes(), "a.step", TOLERANCE, 1_000_000, false, unobserved())
            .map(|_| ())
            .unwrap_err()
            .text
    };
    let file = |data: &str| format!("ISO-10303-21;\nDATA;\n{data}ENDSEC;\nEND-ISO-10303-21;\n");
    let context = "#1=GLOBAL_UNIT_ASSIGNED_CONTEXT((#2));\n#2=(CONVERSION_BASED_UNIT('',#3)LENGTH_UNIT());\n";
    let round = file(&format!("{context}#3=LENGTH_MEASURE_WITH_UNIT(LENGTH_MEASURE(2.),#2);\n"));
    assert!(
        refused(&round).contains("#2 CONVERSION_BASED_UNIT LENGTH_UNIT: it leads to itself"),
        "{}",
        refused(&round)
    );
    assert!(refused(&file(&format!("{context}#3=();\n"))).contains("#3 of the STEP file has no type"));
    let text = String::from_utf8(fixture("turned_boss.step")).unwrap();
    let line = text.find("LINE(").and_then(|at| Some((text[..at].rfind('#')?, at + 5))).unwrap();
    let number = text[line.0..].split(' ').next().unwrap();
    let curve = format!(
        "{}{number} = SURFACE_CURVE('',{number},(),$);\n#99999 = LINE({}",
        &text[..line.0],
        &text[line.1..]
    );
    assert!(refused(&curve).contains("SURFACE_CURVE: it leads to itself"), "{}", refused(&curve));
    let spline = String::from_utf8(fixture("freeform_hole.step")).unwrap();
    let many = spline.replacen("(4,", "(4000000000,", 1);
    assert_ne!(many, spline);
    assert!(refused(&many).contains("more knots than"), "{}", refused(&many));
}
