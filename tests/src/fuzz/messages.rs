//! Every message type as raw CDR bytes, and the checks behind them.

use nalgebra::{Point3, Vector3};
use patchmill_bag_recorder::{BagMessage, BagReader};
use patchmill_geometry::mesh::TriangleMesh;
use patchmill_msgs::builtin_interfaces::msg::Time;
use patchmill_msgs::cdr::{from_cdr, to_cdr};
use patchmill_msgs::{RosType, for_every_message, msg, sensor_msgs};
use patchmill_node_runtime::LargeProduct;
use patchmill_products::evaluation::{Evaluation, ResidualMap};
use patchmill_products::field::RollingBallField;
use patchmill_products::job::Job;
use patchmill_products::partition::Partition;
use patchmill_products::program::{JointMotion, Program};
use patchmill_products::samples::SurfaceSamples;
use patchmill_products::toolpath::CandidateToolpath;
use patchmill_products::wire::{Assembly, Chunked, Provenance};
use patchmill_surface_ingestion::point_cloud2::{PointCloud2, PointField, points};
use patchmill_surface_ingestion::raw::Limits;

use super::Parser;
use super::mutate::Random;
use super::random_message::random_message;

/// Random messages of each type beside the recorded ones.
const RANDOM: u64 = 24;
/// Longest recorded message or product that is a seed, bytes.
const LONGEST: usize = 1 << 16;

/// Every message type, `recorded` among the seeds.
pub fn every_message(recorded: &[BagMessage]) -> Vec<Parser> {
    let mut parsers = Vec::new();
    macro_rules! add {
        ($name:literal, $path:path, [$($constant:ident),*]) => {
            parsers.push(Parser::new($name, seeds_of::<$path>(recorded), |bytes| {
                reads::<$path>(bytes).is_some()
            }));
        };
    }
    for_every_message!(add);
    parsers
}

/// Seeds of a type: the default, random ones and what was recorded.
fn seeds_of<T: RosType>(recorded: &[BagMessage]) -> Vec<Vec<u8>> {
    let random = |number| random_message::<T>(&mut Random::of(1, number));
    let invented = std::iter::once(T::default()).chain((0..RANDOM).filter_map(random));
    let own = recorded.iter().filter(|m| m.type_name == T::TYPE_NAME && m.bytes.len() <= LONGEST);
    invented.map(|m| to_cdr(&m)).chain(own.take(8).map(|m| m.bytes.clone())).collect()
}

/// The message of these bytes; what is read, written and read again gives the same bytes.
fn reads<T: RosType>(bytes: &[u8]) -> Option<T> {
    let message = from_cdr::<T>(bytes).ok()?;
    let written = to_cdr(&message);
    let again = from_cdr::<T>(&written).map(|m| to_cdr(&m));
    assert_eq!(again.as_ref(), Ok(&written), "{} is read otherwise than it is written", T::TYPE_NAME);
    Some(message)
}

/// What the nodes make of messages: jobs, partitions, evaluations, clouds and the products in chunks.
pub fn checked_messages(recorded: &[BagMessage]) -> Vec<Parser> {
    vec![
        Parser::new("job", seeds_of::<msg::Job>(recorded), |bytes| {
            reads::<msg::Job>(bytes).is_some_and(|m| Job::from_msg(&m).is_ok())
        }),
        Parser::new("partition", seeds_of::<msg::PartitionCandidate>(recorded), |bytes| {
            reads::<msg::PartitionCandidate>(bytes).is_some_and(|m| Partition::from_msg(&m).is_ok())
        }),
        Parser::new("evaluation", seeds_of::<msg::Evaluation>(recorded), |bytes| {
            reads::<msg::Evaluation>(bytes).is_some_and(|m| Evaluation::from_msg(&m).is_ok())
        }),
        Parser::new("point_cloud2", cloud_seeds(), |bytes| {
            reads::<sensor_msgs::msg::PointCloud2>(bytes).is_some_and(|m| cloud_is_read(&m))
        }),
        product("mesh", recorded, Some(small_mesh())),
        product::<SurfaceSamples>("samples", recorded, None),
        product::<RollingBallField>("field", recorded, None),
        product::<CandidateToolpath>("toolpath", recorded, None),
        product::<Program>("program", recorded, None),
        product::<JointMotion>("joint_motion", recorded, None),
        product("residual_map", recorded, Some(small_map())),
    ]
}

fn cloud_seeds() -> Vec<Vec<u8>> {
    let field = |name: &str, offset| sensor_msgs::msg::PointField {
        name: name.to_owned(),
        offset,
        datatype: 7,
        count: 1,
    };
    let data: Vec<u8> = (0..12).flat_map(|i| (i as f32).to_le_bytes()).collect();
    let cloud = sensor_msgs::msg::PointCloud2 {
        height: 2,
        width: 2,
        fields: vec![field("x", 0), field("y", 4), field("z", 8)],
        point_step: 12,
        row_step: 24,
        data,
        ..sensor_msgs::msg::PointCloud2::default()
    };
    vec![to_cdr(&cloud)]
}

fn cloud_is_read(message: &sensor_msgs::msg::PointCloud2) -> bool {
    let field = |f: &'_ sensor_msgs::msg::PointField| (f.offset, f.datatype, f.count);
    let fields: Vec<PointField<'_>> = message
        .fields
        .iter()
        .map(|f| (f, field(f)))
        .map(|(f, (offset, datatype, count))| PointField { name: &f.name, offset, datatype, count })
        .collect();
    let cloud = PointCloud2 {
        height: message.height,
        width: message.width,
        fields: &fields,
        is_bigendian: message.is_bigendian,
        point_step: message.point_step,
        row_step: message.row_step,
        data: &message.data,
    };
    points(&cloud, &Limits { triangles: 8_000_000, points: 4_000_000 }).is_ok()
}

/// Two facets: the recorded mesh is too large for a seed.
fn small_mesh() -> TriangleMesh {
    let vertices = [[0.0, 0.0, 0.0], [0.01, 0.0, 0.0], [0.01, 0.01, 0.0], [0.0, 0.01, 0.0]].map(Point3::from);
    TriangleMesh {
        vertices: vertices.to_vec(),
        normals: vec![Vector3::z(); 4],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        chord_error: 1e-6,
        check_only: vec![false, true],
    }
}

fn small_map() -> ResidualMap {
    ResidualMap { points: small_mesh().vertices, leftover: vec![0.0, 1e-5, 2e-5, -1e-6] }
}

/// A product in chunks: an input is the manifest and the chunks, each after its length.
fn product<P: LargeProduct>(name: &str, recorded: &[BagMessage], small: Option<P>) -> Parser {
    let mut seeds = product_seeds::<P>(recorded);
    seeds.extend(small.and_then(|product| parts(&product)));
    Parser::new(name, seeds, |bytes| {
        let mut parts = parts_of(bytes).into_iter();
        let Some(manifest) = parts.next().and_then(|part| from_cdr::<P::Manifest>(part).ok()) else {
            return false;
        };
        let mut assembly = Assembly::<P>::new(P::manifest_key(&manifest));
        let taken = assembly.add_manifest(manifest).is_ok();
        for chunk in parts.filter_map(|part| from_cdr::<P::Chunk>(part).ok()) {
            // A refused chunk leaves the assembly as it was.
            let _ = assembly.add_chunk(chunk);
        }
        let _ = (assembly.missing(), assembly.progress());
        taken && assembly.complete().is_some_and(|product| product.is_ok())
    })
}

fn parts_of(mut bytes: &[u8]) -> Vec<&[u8]> {
    let mut parts = Vec::new();
    while let Some((length, rest)) = bytes.split_first_chunk::<4>() {
        let (part, rest) = rest.split_at((u32::from_le_bytes(*length) as usize).min(rest.len()));
        parts.push(part);
        bytes = rest;
    }
    parts
}

/// A product as an input; none when it is not valid.
fn parts<P: LargeProduct>(product: &P) -> Option<Vec<u8>> {
    let job = Job { job_id: "0123456789abcdef".to_owned(), ..Job::default_for("surface") };
    let surface = Provenance::of_surface(Time::default(), "surface");
    let of_job = Provenance::of_job(Time::default(), &job);
    // What depends on the surface alone has no job.
    let own = if P::WHAT == TriangleMesh::WHAT { surface } else { of_job };
    let (manifest, chunks) = product.split(&own).ok()?;
    let parts: Vec<Vec<u8>> = std::iter::once(to_cdr(&manifest)).chain(chunks.iter().map(to_cdr)).collect();
    Some(joined(&parts))
}

fn joined(parts: &[Vec<u8>]) -> Vec<u8> {
    parts.iter().flat_map(|part| [&(part.len() as u32).to_le_bytes(), part.as_slice()].concat()).collect()
}

/// The recorded products that are short enough, and random manifests and chunks of one another.
fn product_seeds<P: LargeProduct>(recorded: &[BagMessage]) -> Vec<Vec<u8>> {
    let of = |type_name: &str| recorded.iter().filter(move |m| m.type_name == type_name).collect::<Vec<_>>();
    let chunks = of(P::Chunk::TYPE_NAME);
    let mut seeds = Vec::new();
    for manifest in of(P::Manifest::TYPE_NAME) {
        let Ok(read) = manifest.decode::<P::Manifest>() else { continue };
        let key = P::manifest_key(&read);
        let own = chunks.iter().filter(|c| c.decode::<P::Chunk>().is_ok_and(|c| P::chunk_key(&c) == key));
        let mut parts = vec![manifest.bytes.clone()];
        parts.extend(own.map(|c| c.bytes.clone()));
        let whole = joined(&parts);
        seeds.extend((whole.len() <= 4 * LONGEST).then_some(whole));
    }
    for number in 0..RANDOM {
        let random = &mut Random::of(2, number);
        if let (Some(manifest), Some(chunk)) =
            (random_message::<P::Manifest>(random), random_message::<P::Chunk>(random))
        {
            seeds.push(joined(&[to_cdr(&manifest), to_cdr(&chunk)]));
        }
    }
    seeds
}

/// The messages of the golden bag.
///
/// # Errors
/// When it cannot be read.
pub fn recorded() -> Result<Vec<BagMessage>, patchmill_bag_recorder::BagError> {
    BagReader::open(&crate::golden::golden_bag())?.messages()
}
