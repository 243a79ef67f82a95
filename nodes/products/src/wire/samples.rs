//! The samples as messages.

use patchmill_msgs::msg::{SamplesChunk, SamplesManifest};

use super::chunked::{CHUNK_DATA, Chunked, Head};
use super::hash::ContentHash;
use super::vectors::{point, point_msg, vector, vector_msg};
use super::{Provenance, WireError, check};
use crate::samples::SurfaceSamples;

/// Most samples of a surface.
const LIMIT: u32 = 10_000_000;

/// Bytes of a sample.
const SAMPLE_BYTES: usize = 96;

impl Chunked for SurfaceSamples {
    const WHAT: &'static str = "set of samples";
    type Manifest = SamplesManifest;
    type Chunk = SamplesChunk;

    fn split(&self, provenance: &Provenance) -> Result<(SamplesManifest, Vec<SamplesChunk>), WireError> {
        self.check()?;
        let per_chunk = CHUNK_DATA / SAMPLE_BYTES;
        let chunk_count = self.len().div_ceil(per_chunk) as u32;
        let chunk = |index: u32| {
            let first = index as usize * per_chunk;
            let range = first..self.len().min(first + per_chunk);
            SamplesChunk {
                header: provenance.header(),
                surface_id: provenance.surface_id.clone(),
                index,
                count: chunk_count,
                first_sample: first as u32,
                points: self.points[range.clone()].iter().map(point_msg).collect(),
                normals: self.normals[range.clone()].iter().map(vector_msg).collect(),
                curvature_max: self.curvature_max[range.clone()].to_vec(),
                curvature_min: self.curvature_min[range.clone()].to_vec(),
                direction_max: self.direction_max[range.clone()].iter().map(vector_msg).collect(),
                area: self.area[range].to_vec(),
            }
        };
        let [rows, columns] = self.grid.unwrap_or([0, 0]);
        let manifest = SamplesManifest {
            header: provenance.header(),
            surface_id: provenance.surface_id.clone(),
            content_hash: self.content_hash(),
            chunk_count,
            sample_count: self.len() as u32,
            rows,
            columns,
        };
        Ok((manifest, (0..chunk_count).map(chunk).collect()))
    }

    fn join(manifest: &SamplesManifest, chunks: Vec<SamplesChunk>) -> Result<Self, WireError> {
        let count = chunks.iter().map(|c| c.points.len()).sum();
        check::count("samples", manifest.sample_count, count, LIMIT)?;
        let grid = [manifest.rows, manifest.columns];
        let mut samples = Self { grid: (grid != [0, 0]).then_some(grid), ..Self::default() };
        for mut chunk in chunks {
            check::follows("sample", chunk.first_sample, samples.len())?;
            samples.points.extend(chunk.points.iter().map(point));
            samples.normals.extend(chunk.normals.iter().map(vector));
            samples.curvature_max.append(&mut chunk.curvature_max);
            samples.curvature_min.append(&mut chunk.curvature_min);
            samples.direction_max.extend(chunk.direction_max.iter().map(vector));
            samples.area.append(&mut chunk.area);
        }
        Ok(samples)
    }

    fn check(&self) -> Result<(), WireError> {
        let count = self.len();
        check::expect(count <= LIMIT as usize, "the number of samples", count, &format!("at most {LIMIT}"))?;
        check::same_length("normals", self.normals.len(), count)?;
        check::same_length("largest curvatures", self.curvature_max.len(), count)?;
        check::same_length("least curvatures", self.curvature_min.len(), count)?;
        check::same_length("curvature directions", self.direction_max.len(), count)?;
        check::same_length("areas", self.area.len(), count)?;
        if let Some([rows, columns]) = self.grid {
            let size = u64::from(rows) * u64::from(columns);
            let what = format!("the size of the grid of {rows} rows and {columns} columns");
            check::expect(size == count as u64, &what, size, &format!("{count} as there are samples"))?;
        }
        check::finite_points("sample", &self.points)?;
        check::unit_vectors("normal", &self.normals)?;
        check::all_finite("largest curvature", &self.curvature_max)?;
        check::all_finite("least curvature", &self.curvature_min)?;
        check::unit_vectors("curvature direction", &self.direction_max)?;
        check::all_finite("area", &self.area)?;
        match self.area.iter().position(|&area| area < 0.0) {
            None => Ok(()),
            Some(at) => check::not_negative(&format!("area {at}"), self.area[at]),
        }
    }

    fn content_hash(&self) -> String {
        let mut hash = ContentHash::default();
        self.grid.unwrap_or([0, 0]).into_iter().for_each(|n| hash.integer(n));
        hash.points(&self.points);
        hash.vectors(&self.normals);
        hash.numbers(&self.curvature_max);
        hash.numbers(&self.curvature_min);
        hash.vectors(&self.direction_max);
        hash.numbers(&self.area);
        hash.hex()
    }

    fn manifest_head(manifest: &SamplesManifest) -> Head<'_> {
        Head {
            header: &manifest.header,
            surface_id: &manifest.surface_id,
            job_id: "",
            candidate: 0,
            count: manifest.chunk_count,
        }
    }

    fn announced_hash(manifest: &SamplesManifest) -> &str {
        &manifest.content_hash
    }

    fn chunk_head(chunk: &SamplesChunk) -> Head<'_> {
        Head {
            header: &chunk.header,
            surface_id: &chunk.surface_id,
            job_id: "",
            candidate: 0,
            count: chunk.count,
        }
    }

    fn chunk_index(chunk: &SamplesChunk) -> u32 {
        chunk.index
    }
}
