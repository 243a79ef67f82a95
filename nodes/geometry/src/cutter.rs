//! The cutter: a torus of major radius R1 and corner radius R2 with its flat bottom.

/// Cutting end of a tool. R1 = 0 is a ball-end, R2 = 0 a flat-end, both positive a toroidal (bull-nose) mill.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cutter {
    /// Distance from the tool axis to the centre of the corner torus, m.
    pub r1: f64,
    /// Corner radius, m.
    pub r2: f64,
}

impl Cutter {
    /// Outer radius R1 + R2, m.
    pub fn radius(&self) -> f64 {
        self.r1 + self.r2
    }

    /// Height of the cutter's surface above its tip at distance `rho` (m) from the axis; `None` outside the tool.
    pub fn lift(&self, rho: f64) -> Option<f64> {
        if rho > self.radius() {
            return None;
        }
        let w = rho - self.r1;
        // Written as w²/(R2 + √(R2² − w²)) so that small heights keep their digits.
        if w <= 0.0 {
            Some(0.0)
        } else {
            Some(w * w / (self.r2 + (self.r2 * self.r2 - w * w).max(0.0).sqrt()))
        }
    }
}
