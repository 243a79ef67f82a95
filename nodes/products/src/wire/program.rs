//! The program as messages.

use patchmill_msgs::msg::{self, ProgramChunk, ProgramManifest};

use super::chunked::{CHUNK_DATA, Chunked, heads_of_job};
use super::evaluation::{check_proof, proof, proof_msg};
use super::hash::ContentHash;
use super::job::MAX_URDF_BYTES;
use super::patch_plan::{check_plan, plan, plan_msg};
use super::{Provenance, WireError, check};
use crate::program::{PatchProgram, Program};

/// Longest program, bytes.
const LIMIT: u32 = 1 << 30;

/// Most patches: with its URDF the manifest stays below 128 KiB.
const PATCH_LIMIT: usize = 64;

impl Chunked for Program {
    const WHAT: &'static str = "program";
    type Manifest = ProgramManifest;
    type Chunk = ProgramChunk;

    fn split(&self, provenance: &Provenance) -> Result<(ProgramManifest, Vec<ProgramChunk>), WireError> {
        self.check()?;
        let pieces = pieces(&self.text);
        let chunk_count = pieces.len() as u32;
        let chunk = |(text, index): (&str, u32)| ProgramChunk {
            header: provenance.header(),
            surface_id: provenance.surface_id.clone(),
            job_id: provenance.job_id.clone(),
            index,
            count: chunk_count,
            text: text.to_owned(),
        };
        let manifest = ProgramManifest {
            header: provenance.header(),
            surface_id: provenance.surface_id.clone(),
            job_id: provenance.job_id.clone(),
            content_hash: self.content_hash(),
            chunk_count,
            byte_count: self.text.len() as u32,
            block_count: self.block_count,
            candidate_index: self.candidate_index,
            machining_time: self.machining_time,
            cut_length: self.cut_length,
            proof: proof_msg(&self.proof),
            patches: self.patches.iter().map(patch_msg).collect(),
            machine_urdf: self.machine_urdf.clone(),
        };
        Ok((manifest, pieces.into_iter().zip(0..).map(chunk).collect()))
    }

    fn join(manifest: &ProgramManifest, chunks: Vec<ProgramChunk>) -> Result<Self, WireError> {
        let bytes = chunks.iter().map(|chunk| chunk.text.len()).sum();
        check::count("bytes", manifest.byte_count, bytes, LIMIT)?;
        Ok(Self {
            text: chunks.iter().map(|chunk| chunk.text.as_str()).collect(),
            block_count: manifest.block_count,
            candidate_index: manifest.candidate_index,
            machining_time: manifest.machining_time,
            cut_length: manifest.cut_length,
            proof: proof(&manifest.proof),
            patches: manifest.patches.iter().map(patch).collect(),
            machine_urdf: manifest.machine_urdf.clone(),
        })
    }

    fn check(&self) -> Result<(), WireError> {
        let (bytes, urdf, patches) = (self.text.len(), self.machine_urdf.len(), self.patches.len());
        check::expect(bytes <= LIMIT as usize, "the program's bytes", bytes, &format!("at most {LIMIT}"))?;
        let expected = format!("at most {MAX_URDF_BYTES}");
        check::expect(urdf <= MAX_URDF_BYTES, "the machine's URDF in bytes", urdf, &expected)?;
        check::expect(
            patches <= PATCH_LIMIT,
            "the number of patches",
            patches,
            &format!("at most {PATCH_LIMIT}"),
        )?;
        check::not_negative("the machining time", self.machining_time)?;
        check::not_negative("the cut length", self.cut_length)?;
        check_proof(&self.proof)?;
        for patch in &self.patches {
            check_plan(&patch.plan)?;
            let of = |what: &str| format!("patch {}: {what}", patch.plan.patch);
            check::all_finite(&of("rotary position"), &patch.rotary_positions)?;
            check::not_negative(&of("the machining time"), patch.machining_time)?;
            check::not_negative(&of("the cut length"), patch.cut_length)?;
        }
        Ok(())
    }

    /// Of the text alone, so that anyone can hold a file against it.
    fn content_hash(&self) -> String {
        let mut hash = ContentHash::default();
        hash.bytes(self.text.as_bytes());
        hash.hex()
    }

    heads_of_job!();
}

/// The text in pieces that end at line ends; inside a line only where one alone is too long for a chunk.
fn pieces(mut text: &str) -> Vec<&str> {
    let mut pieces = Vec::new();
    while text.len() > CHUNK_DATA {
        let most = text.floor_char_boundary(CHUNK_DATA);
        let end = text[..most].rfind('\n').map_or(most, |at| at + 1);
        let (piece, rest) = text.split_at(end);
        pieces.push(piece);
        text = rest;
    }
    if !text.is_empty() {
        pieces.push(text);
    }
    pieces
}

fn patch_msg(patch: &PatchProgram) -> msg::PatchProgram {
    msg::PatchProgram {
        plan: plan_msg(&patch.plan),
        rotary_names: patch.rotary_names.clone(),
        rotary_positions: patch.rotary_positions,
        machining_time: patch.machining_time,
        cut_length: patch.cut_length,
    }
}

fn patch(msg: &msg::PatchProgram) -> PatchProgram {
    PatchProgram {
        plan: plan(&msg.plan),
        rotary_names: msg.rotary_names.clone(),
        rotary_positions: msg.rotary_positions,
        machining_time: msg.machining_time,
        cut_length: msg.cut_length,
    }
}
