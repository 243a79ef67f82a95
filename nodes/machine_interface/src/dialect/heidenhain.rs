//! Heidenhain Klartext: `PLANE SPATIAL`.
//!
//! Relied on: TNC 640 / TNC 620, User's Manual Klartext Programming, "The PLANE function: Tilting the working plane",
//! there "Defining the working plane with the spatial angle" (rotations A, B, C in the workpiece's own system) and
//! "Specifying the positioning behavior" (TURN, SEQ, TABLE ROT); TNC7 manual, "Tilting solution"; "Retraction in the
//! tool-axis direction M140"; Cycle 32 TOLERANCE.
//!
//! * `M140 MB MAX` retracts along the tool axis to the end of the travel, in the plane before;
//! * `TURN FMAX` turns the rotary axes alone at rapid, the linear axes stand;
//! * `SEQ+`, `SEQ-` choose the solution with the tilting axis (the first one seen from the tool) at a positive or
//!   negative angle; left out where it stands at 0;
//! * `TABLE ROT` turns a table that the tool stands parallel to by the plane's angle, as the proven program has it,
//!   instead of turning the coordinates;
//! * `PLANE RESET STAY` leaves the plane and moves nothing.
//!
//! `FMAX` holds for its block only, `F` and `R0` stay.

use super::angles::{Convention, DECIMALS};
use super::planes::{Plane, PlaneProgram};
use super::text::fixed;
use super::{Control, Motion};
use crate::gcode::trimmed;

/// Writes Klartext programs, blocks numbered from 0.
#[derive(Default)]
pub(super) struct Writer {
    out: String,
    blocks: usize,
}

impl Writer {
    fn block(&mut self, text: &str) {
        self.out.push_str(&format!("{} {text}\n", self.blocks));
        self.blocks += 1;
    }
}

impl Control for Writer {
    const CONVENTION: Convention = Convention::Spatial;
    const SIGNED: bool = true;

    fn begin(&mut self, program: &PlaneProgram) {
        self.block("BEGIN PGM program MM");
        for comment in &program.comments {
            self.comment(comment);
        }
        self.block(&format!("TOOL CALL 1 Z S{:.0}", program.spindle));
        self.block("CYCL DEF 32.0 TOLERANCE");
        self.block(&format!("CYCL DEF 32.1 T{}", trimmed(program.path_tolerance * 1e3, 6)));
        self.block("PLANE RESET STAY");
        self.block("M3");
    }

    fn comment(&mut self, text: &str) {
        self.block(&format!("; {text}"));
    }

    fn turn(&mut self, plane: &Plane, angles: [f64; 3]) {
        let [a, b, c] = angles.map(|angle| fixed(angle, DECIMALS, true));
        let sequence = match plane.branch.positive {
            Some(true) => " SEQ+",
            Some(false) => " SEQ-",
            None => "",
        };
        self.block("M140 MB MAX");
        self.block(&format!("PLANE SPATIAL SPA{a} SPB{b} SPC{c} TURN FMAX{sequence} TABLE ROT"));
    }

    fn motion(&mut self, motion: &Motion<'_>) {
        let mut block = format!("L {}", motion.words.join(" "));
        if motion.rapid {
            block.push_str(" R0 FMAX");
        } else if let Some(feed) = motion.feed {
            block.push_str(&format!(" R0 F{}", trimmed(feed, 4)));
        }
        self.block(&block);
    }

    fn end(mut self) -> String {
        self.block("M5");
        self.block("PLANE RESET STAY");
        self.block("M30");
        self.block("END PGM program MM");
        self.out
    }
}
