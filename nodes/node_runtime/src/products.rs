//! The large products: their topics and the services that give single chunks.

use patchmill_geometry::mesh::TriangleMesh;
use patchmill_msgs::ServiceType;
use patchmill_msgs::srv::{
    GetFieldChunk, GetFieldChunkRequest, GetFieldChunkResponse, GetMeshChunk, GetMeshChunkRequest,
    GetMeshChunkResponse, GetProgramChunk, GetProgramChunkRequest, GetProgramChunkResponse, GetResidualChunk,
    GetResidualChunkRequest, GetResidualChunkResponse, GetSamplesChunk, GetSamplesChunkRequest,
    GetSamplesChunkResponse, GetToolpathChunk, GetToolpathChunkRequest, GetToolpathChunkResponse,
    GetTrajectoryChunk, GetTrajectoryChunkRequest, GetTrajectoryChunkResponse,
};
use patchmill_products::evaluation::ResidualMap;
use patchmill_products::field::RollingBallField;
use patchmill_products::program::{JointMotion, Program};
use patchmill_products::samples::SurfaceSamples;
use patchmill_products::toolpath::CandidateToolpath;
use patchmill_products::wire::Chunked;
pub use patchmill_products::wire::Key as ProductKey;

/// A product that travels as manifest and chunks, with the names under which it does.
pub trait LargeProduct: Chunked + Send + 'static {
    /// Latched topic of the manifests.
    const MANIFEST_TOPIC: &'static str;
    /// Topic of the chunks.
    const CHUNK_TOPIC: &'static str;
    /// Service that gives one chunk.
    const SERVICE_NAME: &'static str;
    /// First code of the node's hundred.
    const CODE: i32;
    /// Type of that service.
    type GetChunk: ServiceType;

    /// The request for a chunk.
    fn request(key: &ProductKey, index: u32) -> <Self::GetChunk as ServiceType>::Request;
    /// What a request asks for: id, candidate, index.
    fn wanted(request: &<Self::GetChunk as ServiceType>::Request) -> (&str, u32, u32);
    /// The answer: a chunk, or the reason why there is none.
    fn answer(chunk: Result<Self::Chunk, String>) -> <Self::GetChunk as ServiceType>::Response;
    /// The chunk in an answer, or the reason why there is none.
    ///
    /// # Errors
    /// With the server's text.
    fn answered(response: <Self::GetChunk as ServiceType>::Response) -> Result<Self::Chunk, String>;
    /// What the service knows the product by.
    fn id(key: &ProductKey) -> &str;
}

macro_rules! large_product {
    ($product:ty, $topic:literal, $service_name:literal, $code:literal, $id:ident,
     $service:ident, $request:ident, $response:ident $(, $candidate:ident)?) => {
        impl LargeProduct for $product {
            const MANIFEST_TOPIC: &'static str = $topic;
            const CHUNK_TOPIC: &'static str = concat!($topic, "/chunks");
            const SERVICE_NAME: &'static str = $service_name;
            const CODE: i32 = $code;
            type GetChunk = $service;

            fn request(key: &ProductKey, index: u32) -> $request {
                $request { id: key.$id.clone(), $($candidate: key.candidate,)? index }
            }

            fn wanted(request: &$request) -> (&str, u32, u32) {
                let candidate = 0 $(+ request.$candidate)?;
                (&request.id, candidate, request.index)
            }

            fn answer(chunk: Result<Self::Chunk, String>) -> $response {
                match chunk {
                    Ok(chunk) => $response { code: 0, text: String::new(), chunk },
                    Err(text) => $response { code: $code, text, chunk: Self::Chunk::default() },
                }
            }

            fn answered(response: $response) -> Result<Self::Chunk, String> {
                if response.code == 0 { Ok(response.chunk) } else { Err(response.text) }
            }

            fn id(key: &ProductKey) -> &str {
                &key.$id
            }
        }
    };
}

large_product!(
    TriangleMesh,
    "surface/mesh",
    "surface_ingestion/get_mesh_chunk",
    100,
    surface_id,
    GetMeshChunk,
    GetMeshChunkRequest,
    GetMeshChunkResponse
);
large_product!(
    SurfaceSamples,
    "surface/samples",
    "surface_ingestion/get_samples_chunk",
    100,
    surface_id,
    GetSamplesChunk,
    GetSamplesChunkRequest,
    GetSamplesChunkResponse
);
large_product!(
    RollingBallField,
    "analysis/rolling_ball_field",
    "rolling_ball_analysis/get_field_chunk",
    200,
    job_id,
    GetFieldChunk,
    GetFieldChunkRequest,
    GetFieldChunkResponse
);
large_product!(
    CandidateToolpath,
    "toolpath/candidates",
    "path_generation/get_toolpath_chunk",
    400,
    job_id,
    GetToolpathChunk,
    GetToolpathChunkRequest,
    GetToolpathChunkResponse,
    candidate_index
);
large_product!(
    Program,
    "machine/program",
    "machine_interface/get_program_chunk",
    500,
    job_id,
    GetProgramChunk,
    GetProgramChunkRequest,
    GetProgramChunkResponse
);
large_product!(
    JointMotion,
    "machine/joint_trajectory",
    "machine_interface/get_trajectory_chunk",
    500,
    job_id,
    GetTrajectoryChunk,
    GetTrajectoryChunkRequest,
    GetTrajectoryChunkResponse
);
large_product!(
    ResidualMap,
    "machine/residual_map",
    "machine_interface/get_residual_chunk",
    500,
    job_id,
    GetResidualChunk,
    GetResidualChunkRequest,
    GetResidualChunkResponse
);
