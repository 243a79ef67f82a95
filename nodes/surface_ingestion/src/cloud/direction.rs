//! The direction along which a cloud is a height field: the mean of its normals.

use nalgebra::{Matrix3, Vector3};

/// The share of the normals that may stand steeper than [`STEEP_COSINE`] allows.
const SHARE: f64 = 0.01;
/// Cosine of the steepest angle between a normal and the direction: 80°.
pub const STEEP_COSINE: f64 = 0.173_648_177_666_930_36;
/// Steps to the mean of the normals on its own side.
const STEPS: usize = 20;

/// Unit directions, none pointing below the horizontal, each the mean of those `normals` (unit, on either side) that are turned to it,
/// and the cosine to it that all but one percent of them exceed. The first is that from above, the others follow by that cosine.
pub fn directions(normals: &[Vector3<f64>]) -> Vec<(Vector3<f64>, f64)> {
    let spread: Matrix3<f64> = normals.iter().map(|n| n * n.transpose()).sum();
    let axes = spread.symmetric_eigen().eigenvectors;
    let along = |start: Vector3<f64>| {
        let mean = mean_turned_to(normals, start);
        (if mean.z < 0.0 { -mean } else { mean }, low_cosine(normals, &mean))
    };
    let mut others = [0, 1, 2].map(|k| along(axes.column(k).into()));
    others.sort_by(|a, b| b.1.total_cmp(&a.1));
    let mut found = vec![along(Vector3::z())];
    for other in others {
        if found.iter().all(|(direction, _)| direction.dot(&other.0).abs() < 1.0 - 1e-6) {
            found.push(other);
        }
    }
    found
}

fn mean_turned_to(normals: &[Vector3<f64>], start: Vector3<f64>) -> Vector3<f64> {
    let mut mean = start;
    for _ in 0..STEPS {
        let sum: Vector3<f64> = normals.iter().map(|n| n * n.dot(&mean).signum()).sum();
        let next = sum.try_normalize(0.0).unwrap_or(mean);
        let step = (next - mean).norm();
        mean = next;
        if step < 1e-6 {
            break;
        }
    }
    mean
}

fn low_cosine(normals: &[Vector3<f64>], direction: &Vector3<f64>) -> f64 {
    let mut cosines: Vec<f64> = normals.iter().map(|n| n.dot(direction).abs()).collect();
    let place = (cosines.len() as f64 * SHARE) as usize;
    if cosines.is_empty() { 0.0 } else { *cosines.select_nth_unstable_by(place, f64::total_cmp).1 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn walls_of_a_groove_do_not_outvote_its_direction() {
        let wall = |s: f64, tilt: f64| Vector3::new(s * tilt.sin(), 0.0, tilt.cos());
        let normals: Vec<_> = (0..100).flat_map(|_| [wall(1.0, 1.1), -wall(-1.0, 1.1)]).collect();
        let (direction, least) = directions(&normals)[0];
        assert!((direction - Vector3::z()).norm() < 1e-9 && (least - 1.1f64.cos()).abs() < 1e-9);
    }

    #[test]
    fn a_tilted_plane_is_seen_from_its_upper_side_and_a_tube_from_none() {
        let normal = Vector3::new(0.8, 0.0, -0.6);
        assert!((directions(&[normal; 10])[0].0 + normal).norm() < 1e-9);
        let tube: Vec<_> = (0..360)
            .map(|a| Vector3::new(f64::from(a).to_radians().cos(), f64::from(a).to_radians().sin(), 0.0))
            .collect();
        assert!(directions(&tube).iter().all(|(_, least)| *least < STEEP_COSINE));
    }
}
