//! Feed direction and fixed tool axis of a patch: the paper's normals' ellipse and most inclined tool axis.

use nalgebra::{Matrix2, Matrix3, SymmetricEigen, Unit, Vector2, Vector3};
use patchmill_geometry::cutter::Cutter;
use patchmill_products::job::Job;

use crate::cloud_point::CloudPoint;

/// One way to hold the tool over a patch. `feed` is perpendicular to the mean normal; the axis lies in the plane of both.
#[derive(Clone, Copy, Debug)]
pub struct Orientation {
    /// Unit tool axis, tip to spindle.
    pub axis: Unit<Vector3<f64>>,
    /// Unit feed direction.
    pub feed: Vector3<f64>,
    /// Unit cross-feed direction, mean normal × feed: passes lie in planes perpendicular to it.
    pub cross_feed: Vector3<f64>,
    /// Largest inclination between the axis and a normal of the patch, rad.
    pub inclination: f64,
}

/// Least inclination θ at which the cutter's bottom stays inside the rolling ball, rad (paper, "Tool positioning").
///
/// sin θ = R1/(R* − R2), R* = 1/κ*, on concave places; the minimum lead where κ* ≤ 0. `None` when the ball is too
/// small for the cutter at any inclination.
pub fn least_lead(cutter: Cutter, pseudo_curvature: f64, lead_min: f64) -> Option<f64> {
    if pseudo_curvature <= 0.0 {
        return Some(lead_min);
    }
    let clearance = 1.0 - cutter.r2 * pseudo_curvature;
    let sine = cutter.r1 * pseudo_curvature / clearance;
    (clearance > 0.0 && sine < 1.0).then(|| sine.asin().max(lead_min))
}

/// [`least_lead`] of every point, rad.
///
/// # Errors
/// With the first place where the cutter does not fit, for a person to read.
pub fn leads(points: &[&CloudPoint], cutter: Cutter, job: &Job) -> Result<Vec<f64>, String> {
    points
        .iter()
        .map(|p| {
            least_lead(cutter, p.pseudo_curvature, job.lead_min).ok_or_else(|| {
                let q = p.position * 1e3;
                format!(
                    "the cutter of radius {:.2} mm does not fit at ({:.1}, {:.1}, {:.1}) mm, where the ball's radius is \
                     {:.2} mm",
                    cutter.radius() * 1e3,
                    q.x,
                    q.y,
                    q.z,
                    1e3 / p.pseudo_curvature
                )
            })
        })
        .collect()
}

/// The four orientations of the paper's rule: feed along ± either axis of the normals' ellipse, and the most
/// inclined axis β* = max(β_i + θ_i) from the mean normal towards the feed. Then α_i ≥ θ_i at every point.
///
/// `leads[i]` is θ of `points[i]`, rad. Empty when the mean normal vanishes.
pub fn orientations(points: &[&CloudPoint], leads: &[f64]) -> Vec<Orientation> {
    let Some(mean) = Unit::try_new(points.iter().map(|p| p.normal * p.area).sum::<Vector3<f64>>(), 1e-300)
    else {
        return Vec::new();
    };
    let (major, minor) = ellipse_axes(points, &mean);
    let inclined =
        |feed: Vector3<f64>| leaning(points, &mean, feed, most_inclined(points, leads, &mean, &feed));
    [major, -major, minor, -minor].into_iter().map(inclined).collect()
}

/// The same rule in `directions` feed directions evenly around the mean normal, each with `leans` axes: the most inclined
/// one and others that lean farther towards the feed by multiples of `step` (rad). The lead only grows with them.
pub fn orientations_around(
    points: &[&CloudPoint],
    leads: &[f64],
    directions: usize,
    leans: usize,
    step: f64,
) -> Vec<Orientation> {
    let Some(mean) = Unit::try_new(points.iter().map(|p| p.normal * p.area).sum::<Vector3<f64>>(), 1e-300)
    else {
        return Vec::new();
    };
    let (major, minor) = ellipse_axes(points, &mean);
    let direction = |i: usize| {
        let angle = std::f64::consts::TAU * i as f64 / directions as f64;
        major * angle.cos() + minor * angle.sin()
    };
    let fan = |feed: Vector3<f64>| {
        let least = most_inclined(points, leads, &mean, &feed);
        (0..leans).map(move |k| (feed, least + k as f64 * step))
    };
    (0..directions)
        .flat_map(|i| fan(direction(i)))
        .map(|(feed, lean)| leaning(points, &mean, feed, lean))
        .collect()
}

/// Three axes: the tool axis along +z, the feed along +x, +y and between them.
pub fn upright_orientations(points: &[&CloudPoint]) -> Vec<Orientation> {
    let inclination = points.iter().map(|p| p.normal.z.clamp(-1.0, 1.0).acos()).fold(0.0, f64::max);
    let along = |eighths: u32| {
        let angle = std::f64::consts::FRAC_PI_4 * f64::from(eighths);
        let feed = Vector3::new(angle.cos(), angle.sin(), 0.0);
        Orientation { axis: Vector3::z_axis(), feed, cross_feed: Vector3::z().cross(&feed), inclination }
    };
    (0..4).map(along).collect()
}

/// β* = max(β_i + θ_i): the least lean from the mean normal towards the feed that keeps every point's lead, rad.
fn most_inclined(
    points: &[&CloudPoint],
    leads: &[f64],
    mean: &Unit<Vector3<f64>>,
    feed: &Vector3<f64>,
) -> f64 {
    let leans = points.iter().zip(leads).map(|(p, lead)| p.normal.dot(feed).atan2(p.normal.dot(mean)) + lead);
    leans.fold(f64::NEG_INFINITY, f64::max)
}

/// The axis at `lean` (rad) from the mean normal towards the feed.
fn leaning(points: &[&CloudPoint], mean: &Unit<Vector3<f64>>, feed: Vector3<f64>, lean: f64) -> Orientation {
    let axis = Unit::new_normalize(mean.into_inner() * lean.cos() + feed * lean.sin());
    let inclination = points.iter().map(|p| p.normal.dot(&axis).clamp(-1.0, 1.0).acos()).fold(0.0, f64::max);
    Orientation { axis, feed, cross_feed: mean.cross(&feed), inclination }
}

/// Unit axes of the 1-sigma ellipse of the normals projected along the mean normal, major first. Where the normals
/// do not tell the axes apart (planes, spheres) the patch's own longest extent is the major axis.
fn ellipse_axes(points: &[&CloudPoint], mean: &Unit<Vector3<f64>>) -> (Vector3<f64>, Vector3<f64>) {
    let u = if mean.x.abs() < 0.9 { Vector3::x() } else { Vector3::y() };
    let u = (u - mean.into_inner() * mean.dot(&u)).normalize();
    let v = mean.cross(&u);
    let area: f64 = points.iter().map(|p| p.area).sum();
    let covariance = |of: &dyn Fn(&CloudPoint) -> Vector3<f64>| {
        let flat = |p: &CloudPoint| {
            let w = of(p);
            Vector2::new(w.dot(&u), w.dot(&v))
        };
        let mean: Vector2<f64> = points.iter().map(|p| flat(p) * p.area).sum::<Vector2<f64>>() / area;
        points.iter().map(|p| (flat(p) - mean) * (flat(p) - mean).transpose() * p.area).sum::<Matrix2<f64>>()
            / area
    };
    let mut eigen = SymmetricEigen::new(covariance(&|p| p.normal));
    let (large, small) = (eigen.eigenvalues.max(), eigen.eigenvalues.min());
    if large < 1e-10 || large - small < 1e-3 * large {
        eigen = SymmetricEigen::new(covariance(&|p| p.position.coords));
    }
    let first = eigen.eigenvectors.column(eigen.eigenvalues.imax());
    // An eigenvector's sign is arbitrary: fix it, so that the same patch always gives the same four directions.
    let mut major = u * first[0] + v * first[1];
    let dominant = major.iamax();
    if major[dominant] < 0.0 {
        major = -major;
    }
    (major, mean.cross(&major))
}

/// Curvature tensor of the cutter at the contact with a surface of normal `n`, 1/m: 1/R2 along the projected axis,
/// 1/(R2 + R1/sin α) across it.
pub fn cutter_curvature(cutter: Cutter, axis: &Unit<Vector3<f64>>, n: &Vector3<f64>) -> Option<Matrix3<f64>> {
    let along = axis.into_inner() - n * axis.dot(n);
    let sine = along.norm();
    if sine < 1e-9 {
        return None;
    }
    let along = along / sine;
    let across = n.cross(&along);
    // A flat-end's corner is sharp: a nanometre of radius keeps the tensor finite.
    let corner = cutter.r2.max(1e-9);
    Some(along * along.transpose() / corner + across * across.transpose() / (corner + cutter.r1 / sine))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;

    const INCH_AND_A_HALF: Cutter = Cutter { r1: 0.01305, r2: 0.006 };

    #[test]
    fn lead_in_the_ball_has_its_known_values() {
        for (radius, degrees) in [(25e-3, 43.38), (40e-3, 22.57), (83e-3, 9.76), (156e-3, 4.99)] {
            let lead = least_lead(INCH_AND_A_HALF, 1.0 / radius, 0.0).unwrap().to_degrees();
            assert!((lead - degrees).abs() < 5e-3, "R* = {radius}: {lead}");
        }
        assert_eq!(least_lead(INCH_AND_A_HALF, 1.0 / 19.05e-3, 0.1), None);
        assert_eq!(least_lead(INCH_AND_A_HALF, -40.0, 0.1), Some(0.1));
    }

    #[test]
    fn most_inclined_axis_keeps_every_lead() {
        let points: Vec<CloudPoint> = (0..400)
            .map(|i| {
                let (x, y) = ((i / 20) as f64 / 20.0 - 0.4, (i % 20) as f64 / 20.0 - 0.6);
                CloudPoint {
                    position: Point3::new(x, y, 0.0),
                    normal: Vector3::new(0.7 * x + 0.2 * y, 0.3 * y * y - 0.1 * x, 1.0).normalize(),
                    pseudo_curvature: 0.0,
                    curvature: Matrix3::zeros(),
                    facet_error: 0.0,
                    area: 1.0 + x * y,
                }
            })
            .collect();
        let points: Vec<&CloudPoint> = points.iter().collect();
        let leads: Vec<f64> = (0..points.len()).map(|i| 0.09 + 0.2 * ((i * 7) % 13) as f64 / 13.0).collect();
        let found = orientations(&points, &leads);
        assert_eq!(found.len(), 4);
        for orientation in found {
            assert!(orientation.feed.dot(&orientation.cross_feed).abs() < 1e-12);
            for (p, lead) in points.iter().zip(&leads) {
                assert!(p.normal.dot(&orientation.axis).acos() >= lead - 1e-12);
            }
        }
        let around = orientations_around(&points, &leads, 8, 3, 0.1);
        assert_eq!(around.len(), 24);
        for orientation in around {
            assert!(orientation.feed.dot(&orientation.cross_feed).abs() < 1e-12);
            for (p, lead) in points.iter().zip(&leads) {
                assert!(p.normal.dot(&orientation.axis).acos() >= lead - 1e-12);
            }
        }
    }
}
