//! Bags: a whole run as rosbag2 files (MCAP) that `ros2 bag`, Foxglove and `rosbags` open.
//!
//! [`writer`] and [`reader`] are pure; [`recorder`] subscribes to every topic and writes.

pub mod error;
mod metadata;
pub mod reader;
pub mod recorder;
pub mod writer;

pub use error::BagError;
pub use reader::{BagMessage, BagReader};
pub use recorder::Recorder;
pub use writer::{BagSummary, BagWriter, Topic};
