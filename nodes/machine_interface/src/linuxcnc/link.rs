//! The connection to `linuxcncrsh`: a text line out, a text line back. Errors are texts; who calls knows what they mean.

use super::protocol::{self, rest_of};
use std::io::{self, BufReader, ErrorKind, Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::time::{Duration, Instant};

/// For a connection.
const CONNECT: Duration = Duration::from_secs(5);
/// For a question and the whole of its answer.
pub(super) const ANSWER: Duration = Duration::from_secs(15);
/// Lines that may come before the answer: the rest of an error text of several lines. As many are kept.
pub(super) const STRAY_LINES: usize = 50;
/// The passwords that linuxcncrsh has unless it is told others.
const HELLO: &str = "hello EMC patchmill 1.0";
const ENABLE: &str = "set enable EMCTOO";

/// The connection.
pub(super) struct Link {
    stream: BufReader<Timed>,
    /// For a question and the whole of its answer.
    patience: Duration,
    /// Lines that were no answer, the first of them.
    strays: Vec<String>,
}

impl Link {
    /// Connects, greets, asks for control and for acknowledgements.
    pub(super) fn open(address: &str, patience: Duration) -> Result<Self, String> {
        let mut link = Self::hello(address, patience)?;
        // Until now it repeats what it is told.
        link.send("set echo off")?;
        link.ask("set verbose on", "SET VERBOSE")?;
        link.strays.clear();
        match link.ask(ENABLE, "SET ENABLE")?.as_str() {
            "ACK" => Ok(link),
            other => Err(format!("it gives no control: {other}")),
        }
    }

    /// Connects and greets; nothing else is sent.
    pub(super) fn hello(address: &str, patience: Duration) -> Result<Self, String> {
        let stream = connect(address)?;
        stream.set_nodelay(true).map_err(|e| e.to_string())?;
        let stream = BufReader::new(Timed { stream, end: Instant::now() });
        let mut link = Self { stream, patience, strays: Vec::new() };
        let hello = link.ask(HELLO, "HELLO")?;
        if !hello.to_ascii_uppercase().starts_with("ACK") {
            return Err(format!("it does not greet back as linuxcncrsh does, but with `HELLO {hello}`"));
        }
        Ok(link)
    }

    /// Sends a command; what follows `word` in the line that begins with it.
    pub(super) fn ask(&mut self, command: &str, word: &str) -> Result<String, String> {
        self.send(command)?;
        for _ in 0..=STRAY_LINES {
            let line = self.line()?;
            if let Some(rest) = rest_of(&line, word) {
                return Ok(rest.to_owned());
            }
            if line.to_ascii_uppercase().ends_with(" NAK") {
                return Err(format!("it does not take `{command}`"));
            }
            if self.strays.len() < STRAY_LINES {
                self.strays.push(line);
            }
        }
        Err(format!("it does not answer `{command}`"))
    }

    /// The lines that have come and were no answer, the first of them.
    pub(super) fn take_strays(&mut self) -> Vec<String> {
        std::mem::take(&mut self.strays)
    }

    /// Sends a command; from now on there is a time for its answer.
    fn send(&mut self, command: &str) -> Result<(), String> {
        self.stream.get_mut().end = Instant::now() + self.patience;
        let sent = self.stream.get_mut().write_all(format!("{command}\r\n").as_bytes());
        sent.map_err(|e| self.failure(&e))
    }

    fn line(&mut self) -> Result<String, String> {
        match protocol::read_line(&mut self.stream) {
            Ok(None) => Err("it closed the connection".to_owned()),
            Ok(Some(line)) => Ok(line),
            Err(e) => Err(self.failure(&e)),
        }
    }

    fn failure(&self, error: &io::Error) -> String {
        match error.kind() {
            ErrorKind::WouldBlock | ErrorKind::TimedOut => {
                format!("no answer within {} s", self.patience.as_secs_f64())
            }
            _ => error.to_string(),
        }
    }
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

/// A connection that is read and written until a moment, however little comes at a time.
struct Timed {
    stream: TcpStream,
    end: Instant,
}

impl Timed {
    /// Time that is left: not zero, which would mean for ever.
    fn left(&self) -> io::Result<Duration> {
        let left = self.end.saturating_duration_since(Instant::now());
        if left.is_zero() { Err(ErrorKind::TimedOut.into()) } else { Ok(left) }
    }
}

impl Read for Timed {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        self.stream.set_read_timeout(Some(self.left()?))?;
        self.stream.read(bytes)
    }
}

impl Write for Timed {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.stream.set_write_timeout(Some(self.left()?))?;
        self.stream.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.stream.flush()
    }
}
