//! Signs of life on `/diagnostics`, as every ROS monitor reads them.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use patchmill_msgs::TYPE_HASHES;
use patchmill_msgs::builtin_interfaces::msg::Time;
use patchmill_msgs::diagnostic_msgs::msg::{DiagnosticArray, DiagnosticStatus, KeyValue};
use patchmill_msgs::msg::StageStatus;
use patchmill_msgs::std_msgs::msg::Header;
use sha2::{Digest, Sha256};

use crate::node::{Node, Publisher};
use crate::qos::Qos;
use crate::stage_runner::in_log;
use crate::status::Newest;
use crate::{RuntimeError, status, topics};

/// A sign of life is given so often.
pub const PERIOD: Duration = Duration::from_millis(500);
/// A stage that is at work and has not got on for so long says so, and again whenever that time has doubled.
const SLOW: Duration = Duration::from_secs(4);
/// What was said longer ago is from a bag, or from a host with another time.
const FRESH: f64 = 5.0;

const STAGE: &str = "stage";
const STARTED: &str = "started";
const UP: &str = "up_s";
const VERSION: &str = "version";
const INTERFACES: &str = "interfaces";

/// A sign of life of a node.
#[derive(Clone, Debug, PartialEq)]
pub struct Heartbeat {
    /// Which stage; empty of a node that is none.
    pub stage: String,
    /// When its node started; another value tells of another process.
    pub started: String,
    /// For how long it has been running, s, by a clock that nobody sets; 0 of one that does not say.
    pub up: f64,
    /// What its process was built from; empty where it does not say.
    pub build: Build,
}

impl Heartbeat {
    /// Whether it is, `age` seconds old, that of another process that has been running for longer than one that `started` then and has been
    /// `up` for so long. What it says of itself left it a while ago: of two that started together neither takes itself for the younger.
    fn is_elder(&self, age: f64, started: &str, up: f64) -> bool {
        self.started != started && age.abs() <= FRESH && self.up > up
    }
}

/// What a process was built from.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Build {
    /// patchmill's version.
    pub version: String,
    /// sha256 (hex, 16 digits) over names and type hashes of all interfaces: two builds with the same one understand each other.
    pub interfaces: String,
}

impl Build {
    /// This one.
    pub fn own() -> Self {
        let mut all = Sha256::new();
        for (name, hash) in TYPE_HASHES {
            all.update(format!("{name} {hash}\n"));
        }
        let interfaces = all.finalize().iter().take(8).map(|byte| format!("{byte:02x}")).collect();
        Self { version: env!("CARGO_PKG_VERSION").to_owned(), interfaces }
    }
}

/// Starts a task that gives a sign of life twice a second until the node is shut down: of a stage what `newest` holds, with a warning when
/// its work does not get on; of any other node that it is up.
pub(crate) fn start(node: &Node, newest: Option<Arc<Mutex<Newest>>>) -> Result<(), RuntimeError> {
    let publisher: Publisher<DiagnosticArray> = node.publisher(topics::DIAGNOSTICS, Qos::Stream)?;
    let (started, begin) = (told(node.started()), node.begin());
    let (name, owner) = (node.full_name(), node.clone());
    let build = Build::own();
    node.spawn(async move {
        let mut clock = tokio::time::interval(PERIOD);
        clock.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        let mut tell = SLOW;
        loop {
            clock.tick().await;
            let origin = Origin { started: &started, up: begin.elapsed().as_secs_f64(), build: &build };
            let message = if let Some(newest) = &newest {
                let newest = newest.lock().unwrap_or_else(PoisonError::into_inner);
                let slow = standstill(&newest, Instant::now());
                let doing = in_log(&newest.status.surface_id, &newest.status.job_id);
                let message = of_stage(&name, owner.role(), &origin, &newest.status, slow);
                drop(newest);
                match slow {
                    Some(time) if time >= tell => {
                        owner.warn(format!("{}{}", message.status[0].message, doing));
                        tell = 2 * time;
                    }
                    Some(_) => {}
                    None => tell = SLOW,
                }
                message
            } else {
                diagnostics(&name, DiagnosticStatus::OK, "up".to_owned(), &origin, &[])
            };
            // One lost sign of life says nothing.
            let _ = publisher.publish(message);
        }
    });
    Ok(())
}

/// Whose sign of life it is.
struct Origin<'a> {
    started: &'a str,
    up: f64,
    build: &'a Build,
}

/// A time as signs of life have it.
fn told(time: &Time) -> String {
    format!("{}.{:09}", time.sec, time.nanosec)
}

/// How long work that is under way has not got on, from [`SLOW`] on.
fn standstill(newest: &Newest, now: Instant) -> Option<Duration> {
    let time = now.saturating_duration_since(newest.said);
    (newest.status.state == StageStatus::RUNNING && time >= SLOW).then_some(time)
}

fn of_stage(
    name: &str,
    role: &str,
    origin: &Origin<'_>,
    newest: &StageStatus,
    slow: Option<Duration>,
) -> DiagnosticArray {
    let (level, state) = match newest.state {
        StageStatus::RUNNING if slow.is_some() => (DiagnosticStatus::WARN, "running"),
        StageStatus::WAITING => (DiagnosticStatus::OK, "waiting"),
        StageStatus::RUNNING => (DiagnosticStatus::OK, "running"),
        StageStatus::DONE => (DiagnosticStatus::OK, "done"),
        StageStatus::FAILED => (DiagnosticStatus::ERROR, "failed"),
        _ => (DiagnosticStatus::OK, "idle"),
    };
    let mut message =
        if newest.text.is_empty() { state.to_owned() } else { format!("{state}: {}", newest.text) };
    if let Some(time) = slow {
        let (percent, time) = (newest.fraction * 100.0, time.as_secs());
        message += &format!(": at {percent:.0} % for {time} s without progress");
    }
    let fraction = format!("{:.3}", newest.fraction);
    let values = [
        (STAGE, role),
        ("surface_id", newest.surface_id.as_str()),
        ("job_id", newest.job_id.as_str()),
        ("fraction", fraction.as_str()),
    ];
    diagnostics(name, level, message, origin, &values)
}

fn diagnostics(
    name: &str,
    level: u8,
    message: String,
    origin: &Origin<'_>,
    more: &[(&str, &str)],
) -> DiagnosticArray {
    let (Origin { started, build, .. }, up) = (origin, format!("{:.3}", origin.up));
    let origin = [
        (STARTED, *started),
        (UP, up.as_str()),
        (VERSION, build.version.as_str()),
        (INTERFACES, build.interfaces.as_str()),
    ];
    let value = |&(key, value): &(&str, &str)| KeyValue { key: key.to_owned(), value: value.to_owned() };
    DiagnosticArray {
        header: Header { stamp: status::now(), frame_id: String::new() },
        status: vec![DiagnosticStatus {
            level,
            name: name.to_owned(),
            message,
            hardware_id: "patchmill".to_owned(),
            values: more.iter().chain(&origin).map(value).collect(),
        }],
    }
}

impl Node {
    /// Gives signs of life of a node that is no stage (those of stages come with their status). One that has keys to listen only, and so
    /// may not offer the topic, says that it gives none, and works all the same.
    ///
    /// # Errors
    /// As [`Node::publisher`], but for a topic that cannot be offered.
    pub fn give_signs_of_life(&self) -> Result<(), RuntimeError> {
        match start(self, None) {
            Err(e @ RuntimeError::Create { .. }) => {
                self.warn(format!("gives no signs of life: {e}"));
                Ok(())
            }
            done => done,
        }
    }

    /// Calls `take` with every sign of life of the stages in this node's namespace. Gives up ([`Node::gave_up`]) when a node of the
    /// same name is heard that has been running for longer: two that answer the same calls are in each other's way. What a bag plays again
    /// is none: what it says is old.
    ///
    /// # Errors
    /// As [`Node::subscribe`].
    pub fn watch_heartbeats(
        &self,
        mut take: impl FnMut(Heartbeat) + Send + 'static,
    ) -> Result<(), RuntimeError> {
        let (namespace, own, node) = (self.namespace().to_owned(), told(self.started()), self.clone());
        self.hear_heartbeats(move |name, age, heartbeat| {
            let up = node.begin().elapsed().as_secs_f64();
            if name == node.full_name() && heartbeat.is_elder(age, &own, up) {
                node.give_up(format!(
                    "{name} runs already on domain {}: for {:.1} s, this one for {up:.1} s",
                    node.domain(),
                    heartbeat.up
                ));
            } else if !heartbeat.stage.is_empty()
                && name.rsplit_once('/').map(|(ns, _)| ns) == Some(namespace.as_str())
            {
                take(heartbeat);
            }
        })
    }

    /// Calls `take` with the full name of every node that gives a sign of life, in whatever namespace, how long ago it says that it gave
    /// it (s, by the clocks of both hosts), and with that sign.
    pub(crate) fn hear_heartbeats(
        &self,
        mut take: impl FnMut(String, f64, Heartbeat) + Send + 'static,
    ) -> Result<(), RuntimeError> {
        self.subscribe_with(topics::DIAGNOSTICS, Qos::Stream, move |message: DiagnosticArray| {
            let age = seconds(&status::now()) - seconds(&message.header.stamp);
            for status in message.status {
                if let Some(heartbeat) = read(&status) {
                    take(status.name, age, heartbeat);
                }
            }
        })?;
        Ok(())
    }
}

/// `None` for what others say there.
fn read(status: &DiagnosticStatus) -> Option<Heartbeat> {
    let values: BTreeMap<&str, &str> =
        status.values.iter().map(|v| (v.key.as_str(), v.value.as_str())).collect();
    if status.hardware_id != "patchmill" {
        return None;
    }
    let value = |key| values.get(key).map(|v| (*v).to_owned());
    let build = Build {
        version: value(VERSION).unwrap_or_default(),
        interfaces: value(INTERFACES).unwrap_or_default(),
    };
    let up = values.get(UP).and_then(|v| v.parse().ok()).unwrap_or(0.0);
    Some(Heartbeat { stage: value(STAGE).unwrap_or_default(), started: value(STARTED)?, up, build })
}

fn seconds(time: &Time) -> f64 {
    f64::from(time.sec) + 1e-9 * f64::from(time.nanosec)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_heartbeat_is_read_back() {
        let newest = StageStatus { state: StageStatus::FAILED, text: "why".to_owned(), ..Default::default() };
        let build = Build::own();
        let origin = Origin { started: "7.5", up: 60.0, build: &build };
        let message = of_stage("/patchmill/n", "path_generation", &origin, &newest, None);
        assert_eq!(message.status[0].message, "failed: why");
        assert_eq!(message.status[0].level, DiagnosticStatus::ERROR);
        let expected = Heartbeat {
            stage: "path_generation".to_owned(),
            started: "7.5".to_owned(),
            up: 60.0,
            build: Build::own(),
        };
        assert_eq!(read(&message.status[0]), Some(expected));
        let other = diagnostics("/patchmill/planner", DiagnosticStatus::OK, "up".to_owned(), &origin, &[]);
        assert_eq!(read(&other.status[0]).unwrap().stage, "");
        assert_eq!(read(&DiagnosticStatus { hardware_id: "arm".to_owned(), ..Default::default() }), None);
    }

    #[test]
    fn the_younger_of_two_knows_it_and_a_bag_is_nobody() {
        let of = |started: &str, up| Heartbeat {
            stage: String::new(),
            started: started.to_owned(),
            up,
            build: Build::default(),
        };
        assert!(of("1", 60.0).is_elder(0.01, "2", 3.0));
        assert!(!of("2", 3.0).is_elder(0.01, "1", 60.0));
        // A clock that was set back between the two changes nothing.
        assert!(of("9", 60.0).is_elder(0.01, "2", 3.0) && !of("2", 3.0).is_elder(0.01, "9", 60.0));
        assert!(!of("1", 60.0).is_elder(0.0, "1", 60.1), "its own");
        assert!(!of("1", 60.0).is_elder(3600.0, "2", 3.0), "played from a bag");
        assert!(!of("1", 0.0).is_elder(0.0, "2", 3.0), "one that does not say");
    }

    #[test]
    fn work_that_does_not_get_on_names_itself_within_five_seconds() {
        let status =
            |state| StageStatus { state, text: "passes".to_owned(), fraction: 0.43, ..Default::default() };
        let said = Instant::now();
        let after = |state, s: f64| {
            let newest = Newest { status: status(state), said };
            standstill(&newest, said + Duration::from_secs_f64(s))
        };
        assert_eq!(after(StageStatus::RUNNING, 3.9), None);
        assert_eq!(after(StageStatus::WAITING, 60.0), None);
        let slow = after(StageStatus::RUNNING, 5.0 - PERIOD.as_secs_f64());
        let build = Build::own();
        let origin = Origin { started: "1", up: 60.0, build: &build };
        let message = of_stage("/patchmill/n", "n", &origin, &status(StageStatus::RUNNING), slow);
        assert_eq!(message.status[0].message, "running: passes: at 43 % for 4 s without progress");
        assert_eq!(message.status[0].level, DiagnosticStatus::WARN);
    }
}
