//! What late clients get of a topic: the messages that DDS would give them.

use std::any::Any;
use std::collections::VecDeque;

use patchmill_msgs::RosType;
use patchmill_msgs::trajectory_msgs::msg::JointTrajectory;
use patchmill_msgs::visualization_msgs::msg::{Marker, MarkerArray};
use patchmill_node_runtime::Qos;

/// The last messages of a topic, oldest first.
pub(crate) struct Latch {
    depth: usize,
    messages: VecDeque<Vec<u8>>,
}

impl Latch {
    /// Empty; keeps nothing of topics that are not latched.
    pub(crate) fn new(qos: Qos) -> Self {
        let depth = if qos.latched() { qos.depth() as usize } else { 0 };
        Self { depth, messages: VecDeque::new() }
    }

    /// Adds a message. One that begins a new whole takes the older whole's place.
    pub(crate) fn push(&mut self, message: Vec<u8>, begins_whole: bool) {
        if begins_whole {
            self.messages.clear();
        }
        if self.messages.len() == self.depth {
            self.messages.pop_front();
        }
        if self.depth > 0 {
            self.messages.push_back(message);
        }
    }

    /// What a late client gets, in order.
    pub(crate) fn messages(&self) -> impl Iterator<Item = &[u8]> {
        self.messages.iter().map(Vec::as_slice)
    }
}

/// Whether a message is the first of a series that makes one whole: a drawing begins by deleting the older one, a program's
/// trajectory at time 0. DDS tells wholes apart by their writers, which are not seen here.
pub(crate) fn begins_whole<T: RosType>(message: &T) -> bool {
    let message: &dyn Any = message;
    if let Some(drawing) = message.downcast_ref::<MarkerArray>() {
        drawing.markers.first().is_some_and(|marker| marker.action == Marker::DELETEALL)
    } else if let Some(part) = message.downcast_ref::<JointTrajectory>() {
        let start = part.points.first().map(|point| &point.time_from_start);
        start.is_none_or(|time| time.sec == 0 && time.nanosec == 0)
    } else {
        false
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use patchmill_msgs::trajectory_msgs::msg::JointTrajectoryPoint;

    fn kept(latch: &Latch) -> Vec<u8> {
        latch.messages().map(|message| message[0]).collect()
    }

    #[test]
    fn as_many_messages_are_kept_as_dds_keeps() {
        let (mut status, mut product, mut stream) =
            (Latch::new(Qos::Status), Latch::new(Qos::Product), Latch::new(Qos::Stream));
        for i in 0..20 {
            [&mut status, &mut product, &mut stream].into_iter().for_each(|l| l.push(vec![i], false));
        }
        assert_eq!(kept(&status), [19]);
        assert_eq!(kept(&product), (4..20).collect::<Vec<u8>>());
        assert!(kept(&stream).is_empty());
    }

    #[test]
    fn a_new_whole_takes_the_older_ones_place() {
        let mut series = Latch::new(Qos::Series);
        for (message, begins) in [(1, true), (2, false), (3, true), (4, false)] {
            series.push(vec![message], begins);
        }
        assert_eq!(kept(&series), [3, 4]);
    }

    #[test]
    fn wholes_are_told_apart_by_how_they_begin() {
        let with = |action| MarkerArray { markers: vec![Marker { action, ..Marker::default() }; 2] };
        assert!(begins_whole(&with(Marker::DELETEALL)) && !begins_whole(&with(Marker::ADD)));
        let mut point = JointTrajectoryPoint::default();
        let part = |point| JointTrajectory { points: vec![point], ..JointTrajectory::default() };
        assert!(begins_whole(&part(point.clone())));
        point.time_from_start.nanosec = 1;
        assert!(!begins_whole(&part(point)));
        assert!(!begins_whole(&patchmill_msgs::msg::Job::default()));
    }
}
