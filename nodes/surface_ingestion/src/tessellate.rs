//! Triangles within a chord tolerance of an analytic surface, as few as a tensor grid allows.
//!
//! Over a triangle whose edges have the second derivatives q = (S''[e, e])·n along them, the distance between facet
//! and surface at barycentric λ is ½ (λ₁λ₂q₁₂ + λ₂λ₃q₂₃ + λ₃λ₁q₃₁) along the normal; its largest value over the triangle
//! has a closed form. Grid lines are spaced as 1/√|S''·n| of each direction asks, each cell is cut along the better
//! diagonal, and the whole grid is refined until the largest value over all cells, taken at nine points of each and held
//! against the distance measured at the edges' midpoints, is within the tolerance.

use nalgebra::Vector3;
use patchmill_geometry::mesh::TriangleMesh;
use patchmill_products::stage::{Progress, StageError};
use rayon::prelude::*;

use crate::error_code::{SINGULAR_SURFACE, TOO_MANY_TRIANGLES};
use crate::parametric::{ParametricSurface, SurfacePoint, regular_point};

/// Intervals a side of the first, coarse look at the surface.
const SCAN: usize = 128;
/// Fewest grid cells along a side, however flat the surface is.
const CELLS_MIN: f64 = 24.0;
/// A cell is at most about this many times as long as wide.
const ASPECT_MAX: f64 = 10.0;
/// Cells over which the normal turns by more than 0.2 rad are judged by that turn.
const TURN_COS: f64 = 0.98;
/// Refinements that may fail to bring a smooth surface's gain before it counts as not smooth.
const STRIKES: u32 = 3;
/// Refinements before giving up.
const ROUNDS: u32 = 16;
/// Share of the tolerance aimed at: the rest covers what nine points of a cell do not see.
const AIM: f64 = 0.97;

/// A mesh of `surface` whose facets keep within `tolerance` (m), with exact vertex normals; `chord_error` is the
/// largest facet distance found.
///
/// # Errors
/// Where the surface is singular, or when the tolerance needs more than `max_triangles`; cancellation.
pub fn tessellate(
    surface: &dyn ParametricSurface,
    tolerance: f64,
    max_triangles: usize,
    progress: Progress<'_>,
) -> Result<TriangleMesh, StageError> {
    let bend = Bend::scan(surface)?;
    let breaks = surface.breaks();
    progress.check()?;
    let (mut budget, mut cells_min) = (tolerance * AIM, CELLS_MIN);
    let mut worst_cell = bend.worst;
    let (mut before, mut worst_before, mut strikes) = (0.0, f64::INFINITY, 0);
    for round in 0..ROUNDS {
        let (us, vs) = bend.grid_lines(budget, cells_min, &breaks);
        let triangles = 2.0 * (us.len() - 1) as f64 * (vs.len() - 1) as f64;
        if triangles > max_triangles as f64 {
            return Err(too_fine(surface, tolerance, max_triangles, Some(triangles), worst_cell));
        }
        let cells = measure(surface, &us, &vs)?;
        progress.check()?;
        worst_cell = cells.worst_cell;
        (progress.report)(0.1 + 0.8 * f64::from(round) / f64::from(ROUNDS));
        // Coarser than needed: spend the slack, but only in the first round, so that the end is certain.
        let least = CELLS_MIN as usize + breaks[0].len().max(breaks[1].len());
        let minimal = us.len().max(vs.len()) <= least + 1;
        let wasteful = round == 0 && cells.worst < 0.9 * tolerance * AIM && !minimal;
        if cells.worst <= tolerance * (1.0 + AIM) * 0.5 && !wasteful {
            return build(surface, &us, &vs, &cells);
        }
        if cells.worst > tolerance && triangles < 1.2 * before {
            // Something that the coarse look missed: finer everywhere.
            cells_min *= 2.0;
        }
        // On a smooth surface the distance falls at least as the number of triangles grows.
        strikes +=
            u32::from(cells.worst > tolerance && cells.worst * triangles > 1.5 * worst_before * before);
        if strikes == STRIKES {
            break;
        }
        (before, worst_before) = (triangles, cells.worst);
        budget *= (tolerance * AIM / cells.worst).clamp(0.02, 100.0);
    }
    Err(too_fine(surface, tolerance, max_triangles, None, worst_cell))
}

fn too_fine(
    surface: &dyn ParametricSurface,
    tolerance: f64,
    max_triangles: usize,
    needed: Option<f64>,
    cell: Rectangle,
) -> StageError {
    let (u, v) = match sharpest_place(surface, cell) {
        Ok(place) => place,
        Err(singular) => return singular,
    };
    let needed =
        needed.map_or_else(|| "unlimited triangles".to_owned(), |n| format!("{n:.0} triangles or more"));
    StageError::new(
        TOO_MANY_TRIANGLES,
        format!(
            "{} needs {needed} for a chord tolerance of {:.3} µm, more than the {max_triangles} allowed: it bends most \
             sharply (perhaps a crease or a pole) near {}; a smooth surface or a larger tolerance was expected",
            surface.title(),
            tolerance * 1e6,
            surface.place(u, v)
        ),
    )
}

/// Where in `cell` facets are worst, by looking closer and closer.
fn sharpest_place(surface: &dyn ParametricSurface, mut cell: Rectangle) -> Result<(f64, f64), StageError> {
    for _ in 0..6 {
        let split =
            |[a, b]: [f64; 2]| (0..=8).map(|i| a + (b - a) * f64::from(i) / 8.0).collect::<Vec<f64>>();
        cell = measure(surface, &split(cell[0]), &split(cell[1]))?.worst_cell;
    }
    Ok((0.5 * (cell[0][0] + cell[0][1]), 0.5 * (cell[1][0] + cell[1][1])))
}

/// Ranges of u and v.
type Rectangle = [[f64; 2]; 2];

/// The error for a pole on the way from `a` to `b`, whose branches differ, found to rounding.
fn pole(surface: &dyn ParametricSurface, mut a: (f64, f64), mut b: (f64, f64)) -> StageError {
    let branch = surface.at(a.0, a.1).branch;
    for _ in 0..50 {
        let middle = (0.5 * (a.0 + b.0), 0.5 * (a.1 + b.1));
        let same = surface.at(middle.0, middle.1).branch == branch;
        *(if same { &mut a } else { &mut b }) = middle;
    }
    StageError::new(
        SINGULAR_SURFACE,
        format!(
            "{} has a pole near {}; it must be finite and smooth over its whole domain",
            surface.title(),
            surface.place(a.0, a.1)
        ),
    )
}

/// How the surface bends along both directions, from a coarse grid.
struct Bend {
    /// Largest |Suu·n| (or its share of the twist) over v at each scanned u, m.
    u: Vec<f64>,
    /// The same of |Svv·n| over u at each scanned v, m.
    v: Vec<f64>,
    /// Largest |Su| and |Sv|, m.
    length: [f64; 2],
    worst: Rectangle,
}

impl Bend {
    fn scan(surface: &dyn ParametricSurface) -> Result<Self, StageError> {
        let at = |i: usize| i as f64 / SCAN as f64;
        let rows: Vec<Vec<(SurfacePoint, Vector3<f64>)>> = (0..=SCAN)
            .into_par_iter()
            .map(|j| (0..=SCAN).map(|i| regular_point(surface, at(i), at(j))).collect())
            .collect::<Result<_, _>>()?;
        let mut bend =
            Self { u: vec![0.0; SCAN + 1], v: vec![0.0; SCAN + 1], length: [0.0; 2], worst: [[0.0, 1.0]; 2] };
        let mut most = -1.0;
        for (j, row) in rows.iter().enumerate() {
            for (i, (p, n)) in row.iter().enumerate() {
                let left = &row[i.saturating_sub(1)].0;
                let below = &rows[j.saturating_sub(1)][i].0;
                for (other, from) in [(left, (i.saturating_sub(1), j)), (below, (i, j.saturating_sub(1)))] {
                    if p.branch != other.branch {
                        return Err(pole(surface, (at(from.0), at(from.1)), (at(i), at(j))));
                    }
                }
                // A twist |Suv·n| asks as much of both directions, in proportion to their lengths:
                // du·dv ≤ ½ (ρ du² + dv²/ρ).
                let ([a, m, b], aspect) = (p.second_form(n).map(f64::abs), p.u.norm() / p.v.norm());
                let (a, b) = (a.max(m * aspect), b.max(m / aspect));
                bend.u[i] = bend.u[i].max(a);
                bend.v[j] = bend.v[j].max(b);
                bend.length[0] = bend.length[0].max(p.u.norm());
                bend.length[1] = bend.length[1].max(p.v.norm());
                if a.max(b) > most {
                    most = a.max(b);
                    bend.worst = [i, j].map(|k| [at(k.saturating_sub(1)), at((k + 1).min(SCAN))]);
                }
            }
        }
        bend.u = widened(&bend.u);
        bend.v = widened(&bend.v);
        Ok(bend)
    }

    /// Grid lines in u and v such that each direction takes half of `budget` (m), at
    /// least `cells_min` a side: a cell's du²·|Suu·n|/8 = budget/2. All `breaks` are among them.
    fn grid_lines(&self, budget: f64, cells_min: f64, breaks: &[Vec<f64>; 2]) -> (Vec<f64>, Vec<f64>) {
        let raw = |bend: &[f64]| bend.iter().map(|a| (a / (4.0 * budget)).sqrt()).collect::<Vec<f64>>();
        let (mut du, mut dv) = (raw(&self.u), raw(&self.v));
        let peak = |d: &[f64]| d.iter().copied().fold(0.0, f64::max);
        // Lines per metre of the finer direction bound how coarse the other may be.
        let finest = |d: &[f64], length: f64| peak(d) / length;
        let (fine_u, fine_v) = (finest(&du, self.length[0]), finest(&dv, self.length[1]));
        let least_u = (fine_v / ASPECT_MAX * self.length[0]).max(cells_min);
        let least_v = (fine_u / ASPECT_MAX * self.length[1]).max(cells_min);
        du.iter_mut().for_each(|d| *d = d.max(least_u));
        dv.iter_mut().for_each(|d| *d = d.max(least_v));
        (lines(&du, &breaks[0]), lines(&dv, &breaks[1]))
    }
}

/// The largest of each entry and its neighbours: what lies between two scanned lines is not missed.
fn widened(bend: &[f64]) -> Vec<f64> {
    (0..bend.len())
        .map(|i| bend[i.saturating_sub(1)..(i + 2).min(bend.len())].iter().copied().fold(0.0, f64::max))
        .collect()
}

/// Positions in [0, 1] spaced by the inverse of a density given at equally spaced places; 0, 1 and the `breaks` between them included.
fn lines(density: &[f64], breaks: &[f64]) -> Vec<f64> {
    let intervals = density.len() - 1;
    let mut sum = vec![0.0];
    for pair in density.windows(2) {
        sum.push(sum[sum.len() - 1] + 0.5 * (pair[0] + pair[1]) / intervals as f64);
    }
    let sum_at = |t: f64| {
        let at = ((t * intervals as f64) as usize).min(intervals - 1);
        sum[at] + (t * intervals as f64 - at as f64) * (sum[at + 1] - sum[at])
    };
    let mut ends = vec![(0.0, 0.0)];
    ends.extend(breaks.iter().map(|t| (*t, sum_at(*t))));
    ends.push((1.0, sum[intervals]));
    let (mut at, mut result) = (0, vec![0.0]);
    for pair in ends.windows(2) {
        let [(_, low), (end, high)] = [pair[0], pair[1]];
        // Far above any limit on triangles, and still an allocation that is harmless.
        let count = (high - low).ceil().clamp(1.0, 2e6) as usize;
        for k in 1..count {
            let wanted = low + (high - low) * k as f64 / count as f64;
            while at + 1 < intervals && sum[at + 1] < wanted {
                at += 1;
            }
            let share = ((wanted - sum[at]) / (sum[at + 1] - sum[at])).clamp(0.0, 1.0);
            result.push((at as f64 + share) / intervals as f64);
        }
        result.push(end);
    }
    result
}

/// What the cells of a grid turn out to be.
struct Cells {
    /// Largest facet distance, m.
    worst: f64,
    worst_cell: Rectangle,
    /// For each row of cells, whether each is cut from its first to its opposite corner.
    rising: Vec<Vec<bool>>,
}

struct Node {
    point: SurfacePoint,
    normal: Vector3<f64>,
}

fn measure(surface: &dyn ParametricSurface, us: &[f64], vs: &[f64]) -> Result<Cells, StageError> {
    let rows: Vec<(f64, usize, Vec<bool>)> = (0..vs.len() - 1)
        .into_par_iter()
        .map(|j| measure_row(surface, us, vs[j], vs[j + 1]))
        .collect::<Result<_, _>>()?;
    let mut cells = Cells {
        worst: 0.0,
        worst_cell: [[us[0], us[us.len() - 1]], [vs[0], vs[vs.len() - 1]]],
        rising: Vec::with_capacity(rows.len()),
    };
    for (j, (worst, i, rising)) in rows.into_iter().enumerate() {
        if worst > cells.worst {
            cells.worst = worst;
            cells.worst_cell = [[us[i], us[i + 1]], [vs[j], vs[j + 1]]];
        }
        cells.rising.push(rising);
    }
    Ok(cells)
}

/// Largest facet distance of a row of cells, the cell that has it, and every cell's diagonal.
fn measure_row(
    surface: &dyn ParametricSurface,
    us: &[f64],
    v0: f64,
    v1: f64,
) -> Result<(f64, usize, Vec<bool>), StageError> {
    let heights = [v0, 0.5 * (v0 + v1), v1];
    let column = |u: f64| -> Result<[Node; 3], StageError> {
        let node = |v| regular_point(surface, u, v).map(|(point, normal)| Node { point, normal });
        Ok([node(heights[0])?, node(heights[1])?, node(heights[2])?])
    };
    let mut left = column(us[0])?;
    let mut worst = (0.0, 0);
    let mut rising = Vec::with_capacity(us.len() - 1);
    for i in 0..us.len() - 1 {
        let nodes = [left, column(0.5 * (us[i] + us[i + 1]))?, column(us[i + 1])?];
        let branch = nodes[0][0].point.branch;
        if let Some(k) = nodes.iter().flatten().position(|n| n.point.branch != branch) {
            let u = us[i] + (us[i + 1] - us[i]) * (k / 3) as f64 * 0.5;
            return Err(pole(surface, (us[i], v0), (u, heights[k % 3])));
        }
        let (error, cut) = cell(&nodes, us[i + 1] - us[i], v1 - v0);
        if error > worst.0 {
            worst = (error, i);
        }
        rising.push(cut);
        let [_, _, right] = nodes;
        left = right;
    }
    Ok((worst.0, worst.1, rising))
}

/// Facet distance of a cell given at 3 × 3 nodes (`[u][v]`), and whether the diagonal from (0, 0) is the better one.
fn cell(nodes: &[[Node; 3]; 3], du: f64, dv: f64) -> (f64, bool) {
    let (mut along, mut against) = (0f64, 0f64);
    for node in nodes.iter().flatten() {
        let [l, m, n] = node.point.second_form(&node.normal);
        let (a, b, c) = (l * du * du, n * dv * dv, 2.0 * m * du * dv);
        along = along.max(facet_distance(a, b, a + b + c));
        against = against.max(facet_distance(a, b, a + b - c));
    }
    let p = |i: usize, j: usize| nodes[i][j].point.position.coords;
    // Where the normal turns much, second derivatives at a few points say little (a pole between them, say): the sagitta
    // of an arc that turns as much does.
    let turn = nodes.iter().flatten().map(|n| n.normal.dot(&nodes[1][1].normal)).fold(1.0, f64::min);
    if turn < TURN_COS {
        let size = (p(2, 2) - p(0, 0)).norm().max((p(2, 0) - p(0, 2)).norm()).max((p(1, 1) - p(0, 0)).norm());
        let sagitta = size * turn.acos() / 8.0;
        return (sagitta.max(along).max(against), true);
    }
    let middle = |i: usize, j: usize, a: Vector3<f64>, b: Vector3<f64>| {
        (p(i, j) - (a + b) * 0.5).dot(&nodes[i][j].normal).abs()
    };
    let sides = middle(1, 0, p(0, 0), p(2, 0))
        .max(middle(1, 2, p(0, 2), p(2, 2)))
        .max(middle(0, 1, p(0, 0), p(0, 2)))
        .max(middle(2, 1, p(2, 0), p(2, 2)));
    along = along.max(middle(1, 1, p(0, 0), p(2, 2)));
    against = against.max(middle(1, 1, p(2, 0), p(0, 2)));
    // Ties and rounding to one side, so that a symmetric surface gets one pattern.
    let rising = along <= against * (1.0 + 1e-9);
    (sides.max(if rising { along } else { against }), rising)
}

/// Largest |½ (λ₁λ₂a + λ₂λ₃b + λ₃λ₁c)| over a triangle.
fn facet_distance(a: f64, b: f64, c: f64) -> f64 {
    let edges = 0.125 * a.abs().max(b.abs()).max(c.abs());
    // The stationary point inside, if it is inside.
    let weights = [b * (a + c - b), c * (a + b - c), a * (b + c - a)];
    let sum: f64 = weights.iter().sum();
    if sum != 0.0 && weights.iter().all(|w| w / sum > 0.0) {
        edges.max((0.5 * a * b * c / sum).abs())
    } else {
        edges
    }
}

fn build(
    surface: &dyn ParametricSurface,
    us: &[f64],
    vs: &[f64],
    cells: &Cells,
) -> Result<TriangleMesh, StageError> {
    let rows: Vec<Vec<(SurfacePoint, Vector3<f64>)>> = vs
        .par_iter()
        .map(|&v| us.iter().map(|&u| regular_point(surface, u, v)).collect())
        .collect::<Result<_, _>>()?;
    let columns = us.len();
    let mut mesh = TriangleMesh { chord_error: cells.worst, ..Default::default() };
    mesh.vertices.reserve_exact(columns * vs.len());
    mesh.normals.reserve_exact(columns * vs.len());
    for (point, normal) in rows.into_iter().flatten() {
        mesh.vertices.push(point.position);
        mesh.normals.push(normal);
    }
    mesh.triangles.reserve_exact(2 * (columns - 1) * (vs.len() - 1));
    for (j, rising) in cells.rising.iter().enumerate() {
        for (i, &rising) in rising.iter().enumerate() {
            let a = (j * columns + i) as u32;
            let (b, c, d) = (a + 1, a + 1 + columns as u32, a + columns as u32);
            mesh.triangles.extend(if rising { [[a, b, c], [a, c, d]] } else { [[a, b, d], [b, c, d]] });
        }
    }
    Ok(mesh)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn lines_follow_the_density() {
        let even = lines(&[10.0; 5], &[]);
        assert_eq!(even.len(), 11);
        assert!(even.iter().enumerate().all(|(i, x)| (x - i as f64 / 10.0).abs() < 1e-12));
        let graded = lines(&[30.0, 10.0, 10.0], &[]);
        assert!(graded[1] - graded[0] < graded[graded.len() - 1] - graded[graded.len() - 2]);
        let broken = lines(&[10.0; 5], &[0.33, 0.34]);
        assert_eq!(broken.len(), 4 + 1 + 7 + 1);
        assert!(broken.contains(&0.33) && broken.contains(&0.34) && broken.is_sorted());
    }

    proptest! {
        #[test]
        fn the_closed_form_is_the_largest_distance(a in -1f64..1.0, b in -1f64..1.0, c in -1f64..1.0) {
            let mut most = 0f64;
            for i in 0..=60 {
                for j in 0..=60 - i {
                    let (s, t) = (f64::from(i) / 60.0, f64::from(j) / 60.0);
                    let r = 1.0 - s - t;
                    most = most.max((0.5 * (s * t * a + t * r * b + r * s * c)).abs());
                }
            }
            let closed = facet_distance(a, b, c);
            prop_assert!(most <= closed + 1e-12 && most >= closed - 2e-3, "{most} {closed}");
        }
    }
}
