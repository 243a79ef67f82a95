//! What a program was proven on beside its text: the machine with its tool, and how machine and control move.

use super::program::sha256_hex;
use crate::timing::Dynamics;

/// Tool lengths that differ by no more are the same, m: a plan's `summary.json` says them in mm with six decimals.
const SAME_LENGTH: f64 = 1e-9;
/// Other numbers that differ by no more of the larger are the same: a decimal text's last digit.
const SAME_SHARE: f64 = 1e-12;

/// Machine, tool and dynamics of a program.
#[derive(Clone, Debug, PartialEq)]
pub struct Setup {
    /// sha256 of the machine's URDF text, hex digits.
    urdf_sha256: String,
    /// From the spindle nose to the tool tip, m.
    tool_length: f64,
    dynamics: Dynamics,
}

impl Setup {
    /// Of a URDF's text, a tool length (m) and dynamics.
    pub fn new(machine_urdf: &str, tool_length: f64, dynamics: Dynamics) -> Self {
        Self { urdf_sha256: sha256_hex(machine_urdf), tool_length, dynamics }
    }

    /// What is not the same in another one, in words; `None`: all is. The path tolerance is the program's own text.
    pub fn difference(&self, other: &Self) -> Option<&'static str> {
        let (a, b) = (&self.dynamics, &other.dynamics);
        let alike = |[x, y]: &[f64; 2]| {
            let off = (x - y).abs();
            off.is_finite() && off <= SAME_SHARE * x.abs().max(y.abs())
        };
        let same = |pairs: &[[f64; 2]]| pairs.iter().all(alike);
        let accelerations = [
            [a.accelerations.linear, b.accelerations.linear],
            [a.accelerations.rotary, b.accelerations.rotary],
        ];
        let (a, b) = (&a.control, &b.control);
        let limits =
            [[a.jerk_linear, b.jerk_linear], [a.jerk_rotary, b.jerk_rotary], [a.block_time, b.block_time]];
        let equal = [
            (self.urdf_sha256 == other.urdf_sha256, "machine (URDF)"),
            ((self.tool_length - other.tool_length).abs() <= SAME_LENGTH, "tool length"),
            (same(&accelerations), "acceleration"),
            (same(&limits), "jerk or block time"),
            (a.look_ahead == b.look_ahead, "look-ahead"),
        ];
        equal.into_iter().find(|(equal, _)| !equal).map(|(_, what)| what)
    }
}

#[cfg(test)]
mod tests {
    use super::super::program::tests::dynamics;
    use super::*;
    use patchmill_kinematics::{Accelerations, Control, LookAhead};

    #[test]
    fn every_part_of_it_counts() {
        let ours = Setup::new("<robot/>", 0.1, dynamics());
        let with = |change: &dyn Fn(&mut Dynamics)| {
            let mut dynamics = dynamics();
            change(&mut dynamics);
            Setup::new("<robot/>", 0.1, dynamics)
        };
        for (other, what) in [
            (Setup::new("<robot />", 0.1, dynamics()), "machine (URDF)"),
            (Setup::new("<robot/>", 0.100_001, dynamics()), "tool length"),
            (Setup::new("<robot/>", f64::NAN, dynamics()), "tool length"),
            (with(&|d| d.accelerations.linear += 0.1), "acceleration"),
            (with(&|d| d.accelerations.rotary = f64::INFINITY), "acceleration"),
            (with(&|d| d.control.jerk_linear += 1.0), "jerk or block time"),
            (with(&|d| d.control.jerk_rotary += 1.0), "jerk or block time"),
            (with(&|d| d.control.block_time += 1e-4), "jerk or block time"),
            (with(&|d| d.control.look_ahead = LookAhead::LinearAxes), "look-ahead"),
        ] {
            assert_eq!(ours.difference(&other), Some(what));
            assert_eq!(other.difference(&ours), Some(what));
        }
    }

    /// As `patchmill execute` reads it: lengths rounded to a millionth of a millimetre, the path tolerance left to the text.
    #[test]
    fn what_a_plans_folder_says_is_the_same() {
        let length = 0.123_456_789_4_f64;
        let said = (length * 1e9).round() / 1e6 / 1e3;
        assert_ne!(length, said);
        let Dynamics { accelerations: Accelerations { linear, rotary }, control } = dynamics();
        let read = Dynamics {
            accelerations: Accelerations { linear: linear * (1.0 + f64::EPSILON), rotary },
            control: Control { corner_tolerance: 0.0, ..control },
        };
        let (ours, theirs) = (Setup::new("", length, dynamics()), Setup::new("", said, read));
        assert_eq!(ours.difference(&theirs), None);
    }
}
