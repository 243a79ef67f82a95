//! Sample points of the surface.

use nalgebra::{Matrix3, Point3, Vector3};

/// Samples of the smooth surface, all arrays of the same length, `workpiece` frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SurfaceSamples {
    /// Rows and columns when the samples form a grid over the surface's two parameters (row-major), else `None`.
    pub grid: Option<[u32; 2]>,
    /// Positions, m.
    pub points: Vec<Point3<f64>>,
    /// Unit normals on the tool side.
    pub normals: Vec<Vector3<f64>>,
    /// Largest (most concave) principal curvature, 1/m.
    pub curvature_max: Vec<f64>,
    /// Least principal curvature, 1/m.
    pub curvature_min: Vec<f64>,
    /// Unit tangent along which `curvature_max` is taken.
    pub direction_max: Vec<Vector3<f64>>,
    /// Surface area that each sample stands for, m².
    pub area: Vec<f64>,
}

impl SurfaceSamples {
    /// Those with these numbers, in this order; in no grid.
    pub fn only(&self, kept: &[usize]) -> Self {
        Self {
            grid: None,
            points: kept.iter().map(|&i| self.points[i]).collect(),
            normals: kept.iter().map(|&i| self.normals[i]).collect(),
            curvature_max: kept.iter().map(|&i| self.curvature_max[i]).collect(),
            curvature_min: kept.iter().map(|&i| self.curvature_min[i]).collect(),
            direction_max: kept.iter().map(|&i| self.direction_max[i]).collect(),
            area: kept.iter().map(|&i| self.area[i]).collect(),
        }
    }

    /// The curvature at sample `i` as a symmetric tensor whose null direction is the normal, 1/m.
    pub fn curvature_tensor(&self, i: usize) -> Matrix3<f64> {
        let (most, normal) = (self.direction_max[i], self.normals[i]);
        let least = normal.cross(&most);
        most * most.transpose() * self.curvature_max[i] + least * least.transpose() * self.curvature_min[i]
    }

    /// Number of samples.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }
}
