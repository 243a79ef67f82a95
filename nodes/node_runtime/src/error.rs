//! What can go wrong below a node, each with one clear sentence.

use std::fmt;
use std::time::Duration;

/// An error of the node runtime.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum RuntimeError {
    /// A bad command-line argument or environment variable.
    Argument(String),
    /// A parameter that does not exist or a value that it refuses.
    Parameter(String),
    /// The protection that was asked for cannot be had.
    Security(String),
    /// Something could not be made.
    Create {
        /// What was to be made.
        what: String,
        /// Why it was not.
        reason: String,
    },
    /// A message could not be published.
    Publish {
        /// Its topic.
        topic: String,
        /// Why not.
        reason: String,
    },
    /// Nobody offers the service or action.
    Unavailable {
        /// Its name.
        name: String,
        /// How long was waited.
        waited: Duration,
    },
    /// The service is there but did not answer in time.
    NoAnswer {
        /// Its name.
        name: String,
        /// How long was waited, all attempts together.
        waited: Duration,
    },
    /// The action server went away while it worked on the goal.
    Lost {
        /// Name of the action.
        name: String,
        /// How long its return was waited for.
        waited: Duration,
    },
    /// The action server does not know the goal that it accepted.
    Forgotten {
        /// Name of the action.
        name: String,
    },
    /// The action server refused the goal.
    Rejected {
        /// Name of the action.
        name: String,
    },
    /// No domain of 1..=100 is free on this machine.
    NoFreeDomain,
    /// The node must not run on; why.
    GaveUp(String),
    /// The node has been shut down.
    Stopped,
}

impl RuntimeError {
    pub(crate) fn create(what: impl Into<String>, reason: impl fmt::Display) -> Self {
        Self::Create { what: what.into(), reason: reason.to_string() }
    }
}

impl fmt::Display for RuntimeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Argument(text) | Self::Parameter(text) | Self::Security(text) | Self::GaveUp(text) => {
                f.write_str(text)
            }
            Self::Create { what, reason } => write!(f, "{what} cannot be made: {reason}"),
            Self::Publish { topic, reason } => write!(f, "nothing can be published on {topic}: {reason}"),
            Self::Unavailable { name, waited } => {
                write!(
                    f,
                    "nobody serves {name} (waited {:.1} s); is its node running on this ROS domain? `patchmill doctor --domain N` tells",
                    waited.as_secs_f64()
                )
            }
            Self::NoAnswer { name, waited } => {
                write!(f, "{name} did not answer within {:.1} s", waited.as_secs_f64())
            }
            Self::Lost { name, waited } => {
                write!(
                    f,
                    "the server of {name} was lost while the goal ran and did not come back within {:.0} s",
                    waited.as_secs_f64()
                )
            }
            Self::Forgotten { name } => {
                write!(
                    f,
                    "the server of {name} no longer knows the goal: was it started anew while the goal ran?"
                )
            }
            Self::Rejected { name } => write!(f, "{name} rejected the goal"),
            Self::NoFreeDomain => f.write_str("no ROS domain of 1..=100 is free on this machine"),
            Self::Stopped => f.write_str("the node has been shut down"),
        }
    }
}

impl std::error::Error for RuntimeError {}
