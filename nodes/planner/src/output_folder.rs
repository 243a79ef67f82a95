//! The output folder: everything is written into a hidden folder first, synced, and moved in when the plan is whole, so that a
//! failed plan leaves nothing behind.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

use patchmill_machine_interface::dialect::Dialect;
use patchmill_node_runtime::whole_file::{self, sync_folder, sync_folder_of, write_new};
use serde::Serialize;

use crate::report_command::REPORT;
use crate::staging_folder::{StagingFolder, remove_abandoned};

/// A plan's seal: moved in last, taken away first. A folder without it is no plan, for every command that reads one.
const SEAL: &str = "summary.json";
/// How staging folders inside a target are called.
const INSIDE: &str = ".patchmill-";

/// Files that come into an output folder together, or vanish.
pub struct OutputFolder {
    /// As it was named, for errors.
    named: PathBuf,
    /// Where links lead that are in the name, if it is there.
    target: PathBuf,
    staging: StagingFolder,
}

impl OutputFolder {
    /// Makes the staging folder: inside a target that is there, which may be a file system of its own, else beside it; creates
    /// missing parents of the target.
    ///
    /// # Errors
    /// When the folder cannot be written, or the target is something else than a folder.
    pub fn create(named: &Path) -> Result<Self, String> {
        let wrong = |what: &str| format!("output folder {}: {what}", named.display());
        let say = |what: &str, e: io::Error| wrong(&format!("{what}: {e}"));
        let there = named.canonicalize();
        if there.as_ref().is_ok_and(|there| !there.is_dir()) {
            return Err(wrong("it exists and is not a folder; expected one or a new name"));
        }
        if there.is_err() && named.is_symlink() {
            return Err(wrong("it is a link that leads nowhere; expected a folder or a new name"));
        }
        let target = there.unwrap_or_else(|_| named.to_path_buf());
        let beside = target.file_name().map(|name| format!(".{}.patchmill-", name.to_string_lossy()));
        let parent = match target.parent() {
            Some(parent) if !parent.as_os_str().is_empty() => parent,
            _ => Path::new("."),
        };
        let staging = if target.is_dir() {
            // One that was killed before the target was there.
            beside.iter().for_each(|prefix| remove_abandoned(parent, prefix));
            remove_abandoned(&target, INSIDE);
            StagingFolder::create(&target, INSIDE).map_err(|e| say("cannot write into it", e))?
        } else {
            let prefix = beside.ok_or_else(|| wrong("expected a path that ends in a folder's name"))?;
            fs::create_dir_all(parent)
                .map_err(|e| say("expected a place that can be written, cannot make its parent", e))?;
            remove_abandoned(parent, &prefix);
            StagingFolder::create(parent, &prefix).map_err(|e| say("cannot write beside it", e))?
        };
        Ok(Self { named: named.to_path_buf(), target, staging })
    }

    /// Where to write until [`Self::commit`].
    pub fn staging(&self) -> &Path {
        self.staging.path()
    }

    /// Writes a whole file and syncs it.
    ///
    /// # Errors
    /// When writing fails.
    pub fn write(&self, name: &str, content: &[u8]) -> Result<(), String> {
        let written = write_new(&self.staging().join(name), content);
        written.map_err(|e| format!("cannot write {}: {e}", self.named.join(name).display()))
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
            .map_err(|e| format!("output folder {}: cannot move the plan in: {e}", self.named.display()))
    }

    fn move_in(&self) -> io::Result<()> {
        let staging = self.staging();
        sync_folders(staging)?;
        if !self.target.exists() {
            fs::rename(staging, &self.target)?;
            return sync_folder_of(&self.target);
        }
        // Two plans into one folder come in one after the other.
        let _lock = locked(&self.target);
        let seal = staging.join(SEAL).exists().then_some(SEAL);
        let stale = seal.into_iter().chain(Dialect::ALL.iter().map(|dialect| dialect.file())).chain([REPORT]);
        for stale in stale.map(|name| self.target.join(name)).filter(|path| path.is_file()) {
            fs::remove_file(&stale)?;
        }
        let mut entries: Vec<_> = fs::read_dir(staging)?.collect::<Result<_, _>>()?;
        entries.sort_by_key(|entry| (entry.file_name() == SEAL, entry.file_name()));
        for entry in entries {
            let place = self.target.join(entry.file_name());
            match place.symlink_metadata() {
                Ok(old) if old.is_dir() => fs::remove_dir_all(&place)?,
                Ok(old) if old.is_symlink() => fs::remove_file(&place)?,
                _ => {}
            }
            if entry.file_name() == SEAL {
                sync_folder(&self.target)?;
            }
            fs::rename(entry.path(), &place)?;
        }
        sync_folder(&self.target)
    }
}

/// Writes a file beside its place, syncs it and moves it there, so that the place never holds half a file.
///
/// # Errors
/// When writing or moving fails.
pub fn replace(place: &Path, content: &[u8]) -> Result<(), String> {
    let beside = place.with_extension(format!("patchmill-{}", std::process::id()));
    whole_file::replace(place, &beside, content).map_err(|e| format!("cannot write {}: {e}", place.display()))
}

/// Puts the names in a folder and in all below it on the disk.
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

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::{MetadataExt, symlink};

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
    fn the_summary_comes_last_and_a_broken_move_leaves_no_plan() {
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
    }

    #[test]
    fn a_folder_on_another_file_system_gets_its_files_too() {
        let (here, there) = (tempfile::tempdir().unwrap(), tempfile::tempdir_in("/dev/shm").unwrap());
        let device = |folder: &Path| folder.metadata().unwrap().dev();
        assert_ne!(device(here.path()), device(there.path()), "/dev/shm is no file system of its own");
        let link = here.path().join("plan");
        symlink(there.path(), &link).unwrap();
        // A plan's bag is a folder, and somebody has put a link in its way.
        let mine = here.path().join("mine");
        fs::create_dir(&mine).unwrap();
        fs::write(mine.join("a"), "kept").unwrap();
        symlink(&mine, there.path().join("bag")).unwrap();
        for text in ["first", "second"] {
            let folder = OutputFolder::create(&link).unwrap();
            fs::create_dir(folder.staging().join("bag")).unwrap();
            folder.write("bag/a", text.as_bytes()).unwrap();
            folder.write("summary.json", text.as_bytes()).unwrap();
            folder.commit().unwrap();
            assert_eq!(fs::read_to_string(link.join("bag/a")).unwrap(), text);
            assert_eq!(names(there.path()), ["bag", "summary.json"]);
        }
        drop(OutputFolder::create(&link).unwrap());
        assert_eq!(names(there.path()), ["bag", "summary.json"]);
        assert_eq!(names(here.path()), ["mine", "plan"]);
        assert_eq!(fs::read_to_string(mine.join("a")).unwrap(), "kept");
    }

    #[test]
    fn a_file_in_the_way_is_refused() {
        let root = tempfile::tempdir().unwrap();
        fs::write(root.path().join("plan"), "").unwrap();
        assert!(OutputFolder::create(&root.path().join("plan")).is_err());
        assert!(OutputFolder::create(Path::new("/proc/patchmill/plan")).is_err());
        symlink("nowhere", root.path().join("link")).unwrap();
        let Err(error) = OutputFolder::create(&root.path().join("link")) else { panic!("no error") };
        assert!(error.contains("leads nowhere"), "{error}");
    }
}
