//! Tests of the writers on a hand-made program.

use super::planes::PlaneProgram;
use super::*;
use crate::DEFAULT_MACHINE_URDF;
use crate::gcode;
use patchmill_kinematics::{Accelerations, Machine};

/// Two planes: the table at A −90 and at A −90 C 90, then the tool upright with the table still turned.
const PROGRAM: &str = "(patchmill: made by hand, 100 % sure)
(coordinates: joint values)
G21 G90 G54 G17 G40 G94
T1 M6
G43 H1
S6000 M3
G64 P0.002
G0 Z400.0000
(patch 1 of 2)
G0 X10.0000 Y20.0000 Z300.0000 A-90.00000 C0.00000
Z250.0000
G1 Z240.0000 F2000
X11.0000
G0 Z300.0000
(patch 2 of 2)
G0 X10.0000 Y20.0000 Z300.0000 A-90.00000 C90.00000
G1 Z299.0000
G0 Z300.0000
G0 Z310.0000 A0.00000 C90.00000
M5
M30
";

fn proven(text: &str) -> ProvenText<'_> {
    ProvenText { text, sha256: "00ff", machine_urdf: DEFAULT_MACHINE_URDF, tool_length: 0.1 }
}

/// Tips of the program, mm, by the machine's own kinematics.
fn tips() -> Vec<[f64; 3]> {
    let accelerations = Accelerations { linear: 1.0, rotary: 1.0 };
    let machine = Machine::from_urdf(DEFAULT_MACHINE_URDF, 0.1, accelerations).unwrap();
    let blocks = gcode::read(PROGRAM, &machine, &machine.zero_offset().unwrap(), gcode::MOST_MOVES).unwrap();
    blocks.iter().map(|b| (machine.pose(&b.joints).tip.coords * 1e3).into()).collect()
}

/// The lines from the first plane's comment to the end of its first feed move, and what comes before.
fn lines(dialect: Dialect) -> Vec<String> {
    write(dialect, &proven(PROGRAM)).unwrap().lines().map(str::to_owned).collect()
}

fn after(lines: &[String], comment: &str, count: usize) -> Vec<String> {
    let at = lines.iter().position(|l| l.to_lowercase().contains(comment)).unwrap();
    lines[at + 1..=at + count].to_vec()
}

#[test]
fn siemens_text() {
    let lines = lines(Dialect::Siemens);
    let [x, y, z] = tips()[0];
    // The tool axis is -Y of the workpiece: turned by 90° about X the plane's Y is the workpiece's Z.
    assert_eq!(
        after(&lines, "plane 1 of 3: rotary axes a -90.00000 c 0.00000", 6),
        [
            "CYCLE800(1,\"\",0,57,0,0,0,90.00000,0.00000,0.00000,0,0,0,-1,0,1)".to_owned(),
            format!("G0 X{x:.4} Y{z:.4}"),
            format!("Z{:.4}", -y),
            format!("Z{:.4}", -y - 50.0),
            format!("G1 Z{:.4} F2000", -y - 60.0),
            format!("X{:.4}", x + 1.0),
        ]
    );
    assert_eq!(lines[0], "; patchmill: made by hand, 100 ? sure");
    assert_eq!(lines[1], "; written from program.ngc, sha256 00ff");
    assert_eq!(lines[lines.len() - 3..], ["M5", "CYCLE800()", "M30"]);
    assert!(lines.contains(&"S6000 M3".to_owned()) && lines.contains(&"G642 CTOL=0.002".to_owned()));
}

#[test]
fn heidenhain_text() {
    let lines = lines(Dialect::Heidenhain);
    assert!(lines.iter().enumerate().all(|(i, line)| line.starts_with(&format!("{i} "))));
    let plain: Vec<String> = lines.iter().map(|l| l.split_once(' ').unwrap().1.to_owned()).collect();
    assert_eq!(
        (plain[0].as_str(), plain[plain.len() - 1].as_str()),
        ("BEGIN PGM program MM", "END PGM program MM")
    );
    let [x, y, z] = tips()[0];
    let sign = |v: f64| format!("{v:+.4}");
    assert_eq!(
        after(&plain, "plane 1 of 3", 7),
        [
            "M140 MB MAX".to_owned(),
            "PLANE SPATIAL SPA+90.00000 SPB+0.00000 SPC+0.00000 TURN FMAX SEQ- TABLE ROT".to_owned(),
            format!("L X{} Y{} R0 FMAX", sign(x), sign(z)),
            format!("L Z{} R0 FMAX", sign(-y)),
            format!("L Z{} R0 FMAX", sign(-y - 50.0)),
            format!("L Z{} R0 F2000", sign(-y - 60.0)),
            format!("L X{}", sign(x + 1.0)),
        ]
    );
    // Upright tool, turned table: the table turns, no solution to choose.
    assert_eq!(
        after(&plain, "plane 3 of 3", 2)[1],
        "PLANE SPATIAL SPA+0.00000 SPB+0.00000 SPC-90.00000 TURN FMAX TABLE ROT"
    );
}

#[test]
fn fanuc_text() {
    let lines = lines(Dialect::Fanuc);
    assert_eq!(lines[..3], ["%", "O0001 (PATCHMILL)", "(PATCHMILL: MADE BY HAND, 100 ? SURE)"]);
    assert_eq!((lines[lines.len() - 2].as_str(), lines[lines.len() - 1].as_str()), ("M30", "%"));
    let [x, y, z] = tips()[0];
    assert_eq!(
        after(&lines, "plane 1 of 3", 9),
        [
            "G69".to_owned(),
            "G91 G28 Z0.".to_owned(),
            "G90 G49".to_owned(),
            "G68.2 X0. Y0. Z0. I0.00000 J90.00000 K0.00000".to_owned(),
            "G53.1 P2".to_owned(),
            format!("G0 X{x:.4} Y{z:.4}"),
            format!("G43 H1 Z{:.4}", -y),
            format!("Z{:.4}", -y - 50.0),
            format!("G1 Z{:.4} F2000.", -y - 60.0),
        ]
    );
    assert!(after(&lines, "plane 2 of 3", 4)[3].ends_with("I-90.00000 J90.00000 K0.00000"));
    // Comments and code only: no parenthesis inside another.
    assert!(lines.iter().all(|l| l.is_ascii() && l.matches('(').count() <= 1 && l.matches(')').count() <= 1));
}

#[test]
fn every_pose_and_feed_is_there() {
    let program = PlaneProgram::read(PROGRAM, DEFAULT_MACHINE_URDF, 0.1).unwrap();
    assert_eq!(program.planes.iter().map(|p| p.moves.len()).collect::<Vec<_>>(), [5, 3, 1]);
    let moves: Vec<_> = program.planes.iter().flat_map(|p| &p.moves).collect();
    assert_eq!(moves.iter().filter(|m| !m.rapid).count(), 3);
    assert!(moves.iter().filter(|m| !m.rapid).all(|m| (m.feed - 2.0 / 60.0).abs() < 1e-12));
    for (m, tip) in moves.iter().zip(tips()) {
        assert!((m.tip.coords * 1e3 - nalgebra::Vector3::from(tip)).norm() < 1e-9);
    }
    assert!(program.planes.iter().all(|p| p.square));
    let branches: Vec<_> = program.planes.iter().map(|p| p.branch.positive).collect();
    assert_eq!(branches, [Some(false), Some(false), None]);
    assert_eq!(program.spindle, 6000.0);
}

#[test]
fn what_cannot_be_written_is_refused() {
    let turning = PROGRAM.replace("G1 Z299.0000", "G1 Z299.0000 C91.00000");
    let cases = [
        (turning.as_str(), "line 17: the tool turns at feed"),
        ("G21 G90\nM30\n", "no spindle speed"),
        ("G21 G90\nS100 M3\nM30\n", "no moves"),
        ("G2 X1\n", "line 1: G2"),
    ];
    for (text, expected) in cases {
        for dialect in Dialect::ALL {
            let error = write(dialect, &proven(text)).unwrap_err();
            assert!(error.contains(expected), "{text}: {error}");
        }
    }
    let error =
        write(Dialect::Fanuc, &ProvenText { machine_urdf: "<robot/>", ..proven(PROGRAM) }).unwrap_err();
    assert!(error.contains("URDF"), "{error}");
}

#[test]
fn a_workpiece_frame_off_the_machines_axes_is_named() {
    let turned = DEFAULT_MACHINE_URDF.replace(
        "<origin xyz=\"-0.09 -0.06 0.07\" rpy=\"0 0 0\"/>",
        "<origin xyz=\"-0.09 -0.06 0.07\" rpy=\"0 0 1.5707963267948966\"/>",
    );
    assert_ne!(turned, DEFAULT_MACHINE_URDF);
    let straight = write(Dialect::Siemens, &proven(PROGRAM)).unwrap();
    let text = write(Dialect::Siemens, &ProvenText { machine_urdf: &turned, ..proven(PROGRAM) }).unwrap();
    let note =
        "machine X runs along 0.000000 -1.000000 0.000000, machine Y along 1.000000 0.000000 0.000000,";
    assert!(
        text.contains(note) && text.contains("has to carry") && !straight.contains("runs along"),
        "{text}"
    );
    let y = "<axis xyz=\"0 1 0\"/>";
    let left_handed = DEFAULT_MACHINE_URDF.replace(y, "<axis xyz=\"0 -1 0\"/>");
    let text = write(Dialect::Fanuc, &ProvenText { machine_urdf: &left_handed, ..proven(PROGRAM) }).unwrap();
    assert!(text.contains("SQUARE AND RIGHT-HANDED"), "{text}");
}
