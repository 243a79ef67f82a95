//! Writes a bag: `DIR/DIR_0.mcap`, `DIR_1.mcap` … and `DIR/metadata.yaml`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use patchmill_msgs::{RosType, cdr};
use patchmill_node_runtime::Qos;

use crate::mcap_file::McapFile;
use crate::summary::BagSummary;
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
    /// The type's hash (RIHS01).
    pub type_hash: &'static str,
    /// Offered quality of service.
    pub qos: Qos,
}

impl Topic {
    /// A topic of messages `T`.
    pub fn of<T: RosType>(name: impl Into<String>, qos: Qos) -> Self {
        Self {
            name: name.into(),
            type_name: T::TYPE_NAME,
            definition: T::DEFINITION,
            type_hash: T::TYPE_HASH,
            qos,
        }
    }
}

/// How a bag is written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BagOptions {
    /// A new file is begun before one has more bytes of data than this; 0: never.
    pub max_file_bytes: u64,
}

/// Writes a bag, message by message.
///
/// `metadata.yaml` is there, whole, from the first moment on; it is written anew with every file, note and at the end.
/// Without [`BagWriter::finish`] the last file lacks its summary: [`crate::BagReader`] reads it all the same, other
/// readers after [`repair`](crate::repair()).
pub struct BagWriter {
    directory: PathBuf,
    name: String,
    options: BagOptions,
    closed: Vec<crate::FileSummary>,
    file: McapFile,
    latest: u64,
    sequence: u32,
    notes: BTreeMap<String, String>,
}

impl BagWriter {
    /// A new bag of one file in a directory that does not exist or is empty.
    ///
    /// # Errors
    /// When the directory has files or cannot be written.
    pub fn create(directory: &Path) -> Result<Self, BagError> {
        Self::create_with(directory, BagOptions::default())
    }

    /// A new bag in a directory that does not exist or is empty.
    ///
    /// # Errors
    /// When the directory has files or cannot be written.
    pub fn create_with(directory: &Path, options: BagOptions) -> Result<Self, BagError> {
        let fail = |e: &dyn std::fmt::Display| BagError::at(directory, e);
        std::fs::create_dir_all(directory).map_err(|e| fail(&e))?;
        if std::fs::read_dir(directory).map_err(|e| fail(&e))?.next().is_some() {
            return Err(fail(&"the directory is not empty"));
        }
        let name = directory.file_name().map_or_else(|| "bag".into(), |n| n.to_string_lossy().into_owned());
        let bag = Self {
            directory: directory.to_path_buf(),
            file: McapFile::create(directory, file_name(&name, 0))?,
            name,
            options,
            closed: Vec::new(),
            latest: 0,
            sequence: 0,
            notes: BTreeMap::new(),
        };
        bag.write_metadata()?;
        Ok(bag)
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
        self.latest = self.latest.max(time);
        let most = self.options.max_file_bytes;
        let holds_some = self.file.summary().message_count > 0;
        if most > 0 && holds_some && self.file.size() + bytes.len() as u64 > most {
            self.next_file()?;
        }
        self.file.write(topic, self.sequence, self.latest, bytes)?;
        self.sequence = self.sequence.wrapping_add(1);
        Ok(())
    }

    /// Puts everything so far where a killed process does not take it along.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn flush(&mut self) -> Result<(), BagError> {
        self.file.flush()
    }

    /// Puts notes into `metadata.yaml` (`custom_data`), at once.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn note(&mut self, notes: &[(&str, String)]) -> Result<(), BagError> {
        self.notes.extend(notes.iter().map(|(key, value)| ((*key).to_owned(), value.clone())));
        self.write_metadata()
    }

    /// Ends the bag. Everything is in the files when this returns.
    ///
    /// # Errors
    /// When the files cannot be written.
    pub fn finish(mut self) -> Result<BagSummary, BagError> {
        self.closed.push(self.file.finish()?);
        let summary = BagSummary::of(self.closed, self.notes);
        metadata::write(&self.directory, &summary)?;
        Ok(summary)
    }

    fn next_file(&mut self) -> Result<(), BagError> {
        let name = file_name(&self.name, self.closed.len() + 1);
        let full = std::mem::replace(&mut self.file, McapFile::create(&self.directory, name)?);
        self.closed.push(full.finish()?);
        self.write_metadata()
    }

    fn write_metadata(&self) -> Result<(), BagError> {
        let mut files = self.closed.clone();
        files.push(self.file.summary().clone());
        metadata::write(&self.directory, &BagSummary::of(files, self.notes.clone()))
    }
}

fn file_name(bag: &str, number: usize) -> String {
    format!("{bag}_{number}.mcap")
}
