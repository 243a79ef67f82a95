//! Stages killed (`kill -9`) while they work: the planner says within five seconds which one is gone, goes on when it is back,
//! gives up with a clear error when it is not, and plans the next part without a restart.
#![allow(clippy::unwrap_used, reason = "a test's own helpers may fail like the test")]

use std::time::{Duration, Instant};

use patchmill_msgs::action::{PlanSurface, PlanSurfaceFeedback, PlanSurfaceGoal, PlanSurfaceResult};
use patchmill_msgs::builtin_interfaces::msg::Time;
use patchmill_node_runtime::{ActionClient, ActionEnd, Node, NodeOptions, block_on, free_domain, topics};
use patchmill_products::job::Job;
use patchmill_tests::processes::Stack;
use tokio::sync::mpsc;

/// For a whole goal, faults included.
const PATIENCE: Duration = Duration::from_secs(120);

fn goal(path: &str) -> PlanSurfaceGoal {
    let job = Job { patches_min: 1, patches_max: 2, ..Job::default_for("") };
    PlanSurfaceGoal { path: path.to_owned(), job: job.to_msg(Time::default()), ..PlanSurfaceGoal::default() }
}

/// A goal under way: its feedback as it comes, and its end.
async fn plan(
    client: &ActionClient<PlanSurface>,
    path: &str,
    feedback: mpsc::UnboundedSender<PlanSurfaceFeedback>,
) -> ActionEnd<PlanSurfaceResult> {
    let tell = |f| {
        // Once the test has seen enough nobody listens.
        let _ = feedback.send(f);
    };
    let end = client.execute(goal(path), Duration::from_secs(20), tell, std::future::pending());
    tokio::time::timeout(PATIENCE, end).await.expect("the goal ends").unwrap()
}

async fn until(
    feedback: &mut mpsc::UnboundedReceiver<PlanSurfaceFeedback>,
    wanted: impl Fn(&PlanSurfaceFeedback) -> bool,
) -> PlanSurfaceFeedback {
    loop {
        let next = feedback.recv().await.expect("the goal ended before the feedback that was awaited");
        if wanted(&next) {
            return next;
        }
    }
}

fn program_hash(end: ActionEnd<PlanSurfaceResult>) -> String {
    match end {
        ActionEnd::Succeeded(result) => result.program.content_hash,
        other => panic!("{}: {}", other.result().stage, other.result().text),
    }
}

#[test]
fn a_killed_stage_is_reported_and_a_restarted_one_takes_up_the_job() {
    block_on(async {
        let lease = free_domain().unwrap();
        // Clustering takes long enough to be hit.
        let mut stack = Stack::start(lease.domain(), &["-p", "surface_partitioning:restarts:=1000"]);
        let node = Node::start(NodeOptions::local("faults", lease.domain())).unwrap();
        let client = node.action_client(topics::PLAN_SURFACE).unwrap();
        let (sender, _quiet) = mpsc::unbounded_channel();
        let undisturbed = program_hash(plan(&client, "surface_1.json", sender).await);
        assert_eq!(undisturbed.len(), 64);
        for stage in topics::nodes::STAGES {
            let (sender, mut feedback) = mpsc::unbounded_channel();
            let disturb = async {
                // It works on this goal now.
                until(&mut feedback, |f| f.stage == stage && !f.text.contains("restarted")).await;
                stack.kill(stage);
                let killed = Instant::now();
                let told = until(&mut feedback, |f| f.text.contains("is gone")).await;
                let noticed = killed.elapsed();
                assert_eq!(told.stage, stage);
                assert!(noticed < Duration::from_secs(5), "{stage} was missed after {noticed:?}");
                stack.spawn(stage);
                until(&mut feedback, |f| f.stage == stage && f.text.contains("restarted")).await;
            };
            let (end, ()) = tokio::join!(plan(&client, "surface_1.json", sender), disturb);
            assert_eq!(program_hash(end), undisturbed, "after {stage} was killed");
        }
        node.shutdown().await;
    })
    .unwrap();
}

#[test]
fn a_stage_that_stays_away_ends_the_goal_with_its_name() {
    block_on(async {
        let lease = free_domain().unwrap();
        let mut stack = Stack::start(lease.domain(), &["-p", "planner:return_timeout_s:=6.0"]);
        let node = Node::start(NodeOptions::local("faults", lease.domain())).unwrap();
        let client = node.action_client(topics::PLAN_SURFACE).unwrap();
        let (sender, mut feedback) = mpsc::unbounded_channel();
        let disturb = async {
            until(&mut feedback, |f| f.stage == "path_generation").await;
            stack.kill("path_generation");
        };
        let (end, ()) = tokio::join!(plan(&client, "surface_1.json", sender), disturb);
        let ActionEnd::Aborted(result) = end else { panic!("the goal did not abort") };
        assert_eq!((result.stage.as_str(), result.code), ("path_generation", 606), "{}", result.text);
        assert!(result.text.contains("did not come back within 6 s"), "{}", result.text);

        stack.spawn("path_generation");
        let (sender, _quiet) = mpsc::unbounded_channel();
        let next = plan(&client, "small_bezier.json", sender).await;
        assert!(matches!(next, ActionEnd::Succeeded(_)), "{}", next.result().text);
        node.shutdown().await;
    })
    .unwrap();
}
