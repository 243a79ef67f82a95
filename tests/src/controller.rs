//! A real LinuxCNC without a screen, run by the script that `patchmill linuxcnc-config` writes.

use std::fs::File;
use std::net::{TcpListener, TcpStream};
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use crate::executables::patchmill;

/// For LinuxCNC to listen.
const PATIENCE: Duration = Duration::from_secs(90);

/// A running LinuxCNC; it ends with the value.
pub struct LinuxCnc {
    child: Child,
    port: u16,
}

impl LinuxCnc {
    /// Makes the configuration in `folder`, which must not exist, and starts it. `more` are further options of `linuxcnc-config`.
    ///
    /// # Panics
    /// When the configuration cannot be made or LinuxCNC does not come up: a peer that is missing is a failure, not a skipped test.
    pub fn start(folder: &Path, more: &[&str]) -> Self {
        let port = free_port();
        let (directory, number) = (folder.to_string_lossy(), port.to_string());
        let mut arguments = vec!["linuxcnc-config", "--out", &directory, "--port", &number];
        arguments.extend(more);
        let made = patchmill(&arguments);
        assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
        let log = folder.join("log.txt");
        let output = |what: &str| match File::create(&log).and_then(|file| Ok((file.try_clone()?, file))) {
            Ok(files) => files,
            Err(e) => panic!("{what} {}: {e}", log.display()),
        };
        let (out, error) = output("the log");
        let mut command = Command::new("bash");
        command.arg(folder.join("start.sh")).stdin(Stdio::null()).stdout(out).stderr(error).process_group(0);
        let child = match command.spawn() {
            Ok(child) => child,
            Err(e) => panic!("bash cannot be started: {e}"),
        };
        let mut this = Self { child, port };
        let end = Instant::now() + PATIENCE;
        while TcpStream::connect(("127.0.0.1", port)).is_err() {
            let ended = this.child.try_wait().ok().flatten();
            if ended.is_some() || Instant::now() >= end {
                let text = std::fs::read_to_string(&log).unwrap_or_default();
                panic!(
                    "LinuxCNC (Debian package linuxcnc-uspace) does not listen on port {port}: {ended:?}\n{text}"
                );
            }
            std::thread::sleep(Duration::from_millis(100));
        }
        this
    }

    /// Its name for `--controller`.
    pub fn name(&self) -> String {
        format!("linuxcnc://127.0.0.1:{}", self.port)
    }

    /// Ends it as a power cut does.
    pub fn kill(&mut self) {
        // The script's process group: as root its end takes LinuxCNC's namespaces along.
        let group = format!("-{}", self.child.id());
        let _ = Command::new("kill").args(["-KILL", "--", &group]).stderr(Stdio::null()).status();
        let _ = self.child.wait();
    }
}

impl Drop for LinuxCnc {
    fn drop(&mut self) {
        self.kill();
    }
}

/// A port that is free at the moment.
fn free_port() -> u16 {
    match TcpListener::bind(("127.0.0.1", 0)).and_then(|listener| listener.local_addr()) {
        Ok(address) => address.port(),
        Err(e) => panic!("no free port: {e}"),
    }
}
