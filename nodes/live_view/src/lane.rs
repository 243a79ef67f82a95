//! One topic on its way from DDS to the WebSocket's clients.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

use foxglove::websocket::{ChannelView, Client, ServerListener};
use foxglove::{ChannelBuilder, ChannelId, Context, FoxgloveError, RawChannel, Schema};
use patchmill_msgs::{RosType, cdr};
use patchmill_node_runtime::Qos;

use crate::latch::{Latch, begins_whole};

/// A topic's channel and what late clients get of it.
pub(crate) struct Lane {
    channel: Arc<RawChannel>,
    latch: Mutex<Latch>,
}

impl Lane {
    /// Advertises a topic of messages `T` by its absolute name.
    pub(crate) fn open<T: RosType>(
        context: &Arc<Context>,
        name: &str,
        qos: Qos,
    ) -> Result<Arc<Self>, FoxgloveError> {
        let channel = ChannelBuilder::new(name)
            .context(context)
            .message_encoding("cdr")
            .schema(Schema::new(T::TYPE_NAME, "ros2msg", T::DEFINITION.as_bytes()))
            .build_raw()?;
        Ok(Arc::new(Self { channel, latch: Mutex::new(Latch::new(qos)) }))
    }

    /// The channel's number, by which clients subscribe.
    pub(crate) fn id(&self) -> ChannelId {
        self.channel.id()
    }

    /// Gives a message to all who have subscribed, and keeps it for those who come later.
    pub(crate) fn pass_on<T: RosType>(&self, message: &T) {
        let bytes = cdr::to_cdr(message);
        // Held until the message is queued: a client that subscribes meanwhile gets old and new ones in order.
        let mut latch = self.latch.lock().unwrap_or_else(PoisonError::into_inner);
        self.channel.log(&bytes);
        latch.push(bytes, begins_whole(message));
    }

    fn catch_up(&self, client: &Client) {
        let latch = self.latch.lock().unwrap_or_else(PoisonError::into_inner);
        for message in latch.messages() {
            self.channel.log_to_sink(message, client.sink_id());
        }
    }
}

/// Gives latched messages to clients when they subscribe.
pub(crate) struct CatchUp {
    /// Looked up only, never gone through.
    pub(crate) lanes: HashMap<ChannelId, Arc<Lane>>,
}

impl ServerListener for CatchUp {
    fn on_subscribe(&self, client: Client, channel: ChannelView) {
        if let Some(lane) = self.lanes.get(&channel.id()) {
            lane.catch_up(&client);
        }
    }
}
