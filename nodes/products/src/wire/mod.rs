//! The products as messages, both ways. Nothing comes in or goes out unchecked: numbers are finite, directions are unit,
//! indices in range, arrays of equal length.
//!
//! A large product travels as a manifest and numbered chunks ([`chunked`]), the others as one message with `to_msg`
//! and `from_msg`. What a message says of its origin is a [`Provenance`].

mod check;
pub mod chunked;
pub mod evaluation;
pub mod field;
mod hash;
pub mod job;
mod joint_trajectory;
pub mod mesh;
pub mod partition;
mod patch_plan;
pub mod program;
pub mod provenance;
pub mod residual;
pub mod samples;
mod selection;
#[cfg(test)]
mod tests;
mod tool;
pub mod toolpath;
pub mod trajectory;
mod vectors;

use std::fmt;

pub use chunked::{Assembly, Chunked, Key, MAX_CHUNK_BYTES, MAX_CHUNKS};
pub use provenance::Provenance;

use crate::stage::StageError;

/// Why a message is no valid product or a product must not be sent: one sentence of what, where, what was expected.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct WireError {
    /// For a person to read.
    pub text: String,
}

impl WireError {
    /// An error with its text.
    pub fn new(text: impl Into<String>) -> Self {
        Self { text: text.into() }
    }

    /// The same as a stage's error, with the stage's own code.
    pub fn with_code(self, code: i32) -> StageError {
        StageError::new(code, self.text)
    }
}

impl fmt::Display for WireError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

impl std::error::Error for WireError {}
