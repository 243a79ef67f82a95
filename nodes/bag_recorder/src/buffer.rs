//! What lies between DDS and the disk: a queue of bounded size that never makes its sender wait.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, mpsc};
use std::time::Duration;

use crate::Topic;

/// Bytes that a queued message takes beside its data.
const OVERHEAD: u64 = 96;

/// A message on its way to the disk.
pub(crate) struct Queued {
    pub topic: Arc<Topic>,
    /// When it was received, ns since 1970.
    pub time: u64,
    /// CDR with its header.
    pub bytes: Vec<u8>,
}

impl Queued {
    fn size(&self) -> u64 {
        self.bytes.len() as u64 + OVERHEAD
    }
}

/// Messages that found no place.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Dropped {
    /// How many.
    pub messages: u64,
    /// Bytes of their data.
    pub bytes: u64,
}

#[derive(Default)]
struct Counters {
    limit: u64,
    queued: AtomicU64,
    dropped_messages: AtomicU64,
    dropped_bytes: AtomicU64,
}

impl Counters {
    fn dropped(&self) -> Dropped {
        Dropped {
            messages: self.dropped_messages.load(Ordering::Relaxed),
            bytes: self.dropped_bytes.load(Ordering::Relaxed),
        }
    }
}

/// Where messages come in. Cloning gives another handle.
#[derive(Clone)]
pub(crate) struct Sender {
    sender: mpsc::Sender<Queued>,
    counters: Arc<Counters>,
}

/// Where messages go out.
pub(crate) struct Receiver {
    receiver: mpsc::Receiver<Queued>,
    counters: Arc<Counters>,
}

/// What a receiver sees.
pub(crate) enum Next {
    Message(Queued),
    /// Nothing came in time.
    Quiet,
    /// All senders are gone.
    Ended,
}

/// A queue that holds at most `limit` bytes.
pub(crate) fn buffer(limit: u64) -> (Sender, Receiver) {
    let (sender, receiver) = mpsc::channel();
    let counters = Arc::new(Counters { limit, ..Counters::default() });
    (Sender { sender, counters: Arc::clone(&counters) }, Receiver { receiver, counters })
}

impl Sender {
    /// Queues a message, or drops and counts it: then what has been dropped so far.
    pub(crate) fn push(&self, message: Queued) -> Result<(), Dropped> {
        let (size, bytes) = (message.size(), message.bytes.len() as u64);
        let counters = &self.counters;
        let queued = counters.queued.fetch_add(size, Ordering::Relaxed) + size;
        if queued <= counters.limit && self.sender.send(message).is_ok() {
            return Ok(());
        }
        counters.queued.fetch_sub(size, Ordering::Relaxed);
        counters.dropped_messages.fetch_add(1, Ordering::Relaxed);
        counters.dropped_bytes.fetch_add(bytes, Ordering::Relaxed);
        Err(counters.dropped())
    }
}

impl Receiver {
    pub(crate) fn next(&self, patience: Duration) -> Next {
        match self.receiver.recv_timeout(patience) {
            Ok(message) => {
                self.counters.queued.fetch_sub(message.size(), Ordering::Relaxed);
                Next::Message(message)
            }
            Err(mpsc::RecvTimeoutError::Timeout) => Next::Quiet,
            Err(mpsc::RecvTimeoutError::Disconnected) => Next::Ended,
        }
    }

    /// What has been dropped so far.
    pub(crate) fn dropped(&self) -> Dropped {
        self.counters.dropped()
    }
}

#[cfg(test)]
mod tests {
    use patchmill_msgs::msg::Job;
    use patchmill_node_runtime::Qos;

    use super::*;

    fn message(bytes: usize) -> Queued {
        let topic = Arc::new(Topic::of::<Job>("/job", Qos::Status));
        Queued { topic, time: 0, bytes: vec![0; bytes] }
    }

    #[test]
    fn a_full_buffer_drops_and_counts_and_takes_again_when_there_is_room() {
        let (sender, receiver) = buffer(3000);
        assert!(sender.push(message(1000)).is_ok() && sender.push(message(1000)).is_ok());
        assert_eq!(sender.push(message(1000)), Err(Dropped { messages: 1, bytes: 1000 }));
        // A small one still fits.
        assert!(sender.push(message(10)).is_ok());
        assert!(matches!(receiver.next(Duration::ZERO), Next::Message(m) if m.bytes.len() == 1000));
        assert!(sender.push(message(1000)).is_ok());
        assert_eq!(sender.push(message(5000)), Err(Dropped { messages: 2, bytes: 6000 }));
        drop(sender);
        let mut left = 0;
        while let Next::Message(_) = receiver.next(Duration::ZERO) {
            left += 1;
        }
        assert_eq!((left, receiver.dropped().messages), (3, 2));
    }

    #[test]
    fn what_is_sent_to_nobody_is_dropped() {
        let (sender, receiver) = buffer(3000);
        drop(receiver);
        assert_eq!(sender.push(message(7)), Err(Dropped { messages: 1, bytes: 7 }));
    }
}
