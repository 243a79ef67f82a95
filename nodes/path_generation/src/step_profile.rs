//! Where the planes of the passes go: neighbours no further apart than the scallop height allows anywhere between them.

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

#[cfg(test)]
mod tests {
    use super::*;

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
}
