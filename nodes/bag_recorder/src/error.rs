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
}

impl fmt::Display for BagError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

impl std::error::Error for BagError {}
