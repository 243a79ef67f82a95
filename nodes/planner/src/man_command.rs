//! `patchmill man`: manual pages, made from the options themselves.

use clap::{Command, CommandFactory};
use clap_mangen::{Man, generate_to};

use crate::options::{CommandLine, ManOptions};
use crate::stdout::say;

/// Prints a page, or writes all.
///
/// # Errors
/// With one sentence: there is no such subcommand, or the folder cannot be written.
pub fn man(options: &ManOptions) -> Result<(), String> {
    let Some(folder) = &options.out else {
        say(&page(&options.subcommand)?);
        return Ok(());
    };
    let written = std::fs::create_dir_all(folder).and_then(|()| generate_to(CommandLine::command(), folder));
    written.map_err(|e| format!("{}: {e}; expected a folder that can be written", folder.display()))?;
    say(&format!("written: {}\n", folder.display()));
    Ok(())
}

/// The page of a subcommand by its words, in roff.
fn page(words: &[String]) -> Result<String, String> {
    let mut root = CommandLine::command();
    root.build();
    let mut command = &root;
    for word in words {
        command = command.find_subcommand(word).ok_or_else(|| {
            let known: Vec<&str> = command.get_subcommands().map(Command::get_name).collect();
            format!("there is no subcommand `{word}`; expected one of {}", known.join(", "))
        })?;
    }
    let source = concat!("patchmill ", env!("CARGO_PKG_VERSION"));
    let mut text = Vec::new();
    let rendered = Man::new(command.clone()).source(source).render(&mut text);
    rendered.map_err(|e| format!("the manual page: {e}"))?;
    Ok(String::from_utf8_lossy(&text).into_owned())
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
