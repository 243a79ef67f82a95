//! Sending the numbered chunks of a large product, paced by acknowledgement and by time.

use std::time::Duration;

use patchmill_msgs::RosType;

use crate::RuntimeError;
use crate::node::{Node, Publisher};
use crate::qos::{PUBLISH_PATIENCE, Qos};

/// Least time between two chunks: 500 a second, 28 MB/s. Unpaced, rustdds overruns the readers' sockets.
pub(crate) const CHUNK_INTERVAL: Duration = Duration::from_millis(2);

/// Publishes chunks: at most [`crate::qos::CHUNK_WINDOW`] unacknowledged by any matched reader, at most 500 a second.
pub struct ChunkPublisher<T: RosType> {
    publisher: Publisher<T>,
}

impl<T: RosType> ChunkPublisher<T> {
    /// Offers the topic.
    ///
    /// # Errors
    /// As [`Node::publisher`].
    pub fn new(node: &Node, topic: &str) -> Result<Self, RuntimeError> {
        Ok(Self { publisher: node.publisher(topic, Qos::Chunks)? })
    }

    /// Publishes the chunks. Ends early, with the number published, when readers stop acknowledging: they then fetch
    /// what is missing by the service.
    pub async fn publish_paced(&self, chunks: impl IntoIterator<Item = T>) -> usize {
        let mut interval = tokio::time::interval(CHUNK_INTERVAL);
        interval.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        let mut sent = 0;
        for chunk in chunks {
            interval.tick().await;
            let publish = self.publisher.publish_when_acknowledged(chunk);
            match tokio::time::timeout(PUBLISH_PATIENCE, publish).await {
                Ok(Ok(())) => sent += 1,
                Ok(Err(_)) | Err(_) => break,
            }
        }
        sent
    }

    /// The publisher itself, to wait for readers in tests.
    pub fn publisher(&self) -> &Publisher<T> {
        &self.publisher
    }
}
