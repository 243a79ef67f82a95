//! Neighbourhood of the samples and the connected parts of a patch.

use linfa_nn::distance::L2Dist;
use linfa_nn::{KdTree, NearestNeighbour};
use ndarray::Array2;
use patchmill_products::samples::SurfaceSamples;
use patchmill_products::stage::StageError;

use crate::CODE_NEIGHBOURS;

/// Neighbours of a sample that is in no grid.
const NEAREST: usize = 8;

/// Which samples lie beside each other: symmetric, sorted, without loops.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Adjacency {
    neighbours: Vec<Vec<u32>>,
    in_grid: bool,
}

impl Adjacency {
    /// The four grid neighbours where the samples form a grid, else each one's eight nearest, made symmetric.
    ///
    /// # Errors
    /// When the search tree refuses the points (they must be finite).
    pub fn of(samples: &SurfaceSamples) -> Result<Self, StageError> {
        match samples.grid {
            Some([rows, columns]) => Ok(Self::of_grid(rows as usize, columns as usize)),
            None => Self::of_nearest(samples),
        }
    }

    fn of_grid(rows: usize, columns: usize) -> Self {
        let neighbours = (0..rows * columns).map(|i| {
            let (r, c) = (i / columns, i % columns);
            let candidates = [
                (r > 0).then(|| i - columns),
                (c > 0).then(|| i - 1),
                (c + 1 < columns).then(|| i + 1),
                (r + 1 < rows).then(|| i + columns),
            ];
            candidates.into_iter().flatten().map(|j| j as u32).collect()
        });
        Self { neighbours: neighbours.collect(), in_grid: true }
    }

    fn of_nearest(samples: &SurfaceSamples) -> Result<Self, StageError> {
        let n = samples.len();
        let failed = |e: &dyn std::fmt::Display| {
            StageError::new(CODE_NEIGHBOURS, format!("the neighbours of {n} samples were not found: {e}"))
        };
        let flat = samples.points.iter().flat_map(|p| p.coords.iter().copied()).collect();
        let points = Array2::from_shape_vec((n, 3), flat).map_err(|e| failed(&e))?;
        let tree = KdTree.from_batch(&points, L2Dist).map_err(|e| failed(&e))?;
        let mut neighbours = vec![Vec::with_capacity(2 * NEAREST); n];
        for (i, point) in points.rows().into_iter().enumerate() {
            // One more than wanted: the nearest is the point itself.
            for (_, j) in tree.k_nearest(point, NEAREST + 1).map_err(|e| failed(&e))? {
                if i != j {
                    neighbours[i].push(j as u32);
                    neighbours[j].push(i as u32);
                }
            }
        }
        for list in &mut neighbours {
            list.sort_unstable();
            list.dedup();
        }
        Ok(Self { neighbours, in_grid: false })
    }

    /// The samples beside sample `i`.
    pub fn of_sample(&self, i: usize) -> &[u32] {
        &self.neighbours[i]
    }

    /// Length of the sum of the unit vectors to the neighbours of a sample on a straight border.
    pub fn one_sided(&self) -> f64 {
        // One neighbour of four, or of eight in a square lattice three on one side: 1 + 2·cos 45°.
        if self.in_grid { 1.0 } else { 1.0 + std::f64::consts::SQRT_2 }
    }

    /// Sizes of the connected parts of every patch, largest first.
    pub fn parts(&self, labels: &[u8], patches: usize) -> Vec<Vec<u32>> {
        let mut parts = vec![Vec::new(); patches];
        let mut seen = vec![false; labels.len()];
        let mut open = Vec::new();
        for start in 0..labels.len() {
            if seen[start] {
                continue;
            }
            let label = labels[start];
            seen[start] = true;
            open.push(start);
            let mut size = 0;
            while let Some(i) = open.pop() {
                size += 1;
                for &j in &self.neighbours[i] {
                    let j = j as usize;
                    if !seen[j] && labels[j] == label {
                        seen[j] = true;
                        open.push(j);
                    }
                }
            }
            parts[label as usize].push(size);
        }
        parts.iter_mut().for_each(|sizes| sizes.sort_unstable_by(|a, b| b.cmp(a)));
        parts
    }
}
