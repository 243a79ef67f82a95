//! The client of `linuxcncrsh`: a text line out, a text line back, every answer checked.

use super::protocol::{self, ProgramStatus, rest_of};
use super::{joint_order, joints_of};
use crate::execution::controller::{Activity, Controller, Report};
use crate::execution::program::ExecutableProgram;
use crate::execution::{BAD_CONTROLLER, BUSY, CONNECTION_LOST, CONTROLLER_ERROR, NO_CONNECTION};
use patchmill_products::stage::StageError;
use std::fs;
use std::io::{BufReader, ErrorKind, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// For a connection, and for an answer.
const CONNECT: Duration = Duration::from_secs(5);
const ANSWER: Duration = Duration::from_secs(15);
/// For all joints to be homed.
const HOMING: Duration = Duration::from_secs(300);
/// While waiting LinuxCNC is asked so often.
const PERIOD: Duration = Duration::from_millis(50);
/// Lines that may come before the answer: the rest of an error text of several lines.
const STRAY_LINES: usize = 50;
/// The passwords that linuxcncrsh has unless it is told others.
const HELLO: &str = "hello EMC patchmill 1.0";
const ENABLE: &str = "set enable EMCTOO";

/// A LinuxCNC that listens.
pub struct LinuxCnc {
    address: String,
    /// Folder that LinuxCNC reads programs from.
    folder: PathBuf,
    link: Option<Link>,
    order: [usize; 5],
    file: Option<PathBuf>,
    created: Instant,
    started: bool,
}

/// `HOST:PORT` of `linuxcnc://HOST:PORT`; `None` for any other text.
pub fn address(controller: &str) -> Option<&str> {
    let address = controller.strip_prefix("linuxcnc://")?;
    let (host, port) = address.rsplit_once(':')?;
    (!host.is_empty() && port.parse::<u16>().is_ok()).then_some(address)
}

/// Asks whether a linuxcncrsh at `HOST:PORT` greets back; nothing else is sent.
///
/// # Errors
/// Why not, in a few words.
pub fn greets(address: &str) -> Result<(), String> {
    Link::hello(Link::connect(address)?).map(drop)
}

impl LinuxCnc {
    /// A controller at `HOST:PORT`, which reads programs from `folder`. Nothing is sent yet.
    pub fn new(address: &str, folder: &Path) -> Self {
        Self {
            address: address.to_owned(),
            folder: folder.to_path_buf(),
            link: None,
            order: [0, 1, 2, 3, 4],
            file: None,
            created: Instant::now(),
            started: false,
        }
    }

    fn link(&mut self) -> Result<&mut Link, StageError> {
        let text = || format!("there is no connection to linuxcnc://{}", self.address);
        self.link.as_mut().ok_or_else(|| StageError::new(NO_CONNECTION, text()))
    }

    /// A failure to talk, by whether the program had been started.
    fn lost(&self, why: &str) -> StageError {
        if self.started {
            let text = format!(
                "the connection to linuxcnc://{} was lost while the program ran ({why}): what the machine does is not known",
                self.address
            );
            return StageError::new(CONNECTION_LOST, text);
        }
        StageError::new(NO_CONNECTION, format!("linuxcnc://{}: {why}", self.address))
    }

    fn get(&mut self, what: &str) -> Result<String, StageError> {
        let answer = self.link()?.ask(&format!("get {what}"), what);
        answer.map_err(|e| self.lost(&e))
    }

    fn parsed<T>(&mut self, what: &str, parse: impl Fn(&str) -> Option<T>) -> Result<T, StageError> {
        let rest = self.get(what)?;
        parse(&rest).ok_or_else(|| self.lost(&format!("it answers `{rest}` to `get {what}`")))
    }

    /// Sends a command, which must be acknowledged. `word` is what the acknowledgement names.
    fn set(&mut self, word: &str, value: &str) -> Result<(), StageError> {
        let command = if value.is_empty() { format!("set {word}") } else { format!("set {word} {value}") };
        let answer = self.link()?.ask(&command, &format!("set {word}"));
        match answer.map_err(|e| self.lost(&e))? {
            ack if ack.eq_ignore_ascii_case("ACK") => Ok(()),
            other => {
                let errors = self.errors()?;
                let reason =
                    if errors.is_empty() { String::new() } else { format!(": {}", errors.join("; ")) };
                let text = format!("LinuxCNC refuses `{command}` ({other}){reason}");
                Err(StageError::new(CONTROLLER_ERROR, text))
            }
        }
    }

    /// The errors that have come up since the last time, oldest first.
    fn errors(&mut self) -> Result<Vec<String>, StageError> {
        let mut errors = Vec::new();
        while errors.len() < STRAY_LINES {
            let rest = self.get("error")?;
            match protocol::error(&rest) {
                Some(text) => errors.push(text.to_owned()),
                None => break,
            }
        }
        let strays = self.link()?.strays.drain(..).collect::<Vec<_>>();
        errors.extend(strays.into_iter().filter(|line| !line.is_empty()));
        Ok(errors)
    }

    fn switch_on(&mut self) -> Result<(), StageError> {
        if self.parsed("program_status", protocol::program_status)? != ProgramStatus::Idle {
            let text = format!("linuxcnc://{} is at work on another program", self.address);
            return Err(StageError::new(BUSY, text));
        }
        // What was wrong before is not this run's.
        self.errors()?;
        self.set("set_wait", "done")?;
        // In an emergency stop it changes no mode.
        for (what, wanted) in [("estop", "off"), ("machine", "on"), ("mode", "manual")] {
            self.set(what, wanted)?;
            self.wait_for(what, wanted, CONNECT)?;
        }
        Ok(())
    }

    /// Waits until `get what` answers `wanted`.
    fn wait_for(&mut self, what: &str, wanted: &str, patience: Duration) -> Result<(), StageError> {
        let end = Instant::now() + patience;
        loop {
            let now = self.get(what)?;
            if now.eq_ignore_ascii_case(wanted) {
                return Ok(());
            }
            if Instant::now() >= end {
                let errors = self.errors()?.join("; ");
                let text = format!("LinuxCNC: {what} stays {now}, {wanted} was asked for; {errors}");
                return Err(StageError::new(CONTROLLER_ERROR, text.trim_end_matches(['.', ';', ' '])));
            }
            std::thread::sleep(PERIOD);
        }
    }

    fn home(&mut self) -> Result<(), StageError> {
        if self.parsed("joint_homed", protocol::all_homed)? {
            return Ok(());
        }
        // In the joints' own mode; homing a real machine takes longer than an answer may.
        self.set("set_wait", "received")?;
        self.set("teleop_enable", "off")?;
        self.set("home", "-1")?;
        let end = Instant::now() + HOMING;
        while !self.parsed("joint_homed", protocol::all_homed)? {
            let errors = self.errors()?;
            if !errors.is_empty() || Instant::now() >= end {
                let reason = if errors.is_empty() {
                    format!("not all joints were within {} s", HOMING.as_secs())
                } else {
                    errors.join("; ")
                };
                return Err(StageError::new(
                    CONTROLLER_ERROR,
                    format!("LinuxCNC does not home its joints: {reason}"),
                ));
            }
            std::thread::sleep(PERIOD);
        }
        Ok(())
    }

    fn load(&mut self, program: &ExecutableProgram) -> Result<(), StageError> {
        let file = write_program(&self.folder, program)?;
        let name = file.to_string_lossy().into_owned();
        self.file = Some(file);
        self.set("set_wait", "done")?;
        self.set("mode", "auto")?;
        self.wait_for("mode", "AUTO", CONNECT)?;
        self.set("open", &name)?;
        self.wait_for("program", &name, CONNECT)?;
        let errors = self.errors()?;
        if errors.is_empty() {
            return Ok(());
        }
        Err(StageError::new(
            CONTROLLER_ERROR,
            format!("LinuxCNC does not load the program: {}", errors.join("; ")),
        ))
    }
}

impl Controller for LinuxCnc {
    fn prepare(&mut self, program: &ExecutableProgram) -> Result<(), StageError> {
        self.order = joint_order(&program.machine);
        self.link = Some(Link::open(&self.address).map_err(|e| self.lost(&e))?);
        self.switch_on()?;
        self.home()?;
        self.load(program)?;
        // From here on LinuxCNC answers while it works.
        self.set("set_wait", "received")
    }

    fn start(&mut self) -> Result<(), StageError> {
        self.set("run", "")?;
        self.started = true;
        Ok(())
    }

    fn report(&mut self) -> Result<Report, StageError> {
        // Errors last: an error that ends the program is there when its end is seen.
        let joints = self.parsed("joint_pos", protocol::joint_positions)?;
        let clock = self.created.elapsed().as_secs_f64();
        let line = self.parsed("program_line", protocol::program_line)?;
        let activity = match self.parsed("program_status", protocol::program_status)? {
            ProgramStatus::Idle => Activity::Idle,
            ProgramStatus::Running => Activity::Running,
            ProgramStatus::Paused => Activity::Held,
        };
        let errors = self.errors()?;
        let line = (line > 0).then_some(line);
        Ok(Report { activity, line, joints: joints_of(&joints, &self.order), errors, clock })
    }

    fn hold(&mut self) -> Result<(), StageError> {
        self.set("pause", "")
    }

    fn resume(&mut self) -> Result<(), StageError> {
        self.set("resume", "")
    }

    fn abort(&mut self) -> Result<(), StageError> {
        self.set("abort", "")
    }
}

impl Drop for LinuxCnc {
    fn drop(&mut self) {
        if let Some(file) = &self.file {
            // LinuxCNC has read it, or has ended; a copy in a folder for temporary files does no harm.
            let _ = fs::remove_file(file);
        }
    }
}

/// Writes the program where LinuxCNC, another user, can read it; under a name that no other has.
fn write_program(folder: &Path, program: &ExecutableProgram) -> Result<PathBuf, StageError> {
    let folder = folder.canonicalize().unwrap_or_else(|_| folder.to_path_buf());
    let say = |what: String| {
        StageError::new(
            BAD_CONTROLLER,
            format!("the program cannot be put into {} for LinuxCNC: {what}", folder.display()),
        )
    };
    if folder.to_string_lossy().contains(char::is_whitespace) {
        return Err(say("linuxcncrsh takes no file names with spaces".to_owned()));
    }
    let id = program.sha256.get(..16).unwrap_or(&program.sha256);
    for number in 0..1000 {
        let path = folder.join(format!("patchmill-{id}-{}-{number}.ngc", std::process::id()));
        match fs::File::create_new(&path) {
            Ok(mut file) => {
                let written = file.write_all(program.text.as_bytes()).and_then(|()| readable_by_all(&file));
                return match written {
                    Ok(()) => Ok(path),
                    Err(e) => {
                        let _ = fs::remove_file(&path);
                        Err(say(e.to_string()))
                    }
                };
            }
            Err(e) if e.kind() == ErrorKind::AlreadyExists => {}
            Err(e) => return Err(say(e.to_string())),
        }
    }
    Err(say("every name is taken".to_owned()))
}

fn readable_by_all(file: &fs::File) -> std::io::Result<()> {
    use std::os::unix::fs::PermissionsExt;
    file.set_permissions(fs::Permissions::from_mode(0o644))
}

/// The connection. Errors are texts; who calls knows what they mean.
struct Link {
    stream: BufReader<TcpStream>,
    /// Lines that were no answer.
    strays: Vec<String>,
}

impl Link {
    /// Connects, greets, asks for control and for acknowledgements.
    fn open(address: &str) -> Result<Self, String> {
        Self::greet(Self::connect(address)?)
    }

    fn connect(address: &str) -> Result<TcpStream, String> {
        let mut failure = "the name has no address".to_owned();
        for socket in address.to_socket_addrs().map_err(|e| e.to_string())? {
            match TcpStream::connect_timeout(&socket, CONNECT) {
                Ok(stream) => return Ok(stream),
                Err(e) => failure = e.to_string(),
            }
        }
        Err(format!("{failure}; expected linuxcncrsh to listen there"))
    }

    fn greet(stream: TcpStream) -> Result<Self, String> {
        let mut link = Self::hello(stream)?;
        // Until now it repeats what it is told.
        link.send("set echo off")?;
        link.ask("set verbose on", "SET VERBOSE")?;
        link.strays.clear();
        match link.ask(ENABLE, "SET ENABLE")?.as_str() {
            "ACK" => Ok(link),
            other => Err(format!("it gives no control: {other}")),
        }
    }

    fn hello(stream: TcpStream) -> Result<Self, String> {
        let set = |result: std::io::Result<()>| result.map_err(|e| e.to_string());
        set(stream.set_read_timeout(Some(ANSWER)))?;
        set(stream.set_write_timeout(Some(ANSWER)))?;
        set(stream.set_nodelay(true))?;
        let mut link = Self { stream: BufReader::new(stream), strays: Vec::new() };
        let hello = link.ask(HELLO, "HELLO")?;
        if !hello.to_ascii_uppercase().starts_with("ACK") {
            return Err(format!("it does not greet back as linuxcncrsh does, but with `HELLO {hello}`"));
        }
        Ok(link)
    }

    fn send(&mut self, command: &str) -> Result<(), String> {
        let line = format!("{command}\r\n");
        self.stream.get_mut().write_all(line.as_bytes()).map_err(|e| e.to_string())
    }

    /// Sends a command; what follows `word` in the line that begins with it.
    fn ask(&mut self, command: &str, word: &str) -> Result<String, String> {
        self.send(command)?;
        for _ in 0..=STRAY_LINES {
            let line = self.line()?;
            if let Some(rest) = rest_of(&line, word) {
                return Ok(rest.to_owned());
            }
            if line.to_ascii_uppercase().ends_with(" NAK") {
                return Err(format!("it does not take `{command}`"));
            }
            self.strays.push(line);
        }
        Err(format!("it does not answer `{command}`"))
    }

    fn line(&mut self) -> Result<String, String> {
        match protocol::read_line(&mut self.stream) {
            Ok(None) => Err("it closed the connection".to_owned()),
            Ok(Some(line)) => Ok(line),
            Err(e) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {
                Err(format!("no answer within {} s", ANSWER.as_secs()))
            }
            Err(e) => Err(e.to_string()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn controllers_are_named_by_scheme_host_and_port() {
        assert_eq!(address("linuxcnc://127.0.0.1:5007"), Some("127.0.0.1:5007"));
        assert_eq!(address("linuxcnc://mill:5007"), Some("mill:5007"));
        for other in ["sim", "linuxcnc://mill", "linuxcnc://:5007", "linuxcnc://mill:99999", "http://mill:80"]
        {
            assert_eq!(address(other), None, "{other}");
        }
    }
}
