//! Log lines: `[level] [node] text` on stderr and the same on `/rosout`.

use std::fmt;
use std::io::Write;
use std::str::FromStr;

/// How much a log line matters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Level {
    /// For whoever debugs the node.
    Debug,
    /// What the node does.
    Info,
    /// Something is wrong and was got over.
    Warn,
    /// Something failed.
    Error,
    /// The node ends.
    Fatal,
}

impl fmt::Display for Level {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Debug => "debug",
            Self::Info => "info",
            Self::Warn => "warn",
            Self::Error => "error",
            Self::Fatal => "fatal",
        })
    }
}

impl FromStr for Level {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.to_ascii_lowercase().as_str() {
            "debug" => Ok(Self::Debug),
            "info" => Ok(Self::Info),
            "warn" | "warning" => Ok(Self::Warn),
            "error" => Ok(Self::Error),
            "fatal" => Ok(Self::Fatal),
            _ => Err(format!("log level '{text}': expected debug, info, warn, error or fatal")),
        }
    }
}

/// Writes a line to stderr. Where that is full or has nobody who reads it the line is lost, not what speaks (`eprintln!` panics).
pub fn say_on_stderr(line: impl fmt::Display) {
    let _ = writeln!(std::io::stderr(), "{line}");
}

impl Level {
    pub(crate) fn ros(self) -> ros2_client::ros2::LogLevel {
        use ros2_client::ros2::LogLevel;
        match self {
            Self::Debug => LogLevel::Debug,
            Self::Info => LogLevel::Info,
            Self::Warn => LogLevel::Warn,
            Self::Error => LogLevel::Error,
            Self::Fatal => LogLevel::Fatal,
        }
    }
}
