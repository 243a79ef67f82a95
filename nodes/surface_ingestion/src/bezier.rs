//! The bicubic Bézier surface of a 4 × 4 control net.

use nalgebra::{Point3, Vector3};
use patchmill_products::stage::StageError;

use crate::parametric::{ParametricSurface, SurfacePoint, looks_up};

/// S(u, v) = Σᵢⱼ Bᵢ(u) Bⱼ(v) Pᵢⱼ, oriented so that its mean normal points to +Z.
#[derive(Clone, Debug)]
pub struct Bezier {
    net: [[Vector3<f64>; 4]; 4],
    /// Whether u and v of the file were exchanged to turn the normal to +Z.
    swapped: bool,
    title: String,
    scale: f64,
}

impl Bezier {
    /// The surface of the file's net (m).
    ///
    /// # Errors
    /// If neither side of the surface looks to +Z on the whole, so that there is no side to machine.
    pub fn new(net: [[Vector3<f64>; 4]; 4], title: String) -> Result<Self, StageError> {
        let flat = net.as_flattened();
        let low = flat.iter().fold(flat[0], |a, b| a.inf(b));
        let high = flat.iter().fold(flat[0], |a, b| a.sup(b));
        let mut surface = Self { net, swapped: false, title, scale: (high - low).norm() };
        if !looks_up(&surface)? {
            surface.swapped = true;
            surface.net = std::array::from_fn(|i| std::array::from_fn(|j| net[j][i]));
        }
        Ok(surface)
    }
}

/// Bernstein polynomials of degree 3 with their first and second derivatives.
fn bernstein(t: f64) -> [[f64; 4]; 3] {
    let s = 1.0 - t;
    [
        [s * s * s, 3.0 * s * s * t, 3.0 * s * t * t, t * t * t],
        [-3.0 * s * s, 3.0 * s * (s - 2.0 * t), 3.0 * t * (2.0 * s - t), 3.0 * t * t],
        [6.0 * s, 6.0 * (t - 2.0 * s), 6.0 * (s - 2.0 * t), 6.0 * t],
    ]
}

impl ParametricSurface for Bezier {
    fn at(&self, u: f64, v: f64) -> SurfacePoint {
        let (bu, bv) = (bernstein(u), bernstein(v));
        // Along v first: curves' values and derivatives, then across.
        let mut row = [[Vector3::zeros(); 4]; 3];
        for (order, weights) in bv.iter().enumerate() {
            row[order] = self.net.map(|curve| {
                curve.iter().zip(weights).fold(Vector3::zeros(), |sum, (point, weight)| sum + point * *weight)
            });
        }
        let across =
            |du: usize, dv: usize| (0..4).fold(Vector3::zeros(), |sum, i| sum + row[dv][i] * bu[du][i]);
        SurfacePoint {
            position: Point3::from(across(0, 0)),
            u: across(1, 0),
            v: across(0, 1),
            uu: across(2, 0),
            uv: across(1, 1),
            vv: across(0, 2),
            branch: 0,
        }
    }

    fn place(&self, u: f64, v: f64) -> String {
        let p = self.at(u, v).position * 1e3;
        let (u, v) = if self.swapped { (v, u) } else { (u, v) };
        format!("u = {u:.4}, v = {v:.4} (x = {:.4} mm, y = {:.4} mm, z = {:.4} mm)", p.x, p.y, p.z)
    }

    fn title(&self) -> &str {
        &self.title
    }

    fn scale(&self) -> f64 {
        self.scale
    }
}
