//! The newest `sensor_msgs/PointCloud2` of the node's topic.

use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use patchmill_msgs::sensor_msgs::msg::PointCloud2 as CloudMessage;
use patchmill_node_runtime::{Node, Qos, RuntimeError, topics};
use patchmill_products::stage::{Progress, StageError};

use crate::error_code::{BAD_CONTENT, FOREIGN_FRAME, NO_CLOUD};
use crate::point_cloud2::{PointCloud2, PointField, points};
use crate::raw::{Limits, RawCloud};

/// A wait looks so often whether it is still wanted.
const LOOK: Duration = Duration::from_millis(50);

/// Holds the newest message. Cloning gives another handle.
#[derive(Clone)]
pub(super) struct CloudTopic {
    topic: Arc<str>,
    slot: Arc<Slot>,
}

#[derive(Default)]
struct Slot {
    newest: Mutex<Option<Arc<CloudMessage>>>,
    came: Condvar,
}

impl CloudTopic {
    /// Listens from now on. A reliable publisher is heard by both readers, where the reliable one gets what the other loses of a large
    /// message; a best-effort publisher by one of them.
    pub(super) fn subscribe(node: &Node) -> Result<Self, RuntimeError> {
        let clouds = Self { topic: node.resolve(topics::CLOUD).into(), slot: Arc::default() };
        for qos in [Qos::Sensor, Qos::SensorBestEffort] {
            let slot = Arc::clone(&clouds.slot);
            node.subscribe_with(topics::CLOUD, qos, move |message: CloudMessage| slot.put(message))?;
        }
        Ok(clouds)
    }

    /// Absolute name of the topic.
    pub(super) fn topic(&self) -> &str {
        &self.topic
    }

    /// The newest cloud; where none has come yet the first one within `wait`.
    ///
    /// # Errors
    /// When none comes; cancellation.
    pub(super) fn newest(&self, wait: Duration, progress: Progress<'_>) -> Result<Newest, StageError> {
        let end = Instant::now() + wait;
        let mut held = self.slot.lock();
        loop {
            progress.check()?;
            if let Some(message) = held.as_ref() {
                return Ok(Newest(Arc::clone(message)));
            }
            let left = end.saturating_duration_since(Instant::now());
            if left.is_zero() {
                let text = format!(
                    "no point cloud came on {} within {} s; a sensor_msgs/PointCloud2 was expected there",
                    self.topic,
                    wait.as_secs_f64()
                );
                return Err(StageError::new(NO_CLOUD, text));
            }
            let waited = self.slot.came.wait_timeout(held, left.min(LOOK));
            held = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
    }
}

impl Slot {
    fn lock(&self) -> MutexGuard<'_, Option<Arc<CloudMessage>>> {
        self.newest.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn put(&self, message: CloudMessage) {
        *self.lock() = Some(Arc::new(message));
        self.came.notify_all();
    }
}

/// A cloud as it came.
pub(super) struct Newest(Arc<CloudMessage>);

impl Newest {
    /// The points, m in `frame`.
    ///
    /// # Errors
    /// When the cloud is in another frame, is malformed, empty or larger than allowed.
    pub(super) fn points(&self, frame: &str, limits: &Limits, topic: &str) -> Result<RawCloud, StageError> {
        let message = &self.0;
        if message.header.frame_id != frame {
            let text = format!(
                "the cloud of {topic} is in the frame \"{}\", \"{frame}\" (parameter cloud_frame) was expected: transform it into the \
                 workpiece's frame before it is published, or name its frame where that is the workpiece's",
                message.header.frame_id
            );
            return Err(StageError::new(FOREIGN_FRAME, text));
        }
        let fields: Vec<PointField<'_>> = message
            .fields
            .iter()
            .map(|f| PointField { name: &f.name, offset: f.offset, datatype: f.datatype, count: f.count })
            .collect();
        let cloud = PointCloud2 {
            height: message.height,
            width: message.width,
            fields: &fields,
            is_bigendian: message.is_bigendian,
            point_step: message.point_step,
            row_step: message.row_step,
            data: &message.data,
        };
        points(&cloud, limits).map_err(|text| StageError::new(BAD_CONTENT, format!("{topic}: {text}")))
    }
}
