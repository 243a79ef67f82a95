//! The highest tip of a cutter over a straight segment.

use crate::contact_tree::{Profile, TANGENT_REACH};

/// Newton steps stop when the sine of the tube angle moves less than this.
const CONVERGED: f64 = 1e-13;
/// Segments shorter than this in plan, m, are vertical: their upper end is the contact.
const VERTICAL: f64 = 1e-15;

/// Where the segment p–q (relative to the tool axis, z = tool axis) holds the cutter strictly between its ends.
///
/// Gives the tip height and the contact point; `None` when the highest contact is at an end, the tool does
/// not reach the segment, or the tip would not rise above `floor` (m). Along the segment F(l) = z(l) − lift(ρ(l)) is concave. With l counted from the foot
/// of the tool axis upwards, d the foot's distance, m = dz/dl ≥ 0 and s the sine of the tube angle, ρ = R1 + R2 s,
/// F' = 0 reads s²(ρ² − d²) = m²(1 − s²)ρ², which has one root with l > 0.
pub(crate) fn inside_contact(
    tool: &Profile,
    p: &[f64; 3],
    q: &[f64; 3],
    floor: f64,
) -> Option<(f64, [f64; 3])> {
    let (p, q) = if q[2] >= p[2] { (p, q) } else { (q, p) };
    let (ux, uy) = (q[0] - p[0], q[1] - p[1]);
    let length = (ux * ux + uy * uy).sqrt();
    if length < VERTICAL {
        return None;
    }
    let (ux, uy) = (ux / length, uy / length);
    let l0 = p[0] * ux + p[1] * uy;
    let l1 = l0 + length;
    // Up to the foot both terms of F rise: the contact is never below it.
    if l1 <= 0.0 {
        return None;
    }
    let d = p[0] * uy - p[1] * ux;
    let d2 = d * d;
    let reach2 = tool.radius * tool.radius - d2;
    if reach2 <= 0.0 || l0 * l0.abs() >= reach2 {
        return None;
    }
    let m = (q[2] - p[2]) / length;
    let l_reach = reach2.sqrt();
    let (low, high) = (l0.max(0.0), l1.min(l_reach));
    if highest(tool, d2, m, low, high) + p[2] - m * l0 <= floor {
        return None;
    }
    let r22 = tool.r2 * tool.r2;
    let still_rising = |l: f64| {
        let rho2 = l * l + d2;
        let w = rho2.sqrt() - tool.r1;
        // s²·l² < m²(1 − s²)ρ², times R2².
        w <= 0.0 || w * w * l * l < m * m * (r22 - w * w) * rho2
    };
    if l0 >= 0.0 && !still_rising(l0) {
        return None;
    }
    if l1 <= l_reach && (tool.r2 == 0.0 || still_rising(l1)) {
        return None;
    }
    let l = if m == 0.0 {
        low
    } else if tool.r2 == 0.0 {
        high
    } else {
        level_point(tool, d2, m, low, high).max(low).min(high)
    };
    let point = [p[0] + ux * (l - l0), p[1] + uy * (l - l0), p[2] + m * (l - l0)];
    Some((point[2] - tool.lift((l * l + d2).sqrt()), point))
}

/// An upper bound of m·l − lift between `low` and `high`, by the tangent at the middle; +∞ where that is too near to the cutter's side.
#[inline]
fn highest(tool: &Profile, d2: f64, m: f64, low: f64, high: f64) -> f64 {
    let (l, half) = (0.5 * (low + high), 0.5 * (high - low));
    let rho = (l * l + d2).sqrt();
    let w = rho - tool.r1;
    if w <= 0.0 || tool.r2 == 0.0 {
        return m * l + m * half;
    }
    if w >= TANGENT_REACH * tool.r2 {
        return f64::INFINITY;
    }
    let root = (tool.r2 * tool.r2 - w * w).sqrt();
    let slope = m - w * l / (root * rho);
    m * l - (tool.r2 - root) + slope.abs() * half
}

/// The root of s²(ρ² − d²) = m²(1 − s²)ρ² between the sines at `low` and `high`, as l: Newton within a bracket.
fn level_point(tool: &Profile, d2: f64, m: f64, low: f64, high: f64) -> f64 {
    let sine = |l: f64| (((l * l + d2).sqrt() - tool.r1) / tool.r2).clamp(0.0, 1.0);
    let (mut s_low, mut s_high) = (sine(low), sine(high));
    let m2 = m * m;
    // For an edge through the axis tan φ = m; elsewhere φ is more.
    let mut s = (m / (1.0 + m2).sqrt()).max(s_low).min(s_high);
    for step in 0..100 {
        let rho = tool.r1 + tool.r2 * s;
        let (rho2, s2) = (rho * rho, s * s);
        let value = s2 * (rho2 - d2) - m2 * (1.0 - s2) * rho2;
        let slope =
            2.0 * (s * (rho2 - d2) + s2 * rho * tool.r2 + m2 * rho * (s * rho - (1.0 - s2) * tool.r2));
        if value <= 0.0 {
            s_low = s;
        } else {
            s_high = s;
        }
        let newton = s - value / slope;
        let middle = 0.5 * (s_low + s_high);
        let inside = newton > s_low && newton < s_high;
        let next = if inside && (step < 12 || step % 2 == 0) { newton } else { middle };
        let moved = (next - s).abs();
        s = next;
        if moved < CONVERGED || s_high - s_low < CONVERGED {
            break;
        }
    }
    let rho = tool.r1 + tool.r2 * s;
    (rho * rho - d2).max(0.0).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cutter::Cutter;
    use crate::test_meshes::Random;

    /// Ternary search of the concave F over the part within reach.
    fn by_search(tool: &Profile, p: &[f64; 3], q: &[f64; 3]) -> f64 {
        let at = |t: f64| [0, 1, 2].map(|k| p[k] + (q[k] - p[k]) * t);
        let rho = |t: f64| at(t)[0].hypot(at(t)[1]);
        let (ux, uy) = (q[0] - p[0], q[1] - p[1]);
        let l2 = ux * ux + uy * uy;
        let foot = -(p[0] * ux + p[1] * uy) / l2;
        let d = (p[0] * uy - p[1] * ux).abs() / l2.sqrt();
        if d >= tool.radius {
            return f64::NEG_INFINITY;
        }
        let half = ((tool.radius * tool.radius - d * d) / l2).sqrt() * (1.0 - 1e-15);
        let (mut a, mut b) = ((foot - half).max(0.0), (foot + half).min(1.0));
        if a > b {
            return f64::NEG_INFINITY;
        }
        let f = |t: f64| at(t)[2] - tool.lift(rho(t));
        for _ in 0..300 {
            let (u, v) = (a + (b - a) / 3.0, b - (b - a) / 3.0);
            if f(u) < f(v) { a = u } else { b = v }
        }
        f(a).max(f(b))
    }

    #[test]
    fn inside_or_end_is_the_maximum_along_the_segment() {
        let mut random = Random::new(1);
        let mut inside = 0;
        for (r1, r2) in [(0.013, 0.006), (0.0, 0.006), (0.01, 0.0), (0.001, 0.012)] {
            let tool = Profile::of(Cutter { r1, r2 });
            for i in 0..4000 {
                let reach = 1.4 * tool.radius;
                let steep = [0.001, 0.02, 0.3][i % 3];
                let mut end = || {
                    [
                        random.in_range(-reach, reach),
                        random.in_range(-reach, reach),
                        random.in_range(-steep, steep),
                    ]
                };
                let (p, q) = (end(), end());
                let ends = [p, q].map(|e| {
                    let rho = e[0].hypot(e[1]);
                    if rho <= tool.radius { e[2] - tool.lift(rho) } else { f64::NEG_INFINITY }
                });
                let contact = inside_contact(&tool, &p, &q, f64::NEG_INFINITY);
                inside += usize::from(contact.is_some());
                if let Some((z, _)) = contact {
                    // Told a floor it is the same or nothing, as the floor is below or above it.
                    assert_eq!(inside_contact(&tool, &p, &q, z - 1e-12), contact);
                    assert!(inside_contact(&tool, &p, &q, z).is_none_or(|again| Some(again) == contact));
                }
                let found = contact.map_or(f64::NEG_INFINITY, |c| c.0).max(ends[0]).max(ends[1]);
                let expected = by_search(&tool, &p, &q).max(ends[0]).max(ends[1]);
                assert!(
                    (found - expected).abs() < 1e-12 || found == expected,
                    "{tool:?} {p:?} {q:?}: {found} {expected}"
                );
            }
        }
        assert!(inside > 2000);
    }

    #[test]
    fn level_edges_rest_at_their_foot() {
        let tool = Profile::of(Cutter { r1: 0.0, r2: 0.005 });
        let (z, c) =
            inside_contact(&tool, &[-0.01, 0.003, 0.2], &[0.02, 0.003, 0.2], f64::NEG_INFINITY).unwrap();
        assert!((z - (0.2 - 0.001)).abs() < 1e-15 && c[0].abs() < 1e-15);
        assert!(
            inside_contact(&tool, &[0.001, 0.003, 0.2], &[0.001, 0.003, 0.1], f64::NEG_INFINITY).is_none()
        );
    }
}
