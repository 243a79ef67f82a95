//! Programs for other controls: with `patchmill plan --dialect`, or later, from a plan's folder, with `patchmill dialect`.

use patchmill_machine_interface::dialect::{self, Dialect, ProvenText};
use patchmill_machine_interface::execution::sha256_hex;
use patchmill_products::program::Program;

use crate::options::{DialectOption, DialectOptions};
use crate::output_folder::{OutputFolder, replace};
use crate::plan_folder::PlanFolder;
use crate::stdout::say;
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
    let sha256 = sha256_hex(&program.text);
    let proven =
        ProvenText { text: &program.text, sha256: &sha256, machine_urdf: &program.machine_urdf, tool_length };
    let one = |dialect: &Dialect| {
        let text = dialect::write(*dialect, &proven).map_err(|e| format!("{}: {e}", dialect.file()))?;
        folder.write(dialect.file(), text.as_bytes())?;
        let sha256 = sha256_hex(&text);
        Ok(ProgramFile { dialect: dialect.name(), file: dialect.file(), sha256 })
    };
    wanted.iter().map(one).collect()
}

/// `patchmill dialect`: reads a plan's folder and writes its program for other controls into it.
///
/// # Errors
/// With one sentence: files that are missing or cannot be read, a program or machine that is not the one the summary speaks of.
pub fn dialect(options: &DialectOptions) -> Result<(), String> {
    let wanted = DialectOption::wanted(&options.to);
    if wanted.is_empty() {
        return Err(
            "program.ngc is the program for linuxcnc; expected --to siemens, heidenhain or fanuc".to_owned()
        );
    }
    let plan = PlanFolder::read(&options.plan)?;
    let proven = ProvenText {
        text: &plan.program,
        sha256: &plan.program_sha256,
        machine_urdf: &plan.machine_urdf,
        tool_length: plan.tool_length,
    };
    for dialect in wanted {
        let text = dialect::write(dialect, &proven)
            .map_err(|e| format!("{}: {e}", options.plan.join("program.ngc").display()))?;
        let place = options.plan.join(dialect.file());
        replace(&place, text.as_bytes())?;
        say(&format!("written: {}\n", place.display()))?;
    }
    Ok(())
}
