//! Files to start from: valid ones of every format, and hostile ones (deep nesting, aliases of aliases, cycles).

use std::io::{Cursor, Write};
use std::path::Path;

use patchmill_bag_recorder::BagMessage;
use patchmill_machine_interface::MACHINES;

use crate::fixture;

/// Cells of the small bowl along each side.
const CELLS: usize = 3;
/// Levels of hostile nesting.
const DEEP: usize = 3000;

/// A bowl of few facets: points and the corners of its quads.
fn bowl() -> (Vec<[f32; 3]>, Vec<[usize; 4]>) {
    let side = CELLS + 1;
    let at = |k: usize| {
        let (x, y) = ((k % side) as f32, (k / side) as f32);
        [x, y, 0.01 * (x * x + y * y)]
    };
    let quad = |k: usize| {
        let a = k % CELLS + k / CELLS * side;
        [a, a + 1, a + side + 1, a + side]
    };
    ((0..side * side).map(at).collect(), (0..CELLS * CELLS).map(quad).collect())
}

fn facets() -> Vec<[[f32; 3]; 3]> {
    let (points, quads) = bowl();
    let halves = quads.iter().flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]]);
    halves.map(|corners| corners.map(|v| points[v])).collect()
}

fn lines(word: &str) -> String {
    bowl().0.iter().map(|[x, y, z]| format!("{word}{x} {y} {z}\n")).collect()
}

fn raw_points() -> Vec<u8> {
    bowl().0.iter().flatten().flat_map(|x| x.to_le_bytes()).collect()
}

/// STL, binary and ASCII.
pub fn stl() -> Vec<Vec<u8>> {
    let mut binary = vec![0; 80];
    binary.extend((facets().len() as u32).to_le_bytes());
    let mut ascii = String::from("solid part\n");
    for facet in facets() {
        binary.extend([0; 12]);
        binary.extend(facet.iter().flatten().flat_map(|x| x.to_le_bytes()));
        binary.extend([0; 2]);
        ascii += "facet normal 0 0 1\n outer loop\n";
        ascii += &facet.map(|[x, y, z]| format!("  vertex {x} {y} {z}\n")).concat();
        ascii += " endloop\nendfacet\n";
    }
    vec![binary, (ascii + "endsolid part\n").into_bytes()]
}

/// Wavefront OBJ.
pub fn obj() -> Vec<Vec<u8>> {
    let faces: String =
        bowl().1.iter().map(|q| format!("f {}\n", q.map(|v| (v + 1).to_string()).join(" "))).collect();
    let polygon = format!("{}f -1 -2 -3 -4 -5 -6//1 -7/2 -8\n", lines("v "));
    vec![(lines("v ") + &faces).into_bytes(), polygon.into_bytes()]
}

/// PLY: a mesh as text and in both byte orders, a cloud, and an element without properties.
pub fn ply() -> Vec<Vec<u8>> {
    let (points, quads) = bowl();
    let head = |format: &str, faces: usize| {
        format!(
            "ply\nformat {format} 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n\
             element face {faces}\nproperty list uchar int vertex_indices\nend_header\n",
            points.len()
        )
    };
    let faces: String = quads.iter().map(|q| format!("4 {}\n", q.map(|v| v.to_string()).join(" "))).collect();
    let binary = |name: &str, turn: fn([u8; 4]) -> [u8; 4]| {
        let mut bytes = head(name, quads.len()).into_bytes();
        bytes.extend(points.iter().flatten().flat_map(|x| turn(x.to_le_bytes())));
        for quad in &quads {
            bytes.push(4);
            bytes.extend(quad.iter().flat_map(|v| turn((*v as i32).to_le_bytes())));
        }
        bytes
    };
    let reversed = |mut bytes: [u8; 4]| {
        bytes.reverse();
        bytes
    };
    let others = head("ascii", 0)
        .replace("element face", "element other 3\nproperty list uint double l\nelement face");
    vec![
        (head("ascii", quads.len()) + &lines("") + &faces).into_bytes(),
        binary("binary_little_endian", |bytes| bytes),
        binary("binary_big_endian", reversed),
        (head("ascii", 0) + &lines("")).into_bytes(),
        (others + &lines("") + "1 2\n0\n0\n").into_bytes(),
    ]
}

/// PCD: as text, binary and compressed.
pub fn pcd() -> Vec<Vec<u8>> {
    let (points, _) = bowl();
    let head = |data: &str| {
        let n = points.len();
        format!(
            "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH {n}\nHEIGHT 1\nPOINTS {n}\nDATA {data}\n"
        )
    };
    let by_field: Vec<u8> =
        (0..3).flat_map(|k| points.iter().flat_map(move |p| p[k].to_le_bytes())).collect();
    // LZF of literals alone: a byte says how many follow, less one.
    let packed: Vec<u8> =
        by_field.chunks(32).flat_map(|part| [&[part.len() as u8 - 1], part].concat()).collect();
    let sizes = [packed.len() as u32, by_field.len() as u32].map(u32::to_le_bytes).concat();
    vec![
        (head("ascii") + &lines("")).into_bytes(),
        [head("binary").into_bytes(), raw_points()].concat(),
        [head("binary_compressed").into_bytes(), sizes, packed].concat(),
    ]
}

/// Points as text.
pub fn xyz() -> Vec<Vec<u8>> {
    let normals: String = bowl().0.iter().map(|[x, y, z]| format!("{x};{y};{z};0;0;1 // scan\n")).collect();
    vec![lines("").into_bytes(), format!("x y z nx ny nz\n{normals}").into_bytes()]
}

/// Models of a 3MF: plain, of components that place each other, and nested deep.
pub fn models() -> Vec<Vec<u8>> {
    let (points, quads) = bowl();
    let vertices: String =
        points.iter().map(|[x, y, z]| format!("<vertex x=\"{x}\" y=\"{y}\" z=\"{z}\"/>")).collect();
    let halves = quads.iter().flat_map(|[a, b, c, d]| [[a, b, c], [a, c, d]]);
    let triangles: String =
        halves.map(|[a, b, c]| format!("<triangle v1=\"{a}\" v2=\"{b}\" v3=\"{c}\"/>")).collect();
    let model = |more: &str, items: &str| {
        format!(
            "<?xml version=\"1.0\"?><model unit=\"millimeter\"><resources><object id=\"1\"><mesh><vertices>{vertices}</vertices>\
             <triangles>{triangles}</triangles></mesh></object>{more}</resources><build>{items}</build></model>"
        )
    };
    let plain = model("", "<item objectid=\"1\" transform=\"1 0 0 0 1 0 0 0 1 5 5 5\"/>");
    let placed = "<component objectid=\"1\"/><component objectid=\"2\"/>";
    let assembly = format!("<object id=\"2\"><components>{placed}</components></object>");
    let round = model(&assembly, "<item objectid=\"2\"/>");
    let deep = model("", &("<a>".repeat(DEEP) + &"</a>".repeat(DEEP)));
    [plain, round, deep].map(String::into_bytes).to_vec()
}

/// 3MF: every model stored, and one compressed.
pub fn three_mf() -> Vec<Vec<u8>> {
    let models = models();
    let compressed = models.first().map(|model| package(model, true));
    models.iter().map(|model| package(model, false)).chain(compressed).collect()
}

/// A 3MF of one model.
pub fn package(model: &[u8], compressed: bool) -> Vec<u8> {
    let method = if compressed { zip::CompressionMethod::Deflated } else { zip::CompressionMethod::Stored };
    let options = zip::write::SimpleFileOptions::default().compression_method(method);
    let mut writer = zip::ZipWriter::new(Cursor::new(Vec::new()));
    let written = writer
        .start_file("3D/3dmodel.model", options)
        .and_then(|()| Ok(writer.write_all(model)?))
        .and_then(|()| writer.finish());
    written.map(Cursor::into_inner).unwrap_or_default()
}

/// Surfaces as JSON.
pub fn json() -> Vec<Vec<u8>> {
    let names = [
        "nurbs_trough.json",
        "small_bezier.json",
        "steep_bezier.json",
        "surface_1.json",
        "surface_2.json",
        "surface_3.json",
    ];
    let mut seeds = files(&names);
    seeds.push("[".repeat(DEEP).into_bytes());
    seeds
}

/// Formulas.
pub fn expressions() -> Vec<Vec<u8>> {
    let formulas = [
        "3.6*sin(2*pi*x/100) + cos(pi*y/40)",
        "x^3*y - y**4/(1+x^2)",
        "exp(-x*y)*tanh(x-y)",
        "sqrt(x^2+y^2+1)*log(2+x)",
        "abs(x-3)^3 + tan(x/9)*sinh(y/3)/cosh(x/2)",
        "((((x))))",
        "-+-+x",
        "2^-1*.5e3",
    ];
    formulas.map(|f| f.as_bytes().to_vec()).to_vec()
}

/// STEP files: parts, and small ones whose instances lead to themselves.
pub fn step() -> Vec<Vec<u8>> {
    let names = ["freeform_hole.step", "rational_block.step", "rounded_block.step", "turned_boss.step"];
    let mut seeds = files(&names.map(|name| Path::new("step").join(name)));
    let file = |data: &str| {
        format!("ISO-10303-21;\nHEADER;\nENDSEC;\nDATA;\n{data}ENDSEC;\nEND-ISO-10303-21;\n").into_bytes()
    };
    let units = "#1=(GEOMETRIC_REPRESENTATION_CONTEXT(3)GLOBAL_UNIT_ASSIGNED_CONTEXT((#2))REPRESENTATION_CONTEXT('',''));\n";
    let metre = "#2=(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT(.MILLI.,.METRE.));\n";
    let inch = "#2=(CONVERSION_BASED_UNIT('INCH',#3)LENGTH_UNIT()NAMED_UNIT(*));\n#3=LENGTH_MEASURE_WITH_UNIT(LENGTH_MEASURE(25.4),#4);\n\
        #4=(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT(.MILLI.,.METRE.));\n";
    let square = "#10=ADVANCED_FACE('',(#11),#12,.T.);\n#11=FACE_OUTER_BOUND('',#13,.T.);\n#12=PLANE('',#14);\n\
        #13=EDGE_LOOP('',(#21,#22,#23));\n#14=AXIS2_PLACEMENT_3D('',#31,$,$);\n\
        #21=ORIENTED_EDGE('',*,*,#41,.T.);\n#22=ORIENTED_EDGE('',*,*,#42,.T.);\n#23=ORIENTED_EDGE('',*,*,#43,.T.);\n\
        #31=CARTESIAN_POINT('',(0.,0.,0.));\n#32=CARTESIAN_POINT('',(10.,0.,0.));\n#33=CARTESIAN_POINT('',(0.,10.,0.));\n\
        #34=VERTEX_POINT('',#31);\n#35=VERTEX_POINT('',#32);\n#36=VERTEX_POINT('',#33);\n\
        #41=EDGE_CURVE('',#34,#35,#52,.T.);\n#42=EDGE_CURVE('',#35,#36,#51,.T.);\n#43=EDGE_CURVE('',#36,#34,#51,.T.);\n\
        #51=LINE('',#31,#52);\n#52=SURFACE_CURVE('',#51,(),.PCURVE_S1.);\n";
    seeds.push(file(&[units, metre, square].concat()));
    seeds.push(file(&[units, inch, square].concat()));
    seeds
}

fn files(names: &[impl AsRef<Path>]) -> Vec<Vec<u8>> {
    names.iter().filter_map(|name| std::fs::read(fixture("").join(name)).ok()).collect()
}

/// Machines as URDF.
pub fn urdf() -> Vec<Vec<u8>> {
    let shape = "<collision><geometry><mesh filename=\"a.stl\"/></geometry></collision>";
    let own = MACHINES[0].1.replacen("</link>", &format!("{shape}</link>"), 1);
    let facets = [[nalgebra::Point3::new(0.0, 0.0, 0.5); 3]; 2];
    let with_mesh = patchmill_kinematics::with_collision_mesh(&own, "a.stl", &facets).unwrap_or_default();
    let deep = format!("<robot name=\"m\">{}</robot>", "<a>".repeat(DEEP) + &"</a>".repeat(DEEP));
    let mut seeds: Vec<Vec<u8>> = MACHINES.iter().map(|(_, text)| text.as_bytes().to_vec()).collect();
    seeds.extend([own, with_mesh, deep].map(String::into_bytes));
    seeds
}

/// Parameter files and values, aliases of aliases and deep nesting among them.
pub fn parameters() -> Vec<Vec<u8>> {
    let shipped = concat!(env!("CARGO_MANIFEST_DIR"), "/../launch_scripts/config/patchmill.yaml");
    let mut laughs = String::from("a: &a0 [x, x, x, x, x, x, x, x, x]\n");
    for k in 1..5 {
        let list = vec![format!("*a{}", k - 1); 9].join(", ");
        laughs += &format!("b{k}: &a{k} [{list}]\n");
    }
    let mut seeds: Vec<Vec<u8>> = std::fs::read(shipped).into_iter().collect();
    let texts = [
        "/**:\n  ros__parameters:\n    noise_tolerance_mm: 0.1\n    a:\n      b: [1, 2.5]\n      c: &x text\n      d: *x\n",
        "surface_ingestion:noise_tolerance_mm:=0.2",
        "shadow:=exact",
        "[1, 2.5, -3e5]",
        "{a: [b, {c: d}]}",
        "- - - - 1\n",
        &laughs,
        &"[".repeat(DEEP),
        &"{a: ".repeat(DEEP),
        &"- ".repeat(DEEP),
    ];
    seeds.extend(texts.map(|t| t.as_bytes().to_vec()));
    seeds
}

/// Job files.
pub fn job_files() -> Vec<Vec<u8>> {
    let texts = [
        "surface: a.json\nout: plan\ntool:\n  - r1=13.05,r2=6\n  - \"r1=1,r2=2\"\nfeed: 2.5e3\nselect: [z=0..1]\npatches: 2..8\n",
        "surface: a.json\nout: p\nholder: d=32..40,l=30\nmount: -90,-60,70,0,0,0\nstrategy: five-axis\nparam: [shadow:=exact]\n",
        "# nothing\n",
        "a: &x 1\nb: *x\n",
        &format!("tool: {}", "[".repeat(DEEP)),
        &format!("tool:\n  {}1\n", "- ".repeat(DEEP)),
    ];
    texts.map(|t| t.as_bytes().to_vec()).to_vec()
}

/// Programs as patchmill writes them.
pub fn programs(recorded: &[BagMessage]) -> Vec<Vec<u8>> {
    let chunks = recorded.iter().filter_map(|m| m.decode::<patchmill_msgs::msg::ProgramChunk>().ok());
    let start = |text: String| text.chars().take(4000).collect::<String>();
    let mut seeds: Vec<Vec<u8>> = chunks.take(2).map(|chunk| start(chunk.text).into_bytes()).collect();
    let square =
        "(a square)\nG21 G90 G54 G17 G40 G94\nG0 Z380\nG0 X0 Y0 Z380 A10 C20\nG1 X10 F6000\nY10\nX0\nM30\n";
    let inverse = "G21 G90 G93\nG0 X0 Y0 Z100 A0 C0\nG1 X1 A1 F20\nX2 C3 F30\nG94\nG1 X0 F100\nM30\n";
    seeds.extend([square, inverse].map(|t| t.as_bytes().to_vec()));
    seeds
}

/// Answers of `linuxcncrsh`.
pub fn linuxcnc() -> Vec<Vec<u8>> {
    let session = "HELLO ACK EMCNETSVR 1.1\r\nSET VERBOSE ACK\r\nSET ENABLE ACK\r\nPROGRAM_STATUS IDLE\r\n\
        ERROR OK\r\nJOINT_HOMED YES YES YES YES YES NO\r\nJOINT_POS 17.660900 -27.146200 -340.959900 12.008250 -73.274170 0.000000\r\n\
        PROGRAM_LINE 41\r\nSET RUN ACK\r\nSET OPEN NAK\r\nERROR Linear move on line 3 would exceed Z's limit\r\n";
    vec![session.as_bytes().to_vec()]
}

/// Words of the command line as typed.
pub fn options() -> Vec<Vec<u8>> {
    let texts = [
        "r1=13.05,r2=6,length=100",
        "r1=0,r2=6,length=100,flute=30,shank=16",
        "d=32..40,l=30;d=63,l=25",
        "normal=60",
        "normal=1,0,1,20",
        "z=-5..20",
        "facet=8,crease=15",
        "facets=/dev/zero",
        "plan surface.json --out /tmp/p --tool r1=1,r2=2 --holder d=3,l=4 --mount -90,-60,70,0,0,0 --select z=-5..20 --patches 2..8",
        "plan surface.json --out p --feed 2000 --scallop 0.02 --strategy five-axis --machine xyzbc --dialect siemens -p shadow:=exact",
        "compare surface.json --out p --stock 3,4,5 --lead-min 5",
        "replay bag --from path_generation --domain 7",
        "execute p --controller linuxcnc://localhost:5007",
        "plot p --what passes --out a.png",
        "bag repair b",
    ];
    texts.map(|t| t.as_bytes().to_vec()).to_vec()
}

/// MCAP files: compressed and checked as bags are, plain and without sums so that changes get through, and without an end.
pub fn bags(recorded: &[BagMessage]) -> Vec<Vec<u8>> {
    let mut topics = std::collections::BTreeMap::new();
    for message in recorded.iter().filter(|m| m.bytes.len() < 3000) {
        topics.entry(&message.topic).or_insert_with(Vec::new).push(message);
    }
    let few: Vec<&BagMessage> = topics.into_values().flat_map(|all| all.into_iter().take(2)).collect();
    let plain = mcap::WriteOptions::new()
        .compression(None)
        .calculate_chunk_crcs(false)
        .calculate_data_section_crc(false)
        .calculate_summary_section_crc(false);
    let zstd = mcap::WriteOptions::new().compression(Some(mcap::Compression::Zstd)).compression_threads(0);
    let mut seeds = Vec::new();
    for options in [plain.clone(), zstd, plain.use_chunks(false)] {
        let whole = bag(options, &few).unwrap_or_default();
        seeds.push(whole[..whole.len() / 2].to_vec());
        seeds.push(whole);
    }
    seeds
}

fn bag(options: mcap::WriteOptions, messages: &[&BagMessage]) -> mcap::McapResult<Vec<u8>> {
    let mut writer = options.profile("ros2").create(Cursor::new(Vec::new()))?;
    for (sequence, message) in messages.iter().enumerate() {
        let hash = patchmill_msgs::TYPE_HASHES.iter().find(|(name, _)| *name == message.type_name);
        let hash = hash.map(|(_, hash)| (*hash).to_owned()).unwrap_or_default();
        let schema = writer.add_schema(&message.type_name, "ros2msg", b"")?;
        let described = std::collections::BTreeMap::from([("topic_type_hash".to_owned(), hash)]);
        let channel_id = writer.add_channel(schema, &message.topic, "cdr", &described)?;
        let header = mcap::records::MessageHeader {
            channel_id,
            sequence: sequence as u32,
            log_time: message.time,
            publish_time: message.time,
        };
        writer.write_to_known_channel(&header, &message.bytes)?;
    }
    writer.finish()?;
    Ok(writer.into_inner().into_inner())
}
