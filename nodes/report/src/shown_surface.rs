//! The surface to look at: few enough triangles, with patch, rolling-ball curvature and leftover.

use std::collections::BTreeMap;

use nalgebra::Point3;
use patchmill_path_generation::sample_interpolation::SampleInterpolation;
use patchmill_products::evaluation::ResidualMap;
use patchmill_visualization::patches::{Colouring, labelled};

use crate::plan::Plan;

/// Rounds in which vertices without a point of the proof take over what their neighbours have.
const ROUNDS: usize = 3;

/// Triangles with what is drawn on them.
#[derive(Clone, Debug, Default)]
pub struct ShownSurface {
    /// Positions, m.
    pub vertices: Vec<Point3<f64>>,
    /// κ* of every vertex between the samples, 1/m.
    pub curvature: Vec<f64>,
    /// Of the points of the proof that are nearest to a vertex the worst leftover, m; `None` where none is near.
    pub leftover: Vec<Option<f64>>,
    /// Vertices of every triangle.
    pub triangles: Vec<[u32; 3]>,
    /// Patch of every triangle.
    pub patches: Vec<u8>,
    /// How many triangles there were before those along the patches' borders were divided.
    pub drawn: usize,
    /// How many the whole surface has.
    pub whole: usize,
}

impl ShownSurface {
    /// The surface of a plan with about `most` triangles and up to half as many more along the patches' borders.
    ///
    /// # Errors
    /// When the partition does not fit the samples.
    pub fn of(plan: &Plan, most: usize) -> Result<Self, String> {
        let by = Colouring { partition: &plan.partition, samples: &plan.samples, field: &plan.field };
        let shown = labelled(&plan.mesh, &by, most)
            .ok_or("the partition does not fit the samples: there are no patches to show")?;
        let mut surface = Self { drawn: shown.drawn, whole: plan.mesh.triangles.len(), ..Self::default() };
        let mut numbers: BTreeMap<[u64; 3], u32> = BTreeMap::new();
        for (patch, corners) in &shown.triangles {
            let triangle = corners.map(|p| {
                let next = surface.vertices.len() as u32;
                let key = [p.x, p.y, p.z].map(f64::to_bits);
                *numbers.entry(key).or_insert_with(|| {
                    surface.vertices.push(p);
                    next
                })
            });
            surface.triangles.push(triangle);
            surface.patches.push(u8::try_from(*patch).unwrap_or(u8::MAX));
        }
        let shape = SampleInterpolation::new(&plan.samples, &plan.field);
        surface.curvature = surface.vertices.iter().map(|p| shape.at(p).pseudo_curvature).collect();
        surface.leftover = worst_at(&surface.vertices, &plan.residual);
        surface.spread();
        Ok(surface)
    }

    /// Lets vertices without a leftover take over the worst of their neighbours'.
    fn spread(&mut self) {
        for _ in 0..ROUNDS {
            let before = self.leftover.clone();
            for triangle in &self.triangles {
                let corners = triangle.map(|v| v as usize);
                let known = corners.iter().filter_map(|&v| before[v]).reduce(worse);
                for v in corners.into_iter().filter(|&v| before[v].is_none()) {
                    self.leftover[v] = match (self.leftover[v], known) {
                        (Some(a), Some(b)) => Some(worse(a, b)),
                        (a, b) => a.or(b),
                    };
                }
            }
        }
    }

    /// Least and largest coordinates, m.
    pub fn bounds(&self) -> [Point3<f64>; 2] {
        bounds(&self.vertices)
    }
}

/// Least and largest coordinates of points; of none the origin.
pub fn bounds(points: &[Point3<f64>]) -> [Point3<f64>; 2] {
    let first = points.first().copied().unwrap_or_else(Point3::origin);
    points.iter().fold([first, first], |[low, high], p| [low.inf(p), high.sup(p)])
}

/// The leftover that is farther from the surface.
fn worse(a: f64, b: f64) -> f64 {
    if b.abs() > a.abs() { b } else { a }
}

/// Of the points of a map that are nearest to a vertex the worst leftover.
fn worst_at(vertices: &[Point3<f64>], map: &ResidualMap) -> Vec<Option<f64>> {
    let cells = Cells::of(vertices);
    let mut worst = vec![None; vertices.len()];
    for (point, &leftover) in map.points.iter().zip(&map.leftover) {
        if let Some(v) = cells.nearest(vertices, point) {
            let so_far: &mut Option<f64> = &mut worst[v];
            *so_far = Some(so_far.map_or(leftover, |w| worse(w, leftover)));
        }
    }
    worst
}

/// Points sorted into the cells of a grid over x and y, about two a cell.
struct Cells {
    low: Point3<f64>,
    size: f64,
    columns: usize,
    rows: usize,
    /// Cell `c` owns `order[start[c]..start[c + 1]]`.
    start: Vec<u32>,
    order: Vec<u32>,
}

impl Cells {
    fn of(points: &[Point3<f64>]) -> Self {
        let [low, high] = bounds(points);
        let (width, depth) = (high.x - low.x, high.y - low.y);
        // Twice the mean distance; along a line of points the grid is no longer than there are points.
        let even = (2.0 * width * depth / points.len().max(1) as f64).sqrt();
        let size = even.max(width.max(depth) / points.len().max(1) as f64).max(f64::MIN_POSITIVE);
        let (columns, rows) = ((width / size) as usize + 1, (depth / size) as usize + 1);
        let mut cells =
            Self { low, size, columns, rows, start: vec![0; columns * rows + 1], order: Vec::new() };
        for p in points {
            let cell = cells.cell(p);
            cells.start[cell[1] * columns + cell[0] + 1] += 1;
        }
        for c in 1..cells.start.len() {
            cells.start[c] += cells.start[c - 1];
        }
        let mut next = cells.start.clone();
        cells.order = vec![0; points.len()];
        for (i, p) in points.iter().enumerate() {
            let cell = cells.cell(p);
            let slot = &mut next[cell[1] * columns + cell[0]];
            cells.order[*slot as usize] = i as u32;
            *slot += 1;
        }
        cells
    }

    fn cell(&self, p: &Point3<f64>) -> [usize; 2] {
        // A float cast saturates at 0 and at the type's end, so points outside fall into the border cells.
        [
            (((p.x - self.low.x) / self.size) as usize).min(self.columns - 1),
            (((p.y - self.low.y) / self.size) as usize).min(self.rows - 1),
        ]
    }

    /// The nearest of the points in the cell of `p` and those around it; of equals the first.
    fn nearest(&self, points: &[Point3<f64>], p: &Point3<f64>) -> Option<usize> {
        let [column, row] = self.cell(p);
        let mut best: Option<(f64, usize)> = None;
        for r in row.saturating_sub(1)..=(row + 1).min(self.rows - 1) {
            let first = r * self.columns + column.saturating_sub(1);
            let last = r * self.columns + (column + 1).min(self.columns - 1);
            for &i in &self.order[self.start[first] as usize..self.start[last + 1] as usize] {
                let distance = (points[i as usize] - p).norm_squared();
                if best.is_none_or(|(least, _)| distance < least) {
                    best = Some((distance, i as usize));
                }
            }
        }
        best.map(|(_, i)| i)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid(n: usize) -> Vec<Point3<f64>> {
        (0..n * n).map(|i| Point3::new((i % n) as f64 * 1e-3, (i / n) as f64 * 1e-3, 0.0)).collect()
    }

    #[test]
    fn every_vertex_has_the_worst_of_the_points_nearest_to_it() {
        let vertices = grid(20);
        let near = |x: f64, y: f64| Point3::new(x * 1e-3, y * 1e-3, 1e-5);
        let points = vec![near(3.2, 4.1), near(2.8, 3.9), near(3.1, 4.0), near(19.4, 19.4)];
        let map = ResidualMap { points, leftover: vec![5e-6, -9e-6, 8e-6, 1e-6] };
        let worst = worst_at(&vertices, &map);
        assert_eq!(worst[4 * 20 + 3], Some(-9e-6));
        assert_eq!(worst[399], Some(1e-6));
        assert_eq!(worst.iter().flatten().count(), 2);
        assert!(worst_at(&[], &map).is_empty());
    }

    #[test]
    fn what_no_point_is_near_takes_over_from_its_neighbours_only() {
        let mut surface = ShownSurface {
            vertices: grid(20),
            leftover: vec![None; 400],
            triangles: (0..19u32).map(|i| [i, i + 1, i + 20]).collect(),
            ..ShownSurface::default()
        };
        surface.leftover[0] = Some(-3e-6);
        surface.leftover[2] = Some(2e-6);
        surface.spread();
        assert_eq!(surface.leftover[1], Some(-3e-6));
        assert_eq!(surface.leftover[5], Some(2e-6));
        assert_eq!(surface.leftover[9], None);
    }
}
