//! `patchmill man`: manual pages, made from the options themselves.

use std::path::Path;

use clap::{Command, CommandFactory};
use clap_mangen::Man;

use crate::options::{CommandLine, ManOptions};
use crate::output_folder::replace;
use crate::stdout::say;

/// Prints a page, or writes all.
///
/// # Errors
/// With one sentence: there is no such subcommand, or the folder cannot be written.
pub fn man(options: &ManOptions) -> Result<(), String> {
    let Some(folder) = &options.out else {
        return say(&page(&options.subcommand)?);
    };
    std::fs::create_dir_all(folder)
        .map_err(|e| format!("{}: {e}; expected a folder that can be written", folder.display()))?;
    write(&built(), folder)?;
    say(&format!("written: {}\n", folder.display()))
}

/// The command with all that clap adds; `help` is no subcommand of its own.
fn built() -> Command {
    let mut root = CommandLine::command().disable_help_subcommand(true);
    root.build();
    root
}

fn man_of(command: &Command) -> Man {
    Man::new(command.clone()).source(concat!("patchmill ", env!("CARGO_PKG_VERSION")))
}

/// The pages of a command and of all below it.
fn write(command: &Command, folder: &Path) -> Result<(), String> {
    let man = man_of(command);
    replace(&folder.join(man.get_filename()), &rendered(&man)?)?;
    command.get_subcommands().try_for_each(|below| write(below, folder))
}

/// The page of a subcommand by its words, in roff.
fn page(words: &[String]) -> Result<String, String> {
    let root = built();
    let mut command = &root;
    for word in words {
        command = command.find_subcommand(word).ok_or_else(|| {
            let known: Vec<&str> = command.get_subcommands().map(Command::get_name).collect();
            format!("there is no subcommand `{word}`; expected one of {}", known.join(", "))
        })?;
    }
    Ok(String::from_utf8_lossy(&rendered(&man_of(command))?).into_owned())
}

fn rendered(man: &Man) -> Result<Vec<u8>, String> {
    let mut text = Vec::new();
    man.render(&mut text).map_err(|e| format!("the manual page: {e}"))?;
    Ok(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn page_of(words: &str) -> Result<String, String> {
        page(&words.split_whitespace().map(str::to_owned).collect::<Vec<_>>())
    }

    #[test]
    fn pages_are_those_of_the_subcommands() {
        let whole = page_of("").unwrap();
        assert!(whole.contains(".TH patchmill 1") && whole.contains("doctor"), "{whole}");
        let plan = page_of("plan").unwrap();
        assert!(plan.contains(".TH patchmill-plan 1") && plan.contains("gouge\\-tolerance"), "{plan}");
        assert!(page_of("bag repair").unwrap().contains("patchmill-bag-repair"));
        assert!(page_of("plna").unwrap_err().contains("compare"));
    }
}
