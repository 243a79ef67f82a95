//! Siemens SINUMERIK: `CYCLE800` axis by axis.
//!
//! Relied on: SINUMERIK 840D sl / 828D, Programming Manual Job Planning, "Programming cycles externally", CYCLE800
//! (parameters, coding of `_MODE`); Operating Manual Milling, "Swivel plane" (retraction, axis-by-axis rotation in
//! which each rotation starts from the one before, direction minus/plus).
//!
//! `CYCLE800(_FR, _TC, _ST, _MODE, _X0, _Y0, _Z0, _A, _B, _C, _X1, _Y1, _Z1, _DIR, _FR_I, _DMODE)` with
//!
//! * `_FR` 1: first retract machine axis Z to the position that the swivel data set holds;
//! * `_TC` "": the only swivel data set; machines with several need its name here;
//! * `_ST` 0: a new plane, in place of the one before; the tip is not followed;
//! * `_MODE` 57 = 2#00_11_10_01: axis by axis, about X, then Y, then Z;
//! * reference points 0: the plane turns about the work offset's origin;
//! * `_DIR` −1 or +1: the solution with the smaller or larger value of the axis that the data set names as direction
//!   reference, taken to be the tilting one; the other solution is taken where this one is out of travel;
//! * `_DMODE` 1: G17.
//!
//! `CYCLE800()` clears the plane and moves nothing. `G642` with `CTOL` rounds within the path tolerance, `RTLION` keeps
//! rapids straight.

use super::angles::{Convention, DECIMALS};
use super::planes::{Plane, PlaneProgram};
use super::text::fixed;
use super::{Control, Motion};
use crate::gcode::trimmed;

/// Writes Siemens programs.
#[derive(Default)]
pub(super) struct Writer {
    out: String,
    code: &'static str,
}

impl Writer {
    fn line(&mut self, line: &str) {
        self.out.push_str(line);
        self.out.push('\n');
    }
}

impl Control for Writer {
    const CONVENTION: Convention = Convention::AxisByAxis;
    const SIGNED: bool = false;

    fn begin(&mut self, program: &PlaneProgram) {
        for comment in &program.comments {
            self.comment(comment);
        }
        self.line("G17 G40 G54 G90 G94 G710");
        self.line("T1 M6");
        self.line("D1");
        self.line(&format!("S{:.0} M3", program.spindle));
        self.line(&format!("G642 CTOL={}", trimmed(program.path_tolerance * 1e3, 6)));
        self.line("RTLION");
        self.line("CYCLE800()");
    }

    fn comment(&mut self, text: &str) {
        self.line(&format!("; {text}"));
    }

    fn turn(&mut self, plane: &Plane, angles: [f64; 3]) {
        let [a, b, c] = angles.map(|angle| fixed(angle, DECIMALS, false));
        let direction = if plane.branch.larger { 1 } else { -1 };
        self.line(&format!("CYCLE800(1,\"\",0,57,0,0,0,{a},{b},{c},0,0,0,{direction},0,1)"));
        self.code = "";
    }

    fn motion(&mut self, motion: &Motion<'_>) {
        let code = if motion.rapid { "G0" } else { "G1" };
        let mut words: Vec<String> = Vec::with_capacity(5);
        if code != self.code {
            words.push(code.to_owned());
            self.code = code;
        }
        words.extend_from_slice(motion.words);
        words.extend(motion.feed.map(|f| format!("F{}", trimmed(f, 4))));
        self.line(&words.join(" "));
    }

    fn end(mut self) -> String {
        self.line("M5");
        self.line("CYCLE800()");
        self.line("M30");
        self.out
    }
}
