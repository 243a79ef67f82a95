//! A sample of `tests/benches/fuzz.sh`: every parser against thousands of mutated inputs.
#![allow(clippy::unwrap_used, reason = "a test's own helpers may fail like the test")]

use patchmill_tests::fuzz::run::{Meter, Range, catch_panics, run};
use patchmill_tests::fuzz::{messages, parsers};
use peak_alloc::PeakAlloc;

#[global_allocator]
static PEAK: PeakAlloc = PeakAlloc;

/// Inputs for each parser.
const COUNT: u64 = 20_000;
/// Inputs for those that take milliseconds for one.
const FEW: u64 = 500;
const SLOW: [&str; 4] = ["urdf", "step_mesh", "options", "job_file"];
/// Another one than the script's.
const SEED: u64 = 20_261_123;

#[test]
fn no_mutated_input_panics_hangs_or_fills_the_memory() {
    fn reset() -> usize {
        PEAK.reset_peak_usage();
        PEAK.current_usage()
    }
    let meter = Meter { reset, peak: || PEAK.peak_usage() };
    let scratch = parsers::scratch().unwrap();
    let parsers = parsers::parsers(&messages::recorded().unwrap(), scratch.path()).unwrap();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).stack_size(2 << 20).build().unwrap();
    let mut finds = Vec::new();
    let hook = std::panic::take_hook();
    catch_panics();
    for parser in &parsers {
        let count = if SLOW.contains(&parser.name.as_str()) { FEW } else { COUNT };
        let range = Range { first: 0, count, seed: SEED };
        let report = pool.install(|| run(parser, range, meter, |_| {}));
        finds.extend(
            report.finds.into_iter().map(|find| format!("{} {}: {}", parser.name, find.number, find.what)),
        );
    }
    std::panic::set_hook(hook);
    assert!(finds.is_empty(), "with --seed {SEED}: {finds:#?}");
}
