//! Generates the Rust types of this package's interfaces and of the standard messages that they use.
//!
//! Input: `msg/*.msg`, `srv/*.srv`, `action/*.action` and `standard/<package>/msg/*.msg`. Output:
//! `$OUT_DIR/interfaces.rs`, which `src/lib.rs` includes.

// Cargo listens to what a build script prints.
#![allow(clippy::print_stdout)]

mod emit;
mod hash;
mod parse;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::{env, fs};

use parse::Section;

/// This package's name in ROS.
const PACKAGE: &str = "patchmill_msgs";

/// Everything that was read, in the order of names.
#[derive(Default)]
pub struct Interfaces {
    /// (package, name) → message.
    pub messages: BTreeMap<(String, String), Section>,
    /// name → request, response.
    pub services: BTreeMap<String, [Section; 2]>,
    /// name → goal, result, feedback.
    pub actions: BTreeMap<String, [Section; 3]>,
}

fn main() {
    for folder in ["build", "msg", "srv", "action", "standard"] {
        println!("cargo::rerun-if-changed={folder}");
    }
    if let Err(error) = generate() {
        println!("cargo::error={error}");
        std::process::exit(1);
    }
}

fn generate() -> Result<(), String> {
    let root = PathBuf::from(env::var("CARGO_MANIFEST_DIR").map_err(|e| e.to_string())?);
    let mut interfaces = Interfaces::default();
    read_messages(&root.join("msg"), PACKAGE, &mut interfaces)?;
    for (package, path) in entries(&root.join("standard"))?.into_iter().filter(|(_, path)| path.is_dir()) {
        read_messages(&path.join("msg"), &package, &mut interfaces)?;
    }
    for (name, path) in files(&root.join("srv"), "srv")? {
        interfaces.services.insert(name.clone(), sections(&path, PACKAGE)?);
    }
    for (name, path) in files(&root.join("action"), "action")? {
        interfaces.actions.insert(name.clone(), sections(&path, PACKAGE)?);
    }
    let out = PathBuf::from(env::var("OUT_DIR").map_err(|e| e.to_string())?).join("interfaces.rs");
    fs::write(&out, emit::rust(PACKAGE, &interfaces)?).map_err(|e| format!("{}: {e}", out.display()))
}

fn read_messages(folder: &Path, package: &str, interfaces: &mut Interfaces) -> Result<(), String> {
    for (name, path) in files(folder, "msg")? {
        let [section] = sections(&path, package)?;
        interfaces.messages.insert((package.to_owned(), name), section);
    }
    Ok(())
}

/// The file's sections between lines of `---`, exactly `N` of them.
fn sections<const N: usize>(path: &Path, package: &str) -> Result<[Section; N], String> {
    let text = fs::read_to_string(path).map_err(|e| format!("{}: {e}", path.display()))?;
    let mut first_line = 1;
    let mut sections = Vec::new();
    for part in text.split("\n---\n") {
        sections.push(Section::parse(part, package, path, first_line)?);
        first_line += part.lines().count() + 1;
    }
    sections
        .try_into()
        .map_err(|s: Vec<_>| format!("{}: {} sections where {N} were expected", path.display(), s.len()))
}

/// (stem, path) of the files with that extension, by name.
fn files(folder: &Path, extension: &str) -> Result<Vec<(String, PathBuf)>, String> {
    let mut found = entries(folder)?;
    found.retain(|(_, path)| path.extension().is_some_and(|e| e == extension));
    Ok(found)
}

/// (stem, path) of everything in a folder, by name.
fn entries(folder: &Path) -> Result<Vec<(String, PathBuf)>, String> {
    let message = |e: std::io::Error| format!("{}: {e}", folder.display());
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).map_err(message)? {
        let path = entry.map_err(message)?.path();
        let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        found.push((stem, path));
    }
    found.sort();
    Ok(found)
}
