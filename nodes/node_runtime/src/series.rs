//! Latched messages that make one whole together, such as the markers of a plan.

use patchmill_msgs::RosType;

use crate::RuntimeError;
use crate::chunks::CHUNK_INTERVAL;
use crate::node::{Node, Publisher};
use crate::qos::Qos;

/// Publishes a whole in several latched messages. A late joiner sees the messages of the newest whole only, in order.
///
/// Every new whole gets a new DDS writer, as nothing else empties a writer's history: rustdds trims it to the depth
/// only when readers have acknowledged, and an old whole's messages would be sent to late joiners too. A reader that
/// is there sees the newer whole after as much of the older one as it had received.
pub struct Series<T: RosType> {
    node: Node,
    topic: String,
    publisher: Option<Publisher<T>>,
    used: bool,
}

impl<T: RosType> Series<T> {
    /// Most messages of a whole.
    pub const MOST: usize = 1000;

    /// Offers the topic, with [`Qos::Series`].
    ///
    /// # Errors
    /// As [`Node::publisher`].
    pub fn new(node: &Node, topic: &str) -> Result<Self, RuntimeError> {
        let publisher = Some(node.publisher(topic, Qos::Series)?);
        Ok(Self { node: node.clone(), topic: topic.to_owned(), publisher, used: false })
    }

    /// Publishes a new whole in place of the older one, at most 500 messages a second.
    ///
    /// # Errors
    /// When there are more than [`Series::MOST`] messages (nothing is published then), or as [`Node::publisher`] and
    /// [`Publisher::publish`].
    pub async fn replace(&mut self, messages: Vec<T>) -> Result<(), RuntimeError> {
        if messages.len() > Self::MOST {
            let reason = format!("it takes {} messages, at most {} are kept", messages.len(), Self::MOST);
            return Err(RuntimeError::Publish { topic: self.topic.clone(), reason });
        }
        let publisher = match self.publisher.take() {
            Some(fresh) if !self.used => fresh,
            old => {
                // The old writer leaves first: nobody ever matches both.
                drop(old);
                self.node.publisher(&self.topic, Qos::Series)?
            }
        };
        self.used = true;
        let mut interval = tokio::time::interval(CHUNK_INTERVAL);
        interval.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        let kept = self.publisher.insert(publisher);
        for message in messages {
            interval.tick().await;
            kept.publish(message)?;
        }
        Ok(())
    }

    /// The publisher of the present whole, to wait for readers in tests.
    pub fn publisher(&self) -> Option<&Publisher<T>> {
        self.publisher.as_ref()
    }
}
