//! Writes a bag: `DIR/DIR_0.mcap` and `DIR/metadata.yaml`.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use mcap::records::{MessageHeader, Metadata};
use patchmill_msgs::{RosType, cdr};
use patchmill_node_runtime::Qos;

use crate::{BagError, metadata};

/// A topic as the bag describes it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Topic {
    /// Absolute name.
    pub name: String,
    /// Full name of its type.
    pub type_name: &'static str,
    /// The type's definition with all nested ones, as ros2msg.
    pub definition: &'static str,
    /// Offered quality of service.
    pub qos: Qos,
}

impl Topic {
    /// A topic of messages `T`.
    pub fn of<T: RosType>(name: impl Into<String>, qos: Qos) -> Self {
        Self { name: name.into(), type_name: T::TYPE_NAME, definition: T::DEFINITION, qos }
    }
}

/// What a bag holds.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BagSummary {
    /// Time of the first message, ns since 1970; 0 without messages.
    pub start: u64,
    /// From the first to the last message, ns.
    pub duration: u64,
    /// Messages in all.
    pub message_count: u64,
    /// The topics by name.
    pub topics: Vec<TopicSummary>,
}

/// What a bag holds of one topic.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TopicSummary {
    /// Absolute name.
    pub name: String,
    /// Full name of its type.
    pub type_name: String,
    /// Offered quality of service (YAML).
    pub qos: String,
    /// Messages.
    pub message_count: u64,
}

struct Channel {
    id: u16,
    summary: TopicSummary,
}

/// Writes a bag, message by message.
pub struct BagWriter {
    directory: PathBuf,
    file: String,
    mcap: mcap::Writer<BufWriter<File>>,
    channels: BTreeMap<String, Channel>,
    times: Option<(u64, u64)>,
    message_count: u64,
}

impl BagWriter {
    /// A new bag in a directory that does not exist or is empty.
    ///
    /// # Errors
    /// When the directory has files or cannot be written.
    pub fn create(directory: &Path) -> Result<Self, BagError> {
        let fail = |e: &dyn std::fmt::Display| BagError::at(directory, e);
        std::fs::create_dir_all(directory).map_err(|e| fail(&e))?;
        if std::fs::read_dir(directory).map_err(|e| fail(&e))?.next().is_some() {
            return Err(fail(&"the directory is not empty"));
        }
        let name = directory.file_name().map_or_else(|| "bag".into(), |n| n.to_string_lossy().into_owned());
        let file = format!("{name}_0.mcap");
        let out = File::create(directory.join(&file)).map_err(|e| fail(&e))?;
        let mcap = mcap::WriteOptions::new()
            .profile("ros2")
            .library(concat!("patchmill ", env!("CARGO_PKG_VERSION")))
            .compression(Some(mcap::Compression::Zstd))
            .compression_threads(0)
            .create(BufWriter::new(out))
            .map_err(|e| fail(&e))?;
        Ok(Self {
            directory: directory.to_path_buf(),
            file,
            mcap,
            channels: BTreeMap::new(),
            times: None,
            message_count: 0,
        })
    }

    /// Adds a message received at `time`, ns since 1970.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn write<T: RosType>(&mut self, topic: &Topic, time: u64, message: &T) -> Result<(), BagError> {
        self.write_bytes(topic, time, &cdr::to_cdr(message))
    }

    /// Adds a message as CDR bytes with their header. Times do not decrease: an earlier one counts as the latest.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn write_bytes(&mut self, topic: &Topic, time: u64, bytes: &[u8]) -> Result<(), BagError> {
        let (start, latest) = self.times.unwrap_or((time, time));
        let time = time.max(latest);
        self.times = Some((start, time));
        let id = self.channel(topic)?;
        let sequence = self.message_count as u32;
        let header = MessageHeader { channel_id: id, sequence, log_time: time, publish_time: time };
        self.mcap.write_to_known_channel(&header, bytes).map_err(|e| BagError::at(&self.directory, e))?;
        self.message_count += 1;
        Ok(())
    }

    fn channel(&mut self, topic: &Topic) -> Result<u16, BagError> {
        if let Some(channel) = self.channels.get_mut(&topic.name) {
            channel.summary.message_count += 1;
            return Ok(channel.id);
        }
        let fail = |e| BagError::at(&self.directory, e);
        let qos = topic.qos.rosbag_yaml();
        let schema =
            self.mcap.add_schema(topic.type_name, "ros2msg", topic.definition.as_bytes()).map_err(fail)?;
        let described = BTreeMap::from([("offered_qos_profiles".to_owned(), qos.clone())]);
        let id = self.mcap.add_channel(schema, &topic.name, "cdr", &described).map_err(fail)?;
        let summary = TopicSummary {
            name: topic.name.clone(),
            type_name: topic.type_name.to_owned(),
            qos,
            message_count: 1,
        };
        self.channels.insert(topic.name.clone(), Channel { id, summary });
        Ok(id)
    }

    /// Ends the bag. Everything is in the files when this returns.
    ///
    /// # Errors
    /// When the files cannot be written.
    pub fn finish(mut self) -> Result<BagSummary, BagError> {
        let (start, end) = self.times.unwrap_or_default();
        let summary = BagSummary {
            start,
            duration: end - start,
            message_count: self.message_count,
            topics: self.channels.into_values().map(|c| c.summary).collect(),
        };
        let inner = metadata::inner(&summary, &self.file);
        let record = Metadata {
            name: "rosbag2".to_owned(),
            metadata: BTreeMap::from([("serialized_metadata".to_owned(), inner.clone())]),
        };
        let directory = &self.directory;
        self.mcap.write_metadata(&record).map_err(|e| BagError::at(directory, e))?;
        self.mcap.finish().map_err(|e| BagError::at(directory, e))?;
        let buffered = self.mcap.into_inner();
        buffered.into_inner().map_err(|e| BagError::at(directory, e))?;
        std::fs::write(directory.join("metadata.yaml"), metadata::file(&inner))
            .map_err(|e| BagError::at(directory, e))?;
        Ok(summary)
    }
}
