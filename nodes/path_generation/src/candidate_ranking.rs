//! All candidates of a job: which of them are worked on to the end.
//!
//! Spacing the passes anew takes most of the time of planning. With [`Strategy::Fastest`] all candidates are cut once, and only
//! the quickest few of them are then spaced as wide as the scallop height allows and trimmed; the others are brought to cover
//! the surface and no further. What a candidate becomes depends on the candidates, never on the order in which they get ready.

use patchmill_products::job::{Job, Strategy};
use patchmill_products::partition::Partition;
use patchmill_products::stage::{Progress, StageError};
use patchmill_products::toolpath::CandidateToolpath;
use rayon::prelude::*;

use crate::assembly::Assembly;
use crate::candidate::{Begun, begun, plan_candidate};
use crate::{PathParams, PreparedSurface};

/// Candidates that are spaced as wide as the scallop height allows, and trimmed.
const REFINED: usize = 3;

/// Plans all candidates in parallel and hands each over to `ready` when it is.
///
/// # Errors
/// As [`plan_candidate`], and those of `ready`.
pub fn plan_candidates(
    surface: &PreparedSurface,
    partitions: &[Partition],
    job: &Job,
    params: &PathParams,
    progress: Progress,
    ready: &(dyn Fn(CandidateToolpath) -> Result<(), StageError> + Sync),
) -> Result<(), StageError> {
    if job.strategy != Strategy::Fastest || partitions.len() <= REFINED {
        return partitions
            .par_iter()
            .try_for_each(|partition| ready(plan_candidate(surface, partition, job, params, progress)?));
    }
    let assembly = Assembly::for_choosing(job);
    let begin = |partition| {
        let begun = begun(surface, partition, job, params, assembly.as_ref(), progress)?;
        let time = match &begun {
            Begun::Planned(_) => f64::INFINITY,
            Begun::Draft(draft) => draft.time(progress)?,
        };
        Ok((time, begun))
    };
    let begun: Vec<(f64, Begun)> = partitions.par_iter().map(begin).collect::<Result<_, StageError>>()?;
    let refined = quickest(&begun.iter().map(|(time, _)| *time).collect::<Vec<_>>(), REFINED);
    begun.into_par_iter().zip(refined).try_for_each(|((_, begun), refines)| {
        ready(match begun {
            Begun::Planned(toolpath) => toolpath,
            Begun::Draft(draft) => draft.finished(refines, params, progress)?,
        })
    })
}

/// Whether each is among the `count` of least time, the earlier of equal ones first.
fn quickest(times: &[f64], count: usize) -> Vec<bool> {
    let mut order: Vec<usize> = (0..times.len()).collect();
    order.sort_by(|&a, &b| times[a].total_cmp(&times[b]).then(a.cmp(&b)));
    let mut among = vec![false; times.len()];
    order.into_iter().take(count).for_each(|i| among[i] = true);
    among
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_quickest_are_found_and_ties_go_to_the_first() {
        assert_eq!(quickest(&[3.0, 1.0, 2.0, 1.0, 1.0], 2), [false, true, false, true, false]);
        assert_eq!(quickest(&[f64::INFINITY, 4.0], 3), [true, true]);
    }
}
