//! A program that can be run: its text checked against its hash, read and timed on its machine; and how far a position is from its path.

use super::BAD_PROGRAM;
use super::setup::Setup;
use crate::evaluate::BAD_MACHINE;
use crate::gcode::{self, ReadBlock};
use crate::timing::{Dynamics, ProgramTiming, time_program};
use patchmill_kinematics::{Control, Joints, Machine};
use patchmill_products::stage::StageError;
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::fmt::Write;

/// Longest text of a program and of a URDF that is taken, bytes.
const LONGEST_TEXT: usize = 64 << 20;
/// Most parts of a program.
const MOST_PARTS: u32 = 8192;
/// A program's last digit may round a value at the end of a travel beyond it: m and rad.
const TRAVEL_SLACK: f64 = 1e-6;
/// Blocks before and after the reported one in which a position is looked for: LinuxCNC names lines up to 58 blocks ahead of the axes.
const BEHIND: usize = 200;
const AHEAD: usize = 2;

/// sha256 of a text, as hex digits.
pub fn sha256_hex(text: &str) -> String {
    Sha256::digest(text.as_bytes()).iter().fold(String::with_capacity(64), |mut hex, byte| {
        // Writing to a string cannot fail.
        let _ = write!(hex, "{byte:02x}");
        hex
    })
}

/// A program on its machine.
#[derive(Clone, Debug)]
pub struct ExecutableProgram {
    /// Its text.
    pub text: String,
    /// sha256 of the text, hex digits.
    pub sha256: String,
    /// The machine, tool mounted.
    pub machine: Machine,
    /// The machine's URDF.
    pub machine_urdf: String,
    /// Machine, tool and dynamics as they were given.
    pub setup: Setup,
    /// Its motions, from the first position in which every axis is given.
    pub blocks: Vec<ReadBlock>,
    /// Their times, from that position on.
    pub timing: ProgramTiming,
}

/// How far from the program's path a position is.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Deviation {
    /// Largest of the linear axes, m.
    pub linear: f64,
    /// Largest of the rotary axes, rad.
    pub rotary: f64,
}

impl Deviation {
    /// The smaller of both in each kind.
    pub fn min(self, other: Self) -> Self {
        Self { linear: self.linear.min(other.linear), rotary: self.rotary.min(other.rotary) }
    }

    /// The larger of both in each kind.
    pub fn max(self, other: Self) -> Self {
        Self { linear: self.linear.max(other.linear), rotary: self.rotary.max(other.rotary) }
    }
}

impl ExecutableProgram {
    /// Reads and times a program of at most `max_moves` moves. Its own path tolerance counts, where it says one.
    ///
    /// # Errors
    /// [`BAD_MACHINE`], or [`BAD_PROGRAM`] when the text does not read, moves nothing or leaves the machine's travel.
    pub fn new(
        text: String,
        machine_urdf: String,
        tool_length: f64,
        dynamics: Dynamics,
        max_moves: usize,
    ) -> Result<Self, StageError> {
        let bad_machine =
            |e: patchmill_kinematics::KinematicsError| StageError::new(BAD_MACHINE, e.to_string());
        let bad = |e: String| StageError::new(BAD_PROGRAM, format!("the program cannot be run: {e}"));
        let machine =
            Machine::from_urdf(&machine_urdf, tool_length, dynamics.accelerations).map_err(bad_machine)?;
        let zero = machine.zero_offset().map_err(bad_machine)?;
        let blocks = gcode::read(&text, &machine, &zero, max_moves).map_err(bad)?;
        if blocks.is_empty() {
            return Err(bad("it has no motion".to_owned()));
        }
        let outside = |b: &ReadBlock| machine.violation(&b.joints).filter(|v| v.excess() > TRAVEL_SLACK);
        if let Some((line, violation)) = blocks.iter().find_map(|b| outside(b).map(|v| (b.line, v))) {
            return Err(bad(format!("line {line}: {violation}")));
        }
        let corner_tolerance = gcode::path_tolerance(&text).unwrap_or(dynamics.control.corner_tolerance);
        let control = Control { corner_tolerance, ..dynamics.control };
        let timing = time_program(&blocks, &machine, &control);
        let (sha256, setup) = (sha256_hex(&text), Setup::new(&machine_urdf, tool_length, dynamics));
        Ok(Self { text, sha256, machine, machine_urdf, setup, blocks, timing })
    }

    /// Where the program ends, m and rad.
    pub fn end(&self) -> Joints {
        self.blocks.last().map_or([0.0; 5], |b| b.joints)
    }

    /// Share of the planned time that is over at the end of the block before `line`.
    pub fn fraction(&self, line: u32) -> f64 {
        let place = self.blocks.partition_point(|b| b.line < line as usize);
        let time = place.checked_sub(1).map_or(0.0, |i| self.timing.block_ends[i]);
        if self.timing.duration > 0.0 { time / self.timing.duration } else { 1.0 }
    }

    /// Place of the block of a line, or of the last one before it; `None` before the first.
    pub fn block_at(&self, line: u32) -> Option<usize> {
        self.blocks.partition_point(|b| b.line <= line as usize).checked_sub(1)
    }

    /// Distance of a position from the path near block `place`.
    pub fn deviation(&self, place: usize, joints: &Joints) -> Deviation {
        self.deviation_within(place.saturating_sub(BEHIND), place + AHEAD, joints)
    }

    /// Distance of a position from the path between the ends of two blocks, places of [`Self::blocks`].
    pub fn deviation_within(&self, first: usize, end: usize, joints: &Joints) -> Deviation {
        let last = self.blocks.len() - 1;
        let (first, end) = (first.min(last), end.min(last));
        let point = |i: usize| &self.blocks[i].joints;
        let start = [*point(first), *point(first)];
        let segments = std::iter::once(start).chain((first..end).map(|i| [*point(i), *point(i + 1)]));
        let far = Deviation { linear: f64::INFINITY, rotary: f64::INFINITY };
        let nearer = |best: Deviation, [a, b]: [Joints; 2]| {
            let found = distance(joints, &a, &b);
            if size(found) < size(best) { found } else { best }
        };
        segments.fold(far, nearer)
    }
}

/// One number for a deviation: a radian counts as 0.1 m.
fn size(deviation: Deviation) -> f64 {
    deviation.linear.hypot(0.1 * deviation.rotary)
}

/// Distance from the straight joint motion between two positions, at its nearest point (a radian counts as 0.1 m).
fn distance(joints: &Joints, a: &Joints, b: &Joints) -> Deviation {
    let weight = |j: usize| if j < 3 { 1.0 } else { 0.01 };
    let dot = |u: &dyn Fn(usize) -> f64, v: &dyn Fn(usize) -> f64| -> f64 {
        (0..5).map(|j| weight(j) * u(j) * v(j)).sum()
    };
    let (way, from) = (|j: usize| b[j] - a[j], |j: usize| joints[j] - a[j]);
    let square = dot(&way, &way);
    let share = if square > 0.0 { (dot(&from, &way) / square).clamp(0.0, 1.0) } else { 0.0 };
    let off = |j: usize| (from(j) - share * way(j)).abs();
    Deviation { linear: (0..3).map(off).fold(0.0, f64::max), rotary: off(3).max(off(4)) }
}

/// What comes with every part of a program.
#[derive(Clone, Debug, PartialEq)]
pub struct Part {
    /// sha256 of the whole text, hex digits.
    pub sha256: String,
    /// Number of the part, from 0.
    pub index: u32,
    /// Number of parts.
    pub count: u32,
    /// Slice of the text.
    pub text: String,
    /// Slice of the URDF.
    pub machine_urdf: String,
    /// From the spindle nose to the tool tip, m.
    pub tool_length: f64,
    /// How machine and control move.
    pub dynamics: Dynamics,
}

impl Part {
    /// Whether both say the same of the program that they are parts of.
    fn belongs_to(&self, other: &Self) -> bool {
        (&self.sha256, self.count, self.tool_length, self.dynamics)
            == (&other.sha256, other.count, other.tool_length, other.dynamics)
    }
}

/// The parts of the program that is coming in. A part of another program lets go of those before.
#[derive(Debug, Default)]
pub struct PartStore {
    parts: BTreeMap<u32, Part>,
}

impl PartStore {
    /// Takes a part; all of them once the last one is there (they are let go of then), else how many are missing.
    ///
    /// # Errors
    /// [`BAD_PROGRAM`] when the part makes no sense.
    pub fn take(&mut self, part: Part) -> Result<Result<AllParts, u32>, StageError> {
        let bad = |text: String| Err(StageError::new(BAD_PROGRAM, text));
        if part.count == 0 || part.count > MOST_PARTS || part.index >= part.count {
            return bad(format!(
                "part {} of {} of a program: 1 to {MOST_PARTS} parts were expected, counted from 0",
                part.index, part.count
            ));
        }
        if !self.parts.values().all(|other| other.belongs_to(&part)) {
            self.parts.clear();
        }
        let count = part.count as usize;
        self.parts.insert(part.index, part);
        let bytes: usize = self.parts.values().map(|p| p.text.len() + p.machine_urdf.len()).sum();
        if bytes > LONGEST_TEXT {
            self.parts.clear();
            return bad(format!("the program has more than {LONGEST_TEXT} bytes"));
        }
        if self.parts.len() < count {
            return Ok(Err((count - self.parts.len()) as u32));
        }
        Ok(Ok(AllParts(std::mem::take(&mut self.parts))))
    }
}

/// Every part of a program.
#[derive(Debug)]
pub struct AllParts(BTreeMap<u32, Part>);

impl AllParts {
    /// Puts them together. Takes time for a long program, as what follows does.
    ///
    /// # Errors
    /// [`BAD_PROGRAM`] when the whole has another hash.
    pub fn join(self) -> Result<BroughtProgram, StageError> {
        let bad = |text: String| Err(StageError::new(BAD_PROGRAM, text));
        let text: String = self.0.values().map(|p| p.text.as_str()).collect();
        let machine_urdf: String = self.0.values().map(|p| p.machine_urdf.as_str()).collect();
        let Some(Part { sha256, tool_length, dynamics, .. }) = self.0.into_values().next() else {
            return bad("a program without parts".to_owned());
        };
        let found = sha256_hex(&text);
        if found != sha256 {
            return bad(format!("the program's text has the sha256 {found}, {sha256} was announced"));
        }
        Ok(BroughtProgram { text, sha256, machine_urdf, tool_length, dynamics })
    }
}

/// A program that was brought as a whole, its text that of its hash, not read yet.
#[derive(Debug)]
pub struct BroughtProgram {
    /// sha256 of the text, hex digits.
    pub sha256: String,
    text: String,
    machine_urdf: String,
    tool_length: f64,
    dynamics: Dynamics,
}

impl BroughtProgram {
    /// Machine, tool and dynamics that it was brought with.
    pub fn setup(&self) -> Setup {
        Setup::new(&self.machine_urdf, self.tool_length, self.dynamics)
    }

    /// Reads and times it, of at most `max_moves` moves.
    ///
    /// # Errors
    /// As [`ExecutableProgram::new`].
    pub fn read(self, max_moves: usize) -> Result<ExecutableProgram, StageError> {
        ExecutableProgram::new(self.text, self.machine_urdf, self.tool_length, self.dynamics, max_moves)
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::DEFAULT_MACHINE_URDF;
    use patchmill_products::job::Job;

    /// Three sides of a square in the air.
    pub(crate) const SQUARE: &str =
        "(a square)\nG21 G90 G54 G17 G40 G94\nG0 Z380\nG0 X0 Y0 Z380 A10 C20\nG1 X10 F6000\nY10\nX0\nM30\n";
    /// Those of a default job.
    pub(crate) fn dynamics() -> Dynamics {
        Dynamics::of(&Job::default_for(""))
    }

    pub(crate) fn square() -> ExecutableProgram {
        ExecutableProgram::new(SQUARE.to_owned(), DEFAULT_MACHINE_URDF.to_owned(), 0.1, dynamics(), 10)
            .unwrap()
    }

    fn part(index: u32, text: &str, urdf: &str) -> Part {
        Part {
            sha256: sha256_hex(SQUARE),
            index,
            count: 2,
            text: text.to_owned(),
            machine_urdf: urdf.to_owned(),
            tool_length: 0.1,
            dynamics: dynamics(),
        }
    }

    #[test]
    fn a_hash_is_the_one_of_sha256sum() {
        assert_eq!(sha256_hex("abc"), "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
    }

    #[test]
    fn parts_come_in_any_order_and_repeated() {
        let (a, b) = SQUARE.split_at(40);
        let (urdf, rest) = DEFAULT_MACHINE_URDF.split_at(1000);
        let mut store = PartStore::default();
        assert_eq!(store.take(part(1, b, rest)).unwrap().unwrap_err(), 1);
        assert_eq!(store.take(part(1, b, rest)).unwrap().unwrap_err(), 1);
        let brought = store.take(part(0, a, urdf)).unwrap().unwrap().join().unwrap();
        assert_eq!(brought.setup(), square().setup);
        let program = brought.read(10).unwrap();
        assert_eq!((program.text.as_str(), program.blocks.len()), (SQUARE, 4));
        assert!(store.take(part(2, a, urdf)).is_err());
        store.take(part(0, a, urdf)).unwrap().unwrap_err();
        let error = store.take(part(1, a, rest)).unwrap().unwrap().join().unwrap_err();
        assert_eq!(error.code, BAD_PROGRAM);
        assert!(error.text.contains("sha256"), "{error}");
    }

    #[test]
    fn parts_that_say_different_things_make_up_no_program() {
        let (a, b) = SQUARE.split_at(40);
        let mut store = PartStore::default();
        store.take(part(0, a, "")).unwrap().unwrap_err();
        let longer = Part { tool_length: 0.2, ..part(1, b, "") };
        assert_eq!(store.take(longer).unwrap().unwrap_err(), 1);
        assert!(store.take(part(0, a, "")).unwrap().is_err());
        assert!(store.take(part(1, b, "")).unwrap().is_ok());
    }

    #[test]
    fn bad_programs_are_refused() {
        let run = |text: &str| {
            let urdf = DEFAULT_MACHINE_URDF.to_owned();
            ExecutableProgram::new(text.to_owned(), urdf, 0.1, dynamics(), 10).unwrap_err()
        };
        assert!(run("G21 G90\nG2 X1").text.contains("line 2"));
        assert!(
            run(&(SQUARE.to_owned() + &"X1\n".repeat(7)))
                .text
                .contains("line 15: the program has more than 10 moves")
        );
        assert!(run("M30\n").text.contains("no motion"));
        assert!(run(&SQUARE.replace("Y10", "Y1000")).text.contains("line 6: axis Y"));
        let none = ExecutableProgram::new(SQUARE.to_owned(), String::new(), 0.1, dynamics(), 10).unwrap_err();
        assert_eq!(none.code, BAD_MACHINE);
    }

    #[test]
    fn deviations_are_measured_from_the_path() {
        let program = square();
        let at = |line| program.block_at(line).unwrap();
        assert_eq!(program.block_at(3), None);
        let mut joints = program.blocks[at(5)].joints;
        joints[0] -= 0.004;
        joints[1] += 0.000_02;
        let off = program.deviation(at(5), &joints);
        assert!((off.linear - 0.000_02).abs() < 1e-9 && off.rotary < 1e-12, "{off:?}");
        joints[4] += 0.001;
        assert!((program.deviation(at(6), &joints).rotary - 0.001).abs() < 1e-9);
        assert_eq!(program.fraction(4), 0.0);
        assert!(program.fraction(6) > 0.3 && program.fraction(6) < 0.4);
    }
}
