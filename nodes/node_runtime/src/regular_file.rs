//! Files from others: regular ones only, within a bound. A FIFO would be waited for, a device has no end.

use std::fs::{File, OpenOptions};
use std::io::{self, Read};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

use rustix::fs::OFlags;

const MIB: u64 = 1 << 20;

/// Opens a file to be read, links followed.
///
/// # Errors
/// When it is not there, not a regular file or cannot be opened.
pub fn open(path: &Path) -> io::Result<File> {
    let irregular = || io::Error::other("it is not a regular file");
    // Before opening: opening a device may do something.
    if !path.metadata()?.is_file() {
        return Err(irregular());
    }
    // Whoever may write there can put a FIFO in its place meanwhile: it is not waited for.
    let flags = OFlags::NONBLOCK.bits() as i32;
    let file = OpenOptions::new().read(true).custom_flags(flags).open(path)?;
    if file.metadata()?.is_file() { Ok(file) } else { Err(irregular()) }
}

/// The content of a file of at most `most` bytes.
///
/// # Errors
/// As [`open`]; when it is larger or cannot be read. The file is not named.
pub fn read(path: &Path, most: u64) -> Result<Vec<u8>, String> {
    let file = open(path).map_err(|e| e.to_string())?;
    let size = file.metadata().map_err(|e| e.to_string())?.len();
    let mut bytes = Vec::new();
    if size <= most {
        // One that grows meanwhile stays within the bound too.
        file.take(most + 1).read_to_end(&mut bytes).map_err(|e| e.to_string())?;
    }
    if size > most || bytes.len() as u64 > most {
        let bound =
            if most.is_multiple_of(MIB) { format!("{} MiB", most / MIB) } else { format!("{most} bytes") };
        return Err(format!("it is larger than {bound}, the most that is read"));
    }
    Ok(bytes)
}

/// The text of a file of at most `most` bytes.
///
/// # Errors
/// As [`read`]; when it is no UTF-8 text.
pub fn read_text(path: &Path, most: u64) -> Result<String, String> {
    String::from_utf8(read(path, most)?).map_err(|_| "it is no UTF-8 text".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::symlink;

    #[test]
    fn only_regular_files_within_the_bound_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let place = |name: &str| folder.path().join(name);
        std::fs::write(place("a"), "äb").unwrap();
        symlink("a", place("link")).unwrap();
        assert_eq!(read_text(&place("link"), 3).unwrap(), "äb");
        assert!(read_text(&place("a"), 2).unwrap_err().contains("larger than 2 bytes"));
        std::fs::write(place("a"), [0xff]).unwrap();
        assert!(read_text(&place("a"), 3).unwrap_err().contains("UTF-8"));
        // Takes no room on the disk.
        File::create(place("huge")).unwrap().set_len(1 << 40).unwrap();
        assert!(read(&place("huge"), 2 * MIB).unwrap_err().contains("larger than 2 MiB"));
        assert!(std::process::Command::new("mkfifo").arg(place("fifo")).status().unwrap().success());
        symlink("/dev/zero", place("zero")).unwrap();
        for bad in ["fifo", "zero", "."] {
            assert!(read(&place(bad), MIB).unwrap_err().contains("not a regular file"), "{bad}");
        }
        assert!(read(&place("none"), MIB).unwrap_err().contains("No such file"));
        // Files of /proc state no size, and may be longer than the bound all the same.
        assert!(read(Path::new("/proc/self/status"), 20).unwrap_err().contains("larger than 20 bytes"));
    }
}
