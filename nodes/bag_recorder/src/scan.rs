//! Reads an MCAP file from its beginning, as far as whole chunks go: also one whose writer was killed.
//!
//! By own code, for `mcap`'s reader (0.26) takes memory for the length that a text in a record or in a chunk's head states, true or not.
//! What records hold is read by `mcap`, once their lengths are known to be true.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use crc32fast::Hasher;
use mcap::records::{MessageHeader, Record, op};
use mcap::{Channel, MAGIC, Schema};
use patchmill_node_runtime::regular_file;

use crate::BagError;

/// No record is longer, and no chunk unpacked, bytes.
const LONGEST_RECORD: usize = 64 << 20;
/// Bytes of a record's kind and length.
const HEAD: usize = 1 + 8;

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
    visit: impl FnMut(&Arc<Channel<'static>>, &MessageHeader, &[u8]) -> Result<(), BagError>,
) -> Result<bool, BagError> {
    let fail = |e: &dyn std::fmt::Display| BagError::at(path, e);
    let mut file = regular_file::open(path).map_err(|e| fail(&e))?;
    let ended = has_end(&mut file).map_err(|e| fail(&e))?;
    let size = file.metadata().map_err(|e| fail(&e))?.len();
    let mut source =
        Records { left: size, source: BufReader::new(file), sum: Hasher::new(), record: Vec::new() };
    let mut reader = Reader { path, channels: Channels::default(), visit };
    let end = source.magic(path).and_then(|()| reader.file(&mut source));
    match end {
        Ok(()) => Ok(ended),
        // A file without an end is read as far as it goes.
        Err(Stop::Damaged(_)) if !ended => Ok(false),
        Err(Stop::Damaged(what)) => Err(fail(&format!("the file is damaged: {what}"))),
        Err(Stop::Failed(error)) => Err(error),
    }
}

/// Why a file is not read to its end.
enum Stop {
    /// What is wrong with it.
    Damaged(String),
    /// It cannot be read, or who is told of its messages has had enough.
    Failed(BagError),
}

fn damaged<T>(what: impl Into<String>) -> Result<T, Stop> {
    Err(Stop::Damaged(what.into()))
}

/// The records of a file, one after the other. No memory is taken for what is not there.
struct Records {
    source: BufReader<File>,
    /// Bytes that have not been read.
    left: u64,
    /// Of all that has been read.
    sum: Hasher,
    /// The last record's content.
    record: Vec<u8>,
}

impl Records {
    /// Reads `length` bytes into the record.
    fn fill(&mut self, path: &Path, length: u64) -> Result<(), Stop> {
        if length > self.left {
            return damaged(format!("{length} bytes are stated where {} are left", self.left));
        }
        if length > LONGEST_RECORD as u64 {
            return damaged(format!("a record has {length} bytes; at most {LONGEST_RECORD} were expected"));
        }
        self.left -= length;
        self.record.resize(length as usize, 0);
        self.source.read_exact(&mut self.record).map_err(|e| Stop::Failed(BagError::at(path, e)))
    }

    fn magic(&mut self, path: &Path) -> Result<(), Stop> {
        self.fill(path, MAGIC.len() as u64)?;
        self.sum.update(&self.record);
        if self.record == MAGIC {
            return Ok(());
        }
        Err(Stop::Failed(BagError::at(path, "the file is damaged: it does not begin as an MCAP file does")))
    }

    /// The next record's kind, its content in `record`; none at the end of the file.
    fn next(&mut self, path: &Path) -> Result<Option<u8>, Stop> {
        if self.left == 0 {
            return Ok(None);
        }
        self.fill(path, HEAD as u64)?;
        let Some((opcode, length)) = head(&self.record) else { return damaged("a record has no head") };
        if opcode != op::DATA_END {
            self.sum.update(&self.record);
        }
        self.fill(path, length)?;
        if opcode != op::DATA_END {
            self.sum.update(&self.record);
        }
        Ok(Some(opcode))
    }
}

/// Kind and length of the record that begins here.
fn head(bytes: &[u8]) -> Option<(u8, u64)> {
    let (opcode, rest) = bytes.split_first()?;
    Some((*opcode, u64::from_le_bytes(*rest.first_chunk()?)))
}

struct Reader<'a, V> {
    path: &'a Path,
    channels: Channels,
    visit: V,
}

impl<V: FnMut(&Arc<Channel<'static>>, &MessageHeader, &[u8]) -> Result<(), BagError>> Reader<'_, V> {
    fn file(&mut self, source: &mut Records) -> Result<(), Stop> {
        while let Some(opcode) = source.next(self.path)? {
            match opcode {
                // The summary says it all once more.
                op::FOOTER => return Ok(()),
                op::DATA_END => {
                    let stated = number(&source.record, 0)?;
                    let found = source.sum.clone().finalize();
                    return if stated == 0 || stated == found {
                        Ok(())
                    } else {
                        damaged("its sum is another one")
                    };
                }
                op::CHUNK => {
                    let content = unpacked(&source.record)?;
                    self.chunk(&content)?;
                }
                _ => self.record(opcode, &source.record)?,
            }
        }
        Ok(())
    }

    fn chunk(&mut self, mut content: &[u8]) -> Result<(), Stop> {
        while !content.is_empty() {
            let length = head(content).and_then(|(_, length)| usize::try_from(length).ok());
            let record = length.and_then(|length| content[HEAD..].get(..length));
            let Some(record) = record else { return damaged("a record goes beyond its chunk") };
            self.record(content[0], record)?;
            content = &content[HEAD + record.len()..];
        }
        Ok(())
    }

    fn record(&mut self, opcode: u8, record: &[u8]) -> Result<(), Stop> {
        if !matches!(opcode, op::SCHEMA | op::CHANNEL | op::MESSAGE) {
            return Ok(());
        }
        if texts_fit(opcode, record).is_none() {
            return damaged("a text or a list goes beyond its record");
        }
        match mcap::parse_record(opcode, record).map_err(|e| Stop::Damaged(e.to_string()))? {
            Record::Schema { header, data } => {
                let (id, name, encoding) = (header.id, header.name, header.encoding);
                let schema = Schema { id, name, encoding, data: data.into_owned().into() };
                self.channels.add_schema(schema)?;
            }
            Record::Channel(channel) => self.channels.add(channel)?,
            Record::Message { header, data } => {
                let Some(channel) = self.channels.channels.get(&header.channel_id) else {
                    let text = format!("a message of the unknown channel {}", header.channel_id);
                    return Err(Stop::Failed(BagError::at(self.path, text)));
                };
                (self.visit)(channel, &header, &data).map_err(Stop::Failed)?;
            }
            _ => {}
        }
        Ok(())
    }
}

/// The four bytes at a place of a record as a number.
fn number(record: &[u8], at: usize) -> Result<u32, Stop> {
    match record.get(at..).and_then(|rest| rest.first_chunk()) {
        Some(bytes) => Ok(u32::from_le_bytes(*bytes)),
        None => damaged("a record is too short"),
    }
}

/// Whether the texts and lists of a schema or a channel lie within the record: `mcap` takes memory for what they state.
fn texts_fit(opcode: u8, record: &[u8]) -> Option<()> {
    match opcode {
        // Its number; name, encoding and definition.
        op::SCHEMA => {
            let mut rest = record.get(2..)?;
            (0..3).try_for_each(|_| skip(&mut rest).map(drop))
        }
        // Its number and the schema's; topic, encoding and a list of texts.
        op::CHANNEL => {
            let mut rest = record.get(4..)?;
            skip(&mut rest)?;
            skip(&mut rest)?;
            let mut list = skip(&mut rest)?;
            while !list.is_empty() {
                skip(&mut list)?;
            }
            Some(())
        }
        _ => Some(()),
    }
}

/// What follows its length of four bytes; `rest` then begins after it.
fn skip<'a>(rest: &mut &'a [u8]) -> Option<&'a [u8]> {
    let (length, after) = rest.split_first_chunk::<4>()?;
    let (part, after) = after.split_at_checked(u32::from_le_bytes(*length) as usize)?;
    *rest = after;
    Some(part)
}

/// The records of a chunk, its sum checked: [start, end, size unpacked, sum, compression, size], then what is compressed.
fn unpacked(chunk: &[u8]) -> Result<Cow<'_, [u8]>, Stop> {
    const FIXED: usize = 8 + 8;
    let parts = || {
        let (size, rest) = chunk.get(FIXED..)?.split_first_chunk::<8>()?;
        let (sum, mut rest) = rest.split_first_chunk::<4>()?;
        let compression = skip(&mut rest)?;
        let (packed, rest) = rest.split_first_chunk::<8>()?;
        let packed = rest.get(..usize::try_from(u64::from_le_bytes(*packed)).ok()?)?;
        Some((u64::from_le_bytes(*size), u32::from_le_bytes(*sum), compression, packed))
    };
    let Some((size, sum, compression, packed)) = parts() else { return damaged("a chunk is too short") };
    if size > LONGEST_RECORD as u64 {
        return damaged(format!("a chunk has {size} bytes unpacked; at most {LONGEST_RECORD} were expected"));
    }
    let content = match compression {
        b"" => Cow::Borrowed(packed),
        b"zstd" => match zstd::bulk::decompress(packed, size as usize) {
            Ok(content) => Cow::Owned(content),
            Err(e) => return damaged(format!("a chunk cannot be unpacked: {e}")),
        },
        other => {
            let name = String::from_utf8_lossy(&other[..other.len().min(40)]).into_owned();
            return damaged(format!("a chunk is compressed by '{}'; zstd was expected", name.escape_debug()));
        }
    };
    if content.len() as u64 != size || (sum != 0 && sum != crc32fast::hash(&content)) {
        return damaged("a chunk has another length or sum than it states");
    }
    Ok(content)
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
    fn add_schema(&mut self, schema: Schema<'static>) -> Result<(), Stop> {
        described_once("schema", schema.id, self.schemas.entry(schema.id), schema)
    }

    fn add(&mut self, channel: mcap::records::Channel) -> Result<(), Stop> {
        let channel = Channel {
            id: channel.id,
            topic: channel.topic,
            schema: self.schemas.get(&channel.schema_id).cloned(),
            message_encoding: channel.message_encoding,
            metadata: channel.metadata,
        };
        described_once("channel", channel.id, self.channels.entry(channel.id), channel)
    }
}

/// Takes a description, which may come again, but not as another one: `mcap`'s writer relies on it.
fn described_once<T: PartialEq>(
    what: &str,
    id: u16,
    known: Entry<'_, u16, Arc<T>>,
    new: T,
) -> Result<(), Stop> {
    match known {
        Entry::Occupied(known) if **known.get() != new => {
            damaged(format!("{what} {id} is described twice, each time otherwise"))
        }
        Entry::Occupied(_) => Ok(()),
        Entry::Vacant(place) => {
            place.insert(Arc::new(new));
            Ok(())
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const END: [(u8, Vec<u8>); 2] = [(op::DATA_END, Vec::new()), (op::FOOTER, Vec::new())];

    fn text(text: &str) -> Vec<u8> {
        [&(text.len() as u32).to_le_bytes(), text.as_bytes()].concat()
    }

    fn schema(name: &str) -> (u8, Vec<u8>) {
        (op::SCHEMA, [vec![1, 0], text(name), text("ros2msg"), text("")].concat())
    }

    fn channel(topic: &str) -> (u8, Vec<u8>) {
        (op::CHANNEL, [vec![1, 0, 1, 0], text(topic), text("cdr"), text("")].concat())
    }

    fn chunk(size: u64, compression: &str, content: &[u8]) -> (u8, Vec<u8>) {
        let head = [&[0; 16], size.to_le_bytes().as_slice(), &[0; 4], &text(compression)].concat();
        (op::CHUNK, [&head, (content.len() as u64).to_le_bytes().as_slice(), content].concat())
    }

    fn records(records: &[(u8, Vec<u8>)]) -> Vec<u8> {
        let one = |(opcode, content): &(u8, Vec<u8>)| {
            [&[*opcode], (content.len() as u64).to_le_bytes().as_slice(), content].concat()
        };
        records.iter().flat_map(one).collect()
    }

    /// What a file of these bytes between its magics is refused with.
    fn refused(content: &[u8]) -> String {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a.mcap");
        std::fs::write(&file, [MAGIC, content, MAGIC].concat()).unwrap();
        scan(&file, |_, _, _| Ok(())).unwrap_err().text
    }

    /// Inputs of the fuzzer, by hand: lengths that are not true took gigabytes, or did not end.
    #[test]
    fn lengths_that_are_not_true_are_refused() {
        let with_end = |first: (u8, Vec<u8>)| {
            let mut all = vec![first];
            all.extend(END);
            records(&all)
        };
        let long = (op::SCHEMA, [vec![1, 0], vec![0xff, 0xff, 0xff, 0x7f], vec![0; 9]].concat());
        let packed = zstd::bulk::compress(&[0; 100], 1).unwrap();
        let mut stated = records(&[(op::ATTACHMENT, Vec::new())]);
        stated[1..9].copy_from_slice(&(1u64 << 40).to_le_bytes());
        let inner = [op::MESSAGE, 0xff, 0, 0, 0, 0, 0, 0, 0];
        for (content, words) in [
            (with_end(long), "a text or a list goes beyond its record"),
            (with_end(chunk(1 << 40, "zstd", &packed)), "1099511627776 bytes unpacked; at most 67108864"),
            (with_end(chunk(101, "zstd", &packed)), "another length or sum"),
            (with_end(chunk(99, "zstd", &packed)), "cannot be unpacked"),
            (with_end(chunk(9, "", &inner)), "a record goes beyond its chunk"),
            (with_end(chunk(3, "lz4", b"abc")), "compressed by 'lz4'; zstd was expected"),
            (with_end((op::CHUNK, vec![0; 20])), "a chunk is too short"),
            (stated, "1099511627776 bytes are stated where 8 are left"),
        ] {
            let error = refused(&content);
            assert!(error.contains("the file is damaged: ") && error.contains(words), "{words}: {error}");
        }
    }

    /// A find of the fuzzer: `mcap`'s writer panicked when such a bag was repaired.
    #[test]
    fn a_channel_that_changes_is_refused() {
        let twice = [schema("a"), channel("/a"), schema("a"), channel("/a")];
        assert!(!refused(&records(&twice)).contains("described twice"));
        let other = [schema("a"), channel("/a"), channel("/b")];
        assert!(refused(&records(&other)).contains("channel 1 is described twice"));
        assert!(refused(&records(&[schema("a"), schema("b")])).contains("schema 1 is described twice"));
    }
}
