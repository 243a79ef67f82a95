//! Topics, services, parameters, actions and the stage runner between two nodes of one process.

#![allow(clippy::unwrap_used)]

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

use patchmill_msgs::action::{PlanSurface, PlanSurfaceFeedback, PlanSurfaceGoal, PlanSurfaceResult};
use patchmill_msgs::msg::{Job, StageStatus};
use patchmill_msgs::srv::{Recompute, RecomputeRequest, RecomputeResponse};
use patchmill_node_runtime::arguments::NodeOptions;
use patchmill_node_runtime::{
    ActionEnd, DomainLease, JobTag, Node, Qos, RuntimeError, Series, StageRunner, StatusPublisher, WAITING,
    block_on, free_domain, topics,
};
use patchmill_products::stage::{SUPERSEDED, StageError};

const PATIENCE: Duration = Duration::from_secs(60);

fn two_nodes() -> (DomainLease, Node, Node) {
    let lease = free_domain().unwrap();
    let a = Node::start(NodeOptions::local("a", lease.domain())).unwrap();
    let b = Node::start(NodeOptions::local("b", lease.domain())).unwrap();
    (lease, a, b)
}

async fn within<T>(future: impl Future<Output = T>) -> T {
    tokio::time::timeout(PATIENCE, future).await.expect("in time")
}

#[test]
fn latched_messages_reach_late_joiners() {
    block_on(async {
        let (_lease, a, b) = two_nodes();
        let publisher = a.publisher::<Job>(topics::JOB, Qos::Status).unwrap();
        publisher.publish(Job { job_id: "first".to_owned(), ..Job::default() }).unwrap();
        let mut jobs = b.subscribe::<Job>(topics::JOB, Qos::Status).unwrap();
        assert_eq!(within(jobs.next()).await.unwrap().job_id, "first");
        publisher.publish(Job { job_id: "second".to_owned(), ..Job::default() }).unwrap();
        assert_eq!(within(jobs.next()).await.unwrap().job_id, "second");
        a.shutdown().await;
        b.shutdown().await;
        assert!(matches!(b.publisher::<Job>("x", Qos::Status), Err(RuntimeError::Stopped)));
    })
    .unwrap();
}

#[test]
fn a_late_joiner_sees_the_newest_whole_of_a_series_and_nothing_older() {
    block_on(async {
        let (lease, a, b) = two_nodes();
        let mut series = Series::<Job>::new(&a, "series").unwrap();
        let whole = |name: &str, count: usize| {
            (0..count).map(|i| Job { job_id: format!("{name}{i}"), ..Job::default() }).collect::<Vec<_>>()
        };
        let mut early = b.subscribe::<Job>("series", Qos::Series).unwrap();
        series.replace(whole("old", 30)).await.unwrap();
        for i in 0..30 {
            assert_eq!(within(early.next()).await.unwrap().job_id, format!("old{i}"));
        }
        assert!(matches!(
            series.replace(whole("too many", Series::<Job>::MOST + 1)).await,
            Err(RuntimeError::Publish { .. })
        ));
        series.replace(whole("new", 20)).await.unwrap();
        let c = Node::start(NodeOptions::local("c", lease.domain())).unwrap();
        let mut late = c.subscribe::<Job>("series", Qos::Series).unwrap();
        for i in 0..20 {
            assert_eq!(within(late.next()).await.unwrap().job_id, format!("new{i}"));
            assert_eq!(within(early.next()).await.unwrap().job_id, format!("new{i}"));
        }
        a.shutdown().await;
        b.shutdown().await;
        c.shutdown().await;
    })
    .unwrap();
}

#[test]
fn of_messages_that_nobody_takes_a_bounded_number_is_held_with_the_newest() {
    block_on(async {
        let (_lease, a, b) = two_nodes();
        let publisher = a.publisher::<Job>(topics::JOB, Qos::Status).unwrap();
        let mut jobs = b.subscribe::<Job>(topics::JOB, Qos::Status).unwrap();
        let count = 40 * WAITING;
        let (arrived, arrives) = tokio::sync::oneshot::channel();
        let mut arrived = Some(arrived);
        let last = (count - 1).to_string();
        b.subscribe_with(topics::JOB, Qos::Status, move |job: Job| {
            if job.job_id == last {
                arrived.take().map(|arrived| arrived.send(()));
            }
        })
        .unwrap();
        assert!(publisher.wait_for_subscriptions(2, PATIENCE).await);
        for i in 0..count {
            publisher.publish(Job { job_id: i.to_string(), ..Job::default() }).unwrap();
        }
        within(arrives).await.unwrap();
        let mut taken = Vec::new();
        while taken.last() != Some(&(count - 1)) {
            taken.push(within(jobs.next()).await.unwrap().job_id.parse::<usize>().unwrap());
        }
        // What DDS holds until it is taken comes to it: its history, cleared now and then.
        assert!(taken.is_sorted() && taken.len() < 10 * WAITING, "{} of {count}", taken.len());
        a.shutdown().await;
        b.shutdown().await;
    })
    .unwrap();
}

/// As two stacks of seven nodes and a recorder each.
#[test]
fn the_fifteenth_and_sixteenth_node_of_a_host_find_each_other() {
    block_on(async {
        let lease = free_domain().unwrap();
        let nodes: Vec<Node> = (0..16)
            .map(|i| Node::start(NodeOptions::local(&format!("node_{i}"), lease.domain())).unwrap())
            .collect();
        let publisher = nodes[14].publisher::<Job>(topics::JOB, Qos::Status).unwrap();
        publisher.publish(Job { job_id: "found".to_owned(), ..Job::default() }).unwrap();
        let mut jobs = nodes[15].subscribe::<Job>(topics::JOB, Qos::Status).unwrap();
        assert_eq!(within(jobs.next()).await.unwrap().job_id, "found");
        for node in &nodes {
            node.shutdown().await;
        }
    })
    .unwrap();
}

#[test]
fn a_slow_service_handles_a_repeated_request_once() {
    block_on(async {
        let (_lease, a, b) = two_nodes();
        let handled = Arc::new(AtomicU32::new(0));
        let counter = Arc::clone(&handled);
        a.serve::<Recompute, _, _>("a/recompute", move |request: RecomputeRequest| {
            counter.fetch_add(1, Ordering::Relaxed);
            async move {
                tokio::time::sleep(Duration::from_millis(700)).await;
                RecomputeResponse { code: 0, text: request.job_id }
            }
        })
        .unwrap();
        let client = b.service_client::<Recompute>("a/recompute").unwrap();
        let request = RecomputeRequest { job_id: "j".to_owned() };
        let answer = client.call(&request, Duration::from_millis(200), PATIENCE).await.unwrap();
        assert_eq!(answer.text, "j");
        assert_eq!(handled.load(Ordering::Relaxed), 1);

        let nobody = b.service_client::<Recompute>("nobody/recompute").unwrap();
        let error = nobody.call(&request, Duration::from_millis(200), Duration::from_millis(300)).await;
        assert!(matches!(error, Err(RuntimeError::Unavailable { .. })), "{error:?}");
        a.shutdown().await;
        b.shutdown().await;
    })
    .unwrap();
}

#[test]
fn a_handler_that_breaks_down_ends_no_service() {
    block_on(async {
        let (_lease, a, b) = two_nodes();
        a.serve::<Recompute, _, _>("a/recompute", |request: RecomputeRequest| {
            assert_ne!(request.job_id, "at once");
            async move {
                assert_ne!(request.job_id, "later");
                RecomputeResponse { code: 0, text: request.job_id }
            }
        })
        .unwrap();
        let client = b.service_client::<Recompute>("a/recompute").unwrap();
        let ask = async |what: &str, patience| {
            let request = RecomputeRequest { job_id: what.to_owned() };
            client.call(&request, PATIENCE, patience).await
        };
        assert_eq!(ask("well", PATIENCE).await.unwrap().text, "well");
        for what in ["at once", "later"] {
            let error = ask(what, Duration::from_millis(300)).await;
            assert!(matches!(error, Err(RuntimeError::NoAnswer { .. })), "{error:?}");
            assert_eq!(ask("well", PATIENCE).await.unwrap().text, "well");
        }
        a.shutdown().await;
        b.shutdown().await;
    })
    .unwrap();
}

#[test]
fn actions_run_reject_and_cancel() {
    block_on(async {
        let (_lease, a, b) = two_nodes();
        a.serve_action::<PlanSurface, _, _>(
            topics::PLAN_SURFACE,
            |goal| if goal.path == "bad" { Err("a bad path".to_owned()) } else { Ok(()) },
            |goal: PlanSurfaceGoal, context| async move {
                context.feedback(PlanSurfaceFeedback { stage: "s".to_owned(), ..Default::default() });
                if goal.path == "long" {
                    context.cancelled().await;
                    return ActionEnd::Canceled(PlanSurfaceResult { code: 1, ..Default::default() });
                }
                ActionEnd::Succeeded(PlanSurfaceResult { text: goal.path, ..Default::default() })
            },
        )
        .unwrap();
        let client = b.action_client::<PlanSurface>(topics::PLAN_SURFACE).unwrap();
        let goal = |path: &str| PlanSurfaceGoal { path: path.to_owned(), ..Default::default() };

        let end = within(client.execute(goal("p"), PATIENCE, |_| {}, std::future::pending())).await.unwrap();
        assert!(matches!(&end, ActionEnd::Succeeded(r) if r.text == "p"), "{:?}", end.result().text);

        let rejected = within(client.execute(goal("bad"), PATIENCE, |_| {}, std::future::pending())).await;
        assert!(matches!(rejected, Err(RuntimeError::Rejected { .. })));

        let (mut stages, (working, works)) = (Vec::new(), tokio::sync::oneshot::channel());
        let mut working = Some(working);
        let follow = |feedback: PlanSurfaceFeedback| {
            stages.push(feedback.stage);
            working.take().map(|working| working.send(()));
        };
        let cancel = async { works.await.unwrap() };
        let end = within(client.execute(goal("long"), PATIENCE, follow, cancel)).await.unwrap();
        assert!(matches!(&end, ActionEnd::Canceled(r) if r.code == 1));
        assert_eq!(stages, ["s"]);
        a.shutdown().await;
        b.shutdown().await;
    })
    .unwrap();
}

#[test]
fn a_newer_job_supersedes_the_older_promptly() {
    block_on(async {
        let (_lease, a, b) = two_nodes();
        let mut statuses = b.subscribe::<StageStatus>(&topics::status("a"), Qos::Status).unwrap();
        let mut runner = StageRunner::<u32>::new(StatusPublisher::new(&a).unwrap());
        let tag = |id: &str| JobTag { job_id: id.to_owned(), ..JobTag::default() };
        runner.start(tag("old"), "working", |progress| {
            loop {
                progress.check()?;
                std::thread::sleep(Duration::from_millis(1));
            }
        });
        runner.start(tag("new"), "working", |progress| {
            (progress.report)(0.5);
            Ok(7)
        });
        let (done, result) = within(runner.finished()).await;
        assert_eq!((done.job_id.as_str(), result), ("new", Ok(7)));
        runner.start(tag("bad"), "working", |_| Err(StageError::new(201, "the tool is too big")));
        let (_, result) = within(runner.finished()).await;
        assert_ne!(result.unwrap_err().code, SUPERSEDED);
        loop {
            let status = within(statuses.next()).await.unwrap();
            if status.state == StageStatus::FAILED {
                assert_eq!((status.code, status.job_id.as_str()), (201, "bad"));
                break;
            }
        }
        a.shutdown().await;
        b.shutdown().await;
    })
    .unwrap();
}

#[test]
fn of_work_that_waits_for_its_turn_only_the_newest_is_begun() {
    block_on(async {
        let (_lease, a, _b) = two_nodes();
        let mut runner = StageRunner::<u32>::new(StatusPublisher::new(&a).unwrap());
        let tag = |number: u32| JobTag { job_id: number.to_string(), ..JobTag::default() };
        let (begun, mut began) = tokio::sync::mpsc::unbounded_channel();
        let (release, released) = std::sync::mpsc::channel::<()>();
        let say = begun.clone();
        runner.start(tag(0), "working", move |_| {
            say.send(0).unwrap();
            // As work that is slow to see that it is not wanted any more.
            released.recv().unwrap();
            Ok(0)
        });
        assert_eq!(within(began.recv()).await, Some(0));
        for number in 1..=20 {
            let say = begun.clone();
            runner.start(tag(number), "working", move |_| {
                say.send(number).unwrap();
                Ok(number)
            });
        }
        release.send(()).unwrap();
        let (done, result) = within(runner.finished()).await;
        assert_eq!((done.job_id.as_str(), result), ("20", Ok(20)));
        drop((begun, runner));
        assert_eq!(within(began.recv()).await, Some(20));
        assert_eq!(within(began.recv()).await, None);
    })
    .unwrap();
}
