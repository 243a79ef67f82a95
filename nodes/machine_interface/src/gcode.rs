//! Program text: RS-274 for LinuxCNC, written from a motion plan and read back as joint motion.
//!
//! X Y Z in mm and A B C in degrees are joint values from the work offset that puts X0 Y0 Z0 at the workpiece origin
//! with both rotary axes at 0. Absolute (G90), millimetres (G21). Feed is in mm/min (G94) where the tool axis is fixed; where
//! five axes move at once every feed move says how much of it is done in a minute (G93), so that the tip keeps its feed.
//! The reader understands what the writer writes and refuses everything else that would move or measure differently.

use crate::motion::MotionPlan;
use patchmill_kinematics::{AxisKind, Joints, Machine};
use std::ops::Range;

/// A tip that moves less than this in a move rests, m: the axes' own way counts then.
const RESTS: f64 = 1e-12;

/// What a program says of itself and of the spindle.
#[derive(Clone, Debug, PartialEq)]
pub struct Header {
    /// Comment lines, one clear statement each; made safe for the control by the writer.
    pub comments: Vec<String>,
    /// Spindle speed, rad/s.
    pub spindle_speed: f64,
    /// Feed, m/s.
    pub feed: f64,
    /// How far the control may leave a corner of the path, m.
    pub path_tolerance: f64,
}

/// A written program.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ProgramText {
    /// The text, lines end with a line feed.
    pub text: String,
    /// Line numbers (1-based, end exclusive) of each patch of the motion plan.
    pub patch_lines: Vec<Range<usize>>,
}

/// One motion of a program, as read.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReadBlock {
    /// Its line, 1-based.
    pub line: usize,
    /// Rapid (G0) or feed (G1).
    pub rapid: bool,
    /// Joint values at its end, m and rad.
    pub joints: Joints,
    /// Programmed feed of the tip, m/s (rad/s of the rotary axis that turns most where the tip rests); 0 for rapids.
    pub feed: f64,
}

/// Writes the program of a motion plan. `zero` is the machine's work offset ([`Machine::zero_offset`]).
pub fn write(plan: &MotionPlan, machine: &Machine, zero: &Joints, header: &Header) -> ProgramText {
    let mut w = Writer {
        machine,
        zero,
        out: ProgramText::default(),
        lines: 0,
        last: Default::default(),
        modal: String::new(),
    };
    for comment in &header.comments {
        w.line(&format!("({})", sanitised(comment)));
    }
    w.line(if plan.simultaneous { "G21 G90 G54 G17 G40 G93" } else { "G21 G90 G54 G17 G40 G94" });
    w.line("T1 M6");
    w.line("G43 H1");
    w.line(&format!("S{:.0} M3", header.spindle_speed * 60.0 / std::f64::consts::TAU));
    w.line(&format!("G64 P{}", trimmed(header.path_tolerance * 1e3, 6)));
    if let Some((axis, value)) = plan.raise {
        let word = w.word(axis, value);
        w.line(&format!("G0 {word}"));
        w.modal = "G0".to_owned();
    }
    let feed = format!("F{}", trimmed(header.feed * 60e3, 4));
    let mut feed_given = false;
    for (i, block) in plan.blocks.iter().enumerate() {
        let enters = i == 0 || plan.blocks[i - 1].patch != block.patch;
        if enters {
            w.enter_patch(plan, block.patch);
        }
        let turns = i == 0 || plan.blocks[i - 1].joints[3..] != block.joints[3..];
        let mut words = w.changed_words(&block.joints, i == 0, turns);
        if words.is_empty() {
            continue;
        }
        let code = if block.rapid { "G0" } else { "G1" };
        if w.modal != code {
            words.insert(0, code.to_owned());
            w.modal = code.to_owned();
        }
        if !block.rapid && plan.simultaneous {
            let from = &plan.blocks[i.saturating_sub(1)].joints;
            let per_minute = 60.0 * header.feed / way(machine, from, &block.joints).max(RESTS);
            words.push(format!("F{}", trimmed(per_minute, 4)));
        } else if !block.rapid && !feed_given {
            words.push(feed.clone());
            feed_given = true;
        }
        w.line(&words.join(" "));
    }
    if let Some(last) = w.out.patch_lines.last_mut() {
        last.end = w.lines + 1;
    }
    w.line("M5");
    w.line("M30");
    w.out
}

/// What the feed of a move is measured on: the way of the tip, m, else of the rotary axis that turns most, rad.
fn way(machine: &Machine, from: &Joints, to: &Joints) -> f64 {
    let tip = (machine.pose(to).tip - machine.pose(from).tip).norm();
    if tip > RESTS { tip } else { (3..5).map(|j| (to[j] - from[j]).abs()).fold(0.0, f64::max) }
}

/// The path tolerance that a program asks of the control (`G64 P`), m; `None` where it does not.
pub fn path_tolerance(text: &str) -> Option<f64> {
    let asked =
        text.lines().filter_map(|line| words_of(line).ok()).find(|words| words.contains(&('G', 64.0)))?;
    asked.iter().find(|(letter, _)| *letter == 'P').map(|(_, value)| value / 1e3)
}

struct Writer<'a> {
    machine: &'a Machine,
    zero: &'a Joints,
    out: ProgramText,
    lines: usize,
    last: [String; 5],
    modal: String,
}

impl Writer<'_> {
    fn line(&mut self, line: &str) {
        self.out.text.push_str(line);
        self.out.text.push('\n');
        self.lines += 1;
    }

    fn enter_patch(&mut self, plan: &MotionPlan, patch: usize) {
        let next = self.lines + 1;
        if let Some(before) = self.out.patch_lines.last_mut() {
            before.end = next;
        }
        self.out.patch_lines.push(next..next);
        self.modal.clear();
        self.line(&format!("(patch {} of {})", patch + 1, plan.patches.len()));
    }

    /// The word of an axis: joint value from the work offset, mm with 4 decimals or degrees with 5.
    fn word(&self, axis: usize, value: f64) -> String {
        let a = &self.machine.axes()[axis];
        let number = match a.kind {
            AxisKind::Linear => format!("{:.4}", (value - self.zero[axis]) * 1e3),
            AxisKind::Rotary => format!("{:.5}", value.to_degrees()),
        };
        let is_zero = number.bytes().all(|b| matches!(b, b'-' | b'0' | b'.'));
        format!("{}{}", a.letter, if is_zero { number.trim_start_matches('-') } else { &number })
    }

    /// The words that differ from the last line's: all of them at the start, the rotary ones at every index.
    fn changed_words(&mut self, joints: &Joints, all: bool, turns: bool) -> Vec<String> {
        let mut words = Vec::with_capacity(5);
        for (i, value) in joints.iter().enumerate() {
            let word = self.word(i, *value);
            if all || (turns && i >= 3) || word != self.last[i] {
                words.push(word.clone());
                self.last[i] = word;
            }
        }
        words
    }
}

/// Text that is safe inside a comment of any control: plain ASCII without parentheses and what ends or goes on with a line (`~`:
/// Heidenhain), not too long, and not taken for an active comment (`MSG,`, `DEBUG,` …).
pub(crate) fn sanitised(text: &str) -> String {
    let plain = |c: char| match c {
        '(' => '[',
        ')' => ']',
        ' '..='}' if !matches!(c, ';' | '%') => c,
        _ => '?',
    };
    let line: String = text.chars().map(plain).take(200).collect();
    if is_active(&line) { format!("- {line}") } else { line }
}

/// Whether LinuxCNC does something at a comment that begins so: shows it, stops, writes files, runs Python.
fn is_active(comment: &str) -> bool {
    let begins = comment.trim_start().to_ascii_uppercase();
    ["MSG", "DEBUG", "PRINT", "LOG", "PROBE", "PY", "ABORT"].iter().any(|word| begins.starts_with(word))
}

/// Fixed decimals without trailing zeros.
pub(crate) fn trimmed(value: f64, decimals: usize) -> String {
    let text = format!("{value:.decimals$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

/// Most moves of a program under any circumstances: some 800 MB of text.
pub const MOST_MOVES: usize = 20_000_000;

/// Reads program text of at most `max_moves` moves back as joint motion on `machine` with the work offset `zero`. Motions before every axis has
/// been given a position are left out: where they begin and end is not known.
///
/// # Errors
/// One sentence with the line number for anything that this reader does not understand.
pub fn read(
    text: &str,
    machine: &Machine,
    zero: &Joints,
    max_moves: usize,
) -> Result<Vec<ReadBlock>, String> {
    let mut state = Reader {
        machine,
        zero,
        at: [None; 5],
        rapid: None,
        feed: None,
        inverse: false,
        metric: false,
        absolute: false,
    };
    let mut blocks = Vec::new();
    for (i, line) in text.lines().enumerate() {
        let words = words_of(line).map_err(|e| format!("line {}: {e}", i + 1))?;
        match state.apply(&words, i + 1) {
            Ok(block) => blocks.extend(block),
            Err(e) => return Err(format!("line {}: {e}", i + 1)),
        }
        if blocks.len() > max_moves {
            return Err(format!("line {}: the program has more than {max_moves} moves (max_moves)", i + 1));
        }
    }
    Ok(blocks)
}

struct Reader<'a> {
    machine: &'a Machine,
    zero: &'a Joints,
    at: [Option<f64>; 5],
    rapid: Option<bool>,
    /// The F word: mm/min, or moves a minute in inverse time.
    feed: Option<f64>,
    inverse: bool,
    metric: bool,
    absolute: bool,
}

impl Reader<'_> {
    fn apply(&mut self, words: &[(char, f64)], line: usize) -> Result<Option<ReadBlock>, String> {
        for &(letter, value) in words {
            if letter == 'G' {
                self.preparatory(value)?;
            }
        }
        if self.inverse {
            // Every move says its own.
            self.feed = None;
        }
        for &(letter, value) in words {
            match letter {
                'F' if value > 0.0 => self.feed = Some(value),
                'F' => return Err("the feed must be positive".to_owned()),
                'S' | 'P' if value <= 0.0 => return Err(format!("{letter}{value} is not above 0")),
                // Others run subroutines and programs of the control, switch outputs or change what a word means.
                'M' if ![2.0, 3.0, 5.0, 6.0, 30.0].contains(&value) => {
                    return Err(format!("M{value} is not supported"));
                }
                'T' | 'H' if value != 1.0 => return Err(format!("{letter}{value}: the tool is number 1")),
                _ => {}
            }
        }
        let before = self.at;
        let mut moved = false;
        for &(letter, value) in words {
            if let Some(i) = self.machine.axes().iter().position(|a| a.letter == letter) {
                moved = true;
                self.at[i] = Some(match self.machine.axes()[i].kind {
                    AxisKind::Linear => value / 1e3 + self.zero[i],
                    AxisKind::Rotary => value.to_radians(),
                });
            } else if !matches!(letter, 'G' | 'F' | 'M' | 'T' | 'S' | 'H' | 'P' | 'N') {
                return Err(format!("word {letter} is not of this machine"));
            }
        }
        if !moved {
            return Ok(None);
        }
        if !(self.metric && self.absolute) {
            return Err("a motion before G21 and G90".to_owned());
        }
        let Some(rapid) = self.rapid else { return Err("a motion before G0 or G1".to_owned()) };
        let mut joints = [0.0; 5];
        for (q, at) in joints.iter_mut().zip(self.at) {
            match at {
                Some(value) => *q = value,
                None if rapid => return Ok(None),
                None => return Err("a feed move before every axis has a position".to_owned()),
            }
        }
        let feed = match (rapid, self.feed) {
            (true, _) => 0.0,
            (false, Some(feed)) if self.inverse => {
                let from = std::array::from_fn(|i| before[i].unwrap_or(joints[i]));
                way(self.machine, &from, &joints) * feed / 60.0
            }
            (false, Some(feed)) => feed / 60e3,
            (false, None) => return Err("a feed move without a feed".to_owned()),
        };
        Ok(Some(ReadBlock { line, rapid, joints, feed }))
    }

    fn preparatory(&mut self, code: f64) -> Result<(), String> {
        // Codes are whole or have one decimal (G33.1).
        match (code * 10.0).round() as i64 {
            0 => self.rapid = Some(true),
            10 => self.rapid = Some(false),
            210 => self.metric = true,
            900 => self.absolute = true,
            930 | 940 => (self.inverse, self.feed) = (code == 93.0, None),
            170 | 400 | 430 | 540 | 640 => {}
            _ => return Err(format!("G{code} is not supported")),
        }
        Ok(())
    }
}

/// The words of a line without its comments, which must do nothing.
pub(crate) fn words_of(line: &str) -> Result<Vec<(char, f64)>, String> {
    if line.chars().any(|c| c.is_control() && c != '\t') {
        // Some controls begin a new line at a carriage return.
        return Err("a control character".to_owned());
    }
    let mut code = String::new();
    let mut in_comment = false;
    for (at, c) in line.char_indices() {
        match c {
            ';' | '(' if !in_comment && is_active(&line[at + 1..]) => {
                let shown: String = line[at..].chars().take(40).collect();
                return Err(format!("the control would act on the comment `{shown}`"));
            }
            ';' if !in_comment => break,
            '(' if !in_comment => in_comment = true,
            ')' if in_comment => in_comment = false,
            c if !in_comment && !c.is_whitespace() => code.push(c.to_ascii_uppercase()),
            _ => {}
        }
    }
    if in_comment {
        return Err("a comment without end".to_owned());
    }
    let mut words = Vec::new();
    let mut rest = code.as_str();
    while let Some(letter) = rest.chars().next() {
        if !letter.is_ascii_alphabetic() {
            return Err(format!("`{letter}` is not understood"));
        }
        let number = rest[1..].find(|c: char| c.is_ascii_alphabetic()).map_or(&rest[1..], |n| &rest[1..=n]);
        let plain = number.bytes().all(|b| b.is_ascii_digit() || matches!(b, b'.' | b'-' | b'+'));
        let value: f64 =
            number.parse().ok().filter(|_| plain).ok_or_else(|| format!("{letter}{number} is not a word"))?;
        words.push((letter, value));
        rest = &rest[1 + number.len()..];
    }
    Ok(words)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::DEFAULT_MACHINE_URDF;
    use crate::motion::{Block, PatchPose};
    use patchmill_kinematics::Accelerations;
    use proptest::prelude::*;

    fn machine() -> Machine {
        Machine::from_urdf(DEFAULT_MACHINE_URDF, 0.1, Accelerations { linear: 5.0, rotary: 20.0 }).unwrap()
    }

    fn header() -> Header {
        Header {
            comments: vec!["msg, (ä) ; %".to_owned()],
            spindle_speed: 628.318_530_7,
            feed: 2.0 / 60.0,
            path_tolerance: 2e-6,
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(200))]

        #[test]
        fn text_says_what_the_plan_says(
            ends in prop::collection::vec((any::<bool>(), prop::array::uniform5(-0.5..0.5f64)), 1..30),
            simultaneous: bool,
        ) {
            let machine = machine();
            let zero = machine.zero_offset().unwrap();
            let mut blocks: Vec<Block> = Vec::new();
            for (rapid, joints) in &ends {
                blocks.push(Block { rapid: *rapid || blocks.is_empty(), joints: *joints, patch: 0 });
            }
            let pose = PatchPose { place: 0, rotary: [0.0; 2], singular: false };
            let plan = MotionPlan { raise: Some((2, -0.001)), blocks, patches: vec![pose], simultaneous };
            let written = write(&plan, &machine, &zero, &header());
            prop_assert!(written.text.is_ascii());
            let read = read(&written.text, &machine, &zero, MOST_MOVES).unwrap();
            prop_assert_eq!(read.len(), plan.blocks.len());
            for (r, b) in read.iter().zip(&plan.blocks) {
                prop_assert_eq!(r.rapid, b.rapid);
                prop_assert!(r.rapid || (r.feed * 30.0 - 1.0).abs() < 1e-3, "{}", r.feed);
                prop_assert!(written.patch_lines[0].contains(&r.line));
                prop_assert!((0..3).all(|j| (r.joints[j] - b.joints[j]).abs() < 5.1e-8));
                prop_assert!((3..5).all(|j| (r.joints[j] - b.joints[j]).abs() < 8.8e-8));
            }
        }

        #[test]
        fn no_text_breaks_the_reader(text in ".{0,80}") {
            let machine = machine();
            let _ = read(&text, &machine, &[0.0; 5], MOST_MOVES);
        }
    }

    #[test]
    fn header_is_for_linuxcnc() {
        let machine = machine();
        let pose = PatchPose { place: 0, rotary: [0.0; 2], singular: false };
        let blocks = vec![Block { rapid: true, joints: [0.0, 0.0, 0.0, -0.0, 0.0], patch: 0 }];
        let plan = MotionPlan { raise: None, blocks, patches: vec![pose], simultaneous: false };
        let zero = [0.0, 0.0, -0.25, 0.0, 0.0];
        assert_eq!(
            write(&plan, &machine, &zero, &header()).text,
            "(- msg, [?] ? ?)\nG21 G90 G54 G17 G40 G94\nT1 M6\nG43 H1\nS6000 M3\nG64 P0.002\n(patch 1 of 1)\nG0 X0.0000 Y0.0000 Z250.0000 A0.00000 C0.00000\nM5\nM30\n"
        );
    }

    #[test]
    fn what_would_move_otherwise_is_refused() {
        let machine = machine();
        for (text, expected) in [
            ("G21 G90\nG2 X1", "line 2: G2 is not supported"),
            ("G20", "G20"),
            ("G21 G91", "G91"),
            ("G21 G90 G1 X1 Y0 Z0 A0 C0", "without a feed"),
            ("G21 G90 G1 X1 F100", "before every axis"),
            ("G21 G90 G93 G0 X1 Y0 Z0 A0 C0\nG1 X2 F9\nX3", "line 3: a feed move without a feed"),
            ("G0 X1", "before G21"),
            ("G21 G90 X1", "before G0"),
            ("G21 G90 G0 B1", "word B"),
            ("G21 G90 G0 X1e3", "word E"),
            ("G21 G90 G0 Xinf", "X is not a word"),
            ("G53 G0 Z0", "G53"),
            ("(never closed", "comment"),
            ("G21 G90\n(py, import os)", "line 2: the control would act on the comment `(py, import os)`"),
            ("; LOGOPEN,/tmp/x", "act on the comment"),
            ("(a\rG0 Z-9)", "a control character"),
            ("M98 P1", "M98 is not supported"),
            ("M100", "M100"),
            ("T2 M6", "T2: the tool is number 1"),
            ("G43 H3", "H3"),
            ("S0 M3", "S0 is not above 0"),
            ("G64 P0", "P0 is not above 0"),
            ("#1=2", "not understood"),
        ] {
            let error = read(text, &machine, &[0.0; 5], MOST_MOVES).unwrap_err();
            assert!(error.contains(expected), "{text}: {error}");
        }
    }
    #[test]
    fn too_many_moves_are_refused() {
        let text = String::from("G21 G90\nG0 X0 Y0 Z0 A0 C0\n") + &"X1\n".repeat(20);
        assert_eq!(read(&text, &machine(), &[0.0; 5], 21).unwrap().len(), 21);
        let error = read(&text, &machine(), &[0.0; 5], 20).unwrap_err();
        assert_eq!(error, "line 22: the program has more than 20 moves (max_moves)");
    }
}
