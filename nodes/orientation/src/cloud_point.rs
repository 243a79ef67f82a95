//! A point of the surface with its shape.

use nalgebra::{Matrix3, Point3, Vector3};

/// One dense point.
#[derive(Clone, Copy, Debug)]
pub struct CloudPoint {
    /// Position on the smooth surface, m.
    pub position: Point3<f64>,
    /// Unit normal on the tool side.
    pub normal: Vector3<f64>,
    /// κ*, 1/m.
    pub pseudo_curvature: f64,
    /// Curvature tensor, 1/m.
    pub curvature: Matrix3<f64>,
    /// Distance between the facets and the smooth surface here, m.
    pub facet_error: f64,
    /// Area that the point stands for, m².
    pub area: f64,
}
