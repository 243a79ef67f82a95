//! The repository's texts.

use std::path::{Path, PathBuf};

/// The repository's folder.
///
/// # Panics
/// When it is not there.
pub fn repository() -> PathBuf {
    match Path::new(env!("CARGO_MANIFEST_DIR")).join("..").canonicalize() {
        Ok(folder) => folder,
        Err(e) => panic!("the repository: {e}"),
    }
}

/// All Markdown files of the repository but the vendored ones, in order.
///
/// # Panics
/// When a folder cannot be read.
pub fn texts() -> Vec<PathBuf> {
    let mut found = vec![repository().join("README.md")];
    let mut folders: Vec<PathBuf> =
        ["nodes", "msgs", "launch_scripts", "tests"].map(|folder| repository().join(folder)).to_vec();
    while let Some(folder) = folders.pop() {
        for path in entries(&folder) {
            if path.is_dir() && !path.ends_with("rustdds") {
                folders.push(path);
            } else if path.extension().is_some_and(|e| e == "md") {
                found.push(path);
            }
        }
    }
    found.sort();
    found
}

/// What a folder holds.
///
/// # Panics
/// When it cannot be read.
pub fn entries(folder: &Path) -> Vec<PathBuf> {
    match std::fs::read_dir(folder) {
        Ok(entries) => entries.flatten().map(|entry| entry.path()).collect(),
        Err(e) => panic!("{}: {e}", folder.display()),
    }
}
