//! The thread that writes: takes what is queued, flushes twice a second, notes what was dropped.

use std::time::{Duration, Instant};

use crate::buffer::{Next, Receiver};
use crate::summary::BagSummary;
use crate::{BagError, BagWriter};

/// What came longer ago than this survives a killed process.
const FLUSH_INTERVAL: Duration = Duration::from_millis(500);

/// Notes in `metadata.yaml`.
const DROPPED_MESSAGES: &str = "dropped_messages";
const DROPPED_BYTES: &str = "dropped_bytes";

/// Writes until all senders are gone.
pub(crate) fn write_all(mut bag: BagWriter, queue: &Receiver) -> Result<BagSummary, BagError> {
    let mut noted = None;
    let mut flushed = Instant::now();
    let mut fresh = false;
    loop {
        let left = FLUSH_INTERVAL.saturating_sub(flushed.elapsed());
        let next = queue.next(if fresh { left } else { FLUSH_INTERVAL });
        let ended = matches!(next, Next::Ended);
        if let Next::Message(message) = next {
            bag.write_bytes(&message.topic, message.time, &message.bytes)?;
            fresh = true;
        }
        if ended || flushed.elapsed() >= FLUSH_INTERVAL {
            bag.flush()?;
            (flushed, fresh) = (Instant::now(), false);
            let dropped = queue.dropped();
            if noted != Some(dropped) {
                let (messages, bytes) = (dropped.messages.to_string(), dropped.bytes.to_string());
                bag.note(&[(DROPPED_MESSAGES, messages), (DROPPED_BYTES, bytes)])?;
                noted = Some(dropped);
            }
        }
        if ended {
            return bag.finish();
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use patchmill_msgs::msg::Job;
    use patchmill_msgs::{RosType as _, cdr};
    use patchmill_node_runtime::Qos;

    use super::*;
    use crate::buffer::{Queued, buffer};
    use crate::{BagReader, Topic, metadata};

    #[test]
    fn what_a_slow_disk_costs_is_in_the_metadata() {
        let root = tempfile::tempdir().unwrap();
        let directory = root.path().join("bag");
        let bag = BagWriter::create(&directory).unwrap();
        let (sender, receiver) = buffer(2000);
        let topic = Arc::new(Topic::of::<Job>("/patchmill/job", Qos::Status));
        // The disk is so slow that nothing is written before all has come.
        let sent = (0..40).filter(|n| {
            let job = Job { job_id: n.to_string(), ..Job::default() };
            let message = Queued { topic: Arc::clone(&topic), time: 5, bytes: cdr::to_cdr(&job) };
            sender.push(message).is_ok()
        });
        let kept = sent.count();
        drop(sender);
        let summary = write_all(bag, &receiver).unwrap();
        assert!((1..40).contains(&kept) && summary.message_count == kept as u64, "{kept}");
        assert_eq!(summary.topics[0].type_hash, Job::TYPE_HASH);
        assert_eq!(BagReader::open(&directory).unwrap().messages().unwrap().len(), kept);
        let notes = metadata::notes(&directory);
        assert_eq!(notes[DROPPED_MESSAGES], (40 - kept).to_string());
        assert!(notes[DROPPED_BYTES].parse::<u64>().unwrap() > 0);
    }
}
