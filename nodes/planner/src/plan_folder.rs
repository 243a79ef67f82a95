//! A folder that `patchmill plan` has written, read back: the program as it was proven, or an error.

use std::path::Path;

use patchmill_kinematics::{Accelerations, Control, LookAhead};
use patchmill_machine_interface::execution::sha256_hex;
use patchmill_machine_interface::timing::Dynamics;
use serde::{Deserialize, Serialize};

/// The plan in a folder. SI units.
#[derive(Clone, Debug, PartialEq)]
pub struct PlanFolder {
    /// Text of `program.ngc`.
    pub program: String,
    /// sha256 of the text, hex digits, equal to the summary's.
    pub program_sha256: String,
    /// Text of `machine.urdf`.
    pub machine_urdf: String,
    /// From the spindle nose to the tool tip, m.
    pub tool_length: f64,
    /// How machine and control move; the path tolerance is the program's own.
    pub dynamics: Dynamics,
}

/// What is needed of `summary.json`.
#[derive(Deserialize)]
struct Summary {
    program_sha256: String,
    tool: Tool,
    acceleration_linear_m_per_s2: f64,
    acceleration_rotary_rad_per_s2: f64,
    #[serde(default)]
    jerk_linear_m_per_s3: f64,
    #[serde(default)]
    jerk_rotary_rad_per_s3: f64,
    #[serde(default)]
    block_time_s: f64,
    #[serde(default)]
    look_ahead: LookAheadName,
}

/// A look-ahead in `summary.json`.
#[derive(Clone, Copy, Debug, Default, Deserialize, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum LookAheadName {
    /// Over all moves.
    #[default]
    AllAxes,
    /// Over moves of linear axes.
    LinearAxes,
}

#[derive(Deserialize)]
struct Tool {
    length_mm: f64,
}

impl PlanFolder {
    /// Reads a folder.
    ///
    /// # Errors
    /// When a file is missing or does not read, or the program is not the one that the summary speaks of.
    pub fn read(folder: &Path) -> Result<Self, String> {
        let text = |name: &str| {
            let path = folder.join(name);
            std::fs::read_to_string(&path).map_err(|e| {
                format!("{}: {e}; expected a folder that `patchmill plan` has written", path.display())
            })
        };
        let (program, machine_urdf, summary) =
            (text("program.ngc")?, text("machine.urdf")?, text("summary.json")?);
        let summary: Summary = serde_json::from_str(&summary)
            .map_err(|e| format!("{}: {e}", folder.join("summary.json").display()))?;
        let program_sha256 = sha256_hex(&program);
        if program_sha256 != summary.program_sha256 {
            return Err(format!(
                "{} is not the program that was proven: its sha256 is {program_sha256}, summary.json says {}",
                folder.join("program.ngc").display(),
                summary.program_sha256
            ));
        }
        Ok(Self {
            program,
            program_sha256,
            machine_urdf,
            tool_length: summary.tool.length_mm / 1e3,
            dynamics: Dynamics {
                accelerations: Accelerations {
                    linear: summary.acceleration_linear_m_per_s2,
                    rotary: summary.acceleration_rotary_rad_per_s2,
                },
                control: Control {
                    jerk_linear: summary.jerk_linear_m_per_s3,
                    jerk_rotary: summary.jerk_rotary_rad_per_s3,
                    block_time: summary.block_time_s,
                    look_ahead: match summary.look_ahead {
                        LookAheadName::AllAxes => LookAhead::AllAxes,
                        LookAheadName::LinearAxes => LookAhead::LinearAxes,
                    },
                    ..Control::default()
                },
            },
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    #[test]
    fn only_the_program_that_was_proven_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, text: &str| fs::write(folder.path().join(name), text).unwrap();
        assert!(PlanFolder::read(folder.path()).unwrap_err().contains("program.ngc"));
        let program = "G21 G90\nM30\n";
        write("program.ngc", program);
        write("machine.urdf", "<robot/>");
        write("summary.json", "{}");
        assert!(PlanFolder::read(folder.path()).unwrap_err().contains("program_sha256"));
        let summary = format!(
            r#"{{"program_sha256": "{}", "tool": {{"r1_mm": 1, "length_mm": 80}}, "acceleration_linear_m_per_s2": 5,
                "acceleration_rotary_rad_per_s2": 20}}"#,
            sha256_hex(program)
        );
        write("summary.json", &summary);
        assert_eq!(PlanFolder::read(folder.path()).unwrap().tool_length, 0.08);
        write("program.ngc", "G21 G90\nG0 Z0\nM30\n");
        assert!(PlanFolder::read(folder.path()).unwrap_err().contains("not the program that was proven"));
    }
}
