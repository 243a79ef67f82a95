//! Makes a bag whole whose recorder was killed: files without an end get their summary, `metadata.yaml` is written anew.

use std::borrow::Cow;
use std::fs::{self, TryLockError};
use std::io::ErrorKind;
use std::path::Path;
use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant};

use mcap::records::MessageHeader;
use mcap::{Channel, Message};
use patchmill_node_runtime::{regular_file, whole_file};

use crate::mcap_file::{ForwardFile, options};
use crate::summary::{BagSummary, FileSummary, TopicSummary};
use crate::{BagError, metadata, scan};

/// A file that is locked for longer is being recorded.
const LOCK_PATIENCE: Duration = Duration::from_secs(1);

/// What a repair found and did.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Repair {
    /// The files that had no end and were written anew with every message that could be read.
    pub rewritten: Vec<String>,
    /// The bag as it is now.
    pub summary: BagSummary,
}

/// Repairs a bag's directory. Whole files stay as they are; a second repair changes nothing.
///
/// # Errors
/// When the directory cannot be read or written, a file is damaged before its end, or the bag is being recorded.
pub fn repair(directory: &Path) -> Result<Repair, BagError> {
    let (mut files, mut rewritten) = (Vec::new(), Vec::new());
    for path in scan::files(directory)? {
        refuse_while_recorded(&path)?;
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let mut summary = FileSummary::of(name.clone());
        let ended = scan::scan(&path, |channel, header, _| {
            summary.count(&channel.topic, header.log_time, || described(channel));
            Ok(())
        })?;
        if !ended {
            rewrite(&path)?;
            rewritten.push(name);
        }
        files.push(summary);
    }
    let summary = BagSummary::of(files, metadata::notes(directory));
    metadata::write(directory, &summary)?;
    Ok(Repair { rewritten, summary })
}

/// A recorder holds a lock on its file, which the system frees when the recorder is killed. Any process that starts another one holds
/// its locks twice until that one runs its own program: a lock is waited for a moment before it counts.
fn refuse_while_recorded(path: &Path) -> Result<(), BagError> {
    let file = regular_file::open(path).map_err(|e| BagError::at(path, e))?;
    let begun = Instant::now();
    loop {
        match file.try_lock_shared() {
            Ok(()) => return Ok(()),
            Err(TryLockError::WouldBlock) if begun.elapsed() < LOCK_PATIENCE => {
                thread::sleep(LOCK_PATIENCE / 50)
            }
            Err(TryLockError::WouldBlock) => {
                return Err(BagError::at(path, "the bag is being recorded: end the recorder first"));
            }
            Err(TryLockError::Error(e)) => return Err(BagError::at(path, e)),
        }
    }
}

fn described(channel: &Channel<'_>) -> TopicSummary {
    let said = |key: &str| channel.metadata.get(key).cloned().unwrap_or_default();
    TopicSummary {
        name: channel.topic.clone(),
        type_name: channel.schema.as_ref().map(|s| s.name.clone()).unwrap_or_default(),
        type_hash: said("topic_type_hash"),
        qos: said("offered_qos_profiles"),
        message_count: 0,
    }
}

/// Copies every message that can be read into a file beside it, which then takes its place.
fn rewrite(path: &Path) -> Result<(), BagError> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let beside = path.with_file_name(format!(".{name}.repair"));
    let fail = |e: std::io::Error| BagError::at(path, e);
    let unwritten = |e: mcap::McapError| BagError::mcap(path, &e);
    // One that an interrupted repair left, or a link that somebody has put there.
    match fs::remove_file(&beside) {
        Err(e) if e.kind() != ErrorKind::NotFound => return Err(fail(e)),
        _ => {}
    }
    let mut whole = options().create(ForwardFile::create(&beside)?).map_err(unwritten)?;
    scan::scan(path, |channel: &Arc<Channel<'static>>, header: &MessageHeader, bytes| {
        let message = Message {
            channel: Arc::clone(channel),
            sequence: header.sequence,
            log_time: header.log_time,
            publish_time: header.publish_time,
            data: Cow::Borrowed(bytes),
        };
        whole.write(&message).map_err(unwritten)
    })?;
    whole.finish().map_err(unwritten)?;
    whole.into_inner().close().map_err(fail)?;
    fs::rename(&beside, path).and_then(|()| whole_file::sync_folder_of(path)).map_err(fail)
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::symlink;

    use patchmill_msgs::msg::Job;
    use patchmill_node_runtime::Qos;

    use super::*;
    use crate::{BagWriter, Topic};

    #[test]
    fn links_in_the_way_are_not_followed() {
        let root = tempfile::tempdir().unwrap();
        let (bag, mine) = (root.path().join("bag"), root.path().join("mine"));
        let mut writer = BagWriter::create(&bag).unwrap();
        let topic = Topic::of::<Job>("/patchmill/job", Qos::Status);
        writer.write(&topic, 5, &Job::default()).unwrap();
        writer.flush().unwrap();
        drop(writer);
        // Of a killed one the end is missing.
        let file = fs::OpenOptions::new().write(true).open(bag.join("bag_0.mcap")).unwrap();
        file.set_len(file.metadata().unwrap().len() - 1).unwrap();
        fs::write(&mine, "kept").unwrap();
        symlink(&mine, bag.join(".metadata.yaml.new")).unwrap();
        symlink("nowhere", bag.join(".bag_0.mcap.repair")).unwrap();
        let repaired = repair(&bag).unwrap();
        assert_eq!((repaired.rewritten, repaired.summary.message_count), (vec!["bag_0.mcap".to_owned()], 1));
        assert_eq!(fs::read_to_string(&mine).unwrap(), "kept");
        for file in ["bag_0.mcap", "metadata.yaml"] {
            assert!(bag.join(file).symlink_metadata().unwrap().is_file(), "{file}");
        }
        assert_eq!(fs::read_dir(&bag).unwrap().count(), 2);
    }

    #[test]
    fn a_fifo_is_not_waited_for() {
        let bag = tempfile::tempdir().unwrap();
        let fifo = bag.path().join("x.mcap");
        assert!(std::process::Command::new("mkfifo").arg(&fifo).status().unwrap().success());
        for error in [repair(bag.path()).unwrap_err(), scan::scan(&fifo, |_, _, _| Ok(())).unwrap_err()] {
            assert!(error.text.contains("x.mcap: it is not a regular file"), "{error}");
        }
    }
}
