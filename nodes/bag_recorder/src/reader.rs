//! Reads a bag, for replay.

use std::path::{Path, PathBuf};

use patchmill_msgs::{RosType, cdr};

use crate::BagError;

/// One message of a bag.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BagMessage {
    /// Absolute name of the topic.
    pub topic: String,
    /// Full name of the type.
    pub type_name: String,
    /// When it was received, ns since 1970.
    pub time: u64,
    /// CDR with its header.
    pub bytes: Vec<u8>,
}

impl BagMessage {
    /// The message, if it is of type `T`.
    ///
    /// # Errors
    /// When it is of another type or the bytes are no such message.
    pub fn decode<T: RosType>(&self) -> Result<T, BagError> {
        let fail = |text: String| BagError { text: format!("a message on {} {text}", self.topic) };
        if self.type_name != T::TYPE_NAME {
            return Err(fail(format!("is of type {}, {} was expected", self.type_name, T::TYPE_NAME)));
        }
        cdr::from_cdr(&self.bytes).map_err(|e| fail(format!("cannot be read: {e}")))
    }
}

/// A bag in memory.
pub struct BagReader {
    directory: PathBuf,
    files: Vec<Vec<u8>>,
}

impl BagReader {
    /// Opens a bag's directory.
    ///
    /// # Errors
    /// When it cannot be read or has no `.mcap` file.
    pub fn open(directory: &Path) -> Result<Self, BagError> {
        let fail = |e: std::io::Error| BagError::at(directory, e);
        let entries = std::fs::read_dir(directory).map_err(fail)?;
        let mut paths: Vec<PathBuf> = entries
            .filter_map(|entry| entry.ok().map(|e| e.path()))
            .filter(|path| path.extension().is_some_and(|e| e == "mcap"))
            .collect();
        paths.sort();
        if paths.is_empty() {
            return Err(BagError::at(directory, "there is no .mcap file"));
        }
        let files = paths.iter().map(std::fs::read).collect::<Result<_, _>>().map_err(fail)?;
        Ok(Self { directory: directory.to_path_buf(), files })
    }

    /// The messages in the order of the files.
    ///
    /// # Errors
    /// When a file is damaged.
    pub fn messages(&self) -> Result<Vec<BagMessage>, BagError> {
        let fail = |e: mcap::McapError| BagError::at(&self.directory, e);
        let mut messages = Vec::new();
        for file in &self.files {
            for message in mcap::MessageStream::new(file).map_err(fail)? {
                let message = message.map_err(fail)?;
                messages.push(BagMessage {
                    topic: message.channel.topic.clone(),
                    type_name: message.channel.schema.as_ref().map(|s| s.name.clone()).unwrap_or_default(),
                    time: message.log_time,
                    bytes: message.data.into_owned(),
                });
            }
        }
        Ok(messages)
    }

    /// The messages of one topic, decoded.
    ///
    /// # Errors
    /// When a file is damaged or a message is of another type.
    pub fn decoded<T: RosType>(&self, topic: &str) -> Result<Vec<T>, BagError> {
        self.messages()?.iter().filter(|m| m.topic == topic).map(BagMessage::decode).collect()
    }
}
