//! LinuxCNC: the configuration of a simulated machine made from its description, and the client of its `linuxcncrsh`.
//!
//! Joint values are those of the URDF, in mm and degrees: machine coordinates of LinuxCNC are joint values, and the work offset
//! G54 puts the program's X0 Y0 Z0 where it belongs. Millimetres and degrees stay inside this module.

pub mod client;
pub mod config;
mod link;
mod program_file;
pub mod protocol;

use patchmill_kinematics::{Joints, Machine};

/// Place in [`Machine::axes`] of each of LinuxCNC's joints, which come in the order of their letters: X Y Z, then A before B before C.
pub fn joint_order(machine: &Machine) -> [usize; 5] {
    let letter = |i: usize| machine.axes().get(i).map_or('?', |axis| axis.letter);
    if letter(3) < letter(4) { [0, 1, 2, 3, 4] } else { [0, 1, 2, 4, 3] }
}

/// Joint values (m, rad, in the order of the machine's axes) of what LinuxCNC reports (mm, degrees, in the order of its joints).
pub fn joints_of(reported: &[f64; 5], order: &[usize; 5]) -> Joints {
    let mut joints = [0.0; 5];
    for (value, &place) in reported.iter().zip(order) {
        joints[place] = if place < 3 { value / 1e3 } else { value.to_radians() };
    }
    joints
}
