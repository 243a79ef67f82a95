//! What a command says on stdout.

/// Prints a finished result; everything else goes to stderr.
#[allow(clippy::print_stdout, reason = "the one place for it")]
pub fn say(text: &str) {
    print!("{text}");
}
