//! Text from outside (file names, what files say, messages) for terminals and logs: nothing in it moves the cursor, begins a line of its
//! own or turns the reading direction.

use std::borrow::Cow;

/// The text with every control and direction character as its escape (`\n`, `\u{1b}`).
pub fn printable(text: &str) -> Cow<'_, str> {
    if !text.contains(acts) {
        return Cow::Borrowed(text);
    }
    let shown = |c: char| if acts(c) { c.escape_default().to_string() } else { c.to_string() };
    Cow::Owned(text.chars().map(shown).collect())
}

/// Control characters, line and paragraph separators, and what changes the direction of text or is not seen.
fn acts(c: char) -> bool {
    c.is_control()
        || matches!(c, '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}' | '\u{feff}')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_acts_is_escaped() {
        assert_eq!(printable("Fläche 3½½ (1).stl"), "Fläche 3½½ (1).stl");
        assert_eq!(
            printable("\u{1b}[2Ja\n[error] b\r\u{202e}lts.\u{9b}1m"),
            r"\u{1b}[2Ja\n[error] b\r\u{202e}lts.\u{9b}1m"
        );
    }
}
