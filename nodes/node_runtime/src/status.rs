//! The latched status of a stage: what it does, how far it is, why it failed.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant, SystemTime};

use patchmill_msgs::builtin_interfaces::msg::Time;
use patchmill_msgs::msg::StageStatus;
use patchmill_msgs::std_msgs::msg::Header;
use patchmill_products::stage::StageError;

use crate::node::{Node, Publisher};
use crate::qos::Qos;
use crate::stage_runner::JobTag;
use crate::{RuntimeError, heartbeat, topics};

/// Progress is published at most so often.
const PROGRESS_INTERVAL: Duration = Duration::from_millis(100);

/// The time as a message has it.
pub fn now() -> Time {
    let since = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
    Time { sec: since.as_secs() as i32, nanosec: since.subsec_nanos() }
}

/// The newest status, and when it was said.
pub(crate) struct Newest {
    pub status: StageStatus,
    pub said: Instant,
}

/// Publishes `<node>/status`, and signs of life on `/diagnostics`. Cloning gives another handle.
#[derive(Clone)]
pub struct StatusPublisher {
    publisher: Publisher<StageStatus>,
    node: Node,
    last_progress: Arc<Mutex<Option<Instant>>>,
    newest: Arc<Mutex<Newest>>,
}

impl StatusPublisher {
    /// Offers the topics and publishes IDLE.
    ///
    /// # Errors
    /// As [`Node::publisher`].
    pub fn new(node: &Node) -> Result<Self, RuntimeError> {
        let publisher = node.publisher(&topics::status(node.role()), Qos::Status)?;
        let newest = Arc::new(Mutex::new(Newest { status: StageStatus::default(), said: Instant::now() }));
        let this = Self { publisher, node: node.clone(), last_progress: Arc::default(), newest };
        this.idle();
        heartbeat::start(node, Some(Arc::clone(&this.newest)))?;
        Ok(this)
    }

    /// There is nothing to do.
    pub fn idle(&self) {
        self.publish(&JobTag::default(), StageStatus::IDLE, 0.0, 0, "");
    }

    /// Inputs are missing.
    pub fn waiting(&self, tag: &JobTag, text: &str) {
        self.publish(tag, StageStatus::WAITING, 0.0, 0, text);
    }

    /// The work has begun.
    pub fn running(&self, tag: &JobTag, text: &str) {
        self.publish(tag, StageStatus::RUNNING, 0.0, 0, text);
    }

    /// The work goes on; published at most ten times a second, from any thread.
    pub fn progress(&self, tag: &JobTag, fraction: f64, text: &str) {
        {
            let mut last = self.last_progress.lock().unwrap_or_else(PoisonError::into_inner);
            if last.is_some_and(|at| at.elapsed() < PROGRESS_INTERVAL) {
                return;
            }
            *last = Some(Instant::now());
        }
        self.publish(tag, StageStatus::RUNNING, fraction.clamp(0.0, 1.0), 0, text);
    }

    /// The products are published.
    pub fn done(&self, tag: &JobTag, text: &str) {
        self.node.info(format!("{text}{}", tag.in_log()));
        self.publish(tag, StageStatus::DONE, 1.0, 0, text);
    }

    /// The work failed.
    pub fn failed(&self, tag: &JobTag, error: &StageError) {
        self.node.error(format!("{error}{}", tag.in_log()));
        self.publish(tag, StageStatus::FAILED, 0.0, error.code, &error.text);
    }

    fn publish(&self, tag: &JobTag, state: u8, fraction: f64, code: i32, text: &str) {
        let status = StageStatus {
            header: Header { stamp: now(), frame_id: String::new() },
            job_stamp: tag.stamp.clone(),
            node: self.node.role().to_owned(),
            surface_id: tag.surface_id.clone(),
            job_id: tag.job_id.clone(),
            state,
            fraction,
            code,
            text: text.to_owned(),
        };
        *self.newest.lock().unwrap_or_else(PoisonError::into_inner) =
            Newest { status: status.clone(), said: Instant::now() };
        // A status that cannot be sent must not stop the work.
        let _ = self.publisher.publish(status);
    }
}
