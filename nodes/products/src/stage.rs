//! What every stage function takes and returns beside its products: cancellation, progress, errors.

use std::fmt;
use std::sync::atomic::{AtomicBool, Ordering};

/// Why a stage gave up: a numeric code in the stage's own hundred and one clear sentence
/// (what, where, what was expected).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StageError {
    /// 1xx surface_ingestion, 2xx rolling_ball_analysis, 3xx surface_partitioning, 4xx path_generation,
    /// 5xx machine_interface, 6xx planner, 7xx bag_recorder.
    pub code: i32,
    /// For a person to read.
    pub text: String,
}

/// Code of a stage whose work was cancelled or superseded by a newer job.
pub const SUPERSEDED: i32 = 1;

impl StageError {
    /// An error with its code and text.
    pub fn new(code: i32, text: impl Into<String>) -> Self {
        Self { code, text: text.into() }
    }
}

impl fmt::Display for StageError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} (code {})", self.text, self.code)
    }
}

impl std::error::Error for StageError {}

/// How a running stage hears of cancellation and tells how far it is.
#[derive(Clone, Copy)]
pub struct Progress<'a> {
    /// Set by the node when the job is cancelled or superseded.
    pub cancelled: &'a AtomicBool,
    /// Called with the done fraction, 0..1, from any thread.
    pub report: &'a (dyn Fn(f64) + Sync),
}

impl Progress<'_> {
    /// `Err(SUPERSEDED)` once the work is no longer wanted. Cheap: call it in every outer loop.
    ///
    /// # Errors
    /// With code [`SUPERSEDED`] when cancelled.
    pub fn check(&self) -> Result<(), StageError> {
        if self.cancelled.load(Ordering::Relaxed) {
            return Err(StageError::new(SUPERSEDED, "the job was cancelled or superseded by a newer one"));
        }
        Ok(())
    }
}

/// A progress that is never cancelled and reports to nobody, for tests and benches.
pub fn unobserved() -> Progress<'static> {
    static NEVER: AtomicBool = AtomicBool::new(false);
    Progress { cancelled: &NEVER, report: &|_| {} }
}
