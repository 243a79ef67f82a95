//! What a command says on stdout.

use std::io::Write;

use serde::Serialize;

/// Prints a finished result; everything else goes to stderr.
pub fn say(text: &str) {
    // A reader that has gone, such as `head`, has what it wanted.
    let _ = anstream::stdout().write_all(text.as_bytes());
}

/// Prints the one JSON document of `--json`.
///
/// # Errors
/// None that can be expected: the data are plain.
pub fn say_json(document: &impl Serialize) -> Result<(), String> {
    let text = serde_json::to_string_pretty(document).map_err(|e| format!("the JSON document: {e}"))?;
    say(&format!("{text}\n"));
    Ok(())
}
