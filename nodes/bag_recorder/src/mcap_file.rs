//! One MCAP file under the pen. What has been flushed stays readable whatever happens to the process.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use mcap::records::{MessageHeader, Metadata};

use crate::summary::{BagSummary, FileSummary, TopicSummary};
use crate::{BagError, Topic, metadata};

/// A chunk is closed when it holds so many bytes, uncompressed.
const CHUNK_BYTES: u64 = 512 * 1024;
/// Bytes of a message record beside its data.
const MESSAGE_BYTES: u64 = 31;

/// How every file here is written: whole chunks only, so that one that is cut short costs nothing else.
pub(crate) fn options() -> mcap::WriteOptions {
    mcap::WriteOptions::new()
        .profile("ros2")
        .library(concat!("patchmill ", env!("CARGO_PKG_VERSION")))
        .compression(Some(mcap::Compression::Zstd))
        .compression_threads(0)
        .chunk_size(Some(CHUNK_BYTES))
        .disable_seeking(true)
}

/// A file that counts what is written to it and goes forward only.
pub(crate) struct ForwardFile {
    out: BufWriter<File>,
    position: Arc<AtomicU64>,
}

impl ForwardFile {
    /// A new file, locked as long as it is open.
    pub(crate) fn create(path: &Path) -> Result<Self, BagError> {
        let file = File::create_new(path).map_err(|e| BagError::at(path, e))?;
        file.try_lock().map_err(|e| BagError::at(path, e))?;
        Ok(Self { out: BufWriter::new(file), position: Arc::default() })
    }

    /// Writes what is left and waits for the disk.
    pub(crate) fn close(self) -> io::Result<()> {
        self.out.into_inner().map_err(io::IntoInnerError::into_error)?.sync_all()
    }
}

impl Write for ForwardFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = self.out.write(bytes)?;
        self.position.fetch_add(written as u64, Ordering::Relaxed);
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }
}

impl Seek for ForwardFile {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        match to {
            SeekFrom::Current(0) => Ok(self.position.load(Ordering::Relaxed)),
            _ => Err(io::ErrorKind::Unsupported.into()),
        }
    }
}

/// An MCAP file that is being written.
pub(crate) struct McapFile {
    path: PathBuf,
    mcap: mcap::Writer<ForwardFile>,
    position: Arc<AtomicU64>,
    /// Bytes in the open chunk, uncompressed.
    pending: u64,
    channels: BTreeMap<String, u16>,
    summary: FileSummary,
}

impl McapFile {
    /// A new file; its head is on disk when this returns.
    pub(crate) fn create(directory: &Path, name: String) -> Result<Self, BagError> {
        let path = directory.join(&name);
        let out = ForwardFile::create(&path)?;
        let position = Arc::clone(&out.position);
        let mut mcap = options().create(out).map_err(|e| BagError::mcap(&path, &e))?;
        mcap.flush().map_err(|e| BagError::mcap(&path, &e))?;
        let summary = FileSummary::of(name);
        Ok(Self { path, mcap, position, pending: 0, channels: BTreeMap::new(), summary })
    }

    pub(crate) fn summary(&self) -> &FileSummary {
        &self.summary
    }

    /// Largest size that the data can have when the open chunk is closed, bytes.
    pub(crate) fn size(&self) -> u64 {
        self.position.load(Ordering::Relaxed) + self.pending
    }

    pub(crate) fn write(
        &mut self,
        topic: &Topic,
        sequence: u32,
        time: u64,
        bytes: &[u8],
    ) -> Result<(), BagError> {
        let channel_id = self.channel(topic)?;
        let header = MessageHeader { channel_id, sequence, log_time: time, publish_time: time };
        self.mcap.write_to_known_channel(&header, bytes).map_err(|e| BagError::mcap(&self.path, &e))?;
        self.summary.count(&topic.name, time, || topic.summary());
        self.pending += MESSAGE_BYTES + bytes.len() as u64;
        if self.pending >= CHUNK_BYTES { self.flush() } else { Ok(()) }
    }

    /// Closes the open chunk and gives it to the system: a killed process does not take it along.
    pub(crate) fn flush(&mut self) -> Result<(), BagError> {
        self.pending = 0;
        self.mcap.flush().map_err(|e| BagError::mcap(&self.path, &e))
    }

    fn channel(&mut self, topic: &Topic) -> Result<u16, BagError> {
        if let Some(id) = self.channels.get(&topic.name) {
            return Ok(*id);
        }
        let fail = |e| BagError::mcap(&self.path, &e);
        let schema =
            self.mcap.add_schema(topic.type_name, "ros2msg", topic.definition.as_bytes()).map_err(fail)?;
        let described = BTreeMap::from([
            ("offered_qos_profiles".to_owned(), topic.qos.rosbag_yaml()),
            ("topic_type_hash".to_owned(), topic.type_hash.to_owned()),
        ]);
        let id = self.mcap.add_channel(schema, &topic.name, "cdr", &described).map_err(fail)?;
        self.channels.insert(topic.name.clone(), id);
        Ok(id)
    }

    /// Ends the file with its summary. Everything is on disk when this returns.
    pub(crate) fn finish(mut self) -> Result<FileSummary, BagError> {
        let alone = BagSummary::of(vec![self.summary.clone()], BTreeMap::new());
        let record = Metadata {
            name: "rosbag2".to_owned(),
            metadata: BTreeMap::from([("serialized_metadata".to_owned(), metadata::inner(&alone))]),
        };
        let path = self.path;
        self.mcap.write_metadata(&record).map_err(|e| BagError::mcap(&path, &e))?;
        self.mcap.finish().map_err(|e| BagError::mcap(&path, &e))?;
        self.mcap.into_inner().close().map_err(|e| BagError::at(&path, e))?;
        Ok(self.summary)
    }
}

impl Topic {
    fn summary(&self) -> TopicSummary {
        TopicSummary {
            name: self.name.clone(),
            type_name: self.type_name.to_owned(),
            type_hash: self.type_hash.to_owned(),
            qos: self.qos.rosbag_yaml(),
            message_count: 0,
        }
    }
}
