//! A numbered point of a triangulation in the plane.

use spade::HasPosition;

/// The point and its number.
pub struct Site {
    /// Where it is.
    pub position: spade::Point2<f64>,
    /// What it stands for.
    pub number: u32,
}

impl HasPosition for Site {
    type Scalar = f64;
    fn position(&self) -> spade::Point2<f64> {
        self.position
    }
}
