//! The result of `plan_surface` for clients on other hosts.
//!
//! A service answer to another host has to fit one datagram of 1.4 KiB: rustdds 0.15.1 garbles fragmented ones. What does not fit is
//! left out and is on the latched topics `machine/evaluation` and `machine/program`, whatever the host.

use patchmill_msgs::action::PlanSurfaceResult;
use patchmill_msgs::cdr;

/// Bytes that a result may have, with room for the headers.
const MOST: usize = 1000;
/// Bytes that its text may have then.
const TEXT: usize = 500;

/// Leaves out the evaluation's candidates and the program's patches when the result does not fit one datagram, and shortens a text that
/// still does not.
pub fn shorten(result: &mut PlanSurfaceResult) {
    if cdr::to_cdr(result).len() <= MOST {
        return;
    }
    result.evaluation.candidates.clear();
    result.program.patches.clear();
    if result.text.len() > TEXT {
        let end = (0..=TEXT).rev().find(|&at| result.text.is_char_boundary(at)).unwrap_or(0);
        result.text.truncate(end);
        result.text.push_str(" …");
    }
}

#[cfg(test)]
mod tests {
    use patchmill_msgs::msg::{CandidateEvaluation, PatchProgram};

    use super::*;

    /// A result with ids of the real length.
    fn result(patches: usize, text: &str) -> PlanSurfaceResult {
        let id = "0123456789abcdef".repeat(4);
        let mut result = PlanSurfaceResult {
            text: text.to_owned(),
            stage: "rolling_ball_analysis".to_owned(),
            surface_id: id.clone(),
            job_id: id.clone(),
            ..PlanSurfaceResult::default()
        };
        let evaluation = &mut result.evaluation;
        evaluation.header.frame_id = "workpiece".to_owned();
        (evaluation.surface_id, evaluation.job_id, evaluation.chosen) = (id.clone(), id.clone(), 3);
        evaluation.candidates = vec![CandidateEvaluation::default(); patches];
        let program = &mut result.program;
        program.header.frame_id = "workpiece".to_owned();
        (program.surface_id, program.job_id, program.content_hash) = (id.clone(), id.clone(), id);
        program.patches = vec![PatchProgram::default(); patches];
        result
    }

    #[test]
    fn a_long_result_fits_one_datagram_and_keeps_its_ids() {
        let mut long = result(8, &"é".repeat(2000));
        assert!(cdr::to_cdr(&long).len() > 1452);
        shorten(&mut long);
        assert!(cdr::to_cdr(&long).len() < 1452 - 150, "{}", cdr::to_cdr(&long).len());
        assert!(long.program.patches.is_empty() && long.evaluation.candidates.is_empty());
        let whole = result(8, "");
        assert_eq!((long.job_id, long.program.job_id), (whole.job_id, whole.program.job_id));
        assert_eq!((long.program.content_hash, long.evaluation.chosen), (whole.program.content_hash, 3));
        assert!(long.text.ends_with('…') && long.text.starts_with('é'));
    }

    #[test]
    fn a_short_result_stays_as_it_is() {
        let mut short = result(0, "cancelled");
        let before = short.clone();
        shorten(&mut short);
        assert_eq!(short, before);
    }
}
