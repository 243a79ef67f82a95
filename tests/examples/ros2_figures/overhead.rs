//! What DDS and separate processes cost a plan: from goal to result, against the same stages called one after the other in this process.

use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use patchmill_machine_interface::MachineParams;
use patchmill_machine_interface::evaluate::evaluate;
use patchmill_msgs::action::{PlanSurface, PlanSurfaceGoal};
use patchmill_msgs::builtin_interfaces::msg::Time;
use patchmill_node_runtime::{ActionEnd, Node, NodeOptions, block_on, free_domain, topics};
use patchmill_products::job::Job;
use patchmill_products::stage::unobserved;
use patchmill_tests::children::Children;
use patchmill_tests::executables::executable;

use crate::{Outcome, PATIENCE, spread};

fn in_process(surface: &Path) -> Outcome<(f64, f64)> {
    let began = Instant::now();
    let planned = patchmill_tests::plan(surface, Job::default_for("")).map_err(|e| e.text)?;
    let mesh = &planned.surface.mesh;
    let output = evaluate(&planned.toolpaths, mesh, &planned.job, &MachineParams::default(), &unobserved());
    let program = output.map_err(|e| e.text)?.program.ok_or("no candidate is feasible")?;
    Ok((began.elapsed().as_secs_f64(), program.machining_time))
}

async fn over_dds(surface: &Path, runs: usize) -> Outcome<Vec<(f64, f64)>> {
    let lease = free_domain()?;
    let folder = surface.parent().ok_or("the surface has no folder")?;
    let mut nodes = Children::default();
    for name in topics::nodes::STAGES.iter().chain([&topics::nodes::PLANNER]) {
        let mut command = Command::new(executable(name));
        command.env("ROS_DOMAIN_ID", lease.domain().to_string()).current_dir(folder);
        nodes.start(command.stderr(Stdio::null()));
    }
    let node = Node::start(NodeOptions::local("client", lease.domain()))?;
    let client = node.action_client::<PlanSurface>(topics::PLAN_SURFACE)?;
    let mut times = Vec::new();
    // The first goal also waits for the nodes to find each other: it does not count.
    for _ in 0..=runs {
        let goal = PlanSurfaceGoal {
            path: surface.to_string_lossy().into_owned(),
            job: Job::default_for("").to_msg(Time::default()),
            ..PlanSurfaceGoal::default()
        };
        let began = Instant::now();
        let never = std::future::pending();
        match client.execute(goal, PATIENCE, |_| {}, never).await? {
            ActionEnd::Succeeded(result) => {
                times.push((began.elapsed().as_secs_f64(), result.program.machining_time));
            }
            other => return Err(other.result().text.clone().into()),
        }
    }
    node.shutdown().await;
    nodes.terminate();
    nodes.wait(Duration::from_secs(20));
    Ok(times.split_off(1))
}

/// Prints both times.
pub fn measure(surface: &Path, runs: usize) -> Outcome<()> {
    let surface = surface.canonicalize()?;
    let alone = (0..runs).map(|_| in_process(&surface)).collect::<Outcome<Vec<_>>>()?;
    let apart = block_on(over_dds(&surface, runs))??;
    let machining = alone[0].1;
    let same = alone.iter().chain(&apart).all(|(_, time)| *time == machining);
    let times = |all: &[(f64, f64)]| spread(all.iter().map(|(t, _)| *t).collect());
    println!("Plan of {} with all defaults, {runs} runs: least / median / most", surface.display());
    println!("one process without DDS: {}", times(&alone));
    println!("six processes over DDS, goal to result: {}", times(&apart));
    println!("machining time {machining:.3} s in all runs: {}", if same { "yes" } else { "NO" });
    Ok(())
}
