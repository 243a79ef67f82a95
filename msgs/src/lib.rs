//! Messages, services and actions of patchmill: a ROS 2 interface package, and the Rust types of the same.
//!
//! The `.msg`, `.srv` and `.action` files are the one truth: the build generates every type here from them and
//! from the standard messages under `standard/` (verbatim from ROS 2 Jazzy). No DDS here: `patchmill_node_runtime`
//! puts these types on the wire, [`cdr`] turns them into the bytes of a bag.

use serde::Serialize;
use serde::de::DeserializeOwned;

pub mod cdr;

#[allow(
    unused_qualifications,
    rustdoc::bare_urls,
    clippy::doc_lazy_continuation,
    clippy::doc_overindented_list_items
)]
mod interfaces {
    include!(concat!(env!("OUT_DIR"), "/interfaces.rs"));
}
pub use interfaces::*;

/// A message, or a part of a service or an action.
pub trait RosType: Serialize + DeserializeOwned + Clone + Default + Send + Sync + 'static {
    /// Full name, such as `patchmill_msgs/msg/Job` or `patchmill_msgs/srv/LoadSurface_Request`.
    const TYPE_NAME: &'static str;
    /// The definition as a bag's `ros2msg` schema: the text of its file, then that of every message it needs, each
    /// after a line of 80 `=` and a line `MSG: package/Name`.
    const DEFINITION: &'static str;
    /// The type hash (RIHS01) of rosidl: `RIHS01_` and 64 hex digits; equal where fields and their order are.
    const TYPE_HASH: &'static str;
}

/// A service, by its marker type.
pub trait ServiceType: Send + Sync + 'static {
    /// What the client sends.
    type Request: RosType;
    /// What the server answers.
    type Response: RosType;
    /// Full name, such as `patchmill_msgs/srv/LoadSurface`.
    const NAME: &'static str;
    /// The type hash (RIHS01) of rosidl, event message included.
    const TYPE_HASH: &'static str;
}

/// An action, by its marker type.
pub trait ActionType: Send + Sync + 'static {
    /// What is asked for.
    type Goal: RosType;
    /// What comes of it.
    type Result: RosType;
    /// How it goes.
    type Feedback: RosType;
    /// Full name, such as `patchmill_msgs/action/PlanSurface`.
    const NAME: &'static str;
    /// The type hash (RIHS01) of rosidl, implicit services and feedback message included.
    const TYPE_HASH: &'static str;
}
