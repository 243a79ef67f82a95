//! Stages killed (`kill -9`) or stopped (SIGSTOP) while they work, goals that get into each other's way: the planner says within five seconds
//! which stage is gone, goes on when it is back, gives up with a clear error when it is not, and plans the next part without a restart.
#![allow(clippy::unwrap_used, reason = "a test's own helpers may fail like the test")]

use std::process::{Command, Stdio};
use std::sync::Arc;
use std::time::{Duration, Instant};

use patchmill_msgs::action::{PlanSurface, PlanSurfaceFeedback, PlanSurfaceGoal, PlanSurfaceResult};
use patchmill_msgs::builtin_interfaces::msg::Time;
use patchmill_node_runtime::{ActionClient, ActionEnd, Node, NodeOptions, block_on, free_domain, topics};
use patchmill_products::job::Job;
use patchmill_products::stage::SUPERSEDED;
use patchmill_tests::executables::executable;
use patchmill_tests::processes::Stack;
use tokio::sync::{Notify, mpsc};

/// For a whole goal, faults included.
const PATIENCE: Duration = Duration::from_secs(120);

/// A stage is stopped for so long; the planner misses it after four.
const STOPPED: Duration = Duration::from_secs(6);

/// Goals that come twenty a second; the last one is [`goal_of`] one patch of `small_bezier.json`.
const GOALS: usize = 58;
const PACE: Duration = Duration::from_millis(50);
const CUSTOMERS: usize = 8;

fn goal(path: &str) -> PlanSurfaceGoal {
    goal_of(path, 2)
}

fn goal_of(path: &str, patches_max: u8) -> PlanSurfaceGoal {
    let job = Job { patches_min: 1, patches_max, ..Job::default_for("") };
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

#[test]
fn a_stopped_stage_is_reported_and_works_on_when_it_is_continued() {
    block_on(async {
        let lease = free_domain().unwrap();
        let stack = Stack::start(lease.domain(), &["-p", "surface_partitioning:restarts:=1000"]);
        let node = Node::start(NodeOptions::local("faults", lease.domain())).unwrap();
        let client = node.action_client(topics::PLAN_SURFACE).unwrap();
        let (sender, _quiet) = mpsc::unbounded_channel();
        let undisturbed = program_hash(plan(&client, "surface_1.json", sender).await);
        for stage in topics::nodes::STAGES {
            let (sender, mut feedback) = mpsc::unbounded_channel();
            let disturb = async {
                until(&mut feedback, |f| f.stage == stage).await;
                stack.signal(stage, "STOP");
                tokio::time::sleep(STOPPED).await;
                stack.signal(stage, "CONT");
                let continued = Instant::now();
                let told = until(&mut feedback, |f| f.text.contains("is gone")).await;
                assert_eq!(told.stage, stage);
                until(&mut feedback, |f| f.stage == stage && f.text.contains("is back")).await;
                let heard = continued.elapsed();
                assert!(heard < Duration::from_secs(5), "{stage} was heard again after {heard:?}");
            };
            let (end, ()) = tokio::join!(plan(&client, "surface_1.json", sender), disturb);
            assert_eq!(program_hash(end), undisturbed, "after {stage} was stopped");
            // Without a restart.
            let (sender, _quiet) = mpsc::unbounded_channel();
            assert_eq!(program_hash(plan(&client, "surface_1.json", sender).await), undisturbed);
        }
        node.shutdown().await;
    })
    .unwrap();
}

/// The end of a goal; `working` is told when it is worked on.
async fn followed(
    client: &ActionClient<PlanSurface>,
    goal: PlanSurfaceGoal,
    working: &Notify,
) -> ActionEnd<PlanSurfaceResult> {
    let end = client.execute(goal, PATIENCE, |_| working.notify_one(), std::future::pending());
    tokio::time::timeout(PATIENCE, end).await.expect("the goal ends").unwrap()
}

/// A goal that nobody listens to.
async fn end_of(client: &ActionClient<PlanSurface>, goal: PlanSurfaceGoal) -> ActionEnd<PlanSurfaceResult> {
    followed(client, goal, &Notify::new()).await
}

/// A client in a node of its own.
fn customer(domain: u16, name: &str) -> (Node, ActionClient<PlanSurface>) {
    let node = Node::start(NodeOptions::local(name, domain)).unwrap();
    let client = node.action_client(topics::PLAN_SURFACE).unwrap();
    (node, client)
}

fn is_superseded(end: &ActionEnd<PlanSurfaceResult>) -> bool {
    matches!(end, ActionEnd::Aborted(result) if result.code == SUPERSEDED)
}

#[test]
fn goals_that_supersede_each_other_end_in_the_newest_ones_plan() {
    block_on(async {
        let lease = free_domain().unwrap();
        let _stack = Stack::start(lease.domain(), &[]);
        // A customer has one goal at a time, and is wanted again after all others.
        let customers: Vec<_> = (0..CUSTOMERS)
            .map(|place| customer(lease.domain(), &format!("customer_{place}")))
            .map(|(node, client)| (node, Arc::new(client)))
            .collect();
        let small = || goal_of("small_bezier.json", 1);
        let right = program_hash(end_of(&customers[0].1, small()).await);
        for (_, client) in &customers {
            assert_eq!(program_hash(end_of(client, small()).await), right);
        }

        // The same job twice at once: the newer one is planned.
        let (one, other) = tokio::join!(end_of(&customers[0].1, small()), end_of(&customers[1].1, small()));
        let (superseded, planned) = if is_superseded(&one) { (one, other) } else { (other, one) };
        assert!(is_superseded(&superseded), "{superseded:?}");
        assert_eq!(program_hash(planned), right);

        // Twenty a second, of two surfaces and two jobs.
        let begun = tokio::time::Instant::now();
        let before_last = Arc::new(Notify::new());
        let goals: Vec<_> = (0..GOALS)
            .map(|number| {
                let client = Arc::clone(&customers[number % CUSTOMERS].1);
                let surface = ["nurbs_trough.json", "small_bezier.json"][number % 2];
                let goal = goal_of(surface, 1 + (number / 2 % 2) as u8);
                let before_last = Arc::clone(&before_last);
                tokio::spawn(async move {
                    tokio::time::sleep_until(begun + PACE * number as u32).await;
                    match GOALS - number {
                        2 => followed(&client, goal, &before_last).await,
                        1 => {
                            // Two of different customers may overtake each other; this one has to be the newest.
                            before_last.notified().await;
                            end_of(&client, goal).await
                        }
                        _ => end_of(&client, goal).await,
                    }
                })
            })
            .collect();
        let mut ends = Vec::new();
        for goal in goals {
            ends.push(goal.await.unwrap());
        }
        let last = ends.pop().unwrap();
        for (number, end) in ends.iter().enumerate() {
            assert!(is_superseded(end), "goal {number}: {end:?}");
        }
        assert_eq!(program_hash(last), right);
        for (node, _) in customers {
            node.shutdown().await;
        }
    })
    .unwrap();
}

/// What a second planner says as it ends.
fn second(program: &str, arguments: &[&str], domain: u16) -> String {
    let mut command = Command::new(executable(program));
    command.args(arguments).env("ROS_DOMAIN_ID", domain.to_string());
    let mut child = command.stdin(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    let end = Instant::now() + PATIENCE;
    while child.try_wait().unwrap().is_none() {
        assert!(Instant::now() < end, "a second planner runs on");
        std::thread::sleep(Duration::from_millis(20));
    }
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    String::from_utf8(output.stderr).unwrap()
}

#[test]
fn of_two_planners_the_younger_ends_and_the_older_goes_on() {
    block_on(async {
        let lease = free_domain().unwrap();
        let _stack = Stack::start(lease.domain(), &[]);
        let (node, client) = customer(lease.domain(), "faults");
        let first = program_hash(end_of(&client, goal("small_bezier.json")).await);
        let domain = lease.domain();
        for (program, arguments) in [("planner", &[][..]), ("patchmill", &["up", "--surfaces", "."])] {
            let said = tokio::task::spawn_blocking(move || second(program, arguments, domain)).await.unwrap();
            assert!(said.contains("/patchmill/planner runs already on domain"), "{said}");
            let again = program_hash(end_of(&client, goal("small_bezier.json")).await);
            assert_eq!(again, first, "after a second {program}");
        }
        node.shutdown().await;
    })
    .unwrap();
}
