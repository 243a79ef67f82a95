//! Bags: a whole run as rosbag2 files (MCAP) that `ros2 bag`, Foxglove and `rosbags` open.
//!
//! [`writer`], [`reader`] and [`repair`](mod@repair) are pure; [`recorder`] subscribes to every topic and writes, [`run`] gives the
//! recorded products.

mod buffer;
mod clock;
mod disk;
pub mod error;
mod interface;
mod mcap_file;
mod metadata;
pub mod reader;
pub mod recorder;
pub mod repair;
pub mod run;
mod scan;
pub mod summary;
pub mod writer;

pub use error::BagError;
pub use reader::{BagMessage, BagReader};
pub use recorder::{Recorder, RecorderOptions};
pub use repair::{Repair, repair};
pub use run::RecordedRun;
pub use summary::{BagSummary, FileSummary, TopicSummary};
pub use writer::{BagOptions, BagWriter, Topic};
