//! The proven program in tilted work planes, for controls that know their own kinematics: Siemens (CYCLE800), Heidenhain
//! (PLANE SPATIAL), Fanuc (G68.2).
//!
//! What is written comes from the proven text itself, read back as joint motion: the same poses of the tool, block by
//! block, the same rapids and feeds. Each position of the rotary axes becomes one tilted plane: the workpiece frame
//! turned about its origin so that the tool axis is +Z and X is the machine's X as it stands then. Coordinates are tip
//! positions in that plane, mm with 4 decimals, computed in the plane that the written angles (5 decimals) make, so that
//! their rounding does not move the tip.
//!
//! Between planes the program is at the proven clear height above the part. There the control first retracts to its own
//! end of travel, then turns, then comes down in the new plane: X and Y first and Z last where the plane's Z is one
//! machine axis (tables), else all at once, a straight rapid from above the plane's clear height. The joint program
//! turns on a way of its own, so these retracts are the only difference.
//!
//! A tool axis has two positions of the rotary axes; each writer says how its control is told which one was proven. Every
//! plane names the proven positions in a comment, counted as the URDF's joints count.

pub mod angles;
mod fanuc;
mod heidenhain;
pub mod planes;
mod siemens;
mod text;

use crate::gcode::trimmed;
use angles::{Convention, DECIMALS};
use planes::{Plane, PlaneProgram};
use text::{Coordinates, fixed};

/// A control's language.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Dialect {
    /// Siemens SINUMERIK 840D sl, 828D, ONE.
    Siemens,
    /// Heidenhain iTNC 530, TNC 6xx, TNC7, Klartext.
    Heidenhain,
    /// Fanuc Series 30i/31i/32i with tilted working plane indexing.
    Fanuc,
}

impl Dialect {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Siemens, Self::Heidenhain, Self::Fanuc];

    /// Its name on the command line and in `summary.json`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Siemens => "siemens",
            Self::Heidenhain => "heidenhain",
            Self::Fanuc => "fanuc",
        }
    }

    /// Name of its file beside `program.ngc`.
    pub fn file(self) -> &'static str {
        match self {
            Self::Siemens => "program.mpf",
            Self::Heidenhain => "program.h",
            Self::Fanuc => "program.nc",
        }
    }
}

/// A proven program and what it was proven with.
#[derive(Clone, Copy, Debug)]
pub struct ProvenText<'a> {
    /// Text of `program.ngc`.
    pub text: &'a str,
    /// Its sha256, named in the header.
    pub sha256: &'a str,
    /// The machine as URDF text.
    pub machine_urdf: &'a str,
    /// From the spindle nose to the tip, m.
    pub tool_length: f64,
}

/// Writes a proven program in a dialect.
///
/// # Errors
/// One sentence when the text or the machine cannot be read, or the program turns the tool at feed.
pub fn write(dialect: Dialect, proven: &ProvenText<'_>) -> Result<String, String> {
    let mut program = PlaneProgram::read(proven.text, proven.machine_urdf, proven.tool_length)?;
    program.comments.extend(notes(proven, program.path_tolerance));
    Ok(match dialect {
        Dialect::Siemens => written_by(siemens::Writer::default(), &program),
        Dialect::Heidenhain => written_by(heidenhain::Writer::default(), &program),
        Dialect::Fanuc => written_by(fanuc::Writer::default(), &program),
    })
}

fn notes(proven: &ProvenText<'_>, path_tolerance: f64) -> Vec<String> {
    vec![
        format!("written from program.ngc, sha256 {}", proven.sha256),
        "coordinates: tool tip in tilted planes of the workpiece frame; the work offset puts that frame where the part is, all rotary axes at 0".to_owned(),
        format!("path tolerance {} mm", trimmed(path_tolerance * 1e3, 6)),
        "rotary axes: each plane names the proven positions; stop where the control turns to others".to_owned(),
    ]
}

/// One straight move as words.
struct Motion<'a> {
    /// Rapid or at feed.
    rapid: bool,
    /// Coordinate words, at least one.
    words: &'a [String],
    /// Feed in mm/min, where it has to be said.
    feed: Option<f64>,
}

/// A control's language; each call adds lines to the program.
trait Control {
    /// How the control takes the angles of a plane.
    const CONVENTION: Convention;
    /// Every coordinate has a sign.
    const SIGNED: bool;

    /// Header, tool, spindle.
    fn begin(&mut self, program: &PlaneProgram);
    /// One comment.
    fn comment(&mut self, text: &str);
    /// Retracts and turns to a plane; `angles` in degrees.
    fn turn(&mut self, plane: &Plane, angles: [f64; 3]);
    /// One straight move.
    fn motion(&mut self, motion: &Motion<'_>);
    /// Leaves the plane and ends.
    fn end(self) -> String;
}

fn written_by<C: Control>(mut control: C, program: &PlaneProgram) -> String {
    control.begin(program);
    let mut at = Coordinates::new(C::SIGNED);
    for (number, plane) in program.planes.iter().enumerate() {
        let [first, second] = [0, 1].map(|i| {
            format!("{} {}", program.letters[i], fixed(plane.rotary[i].to_degrees(), DECIMALS, false))
        });
        control.comment(&format!(
            "plane {} of {}: rotary axes {first} {second}",
            number + 1,
            program.planes.len()
        ));
        let (angles, rotation) = C::CONVENTION.written(&plane.rotation);
        control.turn(plane, angles);
        at.forget();
        let mut feed = 0.0;
        for (place, m) in plane.moves.iter().enumerate() {
            let tip = rotation.inverse() * m.tip.coords * 1e3;
            if place == 0 && plane.square {
                control.motion(&Motion { rapid: true, words: &at.words(&tip, &[0, 1]), feed: None });
                control.motion(&Motion { rapid: true, words: &at.words(&tip, &[2]), feed: None });
                continue;
            }
            let said = (!m.rapid && m.feed != feed).then_some(m.feed * 60e3);
            if said.is_some() {
                feed = m.feed;
            }
            control.motion(&Motion { rapid: m.rapid, words: &at.words(&tip, &[0, 1, 2]), feed: said });
        }
    }
    control.end()
}

#[cfg(test)]
mod tests;
