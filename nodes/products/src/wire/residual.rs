//! The residual map as messages.

use patchmill_msgs::msg::{ResidualMapChunk, ResidualMapManifest};

use super::chunked::{CHUNK_DATA, Chunked, heads_of_job};
use super::hash::ContentHash;
use super::vectors::{point, point_msg};
use super::{Provenance, WireError, check};
use crate::evaluation::ResidualMap;

/// Most points of a map.
const LIMIT: u32 = 10_000_000;

/// Bytes of a point's entry.
const ENTRY_BYTES: usize = 32;

impl Chunked for ResidualMap {
    const WHAT: &'static str = "residual map";
    type Manifest = ResidualMapManifest;
    type Chunk = ResidualMapChunk;

    fn split(
        &self,
        provenance: &Provenance,
    ) -> Result<(ResidualMapManifest, Vec<ResidualMapChunk>), WireError> {
        self.check()?;
        let per_chunk = CHUNK_DATA / ENTRY_BYTES;
        let count = self.points.len();
        let chunk_count = count.div_ceil(per_chunk) as u32;
        let chunk = |index: u32| {
            let first = index as usize * per_chunk;
            let range = first..count.min(first + per_chunk);
            ResidualMapChunk {
                header: provenance.header(),
                surface_id: provenance.surface_id.clone(),
                job_id: provenance.job_id.clone(),
                index,
                count: chunk_count,
                first_point: first as u32,
                points: self.points[range.clone()].iter().map(point_msg).collect(),
                leftover: self.leftover[range].to_vec(),
            }
        };
        let first = self.leftover.first().copied().unwrap_or(0.0);
        let manifest = ResidualMapManifest {
            header: provenance.header(),
            surface_id: provenance.surface_id.clone(),
            job_id: provenance.job_id.clone(),
            content_hash: self.content_hash(),
            chunk_count,
            point_count: count as u32,
            leftover_min: self.leftover.iter().copied().fold(first, f64::min),
            leftover_max: self.leftover.iter().copied().fold(first, f64::max),
        };
        Ok((manifest, (0..chunk_count).map(chunk).collect()))
    }

    fn join(manifest: &ResidualMapManifest, chunks: Vec<ResidualMapChunk>) -> Result<Self, WireError> {
        let count = chunks.iter().map(|c| c.points.len()).sum();
        check::count("points", manifest.point_count, count, LIMIT)?;
        let mut map = Self { points: Vec::with_capacity(count), leftover: Vec::with_capacity(count) };
        for mut chunk in chunks {
            check::follows("point", chunk.first_point, map.points.len())?;
            check::same_length("leftovers", chunk.leftover.len(), chunk.points.len())?;
            map.points.extend(chunk.points.iter().map(point));
            map.leftover.append(&mut chunk.leftover);
        }
        Ok(map)
    }

    fn check(&self) -> Result<(), WireError> {
        let count = self.points.len();
        check::expect(count <= LIMIT as usize, "the number of points", count, &format!("at most {LIMIT}"))?;
        check::same_length("leftovers", self.leftover.len(), count)?;
        check::finite_points("point", &self.points)?;
        check::all_finite("leftover", &self.leftover)
    }

    fn content_hash(&self) -> String {
        let mut hash = ContentHash::default();
        hash.points(&self.points);
        hash.numbers(&self.leftover);
        hash.hex()
    }

    heads_of_job!();
}
