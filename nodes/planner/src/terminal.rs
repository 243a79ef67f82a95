//! What a person is told on stderr: colours on a terminal only, and never with NO_COLOR.

use std::io::Write;

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
    say(Mood::Bad, "error:", text);
}

/// Says what the command goes on without.
pub fn warn(text: impl AsRef<str>) {
    say(Mood::Doubtful, "warning:", text.as_ref());
}

/// Where stderr is full or has nobody who reads it the line is lost.
fn say(mood: Mood, word: &str, text: &str) {
    let _ = writeln!(anstream::stderr(), "patchmill: {} {}", mood.coloured(word), printable(text));
}
