//! What the chosen program leaves, as points of a cloud.

use patchmill_products::evaluation::ResidualMap;

use crate::cloud::Cloud;
use crate::colours::of_leftover;

/// The cloud of a map, `leftover` in m, coloured by its share of the scallop height (m).
///
/// Where the points are too many for one message, of every [`Cloud::stride`] neighbouring ones only the worst is there (points
/// come along a Morton curve): the deepest when one lies deeper below the surface than the highest stands above it, else the highest.
pub fn residual_cloud(map: &ResidualMap, scallop_height: f64) -> Cloud {
    let stride = Cloud::stride_of(map.points.len());
    let mut cloud = Cloud::new("leftover", stride);
    for (points, leftover) in map.points.chunks(stride).zip(map.leftover.chunks(stride)) {
        let worst = (0..leftover.len()).max_by(|&a, &b| leftover[a].abs().total_cmp(&leftover[b].abs()));
        let Some(worst) = worst else { continue };
        cloud.push(&points[worst], leftover[worst], of_leftover(leftover[worst], scallop_height));
    }
    cloud
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloud::POINT_BYTES;
    use nalgebra::Point3;

    fn map(count: usize) -> ResidualMap {
        let points = (0..count).map(|i| Point3::new(i as f64 * 1e-4, 0.0, 0.0)).collect();
        ResidualMap { points, leftover: (0..count).map(|i| (i % 10) as f64 * 1e-6).collect() }
    }

    #[test]
    fn the_worst_of_neighbouring_points_is_never_lost() {
        let mut map = map(60_000);
        map.leftover[31_234] = -30e-6;
        map.leftover[5] = 26e-6;
        let cloud = residual_cloud(&map, 25e-6);
        assert_eq!((cloud.stride, cloud.count), (11, 60_000usize.div_ceil(11)));
        let leftover = |i: usize| {
            let at = i * POINT_BYTES + 12;
            f32::from_le_bytes(cloud.data[at..at + 4].try_into().unwrap())
        };
        let all: Vec<f32> = (0..cloud.count).map(leftover).collect();
        assert!(all.contains(&-30e-6) && all.contains(&26e-6));
        assert_eq!(residual_cloud(&ResidualMap::default(), 25e-6).count, 0);
    }
}
