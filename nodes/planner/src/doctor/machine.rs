//! What the stack makes of a machine's description.

use std::path::Path;

use patchmill_kinematics::{Axis, AxisKind};
use patchmill_machine_interface::DEFAULT_MACHINE_URDF;
use patchmill_machine_interface::evaluate::machine_of;
use patchmill_products::job::Job;

use super::Finding;
use crate::machine_file::machine_text;

const CHECK: &str = "machine";
const MESHES: &str = "collision meshes";
const EXPECTED: &str = "expected links base_link, spindle and workpiece, three prismatic and two revolute or continuous joints named by their letters, each with limits and velocity (machine.urdf of any plan is an example)";

/// Reads a machine as a plan does.
pub fn machine(file: Option<&Path>) -> Vec<Finding> {
    let mut findings = Vec::new();
    let warn = |what| {
        let advice =
            "put the mesh beside the URDF as STL; without it the link is planned as if it were not there";
        findings.push(Finding::doubtful(MESHES, what, advice));
    };
    let text = machine_text(file, warn);
    let read = text.and_then(|machine_urdf| {
        let job = Job { machine_urdf, ..Job::default_for("") };
        machine_of(&job, DEFAULT_MACHINE_URDF).map_err(|e| match file {
            Some(file) => format!("machine file {}: {} (code {})", file.display(), e.text, e.code),
            None => e.text,
        })
    });
    let finding = match read {
        Ok((machine, _)) => {
            let axes: Vec<String> = machine.axes().iter().map(described).collect();
            Finding::good(CHECK, format!("{}: {}", machine.name(), axes.join(", ")))
        }
        Err(what) => Finding::bad(CHECK, what, EXPECTED),
    };
    findings.insert(0, finding);
    findings
}

/// An axis with its travel and speed.
fn described(axis: &Axis) -> String {
    let (scale, unit, speed) = match axis.kind {
        AxisKind::Linear => (1e3, " mm", format!("{:.1} m/min", axis.velocity * 60.0)),
        AxisKind::Rotary => (1f64.to_degrees(), "°", format!("{:.0}°/s", axis.velocity.to_degrees())),
    };
    match axis.limits {
        Some([low, high]) => {
            format!("{} {:.0}..{:.0}{unit} {speed}", axis.letter, low * scale, high * scale)
        }
        None => format!("{} without ends {speed}", axis.letter),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::terminal::Mood;

    #[test]
    fn shipped_machines_are_described_and_broken_ones_refused() {
        for name in [None, Some("xyzac"), Some("xyzbc"), Some("xyzbc_nutating")] {
            let [finding] = &machine(name.map(Path::new))[..] else { panic!("{name:?}") };
            assert!(finding.state == Mood::Good && finding.found.contains(" mm "), "{finding:?}");
        }
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("m.urdf");
        let one = |text: &str| {
            std::fs::write(&file, text).unwrap();
            machine(Some(&file)).remove(0)
        };
        for (text, words) in [
            ("<robot name=\"m\"><link name=\"base_link\"/></robot>", "m.urdf"),
            ("<robot", "m.urdf"),
            (&DEFAULT_MACHINE_URDF.replace("name=\"spindle\"", "name=\"head\""), "spindle"),
        ] {
            let finding = one(text);
            assert!(finding.state == Mood::Bad && finding.found.contains(words), "{finding:?}");
            assert!(finding.advice.contains("prismatic"), "{finding:?}");
        }
        let mesh = "<link name=\"fixture\"><collision><geometry><mesh filename=\"no.stl\"/></geometry></collision></link></robot>";
        let text = DEFAULT_MACHINE_URDF.replace("</robot>", mesh);
        std::fs::write(&file, text).unwrap();
        let findings = machine(Some(&file));
        assert!(findings.iter().any(|f| f.check == MESHES && f.state == Mood::Doubtful), "{findings:?}");
    }
}
