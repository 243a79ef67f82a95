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

    /// Step-over on a plane that leaves a scallop of `height` (m), fed along the lead (rad), m: √(8h·R_eff) with
    /// R_eff = R2 + R1/sin α.
    pub fn step_over_on_plane(&self, lead: f64, height: f64) -> f64 {
        let effective_radius = self.r2 + self.r1 / lead.sin().max(f64::MIN_POSITIVE);
        (8.0 * height * effective_radius).sqrt()
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn step_over_on_a_plane_is_that_of_the_effective_radius() {
        let bull = Cutter { r1: 0.01305, r2: 0.006 };
        // R_eff of 155.73 mm at 5°, of 32.1 mm at 30°.
        assert!((bull.step_over_on_plane(5f64.to_radians(), 25.4e-6) - 5.625e-3).abs() < 2e-6);
        assert!((bull.step_over_on_plane(30f64.to_radians(), 25.4e-6) - 2.554e-3).abs() < 1e-6);
        // A ball's is the same at any lead, none included.
        let ball = Cutter { r1: 0.0, r2: 0.005 };
        assert_eq!(ball.step_over_on_plane(0.0, 25.4e-6), ball.step_over_on_plane(0.5, 25.4e-6));
    }
}
