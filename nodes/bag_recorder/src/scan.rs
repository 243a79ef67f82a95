//! Reads an MCAP file from its beginning, as far as whole chunks go: also one whose writer was killed.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use mcap::records::{MessageHeader, Record, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use mcap::{Channel, MAGIC, McapError, Schema};

use crate::BagError;

/// No record or chunk is longer, bytes.
const LONGEST_RECORD: usize = 1 << 30;

/// The `.mcap` files of a bag's directory, those of a split bag in the order of their numbers.
///
/// # Errors
/// When the directory cannot be read or has no such file.
pub(crate) fn files(directory: &Path) -> Result<Vec<PathBuf>, BagError> {
    let entries = std::fs::read_dir(directory).map_err(|e| BagError::at(directory, e))?;
    let hidden = |path: &Path| path.file_name().is_some_and(|n| n.to_string_lossy().starts_with('.'));
    let mut paths: Vec<PathBuf> = entries
        .filter_map(|entry| entry.ok().map(|e| e.path()))
        .filter(|path| path.extension().is_some_and(|e| e == "mcap") && !hidden(path))
        .collect();
    paths.sort_by_cached_key(|path| {
        let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        match stem.rsplit_once('_').and_then(|(name, n)| Some((name.to_owned(), n.parse::<u64>().ok()?))) {
            Some((name, number)) => (name, number),
            None => (stem, 0),
        }
    });
    if paths.is_empty() {
        return Err(BagError::at(directory, "there is no .mcap file"));
    }
    Ok(paths)
}

/// Calls `visit` with every message of a file, in the order of the file. `false` when the file has no end: its writer was
/// killed, or is still at work.
///
/// # Errors
/// When the file cannot be read, is no MCAP file or is damaged before its end; what `visit` says.
pub(crate) fn scan(
    path: &Path,
    mut visit: impl FnMut(&Arc<Channel<'static>>, &MessageHeader, &[u8]) -> Result<(), BagError>,
) -> Result<bool, BagError> {
    let fail = |e: &dyn std::fmt::Display| BagError::at(path, e);
    let damaged = |e: &McapError| fail(&format!("the file is damaged: {e}"));
    let mut file = File::open(path).map_err(|e| fail(&e))?;
    let ended = has_end(&mut file).map_err(|e| fail(&e))?;
    let mut source = BufReader::new(file);
    let mut reader = LinearReader::new_with_options(
        LinearReaderOptions::default()
            .with_skip_end_magic(true)
            .with_prevalidate_chunk_crcs(true)
            .with_validate_data_section_crc(true)
            .with_record_length_limit(LONGEST_RECORD),
    );
    let mut channels = Channels::default();
    while let Some(event) = reader.next_event() {
        let (opcode, data) = match event {
            Ok(LinearReadEvent::ReadRequest(need)) => {
                let read = source.read(reader.insert(need)).map_err(|e| fail(&e))?;
                reader.notify_read(read);
                continue;
            }
            Ok(LinearReadEvent::Record { opcode, data }) => (opcode, data),
            // A file without an end is read as far as it goes.
            Err(e) if !ended && !matches!(e, McapError::BadMagic) => return Ok(false),
            Err(e) => return Err(damaged(&e)),
        };
        // The summary says it all once more.
        if matches!(opcode, op::DATA_END | op::FOOTER) {
            return Ok(ended);
        }
        let record = match mcap::parse_record(opcode, data) {
            Ok(record) => record,
            Err(_) if !ended => return Ok(false),
            Err(e) => return Err(damaged(&e)),
        };
        match record {
            Record::Schema { header, data } => {
                let (id, name, encoding) = (header.id, header.name, header.encoding);
                let schema = Schema { id, name, encoding, data: data.into_owned().into() };
                channels.schemas.insert(id, Arc::new(schema));
            }
            Record::Channel(channel) => channels.add(channel),
            Record::Message { header, data } => {
                let channel = channels.channels.get(&header.channel_id);
                let unknown = || fail(&format!("a message of the unknown channel {}", header.channel_id));
                visit(channel.ok_or_else(unknown)?, &header, &data)?;
            }
            _ => {}
        }
    }
    Ok(ended)
}

/// Whether the file ends as a whole one does.
fn has_end(file: &mut File) -> std::io::Result<bool> {
    let mut end = [0; 8];
    if file.metadata()?.len() < 2 * MAGIC.len() as u64 {
        return Ok(false);
    }
    file.seek(SeekFrom::End(-(MAGIC.len() as i64)))?;
    file.read_exact(&mut end)?;
    file.rewind()?;
    Ok(end == MAGIC)
}

#[derive(Default)]
struct Channels {
    schemas: BTreeMap<u16, Arc<Schema<'static>>>,
    channels: BTreeMap<u16, Arc<Channel<'static>>>,
}

impl Channels {
    fn add(&mut self, channel: mcap::records::Channel) {
        let channel = Channel {
            id: channel.id,
            topic: channel.topic,
            schema: self.schemas.get(&channel.schema_id).cloned(),
            message_encoding: channel.message_encoding,
            metadata: channel.metadata,
        };
        self.channels.insert(channel.id, Arc::new(channel));
    }
}
