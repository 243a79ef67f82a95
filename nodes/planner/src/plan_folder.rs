//! A folder that `patchmill plan` has written, read back: the program as it was proven, or an error.
//!
//! Folders come from others: files are regular ones of bounded size.

use std::path::Path;

use patchmill_kinematics::{Accelerations, Control, LookAhead};
use patchmill_machine_interface::execution::sha256_hex;
use patchmill_machine_interface::timing::Dynamics;
use patchmill_node_runtime::regular_file;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

const SUMMARY: &str = "summary.json";
const PROGRAM: &str = "program.ngc";
const MACHINE: &str = "machine.urdf";

/// Largest `summary.json`, bytes: that of a plan of many patches and rest regions has some 100 kB.
const SUMMARY_BYTES_MAX: u64 = 16 << 20;
/// Largest `program.ngc`, bytes: one of ten million moves.
const PROGRAM_BYTES_MAX: u64 = 512 << 20;
/// Largest `machine.urdf`, bytes: a job's, with its part's mount and its tool.
const MACHINE_BYTES_MAX: u64 = 1 << 20;

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
    machine_urdf_sha256: Option<String>,
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
    /// When a file is missing or does not read, or program or machine are not those that the summary speaks of.
    pub fn read(folder: &Path) -> Result<Self, String> {
        let summary: Summary = summary(folder)?;
        let (program, machine_urdf) =
            (text(folder, PROGRAM, PROGRAM_BYTES_MAX)?, text(folder, MACHINE, MACHINE_BYTES_MAX)?);
        let program_sha256 = sha256_hex(&program);
        if program_sha256 != summary.program_sha256 {
            return Err(other(folder, PROGRAM, "program", &program_sha256, &summary.program_sha256));
        }
        let proven = summary.machine_urdf_sha256.ok_or_else(|| {
            format!(
                "{}: it has no machine_urdf_sha256, that is, an older patchmill wrote it, and nothing tells whether {MACHINE} is the \
                 machine of the proof; plan anew",
                folder.join(SUMMARY).display()
            )
        })?;
        let found = sha256_hex(&machine_urdf);
        if found != proven {
            return Err(other(folder, MACHINE, "machine", &found, &proven));
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

/// What a command needs of a plan's `summary.json`.
///
/// # Errors
/// When the file is missing, not a regular one, too large or lacks something.
pub fn summary<T: DeserializeOwned>(folder: &Path) -> Result<T, String> {
    let text = text(folder, SUMMARY, SUMMARY_BYTES_MAX)?;
    serde_json::from_str(&text).map_err(|e| format!("{}: {e}", folder.join(SUMMARY).display()))
}

fn text(folder: &Path, name: &str, most: u64) -> Result<String, String> {
    let path = folder.join(name);
    regular_file::read_text(&path, most)
        .map_err(|e| format!("{}: {e}; expected a folder that `patchmill plan` has written", path.display()))
}

fn other(folder: &Path, name: &str, what: &str, found: &str, proven: &str) -> String {
    let path = folder.join(name);
    format!(
        "{} is not the {what} that was proven: its sha256 is {found}, {SUMMARY} says {proven}",
        path.display()
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;
    use std::os::unix::fs::symlink;

    #[test]
    fn only_the_program_that_was_proven_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, text: &str| fs::write(folder.path().join(name), text).unwrap();
        let refused = |file: &str| {
            let error = PlanFolder::read(folder.path()).unwrap_err();
            assert!(error.contains(file) && !error.contains('\n'), "{error}");
            error
        };
        refused("summary.json");
        let program = "G21 G90\nM30\n";
        write("program.ngc", program);
        let machine = "<robot/>";
        write("machine.urdf", machine);
        write("summary.json", "{}");
        assert!(refused("").contains("program_sha256"));
        let summary = format!(
            r#"{{"program_sha256": "{}", "machine_urdf_sha256": "{}", "tool": {{"r1_mm": 1, "length_mm": 80}},
                "acceleration_linear_m_per_s2": 5, "acceleration_rotary_rad_per_s2": 20}}"#,
            sha256_hex(program),
            sha256_hex(machine)
        );
        write("summary.json", &summary);
        assert_eq!(PlanFolder::read(folder.path()).unwrap().tool_length, 0.08);
        write("machine.urdf", "<robot name=\"other\"/>");
        assert!(refused("machine.urdf").contains("not the machine that was proven"));
        write("machine.urdf", machine);
        write("summary.json", &summary.replace("machine_urdf_sha256", "other_key"));
        assert!(refused("summary.json").contains("plan anew"));
        write("summary.json", &summary);
        write("program.ngc", "G21 G90\nG0 Z0\nM30\n");
        assert!(refused("program.ngc").contains("not the program that was proven"));
    }

    #[test]
    fn neither_fifos_nor_devices_are_waited_for() {
        let folder = tempfile::tempdir().unwrap();
        let place = |name: &str| folder.path().join(name);
        symlink("/dev/zero", place("summary.json")).unwrap();
        let error = PlanFolder::read(folder.path()).unwrap_err();
        assert!(error.contains("summary.json: it is not a regular file"), "{error}");
        fs::remove_file(place("summary.json")).unwrap();
        fs::File::create(place("summary.json")).unwrap().set_len(SUMMARY_BYTES_MAX + 1).unwrap();
        let error = PlanFolder::read(folder.path()).unwrap_err();
        assert!(error.contains("summary.json: it is larger than 16 MiB"), "{error}");
        fs::remove_file(place("summary.json")).unwrap();
        assert!(std::process::Command::new("mkfifo").arg(place("summary.json")).status().unwrap().success());
        let error = PlanFolder::read(folder.path()).unwrap_err();
        assert!(error.contains("summary.json: it is not a regular file"), "{error}");
    }
}
