//! What a person is told on stderr: colours on a terminal only, and never with NO_COLOR.

use anstyle::{AnsiColor, Style};
use patchmill_node_runtime::printable;

const RED: Style = AnsiColor::Red.on_default().bold();
const YELLOW: Style = AnsiColor::Yellow.on_default().bold();
const GREEN: Style = AnsiColor::Green.on_default().bold();

/// How things are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Mood {
    /// As they should be.
    Good,
    /// Worth a look.
    Doubtful,
    /// Amiss.
    Bad,
}

impl Mood {
    fn style(self) -> Style {
        match self {
            Self::Good => GREEN,
            Self::Doubtful => YELLOW,
            Self::Bad => RED,
        }
    }

    /// A word in the mood's colour, for [`anstream`]'s streams, which take it out where it does not belong.
    pub fn coloured(self, word: &str) -> String {
        let style = self.style();
        format!("{style}{word}{style:#}")
    }
}

/// Says why the command failed.
pub fn error(text: &str) {
    anstream::eprintln!("patchmill: {} {}", Mood::Bad.coloured("error:"), printable(text));
}

/// Says what the command goes on without.
pub fn warn(text: impl AsRef<str>) {
    anstream::eprintln!("patchmill: {} {}", Mood::Doubtful.coloured("warning:"), printable(text.as_ref()));
}
