//! A range of inputs through one parser, one after the other: time and memory belong to the input at hand.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};

use super::Parser;
use super::mutate::{Random, input};

/// An input that takes longer is a find.
pub const LONGEST_TIME: Duration = Duration::from_secs(1);
/// So is one that takes more memory beyond its own bytes.
pub const MOST_MEMORY: usize = 256 << 20;
/// As many finds are kept.
const FINDS_MAX: usize = 50;

/// Reads the allocator: only a program that has set a counting one can say.
#[derive(Clone, Copy)]
pub struct Meter {
    /// Bytes allocated now; the peak counts from here on.
    pub reset: fn() -> usize,
    /// Most bytes allocated since.
    pub peak: fn() -> usize,
}

/// Which inputs.
#[derive(Clone, Copy, Debug)]
pub struct Range {
    /// Number of the first.
    pub first: u64,
    /// How many.
    pub count: u64,
    /// Seed of the run.
    pub seed: u64,
}

/// An input that a parser did not stand.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Find {
    /// Its number.
    pub number: u64,
    /// What happened.
    pub what: String,
}

/// What came of a range.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// The parser's name.
    pub parser: String,
    /// Inputs tried.
    pub inputs: u64,
    /// Those that were taken for valid.
    pub valid: u64,
    /// What was not stood, the first ones.
    pub finds: Vec<Find>,
    /// Longest time of an input, ms.
    pub slowest_ms: f64,
    /// Most memory of an input beyond its own bytes, MiB.
    pub memory_mib: f64,
    /// Duration, s.
    pub seconds: f64,
}

impl Report {
    /// Adds a range's report.
    pub fn add(&mut self, other: Self) {
        self.inputs += other.inputs;
        self.valid += other.valid;
        self.finds.extend(other.finds);
        self.slowest_ms = self.slowest_ms.max(other.slowest_ms);
        self.memory_mib = self.memory_mib.max(other.memory_mib);
        self.seconds += other.seconds;
    }
}

/// Text of the last panic: the hook's, for it knows the place.
static PANIC: Mutex<String> = Mutex::new(String::new());

/// Keeps panics quiet, their texts for [`run`].
pub fn catch_panics() {
    std::panic::set_hook(Box::new(|info| {
        *PANIC.lock().unwrap_or_else(PoisonError::into_inner) = info.to_string().replace('\n', " ");
    }));
}

/// Input `number` of a run.
pub fn input_of(parser: &Parser, seed: u64, number: u64) -> Vec<u8> {
    input(&parser.seeds, &mut Random::of(seed, number))
}

/// Runs a range; `begin` is told each input's number before the parser has it. Call [`catch_panics`] first.
pub fn run(parser: &Parser, range: Range, meter: Meter, mut begin: impl FnMut(u64)) -> Report {
    let start = Instant::now();
    let mut report = Report { parser: parser.name.clone(), inputs: range.count, ..Report::default() };
    for number in range.first..range.first + range.count {
        let bytes = input_of(parser, range.seed, number);
        begin(number);
        let tried = attempt(parser, &bytes, meter);
        report.valid += u64::from(tried.valid == Ok(true));
        report.slowest_ms = report.slowest_ms.max(tried.time.as_secs_f64() * 1e3);
        report.memory_mib = report.memory_mib.max(tried.memory as f64 / f64::from(1 << 20));
        if let (Some(what), true) = (tried.find(), report.finds.len() < FINDS_MAX) {
            report.finds.push(Find { number, what });
        }
    }
    report.seconds = start.elapsed().as_secs_f64();
    report
}

/// One input's way through a parser.
pub struct Attempt {
    /// Whether it was taken for valid, or the panic's text.
    pub valid: Result<bool, String>,
    /// Time that it took.
    pub time: Duration,
    /// Memory beyond its own bytes.
    pub memory: usize,
}

impl Attempt {
    /// What is not as promised.
    pub fn find(&self) -> Option<String> {
        match &self.valid {
            Err(panic) => Some(panic.clone()),
            Ok(_) if self.time > LONGEST_TIME => Some(format!("{:.1} s", self.time.as_secs_f64())),
            Ok(_) if self.memory > MOST_MEMORY => Some(format!("{} MiB", self.memory >> 20)),
            Ok(_) => None,
        }
    }
}

/// Gives an input to a parser.
pub fn attempt(parser: &Parser, bytes: &[u8], meter: Meter) -> Attempt {
    let mut first = attempt_once(parser, bytes, meter);
    if first.time > LONGEST_TIME {
        // Whether it was the input, or a busy machine.
        let before = waited();
        let second = attempt_once(parser, bytes, meter).time;
        first.time = first.time.min(second.saturating_sub(waited().saturating_sub(before)));
    }
    first
}

/// How long this thread has waited for a processor since it began, as Linux counts; where it does not, nothing.
fn waited() -> Duration {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    Duration::from_nanos(text.split_whitespace().nth(1).and_then(|ns| ns.parse().ok()).unwrap_or(0))
}

fn attempt_once(parser: &Parser, bytes: &[u8], meter: Meter) -> Attempt {
    let before = (meter.reset)();
    let begin = Instant::now();
    let valid = catch_unwind(AssertUnwindSafe(|| (parser.parse)(bytes)));
    let time = begin.elapsed();
    let memory = (meter.peak)().saturating_sub(before + bytes.len());
    let valid = valid.map_err(|_| PANIC.lock().unwrap_or_else(PoisonError::into_inner).clone());
    Attempt { valid, time, memory }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RANGE: Range = Range { first: 0, count: 3, seed: 1 };

    fn finds(parse: fn(&[u8]) -> bool, peak: fn() -> usize) -> Vec<String> {
        let parser = Parser::new("a", vec![vec![1, 2, 3]], parse);
        let report = run(&parser, RANGE, Meter { reset: || 0, peak }, |_| {});
        assert_eq!(report.inputs, 3);
        report.finds.into_iter().map(|find| find.what).collect()
    }

    /// The harness sees what it is there to see.
    #[test]
    fn panics_time_and_memory_are_found() {
        let hook = std::panic::take_hook();
        catch_panics();
        let panics = finds(|bytes| bytes.len() > usize::MAX - 1 || panic!("found"), || 0);
        std::panic::set_hook(hook);
        assert!(
            panics.len() == 3 && panics[0].contains("run.rs") && panics[0].contains("found"),
            "{panics:?}"
        );
        assert_eq!(finds(|_| true, || 300 << 20).len(), 3);
        let slow = |_: &[u8]| {
            std::thread::sleep(LONGEST_TIME + Duration::from_millis(10));
            true
        };
        assert_eq!(finds(slow, || 0), ["1.0 s"; 3]);
        assert!(finds(|_| true, || 1 << 20).is_empty());
    }

    #[test]
    fn an_input_depends_on_seed_and_number_alone() {
        let parser = Parser::new("a", vec![b"one 1 two 2".to_vec(), vec![7; 40]], |_| true);
        let of = |seed| (0..50).map(|number| input_of(&parser, seed, number)).collect::<Vec<_>>();
        assert_eq!(of(1), of(1));
        assert_ne!(of(1), of(2));
    }
}
