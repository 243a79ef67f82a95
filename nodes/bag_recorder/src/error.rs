//! What can go wrong with a bag.

use std::fmt;
use std::path::Path;

/// Why a bag cannot be written or read: one sentence with the file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BagError {
    /// For a person to read.
    pub text: String,
}

impl BagError {
    pub(crate) fn at(path: &Path, reason: impl fmt::Display) -> Self {
        Self { text: format!("bag {}: {reason}", path.display()) }
    }

    /// With what lies behind: an MCAP error alone does not say that the disk is full.
    pub(crate) fn mcap(path: &Path, error: &mcap::McapError) -> Self {
        match error {
            mcap::McapError::Io(io) => Self::at(path, io),
            other => Self::at(path, other),
        }
    }
}

impl fmt::Display for BagError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

impl std::error::Error for BagError {}
