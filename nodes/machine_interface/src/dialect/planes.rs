//! A proven program as moves of the tool tip in tilted planes: one plane for every position of the rotary axes.

use super::text::fixed;
use crate::gcode::{self, ReadBlock, sanitised, words_of};
use nalgebra::{Matrix3, Point3, Rotation3, Vector3};
use patchmill_kinematics::{Accelerations, Joints, Machine};
use std::f64::consts::{PI, TAU};

/// Below this the tilting axis counts as standing at 0, rad.
const UPRIGHT: f64 = 1e-9;
/// Directions closer than this are the same, rad.
const SAME_DIRECTION: f64 = 1e-6;

/// One straight move of the tool tip.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Move {
    /// Rapid or at feed.
    pub rapid: bool,
    /// Tip at its end, m, `workpiece` frame.
    pub tip: Point3<f64>,
    /// Feed, m/s; 0 for rapids.
    pub feed: f64,
}

/// Which of the two rotary positions that give a tool axis the program was proven with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Branch {
    /// The tilting axis stands at a positive angle; `None` at 0, where the two fall together or lie apart by the table.
    pub positive: Option<bool>,
    /// Of the two solutions this is the one with the larger angle of the tilting axis.
    pub larger: bool,
}

/// Moves with one position of the rotary axes.
#[derive(Clone, Debug, PartialEq)]
pub struct Plane {
    /// The plane's axes in the workpiece frame: Z is the tool axis, X the machine's X as it stands then (carried along
    /// by a head).
    pub rotation: Rotation3<f64>,
    /// Proven positions of the rotary axes, rad.
    pub rotary: [f64; 2],
    /// Which solution that is.
    pub branch: Branch,
    /// Moving along the plane's Z is one linear axis's work, so that X and Y first and Z then does not leave its height.
    pub square: bool,
    /// The moves; the first one is reached from outside the plane.
    pub moves: Vec<Move>,
}

/// A program in tilted planes.
#[derive(Clone, Debug, PartialEq)]
pub struct PlaneProgram {
    /// What it says of itself, one statement a line.
    pub comments: Vec<String>,
    /// Spindle speed, rpm.
    pub spindle: f64,
    /// How far the control may leave a corner of the path, m.
    pub path_tolerance: f64,
    /// Letters of the rotary axes.
    pub letters: [char; 2],
    /// Its planes in cutting order.
    pub planes: Vec<Plane>,
}

impl PlaneProgram {
    /// Reads the text of a proven program on the machine `urdf` with a tool `tool_length` m long.
    ///
    /// # Errors
    /// One sentence for text or a machine that cannot be read, and for a program that turns the tool at feed.
    pub fn read(text: &str, urdf: &str, tool_length: f64) -> Result<Self, String> {
        // Accelerations decide nothing here.
        let accelerations = Accelerations { linear: 1.0, rotary: 1.0 };
        let machine = Machine::from_urdf(urdf, tool_length, accelerations).map_err(|e| e.to_string())?;
        let zero = machine.zero_offset().map_err(|e| e.to_string())?;
        let blocks = gcode::read(text, &machine, &zero, gcode::MOST_MOVES)?;
        let mut comments: Vec<String> = header_of(text).map(sanitised).collect();
        comments.extend(frame_note(&machine));
        Ok(Self {
            comments,
            spindle: spindle_of(text)?,
            letters: [3, 4].map(|i| machine.axes()[i].letter),
            planes: planes(&blocks, &machine)?,
            path_tolerance: gcode::path_tolerance(text).ok_or("the program has no path tolerance (G64 P)")?,
        })
    }
}

/// The comments before the first word of code, without those on joint coordinates.
fn header_of(text: &str) -> impl Iterator<Item = &str> {
    text.lines()
        .map_while(|line| line.strip_prefix('(')?.strip_suffix(')'))
        .filter(|comment| !comment.starts_with("coordinates:") && !comment.starts_with("start:"))
}

fn spindle_of(text: &str) -> Result<f64, String> {
    let mut words = text.lines().filter_map(|line| words_of(line).ok()).flatten();
    let speed = words.find(|(letter, _)| *letter == 'S').map(|(_, value)| value);
    speed.filter(|s| *s > 0.0).ok_or_else(|| "the program has no spindle speed (word S)".to_owned())
}

/// Groups the blocks by the position of the rotary axes.
fn planes(blocks: &[ReadBlock], machine: &Machine) -> Result<Vec<Plane>, String> {
    let mut planes: Vec<Plane> = Vec::new();
    for block in blocks {
        let rotary = [block.joints[3], block.joints[4]];
        if planes.last().is_none_or(|p| p.rotary != rotary) {
            if !block.rapid {
                return Err(format!(
                    "line {}: the tool turns at feed; only a program that turns in rapids can be written in tilted planes",
                    block.line
                ));
            }
            planes.push(plane_at(rotary, machine)?);
        }
        if let Some(plane) = planes.last_mut() {
            let tip = machine.pose(&block.joints).tip;
            plane.moves.push(Move { rapid: block.rapid, tip, feed: block.feed });
        }
    }
    if planes.is_empty() { Err("the program has no moves".to_owned()) } else { Ok(planes) }
}

fn plane_at(rotary: [f64; 2], machine: &Machine) -> Result<Plane, String> {
    let at = |linear: [f64; 3]| -> Joints { [linear[0], linear[1], linear[2], rotary[0], rotary[1]] };
    let here = machine.pose(&at([0.0; 3]));
    let z = here.axis.into_inner();
    let along = |i: usize| {
        let mut linear = [0.0; 3];
        linear[i] = 1.0;
        (machine.pose(&at(linear)).tip - here.tip).dot(&z)
    };
    let square = (0..3).any(|i| along(i).abs() > 1.0 - 1e-9);
    // The machine's axes at rotary zero, carried along by what turns the tool against the workpiece.
    let home = machine.workpiece_from_tool(&[0.0; 5]).rotation;
    let turned = machine.workpiece_from_tool(&at([0.0; 3])).rotation * home.inverse();
    let across = |v: Vector3<f64>| (turned * v) - z * (turned * v).dot(&z);
    let [machine_x, machine_y, _] = machine_axes(machine);
    let x = [across(machine_x), across(machine_y).cross(&z)].into_iter().find(|x| x.norm() > 1e-3);
    let x = x.ok_or("the machine's X and Y are both along the tool")?.normalize();
    let rotation = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[x, z.cross(&x), z]));
    Ok(Plane { rotation, rotary, branch: branch(rotary, machine), square, moves: Vec::new() })
}

/// Directions in which the tool moves against the workpiece for growing X, Y, Z, rotary axes at 0.
fn machine_axes(machine: &Machine) -> [Vector3<f64>; 3] {
    let origin = machine.pose(&[0.0; 5]).tip;
    std::array::from_fn(|i| {
        let mut q = [0.0; 5];
        q[i] = 1.0;
        machine.pose(&q).tip - origin
    })
}

fn branch(rotary: [f64; 2], machine: &Machine) -> Branch {
    let tilting = machine.tilting_axis() - 3;
    let tilt = rotary[tilting];
    let within_a_turn = tilt - (tilt / TAU).round() * TAU;
    let positive = (within_a_turn.abs() > UPRIGHT && within_a_turn.abs() < PI).then_some(within_a_turn > 0.0);
    let axis = machine.pose(&[0.0, 0.0, 0.0, rotary[0], rotary[1]]).axis;
    let solutions = machine.orientations(&axis, rotary).unwrap_or_default();
    let other = solutions.iter().map(|o| o.rotary[tilting]).find(|t| (t - tilt).abs() > SAME_DIRECTION);
    Branch { positive, larger: other.map_or(positive == Some(true), |o| tilt > o) }
}

/// For a workpiece frame that does not stand along the machine's axes: how the work offset has to be turned.
fn frame_note(machine: &Machine) -> Option<String> {
    let axes = Matrix3::from_columns(&machine_axes(machine));
    if (axes - Matrix3::identity()).norm() < SAME_DIRECTION {
        return None;
    }
    let text = |i: usize| axes.column(i).iter().map(|c| fixed(*c, 6, false)).collect::<Vec<_>>().join(" ");
    let right_handed =
        (axes.transpose() * axes - Matrix3::identity()).norm() < SAME_DIRECTION && axes.determinant() > 0.0;
    let what = if right_handed {
        "the work offset has to carry this rotation"
    } else {
        "no work offset makes up for that: X Y Z of a control are square and right-handed"
    };
    Some(format!(
        "the workpiece frame is turned against the machine: with all rotary axes at 0 machine X runs along {}, machine Y along {}, machine Z along {} of it; {what}",
        text(0),
        text(1),
        text(2)
    ))
}
