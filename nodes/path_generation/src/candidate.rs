//! One candidate partition: its patches cut, swept, spaced anew where too much is left, and judged.

use nalgebra::{Point3, Unit, Vector3};
use patchmill_geometry::drop_cutter::tool_frame;
use patchmill_geometry::sweep::{ProofPoints, sweep_fixed_axis};
use patchmill_orientation::axis_search::SECONDS_PER_PATCH;
use patchmill_products::job::{Job, Strategy};
use patchmill_products::partition::{Classifier, Partition, feature};
use patchmill_products::stage::{Progress, StageError};
use patchmill_products::toolpath::{CandidateToolpath, PatchToolpath};
use rayon::prelude::*;

use crate::assembly::{Assembly, HeldAssembly};
use crate::five_axis::plan_five_axis;
use crate::pass_trimming::{CutPieces, PatchTips, trimmed};
use crate::patch::{PatchCut, PatchPlan, PlanError, lacking};
use crate::{BAD_INPUT, COMPARED, PathParams, PreparedSurface};
use patchmill_orientation::cloud_point::CloudPoint;

/// Share of the area that has to be within the scallop height.
pub(crate) const COVERAGE: f64 = 0.999;
/// Share at which spacing anew stops.
pub(crate) const COVERAGE_AIM: f64 = 0.9997;
/// The same of a candidate that is not worked on to the end, or whose trimmed passes do not come to the aim: enough for the program's
/// own proof.
const COVERED: f64 = 0.9993;
/// Swept checks after which curves are laid wider where they can be.
const WIDENINGS: usize = 1;
/// Shares of the distance of the points that passes are trimmed by, that passes keep beyond what those ask for: the next one where the
/// swept check, which looks at other points, finds too much left.
const TRIMMING_MARGINS: [f64; 3] = [0.5, 1.0, 2.0];
/// What a piece costs beside its length where candidates are compared, as a length, m: the link to the next one.
const LINK: f64 = 5e-3;
/// Leftovers above this many scallop heights need not be known exactly.
pub(crate) const CHECK_CAP: f64 = 6.0;

/// Plans the toolpath of one partition. A partition that cannot meet the job's tolerances gives a toolpath with its
/// `infeasible_reason`, not an error.
///
/// # Errors
/// [`BAD_INPUT`] when the partition's statistics cannot classify points; SUPERSEDED when cancelled.
pub fn plan_candidate(
    surface: &PreparedSurface,
    partition: &Partition,
    job: &Job,
    params: &PathParams,
    progress: Progress,
) -> Result<CandidateToolpath, StageError> {
    let assembly = Assembly::for_choosing(job);
    match begun(surface, partition, job, params, assembly.as_ref(), progress)? {
        Begun::Planned(toolpath) => Ok(toolpath),
        Begun::Draft(draft) => draft.finished(true, params, progress),
    }
}

/// A candidate after its first cut.
pub(crate) enum Begun<'a> {
    /// It has no other.
    Planned(CandidateToolpath),
    /// To be spaced anew and judged.
    Draft(Box<Draft<'a>>),
}

/// Chooses the orientations and cuts for the first time; `assembly` is what of the job's tool has to keep off the part.
pub(crate) fn begun<'a>(
    surface: &'a PreparedSurface,
    partition: &'a Partition,
    job: &'a Job,
    params: &PathParams,
    assembly: Option<&'a Assembly>,
    progress: Progress,
) -> Result<Begun<'a>, StageError> {
    if job.strategy.simultaneous() {
        return Ok(Begun::Planned(plan_five_axis(surface, partition, job, params, progress)?));
    }
    let classifier = Classifier::new(partition).ok_or_else(|| {
        let text = format!(
            "candidate {}: a patch's covariance is singular, expected a positive definite one",
            partition.index
        );
        StageError::new(BAD_INPUT, text)
    })?;
    let plans = patch_plans(surface, partition, &classifier, job, assembly, progress);
    let cut = plans.and_then(|mut plans| {
        progress.check()?;
        let cut = |plan: &mut PatchPlan| {
            let cut = plan.cut_clear(job, progress);
            // Many candidates are begun before the first is worked on.
            plan.cutter.release();
            cut
        };
        let cuts = plans.iter_mut().map(cut).collect::<Result<_, _>>()?;
        Ok((plans, cuts))
    });
    let (plans, cuts): (Vec<PatchPlan>, Vec<PatchCut>) = match cut {
        Ok(cut) => cut,
        Err(PlanError::Infeasible(reason)) => return Ok(Begun::Planned(infeasible(partition, reason))),
        Err(PlanError::Stopped(error)) => return Err(error),
    };
    let owners = surface.check_features.par_iter().map(|f| classifier.classify(f) as u32).collect();
    Ok(Begun::Draft(Box::new(Draft { surface, partition, job, plans, cuts, owners })))
}

/// A candidate whose patches are cut, not yet judged.
pub(crate) struct Draft<'a> {
    surface: &'a PreparedSurface,
    partition: &'a Partition,
    job: &'a Job,
    plans: Vec<PatchPlan<'a>>,
    cuts: Vec<PatchCut>,
    /// The patch of every point of the swept check.
    owners: Vec<u32>,
}

impl Draft<'_> {
    /// Machining time of the first cut once trimmed, s: for comparison among the candidates of a job.
    ///
    /// # Errors
    /// SUPERSEDED when cancelled.
    pub(crate) fn time(&self, progress: Progress) -> Result<f64, StageError> {
        let points = &self.surface.compared;
        let kept =
            CutPieces::find(points, &self.tips(&self.cuts), self.job, progress)?.kept(TRIMMING_MARGINS[0]);
        let pieces = kept.iter().flatten().flatten();
        let length: f64 = pieces.map(|[from, to]| to - from + LINK).sum();
        Ok(length / self.job.feed + self.plans.len() as f64 * SECONDS_PER_PATCH)
    }

    fn tips(&self, cuts: &[PatchCut]) -> Vec<PatchTips> {
        self.plans.iter().zip(cuts).map(|(plan, cut)| plan.tips(&cut.chains, self.job)).collect()
    }

    /// Sweeps, spaces anew where too much is left and judges; if it `refines`, passes are also laid wider where they may, and trimmed
    /// in the end, both where the least time is asked for.
    ///
    /// # Errors
    /// SUPERSEDED when cancelled.
    pub(crate) fn finished(
        mut self,
        refines: bool,
        params: &PathParams,
        progress: Progress,
    ) -> Result<CandidateToolpath, StageError> {
        let (surface, job) = (self.surface, self.job);
        let (mut round, mut best) = (0, None::<([f64; 2], SweptCheck, Vec<PatchCut>)>);
        // What is not worked on to the end only has to cover the surface, by fewer points.
        let whole = refines || job.strategy != Strategy::Fastest;
        let aim = if whole { COVERAGE_AIM } else { COVERED };
        let points = if whole { &surface.check } else { &surface.compared };
        let share = if whole { 1 } else { COMPARED };
        let owners: Vec<u32> = self.owners.iter().step_by(share).copied().collect();
        let rest: Vec<bool> = surface.rest.iter().step_by(share).copied().collect();
        let adapts = refines && self.plans.iter().any(PatchPlan::adapts);
        loop {
            let toolpaths: Vec<&PatchToolpath> = self.cuts.iter().map(|cut| &cut.toolpath).collect();
            let check = judge(points, &rest, swept_residual(points, &toolpaths, job, progress)?, job);
            let widening = adapts && round < WIDENINGS;
            let enough = check.within >= aim && !widening;
            let residual = check.residual.clone();
            // What covers enough is the better the shorter it is: wider passes count only once they cover as much again.
            let rank = [check.within.min(COVERAGE_AIM), -cut_length(&toolpaths)];
            if best.as_ref().is_none_or(|(found, ..)| rank > *found) {
                best = Some((rank, check, self.cuts.clone()));
            }
            if enough || round == params.respacing_rounds {
                let Some((_, check, cuts)) = best else {
                    return Ok(infeasible(self.partition, String::new()));
                };
                return self.judged(cuts, &check, refines, progress);
            }
            for (i, plan) in self.plans.iter_mut().enumerate() {
                let left = left_over(points, &residual, &owners, plan.patch);
                if !widening && !left.iter().any(|(_, left)| *left > job.scallop_height) {
                    continue;
                }
                plan.respace(&left, job.scallop_height, widening);
                self.cuts[i] = plan.cut(job, progress)?;
            }
            round += 1;
        }
    }

    /// The toolpath, if it `refines` with passes trimmed where the least time is asked for and nothing speaks against it.
    fn judged(
        self,
        cuts: Vec<PatchCut>,
        check: &SweptCheck,
        refines: bool,
        progress: Progress,
    ) -> Result<CandidateToolpath, StageError> {
        let (surface, job) = (self.surface, self.job);
        // A margin beyond the border is wanted there, though no point asks for it.
        let trims = refines && job.strategy == Strategy::Fastest && job.border_margin == 0.0;
        let pieces = match trims {
            true => Some(CutPieces::find(&surface.trimming, &self.tips(&cuts), job, progress)?),
            false => None,
        };
        let mut best: Option<(f64, CandidateToolpath)> = None;
        for (pieces, margin) in pieces.iter().flat_map(|pieces| TRIMMING_MARGINS.map(|m| (pieces, m))) {
            let kept = pieces.kept(margin);
            let pieces = self.plans.iter().zip(&cuts).zip(&kept);
            let patches: Vec<PatchToolpath> = pieces
                .filter(|(_, kept)| kept.iter().any(Option::is_some))
                .map(|((plan, cut), kept)| plan.linked(trimmed(&cut.chains, kept), job))
                .collect();
            let residual =
                swept_residual(&surface.check, &patches.iter().collect::<Vec<_>>(), job, progress)?;
            let trimmed = judge(&surface.check, &surface.rest, residual, job);
            if trimmed.within < COVERED || best.as_ref().is_some_and(|(within, _)| *within >= trimmed.within)
            {
                continue;
            }
            let within = trimmed.within;
            let trimmed = self.verdict(patches, &trimmed);
            if trimmed.infeasible_reason.is_empty() {
                if within >= COVERAGE_AIM.min(check.within) {
                    return Ok(trimmed);
                }
                best = Some((within, trimmed));
            }
        }
        if let Some((_, trimmed)) = best {
            return Ok(trimmed);
        }
        Ok(self.verdict(cuts.into_iter().map(|cut| cut.toolpath).collect(), check))
    }

    fn verdict(&self, patches: Vec<PatchToolpath>, check: &SweptCheck) -> CandidateToolpath {
        let touching = touching(self.surface, &patches, self.job);
        judged(self.partition, patches, check, touching, self.job)
    }
}

/// Length of all passes, m.
fn cut_length(patches: &[&PatchToolpath]) -> f64 {
    let moves = patches.iter().flat_map(|patch| &patch.passes).flat_map(|pass| pass.cl.windows(2));
    moves.map(|w| (w[1] - w[0]).norm()).sum()
}

/// What shank and holder touch along the finished passes, spaced anew since their orientation was chosen.
fn touching(surface: &PreparedSurface, patches: &[PatchToolpath], job: &Job) -> Option<String> {
    let assembly = Assembly::for_finished(job)?;
    patches.iter().find_map(|patch| {
        let axis = Unit::new_normalize(patch.tool_axis);
        let frame = tool_frame(&axis, &patch.feed_direction);
        let held = HeldAssembly::new(&assembly, &surface.mesh, &surface.bvh, frame);
        let collision = held.collision_along(&patch.passes, &axis);
        (!collision.is_clear()).then(|| format!("patch {}: {}", patch.patch, lacking(&collision, job)))
    })
}

fn patch_plans<'a>(
    surface: &'a PreparedSurface,
    partition: &Partition,
    classifier: &Classifier,
    job: &'a Job,
    assembly: Option<&'a Assembly>,
    progress: Progress,
) -> Result<Vec<PatchPlan<'a>>, PlanError> {
    let labels: Vec<usize> = surface
        .cloud
        .par_iter()
        .map(|p| classifier.classify(&feature(&p.position, p.pseudo_curvature)))
        .collect();
    let mut members: Vec<Vec<&CloudPoint>> = vec![Vec::new(); partition.patches.len()];
    for (point, label) in surface.cloud.iter().zip(&labels) {
        members[*label].push(point);
    }
    let plans: Vec<PatchPlan> = members
        .into_par_iter()
        .enumerate()
        // One that has nothing but places on the border has nothing to cut.
        .filter(|(_, points)| points.iter().any(|p| p.area > 0.0))
        .map(|(patch, points)| PatchPlan::new(surface, patch as u32, points, job, assembly, progress))
        .collect::<Result<_, _>>()?;
    Ok(in_cutting_order(plans))
}

/// Greedily the patch whose tool axis is nearest to the last one's, from the most upright: short index moves.
fn in_cutting_order(mut plans: Vec<PatchPlan>) -> Vec<PatchPlan> {
    let (mut ordered, mut axis) = (Vec::with_capacity(plans.len()), Vector3::z());
    while !plans.is_empty() {
        let nearness = |i: &usize| plans[*i].orientation.axis.dot(&axis);
        let next = (0..plans.len()).max_by(|a, b| nearness(a).total_cmp(&nearness(b)).then(b.cmp(a)));
        let plan = plans.remove(next.unwrap_or(0));
        axis = plan.orientation.axis.into_inner();
        ordered.push(plan);
    }
    ordered
}

/// Normal distance from every point of the check to the cutter swept over all passes, m. One patch after the other, so
/// that what one has cut deep need not be looked at closely under the next.
fn swept_residual(
    points: &ProofPoints,
    patches: &[&PatchToolpath],
    job: &Job,
    progress: Progress,
) -> Result<Vec<f64>, StageError> {
    let mut residual = vec![f64::INFINITY; points.len()];
    let cap = CHECK_CAP * job.scallop_height + job.stock_allowance;
    for patch in patches {
        let polylines: Vec<&[Point3<f64>]> = patch.passes.iter().map(|pass| pass.cl.as_slice()).collect();
        let axis = Unit::new_normalize(patch.tool_axis);
        sweep_fixed_axis(points, job.tool.cutter, &axis, &polylines, cap, progress.cancelled, &mut residual);
        progress.check()?;
    }
    Ok(residual)
}

/// What all patches together leave.
pub(crate) struct SweptCheck {
    /// Leftover above the stock allowance at every point, m; at most 0 where the tool does not fit.
    pub(crate) residual: Vec<f64>,
    /// Share of the area where the tool fits within the scallop height.
    pub(crate) within: f64,
    /// Largest depth below the surface, m.
    pub(crate) gouge: f64,
}

/// `rest` marks the points where the tool does not fit; empty: none.
pub(crate) fn judge(points: &ProofPoints, rest: &[bool], mut residual: Vec<f64>, job: &Job) -> SweptCheck {
    let stands = |i: usize| rest.get(i).is_some_and(|rest| *rest);
    for (i, left) in residual.iter_mut().enumerate() {
        *left -= job.stock_allowance;
        if stands(i) {
            *left = left.min(0.0);
        }
    }
    let weights = || residual.iter().zip(&points.weights).enumerate().filter(|(i, _)| !stands(*i));
    let total: f64 = weights().map(|(_, (_, weight))| weight).sum();
    let good: f64 =
        weights().filter(|(_, (left, _))| **left <= job.scallop_height).map(|(_, (_, weight))| weight).sum();
    let gouge = residual.iter().fold(0.0f64, |gouge, left| gouge.max(-left));
    SweptCheck { within: good / total, gouge, residual }
}

fn left_over(points: &ProofPoints, residual: &[f64], owners: &[u32], patch: u32) -> Vec<(Point3<f64>, f64)> {
    (0..residual.len()).filter(|&i| owners[i] == patch).map(|i| (points.points[i], residual[i])).collect()
}

pub(crate) fn judged(
    partition: &Partition,
    patches: Vec<PatchToolpath>,
    check: &SweptCheck,
    touching: Option<String>,
    job: &Job,
) -> CandidateToolpath {
    let reason = if let Some(touching) = touching {
        touching
    } else if check.gouge > job.gouge_tolerance {
        format!("gouges {:.4} mm, allowed are {:.4} mm", check.gouge * 1e3, job.gouge_tolerance * 1e3)
    } else if check.within < COVERAGE {
        format!(
            "leaves {:.3} % of the area above the scallop height of {:.4} mm, allowed are {:.1} %",
            100.0 * (1.0 - check.within),
            job.scallop_height * 1e3,
            100.0 * (1.0 - COVERAGE)
        )
    } else {
        String::new()
    };
    CandidateToolpath {
        patches,
        area_within_scallop: check.within,
        gouge_max: check.gouge,
        ..infeasible(partition, reason)
    }
}

pub(crate) fn infeasible(partition: &Partition, reason: String) -> CandidateToolpath {
    CandidateToolpath {
        index: partition.index,
        count: partition.count,
        patch_count: partition.patches.len() as u32,
        infeasible_reason: reason,
        patches: Vec::new(),
        area_within_scallop: 0.0,
        gouge_max: 0.0,
    }
}
