//! The qualities of service in use. Both ends of every topic state theirs.

use std::time::Duration;

use ros2_client::dds::rustdds::{Duration as DdsDuration, QosPolicies, QosPolicyBuilder, policy};

/// Quality of service of a topic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Qos {
    /// Latched products: reliable, transient local, the last 16 (all candidates of a job).
    Product,
    /// Latched state: reliable, transient local, the last one.
    Status,
    /// Numbered pieces of large products: reliable, volatile. The sender has at most [`CHUNK_WINDOW`] unacknowledged.
    Chunks,
    /// Streams such as joint states and TF: reliable, volatile, the last 64.
    Stream,
    /// Latched messages that make one whole together (see [`crate::Series`]): reliable, transient local, the last 1000.
    Series,
    /// A sensor's newest message, sent again until it has arrived: reliable, volatile, the last one. Matches reliable publishers.
    Sensor,
    /// A sensor's newest message as it happens to arrive: best effort, volatile, the last one. Readers of it match every publisher.
    SensorBestEffort,
}

/// Chunks that a sender has under way before it waits for acknowledgements. One, as the socket buffer that Linux gives unasked (208 KiB,
/// which rclpy's readers keep) holds hardly more than a chunk's fragments with their overhead: with eight a 10 MB mesh took rclpy 3 s
/// instead of 1.2 s, and Rust readers gained nothing.
pub const CHUNK_WINDOW: i32 = 1;

/// How long a publisher waits for acknowledgements when its window is full.
pub(crate) const PUBLISH_PATIENCE: Duration = Duration::from_millis(1000);

impl Qos {
    /// Whether late joiners receive what was sent before.
    pub fn latched(self) -> bool {
        matches!(self, Self::Product | Self::Status | Self::Series)
    }

    /// How many messages are kept.
    pub fn depth(self) -> i32 {
        match self {
            Self::Product => 16,
            Self::Status | Self::Sensor | Self::SensorBestEffort => 1,
            Self::Chunks | Self::Stream => 64,
            Self::Series => 1000,
        }
    }

    pub(crate) fn policies(self, writer: bool) -> QosPolicies {
        let durability =
            if self.latched() { policy::Durability::TransientLocal } else { policy::Durability::Volatile };
        let max_blocking_time = DdsDuration::from_nanos(PUBLISH_PATIENCE.as_nanos() as i64);
        let reliability = match self {
            Self::SensorBestEffort => policy::Reliability::BestEffort,
            _ => policy::Reliability::Reliable { max_blocking_time },
        };
        let builder = QosPolicyBuilder::new()
            .durability(durability)
            .reliability(reliability)
            .history(policy::History::KeepLast { depth: self.depth() })
            .liveliness(policy::Liveliness::Automatic { lease_duration: DdsDuration::INFINITE })
            .deadline(policy::Deadline(DdsDuration::INFINITE))
            .lifespan(policy::Lifespan { duration: DdsDuration::INFINITE });
        if writer && self == Self::Chunks {
            // rustdds derives the window of unacknowledged samples from the resource limits.
            builder
                .resource_limits(policy::ResourceLimits {
                    max_samples: CHUNK_WINDOW,
                    max_instances: 1,
                    max_samples_per_instance: CHUNK_WINDOW,
                })
                .build()
        } else {
            builder.build()
        }
    }

    /// As rosbag2 writes an offered profile (YAML), for bag metadata.
    pub fn rosbag_yaml(self) -> String {
        let durability = if self.latched() { "transient_local" } else { "volatile" };
        let reliability = if self == Self::SensorBestEffort { "best_effort" } else { "reliable" };
        format!(
            "- history: keep_last\n  depth: {}\n  reliability: {reliability}\n  durability: {durability}\n  deadline:\n    sec: 9223372036\n    nsec: 854775807\n  lifespan:\n    sec: 9223372036\n    nsec: 854775807\n  liveliness: automatic\n  liveliness_lease_duration:\n    sec: 9223372036\n    nsec: 854775807\n  avoid_ros_namespace_conventions: false",
            self.depth()
        )
    }
}
