//! Numbers and words of programs in tilted planes.

use nalgebra::Vector3;

/// Decimals of a coordinate in mm.
const COORDINATE_DECIMALS: usize = 4;

/// Fixed decimals, never `-0`; with a leading `+` where `signed`.
pub(super) fn fixed(value: f64, decimals: usize, signed: bool) -> String {
    let text = format!("{value:.decimals$}");
    let zero = text.bytes().all(|b| matches!(b, b'-' | b'0' | b'.'));
    let text = if zero { text.trim_start_matches('-').to_owned() } else { text };
    if signed && !text.starts_with('-') { format!("+{text}") } else { text }
}

/// X Y Z words of one plane; those that did not change are left out.
pub(super) struct Coordinates {
    signed: bool,
    last: [String; 3],
}

impl Coordinates {
    /// `signed`: every number has a sign.
    pub(super) fn new(signed: bool) -> Self {
        Self { signed, last: Default::default() }
    }

    /// The next words count in another plane.
    pub(super) fn forget(&mut self) {
        self.last = Default::default();
    }

    /// The words of a tip in plane coordinates, mm, for the axes `which` (0 X, 1 Y, 2 Z). At least one: a move too
    /// short for its digits stays a block.
    pub(super) fn words(&mut self, tip: &Vector3<f64>, which: &[usize]) -> Vec<String> {
        let mut words = Vec::with_capacity(3);
        for &i in which {
            let word = format!("{}{}", ['X', 'Y', 'Z'][i], fixed(tip[i], COORDINATE_DECIMALS, self.signed));
            if word != self.last[i] {
                words.push(word.clone());
                self.last[i] = word;
            }
        }
        if words.is_empty() {
            words.extend(which.last().map(|&i| self.last[i].clone()));
        }
        words
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn zero_has_no_minus_and_signs_are_where_wanted() {
        let texts = [(-0.00004, false), (0.0, true), (-1.5, true), (2.0, true), (2.0, false)];
        let written: Vec<String> = texts.iter().map(|(v, signed)| fixed(*v, 4, *signed)).collect();
        assert_eq!(written, ["0.0000", "+0.0000", "-1.5000", "+2.0000", "2.0000"]);
    }

    #[test]
    fn only_changes_are_written_but_every_move_is_a_block() {
        let mut at = Coordinates::new(false);
        let all = [0, 1, 2];
        assert_eq!(at.words(&Vector3::new(1.0, 2.0, 3.0), &all), ["X1.0000", "Y2.0000", "Z3.0000"]);
        assert_eq!(at.words(&Vector3::new(1.0, 2.5, 3.00001), &all), ["Y2.5000"]);
        assert_eq!(at.words(&Vector3::new(1.0, 2.5, 3.0), &all), ["Z3.0000"]);
        at.forget();
        assert_eq!(at.words(&Vector3::new(1.0, 2.5, 3.0), &[0, 1]), ["X1.0000", "Y2.5000"]);
    }
}
