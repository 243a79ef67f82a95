//! Step-over for a scallop height, and where the planes of the passes go.
//!
//! The gap between cutter and surface around a contact is, to second order, ½ pᵀ·M·p with the relative curvature
//! M = K_cutter − K_surface. While the contact moves along the unit tangent c the cutter sweeps a valley whose gap is
//! ½ k_D·q² at the distance q across c, k_D = det M / (cᵀ·M·c); on a plane that is 1/R_eff with
//! R_eff = R2 + (R1/sin α)·cos²ω. Two valleys a distance s apart meet at the height k_D·s²/8.

use nalgebra::{Matrix3, Vector3};

use crate::orientation::{Orientation, cutter_curvature};
use crate::surface_cloud::CloudPoint;
use patchmill_geometry::cutter::Cutter;
use patchmill_products::job::Job;

/// Share of the second-order step that is used: the true swept profile is an offset ellipse, whose step is up to 1.4 %
/// shorter at small leads, and the share of area above the height is half of the excess.
const STEP_SHARE: f64 = 0.98;

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

/// The valley that a pass in a plane perpendicular to `cross_feed` cuts at a point; `None` where the cutter's bottom
/// does not clear the surface to second order.
pub fn valley(
    cutter: Cutter,
    orientation: &Orientation,
    normal: &Vector3<f64>,
    surface_curvature: &Matrix3<f64>,
) -> Option<Valley> {
    let along = orientation.cross_feed.cross(normal).try_normalize(1e-9)?;
    let across = normal.cross(&along);
    let relative = cutter_curvature(cutter, &orientation.axis, normal)? - surface_curvature;
    let (cc, cd, dd) =
        (along.dot(&(relative * along)), along.dot(&(relative * across)), across.dot(&(relative * across)));
    let determinant = cc * dd - cd * cd;
    if cc <= 0.0 || determinant <= 0.0 {
        return None;
    }
    Some(Valley {
        curvature: determinant / cc,
        shear: cd / cc,
        slope: across.dot(&orientation.cross_feed).abs(),
    })
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
    match valley(cutter, orientation, &point.normal, &point.curvature) {
        Some(valley) => (plane_distance(&valley, height, cutter.radius()) * STEP_SHARE, valley.slope),
        // The bottom touches all around: the corner alone still cuts a valley of radius R2.
        None => ((8.0 * height * cutter.r2.max(1e-5)).sqrt() * STEP_SHARE, 1.0),
    }
}

/// Allowed plane distance over the cross-feed coordinate of a patch.
pub struct StepProfile {
    low: f64,
    bin: f64,
    /// Least allowed plane distance in each bin, m.
    allowed: Vec<f64>,
    /// Area of the patch in each bin, m².
    area: Vec<f64>,
}

/// Width of a bin of the profile, m.
const BIN: f64 = 0.25e-3;

impl StepProfile {
    /// From (cross-feed coordinate, allowed plane distance, area) of the patch's points; at least one point.
    pub fn new(points: impl Iterator<Item = (f64, f64, f64)> + Clone) -> Self {
        let (low, high) = points
            .clone()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), (y, ..)| (low.min(y), high.max(y)));
        // A part of metres gets wider bins, not unbounded memory.
        let bin = BIN.max((high - low) / 100_000.0);
        let bins = ((high - low) / bin) as usize + 1;
        let (mut allowed, mut area) = (vec![f64::INFINITY; bins], vec![0.0; bins]);
        for (y, step, share) in points {
            let b = (((y - low) / bin) as usize).min(bins - 1);
            allowed[b] = f64::min(allowed[b], step);
            area[b] += share;
        }
        Self { low, bin, allowed, area }
    }

    fn high(&self) -> f64 {
        self.low + self.bin * self.allowed.len() as f64
    }

    fn bin_of(&self, y: f64) -> usize {
        (((y - self.low) / self.bin) as usize).min(self.allowed.len() - 1)
    }

    /// Lowers the allowed distance between `from` and `to` to `distance` (m) at the most.
    pub fn limit(&mut self, from: f64, to: f64, distance: f64) {
        for b in self.bin_of(from)..=self.bin_of(to) {
            self.allowed[b] = self.allowed[b].min(distance);
        }
    }

    /// Least and largest cross-feed coordinate of the patch, m.
    pub fn range(&self) -> (f64, f64) {
        (self.low, self.high())
    }

    /// Furthest y ≤ `start` + `share`·allowed(start..y).
    fn advance(&self, start: f64, share: f64) -> f64 {
        let mut allowed = f64::INFINITY;
        for b in self.bin_of(start)..self.allowed.len() {
            let begin = self.low + b as f64 * self.bin;
            let tighter = allowed.min(self.allowed[b]);
            // Entering the tighter bin is only allowed as far as its own distance reaches.
            if start + share * tighter < begin {
                return begin.min(start + share * allowed);
            }
            allowed = tighter;
            if start + share * allowed <= begin + self.bin {
                return start + share * allowed;
            }
        }
        start + share * allowed
    }

    /// Places of the pass planes: neighbours no further apart than allowed, the first and last within half a step of
    /// the patch's border.
    pub fn planes(&self) -> Vec<f64> {
        let high = self.high();
        let mut planes = vec![self.advance(self.low, 0.5)];
        if planes[0] >= high {
            return vec![(self.low + high) / 2.0];
        }
        loop {
            let last = planes[planes.len() - 1];
            let reach = self.advance(last, 0.5);
            if reach >= high {
                return self.evened(planes, reach);
            }
            // A step is at least a micrometre: a vanishing allowance must not loop for ever.
            planes.push(self.advance(last, 1.0).max(last + 1e-6));
        }
    }

    /// The last pass reaches beyond the border: draw all passes together by that much where every step stays allowed.
    fn evened(&self, planes: Vec<f64>, reach: f64) -> Vec<f64> {
        let share = (self.high() - self.low) / (reach - self.low);
        let drawn: Vec<f64> = planes.iter().map(|y| self.low + (y - self.low) * share).collect();
        let allowed = drawn.windows(2).all(|w| w[1] <= self.advance(w[0], 1.0) + 1e-9);
        let last = drawn[drawn.len() - 1];
        if allowed
            && drawn[0] <= self.advance(self.low, 0.5) + 1e-9
            && self.advance(last, 0.5) >= self.high() - 1e-9
        {
            drawn
        } else {
            // The last plane may still lie beyond the patch: bring it back over it.
            let last = self.high().min(planes[planes.len() - 1]);
            planes[..planes.len() - 1].iter().copied().chain([last]).collect()
        }
    }

    /// Length of the passes over the patch, m, and their number: an estimate without cutting them.
    pub fn estimate(&self) -> (f64, usize) {
        let planes = self.planes();
        let (mut length, mut pass) = (0.0, 0);
        for (b, area) in self.area.iter().enumerate() {
            let y = self.low + (b as f64 + 0.5) * self.bin;
            while pass + 1 < planes.len() && (planes[pass] + planes[pass + 1]) / 2.0 < y {
                pass += 1;
            }
            let below = if pass > 0 { (planes[pass - 1] + planes[pass]) / 2.0 } else { self.low };
            let above =
                if pass + 1 < planes.len() { (planes[pass] + planes[pass + 1]) / 2.0 } else { self.high() };
            length += area / (above - below).max(self.bin);
        }
        (length, planes.len())
    }
}

/// Scallop height left to the spacing at a point, m: facet and chord error are taken out of the job's height first, and
/// a tenth of it is always kept (where even that is missing the swept check decides).
pub fn scallop_budget(point: &CloudPoint, scallop_height: f64, pass_chord: f64) -> f64 {
    (scallop_height - point.facet_error - pass_chord).max(0.1 * scallop_height)
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
    fn planes_keep_the_allowed_distance_and_reach_both_borders() {
        let allowed = |y: f64| 2e-3 + 1e-3 * (y * 150.0).sin();
        let points = (0..=4000).map(|i| i as f64 * 1e-5).map(|y| (y, allowed(y), 1e-6));
        let profile = StepProfile::new(points.clone());
        let planes = profile.planes();
        for w in planes.windows(2) {
            let least = points
                .clone()
                .filter(|p| (w[0]..=w[1]).contains(&p.0))
                .map(|p| p.1)
                .fold(f64::INFINITY, f64::min);
            assert!(w[1] > w[0] && w[1] - w[0] <= least + 2.0 * BIN, "{w:?} {least}");
        }
        assert!(planes[0] <= 0.5 * 3e-3 && planes[planes.len() - 1] >= 0.04 - 0.5 * 3e-3);
        let (length, passes) = profile.estimate();
        assert_eq!(passes, planes.len());
        assert!((length - 4.001e-3 / 2e-3).abs() < 0.6, "{length}");
    }

    #[test]
    fn a_narrow_patch_gets_one_pass_in_its_middle() {
        let points = (0..10).map(|i| (i as f64 * 1e-4, 5e-3, 1e-6));
        let planes = StepProfile::new(points).planes();
        assert_eq!(planes.len(), 1);
        assert!((planes[0] - 0.5e-3).abs() < 1.3e-4);
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
