//! The client against a linuxcncrsh that is played: what it is told, and what it does not answer.

use super::*;
use crate::execution::ABORTED;
use crate::execution::program::tests::square;
use crate::execution::run::execute;
use std::collections::BTreeMap;
use std::io::{BufRead, BufReader, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;

/// What comes back instead of the usual answer.
enum Reply {
    /// A line.
    Line(&'static str),
    /// Nothing, ever.
    Silence,
    /// A byte now and then, no end of line.
    Drip,
    /// A line now and then, none of them the answer.
    Strays,
    /// The end of the connection.
    Close,
}

/// A linuxcncrsh for one connection. The machine does not get homed by itself.
struct Played {
    address: String,
    thread: JoinHandle<Vec<String>>,
}

impl Played {
    /// `reply` says what comes in answer to a command; `None`: the usual.
    fn start(mut reply: impl FnMut(&str) -> Option<Reply> + Send + 'static) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap().to_string();
        let thread = std::thread::spawn(move || {
            let (mut stream, _) = listener.accept().unwrap();
            let lines = BufReader::new(stream.try_clone().unwrap()).lines();
            let (mut told, mut set) = (Vec::new(), BTreeMap::new());
            for line in lines.map_while(Result::ok) {
                told.push(line.clone());
                let answered = match reply(&line) {
                    None => stream.write_all(usual(&line, &mut set).as_bytes()).is_ok(),
                    Some(Reply::Line(text)) => stream.write_all(format!("{text}\r\n").as_bytes()).is_ok(),
                    Some(Reply::Silence) => true,
                    Some(Reply::Drip) => drip(&mut stream, b"x"),
                    Some(Reply::Strays) => drip(&mut stream, b"something else\r\n"),
                    Some(Reply::Close) => false,
                };
                if !answered {
                    break;
                }
            }
            told
        });
        Self { address, thread }
    }

    /// A client of it: patient, but not with the change of a mode or with homing.
    fn client(&self, answer: Duration) -> LinuxCnc {
        let patience = Patience { answer, change: Duration::ZERO, homing: Duration::ZERO };
        LinuxCnc { patience, ..LinuxCnc::new(&self.address, &std::env::temp_dir()) }
    }

    /// All that it was told; the client has to be gone.
    fn told(self) -> Vec<String> {
        self.thread.join().unwrap()
    }
}

/// The same bytes until the client has gone.
fn drip(stream: &mut TcpStream, bytes: &[u8]) -> bool {
    while stream.write_all(bytes).is_ok() {
        std::thread::sleep(Duration::from_millis(100));
    }
    false
}

/// The answer of a LinuxCNC at rest, which is what it was set to.
fn usual(line: &str, set: &mut BTreeMap<String, String>) -> String {
    let words: Vec<&str> = line.split_whitespace().collect();
    let answer = match words[..] {
        ["hello", ..] => "HELLO ACK EMCNETSVR 1.1".to_owned(),
        ["set", "echo", "off"] => return String::new(),
        ["set", "open", name] => {
            set.insert("program".to_owned(), name.to_owned());
            "SET OPEN ACK".to_owned()
        }
        ["set", what, ..] => {
            set.insert(what.to_owned(), words.get(2).map_or("", |word| word).to_owned());
            format!("SET {} ACK", what.to_uppercase())
        }
        ["get", what] => {
            let value = match what {
                "program_status" => "IDLE",
                "error" => "OK",
                "joint_homed" => "NO NO NO NO NO",
                _ => set.get(what).map_or("", String::as_str),
            };
            format!("{} {value}", what.to_uppercase())
        }
        _ => "NAK".to_owned(),
    };
    answer + "\r\n"
}

const LONG: Duration = Duration::from_secs(30);
const SHORT: Duration = Duration::from_secs(2);

fn homed(line: &str) -> Option<Reply> {
    (line == "get joint_homed").then_some(Reply::Line("JOINT_HOMED YES YES YES YES YES"))
}

/// What an execution ends with, and what the controller was told in it.
fn run(played: Played, answer: Duration, orders: &Orders) -> (StageError, Vec<String>) {
    let mut client = played.client(answer);
    let ended = execute(&mut client, &square(), orders, &mut |_| {}, &Mutex::default());
    drop(client);
    (ended.unwrap_err(), played.told())
}

/// Whether the last thing of all that was set is the abort.
fn aborted(told: &[String]) -> bool {
    told.iter().rfind(|line| line.starts_with("set")).is_some_and(|line| line == "set abort")
}

#[test]
fn controllers_are_named_by_scheme_host_and_port() {
    assert_eq!(address("linuxcnc://127.0.0.1:5007"), Some("127.0.0.1:5007"));
    assert_eq!(address("linuxcnc://mill:5007"), Some("mill:5007"));
    for other in [
        "sim",
        "linuxcnc://mill",
        "linuxcnc://:5007",
        "linuxcnc://mill:99999",
        "linuxcnc://a,mill:5007",
        "linuxcnc://a mill:5007",
        "http://mill:80",
    ] {
        assert_eq!(address(other), None, "{other}");
    }
}

#[test]
fn homing_ends_when_the_run_is_aborted() {
    let orders = Arc::new(Orders::default());
    let from_outside = Arc::clone(&orders);
    let played = Played::start(move |line| {
        if line == "set home -1" {
            from_outside.abort();
        }
        None
    });
    let mut client = played.client(LONG);
    client.patience.homing = LONG;
    let error = client.prepare(&square(), &orders).unwrap_err();
    drop(client);
    assert_eq!(error.code, ABORTED, "{error}");
    let told = played.told();
    assert!(told.contains(&"set home -1".to_owned()) && aborted(&told), "{told:?}");
}

#[test]
fn a_run_that_is_aborted_before_it_moves_anything_moves_nothing() {
    let orders = Orders::default();
    orders.abort();
    let (error, told) = run(Played::start(|_| None), LONG, &orders);
    assert_eq!(error.code, ABORTED, "{error}");
    assert!(!told.iter().any(|line| line.starts_with("set home") || line == "set run"), "{told:?}");
}

#[test]
fn a_machine_that_does_not_home_is_stopped() {
    type Script = fn(&str) -> Option<Reply>;
    let refused: Script =
        |line| (line == "set home -1").then_some(Reply::Line("joint 2 on limit switch\r\nSET HOME NAK"));
    let silent: Script = |line| (line == "set home -1").then_some(Reply::Silence);
    for (script, code, words) in [
        ((|_| None) as Script, CONTROLLER_ERROR, "not all joints were within 0 s"),
        (refused, CONTROLLER_ERROR, "joint 2 on limit switch"),
        (silent, CONNECTION_LOST, "while the joints were homed (no answer within 2 s)"),
    ] {
        let answer = if code == CONNECTION_LOST { SHORT } else { LONG };
        let (error, told) = run(Played::start(script), answer, &Orders::default());
        assert_eq!(error.code, code, "{error}");
        assert!(error.text.contains(words), "{error}");
        assert!(aborted(&told), "{told:?}");
    }
}

#[test]
fn a_connection_that_ends_while_homing_leaves_the_machine() {
    let mut homes = false;
    let played = Played::start(move |line| {
        homes |= line == "set home -1";
        (homes && line == "get joint_homed").then_some(Reply::Close)
    });
    let (error, _) = run(played, LONG, &Orders::default());
    assert_eq!(error.code, CONNECTION_LOST, "{error}");
    // Before anything moves there is nothing to be left.
    let played = Played::start(|line| (line == "get joint_homed").then_some(Reply::Close));
    assert_eq!(run(played, LONG, &Orders::default()).0.code, NO_CONNECTION);
}

#[test]
fn an_abort_that_is_not_answered_leaves_the_machine() {
    for by_order in [false, true] {
        let orders = Arc::new(Orders::default());
        let from_outside = Arc::clone(&orders);
        let played = Played::start(move |line| {
            if by_order && line == "set home -1" {
                from_outside.abort();
            }
            (line == "set abort").then_some(Reply::Close)
        });
        let (error, told) = run(played, LONG, &orders);
        assert_eq!(error.code, CONNECTION_LOST, "{error}");
        let why = if by_order { "the run was aborted" } else { "does not home its joints" };
        assert!(error.text.contains(why) && error.text.contains("is not known"), "{error}");
        assert!(aborted(&told), "{told:?}");
    }
}

#[test]
fn a_start_without_an_answer_counts_as_a_start() {
    let played = Played::start(|line| match line {
        "set run" => Some(Reply::Silence),
        _ => homed(line),
    });
    let (error, told) = run(played, SHORT, &Orders::default());
    assert_eq!(error.code, CONNECTION_LOST, "{error}");
    assert!(error.text.contains("while the program ran"), "{error}");
    assert!(told.contains(&"set run".to_owned()) && aborted(&told), "{told:?}");
}

#[test]
fn a_program_of_others_is_left_alone() {
    let played =
        Played::start(|line| (line == "get program_status").then_some(Reply::Line("PROGRAM_STATUS RUNNING")));
    let (error, told) = run(played, LONG, &Orders::default());
    assert_eq!(error.code, BUSY, "{error}");
    assert!(!told.contains(&"set abort".to_owned()), "{told:?}");
}

#[test]
fn an_answer_that_drips_has_one_time_for_all() {
    for strays in [false, true] {
        let played = Played::start(move |line| {
            let reply = || if strays { Reply::Strays } else { Reply::Drip };
            (line == "get joint_homed").then(reply)
        });
        let (error, _) = run(played, SHORT, &Orders::default());
        assert_eq!(error.code, NO_CONNECTION, "{error}");
        assert!(error.text.contains("no answer within 2 s"), "{error}");
    }
}

#[test]
fn errors_without_end_are_bounded() {
    let played = Played::start(|line| (line == "get error").then_some(Reply::Line("ERROR following error")));
    let mut client = played.client(LONG);
    client.link = Some(Link::open(&client.address, LONG).unwrap());
    assert_eq!(client.errors().unwrap(), vec!["following error"; STRAY_LINES]);
    let text = client.complaints().unwrap().to_string();
    assert!(text.ends_with("following error; and 30 more"), "{text}");
}
