//! A hidden folder in which files are made before they move to their place. A lock file beside it, `NAME.lock`, tells that it is one
//! and whether who made it lives: it is there and locked before the folder is, and goes after it.

use std::fs::{self, File};
use std::io::{self, ErrorKind};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use patchmill_node_runtime::regular_file;

/// So many numbers are tried from the process's own on: another container on the same disk may have the same.
const ATTEMPTS: u32 = 100;
const LOCK: &str = ".lock";

/// The folder; removed when dropped, unless it has been moved away.
pub(crate) struct StagingFolder {
    path: PathBuf,
    lock_path: PathBuf,
    /// Held while this process lives.
    _lock: File,
}

impl StagingFolder {
    /// A new folder in `parent`: `prefix` and a number.
    ///
    /// # Errors
    /// When it cannot be made.
    pub(crate) fn create(parent: &Path, prefix: &str) -> io::Result<Self> {
        let own = std::process::id();
        for number in own..own.saturating_add(ATTEMPTS) {
            let path = parent.join(format!("{prefix}{number}"));
            let lock_path = parent.join(format!("{prefix}{number}{LOCK}"));
            let Some(lock) = new_lock(&lock_path)? else { continue };
            let made = fs::create_dir(&path);
            if made.is_ok() {
                return Ok(Self { path, lock_path, _lock: lock });
            }
            // Nobody else takes away what is locked.
            let _ = fs::remove_file(&lock_path);
            match made {
                Err(e) if e.kind() != ErrorKind::AlreadyExists => return Err(e),
                _ => {}
            }
        }
        Err(ErrorKind::AlreadyExists.into())
    }

    /// Where it is.
    pub(crate) fn path(&self) -> &Path {
        &self.path
    }
}

impl Drop for StagingFolder {
    fn drop(&mut self) {
        // After a move it is gone or empty; a failure to tidy up has no better place to go.
        let _ = fs::remove_dir_all(&self.path);
        let _ = fs::remove_file(&self.lock_path);
    }
}

/// A new lock file, locked; `None` when there is one, or somebody took it for abandoned before it was locked.
fn new_lock(path: &Path) -> io::Result<Option<File>> {
    let file = match File::create_new(path) {
        Err(e) if e.kind() == ErrorKind::AlreadyExists => return Ok(None),
        made => made?,
    };
    // On file systems without locks nothing is ever taken for abandoned.
    let _ = file.lock();
    Ok(is_at(&file, path).then_some(file))
}

/// Whether the name still stands for the open file.
fn is_at(file: &File, path: &Path) -> bool {
    match (file.metadata(), path.symlink_metadata()) {
        (Ok(open), Ok(named)) => (open.dev(), open.ino()) == (named.dev(), named.ino()),
        _ => false,
    }
}

/// Removes the staging folders in `parent` whose processes were killed. What cannot be removed stays: it is in nobody's way.
pub(crate) fn remove_abandoned(parent: &Path, prefix: &str) {
    for entry in fs::read_dir(parent).into_iter().flatten().flatten() {
        let name = entry.file_name();
        let Some(folder) = name.to_str().and_then(|name| folder_of(name, prefix)) else { continue };
        let (lock_path, folder) = (entry.path(), parent.join(folder));
        // One that vanishes meanwhile was somebody's who is done.
        let Ok(lock) = regular_file::open(&lock_path) else { continue };
        if lock.try_lock().is_err() || !is_at(&lock, &lock_path) {
            continue;
        }
        let cleared = match folder.symlink_metadata() {
            Ok(there) if there.is_dir() => fs::remove_dir_all(&folder),
            _ => Ok(()),
        };
        if cleared.is_ok() {
            let _ = fs::remove_file(&lock_path);
        }
    }
}

/// The staging folder's name that belongs to a lock file's.
fn folder_of<'a>(lock: &'a str, prefix: &str) -> Option<&'a str> {
    let folder = lock.strip_suffix(LOCK)?;
    let number = folder.strip_prefix(prefix)?;
    (!number.is_empty() && number.bytes().all(|b| b.is_ascii_digit())).then_some(folder)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::symlink;

    const PREFIX: &str = ".plan.patchmill-";

    #[test]
    fn only_folders_of_the_dead_are_cleared() {
        let root = tempfile::tempdir().unwrap();
        let place = |name: &str| root.path().join(name);
        let living = StagingFolder::create(root.path(), PREFIX).unwrap();
        let other = StagingFolder::create(root.path(), PREFIX).unwrap();
        assert_ne!(living.path(), other.path());
        fs::create_dir_all(place(".plan.patchmill-1/bag")).unwrap();
        fs::write(place(".plan.patchmill-1.lock"), "").unwrap();
        // Killed before its folder was made, or after it was moved.
        fs::write(place(".plan.patchmill-2.lock"), "").unwrap();
        // A user's, whatever they are called.
        let kept =
            [".plan.patchmill-3", ".plan.patchmill-old", ".plan.patchmill-4x.lock", ".plan.patchmill-.lock"];
        kept.iter().for_each(|name| fs::create_dir(place(name)).unwrap());
        fs::write(place("mine"), "").unwrap();
        symlink("mine", place(".plan.patchmill-3.lock")).unwrap();
        remove_abandoned(root.path(), PREFIX);
        assert!(living.path().is_dir() && other.path().is_dir());
        assert!(kept.iter().all(|name| place(name).is_dir()));
        for gone in [".plan.patchmill-1", ".plan.patchmill-1.lock", ".plan.patchmill-2.lock"] {
            assert!(!place(gone).exists(), "{gone}");
        }
        drop((living, other));
        assert_eq!(fs::read_dir(root.path()).unwrap().count(), kept.len() + 2);
    }

    #[test]
    fn a_folder_is_never_there_without_its_lock() {
        let root = tempfile::tempdir().unwrap();
        std::thread::scope(|scope| {
            let maker = scope.spawn(|| {
                for _ in 0..2000 {
                    let staging = StagingFolder::create(root.path(), PREFIX).unwrap();
                    fs::write(staging.path().join("a"), "").unwrap();
                    assert!(staging.path().join("a").is_file());
                }
            });
            while !maker.is_finished() {
                remove_abandoned(root.path(), PREFIX);
            }
        });
        assert_eq!(fs::read_dir(root.path()).unwrap().count(), 0);
    }
}
