//! Edges as points that the faces on both sides share.

use nalgebra::Point3;

use crate::step::model::Edge;

/// Largest distance of a curve's end from its vertex, m.
const VERTEX_OFF_MAX: f64 = 10e-6;
/// Most halvings of a piece.
const DEPTH_MAX: u32 = 24;

/// The points along an edge from its start to its end, which are its vertices; no chord leaves the curve by more than `chord` (m) or
/// is longer than `longest` (m).
///
/// # Errors
/// When the curve does not run from one vertex to the other.
pub fn points(number: u64, edge: &Edge, chord: f64, longest: f64) -> Result<Vec<Point3<f64>>, String> {
    // Along the curve's own sense first.
    let mut ends = edge.ends;
    if !edge.forward {
        ends.reverse();
    }
    let range = edge.curve.range(&ends);
    let at = |t: f64| edge.curve.at(t, &ends);
    for (t, end) in range.into_iter().zip(&ends) {
        let off = (at(t) - end).norm();
        if off.is_nan() || off > VERTEX_OFF_MAX {
            return Err(format!(
                "#{number} EDGE_CURVE: its curve ends {:.4} mm from its vertex at x = {:.4} mm, y = {:.4} mm, z = {:.4} mm",
                off * 1e3,
                end.x * 1e3,
                end.y * 1e3,
                end.z * 1e3
            ));
        }
    }
    if range[1] <= range[0] {
        return Err(format!("#{number} EDGE_CURVE: it runs over its closed curve's end, which is not read"));
    }
    let pieces = edge.curve.pieces(range);
    let mut found = vec![ends[0]];
    for pair in pieces.windows(2) {
        split(&at, [pair[0], pair[1]], chord, longest, DEPTH_MAX, &mut found);
    }
    if let Some(last) = found.last_mut() {
        *last = ends[1];
    }
    if !edge.forward {
        found.reverse();
    }
    Ok(found)
}

/// Appends the points of a piece but its first.
fn split(
    at: &dyn Fn(f64) -> Point3<f64>,
    [a, b]: [f64; 2],
    chord: f64,
    longest: f64,
    depth: u32,
    points: &mut Vec<Point3<f64>>,
) {
    let (p, q) = (at(a), at(b));
    let off = |share: f64| (at(a + (b - a) * share) - (p + (q - p) * share)).norm();
    let fine = (q - p).norm() <= longest && [0.25, 0.5, 0.75].into_iter().all(|share| off(share) <= chord);
    if fine || depth == 0 {
        points.push(q);
        return;
    }
    let middle = 0.5 * (a + b);
    split(at, [a, middle], chord, longest, depth - 1, points);
    split(at, [middle, b], chord, longest, depth - 1, points);
}
