//! Latched messages that make one whole together, such as the markers of a plan.

use patchmill_msgs::RosType;

use crate::RuntimeError;
use crate::chunks::CHUNK_INTERVAL;
use crate::node::{Node, Publisher};
use crate::qos::Qos;

/// Publishes a whole in several latched messages. A late joiner sees the messages of the newest whole only, in order.
///
/// The writer forgets the older whole before it publishes a new one: rustdds trims its history to the depth only, and an old
/// whole's messages would be sent to late joiners too. A reader that is there sees the newer whole after as much of the
/// older one as it had received. (rustdds keeps one cache a topic for all readers of a node: a second subscription of a node
/// that listens already gets also what that node still keeps.)
pub struct Series<T: RosType> {
    publisher: Publisher<T>,
}

impl<T: RosType> Series<T> {
    /// Most messages of a whole.
    pub const MOST: usize = 1000;

    /// Offers the topic, with [`Qos::Series`].
    ///
    /// # Errors
    /// As [`Node::publisher`].
    pub fn new(node: &Node, topic: &str) -> Result<Self, RuntimeError> {
        Ok(Self { publisher: node.publisher(topic, Qos::Series)? })
    }

    /// Publishes a new whole in place of the older one, at most 500 messages a second.
    ///
    /// # Errors
    /// When there are more than [`Series::MOST`] messages (nothing is published then), or as [`Publisher::publish`].
    pub async fn replace(&mut self, messages: Vec<T>) -> Result<(), RuntimeError> {
        if messages.len() > Self::MOST {
            let reason = format!("it takes {} messages, at most {} are kept", messages.len(), Self::MOST);
            return Err(RuntimeError::Publish { topic: self.publisher.topic().to_owned(), reason });
        }
        self.publisher.forget();
        let mut interval = tokio::time::interval(CHUNK_INTERVAL);
        interval.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        for message in messages {
            interval.tick().await;
            self.publisher.publish(message)?;
        }
        Ok(())
    }
}
