//! Reads a bag, for replay.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use patchmill_msgs::{RosType, cdr};

use crate::{BagError, interface, scan};

/// Most bytes of messages that are read into memory: some plans of millions of triangles.
const MOST_BYTES: usize = 4 << 30;

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

/// A bag on disk. Files without an end, as a killed recorder leaves them, are read as far as they go.
pub struct BagReader {
    files: Vec<PathBuf>,
}

impl BagReader {
    /// Opens a bag's directory.
    ///
    /// # Errors
    /// When it cannot be read or has no `.mcap` file.
    pub fn open(directory: &Path) -> Result<Self, BagError> {
        Ok(Self { files: scan::files(directory)? })
    }

    /// The messages in the order of the files.
    ///
    /// # Errors
    /// When a file is damaged, or a message is of another version of patchmill's interfaces.
    pub fn messages(&self) -> Result<Vec<BagMessage>, BagError> {
        self.read(|_| true).map(|(messages, _)| messages)
    }

    /// The messages of one topic, decoded.
    ///
    /// # Errors
    /// As [`BagReader::messages`], and when a message is of another type than `T`.
    pub fn decoded<T: RosType>(&self, topic: &str) -> Result<Vec<T>, BagError> {
        self.read(|name| name == topic)?.0.iter().map(BagMessage::decode).collect()
    }

    /// The messages of the wanted topics, and the files that have no end.
    ///
    /// # Errors
    /// As [`BagReader::messages`].
    pub fn read(&self, wanted: impl Fn(&str) -> bool) -> Result<(Vec<BagMessage>, Vec<PathBuf>), BagError> {
        let (mut messages, mut unfinished) = (Vec::new(), Vec::new());
        let mut taken = 0usize;
        for path in &self.files {
            let mut checked = BTreeSet::new();
            let ended = scan::scan(path, |channel, header, bytes| {
                if checked.insert(channel.id) {
                    interface::check(channel)?;
                }
                if wanted(&channel.topic) {
                    taken += bytes.len();
                    if taken > MOST_BYTES {
                        let text = format!("the bag has more than {} GiB of messages", MOST_BYTES >> 30);
                        return Err(BagError::at(path, text));
                    }
                    messages.push(BagMessage {
                        topic: channel.topic.clone(),
                        type_name: channel.schema.as_ref().map(|s| s.name.clone()).unwrap_or_default(),
                        time: header.log_time,
                        bytes: bytes.to_vec(),
                    });
                }
                Ok(())
            })?;
            if !ended {
                unfinished.push(path.clone());
            }
        }
        Ok((messages, unfinished))
    }
}
