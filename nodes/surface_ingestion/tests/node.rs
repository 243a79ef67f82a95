//! The node over DDS: a surface loaded, its products received, a missing file refused, a repeated call idempotent; clouds of a topic.

#![allow(clippy::unwrap_used)]

use std::path::Path;
use std::time::Duration;

use patchmill_geometry::mesh::TriangleMesh;
use patchmill_msgs::sensor_msgs::msg::{PointCloud2, PointField};
use patchmill_msgs::srv::{LoadSurface, LoadSurfaceRequest, LoadSurfaceResponse};
use patchmill_node_runtime::arguments::{NodeOptions, Override};
use patchmill_node_runtime::{Node, ProductReceiver, Qos, Received, Value, block_on, free_domain, topics};
use patchmill_products::samples::SurfaceSamples;
use patchmill_surface_ingestion::{error_code, node};

const PATIENCE: Duration = Duration::from_secs(60);

#[test]
fn loads_a_surface_and_refuses_a_missing_file() {
    let lease = free_domain().unwrap();
    let fixtures = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures");
    block_on(async {
        let mut options =
            NodeOptions::local("surface_ingestion", lease.domain()).with_parameters(node::parameters());
        options.arguments.overrides.push(Override {
            node: None,
            name: "surface_directory".to_owned(),
            value: Value::Text(fixtures.to_string_lossy().into_owned()),
            strict: true,
        });
        let ingestion = node::start(options).unwrap();
        let user = Node::start(NodeOptions::local("user", lease.domain())).unwrap();
        let mut meshes = ProductReceiver::<TriangleMesh>::new(&user).unwrap();
        let mut samples = ProductReceiver::<SurfaceSamples>::new(&user).unwrap();
        let client = user.service_client::<LoadSurface>(topics::LOAD_SURFACE).unwrap();
        let request =
            |path: &str| LoadSurfaceRequest { path: path.to_owned(), ..LoadSurfaceRequest::default() };
        let attempt = Duration::from_secs(1);

        let missing = client.call(&request("nothing.json"), attempt, PATIENCE).await.unwrap();
        assert_eq!(missing.code, error_code::UNREADABLE_FILE, "{}", missing.text);

        let first = client.call(&request("surface_1.json"), attempt, PATIENCE).await.unwrap();
        assert_eq!(first.code, 0, "{}", first.text);
        let Some(Received::Product { key, product: mesh, .. }) = meshes.next().await else {
            panic!("no mesh")
        };
        assert_eq!(key.surface_id, first.surface_id);
        assert_eq!(mesh.triangles.len(), first.triangle_count as usize);
        let Some(Received::Product { product, .. }) = samples.next().await else { panic!("no samples") };
        assert_eq!(product.len(), first.sample_count as usize);

        let again = client.call(&request("surface_1.json"), attempt, PATIENCE).await.unwrap();
        assert_eq!(again, first);
        user.shutdown().await;
        ingestion.shutdown().await;
    })
    .unwrap();
}

const SIDE: u32 = 40;

/// A shallow bowl of 40 × 40 points a millimetre apart, in the workpiece's frame.
fn bowl() -> PointCloud2 {
    let mut cloud =
        PointCloud2 { height: SIDE, width: SIDE, point_step: 12, row_step: 12 * SIDE, ..Default::default() };
    cloud.header.frame_id = "workpiece".to_owned();
    let field =
        |(i, name): (u32, &str)| PointField { name: name.to_owned(), offset: 4 * i, datatype: 7, count: 1 };
    cloud.fields = (0..).zip(["x", "y", "z"]).map(field).collect();
    for k in 0..SIDE * SIDE {
        let (x, y) = (f64::from(k / SIDE) * 1e-3, f64::from(k % SIDE) * 1e-3);
        [x, y, x * x + y * y].iter().for_each(|v| cloud.data.extend((*v as f32).to_le_bytes()));
    }
    cloud
}

#[test]
fn the_newest_cloud_is_loaded_and_bad_ones_are_refused_with_their_code() {
    let lease = free_domain().unwrap();
    block_on(async {
        let mut options =
            NodeOptions::local("surface_ingestion", lease.domain()).with_parameters(node::parameters());
        options.arguments.overrides.push(Override {
            node: None,
            name: "max_points".to_owned(),
            value: Value::Integer(2000),
            strict: true,
        });
        let ingestion = node::start(options).unwrap();
        let user = Node::start(NodeOptions::local("user", lease.domain())).unwrap();
        let client = user.service_client::<LoadSurface>(topics::LOAD_SURFACE).unwrap();
        let attempt = Duration::from_secs(5);
        let newest = LoadSurfaceRequest { newest_cloud: true, ..LoadSurfaceRequest::default() };
        let load =
            async |request: &LoadSurfaceRequest| client.call(request, attempt, PATIENCE).await.unwrap();
        let refused = |answer: &LoadSurfaceResponse, code: i32, words: &str| {
            assert!(answer.code == code && answer.text.contains(words), "{}: {}", answer.code, answer.text);
        };

        let topic = "/patchmill/surface_ingestion/points";
        refused(&load(&newest).await, error_code::NO_CLOUD, &format!("on {topic} within 0 s"));
        let path = "surface_1.json".to_owned();
        for (request, words) in [
            (LoadSurfaceRequest { cloud_wait: f64::NAN, ..newest.clone() }, "cloud_wait is NaN s"),
            (LoadSurfaceRequest { cloud_wait: -1.0, ..newest.clone() }, "cloud_wait is -1 s"),
            (LoadSurfaceRequest { units: "mm".to_owned(), ..newest.clone() }, "whose unit is m"),
            (LoadSurfaceRequest { path, ..newest.clone() }, "a path and newest_cloud"),
            (LoadSurfaceRequest::default(), "the request has none"),
        ] {
            refused(&load(&request).await, error_code::BAD_PARAMETER, words);
        }

        let scanner = user.publisher::<PointCloud2>(topics::CLOUD, Qos::Sensor).unwrap();
        assert!(scanner.wait_for_subscriptions(2, PATIENCE).await);
        let waiting = LoadSurfaceRequest { cloud_wait: 20.0, ..newest.clone() };
        let (first, sent) = tokio::join!(load(&waiting), async {
            // The request is there before the cloud.
            tokio::time::sleep(Duration::from_millis(300)).await;
            scanner.publish(bowl())
        });
        sent.unwrap();
        assert!(first.code == 0 && first.vertex_count == SIDE * SIDE, "{}", first.text);

        // What is published is the newest cloud once its answer is.
        let publish = async |cloud: PointCloud2, code: i32, words: &str| {
            scanner.publish(cloud).unwrap();
            let mut answer = load(&newest).await;
            for _ in 0..200 {
                if answer.code == code && answer.text.contains(words) {
                    break;
                }
                tokio::time::sleep(Duration::from_millis(20)).await;
                answer = load(&newest).await;
            }
            refused(&answer, code, words);
        };
        let mut foreign = bowl();
        foreign.header.frame_id = "camera".to_owned();
        publish(foreign, error_code::FOREIGN_FRAME, "\"camera\", \"workpiece\"").await;
        let mut flat = bowl();
        flat.fields.pop();
        publish(flat, error_code::BAD_CONTENT, "no field \"z\"").await;
        let truncated = PointCloud2 { data: vec![0; 100], ..bowl() };
        publish(truncated, error_code::BAD_CONTENT, "truncated").await;
        let many = PointCloud2 { width: 1 << 20, height: 1 << 20, ..bowl() };
        publish(many, error_code::BAD_CONTENT, "more than the 2000 allowed").await;
        let nowhere = PointCloud2 { data: f32::NAN.to_le_bytes().repeat(3 * 1600), ..bowl() };
        publish(nowhere, error_code::BAD_CONTENT, "no points (1600 without a return)").await;
        let far = PointCloud2 { data: 5e3f32.to_le_bytes().repeat(3 * 1600), ..bowl() };
        publish(far, error_code::BAD_CONTENT, "5000 m from the origin").await;
        publish(PointCloud2::default(), error_code::FOREIGN_FRAME, "\"\"").await;

        publish(bowl(), 0, "1600 points").await;
        assert_eq!(load(&newest).await.surface_id, first.surface_id);
        user.shutdown().await;
        ingestion.shutdown().await;
    })
    .unwrap();
}
