//! What is wanted of a run, from any thread.

use super::ABORTED;
use patchmill_products::stage::StageError;
use std::sync::atomic::{AtomicBool, Ordering};

/// What is wanted of a run, from any thread.
#[derive(Debug, Default)]
pub struct Orders {
    hold: AtomicBool,
    abort: AtomicBool,
}

impl Orders {
    /// Holds or resumes.
    pub fn set_hold(&self, hold: bool) {
        self.hold.store(hold, Ordering::Relaxed);
    }

    /// Ends the run.
    pub fn abort(&self) {
        self.abort.store(true, Ordering::Relaxed);
    }

    /// Whether the run is to be on hold.
    pub fn wants_hold(&self) -> bool {
        self.hold.load(Ordering::Relaxed)
    }

    /// Whether the run is to end.
    pub fn wants_abort(&self) -> bool {
        self.abort.load(Ordering::Relaxed)
    }

    /// For whoever makes a machine ready.
    ///
    /// # Errors
    /// [`ABORTED`] when the run is to end.
    pub fn go_on(&self) -> Result<(), StageError> {
        if self.wants_abort() {
            return Err(StageError::new(ABORTED, "the run was aborted before the program's start"));
        }
        Ok(())
    }
}
