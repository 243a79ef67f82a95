//! Pseudo-curvature and curvature tensor of the samples, carried over to any point of the surface.

use nalgebra::{Matrix3, Point3};
use patchmill_products::field::RollingBallField;
use patchmill_products::samples::SurfaceSamples;

/// What a point of the surface inherits from the samples around it.
#[derive(Clone, Copy, Debug)]
pub struct LocalShape {
    /// κ*, 1/m.
    pub pseudo_curvature: f64,
    /// Symmetric curvature tensor, 1/m: tᵀ·K·t is the normal curvature along the unit tangent t.
    pub curvature: Matrix3<f64>,
}

/// Samples sorted into cubic cells, for smooth compact averages (Wendland's C² weight).
pub struct SampleInterpolation {
    points: Vec<Point3<f64>>,
    shapes: Vec<LocalShape>,
    /// Sample numbers cell by cell; cell `c` owns `order[start[c]..start[c + 1]]`.
    order: Vec<u32>,
    start: Vec<u32>,
    origin: Point3<f64>,
    cells: [usize; 3],
    radius: f64,
}

/// Radius of the average in mean sample distances: wide enough to span the gaps of a 3:1 anisotropic grid.
const RADIUS_IN_SPACINGS: f64 = 3.0;

impl SampleInterpolation {
    /// Sorts the samples; `samples` and `field` have the same, positive, number of entries.
    pub fn new(samples: &SurfaceSamples, field: &RollingBallField) -> Self {
        let area: f64 = samples.area.iter().sum();
        let (low, high) = bounds(&samples.points);
        let size = high - low;
        let spacing = (area / samples.len() as f64).sqrt();
        // Never more than 128 cells a side, so that a degenerate area cannot ask for unbounded memory.
        let radius = (RADIUS_IN_SPACINGS * spacing).max(size.max() / 128.0).max(f64::MIN_POSITIVE);
        let cells = [size.x, size.y, size.z].map(|extent| (extent / radius) as usize + 1);
        let cell_of = |p: &Point3<f64>| cell_index(p, &low, radius, cells);
        let mut start = vec![0u32; cells.iter().product::<usize>() + 1];
        for p in &samples.points {
            start[cell_of(p) + 1] += 1;
        }
        for c in 1..start.len() {
            start[c] += start[c - 1];
        }
        let (mut next, mut order) = (start.clone(), vec![0u32; samples.len()]);
        for (i, p) in samples.points.iter().enumerate() {
            let slot = &mut next[cell_of(p)];
            order[*slot as usize] = i as u32;
            *slot += 1;
        }
        let shapes = (0..samples.len())
            .map(|i| LocalShape {
                pseudo_curvature: field.pseudo_curvature[i],
                curvature: samples.curvature_tensor(i),
            })
            .collect();
        Self { points: samples.points.clone(), shapes, order, start, origin: low, cells, radius }
    }

    /// Weighted mean of the samples around `p`; the nearest sample where none is within the radius.
    pub fn at(&self, p: &Point3<f64>) -> LocalShape {
        let (mut weight_sum, mut kappa, mut tensor) = (0.0, 0.0, Matrix3::zeros());
        let centre = cell_coordinates(p, &self.origin, self.radius, self.cells);
        let range = |k: usize| centre[k].saturating_sub(1)..=(centre[k] + 1).min(self.cells[k] - 1);
        for ix in range(0) {
            for iy in range(1) {
                for iz in range(2) {
                    let cell = (ix * self.cells[1] + iy) * self.cells[2] + iz;
                    for &i in &self.order[self.start[cell] as usize..self.start[cell + 1] as usize] {
                        let q = (self.points[i as usize] - p).norm() / self.radius;
                        if q >= 1.0 {
                            continue;
                        }
                        let weight = (1.0 - q).powi(4) * (4.0 * q + 1.0);
                        let shape = &self.shapes[i as usize];
                        weight_sum += weight;
                        kappa += weight * shape.pseudo_curvature;
                        tensor += shape.curvature * weight;
                    }
                }
            }
        }
        if weight_sum > 1e-9 {
            return LocalShape { pseudo_curvature: kappa / weight_sum, curvature: tensor / weight_sum };
        }
        let distance = |i: &usize| (self.points[*i] - p).norm_squared();
        let nearest = (0..self.points.len()).min_by(|a, b| distance(a).total_cmp(&distance(b)));
        self.shapes[nearest.unwrap_or(0)]
    }
}

fn bounds(points: &[Point3<f64>]) -> (Point3<f64>, Point3<f64>) {
    points.iter().fold((points[0], points[0]), |(low, high), p| (low.inf(p), high.sup(p)))
}

fn cell_coordinates(p: &Point3<f64>, origin: &Point3<f64>, size: f64, cells: [usize; 3]) -> [usize; 3] {
    let d = p - origin;
    // A float cast saturates at 0 and at the type's end, so points outside fall into the border cells.
    [0, 1, 2].map(|k| ((d[k] / size) as usize).min(cells[k] - 1))
}

fn cell_index(p: &Point3<f64>, origin: &Point3<f64>, size: f64, cells: [usize; 3]) -> usize {
    let [x, y, z] = cell_coordinates(p, origin, size, cells);
    (x * cells[1] + y) * cells[2] + z
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    #[test]
    fn smooth_fields_are_reproduced_between_the_samples() {
        let (n, step) = (50, 1e-3);
        let mut samples = SurfaceSamples::default();
        let mut field = RollingBallField::default();
        for i in 0..n * n {
            let p = Point3::new((i / n) as f64 * step, (i % n) as f64 * step, 0.0);
            samples.points.push(p);
            samples.normals.push(Vector3::z());
            samples.curvature_max.push(10.0);
            samples.curvature_min.push(-5.0);
            samples.direction_max.push(Vector3::x());
            samples.area.push(step * step);
            field.pseudo_curvature.push(100.0 * p.x + 7.0);
        }
        let interpolation = SampleInterpolation::new(&samples, &field);
        let shape = interpolation.at(&Point3::new(20.3e-3, 31.7e-3, 0.0));
        assert!((shape.pseudo_curvature - (2.03 + 7.0)).abs() < 2e-3);
        assert!((shape.curvature - Matrix3::from_diagonal(&Vector3::new(10.0, -5.0, 0.0))).norm() < 1e-9);
        let far = interpolation.at(&Point3::new(1.0, 1.0, 1.0));
        assert!((far.pseudo_curvature - (100.0 * 49e-3 + 7.0)).abs() < 1e-9);
    }
}
