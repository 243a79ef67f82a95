//! A judge of programs that shares nothing with the stages: its own reading of the text, its own kinematics of the shipped machine `xyzac`
//! (part where its URDF has it), and the cutter at dense poses against points of every facet.

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use rayon::prelude::*;

use crate::bowl::Facet;

/// Leftovers above this are not told apart, m.
const FAR: f64 = 1e-3;
/// What poses that are apart may hide of a gouge or of what is left, m.
pub const POSE_SLACK: f64 = 1e-6;
/// Lever with which a turn counts as a way, m.
const LEVER: f64 = 0.05;
/// Distance of the points on a facet, m, …
const SPACING: f64 = 1e-3;
/// … but no more than so many along an edge.
const MOST_ALONG: usize = 40;
/// Most points in all: of more every so many is taken.
const MOST_POINTS: usize = 3000;

/// A cutter, m.
#[derive(Clone, Copy, Debug)]
pub struct Tool {
    /// Axis to corner centre.
    pub r1: f64,
    /// Corner radius.
    pub r2: f64,
    /// How much of it above the tip counts.
    pub length: f64,
}

/// What a program does to a surface, m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Verdict {
    /// The deepest place of a facet inside the cutter.
    pub gouge: f64,
    /// Share of the facets' area within the height that was asked for.
    pub within: f64,
    /// Poses that cut.
    pub poses: usize,
}

type Pose = (Point3<f64>, Vector3<f64>);

/// Judges a program on facets (mm): how deep it goes, and how much of their area keeps at most `height` (m).
///
/// # Errors
/// With the line that is not understood.
pub fn judge(program: &str, facets: &[Facet], tool: Tool, height: f64) -> Result<Verdict, String> {
    let moves = moves_of(program)?;
    let step = (8.0 * tool.r2.max(50e-6) * POSE_SLACK).sqrt();
    let poses: Vec<(bool, Pose)> = moves.iter().flat_map(|m| m.poses(step)).collect();
    let points = points_of(facets);
    let depths: Vec<(f64, f64, f64)> = points
        .par_iter()
        .map(|(p, weight)| {
            let (mut any, mut cut) = (FAR, FAR);
            for (feed, pose) in &poses {
                let distance = distance(p, pose, tool);
                any = any.min(distance);
                if *feed {
                    cut = cut.min(distance);
                }
            }
            (any, cut, *weight)
        })
        .collect();
    let total: f64 = depths.iter().map(|(.., weight)| weight).sum();
    let within: f64 = depths.iter().filter(|(_, cut, _)| *cut <= height).map(|(.., weight)| weight).sum();
    Ok(Verdict {
        gouge: depths.iter().fold(0.0, |deepest, (any, ..)| f64::max(deepest, -any)),
        within: within / total,
        poses: poses.iter().filter(|(feed, _)| *feed).count(),
    })
}

/// Distance of a point from the cutter, negative inside it, m: the cutter is a ball of the corner's radius moved over the disc of `r1` and
/// up from there.
fn distance(p: &Point3<f64>, (tip, axis): &Pose, tool: Tool) -> f64 {
    let d = p - tip;
    let height = d.dot(axis);
    if height > tool.length {
        return FAR;
    }
    let rho = (d.norm_squared() - height * height).max(0.0).sqrt();
    let (out, below) = (rho - tool.r1, tool.r2 - height);
    if out <= 0.0 && below <= 0.0 {
        return out.max(below) - tool.r2;
    }
    out.max(0.0).hypot(below.max(0.0)) - tool.r2
}

/// Points on the facets with the area that each stands for: corners, edges and inside.
fn points_of(facets: &[Facet]) -> Vec<(Point3<f64>, f64)> {
    let mut points = Vec::new();
    for facet in facets {
        let [a, b, c] = facet.map(|p| Point3::from(p.map(|x| f64::from(x) / 1e3)));
        let (edges, normal) = ([b - a, c - b, a - c], (b - a).cross(&(c - a)));
        let longest = edges.iter().map(Vector3::norm).fold(0.0, f64::max);
        // Thinner than a millionth of its length: no surface.
        if normal.norm() <= 1e-6 * longest * longest || !normal.norm().is_finite() {
            continue;
        }
        let n = ((longest / SPACING).ceil() as usize).clamp(2, MOST_ALONG);
        let weight = normal.norm() / 2.0 / ((n + 1) * (n + 2) / 2) as f64;
        for i in 0..=n {
            for j in 0..=n - i {
                let (u, v) = (i as f64 / n as f64, j as f64 / n as f64);
                points.push((a + (b - a) * u + (c - a) * v, weight));
            }
        }
    }
    let every = points.len().div_ceil(MOST_POINTS).max(1);
    // Not in step with the rows of a grid.
    let every = if every.is_multiple_of(2) { every + 1 } else { every };
    points.into_iter().step_by(every).collect()
}

/// Joint words of a line: X Y Z in m, A C in rad.
type Joints = [f64; 5];

struct Move {
    feed: bool,
    from: Joints,
    to: Joints,
}

impl Move {
    fn poses(&self, step: f64) -> Vec<(bool, Pose)> {
        let (a, b) = (pose(&self.from), pose(&self.to));
        let turn = (self.from[3] - self.to[3]).abs() + (self.from[4] - self.to[4]).abs();
        let step = if self.feed { step } else { 4.0 * step };
        let steps = (((b.0 - a.0).norm() + LEVER * turn) / step).ceil().clamp(1.0, 20_000.0) as usize;
        let at = |k: usize| -> Joints {
            std::array::from_fn(|j| self.from[j] + (self.to[j] - self.from[j]) * k as f64 / steps as f64)
        };
        (0..=steps).map(|k| (self.feed, pose(&at(k)))).collect()
    }
}

/// Tip and axis on the part: the table tilts about X through the machine's zero (A) and turns 15 mm behind and 60 mm below it (C); the part
/// stands on it at (−90, −60, 70) mm. Coordinates count from the part's origin at A0 C0.
fn pose(joints: &Joints) -> Pose {
    let [x, y, z, a, c] = *joints;
    let turned = |axis: Vector3<f64>, angle: f64| UnitQuaternion::new(axis * angle);
    let table = |a: f64, c: f64| {
        turned(Vector3::x(), a)
            * Translation3::new(0.0, 0.015, -0.06)
            * turned(Vector3::z(), c)
            * Isometry3::translation(-0.09, -0.06, 0.07)
    };
    let origin = table(0.0, 0.0) * Point3::origin();
    let part = table(a, c).inverse();
    (part * (origin + Vector3::new(x, y, z)), part * Vector3::z())
}

/// The moves between positions in which every axis is known.
fn moves_of(program: &str) -> Result<Vec<Move>, String> {
    let (mut at, mut feed, mut moves) = ([None::<f64>; 5], None, Vec::new());
    for (number, line) in program.lines().enumerate() {
        let code = line.split('(').next().unwrap_or_default();
        let before = at;
        for word in code.split_ascii_whitespace() {
            let (letter, value) = word.split_at(1);
            let value: f64 = value.parse().map_err(|_| format!("line {}: {word}", number + 1))?;
            match letter {
                "X" => at[0] = Some(value / 1e3),
                "Y" => at[1] = Some(value / 1e3),
                "Z" => at[2] = Some(value / 1e3),
                "A" => at[3] = Some(value.to_radians()),
                "C" => at[4] = Some(value.to_radians()),
                "G" if value == 0.0 || value == 1.0 => feed = Some(value == 1.0),
                "S" | "F" if value <= 0.0 => return Err(format!("line {}: {word}", number + 1)),
                _ => {}
            }
        }
        let known = |at: [Option<f64>; 5]| -> Option<Joints> {
            at.iter().all(Option::is_some).then(|| at.map(Option::unwrap_or_default))
        };
        if before != at
            && let (Some(from), Some(to)) = (known(before), known(at))
        {
            moves.push(Move { feed: feed.ok_or("a move before G0 or G1")?, from, to });
        }
    }
    Ok(moves)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ball_at_known_places_cuts_as_deep_as_it_should() {
        let square: [Facet; 2] = [
            [[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 4.0, 0.0]],
            [[4.0, 0.0, 0.0], [4.0, 4.0, 0.0], [0.0, 4.0, 0.0]],
        ];
        let tool = Tool { r1: 0.0, r2: 0.003, length: 0.1 };
        let program = |z: &str| format!("G0 X0 Y2 Z9 A0 C0\nG1 Z{z} F100\nX4\nG0 Z9\n");
        let verdict = judge(&program("-0.05"), &square, tool, 20e-6).unwrap();
        assert!((verdict.gouge - 50e-6).abs() < 1e-9, "{verdict:?}");
        let verdict = judge(&program("0"), &square, tool, 20e-6).unwrap();
        assert!(verdict.gouge < 1e-9 && (0.1..0.3).contains(&verdict.within), "{verdict:?}");
        // The same on the table turned by 90 degrees about its axis at (90, 60) mm of the part.
        let turned = "G0 X148 Y-30 Z9 A0 C90\nG1 Z-0.05 F100\nY-26\nG0 Z9\n";
        let verdict = judge(turned, &square, tool, 20e-6).unwrap();
        assert!((verdict.gouge - 50e-6).abs() < 1e-9, "{verdict:?}");
    }
}
