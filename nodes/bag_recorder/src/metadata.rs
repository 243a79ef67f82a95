//! `metadata.yaml` of rosbag2, version 9.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;

use patchmill_node_runtime::{whole_file, yaml};
use yaml_rust2::Yaml;

use crate::BagError;
use crate::summary::{BagSummary, FileSummary, TopicSummary};

/// The file's name inside a bag's directory.
pub(crate) const FILE: &str = "metadata.yaml";

/// Writes the file beside its place and moves it there, so that nobody sees half of it.
///
/// # Errors
/// When the directory cannot be written.
pub(crate) fn write(directory: &Path, summary: &BagSummary) -> Result<(), BagError> {
    let (place, beside) = (directory.join(FILE), directory.join(format!(".{FILE}.new")));
    let text = format!("rosbag2_bagfile_information:\n{}\n", indent(&inner(summary), 2));
    whole_file::replace(&place, &beside, text.as_bytes()).map_err(|e| BagError::at(&place, e))
}

/// The notes (`custom_data`) of a bag's file; none when it is not there or cannot be read.
pub(crate) fn notes(directory: &Path) -> BTreeMap<String, String> {
    let text = yaml::read_text(&directory.join(FILE)).unwrap_or_default();
    let documents = yaml::parse(&text).unwrap_or_default();
    let notes = documents.first().map(|yaml| &yaml["rosbag2_bagfile_information"]["custom_data"]);
    let Some(Yaml::Hash(notes)) = notes else { return BTreeMap::new() };
    let text = |yaml: &Yaml| match yaml {
        Yaml::String(text) => Some(text.clone()),
        Yaml::Integer(number) => Some(number.to_string()),
        _ => None,
    };
    notes.iter().filter_map(|(key, value)| Some((text(key)?, text(value)?))).collect()
}

/// The inner map, as an MCAP's Metadata record `rosbag2` holds it too.
pub(crate) fn inner(summary: &BagSummary) -> String {
    let mut yaml = String::from("version: 9\nstorage_identifier: mcap\n");
    push_times(&mut yaml, summary.start, summary.duration, summary.message_count);
    yaml.push_str("topics_with_message_count:");
    if summary.topics.is_empty() {
        yaml.push_str(" []");
    }
    yaml.push('\n');
    summary.topics.iter().for_each(|topic| push_topic(&mut yaml, topic));
    yaml.push_str("compression_format: \"\"\ncompression_mode: \"\"\nrelative_file_paths:\n");
    for file in &summary.files {
        // Writing into a String cannot fail.
        let _ = writeln!(yaml, "  - {}", quoted(&file.name));
    }
    yaml.push_str("files:\n");
    summary.files.iter().for_each(|file| push_file(&mut yaml, file));
    yaml.push_str("custom_data:");
    if summary.notes.is_empty() {
        yaml.push_str(" ~");
    }
    yaml.push('\n');
    for (key, value) in &summary.notes {
        let _ = writeln!(yaml, "  {}: {}", quoted(key), quoted(value));
    }
    yaml.push_str("ros_distro: jazzy\n");
    yaml
}

fn push_times(yaml: &mut String, start: u64, duration: u64, count: u64) {
    let _ = write!(
        yaml,
        "duration:\n  nanoseconds: {duration}\nstarting_time:\n  nanoseconds_since_epoch: {start}\nmessage_count: {count}\n"
    );
}

fn push_file(yaml: &mut String, file: &FileSummary) {
    let (start, end) = file.times.unwrap_or_default();
    let mut times = String::new();
    push_times(&mut times, start, end - start, file.message_count);
    let _ = writeln!(yaml, "  - path: {}\n{}", quoted(&file.name), indent(&times, 4));
}

fn push_topic(yaml: &mut String, topic: &TopicSummary) {
    let qos = if topic.qos.is_empty() { " []".to_owned() } else { format!("\n{}", indent(&topic.qos, 8)) };
    let _ = write!(
        yaml,
        "  - topic_metadata:\n      name: {}\n      type: {}\n      serialization_format: cdr\n      \
         offered_qos_profiles:{qos}\n      type_description_hash: {}\n    message_count: {}\n",
        topic.name,
        topic.type_name,
        quoted(&topic.type_hash),
        topic.message_count
    );
}

fn quoted(text: &str) -> String {
    format!("\"{}\"", text.replace('\\', "\\\\").replace('"', "\\\""))
}

fn indent(text: &str, by: usize) -> String {
    let space = " ".repeat(by);
    text.lines().map(|line| format!("{space}{line}")).collect::<Vec<_>>().join("\n")
}
