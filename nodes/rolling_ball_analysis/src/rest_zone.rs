//! Where the tool does not fit: what is left standing when the job allows it.
//!
//! At a point whose rolling ball has the radius R* the tool has to lean by sin θ = R1/(R* − R2) at least. A point at which that is
//! more than the job's rest lead, or which holds the tool at no lead, is tight. A pass is lifted where its line crosses tight ground, so up to
//! half a step-over beside that may be left as well: the rest zone goes on so far.

use nalgebra::{Point3, Vector3};
use patchmill_geometry::point_grid::Grid;
use patchmill_geometry::sweep::ProofPoints;
use patchmill_products::job::Job;
use rayon::prelude::*;

use crate::local_balls::LocalBalls;

/// Share by which κ* stays below the limit: beyond rounding, no more.
const TINY: f64 = 1e-9;
/// Distance of the places that are probed for tight ground, as a share of the zone's margin: the zone must not depend on where the points
/// lie that it is asked for, or two checks with points of their own would disagree about it.
const PROBES: f64 = 0.25;
/// The distance grows rather than let there be more of them.
const MOST_PROBES: f64 = 400e3;

/// The largest κ* at which the job's tool fits with leads up to the rest lead, stock allowance included, 1/m.
pub fn tightest_fit(job: &Job) -> f64 {
    let (cutter, sine) = (job.tool.cutter, job.rest_lead.sin());
    sine / (cutter.r1 + (cutter.r2 + job.stock_allowance) * sine) * (1.0 - TINY)
}

/// Half the step-over on a plane at the rest lead, m: how far beyond tight ground the rest zone goes.
pub fn zone_margin(job: &Job) -> f64 {
    0.5 * job.tool.cutter.step_over_on_plane(job.rest_lead, job.scallop_height)
}

/// Points of the rest zone with their κ*.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RestZone {
    /// κ* of every point, 1/m.
    pub curvature: Vec<f64>,
    /// Whether it belongs to the zone.
    pub within: Vec<bool>,
}

impl RestZone {
    /// Of points on facets with their unit normals.
    pub fn of(balls: &LocalBalls, points: &[Point3<f64>], normals: &[Vector3<f64>], job: &Job) -> Self {
        let curvature = balls.curvatures(points, normals);
        let limit = tightest_fit(job);
        let margin = zone_margin(job).max(1e-6);
        let own = points.iter().zip(&curvature).filter(|(_, k)| **k > limit).map(|(p, _)| *p);
        let tight: Vec<Point3<f64>> = own.chain(probed(balls, points, margin, limit)).collect();
        let grid = Grid::new(&tight, margin);
        let within =
            points.iter().zip(&curvature).map(|(p, k)| *k > limit || grid.has_near(p, margin)).collect();
        Self { curvature, within }
    }
}

/// Tight places no farther than `margin` (m) from any of the points.
fn probed(balls: &LocalBalls, points: &[Point3<f64>], margin: f64, limit: f64) -> Vec<Point3<f64>> {
    let mesh = balls.mesh();
    let spacing = (PROBES * margin).max((mesh.finished_area() / MOST_PROBES).sqrt());
    let asked = Grid::new(points, margin);
    let probes = ProofPoints::on_finished(mesh, spacing);
    let probes =
        probes.only(&probes.points.par_iter().map(|p| asked.has_near(p, margin)).collect::<Vec<_>>());
    let curvature = balls.curvatures(&probes.points, &probes.normals);
    probes.points.iter().zip(curvature).filter(|(_, k)| *k > limit).map(|(p, _)| *p).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use patchmill_geometry::bvh::Bvh;
    use patchmill_geometry::cutter::Cutter;
    use patchmill_geometry::mesh::TriangleMesh;
    use patchmill_products::job::Tool;

    /// A valley along x between planes at 45° with a fillet of radius `r` in its bottom, 40 mm long, 2 × 20 mm wide.
    fn valley(r: f64) -> TriangleMesh {
        let half = (0.5f64).sqrt();
        // From the middle of the fillet along the section: place and normal, y ≥ 0.
        let at = |s: f64| {
            let arc = r * std::f64::consts::FRAC_PI_4;
            let angle = s.abs().min(arc) / r;
            let beyond = (s.abs() - arc).max(0.0);
            let y = r * angle.sin() + beyond * half;
            let z = r * (1.0 - angle.cos()) + beyond * half;
            (s.signum() * y, z, Vector3::new(0.0, -s.signum() * angle.sin(), angle.cos()))
        };
        let (rows, columns, step) = (161usize, 21usize, 0.25e-3);
        let mut mesh = TriangleMesh::default();
        for i in 0..rows {
            let (y, z, normal) = at((i as f64 - 80.0) * step);
            for j in 0..columns {
                mesh.vertices.push(Point3::new(j as f64 * 2e-3, y, z));
                mesh.normals.push(normal);
            }
        }
        for i in 0..rows - 1 {
            for j in 0..columns - 1 {
                let [a, b] = [i * columns + j, (i + 1) * columns + j].map(|v| v as u32);
                mesh.triangles.extend([[a, a + 1, b + 1], [a, b + 1, b]]);
            }
        }
        mesh
    }

    fn job(r1: f64, r2: f64, lead: f64) -> Job {
        Job { tool: Tool::bare(Cutter { r1, r2 }, 0.1), rest_lead: lead, ..Job::default_for("s") }
    }

    #[test]
    fn the_limit_is_the_lead_of_the_ball() {
        let job = job(0.01305, 0.006, 43.38f64.to_radians());
        assert!((1.0 / tightest_fit(&job) - 25e-3).abs() < 1e-6);
        let ball = Job { tool: Tool::bare(Cutter { r1: 0.0, r2: 0.006 }, 0.1), ..job.clone() };
        assert!((1.0 / tightest_fit(&ball) - 6e-3).abs() < 1e-9);
        let more = Job { stock_allowance: 1e-3, ..ball };
        assert!((1.0 / tightest_fit(&more) - 7e-3).abs() < 1e-9);
    }

    /// In the fillet the ball is the fillet's; on the plane beside it a ball that touches both sides has the radius of its distance from
    /// where the planes would meet.
    #[test]
    fn balls_in_a_valley_have_the_known_radii_and_the_zone_its_width() {
        let mesh = valley(5e-3);
        let bvh = Bvh::build(&mesh);
        let job = job(0.0, 6e-3, 0.7);
        let balls = LocalBalls::of(&mesh, &bvh, &job);
        let place = |i: usize| (mesh.vertices[i * 21 + 10], mesh.normals[i * 21 + 10]);
        let radius = |i: usize| 1.0 / balls.curvature_at(&place(i).0, &place(i).1);
        assert!((radius(80) - 5e-3).abs() < 0.05e-3, "{}", radius(80));
        for i in [96, 98, 99] {
            // Only a ball that stops the tool is looked for as far as it goes. The planes would meet below the fillet, whose ends are `r` from there along the planes.
            let expected = 5e-3 + ((i - 80) as f64 * 0.25e-3 - 5e-3 * std::f64::consts::FRAC_PI_4);
            assert!((radius(i) - expected).abs() < 0.03 * expected, "{i}: {} {expected}", radius(i));
        }
        let (points, normals): (Vec<_>, Vec<_>) = (80..=160).map(place).unzip();
        let zone = RestZone::of(&balls, &points, &normals, &job);
        let last = zone.within.iter().rposition(|within| *within).unwrap() as f64 * 0.25e-3;
        // Tight up to 6 mm from the planes' meeting, and the margin.
        let edge = 5e-3 * std::f64::consts::FRAC_PI_4 + 1e-3 + zone_margin(&job);
        assert!((last - edge).abs() < 0.4e-3, "{last} {edge}");
        assert!(zone.within[..20].iter().all(|within| *within));
    }

    #[test]
    fn a_smaller_tool_has_no_zone() {
        let mesh = valley(5e-3);
        let bvh = Bvh::build(&mesh);
        let job = job(0.0, 4e-3, 0.7);
        let balls = LocalBalls::of(&mesh, &bvh, &job);
        let zone = RestZone::of(&balls, &mesh.vertices, &mesh.normals, &job);
        assert!(zone.within.iter().all(|within| !within));
    }
}
