//! The orientations of least machining time for a patch: any tool axis and any feed direction within the limits, instead of the
//! paper's most inclined axis along the normals' ellipse.
//!
//! With passes that follow the surface (path_generation's `pass_curves`) a point costs area/(step-over · feed) whatever its neighbours
//! allow, so an orientation's time is a sum over the points. It is searched over a fan of axes around the mean normal, each with
//! feed directions all around, and refined from the best of them by ever smaller turns. An orientation is admitted when at
//! every point the axis leans from the normal by the lead of the rolling ball at least (math: sin θ = R1/(R* − R2), or the least
//! lead) and by the job's largest inclination at the most.

use std::f64::consts::{PI, TAU};

use nalgebra::{Unit, UnitQuaternion, Vector3};
use patchmill_products::job::Job;
use rayon::prelude::*;

use crate::cloud_point::CloudPoint;
use crate::orientation::Orientation;
use crate::step_over::offset_cutter;
use crate::timed_points::TimedPoints;

/// Angle between neighbouring axes of the fan, rad.
const FAN_STEP: f64 = 6.0 * TAU / 360.0;
/// Largest angle of the fan from the mean normal, rad.
const FAN_REACH: f64 = 60.0 * TAU / 360.0;
/// Feed directions tried with each axis over half a turn.
const FEEDS: usize = 8;
/// Those that are refined are at least this far apart, rad.
const APART: f64 = 12.0 * TAU / 360.0;
/// The refinement ends below this turn, rad.
const FINEST: f64 = 0.3 * TAU / 360.0;
/// Times that an axis is moved away from a normal that it is too near to.
const REPAIRS: usize = 40;
/// Dense points that the time of a patch is summed over.
const POINTS: usize = 240;
/// Orientations of the fan that are refined.
const STARTS: usize = 4;
/// What a patch costs beside its passes, s: the index move, the lift and the plunge.
pub const SECONDS_PER_PATCH: f64 = 0.8;
/// What a pass's end costs beside the length over the patch, s: the arcs, half the link, and the corners' speed.
const SECONDS_PER_END: f64 = 0.15;

/// Orientations within the job's limits at all points, the quickest first; may be empty. `leads[i]` is the least lead of
/// `points[i]`, rad; `known` are others that keep the limits.
pub fn quickest_orientations(
    points: &[&CloudPoint],
    leads: &[f64],
    known: &[Orientation],
    job: &Job,
) -> Vec<Orientation> {
    let inner = points.iter().zip(leads).filter(|(p, _)| p.area > 0.0);
    let step = (inner.clone().count() / POINTS).max(1);
    let sample: Vec<(&CloudPoint, f64)> = inner.step_by(step).map(|(p, lead)| (*p, *lead)).collect();
    let Some(mean) = mean_normal(points.iter().copied()) else { return Vec::new() };
    let search = AxisSearch {
        mean,
        timed: TimedPoints::<false>::of(sample.iter().map(|(p, _)| *p), job),
        ends: TimedPoints::<true>::of(std::iter::empty(), job),
        limits: limits(sample),
        job,
    };
    let timed = |o: Orientation| Some((search.time(&o)?, o));
    let mut starts = search.starts(STARTS);
    starts.extend(known.iter().copied().filter_map(timed));
    let refined: Vec<(f64, Orientation)> =
        starts.into_par_iter().map(|(time, o)| search.refined(time, o)).collect();
    let admitted = |(_, o): (f64, Orientation)| timed(search.admitted(o, points, leads)?);
    let mut found: Vec<(f64, Orientation)> = refined.into_iter().filter_map(admitted).collect();
    found.sort_by(|a, b| a.0.total_cmp(&b.0));
    found.into_iter().map(|(_, o)| o).collect()
}

/// Where passes end: a point at the border of a patch, and the border's length there times its outward direction, m.
pub type End<'a> = (&'a CloudPoint, Vector3<f64>);

/// The search over one patch.
pub struct AxisSearch<'a> {
    mean: Unit<Vector3<f64>>,
    /// The time is summed over these.
    timed: TimedPoints<false>,
    /// Where passes end.
    ends: TimedPoints<true>,
    /// Normals, and the cosine of the least lead there.
    limits: Vec<(Vector3<f64>, f64)>,
    job: &'a Job,
}

impl<'a> AxisSearch<'a> {
    /// Over a patch of these points with their least leads (rad), of which `timed` stand for the whole area, and with passes
    /// that end at `ends`; `None` where the mean normal vanishes.
    pub fn new<'p>(
        points: &[(&'p CloudPoint, f64)],
        timed: impl Iterator<Item = &'p CloudPoint>,
        ends: impl Iterator<Item = End<'p>>,
        job: &'a Job,
    ) -> Option<Self> {
        let mean = mean_normal(points.iter().map(|(p, _)| *p))?;
        Some(Self {
            mean,
            timed: TimedPoints::<false>::of(timed, job),
            ends: TimedPoints::<true>::of(ends, job),
            limits: limits(points.iter().copied()),
            job,
        })
    }

    /// The quickest orientation found from the `starts` best ones of the fan: its time, s, and itself; `None` where none is within
    /// the limits.
    pub fn quickest(&self, starts: usize) -> Option<(f64, Orientation)> {
        let refined = self.starts(starts).into_iter().map(|(time, o)| self.refined(time, o));
        refined.min_by(|a, b| a.0.total_cmp(&b.0))
    }

    /// The quickest one found from a known one, which is turned into the limits first where it is a little outside.
    pub fn quickest_from(&self, known: &Orientation) -> Option<(f64, Orientation)> {
        let start = self.orientation(known.axis.into_inner(), known.cross_feed)?;
        let start = self.leant(start)?;
        Some(self.refined(self.time(&start)?, start))
    }

    /// The best ones of the fan that are no neighbours.
    fn starts(&self, count: usize) -> Vec<(f64, Orientation)> {
        let timed: Vec<Vec<(f64, Orientation)>> =
            self.fan().into_par_iter().map(|held| self.timed_around(held)).collect();
        let mut fan: Vec<(f64, Orientation)> = timed.into_iter().flatten().collect();
        fan.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut starts: Vec<(f64, Orientation)> = Vec::new();
        for (time, o) in fan {
            let near = |other: &Orientation| {
                let turn = o.cross_feed.dot(&other.cross_feed).abs().clamp(0.0, 1.0).acos();
                o.axis.angle(&other.axis).max(turn) < APART
            };
            if starts.len() < count && !starts.iter().any(|(_, other)| near(other)) {
                starts.push((time, o));
            }
        }
        starts
    }

    /// Axes all around the mean normal, each with a direction across it.
    fn fan(&self) -> Vec<[Vector3<f64>; 2]> {
        let mean = self.mean.into_inner();
        let u = if mean.x.abs() < 0.9 { Vector3::x() } else { Vector3::y() };
        let u = (u - mean * mean.dot(&u)).normalize();
        let v = mean.cross(&u);
        let mut fan = Vec::new();
        let rings = (FAN_REACH.min(self.job.inclination_max) / FAN_STEP) as usize;
        for ring in 0..=rings {
            let tilt = ring as f64 * FAN_STEP;
            let axes = ((TAU * tilt.sin() / FAN_STEP) as usize).clamp(1, 32);
            for k in 0..axes {
                let turn = TAU * k as f64 / axes as f64;
                let sideways = u * turn.cos() + v * turn.sin();
                fan.push([mean * tilt.cos() + sideways * tilt.sin(), v * turn.cos() - u * turn.sin()]);
            }
        }
        fan
    }

    /// An axis with feed directions all around, and their times, s; none where the axis is outside the limits.
    fn timed_around(&self, [axis, across]: [Vector3<f64>; 2]) -> Vec<(f64, Orientation)> {
        if !self.within(&axis) {
            return Vec::new();
        }
        let feeds: [Option<Orientation>; FEEDS] = std::array::from_fn(|f| {
            let turn = UnitQuaternion::from_scaled_axis(axis * (PI * f as f64 / FEEDS as f64));
            self.orientation(axis, turn * across)
        });
        // A direction that there is none of is timed as any other, and left out.
        let times = self.times(&axis, &feeds.map(|o| o.map_or(across, |o| o.cross_feed)));
        times.into_iter().zip(feeds).filter_map(|(time, o)| Some((time, o?))).collect()
    }

    /// The orientation whose passes lie across `across`, made perpendicular to the axis.
    fn orientation(&self, axis: Vector3<f64>, across: Vector3<f64>) -> Option<Orientation> {
        let axis = Unit::try_new(axis, 1e-9)?;
        let cross_feed = (across - axis.into_inner() * axis.dot(&across)).try_normalize(1e-6)?;
        let feed = cross_feed.cross(&self.mean).try_normalize(1e-6)?;
        Some(Orientation { axis, feed, cross_feed, inclination: 0.0 })
    }

    /// Whether an axis keeps the limits at all points.
    fn within(&self, axis: &Vector3<f64>) -> bool {
        let steepest = self.job.inclination_max.cos();
        let keeps = |(normal, lead): &(Vector3<f64>, f64)| {
            let cosine = normal.dot(axis);
            (cosine >= steepest) & (cosine <= *lead)
        };
        // Some at a time without a branch.
        self.limits.chunks(16).all(|some| some.iter().fold(true, |all, limit| all & keeps(limit)))
    }

    /// Machining time of the patch, s; `None` where a point is outside the limits.
    fn time(&self, o: &Orientation) -> Option<f64> {
        self.within(&o.axis).then(|| self.times(&o.axis, &[o.cross_feed])[0])
    }

    /// The same along an axis within the limits, with passes across each of these.
    fn times<const N: usize>(&self, axis: &Vector3<f64>, across: &[Vector3<f64>; N]) -> [f64; N] {
        let cutter = offset_cutter(self.job);
        let lengths = self.timed.sums(cutter, axis, across);
        let ends = self.ends.sums(cutter, axis, across);
        std::array::from_fn(|k| lengths[k] / self.job.feed + ends[k] * SECONDS_PER_END)
    }

    /// What the passes' ends cost beside the length over the patch, s.
    pub fn time_of_ends(&self, o: &Orientation) -> f64 {
        self.ends.sums(offset_cutter(self.job), &o.axis, &[o.cross_feed])[0] * SECONDS_PER_END
    }

    /// Downhill by turns about the three directions, halved where none helps.
    fn refined(&self, mut time: f64, mut best: Orientation) -> (f64, Orientation) {
        let mut turn = FAN_STEP / 2.0;
        while turn > FINEST {
            let (axis, across) = (best.axis.into_inner(), best.cross_feed);
            let along = across.cross(&axis);
            let about = [axis, across, along, across + along, across - along];
            let tries = about.iter().flat_map(|d| [*d, -*d]).filter_map(|d| {
                let turned = UnitQuaternion::from_scaled_axis(d.normalize() * turn);
                let o = self.orientation(turned * axis, turned * across)?;
                Some((self.time(&o)?, o))
            });
            match tries.min_by(|a, b| a.0.total_cmp(&b.0)).filter(|(t, _)| *t < time) {
                Some(better) => (time, best) = better,
                None => turn *= 0.5,
            }
        }
        (time, best)
    }

    /// The orientation leant until no point of the patch is outside the limits; `None` where that cannot be had.
    fn admitted(&self, mut o: Orientation, points: &[&CloudPoint], leads: &[f64]) -> Option<Orientation> {
        for _ in 0..REPAIRS {
            let short = |(p, lead): (&&CloudPoint, &f64)| (lead - p.normal.angle(&o.axis), p.normal);
            let (worst, normal) = points.iter().zip(leads).map(short).max_by(|a, b| a.0.total_cmp(&b.0))?;
            if worst <= 0.0 {
                let inclination = points.iter().map(|p| p.normal.angle(&o.axis)).fold(0.0, f64::max);
                return (inclination <= self.job.inclination_max).then_some(Orientation { inclination, ..o });
            }
            o = self.leant_by(&o, &normal, worst)?;
        }
        None
    }

    /// The same by the cosines of the search's own limits.
    fn leant(&self, mut o: Orientation) -> Option<Orientation> {
        for _ in 0..REPAIRS {
            let excess = |(normal, lead): &(Vector3<f64>, f64)| (normal.dot(&o.axis) - lead, *normal, *lead);
            let (worst, normal, lead) = self.limits.iter().map(excess).max_by(|a, b| a.0.total_cmp(&b.0))?;
            if worst <= 0.0 {
                return Some(o);
            }
            o = self.leant_by(&o, &normal, lead.acos() - normal.angle(&o.axis))?;
        }
        None
    }

    /// The orientation turned away from a normal by an angle, rad, and a trifle more.
    fn leant_by(&self, o: &Orientation, normal: &Vector3<f64>, angle: f64) -> Option<Orientation> {
        let away = normal.cross(&o.axis).try_normalize(1e-9)?;
        let turned = UnitQuaternion::from_scaled_axis(away * (angle + 1e-5));
        self.orientation(turned * o.axis.into_inner(), o.cross_feed)
    }
}

fn mean_normal<'a>(points: impl Iterator<Item = &'a CloudPoint>) -> Option<Unit<Vector3<f64>>> {
    Unit::try_new(points.map(|p| p.normal * p.area).sum(), 1e-300)
}

fn limits<'a>(points: impl IntoIterator<Item = (&'a CloudPoint, f64)>) -> Vec<(Vector3<f64>, f64)> {
    points.into_iter().map(|(p, lead)| (p.normal, lead.cos())).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::orientation::{least_lead, orientations};
    use nalgebra::{Matrix3, Point3};

    /// A saddle of 80 mm: rises along x, falls along y.
    fn saddle() -> Vec<CloudPoint> {
        let point = |i: usize| {
            let (x, y) = ((i % 60) as f64 * 1.3e-3 - 0.04, (i / 60) as f64 * 1.3e-3 - 0.04);
            CloudPoint {
                position: Point3::new(x, y, 2.0 * (x * x - y * y)),
                normal: Vector3::new(-4.0 * x, 4.0 * y, 1.0).normalize(),
                pseudo_curvature: 4.0,
                curvature: Matrix3::from_diagonal(&Vector3::new(4.0, -4.0, 0.0)),
                facet_error: 0.0,
                area: 1.69e-6,
            }
        };
        (0..3600).map(point).collect()
    }

    #[test]
    fn found_orientations_keep_the_limits_and_are_quicker_than_the_rule() {
        let points = saddle();
        let points: Vec<&CloudPoint> = points.iter().collect();
        let job = Job::default_for("s");
        let leads: Vec<f64> = points
            .iter()
            .map(|p| least_lead(job.tool.cutter, p.pseudo_curvature, job.lead_min).unwrap())
            .collect();
        let found = quickest_orientations(&points, &leads, &[], &job);
        assert!(!found.is_empty());
        for o in &found {
            assert!(o.axis.dot(&o.cross_feed).abs() < 1e-9 && o.feed.dot(&o.cross_feed).abs() < 1e-9);
            for (p, lead) in points.iter().zip(&leads) {
                let lean = p.normal.angle(&o.axis);
                assert!(lean >= lead - 1e-9 && lean <= job.inclination_max + 1e-9);
            }
        }
        let pairs: Vec<(&CloudPoint, f64)> = points.iter().copied().zip(leads.iter().copied()).collect();
        let search = AxisSearch::new(&pairs, points.iter().copied(), std::iter::empty(), &job).unwrap();
        let rule =
            orientations(&points, &leads).iter().filter_map(|o| search.time(o)).fold(f64::INFINITY, f64::min);
        assert!(search.time(&found[0]).unwrap() < rule);
    }

    #[test]
    fn the_search_is_the_same_every_time() {
        let points = saddle();
        let points: Vec<&CloudPoint> = points.iter().collect();
        let job = Job::default_for("s");
        let leads = vec![job.lead_min; points.len()];
        let [a, b] = [0, 1].map(|_| quickest_orientations(&points, &leads, &[], &job));
        assert_eq!(a.len(), b.len());
        assert!(a.iter().zip(&b).all(|(a, b)| a.axis == b.axis && a.cross_feed == b.cross_feed));
    }
}
