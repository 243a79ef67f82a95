//! The pass planes of a patch, and how the swept check's findings move them.

use crate::step_over::StepProfile;

/// Passes reach beyond the points that they have to cut by this at least, m.
const OVERLAP: f64 = 0.4e-3;
/// What the overlap grows by where a pass ends too early, m.
const LONGER: f64 = 0.75e-3;
/// Leftovers above this many heights are no ridge between passes but a place that none of them reached.
const UNREACHED: f64 = 4.0;

/// Pass planes with the allowance that they come from.
pub struct Strips {
    profile: StepProfile,
    planes: Vec<f64>,
    overlap: f64,
}

impl Strips {
    /// Planes as far apart as the profile allows.
    pub fn new(profile: StepProfile) -> Self {
        Self { planes: profile.planes(), profile, overlap: OVERLAP }
    }

    /// Cross-feed coordinates of the planes, m.
    pub fn planes(&self) -> &[f64] {
        &self.planes
    }

    /// How far passes reach beyond the points that they have to cut, m.
    pub fn overlap(&self) -> f64 {
        self.overlap
    }

    /// Least and largest distance between neighbouring planes, m; 0 for a single plane.
    pub fn step_over(&self) -> [f64; 2] {
        let steps = || self.planes.windows(2).map(|w| w[1] - w[0]);
        if self.planes.len() < 2 {
            return [0.0; 2];
        }
        [steps().fold(f64::INFINITY, f64::min), steps().fold(0.0, f64::max)]
    }

    /// Takes the swept check's findings, (cross-feed coordinate, leftover) in m, all above `height` (m): strips with too much
    /// left get a smaller step, passes that end too early a longer overlap.
    pub fn tighten(&mut self, left: impl Iterator<Item = (f64, f64)>, height: f64) {
        let mut worst = vec![0.0f64; self.planes.len() + 1];
        let mut unreached = false;
        for (y, leftover) in left {
            if leftover > UNREACHED * height {
                unreached = true;
                continue;
            }
            let above = self.planes.partition_point(|plane| *plane < y);
            worst[above] = worst[above].max(leftover);
        }
        if unreached {
            self.overlap += LONGER;
        }
        let (low, high) = self.profile.range();
        for (above, leftover) in worst.iter().enumerate().filter(|(_, leftover)| **leftover > 0.0) {
            let factor = (height / leftover).sqrt() * 0.99;
            let (from, to, gap) = match (above.checked_sub(1), self.planes.get(above)) {
                (Some(below), Some(next)) => (self.planes[below], *next, next - self.planes[below]),
                (None, Some(next)) => (low, *next, 2.0 * (next - low)),
                (Some(below), None) => (self.planes[below], high, 2.0 * (high - self.planes[below])),
                (None, None) => continue,
            };
            self.profile.limit(from, to, gap * factor);
        }
        self.planes = self.profile.planes();
    }
}
