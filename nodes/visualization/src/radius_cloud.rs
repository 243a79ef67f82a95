//! The samples with the rolling ball's radius, as points of a cloud.

use patchmill_products::field::RollingBallField;
use patchmill_products::samples::SurfaceSamples;

use crate::cloud::Cloud;
use crate::colours::{of_radius, shown_radius};

/// The cloud of the samples: of all of them, or, where they are too many for one message, of every second, third … as
/// [`Cloud::stride`] says. `radius` is that of the rolling ball, m, positive where concave, within ±0.5 m as in the paper.
pub fn radius_cloud(samples: &SurfaceSamples, field: &RollingBallField) -> Cloud {
    let all = samples.len().min(field.pseudo_curvature.len());
    let mut cloud = Cloud::new("radius", Cloud::stride_of(all));
    for i in (0..all).step_by(cloud.stride) {
        let radius = shown_radius(field.pseudo_curvature[i]);
        cloud.push(&samples.points[i], radius, of_radius(radius));
    }
    cloud
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloud::POINT_BYTES;
    use nalgebra::Point3;

    fn inputs(n: usize) -> (SurfaceSamples, RollingBallField) {
        let points = (0..n).map(|i| Point3::new(i as f64 * 1e-4, 0.02, -0.01)).collect();
        let curvature = (0..n).map(|i| [20.0, -20.0, 0.1, 0.0][i % 4]).collect();
        let samples = SurfaceSamples { points, ..SurfaceSamples::default() };
        (samples, RollingBallField { pseudo_curvature: curvature, ..RollingBallField::default() })
    }

    fn number(cloud: &Cloud, point: usize, entry: usize) -> [u8; 4] {
        let at = point * POINT_BYTES + 4 * entry;
        cloud.data[at..at + 4].try_into().unwrap()
    }

    #[test]
    fn points_carry_place_radius_and_colour() {
        let (samples, field) = inputs(2500);
        let cloud = radius_cloud(&samples, &field);
        assert_eq!((cloud.count, cloud.stride, cloud.data.len()), (2500, 1, 50_000));
        let radius = |i| f32::from_le_bytes(number(&cloud, i, 3));
        assert_eq!([radius(0), radius(1), radius(2), radius(3)], [0.05, -0.05, 0.5, 0.5]);
        assert_eq!(f32::from_le_bytes(number(&cloud, 7, 0)), 7e-4);
        // Nine tenths of the way from white (F7F7F7) to red (B2182B), little-endian: blue, green, red, 0.
        assert_eq!(number(&cloud, 0, 4), [0x3F, 0x2E, 0xB9, 0]);
        assert_eq!(number(&cloud, 2, 4), [0xF7, 0xF7, 0xF7, 0]);
    }

    #[test]
    fn many_samples_are_thinned_evenly_below_the_bound() {
        let (samples, field) = inputs(100_001);
        let cloud = radius_cloud(&samples, &field);
        assert_eq!(cloud.stride, 18);
        assert_eq!(cloud.count, 100_001usize.div_ceil(18));
        assert!(cloud.data.len() <= 110 * 1024 && cloud.data.len() == cloud.count * POINT_BYTES);
        assert_eq!(radius_cloud(&inputs(5632).0, &inputs(5632).1).stride, 1);
        assert_eq!(radius_cloud(&inputs(5633).0, &inputs(5633).1).stride, 2);
    }
}
