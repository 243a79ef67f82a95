//! How long a node takes to be found by others, from the start of its process.

use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use patchmill_msgs::msg::{Job, StageStatus};
use patchmill_node_runtime::{Node, NodeOptions, Publisher, Qos, block_on, free_domain, topics};
use patchmill_tests::children::Children;
use patchmill_tests::executables::executable;
use serde_json::Value;

use crate::{Outcome, PATIENCE, peer, ros_python, spread};

const STAGE: &str = topics::nodes::ROLLING_BALL_ANALYSIS;

/// Asks every millisecond.
async fn until(jobs: &Publisher<Job>, count: usize) -> Outcome<()> {
    let end = Instant::now() + PATIENCE;
    while jobs.subscription_count() != count {
        if Instant::now() > end {
            return Err(format!("the number of readers did not become {count}").into());
        }
        tokio::time::sleep(Duration::from_millis(1)).await;
    }
    Ok(())
}

/// To the match of its subscription, and to its first latched message.
async fn to_rust(runs: usize) -> Outcome<(Vec<f64>, Vec<f64>)> {
    let lease = free_domain()?;
    let node = Node::start(NodeOptions::local("observer", lease.domain()))?;
    let jobs = node.publisher::<Job>(topics::JOB, Qos::Status)?;
    let (mut matched, mut heard) = (Vec::new(), Vec::new());
    for _ in 0..runs {
        let mut statuses = node.subscribe::<StageStatus>(&topics::status(STAGE), Qos::Status)?;
        let (mut process, began) = (Children::default(), Instant::now());
        let mut command = Command::new(executable(STAGE));
        process.start(command.env("ROS_DOMAIN_ID", lease.domain().to_string()).stderr(Stdio::null()));
        until(&jobs, 1).await?;
        matched.push(began.elapsed().as_secs_f64());
        tokio::time::timeout(PATIENCE, statuses.next()).await?.ok_or("shut down")?;
        heard.push(began.elapsed().as_secs_f64());
        process.terminate();
        process.wait(PATIENCE);
        until(&jobs, 0).await?;
    }
    node.shutdown().await;
    Ok((matched, heard))
}

fn to_rclpy(python: &str, runs: usize) -> Outcome<Value> {
    let lease = free_domain()?;
    let output = Command::new(python)
        .arg(peer("discovery.py"))
        .arg(executable(STAGE))
        .arg(runs.to_string())
        .env("ROS_DOMAIN_ID", lease.domain().to_string())
        .env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        .stderr(Stdio::inherit())
        .output()?;
    Ok(serde_json::from_slice(&output.stdout)?)
}

/// Prints all.
pub fn measure(runs: usize) -> Outcome<()> {
    println!(
        "Discovery of a node that is started while the other runs, from the start of its process, {runs} runs: least / median / most"
    );
    let (matched, heard) = block_on(to_rust(runs))??;
    println!(
        "by a Rust node: subscription matched {}, first latched message {}",
        spread(matched),
        spread(heard)
    );
    let Some(python) = ros_python() else {
        println!("rclpy was not measured: PATCHMILL_ROS_PYTHON is not set");
        return Ok(());
    };
    let seen = to_rclpy(&python, runs)?;
    let times = |key: &str| {
        let list = seen[key].as_array().into_iter().flatten();
        spread(list.filter_map(Value::as_f64).collect())
    };
    println!(
        "by rclpy (Fast DDS): in the node graph {}, subscription matched {}, first latched message {}",
        times("graph"),
        times("matched"),
        times("heard")
    );
    Ok(())
}
