//! The motion to look at: few enough points for the moving tool, and bands of position and speed over time that hide no peak.

use nalgebra::{Point3, Unit, Vector3};
use patchmill_kinematics::{AxisKind, Joints, Machine};

use crate::axes::Moves;

/// Tolerances that points are left out with first, m and rad; doubled until the points are few enough.
const LINEAR: f64 = 20e-6;
const ROTARY: f64 = 1e-4;
/// Where axes turn, points are put in until the tip is within this of the straight line between them, m.
const TURNING: f64 = 0.2e-3;
/// How often a move is halved for that.
const HALVINGS: u32 = 6;

/// A point of the moving tool.
#[derive(Clone, Debug, PartialEq)]
pub struct Stop {
    /// From the program's start, s.
    pub time: f64,
    /// Positions of the axes, m and rad.
    pub joints: Joints,
    /// Tool tip, `workpiece` frame, m.
    pub tip: Point3<f64>,
    /// Tool axis, tip to spindle, `workpiece` frame.
    pub axis: Unit<Vector3<f64>>,
}

/// The tool's way with about `most` points: between them the axes move evenly.
pub fn stops(moves: &Moves, machine: &Machine, most: usize) -> Vec<Stop> {
    let stop = |time: f64, joints: Joints| {
        let pose = machine.pose(&joints);
        Stop { time, joints, tip: pose.tip, axis: pose.axis }
    };
    let mut stops: Vec<Stop> = Vec::new();
    for i in kept(moves, machine, most) {
        let next = stop(moves.times[i], moves.positions[i]);
        if let Some(last) = stops.last().cloned() {
            halve(&last, &next, HALVINGS, &stop, &mut stops);
        }
        stops.push(next);
    }
    stops
}

/// Puts points between two where the tip leaves the straight line.
fn halve(a: &Stop, b: &Stop, left: u32, stop: &impl Fn(f64, Joints) -> Stop, into: &mut Vec<Stop>) {
    if left == 0 || (3..5).all(|k| a.joints[k] == b.joints[k]) {
        return;
    }
    let joints = std::array::from_fn(|k| 0.5 * (a.joints[k] + b.joints[k]));
    let middle = stop(0.5 * (a.time + b.time), joints);
    if (middle.tip - nalgebra::center(&a.tip, &b.tip)).norm() > TURNING {
        halve(a, &middle, left - 1, stop, into);
        into.push(middle.clone());
        halve(&middle, b, left - 1, stop, into);
    }
}

/// Douglas and Peucker's points of the motion over time, `most` or fewer where the tolerance allows it.
fn kept(moves: &Moves, machine: &Machine, most: usize) -> Vec<usize> {
    let tolerance = |kind: AxisKind| if kind == AxisKind::Linear { LINEAR } else { ROTARY };
    let mut tolerances: Vec<f64> = machine.axes().iter().map(|a| tolerance(a.kind)).collect();
    loop {
        let kept = within(moves, &tolerances);
        // 20 µm doubled 20 times is longer than any machine.
        if kept.len() <= most || tolerances[0] > 20.0 {
            return kept;
        }
        tolerances.iter_mut().for_each(|t| *t *= 2.0);
    }
}

fn within(moves: &Moves, tolerances: &[f64]) -> Vec<usize> {
    let Some(end) = moves.times.len().checked_sub(1) else { return Vec::new() };
    let mut keep = vec![false; end + 1];
    (keep[0], keep[end]) = (true, true);
    let mut pending = vec![(0, end)];
    while let Some((first, last)) = pending.pop() {
        let span = moves.times[last] - moves.times[first];
        let (a, b) = (&moves.positions[first], &moves.positions[last]);
        let away = |i: usize| {
            let share = if span > 0.0 { (moves.times[i] - moves.times[first]) / span } else { 0.0 };
            let of =
                |k: usize| (moves.positions[i][k] - (a[k] + (b[k] - a[k]) * share)).abs() / tolerances[k];
            (0..5).map(of).fold(0.0, f64::max)
        };
        let mut farthest = (1.0, None);
        for i in first + 1..last {
            let distance = away(i);
            if distance > farthest.0 {
                farthest = (distance, Some(i));
            }
        }
        if let Some(i) = farthest.1 {
            keep[i] = true;
            pending.extend([(first, i), (i, last)]);
        }
    }
    (0..=end).filter(|&i| keep[i]).collect()
}

/// Least and largest values of every axis in equal parts of the program's time, part after part, five axes each.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Bands {
    /// Positions, m and rad.
    pub positions: Vec<[[f64; 2]; 5]>,
    /// Velocities, m/s and rad/s.
    pub velocities: Vec<[[f64; 2]; 5]>,
}

/// The bands of a motion in so many parts: every point counts in its part, and a move in all parts that it passes.
pub fn bands(moves: &Moves, parts: usize) -> Bands {
    let duration = moves.duration().max(f64::MIN_POSITIVE);
    let empty = [[f64::INFINITY, f64::NEG_INFINITY]; 5];
    let mut bands = Bands { positions: vec![empty; parts], velocities: vec![empty; parts] };
    let mut count = |time: f64, q: &Joints, v: &Joints, part: Option<usize>| {
        let part = part.unwrap_or((time / duration * parts as f64) as usize).min(parts - 1);
        for k in 0..5 {
            for (band, value) in [(&mut bands.positions, q[k]), (&mut bands.velocities, v[k])] {
                let [low, high] = &mut band[part][k];
                (*low, *high) = (low.min(value), high.max(value));
            }
        }
    };
    for i in 0..moves.times.len() {
        count(moves.times[i], &moves.positions[i], &moves.velocities[i], None);
        let Some(&next) = moves.times.get(i + 1) else { break };
        let (time, span) = (moves.times[i], next - moves.times[i]);
        let first = (time / duration * parts as f64) as usize + 1;
        let last = ((next / duration * parts as f64) as usize).min(parts - 1);
        for border in first..=last {
            // Where a move goes from one part into the next it counts in both.
            let share = (border as f64 * duration / parts as f64 - time) / span;
            let mixed =
                |rows: &[Joints]| std::array::from_fn(|k| rows[i][k] + (rows[i + 1][k] - rows[i][k]) * share);
            let (q, v) = (mixed(&moves.positions), mixed(&moves.velocities));
            count(time, &q, &v, Some(border - 1));
            count(time, &q, &v, Some(border));
        }
    }
    bands
}

#[cfg(test)]
mod tests {
    use super::*;
    use patchmill_kinematics::Accelerations;
    use patchmill_machine_interface::DEFAULT_MACHINE_URDF;
    use patchmill_products::program::JointMotion;

    fn machine() -> Machine {
        let accelerations = Accelerations { linear: 5.0, rotary: 20.0 };
        Machine::from_urdf(DEFAULT_MACHINE_URDF, 0.1, accelerations).unwrap()
    }

    fn moves(points: &[(f64, Joints, Joints)]) -> Moves {
        let column = |of: fn(&(f64, Joints, Joints)) -> Joints| points.iter().map(of).collect();
        Moves {
            times: points.iter().map(|p| p.0).collect(),
            positions: column(|p| p.1),
            velocities: column(|p| p.2),
        }
    }

    #[test]
    fn even_moves_need_their_ends_only_and_a_turn_keeps_the_tip_on_its_arc() {
        let machine = machine();
        let even = |i: usize| (i as f64, [1e-3 * i as f64, 0.0, -0.3, 0.0, 0.0], [1e-3, 0.0, 0.0, 0.0, 0.0]);
        let mut points: Vec<_> = (0..100).map(even).collect();
        assert_eq!(stops(&moves(&points), &machine, 1000).len(), 2);
        points.push((100.0, [0.099, 0.0, -0.3, 0.0, 1.5], [0.0; 5]));
        let way = stops(&moves(&points), &machine, 1000);
        assert!(way.len() > 10 && way.windows(2).all(|w| w[0].time < w[1].time));
        for pair in way.windows(2) {
            let joints = std::array::from_fn(|k| 0.5 * (pair[0].joints[k] + pair[1].joints[k]));
            let chord = nalgebra::center(&pair[0].tip, &pair[1].tip);
            assert!((machine.pose(&joints).tip - chord).norm() <= TURNING);
        }
    }

    #[test]
    fn too_many_points_are_left_out_within_a_wider_tolerance() {
        let wave = |i: usize| (i as f64 * 0.01, [1e-3 * (i as f64).sin(), 0.0, -0.3, 0.0, 0.0], [0.0; 5]);
        let points: Vec<_> = (0..2000).map(wave).collect();
        assert!(stops(&moves(&points), &machine(), 100_000).len() > 1000);
        assert!(stops(&moves(&points), &machine(), 100).len() <= 100);
    }

    #[test]
    fn bands_lose_no_peak_and_leave_no_gap() {
        let at = |time: f64, x: f64, speed: f64| (time, [x, 0.0, 0.0, 0.0, 0.0], [speed, 0.0, 0.0, 0.0, 0.0]);
        let points = [
            at(0.0, 0.0, 0.0),
            at(1.0, 0.0, 0.0),
            at(1.001, 0.01, 0.5),
            at(1.002, 0.0, -0.4),
            at(1.003, 0.0, 0.0),
            at(4.0, 0.3, 0.1),
        ];
        let bands = bands(&moves(&points), 40);
        let all = |of: &[[[f64; 2]; 5]]| {
            of.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], row| {
                [low.min(row[0][0]), high.max(row[0][1])]
            })
        };
        assert_eq!((all(&bands.velocities), all(&bands.positions)), ([-0.4, 0.5], [0.0, 0.3]));
        assert!(bands.positions.iter().flatten().all(|[low, high]| low <= high));
        for pair in bands.positions.windows(2) {
            assert!(pair[0][0][1] >= pair[1][0][0] - 1e-12 && pair[1][0][1] >= pair[0][0][0] - 1e-12);
        }
    }

    #[test]
    fn a_motion_of_another_machine_is_refused() {
        let machine = machine();
        let names = |names: [&str; 5]| names.map(str::to_owned).to_vec();
        let motion = |joint_names, values: usize| JointMotion {
            joint_names,
            times: vec![0.0],
            positions: vec![0.5; values],
            velocities: vec![0.0; values],
        };
        assert!(Moves::of(&motion(names(["c", "a", "z", "y", "x"]), 5), &machine).is_ok());
        assert!(
            Moves::of(&motion(names(["c", "b", "z", "y", "x"]), 5), &machine)
                .unwrap_err()
                .contains("no joint a")
        );
        assert!(
            Moves::of(&motion(names(["x", "y", "z", "a", "c"]), 4), &machine)
                .unwrap_err()
                .contains("4 positions")
        );
    }
}
