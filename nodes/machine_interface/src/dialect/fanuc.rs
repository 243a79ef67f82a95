//! Fanuc: tilted working plane indexing, `G68.2` with Euler angles.
//!
//! Relied on: FANUC Series 30i/31i/32i-MODEL B, User's Manual (Machining Center System) B-64484EN-2, "Tilted working
//! plane indexing" (G68.2: feature coordinate system by Euler angles, about Z, then the turned X, then the turned Z) and
//! "Tool axis direction control" (G53.1).
//!
//! * `G69` leaves the plane, `G91 G28 Z0` retracts machine axis Z to its reference point, `G49` drops the tool length
//!   offset, which must not be active when a plane is defined;
//! * `G68.2 X0 Y0 Z0 I_ J_ K_` defines the plane, its origin at the work offset's;
//! * `G53.1` turns the rotary axes so that the tool axis is the plane's Z; `P1`, `P2` choose the solution with the tilting
//!   axis at a positive or negative angle, without P (where it stands at 0) the control chooses;
//! * `G43 H1` takes the tool length with the first move along Z.
//!
//! Angles need 5 decimals and coordinates 4 (increment system IS-D, or IS-C with what it rounds). Comments are in
//! capitals, as control screens have them. The path tolerance is a parameter of the control's contour control, which
//! programs of different machines switch on differently: the header names it.

use super::angles::{Convention, DECIMALS};
use super::planes::{Plane, PlaneProgram};
use super::text::fixed;
use super::{Control, Motion};
use crate::gcode::trimmed;

/// Writes Fanuc programs.
#[derive(Default)]
pub(super) struct Writer {
    out: String,
    code: &'static str,
    /// The tool length offset is still to be switched on in this plane.
    length_due: bool,
}

impl Writer {
    fn line(&mut self, line: &str) {
        self.out.push_str(line);
        self.out.push('\n');
    }
}

impl Control for Writer {
    const CONVENTION: Convention = Convention::Euler;
    const SIGNED: bool = false;

    fn begin(&mut self, program: &PlaneProgram) {
        self.line("%");
        self.line("O0001 (PATCHMILL)");
        for comment in &program.comments {
            self.comment(comment);
        }
        self.line("G17 G21 G40 G49 G54 G69 G80 G90 G94");
        self.line("T1 M6");
        self.line(&format!("S{:.0} M3", program.spindle));
    }

    fn comment(&mut self, text: &str) {
        let plain: String = text
            .chars()
            .map(|c| match c.to_ascii_uppercase() {
                '(' => '[',
                ')' => ']',
                ';' => ',',
                '%' => '?',
                c => c,
            })
            .collect();
        self.line(&format!("({plain})"));
    }

    fn turn(&mut self, plane: &Plane, angles: [f64; 3]) {
        let [i, j, k] = angles.map(|angle| fixed(angle, DECIMALS, false));
        self.line("G69");
        self.line("G91 G28 Z0.");
        self.line("G90 G49");
        self.line(&format!("G68.2 X0. Y0. Z0. I{i} J{j} K{k}"));
        self.line(match plane.branch.positive {
            Some(true) => "G53.1 P1",
            Some(false) => "G53.1 P2",
            None => "G53.1",
        });
        self.code = "";
        self.length_due = true;
    }

    fn motion(&mut self, motion: &Motion<'_>) {
        let code = if motion.rapid { "G0" } else { "G1" };
        let mut words: Vec<String> = Vec::with_capacity(7);
        if code != self.code {
            words.push(code.to_owned());
            self.code = code;
        }
        if self.length_due && motion.words.iter().any(|w| w.starts_with('Z')) {
            words.extend(["G43".to_owned(), "H1".to_owned()]);
            self.length_due = false;
        }
        words.extend_from_slice(motion.words);
        // With its point a feed means the same under every setting of the control.
        words.extend(motion.feed.map(|f| {
            let text = trimmed(f, 4);
            if text.contains('.') { format!("F{text}") } else { format!("F{text}.") }
        }));
        self.line(&words.join(" "));
    }

    fn end(mut self) -> String {
        self.line("M5");
        self.line("G69");
        self.line("G49");
        self.line("M30");
        self.line("%");
        self.out
    }
}
