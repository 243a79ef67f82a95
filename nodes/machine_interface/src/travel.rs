//! How much of the machine's travel a program uses.

use crate::gcode;
use patchmill_kinematics::{Accelerations, AxisKind, Machine, Mount, mount_of};

/// A program on its machine.
#[derive(Clone, Debug, PartialEq)]
pub struct MachineUse {
    /// Where the part stands in the link that carries it; `None` where no joint carries the part.
    pub mount: Option<Mount>,
    /// The axes in the order of [`Machine::axes`].
    pub axes: Vec<AxisTravel>,
    /// How often the tool leaves the part: rapids after a cut, those at the end of the program included.
    pub retracts: u32,
}

/// An axis and what a program needs of it.
#[derive(Clone, Debug, PartialEq)]
pub struct AxisTravel {
    /// Name of its joint in the URDF.
    pub joint: String,
    /// Linear (m) or rotary (rad).
    pub kind: AxisKind,
    /// Least and largest joint value of the program, m or rad.
    pub used: [f64; 2],
    /// Least and largest joint value of the machine, m or rad; `None` for a joint that turns without end.
    pub limits: Option<[f64; 2]>,
}

impl AxisTravel {
    /// Whether it moves along a line (m) rather than turns (rad).
    pub fn is_linear(&self) -> bool {
        self.kind == AxisKind::Linear
    }

    /// Distance of the program from the nearer end of the travel, m or rad; `None` without ends.
    pub fn margin(&self) -> Option<f64> {
        self.limits.map(|[low, high]| (self.used[0] - low).min(high - self.used[1]))
    }
}

/// Mount and travel of a written program on its machine. `tool_length` in m.
///
/// # Errors
/// One sentence when machine or program cannot be read or nothing moves.
pub fn travel(program: &str, machine_urdf: &str, tool_length: f64) -> Result<MachineUse, String> {
    let unit = Accelerations { linear: 1.0, rotary: 1.0 };
    let machine = Machine::from_urdf(machine_urdf, tool_length, unit).map_err(|e| e.to_string())?;
    let zero = machine.zero_offset().map_err(|e| e.to_string())?;
    let blocks = gcode::read(program, &machine, &zero, gcode::MOST_MOVES)?;
    if blocks.is_empty() {
        return Err("the program moves nothing".to_owned());
    }
    let axes = machine.axes().iter().enumerate().map(|(i, axis)| {
        let used = blocks.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], block| {
            [low.min(block.joints[i]), high.max(block.joints[i])]
        });
        AxisTravel { joint: axis.joint_name.clone(), kind: axis.kind, used, limits: axis.limits }
    });
    let leaves = |pair: &&[gcode::ReadBlock]| !pair[0].rapid && pair[1].rapid;
    let retracts = blocks.windows(2).filter(leaves).count() as u32;
    Ok(MachineUse { mount: mount_of(machine_urdf).ok(), axes: axes.collect(), retracts })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::DEFAULT_MACHINE_URDF;

    #[test]
    fn margins_are_to_the_nearer_end() {
        let program = "G21 G90\nG0 X0 Y0 Z100 A0 C0\nG1 X-20 A-10 F1000\nG0 Z101\nG0 Z102\n";
        let MachineUse { mount, axes, retracts } = travel(program, DEFAULT_MACHINE_URDF, 0.1).unwrap();
        assert_eq!(retracts, 1);
        assert_eq!(mount.unwrap().xyz, [-0.09, -0.06, 0.07]);
        assert_eq!(axes.iter().map(|a| a.joint.as_str()).collect::<Vec<_>>(), ["x", "y", "z", "a", "c"]);
        // The part's origin lies at -0.09 of the table: X0 is the joint at -90 mm, its travel is 400 mm each way.
        assert!((axes[0].used[0] + 0.11).abs() < 1e-9 && (axes[0].used[1] + 0.09).abs() < 1e-9);
        assert!((axes[0].margin().unwrap() - 0.29).abs() < 1e-9);
        assert!((axes[3].margin().unwrap() - 30f64.to_radians()).abs() < 1e-9);
        assert_eq!(axes[4].margin(), None);
        assert!(travel("G21 G90\n", DEFAULT_MACHINE_URDF, 0.1).unwrap_err().contains("nothing"));
    }
}
