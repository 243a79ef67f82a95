//! The mesh as messages.

use nalgebra::Point3;
use patchmill_geometry::mesh::TriangleMesh;
use patchmill_msgs::msg::{MeshChunk, MeshManifest};
use patchmill_msgs::shape_msgs::msg::MeshTriangle;

use super::chunked::{CHUNK_DATA, Chunked, Head};
use super::hash::ContentHash;
use super::vectors::{point, point_msg, vector, vector_msg};
use super::{Provenance, WireError, check};

/// Most vertices, and most triangles, of a mesh.
const LIMIT: u32 = 50_000_000;

/// Bytes of a vertex with its normal, and of a triangle.
const VERTEX_BYTES: usize = 48;
const TRIANGLE_BYTES: usize = 12;
/// Bytes of a triangle that has a mark beside.
const MARKED_TRIANGLE_BYTES: usize = 13;

impl Chunked for TriangleMesh {
    const WHAT: &'static str = "mesh";
    type Manifest = MeshManifest;
    type Chunk = MeshChunk;

    fn split(&self, provenance: &Provenance) -> Result<(MeshManifest, Vec<MeshChunk>), WireError> {
        self.check()?;
        let (header, surface_id) = (provenance.header(), provenance.surface_id.clone());
        let triangle_bytes = if self.check_only.is_empty() { TRIANGLE_BYTES } else { MARKED_TRIANGLE_BYTES };
        let mut chunks = Vec::new();
        let (mut vertex, mut triangle) = (0, 0);
        while vertex < self.vertices.len() || triangle < self.triangles.len() {
            let vertices = vertex..self.vertices.len().min(vertex + CHUNK_DATA / VERTEX_BYTES);
            let room = (CHUNK_DATA - vertices.len() * VERTEX_BYTES) / triangle_bytes;
            let triangles = triangle..self.triangles.len().min(triangle + room);
            chunks.push(MeshChunk {
                header: header.clone(),
                surface_id: surface_id.clone(),
                index: chunks.len() as u32,
                count: 0,
                first_vertex: vertex as u32,
                first_triangle: triangle as u32,
                vertices: self.vertices[vertices.clone()].iter().map(point_msg).collect(),
                normals: self.normals[vertices.clone()].iter().map(vector_msg).collect(),
                triangles: self.triangles[triangles.clone()]
                    .iter()
                    .map(|&vertex_indices| MeshTriangle { vertex_indices })
                    .collect(),
                check_only: self.check_only.get(triangles.clone()).unwrap_or_default().to_vec(),
            });
            (vertex, triangle) = (vertices.end, triangles.end);
        }
        let chunk_count = chunks.len() as u32;
        chunks.iter_mut().for_each(|chunk| chunk.count = chunk_count);
        let (min, max) = bounds(&self.vertices);
        let manifest = MeshManifest {
            header,
            surface_id,
            content_hash: self.content_hash(),
            chunk_count,
            vertex_count: self.vertices.len() as u32,
            triangle_count: self.triangles.len() as u32,
            chord_error: self.chord_error,
            min: point_msg(&min),
            max: point_msg(&max),
        };
        Ok((manifest, chunks))
    }

    fn join(manifest: &MeshManifest, chunks: Vec<MeshChunk>) -> Result<Self, WireError> {
        let vertex_count = chunks.iter().map(|c| c.vertices.len()).sum();
        let triangle_count = chunks.iter().map(|c| c.triangles.len()).sum();
        check::count("vertices", manifest.vertex_count, vertex_count, LIMIT)?;
        check::count("triangles", manifest.triangle_count, triangle_count, LIMIT)?;
        let mut mesh = Self {
            vertices: Vec::with_capacity(vertex_count),
            normals: Vec::with_capacity(vertex_count),
            triangles: Vec::with_capacity(triangle_count),
            chord_error: manifest.chord_error,
            check_only: Vec::new(),
        };
        for mut chunk in chunks {
            check::follows("vertex", chunk.first_vertex, mesh.vertices.len())?;
            check::follows("triangle", chunk.first_triangle, mesh.triangles.len())?;
            check::same_length("normals", chunk.normals.len(), chunk.vertices.len())?;
            mesh.vertices.extend(chunk.vertices.iter().map(point));
            mesh.normals.extend(chunk.normals.iter().map(vector));
            mesh.triangles.extend(chunk.triangles.iter().map(|t| t.vertex_indices));
            mesh.check_only.append(&mut chunk.check_only);
        }
        Ok(mesh)
    }

    fn check(&self) -> Result<(), WireError> {
        for (what, length) in [("vertices", self.vertices.len()), ("triangles", self.triangles.len())] {
            let expected = format!("at most {LIMIT}");
            check::expect(length <= LIMIT as usize, &format!("the number of {what}"), length, &expected)?;
        }
        check::same_length("normals", self.normals.len(), self.vertices.len())?;
        if !self.check_only.is_empty() {
            check::same_length("marks", self.check_only.len(), self.triangles.len())?;
        }
        check::finite_points("vertex", &self.vertices)?;
        check::unit_vectors("normal", &self.normals)?;
        check::not_negative("the chord error", self.chord_error)?;
        let count = self.vertices.len();
        let wrong = self.triangles.iter().enumerate().find(|(_, t)| t.iter().any(|&v| v as usize >= count));
        match wrong {
            None => Ok(()),
            Some((at, t)) => {
                Err(WireError::new(format!("triangle {at} names the vertices {t:?} of {count}")))
            }
        }
    }

    fn content_hash(&self) -> String {
        let mut hash = ContentHash::default();
        hash.number(self.chord_error);
        hash.points(&self.vertices);
        hash.vectors(&self.normals);
        hash.length(self.triangles.len());
        self.triangles.iter().flatten().for_each(|&v| hash.integer(v));
        hash.length(self.check_only.len());
        self.check_only.iter().for_each(|&check_only| hash.integer(u32::from(check_only)));
        hash.hex()
    }

    fn manifest_head(manifest: &MeshManifest) -> Head<'_> {
        Head {
            header: &manifest.header,
            surface_id: &manifest.surface_id,
            job_id: "",
            candidate: 0,
            count: manifest.chunk_count,
        }
    }

    fn announced_hash(manifest: &MeshManifest) -> &str {
        &manifest.content_hash
    }

    fn chunk_head(chunk: &MeshChunk) -> Head<'_> {
        Head {
            header: &chunk.header,
            surface_id: &chunk.surface_id,
            job_id: "",
            candidate: 0,
            count: chunk.count,
        }
    }

    fn chunk_index(chunk: &MeshChunk) -> u32 {
        chunk.index
    }
}

/// Corners of the bounding box; both the origin without points.
fn bounds(points: &[Point3<f64>]) -> (Point3<f64>, Point3<f64>) {
    let first = points.first().copied().unwrap_or_default();
    points.iter().fold((first, first), |(min, max), p| (min.inf(p), max.sup(p)))
}
