//! YAML from others: within bounds, before memory is taken.

use std::path::Path;

use yaml_rust2::parser::{Event, Parser};
use yaml_rust2::{Yaml, YamlLoader};

use crate::regular_file;

/// Largest file, bytes: a parameter file has a few thousand.
const FILE_BYTES_MAX: u64 = 4 << 20;
/// Deepest nesting: the reader takes a piece of the stack for each level.
const DEPTH_MAX: usize = 64;

/// The documents of a text.
///
/// # Errors
/// For what is not YAML, is nested too deep, or has aliases: a few lines of them can stand for any amount of memory, and ROS 2's
/// own reader takes none either.
pub fn parse(text: &str) -> Result<Vec<Yaml>, String> {
    let mut events = Parser::new_from_str(text);
    let mut depth = 0usize;
    loop {
        let (event, mark) = events.next_token().map_err(|e| format!("it is not YAML ({e})"))?;
        match event {
            Event::SequenceStart(..) | Event::MappingStart(..) => depth += 1,
            Event::SequenceEnd | Event::MappingEnd => depth = depth.saturating_sub(1),
            Event::Alias(_) => {
                return Err(format!("line {} has an alias (*name), which is not read", mark.line()));
            }
            Event::StreamEnd => break,
            _ => {}
        }
        if depth > DEPTH_MAX {
            return Err(format!("line {} is nested more than {DEPTH_MAX} deep", mark.line()));
        }
    }
    YamlLoader::load_from_str(text).map_err(|e| format!("it is not YAML ({e})"))
}

/// The text of a file.
///
/// # Errors
/// When it is larger than a YAML file is, not a regular file, not text or cannot be read.
pub fn read_text(path: &Path) -> Result<String, String> {
    regular_file::read_text(path, FILE_BYTES_MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn aliases_and_deep_nesting_are_refused() {
        assert_eq!(parse("a: [1, 2]\n---\nb").unwrap().len(), 2);
        let mut laughs = String::from("a: &a0 [x, x]\n");
        (1..40).for_each(|k| laughs += &format!("b{k}: &a{k} [*a{0}, *a{0}]\n", k - 1));
        assert!(parse(&laughs).unwrap_err().contains("line 2 has an alias"));
        for deep in ["[".repeat(200), "- ".repeat(100_000), "{a: ".repeat(200)] {
            assert!(parse(&deep).unwrap_err().contains("nested more than 64 deep"));
        }
        assert!(parse("a: [").unwrap_err().contains("not YAML"));
    }

    #[test]
    fn a_file_without_end_is_refused() {
        assert!(read_text(Path::new("/dev/zero")).unwrap_err().contains("not a regular file"));
        assert!(read_text(Path::new("/no/such")).is_err());
    }
}
