//! What is published comes back from the bag: small messages and a chunked product, also with a late recorder.

#![allow(clippy::unwrap_used)]

use std::time::Duration;

use nalgebra::{Point3, Vector3};
use patchmill_bag_recorder::{BagReader, BagWriter, Recorder, RecorderOptions, Topic};
use patchmill_geometry::mesh::TriangleMesh;
use patchmill_msgs::msg::{Job, MeshChunk, MeshManifest};
use patchmill_node_runtime::arguments::NodeOptions;
use patchmill_node_runtime::{Node, ProductServer, Qos, block_on, free_domain, status, topics};
use patchmill_products::wire::{Assembly, Chunked, Provenance};

fn strip(n: u32) -> TriangleMesh {
    let vertices = (0..n).map(|i| Point3::new(f64::from(i), f64::from(i % 2), 0.0)).collect();
    let triangles = (0..n - 2).map(|i| [i, i + 1, i + 2]).collect();
    TriangleMesh {
        vertices,
        normals: vec![Vector3::z(); n as usize],
        triangles,
        chord_error: 0.0,
        check_only: Vec::new(),
    }
}

#[test]
fn a_written_bag_reads_back_in_order() {
    let root = tempfile::tempdir().unwrap();
    let directory = root.path().join("bag");
    let mut bag = BagWriter::create(&directory).unwrap();
    let topic = Topic::of::<Job>("/patchmill/job", Qos::Status);
    for (time, id) in [(5, "a"), (9, "b"), (7, "c")] {
        bag.write(&topic, time, &Job { job_id: id.to_owned(), ..Job::default() }).unwrap();
    }
    let summary = bag.finish().unwrap();
    assert_eq!((summary.start, summary.duration, summary.message_count), (5, 4, 3));
    let messages = BagReader::open(&directory).unwrap().messages().unwrap();
    assert_eq!(messages.iter().map(|m| m.time).collect::<Vec<_>>(), [5, 9, 9]);
    let ids: Vec<String> = messages.iter().map(|m| m.decode::<Job>().unwrap().job_id).collect();
    assert_eq!(ids, ["a", "b", "c"]);
    assert!(messages[0].decode::<MeshChunk>().is_err());
    assert!(BagWriter::create(&directory).is_err());
}

#[test]
fn a_run_is_recorded_whole() {
    let lease = free_domain().unwrap();
    // PATCHMILL_TEST_BAG keeps the bag for a look with other tools.
    let root = tempfile::tempdir().unwrap();
    let directory = std::env::var_os("PATCHMILL_TEST_BAG")
        .map_or_else(|| root.path().join("run"), std::path::PathBuf::from);
    let mesh = strip(40_000);
    block_on(async {
        let node = Node::start(NodeOptions::local("sender", lease.domain())).unwrap();
        let server = ProductServer::<TriangleMesh>::new(&node).unwrap();
        let jobs = node.publisher::<Job>(topics::JOB, Qos::Status).unwrap();
        jobs.publish(Job { job_id: "j".to_owned(), ..Job::default() }).unwrap();
        // Published before the recorder is there: manifest latched, chunks by the service.
        server.publish(&mesh, &Provenance::of_surface(status::now(), "s")).await.unwrap();
        let recorder_node = Node::start(NodeOptions::local("bag_recorder", lease.domain())).unwrap();
        let recorder = Recorder::on(recorder_node, &directory, RecorderOptions::default()).unwrap();
        assert!(jobs.wait_for_subscriptions(1, Duration::from_secs(20)).await);
        while recorder.received() < 3 {
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
        let summary = recorder.finish().await.unwrap();
        assert!(summary.message_count >= 3, "{summary:?}");
        node.shutdown().await;
    })
    .unwrap();

    let bag = BagReader::open(&directory).unwrap();
    assert_eq!(bag.decoded::<Job>("/patchmill/job").unwrap()[0].job_id, "j");
    let manifests = bag.decoded::<MeshManifest>("/patchmill/surface/mesh").unwrap();
    let chunks = bag.decoded::<MeshChunk>("/patchmill/surface/mesh/chunks").unwrap();
    assert_eq!(chunks.len(), manifests[0].chunk_count as usize);
    let mut assembly = Assembly::<TriangleMesh>::new(TriangleMesh::manifest_key(&manifests[0]));
    assembly.add_manifest(manifests[0].clone()).unwrap();
    chunks.into_iter().for_each(|chunk| assembly.add_chunk(chunk).unwrap());
    assert_eq!(assembly.complete().unwrap().unwrap(), mesh);
}
