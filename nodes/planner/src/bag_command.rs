//! `patchmill bag`: what a killed recorder left is made whole.

use crate::options::BagCommand;

/// Does it and prints one line.
///
/// # Errors
/// When the bag cannot be repaired.
#[allow(clippy::print_stdout)]
pub fn bag(command: &BagCommand) -> Result<(), String> {
    let BagCommand::Repair { directory } = command;
    let repaired = patchmill_bag_recorder::repair(directory).map_err(|e| e.text)?;
    let summary = &repaired.summary;
    let done = match repaired.rewritten.as_slice() {
        [] => "nothing was missing".to_owned(),
        files => format!("written anew: {}", files.join(", ")),
    };
    println!(
        "bag {}: {} messages in {} files; {done}",
        directory.display(),
        summary.message_count,
        summary.files.len()
    );
    Ok(())
}
