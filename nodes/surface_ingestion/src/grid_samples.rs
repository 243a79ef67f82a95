//! A grid of samples over an analytic surface's parameters, its border included.

use patchmill_products::samples::SurfaceSamples;
use patchmill_products::stage::StageError;

use crate::parametric::{ParametricSurface, regular_point};

/// `per_side`² samples at u, v = i/(per_side − 1), row by row of v, with exact normals and curvature; areas by the
/// trapezoid rule of |Su × Sv|.
///
/// # Errors
/// Where the surface or its normal is undefined.
pub fn grid_samples(surface: &dyn ParametricSurface, per_side: u32) -> Result<SurfaceSamples, StageError> {
    let last = per_side - 1;
    let step = 1.0 / f64::from(last);
    let share = |i: u32| if i == 0 || i == last { 0.5 * step } else { step };
    let mut samples = SurfaceSamples { grid: Some([per_side, per_side]), ..Default::default() };
    for j in 0..per_side {
        for i in 0..per_side {
            let (point, normal) =
                regular_point(surface, f64::from(i) / f64::from(last), f64::from(j) / f64::from(last))?;
            let curvature = point.curvature(&normal);
            samples.points.push(point.position);
            samples.normals.push(normal);
            samples.curvature_max.push(curvature.max);
            samples.curvature_min.push(curvature.min);
            samples.direction_max.push(curvature.direction);
            samples.area.push(point.area_vector().norm() * share(i) * share(j));
        }
    }
    Ok(samples)
}
