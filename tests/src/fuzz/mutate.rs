//! Inputs made from seeds: bits, bytes, numbers and words changed, stretches cut, repeated and spliced.

use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{RngCore, SeedableRng};

/// No input is longer, bytes, unless a seed is.
const LONGEST: usize = 1 << 16;
/// Of a long input the start is changed more often, bytes: headers and counts stand there.
const HEAD: usize = 400;

/// Numbers at the ends of ranges and beyond, as text.
const NUMBERS: [&str; 24] = [
    "0",
    "-0",
    "1",
    "-1",
    "2",
    "3",
    "255",
    "256",
    "65536",
    "4294967295",
    "4294967296",
    "-2147483648",
    "9223372036854775807",
    "18446744073709551615",
    "99999999999999999999999",
    "1e308",
    "-1e308",
    "1e-320",
    "1e999",
    "nan",
    "inf",
    "-inf",
    "0.5",
    "1e15",
];
/// Numbers at the ends of ranges, as bits.
const BITS: [u64; 16] = [
    0,
    1,
    2,
    0x7f,
    0xff,
    0x7fff,
    0xffff,
    0x7fff_ffff,
    0x8000_0000,
    0xffff_ffff,
    0x7f80_0000,
    0x7ff0_0000_0000_0000,
    0x7ff8_0000_0000_0000,
    0x7fef_ffff_ffff_ffff,
    0x7fff_ffff_ffff_ffff,
    u64::MAX,
];
/// Bytes and texts with a meaning somewhere.
const TEXTS: [&str; 22] = [
    "\0",
    "\n",
    " ",
    "\"",
    "'",
    "(",
    ")",
    "[",
    "]",
    "{",
    "}",
    "<",
    "/>",
    "<!--",
    "&",
    "*",
    "#",
    ";",
    "..",
    "é",
    "\u{feff}",
    "\u{10ffff}",
];

/// Random numbers of one input.
pub struct Random(Xoshiro256PlusPlus);

impl Random {
    /// Those of input `number` of the run with `seed`.
    pub fn of(seed: u64, number: u64) -> Self {
        // Far apart in the seed's space for neighbouring numbers.
        Self(Xoshiro256PlusPlus::seed_from_u64(seed ^ number.wrapping_mul(0x9E37_79B9_7F4A_7C15)))
    }

    /// 64 random bits.
    pub fn bits(&mut self) -> u64 {
        self.0.next_u64()
    }

    /// A number below `end`; 0 for 0.
    pub fn below(&mut self, end: usize) -> usize {
        if end == 0 { 0 } else { (self.bits() % end as u64) as usize }
    }

    /// One of several.
    pub fn pick<'a, T>(&mut self, list: &'a [T]) -> Option<&'a T> {
        list.get(self.below(list.len()))
    }
}

/// An input: a seed, changed once to some times.
pub fn input(seeds: &[Vec<u8>], random: &mut Random) -> Vec<u8> {
    let mut bytes = random.pick(seeds).cloned().unwrap_or_default();
    let longest = bytes.len().max(LONGEST);
    let times = 1 + random.below(8) * random.below(2);
    for _ in 0..times {
        change(&mut bytes, seeds, random);
        bytes.truncate(longest);
    }
    bytes
}

fn change(bytes: &mut Vec<u8>, seeds: &[Vec<u8>], random: &mut Random) {
    match random.below(14) {
        0 => flip(bytes, random),
        1 => set_byte(bytes, random),
        2 | 3 => set_bits(bytes, random),
        4..=6 => {
            // A number from elsewhere in the input may be a reference that leads to itself.
            let own = word_of(bytes, |c| c.is_ascii_digit(), random);
            let known = random.pick(&NUMBERS).map(|n| n.as_bytes().to_vec()).unwrap_or_default();
            let by = if random.below(4) == 0 { own } else { known };
            replace_word(bytes, |c| c.is_ascii_digit() || b"+-.eE".contains(&c), random, &by);
        }
        7 => {
            let word = |c: u8| c.is_ascii_alphanumeric() || c == b'_';
            let by = random.pick(seeds).map(|other| other.to_vec()).unwrap_or_default();
            let by = word_of(&by, word, random);
            replace_word(bytes, word, random, &by);
        }
        8 => bytes.truncate(random.below(bytes.len() + 1)),
        9 => repeat(bytes, random),
        10 => {
            let (from, to) = stretch(bytes, random);
            bytes.drain(from..to);
        }
        11 => splice(bytes, seeds, random),
        12 => {
            let at = place(bytes, random);
            let text = random.pick(&TEXTS).copied().unwrap_or_default();
            bytes.splice(at..at, text.bytes());
        }
        _ => copy(bytes, random),
    }
}

/// A place in the input, its end included.
fn place(bytes: &[u8], random: &mut Random) -> usize {
    let end = if random.below(3) == 0 { bytes.len().min(HEAD) } else { bytes.len() };
    random.below(end + 1)
}

/// From and to of a stretch, mostly a short one.
fn stretch(bytes: &[u8], random: &mut Random) -> (usize, usize) {
    let from = place(bytes, random);
    let longest = if random.below(4) == 0 { bytes.len() } else { 40 };
    (from, (from + random.below(longest + 1)).min(bytes.len()))
}

fn flip(bytes: &mut [u8], random: &mut Random) {
    let (at, bit) = (place(bytes, random), random.below(8));
    if let Some(byte) = bytes.get_mut(at) {
        *byte ^= 1 << bit;
    }
}

fn set_byte(bytes: &mut [u8], random: &mut Random) {
    let (at, value) = (place(bytes, random), random.bits() as u8);
    if let Some(byte) = bytes.get_mut(at) {
        *byte = value;
    }
}

/// A number of 2, 4 or 8 bytes, mostly where such a number can stand in binary data.
fn set_bits(bytes: &mut [u8], random: &mut Random) {
    let size = 2 << random.below(3);
    let mut at = place(bytes, random);
    if random.below(4) > 0 {
        at -= at % 4;
    }
    let bits = random.pick(&BITS).copied().unwrap_or_default();
    let bits = if random.below(4) == 0 { bits.wrapping_add(random.bits() % 9).wrapping_sub(4) } else { bits };
    let mut number = bits.to_le_bytes();
    if random.below(8) == 0 {
        number[..size].reverse();
    }
    if let Some(slot) = bytes.get_mut(at..at + size) {
        slot.copy_from_slice(&number[..size]);
    }
}

/// The first run of bytes of one kind from a place on, replaced.
fn replace_word(bytes: &mut Vec<u8>, kind: impl Fn(u8) -> bool, random: &mut Random, by: &[u8]) {
    let start = place(bytes, random);
    if let Some((from, to)) = run_from(bytes, start, kind) {
        bytes.splice(from..to, by.iter().copied());
    }
}

fn word_of(bytes: &[u8], kind: impl Fn(u8) -> bool, random: &mut Random) -> Vec<u8> {
    let start = place(bytes, random);
    run_from(bytes, start, kind).map(|(from, to)| bytes[from..to].to_vec()).unwrap_or_default()
}

fn run_from(bytes: &[u8], start: usize, kind: impl Fn(u8) -> bool) -> Option<(usize, usize)> {
    let from = start + bytes.get(start..)?.iter().position(|c| kind(*c))?;
    let length = bytes[from..].iter().position(|c| !kind(*c)).unwrap_or(bytes.len() - from);
    Some((from, from + length))
}

/// A stretch, mostly a few times, now and then thousands of times: deep nesting, long lists.
fn repeat(bytes: &mut Vec<u8>, random: &mut Random) {
    let (from, to) = stretch(bytes, random);
    let part = bytes[from..to].to_vec();
    if part.is_empty() {
        return;
    }
    let most = if random.below(16) == 0 { LONGEST } else { 200 };
    let times = (1 + random.below(most / part.len())).min(LONGEST);
    bytes.splice(from..from, part.repeat(times));
}

/// The start of the input, then the end of a seed.
fn splice(bytes: &mut Vec<u8>, seeds: &[Vec<u8>], random: &mut Random) {
    let Some(other) = random.pick(seeds) else { return };
    let (end, start) = (random.below(bytes.len() + 1), random.below(other.len() + 1));
    bytes.truncate(end);
    bytes.extend_from_slice(&other[start..]);
}

/// A stretch, put over another place.
fn copy(bytes: &mut [u8], random: &mut Random) {
    let (from, to) = stretch(bytes, random);
    let at = random.below(bytes.len() - (to - from) + 1);
    bytes.copy_within(from..to, at);
}
