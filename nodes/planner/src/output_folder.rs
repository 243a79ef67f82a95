//! The output folder: everything is written beside it first, synced, and moved in when the plan is whole, so that a failed plan
//! leaves nothing behind.

use std::fs::{self, File};
use std::io::{self, ErrorKind, Write};
use std::path::{Path, PathBuf};

use patchmill_machine_interface::dialect::Dialect;
use serde::Serialize;

use crate::report_command::REPORT;

/// A plan's seal: moved in last, taken away first. A folder without it is no plan, for every command that reads one.
const SEAL: &str = "summary.json";

/// A hidden sibling of the output folder that becomes it, or vanishes.
pub struct OutputFolder {
    target: PathBuf,
    staging: PathBuf,
    /// Held while this process lives: a staging folder without a lock was left by one that was killed.
    _lock: Option<File>,
}

impl OutputFolder {
    /// Makes the staging folder; creates missing parents of the target.
    ///
    /// # Errors
    /// When the folder cannot be written, or the target is something else than a folder.
    pub fn create(target: &Path) -> Result<Self, String> {
        let say = |what: &str, e: io::Error| format!("output folder {}: {what}: {e}", target.display());
        if target.exists() && !target.is_dir() {
            return Err(format!(
                "output folder {}: it exists and is not a folder; expected one or a new name",
                target.display()
            ));
        }
        let name = target.file_name().ok_or_else(|| {
            format!("output folder {}: expected a path that ends in a folder's name", target.display())
        })?;
        let parent = match target.parent() {
            Some(parent) if !parent.as_os_str().is_empty() => parent.to_path_buf(),
            _ => PathBuf::from("."),
        };
        fs::create_dir_all(&parent)
            .map_err(|e| say("expected a place that can be written, cannot make its parent", e))?;
        if target.is_dir() {
            // Renaming into a read-only folder would fail at the very end: find out now.
            let probe = target.join(format!(".patchmill-probe-{}", std::process::id()));
            File::create(&probe).map_err(|e| say("cannot write into it", e))?;
            fs::remove_file(&probe).map_err(|e| say("cannot write into it", e))?;
        }
        let prefix = format!(".{}.patchmill-", name.to_string_lossy());
        remove_abandoned(&parent, &prefix).map_err(|e| say("cannot clear an old staging folder", e))?;
        let staging = parent.join(format!("{prefix}{}", std::process::id()));
        fs::create_dir(&staging).map_err(|e| say("cannot write beside it", e))?;
        Ok(Self { target: target.to_path_buf(), _lock: locked(&staging), staging })
    }

    /// Where to write until [`Self::commit`].
    pub fn staging(&self) -> &Path {
        &self.staging
    }

    /// Writes a whole file and syncs it.
    ///
    /// # Errors
    /// When writing fails.
    pub fn write(&self, name: &str, content: &[u8]) -> Result<(), String> {
        let written = write_synced(&self.staging.join(name), content);
        written.map_err(|e| format!("cannot write {}: {e}", self.target.join(name).display()))
    }

    /// Writes a value as JSON for people, syncs it.
    ///
    /// # Errors
    /// When writing fails.
    pub fn write_json(&self, name: &str, value: &impl Serialize) -> Result<(), String> {
        let mut json = serde_json::to_string_pretty(value).map_err(|e| format!("{name}: {e}"))?;
        json.push('\n');
        self.write(name, json.as_bytes())
    }

    /// Moves everything into the target, over what an earlier plan left there under the same names. Its programs for
    /// other controls and its report go, unless this plan brings them: beside a new program.ngc they would be another plan's.
    /// A process that is killed meanwhile leaves the earlier plan, this one, or a folder without `summary.json`.
    ///
    /// # Errors
    /// When moving fails.
    pub fn commit(self) -> Result<(), String> {
        self.move_in()
            .map_err(|e| format!("output folder {}: cannot move the plan in: {e}", self.target.display()))
    }

    fn move_in(&self) -> io::Result<()> {
        let parent = self.staging.parent().unwrap_or(Path::new("."));
        sync_folders(&self.staging)?;
        if !self.target.exists() {
            fs::rename(&self.staging, &self.target)?;
            return sync_folder(parent);
        }
        // Two plans into one folder come in one after the other.
        let _lock = locked(&self.target);
        let seal = self.staging.join(SEAL).exists().then_some(SEAL);
        let stale = seal.into_iter().chain(Dialect::ALL.iter().map(|dialect| dialect.file())).chain([REPORT]);
        for stale in stale.map(|name| self.target.join(name)).filter(|path| path.is_file()) {
            fs::remove_file(&stale)?;
        }
        let mut entries: Vec<_> = fs::read_dir(&self.staging)?.collect::<Result<_, _>>()?;
        entries.sort_by_key(|entry| (entry.file_name() == SEAL, entry.file_name()));
        for entry in entries {
            let place = self.target.join(entry.file_name());
            if place.is_dir() {
                fs::remove_dir_all(&place)?;
            }
            if entry.file_name() == SEAL {
                sync_folder(&self.target)?;
            }
            fs::rename(entry.path(), &place)?;
        }
        sync_folder(&self.target)
    }
}

impl Drop for OutputFolder {
    fn drop(&mut self) {
        // After a commit it is gone or empty; a failure to tidy up has no better place to go.
        let _ = fs::remove_dir_all(&self.staging);
    }
}

/// Writes a file beside its place, syncs it and moves it there, so that the place never holds half a file.
///
/// # Errors
/// When writing or moving fails.
pub fn replace(place: &Path, content: &[u8]) -> Result<(), String> {
    let beside = place.with_extension(format!("patchmill-{}", std::process::id()));
    let written = write_synced(&beside, content).and_then(|()| fs::rename(&beside, place));
    written.map_err(|e| {
        // Nothing half-written stays; that this may fail too changes nothing.
        let _ = fs::remove_file(&beside);
        format!("cannot write {}: {e}", place.display())
    })
}

fn write_synced(path: &Path, content: &[u8]) -> io::Result<()> {
    let mut file = File::create(path)?;
    file.write_all(content)?;
    file.sync_all()
}

/// Puts the names in a folder on the disk, where the file system can.
fn sync_folder(folder: &Path) -> io::Result<()> {
    match File::open(folder).and_then(|folder| folder.sync_all()) {
        Err(e) if [ErrorKind::InvalidInput, ErrorKind::Unsupported].contains(&e.kind()) => Ok(()),
        synced => synced,
    }
}

/// The same of all folders below it.
fn sync_folders(folder: &Path) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        if entry.file_type()?.is_dir() {
            sync_folders(&entry.path())?;
        }
    }
    sync_folder(folder)
}

/// Waits for a folder's lock; without one on file systems that have none.
fn locked(folder: &Path) -> Option<File> {
    let folder = File::open(folder).ok()?;
    folder.lock().is_ok().then_some(folder)
}

/// Removes the staging folders of processes that were killed.
fn remove_abandoned(parent: &Path, prefix: &str) -> io::Result<()> {
    for entry in fs::read_dir(parent)? {
        let entry = entry?;
        if !entry.file_name().to_string_lossy().starts_with(prefix) || !entry.file_type()?.is_dir() {
            continue;
        }
        // One that vanishes meanwhile was somebody's who is done.
        let Ok(folder) = File::open(entry.path()) else { continue };
        if folder.try_lock().is_ok()
            && let Err(e) = fs::remove_dir_all(entry.path())
            && e.kind() != ErrorKind::NotFound
        {
            return Err(e);
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<String> =
            fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn a_dropped_folder_leaves_nothing_and_a_committed_one_all() {
        let root = tempfile::tempdir().unwrap();
        let target = root.path().join("plan");
        let folder = OutputFolder::create(&target).unwrap();
        folder.write("program.ngc", b"M2\n").unwrap();
        drop(folder);
        assert!(names(root.path()).is_empty());
        for text in ["first", "second"] {
            let folder = OutputFolder::create(&target).unwrap();
            fs::create_dir(folder.staging().join("bag")).unwrap();
            folder.write("bag/a", text.as_bytes()).unwrap();
            folder.write("program.ngc", text.as_bytes()).unwrap();
            folder.commit().unwrap();
            assert_eq!(names(root.path()), ["plan"]);
            assert_eq!(fs::read_to_string(target.join("bag/a")).unwrap(), text);
        }
        fs::write(target.join("mine.txt"), "kept").unwrap();
        for stale in ["program.mpf", "report.html"] {
            fs::write(target.join(stale), "of an earlier plan").unwrap();
        }
        OutputFolder::create(&target).unwrap().commit().unwrap();
        assert_eq!(names(&target), ["bag", "mine.txt", "program.ngc"]);
    }

    #[test]
    fn the_summary_comes_last_and_only_folders_of_the_dead_are_cleared() {
        let root = tempfile::tempdir().unwrap();
        let target = root.path().join("plan");
        fs::create_dir(&target).unwrap();
        fs::write(target.join("summary.json"), "of an earlier plan").unwrap();
        // Something in the way of the program: the move ends halfway, as a kill would end it.
        let folder = OutputFolder::create(&target).unwrap();
        folder.write("program.ngc", b"M2\n").unwrap();
        folder.write("summary.json", b"{}").unwrap();
        fs::remove_file(folder.staging().join("program.ngc")).unwrap();
        fs::create_dir(folder.staging().join("program.ngc")).unwrap();
        fs::write(target.join("program.ngc"), "M2").unwrap();
        assert!(folder.commit().unwrap_err().contains("cannot move the plan in"));
        assert_eq!(names(&target), ["program.ngc"]);

        let living = OutputFolder::create(&target).unwrap();
        let dead = root.path().join(".plan.patchmill-1");
        fs::create_dir(&dead).unwrap();
        remove_abandoned(root.path(), ".plan.patchmill-").unwrap();
        assert!(living.staging().is_dir() && !dead.exists());
    }

    #[test]
    fn a_file_in_the_way_is_refused() {
        let root = tempfile::tempdir().unwrap();
        fs::write(root.path().join("plan"), "").unwrap();
        assert!(OutputFolder::create(&root.path().join("plan")).is_err());
        assert!(OutputFolder::create(Path::new("/proc/patchmill/plan")).is_err());
    }
}
