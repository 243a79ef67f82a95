//! A candidate's toolpath as messages.

use patchmill_msgs::msg::{self, ToolpathChunk, ToolpathManifest};

use super::chunked::{CHUNK_DATA, Chunked, Head};
use super::hash::ContentHash;
use super::patch_plan::{check_plan, hash_plan, plan, plan_msg};
use super::vectors::{point, point_msg, vector, vector_msg};
use super::{Provenance, WireError, check};
use crate::program::PatchPlan;
use crate::toolpath::{CandidateToolpath, Pass, PatchToolpath};

/// Most cutter locations of a toolpath, and most passes of a patch.
const LIMIT: usize = 50_000_000;
const PASS_LIMIT: u32 = 1_000_000;

/// Most patches of a candidate, disconnected parts counted one by one.
const PATCH_LIMIT: usize = 256;

/// Longest reason for a candidate not to be feasible, bytes.
const REASON_LIMIT: usize = 4096;

/// Bytes of a cutter location with its contact point, and of a pass without them.
const POINT_BYTES: usize = 48;
const PASS_BYTES: usize = 56;
/// Bytes of the tool axis of a cutter location, where it has its own.
const AXIS_BYTES: usize = 24;

impl Chunked for CandidateToolpath {
    const WHAT: &'static str = "toolpath";
    type Manifest = ToolpathManifest;
    type Chunk = ToolpathChunk;

    fn split(&self, provenance: &Provenance) -> Result<(ToolpathManifest, Vec<ToolpathChunk>), WireError> {
        self.check()?;
        let passes = pack(pieces(&self.patches));
        let chunk_count = passes.len() as u32;
        let chunks = passes
            .into_iter()
            .zip(0..)
            .map(|(passes, index)| ToolpathChunk {
                header: provenance.header(),
                surface_id: provenance.surface_id.clone(),
                job_id: provenance.job_id.clone(),
                candidate_index: self.index,
                candidate_count: self.count,
                index,
                count: chunk_count,
                passes,
            })
            .collect();
        let manifest = ToolpathManifest {
            header: provenance.header(),
            surface_id: provenance.surface_id.clone(),
            job_id: provenance.job_id.clone(),
            content_hash: self.content_hash(),
            chunk_count,
            candidate_index: self.index,
            candidate_count: self.count,
            patch_count: self.patch_count,
            infeasible_reason: self.infeasible_reason.clone(),
            patches: self.patches.iter().map(|patch| plan_msg(&PatchPlan::from(patch))).collect(),
            area_within_scallop: self.area_within_scallop,
            gouge_max: self.gouge_max,
        };
        Ok((manifest, chunks))
    }

    fn join(manifest: &ToolpathManifest, chunks: Vec<ToolpathChunk>) -> Result<Self, WireError> {
        let mut patches: Vec<PatchToolpath> = manifest.patches.iter().map(empty_patch).collect();
        let mut last = 0;
        for piece in chunks.into_iter().flat_map(|chunk| chunk.passes) {
            let place = piece.patch as usize;
            let expected = format!("{last} to {}", patches.len().saturating_sub(1));
            check::expect((last..patches.len()).contains(&place), "a pass's patch", place, &expected)?;
            check::same_length("contact points of a pass", piece.cc.len(), piece.cl.len())?;
            if !piece.tool_axes.is_empty() {
                check::same_length("tool axes of a pass", piece.tool_axes.len(), piece.cl.len())?;
            }
            last = place;
            append(&mut patches[place].passes, &piece)?;
        }
        for (patch, planned) in patches.iter().zip(&manifest.patches) {
            let what = format!("passes of patch {}", patch.patch);
            check::count(&what, planned.pass_count, patch.passes.len(), PASS_LIMIT)?;
        }
        Ok(Self {
            index: manifest.candidate_index,
            count: manifest.candidate_count,
            patch_count: manifest.patch_count,
            infeasible_reason: manifest.infeasible_reason.clone(),
            patches,
            area_within_scallop: manifest.area_within_scallop,
            gouge_max: manifest.gouge_max,
        })
    }

    fn check(&self) -> Result<(), WireError> {
        let within = format!("less than {}", self.count);
        check::expect(self.index < self.count, "the candidate's index", self.index, &within)?;
        let (patches, reason) = (self.patches.len(), self.infeasible_reason.len());
        check::expect(
            patches <= PATCH_LIMIT,
            "the number of patches",
            patches,
            &format!("at most {PATCH_LIMIT}"),
        )?;
        check::expect(
            reason <= REASON_LIMIT,
            "the reason's bytes",
            reason,
            &format!("at most {REASON_LIMIT}"),
        )?;
        check::within("the share of area within the scallop height", self.area_within_scallop, 0.0, 1.0)?;
        check::not_negative("the largest gouge", self.gouge_max)?;
        let points: usize = self.patches.iter().flat_map(|p| &p.passes).map(|pass| pass.cl.len()).sum();
        check::expect(
            points <= LIMIT,
            "the number of cutter locations",
            points,
            &format!("at most {LIMIT}"),
        )?;
        for patch in &self.patches {
            check_plan(&PatchPlan::from(patch))?;
            for (at, pass) in patch.passes.iter().enumerate() {
                let of = |what: &str| format!("patch {}, pass {at}: {what}", patch.patch);
                check::same_length(&of("contact points"), pass.cc.len(), pass.cl.len())?;
                check::finite_points(&of("cutter location"), &pass.cl)?;
                check::finite_points(&of("contact point"), &pass.cc)?;
                if !pass.tool_axes.is_empty() {
                    check::same_length(&of("tool axes"), pass.tool_axes.len(), pass.cl.len())?;
                    check::unit_vectors(&of("tool axis"), &pass.tool_axes)?;
                }
                check::finite(&of("the retract height"), pass.retract_height)?;
            }
        }
        Ok(())
    }

    fn content_hash(&self) -> String {
        let mut hash = ContentHash::default();
        [self.index, self.count, self.patch_count].into_iter().for_each(|n| hash.integer(n));
        hash.text(&self.infeasible_reason);
        hash.numbers(&[self.area_within_scallop, self.gouge_max]);
        hash.length(self.patches.len());
        for patch in &self.patches {
            hash_plan(&mut hash, &PatchPlan::from(patch));
            for pass in &patch.passes {
                hash.number(pass.retract_height);
                hash.points(&pass.cl);
                hash.points(&pass.cc);
                hash.vectors(&pass.tool_axes);
            }
        }
        hash.hex()
    }

    fn manifest_head(manifest: &ToolpathManifest) -> Head<'_> {
        Head {
            header: &manifest.header,
            surface_id: &manifest.surface_id,
            job_id: &manifest.job_id,
            candidate: manifest.candidate_index,
            count: manifest.chunk_count,
        }
    }

    fn announced_hash(manifest: &ToolpathManifest) -> &str {
        &manifest.content_hash
    }

    fn chunk_head(chunk: &ToolpathChunk) -> Head<'_> {
        Head {
            header: &chunk.header,
            surface_id: &chunk.surface_id,
            job_id: &chunk.job_id,
            candidate: chunk.candidate_index,
            count: chunk.count,
        }
    }

    fn chunk_index(chunk: &ToolpathChunk) -> u32 {
        chunk.index
    }
}

/// A pass, or a piece of it, before it becomes a message.
struct Piece<'a> {
    patch: u32,
    pass: &'a Pass,
    continued: bool,
    range: std::ops::Range<usize>,
}

/// All passes in order.
fn pieces(patches: &[PatchToolpath]) -> impl Iterator<Item = Piece<'_>> {
    patches.iter().zip(0..).flat_map(|(patch, place)| {
        patch.passes.iter().map(move |pass| Piece {
            patch: place,
            pass,
            continued: false,
            range: 0..pass.cl.len(),
        })
    })
}

/// The passes chunk by chunk; one that does not fit goes on in the next chunk.
fn pack<'a>(pieces: impl Iterator<Item = Piece<'a>>) -> Vec<Vec<msg::Pass>> {
    let mut chunks: Vec<Vec<msg::Pass>> = Vec::new();
    let mut room = 0;
    for mut rest in pieces {
        loop {
            let axes = &rest.pass.tool_axes;
            let bytes = if axes.is_empty() { POINT_BYTES } else { POINT_BYTES + AXIS_BYTES };
            // A chunk is open while a pass with at least one point fits.
            if room < PASS_BYTES + bytes {
                chunks.push(Vec::new());
                room = CHUNK_DATA;
            }
            let take = rest.range.len().min((room - PASS_BYTES) / bytes);
            let range = rest.range.start..rest.range.start + take;
            room -= PASS_BYTES + take * bytes;
            if let Some(chunk) = chunks.last_mut() {
                chunk.push(msg::Pass {
                    patch: rest.patch,
                    continued: rest.continued,
                    retract_height: rest.pass.retract_height,
                    cl: rest.pass.cl[range.clone()].iter().map(point_msg).collect(),
                    cc: rest.pass.cc[range.clone()].iter().map(point_msg).collect(),
                    tool_axes: axes.get(range.clone()).unwrap_or_default().iter().map(vector_msg).collect(),
                });
            }
            rest.range.start = range.end;
            rest.continued = true;
            if rest.range.is_empty() {
                break;
            }
        }
    }
    chunks
}

/// Puts a pass, or a further piece of the last one, to a patch's passes.
fn append(passes: &mut Vec<Pass>, piece: &msg::Pass) -> Result<(), WireError> {
    if !piece.continued {
        passes.push(Pass::default());
    }
    let pass =
        passes.last_mut().ok_or_else(|| WireError::new("a patch's first pass continues another one"))?;
    pass.cl.extend(piece.cl.iter().map(point));
    pass.cc.extend(piece.cc.iter().map(point));
    pass.tool_axes.extend(piece.tool_axes.iter().map(vector));
    pass.retract_height = piece.retract_height;
    Ok(())
}

fn empty_patch(msg: &msg::PatchPlan) -> PatchToolpath {
    let plan = plan(msg);
    PatchToolpath {
        patch: plan.patch,
        tool_axis: plan.tool_axis,
        feed_direction: plan.feed_direction,
        pseudo_curvature_max: plan.pseudo_curvature_max,
        sample_count: plan.sample_count,
        step_over: plan.step_over,
        area: plan.area,
        passes: Vec::new(),
    }
}
