//! Which stretches of the tool's path cut a point of the surface deep enough.

use std::sync::atomic::{AtomicBool, Ordering};

use nalgebra::{Point3, Unit, Vector3};
use rayon::prelude::*;

use crate::contact_tree::{Profile, SLACK};
use crate::cutter::Cutter;
use crate::drop_cutter::tool_frame;
use crate::edge_contact::inside_contact;
use crate::sweep::{GRAZING, LEAST_COSINE, Move, Moves, ProofPoints, TASK};

/// Halvings that find an end of a stretch: a move of 4 mm comes down to 4 nm.
const HALVINGS: usize = 20;
/// Stretches closer than this are one, m.
const JOINED: f64 = 1e-8;

/// A stretch of a polyline on which the tool cuts a point, by the length of the way from the polyline's beginning.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CutStretch {
    /// The polyline's place in the list.
    pub polyline: u32,
    /// Begin, m.
    pub from: f64,
    /// End, m.
    pub to: f64,
}

/// For every point the stretches of `polylines` (tips, `workpiece` frame, m) on which a cutter of constant `axis` leaves no
/// more than `height` (m) of it, in order. The residual is that of [`crate::sweep::sweep_fixed_axis`], and the same points count:
/// those steeper than about 84° to the axis are cut by nothing. Once `cancelled` is set the rest is left out.
pub fn cut_stretches(
    points: &ProofPoints,
    cutter: Cutter,
    axis: &Unit<Vector3<f64>>,
    polylines: &[&[Point3<f64>]],
    height: f64,
    cancelled: &AtomicBool,
) -> Vec<Vec<CutStretch>> {
    let frame = tool_frame(axis, &Vector3::x());
    let moves = Moves::new(cutter, polylines, |p| (frame * p).coords.into());
    let ways = ways(polylines);
    let mut found: Vec<Vec<CutStretch>> = vec![Vec::new(); points.len()];
    found.par_chunks_mut(TASK).enumerate().for_each(|(task, found)| {
        if cancelled.load(Ordering::Relaxed) {
            return;
        }
        for (i, found) in found.iter_mut().enumerate() {
            let i = task * TASK + i;
            let facing = points.normals[i].dot(axis);
            if facing > GRAZING {
                let q = frame * points.points[i];
                *found = stretches(&moves, &ways, [q.x, q.y], -(height / facing.max(LEAST_COSINE) + q.z));
            }
        }
    });
    found
}

/// (polyline, begin, length) of every move, as [`Moves`] numbers them, m.
fn ways(polylines: &[&[Point3<f64>]]) -> Vec<(u32, f64, f64)> {
    let mut ways = Vec::new();
    for (polyline, line) in polylines.iter().enumerate() {
        let mut begin = 0.0;
        if line.len() == 1 {
            ways.push((polyline as u32, 0.0, 0.0));
        }
        for w in line.windows(2) {
            let length = (w[1] - w[0]).norm();
            ways.push((polyline as u32, begin, length));
            begin += length;
        }
    }
    ways
}

/// Stretches on which the mirrored path holds a cutter at a place at `level` or higher, joined where they touch.
fn stretches(moves: &Moves, ways: &[(u32, f64, f64)], [x, y]: [f64; 2], level: f64) -> Vec<CutStretch> {
    let mut found: Vec<CutStretch> = Vec::new();
    moves.tree.search(x, y, level, |range, _| {
        for at in range {
            if let Some([from, to]) = shares(&moves.tree.tool, &moves.moves[at], [x, y], level) {
                let (polyline, begin, length) = ways[moves.order[at] as usize];
                found.push(CutStretch { polyline, from: begin + from * length, to: begin + to * length });
            }
        }
    });
    found.sort_by(|a, b| a.polyline.cmp(&b.polyline).then(a.from.total_cmp(&b.from)));
    found.dedup_by(|next, last| {
        let joined = next.polyline == last.polyline && next.from <= last.to + JOINED;
        if joined {
            last.to = last.to.max(next.to);
        }
        joined
    });
    found
}

/// Shares of a move between which it holds a cutter at (x, y) at `level` or higher: the height is concave along the move.
fn shares(tool: &Profile, [p, q]: &Move, [x, y]: [f64; 2], level: f64) -> Option<[f64; 2]> {
    if p[2].max(q[2]) < level {
        return None;
    }
    let (p, q) = ([p[0] - x, p[1] - y, p[2]], [q[0] - x, q[1] - y, q[2]]);
    let holds = |share: f64| {
        let [x, y, z] = [0, 1, 2].map(|k| p[k] + (q[k] - p[k]) * share);
        let rho2 = x * x + y * y;
        rho2 <= tool.radius * tool.radius && z - tool.lift(rho2.sqrt()) >= level
    };
    let end = |mut inside: f64, mut outside: f64| {
        for _ in 0..HALVINGS {
            let middle = 0.5 * (inside + outside);
            if holds(middle) { inside = middle } else { outside = middle }
        }
        inside
    };
    match (holds(0.0), holds(1.0)) {
        (true, true) => Some([0.0, 1.0]),
        (true, false) => Some([0.0, end(0.0, 1.0)]),
        (false, true) => Some([end(1.0, 0.0), 1.0]),
        (false, false) => {
            let (z, contact) = inside_contact(tool, &p, &q, level - SLACK)?;
            let k = if (q[0] - p[0]).abs() > (q[1] - p[1]).abs() { 0 } else { 1 };
            let share = ((contact[k] - p[k]) / (q[k] - p[k])).clamp(0.0, 1.0);
            (z >= level && holds(share)).then(|| [end(share, 0.0), end(share, 1.0)])
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sweep::sweep_fixed_axis;
    use crate::test_meshes::{Random, bumpy};

    static NEVER: AtomicBool = AtomicBool::new(false);

    /// The stretch of a polyline between two lengths of its way.
    fn part(line: &[Point3<f64>], from: f64, to: f64) -> Vec<Point3<f64>> {
        let mut begin = 0.0;
        let mut part = Vec::new();
        for w in line.windows(2) {
            let length = (w[1] - w[0]).norm();
            let at = |way: f64| w[0] + (w[1] - w[0]) * ((way - begin) / length).clamp(0.0, 1.0);
            if begin + length >= from && begin <= to {
                part.extend([at(from), at(to)]);
            }
            begin += length;
        }
        part
    }

    #[test]
    fn a_point_is_cut_on_its_stretches_and_nowhere_else() {
        let points = ProofPoints::on_facets(&bumpy(40, 0.02, 0.002), 2e-3);
        let mut random = Random::new(5);
        let axis = Unit::new_normalize(Vector3::new(0.2, -0.1, 1.0));
        for cutter in [Cutter { r1: 0.006, r2: 0.003 }, Cutter { r1: 0.0, r2: 0.005 }] {
            let line: Vec<Point3<f64>> = (0..30)
                .map(|k| {
                    let x = -0.02 + 0.0014 * f64::from(k);
                    Point3::new(x, random.in_range(-0.002, 0.004), random.in_range(-0.002, 0.0))
                })
                .collect();
            let whole: f64 = line.windows(2).map(|w| (w[1] - w[0]).norm()).sum();
            let height = 0.4e-3;
            let found = cut_stretches(&points, cutter, &axis, &[&line], height, &NEVER);
            let left = |i: usize, from: f64, to: f64| {
                let single = ProofPoints {
                    points: vec![points.points[i]],
                    normals: vec![points.normals[i]],
                    weights: vec![1.0],
                };
                let mut residual = [f64::INFINITY];
                let part = part(&line, from, to);
                sweep_fixed_axis(&single, cutter, &axis, &[&part], 1.0, &NEVER, &mut residual);
                residual[0]
            };
            let mut cut = 0;
            for (i, stretches) in found.iter().enumerate() {
                assert_eq!(left(i, 0.0, whole) <= height, !stretches.is_empty());
                let mut free = 0.0;
                for s in stretches {
                    cut += 1;
                    assert!(left(i, s.from, s.from) <= height + 1e-9 && left(i, s.to, s.to) <= height + 1e-9);
                    if s.from - free > 1e-6 {
                        assert!(left(i, free + 2e-7, s.from - 2e-7) > height);
                    }
                    free = s.to;
                }
                if whole - free > 1e-6 && !stretches.is_empty() {
                    assert!(left(i, free + 2e-7, whole) > height);
                }
            }
            assert!(cut > 100, "{cut}");
        }
    }
}
