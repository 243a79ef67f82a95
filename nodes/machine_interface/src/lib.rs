//! Candidates on the machine: every candidate's toolpath becomes a program, the program is timed and proven from
//! its own text, and the quickest feasible one is chosen. The only owner of kinematics and time.
//!
//! Units SI, `workpiece` frame unless a name says otherwise; millimetres and degrees only in program text and in
//! messages to people.

pub mod clearance;
pub mod evaluate;
pub mod execution;
pub mod gcode;
pub mod linuxcnc;
pub mod motion;
pub mod node;
pub mod proof;
pub mod timing;
pub mod transforms;

/// The machine that ships with patchmill: five axes, A tilting and C turning the table.
pub const DEFAULT_MACHINE_URDF: &str = include_str!("../urdf/xyzac.urdf");

#[cfg(test)]
mod plane_job;
