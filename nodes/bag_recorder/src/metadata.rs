//! `metadata.yaml` of rosbag2, version 9.

use std::fmt::Write;

use crate::writer::{BagSummary, TopicSummary};

/// The inner map, as the MCAP's Metadata record `rosbag2` holds it.
pub(crate) fn inner(summary: &BagSummary, file: &str) -> String {
    let mut yaml = String::new();
    let (start, duration, count) = (summary.start, summary.duration, summary.message_count);
    // Writing into a String cannot fail.
    let _ = write!(
        yaml,
        "version: 9\nstorage_identifier: mcap\nduration:\n  nanoseconds: {duration}\nstarting_time:\n  \
         nanoseconds_since_epoch: {start}\nmessage_count: {count}\n"
    );
    yaml.push_str("topics_with_message_count:");
    if summary.topics.is_empty() {
        yaml.push_str(" []");
    }
    yaml.push('\n');
    for topic in &summary.topics {
        push_topic(&mut yaml, topic);
    }
    let _ = write!(
        yaml,
        "compression_format: \"\"\ncompression_mode: \"\"\nrelative_file_paths:\n  - {file}\nfiles:\n  - path: {file}\n    \
         starting_time:\n      nanoseconds_since_epoch: {start}\n    duration:\n      nanoseconds: {duration}\n    \
         message_count: {count}\ncustom_data: ~\nros_distro: jazzy\n"
    );
    yaml
}

/// The file `metadata.yaml`.
pub(crate) fn file(inner: &str) -> String {
    format!("rosbag2_bagfile_information:\n{}", indent(inner, 2))
}

fn push_topic(yaml: &mut String, topic: &TopicSummary) {
    let qos = indent(&topic.qos, 8);
    let _ = write!(
        yaml,
        "  - topic_metadata:\n      name: {}\n      type: {}\n      serialization_format: cdr\n      \
         offered_qos_profiles:\n{qos}\n      type_description_hash: \"\"\n    message_count: {}\n",
        topic.name, topic.type_name, topic.message_count
    );
}

fn indent(text: &str, by: usize) -> String {
    let space = " ".repeat(by);
    text.lines().map(|line| format!("{space}{line}")).collect::<Vec<_>>().join("\n")
}
