//! The node over DDS: a surface loaded, its products received, a missing file refused, a repeated call idempotent.

#![allow(clippy::unwrap_used)]

use std::path::Path;
use std::time::Duration;

use patchmill_geometry::mesh::TriangleMesh;
use patchmill_msgs::srv::{LoadSurface, LoadSurfaceRequest};
use patchmill_node_runtime::arguments::{NodeOptions, Override};
use patchmill_node_runtime::{Node, ProductReceiver, Received, Value, block_on, free_domain, topics};
use patchmill_products::samples::SurfaceSamples;
use patchmill_surface_ingestion::{error_code, node};

const PATIENCE: Duration = Duration::from_secs(20);

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
