//! Round trips, damage, sizes.

use nalgebra::{Matrix4, Point3, Vector3, Vector4};
use patchmill_geometry::mesh::TriangleMesh;
use patchmill_msgs::builtin_interfaces::msg::Time;
use patchmill_msgs::cdr::{from_cdr, to_cdr};
use proptest::prelude::*;

use super::chunked::{Assembly, Chunked, MAX_CHUNK_BYTES};
use super::{Provenance, WireError};
use crate::evaluation::{CandidateEvaluation, Evaluation, Proof, ProofSpot, ResidualMap, RestRegion};
use crate::field::RollingBallField;
use crate::job::{Job, LookAhead, Pattern, Placement};
use crate::partition::{Partition, PatchStatistics};
use crate::program::{JointMotion, PatchPlan, PatchProgram, Program};
use crate::samples::SurfaceSamples;
use crate::selection::{NormalCone, RestArea, Seed, Selection};
use crate::toolpath::{CandidateToolpath, Pass, PatchToolpath};

/// Numbers without end from a seed (splitmix64).
struct Numbers(u64);

impl Numbers {
    fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    fn below(&mut self, n: usize) -> usize {
        (self.bits() % n.max(1) as u64) as usize
    }

    /// In -1..1.
    fn number(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }

    fn list<T>(&mut self, count: usize, make: impl Fn(&mut Self) -> T) -> Vec<T> {
        (0..count).map(|_| make(self)).collect()
    }

    fn point(&mut self) -> Point3<f64> {
        Point3::new(self.number(), self.number(), self.number())
    }

    fn unit(&mut self) -> Vector3<f64> {
        Vector3::new(self.number(), self.number(), 1.0).normalize()
    }
}

fn mesh(vertices: usize, triangles: usize, seed: u64) -> TriangleMesh {
    let mut n = Numbers(seed);
    let triangles = if vertices == 0 { 0 } else { triangles };
    TriangleMesh {
        vertices: n.list(vertices, Numbers::point),
        normals: n.list(vertices, Numbers::unit),
        triangles: n.list(triangles, |n| [0; 3].map(|_| n.below(vertices) as u32)),
        chord_error: 5e-7,
        check_only: n.list(if seed % 2 == 1 { triangles } else { 0 }, |n| n.below(2) == 1),
    }
}

fn samples(rows: u32, columns: u32, seed: u64) -> SurfaceSamples {
    let mut n = Numbers(seed);
    let count = (rows * columns) as usize;
    SurfaceSamples {
        grid: (rows * columns > 0).then_some([rows, columns]),
        points: n.list(count, Numbers::point),
        normals: n.list(count, Numbers::unit),
        curvature_max: n.list(count, Numbers::number),
        curvature_min: n.list(count, Numbers::number),
        direction_max: n.list(count, Numbers::unit),
        area: n.list(count, |n| n.number().abs()),
    }
}

fn field(count: usize, seed: u64) -> RollingBallField {
    let mut n = Numbers(seed);
    RollingBallField {
        pseudo_curvature: n.list(count, Numbers::number),
        contact: n.list(count, Numbers::point),
        shadow_radius: 0.0321,
    }
}

fn residual_map(count: usize, seed: u64) -> ResidualMap {
    let mut n = Numbers(seed);
    ResidualMap { points: n.list(count, Numbers::point), leftover: n.list(count, Numbers::number) }
}

fn toolpath(patches: usize, passes: usize, longest: usize, seed: u64) -> CandidateToolpath {
    let mut n = Numbers(seed);
    let simultaneous = seed % 2 == 1;
    let pass = |n: &mut Numbers| {
        let points = n.below(longest + 1);
        Pass {
            cl: n.list(points, Numbers::point),
            cc: n.list(points, Numbers::point),
            tool_axes: if simultaneous { n.list(points, Numbers::unit) } else { Vec::new() },
            retract_height: n.number(),
        }
    };
    let patch = |n: &mut Numbers| PatchToolpath {
        patch: n.below(8) as u32,
        tool_axis: n.unit(),
        feed_direction: n.unit(),
        pseudo_curvature_max: n.number(),
        sample_count: n.below(2500) as u32,
        step_over: [1e-3, 2e-3],
        area: n.number().abs(),
        passes: n.list(passes, pass),
    };
    CandidateToolpath {
        index: 2,
        count: 8,
        patch_count: patches as u32,
        infeasible_reason: String::new(),
        patches: n.list(patches, patch),
        area_within_scallop: 0.9995,
        gouge_max: 1e-6,
    }
}

fn program(lines: usize, seed: u64) -> Program {
    let mut n = Numbers(seed);
    let plan = PatchPlan::from(&toolpath(1, 3, 5, seed).patches[0]);
    Program {
        text: (0..lines).map(|i| format!("N{i} G1 X{:.4} (é)\n", n.number())).collect(),
        block_count: lines as u32,
        candidate_index: 1,
        machining_time: 12.5,
        cut_length: 3.25,
        proof: Proof {
            gouge_max: 1e-6,
            scallop_max: 2e-5,
            scallop_p50: 1e-5,
            scallop_p90: 1.5e-5,
            scallop_p99: 1.8e-5,
            scallop_p999: 1.9e-5,
            area_within_scallop: 1.0,
            uncut_area: 0.0,
            deepest: n.list(2, |n| ProofSpot { position: n.point(), leftover: -n.number().abs() }),
            highest: n.list(5, |n| ProofSpot { position: n.point(), leftover: n.number().abs() }),
            rest_area: 3e-5,
            rest: n.list(3, |n| RestRegion {
                position: n.point(),
                bounds: [n.point(), n.point()],
                area: n.number().abs(),
                ball_radius: n.number().abs(),
                leftover_max: n.number().abs(),
            }),
        },
        patches: vec![PatchProgram {
            plan,
            rotary_names: ["a".into(), "c".into()],
            rotary_positions: [0.1, 0.2],
            machining_time: 12.0,
            cut_length: 3.0,
        }],
        machine_urdf: "<robot/>".into(),
    }
}

fn motion(points: usize, joints: usize, seed: u64) -> JointMotion {
    let mut n = Numbers(seed);
    JointMotion {
        joint_names: (0..joints).map(|i| format!("joint_{i}")).collect(),
        times: (0..points as u32).map(|i| f64::from(i / 7) + f64::from(i % 7 * 1_234_567) * 1e-9).collect(),
        positions: n.list(points * joints, Numbers::number),
        velocities: n.list(points * joints, Numbers::number),
    }
}

fn provenance_of<P: Chunked + 'static>() -> Provenance {
    let stamp = Time { sec: 1_700_000_000, nanosec: 999_999_999 };
    let job = Job::default_for(&"5".repeat(64)).with_id();
    let surface_only = [std::any::TypeId::of::<TriangleMesh>(), std::any::TypeId::of::<SurfaceSamples>()];
    if surface_only.contains(&std::any::TypeId::of::<P>()) {
        Provenance::of_surface(stamp, &job.surface_id)
    } else {
        job.provenance(stamp)
    }
}

/// Splits, sends the bytes in any order, some twice and some before the manifest, puts together.
fn travels<P: Chunked + PartialEq + std::fmt::Debug + 'static>(product: &P, seed: u64) {
    let (manifest, chunks) = product.split(&provenance_of::<P>()).unwrap();
    assert!(to_cdr(&manifest).len() <= MAX_CHUNK_BYTES);
    let mut wire: Vec<Vec<u8>> = chunks.iter().map(to_cdr).collect();
    for bytes in &wire {
        assert!(bytes.len() <= MAX_CHUNK_BYTES, "{} bytes", bytes.len());
    }
    let mut n = Numbers(seed);
    for _ in 0..n.below(4).min(wire.len()) {
        wire.push(wire[n.below(wire.len())].clone());
    }
    for at in (1..wire.len()).rev() {
        wire.swap(at, n.below(at + 1));
    }
    let mut assembly = Assembly::<P>::new(P::manifest_key(&manifest));
    let early = n.below(wire.len() + 1);
    for (at, bytes) in wire.iter().enumerate() {
        if at == early {
            assembly.add_manifest(from_cdr(&to_cdr(&manifest)).unwrap()).unwrap();
        }
        assert!(at + 1 > early || assembly.complete().is_none());
        let chunk = from_cdr::<P::Chunk>(bytes).unwrap();
        assert_eq!(P::chunk_key(&chunk), *assembly.key());
        assembly.add_chunk(chunk).unwrap();
    }
    assembly.add_manifest(manifest.clone()).unwrap();
    assert_eq!(assembly.missing(), Vec::<u32>::new());
    assert_eq!(&assembly.complete().unwrap().unwrap(), product);
    assert!(assembly.complete().is_none() && assembly.missing().is_empty());
    assert_eq!(assembly.progress(), Some((chunks.len() as u32, chunks.len() as u32)));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn mesh_travels(v in 0usize..9000, t in 0usize..30_000, seed: u64) {
        travels(&mesh(v, t, seed), seed);
    }

    #[test]
    fn samples_travel(rows in 0u32..70, columns in 0u32..70, seed: u64) {
        travels(&samples(rows, columns, seed), seed);
    }

    #[test]
    fn field_travels(count in 0usize..20_000, seed: u64) {
        travels(&field(count, seed), seed);
    }

    #[test]
    fn residual_map_travels(count in 0usize..20_000, seed: u64) {
        travels(&residual_map(count, seed), seed);
    }

    #[test]
    fn toolpath_travels(patches in 0usize..6, passes in 0usize..20, longest in 0usize..9000, seed: u64) {
        travels(&toolpath(patches, passes, longest, seed), seed);
    }

    #[test]
    fn many_short_passes_travel(passes in 0usize..6000, seed: u64) {
        travels(&toolpath(2, passes, 2, seed), seed);
    }

    #[test]
    fn program_travels(lines in 0usize..20_000, seed: u64) {
        travels(&program(lines, seed), seed);
    }

    #[test]
    fn motion_travels(points in 0usize..9000, joints in 1usize..32, seed: u64) {
        travels(&motion(points, joints, seed), seed);
    }

    /// Any bit of the bytes on the wire: the product does not come out changed.
    #[test]
    fn a_flipped_bit_is_never_taken_for_data(seed: u64) {
        let mut n = Numbers(seed);
        let product = toolpath(2, 2, 20, seed | 1);
        let (manifest, chunks) = product.split(&provenance_of::<CandidateToolpath>()).unwrap();
        prop_assume!(!chunks.is_empty());
        let mut bytes = to_cdr(&chunks[0]);
        let bit = n.below((bytes.len() - 4) * 8);
        bytes[4 + bit / 8] ^= 1 << (bit % 8);
        let mut assembly = Assembly::<CandidateToolpath>::new(CandidateToolpath::manifest_key(&manifest));
        assembly.add_manifest(manifest).unwrap();
        if let Ok(chunk) = from_cdr(&bytes)
            && assembly.add_chunk(chunk).is_ok()
            && let Some(Ok(came)) = assembly.complete()
        {
            // The bit was padding, or in a field that the manifest knows better.
            prop_assert_eq!(came, product);
        }
    }

    #[test]
    fn jobs_travel(seed: u64, lo in 1u8..=16, hi in 1u8..=16, one_way: bool, place in 0u8..3, urdf in "[ -~é]{0,40}") {
        let mut n = Numbers(seed);
        let placement = match place {
            0 => Placement::AsDescribed,
            1 => Placement::At { xyz: [n.number(), 0.0, -1.5], rpy: [0.1, -0.2, n.number()] },
            _ => Placement::Auto,
        };
        let job = Job {
            scallop_height: 1e-5 + n.number().abs() * 1e-4,
            feed: 0.01 + n.number().abs(),
            patches_min: lo.min(hi),
            patches_max: lo.max(hi),
            pattern: if one_way { Pattern::OneWay } else { Pattern::Zigzag },
            look_ahead: if one_way { LookAhead::LinearAxes } else { LookAhead::AllAxes },
            jerk_linear: 50.0 * n.number().abs(),
            block_time: 1e-3 * f64::from(place),
            rest_lead: if one_way { 0.5 } else { 0.0 },
            placement,
            machine_urdf: urdf,
            ..Job::default_for("surface")
        }
        .with_id();
        let msg = job.to_msg(Time { sec: 1, nanosec: 2 });
        prop_assert_eq!(Job::from_msg(&from_cdr(&to_cdr(&msg)).unwrap()).unwrap(), job.clone());
        prop_assert_eq!(job.clone().with_id().job_id, job.job_id.clone());
        let other = Job { feed: job.feed * 1.5, ..job.clone() }.with_id();
        prop_assert_ne!(other.job_id, job.job_id);
    }
}

#[test]
fn the_id_of_a_job_is_stable() {
    let job = Job::default_for("0123456789abcdef").with_id();
    assert_eq!(job.job_id.len(), 16);
    assert_eq!(job.job_id, "176de4a21cf6c0d7");
}

/// Takes a product apart, lets `damage` at it, and returns what the assembly says.
fn damaged<P: Chunked + 'static>(product: &P, damage: impl Fn(&mut P::Manifest, &mut P::Chunk)) -> WireError {
    let (mut manifest, mut chunks) = product.split(&provenance_of::<P>()).unwrap();
    damage(&mut manifest, &mut chunks[0]);
    let mut assembly = Assembly::<P>::new(P::manifest_key(&manifest));
    if let Err(error) = assembly.add_manifest(manifest) {
        return error;
    }
    let count = chunks.len() as u32;
    for chunk in chunks {
        if let Err(error) = assembly.add_chunk(chunk) {
            return error;
        }
    }
    let error = assembly.complete().unwrap().err().unwrap();
    assert_eq!(assembly.missing(), (0..count).collect::<Vec<_>>(), "everything is asked for again");
    error
}

#[test]
fn damage_is_named() {
    let says = |error: WireError, expected: &str| assert!(error.text.contains(expected), "{error}");
    let m = mesh(100, 200, 1);
    says(damaged(&m, |_, c| c.triangles[7].vertex_indices[1] = 100), "triangle 7 names the vertices");
    says(damaged(&m, |_, c| c.vertices[3].y += 1e-12), "as in the manifest");
    says(damaged(&m, |_, c| c.vertices[3].y = f64::NAN), "vertex 3");
    says(damaged(&m, |_, c| c.normals[4].x += 0.01), "normal 4 has length");
    says(damaged(&m, |_, c| c.normals[4].x = f64::NAN), "normal 4 has length NaN");
    says(damaged(&m, |_, c| c.normals.truncate(99)), "the number of normals is 99, 100 was expected");
    says(damaged(&m, |_, c| c.first_vertex = 5), "first vertex is 5, 0 was expected");
    says(damaged(&m, |_, c| c.index = 1), "a chunk's number is 1, less than 1");
    says(damaged(&m, |_, c| c.count = 2), "a chunk's count is 2");
    says(damaged(&m, |_, c| c.surface_id.push('x')), "was expected");
    says(damaged(&m, |h, _| h.vertex_count = u32::MAX), "at most 50000000");
    says(damaged(&m, |h, _| h.vertex_count = 101), "vertices in the chunks is 100, 101 was expected");
    says(damaged(&m, |h, _| h.chord_error = -1.0), "the chord error is -1");
    says(damaged(&m, |h, _| h.chunk_count = u32::MAX), "the number of chunks of a mesh");
    says(damaged(&m, |h, _| h.header.frame_id = "map".into()), "the frame 'map'");
    let s = samples(10, 10, 1);
    says(damaged(&s, |h, _| h.rows = 11), "the grid of 11 rows");
    says(damaged(&s, |_, c| c.area[5] = -1.0), "area 5 is -1");
    says(damaged(&s, |_, c| c.curvature_min.truncate(99)), "least curvatures is 99");
    let f = field(50, 1);
    says(damaged(&f, |_, c| c.pseudo_curvature[9] = f64::INFINITY), "pseudo-curvature 9 is inf");
    says(damaged(&f, |_, c| c.header.stamp.sec += 1), "was expected");
    let r = residual_map(50, 1);
    says(damaged(&r, |_, c| c.leftover[9] = f64::NAN), "leftover 9 is NaN");
    says(damaged(&r, |_, c| c.leftover.truncate(49)), "the number of leftovers is 49, 50 was expected");
    says(damaged(&r, |h, _| h.point_count = u32::MAX), "at most 10000000");
    let t = toolpath(2, 3, 30, 1);
    says(damaged(&t, |_, c| c.passes[0].patch = 2), "a pass's patch is 2, 0 to 1 was expected");
    says(damaged(&t, |_, c| c.passes[0].continued = true), "continues another one");
    says(damaged(&t, |h, _| h.patches[1].pass_count = 4), "in the chunks is 3, 4 was expected");
    says(damaged(&t, |_, c| c.candidate_index = 1), "was expected");
    let p = program(10, 1);
    says(damaged(&p, |_, c| c.text.replace_range(0..1, "M")), "the hash of what came");
    says(damaged(&p, |h, _| h.proof.uncut_area = 2.0), "uncut share is 2");
    says(damaged(&p, |h, _| h.proof.highest[0].position.y = f64::NAN), "a place of the proof 0");
    says(damaged(&p, |h, _| h.proof.deepest = vec![Default::default(); 17]), "deepest places is 17");
    let j = motion(10, 5, 1);
    says(damaged(&j, |_, c| c.trajectory.points[3].time_from_start.sec = -1), "the time of point 3");
    says(damaged(&j, |_, c| c.trajectory.joint_names.swap(0, 1)), "a chunk's joints");
    assert!(mesh(3, 0, 1).split(&provenance_of::<TriangleMesh>()).is_ok());
    let broken = TriangleMesh { triangles: vec![[0, 1, 3]], ..mesh(3, 0, 1) };
    says(broken.split(&provenance_of::<TriangleMesh>()).err().unwrap(), "triangle 0");
}

#[test]
fn a_new_manifest_starts_anew() {
    let provenance = provenance_of::<TriangleMesh>();
    let (old, old_chunks) = mesh(5000, 10, 1).split(&provenance).unwrap();
    let new_mesh = mesh(100, 10, 2);
    let (new, new_chunks) = new_mesh.split(&provenance).unwrap();
    let mut assembly = Assembly::<TriangleMesh>::new(TriangleMesh::manifest_key(&old));
    assembly.add_manifest(old).unwrap();
    assembly.add_chunk(old_chunks[1].clone()).unwrap();
    let others: Vec<u32> = (0..old_chunks.len() as u32).filter(|i| *i != 1).collect();
    assert!(!others.is_empty());
    assert_eq!(assembly.missing(), others);
    assembly.add_manifest(new).unwrap();
    assert_eq!(assembly.missing(), vec![0]);
    assembly.add_chunk(new_chunks[0].clone()).unwrap();
    assert_eq!(assembly.complete().unwrap().unwrap(), new_mesh);
}

fn partition() -> Partition {
    let patch = PatchStatistics {
        mean: Vector4::new(0.1, 0.2, 0.3, 0.4),
        covariance: Matrix4::from_fn(|i, j| 1.0 / (1 + i + j) as f64),
        sample_count: 3,
        parts: vec![2, 1],
    };
    Partition {
        index: 1,
        count: 3,
        feature_mean: Vector4::new(1.0, 2.0, 3.0, 4.0),
        feature_scale: Vector4::new(1.0, 2.0, 3.0, 4.0),
        labels: vec![0, 1, 1, 0, 1],
        patches: vec![patch.clone(), patch],
        inertia: 1.5,
    }
}

#[test]
fn partitions_travel_and_wrong_ones_are_refused() {
    let provenance = provenance_of::<RollingBallField>();
    let msg = partition().to_msg(&provenance).unwrap();
    let came = Partition::from_msg(&from_cdr(&to_cdr(&msg)).unwrap()).unwrap();
    assert_eq!(came, (provenance.clone(), partition()));
    type Damage = fn(&mut Partition);
    let damages: [Damage; 7] = [
        |p| p.labels[2] = 2,
        |p| p.index = 3,
        |p| p.feature_scale[1] = 0.0,
        |p| p.patches.clear(),
        |p| p.patches[0].mean[0] = f64::NAN,
        |p| p.patches[1].covariance[(0, 1)] += 0.1,
        |p| p.inertia = f64::INFINITY,
    ];
    for damage in damages {
        let mut broken = partition();
        damage(&mut broken);
        assert!(broken.to_msg(&provenance).is_err());
    }
}

#[test]
fn evaluations_travel_and_wrong_ones_are_refused() {
    let provenance = provenance_of::<RollingBallField>();
    let candidate = |index, feasible| CandidateEvaluation {
        index,
        patch_count: index + 1,
        feasible,
        reason: if feasible { String::new() } else { "the tool does not reach".into() },
        machining_time: 5.0,
        cut_length: 1.0,
        rapid_length: 0.5,
        index_moves: index,
    };
    let evaluation =
        Evaluation { candidates: vec![candidate(0, false), candidate(1, true)], chosen: Some(1) };
    let msg = evaluation.to_msg(&provenance).unwrap();
    assert_eq!(Evaluation::from_msg(&msg).unwrap(), (provenance.clone(), evaluation.clone()));
    let none = Evaluation { chosen: None, ..evaluation.clone() };
    let msg = none.to_msg(&provenance).unwrap();
    assert_eq!((msg.chosen, Evaluation::from_msg(&msg).unwrap().1), (-1, none));
    for chosen in [0, 2] {
        assert!(Evaluation { chosen: Some(chosen), ..evaluation.clone() }.to_msg(&provenance).is_err());
    }
    let swapped = Evaluation { candidates: vec![candidate(1, true), candidate(0, false)], chosen: None };
    assert!(swapped.to_msg(&provenance).is_err());
}

fn section(length: f64, radius_low: f64, radius_high: f64) -> patchmill_msgs::msg::HolderSection {
    patchmill_msgs::msg::HolderSection { length, radius_low, radius_high }
}

#[test]
fn a_tool_assembly_travels_with_its_job_and_changes_its_id() {
    use crate::job::{HolderSection, Tool};
    let bare = Job::default_for("s").with_id();
    let holder = vec![
        HolderSection { length: 0.03, radius_low: 0.016, radius_high: 0.02 },
        HolderSection { length: 0.025, radius_low: 0.0315, radius_high: 0.0315 },
    ];
    let tool = Tool { flute_length: 0.03, shank_radius: 0.016, holder, ..bare.tool.clone() };
    let held = Job { tool, ..bare.clone() }.with_id();
    assert_ne!(held.job_id, bare.job_id);
    assert_eq!(Job::from_msg(&held.to_msg(Time::default())).unwrap(), held);
}

#[test]
fn wrong_jobs_are_refused_with_the_value_and_the_range() {
    let good = Job::default_for("s").to_msg(Time::default());
    assert!(Job::from_msg(&good).is_ok());
    type Damage = fn(&mut patchmill_msgs::msg::Job);
    let cases: [(Damage, &str); 32] = [
        (|j| j.tool.r1 = -0.001, "tool r1 is -1 mm"),
        (|j| j.tool.r2 = f64::NAN, "tool r2 is NaN mm"),
        (|j| (j.tool.r1, j.tool.r2) = (0.0, 0.0), "r1 + r2 is 0 mm"),
        (|j| j.tool.length = 0.0, "the tool's length"),
        (|j| j.tool.flute_length = 0.005, "the tool's flute_length is 5 mm, 6 mm to 100 mm"),
        (|j| j.tool.shank_radius = 0.01, "without a flute_length, shank_radius is 10 mm"),
        (|j| j.tool.holder = vec![section(0.02, 0.03, 0.0)], "the high radius of holder section 1 is 0 mm"),
        (
            |j| j.tool.holder = vec![section(0.06, 0.03, 0.03); 2],
            "together is 126.000000 mm, at most the tool's",
        ),
        (|j| j.tool.holder = vec![section(0.001, 0.03, 0.03); 33], "holder sections is 33, at most 32"),
        (|j| j.scallop_height = 0.0, "scallop_height is 0 mm"),
        (|j| j.gouge_tolerance = f64::INFINITY, "gouge_tolerance"),
        (|j| j.gouge_tolerance = 1e-8, "gouge_tolerance is 1e-5 mm, 0.0001 mm to 10 mm was expected"),
        (|j| j.feed = 0.0, "feed is 0 mm/min, 0.01 to 600000 mm/min was expected"),
        (|j| j.feed = f64::NAN, "feed is NaN mm/min"),
        (|j| j.spindle_speed = 0.01, "spindle_speed is 0.095493 rpm, 1 to 950000 rpm was expected"),
        (|j| j.spindle_speed = 1e300, "spindle_speed is 9.5493e300 rpm"),
        (|j| j.path_tolerance = 1e-10, "path_tolerance is 1e-7 mm, 1e-5 mm to 1 mm was expected"),
        (|j| j.lead_min = 1.5, "lead_min is 85.944 degrees, 0.000 to 75.000 degrees was expected"),
        (|j| j.inclination_max = 1.6, "inclination_max"),
        (|j| (j.patches_min, j.patches_max) = (5, 4), "the range of patches is 5..4, a range within 1..16"),
        (|j| j.patches_min = 0, "0..8"),
        (|j| j.patches_max = 17, "1..17"),
        (|j| j.pattern = 3, "pattern 3 is unknown"),
        (|j| j.strategy = 9, "strategy 9 is unknown"),
        (|j| j.strategy = 1, "the range of patches is 1..8, 1..1 with a strategy of one patch"),
        (|j| j.look_ahead = 2, "look_ahead 2 is unknown"),
        (|j| j.jerk_rotary = -1.0, "jerk_rotary [rad/s^3]"),
        (|j| j.block_time = f64::NAN, "block_time [s]"),
        (|j| j.lead_radius = 0.2, "lead_radius is 200 mm, 0 mm to 100 mm"),
        (|j| j.border_margin = -0.001, "border_margin is -1 mm"),
        (|j| j.rest_lead = 1.4, "rest_lead is 80.214 degrees, 5.000 to 75.000 degrees was expected"),
        (|j| j.job_id = "abc".into(), "job_id is abc"),
    ];
    for (damage, expected) in cases {
        let mut bad = good.clone();
        damage(&mut bad);
        let error = Job::from_msg(&bad).unwrap_err();
        assert!(error.text.contains(expected), "{error}");
    }
    assert_eq!(WireError::new("x").with_code(401).code, 401);
}

#[test]
fn selections_travel_and_bad_ones_are_named() {
    let all = Selection {
        cone: Some(NormalCone { axis: Vector3::z_axis(), angle: 1.0 }),
        band: Some([-0.01, 0.02]),
        facets: vec![[0, 5], [7, 7]],
        seed: Some(Seed { facet: 3, crease: 0.5 }),
        rest: Some(RestArea {
            surface_id: "ab".into(),
            cell: 1e-3,
            overlap: 5e-4,
            cells: vec![[-7, 0, 2], [3, -4, 5]],
        }),
    };
    for selection in
        [Selection::default(), Selection { band: None, ..all.clone() }, all.without_rest(), all.clone()]
    {
        assert_eq!(Selection::from_msg(&selection.to_msg()).unwrap(), selection);
    }
    let refused = |damage: &dyn Fn(&mut patchmill_msgs::msg::Selection), expected: &str| {
        let mut msg = all.to_msg();
        damage(&mut msg);
        let error = Selection::from_msg(&msg).unwrap_err();
        assert!(error.text.contains(expected), "{error}");
    };
    refused(&|m| m.normal.z = 0.5, "length 0.5");
    refused(&|m| m.normal_angle = f64::NAN, "cone");
    refused(&|m| m.z_max = -0.02, "-20 mm");
    refused(&|m| m.facets.push(9), "pairs");
    refused(&|m| m.facets[1] = u32::MAX, "facets");
    refused(&|m| m.facets[0] = 6, "facets");
    refused(&|m| m.crease = 4.0, "crease");
    refused(&|m| m.rest_cell = 0.0, "rest_cell");
    refused(&|m| m.rest_overlap = f64::NAN, "rest_overlap");
    refused(&|m| m.rest_cells.truncate(5), "three numbers");
    refused(&|m| m.rest_cells.clear(), "number of rest cells");
    refused(&|m| m.rest_cells[0] = 4, "ascending");
}
