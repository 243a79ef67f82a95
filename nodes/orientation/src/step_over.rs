//! Step-over for a scallop height, restated from the geometry of second order; the paper takes the effective radius at each contact point
//! ("Tool path generation").
//!
//! The gap between cutter and surface around a contact is, to second order, ½ pᵀ·M·p with the relative curvature
//! M = K_cutter − K_surface. While the contact moves along the unit tangent c the cutter sweeps a valley whose gap is
//! ½ k_D·q² at the distance q across c, k_D = det M / (cᵀ·M·c); on a plane that is 1/R_eff with
//! R_eff = R2 + (R1/sin α)·cos²ω. Two valleys a distance s apart meet at the height k_D·s²/8.

use nalgebra::{Matrix3, Vector3};

use crate::cloud_point::CloudPoint;
use crate::orientation::Orientation;
use patchmill_geometry::cutter::Cutter;
use patchmill_products::job::Job;

/// Share of the second-order step that is used: the true swept profile is an offset ellipse, whose step is up to 1.4 %
/// shorter at small leads, and the share of area above the height is half of the excess.
pub(crate) const STEP_SHARE: f64 = 0.98;

/// Where pass planes lie along the surface, so that the distance across them is less than this share of that on the surface, a
/// density counts as if it were this share.
pub(crate) const STEEP: f64 = 0.05;
/// A flat-end whose bottom does not clear the surface counts as if its corner had this radius, m.
pub(crate) const LEAST_CORNER: f64 = 1e-5;

/// How a pass cuts around one point.
#[derive(Clone, Copy, Debug)]
pub struct Valley {
    /// Curvature of the swept valley relative to the surface across the pass, 1/m.
    pub curvature: f64,
    /// Shift along the pass, per distance across it, of the cutter contact that reaches a point deepest.
    pub shear: f64,
    /// Distance across the pass planes per distance on the surface.
    pub slope: f64,
}

/// The shape of the surface at a point, in its tangent plane: what the step-over of many orientations there is taken from.
#[derive(Clone, Copy, Debug)]
pub struct TangentShape {
    pub(crate) u: Vector3<f64>,
    pub(crate) v: Vector3<f64>,
    /// Curvature of the surface along u, between them and along v, 1/m.
    pub(crate) curvature: [f64; 3],
}

/// The relative curvature M = K_cutter − K_surface along u, between them and along v, 1/m, and its determinant, 1/m², for a tool
/// axis with components [u, v] (sin α long): 1/R2 along those, 1/(R2 + R1/sin α) across. The determinant is −1 where the axis is the normal. No
/// branch, fewest divisions: with s = sin α the curvatures are s/(R2·s + R1) and 1/R2, brought to one denominator.
#[inline(always)]
pub(crate) fn relative(cutter: Cutter, [au, av]: [f64; 2], [uu, uv, vv]: [f64; 3]) -> [f64; 4] {
    let sine2 = au * au + av * av;
    // A flat-end's corner is sharp: a nanometre of radius keeps the tensor finite.
    let (sine, corner) = (sine2.sqrt(), if cutter.r2 > 1e-9 { cutter.r2 } else { 1e-9 });
    let along = corner * sine + cutter.r1;
    let inverse = 1.0 / (along * corner * sine2);
    let (least, more) = (sine * corner * sine2 * inverse, cutter.r1 * inverse);
    let (uu, uv, vv) = (least + more * au * au - uu, more * au * av - uv, least + more * av * av - vv);
    [uu, uv, vv, if sine2 >= 1e-18 { uu * vv - uv * uv } else { -1.0 }]
}

impl TangentShape {
    /// From the unit normal and the curvature tensor, 1/m.
    pub fn new(normal: &Vector3<f64>, curvature: &Matrix3<f64>) -> Self {
        let other = if normal.x.abs() < 0.9 { Vector3::x() } else { Vector3::y() };
        let u = (other - normal * normal.dot(&other)).normalize();
        let v = normal.cross(&u);
        Self { u, v, curvature: [u.dot(&(curvature * u)), u.dot(&(curvature * v)), v.dot(&(curvature * v))] }
    }

    /// Components of a direction along u and v.
    pub fn components(&self, direction: &Vector3<f64>) -> [f64; 2] {
        [self.u.dot(direction), self.v.dot(direction)]
    }

    /// The valley that a pass in a plane perpendicular to `cross_feed` cuts; `None` where the cutter's bottom does not clear the
    /// surface to second order.
    #[inline]
    pub fn valley(&self, cutter: Cutter, axis: &Vector3<f64>, cross_feed: &Vector3<f64>) -> Option<Valley> {
        let ([au, av], [cu, cv]) = (self.components(axis), self.components(cross_feed));
        let (sine, slope) = ((au * au + av * av).sqrt(), (cu * cu + cv * cv).sqrt());
        if sine < 1e-9 || slope < 1e-9 {
            return None;
        }
        // 1/R2 along the projected axis, 1/(R2 + R1/sin α) across it. A flat-end's corner is sharp: a nanometre of radius keeps the
        // tensor finite.
        let corner = cutter.r2.max(1e-9);
        let least = 1.0 / (corner + cutter.r1 / sine);
        let more = (1.0 / corner - least) / (sine * sine);
        let [uu, uv, vv] = self.curvature;
        let (uu, uv, vv) = (least + more * au * au - uu, more * au * av - uv, least + more * av * av - vv);
        // Across the pass, and along it.
        let (du, dv) = (cu / slope, cv / slope);
        let (tu, tv) = (dv, -du);
        let cc = tu * (uu * tu + uv * tv) + tv * (uv * tu + vv * tv);
        let cd = tu * (uu * du + uv * dv) + tv * (uv * du + vv * dv);
        let determinant = uu * vv - uv * uv;
        if cc <= 0.0 || determinant <= 0.0 {
            return None;
        }
        Some(Valley { curvature: determinant / cc, shear: cd / cc, slope })
    }

    /// Distances between passes (m) that leave a scallop of `height` (m), for directions that passes lie `across`, each times that
    /// direction's length: [`Self::allowed_distance`] with fewer roots and divisions.
    #[inline]
    pub fn allowed_distances<const N: usize>(
        &self,
        axis: &Vector3<f64>,
        across: &[Vector3<f64>; N],
        cutter: Cutter,
        height: f64,
    ) -> [f64; N] {
        let [uu, uv, vv, determinant] = relative(cutter, self.components(axis), self.curvature);
        let (share, longest2) = (8.0 * height / determinant, cutter.radius() * cutter.radius());
        across.map(|across| {
            let [cu, cv] = self.components(&across);
            let slope2 = cu * cu + cv * cv;
            let cc = cv * (uu * cv - uv * cu) - cu * (uv * cv - vv * cu);
            let clears = determinant > 0.0 && cc > 0.0 && slope2 >= 1e-18;
            // √(8h/k_D)·slope with k_D = det M·slope²/cc, at most the radius on the surface.
            let square = if clears {
                (share * cc).min(longest2 * slope2)
            } else {
                8.0 * height * cutter.r2.max(LEAST_CORNER) * across.norm_squared()
            };
            square.sqrt() * STEP_SHARE
        })
    }

    /// Distance between pass planes (m) that leaves a scallop of `height` (m), and the distance across the planes per distance on the
    /// surface.
    #[inline]
    pub fn allowed_distance(&self, orientation: &Orientation, cutter: Cutter, height: f64) -> (f64, f64) {
        match self.valley(cutter, &orientation.axis, &orientation.cross_feed) {
            Some(valley) => (plane_distance(&valley, height, cutter.radius()) * STEP_SHARE, valley.slope),
            // The bottom touches all around: the corner alone still cuts a valley of radius R2.
            None => ((8.0 * height * cutter.r2.max(LEAST_CORNER)).sqrt() * STEP_SHARE, 1.0),
        }
    }
}

/// The valley that a pass in a plane perpendicular to `cross_feed` cuts at a point ([`TangentShape::valley`]).
pub fn valley(
    cutter: Cutter,
    orientation: &Orientation,
    normal: &Vector3<f64>,
    surface_curvature: &Matrix3<f64>,
) -> Option<Valley> {
    TangentShape::new(normal, surface_curvature).valley(cutter, &orientation.axis, &orientation.cross_feed)
}

/// Distance between pass planes, m, that leaves a scallop of `height` (m) at a point: s·slope with
/// s = √(8h/k_D), no more than `longest` on the surface.
pub fn plane_distance(valley: &Valley, height: f64, longest: f64) -> f64 {
    (8.0 * height / valley.curvature).sqrt().min(longest) * valley.slope
}

/// Distance between pass planes (m) that the job's scallop height allows at a point, and the distance across the planes per
/// distance on the surface.
pub fn allowed_distance(
    point: &CloudPoint,
    orientation: &Orientation,
    cutter: Cutter,
    job: &Job,
) -> (f64, f64) {
    let height = scallop_budget(point, job.scallop_height, job.pass_chord);
    TangentShape::new(&point.normal, &point.curvature).allowed_distance(orientation, cutter, height)
}

/// Scallop height left to the spacing at a point, m: facet and chord error are taken out of the job's height first, and
/// a tenth of it is always kept (where even that is missing the swept check decides).
pub fn scallop_budget(point: &CloudPoint, scallop_height: f64, pass_chord: f64) -> f64 {
    (scallop_height - point.facet_error - pass_chord).max(0.1 * scallop_height)
}

/// The cutter grown by the stock allowance: dropping it leaves the allowance everywhere.
pub fn offset_cutter(job: &Job) -> Cutter {
    Cutter { r1: job.tool.cutter.r1, r2: job.tool.cutter.r2 + job.stock_allowance }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Point3, Unit};

    const INCH_AND_A_HALF: Cutter = Cutter { r1: 0.01305, r2: 0.006 };

    fn held(lead_degrees: f64, turn_degrees: f64) -> Orientation {
        let (lead, turn) = (lead_degrees.to_radians(), turn_degrees.to_radians());
        let axis = Vector3::new(lead.sin() * turn.cos(), lead.sin() * turn.sin(), lead.cos());
        Orientation {
            axis: Unit::new_normalize(axis),
            feed: Vector3::x(),
            cross_feed: Vector3::y(),
            inclination: lead,
        }
    }

    #[test]
    fn a_plane_gives_the_effective_radius() {
        let cases = [(5.0, 0.0, 155.73e-3), (15.0, 0.0, 56.42e-3), (15.0, 40.0, 35.59e-3), (5.0, 90.0, 6e-3)];
        for (lead, turn, radius) in cases {
            let found = valley(INCH_AND_A_HALF, &held(lead, turn), &Vector3::z(), &Matrix3::zeros()).unwrap();
            assert!(
                (1.0 / found.curvature - radius).abs() < 2e-5,
                "{lead} {turn}: {}",
                1.0 / found.curvature
            );
        }
    }

    #[test]
    fn distances_at_once_are_those_one_by_one() {
        let normal = Vector3::new(0.2, -0.3, 0.9).normalize();
        let flat = Matrix3::identity() - normal * normal.transpose();
        for i in 0..400 {
            let at = |k: usize| ((i * 7 + k * 13) as f64 * 0.618).fract() * 2.0 - 1.0;
            let (p, q) = (Vector3::new(at(0), at(1), at(2)), Vector3::new(at(3), at(4), at(5)));
            let curvature = flat * (p * p.transpose() * (40.0 * at(6)) - q * q.transpose() * 9.0) * flat;
            let mut held = held(60.0 * at(7).abs(), 180.0 * at(8));
            held.cross_feed = Vector3::new(at(9), at(10), at(11)).normalize();
            let shape = TangentShape::new(&normal, &curvature);
            // The flat-end's nanometre of corner radius costs digits in both.
            let cutters = [(0.01305, 0.006, 1e-12), (0.0, 0.006, 1e-12), (0.01, 0.0, 1e-6)];
            for (cutter, digits) in cutters.map(|(r1, r2, digits)| (Cutter { r1, r2 }, digits)) {
                let (expected, _) = shape.allowed_distance(&held, cutter, 2e-5);
                let across = [held.cross_feed, held.cross_feed * 2.0];
                let [found, twice] = shape.allowed_distances(&held.axis, &across, cutter, 2e-5);
                assert!((found / expected - 1.0).abs() < digits, "{i} {cutter:?}: {found} {expected}");
                assert!((twice / found - 2.0).abs() < digits, "{i} {cutter:?}: {twice} {found}");
            }
        }
    }

    #[test]
    fn the_valley_is_that_of_the_tensors() {
        // M of cutter and surface as 3×3 tensors, along = cross-feed × normal, across = normal × along.
        let normal = Vector3::new(0.2, -0.3, 0.9).normalize();
        let (p, q) = (Vector3::new(1.0, 0.4, 0.1), Vector3::new(-0.3, 0.7, 0.2));
        let flat = Matrix3::identity() - normal * normal.transpose();
        let surface = flat * (p * p.transpose() * 3.0 - q * q.transpose() * 9.0) * flat;
        let mut held = held(25.0, 50.0);
        held.cross_feed = held.axis.cross(&Vector3::new(0.3, 1.0, 0.2)).normalize();
        let along = held.cross_feed.cross(&normal).normalize();
        let across = normal.cross(&along);
        let m = crate::orientation::cutter_curvature(INCH_AND_A_HALF, &held.axis, &normal).unwrap() - surface;
        let [cc, cd, dd] = [along.dot(&(m * along)), along.dot(&(m * across)), across.dot(&(m * across))];
        let found = valley(INCH_AND_A_HALF, &held, &normal, &surface).unwrap();
        assert!((found.curvature / ((cc * dd - cd * cd) / cc) - 1.0).abs() < 1e-12);
        assert!((found.shear - cd / cc).abs() < 1e-12);
        assert!((found.slope - across.dot(&held.cross_feed).abs()).abs() < 1e-12);
    }

    #[test]
    fn step_over_on_plane_and_cylinders() {
        // Across a cylinder of curvature κ_g the valley's curvature is 1/R_eff − κ_g; figures from the exact
        // circle-on-circle step at h = 0.0254 mm.
        for (kappa, step) in [(0.0, 5.625e-3), (-1.0 / 60e-3, 2.966e-3), (1.0 / 180e-3, 15.32e-3)] {
            let curvature = Vector3::y() * Vector3::y().transpose() * kappa;
            let found = valley(INCH_AND_A_HALF, &held(5.0, 0.0), &Vector3::z(), &curvature).unwrap();
            let distance = plane_distance(&found, 25.4e-6, 1.0);
            assert!((distance - step).abs() < 0.003 * step, "{kappa}: {distance}");
        }
    }

    #[test]
    fn the_budget_leaves_out_facet_and_chord_error() {
        let point = CloudPoint {
            position: Point3::origin(),
            normal: Vector3::z(),
            pseudo_curvature: 0.0,
            curvature: Matrix3::zeros(),
            facet_error: 7e-6,
            area: 1.0,
        };
        assert!((scallop_budget(&point, 25.4e-6, 1e-6) - 17.4e-6).abs() < 1e-12);
    }
}
