//! The evaluation as a message.

use patchmill_msgs::msg;

use super::vectors::{point, point_msg};
use super::{Provenance, WireError, check};
use crate::evaluation::{CandidateEvaluation, Evaluation, Proof, ProofSpot, REST_REGIONS, RestRegion};

/// Most places that a proof names of a kind.
const SPOT_LIMIT: usize = 16;

impl Evaluation {
    /// The evaluation's message.
    ///
    /// # Errors
    /// When the evaluation is not valid, as [`Evaluation::check`] says.
    pub fn to_msg(&self, provenance: &Provenance) -> Result<msg::Evaluation, WireError> {
        self.check()?;
        Ok(msg::Evaluation {
            header: provenance.header(),
            surface_id: provenance.surface_id.clone(),
            job_id: provenance.job_id.clone(),
            candidates: self.candidates.iter().map(candidate_msg).collect(),
            chosen: self.chosen.map_or(-1, |index| index as i32),
        })
    }

    /// The evaluation of a message and its origin.
    ///
    /// # Errors
    /// When the message is not valid.
    pub fn from_msg(msg: &msg::Evaluation) -> Result<(Provenance, Self), WireError> {
        let provenance = Provenance::read(&msg.header, &msg.surface_id, &msg.job_id)?;
        check::expect(msg.chosen >= -1, "the chosen candidate", msg.chosen, "its index or -1")?;
        let evaluation = Self {
            candidates: msg.candidates.iter().map(candidate).collect(),
            chosen: u32::try_from(msg.chosen).ok(),
        };
        evaluation.check()?;
        Ok((provenance, evaluation))
    }

    /// Whether candidates are in order, figures finite, and the chosen one is there and feasible.
    ///
    /// # Errors
    /// With the first thing that is not.
    pub fn check(&self) -> Result<(), WireError> {
        for (candidate, index) in self.candidates.iter().zip(0..) {
            let of = |what: &str| format!("candidate {index}: {what}");
            check::expect(candidate.index == index, &of("its index"), candidate.index, &index.to_string())?;
            check::not_negative(&of("machining time"), candidate.machining_time)?;
            check::not_negative(&of("cut length"), candidate.cut_length)?;
            check::not_negative(&of("rapid length"), candidate.rapid_length)?;
        }
        let Some(chosen) = self.chosen else { return Ok(()) };
        let feasible = self.candidates.get(chosen as usize).is_some_and(|candidate| candidate.feasible);
        check::expect(feasible, "the chosen candidate", chosen, "the index of a feasible one")
    }
}

pub(super) fn proof_msg(proof: &Proof) -> msg::Proof {
    msg::Proof {
        gouge_max: proof.gouge_max,
        scallop_max: proof.scallop_max,
        scallop_p50: proof.scallop_p50,
        scallop_p90: proof.scallop_p90,
        scallop_p99: proof.scallop_p99,
        scallop_p999: proof.scallop_p999,
        area_within_scallop: proof.area_within_scallop,
        uncut_area: proof.uncut_area,
        deepest: proof.deepest.iter().map(spot_msg).collect(),
        highest: proof.highest.iter().map(spot_msg).collect(),
        rest_area: proof.rest_area,
        rest: proof.rest.iter().map(rest_msg).collect(),
    }
}

fn rest_msg(region: &RestRegion) -> msg::RestRegion {
    let [min, max] = region.bounds.map(|corner| point_msg(&corner));
    msg::RestRegion {
        position: point_msg(&region.position),
        min,
        max,
        area: region.area,
        ball_radius: region.ball_radius,
        leftover_max: region.leftover_max,
    }
}

/// The region of a message, not yet checked.
pub fn rest_region(msg: &msg::RestRegion) -> RestRegion {
    RestRegion {
        position: point(&msg.position),
        bounds: [point(&msg.min), point(&msg.max)],
        area: msg.area,
        ball_radius: msg.ball_radius,
        leftover_max: msg.leftover_max,
    }
}

fn spot_msg(spot: &ProofSpot) -> msg::ProofSpot {
    msg::ProofSpot { position: point_msg(&spot.position), leftover: spot.leftover }
}

fn spot(msg: &msg::ProofSpot) -> ProofSpot {
    ProofSpot { position: point(&msg.position), leftover: msg.leftover }
}

pub(super) fn proof(msg: &msg::Proof) -> Proof {
    Proof {
        gouge_max: msg.gouge_max,
        scallop_max: msg.scallop_max,
        scallop_p50: msg.scallop_p50,
        scallop_p90: msg.scallop_p90,
        scallop_p99: msg.scallop_p99,
        scallop_p999: msg.scallop_p999,
        area_within_scallop: msg.area_within_scallop,
        uncut_area: msg.uncut_area,
        deepest: msg.deepest.iter().map(spot).collect(),
        highest: msg.highest.iter().map(spot).collect(),
        rest_area: msg.rest_area,
        rest: msg.rest.iter().map(rest_region).collect(),
    }
}

pub(super) fn check_proof(proof: &Proof) -> Result<(), WireError> {
    check::not_negative("the proof's largest gouge", proof.gouge_max)?;
    check::finite("the proof's largest scallop", proof.scallop_max)?;
    let percentiles = [proof.scallop_p50, proof.scallop_p90, proof.scallop_p99, proof.scallop_p999];
    check::all_finite("the proof's scallop percentile", &percentiles)?;
    for (what, spots) in [("deepest", &proof.deepest), ("highest", &proof.highest)] {
        let what = format!("the number of the proof's {what} places");
        check::expect(spots.len() <= SPOT_LIMIT, &what, spots.len(), &format!("at most {SPOT_LIMIT}"))?;
        for spot in spots {
            check::finite_points("a place of the proof", &[spot.position])?;
            check::finite("a leftover of the proof", spot.leftover)?;
        }
    }
    check::not_negative("the proof's rest area", proof.rest_area)?;
    let regions = proof.rest.len();
    let expected = format!("at most {REST_REGIONS}");
    check::expect(regions <= REST_REGIONS, "the number of the proof's rest regions", regions, &expected)?;
    for region in &proof.rest {
        let [min, max] = region.bounds;
        check::finite_points("a place of a rest region", &[region.position, min, max])?;
        check::not_negative("the area of a rest region", region.area)?;
        check::not_negative("the ball's radius of a rest region", region.ball_radius)?;
        check::finite("the leftover of a rest region", region.leftover_max)?;
    }
    check::within("the proof's share within the scallop height", proof.area_within_scallop, 0.0, 1.0)?;
    check::within("the proof's uncut share", proof.uncut_area, 0.0, 1.0)
}

fn candidate_msg(candidate: &CandidateEvaluation) -> msg::CandidateEvaluation {
    msg::CandidateEvaluation {
        index: candidate.index,
        patch_count: candidate.patch_count,
        feasible: candidate.feasible,
        reason: candidate.reason.clone(),
        machining_time: candidate.machining_time,
        cut_length: candidate.cut_length,
        rapid_length: candidate.rapid_length,
        index_moves: candidate.index_moves,
    }
}

fn candidate(msg: &msg::CandidateEvaluation) -> CandidateEvaluation {
    CandidateEvaluation {
        index: msg.index,
        patch_count: msg.patch_count,
        feasible: msg.feasible,
        reason: msg.reason.clone(),
        machining_time: msg.machining_time,
        cut_length: msg.cut_length,
        rapid_length: msg.rapid_length,
        index_moves: msg.index_moves,
    }
}
