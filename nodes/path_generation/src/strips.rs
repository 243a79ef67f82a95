//! The pass planes or curves of a patch, and how the swept check's findings move them.

use nalgebra::{Point3, Vector3};
use patchmill_products::stage::{Progress, StageError};
use patchmill_products::toolpath::{Pass, PatchToolpath};
use rayon::prelude::*;

use crate::pass_layout::{PassLine, PassLines, StripPoint, chains, intervals};
use crate::step_profile::StepProfile;
use patchmill_orientation::cloud_point::CloudPoint;
use patchmill_orientation::pass_curves::{PassCurves, StepField};

/// Gaps along a pass up to this are cut through, m; longer ones are lifted over.
const LONGEST_GAP: f64 = 3e-3;

/// Passes reach beyond the points that they have to cut by this at least, m.
const OVERLAP: f64 = 0.4e-3;
/// What the overlap grows by where a pass ends too early, m.
const LONGER: f64 = 0.75e-3;
/// Leftovers above this many heights are no ridge between passes but a place that none of them reached.
const UNREACHED: f64 = 4.0;
/// Share of the scallop height that ridges between curves are brought to.
const AIM: f64 = 0.99;

/// The passes of a patch with the allowance that they come from.
pub struct Strips {
    lines: Lines,
    overlap: f64,
}

enum Lines {
    Planes { profile: StepProfile, planes: Vec<f64> },
    Curves { field: StepField, curves: PassCurves },
}

impl Strips {
    /// Planes as far apart as the profile allows.
    pub fn planes(profile: StepProfile) -> Self {
        Self { lines: Lines::Planes { planes: profile.planes(), profile }, overlap: OVERLAP }
    }

    /// Curves as far apart as the field allows.
    pub fn curves(mut field: StepField) -> Self {
        field.start_for_least_length();
        Self { lines: Lines::Curves { curves: field.curves(), field }, overlap: OVERLAP }
    }

    /// Length of the passes over the patch, m, and their number: an estimate without cutting them.
    pub fn estimate(&self) -> (f64, usize) {
        match &self.lines {
            Lines::Planes { profile, .. } => profile.estimate(),
            Lines::Curves { field, curves } => field.estimate(curves),
        }
    }

    /// Slope dy/dx of the passes at a place in the tool frame, m.
    pub fn slope_at(&self, x: f64, y: f64) -> f64 {
        match &self.lines {
            Lines::Planes { .. } => 0.0,
            Lines::Curves { curves, .. } => curves.at(curves.nearest(x, y), x).1,
        }
    }

    /// Cuts over the points' intervals of every line with `cut` (line, interval: m), chained from line to line.
    ///
    /// # Errors
    /// SUPERSEDED when cancelled.
    pub fn cut<T: Send>(
        &self,
        points: &[StripPoint],
        progress: Progress,
        cut: impl Fn(PassLine, (f64, f64)) -> T + Sync,
    ) -> Result<Vec<Vec<T>>, StageError> {
        match &self.lines {
            Lines::Planes { planes, .. } => self.cut_along(planes.as_slice(), points, progress, cut),
            Lines::Curves { curves, .. } => self.cut_along(curves, points, progress, cut),
        }
    }

    fn cut_along<T: Send>(
        &self,
        lines: &(impl PassLines + Sync + ?Sized),
        points: &[StripPoint],
        progress: Progress,
        cut: impl Fn(PassLine, (f64, f64)) -> T + Sync,
    ) -> Result<Vec<Vec<T>>, StageError> {
        let needed = intervals(lines, points, self.overlap, LONGEST_GAP);
        let pass = |(line, i): (usize, usize)| {
            progress.check()?;
            Ok(cut(lines.line(line), needed[line][i]))
        };
        chains(&needed).into_iter().map(|chain| chain.into_par_iter().map(pass).collect()).collect()
    }

    /// A patch's toolpath: what its points say of it beside the passes.
    pub fn toolpath(
        &self,
        patch: u32,
        [tool_axis, feed_direction]: [Vector3<f64>; 2],
        points: &[&CloudPoint],
        passes: Vec<Pass>,
    ) -> PatchToolpath {
        PatchToolpath {
            patch,
            tool_axis,
            feed_direction,
            pseudo_curvature_max: points.iter().map(|p| p.pseudo_curvature).fold(f64::NEG_INFINITY, f64::max),
            sample_count: points.iter().filter(|p| p.area == 0.0).count() as u32,
            step_over: self.step_over(),
            area: points.iter().map(|p| p.area).sum(),
            passes,
        }
    }

    /// Least and largest distance between neighbouring passes, m; 0 for a single one.
    fn step_over(&self) -> [f64; 2] {
        let planes = match &self.lines {
            Lines::Planes { planes, .. } => planes,
            Lines::Curves { curves, .. } => return curves.step_over(),
        };
        let steps = || planes.windows(2).map(|w| w[1] - w[0]);
        if planes.len() < 2 {
            return [0.0; 2];
        }
        [steps().fold(f64::INFINITY, f64::min), steps().fold(0.0, f64::max)]
    }

    /// Takes the swept check's findings, (place in the tool frame, leftover) in m: strips with more than `height` (m) left get a
    /// smaller step, passes that end too early a longer overlap, curves with less left a wider step if `widening`.
    pub fn respace(&mut self, left: impl Iterator<Item = (Point3<f64>, f64)>, height: f64, widening: bool) {
        let (unreached, ridges): (Vec<_>, Vec<_>) = left.partition(|(_, left)| *left > UNREACHED * height);
        if !unreached.is_empty() {
            self.overlap += LONGER;
        }
        match &mut self.lines {
            Lines::Planes { profile, planes } => {
                let too_high: Vec<_> = ridges.into_iter().filter(|(_, left)| *left > height).collect();
                tighten_planes(profile, planes, &too_high, height);
            }
            Lines::Curves { field, curves } => {
                field.adapt(curves, &ridges, AIM * height, widening);
                *curves = field.curves();
            }
        }
    }

    /// Whether passes are laid anew even where nothing is left, as far apart as the height allows.
    pub fn adapts(&self) -> bool {
        matches!(self.lines, Lines::Curves { .. })
    }
}

fn tighten_planes(
    profile: &mut StepProfile,
    planes: &mut Vec<f64>,
    ridges: &[(Point3<f64>, f64)],
    height: f64,
) {
    let mut worst = vec![0.0f64; planes.len() + 1];
    for (place, leftover) in ridges {
        let above = planes.partition_point(|plane| *plane < place.y);
        worst[above] = worst[above].max(*leftover);
    }
    let (low, high) = profile.range();
    for (above, leftover) in worst.iter().enumerate().filter(|(_, leftover)| **leftover > 0.0) {
        let factor = (height / leftover).sqrt() * 0.99;
        let (from, to, gap) = match (above.checked_sub(1), planes.get(above)) {
            (Some(below), Some(next)) => (planes[below], *next, next - planes[below]),
            (None, Some(next)) => (low, *next, 2.0 * (next - low)),
            (Some(below), None) => (planes[below], high, 2.0 * (high - planes[below])),
            (None, None) => continue,
        };
        profile.limit(from, to, gap * factor);
    }
    *planes = profile.planes();
}
