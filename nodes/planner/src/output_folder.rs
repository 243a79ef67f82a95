//! The output folder: everything is written beside it first and moved in when the plan is whole, so that a failed plan
//! leaves nothing behind.

use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use patchmill_machine_interface::dialect::Dialect;
use serde::Serialize;

use crate::report_command::REPORT;

/// A hidden sibling of the output folder that becomes it, or vanishes.
pub struct OutputFolder {
    target: PathBuf,
    staging: PathBuf,
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
            fs::File::create(&probe).map_err(|e| say("cannot write into it", e))?;
            fs::remove_file(&probe).map_err(|e| say("cannot write into it", e))?;
        }
        let staging = parent.join(format!(".{}.patchmill-{}", name.to_string_lossy(), std::process::id()));
        match fs::remove_dir_all(&staging) {
            Err(e) if e.kind() != io::ErrorKind::NotFound => {
                return Err(say("cannot clear an old staging folder", e));
            }
            _ => {}
        }
        fs::create_dir(&staging).map_err(|e| say("cannot write beside it", e))?;
        Ok(Self { target: target.to_path_buf(), staging })
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
        let path = self.staging.join(name);
        let written = fs::File::create(&path).and_then(|mut file| {
            file.write_all(content)?;
            file.sync_all()
        });
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
    ///
    /// # Errors
    /// When moving fails.
    pub fn commit(self) -> Result<(), String> {
        let say =
            |e: io::Error| format!("output folder {}: cannot move the plan in: {e}", self.target.display());
        if !self.target.exists() {
            return fs::rename(&self.staging, &self.target).map_err(say);
        }
        let mut entries: Vec<_> =
            fs::read_dir(&self.staging).map_err(say)?.collect::<Result<_, _>>().map_err(say)?;
        entries.sort_by_key(fs::DirEntry::file_name);
        for stale in Dialect::ALL.iter().map(|d| d.file()).chain([REPORT]) {
            let stale = self.target.join(stale);
            if stale.is_file() {
                fs::remove_file(&stale).map_err(say)?;
            }
        }
        for entry in entries {
            let place = self.target.join(entry.file_name());
            if place.is_dir() {
                fs::remove_dir_all(&place).map_err(say)?;
            }
            fs::rename(entry.path(), &place).map_err(say)?;
        }
        Ok(())
    }
}

impl Drop for OutputFolder {
    fn drop(&mut self) {
        // After a commit it is gone or empty; a failure to tidy up has no better place to go.
        let _ = fs::remove_dir_all(&self.staging);
    }
}

/// Writes a file beside its place and moves it there, so that the place never holds half a file.
///
/// # Errors
/// When writing or moving fails.
pub fn replace(place: &Path, content: &[u8]) -> Result<(), String> {
    let say = |e: io::Error| format!("cannot write {}: {e}", place.display());
    let beside = place.with_extension(format!("patchmill-{}", std::process::id()));
    let written = fs::write(&beside, content).and_then(|()| fs::rename(&beside, place));
    written.map_err(|e| {
        // Nothing half-written stays; that this may fail too changes nothing.
        let _ = fs::remove_file(&beside);
        say(e)
    })
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
    fn a_file_in_the_way_is_refused() {
        let root = tempfile::tempdir().unwrap();
        fs::write(root.path().join("plan"), "").unwrap();
        assert!(OutputFolder::create(&root.path().join("plan")).is_err());
        assert!(OutputFolder::create(Path::new("/proc/patchmill/plan")).is_err());
    }
}
