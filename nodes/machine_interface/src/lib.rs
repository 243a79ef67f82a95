//! Candidates on the machine: every candidate's toolpath becomes a program, the program is timed and proven from
//! its own text, and the quickest feasible one is chosen. The only owner of kinematics and time.
//!
//! Units SI, `workpiece` frame unless a name says otherwise; millimetres and degrees only in program text and in
//! messages to people.

pub mod assembly_proof;
pub mod clearance;
pub mod convex_gap;
pub mod dialect;
pub mod evaluate;
pub mod execution;
pub mod gcode;
pub mod linuxcnc;
pub mod machine_collision;
pub mod motion;
pub mod node;
pub mod passed_proof;
pub mod patch_order;
pub mod placement;
pub mod proof;
pub mod rest_regions;
pub mod simultaneous;
pub mod surroundings;
pub mod timing;
pub mod transforms;
pub mod travel;

/// The machine that ships with patchmill: five axes, A tilting and C turning the table.
pub const DEFAULT_MACHINE_URDF: &str = include_str!("../urdf/xyzac.urdf");

/// All machines that ship with patchmill: name and URDF text. A table-table mill, a head-table mill, and one with a head that
/// nutates about an axis at 45°.
pub const MACHINES: [(&str, &str); 3] = [
    ("xyzac", DEFAULT_MACHINE_URDF),
    ("xyzbc", include_str!("../urdf/xyzbc.urdf")),
    ("xyzbc_nutating", include_str!("../urdf/xyzbc_nutating.urdf")),
];

/// Parameters of the stage.
#[derive(Clone, Debug)]
pub struct MachineParams {
    /// URDF text of the machine for jobs that bring none.
    pub default_urdf: String,
    /// Most moves of a program.
    pub max_moves: usize,
}

impl Default for MachineParams {
    fn default() -> Self {
        Self { default_urdf: DEFAULT_MACHINE_URDF.to_owned(), max_moves: 2_000_000 }
    }
}

#[cfg(test)]
mod plane_job;
