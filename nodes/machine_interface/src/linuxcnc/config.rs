//! The files of a headless LinuxCNC simulation of a machine: INI, HAL, tool table, parameters, and a script that starts it.
//!
//! * `trivkins` with the machine's letters; speeds from the URDF, accelerations as given.
//! * Travel: the joint limits widened by [`SLACK`], because a program's last digit may round a value at the end of a travel beyond it.
//!   Continuous joints have no limits.
//! * G54: what [`Machine::zero_offset`] says, less the tool length in Z, which the program takes in by `G43 H1` from the tool table.
//! * All joints are homed where they are at the start: at 0, or at the end of their travel that is nearest to it.

use super::joint_order;
use patchmill_kinematics::{AxisKind, KinematicsError, Machine};
use patchmill_products::job::Tool;

/// The limits are wider than the URDF's by this, mm and degrees.
pub const SLACK: f64 = 1e-3;
/// Port of `linuxcncrsh` when no other is asked for.
pub const DEFAULT_PORT: u16 = 5007;
/// Period of the servo thread, ns.
const SERVO_PERIOD: u32 = 1_000_000;

/// One file of a configuration.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ConfigFile {
    /// Its name in the folder.
    pub name: &'static str,
    /// Its text.
    pub text: String,
    /// Whether it is a script.
    pub executable: bool,
}

/// The files that run `machine` with `tool` as tool 1 in LinuxCNC, `linuxcncrsh` on `port`.
///
/// # Errors
/// As [`Machine::zero_offset`].
pub fn config_files(machine: &Machine, tool: &Tool, port: u16) -> Result<Vec<ConfigFile>, KinematicsError> {
    let joints: Vec<JointConfig> =
        joint_order(machine).iter().map(|&i| JointConfig::of(machine, i)).collect();
    let zero = machine.zero_offset()?;
    let file = |name, text| ConfigFile { name, text, executable: false };
    let length = tool.length * 1e3;
    let radius = tool.cutter.radius() * 1e3;
    Ok(vec![
        file("patchmill.ini", ini(machine.name(), &joints, port)),
        file("patchmill.hal", hal(joints.len())),
        file("patchmill.tbl", format!("T1 P1 D{:.6} Z{length:.6}\n", 2.0 * radius)),
        file("patchmill.var", parameters([zero[0] * 1e3, zero[1] * 1e3, zero[2] * 1e3 - length])),
        ConfigFile { name: "start.sh", text: START.replace("@PORT@", &port.to_string()), executable: true },
    ])
}

/// One joint in LinuxCNC's units: mm or degrees, seconds.
struct JointConfig {
    letter: char,
    kind: AxisKind,
    limits: Option<[f64; 2]>,
    velocity: f64,
    acceleration: f64,
    home: f64,
}

impl JointConfig {
    fn of(machine: &Machine, place: usize) -> Self {
        let axis = &machine.axes()[place];
        let scale = match axis.kind {
            AxisKind::Linear => 1e3,
            AxisKind::Rotary => 1f64.to_degrees(),
        };
        Self {
            letter: axis.letter,
            kind: axis.kind,
            limits: axis.limits.map(|[lower, upper]| [lower * scale - SLACK, upper * scale + SLACK]),
            velocity: axis.velocity * scale,
            acceleration: axis.acceleration * scale,
            home: axis.limits.map_or(0.0, |[lower, upper]| 0f64.clamp(lower, upper) * scale),
        }
    }

    /// The entries that an axis and its joint share.
    fn motion(&self) -> String {
        let limits = self.limits.map_or(String::new(), |[lower, upper]| {
            format!("MIN_LIMIT = {lower:.6}\nMAX_LIMIT = {upper:.6}\n")
        });
        format!("{limits}MAX_VELOCITY = {:.6}\nMAX_ACCELERATION = {:.6}\n", self.velocity, self.acceleration)
    }
}

fn ini(machine: &str, joints: &[JointConfig], port: u16) -> String {
    let letters: String = joints.iter().map(|j| j.letter).collect();
    // The path's own limits must not bind where the axes' do not: the fastest that all axes of a kind are together.
    let together = |kind: AxisKind, of: fn(&JointConfig) -> f64| {
        joints.iter().filter(|j| j.kind == kind).map(|j| of(j).powi(2)).sum::<f64>().sqrt()
    };
    let [speed, acceleration] = [|j: &JointConfig| j.velocity, |j: &JointConfig| j.acceleration];
    let mut text = format!(
        "# LinuxCNC simulation of a machine, made by patchmill from its URDF.\n\
         [EMC]\nVERSION = 1.1\nMACHINE = {name}\nDEBUG = 0\n\n\
         [DISPLAY]\nDISPLAY = linuxcncrsh --port {port}\n\n\
         [TASK]\nTASK = milltask\nCYCLE_TIME = 0.001\n\n\
         [RS274NGC]\nPARAMETER_FILE = patchmill.var\n\n\
         [EMCMOT]\nEMCMOT = motmod\nCOMM_TIMEOUT = 10.0\nSERVO_PERIOD = {SERVO_PERIOD}\n\n\
         [EMCIO]\nEMCIO = io\nCYCLE_TIME = 0.1\nTOOL_TABLE = patchmill.tbl\n\n\
         [HAL]\nHALFILE = patchmill.hal\n\n\
         [KINS]\nKINEMATICS = trivkins coordinates={letters}\nJOINTS = {count}\n\n\
         [TRAJ]\nCOORDINATES = {letters}\nLINEAR_UNITS = mm\nANGULAR_UNITS = degree\n\
         DEFAULT_LINEAR_VELOCITY = {v:.6}\nMAX_LINEAR_VELOCITY = {v:.6}\n\
         DEFAULT_LINEAR_ACCELERATION = {a:.6}\nMAX_LINEAR_ACCELERATION = {a:.6}\n\
         DEFAULT_ANGULAR_VELOCITY = {w:.6}\nMAX_ANGULAR_VELOCITY = {w:.6}\n\
         DEFAULT_ANGULAR_ACCELERATION = {b:.6}\nMAX_ANGULAR_ACCELERATION = {b:.6}\n",
        name = one_word(machine),
        count = joints.len(),
        v = together(AxisKind::Linear, speed),
        a = together(AxisKind::Linear, acceleration),
        w = together(AxisKind::Rotary, speed),
        b = together(AxisKind::Rotary, acceleration),
    );
    for (number, joint) in joints.iter().enumerate() {
        let kind = match joint.kind {
            AxisKind::Linear => "LINEAR",
            AxisKind::Rotary => "ANGULAR",
        };
        text += &format!(
            "\n[AXIS_{letter}]\n{motion}\n[JOINT_{number}]\nTYPE = {kind}\n{motion}FERROR = 50\nMIN_FERROR = 10\n\
             HOME = {home:.6}\nHOME_OFFSET = {home:.6}\nHOME_SEARCH_VEL = 0\nHOME_LATCH_VEL = 0\nHOME_SEQUENCE = 0\n",
            letter = joint.letter,
            motion = joint.motion(),
            home = joint.home,
        );
    }
    text
}

/// A name that an INI file takes as it is.
fn one_word(name: &str) -> String {
    name.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).collect()
}

fn hal(joints: usize) -> String {
    let mut text = "# Every axis is where it is told to be; emergency stop, tool change and spindle answer themselves.\n\
         loadrt [KINS]KINEMATICS\n\
         loadrt [EMCMOT]EMCMOT servo_period_nsec=[EMCMOT]SERVO_PERIOD num_joints=[KINS]JOINTS\n\
         addf motion-command-handler servo-thread\n\
         addf motion-controller servo-thread\n"
        .to_owned();
    for joint in 0..joints {
        text += &format!("net joint-{joint} joint.{joint}.motor-pos-cmd => joint.{joint}.motor-pos-fb\n");
    }
    text + "net estop iocontrol.0.user-enable-out => iocontrol.0.emc-enable-in\n\
            net tool-prepare iocontrol.0.tool-prepare => iocontrol.0.tool-prepared\n\
            net tool-change iocontrol.0.tool-change => iocontrol.0.tool-changed\n\
            setp spindle.0.at-speed 1\n"
}

/// LinuxCNC's parameter file: all that it needs to be there, G54 (X Y Z, mm) in force.
fn parameters(g54: [f64; 3]) -> String {
    // G28 and G30 positions, G92, and the nine work offsets of ten numbers, 5221 on.
    let homes = (5161..=5169).chain(5181..=5189).chain(5210..=5219);
    let offsets = (0..9).flat_map(|system| (5221..=5230).map(move |n| n + 20 * system));
    let mut values: Vec<(u32, f64)> = homes.chain(offsets).map(|n| (n, 0.0)).collect();
    values.push((5220, 1.0));
    values.sort_by_key(|(number, _)| *number);
    for (number, value) in &mut values {
        if let Some(place) = number.checked_sub(5221).filter(|place| *place < 3) {
            *value = g54[place as usize];
        }
    }
    values.iter().map(|(number, value)| format!("{number}\t{value:.6}\n")).collect()
}

/// LinuxCNC refuses root; what it leaves behind when killed would be in the next one's way.
const START: &str = r#"#!/usr/bin/env bash
# Starts LinuxCNC without a screen with the configuration beside this script; linuxcncrsh listens on port @PORT@. Ctrl-C ends it.
# LinuxCNC refuses root: started by root it runs as the user PATCHMILL_LINUXCNC_USER (nobody), and in namespaces of its own, so that
# no process of it outlives this one, not even after kill -9. It writes into a copy; the files here stay as they are.
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
command -v linuxcnc >/dev/null || { echo "start.sh: linuxcnc (Debian package linuxcnc-uspace) is missing" >&2; exit 1; }
run=$(mktemp -d "${TMPDIR:-/tmp}/patchmill-linuxcnc.XXXXXX")
trap 'rm -rf "$run"' EXIT
cp "$here"/patchmill.{ini,hal,tbl,var} "$run"
cd "$run"
# Without a terminal: an input that never ends, because it reads an ended one again and again.
if [ ! -t 0 ]; then mkfifo input && exec 0<>input; fi
if [ "$(id -u)" -ne 0 ]; then
  HOME=$run linuxcnc -r patchmill.ini
else
  user=${PATCHMILL_LINUXCNC_USER:-nobody}
  chmod 755 "$run" && chown -R "$user" "$run"
  # The first process of the namespace stays root's: a change of user would make the kernel forget that it ends with unshare.
  exec unshare --pid --ipc --mount --fork --kill-child --mount-proc sh -c \
    'setpriv --reuid "$0" --regid "$(id -g "$0")" --clear-groups env -u DISPLAY HOME="$1" linuxcnc -r patchmill.ini; code=$?; rm -rf "$1"; exit $code' \
    "$user" "$run"
fi
"#;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::DEFAULT_MACHINE_URDF;
    use patchmill_geometry::cutter::Cutter;
    use patchmill_kinematics::Accelerations;

    fn files(urdf: &str) -> Vec<ConfigFile> {
        let machine = Machine::from_urdf(urdf, 0.08, Accelerations { linear: 5.0, rotary: 20.0 }).unwrap();
        let tool = Tool::bare(Cutter { r1: 0.01305, r2: 0.006 }, 0.08);
        config_files(&machine, &tool, 5123).unwrap()
    }

    fn text(files: &[ConfigFile], name: &str) -> String {
        files.iter().find(|f| f.name == name).unwrap().text.clone()
    }

    /// Value of a key in a section.
    fn value(ini: &str, section: &str, key: &str) -> Option<String> {
        let body = ini.split(&format!("[{section}]\n")).nth(1)?.split("\n[").next()?.to_owned();
        body.lines().find_map(|l| l.strip_prefix(key)?.trim_start().strip_prefix("= ").map(str::to_owned))
    }

    #[test]
    fn the_shipped_machine_in_millimetres_and_degrees() {
        let files = files(DEFAULT_MACHINE_URDF);
        let ini = text(&files, "patchmill.ini");
        let of = |section, key| value(&ini, section, key);
        assert_eq!(of("KINS", "KINEMATICS").unwrap(), "trivkins coordinates=XYZAC");
        assert_eq!(of("DISPLAY", "DISPLAY").unwrap(), "linuxcncrsh --port 5123");
        assert_eq!(of("JOINT_0", "MIN_LIMIT").unwrap(), "-400.001000");
        assert_eq!(of("JOINT_2", "MAX_LIMIT").unwrap(), "0.001000");
        assert_eq!(of("AXIS_A", "MAX_LIMIT").unwrap(), "30.001000");
        assert_eq!(of("JOINT_4", "MIN_LIMIT"), None);
        assert_eq!(of("JOINT_4", "TYPE").unwrap(), "ANGULAR");
        assert_eq!(of("AXIS_X", "MAX_VELOCITY").unwrap(), "500.000000");
        assert_eq!(of("JOINT_3", "MAX_ACCELERATION").unwrap(), "1145.915590");
        assert_eq!(of("TRAJ", "MAX_LINEAR_VELOCITY").unwrap(), "866.025404");
        assert_eq!(text(&files, "patchmill.tbl"), "T1 P1 D38.100000 Z80.000000\n");
        // The tip is at the workpiece origin with the spindle 410 mm below its top; the tool length is taken in by G43.
        let offsets = text(&files, "patchmill.var");
        assert!(
            offsets.contains("5220\t1.000000\n5221\t-90.000000\n5222\t-45.000000\n5223\t-490.000000\n"),
            "{offsets}"
        );
        assert!(text(&files, "start.sh").contains("port 5123"));
    }

    #[test]
    fn joints_come_in_the_order_of_their_letters_and_home_within_their_travel() {
        // C carries A, and Z ends 50 mm below its zero.
        let urdf = DEFAULT_MACHINE_URDF
            .replace(r#"<joint name="a""#, r#"<joint name="q""#)
            .replace(r#"<joint name="c""#, r#"<joint name="a""#)
            .replace(r#"<joint name="q""#, r#"<joint name="c""#)
            .replace(r#"lower="-0.60" upper="0""#, r#"lower="-0.60" upper="-0.05""#);
        let machine = Machine::from_urdf(&urdf, 0.1, Accelerations { linear: 5.0, rotary: 20.0 }).unwrap();
        assert_eq!(joint_order(&machine), [0, 1, 2, 4, 3]);
        let ini = text(&files(&urdf), "patchmill.ini");
        assert_eq!(value(&ini, "KINS", "KINEMATICS").unwrap(), "trivkins coordinates=XYZAC");
        assert_eq!(value(&ini, "AXIS_A", "MAX_LIMIT"), None);
        assert_eq!(value(&ini, "AXIS_C", "MAX_LIMIT").unwrap(), "30.001000");
        assert_eq!(value(&ini, "JOINT_2", "HOME").unwrap(), "-50.000000");
        let joints = super::super::joints_of(&[1.0, 2.0, 3.0, 180.0, 90.0], &joint_order(&machine));
        assert_eq!(joints[..3], [0.001, 0.002, 0.003]);
        assert!((joints[3] - std::f64::consts::FRAC_PI_2).abs() < 1e-15);
    }
}
