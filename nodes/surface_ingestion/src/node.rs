//! The node shell: serves `surface_ingestion/load_surface`, listens to `surface_ingestion/points`, publishes mesh and samples, answers for
//! single chunks.

mod cloud_topic;

use std::path::PathBuf;
use std::time::Duration;

use patchmill_geometry::mesh::TriangleMesh;
use patchmill_msgs::msg::{MeshChunk, MeshManifest, SamplesChunk, SamplesManifest};
use patchmill_msgs::srv::{LoadSurface, LoadSurfaceRequest, LoadSurfaceResponse};
use patchmill_node_runtime::{
    JobTag, Node, NodeOptions, ParameterSet, ProductServer, RuntimeError, StageRunner, StatusPublisher,
    status, topics,
};
use patchmill_products::samples::SurfaceSamples;
use patchmill_products::selection::Selection;
use patchmill_products::stage::{Progress, SUPERSEDED, StageError};
use patchmill_products::wire::{Chunked, Provenance};
use tokio::sync::{mpsc, oneshot};

use crate::cloud::CloudParams;
use crate::raw::{Limits, RawCloud};
use crate::{
    IngestedSurface, IngestionParams, SurfaceSource, error_code, ingest, ingest_points, read_source,
};

use cloud_topic::CloudTopic;

/// Longest wait for a cloud that a request may ask for, s.
const CLOUD_WAIT_MAX: f64 = 3600.0;

/// The parameters of the node.
pub fn parameters() -> ParameterSet {
    ParameterSet::new()
        .text("surface_directory", ".", "only files inside this directory are read")
        .read_only()
        .double(
            "chord_tolerance_mm",
            0.0005,
            1e-6..=1.0,
            "largest distance between facets and an analytic surface or a STEP face [mm]",
        )
        .integer("samples_per_side", 50, 2..=1000, "rows and columns of the sample grid")
        .integer("max_triangles", 8_000_000, 2..=100_000_000, "most triangles of a mesh")
        .integer("max_points", 4_000_000, 30..=50_000_000, "most points of a point cloud")
        .double(
            "noise_tolerance_mm",
            0.05,
            1e-4..=10.0,
            "largest distance by which a point of a cloud is moved; a cloud noisier than that is refused [mm]",
        )
        .double(
            "bridge_holes_mm",
            0.0,
            0.0..=1000.0,
            "holes of a point cloud up to this extent are bridged, 0: none [mm]",
        )
        .text(
            "cloud_frame",
            "workpiece",
            "the frame_id of the clouds on surface_ingestion/points, taken as the workpiece's frame; clouds of another are refused",
        )
}

/// Starts the node. It runs until it is shut down.
///
/// # Errors
/// When the node cannot join the domain or a parameter is refused.
pub fn start(options: NodeOptions) -> Result<Node, RuntimeError> {
    let node = Node::start(options)?;
    let shell = Shell {
        mesh: ProductServer::new(&node)?,
        samples: ProductServer::new(&node)?,
        runner: StageRunner::new(StatusPublisher::new(&node)?),
        clouds: CloudTopic::subscribe(&node)?,
        node: node.clone(),
        reply: None,
    };
    let (sender, receiver) = mpsc::unbounded_channel();
    node.serve::<LoadSurface, _, _>(topics::LOAD_SURFACE, move |request| {
        let (reply, answer) = oneshot::channel();
        let sent = sender.send((request, reply));
        async move {
            let stopping = || refusal(&StageError::new(SUPERSEDED, "the node is shutting down"));
            if sent.is_err() {
                return stopping();
            }
            answer.await.unwrap_or_else(|_| stopping())
        }
    })?;
    node.spawn(shell.run(receiver));
    Ok(node)
}

type Call = (LoadSurfaceRequest, oneshot::Sender<LoadSurfaceResponse>);

/// A surface ready to be published.
struct Loaded {
    response: LoadSurfaceResponse,
    mesh: (MeshManifest, Vec<MeshChunk>),
    samples: (SamplesManifest, Vec<SamplesChunk>),
}

struct Shell {
    mesh: ProductServer<TriangleMesh>,
    samples: ProductServer<SurfaceSamples>,
    runner: StageRunner<Loaded>,
    clouds: CloudTopic,
    node: Node,
    reply: Option<oneshot::Sender<LoadSurfaceResponse>>,
}

impl Shell {
    async fn run(mut self, mut calls: mpsc::UnboundedReceiver<Call>) {
        loop {
            tokio::select! {
                call = calls.recv() => match call {
                    Some((request, reply)) => self.load(request, reply),
                    None => break,
                },
                (tag, result) = self.runner.finished() => self.publish(tag, result).await,
            }
        }
    }

    fn load(&mut self, request: LoadSurfaceRequest, reply: oneshot::Sender<LoadSurfaceResponse>) {
        self.answer(refusal(&StageError::new(SUPERSEDED, "a newer request to load a surface came")));
        self.reply = Some(reply);
        let selection = match Selection::from_msg(&request.selection) {
            Ok(selection) => selection,
            Err(e) => return self.answer(refusal(&e.with_code(error_code::BAD_SELECTION))),
        };
        let settings = match Settings::read(&self.node, &request, selection) {
            Ok(settings) => settings,
            Err(e) => {
                return self.answer(refusal(&StageError::new(error_code::BAD_PARAMETER, e.to_string())));
            }
        };
        let tag = JobTag { stamp: status::now(), ..JobTag::default() };
        let stamp = tag.stamp.clone();
        let clouds = self.clouds.clone();
        self.runner.start(tag, "loading the surface", move |progress| {
            let input = settings.input(&request, &clouds, progress)?;
            load(input, &settings.params, |id| Provenance::of_surface(stamp, id), progress)
        });
    }

    async fn publish(&mut self, mut tag: JobTag, result: Result<Loaded, StageError>) {
        let loaded = match result {
            Ok(loaded) => loaded,
            Err(e) => return self.answer(refusal(&e)),
        };
        tag.surface_id.clone_from(&loaded.response.surface_id);
        let text = loaded.response.text.clone();
        // The answer need not wait for the chunks: products are joined by id.
        self.answer(loaded.response);
        self.samples.publish_parts(loaded.samples.0, loaded.samples.1).await;
        self.mesh.publish_parts(loaded.mesh.0, loaded.mesh.1).await;
        self.runner.status().done(&tag, &text);
    }

    fn answer(&mut self, response: LoadSurfaceResponse) {
        if let Some(reply) = self.reply.take() {
            // The service may have been shut down.
            let _ = reply.send(response);
        }
    }
}

/// What a request and the parameters ask for.
struct Settings {
    directory: PathBuf,
    cloud_frame: String,
    params: IngestionParams,
}

/// What a surface is made of.
enum Input {
    Source(SurfaceSource),
    Points { cloud: RawCloud, name: String },
}

impl Input {
    fn name(&self) -> &str {
        match self {
            Self::Source(source) => &source.name,
            Self::Points { name, .. } => name,
        }
    }
}

impl Settings {
    fn read(node: &Node, request: &LoadSurfaceRequest, selection: Selection) -> Result<Self, RuntimeError> {
        let chord_tolerance = match request.chord_tolerance {
            0.0 => node.double("chord_tolerance_mm")? / 1e3,
            metres => metres,
        };
        let samples_per_side = match request.samples_per_side {
            0 => node.integer("samples_per_side")? as u32,
            count => count,
        };
        let max_triangles = node.integer("max_triangles")? as usize;
        let max_points = node.integer("max_points")? as usize;
        let cloud = CloudParams {
            noise_tolerance: node.double("noise_tolerance_mm")? / 1e3,
            bridge_holes: node.double("bridge_holes_mm")? / 1e3,
        };
        let directory = PathBuf::from(node.text("surface_directory")?);
        let params = IngestionParams {
            chord_tolerance,
            samples_per_side,
            max_triangles,
            max_points,
            cloud,
            selection,
        };
        Ok(Self { directory, cloud_frame: node.text("cloud_frame")?, params })
    }

    fn input(
        &self,
        request: &LoadSurfaceRequest,
        clouds: &CloudTopic,
        progress: Progress<'_>,
    ) -> Result<Input, StageError> {
        match (request.path.as_str(), request.inline_json.as_str(), request.newest_cloud) {
            ("", "", true) => self.newest_cloud(request, clouds, progress),
            (path, "", false) if !path.is_empty() => {
                read_source(&self.directory, path, &request.units).map(Input::Source)
            }
            ("", json, false) if !json.is_empty() => {
                let source = SurfaceSource::new(json.as_bytes().to_vec(), "inline surface", &request.units);
                Ok(Input::Source(source))
            }
            (path, json, cloud) => {
                let given = [
                    (!path.is_empty(), "a path"),
                    (!json.is_empty(), "inline JSON"),
                    (cloud, "newest_cloud"),
                ];
                let given: Vec<_> = given.iter().filter(|(given, _)| *given).map(|(_, what)| *what).collect();
                let found = if given.is_empty() { "none".to_owned() } else { given.join(" and ") };
                Err(StageError::new(
                    error_code::BAD_PARAMETER,
                    format!(
                        "one of a path, inline JSON and newest_cloud was expected, the request has {found}"
                    ),
                ))
            }
        }
    }

    fn newest_cloud(
        &self,
        request: &LoadSurfaceRequest,
        clouds: &CloudTopic,
        progress: Progress<'_>,
    ) -> Result<Input, StageError> {
        let bad = |text: String| StageError::new(error_code::BAD_PARAMETER, text);
        if !request.units.is_empty() {
            return Err(bad(format!(
                "units is \"{}\" for a point cloud, whose unit is m: none was expected",
                request.units
            )));
        }
        if !(0.0..=CLOUD_WAIT_MAX).contains(&request.cloud_wait) {
            return Err(bad(format!(
                "cloud_wait is {} s; 0 s to {CLOUD_WAIT_MAX} s was expected",
                request.cloud_wait
            )));
        }
        let limits = Limits { triangles: self.params.max_triangles, points: self.params.max_points };
        let newest = clouds.newest(Duration::from_secs_f64(request.cloud_wait), progress)?;
        let cloud = newest.points(&self.cloud_frame, &limits, clouds.topic())?;
        Ok(Input::Points { cloud, name: format!("the cloud of {}", clouds.topic()) })
    }
}

fn load(
    input: Input,
    params: &IngestionParams,
    provenance: impl FnOnce(&str) -> Provenance,
    progress: Progress<'_>,
) -> Result<Loaded, StageError> {
    let name = input.name().to_owned();
    let surface = match input {
        Input::Source(source) => ingest(&source, params, progress)?,
        Input::Points { cloud, name } => ingest_points(cloud, &name, params, progress)?,
    };
    loaded(surface, &name, provenance)
}

fn loaded(
    surface: IngestedSurface,
    name: &str,
    provenance: impl FnOnce(&str) -> Provenance,
) -> Result<Loaded, StageError> {
    let provenance = provenance(&surface.surface_id);
    let invalid = |e: patchmill_products::wire::WireError| e.with_code(error_code::BAD_CONTENT);
    let mesh = surface.mesh.split(&provenance).map_err(invalid)?;
    let samples = surface.samples.split(&provenance).map_err(invalid)?;
    let dropped_triangles = surface.degenerate_dropped + surface.duplicate_dropped;
    let text = format!(
        "{name}: {} triangles within {:.6} mm, {} samples{}{}{}",
        surface.mesh.triangles.len(),
        surface.mesh.chord_error * 1e3,
        surface.samples.len(),
        if dropped_triangles > 0 { format!(", {dropped_triangles} facets dropped") } else { String::new() },
        match surface.mesh.check_only.iter().filter(|check_only| **check_only).count() {
            0 => String::new(),
            checked => format!(", {checked} of the triangles only checked"),
        },
        surface.cloud.map_or_else(String::new, |cloud| format!("; {cloud}"))
    );
    let response = LoadSurfaceResponse {
        code: 0,
        text,
        surface_id: surface.surface_id,
        vertex_count: surface.mesh.vertices.len() as u32,
        triangle_count: surface.mesh.triangles.len() as u32,
        sample_count: surface.samples.len() as u32,
        dropped_triangles,
        chord_error: surface.mesh.chord_error,
    };
    Ok(Loaded { response, mesh, samples })
}

fn refusal(error: &StageError) -> LoadSurfaceResponse {
    LoadSurfaceResponse { code: error.code, text: error.text.clone(), ..LoadSurfaceResponse::default() }
}
