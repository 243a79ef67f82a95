//! The graph z = f(x, y) of a formula over a rectangle.

use nalgebra::{Point3, Vector3};

use crate::expression::Expression;
use crate::parametric::{ParametricSurface, SurfacePoint};

/// z = f(x, y), where the formula takes and gives the file's unit.
#[derive(Clone, Debug)]
pub struct Algebraic {
    formula: Expression,
    x: [f64; 2],
    y: [f64; 2],
    metres_per_unit: f64,
    unit: String,
    title: String,
}

impl Algebraic {
    /// The graph over x × y (in the file's unit, `unit`, which is `metres_per_unit` m).
    pub fn new(
        formula: Expression,
        x: [f64; 2],
        y: [f64; 2],
        metres_per_unit: f64,
        unit: String,
        title: String,
    ) -> Self {
        Self { formula, x, y, metres_per_unit, unit, title }
    }
}

impl ParametricSurface for Algebraic {
    fn at(&self, u: f64, v: f64) -> SurfacePoint {
        let ([x0, x1], [y0, y1], m) = (self.x, self.y, self.metres_per_unit);
        let (width, depth) = (x1 - x0, y1 - y0);
        // The ends exactly, whatever the rounding.
        let (x, y) = (x0 * (1.0 - u) + x1 * u, y0 * (1.0 - v) + y1 * v);
        let f = self.formula.at(x, y);
        let jet = f.jet;
        SurfacePoint {
            position: Point3::new(x, y, jet.value) * m,
            u: Vector3::new(width, 0.0, jet.x * width) * m,
            v: Vector3::new(0.0, depth, jet.y * depth) * m,
            uu: Vector3::new(0.0, 0.0, jet.xx * width * width) * m,
            uv: Vector3::new(0.0, 0.0, jet.xy * width * depth) * m,
            vv: Vector3::new(0.0, 0.0, jet.yy * depth * depth) * m,
            branch: f.branch,
        }
    }

    fn place(&self, u: f64, v: f64) -> String {
        let ([x0, x1], [y0, y1]) = (self.x, self.y);
        let unit = &self.unit;
        format!("x = {:.6} {unit}, y = {:.6} {unit}", x0 + (x1 - x0) * u, y0 + (y1 - y0) * v)
    }

    fn title(&self) -> &str {
        &self.title
    }

    fn scale(&self) -> f64 {
        (self.x[1] - self.x[0]).max(self.y[1] - self.y[0]) * self.metres_per_unit
    }
}
