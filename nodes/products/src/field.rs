//! The rolling-ball field: the pseudo-curvature of every sample.

use nalgebra::Point3;

/// Result of the rolling-ball analysis, one entry a sample.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RollingBallField {
    /// κ* = 1/R*, the most concave pseudo-curvature over the shadow, 1/m; positive where the ball is in a hollow.
    pub pseudo_curvature: Vec<f64>,
    /// The surface point that stops the ball (the sample itself when the principal curvature does), m.
    pub contact: Vec<Point3<f64>>,
    /// Radius of the shadow that was searched, m.
    pub shadow_radius: f64,
}
