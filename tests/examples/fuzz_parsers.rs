//! Feeds mutated inputs to the parsers: `cargo run --release -p patchmill_tests --example fuzz_parsers -- PARSER COUNT [--seed N]`.
//!
//! Inputs run in a process of their own, whose end (a stack that overflows, memory that is not there, ten seconds without
//! an answer) is a find too. Finds are written to `target/fuzz/PARSER-NUMBER.bin`; one JSON line a parser goes to stdout.
#![allow(clippy::print_stdout, clippy::print_stderr, reason = "a command line program")]

use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use patchmill_tests::fuzz::run::{Find, Meter, Range, Report, attempt, catch_panics, input_of, run};
use patchmill_tests::fuzz::{Parser, messages, parsers};
use peak_alloc::PeakAlloc;

#[global_allocator]
static PEAK: PeakAlloc = PeakAlloc;

const USAGE: &str =
    "usage: fuzz_parsers PARSER|messages|all COUNT [--seed N] | fuzz_parsers list | fuzz_parsers PARSER FILE
COUNT inputs for each parser; `messages`: every message type; FILE: one input, such as a find";
/// Inputs that one process runs.
const PER_PROCESS: u64 = 100_000;
/// An input that takes longer ends its process.
const PATIENCE: Duration = Duration::from_secs(10);
/// Finds after which a parser is given up.
const ENOUGH: usize = 40;

type Outcome<T> = Result<T, Box<dyn std::error::Error>>;

fn main() -> Outcome<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let scratch = parsers::scratch()?;
    match words.as_slice() {
        ["list"] => all(scratch.path()).map(|all| all.iter().for_each(|p| println!("{}", p.name))),
        ["range", name, first, count, seed, mark] => {
            let range = Range { first: first.parse()?, count: count.parse()?, seed: seed.parse()? };
            one_range(&named(name, scratch.path())?, range, mark.as_ref())
        }
        [names, count, rest @ ..] if count.parse::<u64>().is_ok() => {
            let seed = match rest {
                [] => 1,
                ["--seed", seed] => seed.parse()?,
                _ => return Err(USAGE.into()),
            };
            let chosen = |p: &Parser| {
                *names == "all" || p.name == *names || (*names == "messages" && p.name.contains('/'))
            };
            let parsers: Vec<Parser> = all(scratch.path())?.into_iter().filter(chosen).collect();
            if parsers.is_empty() {
                return Err(format!("there is no parser {names}\n{USAGE}").into());
            }
            for parser in parsers {
                let report = all_ranges(&parser, count.parse()?, seed, scratch.path())?;
                println!("{}", serde_json::to_string(&report)?);
            }
            Ok(())
        }
        [name, file] => one_file(&named(name, scratch.path())?, file.as_ref()),
        _ => Err(USAGE.into()),
    }
}

fn all(scratch: &Path) -> Outcome<Vec<Parser>> {
    parsers::parsers(&messages::recorded()?, scratch)
}

fn named(name: &str, scratch: &Path) -> Outcome<Parser> {
    all(scratch)?
        .into_iter()
        .find(|p| p.name == name)
        .ok_or_else(|| format!("there is no parser {name}").into())
}

fn meter() -> Meter {
    fn reset() -> usize {
        PEAK.reset_peak_usage();
        PEAK.current_usage()
    }
    Meter { reset, peak: || PEAK.peak_usage() }
}

/// What the nodes' own threads have: one, with a stack of 2 MiB.
fn on_a_small_stack<T: Send>(work: impl FnOnce() -> T + Send) -> Outcome<T> {
    Ok(rayon::ThreadPoolBuilder::new().num_threads(1).stack_size(2 << 20).build()?.install(work))
}

/// The child's work: a range, its report to stdout, the number of the input at hand into the file `mark`.
fn one_range(parser: &Parser, range: Range, mark: &Path) -> Outcome<()> {
    let mark = std::fs::File::create(mark)?;
    let begun = AtomicU64::new(0);
    let start = Instant::now();
    let report = std::thread::scope(|threads| {
        threads.spawn(|| watch(&begun, start));
        let report = on_a_small_stack(|| {
            catch_panics();
            run(parser, range, meter(), |number| {
                // Without it a dead process does not tell its last input; there is nobody to tell that it failed.
                let _ = mark.write_at(&number.to_le_bytes(), 0);
                begun.store(start.elapsed().as_millis() as u64, Ordering::Relaxed);
            })
        });
        begun.store(u64::MAX, Ordering::Relaxed);
        report
    })?;
    println!("{}", serde_json::to_string(&report)?);
    Ok(())
}

/// Ends the process when an input takes too long.
fn watch(begun: &AtomicU64, start: Instant) {
    loop {
        std::thread::sleep(Duration::from_millis(100));
        let since = begun.load(Ordering::Relaxed);
        if since == u64::MAX {
            return;
        }
        if start.elapsed().saturating_sub(Duration::from_millis(since)) > PATIENCE {
            eprintln!("no answer within {} s", PATIENCE.as_secs());
            std::process::exit(1);
        }
    }
}

/// All inputs of a parser, in processes one after the other.
fn all_ranges(parser: &Parser, count: u64, seed: u64, scratch: &Path) -> Outcome<Report> {
    let mut report = Report { parser: parser.name.clone(), ..Report::default() };
    let mut left: Vec<Range> = (0..count.div_ceil(PER_PROCESS))
        .rev()
        .map(|k| Range { first: k * PER_PROCESS, count: PER_PROCESS, seed })
        .collect();
    if let Some(last) = left.first_mut() {
        last.count = count - last.first;
    }
    while let Some(range) = left.pop().filter(|_| report.finds.len() < ENOUGH) {
        match in_child(parser, range, scratch)? {
            Ok(part) => report.add(part),
            Err(find) => {
                // The report went with the process: what came before the find once more, then what comes after it.
                let after = find.number + 1;
                left.push(Range { first: after, count: range.first + range.count - after, seed });
                left.push(Range { first: range.first, count: find.number - range.first, seed });
                report.add(Report { inputs: 1, finds: vec![find], ..Report::default() });
            }
        }
    }
    for find in &report.finds {
        keep(parser, seed, find)?;
    }
    Ok(report)
}

/// A range in a process of its own; the input that ended it.
fn in_child(parser: &Parser, range: Range, scratch: &Path) -> Outcome<Result<Report, Find>> {
    let mark = scratch.join("mark");
    // Of the range before: a child that does not get as far as its first input is no find.
    if mark.exists() {
        std::fs::remove_file(&mark)?;
    }
    let numbers = [range.first, range.count, range.seed].map(|n| n.to_string());
    let mut command = Command::new(std::env::current_exe()?);
    command.arg("range").arg(&parser.name).args(numbers).arg(&mark).stderr(Stdio::piped());
    let output = command.output()?;
    if output.status.success() {
        return Ok(Ok(serde_json::from_slice(&output.stdout)?));
    }
    let said = String::from_utf8_lossy(&output.stderr);
    let said: Vec<&str> = said.lines().filter(|line| !line.is_empty()).collect();
    let what = format!("{}: {}", output.status, said.join(" ").chars().take(300).collect::<String>());
    let mut number = [0; 8];
    std::fs::File::open(&mark)
        .and_then(|file| file.read_exact_at(&mut number, 0))
        .map_err(|_| what.clone())?;
    Ok(Err(Find { number: u64::from_le_bytes(number), what }))
}

fn keep(parser: &Parser, seed: u64, find: &Find) -> Outcome<()> {
    let folder = PathBuf::from("target/fuzz");
    std::fs::create_dir_all(&folder)?;
    let file = folder.join(format!("{}-{}.bin", parser.name.replace('/', "."), find.number));
    Ok(std::fs::write(file, input_of(parser, seed, find.number))?)
}

/// One input, such as a find.
fn one_file(parser: &Parser, file: &Path) -> Outcome<()> {
    let bytes = std::fs::read(file)?;
    catch_panics();
    let tried = on_a_small_stack(|| attempt(parser, &bytes, meter()))?;
    println!(
        "{:?}, {:.1} ms, {:.1} MiB beyond its {} bytes",
        tried.valid,
        tried.time.as_secs_f64() * 1e3,
        tried.memory as f64 / f64::from(1 << 20),
        bytes.len()
    );
    Ok(())
}
