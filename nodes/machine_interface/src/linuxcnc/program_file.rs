//! The program where LinuxCNC reads it.

use crate::execution::BAD_CONTROLLER;
use crate::execution::program::ExecutableProgram;
use patchmill_products::stage::StageError;
use std::fs;
use std::io::{self, ErrorKind, Write};
use std::os::unix::fs::{OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};

/// A program's file; it is gone with the value.
pub struct ProgramFile {
    path: PathBuf,
}

impl ProgramFile {
    /// Writes the program into `folder` under a name that no other file has; once it is whole, others can read it.
    ///
    /// # Errors
    /// [`BAD_CONTROLLER`] when the folder does not take it or has a name that LinuxCNC does not take.
    pub fn write(folder: &Path, program: &ExecutableProgram) -> Result<Self, StageError> {
        let folder = folder.canonicalize().unwrap_or_else(|_| folder.to_path_buf());
        let say = |what: String| {
            let text = format!("the program cannot be put into {} for LinuxCNC: {what}", folder.display());
            StageError::new(BAD_CONTROLLER, text)
        };
        if folder.to_string_lossy().contains(char::is_whitespace) {
            return Err(say("linuxcncrsh takes no file names with spaces".to_owned()));
        }
        let id = program.sha256.get(..16).unwrap_or(&program.sha256);
        for number in 0..1000 {
            let path = folder.join(format!("patchmill-{id}-{}-{number}.ngc", std::process::id()));
            match create(&path) {
                Ok(mut file) => {
                    // From here on the file goes away with the value, also when it cannot be written.
                    let this = Self { path };
                    let written =
                        file.write_all(program.text.as_bytes()).and_then(|()| readable_by_all(&file));
                    return written.map(|()| this).map_err(|e| say(e.to_string()));
                }
                Err(e) if e.kind() == ErrorKind::AlreadyExists => {}
                Err(e) => return Err(say(e.to_string())),
            }
        }
        Err(say("every name is taken".to_owned()))
    }

    /// Its whole name.
    pub fn name(&self) -> String {
        self.path.to_string_lossy().into_owned()
    }
}

impl Drop for ProgramFile {
    fn drop(&mut self) {
        // LinuxCNC has read it, or has ended; a copy in a folder for temporary files does no harm.
        let _ = fs::remove_file(&self.path);
    }
}

/// A new file that nobody else opens, whatever the process's umask.
fn create(path: &Path) -> io::Result<fs::File> {
    fs::OpenOptions::new().write(true).create_new(true).mode(0o600).open(path)
}

/// LinuxCNC may run as any other user, in no group of ours; nobody else may write.
fn readable_by_all(file: &fs::File) -> io::Result<()> {
    file.set_permissions(fs::Permissions::from_mode(0o644))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::execution::program::tests::square;

    /// A new folder of this test.
    fn folder(name: &str) -> PathBuf {
        let folder = std::env::temp_dir().join(format!("patchmill-{name}-{}", std::process::id()));
        fs::create_dir(&folder).unwrap();
        folder
    }

    fn mode(path: &Path) -> u32 {
        fs::metadata(path).unwrap().permissions().mode() & 0o777
    }

    #[test]
    fn a_file_is_its_owners_until_it_is_whole() {
        let folder = folder("program-file");
        let path = folder.join("new.ngc");
        create(&path).unwrap();
        assert_eq!(mode(&path), 0o600);
        let link = folder.join("link.ngc");
        std::os::unix::fs::symlink(folder.join("elsewhere"), &link).unwrap();
        for taken in [&path, &link] {
            assert_eq!(create(taken).unwrap_err().kind(), ErrorKind::AlreadyExists);
        }
        assert!(!folder.join("elsewhere").exists());
        let (first, second) = (
            ProgramFile::write(&folder, &square()).unwrap(),
            ProgramFile::write(&folder, &square()).unwrap(),
        );
        assert_ne!(first.name(), second.name());
        assert_eq!(mode(&first.path), 0o644);
        assert_eq!(fs::read_to_string(first.name()).unwrap(), square().text);
        let name = first.name();
        drop(first);
        assert!(!Path::new(&name).exists() && second.path.exists());
        drop(second);
        fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn folders_that_do_not_take_it_are_named() {
        for (folder, what) in [("/no/such/folder", "No such file"), ("/tmp/with space", "spaces")] {
            let refused = ProgramFile::write(Path::new(folder), &square()).err().unwrap();
            assert_eq!(refused.code, BAD_CONTROLLER);
            assert!(refused.text.contains(folder) && refused.text.contains(what), "{refused}");
        }
    }
}
