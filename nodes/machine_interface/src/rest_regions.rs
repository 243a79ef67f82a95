//! What a program leaves standing where the tool does not fit, as connected regions.

use nalgebra::Point3;
use patchmill_geometry::bvh::Bvh;
use patchmill_geometry::mesh::TriangleMesh;
use patchmill_geometry::point_grid::Grid;
use patchmill_geometry::sweep::ProofPoints;
use patchmill_products::evaluation::{REST_REGIONS, ResidualMap, RestRegion};
use patchmill_products::job::Job;
use patchmill_rolling_ball_analysis::local_balls::LocalBalls;
use patchmill_rolling_ball_analysis::rest_zone::{RestZone, zone_margin};

use crate::proof::{PartPoints, within_scallop};

/// Points of one region are no farther from the next one than this, m, or than a few points are apart.
const JOIN: f64 = 1e-3;
/// The same in distances of the points.
const JOIN_IN_SPACINGS: f64 = 2.5;

/// Points of a proof that are left standing where the tool does not fit.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Standing {
    /// Their numbers, in order.
    pub points: Vec<usize>,
    /// κ* of each, 1/m.
    curvature: Vec<f64>,
}

impl Standing {
    /// Of all points that keep more than `most` (m) those that lie in the rest zone, by balls rolled at them.
    pub fn find(map: &ResidualMap, points: &ProofPoints, most: f64, balls: &LocalBalls, job: &Job) -> Self {
        let is_left = |i: usize| map.leftover[i] > most;
        let left: Vec<Point3<f64>> =
            (0..map.points.len()).filter(|&i| is_left(i)).map(|i| map.points[i]).collect();
        // Tight ground of which nothing is left makes a zone as well: the points around what is left are looked at too.
        let margin = zone_margin(job);
        let grid = Grid::new(&left, margin);
        let around: Vec<usize> =
            (0..map.points.len()).filter(|&i| grid.has_near(&map.points[i], margin)).collect();
        let (places, normals): (Vec<_>, Vec<_>) =
            around.iter().map(|&i| (points.points[i], points.normals[i])).unzip();
        let zone = RestZone::of(balls, &places, &normals, job);
        let standing = || (0..around.len()).filter(|&a| zone.within[a] && is_left(around[a]));
        Self {
            points: standing().map(|a| around[a]).collect(),
            curvature: standing().map(|a| zone.curvature[a]).collect(),
        }
    }

    /// Whether each of `count` points is left standing.
    pub fn marks(&self, count: usize) -> Vec<bool> {
        let mut marks = vec![false; count];
        self.points.iter().for_each(|&i| marks[i] = true);
        marks
    }

    /// Their area (m²) and their connected regions, the largest first and no more than a proof lists. `weights` is the area of every
    /// point of the map, m².
    pub fn regions(&self, map: &ResidualMap, weights: &[f64]) -> (f64, Vec<RestRegion>) {
        let places: Vec<Point3<f64>> = self.points.iter().map(|&i| map.points[i]).collect();
        let spacing = weights.iter().copied().fold(0.0, f64::max).sqrt();
        let mut regions: Vec<RestRegion> = connected(&places, JOIN.max(JOIN_IN_SPACINGS * spacing))
            .iter()
            .filter_map(|members| self.region(members, map, weights))
            .collect();
        regions.sort_by(|a, b| b.area.total_cmp(&a.area));
        regions.truncate(REST_REGIONS);
        (self.points.iter().map(|&i| weights[i]).sum(), regions)
    }

    /// The region of these of the points.
    fn region(&self, members: &[usize], map: &ResidualMap, weights: &[f64]) -> Option<RestRegion> {
        let tightest = *members.iter().max_by(|&&a, &&b| self.curvature[a].total_cmp(&self.curvature[b]))?;
        let of_map = || members.iter().map(|&m| self.points[m]);
        let position = map.points[self.points[tightest]];
        let corner = |f: fn(&Point3<f64>, &Point3<f64>) -> Point3<f64>| {
            of_map().fold(position, |corner, i| f(&corner, &map.points[i]))
        };
        Some(RestRegion {
            position,
            bounds: [corner(|a, b| a.inf(b)), corner(|a, b| a.sup(b))],
            area: of_map().map(|i| weights[i]).sum(),
            ball_radius: 1.0 / self.curvature[tightest],
            leftover_max: of_map().map(|i| map.leftover[i]).fold(0.0, f64::max),
        })
    }
}

/// The points of a finished program's map that it leaves standing, m; none where the map is not of this mesh.
pub fn standing_points(mesh: &TriangleMesh, map: &ResidualMap, job: &Job) -> Vec<Point3<f64>> {
    let points = PartPoints::of(mesh, job).finished;
    if points.len() != map.points.len() {
        return Vec::new();
    }
    let bvh = Bvh::build(mesh);
    let balls = LocalBalls::of(mesh, &bvh, job);
    let standing = Standing::find(map, &points, within_scallop(job), &balls, job);
    standing.points.iter().map(|&i| map.points[i]).collect()
}

/// Groups of points in which each is within `distance` (m) of another one, by their numbers, in the order of their first ones.
fn connected(points: &[Point3<f64>], distance: f64) -> Vec<Vec<usize>> {
    let grid = Grid::new(points, distance);
    let mut seen = vec![false; points.len()];
    let mut groups = Vec::new();
    for start in 0..points.len() {
        if std::mem::replace(&mut seen[start], true) {
            continue;
        }
        let (mut group, mut next) = (vec![start], 0);
        while next < group.len() {
            let place = points[group[next]];
            grid.near(&place, distance, |_, i| {
                if !std::mem::replace(&mut seen[i as usize], true) {
                    group.push(i as usize);
                }
            });
            next += 1;
        }
        group.sort_unstable();
        groups.push(group);
    }
    groups
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn regions_have_their_area_place_and_size() {
        // Two rows of points 0.4 mm apart, 3 mm from each other, and one point that is not standing between them.
        let row = |y: f64, n: usize| (0..n).map(move |i| Point3::new(i as f64 * 0.4e-3, y, 0.0));
        let mut points: Vec<Point3<f64>> = row(0.0, 5).chain(row(3e-3, 10)).collect();
        points.push(Point3::new(0.0, 1.5e-3, 0.0));
        let leftover: Vec<f64> = (0..16).map(|i| 1e-4 * f64::from(i)).collect();
        let map = ResidualMap { points, leftover };
        let weights = vec![0.16e-6; 16];
        let curvature = (0..15).map(|i| if i == 7 { 500.0 } else { 200.0 }).collect();
        let standing = Standing { points: (0..15).collect(), curvature };
        let (area, regions) = standing.regions(&map, &weights);
        assert!((area - 15.0 * 0.16e-6).abs() < 1e-18);
        assert_eq!(regions.len(), 2);
        let [large, small] = &regions[..] else { panic!() };
        assert!((large.area - 1.6e-6).abs() < 1e-18 && (small.area - 0.8e-6).abs() < 1e-18);
        assert!((large.ball_radius - 2e-3).abs() < 1e-15 && (small.ball_radius - 5e-3).abs() < 1e-15);
        assert_eq!(large.position, map.points[7]);
        assert_eq!(large.bounds, [map.points[5], map.points[14]]);
        assert!((large.leftover_max - 14e-4).abs() < 1e-15);
        assert_eq!(standing.marks(16).iter().filter(|standing| !**standing).count(), 1);
    }
}
