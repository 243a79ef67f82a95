//! What `patchmill doctor` looks at: each thing in a module of its own, as findings.

pub mod controller;
pub mod disk;
pub mod machine;
pub mod multicast;
pub mod network;
pub mod sockets;
pub mod stack;

use serde::Serialize;

use crate::terminal::Mood;

/// What was found about one thing.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// The thing.
    pub check: &'static str,
    /// How it is.
    #[serde(serialize_with = "word")]
    pub state: Mood,
    /// What was found.
    pub found: String,
    /// What to do about it; empty where nothing has to be done.
    pub advice: String,
}

impl Finding {
    /// A thing as it should be.
    pub fn good(check: &'static str, found: impl Into<String>) -> Self {
        Self { check, state: Mood::Good, found: found.into(), advice: String::new() }
    }

    /// A thing that is worth a look.
    pub fn doubtful(check: &'static str, found: impl Into<String>, advice: impl Into<String>) -> Self {
        Self { check, state: Mood::Doubtful, found: found.into(), advice: advice.into() }
    }

    /// A thing that is amiss.
    pub fn bad(check: &'static str, found: impl Into<String>, advice: impl Into<String>) -> Self {
        Self { check, state: Mood::Bad, found: found.into(), advice: advice.into() }
    }

    /// Two lines at most, for a person.
    pub fn text(&self) -> String {
        // Padded before it is coloured: the colour's characters have no width.
        let state = self.state.coloured(&format!("{:<7}", name(self.state)));
        let advice =
            if self.advice.is_empty() { String::new() } else { format!("{:26}→ {}\n", "", self.advice) };
        format!("{state} {:<17} {}\n{advice}", self.check, self.found)
    }
}

/// The state's name.
fn name(state: Mood) -> &'static str {
    match state {
        Mood::Good => "ok",
        Mood::Doubtful => "warning",
        Mood::Bad => "failed",
    }
}

fn word<S: serde::Serializer>(state: &Mood, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(name(*state))
}
