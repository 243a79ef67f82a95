//! What tessellation and sampling know of an analytic surface.

use nalgebra::{Point3, Vector3};
use patchmill_geometry::curvature::Curvature;
use patchmill_products::stage::StageError;

use crate::error_code::SINGULAR_SURFACE;

/// Position and derivatives at one pair of parameters; metres.
#[derive(Clone, Copy, Debug)]
pub struct SurfacePoint {
    /// S(u, v).
    pub position: Point3<f64>,
    /// ∂S/∂u.
    pub u: Vector3<f64>,
    /// ∂S/∂v.
    pub v: Vector3<f64>,
    /// ∂²S/∂u².
    pub uu: Vector3<f64>,
    /// ∂²S/∂u∂v.
    pub uv: Vector3<f64>,
    /// ∂²S/∂v².
    pub vv: Vector3<f64>,
    /// Changes between two places with a pole between them.
    pub branch: u64,
}

impl SurfacePoint {
    /// Su × Sv: normal on the tool side times the area element.
    pub fn area_vector(&self) -> Vector3<f64> {
        self.u.cross(&self.v)
    }

    /// Unit normal; `None` where the derivatives are parallel or vanish to within 1e-7 rad, or are not finite.
    pub fn normal(&self, scale: f64) -> Option<Vector3<f64>> {
        let (cross, product) = (self.area_vector(), self.u.norm() * self.v.norm());
        let size = cross.norm();
        (size > 1e-7 * product && product > 1e-12 * scale * scale && size.is_finite()).then(|| cross / size)
    }

    /// [Suu·n, Suv·n, Svv·n] of the unit normal `n`.
    pub fn second_form(&self, n: &Vector3<f64>) -> [f64; 3] {
        [self.uu.dot(n), self.uv.dot(n), self.vv.dot(n)]
    }

    /// Principal curvatures for the unit normal `n`.
    pub fn curvature(&self, n: &Vector3<f64>) -> Curvature {
        Curvature::of_fundamental_forms(&self.u, &self.v, n, self.second_form(n))
    }

    /// Whether everything is finite.
    pub fn is_finite(&self) -> bool {
        let finite = |v: &Vector3<f64>| v.iter().all(|x| x.is_finite());
        [&self.position.coords, &self.u, &self.v, &self.uu, &self.uv, &self.vv].into_iter().all(finite)
    }
}

/// A surface over the unit square whose Su × Sv points to the tool side.
pub trait ParametricSurface: Sync {
    /// The surface at (u, v) in [0, 1]².
    fn at(&self, u: f64, v: f64) -> SurfacePoint;

    /// The place (u, v) in the words of the surface's file, such as "x = 12 mm, y = 3 mm".
    fn place(&self, u: f64, v: f64) -> String;

    /// What the surface is called in an error, such as "Bézier net of part.json".
    fn title(&self) -> &str;

    /// Size that derivatives are compared with, m per unit of parameter.
    fn scale(&self) -> f64;

    /// Values of u and of v, increasing and within 0 and 1, at which second derivatives may jump: facets do not reach over them.
    fn breaks(&self) -> [Vec<f64>; 2] {
        Default::default()
    }
}

/// Whether the mean of Su × Sv points to +Z.
///
/// # Errors
/// If neither side of the surface looks to +Z on the whole, so that there is no side to machine.
pub fn looks_up(surface: &dyn ParametricSurface) -> Result<bool, StageError> {
    let (mut vector, mut area) = (Vector3::zeros(), 0.0);
    for i in 0..16 {
        for j in 0..16 {
            let a = surface.at((f64::from(i) + 0.5) / 16.0, (f64::from(j) + 0.5) / 16.0).area_vector();
            vector += a;
            area += a.norm();
        }
    }
    if vector.z.abs() > 1e-6 * area {
        return Ok(vector.z > 0.0);
    }
    Err(StageError::new(
        SINGULAR_SURFACE,
        format!(
            "{} has no +Z side: its mean normal is horizontal or vanishes; the machined side must look to +Z",
            surface.title()
        ),
    ))
}

/// The surface at (u, v) with its normal.
///
/// # Errors
/// Where the surface or its normal is undefined, naming the place.
pub fn regular_point(
    surface: &dyn ParametricSurface,
    u: f64,
    v: f64,
) -> Result<(SurfacePoint, Vector3<f64>), StageError> {
    let point = surface.at(u, v);
    if !point.is_finite() {
        return Err(StageError::new(
            SINGULAR_SURFACE,
            format!(
                "{} has no finite value or slope at {}; it must be smooth over its whole domain",
                surface.title(),
                surface.place(u, v)
            ),
        ));
    }
    let normal = point.normal(surface.scale()).ok_or_else(|| {
        StageError::new(
            SINGULAR_SURFACE,
            format!(
                "{} is degenerate at {}: its derivatives are zero, parallel or beyond all measure, so that it has no normal there; a smooth surface was expected",
                surface.title(),
                surface.place(u, v)
            ),
        )
    })?;
    Ok((point, normal))
}
