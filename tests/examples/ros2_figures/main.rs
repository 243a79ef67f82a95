//! Figures of the ROS side, measured on this machine: large products between processes, what DDS costs a plan, discovery.
//! `tests/benches/ros2_figures.sh` builds and runs all of it.
#![allow(clippy::print_stdout, reason = "a command line program")]

mod discovery;
mod overhead;
mod products;

use std::time::{Duration, SystemTime};

use patchmill_node_runtime::{Arguments, NodeOptions, ParameterSet};

const USAGE: &str = "usage: ros2_figures products [RUNS] | overhead SURFACE [RUNS] | discovery [RUNS] | bowl FILE N\n\
    PATCHMILL_ROS_PYTHON: a Python with rclpy and patchmill_msgs, for the peers; PATCHMILL_READER_PREFIX: words before the readers'\n\
    command of `products`, such as `ip netns exec NAME` (with ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET)";

type Outcome<T> = Result<T, Box<dyn std::error::Error>>;

fn main() -> Outcome<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let runs = |text: Option<&&str>, default: usize| text.map_or(Ok(default), |t| t.parse());
    match words.as_slice() {
        ["products", rest @ ..] => products::measure(runs(rest.first(), 3)?),
        ["receive", domain] => products::receive(domain.parse()?),
        ["overhead", surface, rest @ ..] => overhead::measure(surface.as_ref(), runs(rest.first(), 3)?),
        ["discovery", rest @ ..] => discovery::measure(runs(rest.first(), 10)?),
        ["bowl", file, n] => Ok(patchmill_tests::bowl::write_bowl(file.as_ref(), n.parse()?)?),
        _ => Err(USAGE.into()),
    }
}

/// Seconds since 1970: comparable between the processes of a machine.
fn clock() -> f64 {
    SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default().as_secs_f64()
}

/// A node in a domain; the environment says whether it keeps to this machine.
fn options(name: &str, domain: u16) -> Outcome<NodeOptions> {
    let arguments = Arguments::parse([], name, |variable| std::env::var(variable).ok())?;
    Ok(NodeOptions { arguments: Arguments { domain, ..arguments }, parameters: ParameterSet::new() })
}

/// A Python that has rclpy.
fn ros_python() -> Option<String> {
    std::env::var("PATCHMILL_ROS_PYTHON").ok().filter(|python| !python.is_empty())
}

/// A script of `tests/peers`.
fn peer(name: &str) -> std::path::PathBuf {
    std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("peers").join(name)
}

/// `least / median / most`, s.
fn spread(mut seconds: Vec<f64>) -> String {
    seconds.sort_by(f64::total_cmp);
    match (seconds.first(), seconds.get(seconds.len() / 2), seconds.last()) {
        (Some(least), Some(median), Some(most)) => format!("{least:.2} / {median:.2} / {most:.2} s"),
        _ => "none".to_owned(),
    }
}

const PATIENCE: Duration = Duration::from_secs(120);
