//! The stage as a whole: the fixtures, bad input, meshes of known surfaces.

use std::path::Path;
use std::time::Instant;

use nalgebra::{Point3, Vector3};
use patchmill_products::stage::unobserved;

use super::*;

fn fixture(name: &str) -> IngestedSurface {
    let directory = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures");
    let source = read_source(&directory, name, "mm").unwrap();
    let start = Instant::now();
    let surface = ingest(&source, &IngestionParams::default(), unobserved()).unwrap();
    println!(
        "{name}: {} triangles, {} samples, chord {:.3} µm, {:.0} ms, id {}",
        surface.mesh.triangles.len(),
        surface.samples.len(),
        surface.mesh.chord_error * 1e6,
        start.elapsed().as_secs_f64() * 1e3,
        surface.surface_id
    );
    surface
}

/// Invariants of every product of this stage.
fn check(surface: &IngestedSurface) {
    let (mesh, samples) = (&surface.mesh, &surface.samples);
    assert_eq!(mesh.vertices.len(), mesh.normals.len());
    assert!(mesh.triangles.iter().flatten().all(|&v| (v as usize) < mesh.vertices.len()));
    assert!(mesh.normals.iter().chain(&samples.normals).all(|n| (n.norm() - 1.0).abs() < 1e-12));
    let n = samples.len();
    assert!([samples.normals.len(), samples.curvature_max.len(), samples.curvature_min.len()] == [n; 3]);
    assert!([samples.direction_max.len(), samples.area.len()] == [n; 2]);
    for i in 0..n {
        assert!(samples.curvature_max[i] >= samples.curvature_min[i]);
        assert!((samples.direction_max[i].norm() - 1.0).abs() < 1e-9);
        assert!(samples.direction_max[i].dot(&samples.normals[i]).abs() < 1e-9);
        assert!(samples.area[i] >= 0.0);
    }
    let area: f64 = (0..mesh.triangles.len())
        .map(|t| {
            let [a, b, c] = mesh.corners(t);
            let cross = (b - a).cross(&(c - a));
            let mean: Vector3<f64> = mesh.triangles[t].iter().map(|&v| mesh.normals[v as usize]).sum();
            assert!(cross.dot(&mean) > 0.0, "facet {t} is wound against its normals");
            0.5 * cross.norm()
        })
        .sum();
    let sampled: f64 = samples.area.iter().sum();
    assert!((area - sampled).abs() < 2e-3 * area, "area {area} sampled {sampled}");
}

fn radii(surface: &IngestedSurface) -> (f64, f64) {
    let most = surface.samples.curvature_max.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let least = surface.samples.curvature_min.iter().copied().fold(f64::INFINITY, f64::min);
    (1e3 / most, -1e3 / least)
}

#[test]
fn the_fixtures_have_their_known_radii() {
    for (name, concave, convex) in [
        ("surface_1.json", 93.0, 93.5),
        ("surface_2.json", 113.8, 78.1),
        ("surface_3.json", 70.4, 70.4),
        ("surface_4.stl", 45.0, 35.0),
    ] {
        let surface = fixture(name);
        check(&surface);
        let (a, b) = radii(&surface);
        println!("  concave {a:.2} mm, convex {b:.2} mm");
        assert!((a / concave - 1.0).abs() < 0.01, "{name}: concave {a}");
        assert!((b / convex - 1.0).abs() < 0.01, "{name}: convex {b}");
        if surface.analytic {
            assert!(surface.mesh.chord_error <= 0.5e-6);
            assert!((20_000..300_000).contains(&surface.mesh.triangles.len()));
            assert_eq!(surface.samples.len(), 2500);
        }
    }
}

#[test]
fn facets_keep_within_the_chord_tolerance() {
    // The distance to the graph, along the facet's normal, at points that tessellation did not look at.
    let surface = fixture("surface_3.json");
    let formula = expression::Expression::parse("3.6*sin(2*pi*x/100) + cos(pi*y/40)").unwrap();
    let mut worst = 0f64;
    for t in 0..surface.mesh.triangles.len() {
        let [a, b, c] = surface.mesh.corners(t).map(|p| p.coords);
        let n = (b - a).cross(&(c - a)).normalize();
        for w in [
            [0.5, 0.5, 0.0],
            [0.0, 0.5, 0.5],
            [0.5, 0.0, 0.5],
            [0.34, 0.33, 0.33],
            [0.6, 0.2, 0.2],
            [0.1, 0.45, 0.45],
        ] {
            let p = a * w[0] + b * w[1] + c * w[2];
            let z = formula.at(p.x * 1e3, p.y * 1e3).jet.value * 1e-3;
            worst = worst.max(((z - p.z) * n.z).abs());
        }
    }
    assert!(worst <= surface.mesh.chord_error * 1.01 && worst > 0.5 * surface.mesh.chord_error, "{worst}");
}

fn json(text: &str) -> Result<IngestedSurface, StageError> {
    ingest(
        &SurfaceSource::new(text.as_bytes().to_vec(), "part.json", "mm"),
        &IngestionParams::default(),
        unobserved(),
    )
}

fn formula(expression: &str) -> Result<IngestedSurface, StageError> {
    json(&format!(
        r#"{{"kind":"algebraic","units":"mm","expression":"{expression}","x":[0,100],"y":[0,40]}}"#
    ))
}

#[test]
fn each_bad_file_is_one_clear_error() {
    let row = "[[0,0,0],[0,10,0],[0,20,0],[0,30,0]]";
    let net = |rows: &str| format!(r#"{{"kind":"bezier","units":"mm","control_points":[{rows}]}}"#);
    for (text, part) in [
        (String::new(), "not valid JSON"),
        ("{".to_owned(), "not valid JSON"),
        ("[1]".to_owned(), "a JSON object was expected, found a list of 1"),
        ("{}".to_owned(), "'kind' is missing"),
        (r#"{"kind":3}"#.to_owned(), "'kind' must be a text, found the number 3"),
        (r#"{"kind":"spline"}"#.to_owned(), "\"spline\" is unknown"),
        (r#"{"kind":"bezier","units":"cm"}"#.to_owned(), "\"cm\" is unknown"),
        (r#"{"kind":"bezier"}"#.to_owned(), "'control_points' is missing"),
        (r#"{"kind":"bezier","weights":[]}"#.to_owned(), "'weights' is unknown"),
        (net(&[row; 3].join(",")), "list of 4 rows was expected, found a list of 3"),
        (net(&[row, row, row, "[[0,0,0]]"].join(",")), "in row 4 a list of 4 points"),
        (
            net(&[row, row, row, &row.replace("[0,10,0]", "[0,10]")].join(",")),
            "control point 2 of row 4: [x, y, z]",
        ),
        (
            net(&[row, row, row, &row.replace("10", "\"a\"")].join(",")),
            "must be a number, found the text \"a\"",
        ),
        (net(&[row, row, row, &row.replace("10", "null")].join(",")), "must be a number, found null"),
        (net(&[row, row, row, &row.replace("10", "NaN")].join(",")), "not valid JSON"),
        (net(&[row, row, row, &row.replace("10", "1e400")].join(",")), "not valid JSON"),
        (net(&[row, row, row, &row.replace("10", "1e9")].join(",")), "from the origin"),
        (net(&[row; 4].join(",")), "no +Z side"),
        (r#"{"kind":"algebraic","expression":"x","x":[0,1]}"#.to_owned(), "'y' is missing"),
        (r#"{"kind":"algebraic","expression":"x","x":[1,1],"y":[0,1]}"#.to_owned(), "range of 'x' is empty"),
        (r#"{"kind":"algebraic","expression":"x","x":[0,1,2],"y":[0,1]}"#.to_owned(), "range [low, high]"),
        (r#"{"kind":"algebraic","x":[0,1],"y":[0,1]}"#.to_owned(), "'expression' is missing"),
        (
            r#"{"kind":"algebraic","expression":5,"x":[0,1],"y":[0,1]}"#.to_owned(),
            "'expression' must be a text",
        ),
    ] {
        let Err(error) = json(&text) else { panic!("{text} was read") };
        assert!(error.text.contains(part), "{text}: {error}");
        assert!(error.text.contains("part.json") && (100..200).contains(&error.code), "{error}");
    }
}

#[test]
fn each_bad_expression_is_one_clear_error() {
    for (text, parts) in [
        ("3*foo(x)", ["'foo' is unknown", "3*foo(x)"]),
        ("3*(x", ["ends where", "3*(x"]),
        ("1/(x-50)", ["x = 50", "1/(x-50)"]),
        ("1/(x-33.333)", ["x = 33.", "pole"]),
        ("1e-9/(x-33.333)", ["x = 33.333000", "pole"]),
        ("1/(x-33.333)^2", ["x = 33.", "pole"]),
        ("tan(x/10)", ["x = 15.70796", "pole"]),
        ("log(x-20)", ["x = 0", "no finite value"]),
        ("sqrt(x)", ["x = 0", "no finite value"]),
        ("(x-20)^0.5", ["x = 0", "no finite value"]),
        ("5*abs(x-50.3)", ["x = 50.", "crease"]),
        ("exp(x^2)", ["x = 20.", "no normal"]),
        ("50*sin(1000*x)", ["more than the 8000000 allowed", "x = "]),
    ] {
        let Err(error) = formula(text) else { panic!("{text} was read") };
        assert!(parts.iter().all(|p| error.text.contains(p)), "{text}: {error}");
    }
}

#[test]
fn planes_cylinders_and_turned_nets_work() {
    let plane = formula("0.1*x").unwrap();
    check(&plane);
    assert!(plane.mesh.triangles.len() < 20_000 && plane.mesh.chord_error < 1e-12);
    let cylinder = formula("sqrt(100^2 - (x-50)^2)").unwrap();
    check(&cylinder);
    assert!((radii(&cylinder).1 - 100.0).abs() < 1e-6);
    assert!(cylinder.mesh.triangles.len() < 40_000, "{}", cylinder.mesh.triangles.len());

    let row = |x: i32, down: bool| {
        let point =
            |j: i32| format!("[{x},{},{}]", if down { 30 - j * 10 } else { j * 10 }, (x - 15).abs() / 4);
        format!("[{}]", (0..4).map(point).collect::<Vec<_>>().join(","))
    };
    for down in [false, true] {
        let rows: Vec<String> = (0..4).map(|i| row(i * 10, down)).collect();
        let net = json(&format!(r#"{{"kind":"bezier","control_points":[{}]}}"#, rows.join(","))).unwrap();
        check(&net);
        assert!(net.samples.normals.iter().all(|n| n.z > 0.0));
        assert!(radii(&net).0 > 0.0, "a trough is concave whichever way the net runs");
    }
    let collapsed = json(
        r#"{"kind":"bezier","control_points":[
        [[0,0,0],[0,0,0],[0,0,0],[0,0,0]], [[10,-5,0],[10,0,1],[10,5,1],[10,10,0]],
        [[20,-10,0],[20,0,1],[20,10,1],[20,20,0]], [[30,-15,0],[30,0,1],[30,10,1],[30,30,0]]]}"#,
    )
    .map(|s| s.surface_id)
    .unwrap_err();
    assert!(collapsed.text.contains("degenerate at u = 0.0000"), "{collapsed}");
}

#[test]
fn units_scale_and_ids_tell_content_apart() {
    let text = |units: &str| {
        format!(r#"{{"kind":"algebraic","units":"{units}","expression":"x*y","x":[0,0.5],"y":[0,0.5]}}"#)
    };
    let (mm, inch) = (json(&text("mm")).unwrap(), json(&text("in")).unwrap());
    let last = |s: &IngestedSurface| *s.samples.points.last().unwrap();
    assert!((last(&inch) - last(&mm) * 25.4).norm() < 1e-12);
    let source = SurfaceSource::new(text("mm").into_bytes(), "a.json", "mm");
    let id = |params: IngestionParams| surface_id(&source, &params);
    let base = IngestionParams::default();
    assert_eq!(id(base.clone()).len(), 16);
    assert_eq!(id(base.clone()), id(base.clone()));
    assert_ne!(id(base.clone()), id(IngestionParams { chord_tolerance: 1e-6, ..base.clone() }));
    assert_ne!(id(base.clone()), id(IngestionParams { samples_per_side: 40, ..base.clone() }));
    assert_ne!(mm.surface_id, inch.surface_id);
    assert!(
        ingest(&source, &IngestionParams { chord_tolerance: f64::NAN, ..base.clone() }, unobserved())
            .is_err()
    );
    assert!(ingest(&source, &IngestionParams { samples_per_side: 1, ..base }, unobserved()).is_err());
}

/// A binary STL of the graph z(x, y) over a square of `side` mm with n × n cells.
fn stl_of(n: usize, side: f64, z: impl Fn(f64, f64) -> f64) -> Vec<u8> {
    let at = |i: usize, j: usize| {
        let (x, y) = (side * (i as f64 / n as f64 - 0.5), side * (j as f64 / n as f64 - 0.5));
        stl_io::Vertex::new([x as f32, y as f32, z(x, y) as f32])
    };
    let mut facets = Vec::with_capacity(2 * n * n);
    for j in 0..n {
        for i in 0..n {
            let (a, b, c, d) = (at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1));
            let normal = stl_io::Normal::new([0.0; 3]);
            // Every third facet wound the wrong way round.
            let first = if (i + j) % 3 == 0 { [a, c, b] } else { [a, b, c] };
            facets.extend([
                stl_io::Triangle { normal, vertices: first },
                stl_io::Triangle { normal, vertices: [a, c, d] },
            ]);
        }
    }
    let mut bytes = Vec::new();
    stl_io::write_stl(&mut bytes, facets.iter()).unwrap();
    bytes
}

#[test]
fn a_mesh_of_a_bowl_is_sampled_evenly_with_true_curvature() {
    let r = 80.0;
    let bytes = stl_of(80, 60.0, |x, y| r - (r * r - x * x - y * y).sqrt());
    let source = SurfaceSource::new(bytes, "bowl.stl", "mm");
    let surface = ingest(&source, &IngestionParams::default(), unobserved()).unwrap();
    check(&surface);
    assert_eq!((surface.parts, surface.sharp_vertices, surface.samples.len()), (1, 0, 2500));
    assert!(surface.reversed > 0);
    // A cell's diagonal at the corner (30, 30), where the slope stretches it by 1/cos.
    let chord = 0.75 * 0.75 * 2.0 / (1.0 - 1800.0 / (r * r)) / (8.0 * r) * 1e-3;
    assert!((surface.mesh.chord_error / chord - 1.0).abs() < 0.05, "{}", surface.mesh.chord_error);
    let (samples, r) = (&surface.samples, r * 1e-3);
    let centre = Point3::new(0.0, 0.0, r);
    for i in 0..samples.len() {
        assert!(((samples.points[i] - centre).norm() - r).abs() < 5e-8);
        assert!((centre - samples.points[i]).normalize().cross(&samples.normals[i]).norm() < 2e-4);
        assert!(
            (samples.curvature_max[i] * r - 1.0).abs() < 0.02
                && (samples.curvature_min[i] * r - 1.0).abs() < 0.02
        );
    }
    let spacing = (samples.area.iter().sum::<f64>() / 2500.0).sqrt();
    for (i, p) in samples.points.iter().enumerate() {
        let nearest = samples.points.iter().enumerate().filter(|(j, _)| *j != i).map(|(_, q)| (p - q).norm());
        let nearest = nearest.fold(f64::INFINITY, f64::min);
        assert!(nearest > 0.6 * spacing && nearest < 1.6 * spacing, "{nearest} {spacing}");
    }
    let corner = samples.points.iter().map(|p| p.x + p.y).fold(0.0, f64::max);
    assert!(corner > 0.0599, "the corners are sampled");
}

#[test]
fn a_few_facets_are_enough_and_none_are_an_error() {
    let source = |bytes| SurfaceSource::new(bytes, "a.stl", "mm");
    let params = IngestionParams::default();
    let square = ingest(&source(stl_of(1, 10.0, |_, _| 0.0)), &params, unobserved()).unwrap();
    check(&square);
    assert_eq!(square.samples.len(), 2500);
    let needle = b"solid a\nfacet normal 0 0 0\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 2 0 0\nendloop\nendfacet\nendsolid";
    let error = ingest(&source(needle.to_vec()), &params, unobserved()).unwrap_err();
    assert!(error.text.contains("degenerate"), "{error}");
}

#[test]
fn the_result_does_not_depend_on_the_number_of_threads() {
    let source = SurfaceSource::new(stl_of(200, 100.0, |x, y| 0.002 * x * x - 0.003 * y * y), "a.stl", "mm");
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| ingest(&source, &IngestionParams::default(), unobserved())).unwrap()
    };
    let (one, three) = (run(1), run(3));
    assert_eq!((one.mesh.vertices.len(), one.mesh.triangles.len()), (201 * 201, 80_000));
    // Not assert_eq: a difference would print the whole mesh.
    assert!(one == three);
}
