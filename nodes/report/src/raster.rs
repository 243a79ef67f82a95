//! The shown surface from above, as cells of colours.

use crate::map_colours::Rgb;
use crate::shown_surface::ShownSurface;

/// Colours by row from the top (largest y), `None` where there is no surface.
pub struct Raster {
    /// Cells of a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Row after row, as 8-bit colours.
    pub cells: Vec<Option<[u8; 3]>>,
}

/// A run of cells of one colour.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Run {
    /// Row from the top.
    pub row: usize,
    /// First cell.
    pub from: usize,
    /// The one after the last.
    pub to: usize,
    /// The colour.
    pub colour: [u8; 3],
}

impl Raster {
    /// The surface within its bounds in cells of `size` (m). `colour` is asked with a triangle's number and weights of its
    /// corners (sum 1).
    pub fn of(surface: &ShownSurface, size: f64, colour: impl Fn(usize, [f64; 3]) -> Rgb) -> Self {
        let [low, high] = surface.bounds();
        let count = |extent: f64| ((extent / size).round() as usize).max(1);
        let (width, height) = (count(high.x - low.x), count(high.y - low.y));
        let mut raster = Self { width, height, cells: vec![None; width * height] };
        let mut above = vec![f64::NEG_INFINITY; width * height];
        for (t, corners) in surface.triangles.iter().enumerate() {
            let p = corners.map(|v| surface.vertices[v as usize]);
            // In cells, y from the top.
            let at = p.map(|p| [(p.x - low.x) / size, (high.y - p.y) / size]);
            for (column, row) in covered(&at, width, height) {
                let Some(weights) = weights(&at, [column as f64 + 0.5, row as f64 + 0.5]) else { continue };
                let z: f64 = weights.iter().zip(&p).map(|(w, p)| w * p.z).sum();
                let cell = row * width + column;
                if z > above[cell] {
                    above[cell] = z;
                    raster.cells[cell] = Some(colour(t, weights).map(|c| (c * 255.0).round() as u8));
                }
            }
        }
        raster
    }

    /// The cells as runs of one colour, row by row.
    pub fn runs(&self) -> Vec<Run> {
        let mut runs: Vec<Run> = Vec::new();
        for (i, colour) in self.cells.iter().enumerate() {
            let (row, column) = (i / self.width, i % self.width);
            let Some(colour) = *colour else { continue };
            match runs.last_mut() {
                Some(run) if run.row == row && run.to == column && run.colour == colour => run.to += 1,
                _ => runs.push(Run { row, from: column, to: column + 1, colour }),
            }
        }
        runs
    }
}

/// The cells of a triangle's bounding box.
fn covered(at: &[[f64; 2]; 3], width: usize, height: usize) -> impl Iterator<Item = (usize, usize)> + use<> {
    let range = |k: usize, most: usize| {
        let low = at.iter().map(|p| p[k]).fold(f64::INFINITY, f64::min);
        let high = at.iter().map(|p| p[k]).fold(f64::NEG_INFINITY, f64::max);
        // A float cast saturates at 0.
        (low - 0.5) as usize..((high + 0.5) as usize).min(most)
    };
    let (columns, rows) = (range(0, width), range(1, height));
    rows.flat_map(move |row| columns.clone().map(move |column| (column, row)))
}

/// Weights of a triangle's corners at a point; `None` outside.
fn weights([a, b, c]: &[[f64; 2]; 3], p: [f64; 2]) -> Option<[f64; 3]> {
    let cross = |o: &[f64; 2], u: &[f64; 2], v: &[f64; 2]| {
        (u[0] - o[0]) * (v[1] - o[1]) - (u[1] - o[1]) * (v[0] - o[0])
    };
    let area = cross(a, b, c);
    let weights = [cross(b, c, &p) / area, cross(c, a, &p) / area, cross(a, b, &p) / area];
    // On an edge counts as inside, so that no cell between two triangles is left out; without area there are no numbers.
    weights.iter().all(|w| *w >= -1e-9).then_some(weights)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;

    #[test]
    fn two_triangles_fill_their_square_without_holes_and_the_upper_one_is_seen() {
        let p = |x: f64, y: f64, z: f64| Point3::new(x, y, z);
        let surface = ShownSurface {
            vertices: vec![
                p(0.0, 0.0, 0.0),
                p(0.1, 0.0, 0.0),
                p(0.1, 0.05, 0.0),
                p(0.0, 0.05, 0.0),
                p(0.0, 0.0, 1.0),
                p(0.05, 0.0, 1.0),
                p(0.0, 0.05, 1.0),
            ],
            triangles: vec![[0, 1, 2], [0, 2, 3], [4, 5, 6]],
            ..ShownSurface::default()
        };
        let raster = Raster::of(&surface, 0.001, |t, _| [t as f64 / 255.0; 3]);
        assert_eq!((raster.width, raster.height), (100, 50));
        assert!(raster.cells.iter().all(Option::is_some));
        // Bottom left corner: the triangle on top; bottom right: the first one.
        assert_eq!(raster.cells[49 * 100 + 1], Some([2; 3]));
        assert_eq!(raster.cells[49 * 100 + 98], Some([0; 3]));
        let runs = raster.runs();
        assert_eq!(runs.iter().map(|r| r.to - r.from).sum::<usize>(), 5000);
        assert!(runs.len() < 200);
    }
}
