//! Time of a path on the machine: per-axis speed and acceleration limits, look-ahead, standstill between runs.
//!
//! A run is a joint polyline q(s) from standstill to standstill. Feed runs measure s as the way of the tool tip,
//! rapid runs as the time that the slowest axis needs at full speed. On segment i with q′ = Δq/Δs and path speed v
//! axis j moves at |q′ⱼ|·v, so
//!
//! * v ≤ min over j of Vⱼ/|q′ⱼ|, and v ≤ the programmed feed;
//! * |dv/dt| ≤ min over j of Aⱼ/|q′ⱼ|.
//!
//! At a vertex q′ jumps by Δq′. The control rounds it by a parabola: at constant speed v and full acceleration A
//! the jump takes t = v·|Δq′ⱼ|/Aⱼ and leaves the vertex by Aⱼ·t²/8. Two conditions follow:
//!
//! * the parabola fits between the midpoints of the two segments, v·t ≤ (Δs₁+Δs₂)/2 =: d, so v² ≤ Aⱼ·d/|Δq′ⱼ|
//!   (on a finely divided curve |Δq′|/d is its curvature, and this is the centripetal limit);
//! * linear axes leave the vertex by no more than the path tolerance δ (`G64 P`), so v² ≤ 8·δ·Aⱼ/Δq′ⱼ².
//!
//! Vertex speeds are then lowered until each can be reached from its neighbours (v² ≤ v₀² + 2·a·Δs, forward and
//! backward), and each segment is run through with a trapezoid of that acceleration. Acceleration along the path
//! and in its bends are not added up.
//!
//! What else a [`Control`] may do:
//!
//! * **Block processing.** It takes no more than one block in `block_time`: v ≤ Δs/block_time.
//! * **Look-ahead over linear axes only** ([`LookAhead::LinearAxes`], as LinuxCNC's trajectory planner). A move in which a
//!   rotary axis turns is planned by itself from standstill to standstill with half the acceleration, and the next one's
//!   start is laid over its end. Over a move of length Δs that is a mean speed of at most √(½·A·Δs), A along the path.
//! * **Jerk.** The path speed is averaged over the time T = max Aⱼ/Jⱼ of the moving axes, the bell-shaped acceleration of
//!   controls: the path stays, |d²v/dt²| ≤ A/T, and a run from standstill to standstill takes T longer.

use crate::axis::{AxisKind, Joints};
use crate::chain::Machine;

/// Speeds within this of 0 count as standstill, path units per second.
const STANDSTILL: f64 = 1e-9;
/// Segments shorter than this are no motion, path units.
const NO_MOTION: f64 = 1e-12;
/// Stretches of even acceleration shorter than this are worth no point of the trajectory, s.
const WORTH: f64 = 0.005;

/// What limits the motion of the axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxisLimits {
    /// Largest speeds, m/s and rad/s.
    pub velocity: Joints,
    /// Largest accelerations, m/s² and rad/s².
    pub acceleration: Joints,
    /// Largest jerks, m/s³ and rad/s³; infinite where not limited.
    pub jerk: Joints,
    /// How far a linear axis may leave a corner of the path, m (the `P` of `G64`).
    pub corner_tolerance: f64,
    /// Least time of a block, s.
    pub block_time: f64,
    /// Over which moves speeds are planned together.
    pub look_ahead: LookAhead,
}

/// Over which moves a control plans speeds together.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LookAhead {
    /// Over all.
    #[default]
    AllAxes,
    /// Over those of linear axes; moves in which a rotary axis turns are planned one by one.
    LinearAxes,
}

/// How a control runs a path.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Control {
    /// How far a linear axis may leave a corner of the path, m (the `P` of `G64`).
    pub corner_tolerance: f64,
    /// Largest jerk of every linear axis, m/s³; 0: not limited.
    pub jerk_linear: f64,
    /// Largest jerk of every rotary axis, rad/s³; 0: not limited.
    pub jerk_rotary: f64,
    /// Least time of a block, s.
    pub block_time: f64,
    /// Over which moves speeds are planned together.
    pub look_ahead: LookAhead,
}

impl Machine {
    /// The machine's axis limits on a control.
    pub fn limits(&self, control: &Control) -> AxisLimits {
        let axes = self.axes();
        let jerk = |kind| {
            let limit = if kind == AxisKind::Linear { control.jerk_linear } else { control.jerk_rotary };
            if limit > 0.0 { limit } else { f64::INFINITY }
        };
        AxisLimits {
            velocity: std::array::from_fn(|i| axes[i].velocity),
            acceleration: std::array::from_fn(|i| axes[i].acceleration),
            jerk: KINDS.map(jerk),
            corner_tolerance: control.corner_tolerance,
            block_time: control.block_time,
            look_ahead: control.look_ahead,
        }
    }
}

/// A joint polyline from standstill to standstill.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Run {
    points: Vec<Joints>,
    /// Path lengths of the segments: m for feed moves, s for rapids; one less than points.
    lengths: Vec<f64>,
    /// Programmed path speeds of the segments: m/s for feed moves, 1 for rapids.
    caps: Vec<f64>,
}

/// A moment of a motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathPoint {
    /// Time since the start of the run, s.
    pub time: f64,
    /// Joint values, m and rad.
    pub joints: Joints,
    /// Joint speeds, m/s and rad/s; at a corner the mean of before and after.
    pub velocity: Joints,
}

/// When a run is where.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RunTiming {
    /// Time of the whole run, s.
    pub duration: f64,
    /// Time at which each point of the run is reached, s; as long as the run's points.
    pub arrivals: Vec<f64>,
    /// The run's points, and in long segments the moments where acceleration ends and braking begins.
    pub trajectory: Vec<PathPoint>,
}

/// A run of rapids through these joint values: all axes together, as fast as the slowest allows.
pub fn rapid_run(points: &[Joints], limits: &AxisLimits) -> Run {
    let slowest =
        |a: &Joints, b: &Joints| (0..5).map(|j| (b[j] - a[j]).abs() / limits.velocity[j]).fold(0.0, f64::max);
    let lengths: Vec<f64> = points.windows(2).map(|w| slowest(&w[0], &w[1])).collect();
    let caps = vec![1.0; lengths.len()];
    Run { points: points.to_vec(), lengths, caps }
}

/// A run of feed moves: the way of the tip (m) and the programmed feed (m/s) of every segment. A segment on which
/// the tip rests while axes turn is measured by its largest rotary way, and its feed taken as rad/s.
pub fn feed_run(points: &[Joints], tip_ways: &[f64], feeds: &[f64]) -> Run {
    let way = |(w, &tip): (&[Joints], &f64)| {
        if tip > NO_MOTION { tip } else { (0..5).map(|j| (w[1][j] - w[0][j]).abs()).fold(0.0, f64::max) }
    };
    Run {
        points: points.to_vec(),
        lengths: points.windows(2).zip(tip_ways).map(way).collect(),
        caps: feeds.to_vec(),
    }
}

/// A segment with its slopes and limits.
struct Segment {
    from: usize,
    to: usize,
    length: f64,
    slope: Joints,
    cap: f64,
    acceleration: f64,
}

impl Run {
    /// Times the run on axes with these limits.
    pub fn time(&self, limits: &AxisLimits) -> RunTiming {
        let segments = self.segments(limits);
        let speeds = vertex_speeds(&segments, limits);
        let averaging = averaging_time(&segments, limits);
        let Some(first) = self.points.first() else { return RunTiming::default() };
        let mut moments =
            vec![Moment { time: 0.0, way: 0.0, speed: 0.0, joints: *first, slope: [0.0; 5], point: Some(0) }];
        let (mut clock, mut gone) = (0.0, 0.0);
        for (i, segment) in segments.iter().enumerate() {
            let profile = Trapezoid::new(segment, speeds[i], speeds[i + 1]);
            // The average needs every knee, not only those worth a point of the trajectory.
            for (time, way, speed) in profile.knees(if averaging > 0.0 { 0.0 } else { WORTH }) {
                moments.push(Moment {
                    time: clock + time,
                    way: gone + way,
                    speed,
                    joints: self.on(segment, way),
                    slope: segment.slope,
                    point: None,
                });
            }
            clock += profile.duration;
            gone += segment.length;
            let next = segments.get(i + 1).map_or(&segment.slope, |n| &n.slope);
            moments.push(Moment {
                time: clock,
                way: gone,
                speed: speeds[i + 1],
                joints: self.points[segment.to],
                slope: std::array::from_fn(|j| 0.5 * (segment.slope[j] + next[j])),
                point: Some(segment.to),
            });
        }
        if averaging > 0.0 {
            average(&mut moments, averaging);
        }
        self.timing_of(&moments)
    }

    fn timing_of(&self, moments: &[Moment]) -> RunTiming {
        let mut arrivals = vec![0.0; self.points.len()];
        let (mut reached, mut clock) = (0, 0.0);
        for moment in moments {
            let Some(point) = moment.point else { continue };
            // Points without a way to them are reached with the one before.
            arrivals[reached..point].fill(clock);
            clock = moment.time;
            reached = point;
        }
        arrivals[reached..].fill(clock);
        let trajectory = moments.iter().map(|m| PathPoint {
            time: m.time,
            joints: m.joints,
            velocity: m.slope.map(|s| s * m.speed),
        });
        RunTiming { duration: clock, arrivals, trajectory: trajectory.collect() }
    }

    fn segments(&self, limits: &AxisLimits) -> Vec<Segment> {
        let mut segments = Vec::with_capacity(self.lengths.len());
        for (i, (&length, &cap)) in self.lengths.iter().zip(&self.caps).enumerate() {
            if length <= NO_MOTION {
                continue;
            }
            let slope: Joints = std::array::from_fn(|j| (self.points[i + 1][j] - self.points[i][j]) / length);
            let bound = |limit: &Joints| {
                (0..5).map(|j| limit[j] / slope[j].abs().max(1e-12)).fold(f64::INFINITY, f64::min)
            };
            let acceleration = bound(&limits.acceleration);
            let turns = (0..5).any(|j| KINDS[j] == AxisKind::Rotary && slope[j] != 0.0);
            let alone = if turns && limits.look_ahead == LookAhead::LinearAxes {
                (0.5 * acceleration * length).sqrt()
            } else {
                f64::INFINITY
            };
            let processed = if limits.block_time > 0.0 { length / limits.block_time } else { f64::INFINITY };
            let cap = cap.min(bound(&limits.velocity)).min(alone).min(processed);
            segments.push(Segment { from: i, to: i + 1, length, slope, cap, acceleration });
        }
        segments
    }

    /// The joints at `way` along a segment.
    fn on(&self, segment: &Segment, way: f64) -> Joints {
        let start = &self.points[segment.from];
        std::array::from_fn(|j| start[j] + segment.slope[j] * way)
    }
}

/// A moment of a run: between two of them the path speed changes evenly.
struct Moment {
    time: f64,
    /// Path length up to here.
    way: f64,
    speed: f64,
    joints: Joints,
    slope: Joints,
    /// The run's point that is reached.
    point: Option<usize>,
}

/// T = max Aⱼ/Jⱼ over the axes that the run moves, s; 0 where jerk is not limited.
fn averaging_time(segments: &[Segment], limits: &AxisLimits) -> f64 {
    let moves = |j: &usize| segments.iter().any(|s| s.slope[*j] != 0.0);
    (0..5).filter(moves).map(|j| limits.acceleration[j] / limits.jerk[j]).fold(0.0, f64::max)
}

/// Puts a run's moments to the times at which the way s(t), averaged over the last `time` seconds, has got to them:
/// s̄(t) = (S(t) − S(t − T))/T with S the integral of s.
fn average(moments: &mut [Moment], time: f64) {
    let ways = Ways::new(moments);
    let mean = |t: f64| (ways.integral(t) - ways.integral(t - time)) / time;
    let mut low = 0.0;
    let end = ways.end() + time;
    for moment in moments {
        let mut high = end;
        // The means grow with time: bisection down to a nanosecond.
        while high - low > 1e-9 {
            let middle = 0.5 * (low + high);
            if mean(middle) < moment.way { low = middle } else { high = middle }
        }
        // At the ends the mean is flat and its place ill-defined.
        moment.time = if moment.way <= 0.0 {
            0.0
        } else if moment.way >= ways.length() {
            end
        } else {
            high
        };
        low = moment.time.min(low);
        moment.speed = (ways.way(moment.time) - ways.way(moment.time - time)) / time;
    }
}

/// s(t) and its integral between moments of even acceleration.
struct Ways {
    /// (time, way, speed, acceleration until the next, integral of the way).
    knots: Vec<[f64; 5]>,
}

impl Ways {
    fn new(moments: &[Moment]) -> Self {
        let mut knots: Vec<[f64; 5]> = Vec::with_capacity(moments.len());
        let mut integral = 0.0;
        for (i, m) in moments.iter().enumerate() {
            let span = moments.get(i + 1).map_or(0.0, |next| next.time - m.time);
            let rise = moments.get(i + 1).map_or(0.0, |next| next.speed - m.speed);
            let acceleration = if span > 0.0 { rise / span } else { 0.0 };
            knots.push([m.time, m.way, m.speed, acceleration, integral]);
            integral += span * (m.way + span * (m.speed / 2.0 + span * acceleration / 6.0));
        }
        Self { knots }
    }

    fn end(&self) -> f64 {
        self.knots[self.knots.len() - 1][0]
    }

    fn length(&self) -> f64 {
        self.knots[self.knots.len() - 1][1]
    }

    /// The knot at or before `t`, and the time since; the last one's way stays.
    fn at(&self, t: f64) -> ([f64; 5], f64) {
        let place = self.knots.partition_point(|k| k[0] <= t).max(1) - 1;
        let mut knot = self.knots[place];
        if place + 1 == self.knots.len() {
            (knot[2], knot[3]) = (0.0, 0.0);
        }
        (knot, (t - knot[0]).max(0.0))
    }

    fn way(&self, t: f64) -> f64 {
        let ([_, way, speed, acceleration, _], t) = self.at(t);
        way + t * (speed + t * acceleration / 2.0)
    }

    fn integral(&self, t: f64) -> f64 {
        let ([_, way, speed, acceleration, integral], t) = self.at(t);
        integral + t * (way + t * (speed / 2.0 + t * acceleration / 6.0))
    }
}

/// Speeds at the vertices, one more than segments, 0 at both ends.
fn vertex_speeds(segments: &[Segment], limits: &AxisLimits) -> Vec<f64> {
    let mut v = vec![0.0; segments.len() + 1];
    for (i, pair) in segments.windows(2).enumerate() {
        v[i + 1] = corner_speed(&pair[0], &pair[1], limits);
    }
    let reachable = |from: f64, s: &Segment| (from * from + 2.0 * s.acceleration * s.length).sqrt();
    for (i, s) in segments.iter().enumerate() {
        v[i + 1] = f64::min(v[i + 1], reachable(v[i], s));
    }
    for (i, s) in segments.iter().enumerate().rev() {
        v[i] = f64::min(v[i], reachable(v[i + 1], s));
    }
    v
}

fn corner_speed(a: &Segment, b: &Segment, limits: &AxisLimits) -> f64 {
    let reach = 0.5 * (a.length + b.length);
    let mut squared = f64::INFINITY;
    for (j, kind) in KINDS.iter().enumerate() {
        let jump = (b.slope[j] - a.slope[j]).abs().max(1e-12);
        squared = squared.min(limits.acceleration[j] * reach / jump);
        if *kind == AxisKind::Linear {
            squared = squared.min(8.0 * limits.corner_tolerance * limits.acceleration[j] / (jump * jump));
        }
    }
    squared.sqrt().min(a.cap).min(b.cap)
}

/// Kinds of the axes in the order of [`Joints`].
const KINDS: [AxisKind; 5] =
    [AxisKind::Linear, AxisKind::Linear, AxisKind::Linear, AxisKind::Rotary, AxisKind::Rotary];

/// Speed over one segment: up, steady, down.
struct Trapezoid {
    v0: f64,
    peak: f64,
    acceleration: f64,
    up: f64,
    steady: f64,
    duration: f64,
}

impl Trapezoid {
    fn new(segment: &Segment, v0: f64, v1: f64) -> Self {
        let a = segment.acceleration;
        let free = ((v0 * v0 + v1 * v1) / 2.0 + a * segment.length).sqrt();
        let peak = segment.cap.min(free).max(v0).max(v1).max(STANDSTILL);
        let (up, down) = ((peak - v0) / a, (peak - v1) / a);
        let ramps = (2.0 * peak * peak - v0 * v0 - v1 * v1) / (2.0 * a);
        let steady = (segment.length - ramps).max(0.0) / peak;
        Self { v0, peak, acceleration: a, up, steady, duration: up + steady + down }
    }

    /// (time, way, speed) where acceleration ends and braking begins, where both sides of it take longer than `worth` (s).
    fn knees(&self, worth: f64) -> impl Iterator<Item = (f64, f64, f64)> {
        let down = self.duration - self.up - self.steady;
        let way_up = self.v0 * self.up + 0.5 * self.acceleration * self.up * self.up;
        let up = (self.up > worth && self.steady + down > worth).then_some((self.up, way_up, self.peak));
        let brake = (down > worth && self.steady > worth).then_some((
            self.up + self.steady,
            way_up + self.peak * self.steady,
            self.peak,
        ));
        up.into_iter().chain(brake)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn limits() -> AxisLimits {
        AxisLimits {
            velocity: [0.5, 0.5, 0.5, 2.6, 2.6],
            acceleration: [5.0, 5.0, 5.0, 20.0, 20.0],
            jerk: [f64::INFINITY; 5],
            corner_tolerance: 2e-6,
            block_time: 0.0,
            look_ahead: LookAhead::AllAxes,
        }
    }

    /// A zigzag at feed with corners, standstill and long and short segments.
    fn winding() -> Run {
        let points: Vec<Joints> = (0..60)
            .map(|i| {
                let t = f64::from(i);
                [1e-3 * t, 2e-3 * (0.4 * t).sin(), if i == 30 { 1e-3 } else { 0.0 }, 0.002 * t, 0.0]
            })
            .collect();
        let ways: Vec<f64> = points
            .windows(2)
            .map(|w| (0..3).map(|j| (w[1][j] - w[0][j]).powi(2)).sum::<f64>().sqrt())
            .collect();
        feed_run(&points, &ways, &vec![0.05; ways.len()])
    }

    #[test]
    fn limited_jerk_takes_its_averaging_time_longer_and_keeps_jerk_and_path() {
        // T = A/J = 5/50 = 0.1 s for X and 0.2 s where C, 20/100, moves too.
        let smooth = AxisLimits { jerk: [50.0, 50.0, 50.0, 100.0, 100.0], ..limits() };
        let line = rapid_run(&[[0.0; 5], [0.2, 0.0, 0.0, 0.0, 0.0]], &limits());
        let (hard, soft) = (line.time(&limits()), line.time(&smooth));
        assert!((soft.duration - hard.duration - 0.1).abs() < 1e-6, "{} {}", soft.duration, hard.duration);
        let run = winding();
        let (hard, soft) = (run.time(&limits()), run.time(&smooth));
        assert!((soft.duration - hard.duration - 0.2).abs() < 1e-6);
        assert!(soft.arrivals.windows(2).all(|w| w[0] <= w[1]));
        for (point, arrival) in run.points.iter().zip(&soft.arrivals) {
            let there = soft.trajectory.iter().find(|p| (p.time - arrival).abs() < 1e-12).unwrap();
            assert_eq!(there.joints, *point);
        }
        // On the straight line: speeds change by no more than A·t, accelerations by no more than J·t.
        let points = line.time(&smooth).trajectory;
        let accelerations: Vec<(f64, f64)> = points
            .windows(2)
            .filter(|w| w[1].time > w[0].time)
            .map(|w| (w[0].time, (w[1].velocity[0] - w[0].velocity[0]) / (w[1].time - w[0].time)))
            .collect();
        assert!(accelerations.iter().all(|(_, a)| a.abs() <= 5.0 + 1e-6), "{accelerations:?}");
    }

    #[test]
    fn blocks_take_their_time_and_turning_moves_are_planned_one_by_one() {
        let points: Vec<Joints> = (0..=1000).map(|i| [1e-4 * f64::from(i), 0.0, 0.0, 0.0, 0.0]).collect();
        let run = |points: &[Joints], limits: &AxisLimits| {
            feed_run(points, &[1e-4; 1000], &[0.1; 1000]).time(limits).duration
        };
        let free = run(&points, &limits());
        assert!((free - 1.0 - 0.1 / 5.0).abs() < 1e-3, "{free}");
        let slow = run(&points, &AxisLimits { block_time: 2e-3, ..limits() });
        assert!((slow - 2.0).abs() < 0.02, "{slow}");
        // √(½·5·1e-4) = 15.8 mm/s as soon as C turns, however slowly.
        let one_by_one = AxisLimits { look_ahead: LookAhead::LinearAxes, ..limits() };
        assert_eq!(run(&points, &one_by_one), free);
        let turning: Vec<Joints> = points.iter().map(|p| [p[0], 0.0, 0.0, 0.0, p[0]]).collect();
        assert!((run(&turning, &one_by_one) - 0.1 / 0.015_811).abs() < 0.02);
        assert!((run(&turning, &limits()) - free).abs() < 1e-9);
    }

    #[test]
    fn straight_rapid_is_a_trapezoid() {
        // 0.2 m at 0.5 m/s and 5 m/s²: 0.1 s up, 0.1 s down over 0.05 m, 0.15 m steady.
        let timing = rapid_run(&[[0.0; 5], [0.2, 0.0, 0.0, 0.0, 0.0]], &limits()).time(&limits());
        assert!((timing.duration - 0.5).abs() < 1e-12);
        // 10 mm never reaches full speed.
        let short = rapid_run(&[[0.0; 5], [0.01, 0.0, 0.0, 0.0, 0.0]], &limits()).time(&limits());
        assert!((short.duration - 2.0 * (0.01f64 / 5.0).sqrt()).abs() < 1e-12);
    }

    #[test]
    fn slowest_axis_limits_a_rapid() {
        let timing = rapid_run(&[[0.0; 5], [0.01, 0.0, 0.0, 0.0, 3.0]], &limits()).time(&limits());
        assert!((timing.duration - (3.0 / 2.6 + 2.6 / 20.0)).abs() < 1e-12);
    }

    #[test]
    fn collinear_division_costs_nothing_and_a_right_angle_does() {
        let l = limits();
        let line: Vec<Joints> = (0..=100).map(|i| [0.002 * f64::from(i), 0.0, 0.0, 0.0, 0.0]).collect();
        let whole = rapid_run(&[line[0], line[100]], &l).time(&l).duration;
        assert!((rapid_run(&line, &l).time(&l).duration - whole).abs() < 1e-6);
        let leg = rapid_run(&[[0.0; 5], [0.1, 0.0, 0.0, 0.0, 0.0]], &l).time(&l).duration;
        let corner = rapid_run(&[[0.0; 5], [0.1, 0.0, 0.0, 0.0, 0.0], [0.1, 0.1, 0.0, 0.0, 0.0]], &l);
        let corner = corner.time(&l).duration;
        assert!(corner < 2.0 * leg && corner > 1.95 * leg, "{corner} {leg}");
    }

    #[test]
    fn circle_runs_at_the_centripetal_limit() {
        // r = 2 mm, a = 5 m/s²: v ≤ √(5·0.002)·(a little more, the limit is per axis) = 0.1 m/s, feed asks 0.4.
        let n = 2000;
        let points: Vec<Joints> = (0..=10 * n)
            .map(|i| {
                let t = f64::from(i) / f64::from(n) * std::f64::consts::TAU;
                [0.002 * t.cos(), 0.002 * t.sin(), 0.0, 0.0, 0.0]
            })
            .collect();
        let ways: Vec<f64> = vec![0.002 * std::f64::consts::TAU / f64::from(n); 10 * n as usize];
        let timing = feed_run(&points, &ways, &vec![0.4; ways.len()]).time(&limits());
        let mean = ways.iter().sum::<f64>() / timing.duration;
        assert!(mean > 0.09 && mean < 0.12, "{mean}");
        assert_eq!(timing.arrivals.len(), points.len());
        assert!(timing.arrivals.windows(2).all(|w| w[0] <= w[1]));
    }

    #[test]
    fn trajectory_keeps_limits_and_ends_at_rest() {
        let l = limits();
        let timing =
            rapid_run(&[[0.0; 5], [0.2, 0.1, 0.0, 1.0, -2.0], [0.2, 0.1, -0.3, 1.0, -2.0]], &l).time(&l);
        for p in &timing.trajectory {
            assert!((0..5).all(|j| p.velocity[j].abs() <= l.velocity[j] + 1e-9));
        }
        let last = timing.trajectory.last().unwrap();
        assert!((last.time - timing.duration).abs() < 1e-12 && last.velocity.iter().all(|v| *v == 0.0));
        assert!(timing.trajectory.windows(2).all(|w| w[0].time <= w[1].time));
    }

    #[test]
    fn repeated_points_and_empty_runs_are_harmless() {
        let l = limits();
        assert_eq!(Run::default().time(&l).duration, 0.0);
        let p = [0.1, 0.0, 0.0, 0.0, 0.0];
        let timing = rapid_run(&[p, p, [0.2, 0.0, 0.0, 0.0, 0.0], [0.2, 0.0, 0.0, 0.0, 0.0]], &l).time(&l);
        assert_eq!(timing.arrivals[3], timing.duration);
        assert!(timing.duration > 0.0);
    }
}
