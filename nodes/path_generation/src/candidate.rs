//! One candidate partition: its patches cut, swept, spaced anew where too much is left, and judged.

use nalgebra::{Point3, Unit, Vector3};
use patchmill_geometry::drop_cutter::tool_frame;
use patchmill_geometry::sweep::sweep_fixed_axis;
use patchmill_products::job::Job;
use patchmill_products::partition::{Classifier, Partition, feature};
use patchmill_products::stage::{Progress, StageError};
use patchmill_products::toolpath::{CandidateToolpath, PatchToolpath};
use rayon::prelude::*;

use crate::assembly::{Assembly, HeldAssembly};
use crate::five_axis::plan_five_axis;
use crate::patch::{PatchPlan, PlanError, lacking};
use crate::surface_cloud::CloudPoint;
use crate::{BAD_INPUT, PathParams, PreparedSurface};

/// Share of the area that has to be within the scallop height.
pub(crate) const COVERAGE: f64 = 0.999;
/// Share at which spacing anew stops.
pub(crate) const COVERAGE_AIM: f64 = 0.9997;
/// Swept checks after which curves are laid wider where they can be.
const WIDENINGS: usize = 1;
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
    if job.strategy.simultaneous() {
        return plan_five_axis(surface, partition, job, params, progress);
    }
    let classifier = Classifier::new(partition).ok_or_else(|| {
        let text = format!(
            "candidate {}: a patch's covariance is singular, expected a positive definite one",
            partition.index
        );
        StageError::new(BAD_INPUT, text)
    })?;
    let assembly = Assembly::for_choosing(job);
    let plans = patch_plans(surface, partition, &classifier, job, assembly.as_ref(), progress);
    let cut = plans.and_then(|mut plans| {
        progress.check()?;
        let patches = plans.iter_mut().map(|plan| plan.cut_clear(job, progress)).collect::<Result<_, _>>()?;
        Ok((plans, patches))
    });
    let (mut plans, mut patches): (Vec<PatchPlan>, Vec<PatchToolpath>) = match cut {
        Ok(cut) => cut,
        Err(PlanError::Infeasible(reason)) => return Ok(infeasible(partition, reason)),
        Err(PlanError::Stopped(error)) => return Err(error),
    };
    let owners: Vec<u32> = surface.check_features.par_iter().map(|f| classifier.classify(f) as u32).collect();
    let (mut round, mut best) = (0, None::<([f64; 2], SweptCheck, Vec<PatchToolpath>)>);
    let adapts = plans.iter().any(PatchPlan::adapts);
    loop {
        let check = judge(surface, swept_residual(surface, &patches, job, progress)?, job);
        let widening = adapts && round < WIDENINGS;
        let enough = check.within >= COVERAGE_AIM && !widening;
        let residual = check.residual.clone();
        // What covers enough is the better the shorter it is: wider passes count only once they cover as much again.
        let rank = [check.within.min(COVERAGE_AIM), -cut_length(&patches)];
        if best.as_ref().is_none_or(|(found, ..)| rank > *found) {
            best = Some((rank, check, patches.clone()));
        }
        if enough || round == params.respacing_rounds {
            let Some((_, check, patches)) = best else { return Ok(infeasible(partition, String::new())) };
            let touching = touching(surface, &patches, job);
            return Ok(judged(partition, patches, &check, touching, job));
        }
        for (i, plan) in plans.iter_mut().enumerate() {
            let left = left_over(surface, &residual, &owners, plan.patch);
            if !widening && !left.iter().any(|(_, left)| *left > job.scallop_height) {
                continue;
            }
            plan.respace(&left, job.scallop_height, widening);
            patches[i] = plan.cut(job, progress)?;
        }
        round += 1;
    }
}

/// Length of all passes, m.
fn cut_length(patches: &[PatchToolpath]) -> f64 {
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
        .filter(|(_, points)| !points.is_empty())
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
    surface: &PreparedSurface,
    patches: &[PatchToolpath],
    job: &Job,
    progress: Progress,
) -> Result<Vec<f64>, StageError> {
    let mut residual = vec![f64::INFINITY; surface.check.points.len()];
    let cap = CHECK_CAP * job.scallop_height + job.stock_allowance;
    for patch in patches {
        let polylines: Vec<&[Point3<f64>]> = patch.passes.iter().map(|pass| pass.cl.as_slice()).collect();
        let axis = Unit::new_normalize(patch.tool_axis);
        sweep_fixed_axis(
            &surface.check,
            job.tool.cutter,
            &axis,
            &polylines,
            cap,
            progress.cancelled,
            &mut residual,
        );
        progress.check()?;
    }
    Ok(residual)
}

/// What all patches together leave.
pub(crate) struct SweptCheck {
    /// Leftover above the stock allowance at every point, m.
    pub(crate) residual: Vec<f64>,
    /// Share of the area within the scallop height.
    pub(crate) within: f64,
    /// Largest depth below the surface, m.
    pub(crate) gouge: f64,
}

pub(crate) fn judge(surface: &PreparedSurface, mut residual: Vec<f64>, job: &Job) -> SweptCheck {
    residual.iter_mut().for_each(|left| *left -= job.stock_allowance);
    let weights = || residual.iter().zip(&surface.check.weights);
    let total: f64 = surface.check.weights.iter().sum();
    let good: f64 =
        weights().filter(|(left, _)| **left <= job.scallop_height).map(|(_, weight)| weight).sum();
    let gouge = residual.iter().fold(0.0f64, |gouge, left| gouge.max(-left));
    SweptCheck { within: good / total, gouge, residual }
}

fn left_over(
    surface: &PreparedSurface,
    residual: &[f64],
    owners: &[u32],
    patch: u32,
) -> Vec<(Point3<f64>, f64)> {
    (0..residual.len())
        .filter(|&i| owners[i] == patch)
        .map(|i| (surface.check.points[i], residual[i]))
        .collect()
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
