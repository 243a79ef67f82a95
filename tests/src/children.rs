//! Children that end with the test that started them.

use std::io::Read;
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

/// Running processes; those still there are killed when the value is dropped.
#[derive(Default)]
pub struct Children(pub Vec<Child>);

impl Children {
    /// Starts a process.
    ///
    /// # Panics
    /// When it cannot be started.
    pub fn start(&mut self, command: &mut Command) {
        match command.spawn() {
            Ok(child) => self.0.push(child),
            Err(e) => panic!("{command:?} cannot be started: {e}"),
        }
    }

    /// Sends SIGTERM to all.
    pub fn terminate(&self) {
        self.0.iter().for_each(terminate);
    }

    /// Waits until all have ended.
    ///
    /// # Panics
    /// When one has not within the time.
    pub fn wait(&mut self, patience: Duration) -> Vec<ExitStatus> {
        let end = Instant::now() + patience;
        self.0.iter_mut().map(|child| wait(child, end.saturating_duration_since(Instant::now()))).collect()
    }
}

impl Drop for Children {
    fn drop(&mut self) {
        self.0.iter_mut().for_each(end);
    }
}

/// Kills a process as `kill -9` does, and waits for its end.
pub fn end(child: &mut Child) {
    // One that has already ended cannot be killed.
    let _ = child.kill();
    let _ = child.wait();
}

/// Sends SIGTERM.
pub fn terminate(child: &Child) {
    signal(child, "TERM");
}

/// Sends a signal by its name.
pub fn signal(child: &Child, name: &str) {
    // A process that has ended cannot be signalled.
    let _ =
        Command::new("kill").args(["-s", name]).arg(child.id().to_string()).stderr(Stdio::null()).status();
}

/// Waits until a process has ended.
///
/// # Panics
/// When it has not within the time.
pub fn wait(child: &mut Child, patience: Duration) -> ExitStatus {
    let end = Instant::now() + patience;
    loop {
        match child.try_wait() {
            Ok(Some(status)) => return status,
            Ok(None) if Instant::now() < end => std::thread::sleep(Duration::from_millis(10)),
            Ok(None) => panic!("process {} did not end within {patience:?}", child.id()),
            Err(e) => panic!("process {} cannot be waited for: {e}", child.id()),
        }
    }
}

/// Everything that an ended process wrote to its piped stderr.
pub fn stderr_of(child: &mut Child) -> String {
    let mut text = String::new();
    if let Some(stderr) = &mut child.stderr {
        // What can be read counts.
        let _ = stderr.read_to_string(&mut text);
    }
    text
}

/// Bytes of a planned folder's `program.ngc`.
///
/// # Panics
/// When there is none.
pub fn program_of(folder: &Path) -> Vec<u8> {
    match std::fs::read(folder.join("program.ngc")) {
        Ok(bytes) => bytes,
        Err(e) => panic!("{}: {e}", folder.display()),
    }
}
