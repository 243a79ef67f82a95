//! Programs for other controls: with `patchmill plan --dialect`, or later, from a plan's folder, with `patchmill dialect`.

use std::fs;
use std::path::Path;

use patchmill_machine_interface::dialect::{self, Dialect, ProvenText};
use patchmill_products::program::Program;
use serde_json::Value;
use sha2::{Digest, Sha256};

use crate::options::{DialectOption, DialectOptions};
use crate::output_folder::OutputFolder;
use crate::summary::ProgramFile;

/// Writes the wanted dialects of a program into the folder of its plan.
///
/// # Errors
/// When one cannot be written.
pub fn write_dialects(
    wanted: &[Dialect],
    program: &Program,
    tool_length: f64,
    folder: &OutputFolder,
) -> Result<Vec<ProgramFile>, String> {
    let sha256 = sha256_of(program.text.as_bytes());
    let proven =
        ProvenText { text: &program.text, sha256: &sha256, machine_urdf: &program.machine_urdf, tool_length };
    let one = |dialect: &Dialect| {
        let text = dialect::write(*dialect, &proven).map_err(|e| format!("{}: {e}", dialect.file()))?;
        folder.write(dialect.file(), text.as_bytes())?;
        let sha256 = sha256_of(text.as_bytes());
        Ok(ProgramFile { dialect: dialect.name(), file: dialect.file(), sha256 })
    };
    wanted.iter().map(one).collect()
}

/// `patchmill dialect`: reads a plan's folder and writes its program for other controls into it.
///
/// # Errors
/// With one sentence: files that are missing or cannot be read, a program that is not the one the summary speaks of.
#[allow(clippy::print_stdout)]
pub fn dialect(options: &DialectOptions) -> Result<(), String> {
    let wanted = DialectOption::wanted(&options.to);
    if wanted.is_empty() {
        return Err(
            "program.ngc is the program for linuxcnc; expected --to siemens, heidenhain or fanuc".to_owned()
        );
    }
    let plan = Plan::read(&options.plan)?;
    let proven = ProvenText {
        text: &plan.text,
        sha256: &plan.sha256,
        machine_urdf: &plan.machine_urdf,
        tool_length: plan.tool_length,
    };
    for dialect in wanted {
        let text = dialect::write(dialect, &proven)
            .map_err(|e| format!("{}: {e}", options.plan.join("program.ngc").display()))?;
        let place = options.plan.join(dialect.file());
        replace(&place, text.as_bytes())?;
        println!("written: {}", place.display());
    }
    Ok(())
}

/// What a dialect needs of a plan's folder.
struct Plan {
    text: String,
    sha256: String,
    machine_urdf: String,
    tool_length: f64,
}

impl Plan {
    fn read(folder: &Path) -> Result<Self, String> {
        let read = |name: &str| {
            let path = folder.join(name);
            fs::read_to_string(&path).map_err(|e| format!("{}: {e}", path.display()))
        };
        let (text, machine_urdf, summary) =
            (read("program.ngc")?, read("machine.urdf")?, read("summary.json")?);
        let say = |what: String| format!("{}: {what}", folder.join("summary.json").display());
        let summary: Value = serde_json::from_str(&summary).map_err(|e| say(e.to_string()))?;
        let named =
            summary["program_sha256"].as_str().ok_or_else(|| say("it has no program_sha256".to_owned()))?;
        let length = summary["tool"]["length_mm"].as_f64().filter(|l| l.is_finite() && *l > 0.0);
        let length = length.ok_or_else(|| say("it has no tool.length_mm above 0".to_owned()))?;
        let sha256 = sha256_of(text.as_bytes());
        if sha256 != named {
            return Err(format!(
                "{}: it is not the program that was proven: its sha256 is {sha256}, summary.json names {named}",
                folder.join("program.ngc").display()
            ));
        }
        Ok(Self { text, sha256, machine_urdf, tool_length: length / 1e3 })
    }
}

/// Writes a file beside its place and moves it there, so that the place never holds half a program.
fn replace(place: &Path, content: &[u8]) -> Result<(), String> {
    let say = |e: std::io::Error| format!("cannot write {}: {e}", place.display());
    let beside = place.with_extension(format!("patchmill-{}", std::process::id()));
    let written = fs::write(&beside, content).and_then(|()| fs::rename(&beside, place));
    written.map_err(|e| {
        // Nothing half-written stays; that this may fail too changes nothing.
        let _ = fs::remove_file(&beside);
        say(e)
    })
}

fn sha256_of(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect()
}
