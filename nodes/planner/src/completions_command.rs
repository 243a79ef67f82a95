//! `patchmill completions`: what a shell has to know to complete the command's words.

use clap::CommandFactory;
use clap_complete::{Shell, generate};

use crate::options::{CommandLine, CompletionsOptions, ShellOption};
use crate::stdout::say;

/// Prints the completions of a shell.
///
/// # Errors
/// When they cannot be written.
pub fn completions(options: &CompletionsOptions) -> Result<(), String> {
    say(&script(options.shell))
}

fn script(shell: ShellOption) -> String {
    let shell = match shell {
        ShellOption::Bash => Shell::Bash,
        ShellOption::Zsh => Shell::Zsh,
        ShellOption::Fish => Shell::Fish,
    };
    let mut script = Vec::new();
    generate(shell, &mut CommandLine::command(), "patchmill", &mut script);
    String::from_utf8_lossy(&script).into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_shell_learns_every_subcommand_and_its_options() {
        for shell in [ShellOption::Bash, ShellOption::Zsh, ShellOption::Fish] {
            let script = script(shell);
            for word in ["doctor", "linuxcnc-config", "gouge-tolerance", "rolling-ball"] {
                assert!(script.contains(word), "{shell:?}: {word}");
            }
        }
    }
}
