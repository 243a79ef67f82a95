//! Files that are whole or not there: written under another name, synced, and moved to their place.

use std::fs::{self, File};
use std::io::{self, ErrorKind, Write};
use std::path::Path;

/// Writes a file and waits for the disk. What bears its name is taken away first: a link that somebody has put there is not followed.
///
/// # Errors
/// When it cannot be written.
pub fn write_new(path: &Path, content: &[u8]) -> io::Result<()> {
    match fs::remove_file(path) {
        Err(e) if e.kind() != ErrorKind::NotFound => return Err(e),
        _ => {}
    }
    let mut file = File::create_new(path)?;
    file.write_all(content)?;
    file.sync_all()
}

/// Writes a file as `beside`, in the same folder, and moves it to its place. On an error nothing half-written stays.
///
/// # Errors
/// When writing or moving fails.
pub fn replace(place: &Path, beside: &Path, content: &[u8]) -> io::Result<()> {
    let written = write_new(beside, content).and_then(|()| fs::rename(beside, place));
    if written.is_err() {
        // That this may fail too changes nothing.
        let _ = fs::remove_file(beside);
    }
    written.and_then(|()| sync_folder_of(place))
}

/// Puts the names in a folder on the disk, where the file system can and it may be read.
///
/// # Errors
/// When the disk fails.
pub fn sync_folder(folder: &Path) -> io::Result<()> {
    const CANNOT: [ErrorKind; 3] =
        [ErrorKind::InvalidInput, ErrorKind::Unsupported, ErrorKind::PermissionDenied];
    match File::open(folder).and_then(|folder| folder.sync_all()) {
        Err(e) if CANNOT.contains(&e.kind()) => Ok(()),
        synced => synced,
    }
}

/// [`sync_folder`] of the folder that a file is in.
///
/// # Errors
/// As there.
pub fn sync_folder_of(file: &Path) -> io::Result<()> {
    match file.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => sync_folder(folder),
        _ => sync_folder(Path::new(".")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::symlink;

    #[test]
    fn a_link_in_the_way_is_not_followed() {
        let folder = tempfile::tempdir().unwrap();
        let place = |name: &str| folder.path().join(name);
        fs::write(place("mine"), "kept").unwrap();
        for target in ["mine", "not there"] {
            symlink(target, place("new")).unwrap();
            replace(&place("a"), &place("new"), target.as_bytes()).unwrap();
            assert_eq!(fs::read_to_string(place("a")).unwrap(), target);
            assert!(place("a").symlink_metadata().unwrap().is_file());
        }
        assert_eq!(fs::read_to_string(place("mine")).unwrap(), "kept");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2);
    }

    #[test]
    fn what_cannot_be_moved_leaves_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let place = |name: &str| folder.path().join(name);
        fs::create_dir(place("a")).unwrap();
        assert!(replace(&place("a"), &place("new"), b"text").is_err());
        assert!(!place("new").exists() && place("a").is_dir());
    }
}
