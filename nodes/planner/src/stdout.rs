//! What a command says on stdout.

use std::io::{self, ErrorKind, Write};

use serde::Serialize;

/// Prints a finished result; everything else goes to stderr.
///
/// # Errors
/// When it cannot be written, as onto a full disk.
pub fn say(text: &str) -> Result<(), String> {
    said(to(&mut anstream::stdout(), text))
}

/// Prints what clap answers, to `--help` too.
///
/// # Errors
/// As [`say`].
pub fn say_usage(usage: &clap::Error) -> Result<(), String> {
    let printed = usage.print().and_then(|()| io::stdout().flush());
    // What is wrong with a command line goes to stderr, and its exit code tells it too.
    if usage.use_stderr() { Ok(()) } else { said(printed) }
}

/// Prints the one JSON document of `--json`.
///
/// # Errors
/// As [`say`].
pub fn say_json(document: &impl Serialize) -> Result<(), String> {
    let text = serde_json::to_string_pretty(document).map_err(|e| format!("the JSON document: {e}"))?;
    say(&format!("{text}\n"))
}

/// To the end: what waits in a buffer is lost without a word when the process ends.
fn to(out: &mut impl Write, text: &str) -> io::Result<()> {
    out.write_all(text.as_bytes())?;
    out.flush()
}

fn said(written: io::Result<()>) -> Result<(), String> {
    match written {
        // A reader that has gone, such as `head`, has what it wanted.
        Err(e) if e.kind() != ErrorKind::BrokenPipe => {
            Err(format!("the standard output cannot be written: {e}"))
        }
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs::OpenOptions;

    #[test]
    fn what_is_lost_is_told_and_a_reader_that_has_gone_is_not() {
        let full = OpenOptions::new().write(true).open("/dev/full").unwrap();
        // As stdout: the end of a text without an end of line waits in a buffer.
        let error = said(to(&mut io::LineWriter::new(full), "a text")).unwrap_err();
        assert!(error.contains("standard output") && error.contains("No space left on device"), "{error}");
        let (reader, mut writer) = io::pipe().unwrap();
        drop(reader);
        assert_eq!(said(to(&mut writer, "a text")), Ok(()));
    }
}
