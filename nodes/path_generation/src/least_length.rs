//! A lower bound of the length of cut: every point of the surface cut by its own best orientation.

use std::f64::consts::PI;

use nalgebra::{Matrix2, Unit, Vector3};
use patchmill_geometry::cutter::Cutter;
use patchmill_products::job::Job;
use rayon::prelude::*;

use crate::PreparedSurface;
use patchmill_orientation::cloud_point::CloudPoint;
use patchmill_orientation::orientation::cutter_curvature;
use patchmill_orientation::orientation::leads;
use patchmill_orientation::step_over::offset_cutter;

/// Directions of lean that are looked at around a normal: the cutter's curvature is the same for a lean and its opposite.
const DIRECTIONS: usize = 48;

/// Length, m, below which no toolpath that keeps the rolling ball's lead at every point can bring the cut, to second order: at every
/// point the axis leans by the ball's lead in the direction, and the cut runs in the direction, that allow the widest step-over.
///
/// With M the curvature of cutter less surface in the tangent plane, a pass along t leaves a valley of curvature det M / tᵀM t, least along
/// M's larger principal direction, where it is M's lesser eigenvalue λ; the step-over is √(8h/λ), at most the cutter's diameter.
/// Passes, links, retracts, borders and the machine's limits only add to it.
///
/// # Errors
/// With the place where the cutter does not fit.
pub fn least_cut_length(surface: &PreparedSurface, job: &Job) -> Result<f64, String> {
    let cutter = offset_cutter(job);
    let points: Vec<&CloudPoint> = surface.cloud.iter().filter(|p| p.area > 0.0).collect();
    let leads = leads(&points, cutter, job)?;
    let widest = |(p, lead): (&&CloudPoint, &f64)| p.area / widest_step(p, *lead, cutter, job.scallop_height);
    let lengths: Vec<f64> = points.par_iter().zip(&leads).map(widest).collect();
    Ok(lengths.iter().sum())
}

/// Largest step-over (m, on the surface) that leaves a scallop of `height` (m) at a point with the axis leaning by `lead` (rad).
fn widest_step(point: &CloudPoint, lead: f64, cutter: Cutter, height: f64) -> f64 {
    let (u, v) = tangents(&point.normal);
    let step = |direction: f64| {
        let across = u * direction.cos() + v * direction.sin();
        let axis = Unit::new_normalize(point.normal * lead.cos() + across * lead.sin());
        let relative = cutter_curvature(cutter, &axis, &point.normal)? - point.curvature;
        let [uu, uv, vv] = [u.dot(&(relative * u)), u.dot(&(relative * v)), v.dot(&(relative * v))];
        let least = Matrix2::new(uu, uv, uv, vv).symmetric_eigenvalues().min();
        (least > 0.0).then(|| (8.0 * height / least).sqrt())
    };
    let longest = 2.0 * cutter.radius();
    let steps = (0..DIRECTIONS).filter_map(|i| step(PI * i as f64 / DIRECTIONS as f64));
    // The bottom touches to second order whichever way it leans: nothing bounds the step but the cutter.
    steps.reduce(f64::max).unwrap_or(longest).min(longest)
}

fn tangents(normal: &Vector3<f64>) -> (Vector3<f64>, Vector3<f64>) {
    let other = if normal.x.abs() < 0.9 { Vector3::x() } else { Vector3::y() };
    let u = (other - normal * normal.dot(&other)).normalize();
    (u, normal.cross(&u))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix3, Point3};

    fn point(curvature: Matrix3<f64>) -> CloudPoint {
        CloudPoint {
            position: Point3::origin(),
            normal: Vector3::z(),
            pseudo_curvature: 0.0,
            curvature,
            facet_error: 0.0,
            area: 1e-6,
        }
    }

    #[test]
    fn the_step_of_plane_and_cylinder_is_the_known_one() {
        let (cutter, height) = (Cutter { r1: 0.01305, r2: 0.006 }, 25.4e-6);
        let lead = 5f64.to_radians();
        // On a plane the effective radius is R2 + R1/sin θ whichever way the tool leans.
        let effective = 0.006 + 0.01305 / lead.sin();
        let plane = widest_step(&point(Matrix3::zeros()), lead, cutter, height);
        assert!((plane - (8.0 * height * effective).sqrt()).abs() < 1e-9, "{plane}");
        // In a hollow cylinder of 250 mm along x the tool leans along x: 1/R_e − 1/250 mm across.
        let hollow = Matrix3::from_diagonal(&Vector3::new(0.0, 4.0, 0.0));
        let cylinder = widest_step(&point(hollow), lead, cutter, height);
        assert!((cylinder - (8.0 * height / (1.0 / effective - 4.0)).sqrt()).abs() < 1e-9, "{cylinder}");
        // A ball-end knows no lean; nothing is wider than the cutter.
        let ball = widest_step(&point(Matrix3::zeros()), lead, Cutter { r1: 0.0, r2: 0.01 }, height);
        assert!((ball - (8.0 * height * 0.01).sqrt()).abs() < 1e-9);
        let snug = Matrix3::from_diagonal(&Vector3::new(0.0, 1.0 / effective, 0.0));
        assert_eq!(widest_step(&point(snug), lead, cutter, height), 2.0 * cutter.radius());
    }
}
