//! The client of `linuxcncrsh`: what is asked of it in a run, every answer checked.

use super::link::{ANSWER, Link, STRAY_LINES};
use super::program_file::ProgramFile;
use super::protocol::{self, ProgramStatus};
use super::{joint_order, joints_of};
use crate::execution::complaints::Complaints;
use crate::execution::controller::{Activity, Controller, Report};
use crate::execution::orders::Orders;
use crate::execution::program::ExecutableProgram;
use crate::execution::run::given_up;
use crate::execution::{BUSY, CONNECTION_LOST, CONTROLLER_ERROR, NO_CONNECTION};
use patchmill_products::stage::StageError;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// While waiting LinuxCNC is asked so often.
const PERIOD: Duration = Duration::from_millis(50);

/// How long LinuxCNC may take.
#[derive(Clone, Copy, Debug)]
struct Patience {
    /// For a whole answer.
    answer: Duration,
    /// For what has been acknowledged to be so.
    change: Duration,
    /// For all joints to be homed.
    homing: Duration,
}

const PATIENCE: Patience =
    Patience { answer: ANSWER, change: Duration::from_secs(5), homing: Duration::from_secs(300) };

/// What the machine may be doing on our command, whether or not LinuxCNC still answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Motion {
    None,
    Homing,
    Program,
}

/// A LinuxCNC that listens.
pub struct LinuxCnc {
    address: String,
    /// Folder that LinuxCNC reads programs from.
    folder: PathBuf,
    link: Option<Link>,
    order: [usize; 5],
    file: Option<ProgramFile>,
    created: Instant,
    motion: Motion,
    patience: Patience,
}

/// `HOST:PORT` of `linuxcnc://HOST:PORT`; `None` for any other text.
pub fn address(controller: &str) -> Option<&str> {
    let address = controller.strip_prefix("linuxcnc://")?;
    host_and_port(address).map(|_| address)
}

/// The parts of `HOST:PORT`; `None` for any other text. A host has none of the characters that a list of controllers is divided by.
pub fn host_and_port(address: &str) -> Option<(&str, u16)> {
    let (host, port) = address.rsplit_once(':')?;
    let named = !host.is_empty() && !host.contains(|c: char| c == '/' || c == ',' || c.is_whitespace());
    port.parse().ok().filter(|_| named).map(|port| (host, port))
}

/// Asks whether a linuxcncrsh at `HOST:PORT` greets back; nothing else is sent.
///
/// # Errors
/// Why not, in a few words.
pub fn greets(address: &str) -> Result<(), String> {
    Link::hello(address, ANSWER).map(drop)
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
            motion: Motion::None,
            patience: PATIENCE,
        }
    }

    fn link(&mut self) -> Result<&mut Link, StageError> {
        let text = || format!("there is no connection to linuxcnc://{}", self.address);
        self.link.as_mut().ok_or_else(|| StageError::new(NO_CONNECTION, text()))
    }

    /// A failure to talk, by whether the machine may move.
    fn lost(&self, why: &str) -> StageError {
        let meanwhile = match self.motion {
            Motion::None => {
                return StageError::new(NO_CONNECTION, format!("linuxcnc://{}: {why}", self.address));
            }
            Motion::Homing => "the joints were homed",
            Motion::Program => "the program ran",
        };
        let text = format!(
            "the connection to linuxcnc://{} was lost while {meanwhile} ({why}): what the machine does is not known",
            self.address
        );
        StageError::new(CONNECTION_LOST, text)
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
                let errors = self.complaints()?;
                let reason = if errors.is_empty() { String::new() } else { format!(": {errors}") };
                let text = format!("LinuxCNC refuses `{command}` ({other}){reason}");
                Err(StageError::new(CONTROLLER_ERROR, text))
            }
        }
    }

    /// The errors that have come up since the last time, oldest first; what does not come soon comes the next time.
    fn errors(&mut self) -> Result<Vec<String>, StageError> {
        let (mut errors, end) = (Vec::new(), Instant::now() + self.patience.answer);
        while errors.len() < STRAY_LINES && Instant::now() < end {
            let rest = self.get("error")?;
            match protocol::error(&rest) {
                Some(text) => errors.push(text.to_owned()),
                None => break,
            }
        }
        errors.extend(self.link()?.take_strays().into_iter().filter(|line| !line.is_empty()));
        Ok(errors)
    }

    fn complaints(&mut self) -> Result<Complaints, StageError> {
        Ok(self.errors()?.iter().collect())
    }

    fn switch_on(&mut self, orders: &Orders) -> Result<(), StageError> {
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
            self.wait_for(what, wanted, orders)?;
        }
        Ok(())
    }

    /// Waits until `get what` answers `wanted`.
    fn wait_for(&mut self, what: &str, wanted: &str, orders: &Orders) -> Result<(), StageError> {
        let end = Instant::now() + self.patience.change;
        loop {
            orders.go_on()?;
            let now = self.get(what)?;
            if now.eq_ignore_ascii_case(wanted) {
                return Ok(());
            }
            if Instant::now() >= end {
                let errors = self.complaints()?;
                let text = format!("LinuxCNC: {what} stays {now}, {wanted} was asked for; {errors}");
                return Err(StageError::new(CONTROLLER_ERROR, text.trim_end_matches(['.', ';', ' '])));
            }
            std::thread::sleep(PERIOD);
        }
    }

    fn home(&mut self, orders: &Orders) -> Result<(), StageError> {
        if self.parsed("joint_homed", protocol::all_homed)? {
            return Ok(());
        }
        // In the joints' own mode; homing a real machine takes longer than an answer may.
        self.set("set_wait", "received")?;
        self.set("teleop_enable", "off")?;
        orders.go_on()?;
        self.motion = Motion::Homing;
        if let Err(e) = self.follow_homing(orders) {
            return Err(given_up(self, e));
        }
        self.motion = Motion::None;
        Ok(())
    }

    fn follow_homing(&mut self, orders: &Orders) -> Result<(), StageError> {
        self.set("home", "-1")?;
        let end = Instant::now() + self.patience.homing;
        while !self.parsed("joint_homed", protocol::all_homed)? {
            orders.go_on()?;
            let errors = self.complaints()?;
            let reason = match (errors.is_empty(), Instant::now() >= end) {
                (false, _) => errors.to_string(),
                (true, true) => {
                    format!("not all joints were within {} s", self.patience.homing.as_secs_f64())
                }
                (true, false) => {
                    std::thread::sleep(PERIOD);
                    continue;
                }
            };
            let text = format!("LinuxCNC does not home its joints: {reason}");
            return Err(StageError::new(CONTROLLER_ERROR, text));
        }
        Ok(())
    }

    fn load(&mut self, program: &ExecutableProgram, orders: &Orders) -> Result<(), StageError> {
        let file = ProgramFile::write(&self.folder, program)?;
        let name = file.name();
        self.file = Some(file);
        self.set("set_wait", "done")?;
        self.set("mode", "auto")?;
        self.wait_for("mode", "AUTO", orders)?;
        self.set("open", &name)?;
        self.wait_for("program", &name, orders)?;
        let errors = self.complaints()?;
        if errors.is_empty() {
            return Ok(());
        }
        Err(StageError::new(CONTROLLER_ERROR, format!("LinuxCNC does not load the program: {errors}")))
    }
}

impl Controller for LinuxCnc {
    fn prepare(&mut self, program: &ExecutableProgram, orders: &Orders) -> Result<(), StageError> {
        self.order = joint_order(&program.machine);
        let link = Link::open(&self.address, self.patience.answer);
        self.link = Some(link.map_err(|e| self.lost(&e))?);
        self.switch_on(orders)?;
        self.home(orders)?;
        self.load(program, orders)?;
        // From here on LinuxCNC answers while it works.
        self.set("set_wait", "received")
    }

    fn start(&mut self) -> Result<(), StageError> {
        // Before it is said: the answer may be lost, the command not.
        self.motion = Motion::Program;
        self.set("run", "")
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

#[cfg(test)]
mod tests;
