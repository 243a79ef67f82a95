//! Every reader against mutated, truncated and random bytes: an error or a surface, never a panic.

use patchmill_products::stage::unobserved;
use proptest::prelude::*;

use super::*;

/// A small bowl as a mesh (n × n cells) or as points in every format.
fn seeds() -> Vec<(&'static str, Vec<u8>)> {
    const N: usize = 7;
    let at = |k: usize| {
        let (x, y) = ((k % (N + 1)) as f32, (k / (N + 1)) as f32);
        [x, y, 0.01 * (x * x + y * y)]
    };
    let points: Vec<[f32; 3]> = (0..(N + 1) * (N + 1)).map(at).collect();
    let quads: Vec<[usize; 4]> = (0..N * N)
        .map(|k| {
            let a = k % N + k / N * (N + 1);
            [a, a + 1, a + N + 2, a + N + 1]
        })
        .collect();
    let text = |word: &str| points.iter().map(|[x, y, z]| format!("{word}{x} {y} {z}\n")).collect::<String>();
    let raw: Vec<u8> = points.iter().flatten().flat_map(|x| x.to_le_bytes()).collect();
    let ply = |format: &str, faces: usize| {
        format!(
            "ply\nformat {format} 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n\
             element face {faces}\nproperty list uchar int vertex_indices\nend_header\n",
            points.len()
        )
    };
    let pcd = |data: &str| {
        format!(
            "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH {}\nHEIGHT 1\nPOINTS {}\nDATA {data}\n",
            points.len(),
            points.len()
        )
    };
    let ply_ascii = ply("ascii", quads.len())
        + &text("")
        + &quads.iter().map(|[a, b, c, d]| format!("4 {a} {b} {c} {d}\n")).collect::<String>();
    let mut ply_binary = ply("binary_little_endian", quads.len()).into_bytes();
    ply_binary.extend(&raw);
    quads.iter().for_each(|q| {
        ply_binary.push(4);
        ply_binary.extend(q.iter().flat_map(|v| (*v as i32).to_le_bytes()));
    });
    let obj = text("v ")
        + &quads
            .iter()
            .map(|q| format!("f {} {} {} {}\n", q[0] + 1, q[1] + 1, q[2] + 1, q[3] + 1))
            .collect::<String>();
    let vertices: String =
        points.iter().map(|[x, y, z]| format!("<vertex x=\"{x}\" y=\"{y}\" z=\"{z}\"/>")).collect();
    let triangles: String = quads
        .iter()
        .flat_map(|[a, b, c, d]| [[a, b, c], [a, c, d]])
        .map(|[a, b, c]| format!("<triangle v1=\"{a}\" v2=\"{b}\" v3=\"{c}\"/>"))
        .collect();
    let object = format!(
        "<object id=\"1\"><mesh><vertices>{vertices}</vertices><triangles>{triangles}</triangles></mesh></object>"
    );
    let model =
        three_mf::tests::model(&object, "<item objectid=\"1\" transform=\"1 0 0 0 1 0 0 0 1 5 5 5\"/>");
    let mut stl = vec![0; 80];
    stl.extend((2 * quads.len() as u32).to_le_bytes());
    for [a, b, c] in quads.iter().flat_map(|[a, b, c, d]| [[a, b, c], [a, c, d]]) {
        stl.extend([0; 12]);
        stl.extend([a, b, c].iter().flat_map(|v| points[**v]).flat_map(f32::to_le_bytes));
        stl.extend([0; 2]);
    }
    let by_field: Vec<u8> =
        (0..3).flat_map(|k| points.iter().flat_map(move |p| p[k].to_le_bytes())).collect();
    let packed = lzf::tests::literals(&by_field);
    let sizes = [packed.len() as u32, by_field.len() as u32].map(u32::to_le_bytes).concat();
    vec![
        ("a.stl", stl),
        ("mesh.ply", ply_ascii.into_bytes()),
        ("binary.ply", ply_binary),
        ("cloud.ply", (ply("ascii", 0) + &text("")).into_bytes()),
        ("a.obj", obj.into_bytes()),
        ("a.3mf", three_mf::tests::package(&[("3D/3dmodel.model", &model)])),
        ("a.xyz", text("").into_bytes()),
        ("ascii.pcd", (pcd("ascii") + &text("")).into_bytes()),
        ("binary.pcd", [pcd("binary").into_bytes(), raw].concat()),
        ("compressed.pcd", [pcd("binary_compressed").into_bytes(), sizes, packed].concat()),
    ]
}

fn params() -> IngestionParams {
    IngestionParams {
        samples_per_side: 3,
        max_triangles: 10_000,
        max_points: 10_000,
        ..IngestionParams::default()
    }
}

fn read(name: &str, bytes: Vec<u8>) -> Result<IngestedSurface, StageError> {
    ingest(&SurfaceSource::new(bytes, name, "mm"), &params(), unobserved())
}

#[test]
fn every_format_gives_the_same_surface() {
    for (name, bytes) in seeds() {
        let surface = read(name, bytes).unwrap();
        assert_eq!((surface.mesh.vertices.len(), surface.mesh.triangles.len()), (64, 98), "{name}");
        let heights = || surface.mesh.vertices.iter().map(|p| p.z);
        let highest = heights().fold(f64::MIN, f64::max) - heights().fold(f64::MAX, f64::min);
        let unit = if name == "a.3mf" { 25.4 } else { 1.0 };
        assert!((highest - 0.98e-3 * unit).abs() < 1e-7 * unit, "{name}: {highest}");
        assert_eq!(surface.parts, 1);
    }
}

#[test]
fn limits_name_themselves() {
    for (name, bytes) in seeds() {
        let source = SurfaceSource::new(bytes, name, "mm");
        let few = IngestionParams { max_triangles: 97, max_points: 63, ..params() };
        let error = ingest(&source, &few, unobserved()).unwrap_err();
        assert!(error.text.contains("max_triangles") || error.text.contains("max_points"), "{name}: {error}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(150))]

    #[test]
    fn changed_bytes_never_panic(
        changes in prop::collection::vec((0usize..1 << 20, any::<u8>()), 1..6),
        cut in prop::option::of(0f64..1.0),
        swap in prop::option::of((0f64..1.0, 0f64..1.0, 0usize..40)),
    ) {
        for (name, mut bytes) in seeds() {
            // Half of the changes go to the start, where the counts stand.
            for (k, (place, byte)) in changes.iter().enumerate() {
                let range = if k % 2 == 0 { bytes.len().min(300) } else { bytes.len() };
                bytes[place % range] = *byte;
            }
            if let Some((from, to, length)) = swap {
                let place = |share: f64| (share * (bytes.len() - length) as f64) as usize;
                let (from, to) = (place(from), place(to));
                bytes.copy_within(from..from + length, to);
            }
            if let Some(cut) = cut {
                bytes.truncate((bytes.len() as f64 * cut) as usize);
            }
            let _ = read(name, bytes);
        }
    }

    #[test]
    fn digits_changed_in_texts_never_panic(place in 0usize..1 << 20, text in "[-+0-9.eE nif/]{0,12}") {
        for (name, bytes) in seeds() {
            let digits: Vec<usize> = (0..bytes.len()).filter(|i| bytes[*i].is_ascii_digit()).collect();
            let at = digits[place % digits.len().min(400)];
            let _ = read(name, [&bytes[..at], text.as_bytes(), &bytes[at + 1..]].concat());
        }
    }

    #[test]
    fn random_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..600), body in "[ 0-9.\\-\nvf/#]{0,300}") {
        for (name, seed) in seeds() {
            let _ = read(name, bytes.clone());
            let _ = read(name, body.clone().into_bytes());
            // After a good header.
            let head = seed.len().min(250);
            let _ = read(name, [&seed[..head], &bytes].concat());
        }
    }
}
