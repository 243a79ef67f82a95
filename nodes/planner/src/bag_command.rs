//! `patchmill bag`: what a killed recorder left is made whole.

use std::borrow::Cow;

use serde::Serialize;

use crate::options::BagCommand;
use crate::replay::recorded::meant;
use crate::stdout::{say, say_json};

/// What `--json` prints.
#[derive(Serialize)]
struct Document<'a> {
    bag: Cow<'a, str>,
    messages: u64,
    files: usize,
    /// Files that were written anew.
    rewritten: &'a [String],
}

/// Does it and prints one line.
///
/// # Errors
/// When the bag cannot be repaired.
pub fn bag(command: &BagCommand) -> Result<(), String> {
    let BagCommand::Repair { directory, json } = command;
    let repaired =
        patchmill_bag_recorder::repair(directory).map_err(|e| format!("{}{}", e.text, meant(directory)))?;
    let summary = &repaired.summary;
    if *json {
        return say_json(&Document {
            bag: directory.to_string_lossy(),
            messages: summary.message_count,
            files: summary.files.len(),
            rewritten: &repaired.rewritten,
        });
    }
    let done = match repaired.rewritten.as_slice() {
        [] => "nothing was missing".to_owned(),
        files => format!("written anew: {}", files.join(", ")),
    };
    say(&format!(
        "bag {}: {} messages in {} files; {done}\n",
        directory.display(),
        summary.message_count,
        summary.files.len()
    ))
}
