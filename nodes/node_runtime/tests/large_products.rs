//! A 10 MB and a 50 MB mesh between processes: to a reader that is there, and to one that comes late.

#![allow(clippy::unwrap_used, clippy::print_stdout)]

use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use nalgebra::{Point3, Vector3};
use patchmill_geometry::mesh::TriangleMesh;
use patchmill_msgs::msg::MeshChunk;
use patchmill_node_runtime::arguments::{NodeOptions, Override};
use patchmill_node_runtime::{
    LargeProduct, Node, ParameterSet, ProductReceiver, ProductServer, Qos, Received, Value, block_on,
    free_domain,
};
use patchmill_products::wire::{Chunked, Provenance};

const PEER: &str = "PATCHMILL_TEST_PEER_DOMAIN";

/// A grid of n × n vertices: 72 bytes a vertex.
fn grid(n: u32) -> TriangleMesh {
    let index = |row: u32, column: u32| row * n + column;
    let vertices =
        (0..n * n).map(|i| Point3::new(f64::from(i % n), f64::from(i / n), f64::from(i % 7))).collect();
    let triangles = (0..n - 1)
        .flat_map(|r| (0..n - 1).map(move |c| (r, c)))
        .flat_map(|(r, c)| {
            [
                [index(r, c), index(r, c + 1), index(r + 1, c)],
                [index(r + 1, c), index(r, c + 1), index(r + 1, c + 1)],
            ]
        })
        .collect();
    let normals = vec![Vector3::z(); (n * n) as usize];
    TriangleMesh { vertices, normals, triangles, chord_error: 1e-6, check_only: Vec::new() }
}

/// Not a test by itself: the other process, started by the tests below. Prints the hash of the mesh that it gets.
#[test]
fn peer_process() {
    let Ok(domain) = std::env::var(PEER) else { return };
    block_on(async {
        let node = Node::start(NodeOptions::local("peer", domain.parse().unwrap())).unwrap();
        let mut meshes = ProductReceiver::<TriangleMesh>::new(&node).unwrap();
        match meshes.next().await {
            Some(Received::Product { product, .. }) => println!("got {}", product.content_hash()),
            Some(Received::Failed { text, .. }) => println!("failed {text}"),
            None => println!("stopped"),
        }
        node.shutdown().await;
    })
    .unwrap();
}

fn start_peer(domain: u16) -> Child {
    Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "peer_process", "--nocapture"])
        .env(PEER, domain.to_string())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap()
}

fn said(peer: Child) -> String {
    let output = peer.wait_with_output().unwrap();
    String::from_utf8_lossy(&output.stdout).into_owned()
}

fn arrives_whole(n: u32) {
    let lease = free_domain().unwrap();
    let mesh = grid(n);
    let hash = mesh.content_hash();
    block_on(async {
        let node = Node::start(NodeOptions::local("sender", lease.domain())).unwrap();
        let server = ProductServer::<TriangleMesh>::new(&node).unwrap();
        let early = start_peer(lease.domain());
        assert!(server.wait_for_receivers(1, Duration::from_secs(60)).await, "the peer did not come");

        let started = Instant::now();
        let provenance = Provenance::of_surface(patchmill_node_runtime::status::now(), "grid");
        let sent = server.publish(&mesh, &provenance).await.unwrap();
        let published = started.elapsed();
        let early = tokio::task::spawn_blocking(move || said(early)).await.unwrap();
        let arrived = started.elapsed();
        assert!(early.contains(&format!("got {hash}")), "{early}");

        let started = Instant::now();
        let late = start_peer(lease.domain());
        let late = tokio::task::spawn_blocking(move || said(late)).await.unwrap();
        assert!(late.contains(&format!("got {hash}")), "{late}");
        println!(
            "{} vertices: {sent} chunks published in {published:.2?}, whole at the peer's end after {arrived:.2?}; \
             late joiner, process start to end: {:.2?}",
            mesh.vertices.len(),
            started.elapsed()
        );
        node.shutdown().await;
    })
    .unwrap();
}

#[test]
fn ten_megabytes_arrive_whole() {
    arrives_whole(380);
}

#[test]
fn fifty_megabytes_arrive_whole() {
    arrives_whole(840);
}

#[test]
fn stray_chunks_do_not_keep_a_product_from_coming() {
    let lease = free_domain().unwrap();
    block_on(async {
        let [sender, receiver] =
            ["sender", "receiver"].map(|name| Node::start(NodeOptions::local(name, lease.domain())).unwrap());
        let server = ProductServer::<TriangleMesh>::new(&sender).unwrap();
        let strays = sender.publisher::<MeshChunk>(TriangleMesh::CHUNK_TOPIC, Qos::Chunks).unwrap();
        let mut meshes = ProductReceiver::<TriangleMesh>::new(&receiver).unwrap();
        let patience = Duration::from_secs(60);
        assert!(server.wait_for_receivers(1, patience).await, "the receiver did not come");
        assert!(strays.wait_for_subscriptions(1, patience).await, "the receiver did not come");

        let mesh = grid(60);
        let provenance = Provenance::of_surface(patchmill_node_runtime::status::now(), "grid");
        for mut chunk in mesh.split(&provenance).unwrap().1 {
            chunk.count += 1;
            strays.publish(chunk).unwrap();
        }
        server.publish(&mesh, &provenance).await.unwrap();
        match meshes.next().await.unwrap() {
            Received::Product { product, .. } => assert_eq!(product.content_hash(), mesh.content_hash()),
            Received::Failed { text, .. } => panic!("{text}"),
        }
        for node in [sender, receiver] {
            node.shutdown().await;
        }
    })
    .unwrap();
}

#[test]
fn a_product_of_more_chunks_than_the_receiver_takes_is_refused_by_name() {
    let lease = free_domain().unwrap();
    let limit = |most| {
        let mut options =
            NodeOptions::local("receiver", lease.domain()).with_parameters(ParameterSet::new().max_chunks());
        let (name, value) = ("max_chunks".to_owned(), Value::Integer(most));
        options.arguments.overrides.push(Override { node: None, name, value, strict: true });
        options
    };
    block_on(async {
        let sender = Node::start(NodeOptions::local("sender", lease.domain())).unwrap();
        let server = ProductServer::<TriangleMesh>::new(&sender).unwrap();
        let receiver = Node::start(limit(2)).unwrap();
        let mut meshes = ProductReceiver::<TriangleMesh>::new(&receiver).unwrap();
        assert!(server.wait_for_receivers(1, Duration::from_secs(60)).await, "the receiver did not come");

        // What is refused is not in the way of what comes next.
        for (n, most) in [(60, None), (30, Some(2))] {
            let provenance = Provenance::of_surface(patchmill_node_runtime::status::now(), "grid");
            let sent = server.publish(&grid(n), &provenance).await.unwrap();
            match (meshes.next().await.unwrap(), most) {
                (Received::Failed { text, .. }, None) => {
                    assert_eq!(text, format!("it has {sent} chunks: at most 2 (max_chunks) are taken"));
                }
                (Received::Product { product, .. }, Some(most)) => {
                    assert!(sent <= most && product.vertices.len() == 900, "{sent}");
                }
                (Received::Failed { text, .. }, Some(_)) => panic!("{text}"),
                (Received::Product { .. }, None) => panic!("{sent} chunks were taken"),
            }
        }
        for node in [sender, receiver] {
            node.shutdown().await;
        }
    })
    .unwrap();
}
