//! The rolling-ball field as messages.

use patchmill_msgs::msg::{RollingBallFieldChunk, RollingBallFieldManifest};

use super::chunked::{CHUNK_DATA, Chunked, heads_of_job};
use super::hash::ContentHash;
use super::vectors::{point, point_msg};
use super::{Provenance, WireError, check};
use crate::field::RollingBallField;

/// Most samples of a field.
const LIMIT: u32 = 10_000_000;

/// Bytes of a sample's entry.
const ENTRY_BYTES: usize = 32;

impl Chunked for RollingBallField {
    const WHAT: &'static str = "rolling-ball field";
    type Manifest = RollingBallFieldManifest;
    type Chunk = RollingBallFieldChunk;

    fn split(
        &self,
        provenance: &Provenance,
    ) -> Result<(RollingBallFieldManifest, Vec<RollingBallFieldChunk>), WireError> {
        self.check()?;
        let per_chunk = CHUNK_DATA / ENTRY_BYTES;
        let count = self.pseudo_curvature.len();
        let chunk_count = count.div_ceil(per_chunk) as u32;
        let chunk = |index: u32| {
            let first = index as usize * per_chunk;
            let range = first..count.min(first + per_chunk);
            RollingBallFieldChunk {
                header: provenance.header(),
                surface_id: provenance.surface_id.clone(),
                job_id: provenance.job_id.clone(),
                index,
                count: chunk_count,
                first_sample: first as u32,
                pseudo_curvature: self.pseudo_curvature[range.clone()].to_vec(),
                contact: self.contact[range].iter().map(point_msg).collect(),
            }
        };
        let first = self.pseudo_curvature.first().copied().unwrap_or(0.0);
        let manifest = RollingBallFieldManifest {
            header: provenance.header(),
            surface_id: provenance.surface_id.clone(),
            job_id: provenance.job_id.clone(),
            content_hash: self.content_hash(),
            chunk_count,
            sample_count: count as u32,
            shadow_radius: self.shadow_radius,
            pseudo_curvature_min: self.pseudo_curvature.iter().copied().fold(first, f64::min),
            pseudo_curvature_max: self.pseudo_curvature.iter().copied().fold(first, f64::max),
        };
        Ok((manifest, (0..chunk_count).map(chunk).collect()))
    }

    fn join(
        manifest: &RollingBallFieldManifest,
        chunks: Vec<RollingBallFieldChunk>,
    ) -> Result<Self, WireError> {
        let count = chunks.iter().map(|c| c.pseudo_curvature.len()).sum();
        check::count("samples", manifest.sample_count, count, LIMIT)?;
        let mut field = Self {
            pseudo_curvature: Vec::with_capacity(count),
            contact: Vec::with_capacity(count),
            shadow_radius: manifest.shadow_radius,
        };
        for mut chunk in chunks {
            check::follows("sample", chunk.first_sample, field.pseudo_curvature.len())?;
            check::same_length("contacts", chunk.contact.len(), chunk.pseudo_curvature.len())?;
            field.pseudo_curvature.append(&mut chunk.pseudo_curvature);
            field.contact.extend(chunk.contact.iter().map(point));
        }
        Ok(field)
    }

    fn check(&self) -> Result<(), WireError> {
        let count = self.pseudo_curvature.len();
        check::expect(count <= LIMIT as usize, "the number of samples", count, &format!("at most {LIMIT}"))?;
        check::same_length("contacts", self.contact.len(), count)?;
        check::all_finite("pseudo-curvature", &self.pseudo_curvature)?;
        check::finite_points("contact", &self.contact)?;
        check::not_negative("the shadow's radius", self.shadow_radius)
    }

    fn content_hash(&self) -> String {
        let mut hash = ContentHash::default();
        hash.number(self.shadow_radius);
        hash.numbers(&self.pseudo_curvature);
        hash.points(&self.contact);
        hash.hex()
    }

    heads_of_job!();
}
